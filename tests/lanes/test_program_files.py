"""Programs that an earlier process left on disk."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from erosion import ode
from erosion.lanes import lanewise, machine, program_files
from erosion.lanes.engines import compile_lanes
from erosion.lanes.lanewise import number
from erosion.lanes.program_files import CACHE, ProgramFile
from erosion.ode import step_control

compile_module = machine.compiled

X = np.linspace(0.1, 3.0, 100)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path / "programs"))
    return tmp_path / "programs"


@pytest.fixture
def traces(monkeypatch):
    """How many programs are traced and compiled from now on."""
    traced = []

    def noted(*arguments, **options):
        traced.append(1)
        return flatten(*arguments, **options)

    flatten = lanewise.flatten
    monkeypatch.setattr(lanewise, "flatten", noted)
    return traced


def wave(x, y):
    return {"sine": jnp.sin(x) * y, "both": (x + y, jnp.exp(-y))}


def compiled(what="wave"):
    return compile_lanes(wave, (number, number), what=what)


def test_a_program_is_read_with_the_same_bits(traces):
    first, second = compiled()(X, 0.7), compiled()(X, 0.7)
    assert len(traces) == 1
    assert first["sine"].tobytes() == second["sine"].tobytes()
    assert first["both"][1].tobytes() == second["both"][1].tobytes()


def test_other_programs_have_other_files(traces, folder):
    compiled(), compiled("another wave")
    assert len(traces) == len(list(folder.iterdir())) == 2


def test_a_program_without_a_name_is_not_kept(folder):
    compile_lanes(wave, (number, number))
    assert not folder.exists()


@pytest.mark.parametrize("changed", ["_PACKAGE", "this_machine"])
def test_other_code_and_another_processor_need_other_programs(changed, traces, monkeypatch, tmp_path):
    compiled()
    others = {"_PACKAGE": tmp_path, "this_machine": lambda: machine.Processor("another", "")}
    monkeypatch.setattr(program_files, changed, others[changed])
    program_files._surroundings.cache_clear()
    try:
        compiled()
    finally:
        program_files._surroundings.cache_clear()
    assert len(traces) == 2


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: b"", lambda content: content[::-1]])
def test_a_damaged_file_is_made_anew(damage, traces, folder):
    compiled()
    (path,) = folder.iterdir()
    path.write_bytes(damage(path.read_bytes()))
    np.testing.assert_array_equal(compiled()(X, 1.0)["sine"], compiled()(X, 1.0)["sine"])
    assert len(traces) == 2


def test_a_folder_that_cannot_be_written_is_no_error(traces, monkeypatch):
    monkeypatch.setenv(CACHE, "/dev/null/nowhere")
    compiled(), compiled()
    assert len(traces) == 2


def test_an_empty_variable_keeps_none(traces, monkeypatch, folder):
    monkeypatch.setenv(CACHE, "")
    compiled(), compiled()
    assert len(traces) == 2
    assert not folder.exists()


def test_careful_code_takes_the_place_of_quick_code(traces):
    program = compiled()
    program._shared.code._cost = 0.0
    quick, careful = program(X, 0.5), program(X, 0.5)
    stored = ProgramFile("wave").read()
    assert stored is not None
    assert (stored.made.level, stored.text) == (machine._CAREFUL, "")
    assert quick["sine"].tobytes() == careful["sine"].tobytes() == compiled()(X, 0.5)["sine"].tobytes()
    assert len(traces) == 1


def test_the_oldest_files_make_room(monkeypatch, folder):
    monkeypatch.setattr(program_files, "_MOST", 4)
    folder.mkdir()
    for i in range(10):
        (folder / f"{i}.txt").write_text("the user's")
    for i in range(5):
        compiled(f"wave {i}")
    assert ProgramFile("wave 0").read() is None
    assert ProgramFile("wave 4").read() is not None
    assert len(list(folder.glob("*.txt"))) == 10


def test_code_that_was_edited_since_the_process_started_is_not_kept(monkeypatch, folder):
    monkeypatch.setattr(program_files, "_STARTED", 0.0)
    program_files._surroundings.cache_clear()
    try:
        compiled()
    finally:
        program_files._surroundings.cache_clear()
    assert not folder.exists()


def test_a_constant_or_a_function_that_was_replaced_makes_another_program(traces, monkeypatch):
    compiled()
    with monkeypatch.context() as patch:
        patch.setattr(step_control, "_SAFETY", 0.4)
        compiled()
    with monkeypatch.context() as patch:
        patch.setattr(machine, "compiled", lambda *given: compile_module(*given))
        compiled()
    compiled()
    assert len(traces) == 3


def test_a_function_of_large_arrays_is_not_kept(folder):
    def read(x, table):
        return table[x.astype(int)]

    compile_lanes(read, (number, jax.ShapeDtypeStruct((5000,), float)), what="table")
    assert not folder.exists()


def test_a_folder_may_be_in_the_home(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv(CACHE, "~/kept")
    compiled()
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_problem_that_calls_python_is_not_kept(folder):
    def rate(t, y, args):
        return jax.pure_callback(lambda u: -u, jax.ShapeDtypeStruct((), float), y)

    with pytest.raises(ValueError, match="callback"):
        ode.solve(ode.Problem(1.0, rate), t1=1.0)
    assert not folder.exists()


OF_A_MODEL = """
import erosion
hits = erosion.impact("rotating", erosion.TABLE_1, derivatives=2)
print(hits.to_dict())
"""

OF_A_PROBLEM = """
import jax.numpy as jnp
from erosion import ode

pendulum = ode.Problem(
    {"x": 1.0, "v": 0.0},
    lambda t, y, args: {"x": y["v"], "v": -args["k"] * jnp.sin(y["x"])},
    events={"through": ode.Event(lambda t, y, args: y["x"], direction=-1)},
)
end = ode.solve(pendulum, {"k": 2.0}, t1=10.0, wrt="k", gradient=True)
print(float(end.t).hex(), float(end.along("k").t).hex(), float(end.gradient(t=1.0)["k"]).hex())
"""

NO_COMPILER = """
import llvmlite.binding
llvmlite.binding.TargetMachine.emit_object = None
"""


@pytest.mark.parametrize("script", [OF_A_MODEL, OF_A_PROBLEM], ids=["model", "problem"])
def test_a_second_process_compiles_nothing(script):
    def said(script):
        return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout

    assert said(script) == said(NO_COMPILER + script)
