"""What a problem computes, traced once for each kind of its arguments: what is wrong with it, and its digest.

A problem is what it computes. Its digest is that of its traced functions, and programs know a problem by this digest,
wherever its source is. A helper that is defined anew gives another digest; an edited docstring gives the same.
"""

import abc
import dataclasses
import functools
import struct
import traceback
import types
from collections.abc import Callable, Hashable, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeGuard

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.array_types import Number, Structure
from erosion.lanes.digests import digest_of, hashed
from erosion.lanes.surroundings import Surroundings

_PACKAGE = Path(__file__).parents[1]
_MANY = 256  # kinds that are remembered


@dataclasses.dataclass(frozen=True, eq=False)
class Equations:
    """The equations of one kind of arguments: of all that differ in their numbers alone.

    Args:
        flaw: what is wrong with them, as a clause on one of the functions; None where nothing is.
        digest: of what they compute from the numbers.
        foreign: what in them holds only in this process, such as a callback into Python; mostly "".
        surroundings: what the functions read beside their arguments.
        numbers: shape and type of each number of the arguments, for one lane.
        state: shapes and types of the state; None where it was not traced.
        timed: whether they depend on time.
    """

    flaw: str | None
    digest: str
    foreign: str
    surroundings: Surroundings
    numbers: tuple[jax.ShapeDtypeStruct, ...]
    state: PyTree = None
    timed: bool = False


def is_number(leaf: object) -> TypeGuard[Number]:
    """Whether a leaf is a number or an array of numbers; truth values are, too."""
    if isinstance(leaf, (float, int)):
        return True
    return isinstance(leaf, (np.ndarray, np.generic, jax.Array, Tracer)) and np.dtype(leaf.dtype).kind in "fiub"


def struct_of(leaf: Number) -> jax.ShapeDtypeStruct:
    """Shape and type of a number."""
    dtype = np.asarray(leaf).dtype if not isinstance(leaf, (jax.Array, Tracer)) else leaf.dtype
    return jax.ShapeDtypeStruct(np.shape(leaf), np.float64 if dtype.kind == "f" else dtype)


def digits(*parts: bytes | str) -> str:
    """A digest of some parts."""
    return hashed(*parts).hex()[:32]


class Kind(abc.ABC):
    """What pytrees that differ in their numbers alone have in common, exactly: 2 and 2.0 differ, 0.0 and -0.0 too.

    Args:
        tree: the pytree.
        numbers: shape and type of each of its numbers.
        beside: what else must be the same.
    """

    def __init__(self, tree: PyTree, numbers: Sequence[jax.ShapeDtypeStruct], *beside: object) -> None:
        leaves, self.structure = jax.tree.flatten(tree)
        self.leaves = [None if is_number(leaf) else leaf for leaf in leaves]
        self.numbers = tuple(numbers)
        shapes = tuple((number.shape, number.dtype) for number in self.numbers)
        self.key = _exact_structure(self.structure), _exactly(self.leaves), shapes, _exactly(beside)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and isinstance(other, Kind) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def joined(self, numbers: Sequence[Number | jax.ShapeDtypeStruct]) -> Any:
        """The pytree with these numbers, or with their shapes."""
        rest = iter(numbers)
        return jax.tree.unflatten(self.structure, [next(rest) if leaf is None else leaf for leaf in self.leaves])

    @abc.abstractmethod
    def traced(self) -> Equations:
        """The equations, as the code is now."""


_by_kind: dict[Kind, Equations] = {}


def equations_of(kind: Kind, *, anew: bool = False) -> Equations:
    """The equations as the code is now; they are traced where the kind is new or was redefined, or always if `anew`."""
    known = _by_kind.get(kind)
    if known is not None and known.surroundings.unchanged():
        if not anew:
            return known
    elif known is not None:
        jax.clear_caches()  # JAX, too, remembers what functions within have computed
    equations = kind.traced()
    _by_kind.pop(kind, None)
    _by_kind[kind] = equations
    while len(_by_kind) > _MANY:
        _by_kind.pop(next(iter(_by_kind)), None)
    return equations


class FlawError(Exception):
    """What is wrong with a user's function, as a clause."""


class Traced:
    """Traces a user's functions one after the other, and checks what they give.

    Args:
        made: the arguments, made of their numbers.
        numbers: shapes and types of these.
        labels: what each number is.
    """

    def __init__(
        self, made: Callable[[Sequence[Number]], Any], numbers: Sequence[jax.ShapeDtypeStruct], labels: Sequence[bytes]
    ) -> None:
        self._made, self._numbers, self._labels = made, list(numbers), labels
        self.pieces: list[str] = []
        self.foreign = ""

    def given(self, name: str, function: Callable[..., PyTree], *state: PyTree) -> PyTree:
        """Shapes and types of what a function of (args, …) gives."""
        beside = [hashed("beside", str(i)) for i in range(len(jax.tree.leaves(state)))]
        try:
            digest = digest_of(
                lambda numbers, *rest: function(self._made(numbers), *rest),
                (self._numbers, *state),
                [*self._labels, *beside],
            )
        # A user's own code may raise anything, and may ask to end the program.
        except (Exception, SystemExit) as error:
            raise FlawError(f"`{name}` fails{_where(error)}: {_said(error)}") from error
        self.pieces.append(digest.text)
        self.foreign = self.foreign or digest.foreign
        return digest.results


def require_numbers(name: str, given: PyTree, *, scalars: bool = True, double: bool = False) -> None:
    """Refuse what is no pytree of real numbers; of `double` precision, where it must be.

    Raises:
        FlawError: with the part that is none.
    """
    parts = jax.tree_util.tree_flatten_with_path(given)[0]
    if not parts:
        raise FlawError(f"`{name}` must give numbers, but gives none")
    for path, leaf in parts:
        if (leaf.shape and scalars) or leaf.dtype.kind not in "fiu":
            part = jax.tree_util.keystr(path).lstrip(".") or "it"
            what = f"type {leaf.dtype}" if leaf.dtype.kind not in "fiu" else f"shape {leaf.shape}"
            raise FlawError(f"`{name}` must give real {'scalars' if scalars else 'numbers'}, but {part} has {what}")
        if double and leaf.dtype.kind == "f" and leaf.dtype.itemsize < 8:
            part = jax.tree_util.keystr(path).lstrip(".") or "it"
            raise FlawError(f"`{name}` must give numbers of double precision, but {part} has type {leaf.dtype}")


def _exact_structure(structure: Structure) -> Hashable:
    node = structure.node_data()
    return None if node is None else (node[0], _exactly(node[1]), *map(_exact_structure, structure.children()))


def _exactly(value: Any) -> Hashable:
    """A key that two values share only if no function can tell them apart, as one can 2 and 2.0."""
    kind = type(value)
    if isinstance(value, (np.generic, np.dtype)) or value is None or kind in (str, bytes, bool, int):
        return kind, value.tobytes() if isinstance(value, np.generic) else value
    if kind in (float, complex):
        return kind, struct.pack("<2d", value.real, value.imag)
    if isinstance(value, (tuple, list, set, frozenset)):
        return kind, *map(_exactly, value)
    if isinstance(value, (Fraction, Decimal)):
        return kind, repr(value)
    if isinstance(value, types.MethodType):
        return kind, value.__func__, _exactly(value.__self__)
    if isinstance(value, functools.partial):
        return kind, *map(_exactly, (value.func, value.args, value.keywords))
    if isinstance(value, Mapping):
        return kind, *((_exactly(key), _exactly(part)) for key, part in value.items())
    if dataclasses.is_dataclass(value) and not isinstance(value, (type, eqx.Module)):
        slots = [name for one in kind.__mro__ for name in vars(one).get("__slots__", ()) if hasattr(value, name)]
        return kind, *((name, _exactly(getattr(value, name))) for name in (*getattr(value, "__dict__", ()), *slots))
    return _Same(value)


class _Same:
    """Equal where it holds the same object."""

    def __init__(self, thing: object) -> None:
        self._thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self._thing is other._thing

    def __hash__(self) -> int:
        return id(self._thing)

    def __repr__(self) -> str:
        return repr(self._thing) if isinstance(self._thing, type) else f"{self._thing!r} {id(self._thing)}"


def _said(error: BaseException) -> str:
    """What went wrong; where JAX says it about tracers, what to write instead."""
    # All tell that a number's value is asked for, while JAX traces the method and there is none.
    if isinstance(error, jax.errors.ConcretizationTypeError | jax.errors.TracerArrayConversionError):
        return (
            "it asks for the value of a number while JAX traces it; write `jnp.where(condition, a, b)` for `if`, "
            "and functions of jax.numpy for those of numpy and math"
        )
    return named(error)


def named(error: BaseException) -> str:
    """The kind of an error and what it says, on one line, as the end of a sentence."""
    said = " ".join(str(error).split())
    return f"{type(error).__name__}: {said if len(said) <= 200 else said[:200] + ' …'}".rstrip(".: ")


def _where(error: BaseException) -> str:
    """The last line of the user's own code on the way to an error: " in line 9 of kink.py"."""
    packages = (str(_PACKAGE), *(str(Path(str(module.__file__)).parent) for module in (jax, eqx, np)))
    own = [
        frame for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith((*packages, "<frozen", "<string"))
    ]  # fmt: skip
    return f" in line {own[-1].lineno} of {Path(own[-1].filename).name}" if own else ""
