"""Files that are written completely or not at all."""

import contextlib
import errno
import os
import secrets
import shutil
import signal
import stat
import threading
from collections.abc import Iterator
from pathlib import Path


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file completely or not at all."""
    with written_whole(path) as draft:
        draft.write_bytes(content)


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A draft beside `path`, a file or folder, that gets the name `path` when it is complete.

    Where `path` is a link, the file that it leads to is written. A file keeps its permissions.

    Raises:
        OSError: naming `path`, where it cannot be written.
    """
    _require_replaceable(path)
    with _draft(path) as draft:
        yield draft
        target = _target(path)
        if target.is_file():
            shutil.copymode(target, draft)
        draft.replace(target)


def require_writable(path: Path) -> None:
    """Find out, before a long computation, whether a file can be written.

    Raises:
        OSError: naming the path, where it cannot.
    """
    _require_replaceable(path)
    with _draft(path) as draft:
        draft.touch()


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """What is written within is finished before Ctrl-C counts; a second Ctrl-C counts at once.

    Raises:
        KeyboardInterrupt: at the end, after a Ctrl-C.
    """
    # Python gives signals to the main thread alone. A handler of another language is left alone.
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or usual is None:
        yield
        return
    pressed = False

    def note(*_: object) -> None:
        nonlocal pressed
        pressed = True
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if pressed:
        raise KeyboardInterrupt


Trace = tuple[int, int, int] | None
"""What tells a file from one that comes in its place; None where there is none."""


def trace(path: Path) -> Trace:
    """The trace of the file at `path` at this moment."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def free_path(path: Path) -> Path:
    """The first of out-2.nc, out-3.nc, … that is not there."""
    number = 2
    while (other := path.with_stem(f"{path.stem}-{number}")).exists():
        number += 1
    return other


def _require_replaceable(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    # A device or a pipe would be replaced by a file.
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "Not a regular file", str(path))
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def _target(path: Path) -> Path:
    """Where the links of `path` end."""
    return Path(os.path.realpath(path))


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """A path beside the file, cleared afterwards, of its own for each writer; errors name `path`."""
    target = _target(path)
    draft = target.with_name(f".{target.name[:40]}.{secrets.token_hex(8)}.part")
    try:
        yield draft
    except OSError as error:
        # Libraries put long texts of their own into `strerror`.
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise type(error)(error.errno, reason, str(path)) from error
    finally:
        if draft.is_dir():
            shutil.rmtree(draft, ignore_errors=True)
        with contextlib.suppress(OSError):
            draft.unlink()
