"""A graph as LLVM's intermediate representation, for one lane, as each thread of a GPU computes it.

A loop is a loop of its own thread, and a thread runs the case of a branch that its lane takes. The operations are those
of `vector_ir`, on one number, so a lane has the same bits on a GPU as on a processor. (A NaN may have other bits.)

A thread takes the next lane when its lane ends. After many rounds of a loop it looks at a word that may stop it.
"""

from typing import NamedTuple

from erosion.lanes import tapes
from erosion.lanes.graph import ARRAY, NUMBERS, Branch, Graph, GraphValue, Loop, Step
from erosion.lanes.writer import BITS, ENTRY, Writer, is_short

LOCAL = 256
"""Numbers of a lane's memory that are kept on the stack of its thread; more are kept in the GPU's memory."""

FIELD = 2
"""Whole numbers of a field: an address, and the bytes from lane to lane. A tape has a second field: the bytes from
number to number, and 0."""

_ROUNDS = 2**12  # of a loop, between two looks at the word that stops it: a power of two


class KernelTarget(NamedTuple):
    """The machine that runs the threads: how its text begins a kernel, and how a thread gets its number."""

    header: str
    convention: str
    parameters: str
    prologue: str


GPU = KernelTarget(
    'target triple = "nvptx64-nvidia-cuda"\n'
    "declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()\ndeclare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()\n"
    "declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()\ndeclare i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()",
    "ptx_kernel",
    "",
    """  %tid = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %threads.block = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %blocks = call i32 @llvm.nvvm.read.ptx.sreg.nctaid.x()
  %before = mul i32 %block, %threads.block
  %number = add i32 %before, %tid
  %all = mul i32 %blocks, %threads.block
  %thread = zext i32 %number to i64
  %threads = zext i32 %all to i64""",
)

PROCESSOR = KernelTarget("", "", ", i64 %thread, i64 %threads", "")
"""A processor, for tests: one thread at a time, which is told its number."""

_GLOBAL, _FOREVER = "ptr addrspace(1)", "!invariant.load !0"

_REMAINDER = """define private double @remainder(double %x, double %y) {
begin:
  %r = call double @llvm.fabs.f64(double %x)
  %s = call double @llvm.fabs.f64(double %y)
  %finite = fcmp olt double %r, 0x7FF0000000000000
  %divides = fcmp ogt double %s, 0.0
  %some = and i1 %finite, %divides
  br i1 %some, label %number, label %none
none:
  ret double 0x7FF8000000000000
number:
  %bounded = fcmp olt double %s, 0x7FF0000000000000
  br i1 %bounded, label %up, label %whole
whole:
  ret double %x
up:
  %step = phi double [ %s, %number ], [ %twice, %up ]
  %twice = fadd double %step, %step
  %fits = fcmp ole double %twice, %r
  br i1 %fits, label %up, label %down
down:
  %part = phi double [ %step, %up ], [ %half, %down ]
  %rest = phi double [ %r, %up ], [ %less, %down ]
  %in = fcmp oge double %rest, %part
  %difference = fsub double %rest, %part
  %less = select i1 %in, double %difference, double %rest
  %half = fmul double %part, 5.000000e-01
  %more = fcmp oge double %half, %s
  br i1 %more, label %down, label %done
done:
  %signed = call double @llvm.copysign.f64(double %less, double %x)
  ret double %signed
}
declare double @llvm.copysign.f64(double, double)"""
"""The exact remainder, for which a processor calls the C library: each step is exact, so the bits are the same."""


def thread_ir(graph: Graph, of_tapes: int = 0, target: KernelTarget = GPU) -> str:
    """The text of a module with one kernel.

        void run(i64* fields, i32* order, i64 lanes, double* numbers, double* room, i64* next, i64* stop)

    The threads compute lanes order[:lanes]. `fields` holds the places of the arguments, the outputs, and the tapes
    (see `FIELD`); each number of an argument has a field. `numbers` are large arrays that all lanes share. `room` is
    memory for `own_rows` numbers of each thread, those of neighbours side by side. `next` counts the lanes that are
    taken, 0 at first. Truths are written as bytes. Threads end early where *stop is not 0.

    Args:
        graph: finished, without subroutines.
        of_tapes: how many tapes there are.
        target: the machine that runs it.
    """
    return _ThreadWriter(graph, of_tapes, target).module()


def own_rows(graph: Graph) -> int:
    """How many numbers of `room` each thread needs."""
    rows = graph.rows - graph.places
    return 0 if rows <= LOCAL else rows


class _ThreadWriter(Writer):
    def __init__(self, graph: Graph, of_tapes: int, target: KernelTarget) -> None:
        super().__init__(graph, of_tapes)
        self.target = target
        self.given: dict[str, int] = {}  # arrays that are arguments: the place of the first number
        self.rows: dict[str, tuple[GraphValue, int]] = {}  # tables that are part of an array
        self.lane = ""  # whose numbers are read and written

    def of(self, type_: str) -> str:
        """The type itself."""
        return type_

    def kind(self, type_: str) -> str:
        """The type in the name of an intrinsic function."""
        return f"{'f' if type_ in ('double', 'float') else 'i'}{BITS[type_]}"

    def constant(self, type_: str, number: str) -> str:
        """The number itself."""
        return number

    # The function around the lanes.

    def module(self) -> str:
        """The whole text."""
        self.start("entry")
        for step in self.graph.root.steps:
            if isinstance(step, GraphValue) and step.op == "room":
                step.name = self.room(step.extra, step.type)
        self.do("br label %first")
        self.start("first")
        self.do(f"%at = atomicrmw add {_GLOBAL} %next, i64 1 monotonic")
        some = self.get(
            f"select i1 {self.get('load i1, ptr %stopped')}, i1 false, i1 {self.get('icmp slt i64 %at, %lanes')}"
        )
        self.do(f"br i1 {some}, label %lane, label %exit")
        self.start("lane")
        address = self.get(f"getelementptr i32, {_GLOBAL} %order, i64 %at")
        self.lane = self.get(f"sext i32 {self.get(f'load i32, {_GLOBAL} {address}')} to i64")
        self.region(self.graph.root, "")
        self.write_outputs()
        self.do("br label %first")
        self.start("exit")
        self.do("ret void")
        rows = self.graph.rows - self.graph.places
        if 0 < rows <= LOCAL:
            own = [f"  %own = alloca [{rows} x double]"]
        else:
            own = [
                f"  %own = getelementptr double, {_GLOBAL} %room, i64 %thread",
                "  %pitch = mul i64 %threads, 8",
            ]
        pointers = ", ".join([
            f"{_GLOBAL} noalias readonly align 16 %fields", f"{_GLOBAL} noalias readonly %order", "i64 %lanes",
            f"{_GLOBAL} noalias readonly align 8 %numbers", f"{_GLOBAL} noalias %room",
            f"{_GLOBAL} noalias %next", "ptr %stop",
        ])  # fmt: skip
        return "\n".join([
            self.target.header,
            *self.declared.values(),
            *self.tables,
            f"define {self.target.convention} void @{ENTRY}({pointers}{self.target.parameters}) nounwind {{",
            self.lines[0],
            self.target.prologue,
            *own,
            "  %stopped = alloca i1",
            "  store i1 false, ptr %stopped",
            *self.memory,
            *self.lines[1:],
            "}",
            "!0 = !{}",
        ])  # fmt: skip

    def field(self, number: str, i: int = 0) -> str:
        """A whole number of `fields`."""
        at = self.get(f"add i64 {self.get(f'mul i64 {number}, {FIELD}')}, {i}")
        address = self.get(f"getelementptr i64, {_GLOBAL} %fields, i64 {at}")
        return self.get(f"load i64, {_GLOBAL} {address}, {_FOREVER}")

    def pointer(self, number: str) -> str:
        """Where the lane's number is."""
        at = self.get(f"add i64 {self.field(number)}, {self.get(f'mul i64 {self.field(number, 1)}, {self.lane}')}")
        return self.get(f"inttoptr i64 {at} to {_GLOBAL}")

    def write_outputs(self) -> None:
        """Write the results of a lane."""
        count = self.graph.places
        for output in self.graph.outputs:
            if output.type == ARRAY:
                with self.counting(output.extra) as index:
                    number = self.element(output.inputs[0], index)
                    to = self.pointer(self.get(f"add i64 {index}, {count}"))
                    self.do(f"store double {number}, {_GLOBAL} {to}")
                count += output.extra
            else:
                type_, name = self.stored(output)
                self.do(f"store {type_} {name}, {_GLOBAL} {self.pointer(str(count))}")
                count += 1

    # Memory.

    def gather(self, type_: str, addresses: str) -> str:
        """A number from memory."""
        return self.get(f"load {type_}, {addresses}")

    def input(self, place: int) -> str:
        """The argument, from where it is."""
        return self.argument(str(place))

    def argument(self, place: str) -> str:
        """The argument in a place that may be computed."""
        return self.get(f"load double, {_GLOBAL} {self.pointer(place)}, {_FOREVER}")

    def on_tape(self, value: GraphValue, mask: str) -> None:
        """Numbers in the GPU's memory."""
        token, place, *numbers = map(self.text, value.inputs)
        if value.inputs[1].type != "i64":
            place = self.get(f"sext {value.inputs[1].type} {place} to i64")
        outputs = sum(output.extra if output.type == ARRAY else 1 for output in self.graph.outputs)
        field = str(self.graph.places + outputs + 2 * value.extra)
        tape, step = self.pointer(field), self.field(field, FIELD)
        at = self.get(f"getelementptr i8, {_GLOBAL} {tape}, i64 {self.get(f'mul i64 {place}, {step}')}")
        if value.op == tapes.READ:
            value.name = self.gather("double", f"{_GLOBAL} {at}")
            return
        for i, number in enumerate(numbers):
            to = self.get(f"getelementptr i8, {_GLOBAL} {at}, i64 {self.get(f'mul i64 {step}, {i}')}")
            self.do(f"store double {number}, {_GLOBAL} {to}")
        value.name = token

    def room(self, first: int, type_: str) -> str:
        """A place in the thread's memory, or in what all lanes share; what is an argument stays where it is."""
        if type_ == NUMBERS:
            return self.get(f"getelementptr double, {_GLOBAL} %numbers, i64 {first}")
        if first < self.graph.places:
            name = f"given{first}"
            self.given[name] = first
            return name
        return self.row("%own", str(first - self.graph.places))

    @property
    def space(self) -> str:
        """The type of an address in the thread's memory."""
        return "ptr" if 0 < self.graph.rows - self.graph.places <= LOCAL else _GLOBAL

    def row(self, array: str, place: str) -> str:
        """The address of a number in the thread's memory."""
        if self.space == "ptr":
            return self.get(f"getelementptr double, ptr {array}, i64 {place}")
        return self.get(f"getelementptr i8, {_GLOBAL} {array}, i64 {self.get(f'mul i64 %pitch, {place}')}")

    def element(self, array: GraphValue, place: str) -> str:
        """A number of an array."""
        name = self.text(array)
        if name in self.given:
            return self.argument(self.get(f"add i64 {place}, {self.given[name]}"))
        if array.type == NUMBERS:
            return self.get(
                f"load double, {_GLOBAL} {self.get(f'getelementptr double, {_GLOBAL} {name}, i64 {place}')}, {_FOREVER}"
            )
        return self.get(f"load double, {self.space} {self.row(name, place)}")

    def store(self, array: str, place: str, number: str, mask: str) -> None:
        """Write a number into the thread's memory."""
        self.do(f"store double {number}, {self.space} {self.row(array, place)}")

    def table_of_constants(self, type_: str, numbers: list[str]) -> str:
        """An array of the module, in global memory: threads of a warp look at different places."""
        name = f"@{self.new('table')}"
        elements = ", ".join(f"{type_} {number}" for number in numbers)
        self.tables.append(f"{name} = private addrspace(1) constant [{len(numbers)} x {type_}] [{elements}]")
        return name

    def table_of_inputs(self, type_: str, first: int) -> str:
        """The arguments where they are."""
        self.given[f"given{first}"] = first
        return f"given{first}"

    def table_of_rows(self, type_: str, array: GraphValue, first: int) -> str:
        """A part of an array."""
        name = self.new("rows")
        self.rows[name] = array, first
        return name

    def table_of_values(self, type_: str, names: list[str]) -> str:
        """Numbers on the stack."""
        table = f"%{self.new('memory')}"
        self.memory.append(f"  {table} = alloca [{len(names)} x {type_}]")
        for i, name in enumerate(names):
            self.do(f"store {type_} {name}, ptr {self.get(f'getelementptr {type_}, ptr {table}, i64 {i}')}")
        return table

    def look_up(self, type_: str, table: str, index: str) -> str:
        """An element of a table."""
        if table in self.given:
            return self.argument(self.get(f"add i64 {index}, {self.given[table]}"))
        if table in self.rows:
            array, first = self.rows[table]
            return self.element(array, self.get(f"add i64 {index}, {first}"))
        space = _GLOBAL if table.startswith("@") else "ptr"
        address = self.get(f"getelementptr {type_}, {space} {table}, i64 {index}")
        return self.gather(type_, f"{space} {address}")

    def arithmetic(self, op: str, type_: str, names: list[str]) -> str:
        """The same, but a remainder is not left to the GPU's compiler, which rounds it."""
        if op != "frem":
            return super().arithmetic(op, type_, names)
        if _REMAINDER not in self.tables:
            self.tables.append(_REMAINDER)
            self.call("llvm.fabs.f64", "double", ("double", "0.0"))
        wide = names if type_ == "double" else [self.get(f"fpext {type_} {name} to double") for name in names]
        rest = self.get(f"call double @remainder(double {wide[0]}, double {wide[1]})")
        return rest if type_ == "double" else self.get(f"fptrunc double {rest} to {type_}")

    # Control flow.

    def step(self, step: Step, mask: str) -> None:
        """A step of a region; where memory begins is known before."""
        if not (isinstance(step, GraphValue) and step.op == "room"):
            super().step(step, mask)

    def loop(self, loop: Loop, mask: str) -> None:
        """A loop: the condition, and what is done where it holds."""
        head, body, look, again, done = (self.new(label) for label in ("head", "body", "look", "again", "done"))
        before, rounds = self.label, f"%{self.new('rounds')}"
        self.do(f"br label %{head}")
        self.start(head)
        phis = len(self.lines)
        for argument, initial in zip(loop.arguments, loop.initial, strict=True):
            # An array is changed where it is.
            argument.name = self.text(initial) if argument.type == ARRAY else f"%{self.new()}"
        self.region(loop.head, mask)
        goes_on = self.get(f"select i1 {self.get('load i1, ptr %stopped')}, i1 false, i1 {self.text(loop.condition)}")
        self.do(f"br i1 {goes_on}, label %{body}, label %{done}")
        self.start(body)
        self.region(loop.body, mask)
        following = self.get(f"add i32 {rounds}, 1")
        many = self.get(f"icmp eq i32 {self.get(f'and i32 {following}, {_ROUNDS - 1}')}, 0")
        self.do(f"br i1 {many}, label %{look}, label %{again}")
        self.start(look)
        word = self.get("load volatile i64, ptr %stop")
        # No jump out of the loop: threads come together again only where a loop has one way out.
        self.do(f"store i1 {self.get(f'icmp ne i64 {word}, 0')}, ptr %stopped")
        self.do(f"br label %{again}")
        self.start(again)
        self.do(f"br label %{head}")
        self.lines[phis:phis] = [
            f"  {rounds} = phi i32 [ 0, %{before} ], [ {following}, %{again} ]",
            *(
                f"  {argument.name} = phi {argument.type} [ {self.text(initial)}, %{before} ], "
                f"[ {self.text(update)}, %{again} ]"
                for argument, initial, update in zip(loop.arguments, loop.initial, loop.updates, strict=True)
                if argument.type != ARRAY
            ),
        ]
        self.start(done)
        for argument, result in zip(loop.arguments, loop.results, strict=True):
            result.name = argument.name

    def branch(self, branch: Branch, mask: str) -> None:
        """A branch: the case that the lane takes; short ones are computed all, and one is chosen."""
        conditions = [self.taken(branch, i) for i in range(len(branch.regions))]
        if all(is_short(case) and not any(_writes(step) for step in case.steps) for case in branch.regions):
            for case in branch.regions:
                self.region(case, mask)
            self.chosen(branch, conditions, [list(map(self.text, outputs)) for outputs in branch.outputs])
            return
        merge = self.new("merge")
        ends: list[tuple[str, list[str]]] = []
        last = len(branch.regions) - 1
        for i, (case, outputs) in enumerate(zip(branch.regions, branch.outputs, strict=True)):
            inside, other = self.new("case"), self.new("other")
            self.do(f"br i1 {conditions[i]}, label %{inside}, label %{other}" if i < last else f"br label %{inside}")
            self.start(inside)
            self.region(case, mask)
            ends.append((self.label, list(map(self.text, outputs))))
            self.do(f"br label %{merge}")
            if i < last:
                self.start(other)
        self.start(merge)
        for i, result in enumerate(branch.results):
            result.name = self.get(
                f"phi {result.type} " + ", ".join(f"[ {values[i]}, %{end} ]" for end, values in ends)
            )


def _writes(step: Step) -> bool:
    return isinstance(step, GraphValue) and step.op in ("store", tapes.WRITE)
