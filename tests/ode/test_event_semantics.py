"""What events mean, case by case, as suites of other tools ask it: priorities, delays, persistence, initial values.

A trigger that is true is an event function past zero. A delay is a time in the state; a delayed event that does not
persist is one whose time another event takes back. All values are closed forms.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode

NEVER = 1e9


def growing(rate: float = 1.0, **more: float) -> dict[str, Any]:
    """y grows at a rate; the other numbers of the state stay."""
    return {
        "y0": {"y": 0.0, **more},
        "vector_field": lambda t, y, args: {"y": rate} | dict.fromkeys(more, 0.0),
    }


def delayed(trigger: ode.Event, keeps: bool, delay: float = 0.5) -> dict[str, ode.Event]:
    """An event that happens some time after its trigger, and then writes y into `read`."""

    def plan(t: Any, y: Any, args: Any) -> Any:
        return y | {"due": t + delay, "kept": y["y"]}

    def run(t: Any, y: Any, args: Any) -> Any:
        return y | {"due": NEVER, "read": y["kept"] if keeps else y["y"]}

    return {
        "trigger": ode.Event(trigger.function, trigger.direction, plan),
        "run": ode.Event(lambda t, y, args: t - y["due"], 1, run),
    }


AT_ONE = ode.Event(lambda t, y, args: y["y"] - 1, 1)
LATER = {"due": NEVER, "kept": 0.0, "read": 0.0}


def test_an_event_fires_once_each_time_its_trigger_becomes_true():
    saw = ode.Problem(**growing(), events={"top": ode.Event(AT_ONE.function, 1, lambda t, y, args: {"y": 0.0 * t})})
    end = ode.solve(saw, t1=5.5)
    assert (end.count, end.y["y"]) == (5, pytest.approx(0.5))


@pytest.mark.parametrize(("names", "value"), [(("double", "add"), 3.0), (("add", "double"), 4.0)])
def test_of_events_at_one_time_the_first_in_order_has_priority(names, value):
    events = {
        "double": ode.Event(lambda t, y, args: t - 1, 1, lambda t, y, args: y | {"y": 2 * y["y"]}),
        "add": ode.Event(lambda t, y, args: y["y"] - 1, 1, lambda t, y, args: y | {"y": y["y"] + 1}),
    }
    end = ode.solve(ode.Problem(**growing(), events={name: events[name] for name in names}), t1=1.5)
    assert (end.count, end.y["y"]) == (2, pytest.approx(value + 0.5))


@pytest.mark.parametrize(("keeps", "value"), [(True, 1.0), (False, 1.5)])
def test_a_delayed_event_uses_values_of_its_trigger_or_of_its_own_time(keeps, value):
    problem = ode.Problem(**growing(1.0, **LATER), events=delayed(AT_ONE, keeps))
    end = ode.solve(problem, t1=2.0)
    np.testing.assert_allclose(end.events.t, [1.0, 1.5])
    assert end.y["read"] == pytest.approx(value)


@pytest.mark.parametrize(("persists", "value"), [(True, 0.2), (False, 0.0)])
def test_a_trigger_that_becomes_false_cancels_an_event_that_does_not_persist(persists, value):
    """At t = 1.2 y falls to zero, before the event that was planned at t = 1."""

    def fall(t: Any, y: Any, args: Any) -> Any:
        return y | {"y": 0.0 * y["y"]} | ({} if persists else {"due": 0.0 * t + NEVER})

    drop = ode.Event(lambda t, y, args: t - 1.2, 1, fall)
    problem = ode.Problem(**growing(1.0, **LATER), events={**delayed(AT_ONE, keeps=False, delay=0.4), "drop": drop})
    end = ode.solve(problem, t1=1.9)
    assert end.count == (3 if persists else 2)
    assert end.y["read"] == pytest.approx(value)


@pytest.mark.parametrize(("start", "count", "value"), [("wait", 0, 4.0), ("fire", 1, 1.0)])
def test_an_initial_value_says_whether_a_trigger_that_is_true_at_the_start_fires(start, count, value):
    problem = ode.Problem(
        {"y": 3.0},
        lambda t, y, args: {"y": 1.0},
        {"high": ode.Event(lambda t, y, args: y["y"] - 2, 1, lambda t, y, args: {"y": 0.0 * t})},
    )
    end = ode.solve(problem, t1=1.0, start=start)
    assert (end.count, end.y["y"]) == (count, pytest.approx(value))


def test_assignments_of_one_event_use_the_values_before_it():
    swap = ode.Event(lambda t, y, args: t - 1, 1, lambda t, y, args: {"y": y["other"], "other": y["y"]})
    end = ode.solve(ode.Problem(**growing(1.0, other=7.0), events={"swap": swap}), t1=2.0)
    assert (end.y["y"], end.y["other"]) == (pytest.approx(8.0), pytest.approx(1.0))


def test_an_event_may_make_another_one_happen_at_once():
    events = {
        "lift": ode.Event(lambda t, y, args: t - 1, 1, lambda t, y, args: y | {"y": y["y"] + 5}),
        "full": ode.Event(lambda t, y, args: y["y"] - 4, 1, lambda t, y, args: y | {"y": y["y"] - 4, "n": y["n"] + 1}),
    }
    end = ode.solve(ode.Problem(**growing(1.0, n=0.0), events=events), t1=1.5)
    np.testing.assert_allclose(end.events.t, [1.0, 1.0])
    assert (end.y["y"], end.y["n"]) == (pytest.approx(2.5), 1.0)


def test_an_event_may_stop_another_one_of_the_same_time():
    """Both triggers become true at t = 1; the first makes the second false before it happens."""
    events = {
        "first": ode.Event(lambda t, y, args: t - 1, 1, lambda t, y, args: y | {"y": 0.0 * t, "on": 0.0 * t}),
        "second": ode.Event(
            lambda t, y, args: y["on"] * (y["y"] - 1) - (1 - y["on"]), 1, lambda t, y, args: y | {"n": y["n"] + 1}
        ),
    }
    end = ode.solve(ode.Problem(**growing(1.0, on=1.0, n=0.0), events=events), t1=1.8)
    assert (end.count, end.y["n"]) == (1, 0.0)


def test_a_delay_of_zero_is_an_event_of_the_same_time():
    end = ode.solve(ode.Problem(**growing(1.0, **LATER), events=delayed(AT_ONE, keeps=False, delay=0.0)), t1=2.0)
    np.testing.assert_allclose(end.events.t, [1.0, 1.0])
    assert end.y["read"] == pytest.approx(1.0)


def test_a_second_trigger_before_a_delayed_event_has_a_time_of_its_own():
    """y falls to 0.7 at each trigger, at t = 1, 1.3, 1.6; each event follows 0.5 later, and two may wait."""

    def plan(t: Any, y: Any, args: Any) -> Any:
        waits = y["due"] < NEVER
        later = jnp.where(waits, t + 0.5, y["second"])
        return y | {"y": 0.7 + 0.0 * t, "due": jnp.where(waits, y["due"], t + 0.5), "second": later}

    def run(t: Any, y: Any, args: Any) -> Any:
        return y | {"due": y["second"], "second": 0.0 * t + NEVER}

    events = {
        "trigger": ode.Event(AT_ONE.function, 1, plan),
        "run": ode.Event(lambda t, y, args: t - y["due"], 1, run),
    }
    end = ode.solve(ode.Problem(**growing(1.0, due=NEVER, second=NEVER), events=events), t1=1.85)
    np.testing.assert_allclose(end.events.t, [1.0, 1.3, 1.5, 1.6, 1.8])
    assert list(end.events.name) == ["trigger", "trigger", "run", "trigger", "run"]
