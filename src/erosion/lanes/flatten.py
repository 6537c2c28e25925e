"""From JAX's equations to a graph: calls opened, control flow as regions, arrays element by element."""

import functools
import importlib.util
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var
from jax.typing import ArrayLike

from erosion.lanes import tapes
from erosion.lanes.arrays import ARRAYS, Elements, Part, Work, constant, elementwise, of_each, part, whole
from erosion.lanes.functions import FUNCTIONS
from erosion.lanes.graph import (
    ARRAY,
    BOOL,
    DOUBLE,
    LONG,
    NUMBERS,
    CannotCompileError,
    Function,
    Graph,
    GraphValue,
    Loop,
    Region,
    TooLongError,
)
from erosion.lanes.jax_versions import CALLS, called, carried_by_scan, expansion
from erosion.lanes.large import LARGE, Large, array_of, as_memory, begin_carrying, carry_on, memory, parted
from erosion.lanes.loops import of_arrays
from erosion.lanes.passes import PLACES, SCATTERS, finish, live, scatter
from erosion.lanes.scalars import SCALARS, Atom, Equation, Kind, aval_of, converted

_DOUBLE = np.dtype(np.float64)
_Result = TypeVar("_Result")
_WORTH_A_CALL = 40  # operations of a function, at least, that becomes a subroutine
_UNROLLED = 64  # rounds of a loop of known length, at most; longer ones run as loops

WHOLE = 50_000
"""Operations of a program, above which functions that are called again become subroutines."""

LIBRARIES = tuple(
    str(Path(spec.origin or "").parent) for spec in map(importlib.util.find_spec, ("jax", "equinox", "numpy")) if spec
)
"""Folders whose code is not the user's. equinox is looked for, as to import it takes as long as all else here."""


class NotForLanesError(ValueError):
    """A function that cannot be compiled for lanes; the sentence says what in it, in JAX's names of operations."""

    @classmethod
    def at(cls, place: str, error: CannotCompileError) -> "NotForLanesError":
        """The error of a place, and what to do."""
        return cls(f"{place} uses {error}, which lanes cannot do: {error.instead}.")


class Flattener:
    """Adds functions to a graph.

    Args:
        graph: to add to.
        subroutines: whether functions that are called again become subroutines.
    """

    def __init__(self, graph: Graph, *, subroutines: bool) -> None:
        self.graph, self._subroutines = graph, subroutines
        # A function that is called a dozen times is read once. The jaxprs are kept, so that their ids stay theirs.
        self._read: dict[int, tuple[Jaxpr, _Steps]] = {}
        self._called: dict[tuple[int, ...], _Called] = {}

    def call(self, jaxpr: Jaxpr, constants: Sequence[ArrayLike], arguments: Sequence[Part]) -> list[Part]:
        """A function's results."""
        if id(jaxpr) not in self._read:
            self._read[id(jaxpr)] = (jaxpr, self._steps(jaxpr))
        steps = self._read[id(jaxpr)][1]
        values: list[Elements] = [None] * steps.count
        for slot, number in zip(steps.constants, constants, strict=True):
            values[slot] = constant(self.graph, number, np.asarray(number).dtype)
        for slot, argument in zip(steps.arguments, arguments, strict=True):
            values[slot] = argument
        for slot, literal in steps.literals:
            values[slot] = literal
        graph = self.graph
        for work, inputs, outputs in steps.work:
            for slot, value in zip(outputs, work(graph, [values[i] for i in inputs]), strict=True):
                values[slot] = value
        return [values[slot] for slot in steps.results]

    def called(self, jaxpr: Jaxpr, constants: Sequence[ArrayLike], arguments: Sequence[Part]) -> list[Part]:
        """The results of a function that may be called elsewhere: of a subroutine, where the program is large."""
        # Calls with an array in memory and with the same one taken apart have different numbers of arguments.
        key = id(jaxpr), *(isinstance(argument, Large) for argument in arguments)
        graph, so_far = self.graph, self._called.setdefault(key, _Called(jaxpr))
        given = [value for argument in arguments for value in _values(argument)]
        if not self._subroutines or so_far.size < _WORTH_A_CALL or given == so_far.given or not so_far.shares(given):
            before = graph.made
            results = self.call(jaxpr, constants, arguments)
            so_far.size, so_far.given = max(so_far.size, graph.made - before), given
            return results
        subroutine = next((each for each in so_far.subroutines if each.takes(given)), None)
        if subroutine is None:
            subroutine = self._subroutine(so_far, constants, arguments, given)
        function, results = subroutine.function, subroutine.results
        passed = [value for own, value in zip(subroutine.own, given, strict=True) if own is None]
        made = dict(zip(function.outputs, graph.call(function, passed), strict=True))
        return _gathered([made.get(value, value) for value in _scalars(results)], results)

    def _subroutine(
        self, called: "_Called", constants: Sequence[ArrayLike], arguments: Sequence[Part], given: Sequence[Any]
    ) -> "_Subroutine":
        """A new one. Arguments that are the same as in the call before, and known to the whole lane, are its own."""
        graph, function = self.graph, Function(self.graph.root)
        own = [
            value if value is before and (isinstance(value, Large) or value.region is graph.root) else None
            for value, before in zip(given, called.given, strict=True)
        ]
        values = iter(
            function.argument(value.type) if here is None else here for value, here in zip(given, own, strict=True)
        )
        inside = [
            next(values) if isinstance(each, Large) else part(array_of(whole(each).shape, lambda _: next(values)))
            for each in arguments
        ]
        with graph.within(function.body):
            results = self.call(called.jaxpr, constants, inside)
            scalars = _scalars(results)
        function.outputs = list(dict.fromkeys(value for value in scalars if value.region is function.body))
        graph.functions.append(function)
        called.subroutines.append(_Subroutine(function, own, _gathered(scalars, results)))
        return called.subroutines[-1]

    def closed(self, closed: ClosedJaxpr, arguments: Sequence[Part]) -> list[Part]:
        """The results of a function that has its constants with it."""
        return self.call(closed.jaxpr, closed.consts, arguments)

    def forget(self) -> None:
        """Drop what was read: its steps refer to this object, so Python would have to search for them."""
        self._read.clear()

    def _steps(self, jaxpr: Jaxpr) -> "_Steps":
        steps = _Steps()
        slots: dict[Var, int] = {}

        def slot(atom: Atom) -> int:
            if isinstance(atom, Literal):
                steps.count += 1
                steps.literals.append((steps.count - 1, constant(self.graph, atom.val, aval_of(atom).dtype)))
                return steps.count - 1
            if atom not in slots:
                slots[atom] = steps.count
                steps.count += 1
            return slots[atom]

        steps.constants, steps.arguments = [list(map(slot, atoms)) for atoms in (jaxpr.constvars, jaxpr.invars)]
        for equation in jaxpr.eqns:
            work = self._work(equation)
            inputs = _located(equation, lambda given=equation.invars: list(map(slot, given)))
            steps.work.append((work, inputs, list(map(slot, equation.outvars))))
        steps.results = list(map(slot, jaxpr.outvars))
        return steps

    def _work(self, equation: Equation) -> Work:
        """What computes an equation's outputs."""
        name = equation.primitive.name
        if name in SCALARS:
            return _located(equation, lambda: elementwise(SCALARS[name], equation))
        work = _located(equation, lambda: self._other_work(equation, name))

        def located(graph: Graph, inputs: list[Part]) -> Sequence[Part]:
            return _located(equation, lambda: work(graph, inputs))

        return located

    def _other_work(self, equation: Equation, name: str) -> Work:
        """What computes an equation of a call, of control flow, of a function or of arrays."""
        if name in CALLS:
            body, constants = called(equation)
            return lambda _, inputs: self.called(body, constants, inputs)
        control = {"while": self._while, "cond": self._cond, "scan": self._scan}.get(name)
        if control is not None:
            return functools.partial(control, equation)
        if equation.effects:
            raise CannotCompileError(f"`{name}` for what it does beside computing")
        if name in FUNCTIONS:
            return elementwise(self._function(name, len(equation.invars)), equation, stored=True)
        if name in ("concatenate", "stack") and self._subroutines and is_large(aval_of(equation.outvars[0])):
            # What a large program puts together, such as the state, it computes with in loops.
            return lambda graph, inputs: [as_memory(graph, ARRAYS[name](equation, graph, inputs)[0])]
        if name in ARRAYS:
            return functools.partial(of_arrays, equation)
        if name in PLACES:
            return functools.partial(PLACES[name], equation)
        if name in (tapes.WRITE, tapes.READ):
            slot = equation.params["slot"]
            return lambda graph, inputs: [graph.op(name, DOUBLE, *map(_one, inputs), extra=slot)]
        if name in SCATTERS:
            return functools.partial(scatter, self.call, equation)
        if (expanded := expansion(equation)) is not None:
            return lambda _, inputs: self.closed(expanded, inputs)
        if name == "custom_lin":  # the forward derivative of a `custom_vjp`
            raise CannotCompileError("`custom_vjp`", "use `custom_jvp`, by which JAX goes backwards as well")
        raise CannotCompileError(f"`{name}`")

    def _function(self, name: str, inputs: int) -> Callable[..., GraphValue]:
        """A function such as `exp` in plain arithmetic."""
        closed = _traced(name, inputs)

        def rule(graph: Graph, kind: Kind, *given: GraphValue) -> GraphValue:
            # In double precision, also for integers (as in `pow`) and single precision.
            exact = [converted(graph, value, dtype, _DOUBLE) for value, dtype in zip(given, kind.inputs, strict=True)]
            (result,) = self.called(closed.jaxpr, closed.consts, exact)
            assert isinstance(result, GraphValue)
            return converted(graph, result, _DOUBLE, kind.output)

        return rule

    # Control flow. Loops and branches carry scalars only: arrays are taken apart before, and put together after.

    def _while(self, equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
        params = equation.params
        ends = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
        for_condition, for_body, initial = inputs[: ends[0]], inputs[ends[0] : ends[1]], inputs[ends[1] :]
        return self._loop(
            lambda carried: self.closed(params["cond_jaxpr"], [*for_condition, *carried])[0],
            lambda carried: self.closed(params["body_jaxpr"], [*for_body, *carried]),
            initial,
            _unchanged(params["body_jaxpr"].jaxpr, params["body_nconsts"]),
        )

    def _loop(
        self,
        condition: Callable[[list[Part]], Part],
        body: Callable[[list[Part]], list[Part]],
        initial: list[Part],
        unchanged: set[int],
    ) -> list[Part]:
        """A loop. `condition` and `body` are functions of what it carries; what is `unchanged` is known before it."""
        graph, changing = self.graph, [i for i in range(len(initial)) if i not in unchanged]
        # Large arrays lie in memory that the loop changes.
        arrays = {i: each for i in changing if isinstance(each := initial[i], Large) and each.type == DOUBLE}
        memories = {i: begin_carrying(array) for i, array in arrays.items()}

        def all_of(changed: Sequence[GraphValue]) -> list[Part]:
            carried, rest = list(initial), iter(changed)
            for i in changing:
                if i in memories:
                    memories[i].now = next(rest)
                    carried[i] = memory(graph, memories[i].now, arrays[i].shape, memories[i])
                else:
                    (carried[i],) = _gathered([next(rest) for _ in range(whole(initial[i]).size)], [initial[i]])
            return carried

        begun = _scalars([memories[i].now if i in memories else initial[i] for i in changing])
        loop = Loop(Region(graph.region, is_loop=True), begun)
        with graph.within(loop.head):
            carried = all_of(loop.arguments)
            goes_on = condition(carried)
            # A batch of loops within a lane goes on while any of its rows does; rows that are done keep their values.
            loop.condition = functools.reduce(lambda x, y: graph.op("or", BOOL, x, y), whole(goes_on).ravel())
        with graph.within(loop.body):
            after = body(carried)
            if isinstance(goes_on, np.ndarray):
                pairs = zip(after, carried, strict=True)
                after = [self._where_it_goes_on(goes_on, whole(new), whole(old)) for new, old in pairs]
            held = {i: array for i in memories if isinstance(array := carried[i], Large)}
            ready = {i: parted(array, as_memory(graph, after[i])) for i, array in held.items()}
            # What is not kept in memory is computed before the memory that it may be read from changes.
            scalars = {i: _scalars([after[i]]) for i in changing if i not in memories}
            scalars |= {i: _scalars([carry_on(held[i], ready[i])]) for i in changing if i in memories}
            loop.updates = [value for i in changing for value in scalars[i]]
        return all_of(graph.ended(loop, begun))

    def _where_it_goes_on(self, goes_on: Elements, new: Elements, old: Elements) -> np.ndarray:
        """For a batch of loops: the new values in rows that go on, the old values in the others."""
        return array_of(
            new.shape, lambda index: self.graph.select(goes_on[index[: goes_on.ndim]], new[index], old[index])
        )

    def _cond(self, equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
        case, *arguments = inputs
        assert isinstance(case, GraphValue)
        cases, outputs, results = [], [], []
        for closed in equation.params["branches"]:
            with graph.within(Region(graph.region)) as case_region:
                results = self.closed(closed, arguments)
            cases.append(case_region)
            outputs.append(_scalars(results))
        if len(cases) == 2 and case.type != BOOL:
            case = graph.compare("icmp ne", case, graph.constant(0, case.type))
        return _gathered(graph.branch(case, cases, outputs), results)

    def _scan(self, equation: Equation, graph: Graph, inputs: list[Part]) -> list[Part]:
        params = equation.params
        (constants, carries), length = carried_by_scan(params), params["length"]
        fixed, carried, rows = (
            inputs[:constants],
            inputs[constants : constants + carries],
            inputs[constants + carries :],
        )
        if length > _UNROLLED and not rows and len(equation.outvars) == carries:
            return self._counted(params["jaxpr"], fixed, carried, length)
        made: list[list[Part]] = []
        order = range(length)[::-1] if params["reverse"] else range(length)
        for i in order:
            results = self.closed(params["jaxpr"], [*fixed, *carried, *(whole(row)[i] for row in rows)])
            carried = results[:carries]
            made.append(results[carries:])
        if params["reverse"]:
            made.reverse()
        stacked = [
            array_of(aval_of(variable).shape, lambda index, j=j: whole(made[index[0]][j])[index[1:]])
            for j, variable in enumerate(equation.outvars[carries:])
        ]
        return [*carried, *stacked]

    def _counted(self, closed: ClosedJaxpr, fixed: list[Part], carried: list[Part], length: int) -> list[Part]:
        """A loop that runs a known number of times."""
        graph = self.graph
        zero, one, last = (graph.constant(number, LONG) for number in (0, 1, length))

        def body(state: list[Part]) -> list[Part]:
            count, *rest = state
            assert isinstance(count, GraphValue)
            return [graph.op("add", LONG, count, one), *self.closed(closed, [*fixed, *rest])]

        def condition(state: list[Part]) -> Part:
            assert isinstance(state[0], GraphValue)
            return graph.compare("icmp slt", state[0], last)

        unchanged = {i + 1 for i in _unchanged(closed.jaxpr, len(fixed))}
        return self._loop(condition, body, [zero, *carried], unchanged)[1:]


class _Called:
    """A function that is called: how many operations it took, the last arguments, and what was made of it.

    Each of its arguments is in memory in all of these calls, or in none.
    """

    def __init__(self, jaxpr: Jaxpr) -> None:
        self.jaxpr, self.size = jaxpr, 0
        self.given: list[Any] = []
        self.subroutines: list[_Subroutine] = []

    def shares(self, given: Sequence[Any]) -> bool:
        """Whether the arrays in memory are those of the last call: a subroutine takes numbers alone."""
        return all(isinstance(value, GraphValue) or value is had for value, had in zip(given, self.given, strict=True))


class _Subroutine(NamedTuple):
    """A function of the graph, the arguments that are its own (None for the others), and its results in it."""

    function: Function
    own: list[Any]
    results: list[Part]

    def takes(self, given: Sequence[Any]) -> bool:
        """Whether it is a function of such arguments."""
        return all(own is None or own is value for own, value in zip(self.own, given, strict=True))


class _Steps:
    """A function's equations, read once: what computes each, and the slots of its inputs and outputs."""

    def __init__(self) -> None:
        self.count = 0
        self.constants: list[int] = []
        self.arguments: list[int] = []
        self.literals: list[tuple[int, Part]] = []
        self.work: list[tuple[Work, list[int], list[int]]] = []
        self.results: list[int] = []


def _one(scalar: Part) -> GraphValue:
    assert isinstance(scalar, GraphValue)
    return scalar


def is_large(aval: ShapedArray) -> bool:
    """Whether an argument stays in memory."""
    return aval.dtype == _DOUBLE and math.prod(aval.shape) >= LARGE


def flatten(closed: ClosedJaxpr, *, shared: bool = True) -> Graph:
    """The graph of a function: its inputs are float64 in memory, one place after another.

    Args:
        closed: the function.
        shared: whether all lanes share the large arrays among its arguments.

    Raises:
        NotForLanesError: naming what lanes cannot do, and where it is.
    """
    try:
        return flatten_whole(closed, shared=shared, most=WHOLE)
    except TooLongError:
        return _flatten(closed, Graph(), shared=shared, subroutines=True)


def flatten_whole(closed: ClosedJaxpr, *, shared: bool = True, most: float = math.inf) -> Graph:
    """The graph without subroutines, as `flatten`, if it has no more than `most` operations.

    Raises:
        TooLongError: if it has more.
    """
    return _flatten(closed, Graph(most), shared=shared, subroutines=False)


def _flatten(closed: ClosedJaxpr, graph: Graph, *, shared: bool, subroutines: bool) -> Graph:
    arguments: list[Part] = []
    place, large = 0, [is_large(aval_of(variable)) for variable in closed.jaxpr.invars]
    graph.rows = graph.places = sum(math.prod(aval_of(variable).shape) for variable in closed.jaxpr.invars)
    for variable, is_array in zip(closed.jaxpr.invars, large, strict=True):
        shape = aval_of(variable).shape
        if is_array:
            array = graph.memory(graph.numbers if shared else place, NUMBERS if shared else ARRAY)
            arguments.append(memory(graph, array, shape))
            graph.numbers += math.prod(shape) * shared
            place += math.prod(shape)
            continue
        places, dtype = place + np.arange(math.prod(shape)).reshape(shape), np.dtype(aval_of(variable).dtype)
        place += places.size
        arguments.append(
            part(of_each(lambda at, dtype=dtype: converted(graph, graph.input(at), _DOUBLE, dtype), places))
        )
    flattener = Flattener(graph, subroutines=subroutines)
    try:
        results = flattener.closed(closed, arguments)
    except CannotCompileError as error:
        raise NotForLanesError.at("The function", error) from None
    flattener.forget()
    outputs: list[GraphValue] = []
    for result in results:
        if isinstance(result, Large) and result.type == DOUBLE:
            outputs.append(graph.op("output", ARRAY, result.copied(), extra=result.size))
        else:
            outputs += _scalars([result])
    finish(graph, outputs)
    return graph


def dependencies(closed: ClosedJaxpr) -> np.ndarray:
    """Which numbers among a function's results may depend on which among its arguments, shape (results, arguments).

    Raises:
        NotForLanesError: as `flatten`.
    """
    graph = flatten_whole(closed)
    found = np.zeros((len(graph.outputs), sum(math.prod(aval.shape) for aval in closed.in_avals)), bool)
    for row, output in zip(found, graph.outputs, strict=True):
        row[[value.extra for value in live([output]) if value.op == "input"]] = True
    return found


@functools.cache
def _traced(name: str, inputs: int) -> ClosedJaxpr:
    number = jax.ShapeDtypeStruct((), np.float64)
    return jax.make_jaxpr(FUNCTIONS[name])(*[number] * inputs)


def _values(argument: Part) -> list[Any]:
    """The numbers of an argument; a large array is one thing."""
    return [argument] if isinstance(argument, Large) else list(whole(argument).ravel())


def _scalars(parts: Sequence[Part]) -> list[GraphValue]:
    return [value for array in map(whole, parts) for value in array.ravel()]


def _gathered(values: Sequence[GraphValue], shaped: Sequence[Part]) -> list[Part]:
    """Scalars put together to parts of the shapes of `shaped`."""
    rest = iter(values)
    return [part(array_of(whole(example).shape, lambda _: next(rest))) for example in shaped]


def _unchanged(body: Jaxpr, constants: int) -> set[int]:
    """Indices of the values that a loop carries and its body returns unchanged."""
    carried = body.invars[constants:]
    return {i for i, (before, after) in enumerate(zip(carried, body.outvars, strict=True)) if before is after}


def _located(equation: Equation, function: Callable[[], _Result]) -> _Result:
    """The function's result. An error about what lanes cannot do names the line of the user's own code."""
    try:
        return function()
    except CannotCompileError as error:
        traceback = equation.source_info.traceback
        own = [
            frame
            for frame in (traceback.frames if traceback is not None else [])
            if not frame.file_name.startswith((*LIBRARIES, "<"))
        ]
        if not own:
            raise
        place = (
            f"`{own[0].function_name.split('.<locals>.')[-1]}` ({Path(own[0].file_name).name}, line {own[0].line_num})"
        )
        raise NotForLanesError.at(place, error) from None
