"""Sums over millions of rows: as exact as one row's number.

What a run stands for: its duration, the sand that was injected, and bounces of the same parcel.
"""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.incidence import LEFT_OUT, Hits
from erosion.cfd.map_result import YEAR, MapSummary
from erosion.cfd.tally import FaceTally, portion_of
from tests.cfd.tables import hump, sand, warnings_of


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
            tally.add(portion_of(hits, hits, line[None], outcome, zeros > 0, np.zeros(2, int), 1, 2))
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
    for words in ("kg/day", "g/year", "injected_ratio", "in which 400 g of sand come"):
        assert words in text


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


def test_the_duration_is_that_of_the_times() -> None:
    times = np.linspace(3.0, 13.0, 400)
    data = wear(sand(SURFACE, 400, duration=None, time=times))
    assert float(data["duration"]) == pytest.approx(10)
    assert "from the first impact to the last" in data["duration"].attrs["long_name"]
    # Beside rates of mass, too, where there is no surface and so no depth.
    for of_run in (data, data.drop_dims("face")):
        (row,) = [row for row in MapSummary(of_run).rows() if row[0] == "duration"]
        assert row[2:4] == ("10", "s")
        assert "from the first impact to the last" in row[4]
    given = sand(SURFACE, 400, duration=60.0, time=times)
    assert any("60 s" in sentence and "10 s" in sentence for sentence in MapSummary(wear(given)).warnings)
    assert "duration" not in wear(sand(SURFACE, 400, duration=None))
    (few,) = MapSummary(wear(sand(SURFACE, 10, duration=None, time=np.linspace(3.0, 13.0, 10)))).warnings
    assert "10 impacts, 10 s, is less than" in few
    run = erosion.read_impacts(RUN, duration=1.0)
    assert any("1 s" in sentence and "0.02 s" in sentence for sentence in run.warnings)
