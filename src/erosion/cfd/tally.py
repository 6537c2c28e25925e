"""Sums over rows, for each face: exact enough for any number of rows, and the same bits however they are computed.

Rows are summed in portions of a fixed number of rows, counted from the beginning of the table. The sums of a
portion are pairwise sums, and portions are added in their order with the rounding errors kept (Neumaier 1974). So
neither the blocks in which a table is read nor the processes that compute the portions change a bit.
"""

import collections
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from erosion.cfd.incidence import HIT, LEFT_OUT, Hits

SUMS = ("particles", "particle_mass", "volume", "squares", "angle", "speed", "impacts")
"""Of each face: Σw, Σwm [kg], ΣwV [m³], Σ(wV)² [m⁶], Σwα [rad], Σwv₀ [m/s], and the number of rows.

w is a row's number of particles. V and V² are means over the draws of uncertain parameters. Rows without a volume
("failed", "unfinished") in one of the draws count in none of them.
"""

_SHORTEST, _LONGEST, _PER_DECADE = -12, 6, 400  # decades of a metre: bins of distances
_BINS = (_LONGEST - _SHORTEST) * _PER_DECADE + 2
_HELD = 1 << 20  # parcels of portions that are held before they are joined


@dataclasses.dataclass(frozen=True)
class Portion:
    """The sums of some consecutive rows.

    Args:
        faces: those that are hit, in order.
        sums: of each of `SUMS` and of these faces.
        of_draws: ΣwV of each draw of uncertain parameters and of these faces, shape (draws, faces) [m³].
        counts: what needs no care, by name: `ends`, impacts (rows that hit times draws) by face's patch and by outcome;
            `fates`, rows by fate; `lost_mass` of the rows of each fate [kg]; `outside_mass` of hits outside the range
            of a correlation [kg]; `turned`, bodies that turn too far, and those looked at; `distances`, a histogram of
            those of rows that name no face.
        farthest: the greatest of these distances [m].
        parcels: None where rows have no numbers of parcels.
    """

    faces: np.ndarray
    sums: np.ndarray
    of_draws: np.ndarray
    counts: Mapping[str, np.ndarray]
    farthest: float
    parcels: "Parcels | None" = None


@dataclasses.dataclass(frozen=True)
class Parcels:
    """The rows of each parcel together, as its bounces depend on one another.

    Args:
        parcel, face: of each pair of both that rows have, ascending, shape (pairs,).
        sums: ΣwV and Σ(wV)² of these rows, shape (2, pairs) [m³], [m⁶].
        known: the parcels of all rows, ascending, hits or not, shape (parcels,).
        mass: of all particles of each of them, the greatest of its rows, shape (parcels,) [kg].
        least_mass: the same, the least of its rows.
    """

    parcel: np.ndarray
    face: np.ndarray
    sums: np.ndarray
    known: np.ndarray
    mass: np.ndarray
    least_mass: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence["Parcels"]) -> "Parcels":
        """The sums of all parts."""
        names = ("parcel", "face", "known", "mass", "least_mass")
        parcel, face, known, mass, least_mass = (
            np.concatenate([getattr(part, name) for part in parts]) for name in names
        )
        sums = np.concatenate([part.sums for part in parts], axis=1)
        order = np.lexsort((face, parcel))
        parcel, face = parcel[order], face[order]
        begins = np.flatnonzero((np.diff(parcel, prepend=-2) != 0) | (np.diff(face, prepend=-2) != 0))
        if begins.size:
            sums = np.add.reduceat(sums[:, order], begins, axis=1)
        known, place = np.unique(known, return_inverse=True)
        greatest, least = np.zeros(len(known)), np.full(len(known), np.inf)
        np.maximum.at(greatest, place, mass)
        np.minimum.at(least, place, least_mass)
        return cls(parcel[begins], face[begins], sums, known, greatest, least)

    def bounces(self, group: np.ndarray, groups: int) -> np.ndarray:
        """Σ over parcels of (ΣwV)² - Σ(wV)², 0 where each parcel hits once, shape (groups,) [m⁶].

        Args:
            group: of each face, shape (faces,).
            groups: their number.
        """
        pairs = Parcels.joined([dataclasses.replace(self, face=group[self.face])])
        return np.bincount(pairs.face, pairs.sums[0] ** 2 - pairs.sums[1], groups)


_NONE = np.zeros(0, np.int64)
_NO_PARCELS = Parcels(_NONE, _NONE, np.zeros((2, 0)), _NONE, np.zeros(0), np.zeros(0))


def portion_of(
    hits: Hits,
    struck: Hits,
    volume: np.ndarray,
    outcome: np.ndarray,
    outside: np.ndarray,
    turned: np.ndarray,
    patches: int,
    ends: int,
) -> Portion:
    """The sums of the rows of a portion.

    Args:
        hits: all rows.
        struck: those that hit.
        volume: of one particle for each draw of uncertain parameters, or one, and each row that hits, in the order of
            the rows; shape (draws, rows) [m³].
        outcome: of these impacts, of the same shape.
        outside: whether these rows are outside the range of a correlation.
        turned: of `erosion.impacts.turn.count_turned`.
        patches: number of patches.
        ends: number of outcomes.
    """
    near = hits.distance[np.isfinite(hits.distance) & ~hits.named]
    with np.errstate(divide="ignore"):
        place = np.floor((np.log10(near) - _SHORTEST) * _PER_DECADE) + 1
    code = (struck.patch * ends + outcome).ravel()
    counts = {
        "ends": np.bincount(code, minlength=patches * ends).reshape(patches, ends),
        "fates": np.bincount(hits.fate, minlength=1 + len(LEFT_OUT)),
        "lost_mass": np.bincount(hits.fate, hits.count * hits.mass, minlength=1 + len(LEFT_OUT)),
        "turned": turned,
        "outside_mass": np.sum(struck.count * struck.mass, where=outside),
        # The first bin holds the shortest.
        "distances": np.bincount(np.clip(place, 0, _BINS - 1).astype(np.int64), minlength=_BINS),
    }
    parcels = None
    if hits.rows and hits.parcel[0] >= 0:
        good = np.isfinite(volume).all(axis=0)
        removed = struck.count[good] * volume[:, good].mean(axis=0)
        rows = (struck.parcel[good], struck.face[good], np.array([removed, removed**2]))
        mass = hits.count * hits.mass
        parcels = Parcels.joined([Parcels(*rows, hits.parcel, mass, mass)])
    return Portion(*_by_face(struck, volume), counts, float(near.max(initial=0.0)), parcels)


def _by_face(struck: Hits, volume: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The faces of rows that have a volume, the `SUMS` of these rows, and ΣwV of each draw."""
    known = np.isfinite(volume).all(axis=0)
    if not known.all():
        struck, volume = struck.part(known), volume[:, known]
    # Rows of one face stay in their order; numpy sorts numbers far faster than it finds their order.
    key = struck.face * struck.rows + np.arange(struck.rows)
    key.sort()
    face, order = np.divmod(key, max(struck.rows, 1))
    begins = np.flatnonzero(np.diff(face, prepend=-1))
    count = struck.count[order]
    removed = count * volume[:, order]
    columns = (
        count,
        count * struck.mass[order],
        removed.mean(axis=0),
        (removed**2).mean(axis=0),
        count * struck.alpha[order],
        count * struck.speed[order],
        np.ones(struck.rows),
    )
    if not begins.size:
        return face, np.array(columns), removed
    # `reduceat` adds the rows of a face in pairs.
    sums = np.array([np.add.reduceat(column, begins) for column in columns])
    return face[begins], sums, np.add.reduceat(removed, begins, axis=1)


class FaceTally:
    """The sums of all rows so far.

    Attributes:
        of_draws: ΣwV of each draw of uncertain parameters and each face, shape (draws, faces) [m³].
        counts, farthest: as of `Portion`.
    """

    def __init__(self, faces: int, draws: int = 1) -> None:
        self._sums, self._errors = np.zeros((2, len(SUMS), faces))
        self.of_draws = np.zeros((draws, faces))
        self.counts = collections.defaultdict[str, np.ndarray](lambda: np.zeros((), np.int64))
        self.farthest = 0.0
        self._parcels, self._held = list[Parcels](), 0

    def add(self, portion: Portion) -> None:
        """Add a portion; the order of portions decides the last bits."""
        faces = portion.faces
        before = self._sums[:, faces]
        after = before + portion.sums
        larger = np.abs(before) >= np.abs(portion.sums)
        self._errors[:, faces] += np.where(larger, (before - after) + portion.sums, (portion.sums - after) + before)
        self._sums[:, faces] = after
        self.of_draws[:, faces] += portion.of_draws
        for name, values in portion.counts.items():
            self.counts[name] = self.counts[name] + values
        self.farthest = max(self.farthest, portion.farthest)
        if portion.parcels is not None:
            self._parcels.append(portion.parcels)
            self._held += len(portion.parcels.known)
            if self._held > 2 * len(self._parcels[0].known) + _HELD:
                self._held = len(self.parcels.known)

    @property
    def parcels(self) -> Parcels:
        """The rows of each parcel; none where the table does not name them."""
        self._parcels = [Parcels.joined(self._parcels)] if self._parcels else []
        return self._parcels[0] if self._parcels else _NO_PARCELS

    @property
    def sums(self) -> dict[str, np.ndarray]:
        """The sums by name, of each face."""
        return dict(zip(SUMS, self._sums + self._errors, strict=True))

    @property
    def rows(self) -> int:
        """All rows."""
        return int(self.counts["fates"].sum())

    @property
    def hits(self) -> int:
        """The rows that hit."""
        return int(self.counts["fates"][HIT])

    @property
    def unnamed(self) -> int:
        """The rows that name no face, whose distance from the nearest is known."""
        return int(self.counts["distances"].sum())

    @property
    def median_distance(self) -> float:
        """The median distance of rows that name no face [m], to 0.3 %; NaN where there are none."""
        index = int(np.searchsorted(np.cumsum(self.counts["distances"]), self.unnamed / 2))
        return 0.0 if index == 0 else float(10 ** (_SHORTEST + (index - 0.5) / _PER_DECADE))
