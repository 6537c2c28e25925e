"""The one pluggable interface: what a model must say about a cut, and the parameters that a model has of its own.

A model says how a tip cuts. Everything else (trajectories, batches, derivatives, the best
angle, fits, plots) works for any model without knowing which one it is.

A model's own parameters are numbers that are fields of the model, known by name as those of a case
are: whatever takes the name of a parameter takes that of a model's own as well. Here is what the name
means: which leaf of the model it is, what it is called, and the same model with another value.
"""

import abc
import dataclasses
import functools
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple, TypeGuard, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from erosion.arguments import Broadcast, Flag, ModelState, Number, check_scalars, check_unmasked
from erosion.ode.problem import Event, Problem, Rate
from erosion.output import abbreviate, briefly
from erosion.parameters import (
    QUANTITIES,
    RESULTS,
    TABLE_1,
    Parameters,
    Quantity,
    System,
    about,
    read_dimension,
    require_concrete,
    require_parameters,
)
from erosion.results import Finding

Events = Mapping[str, Broadcast]
"""A number for each event, by its name."""


class State(eqx.Module):
    """The rigid body's motion: centre of mass and rotation, with their rates.

    x points along the surface and **y points down into the target**. φ is the angle of the
    line from the tip to the centre of mass, counter-clockwise; φ = π/2 is upright.

    Args:
        x, y: displacement of the centre of mass since contact [m].
        phi: orientation φ [rad].
        vx, vy: velocity of the centre of mass [m/s].
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
    """Place and velocity of the cutting tip.

    Args:
        x: along the surface from the point of contact [m].
        depth: below the undisturbed surface [m], positive in the target.
        vx: dx/dt [m/s].
        vdepth: d(depth)/dt [m/s].
    """

    x: Broadcast
    depth: Broadcast
    vx: Broadcast
    vdepth: Broadcast


class Scales(NamedTuple):
    """Typical size of a cut, for first steps, absolute tolerances and event functions.

    Args:
        time: a fraction of the cut's duration [s].
        length: of the order of the greatest depth [m].
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
        """Removed volume [m³]."""

    @abc.abstractmethod
    def dvolume(self, p: Parameters) -> Broadcast:
        """dV/dα [m³/rad]."""

    @abc.abstractmethod
    def d2volume(self, p: Parameters) -> Broadcast:
        """d²V/dα² [m³/rad²]."""

    @abc.abstractmethod
    def alpha_max(self, p: Parameters) -> Broadcast:
        """The angle in (0, π/2) where V is greatest [rad]; NaN where there is none."""


class CuttingModel(eqx.Module):
    """How a tip cuts: initial state, motion, tip. Subclass it (or, shorter, `RigidParticle`).

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
        """Events that end a cut: by name, a smooth function that is positive while cutting.

        The functions are dimensionless and of order 1. The cut ends when the first of them
        falls through zero. By default **rebound** (the tip's depth returns to 0) and
        **stop** (its horizontal velocity reaches 0). Where one is negative at contact, or
        is zero there and does not rise, nothing is cut.
        """
        tip = self.tip(state, p)
        return {"rebound": tip.depth / self.scales(p).length, "stop": tip.vx / p.v0}

    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        """dV/dt [m³/s], by default b · depth · ẋ_tip (Laverty (27), at the tip)."""
        tip = self.tip(state, p)
        return p.b * tip.depth * tip.vx

    def removed_at_contact(self, p: Parameters) -> Broadcast:
        """The volume that the impact removes beside the cut, by default zero; see `erosion.models.parts`.

        It counts for every impact, for one that cuts nothing too.
        """
        return 0.0

    @property
    def removes_at_contact(self) -> bool:
        """Whether any impact removes something at contact; by default, whether the model says how much."""
        return type(self).removed_at_contact is not CuttingModel.removed_at_contact

    def outside_of_range(self, p: Parameters, counted: np.ndarray | None = None) -> Finding | None:
        """The finding on the impacts outside of the range that the model is made for, by default none.

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

    def problem(self) -> Problem:
        """The cut as a problem of `erosion.ode`, whose arguments are the parameters of a case.

        So it can be changed, as by an event that the body survives, and solved by `erosion.ode.solve`:

            end = ode.solve(model.problem(), p, start="end", wrt="alpha")
            end.integrals["volume"], end.y.omega

        `start="end"` says that an impact which cuts nothing ends at its start; `ended_by` is then "start" for
        "no-cut". The model's own numbers are part of the problem.
        """
        own = own_quantities(type(self))
        names = jax.eval_shape(lambda p: self.events(self.initial_state(p), p), TABLE_1)

        def of(name: str) -> Rate:
            return lambda t, state, p: getattr(self, name)(state, p)

        return Problem(
            y0=lambda p: self.initial_state(p),
            vector_field=of("derivative"),
            events={
                name: Event(lambda t, state, p, name=name: self.events(state, p)[name], direction=-1)
                for name in sorted(names)
            },
            integrals={"volume": of("removal_rate"), **{name: of(name) for name in own}},
            integrals0=lambda p: {"volume": self.removed_at_contact(p), **dict.fromkeys(own, 0.0)},
            time_scale=lambda p: self.scales(p).time,
            parameter_scale=typical_parameters,
        )

    def replace(self, **changes: object) -> "CuttingModel":
        """Return the model with other values of its own parameters: `model.replace(friction=0.3)`.

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


class SameMotion(CuttingModel):
    """A model's motion with another integrand, `removal_rate`."""

    motion: eqx.AbstractVar[CuttingModel]

    def initial_state(self, p: Parameters) -> ModelState:
        return self.motion.initial_state(p)

    def derivative(self, state: ModelState, p: Parameters) -> ModelState:
        return self.motion.derivative(state, p)

    def tip(self, state: ModelState, p: Parameters) -> Tip:
        return self.motion.tip(state, p)

    def events(self, state: ModelState, p: Parameters) -> Events:
        return self.motion.events(state, p)

    def scales(self, p: Parameters) -> Scales:
        return self.motion.scales(p)

    @abc.abstractmethod
    def removal_rate(self, state: ModelState, p: Parameters) -> Broadcast:
        """The integrand."""


def typical_parameters(p: Parameters) -> Parameters:
    """One radian and the spin v₀/r; of all others their own size."""
    return p.replace(alpha=1.0, phidot0=p.v0 / p.r)


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


_Model = TypeVar("_Model", bound=eqx.Module)
_Method = TypeVar("_Method", bound=Callable[..., Any])
_QUANTITY = "_own_quantity"  # the attribute of a method that is declared as a rate


class OwnParameter(NamedTuple):
    """One of a model's own parameters.

    Args:
        path: the fields that lead to it: ("force", "friction").
        leaf: its place among the leaves of the model.
        value: the model's number, or JAX's tracer for it.
        quantity: symbol, meaning and dimension.
        least: the least value that it may have.
        is_declared: whether its field is said to hold a number, and so may hold an array of them.
    """

    path: tuple[str, ...]
    leaf: int
    value: Number
    quantity: Quantity
    least: float
    is_declared: bool


def own_parameter(default: float, symbol: str, meaning: str, dimension: str = "1", *, least: float = -math.inf) -> Any:
    """Declare a field of a model, or of its parts, with what it is called in tables and on axes.

        friction: float = erosion.own_parameter(0.2, "μ", "coefficient of friction")

    A field that is a number by default is one of the model's own parameters without it too, under
    its name alone and without a unit.

    Args:
        default: the value of a model made without another.
        symbol: "μ".
        meaning: "coefficient of friction".
        dimension: "1", "length", "rate", …, or made of them, "mass/time" or "M/T"; the value is in SI.
        least: the least value; `CuttingModel.replace` and the commands refuse a smaller one. In an array it
            passes, and the model must make that impact fail by a NaN.
    """
    return eqx.field(default=default, metadata={"quantity": _declared(symbol, meaning, dimension), "least": least})


def fixed_parameter(default: float, symbol: str, meaning: str, unit: str) -> Any:
    """The same for a number that is shown in one unit, "kg/m^3", whatever the units of the case."""
    quantity = Quantity(symbol, f"{meaning} [{unit.replace('^3', '³')}]", "1", unit)
    return eqx.field(default=default, metadata={"quantity": quantity, "least": -math.inf})


def own_quantity(symbol: str, meaning: str, dimension: str = "1") -> Callable[[_Method], _Method]:
    """Declare a method of a model as the rate of a quantity that is integrated along the cut, beside the volume.

    For example::

        @erosion.own_quantity("W", "work of the tip", "energy")
        def work(self, state, p):
            return …

    `erosion.impact(…).quantities["work"]` and sweeps give its integral, streams its mean; the method is named as a
    quantity is.

    Args:
        symbol: "W".
        meaning: "work of the tip".
        dimension: of the integral: "1", "length", "energy", "mass*length", …
    """
    quantity = _declared(symbol, meaning, dimension)

    def declared(method: _Method) -> _Method:
        if method.__name__ in RESULTS or f"mean_{method.__name__}" in RESULTS:
            raise ValueError(
                f"An own quantity must not be called `{method.__name__}`, as something else in results is."
            )
        vars(method)[_QUANTITY] = quantity
        return method

    return declared


def own_quantities(kind: type[eqx.Module]) -> dict[str, Quantity]:
    """The quantities that models of a class have of their own, by name; see `own_quantity`."""
    own: dict[str, Quantity] = {}
    for base in reversed(kind.__mro__):
        for name, member in vars(base).items():
            # Equinox wraps the methods of a module.
            quantity = getattr(getattr(member, "method", member), _QUANTITY, None)
            if isinstance(quantity, Quantity):
                own[name] = quantity
            else:
                own.pop(name, None)
    return own


def _declared(symbol: str, meaning: str, dimension: str) -> Quantity:
    with about("Argument `dimension`"):
        return Quantity(symbol, meaning, read_dimension(dimension))


def own_parameters(model: eqx.Module) -> dict[str, OwnParameter]:
    """The model's own parameters by name: its fields, and those of its parts, that hold one real number.

    A field that is declared as a number, by `own_parameter` or the annotation `float`, may hold an array: a
    number for each of many impacts, which broadcasts with the parameters of the case.

    A name is the field's. Where several parts have a field of the same name, as much of its path
    goes before it as tells them apart: "force.rate", "torque.rate".
    """
    own = []
    for leaf, (keys, value) in enumerate(jax.tree_util.tree_flatten_with_path(model)[0]):
        # What is within a tuple or a dictionary has no name of its own.
        path = tuple(key.name for key in keys if isinstance(key, jax.tree_util.GetAttrKey))
        field = _field(model, path) if len(path) == len(keys) else None
        metadata = {} if field is None else field.metadata
        is_declared = field is not None and ("quantity" in metadata or field.type in (float, int, "float", "int"))
        if len(path) == len(keys) and _is_number(value, many=is_declared):
            quantity = metadata.get("quantity", Quantity(path[-1], "own parameter of the model", "1"))
            own.append(OwnParameter(path, leaf, value, quantity, metadata.get("least", -math.inf), is_declared))
    paths = [parameter.path for parameter in own]
    return {_name(parameter.path, paths): parameter for parameter in own}


def check_least(model: eqx.Module, changes: Mapping[str, object]) -> None:
    """Refuse numbers below the least value of an own parameter; arrays and traced numbers pass unseen.

    Raises:
        ValueError: naming the first of them.
    """
    for name, parameter in own_parameters(model).items():
        value = changes.get(name, parameter.value)
        if _is_number(value) and not isinstance(value, Tracer) and value < parameter.least:
            raise ValueError(f"Argument `{name}` must be at least {parameter.least:g}, but is {abbreviate(value)}.")


def replaced(model: _Model, changes: Mapping[str, object]) -> _Model:
    """The same model with other values of some of its own parameters.

    Raises:
        TypeError, ValueError: for an unknown name, or a value that is no finite number.
            NaN or infinity in an array is no error: it is an impact that fails.
    """
    if not changes:
        return model
    own = own_parameters(model)
    leaves, structure = jax.tree.flatten(model)
    for name, value in changes.items():
        if name not in own:
            has = ", ".join(own) or "none"
            raise TypeError(f"Argument `{name}` is not an own parameter of {type(model).__name__}; it has {has}.")
        check_unmasked(name, value)
        if not _is_number(value, many=True):
            raise TypeError(f"Argument `{name}` must be a number, but is {briefly(value)}.")
        if np.ndim(value) and not own[name].is_declared:
            raise TypeError(
                f"Argument `{name}` must be one number, but has shape {np.shape(value)}; for a number for each "
                "impact declare its field with `erosion.own_parameter`, or as `float`."
            )
        if not isinstance(value, Tracer) and not np.ndim(value) and not np.isfinite(value):
            raise ValueError(f"Argument `{name}` must be a finite number, but is {abbreviate(value)}.")
        if isinstance(value, Tracer):
            leaves[own[name].leaf] = value
        else:
            leaves[own[name].leaf] = np.asarray(value, float) if np.ndim(value) else float(value)
    return jax.tree.unflatten(structure, leaves)


def require_one_impact(model: eqx.Module, p: Parameters, instead: str = "", *, traced: bool = False) -> None:
    """Refuse parameters that are arrays, of the case or the model's own.

    Args:
        model: whose own parameters.
        p: the case.
        instead: what to use for arrays, added to the message.
        traced: let pass what JAX traces.

    Raises:
        ValueError: naming the first parameter that is an array, and its shape.
        TypeError: naming the first that is traced.
    """
    require_parameters(p)
    numbers = values(model, p)
    if not traced:
        require_concrete(numbers)
    check_scalars(numbers, instead)


def quantities(model: eqx.Module) -> dict[str, Quantity]:
    """The names of the parameters of an impact: those of the case, then the model's own."""
    return {**QUANTITIES, **{name: parameter.quantity for name, parameter in own_parameters(model).items()}}


def ranges(model: eqx.Module) -> dict[str, tuple[float, float]]:
    """By parameter of an impact, the greatest number below its range, and the greatest number of it."""
    signed = ("alpha", "phidot0")  # the angles of a jet may be any, see `streams`
    case = {name: (-math.inf if name in signed else 0.0, math.inf) for name in QUANTITIES}
    own = {name: (math.nextafter(parameter.least, -math.inf), math.inf)
           for name, parameter in own_parameters(model).items()}  # fmt: skip
    return {**case, **own}


def values(model: eqx.Module, p: Parameters) -> dict[str, Number]:
    """The parameters of an impact, as `quantities` has them."""
    own = {name: parameter.value for name, parameter in own_parameters(model).items()}
    return {**{name: getattr(p, name) for name in QUANTITIES}, **own}


def sizes(model: eqx.Module, p: Parameters) -> dict[str, np.ndarray]:
    """A significant change of each parameter: its size, 1 where that is 0; v₀/r for the spin."""
    changes = {name: np.where(value == 0, 1.0, np.abs(value)) for name, value in values(model, p).items()}
    return {**changes, "phidot0": np.asarray(p.v0 / p.r)}


def with_values(model: _Model, p: Parameters, changes: Mapping[str, Any]) -> tuple[_Model, Parameters]:
    """Model and case with other values of some of `quantities`."""
    own = {name: value for name, value in changes.items() if name not in QUANTITIES}
    return replaced(model, own), dataclasses.replace(
        p, **{name: changes[name] for name in changes if name in QUANTITIES}
    )


def own_in_words(model: eqx.Module, but: Collection[str] = (), system: System | None = None) -> str:
    """The own parameters with their values in one line; empty where there are none.

    Args:
        model: whose own parameters.
        but: names that are left out.
        system: the unit system that shows the values, rounded; without it exact numbers in SI alone.
    """
    own = {name: parameter for name, parameter in own_parameters(model).items() if name not in but}
    return ", ".join(
        f"{name} = {abbreviate(value) if system is None else quantity.in_words(float(value), system, 6)}"
        for name, (_, _, value, quantity, *_) in own.items()
    )


def _is_number(value: object, *, many: bool = False) -> TypeGuard[Number]:
    """Whether it is a real number, or, with `many`, an array of real numbers."""
    if isinstance(value, (bool, np.bool_)):
        return False
    if isinstance(value, (int, float)):
        return True
    if not isinstance(value, (np.ndarray, np.generic, jax.Array, Tracer)):
        return False
    return np.dtype(value.dtype).kind in "iuf" and (many or np.ndim(value) == 0)


def _field(model: eqx.Module, path: tuple[str, ...]) -> dataclasses.Field | None:
    owner = functools.reduce(getattr, path[:-1], model)
    if not dataclasses.is_dataclass(owner):
        return None  # of a named tuple
    return next(field for field in dataclasses.fields(owner) if field.name == path[-1])


def _name(path: tuple[str, ...], paths: list[tuple[str, ...]]) -> str:
    """The shortest end of the path that no other path has."""
    ends = (path[-length:] for length in range(1, len(path)))
    alone = (end for end in ends if sum(other[-len(end) :] == end for other in paths) == 1)
    return ".".join(next(alone, path))
