"""`erosion run`: one impact."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.lists import ModelOption
from erosion.cli.options import CaseFile, CaseOptions, JsonOption, with_file
from erosion.cli.output import Output, print_paths, print_table, require_outputs
from erosion.cli.per_mass import PerMassOptions, weighing
from erosion.cli.progress import working
from erosion.cli.set_option import SetOption, in_full, named_model

if TYPE_CHECKING:
    from erosion.parameters.per_mass import PerMass
    from erosion.tables import Row
    from erosion.trajectory.trajectory import Trajectory


def run(
    file: CaseFile = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    abrasive: PerMassOptions | None = None,
    plot: Annotated[Path | None, Parameter(help="Also draw the cut into this file (.svg, .png, .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Follow one impact to the end of its cut: when, how, and how much is removed."""
    options = with_file(case, file)
    with working("computing"):
        p = options.parameters()
        name, chosen = named_model(model, own, options, p.units)
        per_mass = weighing(chosen, abrasive, options)
        require_outputs(plot=plot, inputs=(options.case, name))
        from erosion.parameters.per_mass import PER_MASS_UNITS
        from erosion.trajectory.path import path

        trajectory = path(chosen, p)
        if plot is not None:
            from erosion.plotting.motion import plot_trajectory
            from erosion.plotting.style import save_plot

            with user_errors():
                save_plot(plot_trajectory(trajectory), plot)
    output = Output("run", p, options.case, json=json)
    for message in trajectory.warnings:
        output.warn(message)
    output.judge(per_mass, trajectory.volume, p)
    if trajectory.dvolume is None or not math.isfinite(trajectory.dvolume):
        output.warn("dV/dα could not be computed")
    if json:
        content = trajectory.to_dict()
        numbers = {name: content[name] for name in content["units"]} | per_mass.to_dict(trajectory.volume, p)
        units = content["units"] | PER_MASS_UNITS
        output.document({"ended_by": trajectory.ended_by, **numbers}, {name: chosen}, units)
        return
    print_table(
        f"{in_full(name, chosen, p.units)}: one impact at α = {math.degrees(float(p.alpha)):.6g}°",
        _rows(trajectory, per_mass),
    )
    print_paths(figure=plot)


def _rows(trajectory: "Trajectory", per_mass: "PerMass") -> "list[Row]":
    """The trajectory's rows, with the volume in SI and per mass of abrasive below the volume."""
    from erosion.parameters.quantities import result_row
    from erosion.parameters.units import conversion_factor

    rows, units = trajectory.rows(), trajectory.p.units
    in_si = result_row("volume", trajectory.volume * conversion_factor("volume", units, "si"), "si")
    same = [] if units == "si" else [in_si._replace(name="", symbol="", meaning="the same in SI")]
    below = 1 + [row.name for row in rows].index("volume")
    return [*rows[:below], *same, *per_mass.rows(trajectory.volume, trajectory.p), *rows[below:]]
