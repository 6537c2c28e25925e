"""Velocity, force and energy of a cut over time, as the animation and the explorer draw them; without matplotlib."""

from typing import NamedTuple

import jax
import numpy as np

from erosion.impacts import Trajectory
from erosion.models import State

SHARES = {"motion": "motion of the centre", "turning": "turning", "lost": "lost by the body"}
"""Into what the kinetic energy at contact is shared out, with the words of a legend."""

_ROUNDING = 1e-9  # of the energy


class Dynamics(NamedTuple):
    """Velocity, force and energy of a body over its cut; all None for a model whose centre of mass is not known.

    Args:
        velocity: of the centre of mass, along the surface and down, over the greatest, shape (2, times).
        force: on the tip, in the same way.
        energy: the `SHARES` of the kinetic energy at contact, shape (3, times). What is lost the cut has used, and a
            rebound gives a part of it back. None where the force drives the body, as in `as-printed`.
    """

    velocity: list[list[float]] | None = None
    force: list[list[float]] | None = None
    energy: list[list[float]] | None = None


def dynamics(motion: Trajectory) -> Dynamics:
    """The velocity, the force and the shares of energy of a followed cut."""
    if not isinstance(motion.states, State):
        return Dynamics()
    p, states = motion.p, motion.states
    velocity = np.stack([motion.vx, motion.vy])
    rate = jax.vmap(lambda state: motion.model.derivative(state, p))(states)
    force = np.stack([np.broadcast_to(np.asarray(part), motion.t.shape) for part in (rate.vx, rate.vy)])
    translation = float(p.m) / 2 * (velocity**2).sum(axis=0)
    rotation = float(p.moment_of_inertia) / 2 * motion.omega**2
    whole = translation[0] + rotation[0]
    shares = np.stack([translation, rotation, whole - translation - rotation]) / whole
    loses = shares[2].min() > -_ROUNDING
    return Dynamics(_over_greatest(velocity), _over_greatest(force), shares.tolist() if loses else None)


def _over_greatest(vectors: np.ndarray) -> list[list[float]]:
    return (vectors / (float(np.max(np.hypot(*vectors))) or 1.0)).tolist()
