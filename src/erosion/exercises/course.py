"""A course: the text of its notebook, and the tasks whose answers the key knows."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

from erosion.models.rigid import LinearizedCut
from erosion.parameters import Dimension, Parameters

LINEARIZED = LinearizedCut()


@dataclasses.dataclass(frozen=True)
class Task:
    """A number that a student computes.

    Args:
        asks: what it is, to follow "is".
        dimension: what it measures.
        tolerance: relative, within which an answer is right.
        points: for the right answer.
        hint: what to do where an answer is near, but not near enough.
        answer: the number for a case without spin, in SI, angles in radians.
        slip: what to say of a wrong number that comes from a mistake of this task; empty for any other.
    """

    asks: str
    dimension: Dimension
    tolerance: float
    points: int
    hint: str
    answer: Callable[[Parameters], float]
    slip: Callable[[Parameters, float], str] = lambda p, given: ""


@dataclasses.dataclass(frozen=True)
class Course:
    """The tasks of a notebook by name, and the file of its text."""

    tasks: Mapping[str, Task]
    text: Path


def omega(p: Parameters) -> float:
    """ω of the linearized model [1/s]."""
    return float(p.rate)


def end_of_cut(p: Parameters) -> float:
    """t_c of the linearized model [s]."""
    return float(LINEARIZED.t_c(p))


def volume(p: Parameters) -> float:
    """V of the linearized model [m³]."""
    return float(LINEARIZED.volume(p))


def best_angle(p: Parameters) -> float:
    """α_max of the linearized model [rad]."""
    return float(LINEARIZED.alpha_max(p))
