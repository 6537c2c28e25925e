"""The physical parameters of an impact, with Table 1 and Table 2 of the scenario.

Source: R. Laverty, *Solid Particle Erosion* (a modelling scenario after I. Finnie, *The
Mechanism of Erosion of Ductile Metals*, Proc. 3rd U.S. Natl. Congr. Appl. Mech., 1958,
527-532). Equation and table numbers in this package are the scenario's.
"""

import dataclasses
import functools
import inspect
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from erosion.arguments import Broadcast, check_scalars, check_unmasked
from erosion.output.tables import abbreviate, briefly
from erosion.parameters.materials import (
    Particle,
    Target,
    implausible_body,
    particle as read_particle,
    target as read_target,
)
from erosion.parameters.quantities import (
    QUANTITIES,
    STEEPEST,
    InSI,
    Quantity,
    System,
    about,
    ascii_unit,
    check_system,
    example,
    read_axis,
    read_quantity,
    unit_name,
    unit_size,
)
from erosion.results import Finding, Result, Value, in_unit

if TYPE_CHECKING:
    Leaf = Any  # numbers, lists and arrays come in; what is kept is an array, or JAX's stand-in for one
else:
    Leaf = Float[Array | np.ndarray, "..."]

_LEAF_TYPES = (int, float, np.ndarray, np.generic, jax.Array)


def _float64(name: str, value: object) -> Array | np.ndarray:
    """Numbers and arrays to float64 (numpy stays numpy: making parameters starts no device)."""
    if hasattr(value, "to_numpy"):
        raise TypeError(f"Argument `{name}` must be an array without labels: give its `.to_numpy()`.")
    if isinstance(value, bool) or not isinstance(value, (*_LEAF_TYPES, list, tuple)):
        raise TypeError(f"Argument `{name}` must be a number or an array, but is {briefly(value)}.")
    check_unmasked(name, value)
    array = value if isinstance(value, jax.Array) else array_of(value)
    if not any(jnp.issubdtype(array.dtype, kind) for kind in (np.integer, np.floating)):
        raise TypeError(f"Argument `{name}` must hold real numbers of one shape, but has the type {array.dtype}.")
    return jnp.asarray(array, jnp.float64) if isinstance(array, jax.Array) else array.astype(np.float64)


def array_of(value: Any) -> np.ndarray:
    """An array; one of objects for lists of several lengths."""
    try:
        return np.asarray(value)
    except ValueError:
        return np.empty(0, object)


def _parameter(name: str, **default: Any) -> Any:
    return eqx.field(converter=functools.partial(_float64, name), metadata={"quantity": QUANTITIES[name]}, **default)


class SizeWarning(UserWarning):
    """No body of a plausible density has the mass m and the size r, b of a case."""


class Parameters(Result, eqx.Module):
    """Particle, target and impact: the symbols of the scenario's equations, as float64 leaves in SI.

    `shown_in` says in which unit system results are shown. Leaves are scalars, or arrays that
    broadcast against each other. Values are not checked here (a
    constructor must work on JAX's tracers); see `validate`.

    Args:
        k: force ratio F_y/F_x [-], > 0.
        psi: contact height over the tip's depth ψ = l/y_tip [-], > 0.
        r: distance from the centre of mass to the tip [m], > 0.
        b: width of the particle out of the plane [m], > 0.
        m: mass of the particle [kg], > 0.
        v0: impact speed [m/s], > 0.
        sigma: flow stress of the target σ [Pa], > 0.
        alpha: angle of attack from the surface [rad], in (0, π/2].
        phidot0: initial spin φ̇(0) [rad/s]; positive spin moves the tip forward.
        inertia: β in I = β m r² [-], > 0; ½ for the scenario's flat cylinder, 2/5 for a sphere.
        shown_in: the unit system of results, "si" or "inch-pound" (in, s, lbf, slinch).

    Raises:
        TypeError: for `units`, which does not say whether the numbers are in these units, and for a unit system
            without `shown_in=`.

    References:
        Laverty, Table 1 and equations (16)-(21). The scenario fixes β = ½; here it is free.
    """

    k: Leaf = _parameter("k")
    psi: Leaf = _parameter("psi")
    r: Leaf = _parameter("r")
    b: Leaf = _parameter("b")
    m: Leaf = _parameter("m")
    v0: Leaf = _parameter("v0")
    sigma: Leaf = _parameter("sigma")
    alpha: Leaf = _parameter("alpha")
    phidot0: Leaf = _parameter("phidot0", default=0.0)
    inertia: Leaf = _parameter("inertia", default=0.5)
    shown_in: System = eqx.field(
        static=True, default="si", converter=functools.partial(check_system, argument="shown_in")
    )

    def __new__(cls, *args: object, **fields: object) -> "Parameters":
        """Refuse a unit system that may be meant as that of the numbers; all else is for the constructor."""
        if "units" in fields or any(isinstance(value, str) for value in args):
            raise TypeError(
                "Argument `units` must be left out, as `Parameters` takes numbers in SI: give `shown_in=` to show "
                "results in other units; numbers in other units are read by "
                '`Parameters.from_quantities("inch-pound", {...})`.'
            )
        return super().__new__(cls)

    @classmethod
    def from_quantities(
        cls, units: str, quantities: Mapping[str, int | float | str], others: Mapping[str, float] | None = None
    ) -> "Parameters":
        """Make parameters from numbers in the unit system `units` and strings such as "4400 in/s".

        Args:
            units: the system of the numbers, in which results are shown as well.
            quantities: by parameter.
            others: parameters that `quantities` lacks [SI].

        Raises:
            ValueError: for an unknown or missing name, or a quantity that cannot be read, has
                the wrong dimension or is out of range; one sentence that names the field.
        """
        system = check_system(units)
        for name in quantities:
            if name not in QUANTITIES:
                raise ValueError(f"Field `{name}` is unknown; the fields are {', '.join(QUANTITIES)}.")
        values: dict[str, float] = {**(others or {})}
        for name, value in quantities.items():
            if isinstance(value, str):
                with about(f"Field `{name}`"):
                    values[name] = read_quantity(value, QUANTITIES[name].dimension, system)
            elif isinstance(value, (int, float)) and not isinstance(value, bool):
                try:
                    values[name] = float(value) * unit_size(QUANTITIES[name].dimension, system)
                except OverflowError:  # an integer of more than 308 digits
                    values[name] = np.inf
            else:
                raise ValueError(f"Field `{name}` must be a number or a quantity in quotes, but is {briefly(value)}.")
        if missing := [name for name in REQUIRED if name not in values]:
            raise ValueError(f"Field `{missing[0]}` ({QUANTITIES[missing[0]].meaning}) is missing.")
        parameters = cls(**values, shown_in=system)
        validate(parameters, what="Field")
        return parameters

    def replace(self, **changes: object) -> "Parameters":
        """A copy with some fields changed: `p.replace(alpha=0.5, v0="2200 in/s")`.

        A change of r, b or m alone, after which no body of a plausible density has this mass and this size, is a
        `SizeWarning`.

        Args:
            **changes: SI numbers or arrays, or texts with units: a quantity, a list of them, or what an axis of a sweep
                may be, "80 m/s : 120 m/s : 5". Where results are shown in inch-pound units r, b, m, v0 and σ must be
                texts: `p.to("si").replace(v0=55.88)` takes SI numbers.

        Raises:
            TypeError: for a name that is no parameter.
            ValueError: for a bare number of which nobody knows the unit, and a text that cannot be read.
        """
        unknown = [name for name in changes if name not in QUANTITIES]
        if unknown:
            hint = '; use `p.to("si")` to show results in other units' if unknown[0] in ("units", "shown_in") else ""
            raise TypeError(f"Argument `{unknown[0]}` is not a parameter{hint}; they are {', '.join(QUANTITIES)}.")
        numbers = {name: si_numbers(name, value, QUANTITIES[name], self.shown_in) for name, value in changes.items()}
        changed = dataclasses.replace(self, **numbers)
        if not _BODY.isdisjoint(changes):
            warn_of_size(changed, before=self)
        return changed

    def similar(self, growth: Broadcast) -> "Parameters":
        """Return the impact by similar bodies, `growth` times as large: r and b grow with it, m with its cube."""
        return dataclasses.replace(self, r=self.r * growth, b=self.b * growth, m=self.m * growth**3)

    def with_particle(self, particle: str | Particle) -> "Parameters":
        """Return the impact by another particle: r, b, m and β of a sphere.

            p.with_particle("garnet 0.3 mm")

        Args:
            particle: see `erosion.particle`.

        Raises:
            ValueError: for a material that the table lacks, or a size that cannot be read.
        """
        return dataclasses.replace(self, **read_particle(particle).parameters)

    def with_target(self, target: str | Target) -> "Parameters":
        """Return the impact on another target: σ and ψ.

            p.with_target("aluminium 6061")

        Args:
            target: see `erosion.target`.

        Raises:
            ValueError: for a metal that the table lacks.
        """
        return dataclasses.replace(self, **read_target(target).parameters)

    def to(self, units: str) -> "Parameters":
        """The same case, with results in another unit system; no number changes."""
        return dataclasses.replace(self, shown_in=check_system(units))

    @property
    def size_finding(self) -> Finding | None:
        """The finding where no body of a plausible density has this mass and this size, else None.

        Numbers that JAX traces are not looked at.
        """
        sizes = {name: getattr(self, name) for name in _BODY}
        if any(isinstance(leaf, Tracer) for leaf in sizes.values()):
            return None
        return implausible_body(**sizes)

    @property
    def stiffness(self) -> Broadcast:
        """Contact stiffness c = σ b ψ, so that F_x = -c · depth."""
        return self.sigma * self.b * self.psi

    @property
    def moment_of_inertia(self) -> Broadcast:
        """I = β m r² about the centre of mass."""
        return self.inertia * self.m * self.r**2

    @property
    def rate(self) -> Broadcast:
        """ω = √(k c/m) [1/s], the rate of the linearized cut, y ∝ sin ωt."""
        return jnp.sqrt(self.k * self.stiffness / self.m)

    @property
    def volume_scale(self) -> Broadcast:
        """V* = m v₀²/(σψ) [m³], on which every volume scales."""
        return self.m * self.v0**2 / (self.sigma * self.psi)

    @property
    def spin(self) -> Broadcast:
        """Spin s = r φ̇₀/v₀ [-], the tip's speed by spin over the speed of impact."""
        return self.r * self.phidot0 / self.v0

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={abbreviate(getattr(self, name))}" for name in QUANTITIES)
        return f"Parameters({values}, shown_in={self.shown_in!r})"

    @property
    def title(self) -> str:
        """The title of the table."""
        return f"Parameters ({self.shown_in})"

    def declare(self) -> list[Value]:
        """Each field."""
        return [quantity.declare(name, getattr(self, name)) for name, quantity in QUANTITIES.items()]


def si_numbers(name: str, value: object, quantity: Quantity, shown_in: System) -> object:
    """A value of a parameter in SI: a text is read, and a number or an array, also a traced one, is returned as it is.

    Args:
        name: of the parameter.
        value: from the caller's program.
        quantity: the parameter's.
        shown_in: the unit system that shows the case.

    Raises:
        ValueError: for a bare number where the unit systems differ and the case is shown in another one than SI, for a
            text without a unit, and for one that cannot be read.
    """
    if isinstance(value, str) or (isinstance(value, (list, tuple)) and any(isinstance(each, str) for each in value)):
        with about(f"Argument `{name}`"):
            return read_axis(value, quantity.dimension, bare=None)
    if shown_in == "si" or quantity.size(shown_in) == 1:
        return value
    if not isinstance(value, (int, float, np.number)):
        remedy = f"texts such as {name}={example(quantity.dimension, shown_in)}"
        given = "bare numbers"
    else:
        number = repr(float(value)).removesuffix(".0")
        typed = f"{number} {ascii_unit(unit_name(quantity.dimension, shown_in))}"
        given, remedy = f"the bare number {number}", f'{name}="{typed}"'
    raise ValueError(
        f"Argument `{name}` must have a unit, as the case is shown in {shown_in} units, but is {given}: give {remedy}, "
        f'or numbers in SI to the case `p.to("si")`.'
    )


def in_si(values: Mapping[str, Any] | None, known: Mapping[str, Quantity], shown_in: System) -> InSI:
    """Values by name in SI, each read as `Parameters.replace` reads it; an `InSI` is returned as it is.

    Args:
        values: numbers, arrays or texts with units.
        known: the quantities; values of other names are not looked at.
        shown_in: the unit system that shows the case.

    Raises:
        ValueError: see `si_numbers`.
    """
    if isinstance(values, InSI):
        return values
    return InSI({name: si_numbers(name, value, known[name], shown_in) if name in known else value
                 for name, value in (values or {}).items()})  # fmt: skip


def warn_of_size(p: Parameters, before: Parameters | None = None) -> None:
    """Warn the user's line where mass and size fit no body, unless they did not before; see `SizeWarning`."""
    finding = p.size_finding
    if finding is None or (before is not None and before.size_finding is not None):
        return
    # Between here and the user stand functions of the package, and wrappers of equinox and jaxtyping.
    level, frame = 1, inspect.currentframe()
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _INNER:
        level, frame = level + 1, frame.f_back
    # In the same words each time, so that Python shows it once for each place.
    warnings.warn(finding.text, SizeWarning, stacklevel=level)


_BODY = frozenset({"r", "b", "m"})
_INNER = frozenset({"erosion", "equinox", "jaxtyping"})

REQUIRED: tuple[str, ...] = tuple(name for name in QUANTITIES if name not in ("phidot0", "inertia"))
"""The fields without a default."""

_STEEPEST = STEEPEST * (1 + 4 * np.finfo(float).eps)  # π/2 reached through degrees may round up by an ulp


def are_angles(values: np.ndarray) -> np.ndarray | np.bool_:
    """Whether numbers are angles of attack, in (0, π/2] rad."""
    return (values > 0) & (values <= _STEEPEST)


def validate(p: Parameters, what: str = "Argument", *, batch: bool = False) -> None:
    """Check parameter values.

    Args:
        p: parameters whose leaves are numbers or arrays.
        what: what a field is called in the message ("Argument", "Field").
        batch: let NaN and infinity in arrays pass, as lanes that will be "failed".

    Raises:
        ValueError: one sentence naming the first field that is not finite or out of range,
            its value and, in an array, the index; or leaves that do not broadcast.
        TypeError: where JAX traces a field, whose value nobody knows.
    """
    require_parameters(p)
    # From the dictionary: equinox looks at each access to an attribute.
    fields = vars(p)
    leaves = {name: fields[name] for name in QUANTITIES}
    require_concrete(leaves)
    for name, leaf in leaves.items():
        values = np.asarray(leaf)
        if name == "phidot0":
            good, condition = np.isfinite(values), "must be a finite number"
        elif name == "alpha":
            good, condition = are_angles(values), "must be in (0, 90°]"
        else:
            good, condition = (values > 0) & np.isfinite(values), "must be positive and finite"
        if batch and values.ndim:
            good = good | ~np.isfinite(values)
        if not (good.all() if values.ndim else good):
            raise ValueError(f"{what} `{name}` {condition}, but is {_first_bad(name, values, good, p.shown_in)}.")
    try:
        np.broadcast_shapes(*(np.shape(leaf) for leaf in leaves.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {np.shape(leaf)}" for name, leaf in leaves.items() if np.ndim(leaf))
        raise ValueError(f"{what}s must broadcast against each other, but have shapes {shapes}.") from None


def require_scalars(p: Parameters, instead: str = "") -> None:
    """Refuse parameters that are arrays.

    Args:
        p: the parameters.
        instead: what to use for arrays, added to the message.

    Raises:
        ValueError: naming the first field that is an array, and its shape.
    """
    require_parameters(p)
    check_scalars({name: getattr(p, name) for name in QUANTITIES}, instead)


def require_concrete(numbers: Mapping[str, Any]) -> None:
    """Refuse numbers that JAX is tracing.

    Raises:
        TypeError: naming the first that is traced, and what to use instead.
    """
    for name, number in numbers.items():
        if isinstance(number, Tracer):
            raise TypeError(
                f"Argument `{name}` must be a number or an array, but is traced by JAX: "
                "inside jit, vmap and grad use `erosion.volume`."
            )


def require_parameters(p: object) -> None:
    """Refuse what is no `Parameters`, by a `TypeError`."""
    if not isinstance(p, Parameters):
        raise TypeError(f"Argument `p` must be Parameters, but is {briefly(p)}.")


def _first_bad(name: str, values: np.ndarray, good: np.ndarray | np.bool_, shown_in: System) -> str:
    """The first value that is not good, and where it is; angles in degrees, others with their unit if it is not SI."""
    index = tuple(int(i) for i in np.argwhere(~good)[0]) if values.ndim else ()
    value = float(values[index])
    quantity = QUANTITIES[name]
    text = f"{value:g}"
    if quantity.size(shown_in) != 1 and np.isfinite(value):
        text = f"{in_unit(value, quantity.size(shown_in)):g} {unit_name(quantity.dimension, shown_in)}"
    if name == "alpha" and np.isfinite(value):
        text = f"{np.rad2deg(value):g}°"
        # Somebody has written 20 and meant degrees.
        text += f' ({value:g} rad; degrees are written "{value:g} deg")' if 2 <= value <= 90 else ""
    if not index:
        return text
    return f"{text} at index {index[0] if len(index) == 1 else index}"


TABLE_1 = Parameters.from_quantities(
    "inch-pound",
    {"k": 2, "psi": 0.04, "r": 0.04, "b": 0.04, "m": 2.855e-7, "v0": 4400, "sigma": 200e3, "alpha": np.deg2rad(20.0)},
)
"""Quartz sand on aluminium: Laverty, Table 1 (initial spin 0, flat cylinder β = ½)."""
