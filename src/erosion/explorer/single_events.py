"""The times at which each event alone would end the cut: the candidates of Figure 9, for any model."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from erosion.impacts.impact import impact
from erosion.impacts.outcomes import OTHER_ENDS, end_names
from erosion.models.base import CuttingModel, Scales, Tip
from erosion.parameters.parameters import Parameters

_PATIENCE = 12.0  # time scales; the page says that a later event never happens
_NEVER = "never"


class SingleEvent(CuttingModel):
    """A model whose cut is ended by one event alone, or by a clock if this event does not happen.

    The motion after the other events continues under the same forces.
    """

    model: CuttingModel
    event: str = eqx.field(static=True)

    def initial_state(self, p: Parameters) -> Any:
        """The model's own state, and a clock that counts time scales."""
        return self.model.initial_state(p), jnp.zeros_like(self.model.scales(p).time)

    def derivative(self, state: Any, p: Parameters) -> Any:
        """The model's own motion, and the rate of the clock."""
        return self.model.derivative(state[0], p), 1 / self.model.scales(p).time

    def tip(self, state: Any, p: Parameters) -> Tip:
        """The model's own tip."""
        return self.model.tip(state[0], p)

    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        """The one event, and the end of the clock."""
        return {self.event: self.model.events(state[0], p)[self.event], _NEVER: 1 - state[1] / _PATIENCE}

    def scales(self, p: Parameters) -> Scales:
        """The model's own scales."""
        return self.model.scales(p)


def end_times(model: CuttingModel, p: Parameters) -> dict[str, np.ndarray]:
    """The times at which each event alone would end the cut.

    Args:
        model: any model.
        p: parameters whose leaves are scalars or arrays that broadcast.

    Returns:
        By event name, times of the broadcast shape [s]; NaN where the event never happens.
    """
    closed = model.closed_form()
    if closed is not None:
        return {name: np.asarray(times) for name, times in closed.end_times(p).items()}
    return {name: _alone(model, name, p) for name in end_names(model) if name not in OTHER_ENDS}


def _alone(model: CuttingModel, event: str, p: Parameters) -> np.ndarray:
    hits = impact(SingleEvent(model=model, event=event), p)
    return np.where(np.asarray(hits.ended_by) == event, hits.t_c, np.nan)
