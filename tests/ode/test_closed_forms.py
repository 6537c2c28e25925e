"""What `ode` promises of every problem, method and mode of differentiation, against closed forms."""

from typing import Any

import jax
import numpy as np
import pytest

from erosion import ode
from tests.ode.closed_forms import CASES, close, derivative, everything


@pytest.mark.parametrize(
    ("name", "method"), [(name, method) for name, case in CASES.items() for method in case.methods]
)
def test_an_end_and_its_derivatives(name, method):
    case = CASES[name]
    stiff = method != "explicit"
    end = case.solve(wrt=case.names, derivatives=1 if stiff else 2, method=method)
    np.testing.assert_array_equal(end.ended_by, case.ended_by)
    np.testing.assert_array_equal(end.count, max(case.count, case.ended_by != "t1"))
    assert not np.any(end.inexact)
    close(everything(end), case.ends(case.values), 1e-8 if stiff else 2e-9, 1e-11)
    for one in case.names:
        first = derivative(case.ends, one)
        close(everything(end.along(one)), first(case.values), 1e-6 if stiff else 1e-8, 1e-9)
        for other in () if stiff else case.names:
            close(everything(end.along(one, other)), derivative(first, other)(case.values), 1e-6, 1e-7)


@pytest.mark.parametrize("name", CASES)
def test_states_at_times_and_their_derivatives(name):
    """In any order, twice, and NaN after a lane's end or where no time is asked for."""
    case = CASES[name]
    over = case.names[0]
    order = [-1, *range(len(case.ts))]
    times = case.solve(wrt=over, ts=[*np.array(case.ts)[order], np.nan], method=case.methods[0]).times
    assert times is not None
    assert case.reached.any()
    for i, j in enumerate(order):
        state = lambda values, j=j: (case.state(case.ts[j], values), case.integrals(case.ts[j], values))  # noqa: E731
        for found, quantity, atol in ((times, state, 1e-9), (times.along(over), derivative(state, over), 1e-7)):
            exact = jax.tree.leaves(quantity(case.values))
            for one, other in zip(jax.tree.leaves((found.ys, found.integrals)), exact, strict=True):
                np.testing.assert_allclose(one[:, i], np.where(case.reached[:, j], other, np.nan), rtol=1e-8, atol=atol)
    assert all(np.isnan(part[:, -1]).all() for part in times.ys.values())


def loss(found: Any) -> Any:
    """One number of each lane: of its time, state and integrals."""
    return sum((i + 1) * leaf**2 / 2 for i, leaf in enumerate(jax.tree.leaves(found)))


@pytest.mark.parametrize("name", CASES)
def test_a_gradient_is_that_of_the_closed_form(name):
    """Of the end and of states at times; what lanes share has the sum over them."""
    case = CASES[name]
    end = case.solve(ts=case.ts, method=case.methods[0])
    leaves, structure = jax.tree.flatten(everything(end))
    t, y, integrals = jax.tree.unflatten(structure, [(i + 1) * leaf for i, leaf in enumerate(leaves)])
    found = end.gradient(t=t, y=y, integrals=integrals, ys=dict.fromkeys(end.ys, 1.0))

    def quantity(values: Any) -> Any:
        states = [sum(case.state(t, values).values()) * case.reached[:, i] for i, t in enumerate(case.ts)]
        return loss(case.ends(values)) + sum(states)

    exact = {name: derivative(quantity, name)(case.values) * case.values[name] for name in case.args}
    size = max(np.max(np.abs(each)) for each in exact.values())
    for name, value in case.args.items():
        expected = exact[name] if np.ndim(value) else np.sum(exact[name])
        np.testing.assert_allclose(found[name] * value, expected, rtol=1e-6, atol=2e-7 * size)


@pytest.mark.parametrize("name", ["driven", "5 bounces"])
def test_jax_differentiates_as_the_closed_form(name):
    """Values, reverse and forward mode, both after another, within `jit`."""
    case = CASES[name]
    lane = {name: value[:1] for name, value in case.values.items()}
    exact = lambda values: loss(case.ends(values))  # noqa: E731
    slopes = {one: derivative(exact, one)(lane)[0] for one in case.names}
    curves = {
        one: {other: derivative(derivative(exact, one), other)(lane)[0] for other in case.names} for one in slopes
    }

    def solved(given: dict[str, Any]) -> Any:
        values = {name: value[0] for name, value in lane.items()} | given
        args = {name: values[name] for name in case.args}
        return loss(everything(case.solve(args, t0=values["t0"], t1=values["t1"])))

    chosen = {name: lane[name][0] for name in case.names}
    every = jax.jit(lambda given: (*jax.value_and_grad(solved)(given), jax.jacfwd(solved)(given)))
    value, back, forth = every(chosen)
    close(value, exact(lane)[0], 1e-9)
    close((back, forth), (slopes, slopes), 1e-7)
    close(jax.jit(jax.hessian(solved))(chosen), curves, 1e-5, 1e-7)


@pytest.mark.parametrize("name", ["driven", "5 bounces", "relay", "kinked"])
def test_many_lanes_have_the_bits_of_each_alone(name):
    case, over = CASES[name], CASES[name].names[0]
    many = {key: np.resize(value, 40) for key, value in case.args.items()}
    many[over] = many[over] * np.linspace(0.95, 1.05, 40)
    t0 = np.resize(case.t0, 40)
    end = case.solve(many, t0=t0, wrt=over)
    for i in (0, 17, 39):
        alone = case.solve({key: value[i] for key, value in many.items()}, t0=t0[i], wrt=over)
        for one, other in ((end, alone), (end.along(over), alone.along(over))):
            for of_many, of_one in zip(*map(jax.tree.leaves, map(everything, (one, other))), strict=True):
                np.testing.assert_array_equal(of_many[i], of_one)


@pytest.mark.parametrize("name", ["throw", "drag", "5 bounces"])
def test_a_maximum_is_where_the_closed_form_has_it(name):
    """Of how near the end's time is to that of the middle of a range."""
    case = CASES[name]
    lane = {key: value[:1] for key, value in case.values.items()}
    over, args = case.names[0], {key: float(lane[key][0]) for key in case.args}
    wanted = float(case.end(lane)[0])
    best = ode.maximum(
        case.problem, args, of=lambda end: -((end.t - wanted) ** 2), over=over, points=8,
        between=(0.7 * args[over], 1.2 * args[over]), t0=float(lane["t0"][0]), t1=float(lane["t1"][0]), **case.options,
    )  # fmt: skip
    assert (best.kind, best.certified) == ("interior", True)
    assert best.at == pytest.approx(args[over], rel=1e-8)
    assert best.curve == pytest.approx(-2 * derivative(case.end, over)(lane)[0] ** 2, rel=1e-6)
