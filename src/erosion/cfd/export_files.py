"""A model's curve in the forms of Fluent's wall and OpenFOAM's `ParticleErosion`."""

import dataclasses
from typing import Any

import numpy as np
from scipy import optimize

from erosion.arguments import Broadcast
from erosion.cfd.exports import (
    ANGLES,
    FAR,
    NEAR,
    ExportedParticle,
    ExportError,
    Losses,
    Reach,
    commented,
    losses,
    more_than_own,
    own_curve,
)
from erosion.correlations import finnie_angle
from erosion.models import model_name
from erosion.results import Finding, found

_MOST_POINTS = 30  # a piecewise-linear profile of Fluent has no more
_SAME = 1e-6  # factors that differ by less do not depend on the diameter
_EXACT = 1e-9  # an exponent as near to 2 is 2, a speed as near to the case's, relatively, is the case's


@dataclasses.dataclass(frozen=True)
class AngleTable:
    """Fluent's generic model of erosion, for a wall: Σ ṁ C(d) f(α) v^b / A, in kg/(m² s).

    C is a factor times the density of the target, with v in m/s; `text` has their product where the density is known.

    Args:
        angle: ascending, shape (points,) [rad].
        f: the curve over its maximum, shape (points,) [-].
        exponent: b, of the greatest volume at each speed [-].
        factor: greatest volume over m v^b, at the case's speed and diameter [m³/kg (s/m)^b]; [m³/J] for b = 2.
        diameter, factors: the same factor by diameter [m], shape (sizes,).
        misfit: greatest difference between table and curve at the case's speed, over the curve's maximum [-].
        losses: what is lost at other speeds and diameters.
        comment: model and case, or data and estimates, for the file.
        density: of the target [kg/m³], or None.
    """

    angle: np.ndarray
    f: np.ndarray
    exponent: float
    factor: float
    diameter: np.ndarray
    factors: np.ndarray
    misfit: float
    losses: Losses
    comment: str
    density: float | None = None

    def constant(self, factor: float) -> str:
        """C with its unit: a number, or without a density what it is to be multiplied by."""
        if self.density is None:
            return f"{factor:.6e} m^3/kg (s/m)^{self.exponent:.6g} x density of the target"
        return f"{factor * self.density:.6e} (s/m)^{self.exponent:.6g}"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Losses of the form at other speeds."""
        return found((self.losses.worst > NEAR, self.losses.finding("Fluent")))

    def text(self) -> str:
        """A CSV table, one point a line, angles in degrees."""
        lines = [f"{np.rad2deg(angle):.4f},{f:.6f}" for angle, f in zip(self.angle, self.f, strict=True)]
        by_size = [f"{d:.6e} m: C = {self.constant(c)}" for d, c in zip(self.diameter, self.factors, strict=True)]
        of = "" if self.density is None else f", for a target of {self.density:.6g} kg/m^3"
        function = f"Velocity exponent b = {self.exponent:.6g}; diameter function C = {self.constant(self.factor)}{of}"
        if np.ptp(self.factors) > _SAME * self.factor:
            function = "\n".join([f"{function} at {self.losses.diameter:.6g} m, piecewise-linear:", *by_size])
        else:
            function += ", the same for all diameters."
        return (
            f"{commented(self.comment, '#')}"
            f"# The table differs from the model's curve by up to {self.misfit:.2%} of its maximum.\n"
            f"{commented(self.losses.finding().text, '#')}"
            f"{commented(function, '#')}"
            "angle [deg],f [-]\n" + "\n".join(lines) + "\n"
        )


def angle_table(
    particle: ExportedParticle, reach: Reach, comment: str, points: int, density: float | None = None
) -> AngleTable:
    """The model's curve at the case's speed as a table, with the exponent and the diameter function that fit best.

    Args:
        particle: model and case.
        reach: speeds and diameters over which the form is to hold.
        comment: for the file.
        points: of the table; each is added where the table's error is greatest.
        density: of the target [kg/m³], where it is known.

    Raises:
        ValueError: for fewer than 2 points or more than Fluent takes.
        ExportError: where the reach asks for more than the form holds.
    """
    if not 2 <= points <= _MOST_POINTS:
        raise ValueError(f"Argument `points` must be from 2 to {_MOST_POINTS}, but is {points}.")
    erosion = own_curve(particle)
    greatest = float(erosion.max())
    angles, curve = np.append(0.0, ANGLES), np.append(0.0, erosion / greatest)
    nodes, misfit = _nodes(angles, curve, points)
    exponent = _exponent(particle, more_than_own(reach.speeds, particle.speed), curve[1:])
    diameters = more_than_own(reach.diameters, particle.diameter)
    factors = _sizes(particle.erosion(ANGLES, particle.speed, diameters[:, None]), curve[1:])
    power = particle.speed**exponent

    def form(alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        shape = np.interp(alpha, angles[nodes], curve[nodes])
        return np.asarray(np.interp(d, diameters, factors) * shape * (v0 / particle.speed) ** exponent)

    return AngleTable(
        angle=angles[nodes],
        f=curve[nodes],
        exponent=exponent,
        factor=greatest / power,
        diameter=diameters,
        factors=factors / power,
        misfit=misfit,
        losses=losses("Fluent", form, particle, reach),
        comment=comment,
        density=density,
    )


def _nodes(angles: np.ndarray, curve: np.ndarray, points: int) -> tuple[list[int], float]:
    """Indices of the table's points, and the greatest difference between table and curve."""
    nodes = [0, len(angles) - 1]
    while True:
        error = np.abs(np.interp(angles, angles[nodes], curve[nodes]) - curve)
        if len(nodes) == points or not error.any():
            return nodes, float(error.max())
        nodes = sorted({*nodes, int(np.argmax(error))})


def _sizes(erosion: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """The heights, shape (…,), with which a curve's shape comes nearest to each of several curves."""
    return erosion @ shape / (shape @ shape)


def _exponent(particle: ExportedParticle, speeds: np.ndarray, shape: np.ndarray) -> float:
    """B of a height that grows as v^b, by least squares of logarithms through the case's speed."""
    ratio = np.log(speeds / particle.speed)
    erosion = particle.erosion(ANGLES, np.append(particle.speed, speeds)[:, None], particle.diameter)
    own, *heights = _sizes(erosion, shape)
    # Below a threshold of the model nothing is removed: no power of v is 0.
    removes = (np.array(heights) > 0) & (np.abs(ratio) > _EXACT)
    if not removes.any():
        raise ExportError(f"{model_name(particle.model)} removes nothing at other speeds: no power of the speed fits.")
    ratio, growth = ratio[removes], np.log(np.array(heights)[removes] / own)
    exponent = float(ratio @ growth / (ratio @ ratio))
    return 2.0 if abs(exponent - 2) < _EXACT else exponent


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
        patches: that erode; without them the entry has a name to be replaced.
    """

    p: float
    psi: float
    K: float
    misfit: float
    rms: float
    losses: Losses
    comment: str
    patches: tuple[str, ...] = ()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Losses of the form at the case's speed and at others."""
        return found(
            (self.misfit > NEAR, Finding("shape_off", "OpenFOAM", {"misfit": self.misfit})),
            (self.losses.worst > max(NEAR, self.misfit), self.losses.finding("OpenFOAM")),
        )

    def text(self) -> str:
        """An entry for the `cloudFunctions` of a case's cloud properties."""
        named = f"({' '.join(self.patches)});"
        patches = named if self.patches else "(walls);    // name the eroding patches here"
        return (
            f"{commented(self.comment, '//')}"
            f"// Finnie's curve differs from the model's by up to {self.misfit:.2%} of its maximum,\n"
            f"// by {self.rms:.2%} in the mean of squares over all angles.\n"
            f"{commented(self.losses.finding().text, '//')}"
            "// It goes into `cloudFunctions` of the cloud's properties, such as constant/kinematicCloudProperties.\n"
            "particleErosion1\n"
            "{\n"
            "    type        particleErosion;\n"
            f"    patches     {patches}\n"
            f"    p           {self.p:.12g};    // Pa\n"
            f"    psi         {self.psi:.12g};\n"
            f"    K           {self.K:.12g};\n"
            "}\n"
        )


def coefficients(particle: ExportedParticle, reach: Reach, comment: str) -> ParticleErosion:
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
