"""Resolve a function of a number: smooth cells, and narrow cells that hold its jumps and kinks.

The function is computed, with its first two derivatives, at some numbers (nodes). Two
neighbouring nodes bound a cell. A cell is *resolved* where the last terms of the quintic
through both nodes are small. Every other cell is split, until it is resolved or as narrow as
rounding allows. Each narrow cell holds a jump, or a change of how lanes end.

Many functions (cases) are resolved at once, so that each round is one large batch. Where a cell is
split depends on its own function alone, so that a case has the same answer alone and among others.
"""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

# Distances are in units of `Ruler`.
_NARROW = 1e-11  # the width to which jumps are bracketed
_SUSPECT = 3e-8  # narrower cells are not split: a tighter tolerance brackets the jump
_AGREED = 2e-10  # at this distance, evaluations with and without derivatives agree on the side of a jump
_STEEP = 1e-5  # a narrower cell that is not resolved may hold a jump
_SETTLED = 1e-12  # the last step of Newton's method
_RESOLVED = 1e-6  # of the function's size, and of how far a cell is below its peak: bound of the quintic term
_BENT = 1e-3  # of the same: bound of the quartic term, because the quintic term may vanish by accident
_JUMP = 1e-8  # of the size: a smaller change over a narrow cell is rounding
_MOST = 0.75  # of the first nodes are no further below the peak than the size, if the peak itself is near zero
_LANES = 256  # a smaller batch takes as long
_MAX_NODES = 20_000  # of one case; a function that needs more is not resolved


class Ruler(NamedTuple):
    """What distances between numbers are measured by.

    Args:
        unit: over which functions change by much of themselves.
        relative: below this number distances are in proportion to the number, as functions may be powers there;
            0 where they are not.
    """

    unit: float
    relative: float = 0.0

    def near(self, at: np.ndarray) -> np.ndarray:
        """The unit near some numbers."""
        return self.unit * (np.minimum(1.0, at / self.relative) if self.relative else np.ones_like(at))


class Nodes(NamedTuple):
    """The functions at some numbers; arrays of shape (nodes,).

    Args:
        case: which function.
        at: the number.
        value, slope, curve: the function and its first two derivatives by the number; NaN where the lane failed,
            the derivatives also where they do not exist.
        time: of the lane, from its start to its end.
        outcome: how the lane ends, as an index of names.
    """

    case: np.ndarray
    at: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    curve: np.ndarray
    time: np.ndarray
    outcome: np.ndarray

    def take(self, index: np.ndarray | slice) -> "Nodes":
        """The nodes of an index or a mask."""
        return Nodes._make(column[index] for column in self)


def choose(where: np.ndarray, nodes: Nodes, others: Nodes) -> Nodes:
    """The nodes, and the others where the mask is False."""
    return Nodes._make(np.where(where, *columns) for columns in zip(nodes, others, strict=True))


def joined(*parts: Nodes) -> Nodes:
    """The nodes of all parts."""
    return Nodes._make(np.concatenate(columns) for columns in zip(*parts, strict=True))


class Cells(NamedTuple):
    """Pairs of neighbouring nodes; `low` and `high` both have the shape (cells,)."""

    low: Nodes
    high: Nodes

    @property
    def width(self) -> np.ndarray:
        """The width of each cell."""
        return self.high.at - self.low.at

    @property
    def middle(self) -> np.ndarray:
        """The number in the middle of each cell."""
        return (self.low.at + self.high.at) / 2

    @property
    def outcome_changes(self) -> np.ndarray:
        """Whether lanes end differently at both nodes; shape (cells,)."""
        return self.low.outcome != self.high.outcome

    def take(self, index: np.ndarray | slice) -> "Cells":
        """The cells of an index or a mask."""
        return Cells(self.low.take(index), self.high.take(index))


class Scan(NamedTuple):
    """Resolved functions.

    Args:
        nodes: all nodes, by case and then by number.
        smooth: the resolved cells, and what lies beside the narrow cells.
        narrow: the cells that hold a jump or a change of outcome; 4e-10 units wide, or up to 3e-8 where one of
            both lanes ends at its start.
        size: of each function, see `_sizes`; shape (cases,).
        unresolved: number of cells of each case that are neither, because lanes failed or have no derivatives;
            shape (cases,).
        rounds: how often cells of each case were split; shape (cases,).
    """

    nodes: Nodes
    smooth: Cells
    narrow: Cells
    size: np.ndarray
    unresolved: np.ndarray
    rounds: np.ndarray


@runtime_checkable
class Evaluate(Protocol):
    """Computes the functions; `case` and `at` have the shape (n,)."""

    def __call__(self, case: np.ndarray, at: np.ndarray) -> Nodes:
        """The nodes at these numbers."""
        ...

    def outcomes(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Outcomes, times and values alone, shape (n,), without derivatives: faster."""
        ...


def scan(evaluate: Evaluate, tight: Evaluate, cases: int, grid: np.ndarray, ruler: Ruler) -> Scan:
    """Resolve functions of a number.

    Args:
        evaluate: computes nodes.
        tight: computes nodes at a tighter tolerance, to bracket jumps.
        cases: number of functions.
        grid: the first nodes, ascending, shape (n,).
        ruler: of distances.
    """
    count = len(grid)
    # Number by number, because lanes of the same number take about as many steps.
    nodes = evaluate(np.tile(np.arange(cases), count), np.repeat(grid, cases))
    low_nodes = np.arange(cases * (count - 1))
    scanned = _resolve(evaluate, nodes, low_nodes, low_nodes + cases, ruler)
    # Where lanes begin not to end at their start, they end so soon that a tighter tolerance is below rounding.
    moving = (scanned.narrow.low.time > 0) & (scanned.narrow.high.time > 0)
    loose = scanned.narrow.take(moving)
    case = loose.low.case
    # With the looser tolerance a jump may lie a little outside of its cell.
    outside = _SUSPECT * ruler.near(loose.low.at)
    low, high = np.maximum(loose.low.at - outside, grid[0]), np.minimum(loose.high.at + outside, grid[-1])
    brackets, _ = _bracket(tight, case, np.stack([low, high]), _NARROW, ruler)
    low, high = np.clip(brackets + _AGREED * ruler.near(brackets[0]) * np.array([[-1], [1]]), grid[0], grid[-1])
    bracketed = Cells(tight(case, low), tight(case, high))
    # A change of outcome that the tighter tolerance does not confirm keeps its looser cell.
    lost = loose.outcome_changes & ~bracketed.outcome_changes
    confirmed = np.isfinite(bracketed.low.value) & np.isfinite(bracketed.high.value) & ~lost
    parts = bracketed.take(confirmed), loose.take(lost), scanned.narrow.take(~moving)
    narrow = Cells._make(joined(*sides) for sides in zip(*parts, strict=True))
    unresolved = scanned.unresolved + np.bincount(case[~confirmed], minlength=cases)
    flanks = _flanks(loose.take(confirmed), bracketed.take(confirmed))
    smooth = Cells._make(map(joined, scanned.smooth, *flanks))
    return scanned._replace(smooth=smooth, narrow=narrow, unresolved=unresolved)


def _flanks(loose: Cells, bracketed: Cells) -> tuple[Cells, Cells]:
    """What a bracket leaves of its cell, below and above: a maximum may lie there."""
    below, above = bracketed.low.at < loose.high.at, bracketed.high.at > loose.low.at
    sides = (
        Cells(loose.low, choose(below, bracketed.low, loose.high)),
        Cells(choose(above, bracketed.high, loose.low), loose.high),
    )
    low, high = (side.take((side.width > 0) & ~side.outcome_changes) for side in sides)
    return low, high


def _resolve(evaluate: Evaluate, nodes: Nodes, low: np.ndarray, high: np.ndarray, ruler: Ruler) -> Scan:
    """Split cells, pairs of node indices of shape (cells,), until each is smooth or as narrow as `_SUSPECT`."""
    used = np.bincount(nodes.case)
    cases = used.size
    grid, unresolved, rounds = nodes, np.zeros(cases, int), np.zeros(cases, int)
    bracketing = np.zeros(nodes.case.size, bool)  # whether `_bracket` chose the node
    smooth, narrow = [], []
    while True:
        peak, size = _sizes(nodes, grid, cases)
        cells = Cells(nodes.take(low), nodes.take(high))
        below = peak[cells.low.case] - np.fmax(cells.low.value, cells.high.value)
        resolved = is_resolved(cells, np.fmax(size[cells.low.case], below))
        computed = np.isfinite(cells.low.value) & np.isfinite(cells.high.value)
        # Where the lane of one node alone fails, the cell is halved: the failures may begin anywhere in it.
        failed = np.isnan(cells.low.value) & np.isnan(cells.high.value)
        # Without derivatives nothing says how often to split, but a change of outcome is found all the same.
        blind = ~np.isfinite(cells.low.curve + cells.high.curve) & ~cells.outcome_changes
        near = ruler.near(cells.low.at)
        thin = ~resolved & (cells.width <= _SUSPECT * near)
        lost = ~resolved & np.where(thin, ~computed, failed | blind | (used[cells.low.case] > _MAX_NODES))
        np.add.at(unresolved, cells.low.case[lost], 1)
        smooth.append(np.stack([low[resolved], high[resolved]]))
        narrow.append(np.stack([low[thin & computed], high[thin & computed]]))
        split = ~(resolved | thin | lost)
        # A cell that may hold a jump is bracketed once. If the jump is not in the bracket, the cell is halved.
        suspect = cells.outcome_changes | (cells.width < _STEEP * near)
        search = np.flatnonzero(split & suspect & computed & ~bracketing[low] & ~bracketing[high])
        if not split.any():
            break
        bounds = np.stack([cells.low.at[search], cells.high.at[search]])
        brackets, clear = _bracket(evaluate, cells.low.case[search], bounds, _SUSPECT, ruler)
        search, brackets = search[clear], brackets[:, clear].T
        halved = np.setdiff1d(np.flatnonzero(split), search)
        between = cells.take(halved).middle[:, None]
        chains, first, places, case = [], nodes.case.size, [], []
        for index, inner in ((halved, between), (search, brackets)):
            new_nodes = first + np.arange(inner.size).reshape(inner.shape)
            chains.append(np.column_stack([low[index], new_nodes, high[index]]))
            places.append(inner.ravel())
            case.append(np.repeat(cells.low.case[index], inner.shape[1]))
            first += inner.size
        new = evaluate(np.concatenate(case), np.concatenate(places))
        np.add.at(used, new.case, 1)
        rounds[np.unique(new.case)] += 1
        nodes = joined(nodes, new)
        bracketing = np.concatenate([bracketing, np.arange(new.case.size) >= between.size])
        low = np.concatenate([chain[:, :-1].ravel() for chain in chains])
        high = np.concatenate([chain[:, 1:].ravel() for chain in chains])
    pairs = [np.concatenate(kind, axis=1) for kind in (smooth, narrow)]
    smooth_cells, narrow_cells = (Cells(nodes.take(pair[0]), nodes.take(pair[1])) for pair in pairs)
    by_number = nodes.take(np.lexsort((nodes.at, nodes.case)))
    return Scan(by_number, smooth_cells, narrow_cells, size, unresolved, rounds)


def _sizes(nodes: Nodes, grid: Nodes, cases: int) -> tuple[np.ndarray, np.ndarray]:
    """The greatest value of each function, and its size: what matters where it is greatest, shape (cases,).

    That is the magnitude of the greatest value, or how far three quarters of the first nodes are below it at most,
    whichever is larger. However low the others are, as at a singularity or for a penalty, they do not count.
    """
    peak = np.full(cases, -np.inf)
    np.fmax.at(peak, nodes.case, nodes.value)
    peak[~np.isfinite(peak)] = 0.0
    below = peak[grid.case] - grid.value
    order = np.lexsort((below, grid.case))  # NaN last
    first = np.searchsorted(grid.case[order], np.arange(cases))
    known = np.bincount(grid.case[np.isfinite(grid.value)], minlength=cases)
    depth = below[order][first + (_MOST * np.maximum(known - 1, 0)).astype(int)]
    return peak, np.fmax(np.abs(peak), depth)


def _bracket(
    evaluate: Evaluate, case: np.ndarray, bounds: np.ndarray, width: float, ruler: Ruler
) -> tuple[np.ndarray, np.ndarray]:
    """Two numbers, at most `width` apart, between which the outcome changes, or else time and value change most.

    Args:
        evaluate: computes outcomes.
        case: shape (cells,).
        bounds: the numbers to begin with; shape (2, cells).
        width: in units of the ruler.
        ruler: of distances.

    Returns:
        The numbers, shape (2, cells), and whether no lane failed there, shape (cells,).
    """
    outcomes, levels = _outcomes(evaluate, case, bounds)
    ends, before, changing = levels, outcomes[0], outcomes[0] != outcomes[1]
    spans, bounds = np.abs(np.diff(ends, axis=1)), bounds.copy()
    widths = width * ruler.near(bounds[0])
    while (wide := np.flatnonzero(bounds[1] - bounds[0] > widths)).size:
        # A few cells are halved several times at once, at places of which only some are needed.
        halvings, places = int(np.clip(np.log2(_LANES / wide.size), 1, 4)), bounds[:, wide]
        for _ in range(halvings):
            between = (places[:-1] + places[1:]) / 2
            places = np.insert(places, np.arange(1, len(places)), between, axis=0)
        outcomes, levels = _outcomes(evaluate, case[wide], places[1:-1])
        changed = outcomes != before[wide]
        levels = np.concatenate([ends[:, :1, wide], levels, ends[:, 1:, wide]], axis=1)
        row, first, last = np.arange(wide.size), np.zeros(wide.size, int), np.full(wide.size, len(places) - 1)
        for _ in range(halvings):
            middle = (first + last) // 2
            earlier = changed[middle - 1, row]
            if (alike := ~changing[wide]).any():
                with np.errstate(all="ignore"):
                    steps = np.abs(np.diff(levels[:, [first, middle, last], row], axis=1)) / spans[:, :, wide]
                # What does not change says nothing; a failed lane is a step.
                steps = np.where(spans[:, :, wide] == 0, 0.0, np.nan_to_num(steps, nan=np.inf)).sum(axis=0)
                earlier = np.where(alike, steps[0] >= steps[1], earlier)
            wider = places[last, row] - places[first, row] > widths[wide]
            first, last = np.where(wider & ~earlier, middle, first), np.where(wider & earlier, middle, last)
        bounds[:, wide] = places[first, row], places[last, row]
        ends[:, :, wide] = np.stack([levels[:, first, row], levels[:, last, row]], axis=1)
    return bounds, np.all(np.isfinite(ends), axis=(0, 1))


def _outcomes(evaluate: Evaluate, case: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outcomes, shape (places, cells), and times and values together, shape (2, places, cells)."""
    outcomes, *levels = evaluate.outcomes(np.tile(case, len(places)), places.ravel())
    return outcomes.reshape(places.shape), np.stack(levels).reshape(2, *places.shape)


def is_resolved(cells: Cells, size: np.ndarray) -> np.ndarray:
    """Whether the function is the quintic through both nodes of each cell; False for NaN. Shape (cells,)."""
    coefficients = quintic(cells)
    slopes = _slope_of(coefficients, np.linspace(0.0, 1.0, 9)[:, None])
    rising, falling = cells.low.slope > 0, cells.high.slope < 0
    # Slopes of the same sign at both nodes: the cell must not hide a maximum and a minimum.
    turns = (rising & ~falling & np.any(slopes < 0, axis=0)) | (~rising & falling & np.any(slopes > 0, axis=0))
    wiggles = turns & (cells.width * np.max(np.abs(slopes), axis=0) > _RESOLVED * size)
    steady = ~cells.outcome_changes & ~wiggles
    small = (np.abs(coefficients[5]) <= _RESOLVED * size) & (np.abs(coefficients[4]) <= _BENT * size)
    return steady & small


def quintic(cells: Cells) -> np.ndarray:
    """Coefficients of t⁰ … t⁵ of the polynomial through both nodes of each cell, t from 0 to 1; shape (6, cells)."""
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


def _slope_of(coefficients: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.polynomial.polynomial.polyval(t, [n * c for n, c in enumerate(coefficients)][1:], tensor=False)


def is_jump(cells: Cells, size: np.ndarray) -> np.ndarray:
    """Whether the function jumps within narrow cells; shape (cells,)."""
    change = np.abs(cells.high.value - cells.low.value)
    allowed = 4 * cells.width * np.nan_to_num(np.abs(cells.low.slope) + np.abs(cells.high.slope))
    return change > allowed + _JUMP * size


def polish(evaluate: Evaluate, cells: Cells, ruler: Ruler) -> tuple[Nodes, np.ndarray]:
    """The maxima within cells whose slope falls through zero, by safeguarded Newton.

    It starts from the quintic's own maximum. Where a Newton step on the slope would leave the
    bracket, as it may at a kink, the bracket is halved.

    Returns:
        The nodes at the maxima, and the number of evaluations of each; shape (cells,).
    """
    case = cells.low.case
    low, high = cells.low.at.copy(), cells.high.at.copy()
    at = cells.low.at + cells.width * _falling_root(quintic(cells))
    evaluations = np.zeros(case.size, int)
    best = cells.low
    active = np.ones(case.size, bool)
    while active.any():
        i = np.flatnonzero(active)
        nodes = evaluate(case[i], at[i])
        evaluations[i] += 1
        best = Nodes._make(_put(column, i, new) for column, new in zip(best, nodes, strict=True))
        low[i] = np.where(nodes.slope > 0, at[i], low[i])
        high[i] = np.where(nodes.slope > 0, high[i], at[i])
        with np.errstate(all="ignore"):
            newton = at[i] - nodes.slope / nodes.curve
        inside = (newton >= low[i]) & (newton <= high[i]) & (nodes.curve < 0)
        following = np.where(inside, newton, (low[i] + high[i]) / 2)
        settled = (
            (np.abs(following - at[i]) <= _SETTLED * ruler.near(at[i])) | (nodes.slope == 0) | ~np.isfinite(nodes.slope)
        )
        at[i] = following
        active[i[settled | (evaluations[i] >= 60)]] = False
    return best, evaluations


def _put(column: np.ndarray, index: np.ndarray, new: np.ndarray) -> np.ndarray:
    column = column.copy()
    column[index] = new
    return column


def _falling_root(coefficients: np.ndarray) -> np.ndarray:
    """The root t in (0, 1) where the quintic's slope falls through zero, by bisection."""
    low, high = np.zeros(coefficients.shape[1]), np.ones(coefficients.shape[1])
    for _ in range(40):
        middle = (low + high) / 2
        rising = _slope_of(coefficients, middle) > 0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    return (low + high) / 2
