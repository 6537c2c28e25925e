"""The best angle of a nozzle, over models, correlations, the force ratio, the contact ratio and the jet."""

import dataclasses
from collections import ChainMap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from erosion.advice.abrasives import Job
from erosion.advice.result import DRAWS, NOZZLE_ANGLES, Advice, Curve, Uncertain
from erosion.arguments import Progress, no_progress, refuse
from erosion.correlations import CORRELATIONS
from erosion.fits.fit import Fit
from erosion.fits.predicted import ANGLES, highest
from erosion.fits.prediction import Predictor
from erosion.fits.problem import FRACTION
from erosion.impacts import SimulationError, alpha_max, impact, turned_beyond
from erosion.laws import JointLaw, JointSamples, joint_law
from erosion.models import CuttingModel, called, load_model, model_name, quantities, with_values
from erosion.models.correlated import Correlated, CorrelatedByShape, correlated, made_for, members, per_mass_of
from erosion.ode.step_control import require_float64
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    InSI,
    Parameters,
    Particle,
    PerMass,
    Quantity,
    System,
    Target,
    particle as read_particle,
    require_parameters,
    require_scalars,
    target as read_target,
    validate,
)
from erosion.results import Finding, unique
from erosion.streams.tally import Particles

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
FRACTION_OF_A_FIT = 1.0  # as `erosion.calibrate` takes it
_FACTORS = {"k": (0.5, 1.5), "psi": (0.5, 2.0)}  # no source gives ranges; these are guesses around Finnie's 2 and 2
_DEVIATES = 64  # particles of a jet that stand for its angles
_SPEEDS = 8
_AT_ONCE = 8  # draws; more of them together take much memory
_CURVES = 200  # of a fit's predictions: the ends of 95 % are known by five curves
_ROUNDING = 1e-6  # of a parameter that a file keeps
_STEEP = np.deg2rad(45.0)  # any: deviations from it are what counts


def advise(
    p: Parameters,
    *,
    particle: str | Particle | None = None,
    target: str | Target | None = None,
    spread: float = float(np.deg2rad(3.0)),
    speed_spread: float = 0.0,
    density: float | int | None = None,
    cutting_fraction: float | None = None,
    models: Sequence[str | CuttingModel] = MODELS,
    uncertain: JointLaw | JointSamples | Mapping[str, Any] | Fit | None = None,
    job: Job | None = None,
    compare: str | Particle | None = None,
    progress: Progress = no_progress,
) -> Advice:
    """The nozzle's angle that is good whichever model holds, and the erosion to expect there.

        p = erosion.TABLE_1.to("si").replace(v0=100.0)
        erosion.advise(p, particle="garnet 0.3 mm", target="aluminium 6061")

    Every model and correlation gives a curve of erosion over the nozzle's angle, for the jet as a whole. k and ψ are
    varied about their values, k by ± 50 % and ψ from half to twice. The advised angle is where the curve that loses
    most against its own maximum loses least.

    After a fit to tests of your own, its draws or those of a posterior take the place of these ranges:

        erosion.advise(fit.p, models=[fit.model], uncertain=fit)

    The advised angle is then where the curves that the tests allow remove most on average, each over its own maximum;
    they also hold what the model may lack. The correlations, which know nothing of your tests, do not count.

    Args:
        p: the case, all scalars; its angle is not used.
        particle: by name, in place of that of `p`; see `erosion.particle`.
        target: by name, in place of that of `p`; see `erosion.target`. It has the density and its correlations.
        spread: standard deviation of the angles of the particles in the jet [rad].
        speed_spread: standard deviation of the logarithm of their speeds; 0.1 is about 10 %.
        density: of the target [kg/m³], in place of that of `target`.
        cutting_fraction: the share of the particles that cut; see `PerMass`. Without it Finnie's 0.5, or with
            `uncertain` 1, as in a fit.
        models: models, names or paths.
        uncertain: laws of what is one number for all particles, but not known, by parameter: of the metal (k, psi,
            sigma), of a model's own, or "cutting_fraction"; or a fit or a posterior of tests of your own.
        job: what is to be removed, for the abrasive and the time that it takes.
        compare: another abrasive, whose erosion is compared with that of `particle`.
        progress: called with "models", how many are done, and how many there are.

    Raises:
        ValueError: for arguments out of range or unknown names.
        SimulationError: where a model removes nothing at any angle.
    """
    require_float64()
    require_parameters(p)
    grit = None if particle is None else read_particle(particle)
    metal = None if target is None else read_target(target)
    p = p if grit is None else p.with_particle(grit)
    p = p if metal is None else p.with_target(metal)
    if isinstance(models, str) or not models:
        raise ValueError(f"Argument `models` must be a list of models, but is {briefly(models)}.")
    chosen = [made_for(load_model(model), metal, grit) for model in models]
    unknown = _uncertain(uncertain, dict(ChainMap(*map(quantities, chosen))), p.shown_in)
    if cutting_fraction is None:
        cutting_fraction = CUTTING_FRACTION if unknown is None else FRACTION_OF_A_FIT
    per_mass = PerMass(density if metal is None else metal.density_beside(density), cutting_fraction)
    if unknown is not None and unknown.predictor is not None:
        fitted = model_name(unknown.predictor.problem.model)
        if [model_name(model) for model in chosen] != [fitted]:
            raise ValueError(f"Argument `models` must be the model of the fit, {fitted}, but is {briefly(models)}.")
    loaded = {called(given, model): model for given, model in zip(models, chosen, strict=True)}
    advice = advise_case(p, (grit, metal), (spread, speed_spread), per_mass, loaded, unknown, progress)
    return dataclasses.replace(advice, job=job, other=compared_with(compare, grit, metal))


def _uncertain(
    uncertain: JointLaw | JointSamples | Mapping[str, Any] | Fit | None, known: Mapping[str, Quantity], shown_in: System
) -> Uncertain | None:
    """The laws of what is not known, and the predictions of a fit where data tell the size of the wear."""
    if not isinstance(uncertain, Fit):
        law = joint_law(uncertain, "uncertain", known=known, shown_in=shown_in)
        return None if uncertain is None else Uncertain(law)
    predictor = None if uncertain.data.free_scale else uncertain.predictor
    return Uncertain(joint_law(uncertain.joint_samples()), predictor=predictor).of_metal({"": uncertain.problem.model})


def compared_with(other: str | Particle | None, grit: Particle | None, metal: Target | None) -> Particle | None:
    """The other abrasive; a `ValueError` where there is nothing to compare it with."""
    if other is None:
        return None
    if grit is None or metal is None:
        raise ValueError("Argument `compare` needs a particle and a target, by name.")
    try:
        return read_particle(other)
    except ValueError as error:
        raise ValueError(str(error).replace("Argument `particle`", "Argument `compare`")) from error


def advise_case(
    p: Parameters,
    named: tuple[Particle | None, Target | None],
    spreads: tuple[float, float],
    per_mass: PerMass,
    models: Mapping[str, CuttingModel],
    uncertain: Uncertain | None = None,
    progress: Progress = no_progress,
) -> Advice:
    """The same for a case that has its particle and its target already; `spreads` of angle [rad] and speed."""
    validate(p)
    require_scalars(p)
    (grit, metal), (spread, speed_spread) = named, spreads
    refuse(
        "Argument ",
        (not 0 < spread < np.deg2rad(45), f"`spread` must be above 0° and below 45°, but is {np.rad2deg(spread):g}°."),
        (not 0 <= speed_spread < 1, f"`speed_spread` must be at least 0 and below 1, but is {speed_spread:g}."),
    )
    if uncertain is not None:
        uncertain = uncertain.checked(models, p.shown_in)
        if uncertain.fraction is not None:
            per_mass = PerMass(per_mass.density, uncertain.fraction)
    correlations = _correlations(metal, grit)
    curves: list[Curve] = []
    jet = _Jet(p, spread, speed_spread, uncertain)
    total = len(models) + len(correlations)
    for done, (name, model) in enumerate(models.items()):
        progress("models", done, total)
        curves += jet.of_model(name, model, per_mass_of(model, per_mass))
    p = jet.p
    outside = [model.outside_of_range(p) for model in models.values()]
    for done, (model, fits) in enumerate(correlations, len(models)):
        progress("models", done, total)
        curves.append(jet.of_correlation(model.label, model, fits=fits, known=per_mass.density is not None))
        outside.append(model.outside_of_range(p))
    progress("models", total, total)
    advice = Advice(p, spread, speed_spread, per_mass, tuple(curves), grit, metal, uncertain=uncertain,
                    weighed=None if uncertain is None else uncertain.tested.get("alpha"))  # fmt: skip
    at = p.replace(alpha=advice.alpha)
    turned = [Finding("turned_beyond_at_best", name) for name, model in models.items() if turned_beyond(model, at)]
    return dataclasses.replace(advice, outside=unique([*filter(None, outside), *turned]))


def _correlations(metal: Target | None, grit: Particle | None) -> list[tuple[Correlated, bool]]:
    """Every correlation once, made for the target where it can be, and whether tests of the target stand behind it."""
    made: list[tuple[Correlated, bool]] = []
    for family in CORRELATIONS:
        if family == "dnv-polynomial":
            continue
        fits = metal is not None and bool(members(family, metal))
        # The others count for the angle.
        model = made_for(correlated(family), metal if fits else None, grit)
        assert isinstance(model, Correlated)
        made.append((model, fits))
    return made


class _Jet:
    """The particles of a jet at every angle of the nozzle."""

    def __init__(self, p: Parameters, spread: float, speed_spread: float, uncertain: Uncertain | None) -> None:
        law = stats.norm(_STEEP, spread)
        angles = law.ppf((np.arange(_DEVIATES) + 0.5) / _DEVIATES)
        speeds = np.ones(1)
        if speed_spread:
            speeds = stats.lognorm(speed_spread).ppf((np.arange(_SPEEDS) + 0.5) / _SPEEDS)
        self._p, self._law, self._uncertain = p, JointLaw({"alpha": law}), uncertain
        self.p = p  # of the first model's most usual draw, where there are draws
        self._values = {"alpha": np.repeat(angles, speeds.size), "v0": float(p.v0) * np.tile(speeds, angles.size)}

    def of_model(self, name: str, model: CuttingModel, per_mass: PerMass) -> Iterator[Curve]:
        """The curves of a model as it is, and with other k and ψ or with draws of what is uncertain."""
        if self._uncertain is not None and not isinstance(model, Correlated):
            made = self._of_draws if self._uncertain.predictor is None else self._of_predictor
            yield from made(name, model, per_mass, self._uncertain)
            return
        (erosion,) = self._erosion(name, model, per_mass, {"k": np.array([float(self._p.k)])})
        yield Curve(name, "models", "", erosion, per_mass.density, single=float(alpha_max(model, self._p).alpha))
        if not isinstance(model, Correlated):
            yield from self._of_ranges(name, model, per_mass)

    def _of_ranges(self, name: str, model: CuttingModel, per_mass: PerMass) -> Iterator[Curve]:
        """The curves of a model with k and ψ at the ends of their ranges."""
        case = {"k": float(self._p.k), "psi": float(self._p.psi)}
        changed = [(group, case | {group: factor * case[group]}) for group, factors in _FACTORS.items()
                   for factor in factors]  # fmt: skip
        varied = {parameter: np.array([setting[parameter] for _, setting in changed]) for parameter in case}
        for (group, setting), erosion in zip(changed, self._erosion(name, model, per_mass, varied), strict=True):
            words = f"{QUANTITIES[group].symbol} = {setting[group]:.3g}"
            yield Curve(name, group, words, erosion, per_mass.density)

    def _of_draws(self, name: str, model: CuttingModel, per_mass: PerMass, uncertain: Uncertain) -> Iterator[Curve]:
        """The curves of a model for draws of what is uncertain, and first that of the most usual draw.

        The medians of the parameters need not explain the rows where a fit leaves parameters open.
        """
        draws = uncertain.draws(model)
        shares = draws.pop(FRACTION, np.full(DRAWS, per_mass.cutting_fraction)) / per_mass.cutting_fraction
        # A share alone still needs a parameter to loop over.
        draws = draws or {"k": np.full(DRAWS, float(self._p.k))}
        parts = [slice(begin, begin + _AT_ONCE) for begin in range(0, DRAWS, _AT_ONCE)]
        erosion = np.concatenate([
            self._erosion(name, model, per_mass, {key: values[part] for key, values in draws.items()}) for part in parts
        ])  # fmt: skip
        erosion *= shares[:, None]
        usual = int(np.argmin(np.sum((erosion - np.median(erosion, axis=0)) ** 2, axis=1)))
        model, p = with_values(model, self._p, {key: float(values[usual]) for key, values in draws.items()})
        self.p = p if self.p is self._p else self.p
        yield Curve(name, "models", "", erosion[usual], per_mass.density, single=float(alpha_max(model, p).alpha))
        for number, curve in enumerate(erosion, 1):
            yield Curve(name, "draws", f"draw {number}", curve, per_mass.density)

    def _of_predictor(self, name: str, model: CuttingModel, per_mass: PerMass, uncertain: Uncertain) -> Iterator[Curve]:
        """The curves of a fit with what the model may lack, and first the one that is nearest to their middle."""
        predictor = uncertain.predictor
        assert predictor is not None
        problem = predictor.problem
        changed = {key: float(value) for key, value in dataclasses.asdict(self._p).items()
                   if key in QUANTITIES and key not in (*problem.names, "alpha")
                   and not np.isclose(value, getattr(problem.p, key), rtol=_ROUNDING, atol=0)}  # fmt: skip
        asked = {key: float(getattr(self._p, key)) for key in ("v0", "m")} | changed
        asked = InSI({key: value for key, value in asked.items() if key not in problem.names})
        single = predictor.draw(ANGLES, asked, _CURVES) * predictor.to_specific_volume(float(self._p.m))
        if FRACTION not in problem.names:
            single = single * per_mass.cutting_fraction / problem.cutting_fraction
        erosion = self._spread(model, single, predictor)
        draws = uncertain.draws(model)
        draws.pop(FRACTION, None)
        usual = {key: float(np.median(values)) for key, values in draws.items()}
        _, p = with_values(model, self._p, usual)
        self.p = p if self.p is self._p else self.p
        middle = int(np.argmin(np.sum((erosion - np.median(erosion, axis=0)) ** 2, axis=1)))
        best = float(highest(single[middle][None])[0])
        yield Curve(name, "models", "", erosion[middle], per_mass.density, single=best)
        for number, curve in enumerate(erosion, 1):
            yield Curve(name, "draws", f"draw {number}", curve, per_mass.density)

    def _spread(self, model: CuttingModel, single: np.ndarray, predictor: Predictor) -> np.ndarray:
        """Curves of single particles over `ANGLES`, (draws, angles), as those of the jet over `NOZZLE_ANGLES`."""
        particles = Particles(model, self._p, self._law)
        _, hits_at, hit = particles.impacts(self._values, NOZZLE_ANGLES[:, None])
        held = predictor.problem.held_exponent
        power = predictor.exponent[0] if predictor.exponent is not None else 2.0 if held is None else held
        faster = (self._values["v0"] / float(self._p.v0)) ** power
        grid = np.concatenate([[0.0], ANGLES])
        angles = np.broadcast_to(np.asarray(hits_at.alpha), hit.shape)
        curves = [np.interp(angles, grid, np.concatenate([[0.0], curve])) for curve in np.nan_to_num(single)]
        return np.stack([np.where(hit, curve * faster, 0.0).mean(axis=-1) for curve in curves])

    def of_correlation(self, name: str, model: CuttingModel, *, fits: bool, known: bool) -> Curve:
        """The curve of a correlation, whose absolute numbers may be made for another target."""
        per_mass = per_mass_of(model, PerMass())
        (erosion,) = self._erosion(name, model, per_mass, {"k": np.array([float(self._p.k)])})
        grains = model.grains if isinstance(model, CorrelatedByShape) else ""
        return Curve(name, "correlations", grains, erosion, per_mass.density if known else None, fits)

    def _erosion(self, name: str, model: CuttingModel, per_mass: PerMass, varied: dict[str, np.ndarray]) -> np.ndarray:
        """Volume per mass of particles at each setting and angle of the nozzle, shape (settings, angles) [m³/kg]."""
        particles = Particles(model, self._p, self._law)
        values = {**self._values, **{parameter: value[:, None, None] for parameter, value in varied.items()}}
        turned, hits_at, hit = particles.impacts(values, NOZZLE_ANGLES[:, None])
        volume = np.where(hit, impact(turned, hits_at).volume, 0.0).mean(axis=-1)
        if not np.isfinite(volume).all() or not (volume.max(axis=-1) > 0).all():
            raise SimulationError(f"{name}: removes nothing at any angle, or could not be computed.")
        return np.asarray(per_mass.specific_volume(volume, self._p))
