"""How parameters vary: laws of one parameter, and of several together.

A law is a frozen distribution of `scipy.stats`, or any other object with `ppf(u)` and `cdf(x)`, such as `Samples`::

    from scipy import stats
    erosion.stream("rotating", p, alpha=stats.norm(0.35, 0.05), v0=stats.lognorm(0.1, scale=110))

Their numbers are in SI. As text, on the command line and in case files:

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
import itertools
import math
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special, stats

from erosion import tables
from erosion.arguments import NUMBERS, real_numbers, refuse
from erosion.output import briefly, digest
from erosion.parameters import QUANTITIES, Dimension, InSI, Quantity, System, has_unit, read_quantity, table_scale
from erosion.parameters.quantities import ascii_unit, unit_name
from erosion.results import Finding
from erosion.tables.headings import of_parameters, of_weights

Ranges = Mapping[str, tuple[float, float]]
"""By parameter, the greatest number below its range, and the greatest number of it."""

SHARE = (0.0, 1.0)
"""The range of the share of the particles that cut."""

MOST_OUTSIDE = 0.01
"""The share of a law outside of a parameter's range that is cut off without a word."""


@dataclasses.dataclass(frozen=True)
class RosinRammler:
    """Rosin and Rammler's law of ground solids, from what lies on sieves, for sizes by number.

    The share of the **mass** that is coarser than x is exp(-(x/scale)ⁿ). A stream counts
    particles, and a particle's mass goes with x³, so their number has the density
    x^(n-4) exp(-(x/scale)ⁿ): far more fines than Weibull's law of the same numbers. For n ≤ 3
    it has no finite total without a least size.

    Args:
        scale: the size of which 1/e of the mass is coarser, > 0.
        spread: n > 0; 1 is broad, 4 narrow.
        least: the finest size in the abrasive, > 0: the last sieve's.

    References:
        P. Rosin, E. Rammler, "The laws governing the fineness of powdered coal",
        J. Inst. Fuel 7 (1933), 29-36.
    """

    scale: float
    spread: float
    least: float

    def __post_init__(self) -> None:
        _require_numbers(dataclasses.asdict(self))
        if self.least >= self._greatest:
            raise ValueError(f"Argument `least` must be a size that some of the mass passes, but is {self.least:g}.")

    def ppf(self, u: np.ndarray) -> np.ndarray:
        """The size below which the share u of the particles lies."""
        sizes, shares = self._table
        return np.exp(np.interp(u, shares, sizes))

    def cdf(self, x: float) -> float:
        """The share of the particles below x."""
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
class Samples:
    """Measured values of one parameter, each as likely as the others.

    Args:
        values: of any shape.
        source: words for where they come from.

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

    def ppf(self, u: np.ndarray) -> np.ndarray:
        """The value below which the share u lies."""
        return self.values[np.minimum((u * len(self.values)).astype(int), len(self.values) - 1)]

    def cdf(self, x: float) -> float:
        """The share of the values up to x."""
        return float(np.searchsorted(self.values, x, side="right") / len(self.values))


@dataclasses.dataclass(frozen=True)
class NamedLaw:
    """A law that text can name; called with its numbers it makes the law.

    Args:
        family: makes the law of the numbers by keyword: a distribution of scipy, for example.
        keywords: by number of the text, in their order, the keyword; `end` is scipy's loc + scale.
    """

    family: Any
    keywords: Mapping[str, str]

    def __call__(self, *numbers: float) -> Any:
        """The law; a `ValueError` names the first number that makes none."""
        given = dict(zip(self.keywords, map(float, numbers), strict=True))
        _require_numbers(given, signed=[name for name, keyword in self.keywords.items() if keyword in ("loc", "end")])
        if given.get("low", -math.inf) >= given.get("high", math.inf):
            raise ValueError(f"Argument `low` must be less than `high`, {given['high']:g}, but is {given['low']:g}.")
        of = dict(zip(self.keywords.values(), given.values(), strict=True))
        if "end" in of:
            of["scale"] = of.pop("end") - of["loc"]
        return self.family(**of)

    def numbers(self, law: Any) -> list[float] | None:
        """The numbers of a law of this family; None for another one, and where text has no number for one of scipy's.

        Args:
            law: any.
        """
        described = _described(law)
        if described is None or described[0] != _name(self.family):
            return None
        of, used = described[1], {*self.keywords.values()}
        if (of["loc"] and "loc" not in used) or (of["scale"] != 1 and not used & {"scale", "end"}):
            return None
        return [of["loc"] + of["scale"] if keyword == "end" else of[keyword] for keyword in self.keywords.values()]


LAWS: Mapping[str, NamedLaw] = {
    "normal": NamedLaw(stats.norm, {"mean": "loc", "deviation": "scale"}),
    "lognormal": NamedLaw(stats.lognorm, {"median": "scale", "spread": "s"}),
    "uniform": NamedLaw(stats.uniform, {"low": "loc", "high": "end"}),
    "loguniform": NamedLaw(stats.loguniform, {"low": "a", "high": "b"}),
    "weibull": NamedLaw(stats.weibull_min, {"scale": "scale", "shape": "c"}),
    "rosin-rammler": NamedLaw(RosinRammler, {"scale": "scale", "spread": "spread", "least": "least"}),
}
"""The laws by the names that text uses."""

_PURE = ("spread", "shape")  # numbers of `LAWS` without the parameter's unit


def _require_numbers(numbers: Mapping[str, Any], signed: Collection[str] = ()) -> None:
    """Refuse numbers that are not finite, or, but for `signed` ones, not positive."""
    for name, value in numbers.items():
        if not isinstance(value, NUMBERS):
            raise TypeError(f"Argument `{name}` must be a number, but is {briefly(value)}.")
        if not math.isfinite(value) or (value <= 0 and name not in signed):
            wish = "finite" if name in signed else "positive and finite"
            raise ValueError(f"Argument `{name}` must be {wish}, but is {value:g}.")


def _name(family: Any) -> str:
    return getattr(family, "name", None) or family.__name__


def _described(law: Any) -> tuple[str, dict[str, float]] | None:
    """The family of a law and its numbers by keyword, where these say all of it; None for other laws."""
    family = getattr(law, "dist", None)
    if isinstance(law, RosinRammler):
        family, given = RosinRammler, {**dataclasses.asdict(law), "loc": 0.0}
    # A distribution of somebody's own may hold more than its numbers.
    elif family is None or type(getattr(stats, str(family.name), None)) is not type(family):
        return None
    else:
        keywords = [*(family.shapes or "").replace(",", " ").split(), "loc", "scale"]
        of = {"loc": 0.0, "scale": 1.0, **dict(zip(keywords, law.args, strict=False)), **law.kwds}
        given = {keyword: of[keyword] for keyword in keywords}
    return _name(family), {keyword: float(np.asarray(number).item()) for keyword, number in given.items()}


def is_law(thing: Any) -> bool:
    """Whether it is a law of one parameter."""
    return hasattr(thing, "ppf") and hasattr(thing, "cdf")


def law_in_words(law: Any, dimension: Dimension = "1", system: System = "si") -> str:
    """A law as a person reads it: "normal(20°, 3°)"; laws that text does not name have scipy's name and numbers.

    Other laws have the name of their type and their digest.

    Args:
        law: of one parameter.
        dimension: of the parameter.
        system: the unit system that shows the law's numbers.
    """
    if isinstance(law, Samples):
        return f"{len(law.values):,} values of {law.source}"
    if (text := _as_text(law, lambda number, of: _readable(number, of, system), dimension)) is not None:
        return text
    described = _described(law)
    if described is None:
        # Words that are the same in each process; a frozen distribution is that which it freezes.
        return f"{type(getattr(law, 'dist', law)).__name__} {law_digest(law)}"
    usual = {("loc", 0.0), ("scale", 1.0)}
    numbers = [f"{keyword}={number:.5g}" for keyword, number in described[1].items() if (keyword, number) not in usual]
    return f"{described[0]}({', '.join(numbers)})"


def law_as_typed(law: Any, dimension: Dimension) -> str:
    """The text from which `read_law` makes a law again, to nine digits; empty for a law that text does not name.

    Args:
        law: of one parameter.
        dimension: of the parameter.
    """
    if isinstance(law, Samples):
        return f"samples({law.source})"

    def typed(number: float, of: Dimension) -> str:
        return f"{number:.9g} {ascii_unit(unit_name(of, 'si')).removeprefix('1')}".rstrip()

    return _as_text(law, typed, dimension) or ""


def _readable(number: float, dimension: Dimension, system: System) -> str:
    scale = table_scale(dimension, system, abs(number))
    return scale.beside(f"{number / scale.size:.5g}")


def _as_text(law: Any, written: Callable[[float, Dimension], str], dimension: Dimension) -> str | None:
    """A law that text names, such as "normal(20°, 3°)", each number as `written`; None for others."""
    for name, named in LAWS.items():
        if (numbers := named.numbers(law)) is not None:
            of: list[Dimension] = ["1" if parameter in _PURE else dimension for parameter in named.keywords]
            return f"{name}({', '.join(map(written, numbers, of))})"
    return None


_PLACES = 4096  # of the inverse distribution, which tell laws apart


def law_digest(law: Any) -> str:
    """The digest of a law: of its family and numbers, of its samples, or of somebody's own law at fixed points.

    Args:
        law: of one parameter.
    """
    if isinstance(law, Samples):
        return digest(law.values.tobytes())
    if (described := _described(law)) is not None:
        return digest(repr(described).encode())
    # Evenly, and ever nearer to both ends.
    even, tail = (np.arange(_PLACES) + 0.5) / _PLACES, np.logspace(-15.9, -3.0, 200)
    values = np.asarray(law.ppf(np.concatenate([even, tail, 1 - tail])), float)
    # A law is cut off at the ends of a parameter's range, by the share that lies below.
    places = np.linspace(-1.5, 1.5, 61) * np.abs(values[:_PLACES]).max()
    shares = np.array([float(law.cdf(value)) for value in (0.0, 1.0, *places.tolist())])
    return digest(values.tobytes() + shares.tobytes())


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class JointSamples:
    """Samples of several parameters, drawn together: all parameters of a particle come from one row of a table.

    Args:
        columns: by parameter, its values [SI], all of the same shape (samples,) or with the same number of values:
            measured impacts, or draws of a posterior (`Posterior.joint_samples`).
        source: words for the table.
        unused: the heads of other columns of the table.
        tested: of a fit's draws, the least and the greatest "alpha" [rad] of its rows, and so on; see `Tested`.

    Raises:
        TypeError: for columns that are no mapping.
        ValueError: for columns that differ in length, or values that are not finite.
    """

    columns: Mapping[str, Any]
    source: str = "a table"
    unused: tuple[str, ...] = ()
    tested: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict[str, tuple[float, float]])

    def __post_init__(self) -> None:
        if not isinstance(self.columns, Mapping):
            raise TypeError(f"Argument `columns` must be arrays by parameter, but is {briefly(self.columns)}.")
        columns = {}
        for name, values in self.columns.items():
            columns[name] = real_numbers(name, values).reshape(-1)
            if not columns[name].size or not np.isfinite(columns[name]).all():
                raise ValueError(f"Argument `columns` must give {name} finite numbers, one or more, but does not.")
        lengths = {name: len(values) for name, values in columns.items()}
        if len({*lengths.values()}) != 1:
            listed = ", ".join(f"{name} {length}" for name, length in lengths.items()) or "none"
            raise ValueError(f"Argument `columns` must be of one length, but lengths are {listed}.")
        object.__setattr__(self, "columns", columns)

    def __repr__(self) -> str:
        return f"JointSamples({self.source}: {', '.join(self.columns)}; {self._count:,} samples)"

    @property
    def _count(self) -> int:
        return len(next(iter(self.columns.values())))

    def draw(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Values by name, from a uniform number in (0, 1) for each row, of any shape."""
        row = np.minimum((points * self._count).astype(int), self._count - 1)
        return {name: values[row] for name, values in self.columns.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class JointLaw:
    """The laws of several parameters, drawn together.

    A correlation ties laws by a Gaussian copula: each parameter keeps its law, and normal scores are correlated.

    Args:
        laws: by parameter.
        correlation: ρ of the normal scores, by pairs of parameters of `laws`, in (-1, 1); other pairs have 0.
            Spearman's correlation of the parameters is (6/π) asin(ρ/2), some hundredths less.
        samples: of other parameters; those of a table are drawn together.
        ranges: of the parameters, see `within`; None for any parameters without a range.
        argument: what messages call the law of a parameter.

    Raises:
        TypeError, ValueError: for what is no law, pairs that are not of `laws`, and correlations that no laws can have.
    """

    laws: Mapping[str, Any] = dataclasses.field(default_factory=dict[str, Any])
    correlation: Mapping[tuple[str, str], float] = dataclasses.field(default_factory=dict[tuple[str, str], float])
    samples: tuple[JointSamples, ...] = ()
    ranges: Ranges | None = None
    argument: str = "`{}`"

    def __post_init__(self) -> None:
        for name, law in self.laws.items():
            argument = f"Argument {self.argument.format(name)}"
            if not is_law(law):
                raise TypeError(f"{argument} must be a law such as scipy.stats.norm(1, 0.1), but is {briefly(law)}.")
            middle = np.asarray(law.ppf(np.array([0.5])), float)
            if middle.shape != (1,) or not np.isfinite(middle[0]):
                raise ValueError(f"{argument} must be a law with one finite number for each share, but is not.")
        given = [*self.laws]
        for table in self.samples:
            if both := [name for name in table.columns if name in given]:
                raise ValueError(f"Argument `samples` must give {both[0]} alone, but {both[0]} has another law, too.")
            given += table.columns
        pairs = {*itertools.permutations(self.laws, 2)}
        if strange := [pair for pair in self.correlation if pair not in pairs]:
            names = ", ".join(self.laws)
            raise ValueError(f"Argument `correlation` must name pairs of {names}, but has {briefly(strange[0])}.")
        for pair, value in self.correlation.items():
            refuse(
                "Argument `correlation` must ",
                (pair[::-1] in self.correlation, f"give {' and '.join(pair)} once, but gives them twice."),
                (not isinstance(value, NUMBERS) or not -1 < value < 1,
                 f"be in (-1, 1), but is {briefly(value)} for {' and '.join(pair)}."),
            )  # fmt: skip
        if any(np.linalg.eigvalsh(self._matrix(group)).min() < 1e-9 for group in self._groups):
            raise ValueError("Argument `correlation` must be possible: these pairs contradict each other.")

    def within(self, ranges: Ranges) -> "JointLaw":
        """The same restricted to the ranges of the parameters.

        Args:
            ranges: of all parameters that can have a law; see `erosion.models.ranges`.

        Raises:
            TypeError, ValueError: for the law of another parameter, and one of which more than 1 % is out of range;
                less is cut off. Samples that are drawn together are taken as they are, so none may be out of range.
        """
        if strange := [name for name in self.names if name not in ranges]:
            argument = self.argument.format(strange[0])
            raise TypeError(f"Argument {argument} is not a parameter; they are {', '.join(ranges)}.")
        bound = dataclasses.replace(self, ranges=ranges)
        for name, (low, high) in bound._parts.items():
            outside, (least, greatest) = low + 1 - high, ranges[name]
            if outside > (MOST_OUTSIDE if name in self.laws else 0.0):
                wish = "positive" if least == 0 else f"at least {np.nextafter(least, np.inf) + 0.0:g}"
                wish += "" if greatest == np.inf else f" and at most {greatest:g}"
                law = law_in_words(self.marginals[name])
                raise ValueError(
                    f"Argument {self.argument.format(name)} must be {wish}, but {outside:.1%} of {law} is not."
                )
        return bound

    def only(self, names: Collection[str]) -> "JointLaw":
        """The same without the laws of other parameters."""
        kept = [{name: values for name, values in table.columns.items() if name in names} for table in self.samples]
        return dataclasses.replace(
            self,
            laws={name: law for name, law in self.laws.items() if name in names},
            correlation={pair: value for pair, value in self.correlation.items() if {*pair} <= {*names}},
            samples=tuple(
                dataclasses.replace(table, columns=columns)
                for table, columns in zip(self.samples, kept, strict=True)
                if columns
            ),
        )

    @functools.cached_property
    def marginals(self) -> dict[str, Any]:
        """The law of each parameter where the others are not looked at."""
        columns = [(table.source, *item) for table in self.samples for item in table.columns.items()]
        return {**self.laws, **{name: Samples(values, source) for source, name, values in columns}}

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters."""
        return tuple(self.marginals)

    def __bool__(self) -> bool:
        return bool(self.names)

    @functools.cached_property
    def _groups(self) -> list[tuple[str, ...]]:
        """The parameters that are correlated, those of one group with each other."""
        groups: list[tuple[str, ...]] = []
        for pair in self.correlation:
            tied = [group for group in groups if {*group} & {*pair}]
            merged = tuple(dict.fromkeys(itertools.chain(*tied, pair)))
            groups = [*(group for group in groups if group not in tied), merged]
        return groups

    def _matrix(self, names: tuple[str, ...]) -> np.ndarray:
        """The correlation of the normal scores, shape (names, names)."""
        matrix = np.eye(len(names))
        for (first, second), value in self.correlation.items():
            if first in names:
                i, j = names.index(first), names.index(second)
                matrix[i, j] = matrix[j, i] = value
        return matrix

    @functools.cached_property
    def inputs(self) -> dict[tuple[str, ...], int]:
        """The parameters of each independent input, and how many uniform numbers it takes."""
        tied = {*itertools.chain(*self._groups)}
        return {
            **{(name,): 1 for name in self.laws if name not in tied},
            **{group: len(group) for group in self._groups},
            **{tuple(table.columns): 1 for table in self.samples},
        }

    @property
    def dimension(self) -> int:
        """How many uniform numbers all parameters together are made from."""
        return sum(self.inputs.values())

    def draw(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Values by name, shape (…), from uniform numbers in (0, 1), shape (…, dimension)."""
        parts = np.split(points, np.cumsum([*self.inputs.values()])[:-1], axis=-1)
        points_of = dict(zip(self.inputs, parts, strict=False))  # of no law there is an empty part
        values = {}
        for table in self.samples:
            values |= table.draw(points_of.pop(tuple(table.columns))[..., 0])
        for names, shares in points_of.items():
            if len(names) > 1:
                shares = special.ndtr(special.ndtri(shares) @ np.linalg.cholesky(self._matrix(names)).T)
            values |= {name: self._quantile(name, shares[..., i]) for i, name in enumerate(names)}
        return values

    @property
    def medians(self) -> dict[str, np.ndarray]:
        """Each parameter at the median of its law, shape (1,)."""
        return {name: self._quantile(name, np.array([0.5])) for name in self.names}

    def _quantile(self, name: str, share: np.ndarray) -> np.ndarray:
        """The value of one law at a share of the part in range."""
        low, high = self._parts[name]
        return np.asarray(self.marginals[name].ppf(low + (high - low) * share), float)

    @functools.cached_property
    def _parts(self) -> dict[str, tuple[float, float]]:
        """By parameter, from which share of its law to which it is within its range."""
        parts = {}
        for name, law in self.marginals.items():
            below, greatest = (-np.inf, np.inf) if self.ranges is None else self.ranges[name]
            low = 0.0 if below == -np.inf else float(law.cdf(below))
            parts[name] = (low, 1.0 if greatest == np.inf else float(law.cdf(greatest)))
        return parts

    def in_words(self, quantities: Mapping[str, Quantity], system: System) -> dict[str, str]:
        """By parameter its law as a person reads it: "normal(20°, 3°), correlated: alpha with v0 by 0.5".

        Args:
            quantities: of the parameters; those of others are pure numbers.
            system: the unit system that shows the laws' numbers.
        """
        words = {}
        for name, law in self.marginals.items():
            words[name] = law_in_words(law, quantities[name].dimension if name in quantities else "1", system)
        for group in self._groups:
            pairs = [f"{first} with {second} by {value:g}"
                     for (first, second), value in self.correlation.items() if first in group]  # fmt: skip
            words |= {name: f"{words[name]}, correlated: {', '.join(pairs)}" for name in group}
        for table in self.samples:
            words |= {name: f"{words[name]}, row by row of {', '.join(table.columns)}" for name in table.columns}
        return words

    @property
    def digest(self) -> str:
        """The digest of all laws, and of what ties them together."""
        parts = [*((name, law_digest(law)) for name, law in self.laws.items()), *self.correlation.items()]
        parts += [(*table.columns, digest(b"".join(values.tobytes() for values in table.columns.values())))
                  for table in self.samples]  # fmt: skip
        return digest(repr(parts).encode())

    @property
    def unused_columns(self) -> list[Finding]:
        """Findings on columns of tables that are not used."""
        return [Finding("unused_columns", str(table.source), {"columns": table.unused})
                for table in self.samples if table.unused]  # fmt: skip

    @property
    def columns_apart(self) -> list[Finding]:
        """Findings on tables of which several columns are drawn, each by itself."""
        names: dict[str, list[str]] = {}
        for name, law in self.laws.items():
            if isinstance(law, Samples):
                names.setdefault(law.source, []).append(name)
        return [Finding("columns_apart", source, {"columns": of}) for source, of in names.items() if len(of) > 1]


def joint_law(
    laws: Any,
    argument: str = "laws",
    correlation: Mapping[tuple[str, str], float] | None = None,
    samples: JointSamples | Mapping[str, Any] | None = None,
    known: Mapping[str, Quantity] = QUANTITIES,
    shown_in: System = "si",
) -> JointLaw:
    """The joint law [SI] of what an argument may be: a mapping of laws, samples, a joint law, or None for no law.

    Args:
        laws: the argument.
        argument: its name.
        correlation: see `JointLaw`.
        samples: of other parameters, drawn together; arrays by parameter.
        known: see `refuse_laws`.
        shown_in: the same.

    Raises:
        TypeError, ValueError: for what is none of these.
    """
    if isinstance(laws, JointLaw | JointSamples):
        for name, value in (("correlation", correlation), ("samples", samples)):
            if value is not None:
                kind = type(laws).__name__
                raise ValueError(f"Argument `{name}` must be left out where `{argument}` is a {kind}.")
        return laws if isinstance(laws, JointLaw) else JointLaw(samples=(laws,))
    refuse(
        "Argument ",
        (not isinstance(laws, Mapping | None),
         f"`{argument}` must be a mapping of parameters to laws, but is {briefly(laws)}."),
        (not isinstance(correlation, Mapping | None),
         f"`correlation` must be a mapping of pairs to numbers, but is {briefly(correlation)}."),
        (not isinstance(samples, JointSamples | Mapping | None),
         f"`samples` must be arrays by parameter, but is {briefly(samples)}."),
        kind=TypeError,
    )  # fmt: skip
    for bare in (laws, samples):
        if isinstance(bare, Mapping):
            refuse_laws(bare, known, shown_in)
    together = JointSamples(samples, "samples") if isinstance(samples, Mapping) else samples
    return JointLaw(laws or {}, correlation or {}, () if together is None else (together,))


def refuse_laws(laws: Mapping[str, Any], known: Mapping[str, Quantity], shown_in: System) -> None:
    """Refuse laws and samples of quantities that have other units beside a case in these; those of an `InSI` pass.

    Args:
        laws: by parameter.
        known: the quantities; laws of other parameters are not looked at.
        shown_in: the unit system that shows the case.

    Raises:
        ValueError: naming the first, and the line to type.
    """
    for name in laws if not isinstance(laws, InSI) else ():
        if name in known and known[name].size(shown_in) != 1:
            raise ValueError(
                f"Argument `{name}` must come with a case that is shown in SI, as laws and samples are in SI, but the "
                f'case is shown in {shown_in} units: give `p.to("si")`.'
            )


_CALL = re.compile(r"\s*(?P<name>[a-z-]+)\s*\((?P<arguments>.*)\)\s*", re.DOTALL)


def numbers_with_unit(text: str) -> list[str]:
    """The numbers of a law as text that are in the parameter's unit: all but spreads and shapes; none of samples."""
    call = _CALL.fullmatch(text)
    named = None if call is None else LAWS.get(call["name"])
    if call is None or named is None:
        return []
    return [number for number, keyword in zip(call["arguments"].split(","), named.keywords, strict=False)
            if keyword not in _PURE]  # fmt: skip


def read_law(text: str, name: str, dimension: Dimension, bare: System = "si") -> Any:
    """A law [SI] from text such as "normal(20deg, 3deg)"; None where the text is no such call.

    Args:
        text: as in the module's description.
        name: the parameter, which names the column of a file of samples.
        dimension: of the parameter.
        bare: the unit system of bare numbers.

    Raises:
        ValueError: with a clause that starts with "must", to follow the parameter's name.
    """
    call = _CALL.fullmatch(text)
    if call is None:
        return None
    if call["name"] == "samples":
        path = call["arguments"].strip()
        columns, unused = _read_columns(path, {name: dimension})
        if name not in columns:
            there = briefly(", ".join([*columns, *unused]))
            raise ValueError(f"must name a table with a column `{name}`, but the columns of {path} are {there}")
        return Samples(columns[name], path)
    named = LAWS.get(call["name"])
    if named is None:
        raise ValueError(f"must be one of {', '.join((*LAWS, 'samples'))}, but is {call['name']!r}")
    arguments = [part.strip() for part in call["arguments"].split(",")]
    if len(arguments) != len(named.keywords):
        raise ValueError(f"must be {call['name']}({', '.join(named.keywords)}), but is {briefly(text)}")
    dimensions: list[Dimension] = ["1" if parameter in _PURE else dimension for parameter in named.keywords]
    given = list(zip(arguments, dimensions, strict=True))
    # Everywhere else a bare number is in radians, but a law of 30 rad would pass for one of 30°.
    if not all(has_unit(argument) for argument, of in given if of == "angle"):
        spelled = ", ".join(f"{a}deg" if of == "angle" and not has_unit(a) else a for a, of in given)
        raise ValueError(f"must have units in its angles, such as {call['name']}({spelled}), but is {briefly(text)}")
    values = [read_quantity(argument, of, bare) for argument, of in given]
    try:
        return named(*values)
    except ValueError as error:
        raise ValueError(f"must be a law, but is {text.strip()!r}: {str(error).rstrip('.')}") from error


def read_samples(path: str | Path, quantities: Mapping[str, Quantity]) -> JointSamples:
    """The columns of a table that bear names of parameters, with their units: "alpha [deg], v0 [m/s]".

    Args:
        path: of the file.
        quantities: what parameters there are.

    Raises:
        ValueError: with a clause that starts with "must".
    """
    columns, unused = _read_columns(path, {name: quantity.dimension for name, quantity in quantities.items()})
    if not columns:
        raise ValueError(f"must have columns of parameters in {path}, such as `alpha [deg]`, but has none")
    return JointSamples(columns, str(path), unused=unused)


def _read_columns(
    path: str | Path, dimensions: Mapping[str, Dimension]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The columns of a table that are called as parameters, with their units, and the headings of the others.

    All rows are drawn alike, so a column that may say how often a row counts is refused.

    Args:
        path: of the table.
        dimensions: of the parameters, by name.

    Raises:
        ValueError: with a clause that starts with "must", for a column that may be a parameter, too, and for a row
            without a number.
    """
    try:
        table = tables.open_table(path, of_parameters(dimensions), refused=of_weights(), remedy="remove it")
        for name, values in table.numbers.items():
            if not values.size:
                raise tables.TableError(f"{table.title}: has no rows.")
            if not (good := np.isfinite(values)).all():
                raise tables.TableError(f"{table.place(int(np.argmin(good)), name)} must have a finite number.")
    except tables.TableError as error:
        raise ValueError(f"must name a table that can be used, but {str(error).rstrip('.')}") from error
    return table.numbers, table.unused
