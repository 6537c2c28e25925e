"""`--uncertain` of `erosion advise`: the fit to tests that an advice rests on, from its draws or its case file."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.options import CaseOptions
from erosion.cli.set_option import SetOption, load_set, settings, with_model_of_case
from erosion.parameters.units import has_control_characters, shown

if TYPE_CHECKING:
    from erosion.advice.uncertain import Uncertain
    from erosion.models.base import CuttingModel
    from erosion.parameters.parameters import Parameters
    from erosion.posteriors.files import Draws

FIELDS = ("model", "set", "uncertain", "correlation", "warning")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `calibrate --posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


def section_of(case: CaseOptions, models: Sequence[str] | None) -> Mapping[str, Any]:
    """The table [advise] of a case file, with the model that the file names for all verbs."""
    return with_model_of_case(case.section("advise", FIELDS, parameters=False), case, models)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class FitOptions:
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

    options: FitOptions
    case: CaseOptions
    section: Mapping[str, Any]

    def __post_init__(self) -> None:
        _ = self.doubts  # are read before anything is computed

    @property
    def files(self) -> list[str]:
        """The files that are read."""
        return self._laws.files

    def models(self, names: Sequence[str] | None, p: "Parameters") -> "dict[str, CuttingModel]":
        """The models by name: those of --model, of the case file, of the draws, or the usual ones."""
        from erosion.advice.advise import MODELS

        chosen = list(names or self._model_of_file or self._model_of_draws() or MODELS)
        own = settings(self.options.own, self.section, f"{self.case.case}: `set` of [advise]")
        if own and len(chosen) > 1:
            raise InputError(f"{next(iter(own.values()))[0]} needs one model, but there are {', '.join(chosen)}.")
        from erosion.models import called

        loaded = {name: load_set(name, own, self.case, p.units) for name in chosen}
        return {called(name, model): model for name, model in loaded.items()}

    def uncertain(
        self, models: "Mapping[str, CuttingModel]", p: "Parameters", *, has_fraction: bool
    ) -> "tuple[Uncertain | None, list[Draws]]":
        """The laws, or None where there are none, and the posteriors' files that were read.

        Args:
            models: by name.
            p: the case.
            has_fraction: whether --cutting-fraction is given.
        """
        from erosion.advice.uncertain import Uncertain

        given = self._laws
        _, laws, draws = given.read(next(iter(models.values())), p.units, {})
        for model in models.values():
            require_same_model(draws, model, given.uncertain[0])
        if not laws:
            return None, draws
        in_options = self.options.uncertain is not None
        uncertain = Uncertain(laws, "" if in_options else str(self.case.case))
        with user_errors():
            uncertain.require_of_metal(models, given.uncertain[0])
        self._refuse_options_beside(uncertain, has_fraction=has_fraction)
        return uncertain, draws

    def _refuse_options_beside(self, uncertain: "Uncertain", *, has_fraction: bool) -> None:
        """An `InputError` for an option that sets what has a law: one of the two would be left aside."""
        from erosion.calibration.forward import FRACTION

        options = {name: name for name in self.case.given()}
        options |= {text.partition("=")[0].strip(): "set" for text in self.options.own or ()}
        if has_fraction:
            options[FRACTION] = "cutting-fraction"
        if self.options.uncertain is None and self.case.target is not None:
            options["sigma"] = "target"
        for name, option in options.items():
            if name in uncertain.laws:
                raise InputError(f"Option `--{option}` cannot set {name}, which has a law in {uncertain}.")

    @property
    def doubts(self) -> tuple[str, ...]:
        """The warning of the case file's table, that the tests were in units of their own for example."""
        warning = self.section.get("warning")
        if warning is None:
            return ()
        if not isinstance(warning, str) or not warning.strip() or has_control_characters(warning):
            raise InputError(
                f"{self.case.case}: field `warning` of [advise] must be a sentence, but is {shown(warning)}."
            )
        return (f"{self.case.case}: {warning}",)

    @property
    def _model_of_file(self) -> list[str] | None:
        name = self.section.get("model")
        if not (name is None or isinstance(name, str)):
            raise InputError(f"{self.case.case}: field `model` of [advise] must be a name, but is {name!r}.")
        return None if name is None else [name]

    def _model_of_draws(self) -> list[str] | None:
        from erosion.posteriors.files import model_of_draws

        paths = [path for path in self.files if path.endswith(".nc")]
        with user_errors():
            return [model_of_draws(path) for path in paths[:1]] or None

    @property
    def _laws(self) -> Any:
        """The laws of the options; without one those of the case file, with their correlation."""
        section = self.section if self.options.uncertain is None else {}
        where = f"{self.case.case}: field `{{}}` of [advise]"
        return LawOptions(uncertain=self.options.uncertain).with_section(section, where)
