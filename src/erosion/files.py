"""Files that are there completely or not at all."""

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there completely or not at all."""
    with _draft(path) as draft:
        draft.write_bytes(content)
        draft.replace(path)


def require_writable(path: Path) -> None:
    """Find out whether `write_whole` can write there, before computing for it.

    Raises:
        OSError: naming the path, where it cannot.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    with _draft(path) as draft:
        draft.touch()


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """A file beside `path`, gone afterwards; errors name `path`."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield draft
    except OSError as error:
        raise type(error)(error.errno, error.strerror, str(path)) from error
    finally:
        with contextlib.suppress(OSError):
            draft.unlink()
