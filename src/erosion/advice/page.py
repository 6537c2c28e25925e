"""An advice as one page: HTML for the browser and the printer, or a PDF of one sheet."""

import dataclasses
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from erosion.advice.abrasives import between
from erosion.advice.result import NOZZLE_ANGLES, Advice, degrees, ends
from erosion.output import briefly, language, require_writable, write_whole
from erosion.parameters import QUANTITIES, quantity_row
from erosion.plotting.labels import DIM, FAINT, INK, STYLES
from erosion.plotting.style import angle_axis, house_style, new_axes, render
from erosion.report.text import inline_svg, render_page
from erosion.version import __version__

_DASHES: Sequence[Any] = ("-", (0, (6, 2)), (0, (2, 2)), (0, (6, 2, 1, 2)), (0, (1, 1)), (0, (6, 2, 1, 2, 1, 2)))
_MARKS = ("o", "s", "^", "v", "D", "x")
_COLUMNS = ((0.09, 42), (0.43, 17), (0.595, 16), (0.745, 22))
"""Where a column of the sheet's table begins, and the letters that it takes."""
_A4 = (8.27, 11.69)  # in


@house_style()
def plot_advice(advice: Advice) -> Figure:
    """Erosion over the nozzle's angle, each curve over its own maximum, and the advised angle."""
    # Narrow, so that letters can be read where a phone shows it.
    fig, ax = new_axes(4.6, 5.4)
    _draw(advice, ax)
    fig.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return fig


@house_style()
def sheet(advice: Advice, notes: Sequence[tuple[str, str]]) -> Figure:
    """The whole advice on one sheet of A4.

    Args:
        advice: of `erosion.advise`.
        notes: what it rests on: names with their texts.
    """
    texts = [f"{name}: {text}" for name, text in notes]
    # The curves take what the text leaves of the sheet; where that is too little, the text is smaller.
    sizes = (0.05 * step for step in range(20, 10, -1))
    scale = next((size for size in sizes if _texts(Figure(), advice, texts, size, 0.0) > _LEAST_CURVES), 0.55)
    fig = Figure(figsize=_A4)
    height = min(_texts(Figure(), advice, texts, scale, 0.0) - _BELOW_CURVES - _FOOT, 0.3)
    _texts(fig, advice, texts, scale, height + _BELOW_CURVES)
    fig.text(_LEFT, 0.02, f"erosion {__version__}", fontsize=7.5, color=DIM)
    return fig


_LEFT = 0.09
_FOOT = 0.045
_BELOW_CURVES = 0.06  # what their axis takes
_LEAST_CURVES = 0.22 + _BELOW_CURVES + _FOOT


def _texts(fig: Figure, advice: Advice, notes: Sequence[str], scale: float, curves: float) -> float:
    """Write the sheet's texts, and the curves where they get a share of its height; the height below all."""
    y = 0.945
    fig.text(_LEFT, y, advice.language.text("Advice on a nozzle's angle"), fontsize=10, color=DIM)
    y = _paragraphs(fig, [advice.title], y - 0.006, width=52, size=15.0, weight="bold")
    y = _paragraphs(fig, advice.answers, y - 0.005, width=round(88 / scale), size=10.5 * scale)
    y = _paragraphs(fig, [*advice.warnings, *advice.reasons], y, width=round(110 / scale), size=8.5 * scale)
    if curves:
        height = curves - _BELOW_CURVES
        ax = fig.add_axes((_LEFT + 0.04, y - 0.015 - height, 0.5, height))
        _draw(advice, ax)
        ax.legend(loc="center left", bbox_to_anchor=(1.03, 0.5), fontsize=7.5)
    y = _table(fig, advice, y - curves, scale)
    return _paragraphs(fig, notes, y - 0.005, width=round(128 / scale), size=7.5 * scale)


def _draw(advice: Advice, ax: Axes) -> None:
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


def _paragraphs(
    fig: Figure, texts: Sequence[str], y: float, *, width: int, size: float, weight: str = "normal"
) -> float:
    """Write paragraphs below each other from the height y; the height below them."""
    line = 1.45 * size / 72 / _A4[1]
    for text in texts:
        for words in textwrap.wrap(text, width, break_on_hyphens=False):  # of a command
            y -= line
            fig.text(0.09, y, words, fontsize=size, weight=weight)
        y -= 0.4 * line
    return y


def _table(fig: Figure, advice: Advice, y: float, scale: float) -> float:
    """Write the table from the height y; the height below it."""
    for i, row in enumerate((advice.headings, *advice.rows())):
        pairs = zip(row, _COLUMNS, strict=True)
        cells = [textwrap.wrap(cell, round(letters / scale)) for cell, (_, letters) in pairs]
        y -= 0.004 * scale
        for line in range(max(map(len, cells))):
            y -= 0.0125 * scale
            for (x, _), lines in zip(_COLUMNS, cells, strict=True):
                weight = "bold" if i == 0 else "normal"
                fig.text(x, y, "".join(lines[line : line + 1]), fontsize=8.5 * scale, weight=weight)
        rule = y - 0.004 * scale
        fig.add_artist(Line2D([_COLUMNS[0][0], 0.93], [rule, rule], color=FAINT, linewidth=0.7))
    return y - 0.01 * scale


_DESCRIPTION = "Erosion by the jet over the angle of the nozzle, by every model and correlation, and the advised angle."


def write_advice(advice: Advice, path: str | Path, lang: str = "en", decimal: str | None = None) -> Path:
    """Write an advice as a page.

    Args:
        advice: of `erosion.advise`.
        path: ends in .html, in .pdf for one sheet of A4, or in .csv for a table of angles that spreadsheets open.
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
    notes = notes_of(advice)
    if path.suffix == ".pdf":
        content = render(sheet(advice, notes), "pdf")
    else:
        svg = render(plot_advice(advice), "svg").decode()
        figure = inline_svg("curves", svg, advice.language.text(_DESCRIPTION))
        fields = {"advice": advice, "notes": notes, "figure": figure}
        content = render_page("page.html", advice.language, package="erosion.advice", **fields).encode()
    write_whole(path, content)
    return path


def require_page_path(path: Path, decimal: str | None = None) -> None:
    """Check that `write_advice` can write to the path with these decimals; errors as of `write_advice`."""
    if path.suffix not in (".html", ".pdf", ".csv"):
        raise ValueError(f"{path}: the file name must end in .html, .pdf or .csv, which Excel opens.")
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
