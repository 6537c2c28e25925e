"""`next_experiment`: the angle, speed and size at which one more test says most."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from erosion.arguments import check_unmasked
from erosion.fits.errors import ErrorModel
from erosion.fits.measurements import Measurements
from erosion.fits.posterior import Posterior
from erosion.fits.ranking import PosteriorRanking
from erosion.models import model_name
from erosion.output import briefly, to_plain
from erosion.parameters import QUANTITIES, Scale, array_of, table_scale
from erosion.results import Result

_DRAWS = 1000
_PER_NOISE = 16  # points of the grid in one standard deviation: the entropy errs by 1e-4 bit
_REACH = 6.0  # standard deviations beyond the outermost prediction
_MOST = 2**17  # points of the grid; a prediction that varies by more noises is sampled less closely
_NEAR = 2.0  # bit below the logarithm of the draws, from where on the information of normal laws is 0.3 bit too small
_SHOWN = 10
_STEP = 2.5  # ° between the candidates, if there are no others


@dataclasses.dataclass(frozen=True)
class NextExperiment(Result):
    """What one more row is expected to say, by angle and other conditions; every array has the shape (candidates,).

    Args:
        candidates: by parameter of the case, its values; "alpha" [rad] among them.
        information: about the parameters: the mean drop of the entropy of the posterior [bit]; of several models the
            mean over their probabilities.
        discrimination: about which model is right [bit]; zeros for one model.
        noise: standard deviation of the row that was assumed, the mean over draws [of the data], shape (candidates,).
        names: the models.
        units: of the case.
        draws: of each posterior, which a row can at most distinguish.
    """

    candidates: Mapping[str, np.ndarray]
    information: np.ndarray
    discrimination: np.ndarray
    noise: np.ndarray
    names: tuple[str, ...]
    units: Any
    draws: int

    @property
    def total(self) -> np.ndarray:
        """Both together [bit]; NaN where a candidate cannot be judged."""
        return self.information + self.discrimination

    @functools.cached_property
    def order(self) -> np.ndarray:
        """The indexes of the candidates, that of the greatest total first."""
        return np.argsort(-self.total, kind="stable")  # NaN comes last

    @property
    def best(self) -> dict[str, float]:
        """The first candidate in the units of the case; empty if none is judged."""
        return self._greatest(self.total)

    @property
    def best_to_discriminate(self) -> dict[str, float]:
        """The same of the candidate that says most about which model is right."""
        return self._greatest(self.discrimination)

    @property
    def sentence(self) -> str:
        """Where to measure next, how much a row there is expected to say, and which candidates cannot be judged."""
        best, unknown = int(self.order[0]), np.isnan(self.total)
        why = "cannot be judged: draws have no volume or no error there."
        if unknown.all():
            return f"No candidate {why.replace('cannot', 'can')}"
        conditions = " and ".join(self.condition_in_words(name, value[best]) for name, value in self.shown.items())
        share = f" ({self.discrimination[best]:.3f} on which model is right)" if len(self.names) > 1 else ""
        usual = f"the median candidate {np.nanmedian(self.total):.3f}; one bit halves what is left open"
        limit = float(np.log2(self.draws))
        is_near = float(np.nanmax(self.information)) > limit - _NEAR
        more = f" {self.draws:,} draws show {limit:.1f} bit at most: ask for more draws." * is_near
        if unknown.any():
            low, high = (f"{end:.4g}°" for end in np.rad2deg(np.sort(self.candidates["alpha"][unknown])[[0, -1]]))
            where = f"at {low}" if low == high else f"between {low} and {high}"
            more += f" {unknown.sum():,} of {len(unknown):,} candidates, {where}, {why}"
        bits = f"{self.total[best]:.3f} bit{share}"
        return f"Measure next at {conditions}: one row there is expected to say {bits}, {usual}.{more}"

    @functools.cached_property
    def shown(self) -> dict[str, np.ndarray]:
        """What a reader needs, as angle, speed, what else varies, of a size the mass alone."""
        varying = {name: values for name, values in self.candidates.items()
                   if name in ("alpha", "v0") or np.ptp(values) > 0}  # fmt: skip
        return {name: values for name, values in varying.items() if "m" not in varying or name not in ("r", "b")}

    def condition_in_words(self, name: str, value: float) -> str:
        """A condition of a candidate: "40°", "30 m/s", "r = 0.2 mm"."""
        words = QUANTITIES[name].in_words(value, self.units)
        return words if name in ("alpha", "v0") else f"{QUANTITIES[name].symbol} = {words}"

    def _greatest(self, bits: np.ndarray) -> dict[str, float]:
        if np.isnan(bits).all():
            return {}
        at = int(np.nanargmax(bits))
        return {name: float(values[at]) for name, values in self.candidates.items()}

    @property
    def title(self) -> str:
        """How many candidates, and of which models."""
        count = len(self.total)
        return f"what one more row says, {count:,} candidate{'s' * (count > 1)}: {', '.join(self.names)}"

    @property
    def headings(self) -> tuple[str, ...]:
        """The columns of the table."""
        return tuple(f"{head} [{unit}]" if unit else head for head, unit, _ in self._columns())

    def rows(self) -> list[tuple[str, ...]]:
        """The best candidates."""
        columns = [[f"{value:{'.3f' if unit == 'bit' else '.4g'}}" for value in values[self.order]]
                   for _, unit, values in self._columns()]  # fmt: skip
        return [*zip(*columns, strict=True)][: min(_SHOWN, int(np.isfinite(self.total).sum()))]

    def _columns(self) -> list[tuple[str, str, np.ndarray]]:
        """Head, unit and values of the columns of the table; by the last of them it is sorted."""
        scales = {name: self._scale(name) for name in self.shown}
        columns = [(QUANTITIES[name].symbol, unit, self.shown[name] / size) for name, (size, unit) in scales.items()]
        columns.append(("about the parameters", "bit", self.information))
        if len(self.names) > 1:
            columns += [("about the model", "bit", self.discrimination), ("together", "bit", self.total)]
        return columns

    def _scale(self, name: str) -> Scale:
        return table_scale(QUANTITIES[name].dimension, self.units, float(np.max(np.abs(self.candidates[name]))))

    def to_dict(self) -> dict[str, Any]:
        """All candidates, in the order they were given in, and the best one."""
        return to_plain({
            "models": self.names,
            "candidates": dict(self.candidates),
            "information": self.information,
            "discrimination": self.discrimination,
            "noise": self.noise,
            "best": self.best,
            "sentence": self.sentence,
        })  # fmt: skip


def next_experiment(
    source: Posterior | PosteriorRanking,
    candidates: Mapping[str, Any] | None = None,
    *,
    noise: float | np.ndarray | ErrorModel | None = None,
    draws: int = _DRAWS,
    discrepancy: bool = True,
) -> NextExperiment:
    """Which angle, speed and size to measure next: where a row is expected to say most.

    The information is the expected drop of entropy from the present posterior to that with one more row, which is the
    mutual information of the row and the parameters (Lindley 1956). It is high where the draws of the posterior predict
    differently, measured in errors of the row: beside a jump of V(α) whose place is not known, above all. Of several
    models a row says two things, about the parameters of each, and about which one is right.

    A row says less of the parameters where the model may miss it.

    Args:
        source: a posterior, or several models' (`rank_posteriors`), with their probabilities.
        candidates: values of α [rad] and other conditions of the case, such as {"alpha": …, "v0": …}, arrays that
            broadcast; without it angles from the least to the greatest of the data, at the condition of most rows.
        noise: error of the row, a standard deviation [of the data], one for each candidate, or an `ErrorModel`; without
            it that of the data at the erosion that is expected, or the sampled one.
        draws: of each posterior.
        discrepancy: with what the model may lack, as `Posterior.predict`; its parameters count, too.

    Raises:
        ValueError: for candidates or a noise that make no sense.

    References:
        D. V. Lindley, On a measure of the information provided by an experiment, Ann. Math. Stat. 27 (1956) 986-1005.
    """
    posteriors = source.posteriors if isinstance(source, PosteriorRanking) else (source,)
    weights = source.weights if isinstance(source, PosteriorRanking) else np.ones(1)
    if not isinstance(noise, ErrorModel | None):
        check_unmasked("noise", noise)
        given = array_of(noise)
        if given.dtype.kind not in "iuf" or not (np.isfinite(given) & (given > 0)).all():
            raise ValueError(f"Argument `noise` must be positive and finite, but is {briefly(noise)}.")
    if candidates is not None and not isinstance(candidates, Mapping):
        raise ValueError(
            f"Argument `candidates` must be such as {{'alpha': …, 'v0': …}}, but is {briefly(candidates)}."
        )
    conditions = _conditions(posteriors, candidates)
    predictors = [posterior.predictor_with(discrepancy) for posterior in posteriors]
    given = True if noise is None else noise
    expected = [predictor.of_draws(conditions, draws, given) for predictor in predictors]
    information, discrimination = np.zeros((2, len(conditions["alpha"])))
    for i in range(len(information)):
        # A draw whose impact fails at a candidate predicts nothing there.
        known = [np.isfinite(means[:, i]) for means, *_ in expected]
        shares = [(means[of, i], np.linalg.norm([missed[of, i], common[of, i], own[of, i]], axis=0))
                  for (means, missed, common, own), of in zip(expected, known, strict=True)]  # fmt: skip
        information[i], discrimination[i] = _gains(shares, weights)
    errors = [np.nanmean(np.hypot(common, own), axis=0) for _, _, common, own in expected]
    return NextExperiment(
        conditions,
        information,
        discrimination,
        np.nanmean(errors, axis=0),
        tuple(model_name(posterior.model) for posterior in posteriors),
        posteriors[0].p.units,
        min(predictor.distinct(draws) for predictor in predictors),
    )


def tested_degrees(data: Measurements) -> np.ndarray:
    """Angles from the least to the greatest of the data [°], each 2.5°: beyond, priors decide what a test says."""
    low, high = np.round(np.rad2deg([data.angle.min(), data.angle.max()]), 6)
    steps = _STEP * np.arange(np.ceil(low / _STEP), np.floor(high / _STEP) + 1)
    return steps if steps.size else np.array([low])


def _conditions(posteriors: Sequence[Posterior], candidates: Mapping[str, Any] | None) -> dict[str, np.ndarray]:
    """The candidates, flat."""
    usual, others = posteriors[0].data.usual, {} if candidates is None else dict(candidates)
    if candidates is None:
        others["alpha"] = np.deg2rad(tested_degrees(posteriors[0].data))
    if "alpha" not in others:
        raise ValueError("Argument `candidates` must give angles, `alpha`, but gives none.")
    alpha = others.pop("alpha")
    checked, *_ = [posterior.likelihood.forward.conditions(alpha, others, usual) for posterior in posteriors]
    return {name: values.reshape(-1) for name, values in checked.items()}


def _gains(shares: Sequence[tuple[np.ndarray, np.ndarray]], weights: np.ndarray) -> tuple[float, float]:
    """What a row says about the parameters and about the model [bit].

    A row is one number, so that its density is a mixture of normal ones on a line, and entropies are sums over a grid.

    Args:
        shares: for each model the predictions and noises of its draws, both of shape (draws,).
        weights: probabilities of the models.
    """
    # Where an error is a share of nothing, no row has one, and what it would say is unknown.
    if not all(len(noise) and noise.all() for _, noise in shares):
        return np.nan, np.nan
    shares = _side_by_side(shares)
    ends = np.array([[(predicted - _REACH * noise).min(), (predicted + _REACH * noise).max()]
                     for predicted, noise in shares])  # fmt: skip
    least = min(float(noise.min()) for _, noise in shares)
    low, high = ends[:, 0].min(), ends[:, 1].max()
    count = int(np.clip((high - low) / least * _PER_NOISE, 64, _MOST))
    edges = np.linspace(low, high, count + 1)
    densities = np.stack([_density(predicted, noise, edges) for predicted, noise in shares])
    width = edges[1] - edges[0]
    of_models = np.array([_entropy(density, width) for density in densities])
    of_noise = np.array([np.mean(0.5 * np.log2(2 * np.pi * np.e * noise**2)) for _, noise in shares])
    # The parameters include the noise: what a row says about them is all of its entropy but that of the error.
    information = float(weights @ (of_models - of_noise))
    discrimination = _entropy(weights @ densities, width) - float(weights @ of_models)
    return max(information, 0.0), max(discrimination, 0.0)


def _side_by_side(shares: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """The same in units of the largest noise, without the gaps that no row falls into.

    Entropies do not change, but for the unit, and the grid is fine wherever a row can be.
    """
    unit = max(float(noise.max()) for _, noise in shares)
    predicted = np.concatenate([values for values, _ in shares])
    order = np.argsort(predicted)
    with np.errstate(over="ignore"):
        steps = np.minimum(np.diff(predicted[order]) / unit, 2 * _REACH)
    places = np.empty(len(predicted))
    places[order] = np.concatenate([[0.0], np.cumsum(steps)])
    of_models = np.split(places, np.cumsum([len(values) for values, _ in shares])[:-1])
    return [(place, noise / unit) for place, (_, noise) in zip(of_models, shares, strict=True)]


def _density(predicted: np.ndarray, noise: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """The density of a row on the cells of a grid: normal laws about the predictions, classes of like noise at once."""
    width = edges[1] - edges[0]
    density = np.zeros(len(edges) - 1)
    order = np.argsort(noise)
    for part in np.array_split(order, min(len(order), 1 if noise.min() == noise.max() else 16)):
        counts = np.histogram(predicted[part], edges)[0] / (len(predicted) * width)
        # The histogram's cells have a variance of 1/12 already.
        spread = np.sqrt(max(float(np.mean(noise[part] ** 2)) / width**2 - 1 / 12, 0.0))
        density += ndimage.gaussian_filter1d(counts, spread, mode="constant", truncate=_REACH)
    return density


def _entropy(density: np.ndarray, width: float) -> float:
    """-∫ f log₂ f over the grid."""
    positive = density[density > 0]
    return float(-np.sum(positive * np.log2(positive)) * width)
