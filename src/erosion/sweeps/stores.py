"""Stores for the blocks of a sweep, so that an interrupted sweep goes on where it stopped.

A block is missing while its `ended_by` is "not-computed", the code 0. Of each block `ended_by`
is written last, and a file gets its name when it is whole: a block counts only when it is
complete.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.files import require_writable, written_whole
from erosion.storage.identity import IDENTITY, StoreError, require_same
from erosion.storage.netcdf import read_netcdf, write_netcdf
from erosion.sweeps.chunks import Region, regions
from erosion.sweeps.grid import Grid


class Store(ABC):
    """A store for the blocks of one sweep."""

    @abstractmethod
    def missing(self) -> list[Region]:
        """The regions of the blocks that are still to be computed."""

    @abstractmethod
    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        """Store the arrays of a block, by name."""

    @abstractmethod
    def save(self) -> None:
        """Make the stored blocks outlast this process."""

    @abstractmethod
    def dataset(self) -> xr.Dataset:
        """All blocks, labelled."""


class MemoryStore(Store):
    """Arrays in memory; with a path, also a netCDF file that `save` writes.

    Raises:
        StoreError: for a file that exists and holds something else.
        OSError: where no file can be written.
    """

    def __init__(self, grid: Grid, block: Sequence[int], path: Path | None = None) -> None:
        self._grid, self._block, self._path = grid, block, path
        if path is not None and path.exists():
            self._dataset = read_netcdf(path, grid.identity())
            return
        if path is not None:
            require_writable(path)
        self._dataset = grid.labelled(
            {
                name: np.full([grid.lengths[dim] for dim in variable.dims], variable.empty)
                for name, variable in grid.variables().items()
            }
        )

    def missing(self) -> list[Region]:
        codes = self._dataset["ended_by"].values
        return [region for region in regions(self._grid.shape, self._block) if not codes[region].all()]

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        along = dict(zip(self._grid.dims, region, strict=True))
        for name, block in values.items():
            array = self._dataset[name]
            array.values[tuple(along[str(dim)] for dim in array.dims)] = block

    def save(self) -> None:
        if self._path is not None:
            write_netcdf(self._dataset, self._path, self._grid.identity())

    def dataset(self) -> xr.Dataset:
        return self._dataset


class ZarrStore(Store):
    """A Zarr folder (format 3), with one chunk of each array for a block; any process may write.

    Raises:
        StoreError: for a folder that exists and holds something else.
    """

    def __init__(self, grid: Grid, block: Sequence[int], path: Path) -> None:
        _require_zarr()
        self._grid, self._block, self._path = grid, block, path
        identity = grid.identity() | {"chunks": f"{dict(zip(grid.dims, block, strict=True))}"}
        if path.exists():
            require_same(path, _zarr_identity(path), identity)
        else:
            self._create(identity)

    def missing(self) -> list[Region]:
        codes = _arrays(self._path)["ended_by"]
        return [region for region in regions(self._grid.shape, self._block) if not np.all(codes[region])]

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        write_block(self._path, dict(zip(self._grid.dims, region, strict=True)), values)

    def save(self) -> None:
        """Every block is on the disk already."""

    def dataset(self) -> xr.Dataset:
        return xr.open_zarr(self._path, consolidated=False)

    def _create(self, identity: Mapping[str, str]) -> None:
        import dask.array

        lengths = {dim: (n, cut) for dim, n, cut in zip(self._grid.dims, self._grid.shape, self._block, strict=True)}
        lazy, encoding = {}, {}
        for name, variable in self._grid.variables().items():
            shape, chunks = zip(*(lengths[dim] for dim in variable.dims), strict=True) if variable.dims else ((), ())
            lazy[name] = dask.array.full(shape, variable.empty, chunks=chunks)
            encoding[name] = {"fill_value": variable.empty}
        template = self._grid.labelled(lazy)
        template.attrs[IDENTITY] = json.dumps(identity)
        require_writable(self._path)  # zarr would make folders
        with written_whole(self._path) as draft:
            # Coordinates and metadata alone: no block is computed.
            template.to_zarr(draft, mode="w-", compute=False, encoding=encoding, consolidated=False, zarr_format=3)


def write_block(path: Path, along: Mapping[str, slice], values: Mapping[str, np.ndarray]) -> None:
    """Write a block into a Zarr store, in the order of `values`; the same block may come twice.

    Args:
        path: of the store.
        along: the slice of the block along each dimension.
        values: its arrays by name, `ended_by` last.
    """
    arrays = _arrays(path)
    for name, block in values.items():
        array = arrays[name]
        array[tuple(along[dim] for dim in array.metadata.dimension_names)] = block


def open_store(grid: Grid, block: Sequence[int], path: Path | None) -> Store:
    """The store that the suffix of the path names, .zarr or .nc; the memory without a path.

    Raises:
        ValueError: for another suffix.
        StoreError: where the path holds something else.
    """
    if path is None or path.suffix == ".nc":
        return MemoryStore(grid, block, path)
    if path.suffix == ".zarr":
        return ZarrStore(grid, block, path)
    raise ValueError(f"Argument `store` must end in .nc or .zarr, but is {path}.")


def _arrays(path: Path) -> Any:
    import zarr

    return dict(zarr.open_group(path, mode="r+").arrays())


def _zarr_identity(path: Path) -> str | None:
    import zarr

    try:
        return str(zarr.open_group(path, mode="r").attrs.get(IDENTITY))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: is there already and is no Zarr group; it is left as it is.") from error


def _require_zarr() -> None:
    try:
        import dask.array  # noqa: F401
        import zarr  # noqa: F401
    except ImportError as error:
        raise StoreError('Zarr stores need the extra `dask`: pip install "erosion[dask]".') from error
