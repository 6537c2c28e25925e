"""Impacts, one or millions, with first and second derivatives: `erosion.impact`, and how an impact ended.

A code below the number of the model's events is an event, in the order of their names. The codes after these
are the others, in the order of `OTHER_ENDS`.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from erosion.arguments import ModelState, Number, PerImpact, Scalar, Structure, check_order, check_share
from erosion.lanes.engines import compile_lanes
from erosion.lanes.lanewise import Lanewise, number
from erosion.models import (
    CUT,
    NO_CUT,
    SI_CASE,
    Case,
    CuttingModel,
    State,
    impact_to_dict,
    load_model,
    model_name,
    own_parameters,
    own_quantities,
    quantities,
    require_one_impact,
    whole_cut,
)
from erosion.ode.batch import compiling, integrate, integrate_along
from erosion.ode.ensemble import LEAST_RTOL, Lanes
from erosion.ode.integrator import LaneEnd
from erosion.ode.outputs import StateOutputs
from erosion.ode.problem import TracedProblem, is_number
from erosion.ode.signature import Clock, Options, Signature
from erosion.ode.solution import Solution
from erosion.ode.solve import solution
from erosion.ode.step_control import LONGEST, require_float64
from erosion.ode.switches import switches_of, unlocated
from erosion.ode.traced import traced_end
from erosion.ode.variational import Derivatives
from erosion.output import Record, briefly, largest_of
from erosion.parameters import (
    QUANTITIES,
    Parameters,
    System,
    declare_derivative,
    declare_result,
    require_concrete,
    validate,
)
from erosion.results import Result, Value

_NAMES = tuple(QUANTITIES)


def signature_of(model: CuttingModel, p: Parameters, *, reports_state: bool = False) -> Signature:
    """The signature of model and case, which are made of the ten parameters and the model's own numbers.

    Args:
        model: the model.
        p: the case.
        reports_state: with a clock, the whole state at the end, and the quantities of the model's own.
    """
    case = Case(SI_CASE, model)
    equations = CUT.equations(case, ())
    leaves, structure = jax.tree.flatten(case)
    rest = tuple(None if is_number(leaf) else leaf for leaf in leaves)
    problem, options = (whole_cut(model), Options(outputs=StateOutputs())) if reports_state else (CUT, Options())
    signature = Signature(problem, structure, rest, *_shapes(equations), options, equations)
    located = signature.wanting(switches=True, arm_on_return=True)
    what = unlocated(located)
    if what:
        raise ValueError(
            f"Argument `model` must have breaks that can be located, but its equations have {what} that cannot: give a "
            "loop its derivative by `jax.custom_jvp`, or write smooth functions, such as `jnp.tanh`, or a table."
        )
    return signature if switches_of(located) is None else located


@functools.lru_cache(maxsize=256)
def _shapes(equations: TracedProblem) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
    """Shape and type of each number, for one lane."""
    return tuple(n.shape for n in equations.parameters), tuple(n.dtype.name for n in equations.parameters)


def split(model: CuttingModel, p: Parameters) -> tuple[Signature, list[PerImpact]]:
    """Signature and parameters of many impacts.

    The parameters of the case and the model's own may be arrays, with one number for each impact.
    Any other array is part of the model, the same for all impacts.
    """
    parameters = [getattr(p, name) for name in _NAMES] + [leaf for leaf in jax.tree.leaves(model) if is_number(leaf)]
    return signature_of(model, p), [leaf if isinstance(leaf, Tracer) else np.asarray(leaf) for leaf in parameters]


def lanes_of(model: CuttingModel, p: Parameters) -> tuple[Signature, list[np.ndarray], tuple[int, ...]]:
    """Signature, parameters and their broadcast shape; each number has one axis of lanes, or all lanes share it."""
    signature, parameters = split(model, p)
    require_concrete(dict(zip(names_of(model), parameters, strict=True)))
    varies = [number.ndim > 0 and shape == () for number, shape in zip(parameters, signature.shapes, strict=True)]
    if not any(varies):
        return signature, parameters, ()
    try:
        shape = np.broadcast_shapes(*(number.shape for number, many in zip(parameters, varies, strict=True) if many))
    except ValueError:
        shapes = ", ".join(str(number.shape) for number, many in zip(parameters, varies, strict=True) if many)
        raise ValueError(
            f"The model's own parameters must broadcast with the case's, but shapes are {shapes}."
        ) from None
    flat = [
        number if not many else number.reshape(()) if number.size == 1 else np.broadcast_to(number, shape).reshape(-1)
        for number, many in zip(parameters, varies, strict=True)
    ]
    return signature, flat, shape


def names_of(model: CuttingModel) -> tuple[str, ...]:
    """The name of each number of model and case; "" of an array that is none of the model's own parameters."""
    own = {parameter.leaf: name for name, parameter in own_parameters(model).items()}
    return _NAMES + tuple(own.get(i, "") for i, leaf in enumerate(jax.tree.leaves(model)) if is_number(leaf))


def element_of(model: CuttingModel, name: str) -> int:
    """The place of a parameter among the elements of all numbers."""
    if name in QUANTITIES:
        return _NAMES.index(name)
    own = own_parameters(model)
    scalars = {parameter.leaf for parameter in own.values()}
    before = jax.tree.leaves(model)[: own[name].leaf]
    return len(_NAMES) + sum(1 if i in scalars else np.size(leaf) for i, leaf in enumerate(before) if is_number(leaf))


_RTOL = 1e-11
_VOLUME = 1  # after the time


def volume(model: CuttingModel | str | Path, p: Parameters) -> Scalar:
    """The removed volume of one impact, as a traceable number.

    Use it inside `jit`, `vmap`, `grad`, `jacfwd`, `hessian` and their compositions up to second order,
    with respect to any leaf of `p` or of the model, arrays included. Event times are differentiated
    exactly. Nothing is checked here: an impact that fails gives NaN, a derivative that does not exist is NaN
    (`erosion.impact` says where, by `no_derivatives`), and parameters out of range (see `validate`) give
    numbers without meaning.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters, all scalars.

    Returns:
        V [m³], a scalar.
    """
    require_float64()
    model = load_model(model)
    require_one_impact(model, p, "; for many impacts use `erosion.impact`, or `jax.vmap`", traced=True)
    signature, parameters = split(model, p)
    return traced_end(signature, _RTOL, parameters)[_VOLUME]


OTHER_ENDS: Mapping[str, str] = {
    NO_CUT: "nothing is cut",
    "failed": "the motion or the volume is not finite, or no step of the motion is exact enough",
    "unfinished": f"no event ended the cut within {LONGEST:,.0f} time scales",
}
"""The ends that are no events, with a sentence on each."""

NO_DERIVATIVES = (
    "the volume is right, but an infinite rate of the force, or events at one time, leave it without these derivatives"
)
"""Of an impact that has a result where fewer derivatives are asked for."""


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished".

    The code of an outcome is an index of these.
    """
    return (*signature_of(model, SI_CASE).event_names, *OTHER_ENDS)


def tip_at(model: CuttingModel, p: Parameters, ys: np.ndarray) -> list[np.ndarray]:
    """Position and velocity of the tip, and dV/dt, at states with the volume, shape (times, quantities)."""
    signature, (_, parameters) = signature_of(model, p), split(model, p)
    with compiling:
        program = _tip_program(signature, jax.tree.structure(signature.state))
    results = [np.empty(len(ys)) for _ in range(5)]
    program.run([*(np.asarray(number, float) for number in parameters), *ys[:, :-1].T], np.arange(len(ys)), results)
    return results


@functools.lru_cache(maxsize=64)
def _tip_program(signature: Signature, structure: Structure) -> Lanewise:
    def lane(parameters: list[Number], leaves: list[Scalar]) -> list[Scalar]:
        p, model = signature.args(parameters)
        state = jax.tree.unflatten(structure, leaves)
        return [jnp.asarray(part, float) for part in (*model.tip(state, p), model.removal_rate(state, p))]

    return compile_lanes(lane, (signature.structs(), [number] * structure.num_leaves))


@dataclasses.dataclass(frozen=True, repr=False)
class Impact(Result):
    """Results of a batch of impacts; every array has the broadcast shape of the parameters.

    Args:
        model, p: what was computed.
        volume: removed volume [m³], also at contact; NaN only where `ended_by` is "failed" or "unfinished".
        t_c: end of the cut [s]; 0 where nothing is cut.
        outcome: how the cut ended, as an index of `end_names(model)`; see `ended_by`.
        dvolume: ∂V/∂q for q = `wrt` [m³ per SI unit of q], or None; NaN where it does not exist, see
            `no_derivatives`. With several names there is a last axis over them.
        d2volume: ∂²V/∂q² [m³ per SI unit of q, squared], or None; with several names there are two
            last axes, the matrix ∂²V/∂q_i∂q_j.
        wrt: the parameter(s) of the derivatives.
        rtol: relative tolerance.
    """

    model: CuttingModel
    p: Parameters
    volume: PerImpact
    t_c: PerImpact
    outcome: PerImpact
    dvolume: PerImpact
    d2volume: PerImpact
    wrt: str | tuple[str, ...]
    rtol: float = 1e-9

    @functools.cached_property
    def ended_by(self) -> PerImpact:
        """How the cut ended, "rebound", "stop", "no-cut" (or a plug-in's event), "failed" or "unfinished".

        Words take five times the memory of the numbers, so they are made when asked for.
        """
        return np.array(end_names(self.model))[self.outcome]

    @functools.cached_property
    def volume_at_contact(self) -> PerImpact:
        """The volume removed at contact by deformation, beside the cut [m³]; computed when first read."""
        signature, parameters, shape = lanes_of(self.model, self.p)

        def of_one(parameters: Sequence[Number]) -> Array:
            p, model = signature.args(parameters)
            return jnp.asarray(model.removed_at_contact(p), float)

        varies = [
            0 if number.ndim > len(own) else None for number, own in zip(parameters, signature.shapes, strict=True)
        ]
        removed = jax.vmap(of_one, (varies,))(parameters) if 0 in varies else of_one(parameters)
        return np.broadcast_to(removed, _count(shape)).reshape(shape)[()]

    @functools.cached_property
    def end(self) -> Solution:
        """The end of the cut as a solution of `erosion.ode`: the whole state, with derivatives.

        `end.y` is the model's own state, `end.along("alpha").y` its first derivatives by α and
        `end.along("alpha", "k").y` second ones, where as many were asked for. NaN where the impact has no result, and
        where a derivative does not exist. It is computed when first read.
        """
        order = 2 if self.d2volume is not None else 1 if self.dvolume is not None else 0
        _, parameters, shape = lanes_of(self.model, self.p)
        wide = signature_of(self.model, self.p, reports_state=True)
        clock = Clock(0.0, np.inf, np.inf, np.inf)
        lanes = Lanes(wide, [*parameters, *map(np.asarray, clock)], shape, (*names_of(self.model), *Clock._fields))
        wrt = (self.wrt,) if isinstance(self.wrt, str) else self.wrt
        return solution(lanes, wrt if order else (), order, self.rtol)

    @property
    def state(self) -> ModelState:
        """The model's own state at the end of the cut, a pytree of arrays; see `end`."""
        return self.end.y

    @property
    def turn(self) -> PerImpact:
        """How far the body turned, `|φ(t_c) - φ(0)|` [rad]; NaN of a model without an orientation; see `end`."""
        state = self.state
        if not isinstance(state, State):
            return np.full(np.shape(self.volume), np.nan)[()]
        return np.abs(state.phi - self.model.initial_state(self.p).phi)[()]

    @property
    def quantities(self) -> Mapping[str, PerImpact]:
        """The quantities of the model's own at the end of the cut, by name; see `erosion.own_quantity` and `end`."""
        return {name: self.end.integrals[name] for name in own_quantities(type(self.model))}

    @functools.cached_property
    def no_derivatives(self) -> np.ndarray | np.bool_:
        """Whether derivatives that were asked for are not known although the volume is; bool.

        They do not exist, or cannot be computed, where the rate of the force is infinite, or where a break of the force
        and the end are at one time. Across a kink or a jump they are computed.
        """
        missing = np.zeros(np.shape(self.volume), bool)
        for part in (self.dvolume, self.d2volume):
            if part is not None:
                missing |= np.isnan(part).any(axis=tuple(range(np.ndim(self.volume), np.ndim(part))))
        return (missing & np.isfinite(self.volume))[()]

    @property
    def shown_in(self) -> System:
        """Of the case."""
        return self.p.shown_in

    def declare(self) -> list[Value]:
        """Times, outcomes, volumes, the quantities of the model's own, and derivatives."""
        own, at_contact = own_quantities(type(self.model)), self.volume_at_contact
        lost = bool(np.any(self.no_derivatives))
        return [
            declare_result("t_c", self.t_c),
            Value("ended_by", self.ended_by, meaning="how the cut ends"),
            declare_result("volume", self.volume),
            declare_result("volume_at_contact", at_contact, only="" if largest_of(at_contact) else "data"),
            *(own[name].declare(name, value) for name, value in self.quantities.items()),
            *([Value("no_derivatives", self.no_derivatives, meaning=NO_DERIVATIVES)] if lost else []),
            *self._derivatives(),
        ]

    def _derivatives(self) -> Iterator[Value]:
        """The derivatives by the parameters; those by several have a name each, `dvolume_dk`."""
        known = quantities(self.model)
        if isinstance(self.wrt, str):
            yield Value("wrt", self.wrt, only="data")
        else:
            yield Value("wrt", [*self.wrt], dims=("wrt",), only="data")
        for name, value, order in (("dvolume", self.dvolume, 1), ("d2volume", self.d2volume, 2)):
            if value is None:
                continue
            if self.wrt == "alpha":
                yield declare_result(name, value)
                continue
            if isinstance(self.wrt, str):
                yield declare_derivative(name, value, [known[self.wrt]] * order)
                continue
            for index in itertools.combinations_with_replacement(range(len(self.wrt)), order):
                by = [self.wrt[i] for i in index]
                below = f"d{by[0]}2" if by[1:] == by[:1] else "_".join(f"d{each}" for each in by)
                yield declare_derivative(f"{name}_{below}", value[(..., *index)], [known[each] for each in by])

    @property
    def title(self) -> str:
        """The model, and how many impacts."""
        count = np.size(self.volume)
        return f"{model_name(self.model)}: {count:,} impact{'s' * (count != 1)}"

    @property
    def subject(self) -> Record:
        """The model and the case."""
        return impact_to_dict(self.model, self.p)


def impact(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    derivatives: int = 0,
    wrt: str | Sequence[str] = "alpha",
    rtol: float = 1e-9,
) -> Impact:
    """Compute many impacts at once: volume, end, and derivatives.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters whose leaves are scalars or arrays that broadcast.
        derivatives: 0, 1 or 2.
        wrt: the parameter, or several, of the derivatives: of the case, or the model's own.
        rtol: relative tolerance of volume, end time and derivatives.

    Returns:
        Results of the broadcast shape; scalars for scalar parameters.

    Raises:
        ValueError: for parameters out of range or invalid arguments. NaN or
            infinity in an array is no error: like run-time failures of single impacts it is
            an outcome, in `ended_by`, and leaves the other impacts as they are.
    """
    require_float64()
    model = load_model(model)
    validate(p, batch=True)
    if not isinstance(wrt, (str, Sequence)):
        raise TypeError(f"Argument `wrt` must be the name of a parameter, or several, but is {briefly(wrt)}.")
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    known = quantities(model)
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"Argument `wrt` must name parameters ({', '.join(known)}), but has {briefly(name)}.")
    if not names or len(set(names)) != len(names):
        raise ValueError(f"Argument `wrt` must name one or several different parameters, but is {briefly(wrt)}.")
    derivatives, rtol = check_order(derivatives), max(check_share("rtol", rtol), LEAST_RTOL)
    signature, parameters, shape = lanes_of(model, p)
    single = isinstance(wrt, str)
    if derivatives == 0 or (single and wrt in QUANTITIES):
        places = (element_of(model, names[0]),) if derivatives else ()
        results = integrate(signature, parameters, _count(shape), derivatives, places, rtol)
        first, second = volume_of(results).by_first, volume_of(results).mixed
    else:
        results, first, second = _several(model, signature, parameters, _count(shape), derivatives, names, rtol)
    tail = () if single else (len(names),)
    return Impact(
        model=model,
        p=p,
        volume=volume_of(results).value.reshape(shape)[()],
        t_c=results.time.value.reshape(shape)[()],
        outcome=results.outcome.reshape(shape)[()],
        dvolume=first.reshape(shape + tail)[()] if derivatives >= 1 else None,
        d2volume=second.reshape(shape + tail + tail)[()] if second is not None else None,
        wrt=wrt if isinstance(wrt, str) else names,
        rtol=rtol,
    )


@dataclasses.dataclass(frozen=True)
class PairDerivatives:
    """Derivatives of volume and end time along pairs of parameters; see `pair_derivatives`.

    Args:
        volume, t_c: `value` has the broadcast shape of the parameters; for a pair (q, w)
            `first` is ∂/∂q, `other` ∂/∂w and `second` ∂²/∂q∂w, with a last axis over pairs.
    """

    volume: Derivatives
    t_c: Derivatives


def pair_derivatives(
    model: CuttingModel, p: Parameters, pairs: Sequence[tuple[str, str]], rtol: float = 1e-9
) -> PairDerivatives:
    """First and second derivatives of volume and end time along pairs of parameters.

    For other modules of the package: arguments are not checked.
    """
    signature, parameters, shape = lanes_of(model, p)
    results = _along(model, signature, parameters, _count(shape), 2, pairs, rtol)

    def shaped(derivatives: Derivatives) -> Derivatives:
        return Derivatives(*(part.reshape(shape + part.shape[1:]) for part in derivatives))

    return PairDerivatives(shaped(volume_of(results)), shaped(results.time))


def volume_of(results: LaneEnd) -> Derivatives:
    """The removed volume, the one output of an impact."""
    return Derivatives(*(None if part is None else part[0] for part in results.outputs))


def _count(shape: tuple[int, ...]) -> int:
    return int(np.prod(shape, dtype=int))


def _several(
    model: CuttingModel,
    signature: Signature,
    parameters: list[np.ndarray],
    lanes: int,
    order: int,
    names: tuple[str, ...],
    rtol: float,
) -> tuple[LaneEnd, np.ndarray, np.ndarray | None]:
    """Gradient and Hessian over several parameters."""
    if order == 1:
        results = _along(model, signature, parameters, lanes, 1, [(name,) for name in names], rtol)
        return results, volume_of(results).by_first, None
    results = _along(
        model, signature, parameters, lanes, 2, list(itertools.combinations_with_replacement(names, 2)), rtol
    )
    row, column = np.triu_indices(len(names))
    second = np.empty((lanes, len(names), len(names)))
    second[:, row, column] = second[:, column, row] = volume_of(results).mixed
    return results, volume_of(results).by_first[:, row == column], second


def _along(
    model: CuttingModel,
    signature: Signature,
    parameters: list[np.ndarray],
    lanes: int,
    order: int,
    directions: Sequence[tuple[str, ...]],
    rtol: float,
) -> LaneEnd:
    """The lanes' results, with derivatives (lanes, directions) along names, or along pairs of names."""
    places = np.array([[element_of(model, name) for name in names] for names in directions], float).T
    results = integrate_along(signature, parameters, lanes, order, places, rtol)
    # A lane that fails along one direction fails in all.
    failed = np.any(signature.has_no_result(results.outcome), axis=1, keepdims=True)
    outcome = np.where(failed[:, 0], results.outcome.max(axis=1), results.outcome[:, 0])

    def of_lanes(parts: Derivatives) -> Derivatives:
        value, *rest = parts
        slopes = (None if part is None else np.where(failed, np.nan, part) for part in rest)
        return Derivatives(np.where(failed[:, 0], np.nan, value[:, 0]), *slopes)

    outputs = of_lanes(volume_of(results))
    listed = Derivatives(*(None if part is None else [part] for part in outputs))
    return results._replace(outcome=outcome, time=of_lanes(results.time), outputs=listed, trials=results.trials[:, 0])
