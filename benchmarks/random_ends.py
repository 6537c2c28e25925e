"""Ends, volumes and certified optima of random impacts, against heyoka at 1e-15 and dense scans of angles."""

import functools
from typing import Any

import numpy as np

import erosion
from benchmarks.contenders import event_of_impact
from benchmarks.heyoka_lanes import Ends, one_by_one
from benchmarks.impacts import RotatingImpact, extreme, fast_turns, usual, volume_unit, without_units
from benchmarks.page import Table
from erosion.impacts import turned_beyond

TITLE = "Random ends and optima"
TEXT = """Random impacts of the rotating models about Table 1 ("usual"), of bodies that turn up to thousands of times
("fast turns") and at the limits of what is legal ("extreme": k from 1e-3 to 1e3, ψ from 1e-6, α from 0.01° to
89.99°, rims up to 100 times as fast as the impact), against heyoka at 1e-15. Impacts whose end changes with α(1
± 1e-11) are undecided by rounding. "Wrong": another end, or a volume off by 1e-6. Optima: certified maxima of cuts
that turn the body by at most 90°, below the best such cut of a scan of angles by more than 1e-9."""

SAMPLES = {"usual": usual, "fast turns": fast_turns, "extreme": extreme}
VARIED = ("k", "psi", "r", "v0", "alpha", "phidot0", "inertia")
WRONG, CLOSE, SHORT = 1e-6, 1e-11, 1e-9
_CASES = {full: RotatingImpact(full) for full in (False, True)}


def models() -> list[str]:
    """Names of the rotating models, without the one with deformation."""
    return [name for name in erosion.available_models() if name.startswith("rotating") and "deform" not in name]


def ends(model: str, p: erosion.Parameters, factor: float = 1.0) -> Ends:
    """By heyoka, of impacts whose angles are multiplied by a factor."""
    lanes = without_units(model, p.replace(alpha=np.asarray(p.alpha) * factor))
    return one_by_one(_CASES[model.endswith("full-torque")], lanes, 0, 1e-15)


def part(p: erosion.Parameters, lanes: np.ndarray) -> erosion.Parameters:
    """Some of the impacts."""
    count = np.size(p.alpha)
    return p.replace(**{name: np.broadcast_to(getattr(p, name), count)[lanes] for name in VARIED})


def compared(model: str, kind: str, count: int, seed: int) -> tuple[list[Any], int]:
    """A row, and how many impacts are wrong."""
    p = SAMPLES[kind](count, seed)
    p = part(p, np.flatnonzero(np.cos(p.alpha) + p.phidot0 * p.r / p.v0 > 1e-9))
    hits = erosion.impact(model, p)
    lost = np.isin(hits.ended_by, ["failed", "unfinished"])
    true, event = ends(model, p), event_of_impact(hits)
    with np.errstate(all="ignore"):
        error = np.abs(hits.volume / volume_unit(p) / true.rows[:, _CASES[False].state.index("volume")] - 1)
    doubtful = np.flatnonzero(~lost & ((event != true.event) | ~(error < WRONG)))
    undecided = np.zeros(len(event), bool)
    if doubtful.size:
        few = part(p, doubtful)
        moved = [ends(model, few, factor).event for factor in (1 - CLOSE, 1.0, 1 + CLOSE)]
        undecided[doubtful] = np.ptp(moved, axis=0) > 0
    wrong = int(np.sum(~undecided[doubtful]))
    right = ~lost & ~undecided
    row = [
        model,
        kind,
        len(event),
        int(lost.sum()),
        int(undecided.sum()),
        wrong,
        float(np.median(error[right])),
        float(error[right].max()),
    ]
    return row, wrong


def optima(model: str, count: int, angles: int, seed: int) -> tuple[list[Any], int]:
    """A row of certified optima within 90° of turn, and how many a scan of such cuts beats."""
    p = usual(count, seed).replace(alpha=erosion.TABLE_1.alpha)
    best = erosion.alpha_max(model, p)
    scanned = np.zeros(count)
    for alpha in np.array_split(np.linspace(0, np.pi / 2, angles + 1)[1:, None], 20):
        cuts = p.replace(alpha=alpha)
        valid = np.where(turned_beyond(model, cuts), 0.0, erosion.impact(model, cuts).volume)
        scanned = np.fmax(scanned, np.nanmax(valid, axis=0))
    short = scanned / np.where(best.volume > 0, best.volume, np.inf) - 1
    wrong = int(np.sum(short > SHORT))
    return [
        model,
        "optima",
        count,
        int(np.sum(~best.certified)),
        0,
        wrong,
        float(np.median(np.abs(short))),
        float(short.max()),
    ], wrong


def measure(quick: bool) -> Table:
    """A row for each model and kind."""
    count, sets, angles = (200, 5, 500) if quick else (3000, 200, 20_000)
    jobs = [
        functools.partial(compared, model, kind, count if kind != "fast turns" else count // 5, seed)
        for seed, model in enumerate(models())
        for kind in SAMPLES
    ]
    jobs += [functools.partial(optima, model, sets, angles, seed) for seed, model in enumerate(models())]
    rows, wrong = zip(*(job() for job in jobs), strict=True)
    head = ["model", "kind", "count", "failed or uncertified", "undecided", "wrong", "error, median", "worst"]
    return Table(head, list(rows), sum(wrong))
