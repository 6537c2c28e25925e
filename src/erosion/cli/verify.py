"""`erosion verify`: does it compute what it says, here and now?"""

from typing import Annotated

from cyclopts import Parameter

from erosion.cli.options import JsonOption, load, print_json, print_table, start_engine, warn


def verify(
    models: Annotated[
        list[str] | None,
        Parameter(negative="", help="Names or paths of files; every registered model without it."),
    ] = None,
    /,
    *,
    json: JsonOption = False,
) -> None:
    """Check models against exact and independent solutions; exit status 1 if an error is out of bounds.

    Closed forms, identities, scaling and units; the batch against trajectories, scipy and (where it is
    installed) heyoka; derivatives against differences. Under a minute for all models on two cores.
    """
    start_engine()
    from rich.console import Console

    from erosion.verification import verify as verify_models
    from erosion.verification.result import HEADINGS

    console = Console(stderr=True, highlight=False)
    for name in models or []:
        load(name)
    with console.status("compiling") as status:
        found = verify_models(models or None, progress=lambda name, done, of: status.update(f"{done} of {of}: {name}"))
    if json:
        names = ("model", "name", "compares", "error", "bound", "passed", "where")
        checks = [{name: getattr(check, name) for name in names} for check in found.checks]
        print_json({"passed": found.passed, "absent": found.absent, "checks": checks})
    else:
        print_table(found.title, found.rows(), HEADINGS, (1, 2, 3))
        for check in found.failures:
            print(f"✗ {check}")
    for name in found.absent:
        warn(f"{name} is not installed: one reference solution fewer.")
    if not found.passed:
        raise RuntimeError(f"{len(found.failures)} of {len(found.checks)} checks are out of bounds.")
