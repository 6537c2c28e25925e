"""How few unknowns the integrator needs of each model, and that they move as the model's own state does."""

import jax
import numpy as np
import pytest

import erosion
from erosion.impacts.impact import split
from erosion.ode.reduction import WholeMotion, motion_of
from erosion.parameters.parameters import QUANTITIES

_P = erosion.TABLE_1.replace(phidot0=2e4)


def _reduced(model):
    layout, numbers = split(model, _P)
    return motion_of(layout)(numbers)


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
    assert len(_reduced(erosion.load_model(name)).initial().state) == unknowns


@pytest.mark.slow
@pytest.mark.parametrize("name", erosion.available_models())
def test_the_motion_is_the_same(name):
    """Rates of events and volume along the motion, at contact and after a step."""
    model = erosion.load_model(name)

    def looks(motion, steps):
        at, rows = motion.initial(), []
        for _ in range(steps):
            rate = motion.rate(at)
            events = jax.jvp(motion.events, (at,), (rate,))
            rows.append(jax.tree.leaves((events, rate.integrals)))
            at = jax.tree.map(lambda s, k: s + 0.1 * model.scales(_P).time * k, at, rate)
        return np.array(rows)

    expected = looks(WholeMotion(*split(model, _P)), 4)
    assert np.allclose(looks(_reduced(model), 4), expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max(axis=0))


@pytest.mark.parametrize("name", ["linearized", "rotating"])
def test_a_parameter_that_is_not_finite_fails_whether_it_matters_or_not(name):
    names = list(QUANTITIES)
    for bad in (np.nan, np.inf):
        cases = {q: np.where(np.arange(len(names)) == i, bad, float(getattr(_P, q))) for i, q in enumerate(names)}
        found = erosion.impact(name, _P.replace(**cases))
        assert set(found.ended_by) == {"failed"}
        assert np.isnan(found.volume).all()
