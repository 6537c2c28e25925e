"""Machine code from LLVM's intermediate representation."""

import contextlib
import ctypes
import functools
import gc
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from erosion.lanes.vector_ir import ENTRY

# Registers are given out with care; more care gains nothing, and none is slow code. No pass runs before it.
_LEVEL = 1


class Target(NamedTuple):
    """A processor: LLVM's name of it, and what it can do."""

    cpu: str
    features: str


class MachineCode:
    """A module's function, in memory.

    Args:
        text: of the module.
        target: this machine without it.
    """

    def __init__(self, text: str, target: Target | None = None) -> None:
        cpu, features = this_machine() if target is None else target
        module = llvm.parse_assembly(text)
        machine = _triple().create_target_machine(cpu=cpu, features=features, opt=_LEVEL, jit=True)
        module.triple, module.data_layout = machine.triple, str(machine.target_data)
        # MCJIT takes a module for what the functions' names are of; the code itself is an object.
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(machine.emit_object(module)))
        self._engine.finalize_object()
        address, whole = ctypes.c_void_p, ctypes.c_int64
        # Called through ctypes, which lets go of Python's lock.
        signature = ctypes.CFUNCTYPE(None, address, address, whole, address, whole, whole, address)
        self.run: Callable[..., None] = signature(self._engine.get_function_address(ENTRY))


@functools.cache
def this_machine() -> Target:
    """The processor that this runs on."""
    features = llvm.get_host_cpu_features()
    # LLVM avoids its widest vectors where they once slowed the clock; here they are the work itself.
    features["prefer-256-bit"] = False
    return Target(llvm.get_host_cpu_name(), features.flatten())


@functools.cache
def _triple() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


@contextlib.contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Compiling makes very many objects, none of them garbage: to look for it takes as long as the rest."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
