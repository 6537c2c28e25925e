"""Files of CSV, Parquet and VTK with columns of any name, and samples of Fluent: understood, refused, or left out."""

import gzip
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
import pyvista

from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactBlock, ImpactsError

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


UNDERSTOOD = [
    (name, value, columns, field, expected)
    for names, columns, field, expected in (
        (WEIGHTS, {**BODY, **MOTION}, "count", 1300),
        (SPEEDS, {**BODY, "angle [deg]": 30}, "speed", 50),
        (ANGLES, {**BODY, "speed [m/s]": 50}, "alpha", math.pi / 6),
        (SIZES, {"density [kg/m^3]": 2650, **MOTION}, "mass", GRAIN),
        (MASSES, {"density [kg/m^3]": 2650, **MOTION}, "mass", 1),
    )
    for name, value in names.items()
]


def a_table(folder: Path, kind: str, columns: dict[str, Any], units: dict[str, str] | None = None) -> Path:
    path = folder / f"impacts.{kind}"
    fields = [pa.field(head, pa.float64(), metadata={"units": (units or {}).get(head, "")}) for head in columns]
    table = pa.Table.from_arrays(
        [pa.array(np.atleast_1d(np.asarray(value, float))) for value in columns.values()], schema=pa.schema(fields)
    )
    (pq.write_table if kind == "parquet" else pyarrow.csv.write_csv)(table, path)
    return path


def written(path: Path, content: str | bytes) -> Path:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def block_of(path: Path, **options: Any) -> ImpactBlock:
    (block,) = read_impacts(path, **options).blocks(10)
    return block


def check(block: ImpactBlock, **expected: Any) -> None:
    for name, values in expected.items():
        np.testing.assert_allclose(np.asarray(getattr(block, name)), values, rtol=1e-12, atol=0, err_msg=name)


kinds = pytest.mark.parametrize("kind", ["csv", "parquet"])


@kinds
@pytest.mark.parametrize(("name", "value", "columns", "field", "expected"), UNDERSTOOD)
def test_names_are_understood(tmp_path, kind, name, value, columns, field, expected):
    check(block_of(a_table(tmp_path, kind, {**columns, name: value})), **{field: [expected]})


@pytest.mark.parametrize(("name", "seconds"), [("count", 1), ("mass_flow [kg/s]", 60), ("particle rate [1/min]", 60)])
def test_rates_hit_for_the_duration(tmp_path, name, seconds):
    path = a_table(tmp_path, "csv", {**BODY, **MOTION, name: WEIGHTS[name]})
    check(block_of(path, duration=60), count=[1300 * seconds])
    assert (seconds == 60) == (" is of a steady run" in "".join(read_impacts(path).warnings))


@kinds
@pytest.mark.parametrize("name", [*DOUBTFUL_WEIGHTS, *DOUBTFUL_SPEEDS, *DOUBTFUL_ANGLES, *DOUBTFUL_SIZES])
def test_a_name_that_leaves_a_doubt_is_refused(tmp_path, kind, name):
    path = a_table(tmp_path, kind, {**BODY, **MOTION, name: 7})
    with pytest.raises(ImpactsError) as caught:
        read_impacts(path)
    assert str(path) in str(caught.value)
    if "others of the vector" not in str(caught.value):
        assert repr(name) in str(caught.value)
        check(block_of(path, ignore=(name,)), count=[1])


def test_units_in_the_metadata_of_parquet_count_as_those_of_a_name(tmp_path):
    columns = {**BODY, **MOTION, "Mass Flow Rate": 1300 * GRAIN}
    check(block_of(a_table(tmp_path, "parquet", columns, {"Mass Flow Rate": "kg/s"})), count=[1300])
    with pytest.raises(ImpactsError, match="'slip' has the unit of a speed"):
        read_impacts(a_table(tmp_path, "parquet", {**BODY, **MOTION, "slip": 7}, {"slip": "m/s"}))
    with pytest.raises(ImpactsError, match=r"'spin \[rpm\]' has another unit beside its heading, 'rad/s'"):
        read_impacts(a_table(tmp_path, "parquet", {**BODY, **MOTION, "spin [rpm]": 7}, {"spin [rpm]": "rad/s"}))


@pytest.mark.parametrize(
    "heads",
    [
        ("u [m/s]", "v [m/s]", "w [m/s]"),
        ("Velocity[i] (m/s)", "Velocity[j] (m/s)", "Velocity[k] (m/s)"),
        ("Velocity u [ m s^-1 ]", "Velocity v [ m s^-1 ]", "Velocity w [ m s^-1 ]"),
        ("vx [m/s]", "vy [m/s]", "vz [m/s]", "v [m/s]"),
    ],
)
def test_components_of_the_velocity(tmp_path, heads):
    path = a_table(tmp_path, "csv", {**BODY, **dict(zip(heads, (3, 0, -4, 5), strict=False))})
    check(block_of(path), velocity=[(3, 0, -4)])
    assert ("columns that are not used: 'v [m/s]'" in " ".join(read_impacts(path).warnings)) == (len(heads) == 4)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"count": 7, "frequency [1/s]": 7}, "count and frequency all give the weight"),
        ({"mass_flow [kg/s]": 7, "parcel mass [kg]": 7}, "parcel_mass and mass_flow all give the weight"),
        ({"frequency [1/s]": 7, "time [s]": 7}, "frequency, of a steady run, but also the `time`"),
        ({"impact velocity [m/s]": 7}, "'impact velocity .m/s.' gives `speed`, but so does 'speed .m/s.'"),
        ({"alpha [deg]": 7}, "'alpha .deg.' gives `angle`, but so does 'angle .deg.'"),
        ({"u [m/s]": 3, "v [m/s]": 5}, "others of the vector"),
        ({"depth_m": 1}, "depth_m.*the unit of a length"),
        ({"distance m": 1}, "distance m.*the unit of a length"),
    ],
)
def test_columns_that_contradict_or_leave_a_doubt_are_refused(tmp_path, columns, message):
    path = a_table(tmp_path, "csv", {**BODY, **MOTION, **columns})
    with pytest.raises(ImpactsError, match=message):
        read_impacts(path)
    read_impacts(path, ignore=[*columns][-2:] if "u [m/s]" in columns else [*columns][-1:])


def test_only_columns_that_are_there_can_be_ignored(tmp_path):
    path = a_table(tmp_path, "csv", {**BODY, **MOTION, "Impact Frequency [1/s]": 7, "count": 3})
    for name in ("Impact Frequency [1/s]", "impact_frequency"):
        check(block_of(path, ignore=(name,)), count=[3])
        assert read_impacts(path, ignore=(name,)).warnings == ()
    with pytest.raises(ImpactsError, match="has no column 'flow', which Argument `ignore` names"):
        read_impacts(path, ignore=("flow",))
    with pytest.raises(ImpactsError, match="is no table with named columns"):
        read_impacts(written(tmp_path / "wall.dpm", STEADY), ignore=("frequency",))


VECTORS = """\
count,diameter [um],density [g/cm^3],velocity_x [m/s],velocity_y [m/s],velocity_z [m/s],x [mm],y [mm],z [mm],note
20,100,2.65,10,-20,30,1,2,3,first
2.5,200,2.65,1,2,-3,4,5,6,second
"""
INCIDENT = "mass [ug],diameter [mm],Speed [km/s],alpha [deg],spin [rpm],mesh face,time [ms]\n50,0.1,0.1,30,60,7,250\n"


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
GRAINS = "speed [m/s],angle [deg],diameter [um],{}\n50,30,100,{}\n"
OF_VECTORS = {
    "count": [20, 2.5],
    "diameter": [1e-4, 2e-4],
    "velocity": [(10, -20, 30), (1, 2, -3)],
    "mass": 2650 * math.pi / 6 * np.array([1e-12, 8e-12]),
    "position": [(1e-3, 2e-3, 3e-3), (4e-3, 5e-3, 6e-3)],
}
OF_UNSTEADY = {
    "position": [(0.015, 0.002, -0.00425), (0.016, 0.002, -0.00425)],
    "diameter": [1e-4, 2e-4],
    "velocity": [(12.5, -3, 0.5), (11.5, -2, 0.25)],
    "count": [20, 3],
    "mass": [1.4e-9, 1.12e-8],
    "time": [0.25, 0.5],
}
WEIGHED = UNSTEADY.replace(" n-in-parcel", "").replace(" 20 ", " ").replace(" 3 1.5e-02 0.5", " 1.5e-02 0.5")


@pytest.mark.parametrize(
    ("name", "content", "options", "expected"),
    [
        ("a.csv", VECTORS, {}, OF_VECTORS),
        ("a.csv.gz", gzip.compress(VECTORS.encode()), {}, OF_VECTORS),
        ("a.csv", b"\xef\xbb\xbf" + VECTORS.replace("\n", "\r\n").encode(), {}, OF_VECTORS),
        ("a.csv", INCIDENT, {}, {"speed": [100], "alpha": [math.pi / 6], "spin": [2 * math.pi], "mass": [5e-8],
                               "face": [7], "time": [0.25]}),
        ("a.csv", "mass [kg],speed [m/s],angle [rad],parcel_mass [kg]\n1e-9,100,0.5,3e-9\n",
         {"particle_density": 2650}, {"diameter": [np.cbrt(6e-9 / 2650 / math.pi)], "count": [3]}),
        ("a.csv", GRAINS.format("density [kg/m^3],x_m,y_mm,z_m", "2650,1,2000,3"), {}, {"position": [(1, 2, 3)]}),
        ("wall.dpm", UNSTEADY, {}, OF_UNSTEADY),
        ("wall.dpm", WEIGHED, {}, {"count": [20, 3]}),
        ("wall.dpm", STEADY, {}, {"count": [3000]}),
        ("wall.dpm", STEADY, {"duration": 60.0}, {"count": [180_000]}),
    ],
)  # fmt: skip
def test_a_file_is_read(tmp_path, name, content, options, expected):
    check(block_of(written(tmp_path / name, content), **options), **expected)


def test_parquet_with_columns_of_other_types(tmp_path):
    types = {"diameter [um]": pa.float32(), "mass [mg]": pa.float64(), "speed [m/s]": pa.float64(),
             "angle [deg]": pa.int32(), "face": pa.int64(), "name": pa.string()}  # fmt: skip
    values = [[100.0, 200.0], [1.0, 2.0], [50.0, 60.0], [30, 60], [0, -1], ["a", "b"]]
    arrays = [pa.array(column, kind) for column, kind in zip(values, types.values(), strict=True)]
    pq.write_table(pa.table(arrays, names=list(types)), tmp_path / "a.parquet")
    impacts = read_impacts(tmp_path / "a.parquet")
    assert (impacts.rows, impacts.mesh_faces) == (2, False)
    first, second = impacts.blocks(1)
    assert (first.first, second.first) == (0, 1)
    check(second, mass=[2e-6], diameter=[2e-4], alpha=[math.pi / 3], face=[-1])


HEADER = "note,diameter [um],density [kg/m^3],Velocity [ m s^-1 ],angle [deg]\n"
ROW = "a,100,2650,50,30\n"
PART = f"\n[Name]\nWall, 1\n\n[Data]\n{HEADER}{ROW}"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    "text",
    [
        f"# by me\n\n#x, y\n{HEADER}{ROW}", f'"# by, me"\n{HEADER}# half, way\n{ROW}', PART, f"# by me\n{PART}",
        *(f"# page{mark}\n{HEADER}{ROW}" for mark in "\f\v\x1c\x85\u2028"),
    ],
    ids=["comments", "comments among rows", "CFD-Post", "both", "page", "tab", "separator", "next line", "line"],
)  # fmt: skip
def test_comments_and_what_cfd_post_writes_above_a_table(tmp_path, text, end):
    check(block_of(written(tmp_path / "a.csv", text.replace("\n", end))), speed=[50])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: is empty"),
        ("\0\0\1", "a.csv: is no table of text"),
        (VECTORS.split("\n")[0] + "\n", "a.csv: has no rows"),
        (VECTORS.replace("diameter [um]", "diameter"), r"'diameter' must have a unit, as `diameter \[m\]`, or"),
        (VECTORS.replace("[um]", "[um/s]"), "'diameter .um/s.': the unit must be that of a length"),
        (VECTORS.replace("count", "count [kg]"), "must be none, as of a pure number, but is 'kg'"),
        (VECTORS.replace("count", "d [m]"), "column 'diameter .um.' gives `diameter`, but so does 'd .m.'"),
        (VECTORS.replace("velocity_z [m/s]", "swirl"), "has no column velocity_z, but the others of the vector"),
        (VECTORS.replace("z [mm]", "depth"), "has no column position_z"),
        (INCIDENT.replace("alpha [deg]", "tilt"), "has no columns of the velocity"),
        (INCIDENT.replace("diameter [mm]", "width"), "has no column `diameter`"),
        (VECTORS.replace("density [g/cm^3]", "gravity"), "has no column `mass` or `density`"),
        (VECTORS.replace("2.5,200", "2.5"), "line 3: has 9 cells"),
        (VECTORS.replace("2.5,200", "2.5,wide"), "line 3: column `diameter .um.` must be a number, but is 'wide'"),
        (VECTORS.replace("2.5,200", "2.5,"), "row 2: column `diameter .um.` has no number"),
        (VECTORS.replace("2.5,200", "2.5,nan"), "row 2: column `diameter .um.` has no number"),
        (VECTORS.replace("2.5,200", "2.5,inf"), "row 2: column `diameter` must be finite, but is inf"),
        (VECTORS.replace("2.5,200", "2.5,1e99"), r"row 2: column `diameter` must be at most 1e\+20, but is 9"),
        (INCIDENT.replace(",7,", ",7.5,"), "row 1: column `mesh_face` must be the number of a face, .*, but is 7.5"),
        (INCIDENT.replace(",7,", ",-2,"), "but is -2"),
        (INCIDENT.replace("time [ms]", "face"), "has both columns `face` and `mesh_face`"),
        (PART + PART, r"\[Name\] begins another part"),
        (f"{PART}\n[Faces]\n0, 1, 2, 3, 4\n", r"\[Faces\] begins another part"),
        (f"# {HEADER}{ROW.replace('a', '1')}", r"line 2 must name the columns, but is '1,100,2650,50,30'"),
        ("# a\n#b\n", "no line that names columns"),
        (f"[Name]\nw\n{HEADER}{ROW}", r"\[Data\] is missing"),
        (f"{HEADER}{ROW}#a,100,2650,50,30\n", "column 'note': rows begin with #"),
        (f"# by me\n{HEADER}{ROW}a,x,2650,50,30\n", r"line 4: column `diameter \[um\]` must be a number, but is 'x'"),
        (f"{HEADER}# half\n{ROW}a,x,2650,50,30\n", r"line 4: column `diameter \[um\]` must be a number, but is 'x'"),
    ],
)  # fmt: skip
def test_a_csv_file_that_cannot_be_used_is_refused(tmp_path, text, message):
    with pytest.raises(ImpactsError, match=message):
        block_of(written(tmp_path / "a.csv", text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wall.dpm: is empty"),
        ("some text\n", "has no header of Fluent"),
        (UNSTEADY.replace(" z ", " "), "has no column position_z, but the others of the vector"),
        (UNSTEADY.replace("diameter", "diameter mass"), "the header repeats mass"),
        (UNSTEADY.replace(" 12.5", ""), "line 3: has 13 cells, but the header names 14"),
        (UNSTEADY.replace("11.5", "fast"), "line 4: column `u` must be a number, but is 'fast'"),
        (UNSTEADY.replace("11.5", "-nan"), "row 2: column `velocity_x` must be finite, but is nan"),
    ],
)
def test_a_sample_that_cannot_be_used_is_refused(tmp_path, text, message):
    with pytest.raises(ImpactsError, match=message):
        block_of(written(tmp_path / "wall.dpm", text))


NONE = pa.array([], pa.float64())


@pytest.mark.parametrize(
    ("diameter", "other", "message"),
    [
        (["wide"], [1.0], r"column 'diameter \[m\]' must hold numbers, but holds string"),
        (NONE, NONE, "has no rows"),
        ([1.0, None], [1.0, 1.0], r"row 2: column `diameter \[m\]` has no number"),
    ],
)
def test_parquet_that_cannot_be_used_is_refused(tmp_path, diameter, other, message):
    path = written(tmp_path / "a.parquet", b"PAR1 junk")
    with pytest.raises(ImpactsError, match="cannot be read as Parquet"):
        read_impacts(path)
    heads = ("mass [kg]", "speed [m/s]", "angle [deg]")
    pq.write_table(pa.table({"diameter [m]": diameter} | dict.fromkeys(heads, other)), path)
    with pytest.raises(ImpactsError, match=message):
        block_of(path)


@pytest.mark.parametrize("column", ["density [kg/m^3]", "mass [ug]"])
def test_a_density_beside_that_of_the_table_is_refused(tmp_path, column):
    path = written(tmp_path / "a.csv", GRAINS.format(column, 1.2))
    with pytest.raises(ImpactsError, match=r"Argument `particle_density` .* Argument `ignore`"):
        read_impacts(path, particle_density=2650)
    check(block_of(path, particle_density=2650, ignore=(column,)), mass=[GRAIN])
    with pytest.raises(ImpactsError, match="the mass of each particle; Argument `particle_density` must be left out"):
        read_impacts(written(tmp_path / "wall.dpm", UNSTEADY), particle_density=2650)


PLAIN = "x,y,z,vel_x,vel_y,vel_z,diameter_um\n1.5,2,-3,30,0.5,-4,200\n2.5,2,-3,30,0.5,-4,100\n"
MEANT = "x,y,z=mm, vel_x,vel_y,vel_z=m/s"
SPELLINGS = {
    "a.csv": PLAIN, "a.txt": PLAIN, "semicolons.txt": PLAIN.replace(",", ";"), "tabs.tsv": PLAIN.replace(",", "\t"),
    "spaces.out": PLAIN.replace(",", "  "), "german.csv": PLAIN.replace(",", ";").replace(".", ","),
    "commented.txt": "# of a run, 3 rows\n" + PLAIN, "hits.dat": PLAIN,
}  # fmt: skip


@pytest.mark.parametrize("name", SPELLINGS)
def test_a_plain_table_needs_no_editing(tmp_path, name):
    path = written(tmp_path / name, SPELLINGS[name])
    with pytest.raises(
        ImpactsError, match=r"'x', 'y', 'z', 'vel_x'.* must have a unit.*\"x,y,z=m, vel_x,vel_y,vel_z=m/s"
    ):
        read_impacts(path, particle_density=2650)
    block = block_of(path, particle_density=2650, columns=MEANT)
    check(block, position=[[1.5e-3, 2e-3, -3e-3], [2.5e-3, 2e-3, -3e-3]], velocity=[[30, 0.5, -4]] * 2)
    check(block, diameter=[2e-4, 1e-4])


def test_meanings_come_from_a_file_and_of_any_name(tmp_path):
    path = written(tmp_path / "a", "U rel,theta,D50\n30,20,200\n")
    meant = {"U rel": "speed [m/s]", "theta": "angle [deg]", "D50": "diameter [um]"}
    file = written(tmp_path / "names.toml", "".join(f"{head!r} = {text!r}\n" for head, text in meant.items()))
    for columns in (meant, str(file), ", ".join(f"{head}={text}" for head, text in meant.items())):
        check(block_of(path, particle_density=2650, columns=columns), speed=[30], alpha=[math.radians(20)])


def test_other_endings_are_known_by_their_content(tmp_path):
    for kind, suffix in (("csv", "x"), ("parquet", "y")):
        table = a_table(tmp_path, kind, {**BODY, **MOTION})
        check(block_of(table.rename(tmp_path / f"rows.{suffix}")), speed=[50])


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("x,y,z", "such as"), ("x,,y=mm", "such as"), ("x=", "such as"), ("q=mm", "no column 'q'"),
        ("x=kg", "'x': the unit must be that of a length"), ("diameter_um=m", "diameter_um"),
        ("nowhere.toml", "nowhere.toml: cannot be read"),
    ],
)  # fmt: skip
def test_meanings_that_fit_no_column_are_refused(tmp_path, columns, words):
    path = written(tmp_path / "a.csv", PLAIN)
    with pytest.raises(ImpactsError, match=words):
        read_impacts(path, particle_density=2650, columns=columns)


def test_a_refusal_prints_what_says_the_meaning_of_a_column(tmp_path):
    heads = {
        "Ort X / mm": "position_x",
        "Ort Y / mm": "position_y",
        "Ort Z / mm": "position_z",
        "Korn / um": "diameter",
    }
    path = written(tmp_path / "a.csv", ";".join([*heads, "count", "v / m s-1", "angle / deg"]) + "\n1;2;3;4;5;6;7\n")
    meant = dict[str, str]()
    for heading, name in heads.items():
        with pytest.raises(ImpactsError) as refused:
            read_impacts(path, particle_density=2650, columns=meant)
        entry = re.findall(r'what it is \("(.*)"\)', str(refused.value))[0]
        assert entry.partition("=")[0] == heading.partition(" /")[0]
        column, _, meaning = entry.replace("NAME", name).partition("=")
        meant[column] = meaning
    check(block_of(path, particle_density=2650, columns=meant), speed=[6], diameter=[4e-6])


def test_points_and_commas_are_one_too_many(tmp_path):
    path = written(tmp_path / "a.csv", SPELLINGS["german.csv"].replace("100", "1.5"))
    with pytest.raises(ImpactsError, match="with points and with commas"):
        read_impacts(path, particle_density=2650, columns=MEANT)


ARRAYS = {"U": [[30, 0.5, -4]] * 2, "d": [200, 100], "rho": [2650, 2650], "nParticle": [3, 4], "age": [1, 2]}
PARTS = slice(1), slice(1, 2), slice(2)
PLACES = [[1.5, 2, -3], [2.5, 2, -3]]
BY_HAND = """<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian">
<UnstructuredGrid><Piece NumberOfPoints="2" NumberOfCells="2">
<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">1.5 2 -3 2.5 2 -3</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">{corners}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{kinds}</DataArray></Cells>
<PointData><DataArray type="Float64" Name="U" NumberOfComponents="3" format="ascii">30 0.5 -4 30 0.5 -4</DataArray>
<DataArray type="Float32" Name="d" format="ascii">200 100</DataArray>
<DataArray type="Int32" Name="rho" format="ascii">2650 2650</DataArray></PointData>
<CellData><DataArray type="Int64" Name="nParticle" format="ascii">3 4</DataArray></CellData>
</Piece></UnstructuredGrid></VTKFile>"""
MEANT_OF_POINTS = "Points=mm, U=m/s, d=um, rho=kg/m^3"


def points_file(path: Path, arrays: dict[str, Any] = ARRAYS) -> Path:
    """Two points; in blocks, one in each."""
    first, second, cloud = parts = [pyvista.PolyData(np.array(PLACES[part], float)) for part in PARTS]
    for part, points in zip(PARTS, parts, strict=True):
        points.point_data.update({name: np.array(values[part]) for name, values in arrays.items()})
    if path.suffix == ".vtm":
        run = pyvista.MultiBlock({"internalMesh": pyvista.ImageData(dimensions=(2, 2, 2)), "nothing": None})
        sand = {"sand0": first.cast_to_unstructured_grid(), "sand1": second.cast_to_unstructured_grid()}
        run["lagrangian"] = pyvista.MultiBlock(sand)
        run.save(path)
    else:
        (cloud if path.suffix == ".vtp" else cloud.cast_to_unstructured_grid()).save(path)
    return path


@pytest.mark.parametrize("name", ["hits.vtp", "hits.vtu", "hits.VTU", "hits.vtm", "hand.vtu"])
def test_points_of_vtk_are_a_table(tmp_path, name):
    if name == "hand.vtu":
        path = written(tmp_path / name, BY_HAND.format(corners="0 1", ends="1 2", kinds="1 1"))
    else:
        path = points_file(tmp_path / name)
    with pytest.raises(ImpactsError, match=r"'U:0'.* must have a unit.*\"Points:0,Points:1,Points:2,d=m"):
        read_impacts(path)
    impacts = read_impacts(path, columns=MEANT_OF_POINTS)
    blocks = [*impacts.blocks(10)]
    expected = {"position": np.array(PLACES) / 1e3, "velocity": ARRAYS["U"], "count": [3, 4], "diameter": [2e-4, 1e-4]}
    for field, values in expected.items():
        got = np.concatenate([getattr(block, field) for block in blocks])
        np.testing.assert_allclose(got, values, rtol=1e-15)
    assert impacts.rows == 2
    assert ("lagrangian/sand0, lagrangian/sand1 are joined" in " ".join(impacts.warnings)) == (name == "hits.vtm")
    assert name == "hand.vtu" or "columns that are not used: 'age'" in impacts.warnings[-1]


@pytest.mark.parametrize(
    ("text", "diameter"),
    [
        ("diameter, um\tdensity, kg/m^3\tspeed, m/s\tangle, deg\n100\t2650\t50\t30\n", 1e-4),
        ("diameter, um;density, kg/m^3;speed, m/s;angle, deg\n100,5;2650;50;30\n", 1.005e-4),
        ("wall;diameter [um];density [kg/m^3];speed [m/s];angle [deg]\nwall 1,2;100.5;2650;50;30\n", 1.005e-4),
    ],
)
def test_commas_in_headings_and_labels_separate_nothing(tmp_path, text, diameter):
    (tmp_path / "hits.csv").write_text(text)
    (block,) = read_impacts(tmp_path / "hits.csv").blocks(9)
    np.testing.assert_allclose(block.diameter, [diameter], rtol=1e-15)


def test_labels_as_windows_writes_them_are_left_out(tmp_path):
    text = "Teil,diameter [um],density [kg/m^3],speed [m/s],angle [deg]\nKrümmer,100,2650,50,30\n"
    (tmp_path / "hits.csv").write_bytes(text.encode("cp1252"))
    (block,) = read_impacts(tmp_path / "hits.csv").blocks(9)
    np.testing.assert_array_equal(block.speed, [50])
