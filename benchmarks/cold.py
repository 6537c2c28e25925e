"""A fresh process's first answers: `python -m benchmarks.cold NAME LANES` prints seconds as JSON."""

import importlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

NAMES = {
    "kernel-0": "erosion.impact, V",
    "kernel-2": "erosion.impact, V, V′, V″",
    "scalar-0": "heyoka, scalar, V",
    "scalar-2": "heyoka, scalar, V, V′, V″",
    "batch-0": "heyoka, batch refilled, V",
    "batch-2": "heyoka, batch refilled, V, V′, V″",
    "Tsit5": "diffrax Tsit5 in blocks, V",
    "Dopri8": "diffrax Dopri8 in blocks, V",
    "scipy": "scipy DOP853, V",
}


class Cold(NamedTuple):
    """Seconds.

    Args:
        process: from the start of the process to its end, one answer printed.
        first, second: the first call and the same call again.
        xla: XLA's share of the first call (0 without JAX).
    """

    process: float
    first: float
    second: float
    xla: float


def measure(name: str, lanes: int) -> Cold:
    """Run `name` in a process of its own, the compilation caches of JAX and heyoka off."""
    environment = dict(os.environ, JAX_ENABLE_COMPILATION_CACHE="false")
    begin = time.perf_counter()
    command = [sys.executable, "-m", "benchmarks.cold", name, str(lanes)]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    return Cold(time.perf_counter() - begin, *json.loads(done.stdout))


def _runner(name: str, lanes: int) -> Callable[[], Any]:
    # Only what the contender itself needs is imported: it is part of the measured time.
    from benchmarks.work import random_work

    work = random_work(lanes)
    if name.startswith("kernel"):
        from benchmarks import kernel

        return kernel.prepare(work, int(name[-1]))
    if name.startswith(("scalar", "batch")):
        import heyoka

        heyoka.llvm_state.set_diskcache_enabled(False)
        module = importlib.import_module(f"benchmarks.heyoka_{name[:-2]}")
        return lambda: module.prepare(work, order=int(name[-1]))()
    if name == "scipy":
        from benchmarks import scipy_dop853

        return scipy_dop853.prepare(work)
    from benchmarks import diffrax_vmap

    return diffrax_vmap.prepare(work, name, diffrax_vmap.TOLERANCES[name], diffrax_vmap.BLOCK)


def _main(name: str, lanes: int) -> None:
    xla = 0.0

    def listen(event: str, duration_secs: float, **_: Any) -> None:
        nonlocal xla
        if event == "/jax/core/compile/backend_compile_duration":
            xla += duration_secs

    run = _runner(name, lanes)
    if "jax" in sys.modules:
        from jax import monitoring

        monitoring.register_event_duration_secs_listener(listen)
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    print(json.dumps([*seconds, xla]))


if __name__ == "__main__":
    _main(sys.argv[1], int(sys.argv[2]))
