"""Files that are written completely or not at all."""

import contextlib
import errno
import hashlib
import os
import shutil
import stat
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from erosion.interrupts import held_off


def digest(content: bytes) -> str:
    """Sixteen hexadecimal digits of the SHA-256 of the content."""
    return hashlib.sha256(content).hexdigest()[:16]


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
        target = Path(os.path.realpath(path))
        if target.is_file():
            shutil.copymode(target, draft)
        draft.replace(target)


def require_no_pdf(path: Path) -> None:
    """Check that a page is not asked for as a PDF.

    Raises:
        ValueError: naming the page to write instead.
    """
    if path.suffix.lower() == ".pdf":
        page = path.with_suffix(".html")
        raise ValueError(f"{path}: a browser makes the PDF: write the page, `-o {page}`, and print it from there.")


def require_writable(path: Path) -> None:
    """Find out, before a long computation, whether a file can be written.

    Raises:
        OSError: naming the path, where it cannot.
    """
    _require_replaceable(path)
    with _draft(path) as draft:
        draft.touch()


def require_finite(path: Path, kind: type[ValueError] = ValueError) -> None:
    """Refuse what may be read for ever: a device, and a named pipe, which waits for its writer.

    A shell's own pipe (`<(…)`) has no name in any folder, and passes; so does what is not there.
    """
    place = Path(os.path.realpath(path))
    if place.exists() and not (place.is_file() or place.is_dir()):
        raise kind(f"{path}: is no file.")


@contextlib.contextmanager
def readable(path: Path, kind: type[ValueError] = ValueError) -> Iterator[None]:
    """Read a text within; an error of that kind says where it cannot be read, may never end, or is not in UTF-8."""
    require_finite(path, kind)
    try:
        yield
    except OSError as error:
        raise kind(f"{path}: cannot be read ({error.strerror or error}).") from error
    except UnicodeDecodeError as error:
        raise kind(f"{path}: is not a text file in UTF-8.") from error


def read_toml(path: Path, kind: type[ValueError] = ValueError) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        ValueError: of that kind, for a file that cannot be read, or is not in TOML.
    """
    with readable(path, kind):
        text = path.read_text(encoding="utf-8-sig")
    try:
        return tomllib.loads(text)
    except ValueError as error:  # tomllib's own, and Python's for numbers of thousands of digits
        raise kind(f"{path}: is not valid TOML: {str(error).rstrip('.')}.") from error
    except RecursionError as error:
        raise kind(f"{path}: is nested too deeply.") from error


@contextlib.contextmanager
def claimed(folder: Path, *, alone: bool = False) -> Iterator[bool]:
    """Hold a folder as its user, one of several or `alone`; gives whether that was possible.

    The system ends the claim when the process ends, also when it is killed. Where the system knows no claims,
    nobody has one, and nobody is alone.

    Raises:
        OSError: where the folder is not there.
    """
    try:
        import fcntl
    except ImportError:
        yield False
        return
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB if alone else fcntl.LOCK_SH)
            held = True
        except OSError:  # held by another, or a file system without locks
            held = False
        yield held
    finally:
        os.close(handle)


Trace = tuple[int, int, int] | None
"""What tells a file from one that comes in its place; None where there is none."""


def trace(path: Path) -> Trace:
    """The trace of the file at `path` at this moment."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def is_file(path: str) -> bool:
    """Whether a text is the path of a file; a text that is too long for a path is none."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def beside(file: Path, path: str) -> str:
    """A path that a file gives, which begins at the file's folder, as this process finds it."""
    return str(file.parent / path)


def seen_from(file: Path, path: str) -> str:
    """A path of this process as a file gives it: the inverse of `beside`."""
    there = Path(path).absolute()
    try:
        return Path(os.path.relpath(there.parent.resolve(), file.parent.resolve()), there.name).as_posix()
    except ValueError:  # another drive
        return str(there)


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


@contextlib.contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """A path in a hidden folder beside the file, of its own for each writer, which goes afterwards; errors name `path`.

    A signal waits until it has gone. A program that is killed while it writes leaves the folder, `.NAME.RANDOM.part`.
    """
    target = Path(os.path.realpath(path))  # where links end
    try:
        with (
            held_off(),
            tempfile.TemporaryDirectory(
                prefix=f".{target.name[:40]}.", suffix=".part", dir=target.parent, ignore_cleanup_errors=True
            ) as folder,
        ):
            yield Path(folder) / target.name
    except OSError as error:
        # Libraries put long texts of their own into `strerror`.
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise type(error)(error.errno, reason, str(path)) from error
