"""Force laws that are more than a formula: a loop, a table, a small network; against scipy.

Kinked force laws: the volume of every impact is right; derivatives are right or said to be missing.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import erosion
from erosion.impacts.batch import split
from erosion.parameters.parameters import QUANTITIES
from tests.fine_steps import scipy_cut
from tests.kinked_laws import KNOTS_OF, Breaking, Cond, KinkedTable, Power, Where, model_of, random_impacts

P = erosion.TABLE_1.to("si")


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
            assert slope[i] == pytest.approx((ends[1] - ends[0]) / 2e-4, rel=1e-5, abs=1.6e-17)


def test_what_lanes_cannot_do_names_the_models_method():
    class Spectral(erosion.models.ForceLaw):
        def __call__(self, state, tip, p):
            horizontal = -p.stiffness * jnp.fft.fft(jnp.stack([tip.depth, 0.0])).real[1]
            return horizontal, p.k * horizontal

        def typical_ratio(self, p):
            return p.k

    model = erosion.models.Rotating(force=Spectral())
    with pytest.raises(ValueError, match=r"`Spectral.__call__` .*`fft`"):
        erosion.impact(model, P)


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


# Every registered model's are compared with coarser differences in its contract.
@pytest.mark.parametrize("name", ["rotating-velocity-aligned", "implicit", "network"])
def test_derivatives_are_differences(name):
    # Away from jumps: one angle, one spin; steps that balance rounding and truncation.
    model = LAWS[name]() if name in LAWS else name
    p, h = P.replace(phidot0=0.1 * P.v0 / P.r), 1e-3
    hit = erosion.impact(model, p.replace(alpha=0.3 + h * np.arange(-4, 5)), derivatives=2, rtol=1e-12)
    first = np.dot([3, -32, 168, -672, 0, 672, -168, 32, -3], hit.volume) / (840 * h)
    second = np.dot([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9], hit.volume) / (5040 * h**2)
    assert hit.dvolume[4] == pytest.approx(first, rel=1e-8, abs=0)
    assert hit.d2volume[4] == pytest.approx(second, rel=1e-5, abs=0)


def test_several_parameters_make_a_symmetric_hessian():
    names = ("alpha", "k", "r")
    hit = erosion.impact("rotating", P, derivatives=2, wrt=names)
    assert hit.dvolume.shape == (3,)
    assert hit.d2volume.shape == (3, 3)
    assert np.array_equal(hit.d2volume, hit.d2volume.T)
    h = 1e-4
    up, down = (erosion.impact("rotating", P.replace(k=2 + d), derivatives=1, wrt=names, rtol=1e-12) for d in (h, -h))
    assert hit.d2volume[1] == pytest.approx((up.dvolume - down.dvolume) / (2 * h), rel=1e-6, abs=0)


@pytest.mark.parametrize("name", ["linearized", "rotating", "rotating-tan-alpha-full-torque"])
def test_gradient_obeys_the_scaling_law(name):
    # V has the dimensions of length³; with V = V* f(α, k, rω/v₀, rφ̇₀/v₀, β), scaling any base
    # unit scales V as its dimension says (Euler's theorem for homogeneous functions).
    p = P.replace(phidot0=5000.0)
    names = tuple(QUANTITIES)
    hit = erosion.impact(name, p, derivatives=1, wrt=names)
    scaled = {n: g * float(getattr(p, n)) for n, g in zip(names, hit.dvolume, strict=True)}
    length = scaled["r"] + scaled["b"] + scaled["v0"] - scaled["sigma"]
    time = -scaled["v0"] - scaled["phidot0"] - 2 * scaled["sigma"]
    mass = scaled["m"] + scaled["sigma"]
    assert length == pytest.approx(3 * hit.volume, rel=1e-8, abs=0)
    assert time == pytest.approx(0, abs=1e-8 * hit.volume)
    assert mass == pytest.approx(0, abs=1e-8 * hit.volume)


CONTINUOUS = [KinkedTable, Where, Cond, Power]


def _case(p: erosion.Parameters, i: int) -> erosion.Parameters:
    return p.replace(**{q: float(getattr(p, q)[i]) for q in ("alpha", "k", "phidot0", "v0")})


@pytest.mark.parametrize("law", [KinkedTable, Where, Cond, Breaking], ids=lambda law: law.__name__)
def test_volumes_are_scipys_started_anew_at_the_kinks(law):
    p = random_impacts(3, seed=3)
    hit = erosion.impact(model_of(law), p)
    for i in range(3):
        volume, ended_by, _ = scipy_cut(model_of(law), _case(p, i), KNOTS_OF[law])
        assert hit.ended_by[i] == ended_by
        assert hit.volume[i] == pytest.approx(volume, rel=2e-8)


@pytest.mark.parametrize("law", [*CONTINUOUS, Breaking], ids=lambda law: law.__name__)
def test_every_impact_has_its_volume_to_every_order(law):
    p = random_impacts(300 if law is KinkedTable else 1000, seed=1)  # each knot takes as long as another impact
    exact = erosion.impact(model_of(law), p, rtol=1e-12)
    assert set(exact.ended_by) == {"rebound", "stop", "no-cut"}
    for order in (0, 2):
        hit = erosion.impact(model_of(law), p, derivatives=order)
        assert np.array_equal(hit.ended_by, exact.ended_by)
        error = np.abs(hit.volume - exact.volume) / np.maximum(exact.volume, 1.6e-17)
        # A step's error estimates may miss a kink by chance: of 600,000 impacts of `Where` one was off by 2.4e-7.
        assert np.max(error) < 1e-8


def _differences(model, p, step=1e-5):
    """V' and V'' by central differences of V and V', and where both ends are alike."""
    low, high = (erosion.impact(model, p.replace(alpha=p.alpha + way * step), derivatives=1, rtol=1e-12)
                 for way in (-1, 1))  # fmt: skip
    alike = (low.ended_by == high.ended_by) & (low.ended_by != "no-cut")
    return (high.volume - low.volume) / (2 * step), (high.dvolume - low.dvolume) / (2 * step), alike


@pytest.mark.parametrize("law", CONTINUOUS, ids=lambda law: law.__name__)
def test_derivatives_across_kinks_are_differences(law):
    model, p = model_of(law), random_impacts(200 if law is KinkedTable else 500, seed=1)
    hit = erosion.impact(model, p, derivatives=2)
    first, second, alike = _differences(model, p)
    # Where V'' is infinite nearby two integrations may differ by more than 1e-6 of it.
    assert np.sum(hit.no_derivatives) <= 1
    alike &= ~hit.no_derivatives
    size = np.abs(first) + hit.volume
    slopes = np.abs(hit.dvolume - first)[alike] / size[alike]
    curves = np.abs(hit.d2volume - second)[alike] / (np.abs(second) + size)[alike]
    # A difference near an angle at which the tip just reaches a kink is wrong itself: V'' is infinite there.
    assert np.quantile(slopes, 0.98) < 1e-6
    assert np.quantile(curves, 0.98) < 1e-4
    assert np.median(curves) < 1e-7


def test_where_the_force_jumps_derivatives_are_differences():
    model, p = model_of(Breaking), random_impacts(500, seed=1)
    hit = erosion.impact(model, p, derivatives=2)
    first, second, alike = _differences(model, p)
    assert not np.any(hit.no_derivatives)
    size = np.abs(first) + hit.volume
    slopes = np.abs(hit.dvolume - first)[alike] / size[alike]
    curves = np.abs(hit.d2volume - second)[alike] / (np.abs(second) + size)[alike]
    # A difference near an angle at which the tip just reaches the jump is wrong itself.
    assert np.quantile(slopes, 0.98) < 1e-6
    assert np.quantile(curves, 0.95) < 1e-4


def test_first_derivatives_remain_where_only_the_second_fails():
    class Rooted(erosion.models.RigidParticle):
        """`linearized` with an end that moves as |α - 0.2|^1.5."""

        kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
        force: erosion.models.ForceLaw = erosion.models.ConstantRatio()
        torque: erosion.models.Torque = erosion.models.NoTorque()

        def events(self, state, p):
            shift = jax.numpy.sqrt(jax.numpy.abs(p.alpha - 0.2)) ** 3
            return {"rebound": state.y / self.scales(p).length + shift * state.vx / p.v0}

    hit = erosion.impact(Rooted(), erosion.TABLE_1.replace(alpha=[0.2, 0.3]), derivatives=2)
    assert list(hit.ended_by) == ["rebound", "rebound"]
    assert list(np.atleast_1d(hit.no_derivatives)) == [True, False]
    assert list(np.isnan(hit.d2volume)) == [True, False]


@pytest.mark.parametrize("name", [name for name in erosion.available_models() if "/" not in name])
def test_only_laws_that_break_pay_for_switches(name):
    assert not split(erosion.load_model(name), erosion.TABLE_1)[0].options.switches


class Iterated(erosion.models.ForceLaw):
    """The law of `Implicit`, of whose loop nothing tells that it is smooth."""

    def __call__(self, state, tip, p):
        target = 2 + (tip.depth / p.r) ** 2
        u = lax.while_loop(
            lambda u: jnp.abs(u**3 + u - target) > 1e-14 * target,
            lambda u: u - (u**3 + u - target) / (3 * u**2 + 1),
            1.0 + 0 * target,
        )
        return -p.stiffness * tip.depth * u, -p.k * p.stiffness * tip.depth * u

    def typical_ratio(self, p):
        return p.k


def test_a_law_whose_breaks_cannot_be_located_is_refused():
    with pytest.raises(ValueError, match=r"within a loop.*custom_jvp"):
        erosion.impact(erosion.models.Rotating(force=Iterated()), P)
