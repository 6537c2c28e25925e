"""Events and resets that take the running integrals, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode

# y falls as y0 exp(-k t), so that its integral is a at t = -ln(1 - a k/y0)/k.
DECAY = ode.Problem(
    lambda args: {"y": args["y0"]},
    lambda t, y, args: {"y": -args["k"] * y["y"]},
    {"full": ode.Event(lambda t, y, args, integrals: integrals["area"] - args["a"], 1)},
    {"area": lambda t, y, args: y["y"]},
)
ARGS = {"y0": 2.0, "k": np.linspace(0.1, 0.9, 9), "a": 1.2}


def time_of(k, a=1.2, y0=2.0):
    return -jnp.log(1 - a * k / y0) / k


def of_lanes(function, k=ARGS["k"], a=1.2):
    """A function of k and a, its gradient and its Hessian at the k of each lane."""
    every = lambda k, a: (function(k, a), jax.grad(function, (0, 1))(k, a), jax.hessian(function, (0, 1))(k, a))  # noqa: E731
    return jax.jit(jax.vmap(every, (0, None)))(k, a)


@pytest.mark.parametrize("method", ["explicit", "rosenbrock", "auto"])
@pytest.mark.parametrize("direction", [1, 0])
def test_an_event_where_an_integral_reaches_a_value(method: str, direction: int) -> None:
    event = ode.Event(DECAY.events["full"].function, direction)
    problem = ode.Problem(DECAY.y0, DECAY.vector_field, {"full": event}, DECAY.integrals)
    end = ode.solve(problem, ARGS, t1=50.0, wrt=("k", "a"), method=method)
    assert set(end.ended_by) == {"full"}
    np.testing.assert_allclose(end.t, time_of(ARGS["k"]), rtol=1e-8)
    np.testing.assert_allclose(end.integrals["area"], 1.2, rtol=1e-9)
    by_k, by_a = of_lanes(time_of)[1]
    np.testing.assert_allclose(end.along("k").t, by_k, rtol=1e-7)
    np.testing.assert_allclose(end.along("a").t, by_a, rtol=1e-7)
    np.testing.assert_allclose(end.along("k").integrals["area"], 0, atol=1e-9)


def test_second_derivatives_and_gradients() -> None:
    end = ode.solve(DECAY, ARGS, t1=50.0, wrt=("k", "a"), derivatives=2)
    _, slopes, curves = of_lanes(time_of)
    for i, j in ((0, 0), (0, 1), (1, 1)):
        np.testing.assert_allclose(end.along("ka"[i], "ka"[j]).t, curves[i][j], rtol=1e-7)
    found = ode.solve(DECAY, ARGS, t1=50.0, gradient=True).gradient(t=1.0)
    np.testing.assert_allclose(found["k"], slopes[0], rtol=1e-7)
    in_jax = jax.grad(lambda k: jnp.sum(ode.solve(DECAY, {**ARGS, "k": k}, t1=50.0).t))
    np.testing.assert_allclose(jax.jit(in_jax)(ARGS["k"]), slopes[0], rtol=1e-7)


@pytest.mark.parametrize("method", ["explicit", "rosenbrock"])
def test_doses_each_time_that_the_area_has_grown_by_as_much(method: str) -> None:
    """A reset takes the integrals, too: it sets the next area, and a dose of half the area so far."""

    def dosed(t, y, args, integrals):
        return {"y": y["y"] + 0.5 * integrals["area"], "next": integrals["area"] + args["a"]}

    problem = ode.Problem(
        lambda args: {"y": args["y0"], "next": args["a"]},
        lambda t, y, args: {"y": -args["k"] * y["y"], "next": 0.0},
        {"dose": ode.Event(lambda t, y, args, integrals: integrals["area"] - y["next"], 1, dosed)},
        {"area": lambda t, y, args: y["y"]},
    )

    def third(k, a=1.2):
        t, y = 0.0, 2.0
        for n in (1, 2, 3):
            t, y = t + time_of(k, a, y), y - k * a + 0.5 * n * a
        return t

    end = ode.solve(problem, ARGS, t1=100.0, wrt=("k", "a"), max_events=3, method=method)
    np.testing.assert_array_equal(end.count, 3)
    exact, (by_k, by_a), _ = of_lanes(third)
    np.testing.assert_allclose(end.t, exact, rtol=1e-8)
    np.testing.assert_allclose(end.along("k").t, by_k, rtol=1e-6)
    np.testing.assert_allclose(end.along("a").t, by_a, rtol=1e-6)
    np.testing.assert_allclose(end.events.t[:, 0], time_of(ARGS["k"]), rtol=1e-8)


def test_an_event_function_that_jumps_where_an_integral_reaches_a_value() -> None:
    jumping = ode.Event(lambda t, y, args, integrals: jnp.where(integrals["area"] < args["a"], 1.0 + y["y"], -1.0), -1)
    problem = ode.Problem(DECAY.y0, DECAY.vector_field, {"full": jumping}, DECAY.integrals)
    end = ode.solve(problem, ARGS, t1=50.0, wrt="k")
    assert set(end.ended_by) == {"full"}
    np.testing.assert_allclose(end.t, time_of(ARGS["k"]), rtol=1e-8)
    np.testing.assert_allclose(end.along("k").t, of_lanes(time_of)[1][0], rtol=1e-7)


def test_integrals_that_do_not_begin_at_zero_and_back_in_time() -> None:
    begun = ode.Problem(
        DECAY.y0, DECAY.vector_field, DECAY.events, DECAY.integrals, integrals0=lambda args: {"area": 0.5 * args["k"]}
    )
    end = ode.solve(begun, ARGS, t1=50.0)
    np.testing.assert_allclose(end.t, time_of(ARGS["k"], 1.2 - 0.5 * ARGS["k"]), rtol=1e-8)
    fallen = ode.Event(lambda t, y, args, integrals: integrals["area"] + args["a"], -1)
    back = ode.Problem(DECAY.y0, DECAY.vector_field, {"full": fallen}, DECAY.integrals)
    end = ode.solve(back, ARGS, t1=-50.0, wrt="k")
    np.testing.assert_allclose(end.t, time_of(ARGS["k"], -1.2), rtol=1e-8)
    np.testing.assert_allclose(end.along("k").t, of_lanes(time_of, a=-1.2)[1][0], rtol=1e-7)


@pytest.mark.parametrize("name", ["function", "reset"])
def test_a_fourth_argument_of_another_name_is_refused(name: str) -> None:
    with pytest.raises(TypeError, match=rf"`{name}`.*`integrals`.*`known`"):
        ode.Event(**{"function": lambda t, y, args: y, name: lambda t, y, args, known: y})


def test_functions_that_take_integrals_that_are_not_there() -> None:
    with pytest.raises(ValueError, match=r"`integrals`.*'full'"):
        ode.Problem(DECAY.y0, DECAY.vector_field, DECAY.events)
    wrong = ode.Event(lambda t, y, args, integrals: integrals["volume"] - 1.0)
    problem = ode.Problem(DECAY.y0, DECAY.vector_field, {"full": wrong}, DECAY.integrals)
    with pytest.raises(ValueError, match="volume"):
        ode.solve(problem, ARGS, t1=1.0)
