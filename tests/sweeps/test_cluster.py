"""Sweeps on a real Dask cluster of two processes, and the death of workers and clients."""

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
from erosion.sweeps.sweep import sweep
from tests.sweeps.test_problems import ARGS, AXES as BALL_AXES, BALL, OPTIONS
from tests.sweeps.test_sweep import assert_same_bits

distributed = pytest.importorskip("distributed")

P = erosion.TABLE_1.to("si")
# One model for all, so that each worker compiles one program.
PLUG_IN = Path(__file__).parents[2] / "models" / "coulomb_tip.py"
AXES: dict[str, Any] = {"alpha": np.deg2rad(np.linspace(1, 90, 400)), "v0": np.linspace(55.88, 111.76, 200)}
CHUNKS = {"alpha": 50}  # 8 blocks of 10 000 impacts


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    return sweep(PLUG_IN, P, **AXES)


@pytest.fixture(scope="module")
def client() -> Iterator:
    from erosion.impacts.cluster import local_cluster

    with local_cluster(2) as cluster, distributed.Client(cluster) as client:
        client.wait_for_workers(2)
        yield client


def state_of_worker() -> tuple[int, bool, str]:
    import jax

    return len(os.sched_getaffinity(0)), bool(jax.config.jax_enable_x64), jax.numpy.ones(1).dtype.name  # pyrefly: ignore


def test_any_problem_is_computed_to_the_same_bits(client, tmp_path):
    lazy = erosion.sweep_problem(BALL, ARGS, BALL_AXES, store=tmp_path / "ball.zarr", chunks={"angle": 75}, **OPTIONS)
    alone = erosion.sweep_problem(BALL, ARGS, BALL_AXES, **OPTIONS)
    assert np.array_equal(lazy["dt_dangle"].values, alone["dt_dangle"])


def test_a_cluster_computes_the_same_bits_whatever_worker_dies(client, whole, tmp_path):
    with pytest.raises(ValueError, match="`model` must be the path"):
        sweep(erosion.load_model(PLUG_IN), P, store=tmp_path / "object.zarr", chunks=CHUNKS, **AXES)
    pids, killed = list(client.run(os.getpid).values()), []

    def kill_one(work: str, done: int, total: int) -> None:
        if done and not killed:
            killed.append(pids[0])
            os.kill(pids[0], signal.SIGKILL)

    dataset = sweep(PLUG_IN, P, store=tmp_path / "out.zarr", chunks=CHUNKS, **AXES)
    assert dataset.volume.chunksizes["alpha"] == (50,) * 8
    assert_same_bits(dataset.compute(), whole)
    # One core each, and float64.
    assert list(client.run(state_of_worker).values()) == [(1, True, "float64")] * 2
    if len(os.sched_getaffinity(0)) > 1:
        cores = client.run(os.sched_getaffinity, 0)
        assert len(set.union(*cores.values())) == 2
    dataset = sweep(PLUG_IN, P, store=tmp_path / "killed.zarr", chunks=CHUNKS, progress=kill_one, **AXES)
    assert killed
    assert_same_bits(dataset.compute(), whole)


def test_workers_of_several_threads_are_refused(tmp_path):
    from distributed import Client, LocalCluster

    from erosion.impacts.cluster import active_client

    with (
        LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address="localhost:0") as cluster,
        Client(cluster),
        pytest.raises(ValueError, match="must have one thread each"),
    ):
        active_client()


def test_a_killed_client_is_resumed(whole, tmp_path):
    """SIGKILL of the process itself; the same sweep then goes on and ends with the same bits."""
    path = tmp_path / "out.zarr"
    code = f"""
import numpy as np, erosion
erosion.sweep({str(PLUG_IN)!r}, erosion.TABLE_1.to("si"), store={str(path)!r}, chunks={CHUNKS!r},
              alpha=np.deg2rad(np.linspace(1, 90, 400)), v0=np.linspace(55.88, 111.76, 200),
              progress=lambda work, done, total: print(done, flush=True))
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        for line in child.stdout:
            if int(line) >= 20_000:
                break
        child.kill()
    assert child.returncode == -signal.SIGKILL
    seen = []
    progress = lambda work, done, total: seen.append(done)  # noqa: E731
    dataset = sweep(PLUG_IN, P, store=path, chunks=CHUNKS, progress=progress, **AXES)
    assert 20_000 <= seen[0] < dataset.volume.size or len(seen) == 1
    assert seen[-1] == dataset.volume.size
    assert_same_bits(dataset.compute(), whole)


def test_importing_the_cluster_leaves_jax_alone():
    code = "import sys, erosion.impacts.cluster; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120, check=False).returncode == 0
