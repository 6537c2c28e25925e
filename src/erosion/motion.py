"""The motion of a block of lanes: jets as arrays, and what they do, in few kernels.

A jet is a tuple of arrays (rows, lanes), so that one instruction serves several lanes: its members'
unknowns one after another, in as few arrays as their `WIDTH` allows.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from erosion.jets import AtEvent, Cut, Direction, Jets, at_event
from erosion.kernels import narrow
from erosion.model import CuttingModel, cuts_at_all, event_rates
from erosion.parameters import Parameters
from erosion.plan import Plan, planned
from erosion.reduction import reduced


class Motion:
    """Model, parameters and directions of a block, and what moves it."""

    def __init__(self, model: CuttingModel, p: Parameters, order: int, directions: tuple[Direction, ...]) -> None:
        self.order, self.directions = order, directions
        self.model = reduced(model, jax.tree.map(lambda leaf: leaf[0], p))
        self.named = all(isinstance(d, str) for d in directions)
        self.known = (p, () if self.named else directions)
        one = jax.tree.map(lambda leaf: leaf[0], self.known)
        shapes = jax.eval_shape(lambda model, known: self._jets(model, known).initial(), self.model, one)
        self.structure = jax.tree.structure(shapes[0])
        self._heights = [len(part) for part in narrow(jax.tree.leaves(shapes))]
        # Made once, so that JAX traces each of them once for the dozen places it is called at.
        self._rate = self.planned(self._rate_of, self._heights)
        self._rate_and_events = self.planned(self._rate_and_events_of, self._heights)
        self._contact = self.planned(self._contact_of, [])
        self.is_arithmetic = all(isinstance(part, Plan) for part in (self._contact, self._rate, self._rate_and_events))

    def at_contact(self) -> tuple[Any, tuple[Any, ...]]:
        """The model's time scale, NaN where a parameter is not finite, and whether the lane starts to cut; the jet."""
        rows, *jet = self._contact()
        return rows, tuple(jet)

    def rate(self, jet: Sequence[Any]) -> tuple[Any, ...]:
        """The jet's time derivative."""
        return self._rate(*jet)

    def rate_and_events(self, jet: Sequence[Any]) -> tuple[tuple[Any, ...], Any]:
        """The jet's time derivative; the event functions, then their rates."""
        *rate, events = self._rate_and_events(*jet)
        return tuple(rate), events

    def at_event(self, model: CuttingModel, known: Any, rows: Sequence[Any], which: Any, time: Any) -> AtEvent:
        """What became of time and volume there, with derivatives by the parameters: for a planned function.

        Args:
            model: as such a function gets it.
            known: likewise.
            rows: one lane's jet, as lists of scalars.
            which: the event's index.
            time: of the event.
        """
        jets = self._jets(model, known)
        end = at_event(jets, self._cuts(rows), which, time)
        return AtEvent(jets.per_unit(end.time), jets.per_unit(end.volume), end.doubt)

    def by_member(self, jet: Sequence[Any]) -> list[list[Any]]:
        """The rows of each member of a jet."""
        rows, width = [row for part in jet for row in part], self.structure.num_leaves
        return [rows[i : i + width] for i in range(0, len(rows), width)]

    def planned(self, lane: Callable[..., Any], rows: Sequence[int | None]) -> Callable[..., Any]:
        """A function of one lane's (model, known, *variables) made one of all lanes; see `erosion.plan`."""
        return planned(lane, self.model, self.known, rows)

    def _contact_of(self, model: CuttingModel, known: Any) -> tuple[list[Any], ...]:
        # Of parameters that the motion does not depend on too: 0·NaN is NaN.
        nothing = sum(jnp.sum(0.0 * leaf) for leaf in jax.tree.leaves((model, known[0])))
        scale, begins = model.scales(known[0]).time + nothing, cuts_at_all(model, known[0])
        return ([scale, begins.astype(float)], *self._rows(self._jets(model, known).initial()))

    def _rate_of(self, model: CuttingModel, known: Any, *rows: Any) -> tuple[list[Any], ...]:
        return self._rows(self._jets(model, known).rate(self._cuts(rows)))

    def _rate_and_events_of(self, model: CuttingModel, known: Any, *rows: Any) -> tuple[list[Any], ...]:
        jet = self._cuts(rows)
        flow = self._jets(model, known).rate(jet)
        values, rates = event_rates(model, jet[0].state, flow[0].state, known[0])
        return (*self._rows(flow), [*values.values(), *(rates[name] for name in values)])

    def _jets(self, model: CuttingModel, known: Any) -> Jets:
        p, directions = known
        return Jets(model, p, self.order, self.directions if self.named else directions)

    def _rows(self, jet: Sequence[Cut]) -> tuple[list[Any], ...]:
        leaves = iter(jax.tree.leaves(jet))
        return tuple(list(itertools.islice(leaves, height)) for height in self._heights)

    def _cuts(self, jet: Sequence[Any]) -> tuple[Cut, ...]:
        return tuple(jax.tree.unflatten(self.structure, member) for member in self.by_member(jet))
