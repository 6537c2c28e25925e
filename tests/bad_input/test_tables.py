"""Bad tables of measurements: one sentence with file, line and column."""

import re

import pytest

from erosion.fits import MeasurementError, read_measurements

HEAD = "angle [deg], volume [in^3], uncertainty [in^3]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", ": is empty."),
        ("\n\n", ": is empty."),
        (HEAD, " has no rows of data."),
        ("volume [in^3]\n1\n", ", line 1, the header has no column `angle [deg]`; its columns are 'volume [in^3]'."),
        ("angle [deg]\n1\n", "must have one column of erosion (volume, mass_loss, erosion), but has none."),
        ("angle [deg],volume [in^3],erosion [-]\n1,1,1\n", "Argument `ignore` may name the others."),
        ("angle [deg],temperature [K]\n1,1\n", "one column of erosion (volume, mass_loss, erosion), but has none."),
        ("angle [deg],angle [deg],erosion\n1,1,1\n", "column 2 (angle [deg]): gives `angle`, but so does 'angle"),
        ("angle [deg],volume\n1,1\n", "(volume): `volume` must carry its unit in brackets, as `volume [mm^3]`."),
        ("angle,volume [in^3]\n1,1\n", "(angle): `angle` must carry its unit in brackets, as `angle [deg]`."),
        ("angle [mm],volume [in^3]\n1,1\n", ", column 1 (angle [mm]): the unit of `angle` must be an angle such as"),
        ("angle [deg],volume [kg]\n1,1\n", "must be one of volume or volume per mass, but is 'kg'."),
        ("angle [deg],volume [blob]\n1,1\n", "but is 'blob'."),
        ("angle [deg],mass_loss [deg]\n1,1\n", "but is 'deg'."),
        ("angle [deg],volume [in^3],uncertainty [g]\n1,1,1\n", "column 3 (uncertainty [g]): the unit of `uncertainty`"),
        (HEAD + "20,1,1\n\n95,1,1\n", ", line 4, column 1 (angle [deg]) must be above 0° and at most 90°, but is 95."),
        (HEAD + "0,1,1\n", ", line 2, column 1 (angle [deg]) must be above 0° and at most 90°, but is 0."),
        (HEAD + "20,1,-2\n", ", line 2, column 3 (uncertainty [in^3]) must be positive and finite, but is -2."),
        (HEAD + "20,1,0\n", "must be positive and finite, but is 0."),
        (HEAD + "20,much,1\n", ", line 2, column 2 (volume [in^3]) must be a number, but is 'much'."),
        (HEAD + "20,1_0,1\n", "must be a number, but is '1_0'."),
        (HEAD + "20,,1\n", "has no row with all of its numbers."),
        (HEAD + "20,nan,1\n", "has no row with all of its numbers."),
        (HEAD + "20,1\n", ", line 2, column 2: there are 2 cells for 3 columns."),
        (HEAD + "20,0,1,5,0,1\n", "column 4: there are 6 cells for 3 columns; columns of numbers with decimal"),
        (HEAD + '"20,5",1,1\n', "must be a number, but is '20,5' (with decimal commas, separate columns by ;)."),
        ("angle [deg];erosion\n1.234,5;1\n", "must be a number, but is '1.234,5'."),
        ('angle [deg],erosion\n"20,1\n', "line 2: cannot be read (unexpected end of data)."),
    ],
)  # fmt: skip
def test_a_bad_table_is_refused_with_its_place(table, text, message):
    path = table(text)
    with pytest.raises(MeasurementError, match=re.escape(message)) as caught:
        read_measurements(path, "inch-pound")
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_that_are_no_table(tmp_path, table):
    with pytest.raises(MeasurementError, match=r"nowhere.csv: cannot be read \(No such file"):
        read_measurements(tmp_path / "nowhere.csv", "si")
    with pytest.raises(MeasurementError, match="has no rows of data"):
        read_measurements(table(HEAD, "utf-16"), "si")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"angle [deg]": [20, 120], "erosion": [1, 2]}, "`data`: row 1, column 'angle [deg]' must be above 0°"),
        ({"angle [deg]": [20], "erosion": [1, 2]}, "must hold columns of one length"),
        ({"angle [deg]": [], "erosion": []}, "has no rows"),
        ({"angle [deg]": ["x"], "erosion": [1]}, "must hold real numbers"),
        ({"angle [deg]": [20]}, "must have one column of erosion"),
        ({"angle [m]": [20], "erosion": [1]}, "column 'angle [m]': the unit of `angle` must be an angle"),
        (3, "must be the path of a CSV file or columns by name, but is int"),
    ],
)
def test_bad_columns_in_memory(data, message):
    with pytest.raises(MeasurementError, match=re.escape(message)):
        read_measurements(data, "si")
