"""The verbs that list, check and teach, such as `materials`, `models`, `verify`, `exercise`, `report`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.options import (
    LISTED,
    CaseArgument,
    CaseOptions,
    JsonOption,
    ModelsOption,
    chosen_models,
    ending,
    output_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, progress_bar, require_apart, require_outputs
from erosion.extras import extra
from erosion.output import briefly
from erosion.results import Columns, Declared, Finding, Scale, Value

_NOTE = (
    "ψ of a target whose flow stress is its Vickers hardness is 2; the others leave ψ as it is. "
    'A table of your own in TOML has the same form: --target "mine.toml: my alloy".'
)


def materials(
    file: Annotated[Path | None, Parameter(help="A table of your own (TOML) instead of the package's.")] = None,
    /,
    *,
    json: JsonOption = False,
) -> None:
    """List the particles and targets that have a name, with sources."""
    before = "" if file is None else f"{file}: "
    with user_errors():
        # Any size will do: it is not shown.
        particles = [lazy.particle(f"{before}{name} 1 mm") for name in lazy.known_particles(file)]
        targets = [lazy.target(f"{before}{name}") for name in lazy.known_targets(file)]
    described = [
        Columns("particles", "Particles", [
            Value("name", [item.name for item in particles], "particle"),
            *_density(particles),
            *(Value(name, [getattr(item, name) for item in particles]) for name in ("hardness", "source")),
            Value("shape", [item.shape for item in particles], only="data"),
        ]),
        Columns("targets", "Targets", [
            Value("name", [item.name for item in targets], "target"),
            *_density(targets),
            *_with_range("flow_stress", targets, "Pa", Scale(1e6, "MPa")),
            Value("vickers", [item.vickers for item in targets], "hardness", scale=Scale(1.0, "HV")),
            Value("source", [item.source for item in targets]),
            Value("psi", [item.psi for item in targets], only="data"),
            Value("correlations", [list(item.correlations) for item in targets], only="data"),
        ]),
    ]  # fmt: skip
    title, notes = "Particles" if particles else "Targets", [_NOTE] if targets else []
    Output("materials", json=json).present(title, described, sentences=notes)


def _density(items: "Sequence[lazy.Particle | lazy.Target]") -> list[Value]:
    return _with_range("density", items, "kg/m^3", Scale(1.0, "kg/m³"))


def _with_range(name: str, items: Sequence[Any], unit: str, scale: Scale) -> list[Value]:
    """A number of each material, and its range where it has one."""
    words = name.replace("_", " ")
    return [
        Value(name, [getattr(item, name) for item in items], words, unit=unit, scale=scale, digits=4),
        Value(f"{name}_range", [getattr(item, f"{name}_range") for item in items], "range", unit=unit, scale=scale,
              digits=4),
    ]  # fmt: skip


def models(
    *,
    path: Annotated[
        Path | None,
        Parameter(help="Also list the model files in this folder. They are run as Python: list only what you trust."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List every model with its equations and its own parameters.

    A model that cannot be used is listed with the reason; the exit status is
    then 1. Correlations, which stand below the table, may be named wherever a
    model may.
    """
    with user_errors():
        catalogue = lazy.available_models(path)
    correlations = (
        f"Correlations of engineers can take the place of a model: {', '.join(lazy.CORRELATIONS)}. "
        'Some have a table of targets: "dnv:duplex".'
    )
    exponent = '"-exponent" behind a name multiplies its volumes by (v₀/100 m/s)^(n - 2), n = speed_exponent.'
    Output("models", json=json).present("", _listed(catalogue), sentences=[exponent, correlations])
    broken = [name for name, info in catalogue.items() if info.error]
    if broken:
        raise RuntimeError(f"{len(broken)} of {len(catalogue)} models cannot be used.")


def _listed(catalogue: "Mapping[str, lazy.ModelInfo]") -> list[Declared]:
    """A record of each model, and its lines in a table: what it says, and its own parameters."""
    own, infos = {name: _own(info) for name, info in catalogue.items()}, list(catalogue.values())
    described = [
        Value("name", [*catalogue]),
        *(Value(key, [getattr(info, key) for info in infos]) for key in ("summary", "equations", "error")),
        Value("own_parameters", [*own.values()]),
    ]
    rows: list[tuple[str, str]] = []
    for name, info in catalogue.items():
        rows.append((name, info.error or f"{info.summary}  {info.equations}"))
        for parameter, its in own[name].items():
            meaning = f"  {its['symbol']}, {its['meaning']}" if its["symbol"] != parameter else ""
            rows.append(("", f"{parameter} = {its['value']:g}{meaning}"))
    names, texts = map(list, zip(*rows, strict=True))
    shown = [Value("model", names), Value("text", texts, "what it says, and the source's equations")]
    return [
        Columns("models", "", described, keyed=True, only="data"),
        Columns("lines", "", shown, only="table"),
    ]


def _own(info: "lazy.ModelInfo") -> dict[str, dict[str, Any]]:
    """Value and names of a model's own parameters; none of a model that cannot be used."""
    own = {} if info.error else lazy.own_parameters(info.make())
    return {
        name: {
            "value": float(parameter.value),
            "symbol": parameter.quantity.symbol,
            "meaning": parameter.quantity.meaning,
        }
        for name, parameter in own.items()
    }


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
    output.show(verification, loaded)
    if not verification.passed:
        raise RuntimeError(f"{len(verification.failures)} of {len(verification.checks)} checks are out of bounds.")


def exercise(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    course: Annotated[
        Literal["scenario", "numerics"],
        Parameter(help="The scenario's questions, or numerical methods of one's own."),
    ] = "scenario",
    students: Annotated[
        Path | None,
        Parameter(help='A notebook and a case for each `id` or `name` of this table (.csv): "tasks-ada.ipynb".'),
    ] = None,
    seed: Annotated[
        int | None,
        Parameter(help="Draw the case, or the cases of the students, by this number; what options name stays."),
    ] = None,
    output: Annotated[Path, output_option("The notebook (.ipynb).", ".ipynb")] = Path("exercise.ipynb"),
    solved: Annotated[
        Path | None,
        Parameter(
            validator=ending(".ipynb"),
            help="Also write it with the solutions into this file (.ipynb), for the teacher.",
        ),
    ] = None,
    answers: Annotated[
        Path | None,
        Parameter(validator=ending(".csv"), help="Also write all cases and answers (.csv), for the teacher."),
    ] = None,
) -> None:
    """Make notebooks of tasks for students, which check their numbers.

    Questions 1 to 8 of the scenario and the additional ones, with hints and
    interpretation; or own Euler and Runge-Kutta steps, the end of the cut, the
    best angle by Newton's method, and where that method fails.
    """
    options = with_file(case, file)
    keys = _answer_keys(options, course, students, seed)
    title = options.title(options.system)
    notebooks = [
        *_notebooks(output, keys, title),
        *([] if solved is None else _notebooks(solved, keys, title, is_solved=True)),
    ]
    require_outputs(*(each.path for each in notebooks), answers, inputs=(options.case, students))
    with user_errors():
        for each in notebooks:
            each.write()
        if answers is not None:
            with progress_bar("solving the tasks") as progress:
                lazy.write_whole(answers, lazy.answers_table(keys, progress=progress).encode())
    for each in notebooks:
        print(each)
    if answers is not None:
        print(f"{answers.resolve()}: the answers")


class _Notebook(NamedTuple):
    """A notebook of tasks, of one student, or for the teacher with the solutions."""

    path: Path
    key: "lazy.AnswerKey"
    title: str
    is_solved: bool

    def write(self) -> None:
        """Write it."""
        lazy.write_whole(self.path, lazy.notebook(self.key, title=self.title, solved=self.is_solved).encode())

    def __str__(self) -> str:
        holds = "the same with solutions" if self.is_solved else f"{len(self.key.tasks)} tasks about {self.title}"
        return f"{self.path.resolve()}: {holds}"


def _answer_keys(
    options: CaseOptions, course: str, students: Path | None, seed: int | None
) -> "dict[str, lazy.AnswerKey]":
    """The tasks and answers of each student; those of "" where there are no students."""
    p = options.parameters()
    with user_errors():
        names = [""] if students is None else lazy.read_students(students)
        cases = dict.fromkeys(names, p)
        if students is not None or seed is not None:
            cases = {name: lazy.drawn_case(p, name, seed=seed or 0, kept=options.given()) for name in names}
        return {name: lazy.AnswerKey(drawn, course) for name, drawn in cases.items()}


def _notebooks(
    path: Path, keys: "Mapping[str, lazy.AnswerKey]", title: str, *, is_solved: bool = False
) -> Iterator[_Notebook]:
    """A notebook of each student: "tasks-ada.ipynb"; of the path itself for one without a name."""
    for name, key in keys.items():
        of_student = path.with_stem(f"{path.stem}-{name}") if name else path
        yield _Notebook(of_student, key, ", ".join(filter(None, (title, name))), is_solved)


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
    browser: Annotated[bool, Parameter(negative="--no-browser", help="Open the page in a browser.")] = True,
) -> None:
    """Explore cuts in the browser: sliders, live plots, exports."""
    options = with_file(case, file)
    p, weights = options.parameters(), (per_mass or PerMassOptions()).per_mass(options)
    for path in model or []:
        if not path.endswith(".py"):
            raise InputError(f"Option `--model` must be the path of a Python file here, but is {briefly(path)}.")
    if port is not None and not 0 <= port < 65536:
        raise InputError(f"Option `--port` must be in 0 … 65535, but is {port}.")
    named, _ = options.model()
    fitted = None if named is None else (named, options.load_as_set(named))
    if fitted is not None and isinstance(fitted[1], lazy.Correlated):
        options.warn_once(Finding("correlation_left_out", str(options.case), {"model": named}))
        fitted = None
    with extra("explorer"), user_errors():
        service = lazy.offer(p, model or [], materials or [], weights, fitted=fitted, file=options.file)
        lazy.serve(service, lazy.free_port(port), show=browser)


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
) -> None:
    """Answer the scenario's questions for a case, on one page."""
    options = with_file(case, file)
    p = options.parameters()
    per_mass = (abrasive or PerMassOptions()).per_mass(options)
    require_apart([output / part for part in lazy.PARTS], (options.case,))
    with user_errors():
        lazy.chosen_questions(only)
        lazy.require_folder(output)
    with progress_bar("report") as progress:
        chosen = {"case_name": options.title(p.shown_in), "only": only, "brief": brief, "per_mass": per_mass}
        page = lazy.write_report(p, output, **chosen, progress=progress)
    print(page.resolve())
