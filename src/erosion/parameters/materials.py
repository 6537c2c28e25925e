"""Particles and targets by name, from a table that a user extends by a file of the same form."""

import difflib
import functools
import math
import re
import sys
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import refuse
from erosion.output.files import read_toml
from erosion.output.tables import briefly
from erosion.parameters.quantities import Dimension, InSI, about, read_quantity, unit_size
from erosion.results import Finding

MATERIALS: Mapping[str, float] = types.MappingProxyType(
    {
        metal: number * unit_size("stress", "inch-pound")
        for metal, number in {
            "mild steel": 37e3, "brass": 27e3, "copper": 10e3, "stainless steel": 75e3, "titanium": 136e3
        }.items()
    }
)  # fmt: skip
"""Flow stress [Pa] of the metals of Laverty, Table 2; they are targets, too: `p.with_target("copper")`."""
# materials.toml has them as well; a test compares.

VICKERS = 9.80665e6
"""A Vickers hardness of 1 kgf/mm² [Pa]."""

CONTACT_RATIO = 2.0
"""ψ of a target whose flow stress is its hardness [-]; the volume depends on σψ alone, so that ψ = 2 H/σ of any other.

Finnie took ψ = 2, from cutting tests on metals: Wear 3 (1960) 87-103. OpenFOAM and COMSOL 6.2 have it as default.
"""

_SPHERE = 0.4  # β = I/(m r²)

_SIZED = re.compile(r"(?P<name>.+)\s+(?P<size>(?:\d+[.,]?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*[^\d\s.,]\S*)\s*")
# "garnet 80 mesh", "garnet 30/60", "garnet mesh 30-60", "garnet #80", "alumina F80"
_SIEVED = re.compile(
    r"(?P<name>.+?)\s+(?P<sieves>(?:#|F\s*|mesh\s+)\d{1,3}(?:\s*[/x-]\s*\d{1,3})?|\d{1,3}\s*[/x-]\s*\d{1,3}(?:\s*mesh)?|"
    r"\d{1,3}\s*mesh)\s*",
    re.IGNORECASE,
)
_FILED = re.compile(r"(?P<file>.+\.toml)\s*:\s*(?P<name>.+)", re.IGNORECASE | re.DOTALL)
_FIELDS: Mapping[str, Mapping[str, Dimension]] = types.MappingProxyType(
    {
        "particles": {"density": "density", "vickers": "1"},
        "targets": {"density": "density", "vickers": "1", "flow_stress": "stress", "psi": "1"},
    }
)
_WORDS: Mapping[str, Mapping[str, Any]] = types.MappingProxyType(
    {
        "particles": {"hardness": "", "shape": "", "oka": "", "source": "", "also": []},
        "targets": {"source": "", "also": [], "correlations": []},
    }
)
"""Fields of text, and of lists of texts, as they are without an entry of their own."""
_RANGED = ("density", "vickers", "flow_stress")


@dataclass(frozen=True)
class Particle:
    """A particle of a material and a size, taken for a sphere of that diameter.

    `p.with_particle(…)` sets m = ρ π d³/6, r = d/2, b = r as Table 1 has it, and β = 2/5.

    Args:
        name: of the material.
        size: diameter d, for grains the width of the sieve's mesh [m].
        sieves: the mesh by which the size was given, with its standard, or "".
        density: ρ [kg/m³].
        density_range: what the source spans [kg/m³].
        hardness: in words.
        vickers: hardness [kgf/mm²], where it is known; the least of the source.
        shape: "angular", "semi-rounded", "round" or "".
        oka: the name of the abrasive in the tests of Oka, or "".
        source: of the numbers.
    """

    name: str
    size: float
    density: float
    density_range: tuple[float, float]
    hardness: str = ""
    shape: str = ""
    source: str = ""
    sieves: str = ""
    vickers: float | None = None
    oka: str = ""

    @property
    def radius(self) -> float:
        """d/2 [m], the distance r from the centre of mass to the tip and the width b."""
        return self.size / 2

    @property
    def mass(self) -> float:
        """ρ π d³/6 [kg]."""
        return self.density * math.pi * self.size**3 / 6

    @property
    def parameters(self) -> InSI:
        """r, b, m and β of this sphere."""
        return InSI(r=self.radius, b=self.radius, m=self.mass, inertia=_SPHERE)

    def __str__(self) -> str:
        return f"{self.name} {self.size * 1e3:.6g} mm"


@dataclass(frozen=True)
class Target:
    """A metal.

    `p.with_target(…)` sets σ and ψ, whose product decides the volume. Where a table gives the Vickers hardness alone,
    σ is that hardness and ψ = 2 (`CONTACT_RATIO`). Beside a flow stress of its own ψ = 2 H/σ.

    Args:
        name: of the metal.
        flow_stress: σ [Pa].
        flow_stress_range: what the source spans [Pa].
        psi: ψ [-].
        density: [kg/m³]; None where the table has none.
        density_range: what the source spans [kg/m³].
        vickers: hardness [kgf/mm²], where it is known.
        correlations: that are made for this target, as `load_model` knows them.
        source: of the numbers.
    """

    name: str
    flow_stress: float
    flow_stress_range: tuple[float, float]
    psi: float
    density: float | None = None
    density_range: tuple[float, float] | None = None
    vickers: float | None = None
    correlations: tuple[str, ...] = ()
    source: str = ""

    @property
    def hardness(self) -> float:
        """σψ/2 [Pa], the flow stress of this metal at ψ = 2."""
        return self.flow_stress * self.psi / CONTACT_RATIO

    @property
    def parameters(self) -> InSI:
        """σ and ψ."""
        return InSI(sigma=self.flow_stress, psi=self.psi)

    def density_beside(self, given: float | None) -> float | None:
        """The density [kg/m³] that counts: a given one, which must be of this metal, or the table's.

        Raises:
            ValueError: for the density of another metal.
        """
        if given is not None and self.density is not None:
            low, high = self.density_range or (self.density, self.density)
            if not low / ANOTHER_METAL <= given <= high * ANOTHER_METAL:
                raise ValueError(
                    f"Argument `density` must be that of the target {self.name}, {self.density:g} kg/m³, but is "
                    f"{given:g} kg/m³: leave one of them out."
                )
        return self.density if given is None else given

    def __str__(self) -> str:
        return self.name


ANOTHER_METAL = 1.1
"""Ratio of densities. Those of one metal differ less between sources, those of a steel and aluminium more."""
_SMALLEST, _LARGEST = 1e-10, 1e6  # m
_LONGEST_NAME = 200  # characters with the size; the pattern's time grows with their square
_MOST_NAMES = 50  # that a message lists


def particle(text: "str | Particle") -> Particle:
    """A particle by material and size.

        erosion.particle("garnet 0.3 mm").mass  # 5.9e-8 kg

    Args:
        text: a name of the table and a diameter, "garnet 0.3 mm"; of a table of your own, "mine.toml: slag 0.5 mm".
            Mesh numbers are read, too: "garnet 80 mesh" has the opening of the sieve, "garnet 30/60 mesh" the
            geometric mean of both, "alumina F80" is as mesh 80.

    Raises:
        ValueError: for a material that the table lacks, a size that cannot be read, or a file that cannot be used.
    """
    if isinstance(text, Particle):
        return text
    file, name = _split_file("particle", text)
    if len(name) <= _LONGEST_NAME and (match := _SIEVED.fullmatch(name)):
        entry = _particle_entry(match["name"], file)
        return Particle(size=_median(match["sieves"]), sieves=f"{match['sieves']}, ASTM E11", **entry)
    match = _SIZED.fullmatch(name) if len(name) <= _LONGEST_NAME else None
    if match is None:
        raise ValueError(
            f'Argument `particle` must be a material and a size such as "garnet 0.3 mm", but is {briefly(text)}.'
        )
    entry = _particle_entry(match["name"], file)
    with about("Argument `particle`"):
        size = read_quantity(match["size"], "length")
    wish = "positive size" if size <= 0 else f"size from {_SMALLEST:g} m to {_LARGEST:g} m"
    if not _SMALLEST <= size <= _LARGEST:
        raise ValueError(f"Argument `particle` must have a {wish}, but is {briefly(text)}.")
    return Particle(size=size, **entry)


def _particle_entry(name: str, file: Path | None) -> dict[str, Any]:
    entry = _entry("particle", name, "particles", file)
    del entry["vickers_range"]
    return entry


def _median(sieves: str) -> float:
    """The middle of the grains that pass the first sieve and stay on the last [m]."""
    openings = _sieves()
    numbers = re.findall(r"\d+", sieves)
    if unknown := [number for number in numbers if number not in openings]:
        raise ValueError(
            f"Argument `particle` must have the number of a sieve of ASTM E11 ({', '.join(openings)}) or a "
            f"diameter, but has {briefly(unknown[0])}."
        )
    # Rounded as catalogues have it: 30/60 is 0.387 mm.
    return float(f"{math.prod(openings[number] for number in numbers) ** (1 / len(numbers)):.3g}") * 1e-3


@functools.cache
def _sieves() -> Mapping[str, float]:
    """The openings of sieves by number [mm]."""
    return read_toml(Path(__file__).with_name("sieves.toml"))


def target(text: "str | Target") -> Target:
    """A target by name.

        erosion.target("aluminium 6061").density  # 2700 kg/m³

    Args:
        text: a name of the table; of a table of your own, "mine.toml: my alloy".

    Raises:
        ValueError: for a metal that the table lacks, or a file that cannot be used.
    """
    if isinstance(text, Target):
        return text
    file, name = _split_file("target", text)
    entry = _entry("target", name, "targets", file)
    vickers, ranged = entry["vickers"], entry.pop("vickers_range")
    if entry["flow_stress"] is None:
        entry |= {"flow_stress": vickers * VICKERS, "flow_stress_range": tuple(end * VICKERS for end in ranged)}
    if entry["psi"] is None:
        entry["psi"] = CONTACT_RATIO * vickers * VICKERS / entry["flow_stress"]
    return Target(**entry)


def known_particles(file: Path | None = None) -> list[str]:
    """The names of the materials of particles in the package's table, or in a file."""
    return list(_table(file)["particles"])


def known_targets(file: Path | None = None) -> list[str]:
    """The names of the targets in the package's table, or in a file."""
    return list(_table(file)["targets"])


def implausible_body(m: Any, r: Any, b: Any) -> Finding | None:
    """The finding where no body of a plausible density has this mass and this size; arrays broadcast."""
    # No body that reaches no further than r from its centre is larger than this cylinder.
    largest = np.pi * np.square(r) * np.maximum(b, 2 * np.asarray(r))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        density = np.ravel(np.asarray(m) / largest)
    density = density[np.isfinite(density) & (density > 0)]
    if density.size and density.max() > HEAVIEST:
        return Finding("too_heavy", numbers={"density": density.max(), "bound": HEAVIEST})
    if density.size and density.min() < LIGHTEST:
        return Finding("too_light", numbers={"density": density.min(), "bound": LIGHTEST})
    return None


HEAVIEST = 22590.0  # kg/m³, osmium, the heaviest solid
LIGHTEST = 100.0  # kg/m³; the lightest hollow glass beads have a little more


def _split_file(argument: str, text: Any) -> tuple[Path | None, str]:
    """The table's file, if one is named, and the rest of the text."""
    if not isinstance(text, str):
        raise ValueError(f"Argument `{argument}` must be text such as {_SUCH_AS[argument]}, but is {briefly(text)}.")
    match = _FILED.fullmatch(text.strip())
    return (None, text.strip()) if match is None else (Path(match["file"]), match["name"].strip())


_SUCH_AS = types.MappingProxyType({"particle": '"garnet 0.3 mm"', "target": '"aluminium 6061"'})


def _entry(argument: str, name: str, kind: str, file: Path | None) -> dict[str, Any]:
    """The fields of the entry that has this name, whatever its capitals, hyphens and spaces."""
    entries = _table(file)[kind]
    names = {_folded(also): key for key, entry in entries.items() for also in (key, *entry["also"])}
    if _folded(name) not in names:
        where = "" if file is None else f" in {file}"
        near = difflib.get_close_matches(_folded(name), names, 1)
        hint = f"; did you mean {names[near[0]]!r}?" if near else "."
        known = ", ".join([*map(briefly, list(entries)[:_MOST_NAMES]), *["…"][: len(entries) > _MOST_NAMES]]) or "none"
        raise ValueError(f"Argument `{argument}` must name one of {known}{where}, but names {briefly(name)}{hint}")
    key = names[_folded(name)]
    return {"name": key} | {field: value for field, value in entries[key].items() if field != "also"}


def _folded(name: str) -> str:
    return re.sub(r"[\s,_-]+", " ", name.casefold()).strip()


def _table(file: Path | None) -> Mapping[str, Mapping[str, dict[str, Any]]]:
    if file is None:
        return _built_in()
    content = read_toml(file)
    try:
        return _checked(content)
    except ValueError as error:
        raise ValueError(f"{file}: {str(error).rstrip('.')}.") from error


@functools.cache
def _built_in() -> Mapping[str, Mapping[str, dict[str, Any]]]:
    return _checked(read_toml(Path(__file__).with_name("materials.toml")))


def _checked(content: Mapping[str, Any]) -> dict[str, dict[str, dict[str, Any]]]:
    """The entries by kind and name, with every field."""
    if not content or not content.keys() <= _FIELDS.keys():
        raise ValueError("must have tables such as [particles.garnet] and [targets.brass], and no others")
    table: dict[str, dict[str, dict[str, Any]]] = {kind: {} for kind in _FIELDS}
    for kind, entries in content.items():
        if not isinstance(entries, Mapping) or not all(isinstance(entry, Mapping) for entry in entries.values()):
            raise ValueError(f"[{kind}] must have a table for each name, such as [{kind}.brass]")
        owners: dict[str, str] = {}
        for key, entry in entries.items():
            with about(f"{_heading(kind, key)}:"):
                fields = table[kind][key] = _read_entry(kind, entry)
                for name in (key, *fields["also"]):
                    # Of two entries of one name a particle or a target could be either.
                    if (owner := owners.setdefault(_folded(name), key)) != key:
                        raise ValueError(f"has the name {briefly(name)}, as {_heading(kind, owner)} has")
    return table


def _heading(kind: str, name: str) -> str:
    return f"[{kind}.{_in_one_line(name)}]"


def _in_one_line(name: str) -> str:
    """A name of a file in a message, which it may neither break nor fill."""
    return name if name.isprintable() and len(name) <= _LONGEST_NAME else briefly(name)


def _read_entry(kind: str, entry: Mapping[str, Any]) -> dict[str, Any]:
    numbers, words = _FIELDS[kind], _WORDS[kind]
    known = (*numbers, *(f"{name}_range" for name in numbers if name in _RANGED), *words)
    for name in entry:
        if name not in known:
            raise ValueError(f"field `{_in_one_line(name)}` is unknown; they are {', '.join(known)}")
    fields: dict[str, Any] = {}
    for name, dimension in numbers.items():
        fields[name] = _number(name, entry.get(name), dimension)
        if name in _RANGED:
            fields[f"{name}_range"] = _range(name, entry.get(f"{name}_range"), fields[name], dimension)
    for name, default in words.items():
        value = entry.get(name, default)
        is_list = isinstance(default, list)
        texts = value if is_list and isinstance(value, list) else [value]
        odd = [text for text in texts if not isinstance(text, str)]
        refuse(
            f"field `{name}` must be ",
            (is_list and texts is not value, f"a list of texts, but is {briefly(value)}"),
            (odd, f"text in quotes, but is {briefly(odd[0] if odd else '')}"),
        )
        fields[name] = tuple(value) if is_list else value
    shape = fields.get("shape", "")
    refuse(
        "field ",
        (shape not in ("", "angular", "semi-rounded", "round"),
         f"`shape` must be angular, semi-rounded or round, but is {briefly(shape)}"),
        (kind == "particles" and fields["density"] is None, "`density` is missing"),
        (kind == "targets" and fields.get("flow_stress") is fields.get("vickers") is None,
         "`vickers` or `flow_stress` is missing"),
        (kind == "targets" and fields.get("psi") is fields.get("vickers") is None,
         "`psi` is missing, or `vickers`, from which it follows: the volume depends on σψ"),
    )  # fmt: skip
    return fields


def _number(name: str, value: Any, dimension: Dimension) -> float | None:
    if value is None:
        return None
    if isinstance(value, str):
        with about(f"field `{name}`"):
            value = read_quantity(value, dimension, "si")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value <= sys.float_info.max:
        value = math.inf if isinstance(value, int) and value > sys.float_info.max else value  # of too many digits
        raise ValueError(f"field `{name}` must be a positive number, or a quantity in quotes, but is {briefly(value)}")
    return float(value)


def _range(name: str, ends: Any, value: float | None, dimension: Dimension) -> tuple[float, float] | None:
    if ends is None:
        return None if value is None else (value, value)
    if not isinstance(ends, list) or len(ends) != 2:
        raise ValueError(f"field `{name}_range` must be two numbers, but is {briefly(ends)}")
    low, high = (_number(f"{name}_range", end, dimension) for end in ends)
    if value is None or low is None or high is None or not low <= value <= high:
        raise ValueError(f"field `{name}_range` must hold `{name}`, but is {briefly(ends)}")
    return low, high
