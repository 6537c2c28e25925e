"""A map by `finnie` is OpenFOAM's own field Q, which OpenFOAM v1912 summed while it ran."""

from pathlib import Path

import numpy as np
import pytest

import erosion
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.read import read_impacts, read_surface

foamlib = pytest.importorskip("foamlib")

RUNS = Path(__file__).parents[1] / "cfd" / "openfoam"
# p, psi and K of case/constant/kinematicCloudProperties.
P = erosion.TABLE_1.to("si").replace(sigma=1.5e9, psi=2.0, k=2.4, inertia=0.5)


@pytest.mark.parametrize("run", ["serial", "parallel"])
def test_finnie_is_what_openfoam_summed(run: str) -> None:
    surface = read_surface(RUNS / run, patch=["hump", "floor"])
    impacts = read_impacts(RUNS / run)
    wear = erosion_map("finnie", P, impacts, surface)
    (file,) = (RUNS / run / "0.02").iterdir()
    field = foamlib.FoamFieldFile(file)
    q = np.concatenate([np.asarray(field.boundary_field[patch].value) for patch in surface.patches])
    np.testing.assert_allclose(wear["volume"], q, rtol=1e-9)
    assert int(wear["total_impacts"]) > 400
    assert int((wear["impacts"] > 0).sum()) > 30
    assert not wear["left_out"].any()


def test_one_patch_leaves_the_rows_of_others_out() -> None:
    impacts = read_impacts(RUNS / "serial")
    hump, both = (
        erosion_map("finnie", P, impacts, read_surface(RUNS / "serial", patch=patch))
        for patch in ("hump", ["hump", "floor"])
    )
    assert float(hump["total_volume"]) == float(both["patch_volume"].sel(patch="hump"))
    assert int(hump["left_out"].sel(reason="elsewhere")) == int(both["total_impacts"] - hump["total_impacts"]) > 0


def test_both_runs_have_nearly_the_same_wear() -> None:
    # Their injections draw other random numbers.
    totals = [
        erosion_map("rotating", P, read_impacts(RUNS / run), read_surface(RUNS / run, patch="hump"))
        for run in ("serial", "parallel")
    ]
    values = [float(wear["total_volume"]) for wear in totals]
    errors = [float(wear["total_volume"] * wear["total_relative_error"]) for wear in totals]
    assert abs(values[0] - values[1]) < 3 * np.hypot(errors[0], errors[1])
