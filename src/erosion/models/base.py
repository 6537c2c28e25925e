"""The one pluggable interface: what a model must say about a cut.

A model says how a tip cuts. Everything else (trajectories, batches, derivatives, the best
angle, fits, plots) works for any model without knowing which one it is.
"""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Broadcast, Flag, ModelState
from erosion.models.own_parameters import check_least, converted, replaced
from erosion.output.tables import abbreviate
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import System

if TYPE_CHECKING:
    from erosion.ode.problem import Problem

Events = Mapping[str, Broadcast]
"""A number for each event, by its name."""


class State(eqx.Module):
    """The rigid body's motion: centre of mass and rotation, with their rates.

    x points along the surface and **y points down into the target**. φ is the angle of the
    line from the tip to the centre of mass, counter-clockwise; φ = π/2 is upright.

    Args:
        x, y: displacement of the centre of mass since contact [length].
        phi: orientation φ [rad].
        vx, vy: velocity of the centre of mass [speed].
        omega: φ̇ [rad/s].
    """

    x: Broadcast
    y: Broadcast
    phi: Broadcast
    vx: Broadcast
    vy: Broadcast
    omega: Broadcast

    def __repr__(self) -> str:
        parts = {name: getattr(self, name) for name in ("x", "y", "phi", "vx", "vy", "omega")}
        return f"State({', '.join(f'{name}={_shown(part)}' for name, part in parts.items())})"


def _shown(part: object) -> str:
    """A number or an array by its values; JAX also puts other things in a state's place."""
    return abbreviate(part) if isinstance(part, (float, int, np.ndarray, np.generic, jax.Array)) else repr(part)


class Tip(NamedTuple):
    """Where the cutting tip is and how it moves.

    Args:
        x: along the surface from the point of contact [length].
        depth: below the undisturbed surface [length], positive in the target.
        vx: dx/dt [speed].
        vdepth: d(depth)/dt [speed].
    """

    x: Broadcast
    depth: Broadcast
    vx: Broadcast
    vdepth: Broadcast


class Scales(NamedTuple):
    """Typical size of a cut, for first steps, absolute tolerances and event functions.

    Args:
        time: a fraction of the cut's duration [s].
        length: of the order of the greatest depth [length].
    """

    time: Broadcast
    length: Broadcast


class ClosedForm(eqx.Module):
    """The exact solution of a model that has one. Every method broadcasts over arrays.

    All are abstract: a closed form is complete or absent.
    """

    @abc.abstractmethod
    def state(self, t: Broadcast, p: Parameters) -> State:
        """The state at time `t` [s] since contact, for t up to `t_c`."""

    @abc.abstractmethod
    def end_times(self, p: Parameters) -> Events:
        """When each event alone would end the cut [s]; NaN where it never happens."""

    @abc.abstractmethod
    def t_c(self, p: Parameters) -> Broadcast:
        """When the cut ends [s]; 0 where nothing is cut."""

    @abc.abstractmethod
    def ended_by(self, p: Parameters) -> np.ndarray:
        """How the cut ends: "rebound", "stop" or "no-cut"."""

    @abc.abstractmethod
    def volume(self, p: Parameters) -> Broadcast:
        """Removed volume [volume]."""

    @abc.abstractmethod
    def dvolume(self, p: Parameters) -> Broadcast:
        """dV/dα [volume/rad]."""

    @abc.abstractmethod
    def d2volume(self, p: Parameters) -> Broadcast:
        """d²V/dα² [volume/rad²]."""

    @abc.abstractmethod
    def alpha_max(self, p: Parameters) -> Broadcast:
        """The angle in (0, π/2) where V is greatest [rad]; NaN where there is none."""


class CuttingModel(eqx.Module):
    """How a tip cuts: initial state, motion, tip. Subclass it (or, shorter, `RigidErodent`).

    A model is autonomous (its motion depends on the state alone) and written for **one**
    impact with `jax.numpy`; the engines batch and differentiate it. `initial_state`,
    `derivative` and `tip` must be given. `events`, `removal_rate`, `removed_at_contact`,
    `outside_of_range`, `scales` and `closed_form` have the defaults that the physics of most models shares, and are
    the only implemented methods a model may replace.

    The state may be any pytree of scalars; `State` serves a rigid body.
    """

    @abc.abstractmethod
    def initial_state(self, p: Parameters) -> ModelState:
        """The state at first contact."""

    @abc.abstractmethod
    def derivative(self, state: ModelState, p: Parameters) -> ModelState:
        """d(state)/dt, a pytree of the state's own structure."""

    @abc.abstractmethod
    def tip(self, state: ModelState, p: Parameters) -> Tip:
        """The cutting tip's position and velocity in this state."""

    def events(self, state: ModelState, p: Parameters) -> Events:
        """What ends a cut: by name, a smooth function that is positive while cutting.

        The functions are dimensionless and of order 1. The cut ends when the first of them
        falls through zero. By default **rebound** (the tip's depth returns to 0) and
        **stop** (its horizontal velocity reaches 0). Where one is negative at contact, or
        is zero there and does not rise, nothing is cut.
        """
        tip = self.tip(state, p)
        return {"rebound": tip.depth / self.scales(p).length, "stop": tip.vx / p.v0}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        """dV/dt [volume/s], by default b · depth · ẋ_tip (Laverty (27), at the tip)."""
        tip = self.tip(state, p)
        return p.b * tip.depth * tip.vx

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        """What the impact removes beside the cut [volume], by default nothing; see `erosion.models.parts`.

        It counts for every impact, for one that cuts nothing too.
        """
        return 0.0

    @property
    def removes_at_contact(self) -> bool:
        """Whether any impact removes something at contact; by default, whether the model says how much."""
        return type(self).removed_at_contact is not CuttingModel.removed_at_contact

    def outside_of_range(self, p: Parameters, counted: np.ndarray | None = None) -> str | None:
        """A sentence on the impacts outside of the range that the model is made for, by default none.

        Args:
            p: of one impact, or arrays that broadcast; the model's own parameters may be arrays as well.
            counted: which impacts count, of the broadcast shape; all of them without it.
        """
        return None

    def scales(self, p: Parameters) -> Scales:
        """Typical time and depth, by default 1/ω and v₀ sin α/ω with ω = √(k c/m)."""
        return Scales(1 / p.rate, p.v0 * jnp.sin(p.alpha) / p.rate)

    def closed_form(self) -> ClosedForm | None:
        """The exact solution, if there is one."""
        return None

    def problem(self) -> "Problem":
        """The cut as a problem of `erosion.ode`, whose arguments are the parameters of a case.

        So it can be changed, as by an event that the body survives, and solved by `erosion.ode.solve`:

            end = ode.solve(model.problem(), p, start="end", wrt="alpha")
            end.integrals["volume"], end.y.omega

        `start="end"` says that an impact which cuts nothing ends at its start; `ended_by` is then "start" for
        "no-cut". The model's own numbers are part of the problem.
        """
        from erosion.models.equations import problem_of

        return problem_of(self)

    @property
    def needs_units(self) -> bool:
        """Whether the model has numbers in fixed units, such as m/s, so that it must know `p.units`.

        By default not: the physics depends on no unit system, and `p.units` says nothing within a model's methods.
        """
        return False

    def replace(self, **changes: object) -> "CuttingModel":
        """The same model with other values of its own parameters: `model.replace(friction=0.3)`.

        A model's own parameters are its fields, and those of its parts, that hold one real number;
        where two have the same name, `**{"force.rate": 1.0, "torque.rate": 2.0}`. An array holds a number
        for each of many impacts, and broadcasts with the parameters of the case.

        Raises:
            TypeError, ValueError: for a name that is none of them, or a value that is no finite number or
                below the least one.
                NaN or infinity in an array is no error: it is an impact that fails.
        """
        check_least(self, changes)
        return replaced(self, changes)

    def to(self, units: str, p: Parameters) -> tuple["CuttingModel", Parameters]:
        """Model and case in another unit system: `model, p = model.to("si", p)`.

        A model knows no unit system: its own parameters are in the units of the case, and those
        declared with a dimension (see `own_parameter`) are converted with it. `p.to` converts the case alone.

        Args:
            units: "inch-pound" or "si".
            p: the case, in the units of the model's present values.

        Returns:
            The model and the case of the same impact.
        """
        return converted(self, p, units)


def units_within(model: CuttingModel, p: Parameters) -> System:
    """The `p.units` that a model's methods see; the same for all cases where it does not count."""
    return p.units if model.needs_units else "inch-pound"


def event_rates(model: CuttingModel, state: ModelState, rate: ModelState, p: Parameters) -> tuple[Events, Events]:
    """The event functions in a state, and their time derivatives along `rate` = d(state)/dt."""
    return jax.jvp(lambda s: model.events(s, p), (state,), (rate,))


def cuts_at_all(model: CuttingModel, p: Parameters) -> Flag:
    """Whether an impact starts to cut: every event function is positive or rises from zero."""
    state = model.initial_state(p)
    values, rates = event_rates(model, state, model.derivative(state, p), p)
    time = model.scales(p).time
    begins = jnp.asarray(True)
    for name, value in values.items():
        rises = (jnp.abs(value) <= ZERO) & (rates[name] * time > ZERO)
        begins = begins & ((value > ZERO) | rises)
    return begins


NO_CUT = "no-cut"
"""What `ended_by` says of an impact that cuts nothing."""

ZERO = 1e-15
"""Event functions below this are zero at contact: cos(π/2) is 6e-17 in floating point."""
