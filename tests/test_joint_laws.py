"""Laws of several parameters together."""

import os
from typing import Any

import numpy as np
import pytest
from scipy import stats

from erosion.advice.advise import advise
from erosion.distributions import LogNormal, Normal, Samples, Uniform, as_law
from erosion.fits.posterior_files import read_draws
from erosion.joint_laws import SHARE, CorrelatedLaws, LawSet, Ranges, Rows, law_digest, read_rows
from erosion.parameters.parameters import TABLE_1
from erosion.parameters.quantities import QUANTITIES
from erosion.streams.stream import stream

POINTS = np.random.default_rng(0).random((100_000, 2))
FROM_0 = (np.nextafter(0.0, -1.0), np.inf)
WHOLE: Ranges = dict.fromkeys(("v0", "r", "alpha"), (0.0, 1.0))
LAWS = {"v0": LogNormal(4400.0, 0.1), "r": Uniform(0.03, 0.05)}


def test_a_copula_keeps_the_laws_and_ties_their_ranks():
    values = CorrelatedLaws(LAWS, {("v0", "r"): -0.6}).draw(POINTS, WHOLE)
    for name, law in LAWS.items():
        # Kolmogorov and Smirnov's distance of 100 000 draws exceeds 0.006 once in a thousand times.
        shares = np.sort([law.cdf(value) for value in values[name][:20_000]])
        assert np.abs(shares - (np.arange(20_000) + 0.5) / 20_000).max() < 0.014
    ranks = stats.spearmanr(values["v0"], values["r"])[0]
    assert ranks == pytest.approx(6 / np.pi * np.arcsin(-0.3), abs=0.01)
    cut = CorrelatedLaws(LAWS, {}).draw(POINTS, {"v0": (0.5, 0.9), "r": (0.0, 1.0)})
    assert cut["v0"].min() >= 4400
    assert cut["v0"].max() <= LAWS["v0"].ppf(np.array([0.9]))


def test_rows_in_other_units_are_refused():
    rows = Rows({"sigma": [1e9, 2e9]}, "the posterior of x.csv", "si")
    with pytest.raises(ValueError, match="are in si, but the case is in inch-pound"):
        stream("linearized", TABLE_1, alpha=Normal(0.4, 0.01), n=64, best_angle=False, uncertain=rows)
    with pytest.raises(ValueError, match="are in si, but the case is in inch-pound"):
        advise(TABLE_1, models=["linearized"], uncertain=rows)


def test_a_law_is_cut_at_both_ends_of_the_range():
    laws = LawSet({"s": Normal(0.5, 0.19)}, {"s": SHARE})
    values = laws.draw(np.linspace(0.0, 1.0, 101)[1:-1, None])["s"]
    assert 0 < values.min() < 0.1
    assert 0.9 < values.max() < 1
    assert values[49] == pytest.approx(0.5)
    at_zero = LawSet(Rows({"e": [0.0, 1.0]}), {"e": FROM_0})
    np.testing.assert_array_equal(at_zero.draw(np.array([[0.2], [0.7]]))["e"], [0.0, 1.0])


def test_rows_stay_together():
    angle, speed = np.arange(5.0), 10 * np.arange(5.0)
    values = Rows({"alpha": angle, "v0": speed}).draw(POINTS[:, :1], WHOLE)
    np.testing.assert_array_equal(values["v0"], 10 * values["alpha"])
    np.testing.assert_allclose(np.bincount(values["alpha"].astype(int)) / len(POINTS), 0.2, atol=0.006)


def test_a_joint_law_is_a_mapping_of_laws():
    rows = Rows({"alpha": [0.1, 0.3, 0.2], "v0": [1.0, 3.0, 2.0]}, "jet.csv")
    assert {**rows}.keys() == {"alpha", "v0"}
    assert rows["v0"].ppf(np.array([0.5])) == [2.0]
    assert rows["v0"].cdf(1.5) == pytest.approx(1 / 3)
    assert str(rows["v0"]).endswith("row by row of alpha, v0")
    correlated = CorrelatedLaws(LAWS, {("v0", "r"): 0.5})
    assert str(correlated["r"]) == "Uniform(0.03, 0.05), correlated: v0 with r by 0.5"
    assert correlated["r"].in_words("length", "si") == "uniform(30 mm, 50 mm), correlated: v0 with r by 0.5"
    with pytest.raises(KeyError):
        rows["r"]


def test_rows_of_a_file(tmp_path):
    path = tmp_path / "hits.csv"
    path.write_text("cell, alpha [deg], v0 [m/s]\n1, 30, 100\n2, 20, 200\n")
    rows = read_rows(path, QUANTITIES, "si")
    np.testing.assert_allclose(rows.columns["alpha"], np.deg2rad([30, 20]))
    np.testing.assert_array_equal(rows.columns["v0"], [100, 200])
    for text, message in (
        ("cell, wall\n1, 30\n", "^must have columns of parameters"),
        ("v0 [m/s]\n100\nnan\n", "^must have a finite number in each row of column `v0`"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_rows(path, QUANTITIES, "si")


def test_a_pipe_is_no_table_and_no_draws(tmp_path):
    os.mkfifo(tmp_path / "hits.csv")
    with pytest.raises(ValueError, match=r"^must name a CSV file, but '.*' is no file$"):
        read_rows(tmp_path / "hits.csv", QUANTITIES, "si")
    with pytest.raises(ValueError, match=r"hits.csv: is no file\.$"):
        read_draws(tmp_path / "hits.csv", QUANTITIES, "si")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rows({}), "must be of one length, but lengths are none"),
        (lambda: Rows({"r": [1.0], "v0": [1.0, 2.0]}), "but lengths are r 1, v0 2"),
        (lambda: Rows({"r": [np.nan]}), "must give r finite numbers"),
        (lambda: CorrelatedLaws(LAWS, {("v0", "b"): 0.5}), "must name pairs of v0, r, but has"),
        (lambda: CorrelatedLaws(LAWS, {("v0", "r"): 1.0}), r"must be in \(-1, 1\), but is 1.0 for v0 and r"),
        (
            lambda: CorrelatedLaws(LAWS, {("v0", "r"): 0.5, ("r", "v0"): 0.1}),
            "must give v0 and r once, but gives them twice",
        ),
        (lambda: LawSet(Rows({"r": [-1.0] + 999 * [1.0]}), {"r": (0.0, np.inf)}), "`r` must be positive, but 0.1% of"),
        (lambda: CorrelatedLaws({"r": 0.04}, {}), "must give r a distribution such as"),
        (
            lambda: CorrelatedLaws(
                {**LAWS, "b": Normal(1, 0.1)}, {("v0", "r"): 0.9, ("r", "b"): 0.9, ("v0", "b"): -0.9}
            ),
            "these pairs contradict each other",
        ),
        (lambda: LawSet({"s": Normal(0.9, 0.1)}, {"s": SHARE}), "`s` must be positive and at most 1, but 15.9% of"),
        (
            lambda: LawSet({"e": Normal(1, 1)}, {"e": FROM_0}),
            "`e` must be at least 0, but 15.9%",
        ),
    ],
)
def test_what_cannot_be(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()


LAW = """
import dataclasses
import numpy as np
from erosion.distributions import Distribution

def middle(u): return {middle}

@dataclasses.dataclass(frozen=True)
class Mine(Distribution):
    '''{text}'''
    mean: float = 1.0

    def ppf(self, u):
        return {formula}

    def cdf(self, x):
        return {below}
"""


def typed(
    middle: str = "u", text: str = "A law.", formula: str = "self.mean + middle(u)", below: str = "float(x >= 1)"
) -> Any:
    scope: dict[str, Any] = {"__name__": "typed"}
    exec(LAW.format(middle=middle, text=text, formula=formula, below=below), scope)
    return scope["Mine"]()


def test_a_law_is_known_by_its_draws_and_numbers() -> None:
    values = np.linspace(0, 1, 5000)
    changed = values.copy()
    changed[2501] = np.nextafter(changed[2501], np.inf)
    different = [
        as_law(stats.norm(1, 0.1)), as_law(stats.norm(1, 0.2)),
        typed(), typed(middle="u + 1e-12"), typed(formula="self.mean - middle(u)"), typed(below="float(x >= 0.5)"),
        Normal(1, 0.1), Normal(1, 0.1 + 1e-16), Samples(values), Samples(changed),
        Rows({"v0": values, "r": values})["v0"], Rows({"v0": changed, "r": values})["v0"],
        *(CorrelatedLaws({"v0": Normal(1, 2), "r": Normal(1, 2)}, {("v0", "r"): rho})["v0"] for rho in (0.1, 0.2)),
    ]  # fmt: skip
    assert len({law_digest(law) for law in different}) == len(different)
    same = [typed(), typed(text="Another text."), typed(formula="middle(u) + self.mean"), typed(middle="+u")]
    assert len({law_digest(law) for law in same}) == 1
    assert law_digest(Samples(values, "a.csv")) == law_digest(Samples(values, "b.csv"))
