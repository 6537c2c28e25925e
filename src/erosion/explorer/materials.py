"""The particles and targets that the page offers by name."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from erosion.explorer.state import with_point
from erosion.parameters.materials import Particle, Target, known_particles, known_targets, particle, target
from erosion.parameters.units import System, conversion_factor, read_quantity


@dataclasses.dataclass(frozen=True)
class Materials:
    """What the menus list.

    Args:
        particles: by name; their size is chosen on the page.
        targets: by name.
    """

    particles: Mapping[str, Particle]
    targets: Mapping[str, Target]

    def sized(self, name: str, size: str, units: System) -> Particle:
        """A particle by its name, of a size as text; a bare number is in these units.

        Raises:
            ValueError: for a size that cannot be read or is not positive.
        """
        try:
            metres = read_quantity(with_point("size", size), "length", units) * conversion_factor("length", units, "si")
        except ValueError as error:
            raise ValueError(f"The size {str(error).rstrip('.')}.") from error
        if not 0 < metres < math.inf:
            raise ValueError(f"The size must be positive and finite, but is {size!r}.")
        return dataclasses.replace(self.particles[name], size=metres)


def read_materials(files: Sequence[Path] = ()) -> Materials:
    """The package's table, and those of the user's own files before it.

    Raises:
        ValueError: for a file that cannot be used.
    """
    particles: dict[str, Particle] = {}
    targets: dict[str, Target] = {}
    for file in (*files, None):
        where = "" if file is None else f"{file}: "
        for name in known_particles(file):
            particles.setdefault(name, particle(f"{where}{name} 1 mm"))
        for name in known_targets(file):
            targets.setdefault(name, target(f"{where}{name}"))
    return Materials(particles, targets)
