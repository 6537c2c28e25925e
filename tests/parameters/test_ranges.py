import numpy as np
import pytest

from erosion.parameters.quantities import read_axis
from erosion.parameters.units import UnitError


@pytest.mark.parametrize(
    ("text", "dimension", "values"),
    [
        ("0deg : 90deg : 4", "angle", np.deg2rad([0, 30, 60, 90])),
        ("1 in/s : 100 in/s : 3 : log", "speed", [1, 10, 100]),
        ("20deg, 0.5", "angle", [np.deg2rad(20), 0.5]),
        (["1 ft", 3], "length", [12, 3]),
        ([1, 2.5], "1", [1, 2.5]),
    ],
)
def test_values_are_read(text, dimension, values):
    np.testing.assert_allclose(read_axis(text, dimension, "inch-pound"), values, rtol=1e-14)


def test_a_single_quantity_is_a_scalar():
    assert read_axis("20 deg", "angle", "si").shape == ()
    assert read_axis(2, "1", "si") == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1:2", 'must be "first : last : count"'),
        ("1:2:1", "count"),
        ("1:2:3:cubic", "count"),
        ("-1:2:3:log", "ends of one sign"),
        ("1 kg:2:3", "must be a speed"),
        ([], "is empty"),
        ([True], "must be numbers"),
        ([[1, 2]], "must be numbers"),
    ],
)
def test_what_makes_no_axis_is_refused(text, message):
    with pytest.raises(UnitError, match=message):
        read_axis(text, "speed", "si")
