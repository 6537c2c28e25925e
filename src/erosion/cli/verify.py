"""`erosion verify`: checks of the models on this machine."""

from typing import Annotated

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import JsonOption
from erosion.cli.output import Output, print_table
from erosion.cli.progress import progress_bar


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
    from erosion.models import load_model
    from erosion.verification import verify as verify_models
    from erosion.verification.result import HEADINGS

    with user_errors():
        loaded = {name: load_model(name) for name in models}
    output = Output("verify", json=json)
    with progress_bar("compiling") as progress:
        verification = verify_models(models or None, progress=progress)
    for name in verification.absent:
        output.warn(f"{name} is not installed: one reference solution fewer.")
    if json:
        output.document(verification.to_dict(), loaded)
    else:
        failures = [f"✗ {check}" for check in verification.failures]
        print_table(verification.title, verification.rows(), HEADINGS, (1, 2, 3), failures)
    if not verification.passed:
        raise RuntimeError(f"{len(verification.failures)} of {len(verification.checks)} checks are out of bounds.")
