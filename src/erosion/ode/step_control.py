"""Step control: whether a trial is taken, how long the next one is, and when a lane stops trying."""

import os
from typing import NamedTuple

import jax
import jax.numpy as jnp

from erosion.arguments import Flag, Scalar


class PrecisionError(RuntimeError):
    """JAX is running in single precision."""


def require_float64() -> None:
    """Raise where JAX would compute in float32.

    Importing `erosion` turns 64-bit mode on, so this only fails where the environment
    (`JAX_ENABLE_X64=0`) or a later `jax.config.update` has turned it off.

    Raises:
        PrecisionError: with the line that mends it.
    """
    if not jax.config.jax_enable_x64:  # pyrefly: ignore
        raise PrecisionError(
            "erosion needs float64, but JAX's 64-bit mode is off; unset JAX_ENABLE_X64 or call "
            'jax.config.update("jax_enable_x64", True) before computing.'
        )


def require_xla() -> None:
    """Raise where XLA cannot compute, which the batches of the engine do without.

    Raises:
        PrecisionError: see `require_float64`.
        RuntimeError: where the device that JAX is to use is not there, or where this process was forked
            from one in which XLA has computed: its threads do not come along, and it would wait for ever.
    """
    require_float64()
    global _process
    if _process is None:
        try:
            jax.default_backend()
        except (AssertionError, RuntimeError) as error:
            asked = os.environ.get("JAX_PLATFORMS", "")
            raise RuntimeError(
                f"JAX has no device to compute on, as JAX_PLATFORMS={asked} asks for one that is not here; unset it."
            ) from error
        _process = os.getpid()
    if _process != os.getpid():
        raise RuntimeError(
            "This process was forked from one in which JAX has computed, and JAX cannot go on in it; "
            'start processes by the method "spawn": multiprocessing.get_context("spawn").'
        )


_process: int | None = None
"""The process in which XLA has started."""


ADVANCING, LOCATING, ENDED, FAILED, UNFINISHED = range(5)

NOT_BEGUN, ARRIVED, STIFF, SLIDES = -1, -2, -3, -4
"""The event of a lane that ends at its start, of one at the time asked for, and of one that is given up: as stiff, or
as its rates point to a switch from both sides."""

FIRST_STEP = 0.17  # of the time scale
MOMENT = 1e-12  # of the time scale: what happens within it happens at once
ULPS = 1e-15  # of a number: so little is rounding
TINY = 1e-300  # keeps 0/0 away
_SAFETY = 0.8  # of the step that would just do
_TREND = 0.5  # of a step's shortening is expected of the next step, too
LONGEST = 1e4  # of the time scale, where nothing else bounds a lane; later is "unfinished"
_REJECTED = 256  # trials, and eight more for each accepted: then the error must be rounding
_STUCK = 512  # trials at a pace that would take more than all of them for a 25th of the time scale: rounding, too
_PACE = 2e-6  # of the time scale a trial
_SHORTEST = 1e-14  # of the time scale


class Limits(NamedTuple):
    """When a lane is given up, and how its steps follow one another.

    Args:
        trials: after so many.
        by_scale: whether the time scale says how long a lane may take at most, and how slow a pace is hopeless.
        foresees: whether steps that get shorter are expected to go on so.
    """

    trials: int
    by_scale: Flag
    foresees: bool = False


class Control(NamedTuple):
    """Where a lane stands between two trials."""

    mode: Scalar
    time: Scalar  # from the start of the lane to that of the step
    trial_length: Scalar  # the length to try next
    step: Scalar  # the length that the error control would like
    high: Scalar  # while locating: a length past the event
    event: Scalar  # the index of the event that ended the lane
    time_to_event: Scalar  # from the last trial's end to the event
    trials: Scalar
    rejected: Scalar  # trials whose error was too large
    closest_approach: Scalar  # the least value to which an event function has dipped so far
    wanted: Scalar  # the length that the error control asked for after the last accepted step; 0 before it


def begin(scale: Scalar, begins: Flag, finite: Flag, first: float) -> Control:
    """At the start: `scale` is the time scale, `begins` says whether the lane goes on from there."""
    zero = 0.0 * scale
    mode = jnp.where(finite & (scale > 0), jnp.where(begins, ADVANCING, ENDED), FAILED)
    return Control(
        mode=mode,
        time=jnp.zeros(()),  # also where the scale is NaN
        trial_length=first * scale,
        step=first * scale,
        high=zero,
        event=jnp.where(begins, 0, NOT_BEGUN),
        time_to_event=zero,
        trials=0 * mode,
        rejected=0 * mode,
        closest_approach=zero + jnp.inf,
        wanted=zero,
    )


def goes_on(control: Control) -> Flag:
    """Whether there is another step to try."""
    return control.mode <= LOCATING


def go_on(control: Control, error: Scalar, scale: Scalar, limits: Limits) -> tuple[Control, Flag]:
    """The control after a trial with no event near, and whether the lane moves to the trial's end.

    Args:
        control: before the trial.
        error: over the tolerance; NaN is an error.
        scale: the time scale.
        limits: when a lane is given up.
    """
    good = error <= 1
    wanted = next_step(control, error, good)
    step = foreseen_step(control, wanted, good, limits)
    after = counted(control, jnp.inf, good, good)._replace(wanted=jnp.where(good, wanted, control.wanted))
    return given_up(after._replace(step=step, trial_length=step), scale, limits), good


def eighth_root(value: Scalar) -> Scalar:
    """The root of the step control's order."""
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(value)))


def next_step(control: Control, error: Scalar, good: Flag) -> Scalar:
    """The length that the error control would like, of the order of the embedded estimate."""
    factor = _SAFETY / eighth_root(error + 1e-30)
    wanted = jnp.where(jnp.isfinite(error), jnp.clip(factor, 0.2, 5.0), 0.2) * control.trial_length
    # A step shortened to end at a local minimum or an event says little about the next step.
    return jnp.where(good & (control.trial_length < control.step), jnp.maximum(wanted, control.step), wanted)


def foreseen_step(control: Control, wanted: Scalar, good: Flag, limits: Limits) -> Scalar:
    """The next step's length: shorter than the error control would like where it liked a longer one before."""
    if not limits.foresees:
        return wanted
    shorter = jnp.minimum(wanted / control.wanted, 1.0)
    return jnp.where(good, wanted * (1 - _TREND + _TREND * shorter), wanted)


def counted(control: Control, lowest: Scalar, good: Flag, moved: Flag) -> Control:
    """The control with one more trial."""
    return control._replace(
        time=control.time + jnp.where(moved, control.trial_length, 0.0),
        trials=control.trials + 1,
        rejected=control.rejected + jnp.where(good, 0, 1),
        closest_approach=jnp.where(moved, jnp.minimum(control.closest_approach, lowest), control.closest_approach),
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
    return control._replace(mode=jnp.where(~(control.trial_length > _SHORTEST * scale) | hopeless, FAILED, mode))
