"""A case's particle as a CFD code knows it: tables over angle, speed and diameter, and how it rebounds."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from erosion.arguments import Broadcast, check_unmasked
from erosion.impacts import OTHER_ENDS, SimulationError, end_names, impact, model_in_words, provenance
from erosion.models import load_model, model_name, own_in_words, require_one_impact
from erosion.models.base import ZERO, CuttingModel, State
from erosion.models.correlated import Correlated, per_mass_of
from erosion.ode.step_control import require_float64
from erosion.output import briefly, tables
from erosion.parameters import (
    QUANTITIES,
    RESULTS,
    Parameters,
    PerMass,
    are_angles,
    ascii_unit,
    si_numbers,
    unit_name,
    validate,
)
from erosion.results import Finding
from erosion.version import __version__

_RTOL = 1e-12
_KNOWN = {**QUANTITIES, **RESULTS}


class ExportError(ValueError):
    """A model that the form of a CFD code cannot hold; the message says what it would lose."""


@dataclasses.dataclass(frozen=True)
class ExportedParticle:
    """The particle of a case and its scaled copies; all numbers are in SI.

    A copy of another diameter is a similar body: r and b grow with the diameter, m with its third power, as in
    `erosion.stream`. All copies have the spin of the case.

    Args:
        model, p: of the impacts.
        diameter: of the case's particle in the CFD code [m].
        cutting_fraction: share of the impacts that cut.
    """

    model: CuttingModel
    p: Parameters
    diameter: float
    cutting_fraction: float = 1.0

    @property
    def speed(self) -> float:
        """v₀ of the case [m/s]."""
        return float(self.p.v0)

    @property
    def density(self) -> float:
        """Of a sphere of the case's mass and this diameter [kg/m³]."""
        return float(6 * self.p.m / (np.pi * self.diameter**3))

    def volume(self, alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        """The mean volume that an impact removes [m³], of the broadcast shape.

        Raises:
            SimulationError: where an impact fails.
        """
        with np.errstate(over="ignore"):  # such an impact fails
            copies = self.p.similar(d / self.diameter)
        hits = impact(self.model, dataclasses.replace(copies, alpha=alpha, v0=v0), rtol=_RTOL)
        volume = np.asarray(hits.volume)
        if not np.isfinite(volume).all():
            lost = np.count_nonzero(~np.isfinite(volume))
            name = model_name(self.model)
            raise SimulationError(f"{name}: {lost:,} of {volume.size:,} impacts could not be computed.")
        return np.asarray(self.cutting_fraction * volume)

    def erosion(self, alpha: Broadcast, v0: Broadcast, d: Broadcast) -> np.ndarray:
        """The volume removed per mass of particles [m³/kg], of the broadcast shape."""
        mass = self.p.m * (d / self.diameter) ** 3
        return np.asarray(self.volume(alpha, v0, d) / mass)

    def origin(self) -> str:
        """Lines on what an exported file comes from: model, case, and the particle's diameter."""
        own = own_in_words(self.model, system="si")
        units = {name: quantity.unit("si") for name, quantity in QUANTITIES.items() if name != "alpha"}
        numbers = {name: f"{float(getattr(self.p, name)):.6g}" for name in units}
        case = ", ".join(f"{name} = {numbers[name]}{'' if unit == '1' else f' {unit}'}" for name, unit in units.items())
        return (
            f"erosion {__version__}: {model_name(self.model)}{f' ({own})' if own else ''}\n{case}\n"
            f"The case's particle has the diameter {self.diameter:.6g} m and the density {self.density:.6g} kg/m^3."
            + ("" if self.cutting_fraction == 1 else f"\n{share_in_words(self.cutting_fraction)}")
        )


def share_in_words(cutting_fraction: float) -> str:
    """The line of an exported file on the share of the particles that cut."""
    return f"The cutting fraction {cutting_fraction:.4g} is part of what is written here."


def particle_of(
    model: CuttingModel | str | Path,
    p: Parameters,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
) -> ExportedParticle:
    """The particle of a case.

    Args:
        model: a model, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        particle_density: of the particles in the CFD code [kg/m³]; their diameter
            is that of a sphere of the case's mass. Without it the diameter is 2 r.
        cutting_fraction: the share of the particles that cut; it does not apply to correlations.

    Raises:
        ValueError: for parameters that are arrays or out of range.
    """
    model = load_model(model)
    require_one_impact(model, p)
    validate(p)
    share = per_mass_of(model, PerMass(cutting_fraction=cutting_fraction)).cutting_fraction
    if particle_density is None:
        return ExportedParticle(model, p, 2 * float(p.r), share)
    density = checked("particle_density", particle_density)
    if density.size != 1:
        raise ValueError(f"Argument `particle_density` must be a scalar, but has shape {density.shape}.")
    volume = float(p.m) / float(density[0])
    return ExportedParticle(model, p, float(np.cbrt(6 * volume / np.pi)), share)


def asked(name: str, values: Any, p: Parameters, own: Any) -> np.ndarray:
    """Speeds ("v0") or diameters ("d") that are given as `p.replace` takes them, in SI; `own` without them.

    Raises:
        ValueError: where one is not positive and finite, or there is none.
    """
    if values is None:
        return np.atleast_1d(np.asarray(own, float))
    return checked(name, si_numbers(name, values, _KNOWN[name], p.shown_in))


def checked(name: str, values: Any) -> np.ndarray:
    """Angles of attack ("alpha") [rad], or other, positive numbers; shape (n,), ascending and each once.

    Raises:
        ValueError: naming the argument, where one is out of range, or there is none.
    """
    check_unmasked(name, values)
    try:
        numbers = np.atleast_1d(np.asarray(values, float))
    except (TypeError, ValueError):
        raise ValueError(f"Argument `{name}` must be numbers, but is {briefly(values)}.") from None
    if numbers.ndim != 1 or not numbers.size:
        raise ValueError(f"Argument `{name}` must be a number or a list of them, but has shape {numbers.shape}.")
    is_angle = name == "alpha"
    good = are_angles(numbers) if is_angle else (numbers > 0) & np.isfinite(numbers)
    if not good.all():
        bad = float(numbers[~good][0])
        condition, shown = ("in (0, 90°]", f"{np.rad2deg(bad):g}°") if is_angle else ("positive and finite", f"{bad:g}")
        raise ValueError(f"Argument `{name}` must be {condition}, but has {shown}.")
    return np.unique(numbers)


def commented(text: str, mark: str) -> str:
    """The lines of a text, each behind a mark of comments."""
    return "".join(f"{mark} {line}\n" for line in text.splitlines())


SHARES = np.linspace(0.5, 2, 7)  # of the case's speed and diameter: from half to twice
TABLE_ANGLES = np.deg2rad(np.arange(2.5, 91, 2.5))
_MOST_ROWS = 1_000_000
_HEADINGS = {"alpha": "angle", "v0": "speed", "d": "diameter"}


def volume_table(
    model: CuttingModel | str | Path,
    p: Parameters,
    *,
    alpha: Any = None,
    v0: Any = None,
    d: Any = None,
    particle_density: float | None = None,
    cutting_fraction: float = 1.0,
) -> xr.Dataset:
    """The volume that an impact removes over diameter, speed and angle, for a table in a CFD code.

        table = erosion.volume_table("rotating", p, v0="20 m/s : 200 m/s : 19")
        table.volume.interp(alpha=0.4, v0=55.0)

    Particles of another diameter are similar bodies: r and b grow with d, m with its third power; the spin is the
    case's.

    Args:
        model: a model, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every 2.5° without it.
        v0: speeds, shape (n,) [m/s], or texts with units; seven from half to twice the case's without it.
        d: diameters, shape (n,) [m], or texts with units; seven from half to twice the case's without it.
        particle_density: of the particles in the code [kg/m³]; without it the case's particle has the diameter 2 r.
        cutting_fraction: the share of the particles that cut; volumes are then the mean over all particles.

    Returns:
        `volume` [m³] over (d, v0, alpha).

    Raises:
        SimulationError: where impacts fail.
        ValueError: for parameters that are arrays or out of range, and for more than a million rows.
    """
    particle = particle_of(model, p, particle_density, cutting_fraction)
    alpha = TABLE_ANGLES if alpha is None else checked("alpha", alpha)
    speeds = asked("v0", v0, p, SHARES * particle.speed)
    diameters = asked("d", d, p, SHARES * particle.diameter)
    require_rows(alpha.size * speeds.size * diameters.size)
    volume = particle.volume(alpha, speeds[:, None], diameters[:, None, None])
    axes = {"d": diameters, "v0": speeds, "alpha": alpha}
    return labelled(particle, p, "removed volumes", axes, {"volume": volume})


def require_rows(rows: int) -> None:
    """Refuse a table that no code would read, and no memory hold."""
    if rows > _MOST_ROWS:
        raise ValueError(
            f"Argument `alpha` must make, with the others, at most {_MOST_ROWS:,} rows, but makes {rows:,}."
        )


def labelled(
    particle: ExportedParticle, p: Parameters, content: str, axes: dict[str, np.ndarray], arrays: dict[str, np.ndarray]
) -> xr.Dataset:
    """Arrays over axes as a Dataset, with units and provenance.

    Args:
        particle: model and case.
        p: the case as it was given.
        content: for the title.
        axes: values by name, in the order of the dimensions.
        arrays: by name, each over all axes.
    """
    attributes = provenance(content, p, **model_in_words(particle.model)) | {"particle_diameter": particle.diameter}
    variables = {name: (name if name in axes else tuple(axes), values, _KNOWN[name].attributes())
                 for name, values in {**axes, **arrays}.items()}  # fmt: skip
    frame = xr.Dataset(coords={name: variables[name] for name in axes}, attrs=attributes)
    return frame.assign({name: variables[name] for name in arrays})


def to_csv(dataset: xr.Dataset) -> str:
    """A Dataset of `labelled` as CSV: a row for each point, SI units, angles in degrees.

    "volume [m^3]" and the like are in the first row. The last axis varies fastest.
    """
    columns, shape = {}, dataset[next(iter(dataset.data_vars))]
    for name in map(str, (*dataset.dims, *dataset.data_vars)):
        values, heading = dataset[name].broadcast_like(shape).transpose(*dataset.dims).values, _HEADINGS.get(name, name)
        if "flag_meanings" in dataset[name].attrs:
            words = dataset[name].attrs["flag_meanings"].split()
            columns[heading] = [words[int(code)] for code in values.ravel()]
            continue
        dimension = _KNOWN[name].dimension
        unit = ascii_unit(unit_name(dimension, "si"))
        factor = 1.0
        if dimension == "angle":
            unit, factor = "deg", 180 / np.pi
        head = f"{heading} [{'-' if unit == '1' else unit}]"
        columns[head] = [f"{number:.10g}" for number in values.ravel() * factor]
    return tables.to_csv(columns)


def to_comsol(dataset: xr.Dataset) -> str:
    """The same in COMSOL's spreadsheet format, which its interpolation functions read: arguments, then the value.

    References:
        COMSOL Multiphysics 6.1, Reference Manual, Spreadsheet Data Format: columns between spaces, % before comments.
    """
    head, *rows = to_csv(dataset).splitlines()
    return "\n".join([f"% {head}", *(row.replace(",", " ") for row in rows), ""])


ANGLES = np.deg2rad(np.arange(0.5, 90.25, 0.25))
NEAR, FAR = 0.02, 0.15
"""Misfits of a form over the maximum of a curve: above the first it is said, above the last refused."""

_HALF_TO_TWICE = np.geomspace(0.5, 2, 9)

_Erosion = Callable[[Broadcast, Broadcast, Broadcast], np.ndarray]
"""Of angle [rad], speed [m/s] and diameter [m]: the volume removed per mass of particles [m³/kg]."""


class Reach(NamedTuple):
    """Speeds [m/s] and diameters [m], ascending; `asked` where a form must hold over all of them."""

    speeds: np.ndarray
    diameters: np.ndarray
    asked: bool

    @classmethod
    def of(cls, particle: ExportedParticle, p: Parameters, v0: Any = None, d: Any = None) -> "Reach":
        """The speeds and diameters, as `p.replace` takes numbers; by default from half to twice the particle's own.

        Raises:
            ValueError: for a speed or a diameter that is not positive.
        """
        if v0 is d is None:
            return cls(_HALF_TO_TWICE * particle.speed, _HALF_TO_TWICE * particle.diameter, asked=False)
        return cls(asked("v0", v0, p, particle.speed), asked("d", d, p, particle.diameter), asked=True)


def more_than_own(values: np.ndarray, own: float) -> np.ndarray:
    """The speeds or diameters to which a form is fitted: from half to twice the case's where no others are given."""
    return _HALF_TO_TWICE * own if np.allclose(values, own, rtol=1e-9, atol=0) else values


@dataclasses.dataclass(frozen=True)
class Losses:
    """How far a form is off at other speeds and diameters, over the curve's greatest value there.

    Args:
        reach: the speeds and diameters.
        misfit: greatest difference over all angles, shape (diameters, speeds) [-].
        speed, diameter: of the case [m/s], [m].
    """

    reach: Reach
    misfit: np.ndarray
    speed: float
    diameter: float

    @property
    def worst(self) -> float:
        """The greatest misfit."""
        return float(self.misfit.max())

    def finding(self, code: str = "") -> Finding:
        """The same for a reader, about the form of a CFD code."""
        speeds, diameters, asked = self.reach
        if asked:
            over = f"{_range(speeds)} m/s" + (f" and {_range(1e6 * diameters)} um" if diameters.size > 1 else "")
            return Finding("form_off_over_range", code, {"range": over, "worst": self.worst})
        own_speed, own_size = np.argmin(np.abs(speeds - self.speed)), np.argmin(np.abs(diameters - self.diameter))
        numbers = {
            "speed": self.speed,
            "at_speeds": self.misfit[own_size, [0, -1]].max(),
            "at_diameters": self.misfit[[0, -1], own_speed].max(),
        }
        return Finding("form_off", code, numbers)


def own_curve(particle: ExportedParticle) -> np.ndarray:
    """The volume removed per mass of particles at `ANGLES`, the case's speed and diameter [m³/kg].

    Raises:
        ExportError: where nothing is removed.
    """
    erosion = particle.erosion(ANGLES, particle.speed, particle.diameter)
    if erosion.max() <= 0:
        raise ExportError(f"{model_name(particle.model)} removes nothing at any angle: it has no curve to export.")
    return erosion


def losses(code: str, form: _Erosion, particle: ExportedParticle, reach: Reach) -> Losses:
    """Losses of a form.

    Args:
        code: its name, for messages.
        form: what the code computes.
        particle: what the model computes.
        reach: over which speeds and diameters.

    Raises:
        ExportError: where the form is asked to hold and is off by more than 15 % of the maximum.
    """
    speeds, diameters = reach.speeds[:, None], reach.diameters[:, None, None]
    erosion, formed = particle.erosion(ANGLES, speeds, diameters), form(ANGLES, speeds, diameters)
    greatest = erosion.max(axis=-1)
    # Where the model removes nothing, all that the form removes is lost.
    size = np.where(greatest > 0, greatest, np.maximum(formed.max(axis=-1), np.finfo(float).tiny))
    misfit = np.abs(formed - erosion).max(axis=-1) / size
    lost = Losses(reach, misfit, particle.speed, particle.diameter)
    if reach.asked and lost.worst > FAR:
        at = np.unravel_index(np.argmax(misfit), misfit.shape)
        raise ExportError(
            f"The form of {code} is made at {particle.speed:.4g} m/s, and at {reach.speeds[at[1]]:.4g} m/s and "
            f"{1e6 * reach.diameters[at[0]]:.4g} µm it is off by up to {misfit[at]:.1%} of the maximum; give a "
            "narrower range, or use a table of volumes over angle, speed and diameter (--table)."
        )
    return lost


def _range(values: np.ndarray) -> str:
    first, last = f"{values[0]:.4g}", f"{values[-1]:.4g}"
    return first if len(values) == 1 else f"{first} to {last}"


_REBOUND_ANGLES = np.deg2rad(np.arange(2.5, 89, 2.5))  # at 90° nothing is cut, and there is no rebound to follow


def restitution(model: CuttingModel | str | Path, p: Parameters, *, alpha: Any = None, v0: Any = None) -> xr.Dataset:
    """Coefficients of restitution and the spin after the impact, over speed and angle.

        table = erosion.restitution("rotating", p)
        table.e_n.sel(v0=p.v0, method="nearest").plot()

    All velocities are those of the centre of mass, which is what a CFD code moves; the tip moves otherwise where the
    body turns. They are taken when the cut ends:

    - **rebound**: the tip has left the target. e_n = -ẏ/(v₀ sin α), e_t = ẋ/(v₀ cos α).
    - **stop** (and an event of a plug-in): the tip no longer moves along the surface, but is still within the target,
      and the model follows it no further. e_t is that of this moment.

    Where the centre of mass still moves into the target when the cut ends, the target takes what is left of the
    normal motion, as it is plastic: e_n = 0. `vx` and `vy` hold the velocities of the end itself.

    - **no-cut**: the model has no rebound without a cut: all are NaN. So are they where an impact fails.

    The losses of the normal motion are the model's: a force that follows the depth, as all built-in ones do, gives
    back what it took, so that a body that does not turn rebounds with e_n = 1.

    Args:
        model: a model of a rigid body, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every 2.5° below 90° without it.
        v0: speeds, shape (n,) [m/s], or texts with units; seven from half to twice the case's without it.

    Returns:
        Over (v0, alpha): `e_n`, `e_t` [-], `spin` φ̇ after the impact [rad/s] (positive
        moves the tip forward), `vx`, `vy` [m/s], and `ended_by` (codes, see its attributes). e_t is NaN at 90°,
        where there is no tangential velocity before the impact.

    Raises:
        ExportError: for a model without the motion of a rigid body, as correlations are.
        ValueError: for parameters that are arrays or out of range.
    """
    require_float64()
    particle = particle_of(model, p)
    alpha = _REBOUND_ANGLES if alpha is None else checked("alpha", alpha)
    speeds = asked("v0", v0, p, SHARES * particle.speed)
    shape = (speeds.size, alpha.size)
    require_rows(speeds.size * alpha.size)
    each_alpha, each_speed = (np.broadcast_to(axis, shape).ravel() for axis in (alpha, speeds[:, None]))
    impacts = dataclasses.replace(particle.p, alpha=each_alpha, v0=each_speed)
    end = impact(particle.model, impacts, rtol=_RTOL)
    if isinstance(particle.model, Correlated) or not isinstance(end.state, State):
        raise ExportError(f"{model_name(particle.model)} has no motion of a rigid body: it says nothing of rebounds.")
    names = end_names(particle.model)
    has_motion = ~np.isin(end.outcome, [names.index(name) for name in OTHER_ENDS])
    vx, vy, spin = (np.where(has_motion, rate, np.nan) for rate in (end.state.vx, end.state.vy, end.state.omega))
    normal, tangential = each_speed * np.sin(each_alpha), each_speed * np.cos(each_alpha)
    tangential[np.cos(each_alpha) <= ZERO] = np.nan
    arrays = {"e_n": np.maximum(-vy / normal, 0.0), "e_t": vx / tangential, "spin": spin, "vx": vx, "vy": vy}
    dataset = labelled(
        particle, p, "rebounds", {"v0": speeds, "alpha": alpha}, {name: v.reshape(shape) for name, v in arrays.items()}
    )
    codes = {"long_name": "how the cut ended", "flag_values": np.arange(len(names), dtype=np.int8)}
    meanings = {"flag_meanings": " ".join(names)}
    dataset["ended_by"] = (("v0", "alpha"), end.outcome.astype(np.int8).reshape(shape), codes | meanings)
    return dataset
