"""A map as one page: the picture, the worst faces, the totals, and what they rest on."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.cfd.map_files import Identity, MapFormat, require_map_path
from erosion.cfd.map_result import FACES, MapSummary
from erosion.output import require_no_pdf, with_error, write_whole
from erosion.pages.frame import inline_png, render_page
from erosion.parameters import readable_scale
from erosion.plotting.maps import depth_of, in_scale, plot_map
from erosion.plotting.style import render
from erosion.results.render import tables
from erosion.version import __version__

_WORST = 10  # faces that a page lists
_ASSUMED = (
    "Each impact meets a plane, smooth wall that has not worn; impacts do not know of each other. ± is the standard "
    "error of the sample of impacts: it knows no error of the flow, of the velocities or of the model."
)


def write_map_page(wear: xr.Dataset, path: str | Path, quantity: str | None = None, **look: Any) -> Path:
    """Write a map as one page: the picture, the worst ten faces, totals, what is assumed, and warnings.

    Args:
        wear: what `erosion_map` returns, of a surface.
        path: ends in .html; the picture is in the file. A browser prints it.
        quantity: of the picture, see `plot_map`.
        look: view, zoom and log of `plot_map`.

    Raises:
        ValueError: for another suffix, and as of `plot_map`.
        OSError: where the file cannot be written.
    """
    require_no_pdf(Path(path))
    path = require_map_path(path, has_surface="face" in wear.dims, formats=page_format())
    title = f"Wear of {Path(wear.attrs['surface']).name}"
    summary = MapSummary(wear)
    totals = [
        (table.title, table.headings, table.rows, table.notes)
        for table in tables("Totals", summary.declare(), summary.shown_in)
    ]
    options = re.sub(r"\d+\.\d{6,}", lambda number: f"{float(number[0]):.6g}", wear.attrs["options"])
    source = "; ".join(filter(None, [summary.title, options, f"erosion {__version__}"]))
    source = re.sub(r"\b(sand_rate = [^, ;]+)(?=[,;])", r"\1 kg/s", source)
    # A reader of the page knows no arguments.
    warnings = [re.sub(r"(?:Argument )?`(\w+)`", r"“\1”", warning) for warning in summary.warnings]
    notes = [*wear.attrs["read_as"].splitlines(), _ASSUMED, f"{wear.attrs['model']}: {wear.attrs['constants']}", source]
    picture = inline_png(render(plot_map(wear, quantity, **look), "png"), "The surface, coloured by its wear.")
    fields = {
        "title": title,
        "warnings": warnings,
        "picture": picture,
        "tables": [_worst_faces(wear), *totals],
        "notes": notes,
    }
    write_whole(path, render_page("map.html", **fields).encode())
    return path


def page_format(quantity: str | None = None, **look: Any) -> Mapping[str, MapFormat]:
    """The page as a format of maps, by the ending of its file; arguments as of `write_map_page`."""

    def write(wear: xr.Dataset, path: Path, _: Identity) -> None:
        write_map_page(wear, path, quantity, **look)

    return {".html": MapFormat(write, holds_surface=True, is_drawn=True)}


_Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
"""Title, headings and rows."""


def _worst_faces(wear: xr.Dataset) -> _Table:
    """The faces with the greatest depth, with their places."""
    name = depth_of(wear)
    scale, depth = in_scale(wear, name)
    errors, centre = depth * wear["relative_error"].values, wear["centre"].values
    length = readable_scale("length", "si", float(np.abs(centre).max()))
    rows = []
    for face in [face for face in np.argsort(-np.nan_to_num(depth), kind="stable")[:_WORST] if depth[face] > 0]:
        patch = wear["patch"].values[wear["face_patch"].values[face]]
        place = ", ".join(f"{number / length.size:.4g}" for number in centre[face])
        rows.append([
            f"{face:,}", str(patch), place, with_error(float(depth[face]), float(errors[face])),
            f"{int(wear['impacts'][face]):,}", f"{math.degrees(float(wear['alpha_mean'][face])):.3g}°",
            f"{float(wear['v0_mean'][face]):.3g}",
        ])  # fmt: skip
    headings = ["face", "patch", f"x, y, z [{length.unit}]", f"{FACES[name].meaning.split(',')[0]} [{scale.unit}]",
                "rows", "mean angle", "speed [m/s]"]  # fmt: skip
    return f"The worst {len(rows)} faces", headings, rows
