"""Every model, built in or a file in models/, keeps what `CuttingModel` promises."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.models import event_rates

P = erosion.TABLE_1.to("si")
FILES = sorted(Path(__file__).parents[2].joinpath("models").glob("*.py"))
EXPONENTS = ("finnie-exponent", "rotating-deformation-exponent")
NAMES = [*erosion.available_models(), *EXPONENTS, *map(str, FILES)]
CASES = [P, P.replace(alpha=0.9, phidot0=0.3 * P.v0 / P.r), P.to("si").replace(alpha=0.1)]


# Once a file: loaded again it is another class, and JAX compiles it again.
load_model = functools.cache(erosion.load_model)


@pytest.fixture(params=NAMES, ids=lambda name: Path(name).name)
def model(request):
    return load_model(request.param)


def test_states_and_rates_have_one_structure(model):
    for p in CASES:
        state = model.initial_state(p)
        rate = model.derivative(state, p)
        assert jax.tree.structure(state) == jax.tree.structure(rate)
        for leaf in jax.tree.leaves((state, rate)):
            assert jnp.shape(leaf) == ()
            assert jnp.asarray(leaf).dtype == jnp.float64
            assert np.isfinite(leaf)


def test_the_tip_starts_at_the_surface_and_goes_in(model):
    for p in CASES:
        tip = model.tip(model.initial_state(p), p)
        assert tip.depth == pytest.approx(0, abs=1e-15 * float(p.r))
        assert tip.vdepth > 0


def test_tip_velocity_is_the_rate_of_its_position(model):
    for p in CASES:
        state = model.initial_state(p)
        # A state away from contact, so that no rate is trivially zero.
        state = jax.tree.map(lambda s, k, p=p: s + 0.3 * model.scales(p).time * k, state, model.derivative(state, p))
        rate = model.derivative(state, p)
        tip, flow = jax.jvp(lambda s, p=p: model.tip(s, p), (state,), (rate,))
        assert flow.x == pytest.approx(float(tip.vx), rel=1e-12)
        assert flow.depth == pytest.approx(float(tip.vdepth), rel=1e-12, abs=1e-12 * float(p.v0))


def test_events_are_of_order_one_and_begin_positive(model):
    for p in CASES:
        state = model.initial_state(p)
        assert min(model.scales(p)) > 0
        values, rates = event_rates(model, state, model.derivative(state, p), p)
        for name, value in values.items():
            assert 0 <= value < 100, name
            assert value > 0 or rates[name] > 0, name


# Built-in models are followed by both in tests/impacts/test_simulate.py and test_impact.py.
@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
@pytest.mark.filterwarnings("ignore::erosion.impacts.trajectory.TurnWarning")
def test_both_engines_follow_a_plug_in_to_the_same_end(file):
    model = load_model(str(file))
    for p in CASES[:2]:
        cut = erosion.simulate(model, p, points=2)
        hit = erosion.impact(model, p)
        assert hit.ended_by == cut.ended_by
        assert hit.volume == pytest.approx(cut.volume, rel=2e-9, abs=0)
        assert hit.t_c == pytest.approx(cut.t_c, rel=2e-9, abs=0)


def test_derivatives_fit_differences(model):
    h = 1e-5
    hit = erosion.impact(model, P, derivatives=2, rtol=1e-12)
    near = erosion.impact(model, P.replace(alpha=P.alpha + h * np.array([-1, 1])), derivatives=2, rtol=1e-12)
    assert hit.dvolume == pytest.approx((near.volume[1] - near.volume[0]) / (2 * h), rel=1e-6)
    assert hit.d2volume == pytest.approx((near.dvolume[1] - near.dvolume[0]) / (2 * h), rel=1e-6)


def test_closed_forms_are_complete(model):
    exact = model.closed_form()
    if exact is None:
        return

    @jax.jit
    def looks(p):
        """Rates by the motion and by the model; derivatives of the volume by its functions and by JAX."""
        t = 0.4 * exact.t_c(p)
        state, rate = jax.jvp(lambda t: exact.state(t, p), (t,), (jnp.ones_like(t),))
        by_jax = [jax.grad(lambda a, f=f: f(p.replace(alpha=a)))(p.alpha) for f in (exact.volume, exact.dvolume)]
        return (rate, model.derivative(state, p)), ([exact.dvolume(p), exact.d2volume(p)], by_jax)

    for p in CASES:
        (rate, expected), (slopes, by_jax) = looks(p)
        for name in ("x", "y", "phi", "vx", "vy", "omega"):
            assert getattr(rate, name) == pytest.approx(float(getattr(expected, name)), rel=1e-11, abs=1e-12), name
        np.testing.assert_allclose(slopes, by_jax, rtol=1e-12)
