import pytest

import erosion
from erosion.correlations.registry import OKA_PARTICLES, oka_normal


@pytest.mark.parametrize("material", ["steel", "carbon-steel", "stainless-steel", "aluminium"])
def test_sand_is_that_of_the_correlation_at_90_degrees(material):
    expected = erosion.correlations.oka(1.5707963267948966, 90.0, 2e-4, material=material, units="mm3/kg")
    assert oka_normal("sand", 90.0, 2e-4, material) * 1e9 == pytest.approx(float(expected), rel=1e-9)


def test_other_abrasives_have_the_published_constants():
    # At v' and D' the erosion of carbon steel (W = 3) is K 3^-k1, by hand.
    for particle, expected in (("silicon-carbide", 45 * 3**0.05), ("glass-beads", 27 * 3**0.16)):
        constants = OKA_PARTICLES[particle]
        erosion_ = oka_normal(particle, constants.speed, constants.diameter, "carbon-steel")
        assert erosion_ * 1e9 == pytest.approx(expected, rel=1e-9)
    # 3.0 Hv^0.085 with 1.18 GPa.
    faster = oka_normal("silicon-carbide", 198.0, 326e-6, "carbon-steel")
    assert faster == pytest.approx(
        oka_normal("silicon-carbide", 99.0, 326e-6, "carbon-steel") * 2 ** (3.0 * 1.18**0.085)
    )
