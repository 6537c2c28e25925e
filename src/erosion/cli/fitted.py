"""`--uncertain` of `erosion advise`: the fit to tests that an advice rests on, from its draws or its case file."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.options import CaseOptions
from erosion.cli.set_option import SetOption, load_set, settings

if TYPE_CHECKING:
    from erosion.advice.uncertain import Uncertain
    from erosion.models.base import CuttingModel
    from erosion.parameters.parameters import Parameters
    from erosion.posteriors.files import Draws

FIELDS = ("model", "set", "uncertain", "correlation")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `calibrate --posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


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
            raise InputError(f"Option `--set` needs one model, but `--model` names {', '.join(chosen)}.")
        return {name: load_set(name, own, p.units) for name in chosen}

    def uncertain(
        self, models: "Mapping[str, CuttingModel]", p: "Parameters"
    ) -> "tuple[Uncertain | None, list[Draws]]":
        """The laws, or None where there are none, and the posteriors' files that were read."""
        from erosion.advice.uncertain import Uncertain

        given, model = self._laws, next(iter(models.values()))
        _, laws, draws = given.read(model, p.units, {})
        require_same_model(draws, model, given.uncertain[0])
        if not laws:
            return None, draws
        in_options = self.options.uncertain is not None
        return Uncertain(laws, "" if in_options else str(self.case.case)), draws

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
