"""Particles of a stream: from points of the unit cube to the parameters of impacts."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from erosion.joint_laws import LawSet, require_units
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import ranges, with_values
from erosion.parameters.parameters import Parameters
from erosion.parameters.ranges import STEEPEST


@dataclasses.dataclass(frozen=True)
class Particles:
    """Model and case, and the laws of their parameters; `draw` makes particles, `impacts` aims them.

    Where `r` varies, particles are scaled copies of the case's particle: b grows with r and m
    with r³, unless b and m have laws of their own.

    Angles need no cut-off. A particle at more than 90° comes from the other side: it is the
    mirror image of a particle at 180° - α with the opposite spin. A particle below 0° (or above
    180°) flies away from the surface and misses it.

    Args:
        model: the model of the cut.
        p: the case, all scalars.
        laws: parameter name, of the case or the model's own, to its `Distribution` from particle to particle; those of
            a joint law (`erosion.joint_laws`) all together.
        uncertain: the same for parameters that are one number for all particles, which is not known exactly.

    Raises:
        ValueError, TypeError: for laws that make no sense; there must be one of either kind.
    """

    model: CuttingModel
    p: Parameters
    laws: Mapping[str, Any]
    uncertain: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.all_laws:
            raise ValueError("Arguments must include a distribution, such as v0=Normal(4400, 400); there is none.")
        if both := [name for name in self.uncertain if name in self.laws]:
            raise ValueError(
                f"Argument `uncertain` must name parameters without another law, but {both[0]} has one from particle "
                "to particle."
            )
        if "cutting_fraction" in self.all_laws:
            raise ValueError(
                "Argument `uncertain` must leave out `cutting_fraction`: volumes of a stream are those of particles "
                "that cut, whose share is a number."
            )
        require_units(self.all_laws, self.p.units)
        # So that an own parameter that cannot be an array is refused before anything is computed.
        self.impacts(self._middle)

    @property
    def all_laws(self) -> dict[str, Any]:
        """The laws of all that varies or is uncertain, by parameter."""
        return {**self.laws, **self.uncertain}

    @functools.cached_property
    def _of_particle(self) -> LawSet:
        return LawSet(self.laws, ranges(self.model))

    @functools.cached_property
    def _of_all(self) -> LawSet:
        return LawSet(self.uncertain, ranges(self.model))

    @functools.cached_property
    def inputs(self) -> dict[tuple[str, ...], int]:
        """What varies independently of all else: the parameters of a law or a joint law, and its uniform numbers."""
        return self._of_particle.inputs | self._of_all.inputs

    @property
    def dimension(self) -> int:
        """How many uniform numbers a particle is made from."""
        return sum(self.inputs.values())

    def draw(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters that vary or are uncertain; each particle gets uncertain ones of its own.

        Args:
            points: in (0, 1), shape (…, dimension).

        Returns:
            Values by name, shape (…); the laws of positive parameters are restricted to x > 0.
        """
        own = self._of_particle.dimension
        return self._grown(self._of_particle.draw(points[..., :own]) | self._of_all.draw(points[..., own:]))

    def draw_apart(self, points: np.ndarray, draws: np.ndarray) -> dict[str, np.ndarray]:
        """The same particles for each draw of the uncertain parameters.

        Args:
            points: in (0, 1), shape (particles, those of the laws from particle to particle).
            draws: in (0, 1), shape (draws, those of the uncertain parameters).

        Returns:
            Values by name, whose shapes broadcast to (draws, particles).
        """
        return self._grown(self._of_particle.draw(points) | self._of_all.draw(draws[:, None]))

    @property
    def dimensions(self) -> tuple[int, int]:
        """How many uniform numbers the laws from particle to particle take, and the uncertain parameters."""
        return self._of_particle.dimension, self._of_all.dimension

    def _grown(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The same, with width and mass of scaled particles where the size varies."""
        if "r" in values:
            scaled = self.p.similar(values["r"] / float(self.p.r))
            for name in ("b", "m"):
                values.setdefault(name, np.asarray(getattr(scaled, name)))
        return values

    @property
    def nozzle(self) -> float:
        """The nozzle's angle [rad]: the median of the angles, or the case's."""
        laws = self.all_laws
        return float(laws["alpha"].ppf(np.array([0.5]))[0]) if "alpha" in laws else float(self.p.alpha)

    @property
    def typical(self) -> tuple[CuttingModel, Parameters]:
        """Model and case of one particle with each law at its median."""
        return self.impacts({name: value.reshape(()) for name, value in self._middle.items()})[:2]

    @property
    def _middle(self) -> dict[str, np.ndarray]:
        """One particle, each law at its median; shape (1,)."""
        return self._grown(self._of_particle.middle | self._of_all.middle)

    def impacts(
        self, values: Mapping[str, np.ndarray], nozzle: float | np.ndarray | None = None
    ) -> tuple[CuttingModel, Parameters, np.ndarray]:
        """The particles as impacts, and whether they hit the surface.

        Args:
            values: from `draw`.
            nozzle: turn the nozzle to this angle, or to several that broadcast against the
                particles [rad]; the deviations from it stay.

        Returns:
            Model, parameters in range, and the mask of the hits, of their shape. A miss gets an angle of 90°.
        """
        shape = np.broadcast_shapes(*(value.shape for value in values.values()))
        alpha = np.broadcast_to(values.get("alpha", np.asarray(self.p.alpha)), shape)
        if nozzle is not None:
            alpha = nozzle + (alpha - self.nozzle)
        hits = np.asarray((alpha > 0) & (alpha < np.pi))
        mirrored = alpha > STEEPEST
        folded = np.where(hits, np.where(mirrored, np.pi - alpha, alpha), STEEPEST)
        spin = values.get("phidot0", np.asarray(self.p.phidot0))
        changes = {**values, "alpha": folded, "phidot0": np.where(mirrored, -spin, spin)}
        return *with_values(self.model, self.p, changes), hits
