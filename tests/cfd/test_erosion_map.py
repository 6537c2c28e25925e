"""Maps of wear: sums over rows, face by face, against the same sums made row by row."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

import erosion
import erosion.cfd.erosion_map
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import MapSummary
from erosion.cfd.rows import ImpactsError
from erosion.correlations import CORRELATIONS
from erosion.distributions import Normal
from tests.cfd.tables import Table, hump, sand, warnings_of

pytestmark = pytest.mark.slow

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


def test_faces_patches_and_totals_are_the_sums_of_the_rows() -> None:
    table = sand(SURFACE, 3000)
    wear = erosion_map("rotating", P, table, SURFACE, density=2700.0)
    rows = rows_of(table)
    np.testing.assert_allclose(wear["volume"], by_face(rows, table), rtol=1e-12)
    assert float(wear["total_volume"]) == pytest.approx(math.fsum(rows), rel=1e-12, abs=0)
    of_patch = [math.fsum(rows[SURFACE.patch[table.columns["face"]] == i]) for i in range(2)]
    np.testing.assert_allclose(wear["patch_volume"], of_patch, rtol=1e-12)
    mass = table.columns["count"] * table.columns["mass"]
    np.testing.assert_allclose(wear["erodent"], by_face(mass, table), rtol=1e-12)
    np.testing.assert_allclose(wear["depth"], wear["volume"] / SURFACE.area, rtol=1e-12)
    np.testing.assert_allclose(wear["mass"], 2700 * wear["volume"], rtol=1e-12)
    np.testing.assert_allclose(wear["mass_flux"], wear["mass"] / SURFACE.area / 2.0, rtol=1e-12)
    np.testing.assert_allclose(wear["depth_per_year"], wear["depth"] / 2.0 * 31557600e3, rtol=1e-12)
    np.testing.assert_allclose(wear["erosion"], wear["volume"] / wear["erodent"], rtol=1e-12)
    np.testing.assert_allclose(wear["relative_error"] * wear["volume"], np.sqrt(by_face(rows**2, table)), rtol=1e-12)
    alpha, _ = angle_and_speed(table)
    count = table.columns["count"]
    mean = by_face(count * alpha, table) / by_face(count, table)
    np.testing.assert_allclose(wear["alpha_mean"], mean, rtol=1e-12)
    assert int(wear["ends"].sum()) == int(wear["total_impacts"]) == 3000
    assert wear["volume"].attrs["units"] == "m^3"
    assert wear["depth_per_year"].attrs["units"] == "mm/year"


def test_finnie_is_the_formula_that_openfoam_sums() -> None:
    # applications of `ParticleErosion`: β = ½, K = k and σ = p, per parcel.
    table, k, psi, stress = sand(SURFACE, 500), 2.0, 2.0, 2.7e9
    p = P.replace(k=k, psi=psi, sigma=stress, inertia=0.5)
    alpha, speed = angle_and_speed(table)
    low = np.sin(2 * alpha) - 6 / k * np.sin(alpha) ** 2
    shape = np.where(np.tan(alpha) < k / 6, low, k / 6 * np.cos(alpha) ** 2)
    q = table.columns["count"] * table.columns["mass"] * speed**2 / (stress * psi * k) * shape
    np.testing.assert_allclose(erosion_map("finnie", p, table, SURFACE)["volume"], by_face(q, table), rtol=1e-9)


@pytest.mark.parametrize("block", [1, 7, 100, 10**6])
def test_the_bits_do_not_depend_on_the_blocks(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", 128)
    table, law = sand(SURFACE, 300), Normal(0.0, 1e4)
    whole = erosion_map("rotating", P, table, SURFACE, spin=law, seed=3)
    cut = erosion_map("rotating", P, sand(SURFACE, 300, block=block), SURFACE, spin=law, seed=3)
    assert whole.identical(cut)


def test_in_other_units_it_is_the_same_wear() -> None:
    table = sand(SURFACE, 500)
    there = erosion_map("rotating", P.to("inch-pound"), table, SURFACE)
    here = erosion_map("rotating", P, table, SURFACE)
    np.testing.assert_allclose(there["volume"] * 0.0254**3, here["volume"], rtol=1e-8)
    np.testing.assert_allclose(there["depth"] * 0.0254, here["depth"], rtol=1e-8)
    np.testing.assert_allclose(there["depth_per_year"], here["depth_per_year"], rtol=1e-8)
    assert there["erodent"].attrs["units"] == "slinch"


def test_the_standard_error_covers_what_another_sample_gives() -> None:
    table, rng, within, of_faces = sand(SURFACE, 600), np.random.default_rng(7), 0, []
    for _ in range(200):
        half = rng.random(600) < 0.5
        first, other = (erosion_map("linearized", P, table.only(rows), SURFACE) for rows in (half, ~half))
        errors = [float(wear["total_volume"] * wear["total_relative_error"]) for wear in (first, other)]
        within += abs(float(first["total_volume"] - other["total_volume"])) <= 2 * math.hypot(*errors)
        error = np.hypot(*[(wear["patch_volume"] * wear["patch_relative_error"]).values for wear in (first, other)])
        of_faces.append(np.abs(first["patch_volume"] - other["patch_volume"]) <= 2 * error)
    assert 0.90 * 200 <= within <= 0.99 * 200
    assert 0.90 <= np.mean(of_faces) <= 0.99


class TestBodies:
    def test_without_a_diameter_the_particle_of_the_case_has_its_mass(self) -> None:
        table = sand(SURFACE, 50).replace(mass=np.full(50, 8 * float(P.m)))
        rows = rows_of(table, r=2 * P.r, b=2 * P.b)
        total = erosion_map("rotating", P, table, SURFACE)["total_volume"]
        assert float(total) == pytest.approx(math.fsum(rows), rel=1e-12, abs=0)

    def test_with_a_diameter_the_size_counts(self) -> None:
        table = sand(SURFACE, 50)
        growth = table.columns["diameter"] / 2e-4
        rows = rows_of(table, r=P.r * growth, b=P.b * growth)
        here = erosion_map("rotating", P, table, SURFACE, diameter=2e-4)
        assert float(here["total_volume"]) == pytest.approx(math.fsum(rows), rel=1e-12, abs=0)
        there = erosion_map("rotating", P.to("inch-pound"), table, SURFACE, diameter=2e-4 / 0.0254)
        assert float(there["total_volume"]) * 0.0254**3 == pytest.approx(math.fsum(rows), rel=1e-8, abs=0)

    def test_or_all_have_the_same_r_and_b(self) -> None:
        table = sand(SURFACE, 50)
        rows = rows_of(table, r=P.r, b=P.b)
        total = erosion_map("rotating", P, table, SURFACE, scaling="none")["total_volume"]
        assert float(total) == pytest.approx(math.fsum(rows), rel=1e-12, abs=0)

    def test_the_spin_is_the_columns_the_cases_or_none(self) -> None:
        spins = np.random.default_rng(1).normal(0, 2e4, 50)
        table, spinning = sand(SURFACE, 50).replace(spin=spins), P.replace(phidot0=5e3)

        def total(table: Table, **options: Any) -> float:
            return float(erosion_map("rotating", spinning, table, SURFACE, **options)["total_volume"])

        plain = table.replace(spin=None)
        of_column, of_case, of_none = (math.fsum(rows_of(table, phidot0=spin)) for spin in (spins, 5e3, 0.0))
        assert total(table) == total(table, spin="column") == pytest.approx(of_column, rel=1e-12, abs=0)
        assert total(plain) == total(table, spin="case") == pytest.approx(of_case, rel=1e-12, abs=0)
        assert total(table, spin="none") == pytest.approx(of_none, rel=1e-12, abs=0)
        law = Normal(0.0, 2e4)
        assert total(table, spin=law, seed=1) == total(plain, spin=law, seed=1) != total(table, spin=law, seed=2)

    def test_a_correlation_knows_the_size_and_the_density_of_a_row(self) -> None:
        table = sand(SURFACE, 50)
        table = table.replace(mass=table.columns["mass"] * 3900 / 2650)
        alpha, speed = angle_and_speed(table)
        ratio = CORRELATIONS["oka"].erosion(alpha, speed, diameter=table.columns["diameter"])
        wear = erosion_map("oka", P, table, SURFACE)
        mass = table.columns["count"] * table.columns["mass"]
        assert float(wear["total_mass"]) == pytest.approx(math.fsum(np.asarray(ratio) * mass), rel=1e-9, abs=0)


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
    table = sand(SURFACE, 50)
    model = erosion.load_model(path)
    assert float(erosion_map(path, P, table, SURFACE)["total_volume"]) > 0
    changed = erosion_map(model.replace(friction=0.5), P, table, SURFACE)
    assert "friction = 0.5" in changed.attrs["own_parameters"]


def test_without_a_surface_there_are_totals() -> None:
    table = sand(SURFACE, 200)
    alpha, speed = angle_and_speed(table)
    plain = table.replace(velocity=None, face=None, position=None, speed=speed, alpha=alpha)
    wear, there = erosion_map("rotating", P, plain), erosion_map("rotating", P, table, SURFACE)
    assert "volume" not in wear
    assert float(wear["total_volume"]) == pytest.approx(float(there["total_volume"]), rel=1e-12, abs=0)
    assert list(wear["patch"].values) == ["all"]


class TestRows:
    def test_the_rebound_is_undone(self) -> None:
        table, (e, friction) = sand(SURFACE, 300), (0.7, 0.2)
        normal = SURFACE.normal[table.columns["face"]]
        into = np.sum(table.columns["velocity"] * normal, axis=1)[:, None] * normal
        after = table.replace(velocity=-e * into + (1 - friction) * (table.columns["velocity"] - into))
        undone = erosion_map("rotating", P, after, SURFACE, restitution=(e, friction))
        np.testing.assert_allclose(undone["volume"], erosion_map("rotating", P, table, SURFACE)["volume"], rtol=1e-8)
        with pytest.raises(ImpactsError, match=r"in 300 of 300 rows n·U is not positive: .* after the rebound"):
            erosion_map("rotating", P, after, SURFACE)
        with pytest.raises(ImpactsError, match="look like velocities before the rebound"):
            erosion_map("rotating", P, table, SURFACE, restitution=(e, friction))

    def test_errors_say_that_they_are_by_sampling_alone(self) -> None:
        wear = erosion_map("rotating", P, sand(SURFACE, 100), SURFACE)
        assert "by sampling the impacts alone" in MapSummary(wear).rows()[0].meaning

    def test_what_is_stuck_or_recedes_is_counted_apart(self) -> None:
        table = sand(SURFACE, 100)
        velocity = table.columns["velocity"].copy()
        velocity[:5] = 0.0
        velocity[5:15] *= -1.0
        wear = erosion_map("rotating", P, table.replace(velocity=velocity), SURFACE)
        assert list(wear["left_out"].values) == [5, 10, 0, 0]
        assert int(wear["total_impacts"]) == 85
        lost = (table.columns["count"] * table.columns["mass"])[5:15].sum()
        assert float(wear["left_out_mass"][1]) == pytest.approx(lost, rel=1e-12, abs=0)
        same = erosion_map("rotating", P, table.only(slice(15, None)), SURFACE)
        assert float(wear["total_volume"]) == pytest.approx(float(same["total_volume"]), rel=1e-12, abs=0)
        assert warnings_of(wear) == [
            "5 of 100 rows have no velocity, as parcels that stick to a wall, and are not counted.",
            "10 of 100 rows move along the surface or away from it (n·U ≤ 0), and are not counted.",
        ]

    def test_a_row_without_a_face_goes_to_the_nearest(self) -> None:
        table = sand(SURFACE, 200)
        shift = 1e-4 * SURFACE.normal[table.columns["face"]]
        plain = table.replace(face=None, position=table.columns["position"] + shift)
        wear, there = erosion_map("rotating", P, plain, SURFACE), erosion_map("rotating", P, table, SURFACE)
        np.testing.assert_array_equal(wear["volume"], there["volume"])
        assert int(wear["rows_to_nearest"]) == 200
        assert float(wear["distance_max"]) == pytest.approx(1e-4, rel=0.05, abs=0)  # the faces are not plane
        assert float(wear["distance_median"]) == pytest.approx(1e-4, rel=0.05, abs=0)
        some = table.replace(face=np.where(np.arange(200) < 50, -1, table.columns["face"]))
        mixed = erosion_map("rotating", P, some, SURFACE)
        np.testing.assert_array_equal(mixed["volume"], there["volume"])
        assert int(mixed["rows_to_nearest"]) == 50

    def test_rows_beyond_the_limit_are_listed(self) -> None:
        table = sand(SURFACE, 100)
        position = table.columns["position"].copy()
        position[[3, 50, 60, 70], 2] += 0.1
        table = table.replace(face=None, position=position)
        wear = erosion_map("rotating", P, table, SURFACE, limit=0.05)
        assert int(wear["total_impacts"]) == 96
        (sentence,) = warnings_of(wear)
        assert sentence.startswith(
            "4 of 100 rows lie farther from their face than the limit, and are not counted: 0.09"
        )
        assert "with a limit of 0.05 m: table.csv: row 4 (0." in sentence
        assert sentence.count("table.csv: row") == 3

    def test_faces_of_the_mesh_are_found_and_others_left_out(self) -> None:
        surface, table = hump(mesh=True), sand(SURFACE, 100)
        face = table.columns["face"] + 1000
        meshed = Table(mesh_faces=True, **{**table.columns, "face": np.where(np.arange(100) < 10, 7, face)})
        wear = erosion_map("rotating", P, meshed, surface)
        assert list(wear["left_out"].values) == [0, 0, 0, 10]
        assert warnings_of(wear) == []  # a table may be of several patches
        same = erosion_map("rotating", P, table.only(slice(10, None)), SURFACE)
        np.testing.assert_array_equal(wear["volume"], same["volume"])
        # A surface of another file than the mesh has no such faces: their positions count.
        there = erosion_map("rotating", P, meshed, SURFACE)
        np.testing.assert_array_equal(there["volume"], erosion_map("rotating", P, table, SURFACE)["volume"])

    def test_impacts_that_fail_are_counted_apart(self, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_progress_tells_the_rows() -> None:
    calls: list[tuple[str, int, int]] = []
    erosion_map("linearized", P, sand(SURFACE, 100), SURFACE, progress=lambda *call: calls.append(call))
    assert calls == [("map", 100, 100)]


def test_the_summary_reads_well() -> None:
    text = str(MapSummary(erosion_map("rotating", P, sand(SURFACE, 500), SURFACE, density=2700.0)))
    assert text.startswith("rotating: table on hump")
    for words in ("48 of 48", "volume front", "greatest depth_per_year", "mm/year", "share rebound", " ± "):
        assert words in text
    numbers = MapSummary(erosion_map("rotating", P, sand(SURFACE, 500), SURFACE)).to_dict()
    assert numbers["patches"]["front"]["volume"] + numbers["patches"]["back"]["volume"] == pytest.approx(
        numbers["total_volume"], abs=0
    )
    assert numbers["units"]["total_volume"] == "m^3"
