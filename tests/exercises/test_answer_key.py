"""What is said of a student's numbers."""

import math
import re
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pint
import pytest
from scipy import integrate

import erosion
from erosion.exercises import answer_key
from erosion.exercises.answer_key import TASKS, at_contact, euler, linearized_rate, notebook, rk4

KEY = erosion.AnswerKey(erosion.TABLE_1)
P = erosion.TABLE_1


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


def test_an_unknown_task_or_language_is_told_in_short() -> None:
    with pytest.raises(ValueError, match=r"^Argument `task` must be one of omega, euler_depth, .* but is 'tc'"):
        KEY.check("tc", 1.0)
    for ask in (KEY.answer, lambda name: erosion.AnswerKey(erosion.TABLE_1, lang=name)):
        with pytest.raises(ValueError, match=r"must be one of (?s:.){1,250}$"):
            ask(100_000 * "x")


def test_a_case_that_cuts_nothing_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"^Argument `alpha` must be an angle at which something is cut, but is 90°\.$"
    ):
        erosion.AnswerKey(P.replace(alpha=np.pi / 2))


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
