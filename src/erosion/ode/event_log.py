"""All events on the way of lanes: recorded while the lanes are integrated once more."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import PerImpact
from erosion.lanes.lanewise import WIDTH
from erosion.ode.batch import in_threads, integrator_of
from erosion.ode.ensemble import Lanes, named_events, shaped
from erosion.ode.gradient import first_method
from erosion.ode.tape import EventLog
from erosion.output.tables import format_number

_CHUNK, _FEW = 2**12, 64  # lanes that are recorded at once, and that one thread computes sooner
_MEMORY = 2**24  # bytes of a log, at once


class Passed(NamedTuple):
    """The events on the way of lanes, arrays (…, n); n is the greatest number of them.

    Args:
        name: of the event; "" after the last.
        t: when; NaN after the last.
        y: the state just before a reset, a pytree of arrays; NaN after the last.
        at_once: by name whether an event happens there, as others may at the same time.
    """

    name: np.ndarray
    t: np.ndarray
    y: PyTree
    at_once: Mapping[str, np.ndarray]

    def __repr__(self) -> str:
        happened = self.name[self.name != ""]
        return f"Passed({format_number(happened) or 'no events'}, t={format_number(self.t, 6)})"


def events_passed(lanes: Lanes, count: PerImpact, tolerance: PerImpact, stiff: PerImpact) -> Passed:
    """The events on the way of lanes.

    Args:
        lanes: the lanes.
        count: how many events each has.
        tolerance: of each lane's results.
        stiff: whether the method for stiff motions integrated it.
    """
    count, tolerance, stiff = (np.reshape(np.asarray(each), -1) for each in (count, tolerance, stiff))
    most = int(count.max(initial=0))
    rows = np.full((lanes.size, most, EventLog.BESIDE + lanes.signature.rows), np.nan)
    for method, those in ((first_method(lanes.signature), ~stiff), ("rosenbrock", stiff)):
        which = np.flatnonzero(those & (count > 0))
        own = lanes.signature.renewed().wanting(method=method, logs=True, records=False, saves=False)
        by_count = which[np.argsort(count[which], kind="stable")]
        in_threads(
            lambda block, stop, own=own: _record(lanes._replace(signature=own), block, count, tolerance, rows, stop),
            by_count, _CHUNK, _FEW,
        )  # fmt: skip
    wide = lanes._replace(shape=(*lanes.shape, most))
    codes, happening, time, *outputs = (part.reshape(wide.shape) for part in np.moveaxis(rows, -1, 0))
    there = np.isfinite(codes)
    codes, happening = (np.where(there, part, 0.0).astype(int) for part in (codes, happening))
    t0 = np.reshape(np.broadcast_to(lanes.signature.clock(lanes.parameters).t0, lanes.size), (*lanes.shape, 1))
    part = shaped(wide, time + t0, outputs)
    at_once = [there & (happening >> i & 1 > 0) for i in range(len(lanes.signature.event_names))]
    return Passed(
        np.where(there, np.array(lanes.signature.end_names)[codes], ""), part.t, part.y, named_events(lanes, at_once)
    )


def _record(
    lanes: Lanes, which: np.ndarray, count: np.ndarray, tolerance: np.ndarray, rows: np.ndarray, stop: np.ndarray | None
) -> None:
    """Integrate some lanes, and write their events into rows, shape (lanes, events, numbers)."""
    most = int(count[which].max())
    capacity, width = most + 1, rows.shape[-1]
    some = max(WIDTH, _MEMORY // (8 * capacity * width))
    for first in range(0, which.size, some):
        each = which[first : first + some]
        program, results = integrator_of(lanes.signature, 0, (), 0)
        found = jax.tree.map(lambda leaf, size=each.size: np.empty(size, leaf.dtype), results)
        log = np.empty((each.size, capacity * width))
        inputs = [
            *(np.asarray(number, float) for number in lanes.signature.of_lanes(lanes.parameters, each)),
            np.asarray(float(capacity)), tolerance[each],
        ]  # fmt: skip
        program.run(inputs, np.arange(each.size), jax.tree.leaves(found), stop, [log])
        if stop is not None and stop[0]:
            return
        written = np.minimum(found.logged.rows, count[each])[:, None, None] > np.arange(most)[:, None]
        rows[each, :most] = np.where(written, log.reshape(each.size, capacity, width)[:, :most], np.nan)
