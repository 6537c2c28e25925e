"""Maps of wear: sums over rows, face by face, against the same sums made row by row."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
import erosion.cfd.erosion_map
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import MapSummary
from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactsError
from erosion.correlations import CORRELATIONS, OKA_MATERIALS, oka
from erosion.distributions import Normal
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


HEADS = ("diameter_um", "density [kg/m^3]", "u [m/s]", "v [m/s]", "w [m/s]", "x [mm]", "y [mm]", "z [mm]", "count")
UNDERSTOOD = {
    "right": ({}, " and 2650 kg/m³, 0.008171 kg in all, at 20.01 to 79.72 m/s, on average 49.69 m/s", ""),
    "mm/s": ({"u": 1e3, "v": 1e3, "w": 1e3}, "on average 4.969e+04 m/s", "The mean speed is 4.97e+04 m/s, at which"),
    "ft/s": ({"u": 3.2808, "v": 3.2808, "w": 3.2808}, "on average 163 m/s", ""),
    "slow": ({"u": 1e-3, "v": 1e-3, "w": 1e-3}, "on average 0.04969 m/s", "The mean speed is 0.0497 m/s, at which"),
    "radii": ({"diameter_um": 0.5}, "of 50.06 to 249.4 um and 2650 kg/m³, 0.001021 kg in all", ""),
    "steel": ({"density": 2.943}, "of 100.1 to 498.8 um and 7799 kg/m³, 0.02405 kg in all", ""),
    "in m": ({"diameter_um": 1e-6}, "of 0.0001001 to 0.0004988 um", "diameters of 1e-10 to 4.99e-10 m, as no"),
    "a cut file": ({}, "Read: 150 rows, diameter from diameter_um in um; density from density in kg/m^3; velocity", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", UNDERSTOOD)
def test_how_a_table_was_understood_is_said(tmp_path: Path, name: str) -> None:
    """With the numbers in the units of the table, so that a wrong unit shows."""
    changed, words, doubt = UNDERSTOOD[name]
    of, rows = TABLE.columns, 150 if name == "a cut file" else 300
    columns = [of["diameter"] * 1e6, np.full(300, 2650.0), *of["velocity"].T, *of["position"].T * 1e3, of["count"]]
    numbers = [values * changed.get(head.split(" ")[0], 1.0) for head, values in zip(HEADS, columns, strict=True)]
    np.savetxt(tmp_path / "a.csv", np.column_stack(numbers)[:rows], delimiter=",", header=",".join(HEADS), comments="")
    summary = MapSummary(erosion_map("dnv", P, read_impacts(tmp_path / "a.csv"), SURFACE))
    assert words in summary.to_dict()["read_as"]
    said = [sentence for sentence in summary.warnings if "far from what tests" not in sentence]
    assert doubt in " ".join(said)
    assert bool(said) == bool(doubt) or "outside the range" in " ".join(said)


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("count", 1e3, "Row 18 of table.csv alone does about 53 %"),
        ("speed", 14.0, "Row 18 of table.csv alone does about 52 %"),
        ("count", 10.0, ""),
        ("weights", 0.0, "150 rows that hit have the weight 0"),
    ],
)
def test_rows_of_too_much_weight_or_none_are_said(column: str, factor: float, words: str) -> None:
    alike = {"count": 1.0, "mass": 2e-8, "diameter": 2.43e-4, "speed": 30.0, "alpha": 0.4}
    table = sand(SURFACE, 900).replace(velocity=None, **{name: np.full(900, value) for name, value in alike.items()})
    field = "count" if column == "weights" else column
    values = table.columns[field].copy()
    values[slice(0, 150) if column == "weights" else 17] *= factor
    said = warnings_of(erosion_map("dnv", P, table.replace(**{field: values}), SURFACE))
    said = [sentence for sentence in said if "outside the range" not in sentence]
    assert len(said) == bool(words)
    assert words in " ".join(said)


def test_faces_patches_and_totals_are_the_sums_of_the_rows(wear: xr.Dataset) -> None:
    rows, columns = rows_of(TABLE), TABLE.columns
    volume, erodent = by_face(rows, TABLE), by_face(columns["count"] * columns["mass"], TABLE)
    of_patch = [math.fsum(rows[SURFACE.patch[columns["face"]] == i]) for i in range(2)]
    particles = by_face(columns["count"], TABLE)
    with np.errstate(invalid="ignore"):
        expected = {
            "volume": volume,
            "total_volume": math.fsum(rows),
            "patch_volume": of_patch,
            "erodent": erodent,
            "depth": volume / SURFACE.area,
            "mass": 2700 * volume,
            "mass_flux": 2700 * volume / SURFACE.area / 2.0,
            "depth_per_year": volume / SURFACE.area / 2.0 * 31557600e3,
            "erosion": volume / erodent,
            "relative_error": np.sqrt(by_face(rows**2, TABLE)) / volume,
            "alpha_mean": by_face(columns["count"] * angle_and_speed(TABLE)[0], TABLE) / particles,
        }
    for name, values in expected.items():
        np.testing.assert_allclose(wear[name], values, rtol=1e-12, err_msg=name)
    assert int(wear["ends"].sum()) == int(wear["total_impacts"]) == 300
    assert (wear["volume"].attrs["units"], wear["depth_per_year"].attrs["units"]) == ("m^3", "mm/year")
    # In other units it is the same wear.
    there = erosion_map("rotating", P.to("inch-pound"), TABLE, SURFACE)
    for name, size in (("volume", 0.0254**3), ("depth", 0.0254), ("depth_per_year", 1.0)):
        np.testing.assert_allclose(there[name] * size, wear[name], rtol=1e-8)
    assert there["erodent"].attrs["units"] == "slinch"


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
    options: dict[str, Any] = {"spin": Normal(0.0, 1e4), "seed": 3}
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
    law = Normal(0.0, 2e4)
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


def test_what_is_stuck_or_recedes_is_counted_apart() -> None:
    velocity = TABLE.columns["velocity"].copy()
    velocity[:5], velocity[5:15] = 0.0, -velocity[5:15]
    table = TABLE.replace(velocity=velocity)
    left = erosion_map("rotating", P, table, SURFACE)
    lost = (table.columns["count"] * table.columns["mass"])[5:15].sum()
    assert (list(left["left_out"].values), int(left["total_impacts"])) == ([5, 10, 0, 0], 285)
    assert float(left["left_out_mass"][1]) == pytest.approx(lost, rel=1e-12, abs=0)
    same = erosion_map("rotating", P, TABLE.only(slice(15, None)), SURFACE)
    assert float(left["total_volume"]) == pytest.approx(float(same["total_volume"]), rel=1e-12, abs=0)
    assert warnings_of(left) == [
        "5 of 300 rows have no velocity, as parcels that stick to a wall, and are not counted.",
        "10 of 300 rows move along the surface or away from it (n·U ≤ 0), and are not counted.",
    ]


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


def test_the_summary_reads_well(wear: xr.Dataset) -> None:
    summary = MapSummary(wear)
    text, numbers = str(summary), summary.to_dict()
    assert text.startswith("rotating: table on hump")
    for words in ("48 of 48", "volume front", "greatest depth per year", "mm/year", "share rebound", " ± "):
        assert words in text
    assert "by sampling the impacts alone" in summary.rows()[0].meaning
    assert sum(patch["volume"] for patch in numbers["patches"].values()) == pytest.approx(
        numbers["total_volume"], abs=0
    )
    assert numbers["units"]["total_volume"] == "m^3"


def test_the_constants_of_a_model_are_told() -> None:
    varied = erosion_map("rotating-deformation", P, TABLE, SURFACE, k=Normal(2.0, 0.1))
    for words in ("ψ = 0.04, σ = 1.379 GPa", "energy_ratio = ", "k = normal(2, 0.1)"):
        assert words in varied.attrs["constants"]
    for name in erosion.CORRELATIONS:
        said = erosion_map(name, P, TABLE, SURFACE).attrs["constants"]
        assert "E = " in said
        assert "{" not in said


@pytest.mark.parametrize("target", OKA_MATERIALS)
def test_okas_constants_as_printed_give_its_erosion(target: str) -> None:
    model = erosion.models.correlated("oka", target)
    one = {symbol: float(number) for symbol, number in re.findall(r"([\w₀-₉']+) = ([-+.\de]+)", model.formula)}
    sine = np.sin(0.5)
    shape = sine ** one["n₁"] * (1 + one["Hv"] * (1 - sine)) ** one["n₂"]
    expected = one["E₉₀"] * (30 / one["v'"]) ** one["k₂"] * (200 / one["D'"]) ** one["k₃"] * shape
    ratio = oka(0.5, 30.0, 200e-6, material=target)
    assert float(ratio) / float(model.density) == pytest.approx(expected, rel=2e-3)  # four digits are printed


def test_progress_tells_the_rows() -> None:
    calls: list[tuple[str, int, int]] = []
    erosion_map("linearized", P, TABLE, SURFACE, progress=lambda *call: calls.append(call))
    assert calls == [("map", 300, 300)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda velocity: velocity, ""),
        (lambda velocity: 0 * velocity + np.linalg.norm(velocity, axis=1)[:, None], "are the same number"),
        (lambda velocity: abs(velocity) * [0, 0, 1], "two of the three components"),
        (lambda velocity: -abs(velocity) * [0, 0, 1], ""),
        (lambda velocity: velocity * [1, 0, 1], ""),
        (np.abs, "has a negative component"),
        (lambda velocity: np.abs(velocity) + 5, ""),
    ],
)
def test_velocities_that_may_be_speeds_are_said(change, words):
    table = sand(SURFACE, 2000)
    table.columns["velocity"] = change(table.columns["velocity"])
    surface = dataclasses.replace(SURFACE, turns_itself=True)
    said = [sentence for sentence in warnings_of(erosion_map("dnv", P, table, surface)) if "magnitudes" in sentence]
    assert len(said) == bool(words)
    assert not said or words in said[0].lower()
