"""Questions 5 to 8 asked again of a body that turns."""

from typing import Any

import numpy as np
from markupsafe import Markup

from erosion.optimum.alpha_max import alpha_max
from erosion.parameters.parameters import QUANTITIES
from erosion.plotting.families import BestAngles, plot_best_angles
from erosion.plotting.style import new_axes
from erosion.report.case import Case, Illustration
from erosion.report.families import Family
from erosion.report.text import degrees, formula, join, math, number, paragraph, table
from erosion.report.varied import family_figure, family_numbers

MODEL = "rotating"
_IN_REACH = ("v0", "r", "m", "sigma", "psi")  # what enters Ω = rω/v₀, k aside
_ON_LINE = 41


def numbers_again(case: Case) -> dict[str, Any]:
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
    found = alpha_max(MODEL, case.p.replace(r=r, phidot0=float(case.p.spin * case.p.v0) / r))
    return reach, found.alpha, found.kind


def figures_again(case: Case, numbers: dict[str, Any]) -> tuple[Illustration, ...]:
    """V(α) at several speeds; α_max over Ω; α_max over k."""
    families = case.families(MODEL)
    return (
        family_figure(case, families["v0"], "rotating-speeds",
                      Markup("Question 5 again, with rotation: the maxima no longer lie on one upright line.")),
        _over_reach_figure(case, numbers),
        _over_k_figure(case, families["k"]),
    )  # fmt: skip


def _over_reach_figure(case: Case, numbers: dict[str, Any]) -> Illustration:
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
    off = "" if case.p.spin == 0 else " Points of other speeds and sizes leave the curve, for they change s as well."
    return Illustration(
        "best-angle-over-reach",
        fig,
        Markup("Questions 5 to 8 again: the angle of greatest removal over {}. Speed, size, mass, flow stress and {} "
               "act through this one number.{}").format(math(r"\Omega=r\omega/v_0"), math(r"\psi"), off),
        "Angle of greatest removal over Ω, with the points of five parameters on one curve.",
    )  # fmt: skip


def _over_k_figure(case: Case, ratios: Family) -> Illustration:
    fig, ax = new_axes(5.4, 3.9)
    law = np.geomspace(ratios.values[0], ratios.values[-1], 200)
    found = BestAngles("with rotation", ratios.values, ratios.alpha, ratios.kind == "jump", line=False)
    plot_best_angles(ax, [found], xlabel=QUANTITIES["k"].label(case.units), log=True,
                     exact=("without: ½ arctan k", law, np.arctan(law) / 2))  # fmt: skip
    return Illustration(
        "rotating-best-angle-over-k",
        fig,
        Markup("Question 8 again: the angle of greatest removal over {} with rotation, where it may sit at a jump of "
               "{}, and without.").format(math("k"), math(r"V(\alpha)")),
        "Angle of greatest removal over the force ratio with rotation, beside ½ arctan k.",
    )  # fmt: skip


def derivation_again(case: Case) -> Markup:
    """Which answers change, and why."""
    return join(
        paragraph(Markup("<b>Questions 5 to 8 again.</b> "), "In the units of question 5 the depth of the tip is ",
                  math(r"D=Y-\Omega(1-\sin\varphi)"), " and the turn follows ",
                  math(r"\varphi''=-D/(\beta k\Omega)"), ", so that a second number enters beside ", math("k"), ":"),
        formula(r"V=\frac{mv_0^2}{\sigma\psi}\cdot f\left(\alpha,k,\Omega,s,\beta\right),\qquad"
                r"\Omega=\frac{r\omega}{v_0}=\frac{r}{v_0}\sqrt{\frac{k\sigma b\psi}{m}},\qquad"
                r"s=\frac{r\dot{\varphi}_0}{v_0}"),
        paragraph("Every parameter that enters ", math(r"\Omega"), " now moves the best angle: the speed, the size, "
                  "the mass, the flow stress, the width and ", math(r"\psi"), ". The answers to questions 5, 6 and 7 "
                  "turn from no to yes. In this case ", math(rf"\Omega={number(_own_reach(case), 4)}"),
                  ", and the best angles are:"),
        _ranges(case),
        _sensitivities(case),
        paragraph("Without spin, speed, size, mass, flow stress, width and ", math(r"\psi"), " enter by ",
                  math(r"\Omega"), " alone, so that their sensitivities are as −1, 1, −½, ½, ½ and ½."),
    )  # fmt: skip


def _own_reach(case: Case) -> float:
    return float(case.p.r) * case.omega / float(case.p.v0)


def _ranges(case: Case) -> Markup:
    rows = []
    for name, family in case.families(MODEL).items():
        quantity = QUANTITIES[name]
        jumps = int(np.sum(family.kind == "jump"))
        cutting = family.alpha[family.kind != "none"]
        ends = (degrees(float(cutting.min())), degrees(float(cutting.max()))) if cutting.size else ("–", "–")
        rows.append((f"{quantity.symbol}, {quantity.meaning}", *ends, f"{jumps} of {family.alpha.size}"))
    head = ("changed as in questions 5 to 8", "least α_max", "greatest α_max", "at a jump")
    return table("The angle of greatest removal with rotation", head, rows)


def _sensitivities(case: Case) -> Markup:
    names = [name for name in QUANTITIES if name not in ("alpha", "phidot0")]
    rows = []
    for name in names:
        cells = (case.sensitivity(model, name) for model in ("linearized", MODEL))
        said = ("0" if rate == 0 else degrees(rate, 6) if np.isfinite(rate) else "–" for rate in cells)
        rows.append((f"{QUANTITIES[name].symbol}, {QUANTITIES[name].meaning}", *said))
    return table("q ∂α_max/∂q: ten per cent more of q moves the angle by a tenth of this",
                 ("parameter q", "without rotation", "with rotation"), rows)  # fmt: skip
