"""`erosion exercise`: a notebook of tasks about a case."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli.errors import InputError, user_errors
from erosion.cli.kept_programs import start_engine
from erosion.cli.options import CaseFile, CaseOptions, with_file
from erosion.cli.output import require_outputs
from erosion.cli.progress import working


def exercise(
    file: CaseFile = None,
    /,
    *,
    case: CaseOptions | None = None,
    output: Annotated[Path, Parameter(name=("--output", "-o"), help="The notebook (.ipynb).")] = Path("exercise.ipynb"),
    solved: Annotated[
        Path | None, Parameter(help="Also write it with the solutions into this file (.ipynb), for the teacher.")
    ] = None,
) -> None:
    """Make a notebook of tasks for students, which checks their numbers.

    Own Euler and Runge-Kutta steps against the tool, the end of the cut, the
    volume, the best angle by Newton's method, and where that method fails.
    """
    for option, path in (("output", output), ("solved", solved)):
        if path is not None and path.suffix != ".ipynb":
            raise InputError(f"Option `--{option}` must end in .ipynb, but is {path}.")
    options = with_file(case, file)
    p = options.parameters()
    require_outputs(output, solved, inputs=(options.case,))
    start_engine()
    from erosion.exercises import AnswerKey
    from erosion.exercises.notebook import notebook
    from erosion.files import write_whole

    name = options.title()
    with user_errors(), working("solving the tasks"):
        key = AnswerKey(p)
        texts = {path: notebook(key, title=name, solved=path == solved) for path in (output, solved) if path}
        for path, text in texts.items():
            write_whole(path, text.encode())
    print(f"{output.resolve()}: {len(key.tasks)} tasks about {name}")
    if solved is not None:
        print(f"{solved.resolve()}: the same with solutions")
