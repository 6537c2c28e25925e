"""An advice as one page: HTML for the browser and the printer, or a PDF of one sheet."""

import tempfile
from pathlib import Path

import jinja2

from erosion.advice.figure import plot_advice, sheet
from erosion.advice.result import Advice, degrees
from erosion.files import require_writable, write_whole
from erosion.parameters.quantities import QUANTITIES, quantity_row
from erosion.plotting.style import render, save_plot
from erosion.report.inline import THEMES, inline_svg
from erosion.version import __version__

_DESCRIPTION = "Erosion by the jet over the angle of the nozzle, by every model and correlation, and the advised angle."


def write_advice(advice: Advice, path: str | Path) -> Path:
    """Write an advice as a page.

    Args:
        advice: of `erosion.advise`.
        path: ends in .html, or in .pdf for one sheet of A4.

    Raises:
        ValueError: for another suffix.
        OSError: where the file cannot be written.
    """
    path = Path(path)
    require_page_path(path)
    notes = _notes(advice)
    content = render(sheet(advice, notes), "pdf") if path.suffix == ".pdf" else _html(advice, notes).encode()
    write_whole(path, content)
    return path


def require_page_path(path: Path) -> None:
    """Check that `write_advice` can write to the path; errors as of `write_advice`."""
    if path.suffix not in (".html", ".pdf"):
        raise ValueError(f"{path}: the page's file name must end in .html or .pdf.")
    require_writable(path)


def _html(advice: Advice, notes: list[tuple[str, str]]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("erosion.advice", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    with tempfile.TemporaryDirectory() as folder:
        figure = inline_svg(save_plot(plot_advice(advice), Path(folder) / "curves.svg"), _DESCRIPTION)
    return environment.get_template("page.html").render(
        advice=advice, degrees=degrees, notes=notes, figure=figure, themes=THEMES, version=__version__
    )


def _notes(advice: Advice) -> list[tuple[str, str]]:
    """What the advice rests on, names with their texts."""
    p = advice.p.to("si")
    shown = ("k", "psi", "r", "b", "m", "v0", "sigma", "inertia", "phidot0")
    rows = [quantity_row(name, QUANTITIES[name], getattr(p, name), "si") for name in shown]
    numbers = ", ".join(f"{row.symbol} = {float(row.value):.4g} {row.unit}".rstrip() for row in rows)
    jet = f"angles deviate by {degrees(advice.spread)} (standard deviation)"
    jet += f", speeds by {advice.speed_spread:.0%}" if advice.speed_spread else ", all speeds are equal"
    notes = [("The case", numbers), ("The jet", jet)]
    if advice.particle is not None:
        notes.append(("Particle", f"{advice.particle}, {advice.particle.density:g} kg/m³ ({advice.particle.source})"))
    if advice.target is not None:
        low, high = (end / 1e6 for end in advice.target.flow_stress_range)
        density = "" if advice.target.density is None else f", {advice.target.density:g} kg/m³"
        notes.append(
            ("Target", f"{advice.target}, σ from {low:.4g} to {high:.4g} MPa{density} ({advice.target.source})")
        )
    if any(not curve.fits for curve in advice.group("correlations")):
        notes.append(("Correlations", "those that are not made for this metal count for the angle, not for the amount"))
    notes += [("Out of range", sentence.rstrip(".")) for sentence in advice.outside]
    notes.append(("Cutting particles", f"{advice.per_mass.cutting_fraction:.3g} of all (Finnie: about one half)"))
    return notes
