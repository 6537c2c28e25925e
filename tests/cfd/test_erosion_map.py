"""Maps of wear: sums over rows, face by face, against the same sums made row by row."""

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
import erosion.cfd.erosion_map
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.rows import ImpactsError
from erosion.correlations import CORRELATIONS, OKA_MATERIALS, oka
from tests.cfd.tables import Table, hump, sand, warnings_of

P = erosion.TABLE_1.to("si")
SURFACE = hump()


def angle_and_speed(table: Table) -> tuple[np.ndarray, np.ndarray]:
    velocity = table.columns["velocity"]
    speed = np.linalg.norm(velocity, axis=1)
    normal = SURFACE.normal[table.columns["face"]]
    return np.arcsin(np.sum(velocity * normal, axis=1) / speed), speed


def by_face(values: np.ndarray, table: Table) -> np.ndarray:
    return np.array([math.fsum(values[table.columns["face"] == face]) for face in range(SURFACE.faces)])


def rows_of(table: Table, **changes: Any) -> np.ndarray:
    """w V of each row, by one call of `impact`."""
    alpha, speed = angle_and_speed(table)
    growth = np.cbrt(table.columns["mass"] / P.m)
    values = {"r": P.r * growth, "b": P.b * growth, "m": table.columns["mass"], "v0": speed, "alpha": alpha, **changes}
    return table.columns["count"] * erosion.impact("rotating", P.replace(**values)).volume


TABLE = sand(SURFACE, 300)


@pytest.fixture(scope="module")
def wear() -> xr.Dataset:
    return erosion_map("rotating", P, TABLE, SURFACE, density=2700.0)


def test_faces_patches_and_totals_are_the_sums_of_the_rows(wear: xr.Dataset) -> None:
    rows, columns = rows_of(TABLE), TABLE.columns
    volume, particle_mass = by_face(rows, TABLE), by_face(columns["count"] * columns["mass"], TABLE)
    of_patch = [math.fsum(rows[SURFACE.patch[columns["face"]] == i]) for i in range(2)]
    particles = by_face(columns["count"], TABLE)
    with np.errstate(invalid="ignore"):
        expected = {
            "volume": volume,
            "total_volume": math.fsum(rows),
            "patch_volume": of_patch,
            "particle_mass": particle_mass,
            "depth": volume / SURFACE.area,
            "mass": 2700 * volume,
            "mass_flux": 2700 * volume / SURFACE.area / 2.0,
            "depth_per_year": volume / SURFACE.area / 2.0 * 31557600e3,
            "erosion": volume / particle_mass,
            "relative_error": np.sqrt(by_face(rows**2, TABLE)) / volume,
            "alpha_mean": by_face(columns["count"] * angle_and_speed(TABLE)[0], TABLE) / particles,
        }
    for name, values in expected.items():
        np.testing.assert_allclose(wear[name], values, rtol=1e-12, err_msg=name)
    assert int(wear["ends"].sum()) == int(wear["total_impacts"]) == 300
    assert (wear["volume"].attrs["units"], wear["depth_per_year"].attrs["units"]) == ("m^3", "mm/year")
    # The unit system shows the numbers alone.
    np.testing.assert_array_equal(erosion_map("rotating", P.to("inch-pound"), TABLE, SURFACE)["volume"], wear["volume"])


def test_finnie_is_the_formula_that_openfoam_sums() -> None:
    # applications of `ParticleErosion`: β = ½, K = k and σ = p, per parcel.
    k, psi, stress = 2.0, 2.0, 2.7e9
    p = P.replace(k=k, psi=psi, sigma=stress, inertia=0.5)
    alpha, speed = angle_and_speed(TABLE)
    low = np.sin(2 * alpha) - 6 / k * np.sin(alpha) ** 2
    shape = np.where(np.tan(alpha) < k / 6, low, k / 6 * np.cos(alpha) ** 2)
    q = TABLE.columns["count"] * TABLE.columns["mass"] * speed**2 / (stress * psi * k) * shape
    np.testing.assert_allclose(erosion_map("finnie", p, TABLE, SURFACE)["volume"], by_face(q, TABLE), rtol=1e-9)


@pytest.mark.parametrize("block", [1, 7, 100, 10**6])
def test_the_bits_do_not_depend_on_the_blocks(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", 128)
    options: dict[str, Any] = {"spin": stats.norm(0.0, 1e4), "seed": 3}
    whole = erosion_map("rotating", P, TABLE, SURFACE, **options)
    assert whole.identical(erosion_map("rotating", P, sand(SURFACE, 300, block=block), SURFACE, **options))


def test_the_standard_error_covers_what_another_sample_gives(wear: xr.Dataset) -> None:
    # Halves of the rows differ by the sum of all with a sign of chance; their errors together are that of all.
    signs, rows = np.random.default_rng(7).choice([-1.0, 1.0], (400, 300)), rows_of(TABLE)
    patch = SURFACE.patch[TABLE.columns["face"]]
    errors = [float(wear["total_relative_error"]), *wear["patch_relative_error"].values]
    for error, part in zip(errors, (patch >= 0, patch == 0, patch == 1), strict=True):
        differences = np.abs(signs[:, part] @ rows[part])
        assert 0.92 <= np.mean(differences <= 2 * error * rows[part].sum()) <= 0.98


FEW = sand(SURFACE, 50)
SPINS = np.random.default_rng(1).normal(0, 2e4, 50)
GROWTH = FEW.columns["diameter"] / 2e-4
HEAVY = FEW.replace(mass=np.full(50, 8 * float(P.m)))
BODIES: dict[str, tuple[Table, dict[str, Any], dict[str, Any]]] = {
    "the particle of the case has its mass": (HEAVY, {}, {"r": 2 * P.r, "b": 2 * P.b}),
    "its diameter counts": (FEW, {"diameter": 2e-4}, {"r": P.r * GROWTH, "b": P.b * GROWTH}),
    "all have the same r and b": (FEW, {"scaling": "none"}, {"r": P.r, "b": P.b}),
    "spins of the table": (FEW.replace(spin=SPINS), {}, {"phidot0": SPINS}),
    "spins of the column": (FEW.replace(spin=SPINS), {"spin": "column"}, {"phidot0": SPINS}),
    "the case's spin": (FEW.replace(spin=SPINS), {"spin": "case"}, {"phidot0": 5e3}),
    "the case's spin without a column": (FEW, {}, {"phidot0": 5e3}),
    "no spin": (FEW.replace(spin=SPINS), {"spin": "none"}, {"phidot0": 0.0}),
}


@pytest.mark.parametrize("what", BODIES)
def test_bodies_follow_the_rows(what: str) -> None:
    table, options, changes = BODIES[what]
    total = erosion_map("rotating", P.replace(phidot0=5e3), table, SURFACE, **options)["total_volume"]
    exact = math.fsum(rows_of(table, **{"phidot0": 5e3, **changes}))
    assert float(total) == pytest.approx(exact, rel=1e-12, abs=0)


def test_a_law_of_the_spin_draws_by_the_seed() -> None:
    law = stats.norm(0.0, 2e4)
    one, same, other = (
        float(erosion_map("rotating", P, table, SURFACE, spin=law, seed=seed)["total_volume"])
        for table, seed in ((FEW, 1), (FEW.replace(spin=SPINS), 1), (FEW, 2))
    )
    assert one == same != other


def test_a_correlation_knows_the_size_and_the_density_of_a_row() -> None:
    table = FEW.replace(mass=FEW.columns["mass"] * 3900 / 2650)
    alpha, speed = angle_and_speed(table)
    ratio = CORRELATIONS["oka"].erosion(alpha, speed, diameter=table.columns["diameter"])
    exact = math.fsum(np.asarray(ratio) * table.columns["count"] * table.columns["mass"])
    assert float(erosion_map("oka", P, table, SURFACE)["total_mass"]) == pytest.approx(exact, rel=1e-9, abs=0)


def test_a_correlation_says_how_much_is_outside_its_range() -> None:
    table = sand(SURFACE, 100)
    fast = np.arange(100) < 25
    velocity = np.where(fast[:, None], 20.0, 1.0) * table.columns["velocity"]  # up to 1600 m/s; made for 200
    wear = erosion_map("dnv:duplex", P, table.replace(velocity=velocity), SURFACE)
    mass = table.columns["count"] * table.columns["mass"]
    assert float(wear["beyond_range"]) == pytest.approx(mass[fast].sum() / mass.sum(), rel=1e-12, abs=0)
    assert "of the mass that hits is outside the range of dnv:duplex." in warnings_of(wear)[0]
    assert wear["total_erosion_ratio"].attrs["units"] == "kg/kg"
    assert "beyond_range" not in erosion_map("linearized", P, table, SURFACE)


def test_any_model_by_path_with_parameters_of_its_own() -> None:
    path = __file__.rsplit("/tests/", 1)[0] + "/models/coulomb_tip.py"
    assert float(erosion_map(path, P, FEW, SURFACE)["total_volume"]) > 0
    changed = erosion_map(erosion.load_model(path).replace(friction=0.5), P, FEW, SURFACE)
    assert "friction = 0.5" in changed.attrs["own_parameters"]


def test_without_a_surface_there_are_totals(wear: xr.Dataset) -> None:
    alpha, speed = angle_and_speed(TABLE)
    plain = erosion_map("rotating", P, TABLE.replace(velocity=None, face=None, position=None, speed=speed, alpha=alpha))
    assert "volume" not in plain
    assert float(plain["total_volume"]) == pytest.approx(float(wear["total_volume"]), rel=1e-12, abs=0)
    assert list(plain["patch"].values) == ["all"]


def test_the_rebound_is_undone(wear: xr.Dataset) -> None:
    velocity, (e, friction) = TABLE.columns["velocity"], (0.7, 0.2)
    normal = SURFACE.normal[TABLE.columns["face"]]
    into = np.sum(velocity * normal, axis=1)[:, None] * normal
    after = TABLE.replace(velocity=-e * into + (1 - friction) * (velocity - into))
    undone = erosion_map("rotating", P, after, SURFACE, restitution=(e, friction))
    np.testing.assert_allclose(undone["volume"], wear["volume"], rtol=1e-8)
    with pytest.raises(ImpactsError, match=r"in 300 of 300 rows n·U is not positive: .* after the rebound"):
        erosion_map("rotating", P, after, SURFACE)
    with pytest.raises(ImpactsError, match="look like velocities before the rebound"):
        erosion_map("rotating", P, TABLE, SURFACE, restitution=(e, friction))


@pytest.mark.parametrize("unnamed", [300, 50])
def test_a_row_without_a_face_goes_to_the_nearest(wear: xr.Dataset, unnamed: int) -> None:
    face = TABLE.columns["face"]
    table = TABLE.replace(position=TABLE.columns["position"] + 1e-4 * SURFACE.normal[face],
                          face=np.where(np.arange(300) < unnamed, -1, face))  # fmt: skip
    found = erosion_map("rotating", P, table, SURFACE)
    np.testing.assert_array_equal(found["volume"], wear["volume"])
    assert int(found["rows_to_nearest"]) == unnamed
    # The faces are not plane.
    assert [float(found[name]) for name in ("distance_max", "distance_median")] == pytest.approx([1e-4] * 2, rel=0.05)


def test_rows_beyond_the_limit_are_listed() -> None:
    position = TABLE.columns["position"].copy()
    position[[3, 50, 60, 70], 2] += 0.1
    left = erosion_map("rotating", P, TABLE.replace(face=None, position=position), SURFACE, limit=0.05)
    assert int(left["total_impacts"]) == 296
    (sentence,) = warnings_of(left)
    assert sentence.startswith("4 of 300 rows lie farther from their face than the limit, and are not counted: 0.09")
    assert "with a limit of 0.05 m: table.csv: row 4 (0." in sentence
    assert sentence.count("table.csv: row") == 3


def test_faces_of_the_mesh_are_found_and_others_left_out(wear: xr.Dataset) -> None:
    face = np.where(np.arange(300) < 10, 7, TABLE.columns["face"] + 1000)
    meshed = Table(mesh_faces=True, **{**TABLE.columns, "face": face})
    left = erosion_map("rotating", P, meshed, hump(mesh=True))
    assert (list(left["left_out"].values), warnings_of(left)) == (
        [0, 0, 0, 10],
        [],
    )  # a table may be of several patches
    same = erosion_map("rotating", P, TABLE.only(slice(10, None)), SURFACE)
    np.testing.assert_array_equal(left["volume"], same["volume"])
    # A surface of another file than the mesh has no such faces: their positions count.
    np.testing.assert_array_equal(erosion_map("rotating", P, meshed, SURFACE)["volume"], wear["volume"])


def test_impacts_that_fail_are_counted_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    table, computed = sand(SURFACE, 40), erosion.cfd.erosion_map.impact
    failed = erosion.impact("rotating", P.replace(v0=[np.nan])).outcome[0]

    def failing(*arguments: Any, **options: Any) -> Any:
        results, lost = computed(*arguments, **options), np.arange(40) < lose
        outcome = np.where(lost, failed, results.outcome)
        return dataclasses.replace(results, volume=np.where(lost, np.nan, results.volume), outcome=outcome)

    monkeypatch.setattr("erosion.cfd.erosion_map.impact", failing)
    lose = 4
    wear = erosion_map("rotating", P, table, SURFACE)
    assert dict(zip(wear["end"].values, wear["ends"].sum("patch").values, strict=True))["failed"] == 4
    assert warnings_of(wear) == ["4 impacts could not be computed, and are not counted."]
    assert int(wear["total_impacts"]) == 36
    lose = 40
    with pytest.raises(erosion.SimulationError, match="of 40 impacts none could be computed"):
        erosion_map("rotating", P, table, SURFACE)


@pytest.mark.parametrize("target", OKA_MATERIALS)
def test_okas_constants_as_printed_give_its_erosion(target: str) -> None:
    model = erosion.models.correlated("oka", target)
    one = {symbol: float(number) for symbol, number in re.findall(r"([\w₀-₉']+) = ([-+.\de]+)", model.formula)}
    sine = np.sin(0.5)
    shape = sine ** one["n₁"] * (1 + one["Hv"] * (1 - sine)) ** one["n₂"]
    expected = one["E₉₀"] * (30 / one["v'"]) ** one["k₂"] * (200 / one["D'"]) ** one["k₃"] * shape
    ratio = oka(0.5, 30.0, 200e-6, material=target)
    assert float(ratio) / float(model.density) == pytest.approx(expected, rel=2e-3)  # four digits are printed
