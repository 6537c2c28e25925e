"""The answers to the tasks of a course about a case, and the verdict on a student's number."""

import dataclasses
import html
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from erosion.exercises.course import LINEARIZED, Course, Task
from erosion.exercises.numerics import NUMERICS, first_guess
from erosion.exercises.scenario import SCENARIO
from erosion.output import briefly
from erosion.parameters import (
    SYSTEMS,
    Dimension,
    Parameters,
    known_scales,
    require_scalars,
    unit_name,
    validate,
)

COURSES: Mapping[str, Course] = {"scenario": SCENARIO, "numerics": NUMERICS}

_NEAR = 0.05  # of the answer: the method is right, and its error is still too large
_CLOSE = 0.01

SLIPS = (
    (180 / math.pi, "It is right in degrees; give radians."),
    (math.pi / 180, "It is right, but divided by 180/π as if it had been in degrees; give radians."),
    (-1.0, "Only the sign is wrong."),
    (2.0, "It is twice the answer."),
    (0.5, "It is half of the answer."),
)
"""Factors by which an answer is often off, and what to say then."""


@dataclasses.dataclass(frozen=True, repr=False)
class Verdict:
    """The verdict on an answer; a notebook shows the sentence, and a script prints it by `print`.

    Args:
        right: whether the answer is within the tolerance.
        sentence: roughly how far off it is, and what to look at.
        points: reached by it.
    """

    right: bool
    sentence: str
    points: int

    def __repr__(self) -> str:
        return self.sentence

    def _repr_mimebundle_(self, **_: Any) -> dict[str, str]:
        """The sentence for the reader of a notebook, the points for nbgrader, which reads the plain text."""
        return {"text/plain": str(self.points), "text/html": html.escape(self.sentence)}


class Score(NamedTuple):
    """Points for numbers.

    Args:
        reached: by the answers that were checked; of several answers to a task the last one counts.
        possible: of all tasks.
    """

    reached: int
    possible: int

    def __str__(self) -> str:
        return f"{self.reached} of {self.possible} points for numbers"


class AnswerKey:
    """The answers to the tasks of `erosion exercise`, computed from the case.

        key = erosion.AnswerKey(erosion.TABLE_1)
        print(key.check("t_c", 4.9e-5))  # t_c: It is more than 5 % below the answer. …

    Args:
        p: the case, all scalars, which the key shows in SI. Its own spin is left aside.
        course: "scenario" (its questions 1 to 8 and the additional ones) or "numerics" (the numerical methods).

    Raises:
        ValueError: for parameters out of range, a case that cuts nothing, and an unknown course.
    """

    def __init__(self, p: Parameters, course: str = "scenario") -> None:
        validate(p)
        require_scalars(p)
        if course not in COURSES:
            raise ValueError(f"Argument `course` must be {' or '.join(COURSES)}, but is {briefly(course)}.")
        self.p = p.to("si").replace(phidot0=0.0)
        self.course = COURSES[course]
        self._answers: dict[str, float] = {}
        self._points: dict[str, int] = {}
        if str(LINEARIZED.ended_by(self.p)) == "no-cut":
            angle = f"{math.degrees(float(p.alpha)):g}°"
            raise ValueError(f"Argument `alpha` must be an angle at which something is cut, but is {angle}.")

    @property
    def first_guess(self) -> float:
        """The angle from which Newton's method begins [rad]."""
        return first_guess(self.p)

    @property
    def tasks(self) -> Mapping[str, Task]:
        """The tasks of the course by name, in their order."""
        return self.course.tasks

    def answer(self, task: str) -> float:
        """The answer to a task, in SI, angles in radians.

        Raises:
            ValueError: for a name that is no task.
        """
        if not isinstance(task, str) or task not in self.tasks:
            raise ValueError(f"Argument `task` must be one of {', '.join(self.tasks)}, but is {briefly(task)}.")
        if task not in self._answers:
            self._answers[task] = self.tasks[task].answer(self.p)
        return self._answers[task]

    def check(self, task: str, answer: Any) -> Verdict:
        """Compare a student's number with the answer: the last line of a notebook's cell, or `print(key.check(…))`.

        Args:
            task: its name, one of `tasks`.
            answer: a number in SI, angles in radians; `...` where there is none yet.

        Returns:
            Whether it is right, and in one or two sentences roughly how far off it is.

        Raises:
            ValueError: for a name that is no task, and for an answer that is no single finite number, or has a unit.
        """
        given = _finite_number(answer)
        if given is None and answer is not ...:
            raise ValueError(f"Argument `answer` must be one finite number, but is {briefly(answer)}.")
        right, asked = self.answer(task), self.tasks[task]
        is_right = given is not None and abs(given / right - 1) <= asked.tolerance
        self._points[task] = asked.points if is_right else 0
        said = "still to do." if given is None else self._said(given, right, asked)
        return Verdict(is_right, f"{task}: {said}", self._points[task])

    def score(self) -> Score:
        """The points of the answers that were checked, of the points of all tasks; without the interpretations."""
        return Score(sum(self._points.values()), sum(task.points for task in self.tasks.values()))

    def _said(self, given: float, right: float, asked: Task) -> str:
        """What is said of an answer."""
        ratio = given / right
        if abs(ratio - 1) <= asked.tolerance:
            return f"right. It is {asked.asks}: {self._in_words(right, asked.dimension)}."
        if slip := asked.slip(self.p, given) or self._slip(ratio, asked):
            return slip
        hint = asked.hint if abs(ratio - 1) <= _NEAR else f"It is to be {asked.asks}."
        return f"{_how_far(ratio)} {hint}"

    def _slip(self, ratio: float, asked: Task) -> str:
        """What is said of an answer that is off by the factor of a common slip; empty for any other."""
        for factor, slip in SLIPS:
            if abs(ratio / factor - 1) <= asked.tolerance and (asked.dimension == "angle" or "radians" not in slip):
                return slip
        unit = unit_name(asked.dimension, "si")
        for system in SYSTEMS:
            for scale in known_scales(asked.dimension, system):
                if scale.unit != unit and abs(ratio * scale.size - 1) <= asked.tolerance:
                    return f"It is right in {scale.unit}; give {unit}."
        return ""

    def _in_words(self, value: float, dimension: Dimension) -> str:
        if dimension == "angle":
            return f"{value:.7g} rad, {math.degrees(value):.7g}°"
        return f"{value:.7g} {unit_name(dimension, 'si')}".strip()


def _how_far(ratio: float) -> str:
    """How far off a number is, as a sentence: in steps so coarse that one check does not give the answer away."""
    if ratio <= 0:
        return "The sign is wrong." if ratio else "The answer is not 0."
    if ratio > 2:
        return f"It is more than {'ten times' if ratio > 10 else 'twice'} the answer."
    if ratio < 0.5:
        return f"It is less than {'a tenth' if ratio < 0.1 else 'half'} of the answer."
    side = "above" if ratio > 1 else "below"
    for step in (_CLOSE, _NEAR):
        if abs(ratio - 1) <= step:
            return f"It is less than {100 * step:g} % {side} the answer."
    return f"It is more than {100 * _NEAR:g} % {side} the answer."


def _finite_number(answer: Any) -> float | None:
    """An answer as a float; None for what is no single finite number."""
    # Of a quantity of pint, numpy would drop the unit; a range may be too long for the memory.
    if hasattr(answer, "units") or isinstance(answer, range):
        return None
    try:
        given = np.asarray(answer)
        if given.dtype.kind == "O" and given.size == 1 and not isinstance(given.item(), str | bytes | bool):
            given = np.asarray(float(given.item()))  # a fraction, a decimal, an exact number of sympy
    except (TypeError, ValueError, OverflowError):  # lists of several lengths, what JAX is tracing, too large integers
        return None
    if given.dtype.kind in "iuf" and given.size == 1 and np.isfinite(given).all() and not np.ma.is_masked(answer):
        return float(given.reshape(()))
    return None
