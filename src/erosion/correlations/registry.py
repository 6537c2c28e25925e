"""The correlations by name."""

import functools
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import jax
import numpy as np
from jax import Array

from erosion.correlations import families
from erosion.correlations.ranges import ANGLES_ALONE, Range, Values
from erosion.ode.step_control import require_xla


@dataclass(frozen=True)
class Correlation:
    """A named correlation: its shape F(α) over the angle, and the erosion E(α, v₀) with all factors.

    Args:
        name: as it is called in `CORRELATIONS` and on the command line.
        title: as it is called in a legend.
        function: F [-] of α [rad].
        erosion: E(alpha [rad], v0 [m/s], …) [kg/kg], with the arguments of the function of that name.
        density: of the default target [kg/m³].
        ranges: what it is made for, by argument, as far as that is known here.
        valid_for: the erodent and target behind it.
        source: where it is published.
        materials: the targets by name, for a correlation with a table of them.
    """

    name: str
    title: str
    function: Callable[[Values], Array]
    erosion: Callable[..., Array]
    density: float
    ranges: Mapping[str, Range]
    valid_for: str
    source: str
    materials: Mapping[
        str, families.DNVMaterial | families.FinnieMaterial | families.OkaMaterial | families.ArabnejadMaterial
    ] = field(default_factory=dict)

    def __call__(self, alpha: Values) -> Array:
        """F at the angle(s) α [rad]."""
        require_xla()
        return self._compiled(alpha)

    @functools.cached_property
    def _compiled(self) -> Callable[[Values], Array]:
        return jax.jit(self.function)

    @functools.cached_property
    def alpha_max(self) -> float:
        """The angle of greatest erosion [rad]."""
        from scipy.optimize import root_scalar  # the explorer, which knows the names, starts without scipy

        # Every F here rises to one maximum and then falls.
        coarse = np.deg2rad(np.arange(1.0, 90.0))
        near = coarse[np.argmax(np.asarray(self(coarse)))]
        step = np.deg2rad(1.0)
        return float(root_scalar(jax.jit(jax.grad(self.function)), bracket=(near - step, near + step), xtol=1e-14).root)

    @property
    def peak(self) -> float:
        """F at `alpha_max`."""
        return float(self(self.alpha_max))

    def normalised(self, alpha: Values) -> Array:
        """F(α)/F(α_max), to lay curves of any scale over each other."""
        return self(alpha) / self.peak


_DNV_STEEL = families.DNV_MATERIALS["carbon-steel"].density

CORRELATIONS: Mapping[str, Correlation] = types.MappingProxyType(
    {
        correlation.name: correlation
        for correlation in (
            Correlation("finnie-cfd", "Finnie (CFD, K = 2)", families.finnie_angle, families.finnie,
                        families.FINNIE_MATERIALS["steel"].density, ANGLES_ALONE,
                        "ductile targets; predicts no erosion at 90°, where tests find some",
                        "I. Finnie, Wear 3 (1960) 87-103, as in OpenFOAM's ParticleErosion", families.FINNIE_MATERIALS),
            Correlation("dnv", "DNV RP-O501 (2015)", families.dnv_2015, families.dnv, _DNV_STEEL, families.DNV_RANGES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNVGL-RP-O501, Managing sand production and erosion, 2015", families.DNV_MATERIALS),
            Correlation("dnv-polynomial", "DNV RP-O501 (before 2015)", families.dnv_polynomial,
                        functools.partial(families.dnv, edition=2007), _DNV_STEEL, families.DNV_RANGES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNV RP O501, Erosive wear in piping systems, revision 4.2, 2007", families.DNV_MATERIALS),
            Correlation("ecrc", "E/CRC (Zhang 2007)", families.ecrc_angle, families.ecrc, families.STEEL_DENSITY,
                        ANGLES_ALONE,
                        "sand on carbon steel and nickel alloy",
                        "Y. Zhang, E. P. Reuterfors, B. S. McLaury, S. A. Shirazi, E. F. Rybicki, "
                        "Wear 263 (2007) 330-338"),
            Correlation("oka", "Oka (SiO₂, Hv = 1.8 GPa)", families.oka_angle, families.oka,
                        families.OKA_MATERIALS["steel"].density, families.OKA_RANGES,
                        "angular sand on metals; the exponents are those of SiO₂",
                        "Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101", families.OKA_MATERIALS),
            Correlation("mclaury", "McLaury (Edwards 2000)", families.mclaury_angle, families.mclaury,
                        families.STEEL_DENSITY, ANGLES_ALONE,
                        "sand on carbon steel",
                        "J. K. Edwards, B. S. McLaury, S. A. Shirazi, ASME FEDSM 2000, 959-966"),
            Correlation("arabnejad", "Arabnejad, cutting (K = 0.4)", families.arabnejad_cutting, families.arabnejad,
                        families.ARABNEJAD_MATERIALS["carbon-steel-4130"].density, families.ARABNEJAD_RANGES,
                        "150 µm sand on steels; F is the cutting term alone, E has deformation too",
                        "H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050",
                        families.ARABNEJAD_MATERIALS),
        )
    }
)  # fmt: skip
"""Every correlation by name: `CORRELATIONS["dnv"].erosion(alpha, v0)`, `CORRELATIONS["dnv"].normalised(alpha)`."""
