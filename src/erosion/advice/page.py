"""An advice as one page: HTML for the browser and the printer, or a PDF of one sheet."""

import dataclasses
import tempfile
from pathlib import Path

from markupsafe import Markup

from erosion.advice.figure import plot_advice, sheet
from erosion.advice.result import Advice, degrees
from erosion.files import require_writable, write_whole
from erosion.language import language
from erosion.parameters.quantities import QUANTITIES, quantity_row
from erosion.plotting.style import render, save_plot
from erosion.report.frame import render_page
from erosion.report.inline import inline_svg

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
    content = render(sheet(advice, notes), "pdf") if path.suffix == ".pdf" else _html(advice, notes).encode()
    write_whole(path, content)
    return path


def require_page_path(path: Path) -> None:
    """Check that `write_advice` can write to the path; errors as of `write_advice`."""
    if path.suffix not in (".html", ".pdf"):
        raise ValueError(f"{path}: the page's file name must end in .html or .pdf.")
    require_writable(path)


def _html(advice: Advice, notes: list[tuple[str, str]]) -> str:
    return render_page(
        "page.html", advice.language, package="erosion.advice", advice=advice, notes=notes, figure=_figure(advice)
    )


def _figure(advice: Advice) -> Markup:
    with tempfile.TemporaryDirectory() as folder:
        svg = save_plot(plot_advice(advice), Path(folder) / "curves.svg")
        return inline_svg(svg, advice.language.text(_DESCRIPTION))


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
