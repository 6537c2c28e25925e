"""The same lanes by a GPU and by the processor: bits, lanes a second, the Lorenz ensemble. `python -m benchmarks.gpu`.

Each engine runs in processes of its own. Takes five minutes with 16 cores; `--quick` tries the script itself with few
lanes, and `--emulate` without a GPU. The ensemble is that of GPUODEBenchmarks: ρ from 0 to 21, σ = 10, β = 8/3, from
(1, 0, 0), t in [0, 1].
"""

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax import lax

import erosion
from benchmarks.ode_problems import CASES, lanes_of
from erosion import ode
from erosion.lanes import engines, gpu
from erosion.lanes.gpu import GpuLanes
from erosion.lanes.lanewise import number

_ENSEMBLE = 2**23
_PARTS = 8  # processes that compare bits
_RATES = ("Lorenz", "Pendulum", "ThreeBodies", "HodgkinHuxley")
_WHOLE = 2**20  # lanes of a kernel that is measured alone


def _cases(lanes: int) -> erosion.Parameters:
    random = np.random.default_rng(1)
    return erosion.TABLE_1.replace(alpha=random.uniform(0.05, 1.5, lanes), psi=random.uniform(0.05, 0.5, lanes))


def _anchors(lanes: int) -> Callable[[], ode.Solution]:
    problem = ode.Problem(
        y0={"x": 1.0, "y": 0.0, "z": 0.0},
        vector_field=lambda t, y, args: {
            "x": args["sigma"] * (y["y"] - y["x"]),
            "y": y["x"] * (args["rho"] - y["z"]) - y["y"],
            "z": y["x"] * y["y"] - args["beta"] * y["z"],
        },
    )
    args = {"rho": np.linspace(0, 21, lanes), "sigma": 10.0, "beta": 8 / 3}
    return lambda: ode.solve(problem, args, t1=1.0, rtol=1e-8)


def _impacts(lanes: int, model: str = "rotating", order: int = 0) -> Callable[[], Any]:
    cases = _cases(lanes)
    return lambda: erosion.impact(model, cases, derivatives=order)


def _end(name: str, lanes: int, **options: Any) -> Callable[[], ode.Solution]:
    case = CASES[name]
    problem, args = case.problem(), lanes_of(case, lanes)
    return lambda: ode.solve(problem, args, t1=case.t1, **options)


def _arrays(result: Any) -> dict[str, np.ndarray]:
    """All numbers of a result's lanes."""
    if isinstance(result, ode.Solution):
        parts: list[Any] = [result.t, result.outcome, result.trials, result.y, result.integrals]
        parts += [(part.t, part.y) for part in result.derivatives.values()]
        parts += [result.ys] if result.times is not None else []
    else:
        parts = [part for part in vars(result).values() if isinstance(part, np.ndarray)]
    return {str(i): np.asarray(part) for i, part in enumerate(jax.tree.leaves(parts))}


def jobs_of_bits() -> dict[str, Callable[[int], Callable[[], Any]]]:
    """Calls by name, for some number of lanes."""
    jobs: dict[str, Callable[[int], Callable[[], Any]]] = {}
    for order in (2, 1, 0):
        for model in erosion.available_models():
            jobs[f"impact {model} {order}"] = lambda n, m=model, o=order: _impacts(n, m, o)
    for name, case in CASES.items():
        jobs[f"ode {name} 0"] = lambda n, name=name: _end(name, n)
        jobs[f"ode {name} 1"] = lambda n, name=name, wrt=case.wrt: _end(name, n, wrt=wrt, derivatives=1)
        jobs[f"ode {name} ts"] = lambda n, name=name, t1=case.t1: _end(name, n, ts=np.linspace(0, t1, 9))
    return jobs


def _write_bits(part: int, lanes: int, folder: Path) -> None:
    for i, (name, job) in enumerate(jobs_of_bits().items()):
        if i % _PARTS == part:
            begin = time.perf_counter()
            try:
                np.savez(folder / f"{name}.npz", **_arrays(job(lanes)()))
            except Exception as error:  # noqa: BLE001
                (folder / f"{name}.txt").write_text(f"{type(error).__name__}: {error}")
            print(f"{name}: {time.perf_counter() - begin:.1f} s", file=sys.stderr)


def _unlike(one: np.ndarray, other: np.ndarray) -> int:
    """In how many lanes two arrays differ; all NaN are alike."""
    same = one == other
    if one.dtype.kind == "f":
        same = (same & (np.signbit(one) == np.signbit(other))) | (np.isnan(one) & np.isnan(other))
    return int((~same.reshape(len(same), -1).all(1)).sum())


def _compare(folders: dict[str, Path]) -> None:
    lanes = differ = items = 0
    for name in jobs_of_bits():
        one, other = (folder / f"{name}.npz" for folder in folders.values())
        if not (one.exists() and other.exists()):
            for engine, folder in folders.items():
                error = folder / f"{name}.txt"
                print(f"bits, {name}, {engine}: {error.read_text() if error.exists() else 'not computed or too late'}")
            continue
        with np.load(one) as ours, np.load(other) as theirs:
            bad = sum(_unlike(ours[key], theirs[key]) for key in ours)
            items, lanes, differ = items + 1, lanes + len(next(iter(ours.values()))), differ + bad
            if bad:
                print(f"bits, {name}: {bad} numbers differ")
    print(f"bits: {items} items of {len(jobs_of_bits())}, {lanes:,} lanes, {differ} numbers differ", flush=True)


@contextmanager
def _kernels() -> Iterator[list[float]]:
    """The seconds of each kernel alone; lanes are given to the GPU at once, ordered by one thread."""
    spent: list[float] = []
    usual, threads, sizes = gpu._Stream.start, ode.batch.threads, (engines._BLOCK, gpu._PORTION, gpu._MEMORY)

    def start(stream: Any, *arguments: Any) -> None:
        while not stream.is_done:
            pass
        begin = time.perf_counter()
        usual(stream, *arguments)
        while not stream.is_done:
            pass
        spent.append(time.perf_counter() - begin)

    gpu._Stream.start, ode.batch.threads = start, lambda: 2
    engines._BLOCK, gpu._PORTION, gpu._MEMORY = _WHOLE, _WHOLE, 2**33
    yield spent
    gpu._Stream.start, ode.batch.threads = usual, threads
    engines._BLOCK, gpu._PORTION, gpu._MEMORY = sizes


def _rates(engine: str, scale: int, seconds: float) -> None:
    begun = time.perf_counter()
    if engine == "gpu":
        _from_numpy(10**7 // scale)
    jobs: dict[str, tuple[Callable[[int], Callable[[], Any]], int]] = {
        "impact rotating V": (_impacts, 10**7),
        "ensemble of Lorenz": (_anchors, _ENSEMBLE),
        "impact rotating V, V', V''": (lambda n: _impacts(n, order=2), 10**6),
        **{f"ode {name}": (lambda n, name=name: _end(name, n), 10**6) for name in _RATES},
    }
    for name, (job, most) in jobs.items():
        for lanes in [n for n in (10**4, 10**5, 10**6) if n < most] + [most]:
            if time.perf_counter() - begun > seconds:
                return
            first, best, call = 0.0, np.inf, job(max(lanes // scale, 100))
            for i in range(4):
                if i > 1 and best > 3:
                    break
                prepared = time.perf_counter()
                call()
                took = time.perf_counter() - prepared
                first, best = (took, best) if i == 0 else (first, min(best, took))
            rate = f"first {first:.2f} s | later {best:.4f} s | {lanes / best:.3g} a second"
            print(f"{name} | {engine} | {lanes:,} lanes | {rate}", flush=True)
        if engine == "gpu":
            lanes, call = most, job(max(most // scale, 10**4))
            with _kernels() as spent:
                call()
                spent.clear()
                call()
            print(f"{name} | kernels alone | {lanes:,} lanes | {[f'{1e3 * s:.2f} ms' for s in spent]} | "
                  f"{lanes / max(sum(spent), 1e-9):.3g} a second", flush=True)  # fmt: skip


def _from_numpy(lanes: int) -> None:
    """Impacts of `rotating` from arrays in no order to arrays, by the lane compiler alone."""
    kept: list[tuple[Any, list[np.ndarray], list[np.ndarray]]] = []
    usual = GpuLanes.run

    def run(self: Any, leaves: Any, order: Any, results: Any, *rest: Any) -> None:
        kept.append((self, leaves, results))
        usual(self, leaves, order, results, *rest)

    GpuLanes.run = run
    _impacts(2**15)()
    GpuLanes.run = usual
    program, leaves, results = kept[0]
    leaves = [
        leaf if leaf.ndim == len(shape) or len(leaf) == 1 or not leaf.strides[0] else np.resize(leaf, lanes)
        for leaf, shape in zip(leaves, program.inputs, strict=True)
    ]
    results = [np.zeros((lanes, *result.shape[1:]), result.dtype) for result in results]
    best = np.inf
    for _ in range(4):
        begin = time.perf_counter()
        program.run(leaves, np.arange(lanes), results)
        best = min(best, time.perf_counter() - begin)
    print(f"impact rotating V | from numpy | {lanes:,} lanes | {best:.4f} s | {lanes / best:.3g} a second", flush=True)


def _stop() -> None:
    """A kernel that never ends, stopped after a second; and the next call."""
    endless = GpuLanes(lambda x: lax.while_loop(lambda s: s >= 0, lambda s: s + x, 0.0 * x), (number,))
    endless(np.full(10**4, -1.0))
    stop, begin = np.zeros(1, np.int64), time.perf_counter()

    def later() -> None:
        time.sleep(1.0)
        stop[0] = 1

    threading.Thread(target=later).start()
    endless.run([np.zeros(10**4)], np.arange(10**4), [np.empty(10**4)], stop)
    took = time.perf_counter() - begin
    again = endless(np.full(10**4, -1.0))
    word = "right" if np.all(again == -1) else "wrong"
    print(f"stop: a kernel that never ends ended after {took:.3f} s; the next call is {word}", flush=True)


def _children(common: list[str], environment: dict[str, str], jobs: list[str], limit: float) -> None:
    with tempfile.TemporaryFile("w+") as errors:
        running = [subprocess.Popen([*common, *job.split()], env=environment, stderr=errors) for job in jobs]
        until = time.monotonic() + limit
        for process in running:
            try:
                process.wait(max(until - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                print(f"{process.args[-1]}: more than {limit:g} s", flush=True)
        if any(process.returncode for process in running):
            errors.seek(0)
            print(errors.read()[-3000:], flush=True)


def run() -> None:
    """Compare, measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few lanes")
    parser.add_argument("--emulate", action="store_true", help="the kernels by the processor")
    parser.add_argument("--child", default="", help="internal: bits:PART, rates, stop")
    parser.add_argument("--folder", type=Path, help="internal: of the bits")
    parser.add_argument("--seconds", type=float, default=80.0, help="of each engine's rates")
    asked = parser.parse_args()
    engine, lanes = os.environ.get(engines.ENGINE, "cpu"), 200 if asked.quick else 10**4
    if asked.emulate and asked.child and engine == "gpu":
        from tests.lanes.emulated_gpu import emulated_gpu

        emulated = emulated_gpu()
        gpu.this_gpu = lambda: emulated
        GpuLanes.__init__.__kwdefaults__["few"] = 0
    if asked.child == "stop":
        _stop()
    elif asked.child == "rates":
        _rates(engine, 10**4 if asked.quick else 1, asked.seconds)
    elif asked.child:
        ode.batch.threads = lambda: 2
        _write_bits(int(asked.child.split(":")[1]), lanes, asked.folder)
    if asked.child:
        return
    begin = time.monotonic()
    common = [sys.executable, "-m", "benchmarks.gpu", *(["--quick"] if asked.quick else [])]
    common += ["--emulate"] if asked.emulate else []
    environments = {name: {**os.environ, engines.ENGINE: name, "JAX_PLATFORMS": "cpu"} for name in ("gpu", "cpu")}
    if not asked.emulate:
        device = gpu.this_gpu()
        name = device.call("cuDeviceGetName", 128, device.call("cuDeviceGet", 0)).split(b"\0")[0].decode()
        driver = device.call("cuDriverGetVersion")
        print(f"{name}, {device._processors} multiprocessors, driver {driver}, {engines.threads()} cores", flush=True)
        _children(common, environments["gpu"], ["--child stop"], 30)
    _children(common, environments["gpu"], [f"--child rates --seconds {asked.seconds}"], 1.3 * asked.seconds)
    _children(common, environments["cpu"], [f"--child rates --seconds {asked.seconds}"], 1.3 * asked.seconds)
    with tempfile.TemporaryDirectory() as folder:
        folders = {name: Path(folder) / name for name in environments}
        for name, path in folders.items():
            path.mkdir()
            jobs = [f"--child bits:{i} --folder {path}" for i in range(_PARTS)]
            _children(common, environments[name], jobs, 100)
            print(f"{name}: {time.monotonic() - begin:.0f} s", flush=True)
        _compare(folders)


if __name__ == "__main__":
    run()
