"""Programs whose trace is kept between processes."""

import enum
import functools
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

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
    sources = programs._sources
    yield names
    sources.cache_clear()


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


def test_other_models_are_other_programs(traced, tmp_path):
    begin = _begin()
    for name in ("rotating", "rotating-full-torque", "rotating-tan-alpha", "linearized", "tan-alpha"):
        begin(erosion.load_model(name), P)
    assert len(traced) == len(list(tmp_path.iterdir())) == 5


class _PlugIn(Linearized):
    """Of a module that is not the package's: what its code calls may change at any time."""


def test_what_is_not_the_packages_own_is_not_kept(traced, tmp_path):
    assert _numbers(_begin()(_PlugIn(), P)) == _numbers(_begin()(Linearized(), P))
    assert len(traced) == len(list(tmp_path.iterdir())) == 1


def _of_the_package(monkeypatch, function):
    """A function as if it stood in one of the package's modules."""
    function.__module__, function.__qualname__ = "erosion.flow", function.__name__
    monkeypatch.setattr(flow, function.__name__, function, raising=False)
    return function


def test_other_shapes_kinds_names_and_fixed_numbers_are_other_programs(traced, monkeypatch, tmp_path):
    def multiplied(by_name, times, more):
        return {name: times * value for name, value in by_name.items()}

    _of_the_package(monkeypatch, multiplied)
    ones = np.ones(2)
    given = [
        *(({"a": array}, 2, 1.0) for array in (ones, np.ones(3), np.ones(2, int))),
        ({"b": ones}, 2, 1.0),
        ({"a": ones}, 3, 1.0),
        *(({"a": ones}, 2, more) for more in (True, 1, 1.5, (1.0,), [1.0], None, "1.0")),
    ]
    for arguments in given:
        # As another process has it.
        found = Program(multiplied, for_few_runs, lambda: multiplied)(*arguments)
        ((name, value),) = arguments[0].items()
        assert np.array_equal(found[name], arguments[1] * value)
    assert len(traced) == len(list(tmp_path.iterdir())) == len(given)


class _Number(enum.IntEnum):
    ONE = 1


class _Pair(NamedTuple):
    first: float


def test_what_is_not_the_packages_own_has_no_name(monkeypatch):
    def local() -> None:
        pass

    @functools.wraps(flow.layout)
    def as_if() -> None:
        pass

    scope: dict = {}
    exec("class Made: pass\ndef made(): pass", scope)
    things = [local, as_if, lambda: None, np.zeros(2), _PlugIn, _Number.ONE, scope["Made"], scope["made"], _Pair(1.0)]
    for thing in things:
        with pytest.raises(programs._UnknownSourceError):
            programs._named((1.0, thing))
    monkeypatch.setattr(flow, "layout", local)
    with pytest.raises(programs._UnknownSourceError):
        programs._named(as_if)


def test_source_that_changed_since_it_was_imported_is_not_what_is_traced(traced, monkeypatch, tmp_path):
    model = erosion.load_model("rotating")
    programs._sources.cache_clear()
    monkeypatch.setattr(programs, "IMPORTED", Path(flow.__file__).stat().st_mtime_ns)
    assert _numbers(_begin()(model, P)) == _numbers(jax.jit(_FUNCTION)(model, P))
    assert not traced
    assert not list(tmp_path.iterdir())


def test_two_threads_make_a_program_once(traced, tmp_path):
    begin, together = _begin(), threading.Barrier(4)
    model = erosion.load_model("rotating")

    def ask(_: int):
        together.wait()
        return _numbers(begin(model, P))

    with ThreadPoolExecutor(4) as pool:
        first, *others = pool.map(ask, range(4))
    assert all(other == first for other in others)
    assert len(traced) == 1


def test_a_damaged_file_is_made_again(traced, tmp_path):
    model = erosion.load_model("rotating")
    whole = _numbers(_begin()(model, P))
    (path,) = tmp_path.iterdir()
    content = path.read_bytes()
    for damaged in (b"", content[:-100], content[:100] + bytes([content[100] ^ 1]) + content[101:]):
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

    _of_the_package(monkeypatch, says)
    assert float(Program(says, for_few_runs, lambda: says)(erosion.load_model("rotating"), P)) == 1.0
    assert not list(tmp_path.iterdir())


def test_the_command_line_says_the_same_at_its_second_start_without_tracing(tmp_path):
    env = {name: value for name, value in os.environ.items()
           if name not in ("JAX_COMPILATION_CACHE_DIR", "EQX_ON_ERROR")}  # fmt: skip
    env["XDG_CACHE_HOME"] = str(tmp_path)

    def said(before: str = "") -> str:
        program = f"{before}from erosion.cli import main; main()"
        command = [sys.executable, "-c", program, "run", "--model", "rotating", "--alpha", "25deg", "--json"]
        return subprocess.run(command, capture_output=True, text=True, check=True, env=env).stdout

    first = said()
    kept = {path.name.partition("-")[0] for path in (tmp_path / "erosion" / "traced").iterdir()}
    assert kept == {"begin", "solve", "interpolate", "look", "event", "chunk"}
    assert said("import jax.export; jax.export.export = None; ") == first


def test_functions_are_compiled_once():
    traced = []

    @programs.seldom_run
    def double(x):
        traced.append(x)
        return 2.0 * x

    assert [float(double(x)) for x in (np.float64(1.0), np.float64(1.5))] == [2.0, 3.0]
    assert len(traced) == 1
