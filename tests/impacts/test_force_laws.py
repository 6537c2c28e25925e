"""Force laws that are more than a formula: a loop, a table, a small network; against scipy."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import erosion
from tests.fine_steps import scipy_cut

pytestmark = pytest.mark.slow

P = erosion.TABLE_1


class Implicit(erosion.models.ForceLaw):
    """F_x = -c·depth·u, where u solves u³ + u = 2 + (depth/r)² by Newton's method."""

    def __call__(self, state, tip, p):
        target = 2 + (tip.depth / p.r) ** 2
        u = _cubic_root(target)
        horizontal = -p.stiffness * tip.depth * u
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


@jax.custom_jvp
def _cubic_root(target):
    """The root of u³ + u = target."""
    return lax.while_loop(
        lambda u: jnp.abs(u**3 + u - target) > 1e-14 * target,
        lambda u: u - (u**3 + u - target) / (3 * u**2 + 1),
        1.0 + 0 * target,
    )


@_cubic_root.defjvp
def _cubic_root_jvp(primals, tangents):
    u = _cubic_root(*primals)
    return u, tangents[0] / (3 * u**2 + 1)


class TableOfDepth(erosion.models.ForceLaw):
    """F_x = -c·depth·f(depth/r), with f from a table of the model's own."""

    depths: Any
    factors: Any

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * tip.depth * jnp.interp(tip.depth / p.r, self.depths, self.factors)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


class Network(erosion.models.ForceLaw):
    """F_x = -c·depth·(1 + n(depth/r)), with a small network n."""

    network: eqx.nn.MLP

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * tip.depth * (1 + self.network(tip.depth / p.r))
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


def network(width: int = 4) -> erosion.models.Rotating:
    made = eqx.nn.MLP("scalar", "scalar", width, 1, activation=jnp.tanh, key=jax.random.PRNGKey(1))
    return erosion.models.Rotating(force=Network(made))


DEPTHS = np.linspace(0, 3, 10)
LAWS = {
    "implicit": lambda: erosion.models.Rotating(force=Implicit()),
    "table": lambda: erosion.models.Rotating(force=TableOfDepth(DEPTHS, 1 + 0.3 * DEPTHS**2)),
    "network": network,
}


@pytest.mark.parametrize("name", LAWS)
def test_the_batch_is_scipys(name):
    model = LAWS[name]()
    p = P.replace(alpha=[0.3, 0.6, 1.1])
    hits = erosion.impact(model, p)
    for i, alpha in enumerate(p.alpha):
        volume, ended_by, t_c = scipy_cut(model, P.replace(alpha=alpha), DEPTHS[1:].tolist() if name == "table" else [])
        assert hits.ended_by[i] == ended_by
        assert hits.volume[i] == pytest.approx(volume, rel=1e-8, abs=0)
        assert hits.t_c[i] == pytest.approx(t_c, rel=1e-8, abs=0)


@pytest.mark.parametrize("name", ["implicit", "network"])
def test_derivatives_are_differences(name):
    model = LAWS[name]()
    hit = erosion.impact(model, P, derivatives=2)
    step = 1e-4
    near = erosion.impact(model, P.replace(alpha=P.alpha + step * np.array([-1, 0, 1])), rtol=1e-12).volume
    assert hit.dvolume == pytest.approx((near[2] - near[0]) / (2 * step), rel=1e-5, abs=0)
    assert hit.d2volume == pytest.approx((near[2] - 2 * near[1] + near[0]) / step**2, rel=1e-4, abs=0)


def test_gradients_by_a_networks_weights_are_differences():
    model = network()
    weights, rest = eqx.partition(model, eqx.is_array)

    def volume(weights):
        return erosion.volume(eqx.combine(weights, rest), P)

    slopes = jax.jit(jax.grad(volume))(weights)
    for where in (lambda m: m.force.network.layers[0].weight, lambda m: m.force.network.layers[1].bias):
        array, slope = where(weights), np.ravel(where(slopes))
        for i in range(array.size):
            ends = []
            for way in (-1, 1):
                moved = np.ravel(np.asarray(array)).copy()
                moved[i] += way * 1e-4
                ends.append(float(volume(eqx.tree_at(where, weights, jnp.asarray(moved.reshape(array.shape))))))
            assert slope[i] == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-5, abs=1e-12)


def test_what_lanes_cannot_do_names_the_models_method():
    class Spectral(erosion.models.ForceLaw):
        def __call__(self, state, tip, p):
            horizontal = -p.stiffness * jnp.fft.fft(jnp.stack([tip.depth, 0.0])).real[1]
            return horizontal, p.k * horizontal

        def typical_ratio(self, p):
            return p.k

    model = erosion.models.Rotating(force=Spectral())
    with pytest.raises(
        ValueError, match=r"`Spectral.__call__` \(test_force_laws\.py, line \d+\) uses `fft`, which lanes"
    ):
        erosion.impact(model, P)


def test_many_impacts_of_one_case_are_all_computed():
    """Where no plain number varies, and many threads share the lanes."""
    model, count = network(), 5000
    one = erosion.impact(model, P).volume
    same = erosion.impact(model, P.replace(alpha=np.broadcast_to(P.alpha, count)))
    assert np.all(same.volume == one)
    weights, rest = eqx.partition(model, eqx.is_array)
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), weights)
    volumes = jax.vmap(lambda weights: erosion.volume(eqx.combine(weights, rest), P))(many)
    assert np.asarray(volumes) == pytest.approx(float(one), rel=1e-8, abs=0)


class Pair(NamedTuple):
    """Numbers that are no own parameters, for they are no field of a model."""

    one: float
    rows: Any


class Paired(erosion.models.ForceLaw):
    """F_x = -c·depth·one, with an array beside it that nothing reads."""

    pair: Pair = Pair(1.0, np.ones(3))

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * tip.depth * self.pair.one
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


def test_a_field_may_be_a_named_tuple():
    model = erosion.models.Rotating(force=Paired())
    assert erosion.impact(model, P).volume == pytest.approx(erosion.impact("rotating", P).volume, rel=1e-9, abs=0)


class TwoLayers(erosion.models.ForceLaw):
    """F_x = -c·depth·exp(v·tanh(w depth/r + b)), the weights as plain arrays."""

    w: Any
    b: Any
    v: Any

    def __call__(self, state, tip, p):
        factor = jnp.exp(self.v @ jnp.tanh(self.w * (tip.depth / p.r) + self.b))
        horizontal = -p.stiffness * tip.depth * factor
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


def test_plain_gradient_descent_under_jit_learns_a_force():
    p, angles = P.replace(psi=0.2), np.deg2rad(np.linspace(4, 34, 8))
    truth = erosion.load_model("models/saturating_lip.py").replace(reach=0.3)
    measured = erosion.impact(truth, p.replace(alpha=angles)).volume

    def loss(layers):
        model = erosion.models.Rotating(force=TwoLayers(*layers))
        volumes = jax.vmap(lambda alpha: erosion.volume(model, p.replace(alpha=alpha)))(angles)
        return jnp.mean(jnp.log(volumes / measured) ** 2)

    @jax.jit
    def descend(layers):
        value, slopes = jax.value_and_grad(loss)(layers)
        return value, jax.tree.map(lambda layer, slope: layer - 0.2 * slope, layers, slopes)

    random = np.random.default_rng(0)
    layers = (jnp.array(2 * random.normal(size=4)), jnp.array(random.normal(size=4)), jnp.zeros(4))
    value = before = float(descend(layers)[0])
    for _ in range(300):
        value, layers = descend(layers)
    assert before > 0.25**2
    assert value < 0.1**2
