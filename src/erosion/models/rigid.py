"""The rigid particle and the models made of it, with the exact solutions of those whose tip depth ignores the turn.

    m ẍ = F_x,   m ÿ = F_y,   I φ̈ = τ        (Laverty (2), (3), (11))

A new model is one new part, a few lines long. With constant K = k the depth is y = (v₀ sin α/ω) sin ωt,
ω² = k c/m, and the tip's horizontal velocity, whether it turns or not, is

    ẋ_tip = v₀ [u - (sin α/P) (1 - cos ωt)].

`linearized` has u = cos α and P = k; `finnie` has u = cos α + r φ̇₀/v₀ and
P = k/(1 + 1/β), because the torque slows the tip as well.
"""

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from erosion.arguments import Broadcast, ModelState, Scalar
from erosion.models.base import (
    NO_CUT,
    ZERO,
    ClosedForm,
    CuttingModel,
    Events,
    SameMotion,
    Scales,
    State,
    Tip,
    own_parameter,
)
from erosion.models.parts import (
    UPRIGHT,
    CentreOfMassTip,
    CircularTip,
    ConstantRatio,
    Deformation,
    ForceLaw,
    HorizontalTorque,
    NoDeformation,
    NoTorque,
    SmallAngleTip,
    TanAlpha,
    TipKinematics,
    Torque,
    VelocityAligned,
    sincos,
)
from erosion.ode.step_control import require_xla
from erosion.parameters import Parameters
from erosion.results import Finding

SPEED_EXPONENT = "speed_exponent"
"""The own parameter of `SpeedExponent`."""
_REFERENCE = 100.0  # m/s, where an exponent of the speed changes nothing
_Method = TypeVar("_Method", bound=Callable[..., Broadcast | State | Events])


def _traced_once(method: _Method) -> _Method:
    """The method as one program: `jax.jit`, with the method's signature left as it is."""
    program = jax.jit(method)

    @functools.wraps(method)
    def call(*arguments: Any, **named: Any) -> Any:
        require_xla()
        return program(*arguments, **named)

    return cast(_Method, call)


class SineCut(ClosedForm):
    """Constant force ratio and depth y: what `linearized` and `finnie` share."""

    @abc.abstractmethod
    def tip_ratio(self, p: Parameters) -> Broadcast:
        """P [-]."""

    @abc.abstractmethod
    def tip_speed(self, p: Parameters) -> Broadcast:
        """u, the tip's horizontal speed at contact over v₀ [-]."""

    @abc.abstractmethod
    def omega(self, vx: Broadcast, p: Parameters) -> Broadcast:
        """φ̇ when the centre of mass moves at `vx`."""

    @abc.abstractmethod
    def turn(self, t: Broadcast, x: Broadcast, p: Parameters) -> Broadcast:
        """φ - π/2 at time `t`, when the centre of mass is at `x`."""

    @_traced_once
    def state(self, t: Broadcast, p: Parameters) -> State:
        rate, sine = p.rate, jnp.sin(p.alpha)
        # 1 - cos ωt = 2 sin²(ωt/2), which keeps its digits for small ωt.
        vx = p.v0 * (jnp.cos(p.alpha) - sine / p.k * 2 * jnp.sin(rate * t / 2) ** 2)
        x = p.v0 * jnp.cos(p.alpha) * t - p.v0 * sine / p.k * (t - jnp.sin(rate * t) / rate)
        return State(
            x=x,
            y=p.v0 * sine / rate * jnp.sin(rate * t),
            phi=UPRIGHT + self.turn(t, x, p),
            vx=vx,
            vy=p.v0 * sine * jnp.cos(rate * t),
            omega=self.omega(vx, p),
        )

    @_traced_once
    def end_times(self, p: Parameters) -> Events:
        fall = self.tip_ratio(p) * self.tip_speed(p) / (2 * jnp.sin(p.alpha))
        stops = (fall >= 0) & (fall <= 1)
        # cos ωt = 1 - P u/sin α, as sin²(ωt/2) = P u/(2 sin α).
        stop = 2 / p.rate * jnp.arcsin(jnp.sqrt(jnp.where(stops, fall, 0.0)))
        return {"rebound": jnp.pi / p.rate + 0 * stop, "stop": jnp.where(stops, stop, jnp.nan)}

    @_traced_once
    def t_c(self, p: Parameters) -> Broadcast:
        times = self.end_times(p)
        return jnp.where(self.tip_speed(p) <= ZERO, 0.0, jnp.fmin(times["rebound"], times["stop"]))

    def ended_by(self, p: Parameters) -> np.ndarray:
        ends = np.where(np.asarray(self._rebounds(p)), "rebound", "stop")
        return np.where(np.asarray(self.tip_speed(p)) <= ZERO, NO_CUT, ends)

    @_traced_once
    def volume(self, p: Parameters) -> Broadcast:
        ratio, u, sine = self.tip_ratio(p), self.tip_speed(p), jnp.sin(p.alpha)
        return self._piecewise(p, 2 * u * sine - 2 / ratio * sine**2, ratio / 2 * u**2)

    @_traced_once
    def dvolume(self, p: Parameters) -> Broadcast:
        ratio, u, sine, cosine = self.tip_ratio(p), self.tip_speed(p), jnp.sin(p.alpha), jnp.cos(p.alpha)
        rebound = 2 * (u * cosine - sine**2) - 4 / ratio * sine * cosine
        return self._piecewise(p, rebound, -ratio * u * sine)

    @_traced_once
    def d2volume(self, p: Parameters) -> Broadcast:
        ratio, u, sine, cosine = self.tip_ratio(p), self.tip_speed(p), jnp.sin(p.alpha), jnp.cos(p.alpha)
        rebound = -2 * sine * (u + 3 * cosine) - 4 / ratio * (cosine**2 - sine**2)
        return self._piecewise(p, rebound, ratio * (sine**2 - u * cosine))

    @_traced_once
    def alpha_max(self, p: Parameters) -> Broadcast:
        """½ arctan P without spin; with spin the root of V′, by bisection to the last bit.

        V′ is positive as α → 0, negative where rebound gives way to stop and beyond, and
        has one root between.
        """
        spin = self.tip_speed(p) - jnp.cos(p.alpha)
        ratio = self.tip_ratio(p)
        low = jnp.zeros_like(spin + ratio)
        # sin α = (P/2)(cos α + s), as √(P²/4 + 1) cos(α + arctan(2/P)) = -s P/2.
        crossing = jnp.clip(-spin * ratio / 2 / jnp.sqrt(ratio**2 / 4 + 1), -1.0, 1.0)
        high = jnp.minimum(jnp.arccos(crossing) - jnp.arctan(2 / ratio), jnp.pi / 2)

        def halve(_: Scalar, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = bracket
            middle = (low + high) / 2
            rising = jnp.cos(2 * middle) + spin * jnp.cos(middle) > jnp.sin(2 * middle) / ratio
            return jnp.where(rising, middle, low), jnp.where(rising, high, middle)

        low, high = jax.lax.fori_loop(0, 64, halve, (low, high))
        best = jnp.where(spin == 0, jnp.arctan(ratio) / 2, (low + high) / 2)
        return jnp.where(spin <= -1, jnp.nan, best)

    def _rebounds(self, p: Parameters) -> Array:
        return jnp.sin(p.alpha) <= self.tip_ratio(p) / 2 * self.tip_speed(p)

    def _piecewise(self, p: Parameters, rebound: Broadcast, stop: Broadcast) -> Broadcast:
        value = p.volume_scale / p.k * jnp.where(self._rebounds(p), rebound, stop)
        return jnp.where(self.tip_speed(p) <= ZERO, 0.0, value)


class LinearizedCut(SineCut):
    """Laverty (22)-(25): V = (V*/k)[sin 2α - (2/k) sin²α] for tan α ≤ k/2, (V*/2) cos²α above."""

    def tip_ratio(self, p: Parameters) -> Broadcast:
        return p.k

    def tip_speed(self, p: Parameters) -> Broadcast:
        return jnp.cos(p.alpha)

    def omega(self, vx: Broadcast, p: Parameters) -> Broadcast:
        return p.phidot0 + 0 * vx

    def turn(self, t: Broadcast, x: Broadcast, p: Parameters) -> Broadcast:
        return 0 * x


class FinnieCut(SineCut):
    """Finnie 1958, for any β and spin; P = k/3 for β = ½ is his "6/k" form."""

    def tip_ratio(self, p: Parameters) -> Broadcast:
        return p.k / (1 + 1 / p.inertia)

    def tip_speed(self, p: Parameters) -> Broadcast:
        return jnp.cos(p.alpha) + p.spin

    def omega(self, vx: Broadcast, p: Parameters) -> Broadcast:
        # φ̇ - φ̇₀ = (ẋ - ẋ(0))/(β r), from I φ̈ = r m ẍ.
        return p.phidot0 + (vx - p.v0 * jnp.cos(p.alpha)) / (p.inertia * p.r)

    def turn(self, t: Broadcast, x: Broadcast, p: Parameters) -> Broadcast:
        return p.phidot0 * t + (x - p.v0 * jnp.cos(p.alpha) * t) / (p.inertia * p.r)


class StraightCut(ClosedForm):
    """K = tan α: motion on a straight line, ẋ = v₀ cos α cos ωt with ω² = c tan α/m.

    It always stops, at ωt = π/2, and V = (V*/2) cos²α only falls: no greatest angle.
    """

    @_traced_once
    def state(self, t: Broadcast, p: Parameters) -> State:
        rate = self._rate(p)
        along, speed = p.v0 * jnp.sin(rate * t) / rate, p.v0 * jnp.cos(rate * t)
        sine, cosine = jnp.sin(p.alpha), jnp.cos(p.alpha)
        spin = p.phidot0 + 0 * speed
        return State(along * cosine, along * sine, UPRIGHT + 0 * along, speed * cosine, speed * sine, spin)

    @_traced_once
    def end_times(self, p: Parameters) -> Events:
        rate = self._rate(p)
        return {"rebound": jnp.pi / rate, "stop": jnp.pi / 2 / rate}

    @_traced_once
    def t_c(self, p: Parameters) -> Broadcast:
        return jnp.where(jnp.cos(p.alpha) <= ZERO, 0.0, self.end_times(p)["stop"])

    def ended_by(self, p: Parameters) -> np.ndarray:
        return np.where(np.cos(np.asarray(p.alpha + 0 * p.v0)) <= ZERO, NO_CUT, "stop")

    @_traced_once
    def volume(self, p: Parameters) -> Broadcast:
        return p.volume_scale / 2 * jnp.cos(p.alpha) ** 2

    @_traced_once
    def dvolume(self, p: Parameters) -> Broadcast:
        return -p.volume_scale / 2 * jnp.sin(2 * p.alpha)

    @_traced_once
    def d2volume(self, p: Parameters) -> Broadcast:
        return -p.volume_scale * jnp.cos(2 * p.alpha)

    @_traced_once
    def alpha_max(self, p: Parameters) -> Broadcast:
        return jnp.nan * (p.alpha + p.v0)

    def _rate(self, p: Parameters) -> Broadcast:
        return jnp.sqrt(p.stiffness * jnp.tan(p.alpha) / p.m)


def with_deformation(cut: ClosedForm, deformation: Deformation) -> ClosedForm:
    """The cut's exact solution, with the volume that deformation removes."""
    return cut if isinstance(deformation, NoDeformation) else DeformingCut(cut, deformation)


class _SameCut(ClosedForm):
    """The motion of a cut whose exact solution is known, with other volumes."""

    cut: eqx.AbstractVar[ClosedForm]

    def state(self, t: Broadcast, p: Parameters) -> State:
        return self.cut.state(t, p)

    def end_times(self, p: Parameters) -> Events:
        return self.cut.end_times(p)

    def t_c(self, p: Parameters) -> Broadcast:
        return self.cut.t_c(p)

    def ended_by(self, p: Parameters) -> np.ndarray:
        return self.cut.ended_by(p)


class DeformingCut(_SameCut):
    """A cut, and wear by deformation: the motion is the cut's, the volumes add up.

    Args:
        cut: the exact solution of the cut alone.
        deformation: what deformation removes.
    """

    cut: ClosedForm
    deformation: Deformation

    def volume(self, p: Parameters) -> Broadcast:
        return self.cut.volume(p) + self._derivative(p, 0)

    def dvolume(self, p: Parameters) -> Broadcast:
        return self.cut.dvolume(p) + self._derivative(p, 1)

    def d2volume(self, p: Parameters) -> Broadcast:
        return self.cut.d2volume(p) + self._derivative(p, 2)

    def alpha_max(self, p: Parameters) -> Broadcast:
        """The root of V′ beside the greatest of volumes every tenth of a degree, by bisection to the last bit."""
        angles = np.deg2rad(np.arange(1, 900) / 10)
        shape = jnp.shape(p.volume_scale * p.k * p.inertia * p.spin)
        grid = p.replace(alpha=angles.reshape(-1, *[1] * len(shape)))
        volumes = np.asarray(jnp.broadcast_to(self.volume(grid), (len(angles), *shape)))
        best = np.argmax(volumes, axis=0)
        # Greatest at an end of the grid: it rises towards 0 or 90°.
        inside = (best > 0) & (best < len(angles) - 1)
        best = np.clip(best, 1, len(angles) - 2)
        low, high = angles[best - 1], angles[best + 1]
        for _ in range(64):
            middle = (low + high) / 2
            rising = np.asarray(self.dvolume(p.replace(alpha=middle))) > 0
            low, high = np.where(rising, middle, low), np.where(rising, high, middle)
        return np.where(inside, (low + high) / 2, np.nan)[()]

    def _derivative(self, p: Parameters, order: int) -> Broadcast:
        """V_D or its derivative by α."""
        alpha = jnp.asarray(p.alpha, float)

        def volume(alpha: Broadcast) -> Broadcast:
            return jnp.asarray(self.deformation.removed_at_contact(p.replace(alpha=alpha)), float)

        def slope(alpha: Broadcast) -> Broadcast:
            return jax.jvp(volume, (alpha,), (jnp.ones_like(alpha),))[1]

        if order == 2:
            return jax.jvp(slope, (alpha,), (jnp.ones_like(alpha),))[1]
        return slope(alpha) if order else volume(alpha)


class RigidParticle(CuttingModel):
    """Newton's law for a rigid body driven by the force at its tip; parts are fields."""

    kinematics: eqx.AbstractVar[TipKinematics]
    force: eqx.AbstractVar[ForceLaw]
    torque: eqx.AbstractVar[Torque]
    deformation: Deformation = eqx.field(default=NoDeformation(), kw_only=True)

    def initial_state(self, p: Parameters) -> State:
        sine, cosine = sincos(p.alpha)
        zero = jnp.zeros_like(sine)
        # Laverty (17), (19), (21): upright at the origin.
        return State(zero, zero, zero + UPRIGHT, p.v0 * cosine, p.v0 * sine, zero + p.phidot0)

    def derivative(self, state: State, p: Parameters) -> State:
        force = self.force(state, self.kinematics(state, p), p)
        if not isinstance(force, tuple | list) or len(force) != 2:
            given = f"{len(force)} of them" if isinstance(force, tuple | list) else "something else"
            raise TypeError(f"{type(self.force).__name__} must give two numbers, (F_x, F_y), but gives {given}")
        for number in force:
            # Numbers of Python and of JAX without a type of their own take that of what they are computed with.
            kind = np.float64 if getattr(number, "weak_type", False) else getattr(number, "dtype", np.float64)
            if kind != np.float64:
                raise TypeError(f"{type(self.force).__name__} must give numbers of type float64, but gives {kind}")
        return State(
            x=state.vx,
            y=state.vy,
            phi=state.omega,
            vx=force[0] / p.m,
            vy=force[1] / p.m,
            omega=self.torque(state, force, p) / p.moment_of_inertia,
        )

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.deformation.removed_at_contact(p)

    @property
    def removes_at_contact(self) -> bool:
        return not isinstance(self.deformation, NoDeformation)

    def tip(self, state: State, p: Parameters) -> Tip:
        return self.kinematics(state, p)

    def scales(self, p: Parameters) -> Scales:
        time = jnp.sqrt(p.m / (self.force.typical_ratio(p) * p.stiffness))
        return Scales(time, p.v0 * sincos(p.alpha)[0] * time)


class PrintedForce(ForceLaw):
    """F_x = -c (y - r sin φ), F_y = k F_x: it pushes the particle *forward* at contact."""

    def __call__(self, state: State, tip: Tip, p: Parameters) -> tuple[Broadcast, Broadcast]:
        horizontal = -p.stiffness * (state.y - p.r * sincos(state.phi)[0])
        return horizontal, p.k * horizontal

    def typical_ratio(self, p: Parameters) -> Broadcast:
        return p.k


class PrintedTorque(Torque):
    """τ = -r c y, from the depth of the centre of mass (Laverty (20))."""

    def __call__(self, state: State, force: tuple[Broadcast, Broadcast], p: Parameters) -> Broadcast:
        return -p.r * p.stiffness * state.y


class AsPrinted(RigidParticle):
    """The literal reading of Laverty (16)-(21), to show what it does; not for use.

    Events and volume are on the centre of mass. With φ(0) = π/2 the force is that of a
    depth -r at first contact, so the particle is first thrown forward and down, and the
    volume only falls with the angle.
    """

    kinematics: TipKinematics = CentreOfMassTip()
    force: ForceLaw = PrintedForce()
    torque: Torque = PrintedTorque()


class Linearized(RigidParticle):
    """The tip moves as the centre of mass: m ẍ = -c y, m ÿ = -K c y. The body does not turn, whatever its spin.

    Args:
        force: K, by default constant; `TanAlpha()` or `VelocityAligned()` for the additional
            questions 2 and 3, or any `ForceLaw`.

    References:
        Laverty (22)-(25). Differs from the source in the reason only: what stays small is
        φ - π/2, not φ.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = NoTorque()
    kinematics: TipKinematics = CentreOfMassTip()

    @property
    def _is_upright(self) -> bool:
        """Whether the body does not turn; with another torque or another tip it does."""
        return bool(self.torque == NoTorque() and self.kinematics == CentreOfMassTip())

    def derivative(self, state: State, p: Parameters) -> State:
        rates = super().derivative(state, p)
        return dataclasses.replace(rates, phi=0 * rates.phi) if self._is_upright else rates

    def closed_form(self) -> ClosedForm | None:
        if not self._is_upright:
            return None
        if type(self.force) is ConstantRatio:  # a class of a user's that derives from it may add a drag
            return with_deformation(LinearizedCut(), self.deformation)
        if type(self.force) in (TanAlpha, VelocityAligned):
            return with_deformation(StraightCut(), self.deformation)
        return None


class Finnie(RigidParticle):
    """The tip is at x + r (φ - π/2) and depth y; I φ̈ = r F_x slows it as it cuts.

    Args:
        force: K, by default constant.

    References:
        Finnie 1958; OpenFOAM's `ParticleErosion` is its closed form with β = ½.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = HorizontalTorque()
    kinematics: TipKinematics = SmallAngleTip()

    def closed_form(self) -> ClosedForm | None:
        parts = (self.force, self.torque, self.kinematics)
        known = parts == (ConstantRatio(), HorizontalTorque(), SmallAngleTip())
        return with_deformation(FinnieCut(), self.deformation) if known else None


class Rotating(RigidParticle):
    """The tip circles the centre of mass, and the contact force turns the body.

    m ẍ = -c d,  m ÿ = -K c d,  I φ̈ = τ,  d = y - r (1 - sin φ).

    Args:
        force: K, by default constant; `TanAlpha()` or `VelocityAligned()` for the additional
            questions 2 and 3, or any `ForceLaw`.
        torque: `HorizontalTorque()` (r F_x, the scenario's) or `FullTorque()`.

    References:
        Laverty (16)-(21). Differs from the source: the depth of the tip is y - r (1 - sin φ),
        not y - r sin φ; the torque uses that depth and has the sign of (20); the volume is
        cut by the tip's own path.
    """

    force: ForceLaw = ConstantRatio()
    torque: Torque = HorizontalTorque()
    kinematics: TipKinematics = CircularTip()


class SpeedExponent(SameMotion):
    """A model's cuts whose volumes grow faster with the speed: all of them times (v₀/100 m/s)^(n - 2).

    At 100 m/s, or with n = 2, it is the model itself. Without spin and threshold, `linearized` and `finnie` remove as
    v₀², models that turn nearly so; erosion of metals grows as v₀^2.6 by DNV and v₀^2.41 by E/CRC
    (`erosion.correlations`, which have exponents of their own). The model's own quantities are not carried over.

    Args:
        motion: any model.
        speed_exponent: n [-], ≥ 0.
    """

    motion: CuttingModel
    speed_exponent: float = own_parameter(2.4, "n", "exponent of the speed for volumes as v₀²", least=0.0)

    def factor(self, p: Parameters) -> Broadcast:
        """The factor on every volume [-]; NaN where n is negative, so that the impact fails."""
        return jnp.where(self.speed_exponent >= 0, (p.v0 / _REFERENCE) ** (self.speed_exponent - 2), jnp.nan)

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        return self.motion.removal_rate(state, p) * self.factor(p)

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        return self.motion.removed_at_contact(p) * self.factor(p)

    @property
    def removes_at_contact(self) -> bool:
        return self.motion.removes_at_contact

    def outside_of_range(self, p: Parameters, counted: np.ndarray | None = None) -> Finding | None:
        return self.motion.outside_of_range(p, counted)

    def closed_form(self) -> ClosedForm | None:
        cut = self.motion.closed_form()
        return None if cut is None else ScaledCut(cut, self)


class ScaledCut(_SameCut):
    """The exact solution of a model with an exponent of the speed: volumes times its factor.

    Args:
        cut: that of the model alone.
        by: the model with the exponent.
    """

    cut: ClosedForm
    by: SpeedExponent

    def volume(self, p: Parameters) -> Broadcast:
        return self.cut.volume(p) * self.by.factor(p)

    def dvolume(self, p: Parameters) -> Broadcast:
        return self.cut.dvolume(p) * self.by.factor(p)

    def d2volume(self, p: Parameters) -> Broadcast:
        return self.cut.d2volume(p) * self.by.factor(p)

    def alpha_max(self, p: Parameters) -> Broadcast:
        return self.cut.alpha_max(p)
