"""A problem: how a state moves, what happens to it on the way, what is wanted; its trace for each kind of arguments.

A problem is what it computes. Its digest is that of its traced functions, and programs know a problem by this digest,
wherever its source is. A helper that is defined anew gives another digest; an edited docstring gives the same.
"""

import abc
import dataclasses
import functools
import inspect
import re
import struct
import sys
import traceback
import types
from collections.abc import Callable, Hashable, Mapping, Sequence
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, ParamSpec, TypeGuard, TypeVar

import jax
import numpy as np
from jax.core import Tracer
from jax.extend.core import Literal
from jaxtyping import PyTree

from erosion.arguments import Number, Scalar, Structure
from erosion.lanes.digests import TRACED, CodeSnapshot, digest_of, hashed
from erosion.lanes.flatten import LIBRARIES
from erosion.lanes.jax_versions import forget_traces
from erosion.output.tables import briefly

_PACKAGE = Path(__file__).parents[1]
_MANY = 256  # kinds that are remembered


@dataclasses.dataclass(frozen=True, eq=False)
class TracedProblem:
    """The equations of one kind of arguments: of all that differ in their numbers alone.

    Args:
        error: what is wrong with them, as a clause on one of the functions; None where nothing is.
        digest: of what they compute from the numbers.
        process_local: what in them holds only in this process, such as a callback into Python; mostly "".
        snapshot: what the functions read beside their arguments.
        parameters: shape and type of each number of the arguments, for one lane.
        state: shapes and types of the state; None where it was not traced.
        timed: whether they depend on time.
    """

    error: str | None
    digest: str
    process_local: str
    snapshot: CodeSnapshot
    parameters: tuple[jax.ShapeDtypeStruct, ...]
    state: PyTree = None
    timed: bool = False


def is_number(leaf: object) -> TypeGuard[Number]:
    """Whether a leaf is a number or an array of numbers; truth values are, too."""
    if isinstance(leaf, (float, int)):
        return True
    return isinstance(leaf, (np.ndarray, np.generic, jax.Array, Tracer)) and np.dtype(leaf.dtype).kind in "fiub"


def flattened(argument: str, tree: PyTree) -> tuple[list[tuple[Any, Any]], Structure]:
    """The leaves of a pytree with their paths, and its structure; a `ValueError` where JAX cannot sort its keys."""
    try:
        return jax.tree_util.tree_flatten_with_path(tree)
    except ValueError:
        raise ValueError(
            f"Argument `{argument}` must have keys of one kind in each dictionary, such as words, "
            f"but is {briefly(tree)}."
        ) from None


def struct_of(leaf: Number) -> jax.ShapeDtypeStruct:
    """Shape and type of a number."""
    dtype = np.asarray(leaf).dtype if not isinstance(leaf, (jax.Array, Tracer)) else leaf.dtype
    return jax.ShapeDtypeStruct(np.shape(leaf), np.float64 if dtype.kind == "f" else dtype)


def digits(*parts: bytes | str) -> str:
    """A digest of some parts."""
    return hashed(*parts).hex()[:32]


class TreeKind(abc.ABC):
    """What pytrees that differ in their numbers alone have in common, exactly: 2 and 2.0 differ, 0.0 and -0.0 too.

    Args:
        tree: the pytree.
        parameters: shape and type of each of its numbers.
        beside: what else must be the same.
    """

    def __init__(self, tree: PyTree, parameters: Sequence[jax.ShapeDtypeStruct], *beside: object) -> None:
        leaves, self.structure = jax.tree.flatten(tree)
        self.leaves = [None if is_number(leaf) else leaf for leaf in leaves]
        self.parameters = tuple(parameters)
        shapes = tuple((number.shape, number.dtype) for number in self.parameters)
        self.key = _exact_structure(self.structure), _exactly(self.leaves), shapes, _exactly(beside)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and isinstance(other, TreeKind) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def joined(self, parameters: Sequence[Number | jax.ShapeDtypeStruct]) -> Any:
        """The pytree with these numbers, or with their shapes."""
        rest = iter(parameters)
        return jax.tree.unflatten(self.structure, [next(rest) if leaf is None else leaf for leaf in self.leaves])

    @abc.abstractmethod
    def traced(self) -> TracedProblem:
        """The equations, as the code is now."""


_by_kind: dict[TreeKind, TracedProblem] = {}


def equations_of(kind: TreeKind, *, anew: bool = False) -> TracedProblem:
    """The equations as the code is now; they are traced where the kind is new or was redefined, or always if `anew`."""
    known = _by_kind.get(kind)
    if known is not None and known.snapshot.unchanged():
        if not anew:
            return known
    elif known is not None:
        forget_traces()  # JAX, too, remembers what functions within have computed
    equations = kind.traced()
    _by_kind.pop(kind, None)
    _by_kind[kind] = equations
    while len(_by_kind) > _MANY:
        _by_kind.pop(next(iter(_by_kind)), None)
    return equations


class FunctionError(Exception):
    """The mistake in a user's function, as a clause."""


class Traced:
    """Traces a user's functions one after the other, and checks what they give.

    Args:
        made: the arguments, made of their numbers.
        parameters: shapes and types of these.
        labels: what each number is.

    Attributes:
        pieces: a digest of each function and its name.
        process_local: what in them holds only in this process.
    """

    def __init__(
        self,
        made: Callable[[Sequence[Number]], Any],
        parameters: Sequence[jax.ShapeDtypeStruct],
        labels: Sequence[bytes],
    ) -> None:
        self._made, self._parameters, self._labels = made, list(parameters), labels
        self.pieces: list[str] = []
        self.process_local = ""

    def given(self, name: str, function: Callable[..., PyTree], *state: PyTree) -> PyTree:
        """Shapes and types of what a function of (args, …) gives."""
        beside = [hashed("beside", str(i)) for i in range(len(jax.tree.leaves(state)))]
        try:
            digest = digest_of(
                lambda parameters, *rest: function(self._made(parameters), *rest),
                (self._parameters, *state),
                [*self._labels, *beside],
            )
        # A user's own code may raise anything, and may ask to end the program.
        except (Exception, SystemExit) as error:
            raise FunctionError(f"`{name}` fails{_where(error)}: {_said(error)}") from error
        if digest.process_local == TRACED:
            raise FunctionError(f"`{name}` reads a number that JAX traces outside of it; give the number by `args`")
        self.pieces.append(digits(name, digest.text))
        self.process_local = self.process_local or digest.process_local
        return digest.results


def require_numbers(name: str, given: PyTree, *, scalars: bool = True, double: bool = False) -> None:
    """Refuse what is no pytree of real numbers; of `double` precision, where it must be.

    Raises:
        FunctionError: with the part that is none.
    """
    parts = jax.tree_util.tree_flatten_with_path(given)[0]
    if not parts:
        raise FunctionError(f"`{name}` must give numbers, but gives {_shown(given)}")
    for path, leaf in parts:
        part, kind = jax.tree_util.keystr(path).lstrip(".") or "it", leaf.dtype.kind
        if (leaf.shape and scalars) or kind not in "fiu":
            what = f"type {leaf.dtype}" if kind not in "fiu" else f"shape {leaf.shape}"
            raise FunctionError(f"`{name}` must give real {'scalars' if scalars else 'numbers'}, but {part} has {what}")
        if not leaf.size:
            raise FunctionError(f"`{name}` must give numbers, but {part} has shape {leaf.shape}")
        if double and kind == "f" and leaf.dtype.itemsize < 8:
            raise FunctionError(f"`{name}` must give numbers of double precision, but {part} has type {leaf.dtype}")


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
    if dataclasses.is_dataclass(value) and not isinstance(value, type) and not _is_module(value):
        slots = [name for one in kind.__mro__ for name in vars(one).get("__slots__", ()) if hasattr(value, name)]
        return kind, *((name, _exactly(getattr(value, name))) for name in (*getattr(value, "__dict__", ()), *slots))
    return Same(value)


def _is_module(value: object) -> bool:
    """Whether it is a module of equinox, which whoever has one has imported."""
    equinox = sys.modules.get("equinox")
    return equinox is not None and isinstance(value, equinox.Module)


class Same:
    """Equal where it holds the same object."""

    def __init__(self, thing: Any) -> None:
        self.thing = thing

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self.thing is other.thing

    def __hash__(self) -> int:
        return id(self.thing)

    def __repr__(self) -> str:
        # Classes, and what equinox puts in the place of a field without a value, are the same in every process.
        kind = self.thing if isinstance(self.thing, type) else type(self.thing)
        is_named = kind is self.thing or (kind.__module__.startswith("equinox.") and not vars(self.thing))
        return repr(self.thing) if is_named else f"{self.thing!r} {id(self.thing)}"


def _said(error: BaseException) -> str:
    """What went wrong; where JAX says it about tracers, what to write instead."""
    # All tell that a number's value is asked for, while JAX traces the method and there is none.
    if isinstance(error, jax.errors.ConcretizationTypeError | jax.errors.TracerArrayConversionError):
        return (
            "it asks for the value of a number while JAX traces it; write `jnp.where(condition, a, b)` for `if`, "
            "and functions of jax.numpy for those of numpy and math"
        )
    no_number = re.search(r"returned a value of type <class '([\w.]+)'>.*not a valid JAX type", str(error))
    if no_number:
        return f"it gives a value of type {no_number[1]}, which is no number"
    return named(error)


def named(error: BaseException) -> str:
    """The kind of an error and what it says, on one line, as the end of a sentence."""
    said = " ".join(str(error).split())
    return f"{type(error).__name__}: {said if len(said) <= 200 else said[:200] + ' …'}".rstrip(".: ")


def _where(error: BaseException) -> str:
    """The last line of the user's own code on the way to an error: " in line 9 of kink.py"."""
    packages = (str(_PACKAGE), *LIBRARIES)
    own = [
        frame for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith((*packages, "<frozen", "<string"))
    ]  # fmt: skip
    return f" in line {own[-1].lineno} of {Path(own[-1].filename).name}" if own else ""


_MEANT = {
    "atol": "`state_scale`", "abstol": "`state_scale`", "reltol": "`rtol`", "stepsize_controller": "`rtol`",
    "solver": "`method`",
    "t_span": "`t0` and `t1` of `ode.solve`", "tspan": "`t0` and `t1` of `ode.solve`", "t_eval": "`ts` of `ode.solve`",
    "dense_output": "`ts`, or call the solution", "saveat": "`ts`", "y0": "`Problem.y0`", "u0": "`Problem.y0`",
    "events": "`Problem.events`",
    "event": "`Problem.events`", "callback": "`Problem.events`", "fun": "`Problem.vector_field`",
    "f": "`Problem.vector_field`", "terms": "`Problem.vector_field`", "condition": "`function`", "affect": "`reset`",
    "first_step": "`Problem.time_scale`",
    "dt0": "`Problem.time_scale`", "adjoint": "`Solution.gradient` or `jax.grad`",
}  # fmt: skip
"""Words of scipy, diffrax and DifferentialEquations.jl, and what to use here."""

_Asked = ParamSpec("_Asked")
_Given = TypeVar("_Given")


def in_these_words(function: Callable[_Asked, _Given]) -> Callable[_Asked, _Given]:
    """The function, with a sentence for an argument that it does not have."""
    known = [name for name in inspect.signature(function).parameters if name not in ("self", "_")]
    called = f"ode.{function.__qualname__.removesuffix('.__init__')}"

    @functools.wraps(function)
    def asked(*args: _Asked.args, **options: _Asked.kwargs) -> _Given:
        for name in options:
            if name not in known:
                hint = f"use {_MEANT[name]}" if name in _MEANT else f"it has {', '.join(known)}"
                raise TypeError(f"Argument `{name}` is none of `{called}`; {hint}.")
        return function(*args, **options)

    return asked


Rate = Callable[[Scalar, PyTree, Any], PyTree]
"""A function of time, state and arguments."""


_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


_BESIDE = ("integrals", "index")
"""Arguments that functions of events may have beside (t, y, args)."""


def sees_integrals(function: Callable[..., Any]) -> bool:
    """Whether a function of (t, y, args) also has an argument named `integrals`, the running integrals by name."""
    return "integrals" in _parameters(function)


def _parameters(function: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """The arguments of a function by name; none where Python cannot tell."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def evaluated(function: Callable[..., PyTree], t: Scalar, y: PyTree, args: Any, **beside: Any) -> PyTree:
    """The value of an event's function or reset, with those of the others that it has as arguments."""
    own = _parameters(function)
    return function(t, y, args, **{name: value for name, value in beside.items() if name in own})


def _unchanged(t: Scalar, y: PyTree, args: Any) -> PyTree:
    return y


@dataclasses.dataclass(frozen=True, eq=False)
class Event:
    """Something that happens where a function passes through zero, or at times.

    Args:
        function: of (t, y, args); a number, smooth near its zeros. It may also have an argument named `integrals`,
            the running integrals by name; so may `reset`.
        direction: +1 where only a rise through zero counts, -1 a fall, 0 either.
        reset: of (t, y, args), the state after the event, from which the motion goes on.
        times: in place of a function the times of the event, in any order: numbers, or a function of args that gives
            them; there may be none. Those before `t0` are left out, and one at `t0` counts. Of equal times the first
            counts first; derivatives are those of this order. A reset may also have an argument named `index`, the
            place among them.
        terminal: whether the event ends the motion; a whole number n says that the n-th does, before its reset. By
            default an event ends it unless it has a reset. With False and no reset it is recorded, see
            `Solution.events`, and the motion goes on.
    """

    function: Callable[..., PyTree] | None = None
    direction: int = 0
    reset: Callable[..., PyTree] | None = None
    _: dataclasses.KW_ONLY
    times: PyTree = None
    terminal: int | None = None

    def __post_init__(self) -> None:
        if (self.function is None) == (self.times is None):
            raise TypeError(
                f"Argument `function` or `times` must be given, and not both, but they are {briefly(self.function)} "
                f"and {briefly(self.times)}."
            )
        for name in ("function", "reset"):
            given = getattr(self, name)
            if given is None:
                continue
            if not callable(given):
                raise TypeError(f"Argument `{name}` must be a function of (t, y, args), but is {briefly(given)}.")
            known = _BESIDE if name == "reset" and self.times is not None else _BESIDE[:1]
            others = [each for each in _parameters(given).values() if each.default is each.empty][3:]
            if unknown := [each.name for each in others if each.kind in _POSITIONAL and each.name not in known]:
                raise TypeError(
                    f"Argument `{name}` must take (t, y, args), the running integrals by an argument named "
                    f"`integrals`, and a reset at `times` their place by `index`, but it has `{unknown[0]}`."
                )
        is_one = isinstance(self.direction, (int, float, np.number)) and not isinstance(self.direction, bool)
        if not is_one or self.direction not in (-1, 0, 1):
            raise ValueError(f"Argument `direction` must be -1, 0 or 1, but is {briefly(self.direction)}.")
        if self.direction and self.times is not None:
            raise ValueError(f"Argument `direction` must be left out with `times`, but is {briefly(self.direction)}.")
        is_whole = self.terminal is None or isinstance(self.terminal, (bool, int, np.integer))
        if not is_whole or self.last < 0 or (self.last == 1 and self.reset is not None):
            raise ValueError(
                "Argument `terminal` must be True, False or a whole number, and with a reset False or at least 2, as "
                f"the event that ends the motion has none, but is {briefly(self.terminal)}."
            )
        for name, own in (("direction", self.direction), ("terminal", self.last)):
            if isinstance(self.function, types.FunctionType) and getattr(self.function, name, own) != own:
                raise ValueError(
                    f"Argument `function` must have no other `{name}` than the event, as scipy alone reads it: say "
                    "`ode.Event(function, direction, terminal=…)`; without a reset an event ends the motion."
                )

    @property
    def last(self) -> int:
        """The count of the event that ends the motion, 3 for the third; 0 if none ends it."""
        return int(self.reset is None if self.terminal is None else self.terminal)

    def after(self) -> Callable[..., PyTree] | None:
        """The state after the event, a function; None where the motion ends with the first."""
        return None if self.last == 1 else self.reset or _unchanged

    def times_of(self, args: Any) -> PyTree:
        """The times of the event; ∞ where there are none."""
        times = self.times(args) if callable(self.times) else self.times
        return times if times is None or any(map(np.size, jax.tree.leaves(times))) else [np.inf]


_OF_ARGS = ("y0", "integrals0", "time_scale", "parameter_scale", "breaks")
"""What a problem says of the arguments alone; all else is of (t, y, args)."""

_TIMES = ".times"  # ends the words for the times of an event

OTHER_ENDS = ("start", "failed", "unfinished", "t1")
"""What `ended_by` may say beside the names of events; a code is an index of events and then these."""


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """dy/dt = f(t, y, args) from y0, with events and integrals, for one lane of many.

    All functions are written for one lane with `jax.numpy`; `y` and `args` are any pytrees.

    Args:
        y0: the state at the start, a pytree of real numbers and small arrays, or a function of args.
        vector_field: f(t, y, args), a pytree of the structure of y.
        events: by name. Of two at once the first comes first; the other happens if its function still passes zero
            with the state after it, and the motion goes on.
        integrals: by name rates r(t, y, args); ∫ r dt is integrated along with y.
        integrals0: a function of args, by name where the integrals begin; zero without it.
        time_scale: a function of args, a typical time of the motion, such as a tenth of a period, for the first step;
            3 % of t1 - t0 without it.
        parameter_scale: a function of args, a pytree like args of typical changes, by which derivatives are scaled;
            their own sizes without it.
        breaks: times at which rates or integrals break by time alone and which `solve` cannot see, as within a `scan`:
            numbers, or a function of args that gives them. A step ends at each of them; derivatives by them follow.
    """

    y0: PyTree
    vector_field: Rate
    events: Mapping[str, Event] = dataclasses.field(default_factory=dict)
    integrals: Mapping[str, Rate] = dataclasses.field(default_factory=dict)
    _: dataclasses.KW_ONLY
    integrals0: Callable[[Any], Mapping[str, Any]] | None = None
    time_scale: Callable[[Any], Any] | None = None
    parameter_scale: Callable[[Any], Any] | None = None
    breaks: PyTree = None

    def __post_init__(self) -> None:
        if not callable(self.vector_field):
            raise TypeError(
                f"Argument `vector_field` must be a function of (t, y, args), but is {briefly(self.vector_field)}."
            )
        if not callable(self.y0):
            flattened("y0", self.y0)
        for name, kind in (("events", Event), ("integrals", None)):
            given = getattr(self, name)
            if not isinstance(given, Mapping):
                raise TypeError(f"Argument `{name}` must be a dictionary by name, but is {briefly(given)}.")
            for key, part in given.items():
                if not isinstance(key, str) or not (isinstance(part, kind) if kind else callable(part)):
                    what = "an `ode.Event`" if kind else "a function of (t, y, args)"
                    raise TypeError(f"Argument `{name}` must hold by name {what}, but {key!r} is {briefly(part)}.")
        for name in ("integrals0", "time_scale", "parameter_scale"):
            if (given := getattr(self, name)) is not None and not callable(given):
                raise TypeError(f"Argument `{name}` must be a function of args, but is {briefly(given)}.")
        for name, event in self.events.items():
            if not name.strip():
                raise ValueError(f"Argument `events` must have names, but has {briefly(name)}.")
            if name in OTHER_ENDS:
                raise ValueError(
                    f"Argument `events` must have other names than {', '.join(OTHER_ENDS)}, but has {briefly(name)}."
                )
            if not self.integrals and any(map(sees_integrals, filter(None, (event.function, event.reset)))):
                raise ValueError(
                    f"Argument `integrals` must name the integrals that event {name!r} takes, but is empty."
                )

    def start(self, args: Any) -> PyTree:
        """The state at the start."""
        return self.y0(args) if callable(self.y0) else self.y0

    def integrals_at_start(self, args: Any) -> Mapping[str, Any]:
        """Initial values of the integrals, by name."""
        return dict.fromkeys(self.integrals, 0.0) if self.integrals0 is None else self.integrals0(args)

    def break_times(self, args: Any) -> PyTree:
        """Times at which rates break."""
        return self.breaks(args) if callable(self.breaks) else self.breaks

    def event_names(self, args: Any) -> tuple[str, ...]:
        """The events, in the order in which they count."""
        return tuple(self.events)

    def directions(self, args: Any) -> tuple[int, ...]:
        """The direction of each event."""
        return tuple(event.direction if event.times is None else 1 for event in self.events.values())

    def event_values(self, t: Scalar, y: PyTree, args: Any, integrals: Mapping[str, Any]) -> Sequence[Scalar]:
        """The functions of all events; the time for those at times."""
        functions = [event.function for event in self.events.values()]
        return [t if each is None else evaluated(each, t, y, args, integrals=integrals) for each in functions]

    def resets(self) -> Sequence[Callable[..., PyTree] | None]:
        """The state after each event; None where the motion ends with the first."""
        return [event.after() for event in self.events.values()]

    def scheduled(self) -> Sequence[int]:
        """The events at times."""
        return [i for i, event in enumerate(self.events.values()) if event.times is not None]

    def equations(self, args: PyTree, parameters: Sequence[jax.ShapeDtypeStruct]) -> TracedProblem:
        """The equations for arguments of this kind.

        Args:
            args: a pytree; of its numbers only the places count.
            parameters: shape and type of each, for one lane.
        """
        return equations_of(_ProblemKind(self, args, parameters))

    def functions(self) -> dict[str, Any]:
        """The functions of the problem, by the words that messages use."""
        parts: dict[str, Any] = {"vector_field": self.vector_field}
        for name, event in self.events.items():
            own = {"": event.function, ".reset": event.reset, _TIMES: event.times}
            parts |= {f"events[{name!r}]{of}": part for of, part in own.items() if part is not None}
        parts |= {f"integrals[{name!r}]": rate for name, rate in self.integrals.items()}
        others = {name: getattr(self, name) for name in _OF_ARGS}
        return parts | {name: part for name, part in others.items() if part is not None}

    def __repr__(self) -> str:
        y = "a function" if callable(self.y0) else jax.tree.map(lambda _: "…", self.y0)
        return f"Problem(y0={y}, events={list(self.events)}, integrals={list(self.integrals)})"


def _says_so(kind: Any) -> None:
    kind.__init__ = in_these_words(kind.__init__)


_says_so(Event)
_says_so(Problem)


class _ProblemKind(TreeKind):
    """What problems with arguments that differ in their numbers alone have in common."""

    def __init__(self, problem: Problem, args: PyTree, parameters: Sequence[jax.ShapeDtypeStruct]) -> None:
        self.problem, self._functions = problem, problem.functions()
        super().__init__(args, parameters, self._functions, self._described(args))

    def _described(self, args: Any) -> Sequence[object]:
        problem = self.problem
        last = [event.last for event in problem.events.values()]
        return problem.event_names(args), problem.directions(args), last, list(problem.integrals)

    def traced(self) -> TracedProblem:
        """The equations, as the code is now."""
        things = [*jax.tree.leaves(self._functions), *(leaf for leaf in self.leaves if leaf is not None)]
        labels = [hashed("argument", str(i)) for i in range(len(self.parameters))]
        trace = Traced(self.joined, self.parameters, labels)
        try:
            state, timed = self._trace(trace)
        except FunctionError as error:
            words = str(error)
            return TracedProblem(words, digits("error", words), "", CodeSnapshot(things), self.parameters)
        # After the trace, which may change what it reads, such as a counter.
        snapshot = CodeSnapshot(things)
        args = self.joined(self.parameters)
        described = repr(self._described(args))
        digest = digits(*trace.pieces, trace.process_local, described, str(jax.tree.structure(state)), str(timed))
        return TracedProblem(None, digest, trace.process_local, snapshot, self.parameters, state, timed)

    def _trace(self, trace: Traced) -> tuple[PyTree, bool]:
        """Shapes of the state, and whether anything depends on time."""
        problem, time = self.problem, jax.ShapeDtypeStruct((), np.float64)
        y = trace.given("y0", problem.start)
        require_numbers("y0", y, scalars=False)
        y = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, np.float64), y)
        beside = {"integrals": dict.fromkeys(problem.integrals, time), "index": jax.ShapeDtypeStruct((), np.int32)}
        of_state = {
            name: _of_args_and_state(name, function)
            for name, function in self._functions.items()
            if name not in _OF_ARGS and not name.endswith(_TIMES)
        }
        for name, function in of_state.items():
            given = trace.given(name, function, time, y, beside)
            if name == "vector_field" or name.endswith(".reset"):
                _require_like_state(name, given, y)
            else:
                if jax.tree.structure(given).num_leaves != 1:
                    raise FunctionError(f"`{name}` must give one number, but gives {_shown(given)}")
                require_numbers(name, given, double=True)
                kind = jax.tree.leaves(given)[0].dtype
                if name.startswith("events[") and kind.kind != "f":
                    raise FunctionError(f"`{name}` must pass through zero, but gives whole numbers ({kind})")
        if problem.integrals0 is not None:
            given = trace.given("integrals0", problem.integrals0)
            require_numbers("integrals0", given)
            if not isinstance(given, Mapping) or set(given) != set(problem.integrals):
                raise FunctionError(f"`integrals0` must give a number for each of {', '.join(problem.integrals)}")
        if problem.time_scale is not None:
            require_numbers("time_scale", trace.given("time_scale", problem.time_scale))
        of_time = {
            f"events[{name!r}]{_TIMES}": event.times_of
            for name, event in problem.events.items()
            if event.times is not None
        }
        for name, times in (of_time | ({} if problem.breaks is None else {"breaks": problem.break_times})).items():
            require_numbers(name, trace.given(name, times), scalars=False)
        if problem.parameter_scale is not None:
            given = trace.given("parameter_scale", problem.parameter_scale)
            if jax.tree.structure(given) != self.structure:
                raise FunctionError("`parameter_scale` must give a pytree like the arguments, but gives another")

        def everything(time: Any, parameters: Sequence[Number], y: PyTree, beside: PyTree) -> list[PyTree]:
            args = self.joined(parameters)
            return [function(args, time, y, beside) for function in of_state.values()]

        return y, bool(of_time) or _depends_on_first(everything, time, list(self.parameters), y, beside)


def _of_args_and_state(name: str, function: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """A function of a problem as one of (args, t, y, beside), of which only events see the last."""
    if name.startswith("events["):
        return lambda args, t, y, beside: evaluated(function, t, y, args, **beside)
    return lambda args, t, y, beside: function(t, y, args)


class Words(str):
    """Words that are printed without quotes in a pytree."""

    __slots__ = ()
    __repr__ = str.__str__


def _require_like_state(name: str, given: PyTree, y: PyTree) -> None:
    require_numbers(name, given, scalars=False, double=True)
    if jax.tree.structure(given) != jax.tree.structure(y):
        raise FunctionError(f"`{name}` must give what `y0` gives, {_shown(y)}, but gives {_shown(given)}")
    for (path, leaf), of_y in zip(jax.tree_util.tree_flatten_with_path(given)[0], jax.tree.leaves(y), strict=True):
        if leaf.shape != of_y.shape:
            part = jax.tree_util.keystr(path) or "it"
            raise FunctionError(f"`{name}` must have the shapes of `y0`, but {part} has {leaf.shape}, not {of_y.shape}")


def _shown(tree: PyTree) -> str:
    """What a pytree is: {'x': a number, 'y': an array of shape (3,)}."""
    words = [Words(f"an array of shape {leaf.shape}" if leaf.shape else "a number") for leaf in jax.tree.leaves(tree)]
    return "nothing (None)" if tree is None else repr(jax.tree.unflatten(jax.tree.structure(tree), words))


def _depends_on_first(function: Callable[..., PyTree], *examples: PyTree) -> bool:
    """Whether a result depends on the first argument, a number, by the function's arithmetic."""
    jaxpr = jax.make_jaxpr(function)(*examples).jaxpr
    needed = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    for equation in reversed(jaxpr.eqns):
        if not needed.isdisjoint(equation.outvars):
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return jaxpr.invars[0] in needed
