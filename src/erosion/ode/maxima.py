"""Every local maximum of a quantity as a function of one number, its jumps and its regimes, for many cases at once."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from erosion.interrupts import unawaited_threads
from erosion.lanes.engines import threads
from erosion.ode.batch import integrate
from erosion.ode.integrator import LaneEnd
from erosion.ode.resolve import Cells, Evaluate, Nodes, Ruler, Scan, is_jump, joined, polish, scan
from erosion.ode.signature import Signature
from erosion.ode.variational import Derivatives
from erosion.output.tables import Record

LOOSE = 1e-9  # relative tolerance of the search
TIGHT = 1e-11  # relative tolerance of a polished maximum

# Distances are in units of `Ruler`.
ASIDE = 1e-9  # at this distance from a jump every evaluation agrees on the side
_BESIDE = 1e-6  # a maximum nearer to a jump is the jump's own
_APART = 1e-11  # jumps nearer to one another are one
_LONG = 1e-3  # a plateau is no shorter, or has half of the range
_LEVEL = 1e-6  # of a function's size, per unit²; with less curvature it is level
_FLAT = 1e-6  # of a function's size, per unit: a plateau is no steeper
_SAME = 1e-9  # of a function's size: by no more values differ on a plateau
_TOGETHER = 1000  # cases that are searched at once: some 100 MB


@dataclasses.dataclass(frozen=True)
class Extremum:
    """A local maximum (or minimum, where the least value is searched), at a jump and at an end of the range too.

    Args:
        at: the number; of a jump 1e-9 units beside the jump; of a plateau the middle.
        low, high: the ends of a plateau; else both are `at`.
        value: the quantity there.
        kind: "interior", "jump", "boundary", "kink", "plateau" or "unresolved"; see `Maximum`.
        ended_by: how the lane ends there.
        side: the side of a jump, "below" or "above"; else "".
        attained: whether `value` is reached. At a jump the lane that just grazes an event belongs to the side where
            lanes end earlier; the other side only approaches its value. A limit is not reached either.
        slope, curve: the first two derivatives of the quantity by the number there.
        steps: evaluations that polished the number.
    """

    at: float
    low: float
    high: float
    value: float
    kind: str
    ended_by: str
    side: str
    attained: bool
    slope: float
    curve: float
    steps: int


@dataclasses.dataclass(frozen=True)
class Discontinuity:
    """A discontinuity, bracketed to 1e-11 units.

    Args:
        at: the number.
        below, above: the quantity on either side, 2e-10 units beside it.
        ended_below, ended_above: how lanes end on either side.
    """

    at: float
    below: float
    above: float
    ended_below: str
    ended_above: str


@dataclasses.dataclass(frozen=True)
class Regime:
    """A range of the number in which every lane ends in the same way.

    Args:
        low, high: the range.
        ended_by: how the lanes end.
    """

    low: float
    high: float
    ended_by: str


@dataclasses.dataclass(frozen=True)
class Maxima:
    """The maxima of one case.

    Args:
        candidates: best first, at least one.
        jumps, regimes: by number.
        rounds: of refinement.
        certified: whether every lane succeeded, with its derivatives.
    """

    candidates: tuple[Extremum, ...]
    jumps: tuple[Discontinuity, ...]
    regimes: tuple[Regime, ...]
    rounds: int
    certified: bool

    def negated(self) -> "Maxima":
        """The minima of a function, from the maxima of its negative."""
        candidates = tuple(
            dataclasses.replace(each, value=0.0 - each.value, slope=-each.slope, curve=-each.curve)
            for each in self.candidates
        )
        jumps = tuple(dataclasses.replace(jump, below=0.0 - jump.below, above=0.0 - jump.above) for jump in self.jumps)
        return dataclasses.replace(self, candidates=candidates, jumps=jumps)


class QuantityAlong(NamedTuple):
    """A quantity of many cases as a function of one of their numbers, or its negative: then its minima are maxima.

    Args:
        signature: of problem and arguments.
        parameters: of the cases, each of shape (cases, …), or of one case's shape where all share it.
        place: which of the numbers.
        quantity: of the ends of lanes and their numbers: the value, and by the number its `by_first` and `mixed`.
        negative: whether the negative is meant.
        rtol: relative tolerance.
        refines: whether doubtful lanes are integrated again; see `integrate`.
    """

    signature: Signature
    parameters: Sequence[np.ndarray]
    place: int
    quantity: Callable[[LaneEnd, list[np.ndarray]], Derivatives]
    negative: bool
    rtol: float
    refines: bool

    def __call__(self, case: np.ndarray, at: np.ndarray) -> Nodes:
        """The nodes at these numbers."""
        results, quantity = self._integrate(2, case, at)
        sign = -1.0 if self.negative else 1.0
        value, slope, curve = (sign * part for part in (quantity.value, quantity.by_first, quantity.mixed))
        return Nodes(case, at, value, slope, curve, *map(np.asarray, (results.time.value, results.outcome)))

    def outcomes(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Outcomes, times and values."""
        results, quantity = self._integrate(0, case, at)
        return np.asarray(results.outcome), results.time.value, quantity.value

    def _integrate(self, order: int, case: np.ndarray, at: np.ndarray) -> tuple[LaneEnd, Derivatives]:
        lanes = self.signature.of_lanes(self.parameters, case)
        lanes[self.place] = at
        along = (self.signature.offsets[self.place],) if order else ()
        results = integrate(self.signature, lanes, at.size, order, along, self.rtol, refines=self.refines)
        return results, self.quantity(results, lanes)


class SearchRange(NamedTuple):
    """Where maxima are searched, and what is special there.

    Args:
        low, high: the ends.
        grid: the first numbers, ascending, within the range.
        ruler: of distances.
        limit: where the lower end itself cannot be computed: of the nodes and the indices of the first two of a case,
            which of both continues the function to the end, and the limit there.
        ends_apart: whether the upper end is a candidate wherever the function goes beside it, and the limit too.
        nothing: an outcome of which a value of 0 is no maximum, but says that there is nothing.
    """

    low: float
    high: float
    grid: np.ndarray
    ruler: Ruler
    limit: "Callable[[Nodes, int, int], tuple[int, float]] | None" = None
    ends_apart: bool = False
    nothing: str = ""


class Search:
    """The maxima of many cases at once; of minima the function is the negative one.

    Args:
        objective: the function at a relative tolerance.
        cases: number of cases.
        names: what an outcome is an index of.
        within: where to search.
        least: whether the function is the negative one.
        loose, tight: relative tolerances of the search and of what is found.
    """

    def __init__(
        self,
        objective: Callable[[float], Evaluate],
        cases: int,
        names: tuple[str, ...],
        within: SearchRange,
        *,
        least: bool,
        loose: float = LOOSE,
        tight: float = TIGHT,
    ) -> None:
        self.cases, self.names, self.within, self.least = cases, names, within, least
        self.loose, self.tight = objective(loose), objective(tight)

    def optima(self) -> list[Maxima]:
        """The maxima of each case, or its minima."""
        scanned = scan(self.loose, self.tight, self.cases, self.within.grid, self.within.ruler)
        scanned = scanned._replace(narrow=self._side_by_side_merged(scanned.narrow))
        certified = scanned.unresolved == 0
        jumped = is_jump(scanned.narrow, scanned.size[scanned.narrow.low.case])
        candidates: list[list[Extremum]] = [[] for _ in range(self.cases)]
        for case, candidate in [
            *self._interior(scanned, jumped),
            *self.at_jumps(scanned, jumped),
            *self._at_boundaries(scanned),
        ]:
            candidates[case].append(candidate)
        plateaus = self._plateaus(scanned, candidates)
        for case, candidate in self._at_best_nodes(scanned, jumped, candidates, plateaus):
            candidates[case].append(candidate)
        for case, plateau in plateaus.items():
            outside = [each for each in candidates[case] if not plateau.low <= each.at <= plateau.high]
            candidates[case] = [plateau, *outside]
        jumps, regimes = self._jumps(scanned, jumped), self._regimes(scanned)
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

    def _ranked(self, candidates: list[Extremum], certified: bool) -> tuple[Extremum, ...]:
        known = [each for each in candidates if not np.isnan(each.value)]
        nothing = self.within.nothing
        worthy = [each for each in known if each.ended_by != nothing or each.value != 0 or self.least]
        if not worthy:
            # Where lanes failed it is not known whether there is anything.
            value, ended_by = (0.0, nothing) if certified and nothing else (np.nan, "failed")
            return (Extremum(np.nan, np.nan, np.nan, value, "none", ended_by, "", True, value, value, 0),)
        return tuple(sorted(worthy, key=lambda candidate: (-candidate.value, not candidate.attained)))

    def _candidate(self, nodes: Nodes, i: int | np.integer, **fields: Any) -> Extremum:
        defaults: dict[str, Any] = _at(float(nodes.at[i])) | {"side": "", "attained": True, "steps": 0}
        return Extremum(
            value=float(nodes.value[i]),
            slope=float(nodes.slope[i]),
            curve=float(nodes.curve[i]),
            ended_by=self.names[nodes.outcome[i]],
            **(defaults | fields),
        )

    def _interior(self, scanned: Scan, jumped: np.ndarray) -> list[tuple[int, Extremum]]:
        """By case, the maxima in smooth cells, and at kinks."""
        cells = Cells._make(map(joined, scanned.smooth, scanned.narrow.take(~jumped)))
        cells = cells.take((cells.low.slope > 0) & (cells.high.slope <= 0))
        size, unit = scanned.size, self.within.ruler.unit
        best, steps = polish(self.tight, cells, self.within.ruler)
        # Where the function is level, its slope falls through zero by rounding.
        bends = best.curve * unit**2 < -_LEVEL * size[best.case]
        # A number known to some 1e-11 units leaves that much of the curvature in the slope.
        flat = np.abs(best.slope) * unit <= 1e-6 * size[best.case] + 1e-10 * np.abs(best.curve) * unit**2
        # At a kink the side whose node is kept may be bent upward: its slope falls through zero at once.
        bends |= ~flat
        bends &= ~(np.abs(best.at - self._nearest_jump(best, scanned, jumped)) < self._near(_BESIDE, best.at))
        return [
            (int(case), self._candidate(best, i, kind="interior" if flat[i] else "kink", steps=int(steps[i])))
            for i, case in enumerate(best.case)
            if bends[i]
        ]

    def at_jumps(self, scanned: Scan, jumped: np.ndarray) -> Iterator[tuple[int, Extremum]]:
        """By case, the jumps whose higher side rises towards the jump.

        Args:
            scanned: the resolved functions.
            jumped: the narrow cells that hold a jump, shape (cells,).
        """
        cells = scanned.narrow.take(jumped)
        aside = np.maximum(self._near(ASIDE, cells.low.at), cells.width / 2)
        range_ = scanned.nodes.at.min(), scanned.nodes.at.max()
        low, high = (self.loose(cells.low.case, np.clip(cells.middle + sign * aside, *range_)) for sign in (-1, 1))
        for i, case in enumerate(low.case):
            if low.value[i] > high.value[i] and not low.slope[i] < 0:
                side, higher, lower = "below", low, high
            elif high.value[i] > low.value[i] and not high.slope[i] > 0:
                side, higher, lower = "above", high, low
            else:
                continue
            # An end of the range is computed itself, whatever jumps beside it.
            attained = bool(higher.time[i] < lower.time[i] or higher.at[i] in self.within[:2])
            yield int(case), self._candidate(higher, i, kind="jump", side=side, attained=attained)

    def _at_boundaries(self, scanned: Scan) -> Iterator[tuple[int, Extremum]]:
        """By case, the ends of the range that the function rises towards."""
        nodes, (low, high, *_) = scanned.nodes, self.within
        limit, apart = self.within.limit, self.within.ends_apart
        first = np.flatnonzero(np.diff(nodes.case, prepend=-1))
        last = np.append(first[1:], nodes.case.size) - 1
        ends = self.loose(np.arange(self.cases), np.full(self.cases, high))
        for case, (i, j) in enumerate(zip(first, last, strict=True)):
            # Where a function is level at an end, its next node says where it goes.
            inner, before = min(i + 1, j), max(j - 1, i)
            falls = nodes.slope[i] < 0 or (nodes.slope[i] == 0 and nodes.slope[inner] <= 0)
            rises = nodes.slope[j] > 0 or (nodes.slope[j] == 0 and nodes.slope[before] >= 0)
            if limit is None and falls:
                yield case, self._candidate(nodes, i, kind="boundary")
            elif limit is not None and (falls or apart):
                node, value = limit(nodes, int(i), int(inner))
                at_limit = self._candidate(nodes, node, kind="boundary", attained=False, **_at(low))
                yield case, dataclasses.replace(at_limit, value=value)
            if rises or apart:
                # The function may do at the end what it does at no number beside it.
                end, at = (ends, case) if np.isfinite(ends.value[case]) else (nodes, j)
                yield case, self._candidate(end, at, kind="boundary", **_at(high))

    def _nearest_jump(self, nodes: Nodes, scanned: Scan, jumped: np.ndarray) -> np.ndarray:
        """The nearest jump of the same case, shape (nodes,); infinite without one."""
        jumps = scanned.narrow.low.take(jumped)
        jumps = jumps.take(np.lexsort((jumps.at, jumps.case)))
        # Further apart lie two cases than any two numbers of one case.
        low, apart = self.within.low, 2 * (self.within.high - self.within.low)
        place = np.searchsorted(jumps.at - low + apart * jumps.case, nodes.at - low + apart * nodes.case)
        case, at = (np.append(column, [-1, -1]) for column in (jumps.case, jumps.at))
        before = np.where(case[place - 1] == nodes.case, at[place - 1], -np.inf)
        after = np.where(case[place] == nodes.case, at[place], np.inf)
        return np.where(nodes.at - before < after - nodes.at, before, after)

    def _at_best_nodes(
        self, scanned: Scan, jumped: np.ndarray, candidates: list[list[Extremum]], plateaus: dict[int, Extremum]
    ) -> Iterator[tuple[int, Extremum]]:
        """By case without a plateau, the best node where it is above all candidates.

        There the function falls so steeply from a jump that it is lower already at the candidate
        beside the jump; or it has no derivatives, so that no search found its maximum.
        """
        nodes = scanned.nodes
        jumps, near = self._nearest_jump(nodes, scanned, jumped), self._near(_BESIDE, nodes.at)
        for case, i in enumerate(_greatest(nodes)):
            above = (
                max((candidate.value for candidate in candidates[case]), default=-np.inf) + 1e-8 * scanned.size[case]
            )
            if nodes.value[i] > above and case not in plateaus:
                aside = float(nodes.at[i] - jumps[i])
                if abs(aside) < near[i]:
                    side = "above" if aside > 0 else "below"
                    yield case, self._candidate(nodes, i, kind="jump", side=side, attained=False)
                else:
                    yield case, self._by_values(nodes, int(i))

    def _plateaus(self, scanned: Scan, candidates: list[list[Extremum]]) -> dict[int, Extremum]:
        """By case, the widest range of numbers in which all values are the greatest one, if there is one."""
        nodes, unit = scanned.nodes, self.within.ruler.unit
        greatest, size = nodes.value[_greatest(nodes)], scanned.size
        peak = np.array([max((each.value for each in of_case), default=-np.inf) for of_case in candidates])
        lowest = np.fmax(greatest, np.where(np.isfinite(peak), peak, -np.inf)) - _SAME * size
        level = (nodes.value >= lowest[nodes.case]) & (np.abs(nodes.slope) * unit <= _FLAT * size[nodes.case])
        linked = level[:-1] & level[1:] & (nodes.case[:-1] == nodes.case[1:])
        begins = np.flatnonzero(linked & ~np.append(False, linked[:-1]))
        ends = np.flatnonzero(linked & ~np.append(linked[1:], False)) + 1
        long = nodes.at[ends] - nodes.at[begins] >= min(_LONG * unit, np.ptp(nodes.at) / 2)
        begins, ends = begins[long], ends[long]
        if not begins.size:
            return {}
        firsts, lasts = (self._level_until(nodes, at, step, lowest) for at, step in ((begins, -1), (ends, 1)))
        case = nodes.case[begins]
        firsts = np.where(firsts == nodes.at.min(), self.within.low, firsts)
        lasts = np.where(lasts == nodes.at.max(), self.within.high, lasts)
        middle = self.tight(case, (firsts + lasts) / 2)
        widest = {}
        for i in np.argsort(lasts - firsts, kind="stable"):
            extent = {"low": float(firsts[i]), "high": float(lasts[i])}
            widest[int(case[i])] = self._candidate(middle, i, kind="plateau", **extent)
        return widest

    def _level_until(self, nodes: Nodes, at: np.ndarray, step: int, lowest: np.ndarray) -> np.ndarray:
        """The numbers until which the functions are level, from a node down (step -1) or up (1), shape (cells,)."""
        case, level = nodes.case[at], nodes.at[at].copy()
        beside = np.clip(at + step, 0, nodes.case.size - 1)
        lower = np.where(nodes.case[beside] == case, nodes.at[beside], level)
        apart = _APART * self.within.ruler.unit
        while (wide := np.flatnonzero(np.abs(level - lower) > apart)).size:
            places = np.linspace(level[wide], lower[wide], 17)
            values = self.tight(np.tile(case[wide], 15), places[1:-1].ravel()).value.reshape(15, wide.size)
            falls = np.append(~(values >= lowest[case[wide]]), np.ones((1, wide.size), bool), axis=0)
            first, column = np.argmax(falls, axis=0), np.arange(wide.size)
            level[wide], lower[wide] = places[first, column], places[first + 1, column]
        return level

    def _by_values(self, nodes: Nodes, i: int) -> Extremum:
        """The greatest value between the neighbours of a node, without derivatives."""
        near = np.flatnonzero(nodes.case == nodes.case[i])
        near = near[np.abs(near - i) <= 1]
        low, high = float(nodes.at[near[0]]), float(nodes.at[near[-1]])
        best, steps = nodes.take(np.array([i])), 0
        narrow = float(np.max(self._near(_BESIDE, nodes.at[near])))
        while high - low > narrow:
            places = np.linspace(low, high, 17)
            new = self.loose(np.full(places.size, nodes.case[i]), places)
            steps += 1
            j = int(np.argmax(np.nan_to_num(new.value, nan=-np.inf)))
            best = max(best, new.take(np.array([j])), key=lambda node: node.value[0])
            low, high = places[max(j - 1, 0)], places[min(j + 1, 16)]
        return self._candidate(best, 0, kind="unresolved", steps=steps)

    def _jumps(self, scanned: Scan, jumped: np.ndarray) -> list[tuple[Discontinuity, ...]]:
        """The jumps of each case, by number."""
        low, high = cells = scanned.narrow.take(jumped)
        jumps: list[list[Discontinuity]] = [[] for _ in range(self.cases)]
        for i in np.argsort(cells.middle):
            jump = Discontinuity(
                at=float(cells.middle[i]),
                below=float(low.value[i]),
                above=float(high.value[i]),
                ended_below=self.names[low.outcome[i]],
                ended_above=self.names[high.outcome[i]],
            )
            jumps[low.case[i]].append(jump)
        return [tuple(of_case) for of_case in jumps]

    def _regimes(self, scanned: Scan) -> list[tuple[Regime, ...]]:
        """The regimes of each case, by number."""
        low, high = self.within.low, self.within.high
        cells = scanned.narrow.take(scanned.narrow.outcome_changes)
        nodes = scanned.nodes
        first = nodes.outcome[np.flatnonzero(np.diff(nodes.case, prepend=-1))]
        regimes = [[Regime(low, high, self.names[outcome])] for outcome in first]
        for i in np.argsort(cells.middle):
            of_case, change = regimes[cells.low.case[i]], float(cells.middle[i])
            of_case[-1] = dataclasses.replace(of_case[-1], high=change)
            of_case.append(Regime(change, high, self.names[cells.high.outcome[i]]))
        return [tuple(of_case) for of_case in regimes]

    def _near(self, distance: float, at: np.ndarray) -> np.ndarray:
        """A distance in units near some numbers."""
        return distance * self.within.ruler.near(at)

    def _side_by_side_merged(self, cells: Cells) -> Cells:
        """Narrow cells, where those of a case that nearly touch are one: rounding alone tells them apart."""
        order = np.lexsort((cells.low.at, cells.low.case))
        low, high = cells.low.take(order), cells.high.take(order)
        begins = np.ones(order.size, bool)
        begins[1:] = (np.diff(low.case) != 0) | (low.at[1:] - high.at[:-1] > _APART * self.within.ruler.unit)
        ends = np.append(np.flatnonzero(begins)[1:], order.size) - 1 if order.size else order
        return Cells(low.take(np.flatnonzero(begins)), high.take(ends))


def _at(number: float) -> dict[str, Any]:
    """Where a candidate is that is no plateau."""
    return {"at": number, "low": number, "high": number}


def _greatest(nodes: Nodes) -> np.ndarray:
    """The node of each case with the greatest value, shape (cases,)."""
    value = np.where(np.isnan(nodes.value), -np.inf, nodes.value)
    peak = np.maximum.reduceat(value, np.flatnonzero(np.diff(nodes.case, prepend=-1)))
    greatest = np.flatnonzero(value == peak[nodes.case])
    return greatest[np.flatnonzero(np.diff(nodes.case[greatest], append=-1))]


def searched(cases: int, search: Callable[[slice, int], list[Maxima]]) -> list[Maxima]:
    """The maxima of all cases, from a function that searches those of a slice, and how many these are."""

    def portion(begin: int) -> list[Maxima]:
        return search(slice(begin, begin + _TOGETHER), min(_TOGETHER, cases - begin))

    # While one thread integrates, another uses Python to choose the next numbers.
    with unawaited_threads(threads()) as pool:
        return list(itertools.chain.from_iterable(pool.map(portion, range(0, cases, _TOGETHER))))


def columns(optima: list[Maxima], shape: tuple[int, ...]) -> Record:
    """The best of each case and what is known of it, by the names of the fields; arrays of a shape."""
    best = [of_case.candidates[0] for of_case in optima]
    names = [field.name for field in dataclasses.fields(Extremum) if field.name != "steps"]
    fields: Record = {name: [getattr(candidate, name) for candidate in best] for name in names}
    fields["iterations"] = [of_case.rounds + of_case.candidates[0].steps for of_case in optima]
    fields["certified"] = [of_case.certified for of_case in optima]
    found = {key: np.array(column).reshape(shape)[()] for key, column in fields.items()}
    for key in ("candidates", "jumps", "regimes"):
        found[key] = objects([getattr(of_case, key) for of_case in optima], shape)
    return found


def objects(of_cases: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """An array of Python's own objects, or the one object."""
    column = np.empty(len(of_cases), object)
    column[:] = of_cases
    return column.reshape(shape)[()]
