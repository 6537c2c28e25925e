"""Surfaces need a unit; rows off the surface are refused, or a sentence says so."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
import xarray as xr

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.read import read_surface
from erosion.cfd.rows import ImpactsError
from erosion.cfd.surface import Surface
from tests.cfd.parts import PARTS, pipe, plate, polygons, rows_on, write
from tests.cfd.tables import Table, warnings_of

P = erosion.TABLE_1.to("si")
TABLES = {name: rows_on(part) for name, part in PARTS.items()}


def wear(table: Table, surface: Surface, **options: Any) -> tuple[xr.Dataset, list[str]]:
    dataset = erosion_map("linearized", P, table, surface, **options)
    return dataset, warnings_of(dataset)


@functools.cache
def right(name: str) -> xr.Dataset:
    dataset, sentences = wear(TABLES[name], PARTS[name])
    assert sentences == []
    return dataset


def is_right(dataset: xr.Dataset, name: str, what: tuple[str, ...] = ("total_volume", "depth_per_year")) -> bool:
    """Whether volume and greatest depth are within 5 %."""
    pairs = [(float(dataset[key].max()), float(right(name)[key].max())) for key in what]
    return all(abs(got / true - 1) < 0.05 for got, true in pairs)


def in_unit(surface: Surface, unit: str, scale: float = 1.0) -> Surface:
    """The same in other numbers, of which somebody says the unit."""
    return dataclasses.replace(surface, points=surface.points * scale).in_unit(unit)


@pytest.mark.parametrize("suffix", [".stl", ".vtp"])
def test_a_file_needs_a_unit(tmp_path: Path, suffix: str) -> None:
    path = write(PARTS["plate"], tmp_path / f"part{suffix}", 1000)
    with pytest.raises(ImpactsError, match=r"part.*unit of its coordinates: Argument `unit`"):
        read_surface(path)
    dataset, sentences = wear(TABLES["plate"], read_surface(path, unit="mm"))
    assert (is_right(dataset, "plate", ("total_volume",)), sentences) == (True, [])
    assert dataset.attrs["surface_unit"] == "mm"
    with pytest.raises(ImpactsError, match="in metres: Argument `unit` must be left out"):
        read_surface(write(PARTS["plate"], tmp_path / "case"), unit="mm")


def test_a_file_of_vtk_may_say_its_unit(tmp_path: Path) -> None:
    path = write(PARTS["plate"], tmp_path / "part.vtp", 1000)
    mesh = pyvista.read(path)
    mesh.field_data["unit"] = ["mm"]
    mesh.save(path)
    assert read_surface(path).length == pytest.approx(PARTS["plate"].length)
    assert read_surface(path, unit="m").length == pytest.approx(1e3 * PARTS["plate"].length)


@pytest.mark.parametrize("unit", ["kg", "", "0 mm", "nan m", "-1 m", "1e300 m", "2"])
def test_what_is_no_unit_is_refused(tmp_path: Path, unit: str) -> None:
    with pytest.raises(ImpactsError, match=r"^Argument `unit` must be"):
        read_surface(write(PARTS["plate"], tmp_path / "part.stl"), unit=unit)


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("factor", [1e-3, 0.0254, 0.1, 0.3048, 10.0, 1 / 0.0254, 1000.0])
def test_a_wrong_unit_is_refused_or_its_extents_are_shown(name: str, factor: float) -> None:
    surface = dataclasses.replace(PARTS[name], points=PARTS[name].points * factor)
    try:
        dataset, _ = wear(TABLES[name], surface)
        said = dataset.attrs["read_as"]
    except ImpactsError as error:
        said = str(error)
    else:  # impacts about the origin may lie on a larger surface, too
        assert factor > 1
        assert factor < 30 or "impacts_on_a_speck" in dataset.attrs["findings"]
    for place in (TABLES[name].columns["position"], surface.points):
        assert f"{place[:, 0].min():.4g} to {place[:, 0].max():.4g}, " in said


def test_a_row_that_hits_nothing_does_not_hide_that_all_others_lie_on_a_speck() -> None:
    part = PARTS["plate"]
    surface = dataclasses.replace(part, points=part.points * 1000.0)
    position = TABLES["plate"].columns["position"].copy()
    position[0, 2] += surface.length
    dataset, _ = wear(TABLES["plate"].replace(position=position), surface)
    assert "impacts_on_a_speck" in dataset.attrs["findings"]
    assert int(dataset["total_impacts"]) == len(position) - 1


OFF = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)


@pytest.mark.parametrize("share", OFF)
@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize("which", ["a quarter", "all", "all aside"])
def test_rows_off_the_surface(name: str, which: str, share: float) -> None:
    table, part = TABLES[name], PARTS[name]
    position = table.columns["position"].copy()
    rows = slice(None, None, 4 if which == "a quarter" else 1)
    along = [1.0, 0.0, 0.0] if which == "all aside" else -part.normal[part.nearest(position[rows])[0]]
    position[rows] += share * 0.137 * np.asarray(along)
    try:
        dataset, sentences = wear(table.replace(position=position), part)
    except ImpactsError:
        assert share >= 0.005
        return
    # What lies aside by less than a face is wide moves the wear to the next face.
    what = ("total_volume",) if which == "all aside" else ("total_volume", "depth_per_year")
    assert is_right(dataset, name, what) or any("farther" in sentence for sentence in sentences)
    if which == "a quarter" and share >= 0.02:
        assert "100 of 400 rows lie farther from their face than the limit" in sentences[0]
        assert int(dataset["total_impacts"]) == 300


def spot(surface: Surface, centre: Any, size: float) -> Table:
    """Rows on a small part of a surface alone."""
    table = rows_on(surface, 200_000)
    near = np.linalg.norm(table.columns["position"] - np.asarray(centre), axis=1) < size
    return table.only(np.flatnonzero(near)[:300])


def round_pipe() -> Table:
    """Rows on a pipe without facets."""
    turn, x = np.random.default_rng(1).uniform(0, [[2 * np.pi], [0.137]], (2, 400))
    outward = np.stack([0 * x, np.cos(turn), np.sin(turn)], axis=1)
    velocity = 30.0 * (np.sin(0.52) * outward + np.cos(0.52) * np.array([1.0, 0.0, 0.0]))
    return TABLES["pipe"].replace(position=0.02 * outward + x[:, None] * [1.0, 0.0, 0.0], velocity=velocity)


SPOT = spot(plate(cells=120), (0, 0, 0), 0.01)
LEGITIMATE: dict[str, tuple[Table, Surface]] = {
    "a jet on a spot of a pipe": (spot(PARTS["pipe"], (0.06, 0.0, 0.02), 2e-3), PARTS["pipe"]),
    "a jet on a spot of a hump": (spot(PARTS["hump"], (0.08, 0.02, 0.018), 5e-3), PARTS["hump"]),
    "one row": (TABLES["pipe"].only([77]), PARTS["pipe"]),
    "two rows": (TABLES["hump"].only([7, 200]), PARTS["hump"]),
    "few digits": (TABLES["pipe"].replace(position=np.round(TABLES["pipe"].columns["position"], 4)), PARTS["pipe"]),
    "facets of a coarse pipe": (round_pipe(), pipe(8, 3)),
    "facets of a fine pipe": (TABLES["pipe"], pipe(240, 16)),
    "a plate of two triangles": (TABLES["plate"], polygons(plate(cells=1).points, np.array([[0, 1, 3], [0, 3, 2]]))),
    "a jet at the end of a plate": (spot(plate(), (0.06, 0.06, 0.0), 5e-3), plate()),
    "a spot in the unit of the file": (SPOT, in_unit(plate(cells=120), "mm", 1000)),
    "the centre of a particle, half its diameter off the wall": (
        TABLES["plate"].replace(diameter=np.full(400, 5e-3), mass=np.full(400, 1e-4),
                                position=TABLES["plate"].columns["position"] - [0, 0, 2.5e-3]), PARTS["plate"]),
}  # fmt: skip


@pytest.mark.parametrize("what", LEGITIMATE)
def test_what_is_right_is_taken_without_a_word(what: str) -> None:
    table, surface = LEGITIMATE[what]
    dataset, sentences = wear(table, surface)
    assert int(dataset["total_impacts"]) == int(dataset["rows"])
    assert sentences == []


def test_a_small_part_of_what_is_hit_needs_a_limit() -> None:
    whole = PARTS["hump"]
    faces = np.flatnonzero(np.isin(np.arange(48) // 4, (3, 4)))
    part = polygons(whole.points, whole.corners.reshape(-1, 4)[faces])
    with pytest.raises(ImpactsError, match="Argument `limit` how far off"):
        wear(TABLES["hump"], part)
    dataset, (sentence,) = wear(TABLES["hump"], part, limit=1e-6)
    np.testing.assert_allclose(dataset["volume"], right("hump")["volume"].values[faces], rtol=1e-12)
    left = 400 - int(dataset["total_impacts"])
    assert sentence.startswith(f"{left} of 400 rows lie farther from their face than the limit")
    assert "with a limit of 1e-06 m" in sentence


class TestRowsThatNameTheirFace:
    named = TABLES["hump"].replace(face=np.arange(400) % 48)

    def test_their_positions_agree(self) -> None:
        dataset, sentences = wear(self.named, PARTS["hump"])
        assert sentences == []
        assert int(dataset["rows_to_nearest"]) == 0
        np.testing.assert_allclose(dataset["volume"], right("hump")["volume"], rtol=1e-12)

    def test_other_faces_than_those_where_they_are(self) -> None:
        faces = self.named.columns["face"].copy()
        faces[:40] = (faces[:40] + 24) % 48
        dataset, (sentence,) = wear(self.named.replace(face=faces), PARTS["hump"])
        assert list(dataset["left_out"].values) == [0, 0, 40, 0]
        assert sentence.startswith("40 of 400 rows lie farther from their face than the limit")
        with pytest.raises(ImpactsError, match="400 of 400 rows of table lie"):
            wear(self.named.replace(face=(self.named.columns["face"] + 24) % 48), PARTS["hump"])
