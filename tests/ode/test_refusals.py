"""What `ode` refuses: one sentence each, in the words of the user's own function and line."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from jaxtyping import TypeCheckError

from erosion import ode

START = {"x": 1.0, "v": 0.0}
FINE = ode.Problem(
    START, lambda t, y, args: {"x": y["v"], "v": -args["k"] * y["x"]}, {"zero": ode.Event(lambda t, y, args: y["x"])}
)

EVENT: Any = ode.Event
PROBLEM: Any = ode.Problem
SOLVE: Any = ode.solve


def field(t: Any, y: Any, args: Any) -> Any:
    return {"x": y["v"], "v": -y["x"]}


def refused(*words: str, error: Any = ValueError, problem: Any = FINE, args: Any = None, **options: Any) -> None:
    """Check that a call is refused in one sentence that holds these words."""
    options.setdefault("t1", 1.0)
    with pytest.raises(error) as refusal:
        ode.solve(problem, {"k": 1.0} if args is None else args, **options)
    said = str(refusal.value)
    if isinstance(refusal.value, TypeCheckError):
        return  # types are checked before, in tests alone
    assert "\n" not in said
    assert re.match(r"Arguments? `", said)
    for word in words:
        assert word in said, said


def raises(t: Any, y: Any, args: Any) -> Any:
    raise KeyError("dragg")


def branches(t: Any, y: Any, args: Any) -> Any:
    return field(t, y, args) if y["x"] > 0 else y


def counts_on_numpy(t: Any, y: Any, args: Any) -> Any:
    return {"x": y["v"], "v": -np.sin(y["x"])}


@pytest.mark.parametrize(
    ("function", "word"), [(raises, "KeyError: 'dragg'"), (branches, "jnp.where"), (counts_on_numpy, "")]
)
def test_a_function_that_fails_is_named_with_its_line_and_what_to_write(function, word):
    line = f"line {function.__code__.co_firstlineno + 1} of test_refusals.py"
    refused("`vector_field`", line, word, problem=ode.Problem(START, function))
    event = ode.Event(lambda t, y, args: function(t, y, args)["x"])
    refused("`events['zero']`", line, problem=ode.Problem(START, field, {"zero": event}))
    reset = ode.Event(lambda t, y, args: y["x"], reset=function)
    refused("`events['zero'].reset`", line, problem=ode.Problem(START, field, {"zero": reset}))
    rate = {"work": lambda t, y, args: function(t, y, args)["x"]}
    refused("`integrals['work']`", line, problem=ode.Problem(START, field, integrals=rate))


OF_OTHER: dict[str, Any] = {"integrals": {"work": lambda t, y, args: 1.0}, "integrals0": lambda args: {"other": 0.0}}
PROBLEMS: dict[str, tuple[ode.Problem, list[str]]] = {
    **{
        f"rate: {name}": (ode.Problem(START, rate), ["`vector_field`", *words])
        for name, rate, words in [
            ("no part", lambda t, y, args: {"x": y["v"]}, ["`y0`", "'v'"]),
            ("tuple", lambda t, y, args: (y["v"], y["x"]), []),
            ("shape", lambda t, y, args: {"x": y["v"], "v": jnp.zeros(2)}, ["'v'", "(2,)"]),
            ("complex", lambda t, y, args: {"x": y["v"], "v": 1j * y["x"]}, ["'v'", "complex"]),
            ("bool", lambda t, y, args: {"x": y["v"], "v": y["x"] > 0}, ["'v'", "bool"]),
            ("text", lambda t, y, args: {"x": y["v"], "v": "down"}, []),
            ("two arguments", lambda t, y: {"x": y["v"], "v": y["x"]}, []),
            ("number", lambda t, y, args: y["x"], ["{'v': a number, 'x': a number}, but gives a number."]),
        ]
    },
    "rate: nothing": (ode.Problem(1.0, lambda t, y, args: None), ["`vector_field`", "nothing (None)"]),
    "rate: list": (ode.Problem(1.0, lambda t, y, args: [y, y]), ["gives, a number,", "[a number, a number]"]),
    "rate: of an array": (ode.Problem(np.ones(3), lambda t, y, args: [*y]), ["an array of shape (3,), but"]),
    "rate: single precision": (
        ode.Problem(1.0, lambda t, y, args: -y.astype(jnp.float32)),
        ["`vector_field`", "float32"],
    ),
    **{
        f"start: {name}": (ode.Problem(y0, lambda t, y, args: y), ["`y0`", *words])
        for name, y0, words in [
            ("no part", {}, []),
            ("nothing", None, []),
            ("text", "rest", []),
            ("a part of text", {"x": "rest"}, ["type str, which is no number"]),
            ("complex", 1j, []),
            ("truth", {"x": True}, []),
            ("empty", {"x": np.zeros(0)}, []),
            ("unknown", lambda args: args["none"], []),
        ]
    },
    **{
        f"event: {name}": (
            ode.Problem(3.0, lambda t, y, args: -y, {"low": ode.Event(function)}),
            ["`events['low']`", word],
        )
        for name, function, word in [
            ("nothing", lambda t, y, args: None, "nothing (None)"),
            ("whole numbers", lambda t, y, args: jnp.floor(y).astype(int) - 1, "whole numbers"),
            ("single precision", lambda t, y, args: jnp.float32(1.0) - y.astype(jnp.float32), "float32"),
        ]
    },
    "integrals0": (ode.Problem(START, field, **OF_OTHER), ["`integrals0`", "work"]),
    "time scale": (ode.Problem(START, field, time_scale=lambda args: jnp.zeros(2)), ["`time_scale`"]),
    "parameter_scale": (ode.Problem(START, field, parameter_scale=lambda args: 1.0), ["`parameter_scale`"]),
}


@pytest.mark.parametrize("what", PROBLEMS)
def test_functions_that_give_something_else_are_refused(what):
    problem, words = PROBLEMS[what]
    refused(*words, problem=problem)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda t, y, args: (y["x"], y["v"]), ["one number"]),
        (lambda t, y, args: jnp.stack([y["x"], y["v"]]), ["(2,)"]),
        (lambda t, y, args: y["x"] > 0, ["bool"]),
        (lambda t, y, args: y["z"], ["'z'", "line"]),
    ],
    ids=["two", "array", "bool", "name"],
)
def test_an_event_or_an_integrand_that_is_no_number_is_refused(function, words):
    refused("`events['zero']`", *words, problem=ode.Problem(START, field, {"zero": ode.Event(function)}))
    refused("`integrals['zero']`", *words, problem=ode.Problem(START, field, integrals={"zero": function}))


def test_no_bound_of_events_may_be_none():
    assert ode.solve(FINE, {"k": 1.0}, t1=9.0, max_events=None).t == ode.solve(FINE, {"k": 1.0}, t1=9.0).t


def test_a_start_of_single_precision_is_computed_with_in_double():
    end = ode.solve(ode.Problem(np.float32(1.0), lambda t, y, args: -args * y), np.float32(1.0), t1=1.0)
    assert end.y == pytest.approx(np.exp(-1), rel=1e-9)


MASKED, TABLE = np.ma.array([1.0, 2.0], mask=[False, True]), {"k": 1.0, "table": np.ones(2)}
EITHER = (TypeError, ValueError)
OPTIONS: list[tuple[Any, list[str], dict[str, Any]]] = [
    (ValueError, ["`wrt`", "k", "'spring'"], {"wrt": "spring"}),
    (ValueError, ["`wrt`"], {"wrt": ("k", "k")}),
    (ValueError, ["`wrt`"], {"wrt": "max_step"}),
    (ValueError, ["`wrt`"], {"wrt": "k", "derivatives": 0}),
    (ValueError, ["`wrt`", "t1", "args"], {"args": {"k": 1.0, "t1": 2.0}, "wrt": "t1"}),
    (ValueError, ["`wrt`"], {"args": TABLE, "wrt": "table", "shared": ("table",)}),
    (ValueError, ["`Solution.gradient`"], {"args": TABLE, "wrt": "table", "shared": "table"}),
    (ValueError, ["`Solution.gradient`"], {"args": TABLE, "wrt": "table.0", "shared": "table"}),
    *((TypeError, ["`wrt`", "list of names"], {"wrt": names}) for names in (3, None, [3])),
    (ValueError, ["Argument `derivatives` needs", "`wrt`"], {"derivatives": 1}),
    (ValueError, ["`derivatives`", "3"], {"wrt": "k", "derivatives": 3}),
    (ValueError, ["`shared`", "k", "'weights'"], {"shared": ("weights",)}),
    *((TypeError, ["`shared`", "list of names"], {"shared": names}) for names in (3, None, [3])),
    (ValueError, ["`args`", "keys of one kind"], {"args": {"k": 1.0, 2: 2.0}}),
    (ValueError, ["`args`", "k (3,)", "t1 (2,)"], {"args": {"k": np.ones(3)}, "t1": np.ones(2)}),
    (ValueError, ["`args`", "shared"], {"args": {"k": np.ones(3), "table": np.ones(5)}}),
    (ValueError, ["`args`", "k"], {"args": {"k": 10**400}}),
    (EITHER, ["`args`", "k"], {"args": {"k": 1j * np.ones(2)}}),
    (ValueError, ["`args.k`"], {"args": {"k": MASKED}}),
    *(
        (TypeError, ["`args`", "k is a", "to_numpy"], {"args": {"k": labelled}})
        for labelled in (pd.Series([1.0, 2.0]), xr.DataArray([1.0, 2.0], dims="k"), pd.DataFrame({"k": [1.0, 2.0]}))
    ),
    *(
        (ValueError, ["`state_scale`"], {"state_scale": sizes})
        for sizes in (
            {"x": 1.0},
            -1.0,
            {"x": 1.0, "v": 0.0},
            {"x": np.ones(3), "v": 1.0},
            np.nan,
            {"x": np.ma.array(1.0, mask=True), "v": 1.0},
        )
    ),
    (EITHER, ["`state_scale`"], {"state_scale": "large"}),
    *(
        (TypeError, [f"`{name}`"], {name: value})
        for name in ("t1", "t0", "max_step", "max_events")
        for value in ("soon", True, ["soon"], {}, 1j, 10**400)
    ),
    (ValueError, ["`t1`", "`t0`"], {"t0": np.array([0.0, 2.0])}),
    *((ValueError, ["`t1`"], {"t1": t1}) for t1 in (np.array([1.0, -1.0]), None, np.inf, np.nan, MASKED)),
    (ValueError, ["`t0`"], {"t0": np.nan}),
    *((ValueError, ["`max_step`"], {"max_step": longest}) for longest in (0.0, np.nan)),
    *((ValueError, ["`max_events`"], {"max_events": most}) for most in (0, 1.5)),
    *((ValueError, ["`ts`"], {"ts": ts}) for ts in (np.array([[1.0]]), 0.1 * MASKED)),
    (EITHER, ["`ts`"], {"ts": "now"}),
    *((EITHER, ["`rtol`"], {"rtol": rtol}) for rtol in (0.0, -1e-9, 1.0, np.nan, "tight", True)),
    *((ValueError, ["`start`", "'wait'"], {"start": start}) for start in ("now", np.array(["wait", "end"]))),
    (ValueError, ["`method`", "'explicit'"], {"method": "magic"}),
    (TypeError, ["`smooth`"], {"smooth": "yes"}),
    *((EITHER, ["`max_steps`"], {"max_steps": most}) for most in (0, 1.5)),
    (TypeError, ["`problem`"], {"problem": field}),
    # Words of other packages.
    (TypeError, ["`atol`", "`state_scale`"], {"atol": 1e-9}),
    (TypeError, ["`t_eval`", "`ts`"], {"t_eval": 1e-9}),
    (TypeError, ["`rtoll`", "rtol"], {"rtoll": 1e-9}),
]


@pytest.mark.parametrize(
    ("error", "words", "options"),
    OPTIONS,
    ids=[re.sub(r" at 0x\w+|\s+", " ", str(options))[:60] for *_, options in OPTIONS],
)
def test_an_option_that_makes_no_sense_is_refused(error, words, options):
    refused(*words, error=error, **options)


def test_a_time_among_many_may_be_unknown():
    end = ode.solve(FINE, {"k": 1.0}, t1=np.array([1.0, np.nan, 3.0]))
    assert list(end.ended_by) == ["t1", "failed", "zero"]


@pytest.mark.parametrize("name", ["direction", "terminal"])
def test_what_only_scipy_reads_of_a_function_is_refused(name):
    """`function.direction = -1` would be left aside, and a rise taken for the event."""

    def low(t, y, args):
        return y["x"]

    setattr(low, name, -1)
    with pytest.raises(ValueError, match=f"`{name}`"):
        ode.Event(low)
    setattr(low, name, 1)
    assert ode.Event(low, direction=1).function is low


@pytest.mark.parametrize(
    ("make", "error", "said"),
    [
        *(
            (lambda name=name: ode.Problem(START, field, {name: EVENT(field)}), ValueError, rf"`events`.*'{name}'")
            for name in ("start", "failed", "unfinished", "t1")
        ),
        (lambda: EVENT("y"), EITHER, "function"),
        *((lambda way=way: EVENT(field, way), EITHER, "direction") for way in (2, True, "up", np.array([1, -1]))),
        (lambda: EVENT(field, reset={"x": 0.0}), EITHER, "reset"),
        (lambda: PROBLEM({"x": 1.0, 2: 2.0}, field), EITHER, "keys of one kind"),
        (lambda: PROBLEM(START, START), EITHER, "vector_field"),
        (lambda: PROBLEM(START, field, [ode.Event(field)]), EITHER, "events"),
        (lambda: PROBLEM(START, field, {"zero": field}), EITHER, "events"),
        (lambda: PROBLEM(START, field, {1: ode.Event(field)}), EITHER, "events"),
        (lambda: PROBLEM(START, field, {" ": ode.Event(field)}), EITHER, "events"),
        (lambda: PROBLEM(START, field, integrals={"work": 1.0}), EITHER, "integrals"),
        (lambda: PROBLEM(START, field, time_scale=1.0), EITHER, "time_scale"),
        # Words of other packages.
        (lambda: EVENT(), TypeError, "`function` or `times`"),
        (lambda: EVENT(field, times=[1.0]), TypeError, "`function` or `times`"),
        (lambda: EVENT(direction=1, times=[1.0]), ValueError, "`direction`"),
        *((lambda n=n: EVENT(field, terminal=n), ValueError, "`terminal`") for n in (-1, 1.5, "last")),
        *((lambda n=n: EVENT(field, reset=field, terminal=n), ValueError, "`terminal`") for n in (True, 1)),
        (lambda: EVENT(lambda t, y, args, index: y), TypeError, "`index`"),
        (lambda: EVENT(field, reset=lambda t, y, args, place: y), TypeError, "`place`"),
        (lambda: EVENT(affect=1), TypeError, "use `reset`"),
        (lambda: PROBLEM(fun=1), TypeError, "`fun` is none of `ode.Problem`; use `Problem.vector_field`"),
        (lambda: PROBLEM(t_span=1), TypeError, "use `t0` and `t1` of `ode.solve`"),
        (lambda: PROBLEM(even=1), TypeError, "it has y0, vector_field, events, integrals, "),
        (lambda: SOLVE(solver=1), TypeError, "use `method`"),
    ],
)
def test_problems_and_events_are_checked_where_they_are_made(make, error, said):
    with pytest.raises(error, match=said):
        make()


def test_a_traced_limit_is_not_asked():
    with pytest.raises(ValueError, match="ts"):
        jax.jit(lambda k: ode.solve(FINE, {"k": k}, t1=1.0, ts=jnp.ones((2, 2))).t)(1.0)
