"""The Dask cluster that `--workers` and `--scheduler` ask for."""

import contextlib
from collections.abc import Iterator

from erosion.cli.errors import InputError
from erosion.extras import extra


@contextlib.contextmanager
def dask_cluster(workers: int | None, scheduler: str | None) -> Iterator[None]:
    """Work within on the cluster; in this process without either option."""
    if workers is None and scheduler is None:
        yield
        return
    if workers is not None and scheduler is not None:
        raise InputError("Give `--workers` or `--scheduler`, but not both.")
    with extra("dask"):
        from distributed import Client
    from erosion.cluster import local_cluster

    if workers is not None and workers < 1:
        raise InputError(f"Option `--workers` must be 1 or more, but is {workers}.")
    with contextlib.ExitStack() as stack:
        target = scheduler if workers is None else stack.enter_context(local_cluster(workers))
        try:
            client = Client(target)
        except (OSError, ValueError) as error:
            raise InputError(f"Option `--scheduler` must be a cluster that answers, not {target} ({error}).") from error
        stack.enter_context(client)
        yield
