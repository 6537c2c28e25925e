"""`erosion models`: what can be computed."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.options import JsonOption, print_json, user_errors


def models(
    *,
    path: Annotated[Path | None, Parameter(help="Also list the model files in this folder.")] = None,
    json: JsonOption = False,
) -> None:
    """List every model: name, what it says, and the source's equations."""
    from erosion.models import available_models

    with user_errors():
        found = available_models(path)
    if json:
        print_json({name: {"summary": info.summary, "equations": info.equations} for name, info in found.items()})
        return
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("model", no_wrap=True)
    table.add_column("what it says")
    table.add_column("source", style="dim")
    for name, info in found.items():
        table.add_row(name, info.summary, info.equations)
    Console(highlight=False).print(table)
