"""Models whose volumes grow as v₀ⁿ: the cut and the deformation of another, times (v₀/100 m/s)^(n - 2)."""

import pickle

import numpy as np
import pytest

import erosion
from erosion.models import Rotating, load_model, model_name, model_source
from erosion.models.rigid import SpeedExponent
from erosion.results import Finding

P = erosion.TABLE_1.to("si")
DEGREES, SPEEDS = (part.ravel() for part in np.meshgrid([10, 20, 30, 45, 60, 80], [60.0, 98.0]))


@pytest.mark.parametrize("name", ["finnie", "rotating-deformation"])
def test_volumes_and_derivatives_are_those_of_the_model_times_a_power(name):
    p = P.replace(alpha=np.array([0.2, 0.5, 1.2]), v0=P.v0 * np.array([0.5, 1.0, 2.0]))
    model, wrt = load_model(f"{name}-exponent").replace(speed_exponent=2.6), ("alpha", "v0")
    hits = erosion.impact(model, p, derivatives=1, wrt=(*wrt, "speed_exponent"), rtol=1e-11)
    alone = erosion.impact(name, p, derivatives=1, wrt=wrt, rtol=1e-11)
    speed = p.v0 / 100
    np.testing.assert_allclose(hits.volume, alone.volume * speed**0.6, rtol=1e-14)
    slopes = alone.dvolume + np.stack([np.zeros(3), alone.volume * 0.6 / p.v0], axis=1)
    np.testing.assert_allclose(hits.dvolume[:, :2], slopes * speed[:, None] ** 0.6, rtol=1e-9)
    np.testing.assert_allclose(hits.dvolume[:, 2], hits.volume * np.log(speed), rtol=1e-9)
    np.testing.assert_allclose(hits.volume_at_contact, alone.volume_at_contact * speed**0.6, rtol=1e-14)
    assert hits.ended_by.tolist() == alone.ended_by.tolist()
    cut = erosion.simulate(model, p.replace(alpha=p.alpha[1], v0=p.v0[1]))
    assert cut.volume == pytest.approx(hits.volume[1], rel=1e-9)


def test_the_best_angle_stays_and_a_negative_exponent_fails():
    model = load_model("rotating-exponent")
    p = P.replace(alpha=0.3)
    assert erosion.alpha_max(model, p).alpha == pytest.approx(erosion.alpha_max("rotating", p).alpha, abs=1e-9)
    with pytest.raises(ValueError, match="`speed_exponent` must be at least 0"):
        model.replace(speed_exponent=-1.0)
    assert erosion.impact(model.replace(speed_exponent=np.array([2.0, -1.0])), p).ended_by[1] == "failed"


def test_names_and_sources():
    model = load_model("rotating-exponent")
    assert model is load_model("rotating-exponent")
    assert model_name(model) == model_source(model) == "rotating-exponent"
    own = SpeedExponent(Rotating(force=erosion.models.TanAlpha()))
    assert model_name(own) == "rotating-tan-alpha-exponent"
    own = type("Sevenfold", (SpeedExponent,), {"factor": lambda self, p: 7.0})(load_model("rotating"))
    assert model_source(own) is None
    for name in ("dnv-exponent", "rotating-exponent-exponent", "-exponent"):
        with pytest.raises(erosion.models.ModelError, match=f"no model '{name}'"):
            load_model(name)


@pytest.fixture(scope="module")
def tests():
    """Weighings of `linearized-deformation` that grow as v₀^2.7, with errors of 3 %."""
    p = P.replace(alpha=np.deg2rad(DEGREES), v0=SPEEDS, psi=0.4, k=2.0)
    truth = load_model("linearized-deformation-exponent").replace(speed_exponent=2.7)
    volume = erosion.impact(truth, p).volume * (1 + 0.03 * np.random.default_rng(4).standard_normal(len(DEGREES)))
    return {
        "angle [deg]": DEGREES,
        "speed [m/s]": SPEEDS,
        "volume [m^3/impact]": volume,
        "uncertainty [m^3]": 0.03 * volume,
    }


def test_the_exponent_is_fitted_and_named_where_a_model_lacks_it(tests):
    free = ["k", "psi", "energy_ratio"]
    fit = erosion.calibrate(erosion.FitProblem("linearized-deformation-exponent", P, tests, [*free, "speed_exponent"]))
    errors = fit.standard_errors["speed_exponent"]
    assert abs(fit.estimates["speed_exponent"] - 2.7) < 3 * errors < 0.2
    assert not fit.findings
    without = erosion.calibrate(erosion.FitProblem("linearized-deformation", P, tests, free))
    assert without.findings[-1] == Finding("model_with_exponent", "linearized-deformation")


def test_an_exponent_that_is_held_is_not_known(tests):
    """At one speed the data say nothing of it."""
    rows = {name: column[SPEEDS == 60.0] for name, column in tests.items()}
    drawn = erosion.posterior(
        erosion.FitProblem("linearized-deformation-exponent", P, rows, ["k", "psi", "energy_ratio"]), draws=125
    )
    assert drawn.predictor.exponent == pytest.approx((2.4, 0.25), abs=0.06)  # in one way of three it is as held
    far = drawn.predictor.draw(np.deg2rad([30]), {"v0": 196.0})
    assert far.std() / far.mean() > 0.3
    hypothesis = drawn.predictor.hypotheses["exponent"]
    near, far = hypothesis.misfit.mean(hypothesis.values, {"alpha": np.full(2, 0.5), "v0": np.array([60.0, 196.0])}).T
    np.testing.assert_allclose(np.log(far / near) / np.log(196 / 60), hypothesis.values["exponent"], rtol=1e-9)
    fit = erosion.calibrate(
        erosion.FitProblem("linearized-deformation-exponent", P, tests, ["k", "psi", "energy_ratio"])
    )
    (free,) = (finding.numbers for finding in fit.findings if finding.code == "free_for_speed")
    assert free == {"parameters": ["threshold", "speed_exponent"]}
    assert pickle.loads(pickle.dumps(drawn)).predictor.weights == drawn.predictor.weights


def test_predictions_have_one_exponent(tests):
    names = ["k", "psi", "energy_ratio", "speed_exponent"]
    drawn = erosion.posterior(erosion.FitProblem("linearized-deformation-exponent", P, tests, names), draws=125)
    assert drawn.prior_in_words("speed_exponent").startswith("normal(2.4, 0.3)")
    assert [*drawn.predictor.hypotheses] == ["model", "discrepancy"]
    assert drawn.predictor.exponent is None
    far = drawn.of_model.draw(np.deg2rad(30), {"v0": [98.0, 196.0]})
    assert np.log2(far[:, 1] / far[:, 0]).mean() == pytest.approx(drawn.means["speed_exponent"], abs=0.02)
