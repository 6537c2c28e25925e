"""A pipe elbow, from an STL in mm and a plain CSV to mm a year, against the sum row by row and DNV's own bend."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.cfd.read import read_impacts, read_surface
from tests.cfd.parts import write
from tests.cfd.tables import quadrilaterals
from tests.correlations.test_pipes import pipes

pytestmark = pytest.mark.slow

PIPE, RADIUS, SPEED, SIZE, ROWS = 0.1, 0.15, 20.0, 250e-6, 100_000
MASS = 2650 * np.pi / 6 * SIZE**3
A_YEAR = 100 / 86400 * 365.25 * 86400.0  # kg of 100 kg/day


def loss(alpha: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """E of carbon steel [m³/kg], as DNVGL-RP-O501 (2015) prints it."""
    sine = np.sin(alpha)
    shape = 0.6 * (sine + 7.2 * (sine - sine**2)) ** 0.6 * (1 - np.exp(-20 * alpha))
    return 2e-9 * speed**2.6 * shape / 7800


def test_the_wear_of_an_elbow(tmp_path: Path) -> None:
    turn, along = np.meshgrid(2 * np.pi * np.arange(48) / 48, np.radians(np.linspace(0, 90, 46)))
    off = RADIUS + PIPE / 2 * np.cos(turn)
    points = np.stack([off * np.sin(along), RADIUS - off * np.cos(along), PIPE / 2 * np.sin(turn)], axis=-1)
    write(quadrilaterals(points[:, ::-1], closed=True), tmp_path / "elbow.stl", 1e3)
    # Sand comes straight along x, evenly over the pipe, until it meets the outer side.
    rng = np.random.default_rng(0)
    r, t = PIPE / 2 * np.sqrt(rng.random(ROWS)), rng.uniform(0, 2 * np.pi, ROWS)
    y, z = r * np.cos(t), r * np.sin(t)
    x = np.sqrt((RADIUS + np.sqrt(PIPE**2 / 4 - z**2)) ** 2 - (RADIUS - y) ** 2)
    velocity = SPEED * np.stack([np.ones(ROWS), *0.02 * rng.standard_normal((2, ROWS))], axis=1)
    table = np.column_stack([1e3 * x, 1e3 * y, 1e3 * z, velocity, np.full(ROWS, 1e6 * SIZE)])
    head = "x,y,z,vel_x,vel_y,vel_z,diameter_um"
    np.savetxt(tmp_path / "hits.csv", table, fmt="%.17g", delimiter=",", header=head, comments="")

    impacts = read_impacts(tmp_path / "hits.csv", particle_density=2650, columns="x,y,z=mm, vel_x,vel_y,vel_z=m/s")
    surface = read_surface(tmp_path / "elbow.stl", unit="mm")
    rate: dict[str, Any] = {"sand_rate": "100 kg/day", "injected": f"{ROWS * MASS!r} kg"}
    wear = erosion.erosion_map("dnv:carbon-steel", erosion.TABLE_1.to("si"), impacts, surface, **rate)

    # The same sum, row by row.
    face, _ = surface.nearest(table[:, :3] * 1e-3)
    speed = np.linalg.norm(velocity, axis=1)
    normal = np.einsum("ij,ij->i", velocity, surface.normal[face])
    hit = normal > 0
    alpha = np.arcsin(normal[hit] / speed[hit])
    volume = np.bincount(face[hit], loss(alpha, speed[hit]) * MASS, surface.faces)
    expected = volume / surface.area * 1e3 * A_YEAR / (ROWS * MASS)
    np.testing.assert_allclose(wear["depth_per_year"], expected, rtol=1e-10)
    assert hit.mean() > 0.99

    # An even stream on planes at each angle, and DNV's bend, whose factor 2.5 is for what is denser than even.
    steepest = np.arccos((RADIUS - PIPE / 2) / (RADIUS + PIPE / 2))
    angles = np.linspace(0.01, steepest, 1000)
    flux = A_YEAR / (np.pi / 4 * PIPE**2)
    even = 1e3 * flux * float((loss(angles, np.array(SPEED)) * np.sin(angles)).max())
    worst = np.sort(wear["depth_per_year"].values)[-20:]
    assert float(np.median(worst)) == pytest.approx(even, rel=0.25)  # some 100 rows a face
    flow = pipes.Flow(SPEED, 1.2, 1.8e-5, SIZE)
    bend = float(pipes.bend(flow, pipe=PIPE, radius=RADIUS / PIPE, material="carbon-steel")) * A_YEAR / 1e3
    assert bend / 2.5 < even < 2.5 * bend
    assert bend / 2.5 < float(np.median(worst)) < 2.5 * bend
