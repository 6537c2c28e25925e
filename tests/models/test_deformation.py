"""Wear by deformation beside the cut: Bitter's term on the closed forms of cuts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.models import DeformationWear, Linearized, ProportionalDeformationWear, Rotating
from tests.reference import relative_volume

P = erosion.TABLE_1.to("si")
STRESS = float(P.sigma * P.psi)
RNG = np.random.default_rng(23)
CASES = 60
# Thresholds from none to one that no impact reaches.
ALPHA = RNG.uniform(0.02, 1.55, CASES)
THRESHOLD = np.where(RNG.random(CASES) < 0.2, 0.0, RNG.uniform(0.0, 1.3, CASES)) * float(P.v0)
ENERGY = STRESS * np.exp(RNG.uniform(-2, 3, CASES))
P_RANDOM = P.replace(alpha=ALPHA, k=np.exp(RNG.uniform(-1.2, 1.8, CASES)), v0=P.v0 * np.exp(RNG.uniform(-1, 1, CASES)))
NAMES = ("alpha", "k", "v0", "specific_energy", "threshold")


def removed(alpha, k, v0, specific_energy, threshold):
    """The cut, and Bitter's term."""
    above = jnp.maximum(v0 * jnp.sin(alpha) - threshold, 0.0)
    cut = P.m * v0**2 / STRESS * relative_volume("linearized", alpha, k, xp=jnp)
    return cut + P.m * above**2 / (2 * specific_energy)


def test_volumes_and_all_their_derivatives_are_those_of_the_closed_form():
    model = Linearized(deformation=DeformationWear()).replace(specific_energy=ENERGY, threshold=THRESHOLD)
    hits = erosion.impact(model, P_RANDOM, derivatives=2, wrt=NAMES, rtol=1e-12)
    numbers = (ALPHA, P_RANDOM.k, P_RANDOM.v0, ENERGY, THRESHOLD)
    every = tuple(range(5))
    of_lanes = jax.vmap(lambda *lane: (removed(*lane), jax.grad(removed, every)(*lane), hessian(removed, every)(*lane)))
    volume, slopes, curves = jax.jit(of_lanes)(*numbers)
    np.testing.assert_allclose(hits.volume, volume, rtol=1e-10)
    # Each derivative in units of the volume and of its parameters' sizes: a mixed one may be zero.
    sizes = np.stack(np.broadcast_arrays(np.ones(CASES), *numbers[1:4], P_RANDOM.v0))
    for i in range(5):
        found = hits.dvolume[:, i] * sizes[i] / volume
        np.testing.assert_allclose(found, slopes[i] * sizes[i] / volume, rtol=1e-8, atol=1e-8, err_msg=NAMES[i])
        for j in range(5):
            size = sizes[i] * sizes[j] / volume
            names = f"{NAMES[i]}, {NAMES[j]}"
            np.testing.assert_allclose(
                hits.d2volume[:, i, j] * size, curves[i][j] * size, rtol=1e-8, atol=1e-8, err_msg=names
            )


def hessian(function, arguments):
    return jax.jacfwd(jax.grad(function, arguments), arguments)


def test_at_90_degrees_deformation_alone_removes():
    model = Linearized(deformation=DeformationWear(STRESS, 0.25 * float(P.v0)))
    p = P.replace(alpha=np.pi / 2)
    alone = float(P.m * P.v0**2) * 0.75**2 / (2 * STRESS)
    hit = erosion.impact(model, p, derivatives=2, wrt=("threshold", "specific_energy"))
    assert (hit.ended_by, hit.t_c) == ("no-cut", 0.0)
    assert hit.volume == pytest.approx(alone, rel=1e-14, abs=0)
    assert hit.dvolume * np.array([float(P.v0), STRESS]) / alone == pytest.approx([-2 / 0.75, -1.0], rel=1e-13, abs=0)
    followed = erosion.simulate(model, p)
    assert (followed.ended_by, followed.volume) == ("no-cut", pytest.approx(alone, rel=1e-14, abs=0))


@pytest.mark.parametrize("degrees", [3.0, 25.0, 80.0])
def test_histories_start_at_what_deformation_removes(degrees):
    deformation = DeformationWear(3 * STRESS, 0.2 * float(P.v0))
    p = P.replace(alpha=np.deg2rad(degrees))
    alone = float(deformation.removed_at_contact(p))
    cut = erosion.simulate(Rotating(), p)
    both = erosion.simulate(Rotating(deformation=deformation), p)
    assert (alone > 0) == (degrees > 12)
    assert both.removed[0] == pytest.approx(alone, rel=1e-14, abs=0)
    assert both.removed == pytest.approx(cut.removed + alone, rel=1e-10, abs=0)
    assert both.t_c == pytest.approx(cut.t_c, rel=1e-12, abs=0)
    hit = erosion.impact(Rotating(deformation=deformation), p)
    assert hit.volume == pytest.approx(both.volume, rel=1e-9, abs=0)
    assert (hit.ended_by, hit.t_c) == (both.ended_by, pytest.approx(both.t_c, rel=1e-9, abs=0))


@pytest.mark.parametrize("numbers", [(0.0, 1.0), (-1e9, 1.0), (STRESS, -1.0)])
@pytest.mark.parametrize("degrees", [20.0, 90.0])
def test_a_number_out_of_range_is_an_impact_that_fails(numbers, degrees):
    p = P.replace(alpha=np.deg2rad(degrees))
    model = Linearized(deformation=DeformationWear(*numbers))
    hit = erosion.impact(model, p)
    assert (hit.ended_by, np.isnan(hit.volume)) == ("failed", True)
    with pytest.raises(erosion.SimulationError, match="not finite at contact"):
        erosion.simulate(model, p)
    assert not erosion.alpha_max(model, p).certified


def test_a_number_below_its_range_is_refused_where_it_is_given(shell):
    with pytest.raises(ValueError, match=r"`threshold` .*-1"):
        erosion.load_model("linearized-deformation").replace(threshold=-1.0)
    said = shell("sweep --model linearized-deformation --set energy_ratio=-1 --alpha 10deg:80deg:3 -o sweep.nc", 2).err
    assert "`--set energy_ratio`" in said
    assert "-1" in said


def test_one_bad_number_of_many_fails_alone():
    model = Linearized(deformation=DeformationWear()).replace(specific_energy=STRESS * np.array([1, -1, np.nan, 2]))
    assert erosion.impact(model, P).ended_by.tolist() == ["rebound", "failed", "failed", "rebound"]


def test_results_say_what_deformation_removes(shell):
    angles, energies = np.deg2rad([[20.0], [90.0]]), np.array([1.0, 2.0, 5.0])
    model = Linearized(deformation=ProportionalDeformationWear()).replace(energy_ratio=energies)
    hits = erosion.impact(model, P.replace(alpha=angles))
    expected = np.sin(angles) ** 2 / (2 * energies) * float(P.volume_scale)
    np.testing.assert_allclose(hits.volume_at_contact, expected, rtol=1e-14)
    assert "volume_at_contact" in {row[0] for row in hits.rows()}
    assert erosion.impact("linearized", P).volume_at_contact == 0
    assert hits.to_dict()["units"]["volume_at_contact"] == "m^3"
    result = shell("run --model rotating-deformation --alpha 90deg --units si --json").result
    assert result["volume_at_contact"] == result["volume"] == pytest.approx(expected[1, 0] / 4.8)


def test_streams_and_sweeps_take_its_numbers():
    model, p = erosion.load_model("linearized-deformation"), P.replace(alpha=np.pi / 2)
    # At 90° V is V* sin²α/(2e), and the mean of v₀² is its mean's square and its variance.
    stream = erosion.stream(model, p, n=2**12, v0=stats.norm(float(P.v0), 10.0), best_angle=False, sensitivities=False)
    expected = float(P.volume_scale) / 3.2 * (1 + (10 / float(P.v0)) ** 2)
    assert stream.mean_volume.value == pytest.approx(expected, rel=5e-4, abs=0)
    assert stream.shares["no-cut"].value == 1
    assert stream.tally.bins[0] == 0  # no particle removes nothing
    sweep = erosion.sweep(model, p, alpha=np.deg2rad([30.0, 90.0]), energy_ratio=[1.0, 4.0], threshold=[0.0, 55.88])
    shares = sweep.volume.sel(alpha=np.pi / 2).values / float(P.volume_scale)
    np.testing.assert_allclose(shares, [[0.5, 0.125], [0.125, 0.03125]], rtol=1e-12)


def test_datasets_keep_apart_what_deformation_removes():
    angles = np.deg2rad([5.0, 30.0, 90.0])
    names = ["linearized", "linearized-deformation", "dnv"]
    curves = erosion.compare(names, P, alpha=angles)
    for name in names:
        apart = curves.volume_at_contact.sel(model=name)
        np.testing.assert_array_equal(apart, erosion.impact(name, P.replace(alpha=angles)).volume_at_contact)
    assert curves.volume_at_contact.dims == curves.volume.dims == ("model", "alpha")
    assert curves.volume_at_contact.attrs["units"] == "m^3"
    assert not curves.volume_at_contact.sel(model="linearized").any()
    # A cut alone has none.
    assert "volume_at_contact" not in erosion.compare(["linearized", "rotating"], P, alpha=angles)
    assert "volume_at_contact" not in erosion.sweep("linearized", P, alpha=angles)
    threshold = erosion.sweep("linearized-deformation", P, alpha=angles, threshold=[0.0, 230.0]).volume_at_contact
    assert threshold.sel(threshold=0.0).all()
    assert not threshold.sel(threshold=230.0).any()


def test_blocks_of_a_store_all_have_it(tmp_path):
    options = {"alpha": np.deg2rad([20.0, 60.0]), "store": tmp_path / "sweep.zarr", "chunks": {"model": 1}}
    stored = erosion.sweep(["linearized", "linearized-deformation"], P, **options).volume_at_contact.values
    expected = erosion.impact("linearized-deformation", P.replace(alpha=options["alpha"])).volume_at_contact
    np.testing.assert_array_equal(stored, [[0.0, 0.0], expected])
