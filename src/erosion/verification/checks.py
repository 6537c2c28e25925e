"""The checks of one model: each gives the relative errors of some impacts."""

import functools
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from erosion.engine.impact import Impact, impact, pair_derivatives
from erosion.models import (
    CentreOfMassTip,
    ConstantRatio,
    FullTorque,
    HorizontalTorque,
    RigidErodent,
    TanAlpha,
    VelocityAligned,
)
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import quantities, sizes, values, with_values
from erosion.parameters.parameters import QUANTITIES, TABLE_1, Parameters
from erosion.parameters.units import conversion_factor
from erosion.trajectory.simulate import simulate
from erosion.trajectory.trajectory import Trajectory
from erosion.verification.witnesses import Witnessed, has_heyoka, heyoka_witness, scipy_of_model, scipy_witness

_RTOL = 1e-12
_STEP = 5e-4  # of differences, relative; their error goes as its fourth power
_SIMILAR = {"m": 3.0, "v0": 0.4, "sigma": 1.7, "b": 2.5, "psi": 0.6}
"""Factors of an impact similar to another; r and the spin follow from them."""


def cases() -> list[Parameters]:
    """The impacts: shallow, steep and spinning, away from the jumps of registered models."""
    spin = float(TABLE_1.v0 / TABLE_1.r)
    return [
        TABLE_1,
        TABLE_1.replace(alpha=0.08),
        TABLE_1.replace(alpha=0.95, phidot0=0.3 * spin),
        TABLE_1.replace(alpha=1.3, k=2.6),
        TABLE_1.replace(alpha=0.3, phidot0=-0.1 * spin, inertia=0.4, sigma=75e3),
        TABLE_1.replace(alpha=0.5, k=3.0, v0=2200.0, m=2e-7),
    ]


def _stacked(many: Sequence[Parameters]) -> Parameters:
    return many[0].replace(**{q: np.array([float(getattr(p, q)) for p in many]) for q in QUANTITIES})


class Subject:
    """A model under examination, with what several checks need computed once."""

    def __init__(self, name: str, model: CuttingModel, *, registered: bool) -> None:
        self.name, self.model, self.registered = name, model, registered
        self.cases = cases()
        self.others = [name for name in quantities(model) if name != "alpha"]

    def checks(self) -> dict[str, Callable[[], Iterable[Any]]]:
        """The checks that apply to the model: name to the errors of its cases."""
        found: dict[str, Callable[[], Iterable[Any]]] = {}
        if self.model.closed_form() is not None:
            found["closed form"] = self._closed_form
        found["engines"] = lambda: self._against([Witnessed(c.volume, c.t_c, c.ended_by) for c in self.cuts])
        if self.registered:
            found["scipy"] = lambda: self._against([scipy_witness(self.name, p) for p in self.cases])
            if has_heyoka():
                found["heyoka"] = lambda: self._against(heyoka_witness(self.name, self.cases))
            found["scaling"] = self._scaling
        else:
            found["scipy"] = lambda: self._against([scipy_of_model(self.model, p) for p in self.cases])
        found["identities"] = lambda: map(_identities, self.cuts)
        found["units"] = self._units
        found["dV/dα"] = lambda: self._slopes("alpha")[0]
        found["d²V/dα²"] = lambda: self._slopes("alpha")[1]
        # A program more, of twice the size, for the engine's own arithmetic: of registered models
        # one shows it. A plug-in's is unknown.
        if not self.registered or self.name == "rotating":
            found["∂V/∂q"] = lambda: np.max([self._slopes(q)[0] for q in self.others], axis=0)
            found["∂²V/∂α∂q"] = lambda: np.max([self._slopes(q)[1] for q in self.others], axis=0)
        return found

    def worst(self, errors: Iterable[Any]) -> tuple[float, str]:
        """The greatest of the cases' errors, and which case it is."""
        greatest = [_greatest(one) for one in errors]
        i = int(np.argmax(greatest))
        p = self.cases[i]
        return greatest[i], f"α = {np.rad2deg(float(p.alpha)):.4g}°, s = {float(p.spin):.2g}"

    @functools.cached_property
    def hits(self) -> Impact:
        """The cases in the batch, with V′ and V″."""
        return self._impact(self.cases)

    @functools.cached_property
    def cuts(self) -> list[Trajectory]:
        """The cases as trajectories."""
        return [simulate(self.model, p, points=3) for p in self.cases]

    def _impact(self, many: Sequence[Parameters], model: CuttingModel | None = None) -> Impact:
        return impact(model or self.model, _stacked(many), derivatives=2, rtol=_RTOL)

    def _closed_form(self) -> Iterator[list[Any]]:
        exact, hits = self.model.closed_form(), self.hits
        assert exact is not None
        for i, (p, cut) in enumerate(zip(self.cases, self.cuts, strict=True)):
            size = hits.volume[i]
            midway = jax.tree.map(
                lambda got, true, most: float(got - true) / np.max(np.abs(most)),
                cut.at(cut.t_c / 2), exact.state(cut.t_c / 2, p), jax.tree.map(lambda leaf: leaf + 1e-300, cut.states),
            )  # fmt: skip
            yield [
                _alike(hits.ended_by[i], str(exact.ended_by(p))),
                hits.t_c[i] / exact.t_c(p) - 1,
                (hits.volume[i] - exact.volume(p)) / size,
                (hits.dvolume[i] - exact.dvolume(p)) / max(size, abs(hits.dvolume[i])),
                (hits.d2volume[i] - exact.d2volume(p)) / max(size, abs(hits.d2volume[i])),
                *jax.tree.leaves(midway),
            ]

    def _against(self, others: Sequence[Witnessed]) -> list[list[Any]]:
        """The batch against another solution."""
        hits = self.hits
        return [
            [
                _alike(hits.ended_by[i], other.ended_by),
                _relative(hits.volume[i], other.volume),
                _relative(hits.t_c[i], other.t_c),
            ]
            for i, other in enumerate(others)
        ]

    def _scaling(self) -> list[list[Any]]:
        similar = self._impact([_similar(p) for p in self.cases])
        return self._beside(similar, similar.p.volume_scale / self.hits.p.volume_scale)

    def _units(self) -> list[list[Any]]:
        converted = [self.model.to("si", p) for p in self.cases]
        # The same model for all, as all cases are in one unit system.
        other = self._impact([p for _, p in converted], converted[0][0])
        return self._beside(other, conversion_factor("volume", self.cases[0].units, "si"))

    def _beside(self, other: Impact, factor: Any) -> list[list[Any]]:
        """Other impacts against the cases, whose volumes differ by a factor."""
        volumes = self.hits.volume * factor
        return [
            [_alike(self.hits.ended_by[i], other.ended_by[i]), _relative(other.volume[i], volume)]
            for i, volume in enumerate(volumes)
        ]

    @functools.cached_property
    def _mixed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        found = pair_derivatives(self.model, self.hits.p, [("alpha", q) for q in self.others], rtol=_RTOL).volume
        return {q: (found.other[:, j], found.second[:, j]) for j, q in enumerate(self.others)}

    def _slopes(self, q: str) -> list[np.ndarray]:
        """Errors of ∂V/∂q and ∂V′/∂q against central differences extrapolated to step 0 (Richardson)."""
        p, hits = self.hits.p, self.hits
        start, unit = values(self.model, p)[q], sizes(self.model, p)[q]

        def moved(share: float) -> Impact:
            model, there = with_values(self.model, p, {q: start + share * _STEP * unit})
            return impact(model, there, derivatives=2, rtol=_RTOL)

        exact = (hits.dvolume, hits.d2volume) if q == "alpha" else self._mixed[q]
        around = {share: moved(share) for share in (1.0, -1.0, 0.5, -0.5)}
        # Beside a kink or a jump there is no derivative to compare with.
        smooth = np.all([there.ended_by == hits.ended_by for there in around.values()], axis=0)
        errors = []
        for name, got in zip(("volume", "dvolume"), exact, strict=True):
            coarse, fine = (
                (getattr(around[share], name) - getattr(around[-share], name)) / (2 * share * _STEP * unit)
                for share in (1.0, 0.5)
            )
            size = np.maximum(np.maximum(hits.volume, np.abs(hits.dvolume)) / unit, np.abs(got))
            error = np.abs(got - (4 * fine - coarse) / 3)
            relative = np.where(error != 0, error / np.where(size > 0, size, 1.0), 0.0)
            # A check that compared nothing has shown nothing.
            errors.append(np.where(smooth, relative, 0.0) if smooth.any() else np.full_like(relative, np.nan))
        return errors


def _similar(p: Parameters) -> Parameters:
    """An impact with the same k, α, β, rω/v₀ and s, so that V/V* is the same."""
    other = p.replace(**{q: getattr(p, q) * factor for q, factor in _SIMILAR.items()})
    other = other.replace(r=p.r * (other.v0 / p.v0) * (p.rate / other.rate))
    return other.replace(phidot0=p.spin * other.v0 / other.r)


def _identities(cut: Trajectory) -> list[Any]:
    """What holds between beginning and end, or at every moment, without solving anything."""
    model, p = cut.model, cut.p
    errors = [*_tip_moves(model, cut)]
    if not isinstance(model, RigidErodent) or len(cut.t) < 2:
        return errors
    ratio = _constant_ratio(model, p)
    if isinstance(model.torque, HorizontalTorque):
        # φ̇ - φ̇₀ = (ẋ - ẋ(0))/(β r).
        change = (cut.vx[-1] - cut.vx[0]) / (p.inertia * p.r)
        errors.append((cut.omega[-1] - cut.omega[0] - change) / np.abs(change))
    if ratio is None:
        return errors
    # ẏ - ẏ(0) = K (ẋ - ẋ(0)).
    errors.append((cut.vy[-1] - cut.vy[0] - ratio * (cut.vx[-1] - cut.vx[0])) / p.v0)
    if isinstance(model.kinematics, CentreOfMassTip):
        # V = (m/2σψ)(ẋ(0)² - ẋ(t_c)²).
        errors.append(p.m / (2 * p.sigma * p.psi) * (cut.vx[0] ** 2 - cut.vx[-1] ** 2) / cut.volume - 1)
    if isinstance(model.torque, FullTorque):
        # V = (KE(0) - KE(t_c))/(σψ) - (K b/2) depth(t_c)².
        energy = p.m / 2 * (cut.vx**2 + cut.vy**2) + p.moment_of_inertia / 2 * cut.omega**2
        lost = (energy[0] - energy[-1]) / (p.sigma * p.psi) - ratio * p.b / 2 * cut.depth[-1] ** 2
        errors.append(lost / cut.volume - 1)
    return errors


def _constant_ratio(model: RigidErodent, p: Parameters) -> Any:
    """K, where the force is -c · depth (1, K) with the same K throughout the cut; else None."""
    if type(model.force) is ConstantRatio:
        return p.k
    # d(ẏ/ẋ)/dt = 0: the force that follows the velocity never turns it.
    return np.tan(p.alpha) if type(model.force) in (TanAlpha, VelocityAligned) else None


def _tip_moves(model: CuttingModel, cut: Trajectory) -> Iterator[Any]:
    """The tip's velocity is the rate of its position, midway."""
    p = cut.p
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf[len(leaf) // 2]), cut.states)
    rate = jax.tree.map(jnp.asarray, model.derivative(state, p))
    tip, flow = jax.jvp(lambda state: model.tip(state, p), (state,), (rate,))
    yield (flow.x - tip.vx) / p.v0
    yield (flow.depth - tip.vdepth) / p.v0


def _relative(got: Any, true: Any) -> Any:
    return 0.0 if got == true else got / true - 1


def _alike(one: str, other: str) -> float:
    return 0.0 if one == other else np.inf


def _greatest(errors: Any) -> float:
    """The greatest size; infinity where one is no number."""
    sizes = np.abs(np.asarray(jax.tree.map(float, errors) if isinstance(errors, list) else errors, float))
    return float(np.max(np.where(np.isnan(sizes), np.inf, sizes), initial=0.0))
