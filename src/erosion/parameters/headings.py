"""What the head of a column means, for all readers of tables: its name, its unit, and the quantity that both give.

    speed [m/s]    Impact Velocity (m s^-1)    "speed, m/s"    speed_mps    v₀ in m/s

A reader declares the quantities that it uses, each with the names that leave no doubt. A column of another name is
refused if it may be one of them: if its unit has one of their dimensions, or its name has one of their words. All other
columns are left out, and the reader says which. So no column that matters is passed over without a word.
"""

import contextlib
import math
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from erosion.output.tables import briefly
from erosion.parameters.quantities import DIMENSIONS, Dimension, Scale, System, UnitError, read_quantity

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
_LONGEST = 300  # characters of a head that a person writes
_NAMED = 6  # names of a quantity that a message lists


class Known(NamedTuple):
    """A quantity that a reader of tables uses.

    Args:
        dimensions: that its unit may have.
        names: other names that leave no doubt; capitals, spaces, hyphens and underscores do not matter.
        words: a pattern; a column with such a word in its name may be meant to be this quantity.
    """

    dimensions: Sequence[Dimension]
    names: Sequence[str] = ()
    words: str = ""


def of_parameters(dimensions: Mapping[str, Dimension]) -> dict[str, Known]:
    """Parameters of an impact, by their names, as quantities that a reader uses."""
    return {name: Known((dimension,), *_OF_PARAMETERS.get(name, ())) for name, dimension in dimensions.items()}


_OF_PARAMETERS: Mapping[str, tuple[Any, ...]] = {
    "v0": ((*SPEEDS, "v"), SPEED_WORDS),
    "alpha": (ANGLES, ANGLE_WORDS),
    "m": (("mass", *MASSES), MASS_WORDS),
    "phidot0": (("spin", "initial spin"), r"spin\w*|omega|rotation\w*"),
    "sigma": (("flow stress",), ""),
    "k": (("force ratio",), ""),
}


class Head(NamedTuple):
    """The head of a column that is used.

    Args:
        name: of the quantity.
        unit: as it is written; empty without one.
        alias: whether the column has another name than the quantity.
    """

    name: str
    unit: str
    alias: bool = False


class HeaderError(ValueError):
    """A header that cannot be used.

    Args:
        index: the column, from 0; None where one is missing.
        message: a clause that follows the column's place.
    """

    def __init__(self, index: int | None, message: str):
        super().__init__(message)
        self.index = index


class Heads(NamedTuple):
    """The heads of a table.

    Args:
        columns: for each of them what it means; None for a column that is left out.
        unused: those that are left out, but were not to be ignored.
    """

    columns: tuple[Head | None, ...]
    unused: tuple[str, ...]


def read_heads(
    heads: Sequence[str],
    known: Mapping[str, Known],
    *,
    ignore: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
    also: Sequence[Dimension] = (),
    leave_out: str = "name it in Argument `ignore`",
) -> Heads:
    """What the columns of a table mean.

    Args:
        heads: of the columns.
        known: the quantities that the reader uses, by name.
        ignore: columns that are left out, by their heads or the names in them.
        units: of heads that carry none, from elsewhere.
        also: dimensions of what differs from row to row, too, but cannot be read: a column of them is refused.
        leave_out: how a user leaves a column out, for messages.

    Raises:
        HeaderError: for two columns of one quantity, a column that may be one of those that are known but is not
            understood, and a name in `ignore` that no column has.
    """
    ignored, units, own = _ignored(heads, ignore), units or {}, dict[str, str]()
    columns = matching(heads, known, ignore=ignore, units=units)
    for index, (text, head) in enumerate(zip(heads, columns, strict=True)):
        if head is not None and head.name in own:
            doubt = f"gives `{head.name}`, but so does {own[head.name].strip()!r}"
        else:
            is_foreign = head is None and index not in ignored
            doubt = _doubt(text, units.get(text, ""), known, also) if is_foreign else ""
        if doubt:
            raise HeaderError(index, f"{doubt}; rename it, or {leave_out}")
        if head is not None:
            own[head.name] = text
    unused = [text.strip() for i, text in enumerate(heads) if columns[i] is None and i not in ignored]
    return Heads(tuple(columns), tuple(unused))


_WEIGHTS = {
    "weight": Known(
        ("rate", "mass flow", "mass flux"),
        words=rf"{WEIGHT_WORDS}|{RATE_WORDS}|nparticles?|mult|pdf|percent|probab\w*|fractions?|shares?|h\w*figkeit",
    )
}


def weight_among(heads: Sequence[str], known: Mapping[str, Known]) -> str | None:
    """The first column that may say how often its row counts, and is none of those that are known."""
    columns = matching(heads, known)
    foreign = (text for text, head in zip(heads, columns, strict=True) if head is None)
    return next((text.strip() for text in foreign if _doubt(text, "", _WEIGHTS, ())), None)


def unused_note(unused: Sequence[str]) -> str:
    """Which columns are left out, as a clause that follows the table's name."""
    return f"columns that are not used: {', '.join(map(briefly, unused))}"


def matching(
    heads: Sequence[str],
    known: Mapping[str, Known],
    *,
    ignore: Sequence[str] = (),
    units: Mapping[str, str] | None = None,
) -> list[Head | None]:
    """What the columns mean among quantities that are looked for; None for all others. Arguments as of `read_heads`."""
    ignored, units = _ignored(heads, ignore), units or {}
    # The quantity by all names that leave no doubt.
    names = {_key(spelled): own for own, entry in known.items() for spelled in (*entry.names, own)}
    names |= {name: name for name in known}
    return [
        None if index in ignored else _understood(text, names, units.get(text, "")) for index, text in enumerate(heads)
    ]


def factor(unit: str, dimension: Dimension, units: System) -> float:
    """What numbers of a column are multiplied by; its unit may have a number of its own, "1e-4 in^3".

    Raises:
        UnitError: as of `read_quantity`, and for a number of its own that is zero or not finite.
    """
    size = read_quantity(unit if _NUMBER.match(unit) else f"1 {unit}", dimension, units)
    if not 0 < size < math.inf:
        raise UnitError(f"must be of a positive, finite size, but is {briefly(unit)}")
    return size


def scale_of(unit: str, dimension: Dimension, units: System) -> Scale:
    """A unit that is written in ASCII or not, for tables and figures; errors as of `factor`."""
    return Scale(factor(unit, dimension, units), unit.replace("^2", "²").replace("^3", "³"))


def head_parts(text: str) -> tuple[str, str]:
    """Name and unit of a column: "Mass loss [mg/g]" is ("Mass loss", "mg/g"); empty where there is none."""
    text = text.strip()
    if len(text) > _LONGEST:
        return "", ""
    name, unit = text, ""
    if text.endswith(("]", ")")):
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
    unit = re.sub(r"(?<!\d[eE])(?<=[^\W\d_])[-−]([1-3])\b", r"^-\1", re.sub(r"^1\s*/\s*", "1/", unit))
    return re.sub(r"(?<=[^\W\d_])\.(?=[^\W\d_])", " ", unit)


def _understood(text: str, names: Mapping[str, str], default: str = "") -> Head | None:
    """The quantity of a head; None where its name leaves a doubt. `default` is its unit from elsewhere."""
    name, unit = head_parts(text)
    if (own := names.get(name, names.get(_key(name)))) is not None:
        return Head(own, unit or default, alias=own != name and _key(own) != _key(name))
    # "speed_mps": a unit ends the name.
    for start, ending in () if unit else _ended(name):
        if (own := names.get(_key(start))) is not None:
            return Head(own, ending, alias=_key(own) != _key(start))
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


def _ignored(heads: Sequence[str], ignore: Sequence[str]) -> set[int]:
    """The columns that are not to be used."""
    ignored: set[int] = set()
    for text in (ignore,) if isinstance(ignore, str) else ignore:
        named = {i for i, head in enumerate(heads) if text.strip() == head.strip()}
        named = named or {i for i, head in enumerate(heads) if _key(head_parts(head)[0]) == _key(head_parts(text)[0])}
        if not named:
            there = briefly(", ".join(head.strip() for head in heads))
            message = f"has no column {briefly(text)}, which Argument `ignore` names; its columns are {there}"
            raise HeaderError(None, message)
        ignored |= named
    return ignored


def _doubt(text: str, unit: str, known: Mapping[str, Known], also: Collection[Dimension]) -> str:
    """Why a column that is not understood may be one of those that are known; empty where it is none."""
    name, own_unit = head_parts(text)
    if not (own_unit or unit) and (start := re.sub(r"[\s_]+m$", "", name)) != name:
        name, own_unit = start, "m"  # "depth_m" is in metres, no mass
    unit = own_unit or unit or (name if "/" in name else "")  # a unit alone, "kg/s"
    used: list[Dimension] = [dimension for entry in known.values() for dimension in entry.dimensions]
    dimension = None if unit in NO_UNIT else _dimension(unit, dict.fromkeys((*used, *also, *DIMENSIONS)))
    if dimension == "mass per mass" and "/" not in unit:  # a percentage may be of anything
        dimension = None
    if _PLACES.fullmatch(_key(name)) and dimension in (None, "length"):
        return ""
    if dimension is not None and dimension in also:
        return f"has the unit of {_article(dimension)}, which is not read from row to row"
    if dimension is not None and dimension in used and dimension not in _HARMLESS_DIMENSIONS:
        meant = [own for own, entry in known.items() if dimension in entry.dimensions]
        return (
            f"has the unit of {_article(dimension)}, but a name that is not understood; names that are: "
            f"{_listed(meant, known)}"
        )
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", unicodedata.normalize("NFKC", name)).lower()
    words = {*re.findall(r"[^\W\d_]+", apart)} if dimension is None else set[str]()
    meant = [own for own, entry in known.items() if any(re.fullmatch(entry.words, word) for word in words)]
    return "" if not meant or words & _HARMLESS else f"is not understood; names that are: {_listed(meant, known)}"


def _dimension(unit: str, dimensions: Iterable[Dimension]) -> Dimension | None:
    """The first of the dimensions that a unit has; None where it has none of them, or is none."""
    for dimension in dimensions:
        if dimension != "1":
            with contextlib.suppress(UnitError):
                factor(unit, dimension, "si")
                return dimension
    return None


def _listed(names: Sequence[str], known: Mapping[str, Known]) -> str:
    """Some names that leave no doubt, first those of the quantities."""
    spelled = [*names, *(alias for name in names for alias in known[name].names if _key(alias) not in map(_key, names))]
    return ", ".join(f"`{name}`" for name in spelled[: max(_NAMED, len(names))])


def _article(dimension: Dimension) -> str:
    return f"{'an' if dimension[0] == 'a' else 'a'} {dimension}"
