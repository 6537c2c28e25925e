import jax.numpy as jnp

import erosion
from erosion.impacts.impact import OTHER_ENDS, end_names
from erosion.models import Linearized


class ThreeEnds(Linearized):
    """Events that are not in the order of their names; each ends the cut at an angle of its own."""

    def events(self, state, p):
        early = {name: p.alpha - angle for name, angle in (("rest", 0.3), ("exit", 0.2), ("limit", 0.1))}
        depth = state.y / self.scales(p).length
        return {name: jnp.where(over > 0, 1.0, depth) for name, over in early.items()}


def test_events_come_by_name_then_what_no_event_ended() -> None:
    assert end_names(ThreeEnds()) == ("exit", "limit", "rest", "no-cut", "failed", "unfinished")
    assert end_names(erosion.load_model("rotating")) == ("rebound", "stop", *OTHER_ENDS)


def test_the_word_is_that_of_the_event_that_fell() -> None:
    assert erosion.impact(ThreeEnds(), erosion.TABLE_1.replace(alpha=0.25)).ended_by == "rest"
