"""Whether results are as exact as asked for: two integrations tell by how much they differ.

There are two where small errors of a motion may be large ones of its results. An error is proportional to the
tolerance. So that of an integration is the change from another one, times a ratio of both tolerances.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Flag, PerLane, Scalar
from erosion.ode.events import GRAZE, graze
from erosion.ode.methods.base import LEAST, TIGHTEST
from erosion.ode.outputs import LaneOutputs
from erosion.ode.signature import Signature
from erosion.ode.step_control import Control
from erosion.ode.variational import Derivatives

if TYPE_CHECKING:
    from erosion.ode.integrator import LaneEnd

_DOUBT = 100.0  # errors are mostly smaller than the tolerance by this factor
_MANY_STEPS, _MANY_FACTOR = 64, 1e-2  # the errors of this many steps add up, and may grow from step to step
_CHEAPER, _CHEAPEST = 1e4, 1e-2  # times the tolerance, at most: of an integration that tells how errors grow
_DERIVED = 3e-2  # of its error, relative as that of a value, counts in a derivative: `Solution.inexact` tells the rest


def plan(
    control: Control, ended: Flag, amplification: Scalar, finite: Flag, rtol: Scalar, outputs: LaneOutputs
) -> Scalar:
    """The tolerance of a second integration of a lane; that of this one where none is needed.

    A greater one is of a cheaper integration, which tells whether a lane of many steps needs a smaller one.

    Args:
        control: at the lane's end.
        ended: whether it came to an end after it had begun.
        amplification: how many times larger the errors of the end may be than those of the state.
        finite: whether its results are.
        rtol: the tolerance of this integration.
        outputs: what is wanted.
    """
    factor = jnp.where(ended & (amplification > _DOUBT), _DOUBT / amplification, 1.0)
    factor = jnp.where(control.closest_approach < graze(rtol), jnp.minimum(factor, 1 / GRAZE), factor)
    cheaper = jnp.clip(_CHEAPEST / rtol, 1.0, _CHEAPER)
    after_many = outputs.after_many_steps(factor, _MANY_FACTOR, cheaper)
    factor = jnp.where(control.trials > _MANY_STEPS, after_many, factor)
    return jnp.where(finite, jnp.maximum(factor * rtol, jnp.minimum(TIGHTEST, rtol)), rtol)


class Reached(NamedTuple):
    """Results of lanes.

    Args:
        results: of the program.
        used: their tolerances.
        tapes: states at times, or steps, where they are written.
    """

    results: "LaneEnd"
    used: np.ndarray
    tapes: Sequence[np.ndarray]


class Errors(NamedTuple):
    """The greatest errors of lanes' results.

    Args:
        own: relative to the size of each value, of derivatives a share.
        greatest: relative to the greatest size that it has had.
    """

    own: np.ndarray
    greatest: np.ndarray


class AccuracyCheck:
    """Compares two integrations of lanes.

    Args:
        signature: of problem and arguments.
        parameters: of all lanes.
        directions: of the derivatives, see `integrate`.
    """

    def __init__(
        self, signature: Signature, parameters: Sequence[PerLane], directions: Sequence[int | PerLane]
    ) -> None:
        self.signature, self.parameters, self.directions = signature, parameters, directions

    def compare(self, lanes: np.ndarray, before: Reached, after: Reached, ratio: np.ndarray) -> Errors:
        """The errors of some lanes, a `ratio` of the change from one integration to another.

        They are 1 where these end otherwise.
        """
        events = len(self.signature.event_names)
        outcome, old = after.results.outcome, before.results.outcome
        values, of_times = (_values(each.results) for each in (before, after)), 0.0
        before_it, found = values
        with np.errstate(all="ignore"):
            if self.signature.options.saves:
                # Relative to the greatest size among the times: a state may pass through zero there.
                states = before.tapes[-1][:, :, 0], after.tapes[-1][:, :, 0]
                for old_part, part in zip(*(np.moveaxis(each, -1, 0) for each in states), strict=True):
                    moved, size = (np.fmax.reduce(np.abs(each), 1, initial=0.0) for each in (part - old_part, part))
                    of_times = np.fmax(of_times, moved / size * ratio)
            sizes = [np.abs(new) for new in found]
            greatest = [*sizes]
            # At an event a part of the state may be zero by definition, and nothing is known relative to it.
            for i, least in enumerate(after.results.least):
                greatest[i] = np.maximum(sizes[i], least / LEAST)
                sizes[i] = np.where(outcome < events, greatest[i], np.maximum(sizes[i], least))
            moved = np.abs(np.array(found) - np.array(before_it))
            changes = np.array([moved / np.array(sizes), moved / np.array(greatest)])
            changes = np.where(outcome == old, np.nan_to_num(changes, posinf=1.0), 1.0) * ratio
            error, of_greatest = changes.max(1)
            of_derivatives = self._of_derivatives(lanes, before.results, after.results, greatest) * ratio
            error, of_greatest = np.fmax(error, _DERIVED * of_derivatives), np.fmax(of_greatest, of_derivatives)
            return Errors(np.fmax(error, of_times), of_greatest)

    def _of_derivatives(
        self, lanes: np.ndarray, before: "LaneEnd", after: "LaneEnd", greatest: Sequence[np.ndarray]
    ) -> np.ndarray | float:
        """The greatest change of a derivative, relative to it or to the value by a change of a number by its own size.

        What a chain or a chaotic motion multiplies in its derivatives need not show in its values.
        """
        if not (self.signature.options.outputs.check_derivatives and self.directions):
            return 0.0
        parameters = self.signature.of_lanes(self.parameters, lanes)
        units = [self._units(parameters, each, lanes.size) for each in of_lanes(self.directions, lanes)]
        by_one, by_other = units[0], units[-1]
        error = np.zeros(lanes.size)
        one, other = (
            Derivatives(*(part and [*part[1:], part[0]] for part in each.quantities)) for each in (before, after)
        )
        for kind, unit in (("by_first", by_one), ("by_second", by_other), ("mixed", by_one * by_other)):
            pairs = zip(getattr(one, kind) or [], getattr(other, kind) or [], greatest, strict=False)
            for old, new, size in pairs:
                change = np.abs(new - old) / np.maximum(np.abs(new), size / unit)
                error = np.fmax(error, np.nan_to_num(change, posinf=1.0))
        return error

    def _units(self, parameters: Sequence[PerLane], direction: int | PerLane, lanes: int) -> np.ndarray:
        """The size of the number that a direction changes; 1 where it is zero. Shape (lanes,)."""
        sizes = zip(self.signature.parameter_scale(parameters), self.signature.shapes, strict=True)
        columns = [np.broadcast_to(np.asarray(size), (lanes, *shape)).reshape(lanes, -1) for size, shape in sizes]
        unit = np.concatenate(columns, axis=1)[np.arange(lanes), np.asarray(direction, int)]
        return np.where(unit == 0, 1.0, unit)


def of_lanes(directions: Sequence[int | PerLane], lanes: np.ndarray) -> tuple[int | PerLane, ...]:
    """The directions of some lanes."""
    return tuple(each if isinstance(each, int) or not np.ndim(each) else each[lanes] for each in directions)


def _values(results: "LaneEnd") -> list[np.ndarray]:
    """LaneOutputs and times."""
    return [*results.outputs.value, results.time.value]
