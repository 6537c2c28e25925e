"""Model and case as numbers: their places, and how large a step of each is."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.impacts.impact import element_of, split
from erosion.models.base import CuttingModel, Tip
from erosion.ode.reduction import WholeMotion
from erosion.ode.variational import Variational
from erosion.parameters.parameters import QUANTITIES

P = erosion.TABLE_1.replace(v0=3.0)


class Start(CuttingModel):
    """A state that shows its parameters."""

    weights: Any = ()
    drift: float = 1.0

    def initial_state(self, p):
        return {"alpha": p.alpha, "drift": self.drift, "phidot0": p.phidot0, "psi": p.psi}

    def derivative(self, state, p):
        return {name: 0.0 * part for name, part in state.items()}

    def tip(self, state, p):
        return Tip(jnp.zeros(()), state["psi"], state["alpha"], state["phidot0"])


@pytest.mark.parametrize(
    ("name", "changes", "unit"),
    [
        ("alpha", {}, 1.0),
        ("phidot0", {"phidot0": 7.0}, P.v0 / P.r),
        ("phidot0", {}, P.v0 / P.r),
        ("psi", {"psi": 0.3}, 0.3),
        ("psi", {"psi": 0.0}, 1.0),
        ("drift", {}, 4.0),
    ],
)
def test_steps_are_of_a_size_that_matters(name: str, changes: dict[str, float], unit: float) -> None:
    """1 rad, the spin v₀/r, or the parameter's own size; of nothing, one."""
    model = Start(drift=4.0)
    layout, numbers = split(model, P.replace(**changes))
    motion = functools.partial(WholeMotion, layout)
    _, first = Variational(layout, numbers, 1, (element_of(model, name),), motion).initial()
    place = ["alpha", "drift", "phidot0", "psi"].index(name)
    assert [float(one) for one in first.state] == [float(unit) if i == place else 0 for i in range(4)]


def test_a_parameter_has_its_place_among_the_elements_of_all_numbers() -> None:
    model = Start(weights=np.ones(3))
    assert [element_of(model, name) for name in QUANTITIES] == list(range(10))
    assert element_of(model, "drift") == 13
    # Of many impacts' own parameters each lane has one.
    assert element_of(model.replace(drift=np.ones(5)), "drift") == 13
