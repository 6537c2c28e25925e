"""`erosion map`: the wear of a surface by the impacts of a CFD run."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.cluster import ClusterOptions
from erosion.cli.errors import InputError, input_errors, user_errors
from erosion.cli.laws import LAW_FIELDS, CaseAndLaws, LawOptions, ReadLaws, case_and_laws
from erosion.cli.options import (
    IMPACTS,
    LAWS,
    LISTED,
    OUTPUT,
    SURFACE,
    CaseArgument,
    CaseOptions,
    EachRow,
    JsonOption,
    ModelOption,
    PlotOption,
    SetOption,
    TableOptions,
    WholeOption,
    in_short,
    output_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, density_option, progress_bar, weighing
from erosion.output import briefly
from erosion.results import Finding

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
class _RowOptions:
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

    @property
    def is_of_spheres(self) -> bool:
        """Whether no option asks for a body of another form or size than the table's spheres."""
        return not self.diameter and self.scaling == "similar"

    def table(self, impacts: Path, table: TableOptions, of_mesh: Path | None, case: CaseOptions) -> "lazy.Impacts":
        """The table of impacts.

        Args:
            impacts: its file.
            table: how it is read.
            of_mesh: the OpenFOAM case of its faces.
            case: the impact, whose particle gives the density of a table without one.
        """
        grit, _ = case.materials()
        return lazy.read_impacts(
            impacts,
            of_mesh,
            particle_density=density_option("particle-density", self.particle_density),
            duration=case.read("duration", self.duration, "time"),
            named_density=None if grit is None else grit.density,
            **table.arguments,
        )

    def options(
        self,
        sand: CaseAndLaws,
        read: ReadLaws,
        per_mass: "lazy.PerMass",
        abrasive: PerMassOptions,
        section: Mapping[str, Any],
    ) -> "lazy.MapOptions":
        """The same as numbers in SI.

        Args:
            sand: case and model.
            read: the laws.
            per_mass: with the density of the target.
            abrasive: the options that it is made of.
            section: the table [map] of the case file. A spin that it or --phidot0 gives takes the place of the table's.

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
        has_spin = "phidot0" in {**section, **sand.case.given()}
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

    def check(self, surface: "lazy.Surface | None", form: "lazy.MapFormat | None") -> None:
        """Know before computing that it can be drawn, and that something can be seen.

        Args:
            surface: what is drawn.
            form: of the map's file, which may hold the picture.
        """
        if self.plot is None and (form is None or not form.is_drawn):
            return
        if surface is None:
            raise InputError("Option `--plot` needs `--surface`: without it there is nothing to draw.")
        if self.quantity is not None and self.quantity not in lazy.FACES:
            raise InputError(
                f"Option `--quantity` must be one of {', '.join(lazy.FACES)}, but is {briefly(self.quantity)}."
            )
        with user_errors():
            lazy.require_view(self.direction, self.zoom, surface.normal)
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
    rows: _RowOptions | None = None,
    abrasive: Annotated[PerMassOptions | None, Parameter(show=False)] = None,
    output: Annotated[
        Path | None, output_option("map.vtp (ParaView), .csv …; a page .html"), Parameter(group=_OUTPUT)
    ] = None,
    picture: _Picture | None = None,
    cluster: Annotated[ClusterOptions | None, Parameter(show=False)] = None,
    json: Annotated[JsonOption, Parameter(show=False, group=_OUTPUT)] = False,
) -> None:
    """Compute the wear of a surface by the impacts of a CFD run."""
    target, rows, picture = target or _Surface(), rows or _RowOptions(), picture or _Picture()
    # Table 1 in SI, as tables and surfaces of CFD codes are.
    options, abrasive = dataclasses.replace(with_file(case, file), usual_units="si"), abrasive or PerMassOptions()
    section = _section(options)
    is_bare = not (model or own or joint or abrasive.cutting_fraction) and rows.is_of_spheres
    usual = _usual_model(options) if is_bare else None
    sand = case_and_laws(options, "map", section, model or usual, own, joint)
    form = _format(output, target, picture)
    laws, per_mass = sand.read_laws(), weighing(sand.model, abrasive, options)
    made = rows.options(sand, laws, per_mass, abrasive, section)
    printed = Output("map", sand.p, options, json=json, seed=made.seed_used, plot=picture.plot, files={"map": output},
                     inputs=(impacts, target.surface, *sand.inputs))  # fmt: skip
    job = _job((impacts, table or TableOptions()), target, rows, made, sand)
    picture.check(job.surface, form)
    # What is wrong with the rows of the table shows while they are computed.
    with (cluster or ClusterOptions()).connected(), input_errors(lazy.ImpactsError), progress_bar("map") as progress:
        dataset = job.run(progress).assign_attrs(options.names())
    printed.warn(*laws.findings(sand.model, sand.p, per_mass.cutting_fraction), _size_doubt(dataset, options))
    printed.save(
        figure=lambda: lazy.plot_map(dataset, **picture.look),
        map=lambda path: form and form.write(dataset, path, job.identity),
    )
    varied = {"alpha": "each row's", "v0": "each row's", **made.laws_in_words(job.task.model)}
    sentences = [_on_usual(sand.name, options)] if usual else []
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
    """The correlation for the target where no cut is named; None where one is, and where nobody has tests of the metal.

    Without a name steel is meant. A model of the cut would need a share of the particles that cut, which nobody has
    named, to give an amount.
    """
    if options.case or options.given():
        return None
    of_metal = options.materials()[1]
    return next(iter(of_metal.correlations), None) if of_metal else "dnv:carbon-steel"


def _on_usual(model: str, options: CaseOptions) -> str:
    """The sentence that nobody has named this model."""
    metal = options.names().get("target", "steel, as no --target is named")
    return f"{model} is the usual correlation for {metal}; --model takes others."


def _format(output: Path | None, target: _Surface, picture: _Picture) -> "lazy.MapFormat | None":
    """The format of the map's file, where one is asked for."""
    if output is None:
        return None
    formats = {**lazy.MAP_FORMATS, **lazy.page_format(**picture.look)}
    with user_errors():
        lazy.require_no_pdf(output)
        lazy.require_map_path(output, has_surface=target.surface is not None, formats=formats)
    return formats[output.suffix]


_SAME_SIZE = 1.5  # ratio of the mean diameter of the table to that of the particle that is named


def _size_doubt(dataset: "xr.Dataset", options: CaseOptions) -> Finding | None:
    """The finding that the particles of the table are of another size than the one that is named."""
    grit, _ = options.materials()
    if grit is None:
        return None
    mass = float(dataset["total_particle_mass"])
    mean = (6 * mass / (math.pi * grit.density * float(dataset["total_particles"]))) ** (1 / 3)
    if 1 / _SAME_SIZE < mean / grit.size < _SAME_SIZE:
        return None
    return Finding("other_size_than_named", numbers={"mean": mean * 1e3, "named": grit.size * 1e3, "unit": "mm"})


def _job(
    impacts: tuple[Path, TableOptions],
    target: _Surface,
    rows: _RowOptions,
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
        table = rows.table(*impacts, mesh, sand.case)
        return lazy.prepare_map(sand.reference, table, surface, options, sand.numbers)
