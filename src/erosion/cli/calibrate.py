"""`erosion calibrate`: a model against measured erosion."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.fit_files import FitFiles
from erosion.cli.fit_options import FitOptions
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import AllAngles, CaseFile, InputError, JsonOption, start_engine, user_errors, with_file
from erosion.cli.output import Output, print_table
from erosion.cli.progress import progress_bar
from erosion.cli.set_option import SetOption, load_set, settings

if TYPE_CHECKING:
    from erosion.calibration import Calibration, Ranking
    from erosion.calibration.profiles import Profile

_DATA = (
    'CSV file, headed "angle [deg], volume [mm^3], uncertainty [mm^3]", or '
    '"angle [deg], speed [m/s], mass_loss [mg/kg]" with --density.'
)


def calibrate(
    data: Annotated[Path, Parameter(help=_DATA)],
    file: CaseFile = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    fit: FitOptions | None = None,
    level: Annotated[float, Parameter(help="Of the confidence intervals.")] = 0.95,
    profile: Annotated[str | None, Parameter(help="Also the likelihood's profile along this parameter.")] = None,
    files: FitFiles | None = None,
    json: JsonOption = False,
) -> None:
    """Fit a model's parameters to measured erosion, or rank several models.

    Without --model, the model is linearized.
    """
    options, fit, files = with_file(case, file), fit or FitOptions(), files or FitFiles()
    options.refuse_angle("the angles are those of the data")
    p = options.parameters()
    if not 0 < level < 1:
        raise InputError(f"Option `--level` must be in (0, 1), but is {level:g}.")
    names = ["linearized"] if model is None else chosen_models(model)
    if own and len(names) > 1:
        raise InputError(f"Option `--set` needs one model, but `--model` names {', '.join(names)}.")
    files.require_writable(inputs=(data, options.case, *names))
    start_engine()
    from erosion.calibration import rank_models, read_measurements

    chosen = [load_set(names[0], settings(own), p.units)] if len(names) == 1 else names
    output = Output("calibrate", p, options.case, json=json)
    with user_errors(), progress_bar("reading") as progress:
        measured = read_measurements(data, p.units)
        if measured.unused:
            output.warn(f"{data}: columns that are not used: {', '.join(map(repr, measured.unused))}.")
        bounds, along = fit.bounds_of(names, p.units, measured), fit.names(measured)
        if profile is not None and profile not in along:
            raise InputError(f"Option `--profile` must be one of {', '.join(along)}, but is {profile!r}.")
        ranking = rank_models(p, measured, fit.free, models=chosen, progress=progress, bounds=bounds, **fit.arguments())
        drawn = None if profile is None else ranking.best.profile(profile)
    try:
        written, warnings, refused = *files.write(ranking, level), None
    except InputError as error:
        # A fit takes longer than any file: it is shown first.
        written, warnings, refused = [], [], error
    for statement in (*ranking.statements, *warnings):
        output.warn(statement)
    if json:
        _document(output, ranking, level, drawn)
    else:
        _print(ranking, level, drawn, written, None if refused else files.write_case)
    if refused is not None:
        raise refused


def _print(ranking: "Ranking", level: float, profile: "Profile | None", written: list[Path], case: Path | None) -> None:
    if _ranks_several(ranking):
        print_table(ranking.title, ranking.rows(), ranking.headings, numbers=(1, 2, 3, 4))
    print_table(ranking.best.title, ranking.best.rows(level))
    if profile is not None:
        print_table(f"profile of {profile.name}", profile.rows(), (profile.name, "Δχ²"), numbers=(0, 1))
    for path in written:
        print(f"written: {path}")
    if case is not None:
        from erosion.calibration.export import command

        print(f"the best angle of this fit: {command(ranking.best, str(case))}")


def _ranks_several(ranking: "Ranking") -> bool:
    return len(ranking.fits) + len(ranking.failures) > 1


def _document(output: Output, ranking: "Ranking", level: float, profile: "Profile | None") -> None:
    """The best fit, the ranking of several models and the profile as JSON."""
    from erosion.models.own_parameters import quantities

    content = _fit_as_json(ranking.best, level)
    if _ranks_several(ranking):
        content["ranking"] = [
            {"model": name, **_fit_as_json(fit, level), "weight": weight, "tied_with": ranking.tied_with(name)}
            for name, fit, weight in zip(ranking.names, ranking.fits, ranking.weights, strict=True)
        ]
    if profile is not None:
        content["profile"] = {"name": profile.name, "values": profile.values.tolist(), "rise": profile.rise.tolist()}
    fits = dict(zip(ranking.names, ranking.fits, strict=True))
    units = {name: quantity.unit(ranking.best.p.units) for fit in fits.values()
             for name, quantity in quantities(fit.model).items()}  # fmt: skip
    units |= dict.fromkeys(("rms", "leave_one_out", "residuals"), ranking.best.erosion_unit)
    output.document(content, {name: fit.model for name, fit in fits.items()}, units)


def _fit_as_json(fit: "Calibration", level: float) -> dict[str, Any]:
    described = ("model", "own_parameters", "parameters", "warnings")
    return {name: value for name, value in fit.to_dict(level).items() if name not in described}
