"""How lanes are shared out and which are integrated again, with a program whose errors are known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from erosion.lanes.lanewise import WIDTH
from erosion.ode import batch
from erosion.ode.integrator import LaneEnd
from erosion.ode.problem import Event, Problem
from erosion.ode.signature import Signature
from erosion.ode.variational import Derivatives
from tests.ode.problems import lanes_of

RTOL = 1e-9
ARGS = {"asked": 1.0, "off": 1.0, "value": 0.3}
NAMES = list(ARGS)
PROBLEM = Problem(
    0.0, lambda t, y, args: args["value"], {"end": Event(lambda t, y, args: y - 1)}, {"value": lambda t, y, args: y}
)
SIGNATURE, _ = lanes_of(PROBLEM, ARGS)
END, FAILED = (SIGNATURE.end_names.index(name) for name in ("end", "failed"))


class Program:
    """Gives `value` as the integral, off by `off` tolerances; and asks for a tolerance `asked` times smaller."""

    def __init__(self, signature: Signature = SIGNATURE, directions: int = 0) -> None:
        self.inputs = [*signature.shapes, *[()] * directions, ()]
        self.directions = directions
        self.runs: list[tuple[np.ndarray, np.ndarray]] = []

    def run(
        self,
        leaves: Sequence[np.ndarray],
        lanes: np.ndarray,
        outputs: Sequence[np.ndarray],
        stop: np.ndarray | None = None,
        tapes: Sequence[np.ndarray] = (),
    ) -> None:
        own = [
            np.broadcast_to(leaf, lanes.max(initial=0) + 1)[lanes] if leaf.ndim == 0 else leaf[lanes] for leaf in leaves
        ]
        numbers, tolerance = dict(zip(NAMES, own, strict=False)), own[-1]
        self.runs.append((lanes.copy(), tolerance.copy()))
        outcome, asked, *results, trials = outputs
        value = numbers["value"] * (1 + numbers["off"] * tolerance)
        outcome[lanes], trials[lanes] = END, len(self.runs)
        asked[lanes] = tolerance / numbers["asked"]
        for result in results:
            result[lanes] = value
        if self.directions:
            results[-1][lanes] = 100 * numbers["value"] + own[-2]
        self.spoil(lanes, outputs)

    def spoil(self, lanes: np.ndarray, outputs: Sequence[np.ndarray]) -> None:
        """Nothing goes wrong."""

    def tolerances(self, lane: int) -> list[float]:
        """With which one lane was integrated."""
        return [tolerance[lanes == lane].item() for lanes, tolerance in self.runs if lane in lanes]

    @property
    def results(self) -> LaneEnd:
        """Types of a lane's results."""
        number = np.zeros(())
        slope = number if self.directions else None
        time = Derivatives(number, slope, slope, None)
        outputs = Derivatives(*(None if part is None else [part] for part in time))
        return LaneEnd(np.zeros((), np.int8), number, time, outputs, np.zeros((), np.int32), None)


def integrate(monkeypatch: pytest.MonkeyPatch, kind: type[Program] = Program, *, refines: bool = True, **changes: Any):
    """What the batch makes of the program, and the program."""
    numbers = [np.asarray(number) for number in {**ARGS, **changes}.values()]
    program = kind()
    monkeypatch.setattr(batch, "integrator_of", lambda *_: (program, program.results))
    results = batch.integrate(SIGNATURE, numbers, np.size(numbers[-1]), 0, (), RTOL, refines=refines)
    return results, program


def test_only_doubtful_lanes_are_integrated_again(monkeypatch) -> None:
    """Errors of 1000 tolerances, foreseen: one integration more makes them as small as asked for."""
    amplified = np.where(np.arange(20) % 7 == 3, 1e3, 1.0)
    values = np.linspace(0.1, 1.5, 20)
    results, program = integrate(monkeypatch, value=values, off=amplified, asked=amplified)
    for lane in range(20):
        assert program.tolerances(lane) == ([RTOL, RTOL / 1e3] if lane % 7 == 3 else [RTOL])
    assert results.outputs.value[0] == pytest.approx(values, rel=1.001 * RTOL)
    assert list(results.trials) == [2 if lane % 7 == 3 else 1 for lane in range(20)]
    results, program = integrate(monkeypatch, refines=False, value=values, off=amplified, asked=amplified)
    assert len(program.runs) == 1
    assert results.outputs.value[0][3] == pytest.approx(values[3] * (1 + 1e3 * RTOL), rel=1e-15)


def test_what_the_second_integration_changed_says_whether_there_is_a_third(monkeypatch) -> None:
    """Errors of 1000 tolerances, of which ten are foreseen."""
    _, program = integrate(monkeypatch, value=np.array([0.3]), off=1e3, asked=10.0)
    first, second, third = program.tolerances(0)
    assert (first, second) == (RTOL, RTOL / 10)
    # The change is 0.9 of the first error, 1000 tolerances.
    assert third == pytest.approx(RTOL / 1e3 / 0.9, rel=1e-5)


def test_a_cheaper_integration_tells_which_lanes_need_a_dearer_one(monkeypatch) -> None:
    """Where a greater tolerance is asked for, errors that grow with it show; the first results stay without that."""
    off = np.where(np.arange(20) % 7 == 3, 50.0, 0.5)
    values = np.linspace(0.1, 1.5, 20)
    results, program = integrate(monkeypatch, value=values, off=off, asked=np.full(20, 1e-2))
    for lane in range(20):
        wanted = [RTOL, 100 * RTOL, *([RTOL / 50 / 0.99] if lane % 7 == 3 else [])]
        assert program.tolerances(lane)[:3] == pytest.approx(wanted, rel=1e-5)
    assert results.outputs.value[0] == pytest.approx(values, rel=1.1 * RTOL)
    assert np.all(results.trials[off < 1] == 1)


def test_no_tolerance_is_beyond_rounding(monkeypatch) -> None:
    _, program = integrate(monkeypatch, value=np.array([0.3]), off=1e8, asked=10.0)
    assert min(program.tolerances(0)) == 1e-13


class Lost(Program):
    """Fails with any tolerance but the first."""

    def spoil(self, lanes, outputs):
        outputs[0][lanes[self.runs[-1][1] < RTOL]] = FAILED


def test_what_never_succeeds_is_tried_four_times(monkeypatch) -> None:
    results, program = integrate(monkeypatch, Lost, value=np.array([0.3]), off=1e3, asked=1e4)
    assert len(program.runs) == 1 + 4
    assert results.outcome == [END]
    assert results.outputs.value[0] == pytest.approx(0.3 * (1 + 1e3 * RTOL), rel=1e-15)


class Rounded(Program):
    """Fails with less than a hundredth of the tolerance."""

    def spoil(self, lanes, outputs):
        failed = self.runs[-1][1] < RTOL / 100
        outputs[0][lanes[failed]] = FAILED
        for output in outputs[2:4]:
            output[lanes[failed]] = np.nan


def test_one_that_fails_for_rounding_keeps_what_was_known(monkeypatch) -> None:
    results, program = integrate(monkeypatch, Rounded, value=np.array([0.3, 0.4]), off=1e3, asked=np.array([1e4, 1.0]))
    first, second, third, *_ = program.tolerances(0)
    assert (first, second) == (RTOL, RTOL / 1e4)
    # Between the one that was good and the one that was not.
    assert third == pytest.approx(np.sqrt(first * second))
    assert list(results.outcome) == [END, END]
    known = min(tolerance for tolerance in program.tolerances(0) if tolerance >= RTOL / 100)
    assert results.outputs.value[0] == pytest.approx([0.3 * (1 + 1e3 * known), 0.4 * (1 + 1e3 * RTOL)], rel=1e-12)


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("lanes", [0, 1, batch._FEW, batch._FEW + 1, 10_001])
def test_every_lane_is_computed_once(monkeypatch, threads: int, lanes: int) -> None:
    monkeypatch.setattr(batch, "threads", lambda: threads)
    monkeypatch.setattr(batch, "_BLOCK", 1000)
    values = np.random.default_rng(4).uniform(0.1, 1.5, lanes)
    results, program = integrate(monkeypatch, value=values)
    assert sorted(np.concatenate([[], *(run for run, _ in program.runs)])) == list(range(lanes))
    assert np.array_equal(results.outputs.value[0], values * (1 + RTOL))
    sizes = [run.size for run, _ in program.runs]
    assert max(sizes, default=0) <= 1000 or lanes <= batch._FEW
    if lanes > batch._FEW and threads > 1:
        assert len(sizes) % threads == 0
        assert max(sizes) - min(sizes) <= 1


def test_neighbours_in_a_vector_are_alike(monkeypatch) -> None:
    values = np.random.default_rng(5).uniform(0.1, 1.5, 100 * WIDTH)
    _, program = integrate(monkeypatch, value=values)
    ((lanes, _),) = program.runs
    spread = np.ptp(values[lanes].reshape(-1, WIDTH), axis=1)
    # Vectors of a sorted list, as a hundred of them are, would have a hundredth of the range.
    assert spread.mean() < 0.011 * np.ptp(values)


def test_directions_vary_fastest(monkeypatch) -> None:
    """Each lane along each direction, in an array of (lanes, directions)."""
    values = np.array([0.1, 0.2, 0.3])
    numbers = [np.ones(()), np.ones(()), values]
    program = Program(directions=1)
    monkeypatch.setattr(batch, "integrator_of", lambda *_: (program, program.results))
    results = batch.integrate_along(SIGNATURE, numbers, 3, 1, np.array([[5.0, 7.0]]), RTOL)
    assert np.array_equal(results.outputs.by_second[0], 100 * values[:, None] + [5, 7])
    assert results.outcome.shape == (3, 2)


def test_codes_are_events_and_then_the_other_ends() -> None:
    assert SIGNATURE.end_names == ("end", "start", "failed", "unfinished", "t1")
    codes = np.arange(5)
    assert np.array_equal(SIGNATURE.has_no_result(codes), (codes == FAILED) | (codes == FAILED + 1))
