"""Do intervals of predictions hold laws that no model of the package is? `python -m benchmarks.coverage`, minutes.

Ten laws of cutting and deformation [mg/kg], five to tune the method on and five to report. Each makes 20 data sets of
its own: angles, speeds' ratios, repeats and errors as laboratories have them. A prediction is asked for the mean, never
for a weighing.
"""

import argparse
import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

import erosion
from erosion import ErrorModel

FASTEST = 98.0  # m/s
ERROR = ErrorModel(0.3e-6, 0.08)  # 0.3 mg/kg + 8 %
ASKED = (1.25, 2.0)  # speeds, over the fastest
CASE = erosion.TABLE_1.to("si").replace(v0=FASTEST)
DENSITY = 8000.0

_Law = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _sin(degrees: np.ndarray) -> np.ndarray:
    return np.sin(np.deg2rad(degrees))


def _cos(degrees: np.ndarray) -> np.ndarray:
    return np.maximum(np.cos(np.deg2rad(degrees)), 0.0)


def _law(height: float, cut: Callable[[np.ndarray], np.ndarray], deformed: Callable[..., np.ndarray], n: float) -> _Law:
    """`height` times the cut over its greatest value, as (v/98)^n, and the deformation's part of the height."""
    top = float(cut(np.linspace(0.5, 90.0, 500)).max())
    return lambda degrees, v: height * (cut(degrees) / top * (v / FASTEST) ** n + deformed(degrees, v / FASTEST))


def _powers(a: float, b: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda degrees: _sin(degrees) ** a * _cos(degrees) ** b


def _bulk(share: float, q: float, n: float) -> Callable[..., np.ndarray]:
    return lambda degrees, v: share * _sin(degrees) ** q * v**n


def _above(share: float, threshold: float) -> Callable[..., np.ndarray]:
    """A threshold of the normal speed, over the fastest speed."""
    return lambda degrees, v: share * (np.maximum(v * _sin(degrees) - threshold, 0.0) / (1 - threshold)) ** 2


TUNED: Mapping[str, _Law] = {
    "narrow cut": _law(380.0, _powers(1.5, 2.4), _bulk(0.25, 3.0, 2.6), 2.6),
    "broad cut": _law(260.0, _powers(0.8, 1.3), _bulk(0.5, 1.6, 2.1), 2.1),
    "two exponents": _law(300.0, _powers(1.0, 2.0), _bulk(0.5, 2.0, 2.7), 2.0),
    "threshold": _law(420.0, _powers(1.1, 1.8), _above(0.5, 0.15), 2.3),
    "saturation": _law(220.0, lambda d: (1 - np.exp(-d / 12.0)) * _cos(d) ** 1.5, _bulk(0.4, 2.2, 2.4), 2.4),
}
REPORTED: Mapping[str, _Law] = {
    "usual cut": _law(350.0, _powers(1.2, 2.0), _bulk(0.4, 2.4, 2.5), 2.5),
    "hump": _law(300.0, lambda d: np.exp(-0.5 * ((d - 27.0) / 14.0) ** 2) * _sin(d), _bulk(0.45, 2.0, 2.3), 2.3),
    "normal speed": _law(240.0, _powers(0.7, 2.2), _bulk(0.55, 2.7, 2.7), 2.2),
    "long tail": _law(400.0, lambda d: _sin(d) / (1 + (d / 25.0) ** 2) * _cos(d) ** 0.5, _bulk(0.3, 1.8, 2.0), 2.0),
    "kink": _law(320.0, lambda d: np.minimum(d / 22.0, 1.0) * _cos(d) ** 1.7, _bulk(0.35, 2.5, 2.7), 2.7),
}


def _of_package(k: float, psi: float, energy_ratio: float) -> _Law:
    """A model of the package, which is right."""
    model = erosion.load_model("linearized-deformation").replace(energy_ratio=energy_ratio)

    def law(degrees: np.ndarray, v: np.ndarray) -> np.ndarray:
        p = CASE.replace(alpha=np.deg2rad(degrees), v0=np.asarray(v, float), k=k, psi=psi)
        return 1e6 * DENSITY / float(CASE.m) * np.asarray(erosion.impact(model, p).volume)

    return law


RIGHT: Mapping[str, _Law] = {
    "right, steep": _of_package(2.6, 0.35, 1.4),
    "right, usual": _of_package(2.0, 0.4, 2.0),
    "right, flat": _of_package(1.3, 0.5, 2.8),
}
LAWS = {"tuned": TUNED, "reported": REPORTED, "right": RIGHT}

DESIGNS: Mapping[str, tuple[Sequence[float], int]] = {
    "10 angles, 2 repeats": ((10, 15, 20, 25, 30, 40, 50, 60, 75, 90), 2),
    "6 angles": ((10, 20, 30, 45, 65, 90), 1),
    "10 angles from 20° to 80°": ((20, 25, 30, 35, 40, 45, 50, 60, 70, 80), 1),
    "6 angles from 20° to 80°": ((20, 30, 40, 50, 65, 80), 1),
}
"""Angles [°] at two speeds, and how often each is tested."""
RATIOS = (1.4, 1.6, 2.0)  # of the two speeds


class Tests(NamedTuple):
    """A data set and what is asked of it.

    Args:
        design: its name.
        table: columns for `erosion.posterior`.
        asked: by place, angles [°] and speeds [m/s].
    """

    design: str
    table: Mapping[str, np.ndarray]
    asked: Mapping[str, tuple[np.ndarray, np.ndarray]]


def made_up(law: _Law, index: int, key: int, common: float = 0.0) -> Tests:
    """The data set `index` of a law, whose number is `key`; all rows of a speed are off together by a share."""
    rng = np.random.default_rng([38, key, index])
    design = [*DESIGNS][index % len(DESIGNS)]
    angles, repeats = DESIGNS[design]
    slow = FASTEST / RATIOS[index // len(DESIGNS) % len(RATIOS)]
    degrees, speeds = (part.ravel() for part in np.meshgrid(np.repeat(angles, repeats), (slow, FASTEST)))
    true = law(degrees, speeds)
    measured = np.maximum(true + rng.standard_normal(true.size) * np.hypot(0.3, 0.08 * true), 0.3)
    measured *= 1 + common * rng.standard_normal(2)[(speeds == FASTEST).astype(int)]
    inside = np.array((12.0, 22.0, 35.0, 55.0, 80.0) if angles[0] == 10 else (22.0, 35.0, 48.0, 55.0, 75.0))
    between = slow + (FASTEST - slow) * np.array([0.25, 0.8])
    asked = {"inside": (np.tile(inside, 2), np.repeat(between, len(inside)))}
    asked |= {f"{factor} × the fastest": (inside, np.full(inside.shape, factor * FASTEST)) for factor in ASKED}
    if angles[0] == 20:
        asked |= {f"at {end}°": (np.full(2, float(end)), np.array([between[0], FASTEST])) for end in (10, 90)}
    table = {"angle [deg]": degrees, "speed [m/s]": speeds, "mass_loss [mg/kg]": measured}
    return Tests(design, table, asked)


class Outcome(NamedTuple):
    """What intervals of 95 % did.

    Args:
        held: whether each holds the law, by place.
        width: over the law, by place.
    """

    held: Mapping[str, np.ndarray]
    width: Mapping[str, np.ndarray]


def outcome(law: _Law, tests: Tests, predict: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Outcome:
    """Of a method that gives draws of the mean [mg/kg], shape (draws, questions)."""
    held, width = {}, {}
    for place, (degrees, speeds) in tests.asked.items():
        low, high = np.quantile(predict(degrees, speeds), [0.025, 0.975], axis=0)
        true = law(degrees, speeds)
        held[place], width[place] = (low <= true) & (true <= high), (high - low) / true
    return Outcome(held, width)


def drawn(
    tests: Tests, model: str, free: Sequence[str], error: ErrorModel = ERROR, **options: Any
) -> erosion.Posterior:
    """The posterior of a data set."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erosion.ConvergenceWarning)
        return erosion.posterior(model, CASE, tests.table, free, density=DENSITY, error=error, **options)


def in_milligrams(posterior: erosion.Posterior, **options: Any) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Its predictions [mg/kg] at angles [°] and speeds [m/s]."""
    return lambda degrees, speeds: 1e6 * posterior.predict(np.deg2rad(degrees), {"v0": speeds}, 2000, **options)


def report(name: str, outcomes: Sequence[Outcome], seconds: float) -> None:
    """A line of how many intervals hold, and how wide they are."""
    places = dict.fromkeys(place for one in outcomes for place in one.held)
    cells = []
    for place in places:
        held = np.concatenate([one.held[place] for one in outcomes if place in one.held])
        width = np.concatenate([one.width[place] for one in outcomes if place in one.width])
        cells.append(f"{place}: {held.mean():.1%} of {held.size}, {np.median(width):.0%} wide")
    print(f"{name} ({len(outcomes)} sets, {seconds / len(outcomes):.1f} s each): {'; '.join(cells)}", flush=True)


def main() -> None:
    """Print a line for each law and method, and for all laws together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20, help="of each law")
    parser.add_argument("--laws", choices=tuple(LAWS), default="reported")
    parser.add_argument("--draws", type=int, default=150, help="of each population")
    parser.add_argument("--model", default="linearized-deformation")
    parser.add_argument("--free", default="k,psi,energy_ratio")
    parser.add_argument("--common", type=float, default=0.0, help="error that the rows of a speed share, such as 0.05")
    arguments = parser.parse_args()
    laws, free = LAWS[arguments.laws], arguments.free.split(",")
    first = sum(len(of) for of in [*LAWS.values()][: [*LAWS].index(arguments.laws)])
    stated = {"": dataclasses.replace(ERROR, common=arguments.common)}
    stated |= {", without the error of each speed": ERROR} if arguments.common else {}
    kinds = {"averaged": True, "without discrepancy": False}
    everything: dict[str, list[Outcome]] = {kind + said: [] for said in stated for kind in kinds}
    begun = time.perf_counter()
    for key, (name, law) in enumerate(laws.items(), start=first):
        since, of_law = time.perf_counter(), {kind: [] for kind in everything}
        for index in range(arguments.sets):
            tests = made_up(law, index, key, arguments.common)
            for said, error in stated.items():
                posterior = drawn(tests, arguments.model, free, error, draws=arguments.draws)
                for kind, discrepancy in kinds.items():
                    predict = in_milligrams(posterior, discrepancy=discrepancy)
                    of_law[kind + said].append(outcome(law, tests, predict))
        for kind, outcomes in of_law.items():
            everything[kind] += outcomes
            report(f"{name}, {kind}", outcomes, time.perf_counter() - since)
    for kind, outcomes in everything.items():
        report(f"all {arguments.laws} laws, {kind}", outcomes, time.perf_counter() - begun)


if __name__ == "__main__":
    main()
