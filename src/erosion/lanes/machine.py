"""Machine code from LLVM's intermediate representation, kept in the user's own cache folder.

Whoever can write to that folder could have any code run. So it must be the user's own, closed to all others, and a file
counts only with the digest of its content and of what it was made from. Where any of this is not so, or nothing can
be written, code is made anew, and no one notices.
"""

import contextlib
import ctypes
import functools
import gc
import hashlib
import os
import re
import stat
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import llvmlite
import llvmlite.binding as llvm

from erosion.lanes.surroundings import PYTHONS
from erosion.lanes.vector_ir import ENTRY

_KEPT_FILES = 256  # files, of some 50 kB each
_DIGEST = 32  # bytes
_FORM = b"1"  # of the files
_OWN = re.compile(r"[0-9a-f]{64}|\.[0-9a-f]{64}\.\w+")  # a key, and while it is written


def key_of(*origins: str) -> str:
    """The name of the code that is made from these texts."""
    digest = hashlib.sha256(_FORM)
    for origin in origins:
        digest.update(hashlib.sha256(origin.encode()).digest())
    return digest.hexdigest()


def read_kept(key: str) -> bytes | None:
    """The code of that name, or None."""
    folder = _own_folder()
    if folder is None:
        return None
    try:
        # By its handle: the folder is the one that is looked at, whatever comes into its place meanwhile.
        place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            handle = os.open(key, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=place)
            with os.fdopen(handle, "rb") as file:
                status = os.fstat(handle)
                if not (_is_own(os.fstat(place)) and _is_own(status) and stat.S_ISREG(status.st_mode)):
                    return None
                content = file.read()
                with contextlib.suppress(OSError):  # the folder may only be read
                    os.utime(handle)  # the longest unused goes first
        finally:
            os.close(place)
    except OSError:
        return None
    code = content[_DIGEST:]
    return code if content[:_DIGEST] == _seal(key, code) else None


def write_kept(key: str, code: bytes) -> None:
    """Keep the code, if that is possible."""
    folder = _own_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        handle, draft = tempfile.mkstemp(dir=folder, prefix=f".{key}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_seal(key, code) + code)
            Path(draft).replace(folder / key)
        except BaseException:
            Path(draft).unlink()
            raise
        _forget_old(folder)


def _seal(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def _forget_old(folder: Path) -> None:
    own = (file for file in folder.iterdir() if _OWN.fullmatch(file.name))
    files = sorted(own, key=lambda file: file.stat().st_mtime)
    for file in files[:-_KEPT_FILES]:
        with contextlib.suppress(OSError):
            file.unlink()


def _own_folder() -> Path | None:
    """The folder, made if needed; None where it is not the user's alone."""
    folder = _place()
    if folder is None:
        return None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    return folder if stat.S_ISDIR(status.st_mode) and _is_own(status) else None


def _is_own(status: os.stat_result) -> bool:
    """Whether a file or a folder is the user's own, and closed to all others."""
    return status.st_uid == os.getuid() and not status.st_mode & 0o077


@functools.cache
def _place() -> Path | None:
    """Where the folder is; None where the system knows no owners of files, or nobody's home."""
    if not hasattr(os, "getuid"):
        return None
    import platformdirs

    try:
        place = platformdirs.user_cache_path("erosion") / "lanes"
    except (OSError, RuntimeError):
        return None
    # Of a user without a home it is "~/.cache", in whatever folder this is.
    return place if place.is_absolute() else None


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


class MachineCode:
    """A module's function: compiled quickly at first, and with care once it has run for long.

    Both codes give the same bits.

    Args:
        text: of the module.
        target: the processor; without it, this machine's.
    """

    def __init__(self, text: str, target: Processor | None = None) -> None:
        self._target = target
        self._cost, self._spent = _COST * len(text), 0.0
        self._replacing = threading.Lock()
        self._code = _Compiled(text, target, _QUICK if len(text) <= _LONG else _CAREFUL)
        self._text = text if self._code.level == _QUICK else ""

    def run(self, inputs: int, varying: int, count: int, order: int, lanes: int, outputs: int, stop: int) -> None:
        """Call the function, with its arguments (see `vector_ir`)."""
        # Other threads go on with the quick code meanwhile.
        if self._spent > self._cost and self._code.level == _QUICK and self._replacing.acquire(blocking=False):
            try:
                if self._code.level == _QUICK:
                    self._code, self._text = _Compiled(self._text, self._target, _CAREFUL), ""
            finally:
                self._replacing.release()
        code, begin = self._code, time.thread_time()  # replaced code is kept until it has run
        code.run(inputs, varying, count, order, lanes, outputs, stop)
        self._spent += time.thread_time() - begin


class _Compiled:
    """A module's function, in memory."""

    def __init__(self, text: str, target: Processor | None, level: int) -> None:
        cpu, features = this_machine() if target is None else target
        machine = _triple().create_target_machine(cpu=cpu, features=features, opt=level, jit=True)
        made_of = text, cpu, features, machine.triple, llvmlite.__version__
        # Code that another process made with care is as quickly at hand.
        careful, key = (key_of(*made_of, str(each)) for each in (_CAREFUL, level))
        code, self.level = read_kept(careful), _CAREFUL
        if code is None:
            code, self.level = read_kept(key), level
        if code is None:
            module = llvm.parse_assembly(text)
            module.triple, module.data_layout = machine.triple, str(machine.target_data)
            code = machine.emit_object(module)
            write_kept(key, code)
        # MCJIT needs a module to start from, so it gets an empty one; the code is added as an object file.
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        address, whole = ctypes.c_void_p, ctypes.c_int64
        # The code itself releases Python's lock; ctypes raises what it brings back.
        signature = ctypes.PYFUNCTYPE(None, address, address, whole, address, whole, address, address)
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
    for name in PYTHONS:
        llvm.add_symbol(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value)
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
