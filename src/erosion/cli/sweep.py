"""`erosion sweep` and `erosion stream`: impacts over a grid, also on a Dask cluster, and of a jet that varies."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.cluster import ClusterOptions
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.laws import LAW_FIELDS, LawOptions, case_and_laws
from erosion.cli.options import (
    LAWS,
    LISTED,
    CaseArgument,
    CaseOptions,
    JsonOption,
    ModelOption,
    ModelsOption,
    PlotOption,
    SetOption,
    Settings,
    WholeOption,
    asked,
    chosen_models,
    output_option,
    read_list,
    read_models,
    read_whole,
    settings,
    with_file,
    with_model_of_case,
)
from erosion.cli.output import Output, PerMassOptions, progress_bar, weighing
from erosion.parameters import QUANTITIES
from erosion.results import Finding

_FIELDS = ("model", "paired", "derivatives", "wrt", "optimum", "turn", "set")
"""The fields of [sweep] in a case file, beside parameters."""


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class GridOptions:
    """Options of a grid: paired axes, and results for each impact."""

    paired: Annotated[list[str] | None, LISTED, Parameter(help='Axes that go together: "alpha,v0".')] = None
    derivatives: Annotated[WholeOption, Parameter(help="Also dV/dq (1), and d²V/dq² (2).")] = None
    wrt: Annotated[str | None, Parameter(help="The parameter q of the derivatives; alpha without it.")] = None
    optimum: Annotated[bool | None, Parameter(help="Also the best angle, over the other axes.")] = None
    turn: Annotated[bool | None, Parameter(help="Also how far the body turns.")] = None

    def grid(
        self, options: CaseOptions, section: Mapping[str, Any], models: Any, own: Sequence[str] | None
    ) -> "lazy.Grid":
        """The grid of the options and of the case file; options win.

        Args:
            options: the case.
            section: the table [sweep] of its file.
            models: the name of one model, or those of several.
            own: the options --set.

        Raises:
            InputError: one sentence naming the option or the field.
        """
        p, axes = _case_and_axes(options, section)
        values = _own_values(models, options, settings(own, section, f"{options.case}: `set` of [sweep]"))
        axes |= {name: axis for name, axis in values.items() if axis.ndim}
        single = {name: float(value) for name, value in values.items() if not value.ndim}
        several = isinstance(models, list)
        if not (axes or several):
            raise InputError('Options must include an axis, such as --alpha "1deg:90deg:90", or several models.')
        chosen = {name: value for name, value in asked(self, section).items() if name != "paired"}
        with user_errors(TypeError, fields=options.fields("sweep", section, **dataclasses.asdict(self))):
            together = self.paired or _listed(options, section, "paired", read_list) or ()
            outputs = lazy.SweepOutputs(**chosen)
            # Correlations are those that are made for the target; a single model's own values are the grid's.
            made = [options.reference(name, as_set=True) for name in models] if several else options.reference(models)
            return lazy.make_grid(made, p, lazy.InSI(axes), outputs, paired=together, own=single)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class StoreOptions:
    """Options of a Zarr store."""

    chunks: Annotated[
        list[str] | None, LISTED, Parameter(help='With out.zarr, sizes of blocks: "alpha=100,v0=200".')
    ] = None
    cluster: ClusterOptions | None = None

    def check(self, output: Path) -> None:
        """Refuse these options without a Zarr store."""
        is_given = self.chunks is not None or (self.cluster or ClusterOptions()).is_given
        if is_given and output.suffix != ".zarr":
            raise InputError(
                f"Options `--chunks`, `--workers` and `--scheduler` need `--output` to end in .zarr, not {output}."
            )

    @contextlib.contextmanager
    def computing(self, grid: "lazy.Grid", path: Path | None) -> Iterator["lazy.SweepJob"]:
        """A grid to compute within, on the cluster that is asked for.

        Args:
            grid: what is computed.
            path: of the store; None for none.
        """
        with (self.cluster or ClusterOptions()).connected():
            with user_errors():
                job = lazy.prepare_sweep(grid, chunks=self._lengths, store=path)
            yield job

    @property
    def _lengths(self) -> dict[str, int] | None:
        """Lengths by dimension, of "alpha=100"."""
        if self.chunks is None:
            return None
        parts = [item.replace(" ", "").partition("=") for item in self.chunks]
        if not all(length.isdecimal() for _, _, length in parts):
            raise ValueError(f'Option `--chunks` must be such as "alpha=100,v0=200", but is {",".join(self.chunks)!r}.')
        return {dim: int(length) for dim, _, length in parts}


def sweep(
    file: CaseArgument = None,
    /,
    *,
    output: Annotated[
        Path, output_option("out.nc (netCDF), out.csv, or out.zarr for any size.", ".nc", ".csv", ".zarr")
    ],
    case: CaseOptions | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    abrasive: PerMassOptions | None = None,
    wanted: GridOptions | None = None,
    store: StoreOptions | None = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Compute impacts over a grid into a labelled file.

    After an interruption, the same command goes on; out.csv starts anew.

    Any parameter of the case may be an axis: --alpha "1deg:90deg:90" (first,
    last, count), --v0 "100 m/s : 900 m/s : 5 : log", --sigma "1 GPa, 2 GPa".
    A model's own parameters may be axes as well: --set "friction=0:0.4:5".
    A case file gives the same in a table [sweep]; options overrule it.
    """
    options, store = with_file(case, file), store or StoreOptions()
    store.check(output)
    section = with_model_of_case(options.section("sweep", _FIELDS), options, model)
    models = _models(options, section, model)
    grid = (wanted or GridOptions()).grid(options, section, models if len(models) > 1 else models[0], own)
    table = output if output.suffix == ".csv" else None
    printed = Output("sweep", grid.p, options, json=json, plot=plot, files={"table": table}, inputs=models)
    if plot is not None:
        with user_errors():
            lazy.require_drawable(grid.lengths, list(grid.axes))
    # By model, and of a single model by the key "".
    weights = {name if grid.compared else "": weighing(each, abrasive, options) for name, each in grid.loaded().items()}
    printed.warn(*_sizes_apart(grid.p, grid.axes))
    with store.computing(grid, output if table is None else None) as job, progress_bar("sweep") as progress:
        dataset = job.run(progress)
    summary = lazy.SweepSummary(dataset, grid.p, weights, output)
    printed.save(
        figure=lambda: lazy.plot_sweep(lazy.with_boundaries(grid, dataset)),
        table=lambda path: lazy.write_csv(dataset, path, grid.p, weights),
    )
    varied = {name: f"{values.size} values" for name, values in grid.axes.items()}
    printed.show(summary, dict(grid.loaded()), varied=varied)
    if summary.lost == dataset.ended_by.size:
        raise RuntimeError(f"of {summary.lost:,} impacts none could be computed.")


def _models(options: CaseOptions, section: Mapping[str, Any], given: list[str] | None) -> list[Any]:
    """The models of the option, or of the case file."""
    named = given or _listed(options, section, "model", read_models) or "linearized"
    return chosen_models(named if isinstance(named, list) else [named])


def _sizes_apart(p: "lazy.Parameters", axes: Mapping[str, Any]) -> list[Finding | None]:
    """The findings that radii or widths of axes do not fit the mass."""
    names = () if "m" in axes else [name for name in ("r", "b") if name in axes]
    return [dataclasses.replace(p, **{name: axes[name]}).size_finding for name in names]


def _listed(options: CaseOptions, section: Mapping[str, Any], name: str, read: Callable[[str], list[str]]) -> Any:
    """A list of the case file, which may be a text as at the command line."""
    value = section.get(name)
    with reading(f"{options.case}: field `{name}` of [sweep]"):
        return read(value) if isinstance(value, str) else value


def _case_and_axes(options: CaseOptions, section: Mapping[str, Any]) -> "tuple[lazy.Parameters, dict[str, Any]]":
    """The case's scalars and its axes, from its [sweep] and the options; options win."""
    given = options.texts("sweep", section)
    p = options.parameters(changed=False)
    values: dict[str, Any] = {}
    for name, (source, value) in given.items():
        with reading(source):
            values[name] = lazy.read_axis(value, QUANTITIES[name].dimension, p.shown_in)
    options.warn_of_flow_stress(values)
    p = dataclasses.replace(p, **{name: value for name, value in values.items() if not value.ndim})
    return p, {name: value for name, value in values.items() if value.ndim}


def _own_values(model: Any, options: CaseOptions, given: Settings) -> dict[str, Any]:
    """The models' own parameters that are set: each a single value, shape (), or the values of an axis."""
    values: dict[str, Any] = {}
    if given:
        for name in model if isinstance(model, list) else [model]:
            values = options.read_settings(
                name,
                options.load(name),
                given,
                lambda _, text, dimension, units: lazy.read_axis(text, dimension, units),
            )
    return values


_NO_LAW = (
    'A stream must have a law of a parameter, an option such as --v0 "normal(110 m/s, 10 m/s)" or the same in the '
    "case's table [stream], but has none."
)


@Parameter(name="*", group=LAWS)
@dataclasses.dataclass(frozen=True)
class SampleOptions:
    """Options of sampling a stream."""

    n: Annotated[WholeOption, Parameter(name="--n", help="Particles: 1e6; a million without it.")] = None
    seed: Annotated[WholeOption, Parameter(help="The same seed gives the same stream.")] = None
    points: Annotated[str | None, Parameter(help='"sobol" (scrambled) or "random".')] = None

    def read(self, options: CaseOptions, section: Mapping[str, Any], **more: Any) -> "lazy.StreamOptions":
        """Values of the options and of the table [stream] of the case file; options win; `more` is not in the table."""
        chosen = asked(self, section)
        if "n" in chosen:
            with reading(f"{options.case}: field `n` of [stream]"):
                chosen["n"] = read_whole(chosen["n"])
        with user_errors(TypeError, fields=options.fields("stream", section, **dataclasses.asdict(self))):
            return lazy.StreamOptions(**chosen, **more)


def stream(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    joint: LawOptions | None = None,
    abrasive: PerMassOptions | None = None,
    sample: SampleOptions | None = None,
    best_angle: Annotated[bool, Parameter(help="Look for the nozzle's angle that removes most.")] = True,
    output: Annotated[Path | None, output_option("Keep it in this file (.nc), to go on from.", ".nc")] = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Compute the erosion by a stream of particles, and its best angle.

    Any parameter of the case may vary: --alpha "normal(20deg, 3deg)",
    --v0 "lognormal(110 m/s, 0.1)", --m "weibull(50ug, 3)",
    --phidot0 "uniform(-1e4 rad/s, 1e4 rad/s)", --v0 "samples(jet.csv)",
    --r "rosin-rammler(1mm, 3, 0.2mm)". A model's own parameters may vary as well:
    --set "friction=normal(0.2, 0.02)". What is one number for all particles but
    not known is --uncertain: its error does not average out. A case file gives
    the same in a table [stream]; options win.
    """
    options = with_file(case, file)
    section = options.section("stream", ("model", "n", "seed", "points", "set", *LAW_FIELDS))
    made = (sample or SampleOptions()).read(options, section, best_angle=best_angle, store=output)
    jet = case_and_laws(options, "stream", section, model, own, joint)
    printed = Output("stream", jet.p, options, json=json, seed=made.seed, plot=plot, inputs=jet.inputs)
    laws, per_mass = jet.read_laws(), weighing(jet.model, abrasive, options)
    if not (laws.varied or laws.uncertain):
        raise InputError(_NO_LAW)
    with user_errors(TypeError):
        job = lazy.prepare_stream(jet.model, jet.p, laws.varied, made, laws.uncertain)
    printed.warn(*laws.findings(jet.model, jet.p, per_mass.cutting_fraction))

    def show(result: "lazy.Stream") -> None:
        result = dataclasses.replace(result, per_mass=per_mass)
        printed.show(result, {jet.name: result.model}, varied=result.laws_in_words())

    try:
        with progress_bar("stream") as progress:
            computed = job.run(progress)
    except lazy.StreamInterrupted as interrupted:
        if interrupted.partial is not None:
            show(interrupted.partial)
        raise
    printed.save(figure=lambda: lazy.plot_stream(computed))
    show(computed)
