"""One impact by the engine of the batches; its motion itself is tested beside `states_at`."""

import numpy as np
import pytest

import erosion
from erosion.impacts import simulate as module
from erosion.impacts.impact import States, states_at
from erosion.impacts.simulate import SimulationError, path
from tests.reference import closed_form

P = erosion.TABLE_1
MODEL = erosion.load_model("linearized")
EXACT = closed_form("linearized")


def test_a_path_is_the_closed_form_from_contact_to_the_end() -> None:
    cut = path(MODEL, P, points=7)
    assert cut.t == pytest.approx(np.linspace(0, float(EXACT.t_c(P)), 7), rel=1e-11)
    assert (cut.t[-1], cut.removed[-1]) == (cut.t_c, cut.volume)
    assert (cut.ended_by, cut.depth[0]) == ("rebound", 0)
    assert cut.depth[-1] == pytest.approx(0, abs=1e-11 * cut.depth.max())
    assert cut.volume == pytest.approx(float(EXACT.volume(P)), rel=1e-11)
    assert cut.dvolume == pytest.approx(float(EXACT.dvolume(P)), rel=1e-10)
    between = cut.t_c * np.array([0.11, 0.77])
    assert cut.at(between).vx == pytest.approx(np.asarray(EXACT.state(between, P).vx), rel=1e-11)


def test_of_what_cuts_nothing_there_is_the_contact() -> None:
    nothing = path(MODEL, P.replace(alpha=np.pi / 2))
    assert (nothing.ended_by, nothing.volume, nothing.t_c) == ("no-cut", 0, 0)
    assert list(nothing.t) == [0]
    assert nothing.vx_tip == pytest.approx(0, abs=1e-12 * P.v0)


@pytest.mark.parametrize(
    ("code", "reason"), [(3, "the motion or the volume is not finite"), (4, "within 10,000 time scales")]
)
def test_what_does_not_end_is_an_error_with_its_reason(monkeypatch, code: int, reason: str) -> None:
    def spoilt(*arguments) -> States:
        return states_at(*arguments)._replace(outcome=np.array([code], np.int8))

    monkeypatch.setattr(module, "states_at", spoilt)
    with pytest.raises(SimulationError, match=f"^linearized: .*{reason}"):
        path(MODEL, P)
