"""Sums over millions of rows: as exact as one row's number."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from erosion.cfd.incidence import LEFT_OUT, Hits
from erosion.cfd.tally import FaceTally, portion_of


def tally_of(volume: np.ndarray, face: np.ndarray, *, times: int = 1, faces: int = 1, **changes: Any) -> FaceTally:
    """The sums of portions with these volumes of rows, one portion a line, all of them so many times."""
    tally, rows = FaceTally(faces), len(face)
    columns: dict[str, Any] = {field.name: np.ones(rows) for field in dataclasses.fields(Hits)}
    zeros = np.zeros(rows, np.int64)
    others = {"fate": zeros, "patch": zeros, "face": face, "distance": np.full(rows, np.nan), "named": zeros > 0}
    hits = Hits(**{**columns, **others, **changes})
    for _ in range(times):
        for line in volume:
            outcome = np.isnan(line)[None].astype(np.int64)
            tally.add(portion_of(hits, hits, line[None], outcome, zeros > 0, 1, 2))
    return tally


def test_many_equal_rows_of_one_face_lose_no_digit() -> None:
    # One after the other, a tenth added ten million times is off by 1e-10.
    rows = 2**16
    tally = tally_of(np.full((1, rows), 0.1), np.zeros(rows, np.int64), times=160)
    assert tally.sums["volume"][0] == pytest.approx(math.fsum([0.1] * 160 * rows), rel=1e-15)
    assert tally.sums["impacts"][0] == tally.rows == 160 * rows


def test_a_small_portion_after_a_large_one_is_not_lost() -> None:
    tally = tally_of(np.array([[1.0], [1e-20], [1e-20], [-1.0]]), np.zeros(1, np.int64))
    assert tally.sums["volume"][0] == 2e-20


def test_rows_without_a_volume_count_in_no_sum() -> None:
    tally = tally_of(np.array([[1.0, np.nan, 2.0]]), np.array([2, 0, 2]), faces=3)
    assert list(tally.sums["impacts"]) == [0, 0, 2]
    assert list(tally.sums["volume"]) == [0.0, 0.0, 3.0]
    assert tally.counts["ends"].tolist() == [[2, 1]]


def test_the_median_of_distances_is_that_of_the_rows() -> None:
    distance = np.random.default_rng(0).lognormal(-8, 1.5, 10001)
    tally = tally_of(np.ones((1, 10001)), np.zeros(10001, np.int64), distance=distance)
    assert tally.median_distance == pytest.approx(np.median(distance), rel=6e-3)
    assert (tally.farthest, tally.unnamed) == (distance.max(), 10001)
    assert len(tally.counts["fates"]) == 1 + len(LEFT_OUT)
