"""Programs whose trace is kept between processes."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest

import erosion
from erosion import flow, programs
from erosion.compiler import for_few_runs
from erosion.models import Linearized
from erosion.parameters import TABLE_1
from erosion.programs import Program

P = TABLE_1.replace(alpha=0.5)


@pytest.fixture
def traced(monkeypatch, tmp_path):
    """Keeps programs in a folder of its own, and counts the functions that are traced to be kept."""
    names = []
    export = jax.export.export

    def counted(function):
        names.append(function)
        return export(function)

    monkeypatch.setattr(Program, "folder", tmp_path)
    monkeypatch.setattr(jax.export, "export", counted)
    return names


_FUNCTION = vars(flow.begin)["__wrapped__"]


def _begin() -> Program:
    """As another process has it: nothing in memory."""
    return Program(_FUNCTION, for_few_runs, lambda: _FUNCTION)


def _numbers(result):
    return [np.asarray(leaf).tolist() for leaf in jax.tree.leaves(result)]


def test_another_process_does_not_trace_again(traced, tmp_path):
    model = erosion.load_model("rotating")
    first, again = (_numbers(_begin()(model, P)) for _ in range(2))
    assert first == again == _numbers(jax.jit(_FUNCTION)(model, P))
    assert len(traced) == len(list(tmp_path.iterdir())) == 1


def test_in_one_process_a_program_is_made_once_for_any_numbers(traced, tmp_path):
    begin = _begin()
    found = [_numbers(begin(erosion.load_model("rotating"), P.replace(alpha=angle))) for angle in (0.2, 0.4)]
    assert found[0] != found[1]
    assert len(traced) == len(list(tmp_path.iterdir())) == 1


def test_other_models_and_shapes_are_other_programs(traced, tmp_path):
    begin = _begin()
    for name in ("rotating", "rotating-full-torque", "rotating-tan-alpha", "linearized", "tan-alpha"):
        begin(erosion.load_model(name), P)
    assert len(traced) == len(list(tmp_path.iterdir())) == 5


class _PlugIn(Linearized):
    """Of a module that is not the package's: what its code calls may change at any time."""


def test_what_is_not_the_packages_own_is_not_kept(traced, tmp_path):
    assert _numbers(_begin()(_PlugIn(), P)) == _numbers(_begin()(Linearized(), P))
    assert len(traced) == len(list(tmp_path.iterdir())) == 1


def test_a_function_made_in_a_function_has_no_name():
    def local() -> None:
        pass

    for thing in (local, lambda: None, np.zeros(2), test_other_models_and_shapes_are_other_programs):
        with pytest.raises(programs._UnknownSourceError):
            programs._named((1.0, thing))


def test_a_damaged_file_is_made_again(traced, tmp_path):
    model = erosion.load_model("rotating")
    whole = _numbers(_begin()(model, P))
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    for damaged in (b"", content[:-100], content[:100] + b"?" + content[101:]):
        path.write_bytes(damaged)
        assert _numbers(_begin()(model, P)) == whole
        assert programs._read(path) is not None
    assert len(traced) == 4


def test_a_folder_that_cannot_be_written_is_no_reason_not_to_compute(traced, monkeypatch, tmp_path):
    monkeypatch.setattr(Program, "folder", tmp_path / "not there")
    assert _numbers(_begin()(erosion.load_model("rotating"), P))
    assert len(traced) == 1


def test_other_source_is_another_program(traced, monkeypatch, tmp_path):
    _begin()(erosion.load_model("rotating"), P)
    monkeypatch.setattr(programs, "_sources", lambda: "changed")
    _begin()(erosion.load_model("rotating"), P)
    assert len(traced) == len(list(tmp_path.iterdir())) == 2


def test_what_calls_back_into_python_is_not_kept(traced, monkeypatch, tmp_path):
    def says(model, p):
        jax.debug.print("{}", p.alpha)
        return p.alpha * 2

    says.__module__, says.__qualname__ = "erosion.flow", "says"
    assert float(Program(says, for_few_runs, lambda: says)(erosion.load_model("rotating"), P)) == 1.0
    assert not list(tmp_path.iterdir())


def test_the_command_line_says_the_same_at_its_second_start(tmp_path):
    env = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    env["XDG_CACHE_HOME"] = str(tmp_path)

    def said() -> str:
        command = [sys.executable, "-m", "erosion", "run", "--model", "rotating", "--alpha", "25deg", "--json"]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=env).stdout

    first = said()
    kept = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "erosion" / "traced").iterdir()}
    assert kept
    assert said() == first
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "erosion" / "traced").iterdir()} == kept


def test_functions_are_compiled_once():
    traced = []

    @programs.seldom_run
    def double(x):
        traced.append(x)
        return 2.0 * x

    assert [float(double(x)) for x in (np.float64(1.0), np.float64(1.5))] == [2.0, 3.0]
    assert len(traced) == 1
