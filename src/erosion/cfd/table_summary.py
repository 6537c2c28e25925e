"""Summary of a table as it was read, for users to compare with their run."""

import math
from pathlib import Path

import numpy as np

from erosion.cfd.incidence import HIT, Hits, box_in_words
from erosion.cfd.rows import ImpactBlock, Impacts
from erosion.cfd.surface import Surface
from erosion.cfd.tally import FaceTally
from erosion.parameters.quantities import Scale, readable_scale
from erosion.results import Finding, found

ONE_ROW = "one_row_wears"
"""The code of the finding that one of many rows does much of the wear."""

_FEW = 100  # impacts at random times, of which the first and the last are 2 % of the time off its ends, on average
_GROWTH = 2.6  # of the wear with speed, as of metals in DNVGL-RP-O501 (2015), table 3-1
_DOMINATES = 0.05  # share of the wear from which on one of many rows is named, if it has 30 times the mean, too
_COMPARED = 1_000_000  # rows at most among which those that repeat others are looked for
_SPECK = 0.03  # of the surface's length: seen is a unit at least 33 times too large (m for mm or inches), not cm for mm
_REPEATED = 0.01  # share of rows above which they are said
_SAME_MASS = 0.05  # of a sphere of its diameter and density, above which a mass contradicts them


class Repeats:
    """Rows that repeat others of the table, number for number, as of a file that is in it twice."""

    def __init__(self) -> None:
        # Of equal rows all are kept or none, so that tables of any length can be compared.
        self._rows, self._stride, self._digests = 0, 1, np.zeros(0, np.uint64)

    def add(self, block: ImpactBlock) -> None:
        """Take note of the rows of a block that say where they hit."""
        if block.position is None:
            return
        digest = np.zeros(block.rows, np.uint64)
        columns = [block.count, block.mass, block.diameter, block.speed, block.alpha, block.time]
        for vector in (block.velocity, block.position):
            columns += [] if vector is None else [*np.asarray(vector).T]
        for values in (column for column in columns if column is not None):
            # To single precision, as another file of the same rows may have them.
            with np.errstate(over="ignore"):
                bits = np.asarray(values, np.float32).view(np.uint32)
            digest = (digest ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            digest ^= digest >> np.uint64(32)
        self._rows += block.rows
        self._digests = np.append(self._digests, digest[digest % np.uint64(self._stride) == 0])
        while len(self._digests) > _COMPARED:
            self._stride *= 2
            self._digests = self._digests[self._digests % np.uint64(self._stride) == 0]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """That rows repeat others."""
        compared = max(1, len(self._digests))
        repeated = int((np.diff(np.sort(self._digests)) == 0).sum())  # `np.unique` of a million takes 20 times as long
        numbers = {"repeated": round(repeated / compared * self._rows), "rows": self._rows}
        return found((repeated > _REPEATED * compared, Finding("rows_repeated", numbers=numbers)))


class TableSummary:
    """The least and the greatest numbers of the rows read so far: times and places of all rows, the rest of hits."""

    def __init__(self) -> None:
        names = ("time", "count", "diameter", "density", "stated", "mass_ratio", "speed", "alpha")
        self._ends = dict.fromkeys(names, (math.inf, -math.inf))
        self._box = self._struck_box = np.array([[math.inf], [-math.inf]]) * np.ones(3)
        self._most, self._place, self._all = 0.0, "", 0.0  # mass × speed^2.6 of a row, the row, and of all
        self._rows, self._near, self._weightless, self._contradicted, self._repeats = 0, 0, 0, 0, Repeats()

    def add(self, block: ImpactBlock, hits: Hits) -> None:
        """Take note of the rows of a block."""
        self._repeats.add(block)
        struck, time = hits.fate == HIT, np.zeros(0) if block.time is None else np.asarray(block.time)
        names = ("count", "diameter", "speed", "alpha")
        rows = {"time": time, **{name: getattr(hits, name)[struck] for name in names}}
        with np.errstate(divide="ignore", over="ignore"):
            rows["density"] = hits.mass[struck] / (math.pi / 6 * rows["diameter"] ** 3)
            rows["stated"] = np.zeros(0) if block.density is None else np.asarray(block.density)[struck]
            ratio = rows["density"][: len(rows["stated"])] / rows["stated"]
        rows["mass_ratio"] = ratio[~(np.abs(ratio - 1) < _SAME_MASS)]
        self._contradicted += len(rows["mass_ratio"])
        wear = np.where(struck, hits.count * hits.mass * hits.speed**_GROWTH, 0.0)
        self._all += float(wear.sum())
        self._weightless += int((struck & (hits.count == 0)).sum())
        self._rows, self._near = self._rows + block.rows, self._near + int(struck.sum())
        if block.position is not None:
            position = np.asarray(block.position, float)
            self._box, self._struck_box = _around(self._box, position), _around(self._struck_box, position[struck])
        if wear.max(initial=0.0) > self._most:
            row = int(wear.argmax())
            self._most, self._place = float(wear[row]), f"Row {block.first + row + 1:,} of {Path(block.source).name}"
        for name, (least, greatest) in self._ends.items():
            self._ends[name] = float(rows[name].min(initial=least)), float(rows[name].max(initial=greatest))

    def lines(self, table: Impacts, tally: FaceTally, surface: Surface | None, injected: float | None) -> list[str]:
        """How the table was understood, in its own units; a line each.

        Args:
            table: the table.
            tally: the sums of its rows.
            surface: of the map.
            injected: the mass of all sand [kg], where the user or the case says it.
        """
        names = "count", "diameter", "density", "speed", "alpha"
        count, size, density, speeds, angles = (self._ends[name] for name in names)
        total = {name: math.fsum(values) for name, values in tally.sums.items()}
        of_particle = 1 / total["particles"] if total["particles"] else math.nan
        own_units = table.own_units or {}
        length = own_units.get("length") or readable_scale("length", "si", size[1])
        speed, degree = own_units.get("speed") or Scale(1.0, "m/s"), Scale(math.pi / 180, "°")
        mass = f"{total['particle_mass']:.4g} kg in all"
        if injected is not None:
            parcels = tally.parcels
            come = float(parcels.mass[np.isin(parcels.known, parcels.parcel)].sum()) or total["particle_mass"]
            mass += f" ({100 * come / injected:.3g} % of the sand injected{', each parcel once' * table.has_parcels})"
        mean = math.degrees(total["angle"] * of_particle)
        stated = f" by mass and diameter, {_range(*self._ends['stated'], Scale(1.0, 'kg/m³'))} as stated"
        densities = _range(*density, Scale(1.0, "kg/m³")) + stated * bool(self._contradicted)
        lines = [
            f"columns: {table.read_as or 'in SI units'}",
            f"rows: {self._rows:,}, of which {self._near:,} hit ({100 * self._near / max(1, self._rows):.3g} %)",
            f"particles: {total['particles']:,.6g}, {_range(*count, Scale(1.0, ''))} a row; {mass}",
            f"size: {_range(*size, length)}, {densities}",
            f"speed: {_range(*speeds, speed)}, mean {total['speed'] * of_particle / speed.size:.4g} {speed.unit}",
            f"angle to the wall: {_range(*angles, degree)}, mean {mean:.3g}°",
        ]
        if np.isfinite(self._box).all():
            lines.append(f"impacts lie in {box_in_words(*self._box)}")
        if surface is not None:
            unit = f", in {surface.unit} as given" if surface.mesh_face is None else ""
            lines.append(f"the surface lies in {box_in_words(*surface.box)}{unit}")
            turned = int(np.broadcast_to(surface.turned, surface.faces).sum())
            if turned:
                lines.append(
                    f"normals: {turned:,} of {surface.faces:,} faces turned, so that most particles come from the fluid"
                )
        return ["Read:", *(f"  {line}" for line in lines)]

    def findings(self, tally: FaceTally, surface: Surface | None) -> tuple[Finding, ...]:
        """What is doubtful in the rows: see the texts of the codes."""
        length = math.inf if surface is None else surface.length
        hit = float(np.linalg.norm(np.diff(self._struck_box, axis=0))) if tally.unnamed > 1 else math.inf
        least, greatest = self._ends["mass_ratio"]
        contradicted = {"rows": self._contradicted, "least": least, "greatest": greatest}
        is_one = self._most > self._all * max(_DOMINATES, 30 / max(1, tally.hits))
        return (
            *self._repeats.findings,
            *found(
                (self._weightless, Finding("rows_without_weight", numbers={"rows": self._weightless})),
                (self._contradicted, Finding("mass_contradicts_size", numbers=contradicted)),
                (
                    hit < _SPECK * length < math.inf,
                    Finding("impacts_on_a_speck", numbers={"impacts": hit, "surface": length}),
                ),
                (is_one, Finding(ONE_ROW, self._place, {"share": self._most / self._all if self._all else 0.0})),
            ),
        )

    def duration_of(self, table: Impacts, rows: int) -> tuple[float | None, str, tuple[Finding, ...]]:
        """The duration of a table [s], who says so, and findings on it."""
        first, last = self._ends["time"]
        span = last - first
        numbers = {"span": span, "rows": rows, "duration": table.duration}
        if table.duration is None and not 0 < span < math.inf:
            return None, "", ()
        if table.duration is None:
            return (
                span,
                "from the first impact to the last",
                found((rows < _FEW, Finding("duration_of_few_impacts", numbers=numbers))),
            )
        is_other = 0 < span < math.inf and table.duration_from == "as given" and not 0.99 < table.duration / span < 1.1
        return table.duration, table.duration_from, found((is_other, Finding("duration_differs", numbers=numbers)))


def _around(box: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The least box that holds a box and points of shape (n, 3)."""
    least, greatest = box
    return np.array([np.vstack([least, points]).min(axis=0), np.vstack([greatest, points]).max(axis=0)])


def _range(least: float, greatest: float, scale: Scale) -> str:
    """Such as "30 to 42 m/s", or "30 m/s"."""
    low, high = f"{least / scale.size:.4g}", f"{greatest / scale.size:.4g}"
    return f"{low if low == high else f'{low} to {high}'} {scale.unit}".replace(" °", "°").rstrip()
