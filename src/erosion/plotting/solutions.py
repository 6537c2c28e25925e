"""The figure of a solution of `erosion.ode`: states over time."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from erosion.ode.solution import Solution
from erosion.plotting.colors import PALETTE
from erosion.plotting.style import axes_or_new, house_style

_MOST = 12  # lanes in one figure: more cannot be told from each other


@house_style()
def plot_solution(solution: Solution, names: Sequence[str] = (), ax: Axes | None = None) -> Axes:
    """Draw states over time, a line for each lane and each part of the state, and a mark where a lane ends.

    Args:
        solution: solved with `ts`.
        names: which parts of the state, by their path: "x", "body.vx"; all of them without it.
        ax: where to draw; a new figure without it.

    Returns:
        The axes.

    Raises:
        ValueError: without times, for names that are no parts of the state, or for more than 12 lanes.
    """
    if solution.times is None:
        raise ValueError("Argument `solution` must have states at times: solve with `ts`.")
    parts = {name.removeprefix("y."): values for name, values in solution.named(solution.times).items()}
    ends = {name.removeprefix("y."): values for name, values in solution.named(solution).items()}
    for name in names:
        if name not in parts:
            raise ValueError(f"Argument `names` must be parts of the state ({', '.join(parts)}), but has {name!r}.")
    if np.size(solution.t) > _MOST:
        raise ValueError(f"Argument `solution` must have at most {_MOST} lanes, but has {np.size(solution.t):,}.")
    _, ax = axes_or_new(ax, 6.4, 3.6)
    times, last = solution.times.ts, np.ravel(solution.t)
    chosen = list(names or parts)
    colors = list(PALETTE.values())
    for i, name in enumerate(chosen):
        lines = np.reshape(parts[name], (last.size, times.size, -1))
        marks = np.reshape(ends[name], (last.size, -1))
        for lane, element in np.ndindex(last.size, lines.shape[-1]):
            # One part: a colour for each lane. Several: a colour for each part.
            place = (lane if len(chosen) == 1 else i) + element
            color, first = colors[place % len(colors)], lane == 0 or len(chosen) == 1
            label = name if lines.shape[-1] == 1 else f"{name}[{element}]"
            label = f"{label}, lane {lane}" if len(chosen) == 1 and last.size > 1 else label
            ax.plot(times, lines[lane, :, element], color=color, label=label if first else None)
            ax.plot(last[lane], marks[lane, element], "o", color=color, markersize=4)
    ax.set_xlabel("t")
    ax.set_ylabel(chosen[0] if len(chosen) == 1 else "")
    if len(ax.get_legend_handles_labels()[0]) > 1:
        ax.legend()
    return ax
