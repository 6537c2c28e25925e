"""Rows far from a fit: found by a closed form, named with their line, and what the fit is without them."""

import numpy as np
import pytest

import erosion
from erosion.fits.outliers import chances, studentized

P = erosion.TABLE_1.to("si")
ANGLES = np.array([10, 15, 20, 25, 30, 40, 50, 60, 75, 90.0])
WRONG = 3


@pytest.fixture
def fit_of(table):
    """The fit of finnie to its own curve with noise of 1 %; rows of a wrong weighing are given."""
    exact = erosion.impact("finnie", P.replace(alpha=np.deg2rad(ANGLES))).volume * 1e9
    noisy = exact * (1 + 0.01 * np.random.default_rng(0).standard_normal(len(ANGLES)))

    def fit(factor=1.0, **options):
        rows = noisy * np.where(np.arange(len(ANGLES)) == WRONG, factor, 1.0)
        lines = "".join(f"{angle},{value!r}\n" for angle, value in zip(ANGLES, rows.tolist(), strict=True))
        return erosion.calibrate(
            "finnie", P, table("angle [deg],volume [mm^3]\n" + lines), ["psi"], starts=2, **options
        )

    return fit


def test_studentized_residuals_are_those_of_a_fit_without_the_row():
    rng = np.random.default_rng(0)
    design, rows = rng.standard_normal((12, 3)), rng.standard_normal(12)
    hat = design @ np.linalg.pinv(design)
    for i, value in enumerate(studentized(rows - hat @ rows, np.diag(hat), 12 - 3)[0]):
        others = np.arange(12) != i
        theta, squares = np.linalg.lstsq(design[others], rows[others])[:2]
        gram = np.linalg.inv(design[others].T @ design[others])
        error = np.sqrt(squares[0] / 8 * (1 + design[i] @ gram @ design[i]))
        assert value == pytest.approx((rows[i] - design[i] @ theta) / error, rel=1e-9)


@pytest.mark.parametrize("relative", [0.0, 0.08, 0.2])
def test_unknown_errors_of_any_shape_seldom_make_an_outlier(relative):
    """Of 100 sets one has a chance below 1 %; the parts of the error, which are fitted, make it a few more."""
    rng, turn = np.random.default_rng(0), np.deg2rad(np.tile(np.repeat(np.linspace(15, 90, 7), 2), 2))
    design = np.stack([np.sin(2 * turn), np.sin(turn) ** 2, np.sin(2 * turn) ** 2]).T * np.repeat(
        [[0.36], [1.0]], 14, 0
    )
    mean, alarms = design @ [1.0, 0.5, 1.0], 0
    for _ in range(100):
        rows = mean + np.hypot(0.02, relative * mean) * rng.standard_normal(28)
        fitted = design @ np.linalg.lstsq(design, rows)[0]
        alarms += 28 * chances(rows - fitted, design, fitted, 25).min() < 0.01
    assert alarms <= 5


def test_a_sampled_error_does_not_hide_an_outlier(table):
    """It is 10 relative errors off, but makes them three times as large; its repeat is no outlier."""
    degrees, rng = np.repeat([10, 20, 30, 45, 60, 75], 2), np.random.default_rng(1)
    exact = erosion.impact("finnie", P.replace(alpha=np.deg2rad(degrees))).volume * 1e9
    rows = exact * (1 + 0.05 * rng.standard_normal(12))
    rows[6] *= 1.5
    lines = "".join(f"{angle},{value!r}\n" for angle, value in zip(degrees, rows.tolist(), strict=True))
    data = table("angle [deg],volume [mm^3]\n" + lines)
    drawn = erosion.posterior("finnie", P, data, ["psi"], draws=125, discrepancy=False)
    (said,) = (sentence for sentence in drawn.predictor.warnings if "miss" in sentence)
    assert "1 of 12 rows" in said
    assert "line 8 (45°)" in said


def test_an_outlier_is_named_with_the_fit_without_it(fit_of):
    clean, spoiled = fit_of(), fit_of(2.0)
    assert not any("outlier" in sentence for sentence in clean.warnings)
    (said,) = (sentence for sentence in spoiled.warnings if "outlier" in sentence)
    assert f"line {WRONG + 2} (25°)" in said
    without = erosion.calibrate("finnie", P, spoiled.data.of_rows(np.delete(np.arange(10), WRONG)), ["psi"], starts=2)
    assert without.in_words("psi", without.estimates["psi"]) in said
    assert without.estimates["psi"] == pytest.approx(P.psi, rel=0.02)


@pytest.mark.parametrize(("error", "named"), [(None, True), ("0.01 mm^3 + 5 %", True), ("0.01 mm^3 + 20 %", False)])
def test_a_row_within_its_stated_error_is_no_outlier(fit_of, error, named):
    assert any("outlier" in sentence for sentence in fit_of(1.3, error=error).warnings) == named


def test_a_robust_loss_says_which_rows_it_weighs_down(fit_of):
    (said,) = (sentence for sentence in fit_of(2.0, loss="soft_l1").warnings if "weighs down" in sentence)
    assert f"soft_l1 weighs down line {WRONG + 2} (25°)" in said
