"""Sweeps of any problem of `erosion.ode`: a grid over numbers of its arguments."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr
from jaxtyping import PyTree

from erosion.arguments import Progress, no_progress, real_numbers, unit_of_labels
from erosion.impacts import code_version, numbers_in_words
from erosion.ode.ensemble import Part, lanes_of, path_of
from erosion.ode.outputs import StateOutputs
from erosion.ode.problem import OTHER_ENDS, Problem, is_number
from erosion.ode.signature import Clock, Options
from erosion.ode.solution import Solution
from erosion.ode.solve import solve
from erosion.ode.step_control import require_float64
from erosion.output import briefly
from erosion.sweeps.grid import AnyGrid, Region, Variable, flags
from erosion.sweeps.sweep import prepare_sweep
from erosion.version import __version__

_NOT_COMPUTED = "not-computed"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class ProblemGrid(AnyGrid):
    """A rectangle of lanes of one problem; `axes` are paths of numbers of `args`, or "t0" or "t1".

    Args:
        problem: the problem.
        args: of one lane.
        options: of `erosion.ode.solve`.
    """

    problem: Problem
    args: PyTree
    options: Mapping[str, Any]

    def __getitem__(self, region: Region) -> "ProblemGrid":
        """The block of this region."""
        axes = {name: values[cut] for (name, values), cut in zip(self.axes.items(), region, strict=True)}
        return dataclasses.replace(self, axes=axes)

    def variables(self) -> dict[str, Variable]:
        """The arrays; `ended_by` comes last."""
        one = self.solved({name: values[:1] for name, values in self.axes.items()})
        ends = (_NOT_COMPUTED, *(name.replace(" ", "_") for name in self.problem.events), *OTHER_ENDS)
        numbers = {name: Variable(self.dims, {}) for name in self._columns(one)}
        return {**numbers, "ended_by": Variable(self.dims, flags(ends))}

    def solve(self) -> dict[str, np.ndarray]:
        """Integrate every lane."""
        return {name: np.reshape(values, self.shape) for name, values in self._columns(self.solved(self.axes)).items()}

    def solved(self, axes: Mapping[str, np.ndarray]) -> Solution:
        """The solution over some values of the axes."""
        values = {
            name: values.reshape([-1 if i == place else 1 for i in range(len(axes))])
            for place, (name, values) in enumerate(axes.items())
        }
        clock = {name: values.pop(name) for name in ("t0", "t1") if name in values}
        paths, structure = jax.tree_util.tree_flatten_with_path(self.args)
        leaves = [values.get(".".join(path_of(keys)), leaf) for keys, leaf in paths]
        options: dict[str, Any] = {**self.options, **clock}
        return solve(self.problem, jax.tree.unflatten(structure, leaves), **options)

    def _columns(self, solution: Solution) -> dict[str, np.ndarray]:
        """The numbers of lanes by name: "t", "y_vx", "integrals_work", "dt_dangle", …; `ended_by` comes last."""
        columns = {**_numbers("{}", solution), "count": np.asarray(solution.count, float)}
        columns["inexact"] = np.asarray(solution.inexact, float)
        for names, part in solution.derivatives.items():
            columns |= _numbers(("d2{}_d" if len(names) == 2 else "d{}_d") + "_d".join(names), part)
        return {**columns, "ended_by": np.asarray(solution.outcome, np.int8) + np.int8(1)}

    def frame(self) -> xr.Dataset:
        """Coordinates and provenance."""
        options = {name: value for name, value in self.options.items() if value is not None and np.size(value)}
        words = {"title": "A sweep of an ODE", "args": repr(self.args), "options": repr(options)}
        attributes = {"Conventions": "CF-1.11", "source": f"erosion {__version__}", **words}
        return xr.Dataset(coords={name: (name, axis) for name, axis in self.axes.items()}, attrs=attributes)

    @functools.cached_property
    def identity(self) -> dict[str, str]:
        """In words, what the numbers depend on.

        Raises:
            ValueError: for a problem that computes by what only this process knows.
        """
        numbers = {name: leaf for name, leaf in _by_path(self.args).items() if is_number(leaf)}
        clock = Clock(0.0, 1.0, math.inf, math.inf)
        lanes = lanes_of(
            self.problem, self.args, clock, Options(outputs=StateOutputs()), self.options.get("shared", ())
        )
        equations = lanes.signature.equations
        if equations.process_local:
            raise ValueError(
                "Argument `problem` must compute by JAX alone where a store is given, but holds "
                f"{equations.process_local}."
            )
        return {
            "version": code_version(),
            "problem": equations.digest,
            "args": numbers_in_words(numbers),
            "axes": numbers_in_words(self.axes),
            "options": numbers_in_words(_by_path(self.options)),
        }


def _by_path(tree: PyTree) -> dict[str, Any]:
    """The leaves of a pytree by their paths; numbers as arrays, which are told to their last bit."""
    leaves: dict[str, Any] = {}
    for keys, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = ".".join(path_of(keys))
        # Names that are joined may be equal.
        name = name if name not in leaves else jax.tree_util.keystr(keys)
        leaves[name] = np.asarray(leaf) if is_number(leaf) else leaf
    return leaves


def _numbers(label: str, part: Part | Solution) -> dict[str, np.ndarray]:
    """Times, states and integrals by name; an array of a state by its elements."""
    numbers = {label.format("t"): np.asarray(part.t)}
    for keys, leaf in jax.tree_util.tree_flatten_with_path({"y": part.y})[0]:
        name = label.format("_".join(path_of(keys)))
        if name in numbers:
            raise ValueError(f"The state's parts must have names of their own, but two are called {name!r}.")
        own = np.shape(leaf)[np.ndim(part.t) :]
        for index in np.ndindex(own):
            numbers["_".join((name, *map(str, index)))] = np.asarray(leaf)[(..., *index)]
    return numbers | {label.format(f"integrals_{name}"): np.asarray(values) for name, values in part.integrals.items()}


def sweep_problem(
    problem: Problem,
    args: PyTree,
    axes: Mapping[str, Any],
    *,
    chunks: Mapping[str, int] | None = None,
    store: str | Path | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> xr.Dataset:
    """Solve a problem over a grid: the product of the axes, in memory or block by block in a store.

        erosion.sweep_problem(shell, args, {"angle": angles, "drag": drags}, t1=100.0, store="shell.zarr")

    Args:
        problem: a problem of `erosion.ode`.
        args: of one lane: numbers, and arrays that are named in `shared`.
        axes: by the path of a number of `args` (dots between), or "t0" or "t1", one-dimensional values.
        chunks: as of `erosion.sweep`.
        store: as of `erosion.sweep`; the same call goes on with an interrupted sweep.
        progress: as of `erosion.sweep`.
        **options: of `erosion.ode.solve`: t1, wrt, derivatives, rtol, max_events, …

    Returns:
        t, count, inexact (0 or 1), each part of the state ("y_vx"), integrals, derivatives ("dt_dangle",
        "d2t_dangle_ddrag") and ended_by (codes, see its attributes) over the axes.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`) that holds something
            else and stays as it is.
        SweepInterrupted: after Ctrl-C, if there is a store.
    """
    require_float64()
    if "ts" in options:
        raise ValueError("Argument `ts` must be left out of a sweep; make `t1` an axis.")
    known = [".".join(path_of(keys)) for keys, leaf in jax.tree_util.tree_flatten_with_path(args)[0] if is_number(leaf)]
    if both := {"t0", "t1"} & set(axes) & set(known):
        raise ValueError(f"Argument `axes` must say which {min(both)!r} is meant: there is one among `args` as well.")
    arrays = {name: _axis(name, values, (*known, "t0", "t1")) for name, values in axes.items()}
    if not arrays:
        raise ValueError("Argument `axes` must name at least one number, but is empty.")
    grid = ProblemGrid(axes=arrays, problem=problem, args=args, options=options)
    one = grid.solved({name: values[:1] for name, values in arrays.items()})
    if np.shape(one.t) != (1,) * len(arrays):
        raise ValueError("Argument `args` must be of one lane; give arrays as axes, or name them in `shared`.")
    if both := set(arrays) & set(grid.variables()):
        raise ValueError(f"Argument `axes` must not be called as a result is, but has {min(both)!r}.")
    return prepare_sweep(grid, chunks=chunks, store=store).run(progress)


def _axis(name: str, values: Any, known: Sequence[str]) -> np.ndarray:
    """The values of an axis."""
    if name not in known:
        raise ValueError(f"Argument `axes` must name numbers of `args` ({', '.join(known)}), but has {briefly(name)}.")
    array = real_numbers(f"axes[{name!r}]", values, unit=unit_of_labels(values))  # in whatever unit the problem has
    if array.ndim != 1 or not array.size or not np.isfinite(array).all():
        raise ValueError(f"Argument `axes` must hold lists of finite numbers, but {name!r} is {briefly(values)}.")
    return array
