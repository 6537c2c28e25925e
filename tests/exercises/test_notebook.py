"""The notebook of tasks, and that its solutions are right.

What is said of a student's numbers.
"""

import ast
import io
import json
import math
import re
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import jax
import matplotlib.pyplot as plt
import nbformat
import numpy as np
import pint
import pytest
from scipy import integrate

import erosion
from erosion.cli import exit_status
from erosion.exercises import AnswerKey, Verdict, answer_key
from erosion.exercises.answer_key import TASKS, at_contact, cells_of, euler, linearized_rate, notebook, rk4

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
    ("units", "says"),
    [
        ("si", "and your answers, are in kg, m, m/s, Pa, and angles in radians"),
        ("inch-pound", "and your answers, are in slinch, in, in/s, lbf/in², and angles in radians"),
    ],
)
def test_the_numbers_of_a_case_have_their_units_named(units: Any, says: str) -> None:
    text = notebook(AnswerKey(P.to(units)), title="a case")
    assert says in " ".join(json.loads(text)["cells"][0]["source"]).replace("\n", " ").replace("  ", " ")


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
def test_all_solutions_are_right(p: erosion.Parameters) -> None:
    key = erosion.AnswerKey(p)
    values = shown(notebook(key, title="a case", solved=True))
    said = verdicts(values)
    assert [str(verdict) for verdict in said if not verdict.right] == []
    assert len(said) == len(key.tasks)
    assert key.with_spin is None or "jump" in str(values[-1])


def test_an_unfilled_notebook_runs_and_gives_no_answer_away() -> None:
    key = erosion.AnswerKey(P)
    values = shown(notebook(key, title="a case"))
    tasks = [*key.tasks, "alpha_max_at_jump"]  # the last cell shows the tool's answer when the student's is right
    said = [str(verdict) for verdict in verdicts(values)]
    assert sorted(said) == sorted(f"{task}: still to do." for task in tasks)
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
    assert exit_status(["exercise", "--alpha", "40deg", "-o", str(tasks), "--solved", str(solved)]) == 0
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
    assert exit_status(["exercise", *arguments]) == 2
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


KEY = erosion.AnswerKey(erosion.TABLE_1)


@pytest.mark.parametrize("task", KEY.tasks)
def test_an_answer_within_the_tolerance_is_right(task: str) -> None:
    tolerance = TASKS[task].tolerance
    assert repr(KEY.check(task, KEY.answer(task))).startswith(f"{task}: right. It is {TASKS[task].asks}: ")
    assert KEY.check(task, KEY.answer(task) * (1 + 0.99 * tolerance)).right
    assert not KEY.check(task, KEY.answer(task) * (1 + 1.01 * tolerance)).right


@pytest.mark.parametrize(
    ("task", "ratio", "sentence"),
    [
        ("t_c", 0.987, "1.3 % below the answer. Look for the end between two steps, not at one."),
        ("t_c", 1.25, "25 % above the answer. It is to be the time at which the cut ends."),
        ("alpha_max", 180 / math.pi, "It is right in degrees; give radians."),
        ("alpha_max", -1.0, "Only the sign is wrong."),
        ("alpha_max", 2.0, "It is twice the answer."),
        # Only angles can be in degrees.
        ("volume", 180 / math.pi, "It is 57.3 times the answer. It is to be the removed volume."),
        ("volume", 0.55, "45 % below the answer. It is to be the removed volume."),
        ("volume", 1e-4, "The answer is 10000 times as large. It is to be the removed volume."),
        ("volume", -3e3, "The sign is wrong. It is 3000 times the answer. It is to be the removed volume."),
        ("volume", 0.0, "The answer is not 0. It is to be the removed volume."),
        ("volume", 1e308, "It is 1e+300 times the answer. It is to be the removed volume."),
    ],
)
def test_the_sentence_says_how_far_off_an_answer_is(task: str, ratio: float, sentence: str) -> None:
    verdict = KEY.check(task, ratio * KEY.answer(task))
    assert not verdict.right
    assert str(verdict) == f"{task}: {sentence}"
    assert str(KEY.check(task, ...)) == f"{task}: still to do."


IN_SI = erosion.AnswerKey(P.to("si"))


@pytest.mark.parametrize(
    ("key", "task", "factor", "other", "unit"),
    [
        (KEY, "euler_depth", 0.0254, "m", "in"),
        (KEY, "rk4_depth", 25.4, "mm", "in"),
        (KEY, "rk4_depth", 1e3, "mil", "in"),
        (KEY, "volume", 0.0254**3, "m³", "in³"),
        (KEY, "t_c", 1e6, "µs", "s"),
        (IN_SI, "volume", 1e9, "mm³", "m³"),
        (IN_SI, "volume", 1e6, "cm³", "m³"),
        (IN_SI, "volume", 0.0254**-3, "in³", "m³"),
        (IN_SI, "rk4_depth", 1e6, "µm", "m"),
    ],
)
def test_an_answer_in_other_units_is_recognized(
    key: erosion.AnswerKey, task: str, factor: float, other: str, unit: str
) -> None:
    assert str(key.check(task, key.answer(task) * factor)) == f"{task}: It is right in {other}; give {unit}."


@pytest.mark.parametrize(
    "answer",
    [math.nan, math.inf, None, "0.5", [1.0, 2.0], 1j, range(10**12), pint.Quantity(4.9e-5, "s"),
     np.ma.masked_array([1.0], [True]), [[1], [1, 2]], 100_000 * "a", 10**4000],
)  # fmt: skip
def test_what_is_no_number_is_refused_in_one_short_sentence(answer: Any) -> None:
    with pytest.raises(ValueError, match=r"^Argument `answer` must be one finite number, but is (?s:.){1,200}$"):
        KEY.check("t_c", answer)
    with pytest.raises(ValueError, match=r"^Argument `answer` must be one finite number"):
        jax.jit(lambda traced: 1.0 * KEY.check("t_c", traced).right)(1e-5)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: KEY.check("tc", 1.0), "^Argument `task` must be one of omega, euler_depth, .* but is 'tc'"),
        (lambda: KEY.answer(100_000 * "x"), "must be one of (?s:.){1,250}$"),
        (
            lambda: erosion.AnswerKey(P.replace(alpha=np.pi / 2)),
            r"^Argument `alpha` must be an angle at which something is cut, but is 90°\.$",
        ),
    ],
    ids=["task", "long task", "nothing is cut"],
)
def test_what_a_key_cannot_answer_is_told_in_short(ask: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask()


def test_the_methods_of_the_tasks_have_their_orders() -> None:
    rate, start, time = linearized_rate(P), at_contact(P), KEY.time
    exact = integrate.solve_ivp(lambda _, state: rate(state), (0, time), start, "DOP853", rtol=1e-13, atol=1e-18).y[
        1, -1
    ]
    for method, order in ((euler, 1.0), (rk4, 4.0)):
        coarse, fine = (abs(method(rate, start, time, steps)[1] - exact) for steps in (40, 80))
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.05)


def test_the_angle_with_spin_is_at_a_jump() -> None:
    best = KEY.with_spin
    assert best is not None
    assert best.kind == "jump"
    assert KEY.answer("jump") == pytest.approx(KEY.answer("alpha_max_at_jump"), abs=1e-7)
    beside = best.p.replace(alpha=KEY.answer("jump") + np.array([-1e-6, 1e-6]))
    volumes = erosion.impact("rotating", beside).volume
    assert abs(volumes[1] - volumes[0]) > 0.05 * volumes.max()


def test_without_a_jump_its_tasks_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answer_key, "_SPINS", (0.0,))  # with which Table 1 has its maximum inside
    key = erosion.AnswerKey(P)
    assert key.with_spin is None
    assert key.tasks == KEY.tasks[:-2]
    with pytest.raises(ValueError, match="must be one of"):
        key.answer("jump")
    assert "Where Newton" not in notebook(key, title="a case")


def test_the_script_of_the_documentation_prints_what_it_says(capsys: pytest.CaptureFixture) -> None:
    text = (Path(__file__).parents[2] / "docs" / "classroom.md").read_text("utf-8")
    (script,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    exec(script, {})
    assert capsys.readouterr().out.splitlines() == re.findall(r"  # (.+)$", script, re.MULTILINE)
