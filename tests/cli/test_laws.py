"""Laws of several parameters, and of what is uncertain, as a user types them for `erosion stream` and `erosion map`.

`erosion sweep` and `erosion stream`: options, case files, refusals and Ctrl-C.
"""

import csv
import dataclasses
import json
import shlex
import sys
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion.cli import exit_status
from erosion.fits.fit_files import read_draws
from erosion.laws import JointLaw, JointSamples
from erosion.parameters.quantities import QUANTITIES
from erosion.results import Finding, to_attribute
from tests.cli.test_document import SCHEMA
from tests.documents import Shell, findings

CASE = """units = "si"
k = 2.4
psi = 2.0
sigma = 1.5e9
r = 0.000125
b = 0.00025
m = 2.168e-8
inertia = 0.5
v0 = 25.0
alpha = 0.44
"""
FEW = "--n 4096 --no-best-angle --json"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tests of a metal, the impacts of a CFD run, and the draws of a posterior by the command line."""
    made = tmp_path_factory.mktemp("laws")
    (made / "sand.toml").write_text(CASE)
    p, degrees = erosion.load_case(made / "sand.toml"), np.linspace(10.0, 70.0, 9)
    exact = erosion.impact("linearized", p.replace(alpha=np.deg2rad(degrees))).volume / float(p.m) * 1e9
    error = 0.1 * exact.max()
    measured = exact + error * np.random.default_rng(2).standard_normal(9)
    with (made / "tests.csv").open("w") as file:
        rows = [("angle [deg]", "erosion [mm^3/kg]", "uncertainty [mm^3/kg]")]
        csv.writer(file).writerows([*rows, *((d, e, error) for d, e in zip(degrees, measured, strict=True))])
    with (made / "impacts.csv").open("w") as file:
        rows = [("diameter [um]", "density [kg/m^3]", "count", "speed [m/s]", "angle [deg]")]
        csv.writer(file).writerows([*rows, *((200, 2650, 10, 30, 5 + i % 60) for i in range(600))])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        prior = '--free psi --prior "psi=loguniform(0.5, 8)" --draws 250'
        assert exit_status(shlex.split(f"posterior tests.csv sand.toml {prior} -o post.nc")) == 0
    return made


@pytest.fixture(autouse=True)
def in_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


def said(line: str, shell: Shell) -> tuple[dict[str, Any], str]:
    out, err = shell(line)
    jsonschema.Draft202012Validator(SCHEMA).validate(json.loads(out))
    return json.loads(out), err


def value(document: dict[str, Any], name: str) -> float:
    number = document["result"][name]
    return number["value"] if isinstance(number, dict) else number


def test_the_error_of_a_fit_goes_on_to_the_map(shell: Shell) -> None:
    document, err = said("map impacts.csv sand.toml --uncertain post.nc --draws 256 --json", shell)
    assert err == ""
    with xr.open_dataset("post.nc", group="posterior") as stored:
        factor = 1 / stored["psi"].values
    # V goes with 1/ψ.
    exact = factor.std() / factor.mean()
    assert 0.01 < exact < 0.2
    assert value(document, "total_parameter_error") == pytest.approx(exact, rel=0.15)
    both = np.hypot(value(document, "total_parameter_error"), value(document, "total_sampling_error"))
    assert value(document, "total_relative_error") == pytest.approx(both)
    assert document["case"]["varied"]["psi"] == "uncertain 1,000 values of post.nc, row by row of psi"
    assert document["seed"] == 0
    plain, _ = said("map impacts.csv sand.toml --json", shell)
    assert value(plain, "total_relative_error") < value(document, "total_relative_error")


def test_a_table_of_particles_is_taken_row_by_row(shell: Shell) -> None:
    angles, speeds = np.linspace(10.0, 60.0, 64), np.linspace(40.0, 20.0, 64)
    with Path("jet.csv").open("w") as file:
        csv.writer(file).writerows([("alpha [deg]", "v0 [m/s]"), *zip(angles, speeds, strict=True)])
    document, _ = said(f"stream sand.toml --rows jet.csv {FEW}", shell)
    p = erosion.load_case("sand.toml")
    exact = erosion.impact("linearized", p.replace(alpha=np.deg2rad(angles), v0=speeds)).volume.mean()
    assert value(document, "mean_volume") == pytest.approx(exact, rel=1e-9)


def test_laws_are_correlated_in_options_and_in_a_case_file(shell: Shell) -> None:
    laws = '--v0 "lognormal(25 m/s, 0.2)" --r "lognormal(0.125 mm, 0.2)"'
    options, _ = said(f"stream sand.toml {laws} --correlation v0,r=0.8 {FEW}", shell)
    section = '[stream]\nv0 = "lognormal(25 m/s, 0.2)"\nr = "lognormal(0.125 mm, 0.2)"\ncorrelation = {"v0, r" = 0.8}\n'
    Path("jet.toml").write_text(CASE + section)
    of_file, _ = said(f"stream jet.toml {FEW}", shell)
    assert of_file["result"] == options["result"]
    p = erosion.load_case("sand.toml")
    speed, size = stats.lognorm(0.2, scale=25.0), stats.lognorm(0.2, scale=0.000125)
    tie = {("v0", "r"): 0.8}
    here = erosion.stream("linearized", p, n=4096, best_angle=False, v0=speed, r=size, correlation=tie)
    assert value(options, "mean_volume") == pytest.approx(here.mean_volume.value, rel=1e-9)


def test_uncertain_laws_are_a_table_of_a_case_file(shell: Shell) -> None:
    section = """[map]
model = "rotating"
phidot0 = "normal(0, 1e4 rad/s)"
correlation = {"k,psi" = -0.9}
[map.uncertain]
k = "normal(2.4, 0.2)"
psi = "lognormal(2, 0.1)"
"""
    Path("map.toml").write_text(CASE + section)
    of_file, _ = said("map impacts.csv map.toml --draws 16 --json", shell)
    laws = '--uncertain "k=normal(2.4, 0.2)" --uncertain "psi=lognormal(2, 0.1)" --correlation k,psi=-0.9'
    line = f'map impacts.csv sand.toml --model rotating --phidot0 "normal(0, 1e4 rad/s)" {laws} --draws 16 --json'
    options, _ = said(line, shell)
    assert of_file["result"] == options["result"]
    joint = JointLaw({"k": stats.norm(2.4, 0.2), "psi": stats.lognorm(0.1, scale=2.0)}, {("k", "psi"): -0.9})
    case, spin = erosion.load_case("sand.toml"), stats.norm(0.0, 1e4)
    table = erosion.read_impacts("impacts.csv")
    wear = erosion.erosion_map("rotating", case, table, phidot0=spin, uncertain=joint, draws=16)
    assert value(options, "total_volume") == pytest.approx(float(wear["total_volume"]), rel=1e-9)
    assert value(options, "total_parameter_error") == pytest.approx(float(wear["total_parameter_error"]), rel=1e-9)


def test_impacts_take_spin_and_force_ratio_from_one_row(shell: Shell) -> None:
    spin, k = np.linspace(-2e4, 2e4, 16), np.linspace(1.5, 3.0, 16)
    with Path("spins.csv").open("w") as file:
        csv.writer(file).writerows([("phidot0 [rad/s]", "k"), *zip(spin, k, strict=True)])
    document, _ = said("map impacts.csv sand.toml --model rotating --rows spins.csv --seed 2 --json", shell)
    case, table = erosion.load_case("sand.toml"), erosion.read_impacts("impacts.csv")
    wear = erosion.erosion_map("rotating", case, table, seed=2, samples={"phidot0": spin, "k": k})
    assert value(document, "total_volume") == pytest.approx(float(wear["total_volume"]), rel=1e-9)
    assert document["case"]["varied"]["k"] == "16 values of spins.csv, row by row of phidot0, k"
    assert document["seed"] == 2


def test_the_share_that_cuts_is_a_factor_of_the_map(shell: Shell) -> None:
    whole, _ = said("map impacts.csv sand.toml --json", shell)
    part, _ = said("map impacts.csv sand.toml --cutting-fraction 0.4 --json", shell)
    assert value(part, "total_volume") == pytest.approx(0.4 * value(whole, "total_volume"))
    Path("half.toml").write_text("cutting_fraction = 0.5\n" + CASE)
    half, _ = said("map impacts.csv half.toml --json", shell)
    assert value(half, "total_volume") == pytest.approx(0.5 * value(whole, "total_volume"))
    line = "map impacts.csv half.toml --uncertain 'cutting_fraction=uniform(0.2, 0.4)' --json"
    unknown, _ = said(line, shell)
    assert value(unknown, "total_volume") == pytest.approx(0.3 * value(whole, "total_volume"), rel=0.01)


def test_a_case_that_is_not_the_fits_is_a_warning(shell: Shell) -> None:
    line = "map impacts.csv sand.toml --uncertain post.nc --sigma '2 GPa' --cutting-fraction 0.5 --draws 4 --json"
    document, err = said(line, shell)
    assert [(one["about"], one["numbers"]) for one in findings(document)] == [
        ("post.nc", {"symbol": "σ", "before": "1.5e+09 Pa", "now": "2e+09 Pa"}),
        ("post.nc", {"before": 1.0, "now": 0.5}),
    ]
    assert err.count("warning: ") == 2


MISFIT = Finding("misfit_of_draws_beyond_errors", "", {"chi2": 40.0, "rows": 12})
PRIOR = Finding("prior_decides", "psi", {"share": 0.94, "end": "lowest", "law": "uniform"})


def test_draws_of_a_bad_fit_are_a_warning() -> None:
    known = {"psi": QUANTITIES["psi"]}
    draws = read_draws("post.nc", known)
    model = erosion.load_model("linearized")
    assert draws.doubts(model, draws.p, 1.0) == []
    (slow,) = draws.doubts(model, draws.p.replace(v0=50.0), 1.0)
    assert (slow.code, slow.about, slow.numbers["ratio"]) == ("outside_of_tests", "post.nc", pytest.approx(2.0))
    assert draws.rows.tested["alpha"] == pytest.approx(np.deg2rad((10.0, 70.0)))
    with xr.open_datatree("post.nc") as tree:
        tree["posterior"].attrs |= {"converged": 0, "findings": to_attribute([MISFIT, PRIOR])}
        tree["posterior"]["scale"] = tree["posterior"]["psi"]
        tree.to_netcdf("bad.nc", engine="h5netcdf")
    bad = read_draws("bad.nc", known)
    assert [one.code for one in bad.doubts(model, draws.p, 1.0)] == ["not_converged", "draws_without_size"]
    named = [dataclasses.replace(MISFIT, about="bad.nc"), dataclasses.replace(PRIOR, about="psi (bad.nc)")]
    assert bad.of_fit() == named
    assert {*bad.rows.columns} == {"psi"}


def test_draws_in_a_csv_file_are_uncertain_together(shell: Shell) -> None:
    psi = np.geomspace(1.5, 2.5, 64)
    with Path("draws.csv").open("w") as file:
        csv.writer(file).writerows([("sigma [GPa]", "psi", "chain"), *((3 / q, q, 0) for q in psi)])
    document, _ = said("map impacts.csv sand.toml --uncertain draws.csv --json", shell)
    # σψ is one number.
    assert value(document, "total_parameter_error") == pytest.approx(0, abs=1e-8)


def test_own_parameters_may_be_those_of_the_fit_in_other_units(shell: Shell) -> None:
    model = ["--model", "linearized-deformation", "--set", "threshold=12 m/s"]
    fit = ["posterior", "tests.csv", "sand.toml", "--draws", "125", "--free", "psi"]
    shell([*fit, *model, "-o", "slow.nc"])
    line = "map impacts.csv sand.toml --units inch-pound --uncertain slow.nc --draws 2 --json"
    document, _ = said(f"{line} --model linearized-deformation --set 'threshold=12 m/s'", shell)
    assert not findings(document, "draws_of_other_model")
    document, _ = said(f"{line} --model linearized-deformation --set 'threshold=15 m/s'", shell)
    (other,) = findings(document, "draws_of_other_model")
    assert other["about"] == "slow.nc"
    assert [other["numbers"][when].split()[-2:] for when in ("before", "now")] == [["12", "m/s"], ["15", "m/s"]]


def test_draws_beside_a_case_in_inches_are_in_si() -> None:
    degrees = np.array([10.0, 30.0, 60.0])
    p = erosion.TABLE_1
    exact = np.asarray(erosion.impact("linearized", p.replace(alpha=np.deg2rad(degrees))).volume)
    data = {"angle [deg]": degrees, "volume [m^3/impact]": exact, "uncertainty [m^3]": np.full(3, 0.1 * exact.max())}
    drawn = erosion.posterior(erosion.FitProblem("linearized", p, data, ["sigma", "cutting_fraction"]), draws=125)
    drawn.save("other.nc")
    known = dict(QUANTITIES)
    rows = read_draws("other.nc", known).rows
    assert isinstance(drawn.joint_samples(), JointSamples)
    assert {*rows.columns} == {*drawn.joint_samples().columns} == {"sigma", "cutting_fraction"}
    np.testing.assert_allclose(rows.columns["sigma"], drawn.samples["sigma"].values.ravel(), rtol=1e-15)
    with pytest.raises(ValueError, match="`uncertain` must leave out `cutting_fraction`"):
        erosion.stream("linearized", p, n=64, uncertain=drawn.joint_samples())


MAP, STREAM = "map impacts.csv sand.toml", "stream sand.toml --v0 'normal(25, 1)' --r 'normal(0.1 mm, 0.01 mm)'"
BAD = [
    (f"{MAP} --uncertain nowhere.nc", "Option `--uncertain`: nowhere.nc: is not there."),
    (f"{MAP} --uncertain tests.csv", "must be left out: each row of the table has its own."),
    (f"{MAP} --uncertain wrong.nc", "wrong.nc: must hold the draws of a posterior, but cannot be read as such."),
    (f"{MAP} --uncertain other-tool.nc", "the draws of a posterior of this program, but holds something else."),
    (f"{MAP} --uncertain post.nc --model rotating", "the parameters of linearized, but Option `--model` is rotating."),
    ("advise sand.toml --uncertain post.nc --model linearized,finnie", "but Option `--model` is finnie."),
    ("stream jet.toml --units inch-pound", "Option `--units` cannot convert the table [stream] of jet.toml, which is"),
    (f"{MAP} --uncertain post.nc --uncertain psi=normal(2,0.1)", "must give psi once, but gives it several times."),
    (f"{MAP} --uncertain post.nc --psi normal(2,0.1)", "must name parameters without another law, but psi has one"),
    (f"{MAP} --uncertain k=2", "Option `--uncertain` must give k a law (normal, "),
    (f"{MAP} --uncertain k", "must be a file (.nc, .csv) or a law such as"),
    (f"{MAP} --uncertain hardness=normal(2,0.1)", "Option `--uncertain` must name one of k, psi"),
    (f"{MAP} --uncertain v0=normal(25,1)", "Option `--v0` must be left out: each row of the table has its own."),
    (f"{MAP} --uncertain k=normal(2,0.1) --draws 1", "Option `--draws` must be a whole number of at least 2"),
    (f"{MAP} --uncertain post.nc -o post.nc", "post.nc: must not be written, because post.nc is read."),
    (f"{MAP} --cutting-fraction 2", "Option `--cutting-fraction` must be above 0 and at most 1"),
    (f"{STREAM} --correlation v0,k=0.5", "must join two parameters with laws of their own, which both"),
    (f"{STREAM} --correlation v0=0.5", "Option `--correlation` must be such as \"v0,r=-0.5\", but is 'v0=0.5'."),
    (f"{STREAM} --correlation v0,r=1.5", "Option `--correlation` must be in (-1, 1), but is 1.5 for v0 and r."),
    (f"{STREAM} --correlation v0,r=much", "Option `--correlation` must be such as"),
    (f"{STREAM} --uncertain k=normal(2,0.1) --correlation v0,k=0.5", "which both vary or are both uncertain"),
    (f"{STREAM} --rows nowhere.csv", "nowhere.csv: cannot be read"),
    (f"{STREAM} --rows speeds.csv", "Option `--rows` must give v0 alone, but v0 has another law, too."),
    ("stream bad.toml", "bad.toml: field `correlation` of [stream] must be a table such as"),
    ("map impacts.csv bad-map.toml", "bad-map.toml: field `v0` of [map] has no meaning here"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "sentence"), BAD)
def test_bad_laws_are_one_line(line: str, sentence: str, shell: Shell) -> None:
    Path("wrong.nc").write_text("psi")
    Path("speeds.csv").write_text("v0 [m/s]\n25\n30\n")
    xr.Dataset({"psi": ("draw", [1.0, 2.0])}).to_netcdf("other-tool.nc", group="posterior", engine="h5netcdf")
    Path("jet.toml").write_text(CASE + '[stream]\nv0 = "normal(25, 1)"\n')
    Path("bad.toml").write_text(CASE + '[stream]\nv0 = "normal(25, 1)"\ncorrelation = 0.5\n')
    Path("bad-map.toml").write_text(CASE + "[map]\nv0 = 30\n")
    assert sentence in shell(line, 2).err


TABLE_1_CASE = (Path(__file__).parents[2] / "examples/table-1.toml").read_text()


@pytest.fixture
def case(written) -> str:
    path = written(
        "case.toml",
        TABLE_1_CASE
        + '\n[sweep]\nalpha = "10deg : 40deg : 4"\nv0 = [2200, "4400 in/s"]\n'
        + '\n[stream]\nn = 1024\nv0 = "lognormal(4400 in/s, 0.1)"\nalpha = "normal(20deg, 2deg)"\n',
    )
    return str(path)


def test_a_case_file_may_hold_a_sweep(case, tmp_path, shell):
    out = tmp_path / "out.nc"
    printed = shell(["sweep", case, "-o", str(out), "--json"]).result
    assert printed["dimensions"] == {"alpha": 4, "v0": 2}
    assert printed["ended_by"] == {"rebound": 8}
    stored = xr.load_dataset(out, engine="h5netcdf")
    assert float(stored.volume.isel(alpha=1, v0=1)) == pytest.approx(1.816436352531e-4 * 0.0254**3, rel=1e-8)
    assert printed["volume_greatest"] * 0.0254**3 == pytest.approx(float(stored.volume.max()), rel=1e-14)
    # The same case serves the other verbs.
    assert erosion.load_case(case).v0 == pytest.approx(111.76)


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
    assert not out.exists()  # refused before anything is computed
    shell([*arguments, "-o", str(out)])
    stored = xr.load_dataset(out, engine="h5netcdf")
    assert dict(stored.sizes) == {"pair": 2}
    assert "v0 = 3937.0078740157483" in stored.attrs["case"]


def test_impacts_that_fail_among_others_are_a_warning(tmp_path, written, shell):
    model = written(
        "steep.py",
        "import erosion, jax.numpy as jnp\n"
        "class F(erosion.models.ForceLaw):\n"
        "  def __call__(self, state, tip, p):\n"
        "    fx = -p.stiffness * tip.depth * jnp.where(p.alpha > 0.5, jnp.nan, 1.0)\n"
        "    return fx, p.k * fx\n"
        "  def typical_ratio(self, p): return p.k\n"
        "model = erosion.models.Linearized(force=F())\n",
    )
    arguments = [
        "sweep",
        "--model",
        str(model),
        "--alpha",
        "0.3 rad, 0.4 rad, 0.7 rad",
        "-o",
        str(tmp_path / "out.nc"),
        "--json",
    ]
    said = shell(arguments)
    assert said.result["ended_by"] == {"rebound": 2, "failed": 1}
    assert said.err == "warning: 1 of 3 impacts could not be computed.\n"


@pytest.mark.parametrize(
    ("absent", "arguments", "message"),
    [
        (
            "zarr",
            ["sweep", "--alpha", "0.3 rad, 0.4 rad", "-o", "x.zarr"],
            "The package zarr is not installed: pip install 'particle-erosion[dask]'.",
        ),
        (
            "distributed",
            ["sweep", "--alpha", "0.3 rad, 0.4 rad", "-o", "x.zarr", "--workers", "2"],
            "The package distributed is not installed: pip install 'particle-erosion[dask]'.",
        ),
        (
            "nicegui",
            ["explore", "--no-browser"],
            "The package nicegui is not installed: pip install 'particle-erosion[explorer]'.",
        ),
        ("nbformat", ["exercise"], "The package nbformat is not installed: pip install 'particle-erosion[classroom]'."),
        (
            "arviz_stats.base.array",
            ["posterior", "{folder}/tests.csv", "{folder}/sand.toml", "--free", "psi", "--draws", "125"],
            "The package arviz_stats is not installed: pip install 'particle-erosion[posterior]'.",
        ),
    ],
)
def test_an_extra_that_is_not_installed_is_named(folder, tmp_path, monkeypatch, shell, absent, arguments, message):
    monkeypatch.chdir(tmp_path)
    for module in [name for name in sys.modules if name.startswith("erosion.explorer")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, absent, None)
    said = shell([word.format(folder=folder) for word in arguments], 2).err
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
