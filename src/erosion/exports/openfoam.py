"""Coefficients for OpenFOAM's `ParticleErosion`, which knows one shape of curve, Finnie's."""

import dataclasses
from typing import Any

import numpy as np
from scipy import optimize

from erosion.array_types import Broadcast
from erosion.correlations import finnie_angle
from erosion.exports.particle import ExportError, Particle, commented
from erosion.exports.reach import ANGLES, FAR, NEAR, Losses, Reach, losses, own_curve
from erosion.models import model_name

_GREATEST_RATIO = 1e3  # K; with more, Finnie's curve no longer changes its shape


@dataclasses.dataclass(frozen=True)
class ParticleErosion:
    """Coefficients of OpenFOAM's `ParticleErosion`: Q = m V²/(p ψ K) F(α; K).

    Args:
        p: flow stress [Pa].
        psi: depth of contact over length of the cut [-].
        K: normal over tangential force [-].
        misfit: greatest difference from the model's curve over that curve's maximum [-].
        rms: root mean square of that difference over all angles [-].
        losses: what is lost at other speeds and diameters.
        comment: model and case, or data and estimates, for the file.
    """

    p: float
    psi: float
    K: float
    misfit: float
    rms: float
    losses: Losses
    comment: str

    @property
    def warning(self) -> str | None:
        """What is clearly lost, at the case's speed and at others; None where little is."""
        shape = f"OpenFOAM knows Finnie's curve only: it is off by up to {self.misfit:.1%} of the maximum."
        sentences = [shape] if self.misfit > NEAR else []
        if self.losses.worst > max(NEAR, self.misfit):
            sentences.append(self.losses.statement if sentences else f"OpenFOAM: {self.losses.statement}")
        return " ".join(sentences) or None

    def text(self) -> str:
        """An entry for the `cloudFunctions` of a case's cloud properties."""
        return (
            f"{commented(self.comment, '//')}"
            f"// Finnie's curve differs from the model's by up to {self.misfit:.2%} of its maximum,\n"
            f"// by {self.rms:.2%} in the mean of squares over all angles.\n"
            f"{commented(self.losses.statement, '//')}"
            "particleErosion1\n"
            "{\n"
            "    type        particleErosion;\n"
            "    patches     (walls);    // name the eroding patches here\n"
            f"    p           {self.p:.12g};    // Pa\n"
            f"    psi         {self.psi:.12g};\n"
            f"    K           {self.K:.12g};\n"
            "}\n"
        )


def coefficients(particle: Particle, reach: Reach, comment: str) -> ParticleErosion:
    """The coefficients with which Finnie's curve comes nearest to the model's at the case's speed.

    Args:
        particle: model and case.
        reach: speeds and diameters over which the coefficients are to hold.
        comment: for the file.

    Raises:
        ExportError: where the model's curve is not of Finnie's shape, or the reach asks for more than they hold.
    """
    case = particle.p
    erosion = own_curve(particle)
    greatest = erosion.max()
    scale = float(case.v0**2 / case.psi)

    def curve(coefficients: Any) -> np.ndarray:
        stress, ratio = np.exp(coefficients)
        return scale / (stress * ratio) * np.asarray(finnie_angle(ANGLES, ratio))

    begin = np.log([scale / greatest / 3, float(case.k)])
    fits = [
        optimize.least_squares(lambda q: (curve(q) - erosion) / greatest, begin + np.log([1.0, factor]),
                               xtol=1e-15, ftol=1e-15, gtol=1e-15)
        for factor in (0.5, 1.0, 3.0)
    ]  # fmt: skip
    best = min(fits, key=lambda fit: fit.cost)
    stress, ratio = map(float, np.exp(best.x))
    misfit = float(np.abs(best.fun).max())
    if misfit > FAR or ratio > _GREATEST_RATIO:
        limit = f" and K, {ratio:.1g}, is without limit" if ratio > _GREATEST_RATIO else ""
        raise ExportError(
            f"OpenFOAM knows Finnie's curve only, and {model_name(particle.model)} is not of that shape: the best "
            f"coefficients are off by up to {misfit:.1%} of the maximum{limit}; use a table for Fluent (--fluent)."
        )

    def form(alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        return np.asarray(v0**2 / (stress * float(case.psi) * ratio) * finnie_angle(alpha, ratio) + 0 * d)

    return ParticleErosion(
        p=stress,
        psi=float(case.psi),
        K=ratio,
        misfit=misfit,
        rms=float(np.sqrt(np.mean(best.fun**2))),
        losses=losses("OpenFOAM", form, particle, reach),
        comment=comment,
    )
