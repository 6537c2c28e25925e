"""The removed volume as a function of the angle: what is its own in the search of `erosion.ode`, and its words."""

import dataclasses
import functools

import numpy as np

from erosion.arguments import PerImpact
from erosion.impacts.batch import OTHER_ENDS, volume_of
from erosion.impacts.turn import TURNED
from erosion.models import NO_CUT
from erosion.ode import maxima
from erosion.ode.integrator import LaneEnd
from erosion.ode.maxima import QuantityAlong, Search, SearchRange
from erosion.ode.resolve import Nodes, Ruler, choose
from erosion.ode.signature import Signature
from erosion.ode.variational import Derivatives
from erosion.output import Record
from erosion.parameters import QUANTITIES, STEEPEST

_SHALLOWEST = 1e-6  # rad; below it a function is continued to its limit as α → 0
_RULER = Ruler(unit=1.0, relative=1e-4)  # rad
_ROUNDING = 1e-11  # of a function: what its slope near 0 adds over the angle, where it is rounding
_ALPHA = list(QUANTITIES).index("alpha")
_GRID = 64  # first angles between 0.02 rad and π/2
_SERIES = 1e-4  # rad; from here to 0 two terms of a series continue a function
_CHANGE = 0.01  # of a function: if its slope adds more over the angle, it is a power of the angle
_BEND = 0.02  # rad; below, the first angles are closer together


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A local maximum of the objective (or minimum, for `alpha_min`), at a jump and at a boundary too.

    Args:
        alpha: its angle [rad]; of a jump 1e-9 beside the jump; of a plateau the middle.
        low, high: the ends of a plateau [rad]; else both are `alpha`.
        value: the objective there.
        kind: "interior", "jump", "limit", "boundary", "kink", "plateau" or "unresolved"; see `Optimum`.
        ended_by: how the cut ends there.
        side: the side of a jump or limit in angle, "below" or "above"; else "".
        attained: whether `value` is reached. At a jump the impact that just grazes belongs
            to the side where the cut ends earlier; the other side only approaches its value.
            The limit as α → 0 is not reached either.
        dvalue, d2value: derivatives of the objective by the angle there [per rad, per rad²].
        steps: evaluations that polished the angle.
    """

    alpha: float
    low: float
    high: float
    value: float
    kind: str
    ended_by: str
    side: str
    attained: bool
    dvalue: float
    d2value: float
    steps: int

    @classmethod
    def of(cls, found: maxima.Extremum) -> "Candidate":
        """Return the search's result with erosion's names."""
        fields = dict(vars(found))
        alpha, dvalue, d2value = (fields.pop(name) for name in ("at", "slope", "curve"))
        return cls(alpha=alpha, dvalue=dvalue, d2value=d2value, **fields)


@dataclasses.dataclass(frozen=True)
class Jump:
    """A discontinuity of the objective, bracketed to 1e-11 rad.

    Args:
        alpha: its angle [rad].
        below, above: the objective on either side, 2e-10 rad beside it.
        ended_below, ended_above: how the cut ends on either side.
    """

    alpha: float
    below: float
    above: float
    ended_below: str
    ended_above: str

    @classmethod
    def of(cls, found: maxima.Discontinuity) -> "Jump":
        """Return the search's result with erosion's names."""
        return cls(found.at, found.below, found.above, found.ended_below, found.ended_above)


class WithinTurn:
    """The volume of a `TurnLimited` model, which falls below all values where the body turns too far.

    There the value tells how late the limit is reached, so that the search resolves where it ends.

    Args:
        volume: the volume, or how late the body turns too far.
        lowest, range_: of the volume of each case, see `_sizes`.
    """

    def __init__(self, volume: QuantityAlong, lowest: np.ndarray, range_: np.ndarray) -> None:
        self._volume, self._lowest, self._range = volume, lowest, range_
        self._turned = volume.signature.event_names.index(TURNED)
        self._sign = -1.0 if volume.negative else 1.0

    def __call__(self, case: np.ndarray, at: np.ndarray) -> Nodes:
        """The nodes at these angles."""
        nodes = self._volume(case, at)
        turned, height = nodes.outcome == self._turned, self._sign * self._range[case]
        value = self._lowest[case] - self._range[case] + height * nodes.value
        below = nodes._replace(value=value, slope=height * nodes.slope, curve=height * nodes.curve)
        return choose(turned, below, nodes)

    def outcomes(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Outcomes, times and values."""
        return self._volume.outcomes(case, at)


def over_angles(
    signature: Signature, parameters: list[np.ndarray], cases: int, low: float, high: float, *, least: bool
) -> Search:
    """The search of the greatest (or least) volumes of many cases over the angles from `low` to `high` [rad].

    Of a `TurnLimited` model only angles count at which the body does not turn too far.
    """
    within = SearchRange(
        low,
        high,
        _first_angles(low, high),
        _RULER,
        limit=None if low else _limit,
        # Beside 90° an impact may cut what one at 90° does not.
        ends_apart=least,
        nothing=NO_CUT,
    )
    names = (*signature.event_names, *OTHER_ENDS)
    if TURNED not in names:
        volume = functools.partial(QuantityAlong, signature, parameters, _ALPHA, _volume, least, refines=False)
        return Search(lambda rtol: volume(rtol=rtol), cases, names, within, least=least)
    lowest, range_ = _sizes(signature, parameters, cases, within.grid, least=least)
    quantity = functools.partial(_volume_or_time, signature.event_names.index(TURNED))
    volume = functools.partial(QuantityAlong, signature, parameters, _ALPHA, quantity, least, refines=False)
    return Search(lambda rtol: WithinTurn(volume(rtol=rtol), lowest, range_), cases, names, within, least=least)


def _sizes(
    signature: Signature, parameters: list[np.ndarray], cases: int, grid: np.ndarray, *, least: bool
) -> tuple[np.ndarray, np.ndarray]:
    """The lowest volume (of `least`, its negative) of each case and the range of its volumes, shape (cases,)."""
    volume = QuantityAlong(signature, parameters, _ALPHA, _volume, False, maxima.LOOSE, refines=False)
    _, _, values = volume.outcomes(np.repeat(np.arange(cases), grid.size), np.tile(grid, cases))
    values = np.where(np.isfinite(values), -values if least else values, np.nan).reshape(cases, grid.size)
    known = np.isfinite(values).any(axis=1)
    lowest, highest = (np.where(known, reduce(values, axis=1, initial=end, where=np.isfinite(values)), 0.0)
                       for reduce, end in ((np.min, np.inf), (np.max, -np.inf)))  # fmt: skip
    range_ = np.maximum(highest - lowest, np.abs(highest))
    return lowest, np.where(range_ > 0, range_, 1.0)


def in_words(optima: list[maxima.Maxima], shape: tuple[int, ...]) -> Record:
    """The fields of an `Optimum` that are arrays of the shape of the cases."""
    optima = [_within_turn(each) for each in optima]
    columns = maxima.columns(optima, shape)
    names = {"at": "alpha", "slope": "dvolume", "curve": "d2volume"}
    columns["candidates"] = maxima.objects([tuple(map(Candidate.of, each.candidates)) for each in optima], shape)
    columns["jumps"] = maxima.objects([tuple(map(Jump.of, each.jumps)) for each in optima], shape)
    return {names.get(name, name): column for name, column in columns.items()}


def _within_turn(found: maxima.Maxima) -> maxima.Maxima:
    """Without what the search found where the body turns too far, and with that limit by its name."""
    if all(regime.ended_by != TURNED for regime in found.regimes):
        return found
    limits = [jump for jump in found.jumps if TURNED in (jump.ended_below, jump.ended_above)]
    at_limits = [jump.at for jump in limits]
    candidates = []
    for each in found.candidates:
        if each.ended_by == TURNED:
            continue
        nearest = min(found.jumps, key=lambda jump, at=each.at: abs(jump.at - at), default=None)
        is_limit = each.kind == "jump" and nearest is not None and nearest.at in at_limits
        candidates.append(dataclasses.replace(each, kind="limit", attained=True) if is_limit else each)
    if not candidates:
        nowhere = dict.fromkeys(("at", "low", "high", "value", "slope", "curve"), np.nan)
        nothing = maxima.Extremum(**nowhere, kind="none", ended_by=TURNED, side="", attained=True, steps=0)
        candidates = [nothing]
    jumps = tuple(jump for jump in found.jumps if TURNED not in (jump.ended_below, jump.ended_above))
    return dataclasses.replace(found, candidates=tuple(candidates), jumps=jumps)


def _volume(results: LaneEnd, parameters: list[np.ndarray]) -> Derivatives:
    """The removed volume."""
    volume, alpha = volume_of(results), parameters[_ALPHA]
    if volume.by_first is None:
        return volume
    # Near 0 a slope is known to rounding over the angle.
    rounding = (_RULER.near(alpha) < 1) & (np.abs(alpha * volume.by_first) <= _ROUNDING * np.abs(volume.value))
    return volume._replace(by_first=np.where(rounding, 0.0, volume.by_first))


def _volume_or_time(turned: int, results: LaneEnd, parameters: list[np.ndarray]) -> Derivatives:
    """The removed volume; where the body turns too far, how late it does, from 0 at once to 1 never."""
    volume, time = _volume(results, parameters), results.time
    late = results.outcome == turned
    if not late.any():
        return volume
    p = dict(zip(QUANTITIES, parameters, strict=False))
    scale = np.sqrt(p["m"] / (p["k"] * p["sigma"] * p["b"] * p["psi"]))
    whole = 1 + time.value / scale
    value = np.where(late, 1 - 1 / whole, volume.value)
    if time.by_first is None or time.mixed is None:
        return volume._replace(value=value)
    rate = time.by_first / scale
    return volume._replace(
        value=value,
        by_first=np.where(late, rate / whole**2, volume.by_first),
        mixed=np.where(late, time.mixed / scale / whole**2 - 2 * rate**2 / whole**3, volume.mixed),
    )


def _limit(nodes: Nodes, first: int, second: int) -> tuple[int, float]:
    """The supremum as α → 0, continued from the shallowest node, or from the next if that is shallow enough."""
    at = (
        second
        if nodes.at[second] <= _SERIES
        and abs(nodes.at[first] * nodes.slope[first]) <= _CHANGE * abs(nodes.value[first])
        else first
    )
    return at, float(limit_at_zero(nodes.at[at], nodes.value[at], nodes.slope[at], nodes.curve[at]))


def shallowest(high: float) -> float:
    """The least angle [rad] that is computed of a range from 0 to `high`."""
    return min(_SHALLOWEST, high / 100)


def limit_at_zero(alpha: PerImpact, value: PerImpact, slope: PerImpact, curve: PerImpact) -> PerImpact:
    """The limit of a function as α → 0, from its value and derivatives at a shallow angle.

    It is a limit plus a power of the angle there, or two terms of a series.
    """
    rise = alpha * slope
    with np.errstate(all="ignore"):
        power = 1 + np.divide(alpha * curve, slope)
        series = value - rise + alpha**2 / 2 * curve
        of_power = np.where(power > 0, value - rise / power, -np.sign(rise) * np.inf)
    changes = np.abs(rise) > _CHANGE * np.abs(value)
    limit = np.where(changes, of_power, series)
    # What has risen from less than a tenth has risen from 0.
    return np.where(changes & (np.abs(limit) < 0.1 * np.abs(value)), 0.0, limit)[()]


def _first_angles(low: float, high: float) -> np.ndarray:
    """The first nodes [rad], all within the range: geometric near 0, where functions may be powers; then even."""
    low = low or shallowest(high)
    # At π/2 itself an impact without spin cuts nothing: its neighbour stands for the limit.
    high = min(high, max(STEEPEST - 1e-10, (low + STEEPEST) / 2))
    if high <= _BEND:
        angles = np.geomspace(low, high, _GRID)
    elif low >= _BEND:
        angles = np.linspace(low, high, _GRID)
    else:
        near_zero = np.geomspace(max(low, _SERIES), _BEND, 14)[:-1]
        angles = np.concatenate([[low], near_zero, np.linspace(_BEND, high, _GRID)])
    # In the narrowest ranges neighbours are the same number.
    return np.unique(np.clip(angles, low, high))
