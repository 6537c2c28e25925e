"""Tables of impacts in memory, and a curved surface, for tests of maps."""

import dataclasses
import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr

from erosion.cfd.map_result import MapSummary
from erosion.cfd.rows import ImpactBlock, Impacts
from erosion.cfd.surface import Surface

_COLUMNS = [field.name for field in dataclasses.fields(ImpactBlock)][2:]


class Table(Impacts):
    """Rows in memory; `block` is the most that a block has, whatever is asked for."""

    def __init__(self, duration: float | None = None, mesh_faces: bool = False, block: int = 10**9, **columns: Any):
        self.columns: dict[str, Any] = {name: np.asarray(values) for name, values in columns.items()}
        self.title, self.duration, self.mesh_faces, self.block = "table", duration, mesh_faces, block
        self.rows = len(self.columns["count"])

    def blocks(self, rows: int) -> Iterator[ImpactBlock]:
        step = min(rows, self.block)
        for first in range(0, self.rows or 0, step):
            yield ImpactBlock("table.csv", first, **{n: v[first : first + step] for n, v in self.columns.items()})

    def identity(self) -> str:
        return hashlib.sha256(b"".join(v.tobytes() for v in self.columns.values())).hexdigest()

    def only(self, rows: Any) -> "Table":
        """A table of some of the rows."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return Table(self.duration, self.mesh_faces, self.block, **columns)

    def replace(self, **columns: Any) -> "Table":
        """A table with other columns; None takes one away."""
        changed = {name: v for name, v in {**self.columns, **columns}.items() if v is not None}
        return Table(self.duration, self.mesh_faces, self.block, **changed)


def quadrilaterals(points: np.ndarray, *, closed: bool = False, first: int = 0, **fields: Any) -> Surface:
    """The faces of a grid of points, shape (along, across, 3), whose last column is beside the first if closed."""
    numbers = np.arange(points[..., 0].size).reshape(points.shape[:2])
    numbers = np.concatenate([numbers, numbers[:, :1]], axis=1) if closed else numbers
    cuts = (slice(None, -1), slice(None, -1)), (slice(None, -1), slice(1, None)), (slice(1, None), slice(1, None))
    corners = np.stack([numbers[cut] for cut in (*cuts, (slice(1, None), slice(None, -1)))], axis=-1).reshape(-1, 4)
    corners, faces = np.roll(corners, -first, axis=1), len(corners)
    described = {"title": "part", "patches": ("wall",), "patch": np.zeros(faces, np.int64), **fields}
    return Surface(points=points.reshape(-1, 3), corners=corners.ravel(), ends=4 * np.arange(1, faces + 1), **described)


def hump(along: int = 12, across: int = 4, *, mesh: bool = False) -> Surface:
    """A sinusoidal floor of quadrilaterals below a fluid, normals down; two patches."""
    x, y = np.meshgrid(np.linspace(0, 0.2, along + 1), np.linspace(0, 0.05, across + 1), indexing="ij")
    faces = np.arange(along * across)
    return quadrilaterals(
        np.stack([x, y, 0.02 * np.sin(np.pi * x / 0.2) ** 2], axis=-1),
        title="hump",
        patches=("front", "back"),
        patch=(faces >= len(faces) // 2).astype(np.int64),
        mesh_face=1000 + faces if mesh else None,
    )


def sand(surface: Surface, rows: int = 2000, seed: int = 0, **changes: Any) -> Table:
    """Impacts at random faces, angles, speeds and sizes of quartz."""
    rng = np.random.default_rng(seed)
    face = rng.integers(0, surface.faces, rows)
    normal, diameter = surface.normal[face], rng.uniform(1e-4, 5e-4, rows)
    along = np.cross(normal, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along, axis=1)[:, None]
    alpha, speed = rng.uniform(0.05, 1.4, rows), rng.uniform(20.0, 80.0, rows)
    velocity = speed[:, None] * (np.sin(alpha)[:, None] * normal + np.cos(alpha)[:, None] * along)
    columns = {"count": rng.uniform(10.0, 1000.0, rows), "mass": 2650 * np.pi / 6 * diameter**3, "diameter": diameter,
               "velocity": velocity, "face": face, "position": surface.centre[face]}  # fmt: skip
    return Table(**{"duration": 2.0, **columns, **changes})


def warnings_of(wear: xr.Dataset) -> list[str]:
    """What a map warns of, but its amount, which no test finds as the case is a scenario's, and its few rows a face."""
    usual = "far from what tests", "lies above the true one by chance"
    return [said for said in MapSummary(wear).warnings if not any(words in said for words in usual)]
