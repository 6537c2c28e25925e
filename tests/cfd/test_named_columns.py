"""CSV and Parquet files, whose columns have names and units."""

import gzip
import math

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from erosion.cfd.impact_tables import NamedImpacts
from erosion.cfd.read import read_impacts
from erosion.cfd.rows import ImpactsError

VECTORS = """\
count,diameter [um],density [g/cm^3],velocity_x [m/s],velocity_y [m/s],velocity_z [m/s],x [mm],y [mm],z [mm],note
20,100,2.65,10,-20,30,1,2,3,first
2.5,200,2.65,1,2,-3,4,5,6,second
"""
ANGLES = "mass [ug],diameter [mm],Speed [km/s],alpha [deg],spin [rpm],mesh face,time [ms]\n50,0.1,0.1,30,60,7,250\n"


def written(path, text):
    path.write_text(text)
    return path


def test_a_csv_file_in_units_of_its_own(tmp_path):
    (block,) = read_impacts(written(tmp_path / "a.csv", VECTORS)).blocks(10)
    np.testing.assert_array_equal(block.count, [20, 2.5])
    np.testing.assert_allclose(block.diameter, [1e-4, 2e-4], rtol=1e-15)
    np.testing.assert_allclose(block.mass, 2650 * math.pi / 6 * np.array([1e-12, 8e-12]), rtol=1e-14)
    np.testing.assert_array_equal(block.velocity, [(10, -20, 30), (1, 2, -3)])
    np.testing.assert_allclose(np.asarray(block.position), [(1e-3, 2e-3, 3e-3), (4e-3, 5e-3, 6e-3)], rtol=1e-15)


def test_speeds_and_angles_and_faces_of_the_mesh(tmp_path):
    impacts = read_impacts(written(tmp_path / "a.csv", ANGLES))
    assert impacts.mesh_faces
    assert impacts.warnings[0].startswith("a.csv has no column of the number of particles")
    (block,) = impacts.blocks(10)
    assert (block.velocity, block.position) == (None, None)
    np.testing.assert_allclose(np.asarray(block.speed), [100], rtol=1e-15)
    np.testing.assert_allclose(np.asarray(block.alpha), [math.pi / 6], rtol=1e-15)
    np.testing.assert_allclose(np.asarray(block.spin), [2 * math.pi], rtol=1e-15)
    np.testing.assert_allclose(block.mass, [5e-8], rtol=1e-15)
    np.testing.assert_array_equal(block.face, [7])
    np.testing.assert_allclose(np.asarray(block.time), [0.25], rtol=1e-15)


def test_the_diameter_follows_from_mass_and_density(tmp_path):
    text = "mass [kg],speed [m/s],angle [rad],parcel_mass [kg]\n1e-9,100,0.5,3e-9\n"
    (block,) = read_impacts(written(tmp_path / "a.csv", text), particle_density=2650).blocks(10)
    np.testing.assert_allclose(block.diameter**3 * 2650 * math.pi / 6, [1e-9], rtol=1e-14)
    np.testing.assert_allclose(block.count, [3], rtol=1e-15)


def test_a_compressed_file_and_one_with_a_byte_order_mark(tmp_path):
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(VECTORS.encode()))
    (tmp_path / "b.csv").write_bytes(b"\xef\xbb\xbf" + VECTORS.replace("\n", "\r\n").encode())
    for name in ("a.csv.gz", "b.csv"):
        (block,) = read_impacts(tmp_path / name).blocks(10)
        np.testing.assert_array_equal(block.count, [20, 2.5])


def test_parquet_with_units_in_names_and_in_metadata(tmp_path):
    fields = [
        pa.field("diameter [um]", pa.float32()),
        pa.field("mass", pa.float64(), metadata={"units": "mg"}),
        pa.field("speed", pa.float64(), metadata={"unit": "m/s"}),
        pa.field("angle [deg]", pa.int32()),
        pa.field("face", pa.int64()),
        pa.field("name", pa.string()),
    ]
    values = [[100.0, 200.0], [1.0, 2.0], [50.0, 60.0], [30, 60], [0, -1], ["a", "b"]]
    pq.write_table(pa.table([pa.array(v, f.type) for v, f in zip(values, fields, strict=True)],
                                    schema=pa.schema(fields)), tmp_path / "a.parquet")  # fmt: skip
    impacts = read_impacts(tmp_path / "a.parquet")
    assert impacts.rows == 2
    assert not impacts.mesh_faces
    first, second = impacts.blocks(1)
    assert (first.first, second.first) == (0, 1)
    np.testing.assert_allclose(second.mass, [2e-6], rtol=1e-15)
    np.testing.assert_allclose(second.diameter, [2e-4], rtol=1e-15)
    np.testing.assert_allclose(np.asarray(second.alpha), [math.pi / 3], rtol=1e-15)
    np.testing.assert_array_equal(second.face, [-1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: is empty"),
        ("\0\0\1", "a.csv: is no table of text"),
        (VECTORS.split("\n")[0] + "\n", "a.csv: has no rows"),
        (VECTORS.replace("diameter [um]", "diameter"), r"'diameter' must carry its unit .*, as `diameter \[m\]`"),
        (VECTORS.replace("[um]", "[um/s]"), "the unit of column 'diameter .um/s.' must be a length"),
        (VECTORS.replace("count", "count [kg]"), "must be a pure number, but has the unit 'kg'"),
        (VECTORS.replace("count", "d [m]"), "column 'diameter .um.' gives `diameter`, but so does 'd .m.'"),
        (VECTORS.replace("velocity_z [m/s]", "swirl"), "has no column velocity_z, but the others of the vector"),
        (VECTORS.replace("z [mm]", "depth"), "has no column position_z"),
        (ANGLES.replace("alpha [deg]", "tilt"), "has no columns of the velocity"),
        (ANGLES.replace("diameter [mm]", "width"), "has no column `diameter`"),
        (VECTORS.replace("density [g/cm^3]", "gravity"), "has no column `mass` or `density`"),
        (VECTORS.replace("2.5,200", "2.5"), "the row '2.5,2.65,1,2,-3,4,5,6,second' has 9 fields"),
        (VECTORS.replace("2.5,200", "2.5,wide"), "row 2: column `diameter .um.` must be a number, but is 'wide'"),
        (VECTORS.replace("2.5,200", "2.5,"), "row 2: column `diameter .um.` has no number"),
        (VECTORS.replace("2.5,200", "2.5,nan"), "row 2: column `diameter .um.` has no number"),
        (VECTORS.replace("2.5,200", "2.5,inf"), "row 2: column `diameter` must be finite, but is inf"),
        (VECTORS.replace("2.5,200", "2.5,1e99"), r"row 2: column `diameter` must be at most 1e\+20, but is 9"),
        (VECTORS.replace(",", ";"), "a.csv: must have commas between its columns"),
        (VECTORS.replace(",", "\t"), "a.csv: must have commas between its columns"),
        (ANGLES.replace(",7,", ",7.5,"), "row 1: column `mesh_face` must be the number of a face, .*, but is 7.5"),
        (ANGLES.replace(",7,", ",-2,"), "but is -2"),
        (ANGLES.replace("time [ms]", "face"), "has both columns `face` and `mesh_face`"),
    ],
)  # fmt: skip
def test_a_csv_file_that_cannot_be_used_is_refused(tmp_path, text, message):
    with pytest.raises(ImpactsError, match=message):
        list(read_impacts(written(tmp_path / "a.csv", text)).blocks(10))


def test_parquet_that_cannot_be_used_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    path.write_bytes(b"PAR1 junk")
    with pytest.raises(ImpactsError, match="cannot be read as Parquet"):
        read_impacts(path)
    columns = {"diameter [m]": ["wide"], "mass [kg]": [1.0], "speed [m/s]": [1.0], "angle [deg]": [1.0]}
    pq.write_table(pa.table(columns), path)
    with pytest.raises(ImpactsError, match=r"column 'diameter \[m\]' must hold numbers, but holds string"):
        list(read_impacts(path).blocks(1))
    pq.write_table(pa.table({name: pa.array([], pa.float64()) for name in columns}), path)
    with pytest.raises(ImpactsError, match="has no rows"):
        read_impacts(path)
    pq.write_table(pa.table({name: [1.0, None] for name in columns}), path)
    with pytest.raises(
        ImpactsError, match=r"row 2: column `mass \[kg\]` has no number|row 2: column `diameter \[m\]` has no"
    ):
        list(read_impacts(path).blocks(1))


def test_places_may_have_their_unit_after_an_underscore(tmp_path):
    text = GRAINS.format("density [kg/m^3],x_m,y_mm,z_m", "2650,1,2000,3")
    (block,) = read_impacts(written(tmp_path / "a.csv", text)).blocks(10)
    np.testing.assert_allclose(np.asarray(block.position), [(1, 2, 3)], rtol=1e-15)


GRAINS = "speed [m/s],angle [deg],diameter [um],{}\n50,30,100,{}\n"


@pytest.mark.parametrize("column", ["density [kg/m^3]", "mass [ug]"])
def test_a_density_beside_that_of_the_table_is_refused(tmp_path, column):
    path = written(tmp_path / "a.csv", GRAINS.format(column, 1.2))
    with pytest.raises(ImpactsError, match=r"Argument `particle_density` .* Argument `ignore`"):
        read_impacts(path, particle_density=2650)
    (block,) = read_impacts(path, particle_density=2650, ignore=(column,)).blocks(10)
    np.testing.assert_allclose(block.mass, [2650 * math.pi / 6 * 1e-12], rtol=1e-14)


@pytest.mark.parametrize(
    ("column", "number", "sentence"),
    [
        ("density [kg/m^3]", "1.2", "a density of 1.2 kg/m³, less than any grain"),
        ("density [kg/m^3],mass [ng]", "2650,500", "in 1 rows the density is not that of mass and diameter"),
        ("density [kg/m^3]", "4000", "a density of 4000 kg/m³, which counts, but the particle that is named has 2650"),
        ("mass [ng]", "13875", "a density of 2.65e+04 kg/m³, more than any solid; if a mass is that of all particles"),
        ("density [kg/m^3],mass [ng]", "2650,1387.537", None),
    ],
)
def test_a_density_of_no_grain_is_said(tmp_path, column, number, sentence):
    impacts = read_impacts(written(tmp_path / "a.csv", GRAINS.format(f"count,{column}", f"1,{number}")))
    assert isinstance(impacts, NamedImpacts)
    impacts.expected = 2650.0 if number in ("4000", "2650,1387.537") else None
    for _ in range(2):
        list(impacts.blocks(10))
        assert len(impacts.warnings) == (sentence is not None)
    assert sentence is None or sentence in impacts.warnings[0]


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_of_rows_are_no_numbers_of_particles(tmp_path, first):
    rows = "".join(f"{first + row},100,2650,50,30\n" for row in range(20))
    path = written(tmp_path / "a.csv", f"count,diameter [um],density [kg/m^3],speed [m/s],angle [deg]\n{rows}")
    with pytest.raises(ImpactsError, match=r"column 'count' counts the rows, .* Argument `ignore`"):
        list(read_impacts(path).blocks(10))
    assert sum(block.rows for block in read_impacts(path, ignore=("count",)).blocks(10)) == 20


HEADER = "note,diameter [um],density [kg/m^3],Velocity [ m s^-1 ],angle [deg]\n"
ROW = "a,100,2650,50,30\n"
PART = f"\n[Name]\nWall, 1\n\n[Data]\n{HEADER}{ROW}"


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    "text",
    [f"# by me\n\n#x, y\n{HEADER}{ROW}", f'"# by, me"\n{HEADER}# half, way\n{ROW}', PART, f"# by me\n{PART}"],
    ids=["comments", "comments among rows", "CFD-Post", "both"],
)
def test_comments_and_what_cfd_post_writes_above_a_table(tmp_path, text, end):
    path = tmp_path / "a.csv"
    path.write_text(text, newline=end)
    (block,) = read_impacts(path).blocks(10)
    np.testing.assert_array_equal(np.asarray(block.speed), [50])


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (PART + PART, r"\[Name\] begins another part"),
        (f"{PART}\n[Faces]\n0, 1, 2, 3, 4\n", r"\[Faces\] begins another part"),
        (f"# {HEADER}{ROW.replace('a', '1')}", r"line 2 must name the columns, but is '1,100,2650,50,30'"),
        ("# a\n#b\n", "no line that names columns"),
        (f"[Name]\nw\n{HEADER}{ROW}", r"\[Data\] is missing"),
        (f"{HEADER}{ROW}#a,100,2650,50,30\n", "column 'note': rows begin with #"),
        (f"# by me\n{HEADER}{ROW}a,x,2650,50,30\n", r"row 2: column `diameter \[um\]` must be a number, but is 'x'"),
    ],
)
def test_parts_and_comments_that_leave_a_doubt(tmp_path, text, named):
    with pytest.raises(ImpactsError, match=named):
        list(read_impacts(written(tmp_path / "a.csv", text)).blocks(10))


@pytest.mark.parametrize("name", ["depth_m", "distance m", "arc length m"])
def test_a_name_that_ends_in_metres_is_taken_for_no_mass(tmp_path, name):
    text = f"{HEADER.rstrip()},{name}\n{ROW.rstrip()},1\n"
    with pytest.raises(ImpactsError, match=f"{name}.*the unit of a length"):
        read_impacts(written(tmp_path / "a.csv", text))
