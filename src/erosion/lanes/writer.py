"""The operations of a graph as LLVM's intermediate representation, for both writers.

`vector_ir` writes vectors of lanes, for a processor; `thread_ir` writes one lane, for each thread of a GPU. Neither has
fast-math, so a result's bits depend on the graph alone and are the same in both.
"""

import abc
import contextlib
import struct
from collections.abc import Iterator

from erosion.lanes import tapes
from erosion.lanes.graph import BOOL, PLACE, Branch, Call, Counted, Graph, GraphValue, Loop, Region, Step

ENTRY = "run"
FEW = 8  # operations of a case that are no longer than the jump around them
BITS = {"double": 64, "float": 32, "i64": 64, "i32": 32, "i16": 16, "i8": 8, "i1": 1, "ptr": 64}

_CHOSEN = 8  # elements of a table among which choosing is quicker than looking up
_SATURATING = ("llvm.fptosi.sat", "llvm.fptoui.sat")
_CASTS = {"sitofp", "uitofp", "fpext", "fptrunc", "sext", "zext", "trunc", "bitcast"}
_IN_MEMORY = ("room", "filled", "row", "store", "place add", "place mul")


class Writer(abc.ABC):
    """Writes a graph.

    Args:
        graph: finished.
        of_tapes: how many tapes there are.
    """

    def __init__(self, graph: Graph, of_tapes: int) -> None:
        self.graph, self.of_tapes = graph, of_tapes
        self.lines: list[str] = []
        self.label = ""  # of the block that is being written
        self.count = 0
        self.declared: dict[str, str] = {}
        self.tables: list[str] = []  # of constants
        self.memory: list[str] = []  # on the stack
        self.numbers: dict[GraphValue, str] = {}  # the texts of constants

    # Text.

    def new(self, what: str = "v") -> str:
        """A name that is not yet used."""
        self.count += 1
        return f"{what}{self.count}"

    def get(self, text: str) -> str:
        """The name of an operation's result."""
        name = f"%{self.new()}"
        self.lines.append(f"  {name} = {text}")
        return name

    def do(self, text: str) -> None:
        """An operation without a result."""
        self.lines.append("  " + text)

    def start(self, label: str) -> None:
        """Begin a block."""
        self.lines.append(label + ":")
        self.label = label

    def call(self, name: str, result: str, *operands: tuple[str, str]) -> str:
        """A call of an intrinsic function of LLVM, which is declared once; operands with their types."""
        self.declared[name] = f"declare {result} @{name}({', '.join(type_ for type_, _ in operands)})"
        return f"call {result} @{name}({', '.join(' '.join(operand) for operand in operands)})"

    @contextlib.contextmanager
    def counting(self, length: str | int) -> Iterator[str]:
        """A loop over indices from 0 to a length; what is written meanwhile is done for each."""
        again, done, before, index = self.new("again"), self.new("done"), self.label, f"%{self.new()}"
        self.do(f"br label %{again}")
        self.start(again)
        phi = len(self.lines)
        yield index
        following = self.get(f"add i64 {index}, 1")
        self.do(f"br i1 {self.get(f'icmp slt i64 {following}, {length}')}, label %{again}, label %{done}")
        self.lines.insert(phi, f"  {index} = phi i64 [ 0, %{before} ], [ {following}, %{self.label} ]")
        self.start(done)

    # Each writer has its own way of these.

    @abc.abstractmethod
    def module(self) -> str:
        """The whole text."""

    @abc.abstractmethod
    def of(self, type_: str) -> str:
        """The type of what is computed at once: of all lanes of a vector, or of one lane."""

    @abc.abstractmethod
    def kind(self, type_: str) -> str:
        """This type in the name of an intrinsic function."""

    @abc.abstractmethod
    def constant(self, type_: str, number: str) -> str:
        """A number that is the same in all lanes."""

    @abc.abstractmethod
    def gather(self, type_: str, addresses: str) -> str:
        """Numbers from memory, each lane's from its own address."""

    @abc.abstractmethod
    def input(self, place: int) -> str:
        """The lane's argument in a place."""

    @abc.abstractmethod
    def on_tape(self, value: GraphValue, mask: str) -> None:
        """Numbers of the lane's own memory; see `erosion.lanes.tapes`."""

    @abc.abstractmethod
    def room(self, first: int, type_: str) -> str:
        """Where an array begins: `first` in the memory of lanes, or in what all lanes share."""

    @abc.abstractmethod
    def element(self, array: GraphValue, place: str) -> str:
        """A number of an array."""

    @abc.abstractmethod
    def store(self, array: str, place: str, number: str, mask: str) -> None:
        """Write a number of each lane into an array; of active lanes alone if there is a mask."""

    @abc.abstractmethod
    def table_of_constants(self, type_: str, numbers: list[str]) -> str:
        """The name of a table of the module's own."""

    @abc.abstractmethod
    def table_of_inputs(self, type_: str, first: int) -> str:
        """The name of a table that is the lane's arguments from a place on."""

    @abc.abstractmethod
    def table_of_rows(self, type_: str, array: GraphValue, first: int) -> str:
        """The name of a table that is in memory already."""

    @abc.abstractmethod
    def table_of_values(self, type_: str, names: list[str]) -> str:
        """The name of a table that is made here."""

    @abc.abstractmethod
    def look_up(self, type_: str, table: str, index: str) -> str:
        """A lane's element of a table."""

    @abc.abstractmethod
    def loop(self, loop: Loop, mask: str) -> None:
        """A loop: the condition, and what is done where it holds."""

    @abc.abstractmethod
    def branch(self, branch: Branch, mask: str) -> None:
        """A branch."""

    # Values.

    def text(self, value: GraphValue) -> str:
        """A value's name, or its number."""
        if value.op == "const":
            return self.number(value)
        return value.name

    def number(self, value: GraphValue) -> str:
        """A constant."""
        if value not in self.numbers:
            text = str(value.extra) if value.type == PLACE else self.constant(value.type, self.digits(value))
            self.numbers[value] = text
        return self.numbers[value]

    def digits(self, value: GraphValue) -> str:
        """A constant's number as LLVM reads it."""
        if value.type in ("double", "float"):
            return f"0x{struct.unpack('<Q', struct.pack('<d', value.extra))[0]:016X}"
        if value.type == BOOL:
            return "true" if value.extra else "false"
        return str(value.extra)

    def region(self, region: Region, mask: str) -> None:
        """The steps of a region, for the lanes of a mask."""
        for step in region.steps:
            self.step(step, mask)

    def step(self, step: Step, mask: str) -> None:
        """A step of a region; `vector_ir` alone writes calls."""
        assert not isinstance(step, Call)
        if isinstance(step, Loop):
            self.loop(step, mask)
        elif isinstance(step, Counted):
            self.counted(step, mask)
        elif isinstance(step, Branch):
            self.branch(step, mask)
        elif step.op in (tapes.WRITE, tapes.READ):
            self.on_tape(step, mask)
        elif step.op == "output":
            pass
        elif step.op in _IN_MEMORY:
            self.in_memory(step, mask)
        else:
            self.operation(step)

    def operation(self, value: GraphValue) -> None:
        """One operation."""
        op, type_ = value.op, self.of(value.type)
        names = [self.text(operand) for operand in value.inputs]
        if op == "input":
            value.name = self.input(value.extra)
        elif op == "fneg":
            value.name = self.get(f"fneg {type_} {names[0]}")
        elif op == "select":
            value.name = self.get(f"select {self.of(BOOL)} {names[0]}, {type_} {names[1]}, {type_} {names[2]}")
        elif op in ("fma", "fms", "fnma"):
            if op == "fms":
                names[2] = self.get(f"fneg {type_} {names[2]}")
            elif op == "fnma":
                names[0] = self.get(f"fneg {type_} {names[0]}")
            value.name = self.get(
                self.call(f"llvm.fma.{self.kind('double')}", type_, *((type_, name) for name in names))
            )
        elif op[1:5] == "cmp ":
            value.name = self.get(f"{op} {self.of(value.inputs[0].type)} {names[0]}, {names[1]}")
        elif op in _CASTS:
            value.name = self.get(f"{op} {self.of(value.inputs[0].type)} {names[0]} to {type_}")
        elif op in _SATURATING:
            from_ = value.inputs[0].type
            kinds = f"{self.kind(value.type)}.{self.kind(from_)}"
            value.name = self.get(self.call(f"{op}.{kinds}", type_, (self.of(from_), names[0])))
        elif op.startswith("llvm."):
            operands = [(type_, name) for name in names]
            value.name = self.get(self.call(f"{op}.{self.kind(value.type)}", type_, *operands))
        elif op == "table":
            self.table(value, names)
        elif op == "lookup":
            value.name = self.lookup(value)
        else:
            value.name = self.arithmetic(op, value.type, names)

    def arithmetic(self, op: str, type_: str, names: list[str]) -> str:
        """An operation on two numbers that LLVM knows by its name."""
        return self.get(f"{op} {self.of(type_)} {names[0]}, {names[1]}")

    def in_memory(self, value: GraphValue, mask: str) -> None:
        """Numbers in memory, and the places of these."""
        names = [self.text(operand) for operand in value.inputs]
        if value.op == "filled":
            value.name = names[0]
        elif value.op == "room":
            value.name = self.room(value.extra, value.type)
        elif value.op.startswith("place"):
            value.name = self.get(f"{value.op[6:]} i64 {names[0]}, {names[1]}")
        elif value.op == "row":
            value.name = self.element(value.inputs[0], names[1])
        else:
            array, place, number = names
            self.store(array, place, number, mask if value.extra else "")

    def counted(self, loop: Counted, mask: str) -> None:
        """A loop over indices, in all lanes at once."""
        before = self.label
        with self.counting(loop.length) as loop.index.name:
            phis = len(self.lines)
            for argument in loop.arguments:
                argument.name = f"%{self.new()}"
            self.region(loop.body, mask)
            self.lines[phis:phis] = [
                f"  {argument.name} = phi {self.of(argument.type)} [ {self.text(initial)}, %{before} ], "
                f"[ {self.text(update)}, %{self.label} ]"
                for argument, initial, update in zip(loop.arguments, loop.initial, loop.updates, strict=True)
            ]
        for update, result in zip(loop.updates, loop.results, strict=True):
            result.name = self.text(update)

    # Tables.

    def table(self, value: GraphValue, names: list[str]) -> None:
        """Numbers in memory: the module's own, the lane's arguments, or copies on the stack."""
        elements, type_ = value.inputs, value.inputs[0].type
        if len(elements) <= _CHOSEN:
            return
        if all(element.is_constant for element in elements) and type_ != BOOL:
            value.name = self.table_of_constants(type_, [self.digits(element) for element in elements])
        elif all(element.op == "input" for element in elements) and _follow([element.extra for element in elements]):
            value.name = self.table_of_inputs(type_, elements[0].extra)
        elif all(
            element.op == "row" and element.inputs[0] is elements[0].inputs[0] for element in elements
        ) and _follow([element.inputs[1].extra for element in elements]):
            # What is in memory already.
            array, first = elements[0].inputs
            value.name = self.table_of_rows(type_, array, first.extra)
        else:
            # Truths as bytes: a vector of them has no address for each.
            kept = "i8" if type_ == BOOL else type_
            if kept != type_:
                names = [self.get(f"zext {self.of(type_)} {name} to {self.of(kept)}") for name in names]
            value.name = self.table_of_values(kept, names)

    def lookup(self, value: GraphValue) -> str:
        """The element of a table that each lane asks for."""
        index, table = value.inputs
        elements, type_ = table.inputs, value.type
        if len(elements) <= _CHOSEN:
            chosen = self.text(elements[-1])
            for i, element in enumerate(elements[:-1]):
                here = self.get(f"icmp eq {self.of('i64')} {self.text(index)}, {self.constant('i64', str(i))}")
                one, other = f"{self.of(type_)} {self.text(element)}", f"{self.of(type_)} {chosen}"
                chosen = self.get(f"select {self.of(BOOL)} {here}, {one}, {other}")
            return chosen
        kept = "i8" if type_ == BOOL else type_
        numbers = self.look_up(kept, table.name, self.text(index))
        return numbers if kept == type_ else self.get(f"trunc {self.of(kept)} {numbers} to {self.of(type_)}")

    # Control flow, and results.

    def taken(self, branch: Branch, i: int) -> str:
        """Which lanes take a case."""
        selector, last = branch.selector, len(branch.regions) - 1
        if selector.type == BOOL:
            if i == 1:
                return self.text(selector)
            return self.get(f"xor {self.of(BOOL)} {self.text(selector)}, {self.constant(BOOL, 'true')}")
        # An index below the range takes the first case, one above it the last.
        kind = "sle" if i == 0 else "sge" if i == last else "eq"
        case = self.constant(selector.type, str(i))
        return self.get(f"icmp {kind} {self.of(selector.type)} {self.text(selector)}, {case}")

    def chosen(self, branch: Branch, conditions: list[str], results: list[list[str]]) -> None:
        """The results of a branch, all of whose cases have some."""
        for i, result in enumerate(branch.results):
            chosen, type_ = results[-1][i], self.of(result.type)
            for taken, values in zip(conditions[-2::-1], results[-2::-1], strict=True):
                chosen = self.get(f"select {self.of(BOOL)} {taken}, {type_} {values[i]}, {type_} {chosen}")
            result.name = chosen

    def stored(self, value: GraphValue) -> tuple[str, str]:
        """An output's type in memory, and its number: truths as bytes."""
        if value.type != BOOL:
            return value.type, self.text(value)
        return "i8", self.get(f"zext {self.of(BOOL)} {self.text(value)} to {self.of('i8')}")


def is_short(case: Region) -> bool:
    """Whether a case is always computed: it is no longer than a jump around it."""
    return len(case.steps) <= FEW and all(isinstance(step, GraphValue) for step in case.steps)


def _follow(places: list[int]) -> bool:
    """Whether places follow one another."""
    return places == list(range(places[0], places[0] + len(places)))


def tapes_with(op: str, graph: Graph) -> set[int]:
    """Which tapes a graph reads or writes, as `op` says."""
    found: set[int] = set()

    def note(region: Region) -> None:
        for step in region.steps:
            if isinstance(step, GraphValue) and step.op == op:
                found.add(step.extra)
            for inner in step.regions:
                note(inner)

    for region in graph.regions:
        note(region)
    return found
