"""The wear of a surface as a labelled Dataset, its summary, and its files for ParaView, spreadsheets and xarray."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import check_path, check_tolerance, check_whole
from erosion.cfd.bodies import Bodies
from erosion.cfd.incidence import LEFT_OUT
from erosion.cfd.surface import Surface
from erosion.cfd.tally import FaceTally
from erosion.extras import library
from erosion.impacts.dataset_files import write_netcdf
from erosion.models.identity import code_version
from erosion.output.files import write_whole
from erosion.output.tables import Record, Result, Row, to_csv, to_plain, with_error
from erosion.parameters.parameters import validate
from erosion.parameters.per_mass import BEYOND_TESTS, FarFromTests, far_from_tests
from erosion.parameters.quantities import QUANTITIES, RESULTS, Quantity, quantity_row
from erosion.parameters.scales import table_scale
from erosion.parameters.units import System, conversion_factor


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """The case, and how a map is made of it; see `erosion_map`.

    Raises:
        ValueError, TypeError: for an option that makes no sense.
    """

    bodies: Bodies
    restitution: tuple[float, float] | None = None
    density: float | None = None
    limit: float | None = None
    rtol: float = 1e-9

    def __post_init__(self) -> None:
        object.__setattr__(self, "rtol", check_tolerance(self.rtol))
        check_whole("seed", self.bodies.seed, 0)
        check_whole("draws", self.bodies.draws, 2)
        validate(self.bodies.p)
        numbers = {name: getattr(self, name) for name in ("density", "limit")}
        for name, value in {**numbers, "diameter": self.bodies.diameter}.items():
            if value is not None and not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
                raise ValueError(f"Argument `{name}` must be positive and finite, but is {value!r}.")
        fraction = self.bodies.cutting_fraction
        if not (isinstance(fraction, (int, float, np.number)) and 0 < fraction <= 1):
            raise ValueError(f"Argument `cutting_fraction` must be above 0 and at most 1, but is {fraction!r}.")
        if self.restitution is not None:
            _check_restitution(self.restitution)


def _check_restitution(pair: Any) -> None:
    """Refuse what is no (e, μ)."""
    numbers = isinstance(pair, (tuple, list)) and all(isinstance(value, (int, float, np.number)) for value in pair)
    if not (numbers and len(pair) == 2 and 0 < pair[0] <= 1 and 0 <= pair[1] < 1):
        raise ValueError(
            "Argument `restitution` must be (e, μ) with e in (0, 1] and μ in [0, 1), as the wall of the CFD run has "
            f"them, but is {pair!r}."
        )


YEAR = 365.25 * 86400.0
"""Seconds of a year (Julian)."""

FACES: Mapping[str, Quantity] = {
    "volume": RESULTS["volume"],
    "depth": Quantity("h", "depth of wear, volume over area", "length"),
    "mass": Quantity("Δm", "removed mass", "mass"),
    "depth_rate": Quantity("ḣ", "depth per time", "speed"),
    "depth_per_year": Quantity("ḣ", "depth per year", "1"),
    "mass_flux": Quantity("ṁ", "removed mass per area and time", "mass flux"),
    "erosion": RESULTS["erosion"],
    "erosion_ratio": RESULTS["erosion_ratio"],
    "erodent": Quantity("M", "mass of erodent that hits", "mass"),
    "impacts": Quantity("n", "rows that hit", "1"),
    "particles": Quantity("N", "particles that hit", "1"),
    "alpha_mean": Quantity("ᾱ", "mean angle of attack of the particles", "angle"),
    "v0_mean": Quantity("v̄₀", "mean impact speed of the particles", "speed"),
    "relative_error": Quantity("s", "relative standard error of the volume", "1"),
    "sampling_error": Quantity("s", "relative standard error by the sample of impacts", "1"),
    "parameter_error": Quantity("s", "relative standard error by uncertain parameters", "1"),
    "area": Quantity("A", "area", "area"),
}
"""The variables over faces. `depth_per_year` is in mm/year in all unit systems."""

TOTALS = (
    "volume", "mass", "erodent", "erosion", "erosion_ratio", "impacts", "particles",
    "v0_mean", "relative_error", "sampling_error", "parameter_error",
)  # fmt: skip
"""Those that a patch, and the whole surface, have as well: `patch_volume`, `total_volume`, …"""


Variables = dict[str, tuple[Any, ...]]
"""Dimensions, values and attributes by name."""


def to_dataset(
    tally: FaceTally,
    options: MapOptions,
    surface: Surface | None,
    duration: float | None,
    ends: Sequence[str],
    attributes: Mapping[str, str],
    *,
    has_range: bool,
) -> xr.Dataset:
    """The wear of a surface with its units and its geometry.

    Args:
        tally: the sums of all rows.
        options: of the map.
        surface: None for totals alone.
        duration: that the table covers [s], where it is known.
        ends: the outcomes, columns of `tally.ends`.
        attributes: of the Dataset.
        has_range: whether the model is a correlation, which is made for a range of impacts.
    """
    units = options.bodies.p.units
    sums = {**tally.sums, "impacts": tally.impacts.astype(float)}
    draws = tally.of_draws if options.bodies.uncertain else None
    if draws is not None:
        sums["common"] = draws.var(axis=0, ddof=1)
    sums["erodent"] = sums["erodent"] * conversion_factor("mass", "si", units)
    sums["speed"] = sums["speed"] * conversion_factor("speed", "si", units)
    density = None if options.density is None else options.density * conversion_factor("density", "si", units)
    patches = ("all",) if surface is None else surface.patches
    patch = np.zeros(1, np.int64) if surface is None else np.asarray(surface.patch)
    variables: Variables = {}
    if surface is not None:
        variables |= _geometry(surface, units)
        numbers = _numbers(sums, density)
        numbers |= _per_area(numbers, surface.area * conversion_factor("area", "si", units), duration, units)
        for name in (name for name in FACES if name in numbers):
            variables[name] = ("face", numbers[name], _attributes(name, units))
    variables["patch"] = ("patch", np.array(patches, dtype=object))
    grouped = {name: _by_patch(values, patch, len(patches)) for name, values in sums.items() if name != "common"}
    whole = {name: np.array(math.fsum(values)) for name, values in grouped.items()}
    if draws is not None:
        of_patches = np.array([_by_patch(volume, patch, len(patches)) for volume in draws])
        # What is common to all faces does not average out: the variance of a sum is not the sum of variances.
        grouped["common"], whole["common"] = of_patches.var(axis=0, ddof=1), of_patches.sum(axis=1).var(ddof=1)
        total = {**_attributes("volume", units), "long_name": "removed volume of all faces for each draw"}
        variables["total_volume_of_draw"] = ("draw", of_patches.sum(axis=1), total)
    for prefix, dims, of in (("patch", ("patch",), grouped), ("total", (), whole)):
        for name, value in _numbers(of, density).items():
            if name in TOTALS:
                variables[f"{prefix}_{name}"] = (dims, value, _attributes(name, units))
    variables["end"] = ("end", np.array(ends, dtype=object))
    # An impact may end in another way for another draw: then rows are shared out.
    counts = tally.ends if draws is None else tally.ends / len(draws)
    variables["ends"] = (("patch", "end"), counts, {"long_name": "rows by how their impact ends", "units": "1"})
    variables |= _rows(tally, units, has_range=has_range)
    if duration is not None:
        variables["duration"] = ((), duration, {"long_name": "time that the impacts cover", "units": "s"})
    # At once: xarray looks at all variables for each one that is added.
    return xr.Dataset(variables, attrs=attributes)


def _numbers(sums: Mapping[str, np.ndarray], density: float | None) -> dict[str, np.ndarray]:
    """Variables from sums over rows, of faces, patches or all; "common" is the variance by uncertain parameters."""
    with np.errstate(invalid="ignore", divide="ignore"):
        numbers = {
            "volume": sums["volume"],
            "erosion": sums["volume"] / sums["erodent"],
            "erodent": sums["erodent"],
            "impacts": np.asarray(sums["impacts"]).astype(np.int64),
            "particles": sums["particles"],
            "alpha_mean": sums["angle"] / sums["particles"],
            "v0_mean": sums["speed"] / sums["particles"],
            "relative_error": np.sqrt(sums["squares"] + sums.get("common", 0.0)) / sums["volume"],
        }
        if "common" in sums:
            numbers["sampling_error"] = np.sqrt(sums["squares"]) / sums["volume"]
            numbers["parameter_error"] = np.sqrt(sums["common"]) / sums["volume"]
    if density is not None:
        numbers["mass"] = numbers["volume"] * density
        numbers["erosion_ratio"] = numbers["erosion"] * density
    return numbers


def _per_area(
    numbers: Mapping[str, np.ndarray], area: np.ndarray, duration: float | None, units: System
) -> dict[str, np.ndarray]:
    """Depths and rates, where what they need is known."""
    made = {"depth": numbers["volume"] / area}
    if duration is not None:
        made["depth_rate"] = made["depth"] / duration
        made["depth_per_year"] = made["depth_rate"] * (YEAR * 1e3 * conversion_factor("length", units, "si"))
        if "mass" in numbers:
            made["mass_flux"] = numbers["mass"] / (area * duration)
    return made


def _attributes(name: str, units: System) -> dict[str, str]:
    attributes = FACES[name].attributes(units)
    return attributes | {"units": "mm/year"} if name == "depth_per_year" else attributes


def _by_patch(values: np.ndarray, patch: np.ndarray, patches: int) -> np.ndarray:
    """Sums over the faces of each patch, rounded once."""
    return np.array([math.fsum(values[patch == i]) for i in range(patches)])


def _geometry(surface: Surface, units: System) -> Variables:
    """Points and corners of the faces, so that the Dataset alone can be drawn and written; in metres, as CFD has it."""
    metres = {"units": "m"}
    names = " ".join(surface.patches)
    flags = {"flag_values": np.arange(len(surface.patches), dtype=np.int32), "flag_meanings": names}
    area = surface.area * conversion_factor("area", "si", units)
    variables: Variables = {
        "point": (("points", "axis"), surface.points, {"long_name": "points of the surface", **metres}),
        "corner": ("corners", surface.corners, {"long_name": "points around each face, face after face"}),
        "corner_end": ("face", surface.ends, {"long_name": "where each face's corners end"}),
        "centre": (("face", "axis"), surface.centre, {"long_name": "centres of the faces", **metres}),
        "face_patch": ("face", np.asarray(surface.patch, np.int32), {"long_name": "patch", **flags}),
        "area": ("face", area, _attributes("area", units)),
    }
    if surface.mesh_face is not None:
        variables["mesh_face"] = ("face", surface.mesh_face, {"long_name": "number of the face in the mesh"})
    return variables


def _rows(tally: FaceTally, units: System, *, has_range: bool) -> Variables:
    """What became of the rows of the table."""
    of_mass = {"long_name": "their mass", "units": QUANTITIES["m"].unit(units)}
    variables: Variables = {
        "rows": ((), tally.rows, {"long_name": "rows of the table"}),
        "reason": ("reason", np.array(list(LEFT_OUT), dtype=object)),
        "left_out": ("reason", tally.fates[1:], {"long_name": "rows that are left out"}),
        "left_out_mass": ("reason", tally.lost_mass[1:] * conversion_factor("mass", "si", units), of_mass),
        "rows_to_nearest": ((), tally.unnamed, {"long_name": "rows that name no face"}),
    }
    distances = {"distance_median": (tally.median_distance, "their median distance, to 0.3 %"),
                 "distance_max": (tally.farthest, "their greatest distance")}  # fmt: skip
    for name, (metres, meaning) in distances.items() if tally.unnamed else ():
        length = metres * conversion_factor("length", "si", units)
        variables[name] = ((), length, {"long_name": meaning, "units": QUANTITIES["r"].unit(units)})
    if has_range:
        share = tally.outside_mass / tally.lost_mass[0] if tally.lost_mass[0] else math.nan
        variables["beyond_range"] = ((), share, {"long_name": "share of the mass outside the correlation's range"})
    return variables


@dataclasses.dataclass(frozen=True)
class MapSummary(Result):
    """The totals of a map, for people and as JSON.

    Args:
        dataset: see `erosion_map`.
    """

    dataset: xr.Dataset

    @property
    def title(self) -> str:
        """Model, table and surface in one line."""
        attrs = self.dataset.attrs
        surface = f" on {attrs['surface']}" if attrs["surface"] else ""
        own = f" ({attrs['own_parameters']})" if "own_parameters" in attrs else ""
        return f"{attrs['model']}{own}: {attrs['table']}{surface}"

    @property
    def units(self) -> System:
        """The unit system of the numbers."""
        return self.dataset.attrs["unit_system"]

    def rows(self) -> list[Row]:
        """The totals, the deepest face, each patch, and how impacts end."""
        data = self.dataset
        has_uncertain = "total_parameter_error" in data
        by = "and by uncertain parameters" if has_uncertain else "alone, all parameters taken as exact"
        meaning = f"rows that hit; ± of totals is the standard error by sampling the impacts {by}"
        rows = [Row("impacts", "", f"{int(data['total_impacts']):,}", "", meaning)]
        if "face" in data.dims:
            hit = int((data["impacts"] > 0).sum())
            rows.append(Row("faces hit", "", f"{hit:,} of {data.sizes['face']:,}", "", "of the surface"))
        rows += self._totals("total", "", ())
        for name in ("sampling_error", "parameter_error"):
            if f"total_{name}" in data:
                share = f"{100 * float(data[f'total_{name}']):.3g}"
                rows.append(Row(name, "", share, "%", f"of V and E: {FACES[name].meaning}"))
        if data.sizes["patch"] > 1:
            for i, patch in enumerate(data["patch"].values):
                rows += self._totals("patch", f" {patch}", (i,))[:1]
        for name in ("depth", "depth_per_year"):
            if name in data:
                row = quantity_row(f"greatest {name}", FACES[name], float(data[name].max()), self.units)
                unit = "mm/year" if name == "depth_per_year" else row.unit
                rows.append(row._replace(unit=unit, meaning=f"at face {int(np.argmax(data[name].values)):,}"))
        counts = data["ends"].sum("patch").values
        for end, count in zip(data["end"].values, counts, strict=True):
            if count:
                rows.append(Row(f"share {end}", "", f"{100 * count / counts.sum():.3g}", "%", "of the rows that hit"))
        for name, meaning in (("distance_median", "median"), ("distance_max", "greatest")):
            if name in data:
                length = quantity_row(name, QUANTITIES["r"], float(data[name]), self.units)
                rows.append(length._replace(symbol="", meaning=f"{meaning} distance of rows that name no face"))
        return rows

    def _totals(self, prefix: str, suffix: str, index: tuple[int, ...]) -> list[Row]:
        """Volume, mass, erodent and erosion of everything, or of a patch."""
        rows = []
        error = float(self.dataset[f"{prefix}_relative_error"].values[index])
        for name in ("volume", "mass", "erodent", "erosion", "erosion_ratio"):
            if f"{prefix}_{name}" not in self.dataset:
                continue
            value = float(self.dataset[f"{prefix}_{name}"].values[index])
            row = quantity_row(f"{name}{suffix}", FACES[name], value, self.units)
            if name in ("volume", "mass"):
                # Patches are in the unit of the whole.
                scale = table_scale(FACES[name].dimension, self.units, float(self.dataset[f"total_{name}"]))
                row = row._replace(
                    value=with_error(value, value * error if value else 0.0, scale.size), unit=scale.unit
                )
            if prefix == "total" and name in ("erosion", "erosion_ratio") and self._far and self._far.is_beyond:
                row = row._replace(meaning=f"{row.meaning}; {BEYOND_TESTS}")
            rows.append(row)
        return rows

    @property
    def warnings(self) -> list[str]:
        """Sentences on what is left out or doubtful."""
        data = self.dataset
        sentences = [data.attrs["warnings"]] if data.attrs["warnings"] else []
        total = int(data["rows"])
        for name, count in zip(data["reason"].values, data["left_out"].values, strict=True):
            if count and name != "elsewhere":
                far = f": {data.attrs['far_rows']}" if name == "too-far" else ""
                sentences.append(f"{count:,} of {total:,} rows {LEFT_OUT[name]}, and are not counted{far}.")
        failed = round(float(data["ends"].sum() - data["total_impacts"]))
        if failed:
            sentences.append(f"{failed:,} impacts could not be computed, and are not counted.")
        if "beyond_range" in data and float(data["beyond_range"]) > 0:
            share = f"{100 * float(data['beyond_range']):.3g} %"
            sentences.append(f"{share} of the mass that hits is outside the range of {data.attrs['model']}.")
        return sentences if self._far is None else [*sentences, str(self._far)]

    @property
    def _far(self) -> FarFromTests | None:
        """The erosion of the whole, where it is far from what tests find at its mean speed."""
        data = self.dataset
        specific, speed = float(data["total_erosion"]), float(data["total_v0_mean"])
        density = float(data["total_erosion_ratio"]) / specific if "total_erosion_ratio" in data and specific else None
        in_si = {name: conversion_factor(FACES[name].dimension, self.units, "si") for name in ("erosion", "v0_mean")}
        in_si_density = None if density is None else density / in_si["erosion"]
        return far_from_tests(specific * in_si["erosion"], speed * in_si["v0_mean"], in_si_density)

    def to_dict(self) -> Record:
        """Totals, patches, how impacts end and what is left out, with the units of the numbers."""
        data = self.dataset
        numbers: Record = {
            str(name): data[name].item() for name, variable in data.data_vars.items() if not variable.dims
        }
        units = {name: data[name].attrs.get("units", "1") for name in numbers}
        for name in ("depth", "depth_rate", "depth_per_year", "mass_flux"):
            if name in data:
                numbers[f"greatest_{name}"] = data[name].max().item()
                units[f"greatest_{name}"] = data[name].attrs["units"]
        if "depth" in data:
            numbers["deepest_face"] = int(np.argmax(data["depth"].values))
            numbers["faces"], numbers["faces_hit"] = data.sizes["face"], int((data["impacts"] > 0).sum())
        of_patches = [str(name) for name, variable in data.data_vars.items() if variable.dims == ("patch",)]
        units |= {name.removeprefix("patch_"): data[name].attrs["units"] for name in of_patches}
        numbers["patches"] = {
            patch: {name.removeprefix("patch_"): data[name].values[i] for name in of_patches}
            for i, patch in enumerate(data["patch"].values)
        }
        numbers["ends"] = dict(zip(data["end"].values, data["ends"].sum("patch").values, strict=True))
        numbers["left_out"] = dict(zip(data["reason"].values, data["left_out"].values, strict=True))
        pure = {name for name, unit in units.items() if unit == "1"}
        numbers["units"] = {name: unit for name, unit in units.items() if name not in pure}
        return to_plain(numbers)


SUFFIXES = (".vtp", ".csv", ".nc")


# By variable its heading, and the SI unit over the file's. The units fit to the surface, which is in metres, whatever
# those of the case are. ASCII, as ParaView's filters are.
_COLUMNS: Mapping[str, tuple[str, float]] = {
    "depth": ("depth [mm]", 1e3),
    "volume": ("volume [mm^3]", 1e9),
    "mass": ("mass [kg]", 1.0),
    "depth_rate": ("depth rate [m/s]", 1.0),
    "depth_per_year": ("depth rate [mm/year]", 1.0),
    "mass_flux": ("mass flux [kg/(m^2 s)]", 1.0),
    "erosion": ("erosion [mm^3/kg]", 1e9),
    "erosion_ratio": ("erosion ratio [kg/kg]", 1.0),
    "erodent": ("erodent [kg]", 1.0),
    "impacts": ("impacts", 1.0),
    "particles": ("particles", 1.0),
    "alpha_mean": ("mean angle [deg]", 180 / math.pi),
    "v0_mean": ("mean speed [m/s]", 1.0),
    "relative_error": ("relative standard error", 1.0),
    "sampling_error": ("relative error by sampling", 1.0),
    "parameter_error": ("relative error by parameters", 1.0),
    "area": ("area [mm^2]", 1e6),
}


def write_map(dataset: xr.Dataset, path: str | Path, identity: Mapping[str, str] | None = None) -> Path:
    """Write a map into a file; an existing one is replaced.

    Args:
        dataset: what `erosion_map` returns.
        path: `….vtp`, which ParaView opens: the surface in metres, with the wear of each face. `….csv`: a line for
            each face, or for all if there is no surface. `….nc`: the Dataset, with its identity.
        identity: of a netCDF file; without it the version and what the Dataset says of its origin.

    Raises:
        ValueError: for another suffix, and for a VTP file of a map without a surface.
        OSError: where the file cannot be written.
    """
    path = require_map_path(path, has_surface="face" in dataset.dims)
    if path.suffix == ".vtp":
        writer = library("vtkmodules.vtkIOXML", "cfd").vtkXMLPolyDataWriter()
        # VTK has words of its own for a full disk.
        writer.WriteToOutputStringOn()
        writer.SetInputData(to_polydata(dataset))
        writer.Write()
        write_whole(path, writer.GetOutputString().encode())
    elif path.suffix == ".csv":
        write_whole(path, _as_csv(dataset).encode())
    else:
        told = {str(name): str(value) for name, value in dataset.attrs.items()}
        write_netcdf(dataset, path, identity or {"version": code_version(), **told})
    return path


def require_map_path(path: str | Path, *, has_surface: bool = True) -> Path:
    """The path of a map's file; errors as of `write_map`."""
    path = check_path("path", path)
    if path.suffix not in SUFFIXES:
        raise ValueError(f"{path}: the name of a map's file must end in {', '.join(SUFFIXES)}.")
    if path.suffix == ".vtp" and not has_surface:
        raise ValueError(f"{path}: a .vtp file holds a surface, but there is none; a .csv file holds totals.")
    return path


def to_polydata(dataset: xr.Dataset) -> Any:
    """The surface of a map as pyvista's `PolyData`, with names and units in the names of the arrays.

    Raises:
        MissingExtraError: where pyvista is not installed.
    """
    points, corners, ends = (dataset[name].values for name in ("point", "corner", "corner_end"))
    sizes = np.diff(ends, prepend=0)
    # VTK's list of faces has the number of corners before each face's corners.
    cells = np.insert(corners, ends - sizes, sizes)
    surface = library("pyvista", "cfd").PolyData(points, faces=cells)
    for name, values in _columns(dataset, "").items():
        surface.cell_data[name] = values
    surface.cell_data["patch"] = dataset["face_patch"].values
    if "mesh_face" in dataset:
        surface.cell_data["mesh face"] = dataset["mesh_face"].values
    told = {str(name): [str(value)] for name, value in dataset.attrs.items() if value}
    told["patches"] = [str(name) for name in dataset["patch"].values]
    for name, texts in told.items():
        surface.field_data[name] = [text.encode("ascii", "backslashreplace").decode() for text in texts]
    return surface


def _columns(dataset: xr.Dataset, prefix: str) -> dict[str, np.ndarray]:
    """The columns of the variables that the map has."""
    units, columns = dataset.attrs["unit_system"], {}
    for name, (heading, size) in _COLUMNS.items():
        if prefix + name in dataset:
            factor = conversion_factor(FACES[name].dimension, units, "si") * size
            values = dataset[prefix + name].values
            columns[heading] = values if factor == 1 else values * factor
    return columns


def _as_csv(dataset: xr.Dataset) -> str:
    """A line for each face, or for each patch if there are no faces."""
    patches = dataset["patch"].values
    columns: dict[str, Any] = {}
    prefix = "" if "face" in dataset.dims else "patch_"
    if not prefix:
        columns["face"] = range(dataset.sizes["face"])
        columns["patch"] = [patches[i] for i in dataset["face_patch"].values]
        columns |= {f"{axis} [m]": dataset["centre"].values[:, i].tolist() for i, axis in enumerate("xyz")}
    else:
        columns["patch"] = list(patches)
    return to_csv(columns | {name: values.tolist() for name, values in _columns(dataset, prefix).items()})
