"""What a solution prints, tells and gives to others."""

import csv
import json
import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode

PROBLEM = ode.Problem(
    lambda args: {"place": jnp.stack([args["x"], 1.0, 2.0]), "v": args["v"]},
    lambda t, y, args: {"place": jnp.stack([y["v"], y["place"][0], 0.0]), "v": -y["v"] * args["drag"]["k"]},
    {
        "low": ode.Event(lambda t, y, args: y["v"] - 0.5, -1),
        "at the wall": ode.Event(lambda t, y, args: y["place"][0] - 1, 1),
    },
    {"work": lambda t, y, args: y["v"]},
)
ARGS: dict[str, Any] = {"x": 0.0, "v": 1.0, "drag": {"k": 1.0}}


@pytest.fixture(scope="module")
def lane() -> ode.Solution:
    return ode.solve(PROBLEM, ARGS, t1=9.0, wrt=("v", "drag.k"), derivatives=2, ts=np.array([0.0, 0.1, 5.0]))


@pytest.fixture(scope="module")
def lanes() -> ode.Solution:
    return ode.solve(PROBLEM, ARGS | {"v": np.array([[0.4], [0.6], [3.0]]), "x": np.zeros(2)}, t1=9.0)


def test_one_lane_prints_its_numbers(lane):
    text = str(lane)
    cells = {row[0]: row[-1] for row in lane.rows()}
    assert text.startswith("1 lane\n")
    assert cells["ended_by"] == "low"
    assert float(cells["t"]) == pytest.approx(np.log(2))
    assert float(cells["dt_dv"]) == pytest.approx(1)
    assert float(cells["d2t_dv_dv"]) == pytest.approx(-1)
    assert float(cells["d2t_dv_ddrag_k"]) == pytest.approx(-1)
    assert float(cells["y_v"]) == pytest.approx(0.5)
    assert float(cells["integrals_work"]) == pytest.approx(0.5)
    assert all(name in text for name in cells)
    # Values, first derivatives, second ones.
    orders = [name.startswith("d") + name.startswith("d2") for name in cells]
    assert orders == sorted(orders)


def test_tables_are_narrow_and_have_no_empty_columns(lane, lanes):
    for end in (lane, lanes):
        lines = str(end).splitlines()
        assert max(map(len, lines)) <= 80
        assert "unit" not in lines[2]
        assert all(row[-1] for row in end.rows())


def test_many_lanes_print_their_ranges_and_counts(lanes):
    assert str(lanes).startswith("6 lanes\n")
    cells = {row[0]: row[-1] for row in lanes.rows()}
    assert cells["ended_by"] == "2 at the wall, 2 low, 2 t1"
    assert cells["t"].startswith("[3, 2]")
    crowd = ode.solve(PROBLEM, ARGS | {"x": np.linspace(0, 2, 20_000)}, t1=9.0)
    assert crowd.title == "20,000 lanes"
    assert "5,000 at the wall, 15,000 low" in str(crowd)
    assert len(str(crowd)) < 1000
    assert len(repr(crowd)) < 200


def test_repr_and_html(lane):
    assert repr(lane).startswith("Solution(low, t=0.693147")
    assert "<td>d2t_dv_dv</td>" in lane._repr_html_()


def test_to_dict_is_json(lane, lanes):
    content = json.loads(json.dumps(lane.to_dict()))
    assert content["ended_by"] == "low"
    assert content["count"] == 1
    assert content["t"] == pytest.approx(np.log(2))
    assert content["y_place"] == pytest.approx([0.5, 1.0 + np.log(2) - 0.5, 2.0])
    assert content["dt_dv"] == pytest.approx(1)
    assert content["d2t_dv_dv"] == pytest.approx(-1)
    assert content["time"] == [0.0, 0.1, 5.0]
    assert content["y_v_at"][1] == pytest.approx(np.exp(-0.1))
    many = json.loads(json.dumps(lanes.to_dict()))
    assert np.shape(many["y_place"]) == (3, 2, 3)
    assert many["ended_by"][0] == ["t1", "t1"]
    assert "time" not in many


def test_to_dataset_has_all(lane, lanes):
    dataset = lane.to_dataset()
    assert float(dataset["t"]) == pytest.approx(np.log(2))
    assert dataset["ended_by"] == "low"
    assert list(dataset["time"].values) == [0.0, 0.1, 5.0]
    assert dataset["y_place_at"].dims == ("time", "y_place_0")
    assert float(dataset["dt_dv"]) == pytest.approx(1)
    assert float(dataset["d2t_dv_ddrag_k"]) == pytest.approx(-1)
    many = lanes.to_dataset()
    assert many["y_place"].dims == ("lane_0", "lane_1", "y_place_0")
    np.testing.assert_array_equal(many["ended_by"], lanes.ended_by)
    assert many["count"].dtype == np.int32


def test_a_dataset_says_which_numbers_its_lanes_have(tmp_path, lanes):
    import xarray as xr

    dataset = lanes.to_dataset()
    assert set(dataset.coords) == {"x", "v"}
    assert dataset["v"].dims == ("lane_0", "lane_1")
    np.testing.assert_array_equal(dataset["v"], [[0.4, 0.4], [0.6, 0.6], [3.0, 3.0]])
    assert float(dataset["rtol"]) == 1e-9
    assert dataset["events"].dims == ("event",)
    assert list(dataset["events"].values) == ["low", "at the wall"]
    lines = list(csv.DictReader(lanes.to_csv().splitlines()))
    ends = zip(dataset["v"].values.flat, lanes.ended_by.flat, strict=True)
    assert [(float(line["v"]), line["ended_by"]) for line in lines] == list(ends)
    decay = ode.Problem({"k": 1.0}, lambda t, y, args: {"k": -args["y"]["k"] * args["y_k"] * y["k"]})
    many = np.array([1.0, 2.0])
    end = ode.solve(decay, {"y": {"k": many}, "y_k": 2 * many, "lane_0": many, "time": many}, t1=many, ts=[0.0])
    end.to_dataset().to_netcdf(tmp_path / "many.nc")
    with xr.open_dataset(tmp_path / "many.nc") as back:
        assert set(back.coords) == {"y_k_", "y_k__", "lane_0_", "time", "time_", "t1"}
        np.testing.assert_array_equal(back["y_k__"], [2.0, 4.0])
        np.testing.assert_array_equal(back["time_"], back["t1"])


def test_along_takes_names_in_any_order_and_refuses_others(lane, lanes):
    assert lane.along("v", "drag.k") is lane.along("drag.k", "v")
    for names in (("x",), ("v", "x"), (), ("v", "v", "v")):
        with pytest.raises(ValueError, match=r"along.*drag\.k"):
            lane.along(*names)
    with pytest.raises(ValueError, match="none"):
        lanes.along("v")


def test_arguments_that_are_a_number_have_a_name_in_print():
    end = ode.solve(ode.Problem(lambda args: args, lambda t, y, args: -y), 1.0, t1=1.0, wrt=("", "t1"), derivatives=2)
    names = {row[0] for row in end.rows()}
    assert {"y", "dy_dargs", "dy_dt1", "d2y_dargs_dargs", "d2y_dargs_dt1"} <= names
    assert "d2y_dargs_dt1" in end.to_dict()
    assert "d2y_dargs_dt1" in end.to_dataset()


def test_events_are_read_once(lanes):
    assert lanes.events is lanes.events
    assert lanes.events.name.shape == (3, 2, 1)
    assert list(lanes.events.name[:, 0, 0]) == ["", "low", "at the wall"]
    assert lanes.events.y["place"].shape == (3, 2, 1, 3)
    np.testing.assert_array_equal(lanes.events.t[1:, :, 0], lanes.t[1:])


def test_events_and_times_print_in_a_line(lane, lanes) -> None:
    assert repr(lanes.events) == "Passed(2 at the wall, 2 low, t=[3, 2, 1] 0.182322 … 0.405465)"
    assert repr(ode.solve(PROBLEM, ARGS | {"v": 0.1}, t1=1.0).events) == "Passed(no events, t=[0] empty)"
    times = ode.solve(ode.Problem({"x": 1.0}, _growing), {"k": -1.0}, t1=1.0, ts=[0.0, 1.0]).times
    assert repr(times) == "Times(ts=[2] 0 … 1, ys={'x': [2] 0.367879 … 1})"
    assert "integrals={'work': [3] " in repr(lane.times)


def test_derivatives_that_a_root_loses_are_told() -> None:
    thrown = ode.Problem(
        lambda args: {"v": args["v"]},
        lambda t, y, args: {"v": -1.0},
        {"apex": ode.Event(lambda t, y, args: y["v"], -1)},
        {"path": lambda t, y, args: jnp.hypot(y["v"], 2 * y["v"])},
    )
    (sentence,) = ode.solve(thrown, {"v": 1.0}, t1=3.0, wrt="v", derivatives=2).warnings
    assert "root" in sentence


def _falling(t, y, args):
    return {"y": y["v"], "v": -args["g"]}


def _height(t, y, args):
    return y["y"]


def test_a_solution_is_pickled_with_all_that_it_can_tell() -> None:
    problem = ode.Problem({"y": 1.0, "v": 0.0}, _falling, {"ground": ode.Event(_height, -1)})
    kept = ode.solve(problem, {"g": np.array([9.81, 1.62])}, t1=9.0, wrt="g", ts=[0.0, 0.1])
    read = pickle.loads(pickle.dumps(kept))
    assert read.to_dataset().identical(kept.to_dataset())
    np.testing.assert_array_equal(read.events.t, kept.events.t)


@pytest.mark.parametrize("clock", [{"t1": 2.0}, {"t0": 2.0, "t1": 0.0}, {"t0": 1.0, "t1": 2.0}])
def test_states_at_any_times_are_those_at_ts(clock) -> None:
    """Times before the start, after the end and no times at all are among them."""
    ts = [0.5, np.nan, 1.5, 0.1, 9.0]
    options = clock | {"wrt": ("v", "x"), "derivatives": 2}
    end, whole = ode.solve(PROBLEM, ARGS, **options), ode.solve(PROBLEM, ARGS, ts=ts, **options)
    found = end(ts)
    assert whole.times is not None
    assert set(found.derivatives) == set(whole.times.derivatives)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(whole.times), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_state_at_a_traced_time_has_a_derivative() -> None:
    decay = ode.Problem(1.0, lambda t, y, args: -args * y)
    at = lambda t: ode.solve(decay, 2.0, t1=9.0)(t[None]).ys[0]  # noqa: E731
    assert jax.jit(jax.grad(at))(0.5) == pytest.approx(-2 * np.exp(-1.0), rel=1e-8)


@pytest.mark.parametrize("read", [lambda end: end.events.t, lambda end: end.gradient(t=1.0), lambda end: end([0.1])])
def test_what_is_computed_later_belongs_to_what_was_solved(read) -> None:
    """Elsewhere the newest code counts; here it would give another motion's numbers beside those of the solution."""
    rate = {"k": 1.0}
    decay = ode.Problem(
        y0=lambda args: {"y": args["start"]},
        vector_field=lambda t, y, args: {"y": -rate["k"] * y["y"]},
        events={"half": ode.Event(lambda t, y, args: y["y"] - 0.5, -1)},
    )
    for derivatives, wrt in ((0, ()), (1, "start")):
        end = ode.solve(decay, {"start": 1.0}, t1=9.0, wrt=wrt, derivatives=derivatives)
        rate["k"] = 2.0
        with pytest.raises(ValueError, match="solve it again"):
            read(end)
        rate["k"] = 1.0
        assert read(end)


@pytest.mark.parametrize(
    "start",
    [
        {"a": {"b": 1.0}, "a_b": 2.0, "a.b": 3.0},
        {"a": 1.0, "a_at": 2.0},
        {"a": np.array([1.0, 2.0]), "a_0": 3.0},
        {"{a}": 1.0, "t": 2.0},
    ],
)
def test_a_dataset_holds_all_parts_whatever_they_are_called(start) -> None:
    """Dots become underscores there, and the same name twice was one variable."""
    problem = ode.Problem(
        start, lambda t, y, args: jax.tree.map(lambda part: args["{k}.l"] * args["{k}"]["l"] * part, y)
    )
    end = ode.solve(problem, {"{k}.l": 2.0, "{k}": {"l": 3.0}, "{k}_l": 1.0}, t1=0.1, wrt="{k}_l", ts=[0.0, 0.1])
    dataset, parts = end.to_dataset(), len(jax.tree.leaves(start))
    # ended_by, t, count, inexact, rtol; dt; and each part four times: at the end, at times, and both differentiated.
    dataset = dataset.drop_vars("events")
    assert len(dataset.data_vars) == 6 + 4 * parts
    kept = sorted(values.size for values in dataset.data_vars.values())
    assert kept == sorted(
        [1] * 6
        + 2 * [np.size(part) for part in jax.tree.leaves(start)]
        + 2 * [2 * np.size(part) for part in jax.tree.leaves(start)]
    )


BALL = ode.Problem(
    {"y": 1.0, "v": 0.0},
    lambda t, y, args: {"y": y["v"], "v": -9.81},
    {"bounce": ode.Event(lambda t, y, args: y["y"], -1, lambda t, y, args: {"y": 0.0, "v": -args["r"] * y["v"]})},
)


def test_a_chain_that_no_event_follows_is_not_said_to_accumulate_alone() -> None:
    """From 1 down to the floor, back, and away for ever."""
    problem = ode.Problem(
        {"x": 1.0, "v": -1.0},
        lambda t, y, args: {"x": y["v"], "v": 0.0 * y["v"]},
        {"floor": ode.Event(lambda t, y, args: y["x"], -1, lambda t, y, args: {"x": 0.0, "v": -y["v"]})},
        time_scale=lambda args: args["scale"],
    )
    (said,) = ode.solve(problem, {"scale": 1.0}).warnings
    assert all(part in said for part in ("unfinished", "none follows", "`t1`"))


@pytest.mark.parametrize("wrt", [(), "r", ("r", "t0")])
def test_events_that_accumulate_are_told_with_their_time(wrt) -> None:
    (sentence,) = ode.solve(BALL, {"r": np.array([0.5, 1.0])}, t1=6.0, max_events=100, wrt=wrt).warnings
    assert f"1 of 2 lanes is unfinished at t = {3 * np.sqrt(2 / 9.81):.6g}" in sentence  # √(2h/g) (1 + r)/(1 - r)
    most = int(sentence.rstrip(".").split()[-1])
    assert ode.solve(BALL, {"r": 0.5}, t1=6.0, max_events=most).ended_by == "bounce"


def _growing(t, y, args):
    return {"x": args["k"] * y["x"]}


def test_too_few_trials_are_told_with_what_was_reached() -> None:
    problem = ode.Problem({"x": 1.0}, _growing)
    for wrt, derivatives in (((), 0), ("k", 1)):
        end = ode.solve(problem, {"k": -1.0}, t1=50.0, max_steps=2, wrt=wrt, derivatives=derivatives)
        assert end.ended_by == "unfinished"
        (sentence,) = end.warnings  # no derivative is told to be missing
        assert f"after 2 trials of steps at t = {end.t:.6g}: raise `max_steps`" in sentence
    by_one = ode.solve(problem, {"k": -1e6}, t1=50.0, max_steps=9, method="explicit")
    assert "`method`" in by_one.warnings[0]
    endless = ode.Problem({"x": 1.0}, _growing, time_scale=lambda args: 1.0)
    (sentence,) = ode.solve(endless, {"k": 0.0}).warnings
    assert "no event came" in sentence


def test_numbers_that_are_none_are_told_by_name() -> None:
    problem = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": args["k"] * args["drag"]["w"][0] * y["x"]})
    ks, w = np.array([1.0, np.nan, np.inf]), np.ones(2)
    (sentence,) = ode.solve(problem, {"k": ks, "drag": {"w": w}}, t1=1.0, shared="drag.w", wrt="k").warnings
    assert sentence.startswith("2 of 3 lanes failed: `k` is NaN or infinite")
    (sentence,) = ode.solve(problem, {"k": 1.0, "drag": {"w": w / [1, np.nan]}}, t1=1.0, shared="drag.w").warnings
    assert "`drag.w` is NaN there" in sentence
    (sentence,) = ode.solve(problem, {"k": 1.0, "drag": {"w": 1.0 * w}}, t1=[1.0, np.nan], shared="drag.w").warnings
    assert "`t1` is NaN there" in sentence


def test_a_function_without_a_value_at_the_start_is_told_by_name() -> None:
    ks, log = np.array([-1.0, 1.0]), lambda t, y, args: jnp.log(args["k"]) + y["x"]
    flat = lambda t, y, args: {"x": -y["x"]}  # noqa: E731
    problems = {
        "y0": ode.Problem(lambda args: {"x": jnp.sqrt(args["k"])}, flat),
        "vector_field": ode.Problem({"x": 1.0}, lambda t, y, args: {"x": log(t, y, args)}),
        "integrals['work']": ode.Problem({"x": 1.0}, flat, integrals={"work": log}),
        "events['low']": ode.Problem({"x": 1.0}, flat, {"low": ode.Event(log)}),
        "time_scale": ode.Problem({"x": 1.0}, flat, time_scale=lambda args: jnp.sqrt(args["k"])),
    }
    for name, problem in problems.items():
        end = ode.solve(problem, {"k": ks}, t1=1.0)
        assert list(end.ended_by) == ["failed", "t1"]
        (sentence,) = end.warnings
        assert sentence.startswith(f"1 of 2 lanes failed at the start: `{name}` is NaN")


def test_a_lane_that_fails_on_the_way_tells_about_when() -> None:
    """ẋ = x²: x = 1/(1/x0 - t). ẋ = -√x - 1 reaches 0 after 2 (1 - ln 2)."""
    grows = ode.Problem(lambda args: {"x": args}, lambda t, y, args: {"x": y["x"] ** 2})
    (sentence,) = ode.solve(grows, np.array([0.1, 1.0, 2.0]), t0=1.0, t1=3.0).warnings
    assert "2 of 3 lanes failed at t = 1.5 … 2:" in sentence
    (sentence,) = ode.solve(grows, 1.0, t1=3.0, wrt="").warnings
    assert "at t = 1:" in sentence
    falls = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -jnp.sqrt(y["x"]) - 1})
    (sentence,) = ode.solve(falls, t1=3.0).warnings
    assert f"at t = {2 * (1 - np.log(2)):.4g}:" in sentence
    endless = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": y["x"] ** 2}, time_scale=lambda args: 0.1)
    (sentence,) = ode.solve(endless).warnings
    assert "failed at t = 1:" in sentence


def test_a_lane_that_fails_where_a_segment_begins_tells_when() -> None:
    """A rate or a reset is NaN from there on; the message has the time of every such lane."""
    breaks = ode.Problem({"u": 0.0}, lambda t, y, args: {"u": jnp.where(t > args["w"], jnp.nan, 1.0)})
    (sentence,) = ode.solve(breaks, {"w": 2.0}, t1=3.0).warnings
    assert "failed at t = 2:" in sentence
    (sentence,) = ode.solve(breaks, {"w": -2.0}, t0=-3.0, t1=-1.0).warnings
    assert "failed at t = -2:" in sentence
    table = jnp.array([0.0, 1.0, 2.0])
    ends = ode.Problem({"u": 0.0}, lambda t, y, args: {"u": jnp.interp(t, table, table, right=jnp.nan)})
    (sentence,) = ode.solve(ends, t1=3.0).warnings
    assert "failed at t = 2:" in sentence
    there = ode.Event(lambda t, y, args: y["x"] - 0.5, 1, lambda t, y, args: {"x": jnp.sqrt(-y["x"])})
    resets = ode.Problem({"x": 0.0}, lambda t, y, args: {"x": args["v"]}, events={"there": there})
    (sentence,) = ode.solve(resets, {"v": np.array([0.1, 1.0, 2.0])}, t1=3.0).warnings
    assert "2 of 3 lanes failed at t = 0.25 … 0.5:" in sentence
    # ẏ = y² fails at 1 by itself.
    either = ode.Problem(
        {"y": 1.0},
        lambda t, y, args: {"y": jnp.where(t > args["w"], jnp.nan, jnp.where(args["w"] > 5, y["y"] ** 2, 1.0))},
    )
    (sentence,) = ode.solve(either, {"w": np.array([2.0, 9.0])}, t1=3.0).warnings
    assert "failed at t = 1 … 2:" in sentence
