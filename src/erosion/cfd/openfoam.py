"""Meshes of OpenFOAM: their patches as surfaces, and the faces of the parts into which a case is decomposed."""

import contextlib
import dataclasses
import functools
import gzip
import itertools
import re
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from erosion.cfd.rows import ImpactsError
from erosion.cfd.surface import Surface
from erosion.extras import library

_MESH = Path("constant") / "polyMesh"
_ADDRESSING = "faceProcAddressing"
# "processor3"; with collated files "processors8", or "processors8_4-7" of some of them.
_PROCESSOR = re.compile(r"processor(?:(\d+)|s\d+(?:_(\d+)-\d+)?)")
_HEAD = 2000  # bytes in which a file names its format
_BLOCK = re.compile(rb"// Processor\d+\s+(\d+)\s*\(")


class Patch(NamedTuple):
    """Consecutive faces of the mesh: from `start` to before `end`."""

    kind: str
    start: int
    end: int

    def has(self, mesh_faces: np.ndarray) -> np.ndarray:
        """Whether each face of the mesh is of this patch."""
        return (mesh_faces >= self.start) & (mesh_faces < self.end)


@dataclasses.dataclass(frozen=True)
class Mesh:
    """The mesh of a case; its files are read when they are needed."""

    case: Path

    @functools.cached_property
    def patches(self) -> dict[str, Patch]:
        """Its patches by name.

        Raises:
            ImpactsError: where the mesh's file cannot be read, or its patches are not one after the other.
        """
        path, patches = self._path("boundary"), dict[str, Patch]()
        with _holding(path, "list of patches"):
            for name, entry in _content(path):
                if name in patches:
                    raise ImpactsError(f"{path}: has two patches {name!r}.")
                for key in ("startFace", "nFaces"):
                    value = entry[key]
                    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 0 <= value < 2**63:
                        must = "must be a whole number of at least 0"
                        raise ImpactsError(f"{path}: `{key}` of patch {name!r} {must}, but is {value}.")
                start = int(entry["startFace"])
                patches[name] = Patch(str(entry["type"]), start, start + int(entry["nFaces"]))
        following = sorted((its.start, its.end, name) for name, its in patches.items() if its.start < its.end)
        for (_, end, before), (start, _, name) in itertools.pairwise(following):
            if start != end:
                raise ImpactsError(
                    f"{path}: patch {name!r} must start at face {end}, where {before!r} ends, but starts at {start}."
                )
        return patches

    @functools.cached_property
    def faces(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each face's corners end, and the corners of all faces.

        Raises:
            ImpactsError: where the mesh's file cannot be read, or its faces are not those of the patches.
        """
        path = self._path("faces")
        if _present(path) and re.search(rb"\bclass\s+faceList\b", head := _head(path)) and _is_binary(head):
            raise ImpactsError(
                f"{path}: is a binary list of faces that is not compact. With `writeFormat ascii` in "
                "system/controlDict, `foamFormatConvert` rewrites it."
            )
        content = _content(path)
        with _holding(path, "list of faces"):
            if isinstance(content, tuple):
                starts, corners = (_labels(path, labels) for labels in content)
            else:
                starts = np.cumsum([0, *map(len, content)])
                corners = _labels(path, np.concatenate([np.zeros(0, np.int64), *content]))
        if not len(starts) or starts[0] != 0 or starts[-1] != len(corners) or (np.diff(starts) < 0).any():
            raise ImpactsError(f"{path}: is no list of faces: their corners do not follow one another.")
        faces = len(starts) - 1
        if self.patches and (end := max(patch.end for patch in self.patches.values())) != faces:
            raise ImpactsError(f"{path}: has {faces} faces, but the last patch of `boundary` ends at {end}.")
        return starts[1:], corners

    @functools.cached_property
    def processors(self) -> dict[int, np.ndarray]:
        """The number of each face of a processor's part in the whole mesh, by processor; empty for a serial case.

        Each processor has a folder, or files of several are collated.

        Raises:
            ImpactsError: where a file cannot be read, or holds what is no number of a face.
        """
        addressing = {}
        for folder in self.case.glob("processor*"):
            path, named = folder / _MESH / _ADDRESSING, _PROCESSOR.fullmatch(folder.name)
            if named and _present(path):
                parts = [_labels(path, _content(path))] if named[1] else _collated(path)
                for number, labels in enumerate(parts, int(named[1] or named[2] or 0)):
                    # The numbers start at 1; a negative one says that the face is turned round.
                    addressing[number] = np.abs(labels) - 1
                    if (addressing[number] < 0).any():
                        raise ImpactsError(f"{path}: numbers faces from 1, but has a 0.")
        return addressing

    @functools.cached_property
    def owners(self) -> dict[int | None, np.ndarray]:
        """The cell of each boundary face: of the whole mesh (None) and of processors' parts, where these are there.

        Raises:
            ImpactsError: where a file cannot be read.
        """
        numbers = [int(named[1]) for folder in self.case.glob("processor*")
                   if (named := _PROCESSOR.fullmatch(folder.name)) and named[1]]  # fmt: skip
        folders = {None: self.case, **{number: self.case / f"processor{number}" for number in numbers}}
        paths = {number: folder / _MESH / "owner" for number, folder in folders.items()}
        return {number: _labels(path, _content(path)) for number, path in paths.items() if _present(path)}

    @property
    def walls(self) -> list[str]:
        """The names of the patches of type wall, mappedWall and the like; errors as of `patches`."""
        return [name for name, its in self.patches.items() if its.kind.lower().endswith("wall")]

    def surface(self, patch: str | Sequence[str] | None) -> Surface:
        """One or more patches, by default all walls.

        Raises:
            ImpactsError: naming the patches of the mesh, for one that is not among them.
        """
        names = self.walls if patch is None else [patch] if isinstance(patch, str) else list(dict.fromkeys(patch))
        for name in names:
            if name not in self.patches:
                raise ImpactsError(f"{self.case}: has no patch {name!r}, but has {', '.join(self.patches)}.")
        if not names:
            raise ImpactsError(f"{self.case}: has no patch of type wall, but has {', '.join(self.patches)}.")
        with _holding(self._path("points"), "list of points"):
            points = np.asarray(_content(self._path("points")), float)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ImpactsError(f"{self._path('points')}: is no list of points.")
        ends, corners = self.faces
        patches = [self.patches[name] for name in names]
        numbers = np.concatenate([np.arange(its.start, its.end) for its in patches])
        sizes = np.diff(ends, prepend=0)[numbers]
        own_ends = np.cumsum(sizes)
        own_corners = corners[np.repeat(ends[numbers] - own_ends, sizes) + np.arange(sizes.sum())]
        used, own_corners = np.unique(own_corners, return_inverse=True)
        if len(used) and not 0 <= used[0] <= used[-1] < len(points):
            wrong = used[0] if used[0] < 0 else used[-1]
            raise ImpactsError(
                f"{self._path('faces')}: has a face with the corner {wrong}, but points are 0 to {len(points) - 1}."
            )
        return Surface(
            title=f"{self.case}: {', '.join(names)}",
            points=points[used],
            corners=own_corners.reshape(-1),
            ends=own_ends,
            patches=tuple(names),
            patch=np.repeat(np.arange(len(names)), [its.end - its.start for its in patches]),
            mesh_face=numbers,
        )

    def _path(self, name: str) -> Path:
        return self.case / _MESH / name


def case_of(path: Path) -> Path | None:
    """The case in which a file or folder lies; a case lies in itself."""
    folders = (path, *path.parents, *path.resolve().parents)
    return next((folder for folder in folders if _present(folder / _MESH / "boundary")), None)


def open_case(case: Path) -> Mesh:
    """The mesh of a case.

    Raises:
        ImpactsError: where the folder holds no mesh.
    """
    if not _present(case / _MESH / "boundary"):
        parts = any(case.glob(f"processor*/{_MESH}"))
        joined = " Its mesh lies in the parts of the processors: `reconstructParMesh` joins them." * parts
        raise ImpactsError(f"{case}: is no OpenFOAM case, because it has no {_MESH / 'boundary'}.{joined}")
    return Mesh(case)


def dictionary(path: Path) -> Any:
    """A dictionary of OpenFOAM as foamlib gives it; None where the file is not there or cannot be read."""
    if not _present(path):
        return None
    try:
        _require_closed(_stored(path))
        return library("foamlib", "cfd").FoamFile(_stored(path)).as_dict()
    except (OSError, EOFError, ValueError):
        return None


@contextlib.contextmanager
def _holding(path: Path, what: str) -> Iterator[None]:
    """Make errors within, as of what a file does not hold, say that it is no such thing."""
    try:
        yield
    except ImpactsError:
        raise
    except (TypeError, ValueError, KeyError) as error:
        raise ImpactsError(f"{path}: is no {what}.") from error


def _labels(path: Path, numbers: Any, head: bytes | None = None) -> np.ndarray:
    """Whole numbers, shape (labels,), from below the `head` of a file or of its block."""
    with _holding(path, "list of whole numbers"):  # lists of several lengths
        labels = np.asarray(numbers)
    if labels.dtype == np.float64 and labels.size:
        if not _is_binary(_head(path) if head is None else head):
            raise ImpactsError(f"{path}: must hold whole numbers, but holds decimals.")
        labels = labels.view(np.int64)  # foamlib takes labels of 64 bits in a binary file for floating point numbers
    if labels.ndim != 1 or (labels.size and labels.dtype.kind not in "iu"):
        raise ImpactsError(f"{path}: is no list of whole numbers.")
    return labels.astype(np.int64)


def _present(path: Path) -> bool:
    return path.is_file() or _stored(path).is_file()


def _stored(path: Path) -> Path:
    compressed = path.with_name(f"{path.name}.gz")
    return compressed if compressed.is_file() and not path.is_file() else path


def _bytes(stored: Path, size: int = -1) -> bytes:
    with gzip.open(stored) if stored.suffix == ".gz" else stored.open("rb") as file:
        return file.read(size)


def _head(path: Path) -> bytes:
    return _bytes(_stored(path), _HEAD)


def _is_binary(content: bytes) -> bool:
    return re.search(rb"\bformat\s+binary\b", content[:_HEAD]) is not None


_NO_BRACKETS = re.compile(rb'"[^"]*"|/\*.*?\*/|//[^\n]*', re.DOTALL)


def _require_closed(stored: Path) -> None:
    """Refuse a text whose brackets are not closed, as one that was cut off: foamlib would look for ever for their ends.

    Raises:
        ValueError: with their numbers.
    """
    content = _bytes(stored)
    if _is_binary(content):
        return
    content = _NO_BRACKETS.sub(b"", content)
    for opened, closed in ("()", "{}"):
        counts = content.count(opened.encode()), content.count(closed.encode())
        if counts[0] != counts[1]:
            raise ValueError(f"it has {counts[0]:,} {opened} and {counts[1]:,} {closed}, as a file that was cut off")


def _collated(path: Path) -> list[np.ndarray]:
    """The whole numbers that a file of several processors holds for each of them.

    Raises:
        ImpactsError: where it ends early, or a block cannot be read.
    """
    content = _bytes(_stored(path))
    blocks, begin = list[bytes](), 0
    while named := _BLOCK.search(content, begin):
        begin = named.end() + int(named[1])
        blocks.append(content[named.end() : begin])
    # The first block alone says whether numbers are text.
    head = re.match(rb".*?FoamFile\s*\{.*?\}", blocks[0], re.DOTALL) if blocks else None
    if head is None or content[begin : begin + 1] != b")":
        raise ImpactsError(f"{path}: is no whole file of several processors.")
    try:
        loads = library("foamlib", "cfd").FoamFile.loads
        contents = [loads(block if i == 0 else head[0] + block) for i, block in enumerate(blocks)]
    except ValueError as error:
        raise ImpactsError(f"{path}: has a block that cannot be read as OpenFOAM's.") from error
    return [_labels(path, content, head[0]) for content in contents]


def _content(path: Path) -> Any:
    """What a file of OpenFOAM holds beside its header."""
    foamlib, stored = library("foamlib", "cfd"), _stored(path)
    try:
        _require_closed(stored)
        # foamlib warns of an entry that is there twice.
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            content = foamlib.FoamFile(stored)[None]
    except FileNotFoundError as error:
        raise ImpactsError(f"{path}: is not there.") from error
    except (OSError, EOFError, ValueError, KeyError, UserWarning) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ImpactsError(f"{stored}: cannot be read as a file of OpenFOAM ({reason[:120]}).") from error
    if isinstance(content, tuple) and len(content) == 2 and isinstance(content[0], int):
        # The number before a list is part of the list only where it is right.
        items = len(content[1]) if hasattr(content[1], "__len__") else "others"
        raise ImpactsError(f"{stored}: says that its list has {content[0]} items, but it has {items}.")
    return content
