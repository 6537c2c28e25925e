"""`erosion run`: one impact."""

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli.options import (
    CaseOptions,
    JsonOption,
    ModelOption,
    parameters_as_json,
    print_json,
    print_table,
    require_outputs,
    user_errors,
    warn,
)
from erosion.cli.settings import SetOption, in_full, load_set, model_as_json, settings


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

    from erosion.parameters.quantities import RESULTS
    from erosion.parameters.units import conversion_factor, unit_name
    from erosion.tables import Row, format_number
    from erosion.trajectory.path import path
    from erosion.trajectory.trajectory import SimulationError

    trajectory = path(chosen, p)
    dvolume = trajectory.dvolume
    if dvolume is None or not np.isfinite(dvolume):
        raise SimulationError(f"{model}: the derivative of the volume could not be computed.")
    in_si = conversion_factor("volume", p.units, "si")
    if plot is not None:
        from erosion.plotting.motion import plot_trajectory
        from erosion.plotting.style import save_plot

        with user_errors():
            save_plot(plot_trajectory(trajectory), plot)
    for message in trajectory.warnings:
        warn(message)
    numbers: dict[str, Any] = {
        "t_c": trajectory.t_c,
        "ended_by": trajectory.ended_by,
        "volume": trajectory.volume,
        "volume_m3": trajectory.volume * in_si,
        "dvolume": dvolume,
        "max_depth": trajectory.max_depth,
        "turn": trajectory.turn,
    }
    if json:
        units = {name: unit_name(RESULTS[name].dimension, p.units) for name in RESULTS if name in numbers}
        print_json(
            {
                **model_as_json(model, chosen),
                "parameters": parameters_as_json(p),
                **numbers,
                "units": units,
                "warnings": list(trajectory.warnings),
            }
        )
        return
    rows = trajectory.rows()
    after_volume = 1 + [row.name for row in rows].index("volume")
    quantity = RESULTS["dvolume"]
    rows[after_volume:after_volume] = [
        *([Row("", "", format_number(trajectory.volume * in_si), "m³", "the same in SI")] if p.units != "si" else []),
        Row(
            "dvolume", quantity.symbol, format_number(dvolume), unit_name(quantity.dimension, p.units), quantity.meaning
        ),
    ]
    print_table(f"{in_full(model, chosen)} at α = {np.rad2deg(float(p.alpha)):.6g}°", rows)
    if plot is not None:
        print(f"figure: {plot}")
