"""Breaklines, spot heights and areas that a TIN follows, from files, geometries or arrays.

Every function takes the same kinds of value:

* the name of a vector file, FILE or FILE:LAYER,
* a GeoDataFrame or GeoSeries, or anything else with ``crs`` that holds geometries,
* a shapely geometry, or anything with ``__geo_interface__``, also GeoJSON as a mapping,
* (n, 2) or (n, 3) map coordinates x, y and perhaps z, as an array or nested lists: the points, one line, or
  the exterior ring of one polygon, which need not be closed,
* an iterable of these. A list of rings within it is a polygon with holes, the exterior first.

What knows its CRS is transformed to that of the DEM, in x and y; z stays as it is. All else is taken for map
coordinates of the DEM.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tin import shapes, vector
from tin.crs import CRS
from tin.errors import InputError
from tin.shapes import Coordinates, Shapes

if TYPE_CHECKING:
    from tin.dem import DEM

_NAMES = {shapes.POINTS: "points", shapes.LINE: "lines", shapes.EXTERIOR: "polygons", shapes.HOLE: "polygons"}
_KNOWN = "a vector file, a GeoDataFrame, shapely geometries, or (n, 2) or (n, 3) map coordinates"


def points(
    value: Any,
    crs: CRS | None,
    *,
    label: str = "points",
    allow_remote: bool = False,
    keep_lost: bool = False,
) -> Coordinates:
    """The points, also those of multipoints, whose x and y are finite.

    Args:
        value: see the module.
        crs: that of the DEM.
        label: what messages call a value that is no file.
        allow_remote: also read files from the network.
        keep_lost: also give the points that cannot be transformed, infinitely far away.

    Returns:
        (n, 3) map x, y and z; z is NaN where there is none or it is not finite.

    Raises:
        InputError: "not-points", "bad-features", "bad-crs", and the codes of `vector.read`.
    """
    found = gather(value, crs, shapes.POINTS, label, allow_remote)
    if not keep_lost:
        return _finite(found)[0]
    xyz = found.xyz[~np.isnan(found.xyz[:, :2]).any(axis=1)]
    xyz[~np.isfinite(xyz[:, 2]), 2] = np.nan
    return xyz


def lines(
    value: Any, crs: CRS | None, *, label: str = "breaklines", allow_remote: bool = False
) -> list[Coordinates]:
    """The lines, and the rings of polygons, as polylines.

    A line is cut at vertices whose x or y is not finite. Vertices that repeat the one before are left out,
    and so is what then has fewer than two.

    Returns:
        (n, 3) map x, y and z of each, n >= 2; z is NaN where there is none or it is not finite.

    Raises:
        InputError: "not-lines", "bad-features", "bad-crs", and the codes of `vector.read`.
    """
    found = gather(value, crs, shapes.LINE, label, allow_remote)
    xyz, path, place = _finite(found)
    starts = np.r_[True, (np.diff(path) != 0) | (np.diff(place) != 1)][: len(xyz)]
    return _split(*_without_repeats(xyz, np.cumsum(starts) - 1), at_least=2)


def areas(
    value: Any, crs: CRS | None, *, label: str = "polygons", allow_remote: bool = False
) -> list[list[Coordinates]]:
    """The polygons, made valid: one that crosses itself becomes several.

    Vertices whose x or y is not finite are left out, and what has no area. Without shapely, as in QGIS, the
    rings stay as they are, only closed; the core gives the same TIN for valid ones, however they turn.

    Returns:
        the closed rings of each polygon, the exterior first and counter-clockwise, the holes clockwise:
        (n, 3) map x, y and z; z is NaN unless all vertices of the polygon have one.

    Raises:
        InputError: "not-polygons", "bad-features", "bad-crs", and the codes of `vector.read`.
    """
    found = gather(value, crs, shapes.EXTERIOR, label, allow_remote)
    xyz, ring, owner = _rings(found)
    if not len(xyz):
        return []
    try:
        import shapely
    except ImportError:
        return _closed(xyz, ring, owner)
    with np.errstate(invalid="ignore"):  # where z is NaN
        polygons = _valid(shapely.polygons(shapely.linearrings(xyz, indices=ring), indices=owner))
    rings, owners = shapely.get_rings(polygons, return_index=True)
    is_exterior = np.r_[True, np.diff(owners) != 0][: len(rings)]
    wrong = shapely.is_ccw(rings) != is_exterior
    rings[wrong] = shapely.reverse(rings[wrong])
    xyz, ring = shapely.get_coordinates(rings, include_z=True, return_index=True)
    parts = _split(_z_of_all(xyz, owners[ring]), ring)
    ends = [*np.flatnonzero(is_exterior).tolist(), len(parts)]
    return [parts[start:end] for start, end in zip(ends, ends[1:])]


def to_pixels(dem: DEM, xyz: Coordinates) -> Coordinates:
    """(n, 3) column, row and z of (n, 3) map x, y and z; whole numbers are pixel centres."""
    return np.column_stack([*dem.map_to_pixel(xyz[:, 0], xyz[:, 1]), xyz[:, 2]])


def gather(value: Any, crs: CRS | None, kind: int, label: str, allow_remote: bool = False) -> Shapes:
    """The shapes of any value, transformed, before cleaning; what cannot be transformed is infinite.

    `kind` is the one needed, POINTS, LINE or EXTERIOR, and that of plain arrays.
    """
    if isinstance(value, (str, os.PathLike)):
        label = os.fsdecode(value)
        found, own = vector.read(label, allow_remote=allow_remote)
    elif hasattr(value, "crs"):
        own = CRS.parse(value.crs or None)
        found = _collected(getattr(value, "geometry", value), crs, kind, label, allow_remote)
    else:
        return _collected(value, crs, kind, label, allow_remote)
    _check(found, kind, label)
    return _transformed(found, own, crs, label)


def _collected(value: Any, crs: CRS | None, kind: int, label: str, allow_remote: bool) -> Shapes:
    """The shapes of Python objects, by a way that has no loop over vertices where they are many."""
    shapely = sys.modules.get("shapely")  # where it is not loaded, there are none of its geometries
    if shapely is not None and isinstance(value, shapely.Geometry):
        value = [value]
    elif not _is_series(value):
        mapping = value if isinstance(value, dict) else getattr(value, "__geo_interface__", None)
        if isinstance(mapping, dict):
            return _check(_mapping(mapping, label), kind, label)
    depth = _depth(value)
    if depth in (2, 3, 4) or (depth == 1 and np.size(value) == 0):
        return _arrays(value, depth, kind, label)
    if depth > 0 or not isinstance(value, Iterable) or isinstance(value, (bytes, bytearray)):
        raise InputError("bad-features", f"{label}: {_told(value)} is not understood; give {_KNOWN}")
    items = [item for item in value if item is not None]
    if shapely is not None and all(isinstance(item, shapely.Geometry) for item in items):
        return _check(shapes.from_shapely(np.array(items, dtype=object)), kind, label)
    if not isinstance(value, (list, tuple)) and any(isinstance(item, str) for item in items):
        # The columns of a table without geometries are no files.
        raise InputError("bad-features", f"{label}: {_told(value)} holds texts; give {_KNOWN}")
    if kind == shapes.EXTERIOR:
        items = [[item] if _depth(item) == 3 else item for item in items]  # one polygon, not several
    return shapes.concatenate([gather(item, crs, kind, label, allow_remote) for item in items])


def _is_series(value: Any) -> bool:
    # Their mapping would be made feature by feature; taken as an iterable they are read in bulk.
    return hasattr(type(value), "geom_type") and hasattr(type(value), "__len__")


def _told(value: Any) -> str:
    shape = getattr(value, "shape", None)
    return f"a {type(value).__name__}" + (f" of shape {shape}" if isinstance(shape, tuple) else "")


def _mapping(value: dict[str, Any], label: str) -> Shapes:
    collector = shapes.Collector()
    try:
        collector.add(value)
        return collector.shapes()
    except InputError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError("bad-features", f"{label}: not a GeoJSON geometry ({error!r})") from error


def _depth(value: Any) -> int:
    """How many axes nested lists or an array of numbers have; below 0 where they hold anything else."""
    depth = 0
    if (
        isinstance(value, (list, tuple))
        and len({isinstance(i, (list, tuple, np.ndarray)) for i in value}) > 1
    ):
        return -99
    while isinstance(value, (list, tuple)):
        depth += 1
        if not len(value):
            return depth
        value = next((item for item in value if not isinstance(item, (list, tuple)) or len(item)), [])
    if isinstance(value, np.ndarray):
        return depth + value.ndim if value.dtype.kind in "iuf" else -99
    return depth if depth and isinstance(value, (int, float, np.number)) else -99


def _arrays(value: Any, depth: int, kind: int, label: str) -> Shapes:
    try:
        if depth < 3:
            paths, kinds = [_positions(value)], [kind]
        elif kind == shapes.EXTERIOR:
            polygons = [polygon if _depth(polygon) > 2 else [polygon] for polygon in value]
            paths = [_positions(ring) for polygon in polygons for ring in polygon]
            kinds = [shapes.HOLE if index else kind for polygon in polygons for index in range(len(polygon))]
        else:
            paths = [_positions(path) for path in value]
            kinds = [kind] * len(paths)
    except (TypeError, ValueError) as error:
        raise InputError("bad-features", f"{label}: not (n, 2) or (n, 3) coordinates: {error}") from error
    return shapes.from_paths(paths, kinds)


def _positions(path: Any) -> Coordinates:
    array: Coordinates = np.asarray(path, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, 3))
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise ValueError(f"the shape is {array.shape}")
    return array


def _check(found: Shapes, kind: int, label: str) -> Shapes:
    allowed = {
        shapes.POINTS: (shapes.POINTS,),
        shapes.LINE: (shapes.LINE, shapes.EXTERIOR, shapes.HOLE),
        shapes.EXTERIOR: (shapes.EXTERIOR, shapes.HOLE),
    }[kind]
    wrong = found.kinds[(found.sizes > 0) & ~np.isin(found.kinds, allowed)]
    if len(wrong):
        need = _NAMES[kind]
        raise InputError(f"not-{need}", f"{label}: holds {_NAMES[int(wrong[0])]}, where {need} are needed")
    return found


def _transformed(found: Shapes, own: CRS | None, crs: CRS | None, label: str) -> Shapes:
    """The shapes in another CRS; what cannot be transformed is not finite."""
    finite = np.isfinite(found.xyz[:, :2]).all(axis=1)
    if own is None or crs is None or not finite.any() or _is_same(own.horizontal, crs.horizontal):
        return found
    x, y = _transform(own.horizontal, crs.horizontal, found.xyz[finite, :2].T, label)
    xyz = found.xyz.copy()
    xyz[finite, 0], xyz[finite, 1] = x, y
    return replace(found, xyz=xyz)


def _is_same(one: CRS, other: CRS) -> bool:
    if one.wkt == other.wkt or (one.code is not None and one.code == other.code):
        return True
    try:
        import rasterio.crs
    except ImportError:
        return False
    try:
        return bool(rasterio.crs.CRS.from_wkt(one.wkt) == rasterio.crs.CRS.from_wkt(other.wkt))
    except rasterio.errors.CRSError:
        return False


def _transform(own: CRS, crs: CRS, xy: Coordinates, label: str) -> npt.NDArray[np.float64]:
    try:
        import rasterio.warp
        from rasterio._err import CPLE_AppDefinedError, CPLE_BaseError
    except ImportError as error:
        raise InputError(
            "missing-library", f"{label}: another CRS than the DEM's needs rasterio: pip install rasterio"
        ) from error
    try:
        with rasterio.Env():  # in it GDAL logs its complaints, elsewhere it would print them
            try:
                return np.array(rasterio.warp.transform(own.wkt, crs.wkt, *xy))
            except CPLE_AppDefinedError:
                # Some points are outside what can be projected. rasterio then gives nothing, fiona the
                # others; it alone would not do, as it tells nothing of a CRS that cannot be reached.
                return _transform_some(own, crs, xy)
    except (CPLE_BaseError, rasterio.errors.RasterioError, ValueError) as error:
        why = " ".join(str(error).split())[:200]
        raise InputError("bad-crs", f"{label}: cannot be transformed from {own} to {crs} ({why})") from error


def _transform_some(own: CRS, crs: CRS, xy: Coordinates) -> npt.NDArray[np.float64]:
    import fiona
    import fiona.transform

    with fiona.Env():
        return np.array(fiona.transform.transform(own.wkt, crs.wkt, *xy))


def _finite(found: Shapes) -> tuple[Coordinates, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Vertices with finite x and y, the path of each and its place among all; z is finite or NaN."""
    place = np.flatnonzero(np.isfinite(found.xyz[:, :2]).all(axis=1))
    xyz = found.xyz[place]
    xyz[~np.isfinite(xyz[:, 2]), 2] = np.nan
    return xyz, found.path_of_vertex[place], place


def _without_repeats(
    xyz: Coordinates, path: npt.NDArray[np.int64]
) -> tuple[Coordinates, npt.NDArray[np.int64]]:
    repeats = (np.diff(path) == 0) & (xyz[1:, :2] == xyz[:-1, :2]).all(axis=1)
    keep = np.r_[True, ~repeats][: len(xyz)]
    return xyz[keep], path[keep]


def _split(xyz: Coordinates, path: npt.NDArray[np.int64], at_least: int = 1) -> list[Coordinates]:
    """Cut vertices where the number of the path changes."""
    ends = [0, *(np.flatnonzero(np.diff(path)) + 1).tolist(), len(xyz)]
    return [xyz[start:end] for start, end in zip(ends, ends[1:]) if end - start >= at_least]


def _rings(found: Shapes) -> tuple[Coordinates, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Vertices of the rings, which are left open, the ring of each, and the polygon of each ring.

    What has fewer than three different vertices is left out.
    """
    xyz, ring, _ = _finite(found)
    xyz, ring = _without_repeats(xyz, ring)
    last = np.r_[np.diff(ring) != 0, True][: len(ring)]
    first = np.searchsorted(ring, ring[last])
    closing = np.flatnonzero(last)[(xyz[first, :2] == xyz[last, :2]).all(axis=1)]
    xyz, ring = np.delete(xyz, closing, axis=0), np.delete(ring, closing)  # they are all closed alike
    polygon = np.cumsum(found.kinds == shapes.EXTERIOR) - 1
    is_ring = _different(xyz, ring, len(polygon)) >= 3
    is_ring &= is_ring[found.kinds == shapes.EXTERIOR][polygon]  # no hole without its exterior
    keep = is_ring[ring]
    xyz, ring = xyz[keep], ring[keep]
    numbers, ring = np.unique(ring, return_inverse=True)
    xyz = _z_of_all(xyz, polygon[numbers][ring])
    return xyz, ring, np.unique(polygon[numbers], return_inverse=True)[1]


def _different(xyz: Coordinates, path: npt.NDArray[np.int64], paths: int) -> npt.NDArray[np.int64]:
    """How many places the vertices of each path have."""
    order = np.lexsort((xyz[:, 1], xyz[:, 0], path))
    xy, path = xyz[order, :2], path[order]
    is_new = np.r_[True, (np.diff(path) != 0) | (np.diff(xy, axis=0) != 0).any(axis=1)][: len(path)]
    return np.bincount(path[is_new], minlength=paths)


def _closed(
    xyz: Coordinates, ring: npt.NDArray[np.int64], owner: npt.NDArray[np.int64]
) -> list[list[Coordinates]]:
    """The closed rings of each polygon."""
    found: list[list[Coordinates]] = [[] for _ in range(int(owner[-1]) + 1)]
    for polygon, path in zip(owner.tolist(), _split(xyz, ring)):
        found[polygon].append(np.concatenate([path, path[:1]]))
    return found


def _z_of_all(xyz: Coordinates, polygon: npt.NDArray[np.int64]) -> Coordinates:
    """The vertices, without z where a vertex of the same polygon has none."""
    if len(xyz):
        incomplete = np.bincount(polygon, weights=np.isnan(xyz[:, 2])) > 0
        xyz[incomplete[polygon], 2] = np.nan
    return xyz


def _valid(polygons: Any) -> Any:
    import shapely

    polygons = np.atleast_1d(polygons)
    wrong = ~shapely.is_valid(polygons)
    polygons[wrong] = shapely.make_valid(polygons[wrong])
    parts = shapely.get_parts(shapely.get_parts(polygons))  # collections may hold multipolygons
    is_polygon = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    return parts[is_polygon & (shapely.area(parts) > 0)]
