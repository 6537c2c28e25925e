"""Functions of a number whose jumps are known, resolved."""

import dataclasses

import numpy as np
import pytest

from erosion.ode.resolve import Nodes, Ruler, Scan, is_jump, scan

GRID = np.linspace(0.1, 1.5, 40)
PLACES = np.array([0.3, 0.7000123, 1.2])


@dataclasses.dataclass(frozen=True)
class Broken:
    """sin x, and from each case's place on cos x / 2; in a band beside it the lanes fail."""

    outcome_changes: bool  # else only the time changes
    band: float = 0.0

    def __call__(self, case: np.ndarray, at: np.ndarray) -> Nodes:
        after, failed = self._after(case, at)
        value, slope, curve = (
            np.where(failed, np.nan, np.where(after, above, below))
            for below, above in (
                (np.sin(at), np.cos(at) / 2),
                (np.cos(at), -np.sin(at) / 2),
                (-np.sin(at), -np.cos(at) / 2),
            )
        )
        outcomes, times, _ = self.outcomes(case, at)
        return Nodes(case, at, value, slope, curve, times, outcomes)

    def outcomes(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        after, failed = self._after(case, at)
        codes = np.where(failed, 2, (after & self.outcome_changes).astype(int))
        times = np.where(failed, np.nan, np.where(after, 1.0, 2.0) + at / 10)
        return codes, times, np.where(failed, np.nan, np.where(after, np.cos(at) / 2, np.sin(at)))

    def _after(self, case: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        beyond = at - PLACES[case]
        return beyond > 0, np.abs(beyond - self.band) < self.band


def _scan(function: Broken) -> Scan:
    return scan(function, function, PLACES.size, GRID, Ruler(1.0))


@pytest.mark.parametrize("outcome_changes", [True, False])
def test_a_jump_is_bracketed_whether_or_not_the_outcome_changes(outcome_changes: bool) -> None:
    scanned = _scan(Broken(outcome_changes))
    assert not scanned.unresolved.any()
    jumps = scanned.narrow.middle[is_jump(scanned.narrow, scanned.size[scanned.narrow.low.case])]
    # Bracketed to 1e-11, of which the middle is at most half off; and rounding.
    assert np.sort(jumps) == pytest.approx(PLACES, abs=6e-12)
    # All the rest is smooth.
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert covered == pytest.approx(np.full(3, np.ptp(GRID)), abs=1e-7)


def test_failed_lanes_are_counted_and_hide_only_their_neighbours() -> None:
    scanned = _scan(Broken(outcome_changes=True, band=1e-4))
    assert np.all(scanned.unresolved > 0)
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert np.all(covered > np.ptp(GRID) - 1e-3)


def test_a_change_of_outcome_that_a_tighter_tolerance_does_not_confirm_is_kept_and_counted() -> None:
    scanned = scan(Broken(outcome_changes=True), Broken(outcome_changes=False), PLACES.size, GRID, Ruler(1.0))
    assert np.array_equal(scanned.unresolved, [1, 1, 1])
    changes = scanned.narrow.outcome_changes
    assert np.sort(scanned.narrow.middle[changes]) == pytest.approx(PLACES, abs=3e-8)
