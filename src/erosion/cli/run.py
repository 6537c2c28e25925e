"""`erosion run`, `optimum` and `compare`: one impact, its best angle, and several models over the angle of attack."""

import math
import warnings
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.options import (
    LISTED,
    AllAngles,
    CaseArgument,
    CaseOptions,
    JsonOption,
    ModelOption,
    ModelsOption,
    PlotOption,
    SetOption,
    chosen_models,
    in_full,
    named_model,
    output_option,
    read_list,
    refuse_same,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing
from erosion.results import Columns, Declared, Finding, Scale, Value


def run(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    abrasive: PerMassOptions | None = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Follow one impact to its end: when, how, and how much is removed."""
    options = with_file(case, file)
    with progress_bar("computing"):
        p = options.parameters()
        name, chosen = named_model(model, own, options)
        per_mass = weighing(chosen, abrasive, options)
        require_outputs(plot=plot, inputs=(options.case, name))
        trajectory = lazy.path(chosen, p)
        draw(plot, lambda: lazy.plot_trajectory(trajectory))
    output = Output("run", p, options, json=json)
    output.warn(per_mass.finding(trajectory.volume, p))
    if trajectory.dvolume is None or not math.isfinite(trajectory.dvolume):
        output.warn(Finding("no_derivative"))
    output.show(
        trajectory,
        {name: chosen},
        [*per_mass.declare(trajectory.volume, p), *_in_si(trajectory.volume, p.units)],
        title=f"{in_full(name, chosen, p.units)}: {trajectory.title.partition(': ')[2]}",
    )
    output.wrote(figure=plot)


def _in_si(volume: float, units: "lazy.System") -> list[Value]:
    """The volume once more, where it is not in SI."""
    volume *= lazy.conversion_factor("volume", units, "si")
    same = lazy.declare_result("volume", volume, "si", meaning="removed volume in SI", only="table")
    return [] if units == "si" else [same]


def optimum(
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    abrasive: PerMassOptions | None = None,
    alpha_range: Annotated[
        list[str] | None,
        Parameter(negative="", consume_multiple=True, help='Only angles between these two: "20deg : 60deg".'),
    ] = None,
    objective: Annotated[str, Parameter(help='"volume", "volume per mass", "t_c" or "depth".')] = "volume",
    least: Annotated[
        bool, Parameter(negative="", show_default=False, help="Where least is removed; give --alpha-range.")
    ] = False,
    max_turn: Annotated[
        str, Parameter(help='The greatest turn of the body, or "any"; beyond 90deg the model does not hold.')
    ] = "90deg",
    sensitivities: Annotated[
        bool, Parameter(negative="", show_default=False, help="Also how the angle moves with each parameter.")
    ] = False,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Find the angle at which most is removed, with certainty.

    Jumps of the volume and the ends of the range are compared too.
    """
    options = with_file(case, file)
    options.refuse_given("all angles are searched, or those of --alpha-range", "alpha")
    with progress_bar("searching all angles"):
        p = options.parameters()
        name, chosen = named_model(model, own, options)
        per_mass = weighing(chosen, abrasive, options)
        texts = read_list(",".join(alpha_range).replace(":", ",")) if alpha_range else []
        if len(texts) not in (0, 2):
            raise InputError(
                f'Option `--alpha-range` must be two angles such as "20deg : 60deg", but has {len(texts)}.'
            )
        ends = [options.read("alpha-range", text, "angle") for text in texts]
        between = (ends[0], ends[1]) if ends else None
        limit = None if max_turn == "any" else options.read("max-turn", max_turn, "angle")
        require_outputs(plot=plot, inputs=(options.case, name))
        search = lazy.alpha_min if least else lazy.alpha_max
        with user_errors():
            best = search(chosen, p, alpha_range=between, objective=objective, max_turn=limit)
        if best.ended_by == "failed":
            raise RuntimeError(f"{name}: no impact could be computed, at any angle.")
        draw(plot, lambda: lazy.plot_optimum(best))
    output = Output("optimum", p, options, json=json)
    output.warn(per_mass.finding(best.volume, p))
    if sensitivities and best.without_sensitivities:
        output.warn(Finding("sensitivities_unknown", numbers={"reason": best.without_sensitivities}))
    title = f"{in_full(name, chosen, p.units)}: {best.title.partition(': ')[2]}"
    also = [*per_mass.declare(best.volume, p), *(_sensitivities(best) if sensitivities else ())]
    output.show(best, {name: chosen}, also, title=title)
    output.wrote(figure=plot)


def _sensitivities(best: "lazy.Optimum") -> list[Declared]:
    """How the angle moves with each parameter: by one of its units in JSON, by its own size in a table."""
    rates = best.sensitivities
    known, size = lazy.quantities(best.model), lazy.sizes(best.model, best.p)
    data = Value("sensitivities", [*map(float, rates.values())], labels=[*rates], only="data")
    if best.without_sensitivities:
        return [data]
    moves = [math.degrees(rate * size[q]) for q, rate in rates.items()]
    columns = [
        Value("parameter", [*rates]),
        Value("symbol", [known[q].symbol for q in rates]),
        Value("move", moves, "q ∂α/∂q", scale=Scale(1.0, "°"), digits=5),
        Value("meaning", [known[q].meaning for q in rates]),
    ]
    title = "How the angle moves when a parameter grows by its own size, to first order"
    return [data, Columns("moves", title, columns, only="table")]


_COMPARISON = {"result": "a comparison of models"}


def compare(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: Annotated[ModelsOption, Parameter(consume_multiple=True)] = None,
    abrasive: PerMassOptions | None = None,
    plot: PlotOption = None,
    correlations: Annotated[
        list[str] | None,
        LISTED,
        Parameter(
            consume_multiple=True,
            help="Also draw these engineering correlations, each over its greatest value: "
            '"finnie-cfd,dnv,dnv-polynomial,ecrc,oka,mclaury,arabnejad", some of them, or "all". Needs --plot. '
            "For their volumes name them in --model.",
        ),
    ] = None,
    output: Annotated[Path | None, output_option("Also keep the curves (.nc, .csv).", ".nc", ".csv")] = None,
    json: JsonOption = False,
) -> None:
    """Compare models at the case's angle and at their best angles.

    Without --model it compares all models.
    """
    options = with_file(case, file)
    with progress_bar("comparing"):
        p = options.parameters()
        require_outputs(output, plot=plot, inputs=(options.case, *(model or ())))
        if output is not None and output.suffix == ".nc" and output.exists():
            with user_errors():  # only a comparison is replaced by a comparison: a sweep took longer
                lazy.read_netcdf(output, _COMPARISON)
        overlay = _correlations(correlations, plot)
        chosen = chosen_models(["all"] if model is None else model)
        loaded = {name: options.load_as_set(name) for name in chosen}
        references = {name: options.reference(name, as_set=True) for name in chosen}
        models = {lazy.called(references[name], each): each for name, each in loaded.items()}
        refuse_same(loaded)
        if not chosen or len(models) != len(chosen):
            raise InputError(
                f"Option `--model` must name one or several different models, but is {','.join(chosen)!r}."
            )
        weights = {name: weighing(each, abrasive, options) for name, each in models.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lazy.OutOfRangeWarning)
            curves = lazy.compare([*references.values()], p, alpha=np.union1d(lazy.QUARTER_DEGREES, p.alpha))
        comparison = lazy.Comparison(curves, p, weights)
        if not curves.volume.notnull().any():
            raise lazy.SimulationError(f"{', '.join(comparison.lost)}: no impact could be computed.")
        draw(plot, lambda: lazy.plot_against_correlations(curves, overlay) if overlay else lazy.plot_comparison(curves))
        if output is not None:
            with user_errors():
                if output.suffix == ".csv":
                    lazy.write_csv(curves, output, p, weights)
                else:
                    lazy.write_netcdf(curves, output, _COMPARISON)
    said = Output("compare", p, options, json=json)
    said.show(comparison, models)
    said.wrote(figure=plot, curves=output)


def _correlations(names: list[str] | None, plot: Path | None) -> list[str]:
    """The correlations to draw, all of them known."""
    if names is None:
        return []
    if plot is None:
        raise InputError("Option `--correlations` needs `--plot`: it lays them over the models in its figure.")

    if names == ["all"]:
        return list(lazy.CORRELATIONS)
    unknown = [name for name in names if name not in lazy.CORRELATIONS]
    if unknown or not names:
        known = ", ".join(lazy.CORRELATIONS)
        raise InputError(f"Option `--correlations` must name some of {known}, or all, but has {' '.join(unknown)!r}.")
    return names
