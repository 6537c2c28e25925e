"""Every local maximum of a function of the angle, its jumps and its regimes, for many cases at once."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from erosion.engine.batch import Results, integrate
from erosion.engine.leaves import Layout
from erosion.engine.outcomes import names_of
from erosion.optimum.resolve import Cells, Nodes, Scan, is_jump, joined, polish, scan
from erosion.parameters.parameters import QUANTITIES

SHALLOWEST = 1e-4  # rad; below it a function is continued to its limit as α → 0
STEEPEST = np.pi / 2
_BESIDE = 1e-6  # rad; a maximum so near a jump is the jump's own
ASIDE = 1e-9  # rad; so far beside a jump any evaluation agrees on which side it is
_LOOSE = 1e-9  # relative tolerance of the search
TIGHT = 1e-11  # relative tolerance where an answer is polished
_LEVEL = 1e-6  # of a function's size, per rad²
_MANY = 100  # cases, for which it pays to compile a second program, without derivatives
_ALPHA = list(QUANTITIES).index("alpha")
_GRID = 64  # angles of the first look between 0.02 rad and π/2


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A local maximum, or one that the range or a jump cuts off.

    Args:
        alpha: its angle [rad]; at a jump 1e-9 beside it, where any evaluation agrees on the side.
        value: of the objective there.
        kind: "interior", "jump", "boundary", "kink" or "plateau"; see `Optimum`.
        ended_by: how the cut ends there.
        side: at a jump "below" or "above" it in angle; else "".
        attained: whether `value` is reached. At a jump the impact that just grazes belongs
            to the side where the cut ends earlier, and the other side's supremum is not
            reached; nor is the limit as α → 0.
        dvalue, d2value: derivatives by the angle there.
        steps: evaluations that the polishing took.
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
    """A range of angles over which the cut ends the same way, between jumps and kinks.

    Args:
        low, high: the range [rad].
        ended_by: how the cut ends in it.
    """

    low: float
    high: float
    ended_by: str


@dataclasses.dataclass(frozen=True)
class Maxima:
    """What is known of one case.

    Args:
        candidates: best first, at least one.
        jumps, regimes: by angle.
        rounds: of refinement.
        certified: whether every impact succeeded.
    """

    candidates: tuple[Candidate, ...]
    jumps: tuple[Jump, ...]
    regimes: tuple[Regime, ...]
    rounds: int
    certified: bool


class _At(NamedTuple):
    """The volumes of many cases at any angle; with a sign, so that all optima are maxima."""

    layout: Layout
    numbers: list[np.ndarray]
    cases: int
    sign: float
    rtol: float

    def __call__(self, case: np.ndarray, alpha: np.ndarray) -> Nodes:
        results = self._integrate(2, case, alpha)
        volume = results.volume
        value, slope, curve = (self.sign * part for part in (volume.value, volume.first, volume.second))
        return Nodes(case, alpha, value, slope, curve, results.time.value, results.outcome)

    def ends(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # For few cases it would take longer to compile another program than it saves.
        results = self._integrate(0 if self.cases >= _MANY else 2, case, alpha)
        return results.outcome, results.time.value

    def _integrate(self, order: int, case: np.ndarray, alpha: np.ndarray) -> Results:
        lanes = self.layout.of_lanes(self.numbers, case)
        lanes[_ALPHA] = alpha
        along = ("alpha",) if order else ()
        return integrate(self.layout, lanes, alpha.size, order, along, self.rtol, again=False)


class Search:
    """The optima of many cases at once; values carry a sign, so that all are maxima.

    Args:
        layout: of model and case.
        numbers: of the cases: each an array (cases,), or of one's shape where all share it.
        cases: how many there are.
        sign: -1 for minima.
    """

    def __init__(self, layout: Layout, numbers: list[np.ndarray], cases: int, sign: float) -> None:
        self.sign, self.cases = sign, cases
        self.names = names_of(layout)
        self._lanes = layout, numbers, cases, sign

    def _at(self, rtol: float) -> _At:
        return _At(*self._lanes, rtol)

    def maxima(self, low: float, high: float) -> list[Maxima]:
        """Of each case, over the angles from `low` to `high` [rad]."""
        cases = self.cases
        found = scan(self._at(_LOOSE), self._at(TIGHT), cases, _first_look(low, high))
        certified = found.unresolved == 0
        jumped = is_jump(found.narrow, found.size[found.narrow.low.case])
        candidates: list[list[Candidate]] = [[] for _ in range(cases)]
        for case, candidate in [
            *self._interior(found, jumped),
            *self._at_jumps(found, jumped),
            *self._at_ends(found, low, high),
        ]:
            candidates[case].append(candidate)
        for case, candidate in self._on_plateaus(found, jumped, candidates):
            candidates[case].append(candidate)
        jumps, regimes = self._jumps(found, jumped, cases), self._regimes(found, cases, low, high)
        return [
            Maxima(
                self._ranked(candidates[case], bool(certified[case])),
                jumps[case],
                regimes[case],
                int(found.rounds[case]),
                bool(certified[case]),
            )
            for case in range(cases)
        ]

    def _ranked(self, candidates: list[Candidate], certified: bool) -> tuple[Candidate, ...]:
        cutting = [c for c in candidates if c.ended_by != "no-cut" or self.sign < 0]
        if not cutting:
            # Where impacts failed nothing is known, not even that nothing is cut.
            value, end = (0.0, "no-cut") if certified else (np.nan, "failed")
            return (Candidate(np.nan, value, "none", end, "", True, value, value, 0),)
        return tuple(sorted(cutting, key=lambda c: -self.sign * c.value))

    def _candidate(self, nodes: Nodes, i: Any, **more: Any) -> Candidate:
        defaults = {"side": "", "attained": True, "steps": 0}
        return Candidate(
            alpha=float(nodes.alpha[i]),
            value=float(self.sign * nodes.value[i]),
            dvalue=float(self.sign * nodes.slope[i]),
            d2value=float(self.sign * nodes.curve[i]),
            ended_by=self.names[nodes.end[i]],
            **{**defaults, **more},
        )

    def _interior(self, found: Scan, jumped: np.ndarray) -> list[tuple[int, Candidate]]:
        cells = Cells._make(joined(a, b.take(~jumped)) for a, b in zip(found.smooth, found.narrow, strict=True))
        falls = (cells.low.slope > 0) & (cells.high.slope <= 0)
        cells = Cells._make(side.take(falls) for side in cells)
        best, steps = polish(self._at(TIGHT), cells)
        # Where the function is level, its slope falls through zero by rounding.
        bends = best.curve < -_LEVEL * found.size[best.case]
        # An angle known to some 1e-11 leaves that much of the curvature in the slope.
        flat = np.abs(best.slope) <= 1e-6 * found.size[best.case] + 1e-10 * np.abs(best.curve)
        bends &= ~(np.abs(best.alpha - self._nearest_jump(best, found, jumped)) < _BESIDE)
        return [
            (int(case), self._candidate(best, i, kind="interior" if flat[i] else "kink", steps=int(steps[i])))
            for i, case in enumerate(best.case)
            if bends[i]
        ]

    def _at_jumps(self, found: Scan, jumped: np.ndarray) -> list[tuple[int, Candidate]]:
        cells = Cells._make(side.take(jumped) for side in found.narrow)
        aside = np.maximum(ASIDE, cells.width / 2)
        low, high = (self._at(_LOOSE)(cells.low.case, cells.middle + way * aside) for way in (-1, 1))
        candidates = []
        for i, case in enumerate(low.case):
            # Only a side that rises towards the jump, to more than there is beyond it.
            if low.value[i] > high.value[i] and low.slope[i] >= 0:
                side, here, beyond = "below", low, high
            elif high.value[i] > low.value[i] and high.slope[i] <= 0:
                side, here, beyond = "above", high, low
            else:
                continue
            attained = bool(here.time[i] < beyond.time[i])
            candidates.append((int(case), self._candidate(here, i, kind="jump", side=side, attained=attained)))
        return candidates

    def _at_ends(self, found: Scan, low: float, high: float) -> list[tuple[int, Candidate]]:
        nodes = found.nodes
        first = np.flatnonzero(np.diff(nodes.case, prepend=-1))
        last = np.append(first[1:], nodes.case.size) - 1
        ends = []
        for case, (i, j) in enumerate(zip(first, last, strict=True)):
            if nodes.slope[i] < 0:
                candidate = self._candidate(nodes, i, kind="boundary")
                ends.append((case, candidate if low > 0 else self._limit(candidate)))
            elif low == 0 and self.sign < 0:
                ends.append((case, self._limit(self._candidate(nodes, i, kind="boundary"))))
            if nodes.slope[j] > 0 or self.sign < 0:
                candidate = self._candidate(nodes, j, kind="boundary")
                ends.append((case, dataclasses.replace(candidate, alpha=high)))
        return ends

    def _nearest_jump(self, nodes: Nodes, found: Scan, jumped: np.ndarray) -> np.ndarray:
        """The angle of the jump of the same case that is nearest to each node; infinite without one."""
        jumps = found.narrow.low.take(jumped)
        # Cases lie too far apart to be taken for one another.
        marks = np.sort(np.concatenate([jumps.alpha + 10 * jumps.case, [-np.inf, np.inf]]))
        place = nodes.alpha + 10 * nodes.case
        after = np.clip(np.searchsorted(marks, place), 1, marks.size - 1)
        before, after = marks[after - 1], marks[after]
        return np.where(place - before < after - place, before, after) - 10 * nodes.case

    def _on_plateaus(
        self, found: Scan, jumped: np.ndarray, candidates: list[list[Candidate]]
    ) -> list[tuple[int, Candidate]]:
        """The best node where it is above all candidates.

        There the function is level; or so steep beside a jump that it is less already where
        any evaluation agrees on the side.
        """
        nodes = found.nodes
        jumps = self._nearest_jump(nodes, found, jumped)
        order = np.lexsort((np.nan_to_num(nodes.value, nan=-np.inf), nodes.case))
        last = np.append(np.flatnonzero(np.diff(nodes.case[order])), order.size - 1)
        plateaus = []
        for case, i in enumerate(order[last]):
            best = max((self.sign * c.value for c in candidates[case]), default=-np.inf)
            if nodes.value[i] > best + 1e-8 * found.size[case]:
                aside = float(nodes.alpha[i] - jumps[i])
                if abs(aside) < _BESIDE:
                    side = "above" if aside > 0 else "below"
                    candidate = self._candidate(nodes, i, kind="jump", side=side, attained=False)
                else:
                    candidate = self._candidate(nodes, i, kind="plateau")
                plateaus.append((case, candidate))
        return plateaus

    def _limit(self, first: Candidate) -> Candidate:
        """The supremum as α → 0, continued from the shallowest angle of the scan."""
        h = first.alpha
        value = first.value - h * first.dvalue + h**2 / 2 * first.d2value
        # α dV/dα over V is the power with which a function without a limit grows.
        if abs(h * first.dvalue) > 0.01 * abs(first.value) and self.sign * first.dvalue < 0:
            value = self.sign * np.inf
        return dataclasses.replace(first, alpha=0.0, value=value, attained=False)

    def _jumps(self, found: Scan, jumped: np.ndarray, cases: int) -> list[tuple[Jump, ...]]:
        cells = Cells._make(side.take(jumped) for side in found.narrow)
        ends = [[self.names[end] for end in side.end] for side in cells]
        values = [self.sign * side.value for side in cells]
        jumps: list[list[Jump]] = [[] for _ in range(cases)]
        middle = cells.middle
        for i in np.argsort(middle):
            below, above = (float(value[i]) for value in values)
            jumps[cells.low.case[i]].append(Jump(float(middle[i]), below, above, ends[0][i], ends[1][i]))
        return [tuple(some) for some in jumps]

    def _regimes(self, found: Scan, cases: int, low: float, high: float) -> list[tuple[Regime, ...]]:
        changes = found.narrow.low.end != found.narrow.high.end
        cells = Cells._make(side.take(changes) for side in found.narrow)
        first = found.nodes.end[np.flatnonzero(np.diff(found.nodes.case, prepend=-1))]
        regimes = [[Regime(low, high, self.names[end])] for end in first]
        middle = cells.middle
        for i in np.argsort(middle):
            some, at = regimes[cells.low.case[i]], float(middle[i])
            some[-1] = dataclasses.replace(some[-1], high=at)
            some.append(Regime(at, high, self.names[cells.high.end[i]]))
        return [tuple(some) for some in regimes]


def _first_look(low: float, high: float) -> np.ndarray:
    """Angles to begin with: geometric near 0, where functions may be powers; then even."""
    # At π/2 itself an impact without spin cuts nothing: its neighbour stands for the limit.
    low, high = max(low, SHALLOWEST), min(high, STEEPEST - 1e-10)
    even = np.linspace(0.02, high, _GRID) if low < 0.02 < high else np.linspace(low, high, _GRID)
    near_zero = np.geomspace(low, 0.02, 14)[:-1] if low < 0.02 < high else []
    return np.concatenate([near_zero, even])
