"""Sums over millions of rows: as exact as one row's number.

What a run stands for: its duration, the sand that was injected, and bounces of the same parcel.
"""

import dataclasses
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.incidence import LEFT_OUT, Hits
from erosion.cfd.map_result import YEAR, MapSummary
from erosion.cfd.rows import ImpactsError
from erosion.cfd.tally import FaceTally, portion_of
from tests.cfd.tables import hump, quadrilaterals, sand, warnings_of
from tests.documents import Written


def tally_of(volume: np.ndarray, face: np.ndarray, *, times: int = 1, faces: int = 1, **changes: Any) -> FaceTally:
    """The sums of portions with these volumes of rows, one portion a line, all of them so many times."""
    tally, rows = FaceTally(faces), len(face)
    columns: dict[str, Any] = {field.name: np.ones(rows) for field in dataclasses.fields(Hits)}
    zeros = np.zeros(rows, np.int64)
    others = {"fate": zeros, "patch": zeros, "face": face, "distance": np.full(rows, np.nan), "named": zeros > 0}
    hits = Hits(**{**columns, **others, **changes})
    for _ in range(times):
        for line in volume:
            outcome = np.isnan(line)[None].astype(np.int64)
            tally.add(portion_of(hits, hits, line[None], outcome, zeros > 0, 1, 2))
    return tally


def test_many_equal_rows_of_one_face_lose_no_digit() -> None:
    # One after the other, a tenth added ten million times is off by 1e-10.
    rows = 2**16
    tally = tally_of(np.full((1, rows), 0.1), np.zeros(rows, np.int64), times=160)
    assert tally.sums["volume"][0] == pytest.approx(math.fsum([0.1] * 160 * rows), rel=1e-15)
    assert tally.sums["impacts"][0] == tally.rows == 160 * rows


def test_a_small_portion_after_a_large_one_is_not_lost() -> None:
    tally = tally_of(np.array([[1.0], [1e-20], [1e-20], [-1.0]]), np.zeros(1, np.int64))
    assert tally.sums["volume"][0] == 2e-20


def test_rows_without_a_volume_count_in_no_sum() -> None:
    tally = tally_of(np.array([[1.0, np.nan, 2.0]]), np.array([2, 0, 2]), faces=3)
    assert list(tally.sums["impacts"]) == [0, 0, 2]
    assert list(tally.sums["volume"]) == [0.0, 0.0, 3.0]
    assert tally.counts["ends"].tolist() == [[2, 1]]


def test_the_median_of_distances_is_that_of_the_rows() -> None:
    distance = np.random.default_rng(0).lognormal(-8, 1.5, 10001)
    tally = tally_of(np.ones((1, 10001)), np.zeros(10001, np.int64), distance=distance)
    assert tally.median_distance == pytest.approx(np.median(distance), rel=6e-3)
    assert (tally.farthest, tally.unnamed) == (distance.max(), 10001)
    assert len(tally.counts["fates"]) == 1 + len(LEFT_OUT)


P = erosion.TABLE_1.to("si")
SURFACE = hump()
TABLE = sand(SURFACE, 400)
RUN = Path(__file__).parent / "openfoam" / "serial"


def wear(table: Any = TABLE, **options: Any) -> xr.Dataset:
    return erosion_map("dnv", P, table, SURFACE, **options)


def test_a_rate_of_sand_makes_rates_of_wear() -> None:
    plain, injected, rate = wear(), 0.4, 100 / 86400
    data = wear(sand_rate="100 kg/day", injected="400 g")
    assert float(data["duration"]) == pytest.approx(injected / rate, rel=1e-14)
    a_year = rate / injected * YEAR
    np.testing.assert_allclose(data["depth_per_year"], plain["depth"] * 1e3 * a_year, rtol=1e-13)
    np.testing.assert_allclose(data["mass_flux"], plain["mass"] / plain["area"] * rate / injected, rtol=1e-13)
    assert float(data["total_mass_per_year"]) == pytest.approx(float(plain["total_mass"]) * a_year, rel=1e-13)
    assert float(data["total_injected_ratio"]) == pytest.approx(float(plain["total_mass"]) / injected, rel=1e-13)
    np.testing.assert_allclose(data["patch_injected_ratio"].sum(), data["total_injected_ratio"], rtol=1e-13)
    # The mass per hit stays beside it.
    assert float(data["total_erosion_ratio"]) == float(plain["total_erosion_ratio"])
    text = str(MapSummary(data))
    for words in ("kg/day", "g/year", "injected ratio", "in which 400 g of sand come"):
        assert words in text


@pytest.mark.parametrize("share", [1.0, 1e-4, 1e-8])
def test_totals_are_those_of_a_year_or_in_a_unit_that_reads_well(share: float) -> None:
    table = TABLE.replace(count=share * TABLE.columns["count"])
    rows = {row.name: row for row in MapSummary(wear(table)).rows()}
    for name in ("volume", "mass", "mass per year"):
        assert 0.05 <= float(rows[name].value.split(" ± ")[0]) < 1e3
    rows = {row.name: row for row in MapSummary(wear(table, sand_rate="100 kg/day", injected="400 g")).rows()}
    assert not {"volume", "mass", "greatest depth"} & rows.keys()
    assert {"±"} <= set(rows["mass per year"].value) & set(rows["greatest depth per year"].value)


@pytest.mark.parametrize(
    ("rate", "injected"),
    [
        ("5e-4 kg/s", "400 g"),
        ("5e-7 t/s", "4e-4 metric_ton"),
        ("50 ppm of 10 kg/s", 0.4),
        ("50 ppmw of 36 t/h", "0.2 kg/s"),
        (5e-4, "0.882 lb"),
    ],
)
def test_a_rate_is_a_mass_flow_or_a_share_of_one(rate: Any, injected: Any) -> None:
    # The table covers 2 s.
    assert float(wear(sand_rate=rate, injected=injected)["duration"]) == pytest.approx(800, rel=2e-4)


def test_each_row_may_be_another_parcel() -> None:
    mass = float(np.sum(TABLE.columns["count"] * TABLE.columns["mass"]))
    data, given = (wear(sand_rate="100 kg/day", injected=injected) for injected in ("rows", mass))
    assert float(data["injected"]) == pytest.approx(mass, rel=1e-13)
    np.testing.assert_allclose(data["depth_per_year"], given["depth_per_year"], rtol=1e-13)
    assert "Each row counts as sand of its own" in " ".join(warnings_of(data))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sand_rate": "100 kg/day"}, "`injected`"),
        ({"sand_rate": "100"}, "`sand_rate` must have a unit"),
        ({"sand_rate": "100 m/s"}, "`sand_rate` must be a mass flow"),
        ({"sand_rate": -1.0}, "`sand_rate` must be positive"),
        ({"sand_rate": "50 ppm of 10 m^3/s"}, "`sand_rate` must be a mass flow"),
        ({"sand_rate": "-50 ppm of 12 kg/s"}, "`sand_rate` must have a share above 0"),
        ({"sand_rate": "nan ppm of 12 kg/s"}, "`sand_rate` must have a share above 0"),
        ({"sand_rate": "2e6 ppm of 12 kg/s"}, "`sand_rate` must have a share above 0"),
        ({"sand_rate": "1 ton/day"}, "`sand_rate` must say which ton"),
        ({"sand_rate": "1 mt/day"}, "`sand_rate` must say which ton"),
        ({"injected": "2"}, "`injected` must have a unit, as '2 g'"),
        ({"injected": "2 g/s", "table": sand(SURFACE, 400, duration=None)}, "`injected` is a mass flow, so"),
        ({"injected": "2 m"}, "`injected` must be a mass"),
        ({"injected": "0 g"}, "`injected` must be positive"),
    ],
)
def test_what_gives_no_rate_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        wear(**options)


def test_more_sand_hits_than_was_injected() -> None:
    erodent = float(wear()["total_erodent"])
    assert any("2 × the mass" in sentence for sentence in MapSummary(wear(injected=erodent / 2)).warnings)
    assert not any("the mass" in sentence for sentence in MapSummary(wear(injected=erodent)).warnings)
    distinct = TABLE.replace(parcel=np.arange(400))
    distinct.has_parcels = True
    data = wear(distinct, injected=erodent / 2)
    assert any("The parcels of the table" in said for said in MapSummary(data).warnings)
    assert "(200 % of the sand injected, each parcel once)" in data.attrs["read_as"]
    assert "% of" not in wear(distinct).attrs["read_as"]


def test_less_sand_hits_than_was_injected() -> None:
    erodent = float(wear()["total_erodent"])
    assert "a mass or `injected` is in another unit" in " ".join(warnings_of(wear(injected=erodent / 1000)))
    (sentence,) = warnings_of(wear(injected=1000 * erodent))
    assert "only 0.001 of the mass of the sand injected" in sentence
    assert "radii" in sentence
    assert "only 0.12 of" in " ".join(warnings_of(wear(injected=8 * erodent)))
    assert warnings_of(wear(injected=7 * erodent)) == []


PARCEL = np.random.default_rng(3).integers(0, 150, 400)


@pytest.mark.parametrize("portion", [64, 2**18])
def test_bounces_are_of_one_parcel(monkeypatch: pytest.MonkeyPatch, portion: int) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", portion)
    monkeypatch.setattr("erosion.cfd.tally._HELD", 10)
    weight = TABLE.columns["count"][PARCEL]  # a parcel keeps its particles and their size
    of_parcel = {"count": weight, "mass": TABLE.columns["mass"][PARCEL], "diameter": TABLE.columns["diameter"][PARCEL]}
    table = TABLE.replace(parcel=PARCEL + 7, **of_parcel)
    table.has_parcels = True
    data, face = wear(table, sand_rate="1 kg/s"), table.columns["face"]
    single = [float(wear(table.only([i]).replace(parcel=None))["total_volume"]) for i in range(400)]
    groups = {"": face, "patch": SURFACE.patch[face], "total": np.zeros(400, int)}
    for name, group in groups.items():
        sums = np.zeros((group.max() + 1, 150))
        np.add.at(sums, (group, PARCEL), single)
        expected = np.sqrt((sums**2).sum(axis=1)) / sums.sum(axis=1)
        np.testing.assert_allclose(data[f"{name}_relative_error".lstrip("_")].values.ravel(), expected, rtol=1e-10)
    known = np.unique(PARCEL)
    injected = math.fsum((TABLE.columns["count"] * TABLE.columns["mass"])[known])
    assert float(data["injected"]) == pytest.approx(injected, rel=1e-13)
    assert float(data["duration"]) == pytest.approx(injected, rel=1e-13)
    assert int(data["parcels"]) == len(known)
    assert any("hits no wall" in sentence for sentence in MapSummary(data).warnings)


def test_parcels_that_change_their_mass_are_others() -> None:
    numbers = {"one": np.full(400, 7), "given again": np.arange(400) % 100}
    for parcel in numbers.values():
        table = TABLE.replace(parcel=parcel)
        table.has_parcels = True
        changing = len(np.unique(parcel))
        (sentence,) = warnings_of(wear(table))
        assert f"{changing} of the {changing} parcels of the table have rows of different masses" in sentence


def test_openfoam_says_what_it_injected(tmp_path: Path) -> None:
    table = erosion.read_impacts(RUN)
    assert (table.injected, table.duration, table.has_parcels) == (1e-4, 0.02, True)
    run = shutil.copytree(RUN, tmp_path / "run")
    windows = run / "postProcessing" / "lagrangian" / "kinematicCloud" / "impacts"
    one = erosion.read_impacts(windows / "0.02")
    assert (one.injected, one.duration) == (None, pytest.approx(0.01))
    properties = run / "constant" / "kinematicCloudProperties"
    text = properties.read_text()
    properties.write_text(text.replace("duration 0.016", "duration 0.04"))
    assert erosion.read_impacts(run).injected == pytest.approx(0.5e-4)
    properties.write_text(text.replace("constant 1", "table ((0 1) (0.04 2))").replace("duration 0.016", "duration 1"))
    assert erosion.read_impacts(run).injected is None
    # What the run itself wrote counts.
    stored = run / "0.02" / "uniform" / "lagrangian" / "kinematicCloud" / "kinematicCloudOutputProperties"
    stored.parent.mkdir(parents=True)
    models = "injectionModel { sand { massInjected 3e-5; nInjections 4; } more { massInjected 1e-5; } }"
    stored.write_text("FoamFile { version 2.0; format ascii; class dictionary; object x; }\n" + models)
    assert erosion.read_impacts(run).injected == pytest.approx(4e-5)
    # Each processor writes what all injected.
    shutil.move(run / "0.02", run / "processor0" / "0.02")
    assert erosion.read_impacts(run).injected == pytest.approx(4e-5)
    control = run / "system" / "controlDict"
    control.write_text(control.read_text().replace("startTime 0", "startTime 0.001"))
    assert erosion.read_impacts(run).injected is None


def test_the_duration_is_that_of_the_times() -> None:
    times = np.linspace(3.0, 13.0, 400)
    data = wear(sand(SURFACE, 400, duration=None, time=times))
    assert float(data["duration"]) == pytest.approx(10)
    assert "from the first impact to the last" in data["duration"].attrs["long_name"]
    # Beside rates of mass, too, where there is no surface and so no depth.
    for of_run in (data, data.drop_dims("face")):
        (row,) = [row for row in MapSummary(of_run).rows() if row.name == "duration"]
        assert (row.value, row.unit) == ("10", "s")
        assert "from the first impact to the last" in row.meaning
    given = sand(SURFACE, 400, duration=60.0, time=times)
    assert any("60 s" in sentence and "10 s" in sentence for sentence in MapSummary(wear(given)).warnings)
    assert "duration" not in wear(sand(SURFACE, 400, duration=None))
    (few,) = MapSummary(wear(sand(SURFACE, 10, duration=None, time=np.linspace(3.0, 13.0, 10)))).warnings
    assert "10 impacts, 10 s, is less than" in few
    run = erosion.read_impacts(RUN, duration=1.0)
    assert any("1 s" in sentence and "0.02 s" in sentence for sentence in run.warnings)


def test_the_number_of_a_parcel_is_whole(written: Written) -> None:
    path = written(
        "rows.csv", "diameter [um],density [kg/m^3],speed [m/s],angle [deg],particle_id\n200,2650,30,20,1.5\n"
    )
    with pytest.raises(ImpactsError, match="row 1: `parcel`"):
        list(erosion.read_impacts(path).blocks(10))


def test_less_than_a_particle_a_row_is_said(written: Written) -> None:
    rows = "".join(f"{100 + i},{3e-8 + i * 1e-10},{20 + i},{5 + i}\n" for i in range(40))
    for unit, is_said in (("kg", False), ("g", True)):
        path = written(f"{unit}.csv", f"diameter [um],parcel_mass [{unit}],speed [m/s],angle [deg]\n{rows}")
        data = erosion_map("dnv", P, erosion.read_impacts(path, particle_density=2650.0))
        assert ("less than one particle; are its unit" in " ".join(warnings_of(data))) == is_said


def test_the_greatest_of_many_faces_is_said_to_be_too_large() -> None:
    """Where all faces of a flat floor wear alike, the estimate is nearer to the truth than the greatest depth."""
    for rows, along, is_said in ((12_000, 41, True), (250_000, 41, True), (250_000, 6, False)):
        x, y = np.meshgrid(np.linspace(0, 0.2, along), np.linspace(0, 0.05, 11), indexing="ij")
        floor = quadrilaterals(np.stack([x, y, 0 * x], axis=-1))
        face = np.random.default_rng(2).integers(0, floor.faces, rows)
        same = {"count": np.ones(rows), "diameter": np.full(rows, 2e-4), "mass": np.full(rows, 1e-8)}
        velocity = np.array([20.0, 0, 0]) + 15 * floor.normal[face]
        table = sand(floor, rows).replace(face=face, position=floor.centre[face], velocity=velocity, **same)
        data = erosion_map("dnv:carbon-steel", P, table, floor, injected=0.01, sand_rate="1 kg/s")
        text, said = str(MapSummary(data)), " ".join(MapSummary(data).warnings)
        assert ("lies above the true one by chance" in said) == is_said
        assert ("greatest of many" in text) == is_said
        if is_said:
            mean, greatest = float(data["depth_per_year"].mean()), float(data["depth_per_year"].max())
            told = float(said.split("truly about ")[1].split(" mm/year")[0])
            assert told == pytest.approx(mean, rel=0.1)
            assert greatest > (1.4 if rows < 100_000 else 1.08) * mean


def test_a_second_line_of_heads_and_pounds_of_mass(tmp_path: Path) -> None:
    (path := tmp_path / "a.csv").write_text("d,m,speed,angle\num,kg,m/s,deg\n100,1e-9,20,30\n")
    with pytest.raises(ImpactsError, match=r"line 2 is a second line of heads.* as `d \[um\]`"):
        erosion.read_impacts(path)
    path.write_text("diameter [um],mass [lbm],speed [m/s],angle [deg]\n100,1e-9,20,30\n")
    (block,) = erosion.read_impacts(path).blocks(9)
    assert block.mass == pytest.approx([0.45359237e-9])
