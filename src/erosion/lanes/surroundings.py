"""What functions read beside their arguments, and whether any of it was replaced since.

A traced function keeps what it found: a helper, a global number, an attribute of a class. In a notebook these are
defined anew while the function that reads them stays the same object. To trace it at every call would cost a hundred
times more than to look whether each of the things that it reads is still the same object.
"""

import argparse
import dis
import functools
import os
import sys
import sysconfig
import types
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

_PACKAGE = str(Path(__file__).parents[1])
_LIBRARIES = tuple({str(Path(sysconfig.get_path(name)).resolve()) for name in ("stdlib", "purelib", "platlib")})
# What Python and dataclasses write into a class, and nothing that is traced reads.
_NOT_READ = frozenset({
    "__init__", "__repr__", "__eq__", "__hash__", "__doc__", "__module__", "__dict__", "__weakref__", "__annotations__",
    "__abstractmethods__", "_abc_impl", "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__slots__",
    "__firstlineno__", "__static_attributes__", "__abstractvars__", "__abstractclassvars__", "__parameters__",
})  # fmt: skip
_NAMESPACES = (types.SimpleNamespace, argparse.Namespace)
_PLAIN = (str, bytes, int, float, complex, bool, type(None))
_EXACT = 4096  # elements of an array of which each is looked at; of a larger one, as many evenly among them


class Surroundings:
    """What functions and classes of the user read, as it was when this was made.

    Code of libraries and of this package does not change while it runs, and is not looked at.

    Args:
        roots: functions, classes and other callables. What they call is looked at, too.
    """

    def __init__(self, roots: Iterable[Any]) -> None:
        self._reads: list[tuple[Callable[[Any], Any], Any]] = []
        self._contents: list[tuple[Callable[[], Any], Any]] = []
        self._seen: dict[tuple[int, str], Any] = {}  # kept, so that no other thing takes an id
        for root in roots:
            self._look_at(root, ())
        self._found = [read(name) for read, name in self._reads]
        self._ids = [id(one) for one in self._found]

    def unchanged(self) -> bool:
        """Whether all is as it was."""
        if [id(read(name)) for read, name in self._reads] != self._ids:
            return False
        return all(content() == before for content, before in self._contents)

    def _is_new(self, thing: Any, part: str = "") -> bool:
        if (id(thing), part) in self._seen:
            return False
        self._seen[id(thing), part] = thing
        return True

    def _look_at(self, thing: Any, attributes: Collection[str]) -> None:
        """Note what a thing consists of, and those of its attributes that code asks for."""
        if isinstance(thing, _PLAIN):
            return
        if isinstance(thing, types.FunctionType):
            self._look_at_function(thing)
        elif isinstance(thing, type):
            self._look_at_class(thing)
        elif isinstance(thing, types.ModuleType):
            if is_own(getattr(thing, "__file__", None)):
                self._look_at_attributes(thing, vars(thing), attributes)
        elif isinstance(thing, (list, tuple, set, frozenset, Mapping)):
            self._look_at_container(thing, attributes)
        elif isinstance(thing, np.ndarray):
            if self._is_new(thing):
                self._note_content(functools.partial(_elements, thing))
        else:
            self._look_at_object(thing, attributes)

    def _look_at_function(self, function: types.FunctionType) -> None:
        if not self._is_new(function) or not is_own(function.__code__.co_filename):
            return
        read = functools.partial(getattr, function)
        self._reads += [(read, name) for name in ("__code__", "__defaults__", "__kwdefaults__")]
        names = _Names(function.__code__)
        attributes = names.attributes
        for default in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._look_at(default, attributes)
        for cell in function.__closure__ or ():
            self._reads.append((functools.partial(_content, cell), ""))
            self._look_at(_content(cell), attributes)
        for name, namespace in [
            *((name, function.__globals__) for name in names.of_globals),
            *((name, sys.modules) for name in names.imported),
        ]:
            self._reads.append((namespace.get, name))
            self._look_at(namespace.get(name), attributes)
        if not attributes.isdisjoint({"environ", "getenv"}):
            for text in names.texts:
                self._note_content(functools.partial(os.environ.get, text))

    def _look_at_class(self, owner: type) -> None:
        for one in owner.__mro__:
            if not _is_own_class(one) or not self._is_new(one):
                continue
            namespace = vars(one)
            self._note_content(namespace.__len__)  # an attribute that is new
            for name, value in list(namespace.items()):
                if name not in _NOT_READ:
                    self._reads.append((namespace.get, name))
                    self._look_at(value, ())

    def _look_at_attributes(self, thing: Any, namespace: Mapping[str, Any], attributes: Collection[str]) -> None:
        for name in attributes:
            if name in namespace and self._is_new(thing, name):
                self._reads.append((namespace.get, name))
                self._look_at(namespace[name], attributes)

    def _look_at_container(self, thing: Any, attributes: Collection[str]) -> None:
        if not self._is_new(thing):
            return
        parts = [*thing.keys(), *thing.values()] if isinstance(thing, Mapping) else list(thing)
        if not isinstance(thing, (tuple, frozenset)):
            self._note_content(functools.partial(_parts, thing))
            self._seen[id(parts), ""] = parts
        for part in parts:
            self._look_at(part, attributes)

    def _look_at_object(self, thing: Any, attributes: Collection[str]) -> None:
        """An object by its attributes that are asked for; a wrapper by what it wraps."""
        for name in ("__wrapped__", "__func__", "__self__", "func", "args", "keywords", "fget", "method"):
            try:
                inner = getattr(thing, name, None)
            except Exception:  # noqa: BLE001 - an object of the user may do anything when it is asked
                continue
            if inner is not None and self._is_new(thing, name):
                self._look_at(inner, attributes)
        if hasattr(thing, "__dict__"):
            # What a function of the user is given is read there; of a library's object only what is asked for here.
            asked = list(vars(thing)) if _is_own_class(type(thing)) or type(thing) in _NAMESPACES else attributes
            self._look_at_attributes(thing, vars(thing), asked)
        slots = {name for one in type(thing).__mro__ for name in _slots(one)}
        for name in slots.intersection(attributes):
            if hasattr(thing, name) and self._is_new(thing, name):
                self._reads.append((functools.partial(getattr, thing), name))
                self._look_at(getattr(thing, name), attributes)
        self._look_at_class(type(thing))

    def _note_content(self, content: Callable[[], Any]) -> None:
        self._contents.append((content, content()))


def _is_own_class(owner: type) -> bool:
    if owner.__module__ in sys.builtin_module_names:
        return False
    return is_own(getattr(sys.modules.get(owner.__module__), "__file__", ""))


def is_own(file: str | None) -> bool:
    """Whether code is the user's; code of no file was typed."""
    return file is not None and not file.startswith((_PACKAGE, *_LIBRARIES, "<frozen"))


class _Names:
    """The names that code reads: globals, attributes, modules that it imports; and its texts. With functions within."""

    def __init__(self, code: types.CodeType) -> None:
        self.of_globals, self.attributes, self.imported = set[str](), set[str](), set[str]()
        self.texts = set[str]()
        self._add(code)

    def _add(self, code: types.CodeType) -> None:
        for instruction in dis.get_instructions(code):
            if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                self.of_globals.add(instruction.argval)
            elif instruction.opname == "IMPORT_NAME":
                self.imported.add(instruction.argval)
            elif instruction.opname.startswith(("LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR", "IMPORT_FROM")):
                self.attributes.add(instruction.argval)
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self._add(constant)
            elif isinstance(constant, str):
                self.texts.add(constant)
                self.attributes.add(constant)  # what `getattr` asks for


def _content(cell: Any, _: str = "") -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # it is empty
        return None


def _parts(container: Any) -> list[int]:
    parts = [*container.keys(), *container.values()] if isinstance(container, Mapping) else container
    return [id(part) for part in parts]


def _elements(array: np.ndarray) -> tuple[Any, ...]:
    step = -(-array.size // _EXACT) or 1
    return (
        array.shape,
        array.dtype,
        array.reshape(-1)[::step].tobytes() if array.flags.c_contiguous else array.tobytes(),
    )


def _slots(owner: type) -> Collection[str]:
    given = vars(owner).get("__slots__", ())
    return (given,) if isinstance(given, str) else tuple(given)
