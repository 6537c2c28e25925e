"""Methods by which a lane is integrated; see `erosion.ode.methods.base`."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from erosion.ode.methods.base import Method
from erosion.ode.methods.dormand_prince import DormandPrince
from erosion.ode.methods.rodas5p import Rodas5P

if TYPE_CHECKING:
    from erosion.ode.lane_equations import LaneEquations

METHODS: Mapping[str, type[Method]] = {"explicit": DormandPrince, "auto": DormandPrince, "rosenbrock": Rodas5P}


def method_of(problem: "LaneEquations") -> Method:
    """The method that a program is to use."""
    return METHODS[problem.options.method](problem)
