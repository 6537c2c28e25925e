"""Ctrl-C while modules are imported: it waits until they are."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from erosion.interrupts import _LONGEST, between_imports

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
    assert done.returncode in (130, -signal.SIGINT)
