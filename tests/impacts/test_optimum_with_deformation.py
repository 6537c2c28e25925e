"""The best angle where deformation removes as well: V″ jumps where v₀ sin α reaches the threshold.

The search here is its own: the closed form of the reference on a fine grid, and bisection on V′.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import erosion
from erosion.models import DeformationWear, Finnie, Linearized, ProportionalDeformationWear
from tests.reference import best_angle, relative_slope, relative_volume

P = erosion.TABLE_1
V0, STRESS = float(P.v0), float(P.sigma * P.psi)
CASES = 100  # of each kind of cut
PEAK = best_angle(2.0)  # where the linearized cut with k = 2 is greatest


# The search itself, of all angles: jumps and kinks are where the body turns far.
alpha_max = functools.partial(erosion.alpha_max, max_turn=None)
alpha_min = functools.partial(erosion.alpha_min, max_turn=None)


class Case:
    """V/V* and V′/V* of the closed forms, with e = ε/(σψ), a threshold over v₀ and s = rφ̇₀/v₀."""

    def __init__(self, kind, k, spin, e, threshold):
        self.kind, self.k, self.spin, self.e, self.threshold = kind, k, spin, e, threshold

    def volume(self, alpha, xp=np):
        cut = relative_volume(self.kind, alpha, self.k, self.spin, xp)
        return cut + xp.maximum(xp.sin(alpha) - self.threshold, 0.0) ** 2 / (2 * self.e)

    def slope(self, alpha):
        above = np.maximum(np.sin(alpha) - self.threshold, 0.0)
        return relative_slope(self.kind, alpha, self.k, self.spin) + above * np.cos(alpha) / self.e

    def maxima(self):
        """(V, α) of every maximum, the greatest first."""
        kink = np.arcsin(self.threshold) if self.threshold <= 1 else np.pi / 2
        grid = np.unique(np.append(np.linspace(1e-4, np.pi / 2, 20_001), kink))
        slopes = self.slope(grid)
        falls = np.flatnonzero((slopes[:-1] > 0) & (slopes[1:] <= 0) & (grid[1:] < np.pi / 2))
        low, high = grid[falls], grid[falls + 1]
        for _ in range(60):
            middle = (low + high) / 2
            rising = self.slope(middle) > 0
            low, high = np.where(rising, middle, low), np.where(rising, high, middle)
        angles = np.append(low, np.pi / 2) if slopes[-2] > 0 else low
        return sorted(zip(self.volume(angles), angles, strict=True), reverse=True)


def random_cases(kind):
    rng = np.random.default_rng(23)
    k, e = np.exp(rng.uniform(-1.6, 1.8, CASES)), np.exp(rng.uniform(-2.3, 3.0, CASES))
    thresholds = np.where(rng.random(CASES) < 0.2, 0.0, rng.uniform(0.0, 1.2, CASES))
    spins = np.where(rng.random(CASES) < 0.5, rng.uniform(-0.6, 0.6, CASES), 0.0)
    if kind == "linearized":
        spins = np.zeros(CASES)
    return [Case(kind, *numbers) for numbers in zip(k, spins, e, thresholds, strict=True)]


def solved(kind, cases):
    k, spin, e, threshold = (np.array([getattr(c, name) for c in cases]) for name in ("k", "spin", "e", "threshold"))
    model = {"linearized": Linearized, "finnie": Finnie}[kind](deformation=DeformationWear())
    model = model.replace(specific_energy=e * STRESS, threshold=threshold * V0)
    return alpha_max(model, P.replace(k=k, phidot0=spin * P.v0 / P.r))


@pytest.mark.parametrize("kind", ["linearized", "finnie"])
def test_random_optima_are_those_of_an_independent_search(kind):
    cases = random_cases(kind)
    best = solved(kind, cases)
    assert np.all(best.certified)
    assert set(best.kind) == {"interior", "boundary"}
    for i, case in enumerate(cases):
        maxima = case.maxima()
        assert best.alpha[i] == pytest.approx(maxima[0][1], abs=1e-9)
        assert best.volume[i] == pytest.approx(maxima[0][0] * P.volume_scale, rel=1e-9)
        assert best.kind[i] == ("boundary" if best.alpha[i] == np.pi / 2 else "interior")
        # Every maximum is found, not only the greatest.
        assert [c.alpha for c in best.candidates[i]] == pytest.approx([alpha for _, alpha in maxima], abs=1e-9)


# Beside the peak of the cut, on the peak, and so far from it that V has two maxima.
ASIDE = np.array([0.0, *(sign * 10.0**power for power in (-12, -10, -8, -6, -5, -4, -3, -2) for sign in (-1, 1))])


@pytest.mark.parametrize("e", [0.2, 0.4, 3.0])
def test_an_optimum_at_or_beside_the_threshold(e):
    # V″ of the cut at its peak is -√5 V*, and above the threshold deformation adds cos²α/e V*.
    cases = [Case("linearized", 2.0, 0.0, e, np.sin(PEAK + aside)) for aside in ASIDE]
    best = solved("linearized", cases)
    assert np.all(best.certified)
    for i, (case, aside) in enumerate(zip(cases, ASIDE, strict=True)):
        maxima = [alpha for _, alpha in case.maxima()]
        assert best.alpha[i] == pytest.approx(maxima[0], abs=1e-9)
        # Nearer to the threshold a maximum and the minimum beside it differ by less than the search resolves.
        if abs(aside) >= 1e-2:
            assert [candidate.alpha for candidate in best.candidates[i]] == pytest.approx(maxima, abs=1e-9)
    assert (best.alpha[0] == pytest.approx(PEAK, abs=1e-9)) == (e > np.cos(PEAK) ** 2 / np.sqrt(5))


def test_sensitivities_are_those_of_the_closed_form():
    cases = [Case("linearized", *n) for n in ((2.0, 0.0, 1.6, 0.3), (2.0, 0.0, 1.6, 0.0), (0.5, 0.0, 0.3, 0.1))]
    best = solved("linearized", cases)
    assert best.kind.tolist() == ["interior", "interior", "boundary"]

    def volume(alpha, e, threshold, case):
        return Case(case.kind, case.k, 0.0, e, threshold).volume(alpha, jnp)

    second = jax.jit(jax.jacfwd(jax.grad(volume), argnums=(0, 1, 2)), static_argnums=3)
    for i, case in enumerate(cases[:2]):
        along = second(best.alpha[i], case.e, case.threshold, case)
        for name, size, mixed in (("specific_energy", STRESS, along[1]), ("threshold", V0, along[2])):
            assert best.sensitivities[name][i] * size == pytest.approx(-float(mixed / along[0]), rel=1e-7)
    # An end of the range stays where it is.
    assert all(rates[2] == 0 for rates in best.sensitivities.values())


def test_where_deformation_outweighs_the_cut_90_degrees_is_best():
    model = Linearized(deformation=ProportionalDeformationWear(0.2))
    best = alpha_max(model, P)
    assert (best.kind, best.alpha, best.attained, best.certified) == ("boundary", np.pi / 2, True, True)
    # What is said of this impact is what the impact does.
    hit = erosion.impact(model, best.p)
    assert (best.ended_by, best.volume) == (hit.ended_by, pytest.approx(hit.volume, rel=1e-14))
    assert hit.ended_by == "no-cut"
    assert best.volume == pytest.approx(float(P.volume_scale) / (2 * 0.2), rel=1e-12)


def test_where_nothing_is_cut_deformation_still_removes_most_somewhere():
    # Finnie's tip moves backward at every angle.
    p = P.replace(phidot0=-1.1 * P.v0 / P.r)
    best = alpha_max(Finnie(deformation=ProportionalDeformationWear(5.0)), p)
    assert (best.kind, best.ended_by, best.alpha) == ("boundary", "no-cut", np.pi / 2)
    assert best.volume == pytest.approx(float(P.volume_scale) / 10, rel=1e-12)


def test_objectives_and_minima():
    model = Linearized(deformation=ProportionalDeformationWear(1.6, 0.3 * V0))
    case = Case("linearized", 2.0, 0.0, 1.6, 0.3)
    volume, alpha = case.maxima()[0]
    per_mass = alpha_max(model, P, objective="volume per mass")
    assert per_mass.alpha == pytest.approx(alpha, abs=1e-9)
    assert per_mass.value == pytest.approx(volume * P.volume_scale / P.m, rel=1e-9)
    # Deformation ends no cut, and makes it no longer.
    longest, without = (alpha_max(m, P, objective="t_c") for m in (model, "linearized"))
    assert (longest.value, longest.alpha) == (without.value, without.alpha)
    model, case = (
        Linearized(deformation=ProportionalDeformationWear(0.2, 0.7 * V0)),
        Case("linearized", 2.0, 0.0, 0.2, 0.7),
    )
    low, high = np.deg2rad([35.0, 90.0])
    least = alpha_min(model, P, alpha_range=(low, high))
    grid = np.linspace(low, high, 100_001)
    assert least.value == pytest.approx(case.volume(grid).min() * P.volume_scale, rel=1e-9)
    assert least.alpha == pytest.approx(grid[case.volume(grid).argmin()], abs=2e-5)
    assert (least.kind, least.certified) == ("interior", True)
