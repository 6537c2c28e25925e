"""`erosion compare`: several models over the angle of attack."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.lists import LISTED, ModelsOption, chosen_models
from erosion.cli.options import (
    CaseOptions,
    InputError,
    JsonOption,
    load,
    parameters_as_json,
    print_json,
    print_table,
    require_outputs,
    start_engine,
    user_errors,
    warn,
)

if TYPE_CHECKING:
    import xarray as xr

    from erosion.parameters.parameters import Parameters

_COMPARISON = {"result": "a comparison of models"}


def compare(
    *,
    case: CaseOptions | None = None,
    model: Annotated[ModelsOption, Parameter(consume_multiple=True)] = None,
    plot: Annotated[Path | None, Parameter(help="Also draw V(α) of all into this file (.svg, .png, .pdf).")] = None,
    correlations: Annotated[
        list[str] | None,
        LISTED,
        Parameter(
            consume_multiple=True,
            help="Also draw these engineering correlations, each over its greatest value: "
            '"finnie-cfd,dnv,dnv-polynomial,ecrc,oka,arabnejad", some of them, or "all". Needs --plot.',
        ),
    ] = None,
    output: Annotated[Path | None, Parameter(name=("--output", "-o"), help="Also keep the curves (.nc).")] = None,
    json: JsonOption = False,
) -> None:
    """Compare models at the case's angle and at their best angles.

    Without --model it compares all models.
    """
    if output is not None and output.suffix != ".nc":
        raise InputError(f"Option `--output` must end in .nc, but is {output}.")
    case = case or CaseOptions()
    p = case.parameters()
    require_outputs(output, plot=plot, inputs=(case.case,))
    if output is not None and output.exists():
        _require_comparison(output)
    overlay = _correlations(correlations, plot)
    names = chosen_models(["all"] if model is None else model)
    if not names or len(set(names)) != len(names):
        raise InputError(f"Option `--model` must name one or several different models, but is {','.join(names)!r}.")
    for name in names:
        load(name)
    start_engine()
    curves = _curves(names, p)
    lines = _at_the_case(curves, p)
    lost = [line["model"] for line in lines if line["ended_by"] in ("failed", "unfinished")]
    _require_volumes(curves, lost)
    _write(curves, overlay, plot, output)
    for name in lost:
        warn(f"{name}: its impact could not be computed.")
    if json:
        print_json({"parameters": parameters_as_json(p), "models": lines})
        return
    _print(lines, p)
    for path, content in ((plot, "figure"), (output, "curves")):
        if path is not None:
            print(f"{content}: {path}")


def _curves(names: list[str], p: "Parameters") -> "xr.Dataset":
    """V(α) of each model; the case's own angle goes along as one more angle."""
    import numpy as np

    from erosion.parameters.ranges import QUARTER_DEGREES
    from erosion.sweeps.studies import compare as compare_models

    return compare_models(names, p, alpha=np.union1d(QUARTER_DEGREES, p.alpha))


def _at_the_case(curves: "xr.Dataset", p: "Parameters") -> list[dict[str, Any]]:
    """By model, the impact at the case's angle and the best angle."""
    from erosion.sweeps.grid import in_words

    at = curves.sel(alpha=float(p.alpha))
    return [
        {
            "model": name,
            "volume": float(impact.volume),
            "ended_by": str(in_words(impact.ended_by)),
            "alpha_max": float(impact.alpha_max),
            "volume_max": float(impact.volume_max),
            "kind": str(in_words(impact.alpha_max_kind)),
            "alpha_max_ended_by": str(in_words(impact.alpha_max_ended_by)),
        }
        for name, impact in ((str(name), at.sel(model=name)) for name in at.model.values)
    ]


def _require_volumes(curves: "xr.Dataset", lost: list[str]) -> None:
    import numpy as np

    from erosion.trajectory.trajectory import SimulationError

    if not np.isfinite(curves.volume).any():
        raise SimulationError(f"{', '.join(lost)}: no impact could be computed.")


def _write(curves: "xr.Dataset", overlay: list[str], plot: Path | None, output: Path | None) -> None:
    """Write the curves and the figure that are asked for."""
    from erosion.storage.netcdf import write_netcdf

    with user_errors():
        if output is not None:
            write_netcdf(curves, output, _COMPARISON)
        if plot is not None:
            from erosion.plotting.correlations import plot_against_correlations
            from erosion.plotting.studies import plot_comparison
            from erosion.plotting.style import save_plot

            save_plot(plot_against_correlations(curves, overlay) if overlay else plot_comparison(curves), plot)


def _print(lines: list[dict[str, Any]], p: "Parameters") -> None:
    import numpy as np

    from erosion.parameters.quantities import RESULTS
    from erosion.parameters.units import unit_name
    from erosion.tables import format_number

    unit = unit_name(RESULTS["volume"].dimension, p.units)
    rows = [
        (
            line["model"],
            format_number(line["volume"], 7),
            line["ended_by"],
            _angle(line["alpha_max"]),
            format_number(line["volume_max"], 7),
            line["kind"],
            line["alpha_max_ended_by"],
        )
        for line in lines
    ]
    headings = ("model", f"V [{unit}]", "ends by", "α_max", f"V_max [{unit}]", "kind", "ends by")
    print_table(f"Models at α = {np.rad2deg(float(p.alpha)):.6g}° and at their best", rows, headings, (1, 3, 4))


def _require_comparison(path: Path) -> None:
    """Only a comparison is replaced by a comparison: a sweep took longer."""
    from erosion.storage.netcdf import read_netcdf

    with user_errors():
        read_netcdf(path, _COMPARISON)


def _correlations(names: list[str] | None, plot: Path | None) -> list[str]:
    """The correlations to draw, all of them known."""
    if names is None:
        return []
    if plot is None:
        raise InputError("Option `--correlations` needs `--plot`: it lays them over the models in its figure.")
    from erosion.correlations import CORRELATIONS

    if names == ["all"]:
        return list(CORRELATIONS)
    unknown = [name for name in names if name not in CORRELATIONS]
    if unknown or not names:
        known = ", ".join(CORRELATIONS)
        raise InputError(f"Option `--correlations` must name some of {known}, or all, but has {' '.join(unknown)!r}.")
    return names


def _angle(alpha: float) -> str:
    import math

    if math.isnan(alpha):
        return "none"
    return "→ 0°" if alpha == 0 else f"{math.degrees(alpha):.6f}°"
