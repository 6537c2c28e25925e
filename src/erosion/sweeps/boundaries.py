"""Lines over two parameters across which the kind of a result changes, bisected where they cross a grid's lines."""

from collections.abc import Callable

import numpy as np
import xarray as xr

from erosion.impacts import alpha_max, impact, turned_beyond
from erosion.models import CuttingModel, with_values
from erosion.parameters import Parameters
from erosion.sweeps.grid import Grid, SweepOutputs

_HALVINGS = 12  # of the distance between neighbouring points: further than a print shows

_KindAt = Callable[[np.ndarray, np.ndarray], np.ndarray]
_KindsOf = Callable[[CuttingModel, Parameters, SweepOutputs], np.ndarray]


def boundary(x: np.ndarray, y: np.ndarray, kinds: np.ndarray, kind_at: _KindAt) -> np.ndarray:
    """The lines between regions of different kinds.

    Wherever neighbours in the grid are of two kinds, the change between them is found by bisection. Within a cell the
    changes on its sides are joined; three and more meet in their middle.

    Args:
        x: values along the second axis of the grid, shape (n,).
        y: values along the first, shape (m,).
        kinds: of each point, shape (m, n).
        kind_at: the kinds at points, arrays of x and y of one shape.

    Returns:
        Pieces of the lines, shape (pieces, 2, 2): their ends, x and y of each.
    """
    grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)
    sides = [(np.argwhere(kinds[:, 1:] != kinds[:, :-1]), (0, 1)), (np.argwhere(kinds[1:] != kinds[:-1]), (1, 0))]
    first = np.concatenate([at for at, _ in sides])
    second = np.concatenate([at + np.array(step) for at, step in sides])
    low, high = (grid[tuple(ends.T)] for ends in (first, second))
    own = kinds[tuple(first.T)]
    for _ in range(_HALVINGS if len(first) else 0):
        middle = (low + high) / 2
        same = (kind_at(*middle.T) == own)[:, None]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return _joined((low + high) / 2, first, second)


def _joined(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Points on the sides of cells, joined within each cell; `first` and `second` are the corners beside each."""
    by_cell: dict[tuple[int, int], list[np.ndarray]] = {}
    for point, (row, column), (next_row, _) in zip(points, first.tolist(), second.tolist(), strict=True):
        # A side along x belongs to the cells below and above it, one along y to those on its left and right.
        beside = ((row, column), (row - 1, column) if next_row == row else (row, column - 1))
        for cell in beside:
            by_cell.setdefault(cell, []).append(point)
    pieces = []
    for ends in by_cell.values():
        if len(ends) == 2:
            pieces.append(ends)
        elif len(ends) > 2:
            pieces += [[end, np.mean(ends, axis=0)] for end in ends]
    return np.array(pieces).reshape(-1, 2, 2)


def _ends(model: CuttingModel, p: Parameters, _: SweepOutputs) -> np.ndarray:
    return np.asarray(impact(model, p).ended_by)


def _turned(model: CuttingModel, p: Parameters, _: SweepOutputs) -> np.ndarray:
    return turned_beyond(model, p)


def _best(model: CuttingModel, p: Parameters, outputs: SweepOutputs) -> np.ndarray:
    optimum = alpha_max(model, p, max_turn=outputs.max_turn)
    return np.char.add(np.asarray(optimum.kind, str), np.asarray(optimum.ended_by, str))


_KINDS = {
    "end_boundary": (_ends, "where the end of the cut changes"),
    "turn_boundary": (_turned, "where the body turns by 90°"),
    "best_boundary": (_best, "where the kind of the optimum or the end of its cut changes"),
}


def with_turned(found: xr.Dataset, dims: tuple[str, ...], turned: np.ndarray) -> xr.Dataset:
    """The same with `turned_beyond`, whether the body turns by more than 90° in each cut."""
    said = {"long_name": "whether the body turns by more than 90°, where the model does not hold", "units": "1"}
    return found.assign(turned_beyond=(dims, turned, said))


def with_boundaries(grid: Grid, found: xr.Dataset) -> xr.Dataset:
    """A sweep with the cuts in which the body turns too far, and with the lines across which its results change.

    Args:
        grid: of the sweep.
        found: its results.

    Returns:
        The same with `turned_beyond`. Of one model over two parameters also with `end_boundary` and `turn_boundary`,
        and with `best_boundary` if it has a best angle at each point. A boundary holds pieces of lines: their two ends,
        in SI, whose names are along "axis".
    """
    shape = grid.shape
    of_model = shape[1:] if grid.compared else shape
    turned = [np.broadcast_to(turned_beyond(*grid.impacts(model)), of_model) for model in grid.loaded().values()]
    found = with_turned(found, grid.dims, np.reshape(turned, shape))
    if len(grid.dims) != 2 or grid.dims != tuple(grid.axes):
        return found
    (model,), (y, x) = grid.loaded().values(), grid.dims
    for name, (kinds_of, meaning) in _KINDS.items():
        if name == "best_boundary" and not ("alpha_max" in found and found.alpha_max.ndim == len(shape)):
            continue
        kinds = found.turned_beyond.values
        if kinds_of is not _turned:
            kinds = np.broadcast_to(kinds_of(*grid.impacts(model), grid.outputs), shape)

        def kind_at(across: np.ndarray, up: np.ndarray, kinds_of: _KindsOf = kinds_of) -> np.ndarray:
            return kinds_of(*with_values(model, grid.p, {x: across, y: up}), grid.outputs)

        pieces = boundary(grid.axes[x], grid.axes[y], kinds, kind_at)
        found = found.assign_coords(axis=[x, y]).assign(
            {name: ((f"{name}_piece", "end", "axis"), pieces, {"long_name": meaning})}
        )
    return found
