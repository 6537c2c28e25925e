"""`erosion predict` as a user types it."""

import csv
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion.fits.posterior_files import read_predictor
from tests.cli.test_document import check

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Draws from weighings at two speeds, of a curve that no model has."""
    angle, speed = (part.ravel() for part in np.meshgrid([15.0, 30.0, 45.0, 60.0, 75.0], [60.0, 98.0]))
    true = 300 * np.sin(np.deg2rad(2 * angle)) ** 0.6 * (speed / 98) ** 2.4
    weighed = true * (1 + 0.05 * np.random.default_rng(4).standard_normal(true.size))
    data = {"angle [deg]": angle, "speed [m/s]": speed, "mass_loss [ug/g]": weighed}
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061")
    drawn = erosion.posterior("linearized", p, data, ["k", "psi"], density=2700.0, error="2 mg/kg + 5 %", draws=125)
    return drawn.save(tmp_path_factory.mktemp("fit") / "draws.nc")


def test_the_numbers_are_those_of_the_predictor(fitted, shell, tmp_path):
    table = tmp_path / "table.csv"
    words = ["predict", str(fitted), "--alpha", "35deg, 50deg", "--v0", "60 m/s, 120 m/s", "--level", "0.9"]
    printed = shell([*words, "-o", str(table), "--json"])
    asked, at = np.deg2rad([[35.0, 50.0]] * 2), {"v0": np.array([[60.0], [120.0]])}
    predictor = read_predictor(fitted)
    of_mean, of_weighing = (predictor.predict(asked, at, 2000, noise=noise) for noise in (False, True))
    result = printed.result
    lines = result["predictions"]
    assert [line["v0"] for line in lines] == [60, 60, 120, 120]
    np.testing.assert_allclose([line["alpha"] for line in lines], asked.ravel())
    np.testing.assert_allclose([line["mean"] for line in lines], of_mean.mean(axis=0).ravel())
    # Weighings are drawn here, not there: of 2000 draws an end is known to some percents of the interval.
    for what, draws, part in (("mean", of_mean, 1e-9), ("weighing", of_weighing, 0.05)):
        ends = np.array([[line[f"{what}_{end}"] for line in lines] for end in ("low", "high")])
        drawn = np.quantile(draws, [0.05, 0.95], axis=0).reshape(2, -1)
        assert (np.abs(ends - drawn) <= part * (drawn[1] - drawn[0])).all()
    check(printed.document)
    assert result["weights"] == pytest.approx(predictor.weights)
    assert result["parts"] == list(predictor.parts)
    assert printed.document["result"]["predictions"][0]["mean"]["unit"] == "kg/kg"
    assert any(said == "120 m/s is 1.22 × the fastest test." for said in printed.document["warnings"])
    heading, *rows = csv.reader(table.read_text().splitlines())
    assert heading[:4] == ["alpha [deg]", "v0 [m/s]", "mean [ug/g]", "mean_low [ug/g]"]
    np.testing.assert_allclose([float(row[2]) for row in rows], 1e6 * of_mean.mean(axis=0).ravel())


def test_the_tables_say_what_is_in_each_interval(fitted, shell, tmp_path):
    printed = shell(["predict", str(fitted), "--plot", str(tmp_path / "bands.png")])
    assert "α [°]   v₀ [m/s]   mean [ug/g]   95 % of the mean   95 % of a new weighing" in printed.out
    # All angles at the speeds of the tests.
    lines = printed.out.splitlines()
    assert [
        sum(line.split()[:2] == [angle, speed] for line in lines) for angle, speed in (("90", "60"), ("10", "98"))
    ] == [1, 1]
    words = " ".join(printed.out.split())
    assert (
        "holds parameters, discrepancy, speed exponent; that of a new weighing also its error, 2 mg/kg + 5 %." in words
    )
    for outside in ("10° is 0.667 × the flattest test.", "90° is 1.2 × the steepest test."):
        assert f"warning: {outside}" in printed.err
    assert (tmp_path / "bands.png").stat().st_size > 1000


def test_another_size_is_another_mass(fitted, shell):
    printed = shell(["predict", str(fitted), "--alpha", "35deg", "--v0", "98 m/s", "--particle", "garnet 0.6 mm"])
    assert "is 8 × the heaviest test." in printed.err
    # By the model, and by what it lacks, wear per mass of erodent has no size.
    usual = shell(["predict", str(fitted), "--alpha", "35deg", "--v0", "98 m/s"])
    (heavy,), (light,) = ([line.split() for line in said.out.splitlines() if line.split()[:2] == ["35", "98"]]
                          for said in (printed, usual))  # fmt: skip
    assert heavy[:2] + heavy[3:] == light  # the mass stands between


def test_the_wear_is_in_the_unit_that_is_asked_for(fitted, shell, tmp_path):
    words = ["predict", str(fitted), "--alpha", "35deg", "--v0", "98 m/s", "-o", str(tmp_path / "table.csv")]
    rows = {}
    for unit in ("mg/kg", "ug/g", "g/kg"):
        shown = shell([*words, "--unit", unit, "--plot", str(tmp_path / "bands.svg")]).out
        assert f"mean [{unit}]" in shown
        # Letters are outlines, and a comment says what they spell.
        assert f"<!-- [{unit}] -->" in (tmp_path / "bands.svg").read_text("utf-8")
        heading, row = csv.reader((tmp_path / "table.csv").read_text().splitlines())
        assert heading[2] == f"mean [{unit}]"
        rows[unit] = float(row[2])
    assert rows["mg/kg"] == pytest.approx(rows["ug/g"]) == pytest.approx(1e3 * rows["g/kg"])


def test_draws_that_did_not_converge_are_named(fitted, shell, tmp_path):
    with xr.open_datatree(fitted, engine="h5netcdf") as stored:
        tree = stored.load()
    tree["posterior"].attrs["converged"] = 0
    tree.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    assert "bad.nc: the draws did not converge." in shell(["predict", str(tmp_path / "bad.nc"), "--alpha", "35deg"]).err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["nowhere.nc"], "nowhere.nc: is not there."),
        ([__file__], "must hold the draws of a posterior"),
        (["--alpha", "3 kg"], "Option `--alpha` must be an angle"),
        (["--alpha", "100 deg"], "Option `--alpha` must be "),
        (["--v0", "0 m/s"], "Option `--v0` must be positive"),
        (["--particle", "garnet"], "Option `--particle` must be a material and a size"),
        (["--unit", "mm^3/g"], "Option `--unit` must be a mass per mass"),
        (["--unit", "2 g/kg"], "Option `--unit` must be a unit, without a number, but is '2 g/kg'."),
        (["--unit", "0 g/kg"], "Option `--unit` must be a unit, without a number"),
        (["--unit", ""], "Option `--unit` must be a unit, without a number"),
        (["--level", "95"], "Option `--level` must be in (0, 1), but is 95.0."),
        (["-o", "table.nc"], "Option `--output` must end in .csv, but is table.nc."),
        (["--plot", "table.txt"], "must end in .svg, .png or .pdf"),
    ],
)
def test_mistakes_are_one_line(fitted, shell, options, message):
    file = [] if options[0][0] != "-" else [str(fitted)]
    assert message in shell(["predict", *file, *options], 2).err
