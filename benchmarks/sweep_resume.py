"""A sweep that is killed twice and resumed: `python -m benchmarks.sweep_resume [N]`, 10⁷ by default.

Once without interruption, and once with a worker killed (SIGKILL) after a quarter of the work
and the client after a half, then started again. Compares the two stores bit for bit, and the
rate of the cluster of two processes with that of `erosion.impact` in one process.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ANGLES = 2000


def main() -> int:
    """Run all three, print, and fail where bits differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweep_resume", description=__doc__)
    parser.add_argument("n", type=lambda text: int(float(text)), nargs="?", default=10**7)
    parser.add_argument("--model", default="rotating")
    parser.add_argument("--child", type=Path, help="(inner) sweep into this store and report")
    arguments = parser.parse_args()
    if arguments.child is not None:
        _sweep(arguments.child, arguments.model, arguments.n)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        whole, broken = Path(folder, "whole.zarr"), Path(folder, "broken.zarr")
        few = min(arguments.n, 4 * 10**6)
        before = _impact_rate(arguments.model, few)
        rate = _run(whole, arguments, kill=False)
        after = _impact_rate(arguments.model, few)
        print(f"2 processes, uninterrupted: {rate:,.0f} impacts/s", flush=True)
        print(f"`impact` in one process before and after: {before:,.0f} and {after:,.0f} impacts/s; ", end="")
        print(f"ratio {2 * rate / (before + after):.2f} (load average {os.getloadavg()[0]:.1f})", flush=True)
        _run(broken, arguments, kill=True)
        _run(broken, arguments, kill=False)
        same = _same(whole, broken)
        print(f"killed twice and resumed: {'the same, bit for bit' if same else 'DIFFERENT'}", flush=True)
    return 0 if same else 1


def _axes(n: int) -> dict[str, Any]:
    return {
        "alpha": np.deg2rad(np.linspace(1, 90, ANGLES)),
        "phidot0": np.linspace(-40_000.0, 40_000.0, max(1, n // ANGLES)),
    }


def _sweep(store: Path, model: str, n: int) -> None:
    from distributed import Client

    import erosion
    from erosion.impacts.cluster import local_cluster

    with local_cluster(2) as cluster, Client(cluster) as client:
        # Both workers compile before the clock starts.
        client.run(_warm, model)
        workers: Any = client.run(os.getpid)
        print(json.dumps({"workers": list(workers.values())}), flush=True)

        def report(work: str, done: int, total: int) -> None:
            print(json.dumps({"done": done, "total": total, "time": time.perf_counter()}), flush=True)

        erosion.sweep(model, erosion.TABLE_1, store=store, progress=report, **_axes(n))
        used: Any = client.run(time.process_time)
        print(json.dumps({"cpu": sum(used.values())}), flush=True)


def _warm(model: str) -> None:
    import erosion

    erosion.impact(model, erosion.TABLE_1.replace(alpha=np.linspace(0.1, 1.5, 10_000)))


def _run(store: Path, arguments: argparse.Namespace, *, kill: bool) -> float:
    """Sweep in a process of its own; returns impacts per second."""
    command = [sys.executable, "-m", "benchmarks.sweep_resume", str(arguments.n), "--model", arguments.model]
    with subprocess.Popen([*command, "--child", str(store)], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        workers, first, last, done = [], None, 0.0, 0
        for line in child.stdout:
            said = json.loads(line)
            workers = said.get("workers", workers)
            if "cpu" in said:
                print(f"processor time of the workers, with start and compiling: {said['cpu']:.1f} s", flush=True)
            if "done" not in said:
                continue
            first = first or (said["done"], said["time"])
            done, last, share = said["done"], said["time"], said["done"] / said["total"]
            if kill and share > 0.25 and workers:
                os.kill(workers.pop(), signal.SIGKILL)
                print(f"one worker killed at {share:.0%}", flush=True)
                workers = []
            if kill and share > 0.5:
                child.kill()
                print(f"client killed at {share:.0%}", flush=True)
                return 0.0
    if child.returncode:
        raise SystemExit(f"the sweep ended with status {child.returncode}")
    assert first is not None
    if first[0]:
        print(f"resumed at {first[0]:,} impacts", flush=True)
    return (done - first[0]) / (last - first[1])


def _impact_rate(model: str, n: int) -> float:
    import erosion

    axes = _axes(n)
    p = erosion.TABLE_1.replace(alpha=axes["alpha"][:, None], phidot0=axes["phidot0"])
    _warm(model)
    begin = time.perf_counter()
    used = time.process_time()
    erosion.impact(model, p)
    print(f"processor time of `impact` for {n:,} impacts: {time.process_time() - used:.1f} s", flush=True)
    return n / (time.perf_counter() - begin)


def _same(one: Path, other: Path) -> bool:
    import zarr

    arrays = dict(zarr.open_group(one, mode="r").arrays())
    others = dict(zarr.open_group(other, mode="r").arrays())
    return arrays.keys() == others.keys() and all(
        np.asarray(array[...]).tobytes() == np.asarray(others[name][...]).tobytes() for name, array in arrays.items()
    )


if __name__ == "__main__":
    sys.exit(main())
