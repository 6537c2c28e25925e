"""What follows a trial step where no event is near: whether the lane moves on, and how long its next step is."""

from typing import NamedTuple

import jax.numpy as jnp

from erosion.array_types import Flag, Scalar

ADVANCING, LOCATING, ENDED, FAILED, UNFINISHED = range(5)

NOT_BEGUN, ARRIVED = -1, -2
"""The event of a lane that ends at its start, and of one that has reached the time asked for."""

_SAFETY = 0.8  # of the step that would just do
LONGEST = 1e4  # of the time scale, where nothing else bounds a lane; later is "unfinished"
_REJECTED = 256  # trials, and eight more for each accepted: then the error must be rounding
_STUCK = 512  # trials at a pace that would take more than all of them for a 25th of the time scale: rounding, too
_PACE = 2e-6  # of the time scale a trial
_SHORTEST = 1e-14  # of the time scale


class Limits(NamedTuple):
    """When a lane is given up.

    Args:
        trials: after so many.
        by_scale: whether the time scale says how long a lane may take at most, and how slow a pace is hopeless.
    """

    trials: int
    by_scale: Flag


class Control(NamedTuple):
    """Where a lane stands between two trials."""

    mode: Scalar
    time: Scalar  # from the start of the lane to that of the step
    trial: Scalar  # the length to try next
    step: Scalar  # the length that the error control would like
    high: Scalar  # while locating: a length past the event
    event: Scalar  # the index of the event that ended the lane
    left: Scalar  # from the last trial's end to the event
    trials: Scalar
    rejected: Scalar  # trials whose error was too large
    margin: Scalar  # the least value to which an event function has dipped so far


def begin(scale: Scalar, begins: Flag, finite: Flag, first: float) -> Control:
    """At the start: `scale` is the time scale, `begins` says whether the lane goes on from there."""
    zero = 0.0 * scale
    mode = jnp.where(finite & (scale > 0), jnp.where(begins, ADVANCING, ENDED), FAILED)
    return Control(
        mode=mode,
        time=zero,
        trial=first * scale,
        step=first * scale,
        high=zero,
        event=jnp.where(begins, 0, NOT_BEGUN),
        left=zero,
        trials=0 * mode,
        rejected=0 * mode,
        margin=zero + jnp.inf,
    )


def goes_on(control: Control) -> Flag:
    """Whether there is another step to try."""
    return control.mode <= LOCATING


def go_on(control: Control, error: Scalar, lowest: Scalar, scale: Scalar, limits: Limits) -> tuple[Control, Flag]:
    """The control after a trial with no event near, and whether the lane moves to the trial's end.

    Args:
        control: before the trial.
        error: over the tolerance; NaN is an error.
        lowest: the least value of an event function in the step.
        scale: the time scale.
        limits: when a lane is given up.
    """
    good = error <= 1
    step = next_step(control, error, good)
    moved = good & (control.mode == ADVANCING)
    after = counted(control, lowest, good, moved)
    return given_up(after._replace(step=step, trial=step), scale, limits), moved


def eighth_root(value: Scalar) -> Scalar:
    """The root of the step control's order."""
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(value)))


def next_step(control: Control, error: Scalar, good: Flag) -> Scalar:
    """The length that the error control would like, of the order of the embedded estimate."""
    factor = _SAFETY / eighth_root(error + 1e-30)
    wanted = jnp.where(jnp.isfinite(error), jnp.clip(factor, 0.2, 5.0), 0.2) * control.trial
    # A step shortened to end at a dip or an event says little about the next step.
    return jnp.where(good & (control.trial < control.step), jnp.maximum(wanted, control.step), wanted)


def counted(control: Control, lowest: Scalar, good: Flag, moved: Flag) -> Control:
    """The control with one more trial."""
    return control._replace(
        time=control.time + jnp.where(moved, control.trial, 0.0),
        trials=control.trials + 1,
        rejected=control.rejected + jnp.where(good, 0, 1),
        margin=jnp.where(moved, jnp.minimum(control.margin, lowest), control.margin),
    )


def given_up(control: Control, scale: Scalar, limits: Limits) -> Control:
    """The control, given up where the lane takes too long or the error must be rounding."""
    late, hopeless = (
        control.trials > limits.trials,
        control.rejected > _REJECTED + 8 * (control.trials - control.rejected),
    )
    if limits.by_scale is not False:
        late = (limits.by_scale & (control.time > LONGEST * scale)) | late
        stuck = (control.trials > _STUCK) & (control.time < _PACE * control.trials * scale)
        hopeless = (limits.by_scale & stuck) | hopeless
    mode = jnp.where(late, UNFINISHED, control.mode)
    return control._replace(mode=jnp.where(~(control.trial > _SHORTEST * scale) | hopeless, FAILED, mode))
