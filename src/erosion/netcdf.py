"""netCDF files of results: written whole or not at all, and never over something else."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

import xarray as xr

from erosion.provenance import IDENTITY, StoreError, require_same


def write_netcdf(dataset: xr.Dataset, path: Path, identity: Mapping[str, str]) -> None:
    """Write a result with its identity; the file is there completely or not at all."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        dataset.assign_attrs({IDENTITY: json.dumps(identity)}).to_netcdf(draft, engine="h5netcdf")
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


def read_netcdf(path: Path, identity: Mapping[str, str]) -> xr.Dataset:
    """Read a result into memory, if it has this identity.

    Raises:
        StoreError: where the file is something else.
    """
    try:
        dataset = xr.load_dataset(path, engine="h5netcdf")
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: is there already and is no netCDF file; it is left as it is.") from error
    require_same(path, dataset.attrs.get(IDENTITY), identity)
    return dataset


def check_folder(path: Path) -> None:
    """Know before computing that there is a place to write to.

    Raises:
        StoreError: where there is none.
    """
    if not path.parent.is_dir():
        raise StoreError(f"{path}: its folder does not exist.")
