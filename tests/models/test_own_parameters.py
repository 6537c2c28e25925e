"""A model's own parameters: their names, and what takes them. The truth is friction in closed form.

Quantities of a model's own, integrated along the cut: the work of the target is the energy that the body loses.
"""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.checks.verify import Subject
from erosion.impacts.optimum import EndTime
from erosion.models import ConstantRatio, Finnie, ForceLaw, FullTorque, Linearized, Torque
from erosion.models.base import own_parameters, own_quantities, quantities, replaced, sizes, values, with_values
from erosion.models.equations import error_in, model_digest
from tests.reference import closed_form

P = erosion.TABLE_1
FRICTION = type(getattr(erosion.load_model("models/coulomb_tip.py"), "force"))  # noqa: B009
MODEL = Linearized(force=FRICTION())


class Hardness(ForceLaw):
    rate: float = erosion.own_parameter(2.0, "D", "rate of something", "rate")
    terms: int = 1
    coefficients: tuple[float, float] = (1.0, 2.0)
    curve: jax.Array = eqx.field(converter=jnp.asarray, default=(1.0, 2.0))
    bent: bool = False

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * tip.depth * self.terms * self.rate / 2
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


class Drag(Torque):
    rate: float = 3.0

    def __call__(self, state, force, p):
        return p.r * force[0] * self.rate / 3


def with_friction(friction, p=P):
    """The equivalent case without friction; see `models/coulomb_tip.py`."""
    more = 1 + friction * p.k
    return p.to("si").replace(sigma=p.sigma * more, k=p.k / more)


def test_names_are_those_of_the_fields_that_hold_one_real_number():
    assert {name: one.value for name, one in own_parameters(MODEL).items()} == {"friction": 0.2}
    assert list(own_parameters(Linearized(force=Hardness()))) == ["rate", "terms"]
    assert own_parameters(erosion.load_model("rotating")) == {}


def test_fields_of_one_name_bear_as_much_of_their_path_as_tells_them_apart():
    both = Finnie(force=Hardness(), torque=Drag())
    assert list(own_parameters(both)) == ["force.rate", "terms", "torque.rate"]
    # An objective is a model with another inside it, whose names stay.
    assert list(own_parameters(EndTime(both))) == list(own_parameters(both))
    changed = replaced(both, {"force.rate": 5, "torque.rate": 7})
    assert [one.value for one in own_parameters(changed).values()] == [5.0, 1, 7.0]


def test_labels_are_those_of_the_field_or_its_name():
    known = quantities(Finnie(force=Hardness(), torque=Drag()))
    assert known["k"].symbol == "k"
    assert known["force.rate"].label("si") == "D  rate of something [1/s]"
    assert known["torque.rate"].label("si") == "rate  own parameter of the model"
    assert quantities(MODEL)["friction"].label("si") == "μ  coefficient of friction"


def test_values_and_sizes_are_those_of_case_and_model():
    resting = MODEL.replace(friction=0)
    assert values(resting, P)["friction"] == 0
    assert values(resting, P)["k"] == P.k
    assert sizes(resting, P)["friction"] == 1
    assert sizes(MODEL.replace(friction=-0.3), P)["friction"] == 0.3
    assert sizes(MODEL, P)["phidot0"] == P.v0 / P.r
    model, p = with_values(MODEL, P, {"friction": 0.4, "k": 3.0})
    assert (values(model, p)["friction"], float(p.k)) == (0.4, 3.0)


@pytest.mark.parametrize(
    ("model", "changes", "error", "message"),
    [
        (
            MODEL,
            {"fricton": 1},
            TypeError,
            "Argument `fricton` is not an own parameter of Linearized; it has friction.",
        ),
        (MODEL, {"k": 1}, TypeError, "Argument `k` is not an own parameter of Linearized; it has friction."),
        (MODEL, {"friction": "a"}, TypeError, "Argument `friction` must be a number, but is 'a'."),
        (MODEL, {"friction": True}, TypeError, "Argument `friction` must be a number, but is True."),
        (MODEL, {"friction": [0.1, 0.2]}, TypeError, "Argument `friction` must be a number, but is [0.1, 0.2]."),
        (MODEL, {"friction": np.nan}, ValueError, "Argument `friction` must be a finite number, but is nan."),
        (Finnie(), {"friction": 1}, TypeError, "`friction` is not an own parameter of Finnie; it has none"),
    ],
)
def test_what_replaces_a_value_must_be_a_number(model, changes, error, message):
    with pytest.raises(error, match=re.escape(message)):
        model.replace(**changes)


def test_derivatives_by_friction_are_those_of_the_closed_form():
    exact, angles, names = closed_form("linearized"), np.deg2rad([10.0, 20.0, 40.0]), ("k", "friction")

    def volume(k, friction, alpha):
        return exact.volume(with_friction(friction, P.replace(alpha=alpha, k=k)))

    def at(derivative):
        return np.moveaxis(np.array(jax.jit(jax.vmap(derivative, (None, None, 0)))(2.0, 0.2, angles)), -1, 0)

    found = erosion.impact(MODEL, P.replace(alpha=angles), derivatives=2, wrt=names)
    assert found.volume == pytest.approx(at(volume), rel=1e-10)
    assert found.dvolume == pytest.approx(at(jax.grad(volume, (0, 1))), rel=1e-8)
    assert found.d2volume == pytest.approx(at(jax.hessian(volume, (0, 1))), rel=1e-7, abs=1e-20)
    assert [row[1] for row in found.rows()[-3:]] == ["∂²V/∂k²", "∂²V/∂k∂μ", "∂²V/∂μ²"]
    slope = jax.jit(jax.grad(lambda friction: erosion.volume(MODEL.replace(friction=friction), P)))(0.2)
    assert slope == pytest.approx(found.dvolume[1, 1], rel=1e-8)


def test_the_best_angle_knows_how_friction_moves_it(shell):
    k, friction = 2.0, 0.2
    found = erosion.alpha_max(MODEL, P, max_turn=None)
    ratio = k / (1 + friction * k)
    assert found.alpha == pytest.approx(np.arctan(ratio) / 2, abs=1e-9)
    assert list(found.sensitivities) == [*(name for name in quantities(MODEL) if name != "alpha")]
    assert found.sensitivities["friction"] == pytest.approx(-(ratio**2) / (1 + ratio**2) / 2, rel=1e-6)
    out = shell(["optimum", "--model", "models/coulomb_tip.py", "--sensitivities"]).out
    assert [line.split()[:2] for line in out.splitlines() if "coefficient of friction" in line] == [["friction", "μ"]]


def test_a_model_with_an_array_of_its_own_has_derivatives_by_several_parameters():
    # rate/2 = terms = 1: the force is that of `linearized`, in which V ∝ 1/ψ and does not depend on r.
    found = erosion.impact(Linearized(force=Hardness()), P, derivatives=1, wrt=("psi", "r", "rate"))
    exact = -float(closed_form("linearized").volume(P)) / float(P.psi)
    assert found.dvolume[:2] == pytest.approx([exact, 0.0], rel=1e-8, abs=1e-17)
    assert found.dvolume[2] == pytest.approx(exact * float(P.psi) / 2, rel=1e-8)


FRICTIONS = np.array([0.0, 0.2, 0.5])


def test_an_array_is_a_number_for_each_impact():
    model, angles = MODEL.replace(friction=FRICTIONS), np.deg2rad([[10.0], [30.0]])
    assert error_in(model) is None
    found = erosion.impact(model, P.replace(alpha=angles), derivatives=2, wrt=["friction", "k"])
    assert found.d2volume.shape == (2, 3, 2, 2)
    for i, friction in enumerate(FRICTIONS):
        one = MODEL.replace(friction=friction)
        for j, angle in enumerate(angles.ravel()):
            alone = erosion.impact(one, P.replace(alpha=angle), derivatives=2, wrt=["friction", "k"])
            for name in ("volume", "t_c", "dvolume", "d2volume"):
                np.testing.assert_array_equal(getattr(found, name)[j, i], getattr(alone, name))
    single = erosion.impact(model, P, derivatives=1, wrt="friction").dvolume
    np.testing.assert_array_equal(single, erosion.impact(model, P, derivatives=1, wrt=["friction"]).dvolume[:, 0])


class Lip(ForceLaw):
    """As `models/saturating_lip.py`, but with a length where that has a multiple of r."""

    reach: float = erosion.own_parameter(0.01, "L", "depth at which the lip stops growing", "length")

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * self.reach * jnp.tanh(tip.depth / self.reach)
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


class Nameless(Lip):
    """The same, but does not say that it is a length."""

    reach: float = 0.01


class Dragged(ConstantRatio):
    """F_x = -c · depth - γ ẋ."""

    drag: float = erosion.own_parameter(1e-3, "γ", "drag", "M/T")

    def __call__(self, state, tip, p):
        horizontal, vertical = super().__call__(state, tip, p)
        return horizontal - self.drag * state.vx, vertical


class NamelessDrag(Dragged):
    """The same, but does not say that it is a mass over a time."""

    drag: float = 1e-3


def test_a_force_that_adds_to_a_built_in_one_has_no_closed_form():
    assert Linearized().closed_form() is not None
    assert Linearized(force=Dragged()).closed_form() is None


def test_the_check_of_own_quantities_passes() -> None:
    right = Subject("own", WORKING, registered=False)
    assert right.worst(right.checks()["own quantities"]())[0] < 1e-9


MANY = erosion.TABLE_1.replace(k=1.0, alpha=np.linspace(0.1, 1.4, 6))


class Working(erosion.models.Rotating):
    """The rotating model, with the work of the target on the tip."""

    @erosion.own_quantity("W", "work of the target on the tip", "energy")
    def work(self, state, p):
        tip = self.tip(state, p)
        fx, fy = self.force(state, tip, p)
        return fx * tip.vx + fy * tip.vdepth


WORKING = Working(torque=FullTorque())


def energy_lost(hit: erosion.Impact) -> np.ndarray:
    p, end = hit.p, hit.state
    before = p.m * p.v0**2 / 2
    return (p.m * (end.vx**2 + end.vy**2) + p.moment_of_inertia * end.omega**2) / 2 - before


def test_the_work_is_the_change_of_energy() -> None:
    hit = erosion.impact(WORKING, MANY, derivatives=1)
    assert hit.quantities["work"] == pytest.approx(energy_lost(hit), rel=1e-8)
    plain = erosion.impact(erosion.models.Rotating(torque=FullTorque()), MANY, derivatives=1)
    assert np.array_equal(hit.volume, plain.volume)
    h = 1e-6
    up, down = (energy_lost(erosion.impact(WORKING, MANY.replace(alpha=MANY.alpha + s * h))) for s in (1, -1))
    slope = hit.end.along("alpha").integrals["work"]
    assert np.allclose(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-5 * np.max(np.abs(slope)))


def test_it_has_units_and_a_label_wherever_results_are_shown() -> None:
    imperial, si = (erosion.impact(WORKING, p) for p in (MANY, MANY.to("si")))
    factor = 0.1129848290276167  # a pound-force inch in joules
    assert np.array_equal(imperial.quantities["work"], si.quantities["work"])
    assert np.multiply(imperial.to_dict()["work"], factor) == pytest.approx(np.array(si.to_dict()["work"]), rel=1e-12)
    assert si.to_dict()["units"]["work"] == "J"
    row = next(row for row in si.rows() if row[0] == "work")
    assert (row[1], row[4], row[3][-1]) == ("W", "work of the target on the tip", "J")
    swept = erosion.sweep(WORKING, erosion.TABLE_1.replace(k=1.0).to("si"), alpha=MANY.alpha)
    assert np.array_equal(swept["work"], si.quantities["work"])
    assert swept["work"].attrs == {"long_name": "work of the target on the tip", "symbol": "W", "units": "J"}


@pytest.fixture(scope="module")
def jet() -> erosion.Stream:
    return erosion.stream(WORKING, CASE, alpha=LAW, n=2**12, best_angle=False, sensitivities=False)


CASE = erosion.TABLE_1.replace(k=1.0)
LAW = stats.uniform(0.2, 0.6)


def test_a_stream_has_its_mean_with_a_standard_error(jet: erosion.Stream) -> None:
    mean = jet.mean_quantities["work"]
    alpha = (np.arange(2000) + 0.5) / 2000 * 0.6 + 0.2
    of_law = np.mean(erosion.impact(WORKING, CASE.replace(alpha=alpha)).quantities["work"])
    assert mean.value == pytest.approx(of_law, abs=4 * mean.error)
    assert 0 < mean.error < 1e-3 * abs(mean.value)
    numbers = jet.to_dict()
    factor = 0.1129848290276167  # a pound-force inch in joules
    assert numbers["mean_work"] * factor == pytest.approx(mean.value)
    assert numbers["mean_work_error"] * factor == pytest.approx(mean.error)
    assert (numbers["units"]["mean_work"], jet.to_dataset()["mean_work"].attrs["units"]) == ("in*lbf", "J")
    assert (
        jet.mean_volume
        == erosion.stream(
            erosion.models.Rotating(torque=FullTorque()),
            CASE,
            alpha=LAW,
            n=2**12,
            best_angle=False,
            sensitivities=False,
        ).mean_volume
    )


def test_a_name_of_another_result_is_refused() -> None:
    with pytest.raises(ValueError, match="`mass`"):

        @erosion.own_quantity("M", "mass", "mass")
        def mass(self, state, p):
            return p.m


def test_a_subclass_inherits_it_or_takes_it_away() -> None:
    class Same(Working):
        pass

    class Without(Working):
        def work(self, state, p):
            return jnp.zeros(())

    assert list(own_quantities(Same)) == ["work"]
    assert own_quantities(Without) == {}
    assert erosion.impact("rotating", MANY).quantities == {}


def test_it_belongs_to_the_model_s_identity() -> None:
    class DoubleWork(Working):
        @erosion.own_quantity("W", "twice the work", "energy")
        def work(self, state, p):
            return 2 * Working.work(self, state, p)

    assert model_digest(DoubleWork()) != model_digest(Working())
    assert model_digest(Working()) != model_digest(erosion.models.Rotating())
    work, twice = (erosion.impact(model, MANY).quantities["work"] for model in (Working(), DoubleWork()))
    assert twice == pytest.approx(2 * work, rel=1e-9)


class Blunt(Hardness):
    r: float = 1.0


class Shapeless(erosion.models.Rotating):
    @erosion.own_quantity("W", "work")
    def work(self, state, p):
        return jnp.zeros(2)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda: erosion.load_model(Linearized(force=Blunt())),
            erosion.ModelError,
            "other names than those of a case, but one is `r`",
        ),
        (lambda: erosion.impact(Shapeless(), MANY), erosion.ModelError, "`work` must give real scalars"),
        (
            lambda: erosion.simulate(MODEL.replace(friction=FRICTIONS), P),
            ValueError,
            r"`friction` must be a scalar here, but has shape \(3,\); for many impacts use `erosion.impact`\.",
        ),
        (
            lambda: erosion.impact(MODEL.replace(friction=FRICTIONS), P.replace(alpha=[0.2, 0.3])),
            ValueError,
            r"own parameters must broadcast with the case's, but shapes are \(2,\), \(3,\)",
        ),
    ],
    ids=["name of the case", "array for a number", "several numbers", "other shapes"],
)
def test_own_parameters_and_quantities_that_do_not_fit_are_refused(call, error, message) -> None:
    with pytest.raises(error, match=message):
        call()
