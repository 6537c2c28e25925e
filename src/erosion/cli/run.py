"""`erosion run`: one impact."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.lists import ModelOption
from erosion.cli.options import (
    CaseOptions,
    JsonOption,
    parameters_as_json,
    print_json,
    print_table,
    require_outputs,
    user_errors,
    warn,
)
from erosion.cli.set_option import SetOption, in_full, load_set, model_as_json, settings

if TYPE_CHECKING:
    from erosion.tables import Row
    from erosion.trajectory.trajectory import Trajectory


def run(
    *,
    case: CaseOptions | None = None,
    model: ModelOption = "linearized",
    own: SetOption = None,
    plot: Annotated[Path | None, Parameter(help="Also draw the cut into this file (.svg, .png, .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Follow one impact to the end of its cut: when, how, and how much is removed."""
    case = case or CaseOptions()
    p = case.parameters()
    chosen = load_set(model, settings(own), p.units)
    require_outputs(plot=plot, inputs=(case.case,))
    import numpy as np

    from erosion.trajectory.path import path
    from erosion.trajectory.trajectory import SimulationError

    trajectory = path(chosen, p)
    if trajectory.dvolume is None or not np.isfinite(trajectory.dvolume):
        raise SimulationError(f"{model}: the derivative of the volume could not be computed.")
    if plot is not None:
        from erosion.plotting.motion import plot_trajectory
        from erosion.plotting.style import save_plot

        with user_errors():
            save_plot(plot_trajectory(trajectory), plot)
    for message in trajectory.warnings:
        warn(message)
    if json:
        print_json({**model_as_json(model, chosen), **_as_json(trajectory)})
        return
    print_table(f"{in_full(model, chosen)} at α = {np.rad2deg(float(p.alpha)):.6g}°", _rows(trajectory))
    if plot is not None:
        print(f"figure: {plot}")


def _as_json(trajectory: "Trajectory") -> dict[str, Any]:
    from erosion.parameters.quantities import RESULTS
    from erosion.parameters.units import unit_name

    names = ("t_c", "ended_by", "volume", "volume_m3", "dvolume", "max_depth", "turn")
    numbers = {name: _volume_in_si(trajectory) if name == "volume_m3" else getattr(trajectory, name) for name in names}
    return {
        "parameters": parameters_as_json(trajectory.p),
        **numbers,
        "units": {name: unit_name(RESULTS[name].dimension, trajectory.p.units) for name in RESULTS if name in names},
        "warnings": list(trajectory.warnings),
    }


def _rows(trajectory: "Trajectory") -> "list[Row]":
    """The trajectory's rows, with the volume in SI and its derivative below the volume."""
    from erosion.parameters.quantities import result_row
    from erosion.tables import Row, format_number

    more = [result_row("dvolume", trajectory.dvolume, trajectory.p.units)]
    if trajectory.p.units != "si":
        more.insert(0, Row("", "", format_number(_volume_in_si(trajectory)), "m³", "the same in SI"))
    rows = trajectory.rows()
    below_volume = 1 + [row.name for row in rows].index("volume")
    return [*rows[:below_volume], *more, *rows[below_volume:]]


def _volume_in_si(trajectory: "Trajectory") -> float:
    from erosion.parameters.units import conversion_factor

    return trajectory.volume * conversion_factor("volume", trajectory.p.units, "si")
