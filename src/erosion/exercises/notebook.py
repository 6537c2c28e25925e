"""From the text of the tasks, a Markdown file that a teacher may edit, to a notebook."""

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jinja2

from erosion.exercises.answer_key import EULER_STEPS, RK4_STEPS, AnswerKey
from erosion.extras import library

TEXT = Path(__file__).with_name("tasks.md")
_CODE = re.compile(r"^```python(?P<kind>| task| solution)\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL)


class Cell(NamedTuple):
    """A cell of the notebook: "markdown" or "code", and its text."""

    kind: str
    source: str


def notebook(key: AnswerKey, *, title: str, solved: bool = False) -> str:
    """The tasks about a case as a Jupyter notebook.

    Args:
        key: of the case.
        title: what to call the case.
        solved: with the solutions in place of the gaps that students fill.

    Returns:
        The notebook's JSON, the same for the same case.

    Raises:
        MissingExtraError: where nbformat is not installed.
    """
    nbformat = library("nbformat", "classroom")
    v4 = nbformat.v4
    cells = []
    for number, (kind, source) in enumerate(cells_of(_filled(key, title), solved=solved)):
        make: Any = v4.new_markdown_cell if kind == "markdown" else v4.new_code_cell
        cells.append(make(source, id=f"cell-{number:02}"))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return nbformat.writes(v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})) + "\n"


def cells_of(text: str, *, solved: bool) -> Iterator[Cell]:
    """Cells of Markdown with code: ```python task is a gap to fill, and ```python solution what fills it."""
    left_out = " task" if solved else " solution"
    end = 0
    for code in _CODE.finditer(text):
        yield from _prose(text[end : code.start()])
        end = code.end()
        if code["kind"] != left_out:
            yield Cell("code", code["code"].strip("\n"))
    yield from _prose(text[end:])


def _prose(text: str) -> Iterator[Cell]:
    """A cell for each section, so that a task and its code stand together."""
    for section in re.split(r"^(?=## )", text, flags=re.MULTILINE):
        if section.strip():
            yield Cell("markdown", section.strip())


def _plain(text: str) -> str:
    """Text, of a file's name, that Markdown and its HTML show as it is."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", text).replace("\\<", "&lt;").replace("\\&", "&amp;")


def _filled(key: AnswerKey, title: str) -> str:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    best = key.with_spin
    return environment.from_string(key.language.template(TEXT.read_text("utf-8"))).render(
        title=_plain(key.language.text(title)),
        _=key.language.text,
        lang=key.language.tag,
        p=repr(key.p),
        alpha=f"{math.degrees(float(key.p.alpha)):g}",
        euler_steps=EULER_STEPS,
        rk4_steps=RK4_STEPS,
        first_guess=f"{math.degrees(key.first_guess):g}",
        number=key.language.number_tex,
        spin=None if best is None else float(best.p.phidot0),
        spin_ratio=None if best is None else f"{float(best.p.spin):g}",
    )
