"""The error of a weighing as laboratories have it: "0.3 mg/kg + 8 %", an absolute part and one of the erosion."""

import dataclasses
import re
from typing import Any

import numpy as np
from scipy import optimize

from erosion.arguments import Number
from erosion.output.tables import briefly
from erosion.parameters.quantities import Dimension, System, UnitError, has_unit, read_quantity, table_scale

_PLUS = re.compile(r"(?<![eE])\+")  # not that of 1e+3
_SHARE = re.compile(r"(.*\S)\s*(?:%|percent)\s*")
_NOTHING = 1e-3  # of the greater part
_LEAST = 0.5  # of a measured erosion, whose error a model has that is far below it
_EXAMPLE = '"0.3 mg/kg + 8 %"'


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """The standard deviation of a row, √(a² + (b E)²) of its erosion E, which is that of the model.

        erosion.ErrorModel(0.3e-6, 0.08).deviation(100e-6)  # of 0.3 mg/kg + 8 % in SI

    Args:
        absolute: a ≥ 0 [of the erosion].
        relative: b ≥ 0, a share.

    Raises:
        ValueError: for parts that are negative or not finite, or both zero.
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        parts = self.absolute, self.relative
        if not (np.isfinite(parts).all() and min(parts) >= 0 < max(parts)):
            raise ValueError(
                f"An error must have parts of zero or more, not both zero, but has {parts[0]:g} and {parts[1]:g}."
            )

    @classmethod
    def read(cls, text: str, dimension: Dimension, units: System) -> "ErrorModel":
        """Of a text such as "0.3 mg/kg + 8 %", whose parts stand in any order; either may be left out.

        Args:
            text: the parts.
            dimension: of the erosion.
            units: of the result.

        Raises:
            ValueError: The text is no sum of an amount and a share; a clause that starts with "must".
        """
        parts = {"absolute": 0.0, "relative": 0.0}
        texts = _PLUS.split(text)
        for part in texts:
            share = _SHARE.fullmatch(part.strip())
            name = "relative" if share else "absolute"
            size = read_quantity(share[1], "1", units) / 100 if share else read_quantity(part, dimension, units)
            bare = not share and dimension != "1" and not has_unit(part)
            if bare or parts[name] or not (np.isfinite(size) and size > 0):
                raise UnitError(
                    f"must be one or two positive parts with units, such as {_EXAMPLE}, but is {briefly(text)}"
                )
            parts[name] = size
        return cls(**parts)

    @classmethod
    def nearest(cls, erosion: np.ndarray, uncertainty: np.ndarray) -> "ErrorModel":
        """The two parts that come nearest to uncertainties, by least squares of variances over them."""
        of_rows = np.stack([np.ones(len(erosion)), erosion**2], axis=1) / uncertainty[:, None] ** 2
        # Columns of one size, so that small numbers are no zeros.
        sizes = np.linalg.norm(of_rows, axis=0)
        sizes[sizes == 0] = 1.0
        squares, _ = optimize.nnls(of_rows / sizes, np.ones(len(erosion)))
        parts = np.sqrt(squares / sizes)
        # Rounding leaves a part that matters in no row.
        shares = parts * np.array([1.0, np.abs(erosion).max()])
        return cls(*np.where(shares < _NOTHING * shares.max(), 0.0, parts).tolist())

    def deviation(self, erosion: np.ndarray | Number) -> Any:
        """One standard deviation at an erosion, of its shape."""
        return np.hypot(self.absolute, self.relative * np.asarray(erosion))

    def in_words(self, dimension: Dimension, units: System) -> str:
        """The parts as `read` takes them: "0.3 mg/kg + 8 %"."""
        scale = table_scale(dimension, units, self.absolute)
        absolute = scale.beside(f"{self.absolute / scale.size:.4g}")
        return " + ".join([absolute] * (self.absolute > 0) + [f"{100 * self.relative:.4g} %"] * (self.relative > 0))


def errors_at(parts: np.ndarray, expected: Any, measured: np.ndarray) -> Any:
    """Standard deviations of rows whose relative part is of the model's erosion; of the measured one it biases a fit.

    Rows that are low by chance would count more, and a fit would be low by about 2 b². A model that has next to nothing
    at a row would have no error there: its least is that of half of the measured erosion.

    Args:
        parts: absolute and relative part of each row, shape (n, 2).
        expected: the model's erosion, shape (…, n).
        measured: the mean of repeats, shape (n,).
    """
    return np.hypot(parts[:, 0], parts[:, 1] * np.maximum(np.abs(expected), _LEAST * np.abs(measured)))
