"""A case for each student: drawn by the name, with an answer to every task."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cli import exit_status
from erosion.exercises import AnswerKey
from erosion.exercises.students import answers_table, drawn_case, read_students

P = erosion.TABLE_1


def test_the_same_name_and_seed_give_the_same_case() -> None:
    assert repr(drawn_case(P, "ada")) == repr(drawn_case(P, "ada"))
    cases = {repr(drawn_case(P, name, seed=seed)) for name in ("ada", "bob", "Ada") for seed in (0, 1)}
    assert len(cases) == 6


def test_what_is_kept_stays() -> None:
    case = drawn_case(P, "ada", kept=["k", "alpha"])
    assert (float(case.k), float(case.alpha)) == (2.0, float(P.alpha))
    assert float(case.v0) != float(P.v0)


@pytest.mark.parametrize(
    ("p", "kept"),
    [(P, ()), (P, ("v0",)), (P, ("v0", "sigma")), (P.replace(v0="9000 in/s", inertia=0.4).to("si"), ())],
    ids=["inch-pound", "v0 kept", "v0 and sigma kept", "a fast sphere, si"],
)
def test_each_drawn_case_holds_where_the_course_needs_it(p: erosion.Parameters, kept: tuple[str, ...]) -> None:
    cases = [drawn_case(p, f"s{i:02}", kept=kept) for i in range(60)]
    together = erosion.Parameters(**{q: [float(getattr(case, q)) for case in cases] for q in ("k", "psi", "r", "b", "m",
                                  "v0", "sigma", "alpha", "phidot0", "inertia")}, shown_in=p.shown_in)  # fmt: skip
    k = np.asarray(together.k)
    assert np.all(np.arctan(k / 2) > 1.01 * np.arctan(2 / k))  # a usual slip in question 2
    # Question 2 sees a rebound and a stop, at angles that are not the best one.
    assert np.all(together.alpha < np.arctan(k / 2) - 0.2)
    assert np.all(together.alpha < np.arctan(k) / 2 - 0.1)
    cut, best = erosion.impact("rotating", together), erosion.alpha_max("rotating", together)
    assert np.all(np.abs(cut.turn) < np.pi / 2)
    assert set(best.kind) == {"interior"}
    assert np.all(best.alpha > np.asarray(together.alpha) + 0.03)
    assert np.allclose(best.alpha, erosion.alpha_max("rotating", together, max_turn=None).alpha)
    half = together.replace(k=k / 2)
    limited, free = (erosion.alpha_max("rotating", half, max_turn=turn) for turn in ("90deg", None))
    assert np.all((limited.alpha > 0.05) & free.turned_beyond & ~limited.turned_beyond)
    assert np.all(free.alpha > 1.1 * limited.alpha)


@pytest.mark.parametrize("p", [P, P.to("si")], ids=["inch-pound", "si"])
def test_each_task_of_a_drawn_case_has_an_answer(p: erosion.Parameters) -> None:
    slow = ("turning_alpha_max", "turning_half_k", "any_turn_half_k")
    for i in range(20):
        key = AnswerKey(drawn_case(p, str(i)))
        assert all(np.isfinite(key.answer(task)) and key.answer(task) > 0 for task in key.tasks if task not in slow)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("name\nada\nJosé García\n", ["ada", "José García"]),
        ("id;name\n007;ada\n008;bob\n", ["007", "008"]),
        ("\ufeffmark,id\n1,x1\n", ["x1"]),
    ],
)
def test_students_are_read_from_a_column(text: str, names: list[str], tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text(text, "utf-8")
    assert read_students(path) == names


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("ada\nbob\n", "must have a column `id` or `name`, but has 'ada'."),
        ("name\nada\nAda\n", "line 3: Ada is there twice; name the students apart."),
        ("name\n../ada\n", "line 2: the `name` must be a part of a file's name, but is '../ada'."),
        ("name,mark\n,3\n", "line 2: the `name` must be a part of a file's name, but is ''."),
        ("name\n", "has no student."),
    ],
)
def test_a_list_that_names_no_student_is_refused(
    text: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("list.csv").write_text(text)
    assert exit_status(["exercise", "--students", "list.csv"]) == 2
    assert capsys.readouterr().err.endswith(f"{sentence}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["list.csv"]


def test_the_command_writes_a_notebook_for_each_student_and_the_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("list.csv").write_text("name\nada\nbob\n")
    words = ["exercise", "--course", "numerics", "--students", "list.csv", "-o", "tasks.ipynb", "--k", "1.5"]
    assert exit_status([*words, "--solved", "solved.ipynb", "--answers", "answers.csv"]) == 0
    names = [
        "answers.csv",
        "list.csv",
        *(f"{kind}-{name}.ipynb" for kind in ("solved", "tasks") for name in ("ada", "bob")),
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert capsys.readouterr().out.count("13 tasks about Table 1, k = 1.5, ada\n") == 1
    rows = list(csv.DictReader(Path("answers.csv").read_text().splitlines()))
    for row, name in zip(rows, ("ada", "bob"), strict=True):
        key = AnswerKey(drawn_case(P.replace(k=1.5), name, kept=["k"]), "numerics")
        assert row["student"] == name
        assert float(row["t_c [s]"]) == key.answer("t_c")
        assert float(row["sigma [Pa]"]) == float(key.p.sigma)
        assert repr(key.p) in "".join(json.loads(Path(f"tasks-{name}.ipynb").read_text())["cells"][1]["source"])


def test_a_seed_draws_one_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_status(["exercise", "--seed", "3", "-o", "tasks.ipynb"]) == 0
    assert repr(drawn_case(P.to("si"), "", seed=3)) in Path("tasks.ipynb").read_text()


def test_the_table_of_answers_has_each_task_with_its_unit() -> None:
    key = AnswerKey(P.to("si"), "numerics")
    heading, row = csv.reader(answers_table({"ada": key}).splitlines())
    assert heading[0] == "student"
    assert len(heading) == len(row) == 1 + 10 + 13
    assert dict(zip(heading, row, strict=True))["volume [m³]"] == repr(key.answer("volume"))
