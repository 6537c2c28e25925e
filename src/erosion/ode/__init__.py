"""The first event of any small ODE, for one lane or millions, with first and second derivatives.

from erosion import ode

`Problem` says what moves and what happens on the way, `solve` integrates lanes to their events, `Solution` is what
came out. docs/develop/ode.md leads through the folder; docs/ode.md through its use.
"""

from erosion.ode.maximum import Maximum as Maximum, maximum as maximum
from erosion.ode.problem import Event as Event, Problem as Problem
from erosion.ode.solution import Solution as Solution
from erosion.ode.solve import solve as solve
