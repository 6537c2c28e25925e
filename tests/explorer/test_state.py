"""The state of a tab, its link, and what slider positions mean.

The particles and targets that the page offers.
"""

import re
from pathlib import Path
from urllib.parse import parse_qsl

import numpy as np
import pytest

from erosion.explorer.controls import (
    at_position,
    entry_of,
    position,
    range_of,
    read_materials,
    with_spin,
)
from erosion.explorer.state import OwnNumber, PageCase, PageState
from erosion.parameters.materials import known_particles, known_targets, target
from erosion.parameters.parameters import QUANTITIES, TABLE_1
from erosion.parameters.per_mass import PerMass
from erosion.parameters.quantities import Quantity, System
from tests.documents import Written

KNOWN = ("linearized", "finnie", "rotating")
CASE = PageCase.of(TABLE_1)
STATE = PageState(CASE, ("linearized", "rotating"), "rotating")


FRICTION = OwnNumber("tip", "friction", 0.2, Quantity("μ", "coefficient of friction", "1"))
REACH = OwnNumber("lip", "reach", 0.0005, Quantity("L", "depth", "length"))
SHIFT = OwnNumber("lip", "shift", -0.5, Quantity("shift", "own parameter of the model", "1"))
PLUGGED = PageState(PageCase.of(TABLE_1, (FRICTION, REACH, SHIFT)), ("rotating", "tip", "lip"), "tip")


def read(query: str, state: PageState = STATE) -> PageState:
    return state.reading(dict(parse_qsl(query)), KNOWN)


@pytest.mark.parametrize("units", ["inch-pound", "si"])
def test_a_link_is_exact(units: str) -> None:
    case = CASE.to(units).replace(alpha=1 / 3, v0=np.pi)
    state = PageState(case, ("finnie",), "finnie", instant=1 / 3, predict=True)
    assert read(state.query()) == state
    assert read(PageState(case, ("finnie",), "finnie").query(), state).predict is False


def test_a_link_holds_what_erosion_per_mass_needs() -> None:
    state = read("density=2.7+g/cm^3&cutting_fraction=0.5")
    assert state.per_mass == PerMass(2700.0, 0.5)
    assert read(state.query()) == state
    assert read(STATE.query(), STATE).per_mass == PerMass()


def test_a_metal_has_its_density_and_its_stress() -> None:
    copper = target("copper")
    state = STATE.of_metal(copper)
    assert state.per_mass.density == copper.density
    assert state.case.numbers()["sigma"] == TABLE_1.with_target(copper).sigma
    # 10⁴ lbf/in²; ψ is 2 · 52 kgf/mm² over it.
    assert state.changes(STATE) == "ψ = 14.7923, σ = 10000 lbf/in², density = 8940 kg/m³"
    assert state.changes(state) == ""


def test_a_link_may_say_little_and_use_units() -> None:
    state = read("alpha=30+deg&v0=100+m/s&models=rotating,linearized")
    assert state.case.numbers()["alpha"] == np.deg2rad(30)
    assert state.case.numbers()["v0"] == 100
    assert state.case.numbers()["k"] == 2
    assert state.models == ("linearized", "rotating")  # in the order of the page
    assert read("units=si").case == CASE.to("si")


@pytest.mark.parametrize(
    ("query", "why"),
    [
        ("alpha=95+deg", r"Field `alpha` must be in \(0, 90°\], but is 95°"),
        ("speed=3", "Field `speed` is unknown"),
        ("units=cgs", "must be one of 'inch-pound', 'si'"),
        ("models=plug-in.py", "'plug-in.py', but the page offers no such model"),
        ("density=2700", 'Field `density` must be a density with its unit, such as "2.7 g/cm.3"'),
        ("density=-1+kg/m^3", "Argument `density` must be positive"),
        ("cutting_fraction=half", "Field `cutting_fraction` must be a number, but is 'half'"),
        ("cutting_fraction=2", "Argument `cutting_fraction` must be above 0 and at most 1"),
        ("instant=2", r"Field `instant` must be in \[0, 1\]"),
        ("instant=soon", r"Field `instant` must be in \[0, 1\]"),
        ("predict=yes", "Field `predict` must be 'true' or 'false'"),
        ("models=finnie&shown=rotating", "Field `shown` must be one of the models"),
    ],
)
def test_a_bad_link_is_one_sentence(query: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read(query)


@pytest.mark.parametrize("units", ["inch-pound", "si"])
def test_a_link_has_the_own_parameters_of_checked_models(units: str) -> None:
    case = PLUGGED.case.to(units).replace(**{"tip.friction": 1 / 3, "lip.reach": 1 / 7})
    state = PageState(case, ("rotating", "tip", "lip"), "lip")
    known = ("rotating", "tip", "lip")
    assert PLUGGED.reading(dict(parse_qsl(state.query())), known) == state
    # On a page without the plug-in, its parameters would be unknown.
    assert "lip." not in state.checking(("rotating", "tip")).query()
    assert STATE.reading(dict(parse_qsl(state.checking(("rotating",)).query())), KNOWN).case.own == ()


def test_own_parameters_are_read_with_units() -> None:
    state = PLUGGED.reading({"units": "si", "lip.reach": "1 mm", "tip.friction": "0.5"}, ("rotating", "tip", "lip"))
    numbers = state.case.numbers()
    assert (numbers["lip.reach"], numbers["tip.friction"], numbers["lip.shift"]) == (0.001, 0.5, -0.5)
    inches = PLUGGED.reading({"units": "inch-pound", "lip.reach": "0.02"}, ("rotating", "tip", "lip"))
    assert inches.case.numbers()["lip.reach"] == pytest.approx(0.02 * 0.0254)
    assert entry_of("lip.reach", state.case, state.case) == ("1", "mm")


def test_sliders_of_own_parameters_reach_a_factor_or_a_size_about_the_first() -> None:
    first = PLUGGED.case
    ends = [at_position("tip.friction", at, first, first).numbers()["tip.friction"] for at in (-1.0, 0.0, 1.0)]
    assert ends == [0.01, 0.2, 4.0]
    ends = [at_position("lip.shift", at, first, first).numbers()["lip.shift"] for at in (-1.0, 0.0, 1.0)]
    assert ends == [-1.0, -0.5, 0.0]
    resting = first.replace(**{"tip.friction": 0.0})
    ends = [at_position("tip.friction", at, first, resting).numbers()["tip.friction"] for at in (-1.0, 0.5)]
    assert ends == [-1.0, 0.5]
    for name in ("tip.friction", "lip.reach", "lip.shift"):
        for at in (-1.0, -0.4, 0.0, 1.0):
            assert position(name, at_position(name, at, first, first), first) == pytest.approx(at, abs=1e-3)
    # A value of 0 moves by the case's parameter of its dimension, and not below its least value.
    limit = OwnNumber("lip", "limit", 0.0, Quantity("v_th", "speed", "speed"), least=0.0)
    case = PageCase.of(TABLE_1, (limit,))
    limits = [at_position("lip.limit", at, case, case).numbers()["lip.limit"] for at in (-1.0, 0.0, 0.5)]
    assert limits == pytest.approx([0, 0, 55.88])
    assert position("lip.limit", case.replace(**{"lip.limit": 55.88}), case) == pytest.approx(0.5)
    with pytest.raises(ValueError, match=r"Field `lip\.limit` must be at least 0 m/s, but is -0\.0254 m/s\."):
        limit.read("-1", "inch-pound")
    # A number that was typed may lie where the slider does not reach.
    assert position("tip.friction", first.replace(**{"tip.friction": -1.0}), first) == -1


def test_presets_leave_own_parameters() -> None:
    case = PLUGGED.case.replace(**{"tip.friction": 0.7})
    metal = case.with_parameters(case.parameters().with_target("copper"))
    copper = target("copper")
    assert metal == case.replace(sigma=copper.flow_stress, psi=copper.psi)
    assert with_spin(0.1, case).own == case.own
    assert case.of_model("lip").own == (REACH, SHIFT)
    assert case.own_values("tip") == {"friction": 0.7}


def test_entries_are_read_with_units_and_bare_angles_are_degrees() -> None:
    assert CASE.read("alpha", "30", CASE).numbers()["alpha"] == np.deg2rad(30)
    assert CASE.read("alpha", "0.5 rad", CASE).numbers()["alpha"] == 0.5
    assert CASE.read("sigma", "1 GPa", CASE).numbers()["sigma"] == 1e9


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("k", "1 m", "Field `k` must be a pure number"),
        ("lip.reach", "3 s", "Field `lip.reach` must be a length such as"),
        ("tip.friction", "nan", "Field `tip.friction` must be a finite number, but is nan"),
        # A comma that may group thousands.
        ("v0", "1,000", "must be written as 1.000 or 1000, as 1,000 may mean either."),
        ("v0", "-12,345 m/s", "must be written as -12.345 m/s or -12345 m/s, as -12,345 m/s may mean either."),
        *(("k", text, "cannot be read") for text in ("1,000,000", "1,5,5", "1.5,5", "1,5.5")),
        *(
            ("alpha", text, f"Field `alpha` must be in degrees, above 0 and up to 90, but is {text.replace(',', '.')}")
            for text in ("200", "0", "-5", "90,5")
        ),
    ],
)
def test_an_entry_that_makes_no_sense_is_refused(name: str, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        PLUGGED.case.read(name, text, PLUGGED.case)


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


def test_spin_follows_speed_and_size() -> None:
    spun = with_spin(-0.25, CASE)
    assert spun.numbers()["phidot0"] == pytest.approx(-27500)
    assert position("phidot0", spun.replace(v0=223.52), CASE) == pytest.approx(-0.125)


@pytest.mark.parametrize(
    ("text", "value"), [("0,5", 0.5), ("3,25", 3.25), (",5", 0.5), ("1,5e1", 15.0), ("0,125", 0.125), ("12,0000", 12.0)]
)
def test_entries_may_have_decimal_commas(text: str, value: float) -> None:
    assert CASE.read("k", text, CASE).numbers()["k"] == value
    assert CASE.read("alpha", text, CASE).numbers()["alpha"] == np.deg2rad(value)
    assert CASE.read("v0", f"{text} m/s", CASE).to("si").numbers()["v0"] == pytest.approx(value)


def test_si_fields_have_readable_units_and_bare_numbers_are_in_them() -> None:
    case = CASE.to("si").replace(r=9e-5, m=1.28e-8, sigma=255.1e6)
    shown = {name: entry_of(name, case, case) for name in ("r", "m", "sigma", "v0", "k")}
    assert shown == {
        "r": ("90", "µm"), "m": ("12.8", "µg"), "sigma": ("255.1", "MPa"), "v0": ("111.76", "m/s"), "k": ("2", ""),
    }  # fmt: skip
    numbers = case.read("r", "70", case).read("m", "1e1", case).read("sigma", "3 GPa", case).numbers()
    assert (numbers["r"], numbers["m"], numbers["sigma"]) == (7e-5, 1e-8, 3e9)


@pytest.mark.parametrize(
    "name", ["a,b", "100%", "a%2Cb", "quo\"te's", "new\nline", "<img src=x onerror=alert(1)>", "ü"]
)
def test_a_plug_in_may_have_any_name(name: str) -> None:
    own = OwnNumber(name, "friction", 0.2, Quantity("μ", "coefficient of friction", "1"))
    state = PageState(PageCase.of(TABLE_1, (own,)).replace(**{own.key: 0.7}), ("rotating", name), name)
    first = PageState(PageCase.of(TABLE_1, (own,)), ("rotating",), "rotating")
    assert first.reading(dict(parse_qsl(state.query())), ("rotating", name, "a")) == state


def test_own_angles_are_in_degrees_too() -> None:
    rake = OwnNumber("tip", "rake", np.deg2rad(10), Quantity("γ", "rake angle", "angle"))
    case = PageCase.of(TABLE_1, (rake,))
    assert entry_of("tip.rake", case, case) == ("10", "°")
    assert case.read("tip.rake", "-30", case).numbers()["tip.rake"] == np.deg2rad(-30)
    assert case.read("tip.rake", "0.1 rad", case).numbers()["tip.rake"] == 0.1


def test_own_tables_come_before_the_packages(tmp_path: Path, written: Written) -> None:
    table = written(
        "mine.toml",
        '[particles.slag]\ndensity = 2800\n[targets."my alloy"]\nvickers = 180\n[targets.brass]\nvickers = 99\n',
    )
    materials = read_materials([table])
    assert list(materials.particles) == ["slag", *known_particles()]
    assert list(materials.targets) == ["my alloy", "brass", *(name for name in known_targets() if name != "brass")]
    assert materials.targets["brass"].vickers == 99.0
    with pytest.raises(ValueError, match=r"none\.toml: cannot be read"):
        read_materials([tmp_path / "none.toml"])


@pytest.mark.parametrize(
    ("size", "units", "metres"), [("0.3 mm", "si", 3e-4), ("0,3 mm", "si", 3e-4), ("0.01", "inch-pound", 2.54e-4)]
)
def test_a_size_is_read_in_the_units_of_the_case(size: str, units: System, metres: float) -> None:
    garnet = read_materials().sized("garnet", size, units)
    assert (garnet.size, garnet.density) == (pytest.approx(metres, rel=1e-15), 4190.0)
