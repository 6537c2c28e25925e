"""`erosion sweep`: impacts over axes of parameters and models, kept in a file."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.options import (
    CaseOptions,
    InputError,
    JsonOption,
    WholeOption,
    load,
    print_json,
    print_table,
    require_outputs,
    start_engine,
    user_errors,
    warn,
    with_file,
)
from erosion.cli.progress import progress_bar
from erosion.cli.settings import SetOption, Settings, read_settings, settings

if TYPE_CHECKING:
    from erosion.parameters.parameters import Parameters


def sweep(
    file: Annotated[Path | None, Parameter(help="Case file (TOML), the same as --case.")] = None,
    /,
    *,
    out: Annotated[Path, Parameter(name=("--out", "-o"), help="out.nc (netCDF), or out.zarr for any size.")],
    case: CaseOptions | None = None,
    model: Annotated[list[str] | None, Parameter(help="A model's name or path; give several for a comparison.")] = None,
    own: SetOption = None,
    paired: Annotated[str | None, Parameter(help='Axes that go together: "alpha,v0".')] = None,
    derivatives: Annotated[WholeOption, Parameter(help="Also dV/dq (1), and d²V/dq² (2).")] = None,
    wrt: Annotated[str | None, Parameter(help="The parameter q of the derivatives; alpha without it.")] = None,
    optimum: Annotated[bool | None, Parameter(help="Also the best angle, over the other axes.")] = None,
    chunks: Annotated[str | None, Parameter(help='With out.zarr, sizes of blocks: "alpha=100,v0=200".')] = None,
    workers: Annotated[WholeOption, Parameter(help="With out.zarr, work in this many processes.")] = None,
    scheduler: Annotated[
        str | None, Parameter(help="With out.zarr, work on this Dask cluster: tcp://host:8786.")
    ] = None,
    plot: Annotated[Path | None, Parameter(help="Also draw the volume into this file (.svg, .png, .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Compute impacts over a grid, into a labelled file; started again, go on where it stopped.

    Any of the case's parameters may be an axis: --alpha "1deg:90deg:90" (first, last, count),
    --v0 "100 m/s : 900 m/s : 5 : log", --sigma "10e3, 37e3"; so may the model's own: --set
    "friction=0:0.4:5". A case file says the same in a table [sweep], which options overrule.
    """
    options = with_file(case, file)
    section = options.section("sweep", ("model", "paired", "derivatives", "wrt", "optimum", "set"))
    if out.suffix not in (".nc", ".zarr"):
        raise InputError(f"Option `--out` must end in .nc or .zarr, but is {out}.")
    if out.suffix != ".zarr" and not (workers is scheduler is chunks is None):
        raise InputError(f"Options `--chunks`, `--workers` and `--scheduler` need `--out` to end in .zarr, not {out}.")
    require_outputs(plot=plot, inputs=(options.case,))
    p, axes = _case_and_axes(options, section)
    chosen = model or section.get("model", "linearized")
    if isinstance(chosen, list) and len(chosen) == 1:
        chosen = chosen[0]
    given = _own_values(chosen, settings(own, section, f"{options.case}: `set` of [sweep]"), p)
    axes |= {name: values for name, values in given.items() if values.ndim}
    start_engine()
    from erosion.sweeps.grid import Outputs, make_grid
    from erosion.sweeps.sweep import prepare_sweep

    together = tuple(paired.replace(" ", "").split(",")) if paired else section.get("paired", ())
    single = {name: float(values) for name, values in given.items() if not values.ndim}
    with user_errors(TypeError):
        outputs = Outputs(
            derivatives=section.get("derivatives", 0) if derivatives is None else derivatives,
            wrt=wrt or section.get("wrt", "alpha"),
            optimum=section.get("optimum", False) if optimum is None else optimum,
        )
        grid = make_grid(chosen, p, axes, outputs, paired=together, own=single)
        cut = _chunks(chunks)
    with _cluster(workers, scheduler), progress_bar("sweep") as progress:
        with user_errors():
            job = prepare_sweep(grid, chunks=cut, store=out)
        dataset = job.run(lambda _, done, total: progress(done, total))
    if plot is not None:
        from erosion.plotting.style import save_plot
        from erosion.plotting.sweeps import plot_sweep

        with user_errors():
            save_plot(plot_sweep(dataset), plot)
    summary = _summary(dataset)
    if json:
        print_json({"out": str(out), "dimensions": {str(dim): int(n) for dim, n in dataset.sizes.items()}, **summary})
    else:
        _print_summary(dataset, out, summary)
    lost = sum(summary["ended_by"].get(end, 0) for end in ("failed", "unfinished"))
    if lost == summary["impacts"]:
        raise RuntimeError(f"of {lost:,} impacts none could be computed.")
    if lost:
        warn(f"{lost:,} of {summary['impacts']:,} impacts could not be computed.")


def _case_and_axes(options: CaseOptions, section: dict[str, Any]) -> "tuple[Parameters, dict[str, Any]]":
    """The scalars of the case, and what its [sweep] and the options make axes; options win."""
    from erosion.parameters.parameters import QUANTITIES
    from erosion.parameters.ranges import read_axis

    given = options.texts("sweep", section)
    p = options.without_changes().parameters()
    values: dict[str, Any] = {}
    for name, (what, value) in given.items():
        try:
            values[name] = read_axis(value, QUANTITIES[name].dimension, p.units)
        except ValueError as error:
            raise InputError(f"{what} {error}.") from error
    p = p.replace(**{name: value for name, value in values.items() if not value.ndim})
    return p, {name: value for name, value in values.items() if value.ndim}


def _own_values(model: Any, said: Settings, p: "Parameters") -> dict[str, Any]:
    """The models' own parameters that are set: of each a single value, shape (), or those of an axis."""
    from erosion.parameters.ranges import read_axis

    values: dict[str, Any] = {}
    if said:
        for name in model if isinstance(model, list) else [model]:
            values = read_settings(name, load(name), said, p.units, lambda _, *of: read_axis(*of))
    return values


def _chunks(text: str | None) -> dict[str, int] | None:
    if text is None:
        return None
    parts = [part.partition("=") for part in text.replace(" ", "").split(",")]
    if not all(length.isdecimal() for _, _, length in parts):
        raise ValueError(f'Option `--chunks` must be such as "alpha=100,v0=200", but is {text!r}.')
    return {dim: int(length) for dim, _, length in parts}


@contextlib.contextmanager
def _cluster(workers: int | None, scheduler: str | None) -> Iterator[None]:
    """The Dask cluster that the options ask for."""
    if workers is None and scheduler is None:
        yield
        return
    if workers is not None and scheduler is not None:
        raise InputError("Give `--workers` or `--scheduler`, but not both.")
    try:
        from distributed import Client

        from erosion.sweeps.cluster import local_cluster
    except ImportError as error:
        raise InputError('A cluster needs the extra `dask`: pip install "erosion[dask]".') from error
    if workers is not None and workers < 1:
        raise InputError(f"Option `--workers` must be 1 or more, but is {workers}.")
    with contextlib.ExitStack() as stack:
        target = scheduler if workers is None else stack.enter_context(local_cluster(workers))
        try:
            client = Client(target)
        except (OSError, ValueError) as error:
            raise InputError(f"Option `--scheduler` must be a cluster that answers, not {target} ({error}).") from error
        stack.enter_context(client)
        yield


def _summary(dataset: Any) -> dict[str, Any]:
    import numpy as np

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


def _print_summary(dataset: Any, out: Path, summary: dict[str, Any]) -> None:
    from erosion.parameters.quantities import RESULTS
    from erosion.parameters.units import unit_name
    from erosion.tables import Row, format_number

    unit = unit_name("volume", dataset.attrs["unit_system"])
    rows = [
        Row("impacts", "", f"{summary['impacts']:,}", "", " × ".join(f"{n} {dim}" for dim, n in dataset.sizes.items())),
        Row("ended_by", "", ", ".join(f"{n:,} {name}" for name, n in summary["ended_by"].items()), ""),
    ]
    for name, meaning in (("volume_least", "least"), ("volume_greatest", "greatest")):
        value = format_number(summary[name])
        rows.append(Row("volume", RESULTS["volume"].symbol, value, unit, f"{meaning} {RESULTS['volume'].meaning}"))
    print_table(f"sweep into {out}", rows)
