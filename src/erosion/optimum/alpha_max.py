"""The angle of greatest removal, certified.

With rotation V(α) is discontinuous, has several maxima, and the greatest may sit at a jump
(`docs/optimum.md`): Newton's method on dV/dα alone gives wrong answers. Here V is resolved
over all angles first (`scan`), and the answer is the best of every maximum, of both sides of
every jump and of both ends of the range.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from erosion.engine.batch import threads
from erosion.engine.impact import impact, lanes_of, pair_derivatives
from erosion.models import load_model, model_name
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import own_parameters, quantities, sizes, values, with_values
from erosion.optimum.maxima import ASIDE as ASIDE
from erosion.optimum.maxima import SHALLOWEST as SHALLOWEST
from erosion.optimum.maxima import STEEPEST, TIGHT, Maxima, Search
from erosion.optimum.objectives import MEASURES, OBJECTIVES, Objective
from erosion.parameters.parameters import Parameters, require_parameters, validate
from erosion.parameters.quantities import result_row
from erosion.tables import Row, format_number, to_html, to_text

_TOGETHER = 1000  # cases resolved at once: some 100 MB


@dataclasses.dataclass(frozen=True)
class Optimum:
    """Where an objective is greatest (or least) over the angle of attack.

    For parameters that are arrays every field but `model`, `p`, `objective` and `least` is
    an array of their broadcast shape (that of `alpha` excepted, which is not used).

    Args:
        model: whose.
        p: the parameters, `alpha` being the answer.
        objective: its name.
        least: whether the least is meant.
        alpha: the angle [rad]; 1e-9 beside a jump; 0 for the limit as α → 0, NaN where nothing is
            cut at any angle.
        value: the objective there.
        volume: V there [volume].
        kind: "interior" (dV/dα = 0), "jump" (one side of a discontinuity; see `side` and
            `attained`), "boundary" (the limit as α → 0, or an end of the range), "kink" (the
            slope jumps through zero), "plateau" (one of many angles with the same value), or
            "none": nothing is ever cut, or, where `ended_by` is "failed", nothing could be computed.
        ended_by: how the cut ends there.
        side: of a jump, "below" or "above" it; else "".
        attained: whether `value` is reached, or only approached.
        dvolume, d2volume: derivatives of the objective by the angle there [per rad, per rad²].
        candidates: everything that was compared, best first: a tuple of `Candidate`.
        jumps: all discontinuities, a tuple of `Jump` by angle.
        regimes: how the cut ends over the whole range, a tuple of `Regime`.
        iterations: rounds of refinement, and Newton steps of the answer.
        certified: False where an impact failed, so that something may have been missed.
        integrand: the model whose "volume" is the objective; `model` itself for the volume.
    """

    model: CuttingModel
    p: Parameters
    objective: str
    least: bool
    alpha: Any
    value: Any
    volume: Any
    kind: Any
    ended_by: Any
    side: Any
    attained: Any
    dvolume: Any
    d2volume: Any
    candidates: Any
    jumps: Any
    regimes: Any
    iterations: Any
    certified: Any
    integrand: CuttingModel = dataclasses.field(repr=False)

    @functools.cached_property
    def sensitivities(self) -> Mapping[str, Any]:
        """dα_max/dq for every parameter q but α, the model's own too [rad per unit of q]; computed when first read.

        Interior: -V_αq/V_αα, by the implicit function theorem. Jump: -t_q/t_α where the end
        time t of the side that grazes is tangent. Boundary: 0. What cannot be told from zero
        in the arithmetic (1e-11 rad for a change of q by its own size) is given as 0.
        """
        names = [name for name in quantities(self.integrand) if name != "alpha"]
        rates = _sensitivities(self, names)
        return dict(zip(names, rates, strict=True))

    def rows(self) -> list[Row]:
        """The answer as rows of a table."""
        degrees = np.rad2deg(self.alpha)
        rows = [
            Row("alpha_max" if not self.least else "alpha_min", "α", format_number(degrees), "°", "angle of attack"),
            Row("kind", "", format_number(self.kind), "", "" if np.ndim(self.kind) else self._explained()),
            Row("ended_by", "", format_number(self.ended_by), "", "how the cut ends there"),
            result_row("volume", self.volume, self.p.units),
        ]
        if self.objective != "volume":
            rows.append(self._value_row())
        return rows

    def __str__(self) -> str:
        return to_text(self._title(), self.rows())

    def _repr_html_(self) -> str:
        return to_html(self._title(), self.rows())

    def _value_row(self) -> Row:
        if self.objective in MEASURES:
            return result_row(MEASURES[self.objective], self.value, self.p.units)
        return Row("value", "", format_number(self.value), "", self.objective)

    def _explained(self) -> str:
        """What the kind means here."""
        if self.kind == "jump":
            return f"just {self.side} a jump" + ("" if self.attained else ", not reached")
        if self.kind == "boundary":
            return "an end of the range" if self.attained else "approached as α → 0, not reached"
        return {"interior": "dV/dα = 0", "plateau": "the same over a range of angles"}.get(str(self.kind), "")

    def _title(self) -> str:
        what = "least" if self.least else "greatest"
        return f"{model_name(self.model)}: the angle of {what} {self.objective}"


def alpha_max(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha_range: tuple[float, float] | None = None,
    objective: str | Objective = "volume",
) -> Optimum:
    """The angle at which most is removed.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters whose leaves are scalars or arrays that broadcast; `alpha` is not used.
        alpha_range: ends of the range of angles [rad]; all of (0, π/2] without it.
        objective: "volume", "volume per mass", "t_c", "depth" (where the tip first stops
            going deeper), or a function that turns a model into one with another
            `removal_rate`, as those of `erosion.optimum.objectives` do.

    Returns:
        The certified optimum; see `Optimum`.

    Raises:
        ValueError: for parameters or a range out of bounds, or an unknown objective.

    References:
        Laverty asks for Newton's method on dV/dα; PHYSICS, section 7, says why that is not
        enough. For the linearized model α_max = ½ arctan k.
    """
    return _optimum(model, p, alpha_range, objective, least=False)


def alpha_min(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha_range: tuple[float, float] | None = None,
    objective: str | Objective = "volume",
) -> Optimum:
    """The angle at which least is removed; over all angles that is an end, so give a range.

    Arguments, result and errors are those of `alpha_max`.
    """
    return _optimum(model, p, alpha_range, objective, least=True)


def _optimum(
    model: CuttingModel | str | Path,
    p: Parameters,
    alpha_range: tuple[float, float] | None,
    objective: str | Objective,
    *,
    least: bool,
) -> Optimum:
    model = load_model(model)
    require_parameters(p)
    if isinstance(objective, str):
        if objective not in OBJECTIVES:
            raise ValueError(f"Argument `objective` must be one of {', '.join(OBJECTIVES)}, but is {objective!r}.")
        name, asked = objective, OBJECTIVES[objective](model)
    elif callable(objective):
        name, asked = getattr(objective, "__name__", "objective"), objective(model)
        if not isinstance(asked, CuttingModel):
            raise TypeError(f"Argument `objective` must turn a model into one, but makes {asked!r}.")
    else:
        raise TypeError(f"Argument `objective` must be a name or a function, but is {objective!r}.")
    low, high = (0.0, STEEPEST) if alpha_range is None else _checked_range(alpha_range)
    p = p.replace(alpha=STEEPEST)
    validate(p)
    layout, numbers, shape = lanes_of(asked, p)
    count = int(np.prod(shape, dtype=int))
    sign = -1.0 if least else 1.0

    def resolved(begin: int) -> list[Maxima]:
        each = layout.of_lanes(numbers, slice(begin, begin + _TOGETHER))
        return Search(layout, each, min(_TOGETHER, count - begin), sign).maxima(low, high)

    # While one thread integrates, Python's lock is another's, to see where to look next.
    with ThreadPoolExecutor(threads()) as pool:
        answers = list(itertools.chain.from_iterable(pool.map(resolved, range(0, count, _TOGETHER))))
    best = [answer.candidates[0] for answer in answers]
    fields = {
        "alpha": [c.alpha for c in best],
        "value": [c.value for c in best],
        "dvolume": [c.dvalue for c in best],
        "d2volume": [c.d2value for c in best],
        "kind": [c.kind for c in best],
        "ended_by": [c.ended_by for c in best],
        "side": [c.side for c in best],
        "attained": [c.attained for c in best],
        "iterations": [answer.rounds + answer.candidates[0].steps for answer in answers],
        "certified": [answer.certified for answer in answers],
    }
    columns = {key: np.array(column).reshape(shape)[()] for key, column in fields.items()}
    for key in ("candidates", "jumps", "regimes"):
        column = np.empty(count, object)
        column[:] = [getattr(answer, key) for answer in answers]
        columns[key] = column.reshape(shape)[()]
    volume = columns["value"]
    if asked is not model:
        volume, columns["ended_by"] = _volume_at(model, p, columns["alpha"], columns["ended_by"])
    p = p.replace(alpha=columns["alpha"])
    return Optimum(model=model, p=p, objective=name, least=least, volume=volume, integrand=asked, **columns)


def _checked_range(alpha_range: tuple[float, float]) -> tuple[float, float]:
    try:
        low, high = (float(end) for end in alpha_range)
    except (TypeError, ValueError):
        low = high = np.nan
    if not 0 <= low < high <= STEEPEST * (1 + 1e-12):
        raise ValueError(
            f"Argument `alpha_range` must be two ascending angles within [0, π/2] rad, but is {alpha_range!r}."
        )
    return low, min(high, STEEPEST)


def _volume_at(model: CuttingModel, p: Parameters, alpha: Any, ended_by: Any) -> tuple[Any, Any]:
    """V and the end at the optimum of another objective."""
    inside = np.asarray(alpha) > 0
    hits = impact(model, p.replace(alpha=np.where(inside, alpha, SHALLOWEST)), rtol=TIGHT)
    # As α → 0 the cut becomes infinitely shallow: what is removed there only the search says.
    return np.where(inside, hits.volume, np.nan)[()], np.where(inside, hits.ended_by, ended_by)[()]


def _sensitivities(optimum: Optimum, names: list[str]) -> np.ndarray:
    """dα/dq, shape (names, *shape of the optimum)."""
    p, model = optimum.p, optimum.integrand
    kind, alpha = np.atleast_1d(optimum.kind), np.atleast_1d(optimum.alpha)
    # A model's own parameters that all cases share stay the model's.
    own = own_parameters(model)
    each = {q: value for q, value in values(model, p).items() if q not in own or np.ndim(value)}
    flat = {q: np.broadcast_to(np.asarray(value), np.shape(optimum.kind)).reshape(-1) for q, value in each.items()}
    known = sizes(model, p)
    size = np.stack([np.broadcast_to(known[q], np.shape(optimum.kind)).reshape(-1) for q in names])
    rates = np.zeros((len(names), kind.size))
    rates[:, kind.ravel() == "none"] = np.nan

    def along_angle(which: np.ndarray, angles: np.ndarray) -> Any:
        some, there = with_values(model, p, {q: leaf[which] for q, leaf in flat.items()} | {"alpha": angles})
        return pair_derivatives(some, there, [("alpha", q) for q in ("alpha", *names)], rtol=TIGHT)

    interior = np.flatnonzero(kind.ravel() == "interior")
    if interior.size:
        second = along_angle(interior, alpha.ravel()[interior]).volume.second
        rates[:, interior] = (-second[:, 1:] / second[:, :1]).T
    jumps = np.flatnonzero(kind.ravel() == "jump")
    if jumps.size:
        rates[:, jumps] = _along_jump(along_angle, jumps, optimum)
    rates = np.where(np.abs(rates * size) < 1e-11, 0.0, rates)
    return rates.reshape(len(names), *np.shape(optimum.kind))


def _along_jump(along_angle: Any, which: np.ndarray, optimum: Optimum) -> np.ndarray:
    """dα/dq of jumps: -t_q/t_α on the side that grazes, where both grow as the tangent is neared.

    There g(t, α, q) = 0 with ġ → 0, so that the quotient tends to -g_q/g_α. It is a series in
    the root of the distance from the jump, whose first two terms three distances cancel.
    """
    side = np.atleast_1d(optimum.side).ravel()[which]
    attained = np.atleast_1d(optimum.attained).ravel()[which]
    beside = np.where(side == "below", -ASIDE, ASIDE)
    alpha = np.atleast_1d(optimum.alpha).ravel()[which] - beside
    # The side that grazes is the one whose cut ends earlier, which is the one attained.
    towards = np.where((side == "below") == attained, -1.0, 1.0)

    def quotient(distance: float) -> np.ndarray:
        time = along_angle(which, alpha + towards * distance).t_c
        return (-time.other[:, 1:] / time.first[:, :1]).T

    return (8 * quotient(1e-7) - 6 * quotient(4e-7) + quotient(16e-7)) / 3
