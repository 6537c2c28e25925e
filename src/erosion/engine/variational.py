"""The variational equations: derivatives by parameters, carried along with the motion.

For directions ε and η in the space of parameters the state s is extended by ∂s/∂ε, ∂s/∂η and
∂²s/∂ε∂η. Only the vector field is differentiated (nested `jvp`), never the integration; the time
of the event follows by the implicit function theorem.
"""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from erosion.array_types import Broadcast, Number, Scalar
from erosion.engine.leaves import Layout
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import QUANTITIES, Parameters

Direction = str | Scalar
"""A parameter's name, or (traced) the place of an element among the elements of all numbers; see `Layout`."""


class Cut(NamedTuple):
    """The integrated quantities: the model's state and the volume removed so far."""

    state: tuple[Scalar, ...]
    volume: Scalar


@runtime_checkable
class Motion(Protocol):
    """What is integrated of an impact; see `erosion.engine.reduction`."""

    def initial_state(self) -> tuple[Scalar, ...]:
        """The state at contact."""
        ...

    def removed_at_contact(self) -> Broadcast:
        """The volume removed beside the cut."""
        ...

    def rate(self, cut: Cut) -> Cut:
        """The time derivative of state and volume."""
        ...

    def events(self, cut: Cut) -> list[Scalar]:
        """The event functions, by name."""
        ...


CutFunction = Callable[[Cut, Motion], PyTree]
"""A function of the cut and its motion; its value is a number, or numbers."""


class Derivatives(NamedTuple):
    """A quantity with its first and mixed second derivative along two directions."""

    value: PyTree
    first: PyTree
    other: PyTree
    second: PyTree


class Variational:
    """The state with its derivatives: at contact, its rate, and functions of it, for `order` 0, 1 or 2.

    The extended state is a tuple. Along one direction it has `order` + 1 members. For two different
    directions at order 2 it has four: value, first, other, second.

    Args:
        layout: of the numbers.
        numbers: of one impact.
        order: number of derivatives, 0 to 2.
        directions: one direction, or two for a mixed second derivative.
        motion: from model and case to what is integrated; see `erosion.engine.reduction`.
    """

    def __init__(
        self,
        layout: Layout,
        numbers: Sequence[Number],
        order: int,
        directions: tuple[Direction, ...],
        motion: Callable[[CuttingModel, Parameters], Motion],
    ) -> None:
        self.layout, self.numbers, self.order, self.directions = layout, list(numbers), order, directions
        self.motion = motion
        self.mixed = order == 2 and len(directions) == 2

    def initial(self) -> tuple[Cut, ...]:
        """The state at contact, and what is removed there."""

        def start(_: object, motion: Motion) -> Cut:
            return Cut(motion.initial_state(), jnp.asarray(motion.removed_at_contact(), float))

        return self._pack(self._lift(start, ()))

    def rate(self, members: tuple[Cut, ...]) -> tuple[Cut, ...]:
        """The time derivative of a state."""
        return self._pack(self._lift(lambda cut, motion: motion.rate(cut), members))

    def of(self, function: CutFunction, members: tuple[Cut, ...]) -> Derivatives:
        """A function of (cut, motion), with its derivatives along the directions."""
        return self._lift(function, members)

    def at(self, numbers: Sequence[Number]) -> Motion:
        """The motion with these numbers."""
        return self.motion(*self.layout.joined(numbers))

    def per_unit(self, scaled: Derivatives) -> Derivatives:
        """Derivatives by the directions' units turned into derivatives by the parameters."""
        if self.order == 0:
            return scaled
        unit, other_unit = self._unit(self.directions[0]), self._unit(self.directions[-1])
        second = None if scaled.second is None else scaled.second / (unit * other_unit)
        return Derivatives(scaled.value, scaled.first / unit, scaled.other / other_unit, second)

    def _pack(self, derivatives: Derivatives) -> tuple[Cut, ...]:
        if self.mixed:
            return (derivatives.value, derivatives.first, derivatives.other, derivatives.second)
        return (derivatives.value, derivatives.first, derivatives.second)[: self.order + 1]

    def _lift(self, function: CutFunction, members: tuple[Cut, ...]) -> Derivatives:
        """Push a state with its derivatives through a function of (cut, motion)."""
        padded = (*members, None, None) if members else ((), (), ())
        at = Derivatives(*members) if len(members) == 4 else Derivatives(padded[0], padded[1], padded[1], padded[2])
        zero, one = np.zeros(()), np.ones(())
        if self.order == 0:
            return Derivatives(function(at.value, self.at(self.numbers)), None, None, None)

        def along(cut: PyTree, step: Scalar, numbers: Sequence[Number]) -> PyTree:
            return function(cut, self.at(self._moved(numbers, self.directions[0], step)))

        if self.order == 1:
            value, first = jax.jvp(lambda c, e: along(c, e, self.numbers), (at.value, zero), (at.first, one))
            return Derivatives(value, first, first, None)

        def first_member(cut: PyTree, cut_first: PyTree, other_step: Scalar) -> tuple[PyTree, PyTree]:
            numbers = self._moved(self.numbers, self.directions[-1], other_step)
            return jax.jvp(lambda c, e: along(c, e, numbers), (cut, zero), (cut_first, one))

        (value, first), (other, second) = jax.jvp(first_member, (at.value, at.first, zero), (at.other, at.second, one))
        return Derivatives(value, first, other, second)

    def _moved(self, numbers: Sequence[Number], direction: Direction, step: Scalar) -> list[Number]:
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

    def _unit(self, direction: Direction) -> Scalar:
        """A significant change of the parameter: 1 rad, the spin v₀/r, or the parameter's own size.

        Derivatives by such units compare with the value itself, so that one tolerance fits all.
        """
        sizes: list[Number] = [jnp.abs(n) for n in self.numbers]
        names = list(QUANTITIES)
        v0, r = (self.numbers[names.index(name)] for name in ("v0", "r"))
        sizes[names.index("alpha")], sizes[names.index("phidot0")] = np.ones(()), v0 / r
        if isinstance(direction, str):
            size = sizes[names.index(direction)]
        else:
            size = 0.0
            for number, shape, offset in zip(sizes, self.layout.shapes, self.layout.offsets, strict=False):
                places = offset + np.arange(np.prod(shape), dtype=float).reshape(shape)
                size = size + jnp.sum(jnp.where(direction == places, number, 0.0))
        return lax.stop_gradient(jnp.where(size == 0, 1.0, size))


class AtEvent(NamedTuple):
    """Derivatives of the event's time and of the volume there, and how much larger their errors may be."""

    time: Derivatives
    volume: Derivatives
    amplification: Scalar


def at_event(equations: Variational, members: tuple[Cut, ...], event: Scalar, time: Scalar) -> AtEvent:
    """Derivatives at the event, whose time depends on the parameters as well.

    With g the event function and R the removal rate along the flow, all at the event:
    t_ε = -g_ε/ġ;  V_ε = v_ε + R t_ε;  and for the second derivatives the chain rule once more.
    R vanishes at rebound and stop, but need not at the events of a plug-in.

    `amplification` is the ratio of the results' errors to the state's: g̈ t/ġ, large where the event
    function falls slowly, times the ratio of the second derivative's terms to their sum.

    Args:
        equations: of the impact.
        members: the state at the event.
        event: index of the event that ended the cut, in the order of names; below 0 if none did.
        time: since contact.
    """

    def event_function(cut: Cut, motion: Motion) -> Scalar:
        chosen = jnp.zeros(())
        for i, value in enumerate(motion.events(cut)):
            chosen = jnp.where(event == i, value, chosen)
        return chosen

    def removal(cut: Cut, motion: Motion) -> Scalar:
        return motion.rate(cut).volume

    here = equations.at(equations.numbers)
    volume = equations.of(lambda cut, _: cut.volume, members)
    g_rate = equations.of(_along_flow(event_function), members)
    # Where no event ended the cut its time is given, and has no derivative.
    g_rate = g_rate._replace(value=jnp.where(event < 0, 1.0, g_rate.value))
    g_curve = _along_flow(_along_flow(event_function))(members[0], here)
    amplification = jnp.maximum(1.0, jnp.abs(g_curve * time / g_rate.value))
    if equations.order == 0:
        return AtEvent(Derivatives(time, None, None, None), volume, amplification)
    g, r = equations.of(event_function, members), equations.of(removal, members)
    t_first, t_other = -g.first / g_rate.value, -g.other / g_rate.value
    v_first, v_other = volume.first + r.value * t_first, volume.other + r.value * t_other
    if equations.order == 1:
        return AtEvent(
            Derivatives(time, t_first, t_other, None), Derivatives(volume.value, v_first, v_other, None), amplification
        )
    r_rate = _along_flow(removal)(members[0], here)

    def chain(mixed: Scalar, first: Scalar, other: Scalar, curve: Scalar) -> list[Scalar]:
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


def _along_flow(function: CutFunction) -> CutFunction:
    """The time derivative of a function of the cut."""
    return lambda cut, motion: jax.jvp(lambda c: function(c, motion), (cut,), (motion.rate(cut),))[1]
