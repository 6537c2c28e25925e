"""What checks of arguments give; their messages are in `bad_input/test_calls.py`."""

import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import erosion
from erosion.arguments import check_path, check_tolerance, check_whole


@pytest.mark.parametrize("given", [0.5, np.float32(0.5), 1e-300, 1 - 1e-16])
def test_a_tolerance_is_a_float(given) -> None:
    assert type(check_tolerance(given)) is float
    assert check_tolerance(given) == given


@pytest.mark.parametrize("given", [0, 1, -0.1, True, np.nan, np.inf, "0.1", None, np.array([0.1])])
def test_what_is_no_tolerance_is_refused(given) -> None:
    with pytest.raises(ValueError, match=r"^Argument `rtol` must be in \(0, 1\), but is .*\.$"):
        check_tolerance(given)


def test_a_whole_number_is_an_int() -> None:
    assert type(check_whole("n", np.int64(3), 3)) is int
    assert check_whole("n", -1, -2) == -1


@pytest.mark.parametrize("given", [0, 3.0, True, "3", None, np.float64(4)])
def test_what_is_no_whole_number_or_too_small_is_refused(given) -> None:
    with pytest.raises(ValueError, match=r"^Argument `n` must be a whole number of at least 1, but is .*\.$"):
        check_whole("n", given, 1)


def test_a_path_is_a_path() -> None:
    assert check_path("store", "a/b.nc") == Path("a/b.nc")
    # Outside of the tests nothing checks types before.
    check = inspect.unwrap(check_path)
    with pytest.raises(TypeError, match=r"^Argument `store` must be a path, but is 3\.$"):
        check("store", 3)
    with pytest.raises(ValueError, match="holds a zero byte"):
        check_path("store", "a\0b")


def test_a_message_shows_a_long_value_briefly_and_on_one_line():
    given: Any = np.arange(2000.0)
    with pytest.raises(TypeError) as caught:
        erosion.volume("finnie", given)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200
    whole = re.compile(r"\b(is|has|makes|offers|gives) \{[a-z_.]+!r\}")
    sources = [path for path in Path(erosion.__file__).parent.rglob("*.py") if path.parent.name != "lanes"]
    assert [path.name for path in sources if whole.search(path.read_text("utf-8"))] == []
