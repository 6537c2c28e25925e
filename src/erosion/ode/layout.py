"""Arguments as plain numbers, which may differ from lane to lane, and the rest, which all lanes share.

The numbers are those leaves of the arguments that are floats, whole numbers or arrays, and then, where the problem
has a clock, those of `Clock`. Everything else in the arguments (functions, strings) is part of the program.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from erosion.array_types import Indices, Number, PerLane, Structure
from erosion.ode.equations import Equations
from erosion.ode.problem import OTHER_ENDS, Problem


class Clock(NamedTuple):
    """The numbers of a lane beside its arguments.

    Args:
        t0, t1: where the lane begins, and where it ends without an event.
        max_step: no step is longer.
        max_events: events that a chain may have.
    """

    t0: Number
    t1: Number
    max_step: Number
    max_events: Number


class Options(NamedTuple):
    """What a program does beside its equations.

    Args:
        waits: an event whose function is zero or beyond it counts once it has returned.
        begins: a lane whose event functions are not all before their events at the start ends there.
        clock: the numbers end with those of `Clock`.
        whole: the state at the end is wanted, beside the integrals.
        smooth: the motion has no kinks, whatever its arithmetic looks like; None looks.
        max_steps: trials after which a lane is unfinished.
        sizes: of each number of the state: below a size times the tolerance it need not be known.
    """

    waits: bool = False
    begins: bool = True
    clock: bool = False
    whole: bool = False
    smooth: bool | None = None
    max_steps: int = 20_000
    sizes: tuple[float, ...] | None = None


class Layout:
    """What programs need to know of a problem and its arguments beside the numbers. Equal layouts share a program.

    Layouts are equal where the problems compute the same from numbers of the same shapes, however they are written.

    Args:
        problem: the problem.
        structure: of the arguments.
        leaves: of the arguments, those that are no numbers; `None` in the place of a number.
        shapes: of each number, for one lane.
        dtypes: of each number.
        options: of the program.
        equations: of the problem with such arguments.
    """

    def __init__(
        self,
        problem: Problem,
        structure: Structure,
        leaves: tuple[object, ...],
        shapes: tuple[tuple[int, ...], ...],
        dtypes: tuple[str, ...],
        options: Options,
        equations: Equations,
    ) -> None:
        self.problem, self.structure, self.leaves, self.options = problem, structure, leaves, options
        count = len(Clock._fields) if options.clock else 0
        self.shapes, self.dtypes = shapes + ((),) * count, dtypes + ("float64",) * count
        self.equations = equations
        self._key = equations.digest, self.shapes, self.dtypes, options

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Layout) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def renewed(self) -> "Layout":
        """The layout of the same problem as its code is now; a program of JAX may keep a layout for long."""
        if self.equations.surroundings.unchanged():
            return self
        args = self.args([np.zeros(struct.shape, struct.dtype) for struct in self.structs()])
        return self._of(self.options, self.problem.equations(args, self.equations.numbers))

    def wanting(self, **options: Any) -> "Layout":
        """The layout with other options."""
        return self._of(self.options._replace(**options), self.equations)

    def _of(self, options: Options, equations: Equations) -> "Layout":
        count = len(self.shapes) - (len(Clock._fields) if self.options.clock else 0)
        own = self.shapes[:count], self.dtypes[:count]
        return Layout(self.problem, self.structure, self.leaves, *own, options, equations)

    @functools.cached_property
    def offsets(self) -> list[int]:
        """The place of each number's first element among the elements of all numbers; last, how many there are."""
        return [0, *np.cumsum([math.prod(shape) for shape in self.shapes]).tolist()]

    @property
    def event_names(self) -> tuple[str, ...]:
        """The events, in their order."""
        return _event_names(self)

    @functools.cached_property
    def state(self) -> PyTree:
        """Shapes and types of one lane's state."""
        known = self.equations.state
        return jax.eval_shape(lambda n: self.problem.start(self.args(n)), self.structs()) if known is None else known

    @property
    def end_names(self) -> tuple[str, ...]:
        """What a code of an outcome means."""
        return (*self.event_names, *OTHER_ENDS)

    def has_no_result(self, codes: np.ndarray) -> np.ndarray:
        """Whether lanes failed or are unfinished."""
        names = self.end_names
        return (codes == names.index("failed")) | (codes == names.index("unfinished"))

    def args(self, numbers: Sequence[Number]) -> Any:
        """The arguments with these numbers."""
        rest = iter(numbers)
        return jax.tree.unflatten(self.structure, [next(rest) if leaf is None else leaf for leaf in self.leaves])

    def clock(self, numbers: Sequence[Number]) -> Clock:
        """The numbers of the clock."""
        return Clock(*numbers[len(numbers) - len(Clock._fields) :])

    def sizes(self, numbers: Sequence[Number]) -> list[Number]:
        """The size of a significant change of each number."""
        if self.problem.typical is None:
            sizes = list(numbers)
        else:
            typical = jax.tree.leaves(self.problem.typical(self.args(numbers)))
            sizes = [size for size, leaf in zip(typical, self.leaves, strict=True) if leaf is None]
        if self.options.clock:
            clock = self.clock(numbers)
            span = jnp.where(jnp.isfinite(clock.t1), clock.t1 - clock.t0, 1.0)
            sizes[len(self.shapes) - len(clock) :] = clock._replace(t0=span, t1=span)
        return [jnp.abs(size) for size in sizes]

    def of_lanes(self, numbers: Sequence[PerLane], lanes: Indices | slice) -> list[PerLane]:
        """The numbers of some lanes, given by indices or a slice; those that all lanes share stay as they are."""
        return [
            number[lanes] if number.ndim > len(shape) else number
            for number, shape in zip(numbers, self.shapes, strict=True)
        ]

    def structs(self) -> list[jax.ShapeDtypeStruct]:
        """Shape and type of one lane's numbers."""
        return [jax.ShapeDtypeStruct(*struct) for struct in zip(self.shapes, self.dtypes, strict=True)]


# By layout, not in it: each call of a user makes a layout, and equal ones have the same events.
@functools.lru_cache(maxsize=256)
def _event_names(layout: Layout) -> tuple[str, ...]:
    names: list[tuple[str, ...]] = []

    def look(numbers: Sequence[Number]) -> float:
        names.append(layout.problem.event_names(layout.args(numbers)))
        return 0.0

    jax.eval_shape(look, layout.structs())
    return names[0]
