"""One impact by the engine of the batches.

The whole state at the end of a cut, and a model's cut as a problem of `erosion.ode`.
"""

import copy
import itertools
import pickle
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import erosion
from erosion import CuttingModel, Tip, ode
from erosion.impacts.trajectory import SimulationError, TurnWarning, path, path as follow
from erosion.plotting.motion import plot_trajectory
from tests.reference import AS_PRINTED, AT_20_DEGREES, CLOSED, closed_form

P = erosion.TABLE_1.to("si")
ROTATING = [name for name in AT_20_DEGREES if name.startswith("rotating")]


INCH3 = 0.0254**3  # m³; the golden numbers are in inches

pytestmark = pytest.mark.filterwarnings("ignore::erosion.impacts.trajectory.TurnWarning")


@pytest.mark.parametrize("name", AT_20_DEGREES)
def test_golden_numbers(name):
    figure = AT_20_DEGREES[name]
    cut = erosion.simulate(name, P)
    assert cut.ended_by == figure.ended_by
    assert cut.volume == pytest.approx(figure.volume * INCH3, rel=1e-11, abs=0)  # printed to 13 digits
    assert cut.t_c == pytest.approx(figure.t_c, rel=1e-10, abs=0)


def test_as_printed_is_the_literal_reading():
    cut = erosion.simulate("as-printed", P)
    volume, t_c, ended_by = AS_PRINTED
    assert cut.ended_by == ended_by
    assert cut.volume == pytest.approx(volume * INCH3, rel=2e-11, abs=0)
    assert cut.t_c == pytest.approx(t_c, rel=1e-9, abs=0)


@pytest.mark.parametrize("name", CLOSED)
# Not 45°, where tan α = k/2: both ends of the linearized cut are at one time there, and rounding chooses.
@pytest.mark.parametrize("degrees", [0.01, 5, 20, 44, 63, 89, 89.99])
def test_motion_equals_the_closed_form(name, degrees):
    p = P.replace(alpha=np.deg2rad(degrees), phidot0=3000.0)
    cut, exact = erosion.simulate(name, p), closed_form(name)
    assert cut.ended_by == str(exact.ended_by(p))
    assert cut.t_c == pytest.approx(float(exact.t_c(p)), rel=1e-12, abs=0)
    assert cut.volume == pytest.approx(float(exact.volume(p)), rel=1e-11, abs=0)
    state = exact.state(cut.t, p)
    for field in ("x", "y", "vx", "vy", "phi", "omega"):
        found, true = getattr(cut, field), np.asarray(getattr(state, field))
        # Against the largest value: positions and speeds pass through zero.
        assert np.abs(found - true).max() <= 1e-11 * np.abs(true).max(), field


@pytest.mark.parametrize(("name", "s"), [*zip(ROTATING, itertools.cycle([-0.5, 0.0, 0.5]))])
def test_against_scipy(name, s):
    p = P.replace(phidot0=s * P.v0 / P.r, alpha=0.6)
    cut = erosion.simulate(name, p)
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
    cut = erosion.simulate(name, P)
    energy = P.m / (2 * P.sigma * P.psi) * (cut.vx[0] ** 2 - cut.vx[-1] ** 2)
    assert cut.volume == pytest.approx(float(energy), rel=1e-12, abs=0)


@pytest.mark.parametrize("alpha", [0.2, 0.5, 0.9, 1.3])
@pytest.mark.parametrize("s", [-0.4, 0.0, 0.6])
def test_energy_balance_with_full_torque(alpha, s):
    p = P.replace(alpha=alpha, phidot0=s * P.v0 / P.r)
    cut = erosion.simulate("rotating-full-torque", p)

    def kinetic(i):
        return (p.m * (cut.vx[i] ** 2 + cut.vy[i] ** 2) + p.moment_of_inertia * cut.omega[i] ** 2) / 2

    balance = (kinetic(0) - kinetic(-1)) / (p.sigma * p.psi) - p.k * p.b / 2 * cut.depth[-1] ** 2
    assert cut.volume == pytest.approx(float(balance), rel=1e-10, abs=0)


@pytest.mark.parametrize("name", ["velocity-aligned", "rotating-velocity-aligned"])
def test_the_direction_of_motion_never_changes(name):
    cut = erosion.simulate(name, P.replace(alpha=0.7))
    assert np.abs(cut.vy - np.tan(0.7) * cut.vx).max() <= 1e-12 * P.v0


def test_tip_and_histories_are_consistent():
    cut = erosion.simulate("rotating", P, points=401)
    assert cut.depth[0] == 0
    assert cut.depth[-1] == pytest.approx(0, abs=1e-13 * P.r)
    assert np.all(cut.depth[1:-1] > 0)
    slope = np.gradient(cut.x_tip, cut.t)[1:-1]
    assert slope == pytest.approx(cut.vx_tip[1:-1], rel=1e-3, abs=0)  # second differences of 400 points
    area = np.trapezoid(cut.depth, cut.x_tip) * P.b
    assert area == pytest.approx(cut.volume, rel=1e-5, abs=0)
    assert cut.max_depth == pytest.approx(cut.depth.max(), rel=1e-5, abs=0)
    assert cut.max_depth >= cut.depth.max()


def test_nothing_is_cut_at_normal_impact_or_backward_spin():
    for p in (P.replace(alpha=np.pi / 2), P.replace(alpha=1.2, phidot0=-0.9 * P.v0 / P.r)):
        cut = erosion.simulate("rotating", p)
        assert (cut.ended_by, cut.volume, cut.t_c) == ("no-cut", 0.0, 0.0)
        assert cut.at(0.0).vx == cut.vx[0]


def test_a_tip_that_leaves_and_returns_within_a_step_is_seen():
    # Spin lifts the tip at once: depth ≈ v₀ sin α t - r φ̇₀² t²/2, back at t = 2 v₀ sin α/(r φ̇₀²).
    p = P.replace(alpha=1e-5, phidot0=0.9 * P.v0 / P.r)
    cut = erosion.simulate("rotating", p)
    assert cut.ended_by == "rebound"
    assert cut.t_c == pytest.approx(2 * float(p.v0) * 1e-5 / (float(p.r) * float(p.phidot0) ** 2), rel=1e-3, abs=0)


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
    cut = erosion.simulate("rotating", p)
    # The force moves the end by (ωt)² or less.
    assert cut.t_c == pytest.approx(free, rel=max(1e-9, (float(p.rate) * free) ** 2))
    assert erosion.impact("rotating", p, rtol=1e-12).t_c == pytest.approx(cut.t_c, rel=1e-9, abs=0)


def test_a_graze_that_step_ends_cannot_see():
    # tests/golden-numbers.md: the jump of the rotating model at k = 1.
    p = P.replace(k=1.0)
    jump = np.deg2rad(39.99624582)
    below, above = (erosion.simulate("rotating", p.replace(alpha=jump + d)) for d in (-1e-6, 1e-6))
    assert below.volume == pytest.approx(1.77719894e-4 * 0.0254**3, rel=1e-4, abs=0)
    assert above.volume == pytest.approx(7.14990785e-5 * 0.0254**3, rel=1e-2, abs=0)  # its slope diverges at the jump


def test_a_far_turn_is_said_in_plain_words():
    with pytest.warns(TurnWarning, match=r"155\.\d°"):
        cut = erosion.simulate("rotating-tan-alpha", P)
    assert len(cut.warnings) == 1
    assert not erosion.simulate("rotating", P).warnings


def test_other_solvers_and_controllers_agree():
    import diffrax

    cut = erosion.simulate("rotating", P, solver=diffrax.Tsit5(),
                  stepsize_controller=diffrax.PIDController(rtol=1e-10, atol=1e-14))  # fmt: skip
    assert cut.volume == pytest.approx(AT_20_DEGREES["rotating"].volume * INCH3, rel=1e-7, abs=0)


def test_an_endless_cut_is_an_error():
    class Endless(erosion.models.RigidParticle):
        """Nothing resists, so the tip goes down for ever."""

        kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
        force: erosion.models.ForceLaw = erosion.models.ConstantRatio()
        torque: erosion.models.Torque = erosion.models.NoTorque()

        def events(self, state, p):
            return {"never": 1.0 + 0 * state.x}

    with pytest.raises(SimulationError, match="no event ended the cut"):
        erosion.simulate(Endless(), P)


def test_a_force_that_pushes_forward_is_named():
    class Pushes(erosion.models.ConstantRatio):
        """The force of the metal with the wrong sign."""

        def __call__(self, state, tip, p):
            return p.stiffness * tip.depth, p.k * p.stiffness * tip.depth

    class Pushed(erosion.models.RigidParticle):
        kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
        force: erosion.models.ForceLaw = Pushes()
        torque: erosion.models.Torque = erosion.models.NoTorque()

    for follow_to_the_end in (erosion.simulate, path):
        with pytest.raises(SimulationError, match="F_x is positive"):
            follow_to_the_end(Pushed(), P)


def test_numbers_far_from_one_are_as_good():
    # Softer by 10³⁰⁰: times grow by its root, volumes as it.
    cut, soft = erosion.simulate("linearized", P), erosion.simulate("linearized", P.replace(sigma=P.sigma * 1e-300))
    assert soft.t_c == pytest.approx(cut.t_c * 1e150, rel=1e-9, abs=0)
    assert soft.volume == pytest.approx(cut.volume * 1e300, rel=1e-9, abs=0)
    assert soft.max_depth == pytest.approx(cut.max_depth * 1e150, rel=1e-9, abs=0)


@pytest.mark.parametrize("copied", [lambda cut: pickle.loads(pickle.dumps(cut)), copy.deepcopy])
@pytest.mark.parametrize("follow", [erosion.simulate, path])
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
        assert erosion.simulate(model, P).volume == pytest.approx(expected, rel=1e-11, abs=0)
        assert erosion.impact(model, P).volume == pytest.approx(expected, rel=1e-9, abs=0)


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
    assert cut.dvolume == pytest.approx(-1.3724186552e-4 * INCH3, rel=1e-9)


ALPHAS = np.linspace(0.05, 1.5, 7)
SQUARE = erosion.TABLE_1.replace(k=1.0, alpha=ALPHAS)
SPUN = SQUARE.replace(phidot0=np.array([0.0, 500.0, -500.0, 0.0, 2000.0, 0.0, 50.0]))


def test_the_state_is_that_of_the_independent_engine() -> None:
    model = erosion.load_model("rotating")
    hit = erosion.impact(model, SPUN)
    for i in range(0, ALPHAS.size, 3):
        one = erosion.TABLE_1.replace(k=1.0, alpha=ALPHAS[i], phidot0=SPUN.phidot0[i])
        path = erosion.simulate(model, one)
        for found, expected in zip(jax.tree.leaves(hit.state), jax.tree.leaves(path.states), strict=True):
            assert found[i] == pytest.approx(float(expected[-1]), rel=1e-8, abs=1e-11 * np.max(np.abs(expected)))


def test_the_state_moves_with_the_parameters() -> None:
    model = erosion.load_model("rotating")
    hit = erosion.impact(model, SPUN, wrt=("alpha", "k"), derivatives=2)
    assert hit.end.integrals["volume"] == pytest.approx(hit.volume, rel=1e-9)
    assert hit.end.along("alpha", "k").integrals["volume"] == pytest.approx(hit.d2volume[:, 0, 1], rel=1e-6)
    h = 1e-5
    up, down = (erosion.impact(model, SPUN.replace(alpha=ALPHAS + s * h), wrt="k", derivatives=1).end for s in (1, -1))
    for name in ("vx", "vy", "omega", "phi", "x"):
        first, mixed = hit.end.along("alpha").y, hit.end.along("alpha", "k").y
        slope = (getattr(up.y, name) - getattr(down.y, name)) / (2 * h)
        assert getattr(first, name) == pytest.approx(slope, rel=1e-5)
        of_k = (getattr(up.along("k").y, name) - getattr(down.along("k").y, name)) / (2 * h)
        assert np.allclose(getattr(mixed, name), of_k, rtol=1e-4, atol=1e-4 * np.max(np.abs(of_k)))


class Melting(CuttingModel):
    """Straight, with a heat of its own: two further states, one of them in a dictionary of arrays' names."""

    def initial_state(self, p):
        return {"x": 0.0, "y": 0.0, "vx": p.v0 * jnp.cos(p.alpha), "vy": p.v0 * jnp.sin(p.alpha), "heat": 0.0}

    def derivative(self, state, p):
        force = -p.stiffness * state["y"]
        power = -force * state["vx"]
        return {"x": state["vx"], "y": state["vy"], "vx": force / p.m, "vy": p.k * force / p.m, "heat": power}

    def tip(self, state, p):
        return Tip(state["x"], state["y"], state["vx"], state["vy"])


def test_a_state_of_a_model_s_own_is_shown_and_drawn() -> None:
    one = erosion.TABLE_1.replace(k=1.0, alpha=0.3)
    cut, hit = erosion.simulate(Melting(), one), erosion.impact(Melting(), one)
    # The heat is the loss of ½ m ẋ².
    lost = 0.5 * one.m * ((one.v0 * np.cos(0.3)) ** 2 - hit.state["vx"] ** 2)
    assert hit.state["heat"] == pytest.approx(float(lost), rel=1e-8)
    shown = {row[0]: row[2] for row in cut.rows()}
    assert "turn" not in shown
    assert float(shown["state heat"]) == pytest.approx(float(hit.state["heat"]), rel=1e-6)
    assert cut.to_dict()["state"]["heat"] == pytest.approx(float(hit.state["heat"]), rel=1e-8)
    assert "nan" not in str(cut)
    lines = [np.asarray(line.get_ydata(), float) for axes in plot_trajectory(cut).axes for line in axes.lines]
    assert sum(line.size == cut.t.size and bool(np.isfinite(line).all()) for line in lines) >= 2


@pytest.mark.parametrize("name", ["rotating-deformation", "tan-alpha"])
def test_a_model_s_problem_ends_as_its_impact(name: str) -> None:
    model = erosion.load_model(name)
    hit = erosion.impact(model, SPUN, derivatives=2)
    end = ode.solve(model.problem(), SPUN, start="end", wrt="alpha", derivatives=2)
    assert end.integrals["volume"] == pytest.approx(hit.volume, rel=1e-9)
    assert end.t == pytest.approx(hit.t_c, rel=1e-9)
    assert end.along("alpha", "alpha").integrals["volume"] == pytest.approx(hit.d2volume, rel=1e-5)
    assert [{"start": "no-cut"}.get(word, word) for word in end.ended_by] == hit.ended_by.tolist()


def test_a_second_cut_adds_to_the_first() -> None:
    """The chain of the notebook: the tip leaves at 10°, and enters again (scipy's DOP853 at 1e-12, typed once more)."""
    model = erosion.load_model("rotating")

    def depth(t, y, p):
        return model.tip(y["body"], p).depth

    def field(t, y, p):
        body, zero = y["body"], 0.0 * y["body"].x
        free = type(body)(body.vx, body.vy, body.omega, zero, zero, zero)
        on = y["cutting"] > 0.5
        return {
            "body": jax.tree.map(lambda a, b: jnp.where(on, a, b), model.derivative(body, p), free),
            "cutting": zero,
        }

    chain = ode.Problem(
        y0=lambda p: {"body": model.initial_state(p), "cutting": 1.0},
        vector_field=field,
        events={
            "leaves": ode.Event(depth, -1, reset=lambda t, y, p: y | {"cutting": 0.0}),
            "enters": ode.Event(depth, +1, reset=lambda t, y, p: y | {"cutting": 1.0}),
            "away": ode.Event(lambda t, y, p: y["body"].y + 1.5 * p.r, -1),
        },
        integrals={"volume": lambda t, y, p: jnp.where(y["cutting"] > 0.5, model.removal_rate(y["body"], p), 0.0)},
    )
    shallow = erosion.TABLE_1.replace(k=1.0, alpha=np.deg2rad(10.0))
    end = ode.solve(chain, shallow, t1=2e-3, smooth=True)
    assert end.ended_by == "away"
    assert end.events.name.tolist() == ["leaves", "enters", "leaves", "away"]
    known = [5.9673558537978376e-05, 0.00016149721385257435, 0.00019475525776928046, 0.00036676674232124124]
    assert end.events.t == pytest.approx(known, rel=1e-9)
    assert end.integrals["volume"] / erosion.impact(model, shallow).volume == pytest.approx(1.19199967051142, rel=1e-9)


def test_the_motion_of_a_slow_sphere_is_known_to_the_last_digit() -> None:
    """At 45° a derivative of the state vanishes: a tolerance of 1e-12 of itself would be below rounding."""
    sphere = erosion.Parameters(
        k=10, psi=1, r=2.5e-3, b=2.5e-3, m=5.13781e-4, v0=11.983, sigma=6.3146e8, alpha=np.pi / 4
    )
    path = erosion.simulate("linearized", sphere)
    fast = follow(erosion.load_model("linearized"), sphere)
    assert fast.volume == pytest.approx(path.volume, rel=1e-10)
