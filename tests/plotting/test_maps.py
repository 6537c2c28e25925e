"""Pictures of maps: the right colours at the right places, and nothing on stderr."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import erosion
from erosion import CORRELATIONS, erosion_map
from erosion.cfd.surface import Surface
from erosion.output.tables import with_error
from erosion.pages.map import write_map_page
from erosion.plotting import maps
from erosion.plotting.maps import plot_map, require_view
from tests.cfd.tables import Table, hump, sand

pytest.importorskip("pyvista")

P = erosion.TABLE_1.to("si")
SURFACE = hump(2, 1)


def two_faces(first: float, second: float) -> xr.Dataset:
    """A map whose faces are at x < 0.1 and x > 0.1, with as many particles as given."""
    table = Table(count=[first, second], mass=[1e-7, 1e-7], diameter=[4e-4, 4e-4], speed=[50.0, 50.0],
                  alpha=[0.4, 0.4], face=[0, 1])  # fmt: skip
    return erosion_map("linearized", P, table.only([count > 0 for count in (first, second)]), SURFACE)


def colours(figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """The colours in the middles of the left and the right half of the picture, of 255."""
    picture = np.asarray(figure.axes[0].images[0].get_array())
    height, width = picture.shape[:2]
    return picture[height // 2, width // 4], picture[height // 2, 3 * width // 4]


def is_yellow(colour: np.ndarray) -> bool:
    return colour[0] > 150 and colour[1] > 130 and colour[2] < 110


def is_grey(colour: np.ndarray) -> bool:
    return int(np.ptp(colour.astype(int))) < 20 and int(colour.max()) > 120


def test_the_deepest_face_is_yellow_and_one_without_impacts_grey(capfd: pytest.CaptureFixture[str]) -> None:
    left, right = colours(plot_map(two_faces(1.0, 10.0), view="+z"))
    assert is_yellow(right)
    assert not is_yellow(left)
    assert left[2] > left[1]
    left, right = colours(plot_map(two_faces(1.0, 0.0), view="+z"))
    assert is_yellow(left)
    assert is_grey(right)
    # Seen from below, x runs to the left where y runs upwards.
    left, right = colours(plot_map(two_faces(1.0, 0.0), view="-z"))
    assert is_grey(left)
    assert is_yellow(right)
    assert capfd.readouterr() == ("", "")


def test_labels_have_the_quantity_and_its_unit() -> None:
    wear = erosion_map("rotating", P, sand(SURFACE, 50), SURFACE)
    figure = plot_map(wear, "depth")
    assert [axes.get_xlabel() for axes in figure.axes][1].startswith("depth of wear, volume over area [")
    title = figure.axes[0].get_title("left")
    assert title.startswith("Depth of wear, volume over area; ")
    assert "by rotating\nimpacts of 2 s" in title
    figure = plot_map(wear.assign_attrs(target="brass"))
    face = int(np.argmax(wear["depth"].values))
    greatest = float(wear["depth_per_year"][face])
    deepest = f"{with_error(greatest, greatest * float(wear['relative_error'][face]))} mm/year at ("
    assert next(text.get_text() for text in figure.axes[0].texts if text.get_text().startswith(deepest)).endswith(
        f"face {face}"
    )
    assert "target brass, by rotating" in figure.axes[0].get_title("left")
    figure = plot_map(wear, "depth_per_year", view=(1, 1, 1), log=True, zoom=1.5)
    assert figure.axes[1].get_xlabel() == "depth per year [mm/year]"
    assert figure.axes[1].get_xscale() == "log"
    assert plot_map(wear, "relative_error", view="+x").axes[1].get_xlabel().endswith("of the volume")


def test_a_page_has_the_worst_faces_the_totals_and_the_warnings(tmp_path: Path) -> None:
    surface = hump()
    wear = erosion_map("dnv", P, sand(surface, 400), surface, sand_rate="100 kg/day", injected="1 g")
    page = write_map_page(wear, tmp_path / "a.html").read_text()
    assert 'src="data:image/png;base64,iVBOR' in page
    worst = [int(face) for face in re.findall(r"<tr><th scope=\"row\">(\d+)</th><td>(?:front|back)</td>", page)]
    assert worst == np.argsort(-wear["depth"].values)[:10].tolist()
    greatest, error = (float(wear[name][worst[0]]) for name in ("depth_per_year", "relative_error"))
    x, y, z = wear["centre"].values[worst[0]] * 1e3
    assert f"<td>{x:.4g}, {y:.4g}, {z:.4g}</td><td>{with_error(greatest, greatest * error)}</td>" in page
    assert page.index("⚠ ") < page.index("<img")
    assert "Argument" not in page
    source = CORRELATIONS["dnv"].source[:20]
    constants = "K = 2e-09 (m/s)⁻ⁿ, n = 2.6", "density = 7800 kg/m^3"
    amounts = "0.00115741 kg/s", "kg/day", "mass per year", "rows: 400, of which"
    for words in (source, *constants, *amounts, "has not worn", "dnv"):
        assert words in page
    with pytest.raises(ValueError, match=r"must end in \.html"):
        write_map_page(wear, tmp_path / "a.vtp")
    with pytest.raises(ValueError, match=r"-o .*a\.html"):
        write_map_page(wear, tmp_path / "a.pdf")


def test_a_wide_range_has_colours_by_the_logarithm() -> None:
    wear, depth = two_faces(1.0, 1.0), np.array([1.0, 100.0]) * 1e-9
    assert plot_map(wear.assign(depth=("face", depth)), "depth").axes[1].get_xscale() == "linear"
    wear = erosion_map("rotating", P, sand(hump(), 50), hump())
    depth = np.where(np.arange(48) == 3, 1e-6, 1e-9)
    wide = wear.assign(depth=("face", depth), impacts=("face", np.ones(48, int)))
    assert plot_map(wide, "depth").axes[1].get_xscale() == "log"
    assert plot_map(wide, "depth", log=False).axes[1].get_xscale() == "linear"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"quantity": "total_volume"}, "Argument `quantity` must be one of volume, depth, "),
        ({"view": "top"}, r"Argument `view` must be one of iso, \+x, "),
        ({"view": (0, 0, 0)}, r"other than \(0, 0, 0\), but is \(0, 0, 0\)"),
        ({"view": (1, 2)}, "Argument `view` must be a direction"),
        ({"zoom": 0.0}, "Argument `zoom` must be positive"),
    ],
)
def test_what_cannot_be_drawn_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plot_map(two_faces(1.0, 1.0), **options)  # pyrefly: ignore


def test_a_surface_that_is_seen_edge_on_is_told() -> None:
    flat = Surface("flat", np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0]]), np.arange(3), np.array([3]), ("flat",),
                   np.zeros(1, np.int64))  # fmt: skip
    table = Table(count=[1.0], mass=[1e-7], diameter=[4e-4], speed=[50.0], alpha=[0.4], face=[0])
    wear = erosion_map("linearized", P, table, flat)
    with pytest.raises(ValueError, match="Argument `view` must show the surface, but sees it edge on"):
        require_view("+x", 1.0, flat.normal)
    with pytest.raises(ValueError, match="Argument `view` must show the surface, but sees it edge on, or zooms"):
        plot_map(wear, view="+x")
    require_view("+z", 1.0, flat.normal)


def test_totals_alone_cannot_be_drawn() -> None:
    table = Table(count=[1.0], mass=[1e-7], diameter=[4e-4], speed=[50.0], alpha=[0.4])
    with pytest.raises(ValueError, match="must be the map of a surface"):
        plot_map(erosion_map("linearized", P, table))


def test_without_a_renderer_it_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(maps, "_RENDERERS", ("libnothing.so.1",))
    with pytest.raises(RuntimeError, match=r"^A picture of a map needs a screen, or a library that draws without one"):
        maps.require_renderer()
    monkeypatch.setenv("DISPLAY", ":0")
    maps.require_renderer()
