"""Particles of a stream: from points of the unit cube to the parameters of impacts."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from erosion.distributions import Distribution
from erosion.joint_laws import JointLaw, Member
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import quantities, with_values
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.parameters.ranges import STEEPEST

_POSITIVE = tuple(name for name in QUANTITIES if name not in ("alpha", "phidot0"))


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
        laws: parameter name, of the case or the model's own, to its `Distribution`, one or more; those of a joint law
            (`erosion.joint_laws`) all together. The range of an own parameter is not known here, so its law is not
            restricted.
    """

    model: CuttingModel
    p: Parameters
    laws: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.laws:
            raise ValueError("Arguments must include a distribution, such as v0=Normal(4400, 400); there is none.")
        parameters = quantities(self.model)
        for name, law in self.laws.items():
            if name not in parameters:
                raise TypeError(f"Argument `{name}` is not a parameter; they are {', '.join(parameters)}.")
            if not isinstance(law, Distribution):
                raise TypeError(f"Argument `{name}` must be a distribution such as Normal(1, 0.1), but is {law!r}.")
            if self._least_share(name) > 0.01:
                raise ValueError(
                    f"Argument `{name}` must be positive, but {self._least_share(name):.1%} of {law} is not."
                )
        for joint in self._joints:
            if missing := [name for name in joint if name not in self.laws]:
                raise ValueError(f"Arguments must include all of a joint law, but {missing[0]} is missing.")
        # So that an own parameter that cannot be an array is refused before anything is computed.
        self.impacts(self._middle)

    @functools.cached_property
    def _joints(self) -> list[JointLaw]:
        """The joint laws, each once."""
        joints = [law.joint for law in self.laws.values() if isinstance(law, Member)]
        return [joint for i, joint in enumerate(joints) if all(joint is not other for other in joints[:i])]

    @functools.cached_property
    def inputs(self) -> dict[tuple[str, ...], int]:
        """What varies independently of all else: the parameters of a law or a joint law, and its uniform numbers."""
        alone = {(name,): 1 for name, law in self.laws.items() if not isinstance(law, Member)}
        return alone | {tuple(joint): joint.dimension for joint in self._joints}

    @property
    def dimension(self) -> int:
        """How many uniform numbers a particle is made from."""
        return sum(self.inputs.values())

    def draw(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """The parameters that vary.

        Args:
            points: in (0, 1), shape (…, dimension).

        Returns:
            Values by name, shape (…); the laws of positive parameters are restricted to x > 0.
        """
        values = {}
        parts = np.split(points, np.cumsum([*self.inputs.values()])[:-1], axis=-1)
        joints = {tuple(joint): joint for joint in self._joints}
        for names, part in zip(self.inputs, parts, strict=True):
            least = {name: self._least_share(name) for name in names}
            if names in joints:
                values |= joints[names].draw(part, least)
            else:
                share = least[names[0]]
                values[names[0]] = self.laws[names[0]].ppf(share + (1 - share) * part[..., 0])
        return self._grown(values)

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
        return float(self.laws["alpha"].ppf(np.array([0.5]))[0]) if "alpha" in self.laws else float(self.p.alpha)

    @property
    def typical(self) -> tuple[CuttingModel, Parameters]:
        """Model and case of one particle with each law at its median."""
        return self.impacts({name: value.reshape(()) for name, value in self._middle.items()})[:2]

    @property
    def _middle(self) -> dict[str, np.ndarray]:
        """One particle, each law at its median; shape (1,)."""
        values = {}
        for name, law in self.laws.items():
            share = self._least_share(name)
            values[name] = law.ppf(np.array([share + (1 - share) * 0.5]))
        return self._grown(values)

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

    def _least_share(self, name: str) -> float:
        """The share of a law that lies below the parameter's range."""
        return self.laws[name].cdf(0.0) if name in _POSITIVE else 0.0
