"""Points, estimates, and tallies: the numbers of all particles at once, whatever parts they come in."""

import dataclasses

import jax
import numpy as np
import pytest

from erosion.streams.tally import BIN_RATIO, Estimate, Points, Tally

SCALE = 1e-4
ENDS = ("stop", "no-cut", "failed")


def particles() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volumes, masses and ends of two replicates: lognormal, some zero, some unknown."""
    generator = np.random.default_rng(5)
    volume = np.exp(generator.normal(-9, 1, (2, 3000)))
    volume[:, :30], volume[:, 30:40] = 0.0, np.nan
    ends = np.where(np.isnan(volume), "failed", np.where(volume == 0, "no-cut", "stop"))
    return volume, generator.uniform(1, 2, (2, 3000)), ends


VOLUME, MASS, ENDED_BY = particles()
KNOWN = VOLUME[np.isfinite(VOLUME)]


def tally_of(part: slice) -> Tally:
    return Tally.of(VOLUME[:, part], MASS[:, part], ENDED_BY[:, part], ENDS, SCALE, {"twice": 2 * VOLUME[:, part]})


def alone(volume: np.ndarray) -> Tally:
    return Tally.of(volume, np.ones(volume.shape), np.full(volume.shape, "stop"), ENDS, 1.0)


@pytest.fixture(scope="module")
def whole() -> Tally:
    return tally_of(slice(None))


def test_a_tally_counts_and_adds(whole: Tally) -> None:
    assert whole.drawn == 3000
    np.testing.assert_array_equal(whole.counted, [2990, 2990])
    np.testing.assert_array_equal(whole.ends, [[2960, 30, 10]] * 2)
    np.testing.assert_allclose(whole.mean, np.nanmean(VOLUME, axis=1), rtol=1e-13)
    np.testing.assert_allclose(whole.squares, 2990 * np.nanvar(VOLUME, axis=1), rtol=1e-12)
    # Of particles whose volume is known.
    np.testing.assert_allclose(whole.mass, MASS[:, :30].sum(axis=1) + MASS[:, 40:].sum(axis=1), rtol=1e-13)
    assert whole.deviation == pytest.approx(KNOWN.std(), rel=1e-12)


@pytest.mark.parametrize("cuts", [(35, 1000), (1, 2), (32, 38)])
def test_parts_add_up_to_the_whole(whole: Tally, cuts: tuple[int, int]) -> None:
    """Also where in one part all volumes are zero or unknown."""
    first, second = cuts
    parts = tally_of(slice(0, first)) + tally_of(slice(first, second)) + tally_of(slice(second, None))
    for name in ("drawn", "counted", "ends", "bins"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    for name in ("mean", "squares", "mass"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-12)


def test_squares_keep_their_digits_far_from_zero() -> None:
    """Volumes of 1 that differ by 1e-9: sums of squares alone would lose all of the deviation."""
    one, other = map(alone, np.split(1 + 1e-9 * np.arange(4.0).reshape(1, 4), 2, 1))
    assert (one + other).deviation == pytest.approx(1e-9 * np.sqrt(1.25), rel=1e-6)


def test_quantiles_are_those_of_the_volumes_to_half_a_bin(whole: Tally) -> None:
    shares = [0.05, 0.5, 0.95]
    exact = np.quantile(KNOWN, shares, method="inverted_cdf")
    given = [whole.quantile(share) for share in shares]
    assert np.abs(np.log(given / exact)).max() <= np.log(BIN_RATIO) / 2 * (1 + 1e-9)
    # Those that remove nothing are the lowest.
    assert whole.quantile(0.99 * 30 / 2990) == 0 < whole.quantile(1.01 * 30 / 2990)
    for volume, quantile in ((1e-40, 1e-24), (1e40, 1e6)):  # beyond the histogram they are in its last bins
        assert alone(np.full((1, 5), volume)).quantile(0.5) == pytest.approx(quantile, rel=BIN_RATIO - 1)


def test_a_histogram_shares_out_the_middle(whole: Tally) -> None:
    edges, shares = whole.histogram(bins=20)
    assert 10 <= len(shares) <= 20
    assert len(edges) == len(shares) + 1
    ratios = edges[1:] / edges[:-1]
    np.testing.assert_allclose(ratios, ratios[0])
    # An edge of the histogram is one of the fine bins', so that each particle is on its own side.
    counts, _ = np.histogram(KNOWN, edges)
    np.testing.assert_allclose(shares, counts / KNOWN.size, atol=1e-12)
    assert shares.sum() == pytest.approx(0.998 * 2960 / 2990, abs=2e-3)


def test_a_dataset_holds_all_of_a_tally(whole: Tally) -> None:
    again = Tally.from_dataset(whole.to_dataset(), own=["twice"])
    one, other = (jax.tree.leaves(dataclasses.asdict(tally)) for tally in (whole, again))
    assert len(one) == 10
    assert [np.asarray(part).tobytes() for part in one] == [np.asarray(part).tobytes() for part in other]


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_points_are_those_of_a_seed_and_go_on_where_they_stopped(kind: str) -> None:
    whole, again, other = (Points(kind, 3, seed, 2).take(64) for seed in (7, 7, 8))
    np.testing.assert_array_equal(whole, again)
    np.testing.assert_array_equal(Points(kind, 3, 7, 2, skip=16).take(16), whole[:, 16:32])
    assert ((whole > 0) & (whole < 1)).all()
    assert not (whole == other).any()
    assert not (whole[0] == whole[1]).any()
    # 2ⁿ points of Sobol: one in each interval of 2⁻ⁿ, along every axis.
    evenly = [(np.sort((axis * 64).astype(int)) == np.arange(64)).all() for sequence in whole for axis in sequence.T]
    assert all(evenly) == any(evenly) == (kind == "sobol")


def test_an_estimate_is_students() -> None:
    mean, moved = (Estimate.of(np.array([1.0, 2.0, 3.0, 4.0]), value) for value in (None, 7.0))
    assert (mean.value, mean.error) == (2.5, pytest.approx(np.sqrt(5 / 3) / 2))
    # t of three degrees of freedom, 97.5 %.
    assert (mean.low, mean.high) == pytest.approx((2.5 - 3.182446 * mean.error, 2.5 + 3.182446 * mean.error), rel=1e-6)
    # A value of its own moves the interval, not the error.
    assert (moved.value, moved.error, moved.high) == (7, mean.error, pytest.approx(7 + mean.high - 2.5))
