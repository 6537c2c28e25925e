"""Tables, surfaces and options of which no map can be made: each gets its sentence, which names the row."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.cfd.erosion_map import erosion_map
from tests.cfd.tables import Table, hump, sand

P = erosion.TABLE_1.to("si")
SURFACE = hump()
GOOD = sand(SURFACE, 20)
AIMED = GOOD.replace(velocity=None, speed=np.full(20, 50.0), alpha=np.full(20, 0.4))


def with_number(table: Table, name: str, value: float, row: int = 4) -> Table:
    """The table with another number in its fifth row."""
    column = table.columns[name].astype(float)
    column[row] = value
    return table.replace(**{name: column})


def with_face(face: int) -> Table:
    faces = GOOD.columns["face"].copy()
    faces[4] = face
    return GOOD.replace(face=faces)


def receding_but_one() -> Table:
    """Rows that move away from the wall, and one that hits it but has the weight 0."""
    velocity, count = -GOOD.columns["velocity"][:2], np.array([0.0, 1.0])
    velocity[0] *= -1
    return GOOD.only(slice(2)).replace(velocity=velocity, count=count)


TABLES = {
    "no rows": (GOOD.only(slice(0)), "table: must hold impacts, but holds none."),
    "mass 0": (with_number(GOOD, "mass", 0.0), "row 5: `mass` must be positive and finite, but is 0.0."),
    "mass NaN": (with_number(GOOD, "mass", np.nan), "row 5: `mass` must be positive and finite, but is nan."),
    "diameter < 0": (with_number(GOOD, "diameter", -1e-4), "row 5: `diameter` must be positive and finite"),
    "count < 0": (with_number(GOOD, "count", -1.0), "row 5: `count` must be a number of at least 0, but is -1.0."),
    "count NaN": (with_number(GOOD, "count", np.nan), "row 5: `count` must be a number of at least 0, but is nan."),
    "no weights": (GOOD.replace(count=np.zeros(20)), "table: every row has the weight 0"),
    "no weight of a hit": (receding_but_one(), "table: every row that hits has the weight 0"),
    "velocity NaN": (with_number(GOOD, "velocity", np.nan), "row 5: `velocity` must be finite"),
    "spin infinite": (with_number(GOOD.replace(spin=np.zeros(20)), "spin", np.inf), "row 5: `spin` must be finite"),
    "speed < 0": (with_number(AIMED, "speed", -1.0), "row 5: `speed` must be a number of at least 0, but is -1.0."),
    "above 90°": (with_number(AIMED, "alpha", 1.7), "row 5: `alpha` must be in [0°, 90°], but is 97.4028°."),
    "below 0°": (with_number(AIMED, "alpha", -0.1), "row 5: `alpha` must be in [0°, 90°], but is -5.72958°."),
    "degrees": (with_number(AIMED, "alpha", 30.0), "(30 rad; was the column in degrees?)"),
    "no angle": (AIMED.replace(alpha=None), "table.csv: must give velocities, or speeds and angles of attack"),
    "no place": (GOOD.replace(face=None, position=None), "row 1 names no face of the surface and no position."),
    "some no place": (with_face(-1).replace(position=None), "row 5 names no face of the surface and no position."),
    "position NaN": (with_number(GOOD.replace(face=None), "position", np.nan), "row 5: `position` must be finite"),
    "another surface": (with_face(48), "row 5 names face 48, but hump has 48 faces, counted from 0."),
    "in mm": (GOOD.replace(face=None, position=1e3 * GOOD.columns["position"]), "The impacts lie in 8.333"),
    "after the rebound": (GOOD.replace(velocity=-GOOD.columns["velocity"]), "look like velocities after the rebound"),
    "all stuck": (GOOD.replace(velocity=0 * GOOD.columns["velocity"]), "of 20 rows none hits: 20 have no velocity"),
    "other patches": (
        Table(mesh_faces=True, **GOOD.columns),
        "of 20 rows none hits: 20 name a face that is not of this surface.",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", TABLES)
def test_a_table_that_cannot_be_used_is_refused(what: str) -> None:
    table, sentence = TABLES[what]
    with pytest.raises(ValueError, match=r"^(table(\.csv)?|hump): .*\.$") as raised:
        erosion_map("linearized", P, table, hump(mesh=table.mesh_faces))
    assert sentence in str(raised.value)


OPTIONS: dict[str, tuple[dict[str, Any], str]] = {
    "scaling": ({"scaling": "big"}, "Argument `scaling` must be one of similar, none, but is 'big'."),
    "diameter 0": ({"diameter": 0.0}, "Argument `diameter` must be positive and finite, but is 0.0."),
    "no size": ({"diameter": 1e-4, "scaling": "none"}, "Argument `diameter` must be left out where all particles"),
    "spin": ({"spin": "fast"}, "Argument `spin` must be column, case, none or a law such as normal(0, 1e4)"),
    "no spin": ({"spin": "column"}, "Argument `spin` must be a law, case or none, as the table has no column of it."),
    "seed": ({"spin": stats.norm(0.0, 1.0), "seed": -1}, "Argument `seed` must be a whole number of at least 0"),
    "e = 0": ({"restitution": (0.0, 0.1)}, "Argument `restitution` must be (e, μ) with e in (0, 1]"),
    "μ = 1": ({"restitution": (0.8, 1.0)}, "Argument `restitution` must be (e, μ) with e in (0, 1]"),
    "before": ({"restitution": (0.8, 0.1)}, "look like velocities before the rebound"),
    "density": ({"density": float("nan")}, "Argument `density` must be positive and finite, but is nan."),
    "limit": ({"limit": -1.0}, "Argument `limit` must be positive and finite, but is -1.0."),
    "rtol": ({"rtol": 2.0}, "Argument `rtol` must be in (0, 1), but is 2.0."),
}


CALLS: dict[str, tuple[dict[str, Any], str]] = {
    **{name: ({"surface": SURFACE, **options}, sentence) for name, (options, sentence) in OPTIONS.items()},
    "no surface": ({}, "gives velocities, so the angle of attack needs the normals of a surface"),
    "angles before a rebound": (
        {"impacts": AIMED, "surface": SURFACE, "restitution": (0.8, 0.1)},
        "of which no rebound can be undone: Argument `restitution` must be left out",
    ),
    "too far": (
        {
            "impacts": GOOD.replace(face=None, position=GOOD.columns["position"] + [0.0, 0.0, 0.1]),
            "surface": SURFACE,
            "limit": 1e-3,
        },
        "none hits: 20 lie farther from their face than the limit",
    ),
    "several impacts": ({"p": P.replace(k=[1.0, 2.0]), "surface": SURFACE}, "must be a scalar here"),
}


@pytest.mark.parametrize("what", CALLS)
def test_a_call_that_makes_no_sense_is_refused(what: str) -> None:
    options, sentence = CALLS[what]
    with pytest.raises(ValueError, match=r"\.$") as raised:
        erosion_map("linearized", **{"p": P, "impacts": GOOD, **options})
    assert sentence in str(raised.value)
