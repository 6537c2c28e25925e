"""Lanes on a GPU: XLA compiles a function of one lane's numbers for many lanes."""

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Array, PyTree

# On a CPU XLA would fuse every stage of an integrator with all before it, and compile for minutes.
_ON_A_CPU = {"xla_disable_hlo_passes": "fusion,cpu-instruction-fusion", "xla_backend_optimization_level": 0}


class XlaLanes:
    """A function of one lane's numbers, compiled for many lanes: `jax.vmap` of it; arguments as of `Lanewise`."""

    def __init__(self, function: Callable[..., PyTree], examples: Sequence[PyTree]) -> None:
        leaves, structure = jax.tree.flatten(tuple(examples))
        self.inputs = [tuple(leaf.shape) for leaf in leaves]
        self._dtypes = [leaf.dtype for leaf in leaves]

        def lane(given: list[Array]) -> list[Array]:
            return jax.tree.leaves(function(*jax.tree.unflatten(structure, given)))

        # A function that cannot be traced fails here, before anything runs.
        jax.eval_shape(lane, leaves)
        options = _ON_A_CPU if jax.default_backend() == "cpu" else None
        self._lanes = jax.jit(jax.vmap(lane), compiler_options=options)

    def run(
        self,
        leaves: Sequence[np.ndarray],
        order: np.ndarray,
        results: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
    ) -> None:
        """Compute some lanes, in an order, and write their results; see `Lanewise.run`. XLA cannot be stopped."""
        del stop
        if not len(order):
            return
        # A program for each power of two: the last lane is repeated.
        count = 1 << (len(order) - 1).bit_length()
        filled = np.concatenate([order, np.full(count - len(order), order[-1])])
        given = [
            np.broadcast_to(leaf, (count, *leaf.shape)) if leaf.ndim == len(shape) else leaf[filled]
            for leaf, shape in zip(leaves, self.inputs, strict=True)
        ]
        computed = self._lanes([leaf.astype(dtype) for leaf, dtype in zip(given, self._dtypes, strict=True)])
        for result, part in zip(results, computed, strict=True):
            result[order] = np.asarray(part)[: len(order)]
