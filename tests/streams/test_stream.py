"""Streams: means with their errors against closed forms, and what is left when one is interrupted."""

import json
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.distributions import LogNormal, Normal, RosinRammler, Samples, Uniform
from erosion.impacts.dataset_files import StoreError
from erosion.models import Linearized
from erosion.models.rigid import LinearizedCut
from erosion.output.tables import to_json
from erosion.streams.stream import StreamInterrupted, stream
from erosion.streams.tally import Particles

P = erosion.TABLE_1
FEW: dict[str, Any] = {"best_angle": False, "sensitivities": False}
LAWS: dict[str, Any] = {"v0": LogNormal(4400.0, 0.1), "alpha": Uniform(0.2, 0.4)}


def mean_volume_of_laws() -> float:
    """Of `LAWS`, by quadrature of the closed form: V ∝ v₀², of lognormal moment exp(2 s²)."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    volume = np.asarray(LinearizedCut().volume(P.replace(alpha=0.3 + 0.1 * nodes)))
    return float(volume @ weights / 2 * np.exp(2 * 0.1**2))


def test_the_mean_and_its_error_are_right():
    result = stream("linearized", P, n=2**16, **FEW, **LAWS)
    assert result.n == 2**16
    exact = mean_volume_of_laws()
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-4, abs=0)
    assert result.mean_volume.low < exact < result.mean_volume.high
    # Scrambled Sobol points: a hundred times nearer than random ones.
    assert result.mean_volume.error < 0.05 * result.deviation / np.sqrt(result.n)
    assert result.total_volume == pytest.approx(result.n * result.mean_volume.value, rel=1e-12, abs=0)
    assert result.erosion.value == pytest.approx(result.mean_volume.value / P.m, rel=1e-12, abs=0)
    assert result.shares["rebound"].value == 1


@pytest.mark.parametrize("points", ["sobol", "random"])
def test_intervals_cover_the_truth(points):
    means = [stream("linearized", P, n=1000, seed=seed, points=points, **FEW, **LAWS) for seed in (*range(40), 1)]
    covered = sum(jet.mean_volume.low < mean_volume_of_laws() < jet.mean_volume.high for jet in means[:40])
    # 95 % intervals: 38 of 40 expected; 33 or fewer have a probability of 0.3 %.
    assert covered >= 34
    # A seed is a stream.
    assert means[1].mean_volume == means[40].mean_volume != means[2].mean_volume
    assert means[0].n == 1008  # a multiple of 16


def test_scaled_particles_remove_in_proportion_to_their_mass():
    result = stream("linearized", P, n=2**16, **FEW, r=RosinRammler(0.04, 3, 0.02))
    single = erosion.impact("linearized", P).volume / P.m
    assert result.erosion.value == pytest.approx(single, rel=1e-9, abs=0)
    # Rotating too, as b goes with r: V/m does not depend on the size.
    particles = Particles(Linearized(), P, {"r": Uniform(0.01, 0.08)})
    _, p, _ = particles.impacts(particles.draw(np.array([[0.1], [0.9]])))
    np.testing.assert_allclose(p.rate * p.r, P.rate * P.r, rtol=1e-12)
    np.testing.assert_allclose(p.m / p.r**3, P.m / P.r**3, rtol=1e-12)


def test_steep_particles_come_from_the_other_side_and_flat_ones_miss():
    particles = Particles(Linearized(), P.replace(phidot0=100.0), {"alpha": Samples([-0.1, 0.3, np.pi - 0.3, 3.2])})
    values = particles.draw(np.array([[0.1], [0.4], [0.6], [0.9]]))
    _, p, hits = particles.impacts(values)
    np.testing.assert_array_equal(hits, [False, True, True, False])
    np.testing.assert_allclose(p.alpha[1:3], [0.3, 0.3])
    np.testing.assert_allclose(p.phidot0[1:3], [100, -100])
    result = stream("linearized", P, n=1024, **FEW, alpha=Uniform(-0.1, 0.1))
    # The lower half misses: 0 is its middle.
    assert result.shares["miss"].value == pytest.approx(0.5, abs=1e-3)
    assert result.quantiles[0.25] == 0
    assert result.erosion.value == pytest.approx(result.mean_volume.value / P.m, rel=1e-12, abs=0)


def test_sensitivities_are_those_of_a_product():
    # V = a·v₀²·m: the indices of a product of independent factors are known.
    laws: dict[str, Any] = {"v0": LogNormal(4400.0, 0.1), "m": LogNormal(float(P.m), 0.3)}
    result = stream("linearized", P, n=1024, best_angle=False, **laws)
    assert result.sensitivities is not None
    variances = {name: np.exp((power * s) ** 2) - 1 for name, power, s in (("v0", 2, 0.1), ("m", 1, 0.3))}
    whole = np.prod([1 + v for v in variances.values()]) - 1
    for name, (first, total) in result.sensitivities.items():
        other = next(v for key, v in variances.items() if key != name)
        assert abs(first.value - variances[name] / whole) < 5 * first.error + 1e-3
        assert abs(total.value - variances[name] * (1 + other) / whole) < 5 * total.error + 1e-3


def test_an_interrupted_stream_is_readable_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("erosion.streams.stream._BLOCK", 2**8)
    whole = stream("linearized", P, n=3 * 2**12, **FEW, **LAWS)
    path = tmp_path / "jet.nc"

    def stop(what: str, done: int, total: int) -> None:
        if done == 2**13:
            raise KeyboardInterrupt

    with pytest.raises(StreamInterrupted, match=r"after 8,192 of 12,288 particles; .*jet.nc holds them") as caught:
        stream("linearized", P, n=3 * 2**12, store=path, progress=stop, **FEW, **LAWS)
    assert caught.value.partial is not None
    assert caught.value.partial.n == 2**13
    partial = xr.load_dataset(path, engine="h5netcdf")
    assert float(partial.mean_volume) == caught.value.partial.mean_volume.value
    result = stream("linearized", P, n=3 * 2**12, store=path, **FEW, **LAWS)
    for name in ("counted", "mean", "squares", "mass", "ends", "bins"):
        np.testing.assert_array_equal(getattr(result.tally, name), getattr(whole.tally, name))
    with pytest.raises(StoreError, match="another distributions"):
        stream("linearized", P, n=2**12, store=path, **FEW, v0=LogNormal(4400.0, 0.2))


@pytest.mark.slow
def test_the_best_angle_of_a_narrow_stream_is_the_particles():
    # The linearized model's α_max depends on k alone: neither speeds nor masses move it.
    result = stream("linearized", P, n=64, sensitivities=False, v0=LogNormal(4400.0, 0.3))
    assert result.nozzle is not None
    exact = np.arctan(2.0) / 2
    # The search ends within 1e-5 rad; V is flat there, known to 1e-9: √1e-9 = 3e-5.
    assert result.nozzle.alpha.value == pytest.approx(exact, abs=1e-4)
    assert result.nozzle.single_alpha == pytest.approx(exact, rel=1e-9, abs=0)
    assert not result.nozzle.at_edge
    assert result.nozzle.curve.argmax() == np.abs(result.nozzle.angles - exact).argmin()
    dataset, numbers = result.to_dataset(), result.to_dict()
    assert float(dataset.alpha_max) == numbers["alpha_max"] == result.nozzle.alpha.value
    assert numbers["model"] == "linearized"
    assert numbers["parameters"]["v0"] == 4400
    assert numbers["units"]["alpha_max"] == "rad"
    assert json.loads(to_json(numbers)) == numbers
    assert "α_max" in str(result)


@pytest.mark.slow
def test_spread_of_the_angle_moves_the_best_angle():
    """V(α) falls more slowly than it rises: a wide jet is best aimed steeper than a particle."""
    spread = 0.2
    found = stream("linearized", P, n=64, sensitivities=False, alpha=Normal(0.35, spread))
    # By Gauss-Hermite quadrature of the closed form, with misses and reflections.
    nodes, weights = np.polynomial.hermite_e.hermegauss(200)
    angles = np.linspace(0.4, 0.8, 4001)
    each = angles[:, None] + spread * nodes
    folded = np.where(each > np.pi / 2, np.pi - each, each)
    volume = np.where(folded > 0, np.asarray(LinearizedCut().volume(P.replace(alpha=np.abs(folded) + 1e-12))), 0)
    best = angles[(volume @ weights).argmax()]
    assert found.nozzle is not None
    assert found.nozzle.alpha.value == pytest.approx(best, abs=3e-3)
    assert found.nozzle.alpha.low - 1e-3 < best < found.nozzle.alpha.high + 1e-3
    assert best > np.arctan(2.0) / 2 + 0.01


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "must include a distribution"),
        ({"v0": 3.0}, TypeError, "`v0` must be a distribution"),
        ({"v0": Normal(3.0, 1.5)}, ValueError, r"`v0` must be positive, but 2\.3% of"),
        ({"speed": Normal(1, 1)}, TypeError, "`speed` is not a parameter"),
        ({**LAWS, "n": 0}, ValueError, "`n` must be a whole number of at least 1"),
        ({**LAWS, "points": "halton"}, ValueError, "`points` must be"),
        ({**LAWS, "store": "out.csv"}, ValueError, r"must end in \.nc"),
        ({**LAWS, "store": "/nowhere/out.nc"}, OSError, "No such file or directory: '/nowhere/out.nc'"),
    ],
)
def test_bad_arguments_are_one_sentence(arguments, error, message):
    with pytest.raises(error, match=message):
        stream("linearized", P, **arguments)
