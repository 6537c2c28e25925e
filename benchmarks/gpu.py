"""The same lanes by XLA on JAX's default device and by this package's compiler. `python -m benchmarks.gpu`, minutes.

Printed are the seconds of three calls, each item in a process of its own, and how the results differ.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import erosion
from benchmarks.ode_problems import CASES, lanes_of
from benchmarks.stiff_problems import CASES as STIFF
from erosion import ode

Arrays = dict[str, np.ndarray]
ENGINES = ("xla", "lanes")


def _cases(lanes: int) -> erosion.Parameters:
    random = np.random.default_rng(1)
    return erosion.TABLE_1.replace(alpha=random.uniform(0.05, 1.5, lanes), psi=random.uniform(0.05, 0.5, lanes))


def _impacts(lanes: int, derivatives: int) -> Arrays:
    hits = erosion.impact("rotating", _cases(lanes), derivatives=derivatives)
    volumes = {"V": hits.volume, "V′": hits.dvolume, "V″": hits.d2volume}
    return {name: np.asarray(values) for name, values in volumes.items() if values is not None}


def _angles(lanes: int) -> Arrays:
    p = erosion.TABLE_1.replace(psi=_cases(lanes // 256).psi)
    return {"angle": np.asarray(erosion.alpha_max("rotating", p).alpha)}


def _ends(name: str, lanes: int) -> Arrays:
    case = {**CASES, **STIFF}[name]
    return {"t": np.asarray(ode.solve(case.problem(), lanes_of(case, lanes), t1=case.t1).t)}


def _total(psi: jax.Array) -> jax.Array:
    model = erosion.load_model("rotating")
    return jnp.sum(jax.vmap(lambda one: erosion.volume(model, erosion.TABLE_1.replace(psi=one)))(psi))


_SLOPES = jax.jit(jax.grad(_total))

ITEMS: dict[str, Callable[[int], Arrays]] = {
    "impacts, V": lambda lanes: _impacts(lanes, 0),
    "impacts, V, V′, V″": lambda lanes: _impacts(lanes, 2),
    "Lorenz": lambda lanes: _ends("Lorenz", lanes),
    "ballistic": lambda lanes: _ends("Ballistic", lanes),
    "Robertson": lambda lanes: _ends("Robertson", lanes),
    "gradient": lambda lanes: {"slopes": np.asarray(_SLOPES(jnp.asarray(_cases(lanes).psi)))},
    "angles": _angles,
}


def _measure(name: str, lanes: int, file: str) -> None:
    seconds: list[float] = []
    results: dict[str, Any] = {}
    for _ in range(3):
        begin = time.perf_counter()
        results = ITEMS[name](lanes)
        seconds.append(time.perf_counter() - begin)
    np.savez(file, seconds=np.array(seconds), **results)


def _differences(one: Arrays, other: Arrays) -> str:
    texts = []
    for name in sorted(one.keys() - {"seconds"}):
        a, b = one[name].ravel(), other[name].ravel()
        lost, error = (np.isnan(a) != np.isnan(b)).sum(), np.nanmax(np.abs(a - b)) / np.nanmax(np.abs(b))
        texts.append(f"{name} differs by {error:.0e} at most" + (f", {lost} have one result" if lost else ""))
    return "; ".join(texts)


def run() -> None:
    """Print seconds and differences, item by item."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, default=2**16)
    parser.add_argument("--item", choices=ITEMS, help="this one only")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds of an item at most")
    parser.add_argument("--write", help="measure in this process and write a file")
    asked = parser.parse_args()
    if asked.write:
        _measure(asked.item, asked.lanes, asked.write)
        return
    print(f"JAX's default device: {jax.devices()[0].device_kind}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in [asked.item] if asked.item else ITEMS:
            results = []
            for engine in ENGINES:
                file = str(Path(folder) / f"{engine}.npz")
                command = [sys.executable, "-m", "benchmarks.gpu", "--item", name, "--lanes", str(asked.lanes)]
                environment = {**os.environ, "EROSION_ENGINE": engine}
                try:
                    subprocess.run([*command, "--write", file], env=environment, check=True, timeout=asked.limit)
                except subprocess.TimeoutExpired:
                    print(f"{name}, {engine}: more than {asked.limit:g} s", flush=True)
                else:
                    results.append(dict(np.load(file)))
                    print(f"{name}, {engine}: {', '.join(f'{s:.3g}' for s in results[-1]['seconds'])} s", flush=True)
            if len(results) == len(ENGINES):
                print(f"  {_differences(*results)}", flush=True)


if __name__ == "__main__":
    run()
