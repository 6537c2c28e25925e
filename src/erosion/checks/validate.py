"""Published numbers, from the file that comes with the package, beside what the package gives."""

import dataclasses
import functools
import importlib.resources
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from erosion import correlations
from erosion.arguments import Number
from erosion.correlations import CORRELATIONS, pipes
from erosion.impacts.alpha_max import alpha_max
from erosion.impacts.impact import impact
from erosion.impacts.simulate import path
from erosion.models import Linearized, load_model
from erosion.models.deformation import DeformationWear
from erosion.ode.step_control import require_float64
from erosion.output.tables import Result, to_plain
from erosion.parameters.parameters import TABLE_1, Parameters

KINDS: Mapping[str, str] = {
    "measured": "measured",
    "correlation": "a published fit to tests, evaluated",
    "formula": "a published formula, evaluated",
    "constant": "documented by a program",
    "test value": "of a program's tests",
}
"""What a fact may be, from what says most of nature to what says least."""


@dataclass(frozen=True)
class Fact:
    """A published number, and what of the package is to give it.

    Args:
        name: of the quantity, in a few words.
        published: the number [`unit`].
        unit: as programs read it; "1" for a pure number.
        kind: a key of `KINDS`.
        source: who, where, and the page or file.
        computes: a key of `COMPUTATIONS`.
        by: the model or the correlation that gives the number here.
        error: of the number, as the source states it [`unit`]; None where it states none.
        note: what else has to be known.
        given: the arguments of the computation.
    """

    name: str
    published: float
    unit: str
    kind: str
    source: str
    computes: str
    by: str
    error: float | None = None
    note: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)


@functools.cache
def published_facts() -> tuple[Fact, ...]:
    """All facts, in the order of the file `erosion/checks/facts.toml`."""
    text = importlib.resources.files("erosion.checks").joinpath("facts.toml").read_text("utf-8")
    return tuple(Fact(**entry) for entry in tomllib.loads(text)["fact"])


# Of the sphere in Cao's tests.
_RADIUS, _DENSITY = 2.5e-3, 7850.0  # m, kg/m³
_MASS = 4 / 3 * math.pi * _RADIUS**3 * _DENSITY  # kg
# Contact pressure, three times the yield stress of Al 6061 (Johnson and Cook's A in dineshadepu/open_source_erosion).
_PRESSURE = 3 * 335e6  # Pa
_FORCE_RATIO = 10.0  # k of the model that stands for a sphere: so large that the cut rebounds
_UM, _US, _MM3 = 1e6, 1e6, 1e9  # a metre in µm, a second in µs, a cubic metre in mm³


def _angle_function(function: str, angle: float) -> Number:
    return getattr(correlations, function)(math.radians(angle))


def _bend(*, pipe: float, radius: float, geometry_factor: float, **flow: float) -> Number:
    return pipes.bend(pipes.Flow(**flow), pipe=pipe, radius=radius, geometry_factor=geometry_factor)


def _blinded_tee(*, pipe: float, geometry_factor: float, **flow: float) -> Number:
    return pipes.blinded_tee(pipes.Flow(**flow), pipe=pipe, geometry_factor=geometry_factor)


def _choke_gallery(*, pipe: float, radius: float, gap: float, height: float, material: str, **flow: float) -> Number:
    return pipes.choke_gallery(pipes.Flow(**flow), pipe=pipe, radius=radius, gap=gap, height=height, material=material)


def _speed_exponent(correlation: str, **factors: str) -> Number:
    """∂ ln E/∂ ln v₀ at 50 m/s and 30°."""
    speed, erosion = 50.0, lambda v0: CORRELATIONS[correlation].erosion(math.radians(30), v0, **factors)
    return jax.grad(erosion)(speed) * speed / erosion(speed)


def _size_exponent() -> Number:
    """∂ ln E/∂ ln D of Oka at 300 µm."""
    size, erosion = 3e-4, lambda diameter: correlations.oka(math.radians(30), 50.0, diameter)
    return jax.grad(erosion)(size) * size / erosion(size)


def _erosion(correlation: str, angle: float, v0: float, **factors: Any) -> Number:
    return CORRELATIONS[correlation].erosion(math.radians(angle), v0, **factors)


def _mclaury_coefficient() -> Number:
    """E/F at 1 m/s, Brinell hardness 1 and F_s = 1."""
    return correlations.mclaury(1.0, 1.0, brinell=1.0, sharpness=1.0) / correlations.mclaury_angle(1.0)


def _ecrc_coefficient() -> Number:
    """E/F at 1 m/s, Brinell hardness 1 and F_s = 1."""
    return correlations.ecrc(1.0, 1.0, brinell=1.0, sharpness=1.0) / correlations.ecrc_angle(1.0)


def _sharpness(sharpness: str) -> Number:
    return correlations.ecrc(0.5, 50.0, sharpness=sharpness) / correlations.ecrc(0.5, 50.0, sharpness="sharp")


def _oka_normal(material: str) -> Number:
    return correlations.oka(math.pi / 2, 104.0, 326e-6, material=material)


def _arabnejad_cutting(material: str) -> Number:
    """E/(F_s cos²α) at 1 m/s and 60°, steeper than the transition and too slow to deform."""
    return correlations.arabnejad(math.radians(60), 1.0, material=material) / math.cos(math.radians(60)) ** 2


def _arabnejad_threshold(material: str) -> Number:
    """The speed at which E begins, at 90°, where nothing is cut: from √E at two greater speeds."""
    slow, fast = 50.0, 100.0
    roots = [math.sqrt(correlations.arabnejad(math.pi / 2, speed, material=material)) for speed in (slow, fast)]
    # At 90° cos²α leaves 4e-33 of the cutting.
    return slow - roots[0] * (fast - slow) / (roots[1] - roots[0])


def _openfoam(angle: float) -> Number:
    """Removed volume of a grain of 10 µg at 50 m/s [µm³], by the model `finnie`."""
    p = Parameters(k=2.0, psi=2.0, r=1e-4, b=1e-4, m=1e-8, v0=50.0, sigma=1e9, alpha=math.radians(angle), units="si")
    return impact("finnie", p).volume * _UM**3


def _openfoam_correlation(angle: float) -> Number:
    """The same by the correlation."""
    return correlations.finnie_volume(math.radians(angle), 50.0, 1e-8, 1e9) * _UM**3


def _sphere(v0: float, angle: float) -> Parameters:
    """A case whose normal motion is that of the sphere: kσbψ = 2πRp."""
    stiffness = 2 * math.pi * _RADIUS * _PRESSURE  # N/m
    return Parameters(k=_FORCE_RATIO, psi=1.0, r=_RADIUS, b=_RADIUS, m=_MASS, v0=v0, alpha=math.radians(angle),
                      sigma=stiffness / (_FORCE_RATIO * _RADIUS), inertia=0.4, units="si")  # fmt: skip


def _sphere_depth(v0: float, angle: float) -> Number:
    return path(load_model("linearized"), _sphere(v0, angle)).max_depth * _UM


def _sphere_time(v0: float, angle: float) -> Number:
    """The time to the greatest depth, half of the contact [µs]."""
    return path(load_model("linearized"), _sphere(v0, angle)).t_c / 2 * _US


def _sphere_volume(v0: float) -> Number:
    """What a model that deforms removes at 90°, where it cuts nothing, with ε = p [mm³]."""
    model = Linearized(deformation=DeformationWear(specific_energy=_PRESSURE, threshold=0.0))
    return impact(model, _sphere(v0, 90.0)).volume * _MM3


def _depth_exponent() -> Number:
    slow, fast = (_sphere_depth(speed, 45.0) for speed in (10.0, 18.0))
    return math.log(fast / slow) / math.log(1.8)


def _share_at_90(model: str) -> Number:
    steep = impact(model, TABLE_1.replace(alpha=np.pi / 2)).volume
    return steep / alpha_max(model, TABLE_1).volume


def _volume_per_mass(model: str) -> Number:
    p = TABLE_1.to("si")
    return impact(load_model(model), p).volume / p.m * _MM3


COMPUTATIONS: Mapping[str, Callable[..., Number]] = {
    "angle function": _angle_function,
    "bend": _bend,
    "blinded tee": _blinded_tee,
    "straight pipe": pipes.straight_pipe,
    "choke gallery": _choke_gallery,
    "speed exponent": _speed_exponent,
    "size exponent": _size_exponent,
    "erosion": _erosion,
    "ecrc coefficient": _ecrc_coefficient,
    "mclaury coefficient": _mclaury_coefficient,
    "sharpness": _sharpness,
    "oka normal": _oka_normal,
    "arabnejad cutting": _arabnejad_cutting,
    "arabnejad threshold": _arabnejad_threshold,
    "openfoam": _openfoam,
    "openfoam correlation": _openfoam_correlation,
    "sphere depth": _sphere_depth,
    "sphere time": _sphere_time,
    "sphere volume": _sphere_volume,
    "depth exponent": _depth_exponent,
    "share at 90°": _share_at_90,
    "volume per mass": _volume_per_mass,
}
"""By the name that a fact has for it."""


HEADINGS = ("quantity", "published", "here", "unit", "off", "source")

OF_TESTS = ("measured", "correlation")
"""The kinds of facts that say something of nature."""

_NEAR = 0.1  # off by less is near
_FAR = 2.0  # times as much or as little; what is farther off is told as a factor
_DIGITS = 4


@dataclasses.dataclass(frozen=True)
class Comparison:
    """A published number, and the package's.

    Args:
        fact: what is published.
        computed: what a model or a correlation gives [unit of the fact].
    """

    fact: Fact
    computed: float

    @property
    def ratio(self) -> float:
        """Computed over published [-]."""
        return self.computed / self.fact.published

    @property
    def within(self) -> bool | None:
        """Whether the two agree within the error that the source states; None where it states none."""
        error = self.fact.error
        return None if error is None else abs(self.computed - self.fact.published) <= error

    @property
    def off(self) -> str:
        """By how much the computed number is off, in words."""
        if self.ratio > _FAR or 0 < self.ratio < 1 / _FAR:
            return f"×{self.ratio:.3g}"
        percent = 100 * (self.ratio - 1)
        # Numbers are printed with six digits or so: less than a thousandth of a percent says nothing.
        return "0 %" if abs(percent) < 1e-3 else f"{percent:+.2g} %" if abs(percent) < 99.5 else f"{percent:+.0f} %"


@dataclasses.dataclass(frozen=True, repr=False)
class Validation(Result):
    """All published facts beside what the package gives.

    Args:
        comparisons: what was measured first.
    """

    comparisons: tuple[Comparison, ...]

    @property
    def title(self) -> str:
        """How many facts."""
        return f"{len(self.comparisons)} published numbers, and what this package gives"

    @property
    def headings(self) -> tuple[str, ...]:
        """The columns of the table."""
        return HEADINGS

    @property
    def sources(self) -> tuple[str, ...]:
        """Kind and source of the numbers, each once, in the order in which the table numbers them."""
        return tuple(dict.fromkeys(_source(comparison.fact) for comparison in self.comparisons))

    def rows(self) -> list[tuple[str, ...]]:
        """A line for each fact; "✗" marks what is off by more than the stated error."""
        return [
            (
                comparison.fact.name,
                _number(comparison.fact.published),
                _number(comparison.computed),
                _unit(comparison.fact.unit),
                comparison.off + (" ✗" if comparison.within is False else ""),
                f"[{self.sources.index(_source(comparison.fact)) + 1}]",
            )
            for comparison in self.comparisons
        ]

    @property
    def conclusions(self) -> tuple[str, ...]:
        """The sources, what agrees and what does not, and what this means."""
        stated = [comparison for comparison in self.comparisons if comparison.within is not None]
        agreeing = sum(bool(comparison.within) for comparison in stated)
        tested = [comparison for comparison in self.comparisons if comparison.fact.kind in OF_TESTS]
        near = sum(abs(comparison.ratio - 1) <= _NEAR for comparison in tested)
        far = sum(not 1 / _FAR <= comparison.ratio <= _FAR for comparison in tested)
        return (
            *(f"[{i}] {source}" for i, source in enumerate(self.sources, 1)),
            f"{agreeing} of {len(stated)} numbers agree within the error or tolerance that their source states; "
            f"{len(self.comparisons) - len(stated)} sources state none.",
            f"Of {len(tested)} numbers that were measured or come from fits to tests, {near} are off by {_NEAR:.0%} or "
            f"less, {far} by more than a factor of {_FAR:.0f}.",
            "Formulas, constants and test values show that something is computed as published, not that it is right. "
            "This table validates no model.",
        )

    def to_dict(self) -> dict[str, Any]:
        """Every fact, with published and computed numbers and their unit."""
        return to_plain({"facts": [_described(comparison) for comparison in self.comparisons]})

    def __repr__(self) -> str:
        return f"Validation({self.title!r})"


def _described(comparison: Comparison) -> dict[str, Any]:
    fact = comparison.fact
    return {
        "name": fact.name,
        "published": {"value": fact.published, "unit": fact.unit},
        "error": None if fact.error is None else {"value": fact.error, "unit": fact.unit},
        "computed": {"value": comparison.computed, "unit": fact.unit},
        "by": fact.by,
        "within": comparison.within,
        "kind": fact.kind,
        "meaning": KINDS[fact.kind],
        "source": fact.source,
        "note": fact.note,
    }


def _source(fact: Fact) -> str:
    return f"{fact.kind}: {fact.source}"


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}"


def _unit(unit: str) -> str:
    """As people write it: µm³."""
    if unit == "1":
        return ""
    return unit.replace("um", "µm").replace("us", "µs").replace("^3", "³")


def against_published() -> Validation:
    """Compare models and correlations with published numbers, misses included.

    Returns:
        For each fact the published number with its source, and the package's own. It prints as a table.
    """
    require_float64()
    return Validation(tuple(Comparison(fact, computed(fact)) for fact in published_facts()))


def computed(fact: Fact) -> float:
    """What the package gives for a fact [`fact.unit`]."""
    return float(COMPUTATIONS[fact.computes](**fact.given))
