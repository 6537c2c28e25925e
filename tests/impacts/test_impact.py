import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.impacts.impact import element_of, end_names, split
from erosion.ode import batch
from erosion.ode.batch import integrate
from tests.reference import CLOSED, closed_form

P = erosion.TABLE_1
ANGLES = np.deg2rad(np.linspace(0.3, 89.9, 300))
SPINS = np.linspace(-0.9, 0.9, 7)


@pytest.mark.parametrize("name", CLOSED)
def test_everything_equals_the_closed_form(name):
    p = P.replace(alpha=ANGLES)
    exact = closed_form(name)
    hit = erosion.impact(name, p, derivatives=2)
    volume = np.asarray(exact.volume(p))
    assert np.all(hit.ended_by == exact.ended_by(p))
    assert hit.volume == pytest.approx(volume, rel=1e-9, abs=0)
    assert hit.t_c == pytest.approx(np.asarray(exact.t_c(p)), rel=1e-9, abs=0)
    for found, true in ((hit.dvolume, exact.dvolume(p)), (hit.d2volume, exact.d2volume(p))):
        # Relative to the derivative, or where it passes through zero to the volume.
        size = np.maximum(np.abs(true), volume)
        assert np.all(np.abs(found - np.asarray(true)) <= 1e-8 * size)


@pytest.mark.parametrize("name", CLOSED)
def test_volumes_hold_down_to_grazing_impacts(name):
    # Derivatives here are small differences of numbers 1/α times larger, so they lose digits.
    p = P.replace(alpha=np.geomspace(1e-6, 1e-2, 30))
    assert erosion.impact(name, p).volume == pytest.approx(np.asarray(closed_form(name).volume(p)), rel=1e-9, abs=0)


def test_at_the_cusp_both_ends_are_right():
    hit = erosion.impact("linearized", P.replace(alpha=np.arctan(1.0)), derivatives=2)
    exact = closed_form("linearized")
    assert hit.ended_by in ("rebound", "stop")
    assert hit.volume == pytest.approx(float(exact.volume(P.replace(alpha=np.pi / 4))), rel=1e-9, abs=0)
    assert hit.dvolume == pytest.approx(float(exact.dvolume(P.replace(alpha=np.pi / 4))), rel=1e-6, abs=0)
    assert np.isfinite(hit.d2volume)


@pytest.mark.parametrize(("name", "ratio"), [("linearized", 2.0), ("finnie", 2 / 3)])
def test_no_wrong_end_near_the_cusp(name, ratio):
    p = P.replace(alpha=np.arctan(ratio / 2) + np.deg2rad(np.linspace(-2, 2, 4000)))
    hit, exact = erosion.impact(name, p), closed_form(name)
    assert np.count_nonzero(hit.ended_by != exact.ended_by(p)) == 0


@pytest.mark.slow
# Each force and each torque once: the contract of models has both engines for every model, at one impact.
@pytest.mark.parametrize(
    "name", ["rotating-full-torque", "rotating-tan-alpha", "rotating-velocity-aligned-full-torque"]
)
def test_both_engines_agree(name):
    import warnings

    rng = np.random.default_rng(7)
    alphas, spins = rng.uniform(0.02, 1.55, 12), rng.uniform(-0.9, 0.9, 12)
    hit = erosion.impact(name, P.replace(alpha=alphas, phidot0=spins * P.v0 / P.r))
    for i, (alpha, s) in enumerate(zip(alphas, spins, strict=True)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cut = erosion.simulate(name, P.replace(alpha=alpha, phidot0=s * P.v0 / P.r), points=2)
        assert hit.ended_by[i] == cut.ended_by
        assert hit.volume[i] == pytest.approx(cut.volume, rel=1e-8, abs=0)
        assert hit.t_c[i] == pytest.approx(cut.t_c, rel=1e-8, abs=0)


def test_a_batch_equals_its_members():
    p = P.replace(alpha=ANGLES[::60, None], phidot0=SPINS * P.v0 / P.r)
    batch = erosion.impact("rotating", p, derivatives=2)
    assert batch.volume.shape == (5, 7)
    for i, j in np.ndindex(5, 7):
        one = erosion.impact("rotating", P.replace(alpha=p.alpha[i, 0], phidot0=p.phidot0[j]), derivatives=2)
        assert batch.ended_by[i, j] == one.ended_by
        for field in ("volume", "t_c", "dvolume", "d2volume"):
            # The same program in the same block: bit for bit.
            assert getattr(batch, field)[i, j] == getattr(one, field)


@pytest.mark.slow
def test_more_lanes_than_a_call_in_order():
    count = 2**17 + 17
    alphas = np.linspace(0.3, 0.31, count)
    hit = erosion.impact("linearized", P.replace(alpha=alphas))
    exact = closed_form("linearized")
    assert hit.volume == pytest.approx(np.asarray(exact.volume(P.replace(alpha=alphas))), rel=1e-9, abs=0)


def test_nothing_is_cut():
    hit = erosion.impact("rotating", P.replace(alpha=[np.pi / 2, 1.0], phidot0=[0.0, -0.9 * P.v0 / P.r]), derivatives=2)
    assert list(hit.ended_by) == ["no-cut", "no-cut"]
    for field in ("volume", "t_c", "dvolume", "d2volume"):
        assert np.all(getattr(hit, field) == 0)


def test_lanes_that_are_not_finite_fail_and_touch_no_other():
    alphas = np.linspace(0.1, 1.4, 40)
    clean = erosion.impact("rotating", P.replace(alpha=alphas), derivatives=2)
    dirty = P.replace(alpha=np.where(np.arange(40) == 7, np.nan, alphas), m=np.where(np.arange(40) == 30, np.inf, P.m))
    hit = erosion.impact("rotating", dirty, derivatives=2)
    bad = np.isin(np.arange(40), (7, 30))
    assert np.all((hit.ended_by == "failed") == bad)
    for field in ("volume", "t_c", "dvolume", "d2volume"):
        assert np.all(np.isnan(getattr(hit, field)) == bad)
        assert np.array_equal(getattr(hit, field)[~bad], getattr(clean, field)[~bad])
    with pytest.raises(ValueError, match="`alpha` must be in"):
        erosion.impact("rotating", P.replace(alpha=np.nan))


def test_an_error_estimate_that_is_zero_by_chance_hides_no_error():
    # Here the volume's estimate in a first step of 0.35/ω was a thousandth of its neighbours'.
    alphas, spins = np.deg2rad(np.linspace(60, 75, 200)), np.linspace(-0.33, -0.24, 50)
    p = P.replace(alpha=alphas, phidot0=spins[:, None] * P.v0 / P.r)
    hit, exact = erosion.impact("rotating", p), erosion.impact("rotating", p, rtol=1e-13)
    assert np.all(hit.ended_by == exact.ended_by)
    # Where the tip hardly moves, no digits are left to compare.
    cuts = np.cos(alphas) + spins[:, None] > 1e-3
    assert hit.volume[cuts] == pytest.approx(exact.volume[cuts], rel=1e-9, abs=0)


def test_a_lane_of_rounding_alone_fails_soon():
    # cos α + s is 1e-8: V′ and V″ have no 13 digits, and a shorter step has no more of them.
    hopeless = P.replace(
        k=1.5871451390844513,
        v0=1088.2481414190745,
        r=0.013939714071078637,
        phidot0=-65955.027033115,
        inertia=0.3040801935815103,
        alpha=0.5645325433252832,
    )
    model = erosion.load_model("rotating")
    layout, numbers = split(model, hopeless)
    results = integrate(layout, numbers, 1, 2, (element_of(model, "alpha"),), 3e-13)
    assert end_names(model)[results.outcome[0]] == "failed"
    assert results.trials < 1000
    assert erosion.impact(model, hopeless, derivatives=2).ended_by == "rebound"


class Brittle(erosion.models.ForceRatio):
    """K = k, but from 57° up not a number once the erodent has slowed down to 0.3 v₀."""

    def ratio(self, state, p):
        return p.k + jnp.where(p.alpha > 1, 0.0 * jnp.sqrt(state.vx / p.v0 - 0.3), 0.0)

    def typical_ratio(self, p):
        return p.k


class Faulty(erosion.models.RigidErodent):
    """Ends as `linearized` does at small angles; above, it never ends, and above that it breaks."""

    kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
    force: erosion.models.ForceLaw = Brittle()
    torque: erosion.models.Torque = erosion.models.NoTorque()

    def events(self, state, p):
        return {"rebound": jnp.where((p.alpha > 0.5) & (p.alpha < 1), 1.0, state.y / self.scales(p).length)}


def test_a_lane_that_never_ends_or_breaks_says_so_alone():
    hit = erosion.impact(Faulty(), P.replace(alpha=[0.2, 0.6, 0.3, 1.1]))
    assert list(hit.ended_by) == ["rebound", "unfinished", "rebound", "failed"]
    assert list(np.isnan(hit.volume)) == [False, True, False, True]
    exact = closed_form("linearized")
    for i in (0, 2):
        assert hit.volume[i] == pytest.approx(
            float(exact.volume(P.replace(alpha=[0.2, 0.6, 0.3, 1.1][i]))), rel=1e-9, abs=0
        )


class Blurred(erosion.models.RigidErodent):
    """`linearized` with an end that is not a number: by spin, never, when slow, at once, in its derivative."""

    kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()
    force: erosion.models.ForceLaw = erosion.models.ConstantRatio()
    torque: erosion.models.Torque = erosion.models.NoTorque()

    def events(self, state, p):
        slow = jnp.where(p.phidot0 == 1, 0.0 * jnp.sqrt(state.vx / p.v0 - 0.8), 0.0)
        never = jnp.where(p.phidot0 == 2, jnp.nan, 0.0)
        bent = jnp.where(p.phidot0 == 3, 0.0 * jnp.sqrt(jnp.abs(p.alpha - 0.2)), 0.0)
        return {"rebound": state.y / self.scales(p).length + slow + never + bent}


def test_an_end_that_is_not_a_number_is_a_failure():
    p = P.replace(alpha=0.2, phidot0=np.arange(4.0))
    hit = erosion.impact(Blurred(), p, derivatives=1)
    assert list(hit.ended_by) == ["rebound", "failed", "failed", "rebound"]
    for field in ("volume", "t_c"):
        assert list(np.isnan(getattr(hit, field))) == [False, True, True, False]
    # The last one has a volume, whose derivative is not a number.
    assert list(np.isnan(hit.dvolume)) == [False, True, True, True]
    assert list(np.atleast_1d(hit.no_derivatives)) == [False, False, False, True]


def test_an_empty_batch_is_empty():
    hit = erosion.impact("rotating", P.replace(alpha=np.zeros((0, 3)) + 0.1))
    assert hit.volume.shape == (0, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrt": "beta"}, "`wrt` must name parameters"),
        ({"wrt": ()}, "`wrt` must name one or several"),
        ({"derivatives": 3}, "`derivatives` must be 0, 1 or 2, but is 3"),
        ({"rtol": 0.0}, r"`rtol` must be in \(0, 1\)"),
    ],
)
def test_bad_arguments_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        erosion.impact("rotating", P, **options)


def test_results_print_with_units():
    several = erosion.impact("linearized", P, derivatives=2, wrt=("alpha", "v0"))
    units = {row.symbol: row.unit for row in several.rows()[3:]}
    assert units == {
        "∂V/∂α": "in³/°", "∂V/∂v₀": "in³/(in/s)",
        "∂²V/∂α²": "in³/°²", "∂²V/∂α∂v₀": "in³/°/(in/s)", "∂²V/∂v₀²": "in³/(in/s)²",
    }  # fmt: skip
    values = {row.symbol: float(row.value) for row in several.rows()[3:]}
    assert values["∂²V/∂α∂v₀"] == pytest.approx(np.deg2rad(several.d2volume[0, 1]), rel=1e-5, abs=0)
    assert repr(several).startswith("Impact('linearized', t_c=6.6353")
    assert len(repr(several)) < 500
    hit = erosion.impact("linearized", P, derivatives=2)
    assert "in³/°²" in str(hit)
    assert "<td>10⁻⁴ in³</td>" in hit._repr_html_()
    assert "2 rebound" in str(erosion.impact("linearized", P.replace(alpha=[0.2, 0.3])))


def test_one_program_serves_whatever_the_impacts_share(monkeypatch):
    angles = np.linspace(0.1, 1.5, 7)
    erosion.impact("rotating", P.replace(alpha=angles), derivatives=1)
    # Called when a program is made, not when it runs; nor is anything traced, which takes ten times longer.
    monkeypatch.setattr(batch, "integrate_lane", None)
    monkeypatch.setattr(jax, "eval_shape", None)
    monkeypatch.setattr(jax, "make_jaxpr", None)
    for changed in ({"k": angles}, {"alpha": angles, "m": angles * 1e-4}, {}):
        erosion.impact("rotating", P.replace(**changed), derivatives=1)
        erosion.impact("rotating", P.replace(**changed), derivatives=1, rtol=1e-8)
