"""Names that people give to columns of impacts: understood, refused by name, or left out with a sentence."""

import math
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactsError

GRAIN = 2650 * math.pi / 6 * 1e-12  # kg, of 0.1 mm
BODY = {"diameter [um]": 100.0, "density [kg/m^3]": 2650.0}
MOTION = {"speed [m/s]": 50.0, "angle [deg]": 30.0}

WEIGHTS = {
    # 1300 particles in 1 s, or in a parcel
    "count": 1300, "nParticle": 1300, "number of particles": 1300, "n_particles": 1300, "particle count": 1300,
    "mass_flow [kg/s]": 1300 * GRAIN, "Mass Flow Rate [kg/s]": 1300 * GRAIN, "mass-flow (g/s)": 1300e3 * GRAIN,
    "massFlowRate [kg s^-1]": 1300 * GRAIN, "MASS FLOW [kg s-1]": 1300 * GRAIN, "mass_flow_kg_s": 1300 * GRAIN,
    "mdot [kg/h]": 1300 * GRAIN * 3600, "frequency [1/s]": 1300, "frequency [Hz]": 1300, "Frequency (s^-1)": 1300,
    "particle rate [1/min]": 78000, "parcel_mass [kg]": 1300 * GRAIN, "Parcel Mass (g)": 1300e3 * GRAIN,
    "parcelMass_kg": 1300 * GRAIN, "number in parcel": 1300,
}  # fmt: skip
DOUBTFUL_WEIGHTS = [
    "mass_flow", "frequency", "n", "N", "np", "particles", "parcel count", "rate", "rate [1/s]", "flow rate [kg/s]",
    "flow rate", "volume flow rate [m^3/s]", "mass flux [kg/m^2/s]", "weight [kg]", "weight factor", "hits",
    "statistical weight", "total mass [kg]", "strength [1/s]", "Anzahl", "Massenstrom [kg/s]", "weight %", "m [kg]",
    "impact frequency [1/s]", "particle number", "number/s", "freq", "mass0", "wt", "kg/s", "npart", "number",
    "Number", "weight",
]  # fmt: skip
SPEEDS = {
    "speed [m/s]": 50, "v [m/s]": 50, "V [m/s]": 50, "velocity [m/s]": 50, "speed (m/s)": 50, "v0 [m/s]": 50,
    "v₀ [m/s]": 50, "Impact Velocity [m s^-1]": 50, "impact speed [km/h]": 180, "impact_velocity [m·s⁻¹]": 50,
    "v_impact [m/s]": 50, "V_impact (m s-1)": 50, "vel [m/s]": 50, "speed_mps": 50, "velocity_m_s": 50, "speed m/s": 50,
    "speed, m/s": 50, "v / (m/s)": 50, "particle velocity [mm/s]": 5e4, "velocity magnitude [m/s]": 50,
    "Speed[m/s]": 50, "|v| [m/s]": 50, "v in m/s": 50,
}  # fmt: skip
DOUBTFUL_SPEEDS = [
    "v", "speed", "u [m/s]", "w [m/s]", "jet velocity [m/s]", "gas speed [m/s]", "v_rel [m/s]", "v1 [m/s]",
    "velocity_ms", "Geschwindigkeit [m/s]", "U [m/s]", "velocity_x [m/s]", "test speed", "v_g [m/s]", "speed [Mach]",
]  # fmt: skip
ANGLES = {
    "angle [deg]": 30, "angle (deg)": 30, "Angle [°]": 30, "alpha [rad]": math.pi / 6, "α [°]": 30, "angle_deg": 30,
    "impact angle [deg]": 30, "Impact Angle (degrees)": 30, "impactAngle [deg]": 30, "angle of attack [deg]": 30,
    "impingement angle [deg]": 30, "angle, deg": 30, "angle in deg": 30, "attack_angle [deg]": 30, "angle / °": 30,
}  # fmt: skip
DOUBTFUL_ANGLES = [
    "angle", "theta [deg]", "incidence angle [deg]", "angle of incidence [deg]", "nozzle angle [deg]", "phi [deg]",
    "Winkel [°]", "tilt [deg]", "angle [m]", "angle to normal [deg]",
]  # fmt: skip
SIZES = {
    "diameter [um]": 100, "d [um]": 100, "D (µm)": 100, "d_p [mm]": 0.1, "dp [um]": 100, "particle diameter [um]": 100,
    "diameter_um": 100, "diameter, um": 100, "d_um": 100, "Diameter [m]": 1e-4, "diameter in um": 100,
}  # fmt: skip
DOUBTFUL_SIZES = [
    "diameter", "d", "size [um]", "radius [um]", "r [um]", "d50 [um]", "grain size [um]", "mean diameter [um]", "d_m",
    "Durchmesser [um]", "parcel diameter [um]",
]  # fmt: skip
MASSES = {
    "mass [kg]": 1.0, "particle mass [ug]": 1e9, "mass_of_particle (mg)": 1e6, "mass_kg": 1.0, "mass, g": 1e3,
    "mass per particle [g]": 1e3,
}  # fmt: skip
FOREIGN = [
    "note", "particle id", "temperature [K]", "particle temperature [K]", "Pressure [Pa]", "age [s]", "injection",
    "residence time [s]", "vtkValidPointMask", "date", "label", "viscosity [Pa s]",
]  # fmt: skip


def a_table(folder: Path, kind: str, columns: dict[str, float], units: dict[str, str] | None = None) -> Path:
    path = folder / f"impacts.{kind}"
    fields = [pa.field(head, pa.float64(), metadata={"units": (units or {}).get(head, "")}) for head in columns]
    table = pa.Table.from_arrays([pa.array([float(value)]) for value in columns.values()], schema=pa.schema(fields))
    (pq.write_table if kind == "parquet" else pyarrow.csv.write_csv)(table, path)
    return path


def block_of(path: Path, **options):
    (block,) = read_impacts(path, **options).blocks(10)
    return block


kinds = pytest.mark.parametrize("kind", ["csv", "parquet"])


@kinds
@pytest.mark.parametrize("name", WEIGHTS)
def test_weights_are_understood(tmp_path, kind, name):
    path = a_table(tmp_path, kind, {**BODY, **MOTION, name: WEIGHTS[name]})
    np.testing.assert_allclose(block_of(path).count, [1300], rtol=1e-12)
    seconds = 60 if " is of a steady run" in "".join(read_impacts(path).warnings) else 1
    np.testing.assert_allclose(block_of(path, duration=60).count, [1300 * seconds], rtol=1e-12)


@kinds
@pytest.mark.parametrize("name", SPEEDS)
def test_speeds_are_understood(tmp_path, kind, name):
    block = block_of(a_table(tmp_path, kind, {**BODY, "angle [deg]": 30, name: SPEEDS[name]}))
    np.testing.assert_allclose(np.asarray(block.speed), [50], rtol=1e-12)


@kinds
@pytest.mark.parametrize("name", ANGLES)
def test_angles_are_understood(tmp_path, kind, name):
    block = block_of(a_table(tmp_path, kind, {**BODY, "speed [m/s]": 50, name: ANGLES[name]}))
    np.testing.assert_allclose(np.asarray(block.alpha), [math.pi / 6], rtol=1e-12)


@kinds
@pytest.mark.parametrize("name", SIZES)
def test_sizes_are_understood(tmp_path, kind, name):
    block = block_of(a_table(tmp_path, kind, {name: SIZES[name], "density [kg/m^3]": 2650, **MOTION}))
    np.testing.assert_allclose(block.mass, [GRAIN], rtol=1e-12)


@kinds
@pytest.mark.parametrize("name", MASSES)
def test_masses_are_understood(tmp_path, kind, name):
    block = block_of(a_table(tmp_path, kind, {name: MASSES[name], "density [kg/m^3]": 2650, **MOTION}))
    np.testing.assert_allclose(block.mass, [1], rtol=1e-12)


@kinds
@pytest.mark.parametrize("name", [*DOUBTFUL_WEIGHTS, *DOUBTFUL_SPEEDS, *DOUBTFUL_ANGLES, *DOUBTFUL_SIZES])
def test_a_name_that_leaves_a_doubt_is_refused(tmp_path, kind, name):
    path = a_table(tmp_path, kind, {**BODY, **MOTION, name: 7})
    with pytest.raises(ImpactsError) as caught:
        list(read_impacts(path).blocks(10))
    assert str(path) in str(caught.value)
    assert repr(name) in str(caught.value) or "of the vector" in str(caught.value)
    if "of the vector" not in str(caught.value):
        assert block_of(path, ignore=(name,)).count == [1]


@kinds
@pytest.mark.parametrize("name", FOREIGN)
def test_other_columns_are_left_out_and_named(tmp_path, kind, name):
    impacts = read_impacts(a_table(tmp_path, kind, {**BODY, **MOTION, "count": 3, name: 7}))
    (block,) = impacts.blocks(10)
    assert block.count == [3]
    assert impacts.warnings == (f"impacts.{kind}: columns that are not used: {name!r}.",)


def test_units_in_the_metadata_of_parquet_count_as_those_of_a_name(tmp_path):
    columns = {**BODY, **MOTION, "Mass Flow Rate": 1300 * GRAIN}
    path = a_table(tmp_path, "parquet", columns, {"Mass Flow Rate": "kg/s"})
    np.testing.assert_allclose(block_of(path).count, [1300], rtol=1e-12)
    columns = {**BODY, **MOTION, "slip": 7}
    with pytest.raises(ImpactsError, match="'slip' has the unit of a speed"):
        read_impacts(a_table(tmp_path, "parquet", columns, {"slip": "m/s"}))


VECTOR = {"u [m/s]": 3.0, "v [m/s]": 0.0, "w [m/s]": -4.0}


def test_v_beside_u_and_w_is_a_component(tmp_path):
    block = block_of(a_table(tmp_path, "csv", {**BODY, **VECTOR}))
    np.testing.assert_array_equal(block.velocity, [(3, 0, -4)])
    for name in ("Velocity[{}] (m/s)", "Velocity {} [ m s^-1 ]"):
        letters = "ijk" if "[{}]" in name else "uvw"
        columns = dict(zip(map(name.format, letters), VECTOR.values(), strict=True))
        block = block_of(a_table(tmp_path, "csv", {**BODY, **columns}))
        np.testing.assert_array_equal(block.velocity, [(3, 0, -4)])
    path = a_table(tmp_path, "csv", {**BODY, "vx [m/s]": 3, "vy [m/s]": 0, "vz [m/s]": -4, "v [m/s]": 5})
    np.testing.assert_array_equal(block_of(path).velocity, [(3, 0, -4)])
    assert "columns that are not used: 'v [m/s]'" in read_impacts(path).warnings[-1]
    with pytest.raises(ImpactsError, match="others of the vector"):
        read_impacts(a_table(tmp_path, "csv", {**BODY, "angle [deg]": 30, "u [m/s]": 3, "v [m/s]": 5}))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"count": 7, "frequency [1/s]": 7}, "count and frequency all give the weight"),
        ({"mass_flow [kg/s]": 7, "parcel mass [kg]": 7}, "parcel_mass and mass_flow all give the weight"),
        ({"frequency [1/s]": 7, "time [s]": 7}, "frequency, of a steady run, but also the `time`"),
        ({"impact velocity [m/s]": 7}, "'impact velocity .m/s.' gives `speed`, but so does 'speed .m/s.'"),
        ({"alpha [deg]": 7}, "'alpha .deg.' gives `angle`, but so does 'angle .deg.'"),
    ],
)
def test_two_columns_of_one_quantity_are_refused(tmp_path, columns, message):
    path = a_table(tmp_path, "csv", {**BODY, **MOTION, **columns})
    with pytest.raises(ImpactsError, match=message):
        read_impacts(path)
    read_impacts(path, ignore=[*columns][-1:])


def test_only_columns_that_are_there_can_be_ignored(tmp_path):
    path = a_table(tmp_path, "csv", {**BODY, **MOTION, "Impact Frequency [1/s]": 7, "count": 3})
    for name in ("Impact Frequency [1/s]", "impact_frequency"):
        impacts = read_impacts(path, ignore=(name,))
        assert (block_of(path, ignore=(name,)).count, impacts.warnings) == ([3], ())
    with pytest.raises(ImpactsError, match="has no column 'flow', which Argument `ignore` names"):
        read_impacts(path, ignore=("flow",))
    sample = tmp_path / "wall.dpm"
    sample.write_text("(wall 13)\n(x y z u v w diameter t mass-flow mass frequency time name)\n")
    with pytest.raises(ImpactsError, match="is no table with named columns"):
        read_impacts(sample, ignore=("frequency",))
