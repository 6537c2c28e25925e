from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.model import CuttingModel, State, Tip
from erosion.reduction import reduced

_P = erosion.TABLE_1.replace(phidot0=2e4)


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
    assert len(reduced(erosion.load_model(name), _P).initial_state(_P)) == unknowns


@pytest.mark.parametrize("name", erosion.available_models())
def test_the_motion_is_the_same(name):
    """Rates of events and volume along the motion, at contact and after a step."""
    model = erosion.load_model(name)
    other = reduced(model, _P)
    assert len(jax.tree.leaves(other)) == len(jax.tree.leaves(model))

    def looks(model, steps):
        state, found = model.initial_state(_P), []
        for _ in range(steps):
            rate = model.derivative(state, _P)
            events = jax.jvp(lambda s: model.events(s, _P), (state,), (rate,))
            found.append(jax.tree.leaves((events, model.removal_rate(state, _P), model.tip(state, _P).depth)))
            state = jax.tree.map(lambda s, k: s + 0.1 * model.scales(_P).time * k, state, rate)
        return np.array(found)

    expected = looks(model, 4)
    assert np.allclose(looks(other, 4), expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max(axis=0))


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
    assert len(reduced(model, _P).initial_state(_P)) == 3  # y, φ with a rate of parameters alone, ∫ force
    # Without drag ẋ stays, and the closed form is half a period of y.
    found = erosion.impact(model, erosion.TABLE_1, derivatives=1)
    p = erosion.TABLE_1
    omega = np.sqrt(p.k * p.stiffness / p.m)
    exact = p.b * p.v0 * np.cos(p.alpha) * 2 * p.v0 * np.sin(p.alpha) / omega**2
    assert found.ended_by == "rebound"
    assert np.isclose(found.volume, exact, rtol=1e-9)
    assert np.isclose(found.dvolume, exact * 2 / np.tan(2 * p.alpha), rtol=1e-8)
