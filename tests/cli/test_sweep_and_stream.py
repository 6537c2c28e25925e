"""`erosion sweep` and `erosion stream`: options, case files, refusals and Ctrl-C."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import erosion

CASE = (Path(__file__).parents[2] / "cases/table-1.toml").read_text()


@pytest.fixture
def case(tmp_path) -> str:
    path = tmp_path / "case.toml"
    path.write_text(
        CASE
        + '\n[sweep]\nalpha = "10deg : 40deg : 4"\nv0 = [2200, "4400 in/s"]\n'
        + '\n[stream]\nn = 1024\nv0 = "lognormal(4400 in/s, 0.1)"\nalpha = "normal(20deg, 2deg)"\n'
    )
    return str(path)


def test_a_case_file_may_hold_a_sweep(case, tmp_path, shell):
    out = tmp_path / "out.nc"
    printed = shell(["sweep", case, "-o", str(out), "--json"]).result
    assert printed["dimensions"] == {"alpha": 4, "v0": 2}
    assert printed["ended_by"] == {"rebound": 8}
    stored = xr.load_dataset(out, engine="h5netcdf")
    assert float(stored.volume.isel(alpha=1, v0=1)) == pytest.approx(1.816436352531e-4, rel=1e-8)
    assert printed["volume_greatest"] == float(stored.volume.max())
    # The same case serves the other verbs.
    assert erosion.load_case(case).v0 == 4400


def test_options_overrule_the_case_file(case, tmp_path, shell):
    out = tmp_path / "out.nc"
    arguments = [
        "sweep",
        case,
        "--v0",
        "100 m/s",
        "--k",
        "1, 2",
        "--alpha",
        "20deg, 30deg",
        "--paired",
        "alpha,k",
    ]
    assert "to be drawn" in shell([*arguments, "-o", str(out), "--plot", str(tmp_path / "curve.svg")], 2).err
    stored = xr.load_dataset(out, engine="h5netcdf")
    assert dict(stored.sizes) == {"pair": 2}
    assert "v0 = 3937.0078740157483" in stored.attrs["case"]


def test_a_stream_is_told_as_json_and_drawn(case, tmp_path, shell):
    plot = tmp_path / "stream.svg"
    arguments = ["stream", case, "--no-best-angle", "-o", str(tmp_path / "jet.nc"), "--plot", str(plot), "--json"]
    printed = shell(arguments).result
    assert printed["particles"] == 1024
    assert printed["mean_volume"] == pytest.approx(1.83e-4, rel=0.01)
    assert set(printed["sensitivities"]) == {"v0", "alpha"}
    assert plot.read_text().startswith("<?xml")
    assert float(xr.load_dataset(tmp_path / "jet.nc", engine="h5netcdf").mean_volume) == printed["mean_volume"]


def test_impacts_that_fail_among_others_are_a_warning(tmp_path, shell):
    model = tmp_path / "steep.py"
    model.write_text(
        "import erosion, jax.numpy as jnp\n"
        "class F(erosion.models.ForceLaw):\n"
        "  def __call__(self, state, tip, p):\n"
        "    fx = -p.stiffness * tip.depth * jnp.where(p.alpha > 0.5, jnp.nan, 1.0)\n"
        "    return fx, p.k * fx\n"
        "  def typical_ratio(self, p): return p.k\n"
        "model = erosion.models.Linearized(force=F())\n"
    )
    arguments = ["sweep", "--model", str(model), "--alpha", "0.3, 0.4, 0.7", "-o", str(tmp_path / "out.nc"), "--json"]
    said = shell(arguments)
    assert said.result["ended_by"] == {"rebound": 2, "failed": 1}
    assert said.err == "warning: 1 of 3 impacts could not be computed.\n"


@pytest.mark.parametrize(
    ("absent", "arguments", "message"),
    [
        (
            "zarr",
            ["sweep", "--alpha", "0.3, 0.4", "-o", "x.zarr"],
            "The package zarr is not installed: pip install 'erosion[dask]'.",
        ),
        (
            "distributed",
            ["sweep", "--alpha", "0.3, 0.4", "-o", "x.zarr", "--workers", "2"],
            "The package distributed is not installed: pip install 'erosion[dask]'.",
        ),
        (
            "nicegui",
            ["explore", "--no-browser"],
            "The package nicegui is not installed: pip install 'erosion[explorer]'.",
        ),
        ("nbformat", ["exercise"], "The package nbformat is not installed: pip install 'erosion[classroom]'."),
    ],
)
def test_an_extra_that_is_not_installed_is_named(tmp_path, monkeypatch, shell, absent, arguments, message):
    monkeypatch.chdir(tmp_path)
    for module in [name for name in sys.modules if name.startswith("erosion.explorer")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, absent, None)
    said = shell(arguments, 2).err
    assert message in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_ctrl_c_is_one_line_that_says_how_to_go_on(case, tmp_path, shell, monkeypatch):
    from erosion.sweeps import sweep
    from erosion.sweeps.grid import Grid

    solve = Grid.solve
    calls: list[Any] = []

    def interrupted(grid: Any) -> Any:
        calls.append(grid)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return solve(grid)

    monkeypatch.setattr(Grid, "solve", interrupted)
    monkeypatch.setattr(sweep, "_MEMORY_BLOCK", 4)
    out = tmp_path / "out.nc"
    said = shell(["sweep", case, "-o", str(out)], 130).err
    assert said == f"erosion: interrupted: {out} holds 4 of 8 impacts; the same command goes on from there\n"
    assert int(np.isnan(xr.load_dataset(out, engine="h5netcdf").volume).sum()) == 4
    assert shell(["sweep", case, "-o", str(out), "--json"]).result["ended_by"] == {"rebound": 8}


@pytest.mark.parametrize(("verb", "part"), [("sweep", "sweeps.grid.Grid.solve"), ("stream", "streams.stream._tally")])
def test_what_breaks_inside_is_not_the_users_mistake(case, tmp_path, shell, monkeypatch, verb, part):
    def broken(*arguments: Any) -> Any:
        raise ValueError("all the king's horses")

    monkeypatch.setattr(f"erosion.{part}", broken)
    assert shell([verb, case, "-o", str(tmp_path / "out.nc")], 1).err == "erosion: ValueError: all the king's horses\n"
    assert not (tmp_path / "out.nc").exists()


@pytest.mark.parametrize("drawn", [0, 1])
def test_ctrl_c_shows_what_a_stream_has_drawn(case, tmp_path, shell, monkeypatch, drawn):
    from erosion.streams import stream

    tally, left = stream._tally, drawn

    def interrupted(*arguments: Any) -> Any:
        nonlocal left
        if not left:
            raise KeyboardInterrupt
        left -= 1
        return tally(*arguments)

    monkeypatch.setattr(stream, "_tally", interrupted)
    monkeypatch.setattr(stream, "_BLOCK", 16)
    out = tmp_path / "jet.nc"
    said = shell(["stream", case, "-o", str(out), "--json"], 130)
    if not drawn:
        assert said.err == "erosion: interrupted before any of 1,024 particles was computed\n"
        assert (said.out, out.exists()) == ("", False)
        return
    assert said.err.endswith(
        f"erosion: interrupted after 256 of 1,024 particles; {out} holds them; the same command goes on from there\n"
    )
    partial = said.result
    assert partial["particles"] == 256
    assert float(xr.load_dataset(out, engine="h5netcdf").mean_volume) == partial["mean_volume"]
