"""Processor time a lane on stiff problems: `ode.solve` by the Rosenbrock method, scipy's Radau and diffrax's Kvaerno5.

    python -m benchmarks.ode_stiff

Errors are the median of those of the event's time, against scipy's Radau at 1e-12 of the first lanes. What a contender
compiles is not counted.
"""

import argparse
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.ode_problems import JAX, NUMPY, Case, Lanes
from benchmarks.timing import table_text
from erosion import ode

_TOLERANCES = (1e-5, 1e-7, 1e-9)


class StiffCase(Case):
    """A stiff problem.

    Args:
        nominal: the numbers as published.
        spread: by which factors lanes differ from them.
        absolute: the absolute tolerance of scipy and diffrax, of the relative one.
    """

    nominal: ClassVar[Mapping[str, float]]
    spread: ClassVar[float] = 1.1
    only_at_start: ClassVar[tuple[str, ...]] = ()
    absolute: ClassVar[float] = 1e-8

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """About the published numbers."""
        most = np.log(self.spread)
        return {name: value * np.exp(random.uniform(-most, most, lanes)) for name, value in self.nominal.items()}

    def integral(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> Any:
        """Of the first unknown."""
        return s[0]


class Robertson(StiffCase):
    """Robertson's reactions, until a ten-thousandth of the first substance is left."""

    name, state, directions = "Robertson, y1 = 1e-4", ("a", "b", "c"), {"down": -1}
    wrt, t1, spread, absolute = "k3", 1e11, 1.6, 1e-10
    nominal: ClassVar = {"k1": 0.04, "k2": 3e7, "k3": 1e4}

    def start(self, m: Any, p: Any) -> list[Any]:
        """One substance alone."""
        zero = 0.0 * p["k1"]
        return [1.0 + zero, zero, zero]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """H. H. Robertson, in Numerical Analysis (Academic Press, 1966) 178-182."""
        a, b, c = s
        first, second, third = p["k1"] * a, p["k2"] * b * b, p["k3"] * b * c
        return [third - first, first - third - second, second]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The first root of SUNDIALS' example cvRoberts."""
        return [s[0] / 1e-4 - 1.0]


class RobertsonEarly(Robertson):
    """Until there is a hundredth of the third substance."""

    name, directions, t1 = "Robertson, y3 = 0.01", {"up": 1}, 1e3

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The second root of cvRoberts."""
        return [s[2] / 0.01 - 1.0]


class VanDerPol(StiffCase):
    """Van der Pol's oscillator with μ = 1000, until it first jumps through zero."""

    name, state, directions = "van der Pol, 1000", ("x", "v"), {"zero": 0}
    wrt, t1, spread, absolute = "mu", 3e3, 1.2, 1e-6
    nominal: ClassVar = {"mu": 1000.0, "x0": 2.0}

    def start(self, m: Any, p: Any) -> list[Any]:
        """At rest."""
        return [1.0 * p["x0"], 0.0 * p["x0"]]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Damped outside of 1, driven within."""
        x, v = s
        return [v, p["mu"] * (1.0 - x * x) * v - x]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Zero."""
        return [1.0 * s[0]]


class Oregonator(StiffCase):
    """The Belousov-Zhabotinskii reaction, to the first minimum of its second substance."""

    name, state, directions = "Oregonator", ("u", "v", "w"), {"least": 1}
    wrt, t1 = "s", 400.0
    nominal: ClassVar = {"s": 77.27, "q": 8.375e-6, "w": 0.161}

    def start(self, m: Any, p: Any) -> list[Any]:
        """As in the literature."""
        zero = 0.0 * p["s"]
        return [1.0 + zero, 2.0 + zero, 3.0 + zero]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """E. Hairer, G. Wanner, Solving Ordinary Differential Equations II (Springer, 1996) 144."""
        u, v, w = s
        return [p["s"] * (v + u * (1.0 - p["q"] * u - v)), (w - (1.0 + u) * v) / p["s"], p["w"] * (u - w)]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """The rate of the second substance."""
        return [self.rates(m, t, s, p)[1]]


class Hires(StiffCase):
    """High irradiance responses of plants, until the sixth substance is almost gone."""

    name, state, directions = "HIRES", tuple(f"y{i}" for i in range(1, 9)), {"down": -1}
    wrt, t1, absolute = "k1", 1e3, 1e-9
    nominal: ClassVar = {"k1": 1.71, "k2": 280.0, "k3": 0.69}

    def start(self, m: Any, p: Any) -> list[Any]:
        """As in the literature."""
        zero = 0.0 * p["k1"]
        return [1.0 + zero, *[zero] * 6, 0.0057 + zero]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Hairer and Wanner, 145."""
        (y1, y2, y3, y4, y5, y6, y7, y8), k, back = s, p["k1"], p["k3"]
        forth = p["k2"] * y6 * y8
        return [
            -k * y1 + 0.43 * y2 + 8.32 * y3 + 0.0007,
            k * y1 - 8.75 * y2,
            -10.03 * y3 + 0.43 * y4 + 0.035 * y5,
            8.32 * y2 + k * y3 - 1.12 * y4,
            -1.745 * y5 + 0.43 * y6 + 0.43 * y7,
            -forth + back * y4 + k * y5 - 0.43 * y6 + back * y7,
            forth - 1.81 * y7,
            1.81 * y7 - forth,
        ]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """A twentieth."""
        return [s[5] / 0.05 - 1.0]


class Ignition(StiffCase):
    """Fuel gives radicals slowly, these branch with oxygen and recombine: until it is 400 K hotter."""

    name, state, directions = "ignition", ("T", "fuel", "oxygen", "radicals"), {"ignition": 1}
    wrt, t1, absolute = "E2", 10.0, 1e-10
    nominal: ClassVar = {"T0": 1000.0, "A1": 1e9, "E1": 24000.0, "A2": 1e10, "E2": 9000.0, "k3": 2e6, "Q": 1800.0}

    def sample(self, lanes: int, random: np.random.Generator) -> Lanes:
        """Rates by factors, temperatures and energies within ranges."""
        ranges = {"T0": (900, 1300), "E1": (23000, 25000), "E2": (8500, 9500), "Q": (1500, 2200)}
        factors = {name: np.exp(random.uniform(-1, 1, lanes)) * self.nominal[name] for name in ("A1", "A2", "k3")}
        return {name: random.uniform(low, high, lanes) for name, (low, high) in ranges.items()} | factors

    def start(self, m: Any, p: Any) -> list[Any]:
        """No radicals."""
        zero = 0.0 * p["T0"]
        return [p["T0"] + zero, 1.0 + zero, 1.0 + zero, zero]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """At constant volume."""
        hot, fuel, oxygen, radicals = s
        first = p["A1"] * fuel * m.exp(-p["E1"] / hot)
        branching = p["A2"] * fuel * radicals * oxygen * m.exp(-p["E2"] / hot)
        return [p["Q"] * branching, -first - branching, -branching, 2.0 * first + branching - p["k3"] * radicals]

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Of order 1."""
        return [(s[0] - p["T0"]) / 400.0 - 1.0]


class Brusselator(StiffCase):
    """A reaction with diffusion on a line of ten points, until the middle falls after its first peak."""

    count = 10
    name, state, directions = "Brusselator, 20", tuple(f"{x}{i}" for x in "uv" for i in range(10)), {"down": -1}
    wrt, t1 = "B", 20.0
    nominal: ClassVar = {"A": 1.0, "B": 3.0, "diffusion": 0.02}

    def start(self, m: Any, p: Any) -> list[Any]:
        """A wave."""
        zero, count = 0.0 * p["A"], self.count
        wave = [zero + 1.0 + float(np.sin(2 * np.pi * (i + 1) / (count + 1))) for i in range(count)]
        return [*wave, *[zero + 3.0] * count]

    def rates(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Hairer and Wanner, 148."""
        count, c = self.count, p["diffusion"] * (self.count + 1) ** 2
        u, v = [1.0, *s[:count], 1.0], [3.0, *s[count:], 3.0]
        rates = []
        for own, sign in ((u, 1.0), (v, -1.0)):
            for i in range(1, count + 1):
                made = u[i] * u[i] * v[i]
                rest = p["A"] - (p["B"] + 1.0) * u[i] if sign > 0 else p["B"] * u[i]
                rates.append(rest + sign * made + c * (own[i - 1] - 2.0 * own[i] + own[i + 1]))
        return rates

    def events(self, m: Any, t: Any, s: Sequence[Any], p: Any) -> list[Any]:
        """Half."""
        return [s[self.count // 2] - 0.5]


CASES: dict[str, StiffCase] = {
    case.__name__: case() for case in (RobertsonEarly, Robertson, VanDerPol, Oregonator, Hires, Ignition, Brusselator)
}


def radau(case: StiffCase, lanes: Lanes, rtol: float) -> tuple[np.ndarray, float]:
    """When each lane ends by scipy's Radau, and the seconds it took."""
    from scipy.integrate import solve_ivp

    begin, count = time.process_time(), len(lanes[case.wrt])
    t = np.full(count, np.nan)
    for i in range(count):
        p = {name: float(values[i]) for name, values in lanes.items()}

        def event(t: float, s: np.ndarray, p: Any = p) -> Any:
            return case.events(NUMPY, t, list(s), p)[0]

        event.direction, event.terminal = next(iter(case.directions.values())), True  # pyright: ignore[reportFunctionMemberAccess]
        end = solve_ivp(
            lambda t, s, p=p: case.rates(NUMPY, t, list(s), p),
            (0.0, case.t1),
            [float(s) for s in case.start(NUMPY, p)],
            method="Radau",
            rtol=rtol,
            atol=rtol * case.absolute,
            events=event,
        )
        if len(end.t_events[0]):
            t[i] = end.t_events[0][-1]
    return t, time.process_time() - begin


@functools.cache
def _problem(case: StiffCase) -> ode.Problem:
    return case.problem()


def ours(case: StiffCase, lanes: Lanes, rtol: float, order: int = 0, method: str = "rosenbrock") -> ode.Solution:
    """`ode.solve`."""
    wrt = case.wrt if order else ()
    return ode.solve(
        _problem(case), lanes, t1=case.t1, rtol=rtol, method=method, smooth=True, wrt=wrt, derivatives=order
    )


def timed(run: Callable[[], Any], lanes: int, rounds: int = 3) -> float:
    """Millionths of a second of processor time a lane: the least of some rounds, after one more."""
    run()
    found = []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        found.append(1e6 * (time.process_time() - begin) / lanes)
    return min(found)


def kvaerno(case: StiffCase, rtol: float) -> Callable[[Lanes], Any]:
    """Those of diffrax under jit and vmap."""
    import diffrax
    import optimistix as optx

    (direction,) = case.directions.values()

    def lane(p: Any) -> Any:
        end = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, _: jnp.stack([jnp.asarray(r) for r in case.rates(JAX, t, list(y), p)])),
            diffrax.Kvaerno5(),
            t0=0.0,
            t1=case.t1,
            dt0=None,
            y0=jnp.stack([jnp.asarray(s, float) for s in case.start(JAX, p)]),
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * case.absolute),
            event=diffrax.Event(
                lambda t, y, args, **_: case.events(JAX, t, list(y), p)[0],
                optx.Newton(1e-9, 1e-9),
                direction=None if direction == 0 else direction > 0,
            ),
            max_steps=20_000,
            throw=False,
        )
        assert end.ts is not None
        return end.ts[-1]

    program = jax.jit(jax.vmap(lane))
    return lambda lanes: jax.block_until_ready(program({name: jnp.asarray(v) for name, v in lanes.items()}))


def row_of(case: Any, rtol: float, lanes: Lanes, few: Lanes, true: np.ndarray, *, diffrax: bool) -> list[str]:
    """A line of the table."""
    count, size = len(true), len(next(iter(lanes.values())))
    found = ours(case, few, rtol)
    micro = [timed(functools.partial(ours, case, lanes, rtol, order), size) for order in range(2)]
    t, seconds = radau(case, few, rtol)
    errors = [np.nanmedian(np.abs(each / true - 1)) for each in (found.t, t)]
    row = [f"{case.name}, {rtol:.0e}", *(f"{each:.3g}" for each in (*micro, 1e6 * seconds / count))]
    row += [f"{error:.0e}" for error in errors]
    if diffrax:
        row.append(f"{timed(functools.partial(kvaerno(case, rtol), few), count, 1):.3g}")
    return row


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lanes", type=int, default=2000)
    parser.add_argument("--true", type=int, default=8, help="lanes that scipy computes")
    parser.add_argument("--diffrax", action="store_true")
    parser.add_argument("cases", nargs="*", default=list(CASES))
    given = parser.parse_args()
    rows = []
    for name in given.cases:
        case = CASES[name]
        lanes = case.sample(given.lanes, np.random.default_rng(34))
        few = {key: values[: given.true] for key, values in lanes.items()}
        true, _ = radau(case, few, 1e-12)
        for rtol in _TOLERANCES:
            rows.append(row_of(case, rtol, lanes, few, true, diffrax=given.diffrax))
            print("  ".join(rows[-1]), flush=True)
    head = ["problem", "t", "t, t′", "Radau", "error", "of Radau", "Kvaerno5"]
    print(table_text(" | ".join(head[: len(rows[0])]), rows))


if __name__ == "__main__":
    main()
