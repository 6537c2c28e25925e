"""One parameter at several values, with all other parameters fixed: questions 5 to 8, for any model."""

import dataclasses
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from erosion.impacts.impact import impact
from erosion.optimum.alpha_max import alpha_max
from erosion.optimum.maxima import Jump
from erosion.parameters.materials import MATERIALS
from erosion.parameters.parameters import QUANTITIES, Parameters
from erosion.parameters.units import System, conversion_factor, unit_name
from erosion.plotting.curves import broken_at
from erosion.plotting.families import Curve
from erosion.report.text import number
from erosion.tables import Record

_RTOL = 1e-12
_SPEEDS: Mapping[System, tuple[float, ...]] = types.MappingProxyType(
    {"inch-pound": (2000.0, 3500.0, 5000.0, 6500.0, 8000.0), "si": (50.0, 90.0, 125.0, 165.0, 200.0)}
)
_FACTORS = {0.25: "¼ ", 0.5: "½ ", 1.0: "", 2.0: "2 ", 4.0: "4 "}
_CONTACTS = (0.01, 0.1, 0.5, 2.0, 4.9)  # of (0, 5), as the source recommends
_RATIOS = (0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)  # of (0.1, 10), as it recommends too


@dataclass(frozen=True)
class Family:
    """A model's answers for the values of one parameter; arrays have shape (values,) first.

    Args:
        name: of the parameter.
        values: ascending, in the case's units.
        labels: of the values.
        shown: which of them are drawn as curves.
        angles: shape (angles,) [rad].
        volumes: V, shape (values, angles).
        alpha, volume: of the maximum.
        kind, ended_by: of the maximum, as in `Optimum`.
        jumps: of each V(α).
        reach: Ω = r ω/v₀.
    """

    name: str
    values: np.ndarray
    labels: tuple[str, ...]
    shown: np.ndarray
    angles: np.ndarray
    volumes: np.ndarray
    alpha: np.ndarray
    volume: np.ndarray
    kind: np.ndarray
    ended_by: np.ndarray
    jumps: tuple[tuple[Jump, ...], ...]
    reach: np.ndarray

    @property
    def rows(self) -> list[Record]:
        """The row of a table for each value."""
        columns = ("label", "value", "alpha", "volume", "kind", "ended_by")
        answers = zip(self.labels, self.values, self.alpha, self.volume, self.kind, self.ended_by, strict=True)
        return [dict(zip(columns, row, strict=True)) for row in answers]

    @property
    def named(self) -> bool:
        """Whether the labels are names, such as copper or 2R, instead of values."""
        return any("=" not in label for label in self.labels)

    @property
    def least(self) -> float:
        """The least V_max."""
        return float(self.volume.min())

    @property
    def greatest(self) -> float:
        """The greatest V_max."""
        return float(self.volume.max())

    @property
    def spread(self) -> float:
        """The greatest α_max minus the least [rad]."""
        return float(np.ptp(self.alpha))

    def departure(self, power: int) -> float:
        """The relative range of V_max / value^`power`; 0 where V_max ∝ value^`power`."""
        scaled = self.volume / self.values**power
        return float(np.ptp(scaled) / scaled.mean())

    def curves(self) -> list[Curve]:
        """V(α) of the values shown."""
        return [
            Curve(
                self.labels[i],
                *broken_at(self.jumps[i], self.angles, self.volumes[i]),
                (float(self.alpha[i]), float(self.volume[i])),
            )
            for i in np.flatnonzero(self.shown)
        ]


Families = Mapping[str, Family]
"""Each family by the name of the parameter that varies: v0, r, m, sigma, psi, k."""


def families_of(model: str, p: Parameters, angles: np.ndarray) -> Families:
    """All families of a model about one case, in one batch."""
    varied = {name: values(p) for name, values in _VALUES.items()}
    rows = [(name, value) for name, values in varied.items() for value in values]
    columns = {q: np.full(len(rows), float(getattr(p, q))) for q in QUANTITIES}
    for i, (name, value) in enumerate(rows):
        columns[name][i] = value
    cases = dataclasses.replace(p, **columns)
    best = alpha_max(model, cases)
    grid = dataclasses.replace(p, **{q: column[:, None] for q, column in columns.items()} | {"alpha": angles})
    hits = impact(model, grid, derivatives=2, rtol=_RTOL)
    reach = np.asarray(cases.r * cases.rate / cases.v0)
    families, begin = {}, 0
    for name, values in varied.items():
        rows_of_family = slice(begin, begin + len(values))
        begin += len(values)
        order = np.argsort(list(values))
        families[name] = Family(
            name=name,
            values=np.array(list(values))[order],
            labels=tuple(list(values.values())[i] for i in order),
            shown=_shown(name, p, np.array(list(values))[order]),
            angles=angles,
            volumes=hits.volume[rows_of_family][order],
            alpha=best.alpha[rows_of_family][order],
            volume=best.volume[rows_of_family][order],
            kind=best.kind[rows_of_family][order],
            ended_by=best.ended_by[rows_of_family][order],
            jumps=tuple(best.jumps[rows_of_family][i] for i in order),
            reach=reach[rows_of_family][order],
        )
    return families


def _shown(name: str, p: Parameters, values: np.ndarray) -> np.ndarray:
    """A mask of the values that a figure shows: all values, but of the force ratios every third and the case's own."""
    return np.isin(values, [*_RATIOS[::3], float(p.k)]) if name == "k" else np.ones(values.size, bool)


def _with_unit(name: str, p: Parameters, values: tuple[float, ...]) -> dict[float, str]:
    quantity = QUANTITIES[name]
    unit = unit_name(quantity.dimension, p.units)
    own = float(getattr(p, name))
    return {
        value: f"{quantity.symbol} = {number(value, 4, strip=True)}" + (f" {unit}" if unit else "")
        for value in {*values, own}
    }


def _multiples(name: str, p: Parameters) -> dict[float, str]:
    own = float(getattr(p, name))
    return {factor * own: f"{written}{QUANTITIES[name].symbol}" for factor, written in _FACTORS.items()}


def _metals(p: Parameters) -> dict[float, str]:
    to_own = conversion_factor("stress", "inch-pound", p.units)
    return {float(p.sigma): "this case"} | {sigma * to_own: metal for metal, sigma in MATERIALS.items()}


_VALUES: Mapping[str, Callable[[Parameters], dict[float, str]]] = types.MappingProxyType(
    {
        "v0": lambda p: _with_unit("v0", p, _SPEEDS[p.units]),
        "r": lambda p: _multiples("r", p),
        "m": lambda p: _multiples("m", p),
        "sigma": _metals,
        "psi": lambda p: _with_unit("psi", p, _CONTACTS),
        "k": lambda p: _with_unit("k", p, _RATIOS),
    }
)
