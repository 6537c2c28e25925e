"""Errors as laboratories have them: read, given as a column or by option, nearest to a column, drawn anew."""

import numpy as np
import pytest

from erosion.fits import ErrorModel, MeasurementError, calibrate, read_measurements
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


def test_a_fit_weighs_rows_by_the_error():
    degrees = np.array([10.0, 20.0, 40.0, 60.0, 75.0])
    columns = {"angle [deg]": degrees, "volume [in^3]": [6e-5, 9e-5, 5e-5, 3e-5, 1e-5]}
    error = ErrorModel(1e-6, 0.1)
    by_option = calibrate("linearized", TABLE_1, columns, ["k", "psi"], error=error)
    uncertainty = error.deviation(np.array(columns["volume [in^3]"]))
    by_column = calibrate("linearized", TABLE_1, {**columns, "uncertainty [in^3]": uncertainty}, ["k", "psi"])
    assert by_option.estimates == pytest.approx(by_column.estimates, rel=1e-12)
    assert by_option.chi2 == pytest.approx(by_column.chi2, rel=1e-12)


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
