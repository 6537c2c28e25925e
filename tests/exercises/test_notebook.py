"""The notebooks of both courses: their solutions are right, and what students get gives no answer away."""

import ast
import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest

import erosion
from erosion.cli import exit_status
from erosion.exercises import COURSES, AnswerKey, Verdict
from erosion.exercises.notebook import cells_of, notebook
from erosion.exercises.numerics import spinning

P = erosion.TABLE_1
CASES = {
    "Table 1": P,
    "a stop": P.replace(alpha=np.deg2rad(70)),
    "large k, SI": P.replace(k=8.0, alpha=np.deg2rad(60)).to("si"),
}


def run(text: str) -> tuple[list[Any], dict[str, Any]]:
    """Run a notebook's code, and give what the last lines of its cells show, and its variables."""
    plt.switch_backend("agg")
    names: dict[str, Any] = {}
    values = []
    for cell in json.loads(text)["cells"]:
        if cell["cell_type"] != "code":
            continue
        tree = ast.parse("".join(cell["source"]))
        last = tree.body[-1]
        if isinstance(last, ast.Expr):
            tree.body.pop()
        with redirect_stdout(io.StringIO()):
            exec(compile(tree, "cell", "exec"), names)
            if isinstance(last, ast.Expr):
                values.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    plt.close("all")
    return values, names


def verdicts(values: list[Any]) -> list[Verdict]:
    return [value for value in values if isinstance(value, Verdict)]


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
@pytest.mark.parametrize("course", COURSES)
def test_all_solutions_are_right(course: str, p: erosion.Parameters) -> None:
    key = AnswerKey(p, course)
    values, names = run(notebook(key, title="a case", solved=True))
    said = verdicts(values)
    assert [str(verdict) for verdict in said if not verdict.right] == []
    assert len(said) == len(key.tasks)
    assert names["key"].score().reached == names["key"].score().possible == sum(verdict.points for verdict in said)
    if course == "numerics":
        assert [value.kind for value in values if isinstance(value, erosion.Optimum)] == ["jump"]
        assert repr(names["spinning"]) == repr(spinning(key.p))


@pytest.mark.parametrize("course", COURSES)
def test_an_unfilled_notebook_runs_and_gives_no_answer_away(course: str) -> None:
    key = AnswerKey(P, course)
    text = notebook(key, title="a case")
    values, _ = run(text)
    said = {str(verdict) for verdict in verdicts(values)}
    assert said == {f"{task}: still to do." for task in key.tasks}
    assert not any(isinstance(value, erosion.Optimum) for value in values)
    for answer in (cell.source for cell in cells_of(key.course.text.read_text(), solved=True) if cell.role != ""):
        assert answer.startswith("key.check(") or json.dumps(answer)[1:-1] not in text


@pytest.mark.parametrize("course", COURSES)
def test_the_notebook_is_one_and_names_its_case_once(course: str) -> None:
    key = AnswerKey(P.replace(alpha=0.5), course)
    text = notebook(key, title="sand\non steel")
    nbformat.validate(nbformat.reads(text, as_version=4))
    cells = json.loads(text)["cells"]
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert text.count(repr(key.p)) == 1
    assert "alpha=0.5, phidot0=0, inertia=0.5, shown_in='si')  # sand on steel\\n" in text
    assert text == notebook(key, title="sand on steel")
    checked = re.findall(r'"key.check\(\\"(\w+)', text)
    assert checked == list(key.tasks)


@pytest.mark.parametrize("course", COURSES)
def test_the_points_of_a_section_are_those_of_its_cells(course: str) -> None:
    tasks = COURSES[course].tasks
    points, cells = [], list(cells_of(COURSES[course].text.read_text(), solved=False))
    for cell in cells:
        if cell.source.startswith("## "):
            stated = re.search(r"\((\d+) points?\b", cell.source.splitlines()[0])
            points.append([int(stated[1]) if stated else 0, 0])
        elif cell.role == "check":
            points[-1][1] += tasks[cell.source.split('"')[1]].points
        elif cell.role == "interpretation":
            points[-1][1] += cell.points
    assert [stated for stated, _ in points] == [sum_ for _, sum_ in points]
    assert not any("```" in cell.source for cell in cells)


@pytest.mark.parametrize("course", COURSES)
def test_nbgrader_grades_the_checks_and_a_teacher_the_interpretations(course: str) -> None:
    key = AnswerKey(P, course)
    graded = [(cell, cell["metadata"]["nbgrader"]) for cell in json.loads(notebook(key, title="a case"))["cells"]
              if cell["metadata"]]  # fmt: skip
    assert len({data["grade_id"] for _, data in graded}) == len(graded)
    checks = {data["grade_id"]: data["points"] for _, data in graded if data["locked"]}
    assert checks == {name: task.points for name, task in key.tasks.items()}
    for cell, data in graded:
        by_hand = cell["cell_type"] == "markdown"
        assert {**data, "grade_id": "", "points": 0} == {
            "schema_version": 3, "grade_id": "", "grade": True, "points": 0, "solution": by_hand,
            "locked": not by_hand, "task": False, "cell_type": cell["cell_type"],
        }  # fmt: skip


def test_gaps_and_solutions_are_told_apart() -> None:
    text = (
        "Do it.\n\n```python task\nx = ...\n```\n\n```python solution\nx = 1\n```\n\n```python\nx\n```\n## Next\nEnd.\n"
        "```markdown interpretation 2\nBecause.\n```\n"
    )
    gaps = [("markdown", "Do it.", "", 0), ("code", "x = ...", "task", 0), ("code", "x", "", 0),
            ("markdown", "## Next\nEnd.", "", 0), ("markdown", "*Your answer:*", "interpretation", 2)]  # fmt: skip
    solved = [gaps[0], ("code", "x = 1", "solution", 0), *gaps[2:4], ("markdown", "Because.", "interpretation", 2)]
    assert list(cells_of(text, solved=False)) == gaps
    assert list(cells_of(text, solved=True)) == solved


@pytest.mark.parametrize(("course", "tasks"), [("scenario", 26), ("numerics", 13)])
def test_the_command_writes_both_notebooks(
    course: str, tasks: int, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    handed_out, solved = tmp_path / "tasks.ipynb", tmp_path / "solved.ipynb"
    words = ["--alpha", "40deg", "-o", str(handed_out), "--solved", str(solved)]
    assert exit_status(["exercise", "--course", course, *words]) == 0
    printed = capsys.readouterr().out
    assert printed == f"{handed_out}: {tasks} tasks about Table 1, α = 40deg\n{solved}: the same with solutions\n"
    key = AnswerKey(P.replace(alpha=np.deg2rad(40)), course)
    title = "Table 1, α = 40deg"
    assert handed_out.read_text() == notebook(key, title=title)
    assert solved.read_text() == notebook(key, title=title, solved=True)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["-o", "x.txt"], "Option `--output` must end in .ipynb, but is x.txt."),
        (["--solved", "x.txt"], "Option `--solved` must end in .ipynb, but is x.txt."),
        (["-o", "a.ipynb", "--solved", "a.ipynb"], "a.ipynb: is named twice, but every file must be another."),
        (["--alpha", "90deg"], "Option `--alpha` must be an angle at which something is cut, but is 90°."),
    ],
)
def test_what_cannot_be_done_is_one_line(
    arguments: list[str], sentence: str, tmp_path: Path, monkeypatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_status(["exercise", *arguments]) == 2
    assert capsys.readouterr().err.replace(f"{tmp_path}/", "") == f"erosion: {sentence}\n"
    assert list(tmp_path.iterdir()) == []
