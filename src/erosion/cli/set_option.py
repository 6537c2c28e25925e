"""`--set friction=0.3`: a model's own parameters at the command line and in case files."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading
from erosion.cli.options import CaseOptions

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel
    from erosion.parameters.units import Dimension, System

SetOption = Annotated[
    list[str] | None,
    Parameter(
        name="--set", negative="", help='An own parameter of the model: "friction=0.3"; repeat it for other parameters.'
    ),
]
Settings = Mapping[str, tuple[str, Any]]
"""By own parameter, where it is set and to what."""


def model_and_settings(
    given: str | None, own: Sequence[str] | None, case: CaseOptions, usual: str = "linearized"
) -> tuple[str, Settings]:
    """The model's name and its settings: those of the options, where these give none those of the case file.

    Args:
        given: the option --model.
        own: the options --set.
        case: whose file may name a model.
        usual: the model where nothing names one.
    """
    section = with_model_of_case({}, case, None if given is None else [given])
    return section.get("model", usual) if given is None else given, settings(own, section, f"{case.case}: `set`")


def named_model(
    given: str | None, own: Sequence[str] | None, case: CaseOptions, units: "System"
) -> "tuple[str, CuttingModel]":
    """The name and the model, with its own parameters set; see `model_and_settings`."""
    from erosion.models import called

    name, of_model = model_and_settings(given, own, case)
    model = load_set(name, of_model, case, units)
    return called(name, model), model


def with_model_of_case(section: Mapping[str, Any], case: CaseOptions, given: Sequence[str] | None) -> Mapping[str, Any]:
    """A verb's table in the case file with the model, and its parameters, that the file names for all verbs.

    Args:
        section: the table; what it says itself wins.
        case: whose file may name a model.
        given: the models of the option --model; another one than the file's leaves out its parameters, too.
    """
    model, own = case.model()
    if model is None or section.get("model", model) != model:
        return section
    if given is not None and (len(given) != 1 or _source(given[0]) != _source(model)):
        return section
    of_verb = section.get("set", {})
    return {**section, "model": model, "set": {**own, **of_verb} if isinstance(of_verb, Mapping) else of_verb}


def _source(model: str) -> str | Path:
    """A model's name, or the one path that all paths of its file have."""
    return Path(model).resolve() if model.endswith(".py") else model


def settings(options: Sequence[str] | None, section: Mapping[str, Any] | None = None, where: str = "") -> Settings:
    """The own parameters that the options and the table `set` of a verb's section set; options win.

    Args:
        options: texts such as "friction=0.3".
        section: the verb's table in the case file.
        where: words for that table, for messages.

    Raises:
        InputError: one sentence naming the option or the field.
    """
    table = (section or {}).get("set", {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table such as {{friction = 0.3}}, but is {table!r}.")
    in_file = {name: (f"{where}, field `{name}`,", value) for name, value in table.items()}
    in_options: dict[str, tuple[str, Any]] = {}
    for text in options or ():
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise InputError(f'Option `--set` must be such as "friction=0.3", but is {text!r}.')
        if name in in_options:
            raise InputError(f"Option `--set` must give `{name}` once, but gives it several times.")
        in_options[name] = (f"Option `--set {name}`", value)
    return in_file | in_options


def read_settings(
    name: str,
    model: "CuttingModel",
    given: Settings,
    units: "System",
    read: "Callable[[str, Any, Dimension, System], Any] | None" = None,
) -> dict[str, Any]:
    """The values of settings.

    Args:
        name: the model's name, for messages.
        model: the model whose own parameters are set.
        given: see `settings`.
        units: of bare numbers and of the result.
        read: takes an own parameter's name, its text, its dimension and the units; gives its value, or
            several, or its law; without it a number.

    Raises:
        InputError: one sentence naming the option or the field.
    """
    import numpy as np

    from erosion.models.own_parameters import own_parameters
    from erosion.parameters.units import read_quantity

    own, values = own_parameters(model), {}
    for key, (source, text) in given.items():
        if key not in own:
            has = f"has {', '.join(own)}" if own else "has none"
            raise InputError(f"{source} must name an own parameter of {name}, which {has}.")
        with reading(source):
            of = own[key].quantity.dimension, units
            values[key] = read_quantity(str(text), *of) if read is None else read(key, text, *of)
        if isinstance(values[key], (float, np.ndarray)) and not np.all(np.isfinite(values[key])):
            raise InputError(f"{source} must be finite, but is {text}.")
        if isinstance(values[key], (float, np.ndarray)) and np.any(values[key] < own[key].least):
            raise InputError(f"{source} must be at least {own[key].least:g}, but is {text}.")
    return values


def load_set(name: str, given: Settings, case: CaseOptions, units: "System") -> "CuttingModel":
    """The model by name or path, see `CaseOptions.load`, with the own parameters that are set."""
    model = case.load(name)
    return model.replace(**read_settings(name, model, given, units))


def in_full(name: str, model: "CuttingModel", units: "System") -> str:
    """A model's name with its own parameters: "linearized-deformation (energy_ratio = 1.6, threshold = 12 m/s)"."""
    from erosion.models.own_parameters import own_in_words

    own = own_in_words(model, units=units)
    return f"{name} ({own})" if own else name
