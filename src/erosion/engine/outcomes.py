"""How an impact ended: the one table of codes, names and sentences.

A code below the number of the model's events is an event, in the order of their names. The codes after these
are the others, in the order of `OTHER_ENDS`, and then "arrived": at the time asked for, before the end.
"""

import functools
from collections.abc import Mapping

import jax
import numpy as np

from erosion.array_types import Number
from erosion.engine.leaves import Layout, split
from erosion.engine.step_control import LONGEST_CUT
from erosion.models.base import NO_CUT, CuttingModel, Events
from erosion.parameters.parameters import TABLE_1

AFTER_NO_CUT, AFTER_FAILED, AFTER_UNFINISHED, AFTER_ARRIVED = range(4)
"""Codes of ends that are no events, counted from the number of events."""

OTHER_ENDS: Mapping[str, str] = {
    NO_CUT: "nothing is cut",
    "failed": "the motion or the volume is not finite, or no step of the motion is exact enough",
    "unfinished": f"no event ended the cut within {LONGEST_CUT:,.0f} time scales",
}
"""The ends that are no events, with a sentence on each."""

NO_DERIVATIVES = "the volume is right, but a jump or an infinite rate of the force leaves it without these derivatives"
"""Of an impact that has a result where fewer derivatives are asked for."""


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished".

    The code of an outcome is an index of these.
    """
    return names_of(split(model, TABLE_1)[0])


@functools.lru_cache(maxsize=256)
def names_of(layout: Layout) -> tuple[str, ...]:
    """`end_names` for all models of a layout."""

    def events(numbers: list[Number]) -> Events:
        model, p = layout.joined(numbers)
        return model.events(model.initial_state(p), p)

    return (*sorted(jax.eval_shape(events, layout.structs())), *OTHER_ENDS)


def has_no_result(layout: Layout, codes: np.ndarray) -> np.ndarray:
    """Whether impacts failed or are unfinished."""
    events = len(names_of(layout)) - len(OTHER_ENDS)
    return (codes == events + AFTER_FAILED) | (codes == events + AFTER_UNFINISHED)
