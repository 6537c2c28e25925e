"""Seven stiff problems with events, for the benchmarks of methods for them; written as those of `ode_problems`."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from benchmarks.ode_problems import Case, Lanes


class StiffCase(Case):
    """A stiff problem.

    Args:
        nominal: the numbers as published.
        spread: by which factors lanes differ from them.
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
