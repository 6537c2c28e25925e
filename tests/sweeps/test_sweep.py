"""Sweeps: the labels, the same bits however a grid is cut and kept, and what happens when it is interrupted.

Blocks of a grid: they cover it once, are of a useful size, and lie as memory does.

Sweeps over a model's own parameters.
"""

import inspect
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.contour import ContourSet
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import erosion
from erosion.impacts import BEYOND_LABEL
from erosion.impacts.dataset_files import StoreError
from erosion.models import Linearized
from erosion.plotting.curves import pieces, plot_against_correlations, plot_optimum
from erosion.plotting.labels import INK, broken
from erosion.plotting.style import fit_legends
from erosion.plotting.sweeps import plot_regimes, plot_sweep
from erosion.sweeps.boundaries import boundary
from erosion.sweeps.grid import block_shape, make_grid, regions
from erosion.sweeps.sweep import MemoryStore, SweepInterrupted, sweep
from tests.cli.test_set_option import FILE
from tests.models.test_own_parameters import FRICTION, MODEL, P as PULLED
from tests.reference import closed_form

P = erosion.TABLE_1.to("si")
# 24 000 impacts: two blocks of the least size.
AXES: dict[str, Any] = {"alpha": np.deg2rad(np.linspace(1, 90, 120)), "v0": np.linspace(55.88, 111.76, 200)}
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
    assert whole.volume.attrs == {"long_name": "removed volume", "symbol": "V", "units": "m^3"}
    assert whole.v0.attrs["units"] == "m/s"
    assert whole.attrs["model"] == "linearized"
    (tmp_path / "case.toml").write_text(whole.attrs["case"])
    assert erosion.load_case(tmp_path / "case.toml") == P


def test_models_are_an_axis_and_axes_may_go_in_pairs():
    k, angles = [1.0, 2.0, 3.0], np.deg2rad([10.0, 20, 30])
    dataset = sweep(
        ["linearized", "tan-alpha"], P, alpha=angles, k=k, v0=[float(P.v0) / 2, float(P.v0)], paired=("alpha", "k")
    )
    assert dict(dataset.sizes) == {"model": 2, "pair": 3, "v0": 2}
    assert dataset.k.dims == ("pair",)
    one = erosion.impact("linearized", P.replace(alpha=angles[2], k=3.0))
    assert float(dataset.volume.sel(model="linearized")[2, 1]) == one.volume
    # No rotation: the volume goes with v₀².
    np.testing.assert_allclose(dataset.volume.isel(v0=1), 4 * dataset.volume.isel(v0=0), rtol=1e-8)


def test_derivatives_carry_their_units():
    dataset = sweep("linearized", P, alpha=[0.2, 0.3], derivatives=2, wrt="v0")
    assert dataset.dvolume.attrs["units"] == "m^3/(m/s)"
    assert dataset.d2volume.attrs["units"] == "m^3/(m/s)^2"
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
        "version", "case", "models", "axes", "derivatives", "turn", "optimum", "tolerance",
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
        ({"model": [MODEL, "finnie"], "p": PULLED, "friction": [0.1]}, ValueError,
         "`friction` must be a parameter of every model, but finnie has none"),
        ({"p": P.replace(alpha=[0.1, 0.2]), "k": [1.0]}, ValueError,
         r"`alpha` must be a scalar here, but has shape \(2,\); give it as an axis"),
    ],
)  # fmt: skip
def test_bad_arguments_are_one_sentence(arguments, error, message):
    with pytest.raises(error, match=message):
        sweep(**{"model": "linearized", "p": P, **arguments})


NAMES = ("alpha", "k", "v0")


def lengths_of(shape: Sequence[int]) -> dict[str, int]:
    return dict(zip(NAMES, shape, strict=False))


@pytest.mark.parametrize("usual", [1, 7, 1000, 10**6])
@pytest.mark.parametrize("shape", [(1,), (100,), (3, 50), (10, 20, 30)])
def test_blocks_cover_the_grid_once(usual: int, shape: tuple[int, ...]) -> None:
    block = block_shape(lengths_of(shape), None, 1, usual)
    assert min(usual, math.prod(shape)) / 4 <= math.prod(block) <= max(usual, 1)
    covered = np.zeros(shape, int)
    for region in regions(shape, block):
        assert covered[region].size > 0
        covered[region] += 1
    assert (covered == 1).all()


@pytest.mark.parametrize(
    ("lengths", "chunks", "least", "usual", "block"),
    [
        # The last dimensions stay whole: a block is one piece of memory, or as few as may be.
        (lengths_of((10, 20, 30)), None, 1, 6000, (10, 20, 30)),
        (lengths_of((10, 20, 30)), None, 1, 2999, (4, 20, 30)),
        (lengths_of((10, 20, 30)), None, 1, 100, (1, 3, 30)),
        # Pieces of about one length: 3 of 34 rather than 2 of 40 and one of 20.
        (lengths_of((100,)), None, 1, 40, (34,)),
        # No block holds two models.
        ({"model": 3, "alpha": 10}, None, 1, 1000, (1, 10)),
        ({"model": 3, "alpha": 10}, {"model": 2, "alpha": 5}, 1, 1000, (1, 5)),
        # Chunks are what the user wants; the whole grid may be smaller than the least block.
        (lengths_of((300, 100)), {"alpha": 100}, 10_000, 0, (100, 100)),
        (lengths_of((300, 100)), {"alpha": 1000, "k": 50}, 10_000, 0, (300, 50)),
        (lengths_of((3,)), {"alpha": 3}, 10_000, 0, (3,)),
    ],
)
def test_the_shape_of_a_block(lengths, chunks, least, usual, block) -> None:
    assert block_shape(lengths, chunks, least, usual) == block


def test_regions_come_in_the_order_of_memory() -> None:
    numbers = np.arange(7 * 5).reshape(7, 5)
    assert [numbers[region].flat[0] for region in regions((7, 5), (3, 2))] == [0, 2, 4, 15, 17, 19, 30, 32, 34]


@pytest.mark.parametrize(
    ("chunks", "error", "message"),
    [
        ({"alpha": 99}, ValueError, "at least 10,000 impacts, but makes blocks of 9,900"),
        ({"beta": 1}, ValueError, r"name dimensions \(alpha, k\), but has 'beta'"),
        ({"alpha": 0}, ValueError, "positive whole numbers, but has alpha=0"),
        ({"alpha": True}, ValueError, "positive whole numbers, but has alpha=True"),
        ({"alpha": 2.5}, ValueError, r"positive whole numbers, but has alpha=2\.5"),
        (100, TypeError, "must give lengths by dimension, but is 100"),
    ],
)
def test_chunks_must_be_of_use(chunks, error: type[Exception], message: str) -> None:
    # Outside of the tests nothing checks types before.
    with pytest.raises(error, match=message):
        inspect.unwrap(block_shape)(lengths_of((300, 100)), chunks, 10_000, 0)


@pytest.fixture(scope="module")
def comparison():
    return erosion.compare(["linearized", "rotating"], P)


@pytest.fixture(scope="module")
def map_of_rotating():
    return erosion.regimes(
        "rotating", P, alpha=np.deg2rad(np.arange(2.0, 90.0, 4.0)), phidot0=[-55000.0, 0.0, 27500.0], max_turn=None
    )


def test_a_comparison_holds_curves_and_optima(comparison):
    assert dict(comparison.sizes) == {"model": 2, "alpha": 360}
    exact = closed_form("linearized")
    p = P.replace(alpha=comparison.alpha.values)
    np.testing.assert_allclose(comparison.volume.sel(model="linearized"), exact.volume(p), rtol=1e-8, atol=1e-20)
    np.testing.assert_allclose(comparison.dvolume.sel(model="linearized"), exact.dvolume(p), rtol=1e-8, atol=1e-18)
    np.testing.assert_allclose(np.rad2deg(comparison.alpha_max), [31.717474411, 25.571827308], atol=1e-8)
    ends = comparison.alpha_max_ended_by
    assert [ends.attrs["flag_meanings"].split()[code] for code in ends.values] == ["rebound", "rebound"]
    assert comparison.volume.attrs["units"] == "m^3"


def test_regimes_change_with_spin(map_of_rotating):
    dataset = map_of_rotating
    assert dict(dataset.volume.sizes) == {"phidot0": 3, "alpha": 22}
    names = dataset.ended_by.attrs["flag_meanings"].split()
    ends = np.array(names)[dataset.ended_by.values]
    # With s = -0.5 nothing is cut where cos α ≤ 0.5.
    assert set(ends[0][np.rad2deg(dataset.alpha) > 60]) == {"no-cut"}
    np.testing.assert_allclose(np.rad2deg(dataset.alpha_max), [47.13850880, 25.57182731, 20.39], atol=5e-3)


def test_a_boundary_lies_on_the_change() -> None:
    """Pieces join where three kinds meet, too."""
    x, y = np.linspace(-1, 1, 12), np.linspace(-1, 1, 9)

    def sectors(x, y):
        return np.where(np.hypot(x, y) > 0.7, 0, np.where(x > 0.1, 1, 2))

    pieces = boundary(x, y, sectors(x, y[:, None]), sectors)
    on_a_line = np.isclose(np.hypot(*pieces.T), 0.7, atol=1e-3) | np.isclose(pieces[..., 0].T, 0.1, atol=1e-3)
    assert on_a_line.mean() > 0.9  # all but the middles of cells
    _, counts = np.unique(pieces.reshape(-1, 2).round(9), axis=0, return_counts=True)
    assert counts.min() == 2  # no line is open
    assert boundary(x, y, np.zeros((9, 12)), sectors).shape == (0, 2, 2)


def test_regimes_have_the_lines_where_the_end_changes(map_of_rotating):
    """Of the cusp of `linearized` the place is known: tan α = k/2."""
    found = erosion.regimes("linearized", P, alpha=np.deg2rad([10, 30, 50, 70]), k=np.geomspace(0.5, 4, 5))
    alpha, k = found.end_boundary.values.reshape(-1, 2).T
    np.testing.assert_allclose(np.tan(alpha), k / 2, rtol=1e-3)
    assert len(map_of_rotating.turn_boundary) > 0


def test_regimes_over_other_parameters_are_of_best_angles():
    """½ arctan k for any speed, on logarithmic axes."""
    found = erosion.regimes("linearized", P, k=np.geomspace(0.5, 4, 7), v0=np.geomspace(25, 230, 8))
    assert found.alpha_max.dims == ("v0", "k")
    np.testing.assert_allclose(found.alpha_max, np.broadcast_to(np.arctan(found.k) / 2, (8, 7)), rtol=1e-9)
    figure = plot_regimes(found)
    assert [(ax.get_xscale(), ax.get_yscale()) for ax in figure.axes[:2]] == [("log", "log")] * 2
    with pytest.raises(ValueError, match="must name two parameters, but name k"):
        erosion.regimes("linearized", P, k=[1, 2])
    with pytest.raises(TypeError, match="`model` must be one model"):
        inspect.unwrap(erosion.regimes)(["linearized", "rotating"], P)
    with pytest.raises(ValueError, match="two or more values of each parameter, but has one of `k`"):
        plot_regimes(erosion.regimes("linearized", P, k=[2], v0=[55.88, 111.76]))


def test_an_axis_of_none_is_none():
    usual = erosion.regimes("linearized", P, alpha=[0.2, 0.3], phidot0=None)
    xr.testing.assert_identical(usual, erosion.regimes("linearized", P, alpha=[0.2, 0.3]))


def test_cuts_that_turn_the_body_too_far_are_hatched(map_of_rotating):
    figure = plot_regimes(map_of_rotating)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    hatched = [text.get_text() for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)
               if isinstance(handle, Patch) and handle.get_hatch()]  # fmt: skip
    assert hatched == [BEYOND_LABEL]
    assert "boundary between no cut, rebound and stop" in [text.get_text() for text in legend.get_texts()]
    assert legend.get_window_extent().width <= figure.bbox.width
    figure.set_figwidth(4.0)
    fit_legends(figure)  # another legend, with marks of the left panel: those of the right are white
    (legend,) = figure.legends
    handles = {text.get_text(): handle for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)}
    best = handles["greatest for this value"]
    assert isinstance(best, Line2D)
    assert best.get_color() == INK
    for ax in figure.axes[:2]:
        (region,) = [drawn for drawn in ax.collections if isinstance(drawn, ContourSet)]
        assert region.hatches == ["////"]
        (path,) = region.get_paths()
        turned = map_of_rotating.turned_beyond.values
        points = np.stack(np.meshgrid(np.rad2deg(map_of_rotating.alpha), map_of_rotating.phidot0), axis=-1)
        assert path.contains_points(points[turned], radius=1e-9).mean() > 0.9


def test_curves_are_broken_where_they_jump(comparison):
    one = comparison.sel(model="rotating")
    x, _ = broken(one.alpha.values, one.volume.values, one.dvolume.values)
    gaps = np.flatnonzero(np.isnan(x))
    assert len(gaps) == 1
    assert x[gaps[0] - 1] < np.deg2rad(42.92255530) < x[gaps[0] + 1]


def test_pieces_end_at_jumps():
    best = erosion.alpha_max("rotating", P.replace(k=1.0), max_turn=None)
    curve = pieces(best)
    assert [piece.ended_by for piece in curve] == ["rebound", "stop", "stop"]
    for before, after, jump in zip(curve[:-1], curve[1:], best.jumps, strict=True):
        assert before.alpha[-1] < jump.alpha < after.alpha[0]
        assert before.value[-1] == pytest.approx(jump.below, rel=1e-5)
        assert after.value[0] == pytest.approx(jump.above, rel=1e-4)


def test_a_batch_of_optima_is_not_one_figure():
    best = erosion.alpha_max("rotating", P.replace(k=np.array([1.0, 2.0])))
    with pytest.raises(ValueError, match="Argument `optimum` must be of one set of parameters"):
        plot_optimum(best)


def test_shapes_lie_over_each_other(comparison):
    ax = plot_against_correlations(comparison, ["dnv", "oka"]).axes[0]
    labels = ax.get_legend_handles_labels()[1]
    assert labels[:2] == ["DNV RP-O501 (2015): 34.7°", "Oka (SiO₂, Hv = 1.8 GPa): 33.9°"]
    models = comparison.sizes["model"]
    assert ["not valid" in label for label in labels[2:]] == [False] * models + [True]
    for line in (line for line in ax.get_lines() if line.get_linestyle() == "-"):
        # The grid of angles misses the greatest by little.
        assert 0.999 < np.nanmax(line.get_ydata()) <= 1 + 1e-12


ANGLES = np.deg2rad([10.0, 20.0, 30.0])
# One program for the whole file, that of derivatives along any parameter.
ASKED: dict[str, Any] = {"derivatives": 1, "wrt": "friction"}


@pytest.fixture(scope="module")
def whole_own_axis() -> xr.Dataset:
    return sweep(MODEL, PULLED, alpha=ANGLES, friction=[0.0, 0.1, 0.3], **ASKED)


def alone(friction: float, alpha: Any) -> erosion.Impact:
    return erosion.impact(MODEL.replace(friction=friction), PULLED.replace(alpha=alpha), **ASKED)


def test_an_own_parameter_is_an_axis(whole_own_axis):
    assert whole_own_axis.volume.dims == ("alpha", "friction")
    for friction in (0.0, 0.1, 0.3):
        dataset, hits = whole_own_axis.sel(friction=friction), alone(friction, ANGLES)
        for name in ("volume", "t_c", "dvolume"):
            np.testing.assert_array_equal(dataset[name], getattr(hits, name))
    assert whole_own_axis.friction.attrs == {"long_name": "coefficient of friction", "symbol": "μ", "units": "1"}
    assert whole_own_axis.dvolume.attrs["units"] == "m^3"
    # Of what is an axis, the model's own value means nothing.
    assert "own_parameters" not in whole_own_axis.attrs


def test_it_goes_together_with_a_parameter_of_the_case_and_has_a_best_angle():
    dataset = sweep(MODEL, PULLED, friction=[0.1, 0.3, 0.3], alpha=ANGLES, paired=("friction", "alpha"), **ASKED)
    assert dataset.volume.dims == dataset.friction.dims == dataset.alpha.dims == ("pair",)
    expected = [alone(friction, alpha).volume for friction, alpha in zip((0.1, 0.3, 0.3), ANGLES, strict=True)]
    np.testing.assert_array_equal(dataset.volume, expected)
    best = sweep(MODEL, PULLED, friction=[0.0, 0.5], optimum=True, alpha=ANGLES, **ASKED).alpha_max
    assert best.dims == ("friction",)
    # linearized at k/(1 + μk): ½ arctan.
    assert best.values == pytest.approx(np.arctan([2.0, 1.0]) / 2, abs=1e-9)


def test_it_must_not_be_called_as_a_result():
    class Odd(FRICTION):
        volume: float = 1.0

    with pytest.raises(ValueError, match="An axis must not be called `volume`, as something else in a sweep is"):
        make_grid(Linearized(force=Odd()), PULLED, {"volume": [1.0]})


def test_a_figure_names_it(whole_own_axis):
    map_ = plot_sweep(sweep(MODEL, PULLED, friction=np.linspace(0, 0.5, 7), alpha=np.linspace(0.1, 1.5, 8), **ASKED))
    assert map_.axes[0].get_xlabel() == "μ  coefficient of friction"
    family = plot_sweep(whole_own_axis)
    assert [text.get_text() for text in family.legends[0].get_texts()] == ["μ = 0", "μ = 0.1", "μ = 0.3"]


def test_the_command_line_takes_axes_of_own_parameters(tmp_path, written, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
    written("harder.py", FILE)
    written("case.toml", erosion.dump_case(PULLED) + '\n[sweep]\nmodel = "harder.py"\nset.factor = [1, 2]\n')
    words = ["sweep", "case.toml", "-o", "out.nc", "--alpha", "20deg,30deg", "--plot", "out.svg"]
    assert shell([*words, "--set", "speed=5 m/s", "--json"]).result["dimensions"] == {"alpha": 2, "factor": 2}
    dataset, golden = xr.load_dataset("out.nc"), 1.816436352531e-4 * 0.0254**3
    assert dataset.volume[0].values == pytest.approx(golden / np.array([1, 2]), rel=1e-8)  # V ∝ 1/σ
    assert dataset.attrs["own_parameters"] == "speed = 5"
    assert "holds another result (of another models)" in shell([*words, "--set", "speed=6 m/s"], 2).err
