"""Ten cases with events of the SBML Test Suite (github.com/sbmlteam/sbml-test-suite, cases/semantic).

Equations and numbers are the suite's, and so are the results.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode


def at(function, direction, **values):
    """An event of (t, y) that sets numbers of the state, to functions of the state before it."""
    return ode.Event(
        lambda t, y, args: function(t, y),
        direction,
        reset=lambda t, y, args: y | {name: value(t, y) for name, value in values.items()},
    )


def decay(t, y, args):
    """S1 becomes S2."""
    return {"S1": -y["S1"], "S2": y["S1"]}


def delayed(t, y, args):
    """Decay, with a clock that runs while an event waits."""
    return decay(t, y, args) | {"waits": 0.0, "clock": y["waits"]}


def bound(t, y, args):
    """S1 and S2 become S3, and back."""
    rate = 0.75 * y["S1"] * y["S2"] - 0.25 * y["S3"]
    return {"S1": -rate, "S2": -rate, "S3": rate}


def exchanged(t, y, args):
    """S1 becomes S2, and S3 becomes S4, and back."""
    first, second = 0.9 * y["S1"] - 0.075 * y["S2"], 0.75 * y["S3"] - 0.15 * y["S4"]
    return {"S1": -first, "S2": first, "S3": -second, "S4": second}


def still(t, y, args):
    """Nothing changes but at events."""
    return {name: 0.0 * each for name, each in y.items()}


def low(limit, name="S1"):
    """An amount falls through a limit."""
    return lambda t, y: y[name] - limit


def waiting(condition):
    """A second after S1 fell through 0.1, while the condition held, it is set to 1."""
    return {
        "trigger": at(low(0.1), -1, waits=lambda t, y: y["waits"] + condition(y), clock=lambda t, y: 0.0),
        "set": at(lambda t, y: y["clock"] - 1.0, +1, S1=lambda t, y: 1.0, waits=lambda t, y: 0.0),
    }


STARTS = {
    decay: {"S1": 1.0, "S2": 0.0},
    delayed: {"S1": 1.0, "S2": 0.0, "waits": 0.0, "clock": 0.0},
    bound: {"S1": 1.0, "S2": 2.0, "S3": 1.0},
    exchanged: {"S1": 1.0, "S2": 2.0, "S3": 1.0, "S4": 1.5},
}

# Field, start, events, times, results there, what counts at the start.
CASES = [
    pytest.param(
        decay, {},
        {"set": at(low(0.1), -1, S1=lambda t, y: 1.0)},
        [0.9, 2.4, 4.9], {"S1": [0.40656964, 0.90717951, 0.74465833], "S2": [0.59343036, 0.99282049, 2.0553417]},
        "wait", id="00026: an amount is set below a limit",
    ),
    pytest.param(
        delayed, {},
        waiting(lambda y: 1.0),
        [0.9, 2.4, 4.9], {"S1": [0.40656964, 0.090717949, 0.20241911], "S2": [0.59343036, 0.90928205, 1.7607929]},
        "wait", id="00071: it is set a second later",
    ),
    pytest.param(
        delayed, {},
        waiting(lambda y: jnp.where(y["S2"] < 0.95, 1.0, 0.0)),
        [0.9, 2.4, 4.9], {"S1": [0.40656964, 0.090717949, 0.20241911], "S2": [0.59343036, 0.90928205, 1.7607929]},
        "wait", id="00933: the condition ends while it waits",
    ),
    pytest.param(
        bound, {},
        {"set": at(low(0.75), -1, S2=lambda t, y: 1.0)},
        [0.36, 0.96, 1.96],
        {"S1": [0.7291585, 0.64260838, 0.59317509], "S2": [0.97915854, 0.89260842, 0.84317513],
         "S3": [1.2708415, 1.3573916, 1.4068249]},
        "wait", id="00348: another amount is set",
    ),
    pytest.param(
        decay, {"S1": 0.0},
        {"set": at(lambda t, y: t, +1, S1=lambda t, y: 1.5e-4)},
        [0.9, 2.4, 4.9],
        {"S1": [6.0985449e-05, 1.3607693e-05, 1.1169875e-06], "S2": [8.9014551e-05, 0.00013639231, 0.00014888301]},
        "fire", id="00928: true at the start, and happens",
    ),
    pytest.param(
        decay, {"S1": 1.5e-4},
        {"set": at(lambda t, y: t, +1, S1=lambda t, y: 1.0)},
        [0.9, 2.4, 4.9],
        {"S1": [6.0985449e-05, 1.3607693e-05, 1.1169875e-06], "S2": [8.9014551e-05, 0.00013639231, 0.00014888301]},
        "wait", id="00929: true at the start, and does not happen",
    ),
    pytest.param(
        still, {"x": 0.0, "y": 0.0, "p": 0.0, "q": 0.0},
        {
            "first": at(lambda t, y: t - 0.98, +1, y=lambda t, y: y["y"] + y["x"], x=lambda t, y: 2.0),
            "second": at(lambda t, y: t - 0.99, +1, p=lambda t, y: 3.0, q=lambda t, y: y["p"] + 1.0),
        },
        [0.8, 1.0, 1.8], {"x": [0, 2, 2], "y": [0, 0, 0], "p": [0, 3, 3], "q": [0, 1, 1]},
        "wait", id="00979: values before the event are assigned",
    ),
    pytest.param(
        exchanged, {},
        {"set": at(low(0.75), -1, S2=lambda t, y: 1.5)},
        [0.9, 2.4, 4.9], {"S1": [0.52847963, 0.25540823, 0.18027095], "S2": [1.7215203, 1.9945917, 2.069729]},
        "wait", id="01045: a reaction that goes both ways",
    ),
    pytest.param(
        exchanged, {},
        {
            "first": at(low(0.5), -1, S2=lambda t, y: 1.5),
            "second": at(low(0.75, "S3"), -1, S4=lambda t, y: 0.5),
        },
        [0.9, 2.4, 4.9],
        {"S1": [0.55063166, 0.24911524, 0.16217067], "S2": [2.4493683, 1.7508848, 1.8378293],
         "S3": [0.63002171, 0.31765193, 0.21985543], "S4": [0.61997829, 0.93234806, 1.0301446]},
        "wait", id="01047: two reactions with an event each",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("field", "start", "events", "times", "results", "counts"), CASES)
def test_the_published_results(field, start, events, times, results, counts):
    problem = ode.Problem(STARTS.get(field, {}) | start, field, events)
    end = ode.solve(problem, t1=times[-1] + 0.1, ts=np.array(times), start=counts, max_events=9)
    for name, expected in results.items():
        np.testing.assert_allclose(end.ys[name], expected, rtol=1e-6, atol=1e-12, err_msg=name)


def test_the_reset_of_an_event_at_once_can_look_at_the_resets_before_it():
    """00953: two events come every hundredth; the first sets the clock back, and then the second must do nothing."""

    def is_due(t, y):
        return t - y["reset"] > 0.005

    def counts(name):
        """Adds a hundredth to a number and sets the clock back, if no event before it did."""
        return at(
            lambda t, y: t - y["reset"] - 0.01,
            +1,
            reset=lambda t, y: jnp.where(is_due(t, y), t, y["reset"]),
            **{name: lambda t, y: y[name] + jnp.where(is_due(t, y), 0.01, 0.0)},
        )

    problem = ode.Problem({"Q": 0.0, "R": 0.0, "reset": 0.0}, still, {name: counts(name) for name in ("Q", "R")})
    times = np.array([0.0999001, 0.2997003, 0.499500499])
    end = ode.solve(problem, t1=0.5, ts=times, max_events=200)
    np.testing.assert_allclose(end.ys["Q"] + end.ys["R"], [0.09, 0.29, 0.49], rtol=1e-9)
