"""Lanes to their first events, with derivatives: `erosion.ode.solve`."""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import Number, PerLane, as_names, check_order, check_share, check_unmasked, check_whole
from erosion.ode.batch import integrate, integrate_along
from erosion.ode.integrator import LaneEnd
from erosion.ode.problem import Problem, flattened, in_these_words, is_number
from erosion.ode.solution import Part, Solution, Times, path_of
from erosion.ode.step_control import require_float64
from erosion.ode.variational import Clock, Layout, Options
from erosion.output.tables import briefly

_INEXACT = 100.0  # tolerances: results that err by more are told
_TINY = 1e-14  # no tolerance is tighter: rounding is near
_STARTS = ("wait", "end")
_METHODS = ("auto", "explicit", "rosenbrock")


class Lanes(NamedTuple):
    """Problem and arguments as lanes.

    Args:
        layout: of both.
        numbers: each with one axis of lanes, or of one lane's shape where all share it.
        shape: of the lanes.
        names: the path of each number, dots between.
        given: the shape of each number as it was given.
    """

    layout: Layout
    numbers: list[PerLane]
    shape: tuple[int, ...]
    names: tuple[str, ...]
    given: tuple[tuple[int, ...], ...] = ()

    @property
    def size(self) -> int:
        """How many lanes there are."""
        return math.prod(self.shape)

    def element_of(self, name: str) -> int:
        """The place of a number among the elements of all numbers.

        Raises:
            ValueError: where the name is none of a number that each lane has.
        """
        known = [one for one, shape in zip(self.names, self.layout.shapes, strict=True) if shape == ()][:-2]
        if self.names.count(name) > 1:
            raise ValueError(f"Argument `wrt` must say which {name!r} is meant: there is one among `args` as well.")
        if name not in known:
            arrays = [one for one, shape in zip(self.names, self.layout.shapes, strict=True) if shape]
            inside = name in arrays or name.rpartition(".")[0] in arrays
            hint = "; for an array that lanes share, use `Solution.gradient` or `jax.grad`" if inside else ""
            raise ValueError(
                f"Argument `wrt` must name numbers of `args` ({', '.join(known)}), but has {briefly(name)}{hint}."
            )
        return self.layout.offsets[self.names.index(name)]


@in_these_words
def solve(
    problem: Problem,
    args: PyTree = None,
    *,
    t1: Any = None,
    t0: Any = 0.0,
    wrt: str | Sequence[str] = (),
    derivatives: int | None = None,
    rtol: float = 1e-9,
    start: str = "wait",
    ts: Any = None,
    max_step: Any = math.inf,
    max_events: Any = math.inf,
    sizes: PyTree = None,
    smooth: bool | None = None,
    max_steps: int = 20_000,
    method: str = "auto",
    shared: str | Sequence[str] = (),
    gradient: bool = False,
) -> Solution:
    """Integrate lanes, each to the first event that ends it, or to `t1`.

    A lane is one initial value problem; arrays among the arguments make many. Within `jax.jit`, `vmap`, `grad`,
    `hessian` and their like the results are numbers that JAX can trace, with derivatives up to the second.

    Args:
        problem: the equations.
        args: any pytree for its functions. Numbers and arrays in it broadcast, one number for each lane.
        t1: where a lane without an event ends; numbers or arrays. It may be left out where the problem has a
            `time_scale`: then a lane may take any time.
        t0: where lanes begin; numbers or arrays.
        wrt: the numbers by which derivatives are taken, by their path in `args` with dots between: "angle",
            "drag.coefficient", "masses.0"; also "t0" and "t1".
        derivatives: 0, 1 or 2; 1 by default where `wrt` names something.
        rtol: relative tolerance of times, states, integrals and their derivatives.
        start: "wait": an event function that is zero or beyond its event at the start counts once it has returned;
            "end": such a lane ends at its start.
        ts: times at which the state is wanted as well, shape (n,), none before `t0`; at an event that before its
            reset. Where JAX traces `t0` or them nothing can be refused: a state before `t0` is NaN.
        max_step: no step is longer; a pulse of an event function shorter than a step may go unseen.
        max_events: a chain of events that the motion survives ends with this one; None for no bound.
        sizes: typical sizes of y, a pytree like it or one number: a state need not be known to better than
            `rtol` times its size.
        smooth: True says that the equations have no kinks although `sqrt` or `where` occurs; by default the
            arithmetic is looked at.
        max_steps: trials of steps after which a lane is "unfinished".
        method: "explicit", a Runge-Kutta method of 8th order; "rosenbrock", Rodas5P of 5th order for stiff motions of
            up to some twenty unknowns without kinks, whose second derivatives are NaN where they are not known to
            about 1e-4; or "auto": explicit, and lanes that turn out to be stiff by the other (`Solution.stiff`).
        shared: paths of arrays that each lane has as a whole, such as tables and weights.
        gradient: whether `Solution.gradient` follows; it then takes the steps of this integration.

    Returns:
        What the lanes ended by, when, in which state; see `Solution`.

    Raises:
        ValueError, TypeError: for arguments that do not fit, and for functions of the problem that cannot be
            computed, with the line in them. A lane that fails is no error: it is an outcome, in `ended_by`.

    Example:
        >>> from erosion import ode
        >>> fall = ode.Problem(
        ...     y0={"y": 10.0, "v": 0.0},
        ...     vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"]},
        ...     events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
        ... )
        >>> end = ode.solve(fall, {"g": 9.81}, t1=100.0, wrt="g")
        >>> float(end.t), str(end.ended_by)  # √(2·10/9.81)
        (1.427843..., 'ground')
    """
    require_float64()
    names = as_names("wrt", wrt)
    order = check_order((1 if names else 0) if derivatives is None else derivatives)
    if order and not names:
        raise ValueError(f"Argument `derivatives` needs numbers in `wrt`, but is {order} and `wrt` names none.")
    if (names and not order) or len(set(names)) != len(names):
        raise ValueError(f"Argument `wrt` must name different numbers, and needs derivatives, but is {briefly(wrt)}.")
    lanes, rtol = checked_lanes(
        problem, args, t1=t1, t0=t0, rtol=rtol, start=start, max_step=max_step, max_events=max_events, sizes=sizes,
        smooth=smooth, max_steps=max_steps, method=method, shared=shared,
    )  # fmt: skip
    if any(isinstance(number, Tracer) for number in (*lanes.numbers, *jax.tree.leaves(ts))):
        from erosion.ode.traced import traced_solution

        return traced_solution(lanes, names, order, rtol, ts)
    if gradient:
        from erosion.ode.gradient import goes_back

        lanes = lanes._replace(layout=lanes.layout.wanting(records=goes_back(lanes.layout)))
    return solution(lanes, names, order, rtol, None if ts is None else checked_times(lanes, ts))


def checked_lanes(
    problem: Problem,
    args: PyTree,
    *,
    t1: Any,
    t0: Any,
    rtol: float,
    start: str,
    max_step: Any,
    max_events: Any,
    sizes: PyTree,
    smooth: bool | None,
    max_steps: int,
    method: str,
    shared: str | Sequence[str],
) -> tuple[Lanes, float]:
    """Lanes of arguments that fit, and the tolerance; see `solve`, also for what is raised."""
    for name, given, known in (("start", start, _STARTS), ("method", method, _METHODS)):
        if not isinstance(given, str) or given not in known:
            raise ValueError(
                f"Argument `{name}` must be one of {', '.join(map(repr, known))}, but is {briefly(given)}."
            )
    if smooth is not None and not isinstance(smooth, bool):
        raise TypeError(f"Argument `smooth` must be True, False or None, but is {briefly(smooth)}.")
    if not isinstance(problem, Problem):
        raise TypeError(f"Argument `problem` must be an `ode.Problem`, but is {briefly(problem)}.")
    rtol = max(check_share("rtol", rtol), _TINY)
    options = Options(
        waits=True,
        begins=start == "end",
        clock=True,
        whole=True,
        smooth=smooth,
        max_steps=check_whole("max_steps", max_steps, 1),
        method=method,
    )
    t_end, most = (math.inf if each is None else each for each in (t1, max_events))
    clock = Clock(t0, t_end, max_step, most)
    if t1 is None and problem.time_scale is None:
        raise ValueError("Argument `t1` must say where a lane without an event ends, but is not given.")
    return lanes_of(problem, args, clock, options, shared, sizes), rtol


def lanes_of(
    problem: Problem,
    args: PyTree,
    clock: Clock,
    options: Options,
    shared: str | Sequence[str] = (),
    sizes: PyTree = None,
) -> Lanes:
    """Layout, numbers and shape of lanes.

    Raises:
        ValueError, TypeError: for numbers that do not broadcast, or functions that cannot be computed.
    """
    paths, structure = flattened("args", args)
    names = [".".join(path_of(keys)) for keys, _ in paths]
    leaves = [leaf for _, leaf in paths]
    shared = as_names("shared", shared)
    whole = [any(name == one or name.startswith(f"{one}.") for one in shared) for name in names]
    for one in shared:
        if not any(name == one or name.startswith(f"{one}.") for name in names):
            raise ValueError(
                f"Argument `shared` must name parts of `args` ({', '.join(names)}), but has {briefly(one)}."
            )
    numbers, own, structs = [], [], []
    for name, leaf, together in zip(names, leaves, whole, strict=True):
        if not is_number(leaf):
            if isinstance(leaf, (complex, np.ndarray, np.generic, jax.Array)):
                raise TypeError(
                    f"Argument `args` must hold real numbers, but {name or 'it'} has type {np.asarray(leaf).dtype}."
                )
            if hasattr(type(leaf), "__array__"):  # of pandas, xarray: its labels would be ignored, and its changes
                raise TypeError(
                    f"Argument `args` must hold arrays of numpy or JAX, but {name or 'it'} is a {type(leaf).__name__}; "
                    "give its values, `.to_numpy()`."
                )
            continue
        check_unmasked(f"args.{name}" if name else "args", leaf)
        array = leaf if isinstance(leaf, (Tracer, jax.Array)) else np.asarray(leaf)
        shape, kind = (array.shape if together else ()), np.dtype(array.dtype).kind
        if kind == "O":
            raise ValueError(f"Argument `args` must hold numbers below 1e308, but {name or 'it'} is greater.")
        structs.append(jax.ShapeDtypeStruct(shape, array.dtype if together and kind != "f" else np.float64))
        numbers.append(array)
        own.append(name)
    own += Clock._fields
    for name, value in zip(Clock._fields, clock, strict=True):
        value = np.asarray(value) if isinstance(value, (list, tuple)) else value
        if not is_number(value) or isinstance(value, bool) or (not isinstance(value, Tracer) and _is_huge(value)):
            raise TypeError(f"Argument `{name}` must be a number or an array, but is {briefly(value)}.")
        check_unmasked(name, value)
        numbers.append(value if isinstance(value, (Tracer, jax.Array)) else np.asarray(value, float))
    _check_clock(clock, endless=problem.time_scale is not None)
    shapes = [struct.shape for struct in structs] + [()] * len(clock)
    many = [(name, number) for name, number, shape in zip(own, numbers, shapes, strict=True) if shape == ()]
    try:
        shape = np.broadcast_shapes(*(np.shape(number) for _, number in many))
    except ValueError:
        said = ", ".join(f"{name} {np.shape(number)}" for name, number in many if np.ndim(number))
        raise ValueError(
            f"Argument `args` must hold numbers and arrays that broadcast, but shapes are {said}; "
            "name arrays that each lane has as a whole in `shared`."
        ) from None
    equations = problem.equations(args, structs)
    if equations.flaw is not None:
        raise ValueError(f"Argument `problem` must be one that can be computed, but {equations.flaw}.")
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    own_shapes, dtypes = tuple(s.shape for s in structs), tuple(np.dtype(s.dtype).name for s in structs)
    layout = Layout(problem, structure, rest, own_shapes, dtypes, options, equations)
    if sizes is not None:
        layout = layout.wanting(sizes=_sizes(layout, sizes))
    flat = numbers
    if not any(isinstance(number, Tracer) for number in numbers):
        flat = [_flat(number, own_shape, shape) for number, own_shape in zip(numbers, shapes, strict=True)]
    return Lanes(layout, flat, shape, tuple(own), tuple(np.shape(number) for number in numbers))


def _flat(number: Number, own: tuple[int, ...], shape: tuple[int, ...]) -> Any:
    """A number with one axis of lanes, or of one lane's shape where all share it."""
    if own or isinstance(number, Tracer) or np.ndim(number) == 0:
        return number if isinstance(number, Tracer) else np.array(number)
    array = np.asarray(number)
    # Copies: the caller may change his own.
    return np.array(array.reshape(())) if array.size == 1 else np.broadcast_to(array, shape).flatten()


def _check_clock(clock: Clock, *, endless: bool) -> None:
    """Refuse times that run backwards or nowhere, and limits that are none; a motion may be `endless`."""
    if any(isinstance(number, Tracer) for number in clock):
        return
    with np.errstate(invalid="ignore"):
        try:
            backwards = np.any(np.asarray(clock.t1) < np.asarray(clock.t0))
        except ValueError:
            return  # shapes that do not broadcast are told of with all others
    if backwards:
        raise ValueError(
            "Argument `t1` must not be before `t0`; for a motion back in time change the sign of its rates."
        )
    for name, times in (("t0", clock.t0), ("t1", clock.t1)):
        if np.size(times) and np.all(np.isnan(times)):
            raise ValueError(f"Argument `{name}` must be a time, but is {briefly(times)}.")
    if not endless and np.any(np.isinf(clock.t1)):
        raise ValueError(
            f"Argument `t1` must be finite where the problem has no `time_scale`, but is {briefly(clock.t1)}."
        )
    if not np.all(np.asarray(clock.max_step) > 0):
        raise ValueError(f"Argument `max_step` must be positive, but is {briefly(clock.max_step)}.")
    most = np.asarray(clock.max_events)
    if not np.all((most >= 1) & (most == np.floor(most))):
        raise ValueError(
            f"Argument `max_events` must be a whole number of at least 1, but is {briefly(clock.max_events)}."
        )


def _sizes(layout: Layout, sizes: PyTree) -> tuple[float, ...]:
    """A size for each element of the state."""
    for size in jax.tree.leaves(sizes):
        check_unmasked("sizes", size)
    leaves, structure = jax.tree.flatten(layout.state)
    if is_number(sizes) and np.ndim(sizes) == 0:
        sizes = jax.tree.unflatten(structure, [sizes] * len(leaves))
    if jax.tree.structure(sizes) != structure:
        raise ValueError(f"Argument `sizes` must be one number, or a pytree like y, but is {briefly(sizes)}.")
    try:
        pairs = zip(jax.tree.leaves(sizes), leaves, strict=True)
        flat = [np.broadcast_to(np.asarray(size, float), leaf.shape).ravel() for size, leaf in pairs]
    except (TypeError, ValueError):
        raise ValueError(f"Argument `sizes` must hold numbers of the shapes of y, but is {briefly(sizes)}.") from None
    values = tuple(float(size) for size in np.concatenate(flat))
    if not all(0 < size < math.inf for size in values):
        raise ValueError(f"Argument `sizes` must hold positive numbers, but is {briefly(sizes)}.")
    return values


def ends(
    lanes: Lanes, names: Sequence[str], order: int, rtol: float, times: np.ndarray | None = None
) -> tuple[LaneEnd, list[tuple[str, ...]]]:
    """The ends of lanes, and along which names the last axis of their derivatives is, where there are several."""
    layout, numbers, count = lanes.layout, lanes.numbers, lanes.size
    if order == 0 or len(names) == 1:
        places = (lanes.element_of(names[0]),) if order else ()
        return integrate(layout, numbers, count, order, places, rtol, times=times), [(*names, *names)[:order]]
    along = [(name,) for name in names] if order == 1 else list(itertools.combinations_with_replacement(names, 2))
    places = np.array([[lanes.element_of(name) for name in each] for each in along], float).T
    results = integrate_along(layout, numbers, count, order, places, rtol, times=times)
    # A lane that fails along one direction fails in all.
    failed = np.any(layout.has_no_result(results.outcome), axis=1)
    outcome = np.where(failed, results.outcome.max(axis=1), results.outcome[:, 0])
    results = results._replace(
        outcome=outcome,
        trials=results.trials.sum(axis=1),
        count=results.count[:, 0],
        stiff=None if results.stiff is None else results.stiff.max(axis=1),
        error=np.max(np.asarray(results.error), axis=1),
        at_once=[each[:, 0] for each in results.at_once],
    )
    return results, along


def solution(lanes: Lanes, names: Sequence[str], order: int, rtol: float, ts: np.ndarray | None = None) -> Solution:
    """The solution of lanes, with derivatives of an order along all pairs of names, and states at times."""
    known = None if ts is None else np.unique(ts[np.isfinite(ts)])
    results, along = ends(lanes, names, order, rtol, known)
    lanes = lanes._replace(layout=lanes.layout.wanting(records=False))
    several = results.time.value.ndim > 1

    def part(kind: str, column: int) -> Part:
        """Times, states and integrals, or one of their derivatives."""
        time, *outputs = (
            found[:, column].reshape(lanes.shape)[()] if several else found.reshape(lanes.shape)[()]
            for found in getattr(results.quantities, kind)
        )
        return shaped(lanes, time, outputs)

    value = part("value", 0)
    t0 = np.broadcast_to(np.asarray(lanes.numbers[-len(Clock._fields)]), lanes.size).reshape(lanes.shape)
    found: dict[tuple[str, ...], Part] = {}
    for i, each in enumerate(along if order else []):
        for kind, path in (("first", each[:1]), ("other", each[-1:]), ("second", each[:2])):
            if len(path) <= order and (kind != "second" or order == 2) and path not in found:
                found[path] = part(kind, i)
    if ("t0",) in found:
        found[("t0",)] = found[("t0",)]._replace(t=found[("t0",)].t + 1.0)
    outcome = results.outcome.reshape(lanes.shape)
    t1 = np.broadcast_to(np.asarray(lanes.layout.clock(lanes.numbers).t1), lanes.size).reshape(lanes.shape)
    # To the last digit: t0 + (t1 - t0) may be another number.
    t = np.where(outcome == lanes.layout.end_names.index("t1"), t1, value.t + t0)[()]
    times = None if ts is None or results.saved is None else _at_times(lanes, ts, t, results.saved, along)
    stiff = np.full(lanes.size, lanes.layout.options.method == "rosenbrock")
    if results.stiff is not None:
        stiff = results.stiff > 0
    return Solution(
        problem=lanes.layout.problem,
        names=lanes.layout.end_names,
        wrt=tuple(names),
        outcome=outcome[()],
        t=t,
        y=value.y,
        integrals=value.integrals,
        count=results.count.reshape(lanes.shape)[()],
        trials=results.trials.reshape(lanes.shape)[()],
        at_once=named_events(lanes, [each.reshape(lanes.shape)[()] > 0 for each in results.at_once]),
        stiff=stiff.reshape(lanes.shape)[()],
        derivatives=found,
        lanes=lanes,
        rtol=rtol,
        digest=lanes.layout.equations.digest,
        tolerance=None if order else results.tolerance,
        inexact=np.reshape(np.asarray(results.error) > _INEXACT * rtol, lanes.shape)[()],
        recorded=results.recorded,
        times=times,
    )


def shaped(lanes: Lanes, time: Any, outputs: Sequence[Any]) -> Part:
    """Time, state and integrals in the structure of the problem; arrays of a state have their own axes last."""
    leaves, structure = jax.tree.flatten(lanes.layout.state)
    rest, parts = list(outputs), []
    stack = jax.numpy.stack if isinstance(time, Tracer) else np.stack
    for leaf in leaves:
        own, rest = rest[: math.prod(leaf.shape)], rest[math.prod(leaf.shape) :]
        parts.append(stack(own, -1).reshape(np.shape(time) + leaf.shape) if leaf.shape else own[0])
    return Part(
        time, jax.tree.unflatten(structure, parts), dict(zip(lanes.layout.problem.integrals, rest, strict=True))
    )


def named_events(lanes: Lanes, flags: Sequence[Any]) -> dict[str, Any]:
    """By the name of each event whether it happens at the end."""
    return dict(zip(lanes.layout.event_names, flags, strict=True))


def again(lanes: Lanes, copies: int, rtol: float, **clock: PerLane) -> LaneEnd:
    """Each lane several times over, with other numbers of the clock, of shape (lanes, copies)."""
    which = np.repeat(np.arange(lanes.size), copies)
    numbers = lanes.layout.of_lanes(lanes.numbers, which)
    for name, value in clock.items():
        numbers[len(numbers) - len(Clock._fields) + Clock._fields.index(name)] = np.ascontiguousarray(value).reshape(-1)
    return integrate(lanes.layout, numbers, which.size, 0, (), rtol)


def _is_huge(value: Number) -> bool:
    """Whether a whole number is beyond all floats."""
    return np.asarray(value).dtype.kind == "O"


def checked_times(lanes: Lanes, ts: Any) -> np.ndarray:
    """Times at which states are wanted."""
    check_unmasked("ts", ts)
    try:
        times = np.array(ts, float)  # the caller may change his own
    except (TypeError, ValueError):
        raise TypeError(f"Argument `ts` must be one row of times, but is {briefly(ts)}.") from None
    if times.ndim != 1:
        raise ValueError(f"Argument `ts` must be one row of times, but has shape {times.shape}.")
    t0 = lanes.layout.clock(lanes.numbers).t0
    t0 = np.broadcast_to(-math.inf if isinstance(t0, Tracer) else np.asarray(t0), lanes.size)
    early = times[times < np.fmax.reduce(t0, initial=-math.inf)]
    if early.size:
        raise ValueError(f"Argument `ts` must hold no times before `t0`, but has {early.min():g}.")
    return times


def _at_times(lanes: Lanes, ts: np.ndarray, t: Any, saved: np.ndarray, along: Sequence[tuple[str, ...]]) -> Times:
    """The states at times and their derivatives; NaN after the end, which is among the times itself.

    Args:
        lanes: the lanes.
        ts: the times in the order asked for.
        t: the end of each lane.
        saved: at each finite time once, in rising order; see `LaneEnd`.
        along: the names of the derivatives.
    """
    known, wide = np.isfinite(ts), lanes._replace(shape=(*lanes.shape, ts.size))
    places = np.unique(ts[known], return_inverse=True)[1]
    in_order, late = np.array_equal(places, np.arange(ts.size)), ts > np.reshape(t, (-1, 1))

    def part(column: int, member: int) -> Times:
        of_along = saved if saved.ndim == 4 else saved[:, column]
        rows = of_along[:, :, member]
        if not in_order:
            rows = np.full((lanes.size, ts.size, saved.shape[-1]), np.nan)
            rows[:, known] = of_along[:, places, member]
        rows[late] = np.nan
        outputs = [row.reshape(wide.shape) for row in np.moveaxis(rows, -1, 0)]
        y, integrals = shaped(wide, np.broadcast_to(ts, wide.shape), outputs)[1:]
        return Times(ts, y, integrals)

    members, found = saved.shape[-2], {}
    for column, names in enumerate(along if members > 1 else []):
        for name, member in zip(names, (1, 2 if members == 4 else 1), strict=False):
            found.setdefault((name,), part(column, member))
        if len(names) == 2:
            found[names] = part(column, members - 1)
    return part(0, 0)._replace(derivatives=found)
