"""The greatest value of a quantity over one of a problem's numbers, certified: `erosion.ode.maximum`.

Where lanes end by another event, a quantity jumps, and the greatest value may be at a jump or a kink, where no
derivative vanishes. So the quantity is resolved over the whole range first (`resolve.py`). The answer is the best of
every maximum, of both sides of every jump and of both ends of the range (`maxima.py`).
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import Number, PerImpact, PerLane, Scalar, as_names, as_pair, check_share, check_whole
from erosion.lanes.digests import hashed
from erosion.lanes.engines import compile_lanes
from erosion.lanes.flatten import NotForLanesError
from erosion.lanes.lanewise import Lanewise
from erosion.ode.batch import compiling
from erosion.ode.ensemble import LEAST_RTOL, Lanes, checked_lanes, path_of, shaped
from erosion.ode.integrator import LaneEnd
from erosion.ode.maxima import LOOSE, TIGHT, Maxima, QuantityAlong, Search, SearchRange, columns, searched
from erosion.ode.problem import FunctionError, Problem, Traced, flattened, is_number, require_numbers
from erosion.ode.resolve import Ruler
from erosion.ode.signature import Clock
from erosion.ode.step_control import require_float64
from erosion.ode.variational import Derivatives
from erosion.output.tables import briefly, format_number
from erosion.results import Columns, Declared, Result, Value

_POINTS = 64
_ROOM = 1e-3  # of a range's magnitude: a narrower one is near the rounding of its numbers


class End(NamedTuple):
    """What `of` is given: the end of one lane.

    Args:
        t: when.
        y: the state there, a pytree like y0.
        integrals: by name.
        args: of the lane.
    """

    t: Scalar
    y: PyTree
    integrals: Mapping[str, Scalar]
    args: Any


_RIVALS = ("candidates", "jumps", "regimes")


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Maximum(Result):
    """The greatest (or least) value of a quantity over one number; arrays have the shape of the other arguments.

    Args:
        problem: what was integrated.
        over: the number.
        least: whether the quantity is least there.
        at: the number there; 1e-9 units beside a jump, which is known to 1e-11; the middle of a plateau; NaN where all
            lanes failed. The unit is the width of the range, or a thousandth of its greatest magnitude if that is more.
        low, high: the ends of a plateau; else both are `at`.
        value: the quantity there.
        kind: "interior" (its slope is zero), "jump" (one side of a discontinuity; see `side` and `attained`),
            "boundary" (an end of the range), "kink" (the slope jumps through zero), "plateau" (the same value from
            `low` to `high`, to nine digits), "unresolved" (the greatest value that was computed, where derivatives
            do not exist; the number is known to 1e-6 units at best), or "none": every lane failed.
        ended_by: how the lane ends there.
        side: the side of a jump, "below" or "above"; else "".
        attained: whether `value` is reached, or only approached beside a jump.
        slope, curve: the first two derivatives of the quantity by the number there.
        candidates: every maximum that was compared, best first: a tuple of `maxima.Extremum`.
        jumps: all discontinuities, a tuple of `maxima.Discontinuity` in ascending order.
        regimes: how lanes end over the whole range, a tuple of `maxima.Regime` in ascending order.
        iterations: rounds of refinement plus Newton steps of the answer.
        certified: False where a lane failed or has no derivatives, so that a better number may have been missed.
    """

    problem: Problem
    over: str
    least: bool
    at: PerImpact
    low: PerImpact
    high: PerImpact
    value: PerImpact
    kind: PerImpact
    ended_by: PerImpact
    side: PerImpact
    attained: PerImpact
    slope: PerImpact
    curve: PerImpact
    candidates: Any
    jumps: Any
    regimes: Any
    iterations: PerImpact
    certified: PerImpact

    @property
    def title(self) -> str:
        """The quantity, and the number it is searched over."""
        return f"The {'least' if self.least else 'greatest'} value over {self.over}"

    def declare(self) -> list[Declared]:
        """The answer with every rival."""
        search = f"no {'smaller' if self.least else 'greater'} value in any resolved cell"
        why = "lanes failed or have no derivatives: a better value may have been missed"
        one = not np.ndim(self.kind)
        names = ("over", "least", "low", "high", "side", "attained", "slope", "curve", "iterations")
        return [
            Value("at", self.at, self.over, digits=10),
            Value("value", self.value, digits=10),
            Value("kind", self.kind, meaning=self._kind_explained() if one else ""),
            Value("ended_by", self.ended_by, meaning="how the lane ends there"),
            Value(
                "certified",
                self.certified,
                meaning=search if np.all(self.certified) else why,
            ),
            *(Value(name, getattr(self, name), only="data") for name in names),
            *(self._rivals() if one else [Value(name, getattr(self, name), only="data") for name in _RIVALS]),
        ]

    def _rivals(self) -> list[Declared]:
        return [Columns.of(name, "", getattr(self, name), {}, only="data") for name in _RIVALS]

    def _kind_explained(self) -> str:
        explained = {
            "interior": "the slope is zero",
            "jump": f"just {self.side} a jump" + ("" if self.attained else ", not reached"),
            "boundary": "an end of the range",
            "kink": "the slope jumps through zero",
            "plateau": f"the same from {format_number(self.low)} to {format_number(self.high)}",
            "unresolved": f"the {'least' if self.least else 'greatest'} value that was computed",
            "none": "every lane failed",
        }
        return explained[str(self.kind)]


def maximum(
    problem: Problem,
    args: PyTree = None,
    *,
    of: Callable[[End], Any],
    over: str,
    between: tuple[float, float],
    t1: Any = None,
    t0: Any = 0.0,
    least: bool = False,
    points: int = _POINTS,
    rtol: float = LOOSE,
    start: str = "wait",
    max_step: Any = math.inf,
    max_events: Any = math.inf,
    state_scale: PyTree = None,
    smooth: bool | None = None,
    max_steps: int = 20_000,
    method: str = "auto",
    shared: str | Sequence[str] = (),
) -> Maximum:
    """The greatest (or least) value of a quantity of the end over one number, for one problem or for arrays of them.

    The quantity may jump and have kinks. It is computed with two derivatives at `points` numbers, and the cells
    between are split until each is resolved, or so narrow that it holds a jump or a kink. A cell is resolved if lanes
    end in the same way at both ends, and a quintic fits both to 1e-6 of the greatest value, or of how far they are
    from it. (Near zero, of how far three quarters of the first numbers are.) That is what is certified. It is no
    proof: a peak much narrower than the first cells, and two jumps within one cell, may be missed if the quintic fits
    the ends of the cell. More `points` look closer.

    Args:
        problem: the equations.
        args: any pytree for its functions, as in `solve`. Arrays make many problems; they share the range.
        of: the quantity, a real number, by jax.numpy from the end of one lane: its `t`, `y`, `integrals` and `args`.
        over: the number, by its path in `args` with dots between, or "t0" or "t1". What stands there is not used.
        between: the ends of its range, both included.
        t1: where lanes end without an event.
        t0: where lanes begin.
        least: whether the least value is wanted.
        points: how many numbers are tried first.
        rtol: relative tolerance of the search, 1e-9 or less; what is found has a hundredth of it.
        start: "wait", "end" or "fire", as in `solve`; so are all options below.
        max_step: no step is longer.
        max_events: a chain of events ends with this one.
        state_scale: typical sizes of y.
        smooth: whether the equations have no kinks.
        max_steps: trials of steps after which a lane is "unfinished", which counts as failed.
        method: "auto" or "explicit".
        shared: paths of arrays that each lane has as a whole.

    Returns:
        The best of every maximum, of both sides of every jump and of both ends; see `Maximum`.

    Raises:
        ValueError, TypeError: for what does not fit or cannot be computed, with the line in the function. Lanes that
            fail are no error: see `certified` and the kind "none".

    Example:
        >>> from erosion import ode
        >>> hat = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": args["a"] * (1 - args["a"])})
        >>> best = ode.maximum(hat, {"a": 0.0}, of=lambda end: end.y["x"], over="a", between=(0.0, 0.9), t1=1.0)
        >>> round(float(best.at), 9), str(best.kind)
        (0.5, 'interior')
    """
    require_float64()
    low, high = _checked_range(between)
    shared, rtol = as_names("shared", shared), check_share("rtol", rtol)
    if not rtol <= LOOSE:
        raise ValueError(
            f"Argument `rtol` must be {LOOSE:g} or less, to tell jumps from slopes, but is {briefly(rtol)}."
        )
    grid = np.unique(np.linspace(low, high, check_whole("points", points, 2)))
    args = _with_number(args, over, low, shared)
    # All times of the range must fit: the clock is checked with the worst of them.
    t0, t1 = high if over == "t0" else t0, low if over == "t1" else t1
    lanes, rtol = checked_lanes(
        problem, args, t1=t1, t0=t0, rtol=rtol, start=start, max_step=max_step, max_events=max_events,
        state_scale=state_scale, smooth=smooth, max_steps=max_steps, method=method, shared=shared,
    )  # fmt: skip
    if lanes.original is not None:
        raise ValueError("Argument `t1` must not be before `t0` in `maximum`.")
    ruler = Ruler(unit=max(high - low, _ROOM * max(abs(low), abs(high))))
    optima = _optima(lanes, over, of, SearchRange(low, high, grid, ruler), rtol, least=least)
    return Maximum(problem=problem, over=over, least=least, **columns(optima, lanes.shape))


def _optima(
    lanes: Lanes, over: str, of: Callable[[End], Any], within: SearchRange, rtol: float, *, least: bool
) -> list[Maxima]:
    """The maxima of each lane."""
    if any(isinstance(number, Tracer) for number in lanes.parameters):
        raise TypeError("Arguments of `maximum` must be numbers: JAX cannot trace a search.")
    lanes = lanes._replace(signature=lanes.signature.wanting(one_sided=True))
    signature, place = lanes.signature, lanes.names.index(over)
    quantity, tight = _Quantity(lanes, place, of), max(rtol * (TIGHT / LOOSE), LEAST_RTOL)

    def search(which: slice, cases: int) -> list[Maxima]:
        parameters = signature.of_lanes(lanes.parameters, which)
        objective = functools.partial(QuantityAlong, signature, parameters, place, quantity, least, refines=True)
        names = signature.end_names
        return Search(
            lambda rtol: objective(rtol=rtol), cases, names, within, least=least, loose=rtol, tight=tight
        ).optima()

    return searched(lanes.size, search)


def _checked_range(between: tuple[float, float]) -> tuple[float, float]:
    low, high = as_pair(between)
    if not -math.inf < low < high < math.inf:
        raise ValueError(f"Argument `between` must be two ascending numbers, but is {briefly(between)}.")
    return low, high


def _with_number(args: PyTree, over: str, number: float, shared: Sequence[str]) -> PyTree:
    """The arguments with a number in the place of the one that is varied."""
    if not isinstance(over, str):
        raise TypeError(f"Argument `over` must be the name of a number, but is {briefly(over)}.")
    if any(over == one or over.startswith(f"{one}.") for one in shared):
        raise ValueError(f"Argument `over` must name one number of each lane, but {over!r} is among `shared`.")
    paths, structure = flattened("args", args)
    names = [".".join(path_of(keys)) for keys, _ in paths]
    leaves = [leaf for _, leaf in paths]
    known = [name for name, leaf in zip(names, leaves, strict=True) if is_number(leaf)]
    if over in ("t0", "t1"):
        if over in known:
            raise ValueError(f"Argument `over` must say which {over!r} is meant: there is one among `args` as well.")
        return args
    if known.count(over) != 1:
        raise ValueError(
            f"Argument `over` must name a number of `args` ({', '.join(known)}), t0 or t1, but is {briefly(over)}."
        )
    leaves[names.index(over)] = number
    return jax.tree.unflatten(structure, leaves)


class _Quantity:
    """The quantity of the ends of lanes, with its derivatives by one of their numbers.

    Along the number u, with the end o(u) and the quantity f(o): f' = f_o o' and f'' = f_o o'' + f_oo o' o'.

    Args:
        lanes: problem and arguments.
        place: which of the numbers.
        of: the quantity.
    """

    def __init__(self, lanes: Lanes, place: int, of: Callable[[End], Any]) -> None:
        if not callable(of):
            raise TypeError(f"Argument `of` must be a function of the end of a lane, but is {briefly(of)}.")
        self._lanes, self._place, self._of = lanes, place, of
        signature = lanes.signature
        outputs = sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(signature.state)) + len(
            signature.problem.integrals
        )
        self._ends = [jax.ShapeDtypeStruct((), np.float64)] * (1 + outputs)
        labels = [hashed("argument", str(i)) for i in range(len(signature.shapes))]
        try:
            given = Traced(list, signature.structs(), labels).given("of", self._given, self._ends)
            if jax.tree.structure(given).num_leaves != 1:
                raise FunctionError("`of` must give one number")
            require_numbers("of", given)
        except FunctionError as error:
            raise ValueError(f"Argument `of` must be a function of the end of a lane, but {error}.") from error
        self._compiled = functools.cache(self._program)

    def __call__(self, results: LaneEnd, parameters: list[PerLane]) -> Derivatives:
        """Value, and where the ends have derivatives, `first` and `second`."""
        parts = [
            list(map(np.asarray, each))
            for each in (results.quantities.value, results.quantities.by_first, results.quantities.mixed)
            if each is not None
        ]
        with compiling:
            program = self._compiled(len(parts) > 1)
        lanes = np.size(results.outcome)
        leaves = [np.asarray(number, float) for number in [*parameters, *itertools.chain.from_iterable(parts)]]
        found = [np.empty(lanes) for _ in parts]
        program.run(leaves, np.arange(lanes), found)
        # An infinite quantity is none.
        failed = self._lanes.signature.has_no_result(np.asarray(results.outcome)) | ~np.isfinite(found[0])
        value, *slopes = (np.where(failed, np.nan, part) for part in found)
        first, second = slopes or (None, None)
        return Derivatives(value, first, first, second)

    def _program(self, derivatives: bool) -> Lanewise:
        examples = self._lanes.signature.structs(), *[self._ends] * (3 if derivatives else 1)
        try:
            return compile_lanes(self._with_derivatives if derivatives else self._value, examples)
        except NotForLanesError as error:
            raise ValueError(f"Argument `of` must be a function that lanes can compute. {error}") from error

    def _given(self, parameters: Sequence[Number], ends: Sequence[Scalar]) -> Any:
        """What `of` gives for the end of a lane."""
        signature = self._lanes.signature
        part = shaped(self._lanes, ends[0], ends[1:])
        clock: Clock = signature.clock(parameters)
        return self._of(End(part.t + clock.t0, part.y, part.integrals, signature.args(parameters)))

    def _value(self, parameters: Sequence[Number], ends: Sequence[Scalar]) -> Scalar:
        (value,) = jax.tree.leaves(self._given(parameters, ends))
        return jnp.asarray(value, float)

    def _with_derivatives(
        self, parameters: Sequence[Number], ends: list[Scalar], first: list[Scalar], second: list[Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        def value(number: Scalar, ends: list[Scalar]) -> Scalar:
            return self._value([*parameters[: self._place], number, *parameters[self._place + 1 :]], ends)

        def slope(number: Scalar, ends: list[Scalar], first: list[Scalar]) -> Scalar:
            return jax.jvp(value, (number, ends), (one, first))[1]

        one = jnp.ones(())
        number = jnp.asarray(parameters[self._place])
        curve = jax.jvp(slope, (number, ends, first), (one, first, second))[1]
        return value(number, ends), slope(number, ends, first), curve
