"""Fits of a model's own parameters."""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.calibration.forward import Forward
from erosion.cli import _status
from erosion.models import Linearized
from tests.cli.test_set_option import FILE
from tests.documents import result_of
from tests.models.test_own_parameters import FRICTION, MODEL, P

pytestmark = pytest.mark.slow

DEGREES = np.arange(8.0, 56.0, 3.0)
TRUTH = {"psi": 0.035, "friction": 0.35}


@pytest.fixture(scope="module")
def data() -> erosion.Measurements:
    """What `TRUTH` gives, with errors of 1 %."""
    hits = erosion.impact(
        MODEL.replace(friction=TRUTH["friction"]),
        P.replace(psi=TRUTH["psi"], alpha=np.deg2rad(DEGREES)),
        derivatives=1,
        wrt=list(TRUTH),
    )
    noisy = hits.volume * (1 + 0.01 * np.random.default_rng(3).standard_normal(DEGREES.size))
    columns = {"angle [deg]": DEGREES, "volume [in^3]": noisy, "uncertainty [in^3]": 0.01 * hits.volume}
    return erosion.read_measurements(columns, "inch-pound")


def assert_is_the_truth(fit: erosion.Calibration) -> None:
    for name, value in TRUTH.items():
        assert abs(fit.estimates[name] - value) < 4 * fit.standard_errors[name] < 0.4 * value


def test_a_fit_finds_friction_and_gives_the_model_back(data):
    fit = erosion.calibrate(MODEL, P, data, free=["psi", "friction"])
    assert_is_the_truth(fit)
    assert getattr(fit.model, "force") == FRICTION(fit.estimates["friction"])  # noqa: B009
    assert fit.p == P.replace(psi=fit.estimates["psi"])
    assert [row.symbol for row in fit.rows()[:2]] == ["ψ", "μ"]
    assert fit.rows()[1].unit == ""
    again = erosion.impact(fit.model, fit.p.replace(alpha=np.deg2rad(DEGREES)), derivatives=1, wrt=["psi", "friction"])
    np.testing.assert_array_equal(again.volume, fit.fitted)


def test_what_starts_at_zero_may_have_either_sign(data):
    fit = erosion.calibrate(MODEL.replace(friction=0.0), P, data, free=["psi", "friction"])
    assert_is_the_truth(fit)
    low, high = fit.intervals()["friction"]
    assert low + high == pytest.approx(2 * fit.estimates["friction"], rel=0.2)
    bound = erosion.calibrate(
        MODEL.replace(friction=0.0), P, data, free=["psi", "friction"], bounds={"friction": (-1.0, 0.1)}
    )
    assert bound.estimates["friction"] == pytest.approx(0.1, abs=1e-6)
    assert any(said.startswith("friction is at its upper bound, 0.1") for said in bound.statements)
    with pytest.raises(ValueError, match="`bounds` must give friction two ascending values in its range, but has"):
        erosion.calibrate(MODEL, P, data, free=["psi", "friction"], bounds={"friction": (-1.0, 0.1)})


def test_what_erosion_cannot_tell_is_said(data):
    fit = erosion.calibrate(MODEL, P, data, free=["k", "psi", "friction"], starts=1)
    assert fit.undetermined == ("k", "psi", "friction")
    assert fit.statements[0].startswith("k, psi and friction cannot be told apart")


@pytest.mark.parametrize("friction", [0.2, -0.1])
def test_derivatives_are_those_of_the_prediction(data, friction):
    forward = Forward(MODEL.replace(friction=friction), P, ("friction", "psi"), data, None)
    theta, step = forward.start, 1e-4
    assert forward.values(theta) == pytest.approx({"friction": friction, "psi": 0.04})
    rates = forward.predict(theta, data.conditions)[1]
    for i in range(2):
        up, down = (forward.predict(theta + sign * step * np.eye(2)[i], data.conditions)[0] for sign in (1, -1))
        # Differences err by step²/6 of the third derivative.
        assert (up - down) / (2 * step) == pytest.approx(rates[:, i], rel=1e-6, abs=1e-8 * np.abs(rates).max())


def test_many_points_are_one_call(data, monkeypatch):
    def verb(model, p, **options):
        calls.append(model)
        return erosion.impact(model, p, **options)

    calls: list[erosion.CuttingModel] = []
    asked = Forward(MODEL, P, ("friction", "psi"), data, None)
    thetas = asked.start + np.linspace(-0.3, 0.3, 7)[:, None]
    one_by_one = [asked.predict(theta, data.conditions)[0] for theta in thetas]
    monkeypatch.setattr("erosion.calibration.forward.impact", verb)
    np.testing.assert_array_equal(asked.predict_many(thetas, data.conditions), one_by_one)
    assert len(calls) == 1


def test_the_name_of_the_scale_is_taken(data):
    class Scaled(FRICTION):
        scale: float = 1.0

    with pytest.raises(ValueError, match="Argument `free` must not name `scale`"):
        erosion.calibrate(Linearized(force=Scaled()), P, data, free=["scale"])


def test_the_command_line_fits_them(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("harder.py").write_text(FILE)
    rows = "\n".join(f"{angle},{volume}" for angle, volume in ((20, 0.9082e-4), (30, 1.0635e-4), (40, 0.95e-4)))
    Path("sand.csv").write_text(f"angle [deg], volume [in^3]\n{rows}\n")
    words = [
        "calibrate",
        "sand.csv",
        "--model",
        "harder.py",
        "--set",
        "factor=1.5",
        "--free",
        "factor",
        "--starts",
        "1",
    ]
    assert _status([*words, "--json"]) == 0
    result = result_of(capsys.readouterr().out)
    # V ∝ 1/σ, and these are about half of what Table 1 gives.
    assert result["estimates"]["factor"] == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("correlation", "threshold"), [("dnv", 0.0), ("ecrc", 2200.0), ("oka", 0.0)])
def test_with_deformation_the_linearized_cut_follows_angle_functions_of_tests(correlation, threshold):
    degrees = np.arange(5.0, 91.0, 5.0)
    curve = erosion.CORRELATIONS[correlation].normalised(np.deg2rad(degrees))
    model = erosion.load_model("linearized-deformation").replace(threshold=threshold)
    free = ["k", "energy_ratio", *(["threshold"] if threshold else [])]
    fit = erosion.calibrate(model, P, {"angle [deg]": degrees, "erosion [-]": curve}, free=free)
    # A cut alone misses these curves by 0.23 to 0.26 of their maximum.
    assert np.sqrt(np.mean(fit.residuals**2)) < 0.05
