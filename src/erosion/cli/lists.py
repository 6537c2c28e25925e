"""Lists as options take them: with commas between the items, or the option repeated."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError
from erosion.files import is_file

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel


def read_list(text: str) -> list[str]:
    """The items of a list, with commas between them; a ValueError where there is none."""
    items = [item.strip() for item in text.split(",") if item.strip()]
    if not items:
        raise ValueError(f"must list one item or more, but is {text!r}")
    return items


def read_models(text: str) -> list[str]:
    """The models that a text names; the path of a file may have a comma."""
    return [text] if is_file(text) else read_list(text)


LISTED = Parameter(
    negative="", converter=lambda kind, tokens: [item for token in tokens for item in read_list(token.value)]
)
IgnoreOption = Annotated[
    list[str] | None, LISTED, Parameter(help='Columns of the table to leave out: "frequency", or several.')
]
ModelOption = Annotated[
    str, Parameter(name="--model", help="A model's name (see `erosion models`), or the path of a Python file.")
]
ModelsOption = Annotated[
    list[str] | None,
    Parameter(
        name="--model",
        negative="",
        converter=lambda kind, tokens: [item for token in tokens for item in read_models(token.value)],
        help='Names or paths of Python files: "linearized,rotating", or the option repeated; "all" for every model. '
        "A path with a comma needs an option of its own.",
    ),
]


def chosen_models(names: Sequence[str] | Any) -> Any:
    """The models that are named, where "all" stands for every usable one."""
    from erosion.models import usable_models

    if not isinstance(names, list) or "all" not in names:
        return names
    others = [name for name in names if name != "all"]
    return list(dict.fromkeys((*usable_models(), *others)))


def refuse_same(models: "Mapping[str, CuttingModel]") -> None:
    """Refuse two names of one model, as "dnv" and "dnv:carbon-steel" are for a target of steel.

    Args:
        models: by the names that are given; correlations are made for the target.
    """
    from erosion.models import called

    first: dict[str, str] = {}
    for name, model in models.items():
        other = first.setdefault(called(name, model), name)
        if other != name:
            raise InputError(
                f"Option `--model` must name different models, but `{other}` and `{name}` are the same here: "
                f"{called(name, model)}."
            )
