"""Additional question 1: the body may turn."""

import numpy as np
from matplotlib.figure import Figure

from erosion.impacts.alpha_max import Optimum
from erosion.impacts.simulate import SimulationError, path
from erosion.models import load_model
from erosion.output.tables import Record
from erosion.plotting.curves import plot_best_angles, plot_family, plot_turn
from erosion.plotting.style import new_axes
from erosion.plotting.sweeps import plot_regimes
from erosion.report.case import TORQUES, Answer, ReportCase
from erosion.report.studies import MODEL, figures_again, numbers_again, ranges, sensitivities

NEEDS = (
    *((kind, model) for model in TORQUES for kind in ("optimum", "hits", "spins")),
    ("families", MODEL),
    ("optimum", "linearized"),
    ("hits", "linearized"),
    ("sensitivities", MODEL),
    ("sensitivities", "linearized"),
)
_LEAST_SEEN = 0.01  # of the greatest volume
_TURN_ANGLES = np.deg2rad(np.arange(3.0, 90.0, 4.0))


def answer(case: ReportCase) -> Answer:
    """α_max for both torques, over the spin; the turn; questions 5 to 8 again."""
    numbers = {model: _numbers(case, model) for model in TORQUES} | {
        "turn": turns(case),
        "again": numbers_again(case),
    }
    figures = {
        "rotation": _curves_figure(case),
        "best-angle-over-spin": _spins_figure(case),
        "regimes": plot_regimes(case.spins(MODEL).map),
        "turn": _turn_figure(numbers["turn"]),
        **figures_again(case, numbers["again"]),
    }
    return Answer(numbers, figures, _fields(case, numbers))


def _fields(case: ReportCase, numbers: Record) -> Record:
    at_best = (numbers["turn"]["at_best"], numbers[MODEL]["alpha_max"])
    at_case = (numbers["turn"]["at_case"], case.alpha)
    turned = [(turn, alpha) for turn, alpha in (at_case, at_best) if turn is not None]
    spins = [case.spins(model) for model in TORQUES]
    torques = [numbers[model] for model in TORQUES]
    return {
        "without": case.optimum("linearized"),
        "simple": torques[0],
        "full": torques[1],
        "greatest_volume": max(torque["volume_max"] for torque in torques),
        "turned": turned,
        "least_sine": min((float(np.cos(turn)) for turn, _ in turned), default=1.0),
        "farthest": max((abs(turn) for turn, _ in turned), default=0.0),
        "jumps": [(label, jump) for model, label in TORQUES.items() for jump in case.optimum(model).jumps],
        "is_seen_to_jump": any(_is_seen_to_jump(case.optimum(model)) for model in TORQUES),
        "torques": list(TORQUES.values()),
        "spins": spins,
        "most": spins[0].at(int(spins[0].volume.argmax())),
        "least": spins[0].at(int(spins[0].volume.argmin())),
        "spin_rows": list(zip(*(spin.rows for spin in spins), strict=True)),
        "reach": float(case.p.r) * case.omega / float(case.p.v0),
        "ranges": ranges(case),
        "sensitivities": sensitivities(case),
    }


def _is_seen_to_jump(best: Optimum) -> bool:
    """Whether a figure shows that V(α) jumps."""
    return any(abs(jump.above - jump.below) > _LEAST_SEEN * float(best.volume) for jump in best.jumps)


def _numbers(case: ReportCase, model: str) -> Record:
    optimum = case.optimum(model)
    return {
        "alpha_max": float(optimum.alpha),
        "volume_max": float(optimum.volume),
        "kind": str(optimum.kind),
        "ended_by": str(optimum.ended_by),
        "volume_at_case": float(case.hits(model).volume[-1]),
        "jumps": [jump.alpha for jump in optimum.jumps],
        "over_spin": case.spins(model).numbers(),
    }


def turns(case: ReportCase) -> Record:
    """How far the body turns, over the angle of attack and at the case's own [rad]."""
    best = float(case.optimum(MODEL).alpha)
    turned: list[tuple[float, float, str]] = []
    for alpha in [*_TURN_ANGLES, case.alpha, *([best] if best > 0 else [])]:
        try:
            cut = path(load_model(MODEL), case.p.replace(alpha=alpha))
        except SimulationError:
            continue
        turned.append((float(alpha), float(cut.turn), cut.ended_by))
    turned.sort()
    alpha, turn, ended_by = zip(*turned, strict=True)
    own = dict(zip(alpha, turn, strict=True))
    return {
        "alpha": list(alpha),
        "turn": list(turn),
        "ended_by": list(ended_by),
        "at_case": own.get(case.alpha),
        "at_best": own.get(best),
    }


def _curves_figure(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.4, 4.1)
    curves = [case.curve("linearized", "no rotation"), *(case.curve(model, label) for model, label in TORQUES.items())]
    plot_family(ax, curves, units=case.units, columns=2)
    return fig


def _spins_figure(case: ReportCase) -> Figure:
    fig, ax = new_axes(5.4, 4.2)
    lines = [case.spins(model).best_angles(label) for model, label in TORQUES.items()]
    plot_best_angles(ax, lines, xlabel="s = r φ̇₀/v₀  initial spin", columns=2)
    return fig


def _turn_figure(turn: Record) -> Figure:
    fig, ax = new_axes(5.4, 3.6)
    plot_turn(ax, np.array(turn["alpha"]), np.array(turn["turn"]), np.array(turn["ended_by"]))
    return fig
