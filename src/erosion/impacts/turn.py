"""How far a body turns in a cut, and the turn beyond which a model of a single tip does not hold."""

import math

import equinox as eqx
import jax
import numpy as np

from erosion.arguments import Broadcast, ModelState
from erosion.impacts.batch import impact
from erosion.models import NO_CUT, CuttingModel, Events, SameMotion, State, load_model
from erosion.output import briefly
from erosion.parameters import QUANTITIES, STEEPEST, Parameters, about, read_quantity

QUARTER_TURN = math.pi / 2
"""Beyond this turn [rad] another edge of the body is in the metal."""

TURNED = "turned"
"""The end of a cut at the greatest turn that is allowed."""

BEYOND = "the body turns by more than 90°, where the model does not hold"
"""The finding on a cut."""

BEYOND_LABEL = "turns by > 90°: not valid"
"""The same in a legend."""

_SHALLOWEST = 1e-6  # rad; the limit as α → 0 is that of this cut, the shallowest that `alpha_max` computes
_STEP_ASIDE = 1e-5  # of an angle, from where a cut begins: nearer its motion is singular
_RTOL = 1e-11


class TurnLimited(SameMotion):
    """A model's cuts, which end where the body has turned by `max_turn`, too."""

    motion: CuttingModel
    max_turn: float = eqx.field(static=True)

    def events(self, state: ModelState, p: Parameters) -> Events:
        turn = (state.phi - self.motion.initial_state(p).phi) / self.max_turn
        return {**self.motion.events(state, p), TURNED: 1 - turn**2}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.motion.removal_rate(state, p)

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.motion.removed_at_contact(p)


def turns(model: CuttingModel, p: Parameters) -> bool:
    """Whether the model's state holds the orientation of a rigid body."""
    one = jax.tree.map(lambda leaf: float(np.ravel(leaf)[0]), p)
    return isinstance(jax.eval_shape(model.initial_state, one), State)


def check_max_turn(max_turn: float | str | None) -> float | None:
    """The greatest turn [rad] that is allowed, or None.

    Raises:
        ValueError: unless it is a positive angle.
    """
    if max_turn is None:
        return None
    with about("Argument `max_turn`"):
        angle = read_quantity(max_turn, "angle", "si") if isinstance(max_turn, str) else max_turn
    if isinstance(angle, bool) or not isinstance(angle, (int, float, np.number)) or not 0 < angle < math.inf:
        raise ValueError(
            f'Argument `max_turn` must be an angle above 0, such as "90deg", or None, but is {briefly(max_turn)}.'
        )
    return float(angle)


def turned_beyond(model: CuttingModel | str, p: Parameters) -> np.ndarray:
    """Whether the body turns by more than 90° in each cut; where nothing is cut, or α is NaN, nothing turns.

    Where cutting begins the cut beside it counts.
    """
    angles = np.broadcast_to(p.alpha, np.broadcast_shapes(*(np.shape(getattr(p, name)) for name in QUANTITIES)))
    model = load_model(model)
    if not turns(model, p):
        return np.zeros(angles.shape, bool)
    known = np.isfinite(angles)
    alpha = np.where(known, np.maximum(angles, _SHALLOWEST), 1.0)
    beside = np.stack([alpha, alpha * (1 - _STEP_ASIDE), np.minimum(alpha * (1 + _STEP_ASIDE), STEEPEST)])
    ends = impact(TurnLimited(model, QUARTER_TURN), p.replace(alpha=beside), rtol=_RTOL).ended_by
    own, turned = ends[0], ends == TURNED
    return known & np.where(np.isin(own, (NO_CUT, "failed")), turned.any(axis=0), turned[0])
