"""Sweeps: the labels, the same bits however a grid is cut and kept, and what happens when it is interrupted."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.impacts.dataset_files import StoreError
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import MemoryStore, SweepInterrupted, sweep

P = erosion.TABLE_1
# 24 000 impacts: two blocks of the least size.
AXES: dict[str, Any] = {"alpha": np.deg2rad(np.linspace(1, 90, 120)), "v0": np.linspace(2200.0, 4400.0, 200)}
CHUNKS = {"alpha": 60}


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    return sweep("linearized", P, **AXES)


def assert_same_bits(one: xr.Dataset, other: xr.Dataset) -> None:
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        assert one[name].values.tobytes() == other[name].values.tobytes(), name


def stop_after(blocks: int):
    """A progress callback as Ctrl-C after some blocks."""
    calls = iter(range(blocks + 1))

    def progress(work: str, done: int, total: int) -> None:
        if next(calls) == blocks:
            raise KeyboardInterrupt

    return progress


def test_a_sweep_is_the_kernel_with_labels(whole, tmp_path):
    p = P.replace(alpha=AXES["alpha"][:, None], v0=AXES["v0"])
    hits = erosion.impact("linearized", p)
    np.testing.assert_array_equal(whole.volume, hits.volume)
    np.testing.assert_array_equal(whole.t_c, hits.t_c)
    meanings = np.array(whole.ended_by.attrs["flag_meanings"].split())
    np.testing.assert_array_equal(meanings[whole.ended_by.values], hits.ended_by)
    assert whole.ended_by.dtype == np.int8
    np.testing.assert_array_equal(whole.ended_by.attrs["flag_values"], range(len(meanings)))
    assert whole.volume.dims == ("alpha", "v0")
    assert whole.volume.attrs == {"long_name": "removed volume", "symbol": "V", "units": "in^3"}
    assert whole.v0.attrs["units"] == "in/s"
    assert whole.attrs["model"] == "linearized"
    (tmp_path / "case.toml").write_text(whole.attrs["case"])
    assert erosion.load_case(tmp_path / "case.toml") == P


def test_models_are_an_axis_and_axes_may_go_in_pairs():
    k, angles = [1.0, 2.0, 3.0], np.deg2rad([10.0, 20, 30])
    dataset = sweep(["linearized", "tan-alpha"], P, alpha=angles, k=k, v0=[2200.0, 4400.0], paired=("alpha", "k"))
    assert dict(dataset.sizes) == {"model": 2, "pair": 3, "v0": 2}
    assert dataset.k.dims == ("pair",)
    one = erosion.impact("linearized", P.replace(alpha=angles[2], k=3.0))
    assert float(dataset.volume.sel(model="linearized", v0=4400.0)[2]) == one.volume
    # No rotation: the volume goes with v₀².
    np.testing.assert_allclose(dataset.volume.isel(v0=1), 4 * dataset.volume.isel(v0=0), rtol=1e-8)


def test_derivatives_carry_their_units():
    dataset = sweep("linearized", P, alpha=[0.2, 0.3], derivatives=2, wrt="v0")
    assert dataset.dvolume.attrs["units"] == "in^3/(in/s)"
    assert dataset.d2volume.attrs["units"] == "in^3/(in/s)^2"
    # V ∝ v₀²; the kernel's tolerance is 1e-9.
    np.testing.assert_allclose(dataset.dvolume, 2 * dataset.volume / P.v0, rtol=1e-7)


def test_the_optimum_lies_beside_the_angles(tmp_path):
    axes: dict[str, Any] = {"alpha": np.deg2rad(np.linspace(1, 90, 6000)), "k": [1.0, 2.0]}
    dataset = sweep("linearized", P, optimum=True, **axes)
    assert dataset.alpha_max.dims == ("k",)
    # The closed form: α_max = ½ arctan k.
    np.testing.assert_allclose(dataset.alpha_max, np.arctan(axes["k"]) / 2, rtol=1e-9)
    np.testing.assert_allclose(dataset.volume_max, dataset.volume.max("alpha"), rtol=1e-6)
    assert dataset.alpha_max_kind.attrs["flag_meanings"].split()[int(dataset.alpha_max_kind[0])] == "interior"
    path = tmp_path / "out.zarr"
    stored = sweep("linearized", P, optimum=True, store=path, chunks={"alpha": 5000}, **axes)
    assert_same_bits(stored.compute(), dataset)


def test_netcdf_holds_the_same_and_is_read_back(whole, tmp_path):
    path, contents = tmp_path / "out.nc", set()
    for _ in range(2):
        assert_same_bits(sweep("linearized", P, store=path, **AXES), whole)
        assert_same_bits(xr.load_dataset(path, engine="h5netcdf"), whole)
        contents.add(path.read_bytes())
    assert len(contents) == 1
    # Identities are words.
    assert set(json.loads(xr.load_dataset(path, engine="h5netcdf").attrs["identity"])) == {
        "version", "case", "models", "axes", "derivatives", "optimum", "tolerance",
    }  # fmt: skip


@pytest.mark.parametrize("chunks", [CHUNKS, {"alpha": 70, "v0": 150}, None])
def test_zarr_holds_the_same_in_any_blocks(whole, tmp_path, chunks):
    dataset = sweep("linearized", P, store=tmp_path / "out.zarr", chunks=chunks, **AXES)
    assert dataset.volume.chunks is not None
    assert_same_bits(dataset.compute(), whole)


def test_a_block_counts_only_when_all_of_it_is_there():
    grid = make_grid("linearized", P, {"alpha": np.linspace(0.1, 1.4, 4)})
    store, missing = MemoryStore(grid, (4,)), []
    for half in ((slice(0, 2),), (slice(2, 4),)):
        store.write(half, grid[half].solve())
        missing.append(store.missing())
    assert missing == [[(slice(0, 4),)], []]


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_an_interrupted_sweep_is_readable_and_goes_on(whole, tmp_path, monkeypatch, suffix):
    path = tmp_path / f"out.{suffix}"
    arguments: dict[str, Any] = {"store": path, **AXES, **({"chunks": CHUNKS} if suffix == "zarr" else {})}
    # In memory too, blocks of half the grid.
    monkeypatch.setattr("erosion.sweeps.sweep._MEMORY_BLOCK", 12_000)
    with pytest.raises(SweepInterrupted, match=r"holds 12,000 of 24,000 impacts; the same command goes on"):
        sweep("linearized", P, progress=stop_after(1), **arguments)
    partial = xr.load_dataset(path) if suffix == "nc" else xr.open_zarr(path, consolidated=False)
    assert int((partial.ended_by == 0).sum()) == 12_000
    assert int(np.isnan(partial.volume).sum()) == 12_000
    seen = []
    dataset = sweep("linearized", P, progress=lambda *told: seen.append(told), **arguments)
    assert seen == [("sweep", 12_000, 24_000), ("sweep", 24_000, 24_000)]
    assert_same_bits(dataset.compute(), whole)


def test_half_a_block_is_computed_again(whole, tmp_path):
    path = tmp_path / "out.zarr"
    sweep("linearized", P, store=path, chunks=CHUNKS, **AXES)
    # As after a kill between the variables of a block: `ended_by` comes last.
    (path / "ended_by" / "c" / "1" / "0").unlink()
    (path / "t_c" / "c" / "1" / "0").unlink()
    assert_same_bits(sweep("linearized", P, store=path, chunks=CHUNKS, **AXES).compute(), whole)


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_a_store_of_something_else_is_refused_and_left(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"out.{suffix}"
    small: dict[str, Any] = {"model": "linearized", "p": P, "alpha": [0.2, 0.3], "store": path}
    sweep(**small)
    before = {file: file.read_bytes() for file in [path, *path.rglob("*")] if file.is_file()}
    for changed, message in [
        ({"alpha": [0.2, 0.4]}, "another axes"),
        ({"derivatives": 1}, "another derivatives"),
        ({"rtol": 1e-8}, "another tolerance"),
        ({"p": P.replace(k=3.0)}, "another case"),
        ({"model": "finnie"}, "another models"),
    ]:
        with pytest.raises(StoreError, match=f"{message}.*left as it is"):
            sweep(**{**small, **changed})
    monkeypatch.setattr("erosion.impacts.dataset_files.__version__", "9.9")
    with pytest.raises(StoreError, match="another version"):
        sweep(**small)
    assert before == {file: file.read_bytes() for file in [path, *path.rglob("*")] if file.is_file()}


def test_foreign_files_are_refused(tmp_path):
    (tmp_path / "out.nc").write_text("notes")
    (tmp_path / "out.zarr").mkdir()
    for name, message in (("out.nc", "no netCDF file"), ("out.zarr", "is there already")):
        with pytest.raises(StoreError, match=message):
            sweep("linearized", P, store=tmp_path / name, alpha=[0.2])


def test_a_plug_in_is_known_by_its_equations(tmp_path):
    plug_in = tmp_path / "lip.py"
    shutil.copy(Path(__file__).parents[2] / "models/saturating_lip.py", plug_in)
    grid = make_grid(str(plug_in), P, {"alpha": [0.2]})
    plug_in.write_text(plug_in.read_text() + "\n# changed\n")
    assert make_grid(str(plug_in), P, {"alpha": [0.2]}).identity == grid.identity
    text = plug_in.read_text()
    plug_in.write_text(text.replace("p.k * ", "1.5 * p.k * ", 1))
    assert plug_in.read_text() != text
    assert make_grid(str(plug_in), P, {"alpha": [0.2]}).identity["models"] != grid.identity["models"]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "must include an axis"),
        ({"speed": [1]}, TypeError, "`speed` is not a parameter"),
        ({"alpha": 0.3}, ValueError, "`alpha` must be a one-dimensional list"),
        ({"alpha": [[0.3]]}, ValueError, "one-dimensional"),
        ({"alpha": []}, ValueError, "one-dimensional"),
        ({"alpha": [0.3, 2.0]}, ValueError, "`alpha` must be in"),
        ({"alpha": [0.3, np.nan]}, ValueError, "`alpha` must be in"),
        ({"alpha": [0.3], "paired": ("alpha",)}, ValueError, "`paired` must name two or more"),
        ({"alpha": [0.3], "k": [1, 2], "paired": ("alpha", "k")}, ValueError, r"of one length, but they have \[1, 2\]"),
        ({"alpha": [0.3], "derivatives": 3}, ValueError, "`derivatives` must be"),
        ({"alpha": [0.3], "wrt": "speed"}, ValueError, "`wrt` must name"),
        ({"alpha": [0.3], "rtol": 0.0}, ValueError, "`rtol` must be"),
        ({"alpha": [0.3], "chunks": {"alpha": 1}}, ValueError, "`chunks` must come with a `store`"),
        ({"alpha": [0.3], "store": "out.csv"}, ValueError, r"must end in .nc or .zarr"),
        ({"alpha": [0.3], "store": "/nowhere/out.nc"}, OSError, "No such file or directory: '/nowhere/out.nc'"),
        ({"model": ["finnie", "finnie"], "alpha": [0.3]}, ValueError, "different names"),
        ({"model": [], "alpha": [0.3]}, ValueError, "an empty list"),
        ({"p": P.replace(alpha=[0.1, 0.2]), "k": [1.0]}, ValueError,
         r"`alpha` must be a scalar here, but has shape \(2,\); give it as an axis"),
    ],
)  # fmt: skip
def test_bad_arguments_are_one_sentence(arguments, error, message):
    with pytest.raises(error, match=message):
        sweep(**{"model": "linearized", "p": P, **arguments})
