"""`erosion models`: what can be computed."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.options import JsonOption
from erosion.cli.output import Output, print_table

if TYPE_CHECKING:
    from erosion.models.registry import ModelInfo


def models(
    *,
    path: Annotated[
        Path | None,
        Parameter(help="Also list the model files in this folder. They are run as Python: list only what you trust."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List every model with its equations and its own parameters (for --set).

    A model that cannot be used is listed with the reason; the exit status is
    then 1. Correlations, which stand below the table, may be named wherever a
    model may.
    """
    from erosion.models import available_models

    with user_errors():
        catalogue = available_models(path)
    if json:
        keys = ("summary", "equations", "error")
        described = {
            name: {key: getattr(info, key) for key in keys} | {"own_parameters": _own(info)}
            for name, info in catalogue.items()
        }
        Output("models", json=True).document({"models": described})
    else:
        _print_table(catalogue)
    broken = [name for name, info in catalogue.items() if info.error]
    if broken:
        raise RuntimeError(f"{len(broken)} of {len(catalogue)} models cannot be used.")


def _print_table(catalogue: "Mapping[str, ModelInfo]") -> None:
    from rich.text import Text

    from erosion.correlations import CORRELATIONS

    rows: list[tuple[str, Text]] = []
    for name, info in catalogue.items():
        text = Text(info.error, "red") if info.error else Text.assemble(info.summary, (f"  {info.equations}", "dim"))
        rows.append((name, text))
        for own, parameter in _own(info).items():
            meaning = f"  {parameter['symbol']}, {parameter['meaning']}" if parameter["symbol"] != own else ""
            rows.append(("", Text.assemble(f"{own} = {parameter['value']:g}", (meaning, "dim"))))
    correlations = (
        f"Correlations of engineers can take the place of a model: {', '.join(CORRELATIONS)}. "
        'Some have a table of targets: "dnv:duplex".'
    )
    print_table("", rows, ("model", "what it says, and the source's equations"), (), [correlations])


def _own(info: "ModelInfo") -> dict[str, dict[str, Any]]:
    """Value and names of a model's own parameters; none of a model that cannot be used."""
    from erosion.models.own_parameters import own_parameters

    own = {} if info.error else own_parameters(info.make())
    return {
        name: {
            "value": float(parameter.value),
            "symbol": parameter.quantity.symbol,
            "meaning": parameter.quantity.meaning,
        }
        for name, parameter in own.items()
    }
