"""Derivatives carried along, on a motion whose state, end and integral are polynomials."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion.ode.motion import Augmented
from erosion.ode.problem import Event, Problem
from erosion.ode.reduction import WholeMotion
from erosion.ode.step_control import ARRIVED
from erosion.ode.variational import AlongFlow, Derivatives, Variational, at_event
from tests.ode.problems import lanes_of

ARGS = {"b": 0.5, "drift": 1.0, "k": 2.0, "v0": 3.0}
NAMES = list(ARGS)  # sorted, as JAX sorts the keys of a dictionary
V0, K, B = ARGS["v0"], ARGS["k"], ARGS["b"]
REBOUND, SLOW = 0, 1
FREE = Derivatives(None, None, None, None)

# Depth v₀ t - k t²/2. It ends at 2 v₀/k, or at 3 v₀/2k, when its speed is -v₀/2; the integral goes with `drift`.
THROWN = Problem(
    lambda args: {"y": 0.0, "vy": args["v0"]},
    lambda t, y, args: {"y": y["vy"], "vy": -args["k"]},
    {
        "rebound": Event(lambda t, y, args: y["y"], -1),
        "slow": Event(lambda t, y, args: y["vy"] + args["v0"] / 2, -1),
    },
    {"volume": lambda t, y, args: args["b"] * args["drift"] * y["y"]},
)


def depth(t: Any, v0: Any, k: Any) -> Any:
    return v0 * t - k * t**2 / 2


def state(t: Any, v0: Any, k: Any) -> Augmented:
    """The state at a time; the integral is b ∫ depth dt. Leaves of a state are sorted by name: vy, y."""
    return Augmented((v0 - k * t, depth(t, v0, k)), (B * (v0 * t**2 / 2 - k * t**3 / 6),))


def end(which: int, v0: Any, k: Any) -> tuple[Any, Any]:
    time = (2.0 if which == REBOUND else 1.5) * v0 / k
    return time, state(time, v0, k).integrals[0]


def equations(order: int, *names: str) -> Variational:
    signature, parameters = lanes_of(THROWN, ARGS)
    return Variational(
        signature, parameters, order, tuple(map(NAMES.index, names)), functools.partial(WholeMotion, signature)
    )


def volume_at_event(lifted: Variational, members: tuple[Augmented, ...], which: int, time: Any, time_to_end=FREE):
    """What happens at an event, with the integral alone."""
    result = at_event(
        AlongFlow(lifted, members), jnp.asarray(which), time, lambda at, motion: motion.outputs(at), time_to_end
    )
    return result._replace(outputs=Derivatives(*(part and part[0] for part in result.outputs)))


def derivatives(function: Any, *names: str) -> Derivatives:
    """Of a function of v₀ and k, by their relative changes along one or two of them."""

    def along(function: Any, name: str) -> Any:
        unit = {one: np.float64(one == name) for one in ("v0", "k")}
        return lambda steps: jax.jvp(function, (steps,), (unit,))[1]

    def scaled(steps: Any) -> Any:
        return function(V0 * (1 + steps["v0"]), K * (1 + steps["k"]))

    zero = {"v0": np.zeros(()), "k": np.zeros(())}
    first, other = along(scaled, names[0]), along(scaled, names[-1])
    return Derivatives(*jax.jit(lambda at: (scaled(at), first(at), other(at), along(first, names[-1])(at)))(zero))


def members(order: int, all_four: Derivatives, names: tuple[str, ...]) -> tuple[Any, ...]:
    """The state that is integrated."""
    return tuple(all_four) if len(names) == 2 else (all_four.value, all_four.by_first, all_four.mixed)[: order + 1]


CASES = [(0, ("v0",)), (1, ("v0",)), (1, ("k",)), (2, ("k",)), (2, ("v0", "k"))]


@pytest.mark.parametrize(("order", "names"), CASES)
def test_the_rate_of_a_state_with_derivatives_is_that_of_the_closed_form(order: int, names: tuple[str, ...]) -> None:
    lifted = equations(order, *names)
    for time in (0.0, 0.8):
        at = members(order, derivatives(lambda v0, k, t=time: state(t, v0, k), *names), names)
        rate = derivatives(lambda v0, k, t=time: jax.jvp(lambda t: state(t, v0, k), (t,), (1.0,))[1], *names)
        rates = jax.tree.leaves(members(order, rate, names))
        assert np.allclose(jax.tree.leaves(lifted.rate(at)), rates, rtol=1e-14)
        if time == 0:
            assert np.allclose(jax.tree.leaves(lifted.initial()), jax.tree.leaves(at), rtol=1e-14)


@pytest.mark.parametrize("which", [REBOUND, SLOW])
@pytest.mark.parametrize(("order", "names"), CASES)
def test_the_end_moves_with_the_parameters(order: int, names: tuple[str, ...], which: int) -> None:
    """Of both events: where the integral's rate is zero, and where it is not."""
    time, _ = end(which, V0, K)
    # The state at a fixed time, and how it depends on the parameters there.
    at = members(order, derivatives(lambda v0, k: state(time, v0, k), *names), names)
    result = volume_at_event(equations(order, *names), at, which, time)
    for i, quantity in enumerate((result.time, result.outputs)):
        exact = derivatives(lambda v0, k, i=i: end(which, v0, k)[i], *names)
        known = [True, order > 0, order > 0, order > 1]
        assert [part is not None for part in quantity] == known
        for part, expected in zip(quantity, exact, strict=True):
            assert part is None or part == pytest.approx(float(expected), rel=1e-13)


def test_the_mixed_derivative_by_parameters_is_the_closed_form() -> None:
    """V = (2/3) b v₀³/k², so that ∂²V/∂v₀∂k = -4 b v₀²/k³."""
    lifted = equations(2, "v0", "k")
    time, volume = end(REBOUND, V0, K)
    at = derivatives(lambda v0, k: state(time, v0, k), "v0", "k")
    slopes = lifted.unscale(volume_at_event(lifted, tuple(at), REBOUND, time).outputs)
    assert volume == pytest.approx(2 / 3 * B * V0**3 / K**2)
    assert slopes.by_first == pytest.approx(3 * volume / V0)
    assert slopes.by_second == pytest.approx(-2 * volume / K)
    assert slopes.mixed == pytest.approx(-4 * B * V0**2 / K**3)


@pytest.mark.parametrize(("which", "amplification"), [(REBOUND, 2.0), (SLOW, 1.0)])
def test_errors_of_a_slow_fall_are_amplified(which: int, amplification: float) -> None:
    """By g̈ t/ġ: k·(2 v₀/k)/v₀ for the depth, which falls with speed v₀; a straight function keeps its slope."""
    time, _ = end(which, V0, K)
    result = volume_at_event(equations(0), (state(time, V0, K),), which, time)
    assert result.amplification == pytest.approx(amplification)


def test_an_end_by_no_event_has_a_time_that_does_not_move() -> None:
    at = derivatives(lambda v0, k: state(0.8, v0, k), "v0")
    result = volume_at_event(equations(1, "v0"), (at.value, at.by_first), ARRIVED, 0.8)
    assert (result.time.value, result.time.by_first) == (0.8, 0)
    assert result.outputs.by_first == at.by_first.integrals[0]


def test_a_time_that_is_given_moves_as_it_is_said_to() -> None:
    at = derivatives(lambda v0, k: state(0.8, v0, k), "v0")
    time_to_end = Derivatives(0.8, 0.1, 0.1, None)
    result = volume_at_event(equations(1, "v0"), (at.value, at.by_first), ARRIVED, 0.8, time_to_end)
    assert result.time.by_first == 0.1
    assert result.outputs.by_first == pytest.approx(at.by_first.integrals[0] + 0.1 * B * depth(0.8, V0, K))
    # An event's own time goes before it.
    time, _ = end(SLOW, V0, K)
    at = derivatives(lambda v0, k: state(time, v0, k), "v0")
    assert volume_at_event(
        equations(1, "v0"), (at.value, at.by_first), SLOW, time, time_to_end
    ).time.by_first == pytest.approx(time)


def test_a_place_is_a_number_or_part_of_the_program() -> None:
    signature, parameters = lanes_of(THROWN, ARGS)
    of_motion = functools.partial(WholeMotion, signature)

    def along(place: Any) -> Variational:
        return Variational(signature, parameters, 1, (place,), of_motion)

    at = (state(0.8, V0, K), Augmented((0.0, 0.0), (0.0,)))
    for place in range(len(NAMES)):
        for of in (lambda lifted: lifted.initial(), lambda lifted: lifted.rate(at)):
            fixed, traced = (jax.tree.leaves(of(along(one))) for one in (place, jnp.asarray(place)))
            assert np.array_equal(fixed, traced)
    # The integral is in proportion to `drift`.
    own = along(NAMES.index("drift")).rate(at)
    assert own[1].integrals[0] == pytest.approx(B * depth(0.8, V0, K))


def test_an_element_of_an_array_is_a_direction() -> None:
    start = Problem(lambda args: args, lambda t, y, args: y)
    signature, parameters = lanes_of(start, {"a": 2.0, "b": np.array([3.0, 5.0])})
    for place, unit in enumerate([2.0, 3.0, 5.0]):
        for one in (place, jnp.asarray(place)):
            _, first = Variational(
                signature, parameters, 1, (one,), functools.partial(WholeMotion, signature)
            ).initial()
            assert [float(part) for part in first.state] == [unit if i == place else 0 for i in range(3)]


@pytest.mark.parametrize(("size", "unit"), [(0.3, 0.3), (-0.3, 0.3), (0.0, 1.0)])
def test_a_step_is_as_large_as_its_number(size: float, unit: float) -> None:
    start = Problem(lambda args: args, lambda t, y, args: y)
    signature, parameters = lanes_of(start, {"a": 7.0, "b": size})
    _, first = Variational(signature, parameters, 1, (1,), functools.partial(WholeMotion, signature)).initial()
    assert [float(part) for part in first.state] == [0, unit]


def test_a_problem_may_say_what_change_is_typical() -> None:
    start = Problem(
        lambda args: args, lambda t, y, args: y, parameter_scale=lambda args: {"a": 1.0, "b": args["a"] / 2}
    )
    signature, parameters = lanes_of(start, {"a": 7.0, "b": 0.0})
    for place, unit in enumerate([1.0, 3.5]):
        _, first = Variational(signature, parameters, 1, (place,), functools.partial(WholeMotion, signature)).initial()
        assert [float(part) for part in first.state] == [unit if i == place else 0 for i in range(2)]
