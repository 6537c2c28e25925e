"""A function of the angle, resolved: where it is smooth, where it jumps, where it bends.

The function is known through its value and first two derivatives at chosen angles (nodes).
Between neighbouring nodes it is *resolved* where the quintic through both ends agrees with
what its own smoothness predicts; every other cell is split, until it is resolved or as
narrow as rounding allows. What is left narrow holds a jump or a change of how the cut ends.

Many functions (cases) are resolved at once, so that each round is one large batch.
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

_NARROW = 1e-11  # rad; the places of jumps are known to this
_SUSPECT = 3e-8  # rad; cells so wide are not split: a tighter tolerance says where the jump is
_AGREED = 2e-10  # rad; so far beside a jump, with derivatives or without, it is on the same side
_STEEP = 1e-5  # rad; where cells so narrow are not resolved there may be a jump
_RESOLVED = 1e-6  # of the function's largest size: what the quintic's last term may add
_BENT = 1e-3  # likewise the quartic term, so that the quintic's cannot vanish by accident
_JUMP = 1e-8  # likewise; a smaller change over a narrow cell is rounding
_LANES = 256  # of a batch that is no cheaper when smaller
_MAX_NODES = 20_000  # of one case; a function that needs more is not resolved


class Nodes(NamedTuple):
    """Where the functions are known; arrays of shape (nodes,).

    Args:
        case: which function.
        alpha: the angle [rad].
        value, slope, curve: the function and its derivatives by the angle; NaN where the
            impact failed.
        time: when the cut ends [s].
        end: a code of how the cut ends: an index of the model's `end_names`.
    """

    case: np.ndarray
    alpha: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    curve: np.ndarray
    time: np.ndarray
    end: np.ndarray

    def take(self, index: Any) -> "Nodes":
        """Some of the nodes."""
        return Nodes._make(column[index] for column in self)


def joined(one: Nodes, other: Nodes) -> Nodes:
    """All nodes of both."""
    return Nodes._make(np.concatenate(pair) for pair in zip(one, other, strict=True))


class Cells(NamedTuple):
    """Neighbouring nodes in pairs: `low` and `high` are aligned."""

    low: Nodes
    high: Nodes

    @property
    def width(self) -> np.ndarray:
        """Of each cell [rad]."""
        return self.high.alpha - self.low.alpha

    @property
    def middle(self) -> np.ndarray:
        """Of each cell [rad]."""
        return (self.low.alpha + self.high.alpha) / 2


class Scan(NamedTuple):
    """Resolved functions.

    Args:
        nodes: all of them, by case and then by angle.
        smooth: the resolved cells.
        narrow: the cells that hold a jump or another end on either side; 4e-10 rad wide, or up to 3e-8
            where cutting begins.
        size: of each case's function, its largest magnitude; shape (cases,).
        unresolved: of each case, how many cells are neither (failed impacts); shape (cases,).
        rounds: how often each case's cells were split, derivatives and all; shape (cases,).
    """

    nodes: Nodes
    smooth: Cells
    narrow: Cells
    size: np.ndarray
    unresolved: np.ndarray
    rounds: np.ndarray


@runtime_checkable
class Evaluate(Protocol):
    """How the functions are computed."""

    def __call__(self, case: np.ndarray, alpha: np.ndarray) -> Nodes:
        """Nodes at some angles."""
        ...

    def ends(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How the cuts end there, and when; for less, where many are asked for."""
        ...


def scan(evaluate: Evaluate, tight: Evaluate, cases: int, angles: np.ndarray) -> Scan:
    """Resolve functions of the angle.

    Args:
        evaluate: computes nodes.
        tight: computes them more exactly, to say where a jump is.
        cases: how many functions.
        angles: where to look first, ascending [rad].
    """
    count = len(angles)
    # Angle by angle: impacts side by side then take about as many steps as each other.
    nodes = evaluate(np.tile(np.arange(cases), count), np.repeat(angles, cases))
    left = np.arange(cases * (count - 1))
    found = _resolve(evaluate, nodes, left, left + cases)
    # Where cutting begins the tip is so slow at contact that a tighter tolerance is below rounding.
    cut = (found.narrow.low.time > 0) & (found.narrow.high.time > 0)
    case = found.narrow.low.case[cut]
    # What the looser tolerance placed within _SUSPECT may lie a little beside it.
    low, high = found.narrow.low.alpha[cut] - _SUSPECT, found.narrow.high.alpha[cut] + _SUSPECT
    places, _ = _bracket(tight, case, np.clip([low, high], angles[0], angles[-1]), _NARROW)
    low, high = np.clip(places + np.array([[-_AGREED], [_AGREED]]), angles[0], angles[-1])
    close = Cells(tight(case, low), tight(case, high))
    # Where a change of the end was between the nodes it must be so still.
    loose = Cells._make(side.take(cut) for side in found.narrow)
    gone = (loose.low.end != loose.high.end) & (close.low.end == close.high.end)
    kept = np.isfinite(close.low.value) & np.isfinite(close.high.value) & ~gone
    narrow = [
        joined(joined(a.take(kept), b.take(gone)), c.take(~cut))
        for a, b, c in zip(close, loose, found.narrow, strict=True)
    ]
    return found._replace(
        narrow=Cells._make(narrow), unresolved=found.unresolved + np.bincount(case[~kept], minlength=cases)
    )


def _resolve(evaluate: Evaluate, nodes: Nodes, low: np.ndarray, high: np.ndarray) -> Scan:
    """Split cells, pairs of indices of nodes, until each is smooth or as narrow as `_SUSPECT`."""
    used = np.bincount(nodes.case)
    cases = used.size
    size, unresolved, rounds = np.zeros(cases), np.zeros(cases, int), np.zeros(cases, int)
    placed = np.zeros(nodes.case.size, bool)  # beside a change of the end, by `_bracket`
    smooth, narrow = [], []
    while True:
        np.maximum.at(size, nodes.case, np.nan_to_num(np.abs(nodes.value)))
        cells = Cells(nodes.take(low), nodes.take(high))
        done = is_resolved(cells, size[cells.low.case])
        known = np.isfinite(cells.low.value) & np.isfinite(cells.high.value)
        thin = ~done & (cells.width <= _SUSPECT)
        lost = ~done & (~known | (~thin & (used[cells.low.case] > _MAX_NODES)))
        np.add.at(unresolved, cells.low.case[lost], 1)
        smooth.append(np.stack([low[done], high[done]]))
        narrow.append(np.stack([low[thin & known], high[thin & known]]))
        split = ~(done | thin | lost)
        # Where there may be a jump, first of all where. If it is not between the nodes placed, halves will do.
        suspect = (cells.low.end != cells.high.end) | (cells.width < _STEEP)
        search = np.flatnonzero(split & suspect & ~placed[low] & ~placed[high])
        if not split.any():
            break
        places = np.stack([cells.low.alpha[search], cells.high.alpha[search]])
        beside, clear = _bracket(evaluate, cells.low.case[search], places, _SUSPECT)
        search, beside = search[clear], beside[:, clear].T
        halves = np.setdiff1d(np.flatnonzero(split), search)
        parts = int(np.clip(_LANES // max(halves.size, 1), 2, 16))
        fractions = np.arange(1, parts) / parts
        between = cells.low.alpha[halves, None] + fractions * cells.width[halves, None]
        chains, first, angles, owners = [], nodes.case.size, [], []
        for chosen, inner in ((halves, between), (search, beside)):
            index = first + np.arange(inner.size).reshape(inner.shape)
            chains.append(np.column_stack([low[chosen], index, high[chosen]]))
            angles.append(inner.ravel())
            owners.append(np.repeat(cells.low.case[chosen], inner.shape[1]))
            first += inner.size
        new = evaluate(np.concatenate(owners), np.concatenate(angles))
        np.add.at(used, new.case, 1)
        rounds[np.unique(new.case)] += 1
        nodes = joined(nodes, new)
        placed = np.concatenate([placed, np.arange(new.case.size) >= between.size])
        low = np.concatenate([chain[:, :-1].ravel() for chain in chains])
        high = np.concatenate([chain[:, 1:].ravel() for chain in chains])
    pairs = [np.concatenate(kind, axis=1) for kind in (smooth, narrow)]
    resolved, bracketed = (Cells(nodes.take(pair[0]), nodes.take(pair[1])) for pair in pairs)
    return Scan(nodes.take(np.lexsort((nodes.alpha, nodes.case))), resolved, bracketed, size, unresolved, rounds)


def _bracket(evaluate: Evaluate, case: np.ndarray, places: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Between which angles, at most `width` apart, the end first changes, or else its time changes most.

    Args:
        evaluate: computes how cuts end.
        case: shape (cells,).
        places: between which angles to look; shape (2, cells).
        width: [rad].

    Returns:
        The angles, shape (2, cells), and whether no impact failed there, shape (cells,).
    """
    (low, high), cells = places.copy(), case.size
    ends, times = (value.reshape(2, cells) for value in evaluate.ends(np.tile(case, 2), places.ravel()))
    before, (start, stop) = ends[0], times.copy()
    changing = before != ends[1]
    while (wide := np.flatnonzero(high - low > width)).size:
        parts = int(np.clip(_LANES // wide.size, 2, 16))
        at = np.linspace(low[wide], high[wide], parts + 1, axis=1)
        ends, times = evaluate.ends(np.repeat(case[wide], parts - 1), at[:, 1:-1].ravel())
        times = np.column_stack([start[wide], times.reshape(wide.size, -1), stop[wide]])
        changed = ends.reshape(wide.size, -1) != before[wide, None]
        first = np.argmax(np.column_stack([changed, np.ones(wide.size, bool)]), axis=1)
        steepest = np.argmax(np.nan_to_num(np.abs(np.diff(times, axis=1)), nan=np.inf), axis=1)
        chosen, row = np.where(changing[wide], first, steepest), np.arange(wide.size)
        low[wide], high[wide] = at[row, chosen], at[row, chosen + 1]
        start[wide], stop[wide] = times[row, chosen], times[row, chosen + 1]
    return np.stack([low, high]), np.isfinite(start) & np.isfinite(stop)


def is_resolved(cells: Cells, size: np.ndarray) -> np.ndarray:
    """Whether the quintic through both ends of a cell can be trusted; False where one is NaN."""
    coefficients = quintic(cells)
    slopes = _slope_of(coefficients, np.linspace(0.0, 1.0, 9)[:, None])
    rising, falling = cells.low.slope > 0, cells.high.slope < 0
    # With slopes of the same sign at both ends there is no maximum inside, nor a pair of extrema.
    turns = (rising & ~falling & np.any(slopes < 0, axis=0)) | (~rising & falling & np.any(slopes > 0, axis=0))
    wiggles = turns & (cells.width * np.max(np.abs(slopes), axis=0) > _RESOLVED * size)
    steady = (cells.low.end == cells.high.end) & ~wiggles
    small = (np.abs(coefficients[5]) <= _RESOLVED * size) & (np.abs(coefficients[4]) <= _BENT * size)
    return steady & small


def quintic(cells: Cells) -> np.ndarray:
    """Coefficients of t⁰ … t⁵ of the polynomial through both ends of a cell, t from 0 to 1."""
    h = cells.width
    value, slope, curve = cells.low.value, h * cells.low.slope, h**2 * cells.low.curve / 2
    rise = cells.high.value - value - slope - curve
    steepening = h * cells.high.slope - slope - 2 * curve
    bending = h**2 * cells.high.curve / 2 - curve
    return np.stack(
        [
            value,
            slope,
            curve,
            10 * rise - 4 * steepening + bending,
            -15 * rise + 7 * steepening - 2 * bending,
            6 * rise - 3 * steepening + bending,
        ]
    )


def _slope_of(coefficients: np.ndarray, t: Any) -> np.ndarray:
    return np.polynomial.polynomial.polyval(t, [n * c for n, c in enumerate(coefficients)][1:], tensor=False)


def is_jump(cells: Cells, size: np.ndarray) -> np.ndarray:
    """Whether the function jumps within narrow cells."""
    change = np.abs(cells.high.value - cells.low.value)
    allowed = 4 * cells.width * (np.abs(cells.low.slope) + np.abs(cells.high.slope))
    return change > allowed + _JUMP * size


def polish(evaluate: Evaluate, cells: Cells) -> tuple[Nodes, np.ndarray]:
    """The maxima within cells whose slope falls through zero, by safeguarded Newton.

    Newton's step on the slope, from the quintic's own maximum; bisection where it would
    leave the bracket, as it may at a kink of the slope.

    Returns:
        The nodes at the maxima, and how many evaluations each took.
    """
    case = cells.low.case
    low, high = cells.low.alpha.copy(), cells.high.alpha.copy()
    at = cells.low.alpha + cells.width * _falling_root(quintic(cells))
    tries = np.zeros(case.size, int)
    best = cells.low
    active = np.ones(case.size, bool)
    while active.any():
        i = np.flatnonzero(active)
        found = evaluate(case[i], at[i])
        tries[i] += 1
        best = Nodes._make(_put(column, i, new) for column, new in zip(best, found, strict=True))
        low[i] = np.where(found.slope > 0, at[i], low[i])
        high[i] = np.where(found.slope > 0, high[i], at[i])
        with np.errstate(all="ignore"):
            newton = at[i] - found.slope / found.curve
        inside = (newton >= low[i]) & (newton <= high[i]) & (found.curve < 0)
        following = np.where(inside, newton, (low[i] + high[i]) / 2)
        settled = (np.abs(following - at[i]) <= 1e-12) | (found.slope == 0) | ~np.isfinite(found.slope)
        at[i] = following
        active[i[settled | (tries[i] >= 60)]] = False
    return best, tries


def _put(column: np.ndarray, index: np.ndarray, new: np.ndarray) -> np.ndarray:
    column = column.copy()
    column[index] = new
    return column


def _falling_root(coefficients: np.ndarray) -> np.ndarray:
    """Where in (0, 1) the quintic's slope falls through zero, by bisection."""
    low, high = np.zeros(coefficients.shape[1]), np.ones(coefficients.shape[1])
    for _ in range(40):
        middle = (low + high) / 2
        rising = _slope_of(coefficients, middle) > 0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    return (low + high) / 2
