"""The notebook of tasks, and that its solutions are right."""

import ast
import io
import json
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pytest

import erosion
from erosion.cli import _status
from erosion.exercises import AnswerKey, Verdict
from erosion.exercises.answer_key import at_contact, cells_of, linearized_rate, notebook, rk4

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
CASES = {
    "Table 1": P,
    "a stop": P.replace(alpha=np.deg2rad(70)),
    "large k, SI": P.replace(k=8.0, alpha=np.deg2rad(60)).to("si"),
}


def shown(text: str) -> list[Any]:
    """Run a notebook's code, and give what the last lines of its cells show."""
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
    return values


def verdicts(values: list[Any]) -> list[Verdict]:
    return [value for value in values if isinstance(value, Verdict)]


@pytest.mark.parametrize(
    ("units", "lang", "says"),
    [
        ("si", "en", "and your answers, are in kg, m, m/s, Pa, and angles in radians"),
        ("inch-pound", "de", "haben die Einheiten slinch, in, in/s, lbf/in², Winkel stehen im Bogenmaß"),
    ],
)
def test_the_numbers_of_a_case_have_their_units_named(units: Any, lang: str, says: str) -> None:
    text = notebook(AnswerKey(P.to(units), lang=lang), title="a case")
    assert says in " ".join(json.loads(text)["cells"][0]["source"]).replace("\n", " ").replace("  ", " ")


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
def test_all_solutions_are_right(p: erosion.Parameters) -> None:
    key = erosion.AnswerKey(p)
    values = shown(notebook(key, title="a case", solved=True))
    said = verdicts(values)
    assert [str(verdict) for verdict in said if not verdict.right] == []
    assert len(said) == len(key.tasks)
    assert key.with_spin is None or "jump" in str(values[-1])


@pytest.mark.parametrize(("lang", "still_to_do"), [("en", "still to do."), ("de", "noch zu lösen.")])
def test_an_unfilled_notebook_runs_and_gives_no_answer_away(lang: str, still_to_do: str) -> None:
    key = erosion.AnswerKey(P, lang)
    values = shown(notebook(key, title="a case"))
    tasks = [*key.tasks, "alpha_max_at_jump"]  # the last cell shows the tool's answer when the student's is right
    said = [str(verdict) for verdict in verdicts(values)]
    assert sorted(said) == sorted(f"{task}: {still_to_do}" for task in tasks)
    assert not any(isinstance(value, erosion.Optimum) for value in values)


def test_the_notebook_is_one_and_has_no_solutions() -> None:
    text = notebook(erosion.AnswerKey(P), title="Table 1")
    nbformat.validate(nbformat.reads(text, as_version=4))
    cells = json.loads(text)["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert "# How a grain cuts: Table 1" in "".join(cells[0]["source"])
    assert len({cell["id"] for cell in cells}) == len(cells)
    checks = [source for source in code if "key.check(" in source]
    assert len(checks) == len(erosion.AnswerKey(P).tasks) + 1
    assert all("..." in source for source in checks[:-1])
    for source in code:
        ast.parse(source)
    assert text == notebook(erosion.AnswerKey(P), title="Table 1")


def test_gaps_and_solutions_are_told_apart() -> None:
    text = (
        "Do it.\n\n```python task\nx = ...\n```\n\n```python solution\nx = 1\n```\n\n```python\nx\n```\n## Next\nEnd.\n"
    )
    gaps = [("markdown", "Do it."), ("code", "x = ..."), ("code", "x"), ("markdown", "## Next\nEnd.")]
    assert list(cells_of(text, solved=False)) == gaps
    assert list(cells_of(text, solved=True)) == [gaps[0], ("code", "x = 1"), *gaps[2:]]


def test_the_command_writes_both_notebooks(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    tasks, solved = tmp_path / "tasks.ipynb", tmp_path / "solved.ipynb"
    assert _status(["exercise", "--alpha", "40deg", "-o", str(tasks), "--solved", str(solved)]) == 0
    printed = capsys.readouterr().out
    assert printed == f"{tasks}: 14 tasks about Table 1, α = 40deg\n{solved}: the same with solutions\n"
    key = erosion.AnswerKey(P.replace(alpha=np.deg2rad(40)))
    title = "Table 1, α = 40deg"
    assert tasks.read_text() == notebook(key, title=title)
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
    assert _status(["exercise", *arguments]) == 2
    assert capsys.readouterr().err.replace(f"{tmp_path}/", "") == f"erosion: {sentence}\n"
    assert list(tmp_path.iterdir()) == []


def test_the_name_of_a_file_is_shown_as_it_is() -> None:
    name = "<img src=x onerror=alert(1)> & $x$ `y` *z* [a](javascript:b)"
    text = nbformat.reads(notebook(AnswerKey(erosion.TABLE_1), title=name), 4).cells[0].source.splitlines()[0]
    assert text == (
        r"# How a grain cuts: &lt;img src\=x onerror\=alert\(1\)\> &amp; \$x\$ \`y\` \*z\* \[a\]\(javascript\:b\)"
    )


def test_the_teachers_copy_alone_answers_the_open_questions() -> None:
    key = erosion.AnswerKey(P)
    solved, handed_out = (notebook(key, title="Table 1", solved=solved) for solved in (True, False))
    assert "Answer:" not in handed_out
    assert solved.count("*Answer:") == 3
    assert "Euler's method needs 308,000 steps" in solved
    turn = np.pi / 4  # ωT; Euler's step multiplies ωy + iẏ's amplitude by 1 + iωh
    errors = [((1 + 1j * turn / n) ** n).imag / np.sin(turn) - 1 for n in (307_500, 309_000)]
    assert errors[0] > 1e-6 > errors[1]
    exact = float(P.v0 * np.sin(P.alpha) / P.rate) * np.sin(turn)
    depths = [rk4(linearized_rate(P), at_contact(P), key.time, steps)[1] for steps in (7, 8)]
    assert abs(depths[0] / exact - 1) > 1e-6 > abs(depths[1] / exact - 1)
    at = P.replace(alpha=key.first_guess)
    bend = float(erosion.impact("linearized", at, derivatives=2).d2volume)

    def by_differences(d: float) -> float:
        angles = key.first_guess + d * np.array([-1, 0, 1])
        below, here, above = erosion.impact("linearized", P.replace(alpha=angles)).volume
        return float((above - 2 * here + below) / d**2)

    wrong = [abs(by_differences(d) / bend - 1) for d in (1e-2, 1e-4, 1e-6)]
    assert min(wrong[0], wrong[2]) > 1e-5
    assert wrong[1] < 1e-7
    assert wrong[2] < 1e-4
