"""The wear of a surface as a labelled Dataset, and its summary."""

import dataclasses
import functools
import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from erosion.cfd.incidence import LEFT_OUT
from erosion.cfd.options import MapOptions
from erosion.cfd.surface import Surface
from erosion.cfd.table_summary import ONE_ROW
from erosion.cfd.tally import FaceTally
from erosion.parameters import (
    BEYOND_TESTS,
    RESULTS,
    FarFromTests,
    Quantity,
    Scale,
    System,
    far_from_tests,
    readable_scale,
)
from erosion.results import Columns, Declared, Finding, Mark, Result, Value, from_attribute

_BY_CHANCE, _MANY = 0.05, 10  # excess of the worst face, and faces beside it, from which chance is told
_ALONE, _SOME = 0.7, 4  # standard error of a face of some rows, from which on one of them does most of its wear
_MANY_RECEDE = 0.1  # of the rows, more than recede at the edges of fine facets
_ROUGH = 0.3  # of a depth: such an error is that of a few rows, and not normal
_NANOMETRE = 9  # decimals of a metre: less of a distance is rounding

YEAR = 365.25 * 86400.0
"""Seconds of a year (Julian)."""


@dataclasses.dataclass(frozen=True)
class Wear(Quantity):
    """A number of each face.

    Args:
        heading: of its column in files, in units that fit to the surface, which is in metres, whatever those of the
            case are. ASCII, as ParaView's filters are.
        per_si: the SI unit over that of the column.
        of_total: whether a patch, and the whole surface, have it as well: `patch_volume`, `total_volume`, …
    """

    heading: str = ""
    per_si: float = 1.0
    of_total: bool = False

    @classmethod
    def like(cls, name: str, heading: str, per_si: float = 1.0) -> "Wear":
        """A result of an impact, summed over those of a face."""
        known = RESULTS[name]
        return cls(known.symbol, known.meaning, known.dimension, "", heading, per_si, of_total=True)


FACES: Mapping[str, Wear] = {
    "volume": Wear.like("volume", "volume [mm^3]", 1e9),
    "depth": Wear("h", "depth of wear, volume over area", "length", "", "depth [mm]", 1e3),
    "mass": Wear("Δm", "removed mass", "mass", "", "mass [kg]", of_total=True),
    "depth_rate": Wear("ḣ", "depth per time", "speed", "", "depth rate [m/s]"),
    "depth_per_year": Wear("ḣ", "depth per year", "1", "mm/year", "depth rate [mm/year]"),
    "mass_flux": Wear("ṁ", "removed mass per area and time", "mass flux", "", "mass flux [kg/(m^2 s)]"),
    "erosion": Wear.like("erosion", "erosion [mm^3/kg]", 1e9),
    "erosion_ratio": Wear.like("erosion_ratio", "erosion ratio [kg/kg]"),
    "injected_ratio": Wear("Δm/M₀", "mass loss per mass of sand injected", "mass per mass", "",
                           "erosion ratio of sand injected [kg/kg]", of_total=True),
    "particle_mass": Wear("M", "mass of particles that hit", "mass", "", "particle_mass [kg]", of_total=True),
    "impacts": Wear("n", "rows that hit", "1", "", "impacts", of_total=True),
    "particles": Wear("N", "particles that hit", "1", "", "particles", of_total=True),
    "alpha_mean": Wear("ᾱ", "mean angle of attack of the particles", "angle", "", "mean angle [deg]", 180 / math.pi),
    "v0_mean": Wear("v̄₀", "mean impact speed of the particles", "speed", "", "mean speed [m/s]", of_total=True),
    "relative_error": Wear("s", "relative standard error of the volume", "1", "", "relative standard error",
                           of_total=True),
    "sampling_error": Wear("s", "relative standard error by the sample of impacts", "1", "",
                           "relative error by sampling", of_total=True),
    "parameter_error": Wear("s", "relative standard error by uncertain parameters", "1", "",
                            "relative error by parameters", of_total=True),
    "mass_per_year": Wear("Δṁ", "removed mass per year", "1", "kg/year", "mass rate [kg/year]", of_total=True),
    "area": Wear("A", "area", "area", "", "area [mm^2]", 1e6),
}  # fmt: skip
"""The variables over faces. `depth_per_year` is in mm/year in all unit systems."""

_SINGLE: Mapping[str, Quantity] = {
    "duration": Quantity("t", "duration", "time"),
    "injected": Quantity("M₀", "mass of sand injected", "mass"),
    "sand_rate": Quantity("Ṁ", "sand that comes", "mass flow"),
    **dict.fromkeys(("distance_median", "distance_max"), Quantity("", "distance", "length")),
}
"""Numbers of a map that no face has."""
_OF_PROGRAMS = ("particles", "v0_mean", "relative_error")  # totals that tables leave out
_WITH_ERROR = ("volume", "mass", "mass_per_year")  # totals with their standard error


def total_scale(name: str, system: System, total: float) -> Scale:
    """The unit in which a total volume or mass reads well: "mg", "g/year"."""
    if not FACES[name].fixed:
        return readable_scale(FACES[name].dimension, system, total)
    mass = readable_scale("mass", "si", total)
    return Scale(mass.size, f"{mass.unit}/year")


class Sand(NamedTuple):
    """The sand of a run.

    Args:
        duration: that the impacts stand for [s]; None where it is not known.
        duration_from: who says so.
        injected: its mass [kg], hits or not; None where it is not known.
        injected_from: who says so.
        findings: what is doubtful in these.
    """

    duration: float | None
    duration_from: str
    injected: float | None
    injected_from: str
    findings: tuple[Finding, ...]


Variables = dict[str, tuple[Any, ...]]
"""Dimensions, values and attributes by name."""


def to_dataset(
    tally: FaceTally,
    options: MapOptions,
    surface: Surface | None,
    sand: Sand,
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
        sand: its mass, and the duration.
        ends: the outcomes, columns of the tally's `ends`.
        attributes: of the Dataset.
        has_range: whether the model is a correlation, which is made for a range of impacts.
    """
    sums, parcels = tally.sums, tally.parcels
    draws = tally.of_draws if options.uncertain else None
    patches = ("all",) if surface is None else surface.patches
    patch = np.zeros(1, np.int64) if surface is None else np.asarray(surface.patch)

    def by_patch(values: np.ndarray) -> np.ndarray:
        """Sums over the faces of each patch, rounded once."""
        return np.array([math.fsum(values[patch == i]) for i in range(len(patches))])

    grouped = {name: by_patch(values) for name, values in sums.items()}
    whole = {name: np.array(math.fsum(values)) for name, values in grouped.items()}
    # Bounces of a parcel are one event, also on several faces.
    for of, group in ((sums, np.arange(len(patch))), (grouped, patch), (whole, np.zeros_like(patch))):
        of["squares"] = of["squares"] + parcels.bounces(group, np.size(of["squares"])).reshape(np.shape(of["squares"]))
    if sand.injected is not None:
        grouped["injected"] = whole["injected"] = np.array(sand.injected)
    if draws is not None:
        sums["common"] = draws.var(axis=0, ddof=1)
    variables: Variables = {}
    if surface is not None:
        numbers = _numbers(sums, options.density, surface.area, sand.duration) | {"area": surface.area}
        variables |= _geometry(surface)
        variables |= {name: _variable("face", numbers[name], FACES[name]) for name in FACES if name in numbers}
    variables["patch"] = ("patch", np.array(patches, dtype=object))
    if draws is not None:
        of_patches = np.array([by_patch(volume) for volume in draws])
        # What is common to all faces does not average out: the variance of a sum is not the sum of variances.
        grouped["common"], whole["common"] = of_patches.var(axis=0, ddof=1), of_patches.sum(axis=1).var(ddof=1)
        what = "removed volume of all faces for each draw"
        variables["total_volume_of_draw"] = _variable("draw", of_patches.sum(axis=1), FACES["volume"], what)
    for prefix, dims, of in (("patch", ("patch",), grouped), ("total", (), whole)):
        for name, value in _numbers(of, options.density, None, sand.duration).items():
            if FACES[name].of_total:
                variables[f"{prefix}_{name}"] = _variable(dims, value, FACES[name])
    variables["end"] = ("end", np.array(ends, dtype=object))
    # An impact may end in another way for another draw: then rows are shared out.
    counts = tally.counts["ends"] if draws is None else tally.counts["ends"] / len(draws)
    variables["ends"] = (("patch", "end"), counts, {"long_name": "rows by how their impact ends", "units": "1"})
    variables |= _rows(tally, has_range=has_range)
    if sand.duration is not None:
        what = f"time that the impacts stand for, {sand.duration_from}"
        variables["duration"] = ((), sand.duration, {"long_name": what, "units": "s"})
    if "injected" in whole:
        what = f"mass of sand injected, {sand.injected_from}"
        variables["injected"] = _variable((), whole["injected"], _SINGLE["injected"], what)
    if options.sand_rate is not None:
        variables["sand_rate"] = _variable((), options.sand_rate, _SINGLE["sand_rate"])
    turned, sampled = tally.counts["turned"].tolist()
    if sampled:
        what = "share of the impacts in which the body turns by more than 90°"
        variables["turned_share"] = ((), turned / sampled, {"long_name": what, "units": "1"})
    if len(parcels.known):
        variables["parcels"] = ((), len(np.unique(parcels.parcel)), {"long_name": "parcels that hit"})
    # At once: xarray looks at all variables for each one that is added.
    return xr.Dataset(variables, attrs=attributes)


def _variable(dims: str | tuple[str, ...], values: Any, quantity: Quantity, words: str = "") -> tuple[Any, ...]:
    """A variable of numbers in SI; `words` take the place of its meaning."""
    return dims, values, quantity.attributes() | ({"long_name": words} if words else {})


def _numbers(
    sums: Mapping[str, np.ndarray],
    density: float | None,
    area: np.ndarray | None = None,
    duration: float | None = None,
) -> dict[str, np.ndarray]:
    """Variables in SI from sums over rows, of faces, patches or all; depths and rates, where what they need is known.

    Args:
        sums: by name; "common" is the variance by uncertain parameters.
        density: of the target [kg/m³].
        area: of faces [m²].
        duration: that the table covers [s].
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        numbers = {
            "volume": sums["volume"],
            "erosion": sums["volume"] / sums["particle_mass"],
            "particle_mass": sums["particle_mass"],
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
        numbers |= {"mass": numbers["volume"] * density, "erosion_ratio": numbers["erosion"] * density}
        if "injected" in sums:
            numbers["injected_ratio"] = numbers["mass"] / sums["injected"]
        if duration is not None:
            numbers["mass_per_year"] = numbers["mass"] / duration * YEAR
    if area is None:
        return numbers
    numbers["depth"] = numbers["volume"] / area
    if duration is not None:
        numbers["depth_rate"] = numbers["depth"] / duration
        numbers["depth_per_year"] = numbers["depth_rate"] * (YEAR * 1e3)
        if "mass" in numbers:
            numbers["mass_flux"] = numbers["mass"] / (area * duration)
    return numbers


def _geometry(surface: Surface) -> Variables:
    """Points and corners of the faces, so that the Dataset alone can be drawn and written; in metres, as CFD has it."""
    flags = {"flag_values": np.arange(len(surface.patches), dtype=np.int32), "flag_meanings": " ".join(surface.patches)}
    variables: Variables = {
        "point": (("points", "axis"), surface.points, {"long_name": "points of the surface", "units": "m"}),
        "corner": ("corners", surface.corners, {"long_name": "points around each face, face after face"}),
        "corner_end": ("face", surface.ends, {"long_name": "where each face's corners end"}),
        "centre": (("face", "axis"), surface.centre, {"long_name": "centres of the faces", "units": "m"}),
        "face_patch": ("face", np.asarray(surface.patch, np.int32), {"long_name": "patch", **flags}),
    }
    if surface.mesh_face is not None:
        variables["mesh_face"] = ("face", surface.mesh_face, {"long_name": "number of the face in the mesh"})
    return variables


def _rows(tally: FaceTally, *, has_range: bool) -> Variables:
    """What became of the rows of the table."""
    lost = tally.counts["lost_mass"]
    variables: Variables = {
        "rows": ((), tally.rows, {"long_name": "rows of the table"}),
        "reason": ("reason", np.array(list(LEFT_OUT), dtype=object)),
        "left_out": ("reason", tally.counts["fates"][1:], {"long_name": "rows that are left out"}),
        "left_out_mass": _variable("reason", lost[1:], FACES["particle_mass"], "their mass"),
        "rows_to_nearest": ((), tally.unnamed, {"long_name": "rows that name no face"}),
    }
    if tally.unnamed:
        for name, distance, words in (
            ("distance_median", tally.median_distance, "median distance, to 0.3 %"),
            ("distance_max", tally.farthest, "greatest distance"),
        ):
            what = f"{words}, of rows that name no face from the nearest"
            variables[name] = _variable((), round(distance, _NANOMETRE), _SINGLE[name], what)
    if has_range:
        share = float(tally.counts["outside_mass"]) / lost[0] if lost[0] else math.nan
        variables["beyond_range"] = ((), share, {"long_name": "share of the mass outside the correlation's range"})
    return variables


@dataclasses.dataclass(frozen=True, repr=False)
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
    def shown_in(self) -> System:
        """The unit system of the numbers."""
        return self.dataset.attrs["unit_system"]

    @property
    def conclusions(self) -> Sequence[str]:
        """How the table is read."""
        return self.dataset.attrs["read_as"].splitlines()

    def declare(self) -> list[Declared]:
        """The totals, the deepest face, how impacts end and what is left out; a table of the patches."""
        data = self.dataset
        of_ends = zip(data["end"].values, data["ends"].sum("patch").values.tolist(), strict=True)
        ends = {end: count for end, count in of_ends if count}
        left_out = data["left_out"].values.tolist()
        return [
            *(self._single(str(name)) for name, variable in data.data_vars.items() if not variable.dims),
            *(self._of_faces() if "face" in data.dims else ()),
            # All impacts of a correlation end without a cut.
            Value("ends", [*ends.values()], meaning="rows that hit", labels=[*ends],
                  only="data" if "beyond_range" in data else ""),
            Value("left_out", left_out, labels=data["reason"].values.tolist(), only="data"),
            Value("read_as", data.attrs["read_as"], only="data"),
            self._patches(),
        ]  # fmt: skip

    def _single(self, name: str) -> Value:
        """A number of the whole map."""
        data, of = self.dataset, name.removeprefix("total_")
        value, meaning = data[name].item(), data[name].attrs["long_name"]
        quantity = _SINGLE.get(name) or FACES.get(of)
        if quantity is None:
            unit = data[name].attrs.get("units", "")
            return Value(name, value, meaning=meaning, unit="" if unit == "1" else unit, only="data")
        more: dict[str, Any] = {"meaning": meaning}
        if of in _OF_PROGRAMS or (of in ("volume", "mass") and self._is_a_year):
            return self._declared(name, quantity, value, **more, only="data")
        if of == "impacts":
            parcels = f", of {int(data['parcels']):,} parcels" if "parcels" in data else ""
            by = "and by uncertain parameters" if "total_parameter_error" in data else "alone, all parameters exact"
            more["meaning"] = f"rows that hit{parcels}; ± is the standard error by sampling the impacts {by}"
        elif of in _WITH_ERROR:
            more["error"] = _times(value, data["total_relative_error"].item())
        elif of in ("sampling_error", "parameter_error"):
            more |= {"meaning": f"of V and E: {meaning}", "scale": Scale(0.01, "%"), "digits": 3}
        elif of in ("erosion", "erosion_ratio"):
            more["marks"] = [Mark(self._far is not None and self._far.is_beyond, BEYOND_TESTS)]
        elif name == "sand_rate":
            more["scale"] = Scale(1 / 86400, "kg/day")
        return self._declared(name, quantity, value, **more)

    def _declared(self, name: str, quantity: Quantity, value: Any, **more: Any) -> Value:
        """A number of a quantity; counts and shares have no unit, and people read kilogrammes a year as grams."""
        made = quantity.declare(name, value, **more)
        if quantity.fixed == "kg/year":
            return made.but(scale=functools.partial(total_scale, "mass_per_year", self.shown_in))
        return made.but(measure=None) if quantity.unit(self.shown_in) == "1" else made

    def _of_faces(self) -> Iterator[Value]:
        """How many faces are hit, and the greatest of their depths and rates."""
        data = self.dataset
        face, faces = self._worst, data.sizes["face"]
        yield Value("faces", faces, only="data")
        yield Value("faces_hit", int((data["impacts"] > 0).sum()), meaning=f"of {faces:,} faces of the surface")
        yield Value("deepest_face", face, only="data")
        shown = ("depth_per_year",) if self._is_a_year else ("depth", "depth_per_year")
        excess, _, error = self._chance or (0.0, 0, 0.0)
        by_chance = f"up to {100 * excess:.0f} % too large" if error < _ROUGH else "too large"
        for name in ("depth", "depth_rate", "depth_per_year", "mass_flux"):
            if name in data:
                greatest = data[name].max().item()
                more: dict[str, Any] = {"only": "data"}
                if name in shown:
                    more = {
                        "meaning": f"at face {face:,}, of {int(data['impacts'][face]):,} rows",
                        "error": _times(greatest, data["relative_error"].values[face].item()),
                        "marks": [Mark(excess > 0, f"the greatest of many, by chance {by_chance}")],
                    }
                yield FACES[name].declare(f"greatest_{name}", greatest, **more)

    def _patches(self) -> Columns:
        """The totals of each patch; a table has those of several patches, their volume or their mass a year."""
        data = self.dataset
        names, errors = data["patch"].values.tolist(), data["patch_relative_error"].values.tolist()
        shown = "mass_per_year" if self._is_a_year else "volume"
        columns = [Value("patch", names)]
        for name, wear in FACES.items():
            if f"patch_{name}" in data:
                values = data[f"patch_{name}"].values.tolist()
                more: dict[str, Any] = {} if name == shown else {"only": "data"}
                if name in _WITH_ERROR:
                    more["error"] = [*map(_times, values, errors)]
                columns.append(self._declared(name, wear, values, **more))
        return Columns("patches", "Patches", columns, keyed=True, only="" if len(names) > 1 else "data")

    @property
    def _is_a_year(self) -> bool:
        """Whether the wear of a year is told alone: the impacts then stand for some seconds of a plant's sand."""
        return "sand_rate" in self.dataset and "total_mass_per_year" in self.dataset

    @property
    def _worst(self) -> int:
        """The deepest face."""
        return int(np.argmax(self.dataset["depth"].values))

    @property
    def _worst_error(self) -> float:
        """Its relative standard error by the sample of impacts."""
        return float(
            self.dataset["sampling_error" if "sampling_error" in self.dataset else "relative_error"][self._worst]
        )

    @property
    def _chance(self) -> tuple[float, int, float] | None:
        """By what share the greatest depth is too large by chance if the faces with half of it or more wear alike.

        Their number and the standard error of the worst one, too; None where this is little.
        """
        data = self.dataset
        if "depth" not in data:
            return None
        depth, error = data["depth"].values, self._worst_error
        rivals = int((depth >= depth[self._worst] / 2).sum())
        # The expected greatest of so many standard normal numbers (Blom 1958).
        above = statistics.NormalDist().inv_cdf((rivals - 0.375) / (rivals + 0.25))
        return (above * error, rivals, error) if above * error > _BY_CHANCE and rivals >= _MANY else None

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on rows that are left out or doubtful."""
        data = self.dataset
        findings = [*from_attribute(data.attrs["findings"]), *self._by_chance()]
        total = int(data["rows"])
        for name, count in zip(data["reason"].values, data["left_out"].values, strict=True):
            if count and name != "elsewhere":
                code = f"rows_{name.replace('-', '_')}"
                if name == "receding" and count > _MANY_RECEDE * total:
                    code = "rows_receding_often"
                numbers = {"left_out": count, "rows": total}
                if name == "too-far":
                    numbers |= {"where": data.attrs["rows_beyond_limit"]}
                findings.append(Finding(code, numbers=numbers))
        if failed := round(float(data["ends"].sum() - data["total_impacts"])):
            findings.append(Finding("impacts_not_counted", numbers={"failed": failed}))
        if "beyond_range" in data and float(data["beyond_range"]) > 0:
            findings.append(Finding("mass_out_of_range", data.attrs["model"], {"share": float(data["beyond_range"])}))
        # A row that does much of all wear is named already.
        is_told = self._chance is not None or any(one.code == ONE_ROW for one in findings) or "depth" not in data
        if not is_told and self._worst_error > _ALONE and (rows := int(data["impacts"][self._worst])) >= _SOME:
            numbers = {"face": self._worst, "rows": rows, "error": self._worst_error}
            findings.append(Finding("one_row_of_face_wears", numbers=numbers))
        return (*findings, *([] if self._far is None else [self._far.finding()]))

    def _by_chance(self) -> Iterator[Finding]:
        """That the greatest of many depths is too large by chance, or hardly known."""
        if self._chance is None:
            return
        excess, rivals, error = self._chance
        name = "depth_per_year" if "depth_per_year" in self.dataset else "depth"
        truly, wear = self.dataset[name].max().item() / (1 + excess), FACES[name]
        scale = wear.scale(self.shown_in, truly)
        numbers = {"excess": excess, "rivals": rivals, "error": error, "truly": truly / scale.size, "unit": scale.unit}
        yield Finding("greatest_by_chance" if error < _ROUGH else "greatest_of_few_rows", numbers=numbers)

    @property
    def _far(self) -> FarFromTests | None:
        """The erosion of the whole, where it is far from what tests find at its mean speed."""
        data = self.dataset
        specific, speed = float(data["total_erosion"]), float(data["total_v0_mean"])
        has_density = "total_erosion_ratio" in data and specific
        density = float(data["total_erosion_ratio"]) / specific if has_density else None
        return far_from_tests(specific, speed, density)


def _times(value: float, relative_error: float) -> float:
    """The standard error of a number; 0 of one that is 0, whose relative error is NaN."""
    return value * relative_error if value else 0.0
