"""The gradient of a loss over the event times of a thousand pendulums by the weights of a network, beside diffrax.

The network is a torque beside gravity. Each lane is let go at an angle and ends where it first hangs down; the
loss is the mean square of these times less 1.7. Both contenders compute value and gradient.

    python -m benchmarks.ode_gradient --weights 12 96 321 1021 5038
    python -m benchmarks.ode_gradient --contender diffrax

Erosion has two times: those of its first calls, by code that was compiled quickly, and those after some seconds, by
code that was compiled with care.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from erosion import ode

LANES, MEAN, T1 = 1000, 1.7, 20.0
WIDTHS = {12: (4, False), 96: (32, False), 321: (16, True), 1021: (30, True), 5038: (69, True)}
"""By the number of weights the width of a network's layers, and whether there are two."""

Weights = dict[str, Any]


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


def of_erosion(size: int, rtol: float) -> Callable[[], tuple[float, Weights]]:
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


def of_diffrax(size: int, rtol: float) -> Callable[[], tuple[float, Weights]]:
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
        return found.ts[0]  # pyright: ignore[reportOptionalSubscript]

    at = jnp.asarray(angles())
    compiled = jax.jit(jax.value_and_grad(lambda w: jnp.mean((jax.vmap(time_of, (0, None))(at, w) - MEAN) ** 2)))
    return lambda: jax.block_until_ready(compiled(w))


CONTENDERS: Mapping[str, tuple[Callable[..., Callable[[], tuple[float, Weights]]], float]] = {
    "diffrax": (of_diffrax, 1e-8),
    "erosion": (of_erosion, 1e-9),
}
"""By name what makes the gradient's function, and its tolerance; erosion's may be looser beside diffrax."""

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
"""Of erosion, from which the loosest is taken whose gradient errs by no more than that of diffrax."""

QUICK_CODE = 4.0
"""Seconds of processor time after which careful code has taken the place of quick code."""


def flat(weights: Weights) -> np.ndarray:
    """The weights one after another, by their names."""
    return np.concatenate([np.ravel(weights[name]) for name in sorted(weights)])


def timed(function: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of processor time that a call takes, and what it gives."""
    begin = time.process_time()
    found = function()
    return time.process_time() - begin, found


def main() -> None:
    """Print a line for each contender and size: the first call, and the least of the rounds, taken by turns."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=int, nargs="+", default=list(WIDTHS), choices=list(WIDTHS))
    parser.add_argument("--contender", choices=[*CONTENDERS, "both"], default="both")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--rtol", type=float, help="of erosion; by default the loosest that is as exact as diffrax")
    options = parser.parse_args()
    names = list(CONTENDERS) if options.contender == "both" else [options.contender]
    heads = ("weights", 8), ("contender", 11), ("rtol", 7), ("error", 7), ("first call", 11), ("then", 9), ("later", 9)
    print("".join(f"{head:>{width}}" for head, width in heads) + "  (CPU s)")
    for size in options.weights:
        ways = {name: CONTENDERS[name][0](size, CONTENDERS[name][1]) for name in names}
        firsts = {name: timed(way) for name, way in ways.items()}
        # It shares its programs with the first call.
        best = flat(of_erosion(size, 1e-13)()[1])

        def error(found: tuple[float, Weights], best: np.ndarray = best) -> float:
            return float(np.abs(flat(found[1]) - best).max() / np.abs(best).max())

        errors, tolerances = {name: error(found) for name, (_, found) in firsts.items()}, {}
        for name in names:
            tolerances[name] = CONTENDERS[name][1]
            if name == "erosion" and (options.rtol or "diffrax" in errors):
                for rtol in [options.rtol] if options.rtol else TOLERANCES:
                    tolerances[name], ways[name] = rtol, of_erosion(size, rtol)
                    errors[name] = error(ways[name]())
                    if options.rtol or errors[name] <= errors["diffrax"]:
                        break
        rounds = [{name: timed(way)[0] for name, way in ways.items()} for _ in range(options.rounds)]
        later = [{} for _ in rounds]
        if "erosion" in ways:
            begin = time.process_time()
            while time.process_time() - begin < QUICK_CODE:
                ways["erosion"]()
            later = [{"erosion": timed(ways["erosion"])[0]} for _ in rounds]
        for name in names:
            least = [min((each[name] for each in some if name in each), default=np.nan) for some in (rounds, later)]
            print(
                f"{size:8} {name:>10} {tolerances[name]:6.0e} {errors[name]:6.0e} {firsts[name][0]:10.2f} "
                f"{least[0]:8.4f} {least[1]:8.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
