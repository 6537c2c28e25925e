"""Case files: the parameters of an impact in TOML, with quantities as strings.

    units = "inch-pound"          # of bare numbers, and of the results as they are shown
    v0 = "4400 in/s"
    alpha = "20 deg"
    k = 2

A file without `units` is in SI, and then every dimensional quantity must carry its unit. In place of r, b, m and σ it
may name the particle and the target:

    particle = "garnet 0.3 mm"
    target = "aluminium 6061"

A path in a file, of a model, a table or draws, begins at the folder of this file (`erosion.output.files.beside`).
"""

import contextlib
import dataclasses
import functools
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import check_path, refuse
from erosion.output.files import beside, is_file, read_toml
from erosion.output.tables import briefly
from erosion.parameters.materials import Particle, Target, particle, target
from erosion.parameters.parameters import QUANTITIES, Parameters, require_scalars, warn_of_size
from erosion.parameters.per_mass import PerMass, read_density
from erosion.parameters.quantities import (
    about,
    check_system,
    exact_text,
    has_control_characters,
    has_unit,
    read_quantity,
    unit_name,
)
from erosion.results import Finding, stated

_SIDES = {"alpha": ("flattest", "steepest"), "v0": ("slowest", "fastest"), "m": ("lightest", "heaviest")}
_UNITS = {"alpha": ("deg", 180 / np.pi), "v0": ("m/s", 1.0), "m": ("kg", 1.0)}
_SAME = 0.005  # relative: of numbers that were rounded


@dataclasses.dataclass(frozen=True)
class Tested:
    """Ranges of the rows of a fit.

    Args:
        ranges: least and greatest of "alpha" [rad], "v0" [m/s] and "m" [kg].
    """

    ranges: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Tested":
        """Of numbers or arrays by name."""
        return cls({name: (float(np.min(rows)), float(np.max(rows))) for name, rows in values.items()})

    @classmethod
    def read(cls, table: Any) -> "Tested":
        """Of the field `tested` of a case file: {v0 = ["60 m/s", "90 m/s"], …}.

        Raises:
            ValueError: with a clause that starts with "must", for another table.
        """
        ranges = {}
        example = 'must be a table such as {v0 = ["60 m/s", "90 m/s"]}, of ' + ", ".join(_SIDES)
        for name, ends in table.items() if isinstance(table, dict) else [("", [])]:
            are_texts = isinstance(ends, list) and all(isinstance(end, str) and has_unit(end) for end in ends)
            if name not in _SIDES or not are_texts or len(ends) != 2:
                raise ValueError(f"{example}, but is {briefly(table)}")
            low, high = (read_quantity(end, QUANTITIES[name].dimension) for end in ends)
            if not 0 < low <= high < np.inf:
                raise ValueError(f"{example}, but is {briefly(table)}")
            ranges[name] = low, high
        return cls(ranges)

    def dump(self) -> str:
        """The text that `read` understands."""
        listed = []
        for name, ends in self.ranges.items():
            unit, factor = _UNITS[name]
            low, high = (f'"{end * factor:.9g} {unit}"' for end in ends)
            listed.append(f"{name} = [{low}, {high}]")
        return f"{{ {', '.join(listed)} }}"

    def outside(self, values: Mapping[str, Any], about: str = "") -> list[Finding]:
        """Findings on values, numbers or arrays by name, that lie outside: "120 m/s is 1.33 × the fastest test"."""
        found = []
        for name, (low, high) in self.ranges.items():
            if name in values:
                least, most = float(np.min(values[name])), float(np.max(values[name]))
                lower, upper = _SIDES[name]
                beyond = (most, high, upper, most - high), (least, low, lower, low - least)
                for value, end, side, excess in beyond:
                    if excess > end * _SAME:
                        shown = QUANTITIES[name].in_words(value, "si")
                        numbers = {"value": value, "shown": shown, "ratio": value / end, "side": side}
                        found.append(Finding("outside_of_tests", about, {"parameter": name, **numbers}))
        return found


TEXT_KEYS = ("title", "units", "particle", "target")
PER_MASS_KEYS = ("density", "cutting_fraction")
"""What only erosion per mass of particles needs; see `CaseFile.per_mass`."""
MODEL_KEYS = ("model", "set")
"""The case's usual model and that model's own parameters; see `CaseFile.model`."""
SECTIONS = ("sweep", "stream", "map", "advise")
"""Tables that a case file may have for the verbs of these names; see `CaseFile.section`."""
_WORDS = ("title", "units", "warning", "tested", "equations")
"""Fields whose text is never a path."""
_WITH_A_PATH = (
    re.compile(r"(\s*+samples\s*+\(\s*+)(.+)(\)\s*)", re.DOTALL),  # a law
    re.compile(r"(\s*+)(.+\.toml)(\s*:.+)", re.DOTALL | re.IGNORECASE),  # a material of a table of one's own
    re.compile(r"(\s*+)(.+\.(?:py|nc|csv|toml))(\s*)", re.DOTALL),  # a model, draws, rows of particles, columns
)


class CaseError(ValueError):
    """A case file that cannot be used; the message names the file and the field."""


@dataclass(frozen=True)
class CaseFile:
    """A case file, read once.

    Args:
        path: the file.
        table: its fields, each path in them as this process finds it.
    """

    path: Path
    table: Mapping[str, Any]

    @classmethod
    def read(cls, path: str | Path) -> "CaseFile":
        """The file as it stands on the disk.

        Raises:
            CaseError: for a file that cannot be read, or is not in TOML.
        """
        path = check_path("path", path)
        return cls(path, with_paths(read_toml(path, CaseError), functools.partial(beside, path)))

    def parameters(self) -> Parameters:
        """The validated parameters, shown in the file's units; see `load_case`.

        Raises:
            CaseError: one sentence naming the file and the field.
        """
        with _in_file(self.path):
            return _parameters(self.table)

    @property
    def stated(self) -> list[str]:
        """The parameters that the file gives by their own names."""
        return [name for name in QUANTITIES if name in self.table]

    @property
    def names(self) -> dict[str, str]:
        """The names of the particle and the target, where the file has them."""
        return {name: self.table[name] for name in ("particle", "target") if isinstance(self.table.get(name), str)}

    def materials(self) -> tuple[Particle | None, Target | None]:
        """The particle and the target that the file names.

        Raises:
            CaseError: for a name that is unknown.
        """
        with _in_file(self.path):
            grit, metal = self.table.get("particle"), self.table.get("target")
            return None if grit is None else particle(grit), None if metal is None else target(metal)

    def per_mass(self, usual_fraction: float = 1.0) -> PerMass:
        """The file's data of erosion per mass, `cutting_fraction`, and `density` or that of `target`.

        Args:
            usual_fraction: the cutting fraction where the file gives none.

        Raises:
            CaseError: one sentence naming the file and the field.
        """
        with _in_file(self.path):
            density = None
            if "density" in self.table:
                with about("Field `density`"):
                    density = read_density(self.table["density"])
            if "target" in self.names:
                density = target(self.table["target"]).density_beside(density)
            fraction = self.table.get("cutting_fraction", usual_fraction)
            if isinstance(fraction, bool) or not isinstance(fraction, (int, float)):
                raise ValueError(f"Field `cutting_fraction` must be a number, but is {briefly(fraction)}.")
            return PerMass(density, float(fraction))

    def model(self) -> tuple[str | None, dict[str, Any]]:
        """The model that the file names for all verbs, a fitted one for example, and what it sets of its parameters.

        Raises:
            CaseError: for a model that is no name, and parameters without a model.
        """
        model, own = self.table.get("model"), self.table.get("set", {})
        refuse(
            f"{self.path}: field ",
            (not isinstance(model, str | None), f"`model` must be a name in quotes, but is {briefly(model)}."),
            (
                not isinstance(own, dict),
                f"`set` must be a table such as {{friction = 0.3}}, but is {briefly(own)}.",
            ),
            (own and model is None, "`set` needs the field `model`, whose parameters it sets."),
            kind=CaseError,
        )
        return model, own

    def title(self) -> str:
        """The name of the case, its `title`, else the file's name without its suffix.

        Raises:
            CaseError: for a title that is no text or holds control characters.
        """
        title = self.table.get("title", "")
        words = " ".join(str(title).split())
        # A terminal would obey control characters.
        refuse(
            f"{self.path}: field `title` must ",
            (not isinstance(title, str), f"be text in quotes, but is {briefly(title)}."),
            (
                has_control_characters(words),
                f"have no control characters, but is {briefly(title)}.",
            ),  # terminals obey them
            kind=CaseError,
        )
        return words or self.path.stem

    @property
    def doubt(self) -> Finding | None:
        """Findings of the fit that wrote the file, from its table [advise].

        Raises:
            CaseError: for a field `warning` that is no sentence.
        """
        warning = self.section("advise").get("warning")
        if warning is None:
            return None
        if not isinstance(warning, str) or not warning.strip() or has_control_characters(warning):
            raise CaseError(f"{self.path}: field `warning` of [advise] must be a sentence, but is {briefly(warning)}.")
        return stated(warning, str(self.path))

    @property
    def tested(self) -> Tested:
        """The tests of the fit that wrote the file; of no ranges where its table [advise] has none.

        Raises:
            CaseError: for a field `tested` that cannot be read.
        """
        try:
            return Tested.read(self.section("advise").get("tested", {}))
        except ValueError as error:
            raise CaseError(f"{self.path}: field `tested` of [advise] {error}.") from error

    def outside(self, p: Parameters, *, angle: bool = False) -> list[Finding]:
        """Findings on how far a case lies outside these tests.

        Args:
            p: the case.
            angle: whether its angle counts.

        Raises:
            CaseError: as of `tested`.
        """
        names = ("v0", "m", "alpha") if angle else ("v0", "m")
        return self.tested.outside({name: getattr(p, name) for name in names}, str(self.path))

    def section(self, name: str) -> dict[str, Any]:
        """The table `[name]`, empty where there is none.

        Raises:
            CaseError: where `name` is no table.
        """
        section = self.table.get(name, {})
        if not isinstance(section, dict):
            raise CaseError(f"{self.path}: `{name}` must be a table, but is {briefly(section)}.")
        return section


def load_case(path: str | Path) -> Parameters:
    """Read the parameters in a TOML case file.

    Args:
        path: the file; its keys are `units`, `title`, `particle`, `target` and the fields of `Parameters`, which
            overrule particle and target; for `density` and `cutting_fraction` see `CaseFile.per_mass`, for `model` and
            `set` `CaseFile.model`. Tables for other verbs (`SECTIONS`) may stand below them.

    Returns:
        Validated parameters, shown in the file's units (SI where it names none); a mass that fits no body of the size
        is a `SizeWarning`.

    Raises:
        CaseError: one sentence naming the file and the field, for a file that cannot be
            read, an unknown or missing key, a wrong dimension or a value out of range.
    """
    p = CaseFile.read(path).parameters()
    warn_of_size(p)
    return p


def parse_case(text: str) -> Parameters:
    """The parameters of the text of a case file, as `dump_case` writes it.

    Raises:
        ValueError: for another text.
    """
    return _parameters(tomllib.loads(text))


def with_paths(value: Any, move: Callable[[str], str], field: str = "") -> Any:
    """A value of a case file with another path in place of each that it has.

    Args:
        value: a text, or a table or list of texts.
        move: takes a path and gives the other one.
        field: the value's.
    """
    if isinstance(value, dict):
        return {name: item if name in _WORDS else with_paths(item, move, name) for name, item in value.items()}
    if isinstance(value, list):
        return [with_paths(item, move, field) for item in value]
    if not isinstance(value, str) or not value.strip():
        return value
    if field in ("rows", "data"):  # tables, whatever their suffix
        return move(value)
    if field == "model" and "," in value and not is_file(move(value)):
        return ",".join(with_paths(name, move, field) for name in value.split(",") if name.strip())
    for pattern in _WITH_A_PATH:
        if match := pattern.fullmatch(value):
            before, path, after = match.groups()
            return f"{before}{move(path)}{after}"
    return value


def dump_case(p: Parameters, title: str = "") -> str:
    """The TOML text of a case file that `load_case` reads back to the last bit.

    Args:
        p: parameters, all scalars.
        title: a line on what the case is.

    Raises:
        ValueError: for a parameter that is an array.
    """
    require_scalars(p)
    lines = [f"title = {toml_string(title)}"] if title else []
    lines.append(f'units = "{p.shown_in}"')
    for name, quantity in QUANTITIES.items():
        unit = unit_name(quantity.dimension, p.shown_in)
        comment = f"{quantity.meaning} [{unit}]" if unit else quantity.meaning
        number = _number(exact_text(float(getattr(p, name)), quantity.dimension, p.shown_in))
        lines.append(f"{name} = {number}  # {comment}")
    return "\n".join(lines) + "\n"


def _number(text: str) -> str:
    """A number of `exact_text`, in quotes where it has a unit."""
    return toml_string(text) if has_unit(text) else text


def dump_per_mass(per_mass: PerMass) -> str:
    """The lines of a case file that `CaseFile.per_mass` reads back."""
    density = "" if per_mass.density is None else f'density = "{per_mass.density:.15g} kg/m^3"  # of the target\n'
    # The share also where all particles cut: `advise` takes another one without it.
    return f"{density}cutting_fraction = {per_mass.cutting_fraction!r}  # share of the particles that cut\n"


def dump_model(source: str, own: Mapping[str, str]) -> str:
    """The lines of a case file that `CaseFile.model` reads back.

    Args:
        source: the model's name, or the path of its file as the case file gives it.
        own: the values of the model's own parameters, by name, as `exact_text` writes them for the case.
    """
    values = ", ".join(f"{toml_string(name) if '.' in name else name} = {_number(text)}" for name, text in own.items())
    return f"model = {toml_string(source)}\n" + (f"set = {{ {values} }}\n" if own else "")


def _parameters(table: Mapping[str, Any]) -> Parameters:
    """The parameters of a file's table; `Parameters.from_quantities` says what is wrong with a quantity."""
    for name in TEXT_KEYS:
        if not isinstance(table.get(name, ""), str):
            raise ValueError(f"Field `{name}` must be text in quotes, but is {briefly(table[name])}.")
    fields = (*TEXT_KEYS, *PER_MASS_KEYS, *MODEL_KEYS, *QUANTITIES)
    for name, value in table.items():
        if name not in fields and not (name in SECTIONS and isinstance(value, dict)):
            raise ValueError(f"Field `{name}` is unknown; the fields are {', '.join(fields)}.")
    quantities = {name: value for name, value in table.items() if name in QUANTITIES}
    for name, value in quantities.items() if "units" not in table else ():
        bare = not has_unit(value) if isinstance(value, str) else isinstance(value, (int, float))
        if bare and QUANTITIES[name].dimension not in ("1", "angle", "angular speed"):
            number = briefly(value).strip("'")
            raise ValueError(
                f"Field `{name}` is the bare number {number}, but the file names no `units`; "
                'write units = "inch-pound" or "si", or give the quantity a unit.'
            )
    system = check_system(table.get("units", "si"))
    grit, metal = (
        read(table[name]).parameters if name in table else {}
        for name, read in (("particle", particle), ("target", target))
    )
    return Parameters.from_quantities(system, quantities, grit | metal)


@contextlib.contextmanager
def _in_file(path: Path) -> Iterator[None]:
    """Errors of what a file says name the file; Python's arguments are fields there."""
    try:
        yield
    except ValueError as error:
        sentence = str(error).replace("Argument", "Field")
        raise CaseError(f"{path}: {sentence[0].lower()}{sentence[1:]}") from error


def toml_string(text: str) -> str:
    """A text in quotes, as TOML has it."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
