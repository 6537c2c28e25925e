"""Questions 5 to 8 for a body that turns."""

import dataclasses

import numpy as np
from matplotlib.figure import Figure

from erosion.optimum.alpha_max import alpha_max
from erosion.parameters.parameters import QUANTITIES
from erosion.plotting.families import BestAngles, plot_best_angles
from erosion.plotting.style import new_axes
from erosion.report.case import Case
from erosion.report.families import Family
from erosion.report.varied import family_figure, family_numbers
from erosion.tables import Record

MODEL = "rotating"
_IN_REACH = ("v0", "r", "m", "sigma", "psi")  # what enters Ω = rω/v₀, k aside
_ON_LINE = 41


def numbers_again(case: Case) -> Record:
    """For numbers.json."""
    reach, alpha, kind = _over_reach(case)
    return {
        **{name: family_numbers(case, family, MODEL) for name, family in case.families(MODEL).items()},
        "over_reach": {"reach": reach.tolist(), "alpha_max": alpha.tolist(), "kind": kind.tolist()},
    }


def _over_reach(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ω over all that the families cover, α_max [rad] and its kind, by changing r at the case's s and k."""
    reaches = np.concatenate([case.families(MODEL)[name].reach for name in _IN_REACH])
    reach = np.geomspace(reaches.min(), reaches.max(), _ON_LINE)
    r = reach * float(case.p.v0) / case.omega
    optimum = alpha_max(MODEL, dataclasses.replace(case.p, r=r, phidot0=float(case.p.spin * case.p.v0) / r))
    return reach, optimum.alpha, optimum.kind


def figures_again(case: Case, numbers: Record) -> dict[str, Figure]:
    """V(α) at several speeds; α_max over Ω; α_max over k."""
    families = case.families(MODEL)
    return {
        "rotating-speeds": family_figure(case, families["v0"]),
        "best-angle-over-reach": _over_reach_figure(case, numbers),
        "rotating-best-angle-over-k": _over_k_figure(case, families["k"]),
    }


def _over_reach_figure(case: Case, numbers: Record) -> Figure:
    fig, ax = new_axes(5.4, 4.2)
    reach, alpha = (np.array(numbers["over_reach"][key]) for key in ("reach", "alpha_max"))
    families = [case.families(MODEL)[name] for name in _IN_REACH]
    plot_best_angles(
        ax,
        [
            BestAngles(f"{QUANTITIES[family.name].symbol} changed", family.reach, family.alpha,
                       family.kind == "jump", line=False)
            for family in families
        ],
        xlabel="Ω = r ω/v₀",
        log=True,
        exact=("any of them changed", reach, alpha),
        columns=3,
    )  # fmt: skip
    return fig


def _over_k_figure(case: Case, ratios: Family) -> Figure:
    fig, ax = new_axes(5.4, 3.9)
    law = np.geomspace(ratios.values[0], ratios.values[-1], 200)
    computed = BestAngles("with rotation", ratios.values, ratios.alpha, ratios.kind == "jump", line=False)
    plot_best_angles(ax, [computed], xlabel=QUANTITIES["k"].label(case.units), log=True,
                     exact=("without: ½ arctan k", law, np.arctan(law) / 2))  # fmt: skip
    return fig


def ranges(case: Case) -> dict[str, Record]:
    """By parameter: the best angles where something is cut, how many are at a jump, and how many values there are."""
    return {
        name: {
            "angles": family.alpha[family.kind != "none"].tolist(),
            "jumps": int(np.sum(family.kind == "jump")),
            "size": family.alpha.size,
        }
        for name, family in case.families(MODEL).items()
    }


def sensitivities(case: Case) -> dict[str, list[float | None]]:
    """Moves of the best angle [rad] by parameter, without rotation and with rotation; None without a derivative."""
    rates = {
        name: [case.sensitivity(model, name) for model in ("linearized", MODEL)]
        for name in QUANTITIES
        # Where nothing spins, "ten per cent more spin" is none.
        if name != "alpha" and (name != "phidot0" or case.p.spin != 0)
    }
    return {name: [rate if np.isfinite(rate) else None for rate in pair] for name, pair in rates.items()}
