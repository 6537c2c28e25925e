"""A problem's motion with fewer unknowns, read from its own arithmetic.

Where the rates of several parts of the state are known multiples of one expression, one
integral of that expression gives them all: for a force of constant direction ẋ, ẏ and (with the
horizontal torque) φ̇ follow from ∫ F_x dt. A part on which neither events nor what is wanted depend,
such as x itself, is not integrated.
"""

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, Scalar, Structure
from erosion.lanes.scalars import Atom
from erosion.ode.memories import Count, Memory, Schedule, finite_times, memories_of
from erosion.ode.motion import Augmented, Motion
from erosion.ode.problem import evaluated
from erosion.ode.signature import Signature

FlatState = list[Scalar]
"""The state with its derivatives, as plain numbers, the value first and then each tangent."""


class WholeMotion(Motion):
    """A problem's motion with the state itself, as a tuple of numbers; first, if it counts, the time since the start.

    After it are the memories of events, which change with these alone.

    Args:
        signature: of problem and arguments.
        parameters: of one lane.
    """

    def __init__(self, signature: Signature, parameters: Sequence[Number]) -> None:
        self.signature, self.problem = signature, signature.problem
        self.args = signature.args(parameters)
        self.clock = signature.clock(parameters)
        self._timed = signature.equations.timed

    @functools.cached_property
    def _y0(self) -> tuple[list[Any], Structure]:
        return jax.tree.flatten(self.problem.start(self.args))

    @functools.cached_property
    def _memories(self) -> list[Memory]:
        return memories_of(self.problem, self.args)

    @functools.cached_property
    def _remembered(self) -> list[list[Scalar]]:
        """The numbers of each memory at the start."""
        return [memory.first(self.clock.t0) for memory in self._memories]

    def _memory(self, state: Sequence[Scalar]) -> list[list[Scalar]]:
        """The numbers of each memory."""
        first, numbers = int(self._timed) + sum(math.prod(np.shape(part)) for part in self._y0[0]), []
        for each in self._remembered:
            numbers.append(list(state[first : first + len(each)]))
            first += len(each)
        return numbers

    @functools.cached_property
    def _breaks(self) -> Any:
        return jnp.sort(finite_times(self.problem.break_times(self.args)))

    def start(self) -> list[Scalar]:
        """The state at the start."""
        remembered = [number for numbers in self._remembered for number in numbers]
        return [0.0 * self.clock.t0] * self._timed + elements_of(self._y0[0]) + remembered

    def initial(self) -> Augmented:
        """State and integrals at the start."""
        return Augmented(tuple(self.start()), self.integrals0())

    def integrals0(self) -> tuple[Scalar, ...]:
        """Where the integrals begin."""
        starts = self.problem.integrals_at_start(self.args)
        return tuple(starts[name] for name in self.problem.integrals)

    def whole(self, state: Sequence[Scalar]) -> tuple[Scalar, PyTree]:
        """Time, and the problem's own state."""
        # The time since the start has the digits that a late time has not.
        elapsed, *elements = state if self._timed else (0.0, *state)
        t = self.clock.t0 + elapsed
        if self.problem.breaks is not None:
            t = beside_breaks(self._breaks, t)
        parts = []
        for shape in map(np.shape, self._y0[0]):
            own, elements = elements[: math.prod(shape)], elements[math.prod(shape) :]
            parts.append(jnp.stack(own).reshape(shape) if shape else own[0])
        return t, jax.tree.unflatten(self._y0[1], parts)

    def rate(self, at: Augmented) -> Augmented:
        """Their time derivative."""
        t, y = self.whole(at.state)
        rates = elements_of(jax.tree.leaves(self.problem.vector_field(t, y, self.args)))
        integrals = tuple(rate(t, y, self.args) for rate in self.problem.integrals.values())
        still = (np.zeros(()) for numbers in self._remembered for _ in numbers)
        return Augmented((*([1.0] * self._timed), *rates, *still), integrals)

    def events(self, at: Augmented) -> list[Scalar]:
        """The event functions."""
        t, y = self.whole(at.state)
        directions = self.problem.directions(self.args)
        values = list(self.problem.event_values(t, y, self.args, self.running(at)))
        for memory, numbers in zip(self._memories, self._memory(at.state), strict=True):
            if isinstance(memory, Schedule):
                values[memory.event] = at.state[0] - (numbers[0] - self.clock.t0)
        return [-value if up == 1 else value for value, up in zip(values, directions, strict=True)]

    def running(self, at: Augmented) -> dict[str, Scalar]:
        """The integrals so far, by name."""
        return dict(zip(self.problem.integrals, at.integrals, strict=True))

    def outputs(self, at: Augmented) -> list[Scalar]:
        """What is wanted at the end."""
        return self.signature.options.outputs.of(lambda: self.elements(at.state), at.integrals)

    def elements(self, state: Sequence[Scalar]) -> list[Scalar]:
        """The elements of the problem's own state."""
        return elements_of(jax.tree.leaves(self.whole(state)[1]))

    def after(self, event: int, at: Augmented) -> Augmented:
        """State and integrals after an event."""
        reset = self.problem.resets()[event]
        if reset is None:
            return at
        (t, y), index, after = self.whole(at.state), None, []
        for memory, numbers in zip(self._memories, self._memory(at.state), strict=True):
            if memory.event == event and isinstance(memory, Schedule):
                index = lax.convert_element_type(numbers[1], np.int32)
            after += memory.following(numbers) if memory.event == event else numbers
        given = evaluated(reset, t, y, self.args, integrals=self.running(at), index=index)
        return Augmented((*at.state[: int(self._timed)], *elements_of(jax.tree.leaves(given)), *after), at.integrals)

    def ends(self, event: int, at: Augmented) -> Flag:
        """Whether the motion does not survive an event."""
        for memory, numbers in zip(self._memories, self._memory(at.state), strict=True):
            if memory.event == event and isinstance(memory, Count):
                return memory.ends(numbers)
        return super().ends(event, at)


@jax.jit
def beside_breaks(breaks: Any, t: Scalar) -> Scalar:
    """The time; `switches` puts it on the side of a break on which the motion is."""
    return t


def elements_of(parts: Sequence[Any]) -> list[Scalar]:
    """The elements of numbers and small arrays, as numbers of one type."""
    elements = []
    for part in parts:
        part = part if jnp.result_type(part) == jnp.float64 else jnp.asarray(part, jnp.float64)
        elements += [part[index] for index in np.ndindex(np.shape(part))] if np.shape(part) else [part]
    return elements


def reduced_motion_of(signature: Signature) -> Callable[[Sequence[Number]], Motion]:
    """The motion of one lane's numbers: a tuple of integrals, as few as the arithmetic shows.

    A chain goes on from a whole state, and so keeps it; so does a state scale, which is given for it, and the method
    for stiff motions, whose Jacobian is sparse in the state as it is written.
    """
    if any(signature.problem.resets()) or signature.options.state_scale is not None or signature.options.for_stiff:
        return functools.partial(WholeMotion, signature)
    start = jax.make_jaxpr(lambda parameters: WholeMotion(signature, parameters).start())(signature.structs())
    number, integrals = jax.ShapeDtypeStruct((), np.float64), len(signature.problem.integrals)

    def look(parameters: list[Number], elements: list[Scalar], integrals: list[Scalar]) -> list[Scalar]:
        motion = WholeMotion(signature, parameters)
        at = Augmented(tuple(elements), tuple(integrals))
        rate = motion.rate(at)
        # What is wanted counts as what must be known, but for the integrals.
        outputs = motion.outputs(at)
        return [*rate.state, *rate.integrals, *motion.events(at), *outputs[: len(outputs) - len(integrals)]]

    parts = [number for _ in start.out_avals]
    closed = jax.make_jaxpr(look)(signature.structs(), parts, [number] * integrals)
    unknowns = Unknowns(closed, jaxpr_as_fun(start), len(parts), integrals, len(signature.event_names))
    if not unknowns.itself and not integrals:
        return functools.partial(WholeMotion, signature)  # nothing moves, and a step needs a row
    return functools.partial(ReducedMotion, unknowns, signature)


class ReducedMotion(Motion):
    """A problem's motion whose state is a tuple of integrals."""

    def __init__(self, unknowns: "Unknowns", signature: Signature, parameters: Sequence[Number]) -> None:
        self.unknowns, self.known = unknowns, list(parameters)
        self._whole = WholeMotion(signature, parameters)
        self.clock = self._whole.clock

    def initial(self) -> Augmented:
        """State and integrals at the start."""
        return Augmented(self.unknowns.initial(self.known), self._whole.integrals0())

    def rate(self, at: Augmented) -> Augmented:
        """Their time derivative."""
        rates = self.unknowns.rates(self.known, at.state)
        count = len(at.state)
        return Augmented(tuple(rates[:count]), tuple(rates[count:]))

    def events(self, at: Augmented) -> list[Scalar]:
        """The event functions."""
        return self.unknowns.events(self.known, at.state, at.integrals)

    def outputs(self, at: Augmented) -> list[Scalar]:
        """What is wanted at the end."""
        return self._whole.signature.options.outputs.of(
            lambda: self._whole.elements(self.unknowns.parts(self.known, at.state)), at.integrals
        )


class _Product(NamedTuple):
    """An expression taken apart: sign · times/over · core."""

    sign: float
    times: list[Atom]
    over: list[Atom]
    core: Atom


class Unknowns:
    """The expressions to integrate, and how the parts of the state follow from them.

    Args:
        closed: a function of (known …, state …, integrals …) that gives the rates of the state, the rates of the
            integrals, the events, and what else must be known. Of these only events depend on integrals.
        start: a function of (known …) that gives the state at the start.
        parts: number of parts of the state.
        integrals: number of integrals.
        events: number of events.
    """

    def __init__(
        self, closed: ClosedJaxpr, start: Callable[..., list[Scalar]], parts: int, integrals: int, events: int
    ) -> None:
        self._start = start
        self._made_by = {made: equation for equation in closed.jaxpr.eqns for made in equation.outvars}
        arguments, outputs = closed.jaxpr.invars, closed.jaxpr.outvars
        moving = arguments[len(arguments) - parts - integrals :]
        state = moving[:parts]
        self._state = set(state)
        self._known = known_values(closed.jaxpr, set(moving))
        no_integrals = [0.0] * integrals
        rates = dict(zip(state, outputs[:parts], strict=True))
        needed: set[Var] = set()
        while (more := needed | self._inputs([*outputs[parts:], *(rates[part] for part in needed)])) > needed:
            needed = more
        changing = [i for i, part in enumerate(state) if part in needed and not _is_zero(rates[part])]
        products = {i: self._product(rates[state[i]]) for i in changing}
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
        first = parts + integrals
        rates = evaluate(closed, [*cores, *outputs[parts:first]])
        values = evaluate(closed, outputs[first : first + events])
        # JAX traces each of these once, for all the places and derivatives that ask for it.
        self.initial = jax.jit(self._initial)
        self.rates = jax.jit(lambda known, own: rates(*known, *self.parts(known, own), *no_integrals))
        self.events = jax.jit(lambda known, own, integrals: values(*known, *self.parts(known, own), *integrals))
        factors = evaluate(closed, [part for *_, product in self._follow for part in (*product.times, *product.over)])
        self._factors = lambda known, start: factors(*known, *start, *no_integrals)

    def _initial(self, known: Sequence[Number]) -> tuple[Scalar, ...]:
        """The integrals at the start: a part of the state where the integral is one, else zero."""
        start = self._start(*known)
        return tuple(jnp.zeros(()) if i is None else start[i] for i in self.itself)

    def parts(self, known: Sequence[Number], integrals: Sequence[Scalar]) -> list[Scalar]:
        """The state itself; parts of it that do not matter stay as they were at the start."""
        start = self._start(*known)
        parts = list(start)
        factors = iter(self._factors(known, start))
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


def known_values(jaxpr: Jaxpr, state: set[Var]) -> set[Var]:
    """The values that do not depend on the state."""
    known = {*jaxpr.constvars, *jaxpr.invars} - state
    for equation in jaxpr.eqns:
        if all(isinstance(atom, Literal) or atom in known for atom in equation.invars):
            known |= set(equation.outvars)
    return known


# What keeps a function affine; beside these a product with a known number, and a quotient by one.
_AFFINE = frozenset({
    "neg", "add", "sub", "add_any", "convert_element_type", "broadcast_in_dim", "reshape", "squeeze", "slice",
    "concatenate", "reduce_sum", "copy", "transpose", "expand_dims", "rev",
})  # fmt: skip


def are_affine(jaxpr: Jaxpr, varies: Sequence[bool]) -> list[bool]:
    """Of each result whether it is an affine function of the arguments that vary."""
    degree: dict[Any, int] = dict(zip(jaxpr.invars, map(int, varies), strict=True))
    return [each < 2 for each in _degrees(jaxpr, degree)]


def _degrees(jaxpr: Jaxpr, degree: dict[Any, int]) -> list[int]:
    """Of each result whether it is known (0), affine in what varies (1), or neither (2); `degree` has the arguments."""

    def of(atom: Atom) -> int:
        return 0 if isinstance(atom, Literal) else degree.get(atom, 0)

    for equation in jaxpr.eqns:
        name, inputs = equation.primitive.name, [of(atom) for atom in equation.invars]
        inner, made = equation.params.get("jaxpr"), [2 if any(inputs) else 0] * len(equation.outvars)
        if any(inputs) and isinstance(inner, ClosedJaxpr) and name in ("jit", "pjit"):
            made = _degrees(inner.jaxpr, dict(zip(inner.jaxpr.invars, inputs, strict=True)))
        elif (
            name in _AFFINE
            or (name == "mul" and not all(inputs))
            or (name == "div" and not inputs[1])
            or (name == "select_n" and not inputs[0])
        ):
            made = [max(inputs)] * len(equation.outvars)
        degree |= zip(equation.outvars, made, strict=True)
    return [of(atom) for atom in jaxpr.outvars]


def _is_zero(value: Atom) -> bool:
    return isinstance(value, Literal) and bool(value.val == 0)


def evaluate(closed: ClosedJaxpr, wanted: list[Atom]) -> Callable[..., list[Scalar]]:
    """A function of the arguments that gives only the wanted values."""
    needed = {value for value in wanted if not isinstance(value, Literal)}
    kept = []
    for equation in reversed(closed.jaxpr.eqns):
        if not needed.isdisjoint(equation.outvars):
            kept.append(equation)
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr.replace(eqns=kept[::-1], outvars=wanted), closed.consts))
