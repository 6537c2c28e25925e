"""`erosion calibrate`: a model against measured erosion."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Parameter

from erosion.cli.lists import LISTED, ModelsOption, chosen_models
from erosion.cli.options import (
    AllAngles,
    CaseFile,
    InputError,
    JsonOption,
    WholeOption,
    require_outputs,
    start_engine,
    user_errors,
    with_file,
)
from erosion.cli.output import Output, print_table
from erosion.cli.progress import progress_bar
from erosion.cli.set_option import SetOption, load_set, settings

if TYPE_CHECKING:
    from erosion.calibration import Calibration, Ranking
    from erosion.calibration.profiles import Profile
    from erosion.parameters.units import Dimension, System

_DATA = (
    'CSV file, headed "angle [deg], volume [mm^3], uncertainty [mm^3]", or '
    '"angle [deg], speed [m/s], mass_loss [mg/kg]" with --density.'
)
_FREE = 'Parameters to fit, of the case or the model\'s own: "k,cutting_fraction,energy_ratio"; "k,psi" without it.'
_BOUNDS = 'Least and greatest values, of own parameters too: "psi=0.01:0.3,threshold=0:40 m/s".'


def calibrate(
    data: Annotated[Path, Parameter(help=_DATA)],
    file: CaseFile = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    free: Annotated[list[str] | None, LISTED, Parameter(help=_FREE)] = None,
    bounds: Annotated[list[str] | None, LISTED, Parameter(help=_BOUNDS)] = None,
    cutting_fraction: Annotated[
        float, Parameter(help='Share of the particles that cut, up to 1; "cutting_fraction" in --free fits it.')
    ] = 1.0,
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
    write_case: Annotated[Path | None, Parameter(help="Write the best fit as a case file, for --case.")] = None,
    json: JsonOption = False,
) -> None:
    """Fit a model's parameters to measured erosion, or rank several models.

    Without --model, the model is linearized.
    """
    options = with_file(case, file)
    options.refuse_angle("the angles are those of the data")
    p = options.parameters()
    if not 0 < level < 1:
        raise InputError(f"Option `--level` must be in (0, 1), but is {level:g}.")
    names = ["linearized"] if model is None else chosen_models(model)
    if own and len(names) > 1:
        raise InputError(f"Option `--set` needs one model, but `--model` names {', '.join(names)}.")
    outputs = _Outputs(plot, openfoam, fluent, write_case)
    require_outputs(openfoam, fluent, write_case, plot=plot, inputs=(data, options.case, *names))
    start_engine()
    from erosion.calibration import rank_models, read_measurements
    from erosion.calibration.forward import SCALE

    chosen = [load_set(names[0], settings(own), p.units)] if len(names) == 1 else names
    free = ["k", "psi"] if free is None else free
    output = Output("calibrate", p, options.case, json=json)
    with user_errors(), progress_bar("reading") as progress:
        measured = read_measurements(data, p.units)
        if measured.unused:
            output.warn(f"{data}: columns that are not used: {', '.join(map(repr, measured.unused))}.")
        along = (*free, SCALE) if measured.free_scale else free
        limits = _read_bounds(bounds or (), along, names, p.units)
        if profile is not None and profile not in along:
            raise InputError(f"Option `--profile` must be one of {', '.join(along)}, but is {profile!r}.")
        ranking = rank_models(
            p,
            measured,
            free,
            models=chosen,
            progress=progress,
            bounds=limits,
            density=density,
            cutting_fraction=cutting_fraction,
            loss=loss,
            starts=32 if starts is None else starts,
        )
        drawn = None if profile is None else ranking.best.profile(profile)
    try:
        written, warnings, refused = *_write(ranking, level, outputs), None
    except InputError as error:
        # A fit takes longer than any file: it is shown first.
        written, warnings, refused = [], [], error
    for statement in (*ranking.statements, *warnings):
        output.warn(statement)
    if json:
        _document(output, ranking, level, drawn)
    else:
        _print(ranking, level, drawn, written, None if refused else write_case)
    if refused is not None:
        raise refused


class _Outputs(NamedTuple):
    """The files that are asked for."""

    plot: Path | None
    openfoam: Path | None
    fluent: Path | None
    case: Path | None


def _read_bounds(
    texts: Sequence[str], free: Sequence[str], models: Sequence[str], units: "System"
) -> dict[str, tuple[float, float]]:
    """Bounds such as "psi=0.01:0.3", by parameter, in the units of the case."""
    from erosion.parameters.units import read_quantity, unit_of

    bounds: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, ends = (part.strip() for part in text.partition("="))
        least, colon, greatest = (part.strip() for part in ends.partition(":"))
        if not (name and equals and least and colon and greatest):
            raise InputError(f'Option `--bounds` must be such as "psi=0.01:0.3", but is {text!r}.')
        if name not in free:
            raise InputError(f"Option `--bounds` must name free parameters ({', '.join(free)}), but has {name!r}.")
        if name in bounds:
            raise InputError(f"Option `--bounds` must give {name} once, but gives it several times.")
        dimension = _dimension(name, models, units)
        # "1:3 GPa" is from 1 GPa. The end with the unit is read first, so that a message shows what was typed.
        shared = unit_of(least) or unit_of(greatest)
        ends_read = {}
        try:
            for end in sorted({least, greatest}, key=unit_of, reverse=True):
                ends_read[end] = read_quantity(end if unit_of(end) else end + shared, dimension, units)
            bounds[name] = ends_read[least], ends_read[greatest]
        except ValueError as error:
            raise InputError(f"Option `--bounds`, {name}, {error}.") from error
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"Option `--bounds` must give {name} two ascending values, but is {text!r}.")
    return bounds


def _dimension(name: str, models: Sequence[str], units: "System") -> "Dimension":
    """What a parameter is measured in: of an impact, of one of the models, or a factor."""
    from erosion.models.own_parameters import own_parameters
    from erosion.parameters.quantities import QUANTITIES

    if name in QUANTITIES:
        return QUANTITIES[name].dimension
    for model in models:
        own = own_parameters(load_set(model, {}, units))
        if name in own:
            return own[name].quantity.dimension
    return "1"


def _write(ranking: "Ranking", level: float, outputs: _Outputs) -> tuple[list[Path], list[str]]:
    """Write the figure, the tables and the case that are asked for; gives their paths, and what they lack."""
    from erosion.calibration import CalibrationError, to_case, to_fluent, to_openfoam
    from erosion.calibration.export import command
    from erosion.files import write_whole
    from erosion.models.own_parameters import own_parameters

    best, warnings = ranking.best, []
    texts: list[tuple[Path, str]] = []
    # What cannot be represented is refused before anything is written.
    with user_errors(CalibrationError):
        if outputs.openfoam is not None:
            coefficients = to_openfoam(best)
            texts.append((outputs.openfoam, coefficients.text()))
            warnings += [coefficients.warning] if coefficients.warning else []
        if outputs.fluent is not None:
            shape = to_fluent(best)
            texts.append((outputs.fluent, shape.text()))
            warnings += [shape.warning] if shape.warning else []
        if outputs.case is not None:
            texts.append((outputs.case, to_case(best, str(outputs.case))))
            if {*best.names} & {*own_parameters(best.model)}:
                warnings.append(
                    f"{outputs.case} holds neither the model nor its own parameters: "
                    f"use it as `{command(best, str(outputs.case))}`."
                )
        written = []
        if outputs.plot is not None:
            from erosion.plotting.calibrations import plot_calibration
            from erosion.plotting.style import save_plot

            written.append(save_plot(plot_calibration(ranking.fits, level), outputs.plot))
        for path, text in texts:
            write_whole(path, text.encode())
            written.append(path)
    return written, warnings


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
