"""diffrax under vmap, in blocks of lanes, one after another, by `lax.map`.

One event on the minimum of both functions, falling: with two events diffrax reports the first
in pytree order, not the earliest. Both cores get half of the work each, by a thread.
"""

import concurrent.futures
from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

import erosion  # noqa: F401 - turns float64 on
from benchmarks.pool import cores
from benchmarks.work import FAILED, NO_CUT, REBOUND, STOP, Answers, Work, constants

TOLERANCES = {"Tsit5": 1e-10, "Dopri8": 1e-11}  # 99 % of the volumes are then right to 2e-9
BLOCK = 64  # Dopri8 is fastest at 32, Tsit5 at 128
_LATE = 1e3  # [1/ω]
SOLVERS = {"Tsit5": diffrax.Tsit5, "Dopri8": diffrax.Dopri8}


def prepare(work: Work, solver: str, rtol: float) -> Callable[[], Answers]:
    """`BLOCK` lanes at a time; the equations as in `heyoka_taylor`."""
    threads = len(cores())
    c, cut = constants(), np.nonzero(work.cutting())[0]
    count = -(-len(cut) // threads)
    block = min(BLOCK, count)
    blocks = -(-count // block)
    # Every thread gets the same shape: the last lanes are repeated where the work runs out.
    share = [cut[np.minimum(np.arange(i, i + threads * block * blocks, threads), len(cut) - 1)] for i in range(threads)]
    starts = [(work.alpha[index].reshape(blocks, block), work.s[index].reshape(blocks, block)) for index in share]
    starts = jax.device_put(starts)

    def run() -> Answers:
        def one(lanes: Any) -> Any:
            return jax.block_until_ready(_solve(*lanes, rtol, solver))

        with concurrent.futures.ThreadPoolExecutor(threads) as pool:
            results = list(pool.map(one, starts))
        volume, end = np.zeros(len(work)), np.full(len(work), NO_CUT)
        for index, (volumes, codes) in zip(share, results, strict=True):
            volume[index], end[index] = c.volume * np.asarray(volumes).ravel(), np.asarray(codes).ravel()
        return Answers(volume, end)

    return run


def _depth_and_speed(z: Any) -> tuple[Any, Any]:
    rho = constants().rho
    cosine = jnp.cos(z[1])
    return z[0] - rho * (1 - cosine), z[2] + rho * z[4] * cosine


def _derivative(_: Any, z: Any, __: Any) -> Any:
    c = constants()
    depth, speed = _depth_and_speed(z)
    return jnp.stack([z[3], z[4], -depth / c.k, -depth, -depth / (c.k * c.rho * c.beta), depth * speed])


def _condition(t: Any, y: Any, args: Any, **_: Any) -> Any:
    return jnp.minimum(*_depth_and_speed(y))


def _one(alpha: Any, s: Any, rtol: Any, solver: str) -> Any:
    zero = jnp.zeros_like(alpha)
    start = jnp.stack([zero, zero, jnp.cos(alpha), jnp.sin(alpha), s / constants().rho, zero])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_derivative),
        SOLVERS[solver](),
        t0=0.0,
        t1=_LATE,
        dt0=0.01,
        y0=start,
        stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * 1e-3),
        event=diffrax.Event(_condition, optx.Newton(1e-12, 1e-12), direction=False),
        adjoint=diffrax.ForwardMode(),
        max_steps=4096,
        throw=False,
    )
    assert solution.ys is not None
    final = solution.ys[-1]
    depth, speed = _depth_and_speed(final)
    code = jnp.where(jnp.abs(depth) < jnp.abs(speed), REBOUND, STOP)
    return final[-1], jnp.where(solution.result == diffrax.RESULTS.event_occurred, code, FAILED)


@jax.jit(static_argnames="solver")
def _solve(alpha: Any, s: Any, rtol: Any, solver: str) -> Any:
    lanes = jax.vmap(lambda a, b: _one(a, b, rtol, solver))
    return jax.lax.map(lambda pair: lanes(*pair), (alpha, s))
