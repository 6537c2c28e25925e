"""`erosion export`: a model and a case in the forms that CFD codes take."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.lists import ModelOption
from erosion.cli.options import (
    AllAngles,
    CaseArgument,
    JsonOption,
    SetOption,
    in_full,
    named_model,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, density_option, progress_bar, require_outputs, weighing
from erosion.parameters.quantities import QUANTITIES, RESULTS

if TYPE_CHECKING:
    import xarray as xr


_OWN_NAMES = {"alpha": "angles", "v0": "speeds", "d": "diameters"}


class _Outputs(NamedTuple):
    """The files that are asked for."""

    openfoam: Path | None
    fluent: Path | None
    table: Path | None
    restitution: Path | None


class _Part(NamedTuple):
    """One file: its content, one line on it for people, its numbers for programs, and what to warn of."""

    path: Path
    text: str
    line: str
    numbers: dict[str, Any]
    warnings: Sequence[str] = ()


def export(
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    openfoam: Annotated[Path | None, Parameter(help="Write OpenFOAM ParticleErosion coefficients.")] = None,
    fluent: Annotated[
        Path | None, Parameter(help="Write angle function, velocity exponent and diameter function for Fluent.")
    ] = None,
    table: Annotated[Path | None, Parameter(help="Write V over angle, speed and diameter (CSV).")] = None,
    restitution: Annotated[Path | None, Parameter(help="Write e_n, e_t and spin over angle and speed (CSV).")] = None,
    angles: Annotated[str | None, Parameter(help='Of both tables: "5deg : 85deg : 17".')] = None,
    speeds: Annotated[
        str | None, Parameter(help='Of the tables, and over which forms must hold: "20 m/s : 80 m/s : 7".')
    ] = None,
    diameters: Annotated[str | None, Parameter(help='The same of diameters: "0.1 mm, 0.2 mm, 0.4 mm".')] = None,
    particle_density: Annotated[
        str | None, Parameter(help='Of the particles in the code: "2650 kg/m^3"; the diameter is 2 r without it.')
    ] = None,
    cutting_fraction: Annotated[
        float | None, Parameter(help="Share of the particles that cut, for the mean volume; Finnie: about 0.5.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Write a model and a case for OpenFOAM, Fluent, or as tables.

    Each file says how far its form is off the model. Forms are made at the
    case's speed; with --speeds they must hold over all of these.
    """
    options = with_file(case, file)
    options.refuse_angle("the forms hold all angles; --angles are those of the tables")
    outputs = _Outputs(openfoam, fluent, table, restitution)
    if not any(outputs):
        raise InputError("Give one or more of `--openfoam`, `--fluent`, `--table` and `--restitution`.")
    with progress_bar("computing"):
        p = options.parameters()
        name, chosen = named_model(model, own, options, p.units)
        of_target = weighing(chosen, None, options).density
        axes = _axes({"alpha": angles, "v0": speeds, "d": diameters}, p)
        share = PerMassOptions(cutting_fraction=cutting_fraction).per_mass(options).cutting_fraction
        density = density_option("particle-density", particle_density)
        particles = {"particle_density": density, "cutting_fraction": share}
        require_outputs(*outputs, inputs=(options.case, name))
        with user_errors(), _named():
            parts = _parts(chosen, p, outputs, axes, particles, of_target)
        # What cannot be represented is refused before anything is written.
        with user_errors():
            for part in parts.values():
                lazy.write_whole(part.path, part.text.encode())
    output = Output("export", p, options, json=json)
    for part in parts.values():
        output.warn(*part.warnings)
    result = {form: {"file": str(part.path), **part.numbers} for form, part in parts.items()}
    output.document(result, {name: chosen}, {"p": "Pa"})
    rows = [(str(part.path), part.line) for part in parts.values()]
    output.table(f"{in_full(name, chosen, p.units)}: for CFD codes", rows, ("file", "holds"), numbers=())


def _parts(
    model: "lazy.CuttingModel",
    p: "lazy.Parameters",
    outputs: _Outputs,
    axes: dict[str, Any],
    particles: dict[str, Any],
    density: float | None,
) -> dict[str, _Part]:
    """What is asked for, computed, for a target of this density [kg/m³]."""
    reach, parts = {name: axes[name] for name in ("v0", "d")}, {}
    if outputs.openfoam is not None:
        # In an OpenFOAM case the entry names its walls.
        of_mesh = lazy.case_of(outputs.openfoam.parent)
        walls = () if of_mesh is None else lazy.open_case(of_mesh).walls
        form = lazy.to_openfoam(model, p, **reach, **particles, patches=walls)
        numbers = {name: getattr(form, name) for name in ("p", "psi", "K", "misfit", "rms")}
        line = f"OpenFOAM: p = {form.p:.6g} Pa, psi = {form.psi:.6g}, K = {form.K:.6g}; off by {form.misfit:.2%}"
        numbers["misfit_over_speeds"] = form.losses.worst
        parts["openfoam"] = _Part(outputs.openfoam, form.text(), line, numbers, form.warnings)
    if outputs.fluent is not None:
        shape = lazy.to_fluent(model, p, **reach, **particles, density=density)
        numbers = {"exponent": shape.exponent, "factor": shape.factor, "misfit": shape.misfit}
        numbers["misfit_over_speeds"] = shape.losses.worst
        line = f"Fluent: {len(shape.angle)} angles, b = {shape.exponent:.6g}, C = {shape.constant(shape.factor)}"
        parts["fluent"] = _Part(outputs.fluent, shape.text(), line, numbers, shape.warnings)
    if outputs.table is not None:
        volumes = lazy.volume_table(model, p, **axes, **particles)
        parts["table"] = _table(outputs.table, volumes, "V")
    if outputs.restitution is not None:
        rebounds = lazy.restitution(model, p, alpha=axes["alpha"], v0=axes["v0"])
        lost = int(rebounds.e_n.isnull().sum())
        if lost == rebounds.e_n.size:
            raise RuntimeError(f"of {lost:,} impacts none has a rebound: nothing is cut, or they fail.")
        warning = f"{lost:,} of {rebounds.e_n.size:,} impacts have no rebound (nan): nothing is cut, or they fail."
        parts["restitution"] = _table(outputs.restitution, rebounds, "e_n, e_t and spin", [warning] * bool(lost))
    return parts


def _table(path: Path, dataset: "xr.Dataset", content: str, warnings: Sequence[str] = ()) -> _Part:
    sizes = {_OWN_NAMES[str(name)]: size for name, size in dataset.sizes.items()}
    line = f"{content} over {' x '.join(f'{size} {name}' for name, size in sizes.items())}"
    return _Part(path, lazy.to_csv(dataset), line, sizes, warnings)


def _axes(texts: dict[str, str | None], p: "lazy.Parameters") -> dict[str, Any]:
    """The values of --angles, --speeds and --diameters, None where they are not given."""
    axes: dict[str, Any] = dict.fromkeys(texts)
    for name, text in texts.items():
        if text is None:
            continue
        with reading(f"Option `--{_OWN_NAMES[name]}`"):
            axes[name] = lazy.read_axis(text, {**QUANTITIES, **RESULTS}[name].dimension, p.units)
    return axes


@contextlib.contextmanager
def _named() -> Iterator[None]:
    """Python's names of axes are other options here."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        for name, option in _OWN_NAMES.items():
            text = text.replace(f"Argument `{name}`", f"Argument `{option}`")
        raise ValueError(text) from error
