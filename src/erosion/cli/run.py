"""`erosion run`, `optimum` and `compare`: one impact, its best angle, and several models over the angle of attack."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

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
from erosion.cli.output import Output, PerMassOptions, progress_bar, weighing
from erosion.parameters import Derivative
from erosion.results import Columns, Declared, Finding, Scale, Value, ValueGroup


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
        cut = _cut(options, model, own, abrasive)
        output = Output("run", cut.p, options, json=json, plot=plot, inputs=[cut.name])
        trajectory = lazy.path(cut.model, cut.p)
    if trajectory.dvolume is None or not math.isfinite(trajectory.dvolume):
        output.warn(Finding("no_derivative"))
    output.save(figure=lambda: lazy.plot_trajectory(trajectory))
    cut.show(output, trajectory, _in_si(trajectory.volume, cut.p.shown_in))


class _Cut(NamedTuple):
    """One model and one case: what a verb of one cut computes with."""

    p: "lazy.Parameters"
    name: str
    model: "lazy.CuttingModel"
    per_mass: "lazy.PerMass"

    def show(self, output: Output, result: "lazy.Trajectory | lazy.Optimum", also: Sequence[Declared]) -> None:
        """Show a result with the erosion per mass of abrasive, under the model's name with its own parameters."""
        output.warn(self.per_mass.finding(result.volume, self.p))
        title = f"{in_full(self.name, self.model, self.p.shown_in)}: {result.title.partition(': ')[2]}"
        output.show(
            result, {self.name: self.model}, [*self.per_mass.declare(result.volume, self.p), *also], title=title
        )


def _cut(options: CaseOptions, model: str | None, own: Sequence[str] | None, abrasive: PerMassOptions | None) -> _Cut:
    """The cut that options ask for."""
    p = options.parameters()
    name, chosen = named_model(model, own, options)
    return _Cut(p, name, chosen, weighing(chosen, abrasive, options))


def _in_si(volume: float, system: "lazy.System") -> list[Value]:
    """The volume once more, where it is not in SI."""
    same = lazy.RESULTS["volume"].in_si("volume", volume, meaning="removed volume in SI", only="table")
    return [] if system == "si" else [same]


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
        Parameter(negative="", consume_multiple=True, help='Only angles between these two: "20:60 deg".'),
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
        cut = _cut(options, model, own, abrasive)
        between = _between(alpha_range, options)
        limit = None if max_turn == "any" else options.read("max-turn", max_turn, "angle")
        output = Output("optimum", cut.p, options, json=json, plot=plot, inputs=[cut.name])
        with user_errors():
            search = lazy.alpha_min if least else lazy.alpha_max
            best = search(cut.model, cut.p, alpha_range=between, objective=objective, max_turn=limit)
        if best.ended_by == "failed":
            raise RuntimeError(f"{cut.name}: no impact could be computed, at any angle.")
    if sensitivities and best.without_sensitivities:
        output.warn(Finding("sensitivities_unknown", numbers={"reason": best.without_sensitivities}))
    output.save(figure=lambda: lazy.plot_optimum(best))
    cut.show(output, best, _sensitivities(best) if sensitivities else ())


def _between(alpha_range: Sequence[str] | None, options: CaseOptions) -> tuple[float, float] | None:
    """The two angles of --alpha-range."""
    if not alpha_range:
        return None
    ends = read_list(",".join(alpha_range).replace(":", ","))
    if len(ends) != 2:
        raise InputError(f'Option `--alpha-range` must be two angles such as "20:60 deg", but has {len(ends)}.')
    return options.read_ends("Option `--alpha-range`", "--alpha-range ", (ends[0], ends[1]), "angle")


def _sensitivities(best: "lazy.Optimum") -> list[Declared]:
    """How the angle moves with each parameter: by one of its units in JSON, by its own size in a table."""
    rates = best.sensitivities
    known, size = lazy.quantities(best.model), lazy.sizes(best.model, best.p)
    each = [Value(q, rate, measure=Derivative("angle", (known[q].dimension,))) for q, rate in rates.items()]
    data = ValueGroup("sensitivities", each, only="data")
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
        p, overlay = options.parameters(), _correlations(correlations, plot)
        said = Output("compare", p, options, json=json, plot=plot, files={"curves": output}, inputs=model or ())
        if output is not None and output.suffix == ".nc" and output.exists():
            with user_errors():  # only a comparison is replaced by a comparison: a sweep took longer
                lazy.read_netcdf(output, _COMPARISON)
        models, references = _several(chosen_models(["all"] if model is None else model), options)
        weights = {name: weighing(each, abrasive, options) for name, each in models.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lazy.OutOfRangeWarning)
            curves = lazy.compare(references, p, alpha=np.union1d(lazy.QUARTER_DEGREES, p.alpha))
    comparison = lazy.Comparison(curves, p, weights)
    if not curves.volume.notnull().any():
        raise lazy.SimulationError(f"{', '.join(comparison.lost)}: no impact could be computed.")
    said.save(
        figure=lambda: lazy.plot_against_correlations(curves, overlay) if overlay else lazy.plot_comparison(curves),
        curves=lambda path: (
            lazy.write_csv(curves, path, p, weights)
            if path.suffix == ".csv"
            else lazy.write_netcdf(curves, path, _COMPARISON)
        ),
    )
    said.show(comparison, models)


def _several(
    names: list[str], options: CaseOptions
) -> "tuple[dict[str, lazy.CuttingModel], list[str | lazy.CuttingModel]]":
    """Different models as the case sets them, by what output calls them, and as other processes know them."""
    loaded = {name: options.load_as_set(name) for name in names}
    references = [options.reference(name, as_set=True) for name in names]
    refuse_same(loaded)
    models = {lazy.called(each, loaded[name]): loaded[name] for name, each in zip(names, references, strict=False)}
    if not names or len(models) != len(names):
        raise InputError(f"Option `--model` must name one or several different models, but is {','.join(names)!r}.")
    return models, references


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
