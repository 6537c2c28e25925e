import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.parameters import QUANTITIES
from tests.reference import AT_20_DEGREES, closed_form

P = erosion.TABLE_1
ANGLES = np.deg2rad(np.linspace(0.3, 89.9, 300))
SPINS = np.linspace(-0.9, 0.9, 7)


@pytest.mark.parametrize("name", [n for n in AT_20_DEGREES if n.startswith("rotating")])
def test_derivatives_equal_differences(name):
    # Away from jumps: one angle, one spin; steps that balance rounding and truncation.
    p = P.replace(phidot0=0.1 * P.v0 / P.r)
    h = 1e-3
    hit = erosion.impact(name, p.replace(alpha=0.3 + h * np.arange(-4, 5)), derivatives=2, rtol=1e-12)
    v = hit.volume
    first = np.dot([3, -32, 168, -672, 0, 672, -168, 32, -3], v) / (840 * h)
    second = np.dot([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9], v) / (5040 * h**2)
    assert hit.dvolume[4] == pytest.approx(first, rel=1e-8)
    assert hit.d2volume[4] == pytest.approx(second, rel=1e-5)


def test_several_parameters_make_a_symmetric_hessian():
    names = ("alpha", "k")
    hit = erosion.impact("linearized", P.replace(alpha=[0.3, 1.2]), derivatives=2, wrt=names)
    assert hit.dvolume.shape == (2, 2)
    assert np.array_equal(hit.d2volume, np.swapaxes(hit.d2volume, 1, 2))
    volume = closed_form("linearized").volume
    for i, alpha in enumerate((0.3, 1.2)):
        at = [jnp.float64(alpha), jnp.float64(P.k)]
        value = lambda *q: volume(P.replace(**dict(zip(names, q, strict=True))))  # noqa: E731
        assert hit.dvolume[i] == pytest.approx(np.array(jax.grad(value, (0, 1))(*at)), rel=1e-8)
        hessian = np.array(jax.hessian(value, (0, 1))(*at))
        # Relative to the derivatives' own scales: one of them vanishes.
        scales = np.abs(np.outer(1 / np.array(at), 1 / np.array(at))) * hit.volume[i]
        assert np.all(np.abs(hit.d2volume[i] - hessian) <= 1e-8 * scales)


def test_mixed_derivatives_with_rotation_equal_differences():
    h = 1e-4
    mixed = erosion.impact("rotating", P, derivatives=2, wrt=("alpha", "k")).d2volume[0, 1]
    near = erosion.impact("rotating", P.replace(k=2 + h * np.array([-1, 1])), derivatives=2, rtol=1e-12).dvolume
    assert mixed == pytest.approx((near[1] - near[0]) / (2 * h), rel=1e-6)


@pytest.mark.parametrize("name", ["linearized", "rotating", "rotating-tan-alpha-full-torque"])
def test_gradient_obeys_the_scaling_law(name):
    # V has the dimensions of length³; with V = V* f(α, k, rω/v₀, rφ̇₀/v₀, β), scaling any base
    # unit scales V as its dimension says (Euler's theorem for homogeneous functions).
    p = P.replace(phidot0=5000.0)
    volume, slopes = jax.device_get(jax.jit(jax.value_and_grad(lambda p: erosion.volume(name, p)))(p))
    scaled = {n: float(getattr(slopes, n)) * float(getattr(p, n)) for n in QUANTITIES}
    length = scaled["r"] + scaled["b"] + scaled["v0"] - scaled["sigma"]
    time = -scaled["v0"] - scaled["phidot0"] - 2 * scaled["sigma"]
    mass = scaled["m"] + scaled["sigma"]
    assert length == pytest.approx(3 * volume, rel=1e-8)
    assert time == pytest.approx(0, abs=1e-8 * volume)
    assert mass == pytest.approx(0, abs=1e-8 * volume)


@pytest.mark.parametrize("transform", ["grad", "jacfwd", "jacrev"])
def test_volume_differentiates_once(transform):
    exact = closed_form("linearized")
    slope = jax.jit(getattr(jax, transform)(lambda a: erosion.volume("linearized", P.replace(alpha=a))))
    for alpha in (0.2, 0.7853, 1.2):
        assert slope(alpha) == pytest.approx(float(exact.dvolume(P.replace(alpha=alpha))), rel=1e-9)


@pytest.mark.parametrize("outer", [jax.grad, jax.jacfwd])
@pytest.mark.parametrize("inner", [jax.grad, jax.jacfwd])
def test_volume_differentiates_twice(outer, inner):
    exact = closed_form("finnie")
    curvature = jax.jit(outer(inner(lambda a: erosion.volume("finnie", P.replace(alpha=a)))))
    for alpha in (0.2, 0.7):  # on both sides of the cusp at 0.32
        assert curvature(alpha) == pytest.approx(float(exact.d2volume(P.replace(alpha=alpha))), rel=1e-8)


def test_volume_maps_and_takes_gradients_of_everything():
    batch = jax.jit(jax.vmap(lambda a: erosion.volume("rotating", P.replace(alpha=a))))(jnp.asarray([0.2, 0.3]))
    assert batch == pytest.approx(erosion.impact("rotating", P.replace(alpha=[0.2, 0.3])).volume, rel=1e-9)
    gradient = jax.jit(jax.grad(lambda p: erosion.volume("rotating", p)))(P)
    names = ("k", "alpha", "phidot0")
    hit = erosion.impact("rotating", P, derivatives=1, wrt=names)
    found = [float(getattr(gradient, name)) for name in names]
    assert found == pytest.approx(hit.dvolume, rel=1e-7)


def test_third_derivatives_say_that_they_are_missing():
    with pytest.raises(NotImplementedError, match="third"):
        jax.make_jaxpr(jax.grad(jax.grad(jax.grad(lambda a: erosion.volume("linearized", P.replace(alpha=a))))))(0.3)
