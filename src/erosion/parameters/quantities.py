"""Numbers with units: the two unit systems, the units in which numbers read well, and the name of every number.

Numbers inside the package are plain floats in SI; a `Parameters` carries the name of the system in which results are
shown. Other units appear at the edges: case files, the command line, tables and axis labels. This is the only place
where pint is used. The module loads without JAX, so that the command line can make its options from it.

"1deg : 90deg : 90"           90 values, evenly from 1° to 90°
"100 m/s : 1000 m/s : 5 : log"  5 values at even ratios
"20deg, 30deg, 45deg"         these values
"""

import contextlib
import functools
import math
import re
import tokenize
import types
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from erosion.output.tables import briefly
from erosion.results import Scale as Scale, System as System, Value, in_unit

Named = Literal[
    "1", "length", "area", "volume", "mass", "time", "speed", "stress", "angle", "angular speed",
    "rate", "volume per angle", "volume per angle²", "density", "volume per mass", "mass per mass",
    "mass flux", "mass flow", "energy",
]  # fmt: skip


class Product(str):
    """A dimension that is made of others, "mass/time"; see `read_dimension`."""


Dimension = Named | Product
DIMENSIONS: tuple[Named, ...] = get_args(Named)


def read_dimension(text: str) -> Dimension:
    """A dimension by name, or as a product of names and powers: "mass/time", "M/T", "[length]^2 / [time]".

    Raises:
        ValueError: with a clause that starts with "must".
    """
    plain = text.translate(_PLAIN_POWERS).replace("**", "^")
    plain = re.sub(r"\s*([*/^])\s*", r"\1", plain.strip())
    plain = re.sub(r"\b[MLT]\b", lambda letter: _LETTERS[letter[0]], plain)
    if plain in _BY_NAME:
        return _BY_NAME[plain]
    if not all(_FACTOR.fullmatch(factor) for factor in re.split("[*/]", plain)):
        raise ValueError(
            f"must be one of {', '.join(DIMENSIONS)}, or made of them, such as 'mass/time', but is {briefly(text)}"
        )
    return Product(plain)


_PLAIN_POWERS = str.maketrans({"²": "^2", "³": "^3", "·": "*", "[": None, "]": None})
_BY_NAME: Mapping[str, Named] = {name: name for name in DIMENSIONS}
_LETTERS = types.MappingProxyType({"M": "mass", "L": "length", "T": "time"})
_FACTOR = re.compile(
    rf"(?P<name>{'|'.join(sorted(map(re.escape, DIMENSIONS), key=len, reverse=True))})(?:\^(?P<power>[23]))?"
)


def factors(dimension: Product) -> Iterator[tuple[str, Named, int]]:
    """The parts of a product: "", "*" or "/", a dimension by name, and its power."""
    for factor in re.finditer(rf"(?P<sign>^|[*/]){_FACTOR.pattern}", dimension):
        yield factor["sign"], _BY_NAME[factor["name"]], int(factor["power"] or 1)


if TYPE_CHECKING:
    import pint

SYSTEMS: tuple[System, ...] = get_args(System)

# pint's name of each dimension's unit. The inch-pound-second system is consistent only with
# mass in slinch ("dozens of slugs", lbf s²/in), 1 slinch = 175.126835246 kg.
_PINT_UNITS: Mapping[System, Mapping[Named, str]] = types.MappingProxyType(
    {
        "inch-pound": {
            "1": "", "length": "inch", "area": "inch**2", "volume": "inch**3", "mass": "slinch",
            "time": "s", "speed": "inch/s", "stress": "lbf/inch**2", "angle": "rad",
            "angular speed": "rad/s", "rate": "1/s", "volume per angle": "inch**3/rad",
            "volume per angle²": "inch**3/rad**2", "density": "slinch/inch**3",
            "volume per mass": "inch**3/slinch", "mass per mass": "slinch/slinch",
            "mass flux": "slinch/inch**2/s", "mass flow": "slinch/s", "energy": "inch*lbf",
        },
        "si": {
            "1": "", "length": "m", "area": "m**2", "volume": "m**3", "mass": "kg",
            "time": "s", "speed": "m/s", "stress": "Pa", "angle": "rad",
            "angular speed": "rad/s", "rate": "1/s", "volume per angle": "m**3/rad",
            "volume per angle²": "m**3/rad**2", "density": "kg/m**3",
            "volume per mass": "m**3/kg", "mass per mass": "kg/kg",
            "mass flux": "kg/m**2/s", "mass flow": "kg/s", "energy": "J",
        },
    }
)  # fmt: skip

# By definition, exactly; a test compares with pint, which would take half a second to ask.
_INCH, _POUND_FORCE = 0.0254, 4.4482216152605  # m, N
_SLINCH = _POUND_FORCE / _INCH  # kg
_INCH_POUND_IN_SI: Mapping[Named, float] = types.MappingProxyType(
    {
        "length": _INCH, "area": _INCH**2, "volume": _INCH**3, "mass": _SLINCH, "speed": _INCH,
        "stress": _POUND_FORCE / _INCH**2, "volume per angle": _INCH**3, "volume per angle²": _INCH**3,
        "density": _SLINCH / _INCH**3, "volume per mass": _INCH**3 / _SLINCH,
        "mass flux": _SLINCH / _INCH**2, "mass flow": _SLINCH, "energy": _INCH * _POUND_FORCE,
    }
)  # fmt: skip

_SUPERSCRIPTS = {"**2": "²", "**3": "³", "*": "·"}


@contextlib.contextmanager
def about(what: str, kind: type[ValueError] = ValueError) -> Iterator[None]:
    """What a reader says of a text, "must be …", becomes an error of that kind, a sentence about `what`."""
    try:
        yield
    except ValueError as error:
        raise kind(f"{what} {error}.") from error


class UnitError(ValueError):
    """A quantity that cannot be read, or of the wrong dimension."""


def check_system(units: str, argument: str = "units") -> System:
    """The unit system that an argument names, in small or capital letters ("SI"), else raise `ValueError`."""
    for system in SYSTEMS:
        if isinstance(units, str) and units.lower() == system:
            return system
    raise ValueError(f"Argument `{argument}` must be one of {', '.join(map(repr, SYSTEMS))}, but is {briefly(units)}.")


def _pint_unit(dimension: Dimension, system: System) -> str:
    if not isinstance(dimension, Product):
        return _PINT_UNITS[system][dimension]
    text = ""
    for sign, name, power in factors(dimension):
        unit = _PINT_UNITS[system][name] or "1"
        is_compound = re.search("[*/]", unit) and (sign or power != 1)
        text += sign + (f"({unit})" if is_compound else unit) + (f"**{power}" if power != 1 else "")
    return text


def unit_name(dimension: Dimension, system: System) -> str:
    """The unit as a person writes it: "in³", "slinch", "" for a pure number."""
    name = re.sub(r"\binch\b", "in", _pint_unit(dimension, system))
    for ascii_power, superscript in _SUPERSCRIPTS.items():
        name = name.replace(ascii_power, superscript)
    return name


def ascii_unit(name: str) -> str:
    """A unit's name as programs read it (UDUNITS, pint): "in^3", "slinch", "1" for a pure number."""
    return name.replace("²", "^2").replace("³", "^3").replace("·", "*") or "1"


def derivative_unit(of: Dimension, by: Sequence[Dimension], system: System) -> str:
    """The unit of a derivative, of first or higher order: "in³/rad", "in³/(in/s)²"."""
    powers = Counter(unit for dimension in by if (unit := unit_name(dimension, system)))
    below = [(f"({unit})" if "/" in unit or unit[-1] in "²³" else unit, power) for unit, power in powers.items()]
    return "/".join([unit_name(of, system), *(unit + {1: "", 2: "²"}[power] for unit, power in below)])


@functools.cache
def unit_size(dimension: Dimension, system: System) -> float:
    """The size of a system's unit in SI: 0.0254 of the inch."""
    if system == "si":
        return 1.0
    if not isinstance(dimension, Product):
        return _INCH_POUND_IN_SI.get(dimension, 1.0)
    sizes = [(sign, unit_size(name, system) ** power) for sign, name, power in factors(dimension)]
    return math.prod(1 / size if sign == "/" else size for sign, size in sizes)


def has_unit(text: str) -> bool:
    """Whether a quantity as text carries a unit."""
    return bool(unit_of(text))


def unit_of(text: str) -> str:
    """The unit of a quantity as text; empty where it has none."""
    parts = _parts(text)
    return "" if parts is None else parts["unit"].strip()


def example(dimension: Dimension, system: System) -> str:
    """A quantity of this dimension as text, in quotes where it has a unit."""
    if isinstance(dimension, Product):
        return f'"2 {ascii_unit(unit_name(dimension, system))}"'
    return _EXAMPLES[system].get(dimension, "2")


def read_quantity(text: str, dimension: Dimension, bare: System | None = "si") -> float:
    """Read "4400 in/s" as a float in SI.

    Args:
        text: the quantity.
        dimension: that it must have.
        bare: the unit system of a bare number (angles: radians), and of the example in messages. None: a bare number is
            refused, but for pure numbers.

    Raises:
        UnitError: with a clause that starts with "must", to follow the field's name.
    """
    import pint

    registry: Any = _registry()
    unit = _pint_unit(dimension, "si")
    article = "an" if dimension[0] == "a" else "a"
    expected = f"{article} {dimension if unit else 'pure number'} such as {example(dimension, bare or 'si')}"
    # Number and unit are taken apart here: pint reads "44 00 in" as a product.
    parts = _parts(text)
    if parts is None:
        raise UnitError(f"must be {expected}, but {_unreadable(text)}")
    number, given = float(parts["number"]), _POWERLESS.sub(r"\1^\2", parts["unit"].strip())
    given = _MIL.sub("thou", given)
    if not given:
        return number * _bare_size(dimension, bare, text)
    # pint passes over what it does not know, such as the sign that stands for a µ which was lost.
    if _NO_UNIT.search(given):
        raise UnitError(f"must be {expected}, but {_unreadable(text)}")
    try:
        _check_powers(pint.util.string_preprocessor(given))
        units = registry.parse_units(given)
        if units.dimensionality == registry.parse_units(unit or "dimensionless").dimensionality:
            _check_angles(dict(units._units), dimension, f"must be {expected}, but is {briefly(text)}")
        for system in SYSTEMS:  # as a bare number there, to the last bit
            if units == registry.parse_units(_pint_unit(dimension, system) or "dimensionless"):
                return number * unit_size(dimension, system)
        return float(registry.Quantity(number, units).to(unit or "dimensionless").magnitude)
    except pint.errors.DimensionalityError as error:
        dimensions = str(registry.parse_units(given).dimensionality).replace(" ** ", "^")
        dimensions = "1 (a pure number)" if dimensions == "dimensionless" else dimensions
        raise UnitError(f"must be {expected}, but is {briefly(text)}, of dimension {dimensions}") from error
    except UnitError:
        raise
    # pint lets errors of its tokenizer and of Python's arithmetic through as they are.
    except (pint.errors.PintError, ArithmeticError, AssertionError, AttributeError, SyntaxError, TypeError, ValueError,
            LookupError, RecursionError, tokenize.TokenError) as error:  # fmt: skip
        raise UnitError(f"must be {expected}, but {_unreadable(text)}") from error


def _bare_size(dimension: Dimension, bare: System | None, number: object) -> float:
    """The size in SI of the unit of a bare number; see `read_quantity`."""
    if bare is None and dimension != "1":
        raise UnitError(f"must have a unit, such as {example(dimension, 'si')}, but has {briefly(number)}")
    return unit_size(dimension, bare or "si")


def exact_text(value: float, dimension: Dimension, bare: System) -> str:
    """The text that `read_quantity` reads back to the last bit: a bare number, or one in SI where none is the same."""
    near, size = in_unit(value, unit_size(dimension, bare)), unit_size(dimension, bare)
    if near * size == value:
        return repr(near)
    return f"{value!r} {ascii_unit(unit_name(dimension, 'si'))}"


def read_removal(text: str, dimension: Dimension, bare: System = "si") -> float:
    """As `read_quantity`, of an erosion: a volume or mass may be that of an impact, "0.3 mg/impact", and is one then.

    Raises:
        UnitError: with a clause that starts with "must".
    """
    if dimension not in ("volume", "mass") or "impact" not in text:
        return read_quantity(text, dimension, bare)
    try:
        return read_quantity(f"{text} * impact", dimension, bare)
    except UnitError as error:
        raise UnitError(f"must be a {dimension} per impact, but is {briefly(text)}") from error


def _unreadable(text: str) -> str:
    hint = "; a number has a point, no comma" if _COMMA.match(text, 0, _LONGEST) else ""
    return f"{briefly(text)} cannot be read{hint}"


def has_control_characters(text: str) -> bool:
    """Whether a text has characters that a terminal obeys; ends of lines are among them."""
    return any(unicodedata.category(character) == "Cc" for character in text)


def _parts(text: str) -> re.Match[str] | None:
    """Number and unit of a quantity; None where it cannot be one."""
    return None if len(text) > _LONGEST else _QUANTITY.fullmatch(text)


def _check_powers(units: str) -> None:
    """Refuse what pint would compute for ever, "9**9**9**9": it takes powers of numbers and powers of powers too."""
    exponents = [_EXPONENT.match(units, sign.end()) for sign in re.finditer(r"\*\*|\^", units)]
    if any(exponent is None for exponent in exponents):
        raise ValueError("an exponent is no small number")
    # Powers in brackets may be raised again: together they raise no more than this.
    if math.prod(max(1.0, float(exponent[1] or exponent[2])) for exponent in exponents if exponent) > _GREATEST_POWER:
        raise ValueError("the exponents are too great")


_LONGEST = 200  # characters of a quantity, of which any that a person types has far fewer
_GREATEST_POWER = 100
_NO_UNIT = re.compile(r"[^\w\s*/^().·⋅×+\-−⁻⁺°%‰'\"]")
# "m3" for m³, which pint takes for a name. It knows no unit of letters and one digit, 2 or 3.
_POWERLESS = re.compile(r"(?<![\w])([^\W\d_]+)([23])(?!\w)")
_MIL = re.compile(r"\bmils?\b")  # a thousandth of an inch; pint's is an angle
# One or two digits before the point, or in brackets also a ratio of two such; no other power follows.
_EXPONENT = re.compile(
    r"\s*(?:[+-]?\s*(\d{1,2}(?:\.\d*)?)|\(\s*[+-]?\s*(\d{1,2}(?:\.\d*)?)(?:/\d{1,2})?\s*\))(?![\w.])(?!\s*(?:[\w.(^]|\*\*))"
)

_ANGLES = {"radian", "milliradian", "degree", "arcminute", "arcsecond", "turn", "gradian"}
_SPINS = {*_ANGLES, "revolutions_per_minute", "revolutions_per_second"}


def _check_angles(units: Mapping[str, Any], dimension: Dimension, complaint: str) -> None:
    """Refuse what pint takes for a pure number: an angle for one, its square for itself, or cycles (Hz) for radians."""
    turns = sum(power for unit, power in units.items() if unit in _SPINS)
    is_odd = {
        "1": True,
        "angle": not units.keys() <= _ANGLES or list(units.values()) != [1],
        "angular speed": turns != 1,
        **dict.fromkeys(("mass per mass", "rate"), bool(_SPINS & units.keys())),
    }
    if is_odd.get(dimension):
        raise UnitError(complaint)


_QUANTITY = re.compile(
    r"\s*(?P<number>[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|inf|nan))(?P<unit>(?:\s*[^\d\s.+\-(][^\n]*|\s+1/[^\n]*)?)\s*"
)
_COMMA = re.compile(r"\s*[+-]?\d*,\d")
_SAME_EXAMPLES = {
    "angle": '"20 deg"', "angular speed": '"1000 rad/s"', "rate": '"40 1/s"', "time": '"60 us"',
    "volume per mass": '"20 mm^3/g"', "mass per mass": '"0.1 mg/g"', "mass flux": '"1 g/m^2/s"', "mass flow": '"1 g/s"',
}  # fmt: skip
_EXAMPLES: Mapping[System, Mapping[str, str]] = {
    "inch-pound": {
        "length": '"0.04 in"', "mass": '"2.855e-7 slinch"', "speed": '"4400 in/s"', "stress": '"200e3 lbf/in^2"',
        "volume": '"1e-4 in^3"', "density": '"0.098 lb/in^3"', **_SAME_EXAMPLES,
    },
    "si": {
        "length": '"1 mm"', "mass": '"50 ug"', "speed": '"110 m/s"', "stress": '"1.4 GPa"',
        "volume": '"3 mm^3"', "density": '"2.7 g/cm^3"', **_SAME_EXAMPLES,
    },
}  # fmt: skip


@functools.cache
def _registry() -> "pint.UnitRegistry":
    import pint  # 0.6 s that a case without text does without

    registry = pint.UnitRegistry(cache_folder=None)
    registry.define("@alias pound = lbm")
    # Of oil fields; pint's barrel is that of dry goods.
    registry.define("@alias metric_ton = te")
    registry.define("pptb = pound / (1000 * oil_bbl)")
    registry.define("impact = [impact]")
    return registry


_DEGREE = math.pi / 180
_POUND = 0.45359237 / _SLINCH  # lb in slinch

_NAMED: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    **{("time", units): (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6), ("ns", 1e-9)) for units in SYSTEMS},
    **{("mass per mass", units): (("g/kg", 1e-3), ("mg/kg", 1e-6), ("µg/kg", 1e-9)) for units in SYSTEMS},
    ("length", "si"): (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9), ("pm", 1e-12), ("fm", 1e-15)),
    ("area", "si"): (("m²", 1.0), ("mm²", 1e-6), ("µm²", 1e-12)),
    ("volume", "si"): (("m³", 1.0), ("mm³", 1e-9), ("µm³", 1e-18)),
    ("mass", "si"): (("kg", 1.0), ("g", 1e-3), ("mg", 1e-6), ("µg", 1e-9), ("ng", 1e-12)),
    ("stress", "si"): (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3), ("Pa", 1.0)),
    ("volume per mass", "si"): (("mm³/g", 1e-6), ("mm³/kg", 1e-9)),
}
_RARE: Mapping[tuple[str, str], Sequence[tuple[str, float]]] = {
    ("length", "inch-pound"): (("mil", 1e-3), ("µin", 1e-6)),
    ("volume", "si"): (("cm³", 1e-6),),
}
"""Units for numbers that would need a power of ten otherwise."""
_BASES: Mapping[tuple[str, str], tuple[str, float]] = {
    **{("angle", units): ("°", _DEGREE) for units in SYSTEMS},
    ("mass", "inch-pound"): ("lb", _POUND),
    ("volume per mass", "inch-pound"): ("in³/lb", 1 / _POUND),
}
"""Units that readers expect instead of the consistent unit."""
_ANY_SIZE = ("1", "angle", "speed", "angular speed", "rate", "density")
"""Dimensions whose numbers read well without prefixes over many powers of ten."""
_PER_ANGLE = {"volume per angle": ("°", _DEGREE), "volume per angle²": ("°²", _DEGREE**2)}


def known_scales(dimension: Dimension, system: System) -> list[Scale]:
    """The units in which a reader may give numbers of a dimension: the consistent one first, then others by name."""
    key = (dimension, system)
    named = (*_NAMED.get(key, ()), *_RARE.get(key, ()), *([_BASES[key]] if key in _BASES else ()))
    sizes = {unit_name(dimension, system): 1.0} | dict(named)
    return [Scale(size * unit_size(dimension, system), unit) for unit, size in sizes.items()]


def superscript(exponent: int) -> str:
    """An integer in superscript digits: "⁻⁴"."""
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def readable_scale(dimension: Dimension, system: System, largest: float) -> Scale:
    """The unit in which numbers up to `largest` read well: "µs", "mm", "°", "10⁻⁴ in³/°", with its size in SI.

    Args:
        dimension: the dimension of the numbers.
        system: the unit system that shows them.
        largest: the greatest magnitude to show [SI]; 0 or a number that is not finite gives the
            base unit.
    """
    plain = (1e-3 if (dimension, system) == ("length", "inch-pound") else 0.5, 1e3)
    return _sized(dimension, system, largest, plain)


def table_scale(dimension: Dimension, system: System, largest: float) -> Scale:
    """As `readable_scale`, for a table: numbers from a thousandth to a million need no power of ten."""
    return Scale(1.0, "") if dimension == "1" else _sized(dimension, system, largest, (1e-3, 1e6))


def _sized(dimension: Dimension, system: System, largest: float, plain: tuple[float, float]) -> Scale:
    """See `readable_scale`; numbers within `plain` need no power of ten."""
    size = unit_size(dimension, system)
    scale = _scale(dimension, system, largest / size, plain)
    return Scale(scale.size * size, scale.unit)


def _scale(dimension: Dimension, system: System, largest: float, plain: tuple[float, float]) -> Scale:
    """The same of numbers in the system's own unit; so is the size."""
    if dimension in _PER_ANGLE:
        below, angle = _PER_ANGLE[dimension]
        volume = _scale("volume", system, largest * angle, plain)
        return Scale(volume.size / angle, f"{volume.unit}/{below}")
    base, size = _BASES.get((dimension, system), (unit_name(dimension, system), 1.0))
    if not (math.isfinite(largest) and largest > 0) or dimension == "angle":
        return Scale(size, base)
    named = _NAMED.get((dimension, system), ())
    # A volume has a thousand times as many digits between two prefixes.
    ideal = (0.05 if dimension == "volume" else 0.5, 1e3)
    for low, high in (ideal, plain):
        for unit, of_unit in named:
            if low <= largest / of_unit < high:
                return Scale(of_unit, unit)
    greatest = 1e5 if dimension in _ANY_SIZE else 1e3
    if plain[0] <= largest / size < max(greatest, plain[1]):
        return Scale(size, base)
    # Powers of ten of volumes in in³, as the source has them, are not in steps of three.
    step = 3 if named or dimension != "volume" else 1
    scales = [
        (step * math.floor((math.log10(largest / of_unit) + 1e-9) / step), unit, of_unit)
        for unit, of_unit in ((base, size), *named, *_RARE.get((dimension, system), ()))
        if 1e-300 < largest / of_unit < 1e300  # the power of ten, and its inverse, are numbers
    ]
    if not scales:
        return Scale(size, base)
    exponent, unit, of_unit = min(scales, key=lambda scale: abs(scale[0]))
    # A division by a whole power of ten rounds once.
    factor = of_unit * 10.0**exponent if exponent > 0 else of_unit / 10.0**-exponent
    return Scale(factor, f"10{superscript(exponent)} {unit}".strip() if exponent else unit)


DIGITS = 6  # in tables: the numerical errors are smaller by far, those of the physics far greater
ANGLE_DIGITS = 5  # 31.717°


@dataclass(frozen=True)
class Quantity:
    """A symbol, its meaning and its dimension.

    Args:
        fixed: the unit of what is in the same one in both unit systems, and so converted by none; its dimension is "1".
    """

    symbol: str
    meaning: str
    dimension: Dimension
    fixed: str = ""

    def label(self, system: System) -> str:
        """An axis label: "v₀  impact speed [in/s]"."""
        unit = unit_name(self.dimension, system)
        return f"{self.symbol}  {self.meaning}" + (f" [{unit}]" if unit else "")

    def unit(self, system: System) -> str:
        """The unit as programs read it: "in^3", "1" for a pure number."""
        return self.fixed or ascii_unit(unit_name(self.dimension, system))

    def size(self, system: System) -> float:
        """The size of that unit in SI; 1 of a fixed one."""
        return unit_size(self.dimension, system)

    def scale(self, system: System, largest: float) -> Scale:
        """The unit in which numbers up to `largest` [SI] read well in a table."""
        return Scale(1.0, self.fixed) if self.fixed else table_scale(self.dimension, system, largest)

    def in_words(self, value: float, system: System, digits: int = 4) -> str:
        """A number [SI] of it with the unit in which it reads well: "30 m/s", "40°", "110.2·10⁻⁶ lb"."""
        scale = self.scale(system, abs(value))
        return scale.beside(f"{value / scale.size:.{digits}g}")

    def declare(self, name: str, value: Any, **more: Any) -> Value:
        """A number of it [SI] for a result; `more` are other fields of the `Value`."""
        digits = ANGLE_DIGITS if self.dimension == "angle" else DIGITS
        usual = {"symbol": self.symbol, "meaning": self.meaning, "digits": digits, "measure": self}
        fields: dict[str, Any] = {**usual, **more}
        return Value(name, value, **fields)

    def in_si(self, name: str, value: Any, **more: Any) -> Value:
        """As `declare`, of a result that has its units in SI whatever the system that shows the others."""
        scale = functools.partial(self.scale, "si")
        return self.declare(name, value, **{"scale": scale, **more, "unit": self.unit("si"), "measure": None})

    def attributes(self) -> dict[str, str]:
        """The same as attributes of a labelled array in SI, in the words of the CF conventions."""
        return {"long_name": self.meaning, "symbol": self.symbol, "units": self.unit("si")}


QUANTITIES: Mapping[str, Quantity] = types.MappingProxyType(
    {
        "k": Quantity("k", "force ratio", "1"),
        "psi": Quantity("ψ", "contact height over depth", "1"),
        "r": Quantity("r", "centre of mass to tip", "length"),
        "b": Quantity("b", "width of the particle", "length"),
        "m": Quantity("m", "mass of the particle", "mass"),
        "v0": Quantity("v₀", "impact speed", "speed"),
        "sigma": Quantity("σ", "flow stress", "stress"),
        "alpha": Quantity("α", "angle of attack", "angle"),
        "phidot0": Quantity("φ̇₀", "initial spin", "angular speed"),
        "inertia": Quantity("β", "moment of inertia over m r²", "1"),
    }
)
"""The parameters of an impact, in the order of the constructor of `Parameters`."""

RESULTS = {
    "t_c": Quantity("t_c", "end of the cut", "time"),
    "volume": Quantity("V", "removed volume", "volume"),
    "volume_at_contact": Quantity("V(0)", "removed at contact, beside the cut", "volume"),
    "dvolume": Quantity("dV/dα", "change of volume with angle", "volume per angle"),
    "d2volume": Quantity("d²V/dα²", "its own change with angle", "volume per angle²"),
    "alpha_max": Quantity("α_max", "angle of attack that removes most", "angle"),
    "volume_max": Quantity("V_max", "volume removed at that angle", "volume"),
    "mean_volume": Quantity("V̄", "removed volume of a particle, mean of the stream", "volume"),
    "deviation": Quantity("s", "standard deviation of V from particle to particle", "volume"),
    "mean_mass": Quantity("m̄", "mass of a particle, mean of the stream", "mass"),
    "total_volume": Quantity("ΣV", "removed by all the particles computed", "volume"),
    "erosion": Quantity("E", "removed volume per unit mass of particles", "volume per mass"),
    "max_depth": Quantity("d_max", "greatest depth of the tip", "length"),
    "turn": Quantity("|Δφ|", "how far the body turned", "angle"),
    "specific_volume": Quantity("V/m", "removed volume per mass of particles", "volume per mass"),
    "mass_loss": Quantity("Δm", "mass loss per impact", "mass"),
    "erosion_ratio": Quantity("Δm/m", "mass loss per mass of particles", "mass per mass"),
    "relative_erosion": Quantity("E", "erosion, in units of its own", "1"),
    "d": Quantity("d", "diameter of the particle in a CFD code", "length"),
    "e_n": Quantity("e_n", "normal speed of the centre of mass after the impact over that before", "1"),
    "e_t": Quantity("e_t", "tangential velocity of the centre of mass after the impact over that before", "1"),
    "vx": Quantity("ẋ", "velocity of the centre of mass along the surface", "speed"),
    "vy": Quantity("ẏ", "velocity of the centre of mass into the target", "speed"),
    "spin": Quantity("φ̇", "spin after the impact", "angular speed"),
}


def declare_result(name: str, value: Any, **more: Any) -> Value:
    """One of `RESULTS`; see `Quantity.declare`."""
    return RESULTS[name].declare(name, value, **more)


@dataclass(frozen=True)
class Derivative:
    """The unit of a derivative of one quantity with respect to others.

    Args:
        of: the dimension of the quantity.
        by: those of the others.
    """

    of: Dimension
    by: tuple[Dimension, ...]

    def unit(self, system: System) -> str:
        """The unit as programs read it: "in^3/rad"."""
        unit = derivative_unit(self.of, self.by, system)
        return ascii_unit(f"1{unit}" if unit.startswith("/") else unit)

    def size(self, system: System) -> float:
        """The size of that unit in SI."""
        return unit_size(self.of, system) / math.prod(unit_size(dimension, system) for dimension in self.by)

    def scale(self, system: System, largest: float) -> Scale:
        """The unit in a table: per degree, and of volumes in SI mm³."""
        size = self.size(system) / _DEGREE ** sum(dimension == "angle" for dimension in self.by)
        unit = re.sub(r"/rad(²?)(?=/|$)", r"/°\1", derivative_unit(self.of, self.by, system))
        if system == "si" and self.of == "volume":
            size, unit = size * 1e-9, unit.replace("m³", "mm³", 1)
        return Scale(size, unit)


def declare_derivative(name: str, value: Any, by: Sequence[Quantity]) -> Value:
    """The volume's derivative with respect to one or two parameters; in tables per degree, not per radian."""
    same = len(by) == 2 and by[0] == by[1]
    power = "²" if len(by) == 2 else ""
    below = f"∂{by[0].symbol}²" if same else "".join(f"∂{quantity.symbol}" for quantity in by)
    meaning = "change of volume with " + " and ".join(dict.fromkeys(quantity.meaning for quantity in by))
    measure = Derivative(RESULTS["volume"].dimension, tuple(quantity.dimension for quantity in by))
    return Value(name, value, f"∂{power}V/{below}", meaning, measure=measure)


STEEPEST = np.pi / 2  # rad; the angle of attack of a perpendicular impact
_LONGEST_COUNT = 100  # digits; Python reads no number of more than a few thousand
QUARTER_DEGREES = np.linspace(0, STEEPEST, 361)[1:]
"""Every quarter of a degree up to 90°, shape (360,) [rad]."""


class InSI(dict[str, Any]):
    """Numbers or laws by parameter that are in SI, also beside a case that is shown in other units."""


def read_axis(value: object, dimension: Dimension, bare: System | None = "si") -> np.ndarray:
    """The values of an axis [SI], shape (n,), or of a single quantity, shape ().

    Args:
        value: text as above, a number, or a list of quantities.
        dimension: of the parameter.
        bare: see `read_quantity`.

    Raises:
        UnitError: with a clause that starts with "must", to follow the axis's name.
    """
    if isinstance(value, str) and ":" in value:
        return _range(value, dimension, bare)
    if isinstance(value, str):
        value = [part.strip() for part in value.split(",")] if "," in value else value
    if isinstance(value, (list, tuple)):
        if not value:
            raise UnitError("must hold values, but is empty")
        return np.array([_one(part, dimension, bare) for part in value])
    return np.array(_one(value, dimension, bare))


def _range(text: str, dimension: Dimension, bare: System | None) -> np.ndarray:
    first, last, number, *spacing = (part.strip() for part in text.split(":")) if text.count(":") > 1 else ("",) * 3
    if not number.isdecimal() or len(number) > _LONGEST_COUNT or int(number) < 2 or spacing not in ([], ["log"]):
        raise UnitError(f'must be "first : last : count", with ": log" for even ratios, but is {briefly(text)}')
    begin, end = (read_quantity(part, dimension, bare) for part in (first, last))
    if not np.isfinite([begin, end]).all():
        raise UnitError(f"must have finite ends, but is {briefly(text)}")
    if spacing and begin * end <= 0:
        raise UnitError(f"must have ends of one sign, other than zero, for even ratios, but is {briefly(text)}")
    try:
        return (np.geomspace if spacing else np.linspace)(begin, end, int(number))
    except (MemoryError, ValueError) as error:
        raise UnitError(f"must have values that fit into the memory, but is {briefly(text)}") from error


def _one(value: object, dimension: Dimension, bare: System | None) -> float:
    if isinstance(value, str):
        return read_quantity(value, dimension, bare)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value) * _bare_size(dimension, bare, value)
    raise UnitError(f"must be numbers or quantities in quotes, but has {briefly(value)}")
