"""`next_test`: the angle, speed and size at which one more test narrows a prediction, or the parameters, most."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special, stats

from erosion.arguments import check_unmasked
from erosion.fits.doubts import LEVEL
from erosion.fits.errors import ErrorModel
from erosion.fits.fit import Fit, require_fits
from erosion.fits.measurements import Measurements
from erosion.fits.ranking import rank
from erosion.models import model_name
from erosion.output import briefly, sentences
from erosion.parameters import QUANTITIES, InSI, Quantity, array_of, in_si
from erosion.results import Columns, Declared, Result, Scale, System, Value, ValueGroup

_DRAWS = 2000
_PLACES = np.linspace(-4.0, 4.0, 33)  # of a row about its mean, in standard deviations, by which cells are chosen
_CELLS = 400  # that a row may fall into: the entropy errs by less than 1e-3 bit
_SHOWN = 10
_STEP = 2.5  # ° between the candidates, if there are no others
_WIDTHS = float(stats.norm.ppf((1 + LEVEL) / 2))  # standard deviations in half of an interval


@dataclasses.dataclass(frozen=True, repr=False)
class NextTest(Result):
    """The narrowing of intervals by one more row, by angle and other conditions; arrays of shape (candidates,).

    Args:
        candidates: by parameter of the case, its values; "alpha" [rad] among them.
        prediction: the share by which the interval of the prediction becomes narrower; NaN where it is not known.
        parameters: the same of the parameters' intervals, the mean over parameters and models.
        discrimination: about which model is right [bit]; zeros for one model.
        noise: standard deviation of the row that was assumed, the mean over draws by their weights [SI].
        asked: the prediction's condition, by parameter.
        half_width: of the prediction's 95 % interval before the row, over its mean.
        names: the models.
        measured: the erosion of the rows.
        shown_in: the unit system that shows the numbers.
    """

    lines = ("candidates",)

    candidates: Mapping[str, np.ndarray]
    prediction: np.ndarray
    parameters: np.ndarray
    discrimination: np.ndarray
    noise: np.ndarray
    asked: Mapping[str, float]
    half_width: float
    names: tuple[str, ...]
    measured: Quantity
    shown_in: System = "si"

    @functools.cached_property
    def order(self) -> np.ndarray:
        """The indexes of the candidates, that which narrows the prediction most first."""
        return np.argsort(-self.prediction, kind="stable")  # NaN comes last

    @property
    def best(self) -> dict[str, float]:
        """The candidate that narrows the prediction most; empty if none is judged."""
        return self._greatest(self.prediction)

    @property
    def best_for_parameters(self) -> dict[str, float]:
        """The same of the parameters."""
        return self._greatest(self.parameters)

    @property
    def best_to_discriminate(self) -> dict[str, float]:
        """The same of the candidate that says most about which model is right."""
        return self._greatest(self.discrimination)

    @property
    def sentence(self) -> str:
        """The next test, the intervals that it narrows, and the candidates that cannot be judged."""
        unknown = np.isnan(self.prediction)
        why = "cannot be judged: draws have no volume or no error there."
        if unknown.all():
            return f"No candidate {why.replace('cannot', 'can')}"
        best = int(self.order[0])
        low, high = (f"{end:.4g}°" for end in np.rad2deg(np.sort(self.candidates["alpha"][unknown])[[0, -1]])
                     ) if unknown.any() else ("", "")  # fmt: skip
        after = self.half_width * (1 - self.prediction[best])
        return " ".join(sentences(
            (True, f"A test at {self._where(best)} narrows the prediction at {self.asked_in_words} most, from "
                   f"±{100 * self.half_width:.2g} % to ±{100 * after:.2g} %."),
            (np.isfinite(self.parameters).any(), self._of_parameters()),
            (len(self.names) > 1, f"It says {self.discrimination[best]:.2g} bit about which model is right."),
            (unknown.any(), f"{unknown.sum():,} of {len(unknown):,} candidates, "
                            f"{f'at {low}' if low == high else f'between {low} and {high}'}, {why}"),
        ))  # fmt: skip

    def _of_parameters(self) -> str:
        """A sentence on the parameters."""
        at = int(np.nanargmax(self.parameters))
        return f"One at {self._where(at)} narrows the parameters most, by {100 * self.parameters[at]:.2g} %."

    def _where(self, candidate: int) -> str:
        return " and ".join(self.condition_in_words(name, values[candidate]) for name, values in self.shown.items())

    @property
    def asked_in_words(self) -> str:
        """The condition of the prediction, such as "30° and 60 m/s"."""
        named = [name for name in self.asked if name in ("alpha", "v0") or name in self.shown]
        return " and ".join(self.condition_in_words(name, self.asked[name]) for name in named)

    @functools.cached_property
    def shown(self) -> dict[str, np.ndarray]:
        """The table's columns for angle, speed, and other varied parameters, of a size the mass alone."""
        varying = {name: values for name, values in self.candidates.items()
                   if name in ("alpha", "v0") or np.ptp(values) > 0}  # fmt: skip
        return {name: values for name, values in varying.items() if "m" not in varying or name not in ("r", "b")}

    def condition_in_words(self, name: str, value: float) -> str:
        """A condition of a candidate: "40°", "30 m/s", "r = 0.2 mm"."""
        words = QUANTITIES[name].in_words(value, self.shown_in)
        return words if name in ("alpha", "v0") else f"{QUANTITIES[name].symbol} = {words}"

    def _greatest(self, gains: np.ndarray) -> dict[str, float]:
        if np.isnan(gains).all():
            return {}
        at = int(np.nanargmax(gains))
        return {name: float(values[at]) for name, values in self.candidates.items()}

    @property
    def title(self) -> str:
        """How many candidates, and of which models."""
        count = len(self.prediction)
        return f"what one more test narrows, {count:,} candidate{'s' * (count > 1)}: {', '.join(self.names)}"

    def declare(self) -> list[Declared]:
        """All candidates in the order they were given in, the best ones in tables."""
        best = self.order[: min(_SHOWN, int(np.isfinite(self.prediction).sum()))]
        percent, is_one = {"scale": Scale(0.01, "%"), "digits": 3}, len(self.names) == 1
        words = {"prediction": f"narrows the prediction at {self.asked_in_words} by",
                 "parameters": "narrows the parameters by"}  # fmt: skip
        columns = [
            *(self._declared(name, values).but(only="" if name in self.shown else "data")
              for name, values in self.candidates.items()),
            *(Value(name, getattr(self, name), symbol, **percent) for name, symbol in words.items()),
            Value("discrimination", self.discrimination, "about the model", unit="bit", scale=Scale(1.0, "bit"),
                  digits=3, only="data" if is_one else ""),
            Value("noise", self.noise, only="data", measure=self.measured),
        ]  # fmt: skip
        tested = [column.but(value=np.asarray(column.value)[best]) for column in columns if column.only != "data"]
        chosen = {"asked": self.asked, "best": self.best, "best_for_parameters": self.best_for_parameters}
        return [
            Value("models", [*self.names], dims=("model",), only="data"),
            Columns("best_tests", self.title, tested, only="table"),
            Columns("candidates", "", columns, only="data"),
            Value("half_width", self.half_width, only="data"),
            *(ValueGroup(part, [self._declared(name, value) for name, value in values.items()], only="data")
              for part, values in chosen.items()),
        ]  # fmt: skip

    @property
    def conclusions(self) -> tuple[str, ...]:
        """The next test."""
        return (self.sentence,)

    def _declared(self, name: str, values: Any) -> Value:
        return QUANTITIES[name].declare(name, values, digits=4)


def next_test(
    source: Fit | Sequence[Fit],
    candidates: Mapping[str, Any] | None = None,
    *,
    for_prediction: Mapping[str, Any] | None = None,
    noise: float | np.ndarray | ErrorModel | None = None,
    draws: int = _DRAWS,
) -> NextTest:
    """Find the angle, speed and size at which one more row narrows intervals most.

    Draws of a fit, with what the model may lack, say how a row at a candidate and the prediction vary together. Their
    covariance says how much narrower the prediction's interval is after the row, exactly for normal laws: its variance
    falls by the share ρ² s²/(s² + e²), with the correlation ρ, the row's standard deviation s by the draws, and its
    error e. The same for each parameter, of the models as they are fitted. Of several models a row also says which one
    is right: the expected drop of entropy (Lindley 1956).

    Args:
        source: a fit, or fits of several models, of which those that are ranked count by their weights (see `rank`).
        candidates: values of α [rad] and other conditions of the case, such as {"alpha": …, "v0": …}, arrays that
            broadcast, or texts, read as `Parameters.replace` reads them; without it angles from the least to the
            greatest of the data, at the condition of most rows.
        for_prediction: the condition that is asked for, such as {"alpha": 0.5, "v0": "60 m/s"}; without an angle
            that of the greatest erosion among the tested ones, and else the condition of most rows.
        noise: error of the row, a standard deviation [SI], one for each candidate, or an `ErrorModel`; without
            it that of the data at the erosion that is expected, or the sampled one.
        draws: of each fit.

    Raises:
        ValueError: for candidates, a prediction or a noise that make no sense.

    References:
        D. V. Lindley, On a measure of the information provided by an experiment, Ann. Math. Stat. 27 (1956) 986-1005.
    """
    if not isinstance(noise, ErrorModel | None):
        check_unmasked("noise", noise)
        given = array_of(noise)
        if given.dtype.kind not in "iuf" or not (np.isfinite(given) & (given > 0)).all():
            raise ValueError(f"Argument `noise` must be positive and finite, but is {briefly(noise)}.")
    for name, asked in (("candidates", candidates), ("for_prediction", for_prediction)):
        if asked is not None and not isinstance(asked, Mapping):
            raise ValueError(f"Argument `{name}` must be such as {{'alpha': …, 'v0': …}}, but is {briefly(asked)}.")
    fits = require_fits("source", [source] if isinstance(source, Fit) else source)
    weights = np.ones(1)
    if len(fits) != 1:
        ranking = rank(fits)  # pyrefly: ignore
        fits, weights = ranking.fits, ranking.weights
    if np.isnan(weights).any():
        raise ValueError("Argument `source` must have fits whose AICc is known, but the tests are too few for it.")
    # Models that are not ranked have no weight.
    fits, weights = [fit for fit, weight in zip(fits, weights, strict=True) if weight > 0], weights[weights > 0]
    conditions, target = _conditions(fits, candidates, for_prediction or {})
    of_fits = [_Drawn.of(fit, conditions, target, draws, noise) for fit in fits]
    prediction, parameters, discrimination, errors = np.zeros((4, len(conditions["alpha"])))
    for i in range(len(prediction)):
        pooled = _pooled(of_fits, weights, i)
        prediction[i], errors[i] = _narrowed(*pooled), _mean(pooled[1], pooled[3])
        parameters[i] = weights @ [drawn.parameters_narrowed(i) for drawn in of_fits]
        if len(fits) > 1:
            discrimination[i] = _discrimination([drawn.known(i) for drawn in of_fits], weights)
    means = np.concatenate([drawn.asked for drawn in of_fits])
    sizes = [len(drawn.asked) for drawn in of_fits]
    shares = np.repeat(weights / np.maximum(sizes, 1), sizes)
    middle = float(shares @ means)
    deviation = float(np.sqrt(shares @ (means - middle) ** 2))
    return NextTest(
        conditions,
        prediction,
        parameters,
        discrimination,
        errors,
        {name: float(values) for name, values in target.items()},
        _WIDTHS * deviation / abs(middle) if middle else np.nan,
        tuple(model_name(fit.problem.model) for fit in fits),
        next(fit.data.quantity for fit in fits),
        next(fit.problem.p.shown_in for fit in fits),
    )


@dataclasses.dataclass(frozen=True)
class _Drawn:
    """Draws of one fit.

    Args:
        candidates: the mean erosion at each candidate, shape (draws, candidates).
        errors: standard deviations of a row there, of the same shape.
        asked: the prediction, shape (draws,).
        thetas: θ of the fitted parameters, shape (draws, names).
    """

    candidates: np.ndarray
    errors: np.ndarray
    asked: np.ndarray
    thetas: np.ndarray

    @classmethod
    def of(
        cls, fit: Fit, conditions: Mapping[str, np.ndarray], target: Mapping[str, np.ndarray], draws: int, noise: Any
    ) -> "_Drawn":
        """Curves of the fit's predictor at all conditions together; `noise` as of `next_test`."""
        predictor = fit.predictor
        both = {name: np.append(values, target[name]) for name, values in conditions.items()}
        if isinstance(noise, np.ndarray) and noise.ndim:
            noise = np.append(np.broadcast_to(noise, conditions["alpha"].shape), np.nan)
        at = InSI({name: values for name, values in both.items() if name != "alpha"})
        means, errors = predictor.with_errors(both["alpha"], at, draws, noise=True if noise is None else noise)
        chosen = [values for _, values in predictor.chosen(draws) if len(next(iter(values.values())))]
        thetas = np.stack([
            np.concatenate([values[name] for values in chosen]) for name in fit.problem.names
        ], axis=1)  # fmt: skip
        thetas = np.where(fit.problem.logarithmic, np.log(np.where(fit.problem.logarithmic, thetas, 1.0)), thetas)
        known = np.isfinite(means[:, -1])
        return cls(means[known, :-1], errors[known, :-1], means[known, -1], thetas[known])

    def known(self, candidate: int) -> tuple[np.ndarray, np.ndarray]:
        """Means and errors at a candidate, of draws whose impact does not fail there."""
        means = self.candidates[:, candidate]
        works = np.isfinite(means)
        return means[works], self.errors[works, candidate]

    def parameters_narrowed(self, candidate: int) -> float:
        """The mean share by which a row at a candidate narrows the parameters' intervals."""
        means = self.candidates[:, candidate]
        works, count = np.isfinite(means), len(means)
        equal = np.full(count, 1 / max(count, 1))[works]
        of_each = [
            _narrowed(means[works], self.errors[works, candidate], theta[works], equal) for theta in self.thetas.T
        ]
        return float(np.mean(of_each))


def _pooled(
    fits: Sequence[_Drawn], weights: np.ndarray, candidate: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means and errors at a candidate, the prediction, and the weight of each draw, of all fits together."""
    parts = []
    for drawn, weight in zip(fits, weights, strict=True):
        works = np.isfinite(drawn.candidates[:, candidate])
        share = np.full(int(works.sum()), weight / max(int(works.sum()), 1))
        parts.append((drawn.candidates[works, candidate], drawn.errors[works, candidate], drawn.asked[works], share))
    means, errors, asked, shares = (np.concatenate(part) for part in zip(*parts, strict=True))
    return means, errors, asked, shares


def _mean(values: np.ndarray, shares: np.ndarray) -> float:
    """The mean of draws by their weights; NaN without any."""
    return float(np.average(values, weights=shares)) if shares.sum() > 0 else np.nan


def _narrowed(means: np.ndarray, errors: np.ndarray, asked: np.ndarray, shares: np.ndarray) -> float:
    """The share by which a row narrows the interval of what is asked; NaN where no row has an error or a size.

    Args:
        means: of the row, shape (draws,).
        errors: standard deviations of the row about them.
        asked: what is narrowed.
        shares: weights of the draws.
    """
    if not (len(means) and shares.sum() > 0 and (errors > 0).all() and means.any()):
        return np.nan
    shares = shares / shares.sum()
    of_row, of_asked = means - shares @ means, asked - shares @ asked
    variance, together = shares @ of_asked**2, shares @ (of_row * of_asked)
    if not variance > 0:
        return 0.0
    explained = together**2 / (shares @ of_row**2 + shares @ errors**2) / variance
    return float(1 - np.sqrt(max(1 - explained, 0.0)))


def tested_degrees(data: Measurements) -> np.ndarray:
    """Angles from the least to the greatest of the data [°], each 2.5°: beyond, priors decide what a test says."""
    low, high = np.round(np.rad2deg([data.angle.min(), data.angle.max()]), 6)
    steps = _STEP * np.arange(np.ceil(low / _STEP), np.floor(high / _STEP) + 1)
    return steps if steps.size else np.array([low])


def _conditions(
    fits: Sequence[Fit], candidates: Mapping[str, Any] | None, asked: Mapping[str, Any]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """The candidates, flat, and the condition of the prediction, with the same parameters."""
    fit, shown_in = fits[0], fits[0].problem.p.shown_in
    others = InSI(in_si(candidates, QUANTITIES, shown_in))
    if candidates is None:
        others["alpha"] = np.deg2rad(tested_degrees(fit.data))
    if "alpha" not in others:
        raise ValueError("Argument `candidates` must give angles, `alpha`, but gives none.")
    named = {*others, *asked} & {*QUANTITIES} - {"alpha", *fit.problem.free}
    usual = {**{name: getattr(fit.problem.p, name) for name in sorted(named)}, **fit.data.usual}
    alpha = others.pop("alpha")
    checked, *_ = [each.problem.conditions(alpha, others, usual) for each in fits]
    given = InSI(in_si(asked, QUANTITIES, shown_in))
    at = given.pop("alpha", None)
    if at is None:
        tested = np.deg2rad(tested_degrees(fit.data))
        curves = fit.predictor.draw(tested, InSI({**usual, **given}))
        works = np.isfinite(curves).any(axis=0)
        if not works.any():
            raise ValueError("Argument `for_prediction` must give an angle, because no tested one has a prediction.")
        at = float(tested[works][int(np.argmax(np.nanmean(curves[:, works], axis=0)))])
    target = fit.problem.conditions(at, given, usual)
    if any(values.size != 1 for values in target.values()):
        raise ValueError(f"Argument `for_prediction` must have one number each, but is {briefly(asked)}.")
    return {name: values.reshape(-1) for name, values in checked.items()}, {
        name: values.reshape(()) for name, values in target.items()
    }


def _discrimination(shares: Sequence[tuple[np.ndarray, np.ndarray]], weights: np.ndarray) -> float:
    """What a row says about which model is right [bit]: the entropy of its cell less the mean of that by each model.

    Args:
        shares: for each model the predictions and noises of its draws, both of shape (draws,).
        weights: probabilities of the models.
    """
    # Where an error is a share of nothing, no row has one, and what it would say is unknown.
    if not all(len(noise) and noise.all() for _, noise in shares):
        return np.nan
    rows = np.concatenate([predicted + np.multiply.outer(_PLACES, noise) for predicted, noise in shares], axis=1)
    places = np.unique(np.quantile(rows, np.linspace(0, 1, _CELLS + 1)))
    edges = np.concatenate([[-np.inf], (places[1:] + places[:-1]) / 2, [np.inf]])
    cells = np.stack([
        np.diff(special.ndtr((edges[:, None] - predicted) / noise), axis=0).mean(axis=1) for predicted, noise in shares
    ])  # fmt: skip
    return max(float(stats.entropy(weights @ cells, base=2) - weights @ stats.entropy(cells, base=2, axis=1)), 0.0)
