"""`ode.maximum`: where a quantity of the end is greatest, against closed forms, scans and scipy."""

import json
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from erosion import ode
from erosion.output.tables import to_json

G = 9.81
SHOT = {"angle": 0.0, "v": 50.0, "drag": 0.0}
BETWEEN = (0.1, 1.5)


def _flight(t, y, args):
    speed = jnp.sqrt(y["vx"] ** 2 + y["vy"] ** 2)
    return {
        "x": y["vx"],
        "y": y["vy"],
        "vx": -args["drag"] * speed * y["vx"],
        "vy": -G - args["drag"] * speed * y["vy"],
    }


def _muzzle(args):
    return {
        "x": 0.0, "y": 0.0, "vx": args["v"] * jnp.cos(args["angle"]), "vy": args["v"] * jnp.sin(args["angle"]),
    }  # fmt: skip


GROUND = {"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)}
# A wall with a round top, half an ellipse: what clears it lands far behind.
WALL = {
    "wall": ode.Event(
        lambda t, y, args: ((y["x"] - args["wall"]) / 0.5) ** 2 + (y["y"] / args["height"]) ** 2 - 1, direction=-1
    )
}
CANNON = ode.Problem(_muzzle, _flight, GROUND)
WALLED = ode.Problem(_muzzle, _flight, GROUND | WALL)


def farthest(problem, args, **options):
    settings = {"of": lambda end: end.y["x"], "over": "angle", "between": BETWEEN, "t1": 100.0, "smooth": True}
    return ode.maximum(problem, args, **settings | options)


def scanned(problem, args, between, points) -> np.ndarray:
    """The greatest range of each problem at evenly spaced angles."""
    angles = np.linspace(between[0], between[1], points)[:, None]
    return ode.solve(problem, args | {"angle": angles}, t1=100.0, smooth=True).y["x"].max(axis=0)


def test_without_drag_the_best_angle_is_45_degrees() -> None:
    best = farthest(CANNON, SHOT)
    assert (best.kind, best.ended_by, best.certified, best.attained) == ("interior", "ground", True, True)
    assert best.at == best.low == best.high == pytest.approx(np.pi / 4, abs=1e-13)
    assert best.value == pytest.approx(50.0**2 / G, rel=1e-13)
    # x = v² sin 2α/g
    assert abs(best.slope) < 1e-10
    assert best.curve == pytest.approx(-4 * 50.0**2 / G, rel=1e-10)
    assert (best.jumps, len(best.candidates), [each.ended_by for each in best.regimes]) == ((), 1, ["ground"])


@pytest.mark.parametrize(("between", "at"), [((0.1, 0.6), 0.6), ((0.9, 1.4), 0.9)])
def test_the_end_of_a_range_may_be_best(between: tuple[float, float], at: float) -> None:
    best = farthest(CANNON, SHOT, between=between)
    assert (best.kind, best.at, best.attained, best.certified) == ("boundary", at, True, True)
    assert best.value == pytest.approx(50.0**2 / G * np.sin(2 * at), rel=1e-12)
    assert best.slope == pytest.approx(2 * 50.0**2 / G * np.cos(2 * at), rel=1e-10)


def test_with_drag_it_is_what_scipy_and_a_scan_find() -> None:
    drag = 0.01
    best = farthest(CANNON, SHOT | {"drag": drag})
    assert (best.kind, best.certified) == ("interior", True)

    def rates(t, s):
        speed = np.hypot(s[2], s[3])
        return [s[2], s[3], -drag * speed * s[2], -G - drag * speed * s[3]]

    def ground(t, s):
        return s[1]

    vars(ground).update(terminal=True, direction=-1)

    def short(angle):
        start = [0.0, 0.0, 50 * np.cos(angle), 50 * np.sin(angle)]
        return -solve_ivp(rates, (0, 100), start, "DOP853", events=ground, rtol=1e-12, atol=1e-12).y_events[0][0, 0]

    found: Any = minimize_scalar(short, bounds=BETWEEN, method="bounded", options={"xatol": 1e-8})
    # Near a maximum values alone tell the place to the root of their errors.
    assert best.at == pytest.approx(found.x, abs=1e-6)
    assert best.value == pytest.approx(-found.fun, rel=1e-10)
    scan = scanned(CANNON, SHOT | {"drag": drag}, BETWEEN, 10_001).item()
    assert scan <= best.value * (1 + 1e-10)
    assert scan == pytest.approx(best.value, rel=1e-7)


def test_the_best_shot_may_be_one_that_just_clears_a_wall() -> None:
    args = SHOT | {"v": 40.0, "wall": 100.0, "height": 45.0}
    best = farthest(WALLED, args, between=(0.05, 1.5))
    assert (best.kind, best.side, best.attained, best.ended_by, best.certified) == (
        "jump", "above", False, "ground", True,
    )  # fmt: skip
    low, high = best.jumps
    assert (low.ended_below, low.ended_above, high.ended_below, high.ended_above) == (
        "wall", "ground", "ground", "wall",
    )  # fmt: skip
    assert [each.ended_by for each in best.regimes] == ["ground", "wall", "ground", "wall", "ground"]
    # The parabola y = x tan α - g x²/(2 v² cos²α) touches the top: the least of the ellipse's function along it is 1.
    x = np.linspace(99.5, 100.5, 100_001)
    height = x * np.tan(low.at) - G * x**2 / (2 * (40 * np.cos(low.at)) ** 2)
    assert np.min(((x - 100) / 0.5) ** 2 + (height / 45) ** 2) == pytest.approx(1.0, abs=1e-8)
    assert best.at - low.at == pytest.approx(1.45e-9, rel=1e-2)  # 1e-9 of the range
    assert best.value == pytest.approx(40.0**2 / G * np.sin(2 * low.at), rel=1e-8)
    assert low.below == pytest.approx(100.0, abs=0.01)
    assert scanned(WALLED, args, (0.05, 1.5), 10_001).item() <= best.value


# x = t from -1; one event at 1 + u, one at 3 - u.
TWO_TIMES = ode.Problem(
    {"x": -1.0},
    lambda t, y, args: {"x": 1.0},
    {
        "early": ode.Event(lambda t, y, args: y["x"] - args["u"], direction=1),
        "late": ode.Event(lambda t, y, args: y["x"] - (2 - args["u"]), direction=1),
    },
    time_scale=lambda args: 0.1,
)


def test_a_kink_is_found_where_the_first_event_is_another_one() -> None:
    best = ode.maximum(TWO_TIMES, {"u": 0.0}, of=lambda end: end.t, over="u", between=(-0.5, 2.5))
    assert (best.kind, best.certified, best.jumps) == ("kink", True, ())
    assert (best.at, best.value) == pytest.approx((1.0, 2.0), abs=1e-10)
    assert [each.ended_by for each in best.regimes] == ["early", "late"]
    assert abs(best.slope) == pytest.approx(1.0, abs=1e-9)


def test_a_kink_is_found_that_the_quantity_makes() -> None:
    # min(x, 100 sin α) with x = v² sin 2α/g: crosses where 2 v² cos α/g = 100.
    best = farthest(CANNON, SHOT, of=lambda end: jnp.minimum(end.y["x"], 250 * jnp.sin(end.args["angle"])))
    assert (best.kind, best.certified) == ("kink", True)
    assert best.at == pytest.approx(np.arccos(250 * G / (2 * 50.0**2)), abs=1e-9)
    assert len(best.regimes) == 1


def test_a_plateau_has_two_ends() -> None:
    best = ode.maximum(TWO_TIMES, {"u": 0.0}, of=lambda end: end.t, over="u", between=(-0.5, 2.5), t1=1.5)
    assert (best.kind, best.ended_by, best.certified) == ("plateau", "t1", True)
    assert (best.low, best.at, best.high, best.value) == pytest.approx((0.5, 1.0, 1.5, 1.5), abs=1e-8)
    whole = ode.maximum(TWO_TIMES, {"u": 0.0}, of=lambda end: 0 * end.t, over="u", between=(-0.5, 2.5))
    assert (whole.kind, whole.low, whole.high, whole.value) == ("plateau", -0.5, 2.5, 0.0)


def test_there_is_none_where_all_lanes_fail() -> None:
    lost = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": jnp.sqrt(args["s"] - args["u"])})
    args = {"u": 0.0, "s": np.array([-1.0, 2.0, 0.5])}
    best = ode.maximum(lost, args, of=lambda end: end.y["x"], over="u", between=(0.0, 1.0), t1=1.0)
    assert best.kind.tolist()[:2] == ["none", "boundary"]
    assert best.certified.tolist() == [False, True, False]  # the third fails beyond 0.5
    assert best.ended_by[0] == "failed"
    assert np.isnan([best.at[0], best.value[0]]).all()
    assert (best.at[1], best.value[1]) == pytest.approx((0.0, np.sqrt(2)))
    assert (best.at[2], best.value[2]) == pytest.approx((0.0, np.sqrt(0.5)))


def test_no_value_of_a_scan_is_above_the_maximum() -> None:
    rng = np.random.default_rng(5)
    n = 80
    args = SHOT | {
        "v": rng.uniform(30, 60, n),
        "drag": rng.uniform(0, 0.02, n),
        "wall": rng.uniform(50, 120, n),
        "height": rng.uniform(10, 60, n),
    }
    best = farthest(WALLED, args)
    assert {"interior", "jump"} <= set(best.kind)
    assert best.certified.mean() > 0.98
    scan = scanned(WALLED, args, BETWEEN, 2001)
    assert np.all(best.value >= scan * (1 - 1e-9))
    assert np.median(best.value / scan - 1) < 1e-6
    one = int(np.flatnonzero(best.kind == "jump")[0])
    alone = farthest(
        WALLED, {name: value[one] if isinstance(value, np.ndarray) else value for name, value in args.items()}
    )
    assert [getattr(alone, name) for name in ("at", "value", "slope", "curve", "candidates", "jumps")] == [
        getattr(best, name)[one] for name in ("at", "value", "slope", "curve", "candidates", "jumps")
    ]


def test_derivatives_go_through_any_quantity() -> None:
    def formula(angle):
        time = 100.0 * jnp.sin(angle) / G
        return jnp.exp(50.0 * jnp.cos(angle) * time / 100) * time + angle**2

    def quantity(end):
        return jnp.exp(end.y["x"] / 100) * end.t + end.args["angle"] ** 2

    best = farthest(CANNON, SHOT, of=quantity, between=(0.1, 0.5))
    slope, curve = (jax.jit(each)(0.5) for each in (jax.grad(formula), jax.grad(jax.grad(formula))))
    assert (best.at, best.kind) == (0.5, "boundary")
    assert (best.value, best.slope, best.curve) == pytest.approx(
        tuple(map(float, (formula(0.5), slope, curve))), rel=1e-9
    )


def test_the_least_value() -> None:
    # Between two angles of the same range the lower trajectory is the shorter one.
    best = farthest(CANNON, SHOT, of=lambda end: (end.y["x"] - 100) ** 2, least=True, between=(0.1, 0.7))
    assert (best.kind, best.least, best.certified) == ("interior", True, True)
    assert best.at == pytest.approx(np.arcsin(100 * G / 50**2) / 2, abs=1e-10)
    assert best.value == pytest.approx(0.0, abs=1e-15)
    assert best.curve > 0


def test_over_times_and_parts_of_arguments() -> None:
    # x = ∫ cos: greatest at π/2 over t1, and at t0 = -π/2 over t0.
    swing = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": args["a"][0] * jnp.cos(t)})
    late = ode.maximum(swing, {"a": [1.0]}, of=lambda end: end.y["x"], over="t1", between=(0.2, 4.0))
    assert (late.at, late.value) == pytest.approx((np.pi / 2, 1.0), abs=1e-10)
    early = ode.maximum(
        swing, {"a": [1.0]}, of=lambda end: end.y["x"] + 0 * end.t, over="t0", between=(-3.0, 0.0), t1=1.0
    )
    assert (early.at, early.value) == pytest.approx((-np.pi / 2, 1 + np.sin(1.0)), abs=1e-10)
    part = ode.maximum(
        swing, {"a": [7.0]}, of=lambda end: -((end.y["x"] - 2) ** 2), over="a.0", between=(0.0, 9.0), t1=1.0
    )
    assert part.at == pytest.approx(2 / np.sin(1.0), abs=1e-9)
    length = ode.maximum(swing, {"a": [1.0]}, of=lambda end: end.t, over="t0", between=(-3.0, 0.0), t1=1.0)
    assert (length.kind, length.value) == ("plateau", 1.0)


def test_integrals_and_chains() -> None:
    bouncing = ode.Problem(
        _muzzle,
        _flight,
        {
            "ground": ode.Event(
                lambda t, y, args: y["y"], -1, lambda t, y, args: y | {"y": 0.0 * y["y"], "vy": -0.5 * y["vy"]}
            )
        },
        {"path": lambda t, y, args: y["vx"]},
    )
    best = farthest(bouncing, SHOT, of=lambda end: end.integrals["path"], max_events=3)
    assert (best.kind, best.certified) == ("interior", True)
    assert (best.at, best.value) == pytest.approx((np.pi / 4, 1.75 * 50.0**2 / G), rel=1e-11)


@pytest.mark.parametrize(("low", "scale"), [(0.0, 1e-6), (0.0, 1e8), (1e3, 1.0), (-5.0, 1.0)])
def test_the_unit_of_the_number_does_not_matter(low: float, scale: float) -> None:
    # Two humps, with a jump between.
    line = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": 1.0})

    def humps(end):
        u = (end.args["n"] - low) / scale
        return end.t * jnp.where(u < 0.63, jnp.sin(4 * u), 1.2 - (u - 0.8) ** 2)

    best = ode.maximum(line, {"n": 0.0}, of=humps, over="n", between=(low, low + scale), t1=1.0)
    assert (best.kind, best.certified) == ("interior", True)
    assert (best.at - low) / scale == pytest.approx(0.8, abs=1e-9)
    assert best.value == pytest.approx(1.2, rel=1e-12)
    assert [(jump.at - low) / scale for jump in best.jumps] == pytest.approx([0.63], abs=1e-9)
    assert [each.kind for each in best.candidates] == ["interior", "interior"]


def test_more_points_find_what_is_narrow() -> None:
    # A peak of a thousandth of the range, on a slope: between two of the first numbers nothing shows it.
    line = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": 1.0})

    def peak(end):
        return end.t * (end.args["n"] / 2 + jnp.exp(-(((end.args["n"] - 0.3141) / 3e-4) ** 2)))

    few, many = (
        ode.maximum(line, {"n": 0.0}, of=peak, over="n", between=(0.0, 1.0), t1=1.0, points=points)
        for points in (64, 4000)
    )
    assert few.at == 1.0  # missed, as is said
    assert many.at == pytest.approx(0.3141, abs=1e-5)
    assert many.kind == "interior"


def test_a_maximum_prints_and_is_numbers_by_name() -> None:
    best = farthest(CANNON, SHOT | {"v": np.array([40.0, 50.0])})
    numbers = best.to_dict()
    assert json.loads(to_json(numbers)) == numbers
    assert numbers["at"] == best.at.tolist()
    assert [each[0]["value"] for each in numbers["candidates"]] == numbers["value"]
    assert "2 of 2" in str(best)
    assert "angle" in repr(best)
    text = str(farthest(CANNON, SHOT))
    assert "0.7853981634" in text
    assert "interior" in text


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"over": "speed"}, ValueError, r"Argument `over` .*angle, .*but is 'speed'"),
        ({"over": "wind"}, ValueError, "Argument `over` .*'wind'"),
        ({"between": (1.0, 1.0)}, ValueError, "Argument `between`"),
        ({"between": (0.0, math.inf)}, ValueError, "Argument `between`"),
        ({"of": lambda end: end.y["z"]}, ValueError, r"Argument `of` .*line \d+ of test_maximum.py.*'z'"),
        ({"of": lambda end: end.y}, ValueError, "Argument `of` .*one number"),
        ({"of": lambda end: end.t > 1}, ValueError, "Argument `of` .*bool"),
        ({"of": lambda end: float(end.t)}, ValueError, "Argument `of` .*jnp.where"),
        ({"points": 1}, ValueError, "Argument `points`"),
        ({"rtol": 1e-6}, ValueError, "Argument `rtol`"),
        ({"rtol": "tight"}, ValueError, "Argument `rtol`"),
        ({"over": 3}, TypeError, "Argument `over`"),
        ({"shared": 3}, TypeError, "Argument `shared`"),
        ({"start": "now"}, ValueError, "Argument `start`"),
        ({"t1": None}, ValueError, "Argument `t1`"),
        ({"over": "t0", "between": (0.0, 200.0)}, ValueError, "`t1` must not be before `t0`"),
        ({"shared": ["angle"]}, ValueError, "Argument `over` .*'angle'"),
    ],
)
def test_what_does_not_fit_is_refused(changes, error, message) -> None:
    with pytest.raises(error, match=message):
        farthest(CANNON, SHOT, **changes)


def test_a_search_is_not_traced() -> None:
    with pytest.raises(TypeError, match="JAX"):
        jax.grad(lambda v: farthest(CANNON, SHOT | {"v": v}).value)(50.0)


CONSTANT = ode.Problem(y0=[0.0], vector_field=lambda t, y, args: [args["k"] + 0 * y[0]])


@pytest.mark.parametrize(
    ("quantity", "between", "least", "at", "value"),
    [
        pytest.param(lambda k: k**-12 - k**-6, (0.2, 3.0), True, 2 ** (1 / 6), -0.25, id="Lennard-Jones"),
        pytest.param(lambda k: jnp.log(k) / k, (1e-9, 5.0), False, math.e, 1 / math.e, id="singularity"),
        pytest.param(
            lambda k: jnp.where(k < -0.1, -1e12, jnp.sin(k)), (-1.0, 5.0), False, math.pi / 2, 1, id="penalty"
        ),
    ],
)
def test_what_is_huge_elsewhere_does_not_matter(quantity, between, least, at, value) -> None:
    best = ode.maximum(
        CONSTANT, {"k": 1.0}, of=lambda end: quantity(end.y[0]), over="k", between=between, t1=1.0, least=least
    )
    assert (best.kind, bool(best.certified)) == ("interior", True)
    np.testing.assert_allclose([best.at, best.value], [at, value], rtol=1e-8)


def test_a_plateau_near_zero_may_be_noise() -> None:
    decay = ode.Problem(y0=lambda args: args["a"], vector_field=lambda t, y, args: -y)

    def of(end: Any) -> Any:
        return (end.y * math.e / end.args["a"] - 1.0) - jnp.maximum(end.args["a"] - 0.5, 0.0) ** 3

    best = ode.maximum(decay, {"a": 0.0}, of=of, over="a", between=(0.1, 1.0), t1=1.0)
    assert (best.kind, bool(best.certified)) == ("plateau", True)
    assert abs(best.value) < 1e-9


def test_the_best_lane_counts_where_others_fail() -> None:
    """A spring of stiffness √k, that fails for k < 0, and is so weak near 0 that the lane ends by `t1`."""
    spring = ode.Problem(
        y0={"x": 1.0, "v": 0.0},
        vector_field=lambda t, y, args: {"x": y["v"], "v": -jnp.sqrt(args["k"]) * y["x"]},
        events={"down": ode.Event(lambda t, y, args: y["x"], -1)},
    )
    best = ode.maximum(spring, {"k": 1.0}, of=lambda end: end.t, over="k", between=(-1, 1), t1=10.0)
    assert (float(best.value), best.ended_by, bool(best.certified)) == (10.0, "t1", False)


def test_an_infinite_quantity_is_none() -> None:
    """A pole has no greatest value, and none of NumPy's words is heard; warnings are errors."""
    pole = farthest(CANNON, SHOT, of=lambda end: 1 / (end.args["angle"] - 0.75) + 0.0 * end.t, between=(0.5, 1.0))
    assert not pole.certified
    assert np.isfinite(pole.value)


DECAY = {"y0": {"u": 1.0}, "vector_field": lambda t, y, args: {"u": -y["u"]}}
DOSE = {"reset": lambda t, y, args: {"u": y["u"] + 1}}
TWO_DOSES = ode.Problem(**DECAY, events={"dose": ode.Event(times=[1.0, 2.0], **DOSE)})
DOSE_AT_W = ode.Problem(**DECAY, events={"dose": ode.Event(times=lambda args: [args["w"]], **DOSE)})
BALL = ode.Problem(
    y0={"x": 1.0, "v": 0.0},
    vector_field=lambda t, y, args: {"x": y["v"], "v": -G},
    events={"floor": ode.Event(lambda t, y, args: y["x"], -1, lambda t, y, args: {"x": 0.0, "v": -0.8 * y["v"]})},
)
NEVER = {"never": ode.Event(lambda t, y, args: t - 100, 1, lambda t, y, args: y)}
FINISH = {name: ode.Event(lambda t, y, args, name=name: y[name] - 1, 1) for name in ("x", "y")}
RACE = ode.Problem({"x": 0.0, "y": 0.0}, lambda t, y, args: {"x": args["v"], "y": 1 / args["v"]}, events=FINISH | NEVER)
TO_X = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": args["v"]}, events={"x": FINISH["x"]} | NEVER)


@pytest.mark.parametrize(
    ("problem", "of", "over", "between", "t1", "kind", "at", "value"),
    [
        pytest.param(
            TWO_DOSES, lambda end: end.y["u"], "t1", (0.2, 3.0), None, "jump", 2.0, 1 + math.exp(-1) + math.exp(-2),
            id="doses",
        ),
        pytest.param(
            DOSE_AT_W, lambda end: end.y["u"], "w", (0.2, 1.0), 1.0, "boundary", 1.0, 1 + math.exp(-1),
            id="a dose at the end of the range",
        ),
        pytest.param(
            DOSE_AT_W, lambda end: end.y["u"], "w", (0.2, 2.0), 1.0, "jump", 1.0, 1 + math.exp(-1),
            id="a dose within it",
        ),
        pytest.param(
            BALL, lambda end: jnp.abs(end.y["v"]), "t1", (0.1, 1.2), None, "jump", math.sqrt(2 / G), math.sqrt(2 * G),
            id="a bounce",
        ),
        pytest.param(RACE, lambda end: end.t, "v", (0.5, 2.0), 9.0, "kink", 1.0, 1.0, id="two terminal events"),
        pytest.param(
            TO_X, lambda end: end.y["x"] - 0.2 * end.args["v"], "v", (0.5, 2.0), 1.0, "kink", 1.0, 0.8,
            id="a terminal event and t1",
        ),
    ],
)  # fmt: skip
def test_the_best_of_a_hybrid_trajectory_may_be_where_an_event_is_exactly_at_the_end(
    problem, of, over, between, t1, kind, at, value
) -> None:
    args = {"w": 0.5, "v": 1.0}
    best = ode.maximum(problem, args, of=of, over=over, between=between, t1=t1)
    assert (best.kind, bool(best.certified)) == (kind, True)
    assert best.at == pytest.approx(at, abs=1e-8)
    assert best.value == pytest.approx(value, rel=1e-8)
    assert np.isfinite(best.slope)
