"""The length of the next step, and when a lane is given up, while no event is near."""

import functools

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion.ode import step_control
from erosion.ode.batch import alike_together
from erosion.ode.methods import dormand_prince
from erosion.ode.step_control import ADVANCING, ENDED, FAILED, NOT_BEGUN, UNFINISHED, Control, Limits

FIRST = 0.17
SCALE = 1.0
LIMITS = Limits(20_000, by_scale=True)


def start(step: float = FIRST, scale: float = SCALE, *, begins: bool = True, finite: bool = True) -> Control:
    return step_control.begin(jnp.asarray(scale), jnp.asarray(begins), jnp.asarray(finite), step)


go_on = jax.jit(step_control.go_on, static_argnames="limits")


def one_trial(control: Control, error: float, limits: Limits = LIMITS) -> tuple[Control, bool]:
    """A trial whose event functions stay at 1."""
    after, moved = go_on(control, jnp.asarray(error), SCALE, limits)
    return after, bool(moved)


@pytest.mark.parametrize(
    ("error", "factor"),
    [
        (0.0, 5.0),
        (1e-4, 0.8 * 1e-4 ** (-1 / 8)),
        (1.0, 0.8),
        (100.0, 0.8 * 100 ** (-1 / 8)),
        (1e9, 0.2),
        (np.inf, 0.2),
        (np.nan, 0.2),
    ],
)
def test_the_next_step_follows_the_error(error: float, factor: float) -> None:
    """A method of 7th order errs as h⁸: 0.8 of the length that would just do, within limits."""
    after, moved = one_trial(start(), error)
    assert moved == (error <= 1)
    assert after.trial_length == pytest.approx(FIRST * factor, rel=1e-12)
    assert after.time == (FIRST if moved else 0)
    assert (after.trials, after.rejected) == (1, 0 if moved else 1)


def test_steps_that_get_shorter_go_on_so() -> None:
    """Half of a step's shortening is expected of the next; nothing after longer steps, rejected ones and the first."""
    foresees = LIMITS._replace(foresees=True)
    wanted = FIRST * 0.8 * 0.5 ** (-1 / 8)
    for before, shorter in ((0.0, 1.0), (wanted / 2, 1.0), (wanted * 2, 0.75)):
        control = start()._replace(wanted=jnp.asarray(before))
        after, _ = one_trial(control, 0.5, foresees)
        assert after.trial_length == pytest.approx(shorter * wanted, rel=1e-12)
        assert after.wanted == pytest.approx(wanted, rel=1e-12)
        rejected, _ = one_trial(control, 100.0, foresees)
        assert rejected.trial_length == pytest.approx(FIRST * 0.8 * 100 ** (-1 / 8), rel=1e-12)
        assert rejected.wanted == before


def test_a_step_cut_short_does_not_shorten_the_next() -> None:
    wanted = start()._replace(trial_length=jnp.asarray(FIRST / 100))
    after, moved = one_trial(wanted, 1e-4)
    assert moved
    assert after.trial_length == FIRST


def test_a_lane_begins_only_with_finite_numbers_and_a_time_scale() -> None:
    assert start().mode == ADVANCING
    assert [start(finite=False).mode, start(scale=0.0).mode, start(scale=np.nan).mode] == [FAILED] * 3
    nothing = start(begins=False)
    assert (nothing.mode, nothing.event) == (ENDED, NOT_BEGUN)


@pytest.mark.parametrize(("error", "factor"), [(np.nan, 0.2), (2.0, 0.8 * 2 ** (-1 / 8))])
def test_steps_that_only_shrink_come_to_an_end(error: float, factor: float) -> None:
    """At 1e-14 of the time scale."""
    control = start()
    while step_control.goes_on(control):
        control, _ = one_trial(control, error)
    assert control.mode == FAILED
    assert control.trials == np.ceil(np.log(1e-14 / FIRST) / np.log(factor))


@pytest.mark.parametrize(
    ("time", "trials", "rejected", "mode"),
    [
        (0.999e4, 100, 0, ADVANCING),
        (1e4, 100, 0, UNFINISHED),
        (1.0, 19_999, 0, ADVANCING),
        (1.0, 20_000, 0, UNFINISHED),
        # Most trials are rejected where the error is rounding.
        (1.0, 300, 256, ADVANCING),
        (1.0, 300, 300, FAILED),
        # 2e-6 of the time scale a trial is too slow.
        (1e-6, 511, 0, ADVANCING),
        (1e-6, 513, 0, FAILED),
    ],
)
def test_what_does_not_end_is_given_up(time: float, trials: int, rejected: int, mode: int) -> None:
    before = start(step=1e-6)._replace(
        time=jnp.asarray(time), trials=jnp.asarray(trials), rejected=jnp.asarray(rejected)
    )
    assert one_trial(before, 0.5)[0].mode == mode


@pytest.mark.parametrize("time", [1e5, 1e-6])
def test_a_time_scale_that_is_no_limit_gives_no_lane_up(time: float) -> None:
    before = start(step=1e-6)._replace(time=jnp.asarray(time), trials=jnp.asarray(600))
    assert one_trial(before, 0.5)[0].mode in (UNFINISHED, FAILED)
    assert one_trial(before, 0.5, Limits(20_000, by_scale=False))[0].mode == ADVANCING
    assert one_trial(before, 0.5, Limits(600, by_scale=False))[0].mode == UNFINISHED


def test_the_eighth_root() -> None:
    assert step_control.eighth_root(jnp.asarray(256.0)) == 2


@functools.cache
def _forests(order):
    """The multisets of rooted trees that have `order` vertices together; a tree is its root's forest."""
    if order == 0:
        return {()}
    return {
        tuple(sorted((*rest, tree), key=repr))
        for size in range(1, order + 1)
        for tree in _forests(size - 1)
        for rest in _forests(order - size)
    }


def _conditions(order):
    """The stages' elementary weights (trees, stages) of Butcher's conditions up to an order."""
    a = np.zeros((dormand_prince.B.size,) * 2)
    for i, row in enumerate(dormand_prince.A):
        a[i + 1, : row.size] = row

    def weight(tree):
        return functools.reduce(np.multiply, [a @ weight(child) for child in tree], np.ones(len(a)))

    return np.array([weight(tree) for size in range(order) for tree in _forests(size)])


def test_the_second_estimate_is_of_sixth_order_and_its_own():
    assert len(_conditions(7)) == 1 + 1 + 2 + 4 + 9 + 20 + 48
    check, error = dormand_prince.B_CHECK, dormand_prince.B_ERROR
    assert np.abs(_conditions(7) @ error).max() < 1e-13
    assert np.abs(_conditions(6) @ check).max() < 1e-13
    assert np.abs(_conditions(7) @ check).max() > 1e-3
    assert abs(check @ error) < 1e-13
    assert np.isclose(check @ check, error @ error)
    # The step makes both estimates from the same stages.
    assert np.array_equal(check != 0, error != 0)


def test_the_pair_is_that_of_diffrax():
    pair = diffrax.Dopri8.tableau
    assert [list(row) for row in dormand_prince.A] == [list(row) for row in pair.a_lower]
    assert list(dormand_prince.B) == list(pair.b_sol)
    assert list(dormand_prince.B_ERROR) == list(pair.b_error)


def test_of_the_second_stage_the_transposed_step_leaves_terms_of_seventh_order():
    """Of one Jacobian J, Ȳ = Σ (h J)ᵏ⁺¹ (Aᵀ)ᵏ b there: it estimates what a cotangent errs by."""
    a = np.array([np.pad(row, (0, len(dormand_prince.A) - row.size)) for row in (np.zeros(0), *dormand_prince.A[:-1])])
    powers = [np.linalg.matrix_power(a.T, k) @ dormand_prince.B[:-1] for k in range(7)]
    assert np.abs([power[1] for power in powers[:6]]).max() < 1e-15
    assert abs(powers[6][1]) > 1e-5


def _spread(values: np.ndarray, tile: int) -> float:
    """The mean range of a tile, over the range of all."""
    return float(np.mean(np.ptp(values.reshape(-1, tile), axis=1)) / np.ptp(values))


def test_tiles_are_small_in_every_parameter() -> None:
    leaves = list(np.random.default_rng(0).random((2, 64 * 64)))
    order = alike_together(leaves, 64)
    assert np.array_equal(np.sort(order), np.arange(64 * 64))
    # 64 tiles halve each of two parameters three times: an eighth of the range, hardly more.
    assert all(_spread(leaf[order], 64) < 0.2 for leaf in leaves)
    assert all(_spread(leaf, 64) > 0.9 for leaf in leaves)


@pytest.mark.parametrize("size", [1, 5, 64, 65, 1000])
def test_every_lane_has_one_place(size: int) -> None:
    random = np.random.default_rng(1).random((3, size))
    for leaves in (
        random[:1],
        random,
        np.round(random),
        np.ones((2, size)),
        np.full((1, size), np.nan),
        np.full((1, size), np.inf),
    ):
        assert np.array_equal(np.sort(alike_together(list(leaves), 64)), np.arange(size))


def test_one_parameter_is_put_in_order() -> None:
    leaf = np.random.default_rng(2).random(500)
    constant = np.ones(500)
    # To within the two bytes of a key.
    assert np.allclose(leaf[alike_together([constant, leaf], 8)], np.sort(leaf), atol=1e-4)


def test_numbers_farther_apart_than_any_float_are_put_in_order() -> None:
    values = np.linspace(-1.0, 1.0, 1000) * 1.7e308
    order = alike_together([values, np.arange(1000.0)], 8)
    assert np.array_equal(np.sort(order), np.arange(1000))
