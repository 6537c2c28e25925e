"""Options that verbs share: the case, the model, `--set` of a model's own parameters; their groups in `--help`."""

import contextlib
import dataclasses
import functools
import math
import re
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, reading, user_errors, warn
from erosion.output import briefly, is_file, split_list
from erosion.parameters import QUANTITIES, example, has_unit, unit_name
from erosion.results import Finding

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from rich.console import Console, ConsoleOptions


def in_short(verb: str, *names: str, without: Collection[str] = ()) -> str:
    """A group's last line: names of options, and with `without` those of a case's parameters, that a verb explains."""
    parameters = [name for name in QUANTITIES if name not in without] if without else []
    return f"see {verb} --help|{' '.join(f'--{name}' for name in (*names, *parameters))}"


# In the order in which help shows them.
SURFACE = Group("Surface", sort_key=1)
IMPACTS = Group("Impacts", sort_key=2)
CASE = Group("Case", sort_key=3)
_CASE_AT_ALL_ANGLES = Group("Case", help=in_short("run", without=["alpha"]), sort_key=3)
_CASE_OF_ROWS = Group(
    "Case",
    help=in_short("run", "model", "set", "density", "cutting-fraction", without=["alpha", "v0"]),
    sort_key=3,
)
MODEL = Group("Model", sort_key=4)
LAWS = Group("Laws", sort_key=5)
FIT = Group("Fit", sort_key=6)
DRAWS = Group("Draws", sort_key=7)
OPTIONS = Group("Options", sort_key=8)  # that are the verb's own
OUTPUT = Group("Output", sort_key=9)
_NAMES = 19  # characters that names have at least, so that the texts of all groups begin at one place


class Help:
    """How `--help` is printed: a line for each option or verb, so that all fit a screen."""

    def __call__(self, console: "Console", options: "ConsoleOptions", panel: "HelpPanel") -> None:
        """Print a group."""
        from rich.table import Table  # 50 ms that only a help needs
        from rich.text import Text

        if not panel.entries:
            return
        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(no_wrap=True, min_width=_NAMES if panel.format == "parameter" else 0)
        table.add_column()
        for entry in panel.entries:
            text = Text(_plain(entry.description))
            if entry.default is not None:
                text.append(f" [{entry.default}]", "dim")
            if entry.required and not entry.positional_label:
                text.append(" (needed)", "red")
            table.add_row(Text(f" {' '.join(entry.display_labels)}", "cyan"), text)
        if words := _plain(panel.description):
            where, _, names = words.partition("|")
            table.add_row(Text(f" {where}", "dim"), Text(names))
        if panel.title != "Arguments":  # stand below the sentence that needs them
            console.print(Text(str(panel.title), "bold"))
        console.print(table)

    def render_usage(self, console: "Console", options: "ConsoleOptions", usage: Any) -> None:
        """Print the first line."""
        console.print(f"Usage: {usage}".rstrip("\n"), markup=False, highlight=False)


def _plain(text: Any) -> str:
    """A text as cyclopts wraps it."""
    return str(getattr(text, "primary_renderable", text) or "")


_Options = TypeVar("_Options")
_Read = Callable[[str, Any, Any], Any]


def _with_quantities(options: type[_Options], *, show: bool = True) -> type[_Options]:
    """The same dataclass with an option, text, for each parameter of an impact."""
    fields: list[tuple[str, Any, Any]] = []
    for name, quantity in QUANTITIES.items():
        such_as = "" if quantity.dimension == "1" else f": {example(quantity.dimension, 'inch-pound')}"
        help_text = f"{quantity.symbol}, {quantity.meaning}{such_as}."
        kind = Annotated[str | None, Parameter(help=help_text, allow_leading_hyphen=True, show=show)]
        fields.append((name, kind, dataclasses.field(default=None)))
    made = dataclasses.make_dataclass(options.__name__, fields, bases=(options,), frozen=True)
    made.__module__ = options.__module__
    return made


@Parameter(name="*", group=CASE)
@_with_quantities
@dataclasses.dataclass(frozen=True)
class CaseOptions:
    """Options of an impact: a case file, and changes to it."""

    case: Annotated[Path | None, Parameter(parse=False)] = None
    usual_units: Annotated[str | None, Parameter(parse=False)] = None
    units: Annotated[str | None, Parameter(help='Of bare numbers, and of the result: "inch-pound", "si".')] = None
    particle: Annotated[str | None, Parameter(help='For r, b, m: "garnet 0.3 mm" or "garnet 80 mesh".')] = None
    target: Annotated[
        str | None,
        Parameter(help='A metal, for σ: "aluminium 6061", see `erosion materials`.'),
    ] = None

    @functools.cached_property
    def file(self) -> "lazy.CaseFile | None":
        """The case file, read once for all that a verb wants of it."""
        with user_errors():
            return None if self.case is None else lazy.CaseFile.read(self.case)

    def given(self) -> dict[str, str]:
        """By parameter, the text of its option, where there is one."""
        texts = {name: getattr(self, name) for name in QUANTITIES}
        return {name: text for name, text in texts.items() if text is not None}

    def words(self, without: Collection[str]) -> list[str]:
        """The case as it is typed, but for the parameters `without`."""
        named = {"units": self.units or self.usual_units, "particle": self.particle, "target": self.target}
        words = [] if self.case is None else [str(self.case)]
        options = {name: text for name, text in (named | self.given()).items() if name not in without}
        return [*words, *lazy.options_in_words(options)]

    def parameters(self, *, changed: bool = True, free: Collection[str] = ()) -> "lazy.Parameters":
        """The case, validated; `Output` says where its size does not fit its mass.

        Args:
            changed: whether by the options of its parameters, too, which may be laws or axes.
            free: the parameters that a fit changes.

        Raises:
            InputError: one sentence naming the file or the option.
        """
        with user_errors(), warnings.catch_warnings():
            warnings.simplefilter("ignore", lazy.SizeWarning)
            p = lazy.TABLE_1 if self.file is None else self.file.parameters()
            usual = "si" if self.usual_units is None and self.particle is not None else self.usual_units
            units = usual if self.units is None and self.case is None else self.units
            if units is not None:
                p = p.to(units)
            if self.particle is not None:
                p = self._replaced(p, p.with_particle(self.particle), "particle")
            if self.target is not None:
                p = self._replaced(p, p.with_target(self.target), "target")
        given = self.given() if changed else {}
        changes = {name: self.read(name, text, QUANTITIES[name].dimension) for name, text in given.items()}
        with user_errors():
            p = dataclasses.replace(p, **changes)
            lazy.validate(p)
        if changed and {"sigma", "psi"}.isdisjoint(free):
            self.warn_of_flow_stress(changes)
        return p

    @functools.cached_property
    def system(self) -> "lazy.System":
        """The unit system of bare numbers, in which results are shown."""
        return self.parameters(changed=False).shown_in

    def read(
        self,
        option: str,
        text: str | None,
        dimension: "lazy.Dimension",
        read: "_Read | None" = None,
    ) -> Any:
        """The number of an option in SI; None where it is not given.

        Args:
            option: its name.
            text: what is typed.
            dimension: of the number.
            read: takes the text, the dimension and the units of bare numbers; without it a number is read.

        Raises:
            InputError: also for a bare number whose unit neither --units nor a case file says.
        """
        if text is None:
            return None
        self.require_unit(f"--{option} ", text, dimension)
        with reading(f"Option `--{option}`"):
            return (read or lazy.read_quantity)(text, dimension, self.system)

    def read_ends(
        self, source: str, typed: str, ends: tuple[str, str], dimension: "lazy.Dimension"
    ) -> tuple[float, float]:
        """The numbers of the two ends of a range; "1:3 GPa" is from 1 GPa.

        Args:
            source: words for the option.
            typed: see the function `require_unit`.
            ends: what is typed.
            dimension: of the numbers.

        Raises:
            InputError: also for bare numbers, see `read`.
        """
        shared = lazy.unit_of(ends[0]) or lazy.unit_of(ends[1])
        numbers = {}
        # The end with the unit is read first, so that a message shows what was typed.
        for end in sorted(ends, key=lazy.unit_of, reverse=True):
            text = end if lazy.unit_of(end) else end + shared
            self.require_unit(typed, text, dimension)
            with reading(source):
                numbers[end] = lazy.read_quantity(text, dimension, self.system)
        return numbers[ends[0]], numbers[ends[1]]

    def require_unit(self, typed: str, text: str, dimension: "lazy.Dimension") -> None:
        """Refuse a bare number unless --units or a case file says its unit; see the function."""
        if self.case is None and self.units is None:
            require_unit(typed, text, dimension, ", or come with --units si or --units inch-pound")

    def read_settings(
        self,
        name: str,
        model: "lazy.CuttingModel",
        given: "Settings",
        read: "Callable[[str, Any, lazy.Dimension, lazy.System], Any] | None" = None,
    ) -> dict[str, Any]:
        """The values of settings.

        Args:
            name: the model's name, for messages.
            model: the model whose own parameters are set.
            given: see `settings`.
            read: takes an own parameter's name, its text, its dimension and the units of bare numbers; gives its
                value, or several, or its law; without it a number.

        Raises:
            InputError: one sentence naming the option or the field.
        """
        own, values = lazy.own_parameters(model), {}
        for key, (source, text) in given.items():
            if key not in own:
                has = f"has {', '.join(own)}" if own else "has none"
                raise InputError(f"{source} must name an own parameter of {name}, which {has}.")
            dimension = own[key].quantity.dimension
            self.require_unit(f"--set {key}=", str(text), dimension)
            with reading(source):
                of = dimension, self.system
                values[key] = lazy.read_quantity(str(text), *of) if read is None else read(key, text, *of)
            # Not those of a law.
            numbers = np.asarray(values[key] if isinstance(values[key], (float, np.ndarray)) else ())
            lazy.refuse(
                f"{source} must be ",
                (not np.isfinite(numbers).all(), f"finite, but is {text}."),
                ((numbers < own[key].least).any(), f"at least {own[key].least:g}, but is {text}."),
                kind=InputError,
            )
        return values

    def warn_once(self, finding: Finding) -> None:
        """A finding, also where several parts of a verb ask for it."""
        if finding not in self._told:
            self._told.append(finding)
            warn(finding)

    @functools.cached_property
    def _told(self) -> list[Finding]:
        return []

    def warn_of_flow_stress(self, given: Mapping[str, Any]) -> None:
        """A warning where the ψ of a named metal stays beside another σ, which leaves the metal's hardness.

        Args:
            given: by parameter, what takes the place of the case's: a number, values or a law.
        """
        metal = self.materials()[1]
        names = {*given} if self.file is None or self.target is not None else {*given, *self.file.stated}
        if metal is None or "sigma" not in names or "psi" in names:
            return
        p = self.parameters(changed=False)
        sigma = given.get("sigma", p.sigma)
        values = sigma.ppf(0.5) if hasattr(sigma, "ppf") else sigma
        shares = np.ravel(values) / metal.parameters["sigma"]
        least, greatest = (end / metal.flow_stress for end in metal.flow_stress_range)
        if ((shares < 0.99 * least) | (shares > 1.01 * greatest)).any():
            self.warn_once(Finding("other_flow_stress", metal.name, {"psi": metal.psi}))

    def _replaced(self, p: "lazy.Parameters", named: "lazy.Parameters", option: str) -> "lazy.Parameters":
        """The case of a name, with a warning of what the case file states otherwise, a fitted ψ for example."""
        if self.file is not None:
            names = [
                name
                for name in self.file.stated
                if name not in self.given() and not math.isclose(getattr(p, name), getattr(named, name), rel_tol=1e-6)
            ]
            if names:
                self.warn_once(Finding("name_replaces_field", str(self.case), {"option": option, "fields": names}))
        return named

    def materials(self) -> "tuple[lazy.Particle | None, lazy.Target | None]":
        """The particle and the target, where an option or the case file names them; options win."""
        with user_errors():
            grit, metal = (None, None) if self.file is None else self.file.materials()
            return (
                grit if self.particle is None else lazy.particle(self.particle),
                metal if self.target is None else lazy.target(self.target),
            )

    def model(self) -> tuple[str | None, dict[str, Any]]:
        """The model that the case file names for all verbs, and what it sets of that model's own parameters."""
        if self.file is None:
            return None, {}
        with user_errors():
            name, own = self.file.model()
        if any(not isinstance(value, str) for value in own.values()):
            self._require_own_units("field `set`")
        return name, own

    def changed(self, p: "lazy.Parameters") -> Finding | None:
        """The finding that the plug-in of the case file has other equations than when it was fitted."""
        digest = None if self.file is None else self.file.section("advise").get("equations")
        name, _ = self.model()
        if digest is None or name is None or lazy.plug_in_digest(lazy.load_model(name)) == digest:
            return None
        return Finding("equations_changed", str(self.case), {"model": name})

    def load(self, name: str) -> "lazy.CuttingModel":
        """The model by name or path; of a correlation the one that is made for the target and the particle named.

        Raises:
            InputError: one sentence, also for a correlation that is not made for the target.
        """
        grit, metal = self.materials()
        with user_errors():
            return lazy.made_for(lazy.load_model(name), metal, grit)

    def load_as_set(
        self, name: str, given: "Settings | None" = None, loaded: "lazy.CuttingModel | None" = None
    ) -> "lazy.CuttingModel":
        """The same with the own parameters that are `given`; without any, with those that the case file sets of it."""
        model, of_file = loaded or self.load(name), None if self.file is None else self.file.model()[0]
        if not given and of_file is not None and is_same_model(of_file, name):
            given = settings((), with_model_of_case({}, self, [name]), f"{self.case}: `set`")
        if not given:
            return model
        return model.replace(**self.read_settings(name, model, given))

    def reference(self, name: str, *, as_set: bool = False) -> "str | lazy.CuttingModel":
        """The model, with `as_set` as `load_as_set` gives it; by its name, which other processes know, where it can."""
        loaded = self.load(name)
        model = self.load_as_set(name, loaded=loaded) if as_set else loaded
        return name if model is loaded and not isinstance(model, lazy.Correlated) else model

    def _require_own_units(self, what: str) -> None:
        """An `InputError` where --units is not that of the file, whose bare numbers would be read in it."""
        if self.file is None or self.units is None:
            return
        with user_errors():
            units = self.file.parameters().shown_in
            if lazy.check_system(self.units) != units:
                raise InputError(
                    f"Option `--units` cannot convert the {what} of {self.case}, which is in {units}: leave "
                    "one of them out."
                )

    def names(self) -> dict[str, str]:
        """The names of the particle and the target as they are typed, in options or the case file; options win."""
        in_file = {} if self.file is None else self.file.names
        options = {"particle": self.particle, "target": self.target}
        return in_file | {name: text for name, text in options.items() if text is not None}

    def title(self, system: "lazy.System") -> str:
        """The name of the case: its title or "Table 1", and changes by options, bare numbers in `system`."""
        with user_errors():
            name = "Table 1" if self.file is None else self.file.title()
        named = [text for text in (self.particle, self.target) if text is not None]
        changes = []
        for q, text in self.given().items():
            unit = "" if has_unit(text) else unit_name(QUANTITIES[q].dimension, system)
            changes.append(f"{QUANTITIES[q].symbol} = {text} {unit}".rstrip())
        return ", ".join([name, *named, *changes])

    def refuse_given(self, reason: str, *names: str) -> None:
        """An `InputError` where an option of a parameter is given to a verb that does not take it."""
        for name in names:
            if name in self.given():
                raise InputError(f"Option `--{name}` has no meaning here: {reason}.")

    def section(self, verb: str, fields: Sequence[str], *, parameters: bool = True) -> dict[str, Any]:
        """The table of a verb in the case file: `fields` of the verb's own, and, if it takes them, parameters.

        Raises:
            InputError: for a field that is neither, and for --units other than the file's, in which the table is.
        """
        if self.file is None:
            return {}
        with user_errors():
            section = self.file.section(verb)
        if not {*section}.isdisjoint((*QUANTITIES, "set", "uncertain")):
            self._require_own_units(f"table [{verb}]")
        known = (*fields, *QUANTITIES) if parameters else fields
        for name in section:
            if name not in known:
                raise InputError(f"{self.case}: field `{name}` of [{verb}] is unknown; they are {', '.join(known)}.")
        return section

    def fields(self, verb: str, section: Mapping[str, Any], **options: Any) -> dict[str, str]:
        """By name, words for the field of the verb's section that gives what no option does."""
        absent = [name for name, option in options.items() if option is None and name in section]
        return {name: f"{self.case}: field `{name}` of [{verb}]" for name in absent}

    def texts(self, verb: str, section: Mapping[str, Any]) -> dict[str, tuple[str, Any]]:
        """By parameter, where the verb's section or an option sets it, and to what; options win."""
        in_file = {
            name: (f"{self.case}: field `{name}` of [{verb}]", section[name]) for name in QUANTITIES if name in section
        }
        return in_file | {name: (f"Option `--{name}`", text) for name, text in self.given().items()}


@Parameter(name="*", group=_CASE_AT_ALL_ANGLES)
@functools.partial(_with_quantities, show=False)
@dataclasses.dataclass(frozen=True)
class AllAngles(CaseOptions):
    """Options of an impact without an angle."""


@Parameter(name="*", group=_CASE_OF_ROWS)
@functools.partial(_with_quantities, show=False)
@dataclasses.dataclass(frozen=True)
class EachRow(CaseOptions):
    """Options of an impact whose angle and speed a table has."""


CaseArgument = Annotated[Path | None, Parameter(help="Case file (TOML); Table 1 without it.")]


def with_file(options: CaseOptions | None, file: Path | None) -> CaseOptions:
    """The case of a file and of the options that change it.

    Raises:
        InputError: for a bare number whose unit neither the file nor --units says.
    """
    made = dataclasses.replace(options or CaseOptions(), case=file)
    for name, text in made.given().items():
        made.require_unit(f"--{name} ", text, QUANTITIES[name].dimension)
    return made


_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")


def require_unit(typed: str, text: str, dimension: "lazy.Dimension", otherwise: str = "") -> None:
    """Refuse a bare number of a quantity that has a dimension, an angle too; 0 is the same in all units.

    A law needs a unit in each number but for spreads and shapes: "normal(110 m/s, 5 m/s)", "lognormal(110 m/s, 0.1)";
    of an axis the last part may be its count.

    Args:
        typed: what stands before the number: "--v0 ", "--set threshold=".
        text: the number, an axis or a law.
        dimension: of the quantity.
        otherwise: what else can be done, for the message.
    """
    if dimension == "1":
        return
    parts = text.removesuffix("log").rstrip(": ").split(":")
    numbers = lazy.numbers_with_unit(text) if "(" in text else parts[:2] if len(parts) > 1 else text.split(",")
    if bare := [number.strip() for number in numbers if _is_bare(number)]:
        option, such_as = typed.partition("=")[0].strip(), f"{typed}{example(dimension, 'si')}"
        has = f"is {briefly(text)}" if bare == [text] else f"has {bare[0]} in {briefly(text)}"
        raise InputError(f"Option `{option}` must have a unit, such as {such_as}{otherwise}, but {has}.")


def _is_bare(part: str) -> bool:
    number = _NUMBER.fullmatch(part.strip())
    return number is not None and float(number[0]) != 0


def ending(*suffixes: str) -> Callable[[Any, Path | None], None]:
    """A validator of a path's ending."""

    def validate(kind: Any, path: Path | None) -> None:
        if path is not None and path.suffix not in suffixes:
            *others, last = suffixes
            listed = f"{', '.join(others)} or {last}" if others else last
            raise ValueError(f"must end in {listed}, but is {path}")

    return validate


def output_option(help_text: str, *suffixes: str) -> Parameter:
    """The option -o, a file with one of these endings, or any where none is given."""
    validator = ending(*suffixes) if suffixes else None
    return Parameter(name=("--output", "-o"), group=OUTPUT, help=help_text, validator=validator)


JsonOption = Annotated[
    bool,
    Parameter(name="--json", negative="", show_default=False, group=OUTPUT, help="Print JSON and nothing else."),
]


PlotOption = Annotated[
    Path | None, Parameter(group=OUTPUT, help='Also draw it: "a.svg"; for print "a.png,a.pdf@84mm".')
]


def read_whole(number: Any) -> int:
    """A whole number as text or TOML has it: 32, 1e6; 1.5 is refused, not rounded."""
    with contextlib.suppress(OverflowError, TypeError, ValueError):
        if not isinstance(number, bool) and float(number) == (value := int(float(number))):
            return int(number) if str(number).isdecimal() else value
    raise ValueError(f"must be a whole number such as 1e6, but is {briefly(number)}")


WholeOption = Annotated[int | None, Parameter(converter=lambda kind, tokens: read_whole(tokens[0].value))]


def read_list(text: str) -> list[str]:
    """The items of a list, see `split_list`; a ValueError where there is none."""
    items = [item for item in split_list(text) if item]
    if not items:
        raise ValueError(f"must list one item or more, but is {briefly(text)}")
    return items


def read_models(text: str) -> list[str]:
    """The models that a text names; the path of a file may have a comma."""
    return [text] if is_file(text) else read_list(text)


LISTED = Parameter(
    negative="", converter=lambda kind, tokens: [item for token in tokens for item in read_list(token.value)]
)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class TableOptions:
    """Options of reading a table."""

    columns: Annotated[str | None, Parameter(help='Units, names: "x,y,z=mm, d50=diameter [um]"; or a .toml.')] = None
    ignore: Annotated[list[str] | None, LISTED, Parameter(help='Columns to leave out, such as "frequency".')] = None
    sep: Annotated[str | None, Parameter(help='Between cells: ";", "tab"; or as its header shows.')] = None
    decimal: Annotated[str | None, Parameter(help='Mark of decimals of a text, "," or "."; or as it shows.')] = None

    @property
    def arguments(self) -> dict[str, Any]:
        """The same as arguments of a reader."""
        return {"columns": self.columns, "ignore": self.ignore or (), "sep": self.sep, "decimal": self.decimal}


ModelOption = Annotated[
    str, Parameter(name="--model", group=MODEL, help="A name, see `erosion models`, or the path of a Python file.")
]
ModelsOption = Annotated[
    list[str] | None,
    Parameter(
        name="--model",
        negative="",
        converter=lambda kind, tokens: [item for token in tokens for item in read_models(token.value)],
        group=MODEL,
        help='Names or paths of files: "linearized,rotating", or "all".',
    ),
]


def chosen_models(names: Sequence[str] | Any) -> Any:
    """The models that are named, where "all" stands for every usable one."""
    if not isinstance(names, list) or "all" not in names:
        return names
    others = [name for name in names if name != "all"]
    return list(dict.fromkeys((*lazy.usable_models(), *others)))


def refuse_same(models: "Mapping[str, lazy.CuttingModel]") -> None:
    """Refuse two names of one model, as "dnv" and "dnv:carbon-steel" are for a target of steel.

    Args:
        models: by the names that are given; correlations are made for the target.
    """
    first: dict[str, str] = {}
    for name, model in models.items():
        other = first.setdefault(lazy.called(name, model), name)
        if other != name:
            raise InputError(
                f"Option `--model` must name different models, but `{other}` and `{name}` are the same here: "
                f"{lazy.called(name, model)}."
            )


SetOption = Annotated[
    list[str] | None,
    Parameter(
        name="--set", negative="", group=MODEL, help='An own parameter of the model: "friction=0.3"; repeatable.'
    ),
]
Settings = Mapping[str, tuple[str, Any]]
"""By own parameter, where it is set and to what."""


def model_and_settings(
    given: str | None, own: Sequence[str] | None, case: CaseOptions, usual: str = "linearized"
) -> tuple[str, Settings]:
    """The model's name and its settings: those of the options, where these give none those of the case file.

    Args:
        given: the option --model.
        own: the options --set.
        case: whose file may name a model.
        usual: the model where nothing names one.
    """
    section = with_model_of_case({}, case, None if given is None else [given])
    return section.get("model", usual) if given is None else given, settings(own, section, f"{case.case}: `set`")


def named_model(given: str | None, own: Sequence[str] | None, case: CaseOptions) -> "tuple[str, lazy.CuttingModel]":
    """The name and the model, with its own parameters set; see `model_and_settings`."""
    name, of_model = model_and_settings(given, own, case)
    model = case.load_as_set(name, of_model)
    return lazy.called(name, model), model


def with_model_of_case(section: Mapping[str, Any], case: CaseOptions, given: Sequence[str] | None) -> Mapping[str, Any]:
    """A verb's table in the case file with the model, and its parameters, that the file names for all verbs.

    Args:
        section: the table; what it says itself wins.
        case: whose file may name a model.
        given: the models of the option --model; another one than the file's leaves out its parameters, too.
    """
    model, own = case.model()
    if model is None or section.get("model", model) != model:
        return section
    if given is not None and (len(given) != 1 or not is_same_model(given[0], model)):
        return section
    of_verb = section.get("set", {})
    return {**section, "model": model, "set": {**own, **of_verb} if isinstance(of_verb, Mapping) else of_verb}


def is_same_model(one: str, other: str) -> bool:
    """Whether two texts are one model's name, or paths of one file."""
    names = {Path(model).resolve() if model.endswith(".py") else model for model in (one, other)}
    return len(names) == 1


def settings(options: Sequence[str] | None, section: Mapping[str, Any] | None = None, where: str = "") -> Settings:
    """The own parameters that the options and the table `set` of a verb's section set; options win.

    Args:
        options: texts such as "friction=0.3".
        section: the verb's table in the case file.
        where: words for that table, for messages.

    Raises:
        InputError: one sentence naming the option or the field.
    """
    table = (section or {}).get("set", {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table such as {{friction = 0.3}}, but is {briefly(table)}.")
    in_file = {name: (f"{where}, field `{name}`,", value) for name, value in table.items()}
    in_options: dict[str, tuple[str, Any]] = {}
    for text in options or ():
        name, equals, value = (part.strip() for part in text.partition("="))
        lazy.refuse(
            "Option `--set` must ",
            (not (name and equals and value), f'be such as "friction=0.3", but is {briefly(text)}.'),
            (name in in_options, f"give `{name}` once, but gives it several times."),
            kind=InputError,
        )
        in_options[name] = (f"Option `--set {name}`", value)
    return in_file | in_options


def asked(options: Any, section: Mapping[str, Any]) -> dict[str, Any]:
    """By name, the options of a group that are given, and the fields of a verb's section that give the others.

    Args:
        options: a dataclass of options, None where one is not given.
        section: the verb's table in the case file.
    """
    given = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    in_file = {name: section[name] for name in given if name in section}
    return in_file | {name: value for name, value in given.items() if value is not None}


def in_full(name: str, model: "lazy.CuttingModel", system: "lazy.System") -> str:
    """A model's name with its own parameters: "linearized-deformation (energy_ratio = 1.6, threshold = 12 m/s)"."""
    own = lazy.own_in_words(model, system=system)
    return f"{name} ({own})" if own else name
