"""`erosion posterior` and `predict`: all values of parameters that data and priors leave, and the wear that follows."""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.calibrate import (
    DataFile,
    FitOptions,
    FitTask,
    WriteCaseOption,
    dimension_of,
    given_fit,
    samples_beside,
    write_case,
)
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.options import (
    DRAWS,
    FIT,
    LISTED,
    OUTPUT,
    AllAngles,
    CaseArgument,
    CaseOptions,
    JsonOption,
    ModelsOption,
    PlotOption,
    SetOption,
    TableOptions,
    WholeOption,
    output_option,
    require_unit,
    with_file,
)
from erosion.cli.output import Output, draw, progress_bar, require_outputs
from erosion.output import briefly
from erosion.parameters import QUANTITIES
from erosion.results import Finding, ValueGroup

_PRIOR = (
    'Law before the data, of a parameter, "noise", "relative_noise" or "error_factor" (on stated errors): '
    '"psi=uniform(0.01, 0.2)"; repeatable.'
)


@Parameter(name="*", group=OUTPUT)
@dataclasses.dataclass(frozen=True)
class _PosteriorFiles:
    """The files that are asked for, all of the likeliest model."""

    output: Annotated[
        Path | None,
        output_option("Keep the draws in this file (.nc), for predict, and --uncertain of other verbs.", ".nc"),
    ] = None
    case_file: WriteCaseOption = None
    plot_pairs: Annotated[Path | None, Parameter(help="Draw each pair of parameters.")] = None
    plot_traces: Annotated[Path | None, Parameter(help="Draw the populations, one draw after the other.")] = None
    plot_prediction: Annotated[Path | None, Parameter(help="Draw the bands of the curve, with its jumps.")] = None
    plot_best_angles: Annotated[Path | None, Parameter(help="Draw the angles of greatest removal.")] = None
    plot_next_test: Annotated[Path | None, Parameter(help="Draw what a test would narrow, over angle and speed.")] = (
        None
    )

    @property
    def samples(self) -> Path | None:
        """The file of draws, which a case file has beside it where it has no other name."""
        return self.output or samples_beside(self.case_file)

    @property
    def figures(self) -> dict[str, Path]:
        """The figures that are asked for, by the name of their function."""
        paths = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: path for name, path in paths.items() if name.startswith("plot_") and path is not None}

    def require_writable(self, inputs: Sequence[Any]) -> None:
        """Know before computing that all files can be written, and that none of them is read."""
        with user_errors():
            figures = [file for path in self.figures.values() for file in lazy.plot_files(path)]
        require_outputs(self.samples, self.case_file, *figures, inputs=inputs)

    def write(
        self,
        task: FitTask,
        ranking: "lazy.Ranking",
        posteriors: "lazy.PosteriorRanking",
        following: "lazy.NextTest | None",
        output: Output,
    ) -> None:
        """Write the files, first the draws, which take longest."""
        posterior = posteriors.best
        with user_errors():
            if self.samples is not None:
                posterior.save(self.samples)
        if self.case_file is not None:
            assert self.samples is not None  # beside the case file
            write_case(self.case_file, ranking, task, output, (posteriors, self.samples))
        with user_errors():
            for name, path in self.figures.items():
                result: Any = posterior.alpha_max() if name == "plot_best_angles" else posterior
                if name == "plot_next_test":
                    result = following
                draw(path, functools.partial(getattr(lazy, name), result))


_ANGLE_UNITS = ("deg", "°", "rad")
_Judge = Callable[["lazy.PosteriorRanking"], "lazy.NextTest"]


@Parameter(name="*", group=DRAWS)
@dataclasses.dataclass(frozen=True)
class _NextTests:
    """The tests among which the next one is looked for, and the prediction that it is for, as they are typed."""

    next_test: Annotated[
        bool, Parameter(negative="", show_default=False, help="Say which test narrows a prediction most.")
    ] = False
    next_angles: Annotated[str | None, Parameter(help='That can be tested next: "20deg:80deg:7".')] = None
    next_speeds: Annotated[
        list[str] | None, LISTED, Parameter(help='That can be tested next: "60 m/s,110 m/s"; or the data\'s.')
    ] = None
    next_particles: Annotated[list[str] | None, LISTED, Parameter(help='The same: "garnet 0.3 mm,garnet 0.6 mm".')] = (
        None
    )
    next_for: Annotated[
        list[str] | None, LISTED, Parameter(help='The prediction to narrow: "30 deg,60 m/s"; or the greatest wear.')
    ] = None

    def read(self, case: CaseOptions, free: Sequence[str]) -> "_Judge":
        """The function that says which test narrows most; what is typed is read before anything is computed."""
        given = case.read("next-angles", self.next_angles, "angle", _axis)
        with reading("Option `--next-angles`"):
            if given is not None and not ((given > 0) & (given <= np.pi / 2)).all():
                raise ValueError(f"must be above 0° and at most 90°, but is {self.next_angles}")
        speeds = [case.read("next-speeds", text, "speed") for text in self.next_speeds or ()]
        if not all(0 < speed < np.inf for speed in speeds):
            listed = ", ".join(self.next_speeds or ())
            raise InputError(f"Option `--next-speeds` must list positive speeds, but is {listed}.")
        with user_errors(fields={"particle": "Option `--next-particles`"}):
            sizes = [lazy.particle(text).parameters for text in self.next_particles or ()]
        for option, names in {
            "speeds": ["v0"] * bool(speeds),
            "particles": [name for one in sizes for name in one],
        }.items():
            if fitted := sorted({*names} & {*free}):
                raise InputError(f"Option `--next-{option}` must be left out, because {', '.join(fitted)} is fitted.")

        asked = {}
        for text in self.next_for or ():
            name = "alpha" if lazy.unit_of(text) in _ANGLE_UNITS else "v0"
            asked[name] = case.read("next-for", text, QUANTITIES[name].dimension)
        lazy.refuse(
            "Option `--next-for` must ",
            (len(asked) != len(self.next_for or ()), "give one angle and one speed at most."),
            (not 0 < asked.get("alpha", 1.0) <= np.pi / 2, "have an angle above 0° and at most 90°."),
            (not 0 < asked.get("v0", 1.0) < np.inf, "have a positive speed."),
            ("v0" in asked and "v0" in free, "have no speed, because v0 is fitted."),
            kind=InputError,
        )  # fmt: skip

        def judge(posteriors: "lazy.PosteriorRanking") -> "lazy.NextTest":
            """Of all models together; without angles, speeds and sizes, among those of the data."""
            angles = np.deg2rad(lazy.tested_degrees(posteriors.best.data)) if given is None else given
            at = _conditions(posteriors.best.likelihood.problem, speeds or None, sizes)
            others: dict[str, Any] = {name: np.array([one[name] for one in at]) for name in at[0]}
            candidates = lazy.InSI(alpha=angles[:, None], **others)
            return lazy.next_test(posteriors.fits, candidates, for_prediction=lazy.InSI(asked))

        return judge


def posterior(
    data: DataFile,
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    table: Annotated[TableOptions | None, Parameter(group=FIT)] = None,
    fit: FitOptions | None = None,
    prior: Annotated[list[str] | None, Parameter(negative="", group=DRAWS, help=_PRIOR)] = None,
    draws: Annotated[WholeOption, Parameter(group=DRAWS, help="Of each of 4 populations; 500 without it.")] = None,
    seed: Annotated[WholeOption, Parameter(group=DRAWS, help="The same seed gives the same draws.")] = None,
    level: Annotated[float, Parameter(group=DRAWS, help="Of the intervals.")] = 0.95,
    discrepancy: Annotated[
        Literal["averaged", "none"],
        Parameter(group=DRAWS, help="What the model may lack, for predictions; averaged by evidence."),
    ] = "averaged",
    next_tests: _NextTests | None = None,
    files: _PosteriorFiles | None = None,
    json: JsonOption = False,
) -> None:
    """Draw all values of a model's parameters that data and priors leave.

    Data, case and models are those of `erosion calibrate`, whose fit comes first:
    a model that misses the data is not drawn. Several models are ordered by their
    evidence; all files are of the likeliest one.
    """
    task, files = given_fit(data, with_file(case, file), fit, model, own, table), files or _PosteriorFiles()
    files.require_writable(task.inputs)
    next_tests = next_tests or _NextTests()
    judge = next_tests.read(task.options, task.fit.free)
    models = task.models()
    output = Output("posterior", task.p, task.options, json=json, seed=seed or 0)
    with user_errors(), progress_bar("reading") as progress:
        lazy.check_share("level", level)
        measured = task.measured(output)
        laws = _read_priors(prior or (), task.fit.names(measured), models, measured, task.options)
        ranking = task.ranking(models, measured, {"priors": laws}, progress, level=level)
        options = {"draws": 500 if draws is None else draws, "seed": seed or 0, "level": level}

        def drawn(problem: "lazy.FitProblem", of_all: "lazy.Progress") -> "lazy.Posterior":
            return lazy.posterior(problem, **options, discrepancy=discrepancy == "averaged", progress=of_all)

        with warnings.catch_warnings():
            # The result says it in its own sentences.
            warnings.simplefilter("ignore", lazy.ConvergenceWarning)
            posteriors = lazy.rank(*lazy.fit_each([fit.problem for fit in ranking.ranked], drawn, progress))
        predictor = posteriors.best.prepared(progress)
        ranking = ranking.preferring(posteriors.names[0])
        is_asked = next_tests != _NextTests() or files.plot_next_test
        following = judge(posteriors) if is_asked else None
    # Draws take longer than any file: they are shown first.
    output.warn(*ranking.findings, *posteriors.findings, *predictor.findings)
    others = {"prediction": predictor, "next_test": following}
    also = [ValueGroup(name, other.declare(), other.title) for name, other in others.items() if other is not None]
    of_models = dict(zip(ranking.names, (fit.model for fit in ranking.fits), strict=True))
    output.show(posteriors, of_models, [ValueGroup("", ranking.declare(), only="data"), *also], name="posterior")
    files.write(task, ranking, posteriors, following, output)
    figures = [f"{name.removeprefix('plot_')}: {file}" for name, path in files.figures.items()
               for file in lazy.plot_files(path)]  # fmt: skip
    steps = [*task.next_steps(ranking, files.case_file, files.samples), *([following.sentence] if following else [])]
    output.wrote(*figures, *steps, draws=files.samples, case=files.case_file)


def _read_priors(
    texts: Sequence[str],
    free: Sequence[str],
    models: Sequence[Any],
    measured: "lazy.Measurements",
    case: CaseOptions,
) -> "lazy.InSI":
    """Laws such as "psi=uniform(0.01, 0.2)", by parameter."""
    known = (*free, *((lazy.NOISE, lazy.RELATIVE) if measured.uncertainty is None else (lazy.ERROR_FACTOR,)))
    laws = lazy.InSI()
    for text in texts:
        name, _, law = (part.strip() for part in text.partition("="))
        lazy.refuse(
            "Option `--prior` must ",
            (name not in known,
             f'be such as "{known[0]}=uniform(1, 3)", of {", ".join(known)}, but is {briefly(text)}.'),
            (name in laws, f"give {name} once, but gives it several times."),
            kind=InputError,
        )  # fmt: skip
        dimension = measured.dimension if name == lazy.NOISE else dimension_of(name, models)
        case.require_unit(f"--prior {name}=", law, dimension)
        with reading(f"Option `--prior`, {name},"):
            read = lazy.read_law(law, name, dimension, measured.shown_in)
        if read is None:
            listed = ", ".join((*lazy.LAWS, "samples"))
            raise InputError(f"Option `--prior`, {name}, must be a law ({listed}), but is {briefly(law)}.")
        laws[name] = read
    return laws


def predict(
    fitted: Annotated[Path, Parameter(help="The file of `erosion posterior -o` (.nc).")],
    /,
    *,
    alpha: Annotated[
        str, Parameter(help='Angles: "35 deg", "20deg, 40deg" or first : last : count.')
    ] = "10deg:90deg:9",
    v0: Annotated[str | None, Parameter(help='Speeds: "60 m/s, 120 m/s"; those of the tests without it.')] = None,
    particle: Annotated[
        str | None, Parameter(help='For r, b and m, as "garnet 0.5 mm"; those of the tests without it.')
    ] = None,
    level: Annotated[float, Parameter(help="Of the intervals.")] = 0.95,
    unit: Annotated[str | None, Parameter(help='Of the wear: "g/kg"; that of the tests without it.')] = None,
    output: Annotated[Path | None, output_option("Write the table into this file (.csv).", ".csv")] = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Predict the wear from a fit, with honest intervals.

    The table has the mean at each angle and speed, the interval of the mean and
    that of a new weighing. A warning says how far a question lies outside the
    tests.
    """
    with user_errors():
        lazy.check_share("level", level)
        predictor = lazy.read_predictor(fitted)
        draws = lazy.read_draws(fitted, lazy.quantities(predictor.problem.model))
    if unit is not None:
        with reading("Option `--unit`"):
            predictor = predictor.in_unit(unit)
    printed = Output("predict", predictor.problem.p, json=json, seed=predictor.seed, plot=plot, files={"table": output},
                     inputs=[fitted])  # fmt: skip
    printed.case = fitted
    speeds = None if v0 is None else _asked("v0", v0).tolist()
    with user_errors():
        sizes = [] if particle is None else [lazy.particle(particle).parameters]
    at = _conditions(predictor.problem, speeds, sizes)
    asked = np.tile(_asked("alpha", alpha), (len(at), 1))
    others = lazy.InSI({name: np.array([[one[name]] for one in at]) for name in at[0]})
    with user_errors(), progress_bar("predicting"):
        lazy.validate(dataclasses.replace(predictor.problem.p, alpha=asked, **others))
        table = lazy.predict(predictor, asked, others, level=level)
    printed.warn(None if draws.converged else Finding("not_converged", str(fitted)))
    model = predictor.problem.model
    varied = {name: f"{len(set(column.tolist()))} values" for name, column in table.asked.items()}
    varied |= dict.fromkeys(predictor.problem.names, "drawn")
    printed.save(
        figure=lambda: lazy.plot_means(predictor, at),
        table=lambda path: lazy.write_whole(path, table.to_csv_as_shown().encode()),
    )
    printed.show(table, {lazy.model_name(model): model}, varied=varied)


def _axis(text: str, dimension: "lazy.Dimension", bare: "lazy.System" = "si") -> Any:
    """The values of an axis or of a single number, shape (n,)."""
    return np.atleast_1d(lazy.read_axis(text, dimension, bare))


def _asked(name: str, text: str) -> Any:
    """The values of a parameter that a prediction is asked for, shape (n,); each has its unit."""
    dimension = QUANTITIES[name].dimension
    require_unit(f"--{name} ", text, dimension)
    with reading(f"Option `--{name}`"):
        return _axis(text, dimension)


def _conditions(
    problem: "lazy.FitProblem", speeds: Sequence[float] | None, sizes: Sequence[Mapping[str, float]]
) -> "list[lazy.InSI]":
    """What is asked beside the angle, each once: the speeds and masses of the tests, or those of the options."""
    usual = {} if "v0" in problem.names else {"v0": float(problem.p.v0)}
    groups = [{**usual, **group.values, **size}
              for group in lazy.conditions(problem.data, lazy.MOST) for size in sizes or [{}]]  # fmt: skip
    if speeds is not None:
        groups = [{**group, "v0": speed} for group in groups for speed in speeds]
    return [lazy.InSI(each) for each in dict.fromkeys(tuple(group.items()) for group in groups)]
