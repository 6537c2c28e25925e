"""Functions of the angle whose jumps are known, resolved."""

import dataclasses

import numpy as np
import pytest

from erosion.optimum.resolve import Nodes, Scan, is_jump, scan

ANGLES = np.linspace(0.1, 1.5, 40)
PLACES = np.array([0.3, 0.7000123, 1.2])


@dataclasses.dataclass(frozen=True)
class Broken:
    """sin α, and from each case's place on cos α / 2; in a band beside it the impacts fail."""

    outcome_changes: bool  # else only the end time changes
    band: float = 0.0

    def __call__(self, case: np.ndarray, alpha: np.ndarray) -> Nodes:
        after, failed = self._after(case, alpha)
        value, slope, curve = (
            np.where(failed, np.nan, np.where(after, above, below))
            for below, above in (
                (np.sin(alpha), np.cos(alpha) / 2),
                (np.cos(alpha), -np.sin(alpha) / 2),
                (-np.sin(alpha), -np.cos(alpha) / 2),
            )
        )
        outcomes, times, _ = self.outcomes(case, alpha)
        return Nodes(case, alpha, value, slope, curve, times, outcomes)

    def outcomes(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        after, failed = self._after(case, alpha)
        codes = np.where(failed, 2, (after & self.outcome_changes).astype(int))
        times = np.where(failed, np.nan, np.where(after, 1.0, 2.0) + alpha / 10)
        return codes, times, np.where(failed, np.nan, np.where(after, np.cos(alpha) / 2, np.sin(alpha)))

    def _after(self, case: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        beyond = alpha - PLACES[case]
        return beyond > 0, np.abs(beyond - self.band) < self.band


def _scan(function: Broken) -> Scan:
    return scan(function, function, PLACES.size, ANGLES)


@pytest.mark.parametrize("outcome_changes", [True, False])
def test_a_jump_is_bracketed_whether_or_not_the_outcome_changes(outcome_changes: bool) -> None:
    scanned = _scan(Broken(outcome_changes))
    assert not scanned.unresolved.any()
    jumps = scanned.narrow.middle[is_jump(scanned.narrow, scanned.size[scanned.narrow.low.case])]
    # Bracketed to 1e-11, of which the middle is at most half off; and rounding.
    assert np.sort(jumps) == pytest.approx(PLACES, abs=6e-12)
    # All the rest is smooth.
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert covered == pytest.approx(np.full(3, np.ptp(ANGLES)), abs=1e-7)


def test_failed_impacts_are_counted_and_hide_only_their_neighbours() -> None:
    scanned = _scan(Broken(outcome_changes=True, band=1e-4))
    assert np.all(scanned.unresolved > 0)
    covered = np.bincount(scanned.smooth.low.case, weights=scanned.smooth.width)
    assert np.all(covered > np.ptp(ANGLES) - 1e-3)


def test_a_change_of_outcome_that_a_tighter_tolerance_does_not_confirm_is_kept_and_counted() -> None:
    scanned = scan(Broken(outcome_changes=True), Broken(outcome_changes=False), PLACES.size, ANGLES)
    assert np.array_equal(scanned.unresolved, [1, 1, 1])
    changes = scanned.narrow.outcome_changes
    assert np.sort(scanned.narrow.middle[changes]) == pytest.approx(PLACES, abs=3e-8)
