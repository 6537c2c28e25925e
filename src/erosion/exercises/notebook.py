"""The notebook of a course about a case: a static text, in which only the line of the case is replaced."""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from erosion.exercises.answer_key import AnswerKey
from erosion.extras import library

CASE = 'p = erosion.TABLE_1.to("si")'
"""The line of the text that a notebook replaces by its own case."""

_FENCE = re.compile(
    r"^```(?:python|markdown)(?: (?P<role>task|solution|check|interpretation) ?(?P<points>\d*))?\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_GAP = "*Your answer:*"


class Cell(NamedTuple):
    """A cell of the notebook.

    Args:
        kind: "markdown" or "code".
        source: its text.
        role: "task" (a gap, or in the teacher's copy its "solution"), "check", "interpretation" or "".
        points: of an interpretation.
    """

    kind: str
    source: str
    role: str = ""
    points: int = 0


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
    v4 = library("nbformat", "classroom").v4
    text = key.course.text.read_text("utf-8")
    text = text.replace(CASE, f"p = erosion.{key.p!r}  # {' '.join(title.split())}")
    cells = []
    for number, cell in enumerate(cells_of(text, solved=solved)):
        make: Any = v4.new_markdown_cell if cell.kind == "markdown" else v4.new_code_cell
        cells.append(make(cell.source, id=f"cell-{number:02}", metadata=_for_nbgrader(key, number, cell)))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return library("nbformat", "classroom").writes(v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})) + "\n"


def _for_nbgrader(key: AnswerKey, number: int, cell: Cell) -> dict[str, Any]:
    """The metadata by which nbgrader grades a check, and asks the teacher to grade an interpretation."""
    if cell.role not in ("check", "interpretation"):
        return {}
    by_hand = cell.role == "interpretation"
    task = "" if by_hand else cell.source.split('"')[1]
    graded = {
        "schema_version": 3,
        "grade_id": f"interpretation-{number:02}" if by_hand else task,
        "grade": True,
        "points": cell.points if by_hand else key.tasks[task].points,
        "solution": by_hand,
        "locked": not by_hand,
        "task": False,
        "cell_type": cell.kind,
    }
    return {"nbgrader": graded}


def cells_of(text: str, *, solved: bool) -> Iterator[Cell]:
    """Cells of Markdown with fences: ```python task is a gap, ```python solution fills it.

    What stands in ```markdown interpretation 2 is the teacher's answer to a question for 2 points.
    """
    left_out = "task" if solved else "solution"
    end = 0
    for fence in _FENCE.finditer(text):
        yield from _prose(text[end : fence.start()])
        end = fence.end()
        role, source = fence["role"] or "", fence["text"].strip("\n")
        if role == "interpretation":
            yield Cell("markdown", source if solved else _GAP, role, int(fence["points"]))
        elif role != left_out:
            yield Cell("code", source, role)
    yield from _prose(text[end:])


def _prose(text: str) -> Iterator[Cell]:
    """A cell for each section, so that a task and its code stand together."""
    for section in re.split(r"^(?=## )", text, flags=re.MULTILINE):
        if section.strip():
            yield Cell("markdown", section.strip())
