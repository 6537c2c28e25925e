"""An advice as one page, HTML for the browser and the printer, and its angles as a table."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from erosion.advice.abrasives import between
from erosion.advice.result import NOZZLE_ANGLES, Advice, degrees, ends
from erosion.output import briefly, language, require_no_pdf, require_writable, write_whole
from erosion.parameters import QUANTITIES, quantity_row
from erosion.plotting.labels import DIM, INK, STYLES
from erosion.plotting.style import angle_axis, house_style, new_axes, render
from erosion.report.text import inline_svg, render_page

_DASHES: Sequence[Any] = ("-", (0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)), (0, (6, 2, 1, 2, 1, 2)))
_MARKS = ("o", "s", "^", "v", "D", "x")


@house_style()
def plot_advice(advice: Advice) -> Figure:
    """Erosion over the nozzle's angle, each curve over its own maximum, and the advised angle."""
    # Narrow, so that letters can be read where a phone shows it.
    fig, ax = new_axes(4.6, 5.4)
    nozzle, say = np.rad2deg(NOZZLE_ANGLES), advice.language.say
    for curve in (*advice.group("k"), *advice.group("psi"), *advice.group("draws")):
        ax.plot(nozzle, curve.shares, color=DIM, linewidth=0.5, alpha=0.45)
    for i, curve in enumerate(advice.group("correlations")):
        ax.plot(nozzle, curve.shares, color=DIM, linewidth=1.4, linestyle=_DASHES[i % len(_DASHES)],
                marker=_MARKS[i % len(_MARKS)], markersize=4, markerfacecolor="none", markevery=(10 + 4 * i, 30),
                label=advice.language.number(f"{curve.name}: {degrees(curve.best)}"))  # fmt: skip
    for i, curve in enumerate(advice.group("models")):
        color, line = STYLES[i % len(STYLES)]
        ax.plot(nozzle, curve.shares, color=color, linestyle=line, linewidth=1.8,
                label=advice.language.number(f"{curve.name}: {degrees(curve.best)}"))  # fmt: skip
    best = float(np.rad2deg(advice.alpha))
    angle = degrees(advice.alpha)
    least = advice.uncertain is None
    label = say("the least of all: {angle}", angle=angle) if least else say("their mean: {angle}", angle=angle)
    ax.plot(nozzle, advice.shares, color=INK, linewidth=2.6, label=label)
    ax.axvline(best, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.plot(best, advice.share, "*", color=INK, markersize=13)
    angle_axis(ax, label=say("angle of the nozzle, from the surface"))
    ax.set(ylabel=say("share of its own greatest erosion"), ylim=(0, 1.03))
    ax.yaxis.set_major_formatter(lambda value, _: advice.language.number(f"{value:.3g}"))
    fig.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return fig


_DESCRIPTION = "Erosion by the jet over the angle of the nozzle, by every model and correlation, and the advised angle."


def write_advice(advice: Advice, path: str | Path, lang: str = "en", decimal: str | None = None) -> Path:
    """Write an advice as a page.

    Args:
        advice: of `erosion.advise`.
        path: ends in .html, which a browser prints, or in .csv for a table of angles that spreadsheets open.
        lang: the language: "en", or "de" for German.
        decimal: of the table's numbers: "." or ","; without it that of the language.

    Raises:
        ValueError: for another suffix, other decimals, or an unknown language.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    require_page_path(path, decimal)
    advice = dataclasses.replace(advice, language=language(lang))
    if path.suffix == ".csv":
        write_whole(path, _spreadsheet(advice, decimal or ("," if advice.language.comma else ".")).encode("utf-8-sig"))
        return path
    svg = render(plot_advice(advice), "svg").decode()
    figure = inline_svg("curves", svg, advice.language.text(_DESCRIPTION))
    fields = {"advice": advice, "notes": notes_of(advice), "figure": figure}
    write_whole(path, render_page("page.html", advice.language, package="erosion.advice", **fields).encode())
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
    text, unit = advice.language.text, advice.unit
    advised = round(float(np.rad2deg(advice.alpha)), 6)
    angles = np.unique([*range(5, 91, 5), advised])
    columns: dict[str, np.ndarray] = {f"{text('angle')} [°]": angles}

    def at_angles(values: np.ndarray) -> np.ndarray:
        return np.interp(np.deg2rad(angles), NOZZLE_ANGLES, values)

    if advice.trusted:
        low, high = ends(
            advice.trusted, lambda curve: at_angles(curve.erosion) * (curve.density or 1.0) / advice.scale.size
        )
        of = "" if advice.uncertain is None else f" {text('with 95% confidence')}"
        columns |= {f"{text('least erosion')}{of} [{unit}]": low, f"{text('greatest erosion')}{of} [{unit}]": high}
    share = text("least share of its own best") if advice.uncertain is None else text("mean share of its own best")
    columns[f"{share} [%]"] = 100 * at_angles(advice.shares)
    marks = [text("advised angle") if angle == advised else "" for angle in angles]
    cells = zip(*([f"{value:.4g}" for value in column] for column in columns.values()), marks, strict=True)
    rows = [[*columns, text("advice")], *map(list, cells)]
    # A spreadsheet with decimal commas takes semicolons between cells.
    return "".join(
        (";".join(row).replace(".", ",") if decimal == "," and number else (";" if decimal == "," else ",").join(row))
        + "\r\n"
        for number, row in enumerate(rows)
    )


def notes_of(advice: Advice) -> list[tuple[str, str]]:
    """What the advice rests on, names with their texts."""
    say, text, p = advice.language.say, advice.language.text, advice.p.to("si")
    case, spread = [], degrees(advice.spread)
    for name in ("k", "psi", "r", "b", "m", "v0", "sigma", "inertia", "phidot0"):
        row = quantity_row(name, QUANTITIES[name], getattr(p, name), "si")
        number = f"{row.symbol} = {float(row.value):.4g} {row.unit}".rstrip()
        case.append(f"{text(row.meaning)} {advice.language.number(number)}")
    jet = say("angles deviate by {spread} (standard deviation), all speeds are equal", spread=spread)
    if advice.speed_spread:
        share = f"{100 * advice.speed_spread:.0f}"
        jet = say("angles deviate by {spread} (standard deviation), speeds by {share}%", spread=spread, share=share)
    # A comma between numbers that have decimal commas would be read with them.
    comma = "; " if advice.language.comma else ", "
    notes = [(text("The case"), comma.join(case)), (text("The jet"), jet)]
    if advice.uncertain is not None:
        name = say("{source}, each number with its 95% range", source=str(advice.uncertain))
        notes.append((name, advice.language.number(comma.join(advice.uncertain.values))))
    if advice.particle is not None:
        grit = advice.particle
        sieves = f" ({grit.sieves})" * bool(grit.sieves)
        notes.append(
            (
                text("Particle"),
                f"{advice.particle_name}{sieves}, {grit.density:g} kg/m³ ({advice.language.cited(grit.source)})",
            )
        )
    if advice.target is not None:
        metal = advice.target
        stress = between([f"{end / 1e6:.4g}" for end in metal.flow_stress_range], advice.language)
        density = "" if metal.density is None else f", {metal.density:g} kg/m³"
        notes.append(
            (text("Target"), f"{text(metal.name)}, σ = {stress} MPa{density} ({advice.language.cited(metal.source)})")
        )
    if advice.uncertain is None and any(not curve.fits for curve in advice.group("correlations")):
        count = text("those that are not made for this metal count for the angle, not for the amount")
        notes.append((text("Correlations"), count))
    if advice.uncertain is None:
        fraction = f"{advice.per_mass.cutting_fraction:.3g}"
        notes.append((text("Cutting particles"), say("{fraction} of all (Finnie: about one half)", fraction=fraction)))
    return notes
