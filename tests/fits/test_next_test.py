"""The next test: what it narrows, in closed form and by the posterior with it, beside a jump, and between models."""

import numpy as np
import pytest
from scipy import stats

from erosion import TABLE_1, FitProblem, calibrate, impact, next_test, posterior, predict, rank
from erosion.fits.next_test import NextTest, _discrimination, _Drawn, _narrowed
from erosion.fits.prediction import Predictor
from erosion.models.rigid import LinearizedCut
from tests.fits import problems

SI = TABLE_1.to("si")


@pytest.mark.parametrize("ratio", [0.3, 1.0, 10.0])
def test_a_normal_row_narrows_its_own_mean_by_its_error(ratio):
    means = ratio * np.random.default_rng(0).standard_normal(100_000)
    narrowed = _narrowed(means, np.ones(100_000), means, np.full(100_000, 1e-5))
    assert narrowed == pytest.approx(1 - 1 / np.sqrt(1 + ratio**2), abs=0.005)
    other = np.random.default_rng(1).standard_normal(100_000)
    assert _narrowed(means, np.ones(100_000), other, np.full(100_000, 1e-5)) == pytest.approx(0, abs=1e-3)


def discrimination(*predicted: np.ndarray, weights=(0.5, 0.5), noise: float = 1.0) -> float:
    return _discrimination([(of, np.full(len(of), noise)) for of in predicted], np.array(weights))


@pytest.mark.parametrize(
    ("apart", "weights", "bits"),
    [(100.0, (0.5, 0.5), 1.0), (100.0, (0.9, 0.1), -0.9 * np.log2(0.9) - 0.1 * np.log2(0.1)), (0.0, (0.5, 0.5), 0.0)],
)
def test_models_that_predict_far_apart_are_told_apart_by_one_row(apart, weights, bits):
    assert discrimination(np.zeros(100), np.full(100, apart), weights=weights) == pytest.approx(bits, abs=1e-3)


@pytest.mark.parametrize("spread", [1e3, 1e5, 1e12, 1e300])
def test_predictions_any_number_of_errors_apart_say_which_model_is_right(spread):
    apart = spread * np.arange(64.0)
    assert discrimination(apart, apart + spread / 2) == pytest.approx(1, abs=0.01)


def test_a_candidate_without_a_prediction_is_not_the_best():
    nothing, something = np.array([np.nan, 0.5]), np.array([np.nan, 0.25])
    candidates = {"alpha": np.array([0.1, 0.2])}
    models = "linearized", "rotating"
    answer = NextTest(candidates, something, nothing, something, np.ones(2), {"alpha": 0.2}, 0.1, models, "si")
    assert answer.best == answer.best_for_parameters == answer.best_to_discriminate == {"alpha": 0.2}
    assert "A test at 11.46° narrows the prediction at 11.46° most, from ±10 % to ±7.5 %." in answer.sentence
    assert "1 of 2 candidates, at 5.73°, cannot be judged" in answer.sentence


def measured(model, degrees, k, share=0.05):
    exact = impact(model, SI.replace(alpha=np.deg2rad(degrees), k=k)).volume
    error = share * exact.max()
    noisy = exact + error * np.random.default_rng(2).standard_normal(len(degrees))
    return {"angle [deg]": degrees, "volume [m^3/impact]": noisy, "uncertainty [m^3]": np.full(len(degrees), error)}


def test_a_scale_is_best_measured_at_the_greatest_volume():
    # Of one factor the gain is a function of the volume at the angle alone.
    data = measured("linearized", np.array([10.0, 60.0]), 2.0)
    priors = {"cutting_fraction": stats.norm(0.5, 0.1)}
    drawn = posterior(
        FitProblem("linearized", SI, data, ["cutting_fraction"], priors=priors), draws=250, discrepancy=False
    )
    degrees = np.array([5.0, 20.0, 31.7, 45.0, 80.0])
    answer = next_test(drawn, {"alpha": np.deg2rad(degrees)}, for_prediction={"alpha": np.deg2rad(70.0)})
    exact = np.asarray(LinearizedCut().volume(SI.replace(alpha=np.deg2rad(degrees))))
    assert answer.best["alpha"] == pytest.approx(np.deg2rad(31.7))
    spread = drawn.deviations["cutting_fraction"] * exact / data["uncertainty [m^3]"][0]
    np.testing.assert_allclose(answer.prediction, 1 - 1 / np.sqrt(1 + spread**2), rtol=0.05, atol=2e-4)
    assert answer.half_width == pytest.approx(1.96 * drawn.deviations["cutting_fraction"]
                                              / drawn.means["cutting_fraction"], rel=0.01)  # fmt: skip
    assert answer.to_dict()["best"] == answer.best
    assert "narrows the prediction at 70° by [%]" in str(answer)


def test_the_posterior_with_the_next_test_is_as_narrow_as_was_said():
    data = measured("linearized", np.array([10.0, 15.0, 20.0, 60.0]), 2.0)
    options = {"draws": 500, "discrepancy": False}
    before = problems.drawn("linearized", SI, data, ["k", "psi"], **options)
    asked = {"alpha": np.deg2rad(40.0)}
    answer = next_test(before, {"alpha": np.deg2rad([30.0, 40.0, 50.0])}, for_prediction=asked)
    row = {"angle [deg]": 40.0, "volume [m^3/impact]": before.predictor.draw(asked["alpha"]).mean(),
           "uncertainty [m^3]": data["uncertainty [m^3]"][0]}  # fmt: skip
    more = {name: np.append(column, row[name]) for name, column in data.items()}
    after = problems.drawn("linearized", SI, more, ["k", "psi"], **options)
    ratio = (
        after.predictor.draw(asked["alpha"], count=2000).std() / before.predictor.draw(asked["alpha"], count=2000).std()
    )
    assert 1 - answer.prediction[1] == pytest.approx(ratio, rel=0.1)
    thetas = [float(np.log(fit.samples[name]).std()) for fit in (before, after) for name in ("k", "psi")]
    assert 1 - answer.parameters[1] == pytest.approx((thetas[2] / thetas[0] + thetas[3] / thetas[1]) / 2, rel=0.1)


def test_a_jump_whose_place_is_not_known_is_the_place_to_test_for_the_parameters():
    # With k = 1 V(α) falls to half at 40°; the data leave 30° to 50° open.
    data = measured("rotating", np.array([10.0, 20.0, 30.0, 50.0, 60.0]), 1.0)
    drawn = posterior(FitProblem("rotating", SI.replace(k=1.0), data, ["k", "psi"]), draws=250, discrepancy=False)
    answer = next_test(drawn)
    assert 34 < np.rad2deg(answer.best_for_parameters["alpha"]) < 45
    assert answer.parameters.max() > 2 * np.median(answer.parameters)
    # Twice the speed has four times the volume, and the errors stay.
    twice = next_test(drawn, {"alpha": np.deg2rad([[40.0], [20.0]]), "v0": [111.76, 223.52]})
    assert twice.prediction.shape == (4,)
    assert twice.parameters[3] > twice.parameters[2]


def test_two_models_are_told_apart_where_they_differ():
    data = measured("linearized", np.array([10.0, 15.0, 20.0, 25.0]), 2.0)
    priors = {"k": stats.uniform(0.5, 9.5), "psi": stats.uniform(0.001, 0.199)}
    of_both = FitProblem.of_models(["linearized", "tan-alpha"], SI, data, ["k", "psi"], priors=priors)
    both = rank([posterior(problem, draws=250) for problem in of_both])
    answer = next_test(both.fits)
    assert answer.names == both.names
    assert answer.discrimination.max() <= -(both.weights @ np.log2(both.weights)) + 1e-6
    assert answer.tables()[0].headings[-1] == "about the model [bit]"
    assert [float(row[1]) for row in answer.rows()] == sorted((float(row[1]) for row in answer.rows()), reverse=True)
    where = answer.best_to_discriminate["alpha"]
    assert answer.discrimination.max() == answer.discrimination[answer.candidates["alpha"] == where]


def test_models_that_are_not_ranked_have_no_part_in_the_next_test():
    data = measured("linearized", np.linspace(10.0, 80.0, 8), 2.0)
    of_both = FitProblem.of_models(["linearized", "tan-alpha"], SI, data, ["psi"])
    both = rank([calibrate(problem, starts=2) for problem in of_both])
    assert both.weights.tolist() == [1.0, 0.0]
    answer, alone = next_test(both.fits, draws=200), next_test(both.best, draws=200)
    assert answer.names == ("linearized",)
    np.testing.assert_array_equal(answer.noise, alone.noise)
    np.testing.assert_array_equal(answer.discrimination, 0.0)


def test_the_noise_of_a_row_is_that_of_the_models_by_their_weights():
    data = measured("linearized", np.array([10.0, 15.0, 20.0, 25.0]), 2.0)
    del data["uncertainty [m^3]"]
    of_both = FitProblem.of_models(["linearized", "tan-alpha"], SI, data, ["psi"])
    both = rank([posterior(problem, draws=125) for problem in of_both])
    at = {"candidates": {"alpha": [0.3]}, "for_prediction": {"alpha": 0.3}}
    of_each = [next_test(fit, **at).noise[0] for fit in both.fits]
    assert of_each[0] != pytest.approx(of_each[1], rel=0.05)
    assert next_test(both.fits, **at).noise[0] == pytest.approx(both.weights @ of_each, rel=1e-6)


def test_a_fit_by_least_squares_has_a_next_test():
    fit = calibrate(
        FitProblem("linearized", SI, measured("linearized", np.array([10.0, 30.0, 60.0]), 2.0), ["k", "psi"])
    )
    answer = next_test(fit)
    assert 0 < answer.prediction.max() < 1
    assert np.rad2deg(answer.asked["alpha"]) == pytest.approx(31.7, abs=8)


def test_the_next_test_is_the_same_for_a_case_in_inch_pound_units():
    data = measured("linearized", np.array([10.0, 60.0]), 2.0) | {"speed [m/s]": [111.76, 111.76]}
    asked = {"candidates": {"alpha": [0.3], "v0": "100 m/s"}, "for_prediction": {"alpha": 0.5, "v0": "60 m/s"}}
    fits = [calibrate(FitProblem("linearized", p, data, ["psi"]), starts=1) for p in (SI, TABLE_1)]
    in_si, in_inches = (next_test(fit, draws=200, **asked) for fit in fits)
    np.testing.assert_array_equal(in_inches.prediction, in_si.prediction)
    # Its own rows, at their speeds, are asked for as well.
    of_si, of_inches = (fit.predictor.findings for fit in fits)
    assert of_si == of_inches


@pytest.fixture(scope="module")
def drawn():
    return posterior(
        FitProblem("linearized", SI, measured("linearized", np.array([10.0, 60.0]), 2.0), ["psi"]), draws=125
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"candidates": {"v0": [1.0]}}, "must give angles"),
        ({"noise": 0.0}, "`noise` must be positive"),
        ({"for_prediction": 0.3}, "`for_prediction` must be such as"),
        ({"for_prediction": {"alpha": [0.3, 0.4]}}, "`for_prediction` must have one number each"),
        ({"for_prediction": {"psi": 0.3}}, "parameters of the case that are known, but has 'psi'"),
    ],
)
def test_what_makes_no_sense_is_refused(drawn, options, message):
    with pytest.raises(ValueError, match=message):
        next_test(drawn, **options)


@pytest.fixture(scope="module")
def fit(drawn):
    return calibrate(FitProblem("linearized", SI, drawn.data, ["psi"]))


@pytest.mark.parametrize(
    ("alpha", "at", "message"),
    [
        ([], {}, "`alpha` must hold at least one angle"),
        (np.zeros((0, 3)), {"v0": 1.0}, "`alpha` must hold at least one angle"),
        (["20"], {}, "`alpha` must have a unit"),
        ([[0.1], [0.2, 0.3]], {}, "`alpha` must hold real numbers"),
        (0.3 + 1j, {}, "`alpha` must be a number"),
        (None, {}, "`alpha` must be a number"),
        (np.nan, {}, "`alpha` must be in"),
        (np.ma.masked_array([0.3, 0.4], [True, False]), {}, "must have no masked values"),
        ([0.1, 2.0], {}, r"`alpha` must be in \(0, 90°\]"),
        ([0.1], {"psi": 0.1}, "parameters of the case that are known, but has 'psi'"),
        ([0.1], {"speed": 0.1}, "parameters of the case that are known, but has 'speed'"),
        ([0.1], {"v0": -1.0}, "`v0` must be positive and finite"),
        ([0.1], {"v0": "60"}, "`v0` must have a unit"),
        ([0.1], {"v0": "60 kg"}, "`v0` must be a speed"),
        ([0.1, 0.2], {"v0": [1.0, 2.0, 3.0]}, "must broadcast"),
    ],
)
def test_a_condition_that_makes_no_sense_is_refused_wherever_it_is_asked_for(drawn, fit, alpha, at, message):
    """A sampled parameter among the conditions would take the place of its draws, without a word."""
    for ask in (
        lambda: next_test(drawn, {"alpha": alpha, **at}),
        lambda: drawn.predictor.draw(alpha, at),
        lambda: drawn.ends(alpha, at),
        lambda: predict(fit, alpha, at),
        lambda: fit.curve(alpha, at),
    ):
        with pytest.raises((ValueError, TypeError), match=message):
            ask()


def test_a_ranking_is_refused_where_fits_are_asked_for(drawn):
    ranking = rank([drawn])
    assert rank(drawn).names == ranking.names
    for ask in (lambda: next_test(ranking), lambda: predict(ranking, 0.3), lambda: rank(ranking)):  # pyrefly: ignore
        with pytest.raises(TypeError, match=r"of a ranking `ranking\.best` or `ranking\.fits`"):
            ask()
    for ask in (lambda: next_test([]), lambda: rank([])):
        with pytest.raises(TypeError, match="must be a fit"):
            ask()


def test_conditions_broadcast_with_angles(drawn):
    both = drawn.predictor.draw([[0.3], [0.5]], {"v0": [75.0, 100.0]}, 5)
    assert both.shape == (5, 2, 2)
    alone = drawn.of_model.draw(0.5, {"v0": 75.0}, 5)
    np.testing.assert_array_equal(drawn.of_model.draw([[0.3], [0.5]], {"v0": [75.0, 100.0]}, 5)[:, 1, 0], alone)


def test_an_angle_without_a_prediction_is_not_that_of_the_greatest_erosion(drawn, monkeypatch):
    draw = Predictor.draw

    def fails_first(self, alpha, *options, **named):
        curves = draw(self, alpha, *options, **named)
        curves[:, 0] = np.nan
        return curves

    expected = next_test(drawn).asked["alpha"]
    monkeypatch.setattr(Predictor, "draw", fails_first)
    assert next_test(drawn).asked["alpha"] == expected > np.deg2rad(10.0)
    monkeypatch.setattr(Predictor, "draw", lambda self, alpha, *options: np.full((3, len(alpha)), np.nan))
    with pytest.raises(ValueError, match="`for_prediction` must give an angle"):
        next_test(drawn)


def test_without_draws_nothing_is_known_of_the_parameters():
    nothing = _Drawn(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty((0, 1)))
    assert np.isnan(nothing.parameters_narrowed(0))
