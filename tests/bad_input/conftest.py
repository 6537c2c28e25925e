"""A folder of files that are not what they should be, and no computing."""

import os
import shutil
from pathlib import Path

import h5py
import pytest

import erosion

CASE = erosion.dump_case(erosion.TABLE_1)
TABLE = "angle [deg], volume [in^3/impact], uncertainty [in^3]\n"
TABLE += "10,1e-4,1e-6\n20,1.8e-4,1e-6\n30,2.1e-4,1e-6\n60,1.1e-4,1e-6\n"
ALL_BYTES = bytes(range(256))


unchecked_types = pytest.mark.skipif(
    os.environ.get("EROSION_CHECK_TYPES") == "1", reason="beartype would be the first to complain"
)


@pytest.fixture(scope="module")
def workshop(tmp_path_factory) -> Path:
    """Good files, broken files, and folders in the place of files."""
    folder = tmp_path_factory.mktemp("workshop")
    for name in ("bytes.toml", "bytes.nc", "bytes.csv", "bytes.py"):
        (folder / name).write_bytes(ALL_BYTES)
    for name in ("empty.toml", "empty.nc", "empty.csv"):
        (folder / name).touch()
    for name in ("folder", "folder.nc", "folder.zarr", "folder.svg", "folder.toml"):
        (folder / name).mkdir()
    with h5py.File(folder / "foreign.nc", "w") as file:
        file["measured"] = [1.0, 2.0]
    (folder / "file").write_text("text")
    (folder / "file.zarr").write_text("text")
    (folder / "case.toml").write_text(CASE)
    (folder / "page" / "figures").mkdir(parents=True)
    (folder / "page" / "index.html").write_text(CASE)
    (folder / "page" / "figures" / "case.svg").write_text(CASE)
    (folder / "jet.svg").write_text("v0 [in/s]\n4400\n4300\n")
    (folder / "jet.svg.toml").write_text(CASE + '[stream]\nv0 = "samples(jet.svg)"\n')
    (folder / "sand.csv").write_text(TABLE)
    (folder / "bad.csv").write_text("angle [deg], erosion [-]\n20,1\n95,2\n")
    (folder / "weights.csv").write_text("angle [deg], mass_loss [mg/impact]\n20,1\n30,2\n40,3\n")
    (folder / "mute.py").write_text('"""A file without a model."""\n')
    shutil.copy(Path(__file__).parents[2] / "models" / "coulomb_tip.py", folder / "friction.py")
    (folder / "raises.py").write_text("raise SystemExit(3)\n")
    (folder / "complains.py").write_text("raise ValueError('Argument `dimension` must be known.')\n")
    os.mkfifo(folder / "pipe")
    return folder


@pytest.fixture
def in_workshop(workshop, monkeypatch):
    """Work there, and leave everything as it was; the path is the folder's."""
    before = _contents(workshop)
    monkeypatch.chdir(workshop)
    yield workshop
    assert _contents(workshop) == before


def _contents(folder: Path) -> dict[str, bytes | None]:
    paths = (path for path in sorted(folder.rglob("*")) if path.parent.name != "__pycache__")
    return {str(path): path.read_bytes() if path.is_file() else None for path in paths if path.name != "__pycache__"}
