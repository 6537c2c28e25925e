"""Arrays of any kind that hold the same numbers give the same bits.

An impact's result depends on its own numbers alone, whatever is computed beside it.

How few unknowns the integrator needs of each model, and that they move as the model's own state does.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.impacts.batch import element_of, end_names, split
from erosion.lanes.lanewise import WIDTH
from erosion.models import Linearized
from erosion.ode.batch import integrate
from erosion.ode.reduction import WholeMotion, reduced_motion_of
from erosion.parameters.parameters import QUANTITIES
from tests.reference import CLOSED, closed_form

P = erosion.TABLE_1.to("si")
ANGLES = np.deg2rad(np.linspace(0.3, 89.9, 300))


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


# Each force and each torque once: the contract of models has both engines for every model, at one impact.
@pytest.mark.parametrize("name", ["rotating-tan-alpha", "rotating-velocity-aligned-full-torque"])
@pytest.mark.filterwarnings("ignore::erosion.impacts.trajectory.TurnWarning")
def test_both_engines_agree(name):
    rng = np.random.default_rng(7)
    alphas, spins = rng.uniform(0.02, 1.55, 6), rng.uniform(-0.9, 0.9, 6)
    hit = erosion.impact(name, P.replace(alpha=alphas, phidot0=spins * P.v0 / P.r))
    for i, (alpha, s) in enumerate(zip(alphas, spins, strict=True)):
        cut = erosion.simulate(name, P.replace(alpha=alpha, phidot0=s * P.v0 / P.r), points=2)
        assert hit.ended_by[i] == cut.ended_by
        assert hit.volume[i] == pytest.approx(cut.volume, rel=1e-8, abs=0)
        assert hit.t_c[i] == pytest.approx(cut.t_c, rel=1e-8, abs=0)


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
    signature, numbers = split(model, hopeless)
    results = integrate(signature, numbers, 1, 2, (element_of(model, "alpha"),), 3e-13)
    assert end_names(model)[results.outcome[0]] == "failed"
    assert results.trials < 1000
    assert erosion.impact(model, hopeless, derivatives=2).ended_by == "rebound"


class Brittle(erosion.models.ForceRatio):
    """K = k, but from 57° up not a number once the particle has slowed down to 0.3 v₀."""

    def ratio(self, state, p):
        return p.k + jnp.where(p.alpha > 1, 0.0 * jnp.sqrt(state.vx / p.v0 - 0.3), 0.0)

    def typical_ratio(self, p):
        return p.k


class Faulty(erosion.models.RigidParticle):
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


class Blurred(erosion.models.RigidParticle):
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


def test_derivatives_have_the_units_of_both():
    inches = P.to("inch-pound")
    several = erosion.impact("linearized", inches, derivatives=2, wrt=("alpha", "v0"))
    units = {row[1]: row[3] for row in several.rows()[3:]}
    assert units == {
        "∂V/∂α": "in³/°", "∂V/∂v₀": "in³/(in/s)",
        "∂²V/∂α²": "in³/°²", "∂²V/∂α∂v₀": "in³/°/(in/s)", "∂²V/∂v₀²": "in³/(in/s)²",
    }  # fmt: skip
    values = {row[1]: float(row[2]) for row in several.rows()[3:]}
    mixed = np.deg2rad(several.d2volume[0, 1]) / 0.0254**2
    assert values["∂²V/∂α∂v₀"] == pytest.approx(mixed, rel=1e-5, abs=0)


TWELVE = np.deg2rad(np.linspace(5.0, 85.0, 12))


LAYOUTS = {
    "strided": lambda a: np.stack([a, 0 * a], 1)[:, 0],
    "reversed": lambda a: a[::-1].copy()[::-1],
    "by columns": lambda a: np.asfortranarray(a.reshape(3, 4)),
    "transposed": lambda a: a.reshape(4, 3).T,
    "of six dimensions": lambda a: a.reshape(1, 2, 1, 3, 1, 2),
    "broadcast": lambda a: np.broadcast_to(a, (4, 12)),
    "big-endian": lambda a: a.astype(">f8"),
    "long": lambda a: a.astype(np.longdouble),
    "read-only": lambda a: np.frombuffer(a.tobytes()),
    "of JAX": jnp.asarray,
    "a list": list,
    "a tuple": tuple,
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_array_of_any_layout_gives_the_same_bits(layout) -> None:
    given = LAYOUTS[layout](TWELVE)
    expected = [
        erosion.impact("rotating", P.replace(alpha=alpha)).volume for alpha in np.ravel(np.asarray(given, float))
    ]
    volume = erosion.impact("rotating", P.replace(alpha=given)).volume
    np.testing.assert_array_equal(volume, np.reshape(expected, np.shape(given)))


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int64, np.uint8])
def test_an_array_of_another_type_is_the_float64_of_its_numbers(kind) -> None:
    k = np.array([1, 2, 3], kind)
    volume = erosion.impact("rotating", P.replace(k=k)).volume
    np.testing.assert_array_equal(volume, erosion.impact("rotating", P.replace(k=k.astype(float))).volume)
    assert volume.dtype == np.float64


@pytest.mark.parametrize("shape", [(0,), (3, 0), (1,), ()])
def test_no_impact_and_one_have_their_shape(shape) -> None:
    assert np.shape(erosion.impact("rotating", P.replace(alpha=np.full(shape, 0.3))).volume) == shape


def test_the_order_of_impacts_does_not_matter() -> None:
    """Bit for bit: a lane's neighbours have no say in its result."""
    rng = np.random.default_rng(3)
    count = 30 * WIDTH + 7
    p = erosion.TABLE_1.replace(alpha=rng.uniform(0.05, 1.5, count), phidot0=rng.uniform(-4e4, 4e4, count))
    shuffled = rng.permutation(count)
    one = erosion.impact("rotating", p)
    other = erosion.impact("rotating", p.replace(alpha=p.alpha[shuffled], phidot0=p.phidot0[shuffled]))
    assert np.array_equal(other.volume, one.volume[shuffled], equal_nan=True)
    assert np.array_equal(other.t_c, one.t_c[shuffled], equal_nan=True)
    assert np.array_equal(other.ended_by, one.ended_by[shuffled])
    # A few lanes alone, so that no other order is at work in them.
    for i in (0, count // 2, count - 1):
        assert erosion.impact("rotating", p.replace(alpha=p.alpha[i], phidot0=p.phidot0[i])).volume == one.volume[i]


@pytest.mark.parametrize(("model", "order"), [*zip(erosion.available_models(), itertools.cycle([2, 1, 0]))])
def test_the_place_in_a_block_does_not_matter(model: str, order: int) -> None:
    """Bit for bit: a block of equal lanes has equal results, and so has one lane among others."""
    rng = np.random.default_rng(order)
    count = 48
    p = erosion.TABLE_1.replace(
        alpha=rng.uniform(0.05, 1.5, count), phidot0=rng.uniform(-4e4, 4e4, count), k=rng.uniform(0.5, 3.0, count)
    )
    repeated = p.replace(**{name: np.repeat(getattr(p, name), WIDTH) for name in ("alpha", "phidot0", "k")})
    one, many = (erosion.impact(model, each, derivatives=order) for each in (p, repeated))
    for name in ("volume", "t_c", "dvolume", "d2volume")[: 2 + order]:
        each = getattr(many, name).reshape(count, WIDTH)
        assert np.array_equal(each, np.broadcast_to(getattr(one, name)[:, None], each.shape), equal_nan=True), name


_P = erosion.TABLE_1.to("si").replace(phidot0=2e4)


def _reduced(model):
    signature, numbers = split(model, _P)
    return reduced_motion_of(signature)(numbers)


@pytest.mark.parametrize("name", erosion.available_models())
def test_the_motion_is_the_same(name):
    """Rates of events and volume along the motion, at contact and after a step."""
    model = erosion.load_model(name)

    def looks(motion, steps):
        at, rows = motion.initial(), []
        for _ in range(steps):
            rate = motion.rate(at)
            events = jax.jvp(motion.events, (at,), (rate,))
            rows.append(jax.tree.leaves((events, rate.integrals)))
            at = jax.tree.map(lambda s, k: s + 0.1 * model.scales(_P).time * k, at, rate)
        return np.array(rows)

    expected = looks(WholeMotion(*split(model, _P)), 4)
    assert np.allclose(looks(_reduced(model), 4), expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max(axis=0))


@pytest.mark.parametrize("name", ["linearized", "rotating"])
def test_a_parameter_that_is_not_finite_fails_whether_it_matters_or_not(name):
    names = list(QUANTITIES)
    for bad in (np.nan, np.inf):
        cases = {q: np.where(np.arange(len(names)) == i, bad, float(getattr(_P, q))) for i, q in enumerate(names)}
        found = erosion.impact(name, _P.replace(**cases))
        assert set(found.ended_by) == {"failed"}
        assert np.isnan(found.volume).all()


class ThreeEnds(Linearized):
    """Events that are not in the order of their names; each ends the cut at an angle of its own."""

    def events(self, state, p):
        early = {name: p.alpha - angle for name, angle in (("rest", 0.3), ("exit", 0.2), ("limit", 0.1))}
        depth = state.y / self.scales(p).length
        return {name: jnp.where(over > 0, 1.0, depth) for name, over in early.items()}


def test_the_word_is_that_of_the_event_that_fell() -> None:
    assert erosion.impact(ThreeEnds(), erosion.TABLE_1.replace(alpha=0.25)).ended_by == "rest"
