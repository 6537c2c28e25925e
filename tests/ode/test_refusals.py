"""What `ode` refuses: one sentence each, in the words of the user's own function and line."""

# What is refused has wrong types.
# pyright: reportArgumentType=false

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


def line_of(function: Any) -> str:
    return f"line {function.__code__.co_firstlineno + 1} of test_refusals.py"


@pytest.mark.parametrize("function", [raises, branches, counts_on_numpy])
def test_a_function_that_fails_is_named_with_its_line(function):
    refused("`vector_field`", line_of(function), problem=ode.Problem(START, function))
    event = ode.Event(lambda t, y, args: function(t, y, args)["x"])
    refused("`events['zero']`", line_of(function), problem=ode.Problem(START, field, {"zero": event}))
    reset = ode.Event(lambda t, y, args: y["x"], reset=function)
    refused("`events['zero'].reset`", line_of(function), problem=ode.Problem(START, field, {"zero": reset}))
    rate = {"work": lambda t, y, args: function(t, y, args)["x"]}
    refused("`integrals['work']`", line_of(function), problem=ode.Problem(START, field, integrals=rate))


def test_what_asks_for_a_value_says_what_to_write():
    refused("jnp.where", problem=ode.Problem(START, branches))
    refused("KeyError: 'dragg'", problem=ode.Problem(START, raises))


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (lambda t, y, args: {"x": y["v"]}, ["`vector_field`", "`y0`", "'v'"]),
        (lambda t, y, args: (y["v"], y["x"]), ["`vector_field`"]),
        (lambda t, y, args: {"x": y["v"], "v": jnp.zeros(2)}, ["`vector_field`", "'v'", "(2,)"]),
        (lambda t, y, args: {"x": y["v"], "v": 1j * y["x"]}, ["`vector_field`", "'v'", "complex"]),
        (lambda t, y, args: {"x": y["v"], "v": y["x"] > 0}, ["`vector_field`", "'v'", "bool"]),
        (lambda t, y, args: {"x": y["v"], "v": "down"}, ["`vector_field`"]),
        (lambda t, y, args: None, ["`vector_field`"]),
        (lambda t, y: {"x": y["v"], "v": y["x"]}, ["`vector_field`"]),
    ],
    ids=["part", "tuple", "shape", "complex", "bool", "text", "none", "arguments"],
)
def test_a_rate_unlike_the_state_is_refused(rate, words):
    refused(*words, problem=ode.Problem(START, rate))


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
def test_an_event_that_is_no_number_is_refused(function, words):
    refused("`events['zero']`", *words, problem=ode.Problem(START, field, {"zero": ode.Event(function)}))
    refused("`integrals['zero']`", *words, problem=ode.Problem(START, field, integrals={"zero": function}))


@pytest.mark.parametrize("y0", [{}, None, "rest", {"x": "rest"}, 1j, {"x": True}, {"x": np.zeros(0)},
                                lambda args: args["none"]])  # fmt: skip
def test_a_start_that_is_no_number_is_refused(y0):
    refused("`y0`", problem=ode.Problem(y0, lambda t, y, args: y))


@pytest.mark.parametrize(
    ("y0", "rate", "words"),
    [
        (1.0, lambda t, y, args: [y, y], ["`y0` gives, a number,", "[a number, a number]"]),
        (np.ones(3), lambda t, y, args: [*y], ["an array of shape (3,), but"]),
        (START, lambda t, y, args: y["x"], ["{'v': a number, 'x': a number}, but gives a number."]),
        (1.0, lambda t, y, args: None, ["nothing (None)"]),
    ],
)
def test_what_a_function_gives_is_told_in_words(y0, rate, words):
    refused("`vector_field`", *words, problem=ode.Problem(y0, rate))


def test_an_event_that_gives_nothing_is_told_so():
    refused(
        "nothing (None)", problem=ode.Problem(1.0, lambda t, y, args: y, {"up": ode.Event(lambda t, y, args: None)})
    )


def test_no_bound_of_events_may_be_none():
    assert ode.solve(FINE, {"k": 1.0}, t1=9.0, max_events=None).t == ode.solve(FINE, {"k": 1.0}, t1=9.0).t


def test_a_word_is_named_as_what_it_is():
    refused("`y0`", "type str, which is no number", problem=ode.Problem({"x": "rest"}, lambda t, y, args: y))


def test_an_event_of_whole_numbers_is_refused():
    event = ode.Event(lambda t, y, args: jnp.floor(y).astype(int) - 1)
    refused("`events['low']`", "whole numbers", problem=ode.Problem(3.0, lambda t, y, args: -y, {"low": event}))


def test_single_precision_is_a_start_but_no_rate():
    """Numbers of single precision are computed with in double; rates of single precision would be too rough."""
    end = ode.solve(ode.Problem(np.float32(1.0), lambda t, y, args: -args * y), np.float32(1.0), t1=1.0)
    assert end.y == pytest.approx(np.exp(-1), rel=1e-9)
    refused("`vector_field`", "float32", problem=ode.Problem(1.0, lambda t, y, args: -y.astype(jnp.float32)))
    event = ode.Event(lambda t, y, args: jnp.float32(1.0) - y.astype(jnp.float32))
    refused("`events['low']`", "float32", problem=ode.Problem(1.0, lambda t, y, args: -y, {"low": event}))


def test_beside_the_functions():
    of_other: dict[str, Any] = {"integrals0": lambda args: {"other": 0.0}}
    refused(
        "`integrals0`",
        "work",
        problem=ode.Problem(START, field, integrals={"work": lambda t, y, args: 1.0}, **of_other),
    )
    refused("`time_scale`", problem=ode.Problem(START, field, time_scale=lambda args: jnp.zeros(2)))
    refused("`typical`", problem=ode.Problem(START, field, typical=lambda args: 1.0))


def test_names_must_be_known():
    refused("`wrt`", "k", "'spring'", wrt="spring")
    refused("`wrt`", wrt=("k", "k"))
    refused("`wrt`", wrt="max_step")
    refused("Argument `derivatives` needs", "`wrt`", derivatives=1)
    refused("`wrt`", wrt="k", derivatives=0)
    refused("`derivatives`", "3", wrt="k", derivatives=3)
    refused("`shared`", "k", "'weights'", shared=("weights",))
    refused("`wrt`", "t1", "args", args={"k": 1.0, "t1": 2.0}, wrt="t1")
    for names in (3, None, [3]):
        refused("`wrt`", "list of names", error=TypeError, wrt=names)
        refused("`shared`", "list of names", error=TypeError, shared=names)
    refused("`args`", "keys of one kind", args={"k": 1.0, 2: 2.0})
    refused("`wrt`", args={"k": 1.0, "table": np.ones(2)}, wrt="table", shared=("table",))
    for name in ("table", "table.0"):
        refused("`Solution.gradient`", args={"k": 1.0, "table": np.ones(2)}, wrt=name, shared="table")


def test_sizes_must_be_like_the_state():
    refused("`sizes`", sizes={"x": 1.0})
    refused("`sizes`", sizes=-1.0)
    refused("`sizes`", sizes={"x": 1.0, "v": 0.0})
    refused("`sizes`", sizes={"x": np.ones(3), "v": 1.0})
    refused("`sizes`", sizes=np.nan)
    refused("`sizes`", error=(TypeError, ValueError), sizes="large")


def test_shapes_must_broadcast():
    refused("`args`", "k (3,)", "t1 (2,)", args={"k": np.ones(3)}, t1=np.ones(2))
    refused("`args`", "shared", args={"k": np.ones(3), "table": np.ones(5)})


def test_numbers_are_those_of_double_precision():
    refused("`args`", "k", args={"k": 10**400})


@pytest.mark.parametrize("name", ["t1", "t0", "max_step", "max_events"])
@pytest.mark.parametrize("value", ["soon", True, ["soon"], {}, 1j, 10**400])
def test_times_must_be_numbers(name, value):
    refused(f"`{name}`", error=TypeError, **{name: value})


def test_times_run_forwards():
    refused("`t1`", "`t0`", t0=2.0)
    refused("`t1`", t1=np.array([1.0, -1.0]))
    refused("`max_step`", max_step=0.0)
    refused("`max_step`", max_step=np.nan)
    refused("`max_events`", max_events=0)
    refused("`max_events`", max_events=1.5)
    refused("`t1`", t1=None)
    refused("`t1`", t1=np.inf)
    refused("`t1`", t1=np.nan)
    refused("`t0`", t0=np.nan)
    refused("`ts`", ts=np.array([-1.0]))
    refused("`ts`", ts=np.array([[1.0]]))
    refused("`ts`", error=(TypeError, ValueError), ts="now")


def test_a_time_among_many_may_be_unknown():
    end = ode.solve(FINE, {"k": 1.0}, t1=np.array([1.0, np.nan, 3.0]))
    assert list(end.ended_by) == ["t1", "failed", "zero"]


@pytest.mark.parametrize("rtol", [0.0, -1e-9, 1.0, np.nan, "tight", True])
def test_tolerances(rtol):
    refused("`rtol`", error=(TypeError, ValueError), rtol=rtol)


def test_options():
    refused("`start`", "'wait'", start="now")
    refused("`start`", "'wait'", start=np.array(["wait", "end"]))
    refused("`method`", "'explicit'", method="magic")
    refused("`smooth`", error=TypeError, smooth="yes")
    refused("`max_steps`", error=(TypeError, ValueError), max_steps=0)
    refused("`max_steps`", error=(TypeError, ValueError), max_steps=1.5)
    refused("`problem`", error=TypeError, problem=field)


@pytest.mark.parametrize(("name", "word"), [("atol", "`sizes`"), ("t_eval", "`ts`"), ("rtoll", "rtol")])
def test_words_of_others_are_told_what_is_meant_here(name, word):
    refused(f"`{name}`", word, error=TypeError, **{name: 1e-9})


@pytest.mark.parametrize(
    ("make", "word", "said"),
    [
        (ode.Event, "terminal", "`terminal` is none of `ode.Event`; use `reset`"),
        (ode.Event, "affect", "use `reset`"),
        (ode.Problem, "fun", "`fun` is none of `ode.Problem`; use `Problem.vector_field`"),
        (ode.Problem, "t_span", "use `t0` and `t1` of `ode.solve`"),
        (ode.Problem, "even", "it has y0, vector_field, events, integrals, "),
        (ode.solve, "solver", "use `method`"),
    ],
)
def test_words_of_others_in_events_and_problems(make, word, said):
    with pytest.raises(TypeError, match=said):
        make(**{word: 1})


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


@pytest.mark.parametrize("make", [pd.Series, lambda k: xr.DataArray(k, dims="k"), lambda k: pd.DataFrame({"k": k})])
def test_arrays_with_labels_are_refused_by_name(make):
    refused("`args`", "k is a", "to_numpy", error=TypeError, args={"k": make([1.0, 2.0])})


def test_masked_arrays_are_refused():
    """A masked number has no value."""
    refused("`args.k`", args={"k": np.ma.array([1.0, 2.0], mask=[False, True])})
    refused("`t1`", t1=np.ma.array([1.0, 2.0], mask=[False, True]))
    refused("`ts`", ts=np.ma.array([0.1, 0.2], mask=[False, True]))
    refused("`sizes`", sizes={"x": np.ma.array(1.0, mask=True), "v": 1.0})


def test_complex_arguments_are_refused():
    refused("`args`", "k", error=(TypeError, ValueError), args={"k": 1j * np.ones(2)})


@pytest.mark.parametrize("name", ["start", "failed", "unfinished", "t1"])
def test_names_that_are_taken(name):
    with pytest.raises(ValueError, match=rf"`events`.*'{name}'"):
        ode.Problem(START, field, {name: ode.Event(lambda t, y, args: y["x"])})


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: EVENT("y"), "function"),
        (lambda: ode.Event(field, 2), "direction"),
        (lambda: ode.Event(field, True), "direction"),
        (lambda: EVENT(field, "up"), "direction"),
        (lambda: EVENT(field, np.array([1, -1])), "direction"),
        (lambda: PROBLEM({"x": 1.0, 2: 2.0}, field), "keys of one kind"),
        (lambda: EVENT(field, reset={"x": 0.0}), "reset"),
        (lambda: PROBLEM(START, START), "vector_field"),
        (lambda: PROBLEM(START, field, [ode.Event(field)]), "events"),
        (lambda: PROBLEM(START, field, {"zero": field}), "events"),
        (lambda: PROBLEM(START, field, {1: ode.Event(field)}), "events"),
        (lambda: PROBLEM(START, field, integrals={"work": 1.0}), "integrals"),
        (lambda: PROBLEM(START, field, time_scale=1.0), "time_scale"),
        (lambda: PROBLEM(START, field, {" ": ode.Event(field)}), "events"),
    ],
)
def test_problems_are_checked_where_they_are_made(make, word):
    with pytest.raises((TypeError, ValueError), match=word):
        make()


def test_a_traced_limit_is_not_asked():
    with pytest.raises(ValueError, match="ts"):
        jax.jit(lambda k: ode.solve(FINE, {"k": k}, t1=1.0, ts=jnp.ones((2, 2))).t)(1.0)
