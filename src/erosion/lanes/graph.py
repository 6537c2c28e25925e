"""The operations of one lane: scalars in nested regions, each distinct operation once.

A region is a list of steps: values, loops and branches. The first region is the lane itself; a loop
has one for its condition and one for its body, a branch has one for each of its cases. A value goes
into the outermost region in which all its inputs are known, so that what a loop does not change is
computed before it.
"""

import contextlib
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Union

import numpy as np

DOUBLE, BOOL, LONG = "double", "i1", "i64"
PLACE = "place"  # a whole number that is the same in all lanes
ARRAY, NUMBERS = "array", "numbers"  # numbers in memory, of each lane or of all lanes together

_MOST = 100_000  # operations of a program; the code generator takes a minute for them, and longer than in proportion
_MOST_ASKED = 2_000_000  # operations asked for, of which many may be known already: some ten seconds


class CannotCompileError(Exception):
    """Something that lanes cannot do.

    Args:
        what: the end of "… uses".
        instead: what to do.
    """

    def __init__(self, what: str, instead: str = "write it by other functions of `jax.numpy`") -> None:
        super().__init__(what)
        self.instead = instead


class TooLongError(Exception):
    """A program that is too long without subroutines."""


class GraphValue:
    """A scalar: the result of an operation.

    Args:
        op: the operation's name, as LLVM has it; or "const", "input", "argument" (of a loop) or
            "result" (of a loop or a branch).
        inputs: values.
        type: LLVM's name of its type.
        region: where it is computed.
        extra: a constant's number, an input's place, or the loop or branch that it belongs to.
    """

    __slots__ = ("extra", "inputs", "name", "op", "region", "type", "uses")

    regions = ()  # a step that has none within it

    def __init__(
        self, op: str, inputs: tuple["GraphValue", ...], type_: str, region: "Region", extra: Any = None
    ) -> None:
        self.op, self.inputs, self.type, self.region, self.extra = op, inputs, type_, region, extra
        self.name = ""  # in the text of the program
        self.uses = 0  # how many steps read it; known once the graph is complete

    @property
    def is_constant(self) -> bool:
        """Whether its number is known."""
        return self.op == "const"


class Region:
    """Steps that run one after another.

    Args:
        parent: the region around it.
        is_loop: whether its steps run again and again.
    """

    __slots__ = ("depth", "is_loop", "known", "level", "parent", "steps", "targets")

    def __init__(self, parent: Union["Region", None], *, is_loop: bool = False) -> None:
        self.parent, self.is_loop = parent, is_loop
        self.depth: int = 0 if parent is None else parent.depth + 1
        self.level: int = is_loop if parent is None else parent.level + is_loop  # loops around it
        self.steps: list[Step] = []
        self.known: dict[tuple[object, ...], GraphValue] = {}  # operations of this region, by name, type and inputs
        # By the depth of the innermost input: the region in which an operation asked for here is computed.
        self.targets: list[Region] = []
        for depth in range(self.depth):
            out_of_loop = is_loop or (parent is not None and parent.targets[depth] is not parent)
            self.targets.append(parent.targets[depth] if parent is not None and out_of_loop else self)
        self.targets.append(self)

    def clear(self) -> None:
        """Drop the steps: they refer to this region, so Python would have to search for them."""
        for step in self.steps:
            if isinstance(step, GraphValue):
                step.inputs = ()
            for region in step.regions:
                region.clear()
        self.steps.clear()
        self.known.clear()
        self.targets.clear()


class Loop:
    """Runs until the condition fails in every lane; a lane whose condition failed keeps its values."""

    __slots__ = ("arguments", "body", "condition", "head", "initial", "regions", "results", "updates")

    def __init__(self, head: Region, initial: Sequence[GraphValue]) -> None:
        self.regions = self.head, self.body = head, Region(head)
        self.initial = list(initial)
        self.arguments = [GraphValue("argument", (), value.type, head, self) for value in initial]
        self.condition: GraphValue
        self.updates: list[GraphValue] = []
        self.results: list[GraphValue] = []

    @property
    def inputs(self) -> tuple[GraphValue, ...]:
        """What it reads."""
        return self.condition, *self.initial, *self.updates


class Branch:
    """Several cases, of which each lane takes one; a case runs if any lane takes it.

    Args:
        selector: each lane's case: its index, or, for two cases, whether the lane takes the second.
        regions: the cases.
        outputs: of each case.
    """

    __slots__ = ("outputs", "regions", "results", "selector")

    def __init__(self, selector: GraphValue, regions: list[Region], outputs: list[list[GraphValue]]) -> None:
        self.selector, self.regions, self.outputs = selector, regions, outputs
        self.results: list[GraphValue] = []

    @property
    def inputs(self) -> tuple[GraphValue, ...]:
        """What it reads."""
        return self.selector, *(value for outputs in self.outputs for value in outputs)


class Counted:
    """Runs for each index from 0 to a known length, in all lanes at once, and carries sums along."""

    __slots__ = ("arguments", "body", "index", "initial", "length", "regions", "results", "updates")

    def __init__(self, parent: Region, length: int, initial: Sequence[GraphValue]) -> None:
        self.length, self.initial, self.body = length, list(initial), Region(parent, is_loop=True)
        self.regions = (self.body,)
        self.index = GraphValue("index", (), PLACE, self.body, self)
        self.arguments = [GraphValue("argument", (), value.type, self.body, self) for value in initial]
        self.updates: list[GraphValue] = []
        self.results: list[GraphValue] = []

    @property
    def inputs(self) -> tuple[GraphValue, ...]:
        """What it reads."""
        return *self.initial, *self.updates


class Function:
    """A part of the program that is written once, and called at several places.

    Beside its arguments it may read values of the outermost region, which are computed before its first call.
    """

    __slots__ = ("arguments", "body", "calls", "outputs", "reads", "room")

    def __init__(self, root: Region) -> None:
        self.body = Region(root, is_loop=True)  # so that what no argument changes is computed outside
        self.arguments: list[GraphValue] = []
        self.outputs: list[GraphValue] = []
        self.calls: list[Call] = []
        self.reads: dict[GraphValue, None] = {}  # values of the outermost region, once the graph is complete
        self.room = 0  # the first row of its memory: one for each argument, then one for each output

    def argument(self, type_: str) -> GraphValue:
        """One more argument."""
        self.arguments.append(GraphValue("argument", (), type_, self.body, self))
        return self.arguments[-1]


class Call:
    """A call of a function."""

    __slots__ = ("function", "inputs", "results")

    regions = ()

    def __init__(self, function: Function, inputs: Sequence[GraphValue], region: Region) -> None:
        self.function, self.inputs = function, tuple(inputs)
        self.results = [GraphValue("result", (), output.type, region, self) for output in function.outputs]


Step = GraphValue | Loop | Branch | Counted | Call


class Graph:
    """Operations on one lane's numbers, to be added one by one.

    `op` adds an operation and returns its value. Constants are folded; what changes no bit is left out:
    x·1, x - 0, a choice between equal values, a sign that is changed twice.

    Args:
        whole: how many operations there may be, while functions are written out wherever they are called.

    Raises:
        TooLongError: for more than `whole`.
        CannotCompileError: for too many operations.
    """

    def __init__(self, whole: float = math.inf) -> None:
        self._whole = whole
        self.root = self.region = Region(None)
        self.outputs: list[GraphValue] = []
        self.functions: list[Function] = []
        self.kept: dict[GraphValue, int] = {}  # the rows of numbers that functions read beside their arguments
        self.places = 0  # of the arguments
        self.rows = 0  # of memory, each with a number of every lane; the first are the arguments
        self.numbers = 0  # in memory after them, of arguments that all lanes share
        self.made = self._asked = 0  # operations

    @property
    def regions(self) -> list[Region]:
        """The outermost ones: of the lane, and of each function."""
        return [self.root, *(function.body for function in self.functions)]

    def constant(self, number: float, type_: str) -> GraphValue:
        """A number."""
        number = _in_range(number, type_)
        key = ("const", type_, struct.pack("<d", number) if type_ in _FLOATS else number)
        value = self.root.known.get(key)
        if value is None:
            value = self.root.known[key] = GraphValue("const", (), type_, self.root, number)
        return value

    def input(self, place: int) -> GraphValue:
        """The float64 in this place of the lane's arguments."""
        key = ("input", place)
        value = self.root.known.get(key)
        if value is None:
            value = self.root.known[key] = GraphValue("input", (), DOUBLE, self.root, place)
            self.root.steps.append(value)
        return value

    def op(self, name: str, type_: str, *inputs: GraphValue, extra: Any = None) -> GraphValue:
        """The value of an operation."""
        self._asked += 1
        if self.made > self._whole:
            raise TooLongError
        if self.made > _MOST or self._asked > _MOST_ASKED:
            raise CannotCompileError(
                f"more than {_MOST:,} operations",
                "put what repeats into a function under `jax.jit`, which is compiled once, or a long sum into a loop",
            )
        simpler = self._simplified(name, type_, inputs)
        if simpler is not None:
            return simpler
        # A plain loop, not `max`: this runs ten thousand times while a user waits.
        innermost, here = 0, self.region
        for value in inputs:
            if value.region.depth > innermost:
                innermost = value.region.depth
        target = here.targets[innermost]
        key = (name, type_, extra, *inputs)
        region: Region | None = target
        while region is not None:
            value = region.known.get(key)
            if value is not None:
                return value
            region = region.parent
        self.made += 1
        value = target.known[key] = GraphValue(name, inputs, type_, target, extra)
        target.steps.append(value)
        return value

    def _simplified(self, name: str, type_: str, inputs: tuple[GraphValue, ...]) -> GraphValue | None:
        """A simpler value with the same bits; None if there is none."""
        if name in _FOLDED and all(value.op == "const" for value in inputs):
            return self._folded(name, type_, inputs)
        simplify = _SIMPLER.get(name)
        return simplify(self, *inputs) if simplify is not None else None

    def _folded(self, name: str, type_: str, inputs: tuple[GraphValue, ...]) -> GraphValue:
        numbers = [_NUMPY[value.type](value.extra) for value in inputs]
        with np.errstate(all="ignore"):
            return self.constant(_FOLDED[name](*numbers), type_)

    def compare(self, kind: str, x: GraphValue, y: GraphValue) -> GraphValue:
        """A comparison: "fcmp olt", "icmp eq", …."""
        return self.op(kind, BOOL, x, y)

    def select(self, condition: GraphValue, if_true: GraphValue, if_false: GraphValue) -> GraphValue:
        """One of two values."""
        return self.op("select", if_true.type, condition, if_true, if_false)

    @contextlib.contextmanager
    def within(self, region: Region) -> Iterator[Region]:
        """Operations that are added meanwhile are in this region."""
        outer, self.region = self.region, region
        yield region
        self.region = outer

    def counted(
        self,
        length: int,
        initial: Sequence[GraphValue],
        body: Callable[[GraphValue, list[GraphValue]], Sequence[GraphValue]],
    ) -> list[GraphValue]:
        """What a loop over indices carries at its end; `body` gives what is carried on, from the index and what was."""
        loop = Counted(self.region, length, initial)
        with self.within(loop.body):
            loop.updates = list(body(loop.index, loop.arguments))
        return self.ended(loop, initial)

    def place(self, terms: Iterable[tuple[GraphValue, int]], offset: int = 0) -> GraphValue:
        """Σ index · stride + offset, the same in all lanes."""
        total: GraphValue | None = None
        for index, stride in terms:
            if index.is_constant or stride == 0:
                offset += stride * (index.extra if index.is_constant else 0)
                continue
            term = index if stride == 1 else self.op("place mul", PLACE, index, self.constant(stride, PLACE))
            total = term if total is None else self.op("place add", PLACE, total, term)
        if total is None:
            return self.constant(offset, PLACE)
        return total if offset == 0 else self.op("place add", PLACE, total, self.constant(offset, PLACE))

    def room(self, rows: int) -> GraphValue:
        """New memory for numbers of each lane."""
        self.rows += rows
        return self.memory(self.rows - rows, ARRAY)

    def memory(self, first: int, type_: str) -> GraphValue:
        """Memory from a row on, or from one of the numbers that all lanes share."""
        room = GraphValue("room", (), type_, self.root, first)
        self.root.steps.append(room)
        return room

    def rows_of(self, values: Sequence[GraphValue]) -> GraphValue:
        """Memory with these numbers."""
        key = ("rows", *values)
        region: Region | None = self.region
        while region is not None:
            if key in region.known:
                return region.known[key]
            region = region.parent
        room = self.room(len(values))
        stores = [self.store(room, self.constant(i, PLACE), value) for i, value in enumerate(values)]
        made = self.region.known[key] = self.filled(room, stores)
        return made

    def filled(self, array: GraphValue, stores: Sequence[GraphValue]) -> GraphValue:
        """The array with what `store` wrote into it."""
        value = GraphValue("filled", (array, *stores), ARRAY, self.region)
        self.region.steps.append(value)
        return value

    def store(self, array: GraphValue, place: GraphValue, value: GraphValue, *, masked: bool = False) -> GraphValue:
        """Write a number of each lane; of active lanes alone if `masked`."""
        self.made += 1
        store = GraphValue("store", (array, place, value), "", self.region, masked)
        self.region.steps.append(store)
        return store

    def branch(self, selector: GraphValue, cases: list[Region], outputs: list[list[GraphValue]]) -> list[GraphValue]:
        """The outputs of the case that each lane takes."""
        return self.ended(Branch(selector, cases, outputs), outputs[0])

    def call(self, function: Function, inputs: Sequence[GraphValue]) -> list[GraphValue]:
        """The results of a function."""
        key = ("call", function, *inputs)
        region: Region | None = self.region
        while region is not None and key not in region.known:
            region = region.parent
        if region is None:
            region, call = self.region, Call(function, inputs, self.region)
            region.steps.append(call)
            function.calls.append(call)
            region.known[key] = GraphValue("call", (), "", region, call)
        return region.known[key].extra.results

    def ended(self, step: Loop | Branch | Counted, values: Sequence[GraphValue]) -> list[GraphValue]:
        """The results of a step that is complete, of the types of some values."""
        self.region.steps.append(step)
        step.results = [GraphValue("result", (), value.type, self.region, step) for value in values]
        return step.results


_FLOATS = ("double", "float")
_NUMPY: dict[str, Any] = {
    "double": np.float64, "float": np.float32, "i1": np.bool_,
    "i8": np.int8, "i16": np.int16, "i32": np.int32, "i64": np.int64,
}  # fmt: skip
_FOLDED: dict[str, Callable[..., float]] = {
    "fadd": np.add, "fsub": np.subtract, "fmul": np.multiply, "fdiv": np.divide, "fneg": np.negative,
    "add": np.add, "sub": np.subtract, "mul": np.multiply,
    "llvm.sqrt": np.sqrt, "llvm.fabs": np.abs, "llvm.floor": np.floor, "llvm.ceil": np.ceil,
    "llvm.roundeven": np.rint, "llvm.trunc": np.trunc,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor,
    "fcmp oeq": np.equal, "fcmp une": np.not_equal, "fcmp olt": np.less, "fcmp ole": np.less_equal,
    "fcmp ogt": np.greater, "fcmp oge": np.greater_equal,
    "icmp eq": np.equal, "icmp ne": np.not_equal, "icmp slt": np.less, "icmp sle": np.less_equal,
    "icmp sgt": np.greater, "icmp sge": np.greater_equal,
    "sitofp": int, "sext": int,
}  # fmt: skip


def _in_range(number: float, type_: str) -> float:
    """A number as its type holds it. LLVM's integers have no sign of their own, so all are read as signed."""
    if type_ in _FLOATS or type_ == BOOL:
        return _NUMPY[type_](number).item()
    if type_ == PLACE:
        return int(number)
    half = 1 << (int(type_[1:]) - 1)
    return (int(number) + half) % (2 * half) - half


def _is(value: GraphValue, number: float) -> bool:
    """Whether a value is this constant; 0.0 and -0.0 differ."""
    return value.op == "const" and value.extra == number and math.copysign(1, value.extra) == math.copysign(1, number)


def _product(graph: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
    for constant, other in ((x, y), (y, x)):
        if _is(constant, 1.0):
            return other
        if _is(constant, -1.0):
            return graph.op("fneg", other.type, other)
    return None


def _quotient(graph: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
    # The reciprocal of a power of two is exact.
    if y.op == "const" and 1e-30 < abs(y.extra) < 1e30 and abs(math.frexp(y.extra)[0]) == 0.5:
        return graph.op("fmul", x.type, x, graph.constant(1.0 / y.extra, y.type))
    return None


def _sum(graph: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
    for term, other in ((x, y), (y, x)):
        if _is(term, -0.0):
            return other
        if term.op == "fneg":
            return graph.op("fsub", other.type, other, term.inputs[0])
    return None


def _difference(graph: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
    if _is(y, 0.0):
        return x
    return graph.op("fadd", x.type, x, y.inputs[0]) if y.op == "fneg" else None


def _choice(_: Graph, condition: GraphValue, x: GraphValue, y: GraphValue) -> GraphValue | None:
    if x is y:
        return x
    return (x if condition.extra else y) if condition.op == "const" else None


def _logical(neutral: bool) -> Callable[..., GraphValue | None]:
    """Of "and" and "or": one of two truths is `neutral`, or decides alone."""

    def simpler(_: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
        for constant, other in ((x, y), (y, x)):
            if constant.op == "const" and constant.type == BOOL:
                return other if constant.extra == neutral else constant
        return x if x is y else None

    return simpler


def _not_zero(_: Graph, x: GraphValue, y: GraphValue) -> GraphValue | None:
    # x is a condition that was made a number, 1 or 0: the condition itself is the answer.
    if x.op == "select" and _is(y, 0) and _is(x.inputs[1], 1) and _is(x.inputs[2], 0):
        return x.inputs[0]
    return None


_SIMPLER: dict[str, Callable[..., GraphValue | None]] = {
    "icmp ne": _not_zero,
    "fmul": _product,
    "fdiv": _quotient,
    "fadd": _sum,
    "fsub": _difference,
    "fneg": lambda _, x: x.inputs[0] if x.op == "fneg" else None,
    "select": _choice,
    "and": _logical(True),
    "or": _logical(False),
}
