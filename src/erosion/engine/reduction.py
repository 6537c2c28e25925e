"""A model's motion with fewer unknowns, read from the model's own arithmetic.

Where the rates of several parts of the state are known multiples of one expression, one
integral of that expression gives them all: for a force of constant direction ẋ, ẏ and (with the
horizontal torque) φ̇ follow from ∫ F_x dt. A part on which neither events nor volume depend,
such as x itself, is not integrated.
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun

from erosion.array_types import Broadcast, ModelState, Number, Scalar
from erosion.engine.leaves import Layout, numbers_of
from erosion.engine.variational import Cut
from erosion.lanes.scalars import Atom
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import Parameters


class WholeMotion:
    """A model's motion with the model's own state, as a tuple of numbers."""

    def __init__(self, model: CuttingModel, p: Parameters) -> None:
        self.model, self.p = model, p
        self.start, self.structure = jax.tree.flatten(model.initial_state(p))

    def initial_state(self) -> tuple[Scalar, ...]:
        """The state at contact."""
        return tuple(self.start)

    def state(self, cut: Cut) -> ModelState:
        """The model's own state."""
        return jax.tree.unflatten(self.structure, cut.state)

    def rate(self, cut: Cut) -> Cut:
        """The time derivative of state and volume."""
        state = self.state(cut)
        rates = jax.tree.leaves(self.model.derivative(state, self.p))
        return Cut(tuple(rates), self.model.removal_rate(state, self.p))

    def removed_at_contact(self) -> Broadcast:
        """The volume removed beside the cut."""
        return self.model.removed_at_contact(self.p)

    def events(self, cut: Cut) -> list[Scalar]:
        """The event functions, by name."""
        # JAX sorts the keys of a dictionary that passes through it; so is the order everywhere.
        return [value for _, value in sorted(self.model.events(self.state(cut), self.p).items())]


def reduced(layout: Layout) -> Callable[[CuttingModel, Parameters], "ReducedMotion"]:
    """The motion of model and case whose state is a tuple of integrals: as few as the arithmetic shows."""
    start = jax.make_jaxpr(lambda numbers: WholeMotion(*layout.joined(numbers)).start)(layout.structs())

    def look(numbers: list[Number], leaves: list[Scalar]) -> list[Scalar]:
        motion = WholeMotion(*layout.joined(numbers))
        cut = Cut(tuple(leaves), 0.0)
        rate = motion.rate(cut)
        return [*rate.state, rate.volume, *motion.events(cut)]

    parts = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in start.out_avals]
    unknowns = Unknowns(jax.make_jaxpr(look)(layout.structs(), parts), jaxpr_as_fun(start), len(parts))
    return functools.partial(ReducedMotion, unknowns)


class ReducedMotion:
    """A model's motion whose state is a tuple of integrals."""

    def __init__(self, unknowns: "Unknowns", model: CuttingModel, p: Parameters) -> None:
        self.unknowns, self.known = unknowns, numbers_of(model, p)
        self.model, self.p = model, p

    def initial_state(self) -> tuple[Scalar, ...]:
        """The integrals at contact."""
        return self.unknowns.initial(self.known)

    def rate(self, cut: Cut) -> Cut:
        """The time derivative of integrals and volume."""
        *rates, volume = self.unknowns.rates(self.known, cut.state)
        return Cut(tuple(rates), volume)

    def removed_at_contact(self) -> Broadcast:
        """The volume removed beside the cut."""
        return self.model.removed_at_contact(self.p)

    def events(self, cut: Cut) -> list[Scalar]:
        """The event functions, by name."""
        return self.unknowns.events(self.known, cut.state)


class _Product(NamedTuple):
    """An expression taken apart: sign · times/over · core."""

    sign: float
    times: list[Atom]
    over: list[Atom]
    core: Atom


class Unknowns:
    """The expressions to integrate, and how the parts of the state follow from them.

    Args:
        closed: a function of (known …, state …) that gives the state's rates, the volume's rate, the events.
        start: a function of (known …) that gives the state at contact.
        parts: number of parts of the state.
    """

    def __init__(self, closed: ClosedJaxpr, start: Callable[..., list[Scalar]], parts: int) -> None:
        self._start = start
        self._made_by = {made: equation for equation in closed.jaxpr.eqns for made in equation.outvars}
        arguments, outputs = closed.jaxpr.invars, closed.jaxpr.outvars
        state = arguments[len(arguments) - parts :]
        self._state = set(state)
        self._known = _known(closed.jaxpr, self._state)
        rates = dict(zip(state, outputs[:parts], strict=True))
        needed: set[Var] = set()
        while (more := needed | self._inputs([*outputs[parts:], *(rates[part] for part in needed)])) > needed:
            needed = more
        moving = [i for i, part in enumerate(state) if part in needed and not _is_zero(rates[part])]
        products = {i: self._product(rates[state[i]]) for i in moving}
        groups: dict[tuple[int, int], list[int]] = {}
        for i, product in products.items():
            # A part that relaxes keeps its digits only as an integral of its own.
            alone = state[i] in self._inputs([rates[state[i]]])
            # Cores by identity: JAX's literals cannot be compared.
            groups.setdefault((i, 0) if alone else (-1, id(product.core)), []).append(i)
        cores = []
        self.itself: list[int | None] = []  # the part of the state that an integral is, if it is one
        self._follow: list[tuple[int, int, _Product]] = []
        for index, group in enumerate(groups.values()):
            # Several parts follow an integral from zero: from one part's start the others lose digits.
            itself = group[0] if len(group) == 1 else None
            cores.append(products[group[0]].core if itself is None else rates[state[itself]])
            self.itself.append(itself)
            self._follow += [(i, index, products[i]) for i in group if i != itself]
        rates, events = _evaluate(closed, [*cores, outputs[parts]]), _evaluate(closed, outputs[parts + 1 :])
        # JAX traces each of these once, for all the places and derivatives that ask for it.
        self.initial = jax.jit(self._initial)
        self.rates = jax.jit(lambda known, integrals: rates(*known, *self._parts(known, integrals)))
        self.events = jax.jit(lambda known, integrals: events(*known, *self._parts(known, integrals)))
        self._factors = _evaluate(
            closed, [part for *_, product in self._follow for part in (*product.times, *product.over)]
        )

    def _initial(self, known: Sequence[Number]) -> tuple[Scalar, ...]:
        """The integrals at contact: a part of the model's state where the integral is one, else zero."""
        start = self._start(*known)
        return tuple(jnp.zeros(()) if i is None else start[i] for i in self.itself)

    def _parts(self, known: Sequence[Number], integrals: Sequence[Scalar]) -> list[Scalar]:
        """The model's own state; parts of it that do not matter stay as they were at contact."""
        start = self._start(*known)
        parts = list(start)
        factors = iter(self._factors(*known, *start))
        for i, index, product in self._follow:
            times = math.prod([next(factors) for _ in product.times], start=product.sign)
            over = math.prod([next(factors) for _ in product.over], start=1.0)
            # Only an integral from zero is followed.
            parts[i] = parts[i] + times / over * integrals[index]
        for i, integral in zip(self.itself, integrals, strict=True):
            if i is not None:
                parts[i] = integral
        return parts

    def _product(self, core: Atom) -> _Product:
        """The expression with its known factors taken off."""
        sign, times, over = 1.0, [], []
        while not self._is_known(core) and core in self._made_by:
            name, inputs = self._made_by[core].primitive.name, self._made_by[core].invars
            if name == "neg":
                sign, core = -sign, inputs[0]
            elif name == "mul" and any(map(self._is_known, inputs)):
                factor, core = inputs if self._is_known(inputs[0]) else reversed(inputs)
                times.append(factor)
            elif name == "div" and self._is_known(inputs[1]):
                core = inputs[0]
                over.append(inputs[1])
            else:
                break
        return _Product(sign, times, over, core)

    def _is_known(self, value: Atom) -> bool:
        return isinstance(value, Literal) or value in self._known

    def _inputs(self, values: Iterable[Atom]) -> set[Var]:
        """The parts of the state that these values depend on."""
        seen: set[Atom] = set()
        waiting = [value for value in values if not self._is_known(value)]
        while waiting:
            value = waiting.pop()
            if value not in seen:
                seen.add(value)
                equation = self._made_by.get(value)
                waiting += [atom for atom in equation.invars if not self._is_known(atom)] if equation else []
        return self._state & seen


def _known(jaxpr: Jaxpr, state: set[Var]) -> set[Var]:
    """The values that do not depend on the state."""
    known = {*jaxpr.constvars, *jaxpr.invars} - state
    for equation in jaxpr.eqns:
        if all(isinstance(atom, Literal) or atom in known for atom in equation.invars):
            known |= set(equation.outvars)
    return known


def _is_zero(value: Atom) -> bool:
    return isinstance(value, Literal) and bool(value.val == 0)


def _evaluate(closed: ClosedJaxpr, wanted: list[Atom]) -> Callable[..., list[Scalar]]:
    """A function of the arguments that gives only the wanted values."""
    needed = {value for value in wanted if not isinstance(value, Literal)}
    kept = []
    for equation in reversed(closed.jaxpr.eqns):
        if not needed.isdisjoint(equation.outvars):
            kept.append(equation)
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr.replace(eqns=kept[::-1], outvars=wanted), closed.consts))
