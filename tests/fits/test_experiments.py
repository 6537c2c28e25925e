"""The next experiment: information in closed form, beside a jump, and between models."""

import numpy as np
import pytest

from erosion import TABLE_1, calibrate, impact, next_experiment, posterior, rank_posteriors
from erosion.distributions import Normal, Uniform
from erosion.fits.experiments import NextExperiment, _gains
from erosion.models.rigid import LinearizedCut
from tests.fits.simulated_experiments import compared


def gains(*predicted: np.ndarray, weights=(1.0,), noise: float = 1.0) -> tuple[float, float]:
    return _gains([(of, np.full(len(of), noise)) for of in predicted], np.array(weights))


@pytest.mark.parametrize("ratio", [0.3, 1.0, 10.0])
def test_the_information_of_a_normal_prediction_is_shannons(ratio):
    # log₂ √(1 + (deviation/noise)²), of 200 000 draws.
    information, discrimination = gains(ratio * np.random.default_rng(0).standard_normal(200_000))
    assert information == pytest.approx(0.5 * np.log2(1 + ratio**2), abs=0.005)
    assert discrimination == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("apart", "weights", "bits"),
    [(100.0, (0.5, 0.5), 1.0), (100.0, (0.9, 0.1), -0.9 * np.log2(0.9) - 0.1 * np.log2(0.1)), (0.0, (0.5, 0.5), 0.0)],
)
def test_models_that_predict_far_apart_are_told_apart_by_one_row(apart, weights, bits):
    information, discrimination = gains(np.zeros(100), np.full(100, apart), weights=weights)
    assert information == pytest.approx(0, abs=1e-3)
    assert discrimination == pytest.approx(bits, abs=1e-3)


def test_noises_that_differ_from_draw_to_draw_are_a_mixture():
    noise, x = np.tile([1.0, 3.0], 2000), np.linspace(-30, 30, 200_001)
    density = sum(np.exp(-0.5 * (x / s) ** 2) / s for s in (1.0, 3.0)) / (2 * np.sqrt(2 * np.pi))
    entropy = -np.trapezoid(density * np.log2(np.maximum(density, 1e-300)), x)
    error = np.mean(0.5 * np.log2(2 * np.pi * np.e * noise**2))
    information, _ = _gains([(np.zeros(4000), noise)], np.ones(1))
    assert information == pytest.approx(entropy - error, abs=0.01)


@pytest.mark.parametrize("spread", [1e3, 1e5, 1e12, 1e300])
def test_predictions_any_number_of_errors_apart_say_which_draw_is_right(spread):
    # 64 draws that one row tells apart are six bits, however far apart they are.
    apart = spread * np.arange(64.0)
    assert gains(apart)[0] == pytest.approx(6, abs=0.01)
    assert gains(apart, apart + spread / 2, weights=(0.5, 0.5))[1] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("size", [1e-300, 1e-30, 1e200, 1e300])
def test_the_information_does_not_depend_on_the_unit(size):
    predicted = np.random.default_rng(3).normal(0, 5, 64)
    assert gains(size * predicted, noise=size) == pytest.approx(gains(predicted), rel=1e-9)


def test_a_candidate_without_a_prediction_is_not_the_best():
    nothing, something = np.array([np.nan, 0.5]), np.array([np.nan, 0.25])
    candidates = {"alpha": np.array([0.1, 0.2])}
    answer = NextExperiment(candidates, nothing, something, np.ones(2), ("linearized", "rotating"), "si", 9)
    assert answer.best == answer.best_to_discriminate == {"alpha": 0.2}


def measured(model, degrees, k, share=0.05):
    exact = impact(model, TABLE_1.replace(alpha=np.deg2rad(degrees), k=k)).volume
    error = share * exact.max()
    noisy = exact + error * np.random.default_rng(2).standard_normal(len(degrees))
    return {"angle [deg]": degrees, "volume [in^3]": noisy, "uncertainty [in^3]": np.full(len(degrees), error)}


def test_a_scale_is_best_measured_at_the_greatest_volume():
    # Of one factor the information is a function of the volume at the angle alone.
    data = measured("linearized", np.array([10.0, 60.0]), 2.0)
    priors = {"cutting_fraction": Normal(0.5, 0.1)}
    drawn = posterior("linearized", TABLE_1, data, ["cutting_fraction"], priors=priors, draws=250)
    degrees = np.array([5.0, 20.0, 31.7, 45.0, 80.0])
    answer = next_experiment(drawn, {"alpha": np.deg2rad(degrees)}, discrepancy=False)
    exact = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(degrees))))
    assert answer.best["alpha"] == pytest.approx(np.deg2rad(31.7))
    spread = drawn.deviations["cutting_fraction"] * exact / data["uncertainty [in^3]"][0]
    np.testing.assert_allclose(answer.information, 0.5 * np.log2(1 + spread**2), rtol=0.05, atol=2e-4)
    assert answer.to_dict()["best"] == answer.best
    assert "about the parameters [bit]" in str(answer)


def test_a_jump_whose_place_is_not_known_is_the_place_to_measure():
    # With k = 1 V(α) falls to half at 40°; the data leave 30° to 50° open.
    data = measured("rotating", np.array([10.0, 20.0, 30.0, 50.0, 60.0]), 1.0)
    drawn = posterior("rotating", TABLE_1.replace(k=1.0), data, ["k", "psi"], draws=250)
    answer = next_experiment(drawn)
    assert 35 < np.rad2deg(answer.best["alpha"]) < 45
    assert answer.information.max() > 2 * np.median(answer.information)
    # Twice the speed has four times the volume, and the errors stay.
    twice = next_experiment(drawn, {"alpha": np.deg2rad([[40.0], [20.0]]), "v0": [4400.0, 8800.0]})
    assert twice.information.shape == (4,)
    assert twice.information[3] > twice.information[2]


def test_two_models_are_told_apart_where_they_differ():
    data = measured("linearized", np.array([10.0, 15.0, 20.0, 25.0]), 2.0)
    priors = {"k": Uniform(0.5, 10.0), "psi": Uniform(0.001, 0.2)}
    both = rank_posteriors(TABLE_1, data, ["k", "psi"], models=["linearized", "tan-alpha"], priors=priors, draws=250)
    answer = next_experiment(both)
    assert answer.names == both.names
    assert answer.discrimination.max() <= -(both.weights @ np.log2(both.weights)) + 1e-6
    assert answer.headings[-2:] == ("about the model [bit]", "together [bit]")
    assert [float(row[-1]) for row in answer.rows()] == sorted((float(row[-1]) for row in answer.rows()), reverse=True)
    where = answer.best_to_discriminate["alpha"]
    assert answer.discrimination.max() == answer.discrimination[answer.candidates["alpha"] == where]


@pytest.fixture(scope="module")
def drawn():
    return posterior("linearized", TABLE_1, measured("linearized", np.array([10.0, 60.0]), 2.0), ["psi"], draws=125)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"candidates": {"v0": [1.0]}}, "must give angles"),
        ({"noise": 0.0}, "`noise` must be positive"),
    ],
)
def test_what_makes_no_sense_is_refused(drawn, options, message):
    with pytest.raises(ValueError, match=message):
        next_experiment(drawn, **options)


@pytest.mark.parametrize(
    ("alpha", "at", "message"),
    [
        ([], {}, "`alpha` must hold at least one angle"),
        (np.zeros((0, 3)), {"v0": 1.0}, "`alpha` must hold at least one angle"),
        (["20 deg"], {}, "`alpha` must hold real numbers"),
        ([[0.1], [0.2, 0.3]], {}, "`alpha` must hold real numbers"),
        (0.3 + 1j, {}, "`alpha` must be a number"),
        (None, {}, "`alpha` must be a number"),
        (np.nan, {}, "`alpha` must be in"),
        (np.ma.masked_array([0.3, 0.4], [True, False]), {}, "must have no masked values"),
        ([0.1, 2.0], {}, r"`alpha` must be in \(0, 90°\]"),
        ([0.1], {"psi": 0.1}, "parameters of the case that are known, but has 'psi'"),
        ([0.1], {"speed": 0.1}, "parameters of the case that are known, but has 'speed'"),
        ([0.1], {"v0": -1.0}, "`v0` must be positive and finite"),
        ([0.1], {"v0": "60 m/s"}, "`v0` must be a number"),
        ([0.1, 0.2], {"v0": [1.0, 2.0, 3.0]}, "must broadcast"),
    ],
)
def test_a_condition_that_makes_no_sense_is_refused_wherever_it_is_asked_for(drawn, alpha, at, message):
    """A sampled parameter among the conditions would take the place of its draws, without a word."""
    fit = calibrate("linearized", TABLE_1, drawn.data, ["psi"])
    for ask in (
        lambda: next_experiment(drawn, {"alpha": alpha, **at}),
        lambda: drawn.predict(alpha, at),
        lambda: drawn.ends(alpha, at),
        lambda: fit.predict(alpha, at),
        lambda: fit.curve(alpha, at),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            ask()


def test_conditions_broadcast_with_angles(drawn):
    both = drawn.predict([[0.3], [0.5]], {"v0": [3000.0, 4000.0]}, 5)
    assert both.shape == (5, 2, 2)
    alone = drawn.predict(0.5, {"v0": 3000.0}, 5, discrepancy=False)
    np.testing.assert_array_equal(
        drawn.predict([[0.3], [0.5]], {"v0": [3000.0, 4000.0]}, 5, discrepancy=False)[:, 1, 0], alone
    )


def test_what_a_model_may_lack_counts_as_in_simulated_experiments():
    answer, gains = compared(10)
    error = gains.std(axis=0, ddof=1) / np.sqrt(len(gains))
    assert (np.abs(answer.total - gains.mean(axis=0)) < 0.03 + 3.5 * error).all()
