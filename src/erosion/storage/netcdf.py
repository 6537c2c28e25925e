"""netCDF files of results: written whole or not at all, with an identity and a checksum."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import h5py
import numpy as np
import xarray as xr

from erosion.files import Trace, free_path, trace, uninterrupted, write_whole
from erosion.storage.identity import IDENTITY, StoreError, require_same

_CHECKSUM = "checksum"
"""The attribute with the digest of all variables and attributes."""


def write_netcdf(
    dataset: xr.Dataset, path: Path, identity: Mapping[str, str], since: Trace | Literal["any"] = "any"
) -> Trace:
    """Write a result with its identity, whole or not at all; Ctrl-C waits until it is written.

    Args:
        dataset: the result.
        path: of the file.
        identity: see `identity`.
        since: the trace of the file that may be replaced; any without it.

    Returns:
        The trace of the new file.

    Raises:
        RuntimeError: where another file has come to `path`; the result is then beside it, as the error says.
        OSError: where the file cannot be written.
    """
    # In memory first: an HDF5 file that a full disk has cut short ends the process when it is closed.
    marked = _in_order(dataset).assign_attrs({IDENTITY: json.dumps(identity), _CHECKSUM: _checksum(dataset)})
    # Whoever reads it, HDF5 checks each array of numbers.
    summed = {
        name: {"fletcher32": True}
        for name, array in marked.variables.items()
        if array.size and array.ndim and array.dtype.kind in "iufb"
    }
    # Its memory is given back at once: a view that a traceback keeps is an error of Python when it is collected.
    with uninterrupted(), memoryview(marked.to_netcdf(None, engine="h5netcdf", encoding=summed)) as content:
        moved = since != "any" and trace(path) not in (None, since)
        target = free_path(path) if moved else path
        write_whole(target, content)
    if moved:
        raise RuntimeError(
            f"{path}: another result has come there meanwhile, and is left as it is; this one is in {target}."
        )
    return trace(path)


def read_netcdf(path: Path, identity: Mapping[str, str]) -> xr.Dataset:
    """Read a result into memory, if it has this identity and is whole.

    Raises:
        StoreError: where the file is something else, or not what was written.
    """
    if not path.is_file():  # to open a pipe would wait for its writer
        raise StoreError(f"{path}: is there already and is no netCDF file; it is left as it is.")
    try:
        # Not by xarray, which prints warnings for an HDF5 file that is not netCDF.
        with h5py.File(path) as file:
            stored, checksum = file.attrs.get(IDENTITY), file.attrs.get(_CHECKSUM)
    except PermissionError as error:
        raise StoreError(f"{path}: cannot be read (Permission denied).") from error
    except (OSError, RuntimeError, KeyError) as error:
        raise StoreError(f"{path}: is there already and is no netCDF file; it is left as it is.") from error
    require_same(path, stored, identity)
    try:
        dataset = xr.load_dataset(path, engine="h5netcdf")
    # Damaged bytes may be anything to the libraries.
    except (OSError, ValueError, RuntimeError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise StoreError(f"{path}: is damaged and cannot be read; it is left as it is.") from error
    dataset.attrs.pop(_CHECKSUM, None)
    if checksum != _checksum(dataset):
        raise StoreError(f"{path}: is damaged, or was changed after it was written; it is left as it is.")
    return dataset


def _in_order(dataset: xr.Dataset) -> xr.Dataset:
    """The same with its variables in one order: what was read and goes on is written as what was never stored."""
    coordinates = {name: dataset.variables[name] for name in sorted(dataset.coords, key=str)}
    return xr.Dataset(coords=coordinates, attrs=dataset.attrs).assign(
        {name: dataset[name].variable for name in sorted(dataset.data_vars, key=str)}
    )


def _checksum(dataset: xr.Dataset) -> str:
    """The digest of names, shapes and bytes of all variables, and of the attributes that hold results."""
    content = hashlib.sha256()
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        content.update(f"{name} {variable.dims} {variable.shape}".encode())
        values = np.asarray(variable.values)
        is_text = values.dtype.kind in "OUS"
        content.update(json.dumps(values.tolist()).encode() if is_text else np.ascontiguousarray(values).tobytes())
    attributes = {str(name): np.asarray(value).tolist() for name, value in dataset.attrs.items() if name != IDENTITY}
    content.update(json.dumps(attributes, sort_keys=True).encode())
    return content.hexdigest()
