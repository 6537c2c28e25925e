"""Samples that Ansys Fluent writes of particles at a surface, files `.dpm`.

Two lines of header come first, the surface and the columns; then one line for each parcel, the numbers in parentheses
and the name of its injection. All numbers are in SI units whatever the session shows; t is the temperature, and `time`
the age of the particle.
"""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from erosion.cfd.impacts import ImpactBlock, Impacts, ImpactsError, digest_of
from erosion.cfd.rows import POSITION, VELOCITY, WEIGHTS, blocks, require_columns, weigh
from erosion.cfd.text import batches, head, header_names

SUFFIXES = (".dpm",)
_COLUMNS = {
    **dict(zip("xyz", POSITION, strict=True)), **dict(zip("uvw", VELOCITY, strict=True)), "diameter": "diameter",
    "mass": "mass", "n-in-parcel": "count", "parcel-mass": "parcel_mass", "mass-flow": "mass_flow",
    "frequency": "frequency", "flow-time": "time",
}  # fmt: skip


@dataclasses.dataclass
class FluentImpacts(Impacts):
    """A sample of parcels at one surface.

    In a steady run a row is a stream of particles, and its `mass-flow` [kg/s] hits for the whole duration.
    """

    path: Path
    names: tuple[str, ...]
    skipped: int
    columns: dict[str, str]
    title: str
    duration: float | None
    rows: int | None = None
    mesh_faces: bool = False
    notes: tuple[str, ...] = ()

    def identity(self) -> str:
        """See `Impacts`."""
        return digest_of([self.path], f"{self.duration}")

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """See `Impacts`."""
        first = 0
        for batch in batches(self.path, self.skipped, self.names, list(self.columns.values())):
            columns = {ours: batch[name] for ours, name in self.columns.items()}
            yield from blocks(str(self.path), first, columns, rows, duration=self.duration)
            first += len(columns["diameter"])


def open_fluent(path: Path, density: float | None, duration: float | None) -> FluentImpacts:
    """A sample of Fluent.

    Raises:
        ImpactsError: for a file without Fluent's header, or without columns that are needed.
    """
    if density is not None:
        raise ImpactsError(f"{path}: gives the mass of each particle; Argument `particle_density` must be left out.")
    lines = head(path)
    numbers = [number for number, line in enumerate(lines[:10]) if "diameter" in line and line.lstrip().startswith("(")]
    if not numbers:
        raise ImpactsError(f"{path}: has no header of Fluent, a line such as (x y z u v w diameter t … name).")
    names = header_names(path, lines[numbers[0]])
    columns = {ours: name for name, ours in _COLUMNS.items() if name in names}
    # Fluent gives the weight in several ways, which agree.
    for weight in [weight for weight in WEIGHTS if weight in columns][1:]:
        del columns[weight]
    duration, notes = weigh(str(path), columns.keys() - {"time"}, duration)
    require_columns(str(path), columns)
    return FluentImpacts(path, names, numbers[0] + 1, columns, str(path), duration, notes=notes)
