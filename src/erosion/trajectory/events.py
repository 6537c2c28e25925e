"""Where a cut ends: the first fall of any event function through zero.

Looks at the ends of steps alone miss a function that dips below zero and returns; with the
rates known as well, the cubic between two looks shows the dip.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

_CLOSE = 4 * float(np.finfo(float).eps)  # of a time: nearer is the same
_NEWTON_STEPS = 60  # from a cubic's accuracy two or three suffice; a graze needs bisection


class Fall(NamedTuple):
    """An event, when it happens to a cubic's accuracy, and looks before and after that."""

    time: float
    low: float
    high: float
    name: str


def first_fall(t: np.ndarray, values: Mapping[str, np.ndarray], rates: Mapping[str, np.ndarray]) -> Fall | None:
    """The earliest fall through zero of several functions; None where none falls.

    Args:
        t: times of the looks, shape (looks,); close enough for a cubic between two of them.
        values: by name, the functions at these times; at the first one zero or positive.
        rates: their time derivatives.

    Raises:
        ArithmeticError: where a function is not finite.
    """
    first_falls: list[Fall] = []
    for name in values:
        value, rate = np.array(values[name]), rates[name]
        finite = np.isfinite(value) & np.isfinite(rate)
        if not np.all(finite):
            raise ArithmeticError(f"the motion is not finite after {t[max(np.argmin(finite) - 1, 0)]:g} s")
        value[0] = max(value[0], 0.0)
        falls = value[1:] <= 0
        # A dip between two looks: down at the first, up at the second.
        dips = (rate[:-1] < 0) & (rate[1:] > 0) & ~falls & (value[:-1] > 0)
        for i in np.flatnonzero(falls | dips):
            root = _first_root(t[i : i + 2], value[i : i + 2], rate[i : i + 2])
            if root is not None:
                first_falls.append(Fall(root, float(t[i]), float(t[i + 1]), name))
                break
    return min(first_falls, default=None)


def find_root(event: Callable[[float], tuple[float, float]], fall: Fall) -> float:
    """Where an event function, given with its rate, falls through zero: Newton within the bracket."""
    t, low, high = fall.time, fall.low, fall.high
    for _ in range(_NEWTON_STEPS):
        value, rate = event(t)
        low, high = (t, high) if value > 0 else (low, t)
        step = -value / rate if rate < 0 else np.inf
        # Asked first: a step below rounding may leave the bracket, which has closed to `t` by then.
        converged = abs(step) <= _CLOSE * t
        # A graze at its lowest point has no slope to follow.
        step = step if converged or low < t + step <= high else (low + high) / 2 - t
        t += step
        if converged or abs(step) <= _CLOSE * t:
            break
    return t


def _first_root(t: np.ndarray, values: np.ndarray, rates: np.ndarray) -> float | None:
    """Where the cubic through both ends first falls to zero after its start; None if it does not."""
    length = float(t[1] - t[0])
    from_, to, rise = length * rates[0], length * rates[1], values[1] - values[0]
    cubic = [from_ + to - 2 * rise, 3 * rise - 2 * from_ - to, from_, values[0]]
    # A start at zero (contact) is no fall: divide that root out.
    roots = np.roots(cubic[:3] if values[0] == 0 else cubic)
    real = [float(root.real) for root in roots if abs(root.imag) <= 1e-7 and 0 < root.real <= 1]
    if not real:
        return float(t[1]) if values[1] <= 0 else None
    return float(t[0]) + length * min(real)
