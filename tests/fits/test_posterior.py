"""Posteriors hold the truth as often as they say: a sample of what benchmarks/fits.py measures.

Posteriors of models: against closed ones, and what is said about them.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion.fits import Posterior
from erosion.fits.export import options_in_words
from erosion.fits.fit_files import read_draws
from erosion.fits.likelihood import make_likelihood
from erosion.fits.problem import FitProblem
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from erosion.parameters.quantities import QUANTITIES
from tests.fits.problems import drawn

SI = TABLE_1.to("si")


def volumes(degrees: np.ndarray) -> np.ndarray:
    return np.asarray(LinearizedCut().volume(SI.replace(alpha=np.deg2rad(degrees))))


def measured(rows: int, *, known: bool = True) -> dict[str, Any]:
    """Table 1 by the linearized model, with errors of 3 % of the greatest volume."""
    degrees = np.linspace(8.0, 80.0, rows)
    exact = volumes(degrees)
    error = 0.03 * exact.max()
    data = {
        "angle [deg]": degrees,
        "volume [m^3/impact]": exact + error * np.random.default_rng(0).standard_normal(rows),
    }
    return {**data, "uncertainty [m^3]": np.full(rows, error)} if known else data


def posterior(*free: str, p=SI, data=None, draws: int = 200, **options) -> Posterior:
    return drawn("linearized", p, measured(8) if data is None else data, [*free], draws=draws, **options)


@pytest.fixture(scope="module")
def result() -> Posterior:
    return posterior("k", "psi", p=SI.replace(k=3.0), data=measured(12), seed=1)


def test_with_k_fixed_the_posterior_is_the_closed_one():
    data, law = measured(5), stats.norm(0.6, 0.15)
    drawn = posterior("cutting_fraction", data=data, priors={"cutting_fraction": law}, draws=10_000)
    # Volumes are proportional to the fraction: a normal prior gives a normal posterior, cut off at 0 and 1.
    shape, error = volumes(data["angle [deg]"]), data["uncertainty [m^3]"]
    variance = 1 / (1 / law.var() + np.sum((shape / error) ** 2))
    mean = variance * (law.mean() / law.var() + np.sum(shape * data["volume [m^3/impact]"] / error**2))
    whole = stats.norm(mean, variance**0.5)
    closed = stats.truncnorm((0 - mean) / variance**0.5, (1 - mean) / variance**0.5, mean, variance**0.5)
    # Of 40 000 draws the mean is known to half a percent of the deviation, and the deviation to 0.4 %.
    assert drawn.means["cutting_fraction"] == pytest.approx(closed.mean(), abs=0.01 * closed.std())
    assert drawn.deviations["cutting_fraction"] == pytest.approx(closed.std(), rel=0.01)
    ends = drawn.intervals(0.9)["cutting_fraction"]
    np.testing.assert_allclose(ends, closed.ppf([0.05, 0.95]), atol=0.03 * closed.std())
    # The marginal density of the data, of which the truncation keeps a part.
    joint: Any = np.diag(error**2) + law.var() * np.outer(shape, shape)
    evidence = stats.multivariate_normal(law.mean() * shape, joint).logpdf(data["volume [m^3/impact]"])
    evidence += np.log(whole.cdf(1) - whole.cdf(0)) - np.log(law.cdf(1.0) - law.cdf(0.0))
    assert drawn.log_evidence == pytest.approx(evidence, abs=0.05)
    assert drawn.log_evidence_error < 0.05


def test_draws_are_labelled_arrays_and_numbers_for_programs(result):
    psi, numbers = result.samples["psi"], dataclasses.replace(result, level=0.9).to_dict()
    assert dict(psi.sizes) == {"chain": 4, "draw": 200}
    assert result.samples["k"].attrs["long_name"] == "force ratio"
    assert (result.findings, numbers["converged"], numbers["draws"]) == ((), True, 800)
    low, high = numbers["intervals"]["k"]
    assert low < 2.0 < high
    assert numbers["correlation"][0][1] == pytest.approx(
        np.corrcoef(np.ravel(result.samples["k"]), np.ravel(psi))[0, 1]
    )
    assert numbers["priors"]["k"] == "loguniform(0.03, 300), the default"


def test_draws_have_no_residuals_to_check(result):
    with pytest.raises(TypeError, match="`fit` must be a fit of `calibrate`, but is a Posterior"):
        erosion.check(result)


def test_the_same_seed_gives_the_same_draws(result):
    again, other = (posterior("k", "psi", p=SI.replace(k=3.0), data=measured(12), seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(again.run.points, result.run.points)
    assert other.means["k"] != result.means["k"]
    assert other.means["k"] == pytest.approx(result.means["k"], abs=0.4 * result.deviations["k"])


def test_damaged_draws_are_refused_by_file_and_parameter(result, tmp_path):
    path = result.save(tmp_path / "draws.nc")
    with xr.open_dataset(path, group="posterior") as stored:
        draws = stored.load()
    for value in (np.nan, np.inf):
        draws["psi"].values[0, 3] = value
        draws.to_netcdf(tmp_path / "bad.nc", group="posterior", engine="h5netcdf")
        with pytest.raises(ValueError, match=r"bad\.nc: must have finite draws of psi, one or more, but has not\.$"):
            read_draws(tmp_path / "bad.nc", QUANTITIES)
    content = bytearray(path.read_bytes())
    content[content.index(np.ascontiguousarray(result.samples["psi"].values)[0, :4].tobytes()) + 6] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"draws\.nc: must hold the draws of a posterior"):
        read_draws(path, QUANTITIES)


def test_a_file_has_arvizs_layout(result, tmp_path):
    data = result.data
    with xr.open_datatree(result.save(tmp_path / "draws.nc")) as tree:
        np.testing.assert_array_equal(tree["posterior"]["psi"], result.samples["psi"])
        np.testing.assert_array_equal(tree["observed_data"]["erosion"], data.erosion)
        np.testing.assert_array_equal(tree["constant_data"]["alpha"], data.angle)
        assert tree["posterior"].attrs["log_evidence"] == pytest.approx(result.log_evidence)
        assert tree["observed_data"]["erosion"].attrs["units"] == "m^3"
        squares = ((data.erosion - result.of_model.draw(data.angle, count=800)) / data.uncertainty) ** 2
        logs = -0.5 * squares.sum(axis=1) - np.log(data.uncertainty * np.sqrt(2 * np.pi)).sum()
        np.testing.assert_allclose(np.ravel(tree["sample_stats"]["log_likelihood"]), logs, rtol=1e-9)
    with pytest.raises(ValueError, match=r"must end in \.nc"):
        result.save(tmp_path / "draws.csv")


def test_a_file_keeps_what_was_known_before_the_tests(tmp_path):
    options = {"bounds": {"k": (1.0, 5.0)}, "priors": {"psi": stats.uniform(1.0, 99.0)}}
    free = posterior("k", "psi", draws=125, discrepancy=False, **options)
    kept = read_draws(free.save(tmp_path / "draws.nc"), QUANTITIES).typed
    assert options_in_words(kept) == [
        "--prior", "k=loguniform(1, 5)", "--prior", "psi=uniform(1, 100)", "--discrepancy", "none",
    ]  # fmt: skip


def erosion_at(model, p, alpha):
    return erosion.impact(model, p.replace(alpha=alpha)).volume


def test_curves_and_best_angles_are_those_of_the_draws(result):
    angles = np.deg2rad([[10.0, 30.0]])
    curves = result.of_model.draw(angles, count=50)
    assert curves.shape == (50, 1, 2)
    model, p = result.cases(50)
    np.testing.assert_allclose(curves[:, 0, 1], erosion_at(model, p, angles[0, 1]), rtol=1e-5)
    noisy = result.of_model.draw(angles, count=800, noise=True)
    noisy = noisy - result.of_model.draw(angles, count=800)
    assert noisy.std() == pytest.approx(result.data.uncertainty[0], rel=0.1)
    twice = result.of_model.draw(angles, {"v0": 2 * float(SI.v0)}, count=50)
    np.testing.assert_allclose(twice, 4 * curves, rtol=1e-5)
    best = result.alpha_max(100, discrepancy=False)
    np.testing.assert_allclose(best.to_dict()["alpha"], np.arctan(result.some(100)["k"]) / 2, rtol=1e-6)
    assert best.kinds == {"interior": 1.0}
    assert "interior" in str(best)


def test_scipys_laws_are_priors():
    drawn = posterior("psi", priors={"psi": stats.gamma(4, scale=0.01)}, draws=125)
    assert drawn.prior_in_words("psi") == "gamma(a=4, scale=0.01)"
    assert drawn.means["psi"] == pytest.approx(0.04, rel=0.05)


def test_a_scale_and_a_noise_are_sampled_where_data_leave_them_open():
    data = measured(10, known=False)
    data["erosion [-]"] = data.pop("volume [m^3/impact]") * 1e7
    drawn = posterior("k", data=data)
    assert drawn.names == ("k", "scale", "noise", "relative_noise")
    assert drawn.means["scale"] == pytest.approx(1e7, rel=0.1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"priors": {"k": stats.uniform(1, 2)}},
            "`priors` must name free parameters \\(psi, error_factor\\), but has 'k'",
        ),
        ({"priors": {"psi": 0.04}}, "Argument `priors` of `psi` must be a law such as"),
        ({"priors": {"psi": stats.norm(0.0, 0.1)}}, "Argument `priors` of `psi` must be positive, but 50.0% of normal"),
        ({"priors": {"psi": stats.multivariate_normal([0, 0])}}, "`psi` must be a law"),
        ({"draws": 10}, "`draws` must be a whole number of at least 125, but is 10"),
        ({"seed": -1}, "`seed` must be a whole number of at least 0"),
        ({"cutting_fraction": 2.0}, "`cutting_fraction` must be above 0 and at most 1"),
        ({"data": {"angle [deg]": [10, 20], "volume [in^3/impact]": [0, 0]}}, "must have erosion other than zero"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        posterior("psi", **options)


@pytest.mark.parametrize(
    ("name", "law", "message"),
    [
        ("k", stats.uniform(1, 2), "must name free parameters"),
        ("psi", stats.norm(0.0, 0.1), "of `psi` must be positive"),
        ("noise", stats.norm(0.0, 0.1), "must name free parameters"),
        ("error_factor", stats.norm(0.0, 0.1), "of `error_factor` must be positive"),
    ],
)
def test_a_problem_refuses_priors_that_no_posterior_takes(name, law, message):
    with pytest.raises(ValueError, match=message):
        FitProblem("linearized", SI, measured(8), ["psi"], priors={name: law})


def test_rows_of_the_same_conditions_count_each():
    """They are one impact; the squares are those of all rows."""
    random = np.random.default_rng(3)
    degrees, error = random.choice([20.0, 35.0, 60.0], 40), random.uniform(1.6e-11, 8e-11, 40)
    data = {"angle [deg]": degrees, "volume [m^3/impact]": volumes(degrees) + error * random.standard_normal(40)}
    problem = FitProblem("linearized", SI, {**data, "uncertainty [m^3]": error}, ["k", "psi"])
    likelihood, points = make_likelihood(problem), random.standard_normal((7, 2))
    predicted = problem.erosion(likelihood.values(points), problem.data.conditions)
    direct = np.sum(((predicted - problem.data.erosion) / error) ** 2, axis=1)
    assert likelihood.sizes == [40]
    assert len(likelihood.parts[0].mean) == 3
    assert likelihood.squares(points, 0)[0] == pytest.approx(direct, rel=1e-5)


def test_a_default_prior_reaches_what_the_amounts_ask_for():
    """Weighings of a whole jet are often far below the cuts of the case: ψ is then hundreds of times the case's."""
    data = measured(8)
    data |= {name: data[name] / 300 for name in ("volume [m^3/impact]", "uncertainty [m^3]")}
    drawn = posterior("k", "psi", data=data)
    assert drawn.means["psi"] == pytest.approx(300 * SI.psi, rel=0.1)
    assert not any(finding.about == "psi" for finding in drawn.findings)
