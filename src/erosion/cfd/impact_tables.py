"""Tables of impacts with named columns."""

import dataclasses
import functools
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.cfd.rows import (
    POSITION,
    VELOCITY,
    WEIGHTS,
    ImpactBlock,
    Impacts,
    ImpactsError,
    blocks,
    digest_of,
    reading_impacts,
    require_columns,
    require_rows,
    weigh,
)
from erosion.cfd.vtk import ENDINGS, VtkPoints, vtk_files
from erosion.parameters.quantities import Scale
from erosion.tables import Column, Table, open_table
from erosion.tables.headings import (
    ANGLE_WORDS,
    ANGLES,
    MASS_WORDS,
    MASSES,
    RATE_WORDS,
    SIZE_WORDS,
    SPEED_WORDS,
    SPEEDS,
    WEIGHT_WORDS,
    Wanted,
    heading_parts,
    matching,
    unused_note,
)
from erosion.tables.text import TextTable, cut_off

_COMPONENTS = [
    ("uvw"[axis], f"velocity {'uvw'[axis]}", f"velocity[{'ijk'[axis]}]", f"v:{axis}",
     *(f"{word}{colon}{letter}" for word in ("u", "v", "vel", "velocity") for colon in ("", ":")),
     *(f"{word}{colon}{axis}" for word in ("u", "velocity") for colon in ("", ":")))
    for axis, letter in enumerate("xyz")
]  # fmt: skip
# Other names that codes and their post-processors give to the same columns. A "number" may be that of the row, and a
# "weight" a share: both are refused.
_KNOWN: Mapping[str, Wanted] = {
    "count": Wanted(
        ("1",),
        ("nparticle", "nparticles", "n particles", "grains", "ngrains", "number of grains",
         "number of particles", "num particles", "particle count",
         "particles per parcel", "particles in parcel", "number in parcel", "n in parcel"),
        WEIGHT_WORDS,
    ),
    "parcel_mass": Wanted(("mass",), ("mass of parcel", "mass per parcel", "mass in parcel"), MASS_WORDS),
    "mass_flow": Wanted(
        ("mass flow",), ("mass flow rate", "particle mass flow rate", "parcel mass flow rate", "mdot"), RATE_WORDS
    ),
    "frequency": Wanted(("rate",), ("particle frequency", "particle rate", "number flow rate"), RATE_WORDS),
    "mass": Wanted(("mass",), MASSES, MASS_WORDS),
    "density": Wanted(("density",), ("rho", "particle density", "rho p"), r"dens\w*|rho\w?|dichte"),
    "diameter": Wanted(("length",), ("d", "d p", "particle diameter", "diameter of particle"), SIZE_WORDS),
    "speed": Wanted(("speed",), SPEEDS, SPEED_WORDS),
    **{name: Wanted(("speed",), _COMPONENTS[axis]) for axis, name in enumerate(VELOCITY)},
    "angle": Wanted(("angle",), ANGLES, ANGLE_WORDS),
    "spin": Wanted(("angular speed",), (), r"spin\w*|omega|rotation\w*"),
    **{name: Wanted(("length",), (letter, f"points:{axis}", f"position[{letter}]"))
       for axis, (letter, name) in enumerate(zip("xyz", POSITION, strict=True))},
    "face": Wanted(("1",)), "mesh_face": Wanted(("1",), ("facei",)),
    "time": Wanted(("time",), ("flow time", "time of impact")),
    "parcel": Wanted(("1",), ("parcel id", "particle id", "orig id")),
    "origin": Wanted(("1",), ("orig proc", "orig proc id", "origin processor")),
}  # fmt: skip


_REFUSED = {"mass flux": Wanted(("mass flux",))}


@dataclasses.dataclass(kw_only=True)
class NamedImpacts(Impacts):
    """A table with named columns."""

    paths: Sequence[Path]
    table: Table

    @property
    def columns(self) -> Mapping[str, Column]:
        """Those that are used, by name."""
        return self.table.columns

    def identity(self) -> str:
        """See `Impacts`."""
        return digest_of(self.paths, f"{self.density} {self.duration} {self.columns}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`."""
        first = 0
        with reading_impacts():
            for columns in self.table.blocks():
                for name, values in columns.items():
                    require_rows(self.title, first, ~np.isnan(values), functools.partial(self._lacking, name))
                yield from blocks(self.title, first, columns, rows, self.density, self.duration)
                first += len(next(iter(columns.values())))
        if not first:
            raise ImpactsError(f"{self.title}: has no rows.")

    def _lacking(self, name: str, _: int) -> str:
        return f": column `{self.columns[name].heading}` has no number."


def open_named(
    path: Path,
    density: float | None,
    duration: float | None,
    *,
    named_density: float | None = None,
    **options: Any,
) -> NamedImpacts:
    """A table with named columns.

    Args:
        path: of a file of text or numbers, or of VTK's points.
        density: of the particles [kg/m³], where no column gives it.
        duration: that the table covers [s].
        named_density: of a particle that the user names [kg/m³], for a table that does not have its own.
        **options: see `open_table`.

    Raises:
        ImpactsError: for a file that cannot be read, and columns or units that cannot be used.
    """
    is_vtk = path.name.lower().endswith(ENDINGS)
    with reading_impacts():
        table = open_table(VtkPoints(path) if is_vtk else path, _wanted, refused=_REFUSED, **options)
    columns = dict(table.columns)
    if {"face", "mesh_face"} <= columns.keys():
        raise ImpactsError(f"{path}: has both columns `face` and `mesh_face`; keep one.")
    # The velocity and the surface give both better.
    doubled = {name: columns.pop(name) for name in ("speed", "angle") if {name, VELOCITY[0]} <= columns.keys()}
    if density is None and "density" not in columns:
        density = named_density
    elif density is not None and _gives_density(columns):
        own = [columns[name].heading for name in ("density", "mass", "diameter") if name in columns]
        raise ImpactsError(
            f"{path}: Argument `particle_density` gives the density of the particles, but so does "
            f"{own[0]!r}{f' with {own[1]!r}' if 'density' not in columns else ''}; leave one out. "
            f"If that is none of the particles, name {own[0]!r} in Argument `ignore`."
        )
    require_columns(str(path), columns, has_density=density is not None)
    if table.source.rows == 0:
        raise ImpactsError(f"{path}: has no rows.")
    duration, warnings = weigh(str(path), columns, duration)
    warnings += table.source.notes
    if isinstance(table.source, TextTable):
        warnings += cut_off(path)
    if unused := (*table.unused, *(column.heading for column in doubled.values())):
        warnings += (f"{path.name}: {unused_note(unused)}.",)
    return NamedImpacts(
        title=str(path),
        paths=[path, *(vtk_files(path).values() if is_vtk else ())],
        table=dataclasses.replace(table, columns=columns),
        rows=table.source.rows,
        density=density,
        duration=duration,
        has_parcels="parcel" in columns,
        has_weights=any(name in columns for name in WEIGHTS),
        mesh_faces="mesh_face" in columns,
        warnings=warnings,
        read_as=_in_words(columns),
        own_units={dimension: Scale(columns[name].factor, columns[name].unit)
                   for name, dimension in (("diameter", "length"), ("speed", "speed"), (VELOCITY[0], "speed"))
                   if name in columns},
    )  # fmt: skip


def _in_words(columns: Mapping[str, Column]) -> str:
    """Which columns are what, and in which units: "velocity from u, v, w in m/s, diameter from d in um as given"."""
    groups = dict[tuple[str, str], list[str]]()
    for name, column in columns.items():
        what = name[:-2] if name in (*VELOCITY, *POSITION) else name.replace("_", " ")
        unit = f" in {column.unit}{' as given' * column.is_declared}" if column.unit else ""
        groups.setdefault((what, unit), []).append(heading_parts(column.heading)[0] or column.heading.strip())
    return "; ".join(f"{what} from {', '.join(heads)}{unit}" for (what, unit), heads in groups.items())


def _gives_density(columns: Collection[str]) -> bool:
    return "density" in columns or {"mass", "diameter"} <= set(columns)


def _wanted(headings: Sequence[str]) -> Mapping[str, Wanted]:
    """The quantities of impacts, where "v" is the speed unless it stands beside u or w."""
    if any(matching(headings, {"u": Wanted(("speed",)), "w": Wanted(("speed",))})):
        return _KNOWN
    second = _KNOWN[VELOCITY[1]]
    return {
        **_KNOWN,
        VELOCITY[1]: dataclasses.replace(second, names=[name for name in second.names if name != "v"]),
        "speed": dataclasses.replace(_KNOWN["speed"], names=(*SPEEDS, "v")),
    }
