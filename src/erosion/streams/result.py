"""Removal by a stream, with errors, and the nozzle's best angle.

The same particles are used at all angles (common random numbers), so the mean volume is a
function of the angle alone. It is smooth where the volume of a single particle jumps, and its
maximum is at another angle than that of a single particle.
"""

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar

from erosion.arguments import Progress, no_progress
from erosion.impacts import (
    alpha_max,
    count_turned,
    finding_of_turned,
    impact,
    model_in_words,
    provenance,
    pushed_forward,
    turned_beyond,
)
from erosion.models import CuttingModel, impact_to_dict, model_name, own_quantities, quantities
from erosion.output import Record
from erosion.parameters import (
    PER_MASS_SCALES,
    QUANTITIES,
    RESULTS,
    FarFromTests,
    PerMass,
    Scale,
    declare_result,
    far_from_tests,
)
from erosion.results import Columns, Declared, Finding, Result, System, Value
from erosion.streams.tally import Estimate, Particles, Points, Tally

_ANGLES = np.deg2rad(np.linspace(2.0, 90.0, 45))
_DRAWN = 2**11  # particles of a replicate
_LANES = 2**20  # impacts of one call
_PRECISION = 1e-5  # rad; of the best angle


@dataclasses.dataclass(frozen=True)
class NozzleAngle:
    """The best angle of the nozzle, and the mean volume over all angles.

    Args:
        alpha: the angle that removes most [rad].
        volume: mean volume of a particle there [m³].
        at_edge: whether the best angle is the first or last of `angles`.
        angles: of the nozzle, shape (n,) [rad].
        curve: mean volume of a particle at each, shape (n,) [m³].
        curve_error: its standard error, shape (n,) [m³].
        single_alpha: the best angle of one typical particle (see `Particles.typical`) [rad].
        single_kind: the kind of that optimum, see `Optimum`.
        single_angles: angles of attack, shape (k,) [rad].
        single_curve: its volume at each, shape (k,) [m³].
        single_beyond: whether its body turns by more than 90° there, shape (k,).
    """

    alpha: Estimate
    volume: Estimate
    at_edge: bool
    angles: np.ndarray
    curve: np.ndarray
    curve_error: np.ndarray
    single_alpha: float
    single_kind: str
    single_angles: np.ndarray
    single_curve: np.ndarray
    single_beyond: np.ndarray


def best_nozzle_angle(
    particles: Particles,
    points: str,
    seed: int,
    *,
    replicates: int = 16,
    rtol: float = 1e-9,
    progress: Progress = no_progress,
) -> NozzleAngle:
    """Maximise the mean volume over the nozzle's angle, in each replicate and in all together.

    Args:
        particles: their deviations from the nozzle's angle stay as they are drawn.
        points: see `Points`.
        seed: of the points.
        replicates: independent sets of 2048 particles; the spread of their best angles gives the interval.
        rtol: see `impact`.
        progress: called with "angles", the number of angles of the curve that are done, and of all.
    """
    sample = particles.draw(Points(points, particles.dimension, seed, replicates).take(_DRAWN))

    def means(angles: np.ndarray, part: slice = slice(None)) -> np.ndarray:
        """Mean volume of some replicates at each angle, shape (replicates, angles) [m³]."""
        values = {name: value[part][..., None, :] for name, value in sample.items()}
        model, p, hits = particles.impacts(values, angles[:, None])
        return np.nanmean(np.where(hits, impact(model, p, rtol=rtol).volume, 0.0), axis=-1)

    def best(curve: np.ndarray, part: slice = slice(None)) -> float:
        """The best angle of some replicates [rad], near the top of their mean curve."""
        top = int(np.argmax(curve))
        around = _ANGLES[max(top - 1, 0)], _ANGLES[min(top + 1, len(_ANGLES) - 1)]
        minimum: Any = minimize_scalar(
            lambda angle: -np.mean(means(np.array([angle]), part)),
            bounds=around,
            method="bounded",
            options={"xatol": _PRECISION},
        )
        return float(minimum.x)

    parts, at_once = [], max(1, _LANES // (replicates * _DRAWN))
    for begin in range(0, len(_ANGLES), at_once):
        parts.append(means(_ANGLES[begin : begin + at_once]))
        progress("angles", min(begin + at_once, len(_ANGLES)), len(_ANGLES))
    curves = np.concatenate(parts, axis=1)
    tops = np.array([best(curve, slice(i, i + 1)) for i, curve in enumerate(curves)])
    alpha = best(curves.mean(axis=0))
    model, typical = particles.typical
    single = alpha_max(model, typical)
    single_angles = np.linspace(_ANGLES[0], _ANGLES[-1], 500)
    at_angles = typical.replace(alpha=single_angles)
    return NozzleAngle(
        alpha=Estimate.of(tops, alpha),
        volume=Estimate.of(means(np.array([alpha]))[:, 0]),
        at_edge=bool(min(abs(alpha - _ANGLES[0]), abs(alpha - _ANGLES[-1])) < 3 * _PRECISION),
        angles=_ANGLES,
        curve=curves.mean(axis=0),
        curve_error=curves.std(axis=0, ddof=1) / np.sqrt(replicates),
        single_alpha=float(single.alpha),
        single_kind=str(single.kind),
        single_angles=single_angles,
        single_curve=np.asarray(impact(model, at_angles, rtol=rtol).volume),
        single_beyond=turned_beyond(model, at_angles),
    )


_DRAWS = 2**8  # the standard deviation is known to 4 %
_PARTICLES = 2**10  # for each draw the same ones, so that their noise is not taken for an effect of the parameters


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """The means of a stream for draws of the uncertain parameters.

    Args:
        volume: mean removed volume of a particle, shape (draws,) [m³].
        mass: mean mass of a particle, shape (draws,) [kg].
    """

    volume: np.ndarray
    mass: np.ndarray

    @property
    def erosion(self) -> np.ndarray:
        """Removed volume per mass of particles if every particle cuts, shape (draws,) [m³/kg]."""
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
    model, p, hits = particles.impacts(particles.draw(points, draws[:, None]))
    volume = np.where(hits, impact(model, p, rtol=rtol).volume, 0.0)
    computed = np.isfinite(volume)
    counts = computed.sum(axis=1)
    mass = np.broadcast_to(np.asarray(p.m), volume.shape)
    sums = [np.where(computed, values, 0.0).sum(axis=1)[counts > 0] for values in (volume, mass)]
    return Uncertainty(*(total / counts[counts > 0] for total in sums))


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_OF_RANGE = 2**12  # particles by which the share outside of a range is known well enough


@dataclasses.dataclass(frozen=True, repr=False)
class Stream(Result):
    """The erosion of a stream of particles.

    Args:
        particles: model and case, and the laws of their parameters.
        tally: counts and moments of the particles.
        ends: the outcomes of a particle, the columns of `tally.ends`.
        nozzle: the stream's own best angle, or None where it was not asked for.
        sensitivities: by parameter, or by parameters that are tied ("alpha, v0"), the shares of the volume's
            variance that it causes alone (first order) and with its interactions (total), or None for a
            single law, a joint one too, or where nothing is removed.
        per_mass: the share of the particles that cut, and the density of the target, for `erosion` and
            `erosion_ratio`; `dataclasses.replace(jet, per_mass=erosion.PerMass(2700, 0.5))`.
        uncertainty: the means for draws of the uncertain parameters; None where there are none.
    """

    particles: Particles
    tally: Tally
    ends: tuple[str, ...]
    nozzle: NozzleAngle | None = None
    sensitivities: Mapping[str, tuple[Estimate, Estimate]] | None = None
    per_mass: PerMass = dataclasses.field(default_factory=PerMass)
    uncertainty: Uncertainty | None = None

    @property
    def model(self) -> CuttingModel:
        """The model of the cut."""
        return self.particles.model

    @property
    def n(self) -> int:
        """Number of particles computed."""
        return self.tally.drawn * len(self.tally.mean)

    @property
    def mean_volume(self) -> Estimate:
        """Removed volume of a particle [m³]."""
        return Estimate.of(self.tally.mean)

    @property
    def mean_quantities(self) -> dict[str, Estimate]:
        """The quantities of the model's own of a particle, by name; see `erosion.own_quantity`."""
        return {name: Estimate.of(own.mean) for name, own in self.tally.own.items()}

    def _means(self) -> Iterator[Value]:
        """The means of a particle's own quantities."""
        means = self.mean_quantities
        for name, quantity in own_quantities(type(self.model)).items():
            more = {"symbol": f"{quantity.symbol}\u0304", "meaning": f"{quantity.meaning}, mean of the stream"}
            yield quantity.declare(f"mean_{name}", means[name].value, error=means[name].error, **more)

    @property
    def total_volume(self) -> float:
        """Volume removed by all particles computed [m³]."""
        return float(self.tally.counted @ self.tally.mean)

    @property
    def deviation(self) -> float:
        """Standard deviation of the volume from particle to particle [m³]."""
        return self.tally.deviation

    @property
    def mean_mass(self) -> Estimate:
        """Mass of a particle [kg]."""
        return Estimate.of(self.tally.mass / self.tally.counted)

    @property
    def erosion(self) -> Estimate:
        """Removed volume per unit mass of particles [m³/kg]; particles that miss are abrasive too."""
        removed = self.per_mass.cutting_fraction * self.tally.counted * self.tally.mean
        return Estimate.of(removed / self.tally.mass, float(removed.sum() / self.tally.mass.sum()))

    @property
    def erosion_ratio(self) -> Estimate | None:
        """Mass loss per mass of particles [kg/kg]; None where the density of the target is not known."""
        if self.per_mass.density is None:
            return None
        return Estimate(*(self.per_mass.density * number for number in dataclasses.astuple(self.erosion)))

    @property
    def _far(self) -> FarFromTests | None:
        """The same in numbers, whether an amount is asked for or not."""
        speed = float(np.mean(self._sample.get("v0", self.particles.p.v0)))
        return far_from_tests(self.erosion.value, speed, self.per_mass.density)

    @property
    def parameter_errors(self) -> dict[str, float]:
        """The standard deviations of `mean_volume`, `erosion` and `erosion_ratio` by the uncertain parameters.

        They do not fall with the number of particles. The errors of the estimates are those of sampling alone. Empty
        where no parameter is uncertain.
        """
        if self.uncertainty is None:
            return {}
        fraction = self.per_mass.cutting_fraction
        errors = {
            "mean_volume": float(np.std(self.uncertainty.volume, ddof=1)),
            "erosion": fraction * float(np.std(self.uncertainty.erosion, ddof=1)),
        }
        if self.erosion_ratio is not None:
            errors["erosion_ratio"] = errors["erosion"] * self.erosion_ratio.value / self.erosion.value
        return errors

    @property
    def error_meaning(self) -> str:
        """The meaning of the errors and intervals of the estimates, in words."""
        others = "uncertain parameters apart" if self.uncertainty is not None else "all other parameters taken as exact"
        return f"the error by sampling these particles alone, {others}"

    @property
    def shares(self) -> dict[str, Estimate]:
        """Share of the particles by outcome, for the outcomes that occur."""
        shares = self.tally.ends / self.tally.drawn
        return {end: Estimate.of(shares[:, i]) for i, end in enumerate(self.ends) if shares[:, i].any()}

    @property
    def quantiles(self) -> dict[float, float]:
        """Volume that 5, 25, 50, 75 and 95 % of the particles do not exceed [m³], to 0.12 %."""
        return {share: self.tally.quantile(share) for share in QUANTILES}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """A force of the wrong sign, particles out of range or turned too far, and erosion far from that of tests."""
        far = self._far if self.per_mass.is_given else None
        too_far = far.finding() if far else None
        pushed = Finding("pushed_forward") if pushed_forward(*self.particles.typical) else None
        found = (pushed, self.outside_of_range, finding_of_turned(self._turned), too_far)
        return tuple(finding for finding in found if finding is not None)

    @property
    def outside_of_range(self) -> Finding | None:
        """The finding on particles outside of the range that the model is made for, from 4096 of them."""
        model, p, hits = self.particles.impacts(self._sample)
        return model.outside_of_range(p, hits)

    @functools.cached_property
    def _turned(self) -> np.ndarray:
        """In how many impacts the body turns by more than 90°, and of how many; see `count_turned`."""
        model, p, hits = self.particles.impacts(self._sample)
        return count_turned(model, p, hits)

    @property
    def _sample(self) -> Mapping[str, np.ndarray]:
        """What varies, of a few thousand particles."""
        return self.particles.draw(Points("sobol", self.particles.dimension, 0, 1).take(_OF_RANGE)[0])

    @property
    def subject(self) -> Record:
        """The model, the case and the laws."""
        return {**impact_to_dict(self.model, self.particles.p, but=self.particles.names), "laws": self._laws}

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.particles.p.shown_in

    def declare(self) -> list[Declared]:
        """The results; errors are standard errors by sampling."""
        mean, mass = self.mean_volume, self.mean_mass
        spread = ", uncertain parameters included" if self.particles.uncertain else ""
        deviation = f"{RESULTS['deviation'].meaning}{spread}"
        return [
            Value("particles", self.n, meaning=f"± is {self.error_meaning}"),
            declare_result("mean_volume", mean.value, error=mean.error),
            *self._per_mass(),
            *self._by_uncertain(),
            declare_result("mean_mass", mass.value, error=mass.error),
            *self._means(),
            declare_result("deviation", self.deviation, meaning=deviation),
            declare_result("total_volume", self.total_volume),
            RESULTS["volume"].declare(
                "quantiles", np.array([*self.quantiles.values()]), dims=("quantile",),
                labels=[*self.quantiles], meaning="no more by this share of the particles",
            ),
            Value(
                "shares", [share.value for share in self.shares.values()], meaning="of the particles",
                scale=Scale(0.01, "%"), error=[share.error for share in self.shares.values()], dims=("outcome",),
                labels=[*self.shares],
            ),
            *self._turned_share(),
            *self._distribution(),
            *self._sensitivities(),
            *self._best_angle(),
        ]  # fmt: skip

    def _per_mass(self) -> Iterator[Value]:
        """Erosion per mass of particles; in tables in mm³/kg and, where the density is known, in g/kg."""
        is_beyond = self._far is not None and self._far.is_beyond
        for name, scale in zip(("erosion", "erosion_ratio"), PER_MASS_SCALES.values(), strict=True):
            if (estimate := getattr(self, name)) is not None:
                meaning = self.per_mass.meaning_of(name, is_beyond=is_beyond)
                yield declare_result(name, estimate.value, error=estimate.error, meaning=meaning, scale=scale)

    def _by_uncertain(self) -> Iterator[Value]:
        """What the uncertain parameters do to the erosion."""
        if self.uncertainty is None:
            return
        symbols = (quantities(self.model)[name].symbol for name in self.particles.uncertain.names)
        for name, error in self.parameter_errors.items():
            meaning = f"standard deviation of {name} by uncertain parameters"
            yield declare_result(name, error, meaning=meaning, only="data").but(name=f"{name}_parameter_error")
        error = self.parameter_errors["erosion"]
        relative = error / self.erosion.value if self.erosion.value else math.nan
        meaning = f"of E, by uncertain {', '.join(symbols)}; ± is by sampling alone"
        yield Value("parameter_error", relative, meaning=meaning, scale=Scale(0.01, "%"), digits=3)
        low, high = self.per_mass.cutting_fraction * np.quantile(self.uncertainty.erosion, [0.025, 0.975])
        yield declare_result("erosion", (float(low), float(high)), scale=PER_MASS_SCALES["specific_volume"]).but(
            name="erosion_interval", symbol="", meaning="the 95 % interval of E by them", digits=4
        )

    def _turned_share(self) -> Iterator[Value]:
        """The share of the impacts beyond the model's turn, where a model turns the body."""
        turned, impacts = self._turned.tolist()
        if impacts:
            meaning = f"of {impacts:,} impacts; the body turns by more than 90°"
            yield Value("turned_share", turned / impacts, meaning=meaning, only="data")

    def _distribution(self) -> Iterator[Value]:
        """The histogram of the particles' volumes."""
        edges, shares = self.tally.histogram()
        yield RESULTS["volume"].declare("volume_edge", edges, dims=("edge",), only="file")
        yield Value("share", shares, "", "share of the particles", "1", dims=("between_edges",), only="file")

    def _sensitivities(self) -> Iterator[Columns]:
        """Sobol indices of each law."""
        if self.sensitivities is None:
            return
        known, names = quantities(self.model), [*self.sensitivities]
        first, total = zip(*self.sensitivities.values(), strict=True)
        symbols = [", ".join(known[part].symbol for part in name.split(", ")) for name in names]
        indices = [
            Value(name, [each.value for each in of], symbol, error=[each.error for each in of])
            for name, symbol, of in (("first", "S, alone", first), ("total", "T, with interactions", total))
        ]
        columns = [Value("law", names), Value("symbol", symbols, only="table"), *indices]
        yield Columns("sensitivities", "Sensitivities: shares of the variance", columns, keyed=True)

    def _best_angle(self) -> Iterator[Value]:
        """The nozzle's best angle, and the curve that it is the top of."""
        if self.nozzle is None:
            return
        nozzle, alpha = self.nozzle, QUANTITIES["alpha"]
        at_edge, best = " (the edge of what was looked at)" if nozzle.at_edge else "", nozzle.alpha
        meaning = f"of the nozzle, for the stream{at_edge}; ± by sampling alone"
        interval, alone = (
            "its 95 % interval, by sampling alone",
            f"of a single, typical particle ({nozzle.single_kind})",
        )
        yield alpha.declare("alpha_max", best.value, symbol="α_max", meaning=meaning, error=best.error)
        yield alpha.declare("alpha_max_interval", (best.low, best.high), symbol="", meaning=interval)
        yield alpha.declare("single_alpha_max", nozzle.single_alpha, symbol="", meaning=alone)
        yield alpha.declare("nozzle", nozzle.angles, meaning="angle of the nozzle", dims=("nozzle",), only="file")
        curve = RESULTS["mean_volume"].declare("curve", nozzle.curve, error=nozzle.curve_error, dims=("nozzle",))
        yield curve.but(only="file")

    @property
    def title(self) -> str:
        """Model and laws in one line."""
        laws = (f"{name} {words}" for name, words in self.laws_in_words().items())
        return f"{model_name(self.model)}: a stream, {', '.join(laws)}"

    def laws_in_words(self) -> dict[str, str]:
        """By parameter, its law as a person reads it: "normal(20°, 3°)", "uncertain normal(2, 0.1)"."""
        known, units = quantities(self.model), self.shown_in
        uncertain = self.particles.uncertain.in_words(known, units)
        return self.particles.laws.in_words(known, units) | {
            name: f"uncertain {law}" for name, law in uncertain.items()
        }

    def to_dataset(self) -> xr.Dataset:
        """The results with their units, and the tally they come from, as a Dataset."""
        model = model_in_words(self.model, but=self.particles.names)
        described = provenance("a stream", self.particles.p, **model, laws=self._laws, particles=self.n)
        ends = {"end": ("end", np.array(self.ends, dtype=object))}
        numbers = super().to_dataset()
        dataset = self.tally.to_dataset().assign(numbers.variables).assign(ends)
        return dataset.assign_attrs(numbers.attrs).assign_attrs(described)

    @property
    def _laws(self) -> str:
        return "; ".join(f"{name}: {law}" for name, law in self.laws_in_words().items())
