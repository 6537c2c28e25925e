"""Work in threads: neither the page nor the end of the program waits for them."""

import ctypes
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

T = TypeVar("T")

_ARENA_MAX = -8  # of glibc's mallopt
_ARENAS = 2


def share_memory() -> None:
    """Let all threads take their memory from two arenas; to be called before threads are started.

    By default glibc gives new threads arenas of their own, up to eight for each core, and never returns what is free
    in the middle of one. A thread for each answer left the explorer with 150 MB of free memory after some minutes.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_ARENA_MAX, _ARENAS)


def in_thread(work: Callable[[], T]) -> Future[T]:
    """Do the work in a new thread.

    A plug-in's own code may never return. In a pool this code would occupy a thread for ever, and
    the interpreter would wait for the thread before it ends.
    """
    future: Future[T] = Future()

    def run() -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(work())
        # The caller of `result` decides what to do about an error.
        except BaseException as error:  # noqa: BLE001
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future
