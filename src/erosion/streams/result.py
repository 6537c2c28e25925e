"""What a stream removes, with errors, and the nozzle's angle at which it removes most.

The same particles are used at all angles (common random numbers), so the mean volume is a
function of the angle alone. It is smooth where the volume of a single particle jumps, and its
maximum is at another angle than that of a single particle.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import xarray as xr
from scipy.optimize import minimize_scalar

from erosion.arguments import Progress, no_progress
from erosion.impacts import alpha_max, impact, model_in_words, provenance, turned_in_part
from erosion.models import CuttingModel, impact_to_dict, model_name, own_quantities, quantities
from erosion.output import Record, Row, largest_of, to_plain, with_error
from erosion.parameters import (
    PER_MASS_SCALES,
    QUANTITIES,
    RESULTS,
    FarFromTests,
    PerMass,
    Quantity,
    conversion_factor,
    far_from_tests,
    quantity_row,
    result_row,
    table_scale,
)
from erosion.results import Finding, Result
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
        volume: mean volume of a particle there [volume].
        at_edge: whether the best angle is the first or last of `angles`.
        angles: of the nozzle, shape (n,) [rad].
        curve: mean volume of a particle at each, shape (n,) [volume].
        curve_error: its standard error, shape (n,) [volume].
        single_alpha: the best angle of one typical particle (see `Particles.typical`) [rad].
        single_kind: the kind of that optimum, see `Optimum`.
        single_angles: angles of attack, shape (k,) [rad].
        single_curve: its volume at each, shape (k,) [volume].
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
        """Mean volume of some replicates at each angle, shape (replicates, angles) [volume]."""
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
        single_curve=np.asarray(impact(model, typical.replace(alpha=single_angles), rtol=rtol).volume),
    )


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
    model, p, hits = particles.impacts(particles.draw(points, draws[:, None]))
    volume = np.where(hits, impact(model, p, rtol=rtol).volume, 0.0)
    computed = np.isfinite(volume)
    counts = computed.sum(axis=1)
    mass = np.broadcast_to(np.asarray(p.m), volume.shape)
    sums = [np.where(computed, values, 0.0).sum(axis=1)[counts > 0] for values in (volume, mass)]
    return Uncertainty(*(total / counts[counts > 0] for total in sums))


QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_OF_RANGE = 2**12  # particles by which the share outside of a range is known well enough


@dataclasses.dataclass(frozen=True)
class Stream(Result):
    """The erosion of a stream of particles.

    Args:
        particles: model and case, and their distributions.
        tally: counts and moments of the particles.
        ends: the outcomes of a particle, the columns of `tally.ends`.
        nozzle: the stream's own best angle, or None where it was not asked for.
        sensitivities: by parameter, or by the parameters of a joint law ("alpha, v0"), the shares of the volume's
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
        """Removed volume of a particle [volume]."""
        return Estimate.of(self.tally.mean)

    @property
    def mean_quantities(self) -> dict[str, Estimate]:
        """The quantities of the model's own of a particle, by name; see `erosion.own_quantity`."""
        return {name: Estimate.of(own.mean) for name, own in self.tally.own.items()}

    @property
    def _estimates(self) -> dict[str, tuple[Quantity, Estimate]]:
        """By name what is estimated with a standard error, as far as it is known."""
        names = ("mean_volume", "mean_mass", "erosion", "erosion_ratio")
        estimates = {name: (RESULTS[name], estimate) for name in names if (estimate := getattr(self, name)) is not None}
        own, means = own_quantities(type(self.model)), self.mean_quantities
        for name, quantity in own.items():
            meaning = f"{quantity.meaning}, mean of the stream"
            described = dataclasses.replace(quantity, symbol=f"{quantity.symbol}\u0304", meaning=meaning)
            estimates[f"mean_{name}"] = described, means[name]
        return estimates

    @property
    def total_volume(self) -> float:
        """Volume removed by all particles computed [volume]."""
        return float(self.tally.counted @ self.tally.mean)

    @property
    def deviation(self) -> float:
        """Standard deviation of the volume from particle to particle [volume]."""
        return self.tally.deviation

    @property
    def mean_mass(self) -> Estimate:
        """Mass of a particle [mass]."""
        return Estimate.of(self.tally.mass / self.tally.counted)

    @property
    def erosion(self) -> Estimate:
        """Removed volume per unit mass of abrasive [volume/mass]; particles that miss are abrasive too."""
        removed = self.per_mass.cutting_fraction * self.tally.counted * self.tally.mean
        return Estimate.of(removed / self.tally.mass, float(removed.sum() / self.tally.mass.sum()))

    @property
    def erosion_ratio(self) -> Estimate | None:
        """Mass loss per mass of abrasive [kg/kg]; None where the density of the target is not known."""
        if self.per_mass.density is None:
            return None
        factor = self.per_mass.density * conversion_factor("volume per mass", self.particles.p.units, "si")
        return Estimate(*(factor * number for number in dataclasses.astuple(self.erosion)))

    @property
    def _far(self) -> FarFromTests | None:
        """The same in numbers, whether an amount is asked for or not."""
        p = self.particles.p
        speed = float(np.mean(self._sample.get("v0", p.v0))) * conversion_factor("speed", p.units, "si")
        removed = self.erosion.value * conversion_factor("volume per mass", p.units, "si")
        return far_from_tests(removed, speed, self.per_mass.density)

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
        """What the errors and intervals of the estimates hold, in words."""
        others = "uncertain parameters apart" if self.uncertainty is not None else "all other parameters taken as exact"
        return f"the error by sampling these particles alone, {others}"

    @property
    def shares(self) -> dict[str, Estimate]:
        """Share of the particles by outcome, for the outcomes that occur."""
        shares = self.tally.ends / self.tally.drawn
        return {end: Estimate.of(shares[:, i]) for i, end in enumerate(self.ends) if shares[:, i].any()}

    @property
    def quantiles(self) -> dict[float, float]:
        """Volume that 5, 25, 50, 75 and 95 % of the particles do not exceed [volume], to 0.12 %."""
        return {share: self.tally.quantile(share) for share in QUANTILES}

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Particles out of the model's range or turned too far, and erosion far from what tests find at this speed."""
        far = self._far if self.per_mass.is_given else None
        model, p, hits = self.particles.impacts(self._sample)
        found = (model.outside_of_range(p, hits), turned_in_part(model, p, counted=hits), far and far.finding())
        return tuple(finding for finding in found if finding is not None)

    @property
    def outside_of_range(self) -> Finding | None:
        """The finding on particles outside of the range that the model is made for, from 4096 of them."""
        model, p, hits = self.particles.impacts(self._sample)
        return model.outside_of_range(p, hits)

    @property
    def _sample(self) -> Mapping[str, np.ndarray]:
        """What varies, of a few thousand particles."""
        return self.particles.draw(Points("sobol", self.particles.dimension, 0, 1).take(_OF_RANGE)[0])

    def rows(self) -> list[Row]:
        """The results as rows of a table; errors are standard errors."""
        units, parameters = self.particles.p.units, quantities(self.model)

        def mean(name: str) -> Row:
            quantity, estimate = self._estimates[name]
            scale = table_scale(quantity.dimension, units, largest_of(estimate.value))
            return _with_error(quantity_row(name, quantity, estimate.value, units), estimate, 1 / scale.size)

        deviation, total = (result_row(name, getattr(self, name), units) for name in ("deviation", "total_volume"))
        if self.particles.uncertain:
            deviation = deviation._replace(meaning=f"{deviation.meaning}, uncertain parameters included")
        rows = [
            Row("n", "", f"{self.n:,}", "", f"particles; ± is {self.error_meaning}"),
            mean("mean_volume"),
            *self._per_mass_rows(),
            *self._uncertainty_rows(),
            mean("mean_mass"),
            *(mean(f"mean_{name}") for name in self.mean_quantities),
            deviation,
            total,
        ]
        for share, volume in self.quantiles.items():
            meaning = f"{share:.0%} of the particles remove no more"
            rows.append(result_row("volume", volume, units)._replace(meaning=meaning))
        for end, share in self.shares.items():
            rows.append(_with_error(Row(f"share {end}", "", "", "%"), share, 100.0))
        for name, (first, with_others) in (self.sensitivities or {}).items():
            symbol = ", ".join(parameters[part].symbol for part in name.split(", "))
            rows.append(_with_error(Row("sensitivity", f"S({symbol})", "", "", "of the variance, alone"), first))
            rows.append(_with_error(Row("sensitivity", f"T({symbol})", "", "", "with interactions"), with_others))
        if self.nozzle is not None:
            at_edge = " (the edge of what was looked at)" if self.nozzle.at_edge else ""
            best, degree = self.nozzle.alpha, 180 / math.pi
            row = Row("alpha_max", "α_max", "", "°", f"of the nozzle, for the stream{at_edge}; ± by sampling alone")
            interval = _interval(best.low, best.high, best.error, 1 / degree)
            alone = f"of a single, typical particle ({self.nozzle.single_kind})"
            rows += [
                _with_error(row, best, degree),
                Row("", "", interval, "°", "its 95 % interval, by sampling alone"),
                Row("", "", f"{self.nozzle.single_alpha * degree:.5g}", "°", alone),
            ]
        return rows

    def _per_mass_rows(self) -> Iterator[Row]:
        """Erosion per mass of abrasive, in mm³/kg and, where the density is known, in g/kg."""
        to_si = conversion_factor("volume per mass", self.particles.p.units, "si")
        is_beyond = self._far is not None and self._far.is_beyond
        sizes = zip(("erosion", "erosion_ratio"), (to_si, 1.0), PER_MASS_SCALES.values(), strict=True)
        for name, to_base, scale in sizes:
            if (estimate := getattr(self, name)) is not None:
                meaning = self.per_mass.meaning_of(name, is_beyond=is_beyond)
                yield _with_error(
                    Row(name, RESULTS[name].symbol, "", scale.unit, meaning), estimate, to_base / scale.size
                )

    def _uncertainty_rows(self) -> list[Row]:
        """What the uncertain parameters do to the erosion."""
        if self.uncertainty is None:
            return []
        names = ", ".join(quantities(self.model)[name].symbol for name in self.particles.uncertain)
        error, scale = self.parameter_errors["erosion"], PER_MASS_SCALES["specific_volume"]
        size = scale.size / conversion_factor("volume per mass", self.particles.p.units, "si")
        low, high = self.per_mass.cutting_fraction * np.quantile(self.uncertainty.erosion, [0.025, 0.975])
        relative = 100 * error / self.erosion.value if self.erosion.value else math.nan
        return [
            Row("parameter_error", "", f"{relative:.3g}", "%", f"of E, by uncertain {names}; ± is by sampling alone"),
            Row("", "", _interval(low, high, error, size), scale.unit, "the 95 % interval of E by them"),
        ]

    @property
    def title(self) -> str:
        """Model and distributions in one line."""
        laws = (f"{name} {words}" for name, words in self.laws_in_words().items())
        return f"{model_name(self.model)}: a stream, {', '.join(laws)}"

    def laws_in_words(self) -> dict[str, str]:
        """By parameter, its distribution as a person reads it: "normal(20°, 3°)"."""
        units, known = self.particles.p.units, quantities(self.model)
        words = {name: law.in_words(known[name].dimension, units) for name, law in self.particles.all_laws.items()}
        return words | {name: f"uncertain {words[name]}" for name in self.particles.uncertain}

    def to_dict(self) -> Record:
        """The results with their standard errors and units, and the case."""
        dataset = self.to_dataset()
        scalars = [str(name) for name, variable in dataset.data_vars.items() if not variable.dims]
        numbers: Record = {"particles": self.n, **{name: dataset[name].item() for name in scalars}}
        numbers["quantiles"] = {f"{share:g}": volume for share, volume in self.quantiles.items()}
        numbers["shares"] = {outcome: share.value for outcome, share in self.shares.items()}
        if self.nozzle is not None:
            numbers["alpha_max_interval"] = [self.nozzle.alpha.low, self.nozzle.alpha.high]
        if self.sensitivities is not None:
            numbers["sensitivities"] = {
                name: {"first": first.value, "first_error": first.error,
                       "total": total.value, "total_error": total.error}
                for name, (first, total) in self.sensitivities.items()
            }  # fmt: skip
        numbers["units"] = {name: dataset[name].attrs["units"] for name in scalars}
        impact = impact_to_dict(self.model, self.particles.p, but=self.particles.all_laws)
        return impact | {"laws": self._laws} | to_plain(numbers)

    def to_dataset(self) -> xr.Dataset:
        """The results with their units, and the tally they come from, as a Dataset."""
        units, estimates = self.particles.p.units, self._estimates
        known = {**RESULTS, **QUANTITIES, **{name: quantity for name, (quantity, _) in estimates.items()}}

        def number(dims: str | tuple[()], values: Any, name: str, meaning: str = "") -> tuple[Any, ...]:
            return dims, values, known[name].attributes(units) | ({"long_name": meaning} if meaning else {})

        variables: dict[str, tuple[Any, ...]] = {"end": ("end", np.array(self.ends, dtype=object))}
        for name, (_, estimate) in estimates.items():
            variables[name] = number((), estimate.value, name)
            error = f"standard error of {name} by sampling"
            variables[f"{name}_error"] = number((), estimate.error, name, error)
        for name, error in self.parameter_errors.items():
            meaning = f"standard deviation of {name} by uncertain parameters"
            variables[f"{name}_parameter_error"] = number((), error, name, meaning)
        variables |= {name: number((), getattr(self, name), name) for name in ("deviation", "total_volume")}
        edges, shares = self.tally.histogram()
        variables |= {
            "quantile": ("quantile", list(self.quantiles)),
            "volume_quantile": number("quantile", list(self.quantiles.values()), "volume"),
            "volume_edge": number("edge", edges, "volume"),
            "share": ("between_edges", shares, {"long_name": "share of the particles", "units": "1"}),
        }
        if self.sensitivities is not None:
            variables["law"] = ("law", np.array(list(self.sensitivities), dtype=object))
            for name, estimates in zip(
                ("first_order", "total_order"), zip(*self.sensitivities.values(), strict=True), strict=True
            ):
                index = {"long_name": f"Sobol index, {name}", "units": "1"}
                variables[name] = ("law", [estimate.value for estimate in estimates], index)
                variables[f"{name}_error"] = ("law", [estimate.error for estimate in estimates], {"units": "1"})
        if (nozzle := self.nozzle) is not None:
            best, single = nozzle.alpha, "angle of attack at which a single, typical particle removes most"
            variables |= {
                "nozzle": number("nozzle", nozzle.angles, "alpha", "angle of the nozzle"),
                "curve": number("nozzle", nozzle.curve, "mean_volume"),
                "curve_error": number("nozzle", nozzle.curve_error, "mean_volume"),
                "alpha_max": number((), best.value, "alpha", "angle of the nozzle that removes most"),
                "single_alpha_max": number((), nozzle.single_alpha, "alpha", single),
                "alpha_max_interval": number("end_of_interval", [best.low, best.high], "alpha"),
            }
        model = model_in_words(self.model, but=self.particles.all_laws)
        described = provenance("a stream", self.particles.p, **model, distributions=self._laws, particles=self.n)
        dataset = self.tally.to_dataset().assign(variables)
        return dataset.assign_attrs(described)

    @property
    def _laws(self) -> str:
        kinds = dict.fromkeys(self.particles.uncertain, "uncertain ")
        return "; ".join(f"{name}: {kinds.get(name, '')}{law}" for name, law in self.particles.all_laws.items())


def _with_error(row: Row, estimate: Estimate, unit: float = 1.0) -> Row:
    """A row whose value shows its standard error."""
    return row._replace(value=with_error(estimate.value, estimate.error, 1 / unit))


def _interval(low: float, high: float, error: float, size: float) -> str:
    """The ends of an interval, to the digits that an error has."""
    return " … ".join(with_error(end, error, size).partition(" ")[0] for end in (low, high))
