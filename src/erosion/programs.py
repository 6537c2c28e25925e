"""Compiled functions, and those of them that need not be traced again in the next process.

JAX can keep what XLA compiled. But to know whether a program is among that, it traces and lowers it,
which takes longer than to read what is kept. So the traced program is kept as well, by what it was
traced from: the package's own source, the names of its classes, and the versions of what it builds on.
Of anything else, such as a plug-in, nobody can say what its code depends on: that is traced anew.
"""

import contextlib
import functools
import hashlib
import os
import platform
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar, TypeVar, cast

import equinox as eqx
import jax
import jax.export
import numpy as np

from erosion.compiler import for_few_runs
from erosion.files import write_whole
from erosion.version import IMPORTED

_Function = TypeVar("_Function", bound=Callable[..., Any])
_ARRAYS = (jax.Array, np.ndarray, np.generic)
_BUILT_ON = ("jax", "jaxlib", "numpy", "equinox", "diffrax", "optimistix", "lineax")
_OF_KNOWN_SOURCE = ("erosion", "builtins", "equinox", "diffrax", "optimistix", "lineax")
_DIGEST = hashlib.sha256().digest_size


class _Array:
    """Where an argument is an array."""


class Program:
    """A function of pytrees that JAX compiles for each structure and shape of its arguments.

    Args:
        function: returns arrays in tuples, lists and dicts.
        options: the compiler's.
        direct: the compiled function where no traces are kept, made when it is first needed.
    """

    folder: ClassVar[Path | None] = None
    """Where traced programs are kept; None: nowhere."""

    def __init__(
        self, function: Callable[..., Any], options: Callable[[], dict[str, Any]], direct: Callable[[], Any]
    ) -> None:
        functools.update_wrapper(self, function)
        self.name = getattr(function, "__name__", "program").strip("_")
        self._function, self._options, self._direct = function, options, direct
        self._lock = threading.Lock()
        self._made: dict[Any, Callable[[Any, Any], Any]] = {}
        self._locks: dict[Any, threading.Lock] = {}

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        if Program.folder is None:
            return self._directly(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        arrays = [leaf for leaf in leaves if isinstance(leaf, _ARRAYS)]
        fixed = tuple((_Array, None) if isinstance(leaf, _ARRAYS) else (type(leaf), leaf) for leaf in leaves)
        key = structure, fixed, tuple(map(jax.typeof, arrays))
        if key not in self._made:
            # Compiled within the lock: what two threads ask for at once is compiled once.
            with self._locks.setdefault(key, threading.Lock()):
                if key not in self._made:
                    call = self._kept(structure, fixed, arrays)
                    result = call(arguments, arrays)
                    self._made[key] = call
                    return result
        return self._made[key](arguments, arrays)

    def _directly(self, *arguments: Any) -> Any:
        # Two threads would make two of them, and each compile its own.
        with self._lock:
            function = self._direct()
        return function(*arguments)

    def _kept(self, structure: Any, fixed: Sequence[tuple[type, Any]], arrays: list[Any]) -> Callable[[Any, Any], Any]:
        """What computes the result, from the arguments or from the arrays among them."""
        try:
            traced = self._traced(structure, fixed, arrays)
        # Of unknown source, or it calls back into Python or into what JAX does not promise to keep.
        # An error of the function itself comes again where it is called directly.
        except (_UnknownSourceError, NotImplementedError, ValueError):
            return lambda arguments, _: self._directly(*arguments)
        compiled = jax.jit(traced.call, compiler_options=self._options())
        return lambda _, arrays: compiled(*arrays)

    def _traced(self, structure: Any, fixed: Sequence[tuple[type, Any]], arrays: list[Any]) -> jax.export.Exported:
        name = [_named(self._function), _structure(structure), _named(fixed), *map(str, map(jax.typeof, arrays))]
        digest = hashlib.sha256("\0".join([_sources(), *name]).encode()).hexdigest()
        path = cast(Path, Program.folder) / f"{self.name}-{digest}"
        content = _read(path)
        if content is None:
            content = self._export(structure, fixed, arrays)
            # A full disk is no reason not to compute.
            with contextlib.suppress(OSError):
                write_whole(path, hashlib.sha256(content).digest() + content)
        # Also what was exported just now: this process and the next do the same.
        return jax.export.deserialize(bytearray(content))

    def _export(self, structure: Any, fixed: Sequence[tuple[type, Any]], arrays: list[Any]) -> bytes:
        def of_arrays(*arrays: Any) -> Any:
            rest = iter(arrays)
            leaves = [next(rest) if kind is _Array else leaf for kind, leaf in fixed]
            return self._function(*jax.tree.unflatten(structure, leaves))

        return bytes(jax.export.export(jax.jit(of_arrays))(*arrays).serialize())


def seldom_run(function: _Function) -> _Function:
    """A program that takes longer to compile than to run: compiled in two thirds of the time."""
    jit: Any = eqx.filter_jit  # whose signature does not say that options are passed on to `jax.jit`
    direct = functools.cache(lambda: jit(function, compiler_options=for_few_runs()))
    return cast(_Function, Program(function, for_few_runs, direct))


class _UnknownSourceError(Exception):
    """Raised for what may change without the package's version or source doing so."""


def _structure(tree: Any) -> str:
    """A tree's structure in words that mean the same in every process."""
    node = tree.node_data()
    if node is None:
        return "*"
    return f"{_named(node[0])}[{_named(node[1])}]({','.join(map(_structure, tree.children()))})"


def _named(thing: Any) -> str:
    # By their exact types: a plug-in's own enumeration is a number too.
    if thing is None or type(thing) in (bool, int, float, str):
        return repr(thing)
    if type(thing) in (tuple, list):
        return f"{type(thing).__name__}({','.join(map(_named, thing))})"
    if thing is type(None) or thing is FunctionType:
        return repr(thing)
    if isinstance(thing, (type, FunctionType)):
        return _name_of_known_source(thing)
    leaves, structure = jax.tree.flatten(thing)
    if leaves:
        raise _UnknownSourceError
    return _structure(structure)


def _name_of_known_source(thing: Any) -> str:
    """The full name of a class or function, by which it can be found in a module of known source."""
    module, name = thing.__module__ or "", thing.__qualname__
    found = sys.modules.get(module)
    # Not so what is made in a function, replaced, or only said to be of a module.
    for part in name.split("."):
        found = getattr(found, part, None)
    known = module.partition(".")[0] in _OF_KNOWN_SOURCE
    if not known or not (found is thing or getattr(found, "__wrapped__", None) is thing):
        raise _UnknownSourceError
    return f"{module}.{name}"


@functools.cache
def _sources() -> str:
    """A digest of all that a program of known arguments depends on."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        # What changes while this process runs is not what it traces.
        if path.stat().st_mtime_ns >= IMPORTED:
            raise _UnknownSourceError
        content = path.read_bytes()
        digest.update(f"{path.relative_to(package)} {len(content)}\0".encode() + content)
    beside = {name: version(name) for name in _BUILT_ON}
    machine = platform.system(), platform.machine(), jax.default_backend(), jax.devices()[0].device_kind
    # Read by equinox when it is imported.
    settings = os.environ.get("EQX_ON_ERROR"), jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    digest.update(repr((sys.version, beside, machine, settings)).encode())
    return digest.hexdigest()


def _read(path: Path) -> bytes | None:
    """What was kept there, if it is there and whole."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, kept = content[:_DIGEST], content[_DIGEST:]
    return kept if hashlib.sha256(kept).digest() == digest else None
