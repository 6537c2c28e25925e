"""`--set friction=0.3`: a model's own parameters at the command line and in case files."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.options import InputError, load

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel
    from erosion.parameters.units import Dimension, System

SetOption = Annotated[
    list[str] | None,
    Parameter(
        name="--set", negative="", help='One of the model\'s own parameters: "friction=0.3"; for each of them once.'
    ),
]
Settings = Mapping[str, tuple[str, Any]]
"""By own parameter, what is said of it: where, and what."""


def settings(options: Sequence[str] | None, section: Mapping[str, Any] | None = None, where: str = "") -> Settings:
    """What the options say of own parameters, and the table `set` of a verb's section; options win.

    Args:
        options: "friction=0.3", of each.
        section: the verb's table in the case file.
        where: that table, in words.

    Raises:
        InputError: one sentence naming the option or the field.
    """
    table = (section or {}).get("set", {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table such as {{friction = 0.3}}, but is {table!r}.")
    in_file = {name: (f"{where}, field `{name}`,", value) for name, value in table.items()}
    given: dict[str, tuple[str, Any]] = {}
    for text in options or ():
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise InputError(f'Option `--set` must be such as "friction=0.3", but is {text!r}.')
        if name in given:
            raise InputError(f"Option `--set` must give `{name}` once, but gives it several times.")
        given[name] = (f"Option `--set {name}`", value)
    return in_file | given


def read_settings(
    name: str,
    model: "CuttingModel",
    said: Settings,
    units: "System",
    read: "Callable[[str, Any, Dimension, System], Any]",
) -> dict[str, Any]:
    """The values of settings.

    Args:
        name: what the model is called.
        model: whose own parameters they must be.
        said: see `settings`.
        units: of bare numbers and of the result.
        read: takes an own parameter's name, what is said of it, its dimension and the units; gives its
            value, or several, or its law.

    Raises:
        InputError: one sentence naming the option or the field.
    """
    import numpy as np

    from erosion.models.own_parameters import own_parameters

    own, values = own_parameters(model), {}
    for one, (what, text) in said.items():
        if one not in own:
            has = f"has {', '.join(own)}" if own else "has none"
            raise InputError(f"{what} must name an own parameter of {name}, which {has}.")
        try:
            values[one] = read(one, text, own[one].quantity.dimension, units)
        except ValueError as error:
            raise InputError(f"{what} {error}.") from error
        if isinstance(values[one], (float, np.ndarray)) and not np.all(np.isfinite(values[one])):
            raise InputError(f"{what} must be finite, but is {text}.")
    return values


def load_set(name: str, said: Settings, units: "System") -> "CuttingModel":
    """The model by name or path, with its own parameters as they are said to be."""
    from erosion.parameters.units import read_quantity

    model = load(name)
    changes = read_settings(name, model, said, units, lambda _, text, *of: read_quantity(str(text), *of))
    return model.replace(**changes)


def in_full(name: str, model: "CuttingModel") -> str:
    """A model's name with its own parameters: "friction.py (friction = 0.3)"."""
    from erosion.models.own_parameters import own_in_words

    own = own_in_words(model)
    return f"{name} ({own})" if own else name


def model_as_json(name: str, model: "CuttingModel", but: Collection[str] = ()) -> dict[str, Any]:
    """A model's name, and its own parameters as plain numbers, those named `but` left out."""
    from erosion.models.own_parameters import own_parameters

    own = {key: float(one.value) for key, one in own_parameters(model).items() if key not in but}
    return {"model": name, "own_parameters": own}
