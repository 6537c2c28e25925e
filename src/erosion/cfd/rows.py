"""From columns of a table to blocks of impacts: the same names and checks for all formats."""

import math
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np

from erosion.cfd.impacts import ImpactBlock, ImpactsError

Columns = Mapping[str, np.ndarray]
"""Numbers in SI units by name, see `NAMES`; each shape (rows,)."""

VELOCITY = ("velocity_x", "velocity_y", "velocity_z")
POSITION = ("position_x", "position_y", "position_z")
NAMES = (
    *(WEIGHTS := ("count", "parcel_mass", "mass_flow", "frequency")), "mass", "density", "diameter", *VELOCITY, "speed",
    "angle", "spin", *POSITION, "face", "mesh_face", "processor", "time",
)  # fmt: skip
"""Columns that a table may have. `parcel_mass` is of all particles of a row, `mass` of one of them."""

_RATES = {"mass_flow": "parcel_mass", "frequency": "count"}
"""Weights of a steady run, whose rows are streams: the mass and the number of particles that hit in 1 s."""

GREATEST = 1e20
"""Of a number in SI units, so that no product of a map overflows."""

NO_WEIGHT = "has no column of the number of particles that a row stands for, so each row counts as one particle"


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
        return duration, (f"{name} {NO_WEIGHT}.",)
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
    for rate, weight in _RATES.items():
        if rate in columns:
            assert duration is not None
            columns = {**columns, weight: columns[rate] * duration}
    for start in range(0, len(next(iter(columns.values()))), rows):
        part = {name: values[start : start + rows] for name, values in columns.items()}
        yield _block(source, first + start, part, density)


def _block(source: str, first: int, columns: Columns, density: float | None) -> ImpactBlock:
    for name, values in columns.items():
        small = np.abs(values) <= GREATEST
        if not small.all():
            row = int(np.argmin(small))
            condition = f"at most {GREATEST:g}" if np.isfinite(values[row]) else "finite"
            raise ImpactsError(
                f"{source}: row {first + row + 1:,}: column `{name}` must be {condition}, but is {values[row]}."
            )
    mass, diameter = _sizes(columns, density)
    count = columns.get("count")
    if count is None:
        count = columns["parcel_mass"] / mass if "parcel_mass" in columns else np.ones(len(mass))
    return ImpactBlock(
        source=source,
        first=first,
        count=count,
        mass=mass,
        diameter=diameter,
        velocity=_vector(columns, VELOCITY),
        speed=columns["speed"] if VELOCITY[0] not in columns else None,
        alpha=columns["angle"] if VELOCITY[0] not in columns else None,
        spin=columns.get("spin"),
        position=_vector(columns, POSITION),
        face=_faces(source, first, columns),
        time=columns.get("time"),
    )


def _sizes(columns: Columns, density: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Mass and diameter of spheres, of which two of mass, diameter and density are enough."""
    rho = np.asarray(columns.get("density", density), float)
    if "mass" not in columns:
        return rho * math.pi / 6 * columns["diameter"] ** 3, columns["diameter"]
    if "diameter" not in columns:
        return columns["mass"], np.cbrt(6 * columns["mass"] / (math.pi * rho))
    return columns["mass"], columns["diameter"]


def _vector(columns: Columns, names: tuple[str, ...]) -> np.ndarray | None:
    return np.stack([columns[name] for name in names], axis=1) if names[0] in columns else None


def _faces(source: str, first: int, columns: Columns) -> np.ndarray | None:
    name = "mesh_face" if "mesh_face" in columns else "face"
    if name not in columns:
        return None
    values = columns[name]
    faces = values.astype(np.int64)
    if not (good := (faces == values) & (faces >= -1)).all():
        row = int(np.argmin(good))
        raise ImpactsError(
            f"{source}: row {first + row + 1:,}: column `{name}` must be the number of a face, or -1 for none, "
            f"but is {values[row]:g}."
        )
    return faces
