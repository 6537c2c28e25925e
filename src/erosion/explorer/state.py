"""What one browser tab shows, and the link that carries it."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple
from urllib.parse import urlencode

import numpy as np

from erosion.parameters import QUANTITIES, Parameters, validate
from erosion.units import System

_NAMES = tuple(QUANTITIES)
_SAID = {True: "true", False: "false"}


class Case(NamedTuple):
    """The parameters of one impact as numbers, so that answers can be kept by it.

    Args:
        values: in the order of `QUANTITIES`.
        units: their unit system.
    """

    values: tuple[float, ...]
    units: System

    @classmethod
    def of(cls, p: Parameters) -> "Case":
        """The case of scalar parameters."""
        return cls(tuple(float(getattr(p, name)) for name in _NAMES), p.units)

    def parameters(self) -> Parameters:
        """The same as parameters."""
        return Parameters(**self.numbers(), units=self.units)

    def numbers(self) -> dict[str, float]:
        """Each parameter's number by its name."""
        return dict(zip(_NAMES, self.values, strict=True))

    def replace(self, **changes: float) -> "Case":
        """The case with some numbers changed, validated.

        Raises:
            ValueError: for a number out of range.
        """
        p = self.parameters().replace(**changes)
        validate(p)
        return Case.of(p)

    def read(self, name: str, text: str) -> "Case":
        """The case with one parameter as a person typed it: "30", "100 m/s"; bare angles are degrees.

        Raises:
            ValueError: a sentence on what is wrong with it.
        """
        if name == "alpha" and _is_number(text):
            text = f"{text} deg"
        quantities: dict[str, Any] = self.numbers()
        return Case.of(Parameters.from_quantities(self.units, quantities | {name: text}))

    def to(self, units: str) -> "Case":
        """The same impact in another unit system."""
        return Case.of(self.parameters().to(units))

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
        """The state as the query of a link, exact to the last bit."""
        numbers = {name: repr(number) for name, number in self.case.numbers().items()}
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
        for name in query:
            if name not in (*QUANTITIES, "units", "models", "shown", "instant", "dark"):
                raise ValueError(f"Field `{name}` is unknown.")
        case = self.case.to(query.get("units", self.case.units))
        quantities: dict[str, Any] = case.numbers()
        quantities |= {name: text for name, text in query.items() if name in QUANTITIES}
        case = Case.of(Parameters.from_quantities(case.units, quantities))
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
