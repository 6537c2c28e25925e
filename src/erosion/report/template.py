"""The text of a question: a Markdown file whose fields are filled with computed values."""

import functools
import math
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import jinja2.ext
from markupsafe import Markup

from erosion.language import ENGLISH, Language
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.scales import Scale, readable_scale
from erosion.parameters.units import Dimension, System, unit_name
from erosion.report.case import Answer, Case
from erosion.report.markdown import blocks, inline, to_html
from erosion.report.text import degrees, degrees_tex, number, number_tex, quantity, quantity_tex

_FOLDER = Path(__file__).parent
_IMAGE = re.compile(r"!\[(?P<description>.*?)\]\((?P<name>[^)]*)\)\s*(?P<caption>.*)", re.DOTALL)
_DERIVATION = re.compile(r"^## .*$", re.MULTILINE)
_TAG_AFTER_TEXT = re.compile(r"(?m)^(?!\s*\{%(?:(?!%\}).)*%\}$)(.*)%\}$")


class TextError(RuntimeError):
    """A question's text has a mistake."""


class Illustration(NamedTuple):
    """A figure as the page shows it.

    Args:
        name: of its files, without suffix.
        caption: HTML below it.
        description: plain text for those who cannot see it.
    """

    name: str
    caption: Markup
    description: str


class Text(NamedTuple):
    """The text of one question.

    Args:
        title: the question in a few words.
        sentence: the answer in one sentence (HTML).
        illustrations: what shows it.
        derivation: why it is so (HTML).
    """

    title: str
    sentence: Markup
    illustrations: tuple[Illustration, ...]
    derivation: Markup


def write_text(path: Path, case: Case, answer: Answer, language: Language = ENGLISH) -> Text:
    """Fill in a question's text and divide it into its parts.

    Args:
        path: of the Markdown file.
        case: a field of the text, `case`.
        answer: its numbers and fields are fields of the text by their own names, the numbers also as `numbers`.
        language: of the page.

    Raises:
        TextError: for a field that does not exist, or a wrong form; it names the file, the line and the reason.
    """
    fields = {"case": case, "numbers": answer.numbers, **answer.numbers, **answer.fields}
    try:
        return _parts(_fill(path, fields, case.units, language), answer.figures)
    except Exception as error:  # a field may call any function
        raise TextError(f"{_place(path, error)}: {str(error).rstrip('.')}.") from error


def _place(path: Path, error: Exception) -> str:
    """The text's file and, if the error gives one, its line."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.endswith(".md")]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else str(path)


def _fill(path: Path, fields: Mapping[str, Any], units: System, language: Language) -> str:
    environment = jinja2.Environment(
        loader=_Translating([path.parent, _FOLDER], language),
        finalize=lambda value: (
            language.text(value) if isinstance(value, str) and not isinstance(value, Markup) else value
        ),
        extensions=[_KeepNewlines],
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= _filters(units, language)
    environment.globals["parameters"] = QUANTITIES
    return environment.get_template(path.name).render(fields)


class _Translating(jinja2.FileSystemLoader):
    """Loads texts in a language."""

    def __init__(self, folders: Sequence[Path], language: Language) -> None:
        super().__init__(list(map(str, folders)))
        self._language = language

    def get_source(self, environment: jinja2.Environment, template: str) -> tuple[str, str, Callable[[], bool]]:
        source, path, is_current = super().get_source(environment, template)
        return self._language.template(source), path, is_current


class _KeepNewlines(jinja2.ext.Extension):
    """Lines of tags alone leave no empty line; a tag at the end of a line of text does not join it to the next."""

    def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
        return _TAG_AFTER_TEXT.sub(r"\1+%}", source)


def _filters(units: System, language: Language) -> dict[str, Callable[..., Any]]:
    def scale(largest: float, dimension: Dimension) -> Scale:
        return readable_scale(dimension, units, largest)

    def fixed(value: float, places: int) -> str:
        return f"{value:.{places}f}"

    of_number: dict[str, Callable[..., Any]] = {"to_degrees": math.degrees, "scale": scale}
    plain = (number, degrees, fixed, functools.partial(quantity, units=units))
    for name, function in zip(("number", "degrees", "fixed", "quantity"), plain, strict=True):
        of_number[name] = _then(language.number, function)
    tex = (number_tex, degrees_tex, functools.partial(quantity_tex, units=units))
    for name, function in zip(("number_tex", "degrees_tex", "quantity_tex"), tex, strict=True):
        of_number[name] = _then(language.number_tex, function)
    filters = {name: _from_float(function) for name, function in of_number.items()}
    return {**filters, "unit": lambda dimension: unit_name(dimension, units)}


def _then(last: Callable[[str], str], first: Callable[..., str]) -> Callable[..., str]:
    return lambda *args, **options: last(first(*args, **options))


def _from_float(function: Callable[..., Any]) -> Callable[..., Any]:
    """Read any number first; `float` raises an error for a field that does not exist."""
    return lambda value, *args, **options: function(float(value), *args, **options)


def _parts(text: str, figures: Mapping[str, Any]) -> Text:
    answer, *derivation = _DERIVATION.split(text)
    title, *paragraphs = blocks(answer)
    images = [_IMAGE.fullmatch(block) for block in paragraphs]
    sentences = [block for block, image in zip(paragraphs, images, strict=True) if image is None]
    if not title.startswith("# ") or len(sentences) != 1 or len(derivation) != 1:
        raise ValueError('A text must be "# title", one paragraph, the figures, "## Derivation" and the derivation.')
    illustrations = [
        Illustration(image["name"], inline(image["caption"]), " ".join(image["description"].split()))
        for image in images
        if image is not None
    ]
    for illustration in illustrations:
        if illustration.name not in figures:
            raise ValueError(f"The figure {illustration.name!r} is unknown; there are {', '.join(figures) or 'none'}.")
    return Text(title.removeprefix("# "), inline(sentences[0]), tuple(illustrations), to_html(derivation[0]))
