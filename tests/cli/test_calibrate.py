"""`erosion calibrate` as a user types it.

`erosion predict` as a user types it.
"""

import csv
import json
import os
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import erosion
from erosion import TABLE_1, dump_case, impact, load_case, load_model, to_fluent
from erosion.cli import exit_status
from erosion.fits.fit_files import read_draws, read_predictor
from erosion.models.rigid import LinearizedCut
from erosion.parameters import QUANTITIES
from tests.cli.test_document import check
from tests.documents import findings
from tests.fits.test_real_data import SAND, measured

GUESS = ["--k", "3", "--psi", "0.06", "--starts", "2"]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    degrees = np.linspace(5.0, 88.0, 50)
    volume = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(degrees)))) / 0.0254**3
    noisy = volume + 6e-6 * np.random.default_rng(1).standard_normal(50)
    path = tmp_path_factory.mktemp("data") / "sand.csv"
    lines = [f"{angle},{one:.6e},6e-6" for angle, one in zip(degrees, noisy, strict=True)]
    path.write_text("angle [deg], volume [in^3/impact], uncertainty [in^3]\n" + "\n".join(lines))
    return path


def test_a_fit_as_json_with_a_figure(table, tmp_path, shell):
    figure = tmp_path / "fit.svg"
    options = ["--plot", str(figure), "--profile", "k"]
    captured = shell(["calibrate", str(table), "--free", "k,psi", "--json", *options, *GUESS])
    printed = captured.result
    assert captured.err == ""
    assert printed["estimates"]["k"] == pytest.approx(2, abs=0.15)
    low, high = printed["intervals"]["k"]
    assert low < printed["estimates"]["k"] < high
    rise = {point["value"]: point["rise"] for point in printed["profile"]["points"]}
    assert rise[printed["estimates"]["k"]] == 0
    assert all((one > 3.84) == (not low < value < high) for value, one in rise.items())
    assert printed["erosion_unit"] == "in^3"
    assert figure.read_text().startswith("<?xml")


def test_what_is_not_determined_is_a_warning(table, shell):
    printed = shell(["calibrate", str(table), "--free", "psi,sigma", "--json", *GUESS]).result
    assert printed["undetermined"] == ["psi", "sigma"]
    assert printed["standard_errors"] == {"psi": None, "sigma": None}  # JSON has no infinity


@pytest.fixture(scope="module")
def sand(tmp_path_factory):
    """Sand at two speeds in mg/kg, of which 30 % of the particles cut; and the case."""
    folder = tmp_path_factory.mktemp("sand")
    data, case = folder / "sand.csv", folder / "case.toml"
    columns = measured()
    rows = zip(*columns.values(), strict=True)
    data.write_text("# 0.3 mm\n" + ",".join(columns) + "\n" + "\n".join(",".join(map(str, row)) for row in rows))
    case.write_text(dump_case(SAND.replace(v0=110.0)))
    return ["calibrate", str(data), str(case), "--density", "7850 kg/m^3", "--starts", "2"]


def test_a_fit_within_bounds_is_written_as_a_case(sand, tmp_path, shell):
    path = tmp_path / "fitted.toml"
    options = ["--free", "sigma,k", "--cutting-fraction", "0.3", "--bounds", "sigma=1 GPa:2 GPa,k=1:5"]
    printed = shell([*sand, *options, "--write-case", str(path), "--json"]).result
    assert printed["bounds"] == {"sigma": pytest.approx([1e9, 2e9]), "k": pytest.approx([1, 5])}
    assert (printed["degrees_of_freedom"], len(printed["residuals"])) == (22, 24)
    assert 10 < printed["chi2"] < 40
    assert printed["rms"] == pytest.approx(np.sqrt(np.mean(np.square(printed["residuals"]))))
    assert printed["cutting_fraction"] == 0.3
    fitted = load_case(path)
    assert float(fitted.sigma) == printed["estimates"]["sigma"] == pytest.approx(1.5e9, rel=0.05)
    # The case was at 110 m/s, at which nothing was measured.
    assert float(fitted.v0) == 60.0
    case, _, advice = path.read_text().partition("\n[advise]\n")
    assert case.endswith('\ncutting_fraction = 0.3  # share of the particles that cut\nmodel = "linearized"\n')
    assert tomllib.loads(f"[advise]\n{advice}")["advise"]["uncertain"] == "fitted.nc"
    draws = read_draws(tmp_path / "fitted.nc", QUANTITIES).rows.columns
    low, high = printed["intervals"]["sigma"]
    assert [*draws] == ["sigma", "k"]
    assert 0.85 < np.mean((low < np.array(draws["sigma"])) & (np.array(draws["sigma"]) < high)) <= 1
    assert shell(["run", str(path), "--json"]).document["case"]["parameters"]["k"]["value"] == printed["estimates"]["k"]
    (beyond,) = findings(shell(["optimum", str(path), "--v0", "600 m/s", "--json"]).document, "outside_of_tests")
    fastest = tomllib.loads(path.read_text())["advise"]["tested"]["v0"][1].removesuffix(" m/s")
    assert (beyond["about"], beyond["numbers"]["side"]) == (str(path), "fastest")
    assert beyond["numbers"]["ratio"] == pytest.approx(600 / float(fastest))


def test_draws_are_within_bounds_and_spread_where_the_data_say_nothing(sand, tmp_path):
    path = tmp_path / "fitted.toml"
    bounded = [*sand, "--free", "sigma,k", "--cutting-fraction", "0.3", "--bounds", "sigma=1 GPa:1.4 GPa"]
    assert exit_status([*bounded, "--write-case", str(path)]) == 0
    draws = read_draws(tmp_path / "fitted.nc", QUANTITIES).rows.columns["sigma"]
    assert 1e9 <= min(draws) < max(draws) == pytest.approx(1.4e9, rel=0.01)


def test_bounds_that_are_touched_are_in_table_and_json(sand, shell):
    options = ["--free", "k,cutting_fraction", "--bounds", "cutting_fraction=0.05:0.1"]
    touched = shell([*sand, *options, "--json"]).result["bounds_touched"]
    assert touched["cutting_fraction"] == ["estimate at upper", "interval at upper"]


@pytest.fixture(scope="module")
def aluminium(tmp_path_factory):
    """Aluminium at all angles and two speeds in mg/kg, worn by cutting and deformation; and the case."""
    folder = tmp_path_factory.mktemp("aluminium")
    data, case = folder / "aluminium.csv", folder / "case.toml"
    p = SAND.replace(sigma=0.4e9, k=1.5)
    model = load_model("linearized-deformation").replace(energy_ratio=1.4, threshold=8.0)
    rng, lines = np.random.default_rng(2), ["angle [deg], speed [m/s], mass_loss [mg/kg], uncertainty [mg/kg]"]
    degrees = np.array([15, 20, 25, 30, 40, 50, 60, 75, 90.0])
    for speed in (40.0, 80.0):
        volume = impact(model, p.replace(alpha=np.deg2rad(degrees), v0=speed)).volume
        loss = 0.3 * volume * 2700 / float(p.m) * 1e6
        error = 0.03 * loss.max()
        noisy = loss + error * rng.standard_normal(degrees.size)
        lines += [f"{angle:g},{speed:g},{one:.2f},{error:.2f}" for angle, one in zip(degrees, noisy, strict=True)]
    data.write_text("\n".join(lines))
    case.write_text(dump_case(p.replace(k=2.0)))
    words = ["calibrate", str(data), str(case), "--density", "2.7 g/cm^3", "--starts", "4"]
    return [*words, "--free", "k,cutting_fraction,energy_ratio"]


DEFORMATION = ["--model", "linearized-deformation"]


def test_a_written_case_has_the_model_for_every_verb(aluminium, shell):
    *_, next_step = shell(
        [*aluminium, *DEFORMATION, "--set", "threshold=8 m/s", "--write-case", "fitted.toml"]
    ).out.splitlines()
    assert next_step == "for CFD codes: erosion export fitted.toml --fluent angles.csv"
    printed = json.loads(shell([*shlex.split(next_step.partition(": erosion ")[2]), "--json"]).out)
    own = {name: parameter["value"] for name, parameter in printed["model"]["own_parameters"].items()}
    assert own == {"energy_ratio": pytest.approx(1.4, abs=0.2), "threshold": 8.0}
    share = tomllib.loads(Path("fitted.toml").read_text())["cutting_fraction"]
    fitted = load_model("linearized-deformation").replace(**own)
    form = to_fluent(fitted, load_case("fitted.toml"), cutting_fraction=share)
    assert printed["result"]["fluent"]["factor"] == pytest.approx(form.factor, rel=1e-12)
    assert Path("angles.csv").read_text().splitlines()[-10:] == form.text().splitlines()[-10:]
    assert "use a table for Fluent (--fluent)" in shell("export fitted.toml --openfoam erosionDict", 2).err
    assert not Path("erosionDict").exists()
    assert "# The best angle of this fit: erosion optimum fitted.toml" in Path("fitted.toml").read_text()
    verbs = (
        "run fitted.toml",
        "optimum fitted.toml",
        "stream fitted.toml --n 1e3 --no-best-angle --alpha 'normal(20 deg, 2 deg)'",
        "sweep fitted.toml --alpha 5deg:85deg:3 -o V.csv",
    )
    for line in verbs:
        model = shell([*shlex.split(line), "--json"]).document["model"]
        assert model["name"] == "linearized-deformation"
        assert {name: parameter["value"] for name, parameter in model["own_parameters"].items()} == own
    # An option wins, and what is set is of the file's model.
    of_option = shell("optimum fitted.toml --set 'threshold=5 m/s' --json").document["model"]["own_parameters"]
    assert of_option["threshold"]["value"] == 5.0
    assert of_option["energy_ratio"]["value"] == own["energy_ratio"]
    assert shell("optimum fitted.toml --model rotating --json").document["model"]["name"] == "rotating"
    assert (
        "cannot convert the field `set` of fitted.toml, which is in si"
        in shell("optimum fitted.toml --units inch-pound", 2).err
    )


def test_models_are_ranked_though_one_lacks_a_parameter(aluminium, capsys, shell):
    options = ["--model", "linearized,linearized-deformation", "--bounds", "threshold=0:40 m/s,energy_ratio=0.5:5"]
    words = [*aluminium[:-1], "k,cutting_fraction,energy_ratio,threshold"]
    first, second = shell([*words, *options, "--json"]).result["fits"].values()
    assert list(first["estimates"]) == ["k", "cutting_fraction", "energy_ratio", "threshold"]
    assert list(second["estimates"]) == ["k", "cutting_fraction"]
    assert exit_status([*aluminium[:-1], "k,friction", *options[:2]]) == 2
    line = "Option `--free` must name parameters of the models, but 'friction' is none of linearized, linearized-"
    assert line in capsys.readouterr().err


def test_the_example_of_the_docs_is_what_is_printed(aluminium, monkeypatch, shell):
    monkeypatch.setenv("COLUMNS", "96")
    page = (Path(__file__).parents[2] / "docs" / "calibration.md").read_text()
    _, data, case, *_ = aluminium
    assert "\n".join(Path(data).read_text().splitlines()[:3]).replace(",", ", ").replace(",  ", ", ") in page
    monkeypatch.chdir(Path(data).parent)
    words = ["calibrate", Path(data).name, case, "--density", "2.7 g/cm^3", "--free"]
    models = ["--model", "linearized,linearized-deformation"]
    printed = shell([*words, "k,cutting_fraction,energy_ratio,threshold", *models]).out
    ranking, _, rest = printed.partition("\n\n* not ranked.\n")
    assert ranking.strip() in page
    assert rest.endswith("\na nozzle's angle: --write-case fitted.toml, then erosion advise fitted.toml\n")


def test_without_a_case_the_units_are_those_of_the_data(written, shell):
    lines = ["angle [deg], speed [m/s], volume [mm^3/impact]", *(f"{angle}, {speed}, {1e-3 * angle * speed}"
             for angle in (10, 20, 30, 40) for speed in (50, 100))]  # fmt: skip
    path = written("sand.csv", "\n".join(lines))
    out = shell(["calibrate", str(path), "--starts", "1"]).out
    assert "mm³" in out
    assert "in³" not in out
    # --units wins.
    assert "in³" in shell(["calibrate", str(path), "--starts", "1", "--units", "inch-pound"]).out
    document = shell(["calibrate", str(path), "--starts", "1", "--r", "1 mm", "--json"]).document
    assert document["units"] == "si"
    assert document["case"]["parameters"]["r"] == {"value": 1e-3, "unit": "m"}


def test_a_pipe_needs_units_beside_it(tmp_path, shell):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert shell(["calibrate", str(pipe)], 2).err == (
        f"erosion: {pipe} is no file: beside it give `--units si`, `--units inch-pound` or a case file.\n"
    )


@pytest.mark.parametrize(("deforms", "best"), [(0.0, "linearized"), (3e-9, "linearized-deformation")])
def test_without_model_and_parameters_wear_at_steep_angles_is_tried(tmp_path, shell, deforms, best):
    """Metals lose much at 90°, where a cut removes nothing."""
    degrees, random = np.array([10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0]), np.random.default_rng(3)
    p = TABLE_1.to("si")
    volume = impact("linearized", p.replace(alpha=np.deg2rad(degrees))).volume
    volume = volume * (1 + 0.02 * random.standard_normal(7)) + deforms * np.sin(np.deg2rad(degrees)) ** 2
    rows = "\n".join(f"{angle}, {removed}, 3e-11" for angle, removed in zip(degrees, volume, strict=True))
    (path := tmp_path / "steel.csv").write_text(f"angle [deg], volume [m^3/impact], uncertainty [m^3]\n{rows}\n")
    printed = shell(["calibrate", str(path), "--starts", "4", "--json"])
    assert printed.result["ranking"][0]["model"] == best
    assert ("energy_ratio" in printed.result["estimates"]) == (best == "linearized-deformation")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Draws from weighings at two speeds, of a curve that no model has."""
    angle, speed = (part.ravel() for part in np.meshgrid([15.0, 30.0, 45.0, 60.0, 75.0], [60.0, 98.0]))
    true = 300 * np.sin(np.deg2rad(2 * angle)) ** 0.6 * (speed / 98) ** 2.4
    weighed = true * (1 + 0.05 * np.random.default_rng(4).standard_normal(true.size))
    data = {"angle [deg]": angle, "speed [m/s]": speed, "mass_loss [ug/g]": weighed}
    p = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061")
    drawn = erosion.posterior(
        erosion.FitProblem("linearized", p, data, ["k", "psi"], density=2700.0, error="2 mg/kg + 5 %"), draws=125
    )
    return drawn.save(tmp_path_factory.mktemp("fit") / "draws.nc")


def test_the_numbers_are_those_of_the_predictor(fitted, shell, tmp_path):
    table = tmp_path / "table.csv"
    words = ["predict", str(fitted), "--alpha", "35deg, 50deg", "--v0", "60 m/s, 120 m/s", "--level", "0.9"]
    printed = shell([*words, "-o", str(table), "--json"])
    asked, at = np.deg2rad([[35.0, 50.0]] * 2), {"v0": np.array([[60.0], [120.0]])}
    predictor = read_predictor(fitted)
    of_mean, of_weighing = (predictor.draw(asked, at, 2000, noise=noise) for noise in (False, True))
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
    assert "120 m/s is 1.22 × the fastest test." in [one["text"] for one in printed.document["findings"]]
    heading, *rows = csv.reader(table.read_text().splitlines())
    assert heading[:4] == ["alpha [deg]", "v0 [m/s]", "mean [ug/g]", "mean_low [ug/g]"]
    np.testing.assert_allclose([float(row[2]) for row in rows], 1e6 * of_mean.mean(axis=0).ravel())


def test_the_wear_is_in_the_unit_that_is_asked_for(fitted, shell, tmp_path):
    words = ["predict", str(fitted), "--alpha", "35deg", "--v0", "98 m/s", "-o", str(tmp_path / "table.csv")]
    rows = {}
    for unit in ("ug/g", "g/kg"):
        shell([*words, "--unit", unit])
        heading, row = csv.reader((tmp_path / "table.csv").read_text().splitlines())
        assert heading[2] == f"mean [{unit}]"
        rows[unit] = float(row[2])
    assert rows["ug/g"] == pytest.approx(1e3 * rows["g/kg"])


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
