"""Arguments as plain numbers of lanes, and all else that a program follows from: its `Signature`.

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

from erosion.arguments import Indices, Number, PerLane, Structure
from erosion.ode.outputs import IntegralOutputs, LaneOutputs
from erosion.ode.problem import OTHER_ENDS, Problem, TracedProblem


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
        arm_on_return: an event whose function is zero or beyond it counts once it has returned.
        check_start: a lane whose event functions are not all before their events at the start ends there.
        fires: an event whose function is zero or past it at the start happens there.
        one_sided: derivatives where two things end a motion at once are those of the first in order; else NaN where
            they differ. A search for a maximum looks at both sides by itself.
        outputs: what is wanted of a lane's end; the parameters end with those of `Clock` where it is clocked.
        smooth: the motion has no kinks, whatever its arithmetic looks like; None looks.
        switches: breaks of the rates are located, see `switches`.
        max_steps: trials after which a lane is unfinished.
        state_scale: of each number of the state: below a size times the tolerance it need not be known.
        method: "explicit", "rosenbrock", or "auto": an explicit lane that turns out to be stiff is given up, and
            `batch` integrates it by the other.
        saves: the state is wanted at times as well, see `tape`.
        records: the steps of a lane without derivatives are written on a tape, see `tape`.
        logs: the events on the way are written on a tape, see `tape`.
    """

    arm_on_return: bool = False
    check_start: bool = True
    fires: bool = False
    one_sided: bool = False
    outputs: LaneOutputs = IntegralOutputs()
    smooth: bool | None = None
    switches: bool = False
    max_steps: int = 20_000
    state_scale: tuple[float, ...] | None = None
    method: str = "explicit"
    saves: bool = False
    records: bool = False
    logs: bool = False

    @property
    def for_stiff(self) -> bool:
        """Whether the method is one for stiff motions."""
        return self.method in FOR_STIFF


FOR_STIFF = frozenset({"rosenbrock"})
"""The methods for stiff motions: they take the state as it is written, whose Jacobian is sparse."""


class Signature:
    """A problem and its arguments without the numbers. Equal signatures share a program.

    Signatures are equal where the problems compute the same from numbers of the same shapes, however they are written.

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
        equations: TracedProblem,
    ) -> None:
        self.problem, self.structure, self.leaves, self.options = problem, structure, leaves, options
        count = len(Clock._fields) if options.outputs.are_clocked else 0
        self.shapes, self.dtypes = shapes + ((),) * count, dtypes + ("float64",) * count
        self.equations = equations
        self._key = equations.digest, self.shapes, self.dtypes, options

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Signature) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def name(self, *of: object) -> str:
        """A program's name for every process, of what else decides what it computes.

        Empty where the equations hold in this process alone.
        """
        return "" if self.equations.process_local else repr((self._key, *of))

    def __reduce__(self) -> tuple[Any, ...]:
        """Without the equations: a process that reads it traces them from its own code."""
        return _traced_again, (self.problem, self.structure, self.leaves, *self._of_arguments, self.options)

    def renewed(self) -> "Signature":
        """The signature of the same problem as its code is now; a program of JAX may keep a signature for long."""
        if self.equations.snapshot.unchanged():
            return self
        args = self.args([np.zeros(struct.shape, struct.dtype) for struct in self.structs()])
        return self._of(self.options, self.problem.equations(args, self.equations.parameters))

    def of_problem(self, problem: Problem) -> "Signature":
        """The signature of another problem with such arguments."""
        args = self.args([np.zeros(struct.shape, struct.dtype) for struct in self.structs()])
        equations = problem.equations(args, self.equations.parameters)
        return Signature(problem, self.structure, self.leaves, *self._of_arguments, self.options, equations)

    def wanting(self, **options: Any) -> "Signature":
        """The signature with other options."""
        wanted = self.options._replace(**options)
        return self if wanted == self.options else self._of(wanted, self.equations)

    def _of(self, options: Options, equations: TracedProblem) -> "Signature":
        return Signature(self.problem, self.structure, self.leaves, *self._of_arguments, options, equations)

    @property
    def arguments(self) -> int:
        """How many of the parameters are arguments; those of the clock follow, whose names arguments may have, too."""
        return len(self.equations.parameters)

    @property
    def _of_arguments(self) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
        return self.shapes[: self.arguments], self.dtypes[: self.arguments]

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
    def rows(self) -> int:
        """How many numbers the time at the end and the outputs are."""
        elements = range(sum(math.prod(leaf.shape) for leaf in jax.tree.leaves(self.state)))
        return 1 + len(self.options.outputs.of(lambda: elements, [*self.problem.integrals]))

    @property
    def end_names(self) -> tuple[str, ...]:
        """What a code of an outcome means."""
        return (*self.event_names, *OTHER_ENDS)

    def end_times(self, parameters: Sequence[Any], codes: Any, elapsed: Any) -> Any:
        """When lanes ended, which is the end wherever one is asked for: a later time is after it, by one digit too.

        Args:
            parameters: of the lanes.
            codes: how they ended, see `end_names`.
            elapsed: since they began.
        """
        clock = self.clock(parameters)
        where = jnp.where if isinstance(elapsed, jax.Array) else np.where
        # t0 + (t1 - t0) may be another number than t1.
        return where(codes == self.end_names.index("t1"), clock.t1, clock.t0 + elapsed)

    def has_no_result(self, codes: Any) -> Any:
        """Whether lanes failed or are unfinished."""
        names = self.end_names
        return (codes == names.index("failed")) | (codes == names.index("unfinished"))

    def args(self, parameters: Sequence[Number]) -> Any:
        """The arguments with these numbers."""
        rest = iter(parameters)
        return jax.tree.unflatten(self.structure, [next(rest) if leaf is None else leaf for leaf in self.leaves])

    def clock(self, parameters: Sequence[Number]) -> Clock:
        """The numbers of the clock; without one a lane begins at 0 and goes on for ever."""
        return Clock(*parameters[self.arguments :]) if self.has_clock else Clock(0.0, math.inf, math.inf, math.inf)

    @property
    def has_clock(self) -> bool:
        """Whether the parameters end with the numbers of a clock."""
        return len(self.shapes) > self.arguments

    def parameter_scale(self, parameters: Sequence[Number]) -> list[Number]:
        """The size of a significant change of each number."""
        if self.problem.parameter_scale is None:
            sizes = list(parameters)
        else:
            typical = jax.tree.leaves(self.problem.parameter_scale(self.args(parameters)))
            sizes = [size for size, leaf in zip(typical, self.leaves, strict=True) if leaf is None]
        if self.has_clock:
            clock = self.clock(parameters)
            span = jnp.where(jnp.isfinite(clock.t1), clock.t1 - clock.t0, 1.0)
            sizes[self.arguments :] = clock._replace(t0=span, t1=span)
        return [jnp.abs(size) for size in sizes]

    def of_lanes(self, parameters: Sequence[PerLane], lanes: Indices | slice) -> list[PerLane]:
        """The numbers of some lanes, given by indices or a slice; those that all lanes share stay as they are."""
        return [
            number[lanes] if number.ndim > len(shape) else number
            for number, shape in zip(parameters, self.shapes, strict=True)
        ]

    def structs(self) -> list[jax.ShapeDtypeStruct]:
        """Shape and type of one lane's numbers."""
        return [jax.ShapeDtypeStruct(*struct) for struct in zip(self.shapes, self.dtypes, strict=True)]


def _traced_again(
    problem: Problem,
    structure: Structure,
    leaves: tuple[object, ...],
    shapes: tuple[tuple[int, ...], ...],
    dtypes: tuple[str, ...],
    options: Options,
) -> Signature:
    structs = list(map(jax.ShapeDtypeStruct, shapes, dtypes))
    zeros = iter([np.zeros(struct.shape, struct.dtype) for struct in structs])
    args = jax.tree.unflatten(structure, [next(zeros) if leaf is None else leaf for leaf in leaves])
    return Signature(problem, structure, leaves, shapes, dtypes, options, problem.equations(args, structs))


# By signature, not in it: each call of a user makes a signature, and equal ones have the same events.
@functools.lru_cache(maxsize=256)
def _event_names(signature: Signature) -> tuple[str, ...]:
    names: list[tuple[str, ...]] = []

    def look(parameters: Sequence[Number]) -> float:
        names.append(signature.problem.event_names(signature.args(parameters)))
        return 0.0

    jax.eval_shape(look, signature.structs())
    return names[0]
