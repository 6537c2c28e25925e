"""Findings: each code of the catalogue is used, and its text needs the numbers that the code gives."""

import re
import string
from pathlib import Path

import pytest

import erosion
from erosion.results import Finding, from_attribute, to_attribute
from erosion.results.findings import LEVELS, catalogue

SOURCE = "".join(path.read_text() for path in Path(next(iter(erosion.__path__))).rglob("*.py"))


@pytest.mark.parametrize("code", catalogue())
def test_a_code_has_a_level_and_is_used(code: str) -> None:
    entry = catalogue()[code]
    assert entry.keys() == {"level", "text"}
    assert entry["level"] in LEVELS
    stem = "rows_" if code.startswith("rows_") and f'"{code}"' not in SOURCE else code
    assert re.search(rf'"{stem}', SOURCE)
    for _, name, _, _ in string.Formatter().parse(entry["text"]):
        assert name is None or name == "about" or re.search(rf'"{name}"|\b{name}[:=]', SOURCE), name


def test_a_text_is_its_template_with_the_numbers() -> None:
    turned = Finding("turned_beyond", "rotating", {"turn": 1.6})
    assert turned.text.startswith("rotating: The body turned by 91.7° during")
    part = Finding("partly_out_of_range", "dnv", {"share": 0.4, "made_for": "speeds to 200 m/s"})
    assert part.text == "40 % of the impacts are outside of the range that dnv is made for: speeds to 200 m/s."
    apart = Finding("unused_columns", "rows.csv", {"columns": ["a", "b"]})
    assert (apart.level, apart.text) == ("note", "rows.csv: columns that are not used: 'a', 'b'.")
    assert str(part) == part.text


def test_entries_that_hold_commas_are_joined_by_semicolons() -> None:
    without = Finding("fit_without_outlier", "line 5", {"estimates": ["k = 2, psi = 1", "v = 3"]})
    assert without.text == "Without line 5 the fit is k = 2, psi = 1; v = 3."


def test_findings_come_back_from_a_file() -> None:
    findings = (Finding("not_certified"), Finding("unused_columns", "rows.csv", {"columns": ["ä", "b"]}))
    assert from_attribute(to_attribute(findings)) == findings
    assert (to_attribute(()), from_attribute("")) == ("", ())


def test_a_code_that_is_unknown_is_refused() -> None:
    with pytest.raises(ValueError, match="but is 'no-such-code'"):
        Finding("no-such-code")
