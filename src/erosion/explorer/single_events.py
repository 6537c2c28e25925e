"""When each event alone would end the cut: the candidates of Figure 9, for any model."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.engine.impact import impact
from erosion.engine.outcomes import OTHER_ENDS, end_names
from erosion.models.base import CuttingModel, Scales, Tip
from erosion.parameters.parameters import Parameters

_PATIENCE = 12.0  # time scales; an event later than this is taken never to happen
_NEVER = "never"


class SingleEvent(CuttingModel):
    """A model whose cut only one of its events ends, or a clock where that never happens.

    The motion past the other events is the one that the same forces would cause.
    """

    model: CuttingModel
    event: str = eqx.field(static=True)

    def initial_state(self, p: Parameters) -> Any:
        """The model's own state and a clock, in time scales."""
        return self.model.initial_state(p), jnp.zeros_like(self.model.scales(p).time)

    def derivative(self, state: Any, p: Parameters) -> Any:
        """The model's own motion; the clock runs."""
        return self.model.derivative(state[0], p), 1 / self.model.scales(p).time

    def tip(self, state: Any, p: Parameters) -> Tip:
        """The model's own tip."""
        return self.model.tip(state[0], p)

    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        """The one event, and the end of patience."""
        return {self.event: self.model.events(state[0], p)[self.event], _NEVER: 1 - state[1] / _PATIENCE}

    def scales(self, p: Parameters) -> Scales:
        """The model's own."""
        return self.model.scales(p)


def end_times(model: CuttingModel, p: Parameters) -> dict[str, np.ndarray]:
    """When each event alone would end the cut.

    Args:
        model: any.
        p: parameters whose leaves are scalars or arrays that broadcast.

    Returns:
        By event name, times of the broadcast shape [s]; NaN where it never happens.
    """
    closed = model.closed_form()
    if closed is not None:
        return {name: np.asarray(times) for name, times in closed.end_times(p).items()}
    return {name: _alone(model, name, p) for name in end_names(model) if name not in OTHER_ENDS}


def _alone(model: CuttingModel, event: str, p: Parameters) -> np.ndarray:
    hits = impact(SingleEvent(model=model, event=event), p)
    return np.where(np.asarray(hits.ended_by) == event, hits.t_c, np.nan)
