"""Laws of several parameters together.

What checks of arguments give; their messages are in `bad_input/test_calls.py`.
"""

import inspect
import math
import os
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from erosion import TABLE_1, advise, stream
from erosion.arguments import check_path, check_share, check_whole
from erosion.distributions import (
    LogNormal,
    LogUniform,
    Normal,
    RosinRammler,
    Samples,
    Uniform,
    Weibull,
    as_law,
    read_distribution,
)
from erosion.fits.fit_files import read_draws
from erosion.joint_laws import SHARE, CorrelatedLaws, LawSet, Ranges, Rows, law_digest, read_rows
from erosion.parameters.quantities import QUANTITIES

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


def test_rows_of_a_file(written):
    path = written("hits.csv", "cell, alpha [deg], v0 [m/s]\n1, 30, 100\n2, 20, 200\n")
    rows = read_rows(path, QUANTITIES, "si")
    np.testing.assert_allclose(rows.columns["alpha"], np.deg2rad([30, 20]))
    np.testing.assert_array_equal(rows.columns["v0"], [100, 200])
    for text, message in (
        ("cell, wall\n1, 30\n", "^must have columns of parameters"),
        ("v0 [m/s]\n100\nnan\n", "column `v0 .*` must have a finite number"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_rows(path, QUANTITIES, "si")


def test_a_pipe_is_no_table_and_no_draws(tmp_path):
    os.mkfifo(tmp_path / "hits.csv")
    with pytest.raises(ValueError, match=r"is no file$"):
        read_rows(tmp_path / "hits.csv", QUANTITIES, "si")
    with pytest.raises(ValueError, match=r"hits.csv: is no file\.$"):
        read_draws(tmp_path / "hits.csv", QUANTITIES, "si")


OTHER_UNITS = Rows({"sigma": [1e9, 2e9]}, "the posterior of x.csv", "si")
REFUSED = [
    (lambda: Rows({}), "must be of one length, but lengths are none"),
    (lambda: Rows({"r": [1.0], "v0": [1.0, 2.0]}), "but lengths are r 1, v0 2"),
    (lambda: Rows({"r": [np.nan]}), "must give r finite numbers"),
    (lambda: CorrelatedLaws(LAWS, {("v0", "b"): 0.5}), "must name pairs of v0, r, but has"),
    (lambda: CorrelatedLaws(LAWS, {("v0", "r"): 1.0}), r"must be in \(-1, 1\), but is 1.0 for v0 and r"),
    (
        lambda: CorrelatedLaws(LAWS, {("v0", "r"): 0.5, ("r", "v0"): 0.1}),
        "must give v0 and r once, but gives them twice",
    ),
    (
        lambda: CorrelatedLaws({**LAWS, "b": Normal(1, 0.1)}, {("v0", "r"): 0.9, ("r", "b"): 0.9, ("v0", "b"): -0.9}),
        "these pairs contradict each other",
    ),
    (lambda: LawSet(Rows({"r": [-1.0] + 999 * [1.0]}), {"r": (0.0, np.inf)}), "`r` must be positive, but 0.1% of"),
    (lambda: LawSet({"s": Normal(0.9, 0.1)}, {"s": SHARE}), "`s` must be positive and at most 1, but 15.9% of"),
    (lambda: LawSet({"e": Normal(1, 1)}, {"e": FROM_0}), "`e` must be at least 0, but 15.9%"),
    (lambda: Samples([1.0, np.nan]), "`values` must be finite numbers"),
    (
        lambda: stream("linearized", TABLE_1, alpha=Normal(0.4, 0.01), n=64, best_angle=False, uncertain=OTHER_UNITS),
        "are in si, but the case is in inch-pound",
    ),
    (
        lambda: advise(TABLE_1, models=["linearized"], uncertain=OTHER_UNITS),
        "are in si, but the case is in inch-pound",
    ),
    *(
        (lambda given=given: check_share("rtol", given), r"^Argument `rtol` must be in \(0, 1\), but is .*\.$")
        for given in (0, 1, -0.1, True, np.nan, np.inf, "0.1", None, np.array([0.1]))
    ),
    *(
        (
            lambda given=given: check_whole("n", given, 1),
            r"^Argument `n` must be a whole number of at least 1, but is .*\.$",
        )
        for given in (0, 3.0, True, "3", None, np.float64(4))
    ),
    (lambda: check_path("store", "a\0b"), "holds a zero byte"),
]
# Outside of the tests nothing checks types before.
WRONG_TYPES = [
    (lambda: CorrelatedLaws({"r": 0.04}, {}), "must give r a distribution such as"),
    (lambda: inspect.unwrap(check_path)("store", 3), r"^Argument `store` must be a path, but is 3\.$"),
]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [(make, ValueError, said) for make, said in REFUSED] + [(make, TypeError, said) for make, said in WRONG_TYPES],
)
def test_what_cannot_be(make, error, message):
    with pytest.raises(error, match=message):
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


U = (np.arange(4096) + 0.5) / 4096


@pytest.mark.parametrize(
    ("law", "known"),
    [
        (Normal(20, 3), stats.norm(20, 3)),
        (LogNormal(100, 0.2), stats.lognorm(0.2, scale=100)),
        (Uniform(-1, 3), stats.uniform(-1, 4)),
        (LogUniform(0.5, 30), stats.loguniform(0.5, 30)),
        (Weibull(5, 2.5), stats.weibull_min(2.5, scale=5)),
    ],
)
def test_laws_are_scipys(law, known):
    np.testing.assert_allclose(law.ppf(U), known.ppf(U), rtol=1e-12)
    for x in (-2.0, 0.0, 2.5, 99.0):
        assert law.cdf(x) == pytest.approx(known.cdf(x), rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("spread", [1.0, 3.0, 5.0])
def test_rosin_rammler_gives_back_the_sieves(spread):
    law = RosinRammler(1.0, spread, 0.1)
    size = np.geomspace(0.1, 50, 20_001)
    number = np.diff([law.cdf(x) for x in size])
    middle = (size[1:] + size[:-1]) / 2
    mass = number * middle**3
    for sieve in (0.3, 0.7, 1.0, 1.3):
        coarser = mass[middle > sieve].sum() / mass.sum()
        # Of what is coarser than the least size; the sum over 20 000 classes errs by half a class.
        assert coarser == pytest.approx(math.exp(-(sieve**spread) + 0.1**spread), rel=5e-3)
    np.testing.assert_allclose([law.cdf(x) for x in law.ppf(U[::64])], U[::64], rtol=1e-6)


def test_narrow_rosin_rammler_is_a_gamma_law_of_powers():
    # For n > 3, (x/d)ⁿ by number is gamma-distributed with shape 1 - 3/n where nothing is cut off.
    law = RosinRammler(2.0, 6.0, 1e-4)
    np.testing.assert_allclose(law.ppf(U), 2 * special.gammaincinv(0.5, U) ** (1 / 6), rtol=1e-6)


def test_samples_come_as_often_as_they_were_measured():
    law = Samples([3.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(np.unique(law.ppf(U), return_counts=True), [[1, 2, 3], [2048, 1024, 1024]])
    assert [law.cdf(0.5), law.cdf(1.0)] == [0, 0.5]


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("normal(20 deg, 3deg)", Normal(math.radians(20), math.radians(3))),
        (" lognormal(1 ft, 0.2) ", LogNormal(12, 0.2)),
        ("uniform(-1, 2)", Uniform(-1, 2)),
        ("weibull(3, 2)", Weibull(3, 2)),
        ("rosin-rammler(1 in, 3, 0.2 in)", RosinRammler(1, 3, 0.2)),
        ("20 deg", None),
    ],
)
def test_text_is_read(text, law):
    dimension = "angle" if "deg" in text else "length"
    assert read_distribution(text, "alpha", dimension, "inch-pound") == law


def test_samples_are_read_with_their_unit(written):
    file = written("jet.csv", "note,v0 [ft/s],alpha\n1,100,0.3\n\n2,200,0.4\n")
    found = read_distribution(f"samples({file})", "v0", "speed", "inch-pound")
    assert isinstance(found, Samples)
    np.testing.assert_allclose(found.values, [1200, 2400])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cauchy(1, 2)", "must be one of normal, lognormal"),
        ("normal(1)", r"must be normal\(mean, deviation\)"),
        ("normal(1, 2 kg)", "must be a speed"),
        ("normal(1, -2)", "`deviation` must be positive"),
        ("uniform(2, 1)", "`low` must be less"),
        ("rosin-rammler(1, 3, 99)", "`least` must be"),
        ("weibull(1, inf)", "`shape` must be positive and finite"),
        ("samples(nowhere.csv)", "must name a table"),
        ("samples(FILE)", r"column `v0 \[m/s\]` must be a number"),
        ("samples(OTHER)", "must name a table with a column `v0`"),
    ],
)
def test_what_is_no_law_is_refused(tmp_path, text, message):
    file, other = tmp_path / "jet.csv", tmp_path / "other.csv"
    file.write_text("v0 [m/s]\n1\nfast\n")
    other.write_text("m\n1\n")
    with pytest.raises(ValueError, match=message):
        read_distribution(text.replace("FILE", str(file)).replace("OTHER", str(other)), "v0", "speed", "inch-pound")
