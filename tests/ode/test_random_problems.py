"""Random small problems with random smooth events, against DOP853 at 1e-12 and fine sampling, and differences.

The coefficients are arguments, so that one program serves many problems. `EROSION_RANDOM_PROBLEMS=2000` asks for more.
"""

import functools
import os
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root_scalar

from erosion import ode

COUNT = int(os.environ.get("EROSION_RANDOM_PROBLEMS", "30"))
UNKNOWNS = (2, 4)
DIRECTIONS = ((-1,), (0, -1, 1))  # for each number of unknowns, those of its events
T1 = 8.0
SAMPLES = 4000
GRAZE = 1e-7  # of an event function's size: so near zero without passing it, rounding decides
STEP = 1e-3  # of differences
ROUGH = 1e-4  # by which those of orders 2 and 4 may disagree
FREQUENCIES = np.array([0.7, 1.3])


class Numbers(NamedTuple):
    """The coefficients of one problem with n unknowns and k events; fields of both kinds are bounded.

    Args:
        start: (n,).
        linear: (n, n), of a damped linear part.
        waves, phases: (n, n) and (n,), sin(waves·y + phases).
        bells: (n, n), of products in exp(-y²).
        force: (n, 2), of cosines in time.
        planes, offsets, curves: (k, n), (k,), (k, n): event functions planes·y + curves·sin(y) - offsets.
        push: a constant part of each rate, by which derivatives are taken.
    """

    start: np.ndarray
    linear: np.ndarray
    waves: np.ndarray
    phases: np.ndarray
    bells: np.ndarray
    force: np.ndarray
    planes: np.ndarray
    offsets: np.ndarray
    curves: np.ndarray
    push: Any = 0.0


def random_numbers(n: int, events: int, random: np.random.Generator) -> Numbers:
    """Coefficients of order 1; some of them are zero."""

    def some(*shape: int) -> np.ndarray:
        return random.normal(size=shape) * (random.random(shape) < 0.7)

    turn = some(n, n)
    return Numbers(
        start=random.normal(size=n),
        linear=turn - turn.T - 0.3 * np.eye(n) * random.random(),
        waves=some(n, n),
        phases=random.uniform(0, 6, n),
        bells=0.7 * some(n, n),
        force=0.5 * some(n, len(FREQUENCIES)),
        planes=random.normal(size=(events, n)),
        offsets=random.normal(size=events),
        curves=some(events, n),
    )


def field(m: Any, t: Any, y: Any, p: Numbers) -> Any:
    """A bounded field, but for its damped linear part."""
    return (
        p.linear @ y + m.sin(p.waves @ y + p.phases) + p.bells @ (y * m.exp(-y * y)) + p.force @ m.cos(FREQUENCIES * t)
    ) + p.push


def event(m: Any, y: Any, p: Numbers, i: int) -> Any:
    """One event function."""
    return p.planes[i] @ y + p.curves[i] @ m.sin(y) - p.offsets[i]


def speed(m: Any, y: Any) -> Any:
    """What is integrated along."""
    return m.exp(-y @ y) + 1.0


@functools.cache
def problem_of(n: int) -> ode.Problem:
    """The problem of so many unknowns."""
    lanes = DIRECTIONS[UNKNOWNS.index(n)]
    return ode.Problem(
        y0=lambda p: p.start,
        vector_field=lambda t, y, p: field(jnp, t, y, p),
        events={
            f"event {i}": ode.Event(lambda t, y, p, i=i: event(jnp, y, p, i), direction)
            for i, direction in enumerate(lanes)
        },
        integrals={"speed": lambda t, y, p: speed(jnp, y)},
    )


class Truth(NamedTuple):
    """The first event, its index -1 where there is none; and whether none was nearly passed before it."""

    event: int
    t: float
    y: np.ndarray
    integral: float
    certain: bool


def truth_of(n: int, p: Numbers) -> Truth:
    """By dense output of a tight integration, finely sampled."""
    solution = solve_ivp(
        lambda t, y: np.append(field(np, t, y[:-1], p), speed(np, y[:-1])),
        (0.0, T1),
        np.append(p.start, 0.0),
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        dense_output=True,
    )
    ts = np.linspace(0.0, T1, SAMPLES)
    values = solution.sol(ts)
    first, when, certain = -1, T1, True
    for i, direction in enumerate(DIRECTIONS[UNKNOWNS.index(n)]):
        g = p.planes[i] @ values[:-1] + p.curves[i] @ np.sin(values[:-1]) - p.offsets[i][None]
        passes = g[:-1] * g[1:] < 0
        if direction:
            passes &= np.sign(g[1:]) == direction
        at = max(int(np.argmax(passes)), 1) if passes.any() else SAMPLES - 1
        if passes.any():
            bracket = ts[at - (at == 1)], ts[at + 1]
            found = root_scalar(lambda t, i=i: event(np, solution.sol(t)[:-1], p, i), bracket=bracket, xtol=1e-14)
            root = float(found.root)
            if root < when:
                first, when = i, root
        # A lowest point between two samples, seen by the parabola through three.
        a, b, c = np.abs(g[: at - 1]), np.abs(g[1:at]), np.abs(g[2 : at + 1])
        turns = (b < a) & (b < c) & (b < 4 * (a + c - 2 * b)) & (b - (a - c) ** 2 / (8 * (a + c - 2 * b)) < GRAZE)
        certain &= not turns.any()
    end = solution.sol(when)
    return Truth(first, when, end[:-1], end[-1], certain)


class Errors(NamedTuple):
    """Of one problem: whether its end is wrong, and relative errors of time, state, integral and of their derivatives.

    The last are taken against differences; NaN where a little push changes the event.
    """

    wrong: bool
    t: float
    y: float
    integral: float
    derivatives: float


def errors_of(n: int, count: int, seed: int) -> list[Errors]:
    """Those of random problems with n unknowns."""
    random = np.random.default_rng(seed)
    lanes = [random_numbers(n, len(DIRECTIONS[UNKNOWNS.index(n)]), random) for _ in range(count)]
    options = {"t1": T1, "shared": Numbers._fields[:-1]}
    ends = [ode.solve(problem_of(n), p, **options) for p in lanes]
    errors = []
    for p, end in zip(lanes, ends, strict=True):
        true = truth_of(n, p)
        if not true.certain:
            continue
        name = "t1" if true.event < 0 else f"event {true.event}"
        errors.append(
            Errors(
                str(end.ended_by) != name,
                abs(float(end.t) / true.t - 1),
                float(np.max(np.abs(end.y - true.y)) / np.max(np.abs(true.y))),
                abs(float(end.integrals["speed"]) / true.integral - 1),
                derivatives_off(n, p, options),
            )
        )
    return errors


def derivatives_off(n: int, p: Numbers, options: dict[str, Any]) -> float:
    """How far the derivatives of t, y and the integral are from differences, over 1 and the greatest of them.

    Where an event is nearly grazed, differences of two orders disagree: then they are not known.
    """
    slopes = ode.solve(problem_of(n), p, wrt="push", derivatives=1, **options)
    sides = ode.solve(problem_of(n), p._replace(push=np.array([-2, -1, 1, 2]) * STEP), rtol=1e-13, **options)
    if not (sides.ended_by == slopes.ended_by).all():
        return np.nan
    along = slopes.along("push")
    found = np.concatenate([[along.t], np.ravel(along.y), [along.integrals["speed"]]])
    values = np.concatenate([[sides.t], np.asarray(sides.y).reshape(4, -1).T, [sides.integrals["speed"]]])
    expected = values @ np.array([1, -8, 8, -1]) / (12 * STEP)
    size = max(1.0, np.max(np.abs(expected)))
    if np.max(np.abs(expected - values @ np.array([0, -1, 1, 0]) / (2 * STEP))) > ROUGH * size:
        return np.nan
    return float(np.max(np.abs(found - expected)) / size)


@pytest.mark.parametrize("n", UNKNOWNS)
def test_random_problems_end_as_dense_output_says(n: int) -> None:
    errors = errors_of(n, COUNT // len(UNKNOWNS), seed=n)
    assert len(errors) > 0.9 * (COUNT // len(UNKNOWNS))
    print(f"{n} unknowns, {len(errors)} problems")
    derivatives = np.array([error.derivatives for error in errors if not error.wrong])
    known = derivatives[np.isfinite(derivatives)]
    print(f"  {known.size} derivatives: {np.percentile(known, [50, 99, 100])}")
    assert known.size > 0.8 * derivatives.size
    assert known.max() < ROUGH / 100
    for name in ("t", "y", "integral"):
        values = [getattr(error, name) for error in errors if not error.wrong]
        print(f"  {name}: {np.percentile(values, [50, 99, 100])}")
        assert np.percentile(values, 99) < 2e-9  # twice the tolerance
    assert sum(error.wrong for error in errors) == 0
