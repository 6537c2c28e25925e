"""The problem of a fit: model, case, tests, what is free; and the erosion at values of that, with exact derivatives.

Positive parameters q are fitted as θ = log q, the spin φ̇₀ as θ = φ̇₀ r/v₀ (of the case): then
steps are of order 1 whatever the units, and nothing leaves its range. A model's own parameter that starts above
zero is fitted as its logarithm; any other is fitted in multiples of its size (`own_parameters.sizes`) and may change
its sign, unless it has a least value. A speed that has a least value is fitted in multiples of the greatest normal
speed of the data, whatever it starts from.
"""

import dataclasses
import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import as_pair, refuse
from erosion.fits.errors import ErrorModel
from erosion.fits.measurements import Measurements, read_measurements
from erosion.impacts import Impact, count_turned, impact
from erosion.laws import SHARE, JointLaw, refuse_laws
from erosion.models import (
    SPEED_EXPONENT,
    CuttingModel,
    SpeedExponent,
    equations_of,
    load_model,
    model_name,
    usable_models,
)
from erosion.models.base import (
    own_parameters,
    quantities,
    ranges,
    replaced,
    require_one_impact,
    sizes,
    values,
    with_values,
)
from erosion.models.correlated import Correlated, per_mass_of
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    InSI,
    Parameters,
    PerMass,
    Quantity,
    Tested,
    about,
    example,
    has_unit,
    in_si,
    read_quantity,
    validate,
)

FREE = "k", "psi"
"""The free parameters where none are named."""
USUAL_MODELS, USUAL_FREE = ("linearized", "linearized-deformation"), (*FREE, "energy_ratio")
"""What is fitted where neither models nor parameters are named: at steep angles metals wear by deformation."""
SCALE = "scale"
"""The free parameter of data in units of its own: measured erosion over the model's volume."""
FRACTION = "cutting_fraction"
"""The share of the particles that cut as the model says, by which its volume is multiplied (Finnie 1960)."""
NOISE, RELATIVE = "noise", "relative_noise"
"""The absolute and the relative part of a row's standard deviation, parameters where the data give no uncertainties."""
ERROR_FACTOR = "error_factor"
"""By which all uncertainties are multiplied, a parameter if it has a prior."""
OF_ERROR = (NOISE, RELATIVE, ERROR_FACTOR)
OF_METAL = ("k", "psi", "sigma", "phidot0", "inertia", FRACTION)
"""The parameters of tests that hold for other tests, too: the particle and the jet are given."""
FACTORS: Mapping[str, Quantity] = {
    FRACTION: Quantity("c", "share of the particles that cut", "1"),
    SCALE: Quantity("s", "measured over computed volume", "1"),
}
"""Symbols of the free parameters that no impact has."""


@dataclasses.dataclass(frozen=True)
class FitProblem:
    """A model, tests, and what of the model they are to tell: `calibrate` and `posterior` answer it.

        problem = erosion.FitProblem("rotating", p, "tests.csv", ["k", "psi"], error="5 %")
        fit, drawn = erosion.calibrate(problem), erosion.posterior(problem)

    Args:
        model: a model, its name, or the path of its file; the first guess of its own parameters.
        p: the case: the first guess of the free parameters, and the values of all others.
        data: a CSV file, columns by header, or `Measurements`; see `read_measurements`.
        free: the parameters to fit, of the case or the model's own: ["k", "psi"]; or "cutting_fraction".
        bounds: (least, greatest) of free parameters, read as `p.replace` reads numbers: in SI, or texts with units;
            beside a case in inch-pound units texts alone, ("100 MPa", "2 GPa"). Between them `posterior` takes all
            factors of a parameter for alike that is fitted as its logarithm, such as k and ψ (`loguniform`), and all
            values of any other (`uniform`). See `calibrate` for parameters without bounds.
        priors: for `posterior`, by parameter, also "noise", "relative_noise", "scale", and for uncertainties that may
            be too small "error_factor", on all of them: a law (`erosion.laws`), in SI. Beside a case in inch-pound
            units, whose numbers they may be, laws of speeds, sizes and stresses are refused: give `p.to("si")`.
            `calibrate`, whose likelihood they do not change, leaves them aside.
        density: of the target, a number [kg/m³] or "2.7 g/cm^3"; needed
            for data of mass loss, but not by a correlation, whose own density counts.
        cutting_fraction: the share of the particles that cut as the model says, in (0, 1]:
            volumes are multiplied by it. The first guess where it is free.
        error: of a row, where the data have no column of it: "0.3 mg/kg + 8 %", and of each speed, "5 % of each
            speed", beside the rows' own; see `read_measurements`.
        per: what removes the amounts of a table: "impact", or the mass of abrasive of each row, such as "100 g".
        digest: of what the model computes; as its code is now, where it is not given.

    Raises:
        ValueError, TypeError: for arguments or data that cannot be used (data: `MeasurementError`).

    References:
        The cutting fraction: I. Finnie, Erosion of surfaces by solid particles, Wear 3 (1960)
        87-103: about half of the particles cut in the idealized manner.
    """

    model: CuttingModel
    p: Parameters
    data: Measurements
    free: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    priors: Mapping[str, Any]
    density: float | None
    cutting_fraction: float
    digest: str

    def __init__(
        self,
        model: CuttingModel | str | Path,
        p: Parameters,
        data: Any,
        free: Sequence[str] = FREE,
        *,
        bounds: Mapping[str, Sequence[float | str]] | None = None,
        priors: Mapping[str, Any] | None = None,
        density: float | str | None = None,
        cutting_fraction: float = 1.0,
        error: ErrorModel | float | str | None = None,
        per: str | None = None,
        digest: str = "",
    ) -> None:
        model = load_model(model)
        validate(p)
        require_one_impact(model, p)
        measured = read_measurements(data, p.shown_in, error=error, per=per)
        if not np.any(measured.erosion):
            raise ValueError("Argument `data` must have erosion other than zero.")
        share = PerMass(cutting_fraction=cutting_fraction).cutting_fraction
        names = check_free(free, measured, model)
        known = {**quantities(model), **FACTORS, NOISE: measured.quantity}
        refuse_laws(priors or {}, known, p.shown_in)
        fields = {
            "model": model,
            "p": p,
            "data": dataclasses.replace(measured, common=None),  # that of another fit
            "free": names,
            "bounds": {},
            "priors": InSI(priors or {}),
            "density": _density(model, density, measured),
            "cutting_fraction": share,
            "digest": digest or equations_of(model).digest,
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        for name in self.priors:
            if name not in (sampled := (*self.names, *self.of_error)):
                raise ValueError(
                    f"Argument `priors` must name free parameters ({', '.join(sampled)}), but has {briefly(name)}."
                )
        self.joint_law(self.priors)  # refuses laws beyond the ranges
        object.__setattr__(self, "bounds", self._checked(bounds))

    def _checked(self, bounds: Mapping[str, Sequence[float | str]] | None) -> InSI:
        """Bounds [SI] of free parameters within their ranges."""
        if not isinstance(bounds, Mapping | None):
            raise TypeError(
                f"Argument `bounds` must be a dictionary, such as {{'psi': (0.01, 10)}}, but is {briefly(bounds)}."
            )
        signed = [name for name, log in zip(self.names, self.logarithmic, strict=True) if not log]
        least = {name: parameter.least for name, parameter in own_parameters(self.model).items()}
        checked = InSI()
        for name in bounds or {}:
            if name not in self.names:
                raise ValueError(f"Argument `bounds` must name free parameters, but has {briefly(name)}.")
        for name, pair in in_si(bounds, quantities(self.model), self.p.shown_in).items():
            low, high = as_pair(pair)
            below = low >= least.get(name, -np.inf) if name in signed else low > 0
            refuse(
                "Argument `bounds` must ",
                (name in self.priors, f"not name {name}, which has a prior."),
                (not (low < high and below and (name != FRACTION or high <= 1)),
                 f"give {name} two ascending values in its range, but has {briefly(pair)}."),
            )  # fmt: skip
            checked[name] = (low, high)
        return checked

    @classmethod
    def of_models(
        cls,
        models: Sequence[CuttingModel | str | Path] | None,
        p: Parameters,
        data: Any,
        free: Sequence[str] = FREE,
        *,
        bounds: Mapping[str, Sequence[float | str]] | None = None,
        priors: Mapping[str, Any] | None = None,
        error: ErrorModel | float | str | None = None,
        per: str | None = None,
        **options: Any,
    ) -> "list[FitProblem]":
        """Return a problem for each model, with those of the free parameters, bounds and priors that it has.

        Args:
            models: models, names or paths; None for every registered model.
            p: the case.
            data: the tests.
            free: in each model those that it has.
            bounds: the same.
            priors: the same.
            error: of rows.
            per: what removes amounts.
            **options: `density` and `cutting_fraction`; see the class for all.

        Raises:
            ValueError: for no model, one that is named twice, a parameter that none has, and a model that has none.
        """
        measured, problems = read_measurements(data, p.shown_in, error=error, per=per), []
        for model, own in _with_free(models, free):
            # Limits of what no model has are refused.
            limits = [type(given)({name: limit for name, limit in given.items() if name in own or name not in free})
                      for given in map(_dictionary, (bounds, priors))]  # fmt: skip
            problems.append(cls(model, p, measured, own, bounds=limits[0], priors=limits[1], **options))
        return problems

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters, and the scale where that is free too."""
        return (*self.free, SCALE) if self.data.free_scale else self.free

    @property
    def of_error(self) -> tuple[str, ...]:
        """The parameters of the rows' error, which `posterior` may sample."""
        return (NOISE, RELATIVE) if self.data.uncertainty is None else (ERROR_FACTOR,)

    def joint_law(self, laws: Mapping[str, Any]) -> JointLaw:
        """The laws of parameters before the data, within the ranges of these."""
        positive = dict.fromkeys((SCALE, *self.of_error), (0.0, np.inf))
        within = {**ranges(self.model), FRACTION: SHARE, **positive}
        return JointLaw(laws, argument="`priors` of `{}`").within(within)

    @property
    def of_impact(self) -> tuple[str, ...]:
        """The free parameters of an impact, which are all but factors on its volume."""
        return tuple(name for name in self.free if name != FRACTION)

    @property
    def logarithmic(self) -> np.ndarray:
        """Whether each θ is a logarithm, shape (names,)."""
        return np.array([name not in self._units for name in self.names])

    @property
    def limits(self) -> np.ndarray:
        """θ at the least and the greatest value that each parameter may have by its meaning, shape (names, 2)."""
        own, fraction = own_parameters(self.model), {FRACTION: (-np.inf, 0.0)}
        thresholds = {name: own[name].least / unit for name, unit in self._units.items() if name in own}
        signed = {name: (least, 1.0 if name in self._normal_speeds else np.inf) for name, least in thresholds.items()}
        return np.array([(fraction | signed).get(name, (-np.inf, np.inf)) for name in self.names])

    @property
    def start(self) -> np.ndarray:
        """θ of the case, shape (names,); 0 for the scale."""
        of_case = {**values(self.model, self.p), FRACTION: self.cutting_fraction, SCALE: 1.0}
        return self.theta({name: float(of_case[name]) for name in self.names})

    @property
    def tested(self) -> Tested:
        """The ranges of the rows; speed and mass are the case's where the rows have none, and left out where fitted."""
        values = {name: getattr(self.p, name) for name in ("v0", "m") if name not in self.names} | self.data.conditions
        return Tested.of(values)

    @property
    def own_stresses(self) -> np.ndarray:
        """Whether each free parameter is a stress of the model that is fitted as a logarithm, shape (names,)."""
        own = own_parameters(self.model)
        return np.array([name in own and name not in self._units and own[name].quantity.dimension == "stress"
                         for name in self.names])  # fmt: skip

    @property
    def contact_stress(self) -> float:
        """σψ of the case [Pa]."""
        return float(self.p.sigma * self.p.psi)

    def theta(self, values: Mapping[str, float]) -> np.ndarray:
        """θ of parameter values."""
        return np.array([self.to_theta(name, values[name]) for name in self.names])

    def to_theta(self, name: str, value: float) -> float:
        """One parameter's θ."""
        return value / self._units[name] if name in self._units else float(np.log(value))

    def values(self, theta: np.ndarray) -> dict[str, float]:
        """The parameters at θ, by name."""
        return {name: float(self.from_theta(name, part)) for name, part in zip(self.names, theta, strict=True)}

    def from_theta(self, name: str, theta: Any) -> Any:
        """The values of one parameter, of the shape of `theta`."""
        return theta * self._units[name] if name in self._units else np.exp(theta)

    def slopes(self, theta: np.ndarray) -> np.ndarray:
        """dq/dθ, shape (names,)."""
        values = self.values(theta)
        return np.array([self._units.get(name, values[name]) for name in self.names])

    def at(self, theta: np.ndarray) -> tuple[CuttingModel, Parameters]:
        """Model and case with the free parameters at θ."""
        values = self.values(theta)
        return with_values(self.model, self.p, {name: values[name] for name in self.of_impact})

    def conditions(self, alpha: Any, at: Mapping[str, Any] | None, usual: Mapping[str, Any] | None = None) -> InSI:
        """The conditions of a question, as arrays of one shape.

        Args:
            alpha: α [rad], or texts with units.
            at: other parameters of the case, by name, read as `p.replace` reads them.
            usual: those that count where `at` has none [SI].

        Raises:
            ValueError, TypeError: for fitted or unknown parameters, and for values that they cannot have.
        """
        others = {} if at is None else at
        if not isinstance(others, Mapping) or "alpha" in others:
            raise ValueError(
                f"Argument `at` must be such as {{'v0': '60 m/s'}}, without `alpha`, but is {briefly(at)}."
            )
        for name in others:
            if name not in QUANTITIES or name in self.free:
                raise ValueError(
                    f"Argument `at` must name parameters of the case that are known, but has {briefly(name)}."
                )
        asked = in_si({"alpha": alpha}, QUANTITIES, "si"), usual or {}, in_si(others, QUANTITIES, self.p.shown_in)
        given = dict(itertools.chain.from_iterable(values.items() for values in asked))
        p = dataclasses.replace(self.p, **given)
        validate(p)
        columns = np.broadcast_arrays(*(np.asarray(getattr(p, name)) for name in given))
        if not columns[0].size:
            raise ValueError("Argument `alpha` must hold at least one angle, but holds none.")
        return InSI(zip(given, columns, strict=True))

    def count_turned(self, values: Mapping[str, Any], conditions: Mapping[str, Any]) -> np.ndarray:
        """In how many impacts the body turns by more than 90°, and of how many; shape (2,).

        Args:
            values: of each of `names`, scalars or of shape (points, 1).
            conditions: as for `predict`.
        """
        model, p = with_values(self.model, self.p, {name: values[name] for name in self.of_impact})
        return count_turned(model, dataclasses.replace(p, **conditions))

    def predict(self, theta: np.ndarray, conditions: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The erosion at θ and its derivatives.

        Args:
            theta: shape (names,).
            conditions: parameters that vary from row to row, each of shape (rows,).

        Returns:
            Erosion, shape (rows,), and ∂/∂θ, shape (rows, names); NaN where an impact failed.
        """
        hits, factor = self._impacts(self.values(theta), conditions, derivatives=1 if self.of_impact else 0)
        erosion = hits.volume * factor
        slopes = dict(zip(self.names, self.slopes(theta), strict=True))
        # Erosion is proportional to its factors, whose θ are logarithms.
        rates: dict[str, Any] = dict.fromkeys(self.names, erosion)
        rates |= {name: hits.dvolume[:, i] * slopes[name] * factor for i, name in enumerate(self.of_impact)}
        if self.data.per_mass and "m" in rates:
            rates["m"] = rates["m"] - erosion
        return erosion, np.stack(list(rates.values()), axis=-1)

    def predict_many(self, thetas: np.ndarray, conditions: Mapping[str, np.ndarray]) -> np.ndarray:
        """The erosion at several θ, in one batch.

        Args:
            thetas: shape (points, names).
            conditions: as for `predict`.

        Returns:
            Erosion, shape (points, rows); NaN where an impact failed.
        """
        columns = zip(self.names, thetas.T, strict=True)
        return self.erosion({name: self.from_theta(name, column) for name, column in columns}, conditions)

    def erosion(
        self, values: Mapping[str, np.ndarray], conditions: Mapping[str, np.ndarray], rtol: float = 1e-9
    ) -> np.ndarray:
        """The erosion at several values of the parameters, in one batch.

        Args:
            values: of each of `names`, shape (points,).
            conditions: as for `predict`.
            rtol: see `impact`.

        Returns:
            Erosion, shape (points, rows); NaN where an impact failed.
        """
        columns = {name: column[:, None] for name, column in values.items()}
        hits, factor = self._impacts(columns, conditions, derivatives=0, rtol=rtol)
        return np.broadcast_to(hits.volume * factor, (len(next(iter(values.values()))), len(conditions["alpha"])))

    def _impacts(
        self, values: Mapping[str, Any], conditions: Mapping[str, Any], derivatives: int, rtol: float = 1e-9
    ) -> tuple[Impact, Any]:
        """The impacts at parameter values, and the factor from volume to the erosion that was measured."""
        if equations_of(self.model).digest != self.digest:
            raise ValueError(
                "The fit needs the model as it was fitted, but its code computes something else since; fit it again."
            )
        model, p = with_values(self.model, self.p, {name: values[name] for name in self.of_impact})
        p = dataclasses.replace(p, **conditions)
        along: dict[str, Any] = {"derivatives": derivatives, "wrt": self.of_impact} if derivatives else {}
        hits = impact(model, p, rtol=rtol, **along)
        factor = values.get(FRACTION, self.cutting_fraction)
        if self.data.needs_density and self.density is not None:
            factor = factor * self.density
        if self.data.per_mass:
            factor = factor / np.asarray(p.m)
        if self.data.free_scale:
            factor = factor * values[SCALE]
        return hits, factor

    @property
    def held_exponent(self) -> float | None:
        """The exponent of the speed over which volumes grow in the model; 2 without one, None if it is free."""
        if not isinstance(self.model, SpeedExponent):
            return 2.0
        return None if SPEED_EXPONENT in self.free else float(self.model.speed_exponent)

    @property
    def own_thresholds(self) -> tuple[str, ...]:
        """The own parameters of the model that are speeds with a least value, free or not."""
        own = own_parameters(self.model).items()
        return tuple(name for name, parameter in own
                     if parameter.quantity.dimension == "speed" and np.isfinite(parameter.least))  # fmt: skip

    @functools.cached_property
    def _units(self) -> dict[str, float]:
        """Size of the parameters that are not fitted as logarithms: their value at θ = 1."""
        size, own = sizes(self.model, self.p), own_parameters(self.model)
        signed = [name for name in self.free if name in own and float(own[name].value) <= 0]
        return {name: float(size[name]) for name in ("phidot0", *signed)} | self._normal_speeds

    @functools.cached_property
    def _normal_speeds(self) -> dict[str, float]:
        """The greatest normal speed of the data, by free own parameter that is a speed with a least value."""
        rows = self.data.conditions
        greatest = float(np.max(rows.get("v0", self.p.v0) * np.sin(rows["alpha"])))
        return {name: greatest for name in self.own_thresholds if name in self.free}


def check_free(free: Sequence[str], data: Measurements, model: CuttingModel) -> tuple[str, ...]:
    """The names of the parameters to fit.

    Raises:
        ValueError: for a name that is no parameter, or one that the data fixes.
        TypeError: for an own parameter of a field that is not declared as a number.
    """
    if not isinstance(free, Sequence):
        raise TypeError(f"Argument `free` must be a list of parameters, but is {briefly(free)}.")
    names = (free,) if isinstance(free, str) else tuple(free)
    known = quantities(model)
    for name in names:
        refuse(
            "Argument `free` must ",
            (not isinstance(name, str) or name not in (*known, FRACTION),
             f"name parameters ({', '.join((*known, FRACTION))}), but has {briefly(name)}."),
            (name == SCALE, f"not name `{SCALE}`, as the factor of data in units of its own is."),
            (name == FRACTION and name in known, f"not name `{FRACTION}`, as the share of particles that cut is."),
            (name in ("alpha", *data.conditions), f"not name `{name}`: the data has a column of it."),
        )  # fmt: skip
    if not names or len(set(names)) != len(names):
        raise ValueError(f"Argument `free` must name one or several different parameters, but is {briefly(free)}.")
    # So that an own parameter that cannot be an array is refused before anything is computed.
    replaced(model, {name: np.zeros(1) for name in names if name not in (*QUANTITIES, FRACTION)})
    return names


def _with_free(
    models: Sequence[CuttingModel | str | Path] | None, free: Sequence[str]
) -> list[tuple[CuttingModel, Sequence[str]]]:
    """Models, all registered ones without names, each with those of the free parameters that it has.

    Raises:
        ValueError: for no model, one that is named twice, a parameter that none has, and a model that has none of them.
    """
    wanted = usable_models() if models is None else list(models)
    named = [str(model) for model in wanted if isinstance(model, (str, Path))]
    if not wanted or len(set(named)) != len(named):
        raise ValueError(f"Argument `models` must name one or several different models, but is {wanted}.")
    loaded = [load_model(source) for source in wanted]
    if len(loaded) == 1 or isinstance(free, str) or not isinstance(free, Sequence):
        return [(model, free) for model in loaded]
    known = [{*quantities(model), FRACTION} for model in loaded]
    for name in free:
        if not any(name in has for has in known):
            listed = ", ".join(map(model_name, loaded))
            raise ValueError(f"Argument `free` must name parameters of the models, but {name!r} is none of {listed}.")
    of_each = [(model, [name for name in free if name in has]) for model, has in zip(loaded, known, strict=True)]
    for model, own_free in of_each:
        if free and not own_free:
            none = f"{model_name(model)} has no {free[0]!r}"
            raise ValueError(f"Argument `free` must name a parameter of each model, but {none}.")
    return [*of_each]


def _dictionary(given: Mapping[str, Any] | None) -> dict[str, Any]:
    """The same as a dictionary; an `InSI` stays one."""
    return given if isinstance(given, dict) else dict(given or {})


def _density(model: CuttingModel, density: float | str | None, data: Measurements) -> float | None:
    """That of the target [kg/m³]; a correlation has its own, by which it makes volumes of masses."""
    if not isinstance(model, Correlated):
        return _given_density(density, data)
    return per_mass_of(model, PerMass(None if density is None else _given_density(density, data))).density


def _given_density(density: float | str | None, data: Measurements) -> float | None:
    if density is None:
        if data.needs_density:
            raise ValueError(
                "Argument `density` of the target must be given, as the data has mass losses: a model removes volume."
            )
        return None
    if isinstance(density, str):
        if not has_unit(density):
            such_as = example("density", data.shown_in)
            raise ValueError(f"Argument `density` must carry its unit, such as {such_as}, but is {briefly(density)}.")
        with about("Argument `density`"):
            density = read_quantity(density, "density")
    if not isinstance(density, (int, float, np.number)) or not (np.isfinite(density) and density > 0):
        raise ValueError(f"Argument `density` must be positive and finite, but is {briefly(density)}.")
    return float(density)
