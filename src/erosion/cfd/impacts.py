"""Impacts of a CFD run, read in blocks of rows, so that memory does not grow with their number."""

import abc
import dataclasses
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from erosion.array_types import Indices, Numbers, Vectors


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
        velocity: of the impact, before the rebound, shape (rows, 3) [m/s].
        speed: v₀, shape (rows,) [m/s].
        alpha: angle of attack, shape (rows,) [rad].
        spin: φ̇₀ as `Parameters` has it, shape (rows,) [rad/s].
        position: shape (rows, 3) [m].
        face: index among the faces of the surface, -1 where the row names none of them, shape (rows,).
        time: shape (rows,) [s].
    """

    source: str
    first: int
    count: Numbers
    mass: Numbers
    diameter: Numbers
    velocity: Vectors | None = None
    speed: Numbers | None = None
    alpha: Numbers | None = None
    spin: Numbers | None = None
    position: Vectors | None = None
    face: Indices | None = None
    time: Numbers | None = None

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.count)


class Impacts(abc.ABC):
    """A table of impacts that can be read again and again; `erosion.read_impacts` opens one.

    Attributes:
        title: file or folder, for messages and titles.
        rows: their number, None where only reading all of them tells it.
        duration: time that the table covers [s], None where it does not say; rates need it.
        mesh_faces: whether `face` of its blocks counts the faces of the whole mesh (`Surface.face_of_mesh` leads from
            them to the surface's own).
        notes: sentences on what the table does not say, and what is taken instead.
    """

    title: str
    rows: int | None
    duration: float | None
    mesh_faces: bool
    notes: tuple[str, ...] = ()

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


def digest_of(paths: Sequence[Path], more: str) -> str:
    """A digest of the content of files, in their order, and of what else the rows depend on."""
    digest = hashlib.sha256(more.encode())
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]
