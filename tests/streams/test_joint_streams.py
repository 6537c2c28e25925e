"""Streams of particles whose parameters vary together, and the sensitivities of such inputs."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from erosion.distributions import LogNormal, Normal, Uniform
from erosion.impacts.impact import impact
from erosion.joint_laws import CorrelatedLaws, Rows
from erosion.parameters.parameters import TABLE_1
from erosion.streams.stream import stream
from erosion.streams.tally import sobol_indices

FEW: dict[str, Any] = {"best_angle": False, "sensitivities": False}


def test_rows_give_the_mean_over_the_table():
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.2, 1.0, 64)
    speed = 4400 * (1 + angle)
    result = stream("linearized", TABLE_1, n=2**12, **FEW, **Rows({"alpha": angle, "v0": speed}))
    exact = impact("linearized", TABLE_1.replace(alpha=angle, v0=speed)).volume.mean()
    # 64 rows, and powers of 2 of Sobol points: each row comes equally often.
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-9)
    apart = stream("linearized", TABLE_1, n=2**12, **FEW, alpha=Uniform(0.2, 1.0), v0=Uniform(5280, 8800))
    assert abs(apart.mean_volume.value / exact - 1) > 0.005
    assert "row by row of alpha, v0" in str(result)
    assert result.to_dict()["mean_volume"] == result.mean_volume.value


def test_correlated_speed_and_size_remove_more():
    laws: dict[str, Any] = {"v0": LogNormal(4400.0, 0.2), "r": LogNormal(0.04, 0.2)}
    together = stream("linearized", TABLE_1, n=2**13, **FEW, **CorrelatedLaws(laws, {("v0", "r"): 0.8}))
    apart = stream("linearized", TABLE_1, n=2**13, **FEW, **laws)
    # V goes with m v0² and m with r³: the logarithms add, and their covariance is 0.8·0.2².
    ratio = together.mean_volume.value / apart.mean_volume.value
    assert ratio == pytest.approx(np.exp(2 * 3 * 0.8 * 0.2**2), rel=0.01)


def test_frozen_laws_of_scipy_are_taken():
    def means(speed: Any, k: Any) -> list[float]:
        tied = CorrelatedLaws({"v0": speed, "r": LogNormal(0.04, 0.2)}, {("v0", "r"): 0.8})
        return [
            stream("linearized", TABLE_1, n=256, **FEW, v0=speed, uncertain={"k": k}).mean_volume.value,
            stream("linearized", TABLE_1, n=256, **FEW, **tied).mean_volume.value,
        ]

    ours = means(Normal(4400.0, 400.0), Uniform(1.5, 2.5))
    assert means(stats.norm(4400.0, 400.0), stats.uniform(1.5, 1.0)) == pytest.approx(ours, rel=1e-9, abs=0)


def test_a_joint_law_is_one_input_of_the_sensitivities(tmp_path):
    laws = {"v0": LogNormal(4400.0, 0.05), "m": LogNormal(float(TABLE_1.m), 0.1)}

    def jet(rho: float, **more: Any):
        joint = CorrelatedLaws(laws, {("v0", "m"): rho})
        return stream("linearized", TABLE_1, n=2**12, best_angle=False, **more, **joint)

    stored: dict[str, Any] = {"sigma": LogNormal(2e5, 0.1), "store": tmp_path / "jet.nc"}
    result, again = jet(-0.5, **stored), jet(-0.5, **stored)
    assert again.mean_volume == result.mean_volume
    assert result.sensitivities is not None
    # log V = log m + 2 log v0 - log σ: variances 0.01 and 0.01 + 4·0.0025 - 4·0.5·0.1·0.05 = 0.01.
    first = {name: estimate.value for name, (estimate, _) in result.sensitivities.items()}
    assert first == {"sigma": pytest.approx(0.5, abs=0.02), "v0, m": pytest.approx(0.5, abs=0.02)}
    assert "S(v₀, m)" in str(result)
    assert jet(-0.5).sensitivities is None
    with pytest.raises(ValueError, match="another distributions"):
        jet(-0.4, **stored)


def test_a_store_knows_which_values_stand_in_one_row(tmp_path):
    angle, speed = np.linspace(0.2, 0.6, 8), np.linspace(4000.0, 5000.0, 8)
    options: dict[str, Any] = {"n": 64, **FEW, "store": tmp_path / "jet.nc"}
    first, again = (stream("linearized", TABLE_1, **options, **Rows({"alpha": angle, "v0": speed})) for _ in range(2))
    assert again.mean_volume == first.mean_volume
    with pytest.raises(ValueError, match="another distributions"):
        stream("linearized", TABLE_1, **options, **Rows({"alpha": angle, "v0": speed[::-1]}))


def test_sobols_indices_are_those_of_ishigami():
    # sin x + 7 sin² y + 0.1 z⁴ sin x on (-π, π)³: Saltelli et al., Sensitivity analysis in practice (2004).
    def ishigami(points: np.ndarray) -> np.ndarray:
        x, y, z = (2 * points.T - 1) * np.pi
        return np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)

    first, total = sobol_indices(ishigami, [1, 1, 1], 2**13, np.random.default_rng(0))
    np.testing.assert_allclose(first, [0.3139, 0.4424, 0.0], atol=0.01)
    np.testing.assert_allclose(total, [0.5576, 0.4424, 0.2437], atol=0.01)
    # The first and the third together cause all that the second does not.
    first, total = sobol_indices(lambda points: ishigami(points[:, [0, 2, 1]]), [2, 1], 2**13, np.random.default_rng(0))
    np.testing.assert_allclose(first, [0.5576, 0.4424], atol=0.01)
    np.testing.assert_allclose(total, [0.5576, 0.4424], atol=0.01)


def test_inputs_of_one_number_have_scipys_indices():
    def function(points: np.ndarray) -> np.ndarray:
        return points[:, 0] + points[:, 1] ** 2 + points[:, 0] * points[:, 2]

    first, total = sobol_indices(function, [1, 1, 1], 2**11, np.random.default_rng(1))
    uniform = [stats.uniform(2.0**-31, 1 - 2.0**-30)] * 3
    known = stats.sobol_indices(func=lambda x: function(x.T), n=2**11, dists=uniform, rng=np.random.default_rng(1))
    np.testing.assert_allclose(first, known.first_order, atol=0.02)
    np.testing.assert_allclose(total, known.total_order, atol=0.02)


def test_normal_laws_of_a_joint_law_are_cut_off_at_zero():
    laws = {"v0": Normal(4400.0, 1850.0), "r": Normal(0.04, 0.001)}
    result = stream("linearized", TABLE_1, n=2**12, **FEW, **CorrelatedLaws(laws, {("v0", "r"): 0.5}))
    assert set(result.shares) <= {"rebound", "stop"}


def test_what_is_uncertain_does_not_average_out():
    # V of the linearized cut goes with 1/σψ: all means scale alike with it, whatever the particles are.
    rng = np.random.default_rng(3)
    sigma, psi = 2e5 * np.exp(0.2 * rng.standard_normal(500)), 0.05 * np.exp(0.1 * rng.standard_normal(500))
    particles: dict[str, Any] = {"v0": LogNormal(4400.0, 0.2), "r": Normal(0.04, 0.002)}
    metal = Rows({"sigma": sigma, "psi": psi})
    few, many = (stream("linearized", TABLE_1, n=n, **FEW, **particles, uncertain=metal) for n in (2**8, 2**15))
    exact = np.std(1 / (sigma * psi)) / np.mean(1 / (sigma * psi))
    for jet in (few, many):
        assert jet.uncertainty is not None
        assert len(jet.uncertainty.volume) == 256
        errors = jet.parameter_errors
        # 256 draws know a standard deviation to 4 %; Sobol's points are better than random ones.
        assert errors["erosion"] / jet.erosion.value == pytest.approx(exact, rel=0.1)
        assert errors["mean_volume"] / jet.mean_volume.value == pytest.approx(exact, rel=0.1)
    assert many.mean_volume.error < few.mean_volume.error / 5
    ratio = many.mean_volume.value / stream("linearized", TABLE_1, n=2**15, **FEW, **particles).mean_volume.value
    mean = np.mean(1 / (sigma * psi)) * float(TABLE_1.sigma * TABLE_1.psi)
    assert ratio == pytest.approx(mean, rel=0.005)
    assert "of E, by uncertain σ, ψ; ± is by sampling alone" in str(many)
    assert many.to_dict()["mean_volume_parameter_error"] == many.parameter_errors["mean_volume"]


def test_what_varies_from_particle_to_particle_averages_out():
    law: dict[str, Any] = {"sigma": LogNormal(2e5, 0.3)}
    varied = stream("linearized", TABLE_1, n=2**15, **FEW, **law)
    assert varied.parameter_errors == {}
    assert varied.mean_volume.error < 0.001 * varied.mean_volume.value
    unknown = stream("linearized", TABLE_1, n=2**15, **FEW, uncertain=law)
    assert unknown.parameter_errors["mean_volume"] == pytest.approx(
        unknown.mean_volume.value * np.sqrt(np.exp(0.3**2) - 1), rel=0.05
    )
    assert "sigma uncertain lognormal" in unknown.title


def test_uncertain_parameters_are_inputs_of_the_sensitivities(tmp_path):
    metal = CorrelatedLaws({"sigma": LogNormal(2e5, 0.1), "psi": LogNormal(0.05, 0.1)}, {("sigma", "psi"): -0.9})
    options: dict[str, Any] = {"n": 2**12, "best_angle": False, "v0": LogNormal(4400.0, 0.05)}
    jet = stream("linearized", TABLE_1, **options, uncertain=metal, store=tmp_path / "jet.nc")
    assert jet.sensitivities is not None
    # log V = 2 log v0 - log σψ: variances 4·0.0025 and 0.01 + 0.01 - 2·0.9·0.01 = 0.002.
    assert jet.sensitivities["sigma, psi"][0].value == pytest.approx(1 / 6, abs=0.02)
    with pytest.raises(ValueError, match="another distributions"):
        stream("linearized", TABLE_1, **options, **metal, store=tmp_path / "jet.nc")


PAIR: dict[str, Any] = dict(Rows({"k": [1.0, 2.0], "psi": [0.05, 0.06]}))
SIGMA: dict[str, Any] = {"sigma": LogNormal(2e5, 0.3)}


@pytest.mark.parametrize(
    ("laws", "message"),
    [
        ({**SIGMA, "uncertain": SIGMA}, "`uncertain` must name parameters without another law, but sigma has one"),
        ({"k": PAIR["k"], "uncertain": {"psi": PAIR["psi"]}}, "must include all of a joint law, but psi is missing"),
        ({"k": PAIR["k"]}, "must include all of a joint law, but psi is missing"),
        (Rows({"v0": [-1.0, 4000.0]}), "`v0` must be positive"),
    ],
)
def test_laws_that_make_no_sense_are_refused(laws, message):
    with pytest.raises(ValueError, match=message):
        stream("linearized", TABLE_1, n=64, **laws)
