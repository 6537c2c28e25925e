"""`erosion export`: a model in the forms of CFD codes."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, as_options, user_errors
from erosion.cli.options import (
    AllAngles,
    CaseArgument,
    CaseOptions,
    JsonOption,
    ModelOption,
    SetOption,
    in_full,
    named_model,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, density_option, progress_bar, weighing
from erosion.parameters import QUANTITIES, RESULTS
from erosion.results import Columns, Declared, Finding, Value

if TYPE_CHECKING:
    import xarray as xr


_OWN_NAMES = {"alpha": "angles", "v0": "speeds", "d": "diameters"}
_OPTIONS = {name: f"Option `--{option}`" for name, option in _OWN_NAMES.items()}


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class _ExportFiles:
    """Which forms are written, and where."""

    openfoam: Annotated[Path | None, Parameter(help="Write OpenFOAM ParticleErosion coefficients.")] = None
    fluent: Annotated[
        Path | None, Parameter(help="Write angle function, velocity exponent and diameter function for Fluent.")
    ] = None
    table: Annotated[Path | None, Parameter(help="Write V over angle, speed and diameter: .csv; .txt for COMSOL.")] = (
        None
    )
    restitution: Annotated[Path | None, Parameter(help="Write e_n, e_t and spin over angle and speed (CSV).")] = None

    @property
    def given(self) -> dict[str, Path]:
        """The files that are asked for, by form."""
        given = {form: path for form, path in dataclasses.asdict(self).items() if path is not None}
        if not given:
            raise InputError("Give one or more of `--openfoam`, `--fluent`, `--table` and `--restitution`.")
        return given


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class _Impacts:
    """Which impacts tables hold, and over which forms must hold."""

    angles: Annotated[str | None, Parameter(help='Of both tables: "5deg : 85deg : 17".')] = None
    speeds: Annotated[
        str | None, Parameter(help='Of the tables, and over which forms must hold: "20 m/s : 80 m/s : 7".')
    ] = None
    diameters: Annotated[str | None, Parameter(help='The same of diameters: "0.1 mm, 0.2 mm, 0.4 mm".')] = None
    particle_density: Annotated[
        str | None, Parameter(help='Of the particles in the code: "2650 kg/m^3"; the diameter is 2 r without it.')
    ] = None
    cutting_fraction: Annotated[
        float | None, Parameter(help="Share of the particles that cut, for the mean volume; Finnie: about 0.5.")
    ] = None

    def read(self, model: "lazy.CuttingModel", options: CaseOptions) -> "_Asked":
        """The model and the case, or the fit, that the forms are made of."""
        axes: dict[str, Any] = {}
        for axis, name in _OWN_NAMES.items():
            dimension = {**QUANTITIES, **RESULTS}[axis].dimension
            axes[axis] = options.read(name, getattr(self, name), dimension, lazy.read_axis)
        share = PerMassOptions(cutting_fraction=self.cutting_fraction).per_mass(options).cutting_fraction
        density = density_option("particle-density", self.particle_density)
        particles = {"particle_density": density, "cutting_fraction": share}
        return _Asked(model, options.parameters(), axes, particles, weighing(model, None, options).density)


class _Asked(NamedTuple):
    """Model, case and impacts that forms are made of; the density of the target [kg/m³]."""

    model: "lazy.CuttingModel"
    p: "lazy.Parameters"
    axes: dict[str, Any]
    particles: dict[str, Any]
    density: float | None

    @property
    def in_si(self) -> "lazy.Parameters":
        """The case shown in SI, beside which bare numbers are in SI."""
        return self.p.to("si")

    @property
    def reach(self) -> dict[str, Any]:
        """The speeds and diameters over which forms must hold."""
        return {name: self.axes[name] for name in ("v0", "d")}

    @property
    def turned(self) -> Finding | None:
        """The finding that bodies turn by more than 90° in some of the cuts of which forms are made."""
        own = {"alpha": lazy.TABLE_ANGLES, "v0": self.p.v0}
        alpha, speed = (own[name] if self.axes[name] is None else self.axes[name] for name in own)
        p = dataclasses.replace(self.p, alpha=alpha.reshape(-1, 1), v0=speed)
        return lazy.finding_of_turned(lazy.count_turned(self.model, p))


class _Part(NamedTuple):
    """One file: its content, one line on it for people, its numbers for programs, and what to warn of."""

    path: Path
    text: str
    line: str
    numbers: dict[str, Any]
    findings: Sequence[Finding] = ()


def export(
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    files: _ExportFiles | None = None,
    impacts: _Impacts | None = None,
    json: JsonOption = False,
) -> None:
    """Write a model and a case for OpenFOAM, Fluent, or as tables.

    Each file says how far its form is off the model. Forms are made at the
    case's speed; with --speeds they must hold over all of these. Where the
    model does not have a form, the others are written, with exit code 1.
    """
    options, given = with_file(case, file), (files or _ExportFiles()).given
    options.refuse_given("the forms hold all angles; --angles are those of the tables", "alpha")
    with progress_bar("computing"):
        name, chosen = named_model(model, own, options)
        asked = (impacts or _Impacts()).read(chosen, options)
        output = Output("export", asked.p, options, json=json, files=given, inputs=[name])
        with user_errors(fields=_OPTIONS):
            parts, refusals = _made(asked, given)
        if not parts:
            raise InputError(" ".join(refusals))
        with user_errors():
            for part in parts.values():
                lazy.write_whole(part.path, part.text.encode())
    output.warn(*(finding for part in parts.values() for finding in part.findings), asked.turned)
    output.present(f"{in_full(name, chosen, asked.p.shown_in)}: for CFD codes", _declared(parts), {name: chosen})
    if refusals:
        raise RuntimeError(" ".join(refusals))


def _made(asked: _Asked, given: Mapping[str, Path]) -> tuple[dict[str, _Part], list[str]]:
    """The forms that the model has, and why it does not have the others, each reason once."""
    parts: dict[str, _Part] = {}
    refusals: list[str] = []
    for form, path in given.items():
        try:
            parts[form] = _FORMS[form](asked, path)
        except lazy.ExportError as error:
            refusals.append(as_options(str(error), _OPTIONS))
    return parts, [*dict.fromkeys(refusals)]


def _declared(parts: Mapping[str, _Part]) -> list[Declared]:
    """The numbers of each form, and a table of the files."""
    files = [
        Value("file", [str(part.path) for part in parts.values()]),
        Value("holds", [part.line for part in parts.values()]),
    ]
    numbers = [Value(form, {"file": str(part.path), **part.numbers}, only="data") for form, part in parts.items()]
    return [*numbers, Columns("files", "", files, only="table")]


def _to_openfoam(asked: _Asked, path: Path) -> _Part:
    # In an OpenFOAM case the entry names its walls.
    of_mesh = lazy.case_of(path.parent)
    walls = () if of_mesh is None else lazy.open_case(of_mesh).walls
    form = lazy.to_openfoam(asked.model, asked.in_si, **asked.reach, **asked.particles, patches=walls)
    numbers = {name: getattr(form, name) for name in ("psi", "K", "misfit", "rms")}
    numbers |= {"p": {"value": form.p, "unit": "Pa"}, "misfit_over_speeds": form.losses.worst}
    line = f"OpenFOAM: p = {form.p:.6g} Pa, psi = {form.psi:.6g}, K = {form.K:.6g}; off by {form.misfit:.2%}"
    return _Part(path, form.text(), line, numbers, form.findings)


def _to_fluent(asked: _Asked, path: Path) -> _Part:
    form = lazy.to_fluent(asked.model, asked.in_si, **asked.reach, **asked.particles, density=asked.density)
    numbers = {"exponent": form.exponent, "factor": form.factor, "misfit": form.misfit}
    numbers["misfit_over_speeds"] = form.losses.worst
    line = f"Fluent: {len(form.angle)} angles, b = {form.exponent:.6g}, C = {form.constant(form.factor)}"
    return _Part(path, form.text(), line, numbers, form.findings)


def _volumes(asked: _Asked, path: Path) -> _Part:
    return _table(path, lazy.volume_table(asked.model, asked.in_si, **asked.axes, **asked.particles), "V")


def _rebounds(asked: _Asked, path: Path) -> _Part:
    rebounds = lazy.restitution(asked.model, asked.in_si, alpha=asked.axes["alpha"], v0=asked.axes["v0"])
    lost = int(rebounds.e_n.isnull().sum())
    if lost == rebounds.e_n.size:
        raise RuntimeError(f"of {lost:,} impacts none has a rebound: nothing is cut, or they fail.")
    lost_ones = Finding("no_rebounds", numbers={"lost": lost, "impacts": rebounds.e_n.size})
    return _table(path, rebounds, "e_n, e_t and spin", [lost_ones] * bool(lost))


_FORMS: Mapping[str, Callable[[_Asked, Path], _Part]] = {
    "openfoam": _to_openfoam,
    "fluent": _to_fluent,
    "table": _volumes,
    "restitution": _rebounds,
}


def _table(path: Path, dataset: "xr.Dataset", content: str, findings: Sequence[Finding] = ()) -> _Part:
    sizes = {_OWN_NAMES[str(name)]: size for name, size in dataset.sizes.items()}
    line = f"{content} over {' x '.join(f'{size} {name}' for name, size in sizes.items())}"
    text = (lazy.to_comsol if path.suffix == ".txt" and "volume" in dataset else lazy.to_csv)(dataset)
    return _Part(path, text, line, sizes, findings)
