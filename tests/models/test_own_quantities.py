"""Quantities of a model's own, integrated along the cut: the work of the target is the energy that the body loses."""

import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.models.equations import model_digest
from erosion.models.own_parameters import own_quantities
from erosion.models.parts import FullTorque
from erosion.parameters.quantities import conversion_factor

P = erosion.TABLE_1.replace(k=1.0, alpha=np.linspace(0.1, 1.4, 6))


class Working(erosion.models.Rotating):
    """The rotating model, with the work of the target on the tip."""

    @erosion.own_quantity("W", "work of the target on the tip", "energy")
    def work(self, state, p):
        tip = self.tip(state, p)
        fx, fy = self.force(state, tip, p)
        return fx * tip.vx + fy * tip.vdepth


MODEL = Working(torque=FullTorque())


def energy_lost(hit: erosion.Impact) -> np.ndarray:
    p, end = hit.p, hit.state
    before = p.m * p.v0**2 / 2
    return (p.m * (end.vx**2 + end.vy**2) + p.moment_of_inertia * end.omega**2) / 2 - before


def test_the_work_is_the_change_of_energy() -> None:
    hit = erosion.impact(MODEL, P, derivatives=1)
    assert np.allclose(hit.quantities["work"], energy_lost(hit), rtol=1e-8)
    plain = erosion.impact(erosion.models.Rotating(torque=FullTorque()), P, derivatives=1)
    assert np.array_equal(hit.volume, plain.volume)
    h = 1e-6
    up, down = (energy_lost(erosion.impact(MODEL, P.replace(alpha=P.alpha + s * h))) for s in (1, -1))
    slope = hit.end.along("alpha").integrals["work"]
    assert np.allclose(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-5 * np.max(np.abs(slope)))


def test_it_has_units_and_a_label_wherever_results_are_shown() -> None:
    imperial, si = (erosion.impact(MODEL, p) for p in (P, P.to("si")))
    factor = conversion_factor("energy", "inch-pound", "si")
    assert factor == pytest.approx(0.1129848290276167)  # a pound-force inch in joules
    assert np.allclose(imperial.quantities["work"] * factor, si.quantities["work"], rtol=1e-8)
    assert si.to_dict()["units"]["work"] == "J"
    row = next(row for row in si.rows() if row.name == "work")
    assert (row.symbol, row.meaning, row.unit[-1]) == ("W", "work of the target on the tip", "J")
    swept = erosion.sweep(MODEL, erosion.TABLE_1.replace(k=1.0).to("si"), alpha=P.alpha)
    assert np.array_equal(swept["work"], si.quantities["work"])
    assert swept["work"].attrs == {"long_name": "work of the target on the tip", "symbol": "W", "units": "J"}


@pytest.fixture(scope="module")
def jet() -> erosion.Stream:
    return erosion.stream(MODEL, CASE, alpha=LAW, n=2**12, best_angle=False, sensitivities=False)


CASE = erosion.TABLE_1.replace(k=1.0)
LAW = erosion.distributions.Uniform(0.2, 0.8)


def test_a_stream_has_its_mean_with_a_standard_error(jet: erosion.Stream) -> None:
    mean = jet.mean_quantities["work"]
    alpha = (np.arange(2000) + 0.5) / 2000 * 0.6 + 0.2
    of_law = np.mean(erosion.impact(MODEL, CASE.replace(alpha=alpha)).quantities["work"])
    assert mean.value == pytest.approx(of_law, abs=4 * mean.error)
    assert 0 < mean.error < 1e-3 * abs(mean.value)
    row = next(row for row in jet.rows() if row.name == "mean_work")
    assert row.meaning.startswith("work of the target on the tip")
    assert "±" in row.value
    numbers = jet.to_dict()
    assert numbers["mean_work"] == mean.value
    assert numbers["mean_work_error"] == mean.error
    assert numbers["units"]["mean_work"] == "in*lbf" == jet.to_dataset()["mean_work"].attrs["units"]
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


def test_a_stored_stream_goes_on_with_it(jet: erosion.Stream, tmp_path) -> None:
    options = {"alpha": LAW, "best_angle": False, "sensitivities": False, "store": tmp_path / "jet.nc"}
    erosion.stream(MODEL, CASE, n=2**11, **options)
    whole = erosion.stream(MODEL, CASE, n=2**12, **options)
    assert whole.mean_quantities["work"].value == pytest.approx(jet.mean_quantities["work"].value, rel=1e-13)
    assert whole.mean_quantities["work"].error == pytest.approx(jet.mean_quantities["work"].error, rel=1e-6)


@pytest.mark.slow
def test_verify_compares_it() -> None:
    def error(model: erosion.models.Rotating) -> float:
        return next(check.error for check in erosion.verify(model).checks if check.name == "own quantities")

    class Mislabelled(Working):
        @erosion.own_quantity("W", "work of the target on the tip", "length")
        def work(self, state, p):
            return Working.work(self, state, p)

    assert error(MODEL) < 1e-9
    assert error(Mislabelled(torque=FullTorque())) > 0.1  # not the unit that it is said to have


def test_a_name_of_another_result_is_refused() -> None:
    with pytest.raises(ValueError, match="`mass`"):

        @erosion.own_quantity("M", "mass", "mass")
        def mass(self, state, p):
            return p.m


def test_a_comparison_shows_what_all_models_have() -> None:
    other = Working()
    both = erosion.sweep([MODEL, "rotating"], erosion.TABLE_1, alpha=[0.3])
    assert "work" not in both
    assert "work" in erosion.sweep([other], erosion.TABLE_1, alpha=[0.3])


def test_a_subclass_inherits_it_or_takes_it_away() -> None:
    class Same(Working):
        pass

    class Without(Working):
        def work(self, state, p):
            return jnp.zeros(())

    assert list(own_quantities(Same)) == ["work"]
    assert own_quantities(Without) == {}
    assert erosion.impact("rotating", P).quantities == {}


def test_it_belongs_to_the_model_s_identity() -> None:
    class DoubleWork(Working):
        @erosion.own_quantity("W", "twice the work", "energy")
        def work(self, state, p):
            return 2 * Working.work(self, state, p)

    assert model_digest(DoubleWork(), P) != model_digest(Working(), P)
    assert model_digest(Working(), P) != model_digest(erosion.models.Rotating(), P)
    assert np.allclose(
        erosion.impact(DoubleWork(), P).quantities["work"],
        2 * erosion.impact(Working(), P).quantities["work"],
        rtol=1e-9,
    )


def test_what_is_no_quantity_is_refused() -> None:
    class Shapeless(erosion.models.Rotating):
        @erosion.own_quantity("W", "work")
        def work(self, state, p):
            return jnp.zeros(2)

    with pytest.raises(erosion.ModelError, match="`work` must give real scalars"):
        erosion.impact(Shapeless(), P)
