"""The result of a sampling: draws, intervals, evidence, and sentences on what is doubtful."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from scipy import stats

from erosion.arguments import check_level, check_path, check_whole
from erosion.calibration.doubts import LEVEL
from erosion.calibration.forward import FRACTION, SCALE
from erosion.calibration.measurements import Measurements
from erosion.calibration.numbers import rounded
from erosion.files import require_writable, seen_from, write_whole
from erosion.impacts.impact import impact
from erosion.joint_laws import Rows
from erosion.models import model_name, model_source
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import with_values
from erosion.models.registry import impact_to_dict
from erosion.optimum.alpha_max import alpha_max
from erosion.parameters.case_files import dump_case, with_paths
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import Quantity
from erosion.parameters.scales import Scale, table_scale
from erosion.posteriors import doubts
from erosion.posteriors.best_angles import BestAngles
from erosion.posteriors.convergence import EFFECTIVE, RHAT, effective, rhats
from erosion.posteriors.files import SOURCE, own_in_si
from erosion.posteriors.likelihood import Likelihood
from erosion.posteriors.priors import NOISE, Priors, sampled_quantities
from erosion.posteriors.tempering import Run
from erosion.tables import Result, Row, format_number, to_plain
from erosion.version import __version__

_FACTOR = 1.5  # by which a deviation and an interval may differ to be shown together
_SOME = 400  # draws that show a curve's quantiles, and take a second for the best angles


class ConvergenceWarning(UserWarning):
    """The draws of a posterior are not good enough."""


@dataclasses.dataclass(frozen=True)
class Posterior(Result):
    """The parameters of a model after the data: draws of them, and the evidence.

    Args:
        likelihood: the model, the data and the priors.
        run: the draws, as the sampler left them.
        seed: of the draws.
    """

    likelihood: Likelihood
    run: Run
    seed: int

    @property
    def model(self) -> CuttingModel:
        """The model, its own parameters as they were given."""
        return self.likelihood.forward.model

    @property
    def p(self) -> Parameters:
        """The case, its parameters as they were given."""
        return self.likelihood.forward.p

    @property
    def data(self) -> Measurements:
        """The measurements."""
        return self.likelihood.forward.data

    @property
    def erosion_unit(self) -> str:
        """The unit of the data's erosion, as programs read it."""
        return self.data.erosion_unit

    @property
    def priors(self) -> Priors:
        """The laws before the data."""
        return self.likelihood.priors

    @property
    def names(self) -> tuple[str, ...]:
        """The sampled parameters; "scale" and "noise" come last."""
        return self.priors.names

    @functools.cached_property
    def samples(self) -> xr.Dataset:
        """The draws of each parameter, over the dimensions (chain, draw), in the case's units.

        Chains are populations that know nothing of each other. Within one, copies of a draw stand side by side.
        """
        known = self.quantities
        return xr.Dataset({
            name: (("chain", "draw"), values, known[name].attributes(self.p.units))
            for name, values in self.priors.values(self.run.points).items()
        }, {"chain": range(self.run.points.shape[0]), "draw": range(self.run.points.shape[1])})  # fmt: skip

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Symbol, meaning and dimension of each parameter."""
        known = sampled_quantities(self.likelihood.forward)
        return {name: known[name] for name in self.names}

    @property
    def means(self) -> dict[str, float]:
        """The mean of each parameter."""
        return {name: float(self.samples[name].mean()) for name in self.names}

    @property
    def deviations(self) -> dict[str, float]:
        """The standard deviation of each parameter."""
        return {name: float(self.samples[name].std(ddof=1)) for name in self.names}

    @property
    def correlation(self) -> np.ndarray:
        """The correlation of the parameters, shape (names, names)."""
        return np.atleast_2d(np.corrcoef([self.samples[name].values.ravel() for name in self.names]))

    def intervals(self, level: float = LEVEL) -> dict[str, tuple[float, float]]:
        """The values between which each parameter is with this probability, as likely below as above."""
        check_level(level)
        ends = [(1 - level) / 2, (1 + level) / 2]
        quantiles = {name: np.quantile(self.samples[name].values, ends) for name in self.names}
        return {name: (float(low), float(high)) for name, (low, high) in quantiles.items()}

    @property
    def log_evidence(self) -> float:
        """The logarithm of the probability density of the data [per unit of erosion, by row] under model and priors.

        Only its difference from that of another model on the same data means something.
        """
        logs = self.run.log_evidence
        return self.likelihood.constant + float(logs.max() + np.log(np.mean(np.exp(logs - logs.max()))))

    @property
    def log_evidence_error(self) -> float:
        """Standard error of `log_evidence`, from the spread of the populations."""
        logs = self.run.log_evidence
        return float(np.std(logs, ddof=1) / np.sqrt(len(logs)))

    @functools.cached_property
    def rhat(self) -> dict[str, float]:
        """R̂ of each parameter; near 1 where the populations agree."""
        return dict(zip(self.names, rhats(self.run.points).tolist(), strict=True))

    @functools.cached_property
    def effective(self) -> dict[str, float]:
        """The number of independent draws that say as much about the middle of each parameter."""
        return dict(zip(self.names, effective(self.run.points).tolist(), strict=True))

    @property
    def converged(self) -> bool:
        """Whether the draws are good, by R̂ ≤ 1.01, 100 effective draws of each population, and one evidence."""
        return not self.not_converged

    @property
    def not_converged(self) -> tuple[str, ...]:
        """Sentences on draws that are not good; none for good ones."""
        return doubts.not_converged(self)

    @property
    def statements(self) -> tuple[str, ...]:
        """Sentences on what is doubtful; empty for a good result."""
        return doubts.sentences(self)

    def some(self, count: int) -> dict[str, np.ndarray]:
        """Draws of all parameters, from all populations alike, each of shape (count,) or, of fewer draws, of all."""
        total = self.run.log_likelihood.size
        chosen = np.linspace(0, total, min(check_whole("count", count, 1), total), endpoint=False).astype(int)
        return {name: self.samples[name].values.reshape(-1)[chosen] for name in self.names}

    def cases(self, count: int = _SOME) -> tuple[CuttingModel, Parameters]:
        """Model and case at draws, as arrays of shape (count,), for `erosion.impact` and all that takes arrays."""
        of_impact = self.likelihood.forward.of_impact
        return with_values(self.model, self.p, {name: self.some(count)[name] for name in of_impact})

    def rows_of_draws(self) -> Rows:
        """All draws as a joint law, for `uncertain` of `erosion.stream` and `erosion.erosion_map`.

        It has the parameters of an impact, and "cutting_fraction" if that was sampled: a map takes it, a stream does
        not. "scale" and "noise" belong to the measurements and are left out. Values are in the units of the posterior's
        case, which the case that takes them must have, too.
        """
        names = [name for name in self.names if name not in (SCALE, NOISE)]
        columns = {name: self.samples[name].values for name in names}
        return Rows(columns, f"the posterior of {self.data.source}", self.p.units)

    def derive(self, function: Callable[[CuttingModel, Parameters], Any], count: int = _SOME) -> Any:
        """A function of model and case at draws; it gets arrays of shape (count,): see `cases`."""
        return function(*self.cases(count))

    def alpha_max(self, count: int = _SOME) -> BestAngles:
        """The angle of greatest removal at draws of the parameters, at jumps of V(α) too."""
        return BestAngles(alpha_max(*self.cases(count)))

    def predict(
        self, alpha: Any, at: Mapping[str, float] | None = None, count: int = _SOME, *, noise: bool = False
    ) -> np.ndarray:
        """The erosion at angles, for draws of the parameters.

        Args:
            alpha: α [rad], of any shape.
            at: other parameters of the case than the sampled ones, such as {"v0": 60.0}.
            count: number of draws.
            noise: also draw the error of a measurement: of the typical uncertainty, or of the sampled noise.

        Returns:
            In the data's dimension, draws first and then the shape of `alpha`.
        """
        angles = np.atleast_1d(np.asarray(alpha, float)).ravel()
        others = {name: np.full(angles.shape, value) for name, value in (at or {}).items()}
        draws = self.some(count)
        erosion = self.likelihood.predict(draws, {"alpha": angles, **others})
        if noise:
            erosion = erosion + self.noise(draws)[:, None] * np.random.default_rng(self.seed).standard_normal(
                erosion.shape
            )
        return erosion.reshape((-1, *np.shape(alpha)))

    def ends(self, alpha: Any, at: Mapping[str, float] | None = None, count: int = _SOME) -> np.ndarray:
        """How the cuts end at angles, for draws of the parameters; arguments and shape as of `predict`."""
        angles = np.atleast_1d(np.asarray(alpha, float)).ravel()
        draws, of_impact = self.some(count), self.likelihood.forward.of_impact
        model, p = with_values(self.model, self.p, {name: draws[name][:, None] for name in of_impact})
        ends = impact(model, dataclasses.replace(p, alpha=angles, **(at or {}))).ended_by
        drawn = len(next(iter(draws.values())))
        return np.broadcast_to(ends, (drawn, angles.size)).reshape((drawn, *np.shape(alpha)))

    def noise(self, draws: Mapping[str, np.ndarray]) -> np.ndarray:
        """The standard deviation of a measurement at draws: sampled, or the median of the data's uncertainties."""
        if self.data.uncertainty is None:
            return draws[NOISE]
        return np.full(len(next(iter(draws.values()))), float(np.median(self.data.uncertainty)))

    def rows(self, level: float = LEVEL) -> list[Row]:
        """Means with deviations, or medians, intervals of `level` and priors; the evidence; the draws' quality."""
        evidence = f"{self.log_evidence:.2f} ± {self.log_evidence_error:.2f}"
        chains, count = self.run.points.shape[:2]
        fewest = f"of {chains * count:,} draws, the fewest; good from {EFFECTIVE * chains}"
        return [
            *(self._row(name, level) for name in self.names),
            Row("log_evidence", "ln Z", evidence, "", "of the data, under this model and these priors"),
            Row("rhat", "R̂", format_number(max(self.rhat.values()), 5), "", f"the greatest; good to {RHAT}"),
            Row("effective", "", f"{min(self.effective.values()):,.0f}", "", fewest),
            Row("acceptance", "", f"{self.run.acceptance:.2f}", "", "share of the last moves"),
        ]

    def _row(self, name: str, level: float) -> Row:
        """A parameter in the unit in which it reads well."""
        quantity = self.quantities[name]
        scale = table_scale(quantity.dimension, self.p.units, abs(self.means[name]))
        mean, deviation = self.means[name] / scale.size, self.deviations[name] / scale.size
        low, high = (end / scale.size for end in self.intervals(level)[name])
        prior = f"prior: {self.prior_in_words(name)}"
        width = float(stats.norm.ppf((1 + level) / 2)) * deviation
        if all(width < _FACTOR * distance < _FACTOR**2 * width for distance in (mean - low, high - mean)):
            ends = f"{rounded(low, high - low, 2)} … {rounded(high, high - low, 2)}"
            value = f"{rounded(mean, deviation)} ± {rounded(deviation, deviation)}"
            return Row(name, quantity.symbol, value, scale.unit, f"{level:.0%}: {ends}; {prior}")
        # A mean and a deviation would say that other values are likely than the interval does.
        middle = float(self.samples[name].median()) / scale.size
        ends = f"{rounded(low, middle - low, 2)} … {rounded(high, high - middle, 2)}"
        value = rounded(middle, min(middle - low, high - middle))
        return Row(name, quantity.symbol, value, scale.unit, f"the median; {level:.0%}: {ends}; {prior}")

    def mean_in_words(self, name: str) -> str:
        """A parameter's mean and deviation, or its median: "threshold = 7.3 ± 1.0 m/s"."""
        row = self._row(name, LEVEL)
        return f"{name} = {Scale(1.0, row.unit).beside(row.value)}"

    def prior_in_words(self, name: str) -> str:
        """The law of a parameter before the data, and whether it is the default."""
        words = self.priors.in_words(name, self.quantities[name], self.p.units)
        return words if name in self.priors.chosen else f"{words}, the default"

    @property
    def title(self) -> str:
        """The model and the data."""
        return f"{model_name(self.model)}: the posterior from {len(self.data):,} rows of {self.data.source}"

    def to_dict(self, level: float = LEVEL) -> dict[str, Any]:
        """Model and case; means, deviations, intervals of `level`; the evidence, and the quality of the draws."""
        numbers = {
            "rows": len(self.data),
            "means": self.means,
            "deviations": self.deviations,
            "intervals": self.intervals(level),
            "level": level,
            "correlation": self.correlation,
            "priors": [{"parameter": name, "law": self.prior_in_words(name)} for name in self.names],
            "log_evidence": self.log_evidence,
            "log_evidence_error": self.log_evidence_error,
            "converged": self.converged,
            "quality": [
                {"parameter": name, "rhat": self.rhat[name], "effective": self.effective[name]} for name in self.names
            ],
            "acceptance": self.run.acceptance,
            "draws": self.run.log_likelihood.size,
            "chains": len(self.run.log_evidence),
            "seed": self.seed,
            "erosion_unit": self.data.erosion_unit,
            "warnings": self.statements,
        }
        return impact_to_dict(self.model, self.p) | to_plain(numbers)

    def to_datatree(self) -> xr.DataTree:
        """Everything in ArviZ's layout: the groups posterior, sample_stats, observed_data and constant_data."""
        chains = self.samples.coords
        stats = xr.Dataset(
            {"log_likelihood": (("chain", "draw"), self.run.log_likelihood + self.likelihood.constant)}, chains
        )
        known, units = sampled_quantities(self.likelihood.forward), self.p.units
        observed = {"erosion": ("row", self.data.erosion, self.data.quantity.attributes(units))}
        if self.data.uncertainty is not None:
            observed["uncertainty"] = ("row", self.data.uncertainty, {"units": self.data.erosion_unit})
        constant = {name: ("row", values, known[name].attributes(units))
                    for name, values in self.data.conditions.items()}  # fmt: skip
        described = {
            "inference_library": "erosion",
            "inference_library_version": __version__,
            "model": model_name(self.model),
            SOURCE: model_source(self.model) or "",
            "case": dump_case(self.p),
            "unit_system": self.p.units,
            "own_parameters": own_in_si(self.model, self.p, self.names),
            **({} if FRACTION in self.names else {FRACTION: self.likelihood.forward.cutting_fraction}),
            "data": self.data.source,
            "seed": self.seed,
            "log_evidence": self.log_evidence,
            "log_evidence_error": self.log_evidence_error,
            "converged": int(self.converged),
            **{f"prior_{name}": self.prior_in_words(name) for name in self.names},
        }
        return xr.DataTree.from_dict({
            "posterior": self.samples.assign_attrs(described),
            "sample_stats": stats,
            "observed_data": xr.Dataset(observed),
            "constant_data": xr.Dataset(constant),
        })  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write `to_datatree` to a netCDF file, whole or not at all.

        Raises:
            ValueError: for a suffix other than .nc.
            OSError: where the file cannot be written.
        """
        path = check_path("path", path)
        if path.suffix != ".nc":
            raise ValueError(f"Argument `path` must end in .nc, but is {path}.")
        require_writable(path)
        tree = self.to_datatree()
        draws = tree["posterior"].attrs
        draws[SOURCE] = with_paths(draws[SOURCE], functools.partial(seen_from, path))
        # HDF5 then sees numbers that were damaged; it keeps no checksum of what has no axes.
        checked = {
            group.path: {name: {"fletcher32": True} for name, values in group.data_vars.items() if values.ndim}
            for group in tree.subtree
        }
        with memoryview(tree.to_netcdf(None, engine="h5netcdf", encoding=checked)) as content:
            write_whole(path, content)
        return path

    @property
    def best(self) -> np.ndarray:
        """θ of the likeliest draw, shape (names of a fit,); for advice that a fit gives, too."""
        at = np.unravel_index(int(np.argmax(self.run.log_likelihood)), self.run.log_likelihood.shape)
        forward = self.likelihood.forward
        return forward.theta({name: float(self.samples[name].values[at]) for name in forward.names})
