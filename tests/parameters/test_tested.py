"""The ranges of a fit's tests: kept by a case file, and compared with a question."""

import tomllib

import numpy as np
import pytest

from erosion.parameters.case_files import Tested as Ranges

RANGES = {"v0": (60.0, 90.0), "alpha": (np.pi / 12, np.pi / 2)}


def test_ranges_are_read_back_and_say_by_how_much_a_question_lies_outside():
    tested = Ranges.read(tomllib.loads(f"tested = {Ranges(RANGES).dump()}")["tested"])
    for name, ends in RANGES.items():
        assert tested.ranges[name] == pytest.approx(ends, rel=1e-8)
    assert tested.outside({"v0": 90.0, "alpha": np.pi / 2, "m": 1.0}) == []
    assert tested.outside({"v0": np.array([30.0, 120.0])}) == [
        "120 m/s is 1.33 × the fastest test.",
        "30 m/s is 0.5 × the slowest test.",
    ]


@pytest.mark.parametrize("table", [3, {"v0": 60}, {"v0": [60, 90]}, {"v0": ["1 kg", "2 kg"]}, {"k": ["1 m", "2 m"]},
                                   {"v0": ["90 m/s", "60 m/s"]}, {"v0": ["60 m/s"]}])  # fmt: skip
def test_other_tables_are_refused(table):
    with pytest.raises(ValueError, match=r"^must "):
        Ranges.read(table)
