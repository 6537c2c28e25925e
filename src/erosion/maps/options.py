"""How a map is made of a table; checked before anything is read."""

import dataclasses
from typing import Any

import numpy as np

from erosion.arguments import check_tolerance, check_whole
from erosion.maps.bodies import Bodies
from erosion.parameters.parameters import validate


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """The case, and how a map is made of it; see `erosion_map`.

    Raises:
        ValueError, TypeError: for an option that makes no sense.
    """

    bodies: Bodies
    restitution: tuple[float, float] | None = None
    density: float | None = None
    limit: float | None = None
    rtol: float = 1e-9

    def __post_init__(self) -> None:
        object.__setattr__(self, "rtol", check_tolerance(self.rtol))
        check_whole("seed", self.bodies.seed, 0)
        check_whole("draws", self.bodies.draws, 2)
        validate(self.bodies.p)
        numbers = {name: getattr(self, name) for name in ("density", "limit")}
        for name, value in {**numbers, "diameter": self.bodies.diameter}.items():
            if value is not None and not (isinstance(value, (int, float, np.number)) and 0 < value < np.inf):
                raise ValueError(f"Argument `{name}` must be positive and finite, but is {value!r}.")
        fraction = self.bodies.cutting_fraction
        if not (isinstance(fraction, (int, float, np.number)) and 0 < fraction <= 1):
            raise ValueError(f"Argument `cutting_fraction` must be above 0 and at most 1, but is {fraction!r}.")
        if self.restitution is not None:
            _check_restitution(self.restitution)


def _check_restitution(pair: Any) -> None:
    """Refuse what is no (e, μ)."""
    numbers = isinstance(pair, (tuple, list)) and all(isinstance(value, (int, float, np.number)) for value in pair)
    if not (numbers and len(pair) == 2 and 0 < pair[0] <= 1 and 0 <= pair[1] < 1):
        raise ValueError(
            "Argument `restitution` must be (e, μ) with e in (0, 1] and μ in [0, 1), as the wall of the CFD run has "
            f"them, but is {pair!r}."
        )
