"""`erosion explore`: the page on which every slider changes the cut."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.errors import InputError, user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import ModelsOption
from erosion.cli.options import CaseFile, CaseOptions, with_file
from erosion.cli.per_mass import PerMassOptions
from erosion.extras import extra

_PORT = 8080


def explore(
    file: CaseFile = None,
    /,
    *,
    case: CaseOptions | None = None,
    per_mass: PerMassOptions | None = None,
    model: Annotated[
        ModelsOption,
        Parameter(help="Also offer the models in these Python files: with commas, or the option repeated."),
    ] = None,
    materials: Annotated[
        list[Path] | None,
        Parameter(negative="", help="Also offer the particles and targets of this table (TOML); it may be repeated."),
    ] = None,
    port: Annotated[int | None, Parameter(help=f"Listen on this port; {_PORT}, or a free one, without it.")] = None,
    host: Annotated[
        str,
        Parameter(
            help="Listen on this address of the machine, for other devices of a network that you trust: 0.0.0.0 for "
            "all. They need the link that is printed."
        ),
    ] = "127.0.0.1",
    browser: Annotated[bool, Parameter(negative="--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Explore cuts in the browser: sliders, live plots, exports. Stop it with Ctrl+C."""
    options = with_file(case, file)
    p, weights = options.parameters(), (per_mass or PerMassOptions()).per_mass(options)
    for path in model or []:
        if not path.endswith(".py"):
            raise InputError(f"Option `--model` must be the path of a Python file here, but is {path!r}.")
    if port is not None and not 0 <= port < 65536:
        raise InputError(f"Option `--port` must be in 0 … 65535, but is {port}.")
    start_engine()
    with extra("explorer"):
        from erosion.explorer.server import free_address, offer, serve
    with user_errors():
        serve(offer(p, model or [], materials or [], weights), free_address(host, port), show=browser)
