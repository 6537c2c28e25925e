"""Signals while lanes compute: loops that never end, and handlers that compute themselves.

What counts as a user's own code.
"""

import os
import signal
import subprocess
import sys
import sysconfig
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from jax import lax

from erosion.lanes import tapes
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.vector_ir import STOPPED

_ENDLESS = '''
"""A lip whose force is found by a search that never ends."""

import jax
import jax.numpy as jnp
from jax import lax

import erosion


@jax.custom_jvp
def searched(depth):
    """A search for a number that is not there."""
    return lax.while_loop(lambda x: x < jnp.inf, lambda x: -x, depth)


@searched.defjvp
def searched_jvp(primals, tangents):
    return searched(*primals), tangents[0]


class Endless(erosion.models.ForceLaw):
    """A force that never comes."""

    def __call__(self, state, tip, p):
        """Return (F_x, F_y)."""
        depth = searched(tip.depth)
        return -p.stiffness * depth, -p.k * p.stiffness * depth

    def typical_ratio(self, p):
        """k."""
        return p.k


model = erosion.models.Rotating(force=Endless())
'''


def _interrupted(arguments: list[str], folder: Path) -> tuple[int, str]:
    """Exit status and errors of a process that gets Ctrl-C a second after it says that it begins."""
    with subprocess.Popen(
        [sys.executable, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1)
        process.send_signal(signal.SIGINT)
        try:
            errors = process.communicate(timeout=10)[1]  # it takes a tenth of a second
        except subprocess.TimeoutExpired:
            process.kill()
            pytest.fail("Ctrl-C did not end it.")
        return process.returncode, errors


def test_ctrl_c_ends_a_loop_that_never_ends(tmp_path):
    program = """
        import signal
        import numpy as np
        from jax import lax
        from erosion.lanes.lanewise import Lanewise, number
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
        endless = Lanewise(lambda x: lax.while_loop(lambda s: s >= 0, lambda s: s + x, 0.0 * x), (number,))
        print(endless(-1.0), flush=True)
        try:
            endless(np.array([-1.0, 0.0]))
        except KeyboardInterrupt:
            print(endless(-1.0))
            raise SystemExit(7)
    """
    status, errors = _interrupted(["-c", textwrap.dedent(program)], tmp_path)
    assert (status, errors) == (7, "")


@pytest.mark.parametrize("impacts", [1, 5000])
def test_ctrl_c_ends_a_model_that_never_ends(impacts, tmp_path):
    """In one thread, and in several."""
    (tmp_path / "endless.py").write_text(_ENDLESS)
    program = f"""
        import signal
        import sys
        import numpy as np
        import erosion
        from erosion.cli import main
        from erosion.ode import batch
        from erosion.lanes.lanewise import Lanewise
        usual = Lanewise.run
        Lanewise.run = lambda *arguments: (print("begins", flush=True), usual(*arguments))
        batch.threads = lambda: 2
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if {impacts} == 1:
            main(["run", "--model", "endless.py"])
        try:
            erosion.impact("endless.py", erosion.TABLE_1.replace(alpha=np.linspace(0.1, 1, {impacts})))
        except KeyboardInterrupt:
            print("erosion: interrupted", file=sys.stderr)
            sys.exit(130)
    """
    status, errors = _interrupted(["-c", textwrap.dedent(program)], tmp_path)
    assert (status, errors) == (130, "erosion: interrupted\n")


def test_a_function_may_be_called_while_it_runs():
    """As a signal's handler does that comes before the machine code begins."""
    product = Lanewise(lambda x, y: x * y, (number, number))

    class Interrupted(np.ndarray):
        @property
        def ctypes(self):
            assert product(5.0, 7.0) == 35.0
            return super().ctypes

    result = np.empty(3).view(Interrupted)
    product.run([np.array(2.0), np.arange(3.0)], np.arange(3), [result])
    assert np.array_equal(np.asarray(result), [0.0, 2.0, 4.0])


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers")
def test_a_signals_handler_may_compute():
    """While the same function's machine code runs in the same thread."""

    def slow(x, y):
        return lax.fori_loop(0, 3_000_000, lambda i, s: s + y, x)

    function, results = Lanewise(slow, (number, number)), []
    expected = function(1.0, 3.0)
    usual = signal.signal(signal.SIGALRM, lambda *_: results.append(function(0.0, 2.0)[0]))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.005)
        done = function(1.0, 3.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, usual)
    assert done == expected
    assert results == [6_000_000.0]


def assert_stops(function, argument):
    """Assert that a function that writes its tape, and then never ends, is stopped and writes no result.

    Args:
        function: takes a number and a token of tape 0; gives a number and a token.
        argument: with which it never ends.
    """
    compiled, tape = Lanewise(function, (number, number), tapes=1), np.zeros((1, 1))
    stop, results = np.zeros(1, np.int64), [np.full(1, np.nan), np.full(1, np.nan)]
    leaves = [np.array([argument]), np.zeros(())]
    # A daemon: should the code never end, the tests do.
    running = threading.Thread(target=compiled.run, args=(leaves, np.arange(1), results, stop, [tape]), daemon=True)
    running.start()
    end = time.monotonic() + 10.0
    while not tape[0, 0] and time.monotonic() < end:
        time.sleep(1e-3)
    assert tape[0, 0]
    assert running.is_alive()
    stop[0] = 1
    running.join(10.0)
    assert stop[0] == STOPPED
    assert not running.is_alive()
    assert np.all(np.isnan(results))


def test_a_stop_ends_a_loop_that_never_ends():
    def endless(x, token):
        token = tapes.write(0, token, 0, 1.0)
        return lax.while_loop(lambda s: s >= 0, lambda s: s + x, 0.0 * x), token

    assert_stops(endless, 1.0)


_ASK = """
import json, sys
import numpy
from erosion.lanes.digests import is_own
print([is_own(file) for file in (json.__file__, numpy.__file__, sys.argv[1])])
"""


def test_libraries_are_not_the_users_where_python_is_reached_by_a_symbolic_link(tmp_path: Path) -> None:
    """All that they read would be looked at before each call: seconds at the first, and 60 ms at each later one."""
    link = tmp_path / "environment"
    link.symlink_to(sys.prefix, target_is_directory=True)
    python = link / Path(sys.executable).relative_to(sys.prefix)
    done = subprocess.run([python, "-c", _ASK, tmp_path / "mine.py"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["[False,", "False,", "True]"]


def _with_libraries_at(folder: Path, *words: str | Path) -> str:
    folder.symlink_to(sysconfig.get_path("purelib"), target_is_directory=True)
    environment = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    return subprocess.run(
        [sys.executable, "-c", *words], capture_output=True, text=True, check=True, env=environment
    ).stdout


def test_libraries_are_not_the_users_in_a_second_folder_of_packages(tmp_path: Path) -> None:
    """As of `pip install --user`, of Debian's packages, and of a cluster's modules."""
    answers = _with_libraries_at(tmp_path / "site-packages", _ASK, tmp_path / "mine.py")
    assert answers.split() == ["[False,", "False,", "True]"]


_READ = """
import jax.numpy as jnp
from erosion.lanes.digests import CodeSnapshot
CodeSnapshot([jnp.zeros(3)])
"""


def test_arrays_are_read_where_libraries_are_taken_for_the_users(tmp_path: Path) -> None:
    """In a folder of another name they are; JAX's arrays have a slot that cannot be read."""
    _with_libraries_at(tmp_path / "libraries", _READ)
