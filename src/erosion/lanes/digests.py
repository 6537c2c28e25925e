"""Whether functions are the same: the digest of what a traced one computes, and whether what it reads was replaced.

Each value has a digest, made of its operation and of the digests of what goes in. So the order of statements, names,
calls of helpers and what no result needs do not count; the order of operands and a number's last bit do. Functions of
one digest have the same bits in every lane, for the same version of JAX.

A traced function keeps what it found: a helper, a global number, an attribute of a class. In a notebook these are
defined anew while the function that reads them stays the same object. To trace it at every call would cost a hundred
times more than to look whether each of the things that it reads is still the same object.
"""

import argparse
import collections
import dataclasses
import dis
import functools
import hashlib
import os
import re
import sys
import sysconfig
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var
from jaxtyping import PyTree

from erosion.lanes.jax_versions import CALLS, called, expansion
from erosion.lanes.scalars import Atom, Equation, aval_of

_PACKAGE = str(Path(__file__).parents[1]) + os.sep
TRACED = "a number that JAX is tracing"
"""`process_local` of a function that reads a tracer from outside."""

_ADDRESS = re.compile(r" at 0x[0-9a-f]+")  # of a thing in this process
_IGNORED = ("weak_type", "sharding", "out_sharding")  # parameters that change no number


@dataclasses.dataclass(frozen=True)
class Digest:
    """What a traced function computes.

    Args:
        text: hexadecimal digits.
        results: shapes and types of what it gives.
        process_local: what holds only in this process, such as a callback into Python; empty where there is nothing.
    """

    text: str
    results: PyTree
    process_local: str


def hashed(*parts: bytes | str) -> bytes:
    """The SHA-256 of some parts, each with its length."""
    made = hashlib.sha256()
    for part in parts:
        content = part.encode("utf-8", "surrogatepass") if isinstance(part, str) else part
        made.update(len(content).to_bytes(8, "little") + content)
    return made.digest()


def digest_of(
    function: Callable[..., PyTree], examples: Sequence[PyTree], labels: Sequence[bytes] | None = None
) -> Digest:
    """The digest of a function, of its derivatives too where it has rules of its own for them.

    Args:
        function: takes and returns pytrees of numbers and small arrays; it is traced, not run.
        examples: examples of its arguments, or `jax.ShapeDtypeStruct` of them.
        labels: what each leaf of the arguments is; its place among them without it.
    """
    walk = _Walk()
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*examples)
    results = walk.results(closed, labels)
    if walk.has_rules:
        results += walk.results(_twice_differentiated(function, examples), labels)
    return Digest(hashed(*results).hex()[:32], shapes, walk.process_local)


def _twice_differentiated(function: Callable[..., PyTree], examples: Sequence[PyTree]) -> ClosedJaxpr:
    """Value, first and second derivative along two directions, by all arguments that are floating-point numbers."""
    leaves, structure = jax.tree.flatten(examples)
    structs = [jax.ShapeDtypeStruct(np.shape(leaf), jax.numpy.result_type(leaf)) for leaf in leaves]
    moving = [i for i, struct in enumerate(structs) if struct.dtype.kind == "f"]

    def second(*given: Any) -> PyTree:
        count = len(structs)
        along, also = given[count : count + len(moving)], given[count + len(moving) :]

        def value(*numbers: Any) -> list[Any]:
            whole = list(given[:count])
            for i, number in zip(moving, numbers, strict=True):
                whole[i] = number
            floats = jax.tree.leaves(function(*jax.tree.unflatten(structure, whole)))
            return [leaf for leaf in floats if jax.numpy.result_type(leaf).kind == "f"]

        def first(*numbers: Any) -> PyTree:
            return jax.jvp(value, numbers, along)

        return jax.jvp(first, tuple(given[i] for i in moving), also)

    directions = [structs[i] for i in moving]
    return jax.make_jaxpr(second)(*structs, *directions, *directions)


class _Walk:
    """Walks through traced functions; notes rules of derivatives and what holds only in this process."""

    def __init__(self) -> None:
        self.has_rules = False
        self.process_local = ""

    def results(self, closed: ClosedJaxpr, labels: Sequence[bytes] | None = None) -> list[bytes]:
        """The digests of a function's results."""
        given = [hashed("argument", str(i), _kind(variable)) for i, variable in enumerate(closed.jaxpr.invars)]
        for i, label in enumerate(labels or ()):
            given[i] = hashed("argument", label, _kind(closed.jaxpr.invars[i]))
        return self._evaluated(closed.jaxpr, closed.consts, given)

    def _evaluated(self, jaxpr: Jaxpr, constants: Sequence[Any], given: Sequence[bytes]) -> list[bytes]:
        known: dict[Var, bytes] = dict(zip(jaxpr.invars, given, strict=True))
        known |= zip(jaxpr.constvars, map(self._number, constants), strict=True)

        def of(atom: Atom) -> bytes:
            return self._number(atom.val, aval_of(atom).dtype) if isinstance(atom, Literal) else known[atom]

        for equation in jaxpr.eqns:
            results = self._outputs(equation, [of(atom) for atom in equation.invars])
            known |= zip(equation.outvars, results, strict=True)
        return [of(atom) for atom in jaxpr.outvars]

    def _outputs(self, equation: Equation, given: list[bytes]) -> list[bytes]:
        """The digests of what an operation gives."""
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            # Rules of the package's own functions do not change.
            self.has_rules |= name == "custom_jvp_call" and not _file(equation).startswith(_PACKAGE)
            return self._evaluated(*called(equation), given)
        if (expanded := expansion(equation)) is not None:
            return self._evaluated(expanded.jaxpr, expanded.consts, given)
        is_cast = name == "convert_element_type"
        if name == "copy" or (is_cast and aval_of(equation.invars[0]).dtype == aval_of(equation.outvars[0]).dtype):
            return given
        if name == "square":
            name, params = "integer_pow", {"y": 2}
        # The order of operands counts: which of two products in a sum is contracted depends on it.
        head = hashed(name, *self._parameters(params), *given)
        several = len(equation.outvars) > 1
        return [hashed(head, str(i)) if several else head for i in range(len(equation.outvars))]

    def _parameters(self, params: Mapping[str, Any]) -> Iterable[bytes]:
        for name in sorted(params):
            if name not in _IGNORED:
                yield hashed(name, self._described(params[name]))

    def _described(self, value: Any) -> bytes:
        """A parameter of an operation."""
        if isinstance(value, (ClosedJaxpr, Jaxpr)):
            jaxpr, constants = (value.jaxpr, value.consts) if isinstance(value, ClosedJaxpr) else (value, ())
            given = [hashed("inner argument", str(i), _kind(variable)) for i, variable in enumerate(jaxpr.invars)]
            return hashed(*self._evaluated(jaxpr, constants, given))
        if isinstance(value, (tuple, list)):
            return hashed("several", *map(self._described, value))
        if isinstance(value, (np.ndarray, np.generic, jax.Array)):
            return self._number(value)
        words = repr(value)
        if _ADDRESS.search(words):
            self.process_local = self.process_local or words
        return hashed(type(value).__name__, _ADDRESS.sub("", words))

    def _number(self, number: Any, dtype: Any = None) -> bytes:
        if isinstance(number, Tracer):
            self.process_local = TRACED
            return hashed("traced", str(id(number)))
        if jax.numpy.issubdtype(getattr(number, "dtype", float), jax.dtypes.extended):  # keys of random numbers
            number = jax.random.key_data(number)
        array = np.asarray(number, None if dtype is None or dtype == jax.dtypes.float0 else dtype)
        return hashed("number", array.dtype.str, str(array.shape), array.tobytes())


def _kind(variable: Var) -> str:
    return f"{aval_of(variable).dtype} {aval_of(variable).shape}"


def _file(equation: Equation) -> str:
    """The file of the function that an equation calls."""
    place = str(called(equation)[0].debug_info.func_src_info)  # "relu at /…/functions.py:47"
    return place.partition(" at ")[2].rpartition(":")[0]


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


class CodeSnapshot:
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
        names: collections.defaultdict[str, set[str]] = collections.defaultdict(set)
        for kind, name in _names(function.__code__):
            names[kind].add(name)
        self._asked_for |= names["attribute"]
        space = function.__globals__
        for name in names["global"] | names["text"].intersection(space):
            self._read(functools.partial(space.get, name))
        for name in names["module"]:
            self._read(functools.partial(sys.modules.get, name))
        if not {"environ", "getenv"}.isdisjoint(names["attribute"] | names["global"]):
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


_READS = {
    "global": ("LOAD_GLOBAL", "LOAD_NAME"),
    "module": ("IMPORT_NAME",),
    "attribute": ("LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR", "IMPORT_FROM"),
}
"""How the operations of Python's code begin that read a name, by what it is the name of."""


def _names(code: types.CodeType) -> Iterator[tuple[str, str]]:
    """What code and the functions within it read: a kind of `_READS` or "text", and a name."""
    for instruction in dis.get_instructions(code):
        for kind, operations in _READS.items():
            if instruction.opname.startswith(operations):
                yield kind, instruction.argval
    constants = list(code.co_consts)
    while constants:
        constant = constants.pop()
        if isinstance(constant, types.CodeType):
            yield from _names(constant)
        elif isinstance(constant, (tuple, frozenset)):
            constants += constant
        elif isinstance(constant, str):
            yield "text", constant
            yield "attribute", constant  # what `getattr` asks for


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
