"""A problem's motion with fewer unknowns, and where it is not smooth, read from its own arithmetic.

Where the rates of several parts of the state are known multiples of one expression, one
integral of that expression gives them all: for a force of constant direction ẋ, ẏ and (with the
horizontal torque) φ̇ follow from ∫ F_x dt. A part on which neither events nor what is wanted depend,
such as x itself, is not integrated.

Steps across a kink of a rate are so short that each rate has one of two values in them: that before the kink or
that after it. So kinks need not be known: they show themselves.

The motion s' = f(s) has the derivatives s_a and s_b by two parameters; their rates are G_a and G_b. With [·] a change
across the kink:

- [f] ≠ 0: the rate jumps. Where it does depends on the parameters, so that even s_a jumps. Nothing says by how much,
  and the lane fails; see `erosion.ode.batch`, which then computes it without derivatives.
- [f] = 0: ḟ and G jump together, [G_a] = -τ_a [ḟ] with τ the time of the kink. Then s_ab jumps by [G_a] [G_b] / [ḟ].

Most motions have none, and their programs need not look for any.
"""

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var, jaxpr_as_fun
from jaxtyping import PyTree

from erosion.arguments import Flag, Number, Scalar, Structure
from erosion.lanes.scalars import Atom, Equation
from erosion.ode.variational import Augmented, Clock, Layout


class WholeMotion:
    """A problem's motion with the state itself, as a tuple of numbers; where it depends on time, time comes first.

    Args:
        layout: of problem and arguments.
        numbers: of one lane.
    """

    def __init__(self, layout: Layout, numbers: Sequence[Number]) -> None:
        self.layout, self.problem = layout, layout.problem
        self.args = layout.args(numbers)
        self.clock = layout.clock(numbers) if layout.options.clock else Clock(0.0, math.inf, math.inf, math.inf)
        self._timed = layout.equations.timed

    @functools.cached_property
    def _y0(self) -> tuple[list[Any], Structure]:
        return jax.tree.flatten(self.problem.start(self.args))

    def start(self) -> list[Scalar]:
        """The state at the start."""
        return [self.clock.t0] * self._timed + _elements(self._y0[0])

    def initial(self) -> Augmented:
        """The state and the integrals at the start."""
        return Augmented(tuple(self.start()), self.integrals0())

    def integrals0(self) -> tuple[Scalar, ...]:
        """Where the integrals begin."""
        if self.problem.integrals0 is None:
            return (0.0,) * len(self.problem.integrals)
        starts = self.problem.integrals0(self.args)
        return tuple(starts[name] for name in self.problem.integrals)

    def whole(self, state: Sequence[Scalar]) -> tuple[Scalar, PyTree]:
        """Time, and the problem's own state."""
        t, *elements = state if self._timed else (self.clock.t0, *state)
        parts = []
        for shape in map(np.shape, self._y0[0]):
            own, elements = elements[: math.prod(shape)], elements[math.prod(shape) :]
            parts.append(jnp.stack(own).reshape(shape) if shape else own[0])
        return t, jax.tree.unflatten(self._y0[1], parts)

    def rate(self, at: Augmented) -> Augmented:
        """The time derivative of state and integrals."""
        t, y = self.whole(at.state)
        rates = _elements(jax.tree.leaves(self.problem.vector_field(t, y, self.args)))
        integrals = tuple(rate(t, y, self.args) for rate in self.problem.integrals.values())
        return Augmented((*([1.0] * self._timed), *rates), integrals)

    def events(self, at: Augmented) -> list[Scalar]:
        """The event functions, positive before their event; those of either direction as they are."""
        t, y = self.whole(at.state)
        directions = self.problem.directions(self.args)
        values = self.problem.event_values(t, y, self.args)
        return [-value if up == 1 else value for value, up in zip(values, directions, strict=True)]

    def outputs(self, at: Augmented) -> list[Scalar]:
        """What is wanted at the end: the elements of the state, where they are, and the integrals."""
        _, y = self.whole(at.state)
        return [*(_elements(jax.tree.leaves(y)) if self.layout.options.whole else []), *at.integrals]

    def after(self, event: int, at: Augmented) -> Augmented:
        """The state after an event that the motion survives."""
        reset = self.problem.resets()[event]
        if reset is None:
            return at
        t, y = self.whole(at.state)
        elements = _elements(jax.tree.leaves(reset(t, y, self.args)))
        return Augmented((*at.state[: int(self._timed)], *elements), at.integrals)


def _elements(parts: Sequence[Any]) -> list[Scalar]:
    """The elements of numbers and small arrays, as numbers of one type."""
    elements = []
    for part in parts:
        part = part if jnp.result_type(part) == jnp.float64 else jnp.asarray(part, jnp.float64)
        elements += [part[index] for index in np.ndindex(np.shape(part))] if np.shape(part) else [part]
    return elements


def motion_of(layout: Layout) -> Callable[[Sequence[Number]], "WholeMotion | ReducedMotion"]:
    """The motion of one lane's numbers: a tuple of integrals, as few as the arithmetic shows.

    A chain goes on from a whole state, and so keeps it; so do sizes, which are given for it, and the method for stiff
    motions, whose Jacobian is sparse in the state as it is written.
    """
    if any(layout.problem.resets()) or layout.options.sizes is not None or layout.options.method == "rosenbrock":
        return functools.partial(WholeMotion, layout)
    start = jax.make_jaxpr(lambda numbers: WholeMotion(layout, numbers).start())(layout.structs())
    integrals = len(layout.problem.integrals)

    def look(numbers: list[Number], elements: list[Scalar]) -> list[Scalar]:
        motion = WholeMotion(layout, numbers)
        at = Augmented(tuple(elements), (0.0,) * integrals)
        rate = motion.rate(at)
        # What is wanted counts as what must be known, but for the integrals.
        wanted = motion.outputs(at)[: len(elements)] if layout.options.whole else []
        return [*rate.state, *rate.integrals, *motion.events(at), *wanted]

    parts = [jax.ShapeDtypeStruct((), np.float64) for _ in start.out_avals]
    closed = jax.make_jaxpr(look)(layout.structs(), parts)
    unknowns = Unknowns(closed, jaxpr_as_fun(start), len(parts), integrals, len(layout.event_names))
    if not unknowns.itself and not integrals:
        return functools.partial(WholeMotion, layout)  # nothing moves, and a step needs a row
    return functools.partial(ReducedMotion, unknowns, layout)


class ReducedMotion:
    """A problem's motion whose state is a tuple of integrals."""

    def __init__(self, unknowns: "Unknowns", layout: Layout, numbers: Sequence[Number]) -> None:
        self.unknowns, self.known = unknowns, list(numbers)
        self._whole = WholeMotion(layout, numbers)
        self.clock = self._whole.clock

    def initial(self) -> Augmented:
        """The integrals at the start."""
        return Augmented(self.unknowns.initial(self.known), self._whole.integrals0())

    def rate(self, at: Augmented) -> Augmented:
        """The time derivative of all integrals."""
        rates = self.unknowns.rates(self.known, at.state)
        count = len(at.state)
        return Augmented(tuple(rates[:count]), tuple(rates[count:]))

    def events(self, at: Augmented) -> list[Scalar]:
        """The event functions."""
        return self.unknowns.events(self.known, at.state)

    def outputs(self, at: Augmented) -> list[Scalar]:
        """What is wanted at the end."""
        if not self._whole.layout.options.whole:
            return list(at.integrals)
        parts = tuple(self.unknowns.parts(self.known, at.state))
        return self._whole.outputs(Augmented(parts, at.integrals))

    def after(self, event: int, at: Augmented) -> Augmented:
        """No event is survived."""
        return at


class _Product(NamedTuple):
    """An expression taken apart: sign · times/over · core."""

    sign: float
    times: list[Atom]
    over: list[Atom]
    core: Atom


class Unknowns:
    """The expressions to integrate, and how the parts of the state follow from them.

    Args:
        closed: a function of (known …, state …) that gives the rates of the state, the rates of the integrals, the
            events, and what else must be known.
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
        first = parts + integrals
        rates = _evaluate(closed, [*cores, *outputs[parts:first]])
        values = _evaluate(closed, outputs[first : first + events])
        # JAX traces each of these once, for all the places and derivatives that ask for it.
        self.initial = jax.jit(self._initial)
        self.rates = jax.jit(lambda known, integrals: rates(*known, *self.parts(known, integrals)))
        self.events = jax.jit(lambda known, integrals: values(*known, *self.parts(known, integrals)))
        self._factors = _evaluate(
            closed, [part for *_, product in self._follow for part in (*product.times, *product.over)]
        )

    def _initial(self, known: Sequence[Number]) -> tuple[Scalar, ...]:
        """The integrals at the start: a part of the state where the integral is one, else zero."""
        start = self._start(*known)
        return tuple(jnp.zeros(()) if i is None else start[i] for i in self.itself)

    def parts(self, known: Sequence[Number], integrals: Sequence[Scalar]) -> list[Scalar]:
        """The state itself; parts of it that do not matter stay as they were at the start."""
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


_SHORT = 1e-2  # of the time scale: longer steps cross no kink that matters
_TWO_VALUED = 0.1  # of the change of a rate: so near one of both its ends are its values at the stages
_ABRUPT = 100.0  # times what a rate that changes within the time scale would: it jumps
_MOMENT = 1e-8  # of the time scale: so soon before and after an event a smooth rate is the same
_OTHER = 1e-6  # of its size, and of what it does within the time scale: a rate so different has a kink

Rows = list[Scalar]
"""The state with its derivatives, as plain numbers, one member after the other."""


@runtime_checkable
class Flow(Protocol):
    """What is needed of the integrated equations.

    Args:
        width: number of rows of the motion itself, and of each derivative.
        rate: of all rows.
        motion_rate: of the rows of the motion itself.
    """

    width: int
    rate: Callable[[Rows], Rows]
    motion_rate: Callable[[Rows], Rows]


def is_broken(problem: Flow, before: Rows, stages: list[Rows], h: Scalar, scale: Scalar) -> Flag:
    """Whether a rate of the motion itself jumps within a step.

    Args:
        problem: the equations.
        before: the state at the step's start.
        stages: the slopes of each row in the step.
        h: its length.
        scale: the time scale.
    """
    broken: Flag = jnp.asarray(False)
    for row in range(problem.width):
        change = jnp.abs(_jump(stages[row]))
        size = jnp.maximum(jnp.abs(before[row]), scale * jnp.maximum(jnp.abs(stages[row][0]), jnp.abs(stages[row][-1])))
        broken = broken | (change * scale * scale > _ABRUPT * h * size)
    return broken & (h < _SHORT * scale)


def is_kinked(problem: Flow, event: Rows, slope: Rows, scale: Scalar) -> Flag:
    """Whether a rate, of the motion or of its derivatives, is another one after an event than before it.

    Args:
        problem: the equations.
        event: the state at the event.
        slope: its rate near the event.
        scale: the time scale.
    """
    moment = _MOMENT * scale
    before, after = (
        problem.rate([u + time * k for u, k in zip(event, slope, strict=True)]) for time in (-moment, moment)
    )
    kinked: Flag = jnp.asarray(False)
    for u, one, other in zip(event, before, after, strict=True):
        size = jnp.maximum(jnp.maximum(jnp.abs(one), jnp.abs(other)), jnp.abs(u) / scale)
        kinked = kinked | (jnp.abs(other - one) > _OTHER * size)
    return kinked


def divisors(closed: ClosedJaxpr, operands: Sequence[Scalar], varies: Sequence[bool]) -> list[Scalar]:
    """What a function divides by, where that depends on the operands that vary."""
    jaxpr, found, parts = closed.jaxpr, [], []
    known = _known(jaxpr, {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves})
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom not in known for atom in equation.invars]
        inner = equation.params.get("jaxpr")
        if any(moves) and isinstance(inner, ClosedJaxpr) and equation.primitive.name in ("jit", "pjit"):
            parts += divisors(inner, _evaluate(closed, list(equation.invars))(*operands), moves)
        elif equation.primitive.name == "div" and moves[1]:
            found.append(equation.invars[1])
        elif equation.primitive.name == "integer_pow" and moves[0] and equation.params["y"] < 0:
            found.append(equation.invars[0])
    return _elements(_evaluate(closed, found)(*operands)) + parts


def corrected(
    problem: Flow,
    before: tuple[Rows, Rows],
    after: tuple[Rows, Rows],
    stages: list[Rows],
    h: Scalar,
    scale: Scalar,
) -> tuple[Rows, Rows]:
    """State and slope after a step, the second derivatives corrected if it crosses a kink.

    Args:
        problem: the equations, to second order.
        before: state and slope where the step begins.
        after: the same at its end.
        stages: the slopes of each row in the step.
        h: its length.
        scale: the time scale.
    """
    width, (state, slope) = problem.width, after
    jumps = [_jump(row) for row in stages[width:-width]]  # of the rates of first derivatives
    crosses = (h < _SHORT * scale) & (sum(map(jnp.abs, jumps)) > 0)

    def at_kink() -> tuple[Rows, Rows]:
        bends = [new - old for new, old in zip(_bend(problem, *after), _bend(problem, *before), strict=True)]
        sizes = [jnp.maximum(jnp.abs(u), scale * jnp.abs(k)) for u, k in zip(state[:width], slope, strict=False)]
        weights = [bend / (size * size + 1e-200) for bend, size in zip(bends, sizes, strict=True)]
        first, other = jumps[:width], jumps[-width:]
        passed = _product(weights, other) / _product(weights, bends)
        second = [u + jump * passed for u, jump in zip(state[-width:], first, strict=True)]
        moved = [*state[:-width], *second]
        return moved, problem.rate(moved)

    return lax.cond(crosses, at_kink, lambda: (state, slope))


def _product(weights: Sequence[Scalar], values: Sequence[Scalar]) -> Scalar:
    return sum(weight * value for weight, value in zip(weights, values, strict=True))


@jax.jit
def _jump(slopes: Sequence[Scalar]) -> Scalar:
    """By how much a rate jumps within a step; 0 where it takes values between its ends, as smooth rates do."""
    start, end = slopes[0], slopes[-1]
    change = end - start
    near = jnp.zeros(())
    for slope in slopes[1:-1]:
        near = jnp.maximum(near, jnp.minimum(jnp.abs(slope - start), jnp.abs(slope - end)))
    return jnp.where(near <= _TWO_VALUED * jnp.abs(change), change, 0.0)


def _bend(problem: Flow, state: Rows, slope: Rows) -> Rows:
    """The second time derivative of the motion itself."""
    width = problem.width
    return jax.jvp(problem.motion_rate, (state[:width],), (slope[:width],))[1]


# What is smooth wherever it is finite. `sqrt`, `log` and `pow` are not: at 0 they are NaN or their rates infinite; nor
# is `atan2`, which jumps at the origin and behind it.
_SMOOTH = frozenset({
    "add", "add_any", "sub", "mul", "neg", "div", "integer_pow", "square", "exp", "exp2", "expm1", "log1p", "tanh",
    "logistic", "sin", "cos", "tan", "atan", "sinh", "cosh", "asinh", "erf", "erfc", "dot_general",
    "reduce_sum", "cumsum", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "concatenate",
    "slice", "stack", "rev", "copy", "convert_element_type", "stop_gradient", "split", "pad",
    "cholesky", "custom_linear_solve", "triangular_solve",
})  # fmt: skip
# Of the package: smooth, although its arithmetic has steps.
_SMOOTH_FUNCTIONS = frozenset({"sincos"})


@functools.lru_cache(maxsize=256)
def may_have_kinks(layout: Layout) -> bool:
    """Whether the rates of state and integrals have an operation on the state that is not smooth everywhere.

    A part of the state whose rate is zero, such as a switch that resets change, is constant between two events.
    """
    if layout.options.smooth is not None:
        return not layout.options.smooth
    start = jax.eval_shape(lambda numbers: WholeMotion(layout, numbers).start(), layout.structs())

    def rate(elements: list[Any], numbers: list[Any]) -> Any:
        return WholeMotion(layout, numbers).rate(Augmented(tuple(elements), ()))

    jaxpr = jax.make_jaxpr(rate)(start, layout.structs()).jaxpr
    made_by = {made: equation for equation in jaxpr.eqns for made in equation.outvars}
    varies = [not _is_always_zero(value, made_by) for value in jaxpr.outvars[: len(start)]]
    return _is_rough(jaxpr, varies + [False] * (len(jaxpr.invars) - len(start)))


def _is_always_zero(value: Atom, made_by: Mapping[Var, Equation]) -> bool:
    """Whether a value is zero by its arithmetic: 0, or 0 times anything."""
    if isinstance(value, Literal):
        return bool(np.all(value.val == 0))
    equation = made_by.get(value)
    if equation is None or equation.primitive.name not in ("mul", "neg", "convert_element_type", "copy"):
        return False
    return any(_is_always_zero(atom, made_by) for atom in equation.invars)


def _is_rough(jaxpr: Jaxpr, varies: list[bool]) -> bool:
    """Whether an operation on the arguments that vary is not smooth."""
    varying = {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves}
    pivoted: set[Atom] = set()  # jumps where rows are exchanged; a solution of the system does not
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom in varying for atom in equation.invars]
        if not any(moves):
            continue
        varying |= set(equation.outvars)
        if equation.primitive.name == "lu":
            pivoted |= set(equation.outvars)
            continue
        if equation.primitive.name != "custom_linear_solve" and not pivoted.isdisjoint(
            atom for atom in equation.invars if not isinstance(atom, Literal)
        ):
            return True
        if not all(np.issubdtype(getattr(made.aval, "dtype", float), np.floating) for made in equation.outvars):
            return True  # whole numbers and truths jump
        if equation.params.get("name") in _SMOOTH_FUNCTIONS or equation.primitive.name in _SMOOTH:
            continue
        if equation.primitive.name == "select_n" and not moves[0]:
            continue  # the same case all the way
        inner = list(_inner(equation.params))
        # A loop or a branch chooses by the state: only plain calls are looked into.
        if len(inner) != 1 or len(inner[0].invars) != len(moves) or equation.primitive.name in ("while", "scan"):
            return True
        if _is_rough(inner[0], moves):
            return True
    return not pivoted.isdisjoint(atom for atom in jaxpr.outvars if not isinstance(atom, Literal))


def _inner(parameters: dict[str, Any]) -> Iterator[Jaxpr]:
    """The functions that an operation calls."""
    for value in parameters.values():
        for part in value if isinstance(value, (tuple, list)) else (value,):
            if hasattr(part, "eqns"):
                yield getattr(part, "jaxpr", part)
