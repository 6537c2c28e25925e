"""How an impact ended: codes where there are many, words for people."""

import functools
from typing import Any

import jax

from erosion.engine.leaves import Layout, split
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import TABLE_1

OTHER_ENDS = ("no-cut", "failed", "unfinished")
"""What may be said of an impact that no event ended."""


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished".

    A code of an outcome is an index of these.
    """
    return names_of(split(model, TABLE_1)[0])


@functools.lru_cache(maxsize=256)
def names_of(layout: Layout) -> tuple[str, ...]:
    """Of all models of a layout."""

    def events(numbers: list[Any]) -> dict[str, Any]:
        model, p = layout.joined(numbers)
        return model.events(model.initial_state(p), p)

    return (*sorted(jax.eval_shape(events, layout.like())), *OTHER_ENDS)
