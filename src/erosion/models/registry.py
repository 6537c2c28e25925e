"""Models by name: the built-in ones, those of installed packages, and files by path."""

import functools
import hashlib
import importlib.metadata
import inspect
import os
import sys
import types
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax

from erosion.arguments import check_path
from erosion.correlations import CORRELATIONS
from erosion.models.base import CuttingModel, own_parameters
from erosion.models.correlated import Correlated, correlated
from erosion.models.equations import equations_of, error_in
from erosion.models.parts import (
    Deformation,
    ForceLaw,
    FullTorque,
    ProportionalDeformationWear,
    TanAlpha,
    TipKinematics,
    Torque,
    VelocityAligned,
)
from erosion.models.rigid import AsPrinted, Finnie, Linearized, Rotating, SpeedExponent
from erosion.ode.problem import named
from erosion.output import Record, briefly, to_plain
from erosion.parameters import QUANTITIES, Parameters
from erosion.results import in_unit

_PARTS = {"force": ForceLaw, "torque": Torque, "kinematics": TipKinematics, "deformation": Deformation}

ENTRY_POINT_GROUP = "erosion.models"
"""A package offers a model as an entry point here: its name, and a model or a class of one."""


PLUG_IN = "erosion_plugin_"
"""How the name of a plug-in file's module begins."""


_EXPONENT = "-exponent"  # after the name of a built-in model, that with an exponent of the speed


_LOADED: list[tuple[str, CuttingModel]] = []
"""The models of files and entry points that were loaded, each with its path or name; see `model_source`."""


class ModelError(ValueError):
    """A model that cannot be found or loaded; the message says which and why."""


@dataclass(frozen=True)
class ModelInfo:
    """A model's name, one line on what it is, and the source's equations for it.

    A plug-in that cannot be used has the reason as its `error`, and `make` raises it.
    """

    name: str
    summary: str
    equations: str
    make: Callable[[], CuttingModel]
    error: str | None = None


def _built_in() -> Mapping[str, ModelInfo]:
    tan, aligned, full = TanAlpha(), VelocityAligned(), FullTorque()
    # A body that turns cuts a third of what one that does not turn cuts (P = k/3 in `finnie`, β = ½).
    deforms, deforms_less = ProportionalDeformationWear(1.6), ProportionalDeformationWear(4.8)
    entries = (
        ("linearized", "no rotation, constant K = k", "(22)-(25)", Linearized),
        ("tan-alpha", "no rotation, K = tan α", "additional question 2", lambda: Linearized(force=tan)),
        ("velocity-aligned", "no rotation, K = ẏ/ẋ along the motion", "additional question 3, (29)",
         lambda: Linearized(force=aligned)),
        ("finnie", "rotation to first order, constant K = k, torque r F_x", "Finnie (1958)", Finnie),
        ("rotating", "full rotation, constant K = k, torque r F_x", "additional question 1, (16)-(21)", Rotating),
        ("rotating-full-torque", "full rotation, constant K = k, torque of both components",
         "additional question 1", lambda: Rotating(torque=full)),
        ("rotating-tan-alpha", "full rotation, K = tan α, torque r F_x", "additional questions 1 and 2",
         lambda: Rotating(force=tan)),
        ("rotating-velocity-aligned", "full rotation, K = ẏ/ẋ of the centre of mass, torque r F_x",
         "additional questions 1 and 3", lambda: Rotating(force=aligned)),
        ("rotating-tan-alpha-full-torque", "full rotation, K = tan α, torque of both components",
         "additional questions 1 and 2", lambda: Rotating(force=tan, torque=full)),
        ("rotating-velocity-aligned-full-torque",
         "full rotation, K = ẏ/ẋ of the centre of mass, torque of both components",
         "additional questions 1 and 3", lambda: Rotating(force=aligned, torque=full)),
        ("linearized-deformation", "no rotation, K = k, and wear by deformation", "(22)-(25); Bitter (1963)",
         lambda: Linearized(deformation=deforms)),
        ("finnie-deformation", "rotation to first order, K = k, and wear by deformation",
         "Finnie (1958); Bitter (1963)", lambda: Finnie(deformation=deforms_less)),
        ("rotating-deformation", "full rotation, K = k, and wear by deformation", "(16)-(21); Bitter (1963)",
         lambda: Rotating(deformation=deforms_less)),
        ("as-printed", "equations (16)-(21) to the letter, slips included", "(16)-(21) as printed", AsPrinted),
    )  # fmt: skip
    return types.MappingProxyType({entry[0]: ModelInfo(*entry) for entry in entries})


BUILT_IN: Mapping[str, ModelInfo] = _built_in()


def require_loadable(model: object, hint: str = "") -> None:
    """Refuse a plug-in's model for a cluster: only this process knows its class, workers load it by its path.

    Raises:
        ValueError: for a model of a plug-in; `hint` ends the sentence.
    """
    import cloudpickle  # comes with the extra `dask`

    if isinstance(model, CuttingModel) and PLUG_IN.encode() in cloudpickle.dumps(model):
        raise ValueError(
            f"Argument `model` must be the path of a plug-in where a cluster computes, but is a model of one{hint}."
        )


def available_models(path: str | Path | None = None) -> dict[str, ModelInfo]:
    """Every model that `load_model` knows by name, with its description.

    Args:
        path: a folder (or file) of plug-ins to list as well, by path. They are run as Python.

    Returns:
        `ModelInfo` by name: built-in models, then entry points, then files. One that cannot
        be used is listed with the reason, as its `error`.

    Raises:
        ModelError: where there is no such file or folder.
    """
    models = dict(BUILT_IN)
    for entry in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        if entry.name not in models:
            models[entry.name] = _listed(entry.name, functools.partial(_from_entry_point, entry))
    if path is not None:
        folder = check_path("path", path)
        if not folder.exists():
            raise ModelError(f"{folder}: there is no such file or folder of models.")
        files = sorted(folder.glob("*.py")) if folder.is_dir() else [folder]
        for file in files:
            models[str(file)] = _listed(str(file), functools.partial(_file, file))
    return models


def usable_models() -> list[str]:
    """The names of the models that can be used; a plug-in that cannot leaves the others as they are."""
    return [name for name, info in available_models().items() if info.error is None]


@functools.cache
def _built_in_model(name: str) -> CuttingModel:
    return BUILT_IN[name].make()


@functools.cache
def _with_exponent(name: str) -> CuttingModel:
    return SpeedExponent(_built_in_model(name))


@functools.cache
def _correlated(name: str) -> CuttingModel:
    """A correlation with its default target, or with another after a colon: "dnv:duplex"."""
    correlation, colon, material = name.partition(":")
    targets = CORRELATIONS[correlation].materials
    if colon and material not in targets:
        known = f"one of {', '.join(targets)}" if targets else "left out"
        raise ModelError(f"Model {name!r}: the target after the colon must be {known}.")
    return correlated(correlation, material if colon else None)


def load_model(name: str | Path | CuttingModel) -> CuttingModel:
    """A model by registered name, or by the path of a Python file.

    A file defines its model as a variable `model`, or as its only `CuttingModel` class that
    can be made without arguments. Loading a file runs it: load only what you trust.

    Args:
        name: "rotating", "rotating-exponent" (see `erosion.models.SpeedExponent`), "models/my_model.py", a correlation
            such as "dnv" or "dnv:duplex" (see `erosion.models.correlated`), or a model, which is returned as it is.

    Raises:
        ModelError: one sentence on what is wrong with the name, the file or the model.
    """
    if isinstance(name, CuttingModel):
        return _sound(name, lambda: f"Model {model_name(name)}")
    for part, kind in _PARTS.items():
        if isinstance(name, kind):
            example = f"erosion.models.Rotating({part}={type(name).__name__}())"
            raise ModelError(
                f"Argument `model` must be a model, but is a part of one: give it to one, as in `{example}`."
            )
    if not isinstance(name, (str, Path)):
        raise ModelError(f"Argument `model` must be a model, its name or a path, but is {briefly(name)}.")
    if str(name) in BUILT_IN:
        return _built_in_model(str(name))
    if str(name).removesuffix(_EXPONENT) in BUILT_IN:
        return _with_exponent(str(name).removesuffix(_EXPONENT))
    if str(name).partition(":")[0] in CORRELATIONS:
        return _correlated(str(name))
    if str(name).endswith(".py"):
        return _remembered(str(name), _file(Path(name))[0])
    for entry in importlib.metadata.entry_points(group=ENTRY_POINT_GROUP):
        if entry.name == str(name):
            return _remembered(entry.name, _from_entry_point(entry)[0])
    known = ", ".join((*available_models(), *CORRELATIONS))
    raise ModelError(
        f"There is no model {briefly(str(name))}; known are {known}, and Python files by path (…/model.py)."
    )


def model_name(model: CuttingModel) -> str:
    """The registered name of a model; else its class, with those of its parts that are a plug-in's."""
    if type(model) is SpeedExponent:
        return f"{model_name(model.motion)}{_EXPONENT}"
    if isinstance(model, Correlated):
        return model.label
    for name, info in BUILT_IN.items():
        if _same_parts(info.make(), model):
            return name
    parts = [type(part).__name__ for part in vars(model).values() if isinstance(part, eqx.Module)
             and not type(part).__module__.startswith("erosion.")]  # fmt: skip
    return type(model).__name__ + (f"({', '.join(parts)})" if parts else "")


def model_source(model: CuttingModel) -> str | None:
    """The name of a model, or the path of its file, which `load_model` reads; own parameters aside.

    Returns:
        None for a model that was made in a program, and has no name.
    """
    if isinstance(model, Correlated):
        return model.label
    if type(model) is SpeedExponent and (name := model_name(model.motion)) in BUILT_IN:
        return f"{name}{_EXPONENT}"
    for name, info in BUILT_IN.items():
        if _same_parts(info.make(), model):
            return name
    for source, loaded in reversed(_LOADED):
        if _same_parts(loaded, model):
            own = {name: parameter.value for name, parameter in own_parameters(loaded).items()}
            if eqx.tree_equal(model.replace(**own), loaded):
                return source
    return None


def _remembered(source: str, model: CuttingModel) -> CuttingModel:
    """The model, of which `model_source` now knows the name or the path, which stays when the folder changes."""
    _LOADED.append((str(Path(source).absolute()) if source.endswith(".py") else source, model))
    return model


def called(given: str | Path | CuttingModel, model: CuttingModel) -> str:
    """The name of a model in output: as a user gave it; a correlation has its target."""
    by_name = isinstance(given, (str, Path)) and not isinstance(model, Correlated)
    return str(given) if by_name else model_name(model)


def impact_to_dict(model: CuttingModel, p: Parameters, but: Collection[str] = ()) -> Record:
    """A model's name and its own parameters (`but` some), and the parameters of the case, for `to_dict` of results."""
    own = {name: in_unit(parameter.value, parameter.quantity.size(p.shown_in))
           for name, parameter in own_parameters(model).items() if name not in but}  # fmt: skip
    case = {name: in_unit(getattr(p, name), quantity.size(p.shown_in)) for name, quantity in QUANTITIES.items()}
    return to_plain({"model": model_name(model), "own_parameters": own, "parameters": {**case, "units": p.shown_in}})


def _same_parts(model: CuttingModel, other: CuttingModel) -> bool:
    """Whether the parts compute the same; the values of own parameters may differ."""
    if jax.tree.structure(model) != jax.tree.structure(other):
        return False
    # Structures compare what they hold by ==, for which 2 is 2.0, and do not see code that was defined anew.
    return equations_of(model).digest == equations_of(other).digest


def _listed(name: str, load: Callable[[], tuple[CuttingModel, object]]) -> ModelInfo:
    """A plug-in's line in the list, given how to load it and what has its description."""
    try:
        model, documented = load()
    except ModelError as error:
        return ModelInfo(name, "", "plug-in", lambda: load()[0], str(error))
    text = inspect.getdoc(documented) or "no description"
    return ModelInfo(name, text.strip().splitlines()[0], "plug-in", lambda: model)


def _file(path: Path) -> tuple[CuttingModel, types.ModuleType]:
    module = _import_file(path)
    return _made(_choose(module, path), str(path)), module


def _from_entry_point(entry: importlib.metadata.EntryPoint) -> tuple[CuttingModel, type]:
    where = f"Model {entry.name!r} (entry point {entry.value})"
    try:
        loaded = entry.load()
    # A plug-in may fail in any way while it is imported.
    except (Exception, SystemExit) as error:
        raise ModelError(f"{where} cannot be imported: {named(error)}.") from error
    model = _made(loaded, where)
    return model, type(model)


def _import_file(path: Path) -> types.ModuleType:
    """Run a file as a module. Python's own import might run what it compiled of an older text.

    The module keeps its text as `__source_bytes__`, from which a store's identity is made: the file may change.
    """
    if not path.is_file():
        raise ModelError(f"{path}: there is no such model file.")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror or error}).") from error
    place = path.absolute()
    # Of its own for each file and each text, so that a class's module is always the one that it was made in.
    key = hashlib.sha256(os.fsencode(place) + b"\0" + content).hexdigest()[:16]
    module = types.ModuleType(PLUG_IN + key)
    module.__file__ = str(place)
    module.__dict__["__source_bytes__"] = content
    sys.modules[module.__name__] = module
    try:
        exec(compile(content, str(place), "exec", dont_inherit=True), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        raise ModelError(f"{path}: cannot be imported: {named(error)}{_beside(error, path)}.") from error
    return module


def _beside(error: BaseException, path: Path) -> str:
    """How Python finds a module that lies beside the plug-in, where it is this that it did not find."""
    name = error.name if isinstance(error, ModuleNotFoundError) else None
    if name is None or not (path.with_name(f"{name}.py").exists() or path.with_name(name).is_dir()):
        return ""
    return "; it lies beside the file: add that folder to PYTHONPATH"


def _choose(module: types.ModuleType, path: Path) -> object:
    if hasattr(module, "model"):
        return module.model
    classes = [
        value
        for value in vars(module).values()
        if inspect.isclass(value) and issubclass(value, CuttingModel) and value.__module__ == module.__name__
    ]
    complete = [candidate for candidate in classes if not inspect.isabstract(candidate)]
    if len(classes) == 1 and not complete:
        lacking = ", ".join(f"`{name}`" for name in sorted(classes[0].__abstractmethods__))
        raise ModelError(f"{path}: {classes[0].__name__} must have all methods of a model, but lacks {lacking}.")
    if len(complete) != 1:
        names = ", ".join(c.__name__ for c in complete) or "none"
        raise ModelError(f"{path}: must define `model`, or exactly one complete CuttingModel class, but has {names}.")
    return complete[0]


def _made(candidate: object, where: str) -> CuttingModel:
    if isinstance(candidate, CuttingModel):
        return _sound(candidate, lambda: where)
    if not callable(candidate):
        raise ModelError(f"{where}: must offer a CuttingModel, but offers {briefly(candidate)}.")
    try:
        model = candidate()
    except (Exception, SystemExit) as error:
        raise ModelError(f"{where}: cannot be made without arguments: {named(error)}.") from error
    if not isinstance(model, CuttingModel):
        raise ModelError(f"{where}: must offer a CuttingModel, but makes {briefly(model)}.")
    return _sound(model, lambda: where)


def _sound(model: CuttingModel, where: Callable[[], str]) -> CuttingModel:
    """The model, unless it has an error; to name a model takes longer than to compute many impacts."""
    wrong = error_in(model)
    if wrong is not None:
        raise ModelError(f"{where()}: {wrong}.")
    return model
