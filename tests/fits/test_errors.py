"""Errors as laboratories have them: read, given as a column or by option, nearest to a column, drawn anew."""

import numpy as np
import pytest
from scipy import stats

from erosion.distributions import Uniform
from erosion.fits import ErrorModel, MeasurementError, calibrate, read_measurements
from erosion.fits.errors import errors_at
from erosion.fits.forward import make_forward
from erosion.fits.likelihood import make_likelihood
from erosion.impacts.impact import impact
from erosion.parameters.parameters import TABLE_1
from erosion.parameters.quantities import UnitError


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("0.3 mg/kg + 8 %", (3e-7, 0.08)),
        ("8%+3e-1 mg/kg", (3e-7, 0.08)),
        ("5 percent", (0.0, 0.05)),
        ("3e+1 ug/kg", (3e-8, 0.0)),
    ],
)
def test_a_text_has_one_or_two_parts(text, parts):
    error = ErrorModel.read(text, "mass per mass", "si")
    np.testing.assert_allclose([error.absolute, error.relative], parts, rtol=1e-12)
    np.testing.assert_allclose(error.deviation(np.array([0.0, 1e-4])), np.hypot(parts[0], [0, parts[1] * 1e-4]))
    again = ErrorModel.read(error.in_words("mass per mass", "si"), "mass per mass", "si")
    assert (again.absolute, again.relative) == pytest.approx(parts)


@pytest.mark.parametrize("text", ["", "8", "-8 %", "8 % + 3 %", "0.3 mg", "0 %", "nan %", "mg/kg + 8 %"])
def test_other_texts_are_refused(text):
    with pytest.raises(UnitError, match="must be"):
        ErrorModel.read(text, "mass per mass", "si")


HEAD, ROWS = "angle [deg], mass_loss [mg/kg]", ("20, 99", "20, 101", "60, 40")


def test_the_relative_part_is_of_the_mean_of_repeats(table):
    measured = read_measurements(table("\n".join((HEAD, *ROWS))), "si", error="3 mg/kg + 4 %")
    assert measured.uncertainty == pytest.approx([5e-6, 5e-6, np.hypot(3, 1.6) * 1e-6])
    assert measured.error == ErrorModel(3e-6, 0.04)
    with pytest.raises(MeasurementError, match="`error`"):
        measured.with_error(1e-6)
    with pytest.raises(MeasurementError, match="absolute part"):
        read_measurements(table(HEAD + "\n20, 99\n60, 0\n"), "si", error="8 %")


def test_a_column_of_percents_is_one_of_shares(table):
    text = "\n".join((HEAD + ", uncertainty [%]", "20, 100, 8", "60, 50, 4"))
    measured = read_measurements(table(text), "si")
    assert measured.uncertainty == pytest.approx([8e-6, 2e-6])
    with pytest.raises(MeasurementError, match="line 3"):
        read_measurements(table(text.replace("60, 50", "60, 0")), "si")


@pytest.mark.parametrize("error", [ErrorModel(3e-7, 0.08), ErrorModel(2e-7), ErrorModel(0.0, 0.05)])
def test_the_parts_of_a_column_are_found(error):
    erosion = np.geomspace(1e-7, 1e-4, 20)
    found = ErrorModel.nearest(erosion, error.deviation(erosion))
    np.testing.assert_allclose([found.absolute, found.relative], [error.absolute, error.relative], atol=1e-12)


DEGREES = np.array([10.0, 10.0, 20.0, 40.0, 60.0, 75.0])
TRUE = impact("linearized", TABLE_1.replace(alpha=np.deg2rad(DEGREES))).volume
SHARES = 1 + 0.2 * np.array([1.5, -0.5, -1.2, 0.3, 1.0, -1.6])
"""Measured over true erosion; with ψ free alone, the fit with relative errors is the mean of them."""


@pytest.mark.parametrize("column", [True, False])
def test_a_relative_error_is_of_the_fit(column):
    """Of the measured erosion, the fit would be low by 2 b²: 9 % here."""
    columns = {"angle [deg]": DEGREES, "volume [in^3]": TRUE * SHARES}
    more = {"uncertainty [%]": np.full(6, 20.0)} if column else {}
    fit = calibrate("linearized", TABLE_1, columns | more, ["psi"], error=None if column else ErrorModel(0.0, 0.2))
    assert fit.estimates["psi"] == pytest.approx(TABLE_1.psi / SHARES.mean(), rel=1e-5)
    assert fit.chi2 == pytest.approx(np.sum((SHARES / SHARES.mean() - 1) ** 2) / 0.2**2, rel=1e-4)
    deviance = (
        fit.chi2 + 12 * np.log(SHARES.mean()) - 2 * np.log(np.prod(np.append(SHARES[2:], [SHARES[:2].mean()] * 2)))
    )
    assert fit.aicc == pytest.approx(deviance + 2 + 4 / 4, rel=1e-3)


@pytest.mark.parametrize("factor", [None, 1.7])
def test_the_likelihood_has_the_error_of_what_is_expected(factor):
    error = ErrorModel(2e-6, 0.1)
    columns = {"angle [deg]": DEGREES, "volume [in^3]": TRUE * SHARES}
    forward = make_forward("linearized", TABLE_1, columns, ["psi"], None, 1.0, error)
    likelihood = make_likelihood(forward, {} if factor is None else {"error_factor": Uniform(1.0, 2.0)})
    points = np.array([[0.02, 0.524][: 1 if factor is None else 2]])
    values = likelihood.values(points)
    expected = TRUE * float(TABLE_1.psi / values["psi"][0])
    squares, variance = likelihood.squares(points, 0)
    log = likelihood.constant - 0.5 * (squares / variance + 6 * np.log(variance))
    deviation = error.deviation(expected) * values.get("error_factor", np.ones(1))
    assert log[0] == pytest.approx(stats.norm.logpdf(TRUE * SHARES, expected, deviation).sum(), rel=1e-6)
    assert likelihood.chi2(points)[0] == pytest.approx(np.sum(((TRUE * SHARES - expected) / deviation) ** 2), rel=1e-5)


def test_a_model_without_erosion_at_a_row_has_an_error_there():
    parts = np.array([[0.0, 0.1], [3e-6, 0.1]])
    np.testing.assert_allclose(errors_at(parts, np.zeros(2), np.full(2, 8e-5)), [4e-6, 5e-6])


@pytest.mark.parametrize("known", [True, False])
def test_repeats_show_what_a_model_misses(known):
    """The ratio is that of the analysis of variance, typed once more."""
    degrees, random = np.repeat([10.0, 20.0, 40.0, 60.0, 80.0], 3), np.random.default_rng(5)
    volume = 1e-4 * np.sin(np.deg2rad(degrees)) + 2e-6 * random.standard_normal(15)
    data = {"angle [deg]": degrees, "volume [in^3]": volume}
    fit = calibrate("linearized", TABLE_1, data, ["k", "psi"], error=1e-6 if known else None)
    means = volume.reshape(5, 3).mean(axis=1)
    pure = np.sum((volume.reshape(5, 3) - means[:, None]) ** 2) / 10
    misses = 3 * np.sum((means - fit.fitted.reshape(5, 3)[:, 0]) ** 2) / 3
    lack = fit.lack_of_fit
    assert lack is not None
    assert lack.ratio == pytest.approx(misses / pure, rel=1e-9)
    assert lack.probability < 1e-3
    assert lack.scatter == pytest.approx(np.sqrt(pure) / (1e-6 if known else 1.0))
    assert "lack_of_fit" in str(fit)
    assert calibrate("linearized", TABLE_1, {n: v[::3] for n, v in data.items()}, ["psi"]).lack_of_fit is None


def test_a_part_that_matters_in_no_row_is_none():
    erosion = np.array([10e-6, 40e-6, 90e-6, 120e-6])
    assert ErrorModel.nearest(erosion, np.full(4, 0.2e-6) * (1 + 1e-12 * np.arange(4))).relative == 0
    assert ErrorModel.nearest(erosion, 0.08 * erosion).absolute == 0
