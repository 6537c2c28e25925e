"""When an event function is expected to fall, on functions that are cubics."""

import numpy as np
import pytest

from erosion.engine.crossings import Ends, expected_fall


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
