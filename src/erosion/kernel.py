"""Millions of impacts: the batch, with first and second derivatives.

`impact` walks many lanes in blocks that stay in a core's cache, one thread a core. `volume`
is one traceable number, for use inside one's own `jit`, `vmap` and `grad`.
"""

import concurrent.futures
import dataclasses
import functools
import itertools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from erosion.integrator import ENDED, NO_CUT, UNFINISHED, Solution, solve
from erosion.jets import Derivatives
from erosion.model import CuttingModel
from erosion.models import load_model, model_name
from erosion.parameters import QUANTITIES, Parameters, validate
from erosion.precision import require_float64
from erosion.quantities import result_row
from erosion.tables import Row, format_number, to_html, to_text

_BLOCK = 256  # lanes of a block on a CPU: their stages fit the second-level cache
_CHUNK = 256  # blocks of one call, walked one after another
_TINY = 1e-14  # no tolerance is tighter: rounding is near


@dataclasses.dataclass(frozen=True)
class Impact:
    """Results of a batch of impacts; every array has the broadcast shape of the parameters.

    Args:
        model, p: what was computed.
        volume: removed volume [volume]; NaN where `ended_by` is "failed" or "unfinished".
        t_c: end of the cut [s]; 0 where nothing is cut.
        ended_by: "rebound", "stop", "no-cut" (or a plug-in's event), "failed", "unfinished".
        dvolume: ∂V/∂q for q = `wrt` [volume per unit of q], or None. With several names there
            is a last axis over them.
        d2volume: ∂²V/∂q² likewise; with several names two last axes, the matrix ∂²V/∂q_i∂q_j.
        wrt: the parameter(s) of the derivatives.
    """

    model: CuttingModel
    p: Parameters
    volume: Any
    t_c: Any
    ended_by: Any
    dvolume: Any
    d2volume: Any
    wrt: str | tuple[str, ...]

    def rows(self) -> list[Row]:
        """The results as rows of a table."""
        rows = [result_row("t_c", self.t_c, self.p.units), Row("ended_by", "", format_number(self.ended_by), "", "")]
        rows.append(result_row("volume", self.volume, self.p.units))
        for name in ("dvolume", "d2volume"):
            value = getattr(self, name)
            if value is None:
                continue
            if self.wrt == "alpha":
                rows.append(result_row(name, value, self.p.units))
            else:
                rows.append(Row(name, "", format_number(value), "", f"with respect to {self.wrt}"))
        return rows

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
        wrt: the parameter, or several, of the derivatives.
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
    names = (wrt,) if isinstance(wrt, str) else tuple(wrt)
    for name in names:
        if name not in QUANTITIES:
            raise ValueError(f"Argument `wrt` must name parameters ({', '.join(QUANTITIES)}), but has {name!r}.")
    if not names or len(set(names)) != len(names):
        raise ValueError(f"Argument `wrt` must name one or several different parameters, but is {wrt!r}.")
    if derivatives not in (0, 1, 2):
        raise ValueError(f"Argument `derivatives` must be 0, 1 or 2, but is {derivatives!r}.")
    if not 0 < rtol < 1:
        raise ValueError(f"Argument `rtol` must be in (0, 1), but is {rtol}.")
    rtol = max(float(rtol), _TINY)
    leaves = [np.asarray(getattr(p, name)) for name in QUANTITIES]
    shape = np.broadcast_shapes(*(leaf.shape for leaf in leaves))
    lanes = [np.broadcast_to(leaf, shape).reshape(-1) for leaf in leaves]
    single = isinstance(wrt, str)
    if derivatives == 0 or single:
        fields = _run(model, lanes, derivatives, names, rtol)
        first, second = (fields.first, fields.second)
    else:
        fields, first, second = _several(model, lanes, derivatives, names, rtol)
    tail = () if single else (len(names),)
    return Impact(
        model=model,
        p=p,
        volume=fields.volume.reshape(shape)[()],
        t_c=fields.time.reshape(shape)[()],
        ended_by=_outcomes(model, fields).reshape(shape)[()],
        dvolume=first.reshape(shape + tail)[()] if derivatives >= 1 else None,
        d2volume=second.reshape(shape + tail + tail)[()] if derivatives == 2 else None,
        wrt=wrt if isinstance(wrt, str) else names,
    )


@functools.partial(jax.tree_util.register_dataclass, data_fields=["mode", "which", "time", "volume", "first", "second"],
                   meta_fields=[])  # fmt: skip
@dataclasses.dataclass
class _Fields:
    """What a block hands back, each of shape (lanes,)."""

    mode: Any
    which: Any
    time: Any
    volume: Any
    first: Any
    second: Any


def _several(
    model: CuttingModel, lanes: list[np.ndarray], order: int, names: tuple[str, ...], rtol: float
) -> tuple[_Fields, np.ndarray, np.ndarray]:
    """Gradient and Hessian over several parameters, a pass for each (pair)."""
    n, count = len(names), lanes[0].size
    first, second = np.empty((count, n)), np.empty((count, n, n))
    fields = None
    for i, name in enumerate(names):
        fields = _run(model, lanes, order, (name,), rtol)
        first[:, i], second[:, i, i] = fields.first, fields.second
    for i, j in itertools.combinations(range(n) if order == 2 else (), 2):
        mixed = _run(model, lanes, 2, (names[i], names[j]), rtol).second
        second[:, i, j] = second[:, j, i] = mixed
    assert fields is not None
    return fields, first, second


def _run(model: CuttingModel, lanes: list[np.ndarray], order: int, names: tuple[str, ...], rtol: float) -> _Fields:
    count = lanes[0].size
    results = _Fields(*(np.empty(count, dtype) for dtype in (np.int64, np.int64, float, float, float, float)))
    if not count:
        return results
    block = _block_size()
    capacity = block if count <= block else block * _CHUNK

    def work(begin: int) -> None:
        end = min(begin + capacity, count)
        # The last block is filled up with copies of its last lane.
        index = np.minimum(np.arange(begin, begin + capacity), end - 1)
        blocks = -(-(end - begin) // block)
        chunk = [lane[index].reshape(-1, block) for lane in lanes]
        out = _compiled_chunk()(model, chunk, blocks, order, names if order else (), rtol)
        for name in ("mode", "which", "time", "volume", "first", "second"):
            getattr(results, name)[begin:end] = np.asarray(getattr(out, name)).reshape(-1)[: end - begin]

    begins = range(0, count, capacity)
    if len(begins) == 1:
        work(0)
    else:
        with concurrent.futures.ThreadPoolExecutor(_threads()) as pool:
            list(pool.map(work, begins))
    return results


def _chunk(
    model: CuttingModel, lanes: list[Any], blocks: Any, order: int, names: tuple[str, ...], rtol: Any
) -> _Fields:
    """The first `blocks` blocks of a chunk, one after another; lanes are (blocks, block)."""

    def run(values: list[Any]) -> _Fields:
        # The physics does not depend on the unit system: one program serves all.
        p = Parameters(**dict(zip(QUANTITIES, values, strict=True)))
        return _fields(solve(model, p, order, names, rtol))

    def block(i: Any, done: _Fields) -> _Fields:
        out = run([values[i] for values in lanes])
        return jax.tree.map(lambda all_, some: lax.dynamic_update_index_in_dim(all_, some, i, 0), done, out)

    shapes = jax.eval_shape(run, [values[0] for values in lanes])
    empty = jax.tree.map(lambda leaf: jnp.zeros((lanes[0].shape[0], *leaf.shape), leaf.dtype), shapes)
    return lax.fori_loop(0, blocks, block, empty)


@functools.cache
def _compiled_chunk() -> Any:
    return jax.jit(_chunk, static_argnames=("order", "names"), compiler_options=_compiler_options())


def _compiler_options() -> dict[str, Any]:
    """Options worth a fifth of the time on a CPU, where this version of XLA knows them."""
    if jax.default_backend() != "cpu":
        return {}
    # Vectors as wide as the machine has them, and no splitting of one small loop over threads.
    options = {"xla_cpu_prefer_vector_width": 512, "xla_disable_hlo_passes": "cpu-parallel-task-assigner"}
    try:
        jax.jit(lambda x: x + 1.0, compiler_options=options)(1.0)
    except jax.errors.JaxRuntimeError:
        return {}
    return options


def _fields(solution: Solution) -> _Fields:
    volume = solution.volume
    nothing = jnp.zeros_like(volume.value)
    return _Fields(
        solution.mode.astype(jnp.int64),
        solution.which.astype(jnp.int64),
        solution.time.value,
        volume.value,
        nothing if volume.first is None else volume.first,
        nothing if volume.second is None else volume.second,
    )


def end_names(model: CuttingModel) -> tuple[str, ...]:
    """What `ended_by` may say for a model: its events, then "no-cut", "failed", "unfinished"."""
    one = Parameters(k=0, psi=0, r=0, b=0, m=0, v0=0, sigma=0, alpha=0)
    events = jax.eval_shape(lambda p: model.events(model.initial_state(p), p), one)
    return (*events, "no-cut", "failed", "unfinished")


def _outcomes(model: CuttingModel, fields: _Fields) -> np.ndarray:
    names = end_names(model)
    # The codes of the events are 0, 1, …; NO_CUT is -1, counted from the three last names.
    code = np.where(fields.which == NO_CUT, len(names) - 3, fields.which)
    code = np.where(fields.mode == ENDED, code, len(names) - 2)
    return np.array(names)[np.where(fields.mode == UNFINISHED, len(names) - 1, code)]


def _block_size() -> int:
    return _BLOCK if jax.default_backend() == "cpu" else _BLOCK * _CHUNK


def _threads() -> int:
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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
    flat, structure = jax.tree.flatten((load_model(model), p))
    return _volume(structure, [jnp.asarray(leaf, float) for leaf in flat])


_VOLUME_RTOL = 1e-11


def _solve(structure: Any, flat: list[Any], order: int, directions: tuple[Any, ...]) -> Derivatives:
    """The volume's derivatives along each of the directions, arrays of leaf indices (lanes,)."""
    model, p = jax.tree.unflatten(structure, flat)
    lanes = 1 if not directions else directions[0].shape[0]
    p = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes,)), p)
    return solve(model, p, order, directions, _VOLUME_RTOL).volume


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
