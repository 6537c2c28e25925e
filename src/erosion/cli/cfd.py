"""`erosion map` and `export`: the wear of a surface by a CFD run, and a model in the forms of CFD codes."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, as_options, sentence, user_errors
from erosion.cli.laws import LAW_FIELDS, CaseAndLaws, LawOptions, ReadLaws, case_and_laws
from erosion.cli.options import (
    IMPACTS,
    LAWS,
    LISTED,
    OUTPUT,
    SURFACE,
    AllAngles,
    CaseArgument,
    CaseOptions,
    EachRow,
    JsonOption,
    ModelOption,
    PlotOption,
    SetOption,
    TableOptions,
    WholeOption,
    in_full,
    in_short,
    named_model,
    output_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, density_option, progress_bar, weighing
from erosion.cli.sweep import dask_cluster
from erosion.output import briefly
from erosion.parameters import QUANTITIES, RESULTS
from erosion.results import Columns, Finding, Value

if TYPE_CHECKING:
    import xarray as xr


_LAWS = Group("Laws", help=in_short("stream", "rows", "uncertain", "correlation", "seed"), sort_key=LAWS.sort_key)
_OUTPUT = Group("Output", help=in_short("sweep", "workers", "scheduler", "json"), sort_key=OUTPUT.sort_key)
_CASE = "Case file; without it, --target's correlation, or steel's."


@Parameter(name="*", group=SURFACE)
@dataclasses.dataclass(frozen=True)
class _Surface:
    """What the particles hit."""

    surface: Annotated[Path | None, Parameter(help="OpenFOAM case, .vtp, .stl …; else totals alone.")] = None
    patch: Annotated[
        list[str] | None, LISTED, Parameter(help='Of the OpenFOAM case: "wall", or several; or all walls.')
    ] = None
    surface_unit: Annotated[str | None, Parameter(help="Of the coordinates of a file, such as mm.")] = None


@Parameter(name="*", group=IMPACTS)
@dataclasses.dataclass(frozen=True)
class _Rows:
    """How rows of the table become impacts; texts as they are typed."""

    scaling: Annotated[str, Parameter(help='r and b follow the size of a particle; or "none".')] = "similar"
    diameter: Annotated[
        str | None,
        Parameter(help='Of the sphere with r and b of the case: "0.2 mm".'),
    ] = None
    seed: Annotated[WholeOption, Parameter(show=False)] = None
    draws: Annotated[WholeOption, Parameter(group=_LAWS, help="Of what is uncertain, a map each; or 64.")] = None
    restitution: Annotated[str | None, Parameter(help="e,μ of the wall, for velocities after the rebound: 0.8,0.1")] = (
        None
    )
    limit: Annotated[
        str | None,
        Parameter(help='Leave out rows that are farther from their face: "1 mm".'),
    ] = None
    duration: Annotated[str | None, Parameter(help='That the table covers, if it does not say it: "60 s".')] = None
    sand_rate: Annotated[str | None, Parameter(help='For wear a year: "100 kg/day", "50 ppm of 12 kg/s" by mass.')] = (
        None
    )
    each_row: Annotated[str | None, Parameter(help='Of a table without weights: "1 particle".')] = None
    injected: Annotated[str | None, Parameter(help='Sand of the run, if no case says it: "2 g"; or "rows".')] = None
    particle_density: Annotated[str | None, Parameter(help='If no column gives it, nor --particle: "2650 kg/m^3".')] = (
        None
    )

    def table(
        self,
        impacts: Path,
        options: TableOptions,
        of_mesh: Path | None,
        case: CaseOptions,
        grit: "lazy.Particle | None",
    ) -> "lazy.Impacts":
        """The table of impacts.

        Args:
            impacts: its file.
            options: how it is read.
            of_mesh: the OpenFOAM case of its faces.
            case: the impact.
            grit: the particle that is named, for a table without a density.
        """
        return lazy.read_impacts(
            impacts,
            of_mesh,
            particle_density=density_option("particle-density", self.particle_density),
            duration=case.read("duration", self.duration, "time"),
            named_density=None if grit is None else grit.density,
            **options.arguments,
        )

    def options(
        self,
        sand: CaseAndLaws,
        read: ReadLaws,
        per_mass: "lazy.PerMass",
        abrasive: PerMassOptions,
        *,
        has_spin: bool,
    ) -> "lazy.MapOptions":
        """The same as numbers in the units of the case.

        Args:
            sand: case and model.
            read: the laws.
            per_mass: with the density of the target.
            abrasive: the options that it is made of.
            has_spin: whether --phidot0 or the case file's [map] gives the spin, which then takes the place of the
                table's.

        Raises:
            InputError: one sentence naming the option.
        """
        try:
            pair = "0,0" if self.restitution is None else self.restitution
            normal, friction = (float(number) for number in pair.split(","))
        except ValueError as error:
            raise InputError(
                f'Option `--restitution` must be two numbers such as "0.8,0.1", but is {briefly(self.restitution)}.'
            ) from error
        # A share that is uncertain has its law alone, if no option gives it too.
        has_law = lazy.FRACTION in read.uncertain.names and abrasive.cutting_fraction is None
        with user_errors(TypeError):
            return lazy.MapOptions(
                sand.p,
                self.scaling,
                sand.case.read("diameter", self.diameter, "length"),
                "case" if has_spin and "phidot0" not in read.varied.names + read.uncertain.names else None,
                None if self.restitution is None else (normal, friction),
                per_mass.density,
                sand.case.read("limit", self.limit, "length"),
                self.seed or 0,
                uncertain=read.uncertain,
                draws=64 if self.draws is None else self.draws,
                cutting_fraction=1.0 if has_law else per_mass.cutting_fraction,
                sand_rate=self.sand_rate,
                injected=self.injected,
                laws=read.varied,
                each_row=self.each_row,
            )


@Parameter(name="*", group=_OUTPUT)
@dataclasses.dataclass(frozen=True)
class _Picture:
    """What is drawn, and how."""

    plot: Annotated[PlotOption, Parameter(group=_OUTPUT)] = None
    quantity: Annotated[str | None, Parameter(help="Drawn, such as alpha_mean; else depth, a year if it can.")] = None
    view: Annotated[
        str,
        Parameter(help='Of the worst face, "iso", +x, …, or "1,-1,0.5".', allow_leading_hyphen=True),
    ] = "worst"
    zoom: Annotated[float, Parameter(help="2 shows the middle half.")] = 1.0
    log: Annotated[
        bool | None, Parameter(negative="--no-log", show_default=False, help="Colours by the logarithm; or as fits.")
    ] = None

    @property
    def direction(self) -> Any:
        """The view's name, or its direction."""
        try:
            return tuple(float(number) for number in self.view.split(",")) if "," in self.view else self.view
        except ValueError as error:
            raise InputError(
                f'Option `--view` must be such as iso, +x or "1,-1,0.5", but is {briefly(self.view)}.'
            ) from error

    def check(self, *, has_surface: bool, is_drawn: bool = False, surface: "lazy.Surface | None" = None) -> None:
        """Know before computing that it can be drawn, and where the surface is known that something can be seen."""
        if self.plot is None and not is_drawn:
            return
        if not has_surface:
            raise InputError("Option `--plot` needs `--surface`: without it there is nothing to draw.")
        if self.quantity is not None and self.quantity not in lazy.FACES:
            raise InputError(
                f"Option `--quantity` must be one of {', '.join(lazy.FACES)}, but is {briefly(self.quantity)}."
            )
        with user_errors():
            lazy.require_view(self.direction, self.zoom, None if surface is None else surface.normal)
        lazy.require_renderer()

    @property
    def look(self) -> dict[str, Any]:
        """The arguments of `plot_map`."""
        return {"quantity": self.quantity, "view": self.direction, "zoom": self.zoom, "log": self.log}


def map_(
    impacts: Annotated[Path, Parameter(help="OpenFOAM case, .post, .dat, .dpm, .csv, .parquet, .vtu …")],
    file: Annotated[CaseArgument, Parameter(help=_CASE)] = None,
    /,
    *,
    target: _Surface | None = None,
    case: EachRow | None = None,
    model: Annotated[ModelOption | None, Parameter(show=False)] = None,
    own: Annotated[SetOption, Parameter(show=False)] = None,
    joint: Annotated[LawOptions | None, Parameter(show=False, group=_LAWS)] = None,
    table: Annotated[TableOptions | None, Parameter(group=IMPACTS)] = None,
    rows: _Rows | None = None,
    abrasive: Annotated[PerMassOptions | None, Parameter(show=False)] = None,
    output: Annotated[
        Path | None, output_option("map.vtp (ParaView), .csv …; a page .html"), Parameter(group=_OUTPUT)
    ] = None,
    picture: _Picture | None = None,
    workers: Annotated[WholeOption, Parameter(show=False)] = None,
    scheduler: Annotated[str | None, Parameter(show=False)] = None,
    json: Annotated[JsonOption, Parameter(show=False, group=_OUTPUT)] = False,
) -> None:
    """Compute the wear of a surface by the impacts of a CFD run."""
    target, rows, picture = target or _Surface(), rows or _Rows(), picture or _Picture()
    abrasive = abrasive or PerMassOptions()
    # Table 1 in SI, as tables and surfaces of CFD codes are.
    options = dataclasses.replace(with_file(case, file), usual_units="si")
    section = _section(options)
    has_cut = bool(options.case or options.given() or own or joint or rows.diameter or rows.scaling != "similar")
    usual = None if has_cut or model or abrasive.cutting_fraction else _usual_model(options)
    sand = case_and_laws(options, "map", section, model or usual, own, joint)
    form = _format(output, target, picture)
    is_drawn = form is not None and form.is_drawn
    picture.check(has_surface=target.surface is not None, is_drawn=is_drawn)
    printed = Output("map", sand.p, options, json=json, plot=picture.plot, files={"map": output},
                     inputs=(impacts, target.surface, *sand.inputs))  # fmt: skip
    laws, per_mass = sand.read_laws(), weighing(sand.model, abrasive, options)
    made = rows.options(sand, laws, per_mass, abrasive, has_spin="phidot0" in {**section, **options.given()})
    printed.seed = made.seed_used
    grit, _ = options.materials()
    with dask_cluster(workers, scheduler):
        job = _job((impacts, table or TableOptions()), target, rows, grit, made, sand)
        picture.check(has_surface=job.surface is not None, is_drawn=is_drawn, surface=job.surface)
        with progress_bar("map") as progress:
            try:
                dataset = job.run(progress).assign_attrs(options.names())
            except lazy.ImpactsError as error:  # of the table, which is read meanwhile
                raise InputError(as_options(sentence(error))) from error
    printed.warn(*laws.findings(sand.model, sand.p, per_mass.cutting_fraction))
    if grit is not None:
        printed.warn(_size_doubt(dataset, grit.size, grit.density))
    metal = options.names().get("target", "steel, as no --target is named")
    sentences = [f"{sand.name} is the usual correlation for {metal}; --model takes others."] if usual else []
    varied = {"alpha": "each row's", "v0": "each row's", **made.laws_in_words(job.task.model)}

    printed.save(
        figure=lambda: lazy.plot_map(dataset, **picture.look),
        map=lambda path: form and form.write(dataset, path, job.identity),
    )
    printed.show(lazy.MapSummary(dataset), {sand.name: job.task.model}, varied=varied, sentences=sentences)


def _section(options: CaseOptions) -> Mapping[str, Any]:
    """The table [map] of the case file."""
    section = options.section("map", ("model", "set", *LAW_FIELDS))
    own_of_rows = "each row of the table has its own"
    options.refuse_given(own_of_rows, "alpha", "v0")
    for name in ("alpha", "v0"):
        if name in section:
            raise InputError(f"{options.case}: field `{name}` of [map] has no meaning here: {own_of_rows}.")
    return section


def _usual_model(options: CaseOptions) -> str | None:
    """The correlation for the target where no model and no cut is named; None where nobody has tests of the metal.

    Without a name steel is meant. A model of the cut would need a share of the particles that cut, which nobody has
    named, to give an amount.
    """
    of_metal = options.materials()[1]
    return next(iter(of_metal.correlations), None) if of_metal else "dnv:carbon-steel"


def _format(output: Path | None, target: _Surface, picture: _Picture) -> "lazy.MapFormat | None":
    """The format of the map's file, where one is asked for."""
    if output is None:
        return None
    formats = {**lazy.FORMATS, **lazy.page_format(**picture.look)}
    with user_errors():
        lazy.require_no_pdf(output)
        lazy.require_map_path(output, has_surface=target.surface is not None, formats=formats)
    return formats[output.suffix]


_SAME_SIZE = 1.5  # ratio of the mean diameter of the table to that of the particle that is named


def _size_doubt(dataset: "xr.Dataset", named: float, density: float) -> Finding | None:
    """The finding that the particles of the table are of another size than the one that is named [m], as radii are."""
    mass = lazy.conversion_factor("mass", dataset.attrs["unit_system"], "si") * float(dataset["total_particle_mass"])
    mean = (6 * mass / (math.pi * density * float(dataset["total_particles"]))) ** (1 / 3)
    if 1 / _SAME_SIZE < mean / named < _SAME_SIZE:
        return None
    return Finding("other_size_than_named", numbers={"mean": mean * 1e3, "named": named * 1e3, "unit": "mm"})


def _job(
    impacts: tuple[Path, TableOptions],
    target: _Surface,
    rows: _Rows,
    grit: "lazy.Particle | None",
    options: "lazy.MapOptions",
    sand: CaseAndLaws,
) -> "lazy.MapJob":
    """Open the table and the surface, and check the map."""
    name = target.surface
    for option in ("patch", "surface_unit"):
        if name is None and getattr(target, option):
            raise InputError(f"Option `--{option.replace('_', '-')}` needs `--surface`, of which it is.")
    with user_errors(TypeError), progress_bar("reading"):
        surface = None if name is None else lazy.read_surface(name, target.patch, unit=target.surface_unit)
        mesh = name if name is not None and name.is_dir() else None
        table = rows.table(*impacts, mesh, sand.case, grit)
        return lazy.prepare_map(sand.reference, table, surface, options, sand.numbers)


_OWN_NAMES = {"alpha": "angles", "v0": "speeds", "d": "diameters"}
_OPTIONS = {name: f"Option `--{option}`" for name, option in _OWN_NAMES.items()}


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
    options.refuse_given("the forms hold all angles; --angles are those of the tables", "alpha")
    given = {"openfoam": openfoam, "fluent": fluent, "table": table, "restitution": restitution}
    outputs = {form: path for form, path in given.items() if path is not None}
    if not outputs:
        raise InputError("Give one or more of `--openfoam`, `--fluent`, `--table` and `--restitution`.")
    with progress_bar("computing"):
        p = options.parameters()
        name, chosen = named_model(model, own, options)
        of_target = weighing(chosen, None, options).density
        axes: dict[str, Any] = {"alpha": angles, "v0": speeds, "d": diameters}
        for axis, text in axes.items():
            dimension = {**QUANTITIES, **RESULTS}[axis].dimension
            axes[axis] = options.read(_OWN_NAMES[axis], text, dimension, lazy.read_axis)
        share = PerMassOptions(cutting_fraction=cutting_fraction).per_mass(options).cutting_fraction
        density = density_option("particle-density", particle_density)
        particles = {"particle_density": density, "cutting_fraction": share}
        output = Output("export", p, options, json=json, files=given, inputs=[name])
        with user_errors(fields=_OPTIONS):
            parts = _parts(chosen, p, outputs, axes, particles, of_target)
        # What cannot be represented is refused before anything is written.
        with user_errors():
            for part in parts.values():
                lazy.write_whole(part.path, part.text.encode())
    for part in parts.values():
        output.warn(*part.findings)
    files = [
        Value("file", [str(part.path) for part in parts.values()]),
        Value("holds", [part.line for part in parts.values()]),
    ]
    numbers = [Value(form, {"file": str(part.path), **part.numbers}, only="data") for form, part in parts.items()]
    title = f"{in_full(name, chosen, p.units)}: for CFD codes"
    output.present(title, [*numbers, Columns("files", "", files, only="table")], {name: chosen})


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
        numbers = {name: getattr(form, name) for name in ("psi", "K", "misfit", "rms")}
        numbers["p"] = {"value": form.p, "unit": "Pa"}
        line = f"OpenFOAM: p = {form.p:.6g} Pa, psi = {form.psi:.6g}, K = {form.K:.6g}; off by {form.misfit:.2%}"
        numbers["misfit_over_speeds"] = form.losses.worst
        parts["openfoam"] = _Part(outputs["openfoam"], form.text(), line, numbers, form.findings)
    if "fluent" in outputs:
        shape = lazy.to_fluent(model, p, **reach, **particles, density=density)
        numbers = {"exponent": shape.exponent, "factor": shape.factor, "misfit": shape.misfit}
        numbers["misfit_over_speeds"] = shape.losses.worst
        line = f"Fluent: {len(shape.angle)} angles, b = {shape.exponent:.6g}, C = {shape.constant(shape.factor)}"
        parts["fluent"] = _Part(outputs["fluent"], shape.text(), line, numbers, shape.findings)
    if "table" in outputs:
        volumes = lazy.volume_table(model, p, **axes, **particles)
        parts["table"] = _table(outputs["table"], volumes, "V")
    if "restitution" in outputs:
        rebounds = lazy.restitution(model, p, alpha=axes["alpha"], v0=axes["v0"])
        lost = int(rebounds.e_n.isnull().sum())
        if lost == rebounds.e_n.size:
            raise RuntimeError(f"of {lost:,} impacts none has a rebound: nothing is cut, or they fail.")
        lost_ones = Finding("no_rebounds", numbers={"lost": lost, "impacts": rebounds.e_n.size})
        parts["restitution"] = _table(outputs["restitution"], rebounds, "e_n, e_t and spin", [lost_ones] * bool(lost))
    return parts


def _table(path: Path, dataset: "xr.Dataset", content: str, findings: Sequence[Finding] = ()) -> _Part:
    sizes = {_OWN_NAMES[str(name)]: size for name, size in dataset.sizes.items()}
    line = f"{content} over {' x '.join(f'{size} {name}' for name, size in sizes.items())}"
    text = (lazy.to_comsol if path.suffix == ".txt" and "volume" in dataset else lazy.to_csv)(dataset)
    return _Part(path, text, line, sizes, findings)
