"""A model's equations, traced once for each kind of model: what is wrong with them, and their digest.

A model is what it computes. Its digest is that of its traced equations: initial state, rates, events, volume.
Programs and stores know a model by this digest, whatever its class is called and wherever its source is. A helper
that is defined anew gives another digest; an edited docstring gives the same.
"""

import contextlib
import dataclasses
import functools
import struct
import sys
import traceback
import types
import weakref
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.array_types import Number, Structure
from erosion.lanes.digests import Digest, digest_of, hashed
from erosion.lanes.surroundings import Surroundings
from erosion.models.base import CuttingModel, Scales, Tip, units_within
from erosion.models.own_parameters import is_number, own_parameters
from erosion.parameters.parameters import QUANTITIES, TABLE_1, Parameters
from erosion.parameters.units import System, shown

_PACKAGE = Path(__file__).parents[1]
_PLAIN_NODES = (tuple, list, dict, type(None))  # of pytrees
_MANY = 256  # kinds of models that are remembered


@dataclasses.dataclass(frozen=True, eq=False)
class Equations:
    """The equations of one kind of model: of all models that differ in their numbers alone.

    Args:
        flaw: what is wrong with them, as a clause on one of the model's methods; None where nothing is.
        digest: of what they compute from the numbers of model and case.
        foreign: what in them holds only in this process, such as a callback into Python; mostly "".
        surroundings: what the model's methods read beside their arguments.
        numbers: shape and type of each leaf of the model that is a number, for one impact.
        state: the structure of the model's state; None of a model of the package's parts alone.
    """

    flaw: str | None
    digest: str
    foreign: str
    surroundings: Surroundings
    numbers: tuple[jax.ShapeDtypeStruct, ...]
    state: Structure | None


def equations_of(model: CuttingModel, units: System = "inch-pound") -> Equations:
    """The equations of a model as its code is now; they are traced where this kind of model is new or was redefined.

    Args:
        model: numbers among its leaves may be arrays, or JAX's tracers.
        units: the unit system that its methods see; see `units_within`.
    """
    recent = _by_place.get((id(model), units))
    if recent is not None and recent[0]() is model and recent[1].surroundings.unchanged():
        return recent[1]
    kind = _Kind(model, units)
    known = _by_kind.get(kind)
    if known is None or not known.surroundings.unchanged():
        known = _traced(kind, known)
    _keep_by_place(model, units, known)
    return known


_by_kind: "dict[_Kind, Equations]" = {}
# By a model's place in memory: a model does not change, and to tell its kind takes ten times longer.
_by_place: "dict[tuple[int, System], tuple[weakref.ref[CuttingModel], Equations]]" = {}


def _traced(kind: "_Kind", before: Equations | None) -> Equations:
    """The equations as the code is now, which are remembered."""
    if before is not None and not before.surroundings.unchanged():
        jax.clear_caches()  # JAX, too, remembers what functions within the model have computed
    equations = kind.traced()
    _by_kind.pop(kind, None)
    _by_kind[kind] = equations
    while len(_by_kind) > _MANY:
        _by_kind.pop(next(iter(_by_kind)), None)
    return equations


def _keep_by_place(model: CuttingModel, units: System, equations: Equations) -> None:
    place = id(model), units
    with contextlib.suppress(TypeError):  # of a class with `__slots__` there are no such references
        _by_place[place] = weakref.ref(model, lambda _: _by_place.pop(place, None)), equations


def model_digest(model: CuttingModel, p: Parameters) -> str:
    """The digest of a model with its numbers, for a case; the same in every process.

    Own parameters are known by name and value, other arrays by their numbers alone.

    Raises:
        ValueError: where the equations hold what only this process knows.
    """
    units = units_within(model, p)
    kind = _Kind(model, units)
    # As the code is now, also where something changed that `Surroundings` does not see, such as a file that is read.
    equations = _traced(kind, _by_kind.get(kind))
    _keep_by_place(model, units, equations)
    if equations.flaw is not None:
        raise ValueError(f"Argument `model` must be a model, but {equations.flaw}.")
    if equations.foreign:
        raise ValueError(
            "Argument `model` must compute by JAX alone where a store is given, but its equations hold "
            f"{shown(equations.foreign)}."
        )
    own = {parameter.leaf: name for name, parameter in own_parameters(model).items()}
    labels, values = [], []
    for i, leaf in enumerate(jax.tree.leaves(model)):
        if is_number(leaf):
            number = np.asarray(leaf, float if i in own else _struct(leaf).dtype)
            content = hashed(number.dtype.str, str(number.shape), number.tobytes())
            labels.append(hashed("own parameter", own[i]) if i in own else hashed("number", content))
            values += [hashed(own[i], content)] if i in own else []
    return _digits(*_trace(kind.model, kind.numbers, units, labels).pieces, *sorted(values))


def _digits(*parts: bytes | str) -> str:
    return hashed(*parts).hex()[:32]


def flaw(model: CuttingModel) -> str | None:
    """What is wrong with a model, as a clause on one of its methods; None where nothing is.

    Its methods are traced, not run: a model of NaN, or one whose cut never ends, passes.
    """
    recent = _by_place.get((id(model), "inch-pound"))
    is_known = recent is not None and recent[0]() is model
    return (None if is_known else _wrong_part(model)) or equations_of(model).flaw


def _wrong_part(model: CuttingModel) -> str | None:
    """What is wrong with a model before its methods are traced."""
    for leaf in jax.tree.leaves(model):
        if not callable(leaf) and not is_number(leaf):
            return f"its own parameters must be numbers, arrays or functions, but one is {leaf!r}"
    for name, part in vars(model).items():
        if isinstance(part, type):
            return f"its part `{name}` must be made, as in {name}={part.__name__}(), but is the class {part.__name__}"
    for name in own_parameters(model):
        if name in QUANTITIES:
            return f"its own parameters must have other names than those of a case, but one is `{name}`"
    return None


class _Kind:
    """What models that differ in their numbers alone have in common, exactly: 2 and 2.0 differ, 0.0 and -0.0 too."""

    units: System

    def __init__(self, model: CuttingModel, units: System) -> None:
        leaves, structure = jax.tree.flatten(model)
        # An own parameter may be an array, with one number for each of many impacts; a whole number is one like others.
        own = {parameter.leaf for parameter in own_parameters(model).values()} if leaves else ()
        self.leaves = [None if is_number(leaf) else leaf for leaf in leaves]
        self.numbers = [
            jax.ShapeDtypeStruct((), np.float64) if i in own else _struct(leaf)
            for i, leaf in enumerate(leaves)
            if is_number(leaf)
        ]
        self.structure, self.units = structure, units
        shapes = tuple((number.shape, number.dtype) for number in self.numbers)
        self._key = _exact_structure(structure), tuple(map(_exactly, self.leaves)), shapes, units

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Kind) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def model(self, numbers: Sequence[Number]) -> CuttingModel:
        """The model with these numbers."""
        rest = iter(numbers)
        return jax.tree.unflatten(self.structure, [next(rest) if leaf is None else leaf for leaf in self.leaves])

    def traced(self) -> Equations:
        """The equations, as the code is now."""
        numbers = tuple(self.numbers)
        nodes, functions = list(_nodes(self.structure)), [leaf for leaf in self.leaves if leaf is not None]
        if not functions and all(kind in _PLAIN_NODES or _is_of_package(kind) for kind, _ in nodes):
            # The package's code does not change, and a short command need not wait for its trace.
            return Equations(None, _digits("package", repr(self._key)), "", Surroundings(()), numbers, None)
        things = [*functions, *(thing for node in nodes for thing in node)]
        try:
            trace = _trace(self.model, numbers, self.units)
        except _FlawError as error:
            return Equations(str(error), _digits("flaw", str(error)), "", Surroundings(things), numbers, None)
        # After the trace, which may change what it reads, such as a counter.
        surroundings, digest = Surroundings(things), _digits(*trace.pieces, trace.foreign)
        return Equations(None, digest, trace.foreign, surroundings, numbers, trace.state)


def _is_of_package(kind: type) -> bool:
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return file is not None and Path(file).is_relative_to(_PACKAGE)


def _struct(leaf: Number) -> jax.ShapeDtypeStruct:
    """Shape and type of a number of a model that is no own parameter."""
    dtype = np.asarray(leaf).dtype if not isinstance(leaf, (jax.Array, Tracer)) else leaf.dtype
    return jax.ShapeDtypeStruct(np.shape(leaf), np.float64 if dtype.kind == "f" else dtype)


def _nodes(structure: Structure) -> Iterator[tuple[type, object]]:
    """The classes of a pytree's nodes, and what they hold beside its leaves."""
    node = structure.node_data()
    if node is not None:
        yield node
        for child in structure.children():
            yield from _nodes(child)


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


class _FlawError(Exception):
    """The clause."""


class _Trace(NamedTuple):
    """The digests of what a model's methods give, what holds only in this process, and the state's structure."""

    pieces: list[str]
    foreign: str
    state: Structure


def _trace(
    model_of: Callable[[Sequence[Number]], CuttingModel],
    numbers: Sequence[jax.ShapeDtypeStruct],
    units: System,
    labels: Sequence[bytes] | None = None,
) -> _Trace:
    """Trace all methods of a model, and check what they give.

    Args:
        model_of: how the model is made, of its numbers.
        numbers: shapes and types of these.
        units: that the methods see.
        labels: what each number is; its place without it.
    """
    case = dataclasses.replace(TABLE_1, units=units)
    named = labels if labels is not None else [hashed("model", str(i)) for i in range(len(numbers))]
    digests: list[Digest] = []

    def given(name: str, method: Callable[..., PyTree], *state: PyTree) -> PyTree:
        """What a method of (model, p, …) gives."""
        arguments = list(numbers), case, *state
        beside = [hashed("beside", str(i)) for i in range(len(jax.tree.leaves(arguments[1:])))]
        try:
            digest = digest_of(lambda numbers, *rest: method(model_of(numbers), *rest), arguments, [*named, *beside])
        # A model's own code may raise anything, and may ask to end the program.
        except (Exception, SystemExit) as error:
            raise _FlawError(f"`{name}` fails{_where(error)}: {_said(error)}") from error
        digests.append(digest)
        return digest.results

    state = given("initial_state", lambda model, p: model.initial_state(p))
    _require_scalars("initial_state", state)
    given("derivative", lambda model, p, state: model.derivative(state, p), state)
    # Each compiled program, of values or derivatives, traces the rates once more.
    rate = given("derivative", lambda model, p, state: model.derivative(state, p), state)
    if jax.tree.structure(rate) != jax.tree.structure(state):
        raise _FlawError("`derivative` must give what `initial_state` gives, its rate, but gives something else")
    _require_scalars("derivative", rate)
    if digests[-1].text != digests[-2].text:
        raise _FlawError("`derivative` must give the same at each call, but its equations change")
    _require("tip", given("tip", lambda model, p, state: model.tip(state, p), state), Tip)
    _require("removal_rate", given("removal_rate", lambda model, p, state: model.removal_rate(state, p), state), None)
    events = given("events", lambda model, p, state: model.events(state, p), state)
    _require("events", events, dict)
    _require("removed_at_contact", given("removed_at_contact", lambda model, p: model.removed_at_contact(p)), None)
    _require("scales", given("scales", lambda model, p: model.scales(p)), Scales)
    foreign = next((digest.foreign for digest in digests if digest.foreign), "")
    return _Trace([digest.text for digest in digests] + sorted(events), foreign, jax.tree.structure(state))


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


def _require(name: str, given: PyTree, kind: type | None) -> None:
    if kind is not None and not isinstance(given, kind):
        raise _FlawError(f"`{name}` must give a {kind.__name__}, but gives a {type(given).__name__}")
    if kind is dict and not given:
        raise _FlawError(f"`{name}` must name at least one event, but is empty")
    _require_scalars(name, given)


def _require_scalars(name: str, given: PyTree) -> None:
    parts = jax.tree_util.tree_flatten_with_path(given)[0]
    if not parts:
        raise _FlawError(f"`{name}` must give numbers, but gives none")
    for path, leaf in parts:
        if leaf.shape or leaf.dtype.kind not in "fiu":
            part = jax.tree_util.keystr(path).lstrip(".") or "it"
            what = f"shape {leaf.shape}" if leaf.shape else f"type {leaf.dtype}"
            raise _FlawError(f"`{name}` must give real scalars, but {part} has {what}")
