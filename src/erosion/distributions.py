"""How a parameter varies from particle to particle: laws by their inverse distribution.

As text, on the command line and in case files:

    normal(20deg, 3deg)                 mean, standard deviation
    lognormal(100 m/s, 0.2)             median, standard deviation of the logarithm
    uniform(80 m/s, 120 m/s)            least, greatest
    loguniform(0.01, 1)                 least > 0, greatest; all factors alike
    weibull(100 m/s, 4)                 scale, shape
    rosin-rammler(1 mm, 3, 0.2 mm)      size of which 1/e of the mass is coarser, spread, least size
    samples(jet.csv)                    the file's column of the parameter's name
"""

import dataclasses
import functools
import hashlib
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy import special

from erosion import tables
from erosion.arguments import real_numbers
from erosion.output import briefly
from erosion.parameters import (
    Dimension,
    System,
    has_unit,
    read_quantity,
    table_scale,
)
from erosion.tables.headings import of_parameters, of_weights

Number = float | int


class Distribution(ABC):
    """The law of one parameter; a new law is a frozen dataclass of numbers with these two methods.

    The numbers are in the parameter's unit, but for those named in `shapes`, which are pure;
    those named in `positive` must be so.
    """

    shapes: ClassVar[tuple[str, ...]] = ()
    positive: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name in _fields(self):
            given = getattr(self, name)
            if isinstance(given, bool) or not isinstance(given, (int, float, np.integer, np.floating)):
                raise TypeError(f"Argument `{name}` must be a number, but is {briefly(given)}.")
            value = float(given)
            object.__setattr__(self, name, value)
            if not math.isfinite(value) or (name in self.positive and value <= 0):
                wish = "positive and finite" if name in self.positive else "finite"
                raise ValueError(f"Argument `{name}` must be {wish}, but is {value:g}.")

    def __str__(self) -> str:
        numbers = ", ".join(f"{getattr(self, name):.6g}" for name in _fields(self))
        return f"{type(self).__name__}({numbers})"

    def in_words(self, dimension: Dimension, system: System) -> str:
        """The law as a person reads it: "normal(20°, 3°)".

        Args:
            dimension: of the parameter.
            system: the units of the numbers.
        """
        texts = []
        for name in _fields(self):
            value = getattr(self, name)
            scale = table_scale("1" if name in self.shapes else dimension, system, abs(value))
            texts.append(scale.beside(f"{value / scale.size:.5g}"))
        names = {law: name for name, law in LAWS.items()}
        return f"{names.get(type(self), type(self).__name__)}({', '.join(texts)})"

    @abstractmethod
    def ppf(self, u: np.ndarray) -> np.ndarray:
        """The value below which the share u lies; u in (0, 1), any shape."""

    @abstractmethod
    def cdf(self, x: float) -> float:
        """The share below x."""


@dataclasses.dataclass(frozen=True)
class Normal(Distribution):
    """The normal law: mean, and standard deviation > 0."""

    mean: Number
    deviation: Number
    positive: ClassVar[tuple[str, ...]] = ("deviation",)

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.mean + self.deviation * special.ndtri(u)

    def cdf(self, x: float) -> float:
        return float(special.ndtr((x - self.mean) / self.deviation))


@dataclasses.dataclass(frozen=True)
class LogNormal(Distribution):
    """The lognormal law: median > 0, and standard deviation of the natural logarithm > 0."""

    median: Number
    spread: Number
    shapes: ClassVar[tuple[str, ...]] = ("spread",)
    positive: ClassVar[tuple[str, ...]] = ("median", "spread")

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.median * np.exp(self.spread * special.ndtri(u))

    def cdf(self, x: float) -> float:
        return float(special.ndtr(math.log(x / self.median) / self.spread)) if x > 0 else 0.0


@dataclasses.dataclass(frozen=True)
class _Between(Distribution):
    """A law of values from `low` to `high`."""

    low: Number
    high: Number

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.low >= self.high:
            raise ValueError(f"Argument `low` must be less than `high`, {self.high:g}, but is {self.low:g}.")


@dataclasses.dataclass(frozen=True)
class Uniform(_Between):
    """All values from `low` to `high` alike."""

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.low + (self.high - self.low) * u

    def cdf(self, x: float) -> float:
        return min(max((x - self.low) / (self.high - self.low), 0.0), 1.0)


@dataclasses.dataclass(frozen=True)
class LogUniform(_Between):
    """All factors from `low` > 0 to `high` alike: the logarithm has the uniform law."""

    positive: ClassVar[tuple[str, ...]] = ("low", "high")

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.low * np.exp(math.log(self.high / self.low) * u)

    def cdf(self, x: float) -> float:
        if x <= self.low:
            return 0.0
        return min(math.log(x / self.low) / math.log(self.high / self.low), 1.0)


@dataclasses.dataclass(frozen=True)
class Weibull(Distribution):
    """Weibull's law by number: scale > 0 (1 - 1/e lie below it), and shape > 0."""

    scale: Number
    shape: Number
    shapes: ClassVar[tuple[str, ...]] = ("shape",)
    positive: ClassVar[tuple[str, ...]] = ("scale", "shape")

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.scale * (-np.log1p(-u)) ** (1 / self.shape)

    def cdf(self, x: float) -> float:
        return -math.expm1(-((x / self.scale) ** self.shape)) if x > 0 else 0.0


@dataclasses.dataclass(frozen=True)
class RosinRammler(Distribution):
    """Rosin and Rammler's law of ground solids, from what lies on sieves, for sizes by number.

    The share of the **mass** that is coarser than x is exp(-(x/scale)ⁿ). A stream counts
    particles, and a particle's mass goes with x³, so their number has the density
    x^(n-4) exp(-(x/scale)ⁿ): far more fines than Weibull's law of the same numbers. For n ≤ 3
    it has no finite total without a least size.

    Args:
        scale: the size of which 1/e of the mass is coarser [of the parameter], > 0.
        spread: n > 0; 1 is broad, 4 narrow.
        least: the finest size that is there, > 0: the last sieve's.

    References:
        P. Rosin, E. Rammler, "The laws governing the fineness of powdered coal",
        J. Inst. Fuel 7 (1933), 29-36.
    """

    scale: Number
    spread: Number
    least: Number
    shapes: ClassVar[tuple[str, ...]] = ("spread",)
    positive: ClassVar[tuple[str, ...]] = ("scale", "spread", "least")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least >= self._greatest:
            raise ValueError(f"Argument `least` must be a size that some of the mass passes, but is {self.least:g}.")

    def ppf(self, u: np.ndarray) -> np.ndarray:
        sizes, shares = self._table
        return np.exp(np.interp(u, shares, sizes))

    def cdf(self, x: float) -> float:
        if x <= self.least:
            return 0.0
        sizes, shares = self._table
        return float(np.interp(math.log(x), sizes, shares))

    @property
    def _greatest(self) -> float:
        # Coarser than this is 1e-16 of the mass.
        return self.scale * (16 * math.log(10)) ** (1 / self.spread)

    @functools.cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of x, and the share of the number below each, by the trapezoidal rule."""
        # 2¹⁵ intervals over, say, 7 units of log x: relative error (7/2¹⁵)²/12 ≈ 4e-9.
        sizes = np.linspace(math.log(self.least), math.log(self._greatest), 2**15 + 1)
        x = np.exp(sizes - math.log(self.scale))
        # The exponent is shifted, as x^(n-3) alone may overflow.
        exponent = (self.spread - 3) * np.log(x) - x**self.spread
        density = np.exp(exponent - exponent.max())
        shares = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
        return sizes, shares / shares[-1]


@dataclasses.dataclass(frozen=True, eq=False)
class Samples(Distribution):
    """Measured values, each as likely as the others, shape (n,).

    Raises:
        ValueError: for values that are not finite, or none.
    """

    values: Any
    source: str = "samples"

    def __post_init__(self) -> None:
        values = np.sort(real_numbers("values", self.values).reshape(-1))
        if not values.size or not np.isfinite(values).all():
            raise ValueError("Argument `values` must be finite numbers, one or more, but is not.")
        object.__setattr__(self, "values", values)

    def __repr__(self) -> str:
        checksum = hashlib.sha256(self.values.tobytes()).hexdigest()[:8]
        return f"Samples({self.source}: {len(self.values)} values, {checksum})"

    __str__ = __repr__

    def in_words(self, dimension: Dimension, system: System) -> str:
        """The file that they are from, and how many they are."""
        return f"{len(self.values):,} values of {self.source}"

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return self.values[np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)]

    def cdf(self, x: float) -> float:
        return float(np.searchsorted(self.values, x, side="right") / len(self.values))


@dataclasses.dataclass(frozen=True, eq=False)
class OfScipy(Distribution):
    """A frozen distribution of `scipy.stats`, or any other law of one number with `ppf` and `cdf`."""

    law: Any

    def __post_init__(self) -> None:
        middle = np.asarray(self.law.ppf(np.array([0.5])), float)
        if middle.shape != (1,) or not np.isfinite(middle[0]):
            raise ValueError(f"Argument `law` must have one finite number for each share, but {self.law} has not.")

    def __str__(self) -> str:
        if not hasattr(self.law, "dist"):
            return str(self.law)
        numbers = [f"{value:.5g}" for value in self.law.args]
        numbers += [f"{name}={value:.5g}" for name, value in self.law.kwds.items()]
        return f"{self.law.dist.name}({', '.join(numbers)})"

    def in_words(self, dimension: Dimension, system: System) -> str:
        """As scipy has it; its numbers are in the units of the parameter."""
        return str(self)

    def ppf(self, u: np.ndarray) -> np.ndarray:
        return np.asarray(self.law.ppf(u), float)

    def cdf(self, x: float) -> float:
        return float(self.law.cdf(x))


def as_law(law: Any) -> Any:
    """A law as a `Distribution`; what is no law of one number stays what it is."""
    is_foreign = not isinstance(law, Distribution) and hasattr(law, "ppf") and hasattr(law, "cdf")
    return OfScipy(law) if is_foreign else law


def as_laws(given: Any, argument: str = "laws") -> dict[str, Any]:
    """Laws by parameter, each as `as_law` gives it; a `TypeError` naming the argument where they are no mapping."""
    if not isinstance(given, Mapping):
        raise TypeError(f"Argument `{argument}` must be a mapping of parameters to laws, but is {briefly(given)}.")
    return {name: as_law(law) for name, law in given.items()}


LAWS: Mapping[str, type[Any]] = {
    "normal": Normal,
    "lognormal": LogNormal,
    "uniform": Uniform,
    "loguniform": LogUniform,
    "weibull": Weibull,
    "rosin-rammler": RosinRammler,
}
"""The laws by the names that text uses."""

MOST_OUTSIDE = 0.01
"""The share of a law outside of a parameter's range that is cut off without a word."""


_CALL = re.compile(r"\s*(?P<name>[a-z-]+)\s*\((?P<arguments>.*)\)\s*", re.DOTALL)


def read_distribution(text: str, name: str, dimension: Dimension, system: System) -> Distribution | None:
    """A law from text such as "normal(20deg, 3deg)"; None where the text is no such call.

    Args:
        text: as in the module's description.
        name: the parameter, which names the column of a file of samples.
        dimension: of the parameter.
        system: the units of bare numbers and of the result.

    Raises:
        ValueError: with a clause that starts with "must", to follow the parameter's name.
    """
    call = _CALL.fullmatch(text)
    if call is None:
        return None
    if call["name"] == "samples":
        path = call["arguments"].strip()
        columns, unused = read_columns(path, {name: dimension}, system)
        if name not in columns:
            there = briefly(", ".join([*columns, *unused]))
            raise ValueError(f"must name a table with a column `{name}`, but the columns of {path} are {there}")
        return Samples(columns[name], path)
    law = LAWS.get(call["name"])
    if law is None:
        raise ValueError(f"must be one of {', '.join((*LAWS, 'samples'))}, but is {call['name']!r}")
    arguments = [part.strip() for part in call["arguments"].split(",")]
    fields = _fields(law)
    if len(arguments) != len(fields):
        raise ValueError(f"must be {call['name']}({', '.join(fields)}), but is {briefly(text)}")
    dimensions: list[Dimension] = ["1" if field in law.shapes else dimension for field in fields]
    given = list(zip(arguments, dimensions, strict=True))
    # Everywhere else a bare number is in radians, but a law of 30 rad would pass for one of 30°.
    if not all(has_unit(argument) for argument, of in given if of == "angle"):
        spelled = ", ".join(f"{a}deg" if of == "angle" and not has_unit(a) else a for a, of in given)
        raise ValueError(f"must have units in its angles, such as {call['name']}({spelled}), but is {briefly(text)}")
    values = [read_quantity(argument, of, system) for argument, of in given]
    try:
        return law(*values)
    except ValueError as error:
        raise ValueError(f"must be a law, but is {text.strip()!r}: {str(error).rstrip('.')}") from error


def read_columns(
    path: str | Path, dimensions: Mapping[str, Dimension], system: System
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The columns of a table that are called as parameters, with their units, and the headings of the others.

    All rows are drawn alike, so a column that may say how often a row counts is refused.

    Args:
        path: of the table.
        dimensions: of the parameters, by name.
        system: the units of the result.

    Raises:
        ValueError: with a clause that starts with "must", for a column that may be a parameter, too, and for a row
            without a number.
    """
    try:
        table = tables.open_table(
            path, of_parameters(dimensions), refused=of_weights(), units=system, remedy="remove it"
        )
        for name, values in table.numbers.items():
            if not values.size:
                raise tables.TableError(f"{table.title}: has no rows.")
            if not (good := np.isfinite(values)).all():
                raise tables.TableError(f"{table.place(int(np.argmin(good)), name)} must have a finite number.")
    except tables.TableError as error:
        raise ValueError(f"must name a table that can be used, but {str(error).rstrip('.')}") from error
    return table.numbers, table.unused


def _fields(law: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(law)]
