"""Options that verbs share: the case and its overrides, whole numbers, the model."""

import contextlib
import dataclasses
import functools
import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, overload

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading, user_errors
from erosion.parameters.quantities import QUANTITIES
from erosion.parameters.units import example

if TYPE_CHECKING:
    from erosion.models.base import CuttingModel
    from erosion.parameters.materials import Particle, Target
    from erosion.parameters.parameters import Parameters
    from erosion.parameters.units import Dimension, System


_Options = TypeVar("_Options")


def _with_quantities(options: type[_Options], hidden: Collection[str] = ()) -> type[_Options]:
    """The same dataclass with an option, text, for each parameter of an impact; help does not list the `hidden`."""
    fields: list[tuple[str, Any, Any]] = []
    for name, quantity in QUANTITIES.items():
        such_as = "" if quantity.dimension == "1" else f": {example(quantity.dimension, 'inch-pound')}"
        bare = "; bare numbers are radians" if quantity.dimension == "angle" else ""
        help_text = f"{quantity.symbol}, {quantity.meaning}{such_as}{bare}."
        kind = Annotated[str | None, Parameter(help=help_text, allow_leading_hyphen=True, show=name not in hidden)]
        fields.append((name, kind, dataclasses.field(default=None)))
    made = dataclasses.make_dataclass(options.__name__, fields, bases=(options,), frozen=True)
    made.__module__ = options.__module__
    return made


@Parameter(name="*")
@_with_quantities
@dataclasses.dataclass(frozen=True)
class CaseOptions:
    """Which impact: a case file, and changes to it."""

    case: Annotated[Path | None, Parameter(help="Case file (TOML); Table 1 without it.")] = None
    units: Annotated[
        str | None, Parameter(help='Convert the case to "inch-pound" or "si"; bare numbers are then in these units.')
    ] = None
    particle: Annotated[
        str | None, Parameter(help='Instead of --r, --b and --m, material and diameter: "garnet 0.3 mm".')
    ] = None
    target: Annotated[
        str | None,
        Parameter(help='Instead of --sigma, a metal: "aluminium 6061", copper, … (`erosion materials` lists them).'),
    ] = None

    def given(self) -> dict[str, str]:
        """By parameter, the text of its option, where there is one."""
        texts = {name: getattr(self, name) for name in QUANTITIES}
        return {name: text for name, text in texts.items() if text is not None}

    def words(self, without: Collection[str]) -> list[str]:
        """The case as it is typed, but for the parameters `without`."""
        options = {name: getattr(self, name) for name in ("units", "particle", "target")} | self.given()
        words = [] if self.case is None else [str(self.case)]
        for name, text in options.items():
            words += [] if text is None or name in without else [f"--{name}", text]
        return words

    def parameters(self) -> "Parameters":
        """The case with its overrides, validated; `Output` says where its size does not fit its mass.

        Raises:
            InputError: one sentence naming the file or the option.
        """
        from erosion.parameters.case_files import load_case
        from erosion.parameters.parameters import TABLE_1, SizeWarning, validate

        with user_errors(), warnings.catch_warnings():
            warnings.simplefilter("ignore", SizeWarning)
            p = TABLE_1 if self.case is None else load_case(self.case)
            # Who names a particle and its size in mm means m/s by a bare 100; a case file says its own units.
            in_si = self.units is None and self.case is None and self.particle is not None
            units = "si" if in_si else self.units
            if units is not None:
                p = p.to(units)
            if self.particle is not None:
                p = self._replaced(p, p.with_particle(self.particle), "particle")
            if self.target is not None:
                p = self._replaced(p, p.with_target(self.target), "target")
        changes = {name: read_option(name, text, QUANTITIES[name].dimension, p.units)
                   for name, text in self.given().items()}  # fmt: skip
        with user_errors():
            p = dataclasses.replace(p, **changes)
            validate(p)
        return p

    def _replaced(self, p: "Parameters", named: "Parameters", option: str) -> "Parameters":
        """The case of a name, with a warning of what the case file states otherwise, a fitted ψ for example."""
        from erosion.cli.output import warn
        from erosion.parameters.case_files import stated

        if self.case is not None:
            names = [
                name
                for name in stated(self.case)
                if name not in self.given() and not math.isclose(getattr(p, name), getattr(named, name), rel_tol=1e-6)
            ]
            if names:
                warn(f"--{option} takes the place of {', '.join(names)} in {self.case}; without --{option} they stay.")
        return named

    def materials(self) -> "tuple[Particle | None, Target | None]":
        """The particle and the target, where an option or the case file names them; options win."""
        from erosion.parameters.case_files import load_materials
        from erosion.parameters.materials import particle, target

        with user_errors():
            grit, metal = (None, None) if self.case is None else load_materials(self.case)
            return (
                grit if self.particle is None else particle(self.particle),
                metal if self.target is None else target(self.target),
            )

    def model(self) -> tuple[str | None, dict[str, Any]]:
        """The model that the case file names for all verbs, and what it sets of that model's own parameters."""
        from erosion.parameters.case_files import load_model_of_case

        if self.case is None:
            return None, {}
        with user_errors():
            name, own = load_model_of_case(self.case)
        if any(not isinstance(value, str) for value in own.values()):
            self._require_own_units("field `set`")
        return name, own

    def load(self, name: str) -> "CuttingModel":
        """The model by name or path; of a correlation the one that is made for the target and the particle named.

        Raises:
            InputError: one sentence, also for a correlation that is not made for the target.
        """
        from erosion.models import load_model, made_for

        grit, metal = self.materials()
        with user_errors():
            return made_for(load_model(name), metal, grit)

    def reference(self, name: str) -> "str | CuttingModel":
        """The same; a model that no target changes by its name, by which other processes find it."""
        from erosion.models import Correlated

        model = self.load(name)
        return model if isinstance(model, Correlated) else name

    def _require_own_units(self, what: str) -> None:
        """An `InputError` where --units is not that of the file, whose bare numbers would be read in it."""
        from erosion.parameters.case_files import load_case
        from erosion.parameters.units import check_system

        if self.case is None or self.units is None:
            return
        with user_errors():
            units = load_case(self.case).units
            if check_system(self.units) != units:
                raise InputError(
                    f"Option `--units` cannot convert the {what} of {self.case}, which is in {units}: leave "
                    "one of them out."
                )

    def names(self) -> dict[str, str]:
        """The names of the particle and the target as they are typed, in options or the case file; options win."""
        from erosion.parameters.case_files import names_of_materials

        with user_errors():
            in_file = {} if self.case is None else names_of_materials(self.case)
        options = {"particle": self.particle, "target": self.target}
        return in_file | {name: text for name, text in options.items() if text is not None}

    def title(self) -> str:
        """What to call the case: its file's title or "Table 1", and what options change."""
        from erosion.parameters.case_files import case_title

        with user_errors():
            name = "Table 1" if self.case is None else case_title(self.case)
        named = [text for text in (self.particle, self.target) if text is not None]
        return ", ".join([name, *named, *(f"{QUANTITIES[q].symbol} = {text}" for q, text in self.given().items())])

    def refuse_angle(self, reason: str) -> None:
        """An `InputError` where --alpha is given to a verb that takes no angle."""
        if "alpha" in self.given():
            raise InputError(f"Option `--alpha` has no meaning here: {reason}.")

    def without_changes(self) -> "CaseOptions":
        """The case file and what holds for all of it."""
        return CaseOptions(case=self.case, units=self.units, particle=self.particle, target=self.target)

    def section(self, verb: str, fields: Sequence[str], *, parameters: bool = True) -> dict[str, Any]:
        """The table of a verb in the case file: `fields` of the verb's own, and, if it takes them, parameters.

        Raises:
            InputError: for a field that is neither, and for --units other than the file's, in which the table is.
        """
        from erosion.parameters.case_files import load_section

        if self.case is None:
            return {}
        with user_errors():
            section = load_section(self.case, verb)
        if not {*section}.isdisjoint((*QUANTITIES, "set", "uncertain")):
            self._require_own_units(f"table [{verb}]")
        known = (*fields, *QUANTITIES) if parameters else fields
        for name in section:
            if name not in known:
                raise InputError(f"{self.case}: field `{name}` of [{verb}] is unknown; they are {', '.join(known)}.")
        return section

    def texts(self, verb: str, section: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
        """By parameter, where the verb's section or an option sets it, and to what; options win."""
        in_file = {
            name: (f"{self.case}: field `{name}` of [{verb}]", section[name]) for name in QUANTITIES if name in section
        }
        return in_file | {name: (f"Option `--{name}`", text) for name, text in self.given().items()}


@Parameter(name="*")
@functools.partial(_with_quantities, hidden=("alpha",))
@dataclasses.dataclass(frozen=True)
class AllAngles(CaseOptions):
    """Which impact, at no angle of its own."""


@Parameter(name="*")
@functools.partial(_with_quantities, hidden=("alpha", "v0"))
@dataclasses.dataclass(frozen=True)
class EachRow(CaseOptions):
    """Which impact, whose angle and speed a table has."""


CaseFile = Annotated[Path | None, Parameter(help="Case file (TOML), the same as --case.")]


def with_file(options: CaseOptions | None, file: Path | None) -> CaseOptions:
    """The case's options, where its file may also stand alone before them."""
    options = options or CaseOptions()
    if file is not None and options.case is not None:
        raise InputError(f"The case must be given once, but is both {file} and {options.case}.")
    return options if file is None else dataclasses.replace(options, case=file)


JsonOption = Annotated[
    bool, Parameter(name="--json", negative="", show_default=False, help="Print JSON and nothing else.")
]


LangOption = Annotated[str, Parameter(help='Language of what is written: "en", or "de" for German.')]


def read_whole(number: Any) -> int:
    """A whole number as text or TOML has it: 32, 1e6; 1.5 is refused, not rounded."""
    with contextlib.suppress(OverflowError, TypeError, ValueError):
        if not isinstance(number, bool) and float(number) == (value := int(float(number))):
            return int(number) if str(number).isdecimal() else value
    raise ValueError(f"must be a whole number such as 1e6, but is {number!r}")


WholeOption = Annotated[int | None, Parameter(converter=lambda kind, tokens: read_whole(tokens[0].value))]


@overload
def read_option(name: str, text: str, dimension: "Dimension", units: "System") -> float: ...
@overload
def read_option(name: str, text: str | None, dimension: "Dimension", units: "System") -> float | None: ...
def read_option(name: str, text: str | None, dimension: "Dimension", units: "System") -> float | None:
    """The number of an option in a unit system; None where it is not given."""
    from erosion.parameters.units import read_quantity

    with reading(f"Option `--{name}`"):
        return None if text is None else read_quantity(text, dimension, units)
