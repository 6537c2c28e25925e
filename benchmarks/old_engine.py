"""The engine before this one, from git's history: XLA compiled its kernels.

Its package is unpacked into a folder of its own and runs in processes that prefer this folder to
the installed package. It needs no dependency that the present package lacks.
"""

import compileall
import contextlib
import io
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.pool import Worker, cores

COMMIT = "7e3663a"  # the last one before the engine was replaced
NEW, OLD = "new", "old"
_ROOT = Path(__file__).parents[1]


def _unpack(folder: Path) -> Path | None:
    """Unpack the commit; None where git or the commit is absent."""
    if shutil.which("git") is None:
        return None
    archive = subprocess.run(["git", "archive", COMMIT, "src/erosion"], cwd=_ROOT, capture_output=True, check=False)
    if archive.returncode:
        return None
    with tarfile.open(fileobj=io.BytesIO(archive.stdout)) as file:
        file.extractall(folder, filter="data")
    # The present package is byte-compiled too.
    compileall.compile_dir(folder, quiet=1)
    return folder / "src"


def worker(source: Path) -> Worker:
    """A process with all cores whose `erosion` is the old package."""
    process = Worker(cores(), source)
    imported = process.call(_imported)
    if not Path(imported).is_relative_to(source):
        raise RuntimeError(f"The old engine was to come from {source}, but {imported} was imported.")
    return process


@contextlib.contextmanager
def unpacked(wanted: bool = True) -> Iterator[Path | None]:
    """The old package's folder for `PYTHONPATH` while it is needed; None where it is not wanted or not to be had."""
    with tempfile.TemporaryDirectory(prefix="old-engine-") as folder:
        yield _unpack(Path(folder)) if wanted else None


@contextlib.contextmanager
def both(source: Path | None) -> Iterator[dict[str, Worker]]:
    """A process for each engine, with all cores, by name (`NEW`, `OLD`)."""
    engines = {NEW: Worker(cores())}
    if source is not None:
        engines[OLD] = worker(source)
    try:
        yield engines
    finally:
        for process in engines.values():
            process.close()


def _imported() -> str:
    import erosion

    return erosion.__file__
