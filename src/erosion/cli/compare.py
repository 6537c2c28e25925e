"""`erosion compare`: several models over the angle of attack."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

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

_COMPARISON = {"result": "a comparison of models"}


def compare(
    *,
    case: CaseOptions | None = None,
    models: Annotated[
        list[str] | None,
        Parameter(
            consume_multiple=True,
            negative="",
            help="Names or paths of files; without it all models.",
        ),
    ] = None,
    plot: Annotated[Path | None, Parameter(help="Also draw V(α) of all into this file (.svg, .png, .pdf).")] = None,
    correlations: Annotated[
        list[str] | None,
        Parameter(
            consume_multiple=True,
            negative="",
            help="In the figure, angle functions of engineers beside the models, each over its own greatest value: "
            "finnie-cfd, dnv, dnv-polynomial, ecrc, oka, arabnejad; or all.",
        ),
    ] = None,
    output: Annotated[Path | None, Parameter(name=["-o", "--output"], help="Also keep the curves (.nc).")] = None,
    json: JsonOption = False,
) -> None:
    """Set models side by side: V at the case's angle, and where each removes most."""
    if output is not None and output.suffix != ".nc":
        raise InputError(f"Option `--output` must name a file that ends in .nc, but is {output}.")
    case = case or CaseOptions()
    p = case.parameters()
    require_outputs(output, plot=plot, inputs=(case.case,))
    if output is not None and output.exists():
        _require_comparison(output)
    overlay = _correlations(correlations, plot)
    from erosion.models import usable_models

    names = usable_models() if models is None else models
    if not names or len(set(names)) != len(names):
        raise InputError(f"Option `--models` must name one or several different models, but is {' '.join(names)!r}.")
    for name in names:
        load(name)
    start_engine()
    import numpy as np

    from erosion.parameters.quantities import RESULTS
    from erosion.parameters.units import unit_name
    from erosion.storage.netcdf import write_netcdf
    from erosion.sweeps.grid import in_words
    from erosion.sweeps.studies import compare as compare_models
    from erosion.tables import format_number
    from erosion.trajectory.trajectory import SimulationError

    # The case's own angle goes along as one more angle.
    angles = np.union1d(np.linspace(0, np.pi / 2, 361)[1:], p.alpha)
    found = compare_models(names, p, alpha=angles)
    at = found.sel(alpha=float(p.alpha))
    lines = [
        {
            "model": name,
            "volume": float(one.volume),
            "ended_by": str(in_words(one.ended_by)),
            "alpha_max": float(one.alpha_max),
            "volume_max": float(one.volume_max),
            "kind": str(in_words(one.alpha_max_kind)),
            "alpha_max_ended_by": str(in_words(one.alpha_max_ended_by)),
        }
        for name, one in ((str(name), at.sel(model=name)) for name in at.model.values)
    ]
    lost = [line["model"] for line in lines if line["ended_by"] in ("failed", "unfinished")]
    if not np.isfinite(found.volume).any():
        raise SimulationError(f"{', '.join(lost)}: no impact could be computed.")
    if output is not None:
        with user_errors():
            write_netcdf(found, output, _COMPARISON)
    if plot is not None:
        from erosion.plotting.shapes import plot_against_correlations
        from erosion.plotting.studies import plot_comparison
        from erosion.plotting.style import save_plot

        with user_errors():
            save_plot(plot_against_correlations(found, overlay) if overlay else plot_comparison(found), plot)
    for name in lost:
        warn(f"{name}: its impact could not be computed.")
    if json:
        print_json({"parameters": parameters_as_json(p), "models": lines})
        return
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
    for path, what in ((plot, "figure"), (output, "curves")):
        if path is not None:
            print(f"{what}: {path}")


def _require_comparison(path: Path) -> None:
    """Only a comparison is replaced by a comparison: a sweep took longer."""
    from erosion.storage.netcdf import read_netcdf

    with user_errors():
        read_netcdf(path, _COMPARISON)


def _correlations(wanted: list[str] | None, plot: Path | None) -> list[str]:
    """The correlations to draw, all of them known."""
    if wanted is None:
        return []
    if plot is None:
        raise InputError("Option `--correlations` needs `--plot`: it lays them over the models in its figure.")
    from erosion.correlations import CORRELATIONS

    names = list(CORRELATIONS) if wanted == ["all"] else wanted
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
