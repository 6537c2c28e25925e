"""The report's page and its files: texts with computed values, index.html, figures, numbers.json."""

import base64
import contextlib
import functools
import math
import re
import traceback
import types
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import jinja2.ext
from markupsafe import Markup
from matplotlib.figure import Figure

from erosion.arguments import Progress, no_progress
from erosion.impacts import TurnWarning
from erosion.interrupts import unawaited_threads
from erosion.ode.step_control import require_xla
from erosion.output import Record, briefly, to_csv, to_json, write_whole
from erosion.pages.frame import inline_svg, render_page
from erosion.parameters import (
    QUANTITIES,
    Parameters,
    PerMass,
    Scale,
    System,
    readable_scale,
    require_scalars,
    table_scale,
    unit_name,
    unit_size,
    validate,
)
from erosion.plotting.style import fit_legends, save_plot
from erosion.report.case import Answer, ReportCase, question, turned_angles
from erosion.report.questions import QUESTIONS, text_file
from erosion.report.text import blocks, degrees, inline, number, quantity, to_html
from erosion.version import __version__

_FOLDER = Path(__file__).parent
_IMAGE = re.compile(r"!\[(?P<description>.*?)\]\((?P<name>[^)]*)\)\s*(?P<caption>.*)", re.DOTALL)
_IDEA = "Idea:"
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
        idea: why, in a sentence (HTML).
        sentence: the answer in one sentence (HTML).
        illustrations: what shows it.
        derivation: why it is so (HTML).
        validity: the cuts in which the models do not hold (HTML), or nothing.
        printed: every number of the text, as it was before it was formatted.
    """

    title: str
    idea: Markup
    sentence: Markup
    illustrations: tuple[Illustration, ...]
    derivation: Markup
    validity: Markup
    printed: tuple[float, ...]


def write_text(path: Path, case: ReportCase, answer: Answer) -> Text:
    """Fill in a question's text and divide it into its parts.

    Args:
        path: of the Markdown file.
        case: a field of the text, `case`.
        answer: its numbers and fields are fields of the text by their own names, the numbers also as `numbers`.

    Raises:
        TextError: for a field that does not exist, or a wrong form; it names the file, the line and the reason.
    """
    fields = {"case": case, "numbers": answer.numbers, **answer.numbers, **answer.fields}
    printed: list[float] = []
    try:
        filled = _fill(path, fields, case.units, printed)
        return Text(*_parts(filled, answer.figures), inline(validity(answer)), tuple(printed))
    except Exception as error:  # a field may call any function
        raise TextError(f"{_place(path, error)}: {str(error).rstrip('.')}.") from error


def _place(path: Path, error: Exception) -> str:
    """The text's file and, if the error gives one, its line."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.endswith(".md")]
    return f"{frames[-1].filename}, line {frames[-1].lineno}" if frames else str(path)


def _fill(path: Path, fields: Mapping[str, Any], system: System, printed: list[float]) -> str:
    def plain(value: Any) -> Any:
        if isinstance(value, str) and not isinstance(value, Markup):
            return value
        if isinstance(value, (int, float)):
            printed.append(value)
        return value

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([path.parent, _FOLDER]),
        finalize=plain,
        extensions=[_KeepNewlines],
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= _filters(system, printed)
    scales = {"parameters": QUANTITIES, "degree": _DEGREE, "percent": _PERCENT}
    return environment.get_template(path.name, globals=scales).render(fields)


class _KeepNewlines(jinja2.ext.Extension):
    """Lines of tags alone leave no empty line; a tag at the end of a line of text does not join it to the next."""

    def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
        return _TAG_AFTER_TEXT.sub(r"\1+%}", source)


_DEGREE, _PERCENT = Scale(math.pi / 180, "°"), Scale(0.01, "%")


def _filters(system: System, printed: list[float]) -> dict[str, Callable[..., Any]]:
    def of_number(function: Callable[..., str]) -> Callable[..., str]:
        def shown(value: Any, *args: Any, **options: Any) -> str:
            printed.append(float(value))  # an error for a field that does not exist
            return function(float(value), *args, **options)

        return shown

    of_units = functools.partial(quantity, system=system)
    plain: dict[str, Callable[..., str]] = {
        "number": number,
        "degrees": degrees,
        "quantity": of_units,
        "per": lambda value, scale, digits, **options: number(value / scale.size, digits, **options),
        "fixed": lambda value, scale, places: f"{value / scale.size:.{places}f}",
    }
    in_tex = {name: functools.partial(plain[name], tex=True) for name in ("number", "degrees", "quantity", "per")}
    return {
        **{name: of_number(function) for name, function in plain.items()},
        **{f"{name}_tex": of_number(function) for name, function in in_tex.items()},
        "to_degrees": lambda value: math.degrees(float(value)),
        "scale": lambda largest, dimension: readable_scale(dimension, system, float(largest)),
        "base_scale": lambda dimension: Scale(unit_size(dimension, system), unit_name(dimension, system)),
    }  # fmt: skip


def turned_curves(answer: Answer) -> dict[str, str]:
    """The angles at which the body turns by more than 90°, in words, of each curve where it does."""
    return {curve.label: angles for curve in answer.curves if (angles := turned_angles(curve))}


def validity(answer: Answer) -> str:
    """The limit of validity in one sentence of Markdown; or nothing."""
    where = turned_curves(answer)
    clauses = [
        f"{', '.join(label for label in where if where[label] == angles)} {angles}"
        for angles in dict.fromkeys(where.values())
    ]
    if not clauses:
        return ""
    return (
        f"**Limit of validity.** The model does not hold where the body turns by more than 90°: {'; '.join(clauses)}."
    )


def _parts(text: str, figures: Mapping[str, Figure]) -> tuple[str, Markup, Markup, tuple[Illustration, ...], Markup]:
    answer, *derivation = _DERIVATION.split(text)
    title, *paragraphs = blocks(answer)
    images = [_IMAGE.fullmatch(block) for block in paragraphs]
    idea, *sentences = [block for block, image in zip(paragraphs, images, strict=True) if image is None] or [""]
    if not (title.startswith("# ") and idea.startswith(_IDEA) and len(sentences) == len(derivation) == 1):
        raise ValueError(
            f'A text must be "# title", "{_IDEA} …", one paragraph, the figures, "## Derivation" and the derivation.'
        )
    illustrations = []
    for image in (image for image in images if image is not None):
        name = image["name"]
        if name not in figures:
            raise ValueError(f"The figure {name!r} is unknown; there are {', '.join(figures) or 'none'}.")
        caption = inline(image["caption"])
        illustrations.append(Illustration(name, caption, " ".join(image["description"].split())))
    idea = idea.removeprefix(_IDEA).strip()
    return title.removeprefix("# "), inline(idea), inline(sentences[0]), tuple(illustrations), to_html(derivation[0])


_SYSTEMS: Mapping[System, str] = types.MappingProxyType(
    {"inch-pound": "inch, pound-force, second; mass in slinch, the source's “dozens of slugs”, 1 slinch = 175.13 kg",
     "si": "SI"}
)  # fmt: skip

_THREADS = 2  # that compute ahead; more would wait for the interpreter


def write_report(
    p: Parameters,
    out: Path,
    *,
    case_name: str = "Table 1",
    only: Sequence[str] | None = None,
    brief: bool = False,
    per_mass: PerMass | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Answer the scenario's questions for a case as one self-contained page.

    Writes `out`/index.html, every figure as `out`/figures/*.svg, and every number
    as `out`/numbers.json and numbers.csv. The same parameters give the same bytes. A file is there
    completely or not at all, and the page is written last.

    Args:
        p: parameters, all scalars, in either unit system.
        out: a folder; it is made if need be.
        case_name: what to call the case on the page.
        only: keys of the questions to answer, by default all; the page keeps its own order.
        brief: a handout: answers and figures without derivations, so that a question fits on a sheet of A4.
        per_mass: the density of the target, for g/kg, and the share of the particles that cut.
        progress: called before each part with its title, how many parts are done, and how many there are.

    Returns:
        The path of the page.

    Raises:
        ValueError: for parameters out of range or not scalar, or an unknown key in `only`.
        OSError: one sentence, where a file cannot be written.
    """
    keys = chosen_questions(only)
    validate(p)
    require_scalars(p)
    require_xla()
    out = Path(out)
    with _naming(out), _folders(out):
        return _write(ReportCase(p, case_name, per_mass), keys, out, progress, brief=brief)


PARTS = ("index.html", "numbers.json", "numbers.csv", "figures")
"""What a report writes into its folder."""


def require_folder(out: Path) -> None:
    """Find out, before a long computation, whether a report can be written.

    Raises:
        ValueError: for the name of a page: a report is a folder.
        OSError: one sentence, where it cannot be written.
    """
    if out.suffix.lower() in (".html", ".pdf"):
        raise ValueError(f"Argument `output` must be a folder, but is {out}; print its index.html as PDF in a browser.")
    with _naming(out), _folders(out):
        pass


@contextlib.contextmanager
def _folders(out: Path) -> Iterator[None]:
    """Make the folders of a report; of those made, the ones that hold nothing at the end go again."""
    figures = out / "figures"
    missing = [folder for folder in (figures, out, *out.parents) if not folder.exists()]
    figures.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # it holds what is whole
            for folder in missing:
                folder.rmdir()


@contextlib.contextmanager
def _naming(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise type(error)(f"{out}: the report cannot be written there ({reason}).") from error


def _write(case: ReportCase, keys: Sequence[str], out: Path, progress: Progress, *, brief: bool) -> Path:
    numbers: Record = {}
    turned: dict[str, Record] = {}
    texts: dict[str, Text] = {}
    drawings: dict[str, Markup] = {}
    wide: set[str] = set()
    alone = False
    # Filters are the process's, not the thread's: set once, around all threads.
    with warnings.catch_warnings(), unawaited_threads(_THREADS) as pool:
        warnings.simplefilter("ignore", TurnWarning)  # the page says it in words
        case.prepare(pool, (need for key in keys for need in QUESTIONS[key].needs))
        for done, key in enumerate(keys):
            progress(question(key), done, len(keys))
            answer = QUESTIONS[key].answer(case)
            numbers[key] = answer.numbers
            turned[key] = {label.strip("`"): angles for label, angles in turned_curves(answer).items()}
            texts[key] = write_text(text_file(key), case, answer)
            shown = [answer.figures[name] for name, *_ in texts[key].illustrations]
            alone = brief and len(keys) == 1 and sum(figure.get_figheight() for figure in shown) <= _SHEET
            for name, _, description in texts[key].illustrations:
                figure = answer.figures[name]
                fit_on_sheet(figure, alone=len(shown) * alone) if brief else fit_legends(figure)
                if figure.get_figwidth() > _BROAD:
                    wide.add(name)
                svg = save_plot(figure, out / "figures" / f"{name}.svg")
                drawings[name] = inline_svg(name, svg.read_text(encoding="utf-8"), description)
    progress("The page", len(keys), len(keys))
    record = {
        "erosion": __version__,
        "case": case.name,
        "units": "si",
        "parameters": {name: float(getattr(case.p, name)) for name in QUANTITIES},
        "answers": numbers,
        "turned_beyond": turned,
    }
    write_whole(out / "numbers.json", (to_json(record) + "\n").encode())
    names, values = zip(*_lines("", record), strict=True)
    write_whole(out / "numbers.csv", to_csv({"name": names, "value": values}).encode())
    page = render_page(
        "handout.html" if brief else "page.html",
        package="erosion.report",
        case_name=case.name,
        system=_SYSTEMS[case.units],
        parameters=_parameter_rows(case.p),
        texts=texts,
        question=question,
        drawings=drawings,
        wide=wide,
        alone=alone,
        formula_font=base64.b64encode(Path(__file__).with_name("formulas.woff").read_bytes()).decode(),
    )
    write_whole(out / "index.html", page.encode())
    return out / "index.html"


def chosen_questions(only: Sequence[str] | None) -> list[str]:
    """Keys of the questions in the page's order; all questions without `only`. A `ValueError` for an unknown key."""
    if only is None:
        return list(QUESTIONS)
    unknown = [key for key in only if key not in QUESTIONS]
    if unknown or not only or isinstance(only, str):
        problem = f"has {briefly(unknown[0])}" if unknown and not isinstance(only, str) else f"is {briefly(only)}"
        raise ValueError(f"Argument `only` must be a list of {', '.join(map(repr, QUESTIONS))}, but {problem}.")
    return [key for key in QUESTIONS if key in only]


def _parameter_rows(p: Parameters) -> list[tuple[str, str, str, str]]:
    """Symbol, meaning, value, unit; in units in which the values read well."""
    rows = []
    for name, entry in QUANTITIES.items():
        value = float(getattr(p, name))
        scale = table_scale(entry.dimension, p.shown_in, abs(value))
        if scale.unit.startswith("10"):
            scale = Scale(entry.size(p.shown_in), unit_name(entry.dimension, p.shown_in))
        shown = number(value / scale.size, 7, strip=True)
        rows.append((entry.symbol, entry.meaning, shown, scale.unit or "–"))
    return rows


def _lines(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Each number with the path to it: "answers.q5.alpha_max.0", 0.5535…."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _lines(f"{path}.{name}".lstrip("."), item)
    elif isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            yield from _lines(f"{path}.{i}", item)
    else:
        yield path, "" if value is None else value


# inches; a handout prints a figure in a column of 3.4 inches, and a wide one across both. Text of 9.5 pt is 7 pt there.
_IN_A_COLUMN, _WIDE, _FLAT = 4.5, 6.5, 3.6
_BROAD = 6.0  # printed in half the width of a page, a broader figure has letters of less than 5 pt
_SHEET = 8.0  # of figures that have room below each other
_ALONE = 7.2, 6.8  # of the only figure on a sheet, or of two below each other, which are printed in this size


def fit_on_sheet(figure: Figure, *, alone: int = 0) -> None:
    """Give a figure the size at which its text is readable on a handout; its legends get fewer columns if need be.

    Args:
        figure: to be printed.
        alone: the figures on the sheet, where they are below each other; 0 for a figure in a column.
    """
    if alone:
        figure.set_size_inches(_ALONE[0], _ALONE[1] / alone)
    elif figure.get_figwidth() > _WIDE:
        figure.set_figheight(_FLAT)
    else:
        figure.set_size_inches(_IN_A_COLUMN, 0.88 * figure.get_figheight())
    fit_legends(figure)
