"""An exported entry in a run of OpenFOAM itself, where it is installed."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import erosion

SOLVER = "icoUncoupledKinematicParcelFoam"
CASE = Path(__file__).parents[1] / "cfd" / "openfoam" / "case"
DIAMETER = 0.25e-3  # m
SAND = erosion.Parameters(
    k=2.4, psi=2.0, sigma=1.5e9, r=DIAMETER / 2, b=DIAMETER, m=2650 * np.pi / 6 * DIAMETER**3, v0=25.0, alpha=0.4,
    inertia=0.4, units="si",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """The hump with the entry for `rotating` in the place of the case's own."""
    folder = tmp_path_factory.mktemp("run") / "case"
    shutil.copytree(CASE, folder)
    control = folder / "system" / "controlDict"
    control.write_text(control.read_text().replace("FORMAT", "ascii").replace("COMPRESSION", "off"))
    entry = erosion.to_openfoam("rotating", SAND).text().replace("(walls)", "(hump floor)")
    cloud = folder / "constant" / "kinematicCloudProperties"
    text, entries = re.subn(r"    erosion\s*\{.*?\}\n", lambda _: entry, cloud.read_text(), flags=re.S)
    assert entries == 1
    cloud.write_text(text)
    # OpenFOAM believes PWD, and stops where that path has spaces.
    environment = {"WM_PROJECT_DIR": "/usr/share/openfoam", **os.environ, "PWD": str(folder)}
    for command in ("blockMesh", SOLVER):
        subprocess.run([command], cwd=folder, env=environment, check=True, capture_output=True, timeout=120)
    return folder


@pytest.mark.slow
@pytest.mark.skipif(shutil.which(SOLVER) is None, reason="OpenFOAM is not installed")
@pytest.mark.parametrize("patch", ["hump", "floor"])
def test_openfoams_field_is_the_map_of_the_model(run: Path, patch: str) -> None:
    wear = erosion.erosion_map("rotating", SAND, erosion.read_impacts(run), erosion.read_surface(run, patch=patch))
    field = (run / "0.02" / "kinematicCloudQ").read_text()
    numbers = re.search(rf"    {patch}\n.*?List<scalar>\s*\d+\s*\((.*?)\)", field, re.S)
    assert numbers is not None
    q = np.array(numbers[1].split(), float)
    assert q.size == wear.sizes["face"]
    assert q.sum() > 0
    # The form is off by less than 0.4 % of the maximum from half to twice the case's speed.
    assert np.abs(q - wear.volume.values).max() < 4e-3 * q.max()
