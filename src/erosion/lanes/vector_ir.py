"""A graph as LLVM's intermediate representation, on vectors of lanes.

Where lanes take different ways, a mask says which of them are active. A loop runs until its last lane is done, and
a case of a branch runs if any lane takes it; lanes that are not active keep their values. There is no fast-math and
no pass over the result, so its bits depend on the graph alone.

The code counts the rounds of its loops, and after many of them it looks at a word in memory that may stop it.
"""

from erosion.lanes import tapes
from erosion.lanes.graph import ARRAY, BOOL, NUMBERS, Branch, Call, Function, Graph, GraphValue, Loop, Region, Step
from erosion.lanes.writer import BITS, ENTRY, Writer, is_short

_ALL = "splat (i1 true)"
_ROUNDS = 2**14  # some hundredths of a second


STOPPED = 2
"""The word that stops the code, once it has stopped."""


def vector_ir(graph: Graph, width: int, of_tapes: int = 0) -> str:
    """The text of a module with one function, and those that it calls.

        void run(double* inputs, Varying* varying, i64 count, i64* order, i64 lanes, Place* outputs, i64* stop)

    For each group of `width` lanes order[:lanes] it copies the lanes' numbers into `inputs`, computes, and
    writes the results. `inputs` is an array (rows, width), which holds what all lanes share in the first `places`
    rows, and after them what the graph keeps in memory; large arrays that all lanes share follow, one number after
    another. `varying` says
    for `count` places where a lane's number is found: an address, the bytes from lane to lane, the place.
    `outputs` has for each output, and then for each tape, an address, and the bytes from lane to lane. A group that is
    not full repeats its last lane, which writes the same. Truths are written as bytes. Where it
    finds that *stop is not 0, it ends early, and writes `STOPPED` there.

    Args:
        graph: finished.
        width: lanes of a vector.
        of_tapes: how many tapes there are.
    """
    return _VectorWriter(graph, width, of_tapes).module()


class _VectorWriter(Writer):
    def __init__(self, graph: Graph, width: int, of_tapes: int) -> None:
        super().__init__(graph, of_tapes)
        self.width = width
        self.tapes: list[str] = []  # of each, where those of the lanes begin
        self.shared: set[str] = set()  # tables that all lanes share

    def of(self, type_: str) -> str:
        """A vector of lanes of this type."""
        return f"<{self.width} x {type_}>"

    def kind(self, type_: str) -> str:
        """A vector of this type in the name of an intrinsic function."""
        return f"v{self.width}{'f' if type_ in ('double', 'float') else 'i'}{BITS[type_]}"

    def constant(self, type_: str, number: str) -> str:
        """A vector of one number that is known."""
        return f"splat ({type_} {number})"

    def splat(self, scalar: str, type_: str = "i64") -> str:
        """A vector of one number."""
        vector = self.of(type_)
        first = self.get(f"insertelement {vector} poison, {type_} {scalar}, i64 0")
        return self.get(f"shufflevector {vector} {first}, {vector} poison, <{self.width} x i32> zeroinitializer")

    # The function around the lanes.

    def module(self) -> str:
        """The whole text."""
        longs, all_lanes = self.of("i64"), _ALL
        functions = [self.function(function) for function in self.graph.functions]
        self.lines, self.memory = [], []
        self.start("entry")
        self.do("store i64 0, ptr %rounds")
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
        self.do("ret void")
        self.start("stopped")
        self.do(f"store volatile i64 {STOPPED}, ptr %stop")
        self.do("ret void")
        parameters = (
            "ptr noalias align 64 %inputs, ptr noalias %varying, i64 %count, ptr noalias %order, i64 %lanes, "
            "ptr noalias %outputs, ptr %stop"
        )
        return "\n".join([
            *self.declared.values(),
            *self.tables,
            *functions,
            # Vectors that do not fit the registers go onto the stack, where they must not straddle cache lines.
            f'define void @{ENTRY}({parameters}) nounwind "stackrealign" {{',
            self.lines[0],
            "  %rounds = alloca i64",
            *self.memory,
            *self.lines[1:],
            "}",
        ])  # fmt: skip

    # Functions. Their arguments and results are in memory, and so is what they read of the lane's other numbers.

    def function(self, function: Function) -> str:
        """The text of a function; it gives whether the code is to stop."""
        self.lines, self.memory, self.tapes = [], [], [f"%tape{i}" for i in range(self.of_tapes)]
        self.start("entry")
        for value in function.reads:
            self.read(value)
        for row, argument in enumerate(function.arguments, function.room):
            self.load(argument, row)
        self.region(function.body, "%mask")
        for row, output in enumerate(function.outputs, function.room + len(function.arguments)):
            self.keep(output, row)
        self.do("ret i1 false")
        self.start("stopped")
        self.do("ret i1 true")
        tapes, self.tapes = self.tapes, []
        parameters = ["ptr align 64 %inputs", "ptr %rounds", "ptr %stop", f"{self.of(BOOL)} %mask"]
        parameters += [f"{self.of('ptr')} {tape}" for tape in tapes]
        return "\n".join([
            f'define internal i1 @{self.name_of(function)}({", ".join(parameters)}) nounwind "stackrealign" {{',
            self.lines[0],
            *self.memory,
            *self.lines[1:],
            "}",
        ])  # fmt: skip

    def name_of(self, function: Function) -> str:
        """Its name in the module."""
        return f"function{function.room}"

    def call_function(self, call: Call, mask: str) -> None:
        """A call, between what is written into the function's memory and read from there."""
        function = call.function
        for row, value in enumerate(call.inputs, function.room):
            self.keep(value, row)
        operands = ["ptr %inputs", "ptr %rounds", "ptr %stop", f"{self.of(BOOL)} {mask}"]
        operands += [f"{self.of('ptr')} {tape}" for tape in self.tapes]
        stops = self.get(f"call i1 @{self.name_of(function)}({', '.join(operands)})")
        if _may_stop(function.body):
            called = self.new("called")
            self.do(f"br i1 {stops}, label %stopped, label %{called}")
            self.start(called)
        for row, result in enumerate(call.results, function.room + len(function.arguments)):
            self.load(result, row)

    def step(self, step: Step, mask: str) -> None:
        """A step of a region; what functions read of it goes to memory as well."""
        if isinstance(step, Call):
            self.call_function(step, mask)
        else:
            super().step(step, mask)
        if self.graph.kept:
            for value in (step,) if isinstance(step, GraphValue) else step.results:
                if value in self.graph.kept:
                    self.keep(value, self.graph.kept[value])

    def read(self, value: GraphValue) -> None:
        """A number of the outermost region, within a function."""
        if value in self.graph.kept:
            self.load(value, self.graph.kept[value])
        elif isinstance(value.extra, Loop):
            # An array is changed where it is.
            value.name = self.text(value.extra.initial[value.extra.results.index(value)])
        else:
            super().step(value, _ALL)

    def row(self, number: int) -> str:
        """The address of a row of memory."""
        return self.get(f"getelementptr {self.of('double')}, ptr %inputs, i64 {number}")

    def keep(self, value: GraphValue, row: int) -> None:
        """Write a number of each lane into a row."""
        type_, name = self.stored(value)
        self.do(f"store {self.of(type_)} {name}, ptr {self.row(row)}")

    def load(self, value: GraphValue, row: int) -> None:
        """Read it."""
        type_ = "i8" if value.type == BOOL else value.type
        value.name = self.get(f"load {self.of(type_)}, ptr {self.row(row)}")
        if value.type == BOOL:
            value.name = self.get(f"trunc {self.of(type_)} {value.name} to {self.of(BOOL)}")

    def place_of_output(self, number: str) -> tuple[str, str]:
        """The address of an output, and the bytes from lane to lane as a vector."""
        row = self.get(f"mul i64 {number}, 2")
        address = self.get(f"getelementptr i64, ptr %outputs, i64 {row}")
        step = self.get(f"getelementptr i64, ptr %outputs, i64 {self.get(f'add i64 {row}, 1')}")
        return self.get(f"load ptr, ptr {address}"), self.splat(self.get(f"load i64, ptr {step}"))

    def write(self, type_: str, name: str, address: str, stride: str, lane: str) -> None:
        """Write a number of each lane into an output."""
        longs = self.of("i64")
        to = self.get(f"getelementptr i8, ptr {address}, {longs} {self.get(f'mul {longs} {lane}, {stride}')}")
        self.scatter(type_, name, to, _ALL)

    def scatter(self, type_: str, numbers: str, addresses: str, active: str) -> None:
        """Write the numbers of active lanes to addresses."""
        name = f"llvm.masked.scatter.{self.kind(type_)}.v{self.width}p0"
        places, size = (self.of("ptr"), addresses), ("i32", str(BITS[type_] // 8))
        self.do(self.call(name, "void", (self.of(type_), numbers), places, size, (self.of(BOOL), active)))

    def on_tape(self, value: GraphValue, mask: str) -> None:
        """Numbers of the lane's own memory; see `erosion.lanes.tapes`."""
        token, place, *numbers = map(self.text, value.inputs)
        pointers, longs, tape = self.of("ptr"), self.of("i64"), self.tapes[value.extra]
        if value.inputs[1].type != "i64":
            place = self.get(f"sext {self.of(value.inputs[1].type)} {place} to {longs}")
        at = self.get(f"getelementptr double, {pointers} {tape}, {longs} {place}")
        if value.op == tapes.READ:
            value.name = self.gather("double", at)
            return
        for i, number in enumerate(numbers):
            self.scatter(
                "double", number, self.get(f"getelementptr double, {pointers} {at}, {longs} splat (i64 {i})"), mask
            )
        value.name = token

    def write_array(self, array: GraphValue, first: str, lane: str) -> None:
        """Write the numbers of an array into outputs, the first of which is given."""
        with self.counting(array.extra) as index:
            place = self.place_of_output(self.get(f"add i64 {index}, {first}"))
            row = self.get(f"getelementptr {self.of('double')}, ptr {self.text(array.inputs[0])}, i64 {index}")
            self.write("double", self.get(f"load {self.of('double')}, ptr {row}"), *place, lane)

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
            (address, stride, place), longs = fields, self.of("i64")
            from_ = self.get(
                f"getelementptr i8, ptr {address}, {longs} {self.get(f'mul {longs} {lane}, {self.splat(stride)}')}"
            )
            numbers = self.gather("double", from_)
            to = self.get(f"getelementptr {self.of('double')}, ptr %inputs, i64 {place}")
            self.do(f"store {self.of('double')} {numbers}, ptr {to}")
        self.do("br label %compute")
        self.start("compute")

    def gather(self, type_: str, addresses: str) -> str:
        """Numbers from memory, each lane's from its own address."""
        vector, pointers, mask = self.of(type_), self.of("ptr"), self.of(BOOL)
        # The alignment as an argument is the form of LLVM 20, which LLVM 22 reads too; LLVM 20 ends the process at the
        # newer form.
        size = str(max(BITS[type_] // 8, 1))
        operands = (pointers, addresses), ("i32", size), (mask, _ALL), (vector, "poison")
        return self.get(self.call(f"llvm.masked.gather.{self.kind(type_)}.v{self.width}p0", vector, *operands))

    # Memory.

    def input(self, place: int) -> str:
        """The argument of each lane, which is in `inputs`."""
        address = self.get(f"getelementptr {self.of('double')}, ptr %inputs, i64 {place}")
        return self.get(f"load {self.of('double')}, ptr {address}")

    def room(self, first: int, type_: str) -> str:
        """A place in `inputs`, or behind them."""
        place = first * self.width if type_ != NUMBERS else first + self.graph.rows * self.width
        return self.get(f"getelementptr double, ptr %inputs, i64 {place}")

    def element(self, array: GraphValue, place: str) -> str:
        """A number of each lane, or one that all share."""
        if array.type == NUMBERS:
            address = self.get(f"getelementptr double, ptr {self.text(array)}, i64 {place}")
            return self.splat(self.get(f"load double, ptr {address}"), "double")
        address = self.get(f"getelementptr {self.of('double')}, ptr {self.text(array)}, i64 {place}")
        return self.get(f"load {self.of('double')}, ptr {address}")

    def store(self, array: str, place: str, number: str, mask: str) -> None:
        """Write a row of numbers."""
        row = self.of("double")
        address = self.get(f"getelementptr {row}, ptr {array}, i64 {place}")
        if mask not in ("", _ALL):
            # Volatile, or LLVM makes it a masked store, which takes ten times as long on some processors.
            old = self.get(f"load volatile {row}, ptr {address}")
            number = self.get(f"select {self.of(BOOL)} {mask}, {row} {number}, {row} {old}")
        self.do(f"store {row} {number}, ptr {address}")

    def table_of_constants(self, type_: str, numbers: list[str]) -> str:
        """An array of the module."""
        name = f"@{self.new('table')}"
        elements = ", ".join(f"{type_} {number}" for number in numbers)
        self.tables.append(f"{name} = private constant [{len(numbers)} x {type_}] [{elements}]")
        return name

    def table_of_inputs(self, type_: str, first: int) -> str:
        """Rows of `inputs`."""
        return self.get(f"getelementptr {self.of(type_)}, ptr %inputs, i64 {first}")

    def table_of_rows(self, type_: str, array: GraphValue, first: int) -> str:
        """Rows of `inputs`, or numbers behind them."""
        kind = type_ if array.type == NUMBERS else self.of(type_)
        name = self.get(f"getelementptr {kind}, ptr {self.text(array)}, i64 {first}")
        if array.type == NUMBERS:
            self.shared.add(name)
        return name

    def table_of_values(self, type_: str, names: list[str]) -> str:
        """Rows on the stack."""
        vector, table = self.of(type_), f"%{self.new('memory')}"
        self.memory.append(f"  {table} = alloca [{len(names)} x {vector}], align 64")
        for i, name in enumerate(names):
            self.do(f"store {vector} {name}, ptr {self.get(f'getelementptr {vector}, ptr {table}, i64 {i}')}")
        return table

    def look_up(self, type_: str, table: str, index: str) -> str:
        """Of a table of rows each lane has its own column."""
        longs = self.of("i64")
        if not table.startswith("@") and table not in self.shared:
            lanes = ", ".join(f"i64 {i}" for i in range(self.width))
            row = self.get(f"mul {longs} {index}, splat (i64 {self.width})")
            index = self.get(f"add {longs} {row}, <{lanes}>")
        return self.gather(type_, self.get(f"getelementptr {type_}, ptr {table}, {longs} {index}"))

    # Control flow.

    def any_of(self, mask: str) -> str:
        """Whether any lane of a mask is active."""
        return self.get(self.call(f"llvm.vector.reduce.or.v{self.width}i1", BOOL, (self.of(BOOL), mask)))

    def both(self, mask: str, other: str) -> str:
        """The lanes of two masks."""
        return other if mask == _ALL else self.get(f"and {self.of(BOOL)} {mask}, {other}")

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
            type_ = self.of(argument.type)
            updates.append(
                self.get(f"select {self.of(BOOL)} {active}, {type_} {self.text(update)}, {type_} {argument.name}")
            )
        # The end of a round.
        self.lines += [
            f"  %before.{again} = load i64, ptr %rounds",
            f"  %rounds.{again} = add i64 %before.{again}, 1",
            f"  store i64 %rounds.{again}, ptr %rounds",
            f"  %many.{again} = icmp ugt i64 %rounds.{again}, {_ROUNDS}",
            f"  br i1 %many.{again}, label %look.{again}, label %{again}",
            f"look.{again}:",
            "  store i64 0, ptr %rounds",
            f"  %word.{again} = load volatile i64, ptr %stop",
            f"  %stopped.{again} = icmp ne i64 %word.{again}, 0",
            f"  br i1 %stopped.{again}, label %stopped, label %{again}",
        ]
        self.start(again)
        self.do(f"br label %{head}")
        self.lines[phis:phis] = [
            f"  {argument.name} = phi {self.of(argument.type)} [ {self.text(initial)}, %{before} ], "
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
        self.chosen(branch, conditions, results)

    def case(self, case: Region, outputs: list[GraphValue], mask: str) -> list[str]:
        """One case; zeros where no lane takes it."""
        if is_short(case):
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
            self.get(f"phi {self.of(value.type)} [ {self.text(value)}, %{end} ], [ zeroinitializer, %{before} ]")
            for value in outputs
        ]


def _may_stop(region: Region) -> bool:
    """Whether a region of a function has a loop, which may stop the code."""
    return any(
        isinstance(step, Loop)
        or (isinstance(step, Call) and _may_stop(step.function.body))
        or any(map(_may_stop, step.regions))
        for step in region.steps
    )
