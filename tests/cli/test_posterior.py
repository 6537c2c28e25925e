"""`erosion posterior` as a user types it."""

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from erosion.cli import exit_status
from erosion.cli.calibrate import FitTask
from erosion.fits.fit_files import model_of_draws
from erosion.models.rigid import LinearizedCut
from erosion.parameters.case_files import CaseFile
from erosion.parameters.parameters import TABLE_1
from erosion.results import Finding, from_attribute, to_attribute
from tests.documents import findings


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    degrees = np.linspace(8.0, 80.0, 10)
    volume = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(degrees)))) / 0.0254**3
    noisy = volume + 6e-6 * np.random.default_rng(1).standard_normal(10)
    path = tmp_path_factory.mktemp("data") / "sand.csv"
    lines = [f"{angle},{part:.6e},6e-6" for angle, part in zip(degrees, noisy, strict=True)]
    path.write_text("angle [deg], volume [in^3/impact], uncertainty [in^3]\n" + "\n".join(lines))
    return path


FREE = ["--free", "k,psi"]


def test_the_files(table, tmp_path, shell):
    names = ("traces.png", "band.pdf", "best.svg", "draws.nc")
    options = ("--plot-traces", "--plot-prediction", "--plot-best-angles", "-o")
    files = [text for option, name in zip(options, names, strict=True) for text in (option, name)]
    out = shell(["posterior", str(table), *FREE, "--psi", "0.05", "--draws", "125", "--seed", "3", *files]).out
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    with xr.open_datatree("draws.nc") as tree:
        assert tree["posterior"].attrs["seed"] == 3
        assert tree["posterior"]["psi"].shape == (4, 125)
    assert out.splitlines()[-1].endswith("erosion advise --units inch-pound --uncertain draws.nc")


def test_several_models_as_json(table, shell):
    arguments = ["posterior", str(table), "--free", "psi", "--model", "linearized,tan-alpha"]
    printed = shell([*arguments, "--draws", "125", "--json"]).result
    # What misses the data is not drawn.
    (drawn,) = printed["posterior"]["ranking"]
    assert (drawn["model"], drawn["delta_log_evidence"], drawn["probability"]) == ("linearized", 0, pytest.approx(1))
    assert printed["ranking"][0]["model"] == "linearized"


def test_the_next_test(table, shell):
    line = ["posterior", str(table), "--free", "psi", "--draws", "125", "--discrepancy", "none", "--json"]
    rig = ["--next-angles", "20deg,40deg", "--next-particles", "quartz sand 2 mm"]
    some = shell([*line, *rig]).result["next_test"]
    assert len(some["candidates"]) == 2
    printed = shell([*line, "--next-test", "--next-for", "45 deg"]).result["next_test"]
    # Of one factor a row says most where the volume is greatest: at arctan(k)/2 = 31.7°.
    assert printed["best"]["alpha"] == pytest.approx(np.deg2rad(32.5))
    assert printed["asked"]["alpha"] == pytest.approx(np.deg2rad(45.0))
    # From 10° to 80°, as the tests are from 8° to 80°.
    assert len(printed["candidates"]) == 29
    assert "next_test" not in shell(line).result


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--next-particles", "garnit 2 mm"], "Option `--next-particles` must "),
        (
            ["--next-particles", "garnet 2 mm", "--free", "r"],
            "`--next-particles` must be left out, because r is fitted.",
        ),
        (["--next-speeds", "60 m/s", "--free", "v0"], "`--next-speeds` must be left out, because v0 is fitted."),
        (["--next-for", "30deg,40deg"], "Option `--next-for` must give one angle and one speed at most."),
        (["--next-for", "95deg"], "Option `--next-for` must have an angle above 0° and at most 90°."),
        (["--next-for", "60 kg"], "Option `--next-for` must be a speed such as"),
        (["--next-speeds", "inf m/s"], "Option `--next-speeds` must list positive speeds, but is inf m/s."),
    ],
)
def test_mistakes_in_the_next_test_are_found_before_anything_is_computed(table, shell, monkeypatch, options, message):
    monkeypatch.setattr(FitTask, "measured", lambda *arguments: pytest.fail("is computed"))
    assert message in shell(["posterior", str(table), "--free", "psi", *options], 2).err


def test_draws_are_kept_where_no_next_test_can_be_judged(shell):
    Path("rows.csv").write_text("angle [deg], mass_loss [mg/kg]\n15,190\n30,240\n45,205\n60,150\n")
    # A share of nothing: the model alone removes nothing at 90°.
    words = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--error", "8 %", "--next-angles", "90deg"]
    files = ["--discrepancy", "none", "--plot-next-test", "next.svg", "-o", "draws.nc"]
    out = shell(["posterior", "rows.csv", *words, "--model", "linearized", "--draws", "125", *files]).out
    assert out.splitlines()[-1].startswith("No candidate can be judged: ")
    assert "nan" not in out
    assert "No candidate can be judged" in Path("next.svg").read_text("utf-8")
    assert model_of_draws("draws.nc") == "linearized"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--profile", "k"], "Option `--profile` is unknown."),
        (["-o", "sand.csv"], "Option `--output` must end in .nc, but is sand.csv."),
        (["--next-speeds", "60 kg"], "Option `--next-speeds` must be a speed such as"),
        (["--next-angles", "100deg"], "Option `--next-angles` must be above 0°"),
        (["--next-speeds", "0 m/s"], "Option `--next-speeds` must list positive speeds, but is 0 m/s."),
        (["--prior", "r=uniform(0, 1)"], "of k, psi, energy_ratio, error_factor, but is 'r=uniform(0, 1)'."),
        (["--prior", "psi=4"], "Option `--prior`, psi, must be a law (normal, "),
        (["--prior", "psi=uniform(4)"], "Option `--prior`, psi, must be uniform(low, high), but is"),
        (["--prior", "psi=normal(0, 1)"], "Option `--prior` of `psi` must be positive, but 50.0%"),
        (["--draws", "5"], "Option `--draws` must be a whole number of at least 125, but is 5."),
        (["--output", "d.csv"], "Option `--output` must end in .nc, but is d.csv."),
        (["--plot-pairs", "d.txt"], "must end in .svg, .png or .pdf"),
    ],
)
def test_mistakes_are_one_line(table, shell, options, message):
    assert message in shell(["posterior", str(table), "--starts", "1", *options], 2).err


def test_all_files_of_a_ranking_are_of_one_model(shell):
    Path("rows.csv").write_text("angle [deg], mass_loss [mg/kg]\n15,190\n30,240\n45,205\n60,150\n75,110\n90,95\n")
    # AICc prefers `rotating-deformation`, whose energy ratio is 10.9; this prior allows that of the other one alone.
    words = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s", "--starts", "8"]
    models = ["--model", "linearized-deformation,rotating-deformation,tan-alpha", "--free", "k,psi,energy_ratio"]
    draws = ["--draws", "125", "--prior", "energy_ratio=uniform(2, 5)", "-o", "post.nc"]
    printed = shell(
        ["posterior", "rows.csv", *words, *models, *draws, "--write-case", "fitted.toml", "--json"]
    ).document
    ranked = [fit["model"] for fit in printed["result"]["ranking"] if fit["not_ranked"] is None]
    assert ranked == ["rotating-deformation", "linearized-deformation"]
    # What misses the data is drawn no posterior of.
    assert [*printed["result"]["posterior"]["fits"]] == ranked[::-1]
    (prefers,) = findings(printed, "evidence_prefers")
    assert (prefers["numbers"], prefers["about"]) == ({"before": ranked[0]}, ranked[1])
    assert CaseFile.read("fitted.toml").model()[0] == model_of_draws("post.nc") == "linearized-deformation"
    assert (
        exit_status(["stream", "fitted.toml", "--uncertain", "post.nc", "--n", "128", "--alpha", "normal(30deg, 3deg)"])
        == 0
    )


def test_a_case_file_names_no_draws_that_an_advice_refuses(shell):
    """In tests in units of their own the scale has the influence of ψ."""
    Path("rows.csv").write_text("angle [deg], erosion [-]\n15,1.9\n30,2.4\n45,2.05\n60,1.5\n75,1.1\n90,0.95\n")
    words = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s", "--starts", "2"]
    options = ["--free", "psi", "--model", "linearized", "--draws", "125", "--write-case", "f.toml", "--json"]
    assert "f.toml: has no draws of the fit" in shell(["posterior", "rows.csv", *words, *options]).err
    assert "uncertain" not in CaseFile.read("f.toml").section("advise")
    assert exit_status(["advise", "f.toml"]) == 0


def test_an_advice_tells_what_only_the_samples_say(shell):
    Path("rows.csv").write_text("angle [deg], erosion [-]\n15,1.9\n30,2.4\n45,2.05\n60,1.5\n75,1.1\n90,0.95\n")
    words = ["--particle", "garnet 0.3 mm", "--target", "aluminium 6061", "--v0", "100 m/s", "--starts", "2"]
    shell(["calibrate", "rows.csv", *words, "--free", "k", "--model", "linearized", "--write-case", "f.toml"])
    alone = Finding("prior_decides", "k", {"share": 0.2, "end": "lowest", "law": "uniform(1, 2)"})
    with h5py.File("f.nc", "r+") as file:
        both = from_attribute(file["posterior"].attrs["findings"])
        file["posterior"].attrs["findings"] = to_attribute([*both, alone])
    told = [one["text"] for one in findings(shell(["advise", "f.toml", "--json"]).document)]
    named = dataclasses.replace(alone, about="k (f.nc)")
    assert all(sum(one.text in text for text in told) == 1 for one in (*both, named))
