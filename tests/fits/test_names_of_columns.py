"""Names that people give to columns of weighings: understood, refused by name, or left out with a sentence."""

import math

import numpy as np
import pytest

from erosion.fits import MeasurementError, read_measurements

SPEEDS = {
    "speed [m/s]": 80, "v [m/s]": 80, "V [m/s]": 80, "velocity [m/s]": 80, "speed (m/s)": 80, "v0 [m/s]": 80,
    "v₀ [m/s]": 80, "Impact Velocity [m s^-1]": 80, "impact speed [km/h]": 288, "impact_velocity [m·s⁻¹]": 80,
    "v_impact [m/s]": 80, "V_impact (m s-1)": 80, "vel [m/s]": 80, "speed_mps": 80, "velocity_m_s": 80, "speed m/s": 80,
    "v / (m/s)": 80, "particle velocity [mm/s]": 8e4, "Speed[m/s]": 80, "|v| [m/s]": 80, "v in m/s": 80,
}  # fmt: skip
ANGLES = {
    "angle [deg]": 30, "angle (deg)": 30, "Angle [°]": 30, "alpha [rad]": math.pi / 6, "α [°]": 30, "angle_deg": 30,
    "impact angle [deg]": 30, "Impact Angle (degrees)": 30, "impactAngle [deg]": 30, "angle of attack [deg]": 30,
    "impingement angle [deg]": 30, "angle in deg": 30, "attack_angle [deg]": 30, "angle / °": 30,
}  # fmt: skip
AMOUNTS = {
    # one amount of each kind in SI
    "volume [mm^3]": ("volume", 1e9), "Volume loss (mm³)": ("volume", 1e9), "wear volume [m3]": ("volume", 1),
    "eroded volume [mm^3/g]": ("volume per mass", 1e6), "volume_mm3": ("volume", 1e9), "mass loss [mg]": ("mass", 1e6),
    "Mass Loss (mg/g)": ("mass per mass", 1e3), "weight loss [mg]": ("mass", 1e6), "mass_loss_mg": ("mass", 1e6),
    "massLoss [mg/kg]": ("mass per mass", 1e6), "removed mass [g]": ("mass", 1e3), "erosion [-]": ("1", 1),
    "erosion rate [mg/kg]": ("mass per mass", 1e6), "Erosion Ratio [kg/kg]": ("mass per mass", 1), "erosion": ("1", 1),
    "wear [mg]": ("mass", 1e6), "wear rate [mm^3/kg]": ("volume per mass", 1e9),
    "specific erosion [mm3/g]": ("volume per mass", 1e6),
}  # fmt: skip
DOUBTFUL_AMOUNTS = [
    "V [mm^3]", "volume", "dm [mg]", "loss [mg]", "erosion ratio [-]", "erosion ratio", "wear",
    "erosion rate [mm/year]", "mass loss [%]", "penetration [mm]", "E [mg/g]",
    "Abtrag [mg]", "weight [g]", "specific wear rate [mm^3/N/m]",
]  # fmt: skip
DOUBTFUL = [
    "v", "speed", "u [m/s]", "w [m/s]", "jet velocity [m/s]", "gas speed [m/s]", "v_rel [m/s]", "v1 [m/s]", "rpm",
    "velocity_ms", "Geschwindigkeit [m/s]", "test speed", "feed rate [g/min]", "sand flow [kg/s]", "impacts [1/s]",
    "theta [deg]", "nozzle angle [deg]", "incidence angle [deg]", "angle std [deg]", "tilt [deg]",
    "size [um]", "d [um]", "diameter [um]", "d50 [um]", "particle size (um)", "size", "radius [mm]", "diameter_um",
    "density [kg/m^3]", "particle density [g/cm^3]", "spin [rad/s]",
    "m [mg]", "sand mass [kg]", "mass before [g]", "mass after [g]", "weight [g]", "weight", "mass",
    "depth [um]", "loss [mg/kg]", "error [mg/kg]", "error", "uncertainty", "sigma [mg/kg]", "std",
    "impact velocity [m/s], speed [m/s]", "volume [mm^3]", "wear [mg/g]", "mass loss [mg]",
]  # fmt: skip
FOREIGN = [
    "note", "run", "sample", "date", "erodent", "material", "repeat", "time [s]", "temperature [K]", "pressure [bar]",
    "humidity [%]", "hardness [GPa]", "test duration [min]", "operator",
]  # fmt: skip


def read(table, head, cells, **options):
    return read_measurements(table(f"{head}\n{cells}\n"), "si", **options)


def cases() -> list[tuple[str, str, object]]:
    """A heading and a cell, the field that has it, and its value."""
    masses = ["mass [mg]", "particle mass [mg]", "mass_mg", "mass of erodent (mg)", "grain mass [mg]"]
    errors = ["uncertainty [mg/g]", "std [mg/g]", "Standard deviation (mg/g)", "std_dev [mg/g]"]
    rest = "angle [deg],mass_loss [mg/kg],{}\n30,5,{}"
    return [
        *((rest.format(name, number), "speed", 80.0) for name, number in SPEEDS.items()),
        *((f"{name},mass_loss [mg/kg]\n{number},5", "angle", math.pi / 6) for name, number in ANGLES.items()),
        *((rest.format(name, 7), "mass", 7e-6) for name in masses),
        *((rest.format(name, 7), "uncertainty", 7e-3) for name in errors),
    ]


@pytest.mark.parametrize(("text", "field", "value"), cases())
def test_conditions_and_errors_are_understood(table, text, field, value):
    measured = read(table, *text.split("\n"))
    assert getattr(measured, field) == pytest.approx(value)
    assert measured.unused == ()


@pytest.mark.parametrize("name", AMOUNTS)
def test_amounts_are_understood(table, name):
    dimension, number = AMOUNTS[name]
    measured = read(table, f"angle [deg],{name}", f"30,{number}")
    assert (measured.dimension, measured.erosion) == (dimension, pytest.approx(1))


def test_the_mass_of_the_sand_of_a_test_is_no_mass_of_an_erodent(table):
    with pytest.raises(
        MeasurementError, match=r"column 3 \(mass \[kg\]\) must be the mass of one erodent, .* but is 0.5"
    ):
        read(table, "angle [deg],mass_loss [mg],mass [kg]", "30,5,0.5")


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_condition_that_leaves_a_doubt_is_refused(table, name):
    rest = ",7" * (name.count(",") + 1)
    with pytest.raises(MeasurementError) as caught:
        read(table, f"angle [deg],mass_loss [mg/kg],{name}", f"30,5{rest}")
    assert str(caught.value).startswith(str(table("")))
    if "," not in name:
        measured = read(table, f"angle [deg],mass_loss [mg/kg],{name}", "30,5,7", ignore=(name,))
        assert (measured.speed, measured.mass, measured.uncertainty, measured.unused) == (None, None, None, ())
        data = {"angle [deg]": [30.0], "mass_loss [mg/kg]": [5.0], name: [7.0]}
        with pytest.raises(MeasurementError, match=r"`ignore`|must carry its unit|must have one column"):
            read_measurements(data, "si")
        np.testing.assert_array_equal(read_measurements(data, "si", ignore=name).erosion, measured.erosion)


@pytest.mark.parametrize("name", DOUBTFUL_AMOUNTS)
def test_an_amount_that_leaves_a_doubt_is_refused(table, name):
    with pytest.raises(MeasurementError, match="line 1"):
        read(table, f"angle [deg],{name}", "30,5")


@pytest.mark.parametrize("name", FOREIGN)
def test_other_columns_are_left_out_and_named(table, name):
    assert read(table, f"angle [deg],{name},mass_loss [mg/kg]", "30,x,5").unused == (name,)


def test_only_columns_that_are_there_can_be_ignored(table):
    with pytest.raises(MeasurementError, match="has no column 'v_gas', which Argument `ignore` names"):
        read(table, "angle [deg],volume [mm^3]", "30,5", ignore=("v_gas",))
