"""`erosion compare`: several models over the angle of attack."""

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.lists import LISTED, ModelsOption, chosen_models, refuse_same
from erosion.cli.options import CaseArgument, CaseOptions, JsonOption, PlotOption, output_option, with_file
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing

if TYPE_CHECKING:
    import xarray as xr


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
        models, references = _models(model, options)
        weights = {name: weighing(chosen, abrasive, options) for name, chosen in models.items()}
        curves, outside = _curves(references, p)
        lines = _at_the_case(curves, p, weights)
        lost = [line["model"] for line in lines if line["ended_by"] in ("failed", "unfinished")]
        if not curves.volume.notnull().any():
            raise lazy.SimulationError(f"{', '.join(lost)}: no impact could be computed.")
        draw(plot, lambda: lazy.plot_against_correlations(curves, overlay) if overlay else lazy.plot_comparison(curves))
        if output is not None:
            with user_errors():
                if output.suffix == ".csv":
                    lazy.write_csv(curves, output, p, weights)
                else:
                    lazy.write_netcdf(curves, output, _COMPARISON)
    said = Output("compare", p, options, json=json)
    said.warn(*outside, *(f"{name}: its impact could not be computed." for name in lost))
    said.warn(*lazy.models_far_from_tests(weights, {line["model"]: line["volume_max"] for line in lines}, p))
    statements = _spread(lines)
    said.document({"models": lines, "statements": statements}, models, _units(p))
    _show(said, lines, p, weights, statements)
    said.wrote(figure=plot, curves=output)


def _models(
    names: list[str] | None, options: CaseOptions
) -> "tuple[dict[str, lazy.CuttingModel], list[str | lazy.CuttingModel]]":
    """The models to compare, by name, and what a sweep takes for them; all of them without names."""
    chosen = chosen_models(["all"] if names is None else names)
    loaded = {name: options.load_as_set(name) for name in chosen}
    references = {name: options.reference_as_set(name) for name in chosen}
    models = {lazy.called(references[name], model): model for name, model in loaded.items()}
    refuse_same(loaded)
    if not chosen or len(models) != len(chosen):
        raise InputError(f"Option `--model` must name one or several different models, but is {','.join(chosen)!r}.")
    return models, [*references.values()]


def _units(p: "lazy.Parameters") -> dict[str, str]:
    units = {name: lazy.RESULTS[name].unit(p.units) for name in ("volume", "volume_max", "alpha_max")}
    return units | lazy.PER_MASS_UNITS | {f"{name}_max": unit for name, unit in lazy.PER_MASS_UNITS.items()}


def _curves(models: "list[str | lazy.CuttingModel]", p: "lazy.Parameters") -> "tuple[xr.Dataset, list[str]]":
    """V(α) of each model, with the case's own angle as one more angle; and who is used outside of its range."""
    import numpy as np

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", lazy.OutOfRangeWarning)
        curves = lazy.compare(models, p, alpha=np.union1d(lazy.QUARTER_DEGREES, p.alpha))
    return curves, [str(warning.message) for warning in caught if warning.category is lazy.OutOfRangeWarning]


def _at_the_case(
    curves: "xr.Dataset", p: "lazy.Parameters", weights: "Mapping[str, lazy.PerMass]"
) -> list[dict[str, Any]]:
    """By model, the impact at the case's angle and the best angle."""
    at = curves.sel(alpha=float(p.alpha))
    return [
        {
            "model": name,
            "volume": float(impact.volume),
            "ended_by": str(lazy.in_words(impact.ended_by)),
            "alpha_max": float(impact.alpha_max),
            "volume_max": float(impact.volume_max),
            "kind": str(lazy.in_words(impact.alpha_max_kind)),
            "alpha_max_ended_by": str(lazy.in_words(impact.alpha_max_ended_by)),
            **weights[name].to_dict(float(impact.volume), p),
            **{f"{key}_max": ratio for key, ratio in weights[name].to_dict(float(impact.volume_max), p).items()},
        }
        for name, impact in ((str(name), at.sel(model=name)) for name in at.model.values)
    ]


def _show(
    output: Output,
    lines: list[dict[str, Any]],
    p: "lazy.Parameters",
    weights: "Mapping[str, lazy.PerMass]",
    statements: list[str],
) -> None:
    largest = max(lazy.largest_of(line[name]) for line in lines for name in ("volume", "volume_max"))
    scale = lazy.table_scale("volume", p.units, largest)

    def volume(value: float) -> str:
        return f"{value / scale.size:.5g}"

    # The erosion per mass of abrasive that every line has.
    key = "erosion_ratio" if all("erosion_ratio" in line for line in lines) else "specific_volume"
    size, unit = lazy.PER_MASS_SCALES[key]

    def weighed(line: dict[str, Any], end: str) -> str:
        mark = " *" if weights[line["model"]].is_beyond_tests(line["volume" + end], p) else ""
        return f"{line[key + end] / size:.5g}{mark}"

    rows = [
        (
            line["model"],
            volume(line["volume"]),
            weighed(line, ""),
            line["ended_by"],
            _angle(line["alpha_max"]),
            volume(line["volume_max"]),
            weighed(line, "_max"),
            line["kind"],
            line["alpha_max_ended_by"],
        )
        for line in lines
    ]
    models = f"{len(lines)} model{'s' * (len(lines) > 1)}"
    at = f"{math.degrees(float(p.alpha)):.6g}°"
    title = f"{models}: impacts at α = {at} and best angles; volumes in {scale.unit}, E in {unit}"
    headings = ("model", "V", "E", "ends by", "α_max", "V_max", "E_max", "kind", "ends by")
    marked = any(cell.endswith("*") for row in rows for cell in row)
    output.table(title, rows, headings, (1, 2, 4, 5, 6), [*statements, *[f"* {lazy.BEYOND_TESTS}."] * marked])


def _spread(lines: list[dict[str, Any]]) -> list[str]:
    """How far the best angles of the models and of the correlations lie apart."""

    def between(angles: list[float]) -> str:
        low, high = (f"{math.degrees(angle):.3g}°" for angle in (min(angles), max(angles)))
        return low if low == high else f"{low} to {high}"

    # Where most is removed as α → 0, or nothing at all, there is no best angle.
    of_models = [line["alpha_max"] for line in lines if line["alpha_max"] > 0]
    if not of_models:
        return []
    of_all = [*of_models, *(correlation.alpha_max for correlation in lazy.CORRELATIONS.values())]
    words = f"{len(of_models)} models" if len(of_models) > 1 else "one model"
    if len(of_models) < len(lines):
        words += f" (the other{'s' * (len(lines) - len(of_models) > 1)} have none)"
    return [f"The best angle is {between(of_models)} over {words}, and {between(of_all)} with the correlations."]


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


def _angle(alpha: float) -> str:
    if math.isnan(alpha):
        return "none"
    return "→ 0°" if alpha == 0 else f"{math.degrees(alpha):.5g}°"
