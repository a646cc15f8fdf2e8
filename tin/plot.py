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
from tin.reproject import on_own_grid
from tin.transform import to_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tin.dem import DEM
    from tin.tin import Tin

Array = npt.NDArray[Any]

WIDTH, MIN_HEIGHT, MAX_HEIGHT = 13.0, 9.0, 15.0  # inches
DPI = 130
MAP_PIXELS = 800  # about what one map has on the screen, along its longer side
ERROR_BLOCKS = 250  # of the map of local errors: single ones would be a fine grain
MIN_SIDE = 4.0  # screen pixels: below it the sides of triangles merge into a grey
CLOSE_UP = 900  # triangles in the close-up
VOID_COLOUR = "#e4e4e4"
MESH_COLOUR = "#14324a"
LAND_COLOURS = ("#5f8f74", "#9db57f", "#d9cd98", "#bf9a6b", "#96755c", "#f2efec")  # low to high
OUTLINE_COLOUR = "#c1121f"
ERROR_COLOURS = "RdBu_r"
BLOCK_COLOURS = "YlOrRd"
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
        from matplotlib.layout_engine import ConstrainedLayoutEngine
    except ImportError as missing:
        raise OutputError(
            "missing-library", f"a picture needs matplotlib ({missing}): install it"
        ) from missing

    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12)
    shown = on_own_grid(tin)
    made = Figure(figsize=(WIDTH, _height(shown.dem)), dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(made)
    (terrain, errors), (close_up, histogram) = made.subplots(2, 2)
    _title(made, tin)
    error = signed_error(tin)
    limit = _robust_limit(error)
    _draw_histogram(histogram, tin, error, limit)
    error, tin = to_grid(tin, error)[0], shown
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

    _draw_errors(errors, tin, error, limit)
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


def _height(dem: DEM) -> float:
    """Inches that suit two rows of maps of the DEM's shape."""
    x, y = Window(0, 0, dem.rows, dem.cols).corners(dem).T
    shape = _aspect(dem) * np.ptp(y) / np.ptp(x)
    return float(np.clip(2.0 * (0.37 * WIDTH * shape + 0.8), MIN_HEIGHT, MAX_HEIGHT))


def _aspect(dem: DEM) -> float:
    """Length on the ground of a unit of the map's y, as a multiple of that of x."""
    a, b, _, d, e, _ = dem.transform
    along_x, _, along_y = dem.metric()
    return math.sqrt(along_y / (b * b + e * e)) / math.sqrt(along_x / (a * a + d * d))


def _close_up_window(tin: Tin) -> Window:
    """The window with the most vertices, for about CLOSE_UP triangles and nearly of the DEM's shape."""
    rows, cols = tin.dem.shape
    area = min(0.16, CLOSE_UP / max(1, len(tin.triangles))) * rows * cols
    shape = min(2.0, max(0.5, rows / cols))
    height = min(rows, max(4, round(math.sqrt(area * shape))))
    width = min(cols, max(4, round(math.sqrt(area / shape))))
    # Counted in cells of half a window, and summed over two by two of them.
    half = max(1, height // 2), max(1, width // 2)
    cell = (tin.pixels[:, ::-1] // half).astype(int)
    counts = np.zeros((rows // half[0] + 2, cols // half[1] + 2), dtype=int)
    np.add.at(counts, (cell[:, 0], cell[:, 1]), 1)
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
    crs = "no CRS" if tin.crs is None else f"{_printable(str(tin.crs))}"
    if tin.crs is not None and tin.crs.name not in ("", "unnamed", crs):
        crs += f" ({_printable(tin.crs.name)})"
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
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    step = _thinning(window, MAP_PIXELS)
    z = _block_means(window.of(tin.dem.z), step)
    shown = z[np.isfinite(z)]
    low, high = np.percentile(shown, (0.5, 99.5)) if shown.size else (0.0, 1.0)
    tint = LinearSegmentedColormap.from_list("land", LAND_COLOURS)
    scale = Normalize(low, high if high > low else low + 1.0)
    colours = tint(scale(np.where(np.isfinite(z), z, low)))
    shade = _hillshade(z, tin.dem, step)[..., None]
    colours[..., :3] = (0.7 * colours[..., :3] + 0.3) * (0.3 + 0.9 * shade)
    colours[..., 3] = np.isfinite(z)
    _draw_image(axes, tin.dem, window, np.clip(colours, 0.0, 1.0))
    if heights_shown:
        _colour_bar(axes, ScalarMappable(scale, tint), f"height{_unit(tin)}")


def _thinning(window: Window, most: int) -> int:
    """Side of the blocks of pixels to average for an image of at most ``most`` by ``most`` blocks."""
    return max(1, math.ceil(max(window.rows, window.cols) / most))


def _block_means(values: Array, step: int, power: int = 1) -> Array:
    """Mean of ``values ** power`` over the valid pixels of each block of ``step`` by ``step``, else NaN."""
    starts = np.arange(0, values.shape[1], step)
    means = np.full((-(-values.shape[0] // step), len(starts)), np.nan)
    for row, mean in enumerate(means):
        lines = values[row * step : (row + 1) * step].astype(np.float64)
        valid = np.isfinite(lines)
        total = np.add.reduceat(np.where(valid, lines**power, 0.0).sum(axis=0), starts)
        count = np.add.reduceat(valid.sum(axis=0), starts)
        np.divide(total, count, out=mean, where=count > 0)
    return means


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
    from matplotlib.ticker import StrMethodFormatter
    from matplotlib.transforms import Affine2D

    a, b, c, d, e, f = dem.transform
    extent = (window.col, window.col + window.cols, window.row + window.rows, window.row)
    settings = {"interpolation": "antialiased", "interpolation_stage": "rgba", **settings}
    shown = axes.imshow(image, extent=extent, **settings)
    shown.set_transform(Affine2D.from_values(a, d, b, e, c, f) + axes.transData)
    x, y = window.corners(dem).T
    axes.set_xlim(x.min(), x.max())
    axes.set_ylim(y.min(), y.max())
    axes.set_aspect(_aspect(dem))
    axes.set_facecolor(VOID_COLOUR)
    shape = _aspect(dem) * np.ptp(y) / np.ptp(x)
    axes.locator_params(axis="x", nbins=max(2, round(5 * min(1.0, 1.0 / shape))))
    axes.locator_params(axis="y", nbins=max(2, round(5 * min(1.0, shape))))
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


def _draw_frame(axes: Axes, dem: DEM, window: Window, width: float = 2.0) -> Any:
    from matplotlib.patches import Polygon

    frame = Polygon(window.corners(dem), fill=False, edgecolor="black", linewidth=width, zorder=3)
    axes.add_patch(frame)
    frame.set_clip_on(False)
    return frame


def _draw_mesh(axes: Axes, tin: Tin, window: Window, side: float) -> None:
    """The edges in ``window``, thinner where triangles are small; constraints in a colour of their own."""
    from matplotlib.collections import LineCollection

    x, y = window.corners(tin.dem).T
    place = tin.vertices[:, :2]
    corner = place[tin.triangles]
    seen = (corner.max(axis=1) >= (x.min(), y.min())) & (corner.min(axis=1) <= (x.max(), y.max()))
    triangles, constrained = tin.triangles[seen.all(axis=1)], tin.constrained[seen.all(axis=1)]
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    width, alpha = min(0.9, max(0.25, side / 30.0)), min(0.85, 0.4 + side / 60.0)
    frame = _draw_frame(axes, tin.dem, window, width=0.0)
    for chosen, colour, factor in ((~constrained, MESH_COLOUR, 1.0), (constrained, OUTLINE_COLOUR, 2.0)):
        unique = np.unique(edges[chosen], axis=0)
        lines = LineCollection(place[unique], colors=colour, linewidths=factor * width, alpha=alpha, zorder=2)
        axes.add_collection(lines, autolim=False)
        lines.set_clip_path(frame)


def _robust_limit(error: Array) -> float:
    """Half the width of the scale: nearly all errors, so that a few outliers do not bleach the rest."""
    step = max(1, math.isqrt(error.size // 1_000_000))
    sample = np.abs(error[::step, ::step])
    sample = sample[np.isfinite(sample)]
    limit = float(np.percentile(sample, 99.0)) if sample.size else 0.0
    return limit or float(sample.max(initial=0.0)) or 1.0


def _draw_errors(axes: Axes, tin: Tin, error: Array, limit: float) -> None:
    """The signed error of every pixel; where the screen has too few, the root mean square of blocks."""
    whole = Window(0, 0, tin.dem.rows, tin.dem.cols)
    if _thinning(whole, MAP_PIXELS) == 1:
        shown = _draw_image(axes, tin.dem, whole, error, cmap=ERROR_COLOURS, vmin=-limit, vmax=limit)
        _colour_bar(axes, shown, f"TIN − DEM{_unit(tin)}: blue is too low, red too high", extend="both")
        axes.set_title("Error (ring: the largest)")
    else:
        # Signed errors change within a screen pixel: one by one they mix to a grey, and means to nothing.
        step = _thinning(whole, ERROR_BLOCKS)
        blocks = np.sqrt(_block_means(error, step, power=2))
        most = _robust_limit(blocks)
        shown = _draw_image(axes, tin.dem, whole, blocks, cmap=BLOCK_COLOURS, vmin=0.0, vmax=most)
        _colour_bar(axes, shown, f"RMSE in {step} × {step} pixels{_unit(tin)}", extend="max")
        axes.set_title("Local RMSE (ring: the largest error)")
    if np.isfinite(error).any():
        row, col = np.unravel_index(np.nanargmax(np.abs(error)), error.shape)
        x, y = tin.dem.pixel_to_map(np.array([col]), np.array([row]))
        axes.plot(x, y, "o", markersize=12, markerfacecolor="none", markeredgecolor="black", clip_on=False)


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
    notes = [f"{covered:,} pixels"]
    if outside > 0.005:
        notes.append(f"{outside:.2g} % beyond the axis")
    if tin.report.spikes:
        without = tin.report.max_error_without_spikes
        notes.append(f"spikes taken out: {tin.report.spikes:,}\nmax without them: {without:.4g}")
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
