"""What `erosion calibrate` and `erosion posterior` share: data, case and models, files, JSON.

`--uncertain` of `erosion advise`: the fit to tests that an advice rests on, from its draws or its case file.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.lists import LISTED, chosen_models, refuse_same
from erosion.cli.options import (
    FIT,
    OUTPUT,
    CaseOptions,
    SetOption,
    Settings,
    WholeOption,
    load_set,
    model_and_settings,
    settings,
    with_model_of_case,
)
from erosion.cli.output import Output, PerMassOptions, weighing

_DATA = (
    'CSV file, headed "angle [deg], volume [mm^3], uncertainty [mm^3]", or "angle [deg], speed [m/s], '
    'mass_loss [mg/kg]" with --target or --density.'
)
DataFile = Annotated[Path, Parameter(help=_DATA)]
_FREE = 'Of case or model, "k,energy_ratio"; k and ψ without it.'


@Parameter(name="*", group=FIT)
@dataclasses.dataclass(frozen=True)
class FitOptions(PerMassOptions):
    """What is fitted."""

    free: Annotated[list[str], LISTED, Parameter(help=_FREE, show_default=False)] = dataclasses.field(
        default_factory=lambda: ["k", "psi"]
    )
    error: Annotated[str | None, Parameter(help='If no column has it: "0.3 mg/kg + 8 %", or one part.')] = None
    starts: Annotated[WholeOption, Parameter(help="Points to begin from; 32 without it.")] = None

    def names(self, measured: "lazy.Measurements") -> Sequence[str]:
        """All that is fitted: the free parameters, and a scale where the data has one of its own."""
        return (*self.free, lazy.SCALE) if measured.free_scale else self.free


@dataclasses.dataclass(frozen=True)
class Fit:
    """Data, case and models of a fit; `given_fit` makes it of the options.

    Args:
        data: the file of measurements.
        ignore: its columns that are left out.
        options: the case.
        p: the same as numbers.
        fit: what is free, with the density and the cutting fraction of the case where the options give none.
        names: the models.
        own: what is set of the only model.
    """

    data: Path
    ignore: Sequence[str]
    options: CaseOptions
    p: "lazy.Parameters"
    fit: FitOptions
    names: list[str]
    own: Settings

    @property
    def inputs(self) -> tuple[Any, ...]:
        """What is read."""
        return self.data, self.options.case, *self.names

    def models(self) -> "list[lazy.CuttingModel]":
        """The models, all of them different and of the target's metal."""
        if len(self.names) == 1:
            models = [load_set(self.names[0], self.own, self.options, self.p.units)]
        else:
            models = list(map(self.options.load_as_set, self.names))
        refuse_same(dict(zip(self.names, models, strict=True)))
        for model in models:
            weighing(model, self.fit, self.options)  # refuses the density of another metal than a correlation's
        return models

    def measured(self, output: Output) -> "lazy.Measurements":
        """The measurements; columns that are not used are a warning."""
        measured = lazy.read_measurements(self.data, self.p.units, ignore=self.ignore, error=self.fit.error)
        if measured.unused:
            output.warn(f"{self.data}: {lazy.unused_note(measured.unused)}.")
        output.warn(*measured.notes)
        return measured

    @property
    def per_mass(self) -> dict[str, Any]:
        """The arguments of a fit and of a posterior on erosion per mass."""
        return {"density": self.fit.density, "cutting_fraction": self.fit.cutting_fraction}

    def ranking(
        self,
        measured: "lazy.Measurements",
        models: "Sequence[lazy.CuttingModel]",
        progress: "lazy.Progress",
        **options: Any,
    ) -> "lazy.Ranking":
        """The fits of the models; `options` are those of `rank_models`."""
        starts = 32 if self.fit.starts is None else self.fit.starts
        return lazy.rank_models(
            self.p, measured, self.fit.free, models=models, progress=progress, starts=starts, **self.per_mass, **options
        )

    def next_steps(self, ranking: "lazy.Ranking", case_file: Path | None, draws: Path | None = None) -> list[str]:
        """The commands for the best angle, the advice and CFD codes, by the files that are written."""
        uncertain = [] if draws is None else ["--uncertain", str(draws)]
        wear = [] if draws is None else [f"wear at other angles and speeds: {lazy.command('predict', str(draws))}"]
        if case_file is not None:
            path = str(case_file)
            return [
                *wear,
                f"the best angle of this fit: {lazy.command('optimum', path)}",
                f"a nozzle's angle by this fit: {lazy.command('advise', path, *uncertain)}",
                f"for CFD codes: {lazy.command('export', path, '--fluent', 'angles.csv')}",
            ]
        if draws is not None:
            words = self.options.words(ranking.best.names)
            return [*wear, f"a nozzle's angle by this fit: {lazy.command('advise', *words, *uncertain)}"]
        return ["a nozzle's angle: --write-case fitted.toml, then erosion advise fitted.toml"]


def given_fit(
    data: Path,
    case: CaseOptions,
    fit: FitOptions | None,
    model: list[str] | None,
    own: list[str] | None,
    ignore: list[str] | None,
) -> Fit:
    """The fit that options ask for.

    Args:
        data: the file of measurements.
        case: without a file and --units, Table 1 in the unit system of the data.
        fit: what is free.
        model: the option --model.
        own: the options --set.
        ignore: the options --ignore.
    """
    if case.case is None and case.units is None:
        if data.is_fifo():
            raise InputError(f"{data} is no file: beside it give `--units si`, `--units inch-pound` or a case file.")
        case = dataclasses.replace(case, units=lazy.unit_system(data, ignore or ()))
    case.refuse_angle("the angles are those of the data")
    fit = fit or FitOptions()
    p = case.parameters(free=fit.free)
    per_mass = fit.per_mass(case)
    density = None if per_mass.density is None else f"{per_mass.density!r} kg/m^3"
    fit = dataclasses.replace(fit, density=density, cutting_fraction=per_mass.cutting_fraction)
    usual, of_model = model_and_settings(None if model is None else model[0], own, case)
    names = [usual] if model is None else chosen_models(model)
    if len(set(names)) != len(names):
        raise InputError(f"Option `--model` must name one or several different models, but is {','.join(names)!r}.")
    if own and len(names) > 1:
        raise InputError(f"Option `--set` needs one model, but `--model` names {', '.join(names)}.")
    return Fit(data, ignore or (), case, p, fit, names, of_model)


def dimension_of(name: str, models: Sequence[Any], units: "lazy.System") -> "lazy.Dimension":
    """What a parameter is measured in: of an impact, of one of the models (names or models), or a factor."""
    with user_errors():
        known = [lazy.QUANTITIES, *(lazy.quantities(lazy.load_model(model)) for model in models)]
    return next((quantities[name].dimension for quantities in known if name in quantities), "1")


WriteCaseOption = Annotated[
    Path | None,
    Parameter(name="--write-case", group=OUTPUT, help="Write the best fit as a case file, for all verbs."),
]


def write_case(path: Path, ranking: "lazy.Ranking", options: CaseOptions) -> None:
    """Write the best fit as a case file."""
    with user_errors(lazy.CalibrationError):
        text = lazy.to_case(ranking.best, str(path), **options.names(), warnings=ranking.warnings_of_best)
        lazy.write_whole(path, text.encode())


def ranks_several(ranking: "lazy.Ranking") -> bool:
    """Whether there are several models, some of which may have failed."""
    return len(ranking.fits) + len(ranking.failures) > 1


def print_document(
    output: Output, ranking: "lazy.Ranking", level: float, more: Mapping[str, Any], units: Mapping[str, str]
) -> None:
    """The best fit and the ranking of several models as JSON.

    Args:
        output: of the verb.
        ranking: the fits.
        level: of the confidence intervals.
        more: what the verb has found beside.
        units: of numbers in `more`.
    """
    fits = dict(zip(ranking.names, ranking.fits, strict=True))
    of_fits = {name: quantity.unit(ranking.best.p.units) for fit in fits.values()
               for name, quantity in lazy.quantities(fit.model).items()}  # fmt: skip
    of_fits |= dict.fromkeys(("rms", "leave_one_out", "residuals"), ranking.best.erosion_unit)
    content = _fit_as_json(ranking.best, level)
    if ranks_several(ranking):
        content["ranking"] = [
            {"model": name, **_fit_as_json(fit, level), **ranking.standing(at)}
            for at, (name, fit) in enumerate(fits.items())
        ]
    output.document({**content, **more}, {name: fit.model for name, fit in fits.items()}, {**of_fits, **units})


def _fit_as_json(fit: "lazy.Calibration", level: float) -> dict[str, Any]:
    return {name: value for name, value in as_json(fit.to_dict(level)).items() if name != "model"}


def as_json(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Without what the document says elsewhere."""
    return {name: value for name, value in numbers.items() if name not in ("own_parameters", "parameters", "warnings")}


FIELDS = ("model", "set", "uncertain", "correlation", "warning", "tested")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


def section_of(case: CaseOptions, models: Sequence[str] | None) -> Mapping[str, Any]:
    """The table [advise] of a case file, with the model that the file names for all verbs."""
    return with_model_of_case(case.section("advise", FIELDS, parameters=False), case, models)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class TestedFitOptions:
    """What tests have said of the metal; texts as they are typed."""

    uncertain: Annotated[list[str] | None, Parameter(negative="", help=_UNCERTAIN)] = None
    own: SetOption = None


@dataclasses.dataclass(frozen=True)
class GivenFit:
    """The options with the table [advise] of the case file; options win.

    Args:
        options: of the fit.
        case: of the impact.
        section: the table.
    """

    options: TestedFitOptions
    case: CaseOptions
    section: Mapping[str, Any]

    def __post_init__(self) -> None:
        _ = self.doubts  # are read before anything is computed

    @property
    def files(self) -> list[str]:
        """The files that are read."""
        return self._laws.files

    def models(self, names: Sequence[str] | None, p: "lazy.Parameters") -> "dict[str, lazy.CuttingModel]":
        """The models by name: those of --model, of the case file, of the draws, or the usual ones."""
        chosen = list(names or self._model_of_file or self._model_of_draws() or lazy.MODELS)
        own = settings(self.options.own, self.section, f"{self.case.case}: `set` of [advise]")
        if own and len(chosen) > 1:
            raise InputError(f"{next(iter(own.values()))[0]} needs one model, but there are {', '.join(chosen)}.")

        loaded = {name: load_set(name, own, self.case, p.units) for name in chosen}
        return {lazy.called(name, model): model for name, model in loaded.items()}

    def uncertain(
        self, models: "Mapping[str, lazy.CuttingModel]", p: "lazy.Parameters", *, has_fraction: bool
    ) -> "tuple[lazy.Uncertain | None, list[lazy.Draws]]":
        """The laws, or None where there are none, and the posteriors' files that were read.

        Args:
            models: by name.
            p: the case.
            has_fraction: whether --cutting-fraction is given.
        """
        given = self._laws
        _, laws, draws = given.read(next(iter(models.values())), p.units, {})
        for model in models.values():
            require_same_model(draws, model, given.uncertain[0])
        if not laws:
            return None, draws
        in_options = self.options.uncertain is not None
        uncertain = lazy.Uncertain(laws, "" if in_options else str(self.case.case))
        with user_errors():
            uncertain.require_of_metal(models, given.uncertain[0])
        self._refuse_options_beside(uncertain, has_fraction=has_fraction)
        return uncertain, draws

    def _refuse_options_beside(self, uncertain: "lazy.Uncertain", *, has_fraction: bool) -> None:
        """An `InputError` for an option that sets what has a law: one of the two would be left aside."""
        options = {name: name for name in self.case.given()}
        options |= {text.partition("=")[0].strip(): "set" for text in self.options.own or ()}
        if has_fraction:
            options[lazy.FRACTION] = "cutting-fraction"
        if self.options.uncertain is None and self.case.target is not None:
            options["sigma"] = "target"
        for name, option in options.items():
            if name in uncertain.laws:
                raise InputError(f"Option `--{option}` cannot set {name}, which has a law in {uncertain}.")

    @property
    def doubts(self) -> tuple[str, ...]:
        """The warning of the case file's table, that the tests were in units of their own for example."""
        with user_errors():
            said = None if self.case.file is None else self.case.file.doubt
        return () if said is None else (said,)

    @property
    def _model_of_file(self) -> list[str] | None:
        name = self.section.get("model")
        if not (name is None or isinstance(name, str)):
            raise InputError(f"{self.case.case}: field `model` of [advise] must be a name, but is {name!r}.")
        return None if name is None else [name]

    def _model_of_draws(self) -> list[str] | None:
        paths = [path for path in self.files if path.endswith(".nc")]
        with user_errors():
            return [lazy.model_of_draws(path) for path in paths[:1]] or None

    @property
    def _laws(self) -> Any:
        """The laws of the options; without one those of the case file, with their correlation."""
        section = self.section if self.options.uncertain is None else {}
        where = f"{self.case.case}: field `{{}}` of [advise]"
        return LawOptions(uncertain=self.options.uncertain).with_section(section, where)
