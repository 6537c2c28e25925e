"""The options of verbs that work in several processes, or on a Dask cluster."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError
from erosion.cli.options import WholeOption
from erosion.extras import extra


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class ClusterOptions:
    """Options of the processes that compute."""

    workers: Annotated[WholeOption, Parameter(help="With out.zarr, work in this many processes.")] = None
    scheduler: Annotated[str | None, Parameter(help="With out.zarr, work on this Dask cluster: tcp://host:8786.")] = (
        None
    )

    @property
    def is_given(self) -> bool:
        """Whether other processes than this one work."""
        return not (self.workers is self.scheduler is None)

    @contextlib.contextmanager
    def connected(self) -> Iterator[None]:
        """Work within on the cluster; in this process without either option.

        Raises:
            InputError: for both options, and a cluster that does not answer.
        """
        if not self.is_given:
            yield
            return
        if self.workers is not None and self.scheduler is not None:
            raise InputError("Give `--workers` or `--scheduler`, but not both.")
        with extra("dask"):
            from distributed import Client

        if self.workers is not None and self.workers < 1:
            raise InputError(f"Option `--workers` must be 1 or more, but is {self.workers}.")
        with contextlib.ExitStack() as stack:
            target = self.scheduler if self.workers is None else stack.enter_context(lazy.local_cluster(self.workers))
            try:
                client = Client(target)
            except (OSError, ValueError) as error:
                raise InputError(
                    f"Option `--scheduler` must be a cluster that answers, not {target} ({error})."
                ) from error
            stack.enter_context(client)
            yield
