"""What functions read beside their arguments, whether any of it was replaced since, and Ctrl-C while lanes run.

A traced function keeps what it found: a helper, a global number, an attribute of a class. In a notebook these are
defined anew while the function that reads them stays the same object. To trace it at every call would cost a hundred
times more than to look whether each of the things that it reads is still the same object.

The code computes without Python's lock. A signal's handler (Ctrl-C) runs only in the main thread, and only where that
thread asks for it. So the code counts the rounds of its loops, and after many of them it asks. In the other threads
it looks at a word in memory instead, which the main thread sets.
"""

import argparse
import collections
import dis
import functools
import os
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

_PACKAGE = str(Path(__file__).parents[1]) + os.sep
_FOLDERS = [Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")]
# Those of `pip install --user`, of Debian's packages, and of a cluster's modules.
_FOLDERS += [path for path in map(Path, sys.path) if path.name in ("site-packages", "dist-packages")]
# Modules know their files by the path through which Python was started, which may have symbolic links in it.
_LIBRARIES = tuple({str(path) for folder in _FOLDERS for path in (folder, folder.resolve())})
# What Python and dataclasses write into a class, and nothing that is traced reads.
_NOT_READ = frozenset({
    "__repr__", "__doc__", "__module__", "__dict__", "__weakref__", "__annotations__", "__abstractmethods__",
    "_abc_impl", "__dataclass_fields__", "__dataclass_params__", "__match_args__", "__slots__", "__firstlineno__",
    "__static_attributes__", "__abstractvars__", "__abstractclassvars__", "__parameters__",
})  # fmt: skip
_WRAPPED = ("__wrapped__", "fun", "jvp", "jvps", "pyfunc")  # where objects of libraries keep functions of the user
_NAMESPACES = (types.SimpleNamespace, argparse.Namespace)
_CONTAINERS = (tuple, list, set, frozenset, dict, collections.deque)
_PLAIN = (str, bytes, int, float, complex, bool, type(None))
_MOST = 4096  # elements of an array or a container that are looked at; of a larger array, as many evenly among them


class Surroundings:
    """What functions and classes of the user read, as it was when this was made.

    Code of libraries and of this package does not change while it runs, and is not looked at. Nor are larger
    containers, each element of larger arrays, and what is read by other ways than Python's names, such as a file.

    Args:
        roots: functions, classes and other callables. What they call is looked at, too.
        classes: of this package, whose attributes someone may have replaced.

    Attributes:
        has_own: whether there is any code of the user among them.
    """

    def __init__(self, roots: Iterable[Any], classes: Iterable[type] = ()) -> None:
        self.has_own = False
        self._reads: list[Callable[[], Any]] = []
        self._checks: list[tuple[Callable[[], Any], Any]] = []
        self._seen: dict[int, Any] = {}  # kept, so that no other thing takes an id
        self._asked_for: set[str] = set()  # the names of attributes in all code that is looked at
        self._searched: dict[int, tuple[Mapping[str, Any], set[str]]] = {}  # where only such names are looked at
        self._waiting = list(roots)
        for owner in classes:
            names = tuple(vars(owner).keys() - _NOT_READ)
            self._waiting += map(vars(owner).get, names)
            self._check(functools.partial(_identities, vars(owner), names))
        while self._waiting:
            while self._waiting:
                self._look_at(self._waiting.pop())
            self._search()
        self._values = [read() for read in self._reads]
        self._ids = [id(value) for value in self._values]

    def unchanged(self) -> bool:
        """Whether all is as it was."""
        if [id(read()) for read in self._reads] != self._ids:
            return False
        return all(check() == before for check, before in self._checks)

    def _look_at(self, thing: Any) -> None:
        """Note what a thing consists of."""
        if isinstance(thing, _PLAIN) or id(thing) in self._seen:
            return
        self._seen[id(thing)] = thing
        if isinstance(thing, types.FunctionType):
            self._look_at_function(thing)
        elif isinstance(thing, type):
            self._look_at_class(thing)
        elif isinstance(thing, types.ModuleType):
            file = getattr(thing, "__file__", None)
            if is_own(file) or (file is None and getattr(thing, "__spec__", None) is None):  # a program made it
                self._searched[id(thing)] = vars(thing), set()
                self._check(vars(thing).__len__)  # an attribute that is new
        elif isinstance(thing, _CONTAINERS):
            self._look_at_container(thing)
        elif isinstance(thing, np.ndarray):
            self._check(functools.partial(_elements, thing))
        elif isinstance(thing, types.MethodType):
            self._waiting += [thing.__func__, thing.__self__]
        elif isinstance(thing, (functools.partial, functools.partialmethod)):
            self._waiting += [thing.func, thing.args, thing.keywords]
        elif isinstance(thing, property):
            self._waiting.append(thing.fget)
        elif isinstance(thing, (staticmethod, classmethod)):
            self._waiting.append(thing.__func__)
        else:
            self._look_at_object(thing)

    def _look_at_function(self, function: types.FunctionType) -> None:
        for cell in function.__closure__ or ():
            self._read(functools.partial(_content, cell))
        # What dataclasses write into a class has no file, but the globals of its module.
        file = function.__globals__.get("__file__")
        if not is_own(function.__code__.co_filename) or (isinstance(file, str) and not is_own(file)):
            self._waiting.append(getattr(function, "__wrapped__", None))  # the user's, of `jax.grad` and others
            return
        self.has_own = True
        for name in ("__code__", "__defaults__", "__kwdefaults__"):
            self._read(functools.partial(getattr, function, name))
        self._look_at_attributes(vars(function))
        names = _Names(function.__code__)
        self._asked_for |= names.attributes
        space = function.__globals__
        for name in {*names.of_globals, *(text for text in names.texts if text in space)}:
            self._read(functools.partial(space.get, name))
        for name in names.imported:
            self._read(functools.partial(sys.modules.get, name))
        if not {"environ", "getenv"}.isdisjoint({*names.attributes, *names.of_globals}):
            self._check(functools.partial(dict, getattr(os.environ, "_data", os.environ)))

    def _look_at_class(self, owner: type) -> None:
        for one in filter(_is_own_class, owner.__mro__):
            if one is not owner:
                self._waiting.append(one)
                continue
            self._check(vars(one).__len__)
            for name in vars(one).keys() - _NOT_READ:
                self._read(functools.partial(vars(one).get, name))

    def _look_at_container(self, container: Any) -> None:
        if len(container) > _MOST:
            self._check(container.__len__)
            return
        if not isinstance(container, (tuple, frozenset)):
            parts = list(_parts(container))
            self._seen[id(parts)] = parts
            self._check(lambda: [id(part) for part in _parts(container)])
        self._waiting += _parts(container)

    def _look_at_object(self, thing: Any) -> None:
        """The attributes of an object: all of the user's own, of another those that code asks for."""
        self._waiting.append(type(thing))
        space = getattr(thing, "__dict__", None)
        if _is_own_class(type(thing)) or type(thing) in _NAMESPACES:
            self._look_at_attributes({} if space is None else space)
            for name in {name for one in type(thing).__mro__ for name in _slots(one)} - _NOT_READ:
                if hasattr(thing, name):
                    self._read(functools.partial(getattr, thing, name))
        elif isinstance(space, dict):
            self._searched[id(thing)] = space, set()
            self._waiting += [thing.__wrapped__] if hasattr(type(thing), "__wrapped__") else []  # of equinox
            for name in _WRAPPED:
                if name in space:
                    self._read(functools.partial(space.get, name))
            self._waiting += [value for value in space.values() if isinstance(value, np.ndarray)]

    def _look_at_attributes(self, space: Mapping[str, Any]) -> None:
        if isinstance(space, dict):
            self._check(space.__len__)
        for name in list(space):
            self._read(functools.partial(space.get, name))

    def _search(self) -> None:
        """Look at the attributes of modules and other objects that code asks for."""
        for space, done in self._searched.values():
            for name in self._asked_for.intersection(space) - done:
                done.add(name)
                self._read(functools.partial(space.get, name))

    def _read(self, read: Callable[[], Any]) -> None:
        self._reads.append(read)
        self._waiting.append(read())

    def _check(self, check: Callable[[], Any]) -> None:
        self._checks.append((check, check()))


def is_own(file: str | None) -> bool:
    """Whether code is the user's; code of no file was typed."""
    return file is not None and not file.startswith((_PACKAGE, *_LIBRARIES, "<frozen"))


def _is_own_class(owner: type) -> bool:
    is_python = bool(owner.__flags__ & 1 << 9)  # made by a class statement, or as one is
    if not is_python or (owner.__module__ in sys.builtin_module_names and owner.__module__ != "builtins"):
        return False
    # A script that a profiler or a test runner runs has their file for its own.
    return owner.__module__ == "__main__" or is_own(getattr(sys.modules.get(owner.__module__), "__file__", ""))


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
        self._add_constants(code.co_consts)

    def _add_constants(self, constants: Iterable[Any]) -> None:
        for constant in constants:
            if isinstance(constant, types.CodeType):
                self._add(constant)
            elif isinstance(constant, (tuple, frozenset)):
                self._add_constants(constant)
            elif isinstance(constant, str):
                self.texts.add(constant)
                self.attributes.add(constant)  # what `getattr` asks for


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # it is empty
        return None


def _parts(container: Any) -> Iterator[Any]:
    yield from container
    if isinstance(container, dict):
        yield from container.values()


def _elements(array: np.ndarray) -> tuple[Any, ...]:
    step = -(-array.size // _MOST) or 1
    return array.shape, array.dtype, array.flat[::step].tobytes()


def _identities(space: Mapping[str, Any], names: tuple[str, ...]) -> list[int]:
    return [len(space), *map(id, map(space.get, names))]


def _slots(owner: type) -> Iterable[str]:
    given = vars(owner).get("__slots__", ())
    return (given,) if isinstance(given, str) else given


_ROUNDS = 2**14  # some hundredths of a second

PYTHONS = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyErr_CheckSignals")
"""Functions of Python that the code calls."""

INTERRUPTED = """declare ptr @PyEval_SaveThread()
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


def look_for_a_stop(again: str) -> list[str]:
    """The end of a round: it goes to the label `again`, or, where the function is to stop, to `exit`."""
    return [
        f"  %before.{again} = load i64, ptr %rounds",
        f"  %rounds.{again} = add i64 %before.{again}, 1",
        f"  store i64 %rounds.{again}, ptr %rounds",
        f"  %many.{again} = icmp ugt i64 %rounds.{again}, {_ROUNDS}",
        f"  br i1 %many.{again}, label %look.{again}, label %{again}",
        f"look.{again}:",
        f"  %stopped.{again} = call i1 @interrupted(ptr %rounds, ptr %stop, ptr %thread)",
        f"  br i1 %stopped.{again}, label %exit, label %{again}",
    ]
