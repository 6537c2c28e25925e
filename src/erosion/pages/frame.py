"""The frame of every page: head, style and print rules, with figures inside the file."""

import base64
import re
from collections.abc import Mapping
from typing import Any

import jinja2
from markupsafe import Markup, escape

from erosion.plotting.labels import DIM, FAINT, INK, PALETTE
from erosion.version import __version__

THEMES: Mapping[str, Mapping[str, str]] = {
    "light": {**PALETTE, "ink": INK, "faint": FAINT, "dim": DIM, "paper": "#ffffff", "page": "#f4f5f7",
              "accent": "#00568a"},
    "dark": {"blue": "#4fb0f0", "vermillion": "#ff8a47", "green": "#2fcca0", "purple": "#e3a0c6", "sky": "#2f7fb8",
             "orange": "#f0b429", "ink": "#e4e7eb", "faint": "#39414a", "dim": "#98a2ad", "paper": "#1b2027",
             "page": "#12161b", "accent": "#7cc4f5"},
}  # fmt: skip
"""Colours of the page by CSS variable. Figures have the same colours; on a dark page they are lighter."""

_VARIABLES = {THEMES["light"][name]: name for name in (*PALETTE, "ink", "faint", "dim")}


def inline_svg(name: str, text: str, description: str) -> Markup:
    """A figure as `<svg>`: it fills its box, has the page's colours, and its ids are unique on the page.

    Args:
        name: of the figure; ids begin with it.
        text: of the SVG file.
        description: a description for readers who cannot see the figure.
    """
    text = text[text.index("<svg") :].strip().replace("fill: #ffffff", "fill: none")
    for color, variable in _VARIABLES.items():
        text = re.sub(color, f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", text)
    start, content = text.split(">", 1)
    start = re.sub(r'\s(?:width|height|version)="[^"]*"', "", start)
    return Markup(start + f' role="img" aria-label="{escape(description)}">' + content)


def inline_png(content: bytes, description: str) -> Markup:
    """A picture as `<img>` that holds it.

    Args:
        content: of the PNG file.
        description: a description for readers who cannot see the picture.
    """
    return Markup('<img alt="{}" src="data:image/png;base64,{}" />').format(
        description, base64.b64encode(content).decode()
    )


def render_page(template: str, *, package: str = "erosion.pages", **fields: Any) -> str:
    """The text of a page.

    Args:
        template: a file of the package, which extends "frame.html".
        package: the folder of the template.
        fields: of the template.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name, ".") for name in (package, "erosion.pages")]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(themes=THEMES, version=__version__, **fields)
