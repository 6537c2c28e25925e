"""Ctrl-C at the command line: when it is heeded, and what ends the process where nothing heeds it.

SIGTERM and SIGHUP, by which batch systems and closed terminals end a process, are heeded as Ctrl-C is.

While a verb works, Ctrl-C is Python's KeyboardInterrupt, so that drafts go and partial results are kept. It is never
raised in the middle of an import: a C++ library that is being imported then aborts or crashes, and a class that is
being made turns it into a RuntimeError. An import that takes long, as on a busy machine, ends with the process.
Before and after the verb there is nothing to lose, and the process ends.

Python runs a signal's handler between two of its own operations. XLA compiles for seconds without any, and a program
of XLA's may run for ever; a thread sees that, and ends the process.

KeyboardInterrupt may be lost: Python ignores what a destructor or a callback of its garbage collection raises, and
JAX has an `except:` in `broadcast_shapes`, which every trace calls. A thread sees that, too, and presses again.
"""

import _thread
import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType

TYPE_CHECKING = False  # `typing` takes longer to import than all else here
if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

INTERRUPTED = 130
"""The exit status, that of shells."""

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals that ask a process to end."""

_AGAIN = 0.01  # s
_LONGEST = 1.0  # s; a plug-in's own import may take for ever, and so may a program of XLA's
_LOOKS = 20  # in that time
_IMPORTS = "<frozen importlib._bootstrap>"


def stop_at_once(*_: object) -> None:
    """A handler of such a signal that says so and ends the process, whatever its threads do."""
    with contextlib.suppress(OSError):
        os.write(2, b"erosion: interrupted\n")  # a handler may run in the middle of another `print`
    os._exit(INTERRUPTED)


class _Patient:
    """A handler of these signals that raises KeyboardInterrupt once no import is under way."""

    keeping = 0  # verbs that have something to keep after a Ctrl-C

    def __init__(self) -> None:
        self._since: float | None = None  # the first of the signals that wait
        self._over = threading.Event()
        self._pressing = list[threading.Thread]()
        self.unheeded, self._arrivals = os.pipe()  # a byte for each signal that was not handled yet

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self._drain()
        if self._over.is_set():
            return
        now = time.monotonic()
        since = self._since = now if self._since is None else self._since
        if _imports(frame):
            if now - since > _LONGEST and not _Patient.keeping:
                stop_at_once()
            self._start(threading.Timer(_AGAIN, _press, (number,)))
            return
        self._since = None
        interrupt = KeyboardInterrupt()
        self._start(threading.Thread(target=self._look_after, args=(interrupt, number), daemon=True))
        raise interrupt

    def _start(self, thread: threading.Thread) -> None:
        thread.start()  # in which the next signal may come
        self._pressing.append(thread)

    def _look_after(self, interrupt: KeyboardInterrupt, number: int) -> None:
        """Press again where nobody handles the interrupt, and the verb goes on."""
        lost = 0
        while lost < 2:  # between two handlers it may seem to be lost
            if self._over.wait(_LONGEST / _LOOKS):
                return
            writes = signal.getsignal(number) is not self
            lost = 0 if writes or _is_handled(interrupt) else lost + 1
        _press(number)

    def end(self) -> None:
        """The verb is over; whoever would press again has done so: afterwards the signal may end the process."""
        self._over.set()
        for thread in self._pressing:
            thread.join()

    @contextlib.contextmanager
    def watched(self) -> Iterator[None]:
        """End the process if it heeds no Ctrl-C for a second."""
        for handle in (self.unheeded, self._arrivals):
            os.set_blocking(handle, False)
        usual = signal.set_wakeup_fd(self._arrivals, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            yield
        finally:
            signal.set_wakeup_fd(usual)
            os.close(self._arrivals)  # wakes the thread

    def _watch(self) -> None:
        while True:
            select.select([self.unheeded], [], [])
            for _ in range(_LOOKS):
                time.sleep(_LONGEST / _LOOKS)
                if not select.select([self.unheeded], [], [], 0)[0]:
                    break
            else:
                if not self._drain():
                    os.close(self.unheeded)
                    return
                # Another handler waits for a file that is being written, or for a server's end.
                if any(signal.getsignal(number) is self for number in ENDING) and not _Patient.keeping:
                    stop_at_once()

    def _drain(self) -> bool:
        """Forget the signals that came; whether more may come."""
        try:
            return bool(os.read(self.unheeded, 512))
        except BlockingIOError:
            return True


def _press(number: int) -> None:
    """The signal once more, which also wakes a main thread that sleeps."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


def _is_handled(interrupt: KeyboardInterrupt) -> bool:
    """Whether the main thread is in an `except` or a `finally` that the interrupt, or an error after it, reached."""
    handled: object = sys._current_exceptions().get(threading.main_thread().ident or 0)
    error = handled[1] if isinstance(handled, tuple) else handled  # before Python 3.12 a tuple
    while isinstance(error, BaseException) and error is not interrupt:
        error = error.__context__
    return error is interrupt


def _imports(frame: FrameType | None) -> bool:
    """Whether an import is under way."""
    while frame is not None:
        if frame.f_code.co_filename == _IMPORTS:
            return True
        frame = frame.f_back
    return False


@contextlib.contextmanager
def between_imports() -> Iterator[None]:
    """Let Ctrl-C wait for imports, where it is as Python, the system or `stop_at_once` leaves it."""
    alone = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in ENDING}
    usual = {number: handler for number, handler in handlers.items()
             if handler in (signal.default_int_handler, signal.SIG_DFL, stop_at_once)}  # fmt: skip
    if not alone or not usual:
        yield
        return
    patient = _Patient()
    with patient.watched() if hasattr(signal, "pthread_kill") else contextlib.nullcontext():
        for number in usual:
            signal.signal(number, patient)
        try:
            yield
        except Exception as error:
            if isinstance(error.__cause__, KeyboardInterrupt):  # Python's, of a class that was being made
                raise error.__cause__ from None
            raise
        finally:
            patient.end()
            for number, handler in usual.items():
                signal.signal(number, handler)


@contextlib.contextmanager
def keeping_results() -> Iterator[None]:
    """Let Ctrl-C wait as long as need be: what is computed is kept."""
    _Patient.keeping += 1
    try:
        yield
    finally:
        _Patient.keeping -= 1


@contextlib.contextmanager
def unawaited_threads(count: int) -> "Iterator[ThreadPoolExecutor]":
    """Threads whose work counts only as a whole: after an error or Ctrl-C nobody waits for what they still do."""
    from concurrent.futures import ThreadPoolExecutor

    pool = ThreadPoolExecutor(count)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
