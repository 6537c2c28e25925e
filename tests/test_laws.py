"""Laws of one parameter and of several together, by their inverse distribution.

What checks of arguments give; their messages are in `bad_input/test_calls.py`.
"""

import inspect
import math
import os

import numpy as np
import pytest
from scipy import special, stats

from erosion import TABLE_1, advise, stream
from erosion.arguments import check_path, check_share, check_whole
from erosion.fits.fit_files import read_draws
from erosion.laws import (
    LAWS,
    SHARE,
    JointLaw,
    JointSamples,
    RosinRammler,
    Samples,
    joint_law,
    law_as_typed,
    law_digest,
    law_in_words,
    read_law,
    read_samples,
)
from erosion.parameters.quantities import QUANTITIES

U = (np.arange(4096) + 0.5) / 4096
POINTS = np.random.default_rng(0).random((100_000, 2))
FROM_0 = (np.nextafter(0.0, -1.0), np.inf)

NUMBERS = {
    "normal": (20.0, 3.0),
    "lognormal": (100.0, 0.2),
    "uniform": (-1.0, 3.0),
    "loguniform": (0.5, 30.0),
    "weibull": (5.0, 2.5),
    "rosin-rammler": (1.0, 3.0, 0.1),
}
KNOWN = {
    "normal": stats.norm(20, 3),
    "lognormal": stats.lognorm(0.2, scale=100),
    "uniform": stats.uniform(-1, 4),
    "loguniform": stats.loguniform(0.5, 30),
    "weibull": stats.weibull_min(2.5, scale=5),
    "rosin-rammler": RosinRammler(1, 3, 0.1),
}


@pytest.mark.parametrize("name", LAWS)
def test_a_named_law_is_scipys_and_reads_as_it_is_written(name):
    law = LAWS[name](*NUMBERS[name])
    assert law_digest(law) == law_digest(KNOWN[name])
    np.testing.assert_allclose([law.cdf(x) for x in law.ppf(U[::64])], U[::64], rtol=1e-9)
    words = law_in_words(law, "length", "si")
    assert words.startswith(f"{name}(")
    np.testing.assert_allclose(read_law(words, "r", "length", "si").ppf(U), law.ppf(U), rtol=1e-12)
    inches = law_in_words(law, "length", "inch-pound")
    np.testing.assert_allclose(read_law(inches, "r", "length").ppf(U), law.ppf(U), rtol=1e-4)


@pytest.mark.parametrize("name", LAWS)
def test_a_number_that_makes_no_law_is_named(name):
    for at, parameter in enumerate(LAWS[name].keywords):
        numbers = [*NUMBERS[name]]
        numbers[at] = math.nan
        with pytest.raises(ValueError, match=f"`{parameter}` must be .*finite, but is nan"):
            LAWS[name](*numbers)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("dimension", ["angle", "volume", "mass per mass"])
def test_a_law_as_it_is_typed_is_read_again(name, dimension):
    law = LAWS[name](*(number / 7 for number in NUMBERS[name]))
    read = read_law(law_as_typed(law, dimension), "x", dimension)
    np.testing.assert_allclose(read.ppf(U), law.ppf(U), rtol=1e-7)


def test_a_law_that_no_option_states_has_no_text():
    assert law_as_typed(stats.gamma(2), "1") == ""


def test_words_of_other_laws():
    assert law_in_words(stats.norm(scale=3, loc=math.radians(20)), "angle", "si") == "normal(20°, 171.89°)"
    assert law_in_words(stats.lognorm(0.1, loc=2, scale=3)) == "lognorm(s=0.1, loc=2, scale=3)"
    assert law_in_words(stats.gamma(2)) == "gamma(a=2)"
    assert law_in_words(Samples([1.0, 2.0], "jet.csv"), "speed", "si") == "2 values of jet.csv"
    # An address in memory would be another one in each process.
    assert law_in_words(HalfAndHalf()) == f"HalfAndHalf {law_digest(HalfAndHalf())}"
    histogram = stats.rv_histogram(np.histogram([1.0, 2.0, 2.5]))
    assert law_in_words(histogram) == law_in_words(histogram()) == f"rv_histogram {law_digest(histogram)}"


class HalfAndHalf:
    """A law of somebody's own: 0 to 1, and `middle` at the middle."""

    def __init__(self, middle: float = 0.5, step: float = 1.0) -> None:
        self.middle, self.step = middle, step

    def ppf(self, u):
        return np.where(u < 0.5, u * self.middle / 0.5, self.middle + (u - 0.5) * (1 - self.middle) / 0.5)

    def cdf(self, x):
        return float(x >= self.step)


def test_a_law_is_known_by_its_numbers_or_its_values():
    values = np.linspace(0, 1, 5000)
    changed = values.copy()
    changed[2501] = np.nextafter(changed[2501], np.inf)
    counts = np.histogram(values)
    different = [
        *KNOWN.values(), stats.norm(1, 0.1), stats.norm(1, 0.1 + 1e-16), stats.gamma(2), stats.gamma(2, loc=1),
        Samples(values), Samples(changed), HalfAndHalf(), HalfAndHalf(0.5 + 1e-12), HalfAndHalf(step=0.9),
        stats.rv_histogram(counts), stats.rv_histogram((counts[0], counts[1] + 1.0)),
        stats.rv_histogram(counts)(), stats.rv_histogram((counts[0], counts[1] + 1.0))(),
    ]  # fmt: skip
    digests = [law_digest(law) for law in different]
    # A frozen histogram is the histogram.
    assert len({*digests}) == len(different) - 2
    assert law_digest(stats.norm(1, 0.1)) == law_digest(stats.norm(scale=0.1, loc=1.0))
    assert law_digest(Samples(values, "a.csv")) == law_digest(Samples(values, "b.csv"))
    joint = [
        JointLaw(TWO), JointLaw({"r": TWO["r"], "v0": TWO["v0"]}), JointLaw(TWO, {("v0", "r"): 0.1}),
        JointLaw(TWO, {("v0", "r"): 0.2}), JointLaw({"v0": TWO["v0"]}),
        *(JointLaw(samples=(JointSamples({"v0": column, "r": values}),)) for column in (values, changed)),
    ]  # fmt: skip
    assert len({law.digest for law in joint}) == len(joint)
    assert JointLaw(TWO, {("v0", "r"): 0.1}).digest == joint[2].digest


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


def test_narrow_rosin_rammler_is_a_gamma_law_of_powers():
    # For n > 3, (x/d)ⁿ by number is gamma-distributed with shape 1 - 3/n where nothing is cut off.
    law = RosinRammler(2.0, 6.0, 1e-4)
    np.testing.assert_allclose(law.ppf(U), 2 * special.gammaincinv(0.5, U) ** (1 / 6), rtol=1e-6)


def test_samples_come_as_often_as_they_were_measured():
    law = Samples([3.0, 1.0, 2.0, 1.0])
    np.testing.assert_array_equal(np.unique(law.ppf(U), return_counts=True), [[1, 2, 3], [2048, 1024, 1024]])
    assert [law.cdf(0.5), law.cdf(1.0)] == [0, 0.5]


TWO = {"v0": stats.lognorm(0.1, scale=4400.0), "r": stats.uniform(0.03, 0.02)}


def test_a_copula_keeps_the_laws_and_ties_their_ranks():
    values = JointLaw(TWO, {("v0", "r"): -0.6}).draw(POINTS)
    for name, law in TWO.items():
        # Kolmogorov and Smirnov's distance of 100 000 draws exceeds 0.006 once in a thousand times.
        assert stats.kstest(values[name], law.cdf).statistic < 0.006
    ranks = stats.spearmanr(values["v0"], values["r"])[0]
    assert ranks == pytest.approx(6 / np.pi * np.arcsin(-0.3), abs=0.01)
    bounds = {"v0": (TWO["v0"].ppf(0.004), TWO["v0"].ppf(0.996)), "r": (0.0, np.inf)}
    cut = JointLaw(TWO, {("v0", "r"): -0.6}).within(bounds).draw(POINTS)["v0"]
    assert bounds["v0"][0] <= cut.min() < TWO["v0"].ppf(0.005)
    assert TWO["v0"].ppf(0.995) < cut.max() <= bounds["v0"][1]


def test_parameters_that_are_tied_are_one_input():
    laws = {name: stats.norm(1, 0.1) for name in "abcdef"}
    table = JointSamples({"x": [1.0, 2.0], "y": [3.0, 4.0]})
    joint = JointLaw(laws, {("a", "b"): 0.5, ("c", "d"): 0.3, ("e", "b"): 0.2}, (table,))
    assert joint.inputs == {("f",): 1, ("c", "d"): 2, ("a", "b", "e"): 3, ("x", "y"): 1}
    values = joint.draw(np.random.default_rng(1).random((50_000, joint.dimension)))
    found = np.corrcoef([values[name] for name in "abcdef"])
    wanted = np.eye(6)
    for i, j, rho in ((0, 1, 0.5), (2, 3, 0.3), (1, 4, 0.2)):
        wanted[i, j] = wanted[j, i] = rho
    np.testing.assert_allclose(found, wanted, atol=0.02)
    np.testing.assert_array_equal(values["y"], values["x"] + 2)
    assert joint.only({"a", "c", "d", "y"}).inputs == {("a",): 1, ("c", "d"): 2, ("y",): 1}


def test_a_law_is_cut_at_both_ends_of_the_range():
    laws = JointLaw({"s": stats.norm(0.5, 0.19)}).within({"s": SHARE})
    values = laws.draw(np.linspace(0.0, 1.0, 101)[1:-1, None])["s"]
    assert 0 < values.min() < 0.1
    assert 0.9 < values.max() < 1
    assert values[49] == pytest.approx(0.5)
    assert laws.medians["s"] == pytest.approx(0.5)
    at_zero = JointLaw(samples=(JointSamples({"e": [0.0, 1.0]}),)).within({"e": FROM_0})
    np.testing.assert_array_equal(at_zero.draw(np.array([[0.2], [0.7]]))["e"], [0.0, 1.0])


def test_joint_samples_stay_together():
    angle, speed = np.arange(5.0), 10 * np.arange(5.0)
    values = JointLaw(samples=(JointSamples({"alpha": angle, "v0": speed}),)).draw(POINTS[:, :1])
    np.testing.assert_array_equal(values["v0"], 10 * values["alpha"])
    np.testing.assert_allclose(np.bincount(values["alpha"].astype(int)) / len(POINTS), 0.2, atol=0.006)


def test_a_joint_law_is_true_where_it_has_a_law():
    assert not JointLaw()
    assert JointLaw({"k": stats.norm(2, 0.1)})
    assert JointLaw(samples=(JointSamples({"k": [1.9, 2.1]}, "tests"),))


def test_a_joint_law_in_words():
    table = JointSamples({"alpha": [0.1, 0.3, 0.2], "k": [1.0, 3.0, 2.0]}, "jet.csv")
    assert JointLaw(TWO, {("v0", "r"): 0.5}, (table,)).in_words(QUANTITIES, "si") == {
        "v0": "lognormal(4400 m/s, 0.1), correlated: v0 with r by 0.5",
        "r": "uniform(30 mm, 50 mm), correlated: v0 with r by 0.5",
        "alpha": "3 values of jet.csv, row by row of alpha, k",
        "k": "3 values of jet.csv, row by row of alpha, k",
    }


def test_samples_of_a_file(written):
    path = written("hits.csv", "cell, alpha [deg], v0 [m/s]\n1, 30, 100\n2, 20, 200\n")
    table = read_samples(path, QUANTITIES)
    np.testing.assert_allclose(table.columns["alpha"], np.deg2rad([30, 20]))
    np.testing.assert_array_equal(table.columns["v0"], [100, 200])
    (unused,) = JointLaw(samples=(table,)).unused_columns
    assert unused.numbers == {"columns": ["cell"]}
    for text, message in (
        ("cell, wall\n1, 30\n", "^must have columns of parameters"),
        ("v0 [m/s]\n100\nnan\n", "column `v0 .*` must have a finite number"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_samples(path, QUANTITIES)


def test_samples_have_comments_semicolons_and_decimal_commas(written):
    path = written("hits.csv", "# of a run\nalpha [deg];v0 [m/s]\n30,5;100\n20;200,25\n")
    table = read_samples(path, QUANTITIES)
    np.testing.assert_allclose(table.columns["alpha"], np.deg2rad([30.5, 20]))
    np.testing.assert_array_equal(table.columns["v0"], [100, 200.25])
    path.write_text("% of a run\nv0 [m/s];\n100,5;\n200,25;\n")
    np.testing.assert_array_equal(read_law(f"samples({path})", "v0", "speed", "si").values, [100.5, 200.25])


def test_a_pipe_is_no_table_and_no_draws(tmp_path):
    os.mkfifo(tmp_path / "hits.csv")
    with pytest.raises(ValueError, match=r"is no file$"):
        read_samples(tmp_path / "hits.csv", QUANTITIES)
    with pytest.raises(ValueError, match=r"hits.csv: is no file\.$"):
        read_draws(tmp_path / "hits.csv", QUANTITIES)


OF_1000 = JointSamples({"r": [-1.0] + 999 * [1.0]})
REFUSED = [
    (lambda: JointSamples({}), "must be of one length, but lengths are none"),
    (lambda: JointSamples({"r": [1.0], "v0": [1.0, 2.0]}), "but lengths are r 1, v0 2"),
    (lambda: JointSamples({"r": [np.nan]}), "must give r finite numbers"),
    (lambda: JointLaw(TWO, samples=(OF_1000,)), "`samples` must give r alone, but r has another law, too"),
    (lambda: JointLaw(TWO, {("v0", "b"): 0.5}), "must name pairs of v0, r, but has"),
    (lambda: JointLaw(TWO, {("v0", "r"): 1.0}), r"must be in \(-1, 1\), but is 1.0 for v0 and r"),
    (lambda: JointLaw(TWO, {("v0", "r"): 0.5, ("r", "v0"): 0.1}), "must give v0 and r once, but gives them twice"),
    (
        lambda: JointLaw({**TWO, "b": stats.norm()}, {("v0", "r"): 0.9, ("r", "b"): 0.9, ("v0", "b"): -0.9}),
        "these pairs contradict each other",
    ),
    (lambda: JointLaw({"r": stats.norm(1, -1)}), "`r` must be a law with one finite number for each share"),
    (lambda: JointLaw(samples=(OF_1000,)).within({"r": (0.0, np.inf)}), "`r` must be positive, but 0.1% of 1,000"),
    (
        lambda: JointLaw({"s": stats.norm(0.9, 0.1)}).within({"s": SHARE}),
        r"`s` must be positive and at most 1, but 15.9% of normal\(0.9, 0.1\) is not",
    ),
    (lambda: JointLaw({"e": stats.norm(1, 1)}).within({"e": FROM_0}), "`e` must be at least 0, but 15.9%"),
    (lambda: Samples([1.0, np.nan]), "`values` must be finite numbers"),
    *(
        (
            lambda laws=laws, option=option: joint_law(laws, "uncertain", **option),
            f"`{next(iter(option))}` must be left out where `uncertain` is a {type(laws).__name__}",
        )
        for laws in (JointLaw(TWO), JointSamples({"v0": [1.0]}))
        for option in ({"correlation": {("v0", "r"): 0.9}}, {"samples": {"b": [1.0]}})
    ),
    (lambda: RosinRammler(1, 3, 99), "`least` must be"),
    (
        lambda: stream(
            "linearized",
            TABLE_1,
            k=stats.norm(2, 0.01),
            n=64,
            best_angle=False,
            uncertain={"sigma": stats.norm(1e9, 1e8)},
        ),
        "`sigma` must come with a case that is shown in SI, as laws and samples are in SI",
    ),
    (
        lambda: advise(TABLE_1, models=["linearized"], uncertain={"sigma": stats.norm(1e9, 1e8)}),
        "`sigma` must come with a case that is shown in SI, as laws and samples are in SI",
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
    (lambda: JointLaw({"r": 0.04}), "must be a law such as"),
    (lambda: JointLaw({"r": stats.norm()}).within({"v0": SHARE}), "`r` is not a parameter; they are v0"),
    (lambda: inspect.unwrap(check_path)("store", 3), r"^Argument `store` must be a path, but is 3\.$"),
]


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [(make, ValueError, said) for make, said in REFUSED] + [(make, TypeError, said) for make, said in WRONG_TYPES],
)
def test_what_cannot_be(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_text_without_a_call_is_no_law():
    assert read_law("20 deg", "alpha", "angle", "si") is None
    law = read_law(" normal(20 deg, 3deg) ", "alpha", "angle", "si")
    assert law_digest(law) == law_digest(stats.norm(math.radians(20), math.radians(3)))


def test_samples_are_read_with_their_unit(written):
    file = written("jet.csv", "note,v0 [ft/s],alpha\n1,100,0.3\n\n2,200,0.4\n")
    found = read_law(f"samples({file})", "v0", "speed", "inch-pound")
    assert isinstance(found, Samples)
    np.testing.assert_allclose(found.values, [30.48, 60.96])


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
        read_law(text.replace("FILE", str(file)).replace("OTHER", str(other)), "v0", "speed", "inch-pound")
