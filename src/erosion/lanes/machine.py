"""Machine code from LLVM's intermediate representation."""

import contextlib
import ctypes
import functools
import gc
import re
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm

from erosion.lanes.writer import ENTRY

LLVMLITE = (0, 45), (0, 51)
"""The first version of llvmlite that works, and the first that is not known to; the same as in `pyproject.toml`."""


def require_llvmlite(version: str) -> None:
    """Refuse an llvmlite whose LLVM reads another text than `vector_ir` writes: it would end the process, unheard.

    Raises:
        ImportError: one sentence that says what to install.
    """
    numbers = re.match(r"(\d+)\.(\d+)", version)
    if numbers is None or not LLVMLITE[0] <= tuple(map(int, numbers.groups())) < LLVMLITE[1]:
        least, beyond = (".".join(map(str, bound)) for bound in LLVMLITE)
        raise ImportError(
            f"erosion needs llvmlite {least} or newer, below {beyond}, but llvmlite {version} is installed: "
            f"pip install 'llvmlite>={least},<{beyond}'; a numba beside it must fit too.",
            name="llvmlite",
        )


require_llvmlite(llvmlite.__version__)

# LLVM's code generator at its level 0 takes a third of the time of level 1, and makes code that takes 1.3 to 2 times
# as long. More than level 1 gains nothing, and no pass before it does.
_QUICK, _CAREFUL = 0, 1

# Seconds of processor time that careful code costs for each character of its module. Quick code that has run for as
# long is replaced: so it never costs much more than the better of the two.
_COST = 1.5e-6

# Characters of a module that is never compiled quickly: quick code keeps much on the stack, 10 kB for each 10⁵.
_LONG = 5_000_000


class Processor(NamedTuple):
    """A processor: LLVM's name for it, and its features."""

    cpu: str
    features: str


class ObjectCode(NamedTuple):
    """An object file, and the level of LLVM's code generator that made it."""

    level: int
    content: bytes


class MachineCode:
    """A module's function: compiled quickly at first, and with care once it has run for long.

    Both codes give the same bits.

    Args:
        text: of the module.
        target: the processor; without it, this machine's.
        made: the code, if it was compiled before.

    Attributes:
        text: of the module, as long as its code is quick; then empty.
        keep: is called with careful code that takes the place of quick code.
    """

    def __init__(
        self,
        text: str,
        target: Processor | None = None,
        made: ObjectCode | None = None,
    ) -> None:
        self._target = target
        self.keep: Callable[[ObjectCode], object] | None = None
        self._cost, self._spent = _COST * len(text), 0.0
        self._replacing = threading.Lock()
        self._code = _Compiled(made or compiled(text, target, _QUICK if len(text) <= _LONG else _CAREFUL), target)
        self.text = text if self.made.level == _QUICK else ""

    @property
    def made(self) -> ObjectCode:
        """The code that runs now."""
        return self._code.made

    def run(self, inputs: int, varying: int, count: int, order: int, lanes: int, outputs: int, stop: int) -> None:
        """Call the function, with its arguments (see `vector_ir`)."""
        # Other threads go on with the quick code meanwhile.
        if self._spent > self._cost and self.made.level == _QUICK and self._replacing.acquire(blocking=False):
            try:
                if self.made.level == _QUICK:
                    self._code, self.text = _Compiled(compiled(self.text, self._target, _CAREFUL), self._target), ""
                    if self.keep is not None:
                        self.keep(self.made)
            finally:
                self._replacing.release()
        code, begin = self._code, time.thread_time()  # replaced code is kept until it has run
        code.run(inputs, varying, count, order, lanes, outputs, stop)
        self._spent += time.thread_time() - begin


def compiled(text: str, target: Processor | None, level: int) -> ObjectCode:
    """The object file of a module."""
    machine = _machine(target, level)
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    return ObjectCode(level, machine.emit_object(module))


def _machine(target: Processor | None, level: int) -> llvm.TargetMachine:
    cpu, features = this_machine() if target is None else target
    return _triple().create_target_machine(cpu=cpu, features=features, opt=level, jit=True)


class _Compiled:
    """A module's function, in memory."""

    def __init__(self, made: ObjectCode, target: Processor | None) -> None:
        self.made = made
        # MCJIT needs a module to start from, so it gets an empty one; the code is added as an object file.
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine(target, made.level))
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(made.content))
        self._engine.finalize_object()
        address, whole = ctypes.c_void_p, ctypes.c_int64
        signature = ctypes.CFUNCTYPE(None, address, address, whole, address, whole, address, address)
        self.run: Callable[..., None] = signature(self._engine.get_function_address(ENTRY))


@functools.cache
def this_machine() -> Processor:
    """The processor that this runs on."""
    features = llvm.get_host_cpu_features()
    # LLVM avoids the widest vectors, because they slowed the clock of older processors. Here all work is in vectors.
    features["prefer-256-bit"] = False
    return Processor(llvm.get_host_cpu_name(), features.flatten())


@functools.cache
def _triple() -> llvm.Target:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


@contextlib.contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Switch Python's search for garbage off: compiling makes many objects, and the search doubles its time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
