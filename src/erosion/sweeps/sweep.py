"""Sweeps: an xarray Dataset of impacts over axes of parameters and models, and the stores of its blocks.

A grid is computed block by block. In memory the blocks follow one another, each on all cores.
For a Zarr store the workers of a Dask cluster may compute them.

With a store an interrupted sweep goes on where it stopped. A block is missing while its `ended_by`
is "not-computed", the code 0. Of each block `ended_by` is written last, and a file gets its name
when it is whole: a block counts only when it is complete, and while each of its chunks is as it
was written.
"""

import contextlib
import dataclasses
import json
import math
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.arguments import Progress, check_path, no_progress
from erosion.correlations.ranges import OutOfRangeWarning
from erosion.extras import library
from erosion.impacts import (
    IDENTITY,
    StoreError,
    check_max_turn,
    code_version,
    read_netcdf,
    require_code,
    require_same,
    turned_beyond,
    write_netcdf,
)
from erosion.interrupts import held_off
from erosion.ode.step_control import require_float64
from erosion.output import briefly, claimed, require_writable, trace, written_whole
from erosion.parameters import QUARTER_DEGREES, Parameters, require_scalars, validate
from erosion.sweeps.boundaries import with_boundaries, with_turned
from erosion.sweeps.grid import AnyGrid, Model, Region, SweepOutputs, block_shape, make_grid, regions

# zarr's own name for a chunk that it is writing: the chunk's place and a random UUID.
_DRAFT_OF_CHUNK = re.compile(r"(c|\d+)\.[0-9a-f]{12}4[0-9a-f]{3}[89ab][0-9a-f]{15}\.partial")


class MemoryStore:
    """Arrays in memory; with a path, also a netCDF file that `save` writes.

    Raises:
        StoreError: for a file that exists and holds something else.
        OSError: where no file can be written.
    """

    def __init__(self, grid: AnyGrid, block: Sequence[int], path: Path | None = None) -> None:
        self._grid, self._block, self._path = grid, block, path
        self._since = None if path is None else trace(path)
        if path is not None and self._since is not None:
            self._dataset = read_netcdf(path, grid.identity)
            return
        self._dataset = grid.labelled(
            {
                name: np.full([grid.lengths[dim] for dim in variable.dims], variable.empty)
                for name, variable in grid.variables().items()
            }
        )

    def missing(self) -> list[Region]:
        """The regions of the blocks that are still to be computed."""
        codes = self._dataset["ended_by"].values
        return [region for region in regions(self._grid.shape, self._block) if not codes[region].all()]

    def require_writable(self) -> None:
        """Find out whether blocks can be stored; an `OSError` that names the path where they cannot."""
        if self._path is not None:
            require_writable(self._path)

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        """Store the arrays of a block, by name."""
        along = dict(zip(self._grid.dims, region, strict=True))
        for name, block in values.items():
            array = self._dataset[name]
            array.values[tuple(along[str(dim)] for dim in array.dims)] = block

    def save(self) -> None:
        """Make the stored blocks outlast this process."""
        if self._path is not None:
            self._since = write_netcdf(self._dataset, self._path, self._grid.identity, self._since)

    def dataset(self) -> xr.Dataset:
        """All blocks, labelled."""
        return self._dataset


class ZarrStore:
    """A Zarr folder (format 3), with one chunk of each array for a block; any process may write.

    Every chunk carries a checksum. A chunk that is lost or damaged is missing, and is computed again. Methods are those
    of `MemoryStore`.

    Raises:
        StoreError: for a folder that exists and holds something else, or lacks an array.
    """

    def __init__(self, grid: AnyGrid, block: Sequence[int], path: Path) -> None:
        for module in ("dask.array", "zarr"):
            library(module, "dask")
        self._grid, self._path, self._variables = grid, path, grid.variables()
        self._lengths = dict(zip(grid.dims, zip(grid.shape, block, strict=True), strict=True))
        identity = grid.identity | {"chunks": f"{dict(zip(grid.dims, block, strict=True))}"}
        if not path.exists():
            self._create(identity)
        import zarr

        # Another process may have made it at the same moment.
        try:
            stored = zarr.open_group(path, mode="r").attrs.get(IDENTITY)
        except _UNREADABLE as error:
            raise StoreError(f"{path}: is there already and is no Zarr group; it is left as it is.") from error
        require_same(path, str(stored), identity)
        self._arrays = _arrays(path, {**self._variables, **grid.labels})
        self._require_frame()
        self._clear_drafts()

    def missing(self) -> list[Region]:
        """See `MemoryStore`."""
        shape, block = zip(*self._lengths.values(), strict=True)
        return [region for region in regions(shape, block) if not self._holds(region)]

    def require_writable(self) -> None:
        """See `MemoryStore`."""
        for name in self._variables:
            require_writable(self._path / name / "probe")

    def write(self, region: Region, values: Mapping[str, np.ndarray]) -> None:
        """See `MemoryStore`."""
        write_block(self._path, dict(zip(self._grid.dims, region, strict=True)), values)

    def save(self) -> None:
        """Every block is on the disk already."""

    def dataset(self) -> xr.Dataset:
        """See `MemoryStore`; lazy."""
        stored = xr.open_zarr(self._path, consolidated=False)
        return stored[list(self._variables)]  # zarr lists them in any order

    def _holds(self, region: Region) -> bool:
        """Whether each array has its chunk of this block, as it was written."""
        along = dict(zip(self._grid.dims, region, strict=True))
        for name, variable in self._variables.items():
            # An array without the dimension "alpha" is computed by the first block along it.
            if any(along[dim].start for dim in self._grid.dims if dim not in variable.dims):
                continue
            values = self._chunk(name, tuple(along[dim] for dim in variable.dims))
            if values is None or (name == "ended_by" and not np.all(values)):
                return False
        return True

    def _chunk(self, name: str, cut: tuple[slice, ...]) -> np.ndarray | None:
        """A chunk of an array; None where it was not written, or is damaged.

        Raises:
            StoreError: where the system does not let it be read.
        """
        array = self._arrays[name]
        place = tuple(along.start // length for along, length in zip(cut, array.chunks, strict=True))
        file = self._path / name / array.metadata.encode_chunk_key(place)
        try:
            return np.asarray(array[cut]) if file.is_file() else None
        except OSError as error:
            reason = f"cannot be read ({error.strerror or error})"
            raise StoreError(f"{file}: {reason}; the store is left as it is.") from error
        except (ValueError, RuntimeError):  # of the checksum, or of what unpacks
            return None

    def _require_frame(self) -> None:
        """Refuse a store whose arrays are not of the grid's shape, or whose axes are not the grid's."""
        labels, damaged = self._grid.labels, list[str]()
        for name, array in self._arrays.items():
            if name in labels:
                stored = self._chunk(name, (slice(0, len(labels[name])),))
                is_whole = stored is not None and np.array_equal(stored, labels[name])
            else:
                variable = self._variables[name]
                shape, chunks = _shapes(variable.dims, self._lengths)
                shapes = array.metadata.dimension_names, array.shape, array.chunks
                is_whole = shapes == (variable.dims, shape, chunks) and array.dtype == np.asarray(variable.empty).dtype
            damaged += [] if is_whole else [name]
        if damaged:
            raise StoreError(f"{self._path}: its array `{damaged[0]}` is damaged; the store is left as it is.")

    def _clear_drafts(self) -> None:
        """Remove the chunks that a killed process left half-written, unless another one is writing."""
        with claimed(self._path, alone=True) as is_alone:
            names = self._variables if is_alone else ()
            for draft in (file for name in names for file in (self._path / name).rglob("*.partial")):
                if _DRAFT_OF_CHUNK.fullmatch(draft.name):
                    with contextlib.suppress(OSError):
                        draft.unlink()

    def _create(self, identity: Mapping[str, str]) -> None:
        import dask.array
        from zarr.codecs import Crc32cCodec, ZstdCodec

        lazy = {}
        for name, variable in self._variables.items():
            shape, chunks = _shapes(variable.dims, self._lengths)
            lazy[name] = dask.array.full(shape, variable.empty, chunks=chunks)
        template = self._grid.labelled(lazy).assign_attrs({IDENTITY: json.dumps(identity)})
        # A checksum at the end of every chunk.
        encoding = {str(name): {"compressors": (ZstdCodec(), Crc32cCodec())} for name in template.variables}
        for name, variable in self._variables.items():
            encoding[name]["fill_value"] = variable.empty
        try:
            with written_whole(self._path) as draft:
                # Coordinates and metadata alone: no block is computed.
                template.to_zarr(
                    draft,
                    mode="w-",
                    compute=False,
                    encoding=encoding,
                    consolidated=False,
                    zarr_format=3,
                    write_empty_chunks=True,  # of coordinates: zeros are there too
                )
        except OSError:
            if not self._path.exists():
                raise


Store = MemoryStore | ZarrStore


def write_block(path: Path, along: Mapping[str, slice], values: Mapping[str, np.ndarray]) -> None:
    """Write a block into a Zarr store, in the order of `values`; the same block may come twice.

    Args:
        path: of the store.
        along: the slice of the block along each dimension.
        values: its arrays by name, `ended_by` last.

    Raises:
        OSError: naming a file or the store, where the block cannot be written.
    """
    import zarr

    # A chunk of NaN is a result too: it must be there.
    with claimed(path), zarr.config.set({"array.write_empty_chunks": True}):
        arrays = _arrays(path, values)
        for name, block in values.items():
            array = arrays[name]
            try:
                array[tuple(along[dim] for dim in array.metadata.dimension_names)] = block
            except OSError as error:
                error.filename = error.filename or str(path)  # of a full disk zarr names no file
                raise


def _arrays(path: Path, names: Iterable[str]) -> dict[str, Any]:
    """The arrays of a Zarr store by name.

    Raises:
        StoreError: where one is not there, or its description cannot be read.
    """
    import zarr

    group, arrays = zarr.open_group(path, mode="r+"), {}
    for name in names:
        try:
            arrays[name] = group[name]
            arrays[name].metadata.dimension_names  # noqa: B018 (a group has none)
        except _UNREADABLE as error:
            raise StoreError(f"{path}: its array `{name}` cannot be read; the store is left as it is.") from error
    return arrays


def _shapes(dims: Sequence[str], lengths: Mapping[str, tuple[int, int]]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The shape of an array over some dimensions, and of its chunks."""
    shape, chunks = (tuple(lengths[dim][i] for dim in dims) for i in (0, 1))
    return shape, chunks


# What zarr raises for a description that is damaged depends on where.
_UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError)


_LEAST_BLOCK = 10_000  # impacts
_STORED_BLOCK = 2**17  # impacts: a fraction of a second's work, a megabyte a variable
_MEMORY_BLOCK = 2**20  # impacts: enough for all cores at once


class SweepInterrupted(KeyboardInterrupt):
    """Ctrl-C during a sweep that has a store; the message says how much the store holds and how to go on."""


def sweep(
    model: Model | Sequence[Model],
    p: Parameters,
    *,
    derivatives: int = 0,
    wrt: str = "alpha",
    rtol: float = 1e-9,
    optimum: bool = False,
    max_turn: float | str | None = "90deg",
    turn: bool = False,
    paired: Sequence[str] = (),
    chunks: Mapping[str, int] | None = None,
    store: str | Path | None = None,
    progress: Progress = no_progress,
    **axes: Any,
) -> xr.Dataset:
    """Compute impacts over a grid: the product of the axes, or some of them going together.

        erosion.sweep("rotating", p, alpha=np.deg2rad(range(1, 91)), v0=["50 m/s", "100 m/s"])
        erosion.sweep(["finnie", "rotating"], p, alpha=…, k=…, paired=("alpha", "k"))

    Args:
        model: a model, its name or path; several in a list make the first dimension, "model".
        p: the case, all scalars; an axis replaces its value, or that of the model's own parameter.
        derivatives: 0, 1 or 2 derivatives of the volume by `wrt`.
        wrt: one parameter, of the case or the model's own.
        rtol: relative tolerance, see `impact`.
        optimum: also keep alpha_max, volume_max, alpha_max_kind and alpha_max_ended_by, over
            the other axes than alpha; see `erosion.alpha_max`.
        max_turn: the greatest turn of the body at the best angles, see `erosion.alpha_max`.
        turn: also how far the body turns in each cut, by a second integration.
        paired: names of two or more axes of one length that go together, along "pair".
        chunks: with a Zarr store, lengths of its blocks by dimension (those left out are not
            cut); without it, blocks of about 10⁵ impacts.
        store: `….nc`: computed in memory and written at the end, or when interrupted.
            `….zarr`: written block by block, by the workers of the active Dask cluster, if there
            is one; the result is lazy. The same call goes on with an interrupted sweep and
            returns a finished one; the bits do not depend on where and how often it was
            interrupted.
        progress: called with "sweep", the number of impacts that are done, and the number of all.
        **axes: parameter name, of the case or every model's own, to one-dimensional values: numbers in SI, or texts
            with units, as `p.replace` reads them.

    Returns:
        volume, t_c and ended_by (codes; the attributes flag_values and flag_meanings explain
        them), derivatives, turns and best angles if asked for, over the axes, in SI with units, and the whole case; and
        volume_at_contact, if a model removes something beside the cut.

    Raises:
        ValueError, TypeError: for arguments that make no sense, and for a store (`StoreError`)
            that holds something else and stays as it is.
        SweepInterrupted: after Ctrl-C, if there is a store.

    Warns:
        OutOfRangeWarning: where a correlation is used outside of its range, with the share of the impacts.
    """
    require_float64()
    outputs = SweepOutputs(derivatives, wrt, rtol, optimum, check_max_turn(max_turn), turn)
    grid = make_grid(model, p, axes, outputs, paired=paired)
    for finding in grid.outside_of_range:
        warnings.warn(finding.text, OutOfRangeWarning, stacklevel=2)
    return prepare_sweep(grid, chunks=chunks, store=store).run(progress)


def prepare_sweep(
    grid: AnyGrid, *, chunks: Mapping[str, int] | None = None, store: str | Path | None = None
) -> "SweepJob":
    """Open the store of a grid, or make one; arguments and errors as of `sweep`."""
    path = None if store is None else check_path("store", store)
    is_zarr = path is not None and path.suffix == ".zarr"
    if chunks is not None and not is_zarr:
        raise ValueError("Argument `chunks` must come with a `store` that ends in .zarr, but there is none.")
    usual = _STORED_BLOCK if is_zarr else _MEMORY_BLOCK
    block = block_shape(grid.lengths, chunks, _LEAST_BLOCK, usual)
    if path is not None and path.suffix not in (".nc", ".zarr"):
        raise ValueError(f"Argument `store` must end in .nc or .zarr, but is {path}.")
    if path is not None and not path.exists():
        require_writable(path)  # before the first impact is computed; zarr would make folders
    store_of_blocks = ZarrStore(grid, block, path) if path is not None and is_zarr else MemoryStore(grid, block, path)
    missing = store_of_blocks.missing()
    if missing:
        store_of_blocks.require_writable()
    return SweepJob(grid, store_of_blocks, missing, path)


@dataclasses.dataclass(frozen=True)
class SweepJob:
    """A checked grid, the store of its blocks, those that it lacks, and its path if it is not the memory."""

    grid: AnyGrid
    store: Store
    missing: list[Region]
    path: Path | None

    def run(self, progress: Progress = no_progress) -> xr.Dataset:
        """Compute the blocks that the store lacks; errors as of `sweep`."""
        total = math.prod(self.grid.shape)
        begun = count = total - sum(_size(region) for region in self.missing)

        def advance(impacts: int) -> None:
            nonlocal count
            count += impacts
            progress("sweep", count, total)
            stop()

        try:
            with held_off("erosion: stops after this block; a second signal ends at once") as stop:
                try:
                    advance(0)
                    self._compute(self.missing, advance)
                finally:
                    # Also after an error: to compute took longer than to write.
                    if count > begun:
                        self.store.save()
                stop()
        except KeyboardInterrupt:
            if self.path is None:
                raise
            hint = f": {self.path} holds {count:,} of {total:,} impacts; the same command goes on from there"
            nothing = f" before any of {total:,} impacts was stored"
            raise SweepInterrupted(f"interrupted{hint if self.path.exists() else nothing}") from None
        return self.store.dataset()

    def _compute(self, missing: list[Region], advance: Callable[[int], None]) -> None:
        # Without the import there is no active cluster.
        if isinstance(self.store, ZarrStore) and "distributed" in sys.modules:
            from erosion.impacts.cluster import active_client, run_blocks

            client = active_client()
            if client is not None:
                assert self.path is not None
                self.grid.require_portable()
                shared = self.path.resolve()
                code = code_version()
                blocks = ((self.grid[region], shared, region, code) for region in missing)
                run_blocks(client, compute_block, blocks, advance)
                return
        for region in missing:
            self.store.write(region, self.grid[region].solve())
            advance(_size(region))


def compute_block(grid: AnyGrid, path: Path, region: Region, code: str) -> int:
    """Compute a block and write it into a Zarr store; returns the number of its impacts.

    Raises:
        RuntimeError: where this process computes with other code, or another model, than the sweep was begun with.
    """
    require_code(code, "sweep")
    write_block(path, dict(zip(grid.dims, region, strict=True)), grid.solve())
    return _size(region)


def _size(region: Region) -> int:
    return math.prod(cut.stop - cut.start for cut in region)


_SPINS = 91  # s from -0.9 to 0.9


def compare(models: Sequence[Model], p: Parameters, *, alpha: Any = None) -> xr.Dataset:
    """Several models over the same angles, each with its angle of greatest removal.

    Args:
        models: models, their names or paths.
        p: one case; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every quarter of a degree without it.

    Returns:
        Over (model, alpha): volume, dvolume, d2volume, t_c and ended_by (codes, see their attributes), and
        turned_beyond, whether the body turns by more than 90°; volume_at_contact, if a model removes something beside
        the cut; over model: alpha_max, volume_max, alpha_max_kind, alpha_max_ended_by.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    if isinstance(models, str) or not isinstance(models, Sequence):
        raise TypeError(f"Argument `models` must be a list of models, but is {briefly(models)}.")
    found = sweep(models, p, alpha=QUARTER_DEGREES if alpha is None else alpha, derivatives=2, optimum=True)
    at = p.replace(alpha=found.alpha.values)
    return with_turned(found, ("model", "alpha"), np.stack([turned_beyond(model, at) for model in models]))


def regimes(model: Model, p: Parameters, *, max_turn: float | str | None = "90deg", **axes: Any) -> xr.Dataset:
    """Compute ends of cuts, volumes and best angles over two parameters.

        erosion.regimes("rotating", p)  # over angle and spin
        erosion.regimes("rotating", p, k=np.geomspace(0.5, 5, 40), phidot0=spins)  # the best angles over k and spin

    Args:
        model: a model, its name or path.
        p: one case; the axes replace two of its values.
        max_turn: the greatest turn of the body at the best angles, see `erosion.alpha_max`.
        **axes: two parameters, of the case or the model's own, with their values, the first along x; None is no
            axis. Without them, or with `alpha` or `phidot0` alone: every half degree, and spins s = r φ̇0/v0 from -0.9
            to 0.9.

    Returns:
        Over both (y, x): volume, dvolume, d2volume, t_c, ended_by, turn and turned_beyond; over the parameters other
        than `alpha`: alpha_max, volume_max, alpha_max_kind, alpha_max_ended_by; and the lines where these change, see
        `with_boundaries`.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    require_float64()
    validate(p)
    require_scalars(p)
    usual = {"alpha": QUARTER_DEGREES[1::2], "phidot0": np.linspace(-0.9, 0.9, _SPINS) * float(p.v0 / p.r)}
    axes = {name: values for name, values in axes.items() if values is not None}
    axes = usual | axes if axes.keys() <= usual.keys() else axes
    if isinstance(model, Sequence) and not isinstance(model, str):
        raise TypeError(f"Argument `model` must be one model, but is {briefly(model)}.")
    if len(axes) != 2:
        raise ValueError(f"Arguments must name two parameters, but name {', '.join(axes)}.")
    outputs = SweepOutputs(derivatives=2, optimum=True, max_turn=check_max_turn(max_turn), turn=True)
    grid = make_grid(model, p, dict(reversed(axes.items())), outputs)
    return with_boundaries(grid, prepare_sweep(grid).run())
