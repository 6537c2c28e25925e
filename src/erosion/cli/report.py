"""`erosion report`: the scenario, answered."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.options import CaseOptions, start_engine, user_errors


def report(
    *,
    case: CaseOptions | None = None,
    out: Annotated[Path, Parameter(help="Folder for the page, its figures and numbers.")] = Path("report"),
    only: Annotated[str | None, Parameter(help='Only these questions: "q4,a1".')] = None,
) -> None:
    """Answer the scenario's questions for a case, on one self-contained page."""
    options = case or CaseOptions()
    p = options.parameters()
    start_engine()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from erosion.report.page import chosen_questions, make_folders, write_report

    name = "Table 1" if options.case is None else options.case.stem
    questions = None if only is None else [part.strip() for part in only.split(",") if part.strip()]
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True, highlight=False)
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    with user_errors():
        chosen_questions(questions)
        make_folders(out)
    with progress as shown:
        task = shown.add_task("report", total=None)

        def tell(line: str, done: int, parts: int) -> None:
            shown.update(task, description=f"{line:<21}", completed=done, total=parts)

        page = write_report(p, out, case_name=name, only=questions, progress=tell)
    print(page.resolve())
