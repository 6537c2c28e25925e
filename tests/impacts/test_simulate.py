import copy
import itertools
import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import erosion
from erosion.impacts.simulate import SimulationError, TurnWarning, path
from tests.reference import AS_PRINTED, AT_20_DEGREES, CLOSED, closed_form

pytestmark = pytest.mark.slow

P = erosion.TABLE_1
ROTATING = [name for name in AT_20_DEGREES if name.startswith("rotating")]


def quietly(model, p, **options):
    """Simulate without the warning that a body turned far."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TurnWarning)
        return erosion.simulate(model, p, **options)


@pytest.mark.parametrize("name", AT_20_DEGREES)
def test_golden_numbers(name):
    figure = AT_20_DEGREES[name]
    cut = quietly(name, P)
    assert cut.ended_by == figure.ended_by
    assert cut.volume == pytest.approx(figure.volume, rel=1e-11, abs=0)  # printed to 13 digits
    assert cut.t_c == pytest.approx(figure.t_c, rel=1e-10, abs=0)


def test_as_printed_is_the_literal_reading():
    cut = quietly("as-printed", P)
    volume, t_c, ended_by = AS_PRINTED
    assert cut.ended_by == ended_by
    assert cut.volume == pytest.approx(volume, rel=2e-11, abs=0)
    assert cut.t_c == pytest.approx(t_c, rel=1e-9, abs=0)


@pytest.mark.parametrize("name", CLOSED)
@pytest.mark.parametrize("degrees", [0.01, 5, 20, 45, 63, 89, 89.99])
def test_motion_equals_the_closed_form(name, degrees):
    p = P.replace(alpha=np.deg2rad(degrees), phidot0=3000.0)
    cut, exact = quietly(name, p), closed_form(name)
    assert cut.ended_by == str(exact.ended_by(p))
    assert cut.t_c == pytest.approx(float(exact.t_c(p)), rel=1e-12, abs=0)
    assert cut.volume == pytest.approx(float(exact.volume(p)), rel=1e-11, abs=0)
    state = exact.state(cut.t, p)
    for field in ("x", "y", "vx", "vy", "phi", "omega"):
        found, true = getattr(cut, field), np.asarray(getattr(state, field))
        # Against the largest value: positions and speeds pass through zero.
        assert np.abs(found - true).max() <= 1e-11 * np.abs(true).max(), field


@pytest.mark.parametrize(("name", "ratio"), [("linearized", 2.0), ("finnie", 2 / 3)])
def test_no_wrong_end_near_the_cusp(name, ratio):
    cusp = np.arctan(ratio / 2)
    exact = closed_form(name)
    aside = np.geomspace(1e-4, 2, 10)  # the tie itself has no right answer
    for offset in (*aside, *-aside):
        p = P.replace(alpha=cusp + np.deg2rad(offset))
        cut = quietly(name, p, points=2)
        assert cut.ended_by == str(exact.ended_by(p)), offset
        assert cut.t_c == pytest.approx(float(exact.t_c(p)), rel=1e-9, abs=0), offset  # its slope diverges at the cusp


@pytest.mark.parametrize(("name", "s"), [*zip(ROTATING, itertools.cycle([-0.5, 0.0, 0.5]))])
def test_against_scipy(name, s):
    p = P.replace(phidot0=s * P.v0 / P.r, alpha=0.6)
    cut = quietly(name, p)
    volume, t_c = scipy_cut(name, p)
    # DOP853 at 1e-12 with its steps bounded; its event is on an interpolant of 7th order.
    assert cut.volume == pytest.approx(volume, rel=1e-9, abs=0)
    assert cut.t_c == pytest.approx(t_c, rel=1e-9, abs=0)


def scipy_cut(name, p):
    """The same cut by scipy, from the equations as written, sharing no code with the models."""
    k, r, b, m = (float(getattr(p, f)) for f in ("k", "r", "b", "m"))
    c = float(p.sigma * p.b * p.psi)
    inertia, v0, alpha = float(p.inertia) * m * r**2, float(p.v0), float(p.alpha)
    full, tan, aligned = "full-torque" in name, "tan-alpha" in name, "velocity-aligned" in name

    def rate(t, u):
        _, y, phi, vx, vy, omega, _ = u
        depth = y - r * (1 - np.sin(phi))
        ratio = np.tan(alpha) if tan else vy / vx if aligned and vx > 1e-9 * v0 else np.tan(alpha) if aligned else k
        fx = -c * depth
        torque = r * (np.sin(phi) * fx + np.cos(phi) * ratio * fx) if full else r * fx
        return [vx, vy, omega, fx / m, ratio * fx / m, torque / inertia, b * depth * (vx + r * np.sin(phi) * omega)]

    def rebound(t, u):
        return u[1] - r * (1 - np.sin(u[2])) if t > 0 else 1.0

    def stop(t, u):
        return u[3] + r * np.sin(u[2]) * u[5]

    for event in (rebound, stop):
        setattr(event, "terminal", True)  # noqa: B010  (scipy reads attributes of the function)
        setattr(event, "direction", -1)  # noqa: B010
    start = [0, 0, np.pi / 2, v0 * np.cos(alpha), v0 * np.sin(alpha), float(p.phidot0), 0]
    scale = np.sqrt(m / (k * c))
    found = solve_ivp(rate, (0, 50 * scale), start, "DOP853", rtol=1e-12, atol=1e-18, events=(rebound, stop),
                      max_step=scale / 100)  # fmt: skip
    return found.y[-1, -1], found.t[-1]


@pytest.mark.parametrize("name", ["linearized", "tan-alpha", "velocity-aligned"])
def test_volume_is_the_kinetic_energy_along_x(name):
    cut = quietly(name, P)
    energy = P.m / (2 * P.sigma * P.psi) * (cut.vx[0] ** 2 - cut.vx[-1] ** 2)
    assert cut.volume == pytest.approx(float(energy), rel=1e-12, abs=0)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.9, 1.3])
@pytest.mark.parametrize("s", [-0.4, 0.0, 0.6])
def test_energy_balance_with_full_torque(alpha, s):
    p = P.replace(alpha=alpha, phidot0=s * P.v0 / P.r)
    cut = quietly("rotating-full-torque", p)

    def kinetic(i):
        return (p.m * (cut.vx[i] ** 2 + cut.vy[i] ** 2) + p.moment_of_inertia * cut.omega[i] ** 2) / 2

    balance = (kinetic(0) - kinetic(-1)) / (p.sigma * p.psi) - p.k * p.b / 2 * cut.depth[-1] ** 2
    assert cut.volume == pytest.approx(float(balance), rel=1e-10, abs=0)


@pytest.mark.parametrize("name", ["rotating", "finnie"])
def test_linear_invariants(name):
    cut = quietly(name, P.replace(phidot0=2000.0))
    gained = cut.vx - cut.vx[0]
    assert cut.vy - cut.vy[0] == pytest.approx(2.0 * gained, abs=1e-12 * P.v0)  # dense output is linear in the stages
    assert cut.omega - cut.omega[0] == pytest.approx(gained / (0.5 * 0.04), abs=1e-11 * P.v0 / P.r)


@pytest.mark.parametrize("name", ["velocity-aligned", "rotating-velocity-aligned"])
def test_the_direction_of_motion_never_changes(name):
    cut = quietly(name, P.replace(alpha=0.7))
    assert np.abs(cut.vy - np.tan(0.7) * cut.vx).max() <= 1e-12 * P.v0


def test_tip_and_histories_are_consistent():
    cut = quietly("rotating", P, points=401)
    assert cut.depth[0] == 0
    assert cut.depth[-1] == pytest.approx(0, abs=1e-13 * P.r)
    assert np.all(cut.depth[1:-1] > 0)
    slope = np.gradient(cut.x_tip, cut.t)[1:-1]
    assert slope == pytest.approx(cut.vx_tip[1:-1], rel=1e-3, abs=0)  # second differences of 400 points
    area = np.trapezoid(cut.depth, cut.x_tip) * P.b
    assert area == pytest.approx(cut.volume, rel=1e-5, abs=0)
    assert cut.max_depth == pytest.approx(cut.depth.max(), rel=1e-5, abs=0)
    assert cut.max_depth >= cut.depth.max()


def test_at_gives_the_motion_at_any_time():
    cut, exact = quietly("linearized", P), closed_form("linearized")
    times = np.linspace(0, cut.t_c, 37)
    assert np.abs(cut.at(times).x - exact.state(times, P).x).max() < 1e-12 * cut.x[-1]
    assert cut.at(cut.t_c / 3).y == pytest.approx(float(exact.state(cut.t_c / 3, P).y), rel=1e-11, abs=0)
    with pytest.raises(ValueError, match="must be in"):
        cut.at(1.01 * cut.t_c)


def test_nothing_is_cut_at_normal_impact_or_backward_spin():
    for p in (P.replace(alpha=np.pi / 2), P.replace(alpha=1.2, phidot0=-0.9 * P.v0 / P.r)):
        cut = quietly("rotating", p)
        assert (cut.ended_by, cut.volume, cut.t_c) == ("no-cut", 0.0, 0.0)
        assert cut.at(0.0).vx == cut.vx[0]


def test_a_tip_that_leaves_and_returns_within_a_step_is_seen():
    # Spin lifts the tip at once: depth ≈ v₀ sin α t - r φ̇₀² t²/2, back at t = 2 v₀ sin α/(r φ̇₀²).
    p = P.replace(alpha=1e-5, phidot0=0.9 * P.v0 / P.r)
    cut = quietly("rotating", p)
    assert cut.ended_by == "rebound"
    assert cut.t_c == pytest.approx(2 * float(p.v0) * 1e-5 / (0.04 * float(p.phidot0) ** 2), rel=1e-3, abs=0)


@pytest.mark.parametrize("alpha", [1e-6, 1e-5, 1e-3])
def test_grazing_impacts_with_spin_keep_their_digits(alpha):
    # To first order the force does not matter: depth = v₀ sin α t - r (1 - cos φ̇₀t).
    p = P.replace(alpha=alpha, phidot0=0.5 * P.v0 / P.r)
    v0, r, spin = float(p.v0), float(p.r), float(p.phidot0)
    guess = 2 * v0 * alpha / (r * spin**2)
    free = guess
    for _ in range(20):  # Newton's method
        depth = v0 * np.sin(alpha) * free - 2 * r * np.sin(spin * free / 2) ** 2
        free -= depth / (v0 * np.sin(alpha) - r * spin * np.sin(spin * free))
    cut = quietly("rotating", p)
    # The force moves the end by (ωt)² or less.
    assert cut.t_c == pytest.approx(free, rel=max(1e-9, (float(p.rate) * free) ** 2))
    assert erosion.impact("rotating", p, rtol=1e-12).t_c == pytest.approx(cut.t_c, rel=1e-9, abs=0)


def test_a_graze_that_step_ends_cannot_see():
    # tests/golden-numbers.md: the jump of the rotating model at k = 1.
    p = P.replace(k=1.0)
    jump = np.deg2rad(39.99624582)
    below, above = (quietly("rotating", p.replace(alpha=jump + d)) for d in (-1e-6, 1e-6))
    assert below.volume == pytest.approx(1.77719894e-4, rel=1e-4, abs=0)
    assert above.volume == pytest.approx(7.14990785e-5, rel=1e-2, abs=0)  # its slope diverges at the jump


def test_a_far_turn_is_said_in_plain_words():
    with pytest.warns(TurnWarning, match=r"turned by 155\.\d° during the cut, more than 90°"):
        cut = erosion.simulate("rotating-tan-alpha", P)
    assert len(cut.warnings) == 1
    assert not quietly("rotating", P).warnings


def test_other_solvers_and_controllers_agree():
    import diffrax

    cut = quietly("rotating", P, solver=diffrax.Tsit5(),
                  stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-14))  # fmt: skip
    assert cut.volume == pytest.approx(AT_20_DEGREES["rotating"].volume, rel=1e-7, abs=0)


def test_an_endless_cut_is_an_error():
    class Endless(erosion.models.RigidErodent):
        """Nothing resists, so the tip goes down for ever."""

        kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
        force: erosion.models.ForceLaw = erosion.models.ConstantRatio()
        torque: erosion.models.Torque = erosion.models.NoTorque()

        def events(self, state, p):
            return {"never": 1.0 + 0 * state.x}

    with pytest.raises(SimulationError, match="no event ended the cut"):
        quietly(Endless(), P)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"alpha": 1.7}, r"`alpha` must be in \(0, 90°\], but is 97.4028°\."),
        ({"alpha": [0.1, 0.2]}, "`alpha` must be a scalar here"),
        ({"m": -1.0}, "`m` must be positive and finite, but is -1"),
        ({"v0": np.nan}, "`v0` must be positive and finite, but is nan"),
    ],
)
def test_bad_parameters_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        erosion.simulate("linearized", P.replace(**changes))


def test_numbers_far_from_one_are_as_good():
    # Softer by 10³⁰⁰: times grow by its root, volumes as it.
    cut, soft = quietly("linearized", P), quietly("linearized", P.replace(sigma=P.sigma * 1e-300))
    assert soft.t_c == pytest.approx(cut.t_c * 1e150, rel=1e-9, abs=0)
    assert soft.volume == pytest.approx(cut.volume * 1e300, rel=1e-9, abs=0)
    assert soft.max_depth == pytest.approx(cut.max_depth * 1e150, rel=1e-9, abs=0)


def test_results_print_with_units():
    assert repr(quietly("linearized", P)).startswith("Trajectory('linearized', 201 points, t_c=6.6353")
    cut = quietly("linearized", P)
    assert "in³" in str(cut)
    assert "1.81644" in str(cut)
    assert "<td>10⁻⁴ in³</td>" in cut._repr_html_()


def test_shapes_broadcast_by_name_alone():
    with jax.numpy_rank_promotion("raise"):
        assert erosion.simulate("rotating", erosion.TABLE_1).volume == pytest.approx(
            1.0140853874622e-4, rel=1e-9, abs=0
        )


@pytest.mark.parametrize("copied", [lambda cut: pickle.loads(pickle.dumps(cut)), copy.deepcopy])
@pytest.mark.parametrize("follow", [quietly, path])
def test_a_copied_or_pickled_trajectory_tells_the_same(follow, copied):
    for alpha in (0.3, np.pi / 2):  # at 90° the printed moment lets nothing be cut
        cut = follow(erosion.load_model("linearized"), P.replace(alpha=alpha))
        read = copied(cut)
        times = cut.t_c * np.array([0.1, 0.77, 1.0])
        np.testing.assert_array_equal(read.at(times).y, cut.at(times).y)
        assert read.to_dict() == cut.to_dict()
        np.testing.assert_array_equal(read.removed, cut.removed)


class Factor(erosion.models.ForceLaw):
    """A force ratio that a function gives, which need not have a hash."""

    function: Any

    def __call__(self, state, tip, p):
        force = -p.stiffness * tip.depth
        return force, jnp.polyval(self.function.coeffs, p.k) * force

    def typical_ratio(self, p):
        return p.k


def test_a_function_without_a_hash_is_part_of_a_model():
    twice = np.poly1d([2.0, 0.0])
    model = erosion.models.Rotating(force=Factor(twice))
    for factor in (2.0, 3.0):
        twice.coeffs[0] = factor  # as the code is now
        expected = erosion.impact("rotating", P.replace(k=factor * P.k), rtol=1e-12).volume
        assert quietly(model, P).volume == pytest.approx(expected, rel=1e-11, abs=0)
        assert erosion.impact(model, P).volume == pytest.approx(expected, rel=1e-9, abs=0)
