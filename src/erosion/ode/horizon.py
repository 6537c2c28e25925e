"""How far a motion may go: to a time, or for ever."""

import jax.numpy as jnp

from erosion.arguments import Flag, Scalar
from erosion.ode import crossings
from erosion.ode.step_control import Control


class Horizon:
    """No end but an event."""

    def reach(self, control: Control) -> Scalar:
        """How long a step may be, as is asked for."""
        return jnp.asarray(jnp.inf)

    def within(self, control: Control) -> Control:
        """The control, of which no step goes further."""
        return control

    def is_far(self, control: Control, steps: float) -> Flag:
        """Whether it takes so many steps to the end."""
        return True


class To(Horizon):
    """To a time.

    Args:
        time: since the motion began.
        max_step: no step is longer.
    """

    def __init__(self, time: Scalar, max_step: Scalar) -> None:
        self.time, self.max_step = time, max_step

    def reach(self, control: Control) -> Scalar:
        """See `Horizon`."""
        return jnp.minimum(self.max_step, self.time - control.time)

    def within(self, control: Control) -> Control:
        """See `Horizon`."""
        return crossings.stop_at(
            control._replace(trial_length=jnp.minimum(control.trial_length, self.max_step)), self.time
        )

    def is_far(self, control: Control, steps: float) -> Flag:
        """See `Horizon`."""
        return self.time - control.time > steps * control.step
