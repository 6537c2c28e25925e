"""No cut ends wrongly: the kernel against brute force with small steps."""

import numpy as np
import pytest

import erosion
from benchmarks.fast_turns import fast_turns
from erosion.impacts.impact import split
from erosion.ode.batch import integrate
from tests.fine_steps import wrong_ends

P = erosion.TABLE_1


# Each force and each torque; a force along the velocity has the ends of one at tan α.
@pytest.mark.parametrize(
    "name", ["rotating", "rotating-full-torque", "rotating-tan-alpha", "rotating-velocity-aligned-full-torque"]
)
def test_ends_are_those_of_small_steps(name):
    # A sample of the grid that benchmarks/ends.py covers (20,000 angles × 19 spins).
    alphas = np.deg2rad(np.linspace(0.05, 89.95, 201))
    spins = np.linspace(-0.9, 0.9, 7)[:, None]
    p = P.replace(alpha=alphas, phidot0=spins * P.v0 / P.r)
    model = erosion.load_model(name)
    wrong, near = wrong_ends(model, p, erosion.impact(model, p).ended_by)
    assert wrong == 0
    assert near <= 2


def test_the_reference_itself_knows_the_closed_form():
    from tests.reference import closed_form

    p = P.replace(alpha=np.arctan(1) + np.deg2rad(np.linspace(-2, 2, 100)))
    wrong, _ = wrong_ends(erosion.load_model("linearized"), p, closed_form("linearized").ended_by(p))
    assert wrong == 0
    reversed_ends = np.where(closed_form("linearized").ended_by(p) == "stop", "rebound", "stop")
    wrong, _ = wrong_ends(erosion.load_model("linearized"), p, reversed_ends)
    assert wrong == 100


def test_a_dip_before_the_end_is_not_looked_for_for_ever():
    # Between the step's start and its end past zero is a dip that stays positive.
    p = P.replace(
        k=3.416359702877047, v0=3865.5369915730844, r=0.18975583800561208, phidot0=-5538.944996032343,
        inertia=0.5376768582569, alpha=np.deg2rad(29.335018174890664) + 1e-9 * np.arange(-500, 500),
    )  # fmt: skip
    layout, numbers = split(erosion.load_model("rotating"), p)
    results = integrate(layout, numbers, 1000, 0, (), 1e-9)
    assert results.trials.max() < 100
    assert np.all(results.outcome < 2)


def _agree_with_tight(p, **options):
    found = erosion.impact("rotating", p, **options)
    tight = erosion.impact("rotating", p, rtol=1e-13, **options)
    assert np.array_equal(found.ended_by, tight.ended_by)
    return found, tight


def test_hundreds_of_turns_end_in_the_right_one():
    # rω/v₀ = 3e-4: the tip turns up to thousands of times, and often all but touches the surface.
    generator = np.random.default_rng(1958)
    r = P.r * 3e-4 / (P.r * P.rate / P.v0) * np.exp(generator.uniform(-1, 1, 500))
    p = P.replace(
        r=r,
        phidot0=generator.uniform(-0.9, 0.9, 500) * P.v0 / r,
        alpha=generator.uniform(0.02, 1.5, 500),
        k=generator.uniform(0.5, 4, 500),
    )
    found, tight = _agree_with_tight(p)
    # Local errors of thousands of steps add up.
    assert found.volume == pytest.approx(tight.volume, rel=1e-8, abs=0)
    assert found.t_c == pytest.approx(tight.t_c, rel=1e-8, abs=0)


def test_accuracy_holds_over_a_wide_range():
    generator = np.random.default_rng(1958)
    n = 20_000
    r, v0 = P.r * np.exp(generator.uniform(-1, 1, n)), P.v0 * np.exp(generator.uniform(-0.7, 0.7, n))
    p = P.replace(
        alpha=np.deg2rad(generator.uniform(0.5, 89.5, n)),
        k=np.exp(generator.uniform(np.log(0.3), np.log(5), n)),
        r=r,
        v0=v0,
        inertia=generator.uniform(0.2, 1, n),
        phidot0=generator.uniform(-0.9, 0.9, n) * v0 / r,
    )
    found, tight = _agree_with_tight(p, derivatives=2)
    assert found.volume == pytest.approx(tight.volume, rel=1e-9, abs=0)
    assert found.t_c == pytest.approx(tight.t_c, rel=1e-9, abs=0)
    # Derivatives pass through zero; a few second ones are small sums of large terms.
    size = np.maximum(np.abs(tight.dvolume), tight.volume)
    assert np.all(np.abs(found.dvolume - tight.dvolume) <= 2e-9 * size)
    size = np.maximum(np.abs(tight.d2volume), size)
    off = np.abs(found.d2volume - tight.d2volume) / np.where(size > 0, size, 1)
    assert np.quantile(off, 0.9995) < 1e-9
    assert np.max(off) < 5e-8


@pytest.mark.parametrize(("k", "jump"), [(1.0, 0.6980661779724753), (2.0, 0.7491399133831508)])
@pytest.mark.parametrize("order", [0, 2])
def test_beside_a_graze_results_are_as_exact(k: float, jump: float, order: int) -> None:
    """Just above a jump of V(α) the tip's height falls through zero nearly touching it."""
    p = erosion.TABLE_1.replace(k=k, alpha=jump + np.logspace(-9, -5, 33), phidot0=0.0)
    true = erosion.impact("rotating", p, derivatives=order, rtol=1e-13)
    found = erosion.impact("rotating", p, derivatives=order)
    assert np.array_equal(found.ended_by, true.ended_by)
    assert found.volume == pytest.approx(true.volume, rel=1e-11, abs=0)
    assert found.t_c == pytest.approx(true.t_c, rel=1e-9, abs=0)
    if order:
        assert found.dvolume == pytest.approx(true.dvolume, rel=1e-9, abs=0)
        assert found.d2volume == pytest.approx(true.d2volume, rel=1e-5, abs=0)


# Where the tip leaves the surface just as its forward motion ends, found at rtol 1e-13.
BOTH_AT_ONCE = [
    ("rotating-full-torque", 3.078017788675913, 4376.322968469776, 0.07905201401510317, 30323.695778164674,
     0.5238927166841869, 1.2771780966347008),
    ("rotating-full-torque", 4.9887494438401845, 9745.209780577792, 0.1357308559605275, 38887.40717538758,
     0.49812418477439285, 1.3269567292620699),
    ("rotating-tan-alpha", 0.36395544630922627, 7147.583400786628, 0.24827711175942138, 23164.054032249092,
     0.44588681309424194, 1.3977155361737053),
    ("rotating-velocity-aligned", 0.6050561034503813, 9432.404611009293, 0.25033418045388506, 25545.800746181256,
     0.3572410974427115, 1.4555764327165823),
    ("rotating-tan-alpha-full-torque", 0.8141381997555498, 7343.782710082683, 0.13040857172506432, 25775.868079639444,
     0.5916171408562353, 1.2020121652434117),
]  # fmt: skip


@pytest.mark.parametrize(("row", "order"), [*zip(BOTH_AT_ONCE, (0, 2, 0, 2, 0), strict=True)])
def test_of_two_ends_at_almost_the_same_time_the_first_is_taken(row: tuple, order: int) -> None:
    name, *numbers, angle = row
    p = P.replace(**dict(zip(("k", "v0", "r", "phidot0", "inertia"), numbers, strict=True)))
    beside = np.logspace(-10, -7, 31)
    for rtol in (1e-9, 1e-11):
        below, above = (
            set(erosion.impact(name, p.replace(alpha=angle + sign * beside), derivatives=order, rtol=rtol).ended_by)
            for sign in (-1, 1)
        )
        assert {*below, *above} == {"rebound", "stop"}, rtol
        assert len(below) == len(above) == 1, rtol


def test_a_stop_within_a_fast_oscillation_is_not_stepped_over():
    # Turned by radians within a step; the figure is scipy's, at 1e-12 with steps of 1e-5 of the time scale.
    p = P.replace(psi=1e-6, alpha=0.3141, phidot0=-2958.0)
    assert erosion.impact("rotating", p).volume == pytest.approx(6.7725336, rel=1e-8, abs=0)
    # At once: not because a lane of so many steps is integrated again.
    layout, numbers = split(erosion.load_model("rotating"), p)
    first = integrate(layout, numbers, 1, 0, (), 1e-9, again=False)
    assert first.outputs.value[0][0] == pytest.approx(6.7725336, rel=1e-8, abs=0)


@pytest.mark.parametrize("name", ["rotating", "rotating-full-torque"])
def test_bodies_that_turn_fast_miss_no_end(name):
    # A sample of what benchmarks/fast_turns.py covers (a million).
    p = fast_turns(4000, seed=5)
    hits, exact = erosion.impact(name, p), erosion.impact(name, p, rtol=1e-12)
    assert np.array_equal(hits.ended_by, exact.ended_by)
    assert "failed" not in hits.ended_by
    cut = exact.t_c > 0
    assert hits.t_c[cut] == pytest.approx(exact.t_c[cut], rel=1e-7, abs=0)
    assert hits.volume[cut] == pytest.approx(exact.volume[cut], rel=1e-7, abs=0)
