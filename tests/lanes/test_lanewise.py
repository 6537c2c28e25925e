"""Functions of a lane, compiled: control flow, arrays, and what a lane's bits depend on.

The versions of llvmlite that are taken, and the text that their LLVMs read.
"""

import gc
import subprocess
import sys
import textwrap
import threading
import tomllib
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.extend.core import JaxprEqn

from erosion.lanes import machine
from erosion.lanes.flatten import NotForLanesError, flatten
from erosion.lanes.graph import GraphValue, Loop, Region
from erosion.lanes.lanewise import Lanewise, number
from erosion.lanes.machine import LLVMLITE, Processor, require_llvmlite, this_machine, without_garbage_collection
from erosion.lanes.vector_ir import vector_ir

_RANDOM = np.random.default_rng(1958)
X, Y = _RANDOM.uniform(0.1, 3, (2, 45))  # no multiple of a vector's width
TABLE = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.8, 0.9, 1.1, 1.7, 2.0, 2.5, 3.1])


def _root(x, y):
    """Newton's method, of as many steps as a lane needs."""
    return lax.while_loop(
        lambda s: jnp.abs(s[1] * s[1] - x) > 1e-15 * x, lambda s: (s[0] + 1, (s[1] + x / s[1]) / 2), (0, x + y)
    )


def _nested(x, y):
    def outer(i, total):
        inner = lax.while_loop(lambda z: z < 10 * x, lambda z: z * (1 + y), x)
        return lax.cond(
            inner > 20, lambda: total + inner * i, lambda: total - lax.fori_loop(0, 70, lambda j, s: s + j * y, x)
        )

    return lax.fori_loop(0, 5, outer, 0.0)


def _switch(x, y):
    return lax.switch((x * 2).astype(int) - 1, [lambda: x, lambda: x * y, lambda: jnp.sqrt(x), lambda: -y])


def _scan(x, y):
    last, rows = lax.scan(lambda c, a: (c * a + y, (c, jnp.stack([a, c]))), x, jnp.array([0.1, 0.2, 0.3]))
    return last, rows, lax.scan(lambda c, a: (c + a, c), x, jnp.arange(4.0), reverse=True)


def _swapped(x, y):
    """A loop that hands its values round, and one value that it never changes."""
    return lax.while_loop(lambda s: s[3] < 3, lambda s: (s[1], s[0], s[2], s[3] + 1), (x, y, x * y, 0))


def _arrays(x, y):
    a, b = jnp.stack([x, y, x * y]), jnp.array([[1.0, 2.0, 3.0], [0.5, 0.1, 4.0]])
    return {
        "product": b @ a,
        "outer": jnp.outer(a, a),
        "sum": a.sum(),
        "max": jnp.max(b * a, axis=0),
        "argmax": jnp.argmax(a),
        "argmin": jnp.argmin(b * a, axis=1),
        "cumsum": jnp.cumsum(a),
        "cumprod": jnp.cumprod(a[::-1]),
        "any": jnp.any(a > 2),
        "all": jnp.all(b > a, axis=1),
        "roll": jnp.roll(a, 1),
        "pad": jnp.pad(a, (1, 2)),
        "where": jnp.where(a > 1, a, -a),
        "reshape": b.reshape(3, 2),
        "transpose": b.T * x,
        "concatenate": jnp.concatenate([a, b[0]]),
        "split": jnp.split(a, 3),
        "linspace": jnp.linspace(0, x, 4),
        "tile": jnp.tile(a, 2),
        "set": a.at[1].set(0.0),
        "prod": jnp.prod(a),
        "arange": jnp.arange(3) * x,
    }


def _places(x, y):
    a, i = jnp.stack([x, y, x * y, x - y, x + y]), (4 * x).astype(int) - 3
    long = jnp.asarray(TABLE) * x
    return {
        "at": a[i],
        "long": long[i],
        "constants": jnp.asarray(TABLE)[i],
        "fill": a.at[i].get(mode="fill", fill_value=7.0),
        "slice": lax.dynamic_slice(a, (i,), (2,)),
        "update": lax.dynamic_update_slice(a, a[:2], (i,)),
        "set": a.at[i].set(-1.0),
        "add": a.at[i].add(y),
        "subtract": a.at[i].subtract(y),
        "least": a.at[i].min(y),
        "apply": a.at[i].apply(jnp.sin),
        "power": a.at[i].power(3),
        "row": jnp.outer(a, a)[i],
        "column": jnp.outer(a, a)[:, i],
        "pair": jnp.outer(a, a)[i, 1],
        "truths": (long > 1)[i],
        "take": jnp.take(a, i, mode="clip"),
        "interp": jnp.interp(x, TABLE, TABLE**2),
    }


def _expanded(x, y):
    """Functions that newer versions of JAX write as primitives of their own."""
    return {
        "polyval": jnp.polyval(jnp.asarray([y, x, 2.0, 1.0]), x),
        "polyval of an array": jnp.polyval(jnp.arange(12.0), jnp.stack([x, y])),
        "log2": jnp.log2(2 + x),
        "tanh": jax.hessian(lambda u: jnp.tanh(u) + jnp.atanh(u / 4))(x / 8),
        "acos": jax.grad(jnp.acos)(x / 8),
        "searchsorted": jnp.searchsorted(TABLE, x),
        "einsum": jnp.einsum("i,ij->j", jnp.stack([x, y]), jnp.ones((2, 3))),
    }


FUNCTIONS = [_root, _nested, _switch, _scan, _swapped, _arrays, _places, _expanded]


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_compiled_function_is_jaxs(function):
    results = Lanewise(function, (number, number))(X, Y)
    expected = jax.jit(jax.vmap(function))(X, Y)
    assert jax.tree.structure(results) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        assert one == pytest.approx(np.asarray(other), rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_lanes_bits_depend_on_nothing_else(function, monkeypatch):
    """Neither on its neighbours, its place, the width of vectors, the processor, nor how it is compiled."""
    plain = [Processor("x86-64", ""), Processor("x86-64-v3", "")] if "x86" in _machine() else []
    longest, order, lanewise = machine._LONG, _RANDOM.permutation(X.size), Lanewise(function, (number, number))
    results = lanewise(X, Y)
    others = [jax.tree.map(lambda leaf: leaf[np.argsort(order)], lanewise(X[order], Y[order]))]
    for i, (width, target) in enumerate([(2, None), (4, None), (16, None), *((8, each) for each in plain)]):
        monkeypatch.setattr(machine, "_LONG", (0, longest)[i % 2])  # compiled with care, or quickly
        others.append(Lanewise(function, (number, number), width=width, target=target)(X, Y))
    for other in others:
        for leaf, same in zip(jax.tree.leaves(results), jax.tree.leaves(other), strict=True):
            assert leaf.tobytes() == same.tobytes()


@pytest.mark.parametrize("function", FUNCTIONS)
def test_quick_and_careful_code_give_the_same_bits(function, monkeypatch):
    lanewise = Lanewise(function, (number, number))
    quick = lanewise(X, Y)
    compiled = _levels(monkeypatch)
    for seconds, levels in ((1.0, []), (0.0, [machine._CAREFUL]), (0.0, [machine._CAREFUL])):
        lanewise._shared.code._cost = seconds
        for leaf, same in zip(jax.tree.leaves(quick), jax.tree.leaves(lanewise(X, Y)), strict=True):
            assert leaf.tobytes() == same.tobytes()
        assert compiled == levels


def test_careful_code_is_tried_again_where_it_could_not_be_made(monkeypatch):
    lanewise = Lanewise(_root, (number, number))
    lanewise(X, Y)
    lanewise._shared.code._cost = 0.0
    with monkeypatch.context() as patch:
        patch.setattr(machine, "_Compiled", _out_of_memory)
        with pytest.raises(MemoryError):
            lanewise(X, Y)
    compiled = _levels(monkeypatch)
    lanewise(X, Y)
    assert compiled == [machine._CAREFUL]


def _out_of_memory(*_):
    raise MemoryError


def test_long_code_is_compiled_with_care_at_once(monkeypatch):
    compiled = _levels(monkeypatch)
    monkeypatch.setattr(machine, "_LONG", 1000)
    assert Lanewise(_root, (number, number))(2.0, 0.0)[1] == pytest.approx(2**0.5)
    assert compiled == [machine._CAREFUL]


def _levels(monkeypatch):
    """The levels at which code is compiled from now on."""
    compiled = []

    def noted(text, target, level):
        compiled.append(level)
        return compile_module(text, target, level)

    compile_module = machine.compiled
    monkeypatch.setattr(machine, "compiled", noted)
    return compiled


def _machine():
    import platform

    return platform.machine()


def test_leaves_may_be_shared_or_each_lanes_own():
    add = Lanewise(
        lambda a, b: (a["x"] * b, a["rows"].sum()), ({"x": number, "rows": jax.ShapeDtypeStruct((3,), float)}, number)
    )
    rows = _RANDOM.random((X.size, 3))
    for x in (X, 2.0):
        for r in (rows, rows[0], np.asfortranarray(rows), rows[:, ::-1]):
            product, total = add({"x": x, "rows": r}, Y)
            assert np.array_equal(product, x * Y)
            assert total == pytest.approx(np.broadcast_to(np.sum(r, axis=-1), Y.shape))


def test_one_lane_has_the_results_of_many():
    """Their types are of one to eight bytes; a lane alone has its results in another memory."""
    mixed = Lanewise(
        lambda x, w: (x * w, x > 1, jnp.int8(x), jnp.int32(-x), jnp.outer(w, w) + x),
        (number, jax.ShapeDtypeStruct((2,), np.float64)),
    )
    x, w = np.array([0.5, 2.5, 7.0]), np.arange(6.0).reshape(3, 2)
    many = mixed(x, w)
    for lane in range(3):
        alone = [np.zeros_like(part) for part in many]
        mixed.run([x, w], np.array([lane]), alone)
        for part, own in zip(many, alone, strict=True):
            np.testing.assert_array_equal(own[lane], part[lane])
            assert not np.delete(own, lane, axis=0).any()


def test_results_are_written_for_the_lanes_that_are_asked_for_alone():
    root = Lanewise(_root, (number, number))
    steps, value = np.full(X.size, -1), np.full(X.size, -1.0)
    some = np.array([3, 17, 4, 40])
    root.run([X, Y], some, [steps, value])
    assert np.array_equal(np.flatnonzero(value != -1), np.sort(some))
    assert value[some] == pytest.approx(np.sqrt(X[some]))
    root.run([X, Y], some[:0], [steps, value])


def test_threads_share_a_function(monkeypatch):
    """Also while one of them compiles it with care."""
    root = Lanewise(_root, (number, number))
    root._shared.code._cost = 1e-3
    expected, results = root(X, Y)[1], [np.empty(0)] * 8

    def compute(i):
        for _ in range(50):
            results[i] = root(X, Y)[1]

    threads = [threading.Thread(target=compute, args=(i,)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(expected, one) for one in results)


def _ops(region: Region) -> list[str]:
    return [step.op for step in region.steps if isinstance(step, GraphValue)]


def test_what_a_loop_does_not_change_is_computed_before_it():
    def function(x, y):
        return lax.while_loop(lambda s: s < 10, lambda s: s + jnp.sqrt(x) * y / (1 + x) + 1, 0.0 * x)

    graph = flatten(jax.make_jaxpr(function)(number, number))
    (loop,) = (step for step in graph.root.steps if isinstance(step, Loop))
    assert _ops(loop.body) == ["fadd", "fadd"]


def test_equal_operations_are_computed_once_and_unused_ones_not_at_all():
    def function(x, y):
        unused = lax.while_loop(lambda s: s < 10, lambda s: s * x, y)
        del unused
        return jnp.sqrt(x) + 1, jax.jit(jnp.sqrt)(x) + 1

    graph = flatten(jax.make_jaxpr(function)(number, number))
    assert _ops(graph.root) == ["input", "llvm.sqrt", "fadd"]


def test_a_product_and_a_sum_become_one_operation():
    ops = _ops(flatten(jax.make_jaxpr(lambda x, y: x * y - x)(number, number)).root)
    assert ops == ["input", "input", "fms"]
    # Not where the product is a result, too.
    ops = _ops(flatten(jax.make_jaxpr(lambda x, y: (x * y, y - x * y))(number, number)).root)
    assert ops == ["input", "input", "fmul", "fsub"]


@pytest.mark.parametrize(
    ("function", "what"),
    [
        (lambda x, y: jnp.fft.fft(jnp.stack([x, y])).real[0], "uses `fft`, which lanes cannot do"),
        (lambda x, y: jax.random.normal(jax.random.PRNGKey(0)) * x * y, "which lanes cannot do"),
        (lambda x, y: jax.pure_callback(np.sin, number, x) + y, "uses `pure_callback`"),
        (lambda x, y: lax.cond(x > y, lambda: _printed(x), lambda: y), "`_printed` (test_lanewise.py"),
        (lambda x, y: lax.while_loop(lambda s: s < y, lambda s: _printed(s) + 1, x), "`_printed` (test_lanewise.py"),
        (lambda x, y: jnp.linalg.eigvalsh(jnp.outer(jnp.stack([x, y]), jnp.stack([x, y])))[0], "which lanes cannot do"),
    ],
)
def test_what_cannot_be_done_is_said_before_anything_runs(function, what):
    with pytest.raises(NotForLanesError, match=r"`(<lambda>|_printed)` \(test_lanewise\.py, line \d+\) ") as error:
        Lanewise(function, (number, number))
    assert what in str(error.value)


def _printed(x):
    jax.debug.print("{}", x)
    return x


def test_a_small_network():
    network = eqx.nn.MLP(2, "scalar", 8, 2, activation=jnp.tanh, key=jax.random.PRNGKey(0))
    weights, rest = eqx.partition(network, eqx.is_array)

    def function(weights, x, y):
        return jax.value_and_grad(lambda x: eqx.combine(weights, rest)(jnp.stack([x, y])))(x)

    result = Lanewise(function, (weights, number, number))(weights, X, Y)
    expected = jax.jit(jax.vmap(function, (None, 0, 0)))(weights, X, Y)
    for one, other in zip(result, expected, strict=True):
        assert one == pytest.approx(np.asarray(other), rel=1e-12, abs=1e-13)


def test_the_text_is_the_same_each_time():
    # What is compiled depends on the function alone: not on hashes, memory or what came before.
    texts = {vector_ir(flatten(jax.make_jaxpr(_nested)(number, number)), 8) for _ in range(3)}
    assert len(texts) == 1


def test_this_machine_uses_its_widest_vectors():
    assert "-prefer-256-bit" in this_machine().features


def test_a_batch_of_loops_within_a_lane():
    def roots(x, y):
        def root(a):
            return lax.while_loop(
                lambda s: jnp.abs(s[0] * s[0] - a) > 1e-14 * a, lambda s: ((s[0] + a / s[0]) / 2, s[1] + 1), (a + y, 0)
            )

        return jax.vmap(root)(jnp.stack([x, 2 * x, 900.0 + 0 * x]))

    values, steps = Lanewise(roots, (number, number))(X, Y)
    assert values == pytest.approx(np.sqrt(np.stack([X, 2 * X, 900 + 0 * X], axis=1)))
    # A row that is done counts no more steps.
    assert np.all(steps[:, 0] < steps[:, 2])
    assert np.array_equal(steps, np.asarray(jax.jit(jax.vmap(roots))(X, Y)[1]))


def test_products_of_arrays_have_the_type_that_is_asked_for():
    def product(x, y):
        a, b = jnp.stack([x, y]).astype(np.float32), jnp.stack([y, x]).astype(np.float32)
        i = (100 * a).astype(np.int8)
        return jnp.dot(a, b, preferred_element_type=np.float64), lax.dot(i, i, preferred_element_type=np.int32)

    for one, other in zip(Lanewise(product, (number, number))(X, Y), jax.jit(jax.vmap(product))(X, Y), strict=True):
        assert one.dtype == other.dtype
        assert one == pytest.approx(np.asarray(other), rel=1e-12)


def test_a_quotient_by_a_tiny_constant_is_a_quotient():
    x = np.array([0.0, 1e-310, 3.0])
    with np.errstate(over="ignore"):
        assert np.array_equal(Lanewise(lambda x: x / 5e-324, (number,))(x), x / 5e-324)


def test_any_order_may_be_asked_for():
    root = Lanewise(_root, (number, number))
    every = np.arange(X.size)[::-2]  # not contiguous
    results = [np.full(X.size, -1), np.full(X.size, -1.0)]
    root.run([X, Y], every, results)
    assert results[1][every] == pytest.approx(np.sqrt(X[every]))


@pytest.mark.parametrize(
    "function",
    [
        lambda x: lax.scan(lambda c, row: (c * row + 1, None), x, jnp.arange(10_000.0) / 1e4)[0],
        lambda x: jnp.sum(jnp.outer(jnp.arange(1000.0) * x, jnp.arange(1000.0))),
    ],
)
def test_what_is_too_long_is_said_soon(function, monkeypatch):
    monkeypatch.setattr("erosion.lanes.graph._MOST", 5_000)
    with pytest.raises(NotForLanesError, match="uses more than 5,000 operations, which lanes cannot do"):
        Lanewise(function, (number,))


def test_what_is_known_already_is_not_asked_for_without_end(monkeypatch):
    monkeypatch.setattr("erosion.lanes.graph._MOST_ASKED", 5_000)

    def function(x):
        ones = jax.jit(lambda: jnp.ones((100, 100)))()
        return x * jnp.cumsum(jnp.cumsum(ones, 0), 1)[-1, -1]  # 20,000 sums of constants

    with pytest.raises(NotForLanesError, match="operations, which lanes cannot do"):
        Lanewise(function, (number,))


@pytest.mark.parametrize("kind", [np.uint64, np.uint8])
def test_an_index_without_a_sign_may_be_beyond_every_signed_one(kind):
    def function(x, y):
        a = jnp.stack([x, y, x + y])
        i = jnp.where(x > 0, kind(np.iinfo(kind).max), kind(1))
        return lax.dynamic_slice_in_dim(a, i, 2), a[i], a.at[i].get(mode="fill"), a.at[i].set(7.0, mode="clip")

    by_jax = jax.jit(jax.vmap(function))(X - 1, Y)
    for one, other in zip(Lanewise(function, (number, number))(X - 1, Y), by_jax, strict=True):
        assert np.array_equal(one, np.asarray(other), equal_nan=True)


@pytest.mark.parametrize("version", ["0.45.0", "0.45.1", "0.46.0", "0.47.0", "0.48.0", "0.50.0", "0.50.0rc1"])
def test_versions_that_work_are_taken(version: str) -> None:
    require_llvmlite(version)


@pytest.mark.parametrize("version", ["0.44.0", "0.51.0", "0.51.0dev0+1.gabc", "1.0.0", "0+unknown", ""])
def test_other_versions_are_refused_at_once(version: str) -> None:
    with pytest.raises(ImportError, match=r"llvmlite>=0\.45,<0\.51") as caught:
        require_llvmlite(version)
    assert f"llvmlite {version} " in str(caught.value)


def test_the_bounds_are_those_of_the_package() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    least, beyond = (".".join(map(str, bound)) for bound in LLVMLITE)
    assert f"llvmlite>={least},<{beyond}" in project["project"]["dependencies"]


def test_a_verb_says_it_in_one_line() -> None:
    code = """
        import llvmlite
        llvmlite.__version__ = "0.44.0"
        from erosion.cli import main
        main(["run"])
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("erosion: erosion needs llvmlite 0.45 or newer, below 0.51, but llvmlite 0.44.0 ")
    assert done.stderr.count("\n") == 1


def test_arrays_are_chosen_among_any_number_of_cases():
    """And a part of a number without axes is that number."""

    def function(x):
        number = lax.dynamic_update_slice(x, lax.dynamic_slice(x, (), ()), ())
        return lax.select_n(
            (x * 20).astype(np.int32) * jnp.ones(2, np.int32), *(number * jnp.ones(2) + k for k in range(70))
        )

    np.testing.assert_allclose(Lanewise(function, (number,))(X), jax.jit(jax.vmap(function))(X), rtol=1e-15)


def test_a_program_keeps_no_trace() -> None:
    def equations() -> int:
        gc.collect()
        return sum(isinstance(thing, JaxprEqn) for thing in gc.get_objects())

    Lanewise(lambda x: x * (x + 16) * (x + 15), (number,))  # JAX keeps sums and products themselves
    before = equations()
    program = Lanewise(lambda x: x * (x + 17) * (x + 18), (number,))
    assert equations() == before
    assert program(np.array([2.0])) == 2 * 19 * 20


def test_a_graph_is_gone_once_it_is_compiled() -> None:
    """Without a search for garbage, which would take a tenth of the time to compile."""

    def values() -> int:
        return sum(isinstance(thing, GraphValue) for thing in gc.get_objects())

    with without_garbage_collection():
        before = values()
        Lanewise(lambda x: lax.cond(x > 0, jnp.sin, lambda x: x * (x + 19), x), (number,))
        assert values() - before < 10
