"""`erosion validate`: published numbers beside what the package gives."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.options import JsonOption
from erosion.cli.output import Output, print_paths, print_table, require_outputs
from erosion.cli.progress import working


def validate(
    *,
    plot: Annotated[Path | None, Parameter(help="Also draw computed over published (.svg, .png, .pdf).")] = None,
    json: JsonOption = False,
) -> None:
    """Compare models and correlations with published numbers.

    Each number has its source. It was measured, or comes from a fit to tests, or
    a program documents it. Misses are shown: a mark ✗ says that a number is off
    by more than the error that its source states. The exit status is 0 all the
    same, because a model that misses a measurement is computed no worse for it;
    `erosion verify` looks at that.
    """
    require_outputs(plot=plot)
    start_engine()
    from erosion.validation import against_published

    with working("comparing"):
        validation = against_published()
    if plot is not None:
        from erosion.plotting.style import save_plot
        from erosion.plotting.validation import plot_validation

        with user_errors():
            save_plot(plot_validation(validation), plot)
    if json:
        Output("validate", json=True).document(validation.to_dict())
        return
    print_table(validation.title, validation.rows(), validation.headings, (1, 2, 4), validation.statements)
    print_paths(figure=plot)
