"""What one browser tab shows, and the link that carries it."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple
from urllib.parse import urlencode

import numpy as np

from erosion.models.base import CuttingModel
from erosion.models.own_parameters import own_parameters
from erosion.parameters.parameters import QUANTITIES, Parameters, validate
from erosion.parameters.quantities import Quantity
from erosion.parameters.units import System, conversion_factor, read_quantity

_NAMES = tuple(QUANTITIES)
_SAID = {True: "true", False: "false"}


class OwnNumber(NamedTuple):
    """The number of one of a model's own parameters.

    Args:
        model: what the page calls the model.
        name: of the parameter.
        value: in the units of the case.
        quantity: symbol, meaning and dimension.
    """

    model: str
    name: str
    value: float
    quantity: Quantity

    @property
    def key(self) -> str:
        """The parameter's name on the page and in links, which no other model has."""
        return f"{self.model}.{self.name}"

    def read(self, text: str, units: System) -> "OwnNumber":
        """With the number that a text says.

        Raises:
            ValueError: a sentence on what is wrong with it.
        """
        try:
            value = read_quantity(text, self.quantity.dimension, units)
        except ValueError as error:
            raise ValueError(f"Field `{self.key}` {error}.") from error
        if not np.isfinite(value):
            raise ValueError(f"Field `{self.key}` must be a finite number, but is {text}.")
        return self._replace(value=value)


def own_numbers(models: Mapping[str, CuttingModel]) -> tuple[OwnNumber, ...]:
    """The numbers of all own parameters of models by name."""
    return tuple(
        OwnNumber(model, name, float(one.value), one.quantity)
        for model, loaded in models.items()
        for name, one in own_parameters(loaded).items()
    )


class Case(NamedTuple):
    """The parameters of one impact as numbers, so that answers can be kept by it.

    Args:
        values: in the order of `QUANTITIES`.
        units: their unit system.
        own: the own parameters of all models.
    """

    values: tuple[float, ...]
    units: System
    own: tuple[OwnNumber, ...] = ()

    @classmethod
    def of(cls, p: Parameters, own: tuple[OwnNumber, ...] = ()) -> "Case":
        """The case of scalar parameters, and models' own in the same units."""
        return cls(tuple(float(getattr(p, name)) for name in _NAMES), p.units, own)

    def parameters(self) -> Parameters:
        """The same as parameters, without models' own."""
        return Parameters(**dict(zip(_NAMES, self.values, strict=True)), units=self.units)

    def with_parameters(self, p: Parameters) -> "Case":
        """Other parameters of the case, in its units; models' own stay."""
        return Case.of(p, self.own)

    def of_model(self, name: str) -> "Case":
        """What of the case matters to one model: the own parameters of others left out."""
        return self._replace(own=tuple(one for one in self.own if one.model == name))

    def own_values(self, model: str) -> dict[str, float]:
        """A model's own parameters, by the names that they have in the model."""
        return {one.name: one.value for one in self.own if one.model == model}

    def numbers(self) -> dict[str, float]:
        """Each parameter's number by its name, models' own by their keys."""
        return dict(zip(_NAMES, self.values, strict=True)) | {one.key: one.value for one in self.own}

    def quantities(self) -> dict[str, Quantity]:
        """What each of them is called."""
        return {**QUANTITIES, **{one.key: one.quantity for one in self.own}}

    def replace(self, **changes: float) -> "Case":
        """The case with some numbers changed, validated.

        Raises:
            ValueError: for a number out of range.
        """
        own = tuple(one._replace(value=changes.pop(one.key, one.value)) for one in self.own)
        p = self.parameters().replace(**changes)
        validate(p)
        return Case.of(p, own)

    def reading(self, texts: Mapping[str, str]) -> "Case":
        """The case with some parameters as texts have them: "30 deg", "100 m/s".

        Raises:
            ValueError: a sentence on what is wrong with one of them.
        """
        numbers: dict[str, Any] = dict(zip(_NAMES, self.values, strict=True))
        p = Parameters.from_quantities(self.units, {name: texts.get(name, number) for name, number in numbers.items()})
        own = [one.read(texts[one.key], self.units) if one.key in texts else one for one in self.own]
        return Case.of(p, tuple(own))

    def read(self, name: str, text: str) -> "Case":
        """The case with one parameter as a person typed it: "30", "100 m/s"; bare angles are degrees.

        Raises:
            ValueError: a sentence on what is wrong with it.
        """
        return self.reading({name: f"{text} deg" if name == "alpha" and _is_number(text) else text})

    def to(self, units: str) -> "Case":
        """The same impact in another unit system."""
        p = self.parameters().to(units)
        factors = [conversion_factor(one.quantity.dimension, self.units, p.units) for one in self.own]
        pairs = zip(self.own, factors, strict=True)
        return Case.of(p, tuple(one._replace(value=one.value * factor) for one, factor in pairs))

    def at_any_angle(self) -> "Case":
        """What all angles of this case have in common."""
        return self.replace(alpha=1.0)

    def at_any_spin(self) -> "Case":
        """What all angles and spins of this case have in common."""
        return self.replace(alpha=1.0, phidot0=0.0)


@dataclasses.dataclass(frozen=True)
class State:
    """Everything that a tab shows.

    Args:
        case: the impact.
        models: names of the checked models, in the order of the list; at least one.
        shown: the one of them whose cut is drawn.
        instant: at which its erodent is shown, as a share of the cut's time.
        dark: whether the page is; None as the browser prefers.
    """

    case: Case
    models: tuple[str, ...]
    shown: str
    instant: float = 1.0
    dark: bool | None = None

    def checking(self, models: tuple[str, ...]) -> "State":
        """With other models checked; the cut drawn stays where it can."""
        return dataclasses.replace(self, models=models, shown=self.shown if self.shown in models else models[0])

    def query(self) -> str:
        """The state as the query of a link, exact to the last bit; of the models that are not checked nothing."""
        own = tuple(one for one in self.case.own if one.model in self.models)
        numbers = {name: repr(number) for name, number in self.case._replace(own=own).numbers().items()}
        said = {"units": self.case.units, **numbers, "models": ",".join(self.models), "shown": self.shown}
        if self.instant != 1:
            said["instant"] = repr(self.instant)
        if self.dark is not None:
            said["dark"] = _SAID[self.dark]
        return urlencode(said, safe=",")

    def reading(self, query: Mapping[str, str], known: Collection[str]) -> "State":
        """This state, changed by what a link says; quantities may carry units ("alpha=30 deg").

        Args:
            query: the link's query.
            known: names of the models there are.

        Raises:
            ValueError: one sentence on what the link has wrong.
        """
        parameters = self.case.quantities()
        for name in query:
            if name not in (*parameters, "units", "models", "shown", "instant", "dark"):
                raise ValueError(f"Field `{name}` is unknown.")
        case = self.case.to(query.get("units", self.case.units))
        case = case.reading({name: text for name, text in query.items() if name in parameters})
        asked = query["models"].split(",") if "models" in query else list(self.models)
        shown = query.get("shown", self.shown if self.shown in asked else asked[0])
        for name in (*asked, shown):
            if name not in known:
                raise ValueError(f"Field `models` names {name!r}, which is not one of the models here.")
        if shown not in asked:
            raise ValueError(f"Field `shown` must be one of the models, but is {shown!r}.")
        instant, dark = query.get("instant", repr(self.instant)), query.get("dark")
        if not _is_number(instant) or not 0 <= float(instant) <= 1:
            raise ValueError(f"Field `instant` must be in [0, 1], a share of the cut's time, but is {instant!r}.")
        if dark not in (None, *_SAID.values()):
            raise ValueError(f"Field `dark` must be 'true' or 'false', but is {dark!r}.")
        models = tuple(name for name in known if name in asked)
        return State(case, models, shown, float(instant), self.dark if dark is None else dark == _SAID[True])


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
