"""Memory beside a lane's results: numbers written and read at places that the lane computes.

A tape is a row of float64 numbers of each lane, of a length that is known only when it runs. What writes is ordered by
a token: a number that the function passes on from write to write, and gives back so that none is dropped.

    def lane(x, token):  # x, x², x³, … up to 100
        def write(at):
            n, power, token = at
            return n + 1, power * x, tapes.write(0, token, n, power)

        count, _, token = lax.while_loop(lambda at: at[1] < 100, write, (0, x, token))
        return count, token

    Lanewise(lane, (number, number), tapes=1)

"""

from typing import Any

import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.typing import ArrayLike

WRITE, READ = "tape_write", "tape_read"
_write, _read = Primitive(WRITE), Primitive(READ)


def write(slot: int, token: ArrayLike, place: ArrayLike, *values: ArrayLike) -> Any:
    """Write numbers, one after another, into the lane's own tape, and give the next token.

    Args:
        slot: which tape.
        token: what was written before.
        place: where the first number goes; all of them must be within the tape.
        values: float64.
    """
    return _write.bind(token, place, *values, slot=slot)


def read(slot: int, token: ArrayLike, place: ArrayLike) -> Any:
    """The number at a place of the lane's own tape, which must be within it; arguments as of `write`."""
    return _read.bind(token, place, slot=slot)


def _number(*_: Any, **__: Any) -> ShapedArray:
    return ShapedArray((), np.dtype(np.float64))


_write.def_abstract_eval(_number)
_read.def_abstract_eval(_number)
