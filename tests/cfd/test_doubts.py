"""What is doubtful in rows: ways between hits beside speeds, and tables that are cut off."""

import dataclasses
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from erosion.cfd.doubts import Column, Journeys, Noted
from erosion.cfd.incidence import Incidence
from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactBlock
from tests.cfd.parts import PARTS


@pytest.mark.parametrize(("alpha", "words"), [(80, ""), (60, ""), (30, "does the domain repeat itself?")])
def test_grains_come_back_slowly_after_a_steep_hit(alpha, words):
    """A jet sends grains that rebound back; after a shallow hit they are back only in a cyclic domain."""
    rng, angle, jets = np.random.default_rng(0), math.radians(alpha), 200
    first = np.column_stack([rng.uniform(-1e-3, 1e-3, (jets, 2)), np.zeros(jets)])
    position = np.concatenate([first, first + np.column_stack([rng.uniform(0, 2e-3, (jets, 2)), np.zeros(jets)])])
    velocity = np.repeat([[60 * math.cos(angle), 0, -60 * math.sin(angle)], [5, 0, -1]], jets, axis=0)
    time = np.concatenate([begin := rng.random(jets), begin + 2e-3])
    size, parcel = np.full(2 * jets, 2e-4), np.tile(np.arange(jets), 2)
    block = ImpactBlock("a", 0, np.ones_like(size), 1e-8 * np.ones_like(size), size, velocity=velocity,
                        position=position, time=time, parcel=parcel)  # fmt: skip
    journeys = Journeys()
    journeys.add(block, Incidence(PARTS["plate"]).hits(block))
    said = " ".join(journeys.in_words())
    assert words in said
    assert bool(said) == bool(words)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1, ""), (1 / 1.6, ""), (2.2369, "0.4 ×"), (1.9438, "0.46 ×"), (1 / 2.2369, "2 ×"), (1 / 1.9438, "1.7 ×")],
)
@pytest.mark.parametrize("is_even", [True, False])
def test_even_ways_tell_miles_and_knots(factor: float, words: str, is_even: bool) -> None:
    """Grains that hop along a plate, in even hops or, as in eddies, in some that go round."""
    rng, grains, hops = np.random.default_rng(0), 200, 4
    along = rng.uniform(20, 30, (grains, 1)) * 0.97 ** np.arange(hops)
    speed = along * np.ones((grains, hops))
    step = rng.uniform(1e-4, 2e-4, (grains, hops))
    far = step * 0.9 * along * (1 if is_even else rng.uniform(0.1, 1.3, (grains, hops)))
    position = np.zeros((grains, hops, 3))
    position[..., 0] = np.cumsum(far, axis=1) - 0.05
    velocity = speed[..., None] * np.array([math.cos(0.3), 0, -math.sin(0.3)])
    rows = np.ones(grains * hops)
    block = ImpactBlock("a", 0, rows, 1e-8 * rows, 2e-4 * rows, velocity=velocity.reshape(-1, 3),
                        position=position.reshape(-1, 3), time=np.cumsum(step, axis=1).ravel(),
                        parcel=np.repeat(np.arange(grains), hops))  # fmt: skip
    hits, journeys = Incidence(PARTS["plate"]).hits(block), Journeys()
    journeys.add(block, dataclasses.replace(hits, speed=factor * hits.speed))
    said = " ".join(journeys.in_words())
    assert bool(said) == (bool(words) and (is_even or factor > 2))
    assert not is_even or words in said


@pytest.mark.parametrize(("rows", "is_said"), [(2**16 - 1, True), (2**16, False), (2**20 - 1, True)])
def test_what_a_sheet_holds_may_not_be_all(rows: int, is_said: bool) -> None:
    noted = Noted({})
    noted.add_rows({"speed": np.ones(rows)})
    assert any("as a sheet of Excel holds" in said for said in noted.doubts(None)) == is_said


def test_a_table_of_openfoam_may_be_cut_within_a_number(tmp_path: Path) -> None:
    run = shutil.copytree(Path(__file__).parent / "openfoam" / "parallel", tmp_path / "run")
    last = max((run / "postProcessing").rglob("hump.post"))
    assert not any("end of a line" in said for said in read_impacts(run).warnings)
    last.write_text(last.read_text()[:-2])
    assert f"{last.name} does not end with the end of a line" in " ".join(read_impacts(run).warnings)


def test_parcels_whose_numbers_have_a_pattern_are_compared_where_there_are_many() -> None:
    """Odd numbers only, of more rows than are held."""
    rows = 300_000
    parcel = 2 * np.repeat(np.arange(rows // 2), 2) + 1
    position = np.zeros((rows, 3))
    position[1::2, 0] = 0.01
    block = ImpactBlock("a", 0, np.ones(rows), 1e-8 * np.ones(rows), 2e-4 * np.ones(rows),
                        velocity=np.tile([36.0, 0, -9.0], (rows, 1)), position=position,
                        time=np.tile([0.0, 1e-3], rows // 2), parcel=parcel)  # fmt: skip
    journeys = Journeys()
    journeys.add(block, Incidence(PARTS["plate"]).hits(block))
    assert "0.27 ×" in " ".join(journeys.in_words())


@pytest.mark.parametrize(("digits", "numbered"), [(6, False), (12, True)])
def test_large_counts_in_few_digits_are_no_numbers_of_rows(digits: int, numbered: bool) -> None:
    counts = 1e7 * np.exp(0.3 * np.random.default_rng(0).standard_normal(100))
    counts = np.array([float(f"{round(count):.{digits}g}") for count in counts])
    assert len(np.unique(counts)) == 100
    noted = Noted({"count": Column("count", 1.0)})
    noted.add_rows({"count": counts})
    assert noted._numbered == numbered
