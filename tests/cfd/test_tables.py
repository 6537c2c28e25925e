"""Volumes over angle, speed and diameter for codes that interpolate."""

import csv
import io

import numpy as np
import pytest

import erosion
from erosion.cfd.exports import to_csv

P = erosion.TABLE_1
SI = P.to("si")


def test_a_table_has_the_volumes_of_similar_bodies():
    alpha, speeds, diameters = np.deg2rad([10.0, 35.0, 90.0]), [3000.0, 4400.0], [0.04, 0.08, 0.2]
    table = erosion.volume_table("rotating", P.replace(phidot0=1e4), alpha=alpha, v0=speeds, d=diameters)
    assert table.volume.dims == ("d", "v0", "alpha")
    assert table.volume.attrs["units"] == "in^3"
    # The case's particle is 2 r wide.
    s = np.array(diameters)[:, None, None] / 0.08
    copy = P.replace(alpha=alpha, v0=np.array(speeds)[:, None], r=0.04 * s, b=0.04 * s, m=P.m * s**3, phidot0=1e4)
    np.testing.assert_allclose(table.volume, erosion.impact("rotating", copy).volume, rtol=1e-8)


def test_the_csv_is_in_si_and_degrees_and_can_be_read_again():
    table = erosion.volume_table("finnie", P, alpha=np.deg2rad([20.0, 30.0]), v0=[4400.0], d=[0.08])
    rows = list(csv.DictReader(io.StringIO(to_csv(table))))
    assert list(rows[0]) == ["diameter [m]", "speed [m/s]", "angle [deg]", "volume [m^3]"]
    assert [float(row["angle [deg]"]) for row in rows] == pytest.approx([20.0, 30.0])
    assert float(rows[0]["speed [m/s]"]) == pytest.approx(111.76)
    exact = float(erosion.impact("finnie", SI.replace(alpha=np.deg2rad(30.0))).volume)
    assert float(rows[1]["volume [m^3]"]) == pytest.approx(exact, rel=1e-9)


def test_without_axes_the_table_reaches_from_half_to_twice_the_case():
    table = erosion.volume_table("finnie", SI)
    assert dict(table.sizes) == {"d": 7, "v0": 7, "alpha": 36}
    assert table.v0.values[[0, 2, -1]] == pytest.approx(111.76 * np.array([0.5, 1.0, 2.0]))
    assert float(table.alpha[-1]) == pytest.approx(np.pi / 2)
    # Similar bodies remove by mass.
    assert (table.volume / table.d**3).std("d").max() < 1e-9 * float((table.volume / table.d**3).max())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"alpha": [20.0]}, r"Argument `alpha` must be in \(0, 90°\], but has 1145.92°."),
        ({"alpha": [[0.1]]}, "Argument `alpha` must be a number or a list of them"),
        ({"v0": [np.nan]}, "Argument `v0` must be positive and finite, but has nan."),
        ({"d": np.ma.masked_less([1.0, 2.0], 1.5)}, "Argument `d` must have no masked values"),
    ],
)
def test_bad_axes_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        erosion.volume_table("finnie", P, **arguments)


def test_a_model_whose_impacts_fail_has_no_table(tmp_path):
    (tmp_path / "mine.py").write_text(
        "import erosion, jax.numpy as jnp\n"
        "class F(erosion.models.ForceLaw):\n"
        "    def __call__(self, state, tip, p): return jnp.log(-1 - tip.depth), 0 * tip.depth\n"
        "    def typical_ratio(self, p): return p.k\n"
        "model = erosion.models.Linearized(force=F())\n"
    )
    with pytest.raises(erosion.SimulationError, match="impacts could not be computed"):
        erosion.volume_table(tmp_path / "mine.py", P)


@pytest.mark.parametrize("table", [erosion.volume_table, erosion.restitution])
def test_a_table_of_too_many_rows_is_refused_before_it_is_computed(table):
    axes = {"alpha": np.linspace(0.1, 1.5, 2000), "v0": np.linspace(1.0, 100.0, 20_000)}
    with pytest.raises(ValueError, match=r"at most 1,000,000 rows, but makes \d*0,000,000\."):
        table("linearized", erosion.TABLE_1, **axes)


def test_an_impact_that_is_too_great_is_an_error_without_a_warning():
    with pytest.raises(erosion.SimulationError, match="could not be computed"):
        erosion.volume_table("linearized", erosion.TABLE_1, d=np.array([1e150]))
