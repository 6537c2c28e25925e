"""Erosion as engineers compute it today: fits to tests, by name, with all their factors.

`dnv(alpha, v0, material)` and the others give target lost per erodent, in kg/kg, mm³/kg or mm³ per impact.
Functions that end in `_angle`, `dnv_2015`, `dnv_polynomial` and `arabnejad_cutting` are the shapes F(α) alone.
All functions are vectorized, and differentiable by JAX; α is in radians from the surface, all else in SI units.
Outside of the range that a correlation is made for, as far as it is known, there is an `OutOfRangeWarning`.
"""

from erosion.correlations import pipes as pipes
from erosion.correlations.arabnejad import ARABNEJAD_MATERIALS as ARABNEJAD_MATERIALS
from erosion.correlations.arabnejad import ArabnejadMaterial as ArabnejadMaterial
from erosion.correlations.arabnejad import arabnejad as arabnejad
from erosion.correlations.arabnejad import arabnejad_cutting as arabnejad_cutting
from erosion.correlations.dnv import DNV_MATERIALS as DNV_MATERIALS
from erosion.correlations.dnv import DNVMaterial as DNVMaterial
from erosion.correlations.dnv import dnv as dnv
from erosion.correlations.dnv import dnv_2015 as dnv_2015
from erosion.correlations.dnv import dnv_brittle as dnv_brittle
from erosion.correlations.dnv import dnv_polynomial as dnv_polynomial
from erosion.correlations.ecrc import SHARPNESS as SHARPNESS
from erosion.correlations.ecrc import ecrc as ecrc
from erosion.correlations.ecrc import ecrc_angle as ecrc_angle
from erosion.correlations.finnie import FINNIE_MATERIALS as FINNIE_MATERIALS
from erosion.correlations.finnie import FinnieMaterial as FinnieMaterial
from erosion.correlations.finnie import finnie as finnie
from erosion.correlations.finnie import finnie_angle as finnie_angle
from erosion.correlations.finnie import finnie_volume as finnie_volume
from erosion.correlations.mclaury import AngleConstants as AngleConstants
from erosion.correlations.mclaury import mclaury as mclaury
from erosion.correlations.mclaury import mclaury_angle as mclaury_angle
from erosion.correlations.oka import OKA_MATERIALS as OKA_MATERIALS
from erosion.correlations.oka import OkaMaterial as OkaMaterial
from erosion.correlations.oka import oka as oka
from erosion.correlations.oka import oka_angle as oka_angle
from erosion.correlations.ranges import UNITS as UNITS
from erosion.correlations.ranges import OutOfRangeWarning as OutOfRangeWarning
from erosion.correlations.ranges import Range as Range
from erosion.correlations.registry import CORRELATIONS as CORRELATIONS
from erosion.correlations.registry import Correlation as Correlation
