"""Published numbers: the file of facts, what the package gives, and how it is told."""

import math

import numpy as np
import pytest

import erosion
from erosion.checks import Comparison, Fact, Validation, published_facts
from erosion.checks.validate import COMPUTATIONS, KINDS
from erosion.plotting.sweeps import plot_validation

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def validation():
    return erosion.against_published()


@pytest.fixture(scope="module")
def ratios(validation):
    return {comparison.fact.name: comparison.ratio for comparison in validation.comparisons}


def test_every_fact_has_a_source_a_kind_and_a_computation():
    facts = published_facts()
    assert len({fact.name for fact in facts}) == len(facts)
    for fact in facts:
        assert fact.source
        assert fact.by
        assert fact.kind in KINDS
        assert fact.computes in COMPUTATIONS
        assert fact.published > 0
        assert fact.error is None or fact.error > 0
    assert {fact.computes for fact in facts} == set(COMPUTATIONS)
    kinds = [list(KINDS).index(fact.kind) for fact in facts]
    assert kinds == sorted(kinds)  # what says most of nature comes first
    assert len(kinds) > 40


@pytest.mark.slow
def test_all_numbers_with_a_stated_error_agree(validation):
    stated = [comparison for comparison in validation.comparisons if comparison.within is not None]
    assert len(stated) == 12
    assert all(comparison.within for comparison in stated)


@pytest.mark.slow
def test_formulas_are_limits_of_models(ratios):
    for name in ("OpenFOAM's Q at 10°", "OpenFOAM's Q at 40°", "Sphere, depth v √(m/(2πRp))",
                 "Sphere, time to that depth", "Sphere, volume m v²/(2p)"):  # fmt: skip
        assert ratios[name] == pytest.approx(1, abs=1e-8), name


@pytest.mark.slow
def test_correlations_give_what_formulas_of_other_programs_give(ratios):
    for name in ("OpenFOAM's Q at 10°, correlation", "E/CRC, E at 30°, 50 m/s", "DNV 2007, F(30°)", "DNV 2007, F(90°)"):
        assert ratios[name] == pytest.approx(1, abs=1e-8), name
    for name in ("McLaury, coefficient A", "Oka, size exponent k₃"):
        assert ratios[name] == pytest.approx(1, abs=1e-6), name
    assert ratios["McLaury, E at 30°, 50 m/s"] == pytest.approx(1 / 1.64, abs=1e-3)
    assert ratios["McLaury, F(10°) in Nektar++"] == pytest.approx(1 / 1.325, abs=1e-3)
    assert ratios["Oka, E₉₀ by 65 Hv^-0.12"] == pytest.approx(1 / 0.768, abs=1e-3)


@pytest.mark.parametrize("name", ["arabnejad", "dnv", "ecrc", "finnie", "mclaury", "oka"])
def test_every_correlation_stands_beside_two_published_numbers(name):
    assert sum(fact.by.startswith(f"correlations.{name}") for fact in published_facts()) >= 2


@pytest.mark.slow
def test_misses_are_as_large_as_the_page_says(ratios):
    assert all(1.6 < ratios[f"Crater, 5 mm sphere, {speed} m/s"] < 1.9 for speed in ("9.99", "12", "14", "16", "18"))
    assert ratios["Crater, speed exponent"] == pytest.approx(1 / 1.137, rel=1e-6)
    assert ratios["Share at 90°, cut alone"] == 0
    assert ratios["Sand on aluminium, 112 m/s"] == pytest.approx(335, rel=1e-3)
    assert ratios["Arabnejad 6061, cutting"] == pytest.approx(1 - 0.23, abs=5e-3)
    # The depth is as 1/√p: 1.005 GPa (ratio)² would meet the measurement.
    pressures = [1.005 * ratios[f"Crater, 5 mm sphere, {speed} m/s"] ** 2 for speed in ("9.99", "12", "14", "16", "18")]
    assert [min(pressures), max(pressures)] == pytest.approx([2.63, 3.50], abs=0.02)


def test_an_arabnejad_threshold_is_read_off_the_erosion(validation):
    computed = {comparison.fact.name: comparison.computed for comparison in validation.comparisons}
    assert computed["Arabnejad 6061, threshold"] == pytest.approx(7.3, rel=1e-9)


@pytest.mark.parametrize(
    ("published", "computed", "error", "off", "within"),
    [
        (2.0, 2.0 + 1e-8, None, "0 %", None),
        (2.0, 2.1, 0.05, "+5 %", False),
        (2.0, 1.96, 0.05, "-2 %", True),
        (2.0, 10.0, None, "×5", None),
        (2.0, 0.2, None, "×0.1", None),
        (2.0, 0.0, None, "-100 %", None),
    ],
)
def test_how_far_off_is_told_in_words(published, computed, error, off, within):
    fact = Fact("f", published, "um^3", "measured", "somebody", "bend", "a model", error)
    comparison = Comparison(fact, computed)
    assert (comparison.off, comparison.within) == (off, within)
    row = Validation((comparison,)).rows()[0]
    assert row == ("f", "2", f"{computed:.4g}", "µm³", off + (" ✗" if within is False else ""), "[1]")


def test_it_prints_each_source_once_and_claims_nothing(validation):
    text = str(validation)
    assert text.startswith("56 published numbers")
    assert text.count("test value: Equinor, pysand 2.0.0, tests/test_erosion.py, bend_validation") == 1
    assert "12 of 12 numbers agree within the error" in text
    assert "This table validates no model." in text
    described = validation.to_dict()["facts"]
    assert described[0]["published"] == {"value": 22.961, "unit": "um"}
    assert described[0]["error"] is None
    assert math.isfinite(described[0]["computed"]["value"])


def test_the_figure_has_a_mark_for_every_number(validation):
    ax = plot_validation(validation).axes[0]
    marks = sum(np.size(line.get_xdata()) for line in ax.lines if line.get_label() in KINDS)
    assert marks == len(validation.comparisons)
    assert [tick.get_text() for tick in ax.get_yticklabels()] == [c.fact.name for c in validation.comparisons]
