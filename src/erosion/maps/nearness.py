"""Whether rows lie on the surface: the limit of their distance, and surfaces in another unit than the impacts."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from erosion.cfd.impacts import ImpactBlock, ImpactsError
from erosion.cfd.surface import METRES, Surface, metres_of
from erosion.maps.incidence import OF_WIDTH, TOO_FAR, Hits, limit_of

_OF_EXTENT = 0.01
"""Of the impacts' extent, the farthest that a surface of the right size may be off: its own width says nothing then."""
_SAMPLE = 256  # rows that are compared with the surface in other sizes, at most
_CLEAR = 0.25  # share of rows by which another size must fit better, so that the surface is refused
_SAME = 0.02  # share of rows below which two sizes fit alike
_ABSURD = 0.04
"""A surface that is larger than the impacts by so much, with faces as large as all of them, is in another unit."""
_NAMES = {"in": "inches", "ft": "feet"}
_RATIOS = {float(f"{a / b:.9g}") for a in METRES.values() for b in METRES.values() if 1e-3 <= a / b <= 1e3}
# Units that people confuse, and half as large, for surfaces that are larger than what is hit.
_FACTORS = sorted(_RATIOS | {0.5, 2.0} | {*METRES.values()})
_OF_METRES = {0.5, *METRES.values()}
"""The factors of a surface that nobody gave a unit: its numbers are of one of these units, or it is large."""


@dataclasses.dataclass(frozen=True)
class _Sample:
    """Rows with a position: where they are, the face that they name or -1, and their diameter."""

    position: np.ndarray
    named: np.ndarray
    diameter: np.ndarray

    def part(self, rows: slice) -> "_Sample":
        return _Sample(self.position[rows], self.named[rows], self.diameter[rows])

    def joined(self, more: "_Sample") -> "_Sample":
        pairs = ((getattr(self, field.name), getattr(more, field.name)) for field in dataclasses.fields(self))
        return _Sample(*(np.concatenate(pair) for pair in pairs))


class Nearness:
    """How the rows that were read so far lie on the surface.

    Args:
        surface: the surface.
        limit: greatest distance of a row from its face [m]; None for `limit_of`.
    """

    def __init__(self, surface: Surface, limit: float | None) -> None:
        self._surface, self._limit = surface, limit
        self._rows, self._far, self._least, self._greatest = 0, 0, math.inf, 0.0
        self._allowed, self._farthest_allowed = 0, 0.0
        self._sample = _Sample(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0))
        self._stride = 1
        self._known: tuple[int, Mapping[float, float]] | None = None

    def add(self, block: ImpactBlock, hits: Hits) -> None:
        """Take note of the rows of a block."""
        rows = np.flatnonzero(np.isfinite(hits.distance))
        if not rows.size or block.position is None:
            return
        compared = hits.part(rows)
        face, distance, diameter, far = compared.face, compared.distance, compared.diameter, compared.fate == TOO_FAR
        if far.any():
            self._far += int(far.sum())
            self._least = min(self._least, float(distance[far].min()))
            self._greatest = max(self._greatest, float(distance[far].max()))
        if self._limit is not None:
            allowed = ~far & (distance > limit_of(self._surface, face, distance, diameter))
            self._allowed += int(allowed.sum())
            self._farthest_allowed = max(self._farthest_allowed, float(distance[allowed].max(initial=0.0)))
        some = slice(-self._rows % self._stride, None, self._stride)
        position = np.asarray(block.position, float)[rows]
        kept = _Sample(position, np.where(compared.named, face, -1), diameter).part(some)
        self._sample = self._sample.joined(kept)
        self._rows += len(rows)
        while len(self._sample.diameter) > _SAMPLE:
            self._sample, self._stride = self._sample.part(slice(None, None, 2)), 2 * self._stride

    def require(self, table: str) -> None:
        """Refuse a surface on which the rows do not lie.

        Args:
            table: name of the table, for messages.

        Raises:
            ImpactsError: with the factor by which the surface is too large or too small, where there is one.
        """
        if self._limit is not None or not self._rows:
            return
        surface, shares = self._surface, self._shares()
        best = max(shares.values())
        alike = [factor for factor, share in shares.items() if share > best - _SAME]
        factor = min(alike, key=lambda factor: abs(math.log(factor)))
        is_other = factor != 1 and best > max(0.5, shares[1.0] + _CLEAR)
        lie = "lie on a smaller one"
        if self._far:
            lie = f"lie {_between(self._least, self._greatest)} from their face"
        off = f"{self._far or self._rows:,} of {self._rows:,} rows of {table} {lie}"
        if is_other:
            times = f"{1 / factor:.4g} × too large" if factor < 1 else f"{factor:.4g} × too small"
            raise ImpactsError(
                f"{surface.title}: is {times} for the impacts: {off}. {_as_units(surface, alike)} "
                "Argument `limit` says how far off rows may lie."
            )
        if self._far > self._rows / 2:
            raise ImpactsError(
                f"{surface.title}: is not where the impacts are: {off}, and it is {surface.length:.3g} m across. "
                "Argument `limit` says how far off rows may lie."
            )
        smaller = self._smaller()
        if smaller and smaller[0] < _ABSURD and self._extent() < self._side():
            raise ImpactsError(f"{surface.title}: may be in another unit. {self._spot(smaller)}")

    def sentences(self) -> list[str]:
        """What a reader of the map must know of its positions."""
        surface, said = self._surface, list[str]()
        if self._allowed:
            said.append(
                f"{self._allowed:,} of {self._rows:,} rows lie up to {self._farthest_allowed:.3g} m from their face, "
                "and are counted only because of the given limit."
            )
        if not self._rows and surface.unit is None and surface.mesh_face is None:
            said.append(f"{surface.title} is taken in metres: it has no unit, and the rows have no positions.")
        if self._rows and (smaller := self._smaller()):
            said.append(self._spot(smaller))
        return said

    def _smaller(self) -> list[float]:
        """The factors of smaller surfaces on which the rows would lie as well, rising; none where it is sure."""
        if self._surface.unit is not None:
            return []
        shares = self._shares()
        least = max(0.5, shares[1.0] - _SAME)
        return sorted(factor for factor in _OF_METRES if factor < 1 and shares[factor] > least)

    def _spot(self, smaller: Sequence[float]) -> str:
        """That the rows would lie as well on smaller surfaces."""
        surface = self._surface
        times = f"{'up to ' * (len(smaller) > 1)}{1 / smaller[0]:.4g}"
        unit = "If it is in metres, Argument `unit` must be 'm'."
        if smaller != [0.5]:
            unit = _as_units(surface, [*smaller, 1.0])
        return (
            f"The impacts reach over {self._extent():.3g} m of the {surface.length:.3g} m of {surface.title}, and "
            f"would lie as well on one that is {times} × smaller. {unit}"
        )

    def far_in_words(self, rows: Sequence[str]) -> str:
        """How far the rows are that are left out, of which the first ones are given; empty if there are none."""
        if not self._far:
            return ""
        limit = OF_WIDTH * self._surface.width if self._limit is None else self._limit
        more = " and the size of the particle and of the face's curve" if self._limit is None else ""
        return f"{_between(self._least, self._greatest)} off it, with a limit of {limit:.3g} m{more}: {'; '.join(rows)}"

    def _extent(self) -> float:
        """Of the impacts without strays [m]."""
        low, high = np.percentile(self._sample.position, [2, 98], axis=0)
        return float(np.linalg.norm(high - low))

    def _side(self) -> float:
        """The longest side of the faces that are hit, by the median [m]."""
        face, _ = self._surface.nearest(self._sample.position)
        return float(np.median(self._surface.longest_side[face]))

    def _shares(self) -> Mapping[float, float]:
        """The share of rows that lie on the surface, made larger by each factor."""
        if self._known is None or self._known[0] != self._rows:
            self._known = self._rows, {factor: self._share(factor) for factor in _FACTORS}
        return self._known[1]

    def _share(self, factor: float) -> float:
        surface, position = self._surface, self._sample.position / factor
        # The box is cheap, and where it is far the tree of faces is slow.
        low, high = surface.box
        margin = 0.05 * surface.length
        within = ((position >= low - margin) & (position <= high + margin)).all(axis=1)
        if not within.any():
            return 0.0
        position, named, diameter = position[within], self._sample.named[within], self._sample.diameter[within]
        face, distance = surface.nearest(position)
        if (has_name := named >= 0).any():
            face[has_name] = named[has_name]
            distance[has_name] = surface.distance(face[has_name], position[has_name])
        limit = limit_of(surface, face, distance, np.zeros(len(face)))
        near = factor * distance <= diameter + np.minimum(factor * limit, _OF_EXTENT * self._extent())
        return float(near.sum() / len(self._sample.diameter))


def _between(least: float, greatest: float) -> str:
    low, high = f"{least:.3g}", f"{greatest:.3g}"
    return f"{low} m" if low == high else f"{low} to {high} m"


def _as_units(surface: Surface, factors: Sequence[float]) -> str:
    """The units in which the surface would fit, of which only the user knows the right one."""
    own = 1.0 if surface.unit is None else metres_of(surface.unit)
    units = [unit for unit, metres in METRES.items()
             if any(math.isclose(factor * own, metres, rel_tol=1e-3) for factor in factors)]  # fmt: skip
    if not units:
        return "Are its numbers, or those of the positions, in another unit?"
    names = _either([_NAMES.get(unit, unit) for unit in units])
    if len(units) == 1:
        return f"In {names} it would fit: Argument `unit` must then be {units[0]!r}."
    return f"In {names} it would fit: Argument `unit` must say which, {_either([repr(unit) for unit in units])}."


def _either(words: Sequence[str]) -> str:
    return " or ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)
