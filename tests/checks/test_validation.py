"""Published numbers: the file of facts, what the package gives, and how it is told."""

import math

import numpy as np
import pytest

import erosion
from erosion.checks import FACTS, Comparison, Fact, Validation
from erosion.checks.validate import KINDS
from erosion.plotting.sweeps import plot_validation

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def validation():
    return erosion.against_published()


@pytest.fixture(scope="module")
def ratios(validation):
    return {comparison.fact.name: comparison.ratio for comparison in validation.comparisons}


def test_every_fact_has_a_source_and_a_kind():
    assert len({fact.name for fact in FACTS}) == len(FACTS) == 11
    assert all(fact.source and fact.by and fact.note and fact.published > 0 for fact in FACTS)
    kinds = [list(KINDS).index(fact.kind) for fact in FACTS]
    assert kinds == sorted(kinds)  # what says most of nature comes first


def test_misses_are_as_large_as_the_page_says(ratios):
    craters = [ratios[f"Crater, 5 mm sphere, {speed} m/s"] for speed in ("9.99", "12", "14", "16", "18")]
    assert 1.6 < min(craters) < max(craters) < 1.9
    assert ratios["Crater, speed exponent"] == pytest.approx(1 / 1.137, rel=1e-6)
    assert ratios["Share at 90°, cut alone"] == 0
    assert ratios["Share at 90°, DNV"] == pytest.approx(1.2524, rel=1e-3)
    assert ratios["Sand on aluminium, 112 m/s"] == pytest.approx(335, rel=1e-3)
    # The depth is as 1/√p: 1.005 GPa (ratio)² would meet the measurement.
    pressures = [1.005 * min(craters) ** 2, 1.005 * max(craters) ** 2]
    assert pressures == pytest.approx([2.63, 3.50], abs=0.02)


@pytest.mark.parametrize(
    ("published", "computed", "off"),
    [
        (2.0, 2.0 + 1e-8, "0 %"),
        (2.0, 2.1, "+5 %"),
        (2.0, 1.96, "-2 %"),
        (2.0, 10.0, "×5"),
        (2.0, 0.2, "×0.1"),
        (2.0, 0.0, "-100 %"),
    ],
)
def test_how_far_off_is_told_in_words(published, computed, off):
    comparison = Comparison(
        Fact("f", published, "um", "measured", "somebody", "a model", "", lambda: computed), computed
    )
    assert comparison.off == off
    assert Validation((comparison,)).rows() == [("f", "2", f"{computed:.4g}", "µm", off, "[1]")]


def test_it_prints_each_source_once_and_claims_nothing(validation):
    text = str(validation)
    assert text.startswith("11 published numbers")
    assert text.count("measured: X. Cao et al. 2022") == 1
    assert "This table validates no model." in text
    described = validation.to_dict()["facts"]
    assert described[0]["published"] == {"value": 22.961, "unit": "um"}
    assert math.isfinite(described[0]["computed"]["value"])


def test_the_figure_has_a_mark_for_every_number(validation):
    ax = plot_validation(validation).axes[0]
    marks = sum(np.size(line.get_xdata()) for line in ax.lines if line.get_label() in KINDS)
    assert marks == len(validation.comparisons)
    assert [tick.get_text() for tick in ax.get_yticklabels()] == [c.fact.name for c in validation.comparisons]
