"""Millions of impacts: the batch, with first and second derivatives.

`impact` computes arrays of them. `volume` is one traceable number, for use inside one's own
`jit`, `vmap` and `grad`.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import check_tolerance
from erosion.blocks import integrate, leaf_index
from erosion.clock import ENDED, NO_CUT, UNFINISHED
from erosion.integrator import Solution, solve
from erosion.jets import Derivatives
from erosion.model import CuttingModel
from erosion.models import load_model, model_name
from erosion.own_parameters import quantities
from erosion.parameters import QUANTITIES, Parameters, require_concrete, require_scalars, validate
from erosion.precision import require_float64
from erosion.quantities import derivative_row, result_row
from erosion.tables import Row, abbreviate, format_number, to_html, to_text

_TINY = 1e-14  # no tolerance is tighter: rounding is near


@dataclasses.dataclass(frozen=True)
class Impact:
    """Results of a batch of impacts; every array has the broadcast shape of the parameters.

    Args:
        model, p: what was computed.
        volume: removed volume [volume]; NaN where `ended_by` is "failed" or "unfinished".
        t_c: end of the cut [s]; 0 where nothing is cut.
        outcome: how the cut ended, as an index of `end_names(model)`; see `ended_by`.
        dvolume: ∂V/∂q for q = `wrt` [volume per unit of q], or None. With several names there
            is a last axis over them.
        d2volume: ∂²V/∂q² likewise; with several names two last axes, the matrix ∂²V/∂q_i∂q_j.
        wrt: the parameter(s) of the derivatives.
    """

    model: CuttingModel
    p: Parameters
    volume: Any
    t_c: Any
    outcome: Any
    dvolume: Any
    d2volume: Any
    wrt: str | tuple[str, ...]

    @functools.cached_property
    def ended_by(self) -> Any:
        """How the cut ended, "rebound", "stop", "no-cut" (or a plug-in's event), "failed" or "unfinished".

        Words take five times the memory of the numbers, so they are made when asked for.
        """
        return np.array(end_names(self.model))[self.outcome]

    def rows(self) -> list[Row]:
        """The results as rows of a table."""
        rows = [result_row("t_c", self.t_c, self.p.units), Row("ended_by", "", format_number(self.ended_by), "", "")]
        rows.append(result_row("volume", self.volume, self.p.units))
        if self.wrt == "alpha":
            found = {"dvolume": self.dvolume, "d2volume": self.d2volume}
            return rows + [result_row(name, value, self.p.units) for name, value in found.items() if value is not None]
        names = (self.wrt,) if isinstance(self.wrt, str) else self.wrt
        known = quantities(self.model)
        for name, value, order in (("dvolume", self.dvolume, 1), ("d2volume", self.d2volume, 2)):
            if value is None:
                continue
            for index in itertools.combinations_with_replacement(range(len(names)), order):
                part = value if isinstance(self.wrt, str) else value[(..., *index)]
                rows.append(derivative_row(name, part, [known[names[i]] for i in index], self.p.units))
        return rows

    def __repr__(self) -> str:
        names = ("t_c", "ended_by", "volume", "dvolume", "d2volume")
        values = [f"{name}={abbreviate(v)}" for name in names if (v := getattr(self, name)) is not None]
        return f"Impact({model_name(self.model)!r}, {', '.join(values)}, wrt={self.wrt!r}, p={self.p!r})"

    def __str__(self) -> str:
        return to_text(f"{model_name(self.model)}: {np.size(self.volume):,} impact(s)", self.rows())

    def _repr_html_(self) -> str:
        return to_html(f"{model_name(self.model)}: {np.size(self.volume):,} impact(s)", self.rows())


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
        ValueError: for parameters out of range or arguments that make no sense. NaN or
            infinity in an array is no error: like run-time failures of single impacts it is
            an outcome, in `ended_by`, and leaves the other impacts as they are.
    """
    require_float64()
    model = load_model(model)
    validate(p, batch=True)
    require_concrete(p)
    if not isinstance(wrt, (str, Sequence)):
        raise TypeError(f"Argument `wrt` must be the name of a parameter, or several, but is {wrt!r}.")
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    known = quantities(model)
    for name in names:
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"Argument `wrt` must name parameters ({', '.join(known)}), but has {name!r}.")
    if not names or len(set(names)) != len(names):
        raise ValueError(f"Argument `wrt` must name one or several different parameters, but is {wrt!r}.")
    if not isinstance(derivatives, (int, np.integer)) or derivatives not in (0, 1, 2):
        raise ValueError(f"Argument `derivatives` must be 0, 1 or 2, but is {derivatives!r}.")
    derivatives, rtol = int(derivatives), max(check_tolerance(rtol), _TINY)
    lanes, shape = _lanes(p)
    single = isinstance(wrt, str)
    if derivatives == 0 or (single and wrt in QUANTITIES):
        found = integrate(model, lanes, derivatives, names if derivatives else (), rtol)
        first, second = found.volume.first, found.volume.second
    else:
        found, first, second = _several(model, lanes, derivatives, names, rtol)
    tail = () if single else (len(names),)
    return Impact(
        model=model,
        p=p,
        volume=found.volume.value.reshape(shape)[()],
        t_c=found.time.value.reshape(shape)[()],
        outcome=outcome_codes(len(end_names(model)), found).reshape(shape)[()],
        dvolume=first.reshape(shape + tail)[()] if derivatives >= 1 else None,
        d2volume=second.reshape(shape + tail + tail)[()] if second is not None else None,
        wrt=wrt if isinstance(wrt, str) else names,
    )


@dataclasses.dataclass(frozen=True)
class PairDerivatives:
    """Derivatives of volume and end time along pairs of parameters; see `pair_derivatives`.

    Args:
        volume, t_c: `value` has the broadcast shape of the parameters; for a pair (q, w)
            `first` is ∂/∂q, `other` ∂/∂w and `second` ∂²/∂q∂w, with a last axis over pairs.
        ended_by: as in `Impact`.
    """

    volume: Derivatives
    t_c: Derivatives
    ended_by: Any


def pair_derivatives(
    model: CuttingModel, p: Parameters, pairs: Sequence[tuple[str, str]], rtol: float = 1e-9
) -> PairDerivatives:
    """First and second derivatives of volume and end time along pairs of parameters.

    A pair costs one lane for each impact, and one program serves all pairs. For other
    modules of the package: arguments are not checked.
    """
    lanes, shape = _lanes(p)
    found, volume, time = _along(model, lanes, 2, pairs, rtol)

    def shaped(derivatives: Derivatives) -> Derivatives:
        return Derivatives(*(part.reshape(shape + part.shape[1:]) for part in derivatives))

    return PairDerivatives(shaped(volume), shaped(time), outcomes(model, found).reshape(shape)[()])


def _lanes(p: Parameters) -> tuple[list[np.ndarray], tuple[int, ...]]:
    leaves = [np.asarray(getattr(p, name)) for name in QUANTITIES]
    shape = np.broadcast_shapes(*(leaf.shape for leaf in leaves))
    return [np.broadcast_to(leaf, shape).reshape(-1) for leaf in leaves], shape


def _several(
    model: CuttingModel, lanes: list[np.ndarray], order: int, names: tuple[str, ...], rtol: float
) -> tuple[Solution, np.ndarray, np.ndarray | None]:
    """Gradient and Hessian over several parameters."""
    if order == 1:
        found, volume, _ = _along(model, lanes, 1, [(name,) for name in names], rtol)
        return found, volume.first, None
    found, volume, _ = _along(model, lanes, 2, list(itertools.combinations_with_replacement(names, 2)), rtol)
    row, column = np.triu_indices(len(names))
    second = np.empty((lanes[0].size, len(names), len(names)))
    second[:, row, column] = second[:, column, row] = volume.second
    return found, volume.first[:, row == column], second


def _along(
    model: CuttingModel, lanes: list[np.ndarray], order: int, along: Sequence[tuple[str, ...]], rtol: float
) -> tuple[Solution, Derivatives, Derivatives]:
    """The lanes' solution, and derivatives of volume and time (lanes, along): names at order 1, pairs at 2."""
    leaves = np.array([[leaf_index(model, name) for name in names] for names in along])
    copies = jax.tree.map(lambda leaf: leaf.reshape(-1, len(along)), integrate(model, lanes, order, leaves.T, rtol))
    # A lane that fails along one direction fails.
    mode = copies.mode.max(axis=1)
    one: Solution = jax.tree.map(lambda leaf: leaf[:, 0], copies)._replace(mode=mode)

    def whole(value: Any, parts: Derivatives) -> Derivatives:
        ended = mode == ENDED
        return Derivatives(
            np.where(ended, value, np.nan),
            *(None if part is None else np.where(ended[:, None], part, np.nan) for part in parts[1:]),
        )

    volume, time = whole(one.volume.value, copies.volume), whole(one.time.value, copies.time)
    return one._replace(volume=volume, time=time), volume, time


# Never run: JAX keeps the traces of what is compiled, so that each kind of model is asked once.
@jax.jit
def _events(model: CuttingModel, p: Parameters) -> dict[str, Any]:
    return model.events(model.initial_state(p), p)


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished"."""
    one = Parameters(k=0.0, psi=0.0, r=0.0, b=0.0, m=0.0, v0=0.0, sigma=0.0, alpha=0.0)
    return (*jax.eval_shape(_events, model, one), "no-cut", "failed", "unfinished")


def outcomes(model: CuttingModel, found: Solution) -> np.ndarray:
    """How each lane ended, in words."""
    names = end_names(model)
    return np.array(names)[outcome_codes(len(names), found)]


def outcome_codes(count: int, found: Solution) -> np.ndarray:
    """How each lane ended: an index of the model's `count` `end_names`."""
    # The codes of the events are 0, 1, …; NO_CUT is -1, counted from the three last names.
    code = np.where(found.which == NO_CUT, count - 3, found.which)
    code = np.where(found.mode == ENDED, code, count - 2)
    return np.where(found.mode == UNFINISHED, count - 1, code).astype(np.int8)


def volume(model: CuttingModel | str | Path, p: Parameters) -> Any:
    """The removed volume of one impact, as a traceable number.

    Use it inside `jit`, `vmap`, `grad`, `jacfwd` and their compositions up to second order,
    with respect to any leaf of `p` (or of a model that has parameters of its own). Event
    times are differentiated exactly. Nothing is checked here: an impact that fails gives NaN,
    and parameters out of range (see `validate`) give numbers without meaning.

    Args:
        model: a model, its name, or the path of its file.
        p: parameters, all scalars.

    Returns:
        V [volume], a scalar.
    """
    require_float64()
    require_scalars(p, "; for many impacts use `erosion.impact`, or `jax.vmap`")
    flat, structure = jax.tree.flatten((load_model(model), p))
    return _volume(structure, [jnp.asarray(leaf, float) for leaf in flat])


_VOLUME_RTOL = 1e-11


def _solve(structure: Any, flat: list[Any], order: int, directions: tuple[Any, ...]) -> Derivatives:
    """The volume's derivatives along each of the directions, arrays of leaf indices (lanes,)."""
    model, p = jax.tree.unflatten(structure, flat)
    lanes = 1 if not directions else directions[0].shape[0]
    p = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes,)), p)
    return Solution.of(*solve(model, p, order, directions, _VOLUME_RTOL)).volume


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _volume(structure: Any, flat: list[Any]) -> Any:
    return _solve(structure, flat, 0, ()).value[0]


@functools.partial(_volume.defjvp, symbolic_zeros=True)
def _volume_jvp(structure: Any, primals: Any, tangents: Any) -> Any:
    (flat,), (rates,) = primals, tangents
    moving, moved = _moving(rates)
    return _volume(structure, flat), _slopes(structure, moving, flat) @ moved


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _slopes(structure: Any, leaves: tuple[int, ...], flat: list[Any]) -> Any:
    """∂V/∂(leaf i) for each i of `leaves`."""
    return _solve(structure, flat, 1, (jnp.asarray(leaves),)).first


@functools.partial(_slopes.defjvp, symbolic_zeros=True)
def _slopes_jvp(structure: Any, leaves: tuple[int, ...], primals: Any, tangents: Any) -> Any:
    (flat,), (rates,) = primals, tangents
    moving, moved = _moving(rates)
    return _slopes(structure, leaves, flat), _curvatures(structure, leaves, moving, flat) @ moved


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1, 2))
def _curvatures(structure: Any, leaves: tuple[int, ...], others: tuple[int, ...], flat: list[Any]) -> Any:
    """∂²V/∂(leaf i)∂(leaf j) for each i of `leaves` and j of `others`."""
    if leaves == others and len(leaves) == 1:
        directions = (jnp.asarray(leaves),)
    else:
        pairs = np.array(list(itertools.product(leaves, others)))
        directions = (jnp.asarray(pairs[:, 0]), jnp.asarray(pairs[:, 1]))
    second = _solve(structure, flat, 2, directions).second
    return second.reshape(len(leaves), len(others))


@_curvatures.defjvp
def _curvatures_jvp(structure: Any, leaves: Any, others: Any, primals: Any, tangents: Any) -> Any:
    raise NotImplementedError("erosion.volume has derivatives up to the second; the third is not available.")


def _moving(rates: list[Any]) -> tuple[tuple[int, ...], Any]:
    """Which leaves' tangents are not zero by construction, and these tangents."""
    zero = jax.custom_derivatives.SymbolicZero
    moving = tuple(i for i, rate in enumerate(rates) if not isinstance(rate, zero))
    return moving, jnp.stack([jnp.asarray(rates[i]) for i in moving])
