"""Newton's method for the angle of greatest removal."""

import numpy as np
import pytest

from erosion.impacts.simulate import SimulationError
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1, Parameters
from erosion.report.questions.linearized import Jet, greatest

CLOSED = LinearizedCut()


def closed_jet(p: Parameters) -> Jet:
    def jet(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        q = p.replace(alpha=angles)
        return np.asarray(CLOSED.volume(q)), np.asarray(CLOSED.dvolume(q)), np.asarray(CLOSED.d2volume(q))

    return jet


@pytest.mark.parametrize("k", [1e-4, 0.01, 0.1, 0.5, 1.0, 2.0, 10.0, 1e3, 1e6])
def test_newton_finds_the_greatest_volume_for_any_k(k: float) -> None:
    steps = greatest(closed_jet(TABLE_1.replace(k=k)))
    assert steps[-1].alpha == pytest.approx(np.arctan(k) / 2, abs=1e-11)
    assert len(steps) < 30
    assert steps[-1].kind == "Newton"


def test_newton_refuses_what_it_cannot_answer() -> None:
    def falling(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.cos(angles), -np.sin(angles) - 0.1, -np.cos(angles)

    def failing(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.where(angles > 0.7, np.nan, angles), angles, angles

    with pytest.raises(SimulationError, match="vanishes"):
        greatest(falling)
    with pytest.raises(SimulationError, match=r"α = 45°|could not be computed"):
        greatest(failing)
