"""The answers to the tasks about a case, by fixed steps in plain numpy, the verdict on an answer, and the notebook."""

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jinja2
import numpy as np

from erosion.extras import library
from erosion.impacts import Optimum, alpha_max, impact
from erosion.models import Linearized
from erosion.output import briefly
from erosion.parameters import (
    Dimension,
    Parameters,
    System,
    conversion_factor,
    known_scales,
    require_scalars,
    unit_name,
    validate,
)

Rate = Callable[[np.ndarray], np.ndarray]


def linearized_rate(p: Parameters) -> Rate:
    """The derivative of the state (x, y, ẋ, ẏ): ẍ = -c y/m, ÿ = -k c y/m with c = σ b ψ."""
    k, stiffness_over_mass = float(p.k), float(p.sigma * p.b * p.psi / p.m)

    def rate(state: np.ndarray) -> np.ndarray:
        _, y, vx, vy = state
        return np.array([vx, vy, -stiffness_over_mass * y, -k * stiffness_over_mass * y])

    return rate


def at_contact(p: Parameters) -> np.ndarray:
    """The state (x, y, ẋ, ẏ) at contact."""
    v0, alpha = float(p.v0), float(p.alpha)
    return np.array([0.0, 0.0, v0 * math.cos(alpha), v0 * math.sin(alpha)])


def euler(rate: Rate, state: np.ndarray, time: float, steps: int) -> np.ndarray:
    """The state after equal steps of Euler's method."""
    h = time / steps
    for _ in range(steps):
        state = state + h * rate(state)
    return state


def rk4(rate: Rate, state: np.ndarray, time: float, steps: int) -> np.ndarray:
    """The state after equal steps of the classical method of Runge and Kutta."""
    h = time / steps
    for _ in range(steps):
        first = rate(state)
        second = rate(state + h / 2 * first)
        third = rate(state + h / 2 * second)
        fourth = rate(state + h * third)
        state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
    return state


EULER_STEPS = 100
RK4_STEPS = 10
_SPINS = (-0.2, -0.7, 0.8, -0.8, 0.6, -0.5, 0.5)  # s = r φ̇₀/v₀ that are tried for a maximum at a jump
_MOST = 1e300  # times the answer; beyond it there is no number to say
_NEAR = 0.05  # of the answer: the method is right, and its error is still too large


@dataclasses.dataclass(frozen=True)
class Task:
    """A number that a student computes.

    Args:
        asks: what it is, to follow "is".
        dimension: what it measures.
        tolerance: relative, within which an answer is right.
        hint: what to do where an answer is near, but not near enough.
    """

    asks: str
    dimension: Dimension
    tolerance: float
    hint: str


TASKS: Mapping[str, Task] = {
    "omega": Task("the angular frequency ω of the depth", "rate", 1e-4, "Keep all digits of the parameters."),
    "euler_depth": Task(
        f"the depth at the time π/(4ω), after {EULER_STEPS} steps of Euler's method", "length", 1e-6,
        "Check the number of steps, and that all four numbers of the state are taken from before the step.",
    ),
    "rk4_depth": Task(
        f"the depth at the time π/(4ω), after {RK4_STEPS} steps of Runge and Kutta's method", "length", 1e-7,
        "Check the number of steps and the weights 1, 2, 2, 1 of the four rates.",
    ),
    "euler_order": Task("the power of the step with which Euler's error falls", "1", 0.05, "Take more steps."),
    "rk4_order": Task(
        "the power of the step with which Runge and Kutta's error falls", "1", 0.05,
        "Take more steps, but not so many that rounding is all that is left.",
    ),
    "t_c": Task("the time at which the cut ends", "time", 1e-5, "Look for the end between two steps, not at one."),
    "volume": Task("the removed volume", "volume", 1e-4, "Take the integral to the end of the cut, in smaller steps."),
    "newton_step": Task(
        "the angle after one step of Newton's method", "angle", 1e-4, "Take the differences of V over a smaller angle."
    ),
    "alpha_max": Task("the angle of greatest removal", "angle", 1e-5, "Take one more step of Newton's method."),
    "cannonball": Task(
        "the angle at which the cannonball flies farthest", "angle", 1e-4, "Take more angles near the best one."
    ),
    "epidemic_peak": Task(
        "the share of the ill at the peak of the epidemic", "1", 1e-5, "End at the event, not at a step."
    ),
    "first_spike": Task("the time of the first spike in milliseconds", "1", 1e-5, "End at the event, not at a step."),
    "jump": Task("the angle at which the volume jumps", "angle", 1e-4, "Halve the interval more often."),
    "alpha_max_at_jump": Task(
        "the angle of greatest removal with spin", "angle", 1e-4, "It is on one side of the jump: find the jump better."
    ),
}  # fmt: skip

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
    """What is said of an answer; a notebook shows the sentence, and a script prints it by `print`.

    Args:
        right: whether the answer is within the tolerance.
        sentence: how far off it is, and what to look at.
    """

    right: bool
    sentence: str

    def __repr__(self) -> str:
        return self.sentence


class AnswerKey:
    """The answers to the tasks of `erosion exercise`, computed from the case.

        key = erosion.AnswerKey(erosion.TABLE_1)
        print(key.check("t_c", 4.9e-5))  # t_c: 26 % below the answer. It is to be the time at which the cut ends.

    Args:
        p: the case, all scalars. Its own spin is left aside: the tasks are about the linearized model, and about
            `rotating` with the spin `spin`.

    Raises:
        ValueError: for parameters out of range, and a case that cuts nothing.
    """

    def __init__(self, p: Parameters) -> None:
        validate(p)
        require_scalars(p)
        self.p = p.replace(phidot0=0.0)
        closed = Linearized().closed_form()
        assert closed is not None, "the linearized model is solved in closed form"
        self._closed = closed
        if str(closed.ended_by(self.p)) == "no-cut":
            angle = f"{math.degrees(float(p.alpha)):g}°"
            raise ValueError(f"Argument `alpha` must be an angle at which something is cut, but is {angle}.")

    @functools.cached_property
    def time(self) -> float:
        """A quarter of the time from surface to surface, π/(4ω) [time].

        At half of it the tip is deepest, and the errors of phase do not count: the order of Runge and Kutta's method
        would seem to be 5.
        """
        return math.pi / 4 / float(self.p.rate)

    @functools.cached_property
    def first_guess(self) -> float:
        """The angle from which Newton's method begins, two digits of degrees [rad]."""
        degrees = math.degrees(self._answers["alpha_max"]())
        return math.radians(float(f"{0.75 * degrees:.2g}"))

    @functools.cached_property
    def with_spin(self) -> Optimum | None:
        """A greatest removal of `rotating` at a jump; None where no spin that is tried has one."""
        for s in _SPINS:
            best = alpha_max("rotating", self.p.replace(phidot0=s * float(self.p.v0) / float(self.p.r)), max_turn=None)
            if best.kind == "jump":
                return best
        return None

    @property
    def tasks(self) -> tuple[str, ...]:
        """The names of the tasks in their order; without those with spin where no spin puts the maximum at a jump."""
        with_spin = ("jump", "alpha_max_at_jump")
        return tuple(name for name in TASKS if name not in with_spin or self.with_spin is not None)

    def answer(self, task: str) -> float:
        """The answer to a task, in the units of the case, angles in radians.

        Raises:
            ValueError: for a name that is no task.
        """
        if not isinstance(task, str) or task not in self.tasks:
            raise ValueError(f"Argument `task` must be one of {', '.join(self.tasks)}, but is {briefly(task)}.")
        return self._answers[task]()

    def check(self, task: str, answer: Any) -> Verdict:
        """Compare a student's number with the answer: the last line of a notebook's cell, or `print(key.check(…))`.

        Args:
            task: its name, one of `tasks`.
            answer: a number in the units of the case, angles in radians; `...` where there is none yet.

        Returns:
            Whether it is right, and in one or two sentences how far off it is.

        Raises:
            ValueError: for a name that is no task, and for an answer that is no single finite number, or has a unit.
        """
        given = _finite_number(answer)
        if given is None and answer is not ...:
            raise ValueError(f"Argument `answer` must be one finite number, but is {briefly(answer)}.")
        right, asked = self.answer(task), TASKS[task]
        if given is None:
            return Verdict(False, f"{task}: still to do.")
        ratio = given / right
        if abs(ratio - 1) <= asked.tolerance:
            words = self._in_words(right, asked.dimension)
            return Verdict(True, f"{task}: right. It is {asked.asks}: {words}.")
        slip = self._slip(ratio, asked)
        if slip:
            return Verdict(False, f"{task}: {slip}")
        near = abs(ratio - 1) <= _NEAR
        hint = asked.hint if near else f"It is to be {asked.asks}."
        return Verdict(False, f"{task}: {self._how_far(ratio)} {hint}")

    def _slip(self, ratio: float, asked: Task) -> str:
        """What is said of an answer that is off by the factor of a common slip; empty for any other."""
        for factor, slip in SLIPS:
            if abs(ratio / factor - 1) <= asked.tolerance and (asked.dimension == "angle" or "radians" not in slip):
                return slip
        unit = unit_name(asked.dimension, self.p.units)
        for system in get_args(System):
            per_unit = conversion_factor(asked.dimension, self.p.units, system)
            for scale in known_scales(asked.dimension, system):
                factor = per_unit / scale.size
                if scale.unit != unit and abs(ratio / factor - 1) <= asked.tolerance:
                    return f"It is right in {scale.unit}; give {unit}."
        return ""

    def _how_far(self, ratio: float) -> str:
        """How far off a number is, to two or three digits, as a sentence."""
        if ratio == 0:
            return "The answer is not 0."
        sign = "" if ratio > 0 else "The sign is wrong. "
        size = min(abs(ratio), _MOST)
        if size >= 2:
            return sign + f"It is {_plain_digits(size, 3)} times the answer."
        if size <= 0.5:
            return sign + f"The answer is {_plain_digits(1 / size, 3)} times as large."
        return f"{sign}{_plain_digits(100 * abs(size - 1), 2)} % {'above' if size > 1 else 'below'} the answer."

    def _in_words(self, value: float, dimension: Dimension) -> str:
        if dimension == "angle":
            return f"{value:.7g} rad, {math.degrees(value):.7g}°"
        return f"{value:.7g} {unit_name(dimension, self.p.units)}".strip()

    @property
    def _answers(self) -> Mapping[str, Callable[[], float]]:
        return {
            "omega": lambda: float(self.p.rate),
            "euler_depth": lambda: self._depth(euler, EULER_STEPS),
            "rk4_depth": lambda: self._depth(rk4, RK4_STEPS),
            "euler_order": lambda: 1.0,
            "rk4_order": lambda: 4.0,
            "t_c": lambda: float(self._closed.t_c(self.p)),
            "volume": lambda: float(self._closed.volume(self.p)),
            "newton_step": self._newton_step,
            "alpha_max": lambda: float(alpha_max("linearized", self.p).alpha),
            "cannonball": _farthest,
            # β s falls to γ: i = i₀ + s₀ - (γ/β)(1 + ln(β s₀/γ)) by di/ds = -1 + γ/(β s).
            "epidemic_peak": lambda: 1.0 - 0.4 * (1.0 + math.log(0.999 / 0.4)),
            "first_spike": lambda: 20.0 * math.log(3.0),  # u = 1.5 (1 - exp(-t/20))
            "jump": lambda: self._at_jump()[1],
            "alpha_max_at_jump": lambda: self._at_jump()[0],
        }

    def _depth(self, method: Callable[..., np.ndarray], steps: int) -> float:
        return float(method(linearized_rate(self.p), at_contact(self.p), self.time, steps)[1])

    def _newton_step(self) -> float:
        hit = impact("linearized", self.p.replace(alpha=self.first_guess), derivatives=2)
        return self.first_guess - float(hit.dvolume) / float(hit.d2volume)

    def _at_jump(self) -> tuple[float, float]:
        """The angle of greatest removal with spin, and that of the jump where it is."""
        best: Any = self.with_spin
        return float(best.alpha), min((float(jump.alpha) for jump in best.jumps), key=lambda at: abs(at - best.alpha))


def _farthest(v0: float = 100.0, drag: float = 0.1, g: float = 9.81) -> float:
    """The angle at which a ball with the drag γẋ and γẏ flies farthest, by its closed form [rad]."""
    from scipy import optimize

    def distance(angle: float) -> float:
        vx, vy = v0 * math.cos(angle), v0 * math.sin(angle)

        def height(t: float) -> float:
            return (vy + g / drag) * -math.expm1(-drag * t) / drag - g * t / drag

        # It lands after more than half of the time, and before all of it, that a ball without drag would fly.
        time: Any = optimize.brentq(height, vy / g, 2 * vy / g)
        return -vx * math.expm1(-drag * time) / drag

    best = optimize.minimize_scalar(lambda angle: -distance(angle), bounds=(0.3, 1.2), options={"xatol": 1e-9})
    return float(best.x)


def _finite_number(answer: Any) -> float | None:
    """An answer as a float; None for what is no single finite number."""
    # Of a quantity of pint, numpy would drop the unit; a range may be too long for the memory.
    if hasattr(answer, "units") or isinstance(answer, range):
        return None
    try:
        given = np.asarray(answer)
    except (TypeError, ValueError):  # lists of several lengths, and what JAX is tracing
        return None
    if given.dtype.kind in "iuf" and given.size == 1 and np.isfinite(given).all() and not np.ma.is_masked(answer):
        return float(given.reshape(()))
    return None


def _plain_digits(value: float, digits: int) -> str:
    """A number rounded to some digits, without an exponent up to 10¹⁵: "27", "0.0031", "1000000"."""
    return f"{float(f'{value:.{digits}g}'):.15g}"


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
    for number, (kind, source) in enumerate(cells_of(_filled(key, title, solved=solved), solved=solved)):
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


def _filled(key: AnswerKey, title: str, *, solved: bool) -> str:
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    best = key.with_spin
    return environment.from_string(TEXT.read_text("utf-8")).render(
        title=_plain(title),
        solved=solved,
        p=repr(key.p),
        units=", ".join(unit_name(dimension, key.p.units) for dimension in ("mass", "length", "speed", "stress")),
        alpha=f"{math.degrees(float(key.p.alpha)):g}",
        euler_steps=EULER_STEPS,
        rk4_steps=RK4_STEPS,
        first_guess=f"{math.degrees(key.first_guess):g}",
        spin=None if best is None else float(best.p.phidot0),
        spin_ratio=None if best is None else f"{float(best.p.spin):g}",
    )
