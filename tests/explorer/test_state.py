"""The state of a tab, its link, and what slider positions mean."""

from urllib.parse import parse_qsl

import numpy as np
import pytest

from erosion.explorer.sliders import at_position, position, range_of, text_of, unit_of, with_spin
from erosion.explorer.state import Case, State
from erosion.parameters import QUANTITIES, TABLE_1

KNOWN = ("linearized", "finnie", "rotating")
CASE = Case.of(TABLE_1)
STATE = State(CASE, ("linearized", "rotating"), "rotating")


def read(query: str, state: State = STATE) -> State:
    return state.reading(dict(parse_qsl(query)), KNOWN)


@pytest.mark.parametrize("units", ["inch-pound", "si"])
def test_a_link_is_exact(units: str) -> None:
    case = CASE.to(units).replace(alpha=1 / 3, v0=np.pi)
    state = State(case, ("finnie",), "finnie", instant=1 / 3, dark=True)
    assert read(state.query()) == state
    assert read(State(case, ("finnie",), "finnie", dark=False).query(), state).dark is False


def test_a_link_may_say_little_and_use_units() -> None:
    found = read("alpha=30+deg&v0=100+m/s&models=rotating,linearized")
    assert found.case.numbers()["alpha"] == np.deg2rad(30)
    assert found.case.numbers()["v0"] == pytest.approx(100 / 0.0254)
    assert found.case.numbers()["k"] == 2
    assert found.models == ("linearized", "rotating")  # in the order of the page
    assert read("units=si").case == CASE.to("si")


@pytest.mark.parametrize(
    ("query", "why"),
    [
        ("alpha=95+deg", r"Field `alpha` must be in \(0, π/2\]"),
        ("speed=3", "Field `speed` is unknown"),
        ("units=cgs", "must be one of 'inch-pound', 'si'"),
        ("models=plug-in.py", "'plug-in.py', which is not one of the models here"),
        ("instant=2", r"Field `instant` must be in \[0, 1\]"),
        ("instant=soon", r"Field `instant` must be in \[0, 1\]"),
        ("dark=yes", "Field `dark` must be 'true' or 'false'"),
        ("models=finnie&shown=rotating", "Field `shown` must be one of the models"),
    ],
)
def test_a_bad_link_is_one_sentence(query: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read(query)


def test_unchecking_the_model_drawn_draws_another() -> None:
    assert STATE.checking(("linearized",)).shown == "linearized"
    assert STATE.checking(KNOWN).shown == "rotating"


def test_entries_are_read_with_units_and_bare_angles_are_degrees() -> None:
    assert CASE.read("alpha", "30").numbers()["alpha"] == np.deg2rad(30)
    assert CASE.read("alpha", "0.5 rad").numbers()["alpha"] == 0.5
    assert CASE.read("sigma", "1 GPa").numbers()["sigma"] == pytest.approx(145037.7, rel=1e-6)
    with pytest.raises(ValueError, match="Field `k` must be a pure number"):
        CASE.read("k", "1 m")


@pytest.mark.parametrize("units", ["inch-pound", "si"])
@pytest.mark.parametrize("name", list(QUANTITIES))
def test_sliders_go_where_they_are_put(name: str, units: str) -> None:
    first = CASE.to(units)
    ends = range_of(name)
    for at in (ends.low, 0.4 * ends.high, ends.high):
        case = at_position(name, at, first, first)
        # A slider sets numbers of four digits.
        assert position(name, case, first) == pytest.approx(at, rel=1e-3, abs=1e-3)
    beyond = first.replace(**{name: 1.5 if name == "alpha" else 1e12})
    assert position(name, beyond, first) <= ends.high


def test_the_middle_of_a_slider_is_the_first_value_exactly() -> None:
    first = CASE.to("si")
    assert at_position("m", 0.0, first.replace(m=1.0), first) == first


def test_spin_follows_speed_and_size() -> None:
    spun = with_spin(-0.25, CASE)
    assert spun.numbers()["phidot0"] == -27500
    assert position("phidot0", spun.replace(v0=8800.0), CASE) == pytest.approx(-0.125)


def test_texts_are_short_and_angles_in_degrees() -> None:
    assert (text_of("alpha", CASE), unit_of("alpha", CASE)) == ("20", "°")
    assert (text_of("m", CASE), unit_of("m", CASE)) == ("2.855e-7", "slinch")
    assert (text_of("sigma", CASE.replace(sigma=2e9)), unit_of("k", CASE)) == ("2e9", "")
