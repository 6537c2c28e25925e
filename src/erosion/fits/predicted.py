"""Tables of predictions: the mean at angles, speeds and sizes, that of a new weighing, the best angles."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import special

from erosion.arguments import check_share
from erosion.fits.doubts import LEVEL
from erosion.fits.fit import Fit, require_fits
from erosion.fits.prediction import Predictor
from erosion.impacts import Optimum
from erosion.models.registry import model_name
from erosion.output import largest_of, to_csv
from erosion.parameters import (
    QUANTITIES,
    RESULTS,
    Dimension,
    InSI,
    Scale,
    ascii_unit,
    declare_result,
    known_scales,
    table_scale,
)
from erosion.results import Columns, Declared, Finding, Result, System, Value, ValueGroup, found

_DRAWS = 2000  # the ends of an interval are known to some percents of its width
_TOGETHER = 60  # questions of one batch, as the time of curves grows with the third power
_HALVINGS = 50  # of the bracket of an end
_FURTHEST = 10.0  # standard deviations of a weighing from its mean
_NOTHING = 1e-3  # of the greatest prediction
_DIGITS = 4

COMPUTED = ("mean", "mean_low", "mean_high", "weighing_low", "weighing_high")
"""The columns that are computed."""


@dataclasses.dataclass(frozen=True, repr=False)
class Predictions(Result):
    """The wear at each question, with two intervals.

    Args:
        predictor: what predicts.
        columns: what is asked, "alpha" and others, and `COMPUTED`; each of shape (n,).
        level: of the intervals.
        lost: share of the impacts that could not be computed and are left out.
    """

    lines = ("predictions",)

    predictor: Predictor
    columns: Mapping[str, np.ndarray]
    level: float
    lost: float

    def dimension(self, name: str) -> Dimension:
        """Of a column."""
        return self.predictor.data.dimension if name in COMPUTED else QUANTITIES[name].dimension

    @property
    def asked(self) -> InSI:
        """The columns that are asked."""
        return InSI({name: column for name, column in self.columns.items() if name not in COMPUTED})

    @functools.cached_property
    def _scales(self) -> dict[str, Scale]:
        """The unit in which each column reads well; what is computed has that of the tests."""
        largest = {name: largest_of(part) for name, part in self.columns.items()}
        data = self.predictor.data
        scales = {name: table_scale(self.dimension(name), data.shown_in, most) for name, most in largest.items()}
        return scales | dict.fromkeys(COMPUTED, data.scale)

    @property
    def title(self) -> str:
        """The model, what it predicts, and the tests."""
        data = self.predictor.data
        name = model_name(self.predictor.problem.model)
        return f"{name}: {data.quantity.meaning} by the fit to {len(data):,} rows of {data.source}"

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.predictor.data.shown_in

    def declare(self) -> list[Declared]:
        """A record for each question, and the numbers of the predictor."""
        share, columns = f"{100 * self.level:g} %", self.columns
        scales, largest = self._scales, max(map(largest_of, (columns[name] for name in COMPUTED)))
        digits = max(_DIGITS, int(np.log10(largest / scales["mean"].size or 1.0)) + 1)  # no powers of ten
        common = {"measure": self.predictor.data.quantity, "scale": scales["mean"], "digits": digits}

        def interval(of: str, words: str) -> Value:
            ends = zip(columns[f"{of}_low"].tolist(), columns[f"{of}_high"].tolist(), strict=True)
            return Value(of, [*ends], f"{share} of {words}", **common, only="table")

        return [
            Value("level", self.level, only="data"),
            Columns("predictions", self.title, [
                *(QUANTITIES[name].declare(name, column, scale=scales[name], digits=_DIGITS)
                  for name, column in self.asked.items()),
                *(Value(name, columns[name], **common, only="" if name == "mean" else "data") for name in COMPUTED),
                interval("mean", "the mean"),
                interval("weighing", "a new weighing"),
            ]),
            ValueGroup("", self.predictor.declare(), self.predictor.title),
        ]  # fmt: skip

    @property
    def conclusions(self) -> tuple[str, ...]:
        """The meaning of each interval."""
        data, parts = self.predictor.data, ", ".join(self.predictor.parts)
        known = "" if data.error is None else data.error.in_words(data.dimension, data.shown_in)
        found = "the error that the fit found" if data.uncertainty is None else "its error"
        error = f"{found}{', ' * bool(known)}{known}"
        return (f"The interval of the mean holds {parts}; that of a new weighing also {error}.",)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of the predictor, questions outside the tests, and losses."""
        at = self.asked
        high, means = self.columns["mean_high"], self.columns["mean"]
        turned = self.predictor.share_turned(at)
        nothing = np.unique(at["alpha"][high <= _NOTHING * np.nanmax(means)])
        return (
            *self.predictor.findings,
            *found((turned, Finding("turned_beyond_at_draws", numbers={"share": turned}))),
            *self.predictor.outside(at.pop("alpha"), at),
            *found(
                (nothing.size, Finding("removes_nothing", "", {"alphas": nothing})),
                (self.lost, Finding("predictions_lost", "", {"share": self.lost})),
            ),
        )

    def to_csv_as_shown(self) -> str:
        """The columns in units that read well, which the headings name: "mean [mg/kg]"."""
        data, columns = self.predictor.data, dict[str, list[float]]()
        for name, scale in self._scales.items():
            known = [*known_scales(self.dimension(name), data.shown_in), data.scale][: None if data.unit else -1]
            size, unit = scale if scale in known else known[0]
            columns[f"{name} [{ascii_unit(unit).replace('°', 'deg')}]"] = (self.columns[name] / size).tolist()
        return to_csv(columns)


def predict(
    source: Fit | Predictor, alpha: Any, at: Mapping[str, Any] | None = None, *, level: float = LEVEL
) -> Predictions:
    """The mean of the erosion at questions, with an interval of the mean and one of a new weighing.

        erosion.predict(fit, np.deg2rad([20.0, 40.0]), {"v0": "60 m/s"})

    The intervals also hold what the model may lack, see `erosion.fits.prediction`.

    Args:
        source: a fit, or its predictor.
        alpha: α [rad], of any shape.
        at: other parameters of the case, numbers or arrays that broadcast with `alpha`, or texts, read as
            `Parameters.replace` reads them; a speed or a mass that is not given and differs from row to row is that of
            `Predictor.usual`, and the table has it.
        level: of the intervals.
    """
    predictor = source if isinstance(source, Predictor) else require_fits("source", [source])[0].predictor
    asked = {name: column.ravel() for name, column in predictor.question(alpha, at).items()}
    shares = (1 - check_share("level", level)) / 2, (1 + level) / 2
    parts, lost = [], []
    for start in range(0, len(asked["alpha"]), _TOGETHER):
        some = InSI({name: column[start : start + _TOGETHER] for name, column in asked.items()})
        means, errors = predictor.with_errors(some.pop("alpha"), some, _DRAWS)
        lost.append(np.isnan(means).mean(axis=0))
        low, high = np.nanquantile(means, shares, axis=0)
        # The ends of the mean are known by draws: by chance they may lie beyond those of a weighing.
        outer = [np.minimum(low, _end_of_weighing(means, errors, shares[0])),
                 np.maximum(high, _end_of_weighing(means, errors, shares[1]))]  # fmt: skip
        parts.append(np.stack([np.nanmean(means, axis=0), low, high, *outer]))
    columns = {name: column for name, column in asked.items() if name in ("alpha", "v0", "m")}
    columns |= dict(zip(COMPUTED, np.concatenate(parts, axis=1), strict=True))
    return Predictions(predictor, columns, level, float(np.concatenate(lost).mean()))


def _end_of_weighing(means: np.ndarray, errors: np.ndarray, share: float) -> np.ndarray:
    """Below which this share of weighings lies, each normal about its draw of the mean; (draws, n) -> (n,)."""
    low, high = np.nanmin(means - _FURTHEST * errors, axis=0), np.nanmax(means + _FURTHEST * errors, axis=0)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        certain = np.where(middle >= means, np.inf, -np.inf)
        distance = np.divide(middle - means, errors, where=errors > 0, out=certain)
        below = np.mean(special.ndtr(distance), axis=0, where=np.isfinite(means))
        low, high = np.where(below < share, middle, low), np.where(below < share, high, middle)
    return (low + high) / 2


@dataclasses.dataclass(frozen=True, repr=False)
class BestAngles(Result):
    """The angle of greatest removal at each draw of a posterior.

    Args:
        optimum: the certified answers of the model alone, whose fields have the shape (draws,).
        predicted: the angles [rad] of curves that also hold what the model may lack, shape (draws,); None without.
        parts: what the curves hold, in words.
    """

    lines = ("draw",)

    optimum: Optimum
    predicted: np.ndarray | None = None
    parts: tuple[str, ...] = ("parameters",)

    @property
    def alpha(self) -> np.ndarray:
        """The angles [rad], shape (draws,), with all `parts`; NaN where nothing is removed."""
        return self.of_model if self.predicted is None else self.predicted

    @property
    def of_model(self) -> np.ndarray:
        """The certified angles of the model alone [rad], shape (draws,)."""
        return np.atleast_1d(np.asarray(self.optimum.alpha))

    @property
    def kinds(self) -> dict[str, float]:
        """What the greatest removal is, as `Optimum.kind` has it: the share of the draws."""
        kinds, counts = np.unique(np.atleast_1d(self.optimum.kind), return_counts=True)
        return {str(kind): float(count / counts.sum()) for kind, count in zip(kinds, counts, strict=True)}

    @property
    def title(self) -> str:
        """How many draws."""
        return f"the angle of greatest removal, {len(self.alpha):,} draws"

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.optimum.p.shown_in

    def declare(self) -> list[Declared]:
        """Medians and intervals of angle and volume; draw by draw the angles, those of the model alone, the kinds."""
        alone = "the model alone: "
        draws: dict[str, Any] = {"dims": ("draw",), "only": "data"}
        volume, angle = np.atleast_1d(self.optimum.volume), QUANTITIES["alpha"]
        middles = [("alpha_max", "alpha_max", f"with {', '.join(self.parts)}: ", self.alpha)]
        middles += [] if self.predicted is None else [("alpha_of_model", "alpha_max", alone, self.of_model)]
        return [
            *(self._median(*middle) for middle in (*middles, ("volume_max", "volume_max", alone, volume))),
            angle.declare("alpha", self.alpha, **draws),
            Value("parts", [*self.parts], dims=("part",), only="data"),
            angle.declare("alpha_of_model", self.of_model, **draws),
            declare_result("volume", volume, **draws),
            Value("kind", np.atleast_1d(self.optimum.kind), **draws),
            Value("kinds", [*self.kinds.values()], meaning="of the draws, the model alone", labels=[*self.kinds],
                  scale=Scale(0.01, "%")),
        ]  # fmt: skip

    def _median(self, name: str, of: str, what: str, values: np.ndarray) -> Value:
        """The median in tables, with the interval in words."""
        quantity = RESULTS[of]
        low, middle, high = np.nanquantile(values, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2])
        scale = quantity.scale(self.shown_in, float(middle))
        ends = f"{LEVEL:.0%} of the draws: {low / scale.size:.4g} … {high / scale.size:.4g}"
        meaning = f"{what}the median; {ends}"
        return quantity.declare(name, float(middle), scale=scale, digits=4, meaning=meaning, only="table")


ANGLES = np.deg2rad(np.arange(1.0, 91.0))
"""Of the curves whose highest points are looked for."""


def highest(curves: np.ndarray) -> np.ndarray:
    """The angle at which each curve over `ANGLES` is highest, by the parabola of three points; NaN without removal."""
    rows, step = np.arange(len(curves)), ANGLES[1] - ANGLES[0]
    middle = np.clip(np.nan_to_num(curves).argmax(axis=1), 1, len(ANGLES) - 2)
    before, there, after = (curves[rows, middle + shift] for shift in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        vertex = 0.5 * (before - after) / (before - 2 * there + after)
    return np.clip(ANGLES[middle] + step * np.clip(vertex, -1, 1), *ANGLES[[0, -1]])
