"""From rows of a table to hits on a surface: the face, the angle, the speed, and which rows are left out.

All of it is arithmetic of single rows, so that a hit does not depend on the rows beside it.
"""

import dataclasses
import functools
import math
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from erosion.cfd.rows import ImpactBlock, ImpactsError, require_rows
from erosion.cfd.surface import Surface
from erosion.parameters import STEEPEST, are_angles

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
        position: shape (rows, 3) [m], NaN where the row has none.
        parcel: the number of the parcel; without a column of it each row has -1.
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
    position: np.ndarray
    parcel: np.ndarray

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
    """Incidence of the rows of a table on a surface: face, angle and speed.

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
        return Hits(
            fate=fate,
            face=face,
            patch=np.zeros(block.rows, np.int64) if self.surface is None else self.surface.patch[face],
            speed=speed,
            alpha=alpha,
            count=block.count,
            mass=block.mass,
            diameter=block.diameter,
            spin=np.full(block.rows, np.nan) if block.spin is None else block.spin,
            distance=distance,
            named=named,
            position=np.full((block.rows, 3), np.nan) if block.position is None else np.asarray(block.position, float),
            parcel=np.full(block.rows, -1) if block.parcel is None else np.asarray(block.parcel),
        )

    def _motion(self, block: ImpactBlock, face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Speed [m/s] and angle of attack [rad], which is not positive where the particle does not approach."""
        if block.velocity is None:
            return np.asarray(block.speed), np.minimum(np.asarray(block.alpha), STEEPEST)
        normal, velocity = self._normals[face], np.asarray(block.velocity, float)
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
        surface, its = self.surface, (block.source, block.first)
        face, distance = np.full(block.rows, -1), np.full(block.rows, np.nan)
        if surface is None:
            return face + 1, distance, face >= 0
        if block.face is not None and not (self.mesh_faces and surface.mesh_face is None):
            face = np.array(block.face, np.int64)
            if self.mesh_faces:
                found = np.where(face >= 0, surface.face_of_mesh(face), -1)
                fate[(face >= 0) & (found < 0)] = ELSEWHERE
                face = found
            else:
                has = f"but {surface.title} has {surface.faces:,} faces, counted from 0."
                require_rows(*its, face < surface.faces, lambda row: f" names face {face[row]:,}, {has}")
        named, meets = face >= 0, fate == HIT
        if block.position is None:
            require_rows(*its, named | ~meets, lambda _: " names no face of the surface and no position.")
            return np.maximum(face, 0), distance, named
        _require_numbers(block, "position")
        position = np.asarray(block.position, float)
        if (unnamed := np.flatnonzero(~named & meets)).size:
            face[unnamed], distance[unnamed] = surface.nearest(position[unnamed])
        if (of_name := np.flatnonzero(named & meets)).size:
            distance[of_name] = surface.distance(face[of_name], position[of_name])
        face = np.maximum(face, 0)
        limit = limit_of(surface, face, distance, np.asarray(block.diameter)) if self.limit is None else self.limit
        fate[meets & (distance > limit)] = TOO_FAR
        return face, distance, named

    @functools.cached_property
    def _normals(self) -> np.ndarray:
        """The unit normals of the faces."""
        assert self.surface is not None
        return self.surface.normal

    def _check(self, block: ImpactBlock) -> None:
        """Refuse rows that can be no impact."""
        motion = ("speed", "alpha") if block.velocity is None else ("velocity",)
        for name in ("mass", "diameter", "count", "spin", *motion):
            if name == "velocity" and self.surface is None:
                raise ImpactsError(
                    f"{block.source}: gives velocities, so the angle of attack needs the normals of a surface; "
                    "give one, or a table with columns of speed and angle."
                )
            if name == "speed" and (block.speed is None or block.alpha is None):
                raise ImpactsError(
                    f"{block.source}: must give velocities, or speeds and angles of attack, but does not."
                )
            if name == "speed" and self.restitution is not None:
                raise ImpactsError(
                    f"{block.source}: gives speeds and angles, of which no rebound can be undone: Argument "
                    "`restitution` must be left out."
                )
            _require_numbers(block, name)


_DEGREES = " ({:g} rad; was the column in degrees?)"
_Check = tuple[str, Callable[[np.ndarray], Any], Callable[[Any], str]]
_FINITE: _Check = ("must be finite", lambda values: np.isfinite(values.reshape(len(values), -1)).all(axis=1), str)
_POSITIVE: _Check = ("must be positive and finite", lambda values: (values > 0) & np.isfinite(values), str)
_AT_LEAST_0: _Check = ("must be a number of at least 0", lambda values: (values >= 0) & np.isfinite(values), str)
_CHECKS: Mapping[str, _Check] = {
    "mass": _POSITIVE,
    "diameter": _POSITIVE,
    "count": _AT_LEAST_0,
    "spin": _FINITE,
    "velocity": _FINITE,
    "speed": _AT_LEAST_0,
    "alpha": (
        "must be in [0°, 90°]",
        lambda values: (values == 0) | are_angles(values),
        lambda angle: f"{math.degrees(angle):g}°" + (_DEGREES.format(angle) if 2 <= angle <= 90 else ""),
    ),
    "position": _FINITE,
}
"""Of the numbers of a block: what they must be, which are so, and one in words."""


def _require_numbers(block: ImpactBlock, name: str) -> None:
    """Refuse the first row whose number is not good."""
    if (values := getattr(block, name)) is not None:
        must, are_good, in_words = _CHECKS[name]
        good = are_good(np.asarray(values))
        said = f": `{name}` {must}, but is"
        require_rows(block.source, block.first, good, lambda row: f"{said} {in_words(values[row])}.")


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


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1] + first[:, 2] * second[:, 2]


_NAMED = 3  # rows that are too far are named, the others counted


class Nearness:
    """Distances of the rows read so far from the surface.

    Args:
        surface: the surface; without one rows have no distance, and nothing is said.
        limit: greatest distance of a row from its face [m]; None for `limit_of`.
    """

    def __init__(self, surface: Surface | None, limit: float | None) -> None:
        self._surface, self._limit = surface, limit
        self._first: list[str] = []  # rows that are too far
        self._rows, self._far, self._least, self._greatest = 0, 0, math.inf, 0.0
        self._box = np.array([[math.inf], [-math.inf]]) * np.ones(3)

    def add(self, block: ImpactBlock, hits: Hits) -> None:
        """Take note of the rows of a block."""
        compared = hits.part(np.isfinite(hits.distance))
        if not compared.rows:
            return
        for row in np.flatnonzero(hits.fate == TOO_FAR)[: _NAMED - len(self._first)]:
            self._first.append(f"{block.source}: row {block.first + row + 1:,} ({hits.distance[row]:.3g} m)")
        distance, far, (least, greatest) = compared.distance, compared.fate == TOO_FAR, self._box
        self._rows, self._far = self._rows + compared.rows, self._far + int(far.sum())
        self._least = min(self._least, float(distance[far].min(initial=math.inf)))
        self._greatest = max(self._greatest, float(distance[far].max(initial=0.0)))
        place = compared.position
        self._box = np.array([np.minimum(least, place.min(0)), np.maximum(greatest, place.max(0))])

    def require(self, table: str) -> None:
        """Refuse a surface on which most of the rows do not lie.

        Args:
            table: name of the table, for messages.

        Raises:
            ImpactsError: with the extents of both.
        """
        if self._surface is None or self._limit is not None or self._far <= self._rows / 2:
            return
        surface = self._surface
        unit = f" in {surface.unit}" if surface.mesh_face is None else ""
        raise ImpactsError(
            f"{surface.title}: {self._far:,} of {self._rows:,} rows of {table} lie "
            f"{_between(self._least, self._greatest)} from it. The impacts lie in {box_in_words(*self._box)}, the "
            f"surface{unit} in {box_in_words(*surface.box)}: Argument `unit` says the surface's unit, Argument "
            "`columns` that of the positions, and Argument `limit` how far off rows may lie."
        )

    def far_in_words(self) -> str:
        """How far the rows are that are left out, and which are the first ones; empty if there are none."""
        if not self._far or self._surface is None:
            return ""
        limit = OF_WIDTH * self._surface.width if self._limit is None else self._limit
        more = " and the size of the particle and of the face's curve" if self._limit is None else ""
        off = f"{_between(self._least, self._greatest)} off it"
        return f"{off}, with a limit of {limit:.3g} m{more}: {'; '.join(self._first)}"


def box_in_words(least: np.ndarray, greatest: np.ndarray) -> str:
    """Such as "0 to 0.2, 0 to 0.05, 0 to 0.02 m"."""
    return ", ".join(f"{low:.4g} to {high:.4g}" for low, high in zip(least, greatest, strict=True)) + " m"


def _between(least: float, greatest: float) -> str:
    low, high = f"{least:.3g}", f"{greatest:.3g}"
    return f"{low} m" if low == high else f"{low} to {high} m"
