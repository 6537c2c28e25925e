"""Ctrl-C while modules are imported: it waits until they are."""

import contextlib
import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import pytest

import erosion
from erosion.interrupts import _LONGEST, INTERRUPTED, between_imports, keeping_results, unawaited_threads

SLOW = """
import os, signal, time
os.kill(os.getpid(), signal.SIGINT)
time.sleep(0.1)
COMPLETE = True
"""


@pytest.fixture
def usual():
    """Ctrl-C as Python leaves it; a shell's background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield signal.default_int_handler
    signal.signal(signal.SIGINT, before)


def test_an_import_is_not_interrupted(tmp_path, monkeypatch, usual):
    (tmp_path / "slow_module.py").write_text(SLOW)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        _import_slow_module()
    assert sys.modules.pop("slow_module").COMPLETE
    assert signal.getsignal(signal.SIGINT) is usual


def _import_slow_module():
    with between_imports():
        import slow_module  # noqa: F401  # pyright: ignore[reportMissingImports]

        time.sleep(1)


def test_an_error_that_python_made_of_ctrl_c_is_ctrl_c():
    """As of one in `__set_name__`, while a class is made."""
    with pytest.raises(KeyboardInterrupt), between_imports():
        raise RuntimeError from KeyboardInterrupt()


@pytest.mark.usefixtures("usual")
def test_an_import_that_never_ends_is_interrupted(tmp_path, monkeypatch):
    (tmp_path / "endless_module.py").write_text(SLOW.replace("0.1", "30"))
    monkeypatch.syspath_prepend(tmp_path)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), between_imports():
        import endless_module  # noqa: F401  # pyright: ignore[reportMissingImports]
    assert time.monotonic() - began < _LONGEST + 2


def test_another_handler_and_another_thread_are_left_alone(usual):
    handlers = []

    def look():
        with between_imports():
            handlers.append(signal.getsignal(signal.SIGINT))

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    look()
    signal.signal(signal.SIGINT, usual)
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.SIG_IGN, usual]


@pytest.mark.slow
def test_ctrl_c_while_the_program_starts():
    """It comes while the first module of the command line is imported."""
    program = """
        import os, signal, sys
        signal.signal(signal.SIGINT, signal.default_int_handler)
        class Once:
            def find_spec(self, name, path=None, target=None):
                if name == "cyclopts.core":
                    os.kill(os.getpid(), signal.SIGINT)
        sys.meta_path.insert(0, Once())
        sys.argv[1:] = ["run"]
        import runpy
        runpy.run_module("erosion", run_name="__main__")
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == "erosion: interrupted\n"
    assert done.returncode == INTERRUPTED


PLUG_IN = """
import atexit, ctypes, os, signal, threading
from erosion.models.rigid import Rotating
{}
"""
# What a plug-in does when it is loaded, in place of XLA and of the user.
MOMENTS = {
    # Python's exec notes an interrupt for its own end, also where it is caught.
    "in a text that is executed": 'exec("raise KeyboardInterrupt")',
    "at the end": """
class Ends(threading.Thread):
    def run(self):
        threading.main_thread().join()
        os.kill(os.getpid(), signal.SIGINT)
Ends().start()
model = Rotating()
""",
    "while a thread computes": """
threading.Thread(target=threading.Event().wait).start()
raise KeyboardInterrupt
""",
}


@pytest.mark.slow
@pytest.mark.usefixtures("usual")
@pytest.mark.parametrize("moment", MOMENTS)
def test_ctrl_c_is_one_line_and_status_130(tmp_path, moment):
    plug_in = tmp_path / "interrupted.py"
    plug_in.write_text(PLUG_IN.format(MOMENTS[moment]))
    command = [sys.executable, "-m", "erosion", "run", "--model", str(plug_in)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.stderr == "erosion: interrupted\n"
    assert done.returncode == INTERRUPTED


@pytest.mark.usefixtures("usual")
@pytest.mark.parametrize("keeps", [False, True])
def test_a_library_that_heeds_no_ctrl_c_is_ended_unless_results_are_kept(monkeypatch, keeps):
    ended = threading.Event()
    monkeypatch.setattr("erosion.interrupts.stop_at_once", ended.set)

    def compute():
        with between_imports(), keeping_results() if keeps else contextlib.nullcontext():
            threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
            began = time.monotonic()
            while time.monotonic() - began < 2 * _LONGEST:
                # Some seconds without Python's lock, as XLA compiles.
                hashlib.pbkdf2_hmac("sha256", b"", b"", 10_000_000)

    with pytest.raises(KeyboardInterrupt):
        compute()
    assert ended.is_set() is not keeps


def test_few_modules_come_before_ctrl_c_is_heeded():
    program = f"""
        import sys
        sys.path.insert(0, {str(Path(erosion.__file__).parents[1])!r})
        import erosion.__main__
        print({{"ast", "importlib.resources", "typing", "concurrent.futures"}} & {{*sys.modules}})
    """
    # Without `site`, which imports what it likes.
    done = subprocess.run(
        [sys.executable, "-S", "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "set()\n"


def test_nobody_waits_for_threads_after_an_error():
    goes_on = threading.Event()
    later = []

    def compute():
        with unawaited_threads(1) as pool:
            pool.submit(goes_on.wait, 20)
            later.append(pool.submit(int))
            raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        compute()
    assert time.monotonic() - began < 10
    assert later[0].cancelled()
    goes_on.set()
