"""`erosion models`: what can be computed."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.options import JsonOption, print_json, print_rich, user_errors

if TYPE_CHECKING:
    from erosion.models.registry import ModelInfo

_LONGEST_NAME = 40


def models(
    *,
    path: Annotated[
        Path | None,
        Parameter(help="Also list the model files in this folder. They are run as Python: list only what you trust."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List every model: name, what it says, the source's equations, and its own parameters (for --set).

    A model that cannot be used is listed with the reason, and the exit status is then 1.
    """
    from erosion.models import available_models

    with user_errors():
        found = available_models(path)
    if json:
        keys = ("summary", "equations", "error")
        print_json(
            {
                name: {key: getattr(info, key) for key in keys} | {"own_parameters": _own(info)}
                for name, info in found.items()
            }
        )
    else:
        _print_table(found)
    broken = [name for name, info in found.items() if info.error]
    if broken:
        raise RuntimeError(f"{len(broken)} of {len(found)} models cannot be used.")


def _print_table(found: "Mapping[str, ModelInfo]") -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    # Names are kept whole; paths may be longer.
    table.add_column("model", overflow="fold", min_width=min(_LONGEST_NAME, max(map(len, found))))
    table.add_column("what it says, and the source's equations", ratio=1)
    for name, info in found.items():
        said = Text(info.error, "red") if info.error else Text.assemble(info.summary, (f"  {info.equations}", "dim"))
        table.add_row(Text(name), said)
        for own, one in _own(info).items():
            meaning = f"  {one['symbol']}, {one['meaning']}" if one["symbol"] != own else ""
            table.add_row("", Text.assemble(f"{own} = {one['value']:g}", (meaning, "dim")))
    print_rich(table)


def _own(info: "ModelInfo") -> dict[str, dict[str, Any]]:
    """Value and names of a model's own parameters; none of a model that cannot be used."""
    from erosion.models.own_parameters import own_parameters

    own = {} if info.error else own_parameters(info.make())
    return {
        name: {"value": float(one.value), "symbol": one.quantity.symbol, "meaning": one.quantity.meaning}
        for name, one in own.items()
    }
