"""Whatever is in a case file or a quantity: parameters, or one clear sentence; never a traceback."""

import tomllib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import erosion
from erosion.distributions import Distribution, read_distribution
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import read_axis, read_quantity
from tests.parameters.test_parameters import GOOD, case_text

pytestmark = pytest.mark.slow

# The same examples every time.
SAME = settings(derandomize=True, max_examples=150)

SYSTEMS = st.sampled_from(["si", "inch-pound"])
DIMENSIONS = st.sampled_from(sorted({quantity.dimension for quantity in QUANTITIES.values()}))
UNITS = st.sampled_from(["in", "m", "s", "kg", "slinch", "deg", "°", "rad", "Pa", "lbf", "rpm", "Hz", "%", "K", "µm"])
PARTS = st.one_of(
    UNITS, st.sampled_from([" ", "/", "*", "**", "^", "(", ")", "-", ".", ",", ":", "e9", "²", "nan", "inf", "\n"]),
    st.integers().map(str), st.floats().map(repr), st.text(max_size=3),
)  # fmt: skip
QUANTITY_TEXTS = st.one_of(st.text(max_size=12), st.lists(PARTS, max_size=7).map("".join))


def tried(refusal, call, *arguments):
    """What a call returns; or, where it refuses its arguments, None and what it says."""
    try:
        return call(*arguments), ""
    except refusal as error:
        return None, str(error)


def loaded(path, content: bytes) -> None:
    path.write_bytes(content)
    p, said = tried(erosion.CaseError, erosion.load_case, path)
    if p is None:
        assert said.startswith(f"{path}: ")
        assert said.endswith(".")
        assert "\n" not in said
        return
    erosion.validate(p)
    assert all(np.asarray(getattr(p, name)).dtype == np.float64 for name in QUANTITIES)


@SAME
@given(st.binary(max_size=200))
def test_bytes_are_no_case(tmp_path_factory, content):
    loaded(tmp_path_factory.mktemp("fuzz") / "case.toml", content)


@SAME
@given(st.integers(0, 400), st.integers(0, 40), st.binary(max_size=8))
def test_damaged_cases(tmp_path_factory, begin, length, instead):
    good = case_text().encode()
    begin %= len(good)
    loaded(tmp_path_factory.mktemp("fuzz") / "case.toml", good[:begin] + instead + good[begin + length :])


VALUES = st.one_of(
    QUANTITY_TEXTS, st.integers(), st.floats(), st.booleans(), st.dates().map(str), st.lists(st.integers(), max_size=2)
)


@SAME
@given(st.dictionaries(st.sampled_from([*GOOD, "title", "phidot0", "inertia", "sweep"]), VALUES, max_size=3))
def test_cases_of_other_values(tmp_path_factory, changes):
    content = case_text(**{name: toml(value) for name, value in changes.items()})
    try:
        tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        raise AssertionError(f"the test wrote bad TOML: {content!r}") from error
    loaded(tmp_path_factory.mktemp("fuzz") / "case.toml", content.encode())


def toml(value: object) -> str:
    if isinstance(value, str):
        plain = "".join(one if one.isprintable() and one not in '"\\' else f"\\U{ord(one):08x}" for one in value)
        return '"' + "".join(one for one in plain if not 0xD800 <= ord(one) < 0xE000) + '"'
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value)


@SAME
@given(QUANTITY_TEXTS, DIMENSIONS, SYSTEMS)
def test_any_text_is_a_quantity_an_axis_a_law_or_a_clause(text, dimension, system):
    for read, kind in ((read_quantity, float), (read_axis, np.ndarray), (_law, (Distribution, type(None)))):
        found, said = tried(ValueError, read, text, dimension, system)
        assert said.startswith("must ") if said else isinstance(found, kind)


def _law(text, dimension, system):
    return read_distribution(f"normal({text})", "v0", dimension, system)


@SAME
@given(st.text(max_size=20), QUANTITY_TEXTS)
def test_any_header_and_cell_is_a_table_or_a_sentence(tmp_path_factory, header, cell):
    path = tmp_path_factory.mktemp("fuzz") / "data.csv"
    path.write_text(f"angle [deg],erosion,{header}\n20,1,{cell}\n", encoding="utf-8", errors="ignore", newline="")
    found, said = tried(erosion.MeasurementError, erosion.read_measurements, path, "si")
    if found is None:
        assert said.startswith(str(path))
        assert "\n" not in said
    else:
        assert len(found) == 1
