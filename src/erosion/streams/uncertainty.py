"""What uncertain parameters do to a whole stream: they are the same for all particles, so that nothing averages out."""

import dataclasses

import numpy as np

from erosion.impacts.impact import impact
from erosion.streams.particles import Particles
from erosion.streams.replicates import Points

_DRAWS = 2**8  # the standard deviation is known to 4 %
_PARTICLES = 2**10  # for each draw the same ones, so that their noise is not taken for an effect of the parameters


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """The means of a stream for draws of the uncertain parameters.

    Args:
        volume: mean removed volume of a particle, shape (draws,) [volume].
        mass: mean mass of a particle, shape (draws,) [mass].
    """

    volume: np.ndarray
    mass: np.ndarray

    @property
    def erosion(self) -> np.ndarray:
        """Removed volume per mass of abrasive if every particle cuts, shape (draws,) [volume/mass]."""
        return self.volume / self.mass


def uncertainty_of(particles: Particles, seed: int, rtol: float) -> Uncertainty | None:
    """The means of the same particles for draws of the uncertain parameters; None where there are none."""
    own, common = particles.dimensions
    if not common:
        return None
    # Other points than the stream's, so that their errors are independent.
    seeds = np.random.SeedSequence([seed, 2]).generate_state(2)
    points = Points("sobol", own, int(seeds[0]), 1).take(_PARTICLES)[0] if own else np.zeros((1, 0))
    draws = Points("sobol", common, int(seeds[1]), 1).take(_DRAWS)[0]
    model, p, hits = particles.impacts(particles.draw_apart(points, draws))
    volume = np.where(hits, impact(model, p, rtol=rtol).volume, 0.0)
    computed = np.isfinite(volume)
    counts = computed.sum(axis=1)
    mass = np.broadcast_to(np.asarray(p.m), volume.shape)
    sums = [np.where(computed, values, 0.0).sum(axis=1)[counts > 0] for values in (volume, mass)]
    return Uncertainty(*(total / counts[counts > 0] for total in sums))
