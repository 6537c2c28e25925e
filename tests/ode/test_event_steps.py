"""How the end of a lane is found among trial steps, for event functions that are known polynomials of time."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

from erosion.ode import crossings, step_control
from erosion.ode.crossings import Ends
from erosion.ode.step_control import ADVANCING, ARRIVED, ENDED, LOCATING, Control, Limits

FIRST = 0.17
SCALE = 1.0
LIMITS = Limits(20_000, by_scale=True)


def start(step: float = FIRST) -> Control:
    return step_control.begin(jnp.asarray(SCALE), jnp.asarray(True), jnp.asarray(True), step)


@jax.jit
def after_trial(control: Control, before: list[Ends], after: list[Ends], within: list, error: jax.Array):
    """As the integrator does it."""
    looks = list(zip((0.15, 0.92), within, strict=True))
    clear = crossings.are_clear([], control.trial, before, after, looks, 1e-5)
    return jax.lax.cond(
        jnp.stack(clear).all() & (control.mode == ADVANCING),
        lambda: step_control.go_on(control, error, SCALE, LIMITS),
        lambda: crossings.decide(
            control, crossings.look(control, before, after, looks, error, jnp.ones(()), clear=clear), SCALE, LIMITS
        ),
    )


@jax.jit
def both_ways(control: Control, before: list[Ends], after: list[Ends], within: list, error: jax.Array):
    """Which events are clear, and what follows without a look at those, with one at all, and with none at any."""
    watched = crossings.watch([-1] * len(before), before, SCALE)
    looks = list(zip((0.15, 0.92), within, strict=True))

    def decided(clear: list):
        trial = crossings.look_directed(watched, control, before, after, looks, error, jnp.ones(()), clear=clear)
        return crossings.decide(control, trial, SCALE, LIMITS)

    clear = crossings.are_clear(watched, control.trial, before, after, looks, 1e-5)
    none = [jnp.asarray(False)] * len(clear)
    return clear, decided(clear), decided(none), step_control.go_on(control, error, SCALE, LIMITS)


@pytest.mark.slow
def test_a_look_at_clear_events_changes_nothing() -> None:
    """Two random cubics with wiggles, before their events and beyond them, near zero and far from it."""
    random = np.random.default_rng(3)
    lanes = 20_000
    step = random.uniform(0.01, 3.0, lanes)
    control = jax.vmap(lambda h: start()._replace(trial=h, step=h))(step)
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
    assert np.mean(quiet) > 0.05
    assert np.mean(one) > 0.1
    for name in ("mode", "time", "trial", "step", "trials", "rejected", "event", "left", "high"):
        found = getattr(looked[0], name)
        assert np.array_equal(getattr(without[0], name), found, equal_nan=True), name
        if name not in ("event", "left", "high"):
            assert np.array_equal(getattr(unseen[0], name)[quiet], found[quiet]), name
    assert np.array_equal(without[1], looked[1])
    assert np.array_equal(unseen[1][quiet], looked[1][quiet])
    assert np.all(looked[0].margin[quiet] > 1e-5)


def follow(
    *events: Polynomial, error: float = 1e-4, until: float | None = None, step: float = FIRST
) -> tuple[Control, int, float]:
    """Step through event functions to the end: the last control, the event's index and its time."""

    def at(time: float) -> list[Ends]:
        return [Ends(jnp.asarray(event(time)), jnp.asarray(event.deriv()(time))) for event in events]

    def within_limit(control: Control) -> Control:
        return control if until is None else crossings.stop_at(control, until)

    control, here = within_limit(start(step)), at(0.0)
    while step_control.goes_on(control):
        begin, length = float(control.time), float(control.trial)
        there = at(begin + length)
        within = [[jnp.asarray(event(begin + share * length)) for event in events] for share in (0.15, 0.92)]
        control, moved = after_trial(control, here, there, within, jnp.asarray(error))
        control = within_limit(control)
        here = there if moved else here
    event, remaining = crossings.first_fall(control, at(float(control.time + control.left)))
    return control, int(event), float(control.time + control.left + remaining)


@pytest.mark.slow
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
    assert abs(control.left) <= 0.01 * SCALE


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, -1])
def test_of_two_falls_the_first_ends_the_lane(order: int) -> None:
    first, second = Polynomial([0.5, -1.0]), Polynomial([0.501, -1.0])
    _, event, time = follow(*(first, second)[::order])
    assert event == (0 if order == 1 else 1)
    assert time == pytest.approx(0.5, rel=1e-9)


def test_a_wrong_expectation_of_two_falls_is_mended() -> None:
    """Newton's method at the place where event 0 was expected says that event 1 falls before."""
    ended = start()._replace(mode=ENDED, event=jnp.asarray(0), left=jnp.asarray(0.01))
    ends = [Ends(jnp.asarray(1e-6), jnp.asarray(-1.0)), Ends(jnp.asarray(-1e-6), jnp.asarray(-1.0))]
    event, remaining = crossings.first_fall(ended, ends)
    assert (event, remaining) == (1, -1e-6)
    # An event that fell before the step began is not this lane's end; nor is one that rises.
    for other in (Ends(jnp.asarray(-0.5), jnp.asarray(-1.0)), Ends(jnp.asarray(1e-6), jnp.asarray(1.0))):
        assert crossings.first_fall(ended, [ends[0], other]) == (0, 1e-6)


def dip(lowest: float) -> Polynomial:
    """A function that dips to `lowest` at 1 and falls through zero at 3."""
    return (Polynomial([1.0, -2.0, 1.0]) + lowest) * Polynomial([1.5, -0.5])


@pytest.mark.parametrize("step", [FIRST, 0.7, 1.9])
def test_a_dip_below_zero_ends_the_lane(step: float) -> None:
    # (t-1)² = 1e-4 at 0.99.
    assert follow(dip(-1e-4), step=step)[2] == pytest.approx(0.99, rel=1e-6)


@pytest.mark.parametrize("step", [FIRST, 0.7, 1.9])
def test_a_dip_that_stays_positive_does_not(step: float) -> None:
    control, _, time = follow(dip(1e-4), step=step)
    assert time == pytest.approx(3, rel=1e-6)
    assert control.margin == pytest.approx(1e-4, rel=0.01)


def test_a_step_that_may_hide_a_fall_is_tried_again_shorter() -> None:
    """A cubic knows nothing of what wiggles within a step: 0.8·256^(-1/8) = 0.4 of the length."""

    def at(time: float) -> list[Ends]:
        return [Ends(jnp.asarray(0.5 + np.cos(40 * time)), jnp.asarray(-40 * np.sin(40 * time)))]

    within = [[at(share * FIRST)[0].value] for share in (0.15, 0.92)]
    after, moved = after_trial(start(), at(0.0), at(FIRST), within, jnp.asarray(1e-9))
    assert not moved
    assert (after.mode, after.time) == (ADVANCING, 0)
    assert after.trial == pytest.approx(0.4 * FIRST, rel=1e-12)


def test_past_an_event_it_is_located_from_the_same_start() -> None:
    fall = Polynomial([0.1, -1.0])
    ends = [[Ends(jnp.asarray(fall(time)), jnp.asarray(-1.0))] for time in (0.0, FIRST)]
    within = [[jnp.asarray(fall(share * FIRST))] for share in (0.15, 0.92)]
    after, moved = after_trial(start(), *ends, within, jnp.asarray(1e-4))
    assert not moved
    assert (after.mode, after.time) == (LOCATING, 0)
    assert after.trial == pytest.approx(0.1, rel=1e-12)
    assert after.high == FIRST


def test_no_step_goes_beyond_the_time_asked_for() -> None:
    control, event, time = follow(Polynomial([0.9, -1.0]), until=0.5)
    assert (control.mode, event) == (ENDED, ARRIVED)
    assert time - control.left == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("until", "expected", "end"), [(0.9 + 1e-6, 0, 0.9), (0.9 - 1e-6, ARRIVED, 0.9 - 1e-6)])
def test_an_event_counts_up_to_the_time_asked_for(until: float, expected: int, end: float) -> None:
    control, event, _ = follow(Polynomial([0.9, -1.0]), until=until)
    assert event == expected
    assert control.time + control.left == pytest.approx(end, abs=1e-9)
