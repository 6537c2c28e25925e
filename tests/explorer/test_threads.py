"""The explorer's threads, and the memory that they share."""

import os
import platform
import subprocess
import sys

import pytest

COUNT = """
import ctypes, sys, tempfile, threading
from erosion.explorer.computed import in_thread, share_memory
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.fopen.restype = ctypes.c_void_p
if sys.argv[1] == "shared":
    share_memory()
together = threading.Barrier(8)
def work():
    libc.malloc(1000)
    together.wait()
    libc.malloc(1000)
for future in [in_thread(work) for _ in range(8)]:
    future.result()
with tempfile.NamedTemporaryFile() as file:
    stream = ctypes.c_void_p(libc.fopen(file.name.encode(), b"w"))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    print(open(file.name).read().count("<heap nr="))
"""


def arenas(how: str) -> int:
    """How many arenas glibc has after eight threads at once."""
    usual = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    done = subprocess.run(
        [sys.executable, "-c", COUNT, how], env=usual, capture_output=True, text=True, timeout=60, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's way to give memory to threads")
def test_threads_share_their_memory() -> None:
    assert arenas("own") > 2
    assert arenas("shared") <= 2
