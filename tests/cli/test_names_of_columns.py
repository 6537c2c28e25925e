"""Names of columns at the command line: of impacts in `map`, of weighings in `calibrate`, of rows in `stream`."""

import json
from pathlib import Path

import numpy as np
import pytest

import erosion
from tests.documents import Shell

CASE = ["--units", "si", "--particle", "quartz 0.1 mm"]


@pytest.fixture(autouse=True)
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


IMPACTS = "diameter [um],density [kg/m^3],speed [m/s],angle [deg],{},note\n100,2650,50,30,13,a\n100,2650,60,20,13,b\n"


def test_a_map_has_the_weights_of_its_rows_or_says_why_not(shell: Shell) -> None:
    pytest.importorskip("pyarrow")
    volumes = {}
    for name in ("count", "frequency [1/s]", "note 2"):
        Path("a.csv").write_text(IMPACTS.format(name))
        printed = shell(["map", "a.csv", *CASE, "--json"])
        volumes[name], err = printed.result["total_volume"], printed.err
        assert "columns that are not used: " in err
        assert ("each row counts as one particle" in err) == (name == "note 2")
    assert volumes["frequency [1/s]"] == volumes["count"]
    np.testing.assert_allclose(volumes["count"], 13 * volumes["note 2"], rtol=1e-12)
    Path("a.csv").write_text(IMPACTS.format("hits"))
    assert "a.csv: column 'hits' is not understood" in shell(["map", "a.csv", *CASE], 2).err
    printed = shell(["map", "a.csv", *CASE, "--json", "--ignore", "hits,note"])
    assert (printed.result["total_volume"], "not used" in printed.err) == (volumes["note 2"], False)
    assert "a.csv: has no column 'hit'" in shell(["map", "a.csv", *CASE, "--ignore", "hit"], 2).err


def test_a_fit_has_the_speeds_of_its_rows_or_is_refused(shell: Shell) -> None:
    p = erosion.TABLE_1.to("si").replace(psi=0.04)
    degrees, speeds = np.tile(np.linspace(10, 60, 9), 2), np.repeat([60.0, 120.0], 9)
    volumes = np.asarray(erosion.impact("linearized", p.replace(alpha=np.deg2rad(degrees), v0=speeds)).volume)
    rows = "".join(f"{a:g},{v * 1e9:.9g},{s:g}\n" for a, v, s in zip(degrees, volumes, speeds, strict=True))
    free = ["--free", "psi", "--units", "si", "--json", "--starts", "2"]
    for name in ("speed [m/s]", "v [m/s]", "velocity [m/s]", "speed (m/s)"):
        Path("a.csv").write_text(f"angle [deg],volume [mm^3],{name}\n{rows}")
        out, _ = shell(["calibrate", "a.csv", *free])
        assert json.loads(out)["result"]["estimates"]["psi"]["value"] == pytest.approx(0.04, rel=1e-3)
    Path("a.csv").write_text(f"angle [deg],volume [mm^3],jet velocity [m/s]\n{rows}")
    _, err = shell(["calibrate", "a.csv", *free], 2)
    assert "column 3 (jet velocity [m/s])" in err
    assert "`speed`" in err
    assert "Option `--ignore`" in err
    assert "not used" not in shell(["calibrate", "a.csv", *free, "--ignore", "jet velocity"]).err


def test_rows_of_a_stream_have_their_speeds_or_are_refused(shell: Shell) -> None:
    means = {}
    for name in ("v0 [m/s]", "Impact Velocity (m/s)"):
        Path("a.csv").write_text(f"alpha [deg],{name},cell\n20,200,1\n30,300,2\n")
        out, err = shell(["stream", "--units", "si", "--rows", "a.csv", "--n", "64", "--json"])
        assert "a.csv: columns that are not used: 'cell'." in err
        means[name] = json.loads(out)["result"]["mean_volume"]["value"]
    assert len({*means.values()}) == 1
    Path("a.csv").write_text("alpha [deg],v_rel [m/s]\n20,200\n30,300\n")
    refused = shell("stream --units si --rows a.csv --n 64", 2)
    assert "in a.csv 'v_rel [m/s]' has the unit of a speed" in refused.err


def test_draws_of_a_table_may_have_the_share_of_particles_that_cut(shell: Shell) -> None:
    pytest.importorskip("pyarrow")
    Path("a.csv").write_text(IMPACTS.format("count"))
    volumes = []
    for share in (1.0, 0.25):
        Path("draws.csv").write_text(f"psi,cutting_fraction,chain\n0.04,{share},1\n0.05,{share},2\n")
        given = [*CASE, "--uncertain", "draws.csv", "--draws", "4"]
        out, err = shell(["map", "a.csv", *given, "--json"])
        assert "draws.csv: columns that are not used: 'chain'." in err
        volumes.append(json.loads(out)["result"]["total_volume"]["value"])
    assert volumes[1] == pytest.approx(0.25 * volumes[0])
    # A stream takes a number alone for this share, whatever gives it.
    shell("stream --v0 'normal(110, 5)' --units si --uncertain draws.csv", 2)


WEIGHTS = (
    "count", "weight", "n", "nParticle", "N_p", "frequency", "frequency [1/s]", "rate [1/s]", "mass_flow [kg/s]",
    "mass flow rate", "probability", "share", "fraction", "Anzahl", "rel. frequency", "wt", "particles",
)  # fmt: skip


@pytest.mark.parametrize("head", WEIGHTS)
@pytest.mark.parametrize("how", [["--rows", "a.csv"], ["--v0", "samples(a.csv)"]])
def test_rows_that_do_not_count_alike_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, head: str, how: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(f"v0 [m/s],{head}\n100,1\n300,1000\n")
    assert head in shell(["stream", "--n", "64", "--no-best-angle", *how], 2).err


@pytest.mark.parametrize("head", ["x [m]", "time [s]", "particle id", "omega [rad/s]", "phidot0 [rpm]", "k", "note"])
def test_what_is_no_weight_may_stand_beside_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell, head: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text(f"v0 [m/s],{head}\n100,1\n300,1000\n")
    assert shell("stream --n 64 --no-best-angle --v0 'samples(a.csv)'").err == ""


def test_columns_of_one_table_that_come_apart_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("v0 [m/s],alpha [deg]\n100,20\n300,40\n")
    stream = ["stream", "--n", "64", "--no-best-angle"]
    assert (
        "are drawn independently of each other"
        in shell([*stream, "--v0", "samples(a.csv)", "--alpha", "samples(a.csv)"]).err
    )
    assert shell([*stream, "--rows", "a.csv"]).err == ""
