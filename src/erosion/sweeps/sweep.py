"""Sweeps: an xarray Dataset of impacts over axes of parameters and models.

A grid is computed block by block. In memory the blocks follow one another, each on all cores.
For a Zarr store the workers of a Dask cluster may compute them.
"""

import dataclasses
import math
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import Progress, check_path, no_progress
from erosion.correlations.ranges import OutOfRangeWarning
from erosion.interrupts import keeping_results
from erosion.models.identity import code_version, require_code
from erosion.ode.step_control import require_float64
from erosion.parameters.parameters import Parameters, require_scalars, validate
from erosion.parameters.quantities import QUARTER_DEGREES
from erosion.sweeps.grid import AnyGrid, Model, Outputs, Region, block_shape, make_grid
from erosion.sweeps.stores import Store, ZarrStore, open_store, write_block

_LEAST_BLOCK = 10_000  # impacts
_STORED_BLOCK = 2**17  # impacts: a fraction of a second's work, a megabyte a variable
_MEMORY_BLOCK = 2**20  # impacts: enough for all cores at once


class SweepInterrupted(KeyboardInterrupt):
    """Ctrl-C during a sweep that has a store; the message says how much the store holds and how to go on."""


def sweep(
    model: Model | Sequence[Model],
    p: Parameters,
    *,
    derivatives: int = 0,
    wrt: str = "alpha",
    rtol: float = 1e-9,
    optimum: bool = False,
    paired: Sequence[str] = (),
    chunks: Mapping[str, int] | None = None,
    store: str | Path | None = None,
    progress: Progress = no_progress,
    **axes: Any,
) -> xr.Dataset:
    """Compute impacts over a grid: the product of the axes, or some of them going together.

        erosion.sweep("rotating", p, alpha=np.deg2rad(range(1, 91)), v0=[2200, 4400])
        erosion.sweep(["finnie", "rotating"], p, alpha=…, k=…, paired=("alpha", "k"))

    Args:
        model: a model, its name or path; several in a list make the first dimension, "model".
        p: the case, all scalars; an axis replaces its value, or that of the model's own parameter.
        derivatives: 0, 1 or 2 derivatives of the volume by `wrt`.
        wrt: one parameter, of the case or the model's own.
        rtol: relative tolerance, see `impact`.
        optimum: also keep alpha_max, volume_max, alpha_max_kind and alpha_max_ended_by, over
            the other axes than alpha; see `erosion.alpha_max`.
        paired: names of two or more axes of one length that go together, along "pair".
        chunks: with a Zarr store, lengths of its blocks by dimension (those left out are not
            cut); without it, blocks of about 10⁵ impacts.
        store: `….nc`: computed in memory and written at the end, or when interrupted.
            `….zarr`: written block by block, by the workers of the active Dask cluster, if there
            is one; the result is lazy. The same call goes on with an interrupted sweep and
            returns a finished one; the bits do not depend on where and how often it was
            interrupted.
        progress: called with "sweep", the number of impacts that are done, and the number of all.
        **axes: parameter name, of the case or every model's own, to one-dimensional values, in the
            units of `p`.

    Returns:
        volume, t_c and ended_by (codes; the attributes flag_values and flag_meanings explain
        them), derivatives and best angles if asked for, over the axes, with units and the whole case; and
        volume_at_contact, if a model removes something beside the cut.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`)
            that holds something else and stays as it is.
        SweepInterrupted: after Ctrl-C, if there is a store.

    Warns:
        OutOfRangeWarning: where a correlation is used outside of its range, with the share of the impacts.
    """
    require_float64()
    grid = make_grid(model, p, axes, Outputs(derivatives, wrt, rtol, optimum), paired=paired)
    for message in grid.outside_of_range:
        warnings.warn(message, OutOfRangeWarning, stacklevel=2)
    return prepare_sweep(grid, chunks=chunks, store=store).run(progress)


def prepare_sweep(
    grid: AnyGrid, *, chunks: Mapping[str, int] | None = None, store: str | Path | None = None
) -> "SweepJob":
    """Open the store of a grid, or make one; arguments and errors as of `sweep`."""
    path = None if store is None else check_path("store", store)
    is_zarr = path is not None and path.suffix == ".zarr"
    if chunks is not None and not is_zarr:
        raise ValueError("Argument `chunks` must come with a `store` that ends in .zarr, but there is none.")
    usual = _STORED_BLOCK if is_zarr else _MEMORY_BLOCK
    block = block_shape(grid.lengths, chunks, _LEAST_BLOCK, usual)
    store_of_blocks = open_store(grid, block, path)
    missing = store_of_blocks.missing()
    if missing:
        store_of_blocks.require_writable()
    return SweepJob(grid, store_of_blocks, missing, path)


@dataclasses.dataclass(frozen=True)
class SweepJob:
    """A checked grid, the store of its blocks, those that it lacks, and its path if it is not the memory."""

    grid: AnyGrid
    store: Store
    missing: list[Region]
    path: Path | None

    def run(self, progress: Progress = no_progress) -> xr.Dataset:
        """Compute the blocks that the store lacks; errors as of `sweep`."""
        total = math.prod(self.grid.shape)
        begun = count = total - sum(_size(region) for region in self.missing)

        def advance(impacts: int) -> None:
            nonlocal count
            count += impacts
            progress("sweep", count, total)

        try:
            advance(0)
            try:
                with keeping_results():
                    self._compute(self.missing, advance)
            finally:
                # Also after an error, and a Ctrl-C meanwhile waits: to compute took longer than to write.
                if count > begun:
                    self.store.save()
        except KeyboardInterrupt:
            if self.path is None:
                raise
            hint = f": {self.path} holds {count:,} of {total:,} impacts; the same command goes on from there"
            nothing = f" before any of {total:,} impacts was stored"
            raise SweepInterrupted(f"interrupted{hint if self.path.exists() else nothing}") from None
        return self.store.dataset()

    def _compute(self, missing: list[Region], advance: Callable[[int], None]) -> None:
        # Without the import there is no active cluster.
        if isinstance(self.store, ZarrStore) and "distributed" in sys.modules:
            from erosion.impacts.cluster import active_client, run_blocks

            client = active_client()
            if client is not None:
                assert self.path is not None
                self.grid.require_portable()
                shared = self.path.resolve()
                code = code_version()
                blocks = ((self.grid[region], shared, region, code) for region in missing)
                run_blocks(client, compute_block, blocks, advance)
                return
        for region in missing:
            self.store.write(region, self.grid[region].solve())
            advance(_size(region))


def compute_block(grid: AnyGrid, path: Path, region: Region, code: str) -> int:
    """Compute a block and write it into a Zarr store; returns the number of its impacts.

    Raises:
        RuntimeError: where this process computes with other code, or another model, than the sweep was begun with.
    """
    require_code(code, "sweep")
    write_block(path, dict(zip(grid.dims, region, strict=True)), grid.solve())
    return _size(region)


def _size(region: Region) -> int:
    return math.prod(cut.stop - cut.start for cut in region)


_SPINS = 91  # s from -0.9 to 0.9


def compare(models: Sequence[Model], p: Parameters, *, alpha: Any = None) -> xr.Dataset:
    """Several models over the same angles, each with its angle of greatest removal.

    Args:
        models: models, their names or paths.
        p: one case; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every quarter of a degree without it.

    Returns:
        Over (model, alpha): volume, dvolume, d2volume, t_c and ended_by (codes, see their attributes), and
        volume_at_contact, if a model removes something beside the cut; over model: alpha_max, volume_max,
        alpha_max_kind, alpha_max_ended_by.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    if isinstance(models, str) or not isinstance(models, Sequence):
        raise TypeError(f"Argument `models` must be a list of models, but is {models!r}.")
    return sweep(models, p, alpha=QUARTER_DEGREES if alpha is None else alpha, derivatives=2, optimum=True)


def regimes(model: Model, p: Parameters, *, alpha: Any = None, phidot0: Any = None) -> xr.Dataset:
    """How cuts end and what they remove over angle and spin, with the best angle of each spin.

    Args:
        model: a model, its name or path.
        p: one case; its `alpha` and `phidot0` are not used.
        alpha: angles, shape (n,) [rad]; every half degree without it.
        phidot0: spins, shape (k,) [rad/s]; without it s = r φ̇0/v0 from -0.9 to 0.9.

    Returns:
        Over (phidot0, alpha): volume, dvolume, d2volume, t_c and ended_by; over phidot0:
        alpha_max, volume_max, alpha_max_kind, alpha_max_ended_by.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    if phidot0 is None:
        validate(p)
        require_scalars(p)
        phidot0 = np.linspace(-0.9, 0.9, _SPINS) * float(p.v0 / p.r)
    angles = QUARTER_DEGREES[1::2] if alpha is None else alpha
    return sweep(model, p, phidot0=phidot0, alpha=angles, derivatives=2, optimum=True)
