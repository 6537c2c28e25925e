"""The 8(7) pair of Prince and Dormand.

The weights are the numbers of `diffrax.Dopri8`, which a test compares. They are written out because
importing diffrax would take a tenth of the time in which a fresh process finds an angle of
greatest removal, and the batch needs nothing else of it.

References:
    P. J. Prince, J. R. Dormand, J. Comput. Appl. Math. 7 (1981) 67-75.
"""

from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from erosion.arguments import Scalar
from erosion.ode.methods.runge_kutta import BackSteps, RungeKutta, Tableau, estimate
from erosion.ode.reduction import FlatState

_EIGHTH = [
    14005451 / 335480064, 0, 0, 0, 0, -59238493 / 1068277825, 181606767 / 758867731, 561292985 / 797845732,
    -1041891430 / 1371343529, 760417239 / 1151165299, 118820643 / 751138087, -528747749 / 2220607170, 1 / 4,
]  # fmt: skip
_SEVENTH = [
    13451932 / 455176623, 0, 0, 0, 0, -808719846 / 976000145, 1757004468 / 5645159321, 656045339 / 265891186,
    -3867574721 / 1518517206, 465885868 / 322736535, 53011238 / 667516719, 2 / 45, 0,
]  # fmt: skip
A = tuple(map(np.array, (
    [1 / 18],
    [1 / 48, 1 / 16],
    [1 / 32, 0, 3 / 32],
    [5 / 16, 0, -75 / 64, 75 / 64],
    [3 / 80, 0, 0, 3 / 16, 3 / 20],
    [29443841 / 614563906, 0, 0, 77736538 / 692538347, -28693883 / 1125000000, 23124283 / 1800000000],
    [16016141 / 946692911, 0, 0, 61564180 / 158732637, 22789713 / 633445777, 545815736 / 2771057229,
     -180193667 / 1043307555],
    [39632708 / 573591083, 0, 0, -433636366 / 683701615, -421739975 / 2616292301, 100302831 / 723423059,
     790204164 / 839813087, 800635310 / 3783071287],
    [246121993 / 1340847787, 0, 0, -37695042795 / 15268766246, -309121744 / 1061227803, -12992083 / 490766935,
     6005943493 / 2108947869, 393006217 / 1396673457, 123872331 / 1001029789],
    [-1028468189 / 846180014, 0, 0, 8478235783 / 508512852, 1311729495 / 1432422823, -10304129995 / 1701304382,
     -48777925059 / 3047939560, 15336726248 / 1032824649, -45442868181 / 3398467696, 3065993473 / 597172653],
    [185892177 / 718116043, 0, 0, -3185094517 / 667107341, -477755414 / 1098053517, -703635378 / 230739211,
     5731566787 / 1027545527, 5232866602 / 850066563, -4093664535 / 808688257, 3962137247 / 1805957418,
     65686358 / 487910083],
    [403863854 / 491063109, 0, 0, -5068492393 / 434740067, -411421997 / 543043805, 652783627 / 914296604,
     11173962825 / 925320556, -13158990841 / 6184727034, 3936647629 / 1978049680, -160528059 / 685178525,
     248638103 / 1413531060, 0],
    _EIGHTH,
)))  # fmt: skip
"""Weights of the slopes so far in each stage after the first; the last row is the step itself."""
B = np.array([*_EIGHTH, 0])
"""Weights of all slopes, that at the step's end included, in the solution of 8th order."""
B_ERROR = np.array([*(eighth - seventh for eighth, seventh in zip(_EIGHTH, _SEVENTH, strict=True)), 0])
"""And in its difference from that of 7th order."""
B_CHECK = np.array([
    -0.06546771316990013, 0, 0, 0, 0, -1.182781246546709, 0.2775527180863478, 1.0732487838069504,
    0.7396385533976804, -1.0064401897180706, 0.32273397601182074, -1.3755777404252905, 1.217092858557171,
    0,
])  # fmt: skip
"""A second estimate, of 6th order.

All differences of two solutions of 6th order are a plane in the space of weights; this one is
orthogonal to the pair's own, and as long.
"""


class _DormandPrinceBackSteps(BackSteps):
    power, stages = 9 / 7, len(A)  # a stage at a step's end is not one of them

    def errors(self, transposed: Callable[[np.ndarray], FlatState], of_states: dict[int, FlatState]) -> FlatState:
        """See `BackSteps`: of the second stage's cotangents nothing but terms of 7th order is left."""
        return of_states[1]


class DormandPrince(RungeKutta):
    """See `RungeKutta`."""

    tableau, back_steps = Tableau(A, B, B_ERROR), _DormandPrinceBackSteps
    # The embedded estimate is of 7th order, the solution of 8th. Where states are wanted, too,
    # at an event they err by the error of its time as well. Measured on the six problems of benchmarks/ode_problems.py.
    slack = 4.0, (1.0, 0.7, 4.0)
    interior_stages = (5, 9)  # stages at 0.15 and 0.92 of a step: a cubic that errs between them errs at one of them
    more_interior_stages = (5, 7, 9)  # with one at 0.56, where event functions may move faster than the state

    def check(self, check: Scalar, h: Scalar, slopes: Sequence[Scalar], size: Scalar) -> Scalar:
        """See `RungeKutta`."""
        return jnp.maximum(check, estimate(tuple(B_CHECK), h, slopes, size))
