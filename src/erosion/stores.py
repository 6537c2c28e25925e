"""Where the blocks of a sweep are kept, so that an interrupted one goes on where it stopped.

A store knows which blocks are missing: those whose `ended_by` is still "not-computed", the
code 0. In a block's place `ended_by` is written last, and a file is renamed into its place
when it is whole, so a block counts only when all of it is there.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr

from erosion.grids import Grid, Region, regions

_IDENTITY = "identity"


class StoreError(ValueError):
    """A file or folder that is not this sweep's."""


class Store(Protocol):
    """A place for the blocks of one sweep."""

    def missing(self) -> list[Region]:
        """The blocks that are still to be computed."""
        ...

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        """Put a block in its place."""
        ...

    def save(self) -> None:
        """Make what has been written last beyond this process."""
        ...

    def dataset(self) -> xr.Dataset:
        """What is there, labelled."""
        ...


class MemoryStore:
    """Arrays in memory; with a path, also a netCDF file that `save` writes.

    Raises:
        StoreError: for a file that exists and holds something else.
    """

    def __init__(self, grid: Grid, block: Sequence[int], path: Path | None = None) -> None:
        self._grid, self._block, self._path = grid, block, path
        if path is not None and path.exists():
            self._dataset = _read_netcdf(path)
            _require_same(path, self._dataset.attrs.get(_IDENTITY), grid.identity())
        else:
            self._dataset = grid.labelled({name: np.full(grid.shape, np.nan) for name in grid.variables()} | {
                "ended_by": np.zeros(grid.shape, np.int8)
            })  # fmt: skip
            if path is not None:
                self._dataset.attrs[_IDENTITY] = json.dumps(grid.identity())
                _check_folder(path)

    def missing(self) -> list[Region]:
        codes = self._dataset["ended_by"].values
        return [region for region in regions(self._grid.shape, self._block) if not codes[region].all()]

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        for name, block in values.items():
            self._dataset[name].values[region] = block

    def save(self) -> None:
        if self._path is None:
            return
        draft = self._path.with_name(f".{self._path.name}.{os.getpid()}.part")
        try:
            self._dataset.to_netcdf(draft, engine="h5netcdf")
            draft.replace(self._path)
        finally:
            draft.unlink(missing_ok=True)

    def dataset(self) -> xr.Dataset:
        return self._dataset


class ZarrStore:
    """A Zarr folder (format 3), one chunk of each array a block; any process may write.

    Raises:
        StoreError: for a folder that exists and holds something else.
    """

    def __init__(self, grid: Grid, block: Sequence[int], path: Path) -> None:
        _require_zarr()
        self._grid, self._block, self._path = grid, block, path
        identity = grid.identity() | {"chunks": f"{dict(zip(grid.dims, block, strict=True))}"}
        if path.exists():
            _require_same(path, _zarr_identity(path), identity)
        else:
            self._create(identity)

    def missing(self) -> list[Region]:
        codes = _arrays(self._path)["ended_by"]
        return [region for region in regions(self._grid.shape, self._block) if not np.all(codes[region])]

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        write_block(self._path, region, values)

    def save(self) -> None:
        """Every block is on the disk already."""

    def dataset(self) -> xr.Dataset:
        return xr.open_zarr(self._path, consolidated=False)

    def _create(self, identity: Mapping[str, str]) -> None:
        import dask.array

        _check_folder(self._path)
        shape = self._grid.shape
        lazy = {name: dask.array.full(shape, np.nan, chunks=self._block) for name in self._grid.variables()}
        lazy["ended_by"] = dask.array.zeros(shape, dtype=np.int8, chunks=self._block)
        template = self._grid.labelled(lazy)
        template.attrs[_IDENTITY] = json.dumps(identity)
        # What has not been written reads as NaN, and "not-computed".
        encoding = {name: {"fill_value": np.nan} for name in self._grid.variables()}
        draft = self._path.with_name(f".{self._path.name}.{os.getpid()}.part")
        try:
            # Coordinates and metadata alone: no block is computed.
            template.to_zarr(draft, mode="w-", compute=False, encoding=encoding, consolidated=False, zarr_format=3)
            draft.rename(self._path)
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def write_block(path: Path, region: Region, values: Mapping[str, np.ndarray]) -> None:
    """Write a block into a Zarr store, `ended_by` last; the same bits may come twice."""
    arrays = _arrays(path)
    for name in sorted(values, key=lambda name: name == "ended_by"):
        arrays[name][region] = values[name]


def open_store(grid: Grid, block: Sequence[int], path: Path | None) -> Store:
    """The store that the path's suffix names: .zarr, .nc, or memory where there is no path.

    Raises:
        ValueError: for another suffix.
        StoreError: where something else is there.
    """
    if path is None or path.suffix == ".nc":
        return MemoryStore(grid, block, path)
    if path.suffix == ".zarr":
        return ZarrStore(grid, block, path)
    raise ValueError(f"Argument `store` must end in .nc or .zarr, but is {path}.")


def _arrays(path: Path) -> Any:
    import zarr

    return dict(zarr.open_group(path, mode="r+").arrays())


def _read_netcdf(path: Path) -> xr.Dataset:
    try:
        return xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: is there already and is no netCDF file; it is left as it is.") from error


def _zarr_identity(path: Path) -> str | None:
    import zarr

    try:
        return str(zarr.open_group(path, mode="r").attrs.get(_IDENTITY))
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: is there already and is no Zarr group; it is left as it is.") from error


def _require_same(path: Path, found: Any, wanted: Mapping[str, str]) -> None:
    """Refuse a store whose identity is not the wanted one, and name what differs."""
    there = None
    with contextlib.suppress(json.JSONDecodeError, TypeError):
        there = json.loads(found)
    if not isinstance(there, dict):
        raise StoreError(f"{path}: is there already and is no sweep; it is left as it is.")
    differing = [name for name in wanted if there.get(name) != wanted[name]]
    if differing:
        raise StoreError(
            f"{path}: is there already and holds another sweep (its {' and '.join(differing)} differ); "
            "it is left as it is."
        )


def _check_folder(path: Path) -> None:
    if not path.parent.is_dir():
        raise StoreError(f"{path}: its folder does not exist.")


def _require_zarr() -> None:
    try:
        import dask.array
        import zarr  # noqa: F401
    except ImportError as error:
        raise StoreError('Zarr stores need the extra `dask`: pip install "erosion[dask]".') from error
