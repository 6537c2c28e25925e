"""When an event function is expected to fall, on functions that are cubics."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from erosion.ode.crossings import Ends, cubic_error, dip_in_step, expected_fall, is_crooked, may_hide_a_fall


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


def dip(polynomial: np.polynomial.Polynomial, error: float = 0.0) -> tuple[float, float]:
    """Where a step from 0 to 1 has its dip, and its lowest value there."""
    start, end = (Ends(polynomial(t), polynomial.deriv()(t)) for t in (0.0, 1.0))
    where, lowest = dip_in_step(start, end, 1.0, error)
    return float(where), float(lowest)


@pytest.mark.parametrize("theta", [0.1, 0.5, 0.83])
@pytest.mark.parametrize("lowest", [-0.1, 0.0, 1e-4])
def test_a_dip_near_zero_is_where_the_parabola_is_lowest(theta: float, lowest: float) -> None:
    where, value = dip(np.polynomial.Polynomial([theta**2 + lowest, -2 * theta, 1.0]))
    # At a step's end below zero nothing dips: the function has fallen.
    assert where == pytest.approx(theta if (1 - theta) ** 2 + lowest > 0 else 2, abs=1e-12)
    assert value == pytest.approx(lowest if where < 1 else np.inf, abs=1e-12)


def test_a_cubic_is_lowest_where_its_slope_is_zero() -> None:
    """(t - 0.4)² (t + 1) - 0.01, which touches -0.01 at 0.4."""
    touching = np.polynomial.Polynomial.fromroots([0.4, 0.4, -1.0]) - 0.01
    assert dip(touching) == (pytest.approx(0.4, rel=1e-12), pytest.approx(-0.01, rel=1e-12))


def test_a_dip_is_harmless_above_what_its_cubic_may_err() -> None:
    high = np.polynomial.Polynomial([0.25 + 0.1, -1.0, 1.0])
    assert dip(high) == (2, pytest.approx(0.1))
    # The cubic's error at a half: θ²(1-θ)² = 1/16, doubled.
    assert dip(high, error=0.99 * 0.8)[0] == 2
    assert dip(high, error=1.01 * 0.8)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("coefficients", [[1.0, 1.0], [1.0, -0.5], [1.0, 1.0, -1.0], [1.0, 0.0, 0.0, 1.0]])
def test_what_rises_falls_or_humps_has_no_dip(coefficients: list[float]) -> None:
    assert dip(np.polynomial.Polynomial(coefficients)) in ((2, np.inf), (2, 1.0))


def test_a_step_that_ends_on_a_lowest_point_does_not_look_there_again() -> None:
    for lowest_at in (0.0, 1.0):
        where, value = dip(np.polynomial.Polynomial([lowest_at**2 + 1e-6, -2 * lowest_at, 1.0]))
        assert where == 2
        assert value == pytest.approx(1e-6, rel=1e-9)
