"""`erosion.volume`: what JAX may do with it, and which derivatives are integrated for it.

The code of tests/golden-numbers.md: its tables against a second solver, and against the package.
"""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.parameters.parameters import QUANTITIES
from tests.reference import closed_form

P = erosion.TABLE_1.to("si")
MODEL = erosion.load_model("linearized")


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
    volumes = jax.jit(jax.vmap(lambda a: erosion.volume("rotating", P.replace(alpha=a))))(jnp.asarray([0.2, 0.3]))
    assert volumes == pytest.approx(erosion.impact("rotating", P.replace(alpha=[0.2, 0.3])).volume, rel=1e-9)
    gradient = jax.jit(jax.grad(lambda p: erosion.volume("rotating", p)))(P)
    hit = erosion.impact("rotating", P, derivatives=1, wrt=tuple(QUANTITIES))
    slopes = [float(getattr(gradient, name)) for name in QUANTITIES]
    assert slopes == pytest.approx(hit.dvolume, rel=1e-7)


class Waves(erosion.models.ForceLaw):
    """F_x = -c f (1 + g depth/r) (1 + Σ wᵢ sin(i depth/r)) depth, F_y = k F_x."""

    weights: jax.Array
    factor: jax.Array
    growth: jax.Array

    def __call__(self, state, tip, p):
        depth = tip.depth / p.r
        waves = jnp.sum(self.weights * jnp.sin(jnp.arange(20.0) * depth))
        factor = self.factor * (1 + self.growth * depth) * (1 + waves)
        horizontal = -p.stiffness * factor * tip.depth
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


def test_a_model_learns_an_array_of_weights_from_many_angles():
    """Twenty weights and three angles: shapes that no one may put together."""
    weights, angles = 0.01 * jnp.arange(20.0), jnp.array([0.2, 0.3, 0.4])

    def total(weights):
        model = erosion.models.Rotating(force=Waves(weights, jnp.array(1.0), jnp.array(2.0)))
        return jnp.sum(jax.vmap(lambda alpha: erosion.volume(model, P.replace(alpha=alpha)))(angles))

    one, step = jnp.eye(20)[2], 1e-4
    slope = (total(weights + step * one) - total(weights - step * one)) / (2 * step)
    assert jax.jit(jax.grad(total))(weights)[2] == pytest.approx(float(slope), rel=1e-6)


def test_third_derivatives_say_that_they_are_missing():
    with pytest.raises(NotImplementedError, match="third"):
        jax.make_jaxpr(jax.grad(jax.grad(jax.grad(lambda a: erosion.volume("linearized", P.replace(alpha=a))))))(0.3)


def test_a_volume_that_was_asked_for_compiles_nothing_more():
    def slope(alpha):
        return jax.grad(lambda a: erosion.volume("rotating", P.replace(alpha=a)))(alpha)

    compiled = []

    def listen(event, *_, **__):
        if "backend_compile" in event:
            compiled.append(event)

    first = erosion.volume("rotating", P), slope(0.3)
    jax.monitoring.register_event_duration_secs_listener(listen)
    later = erosion.volume("rotating", P.replace(k=1.5)), slope(0.4)
    assert not compiled
    assert first != later
    jax.jit(lambda x: x + 1.25)(1.0)
    assert compiled


def test_volumes_of_many_angles_are_the_impacts():
    angles = np.linspace(0.05, 1.5, 300)
    hits = erosion.impact("rotating", P.replace(alpha=angles), derivatives=2, rtol=1e-11)

    def one(alpha):
        return erosion.volume("rotating", P.replace(alpha=alpha))

    assert np.array_equal(
        jax.jit(jax.vmap(one))(angles), erosion.impact("rotating", P.replace(alpha=angles), rtol=1e-11).volume
    )
    assert np.asarray(jax.jit(jax.vmap(jax.grad(one)))(angles)) == pytest.approx(
        hits.dvolume, rel=1e-9, abs=2e-10 * np.abs(hits.dvolume).max()
    )
    nested = jax.vmap(jax.vmap(one))(angles.reshape(3, 100))
    assert np.asarray(nested).ravel() == pytest.approx(hits.volume, rel=1e-9)


def test_mixed_derivatives_are_those_of_the_closed_form() -> None:
    def slopes(volume):
        of = lambda alpha, k: volume(P.replace(alpha=2 * alpha, k=k))  # noqa: E731
        return jax.jit(jax.jacfwd(jax.grad(of, (0, 1)), (0, 1)))(0.1, 2.0)

    found, exact = slopes(lambda p: erosion.volume(MODEL, p)), slopes(closed_form("linearized").volume)
    assert np.asarray(found) == pytest.approx(np.asarray(exact), rel=1e-8)


def test_what_fails_is_not_a_number() -> None:
    assert np.isnan(erosion.volume(MODEL, P.replace(m=np.inf)))
    assert erosion.volume(MODEL, P.replace(alpha=np.pi / 2)) == 0


PAGE = Path(__file__).parents[1] / "golden-numbers.md"


def test_the_golden_numbers_are_those_of_two_solvers(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL))
    assert code.count("assert ") > 15
    monkeypatch.chdir(PAGE.parent)  # the page reads its own tables
    exec(compile(code, str(PAGE), "exec"), {})
