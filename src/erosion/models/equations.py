"""A model as a problem of `erosion.ode`: its equations, traced once for each kind of model, and their digest.

A model is what it computes. Its digest is that of its traced equations: initial state, rates, events, volume.
Programs and stores know a model by this digest, whatever its class is called and wherever its source is; see
`erosion.ode.equations`.
"""

import contextlib
import dataclasses
import functools
import sys
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.arguments import Scalar, Structure
from erosion.lanes.digests import CodeSnapshot, hashed
from erosion.models.base import (
    CuttingModel,
    Scales,
    Tip,
    own_parameters,
    own_quantities,
    typical_parameters,
)
from erosion.ode.problem import (
    FunctionError,
    Problem,
    Rate,
    Traced,
    TracedProblem,
    TreeKind,
    digits,
    equations_of as equations_of_kind,
    is_number,
    require_numbers,
    struct_of,
)
from erosion.output import briefly
from erosion.parameters import QUANTITIES, TABLE_1, Parameters

_PACKAGE = Path(__file__).parents[1]
SI_CASE = TABLE_1.to("si")
"""Any case, for what knows no numbers."""
_PLAIN_NODES = (tuple, list, dict, type(None))  # of pytrees


def equations_of(model: CuttingModel) -> TracedProblem:
    """The equations of a model as its code is now; they are traced where this kind of model is new or was redefined.

    Args:
        model: numbers among its leaves may be arrays, or JAX's tracers.
    """
    recent = _by_place.get(id(model))
    if recent is not None and recent[0]() is model and recent[1].snapshot.unchanged():
        return recent[1]
    return _kept(model, equations_of_kind(_ModelKind(model)))


# By a model's place in memory: a model does not change, and to tell its kind takes ten times longer.
_by_place: "dict[int, tuple[weakref.ref[CuttingModel], TracedProblem]]" = {}


def _kept(model: CuttingModel, equations: TracedProblem) -> TracedProblem:
    """The equations, which are found sooner from now on."""
    place = id(model)
    with contextlib.suppress(TypeError):  # of a class with `__slots__` there are no such references
        _by_place[place] = weakref.ref(model, lambda _: _by_place.pop(place, None)), equations
    return equations


def model_digest(model: CuttingModel) -> str:
    """The digest of a model with its numbers; the same in every process.

    Own parameters are known by name and value, other arrays by their numbers alone.

    Raises:
        ValueError: where the equations hold what only this process knows.
    """
    kind = _ModelKind(model)
    # As the code is now, also where something changed that `CodeSnapshot` does not see, such as a file that is read.
    equations = _kept(model, equations_of_kind(kind, anew=True))
    if equations.error is not None:
        raise ValueError(f"Argument `model` must be a model, but {equations.error}.")
    if equations.process_local:
        raise ValueError(
            "Argument `model` must compute by JAX alone where a store is given, but its equations hold "
            f"{briefly(equations.process_local)}."
        )
    labels, values = _labels(model)
    return digits(*_trace(kind, labels)[0].pieces, *sorted(values))


def plug_in_digest(model: CuttingModel) -> str:
    """The digest of what a plug-in computes, whatever its own parameters are.

    It is empty for the package's own models, whose code does not change, and where only this process knows it.
    """
    kind = _ModelKind(model)
    equations = equations_of_kind(kind, anew=True)
    if kind.is_of_package or equations.error is not None or equations.process_local:
        return ""
    return digits(*_trace(kind, _labels(model)[0])[0].pieces)


def _labels(model: CuttingModel) -> tuple[list[bytes], list[bytes]]:
    """What tells each number of a model: an own parameter's name, else its content; and names with values."""
    own = {parameter.leaf: name for name, parameter in own_parameters(model).items()}
    labels, values = list[bytes](), list[bytes]()
    for i, leaf in enumerate(jax.tree.leaves(model)):
        if is_number(leaf):
            number = np.asarray(leaf, float if i in own else struct_of(leaf).dtype)
            content = hashed(number.dtype.str, str(number.shape), number.tobytes())
            labels.append(hashed("own parameter", own[i]) if i in own else hashed("number", content))
            values += [hashed(own[i], content)] if i in own else []
    return labels, values


def error_in(model: CuttingModel) -> str | None:
    """What is wrong with a model, as a clause on one of its methods; None where nothing is.

    Its methods are traced, not run: a model of NaN, or one whose cut never ends, passes.
    """
    recent = _by_place.get(id(model))
    is_known = recent is not None and recent[0]() is model
    return (None if is_known else _wrong_part(model)) or equations_of(model).error


def _wrong_part(model: CuttingModel) -> str | None:
    """What is wrong with a model before its methods are traced."""
    for leaf in jax.tree.leaves(model):
        if not callable(leaf) and not is_number(leaf):
            return f"its own parameters must be numbers, arrays or functions, but one is {briefly(leaf)}"
    for name, part in vars(model).items():
        if isinstance(part, type):
            return f"its part `{name}` must be made, as in {name}={part.__name__}(), but is the class {part.__name__}"
    for name in own_parameters(model):
        if name in QUANTITIES:
            return f"its own parameters must have other names than those of a case, but one is `{name}`"
    return None


class _ModelKind(TreeKind):
    """What models that differ in their numbers alone have in common."""

    def __init__(self, model: CuttingModel) -> None:
        leaves = jax.tree.leaves(model)
        # An own parameter may be an array, with one number for each of many impacts; a whole number is one like others.
        own = {parameter.leaf for parameter in own_parameters(model).values()} if leaves else ()
        scalar = jax.ShapeDtypeStruct((), np.float64)
        parameters = [scalar if i in own else struct_of(leaf) for i, leaf in enumerate(leaves) if is_number(leaf)]
        super().__init__(model, parameters)
        self.of_class = type(model)

    @property
    def is_of_package(self) -> bool:
        """Whether all of its code is the package's, and no method of its classes was replaced."""
        kinds = {kind for kind, _ in _nodes(self.structure)} - {*_PLAIN_NODES}
        is_own = all(map(_is_of_package, kinds)) and all(leaf is None for leaf in self.leaves)
        return is_own and not CodeSnapshot((), self._classes).has_own

    @property
    def _classes(self) -> list[type]:
        """The package's classes among those of the model and its parts."""
        kinds = (one for kind, _ in _nodes(self.structure) for one in kind.__mro__)
        return [kind for kind in dict.fromkeys(kinds) if _is_of_package(kind)]

    def traced(self) -> TracedProblem:
        """The equations, as the code is now."""
        nodes, functions = list(_nodes(self.structure)), [leaf for leaf in self.leaves if leaf is not None]
        if self.is_of_package:
            # A short command need not wait for the trace of the package's code.
            snapshot = CodeSnapshot((), self._classes)
            return TracedProblem(None, digits("package", repr(self.key)), "", snapshot, self.parameters)
        things = [*functions, *(thing for node in nodes for thing in node)]
        try:
            trace, state = _trace(self, [hashed("model", str(i)) for i in range(len(self.parameters))])
        except FunctionError as error:
            return TracedProblem(
                str(error), digits("error", str(error)), "", CodeSnapshot(things, self._classes), self.parameters
            )
        # After the trace, which may change what it reads, such as a counter.
        snapshot, digest = CodeSnapshot(things, self._classes), digits(*trace.pieces, trace.process_local)
        return TracedProblem(None, digest, trace.process_local, snapshot, self.parameters, state)


def _is_of_package(kind: type) -> bool:
    """Whether a class is one of the package's."""
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return file is not None and Path(file).is_relative_to(_PACKAGE)


def _nodes(structure: Structure) -> Iterator[tuple[type, object]]:
    """The classes of a pytree's nodes, and what they hold beside its leaves."""
    node = structure.node_data()
    if node is not None:
        yield node
        for child in structure.children():
            yield from _nodes(child)


def _trace(kind: _ModelKind, labels: Sequence[bytes]) -> tuple[Traced, PyTree]:
    """The trace of all methods of a model, which are checked, and shapes and types of its state."""
    trace = Traced(kind.joined, kind.parameters, labels)

    def given(name: str, method: Callable[..., PyTree], *state: PyTree) -> PyTree:
        """What a method of (model, p, …) gives."""
        return trace.given(name, method, SI_CASE, *state)

    state = given("initial_state", lambda model, p: model.initial_state(p))
    require_numbers("initial_state", state)
    given("derivative", lambda model, p, state: model.derivative(state, p), state)
    # Each compiled program, of values or derivatives, traces the rates once more.
    rate = given("derivative", lambda model, p, state: model.derivative(state, p), state)
    if jax.tree.structure(rate) != jax.tree.structure(state):
        raise FunctionError("`derivative` must give what `initial_state` gives, its rate, but gives something else")
    require_numbers("derivative", rate)
    if trace.pieces[-1] != trace.pieces[-2]:
        raise FunctionError("`derivative` must give the same at each call, but its equations change")
    _require("tip", given("tip", lambda model, p, state: model.tip(state, p), state), Tip)
    _require("removal_rate", given("removal_rate", lambda model, p, state: model.removal_rate(state, p), state), None)
    events = given("events", lambda model, p, state: model.events(state, p), state)
    _require("events", events, dict)
    _require("removed_at_contact", given("removed_at_contact", lambda model, p: model.removed_at_contact(p)), None)
    for name in own_quantities(kind.of_class):
        rate = given(name, lambda model, p, state, name=name: getattr(model, name)(state, p), state)
        _require(name, rate, None)
    _require("scales", given("scales", lambda model, p: model.scales(p)), Scales)
    trace.pieces += sorted(events) + list(own_quantities(kind.of_class))
    return trace, state


def _require(name: str, given: PyTree, kind: type | None) -> None:
    if kind is not None and not isinstance(given, kind):
        raise FunctionError(f"`{name}` must give a {kind.__name__}, but gives a {type(given).__name__}")
    if kind is dict and not given:
        raise FunctionError(f"`{name}` must name at least one event, but is empty")
    require_numbers(name, given)


class Case(NamedTuple):
    """The arguments of a cut.

    Args:
        p: the parameters.
        model: the model.
    """

    p: Parameters
    model: CuttingModel


class Cut(Problem):
    """The cut of any model, which is among the arguments; see `Case`.

    Args:
        own: names of the quantities of the model's own that are integrated as well.
    """

    def __init__(self, own: Sequence[str] = ()) -> None:
        def rate_of(name: str) -> Rate:
            return lambda t, state, case: getattr(case.model, name)(state, case.p)

        zeros = dict.fromkeys(own, 0.0)
        super().__init__(
            y0=lambda case: case.model.initial_state(case.p),
            vector_field=lambda t, state, case: case.model.derivative(state, case.p),
            integrals={"volume": rate_of("removal_rate"), **{name: rate_of(name) for name in own}},
            integrals0=lambda case: {"volume": case.model.removed_at_contact(case.p), **zeros},
            time_scale=lambda case: case.model.scales(case.p).time,
            parameter_scale=lambda case: case._replace(p=typical_parameters(case.p)),
        )

    def event_names(self, args: Case) -> tuple[str, ...]:
        """The events, by name."""
        p, model = args
        # JAX sorts the keys of a dictionary that passes through it; so is the order everywhere.
        return tuple(sorted(model.events(model.initial_state(p), p)))

    def directions(self, args: Case) -> tuple[int, ...]:
        """A cut ends where a function falls through zero."""
        return (-1,) * len(self.event_names(args))

    def event_values(self, t: Scalar, y: PyTree, args: Case, integrals: Mapping[str, Any]) -> Sequence[Scalar]:
        """The functions of all events, by name."""
        values: Mapping[str, Any] = args.model.events(y, args.p)
        return [values[name] for name in sorted(values)]

    def equations(self, args: Case, parameters: Sequence[jax.ShapeDtypeStruct]) -> TracedProblem:
        """What the model computes; the numbers are those of case and model, whichever are given."""
        return _of_case(equations_of(args.model))


# The same object each time, as what is kept for equations is known by them.
@functools.lru_cache(maxsize=256)
def _of_case(equations: TracedProblem) -> TracedProblem:
    """The equations of a model, whose numbers come after those of the case."""
    number = jax.ShapeDtypeStruct((), np.float64)
    return dataclasses.replace(equations, parameters=(*(number for _ in QUANTITIES), *equations.parameters))


CUT = Cut()
"""The problem of every impact."""

_with_own = functools.lru_cache(maxsize=256)(Cut)


def whole_cut(model: CuttingModel) -> Cut:
    """The cut with the quantities of the model's own."""
    return _with_own(tuple(own_quantities(type(model))))
