"""The two consistent unit systems, and the only place where pint is used.

Numbers inside the package are plain floats in one consistent system; a `Parameters`
carries the name of its system. Units appear at the edges: case files, the command line,
tables and axis labels.
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
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    import pint

System = Literal["inch-pound", "si"]
Dimension = Literal[
    "1", "length", "area", "volume", "mass", "time", "speed", "stress", "angle", "angular speed",
    "rate", "volume per angle", "volume per angle²", "density", "volume per mass", "mass per mass",
    "mass flux", "mass flow", "energy",
]  # fmt: skip

SYSTEMS: tuple[System, ...] = get_args(System)

# pint's name of each dimension's unit. The inch-pound-second system is consistent only with
# mass in slinch ("dozens of slugs", lbf s²/in), 1 slinch = 175.126835246 kg.
_PINT_UNITS: Mapping[System, Mapping[Dimension, str]] = types.MappingProxyType(
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
_INCH_POUND_IN_SI: Mapping[Dimension, float] = types.MappingProxyType(
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


def check_system(units: str) -> System:
    """The unit system that `units` names, in small or capital letters ("SI"), else raise `ValueError`."""
    for system in SYSTEMS:
        if isinstance(units, str) and units.lower() == system:
            return system
    raise ValueError(f"Argument `units` must be one of {', '.join(map(repr, SYSTEMS))}, but is {shown(units)}.")


def unit_name(dimension: Dimension, system: System) -> str:
    """The unit as a person writes it: "in³", "slinch", "" for a pure number."""
    name = re.sub(r"\binch\b", "in", _PINT_UNITS[system][dimension])
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
def conversion_factor(dimension: Dimension, source: System, target: System) -> float:
    """What a number in `source` units is multiplied by to be in `target` units."""
    if source == target:
        return 1.0
    factor = _INCH_POUND_IN_SI.get(dimension, 1.0)
    return factor if target == "si" else 1 / factor


def has_unit(text: str) -> bool:
    """Whether a quantity as text carries a unit."""
    return bool(unit_of(text))


def unit_of(text: str) -> str:
    """The unit of a quantity as text; empty where it has none."""
    parts = _parts(text)
    return "" if parts is None else parts["unit"].rstrip()


def example(dimension: Dimension, system: System) -> str:
    """A quantity of this dimension as text, in quotes where it has a unit."""
    return _EXAMPLES[system].get(dimension, "2")


def read_quantity(text: str, dimension: Dimension, system: System) -> float:
    """Read "4400 in/s" as a float in the units of `system`.

    A bare number is taken to be in the system's own unit (angles: radians).

    Raises:
        UnitError: with a clause that starts with "must", to follow the field's name.
    """
    import pint

    registry = _registry()
    unit = _PINT_UNITS[system][dimension]
    article = "an" if dimension[0] == "a" else "a"
    expected = f"{article} {dimension if unit else 'pure number'} such as {example(dimension, system)}"
    # Number and unit are taken apart here: pint reads "44 00 in" as a product.
    parts = _parts(text)
    if parts is None:
        raise UnitError(f"must be {expected}, but {_unreadable(text)}")
    number, given = float(parts["number"]), _POWERLESS.sub(r"\1^\2", parts["unit"].strip())
    if not given:
        return number
    try:
        _check_powers(pint.util.string_preprocessor(given))
        units = registry.parse_units(given)
        if units.dimensionality == registry.parse_units(unit or "dimensionless").dimensionality:
            _check_angles(dict(units._units), dimension, f"must be {expected}, but is {text!r}")
        return float(registry.Quantity(number, units).to(unit or "dimensionless").magnitude)
    except pint.errors.DimensionalityError as error:
        dimensions = _dimension_of(registry.parse_units(given).dimensionality)
        raise UnitError(f"must be {expected}, but is {text!r}, of dimension {dimensions}") from error
    except UnitError:
        raise
    # pint lets errors of its tokenizer and of Python's arithmetic through as they are.
    except (pint.errors.PintError, ArithmeticError, AssertionError, AttributeError, SyntaxError, TypeError, ValueError,
            LookupError, RecursionError, tokenize.TokenError) as error:  # fmt: skip
        raise UnitError(f"must be {expected}, but {_unreadable(text)}") from error


def _unreadable(text: str) -> str:
    hint = "; a number has a point, no comma" if _COMMA.match(text, 0, _LONGEST) else ""
    return f"{shown(text)} cannot be read{hint}"


def shown(value: Any) -> str:
    """A value as a message shows it; of a long one the beginning."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[:40]}… ({len(text):,} characters)"


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
# "m3" for m³, which pint takes for a name. It knows no unit of letters and one digit, 2 or 3.
_POWERLESS = re.compile(r"(?<![\w])([^\W\d_]+)([23])(?!\w)")
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

_EXAMPLES: Mapping[System, Mapping[str, str]] = {
    "inch-pound": {
        "length": '"0.04 in"', "mass": '"2.855e-7 slinch"', "speed": '"4400 in/s"', "stress": '"200e3 lbf/in^2"',
        "angle": '"20 deg"', "angular speed": '"1000 rad/s"', "rate": '"40 1/s"', "time": '"60 us"',
        "volume": '"1e-4 in^3"',
        "density": '"0.098 lb/in^3"', "volume per mass": '"20 mm^3/g"', "mass per mass": '"0.1 mg/g"',
        "mass flux": '"1 g/m^2/s"', "mass flow": '"1 g/s"',
    },
    "si": {
        "length": '"1 mm"', "mass": '"50 ug"', "speed": '"110 m/s"', "stress": '"1.4 GPa"',
        "angle": '"20 deg"', "angular speed": '"1000 rad/s"', "rate": '"40 1/s"', "time": '"60 us"',
        "volume": '"3 mm^3"',
        "density": '"2.7 g/cm^3"', "volume per mass": '"20 mm^3/g"', "mass per mass": '"0.1 mg/g"',
        "mass flux": '"1 g/m^2/s"', "mass flow": '"1 g/s"',
    },
}  # fmt: skip


def _dimension_of(dimensionality: object) -> str:
    text = str(dimensionality).replace(" ** ", "^")
    return "1 (a pure number)" if text == "dimensionless" else text


@functools.cache
def _registry() -> "pint.UnitRegistry":
    import pint

    return pint.UnitRegistry(cache_folder=None)
