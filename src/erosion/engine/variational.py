"""The variational equations: derivatives by parameters, carried along with the motion.

For directions ε and η in the space of parameters the state s is extended by ∂s/∂ε, ∂s/∂η and
∂²s/∂ε∂η. Only the vector field is differentiated (nested `jvp`), never the integration; the time
of the event follows by the implicit function theorem.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.engine.leaves import Layout
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import QUANTITIES, Parameters

Direction = str | Any
"""A parameter's name, or (traced) the place of an element among those of all numbers; see `Layout`."""


class Cut(NamedTuple):
    """What is integrated: the model's state and the volume removed so far."""

    state: Any
    volume: Any


class Derivatives(NamedTuple):
    """A quantity with its first and mixed second derivative along two directions."""

    value: Any
    first: Any
    other: Any
    second: Any


class Variational:
    """The state with its derivatives: at contact, its rate, and functions of it, for `order` 0, 1 or 2.

    Such a state is a tuple of `order` + 1 members along one direction or, for two different
    directions at order 2, of four: value, first, other, second.

    Args:
        layout: of the numbers.
        numbers: one impact's.
        order: how many derivatives.
        directions: one direction, or two for a mixed second derivative.
        motion: from model and case to what is integrated; see `erosion.engine.reduction`.
    """

    def __init__(
        self,
        layout: Layout,
        numbers: Sequence[Any],
        order: int,
        directions: tuple[Direction, ...],
        motion: Callable[[CuttingModel, Parameters], Any],
    ) -> None:
        self.layout, self.numbers, self.order, self.directions = layout, list(numbers), order, directions
        self.motion = motion
        self.mixed = order == 2 and len(directions) == 2

    def initial(self) -> tuple[Cut, ...]:
        """The state at contact."""
        return self._pack(self._lift(lambda _, motion: Cut(motion.initial_state(), jnp.zeros(())), ()))

    def rate(self, members: tuple[Cut, ...]) -> tuple[Cut, ...]:
        """The time derivative of a state."""
        return self._pack(self._lift(lambda cut, motion: motion.rate(cut), members))

    def of(self, function: Callable[[Cut, Any], Any], members: tuple[Cut, ...]) -> Derivatives:
        """A function of (cut, motion), with its derivatives along the directions."""
        return self._lift(function, members)

    def at(self, numbers: Sequence[Any]) -> Any:
        """The motion for some numbers."""
        return self.motion(*self.layout.joined(numbers))

    def per_unit(self, scaled: Derivatives) -> Derivatives:
        """Derivatives by the directions' units turned into derivatives by the parameters."""
        if self.order == 0:
            return scaled
        one, other = self._unit(self.directions[0]), self._unit(self.directions[-1])
        second = None if scaled.second is None else scaled.second / (one * other)
        return Derivatives(scaled.value, scaled.first / one, scaled.other / other, second)

    def _pack(self, all_four: Derivatives) -> tuple[Cut, ...]:
        if self.mixed:
            return (all_four.value, all_four.first, all_four.other, all_four.second)
        return (all_four.value, all_four.first, all_four.second)[: self.order + 1]

    def _lift(self, function: Callable[[Any, Any], Any], members: tuple[Any, ...]) -> Derivatives:
        """Push a state with its derivatives through a function of (cut, motion)."""
        padded = (*members, None, None) if members else ((), (), ())
        at = Derivatives(*members) if len(members) == 4 else Derivatives(padded[0], padded[1], padded[1], padded[2])
        zero, one = np.zeros(()), np.ones(())
        if self.order == 0:
            return Derivatives(function(at.value, self.at(self.numbers)), None, None, None)

        def along(cut: Any, step: Any, numbers: Sequence[Any]) -> Any:
            return function(cut, self.at(self._moved(numbers, self.directions[0], step)))

        if self.order == 1:
            value, first = jax.jvp(lambda c, e: along(c, e, self.numbers), (at.value, zero), (at.first, one))
            return Derivatives(value, first, first, None)

        def first_member(cut: Any, cut_first: Any, other_step: Any) -> Any:
            numbers = self._moved(self.numbers, self.directions[-1], other_step)
            return jax.jvp(lambda c, e: along(c, e, numbers), (cut, zero), (cut_first, one))

        (value, first), (other, second) = jax.jvp(first_member, (at.value, at.first, zero), (at.other, at.second, one))
        return Derivatives(value, first, other, second)

    def _moved(self, numbers: Sequence[Any], direction: Direction, step: Any) -> list[Any]:
        """The numbers moved along a direction by `step` of its unit."""
        if isinstance(direction, str):
            place = list(QUANTITIES).index(direction)
            return [n + step * self._unit(direction) if i == place else n for i, n in enumerate(numbers)]
        amount = step * self._unit(direction)
        moved = []
        for number, shape, dtype, offset in zip(
            numbers, self.layout.shapes, self.layout.dtypes, self.layout.offsets, strict=False
        ):
            if dtype != "float64":
                moved.append(number)
            elif shape == ():
                moved.append(number + jnp.where(direction == offset, amount, 0.0))
            else:
                places = offset + np.arange(np.prod(shape), dtype=float).reshape(shape)
                moved.append(number + jnp.where(direction == places, amount, 0.0))
        return moved

    def _unit(self, direction: Direction) -> Any:
        """A change of the parameter that matters: 1 rad, the spin v₀/r, or as much as there is.

        Derivatives by such units compare with the value itself, so that one tolerance fits all.
        """
        sizes: list[Any] = [jnp.abs(n) for n in self.numbers]
        names = list(QUANTITIES)
        v0, r = (self.numbers[names.index(name)] for name in ("v0", "r"))
        sizes[names.index("alpha")], sizes[names.index("phidot0")] = np.ones(()), v0 / r
        if isinstance(direction, str):
            size = sizes[names.index(direction)]
        else:
            size = 0.0
            for one, shape, offset in zip(sizes, self.layout.shapes, self.layout.offsets, strict=False):
                places = offset + np.arange(np.prod(shape), dtype=float).reshape(shape)
                size = size + jnp.sum(jnp.where(direction == places, one, 0.0))
        return lax.stop_gradient(jnp.where(size == 0, 1.0, size))


class AtEvent(NamedTuple):
    """Derivatives of the event's time and of the volume there, and how much larger their errors may be."""

    time: Derivatives
    volume: Derivatives
    amplification: Any


def at_event(equations: Variational, members: tuple[Cut, ...], which: Any, time: Any) -> AtEvent:
    """Derivatives at the event, whose time depends on the parameters as well.

    With g the event function and R the removal rate along the flow, all at the event:
    t_ε = -g_ε/ġ;  V_ε = v_ε + R t_ε;  and for the second derivatives the chain rule once more.
    R vanishes at rebound and stop, but need not at the events of a plug-in.

    `amplification` says how many times larger than the state's the errors of the results may be: how
    much the function's slope changes relative to what is left of it, g̈ t/ġ, where it falls
    slowly; times how much larger the terms of the second derivative are than their sum.

    Args:
        equations: the impact's.
        members: the state at the event.
        which: index of the event that ended the cut, in the order of their names; below 0 none did.
        time: since contact.
    """

    def event(cut: Cut, motion: Any) -> Any:
        chosen = jnp.zeros(())
        for i, value in enumerate(motion.events(cut)):
            chosen = jnp.where(which == i, value, chosen)
        return chosen

    def removal(cut: Cut, motion: Any) -> Any:
        return motion.rate(cut).volume

    here = equations.at(equations.numbers)
    volume = equations.of(lambda cut, _: cut.volume, members)
    g_rate = equations.of(_along_flow(event), members)
    # Where no event ended the cut its time is given, and has no derivative.
    g_rate = g_rate._replace(value=jnp.where(which < 0, 1.0, g_rate.value))
    g_curve = _along_flow(_along_flow(event))(members[0], here)
    amplification = jnp.maximum(1.0, jnp.abs(g_curve * time / g_rate.value))
    if equations.order == 0:
        return AtEvent(Derivatives(time, None, None, None), volume, amplification)
    g, r = equations.of(event, members), equations.of(removal, members)
    t_first, t_other = -g.first / g_rate.value, -g.other / g_rate.value
    v_first, v_other = volume.first + r.value * t_first, volume.other + r.value * t_other
    if equations.order == 1:
        return AtEvent(
            Derivatives(time, t_first, t_other, None), Derivatives(volume.value, v_first, v_other, None), amplification
        )
    r_rate = _along_flow(removal)(members[0], here)

    def chain(mixed: Any, first: Any, other: Any, curve: Any) -> list[Any]:
        return [mixed, first * t_other, other * t_first, curve * t_first * t_other]

    t_second = -sum(chain(g.second, g_rate.first, g_rate.other, g_curve)) / g_rate.value
    terms = [*chain(volume.second, r.first, r.other, r_rate), r.value * t_second]
    v_second = sum(terms[1:], terms[0])
    size = functools.reduce(jnp.maximum, map(jnp.abs, (volume.value, v_first, v_other, v_second)))
    return AtEvent(
        Derivatives(time, t_first, t_other, t_second),
        Derivatives(volume.value, v_first, v_other, v_second),
        amplification * jnp.maximum(1.0, sum(map(jnp.abs, terms)) / size),
    )


def _along_flow(function: Callable[[Cut, Any], Any]) -> Callable[[Cut, Any], Any]:
    """The time derivative of a function of the cut."""
    return lambda cut, motion: jax.jvp(lambda c: function(c, motion), (cut,), (motion.rate(cut),))[1]
