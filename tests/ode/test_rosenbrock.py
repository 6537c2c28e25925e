"""The method for stiff motions, against published numbers, scipy's Radau, differences and the explicit method."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.ode_problems import MichaelisMenten
from erosion import ode
from erosion.ode.methods.rodas5p import Rodas5P
from erosion.ode.methods.rosenbrock_steps import Sparse, columns_together, least_fill

STIFF: Any = {"method": "rosenbrock"}


def robertson(event: Callable[[Any], Any], direction: int) -> ode.Problem:
    """Robertson's reactions: H. H. Robertson, in Numerical Analysis (Academic Press, 1966) 178-182."""

    def rates(t: Any, y: Any, args: Any) -> Any:
        first, second, third = 0.04 * y["a"], 3e7 * y["b"] ** 2, args["k3"] * y["b"] * y["c"]
        return {"a": third - first, "b": first - third - second, "c": second}

    return ode.Problem(
        y0={"a": 1.0, "b": 0.0, "c": 0.0},
        vector_field=rates,
        events={"root": ode.Event(lambda t, y, args: event(y), direction=direction)},
    )


EARLY, LATE = robertson(lambda y: y["c"] - 0.01, 1), robertson(lambda y: y["a"] - 1e-4, -1)


@pytest.mark.parametrize(("problem", "t", "tolerance"), [
    # Radau at 1e-12 gives these digits; SUNDIALS prints 2.6391e-01 and 2.0790e+07 for its example cvRoberts.
    (EARLY, 0.2640190781876, 1e-10), (LATE, 20795496.883, 1e-9),
], ids=["early", "late"])  # fmt: skip
def test_robertsons_roots(problem: ode.Problem, t: float, tolerance: float) -> None:
    end = ode.solve(problem, {"k3": 1e4}, t1=1e11, rtol=1e-9, **STIFF)
    assert end.ended_by == "root"
    np.testing.assert_allclose(end.t, t, rtol=tolerance)
    np.testing.assert_allclose(end.y["a"] + end.y["b"] + end.y["c"], 1, rtol=1e-12)


@pytest.mark.parametrize("problem", [EARLY, LATE], ids=["early", "late"])
def test_first_derivatives_are_those_of_differences(problem: ode.Problem) -> None:
    h = 1e-4
    k3 = 1e4 * np.array([0.7, 1.0, 1.3])
    end = ode.solve(problem, {"k3": k3}, t1=1e11, wrt="k3", rtol=1e-8, **STIFF)
    up, down = (ode.solve(problem, {"k3": k3 * (1 + s * h)}, t1=1e11, rtol=1e-11, **STIFF) for s in (1, -1))
    expected = (up.t - down.t) / (2 * h * k3)  # errs by h²
    np.testing.assert_allclose(end.along("k3").t, expected, rtol=1e-6)
    change = (up.y["b"] - down.y["b"]) / (2 * h * k3)
    np.testing.assert_allclose(end.along("k3").y["b"], change, rtol=1e-5, atol=1e-16)


OSCILLATOR = ode.Problem(
    y0={"x": 2.0, "v": 0.0},
    vector_field=lambda t, y, args: {"x": y["v"], "v": args["mu"] * (1 - y["x"] ** 2) * y["v"] - y["x"]},
    events={"zero": ode.Event(lambda t, y, args: y["x"])},
    integrals={"path": lambda t, y, args: y["x"]},
)


def test_the_same_event_for_any_tolerance() -> None:
    mu = np.linspace(500, 1500, 9)
    ends = [ode.solve(OSCILLATOR, {"mu": mu}, t1=1e4, rtol=rtol, **STIFF) for rtol in (1e-5, 1e-9)]
    assert all(np.all(end.ended_by == "zero") for end in ends)
    np.testing.assert_allclose(ends[0].t, ends[1].t, rtol=1e-5)
    # The slow part ends with x = 1 after μ (3/2 - ln 2), and Airy's zero of that fold adds 3.5 μ^(-1/3): Hairer and
    # Wanner, Solving Ordinary Differential Equations II (Springer, 1996), chapter VI.
    np.testing.assert_allclose(ends[1].t, mu * (1.5 - np.log(2)) + 3.5 * mu ** (-1 / 3), rtol=2e-3)


@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
def test_an_end_a_little_before_an_event(rtol: float) -> None:
    """Or steps that may not be as long as the way to the event."""
    event = ode.solve(EARLY, {"k3": 1e4}, t1=1e3, rtol=rtol, **STIFF)
    before = np.array([1e-6, 1e-4, 1e-3, 1e-2, 0.05])
    end = ode.solve(EARLY, {"k3": 1e4}, t1=event.t * (1 - before), rtol=rtol, **STIFF)
    assert set(end.ended_by) == {"t1"}
    expected = ode.solve(EARLY, {"k3": 1e4}, t1=event.t * (1 - before), rtol=1e-10, method="explicit")
    np.testing.assert_allclose(end.y["c"], expected.y["c"], rtol=1e-8)
    for steps in (2.1, 3.3, 10.1):
        end = ode.solve(EARLY, {"k3": 1e4}, t1=1e3, max_step=event.t / steps, rtol=rtol, **STIFF)
        assert end.ended_by == "root"
        np.testing.assert_allclose(end.t, event.t, rtol=1e-7)


def test_a_lane_out_of_steps_has_no_states_that_it_did_not_reach() -> None:
    times = np.array([0.0, 1e-9, 1e-4, 0.01, 0.26])
    for wrt in ((), "k3"):
        end = ode.solve(EARLY, {"k3": np.array([1e4, 2e4])}, t1=1e3, ts=times, max_steps=3, wrt=wrt, **STIFF)
        assert set(end.ended_by) == {"unfinished"}
        np.testing.assert_array_equal(np.isnan(end.ys["c"]), [[False, *[True] * 4]] * 2)


@pytest.mark.parametrize("derivatives", [0, 1])
def test_a_number_that_is_always_zero(derivatives: int) -> None:
    """Such as a switch that is off; the motion is that without it."""

    def falling(**more: float) -> Any:
        def rates(t: Any, y: Any, args: Any) -> Any:
            moving = {"z": args["v"] + y["tilt"], "tilt": -1e4 * (y["tilt"] - jnp.sin(y["z"]))}
            return moving | {key: 0.0 * y[key] for key in more}

        problem = ode.Problem(
            {"z": 50.0, "tilt": 0.3, **more}, rates, {"ground": ode.Event(lambda t, y, args: y["z"], direction=-1)}
        )
        wrt = {"wrt": "v", "derivatives": derivatives} if derivatives else {}
        return ode.solve(problem, {"v": -5.0}, t1=60.0, **wrt)

    end, without = falling(switch=0.0), falling()
    assert (end.ended_by, end.stiff) == ("ground", True)
    np.testing.assert_allclose(end.t, without.t, rtol=1e-9)
    if derivatives:
        np.testing.assert_allclose(end.along("v").t, without.along("v").t, rtol=1e-5)


def test_an_unfinished_lane_of_a_stiff_motion_with_kinks_says_what_to_write() -> None:
    rates = lambda t, y, args: {"y": -1e6 * jnp.hypot(y["y"] - jnp.cos(t), 1e-6)}  # noqa: E731
    end = ode.solve(ode.Problem({"y": 2.0}, rates), t1=100.0, max_steps=300)
    assert end.ended_by == "unfinished"
    assert "`smooth=True`" in " ".join(end.warnings)
    smooth = " ".join(ode.solve(OSCILLATOR, {"mu": 1e3}, t1=1e4, max_steps=3).warnings)
    assert "`max_steps`" in smooth
    assert "`smooth=True`" not in smooth


def test_an_unfinished_lane_that_rests_at_its_event_says_what_to_write() -> None:
    rates = lambda t, y, args: {"h": -args["k"] * jnp.sqrt(y["h"])}  # noqa: E731  Torricelli's law: a tank runs dry
    dry, almost = (
        ode.Problem({"h": 1.0}, rates, {"dry": ode.Event(lambda t, y, args, rest=rest: y["h"] - rest, direction=-1)})
        for rest in (0.0, 1e-12)
    )
    k = np.array([0.5, 2.0])
    said = ode.solve(dry, {"k": k}, t1=100.0)
    assert (said.ended_by == "unfinished").all()
    assert "`h - 1e-12`" in " ".join(said.warnings)
    end, t = ode.solve(almost, {"k": k}, t1=100.0, wrt="k"), 2 * (1 - 1e-6) / k
    assert (end.ended_by == "dry").all()
    np.testing.assert_allclose(end.t, t, rtol=1e-12)
    np.testing.assert_allclose(end.along("k").t, -t / k, rtol=1e-10)


def test_in_jax() -> None:
    """By "auto" as well as outside, where the lane turns out to be stiff."""
    value, slope = jax.jit(jax.value_and_grad(lambda k3: ode.solve(EARLY, {"k3": k3}, t1=1e3).t))(1e4)
    end = ode.solve(EARLY, {"k3": 1e4}, t1=1e3, wrt="k3")
    assert end.stiff
    np.testing.assert_allclose([value, slope], [end.t, end.along("k3").t], rtol=1e-9)


@pytest.mark.parametrize("method", ["rosenbrock", "auto"])
def test_second_derivatives_are_none_and_first_ones_are_those_without_them(method: str) -> None:
    q = {"mu": np.array([800.0, 1000.0]), "x0": 2.0}
    problem = dataclasses.replace(OSCILLATOR, y0=lambda args: {"x": args["x0"], "v": 0.0})
    both = {"t1": 1e4, "wrt": ("mu", "x0"), "rtol": 1e-7, "method": method}
    end, first = ode.solve(problem, q, derivatives=2, **both), ode.solve(problem, q, **both)
    assert set(end.ended_by) == set(first.ended_by) == {"zero"}
    for name in both["wrt"]:
        assert np.array_equal(end.along(name).t, first.along(name).t)
    assert np.isnan(end.along("mu", "x0").t).all()
    assert np.isnan(end.along("mu", "mu").y["v"]).all()
    (*_, last) = end.warnings
    assert "2 of 2 lanes that are stiff" in last


def test_a_chain_whose_resets_change_nothing() -> None:
    """After each of them a number is zero but for rounding."""
    zeros = {"zero": ode.Event(lambda t, y, args: y["x"], reset=lambda t, y, args: y)}
    counted = dataclasses.replace(OSCILLATOR, events=zeros)
    end = ode.solve(counted, {"mu": 1000.0}, t1=3e3, max_events=3, rtol=1e-7, **STIFF)
    assert end.count == 3
    np.testing.assert_allclose(end.events.t, [807.08474082, 1614.28530372, 2421.48586662], rtol=1e-7)  # Radau, 1e-12


def test_an_event_of_a_number_far_below_its_size_needs_sizes() -> None:
    decay = ode.Problem(
        y0={"y": 1.0},
        vector_field=lambda t, y, args: {"y": -y["y"]},
        events={"tiny": ode.Event(lambda t, y, args: jnp.log(y["y"]) + 100)},
    )
    assert ode.solve(decay, t1=1e4, **STIFF).ended_by == "failed"
    np.testing.assert_allclose(ode.solve(decay, t1=1e4, state_scale=1e-50, **STIFF).t, 100, rtol=1e-8)


def test_the_program_finds_the_stiff_lanes() -> None:
    """Each lane has the bits of the method that it is integrated by, whatever its neighbours are."""
    args = {"mu": np.array([1.0, 1000.0, 3.0, 500.0])}
    for order in range(2):
        wrt = "mu" if order else ()
        end, explicit, stiff = (
            ode.solve(OSCILLATOR, args, t1=1e4, rtol=1e-7, wrt=wrt, derivatives=order, method=method, max_steps=2000)
            for method in ("auto", "explicit", "rosenbrock")
        )
        np.testing.assert_array_equal(end.stiff, [False, True, False, True])
        np.testing.assert_array_equal(end.ended_by, "zero")
        np.testing.assert_array_equal(end.t, np.where(np.asarray(end.stiff), stiff.t, explicit.t))
        for names in (("mu",), ("mu", "mu"))[:order]:
            expected = np.where(np.asarray(end.stiff), stiff.along(*names).t, explicit.along(*names).t)
            np.testing.assert_array_equal(end.along(*names).t, expected)
    both = dataclasses.replace(OSCILLATOR, y0=lambda args: {"x": args["x0"], "v": 0.0})
    end = ode.solve(both, {**args, "x0": 2.0}, t1=1e4, rtol=1e-7, wrt=("mu", "x0"))
    np.testing.assert_array_equal(end.stiff, [False, True, False, True])
    np.testing.assert_allclose(end.along("mu").t[1], 0.8068526, rtol=1e-3)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_steps_that_errors_of_fast_parts_make_short_are_stiff_as_well(rtol: float) -> None:
    """They are far shorter than those that stability allows; steps of a slow decay to its end are not meant."""
    assert ode.solve(EARLY, {"k3": 1e4}, t1=1e3, wrt="k3", rtol=rtol).stiff
    dose = MichaelisMenten()
    lanes = dose.sample(64, np.random.default_rng(38))
    assert not np.any(ode.solve(dose.problem(), lanes, t1=dose.t1, smooth=True, rtol=rtol).stiff)


def test_a_lane_out_of_steps_shows_what_the_explicit_method_reached() -> None:
    swing = ode.Problem({"x": 1.0, "v": 0.0}, lambda t, y, args: {"x": y["v"], "v": -args["k"] * y["x"]})
    auto, explicit = (
        ode.solve(swing, {"k": np.array([1.0, 2.0])}, t1=1e4, max_steps=60, method=each)
        for each in ("auto", "explicit")
    )
    assert np.all(auto.ended_by == "unfinished")
    assert not np.any(auto.stiff)
    np.testing.assert_array_equal(auto.t, explicit.t)
    np.testing.assert_array_equal(auto.y["x"], explicit.y["x"])


def test_a_stiff_lane_that_the_method_does_not_take_stays_explicit() -> None:
    size = lambda x: jnp.sqrt(x**2 + 1e-9)  # noqa: E731
    kinked = ode.Problem(
        y0={"y": 2.0},
        vector_field=lambda t, y, args: {"y": -1e3 * (y["y"] - jnp.cos(t)) * (1 + 0 * size(y["y"]))},
    )
    end = ode.solve(kinked, t1=1.0, rtol=1e-6)
    assert end.ended_by == "t1"
    assert not end.stiff
    np.testing.assert_allclose(end.y["y"], (1e6 * np.cos(1) + 1e3 * np.sin(1)) / (1e6 + 1), rtol=1e-5)


def test_what_it_does_not_do_is_refused() -> None:
    kinked = ode.Problem(y0={"x": 1.0}, vector_field=lambda t, y, args: {"x": -jnp.cbrt(y["x"])})
    with pytest.raises(ValueError, match="smooth=True"):
        ode.solve(kinked, t1=1.0, **STIFF)


def test_the_factors_of_a_sparse_matrix() -> None:
    random = np.random.default_rng(0)
    pattern = random.random((7, 7)) < 0.35
    sparse, j = Sparse(pattern), np.where(pattern, random.normal(size=(7, 7)), 0.0)
    factors = sparse.factors([jnp.asarray(j[place]) for place in sparse.places], jnp.asarray(5.0))
    x = sparse.solve(factors, [jnp.asarray(float(i)) for i in range(7)])
    assert factors.sound
    np.testing.assert_allclose((5.0 * np.eye(7) - j) @ np.array(x), np.arange(7.0), atol=1e-13)


@pytest.mark.parametrize("entry", [1.0, 1.0 + 1e-15])
def test_a_pivot_that_cancels_is_not_sound(entry: float) -> None:
    assert not Sparse(np.ones((1, 1), bool)).factors([jnp.asarray(entry)], jnp.asarray(1.0)).sound


def test_an_event_function_that_bends_far_more_than_the_motion() -> None:
    bent = robertson(lambda y: jnp.expm1(3e3 * (y["c"] / 0.01 - 1)), 1)
    end, expected = (ode.solve(each, {"k3": 1e4}, t1=1e11, wrt="k3", rtol=1e-7, **STIFF) for each in (bent, EARLY))
    np.testing.assert_allclose(end.t, expected.t, rtol=1e-9)
    np.testing.assert_allclose(end.along("k3").t, expected.along("k3").t, rtol=1e-7)


def test_an_arrow_is_eliminated_without_fill() -> None:
    arrow = np.eye(5, dtype=bool)
    arrow[0], arrow[:, 0] = True, True
    assert least_fill(arrow)[-1] == 0 or least_fill(arrow)[-2] == 0
    assert Sparse(arrow).size < Sparse(np.ones((5, 5), bool)).size / 2
    assert len(columns_together(np.eye(5, dtype=bool))) == 1
    assert [len(row) for row in Rodas5P.tableau.a] == [1, 2, 3, 4, 5, 6, 7]
