"""The course that follows the scenario: its questions 1 to 8, the additional ones, and a force law of one's own."""

import dataclasses
import math
from pathlib import Path
from typing import Any

from erosion.exercises.course import Course, Task, best_angle, end_of_cut, omega, volume
from erosion.impacts import alpha_max, impact
from erosion.models.rigid import StraightCut
from erosion.parameters import Parameters

_STRAIGHT = StraightCut()
_FRICTION = 0.3
_COPPER, _TITANIUM = 10e3, 136e3  # lbf/in², Table 2


def _x(p: Parameters) -> float:
    time, forward, down = 1 / omega(p), math.cos(float(p.alpha)), math.sin(float(p.alpha))
    return float(p.v0) * time * (forward - down / float(p.k) * (1 - math.sin(1)))


def _y(p: Parameters) -> float:
    return float(p.v0) * math.sin(float(p.alpha)) / omega(p) * math.sin(1)


def cusp(p: Parameters) -> float:
    """The angle from which on the tip can stop [rad]."""
    return math.atan(float(p.k) / 2)


def _steep_end(p: Parameters) -> float:
    return end_of_cut(_at(p, alpha=(cusp(p) + math.pi / 2) / 2))


def _at(p: Parameters, **changes: Any) -> Parameters:
    """The case with changes, without a warning where the grain's mass no longer fits its size."""
    return dataclasses.replace(p, **changes)


def _turning_best(p: Parameters, *, max_turn: str | None = "90deg") -> float:
    return float(alpha_max("rotating", p, max_turn=max_turn).alpha)


def _turns_too_far(p: Parameters, alpha: float) -> str:
    """What to say of an angle at which the grain turns by more than 90°; empty for any other."""
    if not 0 < alpha <= math.pi / 2:
        return ""
    turn = math.degrees(float(impact("rotating", _at(p, alpha=alpha)).turn))
    return f"This cut turns by {turn:.3g}°; count only cuts within 90°." if turn > 90 else ""


def _with_friction(p: Parameters) -> float:
    # F_x = -c d (1 + μ k) and F_y = -k c d are the forces of this σ and k.
    more = 1 + _FRICTION * float(p.k)
    return volume(_at(p, sigma=float(p.sigma) * more, k=float(p.k) / more))


_DIGITS = "Keep all digits of the angle."
_EVENT = "Solve for the event to five digits."
_ANGLES = "Take more angles near the best one."
_STEPS = "Take the integral to the end of the cut, in more steps."
_SOLVER = "Lower the tolerances and the greatest step of the solver, and end at the event."

SCENARIO = Course(
    text=Path(__file__).with_name("scenario.md"),
    tasks={
        "omega": Task("the angular frequency ω of the depth", "rate", 1e-4, 1, "Keep all digits of p.", omega),
        "depth": Task(
            "the depth y at the time 1/ω", "length", 1e-4, 1, "Keep all digits of p.",
            _y,
        ),
        "distance": Task(
            "the way x at the time 1/ω", "length", 1e-4, 2, "Keep all digits of p.",
            _x,
        ),
        "cusp": Task("the angle from which on the tip can stop", "angle", 1e-4, 2, _DIGITS, cusp),
        "t_c": Task("the time at which the cut ends", "time", 1e-4, 2, _EVENT, end_of_cut),
        "steep_t_c": Task(
            "the time at which the cut ends halfway between the cusp and 90°", "time", 1e-4, 2, _EVENT, _steep_end
        ),
        "volume": Task("the removed volume", "volume", 1e-3, 3, _STEPS, volume),
        "alpha_max": Task("the angle of greatest removal", "angle", 1e-3, 3, _ANGLES, best_angle),
        "volume_max": Task(
            "the greatest removed volume", "volume", 1e-3, 1, _STEPS, lambda p: volume(_at(p, alpha=best_angle(p)))
        ),
        "fast_alpha_max": Task(
            "the angle of greatest removal at twice the speed", "angle", 1e-3, 1, _ANGLES,
            lambda p: best_angle(_at(p, v0=2 * float(p.v0))),
        ),
        "speed_power": Task(
            "the power of the speed with which the greatest volume grows", "1", 1e-2, 2, _STEPS, lambda p: 2.0
        ),
        "heavy_alpha_max": Task(
            "the angle of greatest removal at twice the mass", "angle", 1e-3, 1, _ANGLES,
            lambda p: best_angle(_at(p, m=2 * float(p.m))),
        ),
        "mass_power": Task(
            "the power of the mass with which the greatest volume grows", "1", 1e-2, 1, _STEPS, lambda p: 1.0
        ),
        "titanium_alpha_max": Task(
            "the angle of greatest removal on titanium", "angle", 1e-3, 1, _ANGLES, best_angle
        ),
        "copper_over_titanium": Task(
            "the ratio of the greatest volume from copper to that from titanium", "1", 1e-3, 2, _STEPS,
            lambda p: _TITANIUM / _COPPER,
        ),
        "large_psi_alpha_max": Task("the angle of greatest removal at ψ = 4", "angle", 1e-3, 1, _ANGLES, best_angle),
        "half_k_alpha_max": Task(
            "the angle of greatest removal at half the k", "angle", 1e-3, 2, _ANGLES,
            lambda p: best_angle(_at(p, k=float(p.k) / 2)),
        ),
        "alpha_max_limit": Task(
            "the angle that the best one approaches as k grows", "angle", 1e-3, 1, "Take a greater k.",
            lambda p: math.pi / 4,
        ),
        "turning_volume": Task(
            "the volume that the turning grain removes", "volume", 1e-4, 4, _SOLVER,
            lambda p: float(impact("rotating", p).volume),
        ),
        "turning_alpha_max": Task(
            "the angle of greatest removal of the turning grain, where the model holds", "angle", 1e-3, 2, _ANGLES,
            _turning_best, _turns_too_far,
        ),
        "turning_half_k": Task(
            "the angle of greatest removal of the turning grain at half the k, where the model holds", "angle", 1e-3, 2,
            _ANGLES, lambda p: _turning_best(_at(p, k=float(p.k) / 2)),
            lambda p, alpha: _turns_too_far(_at(p, k=float(p.k) / 2), alpha),
        ),
        "any_turn_half_k": Task(
            "the angle of greatest removal of the turning grain at half the k, with any turn", "angle", 1e-3, 2,
            _ANGLES, lambda p: _turning_best(_at(p, k=float(p.k) / 2), max_turn=None),
        ),
        "tan_volume": Task(
            "the volume with k = tan α", "volume", 1e-3, 2, _STEPS, lambda p: float(_STRAIGHT.volume(p))
        ),
        "tan_limit": Task(
            "the volume that is approached with k = tan α", "volume", 1e-3, 2, "Go to smaller angles.",
            lambda p: float(p.volume_scale) / 2,
        ),
        "aligned_volume": Task(
            "the volume with a force against the velocity", "volume", 1e-3, 3, _SOLVER,
            lambda p: float(_STRAIGHT.volume(p)),
        ),
        "friction_volume": Task("the volume with friction", "volume", 1e-4, 3, "Is μ 0.3?", _with_friction),
    },
)  # fmt: skip
"""Questions 1 to 8 of the scenario, its three additional ones, and a force law."""
