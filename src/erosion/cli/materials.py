"""`erosion materials`: particles and targets by name."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.options import JsonOption
from erosion.cli.output import Output, print_table

if TYPE_CHECKING:
    from erosion.parameters.materials import Particle, Target

_NOTE = (
    "ψ of a target whose flow stress is its Vickers hardness is 2; the others leave ψ as it is. "
    'A table of your own in TOML has the same form: --target "mine.toml: my alloy".'
)


def materials(
    file: Annotated[Path | None, Parameter(help="A table of your own (TOML) instead of the package's.")] = None,
    /,
    *,
    json: JsonOption = False,
) -> None:
    """List the particles and targets that --particle and --target name, with sources."""
    from erosion.parameters.materials import known_particles, known_targets, particle, target

    before = "" if file is None else f"{file}: "
    with user_errors():
        # Any size will do: it is not shown.
        particles = [particle(f"{before}{name} 1 mm") for name in known_particles(file)]
        targets = [target(f"{before}{name}") for name in known_targets(file)]
    if json:
        described = {
            "particles": [_particle(item) for item in particles],
            "targets": [_target(item) for item in targets],
        }
        Output("materials", json=True).document(described)
        return
    rows = [(item.name, _span(item.density, item.density_range), item.hardness, item.source) for item in particles]
    if rows:
        print_table("Particles", rows, ("particle", "density [kg/m³]", "hardness", "source"), (1,))
    if targets:
        print_table("Targets", [_row(item) for item in targets], _TARGET, (1, 2), [_NOTE])


_TARGET = ("target", "density [kg/m³]", "flow stress [MPa]", "by", "source")


def _row(item: "Target") -> tuple[str, ...]:
    density = "" if item.density is None else _span(item.density, item.density_range)
    low, high = item.flow_stress_range
    stress = _span(item.flow_stress / 1e6, (low / 1e6, high / 1e6))
    return item.name, density, stress, "" if item.vickers is None else f"{item.vickers:g} HV", item.source


def _span(value: float, ends: tuple[float, float] | None) -> str:
    """A value, and the range where it has one."""
    low, high = ends or (value, value)
    return f"{value:.4g}" if low == high else f"{value:.4g} ({low:.4g} to {high:.4g})"


def _particle(item: "Particle") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            "hardness": item.hardness, "shape": item.shape, "source": item.source}  # fmt: skip


def _target(item: "Target") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            **_quantity("flow_stress", item.flow_stress, "Pa", item.flow_stress_range),
            "vickers": item.vickers, "psi": item.psi, "correlations": list(item.correlations),
            "source": item.source}  # fmt: skip


def _quantity(name: str, value: float | None, unit: str, ends: tuple[float, float] | None) -> dict[str, Any]:
    return {name: {"value": value, "unit": unit}, f"{name}_range": {"value": list(ends or ()), "unit": unit}}
