"""A digest of what a model or a law is: its numbers, to the last bit, and its code.

Two that differ in either have different digests, whatever their names say. Code is known by its
file: that of every class and function, and of what these files take from other files of the user.
Libraries are known by name alone; an identity has a version beside it.
"""

import dataclasses
import functools
import hashlib
import inspect
import sys
import sysconfig
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

_PACKAGE = Path(__file__).parents[1]
_WITHOUT_NUMBERS = ("cli", "explorer", "plotting", "report")  # they show what the other folders compute
_LIBRARIES = {
    *sys.stdlib_module_names, "erosion", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "jaxtyping",
    "numpy", "scipy",
}  # fmt: skip
_INSTALLED = tuple({Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib")})


def digest(content: bytes) -> str:
    """Sixteen hexadecimal digits of the SHA-256 of the content."""
    return hashlib.sha256(content).hexdigest()[:16]


@functools.cache
def package_digest() -> str:
    """The digest of this package's own code, as far as numbers depend on it."""
    files = {str(file.relative_to(_PACKAGE)): file for file in sorted(_PACKAGE.rglob("*.py"))}
    return digest(
        b"\0".join(
            name.encode() + b"\0" + file.read_bytes()
            for name, file in files.items()
            if not name.startswith(_WITHOUT_NUMBERS)
        )
    )


def fingerprint(thing: Any, what: str = "model") -> str:
    """The digest of a model, or of anything else that a result depends on.

    Args:
        thing: numbers, arrays, functions, dataclasses and equinox modules of such.
        what: the argument's name, for messages.

    Raises:
        ValueError: where its code comes from no file, or it holds something that has no digest.
    """
    pieces = _Pieces(what)
    contents = [digest(piece) for piece in pieces.of(thing)]
    sources = sorted(digest(_source(sys.modules[name])) for name in _with_imports(pieces.modules))
    return digest(" ".join([*contents, "code", *sources]).encode())


class _Pieces:
    """The types, numbers and parts of a thing as bytes; `modules` collects where their code is."""

    def __init__(self, what: str) -> None:
        self.modules: set[str] = set()
        self._what, self._inside = what, set[int]()

    def of(self, thing: Any) -> Iterator[bytes]:
        """The pieces, in order."""
        thing = inspect.unwrap(thing) if callable(thing) else thing
        if id(thing) in self._inside:  # a thing that holds itself
            return
        self._inside.add(id(thing))
        yield self._name(thing if isinstance(thing, (type, types.FunctionType)) else type(thing))
        if isinstance(thing, (np.ndarray, np.generic, jax.Array)) and thing.dtype != object:
            array = np.asarray(thing)
            yield f"{array.dtype.str} {array.shape}".encode()
            yield array.tobytes()
        else:
            parts = _parts(thing)
            if parts is None:
                yield self._words(thing)
            for part in parts or ():
                yield from self.of(part)
        self._inside.remove(id(thing))

    def _name(self, owner: Any) -> bytes:
        """The name of a class or function; the modules of its code, and of a class's bases, are collected."""
        for one in owner.__mro__ if isinstance(owner, type) else [owner]:
            name = one.__module__ or "builtins"
            if name.split(".")[0] in _LIBRARIES:
                continue
            if getattr(sys.modules.get(name), "__file__", None) is None:
                raise ValueError(
                    f"Argument `{self._what}` must come from a file where a store is given, "
                    f"but {one.__qualname__} does not."
                )
            self.modules.add(name)
        return str(owner.__qualname__).encode()

    def _words(self, thing: Any) -> bytes:
        """A number, a text, or another thing that its words tell from all others."""
        words = repr(thing)
        if " at 0x" in words:  # where it is in this process
            raise ValueError(
                f"Argument `{self._what}` must hold numbers and functions where a store is given, but holds {words}."
            )
        return words.encode("utf-8", "backslashreplace")


def _parts(thing: Any) -> list[Any] | None:
    """What a thing consists of; None where it has no parts."""
    if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
        # Fields alone: a module may keep what it has computed among its attributes. A joint law is also a mapping, but
        # its items hold nothing but the law.
        return [getattr(thing, field.name, None) for field in dataclasses.fields(thing)]
    if isinstance(thing, Mapping):
        return [part for pair in thing.items() for part in pair]
    if isinstance(thing, (list, tuple, np.ndarray)):
        return list(thing)
    if isinstance(thing, functools.partial):
        return [thing.func, thing.args, thing.keywords]
    if isinstance(thing, types.MethodType):
        return [thing.__self__, thing.__func__]
    if isinstance(thing, types.FunctionType):
        # Two functions of one name in one file are told apart by their lines and constants.
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        return [thing.__code__.co_firstlineno, thing.__defaults__, thing.__kwdefaults__, cells]
    if isinstance(thing, (type, types.ModuleType)):
        return []
    return [vars(thing)] if hasattr(thing, "__dict__") else None


def _source(module: types.ModuleType) -> bytes:
    """The bytes that a module was made of: a plug-in's as they were when it was loaded, else those of its file."""
    content = getattr(module, "__source_bytes__", None)
    return Path(str(module.__file__)).read_bytes() if content is None else content


def _with_imports(names: set[str]) -> set[str]:
    """These modules, and the user's own modules that they take something from."""
    known, waiting = set(names), list(names)
    while waiting:
        name = waiting.pop()
        for value in list(vars(sys.modules[name]).values()):
            other = value.__name__ if isinstance(value, types.ModuleType) else getattr(value, "__module__", None)
            if isinstance(other, str) and other not in known and _is_own(other, name):
                known.add(other)
                waiting.append(other)
    return known


def _is_own(name: str, of: str) -> bool:
    """Whether a module is the user's: no library's, and no installed package's other than its importer's."""
    top, path = name.split(".")[0], getattr(sys.modules.get(name), "__file__", None)
    if path is None or top in _LIBRARIES:
        return False
    return top == of.split(".")[0] or not any(Path(path).resolve().is_relative_to(folder) for folder in _INSTALLED)
