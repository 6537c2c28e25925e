"""`erosion advise`: the nozzle's angle and the erosion to expect, on one page."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import AllAngles, CaseFile, JsonOption, load, read_option, with_file
from erosion.cli.output import Output, print_paths, print_table, require_outputs
from erosion.cli.per_mass import PerMassOptions
from erosion.cli.progress import progress_bar

if TYPE_CHECKING:
    from erosion.advice.result import Advice


def advise(
    file: CaseFile = None,
    /,
    *,
    case: AllAngles | None = None,
    spread: Annotated[
        str, Parameter(help="Standard deviation of the angles in the jet, about half of its half opening angle.")
    ] = "3 deg",
    speed_spread: Annotated[float, Parameter(help="Standard deviation of the speeds: 0.1 is 10 %.")] = 0.0,
    abrasive: PerMassOptions | None = None,
    model: ModelsOption = None,
    output: Annotated[
        Path | None, Parameter(name=("--output", "-o"), help="Also write it as a page: advice.html or advice.pdf.")
    ] = None,
    plot: Annotated[Path | None, Parameter(help="Also draw the curves into this file (.svg, .png, .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Advise a nozzle's angle, with the erosion to expect and how sure that is.

    Give --particle, --target and --v0. Models, correlations, the force ratio k,
    the contact ratio ψ and the spread of the jet are compared. Without
    --cutting-fraction half of the particles cut, as Finnie found.
    """
    options = with_file(case, file)
    options.refuse_angle("all angles of the nozzle are compared")
    p = options.parameters()
    deviation = read_option("spread", spread, "angle", "si")
    grit, metal = options.materials()
    from erosion.advice.advise import CUTTING_FRACTION, MODELS, advise_case

    per_mass = (abrasive or PerMassOptions()).per_mass(options, CUTTING_FRACTION)
    names = chosen_models(model) or list(MODELS)
    _require(output, plot, (options.case, *names))
    for name in names:
        load(name)
    start_engine()
    with progress_bar("advise") as progress, user_errors():
        advice = advise_case(p, grit, metal, (deviation, speed_spread), per_mass, names, progress)
    with user_errors():
        _write(advice, output, plot)
    printed = Output("advise", p, options.case, json=json)
    for message in advice.outside:
        printed.warn(message)
    if json:
        from erosion.advice.result import UNITS

        printed.document(advice.to_dict(), {name: load(name) for name in names}, UNITS)
        return
    print_table(advice.title, advice.rows(), advice.headings, (), advice.statements)
    print_paths(figure=plot, page=output)


def _require(output: Path | None, plot: Path | None, inputs: Sequence[Any]) -> None:
    """Know before computing that the page and the figure can be written."""
    require_outputs(output, plot=plot, inputs=inputs)
    if output is not None:
        from erosion.advice.page import require_page_path

        with user_errors():
            require_page_path(output)


def _write(advice: "Advice", output: Path | None, plot: Path | None) -> None:
    """Write the page and the figure that are asked for."""
    if output is not None:
        from erosion.advice.page import write_advice

        write_advice(advice, output)
    if plot is not None:
        from erosion.advice.figure import plot_advice
        from erosion.plotting.style import save_plot

        save_plot(plot_advice(advice), plot)
