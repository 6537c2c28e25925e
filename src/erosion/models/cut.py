"""A cut as a problem of `erosion.ode`: what a model says, in the words of the integrator."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from erosion.array_types import Scalar
from erosion.models.base import CuttingModel
from erosion.models.equations import equations_of
from erosion.models.own_parameters import own_quantities
from erosion.ode.equations import Equations
from erosion.ode.problem import Event, Problem, Rate
from erosion.parameters.parameters import QUANTITIES, TABLE_1, Parameters


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
            typical=_typical,
        )

    def event_names(self, args: Case) -> tuple[str, ...]:
        """The events, by name."""
        p, model = args
        # JAX sorts the keys of a dictionary that passes through it; so is the order everywhere.
        return tuple(sorted(model.events(model.initial_state(p), p)))

    def directions(self, args: Case) -> tuple[int, ...]:
        """A cut ends where a function falls through zero."""
        return (-1,) * len(self.event_names(args))

    def event_values(self, t: Scalar, y: PyTree, args: Case) -> Sequence[Scalar]:
        """The functions of all events, by name."""
        values: Mapping[str, Any] = args.model.events(y, args.p)
        return [values[name] for name in sorted(values)]

    def equations(self, args: Case, numbers: Sequence[jax.ShapeDtypeStruct]) -> Equations:
        """What the model computes; the numbers are those of case and model, whichever are given."""
        return _of_case(equations_of(args.model, args.p.units))


# The same object each time, as what is kept for equations is known by them.
@functools.lru_cache(maxsize=256)
def _of_case(equations: Equations) -> Equations:
    """The equations of a model, whose numbers come after those of the case."""
    number = jax.ShapeDtypeStruct((), np.float64)
    return dataclasses.replace(equations, numbers=(*(number for _ in QUANTITIES), *equations.numbers))


def _typical(case: Case) -> Case:
    """One radian and the spin v₀/r; of all others their own size."""
    return case._replace(p=case.p.replace(alpha=1.0, phidot0=case.p.v0 / case.p.r))


CUT = Cut()
"""The problem of every impact."""

_with_own = functools.lru_cache(maxsize=256)(Cut)


def whole_cut(model: "CuttingModel") -> Cut:
    """The cut with the quantities of the model's own."""
    return _with_own(tuple(own_quantities(type(model))))


def problem_of(model: "CuttingModel") -> Problem:
    """The cut of one model as a problem of the parameters alone; see `CuttingModel.problem`."""

    def of(function: Rate) -> Rate:
        return lambda t, state, p: function(t, state, Case(p, model))

    def event(name: str) -> Rate:
        return lambda t, state, case: case.model.events(state, case.p)[name]

    cut, found = whole_cut(model), list[str]()
    zeros = dict.fromkeys(own_quantities(type(model)), 0.0)
    jax.eval_shape(lambda p: found.extend(cut.event_names(Case(p, model))), TABLE_1)
    return Problem(
        y0=lambda p: cut.start(Case(p, model)),
        vector_field=of(cut.vector_field),
        events={name: Event(of(event(name)), direction=-1) for name in found},
        integrals={name: of(rate) for name, rate in cut.integrals.items()},
        integrals0=lambda p: {"volume": model.removed_at_contact(p), **zeros},
        time_scale=lambda p: model.scales(p).time,
        typical=lambda p: _typical(Case(p, model)).p,
    )
