"""`calibrate` and its result: estimates, their errors and intervals, and warnings."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from scipy import stats

from erosion.arguments import check_share, check_whole
from erosion.fits import doubts
from erosion.fits.doubts import LEVEL, OPEN, TOUCH
from erosion.fits.fit import Fit
from erosion.fits.least_squares import (
    FINEST,
    LOSSES,
    CalibrationError,
    FitSolution,
    Group,
    Identifiability,
    LeastSquares,
    fit,
    identify,
    make_squares,
)
from erosion.fits.likelihood import flat_laws, make_likelihood
from erosion.fits.measurements import Measurements
from erosion.fits.prediction import Predictor, make_predictor
from erosion.fits.problem import FACTORS, FRACTION, FitProblem
from erosion.fits.profiles import Profile, Ridge
from erosion.fits.residual_checks import check
from erosion.models import CuttingModel, impact_to_dict, model_name, own_parameters, quantities
from erosion.output.tables import Record, briefly
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import InSI, Quantity, table_scale
from erosion.results import Declared, Finding, Value, ValueGroup

_ROUNDING = 1e-9  # of leverages
_STARTS_WITHOUT = 4  # of a fit without one row, of which the fit with it is the first
_PROFILED = 1.8  # intervals of that level, to either side of an estimate


@dataclasses.dataclass(frozen=True, repr=False)
class Calibration(Fit):
    """A model fitted to measurements.

    Args:
        squares: the model, data and weights.
        solution: the minimum.
        level: of the intervals in tables and documents.
    """

    lines = ("row",)

    squares: LeastSquares
    solution: FitSolution
    level: float = LEVEL

    @property
    def model(self) -> CuttingModel:
        """The fitted model, with the estimates of its own parameters in place."""
        return self.problem.at(self.solution.theta)[0]

    @property
    def problem(self) -> FitProblem:
        """The model and the case of the first guess, and the data."""
        return self.squares.problem

    @property
    def data(self) -> Measurements:
        """The measurements, whose relative errors are of the fit."""
        return self.squares.data

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters; "scale" is the last where the data has units of its own."""
        return self.problem.names

    @property
    def p(self) -> Parameters:
        """The case with the estimates in place."""
        return self.problem.at(self.solution.theta)[1]

    @property
    def cutting_fraction(self) -> float:
        """The share of the particles that cut, estimated or given."""
        return self.estimates.get(FRACTION, self.problem.cutting_fraction)

    @property
    def estimates(self) -> dict[str, float]:
        """The best value of each free parameter."""
        return self.problem.values(self.solution.theta)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Symbol, meaning and dimension of each free parameter."""
        known = {**quantities(self.model), **FACTORS}
        return {name: known[name] for name in self.names}

    def in_words(self, name: str, value: float, digits: int = 4) -> str:
        """A value of a free parameter with its unit: "7.25 m/s"."""
        return self.quantities[name].in_words(value, self.p.shown_in, digits)

    @property
    def standard_errors(self) -> dict[str, float]:
        """One standard deviation of each estimate; infinite where the data does not determine it."""
        with np.errstate(invalid="ignore"):
            errors = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.names, errors.tolist(), strict=True))

    @functools.cached_property
    def covariance(self) -> np.ndarray:
        """Covariance of the estimates, shape (names, names); infinite and NaN where not determined."""
        slopes = self.problem.slopes(self.solution.theta)
        return self.covariance_of_theta * np.outer(slopes, slopes)

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the estimates, shape (names, names); NaN where not determined."""
        with np.errstate(invalid="ignore"):
            errors = np.sqrt(np.diag(self.covariance))
            return self.covariance / np.outer(errors, errors)

    def intervals(self, level: float = LEVEL) -> dict[str, tuple[float, float]]:
        """A confidence interval of each parameter, by its profile likelihood.

        The interval reaches to where χ² has risen by `rise(level)` with all other parameters
        fitted again, or to the bound. Where the misfit is a parabola it is symmetric and follows
        from `standard_errors`; near jumps of V(α) it does not. Infinite for parameters that the
        data does not determine, and NaN where the model fails on the way. The ends are accurate
        to 2 % of their distance from the estimate, and take as long as some fits.
        """
        values = self.problem.from_theta
        with np.errstate(over="ignore"):
            ends = {
                name: (float(values(name, theta + low)), float(values(name, theta + high)))
                for name, theta, (low, high) in zip(self.names, self.solution.theta, self.ends(level), strict=True)
            }
        # An end at a bound is off by rounding.
        for name, (lower, upper) in self.bounds.items():
            if name not in self.undetermined:
                ends[name] = max(ends[name][0], lower), min(ends[name][1], upper)
        return ends

    def rise(self, level: float = LEVEL) -> float:
        """The rise of χ² from the minimum to the ends of the intervals of `level`."""
        tail = (1 + check_share("level", level)) / 2
        if self.data.uncertainty is not None:
            return float(stats.norm.ppf(tail)) ** 2
        return float(stats.t.ppf(tail, self.degrees_of_freedom)) ** 2

    @functools.cached_property
    def fitted(self) -> np.ndarray:
        """The fitted erosion of each row, in the data's dimension, shape (rows,)."""
        return self.problem.predict(self.solution.theta, self.data.conditions)[0]

    @property
    def residuals(self) -> np.ndarray:
        """Measured less fitted, shape (rows,)."""
        return self.data.erosion - self.fitted

    def without(self, row: int) -> "Calibration | None":
        """The fit to the other rows, from this one's estimates on; None where it fails."""
        rows = np.flatnonzero(np.arange(len(self.data)) != row)
        try:
            others = dataclasses.replace(self.problem, data=self.problem.data.of_rows(rows))
            squares = dataclasses.replace(self.squares, problem=others, data=others.data, start=self.solution.theta)
            return Calibration(*fit(squares, self.squares.loss, _STARTS_WITHOUT), self.level)
        except (CalibrationError, ValueError):  # without erosion in the other rows they are no problem of a fit
            return None

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, in the data's dimension."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def noise(self) -> float:
        """The typical standard deviation of a row over the greatest fitted erosion."""
        own = self.squares.data.deviation * np.sqrt(self.variance)
        deviation = float(np.median(np.hypot(own, self.data.share_of_speeds * self.fitted)))
        return deviation / float(np.abs(self.fitted).max())

    @property
    def chi2(self) -> float:
        """Sum of squares of residuals over their standard deviation (of the robust loss, if one is chosen)."""
        return 2 * self.solution.cost / self.variance

    @property
    def degrees_of_freedom(self) -> int:
        """Rows less the determined combinations of parameters."""
        return len(self.data) - self.identifiability.rank

    @property
    def aicc(self) -> float:
        """Akaike's criterion, corrected for few rows; smaller is better, among fits of the same data.

        A robust loss is the likelihood of errors of a given size, the noise. So fits are compared at the same noise, as
        `rank` does (Ronchetti 1985, robust model selection in regression). Infinite for fewer rows than
        `rows_for_aicc`.
        """
        rows, free, noise = len(self.data), self._counted, self.squares.noise
        if self.data.uncertainty is None and self.squares.loss == "linear":
            with np.errstate(divide="ignore"):
                misfit = rows * float(np.log(2 * self.solution.cost / rows))
        else:
            misfit = 2 * (self.solution.cost / noise**2 + rows * float(np.log(noise)))
        if rows < self.rows_for_aicc:
            return np.inf
        # Relative errors are of the fit: those of a larger fit are less likely to be this small.
        misfit += self.squares.data.log_determinant - self.problem.data.log_determinant
        return misfit + 2 * free + 2 * free * (free + 1) / (rows - free - 1)

    @property
    def rows_for_aicc(self) -> int:
        """The fewest rows for which AICc is known."""
        return self._counted + 2

    @property
    def _counted(self) -> int:
        """How many parameters AICc counts.

        A parameter counts if it has influence here or at the first guess: the fit may have moved it
        to a place without influence. Without uncertainties the variance was estimated, too.
        """
        return max(self.identifiability.rank, self._rank_at_first) + (self.data.uncertainty is None)

    @functools.cached_property
    def leverage(self) -> np.ndarray:
        """The hat matrix's diagonal, which is how much each row draws the fit to itself; shape (rows,)."""
        return np.sum((self.solution.jacobian @ self.identifiability.modes) ** 2, axis=1)

    @functools.cached_property
    def leave_one_out(self) -> float:
        """Root mean square of the errors at rows left out of the fit, in the data's dimension.

        From the leverage of each row (Allen's PRESS): exact for linear models with errors of
        their own, and to first order in the noise for these. Infinite where one row alone determines a parameter.
        """
        rest = 1 - self.leverage
        if np.min(rest) < _ROUNDING:
            return np.inf
        return float(np.sqrt(np.mean((self.residuals / rest) ** 2)))

    @functools.cached_property
    def identifiability(self) -> Identifiability:
        """The parameters and combinations that the data determines."""
        return self._identify(self.solution.theta, self.solution.jacobian, self.squares.data.over_errors(self.fitted))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The parameters whose estimates mean nothing by themselves."""
        return self.identifiability.undetermined

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings of this fit; empty for a good one."""
        return doubts.doubts(self)

    @property
    def undecided(self) -> tuple[str, ...]:
        """The parameters whose intervals are so wide, a factor of 20, that their estimates say little."""
        touched, both = self.bounds_touched(), {"interval at lower", "interval at upper"}
        return tuple(
            name
            for name, logarithmic, (low, high) in zip(
                self.names, self.problem.logarithmic, self.ends(LEVEL), strict=True
            )
            if name not in self.undetermined
            and (high - low > OPEN if logarithmic else both <= {*touched.get(name, ())})
        )

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """The least and the greatest value that each parameter may take."""
        squares, value = self.squares, self.problem.from_theta
        return {
            name: (float(value(name, low)), float(value(name, high)))
            for name, low, high in zip(self.names, squares.lower, squares.upper, strict=True)
        }

    def bounds_touched(self, level: float = LEVEL) -> dict[str, tuple[str, ...]]:
        """By parameter, what lies at a bound: "estimate at lower", "interval at upper"; only those that touch one."""
        theta, squares, touched = self.solution.theta, self.squares, {}
        for at, name in enumerate(self.names):
            if name in self.undetermined:  # whose interval has no ends
                continue
            low, high = self.ends(level)[at]
            sides = (("lower", squares.lower[at], low), ("upper", squares.upper[at], high))
            marks = [f"estimate at {side}" for side, bound, _ in sides if abs(theta[at] - bound) < TOUCH]
            marks += [f"interval at {side}" for side, bound, end in sides if abs(theta[at] + end - bound) < TOUCH]
            if marks:
                touched[name] = tuple(marks)
        return touched

    def curve(self, alpha: Any, at: Mapping[str, Any] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The fitted erosion at angles α [rad], with its standard error.

        Args:
            alpha: α [rad], of any shape.
            at: other parameters of the case than its own, such as {"v0": "60 m/s"}; see `Parameters.replace`.

        Returns:
            Erosion and one standard deviation of it (of the fit, without the noise of a
            measurement), each of the shape of `alpha`.
        """
        asked = self.problem.conditions(alpha, at)
        flat = {name: column.ravel() for name, column in asked.items()}
        erosion, rates = self.problem.predict(self.solution.theta, flat)
        # Directions without influence on any row have no influence on the curve either.
        spread = np.sum((rates @ self.identifiability.modes) ** 2, axis=1)
        errors = np.sqrt(spread * self.variance)
        return erosion.reshape(asked["alpha"].shape), errors.reshape(asked["alpha"].shape)

    @functools.cached_property
    def predictor(self) -> Predictor:
        """The predictor that `predict` uses, drawn on first use within the bounds; as `Posterior.predictor`.

        A robust loss counts as errors that are greater where it holds rows back.
        """
        squares, problem, data = self.squares, self.problem, self.data
        if squares.loss != "linear":
            weights = squares.weights(squares.data.over_errors(self.residuals))
            spread = squares.data.deviation * np.sqrt(self.variance / weights)
            data = dataclasses.replace(data, uncertainty=spread, parts=None, error=None)
        laws = flat_laws(problem, {name: ends for name, ends in self.bounds.items() if np.isfinite(ends).all()})
        within = dataclasses.replace(problem, data=data, bounds={}, priors=InSI(laws))
        return make_predictor(make_likelihood(within), self.estimates, seed=0)

    @functools.cached_property
    def samples(self) -> xr.Dataset:
        """Samples of what the rows leave within the bounds if the model is right, over the dimensions (chain, draw)."""
        return self.dataset({name: values[None] for name, values in self.predictor.hypotheses["model"].values.items()})

    @functools.cached_property
    def groups(self) -> Sequence[Group]:
        """Groups of parameters that the data determine together only."""
        return self.identifiability.groups

    def profile(self, name: str, points: int = 21) -> Profile:
        """The likelihood's profile along one parameter, with all others fitted again at each value.

        Args:
            name: of the parameter.
            points: approximate number, from beyond one end of the 95 % interval to beyond the other.

        Raises:
            ValueError: for a name that is not free.
            CalibrationError: where the model fails.
        """
        if name not in self.names:
            raise ValueError(f"Argument `name` must be one of {', '.join(self.names)}, but is {briefly(name)}.")
        at, problem = self.names.index(name), self.problem
        best, low, high = self.solution.theta[at], self.squares.lower[at], self.squares.upper[at]
        reach = [_PROFILED * end if abs(end) < np.inf else np.sign(end) for end in self.ends(LEVEL)[at]]
        offsets = np.outer(reach, np.linspace(0.0, 1.0, points // 2 + 1))
        offsets = np.unique(np.clip(offsets, low - best, high - best))
        rise = self._ridge(at).rises(offsets, self.variance / 2)
        values = problem.from_theta(name, best + offsets)
        if np.isnan(rise + offsets).any():
            where = self.in_words(name, self.estimates[name])
            raise CalibrationError(f"The profile of {name} cannot be made: the model fails near {where}.")
        return Profile(name, values, 2 * rise / self.variance, self.quantities[name], self.shown_in)

    @property
    def error_meaning(self) -> str:
        """The meaning of the errors and intervals of the estimates, in words."""
        source = "their scatter" if self.data.uncertainty is None else "the rows' uncertainties"
        share = self.data.share_of_speeds
        return f"± and intervals are by {source} {f'and {100 * share:.4g} % of each speed' if share else 'alone'}"

    @property
    def subject(self) -> Record:
        """Model and case with the estimates."""
        return impact_to_dict(self.model, self.p)

    def declare(self) -> list[Declared]:
        """Estimates, their errors and intervals, and the quality of the fit."""
        has_errors = self.data.uncertainty is not None
        measure, scale = self.data.quantity, self.data.scale_of(self.rms)
        checks = check(self)
        needs = f": needs at least {self.rows_for_aicc} rows for these parameters" if self.aicc == np.inf else ""
        without = ": there is a row without which a parameter is open" if self.leave_one_out == np.inf else ""
        return [
            *map(self._row, self.names),
            *(own.quantity.declare(name, float(own.value), meaning="held", only="table")
              for name, own in own_parameters(self.model).items() if name not in self.names),
            Value("rows", len(self.data), only="data"),
            Value("cutting_fraction", self.cutting_fraction, only="data"),
            self.of_parameters("estimates", self.estimates),
            self.of_parameters("standard_errors", self.standard_errors),
            self.of_parameters("intervals", self.intervals(self.level)),
            Value("level", self.level, only="data"),
            Value("correlation", self.correlation, dims=("parameter", "other_parameter"), only="data"),
            Value("undetermined", [*self.undetermined], dims=("undetermined",), only="data"),
            Value("undecided", [*self.undecided], dims=("undecided",), only="data"),
            self.of_parameters("bounds", self.bounds),
            ValueGroup(
                "bounds_touched",
                [Value(name, [*marks], dims=(name,)) for name, marks in self.bounds_touched(self.level).items()],
                only="data",
            ),
            Value("rms", self.rms, meaning=f"of the residuals; {self.error_meaning}", measure=measure,
                  scale=scale, digits=5),
            *_known(Value("leave_one_out", self.leave_one_out, meaning=f"rms at rows left out{without}",
                          measure=measure, scale=scale, digits=5)),
            Value("noise", "given" if has_errors else "estimated from the residuals", only="data"),
            Value("chi2", self.chi2, "χ²", f"{self.degrees_of_freedom} degrees of freedom", digits=5,
                  only="" if has_errors else "data"),
            Value("degrees_of_freedom", self.degrees_of_freedom, only="data"),
            *checks.of_repeats,
            *_known(Value("aicc", self.aicc, meaning=f"Akaike's criterion, for few data{needs}")),
            Value("residuals", self.residuals, measure=measure, dims=("row",), only="data"),
            dataclasses.replace(checks.of_patterns, only="data"),
            Value("erosion_unit", measure.unit(self.shown_in), only="data"),
        ]  # fmt: skip

    def _row(self, name: str) -> Value:
        """A parameter in tables."""
        quantity = self.quantities[name]
        scale = table_scale(quantity.dimension, self.p.shown_in, abs(self.estimates[name]))
        value, meaning = doubts.in_words(self, name, self.level, scale.size)
        return Value(name, value, quantity.symbol, meaning, scale=scale._replace(size=1.0), only="table")

    @property
    def title(self) -> str:
        """The model and the data."""
        return f"{model_name(self.model)}: fitted to {len(self.data):,} rows of {self.data.source}"

    @property
    def covariance_of_theta(self) -> np.ndarray:
        """Covariance of θ, shape (names, names)."""
        return self.identifiability.covariance * self.variance

    @functools.cached_property
    def variance(self) -> float:
        """The variance of the weighted residuals, 1 with uncertainties, else estimated from the residuals."""
        if self.data.uncertainty is not None:
            return 1.0
        return max(2 * self.solution.cost / self.degrees_of_freedom, FINEST**2 if self.data.speeds is not None else 0.0)

    def _identify(self, theta: np.ndarray, jacobian: np.ndarray, weighted: np.ndarray) -> Identifiability:
        """The parameters and combinations that the data determines about θ, from the Jacobian and prediction there."""
        exponent = np.where(self.problem.logarithmic | (theta == 0), 1.0, theta)
        return identify(self.names, jacobian, exponent, float(np.linalg.norm(weighted)))

    @functools.cached_property
    def _rank_at_first(self) -> int:
        """Number of determined combinations of parameters at the first guess; 0 where impacts fail there."""
        start = self.squares.start
        residuals, jacobian = self.squares.residuals(start)
        if not np.all(np.isfinite(jacobian)):
            return 0
        return self._identify(start, jacobian, residuals + self.squares.data.over_errors(self.data.erosion)).rank

    def ends(self, level: float) -> list[tuple[float, float]]:
        """The intervals as distances of θ from the estimates."""
        rise = self.rise(level)
        if level not in self._offsets:
            self._offsets[level] = [self._crossings(at, rise) for at in range(len(self.names))]
        return self._offsets[level]

    def allowed(self, at: int) -> np.ndarray:
        """The best fits with one parameter at either end of its interval, as θ; shape (2, names)."""
        ends = [self._ridge(at).refit(end, self.solution.theta, self.rise() * self.variance / 2)
                for end in self.ends(LEVEL)[at]]  # fmt: skip
        return np.array([self.solution.theta if refit is None else refit.theta for refit in ends])

    @functools.cached_property
    def _offsets(self) -> dict[float, list[tuple[float, float]]]:
        """The results of `ends` so far, by level."""
        return {}

    def _crossings(self, at: int, rise: float) -> tuple[float, float]:
        """The offsets of one parameter, below and above, at which χ² has risen by `rise`."""
        width, height = float(np.sqrt(rise * self.covariance_of_theta[at, at])), rise * self.variance / 2
        if width in (0.0, np.inf):
            return -width, width
        ridge = self._ridge(at)
        return ridge.crossing(-width, height), ridge.crossing(width, height)

    def _ridge(self, at: int) -> Ridge:
        """The best fits along one parameter."""
        modes = self.identifiability.modes
        together = modes @ modes[at]
        straight = np.eye(len(self.names))[at]
        path = straight if self.names[at] in self.undetermined else together / together[at]
        return Ridge(self.squares, self.solution, at, path)


def _known(value: Value) -> list[Value]:
    """A value, which tables show as a dash where it is infinite."""
    if np.isfinite(value.value):
        return [value]
    return [value.but(value="–", only="table"), value.but(only="data")]


_GREATEST = 1e100  # m³ or m³/kg


def calibrate(problem: FitProblem, *, loss: str = "linear", starts: int = 32, level: float = LEVEL) -> Calibration:
    """Fit parameters of a model to measured erosion, by least squares.

    By default a parameter lies within a factor of 100 about the first guess, a spin within ±2 v₀/r about it, an own
    parameter that starts at zero or below it within ±2 times its size (of zero: 1), but not below its least value, and
    an own speed with a least value goes up to the data's greatest normal speed. The first guess is the case, but ψ, σ
    or the cutting fraction, the first of these that is free, is guessed from the size of the data; and an own stress is
    σψ at first, if that fits better.

    Args:
        problem: the model, the case, the tests, and what is free.
        loss: "linear" for least squares; "soft_l1" where some rows may be far off (`scipy.optimize.least_squares`).
        starts: number of points to begin from. V(α) of a turning body jumps, so the misfit
            has several valleys. The best fits with one parameter at its least value are further starts.
        level: of the intervals in tables and documents.

    Returns:
        Estimates, their errors, and findings on parameters that the data does not determine.

    Raises:
        ValueError: for arguments or data that cannot be used.
        CalibrationError: where the model's impacts fail.
    """
    if loss not in LOSSES:
        raise ValueError(f"Argument `loss` must be one of {', '.join(LOSSES)}, but is {briefly(loss)}.")
    starts, data, free_count = check_whole("starts", starts, 1), problem.data, len(problem.names)
    if data.speeds is not None and loss != "linear":  # what its speed shares would spread a far row over the others
        raise ValueError(f"Argument `loss` must be linear beside an error of each speed, but is {loss}.")
    speeds = int(data.speeds.max()) + 1 if data.speeds is not None and data.uncertainty is None else 0
    if len(data) <= free_count + speeds:
        parameters = f"{free_count} free parameter" + ("s" if free_count > 1 else "")
        parameters += f" and {speeds} errors of speeds" if speeds else ""
        least = f"at least {free_count + speeds + 1} rows for {parameters}, as no degree of freedom is left otherwise"
        raise ValueError(f"Argument `data` must have {least}, but has {len(data)}.")
    greatest = float(np.max(np.abs(data.erosion)))
    if not 1 / _GREATEST <= greatest <= _GREATEST:  # squares are summed
        raise ValueError(f"Argument `data` must have erosion that a metal can have, but has {greatest:g} (SI) at most.")
    return Calibration(*fit(make_squares(problem), loss, starts), check_share("level", level))
