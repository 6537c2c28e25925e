"""Samples of Fluent, unsteady and steady."""

import math

import numpy as np
import pytest

from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactsError

UNSTEADY = """\
(wall 14)
(x y z u v w diameter t parcel-mass mass n-in-parcel time flow-time name)
((1.5e-02 2e-3 -4.25e-03 12.5 -3 0.5 1e-04 300 2.8e-08 1.4e-09 20 1.5e-02 0.25) injection-0:17)
((1.6e-02 2e-3 -4.25e-03 11.5 -2 0.25 2e-04 300 3.36e-08 1.12e-08 3 1.5e-02 0.5) sand-1:3)
"""
STEADY = """\
(wall 13)
(x y z u v w diameter t mass-flow mass frequency time name)
((0.1 0.2 0.3 1 2 3 1e-4 300 4.2e-6 1.4e-9 3000 0.7) injection-0:1)
"""


def written(path, text):
    path.write_text(text)
    return path


def test_an_unsteady_sample(tmp_path):
    impacts = read_impacts(written(tmp_path / "wall.dpm", UNSTEADY))
    (block,) = impacts.blocks(10)
    np.testing.assert_array_equal(block.position, [(0.015, 0.002, -0.00425), (0.016, 0.002, -0.00425)])
    np.testing.assert_array_equal(block.velocity, [(12.5, -3, 0.5), (11.5, -2, 0.25)])
    np.testing.assert_array_equal(block.count, [20, 3])
    np.testing.assert_array_equal(block.mass, [1.4e-9, 1.12e-8])
    np.testing.assert_array_equal(block.diameter, [1e-4, 2e-4])
    np.testing.assert_array_equal(block.time, [0.25, 0.5])  # the flow's time, not the particle's age
    assert block.face is None
    assert impacts.warnings == ()
    assert impacts.duration is None


def test_a_parcel_may_be_weighed_instead_of_counted(tmp_path):
    text = UNSTEADY.replace(" n-in-parcel", "").replace(" 20 ", " ").replace(" 3 1.5e-02 0.5", " 1.5e-02 0.5")
    (block,) = read_impacts(written(tmp_path / "wall.dpm", text)).blocks(10)
    np.testing.assert_allclose(block.count, [20, 3], rtol=1e-15)


@pytest.mark.parametrize(("duration", "seconds"), [(None, 1.0), (60.0, 60.0)])
def test_rows_of_a_steady_run_hit_for_as_long_as_it_is_said_to_last(tmp_path, duration, seconds):
    impacts = read_impacts(written(tmp_path / "wall.dpm", STEADY), duration=duration)
    (block,) = impacts.blocks(10)
    np.testing.assert_allclose(block.count, [3000 * seconds], rtol=1e-15)
    assert block.time is None
    assert impacts.duration == seconds
    assert bool(impacts.warnings) == (duration is None)
    assert all("what hits in 1 s" in note for note in impacts.warnings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wall.dpm: is empty"),
        ("some text\n", "has no header of Fluent"),
        (UNSTEADY.replace(" z ", " "), "has no column position_z, but the others of the vector"),
        (UNSTEADY.replace("diameter", "diameter mass"), "the header repeats mass"),
        (UNSTEADY.replace(" 12.5", ""), "row 1 has 13 fields, but the header names 14"),
        (UNSTEADY.replace("11.5", "fast"), "row 2: column `u` must be a number, but is 'fast'"),
        (UNSTEADY.replace("11.5", "-nan"), "row 2: column `velocity_x` must be finite, but is nan"),
    ],
)
def test_a_sample_that_cannot_be_used_is_refused(tmp_path, text, message):
    with pytest.raises(ImpactsError, match=message):
        list(read_impacts(written(tmp_path / "wall.dpm", text)).blocks(10))


def test_a_density_beside_masses_is_refused(tmp_path):
    with pytest.raises(ImpactsError, match="the mass of each particle; Argument `particle_density` must be left out"):
        read_impacts(written(tmp_path / "wall.dpm", UNSTEADY), particle_density=math.pi)
