"""The best angle of a nozzle, over models, correlations, the force ratio, the contact ratio and the jet."""

from collections.abc import Iterator, Sequence

import numpy as np

from erosion.advice.result import NOZZLE_ANGLES, Advice, Curve
from erosion.arguments import Progress, no_progress
from erosion.correlations import CORRELATIONS
from erosion.distributions import Normal
from erosion.engine.impact import impact
from erosion.models import load_model
from erosion.models.base import CuttingModel
from erosion.models.correlated import Correlated, per_mass_of
from erosion.models.own_parameters import own_parameters
from erosion.optimum.alpha_max import alpha_max
from erosion.parameters.materials import Particle, Target
from erosion.parameters.materials import particle as read_particle
from erosion.parameters.materials import target as read_target
from erosion.parameters.parameters import Parameters, require_scalars, validate
from erosion.parameters.per_mass import PerMass
from erosion.parameters.precision import require_float64
from erosion.streams.particles import Particles
from erosion.trajectory.trajectory import SimulationError

MODELS = (
    "linearized",
    "finnie",
    "rotating",
    "rotating-full-torque",
    "linearized-deformation",
    "finnie-deformation",
    "rotating-deformation",
)
"""The models that are compared without others: those of a constant force ratio. With K = tan α most is removed at
grazing angles, which no test shows."""

CUTTING_FRACTION = 0.5  # Finnie, Wear 3 (1960) 87-103
_FACTORS = {"k": (0.5, 1.5), "psi": (0.5, 2.0)}  # no source gives ranges; these are guesses around Finnie's 2 and 2
_DEVIATES = 64  # particles of a jet that stand for its angles
_SPEEDS = 8
_STEEP = np.deg2rad(45.0)  # any: deviations from it are what counts


def advise(
    p: Parameters,
    *,
    particle: str | Particle | None = None,
    target: str | Target | None = None,
    spread: float = float(np.deg2rad(3.0)),
    speed_spread: float = 0.0,
    density: float | int | None = None,
    cutting_fraction: float = CUTTING_FRACTION,
    models: Sequence[str] = MODELS,
    progress: Progress = no_progress,
) -> Advice:
    """The nozzle's angle that is good whichever model holds, and the erosion to expect there.

        p = erosion.TABLE_1.to("si").replace(v0=100.0)
        erosion.advise(p, particle="garnet 0.3 mm", target="aluminium 6061")

    Every model and correlation gives a curve of erosion over the nozzle's angle, for the jet as a whole. k and ψ are
    varied about their values, k by ± 50 % and ψ from half to twice. The advised angle is where the curve that loses
    most against its own maximum loses least.

    Args:
        p: the case, all scalars; its angle is not used.
        particle: by name, in place of that of `p`; see `erosion.particle`.
        target: by name, in place of that of `p`; see `erosion.target`. It has the density and its correlations.
        spread: standard deviation of the angles of the particles in the jet [rad].
        speed_spread: standard deviation of the logarithm of their speeds; 0.1 is about 10 %.
        density: of the target [kg/m³], in place of that of `target`.
        cutting_fraction: the share of the particles that cut; see `PerMass`.
        models: names or paths.
        progress: called with "models", how many are done, and how many there are.

    Raises:
        ValueError: for arguments out of range or unknown names.
        SimulationError: where a model removes nothing at any angle.
    """
    require_float64()
    grit = None if particle is None else read_particle(particle)
    metal = None if target is None else read_target(target)
    p = p if grit is None else p.with_particle(grit)
    p = p if metal is None else p.with_target(metal)
    per_mass = PerMass(metal.density if density is None and metal is not None else density, cutting_fraction)
    return advise_case(p, grit, metal, (spread, speed_spread), per_mass, models, progress)


def advise_case(
    p: Parameters,
    grit: Particle | None,
    metal: Target | None,
    spreads: tuple[float, float],
    per_mass: PerMass,
    models: Sequence[str] = MODELS,
    progress: Progress = no_progress,
) -> Advice:
    """The same for a case that has its particle and its target already; `spreads` of angle [rad] and speed."""
    validate(p)
    require_scalars(p)
    spread, speed_spread = spreads
    if not 0 < spread < np.deg2rad(45):
        raise ValueError(f"Argument `spread` must be above 0° and below 45°, but is {np.rad2deg(spread):g}°.")
    if not 0 <= speed_spread < 1:
        raise ValueError(f"Argument `speed_spread` must be at least 0 and below 1, but is {speed_spread:g}.")
    if isinstance(models, str) or not models:
        raise ValueError(f"Argument `models` must be a list of models, but is {models!r}.")
    loaded = {str(name): load_model(name) for name in models}
    correlations = _correlations(metal)
    curves: list[Curve] = []
    jet = _Jet(p, spread, speed_spread)
    total = len(loaded) + len(correlations)
    for done, (name, model) in enumerate(loaded.items()):
        progress("models", done, total)
        curves += jet.of_model(name, model, per_mass_of(model, per_mass))
    outside = [model.outside_of_range(p) for model in loaded.values()]
    for done, (name, fits) in enumerate(correlations.items(), len(loaded)):
        progress("models", done, total)
        model = _of_particle(load_model(name), grit)
        curves.append(jet.of_correlation(name, model, fits=fits, known=per_mass.density is not None))
        outside.append(model.outside_of_range(p))
    progress("models", total, total)
    said = tuple(dict.fromkeys(message for message in outside if message))
    return Advice(p, spread, speed_spread, per_mass, tuple(curves), grit, metal, said)


def _of_particle(model: CuttingModel, grit: Particle | None) -> CuttingModel:
    """A correlation that depends on the size of the particle takes the size from its mass: give it the density."""
    if grit is None or "erodent_density" not in own_parameters(model):
        return model
    return model.replace(erodent_density=grit.density)


def _correlations(metal: Target | None) -> dict[str, bool]:
    """Every correlation once, made for the target where there is one, and whether it is."""
    made_for = () if metal is None else metal.correlations
    by_family = {name.partition(":")[0]: name for name in made_for}
    return {by_family.get(family, family): family in by_family for family in CORRELATIONS if family != "dnv-polynomial"}


class _Jet:
    """The particles of a jet at every angle of the nozzle."""

    def __init__(self, p: Parameters, spread: float, speed_spread: float) -> None:
        middles = (np.arange(_DEVIATES) + 0.5) / _DEVIATES
        angles = np.asarray(Normal(_STEEP, spread).ppf(middles))
        speeds = np.ones(1)
        if speed_spread:
            quantiles = Normal(0.0, speed_spread).ppf((np.arange(_SPEEDS) + 0.5) / _SPEEDS)
            speeds = np.exp(np.asarray(quantiles))
        self._p, self._law = p, Normal(_STEEP, spread)
        self._values = {"alpha": np.repeat(angles, speeds.size), "v0": float(p.v0) * np.tile(speeds, angles.size)}

    def of_model(self, name: str, model: CuttingModel, per_mass: PerMass) -> Iterator[Curve]:
        """The curves of a model as it is, and with other k and ψ where they change its best angle or its erosion."""
        settings = [("models", "", float(self._p.k), float(self._p.psi))]
        for group, factors in _FACTORS.items() if not isinstance(model, Correlated) else ():
            for factor in factors:
                changed = {"k": float(self._p.k), "psi": float(self._p.psi)}
                changed[group] *= factor
                symbol = {"k": "k", "psi": "ψ"}[group]
                settings.append((group, f"{symbol} = {changed[group]:.3g}", changed["k"], changed["psi"]))
        varied = {"k": np.array([k for *_, k, _ in settings]), "psi": np.array([psi for *_, psi in settings])}
        erosion = self._erosion(name, model, per_mass, varied)
        single = float(alpha_max(model, self._p).alpha)
        for (group, setting, *_), curve in zip(settings, erosion, strict=True):
            alone = single if group == "models" else None
            yield Curve(name, group, setting, curve, per_mass.density, single=alone)

    def of_correlation(self, name: str, model: CuttingModel, *, fits: bool, known: bool) -> Curve:
        """The curve of a correlation, whose absolute numbers may be made for another target."""
        per_mass = per_mass_of(model, PerMass())
        (erosion,) = self._erosion(name, model, per_mass, {"k": np.array([float(self._p.k)])})
        return Curve(name, "correlations", "", erosion, per_mass.density if known else None, fits)

    def _erosion(self, name: str, model: CuttingModel, per_mass: PerMass, varied: dict[str, np.ndarray]) -> np.ndarray:
        """Volume per mass of abrasive at each setting and angle of the nozzle, shape (settings, angles) [m³/kg]."""
        particles = Particles(model, self._p, {"alpha": self._law})
        values = {**self._values, **{parameter: value[:, None, None] for parameter, value in varied.items()}}
        turned, hits_at, hit = particles.impacts(values, NOZZLE_ANGLES[:, None])
        volume = np.where(hit, impact(turned, hits_at).volume, 0.0).mean(axis=-1)
        if not np.isfinite(volume).all() or not (volume.max(axis=-1) > 0).all():
            raise SimulationError(f"{name}: removes nothing at any angle, or could not be computed.")
        return np.asarray(per_mass.specific_volume(volume, self._p))
