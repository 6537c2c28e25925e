"""The fitted angle curve for CFD codes, and the misfit of their curves.

OpenFOAM's `ParticleErosion` knows one shape of curve, Finnie's, with coefficients p, psi and
K. Fluent takes any curve as a table of up to 30 points.
"""

import dataclasses
from typing import Any

import numpy as np
from scipy import optimize

from erosion.calibration.conditions import MOST, conditions
from erosion.calibration.result import Calibration
from erosion.correlations import finnie_angle
from erosion.engine.impact import impact
from erosion.models import model_name
from erosion.models.own_parameters import own_in_words
from erosion.parameters.case_files import dump_case
from erosion.parameters.parameters import Parameters
from erosion.parameters.units import conversion_factor
from erosion.version import __version__

_ANGLES = np.deg2rad(np.arange(0.5, 90.25, 0.25))
_MOST_POINTS = 30  # a piecewise-linear profile of Fluent has no more
_POINTS = 20


@dataclasses.dataclass(frozen=True)
class ParticleErosion:
    """Coefficients of OpenFOAM's `ParticleErosion`: Q = m V²/(p ψ K) F(α; K).

    Args:
        p: flow stress [Pa].
        psi: depth of contact over length of the cut [-].
        K: normal over tangential force [-].
        misfit: greatest difference from the fitted curve over that curve's maximum [-].
        rms: root mean square of that difference over all angles [-].
        comment: model, data and estimates, for the file.
    """

    p: float
    psi: float
    K: float
    misfit: float
    rms: float
    comment: str

    def text(self) -> str:
        """An entry for the `cloudFunctions` of a case's cloud properties."""
        return (
            f"{_commented(self.comment, '//')}"
            f"// Finnie's curve differs from the fitted one by up to {self.misfit:.2%} of its maximum,\n"
            f"// by {self.rms:.2%} in the mean of squares over all angles.\n"
            "particleErosion1\n"
            "{\n"
            "    type        particleErosion;\n"
            "    patches     (walls);    // name the eroding patches here\n"
            f"    p           {self.p:.6e};    // Pa\n"
            f"    psi         {self.psi:.6g};\n"
            f"    K           {self.K:.6g};\n"
            "}\n"
        )


@dataclasses.dataclass(frozen=True)
class AngleTable:
    """A piecewise-linear angle function f, as Fluent's wall boundary condition takes it.

    Fluent's rate of erosion is Σ ṁ C f(α) V^b / A. With b = 2, `factor` × (density of the
    target) is C.

    Args:
        angle: ascending, shape (points,) [rad].
        f: the curve over its maximum, shape (points,) [-].
        factor: greatest volume over m V² [m³/J].
        misfit: greatest difference between table and curve, over the curve's maximum [-].
        comment: model, data and estimates, for the file.
    """

    angle: np.ndarray
    f: np.ndarray
    factor: float
    misfit: float
    comment: str

    def text(self) -> str:
        """A CSV table, one point a line, angles in degrees."""
        lines = [f"{np.rad2deg(angle):.4f},{f:.6f}" for angle, f in zip(self.angle, self.f, strict=True)]
        return (
            f"{_commented(self.comment, '#')}"
            f"# The table differs from the fitted curve by up to {self.misfit:.2%} of its maximum.\n"
            f"# Velocity exponent b = 2; diameter function C = {self.factor:.6e} m^3/J x density of the target.\n"
            "angle [deg],f [-]\n" + "\n".join(lines) + "\n"
        )


def to_openfoam(calibration: Calibration) -> ParticleErosion:
    """The coefficients p and K with which Finnie's curve comes nearest to the fitted one.

    ψ is kept as the calibration has it; only p ψ counts. Curves of `finnie` with β = ½ and
    no spin, and of `linearized` (with K = 3k), are of Finnie's shape exactly.
    """
    case = exported_case(calibration).to("si")
    volume = _volume(calibration, exported_case(calibration))
    scale = float(case.m * case.v0**2 / case.psi)
    greatest = volume.max()

    def curve(coefficients: Any) -> np.ndarray:
        stress, ratio = np.exp(coefficients)
        return scale / (stress * ratio) * np.asarray(finnie_angle(_ANGLES, ratio))

    begin = np.log([scale / greatest / 3, float(case.k)])
    fits = [
        optimize.least_squares(lambda q: curve(q) / greatest - volume / greatest, begin + np.log([1.0, factor]),
                               xtol=1e-12, ftol=1e-12, gtol=1e-12)
        for factor in (0.5, 1.0, 3.0)
    ]  # fmt: skip
    best = min(fits, key=lambda fit: fit.cost)
    stress, ratio = np.exp(best.x)
    return ParticleErosion(
        p=float(stress),
        psi=float(case.psi),
        K=float(ratio),
        misfit=float(np.abs(best.fun).max()),
        rms=float(np.sqrt(np.mean(best.fun**2))),
        comment=_comment(calibration),
    )


def to_fluent(calibration: Calibration, points: int = _POINTS) -> AngleTable:
    """The fitted curve as a table; each point is added where the error of the table is greatest.

    Raises:
        ValueError: for fewer than 2 points or more than Fluent takes.
    """
    if not 2 <= points <= _MOST_POINTS:
        raise ValueError(f"Argument `points` must be from 2 to {_MOST_POINTS}, but is {points}.")
    angles, volume = np.append(0.0, _ANGLES), np.append(0.0, _volume(calibration, exported_case(calibration)))
    curve = volume / volume.max()
    nodes = [0, len(angles) - 1]
    while True:
        table = np.interp(angles, angles[nodes], curve[nodes])
        error = np.abs(table - curve)
        if len(nodes) == points:
            break
        nodes = sorted({*nodes, int(np.argmax(error))})
        if len(nodes) < points and not error.any():
            break
    case = exported_case(calibration).to("si")
    return AngleTable(
        angle=angles[nodes],
        f=curve[nodes],
        factor=float(volume.max() / (case.m * case.v0**2)),
        misfit=float(error.max()),
        comment=_comment(calibration),
    )


def to_case(calibration: Calibration) -> str:
    """The text of a case file, which `load_case` reads: the estimates in place, at a speed of the data.

    What a case file has no field for, the model, its own parameters and the cutting fraction, is in comments.
    """
    own = own_in_words(calibration.model)
    lines = _origin(calibration)
    if calibration.cutting_fraction != 1:
        lines.append(f"Volumes are those of a particle that cuts: {calibration.cutting_fraction:.4g} of them do.")
    lines += calibration.statements
    if own:
        lines.append(f"The model's own parameters: {own}")
    text = "".join(mark if mark.isprintable() or mark == "\n" else " " for mark in "\n".join(lines))
    return _commented(text, "#") + dump_case(exported_case(calibration), calibration.title)


def exported_case(calibration: Calibration) -> Parameters:
    """The fitted case at a speed and a mass that the data has.

    They are those of most rows, of the greatest speed among equals; or the case's own, where the data has these.
    """
    p, groups = calibration.p, conditions(calibration.data)
    own = [group for group in groups if all(np.isclose(float(getattr(p, name)), value, rtol=1e-3)
                                            for name, value in group.values.items())]  # fmt: skip
    chosen = max(own or groups, key=lambda group: (len(group.rows), *group.values.values()))
    return p.replace(**chosen.values)


def _volume(calibration: Calibration, p: Parameters) -> np.ndarray:
    """Volume over `_ANGLES` [m³], per particle, of which a share cuts."""
    volume = impact(calibration.model, p.replace(alpha=_ANGLES)).volume
    return calibration.cutting_fraction * volume * conversion_factor("volume", p.units, "si")


def _comment(calibration: Calibration) -> str:
    """Model, data, estimates, speed and warnings."""
    lines = _origin(calibration)
    if calibration.cutting_fraction != 1:
        lines.append(f"The cutting fraction {calibration.cutting_fraction:.4g} is part of what is written here.")
    lines += calibration.statements
    if calibration.data.free_scale:
        lines.append("The data was known up to a factor: the curve's height is the case's, not measured.")
    return "\n".join(lines)


def _origin(calibration: Calibration) -> list[str]:
    """Model, data, estimates and speed."""
    p, data = exported_case(calibration), calibration.data
    return [
        f"erosion {__version__}: {model_name(calibration.model)}, fitted to {len(data)} rows of {data.source}",
        ", ".join(f"{name} = {value:.6g}" for name, value in calibration.estimates.items())
        + f" ({p.units} units), at v0 = {float(p.to('si').v0):.6g} m/s",
        *_other_speeds(calibration, p),
    ]


def _other_speeds(calibration: Calibration, p: Parameters) -> list[str]:
    """A sentence on the speed, where the data has speeds, and one on the other speeds or masses that it has."""
    groups = [group for group in conditions(calibration.data, MOST) if group.values]
    if not groups:
        return []
    lines = ["This speed is one of the data's." if "v0" in groups[0].values else "This mass is one of the data's."]

    def over_energy(case: Parameters) -> np.ndarray:
        return _volume(calibration, case) / float(case.m * case.v0**2)

    here = over_energy(p)
    differs = {group.label: np.abs(over_energy(p.replace(**group.values)) - here).max() / here.max()
               for group in groups}  # fmt: skip
    label = max(differs, key=lambda key: differs[key])
    if len(groups) > 1:
        lines.append(f"At {label} the volume over m V^2 differs from it by up to {differs[label]:.2%} of its maximum.")
    return lines


def _commented(text: str, mark: str) -> str:
    return "".join(f"{mark} {line}\n" for line in text.splitlines())
