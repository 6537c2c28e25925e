"""Surfaces in another unit than the impacts, and rows off the surface: refused, or a sentence says so."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.read import read_surface
from erosion.cfd.rows import ImpactsError
from erosion.cfd.surface import Surface, metres_of
from tests.cfd.parts import PARTS, pipe, plate, polygons, rows_on, write
from tests.cfd.tables import Table, warnings_of

P = erosion.TABLE_1.to("si")
SCALES = (0.001, 0.01, 0.0254, 0.1, 0.3048, 1, 2, 10, 39.37, 100, 1000)
TABLES = {name: rows_on(part) for name, part in PARTS.items()}
UNITS = {10: "dm", 39.37: "in", 100: "cm", 1000: "mm"}


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


def in_unit(surface: Surface, unit: str | None, scale: float = 1.0) -> Surface:
    """The same in other numbers, of which somebody or nobody says the unit."""
    return dataclasses.replace(surface, points=surface.points * scale, unit=unit)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(
    ("name", "suffix"),
    [("hump", ".vtp"), ("hump", ""), ("plate", ".vtp"), ("plate", ""), ("pipe", ".vtp"), ("pipe", ".stl")],
)
def test_a_surface_in_another_unit(tmp_path: Path, name: str, suffix: str, scale: float) -> None:
    surface = read_surface(write(PARTS[name], tmp_path / f"part{suffix}", scale))
    if scale == 1:
        dataset, sentences = wear(TABLES[name], surface)
        # An STL file has triangles, whose depths are others than those of the quadrilaterals.
        what = ("total_volume",) if suffix == ".stl" else ("total_volume", "depth_per_year")
        assert (is_right(dataset, name, what), sentences) == (True, [])
    elif name == "plate" and 1 < scale <= 10:  # it lies in the same plane: it may be a larger plate
        dataset, (sentence,) = wear(TABLES[name], surface)
        assert f"{scale:g} × smaller" in sentence
    else:
        with pytest.raises(ImpactsError, match=f"part.*{max(scale, 1 / scale):.4g} × ") as raised:
            wear(TABLES[name], surface)
        assert scale not in UNITS or all(text in str(raised.value) for text in ("`unit`", repr(UNITS[scale])))


@pytest.mark.parametrize("suffix", [".stl", ".vtp", ""])
@pytest.mark.parametrize(("unit", "scale"), [("mm", 1000), ("in", 1 / 0.0254), ("25.4 mm", 1 / 0.0254), ("m", 1)])
def test_the_unit_may_be_given(tmp_path: Path, suffix: str, unit: str, scale: float) -> None:
    surface = read_surface(write(PARTS["plate"], tmp_path / f"part{suffix}", scale), unit=unit)
    dataset, sentences = wear(TABLES["plate"], surface)
    assert dataset["area"].values.sum() == pytest.approx(float(right("plate")["area"].sum()), rel=1e-5)
    assert (is_right(dataset, "plate", ("total_volume",)), sentences) == (True, [])
    assert dataset.attrs["surface_unit"] == unit


@pytest.mark.parametrize("unit", ["kg", "", "0 mm", "nan m", "-1 m", "1e300 m", "2"])
def test_what_is_no_unit_is_refused_before_the_file_is_read(tmp_path: Path, unit: str) -> None:
    (tmp_path / "part.stl").touch()
    with pytest.raises(ImpactsError, match=r"^Argument `unit` must be"):
        read_surface(tmp_path / "part.stl", unit=unit)


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
    "a spot in the unit of the file": (SPOT, in_unit(plate(cells=120), None, 1000).in_unit("mm")),
    "the centre of a particle, half its diameter off the wall": (
        TABLES["plate"].replace(diameter=np.full(400, 5e-3), mass=np.full(400, 1e-4),
                                position=TABLES["plate"].columns["position"] - [0, 0, 2.5e-3]), PARTS["plate"]),
}  # fmt: skip


@pytest.mark.parametrize("what", LEGITIMATE)
def test_what_is_right_is_taken_without_a_word(what: str) -> None:
    table, surface = LEGITIMATE[what]
    dataset, sentences = wear(table, surface if surface.unit == "mm" else in_unit(surface, None))
    assert int(dataset["total_impacts"]) == int(dataset["rows"])
    assert sentences == []


GIVEN = [(true, said) for true in ("mm", "cm", "in", "m") for said in ("mm", "cm", "in", "ft", "m", "km")]


@pytest.mark.parametrize("name", PARTS)
@pytest.mark.parametrize(("true", "said"), GIVEN)
def test_a_wrong_unit_is_refused_or_said(name: str, true: str, said: str) -> None:
    surface = in_unit(PARTS[name], None, 1 / metres_of(true)).in_unit(said)
    try:
        dataset, sentences = wear(TABLES[name], surface)
    except ImpactsError as error:
        refusal = str(error)
        named = refusal.partition("Argument `unit` must ")[2]
        good = true != said and (f"'{true}'" in named or "is not where the impacts are" in refusal)
    else:
        asked = any(f"Is Argument `unit` right, '{said}'?" in sentence for sentence in sentences)
        good = is_right(dataset, name) == (true == said) and asked == (true != said)
    assert good


def test_a_small_part_of_what_is_hit_needs_a_limit() -> None:
    whole = PARTS["hump"]
    faces = np.flatnonzero(np.isin(np.arange(48) // 4, (3, 4)))
    part = polygons(whole.points, whole.corners.reshape(-1, 4)[faces])
    with pytest.raises(ImpactsError, match="Argument `limit` says how far off"):
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

    @pytest.mark.parametrize("scale", [scale for scale in SCALES if scale != 1])
    @pytest.mark.parametrize("name", PARTS)
    def test_a_surface_in_another_unit(self, name: str, scale: float) -> None:
        part = PARTS[name]
        table = TABLES[name].replace(face=np.arange(400) % part.faces)
        with pytest.raises(ImpactsError, match=f"{max(scale, 1 / scale):.4g} × too"):
            wear(table, in_unit(part, "m", scale))

    def test_other_faces_than_those_where_they_are(self) -> None:
        faces = self.named.columns["face"].copy()
        faces[:40] = (faces[:40] + 24) % 48
        dataset, (sentence,) = wear(self.named.replace(face=faces), PARTS["hump"])
        assert list(dataset["left_out"].values) == [0, 0, 40, 0]
        assert sentence.startswith("40 of 400 rows lie farther from their face than the limit")
        with pytest.raises(ImpactsError, match="is not where the impacts are: 400 of 400 rows"):
            wear(self.named.replace(face=(self.named.columns["face"] + 24) % 48), PARTS["hump"])

    def test_without_positions_a_file_without_a_unit_is_said(self, tmp_path: Path) -> None:
        table = self.named.replace(position=None)
        path = write(PARTS["hump"], tmp_path / "part.vtp", 1000)
        _, sentences = wear(table, read_surface(path))
        assert any("part.vtp is taken in metres" in sentence for sentence in sentences)
        dataset, sentences = wear(table, read_surface(path, unit="mm"))
        assert sentences == []
        assert is_right(dataset, "hump")
