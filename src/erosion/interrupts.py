"""Signals that ask a process to end: Ctrl-C, and those of batch systems and closed terminals.

At the command line the system ends the process at once, whatever it does: a file is a draft until it is whole, so
nothing else is lost. Results that a verb keeps, and a draft that gets its name, hold a signal off. Nothing is ever
raised in the middle of an import or of a library, which may not survive it.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator

TYPE_CHECKING = False  # `typing` takes longer to import than all else here
if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

INTERRUPTED = 130
"""The exit status, that of shells."""

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals that ask a process to end."""


_stop: Callable[[], None] | None = None
"""Of what holds signals off now."""


@contextlib.contextmanager
def held_off(said: str = "") -> Iterator[Callable[[], None]]:
    """Hold off the first of these signals while something is done; a second one counts at once.

    Gives a function that raises KeyboardInterrupt after a signal, for places where the work may stop. If it is not
    called, the signal counts at the end, also after an error. What is held off within is held off already.

    Args:
        said: a line on stderr at the first signal.
    """
    global _stop
    # Python gives signals to the main thread alone.
    if _stop is not None or threading.current_thread() is not threading.main_thread():
        yield _stop or _go_on
        return
    # What is ignored, and handlers of other languages, stay.
    usual = {number: handler for number in ENDING
             if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)}  # fmt: skip
    held = list[int]()

    def hold(number: int, _: object) -> None:
        held.append(number)
        restore()
        if said:
            with contextlib.suppress(OSError):
                os.write(2, f"{said}\n".encode())  # a handler may run in the middle of another `print`

    def restore() -> None:
        for number, handler in usual.items():
            signal.signal(number, handler)

    def stop() -> None:
        if held:
            held.clear()
            raise KeyboardInterrupt

    _stop = stop
    for number in usual:
        signal.signal(number, hold)
    try:
        yield stop
    finally:
        restore()
        _stop = None
        if held:
            signal.raise_signal(held[0])


def _go_on() -> None:
    """Another thread heeds no signals."""


@contextlib.contextmanager
def unawaited_threads(count: int) -> "Iterator[ThreadPoolExecutor]":
    """Threads whose work counts only as a whole: after an error or Ctrl-C nobody waits for what they still do."""
    from concurrent.futures import ThreadPoolExecutor  # 7 ms; `erosion` imports this module first

    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
