"""Lanes by a GPU of NVIDIA: a thread for each lane, to the same bits as on the processor.

LLVM, which llvmlite brings, writes the kernel as PTX; the driver assembles it for the GPU at hand. `GpuLanes` copies
numbers and starts kernels in portions: while the GPU computes one, the next is copied.
"""

import contextlib
import ctypes
import functools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from jaxtyping import PyTree

from erosion.lanes.flatten import WHOLE, flatten_whole
from erosion.lanes.graph import Graph, TooLongError
from erosion.lanes.lanewise import Lanewise
from erosion.lanes.machine import without_garbage_collection
from erosion.lanes.tapes import WRITE
from erosion.lanes.thread_ir import FIELD, GPU, KernelTarget, own_rows, thread_ir
from erosion.lanes.writer import ENTRY, tapes_with

_CPU, _PTX = "sm_70", "+ptx70"  # the driver assembles it for any newer GPU, to the same bits
_LEVEL = 0  # of LLVM's code generator: the driver's compiler does the work

FEW = 2**13
"""Lanes: 16 cores compute fewer as fast."""

_LONGEST = 25_000  # lines of a kernel: the driver takes 10 s for as many, and minutes for the largest programs
_BLOCK = 128  # threads that start together; of 64, 128 and 256 none was better by more than 10 % in all programs
_PORTION = 2**17  # lanes at once: several for each thread of the largest GPU
_MEMORY = 2**26  # bytes of a portion at most, unless `_LEAST` lanes need more
_LEAST = 256
_PORTIONS = 2  # under way at once
_PAUSE = 5e-5  # seconds between two looks whether a portion is done; a signal's handler runs meanwhile
_LINE = 256  # bytes: the alignment of an array in the GPU's memory


class NoGpuError(RuntimeError):
    """There is no GPU that can compute lanes; the sentence names what is missing."""


def ptx(text: str) -> str:
    """A module as PTX.

    Raises:
        NoGpuError: where this LLVM cannot write it.
    """
    machine = _machine()
    module = llvm.parse_assembly(text)
    module.data_layout = str(machine.target_data)
    # SROA keeps in a register whether a thread is stopped.
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options())
    passes = llvm.create_new_module_pass_manager()
    passes.add_sroa_pass()
    passes.run(module, builder)
    return machine.emit_assembly(module)


@functools.cache
def _machine() -> llvm.TargetMachine:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        target = llvm.Target.from_triple("nvptx64-nvidia-cuda")
    except RuntimeError:
        raise NoGpuError("This llvmlite was built without NVPTX, which writes code for GPUs.") from None
    return target.create_target_machine(cpu=_CPU, features=_PTX, opt=_LEVEL)


class Program(NamedTuple):
    """A kernel.

    Args:
        function: of the driver.
        threads: that the GPU holds at once.
        rows: numbers of each thread in the GPU's memory.
        written: tapes that it writes.
    """

    function: Any
    threads: int
    rows: int
    written: set[int]


class Gpu:
    """The first GPU of this machine, in the context that other libraries of the process share.

    Args:
        driver: of NVIDIA, as `cuda.bindings` has it; for tests another.
        target, translate: of kernels, and from their text to the code that the driver loads; for tests.

    Raises:
        NoGpuError: where there is no GPU, no driver, or no bindings of the driver.
    """

    def __init__(self, driver: Any = None, target: KernelTarget = GPU, translate: Callable[[str], str] = ptx) -> None:
        if driver is None:
            try:
                from cuda.bindings import driver  # pyrefly: ignore
            except ImportError:
                raise NoGpuError("A GPU needs NVIDIA's bindings: pip install 'particle-erosion[gpu]'.") from None
        self.driver, self._target, self._translate = driver, target, translate
        self._lock, self._idle = threading.Lock(), list["_Stream"]()
        try:
            self.call("cuInit", 0)
            count = self.call("cuDeviceGetCount")
        except (NoGpuError, RuntimeError) as error:
            raise NoGpuError(f"There is no GPU of NVIDIA, or no driver for it: {error}") from None
        if not count:
            raise NoGpuError("The driver of NVIDIA knows no GPU.")
        device = self.call("cuDeviceGet", 0)
        self._context = self.call("cuDevicePrimaryCtxRetain", device)
        attribute = driver.CUdevice_attribute.CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT
        self._processors = self.call("cuDeviceGetAttribute", attribute, device)

    def call(self, name: str, *arguments: Any) -> Any:
        """The results of a function of the driver.

        Raises:
            NoGpuError: with the driver's name of the failure.
        """
        status, *results = getattr(self.driver, name)(*arguments)
        if status.name == "CUDA_ERROR_OUT_OF_MEMORY":
            raise NoGpuError("The GPU has too little free memory.")
        if status.name != "CUDA_SUCCESS":
            raise NoGpuError(f"The GPU failed: {name} returned {status.name}.")
        return results[0] if len(results) == 1 else results

    def enter(self) -> None:
        """Make its context this thread's."""
        self.call("cuCtxSetCurrent", self._context)

    def program(self, graph: Graph, of_tapes: int) -> Program | None:
        """The kernel of a graph; None where the driver would take too long for it."""
        text = thread_ir(graph, of_tapes, self._target)
        if text.count("\n") > _LONGEST:
            return None
        module = self.call("cuModuleLoadData", self._translate(text).encode() + b"\0")
        function = self.call("cuModuleGetFunction", module, ENTRY.encode())
        blocks = self.call("cuOccupancyMaxActiveBlocksPerMultiprocessor", function, _BLOCK, 0)
        return Program(function, blocks * _BLOCK * self._processors, own_rows(graph), tapes_with(WRITE, graph))

    @contextlib.contextmanager
    def streams(self, count: int) -> Iterator[list["_Stream"]]:
        """Streams for one call. A kernel that still runs at its end is stopped."""
        with self._lock:
            streams, self._idle = self._idle[:count], self._idle[count:]
        try:
            while len(streams) < count:
                streams.append(_Stream(self))
            yield streams
        finally:
            for stream in streams:
                stream.stop[0] = 1
            while not all(stream.is_done for stream in streams):
                time.sleep(_PAUSE)
            for stream in streams:
                stream.stop[0] = 0
            with self._lock:
                self._idle += streams


@functools.cache
def this_gpu() -> Gpu:
    """The first GPU of this machine."""
    return Gpu()


class _Stream:
    """Memory on both sides, and copies and kernels that run one after another.

    `host` is memory here that the GPU reaches, `at` the address of as much memory there. Kernels end where `stop` is
    not 0.
    """

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self._handle = gpu.call("cuStreamCreate", gpu.driver.CUstream_flags.CU_STREAM_NON_BLOCKING.value)
        self.host, self.at, self._room, self._room_size = np.empty(0, np.uint8), 0, 0, 0
        self.stop = self._pinned(8).view(np.int64)
        self.stop[0] = 0

    def _pinned(self, size: int) -> np.ndarray:
        address = int(self._gpu.call("cuMemAllocHost", size))
        return np.ctypeslib.as_array((ctypes.c_uint8 * size).from_address(address))

    def reserve(self, size: int) -> None:
        """Have so many bytes on both sides."""
        if size <= self.host.size:
            return
        if self.host.size:
            old, self.host = self.host.ctypes.data, np.empty(0, np.uint8)
            self._gpu.call("cuMemFreeHost", old)
            self._gpu.call("cuMemFree", self.at)
        size += size // 4
        self.at = int(self._gpu.call("cuMemAlloc", size))
        self.host = self._pinned(size)

    def room(self, size: int) -> int:
        """Memory on the GPU alone."""
        if size > self._room_size:
            if self._room_size:
                self._room_size = 0
                self._gpu.call("cuMemFree", self._room)
            self._room = int(self._gpu.call("cuMemAlloc", size))
            self._room_size = size
        return self._room

    def part(self, begin: int, dtype: np.dtype, shape: Sequence[int]) -> np.ndarray:
        """An array in `host`."""
        size = math.prod(shape) * dtype.itemsize
        return self.host[begin : begin + size].view(dtype).reshape(shape)

    def send(self, end: int) -> None:
        """Copy the first bytes to the GPU."""
        self._gpu.call("cuMemcpyHtoDAsync", self.at, self.host.ctypes.data, end, self._handle)

    def start(self, program: Program, threads: int, arguments: Sequence[int]) -> None:
        """Run a kernel; the last argument is the address of `stop`."""
        values = (*arguments, self.stop.ctypes.data)
        numbers = values, (ctypes.c_int64,) * len(values)
        shape = threads // _BLOCK, 1, 1, _BLOCK, 1, 1
        self._gpu.call("cuLaunchKernel", program.function, *shape, 0, self._handle, numbers, 0)

    def fetch(self, begin: int, end: int) -> None:
        """Copy bytes from the GPU."""
        here, there = self.host.ctypes.data + begin, self.at + begin
        self._gpu.call("cuMemcpyDtoHAsync", here, there, end - begin, self._handle)

    @property
    def is_done(self) -> bool:
        """Whether all of it is done."""
        (status,) = self._gpu.driver.cuStreamQuery(self._handle)
        if status.name not in ("CUDA_SUCCESS", "CUDA_ERROR_NOT_READY"):
            raise NoGpuError(f"The GPU failed while it computed: {status.name}.")
        return status.name == "CUDA_SUCCESS"


class GpuLanes(Lanewise):
    """A function of one lane's numbers, compiled for a GPU; the processor computes few lanes, and long programs.

    Args:
        function, examples, tapes: as of `Lanewise`.
        gpu: that computes; this machine's.
        few: lanes below which the processor computes.

    Raises:
        NoGpuError: where there is no GPU.
    """

    def __init__(
        self,
        function: Callable[..., PyTree],
        examples: Sequence[PyTree],
        *,
        tapes: int = 0,
        gpu: Gpu | None = None,
        few: int = FEW,
    ) -> None:
        self._gpu, self._few, self._of_tapes = gpu or this_gpu(), few, tapes
        super().__init__(function, examples, tapes=tapes)
        self._programs: dict[bool, Program | None] = {}
        self._compiling = threading.Lock()

    def run(
        self,
        leaves: Sequence[np.ndarray],
        order: np.ndarray,
        results: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
        tapes: Sequence[np.ndarray] = (),
    ) -> None:
        """Compute some lanes, in an order, and write their results; see `Lanewise.run`.

        A signal's handler may run between two looks at the GPU; where it raises, the kernels stop.
        """
        program = self._program(shared=self.sharing(leaves)[1]) if len(order) >= max(self._few, 1) else None
        if program is None:
            super().run(leaves, order, results, stop, tapes)
            return
        call = _Call(self, program, leaves, results, tapes, stop)
        length = call.portion
        begun: deque[_Begun] = deque()
        with self._gpu.streams(min(_PORTIONS, -(-len(order) // length))) as streams:
            free = list(streams)
            for begin in range(0, len(order), length):
                if not free:
                    free.append(call.finish(begun.popleft()))
                if not call.is_wanted:
                    return
                begun.append(call.begin(free.pop(), np.asarray(order[begin : begin + length], np.int64)))
            while begun:
                call.finish(begun.popleft())

    def _program(self, *, shared: bool) -> Program | None:
        self._gpu.enter()
        with self._compiling, without_garbage_collection():
            if shared not in self._programs:
                try:
                    graph = flatten_whole(self.closed, shared=shared, most=WHOLE)
                    self._programs[shared] = self._gpu.program(graph, self._of_tapes)
                except TooLongError:
                    self._programs[shared] = None
            return self._programs[shared]


class _Begun(NamedTuple):
    """Lanes that are being computed: an index of arrays, and the parts of the stream that are written back."""

    stream: _Stream
    lanes: Any
    fetched: list[tuple[np.ndarray, np.ndarray]]


class _Call:
    """One call of a program: what its portions have in common."""

    def __init__(
        self,
        lanewise: GpuLanes,
        program: Program,
        leaves: Sequence[np.ndarray],
        results: Sequence[np.ndarray],
        tapes: Sequence[np.ndarray],
        stop: np.ndarray | None,
    ) -> None:
        self._program, self._results, self._stop = program, results, stop
        self._tapes = [tape.reshape(len(tape), -1) for tape in tapes]
        together, is_shared = lanewise.sharing(leaves)
        numbers: list[np.ndarray] = []
        self._given: list[np.ndarray | None] = []  # of one row where all lanes share it; None where it is in `_numbers`
        self._sizes: list[int] = []
        for leaf, shape, same, large in zip(leaves, lanewise.inputs, together, lanewise.large, strict=True):
            one = leaf if leaf.ndim == len(shape) else leaf[0]
            self._sizes.append(one.size)
            if large and is_shared:
                numbers.append(one.ravel())
            self._given.append(None if large and is_shared else one[None] if same else leaf)
        self._numbers = np.concatenate([*numbers, np.zeros(1)])
        of_lanes = [given for given in self._given if given is not None and len(given) > 1]
        size = sum(array[:1].nbytes for array in (*of_lanes, *results, *tapes))
        self.portion = int(max(min(_PORTION, _MEMORY // max(size, 1)), _LEAST))
        """Lanes that are computed at once."""

    @property
    def is_wanted(self) -> bool:
        """Whether the results are still wanted."""
        return self._stop is None or not self._stop[0]

    def begin(self, stream: _Stream, order: np.ndarray) -> _Begun:
        """Start to compute some lanes."""
        first, count = int(order.min()), len(order)
        is_row = int(order.max()) - first + 1 == count  # then they are copied as they are
        lanes: Any = slice(first, first + count) if is_row else order
        places = (order - first if is_row else np.arange(count)).astype(np.int32)
        size = _LINE  # the count of lanes that are taken is first

        def room_for(nbytes: int) -> int:
            nonlocal size
            begin, size = size, size + _aligned(nbytes)
            return begin

        # Of each argument, output and tape: the place of the first number, bytes to the next lane and number, how many.
        fields: list[tuple[int, int, int, int]] = []
        outputs = sum(result[0].size for result in self._results)
        fields_at = room_for(8 * FIELD * (sum(self._sizes) + outputs + 2 * len(self._tapes)))
        sent: list[tuple[np.ndarray, int]] = [
            (self._numbers, room_for(self._numbers.nbytes)),
            (places, room_for(places.nbytes)),
        ]
        for given, length in zip(self._given, self._sizes, strict=True):
            at = 0
            if given is not None:
                part = given if len(given) == 1 else given[lanes]
                at = room_for(part.nbytes)
                sent.append((part, at))
            fields.append((at, 0 if given is None or len(given) == 1 else 8 * length, 8, length))
        # Neighbours' numbers of a tape are side by side, so that the threads of a warp write them together.
        tapes_at = [room_for(8 * tape.shape[1] * count) for tape in self._tapes]
        sent += [(tape[lanes].T, at) for tape, at in zip(self._tapes, tapes_at, strict=True)]
        until = size
        results_at = [room_for(result[0].nbytes * count) for result in self._results]
        for result, at in zip(self._results, results_at, strict=True):
            fields.append((at, result.itemsize * result[0].size, result.itemsize, result[0].size))
        stream.reserve(size)
        rows = [
            np.stack([stream.at + at + step * np.arange(length), np.full(length, stride)], axis=1)
            for at, stride, step, length in fields
        ]
        rows += [np.array([[stream.at + at, 8], [8 * count, 0]]) for at in tapes_at]
        sent.append((np.concatenate(rows), fields_at))
        stream.host[:_LINE] = 0
        for part, at in sent:
            stream.part(at, part.dtype, part.shape)[...] = part
        stream.send(until)
        threads = min(self._program.threads, _aligned(count, _BLOCK))
        room, (numbers_at, places_at) = stream.room(8 * self._program.rows * threads), (at for _, at in sent[:2])
        here = stream.at
        stream.start(self._program, threads, (here + fields_at, here + places_at, count, here + numbers_at, room, here))
        fetched: list[tuple[np.ndarray, np.ndarray]] = []
        for i in self._program.written:
            tape, at = self._tapes[i], tapes_at[i]
            stream.fetch(at, at + 8 * tape.shape[1] * count)
            fetched.append((tape, stream.part(at, tape.dtype, (tape.shape[1], count)).T))
        stream.fetch(until, size)
        for result, at in zip(self._results, results_at, strict=True):
            fetched.append((result, stream.part(at, result.dtype, (count, *result.shape[1:]))))
        return _Begun(stream, lanes, fetched)

    def finish(self, begun: _Begun) -> _Stream:
        """Wait for lanes, and write their results, unless they are wanted no more."""
        while self.is_wanted and not begun.stream.is_done:
            time.sleep(_PAUSE)
        if self.is_wanted:
            for array, part in begun.fetched:
                array[begun.lanes] = part
        return begun.stream


def _aligned(size: int, line: int = _LINE) -> int:
    return -(-size // line) * line
