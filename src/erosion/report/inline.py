"""A matplotlib figure as an SVG element of a page that may be light or dark."""

import re
from collections.abc import Mapping
from pathlib import Path

from markupsafe import Markup, escape

from erosion.plotting.colors import DIM, FAINT, INK, PALETTE

THEMES: Mapping[str, Mapping[str, str]] = {
    "light": {**PALETTE, "ink": INK, "faint": FAINT, "dim": DIM, "paper": "#ffffff", "page": "#f4f5f7",
              "accent": "#00568a"},
    "dark": {"blue": "#4fb0f0", "vermillion": "#ff8a47", "green": "#2fcca0", "purple": "#e3a0c6", "sky": "#2f7fb8",
             "orange": "#f0b429", "ink": "#e4e7eb", "faint": "#39414a", "dim": "#98a2ad", "paper": "#1b2027",
             "page": "#12161b", "accent": "#7cc4f5"},
}  # fmt: skip
"""Colours of the page by CSS variable. Figures have the same colours; on a dark page they are lighter."""

_VARIABLES = {THEMES["light"][name]: name for name in (*PALETTE, "ink", "faint", "dim")}


def inline_svg(path: Path, description: str) -> Markup:
    """A saved figure as `<svg>`: it fills its box, has the page's colours, and its ids are unique on the page.

    Args:
        path: the SVG file; ids begin with the file's name and so are unique on the page.
        description: a description for readers who cannot see the figure.
    """
    name, text = path.stem, path.read_text(encoding="utf-8")
    text = text[text.index("<svg") :].strip().replace("fill: #ffffff", "fill: none")
    for color, variable in _VARIABLES.items():
        text = re.sub(color, f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    start, content = text.split(">", 1)
    start = re.sub(r'\s(?:width|height|version)="[^"]*"', "", start)
    return Markup(start + f' role="img" aria-label="{escape(description)}">' + content)
