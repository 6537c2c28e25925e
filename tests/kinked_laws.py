"""Force laws with kinks, jumps and infinite rates, as a user's first plug-in has them."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import erosion

KNOTS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6])  # depths over r
VALUES = np.array([0.0, 0.03, 0.06, 0.15, 0.22, 0.5, 0.7, 1.9])


class _OfDepth(erosion.models.ForceLaw):
    """F_x = -c r f(depth/r), F_y = k F_x."""

    def factor(self, u: Any) -> Any:
        """f."""
        raise NotImplementedError

    def __call__(self, state: Any, tip: erosion.Tip, p: erosion.Parameters) -> tuple[Any, Any]:
        horizontal = -p.stiffness * p.r * self.factor(tip.depth / p.r)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p: erosion.Parameters) -> Any:
        return p.k


class KinkedTable(_OfDepth):
    """From a table."""

    def factor(self, u: Any) -> Any:
        return jnp.interp(u, KNOTS, VALUES)


class Where(_OfDepth):
    """Softer below 0.2 r."""

    def factor(self, u: Any) -> Any:
        return jnp.where(u < 0.2, u, 0.2 + 0.3 * (u - 0.2))


class Cond(_OfDepth):
    """Harder below 0.2 r."""

    def factor(self, u: Any) -> Any:
        return lax.cond(u < 0.2, lambda u: u, lambda u: 0.2 + 2.0 * (u - 0.2), u)


class Power(_OfDepth):
    """NaN above the surface, and with an infinite second derivative at it."""

    def factor(self, u: Any) -> Any:
        return u**1.5


class Breaking(_OfDepth):
    """The material breaks at 0.2 r: the force jumps."""

    def factor(self, u: Any) -> Any:
        return jnp.where(u < 0.2, u, 0.6 * u)


@jax.custom_jvp
def _opaque(u: Any) -> Any:
    return u


@_opaque.defjvp
def _(primals: Any, tangents: Any) -> Any:
    return primals[0], jnp.nan * tangents[0]


class Opaque(_OfDepth):
    """Nobody knows its derivative."""

    def factor(self, u: Any) -> Any:
        return _opaque(u)


KNOTS_OF = {KinkedTable: KNOTS[1:], Where: [0.2], Cond: [0.2], Power: [], Breaking: [0.2]}


def model_of(law: type[_OfDepth]) -> erosion.models.Rotating:
    """A body that turns, with the law."""
    return erosion.models.Rotating(force=law())


def random_impacts(count: int, seed: int) -> erosion.Parameters:
    """Impacts at random about Table 1, slow and fast, spinning either way."""
    random, p = np.random.default_rng(seed), erosion.TABLE_1.to("si")
    return p.replace(
        alpha=random.uniform(0.02, 1.5, count),
        k=random.uniform(0.5, 4, count),
        phidot0=random.uniform(-0.3, 0.3, count) * float(p.v0) / float(p.r),
        v0=float(p.v0) * random.uniform(0.3, 2, count),
    )
