"""A pipe elbow, from an STL in mm and a plain CSV to mm a year, against the sum row by row and DNV's own bend."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.cfd.map_result import MapSummary
from erosion.cfd.read import read_impacts, read_surface
from erosion.cfd.surface import Surface
from tests.cfd.parts import write
from tests.cfd.tables import quadrilaterals
from tests.correlations.test_erosion import pipes

PIPE, RADIUS, SPEED, SIZE, ROWS = 0.1, 0.15, 20.0, 250e-6, 100_000
MASS = 2650 * np.pi / 6 * SIZE**3
A_YEAR = 100 / 86400 * 365.25 * 86400.0  # kg of 100 kg/day


def loss(alpha: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """E of carbon steel [m³/kg], as DNVGL-RP-O501 (2015) prints it."""
    sine = np.sin(alpha)
    shape = 0.6 * (sine + 7.2 * (sine - sine**2)) ** 0.6 * (1 - np.exp(-20 * alpha))
    return 2e-9 * speed**2.6 * shape / 7800


def elbow(around: int = 48) -> Surface:
    turn, along = np.meshgrid(2 * np.pi * np.arange(around) / around, np.radians(np.linspace(0, 90, around - 2)))
    off = RADIUS + PIPE / 2 * np.cos(turn)
    points = np.stack([off * np.sin(along), RADIUS - off * np.cos(along), PIPE / 2 * np.sin(turn)], axis=-1)
    return quadrilaterals(points[:, ::-1], closed=True)


def test_the_wear_of_an_elbow(tmp_path: Path) -> None:
    write(elbow(), tmp_path / "elbow.stl", 1e3)
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


COARSE = elbow(24)
Columns = dict[str, np.ndarray]


def impacts() -> tuple[Columns, float, float]:
    """Impacts on faces that meet the stream, their total wear [m³], and the greatest depth [m]."""
    rng, rows = np.random.default_rng(1), 2000
    face = rng.choice(np.flatnonzero(COARSE.normal[:, 0] > 0.15), rows)
    velocity = SPEED * np.stack([np.ones(rows), *0.02 * rng.standard_normal((2, rows))], axis=1)
    speed, size, count = np.linalg.norm(velocity, axis=1), rng.uniform(2e-4, 3e-4, rows), rng.uniform(50, 150, rows)
    alpha = np.arcsin(np.einsum("ij,ij->i", velocity, COARSE.normal[face]) / speed)
    wear = count * 2650 * np.pi / 6 * size**3 * loss(alpha, speed)
    mass = {"density [kg/m^3]": np.full(rows, 2650.0), "count": count}
    place = dict(zip(("x [mm]", "y [mm]", "z [mm]"), 1e3 * COARSE.centre[face].T, strict=True))
    moves = dict(zip(("u [m/s]", "v [m/s]", "w [m/s]"), velocity.T, strict=True))
    depth = np.bincount(face, wear, COARSE.faces) / COARSE.area
    return {**place, **moves, "diameter [um]": 1e6 * size, **mass}, float(wear.sum()), float(depth.max())


CLEAN, TOTAL, DEPTH = impacts()


def text(columns: Columns, mark: str = ",") -> str:
    rows = (mark.join(f"{number:.9g}" for number in row) for row in zip(*columns.values(), strict=True))
    return "\n".join([mark.join(columns), *rows, ""])


def answer(path: Path, surface: Surface = COARSE) -> tuple[bool, str]:
    """Whether a map is right to 5 %, in total and where it is deepest, and all that is said; a refusal is not right."""
    try:
        table = read_impacts(path)
        wear = erosion.erosion_map("dnv:carbon-steel", erosion.TABLE_1.to("si"), table, surface)
    except ValueError as error:
        return False, str(error)
    errors = float(wear["total_volume"]) / TOTAL - 1, float(wear["depth"].max()) / DEPTH - 1
    summary = MapSummary(wear)
    return max(map(abs, errors)) < 0.05, " ".join([*summary.warnings, wear.attrs["read_as"]])


def times(factor: float, *names: str) -> Callable[[Columns], Columns]:
    return lambda columns: {head: v * factor if head.split(" ")[0] in names else v for head, v in columns.items()}


def swapped(one: str, other: str) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {one: columns[other], other: columns[one]}


def renamed(old: str, new: str, factor: float = 1.0) -> Callable[[Columns], Columns]:
    return lambda columns: {
        new if head == old else head: v * factor if head == old else v for head, v in columns.items()
    }


def every_7th(name: str, value: float) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {name: np.where(np.arange(2000) % 7 == 0, value, columns[name])}


def row_17(name: str, factor: float) -> Callable[[Columns], Columns]:
    return lambda columns: columns | {name: np.where(np.arange(2000) == 17, factor, 1.0) * columns[name]}


def with_digits(*forms: str) -> Callable[[Columns], Columns]:
    def rounded(values: np.ndarray) -> list[np.ndarray]:
        return [np.array([float(format(number, form)) for number in values]) for form in forms]

    return lambda columns: {head: np.concatenate([v, *rounded(v)]) for head, v in columns.items()}


def elongated(values: np.ndarray) -> np.ndarray:
    return np.r_[values, values.astype(np.float32)]


# What is done to the table, and what shows it: a refusal, a finding, or a number of the block `Read:`.
TABLES: dict[str, tuple[Callable[[Columns], Columns], str]] = {
    "km/h": (times(3.6, "u", "v", "w"), "mean 72.03 m/s"),
    "ft/s": (times(3.2808, "u", "v", "w"), "mean 65.6"),
    "mm/s": (times(1e3, "u", "v", "w"), "mean 2.001e+04 m/s"),
    "slow": (times(0.01, "u", "v", "w"), "mean 0.2"),
    "backwards": (times(-1, "u", "v", "w"), "after the rebound"),
    "radii": (times(0.5, "diameter"), "size: 100 to 150 um"),
    "radius": (renamed("diameter [um]", "radius [um]", 0.5), "'radius [um]' has the unit of a length"),
    "sizes in mm": (times(1e-3, "diameter"), "size: 0.2"),
    "steel": (times(7800 / 2650, "density"), "7800 kg/m³"),
    "g/cm^3": (times(1e-3, "density"), "2.65 kg/m³"),
    "grams": (renamed("density [kg/m^3]", "mass [kg]", 1e-9), " kg/m³"),
    "m": (times(1e-3, "x", "y", "z"), "The impacts lie in"),
    "inches": (times(1 / 25.4, "x", "y", "z"), "The impacts lie in"),
    "x and y": (swapped("x [mm]", "y [mm]"), "The impacts lie in"),
    "u and v": (swapped("u [m/s]", "v [m/s]"), "after the rebound"),
    "size and density": (swapped("diameter [um]", "density [kg/m^3]"), "size: 2650 um, 200"),
    "size and count": (swapped("diameter [um]", "count"), "size: 50."),
    "NaN": (every_7th("u [m/s]", np.nan), "row 1: column `u [m/s]` has no number"),
    "backwards at times": (every_7th("u [m/s]", -SPEED), "of which 1,714 hit"),
    "no weight": (every_7th("count", 0.0), "286 rows that hit have the weight 0"),
    "negative": (every_7th("count", -1.0), "row 1: `count` must be a number of at least 0"),
    "infinite": (every_7th("count", np.inf), "row 1: column `count` must be finite"),
    "one weight": (row_17("count", 1e4), "Row 18 of a.csv alone does"),
    "one size": (row_17("diameter [um]", 10.0), "Row 18 of a.csv alone does"),
    "one size on a face": (row_17("diameter [um]", 4.0), "one of them does most of its wear"),
    "rows of rows": (lambda columns: columns | {"count": np.arange(2000) + 1.0}, "1 to 2000 a row"),
    "twice": (lambda columns: {head: np.tile(v, 2) for head, v in columns.items()}, "repeat another one"),
    "twice, once in single precision": (
        lambda columns: {head: elongated(v) for head, v in columns.items()}, "repeat another one"),
    "twice, once with four digits": (with_digits(".4g"), "rows: 4,000"),
    "half": (lambda columns: {head: v[:1000] for head, v in columns.items()}, "rows: 1,000"),
    "shifted by 1 %": (lambda columns: columns | {"z [mm]": columns["z [mm]"] + 3.0}, "The impacts lie in"),
    "shifted by 10 %": (lambda columns: columns | {"x [mm]": columns["x [mm]"] + 30.0}, "The impacts lie in"),
    "shifted by 50 %": (lambda columns: columns | {"y [mm]": columns["y [mm]"] - 150.0}, "The impacts lie in"),
    **{name: (renamed("count", name), "`each_row`" if name in ("rep", "scaling") else f"{name!r}")
       for name in ("n", "weight", "number", "multiplicity", "particles", "parcel size", "strength", "rep", "scaling")},
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_no_wrong_number_is_hidden(tmp_path: Path, name: str) -> None:
    change, words = TABLES[name]
    (tmp_path / "a.csv").write_text(text(change(CLEAN)))
    is_right, said = answer(tmp_path / "a.csv")
    assert words in said
    assert not is_right


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("is_facing", [False, True])
def test_turned_normals(tmp_path: Path, share: float, is_facing: bool) -> None:
    (tmp_path / "a.csv").write_text(text(CLEAN))
    surface = COARSE.reversed(np.random.default_rng(3).random(COARSE.faces) < share)
    is_right, said = answer(tmp_path / "a.csv", dataclasses.replace(surface, turned=False, is_facing=is_facing))
    assert is_right == (not is_facing or share == 0)
    assert is_right or "rebound" in said or "away from it" in said
