"""Where a model of a body with a single tip does not hold: it turns too far, or its force pushes it forward."""

import math
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Broadcast, ModelState, PerImpact
from erosion.impacts.batch import impact
from erosion.models import (
    BUILT_IN,
    NO_CUT,
    CuttingModel,
    Events,
    SameMotion,
    State,
    load_model,
    model_name,
    values,
    with_values,
)
from erosion.output import briefly
from erosion.parameters import STEEPEST, Parameters, about, read_quantity
from erosion.results import Finding

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


OF_TURN = ("turned_beyond", "turned_beyond_at_best", "turned_beyond_in_part", "turned_beyond_at_draws")
"""The codes of findings on a body that turns by more than 90°."""


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


class Turn(SameMotion):
    """φ(t_c) - φ(0) = ∫ φ̇ dt [rad]."""

    motion: CuttingModel

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.motion.derivative(state, p).phi


def turn_of(model: CuttingModel, p: Parameters) -> PerImpact:
    """How far the body turns in each cut [rad]; NaN of a model without an orientation."""
    if not turns(model, p):
        return np.full(np.broadcast_shapes(*(np.shape(value) for value in values(model, p).values())), np.nan)[()]
    return np.abs(impact(Turn(model), p, rtol=_RTOL).volume)


def turns(model: CuttingModel, p: Parameters) -> bool:
    """Whether the model's state holds the orientation of a rigid body."""
    one = jax.tree.map(lambda _: 1.0, p)
    return isinstance(jax.eval_shape(model.initial_state, one), State)


_SHALLOW = 1e-3  # of the greatest depth without rotation


def pushed_forward(model: CuttingModel, p: Parameters) -> bool:
    """Whether the force of a user's model pushes the body forward as it begins to cut, F_x > 0, in the first case."""
    if model_name(model) in BUILT_IN or not turns(model, p):
        return False
    # A law is written for one impact: it need not take arrays.
    first = {name: float(np.ravel(value)[0]) for name, value in values(model, p).items() if np.ndim(value)}
    model, p = with_values(model, p, first)
    state = model.initial_state(p)
    depth = _SHALLOW * p.v0 * jnp.sin(p.alpha) / p.rate
    inside = eqx.tree_at(lambda state: state.y, state, state.y + depth)
    return bool(model.derivative(inside, p).vx > 0)


def check_max_turn(max_turn: float | str | None) -> float | None:
    """The greatest turn [rad] that is allowed, or None.

    Raises:
        ValueError: unless it is a positive angle.
    """
    if max_turn is None:
        return None
    with about("Argument `max_turn`"):
        angle = read_quantity(max_turn, "angle", None) if isinstance(max_turn, str) else max_turn
    if isinstance(angle, bool) or not isinstance(angle, (int, float, np.number)) or not 0 < angle < math.inf:
        raise ValueError(
            f'Argument `max_turn` must be an angle above 0, such as "90deg", or None, but is {briefly(max_turn)}.'
        )
    return float(angle)


def turned_beyond(model: CuttingModel | str | Path, p: Parameters) -> np.ndarray:
    """Whether the body turns by more than 90° in each cut; where nothing is cut, or α is NaN, nothing turns.

    Where cutting begins the cut beside it counts.
    """
    model = load_model(model)
    angles = np.broadcast_to(p.alpha, np.broadcast_shapes(*map(np.shape, values(model, p).values())))
    if not turns(model, p):
        return np.zeros(angles.shape, bool)
    known = np.isfinite(angles)
    alpha = np.where(known, np.maximum(angles, _SHALLOWEST), 1.0)
    limited = TurnLimited(model, QUARTER_TURN)

    def ends(alpha: np.ndarray) -> np.ndarray:
        return np.asarray(impact(limited, p.replace(alpha=alpha), rtol=_RTOL).ended_by)

    own = ends(alpha)
    turned = own == TURNED
    if (none := known & np.isin(own, (NO_CUT, "failed"))).any():
        beside = np.stack([alpha * (1 - _STEP_ASIDE), np.minimum(alpha * (1 + _STEP_ASIDE), STEEPEST)])
        turned = np.where(none, (ends(beside) == TURNED).any(axis=0), turned)
    return known & turned


_SAMPLED = 2**12  # impacts from which the share that turns too far is known well enough


def finding_of_turned(counts: np.ndarray, name: str = "") -> Finding | None:
    """The finding that bodies turn by more than 90° in some impacts, None where none does.

    Args:
        counts: of `count_turned`.
        name: what the finding is about.
    """
    turned, impacts = counts.tolist()
    return Finding("turned_beyond_in_part", name, {"turned": turned, "impacts": impacts}) if turned else None


def count_turned(model: CuttingModel, p: Parameters, counted: np.ndarray | None = None) -> np.ndarray:
    """In how many impacts the body turns by more than 90°, and of how many, 4096 at most that lie evenly; shape (2,).

    Args:
        model: its own parameters may be arrays.
        p: of one impact, or arrays that broadcast.
        counted: which impacts count, of the broadcast shape; all of them without it.
    """
    if not turns(model, p):
        return np.zeros(2, np.int64)
    varied = {name: np.asarray(value) for name, value in values(model, p).items() if np.ndim(value)}
    mask = np.asarray(True) if counted is None else counted
    shape = np.broadcast_shapes(*(value.shape for value in varied.values()), mask.shape) or (1,)
    flat = np.flatnonzero(np.broadcast_to(mask, shape))
    if not flat.size:
        return np.zeros(2, np.int64)
    at = np.unravel_index(flat[np.unique(np.linspace(0, flat.size - 1, _SAMPLED).astype(int))], shape)
    sample = {name: np.broadcast_to(value, shape)[at] for name, value in varied.items()}
    turned = turned_beyond(*with_values(model, p, sample))
    return np.array([np.sum(turned), np.size(turned)])
