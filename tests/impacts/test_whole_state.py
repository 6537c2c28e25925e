"""The whole state at the end of a cut, and a model's cut as a problem of `erosion.ode`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion import ode
from erosion.impacts.simulate import path as follow
from erosion.models.base import CuttingModel, Tip
from erosion.plotting.motion import plot_trajectory

ALPHAS = np.linspace(0.05, 1.5, 7)
P = erosion.TABLE_1.replace(k=1.0, alpha=ALPHAS)
SPUN = P.replace(phidot0=np.array([0.0, 500.0, -500.0, 0.0, 2000.0, 0.0, 50.0]))


@pytest.mark.parametrize("name", ["linearized", "velocity-aligned"])
def test_the_state_is_that_of_the_closed_form(name: str) -> None:
    model = erosion.load_model(name)
    hit = erosion.impact(model, P)
    closed = model.closed_form()
    assert closed is not None
    exact = closed.state(np.asarray(hit.t_c), P)
    sizes = (P.r, P.r, 1.0, P.v0, P.v0, P.v0 / P.r)
    for found, expected, size in zip(jax.tree.leaves(hit.state), jax.tree.leaves(exact), sizes, strict=True):
        assert np.allclose(found, expected, rtol=1e-9, atol=1e-10 * float(size))


def test_the_state_is_that_of_the_independent_engine() -> None:
    model = erosion.load_model("rotating")
    hit = erosion.impact(model, SPUN)
    for i in range(0, ALPHAS.size, 3):
        one = erosion.TABLE_1.replace(k=1.0, alpha=ALPHAS[i], phidot0=SPUN.phidot0[i])
        path = erosion.simulate(model, one)
        for found, expected in zip(jax.tree.leaves(hit.state), jax.tree.leaves(path.states), strict=True):
            assert found[i] == pytest.approx(float(expected[-1]), rel=1e-8, abs=1e-11 * np.max(np.abs(expected)))


def test_the_state_moves_with_the_parameters() -> None:
    model = erosion.load_model("rotating")
    hit = erosion.impact(model, SPUN, wrt=("alpha", "k"), derivatives=2)
    assert np.allclose(hit.end.integrals["volume"], hit.volume, rtol=1e-9)
    assert np.allclose(hit.end.along("alpha", "k").integrals["volume"], hit.d2volume[:, 0, 1], rtol=1e-6)
    h = 1e-5
    up, down = (erosion.impact(model, SPUN.replace(alpha=ALPHAS + s * h), wrt="k", derivatives=1).end for s in (1, -1))
    for name in ("vx", "vy", "omega", "phi", "x"):
        first, mixed = hit.end.along("alpha").y, hit.end.along("alpha", "k").y
        assert np.allclose(getattr(first, name), (getattr(up.y, name) - getattr(down.y, name)) / (2 * h), rtol=1e-5)
        of_k = (getattr(up.along("k").y, name) - getattr(down.along("k").y, name)) / (2 * h)
        assert np.allclose(getattr(mixed, name), of_k, rtol=1e-4, atol=1e-4 * np.max(np.abs(of_k)))


class Melting(CuttingModel):
    """Straight, with a heat of its own: two further states, one of them in a dictionary of arrays' names."""

    def initial_state(self, p):
        return {"x": 0.0, "y": 0.0, "vx": p.v0 * jnp.cos(p.alpha), "vy": p.v0 * jnp.sin(p.alpha), "heat": 0.0}

    def derivative(self, state, p):
        force = -p.stiffness * state["y"]
        power = -force * state["vx"]
        return {"x": state["vx"], "y": state["vy"], "vx": force / p.m, "vy": p.k * force / p.m, "heat": power}

    def tip(self, state, p):
        return Tip(state["x"], state["y"], state["vx"], state["vy"])


def test_a_state_of_a_model_s_own_is_balanced() -> None:
    """The heat is the loss of ½ m ẋ², at every end; its derivative is that of the loss."""
    hit = erosion.impact(Melting(), P, derivatives=1)
    lost = 0.5 * P.m * ((P.v0 * np.cos(ALPHAS)) ** 2 - np.asarray(hit.state["vx"]) ** 2)
    assert np.allclose(hit.state["heat"], lost, rtol=1e-8)
    slope = hit.end.along("alpha").y
    of_loss = -P.m * (P.v0**2 * np.cos(ALPHAS) * np.sin(ALPHAS) + hit.state["vx"] * slope["vx"])
    assert np.allclose(slope["heat"], of_loss, rtol=1e-6, atol=1e-6 * np.max(np.abs(of_loss)))


def test_a_state_of_a_model_s_own_is_shown_and_drawn() -> None:
    one = erosion.TABLE_1.replace(k=1.0, alpha=0.3)
    cut, hit = erosion.simulate(Melting(), one), erosion.impact(Melting(), one)
    shown = {row.name: row.value for row in cut.rows()}
    assert "turn" not in shown
    assert float(shown["heat"]) == pytest.approx(float(hit.state["heat"]), rel=1e-6)
    assert cut.to_dict()["state"]["heat"] == pytest.approx(float(hit.state["heat"]), rel=1e-8)
    assert "nan" not in str(cut)
    lines = [np.asarray(line.get_ydata(), float) for axes in plot_trajectory(cut).axes for line in axes.lines]
    assert sum(line.size == cut.t.size and bool(np.isfinite(line).all()) for line in lines) >= 2


def test_one_impact_and_one_that_cuts_nothing() -> None:
    assert np.shape(erosion.impact("rotating", erosion.TABLE_1).state.omega) == ()
    nothing = erosion.impact("rotating", erosion.TABLE_1.replace(alpha=0.05, phidot0=-1e6), derivatives=1)
    assert nothing.ended_by == "no-cut"
    assert nothing.state.x == 0
    assert nothing.state.omega == -1e6
    failed = erosion.impact("rotating", erosion.TABLE_1.replace(alpha=np.array([np.nan, 0.3])))
    assert np.isnan(failed.state.vx[0])
    assert failed.state.vx[1] > 0


@pytest.mark.parametrize("name", ["linearized", "rotating", "rotating-deformation", "tan-alpha"])
def test_a_model_s_problem_ends_as_its_impact(name: str) -> None:
    model = erosion.load_model(name)
    hit = erosion.impact(model, SPUN, derivatives=2)
    end = ode.solve(model.problem(), SPUN, start="end", wrt="alpha", derivatives=2)
    assert np.allclose(end.integrals["volume"], hit.volume, rtol=1e-9)
    assert np.allclose(end.t, hit.t_c, rtol=1e-9)
    assert np.allclose(end.along("alpha", "alpha").integrals["volume"], hit.d2volume, rtol=1e-5)
    assert [{"start": "no-cut"}.get(word, word) for word in end.ended_by] == hit.ended_by.tolist()


def test_a_second_cut_adds_to_the_first() -> None:
    """The chain of the notebook: the tip leaves at 10°, and enters again (scipy's DOP853 at 1e-12, typed once more)."""
    model = erosion.load_model("rotating")

    def depth(t, y, p):
        return model.tip(y["body"], p).depth

    def field(t, y, p):
        body, zero = y["body"], 0.0 * y["body"].x
        free = type(body)(body.vx, body.vy, body.omega, zero, zero, zero)
        on = y["cutting"] > 0.5
        return {
            "body": jax.tree.map(lambda a, b: jnp.where(on, a, b), model.derivative(body, p), free),
            "cutting": zero,
        }

    chain = ode.Problem(
        y0=lambda p: {"body": model.initial_state(p), "cutting": 1.0},
        vector_field=field,
        events={
            "leaves": ode.Event(depth, -1, reset=lambda t, y, p: y | {"cutting": 0.0}),
            "enters": ode.Event(depth, +1, reset=lambda t, y, p: y | {"cutting": 1.0}),
            "away": ode.Event(lambda t, y, p: y["body"].y + 1.5 * p.r, -1),
        },
        integrals={"volume": lambda t, y, p: jnp.where(y["cutting"] > 0.5, model.removal_rate(y["body"], p), 0.0)},
    )
    shallow = erosion.TABLE_1.replace(k=1.0, alpha=np.deg2rad(10.0))
    end = ode.solve(chain, shallow, t1=2e-3, smooth=True)
    assert end.ended_by == "away"
    assert end.events.name.tolist() == ["leaves", "enters", "leaves", "away"]
    known = [5.9673558537978376e-05, 0.00016149721385257435, 0.00019475525776928046, 0.00036676674232124124]
    assert np.allclose(end.events.t, known, rtol=1e-9)
    assert end.integrals["volume"] / erosion.impact(model, shallow).volume == pytest.approx(1.19199967051142, rel=1e-9)


def test_the_motion_of_a_slow_sphere_is_known_to_the_last_digit() -> None:
    """At 45° a derivative of the state vanishes: a tolerance of 1e-12 of itself would be below rounding."""
    sphere = erosion.Parameters(
        k=10, psi=1, r=2.5e-3, b=2.5e-3, m=5.13781e-4, v0=11.983, sigma=6.3146e8, alpha=np.pi / 4, units="si"
    )
    path = erosion.simulate("linearized", sphere)
    fast = follow(erosion.load_model("linearized"), sphere)
    assert fast.volume == pytest.approx(path.volume, rel=1e-10)
