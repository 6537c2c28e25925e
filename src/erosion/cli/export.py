"""`erosion export`: a model and a case in the forms that CFD codes take."""

from collections.abc import Mapping, Sequence
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
_OPTIONS = {name: f"Option `--{option}`" for name, option in _OWN_NAMES.items()}


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
    table: Annotated[
        Path | None, Parameter(help="Write V over angle, speed and diameter: .csv; .txt for COMSOL.")
    ] = None,
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
    given = {"openfoam": openfoam, "fluent": fluent, "table": table, "restitution": restitution}
    outputs = {form: path for form, path in given.items() if path is not None}
    if not outputs:
        raise InputError("Give one or more of `--openfoam`, `--fluent`, `--table` and `--restitution`.")
    with progress_bar("computing"):
        p = options.parameters()
        name, chosen = named_model(model, own, options, p.units)
        of_target = weighing(chosen, None, options).density
        axes: dict[str, Any] = {"alpha": angles, "v0": speeds, "d": diameters}
        for axis, text in axes.items():
            with reading(_OPTIONS[axis]):
                dimension = {**QUANTITIES, **RESULTS}[axis].dimension
                axes[axis] = None if text is None else lazy.read_axis(text, dimension, p.units)
        share = PerMassOptions(cutting_fraction=cutting_fraction).per_mass(options).cutting_fraction
        density = density_option("particle-density", particle_density)
        particles = {"particle_density": density, "cutting_fraction": share}
        require_outputs(*outputs.values(), inputs=(options.case, name))
        with user_errors(fields=_OPTIONS):
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
    outputs: Mapping[str, Path],
    axes: dict[str, Any],
    particles: dict[str, Any],
    density: float | None,
) -> dict[str, _Part]:
    """What is asked for, computed, for a target of this density [kg/m³]."""
    reach, parts = {name: axes[name] for name in ("v0", "d")}, {}
    if "openfoam" in outputs:
        # In an OpenFOAM case the entry names its walls.
        of_mesh = lazy.case_of(outputs["openfoam"].parent)
        walls = () if of_mesh is None else lazy.open_case(of_mesh).walls
        form = lazy.to_openfoam(model, p, **reach, **particles, patches=walls)
        numbers = {name: getattr(form, name) for name in ("p", "psi", "K", "misfit", "rms")}
        line = f"OpenFOAM: p = {form.p:.6g} Pa, psi = {form.psi:.6g}, K = {form.K:.6g}; off by {form.misfit:.2%}"
        numbers["misfit_over_speeds"] = form.losses.worst
        parts["openfoam"] = _Part(outputs["openfoam"], form.text(), line, numbers, form.warnings)
    if "fluent" in outputs:
        shape = lazy.to_fluent(model, p, **reach, **particles, density=density)
        numbers = {"exponent": shape.exponent, "factor": shape.factor, "misfit": shape.misfit}
        numbers["misfit_over_speeds"] = shape.losses.worst
        line = f"Fluent: {len(shape.angle)} angles, b = {shape.exponent:.6g}, C = {shape.constant(shape.factor)}"
        parts["fluent"] = _Part(outputs["fluent"], shape.text(), line, numbers, shape.warnings)
    if "table" in outputs:
        volumes = lazy.volume_table(model, p, **axes, **particles)
        parts["table"] = _table(outputs["table"], volumes, "V")
    if "restitution" in outputs:
        rebounds = lazy.restitution(model, p, alpha=axes["alpha"], v0=axes["v0"])
        lost = int(rebounds.e_n.isnull().sum())
        if lost == rebounds.e_n.size:
            raise RuntimeError(f"of {lost:,} impacts none has a rebound: nothing is cut, or they fail.")
        warning = f"{lost:,} of {rebounds.e_n.size:,} impacts have no rebound (nan): nothing is cut, or they fail."
        parts["restitution"] = _table(outputs["restitution"], rebounds, "e_n, e_t and spin", [warning] * bool(lost))
    return parts


def _table(path: Path, dataset: "xr.Dataset", content: str, warnings: Sequence[str] = ()) -> _Part:
    sizes = {_OWN_NAMES[str(name)]: size for name, size in dataset.sizes.items()}
    line = f"{content} over {' x '.join(f'{size} {name}' for name, size in sizes.items())}"
    text = (lazy.to_comsol if path.suffix == ".txt" and "volume" in dataset else lazy.to_csv)(dataset)
    return _Part(path, text, line, sizes, warnings)
