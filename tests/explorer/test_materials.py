"""The particles and targets that the page offers."""

from pathlib import Path

import pytest

from erosion.explorer.controls import read_materials
from erosion.parameters.materials import known_particles, known_targets
from erosion.parameters.quantities import System


def test_own_tables_come_before_the_packages(tmp_path: Path) -> None:
    table = tmp_path / "mine.toml"
    table.write_text(
        '[particles.slag]\ndensity = 2800\n[targets."my alloy"]\nvickers = 180\n[targets.brass]\nvickers = 99\n'
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


@pytest.mark.parametrize("size", ["", "0 mm", "-1 mm", "1 kg", "x.toml: garnet 1 mm", "1e999 mm", "9**9**9 mm"])
def test_a_size_that_is_none_is_one_sentence(size: str) -> None:
    with pytest.raises(ValueError, match=r"^The size .*\.$"):
        read_materials().sized("garnet", size, "si")
