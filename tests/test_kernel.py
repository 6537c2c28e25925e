import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion import blocks
from erosion.kernel import pair_derivatives
from erosion.parameters import QUANTITIES
from tests.reference import AT_20_DEGREES, CLOSED, closed_form

P = erosion.TABLE_1
ANGLES = np.deg2rad(np.linspace(0.3, 89.9, 300))
SPINS = np.linspace(-0.9, 0.9, 7)


@pytest.mark.parametrize("name", AT_20_DEGREES)
def test_figures_of_the_physics_note(name):
    figure = AT_20_DEGREES[name]
    hit = erosion.impact(name, P, derivatives=1, rtol=1e-12)
    assert hit.ended_by == figure.ended_by
    assert hit.volume == pytest.approx(figure.volume, rel=1e-11)
    assert hit.t_c == pytest.approx(figure.t_c, rel=1e-9)
    assert hit.dvolume == pytest.approx(figure.dvolume, rel=1e-9)  # printed to 10 digits


@pytest.mark.parametrize("name", CLOSED)
def test_everything_equals_the_closed_form(name):
    p = P.replace(alpha=ANGLES)
    exact = closed_form(name)
    hit = erosion.impact(name, p, derivatives=2)
    volume = np.asarray(exact.volume(p))
    assert np.all(hit.ended_by == exact.ended_by(p))
    assert hit.volume == pytest.approx(volume, rel=1e-9)
    assert hit.t_c == pytest.approx(np.asarray(exact.t_c(p)), rel=1e-9)
    for found, true in ((hit.dvolume, exact.dvolume(p)), (hit.d2volume, exact.d2volume(p))):
        # Relative to the derivative, or where it passes through zero to the volume. With
        # K = tan α the motion at fixed time changes with α by 1/α: digits go as 1/α².
        size = np.maximum(np.abs(true), volume) * np.maximum(1, (np.deg2rad(2) / ANGLES) ** 2)
        assert np.all(np.abs(found - np.asarray(true)) <= 1e-8 * size)


@pytest.mark.parametrize("name", CLOSED)
def test_volumes_hold_down_to_grazing_impacts(name):
    # Derivatives here are small differences of numbers 1/α times larger, so they lose digits.
    p = P.replace(alpha=np.geomspace(1e-6, 1e-2, 30))
    assert erosion.impact(name, p).volume == pytest.approx(np.asarray(closed_form(name).volume(p)), rel=1e-9)


def test_at_the_cusp_both_ends_are_right():
    hit = erosion.impact("linearized", P.replace(alpha=np.arctan(1.0)), derivatives=2)
    exact = closed_form("linearized")
    assert hit.ended_by in ("rebound", "stop")
    assert hit.volume == pytest.approx(float(exact.volume(P.replace(alpha=np.pi / 4))), rel=1e-9)
    assert hit.dvolume == pytest.approx(float(exact.dvolume(P.replace(alpha=np.pi / 4))), rel=1e-6)
    assert np.isfinite(hit.d2volume)


@pytest.mark.parametrize(("name", "ratio"), [("linearized", 2.0), ("finnie", 2 / 3)])
def test_no_wrong_end_near_the_cusp(name, ratio):
    p = P.replace(alpha=np.arctan(ratio / 2) + np.deg2rad(np.linspace(-2, 2, 4000)))
    hit, exact = erosion.impact(name, p), closed_form(name)
    assert np.count_nonzero(hit.ended_by != exact.ended_by(p)) == 0


@pytest.mark.parametrize("name", [n for n in AT_20_DEGREES if n.startswith("rotating")])
def test_derivatives_equal_differences(name):
    # Away from jumps: one angle, one spin; steps that balance rounding and truncation.
    p = P.replace(alpha=0.3, phidot0=0.1 * P.v0 / P.r)
    hit = erosion.impact(name, p, derivatives=2, rtol=1e-12)
    h = 1e-3
    at = 0.3 + h * np.arange(-4, 5)
    v = erosion.impact(name, p.replace(alpha=at), rtol=1e-12).volume
    first = np.dot([3, -32, 168, -672, 0, 672, -168, 32, -3], v) / (840 * h)
    second = np.dot([-9, 128, -1008, 8064, -14350, 8064, -1008, 128, -9], v) / (5040 * h**2)
    assert hit.dvolume == pytest.approx(first, rel=1e-8)
    assert hit.d2volume == pytest.approx(second, rel=1e-5)


def test_several_parameters_make_a_symmetric_hessian():
    names = ("alpha", "k", "r")
    hit = erosion.impact("rotating", P, derivatives=2, wrt=names)
    assert hit.dvolume.shape == (3,)
    assert hit.d2volume.shape == (3, 3)
    assert np.array_equal(hit.d2volume, hit.d2volume.T)
    h = 1e-4
    up, down = (erosion.impact("rotating", P.replace(k=2 + d), derivatives=1, wrt=names, rtol=1e-12) for d in (h, -h))
    assert hit.d2volume[1] == pytest.approx((up.dvolume - down.dvolume) / (2 * h), rel=1e-6)


def test_any_parameters_share_one_program():
    erosion.impact("rotating", P, derivatives=2, wrt=("alpha", "k", "r"))
    programs = blocks._compiled_chunk()._cache_size()
    hit = erosion.impact("rotating", P, derivatives=2, wrt=("phidot0", "alpha"))
    assert blocks._compiled_chunk()._cache_size() == programs
    assert hit.d2volume[1, 1] == pytest.approx(float(erosion.impact("rotating", P, derivatives=2).d2volume), rel=1e-9)


def test_pairs_give_the_derivatives_of_volume_and_end_time():
    p = P.replace(alpha=np.array([0.2, 0.7]), phidot0=1000.0)
    pairs = [("alpha", name) for name in QUANTITIES]
    found = pair_derivatives(erosion.load_model("rotating"), p, pairs)
    hit = erosion.impact("rotating", p, derivatives=2, wrt=("alpha", "v0", "phidot0"))
    column = [list(QUANTITIES).index(name) for name in hit.wrt]
    assert found.volume.second.shape == (2, len(QUANTITIES))
    assert found.volume.second[:, column] == pytest.approx(hit.d2volume[:, 0], rel=1e-9)
    assert found.volume.other[:, column] == pytest.approx(hit.dvolume, rel=1e-9)
    assert np.array_equal(found.ended_by, hit.ended_by)
    h = 1e-4
    near = [pair_derivatives(erosion.load_model("rotating"), p.replace(k=2 + d), pairs).t_c for d in (-h, h)]
    at = list(QUANTITIES).index("k")
    assert found.t_c.other[:, at] == pytest.approx((near[1].value - near[0].value) / (2 * h), rel=1e-5)
    assert found.t_c.second[:, at] == pytest.approx((near[1].first[:, 0] - near[0].first[:, 0]) / (2 * h), rel=1e-5)


def test_a_lane_that_fails_along_one_pair_fails():
    p = P.replace(alpha=np.array([0.2, np.nan, 0.4]))
    hit = erosion.impact("rotating", p, derivatives=2, wrt=("alpha", "k", "r"))
    assert list(hit.ended_by) == ["rebound", "failed", "rebound"]
    for field in ("volume", "t_c", "dvolume", "d2volume"):
        assert np.all(np.isnan(getattr(hit, field)[1]))
        assert np.all(np.isfinite(getattr(hit, field)[::2]))


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
    assert length == pytest.approx(3 * hit.volume, rel=1e-8)
    assert time == pytest.approx(0, abs=1e-8 * hit.volume)
    assert mass == pytest.approx(0, abs=1e-8 * hit.volume)


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
    batch = jax.vmap(lambda a: erosion.volume("rotating", P.replace(alpha=a)))(jnp.asarray([0.2, 0.3]))
    assert batch == pytest.approx(erosion.impact("rotating", P.replace(alpha=[0.2, 0.3])).volume, rel=1e-9)
    gradient = jax.grad(lambda p: erosion.volume("rotating", p))(P)
    hit = erosion.impact("rotating", P, derivatives=1, wrt=tuple(QUANTITIES))
    found = [float(getattr(gradient, name)) for name in QUANTITIES]
    assert found == pytest.approx(hit.dvolume, rel=1e-7)


def test_third_derivatives_say_that_they_are_missing():
    with pytest.raises(NotImplementedError, match="third"):
        jax.grad(jax.grad(jax.grad(lambda a: erosion.volume("linearized", P.replace(alpha=a)))))(0.3)


@pytest.mark.parametrize("name", [n for n in AT_20_DEGREES if n.startswith("rotating")])
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
        assert hit.volume[i] == pytest.approx(cut.volume, rel=1e-8)
        assert hit.t_c[i] == pytest.approx(cut.t_c, rel=1e-8)


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


def test_more_lanes_than_a_chunk_in_order():
    count = blocks.BLOCK * blocks.CHUNK + 17
    alphas = np.linspace(0.3, 0.31, count)
    hit = erosion.impact("linearized", P.replace(alpha=alphas))
    exact = closed_form("linearized")
    assert hit.volume == pytest.approx(np.asarray(exact.volume(P.replace(alpha=alphas))), rel=1e-9)


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
        assert hit.volume[i] == pytest.approx(float(exact.volume(P.replace(alpha=[0.2, 0.6, 0.3, 1.1][i]))), rel=1e-9)


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
    assert list(hit.ended_by) == ["rebound", "failed", "failed", "failed"]
    for field in ("volume", "t_c", "dvolume"):
        assert list(np.isnan(getattr(hit, field))) == [False, True, True, True]


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
    hit = erosion.impact("linearized", P, derivatives=2)
    assert "in³/rad²" in str(hit)
    assert "<td>in³</td>" in hit._repr_html_()
    assert "2 rebound" in str(erosion.impact("linearized", P.replace(alpha=[0.2, 0.3])))
