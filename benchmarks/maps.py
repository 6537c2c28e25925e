"""How many impacts a second a map computes, beside `erosion.impact` on the same lanes, and the memory that it takes."""

import resource
import sys
import time
from collections.abc import Iterator

import numpy as np

import erosion
from benchmarks.page import Table
from benchmarks.timing import by_turns
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.rows import ImpactBlock, Impacts
from erosion.cfd.surface import Surface
from tests.cfd.tables import hump

TITLE = "Maps"
TEXT = """Two million impacts on 40,000 faces, block by block, on all cores. The memory does not grow with the rows."""

P = erosion.TABLE_1.to("si")


class Rain(Impacts):
    """Synthetic impacts, and the time that it took to make them."""

    title, duration, mesh_faces = "rain", 1.0, False

    def __init__(self, rows: int, surface: Surface) -> None:
        self.rows = self.count = rows
        self.surface, self.normal, self.seconds = surface, surface.normal, 0.0

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        """Random rows, the same each time."""
        for number, first in enumerate(range(0, self.count, rows)):
            begin = time.perf_counter()
            block = self._block(number, first, min(rows, self.count - first))
            self.seconds += time.perf_counter() - begin
            yield block

    def _block(self, number: int, first: int, rows: int) -> ImpactBlock:
        rng = np.random.default_rng([0, number])
        face, diameter = rng.integers(0, self.surface.faces, rows), rng.uniform(1e-4, 5e-4, rows)
        speed, alpha = rng.uniform(20.0, 120.0, rows), rng.uniform(0.05, 1.4, rows)
        normal = self.normal[face]
        along = np.stack([normal[:, 2], np.zeros(rows), -normal[:, 0]], axis=1)
        along /= np.linalg.norm(along, axis=1)[:, None]
        velocity = speed[:, None] * (np.sin(alpha)[:, None] * normal + np.cos(alpha)[:, None] * along)
        return ImpactBlock("rain", first, np.full(rows, 10.0), 2650 * np.pi / 6 * diameter**3, diameter,
                           velocity=velocity, face=face)  # fmt: skip

    def identity(self) -> str:
        """The number of rows, on which the others depend."""
        return str(self.rows)


def lanes(rain: Rain) -> Iterator[erosion.Parameters]:
    """The same impacts as the map's, without the map."""
    for block in rain.blocks(2**18):
        assert block.velocity is not None
        speed = np.linalg.norm(block.velocity, axis=1)
        alpha = np.arcsin(np.sum(block.velocity * rain.normal[block.face], axis=1) / speed)
        growth = np.cbrt(block.mass / float(P.m))
        yield P.replace(r=P.r * growth, b=P.b * growth, m=block.mass, v0=speed, alpha=alpha)


def measure(quick: bool) -> Table:
    """The map by turns with its impacts alone."""
    rows = 10**5 if quick else 2 * 10**6
    rain = Rain(rows, hump(400, 100))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    def whole() -> float:
        rain.seconds, begin = 0.0, time.perf_counter()
        erosion_map("rotating", P, rain, rain.surface)
        return time.perf_counter() - begin - rain.seconds

    def alone() -> float:
        seconds = 0.0
        for p in lanes(rain):
            begin = time.perf_counter()
            erosion.impact("rotating", p)
            seconds += time.perf_counter() - begin
        return seconds

    alone()
    times = by_turns({"map": whole, "impacts alone": alone}, 2 if quick else 3)
    # Linux counts kilobytes, macOS bytes.
    more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    memory = more / (2**20 if sys.platform == "darwin" else 2**10)
    cells = [[name, rows / each.median, each.ratio] for name, each in times.items()]
    return Table(
        ["", "rows a second", "time over the map's", "peak memory added, MiB"], [[*cells[0], memory], [*cells[1], None]]
    )
