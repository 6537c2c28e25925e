"""Gradients by the adjoint: closed forms, derivatives forwards, bits that depend on the lanes alone."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.ode_problems import CASES
from benchmarks.stiff_problems import Hires
from erosion import ode
from erosion.ode import batch, gradient

FALL = ode.Problem(
    y0=lambda args: {"y": args["height"], "v": 0.0},
    vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"]},
    events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
)
RNG = np.random.default_rng(0)
HIRES = Hires()


def bounces(n):
    """A ball that is dropped, to its n-th contact; the way that it went, and its state."""
    return ode.Problem(
        y0=lambda args: {"y": args["height"], "v": 0.0 * args["height"]},
        vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"] * (1 + 0.1 * jnp.sin(t))},
        events={
            "ground": ode.Event(
                lambda t, y, args: y["y"], direction=-1, reset=lambda t, y, args: {"y": 0.0, "v": -args["e"] * y["v"]}
            )
        },
        integrals={"work": lambda t, y, args: args["g"] * y["v"] ** 2},
    ), {"t1": 100.0, "max_events": n}


def learned(lanes=40):
    """A pendulum with a learned torque, to where it hangs down first."""
    shapes = {"a": 12, "b": 12, "m": (12, 12), "v": 12, "z": ()}
    w = {name: RNG.normal(size=shape) / 4 for name, shape in shapes.items()}

    def torque(w, x):
        return w["v"] @ jnp.tanh(w["m"] @ jnp.tanh(w["a"] * x + w["b"])) / 4 + w["z"] / 9

    problem = ode.Problem(
        y0=lambda args: {"x": args["x0"], "v": 0.0},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -jnp.sin(y["x"]) + torque(args["w"], y["x"])},
        events={"down": ode.Event(lambda t, y, args: y["x"], direction=-1)},
    )
    return problem, {"x0": RNG.uniform(0.3, 2.0, lanes), "w": w}, {"t1": 20.0, "shared": "w"}


def forwards(problem, args, names, cotangents, rtol=1e-13, **options):
    """The same derivatives forwards, by each of some numbers, to the last digits."""
    end = ode.solve(problem, args, wrt=names, rtol=rtol, **options)
    found = {}
    for name in names:
        part = end.along(name)
        parts = [part.t, *(part.y[key] for key in part.y), *part.integrals.values()]
        found[name] = sum(cotangent * each for cotangent, each in zip(cotangents, parts, strict=True))
    return found


def bars_of(end):
    return RNG.normal(size=(1 + len(end.y) + len(end.integrals), *np.shape(end.t)))


def by_adjoint(end, cotangents):
    time, *rest = cotangents
    y = dict(zip(end.y, rest[: len(end.y)], strict=True))
    return end.gradient(t=time, y=y, integrals=dict(zip(end.integrals, rest[len(end.y) :], strict=True)))


def test_closed_form_in_the_shapes_that_were_given():
    """Σ t² of heights by gravities: t² = 2 h/g; a number that lanes share has the sum over them."""
    height, g = np.array([[1.0], [2.0], [5.0]]), np.array([3.0, 9.0])
    end = ode.solve(FALL, {"height": height, "g": g}, t1=100.0)
    found = end.gradient(t=2 * end.t)
    np.testing.assert_allclose(found["height"], np.sum(2 / g + 0 * height, axis=1, keepdims=True), rtol=1e-9)
    np.testing.assert_allclose(found["g"], np.sum(-2 * height / g**2, axis=0), rtol=1e-9)
    # The state at the ground: v = -√(2 g h).
    found = end.gradient(y={"y": np.zeros(end.t.shape), "v": np.ones(end.t.shape)})
    np.testing.assert_allclose(found["g"], np.sum(-np.sqrt(height / (2 * g)), axis=0), rtol=1e-9)


@pytest.mark.parametrize("name", ["Lorenz", "MichaelisMenten"])
def test_standard_problems(name):
    """Every lane but one relative to its own largest derivative by a number of its size: 1e-7."""
    case, lanes = CASES[name], 50
    problem, args = case.problem(integral=True), case.sample(lanes, np.random.default_rng(3))
    end = ode.solve(problem, args, t1=case.t1, smooth=True)
    cotangents = bars_of(end)
    found = by_adjoint(end, cotangents)
    best = forwards(problem, args, tuple(args), cotangents, t1=case.t1, smooth=True)
    of_size = [np.array([part[key] * args[key] for key in args]) for part in (found, best)]
    error = np.abs(of_size[0] - of_size[1]).max(axis=0) / np.abs(of_size[1]).max(axis=0)
    assert np.sort(error)[-2] < 1e-7


def test_sums_by_weights():
    """Of a network whose matrix stays in memory, against each weight forwards."""
    problem, args, options = learned()
    end = ode.solve(problem, args, **options)
    found = end.gradient(t=2 * (end.t - 1.7))
    off = 2 * (ode.solve(problem, args, rtol=1e-13, **options).t - 1.7)
    shapes = [(args["w"][name], found["w"][name]) for name in ("a", "m", "v")]
    for weights, slopes in shapes:
        assert slopes.shape == weights.shape
        before = weights[3].copy()
        ends = []
        for step in (1e-4, -1e-4):
            weights[3] = before + step
            ends.append(ode.solve(problem, args, rtol=1e-13, **options).t)
        weights[3] = before
        np.testing.assert_allclose(np.sum(slopes[3]), np.sum(off * (ends[0] - ends[1])) / 2e-4, rtol=1e-6)


def test_lanes_without_a_result_are_left_out_of_sums():
    """They are NaN themselves."""
    problem, args, options = learned()
    kept = ode.solve(problem, args, **options)
    expected = kept.gradient(t=kept.t)
    more = {**args, "x0": np.concatenate([args["x0"], [np.nan, np.nan]])}
    end = ode.solve(problem, more, **options)
    found = end.gradient(t=end.t)
    np.testing.assert_array_equal(found["w"]["m"], expected["w"]["m"])
    np.testing.assert_array_equal(found["x0"], [*expected["x0"], np.nan, np.nan])


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (batch, "threads", lambda: 1),
        (gradient, "_FEW", 0),
        (gradient, "_CHUNK", 16),
        (gradient, "_MEMORY", 2**15),
        (gradient, "_BESIDE_STEPS", -5),
    ],
)
def test_bits_depend_on_the_lanes_alone(module, name, value, monkeypatch):
    """Not on threads, blocks, or tapes that were too short at first."""
    problem, args, options = learned(lanes=77)
    end = ode.solve(problem, args, **options)
    expected = end.gradient(t=end.t)
    monkeypatch.setattr(module, name, value)
    found = end.gradient(t=end.t)
    for key in ("a", "m", "z"):
        np.testing.assert_array_equal(found["w"][key], expected["w"][key])
    np.testing.assert_array_equal(found["x0"], expected["x0"])


DOSED = ode.Problem(
    y0=lambda args: {"blood": args["dose"], "tissue": 0.0},
    vector_field=lambda t, y, args: {
        "blood": -args["rate"] * (y["blood"] - y["tissue"]) - args["k"] * y["blood"],
        "tissue": args["rate"] * (y["blood"] - y["tissue"]),
    },
    events={
        "low": ode.Event(
            lambda t, y, args: y["blood"] - 0.1,
            direction=-1,
            reset=lambda t, y, args: {"blood": y["blood"] + args["dose"], "tissue": y["tissue"]},
        )
    },
)


def test_hires_goes_backwards():
    """Eight unknowns of a stiff motion, and an integral, against the derivatives forwards."""
    problem, args = HIRES.problem(integral=True), HIRES.sample(5, np.random.default_rng(0))
    end = ode.solve(problem, args, t1=1e3, method="rosenbrock")
    cotangents = bars_of(end)
    found = by_adjoint(end, cotangents)
    best = forwards(problem, args, tuple(args), cotangents, rtol=1e-11, method="rosenbrock", t1=1e3)
    greatest = np.sum([np.abs(best[name] * args[name]) for name in args], axis=0)
    for name in args:
        expected = best[name] if np.ndim(args[name]) else np.sum(best[name])
        size = greatest if np.ndim(args[name]) else greatest.sum()
        np.testing.assert_allclose(found[name] * args[name] / size, expected * args[name] / size, rtol=0, atol=1e-7)


@pytest.mark.parametrize("method", ["auto", "rosenbrock"])
def test_where_a_motion_rests_its_steps_are_too_long_for_an_adjoint(method):
    """Its value needs none: y' = k (c - y) stays at c, or falls to it, beside what still moves."""
    relaxing = ode.Problem(
        y0=lambda args: {"y": args["s"], "z": 2.0},
        vector_field=lambda t, y, args: {"y": args["k"] * (args["c"] - y["y"]), "z": -0.1 * (y["z"] - y["y"])},
    )
    k, t1 = np.array([10.0, -3.0, 1.0, 3.0]), np.array([10.0, 3.0, 1000.0, 1e-3])
    args = {"s": np.array([1.0, 1.0, 2.0, 1.0]), "k": k, "c": 1.0}
    end = ode.solve(relaxing, args, t1=t1, method=method)
    found = end.gradient(y={"y": 1.0, "z": 0.0})
    decay = np.exp(-k * t1)
    np.testing.assert_allclose(found["s"], decay, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found["k"], -t1 * (args["s"] - 1.0) * decay, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found["c"], np.sum(1 - decay), rtol=1e-6)


def test_each_lane_goes_back_by_its_own_method():
    """By "auto", with the bits of that method; in JAX, too."""
    oscillator = ode.Problem(
        y0=lambda args: {"x": args["x0"], "v": 0.0},
        vector_field=lambda t, y, args: {
            "x": y["v"],
            "v": args["mu"] * (1 - y["x"] ** 2) * y["v"] - args["k"] * y["x"],
        },
        events={"zero": ode.Event(lambda t, y, args: y["x"])},
    )
    args = {"x0": 2.0, "k": np.ones(4), "mu": np.array([1.0, 1000.0, 3.0, 500.0])}
    end, explicit, stiff = (
        ode.solve(oscillator, args, t1=1e4, rtol=1e-7, method=method) for method in ("auto", "explicit", "rosenbrock")
    )
    found, of_explicit, of_stiff = (each.gradient(t=1.0) for each in (end, explicit, stiff))
    np.testing.assert_array_equal(end.stiff, [False, True, False, True])
    for name in ("mu", "k"):
        np.testing.assert_array_equal(found[name], np.where(np.asarray(end.stiff), of_stiff[name], of_explicit[name]))
    # What the explicit method recorded of a lane that it gave up counts for nothing.
    kept = ode.solve(oscillator, args, t1=1e4, rtol=1e-7, gradient=True).gradient(t=1.0)
    for name in ("mu", "k"):
        np.testing.assert_allclose(kept[name], found[name], rtol=1e-12)
    loss = lambda args: jnp.sum(ode.solve(oscillator, args, t1=1e4, rtol=1e-7).t)  # noqa: E731
    _alike(jax.jit(jax.grad(loss))(args), found, 1e-12)


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("t", np.ones(2), "`t`"),
        ("t", None, "`t`"),
        ("t", np.ma.array(np.ones(3), mask=[False, True, False]), "`t`"),
        ("y", np.ones(3), "`y`"),
        ("ys", {"y": 1.0, "v": 0.0}, "`ts`"),
        ("integrals", {"z": 1.0}, "`integrals`"),
        ("integrals", 3, "`integrals`"),
    ],
)
def test_what_does_not_fit_is_refused(name, value, named):
    end = ode.solve(FALL, {"height": np.ones(3), "g": 9.0}, t1=9.0)
    with pytest.raises((ValueError, TypeError), match=named):
        end.gradient(**{name: value})


def test_whole_numbers_that_lanes_share_have_no_derivatives():
    """As in JAX; a number of each lane is a real one, however it is written."""

    def pull(t, y, args):
        return {"y": y["v"], "v": -jnp.sum(args["w"])}

    problem = ode.Problem(FALL.y0, pull, FALL.events)
    found = ode.solve(problem, {"height": np.array([8, 2]), "w": np.array([3, 1])}, t1=9.0, shared="w").gradient(t=1.0)
    assert (found["w"].dtype, found["w"].shape) == (jax.dtypes.float0, (2,))
    np.testing.assert_allclose(found["height"], [1 / 8, 1 / 4], rtol=1e-9)


def test_no_lanes_have_no_derivatives():
    """And sums over them are zero."""
    none = jnp.zeros(0)

    def loss(q, g):
        return jnp.sum(ode.solve(FALL, {"height": q[:, 0], "g": g}, t0=q[:, 1], t1=q[:, 2]).t)

    of_lanes, of_all = jax.jit(jax.grad(loss, (0, 1)))(jnp.zeros((0, 3)), 9.0)
    assert (of_lanes.shape, float(of_all)) == ((0, 3), 0.0)
    assert jax.jit(jax.hessian(loss))(jnp.zeros((0, 3)), 9.0).shape == (0, 3, 0, 3)
    end = jax.jit(lambda h: ode.solve(FALL, {"height": h, "g": 9.0}, t1=9.0, ts=jnp.ones(2)).ys)
    assert end(none)["v"].shape == (0, 2)
    assert ode.solve(FALL, {"height": none, "g": 9.0}, t1=9.0, ts=[1.0, 2.0]).ys["v"].shape == (0, 2)


def _alike(found, expected, rtol=1e-8):
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=rtol * np.abs(other).max())


def test_jax_goes_backwards():
    """`grad`, within `jit` and `vmap` and around them, sums over lanes as `Solution.gradient` does."""
    problem, args, options = learned(lanes=9)
    end = ode.solve(problem, args, **options)
    cotangents = bars_of(end)
    expected = by_adjoint(end, cotangents)
    at = jax.tree.map(jnp.asarray, args)

    def loss(args, cotangents):
        found = ode.solve(problem, args, **options)
        return jnp.sum(
            cotangents[0] * found.t
            + sum(cotangent * y for cotangent, y in zip(cotangents[1:], found.y.values(), strict=True))
        )

    _alike(jax.grad(loss)(at, cotangents), expected, 1e-12)
    lane = {"x0": 0, "w": None}
    of_lanes = jax.vmap(loss, (lane, 1))
    _alike(jax.jit(jax.grad(lambda args: jnp.sum(of_lanes(args, cotangents))))(at), expected, 1e-12)
    each = jax.jit(jax.vmap(jax.grad(loss), (lane, 1)))(at, cotangents)["w"]
    _alike(jax.tree.map(lambda leaf: leaf.sum(0), each), expected["w"], 1e-10)


def test_jax_goes_backwards_and_forwards_to_the_same():
    """First and second derivatives, in any order, of a state by arguments and times."""

    def rate(q):
        return ode.solve(FALL, {"height": q[0], "g": q[1]}, t0=q[2], t1=q[3]).y["v"]

    at = jnp.array([5.0, 9.0, 0.2, 0.9])  # v = -g (t1 - t0)
    _alike(jax.jit(jax.jacrev(rate))(at), np.array([0.0, -0.7, 9.0, -9.0]))
    expected = np.zeros((4, 4))
    expected[1, 2:] = expected[2:, 1] = 1.0, -1.0
    for twice in (jax.hessian, lambda f: jax.jacrev(jax.jacfwd(f)), lambda f: jax.jacrev(jax.jacrev(f))):
        _alike(jax.jit(twice(rate))(at), expected)


def test_jax_makes_no_sum_nan_of_a_lane_that_does_not_count():
    """A lane without a result whose cotangent is zero."""
    problem, args, options = learned(lanes=3)

    def loss(w, x0):
        return jnp.nansum(ode.solve(problem, {"x0": x0, "w": w}, **options).t)

    known = jnp.asarray(args["x0"])
    slope = jax.jit(jax.grad(loss))
    _alike(slope(args["w"], jnp.concatenate([known, jnp.array([jnp.nan])])), slope(args["w"], known), 1e-12)


def _ball():
    """It bounces, and is pushed at times by what is infinite at the ground."""
    return ode.Problem(
        y0=lambda args: {"x": args["h"], "v": 0.0, "w": 0.3},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -args["g"], "w": 1.0},
        events={
            "ground": ode.Event(
                lambda t, y, args: y["x"], -1, reset=lambda t, y, args: {**y, "x": 0.0, "v": -args["u"] * y["v"]}
            ),
            "push": ode.Event(
                lambda t, y, args: y["w"] - 1.0,
                reset=lambda t, y, args: {"x": y["x"], "v": y["v"] + 0.1 / y["x"], "w": y["w"] - 1.0},
            ),
        },
    )


def _iterated():
    """Rates with a loop that JAX cannot go back through."""

    def root(x):
        return jax.lax.while_loop(lambda at: at[0] < 5, lambda at: (at[0] + 1, (at[1] + x / at[1]) / 2), (0, x))[1]

    return ode.Problem(
        y0=lambda args: {"x": args["h"], "v": 0.0},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -args["g"] - args["u"] * root(2.0 + y["v"] ** 2)},
        events={"ground": ode.Event(lambda t, y, args: y["x"], -1)},
    )


@pytest.mark.parametrize(("problem", "options"), [(_ball(), {}), (_iterated(), {"smooth": True})])
def test_where_an_adjoint_is_unknown_it_goes_forwards(problem, options):
    args = {"h": 1.0, "g": 9.81, "u": 0.8}

    def speed(args):
        return ode.solve(problem, args, t1=1.2, **options).y["v"]

    end = ode.solve(problem, args, t1=1.2, **options)
    found = end.gradient(y={name: float(name == "v") for name in end.y})
    back, forth = (jax.jit(of(speed))(args) for of in (jax.grad, jax.jacfwd))
    for name, expected in forth.items():
        assert (float(back[name]), float(found[name])) == pytest.approx((float(expected),) * 2, rel=1e-8)


def test_a_lane_without_a_result_is_left_out_along_each_axis():
    args = {"height": np.array([[1.0], [np.nan]]), "g": np.array([[9.81, 20.0]])}
    found = ode.solve(FALL, args, t1=10.0).gradient(t=1.0)
    alone = ode.solve(FALL, args | {"height": 1.0}, t1=10.0).gradient(t=1.0)
    np.testing.assert_allclose(found["g"], alone["g"])
    np.testing.assert_array_equal(np.isnan(found["height"]), [[False], [True]])


def test_a_jacobian_of_lanes_is_diagonal():
    times = jax.jit(jax.jacrev(lambda heights: ode.solve(FALL, {"height": heights, "g": 9.81}, t1=10.0).t))
    heights = jnp.linspace(1.0, 2.0, 20)
    np.testing.assert_allclose(times(heights), np.diag(1 / np.sqrt(2 * 9.81 * heights)), rtol=1e-9, atol=1e-12)


def test_a_gradient_of_recorded_steps_has_the_same_bits():
    (problem, options), args = bounces(5), {"height": RNG.uniform(1.0, 3.0, 9), "g": 9.0, "e": 0.8}
    one, other = (ode.solve(problem, args, method="explicit", gradient=kept, **options) for kept in (False, True))
    cotangents = bars_of(one)
    assert other.recorded is not None
    list(
        map(
            np.testing.assert_array_equal,
            *map(jax.tree.leaves, (by_adjoint(other, cotangents), by_adjoint(one, cotangents))),
        )
    )


def test_doubtful_lanes_are_recorded_with_their_tolerance(monkeypatch):
    """And those whose steps do not fit once more: results and gradients keep their bits."""
    for module in (batch, gradient):
        monkeypatch.setattr(module, "ROWS", 48)
    case = CASES["ThreeBodies"]
    problem, args = case.problem(integral=True), case.sample(60, np.random.default_rng(3))
    one, other = (
        ode.solve(problem, args, t1=case.t1, smooth=True, method="explicit", gradient=kept) for kept in (False, True)
    )
    results = [(end.t, end.y, end.integrals, end.trials, end.tolerance) for end in (one, other)]
    list(map(np.testing.assert_array_equal, *map(jax.tree.leaves, results)))
    assert other.recorded is not None
    assert other.tolerance is not None
    fits, doubtful = other.recorded.rows <= 48, other.tolerance < other.rtol
    assert np.all([np.any(fits & doubtful), np.any(fits & ~doubtful), np.any(~fits)])
    cotangents = bars_of(one)
    list(
        map(np.testing.assert_array_equal, *map(jax.tree.leaves, (by_adjoint(end, cotangents) for end in (one, other))))
    )


PREY = ode.Problem(
    y0=lambda args: {"prey": args["prey"], "hunters": args["hunters"]},
    vector_field=lambda t, y, args: {
        "prey": y["prey"] * (args["grows"] - args["eaten"] * y["hunters"]),
        "hunters": y["hunters"] * (args["feeds"] * y["prey"] - args["dies"]),
    },
)
DRIVEN = ode.Problem(
    y0=lambda args: {"x": args["x"], "v": args["v"]},
    vector_field=lambda t, y, args: {"x": y["v"], "v": -args["k"] * y["x"] + jnp.cos(args["w"] * t)},
    events={"down": ode.Event(lambda t, y, args: y["x"] + 0.5, direction=-1)},
)


def numbers(lanes, **ranges):
    return {name: RNG.uniform(low, high, lanes) for name, (low, high) in ranges.items()}


OF_PREY = numbers(
    9, prey=(0.8, 1.2), hunters=(0.4, 0.6), grows=(1, 1.2), eaten=(0.3, 0.5), feeds=(0.1, 0.2), dies=(0.3, 0.5)
)
OF_DRIVEN = numbers(9, x=(0.8, 1.2), v=(-1, 1), k=(1, 3), w=(0.5, 2))
TURNS = ode.Problem(
    y0=lambda args: {"x": args["x0"], "v": 0.0 * args["x0"]},
    vector_field=lambda t, y, args: {"x": y["v"], "v": -(args["w"] ** 2) * y["x"]},
    integrals={"area": lambda t, y, args: y["x"]},
)


def test_times_that_jax_traces():
    """x = x₀ cos wt and its integral, by hand: in any order, twice, before the start and after the end, and their
    derivatives by the times and by the numbers, once and twice."""
    args = {"x0": np.full(3, 1.2), "w": np.linspace(0.9, 1.1, 3)}
    ts = np.array([2.0, 0.5, -1.0, 0.5, 7.0, np.nan, 4.5])
    within = jnp.array([0, 1, 3, 6])

    def seen(args, ts):
        times = ode.solve(TURNS, args, t1=5.0, ts=ts).times
        assert times is not None
        return jnp.stack([times.ys["x"], times.integrals["area"]])

    def by_hand(args, ts):
        x0, w = (args[name][..., None] for name in ("x0", "w"))
        ts = jnp.where(jnp.isnan(ts), 0.0, ts)
        return jnp.stack([x0 * jnp.cos(w * ts), x0 * jnp.sin(w * ts) / w])

    found, judge = jax.jit(lambda args, ts: (seen(args, ts), by_hand(args, ts)))(args, ts)
    assert np.isnan(found[..., jnp.array([2, 4, 5])]).all()
    np.testing.assert_allclose(found[..., within], judge[..., within], atol=1e-9)
    orders = [
        lambda of: jax.grad(lambda args, ts: jnp.nansum(jnp.sin(of(args, ts)[..., within])), (0, 1)),
        lambda of: jax.hessian(lambda args, ts: jnp.sum(of(args, ts)[..., within] ** 3), (0, 1)),
        lambda of: jax.jacfwd(jax.jacfwd(lambda args, ts: of(args, ts)[..., within], 1), 0),
    ]
    both = jax.jit(lambda args, ts: [[order(of)(args, ts) for order in orders] for of in (seen, by_hand)])(args, ts)
    for mine, exact in zip(*map(jax.tree.leaves, both), strict=True):
        np.testing.assert_allclose(mine, exact, atol=1e-7 * (1 + np.abs(exact).max()))


def test_states_of_stiff_lanes_move_with_their_times():
    """y' = -k (y - cos t): near the slow motion k times the error of the state is no rate."""
    slow = ode.Problem(y0=0.5, vector_field=lambda t, y, args: -args["k"] * (y - jnp.cos(t)))
    seen = lambda t: ode.solve(slow, {"k": 1e7}, t1=2.0, ts=jnp.array([t])).ys[0]  # noqa: E731
    k, t = 1e7, 1.0
    np.testing.assert_allclose(jax.jit(jax.grad(seen))(t), -k / (k**2 + 1) * (k * np.sin(t) - np.cos(t)), rtol=1e-6)


def test_no_state_at_a_time_needs_to_count():
    loss = lambda args, ts: jnp.maximum(0.0, jnp.sum(ode.solve(PREY, args, t1=2.0, ts=ts).ys["prey"]) - 1e9)  # noqa: E731
    alone = {name: float(numbers[0]) for name, numbers in OF_PREY.items()}
    for ts in (np.array([0.5, 1.0]), jnp.array([0.5, 1.0])):
        assert all(each == 0 for each in jax.jit(jax.grad(loss))(alone, ts).values())
        assert not np.any(jax.jit(jax.grad(lambda ts: loss(alone, ts)))(ts))


def test_lanes_of_vmap_have_times_of_their_own():
    ts = np.random.default_rng(2).uniform(0.0, 0.8, (9, 4))  # before the first lane ends

    def loss(args, ts):
        return jnp.sum(ode.solve(DRIVEN, args, t1=6.0, ts=ts).ys["x"] ** 2)

    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(loss, (0, 1))))(OF_DRIVEN, ts)
    for i in (0, 8):
        alone = {name: float(numbers[i]) for name, numbers in OF_DRIVEN.items()}
        end = ode.solve(DRIVEN, alone, t1=6.0, ts=ts[i], wrt=tuple(alone))
        assert end.times is not None
        exact = np.sum(end.ys["x"] ** 2)
        np.testing.assert_allclose(values[i], exact, rtol=1e-9)
        for name in alone:
            exact = np.sum(2 * end.ys["x"] * end.times.along(name).ys["x"])
            np.testing.assert_allclose(slopes[0][name][i], exact, rtol=1e-7)
        np.testing.assert_allclose(slopes[1][i], 2 * end.ys["x"] * end.ys["v"], rtol=1e-7, atol=1e-9)


DOSED = ode.Problem(
    y0=lambda args: {"x": args["x"]},
    vector_field=lambda t, y, args: {"x": -args["k"] * y["x"]},
    events={
        "dose": ode.Event(
            lambda t, y, args: jnp.sin(jnp.pi * t / args["p"]), reset=lambda t, y, args: {"x": y["x"] + args["d"]}
        )
    },
)


def test_times_at_resets_have_the_gradient_of_what_was_before():
    args, ts = {"x": np.array([1.0, 2.0]), "k": 0.3, "p": 1.0, "d": np.array([0.5, 0.7])}, [1.0, 2.0, 3.0]
    end = ode.solve(DOSED, args, t1=6.5, max_events=1e9, ts=ts, wrt="d")
    assert end.times is not None
    found = end.gradient(ys={"x": 1.0})["d"]
    np.testing.assert_allclose(found, np.sum(end.times.along("d").ys["x"], axis=-1), rtol=1e-8)
    loss = lambda args: jnp.sum(ode.solve(DOSED, args, t1=6.5, max_events=1e9, ts=ts).ys["x"])  # noqa: E731
    np.testing.assert_allclose(jax.jit(jax.grad(loss))(args)["d"], found, rtol=1e-8)


BOUNCING = ode.Problem(
    lambda args: {"y": args["height"], "v": 0.0},
    lambda t, y, args: {"y": y["v"], "v": -args["g"] - args["drag"] * y["v"] * (1 + 0.1 * jnp.sin(y["y"]))},
    {"floor": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -args["kept"] * y["v"]})},
)


@pytest.mark.parametrize("t0", [0.0, 0.3])
def test_chains_with_times_go_back_to_the_derivatives_forwards(t0):
    """Times are before, between and after bounces, and at the start; lanes end by the last bounce, and by t1."""
    args, ts = {"height": np.array([0.3, 1.0, 2.0]), "g": 9.81, "drag": 0.1, "kept": 0.8}, t0 + np.linspace(0, 1.9, 23)
    run = functools.partial(ode.solve, BOUNCING, args, t0=t0, t1=t0 + 2.0, ts=ts, max_events=6)
    end, weights = run(gradient=True), np.cos(np.arange(23.0))
    assert {"floor", "t1"} == set(end.ended_by)
    assert not end.warnings
    ys = {"y": weights, "v": weights**2}
    found = end.gradient(t=0.7, y={"y": 0.3, "v": 0.2}, ys=ys)
    slopes = run(wrt=tuple(args))
    assert slopes.times is not None
    for name, each in found.items():
        last, times = slopes.along(name), slopes.times.along(name)
        at_times = sum(np.nansum(cotangent * times.ys[part], axis=-1) for part, cotangent in ys.items())
        lanes = 0.7 * last.t + 0.3 * last.y["y"] + 0.2 * last.y["v"] + at_times
        np.testing.assert_allclose(each, lanes if name == "height" else lanes.sum(), rtol=1e-8)


KINKED = ode.Problem(lambda args: 1.0, lambda t, y, args: -args["drag"] * jnp.sqrt(jnp.abs(y)))
FORWARDS: dict[str, tuple[ode.Problem, dict[str, Any]]] = {
    "kinks": (KINKED, {}),
    "fire": (BOUNCING, {"start": "fire"}),
    "stiff": (BOUNCING, {"method": "rosenbrock", "ts": [0.1]}),
}


@pytest.mark.parametrize("case", FORWARDS)
def test_lanes_whose_gradient_goes_forwards_are_told(case):
    problem, options = FORWARDS[case]
    args = {"height": np.array([1.0, 2.0]), "g": 9.81, "drag": 0.1, "kept": 0.8}
    end = ode.solve(problem, args, t1=0.2, gradient=True, **options)
    assert any("2 of" in sentence and "4 numbers" in sentence for sentence in end.warnings), end.warnings
    assert not ode.solve(problem, args, t1=0.2, **options).warnings


def test_gradients_at_times_are_as_exact_as_the_states():
    """Chaos until t = 8, and then a rest that hardly depends on it: the end alone would ask for less."""

    def rates(t, y, args):
        x, u, z = y["x"], y["u"], y["z"]
        on = 0.5 - 0.5 * jnp.tanh(20 * (t - 8.0))
        slopes = (args["s"] * (u - x), x * (args["r"] - z) - u, x * u - args["b"] * z)
        return {name: on * slope - (1 - on) * y[name] for name, slope in zip(("x", "u", "z"), slopes, strict=True)}

    forgetful = ode.Problem({"x": 1.0, "u": 1.0, "z": 20.0}, rates)
    args = {"s": np.linspace(9.5, 10.5, 4), "r": 28.0 + np.zeros(4), "b": 8 / 3 + np.zeros(4)}

    def loss(args, rtol=1e-9):
        return jnp.sum(ode.solve(forgetful, args, t1=40.0, ts=np.linspace(0, 7.5, 6), rtol=rtol).ys["x"])

    found, best = (jax.jit(jax.grad(functools.partial(loss, rtol=rtol)))(args) for rtol in (1e-9, 1e-12))
    for name in args:
        np.testing.assert_allclose(found[name], best[name], rtol=2e-8, atol=2e-8 * np.abs(best[name]).max())


def test_lanes_without_a_result_have_no_gradient_of_the_states_before():
    """The first is infinite before its end."""
    burst = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": args["k"] * y["x"] ** 2})
    end = ode.solve(burst, {"k": np.array([1.0, 0.1])}, t1=3.0, ts=[0.1, 0.5])
    assert end.ended_by[1] == "t1"
    found = end.gradient(ys={"x": 1.0})["k"]  # x = 1/(1 - k t)
    assert np.isnan(found[0])
    np.testing.assert_allclose(found[1], sum(t / (1 - 0.1 * t) ** 2 for t in (0.1, 0.5)), rtol=1e-8)


def test_no_times_have_no_gradient():
    end = ode.solve(PREY, OF_PREY, t1=5.0, ts=[])
    found = end.gradient(ys={"prey": 1.0, "hunters": 1.0}, y={"prey": 1.0, "hunters": 0.0})
    np.testing.assert_array_equal(found["dies"], end.gradient(y={"prey": 1.0, "hunters": 0.0})["dies"])
