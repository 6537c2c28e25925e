"""Sweeps over a model's own parameters."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.cli import _status
from erosion.impacts import impact as engine
from erosion.models import Finnie, Linearized
from erosion.plotting.sweeps import plot_sweep
from erosion.sweeps import grid
from erosion.sweeps.grid import Outputs, make_grid
from erosion.sweeps.sweep import SweepInterrupted, sweep
from tests.cli.test_set_option import FILE
from tests.documents import result_of
from tests.models.test_own_parameters import FRICTION, MODEL, P
from tests.sweeps.test_sweep import assert_same_bits, stop_after

ANGLES = np.deg2rad([10.0, 20.0, 30.0])
# One program for the whole file, that of derivatives along any parameter.
ASKED: dict[str, Any] = {"derivatives": 1, "wrt": "friction"}


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    return sweep(MODEL, P, alpha=ANGLES, friction=[0.0, 0.1, 0.3], **ASKED)


def alone(friction: float, alpha: Any) -> erosion.Impact:
    return erosion.impact(MODEL.replace(friction=friction), P.replace(alpha=alpha), **ASKED)


def test_an_own_parameter_is_an_axis(whole):
    assert whole.volume.dims == ("alpha", "friction")
    for friction in (0.0, 0.1, 0.3):
        dataset, hits = whole.sel(friction=friction), alone(friction, ANGLES)
        for name in ("volume", "t_c", "dvolume"):
            np.testing.assert_array_equal(dataset[name], getattr(hits, name))


def test_all_values_are_one_call_of_each_verb(monkeypatch):
    calls: list[str] = []

    def counted(name: str, verb: Any) -> Any:
        def call(*arguments: Any, **options: Any) -> Any:
            calls.append(name)
            return verb(*arguments, **options)

        return call

    monkeypatch.setattr(engine, "integrate", counted("integrate", engine.integrate))
    frictions = np.linspace(0.0, 0.5, 200)
    dataset = sweep(MODEL, P, friction=frictions, alpha=ANGLES)
    assert calls == ["integrate"]
    last = erosion.impact(MODEL.replace(friction=0.5), P.replace(alpha=ANGLES))
    np.testing.assert_array_equal(dataset.volume[-1], last.volume)
    monkeypatch.setattr(grid, "alpha_max", counted("alpha_max", grid.alpha_max))
    calls.clear()
    sweep(MODEL, P, friction=frictions[::50], optimum=True)
    assert calls.count("alpha_max") == 1


def test_it_has_its_label_and_unit(whole):
    assert whole.friction.attrs == {"long_name": "coefficient of friction", "symbol": "μ", "units": "1"}
    by_friction = "derivative of the volume by μ (coefficient of friction)"
    assert whole.dvolume.attrs == {"long_name": by_friction, "symbol": "dV/dμ", "units": "in^3"}
    # Of what is an axis, the model's own value means nothing.
    assert "own_parameters" not in whole.attrs
    other = sweep(MODEL.replace(friction=0.3), P, alpha=ANGLES, **ASKED)
    assert other.attrs["own_parameters"] == "friction = 0.3"
    np.testing.assert_array_equal(other.volume, whole.volume.sel(friction=0.3))


def test_it_goes_together_with_a_parameter_of_the_case_and_has_a_best_angle():
    dataset = sweep(MODEL, P, friction=[0.1, 0.3, 0.3], alpha=ANGLES, paired=("friction", "alpha"), **ASKED)
    assert dataset.volume.dims == dataset.friction.dims == dataset.alpha.dims == ("pair",)
    expected = [alone(friction, alpha).volume for friction, alpha in zip((0.1, 0.3, 0.3), ANGLES, strict=True)]
    np.testing.assert_array_equal(dataset.volume, expected)
    best = sweep(MODEL, P, friction=[0.0, 0.5], optimum=True, alpha=ANGLES, **ASKED).alpha_max
    assert best.dims == ("friction",)
    # linearized at k/(1 + μk): ½ arctan.
    assert best.values == pytest.approx(np.arctan([2.0, 1.0]) / 2, abs=1e-9)


def test_several_models_share_it():
    grid = make_grid([MODEL, Finnie(force=FRICTION())], P, {"friction": [0.1, 0.2]}, Outputs(wrt="friction"))
    assert grid.lengths == {"model": 2, "friction": 2}
    with pytest.raises(ValueError, match="Argument `friction` must be a parameter of every model, but finnie has none"):
        make_grid([MODEL, "finnie"], P, {"friction": [0.1, 0.2]})


def test_it_must_not_be_called_as_a_result():
    class Odd(FRICTION):
        volume: float = 1.0

    with pytest.raises(ValueError, match="An axis must not be called `volume`, as something else in a sweep is"):
        make_grid(Linearized(force=Odd()), P, {"volume": [1.0]})


@pytest.mark.parametrize("store", ["out.nc", "out.zarr"])
def test_an_interrupted_sweep_goes_on(tmp_path, store):
    axes: dict[str, Any] = {"friction": [0.1, 0.2], "alpha": np.linspace(0.1, 1.5, 10_000), **ASKED}
    chunks = {"chunks": {"friction": 1}} if store.endswith("zarr") else {}
    path = tmp_path / store
    with pytest.raises(SweepInterrupted):
        sweep(MODEL, P, store=path, progress=stop_after(1), **chunks, **axes)
    dataset = sweep(MODEL, P, store=path, **chunks, **axes)
    assert_same_bits(dataset.load(), sweep(MODEL, P, **axes))
    assert dataset.friction.attrs["symbol"] == "μ"
    for changed, message in (({"friction": [0.1, 0.3]}, "axes"), ({"model": MODEL.replace(friction=0.9)}, "models")):
        with pytest.raises(erosion.StoreError, match=f"of another {message}"):
            sweep(**{"model": MODEL, "p": P, "store": path, **chunks, **axes, **changed})


def test_a_figure_names_it(whole):
    map_ = plot_sweep(sweep(MODEL, P, friction=np.linspace(0, 0.5, 7), alpha=np.linspace(0.1, 1.5, 8), **ASKED))
    assert map_.axes[0].get_xlabel() == "μ  coefficient of friction"
    family = plot_sweep(whole)
    assert [text.get_text() for text in family.legends[0].get_texts()] == ["μ = 0", "μ = 0.1", "μ = 0.3"]


def test_the_command_line_takes_axes_of_own_parameters(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("harder.py").write_text(FILE)
    Path("case.toml").write_text(erosion.dump_case(P) + '\n[sweep]\nmodel = "harder.py"\nset.factor = [1, 2]\n')
    words = ["sweep", "case.toml", "-o", "out.nc", "--alpha", "20deg,30deg", "--plot", "out.svg"]
    assert _status([*words, "--set", "speed=5 m/s", "--json"]) == 0
    assert result_of(capsys.readouterr().out)["dimensions"] == {"alpha": 2, "factor": 2}
    dataset = xr.load_dataset("out.nc")
    assert dataset.volume[0].values == pytest.approx(1.816436352531e-4 / np.array([1, 2]), rel=1e-8)  # golden; V ∝ 1/σ
    assert dataset.attrs["own_parameters"] == "speed = 196.8503937007874"
    assert _status([*words, "--set", "speed=6 m/s"]) == 2
    assert "holds another result (of another models)" in capsys.readouterr().err
