"""Published numbers beside what the package gives: tests, and fits to tests, that others published."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from erosion.arguments import Number
from erosion.impacts import alpha_max, impact, path
from erosion.models import load_model
from erosion.ode.step_control import require_float64
from erosion.output import Result, to_plain
from erosion.parameters import TABLE_1, Parameters

KINDS: Mapping[str, str] = {"measured": "measured", "correlation": "a published fit to tests, evaluated"}
"""What a fact may be, from what says most of nature to what says least."""


@dataclasses.dataclass(frozen=True)
class Fact:
    """A published number, and what of the package is to give it.

    Args:
        name: of the quantity, in a few words.
        published: the number [`unit`].
        unit: as programs read it; "1" for a pure number.
        kind: a key of `KINDS`.
        source: who, where, and the page or file.
        by: the model that gives the number here.
        note: what else has to be known.
        compute: gives the package's number [`unit`].
    """

    name: str
    published: float
    unit: str
    kind: str
    source: str
    by: str
    note: str
    compute: Callable[[], Number]


# Of the sphere in Cao's tests.
_RADIUS, _DENSITY = 2.5e-3, 7850.0  # m, kg/m³
_MASS = 4 / 3 * math.pi * _RADIUS**3 * _DENSITY  # kg
# Contact pressure, three times the yield stress of Al 6061 (Johnson and Cook's A in dineshadepu/open_source_erosion).
_PRESSURE = 3 * 335e6  # Pa
_FORCE_RATIO = 10.0  # k of the model that stands for a sphere: so large that the cut rebounds


def sphere(v0: float, angle: float) -> Parameters:
    """A case whose normal motion is that of Cao's sphere: kσbψ = 2πRp.

    Args:
        v0: speed [m/s].
        angle: α [°].
    """
    stiffness = 2 * math.pi * _RADIUS * _PRESSURE  # N/m
    return Parameters(k=_FORCE_RATIO, psi=1.0, r=_RADIUS, b=_RADIUS, m=_MASS, v0=v0, alpha=math.radians(angle),
                      sigma=stiffness / (_FORCE_RATIO * _RADIUS), inertia=0.4, units="si")  # fmt: skip


def _sphere_depth(v0: float) -> Number:
    """The greatest depth at 45° [µm]."""
    return path(load_model("linearized"), sphere(v0, 45.0)).max_depth * 1e6


def _share_at_90(model: str) -> Number:
    return impact(model, TABLE_1.replace(alpha=np.pi / 2)).volume / alpha_max(model, TABLE_1).volume


def _volume_per_mass() -> Number:
    p = TABLE_1.to("si")
    return impact("rotating", p).volume / p.m * 1e9  # mm³ in a m³


_CAO = "X. Cao et al. 2022; digitised in dineshadepu/open_source_erosion, code/cao_xuerui_2022_*_exp_*.csv"
_STEEL = (
    "Steel on Al 6061, 45°, 7850 kg/m³; p = 3 × 335 MPa, three times the yield stress that the repository has for Al "
    "6061. Spin and rebound are not in the formula."
)
_CRATERS = [("9.99", 9.9867, 22.961), ("12", 11.983, 25.909), ("14", 13.989, 32.874), ("16", 15.984, 38.848),
            ("18", 17.99, 44.822)]  # fmt: skip
_SHARES = [
    ("cut alone", 0.6013, "DNVGL-RP-O501 (2015)", "rotating"),
    ("DNV", 0.6013, "DNVGL-RP-O501 (2015)", "linearized-deformation"),
    ("E/CRC", 0.7107, "Zhang et al., Wear 263 (2007) 330-338", "linearized-deformation"),
    ("Oka", 0.6986, "Oka et al., Wear 259 (2005) 95-101, Hv = 1.8 GPa", "linearized-deformation"),
]
_DEFORMATION = "With the default ε = 1.6 σψ, which was chosen by such curves."

FACTS: tuple[Fact, ...] = (
    *(
        Fact(f"Crater, 5 mm sphere, {words} m/s", depth, "um", "measured", _CAO, "model linearized, kσbψ = 2πRp",
             _STEEL, functools.partial(_sphere_depth, speed))
        for words, speed, depth in _CRATERS
    ),
    Fact("Crater, speed exponent", 1.137, "1", "measured", _CAO, "model linearized",
         "Between the slowest and the fastest of the five; depth is proportional to the speed in every model of a "
         "constant stress.", lambda: math.log(_sphere_depth(18.0) / _sphere_depth(10.0)) / math.log(1.8)),
    *(
        Fact(f"Share at 90°, {words}", share, "1", "correlation", source, f"model {model}",
             "A cut at 90° removes nothing." if model == "rotating" else _DEFORMATION,
             functools.partial(_share_at_90, model))
        for words, share, source, model in _SHARES
    ),
    Fact("Sand on aluminium, 112 m/s", 99.205, "mm^3/kg", "correlation",
         "DNVGL-RP-O501 (2015), aluminium: K = 5.8e-9, n = 2.3", "model rotating, Table 1",
         "Every grain of Table 1 cuts with its full width, 1 mm; sand does not.", _volume_per_mass),
)  # fmt: skip
"""All facts, what says most of nature first."""


HEADINGS = ("quantity", "published", "here", "unit", "off", "source")

_UNITS = {"1": "", "um": "µm", "mm^3/kg": "mm³/kg"}  # as people write them
_NEAR = 0.1  # off by less is near
_FAR = 2.0  # times as much or as little; what is farther off is told as a factor


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
    def source(self) -> str:
        """Kind and source of the published number."""
        return f"{self.fact.kind}: {self.fact.source}"

    @property
    def ratio(self) -> float:
        """Computed over published [-]."""
        return self.computed / self.fact.published

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
        return tuple(dict.fromkeys(comparison.source for comparison in self.comparisons))

    def rows(self) -> list[tuple[str, ...]]:
        """A line for each fact."""
        return [
            (
                comparison.fact.name,
                f"{comparison.fact.published:.4g}",
                f"{comparison.computed:.4g}",
                _UNITS.get(comparison.fact.unit, comparison.fact.unit),
                comparison.off,
                f"[{self.sources.index(comparison.source) + 1}]",
            )
            for comparison in self.comparisons
        ]

    @property
    def conclusions(self) -> tuple[str, ...]:
        """The sources, how far off the package is, and what this means."""
        ratios = [comparison.ratio for comparison in self.comparisons]
        near = sum(abs(ratio - 1) <= _NEAR for ratio in ratios)
        far = sum(not 1 / _FAR <= ratio <= _FAR for ratio in ratios)
        return (
            *(f"[{i}] {source}" for i, source in enumerate(self.sources, 1)),
            f"Of {len(ratios)} numbers that were measured or come from fits to tests, {near} are off by {_NEAR:.0%} or "
            f"less, {far} by more than a factor of {_FAR:.0f}. This table validates no model.",
        )

    def to_dict(self) -> dict[str, Any]:
        """Every fact, with published and computed numbers and their unit."""
        return to_plain(
            {
                "facts": [
                    {
                        "name": fact.name,
                        "published": {"value": fact.published, "unit": fact.unit},
                        "computed": {"value": comparison.computed, "unit": fact.unit},
                        "by": fact.by,
                        "kind": fact.kind,
                        "meaning": KINDS[fact.kind],
                        "source": fact.source,
                        "note": fact.note,
                    }
                    for comparison in self.comparisons
                    for fact in [comparison.fact]
                ]
            }
        )


def against_published() -> Validation:
    """Compare models and correlations with published numbers, misses included.

    Returns:
        For each fact the published number with its source, and the package's own. It prints as a table.
    """
    require_float64()
    return Validation(tuple(Comparison(fact, float(fact.compute())) for fact in FACTS))
