"""How lanes are shared out and which are integrated again, with a program whose errors are known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.engine import batch
from erosion.engine.leaves import Layout, split
from erosion.engine.outcomes import names_of
from erosion.lanes.lanewise import WIDTH
from erosion.parameters.parameters import QUANTITIES

RTOL = 1e-9
NAMES = list(QUANTITIES)
P = erosion.TABLE_1


class Program:
    """Gives the angle as the volume, off by ψ times the tolerance; and asks for a tolerance m times smaller."""

    def __init__(self, layout: Layout, directions: int = 0) -> None:
        self.inputs = [*layout.shapes, *[()] * directions, ()]
        self.directions = directions
        self.runs: list[tuple[np.ndarray, np.ndarray]] = []

    def run(
        self,
        leaves: Sequence[np.ndarray],
        lanes: np.ndarray,
        outputs: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
    ) -> None:
        own = [
            np.broadcast_to(leaf, lanes.max(initial=0) + 1)[lanes] if leaf.ndim == 0 else leaf[lanes] for leaf in leaves
        ]
        numbers, tolerance = dict(zip(NAMES, own, strict=False)), own[-1]
        self.runs.append((lanes.copy(), tolerance.copy()))
        outcome, asked, *results, trials = outputs
        value = numbers["alpha"] * (1 + numbers["psi"] * tolerance)
        outcome[lanes], trials[lanes] = 0, len(self.runs)
        asked[lanes] = tolerance / numbers["m"]
        for result in results:
            result[lanes] = value
        if self.directions:
            results[-1][lanes] = 100 * numbers["alpha"] + own[-2]
        self.spoil(lanes, outputs)

    def spoil(self, lanes: np.ndarray, outputs: Sequence[np.ndarray]) -> None:
        """Nothing goes wrong."""

    def tolerances(self, lane: int) -> list[float]:
        """With which one lane was integrated."""
        return [tolerance[lanes == lane].item() for lanes, tolerance in self.runs if lane in lanes]


def integrate(monkeypatch: pytest.MonkeyPatch, kind: type[Program] = Program, *, again: bool = True, **changes: Any):
    """What the batch makes of the program, and the program."""
    p = P.replace(psi=1.0, m=1.0).replace(**changes)
    layout, numbers = split(erosion.load_model("linearized"), p)
    program = kind(layout)
    monkeypatch.setattr(batch, "_program", lambda *_: program)
    results = batch.integrate(layout, numbers, np.size(p.alpha), 0, (), RTOL, again=again)
    return results, program


def test_only_doubtful_lanes_are_integrated_again(monkeypatch) -> None:
    """Errors of 1000 tolerances, foreseen: one integration more makes them as small as asked for."""
    amplified = np.where(np.arange(20) % 7 == 3, 1e3, 1.0)
    angles = np.linspace(0.1, 1.5, 20)
    results, program = integrate(monkeypatch, alpha=angles, psi=amplified, m=amplified)
    for lane in range(20):
        assert program.tolerances(lane) == ([RTOL, RTOL / 1e3] if lane % 7 == 3 else [RTOL])
    assert results.volume.value == pytest.approx(angles, rel=1.001 * RTOL)
    assert list(results.trials) == [2 if lane % 7 == 3 else 1 for lane in range(20)]
    results, program = integrate(monkeypatch, again=False, alpha=angles, psi=amplified, m=amplified)
    assert len(program.runs) == 1
    assert results.volume.value[3] == pytest.approx(angles[3] * (1 + 1e3 * RTOL), rel=1e-15)


def test_what_the_second_integration_changed_says_whether_there_is_a_third(monkeypatch) -> None:
    """Errors of 1000 tolerances, of which ten are foreseen."""
    _, program = integrate(monkeypatch, alpha=np.array([0.3]), psi=1e3, m=10.0)
    first, second, third = program.tolerances(0)
    assert (first, second) == (RTOL, RTOL / 10)
    # The change is 0.9 of the first error, 1000 tolerances.
    assert third == pytest.approx(RTOL / 1e3 / 0.9, rel=1e-5)


def test_no_tolerance_is_beyond_rounding(monkeypatch) -> None:
    _, program = integrate(monkeypatch, alpha=np.array([0.3]), psi=1e8, m=10.0)
    assert min(program.tolerances(0)) == 1e-13


class Lost(Program):
    """Fails with any tolerance but the first."""

    def spoil(self, lanes, outputs):
        outputs[0][lanes[self.runs[-1][1] < RTOL]] = 3


def test_what_never_succeeds_is_tried_four_times(monkeypatch) -> None:
    results, program = integrate(monkeypatch, Lost, alpha=np.array([0.3]), psi=1e3, m=1e4)
    assert len(program.runs) == 1 + 4
    assert results.outcome == [0]
    assert results.volume.value == pytest.approx(0.3 * (1 + 1e3 * RTOL), rel=1e-15)


class Rounded(Program):
    """Fails with less than a hundredth of the tolerance."""

    def spoil(self, lanes, outputs):
        failed = self.runs[-1][1] < RTOL / 100
        outputs[0][lanes[failed]] = 3
        for output in outputs[2:4]:
            output[lanes[failed]] = np.nan


def test_one_that_fails_for_rounding_keeps_what_was_known(monkeypatch) -> None:
    results, program = integrate(monkeypatch, Rounded, alpha=np.array([0.3, 0.4]), psi=1e3, m=np.array([1e4, 1.0]))
    first, second, third, *_ = program.tolerances(0)
    assert (first, second) == (RTOL, RTOL / 1e4)
    # Between the one that was good and the one that was not.
    assert third == pytest.approx(np.sqrt(first * second))
    assert list(results.outcome) == [0, 0]
    known = min(tolerance for tolerance in program.tolerances(0) if tolerance >= RTOL / 100)
    assert results.volume.value == pytest.approx([0.3 * (1 + 1e3 * known), 0.4 * (1 + 1e3 * RTOL)], rel=1e-12)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("lanes", [0, 1, batch._FEW, batch._FEW + 1, 10_001])
def test_every_lane_is_computed_once(monkeypatch, threads: int, lanes: int) -> None:
    monkeypatch.setattr(batch, "threads", lambda: threads)
    monkeypatch.setattr(batch, "_BLOCK", 1000)
    angles = np.random.default_rng(4).uniform(0.1, 1.5, lanes)
    results, program = integrate(monkeypatch, alpha=angles)
    assert sorted(np.concatenate([[], *(run for run, _ in program.runs)])) == list(range(lanes))
    assert np.array_equal(results.volume.value, angles * (1 + RTOL))
    sizes = [run.size for run, _ in program.runs]
    assert max(sizes, default=0) <= 1000 or lanes <= batch._FEW
    if lanes > batch._FEW and threads > 1:
        assert len(sizes) % threads == 0
        assert max(sizes) - min(sizes) <= 1


def test_neighbours_in_a_vector_are_alike(monkeypatch) -> None:
    angles = np.random.default_rng(5).uniform(0.1, 1.5, 100 * WIDTH)
    _, program = integrate(monkeypatch, alpha=angles)
    ((lanes, _),) = program.runs
    spread = np.ptp(angles[lanes].reshape(-1, WIDTH), axis=1)
    # Vectors of a sorted list, as a hundred of them are, would have a hundredth of the range.
    assert spread.mean() < 0.011 * np.ptp(angles)


def test_directions_vary_fastest(monkeypatch) -> None:
    """Each lane along each direction, in an array of (lanes, directions)."""
    angles = np.array([0.1, 0.2, 0.3])
    layout, numbers = split(erosion.load_model("linearized"), P.replace(alpha=angles, psi=1.0, m=1.0))
    program = Program(layout, directions=1)
    monkeypatch.setattr(batch, "_program", lambda *_: program)
    results = batch.integrate_along(layout, numbers, 3, 1, np.array([[5.0, 7.0]]), RTOL)
    assert np.array_equal(results.volume.other, 100 * angles[:, None] + [5, 7])
    assert results.outcome.shape == (3, 2)


def test_a_failure_is_known_by_its_place_among_the_outcomes() -> None:
    assert names_of(split(erosion.load_model("linearized"), P)[0])[3] == "failed"
