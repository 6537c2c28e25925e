"""What is known of a stream when its particles have passed, as numbers, table and Dataset."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from erosion.models import model_name
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import own_in_words, quantities
from erosion.parameters.case_files import dump_case
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS, result_row
from erosion.streams.nozzle import NozzleAngle
from erosion.streams.particles import Particles
from erosion.streams.replicates import Estimate
from erosion.streams.tally import Tally
from erosion.tables import Row, to_html, to_text
from erosion.version import __version__

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclasses.dataclass(frozen=True)
class Stream:
    """The erosion of a stream of particles.

    Args:
        particles: model and case, and their distributions.
        tally: what was counted.
        ends: how a particle may end, the columns of `tally.ends`.
        nozzle: the stream's own best angle, or None where it was not asked for.
        sensitivities: by parameter, the shares of the volume's variance that it explains alone
            (first order) and with its interactions (total), or None for a single distribution
            or where nothing is removed.
    """

    particles: Particles
    tally: Tally
    ends: tuple[str, ...]
    nozzle: NozzleAngle | None = None
    sensitivities: Mapping[str, tuple[Estimate, Estimate]] | None = None

    @property
    def model(self) -> CuttingModel:
        """What cuts."""
        return self.particles.model

    @property
    def n(self) -> int:
        """Particles computed."""
        return self.tally.drawn * len(self.tally.mean)

    @property
    def mean_volume(self) -> Estimate:
        """Removed volume of a particle [volume]."""
        return Estimate.of(self.tally.mean)

    @property
    def total_volume(self) -> float:
        """Removed by all particles computed [volume]."""
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
        """Removed volume per unit mass of abrasive [volume/mass]; what misses is abrasive too."""
        removed = self.tally.counted * self.tally.mean
        return Estimate.of(removed / self.tally.mass, float(removed.sum() / self.tally.mass.sum()))

    @property
    def shares(self) -> dict[str, Estimate]:
        """Share of the particles by how they end, those that occur."""
        shares = self.tally.ends / self.tally.drawn
        return {end: Estimate.of(shares[:, i]) for i, end in enumerate(self.ends) if shares[:, i].any()}

    @property
    def quantiles(self) -> dict[float, float]:
        """Volume that 5, 25, 50, 75 and 95 % of the particles do not pass [volume], to 0.12 %."""
        return {share: self.tally.quantile(share) for share in QUANTILES}

    def rows(self) -> list[Row]:
        """The results as rows of a table; errors are standard errors."""
        units = self.particles.p.units
        rows = [
            Row("n", "", f"{self.n:,}", "", "particles"),
            *(
                _with_error(result_row(name, 0.0, units), getattr(self, name))
                for name in ("mean_volume", "erosion", "mean_mass")
            ),
        ]
        rows += [result_row(name, getattr(self, name), units) for name in ("deviation", "total_volume")]
        for share, volume in self.quantiles.items():
            row = result_row("volume", volume, units)
            rows.append(row._replace(value=f"{volume:.4g}", meaning=f"{share:.0%} of the particles remove no more"))
        for end, share in self.shares.items():
            rows.append(_with_error(Row(f"share {end}", "", "", "%"), share, 100.0))
        known = quantities(self.model)
        for name, (first, total) in (self.sensitivities or {}).items():
            symbol = known[name].symbol
            rows.append(_with_error(Row("sensitivity", f"S({symbol})", "", "", "of the variance, alone"), first))
            rows.append(_with_error(Row("sensitivity", f"T({symbol})", "", "", "with interactions"), total))
        if self.nozzle is not None:
            at_edge = " (the edge of what was looked at)" if self.nozzle.at_edge else ""
            best, degree = self.nozzle.alpha, 180 / math.pi
            row = Row("alpha_max", "α_max", "", "°", f"of the nozzle, for the stream{at_edge}")
            rows.append(_with_error(row, best, degree))
            interval = f"{best.low * degree:.4f} … {best.high * degree:.4f}"
            rows.append(Row("", "", interval, "°", "its 95 % interval"))
            alone = f"of a single, typical particle ({self.nozzle.single_kind})"
            rows.append(Row("", "", f"{self.nozzle.single_alpha * degree:.6g}", "°", alone))
        return rows

    def __str__(self) -> str:
        return to_text(self.title, self.rows())

    def _repr_html_(self) -> str:
        return to_html(self.title, self.rows())

    @property
    def title(self) -> str:
        """Model and distributions in one line."""
        laws = ", ".join(f"{name}: {law}" for name, law in self.particles.laws.items())
        return f"stream of {model_name(self.model)}, {laws}"

    def to_dataset(self) -> xr.Dataset:
        """Everything as a Dataset with units: the results, and the tally they come from."""
        units = self.particles.p.units
        dataset = self.tally.to_dataset()
        dataset["end"] = ("end", np.array(self.ends, dtype=object))
        for name in ("mean_volume", "mean_mass", "erosion"):
            estimate: Estimate = getattr(self, name)
            attributes = RESULTS[name].attributes(units)
            dataset[name] = ((), estimate.value, attributes)
            dataset[f"{name}_error"] = ((), estimate.error, {**attributes, "long_name": f"standard error of {name}"})
        for name in ("deviation", "total_volume"):
            dataset[name] = ((), getattr(self, name), RESULTS[name].attributes(units))
        dataset["quantile"] = ("quantile", list(self.quantiles))
        attributes = RESULTS["volume"].attributes(units)
        dataset["volume_quantile"] = ("quantile", list(self.quantiles.values()), attributes)
        edges, shares = self.tally.histogram()
        dataset["volume_edge"] = ("edge", edges, attributes)
        dataset["share"] = ("between_edges", shares, {"long_name": "share of the particles", "units": "1"})
        if self.sensitivities is not None:
            dataset["law"] = ("law", np.array(list(self.sensitivities), dtype=object))
            for i, name in enumerate(("first_order", "total_order")):
                pairs = [orders[i] for orders in self.sensitivities.values()]
                dataset[name] = (
                    "law",
                    [one.value for one in pairs],
                    {"long_name": f"Sobol index, {name}", "units": "1"},
                )
                dataset[f"{name}_error"] = ("law", [one.error for one in pairs], {"units": "1"})
        if self.nozzle is not None:
            angle = QUANTITIES["alpha"].attributes(units)
            dataset["nozzle"] = ("nozzle", self.nozzle.angles, {**angle, "long_name": "angle of the nozzle"})
            dataset["curve"] = ("nozzle", self.nozzle.curve, RESULTS["mean_volume"].attributes(units))
            dataset["curve_error"] = ("nozzle", self.nozzle.curve_error, RESULTS["mean_volume"].attributes(units))
            best = self.nozzle.alpha
            dataset["alpha_max"] = ((), best.value, {**angle, "long_name": "angle of the nozzle that removes most"})
            single = {**angle, "long_name": "angle of attack at which a single, typical particle removes most"}
            dataset["single_alpha_max"] = ((), self.nozzle.single_alpha, single)
            dataset["alpha_max_interval"] = ("end_of_interval", [best.low, best.high], angle)
        laws = "; ".join(f"{name}: {law}" for name, law in self.particles.laws.items())
        own = own_in_words(self.model, but=self.particles.laws)
        dataset.attrs |= {
            "Conventions": "CF-1.11",
            "title": "Solid particle erosion: a stream",
            "source": f"erosion {__version__}",
            "model": model_name(self.model),
            **({"own_parameters": own} if own else {}),
            "distributions": laws,
            "particles": self.n,
            "unit_system": units,
            "case": dump_case(self.particles.p),
        }
        return dataset


def _with_error(row: Row, estimate: Estimate, unit: float = 1.0) -> Row:
    """A row whose value shows its standard error."""
    value = f"{estimate.value * unit:.6g} ± {estimate.error * unit:.2g}"
    return row._replace(value=value)
