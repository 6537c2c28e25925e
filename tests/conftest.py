"""One cache of compiled programs for a run; with EROSION_CHECK_TYPES=1, shapes and types of every call are checked."""

import atexit
import ctypes
import gc
import importlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

from tests.documents import run
from tests.durations import mark_slow

# One run's processes share what they compile; earlier runs and the user's own cache play no part.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="erosion-tests-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)

os.environ.setdefault("XDG_CACHE_HOME", os.environ["JAX_COMPILATION_CACHE_DIR"])

# Tracing makes millions of objects that stay: to look for cycles among them takes 6 % of the time.
gc.set_threshold(20_000)

# `make test-types`: the checks take more time than all else that the tests do.
if os.environ.get("EROSION_CHECK_TYPES") == "1":
    # Unchecked: thousands of its small functions run for each program, half of the time to compile one.
    importlib.import_module("erosion.lanes.lanewise")
    # Before any other module of the package is imported.
    install_import_hook("erosion", "beartype.beartype").__enter__()

# A volume in m³ is 1e-9: the usual absolute tolerance of 1e-12 would hide a part in a thousand of it.
type(pytest.approx(0.0)).DEFAULT_ABSOLUTE_TOLERANCE = 0.0

ENTRIES_OF_NO_TEST = pytest.StashKey[list[str]]()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Before pytest selects by marks."""
    config.stash[ENTRIES_OF_NO_TEST] = mark_slow(items)


@pytest.fixture(scope="session")
def entries_of_no_test(pytestconfig):
    """Those of `slow.txt`, as far as tests are collected."""
    return pytestconfig.stash[ENTRIES_OF_NO_TEST]


MEMORY = Path("/proc/self/statm")
MOST = 1e9  # bytes


@pytest.fixture(scope="module", autouse=True)
def _programs_of_earlier_modules_are_dropped():
    """What JAX compiled for a run holds two gigabytes; the C library gives them back only if it is told to."""
    yield
    if MEMORY.exists() and int(MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > MOST:
        sys.modules["jax"].clear_caches()
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture
def written(tmp_path):
    """Writes a file of this name, and says where."""

    def write(name: str, content: str | bytes):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def table(written):
    """Writes a table of measurements, and says where."""
    return lambda text, encoding="utf-8": written("data.csv", text.encode(encoding))


@pytest.fixture
def shell(capsys):
    """Runs a command line in this process; see `tests.documents.run`."""
    return lambda words, status=0: run(words, status, capsys)


@pytest.fixture
def no_computing(monkeypatch):
    """What is wrong with the input must be known before the first impact."""
    import erosion.impacts.batch
    import erosion.impacts.diffrax_steps
    import erosion.impacts.trajectory
    import erosion.ode.maxima

    def computed(*arguments, **options):
        raise AssertionError("computed before the input was checked")

    monkeypatch.setattr(erosion.impacts.batch, "integrate", computed)
    monkeypatch.setattr(erosion.ode.maxima, "integrate", computed)
    monkeypatch.setattr(erosion.impacts.trajectory, "integrate", computed)
    monkeypatch.setattr(erosion.impacts.diffrax_steps, "solve", computed)
