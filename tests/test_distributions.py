import math

import numpy as np
import pytest
from scipy import special, stats

from erosion.distributions import (
    LogNormal,
    LogUniform,
    Normal,
    RosinRammler,
    Samples,
    Uniform,
    Weibull,
    read_distribution,
)

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


def test_samples_are_read_with_their_unit(tmp_path):
    file = tmp_path / "jet.csv"
    file.write_text("n,v0 [ft/s],alpha\n1,100,0.3\n\n2,200,0.4\n")
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
        ("samples(nowhere.csv)", "must name a CSV file"),
        ("samples(FILE)", "must have a number in each row"),
        ("samples(OTHER)", "must have one column `v0`"),
    ],
)
def test_what_is_no_law_is_refused(tmp_path, text, message):
    file, other = tmp_path / "jet.csv", tmp_path / "other.csv"
    file.write_text("v0\n1\nfast\n")
    other.write_text("m\n1\n")
    with pytest.raises(ValueError, match=message):
        read_distribution(text.replace("FILE", str(file)).replace("OTHER", str(other)), "v0", "speed", "inch-pound")


def test_samples_must_be_numbers():
    with pytest.raises(ValueError, match="`values` must be finite numbers"):
        Samples([1.0, np.nan])
