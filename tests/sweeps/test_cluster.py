"""Sweeps on a real Dask cluster of two processes, and the death of workers and clients.

Sweeps of any problem: the numbers of `ode.solve`, in memory and block by block.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion import StoreError, SweepInterrupted, ode, sweep
from tests.sweeps.test_sweep import assert_same_bits

distributed = pytest.importorskip("distributed")

P = erosion.TABLE_1
AXES: dict[str, Any] = {"alpha": np.deg2rad(np.linspace(1, 90, 400)), "v0": np.linspace(2200.0, 4400.0, 300)}
CHUNKS = {"alpha": 50}  # 8 blocks of 15 000 impacts


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    return sweep("linearized", P, **AXES)


@pytest.fixture(scope="module")
def client() -> Iterator:
    from erosion.impacts.cluster import local_cluster

    with local_cluster(2) as cluster, distributed.Client(cluster) as client:
        yield client


def state_of_worker() -> tuple[int, bool, str]:
    import jax

    return len(os.sched_getaffinity(0)), bool(jax.config.jax_enable_x64), jax.numpy.ones(1).dtype.name  # pyright: ignore


@pytest.mark.slow
def test_a_cluster_computes_the_same_bits(client, whole, tmp_path):
    dataset = sweep("linearized", P, store=tmp_path / "out.zarr", chunks=CHUNKS, **AXES)
    assert dataset.volume.chunksizes["alpha"] == (50,) * 8
    assert_same_bits(dataset.compute(), whole)
    # One core each, and float64.
    states = client.run(state_of_worker)
    assert list(states.values()) == [(1, True, "float64")] * 2
    if len(os.sched_getaffinity(0)) > 1:
        cores = client.run(os.sched_getaffinity, 0)
        assert len(set.union(*cores.values())) == 2


@pytest.mark.slow
def test_the_death_of_a_worker_is_no_matter(client, whole, tmp_path):
    pids = client.run(os.getpid)
    killed = []

    def kill_one(work: str, done: int, total: int) -> None:
        if done and not killed:
            killed.append(next(iter(pids.values())))
            os.kill(killed[0], signal.SIGKILL)

    dataset = sweep("linearized", P, store=tmp_path / "out.zarr", chunks=CHUNKS, progress=kill_one, **AXES)
    assert killed
    assert_same_bits(dataset.compute(), whole)


@pytest.mark.slow
def test_a_plug_in_is_given_by_its_path(client, tmp_path):
    path = Path(__file__).parents[2] / "models" / "coulomb_tip.py"
    with pytest.raises(
        ValueError, match="`model` must be the path of a plug-in where a cluster computes, but is a model"
    ):
        sweep(erosion.load_model(path), P, store=tmp_path / "object.zarr", chunks=CHUNKS, **AXES)
    stored = sweep(path, P, store=tmp_path / "path.zarr", chunks=CHUNKS, **AXES)
    assert_same_bits(stored.compute(), sweep(path, P, **AXES))


@pytest.mark.slow
def test_workers_of_several_threads_are_refused(tmp_path):
    from distributed import Client, LocalCluster

    from erosion.impacts.cluster import active_client

    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address="localhost:0") as cluster,
        Client(cluster),
        pytest.raises(ValueError, match="must have one thread each"),
    ):
        active_client()


@pytest.mark.slow
def test_a_killed_client_is_resumed(whole, tmp_path):
    """SIGKILL of the process itself; the same sweep then goes on and ends with the same bits."""
    path = tmp_path / "out.zarr"
    code = f"""
import numpy as np, erosion
erosion.sweep("linearized", erosion.TABLE_1, store={str(path)!r}, chunks={CHUNKS!r},
              alpha=np.deg2rad(np.linspace(1, 90, 400)), v0=np.linspace(2200.0, 4400.0, 300),
              progress=lambda work, done, total: print(done, flush=True))
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        for line in child.stdout:
            if int(line) >= 30_000:
                break
        child.kill()
    assert child.returncode == -signal.SIGKILL
    seen = []
    progress = lambda work, done, total: seen.append(done)  # noqa: E731
    dataset = sweep("linearized", P, store=path, chunks=CHUNKS, progress=progress, **AXES)
    assert 30_000 <= seen[0] < dataset.volume.size or len(seen) == 1
    assert seen[-1] == dataset.volume.size
    assert_same_bits(dataset.compute(), whole)


@pytest.mark.slow
def test_importing_the_cluster_leaves_jax_alone():
    code = "import sys, erosion.impacts.cluster; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120, check=False).returncode == 0


ARGS = {"v0": 100.0, "angle": 0.0, "drag": 0.0}
GRID = {"angle": np.linspace(0.1, 1.4, 150), "drag": np.linspace(0.01, 0.2, 150)}


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
    return erosion.sweep_problem(BALL, ARGS, GRID, **OPTIONS)


def test_a_sweep_holds_what_solve_gives(swept) -> None:
    angle, drag = np.meshgrid(*GRID.values(), indexing="ij")
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
        erosion.sweep_problem(BALL, ARGS, GRID, store=store, chunks={"angle": 75}, progress=interrupt, **OPTIONS)
    rest: list[int] = []
    whole = erosion.sweep_problem(
        BALL, ARGS, GRID, store=store, chunks={"angle": 75}, progress=lambda *done: rest.append(done[1]), **OPTIONS
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


@pytest.mark.slow
def test_workers_of_a_cluster_compute_the_same_bits(tmp_path, swept) -> None:
    with erosion.local_cluster(2):
        lazy = erosion.sweep_problem(BALL, ARGS, GRID, store=tmp_path / "ball.zarr", chunks={"angle": 75}, **OPTIONS)
        assert np.array_equal(lazy["dt_dangle"].values, swept["dt_dangle"])
