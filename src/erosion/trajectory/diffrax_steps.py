"""The motion as diffrax integrates it: compiled steps, and looks at states.

A state and the volume removed so far are one vector `y`, the volume last: JAX and XLA take
their time over each array of a program, and diffrax has many uses for it.
"""

import dataclasses
from typing import Any, NamedTuple, cast

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from erosion.array_types import Broadcast, Flag, ModelState, Scalar, Structure
from erosion.models.base import CuttingModel, Events, cuts_at_all, event_rates
from erosion.parameters.parameters import Parameters
from erosion.trajectory.quick_xla import seldom_run

Dense = dict[str, PyTree]
"""The fields of diffrax's interpolation between steps, by name."""

Look = tuple[Events, Events, tuple[Broadcast, ...], Broadcast]
"""Event functions, their rates, the tip's position and velocity, and dV/dt."""

MAX_STEPS = 4096
_FIRST_STEP = 0.01  # of the model's time scale


def layout(model: CuttingModel, p: Parameters) -> Structure:
    """The structure of the model's state."""
    return jax.tree.structure(eqx.filter_eval_shape(_initial_state, model, p))


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


class Problem(NamedTuple):
    """An impact and how to integrate it: diffrax sees y divided by `sizes`, so that one absolute tolerance fits all."""

    model: CuttingModel
    p: Parameters
    solver: diffrax.AbstractSolver
    controller: diffrax.AbstractStepSizeController
    sizes: Array


@seldom_run
def solve(problem: Problem, start: Array | np.ndarray, t0: Scalar, t1: Scalar) -> tuple[Array, Array, Array, Dense]:
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
        return (t > t0) & (_least(model.events(state_of(structure, y * sizes), p)) <= 0)

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
    return ends, scaled * sizes, last[0] * sizes, {name: getattr(dense, name) for name in sorted(names)}


@seldom_run
def interpolate(solver: diffrax.AbstractSolver, dense: Dense, sizes: Array, times: Array | np.ndarray) -> Array:
    """The vectors y at many times, from the dense output; shape (times, quantities)."""
    interpolation = diffrax.DenseInterpolation(interpolation_cls=solver.interpolation_cls, **dense)
    return jax.vmap(interpolation.evaluate)(times) * sizes


@seldom_run
def event(model: CuttingModel, p: Parameters, y: Array | np.ndarray) -> tuple[Events, Events]:
    """The event functions and their rates at one y."""
    state = state_of(layout(model, p), y)
    return event_rates(model, state, model.derivative(state, p), p)


@seldom_run
def look(model: CuttingModel, p: Parameters, ys: Array | np.ndarray) -> Look:
    """Event functions, their rates, the tip's position and velocity, and dV/dt, at many y (times, quantities)."""
    structure = layout(model, p)

    def look_at(y: Array) -> Look:
        state = state_of(structure, y)
        values, rates = event_rates(model, state, model.derivative(state, p), p)
        return values, rates, tuple(model.tip(state, p)), model.removal_rate(state, p)

    return jax.vmap(look_at)(jnp.asarray(ys))


def _initial_state(model: CuttingModel, p: Parameters) -> ModelState:
    return model.initial_state(p)


def _rate(model: CuttingModel, p: Parameters, structure: Structure, y: Array) -> Array:
    state = state_of(structure, y)
    return _vector(model.derivative(state, p), model.removal_rate(state, p))


def _vector(state: ModelState, volume: Broadcast) -> Array:
    return jnp.stack([jnp.asarray(leaf, jnp.float64) for leaf in (*jax.tree.leaves(state), volume)])


def _least(values: Events) -> Array:
    return jnp.min(jnp.stack(list(values.values())))
