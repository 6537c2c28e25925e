"""The wall that sand takes from pipes: the numbers that pysand's tests hold of DNV RP-O501 [mm/t]."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from erosion.correlations import OutOfRangeWarning

_FILE = importlib.util.spec_from_file_location("pipes", Path(__file__).parents[2] / "examples" / "pipes.py")
assert _FILE is not None
assert _FILE.loader is not None
pipes = importlib.util.module_from_spec(_FILE)
_FILE.loader.exec_module(pipes)

# pysand compares to 1e-5 mm/t; three of its bends are the standard's own, chapter 4.7 and its validation.
AS_PRINTED = 1e-5

BENDS = [
    ((29.3, 30.0, 1.5e-5, 1.75, 1.0, 0.0978, 0.28e-3), 0.255158),
    ((15.0, 2.0, 4e-4, 1.5, 2.0, 0.1, 0.4e-3), 0.003665),
    ((15.0, 333.3, 3.4e-4, 1.5, 1.0, 0.1, 0.25e-3), 0.014322),
    ((23.0, 350.0, 1e-4, 15.0, 2.0, 0.124, 0.2e-3), 0.009207),  # a flexible pipe
]


@pytest.mark.parametrize(("given", "loss"), BENDS)
def test_bends(given, loss):
    speed, density, viscosity, radius, factor, pipe, diameter = given
    flow = pipes.Flow(speed, density, viscosity, diameter)
    computed = pipes.bend(flow, pipe=pipe, radius=radius, geometry_factor=factor)
    assert float(computed) == pytest.approx(loss, abs=AS_PRINTED)


def test_a_blinded_tee_and_a_straight_pipe():
    tee = pipes.blinded_tee(pipes.Flow(30.0, 400.0, 1e-3, 0.3e-3), pipe=0.1, geometry_factor=2.0)
    assert float(tee) == pytest.approx(0.054024, abs=AS_PRINTED)
    assert float(pipes.straight_pipe(15.0, pipe=0.1)) == pytest.approx(9.05e-5, rel=1e-3)


@pytest.mark.parametrize(("material", "loss"), [("duplex", 0.700978), ("dc-05-tungsten", 0.001721)])
def test_a_choke_gallery(material, loss):
    flow = pipes.Flow(30.0, 450.0, 5e-4, 0.5e-3)
    computed = pipes.choke_gallery(flow, pipe=0.15, radius=0.15, gap=0.04, height=0.15, material=material)
    assert float(computed) == pytest.approx(loss, abs=AS_PRINTED)


def test_a_tee_in_a_gas_takes_the_other_branch():
    """Particles 40 times as dense as the fluid: the shape factor is 1, and large ones lose as (d/d_c)^c."""
    ratio, reynolds = 2650 / 20.0, 20.0 * 0.1 * 20.0 / 1.5e-5
    critical = 0.0035 * (ratio / 40) ** ((np.log(reynolds / 1e4 + 1) + 1) ** -0.6 - 1.2) * 0.1
    normal = 2e-9 * 20.0**2.6 / 7850 / (np.pi / 4 * 0.01) * 1e6
    large = -0.3 * (1 - 1.01 ** (40 - ratio))
    for diameter, exponent in ((critical / 2, 19 / np.log(reynolds)), (2 * critical, large)):
        loss = pipes.blinded_tee(pipes.Flow(20.0, 20.0, 1.5e-5, diameter), pipe=0.1)
        assert float(loss) == pytest.approx(normal * (diameter / critical) ** exponent, rel=1e-12)


def test_pipes_broadcast():
    loss = pipes.bend(pipes.Flow(np.array([10.0, 20.0]), 100.0, 1e-5, 2e-4), pipe=0.1, radius=1.5)
    assert loss.shape == (2,)
    assert loss[1] > loss[0]


def test_sizes_beyond_the_standards_are_said():
    with pytest.warns(OutOfRangeWarning, match=r"diameters from 2e-05 m to 0.005 m: 1e-05 m is 2 times less"):
        pipes.bend(pipes.Flow(10.0, 100.0, 1e-5, 1e-5), pipe=0.1, radius=1.5)
