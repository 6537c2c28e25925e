"""Whether two integrations of lanes agree on their derivatives.

Where a derivative of a rate is infinite, is not defined, or is rounding alone, as the second one of √(v²) is near
v = 0, no estimate of an error holds. But two integrations, which step in different ways, then differ.
"""

from collections.abc import Sequence

import numpy as np

from erosion.arguments import PerLane
from erosion.ode.explicit import LEAST
from erosion.ode.variational import Derivatives, Layout

_AGREE = 1e-7, 1e-6  # of its size: as near are two values of a first derivative, and of a second one
_SMALL = 1e-3  # of what a value does by a number's own size: a smaller derivative need not be known relative to itself


def units_of(layout: Layout, numbers: Sequence[PerLane], direction: int | PerLane, lanes: int) -> np.ndarray:
    """The size of the number that a direction changes; 1 where it is zero. Shape (lanes,)."""
    sizes = zip(layout.sizes(numbers), layout.shapes, strict=True)
    columns = [np.broadcast_to(np.asarray(size), (lanes, *shape)).reshape(lanes, -1) for size, shape in sizes]
    unit = np.concatenate(columns, axis=1)[np.arange(lanes), np.asarray(direction, int)]
    return np.where(unit == 0, 1.0, unit)


def sizes_of(values: Sequence[np.ndarray], least: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The sizes of outputs; of the state, whose parts may be zero at an event, the greatest on the way."""
    greatest = [np.maximum(np.abs(value), part / LEAST) for value, part in zip(values, least, strict=False)]
    return [*greatest, *map(np.abs, values[len(least) :])]


def differ(
    one: Derivatives, two: Derivatives, sizes: Sequence[np.ndarray], units: tuple[np.ndarray, np.ndarray]
) -> list[list[np.ndarray]]:
    """For each quantity whether two integrations differ in its first derivatives, and in its second ones or those.

    Args:
        one: derivatives of quantities, lists; there may be no second ones.
        two: the same of another integration.
        sizes: of the quantities, arrays (lanes,).
        units: of both directions, see `units_of`.
    """
    unit, other = units
    found = []
    for i, size in enumerate(sizes):
        pairs = (one.first[i], two.first[i], size / unit), (one.other[i], two.other[i], size / other)
        first = np.logical_or(*(_differ(*pair, _AGREE[0]) for pair in pairs))
        second = []
        if one.second is not None:
            second = [first | _differ(one.second[i], two.second[i], size / (unit * other), _AGREE[1])]
        found.append([first, *second])
    return found


def _differ(one: np.ndarray, two: np.ndarray, size: np.ndarray, share: float) -> np.ndarray:
    with np.errstate(all="ignore"):
        return ~(np.abs(one - two) <= share * np.maximum(np.maximum(np.abs(one), np.abs(two)), _SMALL * size))
