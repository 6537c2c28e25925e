"""Sums over millions of rows: as exact as one row's number."""

import dataclasses
import math

import numpy as np
import pytest

from erosion.cfd.incidence import LEFT_OUT, Hits
from erosion.cfd.tally import FaceTally, portion_of


def hits(rows: int, face: np.ndarray, **changes: np.ndarray) -> Hits:
    columns = {field.name: np.ones(rows) for field in dataclasses.fields(Hits)}
    zeros = np.zeros(rows, np.int64)
    others = {"fate": zeros, "patch": zeros, "face": face, "distance": np.full(rows, np.nan), "named": zeros > 0}
    return Hits(**{**columns, **others, **changes})


def test_many_equal_rows_of_one_face_lose_no_digit() -> None:
    # One after the other, a tenth added ten million times is off by 1e-10.
    tally, portion = FaceTally(1), 2**16
    struck = hits(portion, np.zeros(portion, np.int64))
    zeros = np.zeros(portion, np.int64)
    part = portion_of(struck, struck, np.full((1, portion), 0.1), zeros[None], zeros > 0, 1, 1)
    for _ in range(160):
        tally.add(part)
    assert tally.sums["volume"][0] == pytest.approx(math.fsum([0.1] * 160 * portion), rel=1e-15)
    assert tally.sums["impacts"][0] == tally.rows == 160 * portion


def test_a_small_portion_after_a_large_one_is_not_lost() -> None:
    tally, none = FaceTally(1), np.zeros(1, np.int64)
    one = hits(1, none)
    for volume in (1.0, 1e-20, 1e-20, -1.0):
        tally.add(portion_of(one, one, np.array([[volume]]), none[None], none > 0, 1, 1))
    assert tally.sums["volume"][0] == 2e-20


def test_rows_without_a_volume_count_in_no_sum() -> None:
    tally, face = FaceTally(3), np.array([2, 0, 2])
    rows = hits(3, face)
    tally.add(portion_of(rows, rows, np.array([[1.0, np.nan, 2.0]]), np.array([[0, 1, 0]]), face > 5, 1, 2))
    assert list(tally.sums["impacts"]) == [0, 0, 2]
    assert list(tally.sums["volume"]) == [0.0, 0.0, 3.0]
    assert tally.counts["ends"].tolist() == [[2, 1]]


def test_the_median_of_distances_is_that_of_the_rows() -> None:
    distance = np.random.default_rng(0).lognormal(-8, 1.5, 10001)
    rows, zeros = hits(10001, np.zeros(10001, np.int64), distance=distance), np.zeros(10001, np.int64)
    tally = FaceTally(1)
    tally.add(portion_of(rows, rows, np.ones((1, 10001)), zeros[None], zeros > 0, 1, 1))
    assert tally.median_distance == pytest.approx(np.median(distance), rel=6e-3)
    assert tally.farthest == distance.max()
    assert tally.unnamed == 10001
    assert len(tally.counts["fates"]) == 1 + len(LEFT_OUT)
