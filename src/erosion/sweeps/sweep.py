"""Sweeps: an xarray Dataset of impacts over axes of parameters and models.

A grid is computed block by block. In memory the blocks follow one another, each on all cores;
into a Zarr store they may also go to the workers of a Dask cluster.
"""

import dataclasses
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from erosion.arguments import check_path
from erosion.parameters.parameters import Parameters
from erosion.parameters.precision import require_float64
from erosion.sweeps.chunks import Region, block_shape
from erosion.sweeps.grid import Grid, Model, make_grid
from erosion.sweeps.stores import Store, ZarrStore, open_store, write_block

_LEAST_BLOCK = 10_000
_STORED_BLOCK = 2**17  # impacts: a fraction of a second's work, a megabyte a variable
_MEMORY_BLOCK = 2**20  # enough for all cores at once


class SweepInterrupted(KeyboardInterrupt):
    """Ctrl-C during a sweep that has a store; the message says what is there and how to go on."""


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
    progress: Callable[[int, int], object] | None = None,
    **axes: Any,
) -> xr.Dataset:
    """Compute impacts over a grid: the product of the axes, or some of them going together.

        erosion.sweep("rotating", p, alpha=np.deg2rad(range(1, 91)), v0=[2200, 4400])
        erosion.sweep(["finnie", "rotating"], p, alpha=…, k=…, paired=("alpha", "k"))

    Args:
        model: a model, its name or path; several in a list make the first dimension, "model".
        p: the case, all scalars; an axis takes the place of its value, or of the model's own.
        derivatives: 0, 1 or 2 derivatives of the volume by `wrt`.
        wrt: one parameter, of the case or the model's own.
        rtol: relative tolerance, see `impact`.
        optimum: also keep alpha_max, volume_max, alpha_max_kind and alpha_max_ended_by, over
            the other axes than alpha; see `erosion.alpha_max`.
        paired: names of two or more axes of one length that go together, along "pair".
        chunks: with a Zarr store, lengths of its blocks by dimension (those left out are not
            cut); without it, blocks of about 10⁵ impacts.
        store: `….nc`: computed in memory and written at the end, or when interrupted.
            `….zarr`: written block by block, by the workers of the Dask cluster that is
            active, if one is; what comes back is lazy. The same call goes on with an
            interrupted sweep and returns a finished one; the bits do not depend on where and
            how often it was interrupted.
        progress: called with the impacts done and their whole number.
        **axes: parameter name, of the case or every model's own, to one-dimensional values, in the
            units of `p`.

    Returns:
        volume, t_c and ended_by (codes; the attributes flag_values and flag_meanings say of
        what), and what was asked for beyond that, over the axes, with units, names and the whole case.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`)
            that holds something else, which is left as it is.
        SweepInterrupted: after Ctrl-C, if there is a store.
    """
    require_float64()
    if chunks is not None and (store is None or check_path("store", store).suffix != ".zarr"):
        raise ValueError("Argument `chunks` must come with a `store` that ends in .zarr, but there is none.")
    grid = make_grid(model, p, axes, paired=paired, derivatives=derivatives, wrt=wrt, rtol=rtol, optimum=optimum)
    return prepare_sweep(grid, chunks=chunks, store=store).run(progress)


def prepare_sweep(
    grid: Grid, *, chunks: Mapping[str, int] | None = None, store: str | Path | None = None
) -> "SweepJob":
    """Open the store of a grid, or make one; arguments and errors as of `sweep`."""
    path = None if store is None else check_path("store", store)
    usual = _MEMORY_BLOCK if path is None or path.suffix != ".zarr" else _STORED_BLOCK
    block = block_shape(grid.lengths, chunks, _LEAST_BLOCK, usual)
    return SweepJob(grid, open_store(grid, block, path), path)


@dataclasses.dataclass(frozen=True)
class SweepJob:
    """A grid that is checked, and a place for what comes out."""

    grid: Grid
    place: Store
    path: Path | None

    def run(self, progress: Callable[[int, int], object] | None = None) -> xr.Dataset:
        """Compute what is not in its place yet; progress and errors as of `sweep`."""
        todo = self.place.missing()
        whole = math.prod(self.grid.shape)
        count = whole - sum(_size(region) for region in todo)

        def advance(impacts: int) -> None:
            nonlocal count
            count += impacts
            if progress is not None:
                progress(count, whole)

        advance(0)
        try:
            self._compute(todo, advance)
        except KeyboardInterrupt:
            if self.path is None:
                raise
            self.place.save()
            raise SweepInterrupted(
                f"interrupted: {self.path} holds {count:,} of {whole:,} impacts; the same command goes on from there"
            ) from None
        if todo:
            self.place.save()
        return self.place.dataset()

    def _compute(self, todo: list[Region], advance: Callable[[int], None]) -> None:
        # Without the import there is no active cluster.
        if isinstance(self.place, ZarrStore) and "distributed" in sys.modules:
            from erosion.sweeps.cluster import active_client, run_blocks

            client = active_client()
            if client is not None:
                assert self.path is not None
                shared = self.path.resolve()
                run_blocks(client, compute_block, ((self.grid[region], shared, region) for region in todo), advance)
                return
        for region in todo:
            self.place.write(region, self.grid[region].solve())
            advance(_size(region))


def compute_block(grid: Grid, path: Path, region: Region) -> int:
    """Compute a block and write it into its place in a Zarr store; returns its impacts."""
    require_float64()
    write_block(path, dict(zip(grid.dims, region, strict=True)), grid.solve())
    return _size(region)


def _size(region: Region) -> int:
    return math.prod(one.stop - one.start for one in region)
