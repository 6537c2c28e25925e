"""`erosion advise`: the nozzle's angle and the erosion to expect, on one page."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.options import (
    OUTPUT,
    AllAngles,
    CaseArgument,
    CaseOptions,
    JsonOption,
    LangOption,
    ModelsOption,
    PlotOption,
    SetOption,
    chosen_models,
    is_same_model,
    output_option,
    read_option,
    settings,
    with_file,
    with_model_of_case,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing
from erosion.output.tables import briefly


@Parameter(name="*", group=Group("Job", sort_key=7))
@dataclasses.dataclass(frozen=True)
class JobOptions:
    """What is to be removed, and with what else."""

    area: Annotated[str | None, Parameter(help='To remove from, for kg of abrasive: "2 m^2".')] = None
    depth: Annotated[str | None, Parameter(help='To remove: "50 um".')] = None
    feed: Annotated[str | None, Parameter(help='Abrasive, for the time: "5 kg/min".')] = None
    compare: Annotated[str | None, Parameter(help='Another abrasive: "aluminium oxide 0.2 mm".')] = None

    def job(self) -> "lazy.Job | None":
        """The job, where there is one."""
        area = read_option("area", self.area, "area", "si")
        depth = read_option("depth", self.depth, "length", "si")
        feed = read_option("feed", self.feed, "mass flow", "si")
        if area is None and depth is None and feed is None:
            return None
        if area is None or depth is None:
            raise InputError("--area and --depth belong together: give both.")
        with user_errors():
            return lazy.Job(area, depth, feed)


FIELDS = ("model", "set", "uncertain", "correlation", "warning", "data", "tested", "equations")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class TestedFitOptions:
    """What tests have said of the metal; texts as they are typed."""

    uncertain: Annotated[list[str] | None, Parameter(negative="", help=_UNCERTAIN)] = None
    own: SetOption = None


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
        self.data = section.get("data", "rows.csv")
        if not isinstance(self.data, str):
            raise InputError(f"{case.case}: field `data` of [advise] must be a path, but is {briefly(self.data)}.")
        # That the tests were in units of their own, for example.
        self.doubts = () if doubt is None else (doubt,)
        # Without laws in the options those of the case file, with their correlation.
        of_file = self._section if options.uncertain is None else {}
        self._counts = "uncertain" in of_file
        laws = LawOptions(uncertain=options.uncertain)
        self._laws = laws.with_section(of_file, f"{case.case}: field `{{}}` of [advise]")
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
        words = [word for name, text in fitted.items() for word in (f"--{name}", text)]
        words += [] if abrasive.density is None else ["--density", abrasive.density]
        if not (self._counts or self._options.uncertain):
            return (*self._case.words(fitted), *words)
        of_file = self._case.model()[0]
        named = [] if of_file and self._section.get("model") == of_file else ["--model", ",".join(models)]
        if not draws and not {"data", "tested"}.isdisjoint(self._section):
            return (str(self._case.case), *named)
        share = draws[0].cutting_fraction if draws else abrasive.cutting_fraction
        if share is not None and (share != 1 or self._case.file is not None):
            words += ["--cutting-fraction", f"{share:.9g}"]
        own = [word for text in self._options.own or () for word in ("--set", text)]
        return (*self._case.words(fitted), *words, *named, *own)

    def uncertain(
        self, models: "Mapping[str, lazy.CuttingModel]", p: "lazy.Parameters", *, has_fraction: bool
    ) -> "tuple[lazy.Uncertain | None, list[lazy.Draws]]":
        """The laws, or None where there are none, and the posteriors' files that were read.

        Args:
            models: by name.
            p: the case.
            has_fraction: whether --cutting-fraction is given.

        Raises:
            InputError: also for an option that sets what has a law: one of the two would be left aside.
        """
        where = self._laws.uncertain[0]
        _, laws, draws = self._laws.read(next(iter(models.values())), p.units, {})
        for model in models.values():
            require_same_model(draws, model, where)
        if not laws:
            return None, draws
        uncertain = lazy.Uncertain(laws, str(self._case.case) if self._options.uncertain is None else "")
        with user_errors():
            uncertain.require_of_metal(models, where)
        options = {name: name for name in self._case.given()}
        options |= {text.partition("=")[0].strip(): "set" for text in self._options.own or ()}
        options |= {lazy.FRACTION: "cutting-fraction"} if has_fraction else {}
        if self._counts and self._case.target is not None:
            names = ", ".join(sorted(laws))
            raise InputError(f"Option `--target` cannot set the metal, of which {names} have laws in {uncertain}.")
        for name, option in options.items():
            if name in laws:
                raise InputError(f"Option `--{option}` cannot set {name}, which has a law in {uncertain}.")
        return uncertain, draws


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
        Path | None, output_option("Also write it as a page, .html or .pdf, or its angles as a table, .csv.")
    ] = None,
    decimal: Annotated[str | None, Parameter(group=OUTPUT, help='Of the table, "." or ","; that of --lang.')] = None,
    plot: PlotOption = None,
    lang: LangOption = "en",
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
    deviation = read_option("spread", spread, "angle", "si")
    fit = GivenFit(fit_of_tests or TestedFitOptions(), options, model)
    shop = shop or JobOptions()
    job = shop.job()
    with user_errors():
        other = lazy.compared_with(shop.compare, *options.materials())
        lazy.language(lang)
    require_outputs(output, plot=plot, inputs=(options.case, *fit.files, *(model or ())))
    if output is not None:
        with user_errors():
            lazy.require_page_path(output, decimal)
    models = fit.models(chosen_models(model), p)
    abrasive = abrasive or PerMassOptions()
    uncertain, draws = fit.uncertain(models, p, has_fraction=abrasive.cutting_fraction is not None)
    shares = [part.cutting_fraction for part in draws if part.cutting_fraction is not None]
    usual = lazy.CUTTING_FRACTION if uncertain is None else [*shares, lazy.FRACTION_OF_A_FIT][0]
    per_mass = abrasive.per_mass(options, usual)
    for chosen in models.values():
        weighing(chosen, abrasive, options)  # refuses the density of another metal than a correlation's
    with progress_bar("advise") as progress, user_errors():
        advice = lazy.advise_case(
            p, options.materials(), (deviation, speed_spread), per_mass, models, uncertain, progress
        )
        outside = [] if options.file is None else options.file.outside(p)
        told = {doubt.partition(": ")[2] for doubt in outside}  # of the file's tests, which may be those of the draws
        of_draws = [doubt for part in draws for chosen in models.values()
                    for doubt in part.doubts(chosen, advice.p, advice.per_mass.cutting_fraction)
                    if doubt.partition(": ")[2] not in told]  # fmt: skip
        weighed = advice.weighed or fit.weighed if uncertain else None
        advice = dataclasses.replace(
            advice, doubts=tuple(dict.fromkeys((*fit.doubts, *outside, *of_draws))), weighed=weighed,
            job=job, other=other, rows_file=draws[0].data if draws else fit.data,
            words=fit.words(abrasive, models, draws, p),
        )  # fmt: skip
    if output is not None:
        with user_errors():
            lazy.write_advice(advice, output, lang, decimal)
    draw(plot, lambda: lazy.plot_advice(dataclasses.replace(advice, language=lazy.language(lang))))
    printed = Output("advise", p, options, json=json)
    printed.warn(*advice.warnings, *(lazy.unused_columns(uncertain.laws) if uncertain else ()))
    printed.document(advice.to_dict(), models, lazy.UNITS)
    printed.table("", advice.rows(), advice.headings, (), advice.reasons, [advice.title, *advice.answers])
    is_table = output is not None and output.suffix == ".csv"
    printed.wrote(figure=plot, **{"table" if is_table else "page": output})
