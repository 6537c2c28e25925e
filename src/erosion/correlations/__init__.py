"""Erosion as engineers compute it today: fits to tests, by name, with all their factors.

`dnv(alpha, v0, material)` and the others give target lost per particle, in kg/kg, mm³/kg or mm³ per impact.
Functions that end in `_angle`, `dnv_2015`, `dnv_polynomial` and `arabnejad_cutting` are the shapes F(α) alone.
All functions are vectorized, and differentiable by JAX; α is in radians from the surface, all else in SI units.
Outside of the range that a correlation is made for, as far as it is known, there is an `OutOfRangeWarning`.
"""

from erosion.correlations.families import (
    ARABNEJAD_MATERIALS as ARABNEJAD_MATERIALS,
    DNV_MATERIALS as DNV_MATERIALS,
    FINNIE_MATERIALS as FINNIE_MATERIALS,
    OKA_MATERIALS as OKA_MATERIALS,
    AngleConstants as AngleConstants,
    ArabnejadMaterial as ArabnejadMaterial,
    DNVMaterial as DNVMaterial,
    FinnieMaterial as FinnieMaterial,
    OkaMaterial as OkaMaterial,
    arabnejad as arabnejad,
    arabnejad_cutting as arabnejad_cutting,
    dnv as dnv,
    dnv_2015 as dnv_2015,
    dnv_brittle as dnv_brittle,
    dnv_polynomial as dnv_polynomial,
    ecrc as ecrc,
    ecrc_angle as ecrc_angle,
    finnie as finnie,
    finnie_angle as finnie_angle,
    finnie_volume as finnie_volume,
    mclaury as mclaury,
    mclaury_angle as mclaury_angle,
    oka as oka,
    oka_angle as oka_angle,
)
from erosion.correlations.ranges import (
    SHARPNESS as SHARPNESS,
    UNITS as UNITS,
    OutOfRangeWarning as OutOfRangeWarning,
    Range as Range,
)
from erosion.correlations.registry import CORRELATIONS as CORRELATIONS, Correlation as Correlation
