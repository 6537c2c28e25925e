"""`--target` beside a correlation, in every verb: its member is chosen and named, or the two contradict each other."""

from pathlib import Path

import pytest

from tests.documents import Shell

SI = ["--units", "si", "--v0", "30 m/s"]
VERBS = {
    "run": ["run", *SI],
    "optimum": ["optimum", *SI],
    "compare": ["compare", *SI],
    "sweep": ["sweep", "--units", "si", "--v0", "20 m/s, 30 m/s", "-o", "out.nc"],
    "stream": ["stream", "--units", "si", "--v0", "normal(30 m/s, 1 m/s)", "--n", "256", "--no-best-angle"],
    "map": ["map", "impacts.csv"],
    "calibrate": ["calibrate", "tests.csv", "--free", "density", "--starts", "2", *SI],
    "export": ["export", "--fluent", "angles.txt", *SI],
    "advise": ["advise", *SI],
}
IMPACTS = "count,diameter [um],density [kg/m^3],speed [m/s],angle [deg]\n1,200,2650,30,20\n1,200,2650,30,40\n"
TESTS = "angle [deg],volume [mm^3/impact]\n10,2e-5\n30,3e-5\n60,2.5e-5\n"


@pytest.fixture(autouse=True)
def in_folder(in_folder: Path) -> Path:
    (in_folder / "impacts.csv").write_text(IMPACTS)
    (in_folder / "tests.csv").write_text(TESTS)
    return in_folder


@pytest.mark.parametrize("verb", VERBS)
def test_the_member_for_the_target_is_chosen_and_named_or_the_target_is_refused(
    verb: str, shell: Shell, in_folder: Path
) -> None:
    words = VERBS[verb]
    document = shell([*words, "--model", "dnv", "--target", "aluminium 6061", "--json"]).document
    assert document["model"]["name"] == "dnv:aluminium"
    # A fit has a density of its own.
    assert verb == "calibrate" or document["model"]["own_parameters"]["density"]["value"] == 2700.0
    (in_folder / "out.nc").unlink(missing_ok=True)
    for model, target, known in (
        ("dnv", "titanium Ti-6Al-4V", "it has carbon-steel, duplex, "),
        ("dnv:duplex", "aluminium 6061", "dnv:aluminium is made for that"),
        ("ecrc", "aluminium 6061", "it is made for sand on carbon steel and nickel alloy"),
    ):
        error = shell([*words, "--model", model, "--target", target], 2).err
        assert error.startswith(f"erosion: Model '{model}': is not made for the target {target}; ")
        assert known in error
        assert error.count("\n") == 1


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in ("calibrate", "compare")])
def test_a_density_that_is_set_beside_a_target_is_blamed(verb: str, shell: Shell) -> None:
    words = [*VERBS[verb], "--model", "dnv", "--target", "aluminium 6061"]
    error = shell([*words, "--set", "density=7800"], 2).err
    assert error.startswith("erosion: Parameter `density` of dnv:aluminium is set to 7800 kg/m³ (`--set`")
    assert "`--target` is 2700 kg/m³" in error
    assert error.count("\n") == 1
    # Another density is not set: the option alone is wrong.
    if verb != "export":
        assert shell([*words, "--density", "7.8 g/cm^3"], 2).err.startswith(
            "erosion: Option `--density` must be that of the target"
        )


def test_a_case_files_target_and_model_are_decided_in_the_same_way(shell: Shell) -> None:
    case = 'particle = "garnet 0.3 mm"\ntarget = "{}"\nmodel = "{}"\nk = 2\nv0 = "30 m/s"\nalpha = "20 deg"\n'
    Path("case.toml").write_text(case.format("stainless steel 316", "oka"))
    model = shell("run case.toml --json").document["model"]
    assert model["name"] == "oka:stainless-steel"
    assert model["own_parameters"]["particle_density"]["value"] == 4190.0
    # Numbers that are set win over those of names.
    assert (
        shell("run case.toml --set particle_density=2650 --json").document["model"]["own_parameters"][
            "particle_density"
        ]["value"]
        == 2650.0
    )
    Path("case.toml").write_text(case.format("stainless steel 316", "dnv:duplex"))
    assert "Model 'dnv:duplex': is not made for the target stainless steel 316" in shell("run case.toml", 2).err


def test_a_comparison_and_a_sweep_of_several_models_name_the_members(shell: Shell) -> None:
    names = ["linearized", "dnv:aluminium", "finnie-cfd"]
    words = ["--model", "linearized,dnv,finnie-cfd", "--target", "aluminium 6061", "--units", "si"]
    assert [
        line["model"] for line in shell(["compare", *words, "-o", "curves.csv", "--json"]).document["result"]["models"]
    ] == names
    assert "dnv:aluminium" in Path("curves.csv").read_text()
    models = shell(["sweep", *words, "--v0", "20 m/s, 30 m/s", "-o", "sweep.csv", "--json"]).document["model"]
    assert [model["name"] for model in models] == names
    assert models[2]["own_parameters"]["flow_stress"]["value"] == pytest.approx(107 * 9.80665e6)


def test_the_density_of_another_metal_is_refused_beside_a_correlation(shell: Shell) -> None:
    for verb in ("run", "compare", "map"):
        assert (
            "Option `--density` must be that of the target of dnv, 7800 kg/m³"
            in shell([*VERBS[verb], "--model", "dnv", "--density", "2.7 g/cm^3"], 2).err
        )
        shell([*VERBS[verb], "--model", "dnv:aluminium", "--density", "2.71 g/cm^3"])


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb != "export"])
def test_the_density_of_another_metal_is_refused_beside_a_target(verb: str, shell: Shell) -> None:
    words = [*VERBS[verb], "--model", "linearized", "--target", "aluminium 6061"]
    error = shell([*words, "--density", "7.8 g/cm^3"], 2).err
    assert "Option `--density` must be that of the target aluminium 6061, 2700 kg/m³, but is 7800 kg/m³" in error
    assert error.count("\n") == 1
