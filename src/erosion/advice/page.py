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

from erosion.advice.result import NOZZLE_ANGLES, Advice, degrees
from erosion.output.files import require_writable, write_whole
from erosion.output.language import language
from erosion.parameters.quantities import QUANTITIES, quantity_row
from erosion.plotting.labels import DIM, FAINT, INK, STYLES
from erosion.plotting.style import angle_axis, house_style, new_axes, render
from erosion.report.frame import render_page
from erosion.report.text import inline_svg
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
    fig = Figure(figsize=_A4)
    left, y = 0.09, 0.945
    fig.text(left, y, advice.language.text("Advice on a nozzle's angle"), fontsize=10, color=DIM)
    y = _paragraphs(fig, [advice.title], y - 0.006, width=52, size=15.0, weight="bold")
    y = _paragraphs(fig, advice.conclusions, y - 0.005, width=99, size=9.5)
    texts = [f"{name}: {text}" for name, text in notes]
    # The curves take what the table and the notes leave of the sheet.
    below = _paragraphs(Figure(), texts, _table(Figure(), advice, y), width=128, size=7.5)
    height = min(max(below - 0.18, 0.12), 0.3)
    ax = fig.add_axes((left + 0.02, y - 0.015 - height, 0.8, height))
    _draw(advice, ax)
    ax.yaxis.label.set_fontsize(8)
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.035 / height), ncols=3, fontsize=8)
    y = _table(fig, advice, y - height - 0.14)
    _paragraphs(fig, texts, y - 0.005, width=128, size=7.5)
    fig.text(left, 0.02, f"erosion {__version__}", fontsize=7.5, color=DIM)
    return fig


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
    ax.plot(
        nozzle,
        advice.worst_shares,
        color=INK,
        linewidth=2.6,
        label=say("the least of all: {angle}", angle=degrees(advice.alpha)),
    )
    ax.axvline(best, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.plot(best, advice.worst_shares.max(), "*", color=INK, markersize=13)
    angle_axis(ax, label=say("angle of the nozzle, from the surface"))
    ax.set(ylabel=say("erosion by the jet, over its own greatest"), ylim=(0, 1.03))
    ax.yaxis.set_major_formatter(lambda value, _: advice.language.number(f"{value:.1f}"))


def _paragraphs(
    fig: Figure, texts: Sequence[str], y: float, *, width: int, size: float, weight: str = "normal"
) -> float:
    """Write paragraphs below each other from the height y; the height below them."""
    line = 1.45 * size / 72 / _A4[1]
    for text in texts:
        for words in textwrap.wrap(text, width):
            y -= line
            fig.text(0.09, y, words, fontsize=size, weight=weight)
        y -= 0.4 * line
    return y


def _table(fig: Figure, advice: Advice, y: float) -> float:
    """Write the table from the height y; the height below it."""
    for i, row in enumerate((advice.headings, *advice.rows())):
        cells = [textwrap.wrap(cell, letters) for cell, (_, letters) in zip(row, _COLUMNS, strict=True)]
        y -= 0.004
        for line in range(max(map(len, cells))):
            y -= 0.0125
            for (x, _), lines in zip(_COLUMNS, cells, strict=True):
                fig.text(x, y, "".join(lines[line : line + 1]), fontsize=8.5, weight="bold" if i == 0 else "normal")
        fig.add_artist(Line2D([_COLUMNS[0][0], 0.93], [y - 0.004, y - 0.004], color=FAINT, linewidth=0.7))
    return y - 0.01


_DESCRIPTION = "Erosion by the jet over the angle of the nozzle, by every model and correlation, and the advised angle."


def write_advice(advice: Advice, path: str | Path, lang: str = "en") -> Path:
    """Write an advice as a page.

    Args:
        advice: of `erosion.advise`.
        path: ends in .html, or in .pdf for one sheet of A4.
        lang: the language: "en", or "de" for German.

    Raises:
        ValueError: for another suffix, or an unknown language.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    require_page_path(path)
    advice = dataclasses.replace(advice, language=language(lang))
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


def require_page_path(path: Path) -> None:
    """Check that `write_advice` can write to the path; errors as of `write_advice`."""
    if path.suffix not in (".html", ".pdf"):
        raise ValueError(f"{path}: the page's file name must end in .html or .pdf.")
    require_writable(path)


def notes_of(advice: Advice) -> list[tuple[str, str]]:
    """What the advice rests on, names with their texts."""
    say, text = advice.language.say, advice.language.text
    notes = [(text("The case"), _case(advice)), (text("The jet"), _jet(advice))]
    if advice.uncertain is not None:
        spreads = (", " if not advice.language.comma else "; ").join(advice.uncertain.values)
        name = say("{source}, each median with 95% of the values", source=str(advice.uncertain))
        notes.append((name, advice.language.number(spreads)))
    if advice.particle is not None:
        grit = advice.particle
        notes.append((text("Particle"), f"{advice.particle_name}, {grit.density:g} kg/m³ ({grit.source})"))
    if advice.target is not None:
        metal = advice.target
        low, high = (f"{end / 1e6:.4g}" for end in metal.flow_stress_range)
        density = "" if metal.density is None else f", {metal.density:g} kg/m³"
        stress = say("{target}, σ from {low} to {high} MPa", target=text(metal.name), low=low, high=high)
        notes.append((text("Target"), f"{stress}{density} ({metal.source})"))
    if advice.uncertain is None and any(not curve.fits for curve in advice.group("correlations")):
        count = text("those that are not made for this metal count for the angle, not for the amount")
        notes.append((text("Correlations"), count))
    notes += [(text("Note"), sentence.rstrip(".")) for sentence in advice.warnings]
    if advice.uncertain is None:
        fraction = f"{advice.per_mass.cutting_fraction:.3g}"
        notes.append((text("Cutting particles"), say("{fraction} of all (Finnie: about one half)", fraction=fraction)))
    return notes


def _case(advice: Advice) -> str:
    p = advice.p.to("si")
    shown = ("k", "psi", "r", "b", "m", "v0", "sigma", "inertia", "phidot0")
    rows = [quantity_row(name, QUANTITIES[name], getattr(p, name), "si") for name in shown]
    numbers = [f"{row.symbol} = {float(row.value):.4g} {row.unit}".rstrip() for row in rows]
    named = [
        f"{advice.language.text(row.meaning)} {advice.language.number(number)}"
        for row, number in zip(rows, numbers, strict=True)
    ]
    # A comma between numbers that have decimal commas would be read with them.
    return ("; " if advice.language.comma else ", ").join(named)


def _jet(advice: Advice) -> str:
    say, spread = advice.language.say, degrees(advice.spread)
    if not advice.speed_spread:
        return say("angles deviate by {spread} (standard deviation), all speeds are equal", spread=spread)
    return say(
        "angles deviate by {spread} (standard deviation), speeds by {share}%",
        spread=spread,
        share=f"{100 * advice.speed_spread:.0f}",
    )
