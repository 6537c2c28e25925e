"""The text of a plug-in that runs is the text on the disk, once for a verb, whatever is cached and whoever edits it."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.explorer.computed import Answers
from erosion.explorer.state import PageCase
from erosion.fits import Measurements
from erosion.models import load_model, model_digest, model_source
from erosion.sweeps.grid import make_grid
from erosion.sweeps.sweep import compute_block, prepare_sweep
from tests.documents import Shell, Written
from tests.fits.problems import ranked

P = erosion.TABLE_1
TEXT = """
import erosion
class Ratio(erosion.models.ForceLaw):
    '''A constant ratio.'''
    def __call__(self, state, tip, p):
        {first}
        horizontal = -p.stiffness * tip.depth
        return horizontal, {factor} * p.k * horizontal
    def typical_ratio(self, p):
        return p.k
model = erosion.models.Linearized(force=Ratio())
"""


def text(factor: str = "1.0", first: str = "pass") -> str:
    return TEXT.format(factor=factor, first=first)


def volume(path: Path) -> float:
    return float(erosion.impact(path, P).volume)


@pytest.fixture
def bytecode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python keeps what it compiles, as it does for users."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)


@pytest.mark.usefixtures("bytecode")
def test_a_text_of_the_same_length_and_time_is_the_one_that_runs(tmp_path: Path, written: Written) -> None:
    path = written("mine.py", text("1.0"))
    os.utime(path, (1e9, 1e9))
    usual = volume(path)
    path.write_text(text("2.0"))
    os.utime(path, (1e9, 1e9))  # rsync -t keeps it
    expected = float(erosion.impact("linearized", P.replace(k=2 * P.k)).volume)
    assert volume(path) == pytest.approx(expected, rel=1e-9, abs=0)
    assert volume(path) != usual
    assert [file.name for file in tmp_path.iterdir()] == ["mine.py"]


def test_files_with_nearly_one_name_have_a_module_each(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a-b.py", "a_b.py", "a b.py")]
    for i, path in enumerate(paths):
        path.write_text(text(f"{i + 1}.0"))
    models = [erosion.load_model(path) for path in paths]
    modules = [type(model.force).__module__ for model in models]  # pyrefly: ignore
    assert len(set(modules)) == 3
    assert all(vars(sys.modules[module])["model"] is model for module, model in zip(modules, models, strict=True))


def test_a_module_beside_a_plug_in_that_python_does_not_find_is_told_how(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import a_helper_of_mine\n" + text())
    with pytest.raises(erosion.models.ModelError, match=r"No module named 'a_helper_of_mine'\.$"):
        erosion.load_model(tmp_path / "mine.py")
    (tmp_path / "a_helper_of_mine.py").write_text("")
    with pytest.raises(erosion.models.ModelError, match="it lies beside the file: add that folder to PYTHONPATH"):
        erosion.load_model(tmp_path / "mine.py")


def test_a_plug_in_behind_a_link_finds_what_lies_beside_the_link(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "real.py").write_text(
        "from pathlib import Path\n" + text("float(Path(__file__).with_name('k').read_text())")
    )
    (tmp_path / "mine.py").symlink_to(tmp_path / "far" / "real.py")
    (tmp_path / "k").write_text("2.0")
    monkeypatch.chdir(tmp_path)
    expected = float(erosion.impact("linearized", P.replace(k=2 * P.k)).volume)
    assert volume(Path("mine.py")) == pytest.approx(expected, rel=1e-9, abs=0)
    swept = erosion.sweep("mine.py", P, alpha=[float(P.alpha)])
    assert float(swept.volume[0]) == pytest.approx(expected, rel=1e-9, abs=0)


def test_a_model_is_digested_as_it_was_when_it_was_loaded(written: Written) -> None:
    path = written("mine.py", text("1.0"))
    first = erosion.load_model(path)
    before = model_digest(first)
    path.write_text(text("2.0"))
    second = erosion.load_model(path)
    assert model_digest(first) == before
    assert model_digest(second) != before
    path.unlink()
    assert model_digest(first) == before


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_an_edit_while_a_sweep_runs_changes_nothing_of_it(tmp_path: Path, written: Written, suffix: str) -> None:
    path = written("mine.py", text("1.0"))
    axes: dict[str, Any] = {"alpha": np.linspace(0.1, 1.0, 20_000)}
    whole = erosion.sweep(path, P, **axes)

    def edit(work: str, done: int, total: int) -> None:
        path.write_text(text("2.0"))

    chunks: dict[str, Any] = {"chunks": {"alpha": 10_000}} if suffix == "zarr" else {}
    path_of_store = tmp_path / f"out.{suffix}"
    stored = erosion.sweep(path, P, store=path_of_store, progress=edit, **chunks, **axes)
    np.testing.assert_array_equal(stored.volume, whole.volume)
    with pytest.raises(ValueError, match="another models"):
        erosion.sweep(path, P, store=path_of_store, **chunks, **axes)


# Its own text changes as soon as it is traced.
EDITED = text(first="from pathlib import Path; Path(__file__).write_text(TWICE)") + f"TWICE = {text('2.0')!r}"
ANGLES = np.deg2rad([15.0, 20.0, 30.0, 50.0])
MEASURED = Measurements(
    ANGLES, np.array([1.4, 1.8, 2.1, 1.4]) * 1.6e-9, "volume", None, None, None, shown_in="inch-pound", source="x"
)


def answers(path: Path) -> list[Any]:
    """What the explorer computes of a model that it offers."""
    of = Answers({"mine": erosion.load_model(path)})
    return [of(kind, "mine", PageCase.of(P)).volume for kind in ("point", "curve", "best")]


def fitted(path: Path) -> list[Any]:
    """ψ of both models that are fitted, the older text's being the better one."""
    return [fit.p.psi for fit in ranked(["finnie", path], P, MEASURED, ["psi"], starts=2).fits]


VERBS: dict[str, Callable[[Path], list[Any]]] = {
    "alpha_max": lambda path: [(best := erosion.alpha_max(path, P)).volume, best.sensitivities["k"]],
    "simulate": lambda path: [erosion.simulate(path, P).volume],
    "stream": lambda path: [erosion.stream(path, P, n=1024, alpha=stats.norm(0.35, 0.05)).mean_volume.value],
    "rank": fitted,
    "explorer": answers,
}


@pytest.mark.parametrize("verb", VERBS)
def test_an_edit_while_a_verb_runs_changes_nothing_of_it(written: Written, verb: str) -> None:
    path = written("mine.py", text("1.0"))
    usual = VERBS[verb](path)
    path.write_text(EDITED)
    for value, as_usual in zip(VERBS[verb](path), usual, strict=True):
        np.testing.assert_array_equal(value, as_usual)
    assert path.read_text() == text("2.0")


def test_a_stream_of_a_model_that_was_edited_meanwhile_is_known_by_the_older_text(tmp_path: Path) -> None:
    path, store = tmp_path / "mine.py", tmp_path / "out.nc"
    path.write_text(EDITED)
    laws: dict[str, Any] = {"alpha": stats.norm(0.35, 0.05), "n": 1024, "best_angle": False, "store": store}
    erosion.stream(path, P, **laws)
    assert path.read_text() == text("2.0")
    with pytest.raises(ValueError, match="another"):
        erosion.stream(path, P, **laws)
    path.write_text(EDITED)
    erosion.stream(path, P, **laws)


def test_a_worker_that_finds_another_text_stops_the_sweep(
    tmp_path: Path, written: Written, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written("mine.py", text("1.0"))
    grid = make_grid(str(path), P, {"alpha": np.linspace(0.1, 1.0, 10)})
    store = tmp_path / "out.zarr"
    job = prepare_sweep(grid, store=store)
    (region,) = job.store.missing()
    from erosion.impacts.dataset_files import code_version

    path.write_text(text("2.0"))
    monkeypatch.setattr("erosion.sweeps.grid._known", {})  # as in another process
    with pytest.raises(RuntimeError, match=r"mine.py: is another model than that which the sweep was begun with\."):
        compute_block(grid, store, region, code_version())
    with pytest.raises(RuntimeError, match=r"A worker has erosion .*, but the sweep was begun with erosion 9\."):
        compute_block(grid, store, region, "erosion 9")
    assert job.store.missing() == [region]


LEAVES = {
    "import": "import sys; sys.exit(0)",
    "method": text(first="import sys; sys.exit(0)"),
    "constructor": "import sys, erosion\nclass M(erosion.models.Linearized):\n  def __init__(self): sys.exit(0)\n",
    "built-in exit": text(first="exit(0)"),
    "raised": text(first="raise SystemExit"),
}


@pytest.mark.parametrize("name", LEAVES)
def test_a_plug_in_that_ends_the_program_is_an_error(written: Written, name: str, shell: Shell) -> None:
    path = written("mine.py", LEAVES[name])
    with pytest.raises(erosion.ModelError, match=r"mine\.py: .*SystemExit"):
        erosion.load_model(path)
    for words, status in ((["verify"], 2), (["models", "--path"], 1), (["run", "--model"], 2)):
        said = shell([*words, str(path)], status).err
        assert said.startswith("erosion: ")
        assert said.count("\n") == 1


def test_the_source_of_a_model_is_found_among_files_of_the_same_parts(tmp_path):
    files = []
    for name, ratio in (("first", 1.0), ("second", 2.0)):
        files.append(tmp_path / f"{name}.py")
        files[-1].write_text(
            "from erosion.models import Rotating, TanAlpha\nfrom erosion.models import ProportionalDeformationWear\n"
            f"model = Rotating(force=TanAlpha(), deformation=ProportionalDeformationWear({ratio}))\n"
        )
    models = [load_model(file) for file in files]
    assert model_source(models[1]) == str(files[1])
    assert model_source(load_model("rotating").replace()) == "rotating"
    assert model_source(load_model("dnv:duplex")) == "dnv:duplex"


def test_a_model_that_only_seems_equal_has_no_source(written):
    file = written(
        "typed.py",
        "import equinox as eqx\nfrom erosion.models import ForceLaw, Linearized\n\n"
        "class Typed(ForceLaw):\n    n: object = eqx.field(static=True)\n\n"
        "    def __call__(self, state, tip, p):\n"
        "        force = -p.stiffness * tip.depth * (1.0 if isinstance(self.n, int) else 0.5)\n"
        "        return force, p.k * force\n\n"
        "    def typical_ratio(self, p):\n        return p.k\n\n"
        "model = Linearized(force=Typed(2))\n",
    )
    model = load_model(file)
    kind: Any = type(model)
    law = type(vars(model)["force"])
    assert model_source(model) == model_source(kind(law(2))) == str(file)
    assert model_source(kind(law(2.0))) is None  # 2 == 2.0, but the law computes another force
