"""The answers to the tasks against closed forms and scipy, and what is said of a student's numbers."""

import math
import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pint
import pytest
from scipy import integrate, optimize

import erosion
from erosion.exercises import AnswerKey
from erosion.exercises.numerics import at_contact, euler, first_guess, linearized_rate, quarter, rk4, spinning

P = erosion.TABLE_1
CASES = {"Table 1": P, "a stop, SI": P.to("si").replace(k=1.5, alpha=np.deg2rad(50), v0=76.2)}
KEY = AnswerKey(P, "numerics")


class Exact:
    """½ arctan 2 as a symbolic number, such as sympy's."""

    def __float__(self) -> float:
        return math.atan(2) / 2


class Cut:
    """A cut by scipy, without the package's models: V, t_c and turn of a force ratio, with or without rotation."""

    def __init__(self, p: erosion.Parameters, *, alpha: float | None = None, ratio: Callable[..., Any] | None = None,
                 turns: bool = False, **changes: float) -> None:  # fmt: skip
        v = {name: float(getattr(p, name)) for name in ("k", "psi", "r", "b", "m", "v0", "sigma", "alpha", "inertia")}
        v |= changes | ({} if alpha is None else {"alpha": alpha})
        c, r = v["sigma"] * v["b"] * v["psi"], v["r"]
        start = [0, 0, math.pi / 2, v["v0"] * math.cos(v["alpha"]), v["v0"] * math.sin(v["alpha"]), 0, 0]
        omega = math.sqrt((v["k"] if ratio is None else ratio(*start[3:5])) * c / v["m"])
        lever = r if turns else 0.0

        def tip(state: np.ndarray) -> tuple[float, float]:
            _, y, phi, vx, _, spin, _ = state
            return y - lever * (1 - math.sin(phi)), vx + lever * spin * math.sin(phi)

        def rate(_: float, state: np.ndarray) -> list[float]:
            depth, vx_tip = tip(state)
            force = -c * depth
            lift = force * (v["k"] if ratio is None else ratio(state[3], state[4]))
            spun = force / (v["inertia"] * v["m"] * r)
            return [*state[3:6], force / v["m"], lift / v["m"], spun, v["b"] * depth * vx_tip]

        events: list[Any] = [
            lambda _, state: tip(state)[0],
            lambda _, state: tip(state)[1] - (0 if ratio is None else 1e-7 * v["v0"]),
        ]
        for event in events:
            event.terminal, event.direction = True, -1
        scale = [v["v0"] / omega] * 2 + [1.0] + [v["v0"]] * 2 + [v["v0"] / r, float(p.volume_scale)]
        found = integrate.solve_ivp(rate, (0, 30 / omega), start, "DOP853", events=events, rtol=1e-11,
                                    atol=1e-13 * np.array(scale), max_step=0.05 / omega)  # fmt: skip
        assert found.status == 1
        self.t_c, self.volume = float(found.t[-1]), float(found.y[6, -1])
        self.turn = float(np.max(np.abs(found.y[2] - math.pi / 2)))


def best(p: erosion.Parameters, **changes: Any) -> float:
    """The angle of greatest removal by scipy, of a V(α) with one maximum."""
    found: Any = optimize.minimize_scalar(lambda a: -Cut(p, alpha=a, **changes).volume, bounds=(0.05, 1.4),
                                     options={"xatol": 1e-6})  # fmt: skip
    return float(found.x)


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
def test_questions_1_to_3_by_scipy(p: erosion.Parameters) -> None:
    key, cut = AnswerKey(p), Cut(p)
    omega = key.answer("omega")
    at = integrate.solve_ivp(lambda _, s: linearized_rate(p)(s), (0, 1 / omega), at_contact(p), "DOP853", rtol=1e-12,
                             atol=1e-16).y[:, -1]  # fmt: skip
    assert (key.answer("distance"), key.answer("depth")) == pytest.approx((at[0], at[1]), rel=1e-9)
    assert key.answer("t_c") == pytest.approx(cut.t_c, rel=1e-8)
    assert key.answer("volume") == pytest.approx(cut.volume, rel=1e-9)
    cusp = key.answer("cusp")
    assert key.answer("steep_t_c") == pytest.approx(Cut(p, alpha=(cusp + math.pi / 2) / 2).t_c, rel=1e-8)
    assert Cut(p, alpha=cusp - 1e-3).t_c == pytest.approx(math.pi / omega, rel=1e-8)
    assert Cut(p, alpha=cusp + 1e-3).t_c < 0.99 * math.pi / omega


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
def test_questions_4_to_8_by_scipy(p: erosion.Parameters) -> None:
    key, first = AnswerKey(p), best(p)
    greatest = Cut(p, alpha=first).volume
    assert key.answer("alpha_max") == pytest.approx(first, abs=1e-5)
    assert key.answer("volume_max") == pytest.approx(greatest, rel=1e-9)
    v0, m, sigma, k = (float(getattr(p, name)) for name in ("v0", "m", "sigma", "k"))
    for task, changes in {
        "fast_alpha_max": {"v0": 2 * v0},
        "heavy_alpha_max": {"m": 2 * m},
        "titanium_alpha_max": {"sigma": 136 / 200 * sigma},
        "large_psi_alpha_max": {"psi": 4.0},
        "half_k_alpha_max": {"k": k / 2},
    }.items():
        assert key.answer(task) == pytest.approx(best(p, **changes), abs=1e-5), task
    assert key.answer("speed_power") == pytest.approx(math.log2(Cut(p, alpha=first, v0=2 * v0).volume / greatest))
    assert key.answer("mass_power") == pytest.approx(math.log2(Cut(p, alpha=first, m=2 * m).volume / greatest))
    softer = Cut(p, alpha=first, sigma=10 / 136 * sigma).volume
    assert key.answer("copper_over_titanium") == pytest.approx(softer / greatest, rel=1e-8)
    assert key.answer("alpha_max_limit") == pytest.approx(best(p, k=1e4), abs=1e-3)


@pytest.mark.parametrize("p", CASES.values(), ids=CASES)
def test_the_additional_questions_by_scipy(p: erosion.Parameters) -> None:
    key, k = AnswerKey(p), float(p.k)
    assert key.answer("turning_volume") == pytest.approx(Cut(p, turns=True).volume, rel=1e-8)
    tan = Cut(p, ratio=lambda vx, vy: math.tan(float(p.alpha)))
    assert key.answer("tan_volume") == pytest.approx(tan.volume, rel=1e-6)
    assert key.answer("tan_limit") == pytest.approx(
        Cut(p, alpha=1e-3, ratio=lambda vx, vy: math.tan(1e-3)).volume, rel=1e-5
    )
    assert key.answer("aligned_volume") == pytest.approx(Cut(p, ratio=lambda vx, vy: vy / vx).volume, rel=1e-6)
    rubs = Cut(p, sigma=float(p.sigma) * (1 + 0.3 * k), k=k / (1 + 0.3 * k))
    assert key.answer("friction_volume") == pytest.approx(rubs.volume, rel=1e-9)

    inside = best_of_valid(p, k)
    assert key.answer("turning_alpha_max") == pytest.approx(inside, abs=1e-4)
    assert key.answer("turning_half_k") == pytest.approx(best_of_valid(p, k / 2), abs=1e-4)


def best_of_valid(p: erosion.Parameters, k: float) -> float:
    """The best of angles at which the body turns by 90° at most, by scipy: a scan, then a finer one around its best."""
    low, high = 0.05, 1.2
    for _ in range(4):
        angles = np.linspace(low, high, 25)
        cuts = [Cut(p, alpha=a, turns=True, k=k) for a in angles]
        at = int(np.argmax([cut.volume if cut.turn <= math.pi / 2 else 0.0 for cut in cuts]))
        low, high = angles[max(at - 1, 0)], angles[min(at + 1, 24)]
    return float((low + high) / 2)


def test_the_best_angle_with_any_turn_is_that_of_the_golden_numbers() -> None:
    assert np.rad2deg(AnswerKey(P).answer("any_turn_half_k")) == pytest.approx(39.99624582, abs=1e-6)


def test_the_angle_with_spin_is_at_a_jump_where_the_model_holds() -> None:
    alpha = KEY.answer("alpha_max_at_jump")
    angles = np.concatenate([[alpha - 1e-6, alpha, alpha + 1e-6], np.linspace(0.01, np.pi / 2, 400)])
    volumes = erosion.impact("rotating", spinning(P).replace(alpha=angles)).volume
    assert volumes[1] > 1.5 * volumes[0]
    assert volumes[1] > volumes[2:].max()
    free = erosion.alpha_max("rotating", spinning(P), max_turn=None)
    assert (free.kind, bool(free.turned_beyond)) == ("jump", False)
    assert float(free.alpha) == pytest.approx(alpha, abs=1e-8)


def test_the_teachers_numbers_of_steps_and_distances() -> None:
    angle = np.pi / 4  # ωT; Euler's step multiplies ωy + iẏ's amplitude by 1 + iωh
    errors = [((1 + 1j * angle / n) ** n).imag / np.sin(angle) - 1 for n in (308_000, 309_000)]
    assert errors[0] > 1e-6 > errors[1]
    exact = float(P.v0 * np.sin(P.alpha) / P.rate) * np.sin(angle)
    depths = [rk4(linearized_rate(P), at_contact(P), quarter(P), steps)[1] for steps in (7, 8)]
    assert abs(depths[0] / exact - 1) > 1e-6 > abs(depths[1] / exact - 1)
    text = KEY.course.text.read_text()
    assert "309,000 steps" in text
    bend = float(erosion.impact("linearized", P.replace(alpha=first_guess(P)), derivatives=2).d2volume)

    def by_differences(d: float) -> float:
        angles = first_guess(P) + d * np.array([-1, 0, 1])
        below, here, above = erosion.impact("linearized", P.replace(alpha=angles)).volume
        return float((above - 2 * here + below) / d**2)

    wrong = [abs(by_differences(d) / bend - 1) for d in (1e-2, 1e-4, 1e-6)]
    assert min(wrong[0], wrong[2]) > 1e-5
    assert wrong[1] < 1e-7
    assert wrong[2] < 1e-4


@pytest.mark.parametrize("task", KEY.tasks)
def test_an_answer_within_the_tolerance_is_right(task: str) -> None:
    tolerance = KEY.tasks[task].tolerance
    assert repr(KEY.check(task, KEY.answer(task))).startswith(f"{task}: right. It is {KEY.tasks[task].asks}: ")
    assert KEY.check(task, KEY.answer(task) * (1 + 0.99 * tolerance)).right
    assert not KEY.check(task, KEY.answer(task) * (1 + 1.01 * tolerance)).right


@pytest.mark.parametrize(
    ("task", "ratio", "sentence"),
    [
        ("t_c", 0.987, "It is less than 5 % below the answer. Look for the end between two steps, not at one."),
        ("t_c", 0.995, "It is less than 1 % below the answer. Look for the end between two steps, not at one."),
        ("t_c", 1.25, "It is more than 5 % above the answer. It is to be the time at which the cut ends."),
        ("alpha_max", 180 / math.pi, "It is right in degrees; give radians."),
        ("alpha_max", -1.0, "Only the sign is wrong."),
        ("alpha_max", 2.0, "It is twice the answer."),
        # Only angles can be in degrees.
        ("volume", 180 / math.pi, "It is more than ten times the answer. It is to be the removed volume."),
        ("volume", 3.0, "It is more than twice the answer. It is to be the removed volume."),
        ("volume", 0.4, "It is less than half of the answer. It is to be the removed volume."),
        ("volume", 0.55, "It is more than 5 % below the answer. It is to be the removed volume."),
        ("volume", 1e-4, "It is less than a tenth of the answer. It is to be the removed volume."),
        ("volume", -3e3, "The sign is wrong. It is to be the removed volume."),
        ("volume", 0.0, "The answer is not 0. It is to be the removed volume."),
        ("volume", 1e308, "It is more than ten times the answer. It is to be the removed volume."),
    ],
)
def test_the_sentence_says_how_far_off_an_answer_is(task: str, ratio: float, sentence: str) -> None:
    verdict = KEY.check(task, ratio * KEY.answer(task))
    assert not verdict.right
    assert str(verdict) == f"{task}: {sentence}"
    assert str(KEY.check(task, ...)) == f"{task}: still to do."


@pytest.mark.parametrize(("task", "k"), [("turning_alpha_max", 2.0), ("turning_half_k", 1.0)])
def test_a_best_angle_beyond_the_limit_of_the_turn_is_recognized(task: str, k: float) -> None:
    key = AnswerKey(P.replace(v0="5500 in/s"))
    free = erosion.alpha_max("rotating", key.p.replace(k=k), max_turn=None)
    turn = math.degrees(Cut(key.p, alpha=float(free.alpha), turns=True, k=k).turn)
    assert turn > 91
    verdict = key.check(task, free.alpha)
    assert not verdict.right
    assert f"turns by {turn:.3g}°; " in str(verdict)
    assert "turns by" not in str(key.check(task, 0.9 * key.answer(task)))


def test_the_score_counts_the_last_answer_to_each_task() -> None:
    key = AnswerKey(P)
    assert key.score() == (0, 49)
    key.check("volume", key.answer("volume"))
    key.check("alpha_max", 2 * key.answer("alpha_max"))
    assert str(key.score()) == "3 of 49 points for numbers"
    key.check("alpha_max", key.answer("alpha_max"))
    key.check("volume", ...)
    assert key.score() == (3, 49)


def test_a_notebook_shows_the_sentence_and_nbgrader_reads_the_points() -> None:
    key = AnswerKey(P)
    bundles = [key.check("volume", key.answer("volume") * factor)._repr_mimebundle_() for factor in (1, 1.25)]
    assert [float(bundle["text/plain"]) for bundle in bundles] == [3, 0]
    assert bundles[1]["text/html"] == "volume: It is more than 5 % above the answer. It is to be the removed volume."


@pytest.mark.parametrize(
    ("task", "factor", "other", "unit"),
    [
        ("euler_depth", 1 / 0.0254, "in", "m"),
        ("rk4_depth", 1e3, "mm", "m"),
        ("rk4_depth", 1e6, "µm", "m"),
        ("rk4_depth", 1e3 / 0.0254, "mil", "m"),
        ("volume", 1e9, "mm³", "m³"),
        ("volume", 1e6, "cm³", "m³"),
        ("volume", 0.0254**-3, "in³", "m³"),
        ("t_c", 1e6, "µs", "s"),
    ],
)
def test_an_answer_in_other_units_is_recognized(task: str, factor: float, other: str, unit: str) -> None:
    assert str(KEY.check(task, KEY.answer(task) * factor)) == f"{task}: It is right in {other}; give {unit}."


def test_one_check_does_not_give_the_answer_away() -> None:
    """Within each step the sentence is the same for all guesses."""
    for low, high in ((1.002, 1.0099), (0.96, 0.985), (1.06, 1.9), (0.51, 0.94), (2.2, 9.9), (0.11, 0.49)):
        said = {str(AnswerKey(P).check("alpha_max", ratio * math.atan(2) / 2)) for ratio in np.linspace(low, high, 20)}
        assert len(said) == 1


@pytest.mark.parametrize("answer", [Fraction(5536, 10_000), Decimal("0.5536"), [0.5536], np.float32(0.5536), Exact()])
def test_a_right_number_of_any_type_is_right(answer: Any) -> None:
    assert AnswerKey(P).check("alpha_max", answer).right


@pytest.mark.parametrize(
    "answer",
    [math.nan, math.inf, None, "0.5", [1.0, 2.0], 1j, range(10**12), pint.Quantity(4.9e-5, "s"),
     np.ma.masked_array([1.0], [True]), [[1], [1, 2]], 100_000 * "a", 10**4000,
     np.array(["0.5"], object), np.array(True, object)],
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
            lambda: AnswerKey(P.replace(alpha=np.pi / 2)),
            r"^Argument `alpha` must be an angle at which something is cut, but is 90°\.$",
        ),
    ],
    ids=["task", "long task", "nothing is cut"],
)
def test_what_a_key_cannot_answer_is_told_in_short(ask: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask()


def test_the_methods_of_the_tasks_have_their_orders() -> None:
    rate, start, time = linearized_rate(P), at_contact(P), quarter(P)
    exact = integrate.solve_ivp(lambda _, state: rate(state), (0, time), start, "DOP853", rtol=1e-13, atol=1e-18).y[
        1, -1
    ]
    for method, order in ((euler, 1.0), (rk4, 4.0)):
        coarse, fine = (abs(method(rate, start, time, steps)[1] - exact) for steps in (40, 80))
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.05)


def test_the_script_of_the_documentation_prints_what_it_says(capsys: pytest.CaptureFixture) -> None:
    text = (Path(__file__).parents[2] / "docs" / "classroom.md").read_text("utf-8")
    (script,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    exec(script, {})
    assert capsys.readouterr().out.splitlines() == re.findall(r"  # (.+)$", script, re.MULTILINE)
