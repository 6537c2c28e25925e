"""All events on the way of lanes: recorded while the lanes are integrated once more."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import PerImpact
from erosion.ode.ensemble import Lanes, Part, among, by_names, ends, named_events, shaped
from erosion.output.tables import format_number


class Passed(NamedTuple):
    """The events on the way of lanes, arrays (…, n); n is the greatest number of them, or `max_events` in JAX.

    Args:
        names: of all events.
        event: the index in `names` of each; -1 after the last.
        t: when; NaN after the last.
        y: the state just before a reset, a pytree of arrays; NaN after the last.
        integrals: by name, in the same way.
        at_once: by name whether an event has happened so far at that time, as others may at the same time.
        derivatives: of t, y and integrals by names of one or two numbers; see `along`.
    """

    names: tuple[str, ...]
    event: PerImpact
    t: PerImpact
    y: PyTree
    integrals: Mapping[str, PerImpact]
    at_once: Mapping[str, PerImpact]
    derivatives: Mapping[tuple[str, ...], Part] = {}

    @property
    def name(self) -> np.ndarray:
        """The name of each event; "" after the last.

        Raises:
            ValueError: where JAX traces the events.
        """
        if isinstance(self.event, Tracer) or isinstance(self.t, Tracer):
            raise ValueError(
                "`name` holds words, and there are none where JAX traces; `event` is the index in `names`."
            )
        return np.array([*self.names, ""])[np.asarray(self.event)]

    def along(self, *names: str) -> Part:
        """Derivatives of t, y and integrals, as `Solution.along`."""
        return among(self.derivatives, names)

    def __repr__(self) -> str:
        happened = self.name[self.name != ""]
        return f"Passed({format_number(happened) or 'no events'}, t={format_number(self.t, 6)})"


def events_passed(lanes: Lanes, count: PerImpact, names: Sequence[str], order: int, rtol: float) -> Passed:
    """The events on the way of lanes with resets.

    Args:
        lanes: the lanes.
        count: how many events each has.
        names: of the derivatives.
        order: of these.
        rtol: relative tolerance.
    """
    most = int(np.max(count, initial=0))
    results, along = ends(lanes, names, order, rtol, events=max(most, 1))
    assert results.saved is not None
    wide, codes = lanes._replace(shape=(*lanes.shape, most)), 1 + len(lanes.signature.event_names)
    there = np.arange(most) < np.expand_dims(count, -1)

    def part(rows: np.ndarray) -> Part:
        time, *outputs = (np.where(there, row.reshape(wide.shape), np.nan) for row in np.moveaxis(rows, -1, 0))
        return shaped(wide, time, outputs)

    saved = results.saved[..., :most, :, :]
    value, derivatives = by_names(saved[..., codes:], along, part)
    t0 = np.reshape(np.broadcast_to(lanes.signature.clock(lanes.parameters).t0, lanes.size), (*lanes.shape, 1))
    for name in names if order else ():
        if lanes.begins_with(name):
            derivatives[(name,)] = derivatives[(name,)]._replace(t=derivatives[(name,)].t + 1.0)
    happening = [row.reshape(wide.shape) for row in np.moveaxis(saved[:, 0, :, 0, :codes], -1, 0)]
    return passed(lanes, there, happening, value._replace(t=value.t + t0), derivatives)


def passed(
    lanes: Lanes, there: Any, codes: Sequence[Any], part: Part, derivatives: Mapping[tuple[str, ...], Part]
) -> Passed:
    """Events from their numbers.

    Args:
        lanes: the lanes.
        there: whether there is an event, shape (…, n).
        codes: the index of each, and whether each of the events happens there.
        part: times, states and integrals.
        derivatives: of these.
    """
    event, *flags = codes
    library = jax.numpy if isinstance(part.t, jax.Array) else np
    return Passed(
        lanes.signature.event_names, library.where(there, event, -1).astype(int), *part,
        named_events(lanes, [there & (flag > 0) for flag in flags]), derivatives,
    )  # fmt: skip
