"""The case that questions are asked about, with the families and spins that several of them share."""

import dataclasses
import functools
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from erosion.impacts import Impact, Jump, Optimum, SimulationError, Trajectory, alpha_max, impact, path, turned_beyond
from erosion.models import Linearized, load_model
from erosion.models.rigid import LinearizedCut
from erosion.output import Record
from erosion.parameters import MATERIALS, QUANTITIES, Parameters, PerMass, System, unit_name
from erosion.plotting.curves import AngleSeries, ShapeCurve, plot_best_angles, plot_family
from erosion.plotting.labels import Best, broken_at, leaps
from erosion.plotting.style import new_axes
from erosion.report.text import degrees, number
from erosion.sweeps.grid import in_words
from erosion.sweeps.sweep import regimes

T = TypeVar("T")

LINEARIZED = "linearized"
"""The model of questions 1 to 8."""

RTOL = 1e-12  # relative tolerance of the report's impacts, with which its other numbers are compared
_SPEEDS: Mapping[System, tuple[float, ...]] = types.MappingProxyType(
    {"inch-pound": (2000.0, 3500.0, 5000.0, 6500.0, 8000.0), "si": (50.0, 90.0, 125.0, 165.0, 200.0)}
)
_FACTORS = {0.25: "¼ ", 0.5: "½ ", 1.0: "", 2.0: "2 ", 4.0: "4 "}
_CONTACTS = (0.01, 0.1, 0.5, 2.0, 4.9)  # of (0, 5), as the source recommends
_RATIOS = (0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)  # of (0.1, 10), as it recommends too


@dataclass(frozen=True)
class BestOverValues:
    """A model's angles of greatest removal over the values of one parameter; arrays have shape (values,).

    Args:
        values: ascending.
        alpha: of the greatest removal [rad], NaN where nothing is removed.
        volume: there.
        kind, ended_by: there, as in `Optimum`.
        beyond: whether the body turns by more than 90° there.
    """

    values: np.ndarray
    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray
    ended_by: np.ndarray
    beyond: np.ndarray

    @property
    def jumps(self) -> int:
        """How many of the maxima are at a jump of V(α)."""
        return int(np.sum(self.kind == "jump"))

    @property
    def leaps(self) -> int:
        """Between how many neighbouring values another maximum becomes the greatest."""
        return leaps(np.rad2deg(self.alpha)).size

    @property
    def rows(self) -> list[Record]:
        """The row of a table for each value."""
        maxima = zip(self.values, self.alpha, self.volume, self.kind, self.ended_by, strict=True)
        return [dict(zip(("value", "alpha", "volume", "kind", "ended_by"), maximum, strict=True)) for maximum in maxima]

    @property
    def one_alpha(self) -> float:
        """The angle, where it is the same for all values."""
        return float(self.alpha[0])

    @property
    def least_and_most(self) -> tuple[Record, Record]:
        """The rows of the least and of the greatest volume."""
        return self.rows[int(self.volume.argmin())], self.rows[int(self.volume.argmax())]

    def series(self, label: str, over: np.ndarray | None = None, *, line: bool = False) -> AngleSeries:
        """The angles over the values, or over other numbers of each value, for a figure."""
        return AngleSeries(
            label, self.values if over is None else over, self.alpha, self.kind == "jump", line, self.beyond
        )

    def numbers(self) -> Record:
        """For numbers.json."""
        columns = {"alpha_max": self.alpha, "volume_max": self.volume, "kind": self.kind, "ended_by": self.ended_by,
                   "turned_beyond": self.beyond}  # fmt: skip
        counts = {"at_jump": self.jumps, "values_in_all": self.alpha.size, "turned_in_all": int(self.beyond.sum())}
        return {name: column.tolist() for name, column in columns.items()} | counts


@dataclass(frozen=True)
class Family(BestOverValues):
    """A model's answers for the values of one parameter.

    Args:
        name: of the parameter.
        labels: of the values.
        curves: V(α) of the values that are drawn.
        volumes: V, shape (values, angles).
        reach: Ω = r ω/v₀, shape (values,).
    """

    name: str
    labels: tuple[str, ...]
    curves: tuple[ShapeCurve, ...]
    volumes: np.ndarray
    reach: np.ndarray

    @property
    def named(self) -> bool:
        """Whether the labels are names, such as copper or 2R, instead of values."""
        return any("=" not in label for label in self.labels)

    @property
    def spread(self) -> float:
        """The greatest α_max minus the least [rad]."""
        return float(np.ptp(self.alpha))

    def departure(self, power: int) -> float:
        """The relative range of V_max / value^`power`; 0 where V_max ∝ value^`power`."""
        scaled = self.volume / self.values**power
        return float(np.ptp(scaled) / scaled.mean())

    def figure(self, system: System) -> Figure:
        """V(α) for every value that is shown, with a line that joins the maxima."""
        return panel(plot_family, self.curves, height=4.2, system=system, joined=True)


Families = Mapping[str, Family]
"""Each family by the name of the parameter that varies: v0, r, m, sigma, psi, k."""


def families_of(model: str, p: Parameters, angles: np.ndarray) -> Families:
    """All families of a model about one case, in one batch."""
    varied = {name: values(p) for name, values in _VALUES.items()}
    rows = [(name, value) for name, values in varied.items() for value in values]
    columns: dict[str, Any] = {q: np.full(len(rows), float(getattr(p, q))) for q in QUANTITIES}
    for i, (name, value) in enumerate(rows):
        columns[name][i] = value
    cases = dataclasses.replace(p, **columns)
    best = alpha_max(model, cases, max_turn=None)
    over_angles: dict[str, Any] = {q: column[:, None] for q, column in columns.items()} | {"alpha": angles}
    grid = dataclasses.replace(p, **over_angles)
    hits = impact(model, grid, derivatives=2, rtol=RTOL)
    reach = np.asarray(cases.r * cases.rate / cases.v0)
    beyond = turned_beyond(model, cases.replace(alpha=best.alpha))
    families = {}
    for name in varied:
        at = np.array(sorted((i for i, row in enumerate(rows) if row[0] == name), key=lambda i: rows[i][1]))
        values = columns[name][at]
        # A figure shows all values, but of the force ratios every third and the case's own.
        shown = np.isin(values, [*_RATIOS[::3], float(p.k)]) if name == "k" else np.ones(values.size, bool)
        labels = tuple(varied[name][value] for value in values.tolist())
        curves = tuple(
            curve_of(model, dataclasses.replace(p, **{name: value}), angles, hits.volume[i], best.jumps[i], label,
                     None if best.kind[i] == "none" else
                     Best(float(best.alpha[i]), float(best.volume[i]), str(best.kind[i]), bool(best.attained[i])))
            for i, value, label, drawn in zip(at, values, labels, shown, strict=True) if drawn
        )  # fmt: skip
        families[name] = Family(
            values, best.alpha[at], best.volume[at], best.kind[at], best.ended_by[at], beyond[at], name, labels, curves,
            hits.volume[at], reach[at],
        )  # fmt: skip
    return families


def curve_of(
    model: str,
    p: Parameters,
    angles: np.ndarray,
    volume: np.ndarray,
    jumps: tuple[Jump, ...],
    label: str,
    best: Best | Optimum | None,
) -> ShapeCurve:
    """V(α) of a model, with gaps at its jumps."""
    angles, volume = broken_at(jumps, angles, volume)
    return ShapeCurve(label, angles, volume, best, turned_beyond(model, p.replace(alpha=angles)))


def turned_angles(curve: ShapeCurve) -> str:
    """The angles at which the body turns by more than 90°, in words: "from 29° on"; empty where there are none."""
    drawn = np.isfinite(curve.angles)
    angles, beyond = curve.angles[drawn], np.zeros(drawn.sum(), bool) if curve.beyond is None else curve.beyond[drawn]
    ends = np.flatnonzero(np.diff(beyond, prepend=False, append=False)).reshape(-1, 2)
    return " and ".join(_between(angles, first, after - 1) for first, after in ends)


def _between(angles: np.ndarray, first: int, last: int) -> str:
    low, high = degrees(angles[first], 3), degrees(angles[last], 3)
    if last == angles.size - 1:
        return f"from {low} on" if first else "at every angle"
    if not first:
        return f"up to {high}"
    return f"at {low}" if first == last else f"from {low} to {high}"


def _with_unit(name: str, p: Parameters, values: tuple[float, ...]) -> dict[float, str]:
    """Labels of values that are in the unit system of a case, and of the case's own value, by the value in SI."""
    quantity, own = QUANTITIES[name], float(getattr(p, name))
    unit, size = unit_name(quantity.dimension, p.shown_in), quantity.size(p.shown_in)
    return {
        value: f"{quantity.symbol} = {number(value / size, 4, strip=True)}" + (f" {unit}" if unit else "")
        for value in {*(value * size for value in values), own}
    }


def _multiples(name: str, p: Parameters) -> dict[float, str]:
    own = float(getattr(p, name))
    return {factor * own: f"{written}{QUANTITIES[name].symbol}" for factor, written in _FACTORS.items()}


_VALUES: Mapping[str, Callable[[Parameters], dict[float, str]]] = types.MappingProxyType(
    {
        "v0": lambda p: _with_unit("v0", p, _SPEEDS[p.shown_in]),
        "r": lambda p: _multiples("r", p),
        "m": lambda p: _multiples("m", p),
        "sigma": lambda p: {float(p.sigma): "this case"} | {sigma: metal for metal, sigma in MATERIALS.items()},
        "psi": lambda p: _with_unit("psi", p, _CONTACTS),
        "k": lambda p: _with_unit("k", p, _RATIOS),
    }
)


TORQUES = {"rotating": "torque r Fₓ", "rotating-full-torque": "torque of both components"}
"""The titles of the models of a body that turns, by name."""

_SPINS = np.round(np.linspace(-0.9, 0.9, 37), 3)  # s = r φ̇₀/v₀, in steps of 0.05


@dataclass(frozen=True)
class Spins(BestOverValues):
    """A model's best angles over the spin s = r φ̇₀/v₀.

    Args:
        map: the dataset of `regimes`, with `turned_beyond`.
        valid_alpha: the best angle among cuts that turn the body by at most 90° [rad], shape (spins,).
    """

    map: xr.Dataset
    valid_alpha: np.ndarray

    @property
    def rows(self) -> list[Record]:
        """The row of a table for each spin."""
        return [{**row, "valid_alpha": alpha} for row, alpha in zip(super().rows, self.valid_alpha, strict=True)]

    def numbers(self) -> Record:
        """For numbers.json."""
        return super().numbers() | {"valid_alpha_max": self.valid_alpha.tolist()}


Need = tuple[str, str]
"""A kind of result and the model that it is about: ("optimum", "rotating")."""

_ASIDE = {"slips": "On the source", "models": "In closing"}


@dataclass(frozen=True)
class Answer:
    """The computed answer to one question; a Markdown file beside the question's module shows it.

    Args:
        numbers: by name, for numbers.json and as fields of the text: every number that the text prints.
        figures: by the names of their files, without suffix.
        fields: further values that the text uses, by name, such as labels.
        curves: of the models that the numbers are of, by their names in Markdown.
    """

    numbers: Record
    figures: Mapping[str, Figure]
    fields: Mapping[str, Any] = field(default_factory=dict)
    curves: Sequence[ShapeCurve] = ()


def question(key: str) -> str:
    """The title of a part: "q4" is Question 4, "a2" is Additional question 2; other keys give their subject."""
    if key in _ASIDE:
        return _ASIDE[key]
    return f"{'Additional question' if key[0] == 'a' else 'Question'} {key[1:]}"


_SHARED: dict[str, Callable[..., Any]] = {}
"""By name, the methods whose results are computed once."""


def _shared(compute: Callable[["ReportCase", str], T]) -> Callable[["ReportCase", str], T]:
    """A method of a model that computes once: ahead, see `ReportCase.prepare`, or when first asked."""
    _SHARED[compute.__name__] = compute

    @functools.wraps(compute)
    def result(case: "ReportCase", model: str) -> T:
        need = compute.__name__, model
        if need not in case._results:
            computed = compute(case, model)
            case._results[need] = Future()
            case._results[need].set_result(computed)
        return case._results[need].result()

    return result


class ReportCase:
    """One set of parameters. Results that several questions need are computed once.

    Questions 1 to 8 are asked of the linearized model, whose solution is known exactly.
    Results about models that are given by name come from the engine, also if a closed form exists.

    Args:
        p: all scalars.
        name: what to call the case.
        per_mass: how a volume becomes erosion per mass of particles.
    """

    def __init__(self, p: Parameters, name: str, per_mass: PerMass | None = None) -> None:
        self.p, self.name, self.per_mass = p, name, per_mass or PerMass()
        self.units: System = p.shown_in
        self.alpha, self.omega = float(p.alpha), float(p.rate)
        self.cusp = float(np.arctan(p.k / 2))  # [rad]: cuts rebound up to this angle and stop above it
        self.model, self.closed = Linearized(), LinearizedCut()
        self._results: dict[Need, Future[Any]] = {}
        # α in (0, 90°] [rad] for curves of the engine; fewer than `angles`, because each angle is integrated. The last
        # is short of 90° by less than any curve shows, for at 90° itself nothing is cut.
        end = 90 - 1e-7
        self.looks = np.deg2rad([0.02, 0.1, 0.25, *np.linspace(0, 90, 181)[1:-1], end])
        # The same for closed forms, closer together where curves bend at the cusp.
        even = np.deg2rad([*np.linspace(0, 90, 361)[1:-1], end])
        below = self.cusp * np.linspace(0, 1, 101)[1:]
        above = self.cusp + (np.pi / 2 - self.cusp) * np.geomspace(1e-6, 1, 81)[:-1]
        self.angles = np.unique(np.concatenate([even, below, above]))

    @functools.cached_property
    def trajectory(self) -> Trajectory:
        """The numerical solution of the linearized model."""
        return path(self.model, self.p)

    @functools.cached_property
    def t_c(self) -> float:
        """The exact time of the end of the cut [s]."""
        return float(self.closed.t_c(self.p))

    @functools.cached_property
    def volume(self) -> float:
        """The exact removed volume [m³]."""
        return float(self.closed.volume(self.p))

    def weighed(self, volume: float) -> Record:
        """A volume per mass of particles, in SI units: `specific_volume`, and `erosion_ratio` with a density."""
        return {name: float(value) for name, value in self.per_mass.to_dict(volume, self.p).items()}

    @functools.cached_property
    def ended_by(self) -> str:
        """How the cut ends: "rebound", "stop" or "no-cut"."""
        return str(self.closed.ended_by(self.p))

    def prepare(self, pool: Executor, needs: Iterable[Need]) -> None:
        """Compute in the background the results that questions need, in an order in which each uses only earlier ones.

        Compiling and integrating release the interpreter, so that a second core has work.
        """
        for kind, model in dict.fromkeys(needs):
            self._results[kind, model] = pool.submit(_SHARED[kind], self, model)

    @_shared
    def optimum(self, model: str) -> Optimum:
        """A model's angle of greatest removal in this case."""
        return alpha_max(model, self.p, max_turn=None)

    @_shared
    def sensitivities(self, model: str) -> Mapping[str, Any]:
        """dα_max/dq by parameter."""
        return self.optimum(model).sensitivities

    @_shared
    def hits(self, model: str) -> Impact:
        """A model's impacts at the `looks`, and after them at the case's own angle."""
        # To second order, as `alpha_max` computes V: the page's numbers are the same to the bit.
        p = self.p.replace(alpha=np.append(self.looks, self.alpha))
        return impact(model, p, derivatives=2, rtol=RTOL)

    @_shared
    def impact_and_optimum(self, model: str) -> Record:
        """A model's impact at the case's own angle, and its angle of greatest removal, as a row of numbers.json."""
        hits, optimum = self.hits(model), self.optimum(model)
        here, best = turned_beyond(model, self.p.replace(alpha=np.array([self.alpha, optimum.alpha]))).tolist()
        valid = alpha_max(model, self.p) if best else optimum
        return {
            "volume": float(hits.volume[-1]),
            "t_c": float(hits.t_c[-1]),
            "ended_by": str(hits.ended_by[-1]),
            "turned_beyond": here,
            "alpha_max": float(optimum.alpha),
            "volume_max": float(optimum.volume),
            "kind": str(optimum.kind),
            "ended_by_at_max": str(optimum.ended_by),
            "turned_beyond_at_max": best,
            "valid_alpha_max": float(valid.alpha),
            "valid_volume_max": float(valid.volume),
            "valid_kind": str(valid.kind),
        }

    @_shared
    def curve(self, model: str) -> ShapeCurve:
        """A model's V(α) with its maximum, and with gaps at its jumps."""
        optimum, volume = self.optimum(model), self.hits(model).volume[:-1]
        best = None if optimum.kind == "none" else optimum
        return curve_of(model, self.p, self.looks, volume, optimum.jumps, model, best)

    @_shared
    def spins(self, model: str) -> Spins:
        """A model's angles of greatest removal over the spin."""
        spins = _SPINS * float(self.p.v0 / self.p.r)
        found = regimes(model, self.p, phidot0=spins, max_turn=None)
        kind, ended_by = in_words(found.alpha_max_kind), in_words(found.alpha_max_ended_by)
        beyond = turned_beyond(model, self.p.replace(alpha=found.alpha_max.values, phidot0=spins))
        valid = alpha_max(model, self.p.replace(phidot0=spins)).alpha
        return Spins(_SPINS, found.alpha_max.values, found.volume_max.values, kind, ended_by, beyond, found, valid)

    @_shared
    def families(self, model: str) -> Families:
        """A model with other speeds, particles, materials and modelling parameters."""
        return families_of(model, self.p, self.looks)

    def curves(self, titles: Mapping[str, str]) -> list[ShapeCurve]:
        """V(α) of models, by their titles."""
        return [self.curve(model)._replace(label=title) for model, title in titles.items()]

    def sensitivity(self, model: str, name: str) -> float:
        """The change of α_max for a change of q by its own size: q dα_max/dq [rad]."""
        return float(self.sensitivities(model)[name]) * float(getattr(self.p, name))

    def over_angles(self) -> Parameters:
        """The case at every one of `angles`."""
        return self.p.replace(alpha=self.angles)


def followed(p: Parameters) -> Trajectory | None:
    """The cut of a body that the force may turn; None where it cannot be followed."""
    try:
        return path(load_model("rotating"), p)
    except SimulationError:
        return None


def panel(plot: Callable[..., Any], *content: Any, width: float = 5.4, height: float = 4.1, **options: Any) -> Figure:
    """A figure of one panel, which a function of `erosion.plotting` fills."""
    fig, ax = new_axes(width, height)
    plot(ax, *content, **options)
    return fig


def family_numbers(case: ReportCase, family: Family, model: str) -> Record:
    """For numbers.json."""
    return {
        "values": family.values.tolist(),
        "labels": [label.strip() for label in family.labels],
        **family.numbers(),
        "spread": family.spread,
        "sensitivity": case.sensitivity(model, family.name),
    }


def best_angle_over_k(family: Family, system: System, label: str, law: str, height: float) -> Figure:
    """The best angles over the force ratio, beside those of the linearized model."""
    ratios = np.geomspace(family.values[0], family.values[-1], 200)
    exact = (law, ratios, np.arctan(ratios) / 2)
    xlabel = QUANTITIES["k"].label(system)
    return panel(plot_best_angles, [family.series(label)], height=height, xlabel=xlabel, log=True, exact=exact)
