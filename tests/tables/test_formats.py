"""One table in every format that is read: the same numbers, or a refusal that names what decides."""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import xarray as xr
from pyarrow import feather, parquet

from erosion.tables import TableError, Wanted, open_table
from erosion.tables.frames import TABLE_FORMATS

WANTED = {
    "angle": Wanted(("angle",), ("alpha",)),
    "speed": Wanted(("speed",), ("v",)),
    "size": Wanted(("length",), ("d",)),
}
NUMBERS = {"angle": np.radians([30.0, 45.5]), "speed": np.array([1250.0, 98.5]), "size": np.array([1e-4, np.nan])}
PLAIN = "note,alpha [deg],v [m/s],d [um]\na,30,1250,100\nb,45.5,98.5,n.a.\n"
GERMAN = "note;alpha [deg];v [m/s];d [um]\na;30;1250;100\nb;45,5;98,5;n.a.\n"

TEXTS: dict[str, str | bytes] = {
    "commas": PLAIN,
    "semicolons": PLAIN.replace(",", ";"),
    "tabs": PLAIN.replace(",", "\t"),
    "spaces": PLAIN.replace(" [", "_").replace("]", "").replace(",", "   "),
    "decimal commas": GERMAN,
    "tabs and decimal commas": GERMAN.replace(";", "\t"),
    "a separator that is named": "sep=;\n" + GERMAN,
    "comments": f"# of a run\n% by me\n\n{PLAIN}".replace("b,", '# later\n"# later, too",,,\n,,,\n\nb,'),
    "ISO headings": "note,α / °,v / m s-1,d / 10^-6 m\n" + PLAIN.partition("\n")[2],
    "units below": "note,alpha,v,d\n,deg,m/s,um\na,30,1250,100\nb,45.5,98.5,n.a.\n",
    "units in brackets below": "note,alpha,v,d\n-,[°],[m s^-1],[um]\na,30,1250,100\nb,45.5,98.5,n.a.\n",
    "some units below": "note,alpha [deg],v,d\n,,m/s,um\na,30,1250,100\nb,45.5,98.5,n.a.\n",
    "byte order mark": b"\xef\xbb\xbf" + PLAIN.encode(),
    "UTF-16": PLAIN.replace("um", "µm").encode("utf-16"),
    "Windows": PLAIN.replace("um", "µm").replace("a,", "größer,").replace("\n", "\r\n").encode("cp1252"),
    "old Mac": PLAIN.replace("\n", "\r"),
    "quotes": PLAIN.replace("a,30", '"a, b","30"').replace("note", '"note"'),
    "no end": PLAIN.rstrip(),
    "spaces after commas": PLAIN.replace(",", ", "),
}  # fmt: skip


def check(table: Any, numbers: dict[str, np.ndarray] = NUMBERS) -> None:
    for name, values in numbers.items():
        np.testing.assert_allclose(table.numbers[name], values, rtol=1e-15, err_msg=name)


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("is_compressed", [False, True])
def test_a_text_is_read(tmp_path: Path, name: str, is_compressed: bool) -> None:
    content = TEXTS[name]
    content = content.encode() if isinstance(content, str) else content
    path = tmp_path / ("a.txt.gz" if is_compressed else "a.txt")
    path.write_bytes(gzip.compress(content) if is_compressed else content)
    table = open_table(path, WANTED)
    check(table)
    assert (table.unused, bool(table.source.notes)) == (("note",), name == "Windows")


FRAME = pd.DataFrame({"alpha [deg]": [30.0, 45.5], "v [m/s]": [1250.0, 98.5], "d [um]": [100.0, np.nan]})


def excel(path: Path, rows: list[list[Any]], sheets: int = 1) -> Path:
    """A workbook of numbers and texts, by the smallest parts that the format has."""
    import zipfile

    def cell(value: Any) -> str:
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
        return f"<c><v>{value!r}</v></c>" if value is not None else "<c/>"

    space = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    sheet = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
    office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    relations = "http://schemas.openxmlformats.org/package/2006/relationships"
    names = range(1, sheets + 1)
    parts = {
        "[Content_Types].xml": '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"/>',
        "_rels/.rels": f'<Relationships xmlns="{relations}"><Relationship Id="a" Type="{office}/officeDocument" '
        'Target="xl/workbook.xml"/></Relationships>',
        "xl/workbook.xml": f'<workbook {space} xmlns:r="{office}"><sheets>'
        + "".join(f'<sheet name="s{n}" sheetId="{n}" r:id="s{n}"/>' for n in names)
        + "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{relations}">'
        + "".join(f'<Relationship Id="s{n}" Type="{office}/worksheet" Target="worksheets/s{n}.xml"/>' for n in names)
        + "</Relationships>",
        **{f"xl/worksheets/s{n}.xml": f"<worksheet {space}><sheetData>{sheet}</sheetData></worksheet>" for n in names},
    }
    with zipfile.ZipFile(path, "w") as file:
        for name, text in parts.items():
            file.writestr(name, text)
    return path


def write_excel(path: Path, units: bool = False) -> None:
    bare = [str(heading).partition(" ")[0] for heading in FRAME]
    rows = [[None if np.isnan(cell) else cell for cell in row] for row in FRAME.to_numpy().tolist()]
    excel(path, [bare, ["deg", "m/s", "um"], *rows] if units else [list(FRAME), *rows])


def write_feather(path: Path) -> None:
    feather.write_feather(pa.Table.from_pandas(FRAME), path)


WRITERS: dict[str, Callable[[Path], Any]] = {
    ".parquet": FRAME.to_parquet,
    ".feather": write_feather,
    ".arrow": write_feather,
    ".xlsx": write_excel,
    ".xlsm": write_excel,
}
"""By the ending of a name, what writes `FRAME` so."""


@pytest.mark.parametrize("ending", [ending for each in TABLE_FORMATS for ending in each.endings])
def test_each_format_is_read_by_the_name_of_its_file_and_by_what_it_begins_with(tmp_path: Path, ending: str) -> None:
    WRITERS[ending](tmp_path / f"a{ending}")
    check(open_table(tmp_path / f"a{ending}", WANTED))
    path = (tmp_path / f"a{ending}").rename(tmp_path / "a.dat")
    check(open_table(path, WANTED))
    with pytest.raises(TableError, match="no table of text, so Argument `decimal`"):
        open_table(path, WANTED, decimal=",")


def test_units_of_a_file_of_numbers_stand_beside_the_headings(tmp_path: Path) -> None:
    write_excel(tmp_path / "units.xlsx", units=True)
    check(open_table(tmp_path / "units.xlsx", WANTED))
    bare = [str(heading).partition(" ")[0] for heading in FRAME]
    units = zip(bare, ("deg", "m/s", "um"), strict=True)
    schema = pa.schema([pa.field(head, pa.float64(), metadata={"units": unit}) for head, unit in units])
    arrays = [pa.array(FRAME[heading].to_numpy()) for heading in FRAME]
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), tmp_path / "units.parquet")
    check(open_table(tmp_path / "units.parquet", WANTED))


def test_objects_are_read() -> None:
    units = {"alpha": "deg", "v": "m/s", "d": "um"}
    columns = {
        head: ("row", FRAME.iloc[:, i].to_numpy(), {"units": unit}) for i, (head, unit) in enumerate(units.items())
    }
    two_rows = FRAME.set_axis(pd.MultiIndex.from_tuples(units.items()), axis=1)
    for data in (FRAME, FRAME.to_dict("list"), xr.Dataset(columns), xr.Dataset(columns).set_coords("alpha"), two_rows):
        check(open_table(data, WANTED))


@pytest.mark.parametrize("sep", ["\t", "tab"])
def test_tabs_can_be_named(tmp_path: Path, sep: str) -> None:
    (tmp_path / "a.csv").write_text("v [m/s]\td [um]\n1\t2\n")
    assert open_table(tmp_path / "a.csv", WANTED, sep=sep).numbers["speed"].tolist() == [1.0]


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("v [m/s];d [um]\n1.250;3\n2;4\n", {}, ("1.25", "1250", "`decimal`")),
        ("v [m/s];d [um]\n1,250;3\n2;4\n", {}, ("1.25", "1250", "`decimal`")),
        ("v [m/s]\n4.400\n4.300\n", {}, ("4.4", "4400", "`decimal`")),
        ("v [m/s];d [um]\n1.250;3\n2;4\n", {"decimal": ","}, ("line 2", "'1.250'")),
        ("v [m/s];d [um]\n1.250;3,5\n2;4\n", {}, ("points and with commas", "`decimal`")),
        ("v [m/s],d [um]\n1,250,3\n2,4\n", {}, ("line 2", "3 cells")),
        ('v [m/s],d [um]\n"1,250",3\n2,4\n', {}, ("line 2", "'1,250'")),
        ("v [m/s];d [um]\n" + "1;2\n" * 20_000 + "1.250;3\n", {}, ("line 20002", "`decimal`")),
        ("v [m/s];d [um]\n" + "1;2\n" * 20_000 + "1,5;3\n", {}, ("line 20002", "'1,5'", "`decimal`")),
        ("v [m/s];d [um]\n1;2;3\n", {}, ("line 2", "3 cells")),
        ("v [m/s];d [um]\n1;wide\n", {}, ("line 2", "'wide'")),
        ("v [m/s];d [um]\n# 1\n\n1;1_0\n", {}, ("line 4", "'1_0'")),
        ("Test of May\nv [m/s];d [um]\n1;2\n", {}, ("line 1", "title")),
        ("1;2\n3;4\n", {}, ("line 1", "must name the columns")),
        ("v [m/s];d [um]\n1;2\n", {"sep": "|"}, ("`sep`", "'tab'")),
        ("v [m/s];d [um]\n1;2\n", {"decimal": "'"}, ("`decimal`",)),
        ("v,d\nm/s,um\n1,2\n", {"columns": {"v": "ft/s"}}, ("'v'", "another unit")),
        ("note,d [um]\na,2\n#3,4\n", {}, ("rows begin with #",)),
        ("v [m/s],d [um]\n1,2\n[Name]\n", {}, ("[Name]",)),
        ("v\0", {}, ("no table of text",)),
        ("", {}, ("is empty",)),
    ],
)  # fmt: skip
def test_a_text_that_leaves_a_doubt_is_refused(tmp_path: Path, text: str, options: Any, words: tuple[str, ...]) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(TableError) as refused:
        _ = open_table(tmp_path / "a.csv", WANTED, **options).numbers
    assert str(refused.value).startswith((str(tmp_path / "a.csv"), "Argument"))
    assert [word for word in words if word not in str(refused.value)] == []


@pytest.mark.parametrize(
    ("text", "decimal", "speed"),
    [
        ("v [m/s];d [um]\n1.250;3\n2;4\n", ".", 1.25),
        ("v [m/s];d [um]\n1,250;3\n2;4\n", ",", 1.25),
        ("v [m/s];d [um]\n1.250;0.5\n2;4\n", None, 1.25),
        ("v [m/s];d [um]\n1.250;30.0\n2;4\n", None, 1.25),
        ("v [m/s];d [um]\n1,250;0,5\n2;4\n", None, 1.25),
        ("v [m/s],d [um]\n1.250,3\n2,4\n", None, 1.25),
    ],
)
def test_the_mark_of_decimals_is_named_or_shown(tmp_path: Path, text: str, decimal: str | None, speed: float) -> None:
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_array_equal(open_table(tmp_path / "a.csv", WANTED, decimal=decimal).numbers["speed"], [speed, 2])


def test_rows_are_found_again_in_their_file(tmp_path: Path) -> None:
    rows = "".join("# c\n" * (n % 3 == 0) + f"{n},{n}\n" for n in range(200_000))
    (tmp_path / "a.csv").write_text(f"# a\nv [m/s],d [um]\n{rows}")
    table = open_table(tmp_path / "a.csv", WANTED)
    assert len(table.numbers["speed"]) == 200_000
    lines = (tmp_path / "a.csv").read_text().splitlines()
    places = table.lines(np.array([0, 1, 3, 99_999, 199_999]))
    assert places is not None
    assert [lines[place - 1].split(",")[0] for place in places] == ["0", "1", "3", "99999", "199999"]


def test_a_workbook_needs_one_sheet_and_numbers(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="one sheet with content, but has s1, s2"):
        open_table(excel(tmp_path / "a.xlsx", [["v [m/s]"], [1.0]], 2), WANTED)
    with pytest.raises(TableError, match=r"line 2: column `v \[m/s\]` must be a number, but is '1,5'"):
        open_table(excel(tmp_path / "a.xlsx", [["v [m/s]"], ["1,5"]]), WANTED)
    (tmp_path / "a.xlsx").write_bytes(b"junk")
    with pytest.raises(TableError, match="cannot be read as an Excel workbook"):
        open_table(tmp_path / "a.xlsx", WANTED)
