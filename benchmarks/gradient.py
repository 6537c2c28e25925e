"""The gradient of a loss over the event times of a thousand pendulums by the weights of a network, beside diffrax."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.page import Table
from benchmarks.timing import by_turns, processor_time, warm
from erosion import ode

TITLE = "Gradients"
TEXT = """A loss over the event times of 1,000 pendulums, and its gradient by the weights of a network that is a torque
beside gravity. diffrax (Tsit5, checkpointed adjoint) has `rtol` 1e-8, erosion the loosest at which its gradient is as
exact. "First" includes compiling."""

DIFFRAX = 1e-8
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
WARM = 4.0  # seconds until optimised code runs
LANES, MEAN, T1 = 1000, 1.7, 20.0
WIDTHS = {12: (4, False), 321: (16, True)}
"""By the number of weights the width of a network's layers, and whether there are two."""

Weights = dict[str, Any]
Way = Callable[[], tuple[float, Weights]]


def network(size: int) -> tuple[Weights, Callable[[Weights, Any], Any]]:
    """Random weights, and the torque at an angle."""
    width, is_deep = WIDTHS[size]
    random = np.random.default_rng(1)
    w: Weights = {"a": random.normal(size=width), "b": random.normal(size=width)}
    if is_deep:
        w["m"] = random.normal(size=(width, width)) / np.sqrt(width)
        w["c"] = 0.3 * random.normal(size=width)
        w["z"] = np.float64(0.01)
    w["v"] = 0.1 * random.normal(size=width) / np.sqrt(width)

    def torque(w: Weights, angle: Any) -> Any:
        hidden = jnp.tanh(w["a"] * angle + w["b"])
        return w["v"] @ jnp.tanh(w["m"] @ hidden + w["c"]) + w["z"] if is_deep else w["v"] @ hidden

    return w, torque


def angles() -> np.ndarray:
    """Where the lanes begin."""
    return np.random.default_rng(0).uniform(0.3, 2.0, LANES)


def of_erosion(size: int, rtol: float) -> Way:
    """Loss and gradient by `Solution.gradient`."""
    w, torque = network(size)
    problem = ode.Problem(
        y0=lambda args: {"angle": args["angle"], "rate": 0.0},
        vector_field=lambda t, y, args: {
            "angle": y["rate"],
            "rate": -jnp.sin(y["angle"]) + torque(args["w"], y["angle"]),
        },
        events={"down": ode.Event(lambda t, y, args: y["angle"], direction=-1)},
    )
    args = {"angle": angles(), "w": w}

    def gradient() -> tuple[float, Weights]:
        end = ode.solve(problem, args, t1=T1, rtol=rtol, shared="w", gradient=True)
        off = end.t - MEAN
        return float(np.mean(off**2)), end.gradient(t=2 * off / LANES)["w"]

    return gradient


def of_diffrax(size: int, rtol: float) -> Way:
    """The same by its checkpointed adjoint."""
    import diffrax
    import optimistix

    w, torque = network(size)

    def time_of(angle: Any, w: Weights) -> Any:
        def field(t: Any, y: Any, args: Any) -> Any:
            return jnp.stack([y[1], -jnp.sin(y[0]) + torque(args, y[0])])

        def down(t: Any, y: Any, args: Any, **_: Any) -> Any:
            return y[0]

        found = diffrax.diffeqsolve(
            diffrax.ODETerm(field), diffrax.Tsit5(), 0.0, T1, 0.1, jnp.stack([angle, 0.0 * angle]), w,
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=rtol * 1e-2), max_steps=1024,
            event=diffrax.Event(down, optimistix.Newton(1e-10, 1e-10, optimistix.rms_norm), direction=False),
        )  # fmt: skip
        return found.ts[0]  # pyrefly: ignore

    at = jnp.asarray(angles())
    compiled = jax.jit(jax.value_and_grad(lambda w: jnp.mean((jax.vmap(time_of, (0, None))(at, w) - MEAN) ** 2)))
    return lambda: jax.block_until_ready(compiled(w))


def flat(weights: Weights) -> np.ndarray:
    """The weights one after another, by their names."""
    return np.concatenate([np.ravel(weights[name]) for name in sorted(weights)])


def measure(quick: bool) -> Table:
    """Two rows a network."""
    rows = []
    for size in (12,) if quick else (12, 321):
        diffrax = of_diffrax(size, DIFFRAX)
        firsts = {"erosion": processor_time(of_erosion(size, DIFFRAX)), "diffrax": processor_time(diffrax)}
        best = flat(of_erosion(size, 1e-13)()[1])

        def error(way: Way, best: np.ndarray = best) -> float:
            return float(np.abs(flat(way()[1]) - best).max() / np.abs(best).max())

        aim = error(diffrax)
        rtol = next(rtol for rtol in TOLERANCES if error(of_erosion(size, rtol)) <= aim)
        ways = {"erosion": of_erosion(size, rtol), "diffrax": diffrax}
        warm(ways["erosion"], 0.5 if quick else WARM)
        times = by_turns({name: lambda way=way: processor_time(way) for name, way in ways.items()}, 2 if quick else 5)
        for name, each in times.items():
            rows.append([f"{size} weights", name, firsts[name], each.median, each.ratio, error(ways[name])])
    return Table(["network", "contender", "first, s", "then, s", "time over erosion's", "error"], rows)
