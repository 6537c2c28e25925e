"""The page and its files: answers -> index.html, figures, numbers.json."""

import math
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import jinja2

from erosion.files import write_whole
from erosion.parameters import QUANTITIES, Parameters, require_scalars, validate
from erosion.plotting import save_figure
from erosion.report.case import Answer, Case, question
from erosion.report.inline import THEMES, inline_svg
from erosion.report.questions import QUESTIONS
from erosion.report.text import number
from erosion.tables import to_json
from erosion.units import System, unit_name
from erosion.version import __version__

_SYSTEMS: Mapping[System, str] = types.MappingProxyType(
    {"inch-pound": "inch, pound-force, second; mass in slinch, the source's “dozens of slugs”, 1 slinch = 175.13 kg",
     "si": "SI"}
)  # fmt: skip


def write_report(
    p: Parameters,
    out: Path,
    *,
    case_name: str = "Table 1",
    only: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Answer the scenario's questions for a case as one self-contained page.

    Writes `out`/index.html, every figure as `out`/figures/*.svg and *.png, and every number
    as `out`/numbers.json. The same parameters give the same bytes. A file is there
    completely or not at all, and the page is written last.

    Args:
        p: parameters, all scalars, in either unit system.
        out: a folder; it is made if need be.
        case_name: what to call the case on the page.
        only: keys of the questions to answer, by default all; the page keeps its own order.
        progress: called with a line of text before each part.

    Returns:
        The path of the page.

    Raises:
        ValueError: for parameters out of range or not scalar, or an unknown key in `only`.
        OSError: one sentence, where a file cannot be written.
    """
    keys = _chosen(only)
    validate(p)
    require_scalars(p)
    out = Path(out)
    try:
        (out / "figures").mkdir(parents=True, exist_ok=True)
        return _write(Case(p, case_name), keys, out, progress or (lambda line: None))
    except OSError as error:
        reason = error.strerror or str(error)
        raise type(error)(f"{out}: the report cannot be written there ({reason}).") from error


def _write(case: Case, keys: Sequence[str], out: Path, progress: Callable[[str], None]) -> Path:
    answers = []
    for key in keys:
        progress(question(key))
        answers.append(QUESTIONS[key](case))
    progress("Figures and page")
    for answer in answers:
        for illustration in answer.figures:
            save_figure(illustration.figure, out / "figures" / illustration.name)
    write_whole(out / "numbers.json", _numbers(case, answers).encode())
    page = out / "index.html"
    write_whole(page, _page(case, answers).encode())
    return page


def _chosen(only: Sequence[str] | None) -> list[str]:
    if only is None:
        return list(QUESTIONS)
    unknown = [key for key in only if key not in QUESTIONS]
    if unknown or not only or isinstance(only, str):
        asked = f"has {unknown[0]!r}" if unknown and not isinstance(only, str) else f"is {only!r}"
        raise ValueError(f"Argument `only` must be a list of {', '.join(map(repr, QUESTIONS))}, but {asked}.")
    return [key for key in QUESTIONS if key in only]


def _page(case: Case, answers: Sequence[Answer]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("erosion.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("page.html").render(
        case_name=case.name,
        system=_SYSTEMS[case.units],
        parameters=_parameter_rows(case.p),
        answers=answers,
        question=question,
        themes=THEMES,
        inline_svg=inline_svg,
        version=__version__,
    )


def _parameter_rows(p: Parameters) -> list[tuple[str, str, str, str]]:
    """Symbol, meaning, value, unit; angles in degrees."""
    rows = []
    for name, quantity in QUANTITIES.items():
        value, unit = float(getattr(p, name)), unit_name(quantity.dimension, p.units)
        if quantity.dimension == "angle":
            value, unit = math.degrees(value), "°"
        rows.append((quantity.symbol, quantity.meaning, number(value, 7, strip=True), unit or "–"))
    return rows


def _numbers(case: Case, answers: Sequence[Answer]) -> str:
    record = {
        "erosion": __version__,
        "case": case.name,
        "units": case.units,
        "parameters": {name: float(getattr(case.p, name)) for name in QUANTITIES},
        "answers": {answer.key: answer.numbers for answer in answers},
    }
    return to_json(record) + "\n"
