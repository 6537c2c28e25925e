"""The identity of a stored result, version, case and models, and the refusal of files with another identity."""

import contextlib
import functools
import importlib.metadata
import json
import tomllib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from erosion.models import model_name
from erosion.models.base import CuttingModel
from erosion.models.equations import model_digest
from erosion.models.own_parameters import own_in_words
from erosion.ode.step_control import require_float64
from erosion.output.files import digest
from erosion.parameters.case_files import dump_case
from erosion.parameters.parameters import Parameters
from erosion.version import __version__

_PACKAGE = Path(__file__).parents[1]
_WITHOUT_NUMBERS = ("cli", "explorer", "plotting", "report")  # they show what the other folders compute

_SHOWN = 3  # numbers that a message names

IDENTITY = "identity"
"""The attribute that holds a stored result's identity, as JSON."""


class StoreError(ValueError):
    """A file or folder that holds something other than the wanted result."""


def identity(models: Mapping[str, CuttingModel], p: Parameters, **more: str) -> dict[str, str]:
    """What a result depends on, in words; two results of the same identity have the same bits.

    Raises:
        ValueError: for a model that computes by what only this process knows.
    """
    return {
        "version": code_version(),
        "case": dump_case(p),
        "models": "\n".join(f"{label}: {model_digest(model, p)}" for label, model in models.items()),
        **more,
    }


def provenance(content: str, p: Parameters, **more: Any) -> dict[str, Any]:
    """The attributes of a Dataset of results: conventions, what it holds, versions, and the case."""
    return {
        "Conventions": "CF-1.11",
        "title": f"Solid particle erosion: {content}",
        "source": f"erosion {__version__}",
        **more,
        "unit_system": p.units,
        "case": dump_case(p),
    }


def model_in_words(model: CuttingModel, but: Collection[str] = ()) -> dict[str, str]:
    """A model's name, and its own parameters `but` those that vary, as attributes for `provenance`."""
    own = own_in_words(model, but=but)
    return {"model": model_name(model), **({"own_parameters": own} if own else {})}


@functools.cache
def package_digest() -> str:
    """The digest of this package's own code, as far as numbers depend on it."""
    files = {str(file.relative_to(_PACKAGE)): file for file in sorted(_PACKAGE.rglob("*.py"))}
    return digest(
        b"\0".join(
            name.encode() + b"\0" + file.read_bytes()
            for name, file in files.items()
            if not name.startswith(_WITHOUT_NUMBERS)
        )
    )


def code_version() -> str:
    """The versions that the numbers depend on, and the digest of this package's code, which may be edited."""
    return f"erosion {__version__} ({package_digest()}), jaxlib {importlib.metadata.version('jaxlib')}"


def require_code(code: str, begun: str) -> None:
    """Refuse to go on in a process that computes with other code than the work, such as "sweep", was begun with.

    Raises:
        RuntimeError, PrecisionError: where it does, or not in float64.
    """
    require_float64()
    if code_version() != code:
        raise RuntimeError(f"A worker has {code_version()}, but the {begun} was begun with {code}.")


def require_same(path: Path, stored: Any, wanted: Mapping[str, str]) -> None:
    """Refuse a store whose identity is not the wanted one.

    Args:
        path: of the store.
        stored: its identity as JSON, or anything else.
        wanted: the identity of the result.

    Raises:
        StoreError: one sentence that names the parts that differ.
    """
    stored_identity = None
    with contextlib.suppress(json.JSONDecodeError, TypeError):
        stored_identity = json.loads(stored)
    if not isinstance(stored_identity, dict):
        raise StoreError(f"{path}: is there already and holds something else; it is left as it is.")
    differing = [name for name in wanted if stored_identity.get(name) != wanted[name]]
    if differing:
        known = "".join(_differences(str(stored_identity.get(name)), wanted[name]) for name in differing)
        raise StoreError(
            f"{path}: is there already and holds another result (of another {' and '.join(differing)}){known}; "
            "it is left as it is."
        )


def _differences(stored: str, wanted: str) -> str:
    """Which numbers of a part of an identity differ, as clauses."""
    there, here = _numbers_in(stored), _numbers_in(wanted)
    names = [name for name in {**there, **here} if there.get(name) != here.get(name)]
    shown = [f"; {name} is {there.get(name, 'not')} there, and {here.get(name, 'not')} here" for name in names]
    return "".join(shown[:_SHOWN]) + (f"; {len(shown) - _SHOWN} more differ" if len(shown) > _SHOWN else "")


def _numbers_in(part: str) -> dict[str, str]:
    """The numbers in a part of an identity, by name; none where it is a digest."""
    for read in (json.loads, tomllib.loads):
        with contextlib.suppress(ValueError):
            content = read(part)
            return {name: str(value) for name, value in content.items()} if isinstance(content, dict) else {}
    return {}


def numbers_in_words(numbers: Mapping[str, Any]) -> str:
    """Named numbers and arrays as a part of an identity, to their last bit."""
    return json.dumps({name: _in_words(value) for name, value in numbers.items()})


def _in_words(value: Any) -> str:
    if not isinstance(value, (int, float, np.ndarray, np.generic)):
        return repr(value)
    array = np.asarray(value)
    if array.ndim == 0:
        return repr(array.item())
    ends = f" from {array.flat[0]!s} to {array.flat[-1]!s}" if array.size else ""
    return f"{' × '.join(map(str, array.shape))} numbers{ends} ({digest(array.tobytes())})"
