"""Figures of maps and streams: a surface coloured by its wear, and the volumes that particles remove."""

import contextlib
import ctypes
import math
import os
import sys
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from erosion.cfd.map_files import to_polydata
from erosion.cfd.map_result import FACES, total_scale
from erosion.extras import library
from erosion.output import briefly, with_error
from erosion.parameters import RESULTS, Scale, System, readable_scale, table_scale
from erosion.plotting.curves import ShapeCurve, draw_curve
from erosion.plotting.labels import DIM, FAINT, INK, PALETTE, round_length
from erosion.plotting.style import PlainNumbers, house_style, legend_below, mark_turned, new_figure
from erosion.results import from_attribute
from erosion.streams.result import NozzleAngle, Stream

VIEWS: Mapping[str, tuple[float, float, float]] = {
    "iso": (1.0, -1.4, 0.9), "+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0), "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0), "+z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Views by name: the direction from the surface to the eye."""

_COLORS = "viridis"
_UNTOUCHED = "#d9dde2"
_PIXELS = 1600  # of the longer side of the picture
_DECADES = 3  # of a logarithmic scale
_MARGIN = 1.04
_FLATTEST, _TALLEST = 0.25, 1.2  # height over width of the picture
_EDGE_ON = 1e-3  # cosine of the angle between a face's normal and the view
_STRIP = 0.15  # height of the strip below the picture over the picture's width, where this is that of a screen
_SCREEN, _AROUND = 6.4, 1.5  # inch: the figure's width on a screen, and the height of title and scale
_RENDERERS = ("libEGL.so.1", "libOSMesa.so.8")  # which VTK looks for on Linux where there is no screen
_WIDE = 30.0  # greatest value over the median from which on colours are by the logarithm
_EDGES = 4000  # faces: with more of them lines between faces would hide the colours


@house_style()
def plot_map(
    wear: xr.Dataset,
    quantity: str | None = None,
    *,
    view: str | Sequence[float | int] = "worst",
    zoom: float | int = 1.0,
    log: bool | None = None,
) -> Figure:
    """Draw a map: the surface, coloured by one of the numbers of its faces; faces that nothing hits are grey.

    The face with the greatest number is marked, with its value, its place and its number.

    Args:
        wear: what `erosion_map` returns, of a surface.
        quantity: a variable over "face": "depth", "depth_per_year", "alpha_mean", "relative_error", …; without it the
            depth per year where the duration is known, else the depth.
        view: "worst" shows the deepest face; "iso", "+x", "-x", …, or the direction from the surface to the
            eye, (x, y, z).
        zoom: 2 shows the middle half of the surface.
        log: colours by the logarithm, over the three decades below the greatest value; without it where the greatest is
            more than 30 times the median.

    Raises:
        ValueError: for a map without a surface, an unknown variable or view, and a view that shows nothing.
        RuntimeError: on a machine where nothing can be drawn.
        MissingExtraError: where pyvista, of the extra `cfd`, is not installed.
    """
    require_view(view, zoom)
    if "face" not in wear.dims:
        raise ValueError("Argument `wear` must be the map of a surface, but holds totals alone.")
    quantity = quantity or depth_of(wear)
    if quantity not in FACES or quantity not in wear:
        known = ", ".join(name for name in FACES if name in wear)
        raise ValueError(f"Argument `quantity` must be one of {known}, but is {briefly(quantity)}.")
    scale, values = in_scale(wear, quantity)
    greatest = float(np.max(values, where=np.isfinite(values), initial=0.0))
    is_amount = quantity not in ("alpha_mean", "v0_mean")
    if log is None:
        hit = values[np.isfinite(values) & (values > 0)]
        log = bool(is_amount and hit.size and greatest > _WIDE * np.median(hit))
    norm = _norm(values, from_zero=is_amount, log=log)
    is_hit = (wear["impacts"].values > 0) & np.isfinite(values)
    colours = mpl.colormaps[_COLORS](np.clip(norm(np.where(is_hit, values, greatest)).filled(0.0), 0.0, 1.0))[:, :3]
    colours[~is_hit] = to_rgb(_UNTOUCHED)
    if isinstance(view, str) and view == "worst":
        view = _view_of_worst(wear)
    camera = _camera(wear["point"].values[wear["corner"].values], view, zoom)
    fig = new_figure(_SCREEN)
    wide = fig.get_figwidth()
    # Letters do not shrink with a column's width.
    strip = _STRIP * max(_SCREEN / wide, 1.0)
    fig.set_figheight(min(wide * (camera.height / camera.width + strip) + _AROUND, 9.0))
    ax = fig.subplots()
    ax.imshow(_picture(wear, colours, camera), extent=(0, camera.width, 0, camera.height))
    _add_ruler_and_axes(ax, camera, strip)
    unit = f" {scale.unit}" if scale.unit else ""
    if is_hit.any():
        worst = int(np.argmax(np.where(is_hit, values, -np.inf)))
        error = greatest * float(wear["relative_error"][worst]) if quantity.startswith("depth") else 0.0
        _mark(ax, (camera, strip), wear, worst, f"{with_error(greatest, error) if error else f'{greatest:.3g}'}{unit}")
    handles = [] if is_hit.all() else [Patch(color=_UNTOUCHED, label="no impacts")]
    if handles := [*handles, *mark_turned(ax, from_attribute(wear.attrs["findings"]))]:
        ax.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 0.0), borderaxespad=0.3)
    low = log and bool(np.any(values[is_hit] < norm.vmin))
    unit = f" [{scale.unit}]" if scale.unit else ""
    fig.colorbar(
        ScalarMappable(norm, _COLORS), ax=ax, orientation="horizontal", aspect=40, shrink=0.9, pad=0.01,
        extend="min" if low else "neither", label=f"{FACES[quantity].meaning}{unit}",
    )  # fmt: skip
    ax.set_title(_title(wear, FACES[quantity].meaning), fontsize="medium", loc="left", wrap=True)
    return fig


def depth_of(wear: xr.Dataset) -> str:
    """The depth a year where the duration is known, else the depth."""
    return "depth_per_year" if "depth_per_year" in wear else "depth"


def require_view(view: str | Sequence[float | int], zoom: float | int, normals: np.ndarray | None = None) -> None:
    """Check a view and its zoom, and that it sees something of a surface; errors as of `plot_map`.

    Args:
        view: see `plot_map`.
        zoom: see `plot_map`.
        normals: of the faces, shape (faces, 3), where they are known.
    """
    direction = None if isinstance(view, str) and view == "worst" else _direction(view)
    if direction is not None and normals is not None and np.abs(normals @ direction).max() < _EDGE_ON:
        raise ValueError("Argument `view` must show the surface, but sees it edge on.")
    if not (isinstance(zoom, (int, float)) and math.isfinite(zoom) and zoom > 0):
        raise ValueError(f"Argument `zoom` must be positive and finite, but is {briefly(zoom)}.")


class _Camera(NamedTuple):
    """A view without perspective; unit vectors, and the size of what is seen [m]."""

    middle: np.ndarray
    eye: np.ndarray
    right: np.ndarray
    up: np.ndarray
    width: float
    height: float


def _direction(view: str | Sequence[float | int]) -> np.ndarray:
    """The unit vector from the surface to the eye."""
    if isinstance(view, str):
        if view not in VIEWS:
            raise ValueError(
                f"Argument `view` must be one of {', '.join(VIEWS)}, or a direction, but is {briefly(view)}."
            )
        view = VIEWS[view]
    direction = np.asarray(view, float)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise ValueError(f"Argument `view` must be a direction (x, y, z) other than (0, 0, 0), but is {briefly(view)}.")
    return direction / np.linalg.norm(direction)


def _view_of_worst(wear: xr.Dataset) -> tuple[float, float, float]:
    """A direction from the deepest face to the eye: from the fluid, or from outside where a wall is in between."""
    surface, face = to_polydata(wear), int(np.nanargmax(wear["depth"].values))
    normal = np.asarray(surface.compute_normals(
        point_normals=False, consistent_normals=False, auto_orient_normals=False)["Normals"][face], float)  # fmt: skip
    centre, length = wear["centre"].values[face], surface.length
    sides = [-normal, normal]
    free = [not len(surface.ray_trace(centre + 1e-3 * length * side, centre + 2 * length * side)[0]) for side in sides]
    towards = sides[1] if free[1] and not free[0] else sides[0]
    # A little from above, or from the side, shows the shape.
    aside = np.array([0.3, -0.4, 0.0]) if abs(normal[2]) > 0.8 else np.array([0.0, 0.0, 0.5])
    x, y, z = map(float, towards + aside)
    return x, y, z


def _mark(ax: Axes, seen: tuple[_Camera, float], wear: xr.Dataset, face: int, value: str) -> None:
    """A ring around a face, with its value and its place; below what a camera sees there is a strip for it."""
    camera, strip = seen
    centre = wear["centre"].values[face]
    size = np.array([camera.width, camera.height])
    at = np.stack([camera.right, camera.up]) @ (centre - camera.middle) + size / 2
    if not ((at > 0) & (at < size)).all():
        return
    scale = readable_scale("length", "si", float(np.abs(centre).max()) or 1.0)
    place = ", ".join(f"{number / scale.size:.4g}" for number in centre)
    ax.plot(*at, "o", markersize=11, markerfacecolor="none", markeredgecolor="white", markeredgewidth=3.0)
    ax.plot(*at, "o", markersize=11, markerfacecolor="none", markeredgecolor=PALETTE["vermillion"], markeredgewidth=1.6)
    line = {"arrowstyle": "-", "color": INK, "linewidth": 0.7, "shrinkB": 6}
    ax.annotate(
        f"{value} at ({place}) {scale.unit}, face {face:,}", tuple(at), (size[0] / 2, -strip / 6 * size[0]),
        ha="center", va="center", fontsize="small", arrowprops=line,
        bbox={"facecolor": "white", "edgecolor": FAINT, "alpha": 0.9, "boxstyle": "round,pad=0.25"},
    )  # fmt: skip


def _camera(points: np.ndarray, view: str | Sequence[float | int], zoom: float | int) -> _Camera:
    """A camera that sees all points, with z upwards if it can be."""
    eye = _direction(view)
    vertical = np.array([0.0, 1.0, 0.0]) if abs(eye[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
    right = np.cross(vertical, eye)
    right /= np.linalg.norm(right)
    up = np.cross(eye, right)
    seen = points @ np.stack([right, up, eye], axis=1)
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = np.stack([right, up, eye], axis=1) @ ((low + high) / 2)
    width, height = (high - low)[:2] * (_MARGIN / zoom)
    width, height = max(width, height / _TALLEST), max(height, width * _FLATTEST)
    return _Camera(middle, eye, right, up, float(width), float(height))


def require_renderer() -> None:
    """Find out whether VTK can draw here; on a machine where it cannot, it would end the process.

    Raises:
        RuntimeError: where there is neither a screen nor a library that draws in memory.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        return
    for name in _RENDERERS:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return
    raise RuntimeError(
        "A picture of a map needs a screen, or a library that draws without one: libegl1 in Debian, libEGL in Fedora."
    )


def _picture(wear: xr.Dataset, colours: np.ndarray, camera: _Camera) -> np.ndarray:
    """The surface as pixels."""
    pyvista = library("pyvista", "cfd")
    require_renderer()
    longer = max(camera.width, camera.height)
    size = [max(1, round(_PIXELS * length / longer)) for length in (camera.width, camera.height)]
    surface = to_polydata(wear)
    surface.clear_data()
    surface.cell_data["colour"] = np.round(255 * colours).astype(np.uint8)
    # Without a screen VTK warns on stderr that it looks for one, and then draws in memory.
    with pyvista.vtk_verbosity("off"):
        plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
        plotter.set_background("white")
        # A light at the eye shows the shape; most of it is ambient, so that colours stay those of the scale.
        plotter.add_light(pyvista.Light(light_type="headlight"))
        edges = {"show_edges": surface.n_cells <= _EDGES, "edge_color": FAINT, "edge_opacity": 0.5, "line_width": 1}
        plotter.add_mesh(surface, scalars="colour", rgb=True, ambient=0.6, diffuse=0.42, specular=0.0, **edges)
        far = 10 * float(np.linalg.norm(np.ptp(surface.points, axis=0)))
        plotter.camera_position = [camera.middle + far * camera.eye, camera.middle, camera.up]
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = camera.height / 2
        plotter.renderer.reset_camera_clipping_range()
        plotter.enable_anti_aliasing("ssaa")
        picture = plotter.screenshot(None, return_img=True)
        plotter.close()
    if (picture == 255).all():
        raise ValueError("Argument `view` must show the surface, but sees it edge on, or zooms into a gap.")
    return np.asarray(picture)


def in_scale(wear: xr.Dataset, quantity: str) -> tuple[Scale, np.ndarray]:
    """The unit in which the numbers of the faces read well, and the numbers in it."""
    values = np.asarray(wear[quantity].values, float)
    if quantity == "depth_per_year":
        return Scale(1.0, "mm/year"), values
    if FACES[quantity].dimension == "1":
        return Scale(1.0, ""), values
    greatest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
    scale = readable_scale(FACES[quantity].dimension, wear.attrs["unit_system"], greatest)
    return scale, values / scale.size


def _norm(values: np.ndarray, *, from_zero: bool, log: bool) -> Normalize:
    """The range of the colours."""
    known = values[np.isfinite(values)]
    low = float(known.min(initial=np.inf)) if not from_zero else 0.0
    high = float(known.max(initial=0.0))
    if log and high > 0:
        return LogNorm(high / 10**_DECADES, high)
    if not low < high:
        return Normalize(min(low, high), high + 1.0) if from_zero else Normalize(high - 1.0, high + 1.0)
    return Normalize(low, high)


def _add_ruler_and_axes(ax: Axes, camera: _Camera, strip: float) -> None:
    """Below the picture, in a strip of a share of its width, a ruler, and the directions of x, y and z."""
    centre = -0.6 * strip * camera.width
    ax.set(xlim=(0, camera.width), ylim=(-strip * camera.width, camera.height))
    ax.axis("off")
    length = round_length(camera.width / 4)
    scale = readable_scale("length", "si", length)
    begin, tick = 0.02 * camera.width, 0.01 * camera.width
    ax.plot([begin, begin, begin + length, begin + length], [centre + tick, centre, centre, centre + tick],
            color=INK, linewidth=1.2, solid_joinstyle="miter")  # fmt: skip
    ax.annotate(f"{length / scale.size:g} {scale.unit}", (begin + length / 2, centre), (0, 3),
                textcoords="offset points", ha="center", va="bottom", fontsize="small")  # fmt: skip
    origin, arm = np.array([0.88 * camera.width, centre]), 0.045 * camera.width
    for i, name in enumerate("xyz"):
        shown: Any = np.array([camera.right[i], camera.up[i]])
        if np.linalg.norm(shown) < 0.15:  # towards the eye
            continue
        tip = origin + arm * shown
        arrow = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
        ax.annotate("", tuple(tip), tuple(origin), arrowprops=arrow)
        ax.annotate(name, tuple(origin + 1.35 * arm * shown), ha="center", va="center", fontsize="small")


def _title(wear: xr.Dataset, meaning: str) -> str:
    """What is drawn, the total with its standard error, and for which sand and metal."""
    units, error = wear.attrs["unit_system"], float(wear["total_relative_error"])
    name = next(name for name in ("mass_per_year", "mass", "volume") if f"total_{name}" in wear)
    total = float(wear[f"total_{name}"])
    scale = total_scale(name, units, total)
    by = "sampling and uncertain parameters" if "total_parameter_error" in wear else "sampling alone"
    amount = scale.beside(with_error(total, total * error, scale.size))
    return "\n".join([f"{meaning[0].upper()}{meaning[1:]}; {amount} in all (± by {by})", *described(wear)])


def described(wear: xr.Dataset) -> list[str]:
    """Lines on metal, particle and model of a map, and on its sand and its duration."""
    attrs = wear.attrs
    named = [f"{name} {attrs[name]}" for name in ("target", "particle") if attrs.get(name)]
    lines = [", ".join([*named, f"by {attrs['model']}"])]
    sand = []
    if "sand_rate" in wear:
        sand.append(f"{float(wear['sand_rate']) * 86400:.4g} kg of sand a day")
    if "duration" in wear:
        time = table_scale("time", "si", float(wear["duration"]))
        sand.append(f"impacts of {float(wear['duration']) / time.size:.4g} {time.unit} {attrs['duration_from']}")
    return [*lines, ", ".join(sand)] if sand else lines


@house_style()
def plot_stream(stream: Stream) -> Figure:
    """The histogram of the volumes and, if it was computed, the curve over the nozzle's angle."""
    panels = 1 if stream.nozzle is None else 2
    fig = new_figure(5.8, 3.6 * panels)
    axes = np.ravel(fig.subplots(panels, 1))
    plot_stream_histogram(axes[0], stream)
    if stream.nozzle is not None:
        plot_nozzle_angle(axes[1], stream.nozzle, stream.particles.p.shown_in)
    return fig


@house_style()
def plot_stream_histogram(ax: Axes, stream: Stream) -> Axes:
    """The share of the particles over the volume that they remove; the title says how many remove nothing."""
    edges, shares = stream.tally.histogram()
    mean = stream.mean_volume.value
    scale = readable_scale("volume", stream.particles.p.shown_in, mean)
    ax.stairs(shares, edges / scale.size, fill=True, color=PALETTE["orange"], alpha=0.55)
    ax.stairs(shares, edges / scale.size, color=PALETTE["vermillion"])
    ax.axvline(mean / scale.size, color=PALETTE["blue"], label="mean")
    ax.axvline(stream.quantiles[0.5] / scale.size, color=PALETTE["green"], linestyle="--", label="median")
    volume, nothing = RESULTS["volume"], stream.tally.bins[0] / stream.tally.bins.sum()
    label = f"{volume.symbol}  {volume.meaning}  [{scale.unit}]"
    ax.set(xscale="log", xlabel=label, ylabel="share of the particles", ylim=(0, None))
    ax.xaxis.set(major_formatter=PlainNumbers(), minor_formatter=PlainNumbers())
    ax.yaxis.set_major_formatter(lambda share, _: f"{100 * share:g} %")
    title = f"{100 * nothing:.2g} % of the particles remove nothing" if nothing else "every particle removes something"
    ax.set_title(title, fontsize="medium", wrap=True)
    mark_turned(ax, stream.findings)
    ax.legend(loc="best")
    return ax


@house_style()
def plot_nozzle_angle(ax: Axes, nozzle: NozzleAngle, system: System) -> Axes:
    """Mean volume over the nozzle's angle with its 95 % by sampling, and the volume that a typical particle removes."""
    scale = readable_scale("volume", system, float(max(nozzle.curve.max(), nozzle.single_curve.max())))
    degrees, mean = np.rad2deg(nozzle.angles), nozzle.curve / scale.size
    half = 1.96 * nozzle.curve_error / scale.size
    alone = f"one typical particle, greatest at {np.rad2deg(nozzle.single_alpha):.2f}°"
    single = ShapeCurve(alone, nozzle.single_angles, nozzle.single_curve, beyond=nozzle.single_beyond)
    draw_curve(ax, single, scale.size, alone, color=DIM, linestyle="--")
    ax.plot(degrees, mean, color=PALETTE["blue"], label="mean of the stream")
    ax.fill_between(degrees, mean - half, mean + half, color=PALETTE["sky"], alpha=0.6, linewidth=0,
                    label="95 % of the mean, by sampling alone")  # fmt: skip
    best = nozzle.alpha
    ax.axvspan(*np.rad2deg([best.low, best.high]), color=PALETTE["orange"], alpha=0.35, linewidth=0)
    where, half = np.rad2deg((best.value, best.high - best.value))
    label = f"greatest at {with_error(where, half)}° (95 %, sampling alone)"
    ax.plot([np.rad2deg(best.value)], [nozzle.volume.value / scale.size], "*", color=PALETTE["orange"],
            markersize=13, markeredgecolor=INK, markeredgewidth=0.7, zorder=5, label=label)  # fmt: skip
    ax.set(xlim=(0, 90), ylim=(0, None), xlabel="angle of the nozzle",
           ylabel=f"{RESULTS['volume'].symbol}  of a particle  [{scale.unit}]")  # fmt: skip
    ax.set_xticks(range(0, 91, 15), [f"{tick}°" for tick in range(0, 91, 15)])
    legend_below([ax], 2)
    return ax
