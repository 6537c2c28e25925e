"""Impacts of a CFD run in blocks of rows: from the columns of any table, with the same names and checks for all."""

import abc
import contextlib
import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Indices, Numbers, Vectors
from erosion.parameters import Scale
from erosion.tables import TableError


@dataclasses.dataclass(frozen=True)
class ImpactBlock:
    """Some consecutive rows of a table of impacts, each a parcel of equal particles, in SI units.

    A row says how fast and how steeply it hits either by `velocity`, from which the surface's normal gives the angle of
    attack, or by `speed` and `alpha`. It says where by `face`, else by `position`; a table may say neither.

    Args:
        source: the file of the rows, for messages.
        first: number of the first row in this file, from 0.
        count: particles that a row stands for, shape (rows,) [-].
        mass: of one particle, shape (rows,) [kg].
        diameter: of one particle, shape (rows,) [m].
        density: beside both of these, shape (rows,) [kg/m³]; None where nobody says it, or the mass is made of it.
        velocity: of the impact, before the rebound, shape (rows, 3) [m/s].
        speed: v₀, shape (rows,) [m/s].
        alpha: angle of attack, shape (rows,) [rad].
        spin: φ̇₀ as `Parameters` has it, shape (rows,) [rad/s].
        position: shape (rows, 3) [m].
        face: index among the faces of the surface, -1 where the row names none of them, shape (rows,).
        time: shape (rows,) [s].
        parcel: which parcel hits, the same number for all of its bounces, shape (rows,).
    """

    source: str
    first: int
    count: Numbers
    mass: Numbers
    diameter: Numbers
    density: Numbers | None = None
    velocity: Vectors | None = None
    speed: Numbers | None = None
    alpha: Numbers | None = None
    spin: Numbers | None = None
    position: Vectors | None = None
    face: Indices | None = None
    time: Numbers | None = None
    parcel: Indices | None = None

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.count)


@dataclasses.dataclass(kw_only=True)
class Impacts(abc.ABC):
    """A table of impacts that can be read again and again; `erosion.read_impacts` opens one.

    Attributes:
        title: file or folder, for messages and titles.
        rows: their number, None where only reading all of them tells it.
        density: of the particles [kg/m³], where no column gives it.
        duration: time that the table covers [s], None where it does not say; rates need it.
        duration_from: what says so, in words.
        injected: mass of the particles that were injected [kg], None where the run does not say it.
        has_parcels: whether rows say which parcel hits, so that bounces are known from new parcels.
        has_weights: whether rows say how many particles they stand for; else each row is one.
        mesh_faces: whether `face` of its blocks counts the faces of the whole mesh (`Surface.face_of_mesh` leads from
            them to the surface's own).
        warnings: sentences on what the table does not say, and what is taken instead.
        read_as: how its columns are understood, in words.
        own_units: of diameters and speeds as the table has them, by "length" and "speed"; else those that read well.
    """

    title: str
    rows: int | None = None
    density: float | None = None
    duration: float | None = None
    duration_from: str = "as given"
    injected: float | None = None
    has_parcels: bool = False
    has_weights: bool = True
    mesh_faces: bool = False
    warnings: tuple[str, ...] = ()
    read_as: str = ""
    own_units: Mapping[str, Scale] | None = None

    @abc.abstractmethod
    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """All rows in the order of the table, at most `rows` at a time.

        Raises:
            ImpactsError: a ValueError that names file and row.
        """

    @abc.abstractmethod
    def identity(self) -> str:
        """A digest of the content of all files, the same only for the same rows."""


class ImpactsError(ValueError):
    """A table of impacts or a surface that cannot be used; says which file, which row, and what to do."""


@contextlib.contextmanager
def reading_impacts() -> Iterator[None]:
    """Errors of the reader of tables become `ImpactsError`."""
    try:
        yield
    except TableError as error:
        raise ImpactsError(str(error)) from error


def require_rows(source: str, first: int, good: np.ndarray, what: Callable[[int], str]) -> None:
    """Refuse the first row of some that is not good.

    Args:
        source: the file, for messages.
        first: number of the first of these rows in the file, from 0.
        good: of each row.
        what: the end of the sentence for a row, by its number among these.
    """
    if not good.all():
        row = int(np.argmin(good))
        raise ImpactsError(f"{source}: row {first + row + 1:,}{what(row)}")


def digest_of(paths: Sequence[Path], more: str) -> str:
    """A digest of the content of files, in their order, and of what else the rows depend on."""
    digest = hashlib.sha256(more.encode())
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]


Columns = Mapping[str, np.ndarray]
"""Numbers in SI units by name, see `NAMES`; each shape (rows,)."""

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
POSITION = ("position_x", "position_y", "position_z")
NAMES = (
    *(WEIGHTS := ("count", "parcel_mass", "mass_flow", "frequency")), "mass", "density", "diameter", *VELOCITY, "speed",
    "angle", "spin", *POSITION, "face", "mesh_face", "cell", "processor", "time", "parcel", "origin",
)  # fmt: skip
"""Columns that a table may have. `parcel_mass` is of all particles of a row, `mass` of one of them. `origin` is the
processor that injected a parcel, which may give the number of another one's again."""

_RATES = {"mass_flow": "parcel_mass", "frequency": "count"}
"""Weights of a steady run, whose rows are streams: the mass and the number of particles that hit in 1 s."""

GREATEST = 1e20
"""Of a number in SI units, so that no product of a map overflows."""


def require_columns(source: str, names: Collection[str], *, has_density: bool = False) -> None:
    """Refuse a table whose columns do not make impacts.

    Args:
        source: the file, for messages.
        names: those of its columns that are in `NAMES`.
        has_density: whether the density is known from elsewhere.

    Raises:
        ImpactsError: one sentence that names what is missing.
    """
    for vector in (VELOCITY, POSITION):
        missing = [name for name in vector if name not in names]
        if missing and len(missing) < len(vector):
            raise ImpactsError(f"{source}: has no column {' and '.join(missing)}, but the others of the vector.")
    if VELOCITY[0] not in names and not {"speed", "angle"} <= set(names):
        raise ImpactsError(
            f"{source}: has no columns of the velocity (`{'`, `'.join(VELOCITY)}`), and none of `speed` and `angle`."
        )
    if "diameter" not in names and not ({"mass", "density"} <= set(names) or ("mass" in names and has_density)):
        raise ImpactsError(f"{source}: has no column `diameter`, and no columns `mass` and `density`.")
    if "mass" not in names and "density" not in names and not has_density:
        raise ImpactsError(
            f"{source}: has no column `mass` or `density` of a particle; Argument `particle_density` must give it."
        )


def weigh(source: str, names: Collection[str], duration: float | None) -> tuple[float | None, tuple[str, ...]]:
    """The duration of a table, and sentences on what it does not say of the weights of its rows.

    Args:
        source: the file, for messages.
        names: its columns, of `NAMES`.
        duration: the time that it covers [s], where it is known.

    Raises:
        ImpactsError: for two weights, and for rates beside the times of impacts.
    """
    weights, name = [weight for weight in WEIGHTS if weight in names], Path(source).name
    if not weights:
        return duration, ()
    if len(weights) > 1:
        raise ImpactsError(
            f"{source}: the columns {' and '.join(weights)} all give the weight of a row; keep one, and name others in "
            "Argument `ignore`."
        )
    if weights[0] not in _RATES:
        return duration, ()
    if "time" in names:
        raise ImpactsError(
            f"{source}: has the column {weights[0]}, of a steady run, but also the `time` of each impact; if this is "
            "the age of a particle, name it in Argument `ignore`."
        )
    if duration is not None:
        return duration, ()
    return 1.0, (
        f"{name} is of a steady run, so its rows are what hits in 1 s; Argument `duration` sets another time.",
    )


def blocks(
    source: str,
    first: int,
    columns: Columns,
    rows: int,
    density: float | None = None,
    duration: float | None = None,
) -> Iterator[ImpactBlock]:
    """The rows of a table whose columns `require_columns` accepts.

    Args:
        source: the file, for messages.
        first: number of the first row in the file, from 0.
        columns: see `NAMES`; one of `face` and `mesh_face` at most.
        rows: of a block, at most.
        density: of particles [kg/m³], where no column gives it.
        duration: for which streams of particles hit [s]; see `weigh`.

    Raises:
        ImpactsError: naming file, row and column of a number that is not finite or too great, or of a face that is no
            number of one.
    """
    columns = {**columns, **{weight: columns[rate] * duration for rate, weight in _RATES.items() if rate in columns}}
    for name, values in columns.items():
        require_rows(source, first, np.abs(values) <= GREATEST, functools.partial(_too_great, name, values))
    mass, diameter = _sizes(columns, density)
    count = columns.get("count")
    if count is None:
        count = columns["parcel_mass"] / mass if "parcel_mass" in columns else np.ones(len(mass))
    fields: dict[str, Any] = {"count": count, "mass": mass, "diameter": diameter}
    stated = columns.get("density", density)
    if stated is not None and {"mass", "diameter"} <= columns.keys():
        fields["density"] = np.broadcast_to(stated, len(mass))
    for name, axes in (("velocity", VELOCITY), ("position", POSITION)):
        if axes[0] in columns:
            fields[name] = np.stack([columns[axis] for axis in axes], axis=1)
    own = {"spin": "spin", "time": "time"} | ({} if "velocity" in fields else {"speed": "speed", "angle": "alpha"})
    fields |= {field: columns[name] for name, field in own.items() if name in columns}
    if name := next((name for name in ("mesh_face", "face") if name in columns), ""):
        values, fields["face"] = columns[name], columns[name].astype(np.int64)
        must = f": column `{name}` must be the number of a face, or -1 for none, but is"
        good = (fields["face"] == values) & (fields["face"] >= -1)
        require_rows(source, first, good, lambda row: f"{must} {values[row]:g}.")
    if "parcel" in columns:
        number, origin = columns["parcel"], columns.get("origin", np.zeros(len(count)))
        # Whole numbers below 2^53 are exact.
        most = 2.0**53 if "origin" not in columns else 2.0**32
        good = (number >= 0) & (number < most) & (origin >= 0) & (origin < 2.0**20) & ((number + origin) % 1 == 0)
        require_rows(source, first, good, lambda row: f": `parcel` must be a number of one, but is {number[row]:g}.")
        fields["parcel"] = (number + 2.0**32 * origin).astype(np.int64)
    for begin in range(0, len(count), rows):
        part = slice(begin, begin + rows)
        yield ImpactBlock(source, first + begin, **{name: values[part] for name, values in fields.items()})


def _too_great(name: str, values: np.ndarray, row: int) -> str:
    condition = f"at most {GREATEST:g}" if np.isfinite(values[row]) else "finite"
    return f": column `{name}` must be {condition}, but is {values[row]}."


def _sizes(columns: Columns, density: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Mass and diameter of spheres, of which two of mass, diameter and density are enough."""
    rho = np.asarray(columns.get("density", density), float)
    if "mass" not in columns:
        return rho * math.pi / 6 * columns["diameter"] ** 3, columns["diameter"]
    if "diameter" not in columns:
        return columns["mass"], np.cbrt(6 * columns["mass"] / (math.pi * rho))
    return columns["mass"], columns["diameter"]
