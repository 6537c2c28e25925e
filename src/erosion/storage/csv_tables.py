"""Labelled results as a table of comma-separated values, for spreadsheets."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.files import write_whole
from erosion.parameters.parameters import Parameters
from erosion.parameters.per_mass import PerMass
from erosion.tables import to_csv

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
