"""Derivatives of one number by all arguments of many lanes: forwards with a tape, and backwards.

Lanes of motions that may have kinks, and those of which the adjoint is not known well enough, have their derivatives
forwards, one lane for each argument. Sums over lanes are taken by pairs of neighbours, pairs of pairs and
so on, so that their bits depend on the lanes alone.
"""

import collections
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import Number, PerImpact, PerLane, check_unmasked
from erosion.lanes.engines import compile_lanes
from erosion.lanes.flatten import NotForLanesError
from erosion.lanes.lanewise import WIDTH, Lanewise, number
from erosion.ode.adjoint import pulled_back
from erosion.ode.batch import ROWS, compiling, in_threads, integrate, integrate_along, integrator_of
from erosion.ode.ensemble import Lanes
from erosion.ode.integrator import LaneEnd
from erosion.ode.kinks import may_have_kinks
from erosion.ode.signature import Clock, Signature
from erosion.ode.tape import Recorded, row_width
from erosion.output.tables import briefly

_BESIDE_STEPS = 8  # rows of a tape beside one for each trial: those of events, and of the steps that end there
_CHUNK = 512  # lanes at most whose tapes are kept at once
_MEMORY = 2**26  # bytes of tapes, and of derivatives by numbers that lanes share, at once
_FEW = 64  # lanes that one thread computes sooner
_FORWARD = 2**20  # lanes at once of derivatives forwards


class Ended(NamedTuple):
    """How lanes ended, arrays of shape (lanes,).

    Args:
        outcome: indices of `Signature.end_names`.
        t: when, see `Signature.end_times`.
        trials: of steps.
        rtol_used: tolerance of the results.
        stiff: whether the method for stiff motions integrated them.
        rtol: that was asked for.
        recorded: their steps, where some are.
    """

    outcome: np.ndarray
    t: np.ndarray
    trials: np.ndarray
    rtol_used: np.ndarray
    stiff: np.ndarray
    rtol: float
    recorded: Recorded | None = None


class AtTimes(NamedTuple):
    """What a number changes by with the outputs of lanes at times.

    Args:
        times: of each lane, rising, shape (lanes, n).
        due: how many of them each lane reaches, shape (lanes,).
        cotangents: zero where a lane does not, shape (lanes, n, outputs).
    """

    times: np.ndarray
    due: np.ndarray
    cotangents: np.ndarray

    @classmethod
    def of(cls, times: np.ndarray, cotangents: np.ndarray, ends: "Ended") -> "AtTimes":
        """With how many times these lanes reach."""
        times = np.broadcast_to(times, cotangents.shape[:2])
        due = np.count_nonzero(times <= ends.t[:, None], axis=1)
        is_late = (np.arange(times.shape[1]) >= due[:, None]) & np.isfinite(ends.t)[:, None]
        return cls(times, due, np.where(is_late[..., None], 0.0, cotangents))


class _Known(NamedTuple):
    signature: Signature
    bits: list[tuple[tuple[int, ...], bytes]]
    lanes: int
    ended: Ended


_known: collections.deque[_Known] = collections.deque(maxlen=4)
"""What JAX integrated last, whose derivatives it may want."""


def ends_of(
    signature: Signature, parameters: Sequence[PerLane], lanes: int, rtol: float, times: np.ndarray | None = None
) -> Ended:
    """How lanes end, with their steps; where states at times count, with the tolerance that these need."""
    if times is not None:
        return _ended(signature, parameters, integrate(signature, parameters, lanes, 0, (), rtol, times=times), rtol)
    signature, bits = signature.wanting(records=True), _bits(parameters)
    for known in list(_known):
        if known.signature == signature and known.ended.rtol == rtol and known.lanes == lanes and known.bits == bits:
            return known.ended
    return _ended(signature, parameters, integrate(signature, parameters, lanes, 0, (), rtol), rtol)


def _ended(signature: Signature, parameters: Sequence[PerLane], found: LaneEnd, rtol: float) -> Ended:
    stiff = np.zeros(found.outcome.shape, bool) if found.stiff is None else found.stiff > 0
    t = signature.end_times(parameters, found.outcome, found.time.value)
    assert found.rtol_used is not None
    return Ended(found.outcome, t, found.trials, found.rtol_used, stiff, rtol, found.recorded)


def keep(signature: Signature, parameters: Sequence[PerLane], found: LaneEnd, rtol: float) -> None:
    """Keep lanes, for `ends_of` them."""
    if found.recorded is not None:
        _known.append(
            _Known(signature, _bits(parameters), found.outcome.size, _ended(signature, parameters, found, rtol))
        )


def _bits(parameters: Sequence[PerLane]) -> list[tuple[tuple[int, ...], bytes]]:
    return [(np.shape(number), np.asarray(number, float).tobytes()) for number in parameters]


FEW = 3
"""Elements by which derivatives are taken from which on going backwards costs less, as measured."""


def is_worth(signature: Signature, elements: int) -> bool:
    """Whether derivatives by so many elements should go backwards."""
    return elements >= FEW and goes_back(signature)


def first_method(signature: Signature) -> str:
    """That by which a lane is integrated unless it turns out to be stiff."""
    return "explicit" if signature.options.method == "auto" else signature.options.method


def goes_back(signature: Signature, *, timed: bool = False) -> bool:
    """Whether lanes of a signature have an adjoint; `timed` where states at times count.

    JAX cannot go backwards through a `while_loop` of the rates. At a time the rates of a stiff motion have few digits.
    """
    signature = signature.wanting(method=first_method(signature))
    options = signature.options
    if may_have_kinks(signature) or options.fires or (timed and options.for_stiff):
        return False
    return _is_traced(signature)


def going_forwards(signature: Signature, stiff: np.ndarray, *, timed: bool) -> np.ndarray:
    """Which lanes have no adjoint, whatever they do on the way, by whether they are stiff; see `goes_back`."""
    methods = (signature.wanting(method="rosenbrock"), signature.wanting(method=first_method(signature)))
    return np.where(stiff, *(not goes_back(each, timed=timed) for each in methods))


def gradient(
    signature: Signature,
    parameters: Sequence[PerLane],
    lanes: int,
    ends: Ended,
    cotangents: np.ndarray,
    *,
    spoils: bool,
    at: AtTimes | None = None,
) -> list[np.ndarray]:
    """What a number L changes by with the numbers of lanes.

    Args:
        signature: of problem and arguments.
        parameters: each an array with an axis of lanes, or of one lane's shape where all share it.
        lanes: how many.
        ends: of these lanes.
        cotangents: by what L changes with each lane's time and outputs, shape (1 + outputs, lanes).
        spoils: whether derivatives of lanes without a result are NaN, and the sums with them; else they are zero.
        at: by what L changes with the outputs at times.

    Returns:
        For each number the derivatives by it: of each lane, shape (lanes, …), or the sum over the lanes where they
        share it. Zero where `cotangents` are zero.
    """
    signature = signature.renewed().wanting(records=False)
    cotangents = np.asarray(cotangents, float)
    lost = signature.has_no_result(ends.outcome)
    # What does not count is zero, whatever the lane did.
    counts = _counts(cotangents, at)
    known = counts & ~lost
    stiff = ends.stiff & (signature.options.method == "auto")
    ways: list[tuple[_WayBack, np.ndarray]] = []
    forwards = known.copy()
    for method, those in ((first_method(signature), known & ~stiff), ("rosenbrock", known & stiff)):
        wanted = signature.wanting(method=method)
        if not np.any(those) or not goes_back(wanted, timed=at is not None):
            continue
        with compiling:
            back = _compiled(wanted, timed=at is not None)
        if back is not None:
            real = [np.asarray(number, float) for number in parameters]
            ways.append((_WayBack(wanted, back, real, ends, cotangents, at), those))
            forwards &= ~those
    shared = [number.ndim == len(shape) for number, shape in zip(parameters, signature.shapes, strict=True)]
    found = [np.zeros(() if same else (lanes, *shape)) for same, shape in zip(shared, signature.shapes, strict=True)]
    sums: list[list[np.ndarray]] = [[] for _ in found]
    size = sum(math.prod(shape) for shape in signature.shapes)
    block = max(WIDTH, 1 << int(math.log2(max(_MEMORY / 8 / size, 1))))
    for begin in range(0, lanes, block):
        some = np.arange(begin, min(begin + block, lanes))
        parts = [np.zeros((some.size, *shape)) for shape in signature.shapes]
        for way, those in ways:
            way.fill(some[those[some]], begin, parts)
        if ways:
            # What did not happen, such as the reset of another event, may have made 0·∞ of an adjoint.
            unknown = [~np.isfinite(part).all(axis=tuple(range(1, part.ndim))) for part in parts]
            forwards[some] |= known[some] & np.any(unknown, axis=0)
        if forwards[some].any():
            _fill_forwards(signature, parameters, some[forwards[some]], ends, cotangents, begin, parts, at=at)
        gone = (counts & lost)[some]
        for i, (part, same) in enumerate(zip(parts, shared, strict=True)):
            if signature.dtypes[i] != "float64":
                continue
            if spoils:
                part[gone] = np.nan
            if same:
                sums[i].append(summed(part))
            else:
                found[i][some] = part
    for i, (of_blocks, same) in enumerate(zip(sums, shared, strict=True)):
        if same:
            found[i] = summed(np.array(of_blocks)) if of_blocks else np.zeros(signature.shapes[i])
    return found


def _counts(cotangents: np.ndarray, at: AtTimes | None) -> np.ndarray:
    """Whether a number changes with what a lane gives, shape (lanes,)."""
    counts = (cotangents != 0).any(axis=0)
    return counts if at is None else counts | np.any(at.cotangents != 0, axis=(1, 2))


def summed(rows: np.ndarray) -> np.ndarray:
    """The sum along the first axis, by pairs of neighbours."""
    while len(rows) > 1:
        even = len(rows) // 2 * 2
        rows = np.concatenate([rows[:even:2] + rows[1:even:2], rows[even:]])
    return rows[0] if len(rows) else np.zeros(rows.shape[1:])


class _WayBack:
    """The way back through lanes.

    Args: see `gradient`.
    """

    def __init__(
        self,
        signature: Signature,
        back: Lanewise,
        parameters: list[np.ndarray],
        ends: Ended,
        cotangents: np.ndarray,
        at: AtTimes | None,
    ) -> None:
        self.signature, self.parameters, self.ends, self.cotangents, self.at = (
            signature,
            parameters,
            ends,
            cotangents,
            at,
        )
        self.back = back

    def fill(self, lanes: np.ndarray, begin: int, parts: Sequence[np.ndarray]) -> None:
        """Compute some lanes, and write the derivatives of lane i into row i - begin of each part."""
        lanes = lanes[np.argsort(self.ends.trials[lanes], kind="stable")]
        recorded = self.ends.recorded
        if recorded is not None:
            is_known = (recorded.rows[lanes] > 0) & (recorded.rows[lanes] <= ROWS)

            def from_known(block: np.ndarray, stop: np.ndarray | None) -> None:
                self._fill(block, begin, parts, stop, Recorded(recorded.rows[block], recorded.tapes[block]))

            in_threads(from_known, lanes[is_known], _CHUNK, _FEW)
            lanes = lanes[~is_known]
        in_threads(lambda block, stop: self._record_and_fill(block, begin, parts, stop), lanes, _CHUNK, _FEW)

    def _record_and_fill(
        self, lanes: np.ndarray, begin: int, parts: Sequence[np.ndarray], stop: np.ndarray | None, rows: int = 0
    ) -> None:
        rows = rows or int(self.ends.trials[lanes].max()) + _BESIDE_STEPS
        signature = self.signature.wanting(records=True)
        length = rows * row_width(signature)
        most = max(WIDTH, _MEMORY // (8 * length))
        if lanes.size > most:
            for first in range(0, lanes.size, most):
                self._record_and_fill(lanes[first : first + most], begin, parts, stop, rows)
            return
        forwards, results = integrator_of(signature, 0, (), 0)
        found = jax.tree.map(lambda leaf: np.empty(lanes.size, leaf.dtype), results)
        tapes = np.empty((lanes.size, length))
        inputs = [*signature.of_lanes(self.parameters, lanes), np.asarray(float(rows)), self.ends.rtol_used[lanes]]
        forwards.run(inputs, np.arange(lanes.size), jax.tree.leaves(found), stop, [tapes])
        if stop is not None and stop[0]:
            return
        count = found.recorded.rows
        # A lane that ends otherwise has taken other steps; that is not known to happen.
        count[found.outcome != self.ends.outcome[lanes]] = 0
        fits = count <= rows
        self._fill(lanes[fits], begin, parts, stop, Recorded(count[fits], tapes[fits]))
        if not fits.all():
            self._record_and_fill(lanes[~fits], begin, parts, stop, int(count.max()))

    def _fill(
        self,
        lanes: np.ndarray,
        begin: int,
        parts: Sequence[np.ndarray],
        stop: np.ndarray | None,
        recorded: Recorded,
    ) -> None:
        results = [np.full((lanes.size, *shape), np.nan) for shape, real in self._real() if real]
        cotangents = [np.ascontiguousarray(row[lanes]) for row in self.cotangents]
        own = self.signature.of_lanes(self.parameters, lanes)
        inputs = [*own, self.ends.rtol_used[lanes], recorded.rows.astype(float), *cotangents, np.zeros(())]
        tapes = [recorded.tapes]
        if self.at is not None:
            inputs.append(self.at.due[lanes].astype(float))
            tapes += [self.at.times[lanes], self.at.cotangents[lanes]]
        self.back.run(inputs, np.flatnonzero(recorded.rows), results, stop, tapes)
        found = iter(results)
        for part, (_, real) in zip(parts, self._real(), strict=True):
            if real:
                part[lanes - begin] = next(found)

    def _real(self) -> list[tuple[tuple[int, ...], bool]]:
        return [
            (shape, dtype == "float64")
            for shape, dtype in zip(self.signature.shapes, self.signature.dtypes, strict=True)
        ]


# JAX traces it once, to look whether it can and to compile it: half of the time of a first gradient.
@functools.lru_cache(maxsize=64)
def _back(signature: Signature) -> Callable[..., list[Number]]:
    """The way back through a lane."""
    return jax.jit(functools.partial(pulled_back, signature))


@functools.lru_cache(maxsize=256)
def _is_traced(signature: Signature) -> bool:
    """Whether JAX can go back through a step."""
    try:
        jax.eval_shape(_back(signature), signature.structs(), number, number, [number] * signature.rows, number)
    except ValueError:
        return False
    return True


@functools.lru_cache(maxsize=64)
def _compiled(signature: Signature, *, timed: bool) -> Lanewise | None:
    """The program that goes back; None where lanes cannot do what it needs."""
    arguments = (signature.structs(), number, number, [number] * signature.rows, number, *[number] * timed)
    try:
        return compile_lanes(_back(signature), arguments, tapes=3 if timed else 1, what=signature.name("back", timed))
    except NotForLanesError:
        return None


def _fill_forwards(
    signature: Signature,
    parameters: Sequence[PerLane],
    lanes: np.ndarray,
    ends: Ended,
    cotangents: np.ndarray,
    begin: int,
    parts: Sequence[np.ndarray],
    *,
    at: AtTimes | None,
) -> None:
    """The same as `_WayBack.fill`, one lane for each element of a number."""
    of_times = signature.arguments + Clock._fields.index("max_step")
    elements = [
        (i, offset + j)
        for i, (shape, offset) in enumerate(zip(signature.shapes[:of_times], signature.offsets, strict=False))
        for j in range(math.prod(shape))
        if signature.dtypes[i] == "float64"
    ]
    places = np.array([[element for _, element in elements]], float)
    some = max(1, _FORWARD // (len(elements) * (1 if at is None else 2 * at.times.shape[1] + 1)))
    for first in range(0, lanes.size, some):
        each = lanes[first : first + some]
        own = signature.of_lanes(parameters, each)
        times = None if at is None else at.times[each]
        slopes = integrate_along(signature, own, each.size, 1, places, ends.rtol, times=times)
        along = slopes.quantities.by_first
        total = np.zeros((each.size, len(elements)))
        for cotangent, slope in zip(cotangents, along, strict=True):
            if np.any(cotangent[each]):
                total += np.where(cotangent[each, None] != 0, cotangent[each, None] * slope, 0.0)
        if at is not None:
            assert slopes.saved is not None
            weights = at.cotangents[each][:, None]
            total += np.sum(np.where(weights != 0, weights * slopes.saved[:, :, :, 1], 0.0), axis=(2, 3))
        for column, (i, element) in enumerate(elements):
            part = parts[i][each - begin].reshape(each.size, -1)
            part[:, element - signature.offsets[i]] = total[:, column]
            parts[i][each - begin] = part.reshape(each.size, *signature.shapes[i])


def gradient_of(
    lanes: Lanes,
    rtol: float,
    ended: Ended | None,
    ts: PerImpact,
    t: Any,
    y: PyTree,
    integrals: Mapping[str, Any],
    ys: PyTree,
) -> PyTree:
    """The gradient of a number that changes by `t`, `y`, `integrals` and `ys`; see `Solution.gradient`.

    `ended` is None where the solution has derivatives, and `ts` where it has no states at times.
    """
    signature, shape = lanes.signature, lanes.shape
    cotangents = [_cotangent("t", t, shape), *_state_cotangents("y", y, signature, shape)]
    names = signature.problem.integrals
    if not isinstance(integrals, Mapping):
        raise TypeError(f"Argument `integrals` must give numbers by name, but is {briefly(integrals)}.")
    for name in integrals:
        if name not in names:
            raise ValueError(
                f"Argument `integrals` must name some of {', '.join(names) or 'none'}, but has {briefly(name)}."
            )
    cotangents += [_cotangent("integrals", integrals.get(name, 0.0), shape) for name in names]
    rows = np.concatenate(
        [cotangent.reshape(lanes.size, math.prod(cotangent.shape[len(shape) :])).T for cotangent in cotangents]
    )
    if ended is None:
        times = None if ys is None or ts is None else np.unique(ts[np.isfinite(ts)])
        ended = ends_of(signature, lanes.parameters, lanes.size, rtol, times)
    at = None if ys is None else _at_times(lanes, ended, ts, ys)
    found = gradient(signature, lanes.parameters, lanes.size, ended, rows, spoils=False, at=at)
    gone = np.asarray(signature.has_no_result(ended.outcome) & _counts(rows, at)).reshape(shape)
    own = [
        _as_given(part, gone, leaf, each) if dtype == "float64" else np.zeros(each, jax.dtypes.float0)
        for part, leaf, dtype, each in zip(found, signature.shapes, signature.dtypes, lanes.given, strict=True)
    ]
    return signature.args(own)


def _state_cotangents(name: str, given: PyTree, signature: Signature, shape: tuple[int, ...]) -> list[np.ndarray]:
    """By what a number changes with each part of a state, arrays of a shape and the part's own; zeros for None."""
    state = jax.tree.leaves(signature.state)
    if given is None:
        return [np.zeros((*shape, *leaf.shape)) for leaf in state]
    if jax.tree.structure(given) != jax.tree.structure(signature.state):
        raise ValueError(f"Argument `{name}` must be a pytree like the state, but is {jax.tree.structure(given)}.")
    return [
        _cotangent(name, part, (*shape, *leaf.shape)) for part, leaf in zip(jax.tree.leaves(given), state, strict=True)
    ]


def _at_times(lanes: Lanes, ended: Ended, ts: PerImpact, ys: PyTree) -> AtTimes:
    """The same with states at times; integrals there do not count."""
    signature = lanes.signature
    if ts is None:
        raise ValueError("Argument `ys` needs states at times, but the solution has none: give `solve` times, `ts`.")
    ts = np.asarray(ts)
    parts = _state_cotangents("ys", ys, signature, (*lanes.shape, ts.size))
    given = np.concatenate(
        [part.reshape(lanes.size, ts.size, math.prod(part.shape[len(lanes.shape) + 1 :])) for part in parts], axis=-1
    )
    known = np.isfinite(ts)
    times, places = np.unique(ts[known], return_inverse=True)
    cotangents = np.zeros((lanes.size, times.size, signature.rows - 1))
    for place, cotangent in zip(places, np.moveaxis(given[:, known], 1, 0), strict=True):
        cotangents[:, place, : cotangent.shape[-1]] += cotangent
    return AtTimes.of(times, cotangents, ended)


def _cotangent(name: str, given: Any, shape: tuple[int, ...]) -> np.ndarray:
    check_unmasked(name, given)
    try:
        return np.broadcast_to(np.asarray(given).astype(float, casting="same_kind"), shape)
    except (TypeError, ValueError):
        raise ValueError(f"Argument `{name}` must have the shape {shape}, but is {briefly(given)}.") from None


def _as_given(found: np.ndarray, gone: np.ndarray, own: tuple[int, ...], given: tuple[int, ...]) -> np.ndarray:
    """Derivatives by a number in the shape in which it was given; summed over the lanes that share an element.

    NaN where none of these lanes has a result: they are `gone`.
    """
    if found.ndim == len(own):
        return np.full(given, np.nan) if gone.size and gone.all() else found.reshape(given)
    if own:
        found = np.where(gone.reshape(-1, *[1] * len(own)), np.nan, found)
        return found.reshape(given)
    found = found.reshape(gone.shape)
    for axis in range(gone.ndim):
        behind = gone.ndim - axis
        if behind > len(given) or given[-behind] < gone.shape[axis]:
            found = np.expand_dims(summed(np.moveaxis(found, axis, 0)), axis)
            gone = np.all(gone, axis=axis, keepdims=True)
    return np.where(gone, np.nan, found).reshape(given)
