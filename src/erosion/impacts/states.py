"""One impact's motion at given times: one lane for each time, which goes no further than its own."""

import functools
from typing import NamedTuple

import jax
import numpy as np

from erosion.array_types import ModelState, Number, Scalar, Structure
from erosion.impacts.lanes import element_of, layout_of, split
from erosion.lanes.choice import Compiled, compile_lanes
from erosion.lanes.lanewise import number
from erosion.models.base import CuttingModel, Tip
from erosion.ode.batch import compiling
from erosion.ode.integrator import integrate_lane
from erosion.ode.layout import Clock, Layout
from erosion.parameters.parameters import Parameters


class States(NamedTuple):
    """The motion at times; arrays of shape (times,).

    Args:
        outcome: an index of `end_names`; beyond them where the impact has not ended by then.
        time: the time asked for, or the end of the cut if that is earlier.
        state: the model's own, a pytree of arrays.
        tip: position and velocity of the tip.
        volume, removal_rate: the volume removed so far, and its time derivative.
        dvolume: dV/dα; only at the end of the cut does it include the change of the time.
    """

    outcome: np.ndarray
    time: np.ndarray
    state: ModelState
    tip: Tip
    volume: np.ndarray
    removal_rate: np.ndarray
    dvolume: np.ndarray


def states_at(model: CuttingModel, p: Parameters, times: np.ndarray, rtol: float) -> States:
    """The motion at times since contact, infinity for the end, of one impact, or of one impact for each time.

    Args:
        model: the model.
        p: scalars, or arrays of shape (times,).
        times: shape (times,) [s].
        rtol: relative tolerance.
    """
    layout, (_, numbers) = layout_of(model, p, whole=True), split(model, p)
    with compiling:
        program, structure, shapes = _compiled(layout, jax.tree.structure(layout.state))
    results = [np.empty((times.size, *shape), dtype) for shape, dtype in shapes]
    clock = Clock(t0=0.0, t1=times, max_step=np.inf, max_events=np.inf)
    leaves = [np.asarray(leaf, float) for leaf in (*numbers, *clock, rtol)]
    program.run(leaves, np.arange(times.size), results)
    return States(*jax.tree.unflatten(structure, results))


@functools.lru_cache(maxsize=64)
def _compiled(
    layout: Layout, its_state: Structure
) -> tuple[Compiled, Structure, list[tuple[tuple[int, ...], np.dtype]]]:
    """The program. It gives states of the model's own class, which may differ where layouts are equal."""

    def lane(numbers: list[Number], rtol: Scalar) -> tuple[ModelState, ...]:
        p, model = layout.args(numbers)
        end = integrate_lane(layout, numbers, (element_of(model, "alpha"),), rtol, order=1)
        integrals = len(layout.problem.integrals)
        elements, (volume, *_) = end.outputs.value[:-integrals], end.outputs.value[-integrals:]
        state = jax.tree.unflatten(jax.tree.structure(model.initial_state(p)), elements)
        rate = model.removal_rate(state, p)
        return end.outcome, end.time.value, state, model.tip(state, p), volume, rate, end.outputs.first[-integrals]

    arguments = (layout.structs(), number)
    leaves, structure = jax.tree.flatten(jax.eval_shape(lane, *arguments))
    return compile_lanes(lane, arguments), structure, [(leaf.shape, leaf.dtype) for leaf in leaves]
