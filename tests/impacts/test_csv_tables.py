import csv
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.impacts.dataset_files import StoreError, read_netcdf, write_csv, write_netcdf

P = erosion.TABLE_1.to("si")


def lines(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_line_for_each_point_with_axes_outcomes_and_erosion_per_mass(tmp_path):
    masses = np.array([4e-5, 5e-5])
    grid = erosion.sweep("rotating", P, alpha=np.deg2rad([10.0, 20.0, 30.0]), m=masses)
    write_csv(grid, tmp_path / "grid.csv", P, {"": erosion.PerMass(2700.0, 0.5)})
    table = lines(tmp_path / "grid.csv")
    assert len(table) == 6
    first, *_, last = table
    assert float(first["alpha [deg]"]) == pytest.approx(10.0)
    assert (float(last["alpha [deg]"]), float(last["m [kg]"])) == (pytest.approx(30.0), 5e-5)
    corner = grid.isel(alpha=-1, m=-1)
    assert float(last["volume [m^3]"]) == float(corner.volume)
    assert float(last["specific_volume [mm^3/kg]"]) == pytest.approx(0.5 * float(corner.volume) / 5e-5 * 1e9)
    assert float(last["erosion_ratio [g/kg]"]) == pytest.approx(1350 * float(corner.volume) / 5e-5 * 1e3)
    assert (last["model"], float(last["cutting_fraction"])) == ("rotating", 0.5)
    assert last["ended_by"] in ("rebound", "stop")


def test_paired_axes_and_several_models(tmp_path):
    grid = erosion.sweep(
        ["finnie", "dnv"], P, r=[1e-3, 2e-3], m=[5e-5, 4e-4], paired=("r", "m"), optimum=True, max_turn=None
    )
    weights = {"finnie": erosion.PerMass(2700.0, 0.25), "dnv": erosion.PerMass(7800.0)}
    write_csv(grid, tmp_path / "grid.csv", P, weights)
    table = lines(tmp_path / "grid.csv")
    assert [(line["model"], float(line["r [m]"])) for line in table] == [
        ("finnie", 1e-3), ("finnie", 2e-3), ("dnv", 1e-3), ("dnv", 2e-3),
    ]  # fmt: skip
    ratio = float(erosion.correlations.dnv(float(P.alpha), float(P.v0)))
    assert float(table[3]["erosion_ratio [g/kg]"]) == pytest.approx(1e3 * ratio, rel=1e-9)
    assert table[0]["alpha_max_kind"] == "interior"
    assert [float(line["cutting_fraction"]) for line in table] == [0.25, 0.25, 1.0, 1.0]
    write_csv(grid, tmp_path / "grid.csv", P, {**weights, "finnie": erosion.PerMass()})
    assert "erosion_ratio [g/kg]" not in lines(tmp_path / "grid.csv")[0]


DATASET = xr.Dataset(
    {
        "volume": (("alpha", "k"), np.array([[0.1, np.nan, 1e-300], [np.inf, -0.0, 1 / 3]]), {"units": "in^3"}),
        "ended_by": ("alpha", np.array([1, 2], np.int8)),
    },
    {"alpha": [0.2, 0.3]},
    {"model": "linearized"},
)
IDENTITY = {"case": "k = 2\n", "models": "α: linearized"}


def test_what_is_read_is_what_was_written_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "out.nc"
    write_netcdf(DATASET, path, IDENTITY)
    with pytest.raises(StoreError, match=r"out\.nc: .*another case.* 2 there, and 3 here"):
        read_netcdf(path, {**IDENTITY, "case": "k = 3\n"})
    there = read_netcdf(path, IDENTITY)
    # In memory: the file may change.
    path.write_bytes(b"")
    assert set(there.variables) == set(DATASET.variables)
    assert DATASET.attrs == {"model": "linearized"}
    for name, variable in DATASET.variables.items():
        assert there[name].values.tobytes() == variable.values.tobytes()
        assert (there[name].dtype, there[name].dims) == (variable.dtype, variable.dims)
    assert there.volume.attrs["units"] == "in^3"


@pytest.mark.parametrize(("name", "message"), [("foreign.nc", "holds something else"), ("text.nc", "no netCDF file")])
def test_what_is_no_result_is_refused(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / "text.nc").write_text("volume 1.0")
    with h5py.File(tmp_path / "foreign.nc", "w") as file:
        file["volume"] = [1.0]
    with pytest.raises(StoreError, match=message):
        read_netcdf(tmp_path / name, IDENTITY)
