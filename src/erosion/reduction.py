"""A model's motion with fewer unknowns, found in its own arithmetic.

Where the rates of several parts of the state are known multiples of one expression, one
integral of that expression gives them all: a force of constant direction has ẋ, ẏ and (with the
horizontal torque) φ̇ follow from ∫ F_x dt. What nothing that matters depends on, as x itself,
need not be integrated at all.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun

from erosion.model import CuttingModel, Scales, Tip
from erosion.parameters import Parameters
from erosion.tracing import traced_once


def reduced(model: CuttingModel, p: Parameters) -> CuttingModel:
    """The same model, whose state is a tuple of integrals: as few as its arithmetic shows.

    Args:
        model: any; the result has the same leaves.
        p: scalars, whose values do not matter.
    """
    start = jax.eval_shape(lambda model, p: model.initial_state(p), model, p)
    leaves, structure = jax.tree.flatten(start)

    def look(model: CuttingModel, p: Parameters, leaves: list[Any]) -> list[Any]:
        state = jax.tree.unflatten(structure, leaves)
        needed = [*jax.tree.leaves(model.events(state, p)), model.removal_rate(state, p)]
        return [*jax.tree.leaves(model.derivative(state, p)), *needed]

    return _Reduced(model, _Unknowns(jax.make_jaxpr(look)(model, p, leaves), len(leaves)))


class _Reduced(CuttingModel):
    model: CuttingModel
    unknowns: "_Unknowns" = eqx.field(static=True)

    def initial_state(self, p: Parameters) -> tuple[Any, ...]:
        leaves = jax.tree.leaves(self.model.initial_state(p))
        return tuple(self._starts(leaves))

    @traced_once
    def derivative(self, state: Any, p: Parameters) -> tuple[Any, ...]:
        arguments = [*jax.tree.leaves((self.model, p)), *jax.tree.leaves(self._whole(state, p))]
        return tuple(self.unknowns.rates(*arguments))

    def tip(self, state: Any, p: Parameters) -> Tip:
        return self.model.tip(self._whole(state, p), p)

    @traced_once
    def events(self, state: Any, p: Parameters) -> dict[str, Any]:
        return self.model.events(self._whole(state, p), p)

    @traced_once
    def removal_rate(self, state: Any, p: Parameters) -> Any:
        return self.model.removal_rate(self._whole(state, p), p)

    def scales(self, p: Parameters) -> Scales:
        return self.model.scales(p)

    def _whole(self, integrals: tuple[Any, ...], p: Parameters) -> Any:
        """The model's own state; parts of it that do not matter stay as they were at contact."""
        leaves, structure = jax.tree.flatten(self.model.initial_state(p))
        starts = self._starts(leaves)
        for i, index, factor in self.unknowns.follow(*jax.tree.leaves((self.model, p)), *leaves):
            leaves[i] = leaves[i] + factor * (integrals[index] - starts[index])
        for i, integral in zip(self.unknowns.itself, integrals, strict=True):
            if i is not None:
                leaves[i] = integral
        return jax.tree.unflatten(structure, leaves)

    def _starts(self, leaves: list[Any]) -> list[Any]:
        """The integrals at contact: of a part of the state, that part; else zero."""
        return [jnp.zeros(()) if i is None else leaves[i] for i in self.unknowns.itself]


class _Product(NamedTuple):
    """An expression taken apart: sign · times/over · core."""

    sign: float
    times: list[Any]
    over: list[Any]
    core: Any


class _Unknowns:
    """Which expressions to integrate, and how the parts of the state follow from them.

    Args:
        closed: of (known …, state …); gives the state's rates, then what else matters.
        parts: of the state.
    """

    def __init__(self, closed: ClosedJaxpr, parts: int) -> None:
        self._made_by = {made: equation for equation in closed.jaxpr.eqns for made in equation.outvars}
        arguments, outputs = closed.jaxpr.invars, closed.jaxpr.outvars
        state = arguments[len(arguments) - parts :]
        self._state = set(state)
        self._known = _known(closed.jaxpr, self._state)
        rates = dict(zip(state, outputs[:parts], strict=True))
        matter: set[Any] = set()
        while (more := matter | self._inputs([*outputs[parts:], *(rates[part] for part in matter)])) > matter:
            matter = more
        moving = [i for i, part in enumerate(state) if part in matter and not _is_zero(rates[part])]
        products = {i: self._product(rates[state[i]]) for i in moving}
        groups: dict[tuple[int, int], list[int]] = {}
        for i, product in products.items():
            # A part that relaxes keeps its digits only as an integral of its own.
            alone = state[i] in self._inputs([rates[state[i]]])
            # Cores by identity: JAX's literals cannot be compared.
            groups.setdefault((i, 0) if alone else (-1, id(product.core)), []).append(i)
        cores = []
        self.itself: list[int | None] = []  # the part of the state that an integral is, if it is one
        self._follow: list[tuple[int, int, _Product]] = []
        for index, group in enumerate(groups.values()):
            # Several parts follow an integral from zero: from one part's start the others lose digits.
            itself = group[0] if len(group) == 1 else None
            cores.append(products[group[0]].core if itself is None else rates[state[itself]])
            self.itself.append(itself)
            self._follow += [(i, index, products[i]) for i in group if i != itself]
        self.rates = _evaluate(closed, cores)
        self._factors = _evaluate(
            closed, [part for *_, product in self._follow for part in (*product.times, *product.over)]
        )

    def follow(self, *arguments: Any) -> list[tuple[int, int, Any]]:
        """For each part of the state that is no integral itself: which one it follows, how many times."""
        values = iter(self._factors(*arguments))
        found = []
        for i, index, product in self._follow:
            times = math.prod([next(values) for _ in product.times], start=product.sign)
            over = math.prod([next(values) for _ in product.over], start=1.0)
            found.append((i, index, times / over))
        return found

    def _product(self, core: Any) -> _Product:
        """Takes known factors off an expression as long as there are any."""
        sign, times, over = 1.0, [], []
        while not self._is_known(core) and core in self._made_by:
            name, inputs = self._made_by[core].primitive.name, self._made_by[core].invars
            if name == "neg":
                sign, core = -sign, inputs[0]
            elif name == "mul" and any(map(self._is_known, inputs)):
                factor, core = inputs if self._is_known(inputs[0]) else reversed(inputs)
                times.append(factor)
            elif name == "div" and self._is_known(inputs[1]):
                core = inputs[0]
                over.append(inputs[1])
            else:
                break
        return _Product(sign, times, over, core)

    def _is_known(self, value: Any) -> bool:
        return isinstance(value, Literal) or value in self._known

    def _inputs(self, values: Iterable[Any]) -> set[Any]:
        """What of the state some values depend on."""
        found: set[Any] = set()
        waiting = [value for value in values if not self._is_known(value)]
        while waiting:
            value = waiting.pop()
            if value not in found:
                found.add(value)
                equation = self._made_by.get(value)
                waiting += [atom for atom in equation.invars if not self._is_known(atom)] if equation else []
        return found & self._state


def _known(jaxpr: Jaxpr, state: set[Any]) -> set[Any]:
    """What does not depend on the state."""
    known = {*jaxpr.constvars, *jaxpr.invars} - state
    for equation in jaxpr.eqns:
        if all(isinstance(atom, Literal) or atom in known for atom in equation.invars):
            known |= set(equation.outvars)
    return known


def _is_zero(value: Any) -> bool:
    return isinstance(value, Literal) and bool(value.val == 0)


def _evaluate(closed: ClosedJaxpr, wanted: list[Any]) -> Callable[..., list[Any]]:
    """A function of the arguments: some values, and nothing else."""
    needed = {value for value in wanted if not isinstance(value, Literal)}
    kept = []
    for equation in reversed(closed.jaxpr.eqns):
        if not needed.isdisjoint(equation.outvars):
            kept.append(equation)
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return jaxpr_as_fun(ClosedJaxpr(closed.jaxpr.replace(eqns=kept[::-1], outvars=wanted), closed.consts))
