"""Checks of a model before anything is computed with it, by the shapes of its methods' results."""

import functools
import re
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from erosion.array_types import Number, Structure
from erosion.models.base import CuttingModel, Scales, Tip
from erosion.models.own_parameters import own_parameters
from erosion.parameters.parameters import QUANTITIES, TABLE_1, Parameters

_Shape = tuple[tuple[int, ...], str]
_Model = tuple[Callable[..., CuttingModel], PyTree]  # how it is made, and of what numbers

_PACKAGE = Path(__file__).parents[1]


def flaw(model: CuttingModel) -> str | None:
    """What is wrong with a model, as a clause on one of its methods; None where nothing is.

    Its methods are traced, not run: a model of NaN, or one whose cut never ends, passes. Each
    kind of model is checked once.
    """
    leaves, structure = jax.tree.flatten(model)
    for leaf in leaves:
        is_number = isinstance(leaf, (int, float)) or (
            isinstance(leaf, (np.ndarray, np.generic, jax.Array)) and np.dtype(leaf.dtype).kind in "fiub"
        )
        if not callable(leaf) and not is_number:
            return f"its own parameters must be numbers, arrays or functions, but one is {leaf!r}"
    for name, part in vars(model).items():
        if isinstance(part, type):
            return f"its part `{name}` must be made, as in {name}={part.__name__}(), but is the class {part.__name__}"
    own = own_parameters(model)
    for name in own:
        if name in QUANTITIES:
            return f"its own parameters must have other names than those of a case, but one is `{name}`"
    # An array of an own parameter holds one number for each of many impacts.
    scalars = {parameter.leaf for parameter in own.values()}
    numbers = (
        (() if i in scalars else np.shape(leaf), str(jnp.result_type(leaf)))
        for i, leaf in enumerate(leaves)
        if not callable(leaf)
    )
    return _flaw(structure, tuple(leaf if callable(leaf) else None for leaf in leaves), tuple(numbers))


@functools.lru_cache(maxsize=1024)
def _flaw(structure: Structure, functions: tuple[Callable | None, ...], shapes: tuple[_Shape, ...]) -> str | None:
    def model_of(numbers: Sequence[Number]) -> CuttingModel:
        rest = iter(numbers)
        return jax.tree.unflatten(structure, [next(rest) if leaf is None else leaf for leaf in functions])

    model = model_of, [jax.ShapeDtypeStruct(*shape) for shape in shapes]
    try:
        state = _given("initial_state", lambda model, p: model.initial_state(p), model, TABLE_1)
        _require_scalars("initial_state", state)
        rate = _given("derivative", lambda model, p, state: model.derivative(state, p), model, TABLE_1, state)
        if jax.tree.structure(rate) != jax.tree.structure(state):
            raise _FlawError("`derivative` must give what `initial_state` gives, its rate, but gives something else")
        _require_scalars("derivative", rate)
        _require_steady(model, state)
        for name, kind in (("tip", Tip), ("removal_rate", None), ("events", dict)):
            given = _given(name, lambda model, p, state, n=name: getattr(model, n)(state, p), model, TABLE_1, state)
            _require(name, given, kind)
        _require(
            "removed_at_contact",
            _given("removed_at_contact", lambda model, p: model.removed_at_contact(p), model, TABLE_1),
            None,
        )
        _require("scales", _given("scales", lambda model, p: model.scales(p), model, TABLE_1), Scales)
    except _FlawError as error:
        return str(error)
    return None


class _FlawError(Exception):
    """The clause."""


def _given(
    name: str, method: Callable[..., PyTree], model: _Model, *arguments: PyTree, trace: Callable = jax.eval_shape
) -> PyTree:
    """What a method of (model, …) gives, for a model of given numbers; `trace` says of what kind the answer is."""
    model_of, numbers = model
    try:
        return trace(lambda numbers, *rest: method(model_of(numbers), *rest), numbers, *arguments)
    # A model's own code may raise anything, and may ask to end the program.
    except (Exception, SystemExit) as error:
        raise _FlawError(f"`{name}` fails{_where(error)}: {_said(error)}") from error


def _require_steady(model: _Model, state: PyTree) -> None:
    """The same equations at each call: each compiled program, of values or derivatives, traces them once more."""

    def derivative(model: CuttingModel, p: Parameters, state: PyTree) -> PyTree:
        return model.derivative(state, p)

    first, second = (_given("derivative", derivative, model, TABLE_1, state, trace=_equations) for _ in range(2))
    if first != second:
        raise _FlawError("`derivative` must give the same at each call, but its equations change")


def _equations(function: Callable[..., PyTree], *arguments: PyTree) -> str:
    """What is computed, as JAX writes it, without the places of functions in memory."""
    return re.sub(r" at 0x[0-9a-f]+", "", str(jax.make_jaxpr(function)(*arguments)))


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
