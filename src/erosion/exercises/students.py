"""One case a student, drawn by the name: the same name and seed give the same case."""

import csv
import dataclasses
import hashlib
import io
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import Progress
from erosion.exercises.answer_key import AnswerKey
from erosion.exercises.course import best_angle
from erosion.output import briefly, readable, to_csv
from erosion.parameters import QUANTITIES, Dimension, Parameters, unit_name

# With β from 0.4 to 0.5 the turning grain's best angle is a maximum within 90° of turn; at half the k the limit binds.
_K = (2.05, 2.4)  # above 2, where arctan(2/k) is arctan(k/2)
_RATIO = (0.31, 0.325)  # r √(c/m) / v₀; Table 1 has 0.304
_SHARES = {"psi": (0.7, 1.3), "sigma": (0.6, 1.15)}  # of the case's
_POWERS = {"v0": -1, "sigma": 2, "psi": 2}  # with which each of them follows the ratio
# Of the linearized model's best angle: it is below the cusp for any k, and the turning grain's is at 74 to 82 % of it.
_ALPHA = (0.45, 0.68)
_NOT_IN_A_FILES_NAME = set('/\\:*?"<>|')


def drawn_case(p: Parameters, name: str, *, seed: int = 0, kept: Collection[str] = ()) -> Parameters:
    """A case with other k, ψ, σ, v₀ and α, in which every task has an answer and each kind of cut occurs.

    α is below the angle from which on the tip can stop. The turning grain turns by less than 90° there and at its best
    angle, and by more than 90° at the best one for half the k.

    Args:
        p: the case around which it is drawn, with an inertia of 0.4 to 0.5.
        name: of the student.
        seed: another one gives another case to each name.
        kept: parameters that stay as they are; the turns are sure only if k, α and one of v₀, σ and ψ are not kept.
    """
    digest = hashlib.sha256(f"{seed} {name}".encode()).digest()
    rng = np.random.default_rng(int.from_bytes(digest))
    ratio, part = rng.uniform(*_RATIO), rng.uniform(*_ALPHA)
    drawn = {"k": rng.uniform(*_K)}
    drawn |= {q: float(getattr(p, q)) * rng.uniform(*share) for q, share in _SHARES.items()}
    rounded: dict[str, Any] = {q: _rounded(value, 3) for q, value in drawn.items() if q not in kept}
    p = dataclasses.replace(p, **rounded)
    change = ratio * float(p.v0) / (float(p.r) * math.sqrt(float(p.stiffness / p.m)))
    follows = next((q for q in _POWERS if q not in kept), None)
    if follows:
        rounded[follows] = _rounded(float(getattr(p, follows)) * change ** _POWERS[follows], 3)
    if "alpha" not in kept:
        rounded["alpha"] = math.radians(_rounded(part * math.degrees(best_angle(p)), 2))
    return dataclasses.replace(p, **rounded)


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")


def read_students(path: Path) -> list[str]:
    """The names of a table with the column `id` or `name`; of both, those of `id`.

    Raises:
        ValueError: one sentence, where the table cannot be read or has neither, and for a name that is missing, double
            or no part of a file's name.
    """
    with readable(path):
        text = path.read_text("utf-8-sig")
    heading = text.partition("\n")[0]
    rows = csv.DictReader(io.StringIO(text), delimiter=";" if ";" in heading and "," not in heading else ",")
    columns = [column for column in ("id", "name") if column in (rows.fieldnames or ())]
    if not columns:
        raise ValueError(f"{path}: must have a column `id` or `name`, but has {briefly(heading)}.")
    names: list[str] = []
    for row in rows:
        name = (row[columns[0]] or "").strip()
        if not name or not name.isprintable() or not _NOT_IN_A_FILES_NAME.isdisjoint(name):
            about = f"{path}, line {rows.line_num}: the `{columns[0]}`"
            raise ValueError(f"{about} must be a part of a file's name, but is {briefly(name)}.")
        if name.casefold() in map(str.casefold, names):
            raise ValueError(f"{path}, line {rows.line_num}: {name} is there twice; name the students apart.")
        names.append(name)
    if not names:
        raise ValueError(f"{path}: has no student.")
    return names


def answers_table(keys: Mapping[str, AnswerKey], *, progress: Progress | None = None) -> str:
    """The case and all answers of each student as CSV, angles in radians, in SI."""
    (first, *_) = keys.values()
    parameters: dict[str, Dimension] = {name: quantity.dimension for name, quantity in QUANTITIES.items()}
    tasks: dict[str, Dimension] = {name: task.dimension for name, task in first.tasks.items()}
    rows = []
    for done, key in enumerate(keys.values()):
        if progress is not None:
            progress("solving the tasks", done, len(keys))
        rows.append([*(float(getattr(key.p, name)) for name in parameters), *map(key.answer, tasks)])
    units = (unit_name(dimension, "si") for dimension in (*parameters.values(), *tasks.values()))
    headings = (f"{name} [{unit}]" if unit else name for name, unit in zip((*parameters, *tasks), units, strict=True))
    return to_csv({"student": [*keys], **dict(zip(headings, zip(*rows, strict=True), strict=True))})
