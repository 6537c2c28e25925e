"""The digest of a traced function: of what it computes, whatever its source looks like.

Each value has a digest, made of its operation and of the digests of what goes in. So the order of statements, names,
calls of helpers and what no result needs do not count; the order of operands and a number's last bit do. Functions of
one digest have the same bits in every lane, for the same version of JAX.
"""

import dataclasses
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
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
_ADDRESS = re.compile(r" at 0x[0-9a-f]+")  # of a thing in this process
_IGNORED = ("weak_type", "sharding", "out_sharding")  # parameters that change no number


@dataclasses.dataclass(frozen=True)
class Digest:
    """What a traced function computes.

    Args:
        text: hexadecimal digits.
        results: shapes and types of what it gives.
        foreign: what holds only in this process, such as a callback into Python; empty where there is nothing.
    """

    text: str
    results: PyTree
    foreign: str


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
    return Digest(hashed(*results).hex()[:32], shapes, walk.foreign)


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
        self.foreign = ""

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
        if name == "copy" or (name == "convert_element_type" and _is_same(equation)):
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
            self.foreign = self.foreign or words
        return hashed(type(value).__name__, _ADDRESS.sub("", words))

    def _number(self, number: Any, dtype: Any = None) -> bytes:
        if isinstance(number, Tracer):
            self.foreign = self.foreign or "a number that JAX is tracing"
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


def _is_same(equation: Equation) -> bool:
    return aval_of(equation.invars[0]).dtype == aval_of(equation.outvars[0]).dtype
