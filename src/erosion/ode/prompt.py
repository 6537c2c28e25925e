"""Calls of the integrator for a few lanes, which spend little time in Python."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from erosion.lanes.lanewise import PreparedCall
from erosion.ode.batch import integrator_of
from erosion.ode.integrator import LaneEnd
from erosion.ode.signature import Signature

FEW = 16
"""Lanes times directions: `PromptCalls` compute so many at most."""


class _PromptCall(NamedTuple):
    """A call, its inputs and results as arrays.

    Args:
        prepared: the call.
        inputs: numbers of a lane, shape (lanes, directions, …).
        first: results along the first direction, shape (lanes,).
        end: results, shape (lanes, directions).
    """

    prepared: PreparedCall
    inputs: list[np.ndarray]
    first: LaneEnd
    end: LaneEnd


class PromptCalls:
    """Calls for some lanes, of which each is done after one integration; their memory is laid out once.

    Args:
        signature: of problem and arguments.
        order: of derivatives, one that the method has.
        places: of the directions of derivatives, see `integrate_along`; shape (0, 1) without any.
        lanes: their number.

    Attributes:
        signature: of problem and arguments.
    """

    def __init__(self, signature: Signature, order: int, places: np.ndarray, lanes: int) -> None:
        self.signature, self._lanes, self._directions = signature, lanes, places.shape[1]
        self._places = np.tile(places, lanes)
        self._program, _ = integrator_of(signature, order, (), len(places))
        self._lost = {signature.end_names.index(name) for name in ("failed", "unfinished")}
        self._unused: list[_PromptCall] = []

    def run(
        self, parameters: Sequence[np.ndarray], rtol: float, read: Callable[[LaneEnd, LaneEnd], list[np.ndarray]]
    ) -> list[np.ndarray] | None:
        """What `read` makes of the results, None where a lane is doubtful.

        Args:
            parameters: of the lanes; see `integrate`.
            rtol: relative tolerance.
            read: takes the results along the first direction, shape (lanes,), and all, shape (lanes, directions).
        """
        # Each has its own: another thread, or a signal's handler, may call while it runs.
        call = self._unused.pop() if self._unused else self._new()
        for place, number, shape in zip(call.inputs, parameters, self.signature.shapes, strict=True):
            place[...] = number[:, None] if number.ndim > len(shape) else number
        call.prepared.inputs[-1][...] = rtol
        call.prepared.run()
        found = None if self._is_doubtful(call.prepared.results, rtol) else read(call.first, call.end)
        self._unused.append(call)
        return found

    def _new(self) -> _PromptCall:
        count = self._lanes, self._directions
        prepared = self._program.prepared(self._lanes * self._directions)
        numbers = len(self.signature.shapes)
        for place, number in zip(prepared.inputs[numbers:], self._places, strict=False):
            place[...] = number
        inputs = [place.reshape(*count, *place.shape[1:]) for place in prepared.inputs[:numbers]]
        end = prepared.results._replace(error=np.zeros(self._lanes * self._directions))
        end = jax.tree.map(lambda part: part.reshape(count), end)
        return _PromptCall(prepared, inputs, jax.tree.map(lambda part: part[:, 0], end), end)

    def _is_doubtful(self, end: LaneEnd, rtol: float) -> bool:
        """Whether a lane is stiff, took many steps, needs another tolerance, or has no results; see `integrate`."""
        if end.stiff is not None:
            most = self.signature.options.max_steps
            if any(end.stiff.tolist()) or max(end.trials.tolist()) > most:
                return True
        return set(end.rtol_next.tolist()) != {rtol} or not self._lost.isdisjoint(end.outcome.tolist())
