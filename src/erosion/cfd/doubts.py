"""What is doubtful in the rows of a table: in its columns, and in what hits; noted while they are read."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy import spatial

from erosion.cfd.incidence import HIT, Hits
from erosion.cfd.rows import POSITION, VELOCITY, Columns, ImpactBlock, Impacts
from erosion.cfd.surface import Surface
from erosion.cfd.tally import FaceTally
from erosion.parameters.materials import HEAVIEST
from erosion.parameters.quantities import Scale, readable_scale
from erosion.results import Finding, stated
from erosion.tables import Column

ONE_ROW = "one_row_wears"
"""The code of the finding that one of many rows does much of the wear."""

_FEW = 100  # impacts at random times, of which the first and the last are 2 % of the time off its ends, on average
_GROWTH = 2.6  # of the wear with speed, as of metals in DNVGL-RP-O501 (2015), table 3-1
_DOMINATES = 0.05  # share of the wear from which on one of many rows is named, if it has 30 times the mean, too
_FINEST, _COARSEST = 1e-6, 5e-3  # diameters of grains [m]
_SLOWEST, _FASTEST = 0.5, 300.0  # mean speeds at which sand wears [m/s]
_MORE, _THOUSANDS = 10, 1000  # rows from which velocities along an axis and radians, and ones without signs, are named
_ALIKE = 1.02  # ratio of speeds of the same rows
_SAME = 1.1  # ratio of densities of one solid
_LIQUID = 1010.0  # kg/m³; the lightest grain of the package's table, walnut shell, has 1200
_DISTINCT = 100  # rows of whole numbers of particles, of which hardly ever no two are the same
_COMPARED = 1_000_000  # rows at most among which those that repeat others are looked for
_REPEATED = 0.01  # share of rows above which they are said
_NEIGHBOURS, _ASKED = 200_000, 2000  # rows that are compared with their neighbours at most, and those that are asked
_TWIN = 0.1  # of the distance to the next neighbour; a tenth of random rows on a line are as near to another one
_TWINS = 0.3  # share of the rows above which such twins are said
_JOURNEYS = 30  # from one shallow hit to the next, from which on they are compared with speeds
# The straightest ways over those by the speeds at both ends: less and more in hardly any flow, and where all are alike.
_WAYS, _EVEN_WAYS, _EVEN = (0.5, 2.5), (0.58, 1.7), 1.25
_STEEP = 45.0  # mean angle from which on it may be measured from the normal, and hits send grains far up [°]
_LARGEST, _IN_GRAINS = 100.0, 20.0  # sizes of a surface that no part has [m], and over the diameter of grains

# Wear grows as speed^2.6 and as the mass of a grain; depths as volumes over areas.
_GRANTED = (
    " All this is taken for granted: speeds in ft/s, mph or km/h that are taken for m/s make the wear about 22, 8 or "
    "28 × too great, knots 6 ×, radii for diameters, without masses, 8 × too little, lost rows in proportion, inches "
    "or cm for mm, in table and surface, depths 645 or 100 × too great."
)


class Repeats:
    """Rows that repeat others of the table, also in other digits or another order, as of a file that is in it twice."""

    def __init__(self) -> None:
        # Of equal rows all are kept or none, so that tables of any length can be compared.
        self._rows, self._stride, self._digests = 0, 1, np.zeros(0, np.uint64)
        self._held, self._axis, self._end = np.zeros((0, 0)), 0, math.inf  # rows up to the end on an axis

    def add(self, columns: Columns) -> None:
        """Take note of some rows."""
        rows = len(columns[POSITION[0]])
        digest = np.zeros(rows, np.uint64)
        for values in columns.values():
            # To single precision, as another file of the same rows may have them.
            with np.errstate(over="ignore"):
                bits = np.asarray(values, np.float32).view(np.uint32)
            digest = (digest ^ bits) * np.uint64(0x9E3779B97F4A7C15)
            digest ^= digest >> np.uint64(32)
        self._digests = np.append(self._digests, digest[digest % np.uint64(self._stride) == 0])
        while len(self._digests) > _COMPARED:
            self._stride *= 2
            self._digests = self._digests[self._digests % np.uint64(self._stride) == 0]
        # Other files may number parcels anew.
        names = [name for name in columns if name not in ("parcel", "origin")]
        table = np.array([columns[name] for name in names], float)
        self._rows += rows
        self._hold(table[:, np.isfinite(table).all(axis=0)], names)  # what is not finite is refused after this

    def _hold(self, table: np.ndarray, names: Sequence[str]) -> None:
        """Hold rows of the part of the space that has not too many of them."""
        if not table.size:
            return
        if not self._held.size:
            self._held = table[:, :0]
            self._axis = max(map(names.index, POSITION), key=lambda axis: np.ptp(table[axis]))
        self._held = np.append(self._held, table[:, table[self._axis] <= self._end], axis=1)
        while self._held.shape[1] > _NEIGHBOURS:
            places = self._held[self._axis]
            self._end = float(np.median(places)) if np.median(places) < places.max() else -math.inf
            self._held = self._held[:, places <= self._end]

    def _twins(self) -> float:
        """The share of rows that have others far nearer to them than all else is."""
        if self._held.shape[1] < _FEW:
            return 0.0
        spread = self._held.std(axis=1)
        points = (self._held[spread > 0] / spread[spread > 0, None]).T
        some = points[:: max(1, len(points) // _ASKED)]
        distance = spatial.KDTree(points).query(some, k=5)[0][:, 1:]
        return float((distance[:, :-1] < _TWIN * distance[:, 1:]).any(axis=1).mean())

    def in_words(self) -> Iterator[str]:
        """Sentences."""
        compared = len(self._digests)
        again = "is a part of the run in the table twice, or does the injection repeat itself?"
        repeated = int((np.diff(np.sort(self._digests)) == 0).sum())  # `np.unique` of a million takes 20 times as long
        if repeated > _REPEATED * compared:
            share, some = repeated / compared, "about " * (self._stride > 1)
            yield (
                f"{some}{share * self._rows:,.0f} of {self._rows:,} rows repeat another one, number for number; {again}"
            )
        elif (share := self._twins()) > _TWINS:
            yield f"about {100 * share:.0f} % of the rows are nearly another one, with other digits; {again}"


class Journeys:
    """How far parcels come from one hit to the next, beside what their speeds and times say."""

    def __init__(self) -> None:
        self._held, self._stride = np.zeros((7, 0)), 1  # parcel, time, position, speed and angle

    def add(self, block: ImpactBlock, hits: Hits) -> None:
        """Take note of the rows of a block; of a parcel all are kept or none."""
        if block.time is None or block.parcel is None or block.position is None:
            return
        angle = np.where(hits.fate == HIT, hits.alpha, np.inf)
        rows = np.array([hits.parcel, np.asarray(block.time), *hits.position.T, hits.speed, angle], float)
        self._held = np.append(self._held, self._of_some(rows), axis=1)
        while self._held.shape[1] > _NEIGHBOURS and self._stride < _COMPARED:
            self._stride *= 2
            self._held = self._of_some(self._held)

    def _of_some(self, rows: np.ndarray) -> np.ndarray:
        """The rows of one of `stride` parcels, by digests of their numbers, which may have a pattern."""
        digest = (np.ascontiguousarray(rows[0]).view(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(32)
        return rows[:, digest % np.uint64(self._stride) == 0]

    def in_words(self) -> Iterator[str]:
        """A sentence where no flow explains the distances."""
        parcel, time, *position, speed, angle = self._held[:, np.lexsort((self._held[1], self._held[0]))]
        # After a steep hit a grain comes back to the same place, slowly.
        is_shallow = angle[:-1] < math.radians(_STEEP)
        after = np.flatnonzero((np.diff(parcel) == 0) & (np.diff(time) > 0) & is_shallow)
        if len(after) < _JOURNEYS:
            return
        way = (speed[:-1] + speed[1:]) / 2 * np.diff(time)
        ratio = (np.linalg.norm(np.diff(position), axis=0) / np.maximum(way, 1e-300))[after]
        middle, most = np.quantile(ratio, [0.5, 0.95]).tolist()
        # Ways that are alike are straight, and the flow hardly changes speeds on them.
        least, greatest = _EVEN_WAYS if most < _EVEN * middle else _WAYS
        if not least < most < greatest:
            cyclic = " Or does the domain repeat itself?" * (most <= least)
            yield (
                f"From one hit to the next parcels come up to {most:.2g} × as far as their speeds and times say; are "
                f"the units of speed, position and time right, and the numbers those of parcels?{cyclic}"
            )


class Noted:
    """What is doubtful in the numbers of a table, noted while its rows are read."""

    def __init__(self, columns: Mapping[str, Column], beside: Column | None = None) -> None:
        self._columns, self._beside, self._speeds = columns, beside, 1.0
        self._density = math.inf, 0.0  # the least and the greatest [kg/m³]
        self._contradictions, self._steepest, self._numbered = 0, 0.0, False
        self._rows, self._particles, self._repeats = 0, 0.0, Repeats()

    def add_rows(self, columns: Columns) -> None:
        """Note what rows have in their columns."""
        if not self._rows:
            count = columns.get("count", np.zeros(0))
            # Large counts of six digits are whole numbers, too, but multiples of ten.
            whole = len(count) >= _DISTINCT and (np.floor(count) == count).all() and (count % 10 != 0).any()
            self._numbered = bool(whole and len(np.unique(count)) == len(count))
        self._steepest = max(self._steepest, float(columns.get("angle", np.zeros(1)).max(initial=0.0)))
        if POSITION[0] in columns:
            self._repeats.add(columns)
        self._rows += len(next(iter(columns.values())))

    def add_speeds(self, columns: Columns, speeds: np.ndarray) -> None:
        """Note speeds that the table has beside velocities."""
        own = np.linalg.norm([columns[axis] for axis in VELOCITY], axis=0)
        both = (own > 0) & np.isfinite(speeds)
        self._speeds = float(np.median(speeds[both] / own[both])) if both.any() else 1.0

    def add_sizes(self, block: ImpactBlock, own: np.ndarray) -> None:
        """Note particles, and their `own` densities where the table has them."""
        self._particles += float(np.asarray(block.count).sum())
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            density = block.mass / (math.pi / 6 * block.diameter**3)
            if len(own):
                self._contradictions += int((np.abs(np.log(density / own)) > math.log(_SAME)).sum())
        (low, high), known = self._density, density[np.isfinite(density) & (density > 0)]
        self._density = float(known.min(initial=low)), float(known.max(initial=high))

    def doubts(self, expected: float | None) -> Iterator[str]:
        """Sentences; `expected` is the density of the particle that the user names [kg/m³]."""
        low, high = self._density
        between = f"{low:.4g} kg/m³" if high < _SAME * low else f"{low:.4g} to {high:.4g} kg/m³"
        has = f"its particles have a density of {between},"
        if high > HEAVIEST:
            yield (
                f"{has} more than any solid; if a mass is that of all particles of a row, its column must be named "
                "`parcel_mass`."
            )
        elif expected is not None and (low * _SAME < expected or high > _SAME * expected):
            yield f"{has} which counts, but the particle that is named has {expected:g} kg/m³."
        elif low < _LIQUID:
            yield f"{has} which a fluid has, but hardly a grain; is it the fluid's?"
        elif high > _SAME * low:
            yield f"{has} so they are of several solids, or a column is none of theirs."
        if self._contradictions:
            yield f"in {self._contradictions:,} rows the density is not that of mass and diameter, which count."
        if self._numbered:
            yield (
                f"column {self._columns['count'].heading!r} has another whole number in each row; are these numbers of "
                "particles, or of rows?"
            )
        if (parcel := self._columns.get("parcel_mass")) and 0 < self._particles < self._rows:
            yield (
                f"column {parcel.heading!r} makes {self._particles:.3g} particles of {self._rows:,} rows, so most are "
                "less than one particle; are its unit and the diameter right?"
            )
        angle = self._columns.get("angle")
        if (
            angle is not None
            and angle.factor < 1
            and self._rows >= _MORE
            and self._steepest <= math.pi / 2 * angle.factor
        ):
            yield f"no angle is above {math.degrees(self._steepest):.3g}°; are they in radians?"
        if self._beside is not None and not 1 / _ALIKE < self._speeds < _ALIKE:
            yield (
                f"column {self._beside.heading!r} is {self._speeds:.3g} × the speed by the components of the velocity, "
                "which count; are the units of both right?"
            )
        if self._rows + 1 in (2**16, 2**20):
            yield f"it has {self._rows + 1:,} lines, as many as a sheet of Excel holds; did the table have more?"
        yield from self._repeats.in_words()


class Ranges:
    """The least and the greatest numbers of the rows read so far: times of all rows, the rest of those that hit."""

    def __init__(self) -> None:
        self._ends = dict.fromkeys(("time", "diameter", "density", "speed", "alpha"), (math.inf, -math.inf))
        self._most, self._place, self._all = 0.0, "", 0.0  # mass × speed^2.6 of a row, the row, and of all
        self._weightless, self._has_angles = 0, False
        self._journeys = Journeys()
        self._velocity, self._are_same = np.array([[math.inf], [-math.inf]]) * np.ones(3), True  # least, greatest

    def add(self, block: ImpactBlock, hits: Hits) -> None:
        """Take note of the rows of a block."""
        self._journeys.add(block, hits)
        struck, time = hits.fate == HIT, np.zeros(0) if block.time is None else np.asarray(block.time)
        rows = {"time": time, **{name: getattr(hits, name)[struck] for name in ("diameter", "speed", "alpha")}}
        with np.errstate(divide="ignore", over="ignore"):
            rows["density"] = hits.mass[struck] / (math.pi / 6 * rows["diameter"] ** 3)
        wear = np.where(struck, hits.count * hits.mass * hits.speed**_GROWTH, 0.0)
        self._all += float(wear.sum())
        self._has_angles |= block.alpha is not None
        if block.velocity is not None and block.rows:
            velocity = np.asarray(block.velocity, float)
            least, greatest = self._velocity
            self._velocity = np.array([np.minimum(least, velocity.min(0)), np.maximum(greatest, velocity.max(0))])
            self._are_same &= bool((velocity == velocity[:, :1]).all())
        self._weightless += int((struck & (hits.count == 0)).sum())
        if wear.max(initial=0.0) > self._most:
            row = int(wear.argmax())
            self._most, self._place = float(wear[row]), f"Row {block.first + row + 1:,} of {Path(block.source).name}"
        for name, (least, greatest) in self._ends.items():
            self._ends[name] = float(rows[name].min(initial=least)), float(rows[name].max(initial=greatest))

    def in_words(
        self, table: Impacts, tally: FaceTally, surface: Surface | None, injected: float | None
    ) -> tuple[str, list[Finding]]:
        """How the table was understood, in its own units, and what no sand has of it.

        Args:
            table: the table.
            tally: the sums of its rows.
            surface: of the map.
            injected: the mass of all sand [kg], where the user or the case says it.
        """
        names = "diameter", "density", "speed", "alpha"
        (fine, coarse), (light, dense), (slow, fast), (flat, steep) = (self._ends[name] for name in names)
        total = {name: math.fsum(values) for name, values in tally.sums.items()}
        of_particle = 1 / total["particles"] if total["particles"] else math.nan
        speed, angle = total["speed"] * of_particle, math.degrees(total["angle"] * of_particle)
        own_units = table.own_units or {}
        length = own_units.get("length") or readable_scale("length", "si", coarse)
        velocity, density = own_units.get("speed") or Scale(1.0, "m/s"), _range(light, dense, Scale(1.0, "kg/m³"))
        mass = f"{total['erodent']:.4g} kg in all"
        if injected is not None:
            parcels = tally.parcels
            come = float(parcels.mass[np.isin(parcels.known, parcels.parcel)].sum()) or total["erodent"]
            mass += f" ({100 * come / injected:.3g} % of the sand injected{', each parcel once' * table.has_parcels})"
        read_as = (
            f"Read: {tally.rows:,} rows, {table.read_as or 'in SI units'}. What hits is {total['particles']:,.6g} "
            f"particles of {_range(fine, coarse, length)} and {density}, {mass}, at "
            f"{_range(slow, fast, velocity)}, on average {speed / velocity.size:.4g} {velocity.unit}, and at "
            f"{_range(flat, steep, Scale(math.pi / 180, '°'))} to the wall, on average {angle:.3g}°."
        )
        doubts, found = [*self._of_velocities(tally.rows), *self._journeys.in_words()], list[Finding]()
        if surface is not None:
            across, unit = surface.length, f"in {surface.unit} as given" if surface.unit else "taken in metres"
            read_as += f" The surface{f', {unit},' * (surface.mesh_face is None)} is {across:.3g} m across."
            if across > _LARGEST or across < _IN_GRAINS * coarse:
                doubts.append(
                    f"The surface is {across:.3g} m across, {across / coarse:.3g} diameters of a grain; are both units "
                    "right?"
                )
        if table.own_units is not None:  # OpenFOAM and Fluent always write the same units
            read_as += _GRANTED
        if self._has_angles and angle > _STEEP:
            doubts.append(
                f"The mean angle is {angle:.3g}° from the wall. If the table measures from the normal, it is "
                f"{90 - angle:.3g}°, and all angles must be taken from 90°."
            )
        if self._weightless:
            doubts.append(f"{self._weightless:,} rows that hit have the weight 0, and count for nothing.")
        if self._most > self._all * max(_DOMINATES, 30 / tally.hits):
            found.append(Finding(ONE_ROW, self._place, {"share": self._most / self._all}))
        if fine < _FINEST or coarse > _COARSEST:
            doubts.append(
                f"Particles have diameters of {fine:.3g} to {coarse:.3g} m, as no sand has; is the unit right?"
            )
        if not _SLOWEST <= speed <= _FASTEST:
            doubts.append(
                f"The mean speed is {speed:.3g} m/s, at which no sand is blasted or carried; is the unit right?"
            )
        return read_as, [*map(stated, doubts), *found]

    def _of_velocities(self, rows: int) -> list[str]:
        """That velocities may be speeds, or without their signs."""
        least, greatest = self._velocity
        if rows <= _MORE or not np.isfinite(least).all():
            return []
        if self._are_same:
            said = "the three components of each velocity are the same number"
        elif (least >= 0).all() and (greatest == 0).sum() == 2:
            said = "two of the three components of the velocity are 0 in all rows"
        # Streams oblique to all axes have no component near 0.
        elif rows >= _THOUSANDS and (least >= 0).all() and (least < 0.01 * greatest).sum() >= 2:
            said = f"none of the velocities of {rows:,} rows has a negative component"
        else:
            return []
        return [f"{said[0].upper()}{said[1:]}; are these magnitudes, as speeds are?"]

    def duration_of(self, table: Impacts, rows: int) -> tuple[float | None, str, list[str]]:
        """The duration of a table [s], who says so, and what is doubtful in it."""
        first, last = self._ends["time"]
        span = last - first
        doubts = list[str]()
        if table.duration is None and not 0 < span < math.inf:
            return None, "", []
        if table.duration is None:
            if rows < _FEW:
                doubts.append(
                    f"The time from the first to the last of {rows} impacts, {span:.3g} s, is less than that of "
                    "the run: Argument `duration` gives it."
                )
            return span, "from the first impact to the last", doubts
        if 0 < span < math.inf and table.duration_from == "as given" and not 0.99 < table.duration / span < 1.1:
            doubts.append(f"`duration` is {table.duration:g} s, but the impacts are from {span:g} s.")
        return table.duration, table.duration_from, doubts


def _range(least: float, greatest: float, scale: Scale) -> str:
    """Such as "30 to 42 m/s", or "30 m/s"."""
    low, high = f"{least / scale.size:.4g}", f"{greatest / scale.size:.4g}"
    return f"{low if low == high else f'{low} to {high}'} {scale.unit}".replace(" °", "°")
