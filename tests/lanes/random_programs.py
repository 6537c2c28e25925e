"""Random functions of one lane: arithmetic, choices, small arrays and nested control flow, of every type."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

FLOATS = ("float64", "float32")
SIGNED = ("int8", "int16", "int32", "int64")
UNSIGNED = ("uint8", "uint16", "uint32", "uint64")
WHOLE = (*SIGNED, *UNSIGNED)
TYPES = ("float64", *FLOATS, *WHOLE, "bool")

_UNARY = {
    "f": ("neg", "abs", "sign", "floor", "ceil", "square", "sqrt", "round", "square"),
    "i": ("neg", "abs", "sign", "square", "bitwise_not"),
    "u": ("sign", "square", "bitwise_not"),
    "b": ("bitwise_not",),
}
_BINARY = {
    "f": ("add", "sub", "mul", "div", "max", "min", "rem", "add", "sub", "mul"),
    "i": ("add", "sub", "mul", "div", "max", "min", "rem", "bitwise_and", "bitwise_or", "bitwise_xor", "shift_left",
          "shift_right_arithmetic", "shift_right_logical"),
    "u": ("add", "sub", "mul", "div", "max", "min", "rem", "bitwise_and", "bitwise_or", "bitwise_xor", "shift_left",
          "shift_right_arithmetic", "shift_right_logical"),
    "b": ("bitwise_and", "bitwise_or", "bitwise_xor"),
}  # fmt: skip
_COMPARISONS = ("eq", "ne", "lt", "le", "gt", "ge")
_FUNCTIONS = (
    "exp", "exp2", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "cbrt", "rsqrt", "logistic", "erf", "erfc",
)  # fmt: skip


def _kind(x: Any) -> str:
    return np.dtype(x.dtype).kind


class RandomFunction:
    """A random function of three float64, the same for the same seed.

    Args:
        seed: of the choices.
        exact: only operations on whole float64 of moderate size, whose results are the same with one rounding (fma)
            as with two.
        functions: whether elementary functions are among the operations.
        size: of the function: operations of its outermost level.
    """

    def __init__(self, seed: int, *, exact: bool = False, functions: bool = True, size: int = 12) -> None:
        self.seed, self.exact, self.functions, self.size = seed, exact, functions, size

    def __call__(self, x: Any, y: Any, z: Any) -> list[Any]:
        """Results of several types and shapes."""
        self.random = np.random.default_rng(self.seed)
        values = [x, y, z]
        if not self.exact:
            values += [x.astype(self.pick(WHOLE)), y.astype(self.pick(FLOATS)), z > 0]
        values = self.steps(values, self.size, 0)
        return values[3:]

    def pick(self, choices: Any) -> Any:
        return choices[int(self.random.integers(len(choices)))]

    def steps(self, values: list[Any], count: int, depth: int) -> list[Any]:
        """The values, and those of some more operations on them."""
        values = list(values)
        for _ in range(count):
            made = self.step(values, depth)
            values += made
        return values

    def step(self, values: list[Any], depth: int) -> list[Any]:
        draw = self.random.random()
        if draw < 0.22 and depth < 3:
            return self.pick([self.cond, self.loop, self.loop, self.switch, self.counted, self.scan])(values, depth)
        if draw < 0.40:
            return [self.array(values)]
        return [self.bounded(self.scalar(values))]

    def bounded(self, x: Any) -> Any:
        return jnp.clip(x, -1000.0, 1000.0) if self.exact and _kind(x) == "f" else x

    def scalars(self, values: list[Any], dtype: Any = None) -> list[Any]:
        return [v for v in values if v.shape == () and (dtype is None or v.dtype == dtype)]

    def one_of(self, values: list[Any], dtype: Any) -> Any:
        """A scalar of this type: one that is there, a constant, or another converted."""
        there = self.scalars(values, dtype)
        draw = self.random.random()
        if draw < 0.15:
            return self.constant(dtype)
        if there and draw < 0.85:
            return self.pick(there)
        return self.pick(self.scalars(values)).astype(dtype)

    def constant(self, dtype: Any) -> Any:
        dtype = np.dtype(dtype)
        if dtype.kind == "b":
            return jnp.asarray(bool(self.random.integers(2)))
        if dtype.kind == "f":
            numbers = [0.0, 1.0, -1.0, 2.0, 3.0, 7.0, -4.0]
            if not self.exact:
                numbers += [-0.0, 0.5, 1 / 3, np.inf, -np.inf, np.nan, 1e-40, 1e30, np.pi, -1e-310, 1e300, 2.0**-1022]
            return jnp.asarray(self.pick(numbers), dtype)
        limits = np.iinfo(dtype)
        return jnp.asarray(
            self.pick([0, 1, 2, 3, 7, limits.min, limits.max, limits.max // 2, 8 * dtype.itemsize]), dtype
        )

    def dtype(self) -> Any:
        if self.exact:
            return np.dtype("float64")
        return np.dtype(self.pick(TYPES))

    def scalar(self, values: list[Any]) -> Any:
        dtype = self.dtype()
        kind, draw = dtype.kind, self.random.random()
        x = self.one_of(values, dtype)
        if draw < 0.12:
            return getattr(lax, self.pick(_COMPARISONS))(x, self.one_of(values, dtype))
        if draw < 0.24:
            return jnp.where(self.truth(values), x, self.one_of(values, dtype))
        if draw < 0.32 and not self.exact:
            return x.astype(self.dtype())
        if draw < 0.38 and kind != "b":
            return lax.clamp(self.one_of(values, dtype), x, self.one_of(values, dtype))
        if draw < 0.44 and kind == "f" and self.functions and not self.exact:
            if self.random.random() < 0.2:
                return self.pick([lax.atan2, lax.pow])(x, self.one_of(values, dtype))
            return getattr(lax, self.pick(_FUNCTIONS))(x)
        if draw < 0.48 and kind in "fiu":
            least = -3 if kind == "f" and not self.exact else 0
            return lax.integer_pow(x, int(self.random.integers(least, 4)))
        if draw < 0.52 and kind == "f":
            return lax.is_finite(x)
        if draw < 0.62 or (kind == "b" and draw < 0.7):
            names = [n for n in _UNARY[kind] if not (self.exact and n == "sqrt")]
            return getattr(lax, self.pick(names))(x)
        names = [n for n in _BINARY[kind] if not (self.exact and n == "div")]
        return getattr(lax, self.pick(names))(x, self.one_of(values, dtype))

    def truth(self, values: list[Any]) -> Any:
        truths = self.scalars(values, np.dtype(bool))
        if truths and self.random.random() < 0.5:
            return self.pick(truths)
        dtype = self.dtype()
        return getattr(lax, self.pick(_COMPARISONS))(self.one_of(values, dtype), self.one_of(values, dtype))

    def index(self, values: list[Any]) -> Any:
        if self.exact:
            return self.one_of(values, np.dtype("float64")).astype(np.int32)
        return self.one_of(values, np.dtype(self.pick(WHOLE)))

    def array(self, values: list[Any]) -> Any:
        arrays = [v for v in values if v.shape != ()]
        if not arrays or self.random.random() < 0.25:
            dtype = self.dtype()
            count = self.pick([1, 3, 10])
            if self.random.random() < 0.3:
                return jnp.stack([self.constant(dtype) for _ in range(count)])
            return jnp.stack([self.one_of(values, dtype) for _ in range(count)])
        a = self.pick(arrays)
        kind, first = _kind(a), len(a)
        way = int(self.random.integers(16))
        if way == 0 and kind != "b":
            return self.bounded(self.pick([jnp.max, jnp.min])(a, axis=self.pick([None, 0])))
        if way == 1 and kind != "b":
            return self.bounded(lax.reduce_sum_p.bind(a, axes=tuple(range(a.ndim)), out_sharding=None))
        if way == 2:
            return lax.dynamic_index_in_dim(a, self.index(values), keepdims=False)
        if way == 3:
            return a.at[self.index(values)].get(mode=self.pick(["fill", "clip", "promise_in_bounds"]))
        if way == 4:
            return a.at[self.index(values)].set(self.one_of(values, a.dtype), mode=self.pick(["drop", "clip"]))
        if way == 5:
            size = int(self.random.integers(1, first + 1))
            return lax.dynamic_slice_in_dim(a, self.index(values), size)
        if way == 6:
            size = int(self.random.integers(1, first + 1))
            return lax.dynamic_update_slice_in_dim(a, a[first - size :], self.index(values), 0)
        if way == 7 and kind != "b":
            return (jnp.argmax if self.random.random() < 0.5 else jnp.argmin)(a, axis=0)
        if way == 8 and kind in "fi" and a.ndim == 1:
            return self.bounded(lax.dot(a, a[::-1]))
        if way == 9 and kind in "fi" and a.ndim == 1 and first <= 3:
            return self.bounded(jnp.outer(a, a)) if kind == "f" else a[:, None] * a[None, :]
        if way == 10 and kind in "fiu":
            return self.bounded(
                self.pick([lax.cumsum, lax.cummax, lax.cummin])(a, 0, reverse=bool(self.random.integers(2)))
            )
        if way == 11:
            return jnp.concatenate([a, a[:1]])[1:]
        if way == 12:
            return a[::-1] if a.ndim == 1 else a.T
        if way == 13:
            return lax.select(jnp.broadcast_to(self.truth(values), a.shape), a, a[::-1] if a.ndim == 1 else a)
        if way == 14:
            low, high = int(self.random.integers(-1, 2)), int(self.random.integers(0, 3))
            return lax.pad(
                a, self.one_of(values, a.dtype), [(low if first > 1 else 0, high, 0)] + [(0, 0, 0)] * (a.ndim - 1)
            )
        return getattr(lax, self.pick(_UNARY[kind]))(a) if not self.exact else self.bounded(a + a)

    # Control flow. What is carried keeps its type.

    def updated(self, values: list[Any], state: list[Any], depth: int) -> list[Any]:
        inner = self.steps([*values, *state], int(self.random.integers(1, 5)), depth + 1)
        return [self.bounded(self.like(inner, s)) for s in state]

    def like(self, values: list[Any], example: Any) -> Any:
        same = [v for v in values if v.shape == example.shape and v.dtype == example.dtype]
        if self.random.random() < 0.8 or example.shape != ():
            return same[-1] if self.random.random() < 0.6 else self.pick(same)
        return self.one_of(values, example.dtype)

    def carried(self, values: list[Any]) -> list[Any]:
        return [self.pick(values) for _ in range(int(self.random.integers(1, 4)))]

    def seeded(self) -> int:
        return int(self.random.integers(2**62))

    def apart(self, function: Any) -> Any:
        """A function that may be traced several times, always with the same choices."""
        seed = self.seeded()

        def same(*arguments: Any) -> Any:
            outer, self.random = self.random, np.random.default_rng(seed)
            try:
                return function(*arguments)
            finally:
                self.random = outer

        return same

    def cond(self, values: list[Any], depth: int) -> list[Any]:
        state, truth = self.carried(values), self.truth(values)
        cases = [self.apart(lambda *s: self.updated(values, list(s), depth)) for _ in range(2)]
        return list(lax.cond(truth, *cases, *state))

    def switch(self, values: list[Any], depth: int) -> list[Any]:
        state, case = self.carried(values), self.index(values).astype(np.int32)
        cases = [
            self.apart(lambda *s: self.updated(values, list(s), depth)) for _ in range(int(self.random.integers(2, 5)))
        ]
        return list(lax.switch(case, cases, *state))

    def loop(self, values: list[Any], depth: int) -> list[Any]:
        state, most = self.carried(values), int(self.random.integers(1, 5))
        condition = self.apart(lambda s: (s[0] < most) & self.truth([*values, *s[1:]]))
        body = self.apart(lambda s: [s[0] + 1, *self.updated(values, list(s[1:]), depth)])
        count, *after = lax.while_loop(condition, body, [jnp.asarray(0), *state])
        return [*after, count] if not self.exact else after

    def counted(self, values: list[Any], depth: int) -> list[Any]:
        state, most = self.carried(values), int(self.random.integers(1, 4))
        body = self.apart(lambda i, s: self.updated([*values] if self.exact else [*values, i], list(s), depth))
        if self.random.random() < 0.5:
            truth = self.truth(values)
            return list(lax.fori_loop(0, jnp.where(truth, most, 0), body, state))
        return list(lax.fori_loop(0, most, body, state))

    def scan(self, values: list[Any], depth: int) -> list[Any]:
        state = self.carried(values)
        rows = jnp.stack([self.one_of(values, np.dtype("float64")) for _ in range(3)])

        def body(s: Any, row: Any) -> Any:
            after = self.updated([*values, row], list(s), depth)
            return after, after[0]

        after, stacked = lax.scan(self.apart(body), state, rows, reverse=bool(self.random.integers(2)))
        return [*after, *([stacked] if stacked.ndim <= 2 else [])]
