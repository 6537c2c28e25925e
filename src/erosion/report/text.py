"""Numbers, formulas, figures and Markdown as parts of an HTML page, and the frame that all pages share."""

import decimal
import math as maths
import re
from collections.abc import Mapping
from typing import Any

import jinja2
from latex2mathml.converter import convert
from markupsafe import Markup, escape

from erosion.output import briefly
from erosion.parameters import Dimension, Scale, System, readable_scale, superscript, unit_name
from erosion.plotting.labels import DIM, FAINT, INK, PALETTE
from erosion.version import __version__

THEMES: Mapping[str, Mapping[str, str]] = {
    "light": {**PALETTE, "ink": INK, "faint": FAINT, "dim": DIM, "paper": "#ffffff", "page": "#f4f5f7",
              "accent": "#00568a"},
    "dark": {"blue": "#4fb0f0", "vermillion": "#ff8a47", "green": "#2fcca0", "purple": "#e3a0c6", "sky": "#2f7fb8",
             "orange": "#f0b429", "ink": "#e4e7eb", "faint": "#39414a", "dim": "#98a2ad", "paper": "#1b2027",
             "page": "#12161b", "accent": "#7cc4f5"},
}  # fmt: skip
"""Colours of the page by CSS variable. Figures have the same colours; on a dark page they are lighter."""

_VARIABLES = {THEMES["light"][name]: name for name in (*PALETTE, "ink", "faint", "dim")}


def inline_svg(name: str, text: str, description: str) -> Markup:
    """A figure as `<svg>`: it fills its box, has the page's colours, and its ids are unique on the page.

    Args:
        name: of the figure; ids begin with it.
        text: of the SVG file.
        description: a description for readers who cannot see the figure.
    """
    text = text[text.index("<svg") :].strip().replace("fill: #ffffff", "fill: none")
    for color, variable in _VARIABLES.items():
        text = re.sub(color, f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    start, content = text.split(">", 1)
    start = re.sub(r'\s(?:width|height|version)="[^"]*"', "", start)
    return Markup(start + f' role="img" aria-label="{escape(description)}">' + content)


_NO_BREAK = "\N{NO-BREAK SPACE}"
_MINUS = "\N{MINUS SIGN}"
_FUNCTION = r"(?:\\(?:sin|cos|tan|cot|arcsin|arccos|arctan)(?![a-zA-Z])(?:\^(?:\{[^{}]*\}|\w))?|\\mathrm\{arcosh\})"
_BEFORE_FUNCTION = re.compile(rf"(?<!\\cdot)(?<!\\propto)(?<=[\w}})])\s*(?={_FUNCTION})")
_AFTER_FUNCTION = re.compile(rf"({_FUNCTION})\s*(?!\s*(?:\(|\\left|\^))")


def _parts(value: float, digits: int, strip: bool) -> tuple[str, int | None]:
    """The mantissa and, for very large and very small numbers, the power of ten."""
    if value == 0 or not maths.isfinite(value):
        return f"{value:g}".replace("-0", "0"), None
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = int(exponent)
    plain = -3 <= power < 6
    text = f"{float(f'{mantissa}e{power}'):.{max(digits - 1 - power, 0)}f}" if plain else mantissa
    if strip and "." in text:
        text = text.rstrip("0").rstrip(".")
    return text, None if plain else power


def number(value: float, digits: int = 5, *, strip: bool = False, tex: bool = False, up: bool = False) -> str:
    """A number to `digits` significant digits: "1.8164 × 10⁻⁴", "−752.44".

    Args:
        value: any float.
        digits: significant digits.
        strip: leave out zeros at the end, for numbers that are given and not computed.
        tex: in LaTeX.
        up: rounded away from zero, for a bound.
    """
    if up and maths.isfinite(value):
        # of the shortest decimal that is this float: 0.1 is slightly above it and stays 0.1
        value = float(decimal.Context(digits, decimal.ROUND_UP).create_decimal(repr(float(value))))
    text, power = _parts(value, digits, strip)
    if tex:
        return text if power is None else rf"{text}\times 10^{{{power}}}"
    if power is not None:
        text += f"{_NO_BREAK}×{_NO_BREAK}10{superscript(power)}"
    return text.replace("-", _MINUS)


_CORRECTIONS = (
    ("<mi>&#x000B1;</mi>", "<mo>&#x000B1;</mo>"),
    ("<mo>&#x0002F;</mo>", '<mo lspace="0" rspace="0">&#x0002F;</mo>'),
)


def quantity(
    value: float,
    dimension: Dimension,
    units: System,
    digits: int = 5,
    *,
    like: float | None = None,
    tex: bool = False,
) -> str:
    """A number with its unit: "1.8164 × 10⁻⁴ in³".

    Args:
        value: in the base unit.
        dimension: what it measures.
        units: the unit system.
        digits: significant digits.
        like: the magnitude that chooses a handier unit, such as "66.353 µs" or "2.9766 mm³".
        tex: in LaTeX, with the unit upright.
    """
    scale = None if like is None else readable_scale(dimension, units, abs(like))
    if scale is None or scale.unit.startswith("10"):
        scale = Scale(1.0, unit_name(dimension, units))
    text, unit = number(value / scale.size, digits, tex=tex), scale.unit
    if not tex:
        return text + (_NO_BREAK + unit if unit else "")
    for raised, power in (("⁻¹", "-1"), ("²", "2"), ("³", "3")):
        unit = unit.replace(raised, rf"}}^{{{power}}}\text{{")
    return rf"{text}\,\text{{{unit}}}".replace(r"\text{}", "") if unit else text


def degrees(angle: float, digits: int = 5, *, tex: bool = False, up: bool = False) -> str:
    """An angle [rad] in degrees: "31.717°"."""
    return number(maths.degrees(angle), digits, strip=True, tex=tex, up=up) + (r"{}^\circ" if tex else "°")


def math(tex: str, *, display: bool = False) -> Markup:
    """LaTeX as MathML, inside a line of text or on a line of its own."""
    # MathML sets "A sin x" without gaps, for the converter does not mark functions as operators.
    tex = _AFTER_FUNCTION.sub(r"\1\\,", _BEFORE_FUNCTION.sub(r"\\,", tex))
    try:
        mathml = convert(tex, display="block" if display else "inline")
    except Exception as error:  # latex2mathml's errors have no base class and mostly no text
        raise ValueError(f"The formula {tex!r} cannot be read ({type(error).__name__}).") from error
    for written, meant in _CORRECTIONS:
        mathml = mathml.replace(written, meant)
    return Markup(mathml)


def formula(tex: str) -> Markup:
    r"""A formula on its own line. If it is too wide, it breaks at \qquad and before ⇒; then it scrolls."""
    pieces = re.split(r"\\qquad|\\quad(?=\\(?:Left)?[Rr]ightarrow)", tex)
    return Markup('<div class="math" tabindex="0">{}</div>').format(
        Markup("").join(math(piece, display=True) for piece in pieces)
    )


_INLINE = re.compile(r"\$(?P<tex>[^$]+)\$|\*\*(?P<strong>.+?)\*\*|`(?P<code>[^`]+)`")
_UNIT = re.compile(r"\[.*?\]")
_RULE = re.compile(r"\|[-:| ]+")


def blocks(text: str) -> list[str]:
    """Pieces of a text between empty lines."""
    return [block.strip() for block in re.split(r"\n\s*\n", text) if block.strip()]


def to_html(text: str) -> Markup:
    """Blocks of Markdown as blocks of HTML."""
    return Markup("\n").join(_block(block) for block in blocks(text))


def inline(text: str) -> Markup:
    """A line of text with `$formulas$`, `**strong words**` and `` `code` ``."""

    def element(match: re.Match[str]) -> str:
        if match["tex"]:
            return math(match["tex"])
        return f"<strong>{inline(match['strong'])}</strong>" if match["strong"] else f"<code>{match['code']}</code>"

    return Markup(_INLINE.sub(element, " ".join(text.split("\n"))))


def _block(block: str) -> Markup:
    if block.startswith("$$"):
        return formula(block.strip("$").strip())
    if block.startswith("Table:"):
        return _table(*block.split("\n"))
    if block.startswith(">"):
        return Markup('<p class="note">{}</p>').format(inline(re.sub(r"(?m)^> ?", "", block)))
    return Markup("<p>{}</p>").format(inline(block))


def _table(caption: str, head: str, rule: str, *rows: str) -> Markup:
    """A table; its first column names the row. Words are aligned to the left and break into lines."""
    if not _RULE.fullmatch(rule):
        raise ValueError(f"The third line of a table must be of the form |---|--:|, but is {briefly(rule)}.")
    cells = [[inline(cell.strip()) for cell in row.strip().strip("|").split("|")] for row in (head, *rows)]
    first_row = Markup("").join(Markup("<th scope='col'>{}</th>").format(cell) for cell in cells[0])
    headings = Markup("<tr>{}</tr>").format(first_row)
    body = [
        Markup("<tr><th scope='row'>{}</th>{}</tr>").format(
            name, Markup("").join(Markup("<td>{}</td>").format(cell) for cell in others)
        )
        for name, *others in cells[1:]
    ]
    # A unit does not break into lines.
    headings = Markup(_UNIT.sub(lambda unit: unit[0].replace(" ", _NO_BREAK), headings))
    table = Markup(
        '<div class="table" tabindex="0"><table><caption>{}</caption><thead>{}</thead><tbody>{}</tbody></table></div>'
    ).format(inline(caption.removeprefix("Table:").strip()), headings, Markup("").join(body))
    return table if "-:" in rule else Markup('<div class="wordy">{}</div>').format(table)


def render_page(template: str, *, package: str = "erosion.report", **fields: Any) -> str:
    """The text of a page.

    Args:
        template: a file of the package, which extends "frame.html".
        package: that has the file.
        fields: of the template.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name, ".") for name in (package, "erosion.report")]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(themes=THEMES, version=__version__, **fields)
