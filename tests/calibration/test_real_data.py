"""Fits to data as laboratories have it: mg/kg, several speeds, few rows, particles that do not all cut."""

import numpy as np
import pytest

import erosion
from erosion.calibration import calibrate
from erosion.calibration.forward import Forward
from erosion.models.closed_forms import LinearizedCut
from erosion.parameters.parameters import TABLE_1

pytestmark = pytest.mark.slow

# Grains of sand of 0.3 mm, of density 2650 kg/m³; the target's flow stress is that of steel at high strain rates.
SAND = erosion.Parameters(
    k=2.0, psi=2.0, r=0.15e-3, b=0.3e-3, m=2650 * np.pi / 6 * 0.3e-3**3, v0=60.0, sigma=1.5e9, alpha=0.35,
    inertia=0.4, units="si",
)  # fmt: skip
DENSITY = 7850.0
DEGREES = np.array([10, 15, 20, 25, 30, 35, 40, 45, 50, 60, 70, 80.0])
SPEEDS = (30.0, 60.0)
FRACTION = 0.3


def measured(noise: float = 0.03, p: erosion.Parameters = SAND, power: float = 0.0) -> dict[str, np.ndarray]:
    """Mass loss in mg/kg at two speeds, with errors of 3 % of the greatest at each speed.

    Args:
        noise: standard deviation over that greatest.
        p: the truth.
        power: of the speed, by which erosion grows more than the model says.
    """
    rng = np.random.default_rng(7)
    columns: dict[str, list[np.ndarray]] = {"angle [deg]": [], "speed [m/s]": [], "mass_loss [mg/kg]": [],
                                            "uncertainty [mg/kg]": []}  # fmt: skip
    for speed in SPEEDS:
        volume = LinearizedCut().volume(p.replace(alpha=np.deg2rad(DEGREES), v0=speed))
        loss = FRACTION * np.asarray(volume) * DENSITY / float(p.m) * 1e6 * (speed / SPEEDS[0]) ** power
        error = np.full(DEGREES.size, 0.03 * loss.max())
        row = (
            DEGREES,
            np.full(DEGREES.size, speed),
            loss + noise / 0.03 * error * rng.standard_normal(DEGREES.size),
            error,
        )
        for values, column in zip(row, columns.values(), strict=True):
            column.append(values)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def test_the_first_guess_comes_from_the_size_of_the_data():
    # Table 1 removes 300 times as much from a particle's mass as this data has.
    fit = calibrate("linearized", TABLE_1, measured(0.0), ["k", "psi"], density="7850 kg/m^3", starts=1)
    assert fit.statements == ()
    assert fit.chi2 < 1e-6
    product = SAND.sigma * SAND.psi / FRACTION
    assert float(fit.p.to("si").sigma) * fit.estimates["psi"] == pytest.approx(float(product), rel=1e-5)


def test_a_guess_stays_within_given_bounds():
    bounds = {"psi": (0.01, 0.3)}
    fit = calibrate("linearized", TABLE_1, measured(), ["k", "psi"], density="7850 kg/m^3", starts=1, bounds=bounds)
    assert fit.estimates["psi"] == pytest.approx(0.3)


def test_the_share_of_particles_that_cut_is_found():
    fit = calibrate("linearized", SAND, measured(), ["k", "cutting_fraction"], density=DENSITY)
    assert fit.cutting_fraction == fit.estimates["cutting_fraction"]
    for name, truth in (("k", 2.0), ("cutting_fraction", FRACTION)):
        assert abs(fit.estimates[name] - truth) < 3 * fit.standard_errors[name] < 0.2 * truth
    assert [row.symbol for row in fit.rows()[:2]] == ["k", "c"]
    given = calibrate("linearized", SAND, measured(), ["k", "psi"], density=DENSITY, cutting_fraction=0.6)
    assert given.estimates["psi"] == pytest.approx(2.0 * 0.6 / fit.cutting_fraction, rel=1e-4)
    np.testing.assert_allclose(given.fitted, fit.fitted, rtol=1e-4)
    assert (given.cutting_fraction, given.to_dict()["cutting_fraction"]) == (0.6, 0.6)


def test_no_more_than_all_particles_cut():
    fit = calibrate("linearized", SAND.replace(sigma=1.5e10), measured(), ["k", "cutting_fraction"], density=DENSITY)
    assert fit.cutting_fraction == pytest.approx(1.0)
    for share in (0.0, 1.5):
        with pytest.raises(ValueError, match="`cutting_fraction` must be above 0 and at most 1, but is"):
            calibrate("linearized", SAND, measured(), ["k"], density=DENSITY, cutting_fraction=share)
    with pytest.raises(ValueError, match="`bounds` must give cutting_fraction two ascending values in its range"):
        calibrate("linearized", SAND, measured(), ["cutting_fraction"], density=DENSITY,
                  bounds={"cutting_fraction": (0.1, 2.0)})  # fmt: skip


def test_derivatives_by_the_cutting_fraction():
    data = erosion.read_measurements(measured(), "si")
    for free in (("k", "cutting_fraction", "m"), ("cutting_fraction",)):
        forward = Forward(erosion.load_model("linearized"), SAND.replace(k=1.9), free, data, DENSITY, 0.4)
        theta, step = forward.start, 1e-4
        rates = forward.predict(theta, data.conditions)[1]
        for i in range(len(free)):
            up, down = (
                forward.predict(theta + sign * step * np.eye(len(free))[i], data.conditions)[0] for sign in (1, -1)
            )
            # Differences err by step²/6 of the third derivative.
            assert (up - down) / (2 * step) == pytest.approx(rates[:, i], rel=1e-6, abs=1e-8 * np.abs(rates).max())


def test_as_many_rows_as_parameters_are_too_few():
    data = {name: values[[2, 5]] for name, values in measured().items()}
    message = "must have at least 3 rows for 2 free parameters, as no degree of freedom is left otherwise, but has 2"
    with pytest.raises(ValueError, match=message):
        calibrate("linearized", SAND, data, ["k", "psi"], density=DENSITY)
