"""Files of VTK: their blocks, and points with arrays as tables."""

import contextlib
import logging
import mmap
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from erosion.cfd.rows import ImpactsError
from erosion.extras import library
from erosion.output import briefly
from erosion.tables import Source

ENDINGS = (".vtp", ".vtu", ".vtm")
_VERTICES = (0, 1, 2)  # VTK's numbers of no cell, of one point, and of several
_MOST_PACKED = 1000  # numbers for each byte: so much packs zlib at most


class VtkPoints(Source):
    """The points of all blocks of points of a file, with their arrays as columns.

    Raises:
        ImpactsError: for a file that cannot be read, or holds no points of their own.
    """

    def __init__(self, path: Path) -> None:
        self.title, self._blocks, self.units = str(path), _tables_of(path), {}
        tables = [*self._blocks.values()]
        self.headings, self.rows = tuple(tables[0]), sum(len(next(iter(table.values()))) for table in tables)
        if len(tables) > 1:
            self.notes = (f"{path.name}: the points of its blocks {', '.join(self._blocks)} are joined.",)

    def check(self, headings: Sequence[str]) -> None:
        """See `Source`."""
        for table in self._blocks.values():
            if other := next((name for name in headings if table[name].dtype.kind not in "iuf"), ""):
                raise ImpactsError(f"{self.title}: column {other!r} must hold numbers, but holds {table[other].dtype}.")

    def blocks(self, headings: Sequence[str]) -> Iterator[Mapping[str, np.ndarray]]:
        """See `Source`."""
        for table in self._blocks.values():
            yield {name: np.asarray(table[name], float) for name in headings}


def vtk_files(path: Path) -> dict[str, Path]:
    """The files of a `.vtm` by the names of its blocks; any other file by its own.

    Raises:
        ImpactsError: for a `.vtm` that cannot be read, and where one of its files is missing.
    """
    if path.suffix.lower() != ".vtm":
        return {path.stem: path}
    try:
        named = list(_named_files(ET.parse(path).getroot(), ""))
    except (ET.ParseError, OSError) as error:
        raise ImpactsError(f"{path}: cannot be read; it is damaged, or no .vtm file.") from error
    files = {name: path.parent / file for name, file in named}
    if missing := next((file for _, file in named if not (path.parent / file).is_file()), ""):
        raise ImpactsError(f"{path}: names the file {missing!r}, which is not there.")
    if len(files) < len(named):
        raise ImpactsError(f"{path}: has two blocks of the same name.")
    return files


def _named_files(element: ET.Element, above: str) -> Iterator[tuple[str, str]]:
    for child in element:
        # The element of all blocks has no index.
        name = "/".join(filter(None, (above, child.get("name", child.get("index", "")))))
        if "file" in child.attrib:
            yield name, child.attrib["file"]
        yield from _named_files(child, name)


def vtk_blocks(path: Path) -> dict[str, Any]:
    """The data sets of the files of `vtk_files` that have points, and its errors.

    Raises:
        ImpactsError: for a file that cannot be read.
    """
    pyvista, blocks = library("pyvista", "cfd"), dict[str, Any]()
    for name, file in vtk_files(path).items():
        _require_counts(file)
        try:
            with _quiet(), pyvista.vtk_verbosity("off"):
                block = pyvista.read(file)
        except Exception as error:
            raise ImpactsError(f"{file}: cannot be read; it is damaged, or no {file.suffix} file.") from error
        if getattr(block, "n_points", 0):
            _require_no_ghosts(file, block, "cell")
            blocks[name] = block
    return blocks


def _require_no_ghosts(path: Path, block: Any, kind: str) -> None:
    """Refuse cells or points that another part of a parallel run has, too: they would count twice."""
    ghosts = np.count_nonzero(getattr(block, f"{kind}_data").get("vtkGhostType", 0))
    if ghosts:
        raise ImpactsError(
            f"{path}: {ghosts:,} of its {kind}s are ghosts, which would count twice. Python removes them: "
            f"mesh = pyvista.read({path.name!r}); mesh.extract_{kind}s(mesh.{kind}_data['vtkGhostType'] == 0)"
            f".save({path.with_suffix('.vtu').name!r})."
        )


def _require_counts(path: Path) -> None:
    """Refuse an XML file whose counts are more than it could hold: VTK makes room for as many, and ends the process."""
    size = path.stat().st_size
    if not size:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for what, count in re.findall(rb"(NumberOf\w+)\s*=\s*[\"']([^\"']*)", content):
            if not count.strip().isdigit() or int(count) > _MOST_PACKED * size:
                number = count[:20].decode("ascii", "replace")
                raise ImpactsError(
                    f"{path}: cannot be read; it is damaged: {what.decode()} is {briefly(number)} "
                    f"in a file of {size:,} bytes."
                )


def _tables_of(path: Path) -> dict[str, dict[str, np.ndarray]]:
    """The points of each block of points, with their arrays as columns: "U:0", "U:1", "U:2" of a vector.

    Raises:
        ImpactsError: for points that are corners of cells, and blocks with other arrays than the first one.
    """
    tables = dict[str, dict[str, np.ndarray]]()
    for name, block in vtk_blocks(path).items():
        cells = block.cast_to_unstructured_grid()
        if not np.isin(cells.celltypes, _VERTICES).all():
            continue
        _require_no_ghosts(path, block, "point")
        arrays = [("Points", block.points), *block.point_data.items()]
        if block.cell_data.keys():
            if not np.array_equal(cells.cell_connectivity, np.arange(cells.n_points)) or cells.n_cells < cells.n_points:
                raise ImpactsError(f"{path}: has arrays of cells that are not one to each point, as {name!r} shows.")
            arrays = [*block.cell_data.items(), *arrays]
        columns = dict[str, np.ndarray]()
        for head, values in arrays:
            parts = np.asarray(values).reshape(cells.n_points, -1).T
            for i, part in enumerate(parts):
                column = f"{head}:{i}" if len(parts) > 1 else head
                if column in columns and not np.array_equal(columns[column], part):
                    raise ImpactsError(f"{path}: has the array {column!r} twice; rename or take away one of them.")
                columns[column] = part
        tables[name] = columns
    if not tables:
        raise ImpactsError(f"{path}: holds no points of their own, as impacts are, but corners of cells.")
    (first, table), *others = tables.items()
    if other := next((name for name, its in others if its.keys() != table.keys()), ""):
        raise ImpactsError(
            f"{path}: its blocks {first!r} and {other!r} both hold points, but with other arrays; save one alone."
        )
    return tables


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Make pyvista raise what it would log and warn of, before it goes on with an empty mesh."""
    before = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            yield
    finally:
        logging.disable(before)
