"""The frame that all pages share: head, colours, and how a template becomes text."""

from typing import Any

import jinja2

from erosion.output.language import Language
from erosion.report.text import THEMES
from erosion.version import __version__


def render_page(template: str, language: Language, *, package: str = "erosion.report", **fields: Any) -> str:
    """The text of a page.

    Args:
        template: a file of the package, which extends "frame.html".
        language: of the page; templates translate by `_`.
        package: that has the file.
        fields: of the template.
    """
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader([jinja2.PackageLoader(name, ".") for name in (package, "erosion.report")]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template(template).render(
        _=language.text, lang=language.tag, themes=THEMES, version=__version__, **fields
    )
