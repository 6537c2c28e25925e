"""The error of a weighing as laboratories have it: "0.3 mg/kg + 8 % + 5 % of each speed".

An absolute part and one of the erosion are each row's own. The last one, as of a jet whose speed is not known better,
all rows of a speed share: y = μ (1 + c z) + e, with one normal number z for each speed. Their covariance is D + c² μμᵀ,
and its inverse follows from that of the diagonal D (Sherman and Morrison, Ann. Math. Stat. 21 (1950) 124-127).
"""

import dataclasses
import re
from typing import Any

import numpy as np
from scipy import optimize, sparse

from erosion.arguments import Number
from erosion.output import briefly, sentences
from erosion.parameters import Dimension, System, UnitError, has_unit, read_quantity, read_removal, table_scale

_PLUS = re.compile(r"(?<![eE])\+")  # not that of 1e+3
_SHARE = re.compile(r"(.*\S)\s*(?:%|percent)\s*(of\s+each\s+speed)?\s*", re.IGNORECASE)
_NOTHING = 1e-3  # of the greater part
_LEAST = 0.5  # of a measured erosion, whose error a model has that is far below it
_EXAMPLE = '"0.3 mg/kg + 8 %" or "8 % + 5 % of each speed"'


@dataclasses.dataclass(frozen=True)
class ErrorModel:
    """Standard deviations: √(a² + (b E)²) of a row's own error, E its erosion by the model; c E of that of its speed.

        erosion.ErrorModel(0.3e-6, 0.08).deviation(100e-6)  # of 0.3 mg/kg + 8 % in SI

    Args:
        absolute: a ≥ 0 [of the erosion, SI].
        relative: b ≥ 0, a share.
        common: c ≥ 0, a share by which all rows of one speed are off together. Alone it leaves a row's own error to a
            column, or to be found.

    Raises:
        ValueError: for parts that are no numbers, negative or not finite, or all zero.
    """

    absolute: float = 0.0
    relative: float = 0.0
    common: float = 0.0

    def __post_init__(self) -> None:
        parts = dataclasses.astuple(self)
        are_numbers = all(isinstance(part, (int, float, np.number)) and not isinstance(part, bool) for part in parts)
        if not (are_numbers and np.isfinite(parts).all() and min(parts) >= 0 < max(parts)):
            listed = ", ".join(map(briefly, parts))
            raise ValueError(f"An error must have parts of zero or more, not all zero, but has {listed}.")

    @property
    def has_own(self) -> bool:
        """Whether it says what a row's own error is."""
        return self.absolute > 0 or self.relative > 0

    @classmethod
    def read(cls, text: str, dimension: Dimension) -> "ErrorModel":
        """Read a text such as "0.3 mg/kg + 8 % + 5 % of each speed"; its parts stand in any order; any may be missing.

        Args:
            text: the parts.
            dimension: of the erosion.

        Raises:
            ValueError: The text is no sum of an amount and shares; a clause that starts with "must".
        """
        parts = {"absolute": 0.0, "relative": 0.0, "common": 0.0}
        texts = _PLUS.split(text)
        for part in texts:
            share = _SHARE.fullmatch(part.strip())
            if not share and "%" in part:
                raise UnitError(f"must be a sum of parts such as {_EXAMPLE}, but is {briefly(text)}")
            name = "absolute" if not share else "common" if share[2] else "relative"
            size = read_quantity(share[1], "1") / 100 if share else read_removal(part, dimension)
            bare = not share and dimension != "1" and not has_unit(part)
            if bare or parts[name] or not (np.isfinite(size) and size > 0):
                raise UnitError(
                    f"must be a sum of positive parts with units, such as {_EXAMPLE}, but is {briefly(text)}"
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
        """One standard deviation of a row's own error at an erosion, of its shape."""
        return np.hypot(self.absolute, self.relative * np.asarray(erosion))

    def in_words(self, dimension: Dimension, system: System) -> str:
        """The parts as `read` takes them: "0.3 mg/kg + 8 %", in units of a system."""
        scale = table_scale(dimension, system, self.absolute)
        return " + ".join(sentences(
            (self.absolute > 0, scale.beside(f"{self.absolute / scale.size:.4g}")),
            (self.relative > 0, f"{100 * self.relative:.4g} %"),
            (self.common > 0, f"{100 * self.common:.4g} % of each speed"),
        ))  # fmt: skip


def of_which(expected: Any, measured: np.ndarray) -> np.ndarray:
    """The erosion of which the relative errors of rows are, the model's; of the measured one they bias a fit.

    Rows that are low by chance would count more, and a fit would be low by about 2 b². A model that has next to nothing
    at a row would have no error there: its least is that of half of the measured erosion.

    Args:
        expected: the model's erosion, shape (…, n).
        measured: the mean of repeats, shape (n,).
    """
    return np.maximum(np.abs(expected), _LEAST * np.abs(measured))


def without_common(of_rows: np.ndarray, common: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Numbers of rows, over their own errors, times the inverse root of the covariance with a common error.

    That of 1 + uuᵀ, with u the common over the own errors of the rows of one speed, is 1 - (1 - 1/√(1 + u²)) uuᵀ/u².

    Args:
        of_rows: shape (…, n).
        common: u, shape (n,).
        speeds: which speed each row has, shape (n,).
    """
    loads = sparse.csr_array((common, (np.arange(len(speeds)), speeds)))
    squares = np.bincount(speeds, common**2)
    taken = (1 - 1 / np.sqrt(1 + squares)) / np.where(squares > 0, squares, 1.0)
    flat = of_rows.reshape(-1, len(speeds))
    return (flat - ((flat @ loads) * taken) @ loads.T).reshape(of_rows.shape)


def by_common(residuals: np.ndarray, common: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The changes of χ² and of the logarithm of the determinant by a common error, both of shape (m,).

    Args:
        residuals: over their own errors, shape (m, n).
        common: over the same, shape (m, n).
        speeds: which speed each row has, shape (n,).
    """
    is_of = sparse.csr_array((np.ones(len(speeds)), (np.arange(len(speeds)), speeds)))
    squares, products = common**2 @ is_of, (common * residuals) @ is_of
    return np.sum(products**2 / (1 + squares), axis=1), np.sum(np.log1p(squares), axis=1)
