"""Lanes by a GPU, without one: the same bits by the text of its kernels, and PTX in which every operation is exact."""

import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from erosion.lanes import engines, gpu
from erosion.lanes.flatten import flatten
from erosion.lanes.gpu import GpuLanes, NoGpuError, ptx
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.thread_ir import LOCAL, thread_ir
from tests.lanes import test_large
from tests.lanes.emulated_gpu import emulated_gpu
from tests.lanes.random_programs import RandomFunction
from tests.lanes.test_lanewise import FUNCTIONS, X, Y

_SPECIAL = np.array([0.0, -0.0, 1.0, -2.5, np.inf, -np.inf, np.nan, 5e-324, -1e-310, 1e308, 3.0, 0.7])
# Of PTX: operations that round as they like, and those that the driver may contract with the next.
_INEXACT = r"\S*\.(?:approx|ftz|full)\S*|\b(?:add|sub|mul|mad|div|sqrt|rcp)\.f(?:32|64)\b"
_LARGE = [
    test_large.network, jax.grad(test_large.network), test_large.sums_of_gradients, test_large.exchanged,
    test_large.moved, test_large.taken_apart,
]  # fmt: skip


def _by_gpu(function, examples, **options):
    return GpuLanes(function, examples, gpu=emulated_gpu(), few=0, **options)


def _assert_same_bits(results, others):
    for one, other in zip(jax.tree.leaves(results), jax.tree.leaves(others), strict=True):
        assert one.dtype == other.dtype
        if one.dtype.kind != "f":
            assert np.array_equal(one, other)
            continue
        nan = np.isnan(one) & np.isnan(other)  # of any bits: a GPU has its own
        assert np.all(nan | ((one == other) & (np.signbit(one) == np.signbit(other))))


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_threads_bits_are_those_of_a_vector(function):
    examples = number, number
    _assert_same_bits(_by_gpu(function, examples)(X, Y), Lanewise(function, examples)(X, Y))


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("function", _LARGE)
def test_large_arrays_of_a_thread(function, own):
    """Shared, and each lane's own; on the stack, and in the GPU's memory."""
    random = np.random.default_rng(1)
    w = test_large.WEIGHTS
    if own:
        w = jax.tree.map(lambda leaf: random.normal(size=(test_large.X.size, *leaf.shape)) / 5, w)
    examples = test_large.STRUCTS, number
    _assert_same_bits(_by_gpu(function, examples)(w, test_large.X), Lanewise(function, examples)(w, test_large.X))


def test_memory_of_both_kinds_is_tried():
    rows = []
    for function in _LARGE:
        graph = flatten(jax.make_jaxpr(function)(test_large.STRUCTS, number), shared=True)
        rows.append(graph.rows - graph.places)
    assert min(rows) <= LOCAL < max(rows)


def test_tapes_of_a_thread():
    spread, order = test_large.SPREAD, np.random.default_rng(0).permutation(test_large.SPREAD.size)
    made = []
    for lanes in (
        Lanewise(test_large.powers, (number, number), tapes=1),
        _by_gpu(test_large.powers, (number, number), tapes=1),
    ):
        tape = np.full((spread.size, test_large.LENGTH * 2), np.nan)
        results = [np.empty(spread.size, np.int64), np.empty(spread.size)]
        lanes.run([spread, np.zeros(())], order, results, tapes=[tape])
        made.append([*results, tape])
    _assert_same_bits(*made)


def test_portions_and_lanes_that_are_asked_for_alone(monkeypatch):
    monkeypatch.setattr(gpu, "_PORTION", 7)
    monkeypatch.setattr(gpu, "_LEAST", 1)
    function = FUNCTIONS[0]
    by_gpu, exact = _by_gpu(function, (number, number)), Lanewise(function, (number, number))
    _assert_same_bits(by_gpu(X, Y), exact(X, Y))
    for some in (np.array([3, 17, 4, 40]), np.arange(5, 30)[::-1]):
        ours, theirs = ([np.full(X.size, -1), np.full(X.size, -1.0)] for _ in range(2))
        by_gpu.run([X, Y], some, ours)
        exact.run([X, Y], some, theirs)
        _assert_same_bits(ours, theirs)


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_remainders_of_a_thread_are_exact(kind):
    x, y = (part.ravel() for part in np.meshgrid(np.append(_SPECIAL, [1e300, 12345.678]), _SPECIAL))

    def function(x, y):
        return lax.rem(x.astype(kind), y.astype(kind))

    with np.errstate(all="ignore"):
        expected = np.fmod(x.astype(kind), y.astype(kind))
    _assert_same_bits(_by_gpu(function, (number, number))(x, y), expected)


@pytest.mark.filterwarnings("ignore:(overflow|invalid value) encountered in cast")
@pytest.mark.parametrize("seed", range(20))
def test_random_functions_of_a_thread(seed):
    """Of every type and operation: the same bits, and PTX without an operation that is not exact."""
    random = np.random.default_rng(seed)
    numbers = [
        np.where(random.random(9) < 0.5, random.choice(_SPECIAL, 9), random.normal(size=9) * 30) for _ in range(3)
    ]
    function, examples = RandomFunction(seed, size=8), (number,) * 3
    _assert_same_bits(_by_gpu(function, examples)(*numbers), Lanewise(function, examples)(*numbers))
    assert re.findall(_INEXACT, _ptx(function, *examples)) == []


def _ptx(function, *examples):
    return ptx(thread_ir(flatten(jax.make_jaxpr(function)(*examples))))


def _ptxas():
    """The assembler of NVIDIA, from its package on PyPI."""
    found = [*Path(sysconfig.get_path("purelib")).glob("nvidia/**/bin/ptxas"), shutil.which("ptxas")]
    assert found[0], "ptxas is missing"
    return found[0]


@pytest.mark.skipif(sys.platform != "linux", reason="NVIDIA packs ptxas for Linux")
@pytest.mark.parametrize("target", ["sm_80", "sm_90", "sm_100"])
def test_kernels_are_assembled(target):
    for function in (FUNCTIONS[0], lambda x, y: lax.rem(x, y), lambda x, y: jnp.exp(x) / jnp.sqrt(y)):
        code = _ptx(function, number, number)
        assert re.findall(_INEXACT, code) == []
        subprocess.run([_ptxas(), f"-arch={target}", "-", "-o", "/dev/null"], input=code, text=True, check=True)


def _endless(x):
    return lax.while_loop(lambda s: s >= 0, lambda s: s + x, 0.0 * x)


def test_a_stop_ends_a_kernel_that_never_ends(monkeypatch):
    """As a kernel that is under way when the results are wanted no more."""
    lanes = _by_gpu(_endless, (number,))
    usual = gpu._Stream.start

    def start(stream, *arguments):
        stream.stop[0] = 1
        usual(stream, *arguments)

    monkeypatch.setattr(gpu._Stream, "start", start)
    lanes.run([np.array(0.0)], np.arange(3), [np.empty(3)])


def test_an_interrupt_stops_kernels(monkeypatch):
    """And the next call finds the streams as they were."""
    lanes, stopped = _by_gpu(lambda x: 2 * x, (number,)), []

    def is_done(stream):
        if stream.stop[0]:
            stopped.append(stream)
        if not stopped:
            raise KeyboardInterrupt
        return True

    monkeypatch.setattr(gpu._Stream, "is_done", property(is_done))
    with pytest.raises(KeyboardInterrupt):
        lanes(np.arange(3.0))
    assert stopped
    assert np.array_equal(lanes(np.arange(3.0)), [0.0, 2.0, 4.0])


def test_results_that_are_wanted_no_more_are_not_written():
    lanes, results = _by_gpu(lambda x: 2 * x, (number,)), [np.full(3, -1.0)]
    lanes.run([np.arange(3.0)], np.arange(3), results, np.ones(1, np.int64))
    assert np.array_equal(results[0], [-1.0, -1.0, -1.0])


def test_few_lanes_are_computed_by_the_processor():
    processor = emulated_gpu()
    GpuLanes(FUNCTIONS[0], (number, number), gpu=processor)(X, Y)
    assert processor.driver.texts == []


@pytest.mark.parametrize("limit", ["_LONGEST", "WHOLE"])
def test_a_program_that_is_too_long_is_computed_by_the_processor(limit, monkeypatch):
    monkeypatch.setattr(gpu, limit, -1)
    lanes = _by_gpu(lambda x: 2 * x, (number,))
    assert np.array_equal(lanes(np.arange(3.0)), [0.0, 2.0, 4.0])
    assert lanes._gpu.driver.texts == []


def test_what_is_missing_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    with pytest.raises(NoGpuError, match=r"pip install 'particle-erosion\[gpu\]'"):
        gpu.Gpu()
    with pytest.raises(NoGpuError, match="no driver"):
        emulated_gpu(failing="cuInit")
    with pytest.raises(NoGpuError, match="too little free memory"):
        GpuLanes(lambda x: 2 * x, (number,), gpu=emulated_gpu(memory=1000), few=0)(np.arange(1000.0))


def test_an_engine_that_nobody_knows_is_refused(monkeypatch):
    monkeypatch.setenv("EROSION_ENGINE", "cuda")
    with pytest.raises(ValueError, match="must be `cpu` or `gpu`, but is 'cuda'"):
        engines.by_gpu.__wrapped__()
