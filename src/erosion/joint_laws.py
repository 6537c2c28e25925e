"""How several parameters vary together: laws with a correlation, and rows of a table.

A joint law is a mapping of parameters to laws, which is given to a stream or a map as such::

    erosion.stream("rotating", p, **Rows({"alpha": angles, "v0": speeds}))
    laws = {"v0": LogNormal(4400, 0.1), "r": Normal(0.04, 0.004)}
    erosion.stream("rotating", p, **CorrelatedLaws(laws, {("v0", "r"): -0.5}))
    erosion.erosion_map("rotating", p, impacts, surface, uncertain=posterior.rows_of_draws())
"""

import abc
import dataclasses
import functools
import hashlib
import types
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from erosion.arguments import real_numbers, refuse
from erosion.distributions import MOST_OUTSIDE, Distribution, OfScipy, Samples, as_laws, read_columns
from erosion.output import briefly, digest
from erosion.parameters import Dimension, Quantity, System
from erosion.results import Finding

Ranges = Mapping[str, tuple[float, float]]
"""By parameter, the greatest number below its range, and the greatest number of it."""

SHARE = (0.0, 1.0)
"""The range of the share of the particles that cut."""

_DRAWN = 4096  # draws that tell laws apart


class JointLaw(Mapping[str, Any], abc.ABC):
    """Parameters that vary together, by name; each has a law of its own, the marginal one."""

    @property
    @abc.abstractmethod
    def marginals(self) -> Mapping[str, Distribution]:
        """The law of each parameter where the others are not looked at."""

    @property
    @abc.abstractmethod
    def dimension(self) -> int:
        """How many uniform numbers all parameters together are made from."""

    @abc.abstractmethod
    def draw(self, points: np.ndarray, parts: Ranges) -> dict[str, np.ndarray]:
        """The parameters of particles.

        Args:
            points: uniform numbers in (0, 1), shape (…, dimension).
            parts: by parameter, from which share to which its marginal law is taken; the rest is cut off.

        Returns:
            Values by name, shape (…).
        """

    @property
    @abc.abstractmethod
    def words(self) -> str:
        """What ties the parameters together."""

    def __getitem__(self, name: str) -> Any:
        _ = self.marginals[name]  # a `KeyError` for another name
        return Member(self, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.marginals)

    def __len__(self) -> int:
        return len(self.marginals)


@dataclasses.dataclass(frozen=True, eq=False)
class Member(Distribution):
    """The law of one parameter of several that vary together.

    Args:
        joint: of all of them.
        name: of the parameter.
    """

    joint: JointLaw
    name: str

    def __post_init__(self) -> None:
        """Nothing to check: the joint law is checked."""

    def __str__(self) -> str:
        return f"{self._marginal}, {self.joint.words}"

    def in_words(self, dimension: Dimension, system: System) -> str:
        """The marginal law, and what ties it to others."""
        return f"{self._marginal.in_words(dimension, system)}, {self.joint.words}"

    def ppf(self, u: np.ndarray) -> np.ndarray:
        """Of the marginal law."""
        return self._marginal.ppf(u)

    def cdf(self, x: float) -> float:
        """Of the marginal law."""
        return self._marginal.cdf(x)

    @property
    def _marginal(self) -> Distribution:
        return self.joint.marginals[self.name]


@dataclasses.dataclass(frozen=True, eq=False)
class Rows(JointLaw):
    """Rows of a table, each as likely as the others: all parameters of a particle come from one row.

    Args:
        columns: by parameter, its values, all of the same shape (rows,) or with the same number of values: measured
            impacts, or draws of a posterior (`Posterior.rows_of_draws`).
        source: words for the table.
        units: the unit system of the values; a case in another one refuses them. Without it they are the case's.
        unused: the heads of other columns of the table.
        tested: of a fit's draws, the least and the greatest "alpha" [rad] of its rows, and so on; see `Tested`.

    Raises:
        ValueError: for columns that differ in length, or values that are not finite.
    """

    columns: Mapping[str, Any]
    source: str = "a table"
    units: System | None = None
    unused: tuple[str, ...] = ()
    tested: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict[str, tuple[float, float]])

    def __post_init__(self) -> None:
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
        checksum = hashlib.sha256(b"".join(values.tobytes() for values in self.columns.values())).hexdigest()[:8]
        return f"Rows({self.source}: {', '.join(self.columns)}; {self._count:,} rows, {checksum})"

    @property
    def marginals(self) -> Mapping[str, Distribution]:
        """The values of each column."""
        return self._sorted

    @functools.cached_property
    def _sorted(self) -> dict[str, Samples]:
        return {name: Samples(values, self.source) for name, values in self.columns.items()}

    @property
    def dimension(self) -> int:
        """One number chooses the row."""
        return 1

    def draw(self, points: np.ndarray, parts: Ranges) -> dict[str, np.ndarray]:
        """Values by name; see `JointLaw.draw`. Rows are taken as they are."""
        row = np.minimum((points[..., 0] * self._count).astype(int), self._count - 1)
        return {name: values[row] for name, values in self.columns.items()}

    @property
    def words(self) -> str:
        """The columns."""
        return f"row by row of {', '.join(self.columns)}"

    @property
    def _count(self) -> int:
        return len(next(iter(self.columns.values())))


@dataclasses.dataclass(frozen=True, eq=False)
class CorrelatedLaws(JointLaw):
    """Laws tied by a Gaussian copula: each parameter keeps its law, and normal scores are correlated.

    Args:
        laws: by parameter.
        correlation: ρ of the normal scores, by pairs of parameters, in (-1, 1); pairs that are not given have 0.
            Spearman's correlation of the parameters is (6/π) asin(ρ/2), some hundredths less.

    Raises:
        ValueError: for pairs that are not of the laws, or correlations that no laws can have.
    """

    laws: Mapping[str, Any]
    correlation: Mapping[tuple[str, str], float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "laws", as_laws(self.laws))
        for pair, value in self.correlation.items():
            refuse(
                "Argument `correlation` must ",
                (len(pair) != 2 or pair[0] == pair[1] or not {*pair} <= {*self.laws},
                 f"name pairs of {', '.join(self.laws)}, but has {briefly(pair)}."),
                (pair[::-1] in self.correlation, f"give {' and '.join(pair)} once, but gives them twice."),
                (not -1 < value < 1, f"be in (-1, 1), but is {briefly(value)} for {' and '.join(pair)}."),
            )  # fmt: skip
        if np.linalg.eigvalsh(self.matrix).min() < 1e-9:
            raise ValueError("Argument `correlation` must be possible: these pairs contradict each other.")
        for name, law in self.laws.items():
            if not isinstance(law, Distribution) or isinstance(law, Member):
                raise TypeError(
                    f"Argument `laws` must give {name} a distribution such as Normal(1, 0.1), but is {briefly(law)}."
                )

    @property
    def matrix(self) -> np.ndarray:
        """The correlation of the normal scores, shape (laws, laws)."""
        names, matrix = list(self.laws), np.eye(len(self.laws))
        for (first, second), value in self.correlation.items():
            i, j = names.index(first), names.index(second)
            matrix[i, j] = matrix[j, i] = value
        return matrix

    @property
    def marginals(self) -> Mapping[str, Distribution]:
        """The laws."""
        return self.laws

    @property
    def dimension(self) -> int:
        """A number for each parameter."""
        return len(self.laws)

    def draw(self, points: np.ndarray, parts: Ranges) -> dict[str, np.ndarray]:
        """Values by name; see `JointLaw.draw`."""
        scores = special.ndtri(points) @ np.linalg.cholesky(self.matrix).T
        shares = special.ndtr(scores)
        values = {}
        for i, (name, law) in enumerate(self.laws.items()):
            low, high = parts[name]
            values[name] = law.ppf(low + (high - low) * shares[..., i])
        return values

    @property
    def words(self) -> str:
        """The pairs."""
        pairs = ", ".join(f"{first} with {second} by {value:g}" for (first, second), value in self.correlation.items())
        return f"correlated: {pairs}"


def _joint_of(law: Any) -> JointLaw | None:
    return law.joint if isinstance(law, Member) else None


def law_digest(law: Any) -> str:
    """The digest of a law: of its numbers and, where it is somebody's own, of its draws, whatever its code looks like.

    Args:
        law: a `Distribution`, or a law of somebody's own with `ppf` and `cdf`.
    """
    # Of a law of the package its class says the rest.
    if type(law).__module__ == Distribution.__module__ and not isinstance(law, OfScipy):
        return digest(b"".join([type(law).__name__.encode(), *_numbers_of(law, ())]))
    joint = _joint_of(law)
    dimension = 1 if joint is None else joint.dimension
    # Evenly, at random for several parameters together, and ever nearer to both ends.
    even = np.repeat((np.arange(_DRAWN)[:, None] + 0.5) / _DRAWN, dimension, axis=1)
    random = np.random.default_rng(0).uniform(2.0**-53, 1 - 2.0**-53, (_DRAWN, dimension))
    tail = np.repeat(np.logspace(-15.9, -3.0, 200)[:, None], dimension, axis=1)
    points = np.concatenate([even, random, tail, 1 - tail])
    own = np.asarray(law.ppf(points[:, 0]), float)
    # A stream cuts laws off at the ends of a parameter's range, by the share that lies below.
    places = np.linspace(-1.5, 1.5, 61) * np.abs(own[:_DRAWN]).max()
    shares = np.array([float(law.cdf(value)) for value in (0.0, 1.0, *places.tolist())])
    drawn = {} if joint is None else joint.draw(points, dict.fromkeys(joint, (0.0, 1.0)))
    pieces = [own, shares, *drawn.values()]
    return digest(b"".join([*(np.ascontiguousarray(piece).tobytes() for piece in pieces), *_numbers_of(law, ())]))


def _numbers_of(thing: Any, within: Collection[int]) -> Iterator[bytes]:
    """The numbers that a law holds, in its attributes, in what its functions hold, and in theirs."""
    if id(thing) in within:
        return
    within = {*within, id(thing)}
    if isinstance(thing, (np.ndarray, np.generic, int, float)) and not isinstance(thing, bool):
        array = np.asarray(thing)
        yield f"{array.dtype.str} {array.shape}".encode() + array.tobytes()
    named: Mapping[Any, Any] = thing if isinstance(thing, Mapping) and not isinstance(thing, JointLaw) else {}
    parts: Iterable[Any] = thing if isinstance(thing, (list, tuple)) else ()
    if isinstance(thing, types.FunctionType):
        parts = [cell.cell_contents for cell in thing.__closure__ or ()]
    elif dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        # Not what it has computed and keeps.
        parts = [getattr(thing, field.name, None) for field in dataclasses.fields(thing)]
    elif isinstance(thing, Distribution):
        slots = [name for one in type(thing).__mro__ for name in vars(one).get("__slots__", ())]
        parts = [getattr(thing, name, None) for name in (*vars(thing), *slots)]
    for name, part in (*named.items(), *(("", part) for part in parts)):
        yield str(name).encode()
        yield from _numbers_of(part, within)


def unused_columns(laws: Mapping[str, Any]) -> list[Finding]:
    """Findings on columns of tables that are not used."""
    tables = {
        rows.source: rows.unused for rows in map(_joint_of, laws.values()) if isinstance(rows, Rows) and rows.unused
    }
    return [Finding("unused_columns", str(source), {"columns": unused}) for source, unused in tables.items()]


def columns_apart(laws: Mapping[str, Any]) -> list[Finding]:
    """Findings on tables of which several columns are drawn, each by itself."""
    names: dict[str, list[str]] = {}
    for name, law in laws.items():
        if isinstance(law, Samples):
            names.setdefault(law.source, []).append(name)
    return [Finding("columns_apart", str(source), {"columns": of}) for source, of in names.items() if len(of) > 1]


def require_units(laws: Mapping[str, Any], units: System) -> None:
    """Refuse rows in other units than those of the case that takes them.

    Raises:
        ValueError: naming the rows.
    """
    for rows in map(_joint_of, laws.values()):
        if isinstance(rows, Rows) and rows.units not in (None, units):
            raise ValueError(f"The rows of {rows.source} are in {rows.units}, but the case is in {units}.")


@dataclasses.dataclass(frozen=True)
class LawSet:
    """Laws of parameters, single and joint ones, drawn together.

    Args:
        laws: by parameter, its `Distribution`; those of a joint law all together. Each is restricted to the range of
            its parameter.
        ranges: of the parameters that there are; see `erosion.models.ranges`.
        argument: what messages call the law of a parameter.

    Raises:
        TypeError, ValueError: naming the first law that makes no sense.
    """

    laws: Mapping[str, Any]
    ranges: Ranges
    argument: str = "`{}`"

    def __post_init__(self) -> None:
        for name, law in self.laws.items():
            argument = f"Argument {self.argument.format(name)}"
            if name not in self.ranges:
                raise TypeError(f"{argument} is not a parameter; they are {', '.join(self.ranges)}.")
            if not isinstance(law, Distribution):
                raise TypeError(f"{argument} must be a distribution such as Normal(1, 0.1), but is {briefly(law)}.")
            joint, (low, high), (least, greatest) = _joint_of(law), self._part(name), self.ranges[name]
            # A row is taken as it is; of a law, what is out of range can be cut off.
            if low + 1 - high > (0.0 if isinstance(joint, Rows) else MOST_OUTSIDE):
                wish = "positive" if least == 0 else f"at least {np.nextafter(least, np.inf) + 0.0:g}"
                wish += "" if greatest == np.inf else f" and at most {greatest:g}"
                alone = law if joint is None else joint.marginals[name]
                raise ValueError(f"{argument} must be {wish}, but {low + 1 - high:.1%} of {alone} is not.")
            if missing := [other for other in joint or () if other not in self.laws]:
                raise ValueError(f"Arguments must include all of a joint law, but {missing[0]} is missing.")

    @functools.cached_property
    def _joints(self) -> list[JointLaw]:
        """The joint laws, each once."""
        joints = {id(joint): joint for law in self.laws.values() if (joint := _joint_of(law)) is not None}
        return [*joints.values()]

    @functools.cached_property
    def inputs(self) -> dict[tuple[str, ...], int]:
        """What varies independently of all else: the parameters of a law or a joint law, and its uniform numbers."""
        alone = {(name,): 1 for name, law in self.laws.items() if not isinstance(law, Member)}
        return alone | {tuple(joint): joint.dimension for joint in self._joints}

    @property
    def dimension(self) -> int:
        """How many uniform numbers all parameters together are made from."""
        return sum(self.inputs.values())

    def draw(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Values by name, shape (…), from uniform numbers in (0, 1), shape (…, dimension)."""
        values, joints = {}, {tuple(joint): joint for joint in self._joints}
        parts = np.split(points, np.cumsum([*self.inputs.values()])[:-1], axis=-1)
        for names, part in zip(self.inputs, parts, strict=False):  # of no law there is an empty part
            if names in joints:
                values |= joints[names].draw(part, {name: self._part(name) for name in names})
            else:
                values[names[0]] = self._value(names[0], part[..., 0])
        return values

    @property
    def middle(self) -> dict[str, np.ndarray]:
        """Each parameter at the median of its law, shape (1,)."""
        return {name: self._value(name, np.array([0.5])) for name in self.laws}

    def _value(self, name: str, share: np.ndarray) -> np.ndarray:
        """The value of one law at a share of the part in range."""
        low, high = self._part(name)
        return self.laws[name].ppf(low + (high - low) * share)

    def _part(self, name: str) -> tuple[float, float]:
        """From which share of a law to which it is within the parameter's range."""
        law, (below, greatest) = self.laws[name], self.ranges[name]
        return (0.0 if below == -np.inf else law.cdf(below)), (1.0 if greatest == np.inf else law.cdf(greatest))


def read_rows(path: str | Path, quantities: Mapping[str, Quantity], system: System) -> Rows:
    """The columns of a table that bear names of parameters, with their units: "alpha [deg], v0 [m/s]".

    Args:
        path: of the file.
        quantities: what parameters there are.
        system: the units of the result.

    Raises:
        ValueError: with a clause that starts with "must".
    """
    dimensions: dict[str, Dimension] = {name: quantity.dimension for name, quantity in quantities.items()}
    columns, unused = read_columns(path, dimensions, system)
    if not columns:
        raise ValueError(f"must have columns of parameters in {path}, such as `alpha [deg]`, but has none")
    return Rows(columns, str(path), unused=unused)
