"""Problem and arguments as lanes, and the parts of their results: what every way to solve needs."""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import Number, PerImpact, PerLane, as_names, check_share, check_unmasked, check_whole
from erosion.ode.back_in_time import reflected
from erosion.ode.batch import integrate, integrate_along
from erosion.ode.integrator import LaneEnd
from erosion.ode.methods import METHODS
from erosion.ode.outputs import StateOutputs
from erosion.ode.problem import Problem, flattened, is_number
from erosion.ode.signature import Clock, Options, Signature
from erosion.output.tables import briefly

LEAST_RTOL = 1e-14  # no tolerance is tighter: rounding is near
_STARTS = ("wait", "fire", "end")
_CLOCK = ("t0", "t1")  # by which there are derivatives
_METHODS = tuple(METHODS)

_Of = TypeVar("_Of")


def path_of(keys: Sequence[Any]) -> tuple[str, ...]:
    """The path of a leaf in a pytree, as words."""
    return tuple(str(getattr(key, "key", getattr(key, "name", getattr(key, "idx", key)))) for key in keys)


class Lanes(NamedTuple):
    """Problem and arguments as lanes.

    Args:
        signature: of both.
        parameters: each with one axis of lanes, or of one lane's shape where all share it.
        shape: of the lanes.
        names: the path of each number, dots between.
        given: the shape of each number as it was given.
        original: where time goes back, the problem that was given; the signature is that of the reflected one.
    """

    signature: Signature
    parameters: list[PerLane]
    shape: tuple[int, ...]
    names: tuple[str, ...]
    given: tuple[tuple[int, ...], ...] = ()
    original: Problem | None = None

    @property
    def size(self) -> int:
        """How many lanes there are."""
        return math.prod(self.shape)

    def turned(self, until: float | None = None) -> "Lanes":
        """The lanes in the other direction of time; they end at a time of these, or where these end."""
        problem = self.signature.problem
        clock = self.signature.clock(self.parameters)
        end = clock.t1 if until is None else np.minimum(clock.t0, until)
        parameters = [*self.parameters[: -len(clock)], *clock._replace(t0=-1.0 * clock.t0, t1=-1.0 * end)]
        signature = self.signature.of_problem(self.original or reflected(problem))
        return self._replace(signature=signature, parameters=parameters, original=problem)  # pyrefly: ignore

    def element_of(self, name: str) -> int:
        """The place of a number among the elements of all numbers.

        Raises:
            ValueError: where the name is none of a number that each lane has.
        """
        count = self.signature.arguments
        known = [*self.names[:count], *_CLOCK]
        # "args.t1" is an argument although `solve` has a number of that name, which is "solve.t1".
        labels = [*(f"args.{one}" for one in self.names[:count]), *(f"solve.{one}" for one in _CLOCK)]
        places = [i for i, one in enumerate(known) if one == name]
        places = places or [i for i, one in enumerate(labels) if one == name]
        if len(places) > 1:
            which = " or ".join(dict.fromkeys(repr(labels[i]) for i in places))
            raise ValueError(f"Argument `wrt` must say which {name!r} is meant, {which}, as there are several.")
        if not places or self.signature.shapes[places[0]] != ():
            inside = bool(places) or name.rpartition(".")[0] in self.names
            hint = "; for an array that lanes share, use `Solution.gradient` or `jax.grad`" if inside else ""
            scalars = [one for one, shape in zip(known, self.signature.shapes, strict=False) if shape == ()]
            raise ValueError(
                f"Argument `wrt` must name numbers of `args` ({', '.join(scalars)}), but has {briefly(name)}{hint}."
            )
        return self.signature.offsets[places[0]]

    def is_of_clock(self, name: str) -> bool:
        """Whether a name is that of where lanes begin or end."""
        return self.element_of(name) >= self.signature.offsets[self.signature.arguments]

    def begins_with(self, name: str) -> bool:
        """Whether a name is that of where lanes begin."""
        return self.element_of(name) == self.signature.offsets[self.signature.arguments]


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
    state_scale: PyTree,
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
    rtol = max(check_share("rtol", rtol), LEAST_RTOL)
    options = Options(
        arm_on_return=True,
        check_start=start == "end",
        fires=start == "fire",
        outputs=StateOutputs(),
        smooth=smooth,
        switches=not smooth,
        max_steps=check_whole("max_steps", max_steps, 1),
        method=method,
    )
    t_end, most = (math.inf if each is None else each for each in (t1, max_events))
    clock = Clock(t0, t_end, max_step, most)
    if t1 is None and problem.time_scale is None:
        raise ValueError("Argument `t1` must say where a lane without an event ends, but is not given.")
    return lanes_of(problem, args, clock, options, shared, state_scale), rtol


def lanes_of(
    problem: Problem,
    args: PyTree,
    clock: Clock,
    options: Options,
    shared: str | Sequence[str] = (),
    state_scale: PyTree = None,
) -> Lanes:
    """Signature, parameters and shape of lanes.

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
    parameters, own, structs = [], [], []
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
        parameters.append(array)
        own.append(name)
    own += Clock._fields
    for name, value in zip(Clock._fields, clock, strict=True):
        value = np.asarray(value) if isinstance(value, (list, tuple)) else value
        if not is_number(value) or isinstance(value, bool) or (not isinstance(value, Tracer) and _is_huge(value)):
            raise TypeError(f"Argument `{name}` must be a number or an array, but is {briefly(value)}.")
        check_unmasked(name, value)
        parameters.append(value if isinstance(value, (Tracer, jax.Array)) else np.asarray(value, float))
    is_back = _check_clock(clock, endless=problem.time_scale is not None)
    shapes = [struct.shape for struct in structs] + [()] * len(clock)
    many = [(name, number) for name, number, shape in zip(own, parameters, shapes, strict=True) if shape == ()]
    try:
        shape = np.broadcast_shapes(*(np.shape(number) for _, number in many))
    except ValueError:
        said = ", ".join(f"{name} {np.shape(number)}" for name, number in many if np.ndim(number))
        raise ValueError(
            f"Argument `args` must hold numbers and arrays that broadcast, but shapes are {said}; "
            "name arrays that each lane has as a whole in `shared`."
        ) from None
    equations = problem.equations(args, structs)
    if equations.error is not None:
        raise ValueError(f"Argument `problem` must be one that can be computed, but {equations.error}.")
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    own_shapes, dtypes = tuple(s.shape for s in structs), tuple(np.dtype(s.dtype).name for s in structs)
    signature = Signature(problem, structure, rest, own_shapes, dtypes, options, equations)
    if state_scale is not None:
        signature = signature.wanting(state_scale=_state_scale(signature, state_scale))
    flat = parameters
    if not any(isinstance(number, Tracer) for number in parameters):
        flat = [_flat(number, own_shape, shape) for number, own_shape in zip(parameters, shapes, strict=True)]
    lanes = Lanes(signature, flat, shape, tuple(own), tuple(np.shape(number) for number in parameters))
    return lanes.turned() if is_back else lanes


def _flat(number: Number, own: tuple[int, ...], shape: tuple[int, ...]) -> Any:
    """A number with one axis of lanes, or of one lane's shape where all share it."""
    if own or isinstance(number, Tracer) or np.ndim(number) == 0:
        return number if isinstance(number, Tracer) else np.array(number)
    array = np.asarray(number)
    # Copies: the caller may change his own.
    return np.array(array.reshape(())) if array.size == 1 else np.broadcast_to(array, shape).flatten()


def _check_clock(clock: Clock, *, endless: bool) -> bool:
    """Refuse times that run nowhere, and limits that are none; a motion may be `endless`. Whether time goes back."""
    if any(isinstance(number, Tracer) for number in clock):
        return False
    with np.errstate(invalid="ignore"):
        try:
            ways = np.sign(np.asarray(clock.t1) - np.asarray(clock.t0))
        except ValueError:
            return False  # shapes that do not broadcast are told of with all others
    is_back = bool(np.any(ways < 0))
    if is_back and np.any(ways > 0):
        raise ValueError("Argument `t1` must be after `t0` in all lanes, or before it in all: solve the others apart.")
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
    return is_back


def _state_scale(signature: Signature, state_scale: PyTree) -> tuple[float, ...]:
    """A size for each element of the state."""
    for size in jax.tree.leaves(state_scale):
        check_unmasked("state_scale", size)
    leaves, structure = jax.tree.flatten(signature.state)
    if is_number(state_scale) and np.ndim(state_scale) == 0:
        state_scale = jax.tree.unflatten(structure, [state_scale] * len(leaves))
    if jax.tree.structure(state_scale) != structure:
        raise ValueError(
            f"Argument `state_scale` must be one number, or a pytree like y, but is {briefly(state_scale)}."
        )
    try:
        pairs = zip(jax.tree.leaves(state_scale), leaves, strict=True)
        flat = [np.broadcast_to(np.asarray(size, float), leaf.shape).ravel() for size, leaf in pairs]
    except (TypeError, ValueError):
        raise ValueError(
            f"Argument `state_scale` must hold numbers of the shapes of y, but is {briefly(state_scale)}."
        ) from None
    values = tuple(float(size) for size in np.concatenate(flat))
    if not all(0 < size < math.inf for size in values):
        raise ValueError(f"Argument `state_scale` must hold positive numbers, but is {briefly(state_scale)}.")
    return values


def ends(
    lanes: Lanes, names: Sequence[str], order: int, rtol: float, times: np.ndarray | None = None, events: int = 0
) -> tuple[LaneEnd, list[tuple[str, ...]]]:
    """The ends of lanes, and along which names the last axis of their derivatives is, where there are several.

    See `integrate` for `times` and `events`; what is saved has an axis for the names after that of the lanes.
    """
    signature, parameters, count = lanes.signature, lanes.parameters, lanes.size
    if order == 0 or len(names) == 1:
        places = (lanes.element_of(names[0]),) if order else ()
        results = integrate(signature, parameters, count, order, places, rtol, times=times, events=events)
        saved = None if results.saved is None else np.asarray(results.saved)[:, None]
        return results._replace(saved=saved), [(*names, *names)[:order]]
    along: list[tuple[str, ...]] = (
        [(name,) for name in names] if order == 1 else list(itertools.combinations_with_replacement(names, 2))
    )
    places = np.array([[lanes.element_of(name) for name in each] for each in along], float).T
    results = integrate_along(signature, parameters, count, order, places, rtol, times=times, events=events)
    # A lane that fails along one direction fails in all.
    failed = np.any(signature.has_no_result(results.outcome), axis=1)
    outcome = np.where(failed, results.outcome.max(axis=1), results.outcome[:, 0])
    results = results._replace(
        outcome=outcome,
        trials=results.trials.sum(axis=1),
        count=results.count[:, 0],
        reached=None if results.reached is None else np.min(results.reached, axis=1),
        stiff=None if results.stiff is None else results.stiff.max(axis=1),
        slides=None if results.slides is None else results.slides.max(axis=1),
        error=np.max(np.asarray(results.error), axis=1),
        at_once=[each[:, 0] for each in results.at_once],
    )
    return results, along


def by_names(
    saved: np.ndarray, along: Sequence[tuple[str, ...]], part: Callable[[np.ndarray], _Of]
) -> tuple[_Of, dict[tuple[str, ...], _Of]]:
    """What is saved of lanes on their way, and its derivatives by names.

    Args:
        saved: see `ends`, and so is `along`.
        along: the names.
        part: makes it of numbers of shape (lanes, times, outputs).
    """
    tangents = saved.shape[-2]
    found: dict[tuple[str, ...], _Of] = {}
    for column, names in enumerate(along if tangents > 1 else []):
        for name, tangent in zip(names, (1, 2 if tangents == 4 else 1), strict=False):
            if (name,) not in found:
                found[(name,)] = part(saved[:, column, :, tangent])
        if len(names) == 2:
            found[names] = part(saved[:, column, :, tangents - 1])
    return part(saved[:, 0, :, 0]), found


class Part(NamedTuple):
    """Times, states and integrals of lanes at their ends, or derivatives of these.

    Args:
        t: shape of the lanes.
        y: a pytree like the state, of arrays of that shape.
        integrals: by name, of that shape.
    """

    t: PerImpact
    y: PyTree
    integrals: Mapping[str, PerImpact]

    def lacks(self, shape: tuple[int, ...]) -> np.ndarray:
        """Whether one of the numbers of a lane is NaN, where lanes have a shape."""
        unknown = [np.isnan(each).reshape(*shape, -1).any(axis=-1) for each in jax.tree.leaves(tuple(self))]
        return functools.reduce(np.logical_or, unknown)


def shaped(lanes: Lanes, time: Any, outputs: Sequence[Any]) -> Part:
    """Time, state and integrals in the structure of the problem; arrays of a state have their own axes last."""
    leaves, structure = jax.tree.flatten(lanes.signature.state)
    rest, parts = list(outputs), []
    stack = jax.numpy.stack if isinstance(time, Tracer) else np.stack
    for leaf in leaves:
        own, rest = rest[: math.prod(leaf.shape)], rest[math.prod(leaf.shape) :]
        parts.append(stack(own, -1).reshape(np.shape(time) + leaf.shape) if leaf.shape else own[0])
    return Part(
        time, jax.tree.unflatten(structure, parts), dict(zip(lanes.signature.problem.integrals, rest, strict=True))
    )


def named_events(lanes: Lanes, flags: Sequence[Any]) -> dict[str, Any]:
    """By the name of each event whether it happens at the end."""
    return dict(zip(lanes.signature.event_names, flags, strict=True))


def _is_huge(value: Number) -> bool:
    """Whether a whole number is beyond all floats."""
    return np.asarray(value).dtype.kind == "O"


def checked_times(ts: Any) -> np.ndarray:
    """Times at which states are wanted."""
    check_unmasked("ts", ts)
    try:
        times = np.array(ts, float)  # the caller may change his own
    except (TypeError, ValueError):
        raise TypeError(f"Argument `ts` must be one row of times, but is {briefly(ts)}.") from None
    if times.ndim != 1:
        raise ValueError(f"Argument `ts` must be one row of times, but has shape {times.shape}.")
    return times


def among(derivatives: Mapping[tuple[str, ...], _Of], names: tuple[str, ...]) -> _Of:
    """The derivatives by some numbers."""
    found = derivatives.get(names) or derivatives.get(names[::-1])
    if found is None:
        known = ", ".join(" and ".join(key) for key in derivatives) or "none"
        raise ValueError(
            f"Arguments of `along` must be among the derivatives ({known}), but are {names}; "
            "`wrt` and `derivatives=2` of `solve` ask for more."
        )
    return found
