"""From rows of a table to hits: on which face, how steeply, how fast, and which rows are left out.

All of it is arithmetic of single rows, so that a hit does not depend on the rows beside it.
"""

import dataclasses
import functools
import math
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from erosion.cfd.impacts import ImpactBlock, ImpactsError
from erosion.cfd.surface import Surface
from erosion.parameters.parameters import are_angles
from erosion.parameters.ranges import STEEPEST

LEFT_OUT: Mapping[str, str] = types.MappingProxyType(
    {
        "stuck": "have no velocity, as parcels that stick to a wall",
        "receding": "move along the surface or away from it (n·U ≤ 0)",
        "too-far": "lie farther from their face than the limit",
        "elsewhere": "name a face that is not of this surface",
    }
)
"""Why a row may remove nothing; codes are 1, 2, … in this order, 0 is a hit."""

HIT, STUCK, RECEDING, TOO_FAR, ELSEWHERE = range(5)

OF_WIDTH = 0.005
"""Of the surface's width: what tables round away, and what walls of other meshes of the same part are off."""


@dataclasses.dataclass(frozen=True)
class Hits:
    """Rows in SI units, arrays of shape (rows,).

    Args:
        fate: 0 for a hit, else 1 + the place in `LEFT_OUT`.
        face: the surface's face; 0 without a surface, and where the row is elsewhere.
        patch: of this face, an index of `Surface.patches`; 0 without a surface.
        speed: v₀ [m/s].
        alpha: angle of attack [rad]; in (0, π/2] for hits.
        count: particles that the row stands for.
        mass: of one particle [kg].
        diameter: of one particle [m].
        spin: φ̇₀ of the table [rad/s], NaN where it has none.
        distance: from the position to the face [m], NaN where the row has no position or is elsewhere.
        named: whether the row names its face, which else is the nearest.
    """

    fate: np.ndarray
    face: np.ndarray
    patch: np.ndarray
    speed: np.ndarray
    alpha: np.ndarray
    count: np.ndarray
    mass: np.ndarray
    diameter: np.ndarray
    spin: np.ndarray
    distance: np.ndarray
    named: np.ndarray

    @property
    def rows(self) -> int:
        """The number of rows."""
        return len(self.fate)

    def part(self, rows: Any) -> "Hits":
        """Some of the rows: a slice, a mask or their numbers."""
        return Hits(*(getattr(self, name)[rows] for name in _COLUMNS))

    @classmethod
    def joined(cls, parts: Sequence["Hits"]) -> "Hits":
        """The rows of all parts, one part after the other."""
        if len(parts) == 1:
            return parts[0]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS))


_COLUMNS = tuple(field.name for field in dataclasses.fields(Hits))


@dataclasses.dataclass(frozen=True)
class Incidence:
    """How rows of a table meet a surface.

    Args:
        surface: None where only totals are wanted.
        mesh_faces: whether rows count the faces of the whole mesh, see `Impacts`.
        restitution: (e, μ) of the wall, where the table holds velocities after the rebound.
        limit: greatest distance of a row from its face [m]; None for `limit_of`.
    """

    surface: Surface | None
    mesh_faces: bool = False
    restitution: tuple[float, float] | None = None
    limit: float | None = None

    @property
    def patches(self) -> tuple[str, ...]:
        """The names of the surface's patches; one for all rows without a surface."""
        return ("all",) if self.surface is None else self.surface.patches

    def hits(self, block: ImpactBlock) -> Hits:
        """The rows of a block.

        Raises:
            ImpactsError: naming the first row that cannot be used.
        """
        self._check(block)
        fate = np.zeros(block.rows, np.int8)
        face, distance, named = self._faces(block, fate)
        speed, alpha = self._motion(block, face)
        meets = fate == HIT
        fate[meets & (alpha <= 0)] = RECEDING
        fate[meets & (speed == 0)] = STUCK
        spin = np.full(block.rows, np.nan) if block.spin is None else block.spin
        patch = np.zeros(block.rows, np.int64) if self.surface is None else self.surface.patch[face]
        return Hits(fate, face, patch, speed, alpha, block.count, block.mass, block.diameter, spin, distance, named)

    def too_far(self, block: ImpactBlock, hits: Hits, most: int) -> list[str]:
        """The first rows of a block that are too far, in words."""
        rows = np.flatnonzero(hits.fate == TOO_FAR)[: max(most, 0)]
        return [f"{row_in_words(block, row)} ({hits.distance[row]:.3g} m)" for row in rows]

    def _motion(self, block: ImpactBlock, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speed [m/s] and angle of attack [rad], which is not positive where the particle does not approach."""
        if block.velocity is None:
            assert block.speed is not None
            assert block.alpha is not None
            return block.speed, np.minimum(block.alpha, STEEPEST)
        assert self.surface is not None
        normal = self._normals[face]
        velocity = np.asarray(block.velocity, float)
        into = _dot(velocity, normal)
        if self.restitution is not None:
            normal_ratio, friction = self.restitution
            along = velocity - into[:, None] * normal
            into = -into / normal_ratio
            velocity = into[:, None] * normal + along / (1 - friction)
        speed = np.sqrt(_dot(velocity, velocity))
        sine = np.divide(into, speed, out=np.zeros_like(speed), where=speed > 0)
        return speed, np.arcsin(np.clip(sine, -1.0, 1.0))

    def _faces(self, block: ImpactBlock, fate: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each row the surface's face, the distance to it, and whether it is named; `fate` notes what is far."""
        distance, surface = np.full(block.rows, np.nan), self.surface
        if surface is None:
            return np.zeros(block.rows, np.int64), distance, np.zeros(block.rows, bool)
        face = self._named_faces(block, fate)
        named, meets = face >= 0, fate == HIT
        unnamed = np.flatnonzero(~named & meets)
        if block.position is None:
            if unnamed.size:
                raise ImpactsError(f"{row_in_words(block, unnamed[0])} names no face of the surface and no position.")
            return np.maximum(face, 0), distance, named
        _require(block, "position", np.isfinite(block.position).all(axis=1), "must be finite")
        position = np.asarray(block.position, float)
        if unnamed.size:
            face[unnamed], distance[unnamed] = surface.nearest(position[unnamed])
        if (of_name := np.flatnonzero(named & meets)).size:
            distance[of_name] = surface.distance(face[of_name], position[of_name])
        face = np.maximum(face, 0)
        limit = limit_of(surface, face, distance, np.asarray(block.diameter)) if self.limit is None else self.limit
        fate[meets & (distance > limit)] = TOO_FAR
        return face, distance, named

    def _named_faces(self, block: ImpactBlock, fate: np.ndarray) -> np.ndarray:
        """The surface's faces that rows name, -1 where they name none."""
        surface = self.surface
        assert surface is not None
        if block.face is None or (self.mesh_faces and surface.mesh_face is None):
            return np.full(block.rows, -1)
        named = np.asarray(block.face, np.int64)
        if self.mesh_faces:
            face = np.where(named >= 0, surface.face_of_mesh(named), -1)
            fate[(named >= 0) & (face < 0)] = ELSEWHERE
            return face
        if np.any(wrong := named >= surface.faces):
            row = int(np.argmax(wrong))
            raise ImpactsError(
                f"{row_in_words(block, row)} names face {named[row]:,}, but {surface.title} has {surface.faces:,} "
                "faces, counted from 0."
            )
        return named.copy()

    @functools.cached_property
    def _normals(self) -> np.ndarray:
        """The unit normals of the faces."""
        assert self.surface is not None
        return self.surface.normal

    def _check(self, block: ImpactBlock) -> None:
        """Refuse rows that can be no impact."""
        for name in ("mass", "diameter"):
            values = getattr(block, name)
            _require(block, name, (values > 0) & np.isfinite(values), "must be positive and finite")
        _require(block, "count", (block.count >= 0) & np.isfinite(block.count), "must be a number of at least 0")
        if block.spin is not None:
            _require(block, "spin", np.isfinite(block.spin), "must be finite")
        if block.velocity is not None:
            if self.surface is None:
                raise ImpactsError(
                    f"{block.source}: gives velocities, so the angle of attack needs the normals of a surface; "
                    "give one, or a table with columns of speed and angle."
                )
            _require(block, "velocity", np.isfinite(block.velocity).all(axis=1), "must be finite")
            return
        if block.speed is None or block.alpha is None:
            raise ImpactsError(f"{block.source}: must give velocities, or speeds and angles of attack, but does not.")
        if self.restitution is not None:
            raise ImpactsError(
                f"{block.source}: gives speeds and angles, of which no rebound can be undone: Argument `restitution` "
                "must be left out."
            )
        _require(block, "speed", (block.speed >= 0) & np.isfinite(block.speed), "must be a number of at least 0")
        _require(block, "alpha", (block.alpha == 0) | are_angles(block.alpha), "must be in [0°, 90°]", _angle_in_words)


def limit_of(surface: Surface, face: np.ndarray, distance: np.ndarray, diameter: np.ndarray) -> np.ndarray:
    """The farthest that a particle which hits a face may lie from it, shape (rows,) [m].

    It is the particle's diameter, as the centre of a sphere is half of it off the wall; and of these the greater one:
    0.5 % of the surface's width, but at most the face's longest side; and what a curved wall may lie off its facets.

    Args:
        surface: the surface.
        face: of each row, shape (rows,).
        distance: from it [m], shape (rows,); only rows that are far make facets be looked at.
        diameter: of a particle [m], shape (rows,).
    """
    limit = np.minimum(OF_WIDTH * surface.width, surface.longest_side[face])
    far = distance > limit + diameter
    if far.any():
        limit[far] = np.maximum(limit[far], surface.bulge[face[far]])
    return limit + diameter


def row_in_words(block: ImpactBlock, row: int | np.integer) -> str:
    """File and number of a row, counted from 1."""
    return f"{block.source}: row {block.first + int(row) + 1:,}"


def _require(
    block: ImpactBlock,
    name: str,
    good: np.ndarray | np.bool_,
    condition: str,
    in_words: Callable[[Any], str] = str,
) -> None:
    """Raise for the first row whose number is not good."""
    if good.all():
        return
    row = int(np.argmin(good))
    raise ImpactsError(
        f"{row_in_words(block, row)}: `{name}` {condition}, but is {in_words(getattr(block, name)[row])}."
    )


def _angle_in_words(angle: float) -> str:
    """An angle in degrees; of one that may be in degrees already, that too."""
    hint = f" ({angle:g} rad; was the column in degrees?)" if 2 <= angle <= 90 else ""
    return f"{math.degrees(angle):g}°{hint}"


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1] + first[:, 2] * second[:, 2]
