"""Files that are written completely or not at all."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path


def write_whole(path: Path, content: bytes | memoryview) -> None:
    """Write a file completely or not at all."""
    with written_whole(path) as draft:
        draft.write_bytes(content)


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A draft beside `path`, a file or folder, that gets the name `path` when it is complete.

    Raises:
        OSError: naming `path`, where it cannot be written.
    """
    _require_replaceable(path)
    with _draft(path) as draft:
        yield draft
        draft.replace(path)


def require_writable(path: Path) -> None:
    """Find out, before a long computation, whether a file can be written.

    Raises:
        OSError: naming the path, where it cannot.
    """
    _require_replaceable(path)
    with _draft(path) as draft:
        draft.touch()


def _require_replaceable(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    # A device or a pipe would be replaced by a file.
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "Not a regular file", str(path))


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """A path beside `path`, cleared afterwards; errors name `path`."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
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
