"""The motion of one impact as diffrax integrates it, and where its cut ends.

Looks at the ends of steps alone miss a function that dips below zero and returns; with the
rates known as well, the cubic between two looks shows the dip.

A state and the volume removed so far are one vector `y`, the volume last: JAX and XLA take
their time over each array of a program, and diffrax has many uses for it.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from erosion.arguments import Broadcast, Flag, ModelState, Scalar, Structure
from erosion.models import CuttingModel, Events, cuts_at_all, equations_of, event_rates
from erosion.ode.problem import Same
from erosion.parameters import Parameters

_CLOSE = 4 * float(np.finfo(float).eps)  # of a time: nearer is the same
_NEWTON_STEPS = 60  # from a cubic's accuracy two or three suffice; a graze needs bisection


class Fall(NamedTuple):
    """An event, when it happens to a cubic's accuracy, and looks before and after that."""

    time: float
    low: float
    high: float
    name: str


def first_fall(t: np.ndarray, values: Mapping[str, np.ndarray], rates: Mapping[str, np.ndarray]) -> Fall | None:
    """The earliest fall through zero of several functions; None where none falls.

    Args:
        t: times of the looks, shape (looks,); close enough for a cubic between two of them.
        values: by name, the functions at these times; at the first one zero or positive.
        rates: their time derivatives.

    Raises:
        ArithmeticError: where a function is not finite.
    """
    first_falls: list[Fall] = []
    for name in values:
        value, rate = np.array(values[name]), rates[name]
        finite = np.isfinite(value) & np.isfinite(rate)
        if not np.all(finite):
            raise ArithmeticError(f"the motion is not finite after {t[max(np.argmin(finite) - 1, 0)]:g} s")
        value[0] = max(value[0], 0.0)
        falls = value[1:] <= 0
        # A dip between two looks: down at the first, up at the second.
        dips = (rate[:-1] < 0) & (rate[1:] > 0) & ~falls & (value[:-1] > 0)
        for i in np.flatnonzero(falls | dips):
            root = _first_root(t[i : i + 2], value[i : i + 2], rate[i : i + 2])
            if root is not None:
                first_falls.append(Fall(root, float(t[i]), float(t[i + 1]), name))
                break
    return min(first_falls, default=None)


def find_root(event: Callable[[float], tuple[float, float]], fall: Fall) -> float:
    """Where an event function, given with its rate, falls through zero: Newton within the bracket."""
    t, low, high = fall.time, fall.low, fall.high
    for _ in range(_NEWTON_STEPS):
        value, rate = event(t)
        low, high = (t, high) if value > 0 else (low, t)
        step = -value / rate if rate < 0 else np.inf
        # Asked first: a step below rounding may leave the bracket, which has closed to `t` by then.
        converged = abs(step) <= _CLOSE * t
        # A graze at its lowest point has no slope to follow.
        step = step if converged or low < t + step <= high else (low + high) / 2 - t
        t += step
        if converged or abs(step) <= _CLOSE * t:
            break
    return t


def _first_root(t: np.ndarray, values: np.ndarray, rates: np.ndarray) -> float | None:
    """Where the cubic through both ends first falls to zero after its start; None if it does not."""
    length = float(t[1] - t[0])
    from_, to, rise = length * rates[0], length * rates[1], values[1] - values[0]
    cubic = [from_ + to - 2 * rise, 3 * rise - 2 * from_ - to, from_, values[0]]
    # A start at zero (contact) is no fall: divide that root out.
    roots = np.roots(cubic[:3] if values[0] == 0 else cubic)
    real = [float(root.real) for root in roots if abs(root.imag) <= 1e-7 and 0 < root.real <= 1]
    if not real:
        return float(t[1]) if values[1] <= 0 else None
    return float(t[0]) + length * min(real)


_Function = TypeVar("_Function", bound=Callable[..., PyTree])

# The older code generator, and LLVM does not optimise: two thirds of the time to compile.
_QUICK = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def seldom_run(function: _Function) -> _Function:
    """The function as a program that is compiled quickly; for single impacts it runs no slower."""
    jit: Any = eqx.filter_jit  # whose signature does not say that options are passed on to `jax.jit`

    @functools.cache
    def program() -> Callable[..., PyTree]:
        def run(_: PyTree, *arguments: PyTree) -> PyTree:
            return function(*jax.tree.map(lambda leaf: leaf.thing if isinstance(leaf, Same) else leaf, arguments))

        return jit(run, compiler_options=_accepted(tuple(_QUICK.items())))

    @functools.wraps(function)
    def call(*arguments: PyTree) -> PyTree:
        # JAX knows a model by its class and fields. Its code may have been defined anew.
        parts = jax.tree.leaves(arguments, is_leaf=lambda part: isinstance(part, CuttingModel))
        models = [part for part in parts if isinstance(part, CuttingModel)]
        digests = [equations_of(model).digest for model in models]
        return program()(digests, *jax.tree.map(_with_hash, arguments))

    return cast(_Function, call)


def _with_hash(leaf: object) -> object:
    """The leaf, or, for JAX, what stands for a function that has no hash, such as `np.poly1d`."""
    if callable(leaf):
        try:
            hash(leaf)
        except TypeError:
            return Same(leaf)
    return leaf


@functools.cache
def _accepted(options: tuple[tuple[str, bool | int], ...]) -> dict[str, bool | int]:
    """Those of the options that this version of XLA knows, on a CPU; elsewhere none."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=dict(options))(1.0)
    except jax.errors.JaxRuntimeError:
        alone = [_accepted((option,)) for option in options] if len(options) > 1 else []
        return {name: value for option in alone for name, value in option.items()}
    return dict(options)


Dense = dict[str, PyTree]
"""The fields of diffrax's interpolation between steps, by name."""

MAX_STEPS = 4096
_FIRST_STEP = 0.01  # of the model's time scale


def layout(model: CuttingModel, p: Parameters) -> Structure:
    """The structure of the model's state."""
    return jax.tree.structure(eqx.filter_eval_shape(lambda model, p: model.initial_state(p), model, p))


def state_of(structure: Structure, y: Array | np.ndarray) -> ModelState:
    """The state in a vector, or in many of shape (times, quantities)."""
    return jax.tree.unflatten(structure, [y[..., i] for i in range(structure.num_leaves)])


@seldom_run
def begin(model: CuttingModel, p: Parameters) -> tuple[Flag, Array, Array, Scalar]:
    """Whether it cuts; y at contact; how large everything gets, by a look ahead; the time scale."""
    time, state = model.scales(p).time, model.initial_state(p)
    start = _vector(state, model.removed_at_contact(p))
    now = time * _rate(model, p, jax.tree.structure(state), start)
    ahead = time * _rate(model, p, jax.tree.structure(state), start + now)
    largest = jnp.max(jnp.abs(jnp.stack([start, now, ahead])), axis=0)
    sizes = jnp.where(jnp.isfinite(largest) & (largest > 0), largest, 1.0)
    return cuts_at_all(model, p), start, sizes, time


class DiffraxProblem(NamedTuple):
    """An impact and how to integrate it: diffrax sees y divided by `sizes`, so that one absolute tolerance fits all."""

    model: CuttingModel
    p: Parameters
    solver: diffrax.AbstractSolver
    controller: diffrax.AbstractStepSizeController
    sizes: Array


@seldom_run
def solve(
    problem: DiffraxProblem, start: Array | np.ndarray, t0: Scalar, t1: Scalar
) -> tuple[Array, Array, Array, Dense]:
    """Integrate y from `t0` until `t1`, or the first step that ends past an event.

    Returns:
        The ends of the steps (padded), y there, y at the last, and what `interpolate` takes.
    """
    model, p, solver, controller, sizes = problem
    structure = layout(model, p)

    def rate(t: Scalar, y: Array, args: PyTree) -> Array:
        return _rate(model, p, structure, y * sizes) / sizes

    # A boolean condition only tells diffrax when to stop stepping; the names are its own.
    def past_the_end(t: Scalar, y: Array, args: PyTree, **kwargs: PyTree) -> Flag:
        values = model.events(state_of(structure, y * sizes), p)
        return (t > t0) & (jnp.min(jnp.stack(list(values.values()))) <= 0)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        solver,
        t0=t0,
        t1=t1,
        dt0=jnp.minimum(_FIRST_STEP * model.scales(p).time, t1 - t0),
        y0=start / sizes,
        saveat=diffrax.SaveAt(subs=(diffrax.SubSaveAt(steps=True), diffrax.SubSaveAt(t1=True)), dense=True),
        stepsize_controller=controller,
        event=diffrax.Event(past_the_end),
        max_steps=MAX_STEPS,
        adjoint=diffrax.ForwardMode(),  # nothing is differentiated: the loop is traced fewer times
        throw=False,
    )
    (ends, _), (scaled, last) = cast(Any, solution.ts), cast(Any, solution.ys)
    dense = cast(diffrax.DenseInterpolation, solution.interpolation)
    names = {field.name for field in dataclasses.fields(dense)} - {"interpolation_cls"}
    return ends, scaled * sizes[None], last[0] * sizes, {name: getattr(dense, name) for name in sorted(names)}


@seldom_run
def interpolate(solver: diffrax.AbstractSolver, dense: Dense, sizes: Array, times: Array | np.ndarray) -> Array:
    """The vectors y at many times, from the dense output; shape (times, quantities)."""
    interpolation = diffrax.DenseInterpolation(interpolation_cls=solver.interpolation_cls, **dense)
    return jax.vmap(interpolation.evaluate)(times) * sizes[None]


@seldom_run
def event(model: CuttingModel, p: Parameters, y: Array | np.ndarray) -> tuple[Events, Events]:
    """The event functions and their rates at one y."""
    return _events(model, p, y)


@seldom_run
def events(model: CuttingModel, p: Parameters, ys: Array | np.ndarray) -> tuple[Events, Events]:
    """The event functions and their rates at many y, shape (times, quantities)."""
    return jax.vmap(lambda y: _events(model, p, y))(jnp.asarray(ys))


def _events(model: CuttingModel, p: Parameters, y: Array | np.ndarray) -> tuple[Events, Events]:
    state = state_of(layout(model, p), y)
    return event_rates(model, state, model.derivative(state, p), p)


def _rate(model: CuttingModel, p: Parameters, structure: Structure, y: Array) -> Array:
    state = state_of(structure, y)
    return _vector(model.derivative(state, p), model.removal_rate(state, p))


def _vector(state: ModelState, volume: Broadcast) -> Array:
    return jnp.stack([jnp.asarray(leaf, jnp.float64) for leaf in (*jax.tree.leaves(state), volume)])
