"""netCDF files of results: written whole or not at all, with an identity."""

import json
from collections.abc import Mapping
from pathlib import Path

import h5py
import xarray as xr

from erosion.files import write_whole
from erosion.storage.identity import IDENTITY, StoreError, require_same


def write_netcdf(dataset: xr.Dataset, path: Path, identity: Mapping[str, str]) -> None:
    """Write a result with its identity, whole or not at all."""
    # In memory first: an HDF5 file that a full disk has cut short ends the process when it is closed.
    content = dataset.assign_attrs({IDENTITY: json.dumps(identity)}).to_netcdf(None, engine="h5netcdf")
    write_whole(path, content)


def read_netcdf(path: Path, identity: Mapping[str, str]) -> xr.Dataset:
    """Read a result into memory, if it has this identity.

    Raises:
        StoreError: where the file is something else.
    """
    try:
        # Not by xarray, which prints warnings for an HDF5 file that is not netCDF.
        with h5py.File(path) as file:
            stored = file.attrs.get(IDENTITY)
    except OSError as error:
        raise StoreError(f"{path}: is there already and is no netCDF file; it is left as it is.") from error
    require_same(path, stored, identity)
    return xr.load_dataset(path, engine="h5netcdf")
