"""The wall that sand takes from pipes, after DNV RP-O501: millimetres per tonne of sand.

A part of a pipe has an angle at which the sand hits, an area that it hits, and factors for its shape and for
particles that are small enough to follow the flow. `python examples/pipes.py` computes a bend.
"""

import functools
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from erosion.correlations import DNV_MATERIALS, DNVMaterial, dnv_2015, dnv_brittle
from erosion.correlations.families import DNV_RANGES
from erosion.correlations.ranges import Range, Values, of_table, warn_outside

_MM_PER_TONNE = 1e6  # 1 m/kg in mm/t
_YEAR = 365.25 * 24 * 3600.0  # s
SAND_DENSITY = 2650.0  # kg/m³, quartz; RP-O501

# Model factors C₁ of RP-O501.
_BEND_FACTOR, _GALLERY_FACTOR = 2.5, 1.25
_LARGEST_CRITICAL = 0.1  # greatest critical diameter of a particle, over the pipe's; RP-O501 (4.30)

_RANGES: Mapping[str, Range] = {name: DNV_RANGES[name] for name in ("v0", "diameter")}


_BOUNDS: Mapping[str, tuple[float, float]] = {
    "density": (0.01, 3000.0), "viscosity": (1e-7, 100.0), "sand_density": (500.0, 20_000.0), "diameter": (1e-7, 0.02),
    "v0": (1e-3, 1000.0), "pipe": (0.005, 3.0), "radius": (0.5, 50.0), "gap": (1e-4, 1.0), "height": (1e-3, 5.0),
}  # fmt: skip
"""The least and the greatest value of each argument that a pipe of this world has, in SI units; a radius over D."""


class Flow(NamedTuple):
    """What flows in a pipe; all numbers broadcast.

    Args:
        v0: mean speed of the mixture [m/s].
        density: of the mixture [kg/m³].
        viscosity: of the mixture [Pa s].
        diameter: of the particles [m].
        sand_density: of the particles [kg/m³].
    """

    v0: Values
    density: Values
    viscosity: Values
    diameter: Values
    sand_density: Values = SAND_DENSITY

    @property
    def density_ratio(self) -> Array:
        """Particles over mixture [-]."""
        return jnp.asarray(self.sand_density / self.density, float)

    def reynolds(self, pipe: Values) -> Array:
        """The Reynolds number in a pipe of inner diameter `pipe` [m]."""
        return jnp.asarray(self.v0 * pipe * self.density / self.viscosity, float)


def bend(
    flow: Flow,
    *,
    pipe: Values,
    radius: Values,
    material: str | DNVMaterial = "duplex",
    geometry_factor: Values = 1.0,
) -> Array:
    """The greatest loss of wall in a bend.

    Args:
        flow: the mixture.
        pipe: inner diameter D [m].
        radius: of the bend's axis, over D [-].
        material: a name in `DNV_MATERIALS`, or constants of your own.
        geometry_factor: GF for what is upstream [-]; 1 for a straight pipe, 2 for flexible pipes.

    Returns:
        Loss of wall per mass of sand [mm/t].

    References:
        DNVGL-RP-O501 (2015), (4.23)-(4.34).
    """
    _require(flow, pipe=pipe, radius=radius)
    return _bend(flow, pipe, radius, _target(material, flow)) * geometry_factor


def _require(flow: Flow | None, **values: Values) -> None:
    """Refuse what no pipe has, such as millimetres for metres, or a radius in metres for one over D."""
    for name, value in {**({} if flow is None else flow._asdict()), **values}.items():
        low, high = _BOUNDS[name]
        if not (np.asarray(value) >= low).all() or not (np.asarray(value) <= high).all():
            raise ValueError(f"Argument `{name}` must be from {low:g} to {high:g} in SI units, but is {value}.")


@functools.partial(jax.jit, static_argnames="target")
def _bend(flow: Flow, pipe: Values, radius: Values, target: DNVMaterial) -> Array:
    angle = jnp.arctan(1 / jnp.sqrt(2 * jnp.asarray(radius, float)))
    group = flow.reynolds(pipe) * jnp.tan(angle) / flow.density_ratio
    critical = 1 / (flow.density_ratio * (1.88 * jnp.log(group) - 6.04))
    critical = jnp.where((critical <= 0) | (critical > _LARGEST_CRITICAL), _LARGEST_CRITICAL, critical)
    small = jnp.minimum(flow.diameter / pipe / critical, 1.0)
    shape = dnv_brittle(angle) if target.brittle else dnv_2015(angle)
    return _normal_loss(flow, pipe, target) * shape * jnp.sin(angle) * small * _BEND_FACTOR


def blinded_tee(
    flow: Flow, *, pipe: Values, material: str | DNVMaterial = "duplex", geometry_factor: Values = 1.0
) -> Array:
    """The greatest loss of wall in a blinded tee.

    Args:
        flow: the mixture.
        pipe: inner diameter [m].
        material: a name in `DNV_MATERIALS`, or constants of your own.
        geometry_factor: GF for what is upstream [-].

    Returns:
        Loss of wall per mass of sand [mm/t].

    References:
        DNVGL-RP-O501 (2015), (4.37)-(4.45).
    """
    _require(flow, pipe=pipe)
    return _blinded_tee(flow, pipe, _target(material, flow)) * geometry_factor


@functools.partial(jax.jit, static_argnames="target")
def _blinded_tee(flow: Flow, pipe: Values, target: DNVMaterial) -> Array:
    ratio, reynolds = flow.density_ratio, flow.reynolds(pipe)
    light = ratio < 40  # particles in a liquid
    slope = (jnp.log(reynolds / 1e4 + 1) + 1) ** -0.6 - 1.2
    critical = jnp.where(light, 0.14 / ratio, 0.0035 * (ratio / 40) ** slope)
    size = flow.diameter / pipe / critical
    of_large = jnp.where(light, 0.0, -0.3 * (1 - 1.01 ** (40 - ratio)))
    exponent = jnp.where(size < 1, 19 / jnp.log(reynolds), of_large)
    shape = jnp.where(light, 3 / ratio**0.3, 1.0)
    return _normal_loss(flow, pipe, target) * size**exponent * shape


def straight_pipe(v0: Values, *, pipe: Values) -> Array:
    """The loss of wall in a smooth straight pipe of steel.

    Args:
        v0: mean speed of the mixture [m/s].
        pipe: inner diameter D [m].

    Returns:
        Loss of wall per mass of sand [mm/t].

    References:
        DNVGL-RP-O501 (2015), section 4.2: 2.5e-5 v^2.6 D^-2 mm a year for a kilogramme of sand a second.
    """
    _require(None, v0=v0, pipe=pipe)
    warn_outside("DNV RP-O501", _RANGES, v0=v0)
    return 2.5e-5 * jnp.asarray(v0, float) ** 2.6 / jnp.asarray(pipe) ** 2 * 1e3 / _YEAR


def choke_gallery(
    flow: Flow,
    *,
    pipe: Values,
    radius: Values,
    gap: Values,
    height: Values,
    material: str | DNVMaterial = "cr-37-tungsten",
    geometry_factor: Values = 1.0,
) -> Array:
    """The greatest loss of wall in the gallery of an angle choke, computed as a bend of the gap's width.

    Args:
        flow: the mixture, with the speed in the pipe upstream.
        pipe: inner diameter of that pipe [m].
        radius: of the gallery [m].
        gap: between cage and body [m].
        height: of the gallery [m].
        material: a name in `DNV_MATERIALS`, or constants of your own.
        geometry_factor: GF for what is upstream [-].

    Returns:
        Loss of wall per mass of sand [mm/t].

    References:
        DNVGL-RP-O501 (2015), table 4-5.
    """
    _require(flow, pipe=pipe, gap=gap, height=height)
    in_gallery = flow._replace(v0=0.75 * flow.v0 * _section(pipe) / (2 * height * gap))
    as_bend = bend(in_gallery, pipe=gap, radius=radius / gap, material=material, geometry_factor=geometry_factor)
    return as_bend * _GALLERY_FACTOR / _BEND_FACTOR


def _target(material: str | DNVMaterial, flow: Flow) -> DNVMaterial:
    warn_outside("DNV RP-O501", _RANGES, v0=flow.v0, diameter=flow.diameter)
    return of_table(DNV_MATERIALS, material, DNVMaterial)


def _section(pipe: Values) -> Array:
    """The area of a pipe's section [m²]."""
    return jnp.pi / 4 * jnp.asarray(pipe, float) ** 2


def _normal_loss(flow: Flow, pipe: Values, target: DNVMaterial) -> Array:
    """Depth that a mass of sand removes of the pipe's section at F = 1 [mm/t]."""
    removed = target.coefficient * jnp.asarray(flow.v0, float) ** target.exponent / target.density
    return removed / _section(pipe) * _MM_PER_TONNE


if __name__ == "__main__":
    gas = Flow(v0=29.3, density=30.0, viscosity=1.5e-5, diameter=0.28e-3)
    print(f"{float(bend(gas, pipe=0.0978, radius=1.75)):.6f} mm/t")
