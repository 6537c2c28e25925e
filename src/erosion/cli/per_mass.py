"""`--density` and `--cutting-fraction`: erosion per mass of abrasive at the command line."""

import dataclasses
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.options import CaseOptions

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel
    from erosion.parameters.per_mass import PerMass


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class PerMassOptions:
    """What erosion per mass of abrasive needs beside the case."""

    density: Annotated[
        str | None,
        Parameter(help='Of the target, for g/kg: "2.7 g/cm^3"; --target has one as well.'),
    ] = None
    cutting_fraction: Annotated[
        float | None,
        Parameter(help="Share of the particles that cut, for mm³/kg and g/kg; Finnie: about 0.5."),
    ] = None

    def per_mass(self, options: CaseOptions, usual_fraction: float = 1.0) -> "PerMass":
        """With what --target or the case file give where these options give nothing.

        Raises:
            InputError: one sentence naming the option or the file.
        """
        from erosion.parameters.case_files import load_per_mass
        from erosion.parameters.materials import target
        from erosion.parameters.per_mass import PerMass

        with user_errors():
            of_case = PerMass(cutting_fraction=usual_fraction)
            if options.case is not None:
                of_case = load_per_mass(options.case, usual_fraction)
            density = of_case.density if options.target is None else target(options.target).density
        if self.density is not None:
            density = density_option("density", self.density)
        fraction = of_case.cutting_fraction if self.cutting_fraction is None else self.cutting_fraction
        with user_errors():
            return PerMass(density, fraction)


def density_option(name: str, text: str | None) -> float | None:
    """The density of an option [kg/m³]; None where it is not given."""
    from erosion.parameters.per_mass import read_density

    with reading(f"Option `--{name}`"):
        return None if text is None else read_density(text)


def weighing(model: "CuttingModel", given: PerMassOptions | None, options: CaseOptions) -> "PerMass":
    """How a model's volume becomes erosion per mass of abrasive.

    Raises:
        InputError: also for the density of another metal than a correlation's.
    """
    from erosion.models.correlated import per_mass_of

    given = given or PerMassOptions()
    per_mass = given.per_mass(options)
    try:
        return per_mass_of(model, per_mass)
    except ValueError as error:
        source = "Option `--density`"
        if given.density is None:
            source = f"{options.case}: the density" if options.target is None else "The density of `--target`"
        raise _set_beside(model, source, per_mass, options) or InputError(
            str(error).replace("Argument `density`", source)
        ) from error


def _set_beside(model: "CuttingModel", source: str, per_mass: "PerMass", options: CaseOptions) -> InputError | None:
    """The error where the density was set as an own parameter of a correlation; None where it is the correlation's."""
    from erosion.models import Correlated

    if not isinstance(model, Correlated):
        return None
    usual = options.load(model.label)
    if not isinstance(usual, Correlated) or float(model.density) == float(usual.density):
        return None
    return InputError(
        f"Parameter `density` of {model.label} is set to {float(model.density):g} kg/m³ (`--set`, or `set` in the case "
        f"file), but {source[0].lower()}{source[1:]} is {per_mass.density:g} kg/m³: leave one of them out."
    )
