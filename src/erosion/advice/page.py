"""An advice as one page, HTML for the browser and the printer, and its angles as a table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from erosion.advice.abrasives import between
from erosion.advice.result import DRAWS, NOZZLE_ANGLES, Advice, degrees, ends
from erosion.output import briefly, require_no_pdf, require_writable, write_whole
from erosion.pages.frame import inline_svg, render_page
from erosion.parameters import QUANTITIES
from erosion.plotting.labels import DIM, INK, PALETTE, STYLES
from erosion.plotting.style import angle_axis, house_style, mark_turned, new_figure, render

_DASHES: Sequence[Any] = ("-", (0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)), (0, (6, 2, 1, 2, 1, 2)))
_MARKS = ("o", "s", "^", "v", "D", "x")


@house_style()
def plot_advice(advice: Advice) -> Figure:
    """Erosion over the nozzle's angle, each curve over its own maximum, and the advised angle.

    After tests of its own a second panel has their weighings, and 95 % of the curves, as amounts.
    """
    weighed = len(advice.weighings[0]) > 0
    # Narrow, so that letters can be read where a phone shows it.
    fig = new_figure(4.6, 8.0 if weighed else 5.4)
    ax, *below = fig.subplots(1 + weighed, 1, sharex=True, squeeze=False)[:, 0]
    nozzle = np.rad2deg(NOZZLE_ANGLES)
    for curve in (*advice.group("k"), *advice.group("psi"), *advice.group("draws")[:DRAWS]):
        ax.plot(nozzle, curve.shares, color=DIM, linewidth=0.5, alpha=0.45)
    for i, curve in enumerate(advice.group("correlations")):
        ax.plot(nozzle, curve.shares, color=DIM, linewidth=1.4, linestyle=_DASHES[i % len(_DASHES)],
                marker=_MARKS[i % len(_MARKS)], markersize=4, markerfacecolor="none", markevery=(10 + 4 * i, 30),
                label=f"{curve.name}: {degrees(curve.best)}")  # fmt: skip
    for i, curve in enumerate(advice.group("models")):
        color, line = STYLES[i % len(STYLES)]
        ax.plot(nozzle, curve.shares, color=color, linestyle=line, linewidth=1.8,
                label=f"{curve.name}: {degrees(curve.best)}")  # fmt: skip
    best = float(np.rad2deg(advice.alpha))
    angle = degrees(advice.alpha)
    least = advice.uncertain is None
    label = f"the least of all: {angle}" if least else f"their mean: {angle}"
    ax.plot(nozzle, advice.shares, color=INK, linewidth=2.6, label=label)
    ax.axvline(best, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.plot(best, advice.share, "*", color=INK, markersize=13)
    for lower in below:
        _draw_amounts(lower, advice)
    angle_axis((ax, *below)[-1], label="angle of the nozzle, from the surface")
    ax.set(ylabel="share of its own greatest erosion", ylim=(0, 1.03))
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:.3g}")
    mark_turned(ax, advice.findings)
    entries = [entry for panel in (ax, *below) for entry in zip(*panel.get_legend_handles_labels(), strict=True)]
    fig.legend(*zip(*entries, strict=True), loc="outside lower center", ncols=2, fontsize=8)
    return fig


def _draw_amounts(ax: Axes, advice: Advice) -> None:
    """The weighings, and the middle 95 % of the curves that they allow."""
    nozzle, (angles, amounts) = np.rad2deg(NOZZLE_ANGLES), advice.weighings
    low, high = ends(advice.group("draws"), lambda curve: curve.erosion * (curve.density or 1.0) / advice.scale.size)
    ax.fill_between(nozzle, low, high, color=PALETTE["blue"], alpha=0.3, linewidth=0, label="95% of the curves")
    ax.plot(np.rad2deg(angles), amounts, "o", color=INK, markersize=4, clip_on=False, label="your weighings")
    ax.axvline(float(np.rad2deg(advice.alpha)), color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.set(ylabel=f"erosion [{advice.unit}]", ylim=(0, None))


_DESCRIPTION = "Erosion by the jet over the angle of the nozzle, by every model and correlation, and the advised angle."


def write_advice(advice: Advice, path: str | Path, decimal: str = ".") -> Path:
    """Write an advice as a page.

    Args:
        advice: of `erosion.advise`.
        path: ends in .html, which a browser prints, or in .csv for a table of angles that spreadsheets open.
        decimal: of the table's numbers: "." or ",".

    Raises:
        ValueError: for another suffix, or other decimals.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    require_page_path(path, decimal)
    if path.suffix == ".csv":
        write_whole(path, _spreadsheet(advice, decimal).encode("utf-8-sig"))
        return path
    svg = render(plot_advice(advice), "svg").decode()
    figure = inline_svg("curves", svg, _DESCRIPTION)
    fields = {"advice": advice, "notes": notes_of(advice), "figure": figure}
    write_whole(path, render_page("page.html", package="erosion.advice", **fields).encode())
    return path


def require_page_path(path: Path, decimal: str | None = None) -> None:
    """Check that `write_advice` can write to the path with these decimals; errors as of `write_advice`."""
    require_no_pdf(path)
    if path.suffix not in (".html", ".csv"):
        raise ValueError(f"{path}: the file name must end in .html or .csv, which Excel opens.")
    if decimal not in (None, ".", ","):
        raise ValueError(f"Argument `decimal` must be . or a comma, but is {briefly(decimal)}.")
    require_writable(path)


def _spreadsheet(advice: Advice, decimal: str) -> str:
    """Angles, also the advised one, the least and the greatest of the amounts that the advice trusts, the share."""
    unit = advice.unit
    advised = round(float(np.rad2deg(advice.alpha)), 6)
    angles = np.unique([*range(5, 91, 5), advised])
    columns: dict[str, np.ndarray] = {"angle [°]": angles}

    def at_angles(values: np.ndarray) -> np.ndarray:
        return np.interp(np.deg2rad(angles), NOZZLE_ANGLES, values)

    if advice.trusted:
        low, high = ends(
            advice.trusted, lambda curve: at_angles(curve.erosion) * (curve.density or 1.0) / advice.scale.size
        )
        of = "" if advice.uncertain is None else " of 95% of the curves"
        columns |= {f"least erosion{of} [{unit}]": low, f"greatest erosion{of} [{unit}]": high}
    share = "least share of its own best" if advice.uncertain is None else "mean share of its own best"
    columns[f"{share} [%]"] = 100 * at_angles(advice.shares)
    marks = ["advised angle" if angle == advised else "" for angle in angles]
    cells = zip(*([f"{value:.4g}" for value in column] for column in columns.values()), marks, strict=True)
    rows = [[*columns, "advice"], *map(list, cells)]
    # A spreadsheet with decimal commas takes semicolons between cells.
    return "".join(
        (";".join(row).replace(".", ",") if decimal == "," and number else (";" if decimal == "," else ",").join(row))
        + "\r\n"
        for number, row in enumerate(rows)
    )


def notes_of(advice: Advice) -> list[tuple[str, str]]:
    """The assumptions of the advice: names with their texts."""
    p = advice.p
    case, spread = [], degrees(advice.spread)
    for name in ("k", "psi", "r", "b", "m", "v0", "sigma", "inertia", "phidot0"):
        quantity = QUANTITIES[name]
        case.append(f"{quantity.meaning} {quantity.symbol} = {quantity.in_words(float(getattr(p, name)), 'si')}")
    jet = f"angles deviate by {spread} (standard deviation), all speeds are equal"
    if advice.speed_spread:
        share = f"{100 * advice.speed_spread:.0f}"
        jet = f"angles deviate by {spread} (standard deviation), speeds by {share}%"
    notes = [("The case", ", ".join(case)), ("The jet", jet)]
    if advice.uncertain is not None:
        name = f"{advice.uncertain}, each number with its 95% range"
        notes.append((name, ", ".join(advice.uncertain.values)))
    if advice.particle is not None:
        grit = advice.particle
        sieves = f" ({grit.sieves})" * bool(grit.sieves)
        notes.append(
            (
                "Particle",
                f"{advice.particle}{sieves}, {grit.density:g} kg/m³ ({grit.source})",
            )
        )
    if advice.target is not None:
        metal = advice.target
        stress = between([f"{end / 1e6:.4g}" for end in metal.flow_stress_range])
        density = "" if metal.density is None else f", {metal.density:g} kg/m³"
        notes.append(("Target", f"{metal.name}, σ = {stress} MPa{density} ({metal.source})"))
    if advice.uncertain is None and any(not curve.fits for curve in advice.group("correlations")):
        count = "those that are not made for this metal count for the angle, not for the amount"
        notes.append(("Correlations", count))
    if advice.uncertain is None:
        fraction = f"{advice.per_mass.cutting_fraction:.3g}"
        notes.append(("Cutting particles", f"{fraction} of all (Finnie: about one half)"))
    return notes
