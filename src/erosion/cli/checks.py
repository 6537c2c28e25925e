"""`erosion verify` and `erosion validate`: models against other solvers, published numbers beside computed ones."""

from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import user_errors
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import JsonOption, PlotOption
from erosion.cli.output import Output, draw, progress_bar, require_outputs


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
    with progress_bar("comparing"):
        validation = lazy.against_published()
    draw(plot, lambda: lazy.plot_validation(validation))
    output = Output("validate", json=json)
    output.document(validation.to_dict())
    output.table(validation.title, validation.rows(), validation.headings, (1, 2, 4), validation.conclusions)
    output.wrote(figure=plot)


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

    with user_errors():
        loaded = {name: lazy.load_model(name) for name in models}
    output = Output("verify", json=json)
    with progress_bar("compiling") as progress:
        verification = lazy.verify(models or None, progress=progress)
    output.warn(*(f"{name} is not installed: one reference solution fewer." for name in verification.absent))
    output.document(verification.to_dict(), loaded)
    failures = [f"✗ {check}" for check in verification.failures]
    output.table(verification.title, verification.rows(), verification.headings, (1, 2, 3), failures)
    if not verification.passed:
        raise RuntimeError(f"{len(verification.failures)} of {len(verification.checks)} checks are out of bounds.")
