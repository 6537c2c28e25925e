"""The identity of a stored result, version, case and models, and the refusal of files with another identity."""

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx

from erosion.models.base import CuttingModel
from erosion.parameters.case_files import dump_case
from erosion.parameters.parameters import Parameters
from erosion.version import __version__

IDENTITY = "identity"
"""The attribute that holds a stored result's identity, as JSON."""


class StoreError(ValueError):
    """A file or folder that holds something other than the wanted result."""


def identity(models: Mapping[str, CuttingModel], p: Parameters, **more: str) -> dict[str, str]:
    """What a result depends on, in words; two results of the same identity have the same bits."""
    return {
        "version": f"erosion {__version__}, jaxlib {importlib.metadata.version('jaxlib')}",
        "case": dump_case(p),
        "models": "\n".join(f"{label}: {_fingerprint(model)}" for label, model in models.items()),
        **more,
    }


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
        raise StoreError(
            f"{path}: is there already and holds another result (of another {' and '.join(differing)}); "
            "it is left as it is."
        )


def digest(content: bytes) -> str:
    """Sixteen hexadecimal digits of the SHA-256 of the content."""
    return hashlib.sha256(content).hexdigest()[:16]


def _fingerprint(model: CuttingModel) -> str:
    """A model's parts and numbers in words, and a digest of its source files outside of this package."""
    described = eqx.tree_pformat(model, short_arrays=False)
    files = sorted(_foreign_files(model))
    return f"{described} {digest(b''.join(Path(file).read_bytes() for file in files))}" if files else described


def _foreign_files(part: Any) -> set[str]:
    """The files of the classes of a model and its parts that do not belong to this package."""
    files: set[str] = set()
    if not isinstance(part, eqx.Module):
        return files
    for base in type(part).__mro__:
        if not issubclass(base, eqx.Module) or base.__module__.startswith(("erosion.", "equinox.")):
            continue
        try:
            files.add(inspect.getfile(base))
        except (OSError, TypeError) as error:
            raise ValueError(
                f"Argument `model` must come from a file where a store is given, but {base.__name__} does not."
            ) from error
    return files.union(*(_foreign_files(getattr(part, field.name)) for field in dataclasses.fields(part)))
