"""A graph as LLVM's intermediate representation, on vectors of lanes.

Where lanes take different ways, a mask says which of them are active. A loop runs until its last lane is done, and
a case of a branch runs if any lane takes it; lanes that are not active keep their values. There is no fast-math and
no pass over the result, so its bits depend on the graph alone.

The code computes without Python's lock. A signal's handler (Ctrl-C) runs only in the main thread, and only where that
thread asks for it. So the code counts the rounds of its loops, and after many of them it asks. In the other threads
it looks at a word in memory instead, which the main thread sets.
"""

import contextlib
import struct
from collections.abc import Iterator

from erosion.lanes import tapes
from erosion.lanes.graph import ARRAY, BOOL, NUMBERS, PLACE, Branch, Counted, Graph, Loop, Region, Value

ENTRY = "run"
_FEW = 8  # operations of a case that are no longer than the jump around them
_CHOSEN = 8  # elements of a table among which choosing is quicker than looking up
_BITS = {"double": 64, "float": 32, "i64": 64, "i32": 32, "i16": 16, "i8": 8, "i1": 1, "ptr": 64}
_SATURATING = ("llvm.fptosi.sat", "llvm.fptoui.sat")
_CASTS = {"sitofp", "uitofp", "fpext", "fptrunc", "sext", "zext", "trunc", "bitcast"}

_ROUNDS = 2**14  # some hundredths of a second

PYTHONS = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
"""Functions of Python that the code calls."""

_INTERRUPTED = """declare ptr @PyEval_SaveThread()
declare void @PyEval_RestoreThread(ptr)
declare i32 @PyErr_CheckSignals()
define private i1 @interrupted(ptr %rounds, ptr %stop, ptr %thread) nounwind {
  store i64 0, ptr %rounds
  %alone = icmp eq ptr %stop, null
  br i1 %alone, label %signals, label %told
told:
  %word = load volatile i64, ptr %stop
  %stopped = icmp ne i64 %word, 0
  ret i1 %stopped
signals:
  call void @PyEval_RestoreThread(ptr %thread)
  %status = call i32 @PyErr_CheckSignals()
  %same = call ptr @PyEval_SaveThread()
  %came = icmp ne i32 %status, 0
  ret i1 %came
}"""
"""Whether to end: *stop is not 0, or, where `stop` is null, a handler has raised. Rounds are counted from 0 again."""


def vector_ir(graph: Graph, width: int, of_tapes: int = 0) -> str:
    """The text of a module with one function.

        void run(double* inputs, Varying* varying, i64 count, i64* order, i64 lanes, Place* outputs, i64* stop)

    For each group of `width` lanes order[:lanes] it copies the lanes' numbers into `inputs`, computes, and
    writes the results. `inputs` is an array (rows, width), which holds what all lanes share in the first `places`
    rows, and after them what the graph keeps in memory; large arrays that all lanes share follow, one number after
    another. `varying` says
    for `count` places where a lane's number is found: an address, the bytes from lane to lane, the place.
    `outputs` has for each output, and then for each tape, an address, and the bytes from lane to lane. A group that is
    not full repeats its last lane, which writes the same. Truths are written as bytes. It is called with Python's lock
    held, and works without. It ends early where *stop is not 0, or, without `stop`, where a signal's handler raises an
    exception.

    Args:
        graph: finished.
        width: lanes of a vector.
        of_tapes: how many tapes there are.
    """
    return _Writer(graph, width, of_tapes).module()


class _Writer:
    def __init__(self, graph: Graph, width: int, of_tapes: int) -> None:
        self.graph, self.width, self.of_tapes = graph, width, of_tapes
        self.tapes: list[str] = []  # of each, where those of the lanes begin
        self.lines: list[str] = []
        self.label = ""  # of the block that is being written
        self.count = 0
        self.declared: dict[str, str] = {}
        self.tables: list[str] = []  # of constants
        self.memory: list[str] = []  # on the stack
        self.shared: set[str] = set()  # tables that all lanes share

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

    def vector(self, type_: str) -> str:
        """A vector of lanes of this type."""
        return f"<{self.width} x {type_}>"

    def kind(self, type_: str) -> str:
        """A vector of this type in the name of an intrinsic function."""
        return f"v{self.width}{'f' if type_ in ('double', 'float') else 'i'}{_BITS[type_]}"

    def call(self, name: str, result: str, *operands: tuple[str, str]) -> str:
        """A call of an intrinsic function of LLVM, which is declared once; operands with their types."""
        self.declared[name] = f"declare {result} @{name}({', '.join(type_ for type_, _ in operands)})"
        return f"call {result} @{name}({', '.join(' '.join(operand) for operand in operands)})"

    def splat(self, scalar: str, type_: str = "i64") -> str:
        """A vector of one number."""
        vector = self.vector(type_)
        first = self.get(f"insertelement {vector} poison, {type_} {scalar}, i64 0")
        return self.get(f"shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer")

    # The function around the lanes.

    def module(self) -> str:
        """The whole text."""
        longs, all_lanes = self.vector("i64"), "splat (i1 true)"
        self.start("entry")
        self.do("store i64 0, ptr %rounds")
        self.do("%thread = call ptr @PyEval_SaveThread()")
        self.do("%last = sub i64 %lanes, 1")
        last = self.splat("%last")
        places: list[tuple[str, str] | str] = []
        count = 0
        for output in self.graph.outputs:
            places.append(self.place_of_output(str(count)) if output.type != ARRAY else str(count))
            count += output.extra if output.type == ARRAY else 1
        tapes_at = [self.place_of_output(str(count + i)) for i in range(self.of_tapes)]
        self.do("br label %group")
        self.start("group")
        self.do("%at = phi i64 [ 0, %entry ], [ %next, %written ]")
        steps = ", ".join(f"i64 {i}" for i in range(self.width))
        position = self.get(f"add {longs} {self.splat('%at')}, <{steps}>")
        position = self.get(self.call(f"llvm.smin.v{self.width}i64", longs, (longs, position), (longs, last)))
        in_order = self.get(f"getelementptr i64, ptr %order, {longs} {position}")
        lane = self.gather("i64", in_order)
        for address, stride in tapes_at:
            offset = self.get(f"mul {longs} {lane}, {stride}")
            self.tapes.append(self.get(f"getelementptr i8, ptr {address}, {longs} {offset}"))
        self.copy_inputs(lane)
        self.region(self.graph.root, all_lanes)
        for place, value in zip(places, self.graph.outputs, strict=True):
            if isinstance(place, tuple):
                self.write(*self.stored(value), place[0], place[1], lane)
            else:
                self.write_array(value, place, lane)
        self.do("br label %written")
        self.start("written")
        self.do(f"%next = add i64 %at, {self.width}")
        self.do("%more = icmp slt i64 %next, %lanes")
        self.do("br i1 %more, label %group, label %exit")
        self.start("exit")
        self.do("call void @PyEval_RestoreThread(ptr %thread)")
        self.do("ret void")
        parameters = (
            "ptr noalias align 64 %inputs, ptr noalias %varying, i64 %count, ptr noalias %order, i64 %lanes, "
            "ptr noalias %outputs, ptr %stop"
        )
        return "\n".join([
            _INTERRUPTED,
            *self.declared.values(),
            *self.tables,
            # Vectors that do not fit the registers go onto the stack, where they must not straddle cache lines.
            f'define void @{ENTRY}({parameters}) nounwind "stackrealign" {{',
            self.lines[0],
            "  %rounds = alloca i64",
            *self.memory,
            *self.lines[1:],
            "}",
        ])  # fmt: skip

    def place_of_output(self, number: str) -> tuple[str, str]:
        """The address of an output, and the bytes from lane to lane as a vector."""
        row = self.get(f"mul i64 {number}, 2")
        address = self.get(f"getelementptr i64, ptr %outputs, i64 {row}")
        step = self.get(f"getelementptr i64, ptr %outputs, i64 {self.get(f'add i64 {row}, 1')}")
        return self.get(f"load ptr, ptr {address}"), self.splat(self.get(f"load i64, ptr {step}"))

    def write(self, type_: str, name: str, address: str, stride: str, lane: str) -> None:
        """Write a number of each lane into an output."""
        longs = self.vector("i64")
        to = self.get(f"getelementptr i8, ptr {address}, {longs} {self.get(f'mul {longs} {lane}, {stride}')}")
        self.scatter(type_, name, to, "splat (i1 true)")

    def scatter(self, type_: str, numbers: str, addresses: str, active: str) -> None:
        """Write the numbers of active lanes to addresses."""
        name = f"llvm.masked.scatter.{self.kind(type_)}.v{self.width}p0"
        places, size = (self.vector("ptr"), addresses), ("i32", str(_BITS[type_] // 8))
        self.do(self.call(name, "void", (self.vector(type_), numbers), places, size, (self.vector(BOOL), active)))

    def on_tape(self, value: Value, mask: str) -> None:
        """Numbers of the lane's own memory; see `erosion.lanes.tapes`."""
        token, place, *numbers = map(self.text, value.inputs)
        pointers, longs, tape = self.vector("ptr"), self.vector("i64"), self.tapes[value.extra]
        if value.inputs[1].type != "i64":
            place = self.get(f"sext {self.vector(value.inputs[1].type)} {place} to {longs}")
        at = self.get(f"getelementptr double, {pointers} {tape}, {longs} {place}")
        if value.op == tapes.READ:
            value.name = self.gather("double", at)
            return
        for i, number in enumerate(numbers):
            self.scatter(
                "double", number, self.get(f"getelementptr double, {pointers} {at}, {longs} splat (i64 {i})"), mask
            )
        value.name = token

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

    def write_array(self, array: Value, first: str, lane: str) -> None:
        """Write the numbers of an array into outputs, the first of which is given."""
        with self.counting(array.extra) as index:
            place = self.place_of_output(self.get(f"add i64 {index}, {first}"))
            row = self.get(f"getelementptr {self.vector('double')}, ptr {self.text(array.inputs[0])}, i64 {index}")
            self.write("double", self.get(f"load {self.vector('double')}, ptr {row}"), *place, lane)

    def copy_inputs(self, lane: str) -> None:
        """Copy the numbers that vary from lane to lane into `inputs`, in a loop over their places."""
        self.do("%any_varies = icmp sgt i64 %count, 0")
        self.do("br i1 %any_varies, label %copy, label %compute")
        self.start("copy")
        with self.counting("%count") as index:
            row, fields = self.get(f"mul i64 {index}, 3"), []
            for field, type_ in enumerate(("ptr", "i64", "i64")):
                address = self.get(f"getelementptr i64, ptr %varying, i64 {self.get(f'add i64 {row}, {field}')}")
                fields.append(self.get(f"load {type_}, ptr {address}"))
            (address, stride, place), longs = fields, self.vector("i64")
            from_ = self.get(
                f"getelementptr i8, ptr {address}, {longs} {self.get(f'mul {longs} {lane}, {self.splat(stride)}')}"
            )
            numbers = self.gather("double", from_)
            to = self.get(f"getelementptr {self.vector('double')}, ptr %inputs, i64 {place}")
            self.do(f"store {self.vector('double')} {numbers}, ptr {to}")
        self.do("br label %compute")
        self.start("compute")

    def gather(self, type_: str, addresses: str) -> str:
        """Numbers from memory, each lane's from its own address."""
        vector, pointers, mask = self.vector(type_), self.vector("ptr"), self.vector(BOOL)
        # The alignment as an argument is the form of LLVM 20, which LLVM 22 reads too; LLVM 20 ends the process at the
        # newer form.
        size = str(max(_BITS[type_] // 8, 1))
        operands = (pointers, addresses), ("i32", size), (mask, "splat (i1 true)"), (vector, "poison")
        return self.get(self.call(f"llvm.masked.gather.{self.kind(type_)}.v{self.width}p0", vector, *operands))

    def stored(self, value: Value) -> tuple[str, str]:
        """An output's type in memory, and its vector: truths as bytes."""
        if value.type != BOOL:
            return value.type, self.text(value)
        return "i8", self.get(f"zext {self.vector(BOOL)} {self.text(value)} to {self.vector('i8')}")

    # Values.

    def text(self, value: Value) -> str:
        """A value's name, or its number."""
        if value.op == "const":
            return self.number(value)
        return value.name

    def number(self, value: Value) -> str:
        """A constant."""
        if not value.name:
            if value.type in ("double", "float"):
                bits = struct.unpack("<Q", struct.pack("<d", value.extra))[0]
                value.name = f"splat ({value.type} 0x{bits:016X})"
            elif value.type == PLACE:
                value.name = str(value.extra)
            elif value.type == BOOL:
                value.name = f"splat (i1 {'true' if value.extra else 'false'})"
            else:
                value.name = f"splat ({value.type} {value.extra})"
        return value.name

    def region(self, region: Region, mask: str) -> None:
        """The steps of a region, for the lanes of a mask."""
        for step in region.steps:
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
            elif step.op in ("room", "filled", "row", "store", "place add", "place mul"):
                self.in_memory(step, mask)
            else:
                self.operation(step)

    def operation(self, value: Value) -> None:
        """One operation."""
        op, type_ = value.op, self.vector(value.type)
        names = [self.text(operand) for operand in value.inputs]
        if op == "input":
            address = self.get(f"getelementptr {type_}, ptr %inputs, i64 {value.extra}")
            value.name = self.get(f"load {type_}, ptr {address}")
        elif op == "fneg":
            value.name = self.get(f"fneg {type_} {names[0]}")
        elif op == "select":
            value.name = self.get(f"select {self.vector(BOOL)} {names[0]}, {type_} {names[1]}, {type_} {names[2]}")
        elif op in ("fma", "fms", "fnma"):
            if op == "fms":
                names[2] = self.get(f"fneg {type_} {names[2]}")
            elif op == "fnma":
                names[0] = self.get(f"fneg {type_} {names[0]}")
            value.name = self.get(self.call(f"llvm.fma.v{self.width}f64", type_, *((type_, name) for name in names)))
        elif op[1:5] == "cmp ":
            value.name = self.get(f"{op} {self.vector(value.inputs[0].type)} {names[0]}, {names[1]}")
        elif op in _CASTS:
            value.name = self.get(f"{op} {self.vector(value.inputs[0].type)} {names[0]} to {type_}")
        elif op in _SATURATING:
            of = value.inputs[0].type
            kinds = f"{self.kind(value.type)}.{self.kind(of)}"
            value.name = self.get(self.call(f"{op}.{kinds}", type_, (self.vector(of), names[0])))
        elif op.startswith("llvm."):
            operands = [(type_, name) for name in names]
            value.name = self.get(self.call(f"{op}.{self.kind(value.type)}", type_, *operands))
        elif op == "table":
            self.table(value, names)
        elif op == "lookup":
            value.name = self.lookup(value)
        else:
            value.name = self.get(f"{op} {type_} {names[0]}, {names[1]}")

    def in_memory(self, value: Value, mask: str) -> None:
        """Numbers in memory, and the places of these."""
        names, row = [self.text(operand) for operand in value.inputs], self.vector("double")
        if value.op == "filled":
            value.name = names[0]
        elif value.op == "room":
            place = value.extra * self.width
            if value.type == NUMBERS:
                place = value.extra + self.graph.rows * self.width
            value.name = self.get(f"getelementptr double, ptr %inputs, i64 {place}")
        elif value.op.startswith("place"):
            value.name = self.get(f"{value.op[6:]} i64 {names[0]}, {names[1]}")
        elif value.inputs[0].type == NUMBERS:
            address = self.get(f"getelementptr double, ptr {names[0]}, i64 {names[1]}")
            value.name = self.splat(self.get(f"load double, ptr {address}"), "double")
        else:
            address = self.get(f"getelementptr {row}, ptr {names[0]}, i64 {names[1]}")
            if value.op == "row":
                value.name = self.get(f"load {row}, ptr {address}")
                return
            if value.extra and mask != "splat (i1 true)":
                # Volatile, or LLVM makes it a masked store, which takes ten times as long on some processors.
                old = self.get(f"load volatile {row}, ptr {address}")
                names[2] = self.get(f"select {self.vector(BOOL)} {mask}, {row} {names[2]}, {row} {old}")
            self.do(f"store {row} {names[2]}, ptr {address}")

    def counted(self, loop: Counted, mask: str) -> None:
        """A loop over indices, in all lanes at once."""
        before = self.label
        with self.counting(loop.length) as loop.index.name:
            phis = len(self.lines)
            for argument in loop.arguments:
                argument.name = f"%{self.new()}"
            self.region(loop.body, mask)
            self.lines[phis:phis] = [
                f"  {argument.name} = phi {self.vector(argument.type)} [ {self.text(initial)}, %{before} ], "
                f"[ {self.text(update)}, %{self.label} ]"
                for argument, initial, update in zip(loop.arguments, loop.initial, loop.updates, strict=True)
            ]
        for update, result in zip(loop.updates, loop.results, strict=True):
            result.name = self.text(update)

    # Tables.

    def table(self, value: Value, names: list[str]) -> None:
        """Numbers in memory: the module's own, the lane's arguments, or copies on the stack."""
        elements, type_ = value.inputs, value.inputs[0].type
        if len(elements) <= _CHOSEN:
            return
        places = [element.extra for element in elements]
        if all(element.is_constant for element in elements) and type_ != BOOL:
            value.name = f"@{self.new('table')}"
            numbers = ", ".join(self.number(element)[len("splat (") : -1] for element in elements)
            self.tables.append(f"{value.name} = private constant [{len(elements)} x {type_}] [{numbers}]")
        elif all(element.op == "input" for element in elements) and _follow(places):
            value.name = self.get(f"getelementptr {self.vector(type_)}, ptr %inputs, i64 {places[0]}")
        elif all(
            element.op == "row" and element.inputs[0] is elements[0].inputs[0] for element in elements
        ) and _follow([element.inputs[1].extra for element in elements]):
            # What is in memory already.
            array, first = elements[0].inputs
            kind = type_ if array.type == NUMBERS else self.vector(type_)
            value.name = self.get(f"getelementptr {kind}, ptr {self.text(array)}, i64 {first.extra}")
            if array.type == NUMBERS:
                self.shared.add(value.name)
        else:
            # Truths as bytes: a vector of them has no address for each.
            kept = "i8" if type_ == BOOL else type_
            vector = self.vector(kept)
            value.name = f"%{self.new('memory')}"
            self.memory.append(f"  {value.name} = alloca [{len(names)} x {vector}], align 64")
            for i, name in enumerate(names):
                to = self.get(f"getelementptr {vector}, ptr {value.name}, i64 {i}")
                one = name if kept == type_ else self.get(f"zext {self.vector(type_)} {name} to {vector}")
                self.do(f"store {vector} {one}, ptr {to}")

    def lookup(self, value: Value) -> str:
        """The element of a table that each lane asks for."""
        index, table = value.inputs
        elements, type_ = table.inputs, value.type
        longs = self.vector("i64")
        if len(elements) <= _CHOSEN:
            chosen = self.text(elements[-1])
            for i, element in enumerate(elements[:-1]):
                here = self.get(f"icmp eq {longs} {self.text(index)}, splat (i64 {i})")
                vector = self.vector(type_)
                chosen = self.get(
                    f"select {self.vector(BOOL)} {here}, {vector} {self.text(element)}, {vector} {chosen}"
                )
            return chosen
        kept = "i8" if type_ == BOOL else type_
        flat = self.text(index)
        if not table.name.startswith("@") and table.name not in self.shared:
            lanes = ", ".join(f"i64 {i}" for i in range(self.width))
            row = self.get(f"mul {longs} {flat}, splat (i64 {self.width})")
            flat = self.get(f"add {longs} {row}, <{lanes}>")
        numbers = self.gather(kept, self.get(f"getelementptr {kept}, ptr {table.name}, {longs} {flat}"))
        return numbers if kept == type_ else self.get(f"trunc {self.vector(kept)} {numbers} to {self.vector(type_)}")

    # Control flow.

    def any_of(self, mask: str) -> str:
        """Whether any lane of a mask is active."""
        return self.get(self.call(f"llvm.vector.reduce.or.v{self.width}i1", BOOL, (self.vector(BOOL), mask)))

    def both(self, mask: str, other: str) -> str:
        """The lanes of two masks."""
        return other if mask == "splat (i1 true)" else self.get(f"and {self.vector(BOOL)} {mask}, {other}")

    def loop(self, loop: Loop, mask: str) -> None:
        """A loop: the condition, and what is done where it holds."""
        head, body, again, done = (self.new(label) for label in ("head", "body", "again", "done"))
        before = self.label
        self.do(f"br label %{head}")
        self.start(head)
        phis = len(self.lines)
        for argument, initial in zip(loop.arguments, loop.initial, strict=True):
            # An array is changed where it is.
            argument.name = self.text(initial) if argument.type == ARRAY else f"%{self.new()}"
        self.region(loop.head, mask)
        active = self.both(mask, self.text(loop.condition))
        self.do(f"br i1 {self.any_of(active)}, label %{body}, label %{done}")
        self.start(body)
        self.region(loop.body, active)
        updates = []
        carried = [
            each for each in zip(loop.arguments, loop.initial, loop.updates, strict=True) if each[0].type != ARRAY
        ]
        for argument, _, update in carried:
            type_ = self.vector(argument.type)
            updates.append(
                self.get(f"select {self.vector(BOOL)} {active}, {type_} {self.text(update)}, {type_} {argument.name}")
            )
        # The end of a round.
        self.lines += [
            f"  %before.{again} = load i64, ptr %rounds",
            f"  %rounds.{again} = add i64 %before.{again}, 1",
            f"  store i64 %rounds.{again}, ptr %rounds",
            f"  %many.{again} = icmp ugt i64 %rounds.{again}, {_ROUNDS}",
            f"  br i1 %many.{again}, label %look.{again}, label %{again}",
            f"look.{again}:",
            f"  %stopped.{again} = call i1 @interrupted(ptr %rounds, ptr %stop, ptr %thread)",
            f"  br i1 %stopped.{again}, label %exit, label %{again}",
        ]
        self.start(again)
        self.do(f"br label %{head}")
        self.lines[phis:phis] = [
            f"  {argument.name} = phi {self.vector(argument.type)} [ {self.text(initial)}, %{before} ], "
            f"[ {update}, %{again} ]"
            for (argument, initial, _), update in zip(carried, updates, strict=True)
        ]
        self.start(done)
        for argument, result in zip(loop.arguments, loop.results, strict=True):
            result.name = argument.name

    def branch(self, branch: Branch, mask: str) -> None:
        """A branch: each case if any lane takes it."""
        results: list[list[str]] = []
        conditions = []
        for i, case in enumerate(branch.regions):
            taken = self.taken(branch, i)
            conditions.append(taken)
            results.append(self.case(case, branch.outputs[i], self.both(mask, taken)))
        for i, result in enumerate(branch.results):
            chosen, type_ = results[-1][i], self.vector(result.type)
            for taken, values in zip(conditions[-2::-1], results[-2::-1], strict=True):
                chosen = self.get(f"select {self.vector(BOOL)} {taken}, {type_} {values[i]}, {type_} {chosen}")
            result.name = chosen

    def taken(self, branch: Branch, i: int) -> str:
        """Which lanes take a case."""
        selector, last = branch.selector, len(branch.regions) - 1
        if selector.type == BOOL:
            if i == 1:
                return self.text(selector)
            return self.get(f"xor {self.vector(BOOL)} {self.text(selector)}, splat (i1 true)")
        # An index below the range takes the first case, one above it the last.
        kind = "sle" if i == 0 else "sge" if i == last else "eq"
        return self.get(f"icmp {kind} {self.vector(selector.type)} {self.text(selector)}, splat ({selector.type} {i})")

    def case(self, case: Region, outputs: list[Value], mask: str) -> list[str]:
        """One case; zeros where no lane takes it."""
        if len(case.steps) <= _FEW and all(isinstance(step, Value) for step in case.steps):
            self.region(case, mask)
            return [self.text(value) for value in outputs]
        inside, after = self.new("case"), self.new("after")
        before = self.label
        self.do(f"br i1 {self.any_of(mask)}, label %{inside}, label %{after}")
        self.start(inside)
        self.region(case, mask)
        end = self.label
        self.do(f"br label %{after}")
        self.start(after)
        return [
            self.get(f"phi {self.vector(value.type)} [ {self.text(value)}, %{end} ], [ zeroinitializer, %{before} ]")
            for value in outputs
        ]


def _follow(places: list[int]) -> bool:
    """Whether places follow one another."""
    return places == list(range(places[0], places[0] + len(places)))
