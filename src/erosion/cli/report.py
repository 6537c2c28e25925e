"""`erosion report`: the scenario, answered."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import LISTED
from erosion.cli.options import CaseFile, CaseOptions, LangOption, with_file
from erosion.cli.output import require_apart
from erosion.cli.per_mass import PerMassOptions
from erosion.cli.progress import progress_bar


def report(
    file: CaseFile = None,
    /,
    *,
    case: CaseOptions | None = None,
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), help="Folder for the page, its figures and numbers.")
    ] = Path("report"),
    only: Annotated[
        list[str] | None,
        LISTED,
        Parameter(
            help='Only these parts: the questions "q1" to "q8", the harder ones "a1" to "a3", "slips" of the source, '
            'or "models" side by side; with commas: "q4,a1".'
        ),
    ] = None,
    brief: Annotated[
        bool,
        Parameter(negative="", show_default=False, help="Answers and figures alone; a question fits on a sheet of A4."),
    ] = False,
    abrasive: PerMassOptions | None = None,
    lang: LangOption = "en",
) -> None:
    """Answer the scenario's questions for a case, on one self-contained page."""
    options = with_file(case, file)
    p = options.parameters()
    per_mass = (abrasive or PerMassOptions()).per_mass(options)
    start_engine()
    from erosion.language import language
    from erosion.report.page import PARTS, chosen_questions, require_folder, write_report

    require_apart([output / part for part in PARTS], (options.case,))
    with user_errors():
        chosen_questions(only)
        language(lang)
        require_folder(output)
    with progress_bar("report") as progress:
        chosen = {"case_name": options.title(), "only": only, "brief": brief, "lang": lang, "per_mass": per_mass}
        page = write_report(p, output, **chosen, progress=progress)
    print(page.resolve())
