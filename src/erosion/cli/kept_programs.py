"""Programs that XLA has compiled, kept for the next start in the user's cache folder."""

import os
import re
import stat
import warnings
from pathlib import Path
from typing import Any


def keep_programs() -> None:
    """Keep what XLA compiles (closed forms, correlations, `simulate`), if there is a folder for it that is safe.

    Whoever may write into the folder may have this process run what they like.
    """
    import jax
    import platformdirs

    # Whoever says where JAX is to keep its programs decides for themselves, as the tests do.
    if jax.config.jax_compilation_cache_dir is not None:  # pyright: ignore[reportAttributeAccessIssue]
        return
    try:
        folder = platformdirs.user_cache_path("erosion") / "compiled"
        if not folder.is_absolute():  # "~/.cache", in whatever folder this is: the user has no home
            return
        for place in (folder.parent, folder):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not all(_is_ours(place) for place in (folder.parent, folder)):
            return
    except OSError:
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # However small: reading any program takes a fraction of the time that compiling it does.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    _remove_damaged(folder)


def _is_ours(folder: Path) -> bool:
    """Whether nobody but this user may write there."""
    status = folder.stat()
    return not hasattr(os, "getuid") or (
        status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    )


def _remove_damaged(folder: Path) -> None:
    """Remove a program that cannot be read or written: JAX would warn at every start, and never write it anew."""
    usual = warnings.showwarning

    def show(message: Warning | str, *where: Any, **more: Any) -> None:
        entry = re.match(r"Error (?:reading|writing) persistent compilation cache entry for '([^']+)'", str(message))
        if entry is None:
            usual(message, *where, **more)
            return
        # JAX says the function's name alone; all programs of that name are compiled again.
        name_of_jax = re.compile(re.escape(entry[1]) + "-[0-9a-f]{64}-(cache|atime)")
        for file in folder.iterdir():
            if name_of_jax.fullmatch(file.name):
                file.unlink(missing_ok=True)

    warnings.showwarning = show


def start_engine() -> None:
    """Make ready to compute: what XLA compiles is kept for the next start."""
    silence_matplotlib()
    keep_programs()


def silence_matplotlib() -> None:
    """Where it has no place for its settings matplotlib says so in two lines, but needs none; before it is imported."""
    import logging

    logging.getLogger("matplotlib").setLevel(logging.ERROR)
