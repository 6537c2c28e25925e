"""The additional questions: bodies that turn, other force ratios; slips of the source, and all models side by side."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from erosion.correlations import CORRELATIONS
from erosion.impacts.alpha_max import alpha_max
from erosion.impacts.simulate import SimulationError, Trajectory, path
from erosion.models import NoDeformation, RigidErodent, load_model
from erosion.models.base import CuttingModel
from erosion.models.registry import BUILT_IN
from erosion.models.rigid import StraightCut
from erosion.output.tables import Record
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.plotting.curves import plot_best_angles, plot_differences, plot_family, plot_shapes, plot_turn
from erosion.plotting.sweeps import plot_regimes
from erosion.report.case import TORQUES, Answer, Need, ReportCase, Spins, best_angle_over_k, family_numbers, panel

MODEL = "rotating"
NEEDS = (
    *((kind, model) for model in TORQUES for kind in ("optimum", "hits", "spins")),
    ("families", MODEL),
    ("optimum", "linearized"),
    ("hits", "linearized"),
    ("sensitivities", MODEL),
    ("sensitivities", "linearized"),
)
_LEAST_SEEN = 0.01  # of the greatest volume; a figure shows a jump that is larger
_TURN_ANGLES = np.deg2rad(np.arange(3.0, 90.0, 4.0))
_IN_REACH = ("v0", "r", "m", "sigma", "psi")  # what enters Ω = rω/v₀, k aside
_ON_LINE = 41
_STEP_ASIDE = 1e-5  # of an angle, from where a cut begins: nearer its motion is singular
_TOLD = (-0.9, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 0.9)  # spins that the page lists in a table


def body_may_turn(case: ReportCase) -> Answer:
    """α_max for both torques, over the spin; the turn; questions 5 to 8 again."""
    spins, best = [case.spins(model) for model in TORQUES], [case.optimum(model) for model in TORQUES]
    torques = [
        {
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "kind": str(optimum.kind),
            "ended_by": str(optimum.ended_by),
            "volume_at_case": float(case.hits(model).volume[-1]),
            "jumps": [jump.alpha for jump in optimum.jumps],
            "over_spin": {"s": spin.values.tolist(), **spin.numbers()},
        }
        for model, optimum, spin in zip(TORQUES, best, spins, strict=True)
    ]
    families, turn, over_reach = case.families(MODEL), turns(case), _over_reach(case)
    again = {name: family_numbers(case, family, MODEL) for name, family in families.items()}
    numbers = {
        **dict(zip(TORQUES, torques, strict=True)),
        "turn": turn,
        "again": again | {"over_reach": {name: column.tolist() for name, column in over_reach.items()}},
    }
    curves = [case.curve("linearized", "no rotation"), *(case.curve(model, label) for model, label in TORQUES.items())]
    over_spin = [spin.series(label, line=True) for spin, label in zip(spins, TORQUES.values(), strict=True)]
    changed = [families[name].series(f"{QUANTITIES[name].symbol} changed", families[name].reach) for name in _IN_REACH]
    figures = {
        "rotation": panel(plot_family, curves, units=case.units, columns=2),
        "best-angle-over-spin": panel(plot_best_angles, over_spin, height=4.2, xlabel="s = r φ̇₀/v₀  initial spin"),
        "regimes": plot_regimes(spins[0].map),
        "turn": panel(plot_turn, *(np.array(turn[name]) for name in ("alpha", "turn", "ended_by")), height=3.6),
        "rotating-speeds": families["v0"].figure(case.units),
        "best-angle-over-reach": panel(
            plot_best_angles,
            changed,
            height=4.2,
            xlabel="Ω = r ω/v₀",
            log=True,
            exact=("any of them changed", over_reach["reach"], over_reach["alpha_max"]),
            columns=3,
        ),
        "rotating-best-angle-over-k": best_angle_over_k(
            families["k"], case.units, "with rotation", "without: ½ arctan k", 3.9
        ),
    }
    at_both = ((turn["at_case"], case.alpha), (turn["at_best"], torques[0]["alpha_max"]))
    turned = [(angle, alpha) for angle, alpha in at_both if angle is not None]
    fields = {
        "without": case.optimum("linearized"),
        "simple": torques[0],
        "full": torques[1],
        "greatest_volume": max(torque["volume_max"] for torque in torques),
        "turned": turned,
        "least_sine": min((float(np.cos(angle)) for angle, _ in turned), default=1.0),
        "farthest": max((abs(angle) for angle, _ in turned), default=0.0),
        "jumps": [
            (label, jump) for label, optimum in zip(TORQUES.values(), best, strict=True) for jump in optimum.jumps
        ],
        "is_seen_to_jump": any(
            abs(jump.above - jump.below) > _LEAST_SEEN * float(optimum.volume)
            for optimum in best
            for jump in optimum.jumps
        ),
        "torques": list(TORQUES.values()),
        "spins": spins,
        "most": spins[0].rows[int(spins[0].volume.argmax())],
        "least": spins[0].rows[int(spins[0].volume.argmin())],
        "spin_rows": [rows for rows in zip(*(spin.rows for spin in spins), strict=True) if rows[0]["value"] in _TOLD],
        "reach": float(case.p.r) * case.omega / float(case.p.v0),
        # The best angles where something is cut, how many are at a jump, and how many values there are.
        "ranges": {
            name: {
                "angles": family.alpha[family.kind != "none"].tolist(),
                "jumps": family.jumps,
                "size": family.alpha.size,
            }
            for name, family in families.items()
        },
        "sensitivities": sensitivities(case),
        "turned_beyond": _turned_beyond(case, spins, turn, over_reach),
    }
    return Answer(numbers, figures, fields)


def turns(case: ReportCase) -> Record:
    """How far the body turns, over the angle of attack and at the case's own [rad]."""
    best = float(case.optimum(MODEL).alpha)
    turned: list[tuple[float, float, str]] = []
    beyond = 0
    for alpha in [*_TURN_ANGLES, case.alpha, *([best] if best > 0 else [])]:
        try:
            cut = path(load_model(MODEL), case.p.replace(alpha=alpha))
        except SimulationError:
            continue
        turned.append((float(alpha), float(cut.turn), cut.ended_by))
        beyond += cut.turn_warning is not None
    alpha, turn, ended_by = zip(*sorted(turned), strict=True)
    own = dict(zip(alpha, turn, strict=True))
    return {
        "alpha": list(alpha),
        "turn": list(turn),
        "ended_by": list(ended_by),
        "at_case": own.get(case.alpha),
        "at_best": own.get(best),
        "beyond": beyond,
    }


Counts = tuple[int, int]
"""How many cuts turn the body by more than 90°, and of how many."""


def turned_beyond(model: str, p: Parameters, **columns: np.ndarray) -> Counts:
    """The cuts of the case with other parameters, arrays that broadcast; where nothing is cut, nothing turns."""
    loaded = load_model(model)
    beyond = total = 0
    for values in zip(*(column.ravel().tolist() for column in np.broadcast_arrays(*columns.values())), strict=True):
        total += 1
        if np.isfinite(values).all():
            cut = _cut(loaded, dataclasses.replace(p, **dict(zip(columns, values, strict=True))))
            beyond += cut is not None and cut.turn_warning is not None
    return beyond, total


def _cut(model: CuttingModel, p: Parameters) -> Trajectory | None:
    """A cut; at a jump of V(α) to nothing that of its other side; None where nothing is cut."""
    alpha = float(p.alpha)
    for sides in ((alpha,), (alpha * (1 - _STEP_ASIDE), alpha * (1 + _STEP_ASIDE))):
        cuts: list[Trajectory] = []
        for side in sides:
            with contextlib.suppress(SimulationError):
                cuts.append(path(model, dataclasses.replace(p, alpha=side)))
        if any(cut.volume for cut in cuts):
            return max(cuts, key=lambda cut: float(cut.volume))
    return None


def _turned_beyond(
    case: ReportCase, spins: Sequence[Spins], turn: Record, over_reach: Mapping[str, np.ndarray]
) -> dict[str, Counts]:
    """The same for the cuts that each figure and table of the page shows."""
    per_spin = float(case.p.v0 / case.p.r)

    def best(*rows: np.ndarray) -> Counts:
        each = [
            turned_beyond(model, case.p, alpha=spin.alpha[at], phidot0=spin.values[at] * per_spin)
            for model, spin, at in zip(TORQUES, spins, rows, strict=True)
        ]
        return sum(count for count, _ in each), sum(total for _, total in each)

    r, alpha = over_reach["r"], over_reach["alpha_max"]
    of_families = {
        name: turned_beyond(MODEL, case.p, **{name: family.values, "alpha": family.alpha})
        for name, family in case.families(MODEL).items()
    }
    told = np.isin(spins[0].values, _TOLD)
    return of_families | {
        "spins": best(*(np.full(spin.values.size, True) for spin in spins)),
        "table": best(told, told),
        "map": turned_beyond(
            MODEL, case.p, alpha=_TURN_ANGLES[::2], phidot0=(spins[0].values[::3] * per_spin)[:, None]
        ),
        "angles": (turn["beyond"], len(turn["alpha"])),
        "reach": turned_beyond(MODEL, case.p, r=r, alpha=alpha, phidot0=float(case.p.spin * case.p.v0) / r),
    }


def _over_reach(case: ReportCase) -> dict[str, np.ndarray]:
    """Ω over all that the families cover, α_max [rad] and its kind, by changing r at the case's s and k."""
    reaches = np.concatenate([case.families(MODEL)[name].reach for name in _IN_REACH])
    reach = np.geomspace(reaches.min(), reaches.max(), _ON_LINE)
    r = reach * float(case.p.v0) / case.omega
    optimum = alpha_max(MODEL, dataclasses.replace(case.p, r=r, phidot0=float(case.p.spin * case.p.v0) / r))
    return {"reach": reach, "r": r, "alpha_max": optimum.alpha, "kind": optimum.kind}


def sensitivities(case: ReportCase) -> dict[str, list[float | None]]:
    """Moves of the best angle [rad] by parameter, without rotation and with rotation; None without a derivative."""
    rates = {
        name: [case.sensitivity(model, name) for model in ("linearized", MODEL)]
        for name in QUANTITIES
        # Where nothing spins, "ten per cent more spin" is none.
        if name != "alpha" and (name != "phidot0" or case.p.spin != 0)
    }
    return {name: [rate if np.isfinite(rate) else None for rate in pair] for name, pair in rates.items()}


_ALONG, _TURNING = "tan-alpha", "rotating-tan-alpha"
_RATIOS = {"linearized": "k constant", _ALONG: "k = tan α", _TURNING: "k = tan α, the body turns"}
_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Pairs of models that differ only in the force: of additional question 2 and of additional question 3."""
_READINGS = {"as-printed": "as printed", "rotating": "as corrected", "linearized": "linearized"}
_BESIDE = ("linearized", "finnie", "rotating", "linearized-deformation")


def _needs(*models: str) -> tuple[Need, ...]:
    return tuple((kind, model) for model in models for kind in ("optimum", "hits"))


NEEDS_OF_TAN_ALPHA = _needs(_ALONG, _TURNING, "linearized")
NEEDS_OF_PAIRS = _needs(*(model for pair in _PAIRS.values() for model in pair))
NEEDS_OF_READINGS = _needs(*_READINGS)
NEEDS_OF_MODELS = _needs(*BUILT_IN)


def ratio_is_tan_alpha(case: ReportCase) -> Answer:
    """V = (V*/2) cos²α only falls: no interior maximum, a supremum that is not reached."""
    optimum, turning, hits = case.optimum(_ALONG), case.optimum(_TURNING), case.hits(_ALONG)
    exact = np.asarray(StraightCut().volume(hits.p))
    numbers = {
        "supremum": float(optimum.volume),
        "supremum_closed_form": float(case.p.volume_scale) / 2,
        "alpha_of_supremum": float(optimum.alpha),
        "attained": bool(optimum.attained),
        "kind": str(optimum.kind),
        "largest_difference": float(np.abs(hits.volume - exact).max() / float(case.p.volume_scale)),
        "largest_slope": float(hits.dvolume.max()),
        "volume_at_case": float(hits.volume[-1]),
        "rotating": {
            "alpha_max": float(turning.alpha),
            "volume_max": float(turning.volume),
            "kind": str(turning.kind),
            "ended_by": str(turning.ended_by),
        },
    }
    curves = [case.curve(model, label) for model, label in _RATIOS.items()]
    return Answer(numbers, {"tan-alpha": panel(plot_family, curves, units=case.units, columns=2)})


def force_opposes_motion(case: ReportCase) -> Answer:
    """The direction of a force that opposes the motion never changes, so this is additional question 2 again."""
    differences, pairs = {}, {}
    for label, (fixed, aligned) in _PAIRS.items():
        volumes = [case.hits(model).volume[:-1] for model in (fixed, aligned)]
        differences[label] = np.abs(volumes[0] - volumes[1]) / float(case.p.volume_scale)
        best, best_of_tan_alpha = case.optimum(aligned), case.optimum(fixed)
        pairs[label] = {
            "largest_difference": float(np.nanmax(differences[label])),
            "kind": str(best.kind),
            "alpha_max": float(best.alpha),
            "alpha_max_of_tan_alpha": float(best_of_tan_alpha.alpha),
            "volume_max": float(best.volume),
            "volume_max_of_tan_alpha": float(best_of_tan_alpha.volume),
            "ended_by": str(best.ended_by),
        }
    curves = [case.curve(aligned, label) for label, (_, aligned) in _PAIRS.items()]
    figures = {
        "velocity-aligned": panel(plot_family, curves, units=case.units, columns=2),
        "velocity-aligned-difference": panel(plot_differences, case.looks, differences, height=4.0),
    }
    fields = {
        "largest_difference": max(pair["largest_difference"] for pair in pairs.values()),
        "greatest_volume": max(pair["volume_max"] for pair in pairs.values()),
    }
    return Answer({"pairs": pairs}, figures, fields)


def slips(case: ReportCase) -> Answer:
    """The slips; the source's equations exactly as printed compared with the corrected ones."""
    readings: dict[str, Record] = {}
    for model in _READINGS:
        hits = case.hits(model)
        slopes = hits.dvolume[:-1][hits.ended_by[:-1] != "no-cut"]
        readings[model] = case.impact_and_optimum(model) | {"only_falls": bool((slopes < 0).all())}
    fields = {
        "readings": {label: readings[model] for model, label in _READINGS.items()},
        "greatest_volume": max(reading["volume_max"] for reading in readings.values()),
    }
    curves = [case.curve(model, label) for model, label in _READINGS.items()]
    figure = panel(plot_family, curves, height=4.0, units=case.units)
    return Answer({"force_at_contact": float(case.p.stiffness * case.p.r), **readings}, {"as-printed": figure}, fields)


def all_models(case: ReportCase) -> Answer:
    """For every model: V at the case's angle, α_max, V_max, the kind of the maximum, and how its cut ends."""
    numbers = {}
    for model in BUILT_IN:
        optimum = case.optimum(model)
        numbers[model] = case.impact_and_optimum(model) | {
            "side": str(optimum.side),
            "attained": bool(optimum.attained),
            "ended_by_at_max": str(optimum.ended_by),
            "certified": bool(optimum.certified),
        }
    fields = {
        "models": BUILT_IN,
        # At 90°, too; not the limit as α → 0, and not the NaN where nothing is removed.
        "best_angles": [row["alpha_max"] for row in numbers.values() if row["alpha_max"] > 0],
        # V at 90° over the greatest V.
        "left_at_90_degrees": {
            model: float(case.hits(model).volume[-2] / case.optimum(model).volume)
            for model in BUILT_IN
            if deforms(model)
        },
        "greatest_volume": max(row["volume_max"] for row in numbers.values()),
    }
    curves = [case.curve(model) for model in BUILT_IN]
    beside = [case.curve(model) for model in _BESIDE]
    figures = {
        "models": panel(plot_family, curves, width=5.8, height=5.2, units=case.units, columns=2),
        "correlations": panel(plot_shapes, beside, tuple(CORRELATIONS), width=5.8, height=5.0),
    }
    return Answer(numbers, figures, fields)


def deforms(model: str) -> bool:
    """Whether a registered model has wear by deformation."""
    built_in = BUILT_IN[model].make()
    return isinstance(built_in, RigidErodent) and not isinstance(built_in.deformation, NoDeformation)
