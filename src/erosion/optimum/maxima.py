"""Every local maximum of a function of the angle, its jumps and its regimes, for many cases at once."""

import dataclasses
from typing import NamedTuple

import numpy as np

from erosion.engine.batch import Results, integrate
from erosion.engine.leaves import Layout
from erosion.engine.outcomes import names_of
from erosion.models.base import NO_CUT
from erosion.optimum.resolve import Cells, Nodes, Scan, is_jump, joined, polish, scan
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.ranges import STEEPEST

SHALLOWEST = 1e-4  # rad; below it a function is continued to its limit as α → 0
ASIDE = 1e-9  # rad; at this distance from a jump every evaluation agrees on the side
TIGHT = 1e-11  # relative tolerance of a polished maximum
_LOOSE = 1e-9  # relative tolerance of the search
_BESIDE = 1e-6  # rad; a maximum nearer to a jump is the jump's own
_LEVEL = 1e-6  # of a function's size, per rad²; with less curvature it is level
_APART = 1e-11  # rad; jumps nearer to one another are one
_FLAT = 1e-6  # of a function's size, per rad: a plateau is no steeper
_MANY = 100  # cases; for fewer it takes longer to compile a program without derivatives than it saves
_ALPHA = list(QUANTITIES).index("alpha")
_GRID = 64  # first angles between 0.02 rad and π/2


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A local maximum of the objective (or minimum, for `alpha_min`), at a jump and at a boundary too.

    Args:
        alpha: its angle [rad]; of a jump 1e-9 beside the jump.
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
            dataclasses.replace(candidate, value=-candidate.value, dvalue=-candidate.dvalue, d2value=-candidate.d2value)
            for candidate in self.candidates
        )
        jumps = tuple(dataclasses.replace(jump, below=-jump.below, above=-jump.above) for jump in self.jumps)
        return dataclasses.replace(self, candidates=candidates, jumps=jumps)


class _Objective(NamedTuple):
    """The objective of many cases at any angle, or its negative: then its minima are maxima."""

    layout: Layout
    numbers: list[np.ndarray]
    cases: int
    negative: bool
    rtol: float

    def __call__(self, case: np.ndarray, alpha: np.ndarray) -> Nodes:
        results = self._integrate(2, case, alpha)
        volume = results.volume
        sign = -1.0 if self.negative else 1.0
        value, slope, curve = (sign * part for part in (volume.value, volume.first, volume.second))
        return Nodes(case, alpha, value, slope, curve, results.time.value, results.outcome)

    def outcomes(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        results = self._integrate(0 if self.cases >= _MANY else 2, case, alpha)
        return results.outcome, results.time.value

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
        self._lanes = layout, numbers, cases, least

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
        for case, candidate in self._on_plateaus(scanned, jumped, candidates):
            candidates[case].append(candidate)
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
        removing = [each for each in candidates if each.ended_by != NO_CUT or each.value != 0 or self.least]
        if not removing:
            # Where impacts failed it is not known whether anything is removed.
            value, ended_by = (0.0, NO_CUT) if certified else (np.nan, "failed")
            return (Candidate(np.nan, value, "none", ended_by, "", True, value, value, 0),)
        return tuple(sorted(removing, key=lambda candidate: -candidate.value))

    def _candidate(self, nodes: Nodes, i: int | np.integer, **fields: str | bool | int) -> Candidate:
        defaults = {"side": "", "attained": True, "steps": 0}
        return Candidate(
            alpha=float(nodes.alpha[i]),
            value=float(nodes.value[i]),
            dvalue=float(nodes.slope[i]),
            d2value=float(nodes.curve[i]),
            ended_by=self.names[nodes.outcome[i]],
            **{**defaults, **fields},
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
        bends &= ~(np.abs(best.alpha - self._nearest_jump(best, scanned, jumped)) < _BESIDE)
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
        aside = np.maximum(ASIDE, cells.width / 2)
        low, high = (self.objective(_LOOSE)(cells.low.case, cells.middle + sign * aside) for sign in (-1, 1))
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
            if nodes.slope[i] < 0:
                candidate = self._candidate(nodes, i, kind="boundary")
                candidates.append((case, candidate if low > 0 else self._limit(candidate)))
            elif low == 0 and self.least:
                candidates.append((case, self._limit(self._candidate(nodes, i, kind="boundary"))))
            if nodes.slope[j] > 0 or self.least:
                # The last node is beside 90°, where an impact may cut what one at 90° does not.
                end, at = (ends, case) if np.isfinite(ends.value[case]) else (nodes, j)
                candidate = self._candidate(end, at, kind="boundary")
                candidates.append((case, dataclasses.replace(candidate, alpha=high)))
        return candidates

    def _nearest_jump(self, nodes: Nodes, scanned: Scan, jumped: np.ndarray) -> np.ndarray:
        """The angle of the nearest jump of the same case [rad], shape (nodes,); infinite without one."""
        jumps = scanned.narrow.low.take(jumped)
        # 10 rad lie between two cases, more than between any two angles of one case.
        angles = np.sort(np.concatenate([jumps.alpha + 10 * jumps.case, [-np.inf, np.inf]]))
        shifted = nodes.alpha + 10 * nodes.case
        i = np.clip(np.searchsorted(angles, shifted), 1, angles.size - 1)
        before, after = angles[i - 1], angles[i]
        return np.where(shifted - before < after - shifted, before, after) - 10 * nodes.case

    def _on_plateaus(
        self, scanned: Scan, jumped: np.ndarray, candidates: list[list[Candidate]]
    ) -> list[tuple[int, Candidate]]:
        """By case, the best node where it is above all candidates.

        There the function is level; or it falls so steeply from a jump that it is lower already
        at the candidate beside the jump; or it has no derivatives, so that no search found its maximum.
        """
        nodes = scanned.nodes
        jumps = self._nearest_jump(nodes, scanned, jumped)
        order = np.lexsort((np.nan_to_num(nodes.value, nan=-np.inf), nodes.case))
        last = np.append(np.flatnonzero(np.diff(nodes.case[order])), order.size - 1)
        plateaus = []
        for case, i in enumerate(order[last]):
            best = max((candidate.value for candidate in candidates[case]), default=-np.inf)
            if nodes.value[i] > best + 1e-8 * scanned.size[case]:
                aside = float(nodes.alpha[i] - jumps[i])
                if abs(aside) < _BESIDE:
                    side = "above" if aside > 0 else "below"
                    candidate = self._candidate(nodes, i, kind="jump", side=side, attained=False)
                elif abs(nodes.slope[i]) <= _FLAT * scanned.size[case]:
                    candidate = self._candidate(nodes, i, kind="plateau")
                else:
                    candidate = self._by_values(nodes, int(i))
                plateaus.append((case, candidate))
        return plateaus

    def _by_values(self, nodes: Nodes, i: int) -> Candidate:
        """The greatest value between the neighbours of a node, without derivatives."""
        near = np.flatnonzero(nodes.case == nodes.case[i])
        near = near[np.abs(near - i) <= 1]
        low, high = float(nodes.alpha[near[0]]), float(nodes.alpha[near[-1]])
        evaluate = self.objective(_LOOSE)
        best, steps = nodes.take(np.array([i])), 0
        while high - low > _BESIDE:
            angles = np.linspace(low, high, 17)
            new = evaluate(np.full(angles.size, nodes.case[i]), angles)
            steps += 1
            j = int(np.argmax(np.nan_to_num(new.value, nan=-np.inf)))
            best = max(best, new.take(np.array([j])), key=lambda node: node.value[0])
            low, high = angles[max(j - 1, 0)], angles[min(j + 1, 16)]
        return self._candidate(best, 0, kind="unresolved", steps=steps)

    def _limit(self, first: Candidate) -> Candidate:
        """The supremum as α → 0, continued from the shallowest node."""
        h = first.alpha
        value = first.value - h * first.dvalue + h**2 / 2 * first.d2value
        # α dV/dα over V is the exponent of a power; with a negative exponent there is no limit.
        if abs(h * first.dvalue) > 0.01 * abs(first.value) and first.dvalue < 0:
            value = np.inf
        return dataclasses.replace(first, alpha=0.0, value=value, attained=False)

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


def _side_by_side_merged(cells: Cells) -> Cells:
    """Narrow cells, where those of a case that nearly touch are one: rounding alone tells them apart."""
    order = np.lexsort((cells.low.alpha, cells.low.case))
    low, high = cells.low.take(order), cells.high.take(order)
    begins = np.ones(order.size, bool)
    begins[1:] = (np.diff(low.case) != 0) | (low.alpha[1:] - high.alpha[:-1] > _APART)
    ends = np.append(np.flatnonzero(begins)[1:], order.size) - 1 if order.size else order
    return Cells(low.take(np.flatnonzero(begins)), high.take(ends))


def _first_angles(low: float, high: float) -> np.ndarray:
    """The first nodes [rad]: geometric near 0, where functions may be powers; then even."""
    # At π/2 itself an impact without spin cuts nothing: its neighbour stands for the limit.
    low, high = max(low, SHALLOWEST), min(high, STEEPEST - 1e-10)
    even = np.linspace(0.02, high, _GRID) if low < 0.02 < high else np.linspace(low, high, _GRID)
    near_zero = np.geomspace(low, 0.02, 14)[:-1] if low < 0.02 < high else []
    return np.concatenate([near_zero, even])
