"""The verbs that list, check and teach, such as `materials`, `models`, `verify`, `exercise`, `report`."""

from pathlib import Path
from typing import Annotated, Any, Literal

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
from erosion.results import Finding

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
    output = Output("materials", json=json)
    output.document({"particles": [*map(_particle, particles)], "targets": [*map(_target, targets)]})
    rows = [(item.name, _span(item.density, item.density_range), item.hardness, item.source) for item in particles]
    if rows:
        output.table("Particles", rows, ("particle", "density [kg/m³]", "hardness", "source"), (1,))
    if targets:
        output.table("Targets", [_row(item) for item in targets], _TARGET, (1, 2), [_NOTE])


_TARGET = ("target", "density [kg/m³]", "flow stress [MPa]", "by", "source")


def _row(item: "lazy.Target") -> tuple[str, ...]:
    density = "" if item.density is None else _span(item.density, item.density_range)
    low, high = item.flow_stress_range
    stress = _span(item.flow_stress / 1e6, (low / 1e6, high / 1e6))
    return item.name, density, stress, "" if item.vickers is None else f"{item.vickers:g} HV", item.source


def _span(value: float, ends: tuple[float, float] | None) -> str:
    """A value, and the range where it has one."""
    low, high = ends or (value, value)
    return f"{value:.4g}" if low == high else f"{value:.4g} ({low:.4g} to {high:.4g})"


def _particle(item: "lazy.Particle") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            "hardness": item.hardness, "shape": item.shape, "source": item.source}  # fmt: skip


def _target(item: "lazy.Target") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            **_quantity("flow_stress", item.flow_stress, "Pa", item.flow_stress_range),
            "vickers": item.vickers, "psi": item.psi, "correlations": list(item.correlations),
            "source": item.source}  # fmt: skip


def _quantity(name: str, value: float | None, unit: str, ends: tuple[float, float] | None) -> dict[str, Any]:
    return {name: {"value": value, "unit": unit}, f"{name}_range": {"value": list(ends or ()), "unit": unit}}


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
    output = Output("models", json=json)
    own = {name: _own(info) for name, info in catalogue.items()}
    described = {
        name: {key: getattr(info, key) for key in ("summary", "equations", "error")} | {"own_parameters": own[name]}
        for name, info in catalogue.items()
    }
    output.document({"models": described})
    rows: list[tuple[str, str]] = []
    for name, info in catalogue.items():
        rows.append((name, info.error or f"{info.summary}  {info.equations}"))
        for parameter, its in own[name].items():
            meaning = f"  {its['symbol']}, {its['meaning']}" if its["symbol"] != parameter else ""
            rows.append(("", f"{parameter} = {its['value']:g}{meaning}"))
    correlations = (
        f"Correlations of engineers can take the place of a model: {', '.join(lazy.CORRELATIONS)}. "
        'Some have a table of targets: "dnv:duplex".'
    )
    exponent = '"-exponent" behind a name multiplies its volumes by (v₀/100 m/s)^(n - 2), n = speed_exponent.'
    heads = ("model", "what it says, and the source's equations")
    output.table("", rows, heads, (), [exponent, correlations])
    broken = [name for name, info in catalogue.items() if info.error]
    if broken:
        raise RuntimeError(f"{len(broken)} of {len(catalogue)} models cannot be used.")


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
    p = options.parameters()
    title = options.title(p.units)
    with user_errors():
        names = [""] if students is None else lazy.read_students(students)
        cases = dict.fromkeys(names, p)
        if students is not None or seed is not None:
            cases = {name: lazy.drawn_case(p, name, seed=seed or 0, kept=options.given()) for name in names}
        keys = {name: lazy.AnswerKey(drawn, course) for name, drawn in cases.items()}
    handed_out, for_teacher = _each(output, names), {} if solved is None else _each(solved, names)
    require_outputs(*handed_out.values(), *for_teacher.values(), answers, inputs=(options.case, students))

    with user_errors():
        for name, key in keys.items():
            called = ", ".join(filter(None, (title, name)))
            lazy.write_whole(handed_out[name], lazy.notebook(key, title=called).encode())
            if solved is not None:
                lazy.write_whole(for_teacher[name], lazy.notebook(key, title=called, solved=True).encode())
        if answers is not None:
            with progress_bar("solving the tasks") as progress:
                lazy.write_whole(answers, lazy.answers_table(keys, progress=progress).encode())
    count = len(keys[names[0]].tasks)
    for name, path in handed_out.items():
        print(f"{path.resolve()}: {count} tasks about {', '.join(filter(None, (title, name)))}")
    for path in for_teacher.values():
        print(f"{path.resolve()}: the same with solutions")
    if answers is not None:
        print(f"{answers.resolve()}: the answers")


def _each(path: Path, students: list[str]) -> dict[str, Path]:
    """A file for each student: "tasks-ada.ipynb"; the path itself for one without a name."""
    return {name: path.with_stem(f"{path.stem}-{name}") if name else path for name in students}


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
        chosen = {"case_name": options.title(p.units), "only": only, "brief": brief, "per_mass": per_mass}
        page = lazy.write_report(p, output, **chosen, progress=progress)
    print(page.resolve())
