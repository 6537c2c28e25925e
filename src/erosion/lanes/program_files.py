"""Compiled programs on disk: a later process reads them and neither traces nor compiles them again.

A program's name is the digest of all that its bits follow from: what it computes, the code of this package as this
process has it, the versions of the libraries, and the processor. So a file is never out of date; it is only not asked
for. A process whose package was edited since it started has code that no file shows, and keeps nothing. A file that
is damaged, and a folder that cannot be read or written, cost the time to compile and nothing else.
"""

import contextlib
import functools
import hashlib
import importlib.metadata
import os
import pickle
import platform
import re
import sys
import tempfile
import time
import types
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jaxlib
import llvmlite
import numpy as np
import platformdirs
from jaxtyping import PyTree

from erosion.lanes.digests import hashed
from erosion.lanes.machine import ObjectCode, this_machine

CACHE = "EROSION_CACHE"
"""The environment variable: a folder for compiled programs, or nothing (`EROSION_CACHE=`) to keep none."""

_PACKAGE = Path(__file__).parents[1]
_OURS = re.compile(r"[0-9a-f]{40}\.program")
_STARTED = time.time() - 3.0  # the package's first modules were read shortly before this one
_MOST = 1000  # files; one of `rotating` with two derivatives has 150 kB
_CHECK = hashlib.sha256().digest_size


class KeptProgram(NamedTuple):
    """A compiled function of one lane.

    Args:
        inputs: the shape of each argument, for one lane; none is large.
        results: shapes and types of what it returns.
        rows, numbers: of the memory for one vector of lanes, and for what lanes share.
        is_repeatable: whether it may begin again.
        made: the code.
        text: of LLVM's intermediate representation, where more care would make faster code; else empty.
    """

    inputs: list[tuple[int, ...]]
    results: PyTree
    rows: int
    numbers: int
    is_repeatable: bool
    made: ObjectCode
    text: str


class ProgramFile:
    """The file of one program.

    Args:
        what: all that the program follows from, beside this package, the libraries and the processor; the same text
            in every process.
    """

    def __init__(self, what: str) -> None:
        surroundings = _surroundings()
        self._name = "" if surroundings is None else f"{hashed(surroundings, _loaded(), what).hex()[:40]}.program"

    def read(self) -> KeptProgram | None:
        """The program; None where there is no such file that can be read."""
        folder = _folder()
        if folder is None or not self._name:
            return None
        path = folder / self._name
        try:
            if hasattr(os, "getuid") and path.stat().st_uid != os.getuid():
                return None
            content = path.read_bytes()
        except OSError:
            return None
        if hashlib.sha256(content[_CHECK:]).digest() != content[:_CHECK]:
            return None
        with contextlib.suppress(OSError):
            os.utime(path)
        return pickle.loads(zlib.decompress(content[_CHECK:]))

    def write(self, program: KeptProgram) -> None:
        """Keep the program, in place of an earlier one; the oldest files make room."""
        folder = _folder()
        if folder is None or not self._name:
            return
        content = zlib.compress(pickle.dumps(program), 1)
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            handle, partial = tempfile.mkstemp(prefix=self._name, suffix=".part", dir=folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(hashlib.sha256(content).digest() + content)
                Path(partial).replace(folder / self._name)
            finally:
                Path(partial).unlink(missing_ok=True)
            _make_room(folder)


def _make_room(folder: Path) -> None:
    files = list(_files(folder))
    if len(files) > _MOST:
        for _, path in sorted(files)[: len(files) - _MOST // 2]:
            path.unlink(missing_ok=True)


def _files(folder: Path) -> Iterator[tuple[float, Path]]:
    """When each program was last used, and its path; other files are none of ours."""
    for path in folder.iterdir():
        if _OURS.match(path.name):
            with contextlib.suppress(OSError):
                yield path.stat().st_mtime, path


def _folder() -> Path | None:
    given = os.environ.get(CACHE)
    if given is None:
        return platformdirs.user_cache_path("erosion", appauthor=False) / "programs"
    return Path(given).expanduser() if given else None


@functools.cache
def _surroundings() -> bytes | None:
    """The digest of this package's code, of the libraries and of the processor; None where the code is not known."""
    files = sorted(_PACKAGE.rglob("*.py"))
    changes = [max(status.st_mtime, status.st_ctime) for status in map(Path.stat, files)]
    if not files or max(changes) > _STARTED:
        return None
    code = (part for file in files for part in (str(file), file.read_bytes()))
    libraries = (library.__version__ for library in (jax, jaxlib, np, llvmlite))
    equinox = importlib.metadata.version("equinox")  # which users' modules are of
    return hashed(*code, *libraries, equinox, sys.version, platform.platform(), *this_machine())


def _loaded() -> bytes:
    """The digest of what modules that make programs hold: a process may replace a constant or a function."""
    modules = sorted(name for name in sys.modules if name.startswith(("erosion.lanes.", "erosion.ode.")))
    return hashed(*(part for name in modules for part in _parts(name, vars(sys.modules[name]))))


def _parts(name: str, space: Mapping[str, Any]) -> Iterator[str]:
    """What decides between one content of a module or class and another."""
    for key, value in sorted(space.items()):
        if isinstance(value, types.FunctionType):
            yield f"{name}.{key} {value.__code__.co_filename} {value.__code__.co_firstlineno}"
        elif isinstance(value, type) and value.__module__ == name:
            yield from _parts(f"{name}.{key}", vars(value))
        elif isinstance(value, (bool, int, float, str)) and not key.startswith("_STARTED"):
            yield f"{name}.{key} {value!r}"
        elif isinstance(value, np.ndarray):
            yield f"{name}.{key} {value.tobytes().hex()}"
