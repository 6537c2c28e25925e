"""Numbers, formulas and Markdown as parts of an HTML page."""

import decimal
import math as maths
import re
from collections.abc import Sequence
from typing import Any

from latex2mathml.converter import convert
from markdown_it import MarkdownIt
from markdown_it.renderer import RendererHTML
from markdown_it.rules_core import StateCore
from markdown_it.token import Token
from markupsafe import Markup
from mdit_py_plugins.dollarmath import dollarmath_plugin

from erosion.output import briefly
from erosion.parameters import Dimension, Scale, System, readable_scale, superscript, unit_name, unit_size

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
    system: System,
    digits: int = 5,
    *,
    like: float | None = None,
    tex: bool = False,
) -> str:
    """A number with its unit: "1.8164 × 10⁻⁴ in³".

    Args:
        value: in SI.
        dimension: what it measures.
        system: the unit system that shows it.
        digits: significant digits.
        like: the magnitude that chooses a handier unit, such as "66.353 µs" or "2.9766 mm³".
        tex: in LaTeX, with the unit upright.
    """
    scale = None if like is None else readable_scale(dimension, system, abs(like))
    if scale is None or scale.unit.startswith("10"):
        scale = Scale(unit_size(dimension, system), unit_name(dimension, system))
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


_UNIT = re.compile(r"\[.*?\]")
_CAPTION = "Table:"


def blocks(text: str) -> list[str]:
    """Pieces of a text between empty lines."""
    return [block.strip() for block in re.split(r"\n\s*\n", text) if block.strip()]


def to_html(text: str) -> Markup:
    """Blocks of Markdown as blocks of HTML."""
    return Markup(_MARKDOWN.render(text).strip())


def inline(text: str) -> Markup:
    """A line of Markdown as HTML."""
    return Markup(_MARKDOWN.renderInline(text))


def _caption_tables(state: StateCore) -> None:
    """Take the line before each table as its caption.

    Raises:
        ValueError: for a caption without a table below it.
    """
    tokens, captions = state.tokens, []
    for at, token in enumerate(tokens):
        if token.type == "inline" and token.content.startswith(_CAPTION):
            if at + 2 == len(tokens) or tokens[at + 2].type != "table_open":
                raise ValueError(
                    "Below a caption must be a table, its second line of the form |---|--:|, but there is none below "
                    f"{briefly(token.content)}"
                )
            tokens[at + 2].meta["caption"] = token.content.removeprefix(_CAPTION).strip()
            captions.append(slice(at - 1, at + 2))
    for paragraph in reversed(captions):
        del tokens[paragraph]


def _head_tables(state: StateCore) -> None:
    """Mark the headings of rows and columns, and tables of words alone."""
    table: Token | None = None
    for before, token, content, close in zip(*(state.tokens[at:] for at in range(4)), strict=False):
        if before.type == "table_open":
            table, before.meta["wordy"] = before, True
        if table is None or token.type not in ("th_open", "td_open"):
            continue
        if "right" in str(token.attrs.pop("style", "")):
            table.meta["wordy"] = False
        if token.type == "th_open":
            token.attrs["scope"] = "col"
            for part in content.children or []:  # a unit does not break into lines
                part.content = _UNIT.sub(lambda unit: unit[0].replace(" ", _NO_BREAK), part.content)
        elif before.type == "tr_open":
            token.tag = close.tag = "th"
            token.attrs["scope"] = "row"


class _Renderer(RendererHTML):
    """Formulas as MathML, and tables in boxes that scroll; words in tables without numbers break into lines."""

    def blockquote_open(self, *_: Any) -> str:
        return '<div class="note">'

    def table_open(self, tokens: Sequence[Token], at: int, *_: Any) -> str:
        meta = tokens[at].meta
        caption = f"<caption>{inline(meta['caption'])}</caption>" if "caption" in meta else ""
        return f'<div class="table{" wordy" * meta["wordy"]}" tabindex="0"><table>{caption}'

    def table_close(self, *_: Any) -> str:
        return "</table></div>"


_MARKDOWN = MarkdownIt("commonmark", {"html": False}, renderer_cls=_Renderer).enable("table")
_MARKDOWN.use(dollarmath_plugin, allow_labels=False, double_inline=True)
_MARKDOWN.core.ruler.push("caption_tables", _caption_tables)
_MARKDOWN.core.ruler.push("head_tables", _head_tables)
_MARKDOWN.add_render_rule("math_inline", lambda _, tokens, at, *__: math(tokens[at].content))
_MARKDOWN.add_render_rule("math_inline_double", lambda _, tokens, at, *__: math(tokens[at].content, display=True))
_MARKDOWN.add_render_rule("math_block", lambda _, tokens, at, *__: formula(tokens[at].content.strip()))
_MARKDOWN.add_render_rule("blockquote_close", lambda *_: "</div>")
