"""`erosion calibrate`: a model against measured erosion."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.fitting import (
    DataFile,
    FitOptions,
    WriteCaseOption,
    dimension_of,
    given_fit,
    print_document,
    ranks_several,
    write_case,
)
from erosion.cli.lists import LISTED, IgnoreOption, ModelsOption
from erosion.cli.options import FIT, OUTPUT, AllAngles, CaseArgument, JsonOption, SetOption, with_file
from erosion.cli.output import Output, draw, progress_bar, require_outputs

_BOUNDS = 'Least and greatest: "psi=0.01:0.3,threshold=0:40 m/s".'


def calibrate(
    data: DataFile,
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    ignore: Annotated[IgnoreOption, Parameter(group=FIT)] = None,
    fit: FitOptions | None = None,
    bounds: Annotated[list[str] | None, LISTED, Parameter(group=FIT, help=_BOUNDS)] = None,
    loss: Annotated[str, Parameter(group=FIT, help="Or soft_l1, huber, cauchy, arctan, for outliers.")] = "linear",
    level: Annotated[float, Parameter(group=FIT, help="Of the confidence intervals.")] = 0.95,
    profile: Annotated[str | None, Parameter(group=FIT, help="Also the likelihood along this parameter.")] = None,
    plot: Annotated[Path | None, Parameter(group=OUTPUT, help="Draw data, fits and band (.svg, .png, .pdf).")] = None,
    case_file: WriteCaseOption = None,
    json: JsonOption = False,
) -> None:
    """Fit a model to measured erosion, or rank several models.

    Without --model, the model is linearized; without --free, k and ψ are fitted.
    Without a case file and --units, bare numbers and what is printed are in the
    units of the data. `erosion posterior` draws all values that data leave.
    """
    task = given_fit(data, with_file(case, file), fit, model, own, ignore)
    require_outputs(case_file, plot=plot, inputs=task.inputs)
    models = task.models()
    output = Output("calibrate", task.p, task.options, json=json)
    with user_errors(), progress_bar("reading") as progress:
        lazy.check_level(level)
        measured = task.measured(output)
        names = task.fit.names(measured)
        ends = _read_bounds(bounds or (), names, task.names, task.p.units)
        if profile is not None and profile not in names:
            raise InputError(f"Option `--profile` must be one of {', '.join(names)}, but is {profile!r}.")
        ranking = task.ranking(measured, models, progress, bounds=ends, loss=loss)
        along = None if profile is None else ranking.best.profile(profile)
    output.warn(*ranking.warnings)
    # A fit takes longer than any file: it is shown first.
    more, units = {}, {}
    if along is not None:
        more = {"profile": {"name": along.name, "values": along.values.tolist(), "rise": along.rise.tolist()}}
        units = {"values": along.unit or "1"}
    print_document(output, ranking, level, more, units)
    if ranks_several(ranking):
        output.table(ranking.title, ranking.rows(), ranking.headings, (1, 2, 3, 4))
    output.table(ranking.best.title, ranking.best.rows(level))
    if along is not None:
        output.table(along.title, along.rows(), along.headings, (0, 1))
    if case_file is not None:
        write_case(case_file, ranking, task.options)
    draw(plot, lambda: lazy.plot_calibration(ranking.best_first, level))
    output.wrote(*task.next_steps(ranking, case_file), figure=plot, case=case_file)


def _read_bounds(
    texts: Sequence[str], free: Sequence[str], models: Sequence[str], units: "lazy.System"
) -> dict[str, tuple[float, float]]:
    """Bounds such as "psi=0.01:0.3", by parameter, in the units of the case."""
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
        dimension = dimension_of(name, models, units)
        # "1:3 GPa" is from 1 GPa. The end with the unit is read first, so that a message shows what was typed.
        shared = lazy.unit_of(least) or lazy.unit_of(greatest)
        ends_read = {}
        with reading(f"Option `--bounds`, {name},"):
            for end in sorted({least, greatest}, key=lazy.unit_of, reverse=True):
                ends_read[end] = lazy.read_quantity(end if lazy.unit_of(end) else end + shared, dimension, units)
            bounds[name] = ends_read[least], ends_read[greatest]
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"Option `--bounds` must give {name} two ascending values, but is {text!r}.")
    return bounds
