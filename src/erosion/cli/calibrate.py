"""`erosion calibrate`: a model against measured erosion."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.options import (
    CaseOptions,
    InputError,
    JsonOption,
    ModelOption,
    WholeOption,
    parameters_as_json,
    print_json,
    print_table,
    require_outputs,
    start_engine,
    user_errors,
    warn,
)
from erosion.cli.settings import SetOption, load_set, model_as_json, settings

if TYPE_CHECKING:
    from erosion.calibration import Calibration


def calibrate(
    data: Annotated[Path, Parameter(help='CSV file, headed "angle [deg], volume [mm^3], uncertainty [mm^3]".')],
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption = "linearized",
    own: SetOption = None,
    models: Annotated[str | None, Parameter(help='Rank several models: "all" or "linearized,rotating".')] = None,
    free: Annotated[str, Parameter(help="Parameters to fit, with commas between.")] = "k,psi",
    density: Annotated[str | None, Parameter(help='Of the target, for mass losses: "2.7 g/cm^3".')] = None,
    loss: Annotated[
        str, Parameter(help='"linear"; "soft_l1", "huber", "cauchy" or "arctan" with outliers.')
    ] = "linear",
    starts: Annotated[WholeOption, Parameter(help="Points to begin from; 32 without it.")] = None,
    level: Annotated[float, Parameter(help="Of the confidence intervals.")] = 0.95,
    profile: Annotated[str | None, Parameter(help="Also the likelihood's profile along this parameter.")] = None,
    plot: Annotated[Path | None, Parameter(help="Draw data, fits and band into this file (.svg, .png, .pdf).")] = None,
    openfoam: Annotated[Path | None, Parameter(help="Write OpenFOAM ParticleErosion coefficients.")] = None,
    fluent: Annotated[Path | None, Parameter(help="Write the angle function as a piecewise-linear table.")] = None,
    json: JsonOption = False,
) -> None:
    """Fit a model's parameters to measured erosion, or rank models by how well they fit."""
    case = case or CaseOptions()
    p = case.parameters()
    if not 0 < level < 1:
        raise InputError(f"Option `--level` must be in (0, 1), but is {level:g}.")
    names = [name.strip() for name in free.split(",") if name.strip()]
    if own and models is not None:
        raise InputError("Option `--set` needs one model: give it by `--model`, without `--models`.")
    require_outputs(openfoam, fluent, plot=plot, inputs=(data, case.case))
    start_engine()
    from rich.console import Console

    from erosion.calibration import rank_models, read_measurements, to_fluent, to_openfoam
    from erosion.calibration.forward import SCALE

    chosen = load_set(model, settings(own), p.units)
    several = None if models is None or models == "all" else [one.strip() for one in models.split(",") if one.strip()]
    console = Console(stderr=True, highlight=False)
    with user_errors(), console.status("reading") as status:
        measured = read_measurements(data, p.units)
        along = (*names, SCALE) if measured.free_scale else names
        if profile is not None and profile not in along:
            raise InputError(f"Option `--profile` must be one of {', '.join(along)}, but is {profile!r}.")
        ranking = rank_models(
            p,
            measured,
            names,
            models=[chosen] if models is None else several,
            progress=status.update,
            density=density,
            loss=loss,
            starts=32 if starts is None else starts,
        )
        best = ranking.best
        drawn = None if profile is None else best.profile(profile)
    written = []
    with user_errors():
        if plot is not None:
            from erosion.plotting.calibrations import plot_calibration
            from erosion.plotting.style import save_plot

            written.append(save_plot(plot_calibration(ranking.fits, level), plot))
        from erosion.files import write_whole

        for path, export in ((openfoam, to_openfoam), (fluent, to_fluent)):
            if path is not None:
                write_whole(path, export(best).text().encode())
                written.append(path)
    for sentence in ranking.statements:
        warn(sentence)
    if json:
        content = _as_json(best, level)
        if models is not None:
            content["ranking"] = [
                {**_as_json(one, level), "weight": weight, "tied_with": ranking.tied_with(name)}
                for name, one, weight in zip(ranking.names, ranking.fits, ranking.weights, strict=True)
            ]
        if drawn is not None:
            content["profile"] = {"name": drawn.name, "values": drawn.values.tolist(), "rise": drawn.rise.tolist()}
        print_json(content)
        return
    if models is not None:
        print_table(ranking.title, ranking.rows(), ranking.headings)
    print_table(best.title, best.rows(level))
    if drawn is not None:
        print_table(f"profile of {drawn.name}", drawn.rows(), (drawn.name, "Δχ²"), numbers=(0, 1))
    for path in written:
        print(f"written: {path}")


def _as_json(fit: "Calibration", level: float) -> dict[str, Any]:
    from erosion.models import model_name
    from erosion.parameters.units import unit_name

    return {
        **model_as_json(model_name(fit.model), fit.model),
        "rows": len(fit.data),
        "estimates": fit.estimates,
        "standard_errors": fit.standard_errors,
        "intervals": fit.intervals(level),
        "level": level,
        "correlation": fit.correlation.tolist(),
        "undetermined": fit.undetermined,
        "aicc": fit.aicc,
        "leave_one_out": fit.leave_one_out,
        "erosion_unit": unit_name(fit.data.dimension, fit.p.units),
        "parameters": parameters_as_json(fit.p),
        "warnings": fit.statements,
    }
