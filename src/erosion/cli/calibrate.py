"""`erosion calibrate`: a model against measured erosion."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError, user_errors
from erosion.cli.fitting import Drawn, DrawOptions, FitFiles, FitOptions
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import IgnoreOption, ModelsOption, chosen_models, refuse_same
from erosion.cli.options import (
    AllAngles,
    CaseFile,
    CaseOptions,
    JsonOption,
    SetOption,
    Settings,
    load_set,
    model_and_settings,
    with_file,
)
from erosion.cli.output import Output, print_table, progress_bar, weighing

if TYPE_CHECKING:
    from erosion.fits import Calibration, Ranking
    from erosion.fits.doubts import Profile

_DATA = (
    'CSV file, headed "angle [deg], volume [mm^3], uncertainty [mm^3]", or '
    '"angle [deg], speed [m/s], mass_loss [mg/kg]" with --target or --density.'
)


def calibrate(
    data: Annotated[Path, Parameter(help=_DATA)],
    file: CaseFile = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    ignore: IgnoreOption = None,
    fit: FitOptions | None = None,
    level: Annotated[float, Parameter(help="Of the confidence intervals.")] = 0.95,
    profile: Annotated[str | None, Parameter(help="Also the likelihood's profile along this parameter.")] = None,
    files: FitFiles | None = None,
    draw: DrawOptions | None = None,
    json: JsonOption = False,
) -> None:
    """Fit a model's parameters to measured erosion, or rank several models.

    Without --model, the model is linearized. Without a case file and --units, bare
    numbers and what is printed are in the unit system of the data.
    """
    options = _in_units_of(data, with_file(case, file), ignore or ())
    fit, files, draw = fit or FitOptions(), files or FitFiles(), draw or DrawOptions()
    options.refuse_angle("the angles are those of the data")
    p, fit = options.parameters(), fit.on(options)
    names, given = _models(model, own, options)
    files.require_writable(inputs=(data, options.case, *names))
    draw.require_sense(p, files.paths, inputs=(data, options.case, *names))
    start_engine()
    from erosion.arguments import check_level
    from erosion.fits import rank_models, read_measurements
    from erosion.parameters.headings import unused_note

    chosen = [load_set(names[0], given, options, p.units)] if len(names) == 1 else list(map(options.load, names))
    refuse_same(dict(zip(names, chosen, strict=True)))
    for each in chosen:
        weighing(each, fit, options)  # refuses the density of another metal than a correlation's
    output = Output("calibrate", p, options.case, json=json, seed=draw.seed_used)
    with user_errors(), progress_bar("reading") as progress:
        check_level(level)
        measured = read_measurements(data, p.units, ignore=ignore or ())
        if measured.unused:
            output.warn(f"{data}: {unused_note(measured.unused)}.")
        bounds, along = fit.bounds_of(names, p.units, measured), fit.names(measured)
        laws = draw.laws(measured, chosen, fit)
        _require_known(profile, along)
        ranking = rank_models(p, measured, fit.free, models=chosen, progress=progress, bounds=bounds, **fit.arguments())
        drawn = draw.drawn(p, ranking, fit, laws, progress)
        if drawn is not None:
            ranking = ranking.preferring(drawn.posteriors.names[0])
        along_profile = None if profile is None else ranking.best.profile(profile)
    try:
        written, warnings, refused = *files.write(ranking, level, options), None
        written += [] if drawn is None else draw.write(drawn)
    except InputError as error:
        # A fit takes longer than any file: it is shown first.
        written, warnings, refused = [], [], error
    for statement in (*ranking.statements, *warnings, *_of_draws(drawn)):
        output.warn(statement)
    if json:
        _document(output, ranking, level, along_profile, drawn)
    else:
        sentences = _advice(ranking, options, *((None, None) if refused else (files.write_case, draw.output)), drawn)
        _print(_tables(ranking, level, along_profile, drawn), written, sentences)
    if refused is not None:
        raise refused


def _in_units_of(data: Path, options: CaseOptions, ignore: Sequence[str]) -> CaseOptions:
    """Without a case file and --units, Table 1 in the unit system of the data."""
    if options.case is not None or options.units is not None:
        return options
    from erosion.fits.measurements import unit_system

    if data.is_fifo():
        raise InputError(f"{data} is no file: beside it give `--units si`, `--units inch-pound` or a case file.")
    return dataclasses.replace(options, units=unit_system(data, ignore))


def _require_known(profile: str | None, names: Sequence[str]) -> None:
    if profile is not None and profile not in names:
        raise InputError(f"Option `--profile` must be one of {', '.join(names)}, but is {profile!r}.")


def _of_draws(drawn: "Drawn | None") -> list[str]:
    """The sentences on posteriors, apart from those on fits."""
    return [] if drawn is None else [f"posterior: {sentence}" for sentence in drawn.posteriors.statements]


def _advice(
    ranking: "Ranking", options: CaseOptions, case_file: Path | None, draws: Path | None, drawn: "Drawn | None"
) -> list[str]:
    """The commands for the best angle and the advice, and what to measure next, where that is asked for."""
    from erosion.fits.export import advice_command, command

    lines = [] if case_file is None else [f"the best angle of this fit: {command(str(case_file))}"]
    if case_file is not None:
        lines.append(f"a nozzle's angle by this fit: {advice_command([str(case_file)], draws)}")
    elif draws is not None:
        lines.append(f"a nozzle's angle by this fit: {advice_command(options.words(ranking.best.names), draws)}")
    else:
        lines.append("a nozzle's angle: --write-case fitted.toml, then erosion advise fitted.toml")
    return lines + ([] if drawn is None or drawn.experiment is None else [drawn.experiment.sentence])


def _models(model: list[str] | None, own: list[str] | None, options: CaseOptions) -> tuple[list[str], Settings]:
    """The names of the models, and what is set of the only one."""
    usual, given = model_and_settings(None if model is None else model[0], own, options)
    names = [usual] if model is None else chosen_models(model)
    if len(set(names)) != len(names):
        raise InputError(f"Option `--model` must name one or several different models, but is {','.join(names)!r}.")
    if own and len(names) > 1:
        raise InputError(f"Option `--set` needs one model, but `--model` names {', '.join(names)}.")
    return names, given


def _tables(
    ranking: "Ranking", level: float, profile: "Profile | None", drawn: "Drawn | None"
) -> list[tuple[Any, ...]]:
    """All tables, as arguments of `print_table`."""
    tables: list[tuple[Any, ...]] = []
    if _ranks_several(ranking):
        tables.append((ranking.title, ranking.rows(), ranking.headings, (1, 2, 3, 4)))
    tables.append((ranking.best.title, ranking.best.rows(level)))
    if profile is not None:
        tables.append((profile.title, profile.rows(), profile.headings, (0, 1)))
    if drawn is not None:
        posteriors, experiment = drawn
        if len(posteriors.posteriors) > 1:
            tables.append((posteriors.title, posteriors.rows(), posteriors.headings, (1, 2)))
        tables.append((posteriors.best.title, posteriors.best.rows(level)))
        if experiment is not None:
            columns = range(len(experiment.headings))
            tables.append((experiment.title, experiment.rows(), experiment.headings, columns))
    return tables


def _print(tables: list[tuple[Any, ...]], written: list[Path], sentences: list[str]) -> None:
    for table in tables:
        print_table(*table)
    for path in written:
        print(f"written: {path}")
    for sentence in sentences:
        print(sentence)


def _ranks_several(ranking: "Ranking") -> bool:
    return len(ranking.fits) + len(ranking.failures) > 1


def _document(
    output: Output,
    ranking: "Ranking",
    level: float,
    profile: "Profile | None",
    drawn: "Drawn | None",
) -> None:
    """The best fit, the ranking of several models, the profile and the posteriors as JSON."""
    from erosion.models.own_parameters import quantities

    fits = dict(zip(ranking.names, ranking.fits, strict=True))
    units = {name: quantity.unit(ranking.best.p.units) for fit in fits.values()
             for name, quantity in quantities(fit.model).items()}  # fmt: skip
    units |= dict.fromkeys(("rms", "leave_one_out", "residuals"), ranking.best.erosion_unit)
    content = _fit_as_json(ranking.best, level)
    if _ranks_several(ranking):
        content["ranking"] = [
            {"model": name, **_fit_as_json(fit, level), **ranking.standing(at)}
            for at, (name, fit) in enumerate(zip(ranking.names, ranking.fits, strict=True))
        ]
    if profile is not None:
        content["profile"] = {"name": profile.name, "values": profile.values.tolist(), "rise": profile.rise.tolist()}
        units["values"] = profile.unit or "1"
    if drawn is not None:
        parts = [_as_json(part) for part in drawn.posteriors.to_dict(level)["posteriors"]]
        content["posterior"], content["posteriors"] = parts[0], parts
        if drawn.experiment is not None:
            content["next_experiment"] = drawn.experiment.to_dict()
    output.document(content, {name: fit.model for name, fit in fits.items()}, units)


def _fit_as_json(fit: "Calibration", level: float) -> dict[str, Any]:
    return {name: value for name, value in _as_json(fit.to_dict(level)).items() if name != "model"}


def _as_json(numbers: dict[str, Any]) -> dict[str, Any]:
    """Without what the document says elsewhere."""
    return {name: value for name, value in numbers.items() if name not in ("own_parameters", "parameters", "warnings")}
