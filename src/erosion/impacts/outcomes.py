"""How an impact ended: the one table of names and sentences.

A code below the number of the model's events is an event, in the order of their names. The codes after these
are the others, in the order of `OTHER_ENDS`, and then "arrived": at the time asked for, before the end.
"""

from collections.abc import Mapping

from erosion.impacts.lanes import layout_of
from erosion.models.base import NO_CUT, CuttingModel
from erosion.ode.step_control import LONGEST
from erosion.parameters.parameters import TABLE_1

OTHER_ENDS: Mapping[str, str] = {
    NO_CUT: "nothing is cut",
    "failed": "the motion or the volume is not finite, or no step of the motion is exact enough",
    "unfinished": f"no event ended the cut within {LONGEST:,.0f} time scales",
}
"""The ends that are no events, with a sentence on each."""

NO_DERIVATIVES = "the volume is right, but a jump or an infinite rate of the force leaves it without these derivatives"
"""Of an impact that has a result where fewer derivatives are asked for."""


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished".

    The code of an outcome is an index of these.
    """
    return (*layout_of(model, TABLE_1).event_names, *OTHER_ENDS)
