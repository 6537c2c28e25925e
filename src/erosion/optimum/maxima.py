"""Every local maximum of a function of the angle, its jumps and its regimes, for many cases at once."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from erosion.array_types import PerImpact
from erosion.engine.batch import Results, integrate
from erosion.engine.leaves import Layout
from erosion.engine.outcomes import names_of
from erosion.models.base import NO_CUT
from erosion.optimum.resolve import Cells, Nodes, Scan, is_jump, joined, polish, reach, scan
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.ranges import STEEPEST

SHALLOWEST = 1e-6  # rad; below it a function is continued to its limit as α → 0
ASIDE = 1e-9  # rad; at this distance from a jump every evaluation agrees on the side
TIGHT = 1e-11  # relative tolerance of a polished maximum
_LOOSE = 1e-9  # relative tolerance of the search
_ROUNDING = 1e-11  # of a function: what its slope near 0 adds over the angle, where it is rounding
_BESIDE = 1e-6  # rad; a maximum nearer to a jump is the jump's own
_LEVEL = 1e-6  # of a function's size, per rad²; with less curvature it is level
_APART = 1e-11  # rad; jumps nearer to one another are one
_FLAT = 1e-6  # of a function's size, per rad: a plateau is no steeper
_SAME = 1e-9  # of a function's size: by no more values differ on a plateau
_LONG = 1e-3  # rad; a plateau is no shorter, or has half of the range
_ALPHA = list(QUANTITIES).index("alpha")
_GRID = 64  # first angles between 0.02 rad and π/2
_SERIES = 1e-4  # rad; from here to 0 two terms of a series continue a function
_CHANGE = 0.01  # of a function: if its slope adds more over the angle, it is a power of the angle
_BEND = 0.02  # rad; below, the first angles are closer together


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A local maximum of the objective (or minimum, for `alpha_min`), at a jump and at a boundary too.

    Args:
        alpha: its angle [rad]; of a jump 1e-9 beside the jump; of a plateau the middle.
        low, high: the ends of a plateau [rad]; else both are `alpha`.
        value: the objective there.
        kind: "interior", "jump", "boundary", "kink", "plateau" or "unresolved"; see `Optimum`.
        ended_by: how the cut ends there.
        side: the side of a jump in angle, "below" or "above"; else "".
        attained: whether `value` is reached. At a jump the impact that just grazes belongs
            to the side where the cut ends earlier; the other side only approaches its value.
            The limit as α → 0 is not reached either.
        dvalue, d2value: derivatives of the objective by the angle there [per rad, per rad²].
        steps: evaluations that polished the angle.
    """

    alpha: float
    low: float
    high: float
    value: float
    kind: str
    ended_by: str
    side: str
    attained: bool
    dvalue: float
    d2value: float
    steps: int


@dataclasses.dataclass(frozen=True)
class Jump:
    """A discontinuity of the objective, bracketed to 1e-11 rad.

    Args:
        alpha: its angle [rad].
        below, above: the objective on either side, 2e-10 rad beside it.
        ended_below, ended_above: how the cut ends on either side.
    """

    alpha: float
    below: float
    above: float
    ended_below: str
    ended_above: str


@dataclasses.dataclass(frozen=True)
class Regime:
    """A range of angles in which every cut ends in the same way.

    Args:
        low, high: the range [rad].
        ended_by: how the cuts end.
    """

    low: float
    high: float
    ended_by: str


@dataclasses.dataclass(frozen=True)
class Maxima:
    """The maxima of one case.

    Args:
        candidates: best first, at least one.
        jumps, regimes: by angle.
        rounds: of refinement.
        certified: whether every impact succeeded, with its derivatives.
    """

    candidates: tuple[Candidate, ...]
    jumps: tuple[Jump, ...]
    regimes: tuple[Regime, ...]
    rounds: int
    certified: bool

    def negated(self) -> "Maxima":
        """The minima of a function, from the maxima of its negative."""
        candidates = tuple(
            dataclasses.replace(
                candidate, value=0.0 - candidate.value, dvalue=-candidate.dvalue, d2value=-candidate.d2value
            )
            for candidate in self.candidates
        )
        jumps = tuple(dataclasses.replace(jump, below=0.0 - jump.below, above=0.0 - jump.above) for jump in self.jumps)
        return dataclasses.replace(self, candidates=candidates, jumps=jumps)


class _Objective(NamedTuple):
    """The objective of many cases at any angle, or its negative: then its minima are maxima."""

    layout: Layout
    numbers: list[np.ndarray]
    negative: bool
    rtol: float

    def __call__(self, case: np.ndarray, alpha: np.ndarray) -> Nodes:
        results = self._integrate(2, case, alpha)
        volume = results.volume
        sign = -1.0 if self.negative else 1.0
        value, slope, curve = (sign * part for part in (volume.value, volume.first, volume.second))
        # Near 0 a slope is known to rounding over the angle.
        rounding = (reach(alpha) < 1) & (np.abs(alpha * slope) <= _ROUNDING * np.abs(value))
        slope = np.where(rounding, 0.0, slope)
        return Nodes(case, alpha, value, slope, curve, results.time.value, results.outcome)

    def outcomes(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        results = self._integrate(0, case, alpha)
        return results.outcome, results.time.value, results.volume.value

    def _integrate(self, order: int, case: np.ndarray, alpha: np.ndarray) -> Results:
        lanes = self.layout.of_lanes(self.numbers, case)
        lanes[_ALPHA] = alpha
        along = ("alpha",) if order else ()
        return integrate(self.layout, lanes, alpha.size, order, along, self.rtol, again=False)


class Search:
    """The optima of many cases at once. Within the search all optima are maxima.

    Args:
        layout: of model and case.
        numbers: the leaves of the cases, each of shape (cases, …), or of one case's shape where all share it.
        cases: number of cases.
        least: whether minima are searched.
    """

    def __init__(self, layout: Layout, numbers: list[np.ndarray], cases: int, *, least: bool) -> None:
        self.cases, self.least = cases, least
        self.names = names_of(layout)
        self._lanes = layout, numbers, least

    def objective(self, rtol: float) -> _Objective:
        """The function whose maxima are searched, at a relative tolerance."""
        return _Objective(*self._lanes, rtol)

    def optima(self, low: float, high: float) -> list[Maxima]:
        """The maxima of each case (or its minima) over the angles from `low` to `high` [rad]."""
        scanned = scan(self.objective(_LOOSE), self.objective(TIGHT), self.cases, _first_angles(low, high))
        scanned = scanned._replace(narrow=_side_by_side_merged(scanned.narrow))
        certified = scanned.unresolved == 0
        jumped = is_jump(scanned.narrow, scanned.size[scanned.narrow.low.case])
        candidates: list[list[Candidate]] = [[] for _ in range(self.cases)]
        for case, candidate in [
            *self._interior(scanned, jumped),
            *self.at_jumps(scanned, jumped),
            *self._at_boundaries(scanned, low, high),
        ]:
            candidates[case].append(candidate)
        for case, candidate in self._at_best_nodes(scanned, jumped, candidates):
            candidates[case].append(candidate)
        for case, plateau in self._plateaus(scanned, candidates, low, high):
            outside = [each for each in candidates[case] if not plateau.low <= each.alpha <= plateau.high]
            candidates[case] = [plateau, *outside]
        jumps, regimes = self._jumps(scanned, jumped), self._regimes(scanned, low, high)
        maxima = [
            Maxima(
                self._ranked(candidates[case], bool(certified[case])),
                jumps[case],
                regimes[case],
                int(scanned.rounds[case]),
                bool(certified[case]),
            )
            for case in range(self.cases)
        ]
        return [of_case.negated() for of_case in maxima] if self.least else maxima

    def _ranked(self, candidates: list[Candidate], certified: bool) -> tuple[Candidate, ...]:
        # An impact that cuts nothing may remove something at contact.
        known = [each for each in candidates if not np.isnan(each.value)]
        removing = [each for each in known if each.ended_by != NO_CUT or each.value != 0 or self.least]
        if not removing:
            # Where impacts failed it is not known whether anything is removed.
            value, ended_by = (0.0, NO_CUT) if certified else (np.nan, "failed")
            return (Candidate(np.nan, np.nan, np.nan, value, "none", ended_by, "", True, value, value, 0),)
        return tuple(sorted(removing, key=lambda candidate: (-candidate.value, not candidate.attained)))

    def _candidate(self, nodes: Nodes, i: int | np.integer, **fields: Any) -> Candidate:
        defaults: dict[str, Any] = _at(float(nodes.alpha[i])) | {"side": "", "attained": True, "steps": 0}
        return Candidate(
            value=float(nodes.value[i]),
            dvalue=float(nodes.slope[i]),
            d2value=float(nodes.curve[i]),
            ended_by=self.names[nodes.outcome[i]],
            **(defaults | fields),
        )

    def _interior(self, scanned: Scan, jumped: np.ndarray) -> list[tuple[int, Candidate]]:
        """By case, the maxima in smooth cells, and at kinks."""
        cells = Cells._make(map(joined, scanned.smooth, scanned.narrow.take(~jumped)))
        cells = cells.take((cells.low.slope > 0) & (cells.high.slope <= 0))
        best, steps = polish(self.objective(TIGHT), cells)
        # Where the function is level, its slope falls through zero by rounding.
        bends = best.curve < -_LEVEL * scanned.size[best.case]
        # An angle known to some 1e-11 leaves that much of the curvature in the slope.
        flat = np.abs(best.slope) <= 1e-6 * scanned.size[best.case] + 1e-10 * np.abs(best.curve)
        # At a kink the side whose node is kept may be bent upward: its slope falls through zero at once.
        bends |= ~flat
        bends &= ~(np.abs(best.alpha - self._nearest_jump(best, scanned, jumped)) < _BESIDE * reach(best.alpha))
        return [
            (int(case), self._candidate(best, i, kind="interior" if flat[i] else "kink", steps=int(steps[i])))
            for i, case in enumerate(best.case)
            if bends[i]
        ]

    def at_jumps(self, scanned: Scan, jumped: np.ndarray) -> list[tuple[int, Candidate]]:
        """By case, the jumps whose higher side rises towards the jump.

        Args:
            scanned: the resolved functions.
            jumped: the narrow cells that hold a jump, shape (cells,).
        """
        cells = scanned.narrow.take(jumped)
        aside = np.maximum(ASIDE * reach(cells.low.alpha), cells.width / 2)
        range_ = scanned.nodes.alpha.min(), scanned.nodes.alpha.max()
        low, high = (
            self.objective(_LOOSE)(cells.low.case, np.clip(cells.middle + sign * aside, *range_)) for sign in (-1, 1)
        )
        candidates = []
        for i, case in enumerate(low.case):
            if low.value[i] > high.value[i] and not low.slope[i] < 0:
                side, higher, lower = "below", low, high
            elif high.value[i] > low.value[i] and not high.slope[i] > 0:
                side, higher, lower = "above", high, low
            else:
                continue
            attained = bool(higher.time[i] < lower.time[i])
            candidates.append((int(case), self._candidate(higher, i, kind="jump", side=side, attained=attained)))
        return candidates

    def _at_boundaries(self, scanned: Scan, low: float, high: float) -> list[tuple[int, Candidate]]:
        """By case, the ends of the range that the function rises towards."""
        nodes = scanned.nodes
        first = np.flatnonzero(np.diff(nodes.case, prepend=-1))
        last = np.append(first[1:], nodes.case.size) - 1
        ends = self.objective(_LOOSE)(np.arange(self.cases), np.full(self.cases, high))
        candidates = []
        for case, (i, j) in enumerate(zip(first, last, strict=True)):
            # Where a function is level at an end, its next node says where it goes.
            inner, before = min(i + 1, j), max(j - 1, i)
            falls = nodes.slope[i] < 0 or (nodes.slope[i] == 0 and nodes.slope[inner] <= 0)
            rises = nodes.slope[j] > 0 or (nodes.slope[j] == 0 and nodes.slope[before] >= 0)
            if low > 0 and falls:
                candidates.append((case, self._candidate(nodes, i, kind="boundary")))
            elif low == 0 and (falls or self.least):
                candidates.append((case, self._limit(nodes, i, inner)))
            if rises or self.least:
                # The last node is beside 90°, where an impact may cut what one at 90° does not.
                end, at = (ends, case) if np.isfinite(ends.value[case]) else (nodes, j)
                candidates.append((case, self._candidate(end, at, kind="boundary", **_at(high))))
        return candidates

    def _limit(self, nodes: Nodes, first: int | np.integer, second: int | np.integer) -> Candidate:
        """The supremum as α → 0, continued from the shallowest node, or from the next if that is shallow enough."""
        at = (
            second
            if nodes.alpha[second] <= _SERIES
            and abs(nodes.alpha[first] * nodes.slope[first]) <= _CHANGE * abs(nodes.value[first])
            else first
        )
        value = float(limit_at_zero(nodes.alpha[at], nodes.value[at], nodes.slope[at], nodes.curve[at]))
        return dataclasses.replace(self._candidate(nodes, at, kind="boundary"), **_at(0.0), value=value, attained=False)

    def _nearest_jump(self, nodes: Nodes, scanned: Scan, jumped: np.ndarray) -> np.ndarray:
        """The angle of the nearest jump of the same case [rad], shape (nodes,); infinite without one."""
        jumps = scanned.narrow.low.take(jumped)
        jumps = jumps.take(np.lexsort((jumps.alpha, jumps.case)))
        # 10 rad lie between two cases, more than between any two angles of one case.
        at = np.searchsorted(jumps.alpha + 10 * jumps.case, nodes.alpha + 10 * nodes.case)
        case, alpha = (np.append(column, [-1, -1]) for column in (jumps.case, jumps.alpha))
        before = np.where(case[at - 1] == nodes.case, alpha[at - 1], -np.inf)
        after = np.where(case[at] == nodes.case, alpha[at], np.inf)
        return np.where(nodes.alpha - before < after - nodes.alpha, before, after)

    def _at_best_nodes(
        self, scanned: Scan, jumped: np.ndarray, candidates: list[list[Candidate]]
    ) -> list[tuple[int, Candidate]]:
        """By case, the best node where it is above all candidates.

        There the function falls so steeply from a jump that it is lower already at the candidate
        beside the jump; or it has no derivatives, so that no search found its maximum.
        """
        nodes = scanned.nodes
        jumps, near = self._nearest_jump(nodes, scanned, jumped), _BESIDE * reach(nodes.alpha)
        best = []
        for case, i in enumerate(_greatest(nodes)):
            above = (
                max((candidate.value for candidate in candidates[case]), default=-np.inf) + 1e-8 * scanned.size[case]
            )
            # A level function is a plateau, see there.
            if nodes.value[i] > above and not abs(nodes.slope[i]) <= _FLAT * scanned.size[case]:
                aside = float(nodes.alpha[i] - jumps[i])
                if abs(aside) < near[i]:
                    side = "above" if aside > 0 else "below"
                    candidate = self._candidate(nodes, i, kind="jump", side=side, attained=False)
                else:
                    candidate = self._by_values(nodes, int(i))
                best.append((case, candidate))
        return best

    def _plateaus(
        self, scanned: Scan, candidates: list[list[Candidate]], low: float, high: float
    ) -> list[tuple[int, Candidate]]:
        """By case, the widest range of angles in which all values are the greatest one, if there is one."""
        nodes = scanned.nodes
        greatest, size = nodes.value[_greatest(nodes)], scanned.size
        peak = np.array([max((each.value for each in of_case), default=-np.inf) for of_case in candidates])
        lowest = np.fmax(greatest, np.where(np.isfinite(peak), peak, -np.inf)) - _SAME * size
        level = (nodes.value >= lowest[nodes.case]) & (np.abs(nodes.slope) <= _FLAT * size[nodes.case])
        linked = level[:-1] & level[1:] & (nodes.case[:-1] == nodes.case[1:])
        begins = np.flatnonzero(linked & ~np.append(False, linked[:-1]))
        ends = np.flatnonzero(linked & ~np.append(linked[1:], False)) + 1
        long = nodes.alpha[ends] - nodes.alpha[begins] >= min(_LONG, np.ptp(nodes.alpha) / 2)
        begins, ends = begins[long], ends[long]
        if not begins.size:
            return []
        firsts, lasts = (self._level_until(nodes, at, step, lowest) for at, step in ((begins, -1), (ends, 1)))
        case = nodes.case[begins]
        firsts = np.where(firsts == nodes.alpha.min(), low, firsts)
        lasts = np.where(lasts == nodes.alpha.max(), high, lasts)
        middle = self.objective(TIGHT)(case, (firsts + lasts) / 2)
        widest = {}
        for i in np.argsort(lasts - firsts, kind="stable"):
            extent = {"low": float(firsts[i]), "high": float(lasts[i])}
            widest[int(case[i])] = self._candidate(middle, i, kind="plateau", **extent)
        return list(widest.items())

    def _level_until(self, nodes: Nodes, at: np.ndarray, step: int, lowest: np.ndarray) -> np.ndarray:
        """The angles until which the functions are level, from a node down (step -1) or up (1), shape (cells,)."""
        case, level = nodes.case[at], nodes.alpha[at].copy()
        beside = np.clip(at + step, 0, nodes.case.size - 1)
        lower = np.where(nodes.case[beside] == case, nodes.alpha[beside], level)
        evaluate = self.objective(TIGHT)
        while (wide := np.flatnonzero(np.abs(level - lower) > _APART)).size:
            angles = np.linspace(level[wide], lower[wide], 17)
            values = evaluate(np.tile(case[wide], 15), angles[1:-1].ravel()).value.reshape(15, wide.size)
            falls = np.append(~(values >= lowest[case[wide]]), np.ones((1, wide.size), bool), axis=0)
            first, column = np.argmax(falls, axis=0), np.arange(wide.size)
            level[wide], lower[wide] = angles[first, column], angles[first + 1, column]
        return level

    def _by_values(self, nodes: Nodes, i: int) -> Candidate:
        """The greatest value between the neighbours of a node, without derivatives."""
        near = np.flatnonzero(nodes.case == nodes.case[i])
        near = near[np.abs(near - i) <= 1]
        low, high = float(nodes.alpha[near[0]]), float(nodes.alpha[near[-1]])
        evaluate = self.objective(_LOOSE)
        best, steps = nodes.take(np.array([i])), 0
        narrow = _BESIDE * float(np.max(reach(nodes.alpha[near])))
        while high - low > narrow:
            angles = np.linspace(low, high, 17)
            new = evaluate(np.full(angles.size, nodes.case[i]), angles)
            steps += 1
            j = int(np.argmax(np.nan_to_num(new.value, nan=-np.inf)))
            best = max(best, new.take(np.array([j])), key=lambda node: node.value[0])
            low, high = angles[max(j - 1, 0)], angles[min(j + 1, 16)]
        return self._candidate(best, 0, kind="unresolved", steps=steps)

    def _jumps(self, scanned: Scan, jumped: np.ndarray) -> list[tuple[Jump, ...]]:
        """The jumps of each case, by angle."""
        low, high = cells = scanned.narrow.take(jumped)
        jumps: list[list[Jump]] = [[] for _ in range(self.cases)]
        for i in np.argsort(cells.middle):
            jump = Jump(
                alpha=float(cells.middle[i]),
                below=float(low.value[i]),
                above=float(high.value[i]),
                ended_below=self.names[low.outcome[i]],
                ended_above=self.names[high.outcome[i]],
            )
            jumps[low.case[i]].append(jump)
        return [tuple(of_case) for of_case in jumps]

    def _regimes(self, scanned: Scan, low: float, high: float) -> list[tuple[Regime, ...]]:
        """The regimes of each case, by angle."""
        cells = scanned.narrow.take(scanned.narrow.outcome_changes)
        nodes = scanned.nodes
        first = nodes.outcome[np.flatnonzero(np.diff(nodes.case, prepend=-1))]
        regimes = [[Regime(low, high, self.names[outcome])] for outcome in first]
        for i in np.argsort(cells.middle):
            of_case, change = regimes[cells.low.case[i]], float(cells.middle[i])
            of_case[-1] = dataclasses.replace(of_case[-1], high=change)
            of_case.append(Regime(change, high, self.names[cells.high.outcome[i]]))
        return [tuple(of_case) for of_case in regimes]


def _at(alpha: float) -> dict[str, Any]:
    """The angle of a candidate that is no plateau."""
    return {"alpha": alpha, "low": alpha, "high": alpha}


def _greatest(nodes: Nodes) -> np.ndarray:
    """The node of each case with the greatest value, shape (cases,)."""
    value = np.where(np.isnan(nodes.value), -np.inf, nodes.value)
    peak = np.maximum.reduceat(value, np.flatnonzero(np.diff(nodes.case, prepend=-1)))
    greatest = np.flatnonzero(value == peak[nodes.case])
    return greatest[np.flatnonzero(np.diff(nodes.case[greatest], append=-1))]


def shallowest(high: float) -> float:
    """The least angle [rad] that is computed of a range from 0 to `high`."""
    return min(SHALLOWEST, high / 100)


def limit_at_zero(alpha: PerImpact, value: PerImpact, slope: PerImpact, curve: PerImpact) -> PerImpact:
    """The limit of a function as α → 0, from its value and derivatives at a shallow angle.

    It is a limit plus a power of the angle there, or two terms of a series.
    """
    rise = alpha * slope
    with np.errstate(all="ignore"):
        power = 1 + np.divide(alpha * curve, slope)
        series = value - rise + alpha**2 / 2 * curve
        of_power = np.where(power > 0, value - rise / power, -np.sign(rise) * np.inf)
    changes = np.abs(rise) > _CHANGE * np.abs(value)
    limit = np.where(changes, of_power, series)
    # What has risen from less than a tenth has risen from 0.
    return np.where(changes & (np.abs(limit) < 0.1 * np.abs(value)), 0.0, limit)[()]


def _side_by_side_merged(cells: Cells) -> Cells:
    """Narrow cells, where those of a case that nearly touch are one: rounding alone tells them apart."""
    order = np.lexsort((cells.low.alpha, cells.low.case))
    low, high = cells.low.take(order), cells.high.take(order)
    begins = np.ones(order.size, bool)
    begins[1:] = (np.diff(low.case) != 0) | (low.alpha[1:] - high.alpha[:-1] > _APART)
    ends = np.append(np.flatnonzero(begins)[1:], order.size) - 1 if order.size else order
    return Cells(low.take(np.flatnonzero(begins)), high.take(ends))


def _first_angles(low: float, high: float) -> np.ndarray:
    """The first nodes [rad], all within the range: geometric near 0, where functions may be powers; then even."""
    low = low or shallowest(high)
    # At π/2 itself an impact without spin cuts nothing: its neighbour stands for the limit.
    high = min(high, max(STEEPEST - 1e-10, (low + STEEPEST) / 2))
    if high <= _BEND:
        angles = np.geomspace(low, high, _GRID)
    elif low >= _BEND:
        angles = np.linspace(low, high, _GRID)
    else:
        near_zero = np.geomspace(max(low, _SERIES), _BEND, 14)[:-1]
        angles = np.concatenate([[low], near_zero, np.linspace(_BEND, high, _GRID)])
    # In the narrowest ranges neighbours are the same number.
    return np.unique(np.clip(angles, low, high))
