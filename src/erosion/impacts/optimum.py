"""The angle at which an objective (volume, volume per mass, time, depth) is greatest or least, with every rival.

An objective is a model with the motion of another model and another integrand. The engine
computes the integral and its derivatives as it computes any volume.

With rotation V(α) is discontinuous and has several maxima; the greatest may be at a jump
(`docs/optimum.md`). Newton's method on dV/dα alone gives wrong answers. So V is resolved over
all angles first (`resolve.py`). The answer is the best of every maximum, of both sides of
every jump and of both ends of the range.
"""

import contextlib
import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Broadcast, ModelState, PerImpact, as_pair
from erosion.impacts.batch import PairDerivatives, impact, lanes_of, pair_derivatives
from erosion.impacts.maxima import in_words, limit_at_zero, over_angles, shallowest
from erosion.impacts.turn import (
    BEYOND,
    TURNED,
    Turn,
    TurnLimited,
    check_max_turn,
    pushed_forward,
    turn_of,
    turned_beyond,
    turns,
)
from erosion.models import (
    CuttingModel,
    Events,
    SameMotion,
    impact_to_dict,
    load_model,
    model_name,
    own_parameters,
    quantities,
    sizes,
    values,
    with_values,
)
from erosion.ode.maxima import ASIDE as ASIDE, TIGHT, Maxima, searched
from erosion.ode.step_control import require_float64
from erosion.output import Record, briefly
from erosion.parameters import (
    QUANTITIES,
    RESULTS,
    STEEPEST,
    Derivative,
    Parameters,
    Quantity,
    System,
    declare_result,
    require_parameters,
    validate,
)
from erosion.results import Columns, Declare, Declared, Finding, Result, Value, found

_HAIR = 1e-8  # of the first speed into the depth


class VolumePerMass(SameMotion):
    """V/m, the volume per mass of particles [m³/kg]."""

    motion: CuttingModel

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.motion.removal_rate(state, p) / p.m

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.motion.removed_at_contact(p) / p.m


class EndTime(SameMotion):
    """t_c = ∫ dt [s]."""

    motion: CuttingModel

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return jnp.ones_like(self.tip(state, p).depth)


class Depth(SameMotion):
    """The depth at which the tip first stops going deeper, ∫ d(depth) [m]."""

    motion: CuttingModel

    def events(self, state: ModelState, p: Parameters) -> Events:
        scales = self.scales(p)
        # A hair later than it is, so that rounding does not choose where the cut ends at this instant anyway: the depth
        # changes by the square of it.
        vdepth = self.tip(state, p).vdepth + _HAIR * self.tip(self.initial_state(p), p).vdepth
        return {**self.motion.events(state, p), "deepest": vdepth * scales.time / scales.length}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.tip(state, p).vdepth


Objective = Callable[[CuttingModel], CuttingModel]

OBJECTIVES: Mapping[str, Objective] = {
    "volume": lambda model: model,
    "volume per mass": VolumePerMass,
    "t_c": EndTime,
    "depth": Depth,
}
"""The objectives of `alpha_max` by name."""

MEASURES: Mapping[str, str] = {
    "volume": "volume",
    "volume per mass": "specific_volume",
    "t_c": "t_c",
    "depth": "max_depth",
}
"""The key of each objective in `erosion.parameters.quantities.RESULTS`."""


_NO_RATES = {
    "plateau": "no angle of a plateau is better than the others",
    "unresolved": "there are no derivatives there",
    "jump": "the cut does not graze at this jump",
    "none": "nothing is removed at any angle",
}

_AT_LIMIT = 1e-6  # of the greatest turn: a cut that ends so near it ends at it
_DISTANCES = 1e-7, 4e-7, 16e-7  # rad, from a jump or a kink; a quotient at it is continued from these


@dataclasses.dataclass(frozen=True, repr=False)
class Optimum(Result):
    """The angle of attack at which an objective is greatest (or least).

    For parameters that are arrays, every field but `model`, `p`, `objective`, `least` and
    `integrand` is an array of their broadcast shape, without that of `alpha`, which is not used.

    Args:
        model: the model.
        p: the parameters; `alpha` is the answer.
        objective: the name of the objective.
        least: whether the objective is least there.
        alpha: the angle [rad]; 1e-9 beside a jump; 0 for the limit as α → 0; the middle of a plateau; NaN where
            nothing is removed at any angle.
        low, high: the ends of a plateau [rad]; else both are `alpha`.
        value: the objective there.
        volume: V there [m³].
        kind: "interior" (dV/dα = 0), "jump" (one side of a discontinuity; see `side` and
            `attained`), "limit" (on the other side the body turns further than `max_turn`), "boundary" (the
            limit as α → 0, or an end of the range), "kink" (the slope jumps through zero), "plateau" (the
            same value from `low` to `high`, to nine digits), "unresolved" (the greatest value, known to
            1e-6 rad at best, where derivatives do not exist), or "none": nothing is ever removed, or, where
            `ended_by` is "failed", nothing could be computed, or, where it is "turned", the body turns
            further than `max_turn` at every angle that cuts.
        ended_by: how the cut ends there.
        side: the side of a jump or limit, "below" or "above"; else "".
        attained: whether `value` is reached, or only approached.
        dvolume, d2volume: derivatives of the objective by the angle there [per rad, per rad²].
        candidates: every maximum that was compared, best first: a tuple of `Candidate`.
        jumps: all discontinuities, a tuple of `Jump` by angle.
        regimes: how the cut ends over the whole range, a tuple of `Regime` by angle; "turned" where the body turns
            further than `max_turn`.
        iterations: rounds of refinement plus Newton steps of the answer.
        certified: False where an impact failed or has no derivatives, so that a better angle may have been missed.
            Of a range from 0 what was searched begins at 1e-6 rad, or at a hundredth of its end.
        max_turn: the greatest turn of the body that was allowed [rad]; None where any was, or the model has no body.
        integrand: the model whose "volume" is the objective; `model` itself for the volume.
    """

    model: CuttingModel
    p: Parameters
    objective: str
    least: bool
    alpha: PerImpact
    low: PerImpact
    high: PerImpact
    value: PerImpact
    volume: PerImpact
    kind: PerImpact
    ended_by: PerImpact
    side: PerImpact
    attained: PerImpact
    dvolume: PerImpact
    d2volume: PerImpact
    candidates: PerImpact
    jumps: PerImpact
    regimes: PerImpact
    iterations: PerImpact
    certified: PerImpact
    max_turn: float | None
    integrand: CuttingModel = dataclasses.field(repr=False)

    @functools.cached_property
    def turn(self) -> PerImpact:
        """How far the body turns there [rad]; NaN without an angle or an orientation; computed when first read."""
        at = np.asarray(self.alpha)
        cut = at > 0
        turn = turn_of(self.model, self.p.replace(alpha=np.where(cut, at, STEEPEST)))
        return np.where(cut, turn, np.nan)[()]

    @functools.cached_property
    def turned_beyond(self) -> PerImpact:
        """Whether the body turns by more than 90° there, where the model does not hold; computed when first read."""
        return turned_beyond(self.model, self.p)[()]

    @functools.cached_property
    def sensitivities(self) -> Mapping[str, PerImpact]:
        """dα_max/dq for every parameter q but α, the model's own too [rad per unit of q]; computed when first read.

        Interior: -V_αq/V_αα, by the implicit function theorem. Jump: -t_q/t_α of the end time t
        on the side that grazes. Kink: -[V_q]/[V_α], where [ ] is the difference of both sides. Limit of the turn:
        -φ_q/φ_α of the orientation φ at the end of the cut, or as at a jump where the turn grazes `max_turn` before
        it. Boundary: 0.
        NaN where it is not known: on a plateau, where derivatives do not exist ("unresolved"), at a jump without
        a graze (as where cutting begins), and where nothing is removed. A sensitivity below the rounding (1e-11 rad
        for a change of q by its own size) is given as 0.
        """
        names = [name for name in quantities(self.integrand) if name != "alpha"]
        rates = _sensitivities(self, names)
        return dict(zip(names, rates, strict=True))

    @property
    def without_sensitivities(self) -> str:
        """Why the sensitivities of one case are not known; empty where they are."""
        if any(np.isfinite(rate) for rate in self.sensitivities.values()):
            return ""
        return _NO_RATES.get(str(self.kind), "there are no derivatives there")

    @property
    def _turns_always(self) -> np.ndarray:
        """Whether the body turns further than is allowed at each angle, so that none is the best."""
        return (np.asarray(self.kind) == "none") & (np.asarray(self.ended_by) == TURNED)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Angles that may have been missed, and a body that turns too far at the best angle or at each one."""
        turned, many = int(np.sum(self.turned_beyond)), np.ndim(self.turned_beyond) > 0
        numbers = {"turned": turned, "impacts": np.size(self.turned_beyond)}
        return found(
            (not np.all(self.certified), Finding("not_certified")),
            (pushed_forward(self.model, self.p), Finding("pushed_forward")),
            (np.any(self._turns_always), Finding("turned_at_each_angle", numbers={"max_turn": self.max_turn})),
            (turned, Finding("turned_beyond_in_part", numbers=numbers) if many else Finding("turned_beyond_at_best")),
        )

    @property
    def title(self) -> str:
        """The model and what is greatest or least."""
        return f"{model_name(self.model)}: the angle of {'least' if self.least else 'greatest'} {self.objective}"

    @property
    def subject(self) -> Record:
        """The model and the case."""
        return impact_to_dict(self.model, self.p)

    @property
    def measure(self) -> Quantity:
        """The quantity that the objective is."""
        return RESULTS[MEASURES[self.objective]] if self.objective in MEASURES else Quantity("", self.objective, "1")

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Declared]:
        """The answer with every rival, but not the sensitivities, which take longer."""
        known, angle, turn = self.measure, QUANTITIES["alpha"], self.turn
        slope, bend = (Derivative(known.dimension, ("angle",) * order) for order in (1, 2))
        symbol, is_volume = "α_min" if self.least else "α_max", self.objective == "volume"
        certified = Finding("not_certified").text if not np.all(self.certified) else "the search resolved all angles"
        return [
            Value("objective", self.objective, only="data"),
            Value("least", self.least, only="data"),
            angle.declare("alpha", self.alpha, symbol=symbol, meaning="angle of attack, of this model"),
            angle.declare("low", self.low, only="data"),
            angle.declare("high", self.high, only="data"),
            Value("kind", self.kind, meaning="" if np.ndim(self.kind) else self._kind_explained()),
            Value("ended_by", self.ended_by, meaning="how the cut ends there"),
            declare_result("volume", self.volume),
            known.declare("value", self.value, only="data" if is_volume else ""),
            declare_result("turn", turn, only="data" if np.all(np.isnan(turn)) else ""),
            Value(
                "turned_beyond", self.turned_beyond, meaning=BEYOND, only="" if np.any(self.turned_beyond) else "data"
            ),
            Value("side", self.side, only="data"),
            Value("attained", self.attained, only="data"),
            Value("dvolume", self.dvolume, measure=slope, only="data"),
            Value("d2volume", self.d2volume, measure=bend, only="data"),
            angle.declare("max_turn", self.max_turn, only="data"),
            Value("iterations", self.iterations, only="data"),
            Value("certified", self.certified, meaning=certified),
            *self._rivals(slope, bend),
        ]

    def _rivals(self, slope: Derivative, bend: Derivative) -> list[Declared]:
        """The candidates, jumps and regimes; of many optima with the indices of the impact that each belongs to."""
        angle, value = (functools.partial(_declared, each) for each in (QUANTITIES["alpha"], self.measure))
        known: dict[str, Declare] = {
            **dict.fromkeys(("alpha", "low", "high"), angle),
            **dict.fromkeys(("value", "below", "above"), value),
            "dvalue": lambda name, numbers: Value(name, numbers, measure=slope),
            "d2value": lambda name, numbers: Value(name, numbers, measure=bend),
        }
        if np.ndim(self.kind):
            rivals = {"candidates": self.candidates, "jumps": self.jumps, "regimes": self.regimes}
            return [_of_many(name, each, known) for name, each in rivals.items()]
        hidden = ("low", "high", "attained", "dvalue", "d2value", "steps")
        return [
            Columns.of("candidates", "", self.candidates, known, only="data"),
            Columns.of("others", "Other candidates", self.candidates[1:], known, hidden, only="table"),
            Columns.of("jumps", "Jumps", self.jumps, known),
            Columns.of("regimes", "", self.regimes, known, only="data"),
        ]

    def _kind_explained(self) -> str:
        if self.kind == "jump":
            return f"just {self.side} a jump" + ("" if self.attained else ", not reached")
        if self.kind == "limit":
            beside = "above" if self.side == "below" else "below"
            return f"{beside} it the body turns by more than {math.degrees(self.max_turn or math.nan):.4g}°"
        if self.kind == "boundary":
            return "an end of the range" if self.attained else "approached as α → 0, not reached"
        if self.kind == "plateau":
            low, high = (f"{math.degrees(end):.5g}°" for end in (self.low, self.high))
            return f"the same from {low} to {high}"
        if self.kind == "none":
            return "the body turns too far at each angle" if self._turns_always else "nothing is removed"
        return {"interior": "dV/dα = 0", "unresolved": "the greatest value that was computed"}.get(str(self.kind), "")


def _of_many(name: str, of_each: np.ndarray, known: Mapping[str, Declare]) -> Columns:
    """The rivals of many optima, each beside the indices of its impact, `dim_0`, ….

    Args:
        name: of the columns.
        of_each: tuples of dataclasses, an array of them.
        known: see `Columns.of`.
    """
    at = [index for index in np.ndindex(of_each.shape) for _ in of_each[index]]
    places = [Value(f"dim_{i}", [index[i] for index in at]) for i in range(of_each.ndim if at else 0)]
    columns = Columns.of(name, "", [*itertools.chain.from_iterable(of_each.ravel())], known, only="data")
    return dataclasses.replace(columns, values=[*places, *columns.values])


def _declared(quantity: Quantity, name: str, numbers: Any) -> Value:
    """A column of the quantity, named as its field is."""
    symbol = quantity.symbol if name in ("alpha", "value") else ""
    return quantity.declare(name, numbers, symbol=symbol)


def alpha_max(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha_range: tuple[float, float] | None = None,
    objective: str | Objective = "volume",
    max_turn: float | str | None = "90deg",
) -> Optimum:
    """The angle at which most is removed.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters whose leaves are scalars or arrays that broadcast; `alpha` is not used.
        alpha_range: ends of the range of angles [rad]; all of (0, π/2] without it.
        objective: "volume", "volume per mass", "t_c", "depth" (where the tip first stops
            going deeper), or a function that turns a model into one with another
            `removal_rate`, as those of `erosion.impacts.optimum` do.
        max_turn: the greatest turn of the body [rad], or text with a unit; only angles at which the body turns no
            further at any time are searched. None allows any turn, beyond 90° without meaning. Of a model without an
            orientation it limits nothing.

    Returns:
        The certified optimum; see `Optimum`.

    Raises:
        ValueError: for parameters, a range or a turn out of bounds, or an unknown objective.

    References:
        Laverty asks for Newton's method on dV/dα; docs/optimum.md says why that is not
        enough. For the linearized model α_max = ½ arctan k.
    """
    return _optimum(model, p, alpha_range, objective, max_turn, least=False)


def alpha_min(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha_range: tuple[float, float] | None = None,
    objective: str | Objective = "volume",
    max_turn: float | str | None = "90deg",
) -> Optimum:
    """The angle at which least is removed; give a range, because over all angles it is an end.

    Arguments, result and errors are those of `alpha_max`.
    """
    return _optimum(model, p, alpha_range, objective, max_turn, least=True)


def _optimum(
    model: CuttingModel | str | Path,
    p: Parameters,
    alpha_range: tuple[float, float] | None,
    objective: str | Objective,
    max_turn: float | str | None,
    *,
    least: bool,
) -> Optimum:
    require_float64()
    model = load_model(model)
    require_parameters(p)
    name, integrand = _integrand(model, objective)
    low, high = (0.0, STEEPEST) if alpha_range is None else _checked_range(alpha_range)
    p = p.replace(alpha=STEEPEST)
    validate(p)
    limit = check_max_turn(max_turn)
    if limit is not None and not turns(model, p):
        limit = None
    searched_model = integrand if limit is None else TurnLimited(integrand, limit)
    signature, parameters, shape = lanes_of(searched_model, p)

    def search(lanes: slice, cases: int) -> list[Maxima]:
        return over_angles(signature, signature.of_lanes(parameters, lanes), cases, low, high, least=least).optima()

    columns = in_words(searched(math.prod(shape), search), shape)
    volume = columns["value"]
    if integrand is not model:
        volume, columns["ended_by"] = _volume_at(model, p, columns["alpha"], columns["ended_by"], shallowest(high))
    p = p.replace(alpha=columns["alpha"])
    return Optimum(model=model, p=p, objective=name, least=least, volume=volume, max_turn=limit,
                   integrand=integrand, **columns)  # fmt: skip


def _integrand(model: CuttingModel, objective: str | Objective) -> tuple[str, CuttingModel]:
    """The objective's name, and the model whose volume it is."""
    if isinstance(objective, str):
        if objective not in OBJECTIVES:
            raise ValueError(
                f"Argument `objective` must be one of {', '.join(OBJECTIVES)}, but is {briefly(objective)}."
            )
        return objective, OBJECTIVES[objective](model)
    if not callable(objective):
        raise TypeError(f"Argument `objective` must be a name or a function, but is {briefly(objective)}.")
    integrand = objective(model)
    if not isinstance(integrand, CuttingModel):
        raise TypeError(f"Argument `objective` must turn a model into a model, but makes {briefly(integrand)}.")
    return getattr(objective, "__name__", "objective"), integrand


def _checked_range(alpha_range: tuple[float, float]) -> tuple[float, float]:
    low, high = as_pair(alpha_range)
    if not 0 <= low < high <= STEEPEST * (1 + 1e-12):
        given = repr(alpha_range)
        with contextlib.suppress(TypeError):
            given = ", ".join(f"{math.degrees(angle):g}°" for angle in alpha_range)
        raise ValueError(
            f"Argument `alpha_range` must be two ascending angles within [0, 90°], but is {given} (numbers without a "
            "unit are in radians)."
        )
    return low, min(high, STEEPEST)


def _volume_at(
    model: CuttingModel, p: Parameters, alpha: PerImpact, ended_by: PerImpact, shallow: float
) -> tuple[PerImpact, PerImpact]:
    """Volume [m³] and outcome in words at the optimum of another objective."""
    inside, at_zero = np.asarray(alpha) > 0, np.asarray(alpha) == 0
    hits = impact(model, p.replace(alpha=np.where(inside, alpha, shallow)), rtol=TIGHT)
    volume = np.where(inside, hits.volume, np.nan)
    if np.any(at_zero):
        first = impact(model, p.replace(alpha=shallow), derivatives=2, rtol=TIGHT)
        volume = np.where(at_zero, limit_at_zero(shallow, first.volume, first.dvolume, first.d2volume), volume)
    return volume[()], np.where(inside, hits.ended_by, ended_by)[()]


class _AlongAngle(Protocol):
    """First and second derivatives by α, and by α and each of some names, of given cases at given angles."""

    def __call__(self, cases: np.ndarray, angles: np.ndarray, of: Objective = ...) -> PairDerivatives: ...


def _sensitivities(optimum: Optimum, names: list[str]) -> np.ndarray:
    """dα/dq, shape (names, *shape of the optimum)."""
    p, model = optimum.p, optimum.integrand
    kind = np.atleast_1d(optimum.kind)
    # Own parameters that all cases share stay single numbers: their fields may not take an array.
    own = own_parameters(model)
    per_case = {q: value for q, value in values(model, p).items() if q not in own or np.ndim(value)}
    flat = {q: np.broadcast_to(np.asarray(value), np.shape(optimum.kind)).reshape(-1) for q, value in per_case.items()}
    size_of = sizes(model, p)
    size = np.stack([np.broadcast_to(size_of[q], np.shape(optimum.kind)).reshape(-1) for q in names])
    # An end of the range stays where it is.
    rates = np.where(kind.ravel() == "boundary", 0.0, np.full((len(names), kind.size), np.nan))

    def along_angle(cases: np.ndarray, angles: np.ndarray, of: Objective = OBJECTIVES["volume"]) -> PairDerivatives:
        varied, at_angles = with_values(model, p, {q: leaf[cases] for q, leaf in flat.items()} | {"alpha": angles})
        return pair_derivatives(of(varied), at_angles, [("alpha", q) for q in ("alpha", *names)], rtol=TIGHT)

    for of_kind, rates_of in _RATES_OF.items():
        cases = np.flatnonzero(kind.ravel() == of_kind)
        if cases.size:
            with np.errstate(all="ignore"):
                rates[:, cases] = rates_of(along_angle, cases, optimum)
    # No finite rate is a statement only where the derivatives exist.
    rates = np.where(np.isfinite(rates), np.where(np.abs(rates * size) < 1e-11, 0.0, rates), np.nan)
    return rates.reshape(len(names), *np.shape(optimum.kind))


def _along_interior(along_angle: _AlongAngle, cases: np.ndarray, optimum: Optimum) -> np.ndarray:
    """dα/dq of the interior maxima of some cases, shape (names, cases)."""
    second = along_angle(cases, np.ravel(optimum.alpha)[cases]).volume.mixed
    return (-second[:, 1:] / second[:, :1]).T


def _along_jump(along_angle: _AlongAngle, cases: np.ndarray, optimum: Optimum) -> np.ndarray:
    """dα/dq of the jumps of some cases, shape (names, cases).

    On the side that grazes, the event function g(t, α, q) is tangent at the jump: ġ → 0 there,
    both t_q and t_α grow, and -t_q/t_α tends to -g_q/g_α. The quotient is a series in the root
    of the distance from the jump.
    """
    at = _beside(cases, optimum, optimum.jumps, lambda jump: jump.alpha)
    # On the side that grazes the cut ends earlier: it is the side that is attained.
    return _along_graze(along_angle, cases, at, below=_is_below(cases, optimum) == np.ravel(optimum.attained)[cases])


def _along_graze(along_angle: _AlongAngle, cases: np.ndarray, at: np.ndarray, *, below: np.ndarray) -> np.ndarray:
    """dα/dq of some angles, `below` or above which an event grazes; NaN where none does."""
    towards = np.where(below, -1.0, 1.0)
    times = [along_angle(cases, at + towards * distance).t_c for distance in _DISTANCES]
    rates = _at_no_distance([(-time.by_second[:, 1:] / time.by_first[:, :1]).T for time in times])
    nearest, farthest = (np.abs(times[i].by_first[:, 0]) for i in (0, -1))
    # Beside a graze t_α grows as the root of the distance falls, by 4 here. Another jump leaves no trace beside it, and
    # t_α may be zero but for rounding there.
    is_graze = (nearest > 2 * farthest) & (nearest > 1e-6 * times[0].value)
    return np.where(is_graze, rates, np.nan)


def _along_limit(along_angle: _AlongAngle, cases: np.ndarray, optimum: Optimum) -> np.ndarray:
    """dα/dq of the limits of the turn of some cases, shape (names, cases).

    The turn by which the cut ends stays the greatest that is allowed. Else the body turns back before, so that the
    turn grazes its limit on the side beyond, or the limit is a jump of the cut.
    """
    assert optimum.max_turn is not None
    at, below = _beside(cases, optimum, optimum.regimes, lambda regime: regime.high), _is_below(cases, optimum)
    whole = along_angle(cases, np.ravel(optimum.alpha)[cases], Turn).volume
    at_end = np.abs(np.abs(whole.value) - optimum.max_turn) < _AT_LIMIT * optimum.max_turn
    limited = functools.partial(along_angle, of=functools.partial(TurnLimited, max_turn=optimum.max_turn))
    beside = _along_graze(limited, cases, at, below=~below)
    of_jump = _along_graze(along_angle, cases, at, below=below)
    beside = np.where(np.isfinite(beside), beside, of_jump)
    return np.where(at_end, (-whole.by_second[:, 1:] / whole.by_first[:, :1]).T, beside)


def _beside(cases: np.ndarray, optimum: Optimum, of_each: PerImpact, place: Callable[[Any], float]) -> np.ndarray:
    """The place of the jump or limit that the optimum of each of some cases is beside [rad]."""
    each = np.ravel(of_each) if np.ndim(optimum.kind) else [of_each]
    both = zip(cases, np.ravel(optimum.alpha)[cases], strict=True)
    return np.array([min(map(place, each[case]), key=lambda at, alpha=alpha: abs(at - alpha)) for case, alpha in both])


def _is_below(cases: np.ndarray, optimum: Optimum) -> np.ndarray:
    """Of some cases whether the optimum is below the jump or limit beside it."""
    return np.ravel(np.asarray(optimum.side) == "below")[cases]


def _along_kink(along_angle: _AlongAngle, cases: np.ndarray, optimum: Optimum) -> np.ndarray:
    """dα/dq of the kinks of some cases, shape (names, cases).

    V is the same on both sides of the kink, also of the kink at q + dq: [V_α] dα + [V_q] dq = 0.
    """
    alpha = np.ravel(optimum.alpha)[cases]

    def quotient(distance: float) -> np.ndarray:
        below, above = (along_angle(cases, alpha + side * distance).volume for side in (-1, 1))
        return (-(above.by_second - below.by_second)[:, 1:] / (above.by_first - below.by_first)[:, :1]).T

    return _at_no_distance([quotient(distance) for distance in _DISTANCES])


def _at_no_distance(quotients: Sequence[np.ndarray]) -> np.ndarray:
    """A quotient at a place, from those at `_DISTANCES`, which cancel the terms of the distance and of its root."""
    nearest, middle, farthest = quotients
    return (8 * nearest - 6 * middle + farthest) / 3


_RATES_OF: Mapping[str, Callable[[_AlongAngle, np.ndarray, Optimum], np.ndarray]] = {
    "interior": _along_interior,
    "jump": _along_jump,
    "limit": _along_limit,
    "kink": _along_kink,
}
"""By the kind of an optimum, dα/dq of some cases of this kind, shape (names, cases)."""
