"""Numbers, units and formulas as a reader sees them.

The texts of the questions: their Markdown, their fields, and what is said of a mistake in them.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from erosion.parameters.parameters import TABLE_1
from erosion.plotting.curves import ShapeCurve
from erosion.report.case import Answer, ReportCase
from erosion.report.page import Text, TextError, validity, write_text
from erosion.report.text import degrees, formula, math, number, quantity, to_html


def test_numbers_read_well() -> None:
    plain = str.maketrans("\N{NO-BREAK SPACE}", " ")
    assert number(1.81643635e-4).translate(plain) == "1.8164 × 10⁻⁴"
    assert number(-752.4442) == "−752.44"
    assert number(99999.96, 5).translate(plain) == "100000"
    assert number(0.0) == number(-0.0) == "0"
    assert number(200e3, 7, strip=True) == "200000"
    assert number(3.01e-11, 1, up=True).translate(plain) == "4 × 10⁻¹¹"
    assert number(3e-11, 1, up=True).translate(plain) == "3 × 10⁻¹¹"
    assert number(0.1, 1, up=True) == "0.1"  # though the float is slightly above
    assert number(200e3, 6, strip=True) == "200000"
    assert number(2.855e-7, 7, strip=True).translate(plain) == "2.855 × 10⁻⁷"
    assert number(-1.5e9, tex=True) == r"-1.5000\times 10^{9}"
    assert quantity(6.635e-5, "time", "si", like=6.6e-5).translate(plain) == "66.350 µs"
    assert quantity(6.635e-5, "time", "si").translate(plain) == "6.6350 × 10⁻⁵ s"
    assert quantity(2e-4 * 0.0254**3, "volume", "inch-pound", 2, tex=True) == r"2.0\times 10^{-4}\,\text{in}^{3}"
    assert degrees(np.deg2rad(20)) == "20°"
    assert degrees(np.arctan(2) / 2) == "31.717°"


def test_formulas_are_sound_mathml() -> None:
    for tex in (r"k\cot\alpha=\pm\dot{x}/2", r"\begin{align*} a&=b\\c&=d\end{align*}", r"\sin^2\alpha\left(1\right)"):
        root = ET.fromstring(math(tex))
        assert root.tag.endswith("math")
    assert "<mo>&#x000B1;</mo>" in math(r"\pm")
    assert math(r"k\sin x").count("<mspace") == 2
    assert math(r"\cdot\sin(x)").count("<mspace") == 0
    assert formula("x").startswith('<div class="math"')


CASE = ReportCase(TABLE_1, "Table 1")


def text_of(folder: Path, derivation: str, *, figures: str = "", **fields: Any) -> Text:
    """A text with this derivation, filled in."""
    path = folder / "q2.md"
    path.write_text(
        f"# Title\n\nIdea: Why.\n\nThe answer.\n\n{figures}\n\n## Derivation\n\n{derivation}\n", encoding="utf-8"
    )
    return write_text(path, CASE, Answer(fields, {"shape": Figure()}))


def test_a_text_has_a_title_a_sentence_figures_and_a_derivation(tmp_path: Path) -> None:
    text = text_of(tmp_path, "It is {{ volume | number(3) }}.", figures="![A **line**.](shape)\nThe shape.", volume=1.5)
    assert (text.title, text.idea, text.sentence) == ("Title", "Why.", "The answer.")
    assert text.derivation == "<p>It is 1.50.</p>"
    assert text.illustrations == (("shape", "The shape.", "A **line**."),)


@pytest.mark.parametrize(
    ("derivation", "fields", "reason"),
    [
        ("{{ 1.0 | numbr }}", {}, r".*line 11: No filter named 'numbr'\."),
        ("{% if true %}", {}, r".*line \d+: Unexpected end of template"),
        ("Table: t\n| a |\n| 1 |", {}, r".*Below a caption must be a table, .*Table: t"),
        (r"$\left(x$", {}, r".*formula '.*left\(x' cannot be read \(ExtraLeftOrMissingRightError\)"),
        ("## Again\n\nText.", {}, ".*A text must be"),
        ("First.\n\nThe volume is {{ volum | number }}.", {"volume": 1.0}, r", line 13: 'volum' is undefined\."),
        ("The width is {{ case.p.width }}.", {}, r", line 11: '.*Parameters object' has no attribute 'width'\."),
        ("", {"figures": "![A line.](shap)\nThe shape."}, r": The figure 'shap' is unknown; there are shape\."),
    ],
)
def test_a_mistake_in_a_text_is_named_with_its_file(
    tmp_path: Path, derivation: str, fields: dict[str, Any], reason: str
) -> None:
    with pytest.raises(TextError, match=rf"/q2\.md{reason}"):
        text_of(tmp_path, derivation, **fields)


def test_angles_that_turn_by_more_than_90_degrees_are_named_in_one_sentence() -> None:
    degrees, n = np.array([1, 2, 3, np.nan, 4, 5, 6]), np.arange(7)
    where = {"one": n > 4, "other": n > 4, "steep": n < 2, "two": (n == 1) | (n == 4), "all": n != 3, "none": n < 0}
    curves = [ShapeCurve(name, np.deg2rad(degrees), degrees, beyond=beyond) for name, beyond in where.items()]
    sentence = validity(Answer({}, {}, curves=curves))
    assert sentence.endswith(": one, other from 5° on; steep up to 2°; two at 2° and at 4°; all at every angle.")
    assert validity(Answer({}, {}, curves=curves[-1:])) == ""


def test_fields_are_text_not_html(tmp_path: Path) -> None:
    assert "&lt;b&gt;a &amp; b&lt;/b&gt;" in text_of(tmp_path, "{{ words }}", words="<b>a & b</b>").derivation


def test_markdown_becomes_html() -> None:
    assert to_html("One\nline.\n\n> A **note**\n> on `code`.").replace("\n", " ") == (
        '<p>One line.</p> <div class="note"><p>A <strong>note</strong> on <code>code</code>.</p> </div>'
    )
    assert to_html("$$\nx\n$$").startswith('<div class="math"')
    for text in ("from $$x$$ to y", "from $$x$$", "$$x$$ (label)", "$$x$$ and more"):
        assert "$" not in to_html(text)
        assert to_html(text).count("<math") == 1
    assert "<p>So <math" in to_html("So $x$")
    table = to_html("Table: Of $x$\n| a | b [m s] |\n|---|--:|\n| r | 1 |").replace("\n", "")
    assert table.startswith('<div class="table" tabindex="0"><table><caption>Of <math')
    assert '<th scope="col">b [m\N{NO-BREAK SPACE}s]</th>' in table
    assert '<tr><th scope="row">r</th><td>1</td></tr>' in table
    assert 'class="table wordy"' in to_html("| a | b |\n|---|---|\n| r | words |")
