"""Machine code that earlier processes made, kept in the user's own cache folder.

Whoever can write there could have any code run. So the folder must be the user's own, closed to all others, and a file
counts only with the digest of its content and of what it was made from. Where any of this is not so, or nothing can
be written, code is made anew, and no one notices.
"""

import contextlib
import functools
import hashlib
import os
import re
import stat
import tempfile
from pathlib import Path

_MANY = 256  # files, of some 50 kB each
_DIGEST = 32  # bytes
_FORM = b"1"  # of the files
_OWN = re.compile(r"[0-9a-f]{64}|\.[0-9a-f]{64}\.\w+")  # a key, and while it is written


def key_of(*origins: str) -> str:
    """The name of the code that is made from these texts."""
    digest = hashlib.sha256(_FORM)
    for origin in origins:
        digest.update(hashlib.sha256(origin.encode()).digest())
    return digest.hexdigest()


def read(key: str) -> bytes | None:
    """The code of that name, or None."""
    folder = _own_folder()
    if folder is None:
        return None
    try:
        # By its handle: the folder is the one that is looked at, whatever comes into its place meanwhile.
        place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            handle = os.open(key, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=place)
            with os.fdopen(handle, "rb") as file:
                status = os.fstat(handle)
                if not (_is_own(os.fstat(place)) and _is_own(status) and stat.S_ISREG(status.st_mode)):
                    return None
                content = file.read()
                with contextlib.suppress(OSError):  # the folder may only be read
                    os.utime(handle)  # the longest unused goes first
        finally:
            os.close(place)
    except OSError:
        return None
    code = content[_DIGEST:]
    return code if content[:_DIGEST] == _seal(key, code) else None


def write(key: str, code: bytes) -> None:
    """Keep the code, if that is possible."""
    folder = _own_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):
        handle, draft = tempfile.mkstemp(dir=folder, prefix=f".{key}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_seal(key, code) + code)
            Path(draft).replace(folder / key)
        except BaseException:
            Path(draft).unlink()
            raise
        _forget_old(folder)


def _seal(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def _forget_old(folder: Path) -> None:
    own = (file for file in folder.iterdir() if _OWN.fullmatch(file.name))
    files = sorted(own, key=lambda file: file.stat().st_mtime)
    for file in files[:-_MANY]:
        with contextlib.suppress(OSError):
            file.unlink()


def _own_folder() -> Path | None:
    """The folder, made if needed; None where it is not the user's alone."""
    folder = _place()
    if folder is None:
        return None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return None
    return folder if stat.S_ISDIR(status.st_mode) and _is_own(status) else None


def _is_own(status: os.stat_result) -> bool:
    """Whether a file or a folder is the user's own, and closed to all others."""
    return status.st_uid == os.getuid() and not status.st_mode & 0o077


@functools.cache
def _place() -> Path | None:
    """Where the folder is; None where the system knows no owners of files, or nobody's home."""
    if not hasattr(os, "getuid"):
        return None
    import platformdirs

    try:
        place = platformdirs.user_cache_path("erosion") / "lanes"
    except (OSError, RuntimeError):
        return None
    # Of a user without a home it is "~/.cache", in whatever folder this is.
    return place if place.is_absolute() else None
