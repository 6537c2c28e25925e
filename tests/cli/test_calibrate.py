"""`erosion calibrate` as a user types it."""

import numpy as np
import pytest

from erosion.cli import _status
from erosion.models.closed_forms import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from tests.documents import result_of

pytestmark = pytest.mark.slow

GUESS = ["--k", "3", "--psi", "0.06", "--starts", "2"]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    degrees = np.linspace(5.0, 88.0, 50)
    volume = np.asarray(LinearizedCut().volume(TABLE_1.replace(alpha=np.deg2rad(degrees))))
    noisy = volume + 6e-6 * np.random.default_rng(1).standard_normal(50)
    path = tmp_path_factory.mktemp("data") / "sand.csv"
    lines = [f"{angle},{one:.6e},6e-6" for angle, one in zip(degrees, noisy, strict=True)]
    path.write_text("angle [deg], volume [in^3], uncertainty [in^3]\n" + "\n".join(lines))
    return path


def test_a_fit_as_json_with_files(table, tmp_path, capsys):
    files = [tmp_path / name for name in ("fit.svg", "particleErosion", "table.csv")]
    options = ["--plot", str(files[0]), "--openfoam", str(files[1]), "--fluent", str(files[2]), "--profile", "k"]
    assert _status(["calibrate", str(table), "--free", "k,psi", "--json", *options, *GUESS]) == 0
    captured = capsys.readouterr()
    printed = result_of(captured.out)
    assert captured.err == ""
    assert printed["estimates"]["k"] == pytest.approx(2, abs=0.15)
    low, high = printed["intervals"]["k"]
    assert low < printed["estimates"]["k"] < high
    rise = dict(zip(printed["profile"]["values"], printed["profile"]["rise"], strict=True))
    assert rise[printed["estimates"]["k"]] == 0
    assert all((one > 3.84) == (not low < value < high) for value, one in rise.items())
    assert printed["erosion_unit"] == "in^3"
    assert files[0].read_text().startswith("<?xml")
    assert "type        particleErosion;" in files[1].read_text()
    assert "angle [deg],f [-]" in files[2].read_text()


def test_a_profile_as_text(table, capsys):
    assert _status(["calibrate", str(table), "--free", "k,psi", "--profile", "psi", *GUESS]) == 0
    out = capsys.readouterr().out
    below, profile = out.split("profile of psi")
    assert "95%: " in below
    assert "Δχ²" in profile
    assert len([line for line in profile.splitlines() if line.strip()[:4] in ("0.03", "0.04")]) == 21


def test_what_is_not_determined_is_a_warning(table, capsys):
    assert _status(["calibrate", str(table), "--free", "psi,sigma", *GUESS]) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("warning: psi and sigma cannot be told apart: only psi·sigma is determined.")
    assert "not determined" in captured.out
    assert _status(["calibrate", str(table), "--free", "psi,sigma", "--json", *GUESS]) == 0
    printed = result_of(capsys.readouterr().out)
    assert printed["undetermined"] == ["psi", "sigma"]
    assert printed["standard_errors"] == {"psi": None, "sigma": None}  # JSON has no infinity


def test_several_models_are_ranked(table, capsys):
    arguments = ["calibrate", str(table), "--model", "linearized,tan-alpha", "--free", "psi", *GUESS]
    assert _status([*arguments, "--json"]) == 0
    captured = capsys.readouterr()
    assert [one["model"] for one in result_of(captured.out)["ranking"]] == ["linearized", "tan-alpha"]
    assert _status(arguments) == 0
    out = capsys.readouterr().out
    assert "ΔAICc" in out
    assert out.index("linearized") < out.index("tan-alpha")
