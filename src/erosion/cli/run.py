"""`erosion run` and `erosion optimum`: one impact, and the angle at which most or least is removed."""

import math
from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.lists import ModelOption, read_list
from erosion.cli.options import (
    AllAngles,
    CaseArgument,
    CaseOptions,
    JsonOption,
    PlotOption,
    SetOption,
    in_full,
    named_model,
    read_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing


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
        name, chosen = named_model(model, own, options, p.units)
        per_mass = weighing(chosen, abrasive, options)
        require_outputs(plot=plot, inputs=(options.case, name))
        trajectory = lazy.path(chosen, p)
        draw(plot, lambda: lazy.plot_trajectory(trajectory))
    output = Output("run", p, options, json=json)
    output.warn(*trajectory.warnings, per_mass.warning(trajectory.volume, p))
    if trajectory.dvolume is None or not math.isfinite(trajectory.dvolume):
        output.warn("dV/dα could not be computed")
    content = trajectory.to_dict()
    units = content["units"]
    numbers = {"ended_by": trajectory.ended_by} | {name: content[name] for name in units}
    output.document(numbers | per_mass.to_dict(trajectory.volume, p), {name: chosen}, units | lazy.PER_MASS_UNITS)
    at = f"one impact at α = {math.degrees(float(p.alpha)):.6g}°"
    output.table(f"{in_full(name, chosen, p.units)}: {at}", _rows(trajectory, per_mass))
    output.wrote(figure=plot)


def _rows(trajectory: "lazy.Trajectory", per_mass: "lazy.PerMass") -> "list[lazy.Row]":
    """The trajectory's rows, with the volume in SI and per mass of abrasive below the volume."""
    rows, units = trajectory.rows(), trajectory.p.units
    in_si = lazy.result_row("volume", trajectory.volume * lazy.conversion_factor("volume", units, "si"), "si")
    same = [] if units == "si" else [in_si._replace(name="", symbol="", meaning="the same in SI")]
    below = 1 + [row.name for row in rows].index("volume")
    return [*rows[:below], *same, *per_mass.rows(trajectory.volume, trajectory.p), *rows[below:]]


_AT = ("angle", "", "value", "unit", "kind")


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
    options.refuse_angle("all angles are searched, or those of --alpha-range")
    with progress_bar("searching all angles"):
        p = options.parameters()
        name, chosen = named_model(model, own, options, p.units)
        per_mass = weighing(chosen, abrasive, options)
        between = None if alpha_range is None else _angles(alpha_range, p)
        require_outputs(plot=plot, inputs=(options.case, name))
        with user_errors():
            best = (lazy.alpha_min if least else lazy.alpha_max)(chosen, p, alpha_range=between, objective=objective)
        if best.ended_by == "failed":
            raise RuntimeError(f"{name}: no impact could be computed, at any angle.")
        draw(plot, lambda: lazy.plot_optimum(best))
        rates = best.sensitivities if sensitivities else {}
    output = Output("optimum", p, options, json=json)
    if not best.certified:
        output.warn("some impacts failed or have no derivatives: a greater value may have been missed")
    if sensitivities and best.without_sensitivities:
        output.warn(f"the sensitivities are not known: {best.without_sensitivities}")
    output.warn(per_mass.warning(best.volume, p))
    described = ("model", "own_parameters", "parameters", "units")
    result = {name: value for name, value in best.to_dict().items() if name not in described}
    result |= per_mass.to_dict(best.volume, p)
    if rates:
        result["sensitivities"] = {name: float(rate) for name, rate in rates.items()}
    output.document(result, {name: chosen}, best.units() | lazy.PER_MASS_UNITS)
    _show(output, name, best, per_mass)
    if sensitivities and not best.without_sensitivities:
        _show_sensitivities(output, best)
    output.wrote(figure=plot)


def _angles(texts: list[str], p: "lazy.Parameters") -> tuple[float, float]:
    texts = read_list(",".join(texts).replace(":", ","))
    if len(texts) != 2:
        raise InputError(f'Option `--alpha-range` must be two angles such as "20deg : 60deg", but has {len(texts)}.')
    low, high = (read_option("alpha-range", text, "angle", p.units) for text in texts)
    return low, high


def _show(output: Output, model: str, best: "lazy.Optimum", per_mass: "lazy.PerMass") -> None:
    extreme = "least" if best.least else "greatest"
    title = f"{in_full(model, best.model, best.p.units)}: the angle of {extreme} {best.objective}"
    *rows, certificate = best.rows()
    output.table(title, [*rows, *per_mass.rows(best.volume, best.p), certificate])
    value = best.value_row(best.value)

    def line(alpha: float, numbers: list[float], meaning: str) -> lazy.Row:
        angle = lazy.quantity_row("", lazy.QUANTITIES["alpha"], alpha, best.p.units)
        values = " → ".join(best.value_row(number).value for number in numbers)
        return lazy.Row(f"{angle.value}{angle.unit}", "", values, value.unit, meaning)

    others = [line(c.alpha, [c.value], f"{c.kind} {c.side}".strip()) for c in best.candidates[1:]]
    if others:
        output.table("Other candidates", others, _AT)
    jumps = [line(j.alpha, [j.below, j.above], f"{j.ended_below} → {j.ended_above}") for j in best.jumps]
    if jumps:
        output.table("Jumps", jumps, _AT)


def _show_sensitivities(output: Output, best: "lazy.Optimum") -> None:
    known, size = lazy.quantities(best.model), lazy.sizes(best.model, best.p)
    rows = [
        lazy.Row(name, known[name].symbol, f"{math.degrees(rate * size[name]):.5g}", "°", known[name].meaning)
        for name, rate in best.sensitivities.items()
    ]
    output.table(
        "How the angle moves when a parameter grows by its own size, to first order",
        rows,
        ("parameter", "", "q ∂α/∂q", "unit", "meaning"),
    )
