"""Erosion over the angle of attack as engineers compute it today: fits to tests, by name.

A correlation's angle function F(α) multiplies a factor for speed, size and material. Only the
angle functions are here: those factors differ with erodent and target, and are not invented.
All functions are vectorized, and differentiable by JAX; α is in radians from the surface.
"""

import functools
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import root_scalar

from erosion.parameters.precision import require_float64

Angle = Float[Array | np.ndarray, "..."] | float


@dataclass(frozen=True)
class Correlation:
    """A named angle function F(α).

    Args:
        name: as it is called in `CORRELATIONS` and on the command line.
        title: as it is called in a legend.
        function: F [`units`] of α [rad].
        units: of F; "-" throughout, as the factor before F carries the dimension.
        valid: the angles it is made for [rad].
        valid_for: the erodent and target behind it.
        source: where it is published.
    """

    name: str
    title: str
    function: Callable[[Angle], Array]
    units: str
    valid: tuple[float, float]
    valid_for: str
    source: str

    def __call__(self, alpha: Angle) -> Array:
        """F at the angle(s) α [rad]."""
        return self._compiled(alpha)

    @functools.cached_property
    def _compiled(self) -> Callable[[Angle], Array]:
        return jax.jit(self.function)

    @functools.cached_property
    def alpha_max(self) -> float:
        """The angle of greatest erosion [rad]."""
        require_float64()
        # Every F here rises to one maximum and then falls.
        coarse = np.deg2rad(np.arange(1.0, 90.0))
        near = coarse[np.argmax(np.asarray(self(coarse)))]
        step = np.deg2rad(1.0)
        return float(root_scalar(jax.jit(jax.grad(self.function)), bracket=(near - step, near + step), xtol=1e-14).root)

    @property
    def peak(self) -> float:
        """F at `alpha_max`."""
        return float(self(self.alpha_max))

    def normalised(self, alpha: Angle) -> Array:
        """F(α)/F(α_max), to lay curves of any scale over each other."""
        return self(alpha) / self.peak


def finnie(alpha: Angle, force_ratio: float = 2.0) -> Array:
    """Finnie's closed form as CFD codes have it, per V²/(ψ K p) and unit mass of erodent.

    F = sin 2α - (6/K) sin²α for tan α < K/6, (K/6) cos²α above. It is the model `finnie` with
    β = ½ and no spin.

    Args:
        alpha: α [rad].
        force_ratio: K, normal over tangential force [-].

    References:
        I. Finnie, Wear 3 (1960) 87-103; OpenFOAM, `ParticleErosion`.
    """
    sine, cosine = jnp.sin(alpha), jnp.cos(alpha)
    shallow = 2 * sine * cosine - 6 / force_ratio * sine**2
    return jnp.where(jnp.tan(alpha) < force_ratio / 6, shallow, force_ratio / 6 * cosine**2)


def finnie_volume(alpha: Angle, speed: Angle, mass: Angle, flow_stress: Angle, psi: Angle = 2.0,
                  force_ratio: float = 2.0) -> Angle:  # fmt: skip
    """The removed volume as OpenFOAM's `ParticleErosion` has it: m V²/(p ψ K) · F(α).

    Args:
        alpha: α [rad].
        speed: V, relative to the wall [speed].
        mass: m, of the particle(s) [mass].
        flow_stress: p [stress].
        psi: depth of contact over length of the cut ψ [-]; OpenFOAM's default.
        force_ratio: K [-]; OpenFOAM's default.

    Returns:
        Volume, in any consistent unit system.
    """
    return mass * speed**2 / (flow_stress * psi * force_ratio) * finnie(alpha, force_ratio)


def dnv_2015(alpha: Angle) -> Array:
    """F = 0.6 [sin α + 7.2 (sin α - sin²α)]^0.6 (1 - e^(-20α)), of DNV RP-O501 since 2015."""
    sine = jnp.sin(alpha)
    return 0.6 * (sine + 7.2 * (sine - sine**2)) ** 0.6 * -jnp.expm1(-20 * alpha)


# Copies of this table are in print with 110.804 for A₃ and 98.298 for A₆: they give F(90°) = 1.838.
_DNV_POLYNOMIAL = (9.370, 42.295, 110.864, 175.804, 170.137, 98.398, 31.211, 4.170)
_ECRC = (5.40, 10.11, 10.93, 6.33, 1.42)


def dnv_polynomial(alpha: Angle, coefficients: Sequence[float] = _DNV_POLYNOMIAL) -> Array:
    """F = Σ (-1)^(i+1) A_i α^i, i = 1 … 8, of DNV RP-O501 before 2015.

    Args:
        alpha: α [rad].
        coefficients: A_i; a table of one's own can be checked by F(90°) = 0.56851.
    """
    return _alternating(coefficients, alpha)


def ecrc(alpha: Angle) -> Array:
    """F = 5.40α - 10.11α² + 10.93α³ - 6.33α⁴ + 1.42α⁵, of the E/CRC in Tulsa (Zhang 2007)."""
    return _alternating(_ECRC, alpha)


def _alternating(coefficients: Sequence[float], alpha: Angle) -> Array:
    """The sum A₁α - A₂α² + A₃α³ - … of a published table."""
    signed = [a * (-1) ** i for i, a in enumerate(coefficients)]
    return jnp.polyval(jnp.array([*reversed(signed), 0.0]), jnp.asarray(alpha))


def oka(alpha: Angle, hardness: float = 1.8) -> Array:
    """Oka's (sin α)^n₁ [1 + Hv (1 - sin α)]^n₂ for sand (SiO₂), which is 1 at 90°.

    n₁ = 0.71 Hv^0.14 and n₂ = 2.4 Hv^-0.94: shallow angles gain on hard targets less.

    Args:
        alpha: α [rad].
        hardness: Vickers hardness Hv of the target [GPa]. 1.8 GPa is a carbon steel.

    References:
        Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101.
    """
    sine = jnp.sin(alpha)
    return sine ** (0.71 * hardness**0.14) * (1 + hardness * (1 - sine)) ** (2.4 * hardness**-0.94)


def arabnejad_cutting(alpha: Angle, force_ratio: float = 0.4) -> Array:
    """The cutting term: sin α (2K cos α - sin α)/(2K²) for tan α < K, cos²α/2 above.

    Args:
        alpha: α [rad].
        force_ratio: K [-], 0.4 for the carbon steels it was fitted to.

    References:
        H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050.
    """
    sine, cosine = jnp.sin(alpha), jnp.cos(alpha)
    shallow = sine * (2 * force_ratio * cosine - sine) / (2 * force_ratio**2)
    return jnp.where(jnp.tan(alpha) < force_ratio, shallow, cosine**2 / 2)


_ALL_ANGLES = (0.0, float(np.pi / 2))

CORRELATIONS: Mapping[str, Correlation] = types.MappingProxyType(
    {
        one.name: one
        for one in (
            Correlation("finnie-cfd", "Finnie (CFD, K = 2)", finnie, "-", _ALL_ANGLES,
                        "ductile targets; predicts no erosion at 90°, where tests find some",
                        "I. Finnie, Wear 3 (1960) 87-103, as in OpenFOAM's ParticleErosion"),
            Correlation("dnv", "DNV RP-O501 (2015)", dnv_2015, "-", _ALL_ANGLES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNVGL-RP-O501, Managing sand production and erosion, 2015"),
            Correlation("dnv-polynomial", "DNV RP-O501 (before 2015)", dnv_polynomial, "-", _ALL_ANGLES,
                        "sand on ductile steels and alloys, pipe flow",
                        "DNV RP O501, Erosive wear in piping systems, revision 4.2, 2007"),
            Correlation("ecrc", "E/CRC (Zhang 2007)", ecrc, "-", _ALL_ANGLES,
                        "sand on carbon steel and nickel alloy",
                        "Y. Zhang, E. P. Reuterfors, B. S. McLaury, S. A. Shirazi, E. F. Rybicki, "
                        "Wear 263 (2007) 330-338"),
            Correlation("oka", "Oka (SiO₂, Hv = 1.8 GPa)", oka, "-", _ALL_ANGLES,
                        "angular sand on metals; the exponents are those of SiO₂",
                        "Y. I. Oka, K. Okamura, T. Yoshida, Wear 259 (2005) 95-101"),
            Correlation("arabnejad", "Arabnejad, cutting (K = 0.4)", arabnejad_cutting, "-", _ALL_ANGLES,
                        "sand on steels; the cutting term alone, without deformation",
                        "H. Arabnejad, A. Mansouri, S. A. Shirazi, B. S. McLaury, Wear 332-333 (2015) 1044-1050"),
        )
    }
)  # fmt: skip
"""Every correlation by name, to overlay on a model's curve: `CORRELATIONS["dnv"].normalised(alpha)`."""
