"""Labelled results in files: CSV for spreadsheets, netCDF written whole or not at all, with identity and checksum."""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import xarray as xr

from erosion.models.identity import IDENTITY, StoreError, require_same
from erosion.output.files import Trace, free_path, trace, uninterrupted, write_whole
from erosion.output.tables import to_csv
from erosion.parameters.parameters import Parameters
from erosion.parameters.per_mass import PerMass

_PER_MASS: Mapping[str, tuple[str, float]] = {
    "cutting_fraction": ("cutting_fraction", 1.0),
    "specific_volume": ("specific_volume [mm^3/kg]", 1e9),
    "erosion_ratio": ("erosion_ratio [g/kg]", 1e3),
}
"""Heading and factor of each column per mass of abrasive."""


def write_csv(dataset: xr.Dataset, path: Path, p: Parameters, weights: Mapping[str, PerMass]) -> None:
    """Write a sweep or a comparison: a line for each point of the grid, its model and axes first, then its results.

    Angles are in degrees, everything else in the units of the dataset, which stand in the headings: "v0 [m/s]".
    Outcomes are words. The share of the particles that cut and the erosion per mass of abrasive, in mm³/kg and g/kg,
    come last.

    Args:
        dataset: with `volume`, and the parameters that vary as coordinates.
        path: of the file, which is replaced.
        p: the case, for the mass where it does not vary.
        weights: by model, how a volume becomes erosion per mass; the key "" stands for all models.
    """
    write_whole(path, to_csv(dict(_columns(dataset, p, weights))).encode())


def _columns(dataset: xr.Dataset, p: Parameters, weights: Mapping[str, PerMass]) -> Iterator[tuple[str, Any]]:
    """Each column's heading and its cells, of the points in the order of the grid."""
    dims = tuple(dataset.volume.dims)
    if "model" not in dataset.coords:
        yield "model", [dataset.attrs["model"]] * dataset.volume.size
    for name in (*dataset.coords, *dataset.data_vars):
        variable = dataset[name]
        if name == "pair" or not set(variable.dims) <= set(dims):  # a pair's number says nothing
            continue
        yield _heading(str(name), variable), _cells(variable.broadcast_like(dataset.volume).transpose(*dims))
    yield from _per_mass(dataset, p, weights)


def _heading(name: str, variable: xr.DataArray) -> str:
    unit = variable.attrs.get("units", "")
    return f"{name} [{'deg' if unit == 'rad' else unit}]" if unit not in ("", "1") else name


def _cells(values: xr.DataArray) -> list[Any]:
    flat = values.values.ravel()
    if "flag_meanings" in values.attrs:
        return np.array(values.attrs["flag_meanings"].split())[flat].tolist()
    return (np.rad2deg(flat) if values.attrs.get("units") == "rad" else flat).tolist()


def _per_mass(dataset: xr.Dataset, p: Parameters, weights: Mapping[str, PerMass]) -> Iterator[tuple[str, list[Any]]]:
    volume = dataset.volume
    mass = (dataset["m"] if "m" in dataset else xr.DataArray(float(p.m))).broadcast_like(volume)
    mass = mass.transpose(*volume.dims)

    def weigh(model: str, values: xr.DataArray, masses: xr.DataArray) -> dict[str, np.ndarray]:
        weight = weights[model]
        share = {"cutting_fraction": np.full(values.shape, weight.cutting_fraction)}
        return share | weight.to_dict(values.values, dataclasses.replace(p, m=masses.values))

    if "" in weights:
        parts = {name: volume.copy(data=part) for name, part in weigh("", volume, mass).items()}
    else:
        each = {name: weigh(name, volume.sel(model=name), mass.sel(model=name)) for name in weights}
        common = set.intersection(*(set(part) for part in each.values()))
        parts = {name: volume.copy() for name in _PER_MASS if name in common}
        for name, part in parts.items():
            for model, numbers in each.items():
                part.loc[{"model": model}] = numbers[name]
    for name, part in parts.items():
        heading, factor = _PER_MASS[name]
        yield heading, (part.values.ravel() * factor).tolist()


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
