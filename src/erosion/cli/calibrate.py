"""`erosion calibrate` and `advise`: a model against measured erosion, and the nozzle's angle that follows."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.options import (
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
    Settings,
    TableOptions,
    WholeOption,
    chosen_models,
    is_same_model,
    model_and_settings,
    output_option,
    refuse_same,
    settings,
    with_file,
    with_model_of_case,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing
from erosion.output import briefly
from erosion.results import Finding, ValueGroup, found, stated, unique

_DATA = (
    'CSV file, headed "angle [deg], volume [mm^3/impact], uncertainty [mm^3]", or "angle [deg], speed [m/s], '
    'mass_loss [mg/kg]" with --target or --density.'
)
DataFile = Annotated[Path, Parameter(help=_DATA)]
_FREE = 'Of case or model, "k,energy_ratio"; k and ψ without it.'


@Parameter(name="*", group=FIT)
@dataclasses.dataclass(frozen=True)
class FitOptions(PerMassOptions):
    """Options of a fit: free parameters, errors of rows, starts."""

    free: Annotated[list[str], LISTED, Parameter(help=_FREE, show_default=False)] = dataclasses.field(
        default_factory=list
    )
    error: Annotated[str | None, Parameter(help='Without a column: "0.3 mg/kg + 8 % + 5 % of each speed".')] = None
    per: Annotated[str | None, Parameter(help='Of amounts such as [mg]: "impact", or abrasive "100 g".')] = None
    starts: Annotated[WholeOption, Parameter(help="Points to begin from; 32 without it.")] = None

    def names(self, measured: "lazy.Measurements") -> Sequence[str]:
        """All that is fitted: the free parameters, and a scale where the data has one of its own."""
        return (*self.free, lazy.SCALE) if measured.free_scale else self.free


@dataclasses.dataclass(frozen=True)
class FitTask:
    """Data, case and models of a fit; `given_fit` makes it of the options.

    Args:
        data: the file of measurements.
        table: how it is read.
        options: the case.
        p: the same as numbers.
        fit: what is free, with the density and the cutting fraction of the case where the options give none.
        names: the models.
        own: what is set of the only model.
    """

    data: Path
    table: TableOptions
    options: CaseOptions
    p: "lazy.Parameters"
    fit: FitOptions
    names: list[str]
    own: Settings

    @property
    def inputs(self) -> tuple[Any, ...]:
        """The files that the verb reads."""
        return self.data, self.options.case, *self.names

    def models(self) -> "list[lazy.CuttingModel]":
        """The models, all of them different and of the target's metal."""
        own = self.own if len(self.names) == 1 else {}
        models = [self.options.load_as_set(name, own) for name in self.names]
        refuse_same(dict(zip(self.names, models, strict=True)))
        for model in models:
            weighing(model, self.fit, self.options)  # refuses the density of another metal than a correlation's
        return models

    def measured(self, output: Output) -> "lazy.Measurements":
        """The measurements; columns that are not used are a warning."""
        fit = self.fit
        measured = lazy.read_measurements(
            self.data, self.p.shown_in, error=fit.error, per=fit.per, **self.table.arguments
        )
        if measured.unused:
            output.warn(Finding("unused_columns", str(self.data), {"columns": measured.unused}))
        output.warn(*map(stated, measured.notes))
        return measured

    def ranking(
        self,
        models: "Sequence[lazy.CuttingModel]",
        measured: "lazy.Measurements",
        limits: Mapping[str, Any],
        progress: "lazy.Progress",
        **options: Any,
    ) -> "lazy.Ranking":
        """The fits of the models.

        Args:
            models: with what is set.
            measured: the tests.
            limits: the bounds or the priors of the problems.
            progress: of `progress_bar`.
            **options: of `calibrate`.
        """
        problems = lazy.FitProblem.of_models(
            models, self.p, measured, self.fit.free, density=self.fit.density,
            cutting_fraction=self.fit.cutting_fraction, **limits,
        )  # fmt: skip
        starts = 32 if self.fit.starts is None else self.fit.starts

        def fit(problem: "lazy.FitProblem", _: "lazy.Progress") -> "lazy.Calibration":
            return lazy.calibrate(problem, starts=starts, **options)

        return lazy.rank(*lazy.fit_each(problems, fit, progress))

    def next_steps(self, ranking: "lazy.Ranking", case_file: Path | None, draws: Path | None = None) -> list[str]:
        """The commands for the best angle, the advice and CFD codes, by the files that are written."""
        wear = [] if draws is None else [f"wear at other angles and speeds: {lazy.command('predict', str(draws))}"]
        if case_file is not None:
            path = str(case_file)
            return [
                *wear,
                f"the best angle of this fit: {lazy.command('optimum', path)}",
                f"a nozzle's angle by this fit: {lazy.command('advise', path)}",
                f"for CFD codes: {lazy.command('export', path, '--fluent', 'angles.csv')}",
            ]
        if draws is not None:
            words = self.options.words(ranking.best.names)
            return [*wear, f"a nozzle's angle by this fit: {lazy.command('advise', *words, '--uncertain', str(draws))}"]
        return ["a nozzle's angle: --write-case fitted.toml, then erosion advise fitted.toml"]


def given_fit(
    data: Path,
    case: CaseOptions,
    fit: FitOptions | None,
    model: list[str] | None,
    own: list[str] | None,
    table: TableOptions | None,
) -> FitTask:
    """The fit that options ask for.

    Args:
        data: the file of measurements.
        case: without a file and --units, Table 1 in the unit system of the data.
        fit: what is free.
        model: the option --model; without it and free parameters `USUAL_MODELS`.
        own: the options --set.
        table: how the file is read.
    """
    table = table or TableOptions()
    if case.case is None and case.units is None:
        if data.is_fifo():
            raise InputError(f"{data} is no file: beside it give `--units si`, `--units inch-pound` or a case file.")
        case = dataclasses.replace(case, usual_units=lazy.unit_system(data, **table.arguments))
    case.refuse_given("the angles are those of the data", "alpha")
    fit = fit or FitOptions()
    is_usual = model is None and not own and not fit.free and case.model()[0] is None
    fit = dataclasses.replace(fit, free=fit.free or [*(lazy.USUAL_FREE if is_usual else lazy.FREE)])
    p = case.parameters(free=fit.free)
    per_mass = fit.per_mass(case)
    density = None if per_mass.density is None else f"{per_mass.density!r} kg/m^3"
    fit = dataclasses.replace(fit, density=density, cutting_fraction=per_mass.cutting_fraction)
    usual, of_model = model_and_settings(None if model is None else model[0], own, case)
    names = [*lazy.USUAL_MODELS] if is_usual else [usual] if model is None else chosen_models(model)
    lazy.refuse(
        "Option ",
        (len(set(names)) != len(names),
         f"`--model` must name one or several different models, but is {','.join(names)!r}."),
        (own and len(names) > 1, f"`--set` needs one model, but `--model` names {', '.join(names)}."),
        kind=InputError,
    )  # fmt: skip
    return FitTask(data, table, case, p, fit, names, of_model)


def dimension_of(name: str, models: Sequence[Any]) -> "lazy.Dimension":
    """The dimension of a parameter of an impact, of one of the models (names or models), or of a factor."""
    with user_errors():
        known = [lazy.QUANTITIES, *(lazy.quantities(lazy.load_model(model)) for model in models)]
    return next((quantities[name].dimension for quantities in known if name in quantities), "1")


WriteCaseOption = Annotated[
    Path | None,
    Parameter(
        name="--write-case",
        group=OUTPUT,
        help="The best fit as a case file; its samples beside it (.nc).",
    ),
]


def samples_beside(case_file: Path | None) -> Path | None:
    """The file of samples that belongs to a case file."""
    return None if case_file is None else case_file.with_suffix(".nc")


def write_case(
    path: Path,
    ranking: "lazy.Ranking",
    task: FitTask,
    output: Output,
    drawn: "tuple[lazy.PosteriorRanking, Path] | None" = None,
) -> Path | None:
    """Write the best fit as a case file, and the file of its samples.

    Args:
        path: of the case file.
        ranking: the fits.
        task: what was asked.
        output: of the verb.
        drawn: posteriors and the file of the best one, which is written already: the case file refers to it.

    Returns:
        The file of samples to which the case file refers; None, with a finding, where there is no parameter of an
        impact to sample.
    """
    findings = ranking.findings_of_best
    with user_errors(lazy.CalibrationError):
        try:
            (ranking.best if drawn is None else drawn[0].best).joint_samples()
            samples = ranking.best.save(path.with_suffix(".nc"), findings) if drawn is None else drawn[1]
        except lazy.SamplingError:
            samples = None
            output.warn(Finding("case_without_draws", str(path)))
        options = task.options.names()
        text = lazy.to_case(ranking.best, str(path), **options, findings=findings, samples=samples)
        lazy.write_whole(path, text.encode())
    return samples


_BOUNDS = 'Least and greatest: "psi=0.01:0.3,threshold=0:40 m/s".'


def calibrate(
    data: DataFile,
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    model: ModelsOption = None,
    own: SetOption = None,
    table: Annotated[TableOptions | None, Parameter(group=FIT)] = None,
    fit: FitOptions | None = None,
    bounds: Annotated[list[str] | None, LISTED, Parameter(group=FIT, help=_BOUNDS)] = None,
    loss: Annotated[str, Parameter(group=FIT, help="Or soft_l1, for outliers.")] = "linear",
    level: Annotated[float, Parameter(group=FIT, help="Of the confidence intervals.")] = 0.95,
    profile: Annotated[str | None, Parameter(group=FIT, help="Also the likelihood along this parameter.")] = None,
    plot: Annotated[PlotOption, Parameter(help='Draw data, fits and band: "a.svg"; "a.png,a.pdf@84mm".')] = None,
    case_file: WriteCaseOption = None,
    json: JsonOption = False,
) -> None:
    """Fit a model to measured erosion, or rank several models.

    Without --model and --free, linearized is fitted with and without deformation.
    Without a case file and --units, what is printed is in the units of the data.
    `erosion posterior` draws all values that data leave.
    """
    task = given_fit(data, with_file(case, file), fit, model, own, table)
    require_outputs(case_file, samples_beside(case_file), plot=plot, inputs=task.inputs)
    models = task.models()
    output = Output("calibrate", task.p, task.options, json=json)
    with user_errors(), progress_bar("reading") as progress:
        lazy.check_share("level", level)
        measured = task.measured(output)
        names = task.fit.names(measured)
        ends = _read_bounds(bounds or (), names, task.names, task.options)
        if profile is not None and profile not in names:
            raise InputError(f"Option `--profile` must be one of {', '.join(names)}, but is {briefly(profile)}.")
        ranking = task.ranking(models, measured, {"bounds": ends}, progress, loss=loss, level=level)
        along = None if profile is None else ranking.best.profile(profile)
    # A fit takes longer than any file: it is shown first.
    also = [] if along is None else [ValueGroup("profile", along.declare())]
    output.show(ranking, dict(zip(ranking.names, (fit.model for fit in ranking.fits), strict=True)), also)
    samples = None if case_file is None else write_case(case_file, ranking, task, output)
    draw(plot, lambda: lazy.plot_calibration(ranking.best_first, level))
    output.wrote(*task.next_steps(ranking, case_file, samples), figure=plot, case=case_file, samples=samples)


def _read_bounds(texts: Sequence[str], free: Sequence[str], models: Sequence[str], case: CaseOptions) -> "lazy.InSI":
    """Bounds such as "psi=0.01:0.3", by parameter."""
    bounds = lazy.InSI()
    for text in texts:
        name, equals, ends = (part.strip() for part in text.partition("="))
        least, colon, greatest = (part.strip() for part in ends.partition(":"))
        lazy.refuse(
            "Option `--bounds` must ",
            (not (name and equals and least and colon and greatest),
             f'be such as "psi=0.01:0.3", but is {briefly(text)}.'),
            (name not in free, f"name free parameters ({', '.join(free)}), but has {briefly(name)}."),
            (name in bounds, f"give {name} once, but gives it several times."),
            kind=InputError,
        )  # fmt: skip
        dimension = dimension_of(name, models)
        source, typed = f"Option `--bounds`, {name},", f"--bounds {name}={least}:"
        bounds[name] = case.read_ends(source, typed, (least, greatest), dimension)
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"Option `--bounds` must give {name} two ascending values, but is {briefly(text)}.")
    return bounds


@Parameter(name="*", group=Group("Job", sort_key=7))
@dataclasses.dataclass(frozen=True)
class JobOptions:
    """Options of a job: the volume to remove, and another abrasive to compare."""

    area: Annotated[str | None, Parameter(help='To remove from, for kg of abrasive: "2 m^2".')] = None
    depth: Annotated[str | None, Parameter(help='To remove: "50 um".')] = None
    feed: Annotated[str | None, Parameter(help='Abrasive, for the time: "5 kg/min".')] = None
    compare: Annotated[str | None, Parameter(help='Another abrasive: "aluminium oxide 0.2 mm".')] = None

    def job(self, case: CaseOptions) -> "lazy.Job | None":
        """The job, where there is one."""
        area = case.read("area", self.area, "area")
        depth = case.read("depth", self.depth, "length")
        feed = case.read("feed", self.feed, "mass flow")
        if area is None and depth is None and feed is None:
            return None
        if area is None or depth is None:
            raise InputError("--area and --depth belong together: give both.")
        with user_errors():
            return lazy.Job(area, depth, feed)

    def other(self, case: CaseOptions) -> Any:
        """The other abrasive, where there is one."""
        with user_errors():
            return lazy.compared_with(self.compare, *case.materials())


FIELDS = ("model", "set", "uncertain", "correlation", "warning", "data", "reading", "tested", "equations")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class TestedFitOptions:
    """Options on tests of the metal; texts as they are typed."""

    uncertain: Annotated[list[str] | None, Parameter(negative="", help=_UNCERTAIN)] = None
    own: SetOption = None


def _are_options(typed: Any) -> bool:
    """Whether a value is a table with a text for each option, and for `prior` with a text for each parameter."""
    if not isinstance(typed, Mapping):
        return False
    priors = typed.get("prior", {})
    texts = [text for option, text in typed.items() if option != "prior"]
    return isinstance(priors, Mapping) and all(isinstance(text, str) for text in (*texts, *priors.values()))


class GivenFit:
    """The options with the table [advise] of the case file; options win.

    Args:
        options: of the fit.
        case: of the impact.
        models: the option --model, which wins over the model that the file names.
    """

    def __init__(self, options: TestedFitOptions, case: CaseOptions, models: Sequence[str] | None) -> None:
        self._options, self._case = options, case
        section = case.section("advise", FIELDS, parameters=False)
        self._section = with_model_of_case(section, case, models)
        with user_errors():
            doubt = None if case.file is None else case.file.doubt
            self.weighed = None if case.file is None else case.file.tested.ranges.get("alpha")
        self.data, self.typed = section.get("data", "rows.csv"), section.get("reading", {})
        if not isinstance(self.data, str):
            raise InputError(f"{case.case}: field `data` of [advise] must be a path, but is {briefly(self.data)}.")
        if not _are_options(self.typed):
            given = briefly(self.typed)
            raise InputError(f"{case.case}: field `reading` of [advise] must be a table of texts, but is {given}.")
        # Without laws in the options those of the case file, with their correlation.
        of_file = self._section if options.uncertain is None else {}
        self._counts = "uncertain" in of_file
        # The file of samples has what is doubtful in the fit, too.
        self.doubts = () if doubt is None or self._counts else (doubt,)
        laws = LawOptions(uncertain=options.uncertain)
        self._laws = laws.with_section(of_file, f"{case.case}: field `{{}}` of [advise]", case)
        self.files = self._laws.files

    def models(self, names: Sequence[str] | None, p: "lazy.Parameters") -> "dict[str, lazy.CuttingModel]":
        """The models by name: those of --model, of the case file, of the draws, or the usual ones."""
        named = self._section.get("model")
        if not (named is None or isinstance(named, str)):
            raise InputError(f"{self._case.case}: field `model` of [advise] must be a name, but is {briefly(named)}.")
        draws = [path for path in self.files if path.endswith(".nc")][:1]
        with user_errors():
            of_fit = [lazy.model_of_draws(path) for path in draws] if named is None else [named]
        chosen = list(names or of_fit or lazy.MODELS)
        of_file = named if named is not None else self._case.model()[0]
        if of_file is not None and self._counts and not all(is_same_model(name, of_file) for name in chosen):
            raise InputError(
                f"Option `--model` must be {of_file}, whose parameters have laws in {self._case.case}, "
                f"but is {', '.join(chosen)}."
            )
        own = settings(self._options.own, self._section, f"{self._case.case}: `set` of [advise]")
        if own and len(chosen) > 1:
            raise InputError(f"{next(iter(own.values()))[0]} needs one model, but there are {', '.join(chosen)}.")
        loaded = {name: self._case.load_as_set(name, own) for name in chosen}
        return {lazy.called(name, model): model for name, model in loaded.items()}

    def words(
        self,
        abrasive: PerMassOptions,
        models: "Mapping[str, lazy.CuttingModel]",
        draws: "Sequence[lazy.Draws]",
        p: "lazy.Parameters",
    ) -> tuple[str, ...]:
        """The case of the tests as a fit takes it, and the models where the case file names none.

        The options of an advice change the question, not the tests: a fit of theirs is of its case file as it is, and
        what the case of `draws` has otherwise than `p` takes the place of the options.
        """
        fitted = draws[0].otherwise(p) if draws else {}
        words = lazy.options_in_words({**fitted, "density": abrasive.density})
        if not (self._counts or self._options.uncertain):
            return (*self._case.words(fitted), *words)
        of_file = self._case.model()[0]
        named = [] if of_file and self._section.get("model") == of_file else ["--model", ",".join(models)]
        if (self._counts or not draws) and not {"data", "tested"}.isdisjoint(self._section):
            return (str(self._case.case), *named)
        share = draws[0].cutting_fraction if draws else abrasive.cutting_fraction
        if share is not None and (share != 1 or self._case.file is not None):
            words += ["--cutting-fraction", f"{share:.9g}"]
        own = [word for text in self._options.own or () for word in ("--set", text)]
        return (*self._case.words(fitted), *words, *named, *own)

    def read(
        self, models: "Mapping[str, lazy.CuttingModel]", p: "lazy.Parameters", abrasive: PerMassOptions
    ) -> "ReadFit":
        """What the files say of the metal.

        Args:
            models: by name.
            p: the case.
            abrasive: see `advise`.

        Raises:
            InputError: also for an option that sets what has a law: one of the two would be left aside.
        """
        where = self._laws.uncertain[0]
        _, laws, draws = self._laws.read(next(iter(models.values())), {})
        for model in models.values():
            require_same_model(draws, model, where)
        if not laws:
            return ReadFit(self, self._case, abrasive, models, p, None, draws)
        source = str(self._case.case) if self._options.uncertain is None else ""
        with user_errors():
            uncertain = lazy.Uncertain(laws, source, predictor=draws[0].predictor if draws else None)
            uncertain = uncertain.of_metal(models) if draws else uncertain
            uncertain.require_of_metal(models, where)
        options = {name: name for name in self._case.given()}
        options |= {text.partition("=")[0].strip(): "set" for text in self._options.own or ()}
        options |= {} if abrasive.cutting_fraction is None else {lazy.FRACTION: "cutting-fraction"}
        if self._counts and self._case.target is not None:
            names = ", ".join(sorted(laws.names))
            raise InputError(f"Option `--target` cannot set the metal, of which {names} have laws in {uncertain}.")
        for name, option in options.items():
            if name in laws.names:
                raise InputError(f"Option `--{option}` cannot set {name}, which has a law in {uncertain}.")
        return ReadFit(self, self._case, abrasive, models, p, uncertain, draws)


@dataclasses.dataclass(frozen=True)
class ReadFit:
    """What tests have said of the metal, as it was read.

    Args:
        given: the options.
        case: of the impact.
        abrasive: see `advise`.
        models: by name.
        p: the case.
        uncertain: the laws, None where there are none.
        draws: the posteriors' files among them.
    """

    given: GivenFit
    case: CaseOptions
    abrasive: PerMassOptions
    models: "Mapping[str, lazy.CuttingModel]"
    p: "lazy.Parameters"
    uncertain: "lazy.Uncertain | None"
    draws: "list[lazy.Draws]"

    def per_mass(self) -> "lazy.PerMass":
        """How volumes become erosion per mass; refuses the density of another metal than a correlation's."""
        shares = [part.cutting_fraction for part in self.draws if part.cutting_fraction is not None]
        usual = lazy.CUTTING_FRACTION if self.uncertain is None else [*shares, lazy.FRACTION_OF_A_FIT][0]
        per_mass = self.abrasive.per_mass(self.case, usual)
        for model in self.models.values():
            weighing(model, self.abrasive, self.case)
        return per_mass

    def completed(self, advice: "lazy.Advice") -> "lazy.Advice":
        """An advice with the doubts of the tests, where they lie, and the commands that lead from it to a fit."""
        outside = [] if self.case.file is None else self.case.file.outside(self.p)
        # Doubts of the file's tests, which may be those of the draws.
        told = [(doubt.code, doubt.numbers) for doubt in outside]
        of_draws = [doubt for part in self.draws for model in self.models.values()
                    for doubt in (*part.doubts(model, advice.p, advice.per_mass.cutting_fraction), *part.of_fit())
                    if (doubt.code, doubt.numbers) not in told]  # fmt: skip
        speed = {"speed": lazy.QUANTITIES["v0"].in_words(float(self.p.v0), "si")}
        is_usual = self.case.case is None and "v0" not in self.case.given()
        of_table = found((is_usual, Finding("speed_of_table_1", "", speed)))
        return dataclasses.replace(
            advice,
            doubts=unique((*of_table, *self.given.doubts, *outside, *of_draws)),
            weighed=advice.weighed or self.given.weighed if self.uncertain else None,
            rows_file=self.draws[0].data if self.draws else self.given.data,
            tests_typed=self.draws[0].typed if self.draws else self.given.typed,
            words=self.given.words(self.abrasive, self.models, self.draws, self.p),
        )


def advise(
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    spread: Annotated[
        str, Parameter(help="Standard deviation of the angles in the jet, about half of its half opening angle.")
    ] = "3 deg",
    speed_spread: Annotated[float, Parameter(help="Standard deviation of the speeds: 0.1 is 10 %.")] = 0.0,
    abrasive: PerMassOptions | None = None,
    model: ModelsOption = None,
    fit_of_tests: TestedFitOptions | None = None,
    shop: JobOptions | None = None,
    output: Annotated[
        Path | None, output_option("Also write it as a page, .html, or its angles as a table, .csv.")
    ] = None,
    decimal: Annotated[str, Parameter(group=OUTPUT, help='Of the table, "." or ",".')] = ".",
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Advise a nozzle's angle: the erosion to expect, and how sure.

    Give --particle, --target and --v0. Models, correlations, the force ratio k,
    the contact ratio ψ and the spread of the jet are compared. Without
    --cutting-fraction half of the particles cut, as Finnie found.

    After tests of your own: --uncertain with the draws of `posterior -o`, or the
    case file of `calibrate --write-case`. They take the place of the ranges of k
    and ψ, and the correlations do not count.
    """
    options = with_file(case, file)
    options.refuse_given("all angles of the nozzle are compared", "alpha")
    p = options.parameters()
    deviation = options.read("spread", spread, "angle")
    fit, shop = GivenFit(fit_of_tests or TestedFitOptions(), options, model), shop or JobOptions()
    job, other = shop.job(options), shop.other(options)
    what = "table" if output is not None and output.suffix == ".csv" else "page"
    printed = Output("advise", p, options, json=json, plot=plot, files={what: output},
                     inputs=(*fit.files, *(model or ())))  # fmt: skip
    if output is not None:
        with user_errors():
            lazy.require_page_path(output, decimal)
    models = fit.models(chosen_models(model), p)
    tests = fit.read(models, p, abrasive or PerMassOptions())
    per_mass, spreads = tests.per_mass(), (deviation, speed_spread)
    with progress_bar("advise") as progress, user_errors():
        computed = lazy.advise_case(p, options.materials(), spreads, per_mass, models, tests.uncertain, progress)
        advice = dataclasses.replace(tests.completed(computed), job=job, other=other)
    printed.warn(*(tests.uncertain.laws.unused_columns if tests.uncertain else ()))
    printed.save(
        figure=lambda: lazy.plot_advice(advice), **{what: lambda path: lazy.write_advice(advice, path, decimal)}
    )
    printed.show(advice, models)
