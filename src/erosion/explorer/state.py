"""The state of one browser tab, the link that holds it, and errors as the page words them."""

import dataclasses
import re
from collections.abc import Collection, Mapping
from decimal import Decimal
from typing import Any, NamedTuple
from urllib.parse import unquote, urlencode

import numpy as np

from erosion.arguments import refuse
from erosion.models import CuttingModel, own_parameters
from erosion.output import briefly
from erosion.parameters import (
    QUANTITIES,
    Parameters,
    PerMass,
    Quantity,
    Scale,
    System,
    Target,
    about,
    check_system,
    exact_text,
    read_density,
    read_quantity,
    table_scale,
    unit_name,
    validate,
)

_LONGEST = 300  # characters; a link or an entry may repeat as many as it likes


def sentence(error: BaseException) -> str:
    """An error in one line of bounded length. What is an argument in Python is a field here."""
    line = " ".join(str(error).split()).replace("Argument `", "Field `") or type(error).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} …"


_NAMES = tuple(QUANTITIES)
_TEXTS = {True: "true", False: "false"}
# Of a link, beside parameters.
_FIELDS = ("units", "density", "cutting_fraction", "models", "shown", "instant", "predict")


class OwnNumber(NamedTuple):
    """The number of one of a model's own parameters.

    Args:
        model: the model's name on the page.
        name: the parameter's name in the model.
        value: the number, in SI.
        quantity: the parameter's symbol, meaning and dimension.
        least: the least value that it may have.
    """

    model: str
    name: str
    value: float
    quantity: Quantity
    least: float = -np.inf

    @property
    def key(self) -> str:
        """The parameter's name on the page and in links; no two models share a key."""
        return f"{self.model}.{self.name}"

    def read(self, text: str, bare: System) -> "OwnNumber":
        """Return the same parameter with the number that the text holds; a bare one is in the system `bare`.

        Raises:
            ValueError: one sentence that says what is wrong with the text.
        """
        with about(f"Field `{self.key}`"):
            value = read_quantity(text, self.quantity.dimension, bare)
        return self.with_value(value)

    def with_value(self, value: float) -> "OwnNumber":
        """Return the same parameter with another number, in SI.

        Raises:
            ValueError: if the number is not finite, or too small.
        """

        def in_si(number: float) -> str:
            return self.quantity.in_words(number, "si")

        refuse(
            f"Field `{self.key}` must be ",
            (not np.isfinite(value), f"a finite number, but is {value:g}."),
            (value < self.least, f"at least {in_si(self.least)}, but is {in_si(value)}."),
        )
        return self._replace(value=value)


def own_numbers(models: Mapping[str, CuttingModel]) -> tuple[OwnNumber, ...]:
    """The own parameters of all models, where `models` gives each model by its name."""
    return tuple(
        OwnNumber(name, parameter, float(own.value), own.quantity, own.least)
        for name, model in models.items()
        for parameter, own in own_parameters(model).items()
    )


class PageCase(NamedTuple):
    """The parameters of one impact as plain numbers, so that a dictionary can keep answers by case.

    Args:
        values: the numbers in SI, in the order of `QUANTITIES`.
        units: the unit system that shows them.
        own: the own parameters of all models.
    """

    values: tuple[float, ...]
    units: System
    own: tuple[OwnNumber, ...] = ()

    @classmethod
    def of(cls, p: Parameters, own: tuple[OwnNumber, ...] = ()) -> "PageCase":
        """Make a case of scalar parameters and of models' own parameters."""
        return cls(tuple(float(getattr(p, name)) for name in _NAMES), p.shown_in, own)

    def parameters(self) -> Parameters:
        """The case as `Parameters`, which hold no own parameters of models."""
        return Parameters(**dict(zip(_NAMES, self.values, strict=True)), shown_in=self.units)

    def with_parameters(self, p: Parameters) -> "PageCase":
        """Replace the parameters of the impact; models' own parameters stay."""
        return PageCase.of(p, self.own)

    def of_model(self, name: str) -> "PageCase":
        """Leave out the own parameters of all other models, which do not matter to this one."""
        return self._replace(own=tuple(number for number in self.own if number.model == name))

    def own_values(self, model: str) -> dict[str, float]:
        """A model's own parameters, by the names that they have in the model."""
        return {number.name: number.value for number in self.own if number.model == model}

    def numbers(self) -> dict[str, float]:
        """Each parameter's number by its name, models' own by their keys."""
        return dict(zip(_NAMES, self.values, strict=True)) | {number.key: number.value for number in self.own}

    def quantities(self) -> dict[str, Quantity]:
        """Symbol, meaning and dimension of each of these numbers, by the same names."""
        return {**QUANTITIES, **{number.key: number.quantity for number in self.own}}

    def replace(self, **changes: Any) -> "PageCase":
        """Change some numbers and validate the case.

        Raises:
            ValueError: for a number out of range.
        """
        own = tuple(number.with_value(changes.pop(number.key, number.value)) for number in self.own)
        p = dataclasses.replace(self.parameters(), **changes)
        validate(p)
        return PageCase.of(p, own)

    def reading(self, texts: Mapping[str, str]) -> "PageCase":
        """Change some parameters to the quantities that texts hold: "30 deg", "100 m/s".

        Raises:
            ValueError: one sentence that says what is wrong with a text.
        """
        numbers = {name: number for name, number in zip(_NAMES, self.values, strict=True) if name not in texts}
        p = Parameters.from_quantities(self.units, {name: texts[name] for name in _NAMES if name in texts}, numbers)
        own = [number.read(texts[number.key], self.units) if number.key in texts else number for number in self.own]
        return PageCase.of(p, tuple(own))

    def read(self, name: str, text: str, first: "PageCase") -> "PageCase":
        """Change one parameter to a typed text: "30", "0,5", "100 m/s".

        Args:
            name: the parameter.
            text: what is typed; a number without a unit is in that of the parameter's field.
            first: the case with which the page begins, in the same units; its `scale` has the units of the fields.

        Raises:
            ValueError: one sentence that says what is wrong with the text.
        """
        text = with_point(name, text)
        if not _is_number(text):
            return self.reading({name: text})
        if name == "alpha" and not 0 < float(text) <= 90:
            raise ValueError(f"Field `alpha` must be in degrees, above 0 and up to 90, but is {text.strip()}.")
        if self.quantities()[name].dimension == "angle":
            return self.reading({name: f"{text} deg"})
        quantity, size = self.quantities()[name], first.scale(name).size
        if size == quantity.size(self.units):
            return self.reading({name: text})
        # The product of both as decimal numbers rounds once: 90 µm are 9e-5 m.
        number = float(Decimal(text.strip()) * Decimal(repr(size)))
        return self.reading({name: f"{number!r} {quantity.unit('si')}".removesuffix(" 1")})

    def scale(self, name: str) -> Scale:
        """The unit in which a parameter reads well: 90 µm, but 0.04 in and 2.855e-7 slinch as the source has them."""
        quantity = self.quantities()[name]
        scale = table_scale(quantity.dimension, self.units, abs(self.numbers()[name]))
        if scale.unit.startswith("10"):
            return Scale(quantity.size(self.units), unit_name(quantity.dimension, self.units))
        return scale

    def to(self, units: str) -> "PageCase":
        """The same impact, shown in another unit system.

        Raises:
            ValueError: for another name than those of the unit systems.
        """
        return self._replace(units=check_system(units))


@dataclasses.dataclass(frozen=True)
class PageState:
    """Everything that a tab shows.

    Args:
        case: the impact.
        models: names of the checked models, in the order of the list; at least one.
        shown: the checked model whose cut is drawn.
        per_mass: how a volume becomes erosion per mass of particles.
        instant: the time at which the particle is drawn, as a share of the cut's time.
        predict: whether the page hides the best angles until the reader has predicted them.
    """

    case: PageCase
    models: tuple[str, ...]
    shown: str
    per_mass: PerMass = dataclasses.field(default_factory=PerMass)
    instant: float = 1.0
    predict: bool = False

    def checking(self, models: tuple[str, ...]) -> "PageState":
        """Check other models. The same model's cut stays drawn if this model is still checked."""
        return dataclasses.replace(self, models=models, shown=self.shown if self.shown in models else models[0])

    def of_metal(self, metal: Target) -> "PageState":
        """Take the flow stress and the density of a target."""
        case = self.case.with_parameters(self.case.parameters().with_target(metal))
        per_mass = dataclasses.replace(self.per_mass, density=metal.density)
        return dataclasses.replace(self, case=case, per_mass=per_mass)

    def changes(self, before: "PageState") -> str:
        """The numbers of the case that another state of the same units had otherwise: "σ = 1049 MPa, ψ = 2"."""
        numbers, had, units = self.case.numbers(), before.case.numbers(), self.case.units
        changed = [f"{quantity.symbol} = {quantity.in_words(numbers[name], units, 6)}"
                   for name, quantity in QUANTITIES.items() if numbers[name] != had[name]]  # fmt: skip
        if self.per_mass.density not in (None, before.per_mass.density):
            changed.append(f"density = {self.per_mass.density:.4g} kg/m³")
        return ", ".join(changed)

    def query(self) -> str:
        """The state as the query of a link, exact to the last bit, without models that are not checked."""
        own = tuple(number for number in self.case.own if number.model in self.models)
        density, fraction = self.per_mass.density, self.per_mass.cutting_fraction
        parameters = self.case.quantities()
        # A comma in the name of a model is spelled apart from those of the list; few names of files hold one.
        models = [model.replace("%", "%25").replace(",", "%2C") for model in self.models]
        fields = {
            "units": self.case.units,
            **{
                name: exact_text(number, parameters[name].dimension, self.case.units)
                for name, number in self.case._replace(own=own).numbers().items()
            },
            "density": None if density is None else f"{density!r} kg/m^3",
            "cutting_fraction": None if fraction == 1 else repr(fraction),
            "models": ",".join(models),
            "shown": self.shown,
            "instant": None if self.instant == 1 else repr(self.instant),
            "predict": _TEXTS[self.predict],
        }
        return urlencode({name: text for name, text in fields.items() if text is not None}, safe=",")

    def reading(self, query: Mapping[str, str], known: Collection[str]) -> "PageState":
        """Change this state as a link asks. Quantities may have units ("alpha=30 deg").

        Args:
            query: the link's query.
            known: names of all models that the page offers.

        Raises:
            ValueError: one sentence that says what is wrong in the link.
        """
        parameters = self.case.quantities()
        for name in query:
            if name not in (*parameters, *_FIELDS):
                raise ValueError(f"Field `{name}` is unknown.")
        case = self.case.to(query.get("units", self.case.units))
        case = case.reading({name: text for name, text in query.items() if name in parameters})
        checked = [unquote(name) for name in query["models"].split(",")] if "models" in query else list(self.models)
        shown = query.get("shown", self.shown if self.shown in checked else checked[0])
        for name in (*checked, shown):
            if name not in known:
                raise ValueError(f"Field `models` names {name!r}, but the page offers no such model.")
        if shown not in checked:
            raise ValueError(f"Field `shown` must be one of the models, but is {briefly(shown)}.")
        density, fraction = self.per_mass.density, query.get("cutting_fraction", repr(self.per_mass.cutting_fraction))
        if "density" in query:
            with about("Field `density`"):
                density = read_density(query["density"])
        if not _is_number(fraction):
            raise ValueError(f"Field `cutting_fraction` must be a number, but is {briefly(fraction)}.")
        instant, predict = query.get("instant", repr(self.instant)), query.get("predict", _TEXTS[self.predict])
        if not _is_number(instant) or not 0 <= float(instant) <= 1:
            raise ValueError(
                f"Field `instant` must be in [0, 1], a share of the cut's time, but is {briefly(instant)}."
            )
        if predict not in _TEXTS.values():
            raise ValueError(f"Field `predict` must be 'true' or 'false', but is {briefly(predict)}.")
        models = tuple(name for name in known if name in checked)
        per_mass = PerMass(density, float(fraction))
        return PageState(case, models, shown, per_mass, float(instant), predict == _TEXTS[True])


_COMMA = re.compile(r"\s*[+-]?(?P<whole>\d*),(?P<part>\d+)(?![\d.,])")
_LONGEST_GROUP = 3  # digits of a number between two commas that only group them: 1,000,000


def with_point(name: str, text: str) -> str:
    """The text with a point in place of a decimal comma.

    Raises:
        ValueError: for 1,000, which is a thousand to one reader and one to another.
    """
    number = _COMMA.match(text)
    if number is None:
        return text
    grouped = len(number["part"]) == _LONGEST_GROUP and 1 <= len(number["whole"].lstrip("0")) <= _LONGEST_GROUP
    if grouped:
        point, none = text.strip().replace(",", "."), text.strip().replace(",", "")
        raise ValueError(f"Field `{name}` must be written as {point} or {none}, as {text.strip()} may mean either.")
    return text.replace(",", ".", 1)


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
