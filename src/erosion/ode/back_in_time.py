"""Motions back in time: those of another problem, in -t, that go forwards."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import Scalar
from erosion.ode.problem import Event, Problem


# Not functions within a function: they are alike where what they hold is.
@dataclasses.dataclass(frozen=True)
class _OfMinusT:
    fun: Callable[..., PyTree]

    @property
    def __wrapped__(self) -> Callable[..., PyTree]:
        """Of which Python reads the names of the arguments."""
        return self.fun

    def __call__(self, t: Scalar, y: PyTree, args: Any, **beside: Any) -> PyTree:
        return self.fun(-t, y, args, **beside)


@dataclasses.dataclass(frozen=True)
class _MinusOfMinusT(_OfMinusT):
    def __call__(self, t: Scalar, y: PyTree, args: Any, **beside: Any) -> PyTree:
        return jax.tree.map(lambda rate: -jnp.asarray(rate), super().__call__(t, y, args, **beside))


@dataclasses.dataclass(frozen=True)
class _Minus:
    times: Callable[[Any], PyTree]

    def __call__(self, args: Any) -> PyTree:
        return jax.tree.map(lambda time: -jnp.asarray(time), self.times(args))


def reflected(problem: Problem) -> Problem:
    """The problem of -t. An event's direction is that in which its function passes zero on the way, as in scipy."""

    def turned(event: Event) -> Event:
        function, reset = (each and _OfMinusT(each) for each in (event.function, event.reset))
        times = None if event.times is None else _Minus(event.times_of)
        return dataclasses.replace(event, function=function, reset=reset, times=times)

    events = {name: turned(event) for name, event in problem.events.items()}
    rates = {name: _MinusOfMinusT(rate) for name, rate in problem.integrals.items()}
    breaks = None if problem.breaks is None else _Minus(problem.break_times)
    return dataclasses.replace(
        problem, vector_field=_MinusOfMinusT(problem.vector_field), events=events, integrals=rates, breaks=breaks
    )


def early(t0: Any, shape: tuple[int, ...], ts: np.ndarray) -> np.ndarray:
    """Which times are before the start of which lanes, shape (…, times)."""
    # With one axis of lanes, or as it was given beside numbers that JAX traces.
    starts = np.reshape(t0, shape) if np.size(t0) == np.prod(shape, dtype=int) else np.broadcast_to(t0, shape)
    return ts < starts[..., None]


def chosen(flags: np.ndarray, this: PyTree, that: PyTree) -> PyTree:
    """Arrays (…, times, …) of this where the flags, shape (…, times), say so, and of that elsewhere."""

    def of(one: Any, other: Any) -> Any:
        wide = flags.reshape(*flags.shape, *[1] * (np.ndim(one) - flags.ndim))
        return (jnp if isinstance(other, jax.Array) else np).where(wide, one, other)

    return jax.tree.map(of, this, that)
