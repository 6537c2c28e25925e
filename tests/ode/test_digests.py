"""The digest of a problem: programs and stores know it by that, so no two problems may share one."""

from typing import Any

import pytest

from erosion import ode


def problem(events: Any = None, integrals: Any = None, **of_args: Any) -> ode.Problem:
    """x = t from 0, with events, integrals and functions of the arguments."""
    return ode.Problem({"x": 0.0}, lambda t, y, args: {"x": 1.0}, events or {}, integrals or {}, **of_args)


def less(amount: float) -> Any:
    """A reset that takes from x."""
    return lambda t, y, args: {"x": y["x"] - amount}


def passes(place: float, reset: Any = None) -> ode.Event:
    """The event that x rises above a place."""
    return ode.Event(lambda t, y, args: y["x"] - place, 1, reset)


WORK: dict[str, Any] = {"w": lambda t, y, args: y["x"]}

# Pairs of problems whose functions compute the same in another place; with time, number of events and integrals at the
# end of each.
PAIRS: dict[str, list[tuple[ode.Problem, float, int, dict[str, float]]]] = {
    "integrals0, time_scale": [
        (problem(integrals=WORK, integrals0=lambda args: {"w": args}), 6.0, 0, {"w": 20.0}),
        (problem(integrals=WORK, time_scale=lambda args: args), 6.0, 0, {"w": 18.0}),
    ],
    "time_scale, parameter_scale": [
        (problem(time_scale=lambda args: args), 6.0, 0, {}),
        (problem(parameter_scale=lambda args: args), 6.0, 0, {}),
    ],
    "a reset, the next event": [
        (problem({"e": passes(3.0, less(1.0)), "f": passes(2.0)}), 2.0, 1, {}),
        (problem({"e": passes(3.0), "f": passes(1.0, less(2.0))}), 5.0, 3, {}),
    ],
}


@pytest.mark.parametrize("places", PAIRS)
def test_the_same_functions_in_other_places_are_another_problem(places):
    (one, *_), (other, *_) = PAIRS[places]
    assert ode.solve(one, 2.0, t1=1.0).digest != ode.solve(other, 2.0, t1=1.0).digest


@pytest.mark.parametrize("places", PAIRS)
def test_each_problem_is_solved_by_its_own_program(places):
    for one, t, count, integrals in PAIRS[places]:
        end = ode.solve(one, 2.0, t1=6.0, max_events=3)
        assert (end.t, end.count) == (pytest.approx(t), count)
        assert end.integrals == pytest.approx(integrals)
