"""Ctrl-C at the command line: never in the middle of an import.

Python raises its exception wherever it is. A C++ library that is being imported then aborts or crashes, and a class
that is being made turns it into a RuntimeError. So it waits for the import.
"""

import _thread
import contextlib
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

_AGAIN = 0.01  # s
_LONGEST = 1.0  # s; a plug-in's own import may take for ever
_IMPORTS = "<frozen importlib._bootstrap>"


class _Patient:
    """A handler of SIGINT that raises KeyboardInterrupt once no import is under way."""

    def __init__(self) -> None:
        self._since: float | None = None  # the first of the signals that wait

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        since = self._since = now if self._since is None else self._since
        if _imports(frame) and now - since < _LONGEST:
            threading.Timer(_AGAIN, _press).start()
            return
        self._since = None
        signal.default_int_handler(number, frame)


def _press() -> None:
    """Ctrl-C once more, which also wakes a main thread that sleeps."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


def _imports(frame: FrameType | None) -> bool:
    """Whether an import is under way."""
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTS:
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def between_imports() -> Iterator[None]:
    """Let Ctrl-C wait for imports, where it is as Python leaves it."""
    alone = threading.current_thread() is threading.main_thread()
    if not alone or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _Patient())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
