"""Velocities and spin after the impact: closed forms, momentum, energy, and an integration by scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import erosion
from erosion.cfd.exports import to_csv

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
ALPHA = np.deg2rad([5.0, 15.0, 25.0, 40.0, 55.0, 70.0, 85.0])
SPEEDS = [2200.0, 4400.0]


SPEED = np.array(SPEEDS)[:, None]


def rebounds(model, p=P):
    table = erosion.restitution(model, p, alpha=ALPHA, v0=SPEEDS)
    words = np.array(table.ended_by.attrs["flag_meanings"].split())[table.ended_by.values]
    return table, words


def test_a_body_that_does_not_turn_keeps_its_normal_speed_or_stops():
    table, words = rebounds("linearized", P.replace(phidot0=300.0))
    rebound = np.broadcast_to(np.tan(ALPHA) <= 1, (2, 7))
    np.testing.assert_array_equal(words, np.where(rebound, "rebound", "stop"))
    # tan α ≤ k/2 = 1 rebounds: ẏ = -ẏ(0), and k (ẋ - ẋ(0)) = -2 ẏ(0). A stop ends with the velocity of that moment:
    # cos ωt = 1 - k cot α, so that the tip rises below 2 = k cot α, and sinks above.
    cosine = np.where(rebound, -1.0, 1 - 2 / np.tan(ALPHA))
    expected = {
        "e_n": np.maximum(-cosine, 0.0),
        "e_t": np.where(rebound, 1 - np.tan(ALPHA), 0.0),
        "vy": SPEED * np.sin(ALPHA) * cosine,
        "spin": np.full((2, 7), 300.0),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-9, atol=1e-10 * max(1.0, np.abs(values).max()))


@pytest.mark.parametrize("model", ["finnie", "rotating", "rotating-deformation"])
def test_momentum_is_balanced(model):
    table, _ = rebounds(model, P.replace(phidot0=2e3))
    lost = table.vx.values - SPEED * np.cos(ALPHA)
    # Constant K: ẏ - ẏ(0) = K (ẋ - ẋ(0)); torque r F_x: φ̇ - φ̇0 = (ẋ - ẋ(0))/(β r).
    assert table.vy.values == pytest.approx(SPEED * np.sin(ALPHA) + 2.0 * lost, abs=1e-9 * 4400)
    assert table.spin.values == pytest.approx(2e3 + lost / (0.5 * 0.04), rel=1e-9)


@pytest.mark.parametrize("model", ["linearized", "rotating-full-torque"])
def test_the_energy_that_is_lost_is_the_work_of_cutting(model):
    table, words = rebounds(model)
    turning = float(P.moment_of_inertia) * table.spin.values**2 / 2
    lost = float(P.m) * (SPEED**2 - table.vx.values**2 - table.vy.values**2) / 2 - turning
    assert (lost >= 0).all()
    volume, rebound = erosion.impact(model, P.replace(alpha=ALPHA, v0=SPEED)).volume, words == "rebound"
    assert rebound.sum() >= 4
    assert volume[rebound] == pytest.approx(lost[rebound] / float(P.sigma * P.psi), rel=1e-8)


def integrated(alpha: float, v0: float, p) -> tuple[np.ndarray, str]:
    """The end of `rotating-full-torque` by scipy: (ẋ, ẏ, φ̇), and which event."""
    k, r, m = float(p.k), float(p.r), float(p.m)
    c, inertia = float(p.sigma * p.b * p.psi), float(p.inertia) * m * r**2

    def depth(t, s):
        return s[1] - r * (1 - np.sin(s[2]))

    def along(t, s):
        return s[3] + r * np.sin(s[2]) * s[5]

    def rate(t, s):
        fx = -c * depth(t, s)
        return [*s[3:], fx / m, k * fx / m, r * (np.sin(s[2]) * fx + np.cos(s[2]) * k * fx) / inertia]

    for event in (depth, along):
        event.__dict__.update(terminal=True, direction=-1)
    start = [0.0, 0.0, np.pi / 2, v0 * np.cos(alpha), v0 * np.sin(alpha), float(p.phidot0)]
    ended = solve_ivp(rate, (0, 1e-2), start, "DOP853", events=(depth, along), rtol=1e-12, atol=1e-14, max_step=1e-7)
    which = int(ended.t_events[1].size > 0)
    return ended.y_events[which][0][3:], ("rebound", "stop")[which]


@pytest.mark.parametrize(("angle", "ended_by"), [(12.0, "rebound"), (50.0, "stop")])
def test_an_independent_integration_ends_with_the_same_velocities(angle, ended_by):
    p, alpha = P.replace(phidot0=-1500.0, inertia=0.4), np.deg2rad(angle)
    row = erosion.restitution("rotating-full-torque", p, alpha=[alpha], v0=[4400.0]).isel(v0=0, alpha=0)
    (vx, vy, spin), end = integrated(alpha, 4400.0, p)
    assert row.ended_by.attrs["flag_meanings"].split()[int(row.ended_by)] == end == ended_by
    ratios = vx / (4400.0 * np.cos(alpha)), max(0.0, -vy / (4400.0 * np.sin(alpha)))
    given = [float(row[name]) for name in ("vx", "vy", "spin", "e_t", "e_n")]
    assert given == pytest.approx([vx, vy, spin, *ratios], rel=1e-8)


def test_what_cuts_nothing_has_no_rebound():
    table = erosion.restitution("linearized", P, alpha=[0.5, np.pi / 2])
    assert table.e_n.isnull().values.tolist() == [[False, True]] * 7
    assert "no-cut" in to_csv(table)
    # A spinning tip cuts at 90°: there is a spin after it, but no tangential velocity before.
    upright = erosion.restitution("rotating", P.replace(phidot0=2e4), alpha=[np.pi / 2])
    assert upright.e_t.isnull().all()
    assert upright.spin.notnull().all()
    assert upright.vx.notnull().all()


def test_units_are_those_of_the_case():
    here, there = (erosion.restitution("rotating", p, alpha=ALPHA, v0=[p.v0]) for p in (P, P.to("si")))
    assert there.e_n.values == pytest.approx(here.e_n.values, rel=1e-9)
    assert there.vx.values == pytest.approx(here.vx.values * 0.0254, rel=1e-9)
    assert (here.vx.attrs["units"], there.vx.attrs["units"]) == ("in/s", "m/s")


def test_a_correlation_says_nothing_of_rebounds():
    with pytest.raises(erosion.ExportError, match="dnv has no motion of a rigid body"):
        erosion.restitution("dnv", P)
