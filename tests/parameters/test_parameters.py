"""The ranges of a fit's tests: kept by a case file, and compared with a question."""

import dataclasses
import math
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import erosion
from erosion.models.correlated import per_mass_of
from erosion.parameters.case_files import CaseFile, Tested as Ranges, with_paths
from erosion.parameters.per_mass import far_from_tests
from erosion.parameters.quantities import QUANTITIES, read_quantity
from erosion.results import render
from tests.reference import relative_volume

P = erosion.TABLE_1
INCH, SLINCH = 0.0254, 175.126835246  # m, kg
CASES = Path(__file__).parents[2] / "examples"


def test_table_1_and_its_derived_numbers():
    # docs/physics.md: ω = √(kc/m) and V*.
    assert float(P.rate) == pytest.approx(47346, rel=1e-5)
    assert float(P.volume_scale) == pytest.approx(6.9091e-4 * INCH**3, rel=1e-5)
    assert float(P.moment_of_inertia) == pytest.approx(0.5 * 2.855e-7 * SLINCH * (0.04 * INCH) ** 2)
    assert {metal: round(v / 6894757.293168, 9) for metal, v in erosion.MATERIALS.items()} == {
        "mild steel": 37, "brass": 27, "copper": 10, "stainless steel": 75, "titanium": 136,
    }  # fmt: skip


def test_leaves_are_float64_whatever_comes_in():
    p = erosion.Parameters(k=2, psi=0.04, r=np.float32(0.5), b=0.04, m=1e-7, v0=[1, 2], sigma=2e5, alpha=np.array(0.3))
    assert {np.asarray(leaf).dtype for leaf in jax.tree.leaves(p)} == {np.dtype("float64")}
    assert p.v0.shape == (2,)
    assert (p.phidot0, p.inertia, p.shown_in) == (0.0, 0.5, "si")


def test_numbers_are_in_si_and_another_unit_system_shows_them():
    si = P.to("si")
    # 1 slinch = 175.126835246 kg, 1 in = 0.0254 m, 1 lbf/in² = 6894.757293 Pa.
    assert float(si.m) == pytest.approx(2.855e-7 * 175.126835246, rel=1e-11)
    assert float(si.v0) == pytest.approx(111.76, rel=1e-15)
    assert float(si.sigma) == pytest.approx(200e3 * 6894.757293168, rel=1e-12)
    assert float(si.r) == pytest.approx(0.04 * 0.0254, rel=1e-15)
    assert si.shown_in == "si"
    assert all(getattr(si, name) == getattr(P, name) for name in QUANTITIES)
    assert (P.to_dict()["v0"], si.to_dict()["v0"]) == (4400, float(si.v0))
    assert [row[2:4] for row in P.rows()][5] == ("4400", "in/s")
    copper = P.with_target("copper")
    assert (copper.shown_in, float(copper.sigma)) == ("inch-pound", pytest.approx(10e3 * 6894.757293168, rel=1e-12))


@pytest.mark.parametrize(
    ("text", "speeds"),
    [
        ("2200 in/s", 55.88),
        ("100 m/s", 100.0),
        (["2200 in/s", "100 m/s"], [55.88, 100.0]),
        ("50 m/s : 100 m/s : 2", [50.0, 100.0]),
    ],
)
def test_texts_with_units_change_a_case(text, speeds):
    np.testing.assert_allclose(P.replace(v0=text).v0, speeds, rtol=1e-15)


@pytest.mark.parametrize("name", ["r", "b", "m", "v0", "sigma"])
@pytest.mark.parametrize("value", [2.0, np.array([1.0, 2.0]), [1.0, 2.0]])
def test_a_bare_number_needs_a_case_in_si(name, value):
    with pytest.raises(ValueError, match=rf'Argument `{name}` must have a unit.* give .*{name}="'):
        P.replace(**{name: value})
    np.testing.assert_array_equal(getattr(P.to("si").replace(**{name: value}), name), value)


def test_what_jax_traces_needs_a_case_in_si_too():
    with pytest.raises(ValueError, match="Argument `v0` must have a unit"):
        jax.jit(lambda v0: P.replace(v0=v0).rate)(1.0)


REFUSED = [
    *(
        (lambda bad=bad: P.replace(k=bad), TypeError, r"Argument `k` must (be a number|hold real numbers)")
        for bad in (None, True, 1j)
    ),
    (lambda: P.replace(beta=1.0), TypeError, "`beta` is not a parameter"),
    (lambda: P.replace(shown_in="si"), TypeError, r'use `p.to\("si"\)`'),
    (
        lambda: erosion.Parameters(*(1.0,) * 8, units="inch-pound"),  # pyrefly: ignore
        TypeError,
        r'numbers in SI.* `Parameters.from_quantities\("inch-pound", {...}\)`',
    ),
    (lambda: erosion.Parameters(*(1.0,) * 10, "inch-pound"), TypeError, "give `shown_in=`"),
    (lambda: erosion.TABLE_1.replace(sigma=217342.55), ValueError, 'give sigma="217342.55 lbf/in'),
    (lambda: erosion.TABLE_1.replace(v0=np.int64(4400)), ValueError, 'give v0="4400 in/s"'),
    (
        lambda: erosion.Parameters(*(1.0,) * 8, shown_in="cgs"),
        ValueError,
        "`shown_in` must be one of 'inch-pound', 'si'",
    ),
    (
        lambda: erosion.validate(P.replace(v0="-3 in/s")),
        ValueError,
        r"`v0` must be positive and finite, but is -3 in/s\.",
    ),
    (lambda: P.to("cgs"), ValueError, "`units` must be one of 'inch-pound', 'si', but is 'cgs'"),
    (
        lambda: erosion.dump_case(P.replace(alpha=[0.1, 0.2])),
        ValueError,
        r"`alpha` must be a scalar here, but has shape \(2,\)",
    ),
    *(
        (lambda changes=changes: erosion.validate(P.to("si").replace(**changes)), ValueError, message)
        for changes, message in [
            ({"alpha": 0.0}, r"`alpha` must be in \(0, 90°\], but is 0°\."),
            ({"alpha": 20.0}, r'is 1145.92° \(20 rad; degrees are written "20 deg"\)'),
            ({"alpha": [0.1, 2.0]}, r'is 114.592° \(2 rad; degrees are written "2 deg"\) at index 1'),
            ({"alpha": np.full((2, 2), -1.0)}, r"is -57.2958° at index \(0, 0\)"),
            ({"k": 0.0}, "`k` must be positive and finite, but is 0"),
            ({"sigma": np.inf}, "`sigma` must be positive and finite, but is inf"),
            ({"phidot0": np.nan}, "`phidot0` must be a finite number, but is nan"),
            ({"alpha": [0.1, 0.2], "k": [1.0, 2.0, 3.0]}, r"must broadcast .* k \(3,\), alpha \(2,\)"),
        ]
    ),
    *(
        (lambda name=name, value=value: erosion.PerMass(**{name: value}), ValueError, f"Argument `{name}` must be")
        for name, value in [("density", 0.0), ("density", -1.0), ("cutting_fraction", 0.0), ("cutting_fraction", 1.1)]
    ),
]


@pytest.mark.parametrize(("call", "error", "message"), REFUSED)
def test_what_makes_no_case_is_refused(call, error, message):
    with pytest.raises(error, match=message):
        call()


@pytest.mark.parametrize("alpha", [np.pi / 2, read_quantity("90 deg", "angle", "si")])
def test_validate_lets_right_angles_through(alpha):
    erosion.validate(P.replace(alpha=alpha))


def test_parameters_pass_through_jax():
    doubled = jax.jit(lambda p: p.replace(k=2 * p.k))(P)
    assert float(doubled.k) == 4.0
    assert np.shape(jax.vmap(lambda a: P.replace(alpha=a).rate)(np.ones(3))) == (3,)


def test_case_files_are_table_1():
    for case in ("table-1.toml", "table-1-si.toml"):
        p = erosion.load_case(CASES / case)
        for name in QUANTITIES:
            assert float(getattr(p, name)) == pytest.approx(float(getattr(P, name)), rel=1e-14), name


GOOD = {
    "units": '"inch-pound"', "k": "2", "psi": "0.04", "r": '"0.04 in"', "b": '"0.04 in"', "m": '"2.855e-7 slinch"',
    "v0": '"4400 in/s"', "sigma": '"200e3 lbf/in^2"', "alpha": '"20 deg"',
}  # fmt: skip


def case_text(**changes):
    lines = {**GOOD, **changes}
    return "\n".join(f"{name} = {value}" for name, value in lines.items() if value is not None)


@pytest.mark.parametrize(
    ("units", "system", "encoding"), [(None, "si", "utf-8"), ('"inch-pound"', "inch-pound", "utf-8-sig")]
)
def test_a_case_without_units_is_si_and_a_byte_order_mark_does_no_harm(tmp_path, units, system, encoding):
    (tmp_path / "case.toml").write_text(case_text(units=units), encoding=encoding)
    p = erosion.load_case(tmp_path / "case.toml")
    assert (p.shown_in, float(p.v0)) == (system, pytest.approx(111.76))


positive = st.floats(1e-12, 1e12)


# How long an example takes depends on what else the machine does.
@settings(deadline=None)
@given(
    st.sampled_from(["si", "inch-pound"]),
    st.fixed_dictionaries({n: positive for n in QUANTITIES if n not in ("alpha", "phidot0")}),
    st.floats(1e-9, math.pi / 2),
    st.floats(-1e9, 1e9),
)
def test_cases_survive_a_round_trip(tmp_path_factory, units, numbers, alpha, phidot0):
    p = erosion.Parameters(**numbers, alpha=alpha, phidot0=phidot0, shown_in=units)
    file = tmp_path_factory.mktemp("case") / "case.toml"
    file.write_text(erosion.dump_case(p, title='a "title"\n'), encoding="utf-8")
    again = erosion.load_case(file)
    assert again.shown_in == p.shown_in
    assert all(getattr(again, n) == getattr(p, n) for n in QUANTITIES)


def test_repr_is_short_and_reads_back():
    from erosion import Parameters

    assert repr(P).startswith("Parameters(k=2, psi=0.04, r=0.001016, b=0.001016, m=4.99987")
    again = eval(repr(P), {"Parameters": Parameters})
    assert again.shown_in == "inch-pound"
    assert all(getattr(again, name) == getattr(P, name) for name in QUANTITIES)
    assert "alpha=<[1000] 0.1 … 1>," in repr(P.replace(alpha=np.linspace(0.1, 1, 1000)))
    shown = []
    jax.jit(lambda p: shown.append(repr(p)) or p.k)(P)
    assert "k=<traced[]>" in shown[0]


def test_the_table_of_quantities_loads_without_jax_and_is_the_fields():
    code = "import sys, erosion.parameters.quantities; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0
    fields = {field.name: field.metadata.get("quantity") for field in dataclasses.fields(P)}
    assert fields == {**QUANTITIES, "shown_in": None}


def test_text_that_is_no_path_stays():
    table = {
        "title": "of plug.py", "k": "normal(2, 0.1)", "model": "linearized,a.py", "n": 3, "target": "copper",
        "uncertain": {"k": " samples( in (1).csv ) "}, "set": {"x": ["a.csv", 2]}, "warning": "see draws.nc",
    }  # fmt: skip
    assert with_paths(table, lambda path: f"f/{path}") == table | {
        "model": "linearized,f/a.py", "uncertain": {"k": " samples( f/in (1).csv ) "}, "set": {"x": ["f/a.csv", 2]},
    }  # fmt: skip


GARNET = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061").replace(v0=100.0)


def test_the_linearized_cut_per_mass_of_abrasive():
    # V* = m v²/(σψ): the mass of the particle cancels.
    alpha, sigma = np.deg2rad(20), 107 * 9.80665e6
    expected = 1e4 / (sigma * 2) * relative_volume("linearized", alpha, 2.0)
    p = GARNET.replace(alpha=alpha)
    volume = erosion.impact("linearized", p).volume
    assert erosion.PerMass().specific_volume(volume, p) == pytest.approx(expected, rel=1e-9)
    per_mass = erosion.PerMass.on("aluminium 6061", cutting_fraction=0.5)
    assert per_mass == erosion.PerMass(2700.0, 0.5)
    assert per_mass.erosion_ratio(volume, p) == pytest.approx(0.5 * 2700 * expected, rel=1e-9)


def test_arrays_broadcast_with_the_mass():
    p = GARNET.replace(m=np.array([1e-8, 2e-8]))
    ratios = erosion.PerMass(1000.0).erosion_ratio(np.array([[1e-15], [3e-15]]), p)
    np.testing.assert_allclose(ratios, [[1e-4, 5e-5], [3e-4, 1.5e-4]])


@pytest.mark.parametrize(
    ("density", "amount", "speed", "is_far"),
    [
        (1000.0, 0.3, 100.0, False), (1000.0, 2.9, 100.0, False), (1000.0, 3.1, 100.0, True),
        (1000.0, 0.032, 100.0, True), (1000.0, 0.0, 100.0, False), (1000.0, 0.3, 10.0, True),
        (1000.0, 2e-3, 10.0, False),
        # 0.1 g/kg of steel, 7.8 g/cm³, is 12.8 mm³/kg; 1 g/kg of aluminium, 2.7 g/cm³, is 370 mm³/kg.
        (None, 59500.0, 100.0, True), (None, 1100.0, 100.0, False), (None, 1120.0, 100.0, True),
        (None, 4.3, 100.0, False), (None, 4.2, 100.0, True),
    ],
)  # fmt: skip
def test_far_from_tests_is_one_sentence_with_its_source(density, amount, speed, is_far):
    # In g/kg; of an unknown density in mm³/kg, beside those of the metals that were tested.
    far = far_from_tests(amount * (1e-9 if density is None else 1e-3 / density), speed, density)
    assert (far is not None) == is_far
    assert far is None or far.finding().text.startswith(
        f"{float(f'{amount:.2g}'):g} {'mm³/kg' if density is None else 'g/kg'} "
    )


@pytest.mark.parametrize(("ratio", "is_beyond"), [(9.9e-3, False), (10.1e-3, True), (1e-9, False)])
def test_an_amount_of_more_than_ten_times_all_tests_is_marked(ratio, is_beyond):
    p = GARNET.replace(m=1.0)
    for per_mass in (erosion.PerMass(2700.0), erosion.PerMass(2700.0, 0.5)):
        volume = ratio / 2700 / per_mass.cutting_fraction
        assert per_mass.is_beyond_tests(volume, p) == is_beyond
    # 0.3 g/kg is usual at 100 m/s, and far too much at 10 m/s.
    many = erosion.PerMass(1000.0).far_from_tests(np.array([2.9e-7, 3e-7]), p.replace(v0=np.array([10.0, 100.0])))
    assert many is not None
    assert (many.amount, many.unit, many.speed) == (pytest.approx(0.29), "g/kg", 10.0)


@pytest.mark.parametrize("material", ["aluminium", "carbon-steel"])
@pytest.mark.parametrize("speed", [30.0, 100.0, 200.0])
def test_the_range_of_tests_holds_the_fits_that_it_rests_on(material, speed):
    greatest = float(erosion.CORRELATIONS["dnv"].erosion(0.6, speed, material))
    assert far_from_tests(greatest / 1000.0, speed, 1000.0) is None


def test_without_a_density_there_is_no_mass_loss():
    with pytest.raises(ValueError, match="`density` must be given"):
        erosion.PerMass().erosion_ratio(1.0, GARNET)
    assert [value.name for value in erosion.PerMass().declare(1e-12, GARNET)] == ["specific_volume"]
    (table,) = render.tables("", erosion.PerMass(2700.0, 0.5).declare(GARNET.m * 1e-6, GARNET), "inch-pound")
    assert [tuple(row[2:4]) for row in table.rows] == [("500", "mm³/kg"), ("1.35", "g/kg")]


TARGET = 'target = "aluminium 6061"\n'


@pytest.mark.parametrize(
    ("text", "given"),
    [
        (TARGET + "cutting_fraction = 0.4", erosion.PerMass(2700.0, 0.4)),
        (TARGET + 'density = "2.71 g/cm^3"', erosion.PerMass(2710.0)),
        ("density = 2700", r"field `density` must be a density with its unit"),
        ('density = "3 m"', "field `density` must be a density"),
        (TARGET + 'density = "7.8 g/cm^3"', "field `density` must be that of the target aluminium 6061"),
        ("cutting_fraction = 2", "field `cutting_fraction` must be above 0"),
        ('cutting_fraction = "1"', "field `cutting_fraction` must be a number"),
    ],
)
def test_case_files_give_density_and_cutting_fraction(tmp_path, text, given):
    (tmp_path / "case.toml").write_text(text)
    case = CaseFile.read(tmp_path / "case.toml")
    if isinstance(given, erosion.PerMass):
        assert dataclasses.astuple(case.per_mass()) == pytest.approx(dataclasses.astuple(given))
    else:
        with pytest.raises(erosion.CaseError, match=given):
            case.per_mass()


def test_a_correlation_has_all_particles_and_its_own_density_in_it():
    model = erosion.load_model("dnv:aluminium")
    p = GARNET.replace(alpha=0.6)
    ratio = per_mass_of(model, erosion.PerMass(2710.0, 0.1)).erosion_ratio(erosion.impact(model, p).volume, p)
    assert ratio == pytest.approx(float(erosion.correlations.dnv(0.6, 100.0, "aluminium")), rel=1e-9)
    cutting = erosion.PerMass(8000.0, 0.1)
    assert per_mass_of(erosion.load_model("rotating"), cutting) is cutting


RANGES = {"v0": (60.0, 90.0), "alpha": (np.pi / 12, np.pi / 2)}


def test_ranges_are_read_back_and_say_by_how_much_a_question_lies_outside():
    tested = Ranges.read(tomllib.loads(f"tested = {Ranges(RANGES).dump()}")["tested"])
    for name, ends in RANGES.items():
        assert tested.ranges[name] == pytest.approx(ends, rel=1e-8)
    assert tested.outside({"v0": 90.0, "alpha": np.pi / 2, "m": 1.0}) == []
    fast, slow = tested.outside({"v0": np.array([30.0, 120.0])})
    assert [(one.numbers["side"], one.numbers["ratio"]) for one in (fast, slow)] == [
        ("fastest", pytest.approx(120 / 90)),
        ("slowest", pytest.approx(0.5)),
    ]


@pytest.mark.parametrize("table", [3, {"v0": 60}, {"v0": [60, 90]}, {"v0": ["1 kg", "2 kg"]}, {"k": ["1 m", "2 m"]},
                                   {"v0": ["90 m/s", "60 m/s"]}, {"v0": ["60 m/s"]}])  # fmt: skip
def test_other_tables_are_refused(table):
    with pytest.raises(ValueError, match=r"^must "):
        Ranges.read(table)
