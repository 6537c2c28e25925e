"""Least squares with exact Jacobians from many starts, and which parameters the data can tell apart.

Parameters that enter only as a product leave the prediction unchanged along a direction of
their logarithms. The singular vectors of the Jacobian with vanishing singular values show
these directions; the other singular vectors are the combinations that are determined.

V(α) of a turning body jumps, and the misfit jumps with it: a descent from one start may end in
the wrong valley. So the misfit is computed at many starts, and descents begin at the best.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy import optimize
from scipy.linalg import null_space
from scipy.sparse.csgraph import connected_components
from scipy.stats import qmc

from erosion.fits.measurements import Measurements
from erosion.fits.problem import FRACTION, SCALE, FitProblem
from erosion.results import Finding

# The engine's derivatives hold nine digits, so a direction without influence has 1e-9 or less.
_NOTHING = 1e-7  # of the prediction: influence of a parameter
_NULL = 1e-6  # of the largest singular value
_INVOLVED = 1e-4  # component of a parameter in a direction


class Group(NamedTuple):
    """Parameters that the data leaves open together.

    Args:
        names: of these parameters.
        determined: the products of powers of them that are determined: ("m/b^(1/2)",).
        direction: a change of θ that leaves the prediction as it is, shape (n,).
    """

    names: tuple[str, ...]
    determined: tuple[str, ...]
    direction: np.ndarray

    @property
    def finding(self) -> Finding:
        """The finding on undetermined parameters."""
        about = ", ".join(self.names)
        if len(self.names) == 1:
            return Finding("parameter_has_no_influence", about)
        numbers = {"parameters": self.names, "determined": self.determined}
        return Finding("parameters_are_tied" if self.determined else "parameters_are_tied_completely", about, numbers)


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """The parameters and combinations that the data determines.

    Args:
        covariance: of θ, for residuals of variance 1; infinite on the diagonal for parameters
            that are not determined, and NaN beside it; shape (n, n).
        modes: directions of θ that are determined, each as long as one standard deviation
            for residuals of variance 1; shape (n, rank).
        undetermined: the names of the parameters that are not determined.
        groups: of undetermined parameters.
    """

    covariance: np.ndarray
    modes: np.ndarray
    undetermined: tuple[str, ...]
    groups: tuple[Group, ...]

    @property
    def rank(self) -> int:
        """How many combinations of the parameters are determined."""
        return self.modes.shape[1]


def identify(names: Sequence[str], jacobian: np.ndarray, exponent: np.ndarray, size: float) -> Identifiability:
    """Find the combinations of parameters that the residuals depend on.

    Args:
        names: of the parameters.
        jacobian: of the weighted residuals with respect to θ, shape (rows, n), rows ≥ n.
        exponent: dθ/d(log q), 1 for θ = log q; shape (n,). Combinations are products of powers.
        size: norm of the weighted prediction, with which influences are compared.
    """
    n = len(names)
    norms = np.linalg.norm(jacobian, axis=0)
    active = norms > _NOTHING * size
    groups = [
        Group((name,), (), direction)
        for name, counts, direction in zip(names, active, np.eye(n), strict=True)
        if not counts
    ]
    undetermined = ~active
    modes = np.zeros((n, 0))
    if active.any():
        index, scaled = np.flatnonzero(active), jacobian[:, active] / norms[active]
        _, strength, across = np.linalg.svd(scaled, full_matrices=False)
        determined = strength > _NULL * strength[0]
        modes = np.zeros((n, int(determined.sum())))
        modes[index] = across[determined].T / norms[active][:, None] / strength[determined]
        if not determined.all():
            null = across[~determined].T
            involved = np.abs(null).max(axis=1) > _INVOLVED
            undetermined[index[involved]] = True
            thetas = np.zeros((n, null.shape[1]))
            thetas[index] = null / norms[active][:, None]
            groups += _ties(names, index[involved], thetas, exponent)
    covariance = modes @ modes.T
    covariance[undetermined, :] = covariance[:, undetermined] = np.nan
    covariance[undetermined, undetermined] = np.inf
    return Identifiability(covariance, modes, tuple(itertools.compress(names, undetermined)), tuple(groups))


def _ties(all_names: Sequence[str], involved: np.ndarray, thetas: np.ndarray, exponent: np.ndarray) -> list[Group]:
    """The groups of parameters that null directions of θ, shape (n, directions), tie together."""
    names, null = [all_names[int(i)] for i in involved], thetas[involved] / exponent[involved][:, None]
    determined = _reduced(null_space(null.T).T) if null.shape[1] < len(names) else np.zeros((0, len(names)))  # pyrefly: ignore
    has = np.abs(np.concatenate([_reduced(null.T), determined])) > _INVOLVED
    together, groups = connected_components(has.T.astype(int) @ has)[1], []
    for label in dict.fromkeys(together.tolist()):
        members = np.flatnonzero(together == label)
        products = [_product(names, row) for row in determined if (np.abs(row[members]) > _INVOLVED).any()]
        of_group = [names[i] for i in members]
        direction = np.zeros(len(all_names))
        # A null direction of the members alone, which no direction ties to others.
        strongest = np.linalg.svd(null[members], full_matrices=False)[0][:, 0]
        direction[involved[members]] = strongest * exponent[involved[members]]
        groups.append(Group(tuple(of_group), tuple(products), direction))
    return groups


def _reduced(rows: np.ndarray) -> np.ndarray:
    """The reduced row echelon form, whose rows are sparse combinations; of the same shape."""
    rows, at = rows.copy(), 0
    for column in range(rows.shape[1]):
        if at == len(rows):
            break
        pivot = at + int(np.argmax(np.abs(rows[at:, column])))
        if abs(rows[pivot, column]) < _INVOLVED * np.abs(rows).max():
            continue
        rows[[at, pivot]] = rows[[pivot, at]]
        rows[at] /= rows[at, column]
        others = np.arange(len(rows)) != at
        rows[others] -= np.outer(rows[others, column], rows[at])
        at += 1
    return rows


def _product(names: Sequence[str], exponents: np.ndarray) -> str:
    """Powers as text: "sigma·psi", "m/(sigma·psi)"."""
    powers = [(name, float(e)) for name, e in zip(names, exponents, strict=True) if abs(e) > _INVOLVED]
    above, below = ([_power(name, abs(e)) for name, e in powers if e * sign > 0] for sign in (1, -1))
    under = "·".join(below)
    return ("·".join(above) or "1") + (f"/({under})" if len(below) > 1 else f"/{under}" if below else "")


def _power(name: str, exponent: float) -> str:
    simple = Fraction(exponent).limit_denominator(6)
    if abs(exponent - simple) < 1e-3:
        return name if simple == 1 else f"{name}^{simple}" if simple.denominator == 1 else f"{name}^({simple})"
    return f"{name}^{exponent:.3g}"


Loss = Literal["linear", "soft_l1"]
LOSSES: tuple[Loss, ...] = get_args(Loss)

_FOLLOWED = 5  # descents
THINNED = 500  # rows are enough to choose among valleys
_WIDTH = {True: np.log(100.0), False: 2.0}  # of the default bounds, by `logarithmic`: a factor of 100, a spin of 2 v₀/r
_INSIDE = 0.1  # of the range, from a bound
_SIZES = {SCALE: 1, "psi": -1, "sigma": -1, FRACTION: 1}  # powers of the erosion's size; V grows as 1/(σψ)
_SIZED = 4  # steps to the size of the data: with rotation, ψ and σ change the shape of V(α) too
_NEAR = {True: np.log(5.0), False: 0.5}  # of the starts about the case, by `logarithmic`
_HOPS = 10  # rounds of points about the best minimum
_DRAWN, _DRAWN_HELD = 96, 24  # points of a round: about a start, which may be far off; about a profile's last point
_SEARCHED = 400_000  # rows of all points of a round
_REACH = 0.1, 6.0  # of these points, in standard errors
_EXACT = 1e-12  # of the cost
_ROUGH = 0.02  # of one row's share in the cost: enough to choose among valleys
_RHO: Mapping[Loss, Callable[[np.ndarray], np.ndarray]] = {
    "linear": lambda z: z,
    "soft_l1": lambda z: 2 * (np.sqrt(1 + z) - 1),
}  # of scipy.optimize.least_squares
_WEIGHTS: Mapping[Loss, Callable[[np.ndarray], np.ndarray]] = {
    "linear": np.ones_like,
    "soft_l1": lambda z: 1 / np.sqrt(1 + z),
}  # their derivatives
_NOISES, _SAME_NOISE = 10, 0.01  # rounds of a robust fit and its noise; the relative change that ends them
_REWEIGHTED, _SAME_ERRORS = 10, 1e-3  # rounds of a fit and its relative errors; the relative change that ends them
FINEST = 1e-4  # scatter over the typical erosion: the digits of a balance
_MAD = 1.4826  # median absolute deviation to standard deviation of a normal distribution


class CalibrationError(RuntimeError):
    """A fit that could not be made."""


@dataclasses.dataclass(frozen=True)
class LeastSquares:
    """Weighted residuals of a model against data, as a function of θ.

    Args:
        problem: what is fitted.
        data: its rows, or some of them; with errors of their own where these follow from the fit.
        lower, upper: bounds of θ, shape (names,).
        start: θ of the first guess, of the data's size, shape (names,).
        loss: scipy's robust loss, "linear" for plain least squares.
        noise: residuals beyond so many standard deviations count less in a robust loss.
    """

    problem: FitProblem
    data: Measurements
    lower: np.ndarray
    upper: np.ndarray
    start: np.ndarray
    loss: Loss = "linear"
    noise: float = 1.0

    def residuals(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Prediction less measurement over the rows' errors, shape (rows,), and its Jacobian, shape (rows, names)."""
        predicted, rates = self.problem.predict(theta, self.data.conditions)
        return self.data.over_errors(predicted - self.data.erosion), self.data.over_errors(rates.T).T

    def cost(self, residuals: np.ndarray) -> np.ndarray:
        """Half the sum of squares (of the robust loss) over the last axis; infinite for NaN."""
        with np.errstate(over="ignore"):
            costs = 0.5 * self.noise**2 * np.sum(_RHO[self.loss]((residuals / self.noise) ** 2), axis=-1)
        return np.where(np.isfinite(costs), costs, np.inf)

    def weights(self, residuals: np.ndarray) -> np.ndarray:
        """How much each row counts beside others, by the slope of the robust loss; 1 for least squares."""
        return _WEIGHTS[self.loss]((residuals / self.noise) ** 2)

    def costs(self, thetas: np.ndarray) -> np.ndarray:
        """The cost at several θ, shape (points, names) -> (points,); infinite where impacts fail."""
        predicted = self.problem.predict_many(thetas, self.data.conditions)
        return self.cost(self.data.over_errors(predicted - self.data.erosion))

    def thinned(self) -> "LeastSquares":
        """The same with at most as many rows as are needed to choose among valleys."""
        data = self.data.thinned(THINNED)
        return self if data is self.data else dataclasses.replace(self, data=data)


@dataclasses.dataclass(frozen=True)
class FitSolution:
    """A minimum.

    Args:
        theta: the place of the minimum, shape (names,).
        cost: half the sum of squares (of the robust loss), with residuals over `deviation`.
        jacobian: of the residuals, weighted by the robust loss, shape (rows, names); 0 for a
            parameter that was held.
    """

    theta: np.ndarray
    cost: float
    jacobian: np.ndarray


def make_squares(problem: FitProblem) -> LeastSquares:
    """The residuals of all rows, with the first guess and the bounds, as θ."""
    lower, upper = problem.limits.T
    for i, name in enumerate(problem.names):
        if name in problem.bounds:
            lower[i], upper[i] = (problem.to_theta(name, value) for value in problem.bounds[name])
    unbounded = LeastSquares(problem, problem.data, lower, upper, np.clip(problem.start, lower, upper))
    start = _first_guess(unbounded.thinned())
    width = default_width(problem)
    width[len(problem.free) :] = np.inf  # the scale has no bounds
    lower = np.where(lower == -np.inf, start - width, lower)
    upper = np.where(upper == np.inf, start + width, upper)
    # A threshold of zero is at the end of its range: the fit begins inside.
    at_least = ~problem.logarithmic & (start <= lower)
    start[at_least] = (1 - _INSIDE) * lower[at_least] + _INSIDE * upper[at_least]
    return dataclasses.replace(unbounded, lower=lower, upper=upper, start=start)


def default_width(problem: FitProblem) -> np.ndarray:
    """How far from a first guess each θ is looked for, shape (names,), where nothing else limits it."""
    return np.array([_WIDTH[bool(logarithmic)] for logarithmic in problem.logarithmic])


def _first_guess(squares: LeastSquares) -> np.ndarray:
    """θ of the case, of the data's size; or with the model's stresses at σψ, where the data are nearer to that."""
    of_case, stresses = _of_data_size(squares, squares.start[None])[0], squares.problem.own_stresses
    if not stresses.any():
        return of_case
    similar = squares.start.copy()
    similar[stresses] = np.log(squares.problem.contact_stress)
    similar = _of_data_size(squares, np.clip(similar, squares.lower, squares.upper)[None], together=stresses)[0]
    guesses = np.stack([of_case, np.clip(similar, squares.lower, squares.upper)])
    return guesses[np.argmin(squares.costs(guesses))]


def fit(squares: LeastSquares, loss: Loss, starts: int) -> tuple[LeastSquares, FitSolution]:
    """The squares with the robust loss and its noise, and the deepest minimum.

    Raises:
        CalibrationError: if the model fails for all starts.
    """
    few = squares.thinned()
    rough = _ROUGH / len(few.data)
    begins = [*_starts(few, starts), *_at_least_values(few, rough)]
    solutions = [solution for theta in begins if (solution := descend(few, theta, ftol=rough)) is not None]
    if not solutions:
        raise CalibrationError("The model could not be fitted: its impacts failed for every start.")
    # Valleys whose depths differ by rounding are the same; the first start is the first guess.
    least = min(solution.cost for solution in solutions)
    best = next(solution for solution in solutions if solution.cost <= least * (1 + rough) + 1e-20)
    squares = dataclasses.replace(squares, loss=loss)
    if loss == "linear" or squares.data.uncertainty is not None:
        return _reweighted(*with_noise(squares, best.theta, squares.noise))
    # What plain least squares finds, far rows may have moved to another valley, or to where most residuals are great.
    begins = [*begins, *(solution.theta for solution in solutions)]
    few = dataclasses.replace(few, loss=loss, noise=float(np.nanmin([_noise(few, theta) for theta in begins])))
    robust = [solution for theta in begins if (solution := descend(few, theta, ftol=rough)) is not None]
    best = min(robust, key=lambda solution: solution.cost)
    squares, whole = with_noise(squares, best.theta, _noise(squares, best.theta))
    for _ in range(_NOISES):
        noise = _noise(squares, whole.theta)
        if abs(noise - squares.noise) < _SAME_NOISE * squares.noise:
            break
        squares, whole = with_noise(squares, whole.theta, noise)
    return squares, whole


def with_noise(squares: LeastSquares, theta: np.ndarray, noise: float) -> tuple[LeastSquares, FitSolution]:
    """The squares with another noise of their robust loss, and the deepest minimum about θ."""
    squares = dataclasses.replace(squares, noise=noise)
    solution = settle(squares, theta)
    if solution is None:
        raise CalibrationError("The model could not be fitted: impacts failed at the best start.")
    return squares, solution


def _reweighted(squares: LeastSquares, solution: FitSolution) -> tuple[LeastSquares, FitSolution]:
    """The fit whose relative errors are of its own erosion, by fits with the errors of the one before."""
    has_shares, names = squares.data.parts is not None or squares.data.share_of_speeds, squares.problem.names
    for _ in range(_REWEIGHTED if has_shares else 0):
        before, scatter = squares.data, None
        fitted = squares.problem.predict(solution.theta, before.conditions)[0]
        if before.uncertainty is None:
            size = float(np.linalg.norm(before.over_errors(fitted)))
            rank = identify(names, solution.jacobian, np.ones(len(names)), size).rank
            own = np.sqrt(2 * solution.cost / (len(before) - rank))
            scatter = max(own, FINEST) * float(before.deviation[0])
        data = before.weighed(fitted, scatter)
        if all(np.allclose(now, 0.0 if then is None else then, rtol=_SAME_ERRORS, atol=0.0)
               for now, then in ((data.deviation, before.deviation), (data.common, before.common))
               if now is not None):  # fmt: skip
            break
        squares, solution = with_noise(dataclasses.replace(squares, data=data), solution.theta, squares.noise)
    return squares, solution


def _noise(squares: LeastSquares, theta: np.ndarray) -> float:
    """The standard deviation of most residuals; the least of them may be zero, as many as there are parameters."""
    residuals = np.sort(np.abs(squares.residuals(theta)[0]))
    free = min(len(theta), len(residuals) - 1)
    return max(_MAD * float(np.median(residuals[free:])), 1e-12)


def settle(
    squares: LeastSquares, theta: np.ndarray, held: int | None = None, ftol: float = _EXACT
) -> FitSolution | None:
    """The deepest of the valleys about θ; arguments as for `descend`.

    When a parameter moves, a jump of V(α) passes rows one after the other, and the misfit steps
    at each: valleys are as narrow as the rows are close. So points are drawn about the minimum,
    nearer than its errors and farther. A point below the minimum lies in a deeper valley. For
    very many rows this takes too long; there the search uses some of the rows.
    """
    few, rough = squares.thinned(), max(ftol, _ROUGH / len(squares.data))
    if held is None and few is not squares:
        of_few = settle(few, theta, ftol=rough)
        theta = theta if of_few is None else of_few.theta
    best = descend(squares, theta, held, rough)
    if best is None:
        return None
    rng = np.random.default_rng(0)
    drawn = min(_DRAWN if held is None else _DRAWN_HELD, _SEARCHED // len(squares.data))
    reach = np.geomspace(*_REACH, drawn)[:, None]
    names, size = squares.problem.names, float(np.linalg.norm(squares.data.over_errors(squares.data.erosion)))
    for _ in range(_HOPS if drawn else 0):
        modes = identify(names, best.jacobian, np.ones(len(names)), size).modes
        spread = np.sqrt(2 * best.cost / max(len(squares.data) - modes.shape[1], 1))
        draws = best.theta + spread * reach * rng.standard_normal((drawn, modes.shape[1])) @ modes.T
        draws = np.clip(draws, squares.lower, squares.upper)
        costs = squares.costs(draws)
        lowest = int(np.argmin(costs))
        if costs[lowest] >= best.cost:
            break
        deeper = descend(squares, draws[lowest], held, rough)
        best = best if deeper is None else deeper
    return best if rough == ftol else descend(squares, best.theta, held, ftol)


def descend(
    squares: LeastSquares, theta: np.ndarray, held: int | None = None, ftol: float = _EXACT
) -> FitSolution | None:
    """The minimum down from θ.

    Args:
        squares: the residuals.
        theta: shape (names,).
        held: index of a parameter that keeps its value.
        ftol: relative tolerance of the cost.

    Returns:
        None where impacts fail.
    """
    moving = np.arange(len(theta)) != held

    @functools.lru_cache(maxsize=1)  # scipy asks for residuals and Jacobian of the same point in two calls
    def evaluate(part: bytes) -> tuple[np.ndarray, np.ndarray]:
        whole = theta.copy()
        whole[moving] = np.frombuffer(part)
        return squares.residuals(whole)

    part = theta[moving]
    residuals, jacobian = evaluate(part.tobytes())
    if not (np.all(np.isfinite(residuals)) and np.all(np.isfinite(jacobian))):
        return None
    if not moving.any():
        return FitSolution(theta, float(squares.cost(residuals)), np.zeros_like(jacobian))
    # At a jump of the misfit the steps shrink; they end at a length that would change the cost too little on a slope.
    steepness = float(np.linalg.norm(jacobian[:, moving])) or np.inf
    length = 0.1 * np.sqrt(ftol * float(squares.cost(residuals))) / steepness
    with np.errstate(over="ignore"):
        result = optimize.least_squares(
            lambda part: evaluate(part.tobytes())[0],
            part,
            jac=lambda part: evaluate(part.tobytes())[1][:, moving],  # pyrefly: ignore
            bounds=(squares.lower[moving], squares.upper[moving]),
            loss=squares.loss,
            f_scale=squares.noise,
            xtol=max(_EXACT, length / max(float(np.linalg.norm(part)), 1.0)),
            ftol=ftol,
            gtol=1e-12,
            max_nfev=200,
        )
    theta, jacobian = theta.copy(), np.zeros_like(jacobian)
    # scipy's steps never reach a bound: no threshold is 0, and not 1e-33.
    at_least = result.x - squares.lower[moving] < _EXACT
    theta[moving], jacobian[:, moving] = np.where(at_least, squares.lower[moving], result.x), result.jac
    return FitSolution(theta, float(result.cost), jacobian)


def _starts(squares: LeastSquares, count: int) -> np.ndarray:
    """The first guess, and the best of `count` points about it, shape (points, names)."""
    problem, start = squares.problem, squares.start
    free = len(problem.free)
    near = np.array([_NEAR[bool(logarithmic)] for logarithmic in problem.logarithmic[:free]])
    low, high = (
        np.maximum(start[:free] - near, squares.lower[:free]),
        np.minimum(start[:free] + near, squares.upper[:free]),
    )
    spread = low + (high - low) * qmc.LatinHypercube(free, rng=0).random(max(count - 1, 0))
    begins = np.tile(start, (count, 1))
    begins[1:, :free] = spread
    begins = _of_data_size(squares, begins)
    costs = squares.costs(begins)
    ranked = [i for i in np.argsort(costs[1:]) + 1 if np.isfinite(costs[i])]
    return begins[[0, *ranked[: _FOLLOWED - 1]]]


def _at_least_values(squares: LeastSquares, ftol: float) -> list[np.ndarray]:
    """θ of the fits that hold one parameter at its least value: no threshold.

    There the misfit often has a valley of its own, whose floor is the bound. Points inside of the range miss it.
    """
    thetas = []
    for i in np.flatnonzero(np.isfinite(squares.problem.limits[:, 0])):
        theta = np.where(np.arange(len(squares.start)) == i, squares.lower, squares.start)
        held = descend(squares, _of_data_size(squares, theta[None])[0], int(i), ftol)
        thetas += [] if held is None else [held.theta]
    return thetas


def _of_data_size(squares: LeastSquares, thetas: np.ndarray, together: np.ndarray | None = None) -> np.ndarray:
    """Several θ, shape (points, names), each with erosion of the data's size if a parameter that sets it is free.

    Args:
        squares: the residuals.
        thetas: shape (points, names).
        together: which stresses keep their ratio to σψ, shape (names,); none by default.
    """
    names = squares.problem.names
    name = next((name for name in _SIZES if name in names), None)
    if name is None:
        return thetas
    thetas, at = thetas.copy(), names.index(name)
    for _ in range(_SIZED):
        predicted = squares.problem.predict_many(thetas, squares.data.conditions)
        weight = predicted / squares.data.deviation**2
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = np.log((weight @ squares.data.erosion) / np.sum(weight * predicted, axis=1)) / _SIZES[name]
        moved = np.clip(thetas[:, at] + np.where(np.isfinite(step), step, 0.0), squares.lower[at], squares.upper[at])
        if np.array_equal(moved, thetas[:, at]):
            break
        if together is not None and _SIZES[name] < 0:
            thetas[:, together] += (moved - thetas[:, at])[:, None]
        thetas[:, at] = moved
    return thetas
