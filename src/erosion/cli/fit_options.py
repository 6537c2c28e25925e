"""What `erosion calibrate` fits, and how."""

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.lists import LISTED
from erosion.cli.options import CaseOptions, WholeOption
from erosion.cli.per_mass import PerMassOptions

if TYPE_CHECKING:
    from erosion.calibration import Measurements
    from erosion.parameters.units import Dimension, System

_FREE = 'Parameters to fit, of the case or the model\'s own: "k,cutting_fraction,energy_ratio"; "k,psi" without it.'
_BOUNDS = 'Least and greatest values, of own parameters too: "psi=0.01:0.3,threshold=0:40 m/s".'


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class FitOptions(PerMassOptions):
    """What is fitted, and how."""

    free: Annotated[list[str], LISTED, Parameter(help=_FREE, show_default=False)] = dataclasses.field(
        default_factory=lambda: ["k", "psi"]
    )
    bounds: Annotated[list[str] | None, LISTED, Parameter(help=_BOUNDS)] = None
    loss: Annotated[str, Parameter(help='"linear"; "soft_l1", "huber", "cauchy" or "arctan" with outliers.')] = "linear"
    starts: Annotated[WholeOption, Parameter(help="Points to begin from; 32 without it.")] = None

    def names(self, measured: "Measurements") -> Sequence[str]:
        """All that is fitted: the free parameters, and a scale where the data has one of its own."""
        from erosion.calibration.forward import SCALE

        return (*self.free, SCALE) if measured.free_scale else self.free

    def on(self, options: CaseOptions) -> "FitOptions":
        """The same with the density and the cutting fraction of the case or its target, where none are given."""
        per_mass = self.per_mass(options)
        density = None if per_mass.density is None else f"{per_mass.density!r} kg/m^3"
        return dataclasses.replace(self, density=density, cutting_fraction=per_mass.cutting_fraction)

    def arguments(self) -> dict[str, Any]:
        """The arguments of `erosion.calibrate` of the same names, but for `bounds`, which need the models."""
        return {
            "density": self.density,
            "cutting_fraction": 1.0 if self.cutting_fraction is None else self.cutting_fraction,
            "loss": self.loss,
            "starts": 32 if self.starts is None else self.starts,
        }

    def bounds_of(
        self, models: Sequence[str], units: "System", measured: "Measurements"
    ) -> dict[str, tuple[float, float]]:
        """The bounds by parameter, in the units of the case."""
        return _read_bounds(self.bounds or (), self.names(measured), models, units)


def _read_bounds(
    texts: Sequence[str], free: Sequence[str], models: Sequence[str], units: "System"
) -> dict[str, tuple[float, float]]:
    """Bounds such as "psi=0.01:0.3", by parameter, in the units of the case."""
    from erosion.parameters.units import read_quantity, unit_of

    bounds: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, ends = (part.strip() for part in text.partition("="))
        least, colon, greatest = (part.strip() for part in ends.partition(":"))
        if not (name and equals and least and colon and greatest):
            raise InputError(f'Option `--bounds` must be such as "psi=0.01:0.3", but is {text!r}.')
        if name not in free:
            raise InputError(f"Option `--bounds` must name free parameters ({', '.join(free)}), but has {name!r}.")
        if name in bounds:
            raise InputError(f"Option `--bounds` must give {name} once, but gives it several times.")
        dimension = dimension_of(name, models, units)
        # "1:3 GPa" is from 1 GPa. The end with the unit is read first, so that a message shows what was typed.
        shared = unit_of(least) or unit_of(greatest)
        ends_read = {}
        with reading(f"Option `--bounds`, {name},"):
            for end in sorted({least, greatest}, key=unit_of, reverse=True):
                ends_read[end] = read_quantity(end if unit_of(end) else end + shared, dimension, units)
            bounds[name] = ends_read[least], ends_read[greatest]
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"Option `--bounds` must give {name} two ascending values, but is {text!r}.")
    return bounds


def dimension_of(name: str, models: Sequence[Any], units: "System") -> "Dimension":
    """What a parameter is measured in: of an impact, of one of the models (names or models), or a factor."""
    from erosion.models import load_model
    from erosion.models.own_parameters import own_parameters
    from erosion.parameters.quantities import QUANTITIES

    if name in QUANTITIES:
        return QUANTITIES[name].dimension
    for model in models:
        with user_errors():
            own = own_parameters(load_model(model))
        if name in own:
            return own[name].quantity.dimension
    return "1"
