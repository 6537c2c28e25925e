"""The events of a program as one object: which count where a motion begins, in a trial, and at its end."""

import abc
import functools
from collections.abc import Callable, Sequence
from typing import ClassVar

import jax.numpy as jnp
from jax import lax

from erosion.arguments import Flag, Scalar
from erosion.ode import arming, crossings, cubics, step_control
from erosion.ode.arming import Watched
from erosion.ode.crossings import Ending, Trial
from erosion.ode.cubics import Ends
from erosion.ode.methods.base import Step
from erosion.ode.step_control import ADVANCING, MOMENT, Control, Limits

GRAZE = 1e4  # tolerances: a local minimum this close to zero may be a fall, after many turns of a fast spin
_GRAZE_MOST = 1e-2  # of an event function's size in a step: a local minimum that is farther from zero is no fall
_ZERO = 1e-15  # event functions of order 1 below this are zero at the start: cos(π/2) is 6e-17 in floating point


def graze(rtol: Scalar) -> Scalar:
    """How near zero a local minimum of an event function of order 1 may be a fall."""
    return jnp.minimum(GRAZE * rtol, _GRAZE_MOST)


class EventSet(abc.ABC):
    """All events of a program: which count where a motion begins, what a trial finds of them, and how it ends.

    Args:
        directions: of the events.

    Attributes:
        are_smooth: whether their functions are by their arithmetic.
        are_slow: whether none of them may move faster than the state.
        foresee: whether steps that get shorter are expected to go on so.
        locates_closely: whether the end of a motion is searched and checked with care, as a user's functions need it.
    """

    are_smooth: bool = True
    are_slow: bool = True
    foresee: ClassVar[bool] = False
    locates_closely: ClassVar[bool] = False

    def __init__(self, directions: Sequence[int]) -> None:
        self.directions = directions

    @abc.abstractmethod
    def begins(self, events: Sequence[Ends], scale: Scalar) -> Flag:
        """Whether a lane goes on from its start: every event function is positive or rises from zero."""

    def at_start(self, events: list[Ends], scale: Scalar, begins: Flag) -> list[Ends]:
        """The event functions at a start; zero without its rounding, where the lane begins."""
        return events

    @abc.abstractmethod
    def begun(self, events: list[Ends]) -> list[Ends]:
        """The event functions where a lane goes on from its start."""

    def in_modes(self, events: list[Ends]) -> list[Ends]:
        """The event functions where a motion begins; bounds of its modes are not below zero there."""
        return events

    @abc.abstractmethod
    def watch(self, events: Sequence[Ends], scale: Scalar) -> list[Watched]:
        """How they are watched in a step that begins there."""

    def resolved(self, start: Sequence[Ends], step: Step, h: Scalar) -> Step:
        """A trial whose error is that of the event functions, too."""
        return step

    @abc.abstractmethod
    def look(
        self, watched: Sequence[Watched], control: Control, start: Sequence[Ends], step: Step, scale: Scalar,
        clear: Sequence[Flag],
    ) -> Trial:  # fmt: skip
        """What a trial says."""

    def decide(
        self, watched: Sequence[Watched], control: Control, start: Sequence[Ends], step: Step,
        scale: Scalar, rtol: Scalar, limits: Limits, ending: Ending, reach: Callable[[], Scalar],
    ) -> tuple[Control, Flag]:  # fmt: skip
        """The control after a trial, and whether the lane moves to its end.

        Args:
            watched: how the events are watched.
            control: before the trial.
            start: the event functions there.
            step: the trial.
            scale: the time scale.
            rtol: relative tolerance.
            limits: when a lane is given up.
            ending: how the method finds the end.
            reach: the longest step that is allowed.
        """

        def goes_on() -> tuple[Control, Flag]:
            return step_control.go_on(control, step.error, scale, limits)

        def looks() -> tuple[Control, Flag]:
            trial = self.look(watched, control, start, step, scale, clear)
            return crossings.decide(control, trial, scale, limits, ending=ending, reach=reach)

        clear = crossings.are_clear(
            watched, control.trial_length, start, step.events, step.interior_samples, graze(rtol)
        )
        quiet = functools.reduce(jnp.logical_and, clear, control.mode == ADVANCING)
        return lax.cond(quiet, goes_on, looks)

    def counting(self, watched: Sequence[Watched], events: Sequence[Ends], event: Scalar) -> Sequence[Ends]:
        """The event functions near an event, turned so that they fall; far from zero those that do not count."""
        return events

    def first_at_end(
        self, control: Control, events: Sequence[Ends], scale: Scalar, time_to_end: Scalar | None
    ) -> tuple[Scalar, Scalar]:
        """The event that ends a motion and the time to it, from the functions that count near its end."""
        return crossings.first_fall(control, events)

    def at_once(self, events: Sequence[Ends], remaining: Scalar, scale: Scalar) -> list[Flag]:
        """Which of these events happen in a time that remains, beside the first."""
        return [jnp.asarray(False)] * len(events)

    def rivals(self, happening: Sequence[Flag]) -> Sequence[Flag]:
        """What else may end a motion, of what happens there; see `at_event`."""
        return ()


class Falling(EventSet):
    """All count from the start, and fall to their events."""

    def begins(self, events: Sequence[Ends], scale: Scalar) -> Flag:
        """See `EventSet`."""
        rises = ((jnp.abs(event.value) <= _ZERO) & (event.rate * scale > _ZERO) for event in events)
        going = ((event.value > _ZERO) | rising for event, rising in zip(events, rises, strict=True))
        return functools.reduce(jnp.logical_and, going, jnp.asarray(True))

    def begun(self, events: list[Ends]) -> list[Ends]:
        """See `EventSet`: where an event function is zero at the start it rises, or the lane ends there."""
        return [Ends(jnp.maximum(event.value, 0.0), event.rate) for event in events]

    def watch(self, events: Sequence[Ends], scale: Scalar) -> list[Watched]:
        """See `EventSet`."""
        return []

    def look(
        self, watched: Sequence[Watched], control: Control, start: Sequence[Ends], step: Step, scale: Scalar,
        clear: Sequence[Flag],
    ) -> Trial:  # fmt: skip
        """See `EventSet`."""
        return crossings.look(control, start, step.events, step.interior_samples, step.error, scale, clear=clear)


class Armed(EventSet):
    """Of any direction; each counts once it is before its event.

    Args:
        directions: see `EventSet`.
        own: how many of them are events of the problem; the others are bounds of modes, see `switches`.
        affine: of each event whether its function is affine in the state; others may move faster than it.
        smooth: whether all event functions are smooth.
        one_sided: whether nothing rivals the first event at an end.
    """

    foresee = locates_closely = True

    def __init__(
        self, directions: Sequence[int], *, own: int, affine: Sequence[bool], smooth: bool, one_sided: bool
    ) -> None:
        super().__init__(directions)
        self.one_sided = one_sided
        self.own, self.affine, self.are_smooth, self.are_slow = own, affine, smooth, all(affine)

    def at_start(self, events: list[Ends], scale: Scalar, begins: Flag) -> list[Ends]:
        """See `EventSet`."""
        time = jnp.where(begins, MOMENT * scale, 0.0)
        return [arming.without_rounding(event, time) for event in events]

    def resolved(self, start: Sequence[Ends], step: Step, h: Scalar) -> Step:
        """See `EventSet`."""
        error = step.error
        for i, (begin, end, affine) in enumerate(zip(start, step.events, self.affine, strict=True)):
            if not affine:
                samples = [(theta, values[i]) for theta, values in step.interior_samples]
                error = jnp.maximum(error, cubics.unresolved(begin, end, h, samples, smooth=self.are_smooth))
        return step._replace(error=error)

    def begins(self, events: Sequence[Ends], scale: Scalar) -> Flag:
        """See `EventSet`."""
        return arming.all_armed(self.directions[: self.own], events[: self.own], scale)

    def begun(self, events: list[Ends]) -> list[Ends]:
        """See `EventSet`."""
        return events

    def in_modes(self, events: list[Ends]) -> list[Ends]:
        """See `EventSet`."""
        return [*events[: self.own], *(Ends(jnp.maximum(each.value, 0.0), each.rate) for each in events[self.own :])]

    def watch(self, events: Sequence[Ends], scale: Scalar) -> list[Watched]:
        """See `EventSet`."""
        return arming.watch(self.directions, events, scale)

    def look(
        self, watched: Sequence[Watched], control: Control, start: Sequence[Ends], step: Step, scale: Scalar,
        clear: Sequence[Flag],
    ) -> Trial:  # fmt: skip
        """See `EventSet`."""
        return crossings.look_directed(
            watched, control, start, step.events, step.interior_samples, step.error, scale, clear=clear
        )

    def counting(self, watched: Sequence[Watched], events: Sequence[Ends], event: Scalar) -> Sequence[Ends]:
        """See `EventSet`."""
        return [
            arming.disarmed(cubics.signed(each, how.sign), how.armed | (event == i))
            for i, (each, how) in enumerate(zip(events, watched, strict=True))
        ]

    def first_at_end(
        self, control: Control, events: Sequence[Ends], scale: Scalar, time_to_end: Scalar | None
    ) -> tuple[Scalar, Scalar]:
        """See `EventSet`."""
        event, remaining = super().first_at_end(control, events, scale, time_to_end)
        return (event, remaining) if time_to_end is None else crossings.last_moment(event, remaining, events, scale)

    def at_once(self, events: Sequence[Ends], remaining: Scalar, scale: Scalar) -> list[Flag]:
        """See `EventSet`."""
        return crossings.at_once(events, remaining, scale)

    def rivals(self, happening: Sequence[Flag]) -> Sequence[Flag]:
        """See `EventSet`."""
        return () if self.one_sided else happening
