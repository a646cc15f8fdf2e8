"""Points, lines and polygons taken apart into arrays, whichever library they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tin.errors import InputError

POINTS, LINE, EXTERIOR, HOLE = range(4)

Coordinates = npt.NDArray[np.float64]

# How deep the positions of a GeoJSON geometry lie, and what its paths are.
_NESTING = {
    "Point": (0, POINTS),
    "MultiPoint": (1, POINTS),
    "LineString": (1, LINE),
    "LinearRing": (1, LINE),
    "MultiLineString": (2, LINE),
    "Polygon": (2, EXTERIOR),
    "MultiPolygon": (3, EXTERIOR),
}
_POLYGON = 3  # shapely's type number; up to it the types are single, and straight


@dataclass(frozen=True)
class Shapes:
    """Paths, one after the other: sets of points, lines, and the rings of polygons (exterior, then holes)."""

    xyz: Coordinates
    """(n, 3); z is NaN where there is none."""
    sizes: npt.NDArray[np.int64]
    """(paths,) number of vertices, 0 for what is empty: an empty exterior still parts the holes of others."""
    kinds: npt.NDArray[np.uint8]
    """(paths,) POINTS, LINE, EXTERIOR or HOLE."""

    @property
    def path_of_vertex(self) -> npt.NDArray[np.int64]:
        """(n,) index into `sizes`."""
        return np.repeat(np.arange(len(self.sizes)), self.sizes)


def make(xyz: npt.ArrayLike, sizes: npt.ArrayLike, kinds: npt.ArrayLike) -> Shapes:
    """Shapes of (n, 2) or (n, 3) coordinates and the (paths,) sizes and kinds."""
    xyz = with_z(np.asarray(xyz, dtype=np.float64))
    return Shapes(xyz, np.asarray(sizes, dtype=np.int64), np.asarray(kinds, dtype=np.uint8))


def with_z(positions: Coordinates) -> Coordinates:
    """Positions (n, 2) with a third column of NaN; (n, 3) as they are."""
    if positions.shape[1] == 3:
        return positions
    return np.column_stack([positions, np.full(len(positions), np.nan)])


def from_paths(paths: Sequence[Coordinates], kinds: npt.ArrayLike) -> Shapes:
    """Shapes of a list of (n, 2) or (n, 3) arrays and the kind of each, or of all."""
    sizes = [len(path) for path in paths]
    if len({path.shape[1] for path in paths}) > 1:
        paths = [with_z(path) for path in paths]
    xyz = np.concatenate(paths) if sizes else np.empty((0, 3))
    return make(xyz, sizes, np.broadcast_to(np.asarray(kinds, dtype=np.uint8), len(sizes)))


def concatenate(parts: Sequence[Shapes]) -> Shapes:
    """All shapes, in their order."""
    if len(parts) == 1:
        return parts[0]
    parts = [make(np.empty((0, 3)), [], []), *parts]
    return Shapes(
        np.concatenate([part.xyz for part in parts]),
        np.concatenate([part.sizes for part in parts]),
        np.concatenate([part.kinds for part in parts]),
    )


def from_shapely(geometries: npt.NDArray[Any]) -> Shapes:
    """Take apart an array of shapely geometries; None and empty ones vanish."""
    import shapely

    parts = shapely.get_parts(geometries)
    while (shapely.get_type_id(parts) > _POLYGON).any():  # collections within collections
        parts = shapely.get_parts(parts)
    is_polygon = shapely.get_type_id(parts) == _POLYGON
    rings, owners = shapely.get_rings(parts[is_polygon], return_index=True)
    is_hole = np.r_[False, owners[1:] == owners[:-1]][: len(rings)]
    places = np.concatenate([np.flatnonzero(~is_polygon), np.flatnonzero(is_polygon)[owners]])
    order = np.argsort(places, kind="stable")  # the exterior stays before its holes
    single = parts[~is_polygon]
    paths = np.concatenate([single, rings])[order]
    kinds = np.concatenate(
        [np.where(shapely.get_type_id(single) == 0, POINTS, LINE), np.where(is_hole, HOLE, EXTERIOR)]
    )[order]
    xyz = shapely.get_coordinates(paths, include_z=True)
    return make(xyz, shapely.get_num_coordinates(paths), kinds)


class Collector:
    """Gathers geometries that come one by one, in the manner of GeoJSON."""

    def __init__(self) -> None:
        self._positions: list[Any] = []
        self._sizes: list[int] = []
        self._kinds: list[int] = []

    def add(self, geometry: Any) -> None:
        """Take a GeoJSON mapping, also a feature, or an object with the attributes of one.

        Raises InputError ("bad-features") for an unknown type; ValueError, TypeError, KeyError or
        AttributeError for what is no geometry at all.
        """
        get = geometry.__getitem__ if isinstance(geometry, dict) else geometry.__getattribute__
        name = get("type")
        if name in _NESTING:
            depth, kind = _NESTING[name]
            self._nested(get("coordinates"), depth, kind)
        elif name == "Feature":
            if get("geometry") is not None:
                self.add(get("geometry"))
        elif name in ("GeometryCollection", "FeatureCollection"):
            for part in get("geometries" if name == "GeometryCollection" else "features"):
                if part is not None:
                    self.add(part)
        else:
            raise InputError("bad-features", f"a geometry of type {name!r} is not understood")

    def _nested(self, content: Any, depth: int, kind: int) -> None:
        if content is None:  # an empty geometry
            return
        if depth > 1:
            for index, part in enumerate(content):
                is_hole = kind == EXTERIOR and depth == 2 and index > 0
                self._nested(part, depth - 1, HOLE if is_hole else kind)
            return
        path = list(content) if depth else [content]
        if kind == POINTS:
            path = [position for position in path if len(position)]
        if kind == POINTS and self._kinds and self._kinds[-1] == POINTS:
            self._sizes[-1] += len(path)
        else:
            self._sizes.append(len(path))
            self._kinds.append(kind)
        self._positions += path

    def shapes(self) -> Shapes:
        """All that was added; raises ValueError or TypeError where positions are not numbers."""
        widths = set(map(len, self._positions))
        if not widths:
            return from_paths([], [])
        if min(widths) < 2:
            raise ValueError("a position needs x and y")
        if len(widths) > 1:
            self._positions = [(*position, np.nan)[:3] for position in self._positions]
        positions = np.array(self._positions, dtype=np.float64)
        return make(positions[:, :3], self._sizes, self._kinds)
