"""Step control: the 8(7) pair of Prince and Dormand, the precision asked for, and the next step's length.

These are the numbers of `diffrax.Dopri8`, which a test compares. They are written out because
importing diffrax would take a tenth of the time in which a fresh process finds an angle of
greatest removal, and the batch needs nothing else of it.

References:
    P. J. Prince, J. R. Dormand, J. Comput. Appl. Math. 7 (1981) 67-75.
"""

import functools
import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Flag, Scalar

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


def moved_by(weights: Sequence[float] | np.ndarray, u: Scalar, h: Scalar, slopes: Sequence[Scalar]) -> Scalar:
    """U + h Σ w k."""
    used = [k for weight, k in zip(weights, slopes, strict=False) if weight != 0]
    return _increment(tuple(weight for weight in weights if weight != 0))(u, h, used)


# JAX takes 0.1 ms to trace each product; these are traced once for all rows and programs.
@functools.cache
def _increment(weights: tuple[float, ...]) -> Callable[[Scalar, Scalar, Sequence[Scalar]], Scalar]:
    return jax.jit(lambda u, h, slopes: u + h * weighted(weights, slopes))


@functools.cache
def total_by(weights: tuple[float, ...]) -> Callable[[Sequence[Scalar]], Scalar]:
    """What gives Σ w k of slopes."""
    return jax.jit(functools.partial(weighted, weights))


def weighted(weights: Sequence[float] | np.ndarray, slopes: Sequence[Scalar]) -> Scalar:
    """Σ w k."""
    terms = [float(weight) * k for weight, k in zip(weights, slopes, strict=False) if weight != 0]
    return sum(terms[1:], terms[0]) if terms else 0.0 * slopes[0]


class PrecisionError(RuntimeError):
    """JAX is running in single precision."""


def require_float64() -> None:
    """Raise where JAX would compute in float32.

    Importing `erosion` turns 64-bit mode on, so this only fails where the environment
    (`JAX_ENABLE_X64=0`) or a later `jax.config.update` has turned it off.

    Raises:
        PrecisionError: with the line that mends it.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise PrecisionError(
            "erosion needs float64, but JAX's 64-bit mode is off; unset JAX_ENABLE_X64 or call "
            'jax.config.update("jax_enable_x64", True) before computing.'
        )


def require_xla() -> None:
    """Raise where XLA cannot compute, which the batches of the engine do without.

    Raises:
        PrecisionError: see `require_float64`.
        RuntimeError: where the device that JAX is to use is not there, or where this process was forked
            from one in which XLA has computed: its threads do not come along, and it would wait for ever.
    """
    require_float64()
    global _process
    if _process is None:
        try:
            jax.default_backend()
        except (AssertionError, RuntimeError) as error:
            asked = os.environ.get("JAX_PLATFORMS", "")
            raise RuntimeError(
                f"JAX has no device to compute on, as JAX_PLATFORMS={asked} asks for one that is not here; unset it."
            ) from error
        _process = os.getpid()
    if _process != os.getpid():
        raise RuntimeError(
            "This process was forked from one in which JAX has computed, and JAX cannot go on in it; "
            'start processes by the method "spawn": multiprocessing.get_context("spawn").'
        )


_process: int | None = None
"""The process in which XLA has started."""


ADVANCING, LOCATING, ENDED, FAILED, UNFINISHED = range(5)

NOT_BEGUN, ARRIVED, STIFF = -1, -2, -3
"""The event of a lane that ends at its start, of one at the time asked for, and of one that is given up as stiff."""

FIRST_STEP = 0.17  # of the time scale
_SAFETY = 0.8  # of the step that would just do
_TREND = 0.5  # of a step's shortening is expected of the next step, too
LONGEST = 1e4  # of the time scale, where nothing else bounds a lane; later is "unfinished"
_REJECTED = 256  # trials, and eight more for each accepted: then the error must be rounding
_STUCK = 512  # trials at a pace that would take more than all of them for a 25th of the time scale: rounding, too
_PACE = 2e-6  # of the time scale a trial
_SHORTEST = 1e-14  # of the time scale


class Limits(NamedTuple):
    """When a lane is given up, and how its steps follow one another.

    Args:
        trials: after so many.
        by_scale: whether the time scale says how long a lane may take at most, and how slow a pace is hopeless.
        foresees: whether steps that get shorter are expected to go on so.
    """

    trials: int
    by_scale: Flag
    foresees: bool = False


class Control(NamedTuple):
    """Where a lane stands between two trials."""

    mode: Scalar
    time: Scalar  # from the start of the lane to that of the step
    trial: Scalar  # the length to try next
    step: Scalar  # the length that the error control would like
    high: Scalar  # while locating: a length past the event
    event: Scalar  # the index of the event that ended the lane
    left: Scalar  # from the last trial's end to the event
    trials: Scalar
    rejected: Scalar  # trials whose error was too large
    margin: Scalar  # the least value to which an event function has dipped so far
    wanted: Scalar  # the length that the error control asked for after the last accepted step; 0 before it


def begin(scale: Scalar, begins: Flag, finite: Flag, first: float) -> Control:
    """At the start: `scale` is the time scale, `begins` says whether the lane goes on from there."""
    zero = 0.0 * scale
    mode = jnp.where(finite & (scale > 0), jnp.where(begins, ADVANCING, ENDED), FAILED)
    return Control(
        mode=mode,
        time=zero,
        trial=first * scale,
        step=first * scale,
        high=zero,
        event=jnp.where(begins, 0, NOT_BEGUN),
        left=zero,
        trials=0 * mode,
        rejected=0 * mode,
        margin=zero + jnp.inf,
        wanted=zero,
    )


def goes_on(control: Control) -> Flag:
    """Whether there is another step to try."""
    return control.mode <= LOCATING


def go_on(control: Control, error: Scalar, scale: Scalar, limits: Limits) -> tuple[Control, Flag]:
    """The control after a trial with no event near, and whether the lane moves to the trial's end.

    Args:
        control: before the trial.
        error: over the tolerance; NaN is an error.
        scale: the time scale.
        limits: when a lane is given up.
    """
    good = error <= 1
    wanted = next_step(control, error, good)
    step = foreseen_step(control, wanted, good, limits)
    after = counted(control, jnp.inf, good, good)._replace(wanted=jnp.where(good, wanted, control.wanted))
    return given_up(after._replace(step=step, trial=step), scale, limits), good


def eighth_root(value: Scalar) -> Scalar:
    """The root of the step control's order."""
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(value)))


def next_step(control: Control, error: Scalar, good: Flag) -> Scalar:
    """The length that the error control would like, of the order of the embedded estimate."""
    factor = _SAFETY / eighth_root(error + 1e-30)
    wanted = jnp.where(jnp.isfinite(error), jnp.clip(factor, 0.2, 5.0), 0.2) * control.trial
    # A step shortened to end at a dip or an event says little about the next step.
    return jnp.where(good & (control.trial < control.step), jnp.maximum(wanted, control.step), wanted)


def foreseen_step(control: Control, wanted: Scalar, good: Flag, limits: Limits) -> Scalar:
    """The next step's length: shorter than the error control would like where it liked a longer one before."""
    if not limits.foresees:
        return wanted
    shorter = jnp.minimum(wanted / control.wanted, 1.0)
    return jnp.where(good, wanted * (1 - _TREND + _TREND * shorter), wanted)


def counted(control: Control, lowest: Scalar, good: Flag, moved: Flag) -> Control:
    """The control with one more trial."""
    return control._replace(
        time=control.time + jnp.where(moved, control.trial, 0.0),
        trials=control.trials + 1,
        rejected=control.rejected + jnp.where(good, 0, 1),
        margin=jnp.where(moved, jnp.minimum(control.margin, lowest), control.margin),
    )


def given_up(control: Control, scale: Scalar, limits: Limits) -> Control:
    """The control, given up where the lane takes too long or the error must be rounding."""
    late, hopeless = (
        control.trials > limits.trials,
        control.rejected > _REJECTED + 8 * (control.trials - control.rejected),
    )
    if limits.by_scale is not False:
        late = (limits.by_scale & (control.time > LONGEST * scale)) | late
        stuck = (control.trials > _STUCK) & (control.time < _PACE * control.trials * scale)
        hopeless = (limits.by_scale & stuck) | hopeless
    mode = jnp.where(late, UNFINISHED, control.mode)
    return control._replace(mode=jnp.where(~(control.trial > _SHORTEST * scale) | hopeless, FAILED, mode))
