"""What the report's sentences say of directions and sizes: over random cases, or by what makes the sentence true."""

import numpy as np
import pytest

import erosion
from erosion.impacts import path, turned_beyond
from erosion.models import load_model
from erosion.models.rigid import LinearizedCut, StraightCut
from erosion.parameters.parameters import TABLE_1, Parameters
from erosion.report.case import ReportCase
from erosion.report.questions.linearized import midpoint_rule

SI = TABLE_1.to("si")

N = 200
RNG = np.random.default_rng(16)
K = 10 ** RNG.uniform(-1, 1, N)
ALPHA = RNG.uniform(np.deg2rad(1), np.deg2rad(89), N)
S = RNG.uniform(-0.95, 0.95, N)
FACTORS = {name: 10 ** RNG.uniform(-1, 1, N) for name in ("v0", "m", "sigma", "psi", "r", "b")}
VARIED = (*FACTORS, "k", "alpha", "phidot0")
ROTATING = ("rotating", "rotating-full-torque")


def cases(**changes: np.ndarray | float) -> Parameters:
    """200 cases about Table 1, without spin."""
    values = {name: getattr(SI, name) * factor for name, factor in FACTORS.items()}
    return SI.replace(**{**values, "k": K, "alpha": ALPHA, "phidot0": 0.0, **changes})


def volume(model: str, p: Parameters) -> np.ndarray:
    """V over V* [-]."""
    return erosion.impact(model, p, derivatives=0).volume / np.asarray(p.volume_scale)


def test_spin_has_no_direction_that_holds_in_every_case() -> None:
    """A tip that runs ahead may cut less or more, shorter or longer, and so may one that lags."""
    for model in ROTATING:
        cuts = [
            erosion.impact(model, cases(phidot0=s * cases().v0 / cases().r), derivatives=0) for s in (-0.3, 0.0, 0.3)
        ]
        for values in ([cut.volume for cut in cuts], [cut.t_c for cut in cuts]):
            lagging, still, ahead = (np.asarray(value) for value in values)
            assert np.any(ahead < still)
            assert np.any(ahead > still)
            assert np.any(lagging > still)
            assert np.any(lagging < still)


def test_a_small_turn_does_not_make_the_linearization_fair() -> None:
    large = SI.replace(r=1000 * SI.r)
    cut = path(load_model("rotating"), large)
    assert abs(cut.turn) < np.deg2rad(1)
    assert abs(cut.volume / float(LinearizedCut().volume(large)) - 1) > 0.1


@pytest.mark.parametrize("model", ROTATING)
def test_nothing_is_cut_where_the_tip_moves_backward_and_only_there(model: str) -> None:
    p = cases(phidot0=S * cases().v0 / cases().r)
    cut = volume(model, p)
    backward = np.cos(ALPHA) + S <= 0
    assert 10 < backward.sum() < N - 10
    assert np.all(cut[backward] == 0)
    assert np.all(cut[~backward] > 0)
    for s in (-1.0, -1.5):
        assert np.all(volume(model, cases(phidot0=s * cases().v0 / cases().r)) == 0)
    # At 90° spin alone decides.
    assert np.all((volume(model, cases(alpha=np.pi / 2, phidot0=S * cases().v0 / cases().r)) > 0) == (S > 0))


@pytest.mark.parametrize("model", ["linearized", *ROTATING])
def test_all_parameters_act_through_omega_k_and_s(model: str) -> None:
    reach = np.asarray(cases().r * cases().rate / cases().v0)
    plain = SI.replace(k=K, alpha=ALPHA, phidot0=0.0)
    r = reach * np.asarray(plain.v0 / plain.rate)
    spins = S if model != "linearized" else 0 * S
    one = volume(model, cases(phidot0=spins * cases().v0 / cases().r))
    other = volume(model, plain.replace(r=r, phidot0=spins * plain.v0 / r))
    # The engine's tolerance is 1e-9 a step; at a graze of an end it decides where the cut ends.
    assert np.mean(np.abs(one - other) < 1e-7) > 0.98


def test_the_linearized_model_has_the_stated_laws() -> None:
    exact, p = LinearizedCut(), cases()
    best = np.arctan(K) / 2
    v_max = np.asarray(exact.volume(p.replace(alpha=best))) / np.asarray(p.volume_scale)
    assert v_max == pytest.approx((np.sqrt(1 + K**2) - 1) / K**2, rel=1e-9)
    assert np.all(np.asarray(exact.volume(p)) / np.asarray(p.volume_scale) <= v_max * (1 + 1e-12))
    order = np.argsort(K)
    assert np.all(np.diff(best[order]) > 0)
    assert np.all(best < np.pi / 4)
    assert np.all(np.diff(v_max[order]) < 0)  # "the less is removed at the best angle, and the steeper it is"
    steeper = p.replace(alpha=ALPHA + 0.5 * (np.pi / 2 - ALPHA))
    stops = np.tan(ALPHA) >= K / 2
    assert np.all(np.asarray(exact.volume(steeper))[stops] < np.asarray(exact.volume(p))[stops])
    # "the curvature jumps there": V″ k/(2 V*) of the rebound and V″/V* of the stop at the cusp, times 1 + k²/4.
    assert np.all(-3 - 4 / K**2 < -(1 - K**2 / 4))
    # "if k is off by a tenth, the angle is off by about"
    assert np.abs(np.arctan(1.1 * K) / 2 - best) == pytest.approx(K / (1 + K**2) / 20, rel=0.1)
    halved = {"m": 1, "v0": 2, "sigma": -1, "psi": -1, "r": 0}
    for name, power in halved.items():
        twice = np.asarray(exact.volume(p.replace(**{name: 2 * getattr(p, name)})))
        assert twice == pytest.approx(2.0**power * np.asarray(exact.volume(p)), rel=1e-12)


def test_along_the_line_of_impact_the_volume_only_falls_and_every_cut_stops() -> None:
    p, exact = cases(), StraightCut()
    assert volume("tan-alpha", p) == pytest.approx(np.cos(ALPHA) ** 2 / 2, abs=1e-8)
    assert set(np.asarray(exact.ended_by(p))) == {"stop"}
    order = np.argsort(ALPHA)
    length = (np.cos(ALPHA) / np.sqrt(np.tan(ALPHA)))[order]
    depth = (np.sin(ALPHA) / np.sqrt(np.tan(ALPHA)))[order]
    assert np.all(np.diff(length) < 0)  # "an ever longer groove"
    assert np.all(np.diff(depth[np.sort(ALPHA) < np.pi / 4]) > 0)  # "which below 45° becomes ever shallower"
    assert np.any(np.diff(depth) < 0)  # but not above


@pytest.mark.parametrize("end", ["tan-alpha", "tan-alpha-full-torque"])
def test_a_force_against_the_motion_is_one_along_the_line_of_impact(end: str) -> None:
    names = [f"rotating-{end}", f"rotating-{end.replace('tan-alpha', 'velocity-aligned')}"]
    fixed, aligned = (volume(name, cases()) for name in names)
    assert np.mean(np.abs(fixed - aligned) < 1e-7) > 0.98
    assert volume("tan-alpha", cases()) == pytest.approx(volume("velocity-aligned", cases()), abs=1e-7)


def test_the_midpoint_rule_errs_by_the_square_of_its_panels() -> None:
    p = cases()
    for i in range(0, N, 10):
        case = ReportCase(SI.replace(k=K[i], alpha=ALPHA[i]), "random")
        few, many = (midpoint_rule(case, panels) / case.volume - 1 for panels in (50, 100))
        assert few / many == pytest.approx(4, rel=0.05)
    assert p.k.size == N


def test_every_cut_that_turns_by_more_than_90_degrees_is_counted() -> None:
    p = SI.replace(k=K, alpha=ALPHA, phidot0=S * SI.v0 / SI.r)
    few = range(0, N, 10)
    for model in ("finnie", "rotating", "as-printed"):
        beyond = turned_beyond(model, p)
        for i in few:
            cut = path(load_model(model), SI.replace(k=K[i], alpha=ALPHA[i], phidot0=p.phidot0[i]))
            assert bool(np.abs(cut.phi - cut.phi[0]).max() > np.pi / 2) == beyond[i], (model, i)
        assert 2 < beyond[few].sum() < len(few) - 2
    # Where nothing is cut, nothing turns.
    assert not turned_beyond("rotating", SI.replace(phidot0=-1.2 * SI.v0 / SI.r))
    # The limit as α → 0 turns as its shallowest cuts do; α is NaN where nothing has a best angle.
    assert turned_beyond("as-printed", SI.replace(alpha=np.array([np.nan, 0.0, 1e-4]))).tolist() == [
        False,
        True,
        True,
    ]


@pytest.mark.parametrize("model", ROTATING)
def test_the_second_first_integral_holds_with_the_torque_of_the_horizontal_force_only(model: str) -> None:
    p = cases(phidot0=S * cases().v0 / cases().r)
    for i in np.flatnonzero(np.cos(ALPHA) + S > 0)[:20]:
        cut = path(load_model(model), SI.replace(**{name: np.asarray(getattr(p, name))[i] for name in VARIED}))
        slowed = cut.vx - cut.vx[0]
        size = np.abs(slowed).max()
        assert cut.vy - cut.vy[0] == pytest.approx(float(cut.p.k) * slowed, abs=1e-9 * size * float(cut.p.k))
        spun = (cut.omega - cut.omega[0]) * float(cut.p.inertia * cut.p.r)
        assert (np.abs(spun - slowed).max() < 1e-9 * size) == (model == "rotating")


EXACT, CUSP, NEAR = LinearizedCut(), np.arctan(K / 2), 1e-7


def at_cusp(side: float) -> Parameters:
    """The cases at, below or above the angle where the stop takes the place of the rebound, in steps of 1e-7."""
    return cases(alpha=CUSP + side * NEAR)


def shares(side: float) -> np.ndarray:
    """V over V* of the linearized model beside the cusp."""
    return np.asarray(EXACT.volume(at_cusp(side))) / np.asarray(cases().volume_scale)


def midpoint_errors(panels: int) -> np.ndarray:
    """Of the volume, over every tenth case."""
    every = [ReportCase(SI.replace(k=K[i], alpha=ALPHA[i]), "random") for i in range(0, N, 10)]
    return np.array([abs(midpoint_rule(case, panels) / case.volume - 1) for case in every])


POWERS = {"v0": -1, "m": -0.5, "sigma": 0.5, "b": 0.5, "psi": 0.5}


def moves_by_reach() -> np.ndarray:
    """Whether the best angle of every fifth case moves as Ω does, to four digits: over the move by the size."""
    p = cases()
    p = p.replace(**{name: np.asarray(getattr(p, name))[::5] for name in (*FACTORS, "k", "alpha")})
    best = erosion.alpha_max("rotating", p, max_turn=None)
    moves = {name: np.asarray(best.sensitivities[name]) * np.asarray(getattr(p, name)) for name in ("r", *POWERS)}
    # Where Ω is small, the side of a jump is known to fewer digits.
    known = np.isfinite(moves["r"]) & ((best.kind == "interior") | (np.asarray(p.r * p.rate / p.v0) > 0.03))
    assert known.sum() > 15
    errors = [np.abs(moves[name] / moves["r"] - power)[known] for name, power in POWERS.items()]
    return np.max(errors, axis=0) < 1e-4


def pushed_forward() -> np.ndarray:
    """Whether the printed equations push the particle forward and down at contact."""
    cuts = [path(load_model("as-printed"), SI.replace(k=k, alpha=alpha))
            for k, alpha in zip(K[::10], ALPHA[::10], strict=True)]  # fmt: skip
    return np.array([cut.vx[1] > cut.vx[0] and cut.vy[1] > cut.vy[0] for cut in cuts])


HOLD = {
    "wherever the stop is real it is the earlier one": lambda: (
        np.asarray(EXACT.end_times(cases())["stop"])[ALPHA > CUSP] <= np.pi / np.asarray(cases().rate)[ALPHA > CUSP]
    ),
    "at the cusp the curve of the stop falls vertically": lambda: (
        (np.pi - np.asarray(EXACT.t_c(at_cusp(1))) * np.asarray(cases().rate)) / NEAR > 100
    ),
    "at the cusp the slope of V is continuous": lambda: np.abs(shares(1) - 2 * shares(0) + shares(-1)) / NEAR < 1e-4,
    "the midpoint rule comes the closer, the more panels it has": lambda: (
        (midpoint_errors(10) > midpoint_errors(100)) & (midpoint_errors(100) > midpoint_errors(1000))
    ),
    "sensitivities are −1, 1, −½, ½, ½ and ½ times that of the size": moves_by_reach,
    "taken to the letter they first push the particle forward": pushed_forward,
    "without spin a cut removes nothing at 90°": lambda: (
        np.array([volume(model, cases(alpha=np.pi / 2)) for model in ("linearized", "finnie", *ROTATING)]) == 0
    ),
}


@pytest.mark.parametrize("claim", HOLD)
def test_a_claim_holds_in_every_case(claim: str) -> None:
    assert np.all(HOLD[claim]())
