"""`erosion exercise`, `erosion explore` and `erosion report`: the verbs that make pages and notebooks."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.lists import LISTED, ModelsOption
from erosion.cli.options import CaseArgument, CaseOptions, LangOption, ending, output_option, with_file
from erosion.cli.output import PerMassOptions, progress_bar, require_apart, require_outputs
from erosion.extras import extra
from erosion.output.tables import briefly


def exercise(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    output: Annotated[Path, output_option("The notebook (.ipynb).", ".ipynb")] = Path("exercise.ipynb"),
    solved: Annotated[
        Path | None,
        Parameter(
            validator=ending(".ipynb"),
            help="Also write it with the solutions into this file (.ipynb), for the teacher.",
        ),
    ] = None,
    lang: LangOption = "en",
) -> None:
    """Make a notebook of tasks for students, which checks their numbers.

    Own Euler and Runge-Kutta steps against the tool, the end of the cut, the
    volume, the best angle by Newton's method, and where that method fails.
    """
    options = with_file(case, file)
    p = options.parameters()
    require_outputs(output, solved, inputs=(options.case,))

    name = options.title(p.units)
    with user_errors(), progress_bar("solving the tasks"):
        key = lazy.AnswerKey(p, lang)
        texts = {path: lazy.notebook(key, title=name, solved=path == solved) for path in (output, solved) if path}
        for path, text in texts.items():
            lazy.write_whole(path, text.encode())
    print(f"{output.resolve()}: {len(key.tasks)} tasks about {name}")
    if solved is not None:
        print(f"{solved.resolve()}: the same with solutions")


_PORT = 8080


def explore(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    per_mass: PerMassOptions | None = None,
    model: Annotated[
        ModelsOption,
        Parameter(help="Also offer the models in these Python files: with commas, or the option repeated."),
    ] = None,
    materials: Annotated[
        list[Path] | None,
        Parameter(negative="", help="Also offer the particles and targets of this table (TOML); it may be repeated."),
    ] = None,
    port: Annotated[int | None, Parameter(help=f"Listen on this port; {_PORT}, or a free one, without it.")] = None,
    host: Annotated[
        str,
        Parameter(
            help="Listen on this address of the machine, for other devices of a network that you trust: 0.0.0.0 for "
            "all. They need the link that is printed."
        ),
    ] = "127.0.0.1",
    browser: Annotated[bool, Parameter(negative="--no-browser", help="Open the page in a browser.")] = True,
    lang: LangOption = "en",
) -> None:
    """Explore cuts in the browser: sliders, live plots, exports."""
    options = with_file(case, file)
    p, weights = options.parameters(), (per_mass or PerMassOptions()).per_mass(options)
    for path in model or []:
        if not path.endswith(".py"):
            raise InputError(f"Option `--model` must be the path of a Python file here, but is {briefly(path)}.")
    if port is not None and not 0 <= port < 65536:
        raise InputError(f"Option `--port` must be in 0 … 65535, but is {port}.")
    with extra("explorer"), user_errors():
        service = lazy.offer(p, model or [], materials or [], weights, lang)
        lazy.serve(service, lazy.free_address(host, port), show=browser)


def report(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    output: Annotated[Path, output_option("Folder for the page, its figures and numbers.")] = Path("report"),
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
    """Answer the scenario's questions for a case, on one page."""
    options = with_file(case, file)
    p = options.parameters()
    per_mass = (abrasive or PerMassOptions()).per_mass(options)
    require_apart([output / part for part in lazy.PARTS], (options.case,))
    with user_errors():
        lazy.chosen_questions(only)
        lazy.language(lang)
        lazy.require_folder(output)
    with progress_bar("report") as progress:
        chosen = {"case_name": options.title(p.units), "only": only, "brief": brief, "lang": lang, "per_mass": per_mass}
        page = lazy.write_report(p, output, **chosen, progress=progress)
    print(page.resolve())
