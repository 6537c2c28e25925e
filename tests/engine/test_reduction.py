from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.engine.leaves import split
from erosion.engine.reduction import WholeMotion, reduced
from erosion.engine.variational import Cut
from erosion.models.base import CuttingModel, State, Tip
from erosion.parameters.parameters import QUANTITIES

_P = erosion.TABLE_1.replace(phidot0=2e4)


def _reduced(model):
    layout, _ = split(model, _P)
    return reduced(layout)(model, _P)


@pytest.mark.parametrize(
    ("name", "unknowns"),
    [
        ("linearized", 2),  # y and ∫ depth
        ("finnie", 2),
        ("rotating", 3),  # y, φ and ∫ depth
        ("rotating-full-torque", 4),  # and φ̇
        ("rotating-velocity-aligned-full-torque", 5),  # all but x
    ],
)
def test_as_few_unknowns_as_the_physics_allows(name, unknowns):
    assert len(_reduced(erosion.load_model(name)).initial_state()) == unknowns


@pytest.mark.slow
@pytest.mark.parametrize("name", erosion.available_models())
def test_the_motion_is_the_same(name):
    """Rates of events and volume along the motion, at contact and after a step."""
    model = erosion.load_model(name)

    def looks(motion, steps):
        cut, rows = Cut(motion.initial_state(), 0.0), []
        for _ in range(steps):
            rate = motion.rate(cut)
            events = jax.jvp(motion.events, (cut,), (rate,))
            rows.append(jax.tree.leaves((events, rate.volume)))
            cut = jax.tree.map(lambda s, k: s + 0.1 * model.scales(_P).time * k, cut, rate)
        return np.array(rows)

    expected = looks(WholeMotion(model, _P), 4)
    assert np.allclose(looks(_reduced(model), 4), expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max(axis=0))


class Odd(CuttingModel):
    """What the search must not stumble over: arrays, zeros, a factor of zero, a rate without state."""

    drag: Any = 0.0

    def initial_state(self, p):
        return State(0.0, 0.0, 0.0, p.v0 * jnp.cos(p.alpha), p.v0 * jnp.sin(p.alpha), 1.0 + 0 * p.v0)

    def derivative(self, state, p):
        force = -p.stiffness * jnp.sum(jnp.stack([state.y, jnp.zeros_like(state.y)])) / p.m
        return State(state.vx, state.vy, p.v0 / p.r, -self.drag * force, p.k * force, jnp.zeros_like(force))

    def tip(self, state, p):
        return Tip(state.x, state.y + 0 * state.phi, state.vx * state.omega, state.vy)


def test_odd_arithmetic_is_left_as_it_is():
    model = Odd()
    assert len(_reduced(model).initial_state()) == 3  # y, φ with a rate of parameters alone, ∫ force
    # Without drag ẋ stays, and the closed form is half a period of y.
    found = erosion.impact(model, erosion.TABLE_1, derivatives=1)
    p = erosion.TABLE_1
    omega = np.sqrt(p.k * p.stiffness / p.m)
    exact = p.b * p.v0 * np.cos(p.alpha) * 2 * p.v0 * np.sin(p.alpha) / omega**2
    assert found.ended_by == "rebound"
    assert np.isclose(found.volume, exact, rtol=1e-9)
    assert np.isclose(found.dvolume, exact * 2 / np.tan(2 * p.alpha), rtol=1e-8)


class Odometer(CuttingModel):
    """`linearized`, with a part that starts far from zero and moves as the depth does."""

    def initial_state(self, p):
        return {"a": 1e6, "y": 0.0, "vx": p.v0 * jnp.cos(p.alpha), "vy": p.v0 * jnp.sin(p.alpha)}

    def derivative(self, state, p):
        force = -p.stiffness * state["y"] / p.m
        moved = 0 * state["a"]
        return {"a": state["vy"], "y": 1.0 * state["vy"], "vx": force + moved, "vy": p.k * force}

    def tip(self, state, p):
        return Tip(jnp.zeros(()), state["y"], state["vx"], state["vy"])


@pytest.mark.slow
def test_a_part_that_starts_far_from_zero_costs_no_digits():
    p = erosion.TABLE_1.replace(alpha=np.array([1e-8, 1e-4, 0.1]))
    exact = erosion.load_model("linearized").closed_form()
    assert exact is not None
    assert np.allclose(erosion.impact(Odometer(), p).volume / exact.volume(p), 1, rtol=0, atol=1e-9)


class Ploughing(CuttingModel):
    """Linear drag at constant depth until hardly anything of the speed is left: t_c = ln(1/ψ)/ω."""

    def initial_state(self, p):
        return {"x": 0.0, "u": p.v0}

    def derivative(self, state, p):
        return {"x": state["u"], "u": -p.rate * state["u"]}

    def tip(self, state, p):
        return Tip(state["x"], 1e-3 * p.r, state["u"], jnp.zeros(()))

    def events(self, state, p):
        return {"rest": state["u"] / p.v0 - p.psi}

    def removal_rate(self, state, p):
        return 1e-3 * p.b * p.r * (state["u"] + 1e-3 * p.rate * state["x"])


def test_a_part_that_relaxes_keeps_its_digits():
    left = np.array([1e-2, 1e-8])
    p = erosion.TABLE_1.replace(psi=left, sigma=erosion.TABLE_1.sigma * erosion.TABLE_1.psi / left)
    assert np.allclose(erosion.impact(Ploughing(), p).t_c * p.rate, np.log(1 / left), rtol=1e-9)


class Resting(Ploughing):
    """Nothing moves that matters."""

    def derivative(self, state, p):
        return {"x": state["u"], "u": 0.0}

    def events(self, state, p):
        return {"rest": -p.psi + 0 * state["u"]}

    def removal_rate(self, state, p):
        return p.b * state["u"]


def test_nothing_left_to_integrate():
    assert len(_reduced(Resting()).initial_state()) == 0
    found = erosion.impact(Resting(), _P, derivatives=1)
    assert (found.ended_by, found.volume) == ("no-cut", 0.0)


@pytest.mark.parametrize("name", ["linearized", "rotating"])
def test_a_parameter_that_is_not_finite_fails_whether_it_matters_or_not(name):
    names = list(QUANTITIES)
    for bad in (np.nan, np.inf):
        cases = {q: np.where(np.arange(len(names)) == i, bad, float(getattr(_P, q))) for i, q in enumerate(names)}
        found = erosion.impact(name, _P.replace(**cases))
        assert set(found.ended_by) == {"failed"}
        assert np.isnan(found.volume).all()
