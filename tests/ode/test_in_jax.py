"""`ode.solve` within JAX's transformations."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from erosion import ode
from tests.ode.problems import alike

# y = h + v t - g t²/2 falls to zero at t = (v + √(v² + 2 g h))/g.
BALL = ode.Problem(
    lambda args: {"y": args["h"], "v": args["v"]},
    lambda t, y, args: {"y": y["v"], "v": -args["g"]},
    {"ground": ode.Event(lambda t, y, args: y["y"], -1), "roof": ode.Event(lambda t, y, args: y["y"] - 4, 1)},
    {"path": lambda t, y, args: y["v"]},
)
BOUNCES = ode.Problem(
    BALL.y0,
    BALL.vector_field,
    {"floor": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -args["e"] * y["v"]})},
)
ARGS = {"g": 9.81, "h": 1.5, "v": 2.0}


def lands(args: Any) -> Any:
    """The time at which the ball lands, in closed form."""
    return (args["v"] + jnp.sqrt(args["v"] ** 2 + 2 * args["g"] * args["h"])) / args["g"]


def end_of(args: Any) -> Any:
    """The time at which the ball lands."""
    return ode.solve(BALL, args, t1=10.0).t


def close(one: Any, other: Any, rtol: float = 1e-8) -> None:
    alike(one, other, rtol, atol=1e-9)


def everything(end: ode.Solution) -> Any:
    return end.t, end.y, end.integrals, end.outcome, end.count, end.at_once


def test_jit_gives_the_same_bits():
    args = ARGS | {"h": np.linspace(0.5, 3, 5), "v": np.array([[0.0], [5.0]])}
    outside = ode.solve(BALL, args, t1=0.6)
    inside = jax.jit(lambda args: everything(ode.solve(BALL, args, t1=0.6)))(args)
    assert inside[0].shape == (2, 5)
    assert {"ground", "roof", "t1"} == set(outside.ended_by.ravel())
    alike(everything(outside), inside)


def test_the_state_at_a_traced_time_before_the_start_is_nan():
    """JAX does not know which times are before t0 while it traces."""
    t0 = np.array([0.0, 0.2, np.nan])
    early, fine = [0.3, 0.1], [0.3, 0.2, np.nan]
    for ts in (early, fine):
        ys = jax.jit(lambda ts: ode.solve(BALL, ARGS, t0=t0, t1=10.0, ts=ts).ys)(jnp.array(ts))
        np.testing.assert_array_equal(np.isnan(ys["y"][:, :2]), [[False] * 2, [False, ts is early], [True] * 2])
    close(ode.solve(BALL, ARGS, t0=t0, t1=10.0, ts=fine).ys, ys)
    square = ARGS | {"h": np.array([[1.0, 2.0], [3.0, 1.5]])}
    slopes = jax.jit(jax.jacfwd(lambda ts: ode.solve(BALL, square, t1=10.0, ts=ts).ys["y"]))(jnp.array([0.1, 0.2]))
    close(slopes, np.broadcast_to(np.diag([2.0 - 0.981, 2.0 - 1.962]), (2, 2, 2, 2)))


def test_solution_in_jit_tells_outcome_and_end():
    def code(h):
        end = ode.solve(BALL, ARGS | {"h": h}, t1=0.6)
        return end.outcome, end.at_once["roof"]

    heights = jnp.array([0.2, 1.5, 3.9])
    outcome, roof = jax.vmap(code)(heights)
    outside = ode.solve(BALL, ARGS | {"h": np.asarray(heights)}, t1=0.6)
    assert [outside.names[i] for i in outcome] == list(outside.ended_by) == ["ground", "t1", "roof"]
    np.testing.assert_array_equal(roof, [False, False, True])


def test_vmap_nested_vmap_and_their_derivatives():
    """galpy #1344: derivatives under `vmap` are those of each lane alone."""
    heights, speeds = jnp.linspace(0.5, 3, 4), jnp.array([0.0, 1.0, 2.0])

    def of(f, h, v):
        return f(ARGS | {"h": h, "v": v})

    def over(f):
        return jax.vmap(jax.vmap(functools.partial(of, f), (None, 0)), (0, None))(heights, speeds)

    both = jax.value_and_grad(end_of)
    (times, slopes), exact = jax.jit(lambda: (over(both), over(jax.value_and_grad(lands))))()
    close((times, slopes), exact)
    each = jax.jit(both)
    alone = [[each(ARGS | {"h": float(h), "v": float(v)}) for v in speeds] for h in heights]
    np.testing.assert_array_equal(times, [[time for time, _ in row] for row in alone])
    np.testing.assert_array_equal(slopes["h"], [[slope["h"] for _, slope in row] for row in alone])


def test_loops_and_checkpoints():
    def step(h, _):
        t = end_of(ARGS | {"h": h})
        return h + t, t

    last, times = jax.jit(lambda h: lax.scan(step, h, None, length=3))(1.0)
    h = 1.0
    for time in times:
        exact = lands(ARGS | {"h": h})
        close(time, exact)
        h = h + exact

    def composed(h):
        for _ in range(3):
            h = h + lands(ARGS | {"h": h})
        return h

    looped = lambda h: lax.scan(step, h, None, length=3)[0]  # noqa: E731
    slope, exact = jax.jit(lambda h: (jax.grad(looped)(h), jax.grad(composed)(h)))(1.0)
    close(slope, exact)
    slopes, exact = jax.jit(lambda args: (jax.grad(jax.checkpoint(end_of))(args), jax.grad(lands)(args)))(ARGS)
    close(slopes, exact)
    grown = jax.jit(lambda: lax.while_loop(lambda h: h < 3.0, lambda h: step(h, None)[0], 1.0))()
    assert 3 <= grown < 5
    assert float(last) == pytest.approx(float(composed(1.0)))


def test_the_longest_chain_may_be_traced():
    args = ARGS | {"v": 0.0, "e": 0.7}
    count = jax.vmap(lambda n: ode.solve(BOUNCES, args, t1=99.0, max_events=n).count)(jnp.array([1.0, 3, 4]))
    np.testing.assert_array_equal(count, [1, 3, 4])


def test_the_events_on_the_way_can_be_traced():
    """NaN after the last one, which has no derivatives."""
    args = ARGS | {"e": 0.8}

    def events(args: Any) -> Any:
        passed = ode.solve(BOUNCES, args, t1=3.0, max_events=5).events
        return passed.t, passed.y["v"], passed.event, passed.at_once["floor"]

    def exact(args: Any) -> Any:
        """The times of three impacts."""
        speed = jnp.sqrt(args["v"] ** 2 + 2 * args["g"] * args["h"])
        times = [lands(args), *(2 * speed * args["e"] ** n / args["g"] for n in (1, 2))]
        return jnp.cumsum(jnp.stack(times))

    t, v, event, at_once = jax.jit(events)(args)
    close(t[:3], jax.jit(exact)(args))
    np.testing.assert_array_equal(np.isnan([t, v]), [[False] * 3 + [True] * 2] * 2)
    np.testing.assert_array_equal(event, [0] * 3 + [-1] * 2)
    np.testing.assert_array_equal(at_once, event == 0)
    of_two = jax.vmap(lambda g: events(args | {"g": g})[0])(jnp.array([9.81, 12.0]))
    np.testing.assert_array_equal(of_two[0], t)

    def derivatives(times: Any, args: Any) -> Any:
        loss = lambda args: jnp.nansum(times(args) ** 2)  # noqa: E731
        curve = jax.grad(jax.grad(lambda e: loss(args | {"e": e})))(args["e"])
        return jax.tree.map(lambda slope: slope[:3], jax.jacfwd(times)(args)), jax.grad(loss)(args), curve

    found, expected = jax.jit(lambda args: (derivatives(lambda args: events(args)[0], args), derivatives(exact, args)))(
        args
    )
    close(found, expected, 1e-7)
    first = lambda args: ode.solve(BALL, args, t1=9.0).events.t[0]  # noqa: E731
    found, expected = jax.jit(lambda args: (jax.value_and_grad(first)(args), jax.value_and_grad(lands)(args)))(ARGS)
    close(found, expected)


def test_shared_arrays_and_functions_in_jax():
    problem = ode.Problem(
        1.0,
        lambda t, y, args: -args["law"](args["w"] @ jnp.stack([y, y])),
        {"low": ode.Event(lambda t, y, args: y - 0.5)},
    )

    def end(w):
        return ode.solve(problem, {"law": lambda x: x, "w": w}, t1=9.0, shared=("w",)).t

    w = jnp.array([0.5, 1.5])
    np.testing.assert_allclose(jax.jit(end)(w), np.log(2) / 2, rtol=1e-9)
    np.testing.assert_allclose(jax.jit(jax.grad(end))(w), [-np.log(2) / 4] * 2, rtol=1e-8)
    np.testing.assert_allclose(jax.jit(jax.hessian(end))(w), np.full((2, 2), np.log(2) / 4), rtol=1e-6)


def test_lanes_that_fail_are_nan():
    t = jax.vmap(lambda h: end_of(ARGS | {"h": h}))(jnp.array([1.0, jnp.nan]))
    slope = jax.vmap(jax.grad(lambda h: end_of(ARGS | {"h": h})))(jnp.array([1.0, jnp.nan]))
    np.testing.assert_array_equal(np.isnan(t), [False, True])
    np.testing.assert_array_equal(np.isnan(slope), [False, True])


@pytest.mark.parametrize("names", [["g"], ["g", "v", "h"]])
def test_lanes_that_a_loss_leaves_out_do_not_spoil_its_derivatives(names):
    speeds, known = np.array([1.0, np.nan, 2.0]), np.array([1.0, 2.0])

    def loss(some, of=end_of, speeds=speeds):
        t = jax.vmap(lambda speed: of(ARGS | some | {"v": some.get("v", 0.0) + speed}))(speeds)
        return jnp.sum(jnp.where(jnp.isfinite(t), t, 0.0))

    def derivatives(f, some):
        return [
            transform(f)(some) for transform in (jax.grad, jax.jacfwd, jax.hessian, lambda f: jax.jacrev(jax.grad(f)))
        ]

    some = {name: ARGS[name] for name in names}
    found, expected = jax.jit(
        lambda some: (derivatives(loss, some), derivatives(functools.partial(loss, of=lands, speeds=known), some))
    )(some)
    close(found, expected, 1e-7)


def test_states_at_times_that_a_loss_leaves_out_do_not_spoil_its_derivatives():
    heights = jnp.array([1.5, jnp.nan])

    def loss(args, ts):
        ys = ode.solve(BALL, args | {"h": heights}, t1=10.0, ts=ts).ys["y"]
        return jnp.sum(jnp.where(jnp.isfinite(ys), ys, 0.0))

    def exact(args, ts):
        return jnp.sum(1.5 + args["v"] * ts - args["g"] * ts**2 / 2)

    def derivatives(f, args, ts):
        return jax.grad(f, (0, 1))(args, ts), jax.hessian(f, 1)(args, ts)

    found, expected = jax.jit(lambda args, ts: (derivatives(loss, args, ts), derivatives(exact, args, ts)))(
        ARGS | {"h": 0.0}, jnp.array([0.1, 0.3])
    )
    close(found, expected)


def test_second_derivatives_through_a_scan():
    def last(height, step):
        return lax.scan(lambda h, _: (h + step(ARGS | {"h": h}), None), height, None, length=3)[0]

    for second in (jax.hessian, lambda f: jax.jacrev(jax.grad(f))):
        found, exact = (jax.jit(second(functools.partial(last, step=step)))(1.0) for step in (end_of, lands))
        close(found, exact, 1e-7)


def test_inexact_lanes_are_told_within_jit():
    """Lorenz's equations: after so long no digit is left."""

    def field(t, y, args):
        x, y, z = y
        return [10 * (y - x), x * (args - z) - y, x * y - 8 / 3 * z]

    problem = ode.Problem([1.0, 1.0, 1.0], field)
    times = np.array([0.5, 60.0])
    inexact = jax.jit(lambda rho: ode.solve(problem, rho, t1=times).inexact)(28.0)
    np.testing.assert_array_equal(inexact, [False, True])


TRACED: dict[str, tuple[Any, type[Exception]]] = {
    "outcome": (lambda g: 1.0 * (ode.solve(BALL, ARGS | {"g": g}, t1=1.0).ended_by == "t1"), ValueError),
    "wrt": (lambda g: ode.solve(BALL, ARGS | {"g": g}, t1=1.0, wrt="g").t, ValueError),
    "max_events": (lambda g: ode.solve(BOUNCES, ARGS | {"g": g, "e": 0.9}, t1=3.0).events.t[0], ValueError),
    "name": (lambda g: ode.solve(BALL, ARGS | {"g": g}, t1=1.0).events.name[0] == "", ValueError),
    "third": (lambda g: jax.hessian(lambda g: end_of(ARGS | {"g": g}))(g), NotImplementedError),
}


@pytest.mark.parametrize("word", TRACED)
def test_what_jax_cannot_trace_is_refused(word):
    function, error = TRACED[word]
    with pytest.raises(error, match=word):
        jax.grad(function)(9.81)


def test_a_helper_that_is_redefined_is_seen():
    space: dict[str, Any] = {"ode": ode}
    exec("def rate(y):\n    return -y\nproblem = ode.Problem(1.0, lambda t, y, args: args * rate(y))", space)

    def at_one(k):
        return ode.solve(space["problem"], k, t1=1.0).y

    assert at_one(2.0) == pytest.approx(np.exp(-2), rel=1e-9)
    assert float(jax.jit(lambda k: at_one(k))(2.0)) == pytest.approx(np.exp(-2), rel=1e-9)
    exec("def rate(y):\n    return -2 * y", space)
    assert at_one(2.0) == pytest.approx(np.exp(-4), rel=1e-9)
    assert float(jax.jit(lambda k: at_one(k))(2.0)) == pytest.approx(np.exp(-4), rel=1e-9)


def test_numpy_arrays_of_two_dimensions_may_stand_beside_what_is_traced():
    heights = np.linspace(1.0, 2.0, 6).reshape(2, 3)
    problem = ode.Problem(
        lambda args: {"y": args["h"], "v": 0.0},
        lambda t, y, args: {"y": y["v"], "v": -args["g"]},
        {"ground": ode.Event(lambda t, y, args: y["y"], -1)},
    )
    fall = jax.jit(lambda g: ode.solve(problem, {"h": heights, "g": g}, t1=100.0).t)(9.81)
    np.testing.assert_allclose(fall, np.sqrt(2 * heights / 9.81), rtol=1e-9)


def test_jit_of_one_lane_and_of_times():
    ts = jnp.array([0.1, 0.5, 5.0])
    outside = ode.solve(BALL, ARGS, t1=10.0, ts=ts)
    inside = jax.jit(lambda args, ts: ode.solve(BALL, args, t1=10.0, ts=ts).ys)(ARGS, ts)
    close(inside, outside.ys)
    assert np.isnan(inside["y"][2])


CHAOS = ode.Problem(  # Lorenz's equations; small errors grow, so lanes are integrated again
    lambda args: jnp.array([1.0, args["k"], 20.0]),
    lambda t, y, args: jnp.stack([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]]),
)
STIFF = ode.Problem(
    lambda args: {"y": args["k"]}, lambda t, y, args: {"y": -1e5 * args["k"] * (y["y"] - jnp.cos(t)) - jnp.sin(t)}
)
LOST = ode.Problem(lambda args: {"y": 0.5}, lambda t, y, args: {"y": jnp.where(args["k"] > 1.3, 1.0, jnp.nan)})
TABLE = ode.Problem(lambda args: {"y": 0.0}, lambda t, y, args: {"y": args["k"] * jnp.sum(args["w"] ** 2)})


@pytest.mark.parametrize(
    ("problem", "times"),
    [(BALL, None), (BALL, [0.1, 0.4]), (CHAOS, None), (STIFF, None), (LOST, None), (TABLE, None)],
    ids=["plain", "times", "chaos", "stiff", "lost", "table"],
)
def test_one_lane_in_jit_has_the_bits_of_many(problem: ode.Problem, times: Any):
    """Calls of a few lanes go another way; with derivatives, values and these come from one program."""

    def everything(k: Any, h: Any) -> Any:
        args = {"g": 9.81, "h": 1.5, "v": k, "k": k, "w": h * jnp.arange(500.0) if problem is TABLE else h}
        shared = ("w",) if problem is TABLE else ()
        end = ode.solve(problem, args, t1=5.0 if problem is CHAOS else 0.6, ts=times, shared=shared)
        return end.t, end.y, end.ys if times else None, end.outcome, end.trials, end.inexact

    def with_slopes(k: Any, h: Any) -> Any:
        return everything(k, h), jax.jacfwd(lambda k, h: jax.tree.leaves(everything(k, h))[:2], (0, 1))(k, h)

    ks, h = jnp.linspace(1.0, 1.6, 40), jnp.array(1.0)
    many = jax.jit(jax.vmap(with_slopes, (0, None)))(ks, h)
    one = jax.jit(with_slopes)
    for i in (0, 17, 39):
        # The derivative by the table's size is a sum over its elements.
        alike(one(ks[i], h), jax.tree.map(lambda part, i=i: part[i], many), 1e-15 if problem is TABLE else 0.0)


def test_a_stiff_lane_in_jit_has_no_second_derivatives():
    second = jax.jit(jax.hessian(lambda v: ode.solve(BALL, ARGS | {"v": v}, t1=10.0, method="rosenbrock").t))
    assert jnp.isnan(second(1.0))
