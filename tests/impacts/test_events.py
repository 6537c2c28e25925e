"""The first fall of event functions, on looks at functions that are known."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from erosion.impacts.diffrax_steps import Fall, find_root, first_fall


def looks(times: np.ndarray, **functions: Polynomial) -> Fall | None:
    """The first fall, by the functions' values and rates at these times."""
    values = {name: function(times) for name, function in functions.items()}
    rates = {name: function.deriv()(times) for name, function in functions.items()}
    return first_fall(times, values, rates)


TIMES = np.linspace(0, 2, 21)
LATE, EARLY = Polynomial([1.57, -1.0]), Polynomial([1.52, -1.0])


@pytest.mark.parametrize("root", [0.05, 0.77, 1.99])
def test_the_cubic_of_a_cubic_falls_where_it_does(root: float) -> None:
    fall = looks(TIMES, stop=Polynomial.fromroots([root, -1.0, 7.0]))
    assert fall is not None
    assert fall.time == pytest.approx(root, rel=1e-12)
    assert fall.low <= root <= fall.high
    assert fall.high - fall.low == pytest.approx(0.1)


def test_the_first_of_several_falls_is_named() -> None:
    for functions in ({"late": LATE, "early": EARLY}, {"early": EARLY, "late": LATE}):
        fall = looks(TIMES, **functions)
        assert fall is not None
        assert (fall.name, fall.time) == ("early", pytest.approx(1.52))


def test_what_stays_positive_does_not_fall() -> None:
    assert looks(TIMES, rest=Polynomial([1.0]), dip=Polynomial([1.0 + 1e-6, -2.0, 1.0])) is None


def test_a_dip_between_two_looks_is_seen() -> None:
    """Below zero for a thousandth of the time between looks at 1.0 and 1.1."""
    fall = looks(TIMES, dip=Polynomial.fromroots([1.04995, 1.05005]))
    assert fall is not None
    assert fall.time == pytest.approx(1.04995, rel=1e-9)


def test_the_start_at_zero_is_contact_and_no_fall() -> None:
    # Rounding may leave it just below.
    for below in (0.0, 1e-17):
        fall = looks(TIMES, rebound=Polynomial.fromroots([0.0, 0.03]) * -1 - below)
        assert fall is not None
        assert fall.time == pytest.approx(0.03, rel=1e-9)


def test_a_motion_that_is_not_finite_is_an_error_that_says_since_when() -> None:
    values = np.where(TIMES > 0.95, np.nan, 1.0)
    with pytest.raises(ArithmeticError, match=r"^the motion is not finite after 0\.9 s$"):
        first_fall(TIMES, {"stop": values}, {"stop": np.zeros(21)})


@pytest.mark.parametrize("root", [2.3681748354496e-05, 0.5, 3.0])
@pytest.mark.parametrize("off", [0.0, 1e-15, -1e-15, 1e-9, -1e-9])
def test_where_newton_has_found_the_end_no_one_looks_further(root, off):
    looked = []

    def event(t):
        looked.append(t)
        # At the root a rest remains, as it does where the value comes from an integration.
        return root - t + 1e-17 * root, -1.0

    end = find_root(event, Fall(root * (1 + off), root * 0.9, root * 1.1, "stop"))
    assert end == pytest.approx(root, rel=2e-15)
    assert len(looked) <= 3


def test_without_a_slope_to_follow_the_end_is_bracketed():
    # A fall that lies flat at zero, and one whose slope leads out of the bracket at first.
    for event in (lambda t: ((1 - t) ** 3, -3 * (1 - t) ** 2), lambda t: (np.arctan(20 * (1 - t)), -0.01)):
        assert find_root(event, Fall(0.6, 0.5, 1.7, "stop")) == pytest.approx(1, abs=1e-5)
