"""Where a motion is not smooth: whether its arithmetic may have kinks, and what to do at one.

Steps across a kink of a rate are so short that each rate has one of two values in them: that before the kink or
that after it. So kinks need not be known: they show themselves. A jump may be too small for that. But where a rate
jumps, a case of its arithmetic changes, and there both sides are compared.

The motion s' = f(s) has the derivatives s_a and s_b by two parameters; their rates are G_a and G_b. With [·] a change
across the kink:

- [f] ≠ 0: the rate jumps. Where it does depends on the parameters, so that even s_a jumps. Nothing says by how much,
  and the lane fails; see `erosion.ode.batch`, which then computes it without derivatives.
- [f] = 0: ḟ and G jump together, [G_a] = -τ_a [ḟ] with τ the time of the kink. Then s_ab jumps by [G_a] [G_b] / [ḟ].
  Where G jumps and ḟ does not, f jumps for other parameters, and nothing says by how much s_ab does.

Most motions have none, and their programs need not look for any.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from erosion.arguments import Flag, Scalar
from erosion.lanes.scalars import Atom
from erosion.ode.reduction import Rows, WholeMotion, elements_of, evaluate, known_values
from erosion.ode.switches import SwitchedMotion, is_always_zero, switches_of
from erosion.ode.variational import Augmented, Layout

_SHORT = 1e-2  # of the time scale: longer steps cross no kink that matters
_TWO_VALUED = 0.1  # of the change of a rate: so near one of both its ends are its values at the stages
_ABRUPT = 100.0  # times what a rate that changes within the time scale would: it jumps
_SMALL_JUMP = 1e-7  # of a size, within the time scale: by less a rate may jump, as between a function and its series
_HALVINGS, _CHANGES = 52, 8  # of a step, to find where a case changes; how many changes are looked at
_FAR = 1e6  # time scales: by more a kink's time cannot depend on a number by its own size
_MOMENT = 1e-8  # of the time scale: so soon before and after an event a smooth rate is the same
_OTHER = 1e-6  # of its size, and of what it does within the time scale: a rate so different has a kink


@runtime_checkable
class Flow(Protocol):
    """What is needed of the integrated equations.

    Args:
        width: number of rows of the motion itself, and of each derivative.
        rate: of all rows.
        motion_rate: of the rows of the motion itself.
        cases: of the rows of the motion itself, see `cases`.
    """

    width: int
    rate: Callable[[Rows], Rows]
    motion_rate: Callable[[Rows], Rows]
    cases: Callable[[Rows], list[Scalar]]


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
    known = known_values(jaxpr, {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves})
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom not in known for atom in equation.invars]
        inner = equation.params.get("jaxpr")
        if any(moves) and isinstance(inner, ClosedJaxpr) and equation.primitive.name in ("jit", "pjit"):
            parts += divisors(inner, evaluate(closed, list(equation.invars))(*operands), moves)
        elif equation.primitive.name == "div" and moves[1]:
            found.append(equation.invars[1])
        elif equation.primitive.name == "integer_pow" and moves[0] and equation.params["y"] < 0:
            found.append(equation.invars[0])
    return elements_of(evaluate(closed, found)(*operands)) + parts


def cases(closed: ClosedJaxpr, operands: Sequence[Scalar], varies: Sequence[bool]) -> list[Scalar]:
    """Truths, whole numbers and rounded numbers within a function: where it jumps, one of them changes."""
    jaxpr, found, parts = closed.jaxpr, [], []
    known = known_values(jaxpr, {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves})
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom not in known for atom in equation.invars]
        if not any(moves):
            continue
        name, inner = equation.primitive.name, equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        if isinstance(inner, ClosedJaxpr) and name in ("jit", "pjit", "custom_jvp_call"):
            parts += cases(inner, evaluate(closed, list(equation.invars))(*operands), moves)
        elif name == "rem":
            dividend, divisor = evaluate(closed, list(equation.invars))(*operands)
            parts += elements_of([jnp.trunc(dividend / divisor)])
        elif name in _STEPS:
            found += equation.outvars
        else:
            found += [
                made for made in equation.outvars if not np.issubdtype(getattr(made.aval, "dtype", float), np.floating)
            ]
    return elements_of(evaluate(closed, found)(*operands)) + parts


_STEPS = frozenset({"floor", "ceil", "round", "sign"})


def arguments(closed: ClosedJaxpr, operands: Sequence[Scalar], varies: Sequence[bool]) -> list[Scalar] | None:
    """Numbers of which one is zero wherever a function is not smooth; None where its arithmetic does not tell.

    Of a root, a power, a logarithm or |u| that is u, of a comparison the difference of what it compares.
    """
    jaxpr, found, parts = closed.jaxpr, [], []
    known = known_values(jaxpr, {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves})
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom not in known for atom in equation.invars]
        name = equation.primitive.name
        if not any(moves) or equation.params.get("name") in _SMOOTH_FUNCTIONS:
            continue
        inner = list(_inner(equation.params))
        types = [getattr(atom.aval, "dtype", np.dtype(float)) for atom in (*equation.invars, *equation.outvars)]
        real = [np.issubdtype(each, np.floating) for each in types]
        values = functools.partial(evaluate(closed, list(equation.invars)), *operands)
        if name == "select_n" or name in _LOGICAL:
            continue  # what chooses is a comparison, or made of some
        if name in _SMOOTH and name not in ("lu", "custom_linear_solve", "triangular_solve"):
            if name == "convert_element_type" and real[0] and not real[-1] and types[-1] != np.dtype(bool):
                return None
            continue
        if name in _SINGULAR and real[0]:
            found.append(equation.invars[0])
        elif name in _COMPARISONS and all(real[:2]):
            one, other = values()
            parts += elements_of([one - other])
        elif name == "clamp" and all(real):
            low, middle, high = values()
            parts += elements_of([middle - low, high - middle])
        elif name == "atan2":
            y, x = values()
            parts += elements_of([jnp.sqrt(x * x + y * y) + x])
        elif name in ("acos", "asin"):
            (x,) = values()
            parts += elements_of([1.0 - x, 1.0 + x])
        elif name == "cond":
            branches = equation.params["branches"]
            if any(is_nonsmooth(branch.jaxpr, moves[1:]) for branch in branches):
                return None
        elif name in ("jit", "pjit", "custom_jvp_call") and len(inner) == 1:
            called = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
            more = arguments(called, values(), moves)
            if more is None:
                return None
            parts += more
        else:
            return None
    return elements_of(evaluate(closed, found)(*operands)) + parts


_SINGULAR = frozenset({"sqrt", "rsqrt", "cbrt", "log", "pow", "abs", "sign"})
_COMPARISONS = frozenset({"max", "min", "lt", "le", "gt", "ge", "eq", "ne"})
_LOGICAL = frozenset({"and", "or", "not", "xor", "reduce_and", "reduce_or", "is_finite"})
_NEAR = 1.0  # of what a number changes by within a step: if it is nearer to zero, it may be zero there


def comes_near(samples: Sequence[Sequence[Scalar]]) -> Flag:
    """Whether one of the `arguments`, sampled within a step, may come to zero there."""
    near: Flag = jnp.asarray(False)
    for values in zip(*samples, strict=True):
        low, high = functools.reduce(jnp.minimum, values), functools.reduce(jnp.maximum, values)
        near = near | ~(jnp.maximum(low, -high) > _NEAR * (high - low))
    return near


def breaks(
    problem: Flow, before: tuple[Rows, Rows], after: tuple[Rows, Rows], h: Scalar, scale: Scalar, start: Scalar
) -> Flag:
    """Whether a rate of the motion itself jumps where a case changes within a step, by however little.

    A kink is none: there the rates of both cases are the same. But where a rate of a derivative jumps without one of
    the motion, the place of the jump is not known by `corrected`.

    Args:
        problem: the equations.
        before: state and slope where the step begins.
        after: the same at its end.
        h: its length.
        scale: the time scale.
        start: the share of the step in which the lane begins; a rate may jump there.
    """
    width, (rows, slopes), (ends, end_slopes) = problem.width, before, after

    def at(share: Scalar) -> Rows:
        a, b = share * share * (3 - 2 * share), share * (1 - share)
        cubic = zip(rows, slopes, ends, end_slopes, strict=True)
        return [u + a * (v - u) + h * b * ((1 - share) * k - share * m) for u, k, v, m in cubic]

    def differ(one: Rows, other: Rows) -> Flag:
        pairs = zip(problem.cases(one[:width]), problem.cases(other[:width]), strict=True)
        return functools.reduce(jnp.logical_or, (a != b for a, b in pairs), jnp.asarray(False))

    def jumps(low: Scalar, high: Scalar) -> Flag:
        one, other = at(low), at(high)
        old, new = problem.rate(one), problem.rate(other)
        changes = [scale * jnp.abs(k - m) for k, m in zip(old, new, strict=True)]
        bends = [jnp.abs(k - m) for k, m in zip(_bend(problem, one, old), _bend(problem, other, new), strict=True)]
        broken: Flag = jnp.asarray(False)
        for row in range(width):
            fast = scale * jnp.maximum(jnp.abs(slopes[row]), jnp.abs(end_slopes[row]))
            least = _SMALL_JUMP * jnp.maximum(jnp.maximum(jnp.abs(rows[row]), jnp.abs(ends[row])), fast)
            broken = broken | (changes[row] > least)
            # [G] = -τ' [ḟ], see above, for second derivatives.
            for change in changes[width + row : -width : width]:
                broken = broken | ((change > least) & (change > _FAR * scale * scale * bends[row]))
        return broken

    def next_change(search: tuple[Scalar, Flag, Scalar]) -> tuple[Scalar, Flag, Scalar]:
        low, _, count = search
        one = at(low)

        def halve(_: Scalar, pair: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = pair
            middle = (low + high) / 2
            is_other = differ(one, at(middle))
            return jnp.where(is_other, low, middle), jnp.where(is_other, middle, high)

        low, high = lax.fori_loop(0, _HALVINGS, halve, (low, 0.0 * low + 1.0))
        return high, jumps(low, high) & (high > start), count + 1

    def goes_on(search: tuple[Scalar, Flag, Scalar]) -> Flag:
        low, broken, count = search
        return jnp.logical_and(differ(at(low), ends) & ~broken, count < _CHANGES)

    zero = 0.0 * h
    return lax.while_loop(goes_on, next_change, (zero, jnp.asarray(False), zero))[1]


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
        passed = jnp.where(jnp.abs(passed) < _FAR * scale, passed, 0.0)  # at a start, see `breaks`
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
_SMOOTH_FUNCTIONS = frozenset({"sincos", "between"})


@functools.lru_cache(maxsize=256)
def may_have_kinks(layout: Layout) -> bool:
    """Whether the rates of state and integrals have an operation on the state that is not smooth everywhere.

    A part of the state whose rate is zero, such as a switch that resets change, is constant between two events.
    """
    if layout.options.smooth is not None:
        return not layout.options.smooth
    switches = switches_of(layout)
    whole = WholeMotion if switches is None else functools.partial(SwitchedMotion, switches)
    start = jax.eval_shape(lambda numbers: whole(layout, numbers).start(), layout.structs())

    def rate(elements: list[Any], numbers: list[Any]) -> Any:
        return whole(layout, numbers).rate(Augmented(tuple(elements), ()))

    jaxpr = jax.make_jaxpr(rate)(start, layout.structs()).jaxpr
    made_by = {made: equation for equation in jaxpr.eqns for made in equation.outvars}
    varies = [not is_always_zero(value, made_by) for value in jaxpr.outvars[: len(start)]]
    return is_nonsmooth(jaxpr, varies + [False] * (len(jaxpr.invars) - len(start)))


def is_nonsmooth(jaxpr: Jaxpr, varies: list[bool]) -> bool:
    """Whether an operation on the arguments that vary is not smooth."""
    varying = {variable for variable, moves in zip(jaxpr.invars, varies, strict=True) if moves}
    pivoted: set[Atom] = set()  # jumps where rows are exchanged; a solution of the system does not
    for equation in jaxpr.eqns:
        moves = [not isinstance(atom, Literal) and atom in varying for atom in equation.invars]
        if not any(moves):
            continue
        if equation.primitive.name in ("eq", "ne"):
            continue  # it holds, or not, all the way
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
        if is_nonsmooth(inner[0], moves):
            return True
    return not pivoted.isdisjoint(atom for atom in jaxpr.outvars if not isinstance(atom, Literal))


def _inner(parameters: dict[str, Any]) -> Iterator[Jaxpr]:
    """The functions that an operation calls."""
    for value in parameters.values():
        for part in value if isinstance(value, (tuple, list)) else (value,):
            if hasattr(part, "eqns"):
                yield getattr(part, "jaxpr", part)
