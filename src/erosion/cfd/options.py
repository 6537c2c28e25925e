"""Options of a map: the case, the scaling of its body with a row's particle, its spin, and laws."""

import contextlib
import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.stats import qmc

from erosion.arguments import check_share, check_whole
from erosion.cfd.incidence import Hits
from erosion.cfd.rows import ImpactsError
from erosion.laws import SHARE, JointLaw, is_law
from erosion.models import CuttingModel, own_in_words, quantities, ranges, with_values
from erosion.models.correlated import Correlated, CorrelatedBySize
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    Dimension,
    Parameters,
    UnitError,
    about,
    has_unit,
    read_quantity,
    validate,
)

SCALINGS = ("similar", "none")
SPINS = ("column", "case", "none")
ROWS = "rows"
"""The mass of sand injected, where each row is another parcel."""
OF_ROWS = ("alpha", "v0", "m")
"""The parameters that each row has of its own."""
OF_CASE = ("k", "psi", "sigma", "r", "b", "inertia", "phidot0")
FRACTION = "cutting_fraction"
"""The share of the particles that cut, a factor of the volume; it may be uncertain as parameters of an impact may."""


@dataclasses.dataclass(frozen=True)
class MapOptions:
    """The case, and how a map is made of it; see `erosion_map`.

    Speed, angle and mass are always the row's. The other parameters follow from the case, which describes one
    particle: that of the case's mass, or of `diameter` where it is given.

    Args:
        p: the case, all scalars.
        scaling, diameter, restitution, density, limit, seed, rtol, uncertain, draws, cutting_fraction, sand_rate,
            injected, each_row: see `erosion_map`.
        spin: see `erosion_map`; a law joins `laws`.
        laws: of parameters of the case or the model's own, from impact to impact.

    Raises:
        ValueError, TypeError: for an option that makes no sense.
    """

    p: Parameters
    scaling: str = "similar"
    diameter: float | None = None
    spin: Any = None
    restitution: tuple[float, float] | None = None
    density: float | None = None
    limit: float | None = None
    seed: int = 0
    rtol: float = 1e-9
    uncertain: JointLaw = dataclasses.field(default_factory=JointLaw)
    draws: int = 64
    cutting_fraction: float = 1.0
    sand_rate: Any = None
    injected: Any = None
    laws: JointLaw = dataclasses.field(default_factory=JointLaw)
    each_row: str | None = None

    def __post_init__(self) -> None:
        if self.scaling not in SCALINGS:
            raise ValueError(
                f"Argument `scaling` must be one of {', '.join(SCALINGS)}, but is {briefly(self.scaling)}."
            )
        if not (self.spin is None or is_law(self.spin) or self.spin in SPINS):
            known = ", ".join(SPINS)
            raise ValueError(
                f"Argument `spin` must be {known} or a law such as normal(0, 1e4), but is {briefly(self.spin)}."
            )
        if self.diameter is not None and self.scaling == "none":
            raise ValueError("Argument `diameter` must be left out where all particles have the case's r and b.")
        self._check_names()
        if is_law(self.spin):
            laws = {**self.laws.laws, "phidot0": self.spin}
            object.__setattr__(self, "laws", dataclasses.replace(self.laws, laws=laws))
            object.__setattr__(self, "spin", None)
        object.__setattr__(self, "rtol", check_share("rtol", self.rtol))
        check_whole("seed", self.seed, 0)
        check_whole("draws", self.draws, 2)
        validate(self.p)
        object.__setattr__(self, "sand_rate", _read_sand_rate(self.sand_rate))
        if self.injected is not None:
            self.injected_in(1.0)
        _ = self.particles
        for name in ("density", "limit", "diameter"):
            if (value := getattr(self, name)) is not None and not (_are_numbers(value) and 0 < value < np.inf):
                raise ValueError(f"Argument `{name}` must be positive and finite, but is {briefly(value)}.")
        if not (_are_numbers(self.cutting_fraction) and 0 < self.cutting_fraction <= 1):
            raise ValueError(
                f"Argument `cutting_fraction` must be above 0 and at most 1, but is {briefly(self.cutting_fraction)}."
            )
        pair: Any = (1, 0) if self.restitution is None else self.restitution
        is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2 and _are_numbers(*pair)
        if not (is_pair and 0 < pair[0] <= 1 and 0 <= pair[1] < 1):
            raise ValueError(
                "Argument `restitution` must be (e, μ) with e in (0, 1] and μ in [0, 1), as the wall of the CFD run "
                f"has them, but is {briefly(pair)}."
            )

    def _check_names(self) -> None:
        """Refuse laws of what has another value already."""
        for name in OF_ROWS:
            if name in self.names:
                raise ValueError(f"Argument `{name}` must be left out: each row of the table has its own.")
        if self.spin is not None and "phidot0" in self.names:
            raise ValueError("Argument `spin` must be left out where `phidot0` has a law.")
        if both := [name for name in self.uncertain.names if name in self.laws.names]:
            raise ValueError(
                f"Argument `uncertain` must name parameters without another law, but {both[0]} has one from impact to "
                "impact."
            )
        if FRACTION in self.uncertain.names and self.cutting_fraction != 1:
            raise ValueError("Argument `cutting_fraction` must be left out where it is uncertain.")

    def check_laws(self, model: CuttingModel) -> None:
        """Know before anything is read that the laws make sense for the model.

        Raises:
            ValueError, TypeError: naming the first law that does not.
        """
        varied, common = self.laws.within(ranges(model)).medians, self.common(model)
        # So that an own parameter that cannot be an array is refused too.
        with_values(model, self.p, {name: value for name, value in (varied | common).items() if name != FRACTION})

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that vary or are uncertain."""
        return self.laws.names + self.uncertain.names

    @property
    def seed_used(self) -> int | None:
        """The seed, where numbers are drawn."""
        return self.seed if self.names else None

    @property
    def realisations(self) -> int:
        """How many times the map is computed: once for each draw of uncertain parameters, 1 without these."""
        return self.draws if self.uncertain else 1

    def in_words(self) -> str:
        """The options that are not the default."""
        given = {
            "scaling": None if self.scaling == "similar" else self.scaling,
            "diameter": self.diameter,
            "spin": self.spin,
            **self.laws.in_words({}, self.p.shown_in),
            **{f"uncertain {name}": law for name, law in self.uncertain.in_words({}, self.p.shown_in).items()},
            "draws": self.draws if self.uncertain else None,
            "seed": self.seed_used,
            FRACTION: None if self.cutting_fraction == 1 else self.cutting_fraction,
            **{
                name: getattr(self, name)
                for name in ("restitution", "density", "limit", "sand_rate", "injected", "each_row")
            },
        }
        return ", ".join(f"{name} = {value}" for name, value in given.items() if value is not None)

    def injected_in(self, duration: float | None) -> float | None:
        """The mass of sand that is injected [kg], where `injected` is given.

        Args:
            duration: of the run [s], for a mass flow.

        Raises:
            ValueError: for what is neither a mass nor a mass flow, and a mass flow where the duration is not known.
        """
        if self.injected in (None, ROWS):
            return None
        is_flow = False
        with contextlib.suppress(UnitError):
            is_flow = isinstance(self.injected, str) and bool(read_quantity(self.injected, "mass flow"))
        if not (is_flow and has_unit(self.injected)):
            return _read("injected", self.injected, "mass")
        if duration is None:
            raise ValueError("Argument `injected` is a mass flow, so Argument `duration` must be given.")
        return _read("injected", self.injected, "mass flow") * duration

    @property
    def particles(self) -> float:
        """The particles that each row of a table without weights stands for.

        Raises:
            ValueError: for what is no number of particles.
        """
        if self.each_row is None:
            return 1.0
        number, _, word = str(self.each_row).strip().partition(" ")
        with contextlib.suppress(ValueError):
            if word in ("particle", "particles") and 0 < float(number) < math.inf:
                return float(number)
        raise ValueError(f'Argument `each_row` must be such as "1 particle", but is {briefly(self.each_row)}.')

    def laws_in_words(self, model: CuttingModel) -> dict[str, str]:
        """By parameter, its law as a person reads it: "normal(2, 0.1)", "uncertain normal(2, 0.1)"."""
        known, units = quantities(model), self.p.shown_in
        uncertain = self.uncertain.in_words(known, units)
        return self.laws.in_words(known, units) | {name: f"uncertain {law}" for name, law in uncertain.items()}

    def constants_in_words(self, model: CuttingModel) -> str:
        """Constants of the model, the formula of a correlation, else the case, and own parameters; and laws."""
        formula = model.formula if isinstance(model, Correlated) else ""
        own = own_in_words(model, self.names, self.p.shown_in)
        values = {} if formula else {name: float(getattr(self.p, name)) for name in OF_CASE if name not in self.names}
        case = [f"{QUANTITIES[name].symbol} = {QUANTITIES[name].in_words(value, self.p.shown_in)}"
                for name, value in values.items() if value]  # fmt: skip
        laws = [f"{name} = {law}" for name, law in self.laws_in_words(model).items()]
        return "; ".join(filter(None, [formula, ", ".join([*case, *filter(None, [own]), *laws])]))

    def common(self, model: CuttingModel) -> dict[str, np.ndarray]:
        """The uncertain parameters, the same for all rows; each of shape (draws, 1).

        Raises:
            ValueError, TypeError: for laws that make no sense.
        """
        laws = self.uncertain.within({**ranges(model), FRACTION: SHARE})
        if not laws.dimension:
            return {}
        sampler = qmc.Sobol(laws.dimension, rng=np.random.default_rng([self.seed, 0, 1]))
        # A power of 2 is drawn, of which scrambled points are even; 0 and 1 do not come out.
        points = sampler.random_base2(math.ceil(math.log2(self.draws)))[: self.draws] + 2.0**-31
        return {name: value[:, None] for name, value in laws.draw(points).items()}

    def of_rows(self, model: CuttingModel, hits: Hits, portion: int) -> dict[str, np.ndarray]:
        """Values of laws and spins for each row of a portion, shape (rows,); rows that are left out get numbers, too.

        Raises:
            ImpactsError: where the column of the spin is asked for but not there.
            ValueError, TypeError: for laws that make no sense.
        """
        laws = self.laws.within(ranges(model))
        points = np.random.default_rng([self.seed, portion]).uniform(2.0**-53, 1.0, (hits.rows, laws.dimension))
        values = laws.draw(points)
        if "phidot0" in self.names:
            return values
        lacks = np.isnan(hits.spin)
        if self.spin == "column" and lacks.any():
            raise ImpactsError("Argument `spin` must be a law, case or none, as the table has no column of it.")
        usual = 0.0 if self.spin == "none" else float(self.p.phidot0)
        return {**values, "phidot0": np.where(lacks | (self.spin in ("none", "case")), usual, hits.spin)}

    def impacts(
        self, model: CuttingModel, hits: Hits, values: Mapping[str, np.ndarray]
    ) -> tuple[CuttingModel, Parameters]:
        """Model and case of rows that hit.

        Args:
            model: with its own parameters.
            hits: the rows.
            values: by parameter, φ̇₀ among them, what takes the place of the case's value: from `of_rows` for these
                rows, and from `common`.
        """
        model, p = with_values(model, self.p, {name: value for name, value in values.items() if name != FRACTION})
        if self.scaling == "none":
            growth = np.ones_like(hits.mass)
        elif self.diameter is None:
            growth = np.cbrt(hits.mass / float(self.p.m))
        else:
            growth = hits.diameter / self.diameter
        p = dataclasses.replace(p.similar(growth), m=hits.mass, v0=hits.speed, alpha=hits.alpha)
        if isinstance(model, CorrelatedBySize):
            # The table knows the size, for which the case alone has but a density to guess from.
            model = model.replace(particle_density=6 * hits.mass / (math.pi * hits.diameter**3))
        return model, p


_PPM = re.compile(r"\s*(\S+?)\s*ppm(?:w| by mass)?\s+of\s+(.+)")
# As pint reads them, a ton has 907 kg, and mt is a thousandth of a tonne.
_SOME_TON = re.compile(r"(?<![a-zA-Z_])(tons?|mt)(?![a-zA-Z])")
_SUCH_AS: Mapping[str, str] = {"mass flow": "100 kg/day", "mass": "2 g"}


def _read_sand_rate(rate: Any) -> float | None:
    """The mass of sand in a second [kg/s]: "100 kg/day", or by mass "50 ppm of 12 kg/s"."""
    of_flow = _PPM.fullmatch(rate) if isinstance(rate, str) else None
    if of_flow is None:
        return None if rate is None else _read("sand_rate", rate, "mass flow")
    with about("Argument `sand_rate`"):
        share = read_quantity(of_flow[1], "1") * 1e-6
        if not 0 < share <= 1:
            raise ValueError(f"must have a share above 0 and of at most 1e6 ppm, but is {briefly(rate)}")
    return share * _read("sand_rate", of_flow[2], "mass flow")


def _read(name: str, given: Any, dimension: Dimension) -> float:
    """A positive number in SI units, or text with a unit."""
    value = given
    if isinstance(given, str):
        with about(f"Argument `{name}`"):
            if not has_unit(given):
                raise ValueError(f"must have a unit, as {_SUCH_AS[dimension]!r} has, but is {briefly(given)}")
            if _SOME_TON.search(given):
                raise ValueError(f"must say which ton, t (1000 kg), short_ton or long_ton, but is {briefly(given)}")
            value = read_quantity(given, dimension)
    if not (_are_numbers(value) and 0 < value < np.inf):
        raise ValueError(f"Argument `{name}` must be positive and finite, but is {briefly(given)}.")
    return float(value)


def _are_numbers(*values: Any) -> bool:
    return all(isinstance(value, (int, float, np.number)) for value in values)
