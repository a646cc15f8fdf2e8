"""The TIN, and the function that makes it from a DEM."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin import _core, options
from tin.constraints import constraints
from tin.dem import DEM
from tin.errors import InputError, OptionError
from tin.metrics import Errors, Report

if TYPE_CHECKING:
    from tin.crs import CRS

Progress = Callable[[str, float], Any]
"""Called with the stage's name and the fraction of it that is done; a false answer cancels the run."""


class Tin:
    """A triangulated irregular network over a DEM; made by ``triangulate``, never changed."""

    dem: DEM
    """The DEM it was made of."""
    vertices: npt.NDArray[np.float64]
    """(n, 3) map x, y and height z, in the units of the CRS and the DEM's vertical unit."""
    triangles: npt.NDArray[np.uint32]
    """(m, 3) vertex numbers, counter-clockwise in map coordinates."""
    pixels: npt.NDArray[np.float64]
    """(n, 2) column and row of each vertex; pixel centres are whole numbers."""
    constrained: npt.NDArray[np.bool_]
    """(m, 3) whether the edge from corner k to corner k + 1 is a constraint, such as the data's outline."""
    triangle_errors: npt.NDArray[np.float64]
    """(m,) the largest absolute error of the DEM's pixels in each triangle."""
    report: Report

    def __init__(
        self,
        core: _core.Mesh,
        dem: DEM,
        seconds: float,
        progress: Progress | None = None,
        warnings: Sequence[str] = (),
    ) -> None:
        self._core = core
        self.dem = dem
        self.pixels = core.pixels()
        x, y = dem.pixel_to_map(self.pixels[:, 0], self.pixels[:, 1])
        self.vertices = np.column_stack([x, y, core.heights()])
        a, b, _, d, e, _ = dem.transform
        # A transform that mirrors (rows downwards: nearly all) turns the core's corners around.
        turn = slice(None, None, -1) if a * e - b * d < 0 else slice(None)
        self.triangles = np.ascontiguousarray(core.triangles()[:, turn])
        constrained = core.constrained()
        # Edge k joins corners k and k + 1: turned around, corners are 2 1 0 and edges 1 0 2.
        self.constrained = constrained if turn == slice(None) else constrained[:, [1, 0, 2]]
        errors, self.triangle_errors = core.errors(dem.z, progress)
        self._errors = Errors(**errors)
        self.report = replace(self._report(seconds, progress), warnings=list(warnings))
        self._set(
            dem.crs,
            vertices=self.vertices,
            triangles=self.triangles,
            pixels=self.pixels,
            constrained=self.constrained,
            triangle_errors=self.triangle_errors,
        )

    def _set(self, crs: CRS | None, **arrays: npt.NDArray[Any]) -> None:
        """Take over the arrays, and the CRS that they are in."""
        self._crs = crs
        for name, array in arrays.items():
            array.flags.writeable = False
            setattr(self, name, array)

    def _report(self, seconds: float, progress: Progress | None) -> Report:
        spikes = self._core.spikes()
        without = self._errors.max_error
        if len(spikes):
            kept = self.dem.z.copy()
            kept.ravel()[spikes] = np.nan
            without = self._core.errors(kept, progress)[0]["max_error"]
        return Report(
            points=len(self.vertices),
            triangles=len(self.triangles),
            stop_reason=self._core.stop_reason,
            errors=self._errors,
            max_error_without_spikes=without,
            spikes=len(spikes),
            noise=self._core.noise,
            scales=self._core.scales,
            delaunay=self._core.delaunay,
            seconds=seconds,
            crs=str(self.dem.crs) if self.dem.crs else None,
            vertical_unit=self.dem.vertical_unit,
        )

    @property
    def crs(self) -> CRS | None:
        """That of the vertices: the DEM's, unless ``to_crs`` changed it."""
        return self._crs

    @property
    def name(self) -> str:
        """That of the DEM."""
        return self.dem.name

    @cached_property
    def spikes(self) -> npt.NDArray[np.bool_]:
        """(rows, cols) the pixels that despiking replaced."""
        spikes = np.zeros(self.dem.shape, dtype=bool)
        spikes.ravel()[self._core.spikes()] = True
        return spikes

    def error(self) -> Errors:
        """RMSE, MAE, P95 and largest error against the DEM."""
        return self._errors

    def rasterize(self, dtype: npt.DTypeLike = np.float64) -> npt.NDArray[np.floating[Any]]:
        """(rows, cols) heights of the TIN on the DEM's pixel centres, NaN where there is no triangle.

        Always the DEM's own grid, in the DEM's CRS, also after ``to_crs``.
        """
        if np.dtype(dtype) not in (np.float32, np.float64):
            raise OptionError(
                "bad-option", f"a raster of heights is float32 or float64, not {np.dtype(dtype)}"
            )
        single = np.dtype(dtype) == np.float32
        return self._core.rasterize_f32() if single else self._core.rasterize_f64()

    def check(self) -> None:
        """Prove the mesh: orientation, adjacency, Euler's formula, exact area, Delaunay edges.

        Raises RuntimeError, naming the first property that does not hold.
        """
        self._core.check()

    def to_crs(self, crs: Any) -> Tin:
        """Return the TIN in another CRS: vertices are moved, heights and their unit stay as they are.

        Args:
            crs: anything ``CRS.parse`` takes, such as "EPSG:26710", or "utm": the WGS 84 / UTM zone of the
                DEM's centre (UPS beyond 84 degrees north and 80 south). Of a compound CRS it is the
                horizontal part.

        Everything written afterwards follows; ``dem``, ``rasterize`` and the errors stay those of the DEM.
        Edges that would be more than a pixel off in the other CRS are split, so there may be a few more
        vertices; a part of a triangle keeps the whole one's largest error.

        Raises:
            InputError: "no-crs", "bad-crs", "outside-crs" (points that have no place there), "turned-over"
                (the TIN would be torn, as across the antimeridian), "missing-library" without rasterio.
        """
        from tin.reproject import to_crs

        return to_crs(self, crs)

    def outline(self) -> list[list[npt.NDArray[np.float64]]]:
        """Return the polygons of the area that the triangles cover: parts that no edge connects.

        Each polygon is a list of closed rings (k, 3) of x, y and z: the exterior, counter-clockwise, and then
        the holes, clockwise. They are valid; rings and parts may touch each other in vertices.
        """
        from tin.outline import exterior_first, rings

        return [exterior_first([self.vertices[ring] for ring in part]) for part in rings(self.triangles)]

    def write(self, path: str | os.PathLike[str], *, overwrite: bool = False, **choices: Any) -> None:
        """Write to ``path`` in the format of its suffix (.gpkg, .obj, .tif, ...); all of it or nothing.

        Raises OutputError, see ``tin.formats.write``.
        """
        from tin import formats

        formats.write(self, path, overwrite=overwrite, **choices)

    def plot(self) -> Any:
        """A matplotlib Figure: hillshade, mesh, error map and error histogram; see ``tin.plot``."""
        from tin.plot import figure

        return figure(self)

    def to_geodataframe(self) -> Any:
        """A geopandas.GeoDataFrame: POLYGON Z a triangle, with the attributes of the GeoPackage.

        Raises InputError ``missing-library`` without geopandas and shapely.
        """
        from tin.formats.attributes import attributes

        try:
            import geopandas
            import shapely
        except ImportError as error:
            raise InputError(
                "missing-library", f"to_geodataframe needs geopandas and shapely: {error}"
            ) from error
        corners = self.vertices[self.triangles]
        rings = np.concatenate([corners, corners[:, :1]], axis=1)
        return geopandas.GeoDataFrame(attributes(self), geometry=shapely.polygons(rings), crs=self.crs)

    def __repr__(self) -> str:
        return f"<Tin {self.name or 'unnamed'}: {len(self.vertices)} points, {len(self.triangles)} triangles>"


def triangulate(
    dem: DEM,
    *,
    breaklines: Any = None,
    points: Any = None,
    clip: Any = None,
    flat: Any = None,
    soft: bool = False,
    allow_remote: bool = False,
    progress: Progress | None = None,
    **keywords: Any,
) -> Tin:
    """Make a TIN of a DEM.

    Breaklines, points, clip and flat take the name of a vector file, a GeoDataFrame, shapely geometries or
    arrays of map coordinates (see ``tin.features``), transformed to the CRS of the DEM if they have another.

    Args:
        dem: the heights.
        breaklines: lines that are edges of the TIN. Where their vertices have a height, in the DEM's vertical
            unit, the TIN keeps it and runs straight between them; else it has that of the DEM.
        points: points that are vertices from the start (P_I of Algorithm 1). With a height they keep place
            and height; else they are moved to the nearest pixel centre.
        clip: polygons; what lies outside is left out, and their boundary consists of edges.
        flat: polygons that are kept level, such as lakes: at their own height, or at the DEM's median there.
        soft: ignore the heights of breaklines and points.
        allow_remote: also read vector files from the network.
        progress: called with (stage, fraction); a false answer cancels.
        keywords: the options of the group "method" in ``tin.options.OPTIONS``.

    Raises:
        OptionError: "bad-option", "unknown-option".
        InputError: "not-a-dem", "too-small", "no-area", "too-large", "clip-outside", and those of
            ``tin.features``.
        Cancelled: the callback asked to stop.
    """
    if not isinstance(dem, DEM):
        kind = type(dem).__name__
        raise InputError("not-a-dem", f"a {kind} is no DEM: tin.open(path) or tin.DEM(array, ...) makes one")
    start = time.perf_counter()
    arguments = options.core_arguments(keywords, dem)
    followed = constraints(
        dem,
        breaklines=breaklines,
        points=points,
        clip=clip,
        flat=flat,
        soft=soft,
        allow_remote=allow_remote,
    )
    core = _core.triangulate(dem.z, dem.metric(), progress=progress, **arguments, **followed.core_arguments())
    warnings = [*dem.warnings(), *followed.warnings]
    return Tin(core, dem, time.perf_counter() - start, progress, warnings)
