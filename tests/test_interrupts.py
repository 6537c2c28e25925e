"""Signals that ask a process to end: at once, but for results that are kept and files that are written."""

import os
import shlex
import signal
import subprocess
import sys
import threading
import time

import pytest

from erosion.interrupts import INTERRUPTED, held_off, unawaited_threads


@pytest.fixture(autouse=True)
def usual():
    """Ctrl-C as Python leaves it; a shell's background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(("presses", "reached"), [([], 3), ([1], 3), ([0, 1], 1)])
def test_the_first_signal_waits_and_the_second_counts_at_once(presses, reached):
    seen = []

    def work():
        with held_off():
            for place in range(3):
                if place in presses:
                    os.kill(os.getpid(), signal.SIGINT)
                seen.append(place)

    if presses:
        with pytest.raises(KeyboardInterrupt):
            work()
    else:
        work()
    assert len(seen) == reached


def test_work_stops_where_it_may_also_after_a_file_that_was_being_written(capfd):
    seen = []

    def work():
        with held_off("stops soon") as stop:
            for place in range(3):
                with held_off():
                    os.kill(os.getpid(), signal.SIGTERM)
                seen.append(place)
                stop()

    with pytest.raises(KeyboardInterrupt):
        work()
    assert seen == [0]
    assert capfd.readouterr().err == "stops soon\n"
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_second_signal_counts_at_once_also_while_a_file_is_written():
    seen = []

    def work():
        with held_off(), held_off():
            for place in range(3):
                os.kill(os.getpid(), signal.SIGINT)
                seen.append(place)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert seen == [0]


def test_a_signal_counts_also_where_the_work_fails():
    def work():
        with held_off():
            os.kill(os.getpid(), signal.SIGINT)
            raise OSError

    with pytest.raises(KeyboardInterrupt):
        work()


def test_an_import_is_not_interrupted(tmp_path, monkeypatch):
    (tmp_path / "slow_module.py").write_text("import os\nos.kill(os.getpid(), 2)\nCOMPLETE = True\n")
    monkeypatch.syspath_prepend(tmp_path)

    def work():
        with held_off():
            import slow_module  # noqa: F401  # pyrefly: ignore

    with pytest.raises(KeyboardInterrupt):
        work()
    assert sys.modules.pop("slow_module").COMPLETE


def test_what_is_ignored_and_other_threads_are_left_alone():
    handlers = []

    def look():
        with held_off():
            handlers.append(signal.getsignal(signal.SIGINT))

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    look()
    usual = signal.default_int_handler
    signal.signal(signal.SIGINT, usual)
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.SIG_IGN, usual]


PLUG_IN = """
import pathlib, signal, sys
from erosion.models.rigid import Rotating
from erosion.models.parts import ForceLaw

sys.path.insert(0, "")
{}
"""
# Its force is traced while results are kept.
FORCE = """
class Force(ForceLaw):
    def __call__(self, state, tip, p):
        if callable(signal.getsignal(signal.SIGINT)):
            pathlib.Path("begun").touch()
            {}
        return -p.stiffness * tip.depth, -p.k * p.stiffness * tip.depth
    def typical_ratio(self, p):
        return p.k
model = Rotating(force=Force())
"""
# Minutes without Python, as in a library in C++.
LIBRARY = "import hashlib; pathlib.Path('begun').touch(); hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)"
STREAM = 'stream --v0 "normal(110 m/s, 1 m/s)" --n 1e11 -o out.nc'
SWEEP = "sweep --alpha 10deg,20deg --k 0.5:3:600000 -o out.nc"  # two blocks


@pytest.mark.parametrize(
    ("line", "model", "presses", "status"),
    [
        ("run", LIBRARY, 1, -signal.SIGINT),
        (STREAM, FORCE.format("import endless"), 2, -signal.SIGINT),
        (STREAM, FORCE.format("pass"), 1, INTERRUPTED),
        (SWEEP, FORCE.format("pass"), 1, INTERRUPTED),
    ],
    ids=["in a library", "in an import that never ends, while results are kept", "a stream", "a sweep"],
)
def test_a_process_ends_at_once_or_keeps_its_results(tmp_path, line, model, presses, status):
    (tmp_path / "endless.py").write_text("import time\ntime.sleep(60)\n")
    (tmp_path / "model.py").write_text(PLUG_IN.format(model))
    command = [sys.executable, "-m", "erosion", *shlex.split(line), "--model", "model.py"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        end = time.monotonic() + 180
        while not (tmp_path / "begun").exists() and time.monotonic() < end:
            time.sleep(0.05)
        for _ in range(presses):
            assert process.poll() is None
            time.sleep(0.2)
            process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=180)
    assert process.returncode == status, said
    assert said.count("erosion: stops after this block") == ("-o" in line)
    assert ("the same command goes on" in said) == (tmp_path / "out.nc").exists() == (status == INTERRUPTED)
    assert not list(tmp_path.rglob("*.part"))


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
