"""Derivatives carried along, on a motion whose state, end and volume are polynomials."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.engine.leaves import split
from erosion.engine.reduction import WholeMotion
from erosion.engine.variational import Cut, Derivatives, Variational, at_event
from erosion.models.base import CuttingModel, Tip
from erosion.parameters.parameters import QUANTITIES

P = erosion.TABLE_1.replace(v0=3.0, k=2.0, b=0.5)
REBOUND, SLOW = 0, 1


class Thrown(CuttingModel):
    """Depth v₀ t - k t²/2. It ends at 2 v₀/k, or at 3 v₀/2k, when its speed is -v₀/2; the volume goes with `drift`."""

    drift: Any = 1.0

    def initial_state(self, p):
        return {"y": 0.0 * p.v0, "vy": p.v0}

    def derivative(self, state, p):
        return {"y": state["vy"], "vy": -p.k + 0.0 * state["y"]}

    def tip(self, state, p):
        return Tip(jnp.zeros(()), state["y"], self.drift, state["vy"])

    def events(self, state, p):
        return {"rebound": state["y"], "slow": state["vy"] + p.v0 / 2}


def depth(t: Any, v0: Any, k: Any) -> Any:
    return v0 * t - k * t**2 / 2


def cut(t: Any, v0: Any, k: Any) -> Cut:
    """The state at a time; the volume is b ∫ depth dt. Leaves of a state are sorted by name: vy, y."""
    return Cut((v0 - k * t, depth(t, v0, k)), P.b * (v0 * t**2 / 2 - k * t**3 / 6))


def end(which: int, v0: Any, k: Any) -> tuple[Any, Any]:
    time = (2.0 if which == REBOUND else 1.5) * v0 / k
    return time, cut(time, v0, k).volume


def equations(order: int, directions: tuple[Any, ...], p: Any = P) -> Variational:
    layout, numbers = split(Thrown(), p)
    return Variational(layout, numbers, order, directions, WholeMotion)


def derivatives(function: Any, *names: str) -> Derivatives:
    """Of a function of v₀ and k, by their relative changes along one or two of them."""

    def along(function: Any, name: str) -> Any:
        unit = {one: np.float64(one == name) for one in ("v0", "k")}
        return lambda steps: jax.jvp(function, (steps,), (unit,))[1]

    def scaled(steps: Any) -> Any:
        return function(P.v0 * (1 + steps["v0"]), P.k * (1 + steps["k"]))

    zero = {"v0": np.zeros(()), "k": np.zeros(())}
    first, other = along(scaled, names[0]), along(scaled, names[-1])
    return Derivatives(scaled(zero), first(zero), other(zero), along(first, names[-1])(zero))


def members(order: int, all_four: Derivatives, names: tuple[str, ...]) -> tuple[Any, ...]:
    """The state that is integrated."""
    return tuple(all_four) if len(names) == 2 else (all_four.value, all_four.first, all_four.second)[: order + 1]


CASES = [(0, ("v0",)), (1, ("v0",)), (1, ("k",)), (2, ("k",)), (2, ("v0", "k"))]


@pytest.mark.parametrize(("order", "names"), CASES)
def test_the_rate_of_a_state_with_derivatives_is_that_of_the_closed_form(order: int, names: tuple[str, ...]) -> None:
    lifted = equations(order, names)
    for time in (0.0, 0.8):
        state = members(order, derivatives(lambda v0, k, t=time: cut(t, v0, k), *names), names)
        rate = derivatives(lambda v0, k, t=time: jax.jvp(lambda t: cut(t, v0, k), (t,), (1.0,))[1], *names)
        rates = jax.tree.leaves(members(order, rate, names))
        assert np.allclose(jax.tree.leaves(lifted.rate(state)), rates, rtol=1e-14)
        if time == 0:
            assert np.allclose(jax.tree.leaves(lifted.initial()), jax.tree.leaves(state), rtol=1e-14)


@pytest.mark.parametrize("which", [REBOUND, SLOW])
@pytest.mark.parametrize(("order", "names"), CASES)
def test_the_end_moves_with_the_parameters(order: int, names: tuple[str, ...], which: int) -> None:
    """Of both events: where the removal rate is zero, and where it is not."""
    time, _ = end(which, P.v0, P.k)
    # The state at a fixed time, and how it depends on the parameters there.
    state = members(order, derivatives(lambda v0, k: cut(time, v0, k), *names), names)
    result = at_event(equations(order, names), state, jnp.asarray(which), time)
    for i, quantity in enumerate((result.time, result.volume)):
        exact = derivatives(lambda v0, k, i=i: end(which, v0, k)[i], *names)
        known = [True, order > 0, order > 0, order > 1]
        assert [part is not None for part in quantity] == known
        for part, expected in zip(quantity, exact, strict=True):
            assert part is None or part == pytest.approx(float(expected), rel=1e-13)


def test_the_mixed_derivative_by_parameters_is_the_closed_form() -> None:
    """V = (2/3) b v₀³/k², so that ∂²V/∂v₀∂k = -4 b v₀²/k³."""
    lifted = equations(2, ("v0", "k"))
    time, volume = end(REBOUND, P.v0, P.k)
    state = derivatives(lambda v0, k: cut(time, v0, k), "v0", "k")
    slopes = lifted.per_unit(at_event(lifted, tuple(state), jnp.asarray(REBOUND), time).volume)
    assert volume == pytest.approx(2 / 3 * P.b * P.v0**3 / P.k**2)
    assert slopes.first == pytest.approx(3 * volume / P.v0)
    assert slopes.other == pytest.approx(-2 * volume / P.k)
    assert slopes.second == pytest.approx(-4 * P.b * P.v0**2 / P.k**3)


@pytest.mark.parametrize(("which", "amplification"), [(REBOUND, 2.0), (SLOW, 1.0)])
def test_errors_of_a_slow_fall_are_amplified(which: int, amplification: float) -> None:
    """By g̈ t/ġ: k·(2 v₀/k)/v₀ for the depth, which falls with speed v₀; a straight function keeps its slope."""
    time, _ = end(which, P.v0, P.k)
    result = at_event(equations(0, ()), (cut(time, P.v0, P.k),), jnp.asarray(which), time)
    assert result.amplification == pytest.approx(amplification)


def test_an_end_by_no_event_has_a_time_that_does_not_move() -> None:
    state = derivatives(lambda v0, k: cut(0.8, v0, k), "v0")
    result = at_event(equations(1, ("v0",)), (state.value, state.first), jnp.asarray(-2), 0.8)
    assert (result.time.value, result.time.first) == (0.8, 0)
    assert result.volume.first == state.first.volume


def test_a_place_among_all_numbers_is_a_direction_as_its_name_is() -> None:
    for name in ("v0", "k", "alpha"):
        by_name, by_place = (
            jax.tree.leaves(equations(1, (one,)).initial()) for one in (name, jnp.asarray(list(QUANTITIES).index(name)))
        )
        assert np.array_equal(by_name, by_place)
    # `drift` follows the parameters of the case: the volume is in proportion to it.
    state = (cut(0.8, P.v0, P.k), Cut((0.0, 0.0), 0.0))
    own = equations(1, (jnp.asarray(len(QUANTITIES)),)).rate(state)
    assert own[1].volume == pytest.approx(P.b * depth(0.8, P.v0, P.k))


class Start(Thrown):
    """A state that shows its parameters."""

    def initial_state(self, p):
        return {"alpha": p.alpha, "phidot0": p.phidot0, "psi": p.psi}


@pytest.mark.parametrize(
    ("name", "changes", "unit"),
    [
        ("alpha", {}, 1.0),
        ("phidot0", {"phidot0": 7.0}, P.v0 / P.r),
        ("phidot0", {}, P.v0 / P.r),
        ("psi", {"psi": 0.3}, 0.3),
        ("psi", {"psi": 0.0}, 1.0),
    ],
)
def test_steps_are_of_a_size_that_matters(name: str, changes: dict[str, float], unit: float) -> None:
    """1 rad, the spin v₀/r, or the parameter's own size; of nothing, one."""
    layout, numbers = split(Start(), P.replace(**changes))
    _, first = Variational(layout, numbers, 1, (name,), WholeMotion).initial()
    place = ["alpha", "phidot0", "psi"].index(name)
    assert [float(one) for one in first.state] == [float(unit) if i == place else 0 for i in range(3)]
