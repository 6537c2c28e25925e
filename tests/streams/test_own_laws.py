"""Streams whose own parameters vary: the same impacts as those of the equivalent case without friction."""

import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.cli import _status
from erosion.distributions import LogNormal, Normal, Uniform
from erosion.impacts.dataset_files import StoreError
from erosion.models import ForceLaw, Linearized
from erosion.streams.stream import REPLICATES, stream
from erosion.streams.tally import Particles, Points
from tests.cli.test_set_option import FILE
from tests.documents import result_of
from tests.models.test_own_parameters import MODEL, P, with_friction
from tests.reference import AT_20_DEGREES, closed_form

pytestmark = pytest.mark.slow

FEW: dict[str, Any] = {"best_angle": False, "sensitivities": False}
LAWS: dict[str, Any] = {"friction": Uniform(0.1, 0.3), "v0": LogNormal(4400.0, 0.1)}


@pytest.mark.parametrize("points", ["sobol", "random"])
def test_a_law_of_friction_is_laws_of_flow_stress_and_force_ratio(points):
    result = stream(MODEL, P, n=2**10, seed=3, points=points, **FEW, **LAWS)
    drawn = Particles(MODEL, P, LAWS).draw(Points(points, 2, 3, REPLICATES).take(2**10 // REPLICATES))
    assert drawn["friction"].shape == (REPLICATES, 64)
    equivalent = with_friction(drawn["friction"], P.replace(v0=drawn["v0"]))
    volume = erosion.impact("linearized", equivalent).volume
    np.testing.assert_allclose(result.tally.mean, volume.mean(axis=1), rtol=1e-8)  # the engine's tolerance is 1e-9
    assert result.quantiles[0.5] == pytest.approx(np.median(volume), rel=3e-3)


def test_the_mean_and_the_best_angle_are_those_of_the_closed_form():
    result = stream(MODEL, P, n=2**16, **FEW, **LAWS)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    volume = np.asarray(closed_form("linearized").volume(with_friction(0.2 + 0.1 * nodes)))
    # V ∝ v₀², of lognormal moment exp(2 s²).
    exact = float(volume @ weights / 2 * np.exp(2 * 0.1**2))
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-4)
    assert result.mean_volume.low < exact < result.mean_volume.high
    nozzle = stream(MODEL, P, n=64, sensitivities=False, friction=Normal(0.2, 1e-6)).nozzle
    assert nozzle is not None
    best = np.arctan(2.0 / 1.4) / 2  # ½ arctan k at k/(1 + μk)
    assert (nozzle.alpha.value, nozzle.single_alpha) == (pytest.approx(best, abs=1e-4), pytest.approx(best, abs=1e-9))


def test_no_range_of_an_own_parameter_is_known():
    drawn = Particles(MODEL, P, {"friction": Normal(0.0, 0.1)}).draw(np.array([[0.1], [0.9]]))
    assert drawn["friction"] == pytest.approx([-0.1281551566, 0.1281551566])
    with pytest.raises(ValueError, match=r"`k` must be positive, but 50\.0% of"):
        Particles(MODEL, P, {"k": Normal(0.0, 0.1)})


def test_sensitivities_and_labels_are_those_of_the_model():
    result = stream(MODEL, P, n=64, best_angle=False, **LAWS)
    assert result.sensitivities is not None
    assert list(result.sensitivities) == ["friction", "v0"]
    symbols = [row.symbol for row in result.rows() if row.name == "sensitivity"]
    assert symbols == ["S(μ)", "T(μ)", "S(v₀)", "T(v₀)"]
    assert result.title == (
        "Linearized(CoulombTip): a stream, friction uniform(0.1, 0.3), v0 lognormal(4400 in/s, 0.1)"
    )


def test_the_law_is_part_of_the_identity(tmp_path):
    path = tmp_path / "jet.nc"
    whole = stream(MODEL, P, n=2**10, **FEW, **LAWS)
    stream(MODEL, P, n=2**9, store=path, **FEW, **LAWS)
    result = stream(MODEL, P, n=2**10, store=path, **FEW, **LAWS)
    np.testing.assert_allclose(result.tally.mean, whole.tally.mean, rtol=1e-14)
    stored = xr.load_dataset(path, engine="h5netcdf")
    assert stored.attrs["distributions"] == "friction: Uniform(0.1, 0.3); v0: LogNormal(4400, 0.1)"
    # Of what varies, the model's own value means nothing.
    assert "own_parameters" not in stored.attrs
    with pytest.raises(StoreError, match="another distributions"):
        stream(MODEL, P, n=2**9, store=path, **FEW, **{**LAWS, "friction": Uniform(0.1, 0.4)})


def test_what_cannot_vary_is_one_sentence():
    class Undeclared(ForceLaw):
        factor: jax.Array = eqx.field(default=1.0)  # pyright: ignore[reportAssignmentType]

        def __call__(self, state, tip, p):
            horizontal = -p.stiffness * tip.depth * self.factor
            return horizontal, p.k * horizontal

        def typical_ratio(self, p):
            return p.k

    model, data = Linearized(force=Undeclared()), {"angle [deg]": [20.0, 30.0, 40.0], "volume [in^3]": [1e-4] * 3}
    for call in (
        lambda: stream(model, P, factor=Normal(1.0, 0.1)),
        lambda: erosion.sweep(model, P, factor=[1.0, 2.0]),
        lambda: erosion.calibrate(model, P, data, free=["factor"]),
    ):
        with pytest.raises(TypeError, match=r"`factor` must be one number, .*`erosion\.own_parameter`, or as `float`"):
            call()
    with pytest.raises(TypeError, match=r"`fricton` is not a parameter; they are .*, friction\."):
        stream(MODEL, P, fricton=Normal(0.2, 0.1))
    with pytest.raises(ValueError, match=r"`friction` must be a scalar here, but has shape \(2,\)"):
        stream(MODEL.replace(friction=np.array([0.1, 0.2])), P, v0=Normal(4400, 40))


def test_the_command_line_takes_laws_of_own_parameters(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("harder.py").write_text(FILE)
    case = '\n[stream]\nmodel = "harder.py"\nn = 1024\nset.factor = "uniform(2, 3)"\n'
    Path("case.toml").write_text(erosion.dump_case(P) + case)
    words = ["stream", "case.toml", "--no-best-angle", "-o", "jet.nc", "--json", "--set"]
    assert _status([*words, "speed=normal(5 m/s, 1 m/s)"]) == 0
    document = capsys.readouterr().out
    result = result_of(document)
    # V ∝ 1/σ, and the mean of 1/f is ln 1.5; 1024 points are worth four digits.
    single = AT_20_DEGREES["linearized"].volume
    assert result["mean_volume"] == pytest.approx(single * np.log(1.5), rel=1e-4)
    assert json.loads(document)["model"] == {"name": "harder.py", "own_parameters": {}}
    assert set(result["sensitivities"]) == {"factor", "speed"}
    stored = xr.load_dataset("jet.nc")
    assert stored.attrs["distributions"] == "factor: Uniform(2, 3); speed: Normal(196.85, 39.3701)"
    for own, message in (
        ("speed=normal(5 m/s, 2 m/s)", "holds another result (of another distributions)"),
        ("factor=2", "must have a law of a parameter, an option such as"),
        ("speed=normal(5 kg, 2 m/s)", "Option `--set speed` must be a speed"),
    ):
        assert _status([*words, own]) == 2
        assert message in capsys.readouterr().err
    Path("factors.csv").write_text("factor\n2\n4\n")
    assert _status(["stream", "--model", "harder.py", "--n", "64", "--no-best-angle", "--set",
                    "factor=samples(factors.csv)", "--json"]) == 0  # fmt: skip
    result = result_of(capsys.readouterr().out)
    assert result["mean_volume"] == pytest.approx(single * 3 / 8, rel=1e-8)
