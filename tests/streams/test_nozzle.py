"""The best angle of a nozzle against the closed form of `linearized`."""

import json

import numpy as np
import pytest

import erosion
from erosion.distributions import LogNormal, Normal
from erosion.models.closed_forms import LinearizedCut
from erosion.output.tables import to_json
from erosion.streams.stream import stream

pytestmark = pytest.mark.slow

P = erosion.TABLE_1


def test_the_best_angle_of_a_narrow_stream_is_the_particles():
    # The linearized model's α_max depends on k alone: neither speeds nor masses move it.
    result = stream("linearized", P, n=64, sensitivities=False, v0=LogNormal(4400.0, 0.3))
    assert result.nozzle is not None
    exact = np.arctan(2.0) / 2
    # The search ends within 1e-5 rad; V is flat there, known to 1e-9: √1e-9 = 3e-5.
    assert result.nozzle.alpha.value == pytest.approx(exact, abs=1e-4)
    assert result.nozzle.single_alpha == pytest.approx(exact, rel=1e-9)
    assert not result.nozzle.at_edge
    assert result.nozzle.curve.argmax() == np.abs(result.nozzle.angles - exact).argmin()
    dataset, numbers = result.to_dataset(), result.to_dict()
    assert float(dataset.alpha_max) == numbers["alpha_max"] == result.nozzle.alpha.value
    assert numbers["model"] == "linearized"
    assert numbers["parameters"]["v0"] == 4400
    assert numbers["units"]["alpha_max"] == "rad"
    assert json.loads(to_json(numbers)) == numbers
    assert "α_max" in str(result)


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
