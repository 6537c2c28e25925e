"""The additional questions: bodies that turn, other force ratios; slips of the source, and all models side by side."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from erosion.correlations import CORRELATIONS
from erosion.impacts import ASIDE, alpha_max, impact, turn_of, turned_beyond
from erosion.models import BUILT_IN, NoDeformation, RigidParticle, load_model
from erosion.models.rigid import StraightCut
from erosion.output import Record
from erosion.parameters import QUANTITIES, Scale, System, unit_size
from erosion.plotting.curves import ShapeCurve, plot_best_angles, plot_differences, plot_family, plot_shapes, plot_turn
from erosion.plotting.labels import coinciding, model_title
from erosion.plotting.sweeps import plot_regimes
from erosion.report.case import (
    LINEARIZED,
    RTOL,
    TORQUES,
    Answer,
    Need,
    ReportCase,
    best_angle_over_k,
    family_numbers,
    followed,
    panel,
)

MODEL = "rotating"


def _needs(*models: str) -> tuple[Need, ...]:
    return tuple((kind, model) for model in models for kind in ("optimum", "hits", "impact_and_optimum", "curve"))


NEEDS = (
    *_needs(*TORQUES, LINEARIZED),
    *(("spins", model) for model in TORQUES),
    ("families", MODEL),
    ("sensitivities", MODEL),
    ("sensitivities", LINEARIZED),
)
_LEAST_SEEN = 0.01  # of the greatest volume; a figure shows a jump that is larger
_TURN_ANGLES = np.deg2rad(np.arange(3.0, 90.0, 4.0))
_IN_REACH = ("v0", "r", "m", "sigma", "psi")  # what enters Ω = rω/v₀, k aside
_ON_LINE = 41
_TOLD = (-0.9, -0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 0.9)  # spins that the page lists in a table


def body_may_turn(case: ReportCase) -> Answer:
    """α_max for both torques, over the spin; the turn; questions 5 to 8 again."""
    spins = [case.spins(model) for model in TORQUES]
    without = case.impact_and_optimum(LINEARIZED)
    torques: list[dict[str, Any]] = []
    for model, spin in zip(TORQUES, spins, strict=True):
        row = case.impact_and_optimum(model)
        torques.append(
            {
                **row,
                "valid_turn": _turn(case, model, row["valid_alpha_max"]),
                "over_no_rotation": row["valid_volume_max"] / without["volume_max"],
                "jumps": jumps(case, model),
                "over_spin": {"s": spin.values.tolist(), **spin.numbers()},
            }
        )
    families, turn, over_reach = case.families(MODEL), turns(case), _over_reach(case)
    again = {name: family_numbers(case, family, MODEL) for name, family in families.items()}
    rates = sensitivities(case)
    numbers = {
        **dict(zip(TORQUES, torques, strict=True)),
        "without_rotation": without,
        "turn": turn,
        "again": again | {"over_reach": {name: column.tolist() for name, column in over_reach.items()}},
        "reach": float(case.p.r) * case.omega / float(case.p.v0),
        "tip_over_centre": 1 + 1 / float(case.p.inertia),
        "sensitivities": rates,
    }
    changed = [families[name].series(f"{QUANTITIES[name].symbol} changed", families[name].reach) for name in _IN_REACH]
    line = ("any of them changed", over_reach["reach"], over_reach["alpha_max"])
    over_spin = [spin.series(label, line=True) for spin, label in zip(spins, TORQUES.values(), strict=True)]
    figures = {
        "rotation": panel(
            plot_family,
            case.curves({LINEARIZED: "no rotation", **TORQUES}),
            system=case.units,
            columns=2,
        ),
        "best-angle-over-spin": panel(plot_best_angles, over_spin, height=4.2, xlabel="s = r φ̇₀/v₀  initial spin"),
        "regimes": plot_regimes(spins[0].map),
        "turn": panel(plot_turn, *(np.array(turn[name]) for name in ("alpha", "turn", "ended_by")), height=3.6),
        "rotating-speeds": families["v0"].figure(case.units),
        "best-angle-over-reach": panel(
            plot_best_angles, changed, height=4.2, xlabel="Ω = r ω/v₀", log=True, exact=line, columns=3
        ),
        "rotating-best-angle-over-k": best_angle_over_k(
            families["k"], case.units, "with rotation", "without: ½ arctan k", 3.9
        ),
    }
    least, most = spins[0].least_and_most
    fields = {
        "simple": torques[0],
        "turned_further": [(label, row) for label, row in zip(TORQUES.values(), torques, strict=True)
                           if row["turned_beyond_at_max"]],
        "full": torques[1],
        "greatest_volume": max(torque["volume_max"] for torque in torques),
        "farthest": max((cut["turn"] for cut in turn["told"]), default=0.0),
        "jumps": [(label, jump) for label, torque in zip(TORQUES.values(), torques, strict=True)
                  for jump in torque["jumps"]],
        "is_seen_to_jump": any(
            abs(jump["above"] - jump["below"]) > _LEAST_SEEN * torque["volume_max"]
            for torque in torques
            for jump in torque["jumps"]
        ),
        "torques": list(TORQUES.values()),
        "spins": spins,
        "most": most,
        "least": least,
        "spin_rows": [rows for rows in zip(*(spin.rows for spin in spins), strict=True) if rows[0]["value"] in _TOLD],
        "best_angles": {name: [row["alpha"] for row in family.rows if row["kind"] != "none"]
                        for name, family in families.items()},
    }  # fmt: skip
    return Answer(numbers, figures, fields, case.curves(TORQUES))


def _turn(case: ReportCase, model: str, alpha: float) -> float | None:
    """How far the body turns in a cut [rad]; None without an angle of greatest removal."""
    return float(turn_of(load_model(model), case.p.replace(alpha=alpha))) if alpha > 0 else None


def jumps(case: ReportCase, model: str) -> list[Record]:
    """The jumps of V(α), to how many digits both sides differ, and which of them turn the body by more than 90°."""
    found = case.optimum(model).jumps
    angles = np.array([[jump.alpha - ASIDE, jump.alpha + ASIDE] for jump in found]).reshape(-1, 2)
    beyond = turned_beyond(model, case.p.replace(alpha=angles))
    return [
        {
            "alpha": jump.alpha,
            "below": jump.below,
            "above": jump.above,
            "turned_beyond": [name for name, turned in zip(("below", "above"), both, strict=True) if turned],
            "ended_below": jump.ended_below,
            "ended_above": jump.ended_above,
            "digits": _telling_digits(jump.below, jump.above),
        }
        for jump, both in zip(found, beyond, strict=True)
    ]


def _telling_digits(one: float, other: float) -> int:
    """Five digits, or as many as show that two numbers differ."""
    part = abs(one - other) / max(abs(one), abs(other))
    return int(np.clip(2 - np.floor(np.log10(part)), 5, 15)) if part else 5


def turns(case: ReportCase) -> Record:
    """How far the body has turned at the end of cuts [rad], over the angle of attack.

    `told` are the cuts at the case's own angle and at the best one, where something is cut, with the greatest turn and
    the least sin φ.
    """
    best = case.impact_and_optimum(MODEL)["alpha_max"]
    angles = case.p.replace(alpha=_TURN_ANGLES)
    hits = impact(MODEL, angles, rtol=RTOL)
    told = []
    for alpha in dict.fromkeys((case.alpha, float(best))):
        cut = followed(case.p.replace(alpha=alpha)) if alpha > 0 else None
        if cut is not None and cut.ended_by != "no-cut":
            turn, sine = np.abs(cut.phi - np.pi / 2).max(), np.sin(cut.phi).min()
            told.append({"alpha": alpha, "turn": float(turn), "least_sine": float(sine)})
    columns = {"alpha": _TURN_ANGLES, "turn": hits.turn, "ended_by": hits.ended_by,
               "turned_beyond": turned_beyond(MODEL, angles)}  # fmt: skip
    return {name: np.asarray(column).tolist() for name, column in columns.items()} | {"told": told}


def _over_reach(case: ReportCase) -> dict[str, np.ndarray]:
    """Ω over all that the families cover, α_max [rad] and its kind, by changing r at the case's s and k."""
    reaches = np.concatenate([case.families(MODEL)[name].reach for name in _IN_REACH])
    reach = np.geomspace(reaches.min(), reaches.max(), _ON_LINE)
    r = reach * float(case.p.v0) / case.omega
    p = dataclasses.replace(case.p, r=r, phidot0=float(case.p.spin * case.p.v0) / r)
    optimum = alpha_max(MODEL, p, max_turn=None)
    beyond = turned_beyond(MODEL, p.replace(alpha=optimum.alpha))
    return {"reach": reach, "r": r, "alpha_max": optimum.alpha, "kind": optimum.kind, "turned_beyond": beyond}


def sensitivities(case: ReportCase) -> dict[str, list[float | None]]:
    """Moves of the best angle [rad] by parameter, without rotation and with rotation; None without a derivative."""
    rates = {
        name: [case.sensitivity(model, name) for model in (LINEARIZED, MODEL)]
        for name in QUANTITIES
        # Where nothing spins, "ten per cent more spin" is none.
        if name != "alpha" and (name != "phidot0" or case.p.spin != 0)
    }
    return {name: [rate if np.isfinite(rate) else None for rate in pair] for name, pair in rates.items()}


_ALONG, _TURNING = "tan-alpha", "rotating-tan-alpha"
_RATIOS = {LINEARIZED: "k constant", _ALONG: "k = tan α", _TURNING: "k = tan α, the body turns"}
_PAIRS = {
    "without rotation": ("tan-alpha", "velocity-aligned"),
    "torque r Fₓ": ("rotating-tan-alpha", "rotating-velocity-aligned"),
    "torque of both components": ("rotating-tan-alpha-full-torque", "rotating-velocity-aligned-full-torque"),
}
"""Pairs of models that differ only in the force: of additional question 2 and of additional question 3."""
_READINGS = {"as-printed": "as printed", "rotating": "as corrected", LINEARIZED: "linearized equations"}
_COINCIDES = 0.99  # share of the angles
_BESIDE = (LINEARIZED, "finnie", "rotating", "linearized-deformation")

NEEDS_OF_TAN_ALPHA = _needs(_ALONG, _TURNING, LINEARIZED)
NEEDS_OF_PAIRS = _needs(*(model for pair in _PAIRS.values() for model in pair))
NEEDS_OF_READINGS = _needs(*_READINGS)
NEEDS_OF_MODELS = _needs(*BUILT_IN)


def _curves(case: ReportCase, models: Iterable[str]) -> list[ShapeCurve]:
    """V(α) of models by their names in Markdown."""
    return case.curves({model: f"`{model}`" for model in models})


def ratio_is_tan_alpha(case: ReportCase) -> Answer:
    """V = (V*/2) cos²α only falls: no interior maximum, a supremum that is not reached."""
    along, optimum, hits = case.impact_and_optimum(_ALONG), case.optimum(_ALONG), case.hits(_ALONG)
    exact = np.asarray(StraightCut().volume(hits.p))
    numbers = {
        "supremum": along["volume_max"],
        "supremum_closed_form": float(case.p.volume_scale) / 2,
        "alpha_of_supremum": along["alpha_max"],
        "attained": bool(optimum.attained),
        "kind": along["kind"],
        "largest_difference": float(np.abs(hits.volume - exact).max() / float(case.p.volume_scale)),
        "largest_slope": float(hits.dvolume.max()),
        "volume_at_case": along["volume"],
        "rotating": case.impact_and_optimum(_TURNING),
    }
    curves = case.curves(_RATIOS)
    return Answer(
        numbers,
        {"tan-alpha": panel(plot_family, curves, system=case.units, columns=2)},
        curves=_curves(case, [_TURNING]),
    )


def force_opposes_motion(case: ReportCase) -> Answer:
    """The direction of a force that opposes the motion never changes, so this is additional question 2 again."""
    differences, pairs = {}, {}
    for label, (fixed, aligned) in _PAIRS.items():
        volumes = [case.hits(model).volume[:-1] for model in (fixed, aligned)]
        differences[label] = np.abs(volumes[0] - volumes[1]) / float(case.p.volume_scale)
        best, best_of_tan_alpha = case.impact_and_optimum(aligned), case.impact_and_optimum(fixed)
        pairs[label] = {
            "largest_difference": float(np.nanmax(differences[label])),
            "kind": best["kind"],
            "alpha_max": best["alpha_max"],
            "alpha_max_of_tan_alpha": best_of_tan_alpha["alpha_max"],
            "volume_max": best["volume_max"],
            "volume_max_of_tan_alpha": best_of_tan_alpha["volume_max"],
            "ended_by": best["ended_by_at_max"],
        }
    curves = case.curves({aligned: label for label, (_, aligned) in _PAIRS.items()})
    figures = {
        "velocity-aligned": panel(plot_family, curves, system=case.units, columns=2),
        "velocity-aligned-difference": panel(plot_differences, case.looks, differences, height=4.0),
    }
    fields = {
        "largest_difference": max(pair["largest_difference"] for pair in pairs.values()),
        "greatest_volume": max(pair["volume_max"] for pair in pairs.values()),
    }
    aligned = [model for pair in _PAIRS.values() for model in pair]
    return Answer({"pairs": pairs}, figures, fields, _curves(case, aligned))


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
        "force": Scale(unit_size("stress", case.units) * unit_size("area", case.units), _FORCES[case.units]),
    }
    figure = panel(plot_family, case.curves(_READINGS), height=4.0, system=case.units)
    numbers = {"force_at_contact": float(case.p.stiffness * case.p.r), **readings}
    return Answer(numbers, {"as-printed": figure}, fields, _curves(case, _READINGS))


_FORCES: Mapping[System, str] = {"inch-pound": "lbf", "si": "N"}


def all_models(case: ReportCase) -> Answer:
    """For every model: V at the case's angle, α_max, V_max, the kind of the maximum, and how its cut ends."""
    numbers = {}
    for model in BUILT_IN:
        optimum = case.optimum(model)
        numbers[model] = case.impact_and_optimum(model) | {
            "side": str(optimum.side),
            "attained": bool(optimum.attained),
            "certified": bool(optimum.certified),
        }
        if deforms(model):
            numbers[model]["left_at_90_degrees"] = float(case.hits(model).volume[-2] / optimum.volume)
    # With `as-printed` most is removed as α → 0; its best angle is where the turn falls to 90°.
    corrected = [row for model, row in numbers.items() if model != "as-printed"]
    hidden = coinciding([case.hits(model).volume[:-1] for model in BUILT_IN], _COINCIDES)
    fields: dict[str, Any] = {
        "models": BUILT_IN,
        # At 90°, too; not the limit as α → 0, and not the NaN where nothing is removed.
        "best_angles": [row["valid_alpha_max"] for row in corrected if row["valid_alpha_max"] > 0],
        "any_turn": [row["alpha_max"] for row in corrected if row["alpha_max"] > 0],
        "shallowest": [model for model, row in numbers.items() if row["alpha_max"] == 0],
        "idle": [model for model, row in numbers.items() if row["kind"] == "none"],
        "deforming": {model: row for model, row in numbers.items() if "left_at_90_degrees" in row},
        "greatest_volume": max(row["volume_max"] for row in numbers.values()),
        "hidden": {model: list(BUILT_IN)[below[0]] for model, below in zip(BUILT_IN, hidden, strict=True) if below},
    }
    titles = {model: model_title(model) for model in BUILT_IN}
    drawn = {model: f"{title} ({model})" for model, title in titles.items() if model not in fields["hidden"]}
    figures = {
        "models": panel(plot_family, case.curves(drawn), width=6.4, height=7.2, system=case.units, columns=1),
        "correlations": panel(
            plot_shapes,
            case.curves({model: titles[model] for model in _BESIDE}),
            tuple(CORRELATIONS),
            width=5.8,
            height=5.0,
        ),
    }
    return Answer(numbers, figures, fields, _curves(case, BUILT_IN))


def deforms(model: str) -> bool:
    """Whether a registered model has wear by deformation."""
    built_in = BUILT_IN[model].make()
    return isinstance(built_in, RigidParticle) and not isinstance(built_in.deformation, NoDeformation)
