"""Results in files: their identity, CSV for spreadsheets, netCDF written whole or not at all, with a checksum.

The identity of a result is all that its numbers depend on: version, case and models. A file of another identity
is refused.
"""

import contextlib
import dataclasses
import functools
import hashlib
import importlib.metadata
import itertools
import json
import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
import xarray as xr

from erosion.interrupts import held_off
from erosion.models import CuttingModel, model_digest, model_name, own_in_words
from erosion.ode.step_control import require_float64
from erosion.output import Trace, digest, to_csv, trace, write_whole
from erosion.parameters import Parameters, PerMass, dump_case
from erosion.version import __version__

_PACKAGE = Path(__file__).parents[1]
_WITHOUT_NUMBERS = ("cli", "explorer", "plotting", "report")  # they show what the other folders compute

_SHOWN = 3  # numbers that a message names

IDENTITY = "identity"
"""The attribute that holds a stored result's identity, as JSON."""


class StoreError(ValueError):
    """A file or folder that holds something other than the wanted result."""


def identity(models: Mapping[str, CuttingModel], p: Parameters, **more: str) -> dict[str, str]:
    """What a result depends on, in words; two results of the same identity have the same bits.

    Raises:
        ValueError: for a model that computes by what only this process knows.
    """
    return {
        "version": code_version(),
        "case": dump_case(p),
        "models": "\n".join(f"{label}: {model_digest(model)}" for label, model in models.items()),
        **more,
    }


def provenance(content: str, p: Parameters, **more: Any) -> dict[str, Any]:
    """The attributes of a Dataset of results: conventions, what it holds, versions, and the case."""
    return {
        "Conventions": "CF-1.11",
        "title": f"Solid particle erosion: {content}",
        "source": f"erosion {__version__}",
        **more,
        "unit_system": p.shown_in,
        "case": dump_case(p),
    }


def model_in_words(model: CuttingModel, but: Collection[str] = ()) -> dict[str, str]:
    """A model's name, and its own parameters `but` those that vary, as attributes for `provenance`."""
    own = own_in_words(model, but=but)
    return {"model": model_name(model), **({"own_parameters": own} if own else {})}


@functools.cache
def package_digest() -> str:
    """The digest of this package's own code, as far as numbers depend on it."""
    files = {str(file.relative_to(_PACKAGE)): file for file in sorted(_PACKAGE.rglob("*.py"))}
    return digest(
        b"\0".join(
            name.encode() + b"\0" + file.read_bytes()
            for name, file in files.items()
            if not name.startswith(_WITHOUT_NUMBERS)
        )
    )


def code_version() -> str:
    """The versions that the numbers depend on, and the digest of this package's code, which may be edited."""
    return f"erosion {__version__} ({package_digest()}), jaxlib {importlib.metadata.version('jaxlib')}"


def require_code(code: str, begun: str) -> None:
    """Refuse to go on in a process that computes with other code than the work, such as "sweep", was begun with.

    Raises:
        RuntimeError, PrecisionError: where it does, or not in float64.
    """
    require_float64()
    if code_version() != code:
        raise RuntimeError(f"A worker has {code_version()}, but the {begun} was begun with {code}.")


def require_same(path: Path, stored: Any, wanted: Mapping[str, str]) -> None:
    """Refuse a store whose identity is not the wanted one.

    Args:
        path: of the store.
        stored: its identity as JSON, or anything else.
        wanted: the identity of the result.

    Raises:
        StoreError: one sentence that names the parts that differ.
    """
    stored_identity = None
    with contextlib.suppress(json.JSONDecodeError, TypeError):
        stored_identity = json.loads(stored)
    if not isinstance(stored_identity, dict):
        raise StoreError(f"{path}: is there already and holds something else; it is left as it is.")
    differing = [name for name in wanted if stored_identity.get(name) != wanted[name]]
    if differing:
        known = "".join(_differences(str(stored_identity.get(name)), wanted[name]) for name in differing)
        raise StoreError(
            f"{path}: is there already and holds another result (of another {' and '.join(differing)}){known}; "
            "it is left as it is."
        )


def _differences(stored: str, wanted: str) -> str:
    """Which numbers of a part of an identity differ, as clauses."""
    there, here = _numbers_in(stored), _numbers_in(wanted)
    names = [name for name in {**there, **here} if there.get(name) != here.get(name)]
    shown = [f"; {name} is {there.get(name, 'not')} there, and {here.get(name, 'not')} here" for name in names]
    return "".join(shown[:_SHOWN]) + (f"; {len(shown) - _SHOWN} more differ" if len(shown) > _SHOWN else "")


def _numbers_in(part: str) -> dict[str, str]:
    """The numbers in a part of an identity, by name; none where it is a digest."""
    for read in (json.loads, tomllib.loads):
        with contextlib.suppress(ValueError):
            content = read(part)
            return {name: str(value) for name, value in content.items()} if isinstance(content, dict) else {}
    return {}


def numbers_in_words(numbers: Mapping[str, Any]) -> str:
    """Named numbers and arrays as a part of an identity, to their last bit."""
    return json.dumps({name: _in_words(value) for name, value in numbers.items()})


def _in_words(value: Any) -> str:
    if not isinstance(value, (int, float, np.ndarray, np.generic)):
        return repr(value)
    array = np.asarray(value)
    if array.ndim == 0:
        return repr(array.item())
    ends = f" from {array.flat[0]!s} to {array.flat[-1]!s}" if array.size else ""
    return f"{' × '.join(map(str, array.shape))} numbers{ends} ({digest(array.tobytes())})"


_PER_MASS: Mapping[str, tuple[str, float]] = {
    "cutting_fraction": ("cutting_fraction", 1.0),
    "specific_volume": ("specific_volume [mm^3/kg]", 1e9),
    "erosion_ratio": ("erosion_ratio [g/kg]", 1e3),
}
"""Heading and factor of each column per mass of particles."""


def write_csv(dataset: xr.Dataset, path: Path, p: Parameters, weights: Mapping[str, PerMass]) -> None:
    """Write a sweep or a comparison: a line for each point of the grid, its model and axes first, then its results.

    Angles are in degrees, everything else in SI; the units stand in the headings: "v0 [m/s]".
    Outcomes are words. The share of the particles that cut and the erosion per mass of particles, in mm³/kg and g/kg,
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
    # Its variables in one order: what was read and goes on is written as what was never stored.
    coordinates = {name: dataset.variables[name] for name in sorted(dataset.coords, key=str)}
    variables = {name: dataset[name].variable for name in sorted(dataset.data_vars, key=str)}
    ordered = xr.Dataset(coords=coordinates, attrs=dataset.attrs).assign(variables)
    marked = ordered.assign_attrs({IDENTITY: json.dumps(identity), _CHECKSUM: _checksum(dataset)})
    # Whoever reads it, HDF5 checks each array of numbers.
    summed = {
        name: {"fletcher32": True}
        for name, array in marked.variables.items()
        if array.size and array.ndim and array.dtype.kind in "iufb"
    }
    # Its memory is given back at once: a view that a traceback keeps is an error of Python when it is collected.
    with held_off(), memoryview(marked.to_netcdf(None, engine="h5netcdf", encoding=summed)) as content:
        moved = since != "any" and trace(path) not in (None, since)
        numbered = (path.with_stem(f"{path.stem}-{number}") for number in itertools.count(2))
        target = next(other for other in numbered if not other.exists()) if moved else path
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
