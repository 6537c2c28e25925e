"""`erosion sweep` and `erosion stream`: impacts over a grid, also on a Dask cluster, and of a jet that varies."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
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
from erosion.extras import extra
from erosion.parameters import QUANTITIES
from erosion.results import Finding


@contextlib.contextmanager
def dask_cluster(workers: int | None, scheduler: str | None) -> Iterator[None]:
    """Work within on the cluster; in this process without either option."""
    if workers is None and scheduler is None:
        yield
        return
    if workers is not None and scheduler is not None:
        raise InputError("Give `--workers` or `--scheduler`, but not both.")
    with extra("dask"):
        from distributed import Client

    if workers is not None and workers < 1:
        raise InputError(f"Option `--workers` must be 1 or more, but is {workers}.")
    with contextlib.ExitStack() as stack:
        target = scheduler if workers is None else stack.enter_context(lazy.local_cluster(workers))
        try:
            client = Client(target)
        except (OSError, ValueError) as error:
            raise InputError(f"Option `--scheduler` must be a cluster that answers, not {target} ({error}).") from error
        stack.enter_context(client)
        yield


_FIELDS = ("model", "paired", "derivatives", "wrt", "optimum", "turn", "set")
"""The fields of [sweep] in a case file, beside parameters."""


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
    paired: Annotated[list[str] | None, LISTED, Parameter(help='Axes that go together: "alpha,v0".')] = None,
    derivatives: Annotated[WholeOption, Parameter(help="Also dV/dq (1), and d²V/dq² (2).")] = None,
    wrt: Annotated[str | None, Parameter(help="The parameter q of the derivatives; alpha without it.")] = None,
    optimum: Annotated[bool | None, Parameter(help="Also the best angle, over the other axes.")] = None,
    turn: Annotated[bool | None, Parameter(help="Also how far the body turns.")] = None,
    chunks: Annotated[
        list[str] | None, LISTED, Parameter(help='With out.zarr, sizes of blocks: "alpha=100,v0=200".')
    ] = None,
    workers: Annotated[WholeOption, Parameter(help="With out.zarr, work in this many processes.")] = None,
    scheduler: Annotated[
        str | None, Parameter(help="With out.zarr, work on this Dask cluster: tcp://host:8786.")
    ] = None,
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
    options = with_file(case, file)
    section = with_model_of_case(options.section("sweep", _FIELDS), options, model)
    if output.suffix != ".zarr" and not (workers is scheduler is chunks is None):
        raise InputError(
            f"Options `--chunks`, `--workers` and `--scheduler` need `--output` to end in .zarr, not {output}."
        )
    p, axes = _case_and_axes(options, section)
    chosen = chosen_models(model or _listed(options, section, "model", read_models)) or "linearized"
    chosen = chosen[0] if isinstance(chosen, list) and len(chosen) == 1 else chosen
    table = output if output.suffix == ".csv" else None
    read = chosen if isinstance(chosen, list) else [chosen]
    printed = Output("sweep", p, options, json=json, plot=plot, files={"table": table}, inputs=read)
    values = _own_values(chosen, options, settings(own, section, f"{options.case}: `set` of [sweep]"))
    axes |= {name: axis for name, axis in values.items() if axis.ndim}
    if not (axes or isinstance(chosen, list)):
        raise InputError('Options must include an axis, such as --alpha "1deg:90deg:90", or several models.')
    in_file = options.fields(
        "sweep", section, paired=paired, derivatives=derivatives, wrt=wrt, optimum=optimum, turn=turn
    )
    with user_errors(TypeError, fields=in_file):
        outputs = lazy.Outputs(
            derivatives=section.get("derivatives", 0) if derivatives is None else derivatives,
            wrt=wrt or section.get("wrt", "alpha"),
            optimum=section.get("optimum", False) if optimum is None else optimum,
            turn=section.get("turn", False) if turn is None else turn,
        )
        together = paired or _listed(options, section, "paired", read_list) or ()
        # Correlations are those that are made for the target; a single model's own values are the grid's.
        made: Any = options.reference(chosen) if not isinstance(chosen, list) else [
            options.reference(name, as_set=True) for name in chosen]  # fmt: skip
        single = {name: float(value) for name, value in values.items() if not value.ndim}
        grid = lazy.make_grid(made, p, axes, outputs, paired=together, own=single)
        if plot is not None:
            lazy.require_drawable(grid.lengths, list(grid.axes))
    # By model, and of a single model by the key "".
    weights = {name if grid.compared else "": weighing(each, abrasive, options) for name, each in grid.loaded().items()}
    printed.warn(*_sizes_apart(p, grid.axes))
    with dask_cluster(workers, scheduler), progress_bar("sweep") as progress:
        with user_errors():
            job = lazy.prepare_sweep(grid, chunks=_chunks(chunks), store=output if table is None else None)
        dataset = job.run(progress)
    summary = lazy.SweepSummary(dataset, grid.p, weights, output)
    varied = {name: f"{values.size} values" for name, values in grid.axes.items()}
    printed.save(
        figure=lambda: lazy.plot_sweep(lazy.with_boundaries(grid, dataset)),
        table=lambda path: lazy.write_csv(dataset, path, p, weights),
    )
    printed.show(summary, dict(grid.loaded()), varied=varied)
    if summary.lost == dataset.ended_by.size:
        raise RuntimeError(f"of {summary.lost:,} impacts none could be computed.")


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
            values[name] = lazy.read_axis(value, QUANTITIES[name].dimension, p.units)
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


def _chunks(items: list[str] | None) -> dict[str, int] | None:
    """Lengths by dimension, of "alpha=100"."""
    if items is None:
        return None
    parts = [item.replace(" ", "").partition("=") for item in items]
    if not all(length.isdecimal() for _, _, length in parts):
        raise ValueError(f'Option `--chunks` must be such as "alpha=100,v0=200", but is {",".join(items)!r}.')
    return {dim: int(length) for dim, _, length in parts}


_NO_LAW = (
    'A stream must have a law of a parameter, an option such as --v0 "normal(110 m/s, 10 m/s)" or the same in the '
    "case's table [stream], but has none."
)


def stream(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    joint: LawOptions | None = None,
    abrasive: PerMassOptions | None = None,
    n: Annotated[WholeOption, Parameter(name="--n", group=LAWS, help="Particles: 1e6; a million without it.")] = None,
    seed: Annotated[WholeOption, Parameter(group=LAWS, help="The same seed gives the same stream.")] = None,
    points: Annotated[str | None, Parameter(group=LAWS, help='"sobol" (scrambled) or "random".')] = None,
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
    jet = case_and_laws(options, "stream", section, model, own, joint)
    with reading(f"{options.case}: field `n` of [stream]"):
        count = read_whole(section.get("n", 2**20)) if n is None else n
    number = section.get("seed", 0) if seed is None else seed
    printed = Output("stream", jet.p, options, json=json, seed=number, plot=plot, inputs=jet.inputs)
    laws = jet.read_laws()
    if not (laws.varied or laws.uncertain):
        raise InputError(_NO_LAW)
    with user_errors(TypeError, fields=options.fields("stream", section, n=n, seed=seed, points=points)):
        made = lazy.StreamOptions(count, number, points or section.get("points", "sobol"), best_angle, store=output)
        job = lazy.prepare_stream(jet.model, jet.p, laws.varied, made, laws.uncertain)
    per_mass = weighing(jet.model, abrasive, options)
    printed.warn(*laws.findings(jet.model, jet.p, per_mass.cutting_fraction))

    def show(result: "lazy.Stream", *, is_complete: bool) -> None:
        result = dataclasses.replace(result, per_mass=per_mass)
        if is_complete:
            printed.save(figure=lambda: lazy.plot_stream(result))
        printed.show(result, {jet.name: result.model}, varied=result.laws_in_words())

    try:
        with progress_bar("stream") as progress:
            computed = job.run(progress)
    except lazy.StreamInterrupted as interrupted:
        if interrupted.partial is not None:
            show(interrupted.partial, is_complete=False)
        raise
    show(computed, is_complete=True)
