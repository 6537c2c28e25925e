"""What the questions compute and draw beside the case: families, turning bodies, Newton's method."""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter

from erosion.impacts.alpha_max import alpha_max
from erosion.impacts.impact import impact
from erosion.impacts.simulate import SimulationError
from erosion.models.base import CuttingModel
from erosion.output.language import ENGLISH, Language
from erosion.output.tables import Record
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.plotting.curves import AngleSeries, plot_best_angles, plot_family
from erosion.plotting.style import house_style, new_axes
from erosion.report.case import Family, ReportCase


def family_figure(case: ReportCase, family: Family) -> Figure:
    """V(α) for every value, with a line that joins the maxima."""
    fig, ax = new_axes(5.4, 4.2)
    plot_family(ax, family.curves(), units=case.units, joined=True)
    return fig


def family_numbers(case: ReportCase, family: Family, model: str) -> Record:
    """For numbers.json."""
    return {
        "values": [float(value) for value in family.values],
        "labels": [label.strip() for label in family.labels],
        "alpha_max": [float(alpha) for alpha in family.alpha],
        "volume_max": [float(volume) for volume in family.volume],
        "kind": [str(kind) for kind in family.kind],
        "ended_by": [str(end) for end in family.ended_by],
        "spread": family.spread,
        "sensitivity": case.sensitivity(model, family.name),
    }


MODEL = "rotating"
_IN_REACH = ("v0", "r", "m", "sigma", "psi")  # what enters Ω = rω/v₀, k aside
_ON_LINE = 41


def numbers_again(case: ReportCase) -> Record:
    """For numbers.json."""
    reach, alpha, kind = _over_reach(case)
    return {
        **{name: family_numbers(case, family, MODEL) for name, family in case.families(MODEL).items()},
        "over_reach": {"reach": reach.tolist(), "alpha_max": alpha.tolist(), "kind": kind.tolist()},
    }


def _over_reach(case: ReportCase) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ω over all that the families cover, α_max [rad] and its kind, by changing r at the case's s and k."""
    reaches = np.concatenate([case.families(MODEL)[name].reach for name in _IN_REACH])
    reach = np.geomspace(reaches.min(), reaches.max(), _ON_LINE)
    r = reach * float(case.p.v0) / case.omega
    optimum = alpha_max(MODEL, dataclasses.replace(case.p, r=r, phidot0=float(case.p.spin * case.p.v0) / r))
    return reach, optimum.alpha, optimum.kind


def figures_again(case: ReportCase, numbers: Record) -> dict[str, Figure]:
    """V(α) at several speeds; α_max over Ω; α_max over k."""
    families = case.families(MODEL)
    return {
        "rotating-speeds": family_figure(case, families["v0"]),
        "best-angle-over-reach": _over_reach_figure(case, numbers),
        "rotating-best-angle-over-k": _over_k_figure(case, families["k"]),
    }


def _over_reach_figure(case: ReportCase, numbers: Record) -> Figure:
    fig, ax = new_axes(5.4, 4.2)
    reach, alpha = (np.array(numbers["over_reach"][key]) for key in ("reach", "alpha_max"))
    families = [case.families(MODEL)[name] for name in _IN_REACH]
    plot_best_angles(
        ax,
        [
            AngleSeries(f"{QUANTITIES[family.name].symbol} changed", family.reach, family.alpha,
                       family.kind == "jump", line=False)
            for family in families
        ],
        xlabel="Ω = r ω/v₀",
        log=True,
        exact=("any of them changed", reach, alpha),
        columns=3,
    )  # fmt: skip
    return fig


def _over_k_figure(case: ReportCase, ratios: Family) -> Figure:
    fig, ax = new_axes(5.4, 3.9)
    law = np.geomspace(ratios.values[0], ratios.values[-1], 200)
    computed = AngleSeries("with rotation", ratios.values, ratios.alpha, ratios.kind == "jump", line=False)
    plot_best_angles(ax, [computed], xlabel=QUANTITIES["k"].label(case.units), log=True,
                     exact=("without: ½ arctan k", law, np.arctan(law) / 2))  # fmt: skip
    return fig


def ranges(case: ReportCase) -> dict[str, Record]:
    """By parameter: the best angles where something is cut, how many are at a jump, and how many values there are."""
    return {
        name: {
            "angles": family.alpha[family.kind != "none"].tolist(),
            "jumps": int(np.sum(family.kind == "jump")),
            "size": family.alpha.size,
        }
        for name, family in case.families(MODEL).items()
    }


def sensitivities(case: ReportCase) -> dict[str, list[float | None]]:
    """Moves of the best angle [rad] by parameter, without rotation and with rotation; None without a derivative."""
    rates = {
        name: [case.sensitivity(model, name) for model in ("linearized", MODEL)]
        for name in QUANTITIES
        # Where nothing spins, "ten per cent more spin" is none.
        if name != "alpha" and (name != "phidot0" or case.p.spin != 0)
    }
    return {name: [rate if np.isfinite(rate) else None for rate in pair] for name, pair in rates.items()}


_STEEPEST = np.pi / 2
_CLOSE = 1e-11  # [rad]: what V′ of a numerical volume can resolve near its root
_NEAR = 1e-7  # [rad]: Newton's step from a zero of V′ is below this, whatever the rounding
_RTOL = 1e-12
_MOST = 60  # bisection alone gains 18 digits in as many


class Iterate(NamedTuple):
    """One step: V and its derivatives at `alpha`, and the move made from there.

    Args:
        alpha: angle of attack [rad].
        volume, dvolume, d2volume: V, V′ and V″ there.
        step: to the next angle [rad].
        kind: "Newton", or "bisection" where Newton's step would have left the bracket.
    """

    alpha: float
    volume: float
    dvolume: float
    d2volume: float
    step: float
    kind: str


Jet = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def volume_jet(model: CuttingModel, p: Parameters) -> Jet:
    """Angles -> V, V′ and V″ there, by automatic differentiation of the solver."""

    def jet(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        result = impact(model, p.replace(alpha=angles), derivatives=2, wrt="alpha", rtol=_RTOL)
        return np.asarray(result.volume), np.asarray(result.dvolume), np.asarray(result.d2volume)

    return jet


def greatest(jet: Jet, looks: int = 17) -> list[Iterate]:
    """Climb to the greatest V in (0, π/2), for a V with one maximum.

    A scan of `looks` angles gives the start and, to either side of it, a bracket in which V′
    changes sign. Each step is Newton's, -V′/V″; where that would leave the bracket, or V″
    has the sign of a valley, the bracket is halved instead. Every look shrinks the bracket,
    so the climb ends whatever the shape of V: V″ jumps where cuts change their end.

    Args:
        jet: angles -> V, V′, V″.
        looks: angles in the scan.

    Returns:
        The steps; the last one's `alpha` is the answer, and its `step` is below 1e-11 rad.

    Raises:
        SimulationError: where an impact fails, or V′ has no zero near the greatest V seen.
    """
    scan = _STEEPEST * np.arange(1, looks + 1) / (looks + 1)
    alpha = float(scan[np.argmax(_finite(scan, jet(scan)[0]))])
    low, high = alpha - scan[0], alpha + scan[0]
    steps: list[Iterate] = []
    while len(steps) < _MOST:
        value, d1, d2 = (float(_finite([alpha], of)[0]) for of in jet(np.array([alpha])))
        low, high = (alpha, high) if d1 > 0 else (low, alpha)
        newton = alpha - d1 / d2 if d2 < 0 else np.nan
        # The end just moved to may itself be the root, to rounding.
        inside = low < newton < high or abs(newton - alpha) <= _CLOSE
        step = (newton if inside else (low + high) / 2) - alpha
        steps.append(Iterate(alpha, value, d1, d2, float(step), "Newton" if inside else "bisection"))
        if abs(step) <= _CLOSE:
            break
        alpha = float(alpha + step)
    # A bracket that held no zero of V′ shrinks to one of its ends, far from where V′ points.
    if abs(steps[-1].dvolume) > _NEAR * abs(steps[-1].d2volume):
        raise SimulationError(f"No angle was found where dV/dα vanishes; the search ended at {np.rad2deg(alpha):.6g}°.")
    return steps


def _finite(angles: Sequence[float] | np.ndarray, values: np.ndarray) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise SimulationError(f"The impact at α = {np.rad2deg(angles[bad[0]]):.6g}° could not be computed.")
    return values


# inches; a handout prints a figure in a column of 3.4 inches, and a wide one across both. Text of 9.5 pt is 7 pt there.
_IN_A_COLUMN, _WIDE, _FLAT = 4.5, 6.5, 3.6


def translate_figure(figure: Figure, language: Language) -> None:
    """Translate all texts of a figure, and the numbers of its axes."""
    if language == ENGLISH:
        return
    for text in cast(Sequence[Text], figure.findobj(Text)):
        text.set_text(language.number(_translated(text.get_text(), language)))
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(_Translated(axis.get_major_formatter(), language))


def is_wide(figure: Figure) -> bool:
    """Whether a figure needs the whole width of a sheet."""
    return bool(figure.get_figwidth() > _WIDE)


@house_style()
def fit_on_sheet(figure: Figure) -> None:
    """Give a figure the size at which its text is readable on a handout; its legends get fewer columns if need be."""
    if is_wide(figure):
        figure.set_figheight(_FLAT)
    else:
        figure.set_size_inches(_IN_A_COLUMN, 0.88 * figure.get_figheight())
    for legend in list(figure.legends):
        for columns in (2, 1):
            extent = legend.get_window_extent()
            if extent.width <= figure.bbox.width:
                break
            legend.remove()
            labels = [text.get_text() for text in legend.get_texts()]
            handles = [handle for handle in legend.legend_handles if handle is not None]
            legend = figure.legend(handles, labels, loc="outside lower center", ncols=columns)
            growth = (legend.get_window_extent().height - extent.height) / figure.dpi
            figure.set_figheight(figure.get_figheight() + growth)  # the axes keep their height


def _translated(label: str, language: Language) -> str:
    """A label such as "V  removed volume  [in³]": its symbol and unit stay."""
    symbol, gap, rest = label.partition("  ")
    whole = language.text(label)
    if whole != label or not gap:
        return whole
    meaning, end, unit = rest.partition("  ")
    name = symbol if re.fullmatch(r"\W*\w\W*|\$.*\$|\S{1,3}|.* = .*", symbol) else language.text(symbol)
    return name + gap + (language.text(meaning) if not meaning.startswith("[") else meaning) + end + unit


class _Translated(Formatter):
    """A formatter whose numbers have the separators of a language.

    Args:
        inner: the formatter that makes the texts.
        language: their language.
    """

    def __init__(self, inner: Formatter, language: Language) -> None:
        self._inner, self._language = inner, language

    def __call__(self, x: Any, pos: int | None = None) -> str:
        return self._language.number(self._inner(x, pos))

    def set_axis(self, axis: Any) -> None:
        self._inner.set_axis(cast(Axis, axis))

    def set_locs(self, locs: Any) -> None:
        self._inner.set_locs(locs)

    def get_offset(self) -> str:
        return self._inner.get_offset()
