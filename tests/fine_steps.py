"""How cuts end: by brute force, in many small classical Runge-Kutta steps; one cut by scipy.

Shares the model's equations with the kernel and nothing else. A step of 0.002 of the time
scale leaves an error of about 1e-12, and the cubic between two steps one of 1e-14.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from scipy.integrate import solve_ivp

from erosion.models import CuttingModel, event_rates
from erosion.parameters.parameters import QUANTITIES, Parameters

STEP = 0.002
COARSE = 0.02  # leaves 1e-8: enough where nothing is missed by less than 1e-4


class Reference(NamedTuple):
    """For each lane: the index of the event (-1: none yet), its time, and the nearest miss before it."""

    which: Any
    time: Any
    miss: Any


class _Lane(NamedTuple):
    state: Any
    values: Any
    rates: Any
    time: Any
    which: Any
    miss: Any


@functools.partial(jax.jit, static_argnames="steps")
def ends(model: CuttingModel, p: Parameters, length: float = STEP, steps: int = 20_000) -> Reference:
    """The first event of many lanes that begin to cut; leaves of `p` are of one shape (lanes,)."""

    def look(state: Any, p: Parameters) -> tuple[Any, Any]:
        values, rates = event_rates(model, state, model.derivative(state, p), p)
        return jnp.stack(list(values.values())), jnp.stack([rates[name] for name in values])

    def step(lane: _Lane, p: Parameters) -> _Lane:
        h = length * model.scales(p).time

        def rate(state: Any) -> Any:
            return model.derivative(state, p)

        def add(state: Any, length: Any, slope: Any) -> Any:
            return jax.tree.map(lambda s, k: s + length * k, state, slope)

        k1 = rate(lane.state)
        k2 = rate(add(lane.state, h / 2, k1))
        k3 = rate(add(lane.state, h / 2, k2))
        k4 = rate(add(lane.state, h, k3))
        state = jax.tree.map(lambda s, a, b, c, d: s + h / 6 * (a + 2 * b + 2 * c + d), lane.state, k1, k2, k3, k4)
        values, rates = look(state, p)
        lowest, where = _lowest(lane.values, values, h * lane.rates, h * rates)
        falls = lowest <= 0
        at = jnp.where(falls, _root(lane.values, lane.rates * h, lowest, where, values, rates * h), jnp.inf)
        going = lane.which < 0
        now = going & jnp.any(falls)
        missed = jnp.min(jnp.where(falls | (where >= 1) | (where <= 0), jnp.inf, lowest))
        return _Lane(
            state,
            values,
            rates,
            jnp.where(going, lane.time + jnp.where(now, h * jnp.min(at), h), lane.time),
            jnp.where(now, jnp.argmin(at), lane.which),
            jnp.where(going, jnp.minimum(lane.miss, missed), lane.miss),
        )

    def begin(p: Parameters) -> _Lane:
        state = model.initial_state(p)
        values, rates = look(state, p)
        zero = jnp.zeros(())
        return _Lane(state, values, rates, zero, jnp.asarray(-1), zero + jnp.inf)

    def more(carry: tuple[Any, _Lane]) -> Any:
        return (carry[0] < steps) & jnp.any(carry[1].which < 0)

    def body(carry: tuple[Any, _Lane]) -> tuple[Any, _Lane]:
        return carry[0] + 1, jax.vmap(step)(carry[1], p)

    lane = lax.while_loop(more, body, (0, jax.vmap(begin)(p)))[1]
    return Reference(lane.which, lane.time, lane.miss)


def _cubic(start: Any, end: Any, from_: Any, to: Any, theta: Any) -> Any:
    rise = end - start
    return start + theta * (from_ + theta * ((3 * rise - 2 * from_ - to) + theta * (from_ + to - 2 * rise)))


def _lowest(start: Any, end: Any, from_: Any, to: Any) -> tuple[Any, Any]:
    """The least value of the cubic after its start, and where: 1 at the end, less in a dip."""
    rise = end - start
    a, b = 3 * (from_ + to - 2 * rise), 2 * (3 * rise - 2 * from_ - to)
    root = jnp.sqrt(jnp.maximum(b * b - 4 * a * from_, 0.0))
    theta = jnp.where(b >= 0, -2 * from_ / (b + root), (root - b) / (2 * a))
    dips = (b * b > 4 * a * from_) & (theta > 0) & (theta < 1)
    theta = jnp.where(dips, theta, 1.0)
    lowest = _cubic(start, end, from_, to, theta)
    return jnp.minimum(lowest, end), jnp.where(lowest <= end, theta, 1.0)


def _root(start: Any, from_: Any, lowest: Any, where: Any, end: Any, to: Any) -> Any:
    """Where the cubic falls through zero before its lowest point, by bisection."""

    def halve(_: Any, ends: tuple[Any, Any]) -> tuple[Any, Any]:
        low, high = ends
        middle = (low + high) / 2
        above = _cubic(start, end, from_, to, middle) > 0
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    low, high = lax.fori_loop(0, 40, halve, (jnp.zeros_like(where), where))
    return (low + high) / 2


def wrong_ends(model: CuttingModel, p: Parameters, ended_by: np.ndarray, close: float = 1e-9) -> tuple[int, int]:
    """How many lanes end wrongly, and how many miss an event by less than `close` (not judged).

    Lanes whose two events coincide to 1e-9 of the time scale have no right answer either.
    """
    shape = np.broadcast_shapes(*(np.shape(getattr(p, name)) for name in QUANTITIES))
    lanes = jax.tree.map(lambda leaf: np.broadcast_to(leaf, shape).reshape(-1), p)
    cuts = np.asarray(ended_by).reshape(-1) != "no-cut"
    lanes = jax.tree.map(lambda leaf: leaf[cuts], lanes)
    codes = np.array(["rebound", "stop"])
    ended = np.asarray(ended_by).reshape(-1)[cuts]
    look = jax.tree.map(np.asarray, ends(model, lanes, COARSE))
    unsettled = (codes[look.which] != ended) | (look.miss < 1e-4)
    if not np.any(unsettled):
        return 0, 0
    found = jax.tree.map(np.asarray, ends(model, jax.tree.map(lambda leaf: leaf[_padded(unsettled)], lanes)))
    count = np.count_nonzero(unsettled)
    wrong, near = codes[found.which[:count]] != ended[unsettled], found.miss[:count] < close
    return int(np.count_nonzero(wrong & ~near)), int(np.count_nonzero(near))


def _padded(chosen: np.ndarray) -> np.ndarray:
    """Indices of what is chosen, the last repeated up to a power of four: few shapes to compile."""
    index = np.flatnonzero(chosen)
    size = 4 ** int(np.ceil(np.log2(max(index.size, 64)) / 2))
    return np.concatenate([index, np.repeat(index[-1:], size - index.size)])


def scipy_cut(model: CuttingModel, p: Parameters, knots: Sequence[float] = ()) -> tuple[float, str, float]:
    """Volume, end and its time by scipy's DOP853, started anew where depth/r passes a knot."""
    start, structure = jax.tree.flatten(model.initial_state(p))

    @jax.jit
    def looks(u: Any) -> tuple[Any, Any]:
        """Rates of the state and of the volume; the tip's depth over r and its speed over v₀."""
        state = jax.tree.unflatten(structure, [*u[:-1]])
        tip = model.tip(state, p)
        rates = [*jax.tree.leaves(model.derivative(state, p)), model.removal_rate(state, p)]
        return jnp.stack(rates), jnp.stack([tip.depth / p.r, tip.vx / p.v0])

    # All events look at one state in turn.
    @functools.lru_cache(1)
    def seen(u: bytes) -> np.ndarray:
        return np.asarray(looks(np.frombuffer(u))[1])

    def rate(_: float, u: np.ndarray) -> np.ndarray:
        return np.asarray(looks(u)[0])

    def event(place: int, level: float, direction: int) -> Any:
        def value(_: float, u: np.ndarray) -> float:
            return seen(u.tobytes())[place] - level

        value.terminal, value.direction = True, direction  # pyrefly: ignore
        return value

    events = [event(0, 0.0, -1), event(1, 0.0, -1), *(event(0, knot, way) for knot in knots for way in (1, -1))]
    scale, time, u = float(model.scales(p).time), 0.0, np.array([*map(float, start), 0.0])
    for _ in range(50):
        piece = solve_ivp(rate, (time, time + 100 * scale), u, "DOP853", rtol=1e-12, atol=1e-16, events=events,
                          first_step=1e-6 * scale)  # fmt: skip
        assert piece.status == 1
        for name, times in zip(("rebound", "stop"), piece.t_events, strict=False):
            if times.size:
                return float(piece.y[-1, -1]), name, float(times[0])
        # A little past the kink, or it would be found again.
        past = 1e-7 * scale
        time, u = piece.t[-1] + past, piece.y[:, -1] + past * rate(0.0, piece.y[:, -1])
    raise AssertionError("too many kinks")
