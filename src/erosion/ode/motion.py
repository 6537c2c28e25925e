"""The motion of one lane: what is integrated, and the functions of it."""

import abc
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import PyTree

from erosion.arguments import Flag, Scalar
from erosion.ode.signature import Clock


class Augmented(NamedTuple):
    """What is integrated: the state, and the integrals so far."""

    state: tuple[Scalar, ...]
    integrals: tuple[Scalar, ...]


class Motion(abc.ABC):
    """The motion of one lane; see `erosion.ode.reduction`."""

    clock: Clock

    @abc.abstractmethod
    def initial(self) -> Augmented:
        """State and integrals at the start."""

    @abc.abstractmethod
    def rate(self, at: Augmented) -> Augmented:
        """Their time derivative."""

    @abc.abstractmethod
    def events(self, at: Augmented) -> list[Scalar]:
        """The event functions, in their order: positive before their event; those of either direction as they are."""

    @abc.abstractmethod
    def outputs(self, at: Augmented) -> list[Scalar]:
        """What is wanted at the end: the elements of the state, where they are, and the integrals."""

    def after(self, event: int, at: Augmented) -> Augmented:
        """State and integrals after an event, which the motion may survive."""
        return at

    def ends(self, event: int, at: Augmented) -> Flag:
        """Whether it does not."""
        return jnp.asarray(False)


OfMotion = Callable[[Augmented, Motion], PyTree]
"""A function of the state and its motion; its value is a number, or numbers."""


def outputs_of(at: Augmented, motion: Motion) -> list[Scalar]:
    """What is wanted of a motion."""
    return motion.outputs(at)


def events_of(at: Augmented, motion: Motion) -> list[Scalar]:
    """The event functions of a motion."""
    return motion.events(at)


def event_function(event: Scalar) -> OfMotion:
    """The function of an event, by its index; 0 for one below 0."""
    return lambda at, motion: of_event(event, motion.events(at), jnp.zeros(()))


def of_event(event: Scalar, numbers: Sequence[Scalar], otherwise: Scalar) -> Scalar:
    """That number of all events' which is the event's; another one for an index below 0."""
    for i, number in enumerate(numbers):
        otherwise = jnp.where(event == i, number, otherwise)
    return otherwise
