"""Headings of columns for all readers of tables: name, unit, and the quantity of both.

    speed [m/s]    Impact Velocity (m s^-1)    "speed, m/s"    speed_mps    v₀ in m/s

A reader declares the quantities that it uses, each with the names that leave no doubt. A column of another name is
refused if it may be one of them: if its unit has one of their dimensions, or its name has one of their words. All other
columns are left out, and the reader says which. So no column that matters is passed over without a word.
"""

import contextlib
import dataclasses
import itertools
import math
import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from erosion.output import briefly
from erosion.parameters.quantities import (
    DIMENSIONS,
    Dimension,
    Scale,
    UnitError,
    ascii_unit,
    read_quantity,
    read_removal,
    unit_name,
)

SPEEDS = (
    "v0", "speed", "velocity", "vel", "impact speed", "impact velocity", "speed of impact", "velocity of impact",
    "particle speed", "particle velocity", "particle impact speed", "particle impact velocity", "impingement speed",
    "impingement velocity", "v impact", "v imp", "speed magnitude", "velocity magnitude", "velocity mag", "v mag",
    "u mag", "mag u", "u magnitude", "velocity:magnitude", "u:magnitude",
)  # fmt: skip
ANGLES = (
    "alpha", "angle", "impact angle", "angle of impact", "attack angle", "angle of attack", "impingement angle",
    "angle of impingement", "particle impact angle",
)  # fmt: skip
MASSES = ("particle mass", "mass of particle", "mass of a particle", "mass per particle")
"""Names that leave no doubt, in every table."""

SPEED_WORDS = r"[uvw]|v[npt]|[uv](imp|rel|mag|abs|tot|par)\w*|veloc\w*|vel|speeds?|geschw\w*"
ANGLE_WORDS = r"angles?|alpha|theta|inciden\w*|impinge\w*|attack|winkel"
MASS_WORDS = r"m|mass|masses|masse|weigh\w*|gewicht"
SIZE_WORDS = r"d|dp|diam\w*|sizes?|radius|durchmesser|korn\w*"
WEIGHT_WORDS = (
    r"n|np\w*|num|nr|numbers?|counts?|particles?|parcels?|weigh\w*|wt|factor|scale|multiplicity|hits|impacts|"
    r"gewicht\w*|anzahl"
)
RATE_WORDS = r"rates?|flow\w*|flux|mflow\w*|freq\w*|mdot|strength|massenstrom"
"""Words of names that may be meant, as patterns."""

NO_UNIT = ("", "-", "–", "1")

# A column with such a word in its name is none of a quantity that a reader uses, unless its unit says so.
_HARMLESS = {
    "id", "ids", "index", "idx", "name", "names", "label", "labels", "note", "notes", "comment", "comments", "remark",
    "remarks", "type", "date", "day", "temperature", "temp", "pressure", "material", "operator", "run", "reynolds",
}  # fmt: skip
_PLACES = re.compile(r"(position|pos|points|coordinates?)?:?[xyz012](position|coordinate)?")
_HARMLESS_DIMENSIONS: Sequence[Dimension] = ("time", "stress")  # ages, pressures

# Units that may end a name without brackets, "angle_deg", "speed m/s"; of those in a column's name that pint reads in
# another way, how it reads them. What may be read in two ways is missing: "speed_ms", "d_min".
_ENDINGS: Mapping[str, str] = {
    **{unit: unit for unit in (
        "deg", "degree", "degrees", "°", "rad", "um", "µm", "μm", "micron", "microns", "mm", "cm", "m", "kg", "g", "mg",
        "ug", "µg", "μg", "ng", "m/s", "mps", "ft/s", "fps", "in/s", "km/h", "mph", "kg/s", "g/s", "kg/m3", "kg/m^3",
        "g/cm3", "g/cm^3", "rad/s", "rpm", "1/s", "Hz", "s", "mm3", "mm^3", "mm³", "m3", "m^3", "in3", "in^3",
        "mm3/kg", "mm^3/kg", "mm³/kg", "mm3/g", "mm^3/g", "mm³/g", "mg/kg", "mg/g", "g/kg", "kg/kg",
    )},
    "m_s": "m/s", "m_per_s": "m/s", "kg_s": "kg/s", "kg_per_s": "kg/s", "kg_m3": "kg/m^3", "kg_per_m3": "kg/m^3",
    "per_s": "1/s", "mm3_kg": "mm^3/kg", "mg_kg": "mg/kg", "mg_g": "mg/g", "g_kg": "g/kg",
}  # fmt: skip
_NUMBER = re.compile(r"\d[\d.]*(e[+-]?\d+)?\s*[^\W\d_]", re.IGNORECASE)  # "1e-4 in^3", not "1/s"
_POWER_OF_TEN = re.compile(r"10(?:\^|(?=[⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹]))([+\-−⁺⁻]?[\d⁰¹²³⁴⁵⁶⁷⁸⁹]+)\s*[·×*]?\s*")
_LONGEST = 300  # characters of a head that a person writes
_NAMED = 6  # names of a quantity that a message lists


@dataclasses.dataclass(frozen=True)
class Wanted:
    """A quantity that a reader of tables uses.

    Args:
        dimensions: that its unit may have.
        names: other names that leave no doubt; capitals, spaces, hyphens and underscores do not matter.
        words: a pattern; a column with such a word in its name may be meant to be this quantity.
    """

    dimensions: Sequence[Dimension]
    names: Sequence[str] = ()
    words: str = ""

    def measure(self, unit: str, *, is_alias: bool) -> tuple[Dimension, float] | None:
        """Dimension and size in SI of a unit; None where a unit is needed.

        Args:
            unit: as it is written; empty without one.
            is_alias: whether the column has another name than the quantity.

        Raises:
            UnitError: with a clause that starts with "must", for a unit of another dimension.
        """
        if unit in NO_UNIT:
            bare: Sequence[Dimension] = ("1", "mass per mass") if unit else ("1",)
            return next(((dimension, 1.0) for dimension in bare if dimension in self.dimensions), None)
        if tuple(self.dimensions) == ("1",):
            raise UnitError(f"must be none, as of a pure number, but is {briefly(unit)}")
        for dimension in self.dimensions:
            with contextlib.suppress(UnitError):
                return dimension, self.factor(unit, dimension)
        listed = " or ".join(", ".join(self.dimensions).rsplit(", ", 1))
        raise UnitError(f"must be that of {_article(listed)}, but is {briefly(unit)}")

    def factor(self, unit: str, dimension: Dimension) -> float:
        """See the function of this name."""
        return factor(unit, dimension)

    @property
    def example(self) -> str:
        """A unit that it may have."""
        usual = {"angle": "deg", "volume": "mm^3"}
        return usual.get(self.dimensions[0], ascii_unit(unit_name(self.dimensions[0], "si")))


def of_parameters(dimensions: Mapping[str, Dimension]) -> dict[str, Wanted]:
    """Parameters of an impact, by their names, as quantities that a reader uses."""
    return {name: Wanted((dimension,), *_OF_PARAMETERS.get(name, ())) for name, dimension in dimensions.items()}


_OF_PARAMETERS: Mapping[str, tuple[Any, ...]] = {
    "v0": ((*SPEEDS, "v"), SPEED_WORDS),
    "alpha": (ANGLES, ANGLE_WORDS),
    "m": (("mass", *MASSES), MASS_WORDS),
    "phidot0": (("spin", "initial spin"), r"spin\w*|omega|rotation\w*"),
    "sigma": (("flow stress",), ""),
    "k": (("force ratio",), ""),
}


class Heading(NamedTuple):
    """The head of a column that is used.

    Args:
        name: of the quantity.
        unit: as it is written; empty without one.
        alias: whether the column has another name than the quantity.
    """

    name: str
    unit: str
    alias: bool = False


def doubtful(
    headings: Sequence[str],
    found: Sequence[Heading | None],
    wanted: Mapping[str, Wanted],
    refused: Mapping[str, Wanted],
    *,
    ignored: Collection[int] = (),
    units: Mapping[str, str] | None = None,
) -> tuple[int, str] | None:
    """The first column that may be of a quantity, but is not understood, and a clause on it.

    Args:
        headings: of the columns.
        found: what they mean, see `matching`.
        wanted: the quantities that the reader uses, by name.
        refused: quantities that no column may have.
        ignored: the columns that are left out, by their places.
        units: by heading, from elsewhere.
    """
    units = units or {}
    for index, (text, heading) in enumerate(zip(headings, found, strict=True)):
        if heading is None and index not in ignored and (said := _doubt(text, units.get(text, ""), wanted, refused)):
            return index, said
    return None


def of_weights() -> dict[str, Wanted]:
    """The name of the weight, where all rows count alike."""
    words = rf"{WEIGHT_WORDS}|{RATE_WORDS}|nparticles?|mult|pdf|percent|probab\w*|fractions?|shares?|h\w*figkeit"
    return {"weight": Wanted(("rate", "mass flow", "mass flux"), words=words)}


def unused_note(unused: Sequence[str]) -> str:
    """Which columns are left out, as a clause that follows the table's name."""
    return f"columns that are not used: {', '.join(map(briefly, unused))}"


def matching(
    headings: Sequence[str],
    wanted: Mapping[str, Wanted],
    *,
    ignored: Collection[int] = (),
    units: Mapping[str, str] | None = None,
) -> list[Heading | None]:
    """The quantities of the columns; None for a column of another quantity.

    Args:
        headings: of the columns.
        wanted: the quantities that the reader uses, by name.
        ignored: the columns that are left out, by their places.
        units: of headings that carry none, from elsewhere.
    """
    units = units or {}
    # The quantity by all names that leave no doubt.
    names = {_key(spelled): own for own, entry in wanted.items() for spelled in (*entry.names, own)}
    names |= {name: name for name in wanted}
    return [
        None if index in ignored else _understood(text, names, units.get(text, ""))
        for index, text in enumerate(headings)
    ]


def factor(unit: str, dimension: Dimension, read: Callable[[str, Dimension], float] = read_quantity) -> float:
    """The factor of a column's numbers to SI; its unit may have a number of its own, "1e-4 in^3".

    Args:
        unit: as it is written.
        dimension: of the numbers.
        read: `read_removal` for an erosion, which may be per impact.

    Raises:
        UnitError: as of `read_quantity`, and for a number of its own that is zero or not finite.
    """
    size = read(unit if _NUMBER.match(unit) else f"1 {unit}", dimension)
    if not 0 < size < math.inf:
        raise UnitError(f"must be of a positive, finite size, but is {briefly(unit)}")
    return size


def scale_of(unit: str, dimension: Dimension) -> Scale:
    """A unit of erosion that is written in ASCII or not, for tables and figures; errors as of `factor`."""
    return Scale(factor(unit, dimension, read_removal), unit.replace("^2", "²").replace("^3", "³"))


def heading_parts(text: str) -> tuple[str, str]:
    """Name and unit of a column: "Mass loss [mg/g]" is ("Mass loss", "mg/g"); empty where there is none."""
    text = text.strip()
    if len(text) > _LONGEST:
        return "", ""
    name, unit = text, ""
    if " / " in text and not text.endswith("]"):  # as ISO 80000 writes it
        name, _, unit = text.partition(" / ")
        unit = unit.strip().removeprefix("(").removesuffix(")") if unit.startswith("(") else unit
    elif text.endswith(("]", ")")):
        name, unit = _brackets(text)
    elif "," in text:
        name, _, unit = text.rpartition(",")
    return name.strip().removesuffix("/").strip(), _spelled(unit.strip())


def _brackets(text: str) -> tuple[str, str]:
    """A text before its last pair of brackets, and in it."""
    depth = 0
    for i in range(len(text) - 1, -1, -1):
        depth += (text[i] in ")]") - (text[i] in "([")
        if depth == 0:
            return text[:i], text[i + 1 : -1]
    return text, ""


def _spelled(unit: str) -> str:
    """A unit as pint reads it: "m s-1" is "m s^-1", "m.s-1" too, but "1e-3 m" has a number; "1 / s" is "1/s"."""
    if power := _POWER_OF_TEN.match(unit):
        unit = f"1e{unicodedata.normalize('NFKC', power[1]).replace('−', '-')} {unit[power.end() :]}"
    unit = re.sub(r"(?<!\d[eE])(?<=[^\W\d_])[-−]([1-3])\b", r"^-\1", re.sub(r"^1\s*/\s*", "1/", unit))
    return re.sub(r"(?<=[^\W\d_])\.(?=[^\W\d_])", " ", unit)


class IgnoreError(ValueError):
    """A column that is to be left out, but is not there."""


def unit_row(headings: Sequence[str], cells: Sequence[str]) -> tuple[str, ...]:
    """The units of the columns, of the row below their headings; empty where this row has something else."""
    texts = [_spelled(cell.strip().strip("[]()").strip()) for cell in cells]
    are_units = [*map(is_unit, texts)]
    if len(texts) != len(headings) or not any(are_units):
        return ()
    are_good = (is_unit or text in ("", "-", "–") for is_unit, text in zip(are_units, texts, strict=True))
    return tuple(texts) if all(are_good) else ()


def is_unit(text: str) -> bool:
    """Whether a text is a unit of some quantity."""
    return text not in NO_UNIT and _dimension(text, DIMENSIONS) is not None


def _understood(text: str, names: Mapping[str, str], default: str = "") -> Heading | None:
    """The quantity of a head; None where its name leaves a doubt. `default` is its unit from elsewhere."""
    name, unit = heading_parts(text)
    if (own := names.get(name, names.get(_key(name)))) is not None:
        return Heading(own, unit or default, alias=own != name and _key(own) != _key(name))
    # "speed_mps": a unit ends the name.
    for start, ending in () if unit else _ended(name):
        if (own := names.get(_key(start))) is not None:
            return Heading(own, ending, alias=_key(own) != _key(start))
    return None


def _ended(name: str) -> Iterator[tuple[str, str]]:
    """Ways to take a name and the unit at its end apart."""
    for ending, unit in _ENDINGS.items():
        rest = name.removesuffix(ending)
        start = re.sub(r"[\s_]+in$", "", rest.rstrip(" _/"))
        # "d_m" may be a mean diameter, "v_g" the velocity of a gas; "x_m" is a place.
        is_long = len(start) > 1 or len(ending) > 1 or (start.lower() in ("x", "y", "z") and ending == "m")
        if rest not in (name, rest.rstrip(" _")) and is_long:
            yield start, unit


def _key(name: str) -> str:
    """A name without what does not matter: capitals, spaces, hyphens, underscores, subscripts."""
    plain = unicodedata.normalize("NFKC", name).lower().replace("α", "alpha").replace("ρ", "rho")
    return re.sub(r"[\s_.,|–-]", "", plain)


def ignored_columns(headings: Sequence[str], ignore: Sequence[str]) -> set[int]:
    """The places of the columns that are left out.

    Args:
        headings: of all columns.
        ignore: headings, or the names in them.

    Raises:
        IgnoreError: for a name that no column has.
    """
    ignored: set[int] = set()
    for text in ignore:
        named = columns_of(headings, text)
        if not named:
            there = briefly(", ".join(heading.strip() for heading in headings))
            raise IgnoreError(f"has no column {briefly(text)}, which Argument `ignore` names; its columns are {there}")
        ignored.update(named)
    return ignored


def columns_of(headings: Sequence[str], text: str) -> list[int]:
    """The places of the columns with a heading, or else with this name in theirs; "U" is all of "U:0", "U:1", "U:2"."""
    exact = [i for i, heading in enumerate(headings) if heading.strip() == text.strip()]
    name, plain = _key(heading_parts(text)[0]), [re.sub(r":\d$", "", heading.strip()) for heading in headings]
    return exact or [i for i, heading in enumerate(plain) if _key(heading_parts(heading)[0]) == name]


def _doubt(text: str, unit: str, wanted: Mapping[str, Wanted], refused: Mapping[str, Wanted]) -> str:
    """Why a column that is not understood may be of a quantity; empty where it is of none."""
    name, own_unit = heading_parts(text)
    if not (own_unit or unit) and (start := re.sub(r"[\s_]+m$", "", name)) != name:
        name, own_unit = start, "m"  # "depth_m" is in metres, no mass
    unit = own_unit or unit or (name if "/" in name else "")  # a unit alone, "kg/s"
    used, foreign = (
        [dimension for entry in entries.values() for dimension in entry.dimensions] for entries in (wanted, refused)
    )
    dimension = None if unit in NO_UNIT else _dimension(unit, itertools.chain(used, foreign, DIMENSIONS))
    if dimension == "mass per mass" and "/" not in unit:  # a percentage may be of anything
        dimension = None
    if _PLACES.fullmatch(_key(name)) and dimension in (None, "length"):
        return ""
    if dimension is not None and dimension in foreign:
        return f"has the unit of {_article(dimension)}, which is not read from row to row"
    if dimension is not None and dimension in used and dimension not in _HARMLESS_DIMENSIONS:
        meant = [own for own, entry in wanted.items() if dimension in entry.dimensions]
        return (
            f"has the unit of {_article(dimension)}, but a name that is not understood; names that are: "
            f"{_listed(meant, wanted)}"
        )
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", unicodedata.normalize("NFKC", name)).lower()
    words = {*re.findall(r"[^\W\d_]+", apart)} if dimension is None else set[str]()
    if words & _HARMLESS:
        return ""
    if meant := _meant(words, wanted):
        return f"is not understood; names that are: {_listed(meant, wanted)}"
    return "".join(f"may be {_article(own)}, which no row may have" for own in _meant(words, refused)[:1])


def _meant(words: Collection[str], entries: Mapping[str, Wanted]) -> list[str]:
    """The quantities that words of a heading may mean."""
    return [own for own, entry in entries.items() if any(re.fullmatch(entry.words, word) for word in words)]


def _dimension(unit: str, dimensions: Iterable[Any]) -> Dimension | None:
    """The first of the dimensions that a unit has; None where it has none of them, or is none."""
    for dimension in dimensions:
        if dimension != "1":
            with contextlib.suppress(UnitError):
                factor(unit, dimension, read_removal)
                return dimension
    return None


def _listed(names: Sequence[str], known: Mapping[str, Wanted]) -> str:
    """Some names that leave no doubt, first those of the quantities."""
    spelled = [*names, *(alias for name in names for alias in known[name].names if _key(alias) not in map(_key, names))]
    return ", ".join(f"`{name}`" for name in spelled[: max(_NAMED, len(names))])


def _article(noun: str) -> str:
    return f"{'an' if noun[0] == 'a' else 'a'} {noun}"
