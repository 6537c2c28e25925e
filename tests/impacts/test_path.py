"""One impact by the engine of the batches."""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.impacts import simulate as module
from erosion.impacts.simulate import SimulationError, path
from tests.reference import closed_form

P = erosion.TABLE_1
MODEL = erosion.load_model("linearized")
EXACT = closed_form("linearized")


def test_a_path_is_the_closed_form_from_contact_to_the_end() -> None:
    p = P.replace(phidot0=1000.0)
    cut = path(MODEL, p, points=7)
    end = float(EXACT.t_c(p))
    assert cut.t == pytest.approx(np.linspace(0, end, 7), rel=1e-11)
    assert (cut.t[-1], cut.removed[-1]) == (cut.t_c, cut.volume)
    assert (cut.ended_by, cut.depth[0]) == ("rebound", 0)
    assert cut.volume == pytest.approx(float(EXACT.volume(p)), rel=1e-11)
    assert cut.dvolume == pytest.approx(float(EXACT.dvolume(p)), rel=1e-10)
    between = end * np.array([0.77, 0.0, 1e-6, 1 - 1e-9, 0.11])
    exact, exact_between = EXACT.state(cut.t, p), EXACT.state(between, p)
    for name, values in vars(exact).items():
        # Against the greatest value: depth and speeds pass through zero.
        greatest = 1e-11 * np.abs(values).max()
        assert getattr(cut.states, name) == pytest.approx(np.asarray(values), rel=0, abs=greatest), name
        expected = np.asarray(getattr(exact_between, name))
        assert getattr(cut.at(between), name) == pytest.approx(expected, rel=0, abs=greatest), name
    # The volume removed so far is the kinetic energy along x that was lost, over the flow stress.
    lost = p.m / (2 * p.sigma * p.psi) * ((p.v0 * np.cos(p.alpha)) ** 2 - np.asarray(exact.vx) ** 2)
    assert cut.removed == pytest.approx(lost, rel=0, abs=1e-11 * cut.volume)
    assert cut.removal_rate == pytest.approx(p.b * cut.y * cut.vx, rel=1e-13)


def test_a_path_across_a_kink_has_its_derivative_near_a_right_angle() -> None:
    # A difference of volumes at 89.99°, over 2e-5 rad.
    model = erosion.load_model(Path(__file__).parents[2] / "models" / "opposing_tip.py")
    cut = path(model, P.replace(alpha=np.deg2rad(89.99)))
    assert cut.dvolume == pytest.approx(-1.3724186552e-4, rel=1e-9)


@pytest.mark.parametrize("points", [2, 3, 201])
def test_the_greatest_depth_needs_no_point_near_it(points: int) -> None:
    assert path(MODEL, P, points=points).max_depth == pytest.approx(path(MODEL, P).max_depth, rel=0.3)


def test_of_what_cuts_nothing_there_is_the_contact() -> None:
    nothing = path(MODEL, P.replace(alpha=np.pi / 2))
    assert (nothing.ended_by, nothing.volume, nothing.t_c) == ("no-cut", 0, 0)
    assert list(nothing.t) == [0]
    assert nothing.vx_tip == pytest.approx(0, abs=1e-12 * P.v0)


@pytest.mark.parametrize(
    ("code", "reason"), [(3, "the motion or the volume is not finite"), (4, "within 10,000 time scales")]
)
def test_what_does_not_end_is_an_error_with_its_reason(monkeypatch, code: int, reason: str) -> None:
    monkeypatch.setattr(module, "_end_and_states", lambda *_: ((code, 1.0, 1.0), None))
    with pytest.raises(SimulationError, match=f"^linearized: .*{reason}"):
        path(MODEL, P)
