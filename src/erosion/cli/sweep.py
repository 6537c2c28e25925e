"""`erosion sweep` and `erosion stream`: impacts over a grid, also on a Dask cluster, and of a jet that varies."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
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
    read_settings,
    read_whole,
    settings,
    with_file,
    with_model_of_case,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing
from erosion.extras import extra
from erosion.parameters import QUANTITIES
from erosion.results import Finding, from_attribute, render


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


_FIELDS = ("model", "paired", "derivatives", "wrt", "optimum", "set")
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
    last, count), --v0 "100 m/s : 900 m/s : 5 : log", --sigma "10e3, 37e3".
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
    require_outputs(table, plot=plot, inputs=(options.case, *(chosen if isinstance(chosen, list) else [chosen])))
    values = _own_values(chosen, options, settings(own, section, f"{options.case}: `set` of [sweep]"), p)
    single = {name: float(value) for name, value in values.items() if not value.ndim}
    axes |= {name: axis for name, axis in values.items() if axis.ndim}
    if not (axes or isinstance(chosen, list)):
        raise InputError('Options must include an axis, such as --alpha "1deg:90deg:90", or several models.')
    in_file = options.fields("sweep", section, paired=paired, derivatives=derivatives, wrt=wrt, optimum=optimum)
    with user_errors(TypeError, fields=in_file):
        outputs = lazy.Outputs(
            derivatives=section.get("derivatives", 0) if derivatives is None else derivatives,
            wrt=wrt or section.get("wrt", "alpha"),
            optimum=section.get("optimum", False) if optimum is None else optimum,
        )
        together = paired or _listed(options, section, "paired", read_list) or ()
        # Correlations are those that are made for the target; a single model's own values are the grid's.
        made: Any = options.reference(chosen) if not isinstance(chosen, list) else [
            options.reference(name, as_set=True) for name in chosen]  # fmt: skip
        grid = lazy.make_grid(made, p, axes, outputs, paired=together, own=single)
    # By model, and of a single model by the key "".
    weights = {name if grid.compared else "": weighing(each, abrasive, options) for name, each in grid.loaded().items()}
    with dask_cluster(workers, scheduler), progress_bar("sweep") as progress:
        with user_errors():
            job = lazy.prepare_sweep(grid, chunks=_chunks(chunks), store=output if table is None else None)
        dataset = job.run(progress)
    if table is not None:
        with user_errors():
            lazy.write_csv(dataset, table, p, weights)
    draw(plot, lambda: lazy.plot_sweep(dataset))
    printed = Output("sweep", p, options, json=json)
    for name in () if "m" in grid.axes else [name for name in ("r", "b") if name in grid.axes]:
        printed.warn(dataclasses.replace(p, **{name: grid.axes[name]}).size_finding)
    _show_sweep(dataset, grid, output, printed, weights)


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


def _own_values(model: Any, options: CaseOptions, given: Settings, p: "lazy.Parameters") -> dict[str, Any]:
    """The models' own parameters that are set: each a single value, shape (), or the values of an axis."""
    values: dict[str, Any] = {}
    if given:
        for name in model if isinstance(model, list) else [model]:
            values = read_settings(name, options.load(name), given, p.units, lambda _, *of: lazy.read_axis(*of))
    return values


def _chunks(items: list[str] | None) -> dict[str, int] | None:
    """Lengths by dimension, of "alpha=100"."""
    if items is None:
        return None
    parts = [item.replace(" ", "").partition("=") for item in items]
    if not all(length.isdecimal() for _, _, length in parts):
        raise ValueError(f'Option `--chunks` must be such as "alpha=100,v0=200", but is {",".join(items)!r}.')
    return {dim: int(length) for dim, _, length in parts}


def _show_sweep(
    dataset: Any, grid: "lazy.Grid", store: Path, output: Output, weights: "Mapping[str, lazy.PerMass]"
) -> None:
    """Show a summary; some impacts that could not be computed are a warning, all of them an error."""
    summary = _summary(dataset)
    of_mass, volumes, at = _per_mass(dataset, grid.p, weights)
    lost = sum(summary["ended_by"].get(event, 0) for event in ("failed", "unfinished"))
    output.warn(*from_attribute(dataset.attrs.get("findings", "")), *lazy.models_far_from_tests(weights, volumes, at))
    if 0 < lost < summary["impacts"]:
        output.warn(Finding("not_computed", numbers={"lost": lost, "impacts": summary["impacts"]}))
    dimensions = {str(dim): length for dim, length in dataset.sizes.items()}
    units: dict[str, str] = dict.fromkeys(("volume_least", "volume_greatest"), dataset.volume.attrs["units"])
    units |= {name: lazy.PER_MASS_UNITS[name.rpartition("_")[0]] for name in of_mass}
    axes = {name: f"{values.size} values" for name, values in grid.axes.items()}
    result = {"output": str(store), "dimensions": dimensions, **summary, **of_mass}
    output.document(result, dict(grid.loaded()), units, axes)
    is_beyond = any(weight.is_beyond_tests(volumes[name], at) for name, weight in weights.items())
    rows = [*_rows(dataset, summary), *_per_mass_rows(of_mass, is_beyond=is_beyond)]
    output.table(f"{store}: a sweep", rows)
    if lost == summary["impacts"]:
        raise RuntimeError(f"of {lost:,} impacts none could be computed.")


def _summary(dataset: Any) -> dict[str, Any]:
    meanings = dataset.ended_by.attrs["flag_meanings"].split()
    counts = np.zeros(len(meanings), int)
    # Block by block, for what is larger than memory.
    for block in dataset.ended_by.data.blocks if dataset.ended_by.chunks else [dataset.ended_by.data]:
        counts += np.bincount(np.asarray(block).ravel(), minlength=len(meanings))
    return {
        "impacts": int(dataset.ended_by.size),
        "ended_by": {name: int(n) for name, n in zip(meanings, counts, strict=True) if n},
        "volume_least": float(dataset.volume.min()),
        "volume_greatest": float(dataset.volume.max()),
    }


def _per_mass(
    dataset: Any, p: "lazy.Parameters", weights: "Mapping[str, lazy.PerMass]"
) -> "tuple[dict[str, float], dict[str, Any], lazy.Parameters]":
    """The least and the greatest erosion per mass of abrasive, of all models [SI].

    And by model the greatest volumes at each speed, of a particle of mass 1, with the case that they belong to.
    """
    per_particle_mass = dataset.volume / (dataset["m"] if "m" in dataset else float(p.m))
    speeds, one = dataset.get("v0"), dataclasses.replace(p, m=1.0)
    volumes: dict[str, Any] = {}
    ends: dict[str, list[float]] = {}
    for model, weight in weights.items():
        of_model = per_particle_mass.sel(model=model) if model else per_particle_mass
        volumes[model] = of_model.max([dim for dim in of_model.dims if speeds is None or dim not in speeds.dims]).values
        for end in (float(of_model.min()), float(of_model.max())):
            for name, value in weight.to_dict(end, one).items():
                ends.setdefault(name, []).append(float(value))
    # Where only some models have a density, their ratios are not those of all.
    common = {name: values for name, values in ends.items() if len(values) == 2 * len(weights)}
    of_mass = {f"{name}_{end}": of(values) for name, values in common.items()
               for end, of in (("least", min), ("greatest", max))}  # fmt: skip
    return of_mass, volumes, one if speeds is None else dataclasses.replace(one, v0=speeds.values)


def _per_mass_rows(of_mass: Mapping[str, float], *, is_beyond: bool) -> "list[lazy.Row]":
    """The rows of `_per_mass`, the greatest marked where it is beyond all tests."""
    rows = []
    for name, value in of_mass.items():
        quantity, _, end = name.rpartition("_")
        (size, unit), known = lazy.PER_MASS_SCALES[quantity], lazy.RESULTS[quantity]
        mark = f"; {lazy.BEYOND_TESTS}" if is_beyond and end == "greatest" else ""
        rows.append(lazy.Row(name, known.symbol, f"{value / size:.6g}", unit, f"{end} {known.meaning}{mark}"))
    return rows


def _rows(dataset: Any, summary: dict[str, Any]) -> "list[lazy.Row]":
    rows = [
        lazy.Row(
            "impacts", "", f"{summary['impacts']:,}", "", " × ".join(f"{n} {dim}" for dim, n in dataset.sizes.items())
        ),
        lazy.Row("ended_by", "", ", ".join(f"{n:,} {name}" for name, n in summary["ended_by"].items()), ""),
    ]
    for name, meaning in (("volume_least", "least"), ("volume_greatest", "greatest")):
        value = lazy.declare_result("volume", summary[name], dataset.attrs["unit_system"])
        rows += map(lazy.Row._make, render.tables("", [value.but(meaning=f"{meaning} {value.meaning}")])[0].rows)
    return rows


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
    --v0 "lognormal(110 m/s, 0.1)", --phidot0 "uniform(-1e4, 1e4)",
    --m "weibull(50ug, 3)", --r "rosin-rammler(1mm, 3, 0.2mm)",
    --v0 "samples(jet.csv)". A model's own parameters may vary as well:
    --set "friction=normal(0.2, 0.02)". What is one number for all particles but
    not known is --uncertain: its error does not average out. A case file gives
    the same in a table [stream]; options win.
    """
    options = with_file(case, file)
    section = options.section("stream", ("model", "n", "seed", "points", "set", *LAW_FIELDS))
    jet = case_and_laws(options, "stream", section, model, own, joint)
    with reading(f"{options.case}: field `n` of [stream]"):
        count = read_whole(section.get("n", 2**20)) if n is None else n
    require_outputs(plot=plot, inputs=jet.inputs)
    number = section.get("seed", 0) if seed is None else seed
    printed = Output("stream", jet.p, options, json=json, seed=number)
    varied, uncertain, draws = jet.read_laws()
    if not (varied or uncertain):
        raise InputError(_NO_LAW)
    with user_errors(TypeError, fields=options.fields("stream", section, n=n, seed=seed, points=points)):
        made = lazy.StreamOptions(count, number, points or section.get("points", "sobol"), best_angle, store=output)
        job = lazy.prepare_stream(jet.model, jet.p, varied, made, uncertain)
    per_mass = weighing(jet.model, abrasive, options)
    printed.warn(*lazy.unused_columns({**varied, **uncertain}), *lazy.columns_apart(varied))
    for part in draws:
        printed.warn(*part.doubts(jet.model, jet.p, per_mass.cutting_fraction))
    try:
        with progress_bar("stream") as progress:
            result = dataclasses.replace(job.run(progress), per_mass=per_mass)
    except lazy.StreamInterrupted as interrupted:
        if interrupted.partial is not None:
            partial = dataclasses.replace(interrupted.partial, per_mass=per_mass)
            printed.show(partial, {jet.name: partial.model}, varied=partial.laws_in_words())
        raise
    draw(plot, lambda: lazy.plot_stream(result))
    printed.show(result, {jet.name: result.model}, varied=result.laws_in_words())
