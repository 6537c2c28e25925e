"""The result of `advise`: curves over the nozzle's angle, the advised angle, warnings, and uncertainties."""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from erosion.advice.abrasives import Job, between, comparison, hardness_sentence
from erosion.fits.conditions import is_same
from erosion.fits.export import command, options_in_words
from erosion.fits.prediction import Predictor
from erosion.fits.problem import FACTORS, FRACTION, OF_METAL
from erosion.laws import SHARE, JointLaw
from erosion.models import CuttingModel, own_parameters, quantities, ranges
from erosion.models.correlated import Correlated
from erosion.output import format_number
from erosion.parameters import (
    BEYOND_TESTS,
    PER_MASS_SCALES,
    QUANTITIES,
    RESULTS,
    FarFromTests,
    Parameters,
    Particle,
    PerMass,
    Scale,
    System,
    Target,
    far_from_tests,
    two_digits,
)
from erosion.results import Columns, Declared, Finding, Mark, Result, Value
from erosion.streams.tally import Points

DRAWS = 64
_SAME_ANGLE = 1e-6  # rad: an angle in degrees is read and written with rounding


@dataclasses.dataclass(frozen=True)
class Uncertain:
    """Laws of what is one number for all particles, but not known.

    Args:
        laws: of parameters of the metal or of a model's own, or of "cutting_fraction".
        source: words for where they come from; without it they are made from the laws.
        values: the median of each parameter, and where 95 % of its law lies: "k = 1.29 (1.03 … 1.61)".
        predictor: of the fit that the laws are from; its curves, which also hold what the model may lack, take the
            place of the model's.
    """

    laws: JointLaw
    source: str = ""
    values: tuple[str, ...] = ()
    predictor: Predictor | None = None

    @property
    def holds(self) -> str:
        """The meaning of the 95 % band of the curves, in words."""
        return "if the model is right" if self.predictor is None else f"of {', '.join(self.predictor.parts)}"

    @property
    def tested(self) -> Mapping[str, tuple[float, float]]:
        """The least and the greatest angle, speed and mass of the tests of a fit, in SI; empty where not known."""
        return next((table.tested for table in self.laws.samples if table.tested), {})

    def __str__(self) -> str:
        tables = dict.fromkeys(table.source for table in self.laws.samples)
        return self.source or ", ".join(tables) or f"the laws of {', '.join(self.laws.names)}"

    def checked(self, models: Mapping[str, CuttingModel], system: System) -> "Uncertain":
        """The same with `values`, in units for tables.

        Raises:
            ValueError: where a model does not have one of the parameters, or the laws make no sense.
        """
        if not self.laws:
            raise ValueError("Argument `uncertain` must have a law, but has none.")
        if all(isinstance(model, Correlated) for model in models.values()):
            raise ValueError("Argument `models` must have one that takes what is uncertain; a correlation does not.")
        self.require_of_metal(models)
        for model in models.values():
            self._within(model)
        return dataclasses.replace(self, values=tuple(self._values(models, system)))

    def require_of_metal(self, models: Mapping[str, CuttingModel], where: str = "Argument `uncertain`") -> None:
        """A `ValueError` that begins with `where` for a law of what the metal and a model do not have."""
        for name, model in models.items():
            known = (*OF_METAL, *own_parameters(model))
            if strange := [parameter for parameter in self.laws.names if parameter not in known]:
                wanted = f"parameters of the metal or of {name} ({', '.join(known)})"
                raise ValueError(f"{where} must name {wanted}, but has {strange[0]}.")

    def of_metal(self, models: Mapping[str, CuttingModel]) -> "Uncertain":
        """The same without the laws of particle and jet: they are of the tests of a fit, and an advice has its own."""
        known = {*OF_METAL, *(name for model in models.values() for name in own_parameters(model))}
        return dataclasses.replace(self, laws=self.laws.only(known))

    def _values(self, models: Mapping[str, CuttingModel], system: System) -> Iterator[str]:
        known = dict(FACTORS)
        for model in models.values():
            known |= quantities(model)
        for name, law in self.laws.marginals.items():
            low, middle, high = (float(value) for value in law.ppf(np.array([0.025, 0.5, 0.975])))
            scale = known[name].scale(system, abs(middle))
            ends = [format_number(value, 3, scale.size) for value in (middle, low, high)]
            yield f"{known[name].symbol} = {ends[0]} ({ends[1]} … {ends[2]}) {scale.unit}".rstrip()

    @functools.cached_property
    def fraction(self) -> float | None:
        """The median share of the particles that cut, where it is uncertain."""
        law = self.laws.marginals.get(FRACTION)
        return None if law is None else float(law.ppf(np.array([0.5]))[0])

    def draws(self, model: CuttingModel) -> dict[str, np.ndarray]:
        """The parameters of the draws, shape (DRAWS,) each; always the same."""
        laws = self._within(model)
        return laws.draw(Points("sobol", laws.dimension, 0, 1).take(DRAWS)[0])

    def _within(self, model: CuttingModel) -> JointLaw:
        return self.laws.within({**ranges(model), FRACTION: SHARE})


NOZZLE_ANGLES = np.deg2rad(np.arange(1.0, 90.5, 0.5))
"""The angles of the nozzle that are compared [rad]."""


FIT = (
    "erosion calibrate rows.csv --model linearized-deformation,rotating-deformation --free k,psi,energy_ratio "
    "--write-case fitted.toml"
)
"""The command that fits weighings for an advice, but for the case.

Metals wear at 90°, too, and how much decides the place of the maximum: so the models are those with wear by
deformation, and its energy ratio is free. The models without it have no such curve.
"""


@dataclasses.dataclass(frozen=True)
class Curve:
    """Erosion by a jet over the angle of the nozzle, by one model or correlation.

    Args:
        name: of the model or correlation.
        group: "models", "k", "psi", "draws" or "correlations": what differs within the group.
        setting: what differs from the case, "k = 1" or "draw 3", the shape that a correlation counts, or "".
        erosion: volume per mass of particles at `NOZZLE_ANGLES`, shape (n,) [m³/kg].
        density: of the target [kg/m³], or None.
        fits: whether the absolute numbers are made for this target.
        single: of a model as it is, the best angle of attack of one particle without the spread of the jet [rad].
    """

    name: str
    group: str
    setting: str
    erosion: np.ndarray
    density: float | None
    fits: bool = True
    single: float | None = None

    @functools.cached_property
    def best(self) -> float:
        """The angle of the nozzle that removes most [rad], by the parabola through the three highest points."""
        top = int(np.clip(np.argmax(self.erosion), 1, self.erosion.size - 2))
        before, at, after = self.erosion[top - 1 : top + 2]
        bend = before - 2 * at + after
        shift = 0.0 if bend == 0 else float(np.clip(0.5 * (before - after) / bend, -1, 1))
        return float(NOZZLE_ANGLES[top] + shift * (NOZZLE_ANGLES[1] - NOZZLE_ANGLES[0]))

    @property
    def shares(self) -> np.ndarray:
        """Erosion over its greatest value, shape (n,)."""
        return self.erosion / self.erosion.max()

    def share(self, alpha: float) -> float:
        """Erosion at an angle of the nozzle over its greatest value."""
        return float(np.interp(alpha, NOZZLE_ANGLES, self.shares))

    def at(self, alpha: float) -> float:
        """Erosion at an angle of the nozzle: mass per mass [kg/kg], or volume per mass [m³/kg] without a density."""
        return float(np.interp(alpha, NOZZLE_ANGLES, self.erosion)) * (self.density or 1.0)


@dataclasses.dataclass(frozen=True, repr=False)
class Advice(Result):
    """A nozzle's angle, and what speaks for it.

    Args:
        p: the case; its angle is not used.
        spread: standard deviation of the angles in the jet [rad].
        speed_spread: standard deviation of the logarithm of the speeds.
        per_mass: density of the target, share of the particles that cut.
        curves: every model, its variations, and every correlation.
        particle, target: where they were named.
        outside: findings on models at the advised angle that turn the body too far, and on models out of range.
        uncertain: the laws that took the place of the ranges of k and ψ, from a fit for example.
        doubts: findings on the fit that it rests on.
        weighed: the least and the greatest angle of its tests [rad]; the advised angle is between them.
        job: what is to be removed.
        other: another abrasive, to compare with `particle`.
        words: the case as it is typed behind a verb, for the commands that go on from here.
        rows_file: the path of its tests.
        tests_typed: how they were fitted, see `Fit.typed`.
    """

    p: Parameters
    spread: float
    speed_spread: float
    per_mass: PerMass
    curves: tuple[Curve, ...]
    particle: Particle | None = None
    target: Target | None = None
    outside: tuple[Finding, ...] = ()
    uncertain: Uncertain | None = None
    doubts: tuple[Finding, ...] = ()
    weighed: tuple[float, float] | None = None
    job: Job | None = None
    other: Particle | None = None
    words: tuple[str, ...] = ()
    rows_file: str = "rows.csv"
    tests_typed: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @functools.cached_property
    def alpha(self) -> float:
        """The advised angle of the nozzle [rad], where `shares` are greatest among the angles of the tests."""
        angles = NOZZLE_ANGLES if self.weighed is None else np.clip(NOZZLE_ANGLES, *self.weighed)
        return float(angles[int(np.argmax(np.interp(angles, NOZZLE_ANGLES, self.shares)))])

    @property
    def counted(self) -> Sequence[Curve]:
        """All curves decide, or after a fit its draws alone, for its tests know this metal."""
        return self.curves if self.uncertain is None else self.group("draws")

    @functools.cached_property
    def shares(self) -> np.ndarray:
        """The least share that a counted curve removes at each angle of its own greatest erosion, shape (n,).

        Draws are as many as they are likely: there it is the mean. The least of them is that of the least likely.
        """
        shares = np.array([curve.shares for curve in self.counted])
        return shares.min(axis=0) if self.uncertain is None else shares.mean(axis=0)

    @property
    def share(self) -> float:
        """`shares` at the advised angle."""
        return float(np.interp(self.alpha, NOZZLE_ANGLES, self.shares))

    @property
    def low(self) -> float:
        """The least of the counted curves' own best angles [rad]; of draws of the middle 95 %."""
        return ends(self.counted, lambda curve: curve.best)[0]

    @property
    def high(self) -> float:
        """The greatest of them [rad]."""
        return ends(self.counted, lambda curve: curve.best)[1]

    @property
    def worst(self) -> float:
        """The share of its own greatest erosion that every counted curve, or 95 % of draws, reaches at `alpha`."""
        return ends(self.counted, lambda curve: curve.share(self.alpha))[0]

    def group(self, name: str) -> list[Curve]:
        """The curves of a group; those of "k", "psi" and "draws" beside the models as they are."""
        return [curve for curve in self.curves if curve.group == name]

    @property
    def title(self) -> str:
        """Particle, target and speed."""
        particle = "the particle of the case" if self.particle is None else str(self.particle)
        target = "the target of the case" if self.target is None else self.target.name
        title = f"{particle} on {target} at {float(self.p.v0):.4g} m/s: {degrees(self.alpha)}"
        return f"{title[0].upper()}{title[1:]}"

    @property
    def unit(self) -> str:
        """The unit of erosion in the table, "g/kg", or "mm³/kg" where the density is not known."""
        return self.scale.unit

    @property
    def scale(self) -> Scale:
        """The unit and its size in SI."""
        return PER_MASS_SCALES["specific_volume" if self.per_mass.density is None else "erosion_ratio"]

    @property
    def weighings(self) -> tuple[np.ndarray, np.ndarray]:
        """Angles [rad] and erosion [`unit`] of the tests at the case's speed; none without a fit of their size."""
        predictor = None if self.uncertain is None else self.uncertain.predictor
        if predictor is None:
            return np.empty(0), np.empty(0)
        data = predictor.data
        speed = predictor.problem.p.v0 if data.speed is None else data.speed
        here = np.broadcast_to(is_same(speed, float(self.p.v0)), data.angle.shape)
        factor = predictor.to_specific_volume(float(self.p.m)) * (self.per_mass.density or 1.0)
        return data.angle[here], data.erosion[here] * factor / self.scale.size

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Declared]:
        """A table of what varies; for programs the advised angle, and every curve's best angle and erosion there."""
        angle = functools.partial(QUANTITIES["alpha"].declare, only="data")
        named = {name: getattr(self, name) for name in ("particle", "target", "uncertain")}
        return [
            self._comparison(),
            *(angle(name, getattr(self, name)) for name in ("alpha", "low", "high", "spread")),
            Value("worst_share", self.worst, only="data"),
            Value("speed_spread", self.speed_spread, only="data"),
            Value("density", self.per_mass.density, unit="kg/m^3", only="data"),
            Value("cutting_fraction", self.per_mass.cutting_fraction, only="data"),
            *(Value(name, None if each is None else str(each), only="data") for name, each in named.items()),
            self._of_each_curve(),
            Value("statements", [*self.conclusions], dims=("statement",), only="data"),
        ]

    def _comparison(self) -> Columns:
        """What varies, the range of best angles, and what the advised angle gives."""
        groups, at = list(self._compared()), degrees(self.alpha)
        models = self.group("models")
        alone = "without the spread of the jet" if len(models) == 1 else "the models without the spread of the jet"
        singles = sorted(curve.single for curve in models if curve.single is not None)
        best = [*(tuple(ends(curves, lambda curve: curve.best)) for _, curves in groups), (singles[0], singles[-1])]
        shares = [ends(curves, lambda curve: curve.share(self.alpha))[0] for _, curves in groups]
        fitting = [[curve for curve in curves if curve.fits] for _, curves in groups]
        beyond = Mark([*map(self._is_beyond, fitting), False], BEYOND_TESTS)
        columns = [
            Value("curves", [*(words for words, _ in groups), alone], "what varies"),
            QUANTITIES["alpha"].declare("best", best, symbol="best nozzle angle", digits=2),
            Value("share", [*shares, None], f"least share at {at}", scale=Scale(0.01, "%"), digits=3),
            Value("erosion", [*map(self._amounts, fitting), None], f"erosion at {at}", scale=self.scale, digits=2,
                  marks=[beyond]),
        ]  # fmt: skip
        return Columns("comparison", "What varies", columns, only="table")

    def _compared(self) -> Iterator[tuple[str, Sequence[Curve]]]:
        """Curves that are compared, with words for what differs among them."""
        models, draws, correlations = map(self.group, ("models", "draws", "correlations"))
        count = models[0].name if len(models) == 1 else f"{len(models)} models"
        yield f"{count}, k = {float(self.p.k):.4g}, ψ = {float(self.p.psi):.4g}", models
        for name in ("k", "psi"):
            if varied := self.group(name):
                least, greatest = varied[0].setting, varied[-1].setting
                yield f"{least.replace(' =', ' from')} to {greatest.partition(' = ')[2]}", varied
        if draws:
            yield f"{len(draws)} curves that the tests allow ({self.uncertain}), 95% of them", draws
        if correlations:
            yield f"{len(correlations)} correlations of tests", correlations
        for curve in correlations:
            yield f"· {curve.name}{f', {curve.setting}' if curve.setting else ''}", [curve]

    def _of_each_curve(self) -> Columns:
        """Each curve's best angle, and what it gives at the advised angle."""
        curves, angle = self.curves, QUANTITIES["alpha"].declare
        columns = [
            *(Value(name, [getattr(curve, name) for curve in curves]) for name in ("name", "group", "setting", "fits")),
            angle("alpha_max", [curve.best for curve in curves]),
            angle("single_alpha_max", [curve.single for curve in curves]),
            Value("share", [curve.share(self.alpha) for curve in curves]),
        ]
        for name in ("specific_volume", "erosion_ratio"):
            has = [(curve.density is None) == (name == "specific_volume") for curve in curves]
            amounts = [curve.at(self.alpha) if of_it else None for curve, of_it in zip(curves, has, strict=True)]
            columns += [RESULTS[name].in_si(name, amounts)] if any(has) else []
        return Columns("curves", "Curves", columns, only="data")

    def _far(self, curves: Sequence[Curve]) -> FarFromTests | None:
        """The greatest erosion of curves, of 95 % of draws, at the advised angle, where tests find nothing like it."""
        removed = ends(curves, lambda curve: curve.at(self.alpha) / (curve.density or 1.0)) if curves else []
        return far_from_tests(removed, float(self.p.v0), self.per_mass.density)

    def _is_beyond(self, curves: Sequence[Curve]) -> bool:
        """Whether that is more than ten times what any test finds, and so no amount to tell anyone."""
        far = self._far(curves)
        return far is not None and far.is_beyond

    def _amounts(self, curves: Sequence[Curve]) -> tuple[float, ...] | None:
        """The least and the greatest erosion of curves at the advised angle; None without curves and beyond tests."""
        if not curves or self._is_beyond(curves):
            return None
        return tuple(ends(curves, lambda curve: curve.at(self.alpha)))

    def _in_words(self, curves: Sequence[Curve]) -> str:
        """The same as text."""
        amounts = self._amounts(curves)
        return "–" if amounts is None else between(two_digits(amount / self.scale.size) for amount in amounts)

    @property
    def trusted(self) -> Sequence[Curve]:
        """The curves whose amounts count, of correlations of this metal, of the draws of a fit, or of models.

        None where the models' amount is more than ten times what tests find.
        """
        fitting = [curve for curve in self.group("correlations") if curve.fits]
        if self.uncertain is None and fitting:
            return fitting
        models = [curve for curve in self.curves if curve.group != "correlations"]
        return [] if self._is_beyond(models) else models

    @property
    def conclusions(self) -> list[str]:
        """The answers and their reasons, in sentences."""
        return [*self.answers, *self.reasons]

    @property
    def answers(self) -> list[str]:
        """Angle, amount, the job, the other abrasive."""
        mine = "" if self.uncertain is None else "By your weighings: "
        sentences = [
            mine + f"set the nozzle to {degrees(self.alpha)} from the surface.",
            self._amount(),
        ]
        if self.job is not None and self.trusted:
            erosion = ends(self.trusted, lambda curve: curve.at(self.alpha) / (curve.density or 1.0))
            job = self.job.sentence(erosion, self.per_mass.density)
            sentences.append(job if self.uncertain is None else f"By 95% of these curves: {job}")
        if self.other is not None and self.particle is not None and self.target is not None:
            names = (str(self.particle), str(self.other))
            speed = float(self.p.v0)
            sentences.append(comparison(self.particle, self.other, self.target, speed, names))
        return [f"{sentence[0].upper()}{sentence[1:]}" for sentence in sentences]

    @property
    def reasons(self) -> list[str]:
        """Why this angle, what would narrow it, and what the abrasive does."""
        sentences = [self._why(), self._narrowing()]
        if self.particle is not None and self.target is not None:
            name = self.particle.name
            sentences.append(hardness_sentence(self.particle, self.target, name))
        if self.particle is not None and self.particle.shape == "round":
            sentences.append(
                "The models take a sharp edge; round particles plough more and cut less, so expect less: 0.2 "
                "times by E/CRC's factor for rounded sand."
            )
        return [f"{sentence[0].upper()}{sentence[1:]}" for sentence in sentences]

    @property
    def findings(self) -> list[Finding]:
        """A size that fits no body, correlations out of range, amounts far from tests, and doubts of the fit."""
        far = self._far([curve for curve in self.curves if curve.group != "correlations"])
        found = (self.p.size_finding, *self.outside, far.finding() if far else None)
        return [*filter(None, found), *self.doubts]

    def _why(self) -> str:
        """What the advised angle is worth by the curves that count."""
        share, span = _percent(self.share), f"from {degrees(self.low)} to {degrees(self.high)}"
        if self.uncertain is None:
            return (
                f"At this angle every model and correlation removes at least {share}% of what it removes at its own "
                f"best angle; these best angles lie {span}."
            )
        return (
            f"At this angle the {len(self.group('draws'))} curves that the tests allow ({self.uncertain}) remove on "
            f"average {share}% of what they remove at their own best angles, and 95% of them at least "
            f"{_percent(self.worst)}%; 95% of these best angles lie {span}. The correlations are made from other "
            "tests, and do not count."
        )

    def _amount(self) -> str:
        models = [curve for curve in self.curves if curve.group != "correlations"]
        fitting = [curve for curve in self.group("correlations") if curve.fits]
        share = self.per_mass.cutting_fraction
        amount, tests = f"{self._in_words(models)} {self.unit}", f"{self._in_words(fitting)} {self.unit}"
        cutting = f"if {'all' if share == 1 else f'{share:.3g}'} of the particles cut"
        if self._is_beyond(models) and fitting:
            text = (
                f"Expect {tests}, by the correlations for this metal. The models' amount is left out, because it is "
                "more than ten times what tests find."
            )
        elif self._is_beyond(models):
            text = (
                "The models' amount is left out, because it is more than ten times what tests find, and no correlation "
                "is made for this metal."
            )
        elif self.uncertain is not None:
            text = f"Expect {amount}: 95% {self.uncertain.holds}{'' if share == 1 else f', {cutting}'}."
            if fitting:
                text += f" The correlations for this metal, made from other tests, say {tests}."
        elif fitting:
            text = (
                f"Expect {tests}, by the correlations for this metal. The models say {amount} {cutting}: trust the "
                "correlations more."
            )
        else:
            text = f"Expect {amount}, by the models, {cutting}."
        return text if self.per_mass.density else f"{text} Name the target, or give its density, for g/kg."

    def _narrowing(self) -> str:
        """What would narrow the range of best angles most."""
        best = float(NOZZLE_ANGLES[np.argmax(self.shares)])
        if abs(best - self.alpha) > _SAME_ANGLE:
            return (
                f"What would narrow it: weigh at {degrees(best)}, too. The fit removes most there, but no weighing of "
                f"yours is that {'flat' if best < self.alpha else 'steep'}."
            )
        if self.uncertain is not None:
            if not all(self.tests_typed.get("prior", {}).values()):
                return (
                    "What would narrow it: more tests. The function `erosion.next_test` says at which angle and speed "
                    "one more test narrows the prediction most; no option states the priors of this fit."
                )
            asked = options_in_words({**self.tests_typed, "free": ",".join(self.uncertain.laws.names)})
            words = (self.rows_file, *self._typed, *asked, "--next-test")
            return (
                f"What would narrow it: more tests. “{command('posterior', *words)}” says at which angle and speed one "
                "more test narrows the prediction most (extra posterior)."
            )
        models = self.group("models")
        spans = {"the choice of the model": _width(models)}
        for name, words in (("k", "the force ratio k"), ("psi", "the contact ratio ψ")):
            widths = [_width([*self.group(name), model], model.name) for model in models]
            spans[words] = max(widths, default=0.0)
        widest = max(spans, key=lambda name: spans[name])
        return (
            f"What would narrow it: {widest} moves the best angle of the models most, by up to "
            f"{degrees(spans[widest])}. Weigh the loss at six angles, 15° to 90° in steps of 15°, with your own "
            "abrasive and metal, and write the rows into rows.csv. Then "
            f"“{command(*FIT.split()[1:], *self._typed)}”, and “erosion advise fitted.toml”."
        )

    @property
    def _typed(self) -> tuple[str, ...]:
        """`words`, or the names of particle, target and models that stand for them."""
        # After a fit the speed of its tests, where they have one.
        tested = {} if self.uncertain is None else self.uncertain.tested
        speed = tested.get("v0", (float(self.p.v0),))[0]
        named = {"particle": self.particle, "target": self.target, "v0": f"{speed:g} m/s"}
        if self.uncertain is not None:
            named["model"] = ",".join(curve.name for curve in self.group("models"))
        return self.words or tuple(options_in_words(named))


_LIKELY = 0.025, 0.975  # the middle 95 %


def ends(curves: Sequence[Curve], of: Callable[[Curve], Any]) -> list[Any]:
    """The least and the greatest number of curves; where draws are among them, the ends of the middle 95 % of draws.

    Args:
        curves: one or more.
        of: the number of a curve, or its numbers over the angle, shape (n,).
    """
    draws = [of(curve) for curve in curves if curve.group == "draws"]
    return list(np.quantile(draws or [of(curve) for curve in curves], _LIKELY if draws else (0.0, 1.0), axis=0))


def degrees(alpha: float) -> str:
    """An angle for people: "27°"; of less than 10° with a decimal."""
    value = float(np.rad2deg(alpha))
    return f"{value:.1f}°" if value < 9.95 else f"{value:.0f}°"


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _width(curves: Sequence[Curve], name: str | None = None) -> float:
    """Between the least and the greatest best angle of curves, of one name where it is given [rad]."""
    best = [curve.best for curve in curves if name in (None, curve.name)]
    return max(best) - min(best) if best else 0.0
