"""One picture of a TIN: the terrain, the mesh over it, where it errs and by how much.

matplotlib is imported when a figure is made, and without pyplot, so that this works in
threads, in QGIS and without a display.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin.errors import OutputError
from tin.formats.geotiff import signed_error

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tin.dem import DEM
    from tin.tin import Tin

Array = npt.NDArray[Any]

SIZE = (13.0, 11.0)  # inches
DPI = 130
MAP_PIXELS = 800  # about what one map has on the screen, along its longer side
MIN_SIDE = 4.0  # screen pixels: below it the sides of triangles merge into a grey
CLOSE_UP = 900  # triangles in the close-up
VOID_COLOUR = "#e4e4e4"
MESH_COLOUR = "#14324a"
OUTLINE_COLOUR = "#c1121f"
ERROR_COLOURS = "RdBu_r"
SUN_AZIMUTH, SUN_ALTITUDE = math.radians(315.0), math.radians(45.0)


def figure(tin: Tin) -> Figure:
    """Draw the terrain with the mesh, a close-up of the mesh, the error map and the histogram of the errors.

    Large DEMs are thinned out for the display. The mesh is drawn over the whole map only where its
    triangles can be told apart; the close-up, framed in the map, always shows it.

    Raises OutputError ``missing-library`` without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError("missing-library", f"a picture needs matplotlib ({error}): install it") from error

    made = Figure(figsize=SIZE, dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(made)
    (terrain, errors), (close_up, histogram) = made.subplots(2, 2)
    _title(made, tin)
    whole = Window(0, 0, tin.dem.rows, tin.dem.cols)
    near = _close_up_window(tin)

    _draw_terrain(terrain, tin, whole, heights_shown=True)
    _draw_frame(terrain, tin.dem, near)
    side = _screen_side(tin, whole)
    if side >= MIN_SIDE:
        _draw_mesh(terrain, tin, whole, side)
    terrain.set_title("Terrain and mesh" if side >= MIN_SIDE else "Terrain (the mesh is too fine to show)")

    _draw_terrain(close_up, tin, near, heights_shown=False)
    _draw_mesh(close_up, tin, near, _screen_side(tin, near))
    close_up.set_title("Mesh, close-up of the frame")

    error = signed_error(tin)
    limit = _robust_limit(error)
    _draw_errors(errors, tin, error, limit)
    _draw_histogram(histogram, tin, error, limit)
    return made


@dataclass(frozen=True)
class Window:
    """A part of the grid, in pixels."""

    row: int
    col: int
    rows: int
    cols: int

    def of(self, grid: Array) -> Array:
        """The pixels of ``grid`` in the window."""
        return grid[self.row : self.row + self.rows, self.col : self.col + self.cols]

    def corners(self, dem: DEM) -> Array:
        """(4, 2) map x, y of the corners, in turn."""
        col = np.array([0, self.cols, self.cols, 0]) + self.col - 0.5
        row = np.array([0, 0, self.rows, self.rows]) + self.row - 0.5
        return np.column_stack(dem.pixel_to_map(col, row))


def _close_up_window(tin: Tin) -> Window:
    """The window of the DEM's shape, with about CLOSE_UP triangles, that has the most vertices."""
    rows, cols = tin.dem.shape
    share = min(0.4, math.sqrt(CLOSE_UP / max(1, len(tin.triangles))))
    height, width = (max(min(4, n), round(share * n)) for n in (rows, cols))
    # Counted in cells of half a window, and summed over two by two of them.
    half = max(1, height // 2), max(1, width // 2)
    shape = rows // half[0] + 1, cols // half[1] + 1
    cell = (tin.pixels[:, ::-1] // half).astype(int)
    counts = np.bincount(cell[:, 0] * shape[1] + cell[:, 1], minlength=shape[0] * shape[1]).reshape(shape)
    sums = counts[:-1, :-1] + counts[1:, :-1] + counts[:-1, 1:] + counts[1:, 1:]
    row, col = np.unravel_index(np.argmax(sums), sums.shape)
    return Window(
        min(int(row) * half[0], rows - height), min(int(col) * half[1], cols - width), height, width
    )


def _screen_side(tin: Tin, window: Window) -> float:
    """About how many screen pixels the side of a triangle in ``window`` has."""
    inside = (np.abs(tin.pixels - (window.col, window.row) - _half(window)) <= _half(window)).all(axis=1)
    triangles = max(1, 2 * int(inside.sum()))
    scale = MAP_PIXELS / max(window.rows, window.cols)
    return math.sqrt(2.0 * window.rows * window.cols / triangles) * scale


def _half(window: Window) -> Array:
    return np.array([window.cols, window.rows]) / 2.0


def _title(made: Figure, tin: Tin) -> None:
    dem = tin.dem
    name = _printable(tin.name) or "TIN"
    points, triangles = len(tin.vertices), len(tin.triangles)
    made.suptitle(
        f"{name}: {points:,} points, {triangles:,} triangles", fontsize=17, weight="bold", parse_math=False
    )
    crs = "no CRS" if dem.crs is None else f"{_printable(str(dem.crs))}"
    if dem.crs is not None and dem.crs.name and dem.crs.name not in crs:
        crs += f" ({_printable(dem.crs.name)})"
    share = 100.0 * points / max(1, dem.n_valid)
    text = f"{dem.cols:,} × {dem.rows:,} pixels, {share:.3g} % of the valid ones are vertices  ·  {crs}"
    # In the place of an axis label, which constrained layout keeps clear of the maps.
    made.supxlabel(text, fontsize=11, color="#444444", parse_math=False)


def _printable(text: str) -> str:
    """``text`` in one line, with a box for what the font has no glyph of (matplotlib would warn)."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    known = get_font(findfont(FontProperties())).get_charmap()
    return "".join(c if ord(c) in known else "\N{WHITE SQUARE}" for c in " ".join(text.split()))


def _unit(tin: Tin) -> str:
    return f" ({_printable(tin.dem.vertical_unit)})" if tin.dem.vertical_unit else ""


def _draw_terrain(axes: Axes, tin: Tin, window: Window, *, heights_shown: bool) -> None:
    """Hillshade of ``window`` over a tint by height."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    z, step = _thinned(window.of(tin.dem.z))
    shown = z[np.isfinite(z)]
    low, high = np.percentile(shown, (0.5, 99.5)) if shown.size else (0.0, 1.0)
    tint = LinearSegmentedColormap.from_list("land", colormaps["gist_earth"](np.linspace(0.3, 0.92, 64)))
    scale = Normalize(low, high if high > low else low + 1.0)
    colours = tint(scale(np.where(np.isfinite(z), z, low)))
    shade = _hillshade(z, tin.dem, step)[..., None]
    colours[..., :3] = (0.45 * colours[..., :3] + 0.55) * (0.35 + 0.65 * shade)
    colours[..., 3] = np.isfinite(z)
    _draw_image(axes, tin.dem, window, np.clip(colours, 0.0, 1.0))
    if heights_shown:
        _colour_bar(axes, ScalarMappable(scale, tint), f"height{_unit(tin)}")


def _thinned(z: Array) -> tuple[Array, int]:
    """``z`` as float64, averaged over blocks so that it is not much larger than a map on the screen."""
    step = max(1, math.ceil(max(z.shape) / MAP_PIXELS))
    if step == 1:
        return z.astype(np.float64), 1
    rows, cols = (-(-n // step) for n in z.shape)
    thin = np.full((rows, cols), np.nan)
    for row in range(rows):
        lines = z[row * step : (row + 1) * step]
        valid = np.isfinite(lines)
        starts = np.arange(0, z.shape[1], step)
        total = np.add.reduceat(np.where(valid, lines, 0.0).sum(axis=0, dtype=np.float64), starts)
        count = np.add.reduceat(valid.sum(axis=0), starts)
        np.divide(total, count, out=thin[row], where=count > 0)
    return thin, step


def _hillshade(z: Array, dem: DEM, step: int) -> Array:
    """Brightness from 0 to 1 of a surface lit from the map's north-west, as steep as makes it readable."""
    if min(z.shape) < 2:
        return np.ones_like(z)
    down, across = np.gradient(z)
    # From slopes along the grid to slopes along the map's x and y, in ground units.
    a, b, _, d, e, _ = dem.transform
    along_x, _, along_y = dem.metric()
    unit_x, unit_y = (math.sqrt(along_x) / math.hypot(a, d), math.sqrt(along_y) / math.hypot(b, e))
    turn = np.linalg.inv(np.array([[a * unit_x, d * unit_y], [b * unit_x, e * unit_y]]) * step)
    east, north = turn[0, 0] * across + turn[0, 1] * down, turn[1, 0] * across + turn[1, 1] * down
    steepness = np.nanpercentile(np.hypot(east, north), 90) if np.isfinite(east).any() else 0.0
    # Exaggerated to a typical slope of 35 degrees: units may be unknown, and plains should show their relief.
    lift = math.tan(math.radians(35.0)) / steepness if steepness > 0.0 else 1.0
    east, north = np.nan_to_num(lift * east), np.nan_to_num(lift * north)
    light = math.sin(SUN_ALTITUDE) - math.cos(SUN_ALTITUDE) * (
        east * math.sin(SUN_AZIMUTH) + north * math.cos(SUN_AZIMUTH)
    )
    return np.asarray(np.clip(light / np.sqrt(1.0 + east**2 + north**2), 0.0, 1.0))


def _draw_image(axes: Axes, dem: DEM, window: Window, image: Array, **settings: Any) -> Any:
    """``image`` where ``window`` lies on the map, for any geotransform."""
    from matplotlib.transforms import Affine2D
    from matplotlib.ticker import StrMethodFormatter

    a, b, c, d, e, f = dem.transform
    extent = (window.col, window.col + window.cols, window.row + window.rows, window.row)
    settings = {"interpolation": "antialiased", "interpolation_stage": "rgba", **settings}
    shown = axes.imshow(image, extent=extent, **settings)
    shown.set_transform(Affine2D.from_values(a, d, b, e, c, f) + axes.transData)
    x, y = window.corners(dem).T
    axes.set_xlim(x.min(), x.max())
    axes.set_ylim(y.min(), y.max())
    along_x, _, along_y = dem.metric()
    axes.set_aspect(math.sqrt(along_y / (b * b + e * e)) / math.sqrt(along_x / (a * a + d * d)))
    axes.set_facecolor(VOID_COLOUR)
    axes.locator_params(nbins=5)
    axes.tick_params(labelsize=8)
    is_degrees = dem.crs is not None and dem.crs.is_geographic
    names = (
        ("longitude", "latitude")
        if is_degrees
        else ("x", "y")
        if dem.crs is None
        else ("easting", "northing")
    )
    unit = f" ({_printable(dem.crs.unit_name)})" if dem.crs is not None else ""
    axes.set_xlabel(names[0] + unit, fontsize=9)
    axes.set_ylabel(names[1] + unit, fontsize=9)
    for axis in (axes.xaxis, axes.yaxis):
        # 5,118,400 and not 1.4e1+5.1184e6.
        axis.set_major_formatter(StrMethodFormatter("{x:g}" if is_degrees else "{x:,.10g}"))
    return shown


def _colour_bar(axes: Axes, colours: Any, label: str, **settings: Any) -> None:
    bar = axes.figure.colorbar(colours, ax=axes, shrink=0.8, pad=0.02, aspect=28, **settings)
    bar.set_label(label, fontsize=9, parse_math=False)
    bar.ax.tick_params(labelsize=8)


def _draw_frame(axes: Axes, dem: DEM, window: Window) -> None:
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(window.corners(dem), fill=False, edgecolor="black", linewidth=1.6, zorder=3))


def _draw_mesh(axes: Axes, tin: Tin, window: Window, side: float) -> None:
    """The edges in ``window``, thinner where triangles are small; constraints in a colour of their own."""
    from matplotlib.collections import LineCollection

    x, y = window.corners(tin.dem).T
    place = tin.vertices[:, :2]
    corner = place[tin.triangles]
    seen = (corner.max(axis=1) >= (x.min(), y.min())) & (corner.min(axis=1) <= (x.max(), y.max()))
    triangles, constrained = tin.triangles[seen.all(axis=1)], tin.constrained[seen.all(axis=1)]
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    width = min(0.9, max(0.25, side / 25.0))
    for chosen, colour, factor in ((~constrained, MESH_COLOUR, 1.0), (constrained, OUTLINE_COLOUR, 2.0)):
        unique = np.unique(edges[chosen], axis=0)
        axes.add_collection(
            LineCollection(place[unique], colors=colour, linewidths=factor * width, alpha=0.85, zorder=2),
            autolim=False,
        )


def _robust_limit(error: Array) -> float:
    """Half the width of the scale: nearly all errors, so that a few outliers do not bleach the rest."""
    step = max(1, math.isqrt(error.size // 1_000_000))
    sample = np.abs(error[::step, ::step])
    sample = sample[np.isfinite(sample)]
    limit = float(np.percentile(sample, 99.0)) if sample.size else 0.0
    return limit or float(sample.max(initial=0.0)) or 1.0


def _draw_errors(axes: Axes, tin: Tin, error: Array, limit: float) -> None:
    from matplotlib.colors import Normalize

    # Every n-th pixel as it is: averages would hide the errors, extremes exaggerate them.
    step = max(1, math.ceil(max(error.shape) / (2 * MAP_PIXELS)))
    whole = Window(0, 0, tin.dem.rows, tin.dem.cols)
    thin = np.ma.masked_invalid(error[::step, ::step])
    shown = _draw_image(axes, tin.dem, whole, thin, cmap=ERROR_COLOURS, norm=Normalize(-limit, limit))
    _colour_bar(axes, shown, f"TIN − DEM{_unit(tin)}: blue is too low, red too high", extend="both")
    axes.set_title("Error")
    if np.isfinite(error).any():
        row, col = np.unravel_index(np.nanargmax(np.abs(error)), error.shape)
        x, y = tin.dem.pixel_to_map(np.array([col]), np.array([row]))
        axes.plot(x, y, "o", markersize=11, markerfacecolor="none", markeredgecolor="black")
        axes.plot([], [], "o", markerfacecolor="none", markeredgecolor="black", label="largest error")
        axes.legend(loc="lower right", fontsize=8, framealpha=0.8)


def _draw_histogram(axes: Axes, tin: Tin, error: Array, limit: float) -> None:
    from matplotlib import colormaps

    edges = np.linspace(-1.5 * limit, 1.5 * limit, 76)
    counts = np.zeros(len(edges) - 1)
    covered = 0
    for rows in np.array_split(error, max(1, error.size // 2**22)):  # the copies stay small
        finite = rows[np.isfinite(rows)]
        covered += finite.size
        counts += np.histogram(finite, edges)[0]
    shares = 100.0 * counts / max(1, covered)
    middle = (edges[1:] + edges[:-1]) / 2
    colours = colormaps[ERROR_COLOURS](0.5 + middle / (2 * limit))
    axes.bar(middle, shares, np.diff(edges), color=colours, edgecolor="#555555", linewidth=0.4)
    errors = tin.error()
    for sign in (-1, 1):
        axes.axvline(sign * errors.rmse, color="black", linestyle="--", linewidth=1)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel(f"TIN − DEM{_unit(tin)}", fontsize=9, parse_math=False)
    axes.set_ylabel("pixels (%)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_title("Errors (dashed: ± RMSE)")
    axes.spines[["top", "right"]].set_visible(False)
    lines = [
        f"RMSE {errors.rmse:9.4g}",
        f"MAE  {errors.mae:9.4g}",
        f"P95  {errors.p95:9.4g}",
        f"max  {errors.max_error:9.4g}",
        f"mean {errors.mean:+9.2g}",
    ]
    axes.text(
        0.98, 0.97, "\n".join(lines), transform=axes.transAxes, ha="right", va="top", family="monospace",
        fontsize=12, bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "#999999"},
    )  # fmt: skip
    outside = 100.0 - shares.sum() if covered else 0.0
    notes = (
        [f"{covered:,} pixels", f"{outside:.2g} % beyond the axis"]
        if outside > 0.005
        else [f"{covered:,} pixels"]
    )
    if tin.report.spikes:
        notes.append(
            f"{tin.report.spikes:,} spikes taken out,\nmax without them {tin.report.max_error_without_spikes:.4g}"
        )
    if errors.uncovered:
        notes.append(f"{errors.uncovered:,} valid pixels not covered")
    axes.text(
        0.02,
        0.97,
        "\n".join(notes),
        transform=axes.transAxes,
        ha="left",
        va="top",
        fontsize=9,
        color="#444444",
    )
