"""Machine code in a thread of its own, while the main thread waits for it and runs the handlers of signals."""

import concurrent.futures
import ctypes
import functools
import os
import threading
from collections.abc import Callable

from erosion.lanes.vector_ir import STOPPED


class Interruptible:
    """Runs machine code, which a signal's handler may stop by an exception.

    Python runs handlers in the main thread, and only between two of its own operations. So the main thread gives long
    work to a worker. It begins the work itself, with the word set that stops the code: the code looks at the word after
    some hundredths of a second. Code that stops there begins again in the worker.

    Args:
        is_long: whether a worker runs the code from the beginning.
    """

    def __init__(self, *, is_long: bool) -> None:
        self._is_long = is_long

    def run(self, code: Callable[[int], None], *memory: object) -> None:
        """Run some code, which takes the address of the word; other threads than the main one have no handlers.

        Args:
            code: knows the other memory by addresses, too.
            memory: owns it. The worker keeps it until it ends, also where an exception leaves this call.
        """
        word = ctypes.c_int64(0)
        if threading.current_thread() is not threading.main_thread():
            code(ctypes.addressof(word))
            return
        if not self._is_long:
            word.value = 1
            code(ctypes.addressof(word))
            self._is_long = word.value == STOPPED
            if not self._is_long:
                return
            word.value = 0
        begun: list[concurrent.futures.Future[None]] = []
        try:
            begun.append(_workers().submit(_kept, code, word, *memory))
            begun[0].result()
        except BaseException:
            word.value = 1
            concurrent.futures.wait(begun)
            raise


def _kept(code: Callable[[int], None], word: ctypes.c_int64, *_: object) -> None:
    """Run some code in a frame that holds its memory."""
    code(ctypes.addressof(word))


@functools.cache
def _workers() -> concurrent.futures.ThreadPoolExecutor:
    return concurrent.futures.ThreadPoolExecutor(thread_name_prefix="lanes")


if hasattr(os, "register_at_fork"):
    # A forked process has none of the threads.
    os.register_at_fork(after_in_child=_workers.cache_clear)
