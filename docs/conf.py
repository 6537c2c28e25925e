"""How the pages are built: `make docs`."""

import base64
import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import platformdirs
from sphinx.addnodes import toctree
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

import erosion

HERE = Path(__file__).parent

project = "erosion"
author = "The erosion developers"
version = release = erosion.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

# Nothing is fetched by a reader's browser: MathJax 3.2.2, one file with its fonts, is kept here.
html_theme = "furo"
html_title = "erosion"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
templates_path = ["_templates"]
html_show_sphinx = html_show_copyright = html_copy_source = False
mathjax_path = "mathjax/tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}

myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3

# Every page is run anew, so that none shows what the package no longer does; a cell that fails
# or complains fails the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "error"
nb_merge_streams = True

# What the cells' processes inherit: the command line of this environment, plain tables that fit
# the page, and JAX's compiled programs of the last build.
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ |= {"COLUMNS": "88", "TTY_COMPATIBLE": "0"}
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(platformdirs.user_cache_path("erosion") / "compiled"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")

default_role = "literal"
autodoc_member_order = "bysource"
# A page for each object. On some file systems `erosion.impact` and `erosion.Impact` would share a file.
autosummary_filename_map = {
    f"erosion.{name}": f"erosion.{name}_function" for name in ("impact", "particle", "posterior", "stream", "target")
}
autodoc_typehints = "signature"
# No inventories of other projects: they would be fetched. Their names, and those of parts that
# only results hold, stay plain text.
nitpicky = True
nitpick_ignore_regex = [
    (
        "py:class",
        r"(collections|diffrax|distributed|jax|jaxlib|jaxtyping|matplotlib|numpy|pathlib|xarray|xr)\..*|ndarray|Lanes",
    ),
    (
        "py:class",
        r"erosion\.(advice\.(abrasives\.Job|result\.Uncertain)|cfd\.exports\.ExportedParticle|fits\.(least_squares\.(Fit|LeastSquares)|ranking\._Fit|likelihood\.|predicted\.|prediction\.Hypothesis|tempering\.)|models\.base\.(OwnParameter|OwnQuantity|_Method)|ode\.(ensemble|maximum|problem|solution|tape)\.|output\.|results\.declaration\.|parameters\.(case_files\.Tested|dimensions\.|per_mass\.|quantities\.)|streams\.tally\.).*",
    ),
]
napoleon_numpy_docstring = False
napoleon_use_rtype = False


def deal_out(app: Sphinx, env: BuildEnvironment, docnames: list[str]) -> None:
    """Give each process that reads pages as many with cells, which are neighbours in the order of names."""
    docnames[:] = [name for first in range(8) for name in docnames[first::8]]


def leave_objects_out_of_navigation(app: Sphinx, env: BuildEnvironment) -> None:
    """Have the side bar end at the page of the API: 200 objects beside each page take half of the time of a build."""
    for objects in [*env.tocs["api"].findall(toctree)]:
        objects.parent.remove(objects)


def point_to_examples(app: Sphinx, docname: str, source: list[str]) -> None:
    """Have links between the pages and the examples, two folders of the repository, lead to their pages here."""
    source[0] = source[0].replace("](../examples/", "](examples/")
    if docname.startswith("examples/"):
        source[0] = source[0].replace("](../docs/", "](../").replace("](../models/", "](../../models/")


def offer_notebook(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Tell the page's template where the executed notebook is."""
    if doctree is not None and (_notebooks(app) / f"{pagename}.ipynb").is_file():
        context["notebook"] = f"_notebooks/{pagename}.ipynb"


def copy_notebooks(app: Sphinx, failed: Exception | None) -> None:
    """Put the executed notebooks beside the pages."""
    if failed is None and app.builder.format == "html":
        for notebook in _notebooks(app).rglob("*.ipynb"):
            copy = Path(app.outdir) / "_notebooks" / notebook.relative_to(_notebooks(app))
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(notebook, copy)


def show_thumbnails(app: Sphinx, pagename: str, templatename: str, context: dict[str, Any], doctree: Any) -> None:
    """Put the first figure of each example above its link on the page of examples."""
    if pagename != "examples":
        return
    folder = Path(app.outdir) / "_images" / "examples"
    folder.mkdir(parents=True, exist_ok=True)

    def card(link: re.Match) -> str:
        figure = _first_figure(_notebooks(app) / "examples" / f"{link[1]}.ipynb", folder)
        return f'{link[0]}<img src="_images/examples/{figure}" alt="">'

    context["body"] = re.sub(r'<a class="reference internal" href="examples/([\w-]+)\.html">', card, context["body"])


def _first_figure(notebook: Path, folder: Path) -> str:
    """Write the first figure of an executed notebook into a folder, and return its name."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    for data in (output["data"] for cell in cells for output in cell.get("outputs", ()) if "data" in output):
        for kind, ending in (("image/svg+xml", "svg"), ("image/png", "png")):
            if kind in data:
                figure = folder / f"{notebook.stem}.{ending}"
                content = "".join(data[kind])
                figure.write_bytes(content.encode() if ending == "svg" else base64.b64decode(content))
                return figure.name
    raise ValueError(f"{notebook} has no figure")


def copy_examples() -> None:
    """Put the notebooks of examples/ where Sphinx reads: it sees its own folder only."""
    shutil.rmtree(HERE / "examples", ignore_errors=True)
    shutil.copytree(HERE.parent / "examples", HERE / "examples", ignore=shutil.ignore_patterns(".*"))


def _notebooks(app: Sphinx) -> Path:
    return Path(app.outdir).parent / "jupyter_execute"


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    shutil.rmtree(HERE / "api", ignore_errors=True)  # pages of objects that are no more
    copy_examples()
    app.connect("env-before-read-docs", deal_out)
    app.connect("env-updated", leave_objects_out_of_navigation)
    app.connect("source-read", point_to_examples)
    app.connect("html-page-context", offer_notebook)
    app.connect("html-page-context", show_thumbnails)
    app.connect("build-finished", copy_notebooks)
