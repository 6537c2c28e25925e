"""Files of a run with one mistake each: refused, right, or visible; never a wrong number without a word.

Visible is a finding that the right files do not have, or another line in the block `Read:`.
"""

import contextlib
import gzip
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import MapSummary
from erosion.cfd.read import read_impacts, read_surface
from erosion.cfd.rows import ImpactsError
from tests.cfd.parts import PARTS, rows_on, write
from tests.cfd.tables import warnings_of

P = erosion.TABLE_1.to("si")
ROWS = rows_on(PARTS["plate"], rows=200).columns
NAMES = ("x [mm]", "y [mm]", "z [mm]", "u [m/s]", "v [m/s]", "w [m/s]", "d [um]", "rho [kg/m^3]", "count", "time [s]")
NUMBERS = np.column_stack(
    [1e3 * ROWS["position"], ROWS["velocity"], 1e6 * ROWS["diameter"], np.full(200, 2650.0), ROWS["count"],
     np.linspace(0, 1, 200)]
)  # fmt: skip
HEAD = ",".join(NAMES)
TEXT = "\n".join([HEAD, *(",".join(f"{number:.9g}" for number in row) for row in NUMBERS), ""])
LINES = TEXT.splitlines()


def headed(old: str, new: str) -> str:
    """The table with another heading."""
    assert old in HEAD
    return TEXT.replace(old, new, 1)


def with_cell(cell: str, column: int = 3, row: int = 5) -> str:
    """The table with another cell."""
    lines = [*LINES]
    cells = lines[row].split(",")
    cells[column] = cell
    lines[row] = ",".join(cells)
    return "\n".join([*lines, ""])


def with_column(heading: str, values: Any = 7.0, text: str = TEXT) -> str:
    """The table with one more column."""
    lines = text.splitlines()
    numbers = np.broadcast_to(values, len(lines) - 1)
    more = (f"{line},{number:.9g}" for line, number in zip(lines[1:], numbers, strict=True))
    return "\n".join([f"{lines[0]},{heading}", *more, ""])


def changed(column: int, change: Callable[[np.ndarray], Any], heading: str | None = None) -> str:
    """The table with other numbers in a column, and another heading."""
    numbers = NUMBERS.copy()
    numbers[:, column] = change(numbers[:, column])
    names = [*NAMES]
    names[column] = heading or names[column]
    return "\n".join([",".join(names), *(",".join(f"{number:.9g}" for number in row) for row in numbers), ""])


def without(column: int) -> str:
    """The table without a column."""
    return "\n".join(",".join(np.delete(line.split(","), column)) for line in LINES) + "\n"


def swapped(one: int, other: int) -> str:
    """The table with the headings of two columns exchanged."""
    names = [*NAMES]
    names[one], names[other] = names[other], names[one]
    return "\n".join([",".join(names), *LINES[1:], ""])


ANGLED = ",".join(("x [mm]", "y [mm]", "z [mm]", "speed [m/s]", "angle [deg]", "d [um]", "rho [kg/m^3]", "count"))


def angled(heading: str = "angle [deg]", change: Callable[[float], float] = lambda angle: angle) -> str:
    """The table with speeds and angles in place of velocities."""
    angle = change(float(np.degrees(0.52)))
    rows = (f"{x:.9g},{y:.9g},{z:.9g},30,{angle:.9g},50,2650,10" for x, y, z in NUMBERS[:, :3])
    return "\n".join([ANGLED.replace("angle [deg]", heading), *rows, ""])


def texts() -> Iterator[tuple[str, str | bytes]]:
    """Each table by what is wrong with it, or only unusual."""
    for place, name in enumerate(NAMES):
        bare = name.partition(" ")[0]
        yield f"without {bare}", without(place)
        yield f"{bare} twice", with_column(name, NUMBERS[:, place])
        if "[" in name:
            yield f"{bare} without a unit", headed(name, bare)
            yield f"{bare} in kelvin", headed(name, f"{bare} [K]")
            yield f"{bare} in nonsense", headed(name, f"{bare} [blob]")
    wrong = {
        "x": ("m", "cm", "in", "um"), "u": ("mm/s", "ft/s", "km/h"), "d": ("mm", "m", "nm", "mil"),
        "rho": ("g/cm^3", "lb/ft^3"), "time": ("ms", "h"),
    }  # fmt: skip
    for bare, units in wrong.items():
        for unit in units:
            text = headed(next(name for name in NAMES if name.startswith(f"{bare} ")), f"{bare} [{unit}]")
            if bare in "xu":
                for other in {"x": "yz", "u": "vw"}[bare]:
                    text = re.sub(rf"\b{other} \[m[m/s]*\]", f"{other} [{unit}]", text, count=1)
            yield f"{bare} called {unit}", text
    for word in ("grains", "Ngrains", "N", "n_p", "weight", "wt", "parcels", "hits", "factor", "multiplicity", "num",
                 "scale", "particles", "mass of parcel", "nParticle", "number", "Anzahl", "share"):  # fmt: skip
        yield f"the weight is called {word}", headed("count", word)
        yield f"{word} beside the weight", with_column(word)
    for heading in ("speed [m/s]", "Umag [m/s]", "v_rel [m/s]", "angle [deg]", "theta [deg]", "mass [kg]", "m", "dp",
                    "radius [um]", "size", "parcel mass [kg]", "mass_flow [kg/s]", "frequency [1/s]", "spin [rad/s]",
                    "spin", "face", "facei", "id", "Unnamed: 0", "", "temperature [K]", "flux", "rate"):  # fmt: skip
        yield f"with a column {heading!r}", with_column(heading)
    for heading in ("dp [um]", "d32 [um]", "d50 [um]", "size [um]", "radius [um]", "R [um]", "D [um]", "diam [um]"):
        yield f"the diameter is called {heading}", headed("d [um]", heading)
    for cell in ("", "n.a.", "nan", "inf", "-inf", "1e400", "x", "1_000", "0x10", "12,5", "1 234", "−12.5",
                 "12.5.1", "TRUE", "2024-01-05", "#DIV/0!", "#REF!", "12.5 m/s", "1e3e3", "١٢", "=A1",
                 '"12.5"', "1,234"):  # fmt: skip
        yield f"a cell {cell!r}", with_cell(cell)
    yield "a negative size", with_cell("-50", 6)
    yield "a size of 0", with_cell("0", 6)
    yield "a negative weight", with_cell("-1", 8)
    yield "a weight of 0", with_cell("0", 8)
    yield "an enormous weight", with_cell("1e9", 8)
    yield "an enormous particle", with_cell("5e4", 6)
    yield "radii for diameters", changed(6, lambda d: d / 2)
    yield "diameters in mm", changed(6, lambda d: d / 1e3)
    yield "densities in g/cm³", changed(7, lambda rho: rho / 1e3)
    yield "velocities to the other side", changed(5, lambda w: -w)
    yield "the axes u and w exchanged", swapped(3, 5)
    yield "the axes x and z exchanged", swapped(0, 2)
    yield "sizes and densities exchanged", swapped(6, 7)
    yield "rows far away", changed(2, lambda z: z + 1e3)
    yield "half of the rows far away", changed(2, lambda z: z + 1e3 * (np.arange(200) % 2))
    yield "all rows in one place", changed(0, lambda x: 0 * x + x[0])
    yield "all rows twice", TEXT + "\n".join(LINES[1:]) + "\n"
    yield "a row many times", "\n".join([*LINES, *[LINES[5]] * 50, ""])
    yield "half of the rows", "\n".join([*LINES[:101], ""])
    yield "the header twice", TEXT + TEXT
    yield "no header", "\n".join(LINES[1:]) + "\n"
    yield "a title above", "Impacts of run 7\n" + TEXT
    yield "a comment above", "# run 7\n" + TEXT
    yield "no rows", HEAD + "\n"
    yield "nothing", ""
    yield "cut off", TEXT[: len(TEXT) // 2]
    yield "a cell too many", "\n".join([*LINES[:9], LINES[9] + ",1", *LINES[10:], ""])
    yield "a cell too few", "\n".join([*LINES[:9], LINES[9].rpartition(",")[0], *LINES[10:], ""])
    yield "semicolons", TEXT.replace(",", ";")
    yield "tabs", TEXT.replace(",", "\t")
    yield "bars", TEXT.replace(",", "|")
    yield "decimal commas between commas", TEXT.replace(".", ",")
    yield "decimal commas between semicolons", TEXT.replace(",", ";").replace(".", ",")
    yield "thousands", TEXT.replace(",", ";").replace(";2650;", ";2.650;")
    yield "a named separator", "sep=;\n" + TEXT.replace(",", ";")
    yield "a wrong named separator", "sep=;\n" + TEXT
    yield "Windows", TEXT.replace("\n", "\r\n").replace("um", "µm").encode("cp1252")
    yield "old Mac", TEXT.replace("\n", "\r")
    yield "UTF-16", TEXT.encode("utf-16")
    yield "UTF-32", TEXT.encode("utf-32")
    yield "a byte order mark", b"\xef\xbb\xbf" + TEXT.encode()
    yield "zeros", TEXT.encode() + b"\0" * 100
    yield "compressed without saying so", gzip.compress(TEXT.encode())
    yield "Excel's first bytes", b"PK\3\4" + TEXT.encode()
    yield "Parquet's first bytes", b"PAR1" + TEXT.encode()
    yield "angles", angled()
    yield "angles from the normal", angled(change=lambda angle: 90 - angle)
    yield "radians called degrees", angled(change=np.radians)
    yield "degrees called radians", angled("angle [rad]")
    yield "angles without a unit", angled("angle")
    yield "negative angles", angled(change=lambda angle: -angle)
    yield "angles above 90°", angled(change=lambda angle: 180 - angle)


RIGHT = {
    "without time",
    "x called um",
    "time called ms",
    "time called h",
    "the weight is called grains",
    "the weight is called Ngrains",
    "the weight is called nParticle",
    "share beside the weight",
    "with a column 'speed [m/s]'",
    "with a column 'Umag [m/s]'",
    "with a column 'angle [deg]'",
    "with a column 'spin [rad/s]'",
    "with a column 'facei'",
    "with a column 'id'",
    "with a column 'Unnamed: 0'",
    "with a column ''",
    "with a column 'temperature [K]'",
    "the diameter is called dp [um]",
    "the diameter is called D [um]",
    "a cell '\"12.5\"'",
    "a weight of 0",
    "velocities to the other side",
    "all rows in one place",
    "a comment above",
    "semicolons",
    "tabs",
    "decimal commas between semicolons",
    "a named separator",
    "Windows",
    "old Mac",
    "UTF-16",
    "a byte order mark",
    "angles",
}
"""Tables that give the usual volume all the same."""
VISIBLE = {
    "u called mm/s",
    "u called ft/s",
    "u called km/h",
    "d called mm",
    "d called m",
    "d called nm",
    "d called mil",
    "rho called g/cm^3",
    "rho called lb/ft^3",
    "with a column 'mass [kg]'",
    "an enormous weight",
    "an enormous particle",
    "radii for diameters",
    "diameters in mm",
    "densities in g/cm³",
    "the axes u and w exchanged",
    "sizes and densities exchanged",
    "half of the rows far away",
    "all rows twice",
    "a row many times",
    "half of the rows",
    "thousands",
    "angles from the normal",
    "radians called degrees",
}
"""Tables that no reader can know to be wrong: a finding or `Read:` shows it. All others are refused."""


@pytest.fixture(scope="module")
def right(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, float, set[str], str]:
    """The surface; and of the right table the volume, the findings and what was read."""
    folder = tmp_path_factory.mktemp("right")
    surface = read_surface(write(PARTS["plate"], folder / "plate.stl", 1e3), unit="mm")
    (folder / "hits.csv").write_text(TEXT)
    dataset = erosion_map("linearized", P, read_impacts(folder / "hits.csv"), surface)
    return surface, float(dataset.total_volume), set(warnings_of(dataset)), dataset.attrs["read_as"]


def outcome(path: Path, right: tuple[Any, float, set[str], str], surface: Any = None, **options: Any) -> str:
    """What a table gets: "refused", "right", "visible"; empty for a wrong number without a word."""
    usual, volume, said, read_as = right
    try:
        dataset = erosion_map("linearized", P, read_impacts(path), usual if surface is None else surface, **options)
    except (ImpactsError, ValueError) as error:
        return "refused" * bool(str(error))
    if abs(float(dataset.total_volume) / volume - 1) < 0.05:
        return "right"
    return "visible" if set(warnings_of(dataset)) - said or dataset.attrs["read_as"] != read_as else ""


@pytest.mark.parametrize(("name", "text"), [pytest.param(*case, id=case[0]) for case in texts()])
def test_a_table_with_a_mistake(tmp_path: Path, right: Any, name: str, text: str | bytes) -> None:
    (tmp_path / "hits.csv").write_bytes(text.encode() if isinstance(text, str) else text)
    expected = "right" if name in RIGHT else "visible" if name in VISIBLE else "refused"
    assert outcome(tmp_path / "hits.csv", right) == expected


def surfaces(path: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Each surface by what is wrong with it; `path` is a right one in millimetres."""
    for unit in ("m", "cm", "um", "in", "ft", "km", "kg", ""):
        yield f"in {unit!r}", lambda unit=unit: read_surface(path, unit=unit)
    content = path.read_bytes()

    def as_file(content: bytes, ending: str = ".stl") -> Any:
        other = path.with_name(f"other{ending}")
        other.write_bytes(content)
        return read_surface(other, unit="mm")

    yield "cut off", lambda: as_file(content[:-20])
    yield "longer", lambda: as_file(content + b"\0" * 50)
    yield "empty", lambda: as_file(b"")
    yield "of another ending", lambda: as_file(content, ".obj")
    yield "called VTP", lambda: as_file(content, ".vtp")
    usual = read_surface(path, unit="mm")

    def usual_with(points: np.ndarray) -> Any:
        return type(usual)("other", points, usual.corners, usual.ends, usual.patches, usual.patch, is_facing=False)

    moved = {"by 1 mm": 1e-3, "by 1 cm": 1e-2, "by 1 m": 1.0}
    for words, size in moved.items():
        for axis in range(3):
            points = usual.points + size * np.eye(3)[axis]
            yield f"moved {words} along {'xyz'[axis]}", lambda points=points: usual_with(points)
    yield "turned over", usual.reversed
    yield "upright", lambda: usual_with(usual.points[:, [0, 2, 1]])
    yield "of half the size", lambda: usual_with(usual.points / 2)


def test_a_surface_with_a_mistake(tmp_path: Path, right: Any) -> None:
    (tmp_path / "hits.csv").write_text(TEXT)
    silent = list[str]()
    for name, made in surfaces(write(PARTS["plate"], tmp_path / "plate.stl", 1e3)):
        with contextlib.suppress(ImpactsError):
            if not outcome(tmp_path / "hits.csv", right, made()):
                silent.append(name)
    assert not silent


@pytest.mark.parametrize("is_named", [False, True])
@pytest.mark.parametrize(
    ("factors", "rows"), [((1.0,), 0), ((1.04,), 0), ((1.1,), 200), ((0.5,), 200), ((1.0, 2.0), 100)]
)
def test_a_mass_that_contradicts_diameter_and_density(
    tmp_path: Path, right: Any, factors: tuple[float, ...], rows: int, is_named: bool
) -> None:
    masses = np.resize(factors, len(NUMBERS)) * 2650 * np.pi / 6 * (NUMBERS[:, 6] * 1e-6) ** 3
    text = without(7) if is_named else TEXT
    (tmp_path / "hits.csv").write_text(with_column("mass [kg]", masses, text))
    density = {"named_density": 2650.0} if is_named else {}
    dataset = erosion_map("linearized", P, read_impacts(tmp_path / "hits.csv", **density), right[0])
    found = [one for one in MapSummary(dataset).findings if one.code == "mass_contradicts_size"]
    assert [one.numbers["rows"] for one in found] == [rows] * (rows > 0)
    assert all(one.numbers["least"] == pytest.approx(factors[-1]) for one in found)
    assert ("2650 kg/m³ as stated" in dataset.attrs["read_as"]) == (rows > 0)
