"""The motion as diffrax integrates it: compiled steps, and looks at states.

Each function is compiled once for a model, whatever the parameters.
"""

from typing import Any, NamedTuple, cast

import diffrax
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from erosion.compiler import quick_to_compile
from erosion.model import CuttingModel, cuts_at_all, event_rates
from erosion.parameters import Parameters

MAX_STEPS = 4096
_FIRST_STEP = 0.01  # of the model's time scale


class Steps(NamedTuple):
    """What diffrax did: its solution, and the ends of its steps (padded) with the states there."""

    solution: diffrax.Solution
    ends: Any
    states: Any
    last: Any


@quick_to_compile
def solve(
    model: CuttingModel,
    p: Parameters,
    solver: diffrax.AbstractSolver,
    controller: diffrax.AbstractStepSizeController,
    start: tuple[Any, Any],
    sizes: tuple[Any, Any],
    t0: Any,
    t1: Any,
) -> Steps:
    """Integrate (state, volume) from `t0` until `t1`, or the first step that ends past an event.

    diffrax sees everything divided by `sizes`, so that one absolute tolerance fits all.
    """

    # As one vector, for JAX and XLA take their time over each array, and diffrax has many uses of it.
    (size, given), (start_, _) = ravel_pytree(sizes), (ravel_pytree(start))

    def given_state(y: Any) -> Any:
        return given(y * size)[0]

    def rate(t: Any, y: Any, args: Any) -> Any:
        state = given_state(y)
        return ravel_pytree((model.derivative(state, p), model.removal_rate(state, p)))[0] / size

    # A boolean condition only tells diffrax when to stop stepping; the names are its own.
    def past_the_end(t: Any, y: Any, args: Any, **kwargs: Any) -> Any:
        return (t > t0) & (_least(model.events(given_state(y), p)) <= 0)

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        solver,
        t0=t0,
        t1=t1,
        dt0=jnp.minimum(_FIRST_STEP * model.scales(p).time, t1 - t0),
        y0=start_ / size,
        saveat=diffrax.SaveAt(subs=(diffrax.SubSaveAt(steps=True), diffrax.SubSaveAt(t1=True)), dense=True),
        stepsize_controller=controller,
        event=diffrax.Event(past_the_end),
        max_steps=MAX_STEPS,
        adjoint=diffrax.ForwardMode(),  # nothing is differentiated: the loop is traced fewer times
        throw=False,
    )
    (ends, _), (states, last) = cast(Any, solution.ts), cast(Any, solution.ys)
    return Steps(solution, ends, jax.vmap(given)(states * size), given(last[0] * size))


@quick_to_compile
def begin(model: CuttingModel, p: Parameters) -> Any:
    """Whether it cuts; the start; how large everything gets, by a look ahead; the time scale."""
    time, start = model.scales(p).time, (model.initial_state(p), jnp.zeros_like(model.scales(p).time))

    def rate(y: Any) -> Any:
        return model.derivative(y[0], p), model.removal_rate(y[0], p)

    def size(*values: Any) -> Any:
        largest = jnp.max(jnp.abs(jnp.stack(values)))
        return jnp.where(jnp.isfinite(largest) & (largest > 0), largest, 1.0)

    now = jax.tree.map(lambda k: time * k, rate(start))
    ahead = jax.tree.map(lambda k: time * k, rate(jax.tree.map(jnp.add, start, now)))
    # Weak types would have `solve` compiled twice.
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), start)
    return cuts_at_all(model, p), start, jax.tree.map(size, start, now, ahead), time


@quick_to_compile
def interpolate(solution: diffrax.Solution, sizes: Any, times: Any) -> Any:
    """(State, volume) at many times, from the dense output."""
    size, given = ravel_pytree(sizes)
    return jax.vmap(lambda t: given(solution.evaluate(t) * size))(times)


@quick_to_compile
def event(model: CuttingModel, p: Parameters, state: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """The event functions and their rates in one state."""
    return event_rates(model, state, model.derivative(state, p), p)


@quick_to_compile
def look(model: CuttingModel, p: Parameters, states: Any) -> Any:
    """Event functions, their rates, the tip and its removal rate in many states."""

    def one(state: Any) -> Any:
        values, rates = event_rates(model, state, model.derivative(state, p), p)
        return values, rates, model.tip(state, p)

    return jax.vmap(one)(states)


def _only(leaf: Any) -> Any:
    return leaf[0]


def _least(values: dict[str, Any]) -> Any:
    return jnp.min(jnp.stack(list(values.values())))
