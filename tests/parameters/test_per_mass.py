import dataclasses

import numpy as np
import pytest

import erosion
from erosion.models.correlated import per_mass_of
from erosion.parameters.case_files import CaseFile
from erosion.parameters.per_mass import far_from_tests

P = erosion.TABLE_1.to("si").with_particle("garnet 0.3 mm").with_target("aluminium 6061").replace(v0=100.0)


def test_the_linearized_cut_per_mass_of_abrasive():
    # V = V*/k [sin 2α - (2/k) sin²α] with V* = m v²/(σψ): the mass of the particle cancels.
    alpha, sigma = np.deg2rad(20), 107 * 9.80665e6
    expected = 1e4 / (sigma * 2) / 2 * (np.sin(2 * alpha) - np.sin(alpha) ** 2)
    p = P.replace(alpha=alpha)
    volume = erosion.impact("linearized", p).volume
    assert erosion.PerMass().specific_volume(volume, p) == pytest.approx(expected, rel=1e-9)
    per_mass = erosion.PerMass.on("aluminium 6061", cutting_fraction=0.5)
    assert per_mass == erosion.PerMass(2700.0, 0.5)
    assert per_mass.erosion_ratio(volume, p) == pytest.approx(0.5 * 2700 * expected, rel=1e-9)
    inches = p.to("inch-pound")
    cubic_inches = erosion.impact("linearized", inches).volume
    assert per_mass.erosion_ratio(cubic_inches, inches) == pytest.approx(0.5 * 2700 * expected, rel=1e-9)


def test_arrays_broadcast_with_the_mass():
    p = P.replace(m=np.array([1e-8, 2e-8]))
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
    unit = "mm³/kg" if density is None else "g/kg"
    assert far is None or str(far).startswith(
        f"{float(f'{amount:.2g}'):g} {unit} is far from what tests on ductile metals"
    )
    assert far is None or "DNVGL-RP-O501, 2015, table 3-1" in str(far)
    assert erosion.PerMass().warning(1.0, P) is None


@pytest.mark.parametrize(("ratio", "is_beyond"), [(9.9e-3, False), (10.1e-3, True), (1e-9, False)])
def test_an_amount_of_more_than_ten_times_all_tests_is_marked(ratio, is_beyond):
    p = P.replace(m=1.0)
    for per_mass in (erosion.PerMass(2700.0), erosion.PerMass(2700.0, 0.5)):
        volume = ratio / 2700 / per_mass.cutting_fraction
        assert per_mass.is_beyond_tests(volume, p) == is_beyond
        marks = [row.meaning.endswith("; more than ten times what tests find") for row in per_mass.rows(volume, p)]
        assert marks == [is_beyond, is_beyond]
        far = per_mass.far_from_tests(volume, p)
        assert far is not None
        assert far.is_beyond == is_beyond


def test_of_many_impacts_that_counts_which_is_greatest_for_its_speed():
    # 0.3 g/kg is usual at 100 m/s, and far too much at 10 m/s.
    p = P.replace(v0=np.array([10.0, 100.0]), m=1.0)
    message = erosion.PerMass(1000.0).warning(np.array([2.9e-7, 3e-7]), p)
    assert (message or "").startswith("0.29 g/kg is far from what tests on ductile metals find at 10 m/s")
    assert erosion.PerMass(1000.0).warning(np.array([np.nan, 3e-7]), p) is None


@pytest.mark.parametrize("material", ["aluminium", "carbon-steel"])
@pytest.mark.parametrize("speed", [30.0, 100.0, 200.0])
def test_the_range_of_tests_holds_the_fits_that_it_rests_on(material, speed):
    greatest = float(erosion.CORRELATIONS["dnv"].erosion(0.6, speed, material))
    assert far_from_tests(greatest / 1000.0, speed, 1000.0) is None


@pytest.mark.parametrize(
    ("name", "value"), [("density", 0.0), ("density", -1.0), ("cutting_fraction", 0.0), ("cutting_fraction", 1.1)]
)
def test_numbers_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=f"Argument `{name}` must be"):
        erosion.PerMass(**{name: value})


def test_without_a_density_there_is_no_mass_loss():
    with pytest.raises(ValueError, match="`density` must be given"):
        erosion.PerMass().erosion_ratio(1.0, P)
    assert [row.name for row in erosion.PerMass().rows(1e-12, P)] == ["specific_volume"]
    rows = erosion.PerMass(2700.0, 0.5).rows(P.m * 1e-6, P)
    assert [(row.value, row.unit) for row in rows] == [("500", "mm³/kg"), ("1.35", "g/kg")]


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
    p = P.replace(alpha=0.6)
    ratio = per_mass_of(model, erosion.PerMass(2710.0, 0.1)).erosion_ratio(erosion.impact(model, p).volume, p)
    assert ratio == pytest.approx(float(erosion.correlations.dnv(0.6, 100.0, "aluminium")), rel=1e-9)
    cutting = erosion.PerMass(8000.0, 0.1)
    assert per_mass_of(erosion.load_model("rotating"), cutting) is cutting
