import functools

import diffrax
import numpy as np

from erosion.ode import step_control


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
    a = np.zeros((step_control.B.size,) * 2)
    for i, row in enumerate(step_control.A):
        a[i + 1, : row.size] = row

    def weight(tree):
        return functools.reduce(np.multiply, [a @ weight(child) for child in tree], np.ones(len(a)))

    return np.array([weight(tree) for size in range(order) for tree in _forests(size)])


def test_the_second_estimate_is_of_sixth_order_and_its_own():
    assert len(_conditions(7)) == 1 + 1 + 2 + 4 + 9 + 20 + 48
    check, error = step_control.B_CHECK, step_control.B_ERROR
    assert np.abs(_conditions(7) @ error).max() < 1e-13
    assert np.abs(_conditions(6) @ check).max() < 1e-13
    assert np.abs(_conditions(7) @ check).max() > 1e-3
    assert abs(check @ error) < 1e-13
    assert np.isclose(check @ check, error @ error)
    # The step makes both estimates from the same stages.
    assert np.array_equal(check != 0, error != 0)


def test_the_pair_is_that_of_diffrax():
    pair = diffrax.Dopri8.tableau
    assert [list(row) for row in step_control.A] == [list(row) for row in pair.a_lower]
    assert list(step_control.B) == list(pair.b_sol)
    assert list(step_control.B_ERROR) == list(pair.b_error)


def test_of_the_second_stage_the_transposed_step_leaves_terms_of_seventh_order():
    """Of one Jacobian J, Ȳ = Σ (h J)ᵏ⁺¹ (Aᵀ)ᵏ b there: it estimates what a cotangent errs by."""
    a = np.array([np.pad(row, (0, len(step_control.A) - row.size)) for row in (np.zeros(0), *step_control.A[:-1])])
    powers = [np.linalg.matrix_power(a.T, k) @ step_control.B[:-1] for k in range(7)]
    assert np.abs([power[1] for power in powers[:6]]).max() < 1e-15
    assert abs(powers[6][1]) > 1e-5
