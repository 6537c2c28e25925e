"""Erosion as engineers compute it today: fits to tests, by name, with all their factors.

`dnv(alpha, v0, material)` and the others give target lost per erodent, in kg/kg, mm³/kg or mm³ per impact.
Functions that end in `_angle`, `dnv_2015`, `dnv_polynomial` and `arabnejad_cutting` are the shapes F(α) alone.
All functions are vectorized, and differentiable by JAX; α is in radians from the surface, all else in SI units.
Outside of the range that a correlation is made for, as far as it is known, there is an `OutOfRangeWarning`.
"""

from erosion.correlations.families import ARABNEJAD_MATERIALS as ARABNEJAD_MATERIALS
from erosion.correlations.families import DNV_MATERIALS as DNV_MATERIALS
from erosion.correlations.families import FINNIE_MATERIALS as FINNIE_MATERIALS
from erosion.correlations.families import OKA_MATERIALS as OKA_MATERIALS
from erosion.correlations.families import AngleConstants as AngleConstants
from erosion.correlations.families import ArabnejadMaterial as ArabnejadMaterial
from erosion.correlations.families import DNVMaterial as DNVMaterial
from erosion.correlations.families import FinnieMaterial as FinnieMaterial
from erosion.correlations.families import OkaMaterial as OkaMaterial
from erosion.correlations.families import arabnejad as arabnejad
from erosion.correlations.families import arabnejad_cutting as arabnejad_cutting
from erosion.correlations.families import dnv as dnv
from erosion.correlations.families import dnv_2015 as dnv_2015
from erosion.correlations.families import dnv_brittle as dnv_brittle
from erosion.correlations.families import dnv_polynomial as dnv_polynomial
from erosion.correlations.families import ecrc as ecrc
from erosion.correlations.families import ecrc_angle as ecrc_angle
from erosion.correlations.families import finnie as finnie
from erosion.correlations.families import finnie_angle as finnie_angle
from erosion.correlations.families import finnie_volume as finnie_volume
from erosion.correlations.families import mclaury as mclaury
from erosion.correlations.families import mclaury_angle as mclaury_angle
from erosion.correlations.families import oka as oka
from erosion.correlations.families import oka_angle as oka_angle
from erosion.correlations.ranges import SHARPNESS as SHARPNESS
from erosion.correlations.ranges import UNITS as UNITS
from erosion.correlations.ranges import OutOfRangeWarning as OutOfRangeWarning
from erosion.correlations.ranges import Range as Range
from erosion.correlations.registry import CORRELATIONS as CORRELATIONS
from erosion.correlations.registry import Correlation as Correlation
