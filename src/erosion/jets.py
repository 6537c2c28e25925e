"""Derivatives with respect to parameters, carried along with the motion.

For directions ε and η in parameter space the state is extended to the jet
(s, ∂s/∂ε, ∂s/∂η, ∂²s/∂ε∂η). Only the vector field is differentiated (nested `jvp`), never the
integration loop; the time of the event follows by the implicit function theorem.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from erosion.model import CuttingModel
from erosion.parameters import Parameters

Direction = str | Any
"""A parameter's name, or (traced) the index of a leaf of (model, p)."""


class Cut(NamedTuple):
    """What a lane integrates: the model's state and the volume removed so far."""

    state: Any
    volume: Any


class Derivatives(NamedTuple):
    """A quantity with its first and mixed second derivative along two directions."""

    value: Any
    first: Any
    other: Any
    second: Any


def perturbed(leaves: tuple[CuttingModel, Parameters], direction: Direction, step: Any) -> Any:
    """Model and parameters moved along a direction by `step` of its `unit`."""
    if isinstance(direction, str):
        model, p = leaves
        return model, p.replace(**{direction: getattr(p, direction) + step * unit(leaves, direction)})
    flat, structure = jax.tree.flatten(leaves)
    amount = step * unit(leaves, direction)
    moved = [leaf + jnp.where(direction == i, amount, 0.0) for i, leaf in enumerate(flat)]
    return jax.tree.unflatten(structure, moved)


def unit(leaves: tuple[CuttingModel, Parameters], direction: Direction) -> Any:
    """A change of the parameter that matters: 1 rad, the spin v₀/r, or as much as there is.

    Derivatives by such units compare with the value itself, so that one tolerance fits all.
    """
    model, p = leaves
    if isinstance(direction, str):
        special = {"alpha": jnp.ones_like(p.alpha), "phidot0": p.v0 / p.r}
        size = special.get(direction, getattr(p, direction))
    else:
        sizes = jax.tree.leaves((jax.tree.map(jnp.abs, model), p.replace(alpha=1.0, phidot0=p.v0 / p.r)))
        size = sum(jnp.where(direction == i, leaf, 0.0) for i, leaf in enumerate(sizes) if not jnp.ndim(leaf))
    return lax.stop_gradient(jnp.where(size == 0, 1.0, size))


class Jets:
    """The initial jet, its rate, and what happens to it at the event, for `order` 0, 1 or 2.

    A jet is a tuple of `order` + 1 members along one direction, or, for two different
    directions at order 2, of four: value, first, other, second.

    Args:
        model, p: one lane's.
        order: how many derivatives.
        directions: one direction, or two for a mixed second derivative.
    """

    def __init__(self, model: CuttingModel, p: Parameters, order: int, directions: tuple[Direction, ...]) -> None:
        self.leaves = (model, p)
        self.model, self.p = model, p
        self.order = order
        self.directions = directions
        self.mixed = order == 2 and len(directions) == 2

    def initial(self) -> tuple[Cut, ...]:
        """The jet at contact."""

        def begin(model: CuttingModel, p: Parameters) -> Cut:
            state = model.initial_state(p)
            return Cut(state, jnp.zeros_like(p.alpha))

        return self._pack(self._lift(lambda _, model, p: begin(model, p), ()))

    def rate(self, jet: tuple[Cut, ...]) -> tuple[Cut, ...]:
        """The time derivative of a jet."""

        def flow(cut: Cut, model: CuttingModel, p: Parameters) -> Cut:
            return Cut(model.derivative(cut.state, p), model.removal_rate(cut.state, p))

        return self._pack(self._lift(flow, jet))

    def of(self, function: Callable[[Cut, CuttingModel, Parameters], Any], jet: tuple[Cut, ...]) -> Derivatives:
        """A function of the cut, with its derivatives along the directions."""
        return self._lift(function, jet)

    def per_unit(self, scaled: Derivatives) -> Derivatives:
        """Derivatives by the directions' units turned into derivatives by the parameters."""
        if self.order == 0:
            return scaled
        one, other = unit(self.leaves, self.directions[0]), unit(self.leaves, self.directions[-1])
        second = None if scaled.second is None else scaled.second / (one * other)
        return Derivatives(scaled.value, scaled.first / one, scaled.other / other, second)

    def _pack(self, all_four: Derivatives) -> tuple[Cut, ...]:
        if self.mixed:
            return (all_four.value, all_four.first, all_four.other, all_four.second)
        return (all_four.value, all_four.first, all_four.second)[: self.order + 1]

    def _unpack(self, jet: tuple[Cut, ...]) -> Derivatives:
        if self.mixed:
            return Derivatives(*jet)
        padded = (*jet, None, None)
        return Derivatives(padded[0], padded[1], padded[1], padded[2])

    def _lift(self, function: Callable[[Any, CuttingModel, Parameters], Any], jet: tuple[Any, ...]) -> Derivatives:
        """Push a jet through a function of (cut, model, p)."""
        at = self._unpack(jet) if jet else Derivatives((), (), (), ())
        zero, one = jnp.zeros(()), jnp.ones(())
        if self.order == 0:
            return Derivatives(function(at.value, *self.leaves), None, None, None)

        def along(cut: Any, step: Any, leaves: Any) -> Any:
            return function(cut, *perturbed(leaves, self.directions[0], step))

        if self.order == 1:
            value, first = jax.jvp(lambda c, e: along(c, e, self.leaves), (at.value, zero), (at.first, one))
            return Derivatives(value, first, first, None)

        def first_jet(cut: Any, cut_first: Any, other_step: Any) -> Any:
            leaves = perturbed(self.leaves, self.directions[-1], other_step)
            return jax.jvp(lambda c, e: along(c, e, leaves), (cut, zero), (cut_first, one))

        (value, first), (other, second) = jax.jvp(first_jet, (at.value, at.first, zero), (at.other, at.second, one))
        return Derivatives(value, first, other, second)


class AtEvent(NamedTuple):
    """Derivatives of the event's time and of the volume there, and how far to trust them."""

    time: Derivatives
    volume: Derivatives
    doubt: Any


def at_event(jets: Jets, jet: tuple[Cut, ...], which: Any, time: Any) -> AtEvent:
    """Derivatives at the event, whose time depends on the parameters as well.

    With g the event function and R the removal rate along the flow, all at the event:
    t_ε = -g_ε/ġ;  V_ε = v_ε + R t_ε;  and for the second derivatives the chain rule once more.
    R vanishes at rebound and stop, but need not at the events of a plug-in.

    `doubt` says how many times larger than the state's the errors of the results may be: how
    much the function's slope changes relative to what is left of it, g̈ t/ġ, where it falls
    slowly; times how much larger the terms of the second derivative are than their sum.

    Args:
        jets: the lane's jets.
        jet: at the event.
        which: index of the event that ended the cut, in the order of their names.
        time: since contact.
    """

    def event(cut: Cut, model: CuttingModel, p: Parameters) -> Any:
        chosen = jnp.zeros_like(cut.volume)
        # By name, as everywhere: JAX sorts the keys of a dictionary that passes through it.
        for i, (_, value) in enumerate(sorted(model.events(cut.state, p).items())):
            chosen = jnp.where(which == i, value, chosen)
        return chosen

    def removal(cut: Cut, model: CuttingModel, p: Parameters) -> Any:
        return model.removal_rate(cut.state, p)

    volume = jets.of(lambda cut, model, p: cut.volume, jet)
    g_rate = jets.of(_along_flow(event), jet)
    g_curve = _along_flow(_along_flow(event))(jet[0], *jets.leaves)
    doubt = jnp.maximum(1.0, jnp.abs(g_curve * time / g_rate.value))
    if jets.order == 0:
        return AtEvent(Derivatives(time, None, None, None), volume, doubt)
    g, r = jets.of(event, jet), jets.of(removal, jet)
    t_first, t_other = -g.first / g_rate.value, -g.other / g_rate.value
    v_first, v_other = volume.first + r.value * t_first, volume.other + r.value * t_other
    if jets.order == 1:
        return AtEvent(
            Derivatives(time, t_first, t_other, None), Derivatives(volume.value, v_first, v_other, None), doubt
        )
    r_rate = _along_flow(removal)(jet[0], *jets.leaves)

    def chain(mixed: Any, first: Any, other: Any, curve: Any) -> list[Any]:
        return [mixed, first * t_other, other * t_first, curve * t_first * t_other]

    t_second = -sum(chain(g.second, g_rate.first, g_rate.other, g_curve)) / g_rate.value
    terms = [*chain(volume.second, r.first, r.other, r_rate), r.value * t_second]
    v_second = sum(terms[1:], terms[0])
    size = functools.reduce(jnp.maximum, map(jnp.abs, (volume.value, v_first, v_other, v_second)))
    return AtEvent(
        Derivatives(time, t_first, t_other, t_second),
        Derivatives(volume.value, v_first, v_other, v_second),
        doubt * jnp.maximum(1.0, sum(map(jnp.abs, terms)) / size),
    )


def _along_flow(function: Callable[[Cut, CuttingModel, Parameters], Any]) -> Callable[..., Any]:
    """The time derivative of a function of the cut."""

    def derivative(cut: Cut, model: CuttingModel, p: Parameters) -> Any:
        rate = Cut(model.derivative(cut.state, p), model.removal_rate(cut.state, p))
        return jax.jvp(lambda c: function(c, model, p), (cut,), (rate,))[1]

    return derivative
