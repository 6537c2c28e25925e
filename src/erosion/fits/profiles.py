"""The misfit along one parameter with all others fitted again, and where it has risen by the quantile of a level.

A profile's interval reaches from the estimate to where the profile has risen by the quantile of its
level. Where residuals are linear in θ the profile is a parabola, and the interval is the usual
interval from standard errors. Where V(α) jumps between two rows the profile has steps, which the
slopes at the estimate do not show.
"""

import dataclasses

import numpy as np

from erosion.fits.least_squares import FitSolution, LeastSquares, settle
from erosion.parameters.quantities import Quantity
from erosion.results import Columns, Declared, Result, System, Value

_TRIALS = 24  # a step of the profile takes 8 of them, by halving
_WIDER = 2.0  # factor per trial at most, while the end is not passed
_CLOSE = 0.02  # of an interval's half width, and of the rise that is looked for


@dataclasses.dataclass(frozen=True, repr=False)
class Profile(Result):
    """The misfit over one parameter, with all others fitted again.

    Args:
        name: of the parameter.
        values: ascending, shape (points,).
        rise: Δχ² above the best fit, shape (points,); a quadratic where the fit is linear.
        quantity: the parameter.
        shown_in: the unit system that shows it.
    """

    lines = ("points",)

    name: str
    values: np.ndarray
    rise: np.ndarray
    quantity: Quantity
    shown_in: System = "si"

    @property
    def title(self) -> str:
        """The parameter."""
        return f"profile of {self.name}"

    def declare(self) -> list[Declared]:
        """The parameter, with value and rise at each point."""
        values = self.quantity.declare("value", self.values, symbol=self.name, meaning="")
        rises = Value("rise", self.rise, "Δχ²", digits=4)
        return [Value("parameter", self.name, only="data"), Columns("points", self.title, [values, rises])]


@dataclasses.dataclass(frozen=True)
class Ridge:
    """The best fits along one parameter, whose θ is held at offsets from the estimate.

    Args:
        squares, solution: the fit.
        at: index of the parameter.
        path: change of θ per unit of offset where residuals are linear, shape (names,).
    """

    squares: LeastSquares
    solution: FitSolution
    at: int
    path: np.ndarray

    def rises(self, offsets: np.ndarray, unit: float) -> np.ndarray:
        """The cost above the minimum at each offset.

        Args:
            offsets: ascending, shape (points,).
            unit: a typical rise of the cost; rises are computed to some percents of it.

        Returns:
            Shape (points,); NaN where the model fails.
        """
        rises = np.zeros(len(offsets))
        for side in (np.flatnonzero(offsets > 0), np.flatnonzero(offsets < 0)[::-1]):
            near = self.solution.theta
            for i in side:
                refit = self.refit(offsets[i], near, unit)
                near = near if refit is None else refit.theta
                rises[i] = np.nan if refit is None else refit.cost - self.solution.cost
        return rises

    def crossing(self, first: float, height: float) -> float:
        """The offset at which the cost has risen by `height`, to 2 %.

        At a step it is the far side of the step. Where the cost does not rise so far within the
        bounds, it is the bound; NaN where the model fails on the way.

        Args:
            first: the offset at which a parabola has risen by `height`; its sign gives the side.
            height: positive.
        """
        sign = np.sign(first)
        bound = self.squares.upper[self.at] if sign > 0 else self.squares.lower[self.at]
        limit = abs(bound - self.solution.theta[self.at])
        inside, outside, near = 0.0, np.inf, self.solution.theta
        trial = min(abs(first), limit)
        for _ in range(_TRIALS):
            refit = self.refit(sign * trial, near, height)
            if refit is None:
                return np.nan
            ratio = np.sqrt(max(refit.cost - self.solution.cost, 0.0) / height)  # linear where the rise is a parabola
            if abs(ratio - 1) < _CLOSE or (ratio < 1 and trial == limit):
                return sign * trial
            if ratio < 1:
                inside, near = trial, refit.theta
            else:
                outside = trial
            if outside - inside < _CLOSE * outside:
                break
            linear = trial / ratio if ratio > 0 else np.inf
            margin = 0.1 * (outside - inside)
            if outside == np.inf:
                trial = min(linear, _WIDER * trial, limit)
            elif inside + margin < linear < outside - margin:
                trial = linear
            else:
                trial = (inside + outside) / 2
        return sign * (outside if outside < np.inf else trial)

    def refit(self, offset: float, near: np.ndarray, height: float) -> FitSolution | None:
        """The best fit at an offset, from the better of two points: on the straight path, or near the last fit."""
        squares, at = self.squares, self.at
        place = self.solution.theta[at] + offset
        begins = np.array([self.solution.theta + offset * self.path, near + (place - near[at]) * self.path])
        begins = np.clip(begins, squares.lower, squares.upper)
        begin = begins[int(np.argmin(squares.thinned().costs(begins)))]
        return settle(squares, begin, at, _CLOSE * min(1.0, height / max(self.solution.cost, height)))
