"""The gradient of a loss over the event times of a thousand pendulums by the weights of a network, beside diffrax.

The network is a torque beside gravity. Each lane is let go at an angle and ends where it first hangs down; the
loss is the mean square of these times less 1.7. Both contenders compute value and gradient.

    python -m benchmarks.ode_gradient --weights 12 96 321 1021 5038
    python -m benchmarks.ode_gradient --contender diffrax
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
    "erosion": (of_erosion, 1e-9),
    "diffrax": (of_diffrax, 1e-8),
}
"""By name what makes the gradient's function, and its tolerance."""


def flat(weights: Weights) -> np.ndarray:
    """The weights one after another, by their names."""
    return np.concatenate([np.ravel(weights[name]) for name in sorted(weights)])


def main() -> None:
    """Print a line for each contender and size: the first call, and the median of the second half of the rounds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--weights", type=int, nargs="+", default=list(WIDTHS), choices=list(WIDTHS))
    parser.add_argument("--contender", choices=[*CONTENDERS, "both"], default="both")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--rtol", type=float)
    options = parser.parse_args()
    names = list(CONTENDERS) if options.contender == "both" else [options.contender]
    print(f"{'weights':>8} {'contender':>10} {'first call, CPU s':>18} {'gradient, CPU s':>16} {'error':>9}")
    for size in options.weights:
        lines = []
        for name in names:
            make, rtol = CONTENDERS[name]
            rtol = options.rtol or rtol
            begin = time.process_time()
            gradient = make(size, rtol)
            found = flat(gradient()[1])
            first, spent = time.process_time() - begin, []
            for _ in range(options.rounds):
                begin = time.process_time()
                gradient()
                spent.append(time.process_time() - begin)
            lines.append((name, first, np.median(spent[options.rounds // 2 :]), found))
        # At last: it shares its programs with the first call.
        best = flat(of_erosion(size, 1e-13)()[1])
        for name, first, median, found in lines:
            error = np.abs(found - best).max() / np.abs(best).max()
            print(f"{size:8} {name:>10} {first:18.2f} {median:16.4f} {error:9.0e}", flush=True)


if __name__ == "__main__":
    main()
