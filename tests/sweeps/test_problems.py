"""Sweeps of any problem: the numbers of `ode.solve`, in memory and block by block."""

from typing import Any

import numpy as np
import pytest

import erosion
from erosion import ode
from erosion.impacts.dataset_files import StoreError
from erosion.sweeps.sweep import SweepInterrupted

ARGS = {"v0": 100.0, "angle": 0.0, "drag": 0.0}
AXES = {"angle": np.linspace(0.1, 1.4, 150), "drag": np.linspace(0.01, 0.2, 150)}


def thrown(gravity: float = 9.81) -> ode.Problem:
    """A ball with linear drag; its velocity is an array."""
    import jax.numpy as jnp

    return ode.Problem(
        y0=lambda args: {
            "x": 0.0,
            "y": 0.0,
            "v": args["v0"] * jnp.stack([jnp.cos(args["angle"]), jnp.sin(args["angle"])]),
        },
        vector_field=lambda t, y, args: {
            "x": y["v"][0],
            "y": y["v"][1],
            "v": -args["drag"] * y["v"] - jnp.array([0.0, gravity]),
        },
        events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
        integrals={"path": lambda t, y, args: jnp.sqrt(y["v"] @ y["v"])},
    )


BALL = thrown()
OPTIONS: dict[str, Any] = {"t1": 100.0, "wrt": "angle", "smooth": True}


@pytest.fixture(scope="module")
def swept():
    return erosion.sweep_problem(BALL, ARGS, AXES, **OPTIONS)


def test_a_sweep_holds_what_solve_gives(swept) -> None:
    angle, drag = np.meshgrid(*AXES.values(), indexing="ij")
    end = ode.solve(BALL, ARGS | {"angle": angle, "drag": drag}, **OPTIONS)
    for name, values in {
        "t": end.t,
        "inexact": end.inexact,
        "y_v_1": end.y["v"][..., 1],
        "integrals_path": end.integrals["path"],
        "dt_dangle": end.along("angle").t,
        "dy_v_dangle_0": end.along("angle").y["v"][..., 0],
    }.items():
        assert np.array_equal(swept[name], values), name
    meanings = swept["ended_by"].attrs["flag_meanings"].split()
    assert {meanings[code] for code in np.unique(swept["ended_by"])} == {"ground"}
    assert swept["t"].dims == ("angle", "drag")


def test_time_may_be_an_axis_and_options_numbers_of_numpy() -> None:
    short = erosion.sweep_problem(
        BALL, ARGS | {"angle": 1.0, "drag": 0.1}, {"t1": [0.5, 1.0, 200.0]}, rtol=np.float64(1e-9)
    )
    meanings = short["ended_by"].attrs["flag_meanings"].split()
    assert [meanings[code] for code in short["ended_by"].values] == ["t1", "t1", "ground"]


def test_a_store_is_filled_block_by_block_and_goes_on(tmp_path, swept) -> None:
    store, seen = tmp_path / "ball.zarr", []

    def interrupt(work: str, done: int, total: int) -> None:
        seen.append(done)
        if len(seen) == 2:
            raise KeyboardInterrupt

    with pytest.raises(SweepInterrupted, match=r"holds 11,250 of 22,500"):
        erosion.sweep_problem(BALL, ARGS, AXES, store=store, chunks={"angle": 75}, progress=interrupt, **OPTIONS)
    rest: list[int] = []
    whole = erosion.sweep_problem(
        BALL, ARGS, AXES, store=store, chunks={"angle": 75}, progress=lambda *done: rest.append(done[1]), **OPTIONS
    )
    assert rest == [11_250, 22_500]
    assert list(whole) == list(swept)
    for name in swept:
        assert np.array_equal(whole[name], swept[name]), name


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"problem": thrown(1.62)}, "problem"),
        ({"args": ARGS | {"v0": 101.0}}, "args.*v0 is 100.0 there, and 101.0 here"),
        ({"axes": {"angle": np.linspace(0.1, 1.5, 3)}}, "axes.*angle is 3 numbers from 0.1 to 1.4"),
        ({"rtol": 1e-6}, "options.*rtol is not there, and 1e-06 here"),
    ],
)
def test_a_store_of_something_else_is_refused(tmp_path, change: dict[str, Any], said: str) -> None:
    axes = {"angle": np.linspace(0.1, 1.4, 3)}
    given: dict[str, Any] = {"problem": BALL, "args": ARGS, "axes": axes, "store": tmp_path / "ball.nc", **OPTIONS}
    first = erosion.sweep_problem(**given)
    # A problem that is written again goes on with its store.
    assert np.array_equal(erosion.sweep_problem(**dict(given, problem=thrown()))["t"], first["t"])
    with pytest.raises(StoreError, match=said):
        erosion.sweep_problem(**given | change)


@pytest.mark.parametrize(
    ("args", "axes", "options", "named"),
    [
        (ARGS, {"mass": [1.0]}, {}, "mass"),
        (ARGS, {"angle": [[1.0]]}, {}, "angle"),
        (ARGS, {"angle": ["a"]}, {}, "angle"),
        (ARGS, {"angle": [np.nan]}, {}, "angle"),
        (ARGS, {}, {}, "axes"),
        (ARGS | {"t1": 1.0}, {"t1": [1.0]}, {}, "t1"),
        (ARGS | {"v0": np.array([1.0, 2.0])}, {"angle": [1.0]}, {}, "args"),
        (ARGS, {"angle": [1.0]}, {"ts": [1.0]}, "ts"),
        (ARGS, {"angle": [1.0]}, {"chunks": {"angle": 1}}, "chunks"),
    ],
)
def test_what_makes_no_sweep_is_refused(args, axes, options, named: str) -> None:
    with pytest.raises(ValueError, match=named):
        erosion.sweep_problem(BALL, args, axes, **({"t1": 100.0} | options))


def test_options_count_to_their_last_digit(tmp_path) -> None:
    axes, still = {"angle": np.linspace(0.1, 1.4, 3)}, {"x": 1.0, "y": 1.0}
    given: dict[str, Any] = {"problem": BALL, "args": ARGS, "axes": axes, "store": tmp_path / "ball.nc", **OPTIONS}
    erosion.sweep_problem(**given, state_scale={**still, "v": np.array([1.0, 1.0])})
    with pytest.raises(StoreError, match="options"):
        erosion.sweep_problem(**given, state_scale={**still, "v": np.array([1.0, 1.0 + 1e-12])})
