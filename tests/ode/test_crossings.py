"""When an event function is expected to fall, on functions that are cubics.

How the end of a lane is found among trial steps, for event functions that are known polynomials of time.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicHermiteSpline

from erosion.ode import arming, crossings, step_control
from erosion.ode.cubics import Ends, cubic_error, expected_fall, is_crooked, may_hide_a_fall, minimum_in_step
from erosion.ode.step_control import ADVANCING, ARRIVED, ENDED, LOCATING, Control, Limits


def looked_at(polynomial: np.polynomial.Polynomial, length: float, low: float, high: float) -> tuple[float, bool]:
    slope = polynomial.deriv()
    start, end = (Ends(polynomial(t), slope(t)) for t in (0.0, length))
    root, steep, _ = expected_fall(start, end, length, low, high)
    return float(root), bool(steep)


@pytest.mark.parametrize("beyond", [1.1, 1.5, 2.0])
def test_a_steep_fall_beyond_a_step_is_foreseen(beyond: float) -> None:
    length = 1e-6
    fall = np.polynomial.Polynomial.fromroots([-2 * length, beyond * length, 20 * length])
    root, steep = looked_at(fall, length, length, 3 * length)
    assert root == pytest.approx(beyond * length, rel=1e-4)
    assert steep


def test_a_fall_past_a_known_length_is_found() -> None:
    fall = np.polynomial.Polynomial.fromroots([-1.0, 0.4, 5.0])
    root, _ = looked_at(fall, 1.0, 0.0, 1.0)
    assert root == pytest.approx(0.4, rel=1e-5)


@pytest.mark.parametrize("lowest", [1e-3, 1e-6, -1e-6])
def test_a_graze_is_not_steep(lowest: float) -> None:
    """A parabola that touches zero a little beyond the step, or all but does."""
    graze = np.polynomial.Polynomial([1.2**2 + lowest, -2.4, 1.0])
    assert not looked_at(graze, 1.0, 1.0, 3.0)[1]


def test_a_function_that_rises_is_not_steep() -> None:
    assert not looked_at(np.polynomial.Polynomial([0.1, 1.0]), 1.0, 1.0, 3.0)[1]


@pytest.mark.parametrize("length", [0.3, 1.0, 2.5, 3.5])
def test_looks_within_a_step_say_how_much_its_cubic_errs(length):
    """A sine's cubic errs by up to length⁴/384 of its amplitude; the bound holds, and is not far above."""
    for phase in np.linspace(0, 2 * np.pi, 50):
        theta = np.linspace(0, 1, 200)
        start, end = (Ends(np.sin(phase + t * length), np.cos(phase + t * length)) for t in (0.0, 1.0))
        error = cubic_error(start, end, length, [(t, np.sin(phase + t * length)) for t in (0.1475, 0.9247)])
        cubic = CubicHermiteSpline([0, length], [start.value, end.value], [start.rate, end.rate])(theta * length)
        off = np.abs(cubic - np.sin(phase + theta * length))
        assert np.all(off <= 2 * float(error) * (theta * (1 - theta)) ** 2 + 1e-14)
        assert float(error) / 16 <= 1.5 * length**4 / 384


def test_a_dip_that_the_cubic_does_not_see_may_be_there():
    # Down and up again within the step, both ends high: the cubic is a hump.
    start, end = Ends(1.0, 0.5), Ends(1.0, -0.5)
    within = [(0.465, -0.1), (0.65, 0.1)]
    error = cubic_error(start, end, 1.0, within)
    assert is_crooked(start, end, 1.0, error)
    assert may_hide_a_fall(start, end, 1.0, error)
    straight = [(t, 1 + 0.5 * t * (1 - t)) for t in (0.1475, 0.9247)]
    assert not is_crooked(start, end, 1.0, cubic_error(start, end, 1.0, straight))


def minimum(polynomial: np.polynomial.Polynomial, error: float = 0.0) -> tuple[float, float]:
    """Where a step from 0 to 1 has its dip, and its lowest value there."""
    start, end = (Ends(polynomial(t), polynomial.deriv()(t)) for t in (0.0, 1.0))
    where, lowest = minimum_in_step(start, end, 1.0, error)
    return float(where), float(lowest)


@pytest.mark.parametrize("theta", [0.1, 0.5, 0.83])
@pytest.mark.parametrize("lowest", [-0.1, 0.0, 1e-4])
def test_a_dip_near_zero_is_where_the_parabola_is_lowest(theta: float, lowest: float) -> None:
    where, value = minimum(np.polynomial.Polynomial([theta**2 + lowest, -2 * theta, 1.0]))
    # At a step's end below zero nothing dips: the function has fallen.
    assert where == pytest.approx(theta if (1 - theta) ** 2 + lowest > 0 else 2, abs=1e-12)
    assert value == pytest.approx(lowest if where < 1 else np.inf, abs=1e-12)


def test_a_cubic_is_lowest_where_its_slope_is_zero() -> None:
    """(t - 0.4)² (t + 1) - 0.01, which touches -0.01 at 0.4."""
    touching = np.polynomial.Polynomial.fromroots([0.4, 0.4, -1.0]) - 0.01
    assert minimum(touching) == (pytest.approx(0.4, rel=1e-12), pytest.approx(-0.01, rel=1e-12))


def test_a_dip_is_harmless_above_what_its_cubic_may_err() -> None:
    high = np.polynomial.Polynomial([0.25 + 0.1, -1.0, 1.0])
    assert minimum(high) == (2, pytest.approx(0.1))
    # The cubic's error at a half: θ²(1-θ)² = 1/16, doubled.
    assert minimum(high, error=0.99 * 0.8)[0] == 2
    assert minimum(high, error=1.01 * 0.8)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("coefficients", [[1.0, 1.0], [1.0, -0.5], [1.0, 1.0, -1.0], [1.0, 0.0, 0.0, 1.0]])
def test_what_rises_falls_or_humps_has_no_dip(coefficients: list[float]) -> None:
    assert minimum(np.polynomial.Polynomial(coefficients)) in ((2, np.inf), (2, 1.0))


def test_a_step_that_ends_on_a_lowest_point_does_not_look_there_again() -> None:
    for lowest_at in (0.0, 1.0):
        where, value = minimum(np.polynomial.Polynomial([lowest_at**2 + 1e-6, -2 * lowest_at, 1.0]))
        assert where == 2
        assert value == pytest.approx(1e-6, rel=1e-9)


FIRST = 0.17
SCALE = 1.0
LIMITS = Limits(20_000, by_scale=True)


def start(step: float = FIRST) -> Control:
    return step_control.begin(jnp.asarray(SCALE), jnp.asarray(True), jnp.asarray(True), step)


@jax.jit
def after_trial(control: Control, before: list[Ends], after: list[Ends], within: list, error: jax.Array):
    """As the integrator does it."""
    samples = list(zip((0.15, 0.92), within, strict=True))
    clear = crossings.are_clear([], control.trial_length, before, after, samples, 1e-5)
    return jax.lax.cond(
        jnp.stack(clear).all() & (control.mode == ADVANCING),
        lambda: step_control.go_on(control, error, SCALE, LIMITS),
        lambda: crossings.decide(
            control, crossings.look(control, before, after, samples, error, jnp.ones(()), clear=clear), SCALE, LIMITS
        ),
    )


@jax.jit
def both_ways(control: Control, before: list[Ends], after: list[Ends], within: list, error: jax.Array):
    """Which events are clear, and what follows without a look at those, with one at all, and with none at any."""
    watched = arming.watch([-1] * len(before), before, SCALE)
    samples = list(zip((0.15, 0.92), within, strict=True))

    def decided(clear: list):
        trial = crossings.look_directed(watched, control, before, after, samples, error, jnp.ones(()), clear=clear)
        return crossings.decide(control, trial, SCALE, LIMITS)

    clear = crossings.are_clear(watched, control.trial_length, before, after, samples, 1e-5)
    none = [jnp.asarray(False)] * len(clear)
    return clear, decided(clear), decided(none), step_control.go_on(control, error, SCALE, LIMITS)


def test_a_look_at_clear_events_changes_nothing() -> None:
    """Two random cubics with wiggles, before their events and beyond them, near zero and far from it."""
    random = np.random.default_rng(3)
    lanes = 20_000
    step = random.uniform(0.01, 3.0, lanes)
    control = jax.vmap(lambda h: start()._replace(trial_length=h, step=h))(step)
    before, after, within = [], [], []
    for _ in range(2):
        cubics = random.normal(size=(4, lanes)) * 10.0 ** random.uniform(-3, 1, (4, 1))
        wiggle = random.choice([0.0, 1e-3, 0.1], lanes)

        def value(time, cubics=cubics, wiggle=wiggle):
            return sum(c * time**i for i, c in enumerate(cubics)) + wiggle * np.sin(9 * time)

        def ends(time, cubics=cubics, wiggle=wiggle, value=value):
            rate = sum(i * c * time ** max(i - 1, 0) for i, c in enumerate(cubics)) + 9 * wiggle * np.cos(9 * time)
            return Ends(jnp.asarray(value(time)), jnp.asarray(rate))

        before.append(ends(0.0 * step))
        after.append(ends(step))
        within.append([jnp.asarray(value(share * step)) for share in (0.15, 0.92)])
    error = jnp.asarray(10.0 ** random.uniform(-3, 1, lanes))
    inside = [list(values) for values in zip(*within, strict=True)]
    clear, without, looked, unseen = jax.vmap(both_ways)(control, before, after, inside, error)
    quiet = clear[0] & clear[1]
    one = clear[0] ^ clear[1]
    assert np.mean(quiet) > 0.02
    assert np.mean(one) > 0.1
    for name in ("mode", "time", "trial_length", "step", "trials", "rejected", "event", "time_to_event", "high"):
        found = getattr(looked[0], name)
        assert np.array_equal(getattr(without[0], name), found, equal_nan=True), name
        if name not in ("event", "time_to_event", "high"):
            assert np.array_equal(getattr(unseen[0], name)[quiet], found[quiet]), name
    assert np.array_equal(without[1], looked[1])
    assert np.array_equal(unseen[1][quiet], looked[1][quiet])
    assert np.all(looked[0].closest_approach[quiet] > 1e-5)


def follow(
    *events: Polynomial, error: float = 1e-4, t_stop: float | None = None, step: float = FIRST
) -> tuple[Control, int, float]:
    """Step through event functions to the end: the last control, the event's index and its time."""

    def at(time: float) -> list[Ends]:
        return [Ends(jnp.asarray(event(time)), jnp.asarray(event.deriv()(time))) for event in events]

    def within_limit(control: Control) -> Control:
        return control if t_stop is None else crossings.stop_at(control, t_stop)

    control, here = within_limit(start(step)), at(0.0)
    while step_control.goes_on(control):
        begin, length = float(control.time), float(control.trial_length)
        there = at(begin + length)
        within = [[jnp.asarray(event(begin + share * length)) for event in events] for share in (0.15, 0.92)]
        control, moved = after_trial(control, here, there, within, jnp.asarray(error))
        control = within_limit(control)
        here = there if moved else here
    event, remaining = crossings.first_fall(control, at(float(control.time + control.time_to_event)))
    return control, int(event), float(control.time + control.time_to_event + remaining)


@pytest.mark.parametrize("step", [FIRST, 3.0])
@pytest.mark.parametrize("roots", [[0.9], [-2.0, 0.31], [0.75, 6.0, 9.0]])
def test_a_fall_is_located(roots: list[float], step: float) -> None:
    fall = Polynomial.fromroots(roots)
    fall = fall if fall(0.0) > 0 else -fall
    control, event, time = follow(fall, step=step)
    assert (control.mode, event) == (ENDED, 0)
    # Newton's last step starts within 1 % of the root.
    assert time == pytest.approx(min(root for root in roots if root > 0), rel=1e-4)
    # The state from which it starts is nearer by the trial's own step.
    assert abs(control.time_to_event) <= 0.01 * SCALE


def test_a_wrong_expectation_of_two_falls_is_mended() -> None:
    """Newton's method at the place where event 0 was expected says that event 1 falls before."""
    ended = start()._replace(mode=ENDED, event=jnp.asarray(0), time_to_event=jnp.asarray(0.01))
    ends = [Ends(jnp.asarray(1e-6), jnp.asarray(-1.0)), Ends(jnp.asarray(-1e-6), jnp.asarray(-1.0))]
    event, remaining = crossings.first_fall(ended, ends)
    assert (event, remaining) == (1, -1e-6)
    # An event that fell before the step began is not this lane's end; nor is one that rises.
    for other in (Ends(jnp.asarray(-0.5), jnp.asarray(-1.0)), Ends(jnp.asarray(1e-6), jnp.asarray(1.0))):
        assert crossings.first_fall(ended, [ends[0], other]) == (0, 1e-6)


def dipping(lowest: float) -> Polynomial:
    """A function that dips to `lowest` at 1 and falls through zero at 3."""
    return (Polynomial([1.0, -2.0, 1.0]) + lowest) * Polynomial([1.5, -0.5])


@pytest.mark.parametrize("step", [FIRST, 0.7, 1.9])
def test_a_dip_below_zero_ends_the_lane(step: float) -> None:
    # (t-1)² = 1e-4 at 0.99.
    assert follow(dipping(-1e-4), step=step)[2] == pytest.approx(0.99, rel=1e-6)


@pytest.mark.parametrize("step", [FIRST, 0.7, 1.9])
def test_a_dip_that_stays_positive_does_not(step: float) -> None:
    control, _, time = follow(dipping(1e-4), step=step)
    assert time == pytest.approx(3, rel=1e-6)
    assert control.closest_approach == pytest.approx(1e-4, rel=0.01)


def test_a_step_that_may_hide_a_fall_is_tried_again_shorter() -> None:
    """A cubic knows nothing of what wiggles within a step: 0.8·256^(-1/8) = 0.4 of the length."""

    def at(time: float) -> list[Ends]:
        return [Ends(jnp.asarray(0.5 + np.cos(40 * time)), jnp.asarray(-40 * np.sin(40 * time)))]

    within = [[at(share * FIRST)[0].value] for share in (0.15, 0.92)]
    after, moved = after_trial(start(), at(0.0), at(FIRST), within, jnp.asarray(1e-9))
    assert not moved
    assert (after.mode, after.time) == (ADVANCING, 0)
    assert after.trial_length == pytest.approx(0.4 * FIRST, rel=1e-12)


def test_past_an_event_it_is_located_from_the_same_start() -> None:
    fall = Polynomial([0.1, -1.0])
    ends = [[Ends(jnp.asarray(fall(time)), jnp.asarray(fall.deriv()(time)))] for time in (0.0, FIRST)]
    within = [[jnp.asarray(fall(share * FIRST))] for share in (0.15, 0.92)]
    after, moved = after_trial(start(), *ends, within, jnp.asarray(1e-4))
    assert not moved
    assert (after.mode, after.time) == (LOCATING, 0)
    assert after.trial_length == pytest.approx(0.1, rel=1e-12)
    assert after.high == FIRST


def test_no_step_goes_beyond_the_time_asked_for() -> None:
    control, event, time = follow(Polynomial([0.9, -1.0]), t_stop=0.5)
    assert (control.mode, event) == (ENDED, ARRIVED)
    assert time - control.time_to_event == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("t_stop", "expected", "end"), [(0.9 + 1e-6, 0, 0.9), (0.9 - 1e-6, ARRIVED, 0.9 - 1e-6)])
def test_an_event_counts_up_to_the_time_asked_for(t_stop: float, expected: int, end: float) -> None:
    control, event, _ = follow(Polynomial([0.9, -1.0]), t_stop=t_stop)
    assert event == expected
    assert control.time + control.time_to_event == pytest.approx(end, abs=1e-9)
