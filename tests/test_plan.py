import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion import plan
from erosion.model import CuttingModel, State, Tip

P = erosion.TABLE_1
LANES = np.linspace(-2.0, 3.0, 11)


def planned(function, like, shared=(), known=(LANES,)):
    return plan.planned(function, shared, known, like)


def shared_work(shared, known, row, scale):
    (k,) = known
    x, y = row
    dear = jnp.where(x > 0, jnp.sqrt(jnp.abs(x)) + y**3, jnp.cos(y) * x)
    return [dear * k, dear / k, 2.0], [dear + scale, k]


def test_a_plan_equals_the_function_and_stores_what_is_shared():
    found = planned(shared_work, [2, None])
    assert isinstance(found, plan.Plan)
    assert len(found.kernels) == 3  # what is dear, and one for each list
    row, scale = np.stack([LANES[::-1], LANES + 0.5]), LANES**2
    for made, true in zip(found(row, scale), shared_work((), (LANES,), row, scale), strict=True):
        assert made == pytest.approx(np.stack([np.broadcast_to(part, LANES.shape) for part in true]), rel=1e-15)


def test_zeros_infinities_and_nan_divide_as_ever():
    special = np.array([0.0, -0.0, 1.0, np.inf, -np.inf, np.nan])
    x, k = (axis.ravel() for axis in np.meshgrid(special, special))
    (found,) = planned(lambda shared, known, x: ([x / known[0]],), [None], known=(k,))(x)
    with np.errstate(all="ignore"):
        assert np.array_equal(found[0], x / k, equal_nan=True)


@pytest.mark.parametrize(
    "function",
    [
        lambda shared, known, x: ([jax.lax.cond(x > 0, jnp.sin, jnp.cos, x)],),
        lambda shared, known, x: ([jax.lax.fori_loop(0, 3, lambda i, y: y * known[0], x)],),
        lambda shared, known, x: ([jnp.sum(shared * x)],),
        lambda shared, known, x: (
            [jnp.linalg.solve(jnp.array([[2.0, 1.0], [1.0, 3.0]]), jnp.stack([x, known[0]]))[0]],
        ),
    ],
)
def test_what_is_not_scalar_arithmetic_stays_whole(function):
    shared = jnp.arange(3.0)
    found = planned(function, [None], shared)
    assert not isinstance(found, plan.Plan)
    each = [function(shared, (k,), x)[0][0] for k, x in zip(LANES, LANES**2, strict=True)]
    assert found(LANES**2)[0][0] == pytest.approx(np.asarray(each), rel=1e-14)


class Matrix(CuttingModel):
    """The linearized cut, written with linear algebra and control flow."""

    softening: jax.Array = eqx.field(default_factory=lambda: jnp.array([1.0, 0.0]))

    def initial_state(self, p):
        zero = jnp.zeros_like(p.alpha)
        return State(zero, zero, zero, p.v0 * jnp.cos(p.alpha), p.v0 * jnp.sin(p.alpha), zero)

    def derivative(self, state, p):
        force = -p.stiffness * jax.lax.cond(state.y > 0, lambda y: y, lambda y: 1.0 * y, state.y)
        force = force * jnp.dot(self.softening, jnp.stack([jnp.ones_like(force), state.y]))
        vx, vy = jnp.linalg.solve(p.m * jnp.array([[1.0, 0.0], [0.5, 1.0]]), force * jnp.stack([1.0, p.k + 0.5]))
        return State(state.vx, state.vy, state.omega, vx, vy, jnp.zeros_like(force))

    def tip(self, state, p):
        return Tip(state.x, state.y, state.vx, state.vy)


def test_a_model_with_linear_algebra_and_control_flow_works():
    p = P.replace(alpha=np.linspace(0.2, 1.2, 7))
    found = erosion.impact(Matrix(), p, derivatives=2)
    true = erosion.impact("linearized", p, derivatives=2)
    assert np.all(found.ended_by == true.ended_by)
    for name in ("volume", "t_c", "dvolume", "d2volume"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=1e-8), name


class Tagged(erosion.models.ConstantRatio):
    """K = k; another tag makes another program of the same arithmetic."""

    tag: str = eqx.field(static=True)


def test_a_plan_changes_no_result(monkeypatch):
    def results(tag):
        turning = erosion.models.Rotating(force=Tagged(tag), torque=erosion.models.FullTorque())
        p = P.replace(alpha=np.linspace(0.1, 1.5, 9), phidot0=0.3 * P.v0 / P.r)
        hit = erosion.impact(turning, p, derivatives=2)
        straight = erosion.models.Linearized(force=Tagged(tag))
        return hit, jax.jit(jax.grad(lambda p: erosion.volume(straight, p)))(P)

    found, slope = results("planned")
    wholes = []
    monkeypatch.setattr(plan, "Plan", lambda *arguments: wholes.append(arguments) or plan._whole(*arguments))
    true, expected = results("whole")
    assert wholes
    for name, rel in (("volume", 1e-13), ("t_c", 1e-13), ("dvolume", 1e-11), ("d2volume", 1e-11)):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=rel), name
    for one, other in zip(jax.tree.leaves(slope), jax.tree.leaves(expected), strict=True):
        assert one == pytest.approx(float(other), rel=1e-11)


def test_a_flag_of_the_model_stays_one():
    def function(shared, known, x):
        return ([jnp.where(shared["flag"], shared["a"] * x, known[0] * x), x ** shared["n"]],)

    shared = {"flag": jnp.array(True), "a": jnp.array(2.0), "n": jnp.array(3)}
    found = planned(function, [None], shared)
    assert isinstance(found, plan.Plan)
    assert np.array_equal(found(LANES)[0], np.stack([2 * LANES, LANES**3]))


def test_products_of_small_loops_are_rounded_by_themselves():
    """Or a lane's result would depend on where in a block it lies; see `plan._rounded`."""
    x, y, z = np.random.default_rng(0).normal(size=(3, LANES.size))
    found = planned(lambda shared, known, x, y, z: ([x * y + z, x * y - z * y], [x * y]), [None, None, None])(x, y, z)
    assert np.array_equal(found[0], [x * y + z, x * y - z * y])
    assert np.array_equal(found[1], [x * y])
