"""Numbers at the ends of what is legal: is any result wrong without a word?

    python -m benchmarks.extremes [COUNT] [SEED] [MODEL …]

Random impacts with k from 1e-3 to 1e3, ψ from 1e-6 to 1, β from 0.05 to 5, r from a tenth to ten times Table 1's, α
from 0.01° to 89.99°, and rims up to a hundred times as fast as the impact, against scipy's DOP853 at 1e-12 in short
steps. The equations are typed here once more. The ends are looked for at 17 places of each step, and between them at
every minimum. Models that do not turn, or to first order, are compared with their closed forms.
"""

import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.integrate import DOP853

import erosion
from erosion.parameters.parameters import Parameters

WRONG = 1e-7  # relative error of V that is silent
_TURN = 2500.0  # rad; what turns further is left out
_GROUP = 400  # impacts that are integrated together
_STEP = 0.2  # of the fastest time of an impact
_FIRST_STEP = 1e-10  # the same; steps then grow at most tenfold
_FIRST_DEPTH = 1e-300
_CLOSE = 1e-10  # of a length or a speed: rounding decides whether an event function falls below zero
_VARIED = ("k", "psi", "r", "alpha", "phidot0", "inertia")
_PLACES = np.linspace(0, 1, 17)

Numbers = np.ndarray


def random_impacts(count: int, seed: int) -> Parameters:
    """Random impacts at legal extremes."""
    rng = np.random.default_rng(seed)

    def spread(low: float, high: float) -> Numbers:
        return np.exp(rng.uniform(np.log(low), np.log(high), count))

    p = erosion.TABLE_1
    r = p.r * spread(0.1, 10)
    flat, steep = np.deg2rad(spread(0.01, 45)), np.pi / 2 - np.deg2rad(spread(0.01, 45))
    kind = rng.random(count)
    fast = rng.choice([-1, 1], count) * spread(0.01, 100)
    spin = np.where(kind < 0.2, 0, np.where(kind < 0.6, rng.uniform(-0.95, 0.95, count), fast))
    return p.replace(
        k=spread(1e-3, 1e3),
        psi=spread(1e-6, 1),
        r=r,
        alpha=np.where(rng.random(count) < 0.5, flat, steep),
        phidot0=spin * p.v0 / r,
        inertia=spread(0.05, 5),
    )


@dataclasses.dataclass(frozen=True)
class Motion:
    """Many impacts of a rotating model, each in units of its own.

    Lengths are in v₀/ω, times in 1/ω, with ω = √(c/m), and then in `unit`. The state is (y, q, ẋ, ẏ, q̇, V), each in
    its `scales`; q is φ - π/2.

    Args:
        ratio, size, inertia: K, rω/v₀ and β, shape (n,).
        full: whether the whole force turns the body.
        unit: the shortest time in which an impact changes, shape (n,).
        scales: of the state, shape (6, n).
        start: the state at contact, shape (6, n).
    """

    ratio: Numbers
    size: Numbers
    inertia: Numbers
    full: bool
    unit: Numbers
    scales: Numbers
    start: Numbers

    def of(self, lanes: Numbers) -> "Motion":
        """Some of the impacts."""
        names = ("ratio", "size", "inertia", "unit", "scales", "start")
        return dataclasses.replace(self, **{name: getattr(self, name)[..., lanes] for name in names})

    def rates(self, scaled: Numbers) -> Numbers:
        """d(state)/dt, shape (6, n, …)."""
        y, q, vx, vy, spin, _ = scaled * self.scales
        depth, speed = self._events(y, q, vx, spin)
        arm = np.cos(q) - self.ratio * np.sin(q) if self.full else 1.0
        turning = -depth * arm / (self.inertia * self.size)
        rates = np.stack([vy, spin, -depth, -self.ratio * depth, turning, depth * speed])
        return rates * self.unit / self.scales

    def events(self, scaled: Numbers) -> Numbers:
        """Depth (rebound) and horizontal speed (stop) of the tip, shape (2, n)."""
        y, q, vx, _, spin, _ = scaled * self.scales
        return np.stack(self._events(y, q, vx, spin))

    def lengths(self, scaled: Numbers) -> Numbers:
        """What rounding of the two event functions is relative to, shape (2, n)."""
        y, _, vx, _, spin, _ = scaled * self.scales
        return np.stack([np.maximum(np.abs(y), self.size), np.maximum(np.abs(vx), np.abs(self.size * spin))])

    def _events(self, y: Numbers, q: Numbers, vx: Numbers, spin: Numbers) -> list[Numbers]:
        half = np.sin(q / 2)
        return [y - 2 * self.size * half * half, vx + self.size * spin * np.cos(q)]


def motion(name: str, p: Parameters, t_c: Numbers, volume: Numbers) -> Motion:
    """The motion of impacts; t_c and V, roughly known, set the scale of what is small."""
    rate = np.sqrt(np.asarray(p.stiffness) / float(p.m))
    size, alpha = np.asarray(p.r) * rate / float(p.v0), np.asarray(p.alpha)
    ratio = np.tan(alpha) if "tan-alpha" in name or "velocity-aligned" in name else np.asarray(p.k)
    beta, spin = np.asarray(p.inertia), np.asarray(p.phidot0) / rate
    full = name.endswith("full-torque")
    fastest = np.abs(spin) + (1 / np.sqrt(beta) if full else 2 / beta) / size
    unit = 1 / np.maximum(fastest, np.sqrt((1 + ratio) * (1 + 1 / beta)))
    one, zero = np.ones_like(size), np.zeros_like(size)
    depth = np.sin(alpha) * t_c * rate
    swept = np.maximum(volume * rate**2 / (float(p.b) * float(p.v0) ** 2), 1e-300)
    scales = np.stack([depth, one, one, np.sin(alpha), np.maximum(fastest, 1e-300), swept])
    start = np.stack([zero + _FIRST_DEPTH, zero, np.cos(alpha), np.sin(alpha), spin, zero]) / scales
    return Motion(ratio, size, beta, full, unit, scales, start)


@dataclasses.dataclass(frozen=True)
class EndsOfCuts:
    """How impacts end: 0 rebound or 1 stop, when (in units), their scaled volume, and how nearly otherwise."""

    event: Numbers
    time: Numbers
    volume: Numbers
    miss: Numbers

    def put(self, lanes: Numbers, step: "EndsOfCuts") -> None:
        """Note what a step has found of some impacts."""
        self.miss[lanes] = np.minimum(self.miss[lanes], step.miss)
        ended = lanes[step.event >= 0]
        for name in ("event", "time", "volume"):
            getattr(self, name)[ended] = getattr(step, name)[step.event >= 0]


def ends(motion: Motion, latest: Numbers) -> EndsOfCuts:
    """Integrate impacts to their ends; an event of -1 has none before its latest time."""
    count = motion.size.size
    found = EndsOfCuts(np.full(count, -1), np.full(count, np.nan), np.full(count, np.nan), np.full(count, np.inf))
    lanes, now, state, step = np.arange(count), 0.0, motion.start, _FIRST_STEP
    while lanes.size:
        here = motion.of(lanes)
        solver = DOP853(
            lambda t, flat, here=here: here.rates(flat.reshape(6, -1)).ravel(), now, state.ravel(), np.inf,
            rtol=1e-12, atol=1e-15, max_step=_STEP, first_step=step,
        )  # fmt: skip
        going = np.ones(lanes.size, bool)
        before = here.events(state)
        while np.count_nonzero(going) > 0.7 * lanes.size:
            solver.step()
            if solver.status == "failed":
                raise ArithmeticError("scipy's DOP853 finds no step that is short enough.")
            after = here.events(solver.y.reshape(6, -1))
            near = np.flatnonzero(going & _may_end(before, after, here.lengths(solver.y.reshape(6, -1))))
            if near.size:
                found.put(lanes[near], _within(here, solver, near))
            before = after
            going = (found.event[lanes] < 0) & (solver.t < latest[lanes])
        left = np.flatnonzero(going)
        now, step, state = solver.t, solver.h_abs, solver.y.reshape(6, -1)[:, left]
        lanes = lanes[left]
    return found


def _may_end(before: Numbers, after: Numbers, lengths: Numbers) -> Numbers:
    """Whether an event function may fall below zero within a step of a fifth of a radian at most."""
    low, high = np.minimum(before, after), np.maximum(before, after)
    return np.any((low < 0.5 * high) | (low < 0.02 * lengths), axis=0)


def _within(motion: Motion, solver: DOP853, lanes: Numbers) -> EndsOfCuts:
    """The first fall through zero within a step, of some impacts."""
    here = motion.of(lanes)
    dense: Any = solver.dense_output()
    old = dense.y_old.reshape(6, -1)[:, lanes]
    parts = [part.reshape(6, -1)[:, lanes] for part in dense.F]

    def state(place: Numbers) -> Numbers:
        value = np.zeros_like(old)
        for i, part in enumerate(reversed(parts)):
            value = (value + part) * (place if i % 2 == 0 else 1 - place)
        return value + old

    first, miss, event = np.full(lanes.size, np.inf), np.full(lanes.size, np.inf), np.full(lanes.size, -1)
    values = np.stack([here.events(state(np.full(lanes.size, place))) for place in _PLACES])
    size = here.lengths(old)
    for i in range(len(size)):
        series = values[:, i]
        place, lowest = _first_fall(lambda at, i=i: here.events(state(at))[i], series)
        miss = np.minimum(miss, np.abs(lowest) / size[i])
        event = np.where(place < first, i, event)
        first = np.minimum(first, place)
    ended = np.isfinite(first)
    at = state(np.where(ended, first, 1.0))
    return EndsOfCuts(event, dense.t_old + first * dense.h, at[5], miss)


def _first_fall(value: Callable[[Numbers], Numbers], series: Numbers) -> tuple[Numbers, Numbers]:
    """Where a function first falls through zero, infinity if nowhere; and its least minimum before."""
    places, count = _PLACES, series.shape[1]
    fall = np.full(count, np.inf)
    lowest = np.full(count, np.inf)
    going = np.ones(count, bool)
    for j in range(1, len(places)):
        falls = going & (series[j - 1] > 0) & (series[j] <= 0)
        if falls.any():
            root = _bisected(value, np.full(count, places[j - 1]), np.full(count, places[j]))
            fall = np.where(falls, root, fall)
            going = going & ~falls
        if j + 1 < len(places):
            dips = going & (series[j] > 0) & (series[j] <= series[j - 1]) & (series[j] <= series[j + 1])
            if dips.any():
                where, least = _least(value, np.full(count, places[j - 1]), np.full(count, places[j + 1]))
                lowest = np.where(dips, np.where(np.abs(least) < np.abs(lowest), least, lowest), lowest)
                crosses = dips & (least <= 0)
                if crosses.any():
                    root = _bisected(value, np.full(count, places[j - 1]), where)
                    fall = np.where(crosses, root, fall)
                    going = going & ~crosses
    return fall, lowest


def _bisected(value: Callable[[Numbers], Numbers], low: Numbers, high: Numbers) -> Numbers:
    for _ in range(54):
        middle = (low + high) / 2
        above = value(middle) > 0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return (low + high) / 2


def _least(value: Callable[[Numbers], Numbers], low: Numbers, high: Numbers) -> tuple[Numbers, Numbers]:
    """The least value between two places, by golden sections."""
    golden = (np.sqrt(5) - 1) / 2
    for _ in range(45):
        left, right = high - golden * (high - low), low + golden * (high - low)
        keeps_left = value(left) < value(right)
        low, high = np.where(keeps_left, low, left), np.where(keeps_left, right, high)
    middle = (low + high) / 2
    return middle, value(middle)


def _groups(length: Numbers) -> Iterator[Numbers]:
    order = np.argsort(length)
    yield from (order[i : i + _GROUP] for i in range(0, order.size, _GROUP))


def _of(p: Parameters, lanes: Numbers) -> Parameters:
    return p.replace(**{name: getattr(p, name)[lanes] for name in _VARIED})


def compare(name: str, p: Parameters) -> int:
    """Print how a model's results differ from scipy's; gives the number of silent errors."""
    begun = time.perf_counter()
    hits = erosion.impact(name, p)
    lost = np.isin(hits.ended_by, ["failed", "unfinished"])
    whole = motion(name, p, np.where(hits.t_c > 0, hits.t_c, 1.0), hits.volume)
    rate = np.sqrt(np.asarray(p.stiffness) / float(p.m))
    length = hits.t_c * rate / whole.unit
    cut = ~lost & (hits.ended_by != "no-cut")
    chosen = np.flatnonzero(cut & (length < _TURN))
    solutions = [(chosen[group], ends(whole.of(chosen[group]), 3 * length[chosen[group]] + 10))
                 for group in _groups(length[chosen])]  # fmt: skip
    lanes = np.concatenate([group for group, _ in solutions])
    joined = EndsOfCuts(*(np.concatenate([getattr(part, field.name) for _, part in solutions])
                    for field in dataclasses.fields(EndsOfCuts)))  # fmt: skip
    error = np.abs(joined.volume - 1)  # in units of the engine's volume
    error = np.where(np.isfinite(error), error, np.inf)
    other = np.array(["rebound", "stop", "none"])[joined.event] != hits.ended_by[lanes]
    undecided = joined.miss < _CLOSE
    wrong = ((error > WRONG) | other) & ~undecided
    no_cut = ~lost & ~cut & (np.cos(p.alpha) + p.phidot0 * p.r / p.v0 > 1e-12)
    took = time.perf_counter() - begun
    turned = length[lanes] / (2 * np.pi)
    counts = {"turn further": cut & (length >= _TURN), "failed": lost, "cut nothing": ~cut & ~lost, "wrongly": no_cut}
    print(
        f"{name}: {p.k.size:,} impacts; {lanes.size:,} compared, of up to {turned.max():.0f} turns; "
        f"{', '.join(f'{np.count_nonzero(each):,} {label}' for label, each in counts.items())}; {took:.0f} s"
    )
    quantiles = ", ".join(f"{q:.1e}" for q in np.quantile(error[~undecided], [0.5, 0.99, 0.999, 1], method="lower"))
    print(
        f"  V: median, 99 %, 99.9 %, worst {quantiles}; {np.count_nonzero(undecided)} undecided by rounding; "
        f"{np.count_nonzero(wrong)} wrong",
        flush=True,
    )
    for lane in np.flatnonzero(wrong)[:12]:
        i = lanes[lane]
        values = ", ".join(f"{each}={float(getattr(p, each)[i])!r}" for each in _VARIED)
        print(f"    {hits.ended_by[i]} for {joined.event[lane]}, V off by {error[lane]:.1e}, nearest miss "
              f"{joined.miss[lane]:.1e}, {turned[lane]:.1f} turns: {values}", flush=True)  # fmt: skip
    return int(np.count_nonzero(wrong) + np.count_nonzero(no_cut))


def compare_exactly(name: str, p: Parameters) -> int:
    """Print how a model's results differ from its closed form; gives the number of silent errors."""
    form = erosion.load_model(name).closed_form()
    assert form is not None
    hits, exact = erosion.impact(name, p), np.asarray(form.volume(p))
    known = ~np.isin(hits.ended_by, ["failed", "unfinished"])
    with np.errstate(all="ignore"):
        error = np.where(hits.volume == exact, 0, np.abs(hits.volume / exact - 1))[known]
    wrong = int(np.count_nonzero(~(error <= WRONG)))
    print(f"{name}: {p.k.size:,} impacts, {np.count_nonzero(~known)} failed; V off by {error.max():.1e}; {wrong} wrong")
    return wrong


def main(count: int = 2000, seed: int = 1, models: list[str] | None = None) -> int:
    """Compare models; gives the number of silent errors."""
    rotating = [name for name in erosion.available_models() if name.startswith("rotating") and "deform" not in name]
    exact = ("linearized", "finnie", "tan-alpha", "velocity-aligned")
    return sum(
        (compare_exactly if name in exact else compare)(name, random_impacts(count, seed + i))
        for i, name in enumerate(models or [*exact, *rotating])
    )


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:3]]
    sys.exit(1 if main(*given, models=sys.argv[3:] or None) else 0)
