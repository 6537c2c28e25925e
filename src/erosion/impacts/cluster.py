"""Blocks of a sweep or a map on a Dask cluster, each of them on one core.

Nothing here imports JAX: a worker is pinned to its core before JAX counts the cores.
"""

import logging
import os
import re
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from erosion.extras import extra

with extra("dask"):
    from distributed import Client, LocalCluster, Worker, WorkerPlugin, as_completed, default_client

_AHEAD = 3
"""Blocks that each worker has in its queue, so that it never waits for the client."""


def local_cluster(workers: int) -> LocalCluster:
    """A Dask cluster on this machine: `workers` processes of one thread each.

    Use it as a context, with a client: `with local_cluster(2) as cluster, Client(cluster): …`.
    """
    # Any free port: two sweeps at once must not meet.
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        dashboard_address="localhost:0",
        silence_logs=logging.ERROR,
    )


def active_client() -> Client | None:
    """The client of the Dask cluster that is active, if one is.

    Raises:
        ValueError: where its workers have several threads.
    """
    try:
        client = default_client()
    except ValueError:
        return None
    for address, threads in _threads(client).items():
        if threads != 1:
            raise ValueError(
                "The active Dask cluster's workers must have one thread each (threads_per_worker=1), "
                f"but {address} has {threads}."
            )
    return client


def _threads(client: Client) -> dict[str, int]:
    """Number of threads of each worker, by its address."""
    threads: Any = client.nthreads()
    return threads


def run_blocks(
    client: Client, task: Callable[..., Any], blocks: Iterator[tuple[Any, ...]], done: Callable[[Any], None]
) -> None:
    """Run `task(*block)` for every block on the cluster's workers.

    Args:
        client: of the cluster.
        task: computes a block; it runs again for a block whose worker died.
        blocks: taken one by one as the workers are ready, so that there may be millions.
        done: called with what `task` returns of each block, in the order in which they are done.
    """
    client.register_plugin(OneCore())
    running = as_completed()

    def submit_next() -> None:
        block = next(blocks, None)
        if block is not None:
            # Dask asks for smaller tasks above 10 MB; a portion of a map has 27.
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Sending large graph")
                running.add(client.submit(task, *block, pure=False))

    try:
        for _ in range(_AHEAD * max(1, len(_threads(client)))):
            submit_next()
        for future in running:
            done(future.result())
            submit_next()
    finally:
        client.cancel(list(running.futures))


class OneCore(WorkerPlugin):
    """Pins a worker to one core before JAX is imported there.

    Loading it imports this package, which turns 64-bit mode on.
    """

    name = "erosion-one-core"

    def setup(self, worker: Worker) -> None:
        """Pin the worker; Dask calls it in each worker, now or when the worker starts, before its tasks."""
        # Ctrl-C in a terminal reaches every process of the terminal. Only the client acts on it:
        # its nannies end their workers, without a traceback.
        if worker.nanny is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        # The number at the end of its name tells a worker from the others of the same machine.
        # A worker without a name is named by its address; the system chooses its core.
        number = None if worker.name == worker.address else re.search(r"\d+$", str(worker.name))
        if number is None or not hasattr(os, "sched_setaffinity"):
            return
        cores = sorted(os.sched_getaffinity(0))
        core = cores[int(number[0]) % len(cores)]
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(thread.name), {core})
