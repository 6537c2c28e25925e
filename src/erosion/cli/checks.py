"""`erosion verify` and `erosion validate`: models against other solvers, published numbers beside computed ones."""

from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import JsonOption, PlotOption
from erosion.cli.output import Output, print_paths, print_table, progress_bar, require_outputs, working


def validate(
    *,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Compare models and correlations with published numbers.

    Each number has its source. It was measured, or comes from a fit to tests.
    Misses are shown; the exit status is 0 all the same, because a model that
    misses a measurement is computed no worse for it: see `erosion verify`.
    """
    require_outputs(plot=plot)
    start_engine()

    with working("comparing"):
        validation = lazy.against_published()
    if plot is not None:
        with user_errors():
            lazy.save_plot(lazy.plot_validation(validation), plot)
    if json:
        Output("validate", json=True).document(validation.to_dict())
        return
    print_table(validation.title, validation.rows(), validation.headings, (1, 2, 4), validation.conclusions)
    print_paths(figure=plot)


def verify(
    files: Annotated[list[str] | None, Parameter(negative="", show=False)] = None,
    /,
    *,
    model: ModelsOption = None,
    json: JsonOption = False,
) -> None:
    """Check models against exact and independent solutions.

    The exit status is 1 if an error is out of bounds.

    It checks all models, or those of --model: closed forms, identities, scaling
    and units; the batch against trajectories, scipy and (where it is installed)
    heyoka; derivatives against differences. All models take less than a minute
    on two cores.
    """
    models = chosen_models([*(files or []), *(model or [])])
    start_engine()

    with user_errors():
        loaded = {name: lazy.load_model(name) for name in models}
    output = Output("verify", json=json)
    with progress_bar("compiling") as progress:
        verification = lazy.verify(models or None, progress=progress)
    for name in verification.absent:
        output.warn(f"{name} is not installed: one reference solution fewer.")
    if json:
        output.document(verification.to_dict(), loaded)
    else:
        failures = [f"✗ {check}" for check in verification.failures]
        print_table(verification.title, verification.rows(), verification.headings, (1, 2, 3), failures)
    if not verification.passed:
        raise RuntimeError(f"{len(verification.failures)} of {len(verification.checks)} checks are out of bounds.")
