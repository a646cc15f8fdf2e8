"""What a GIS wants to know of each triangle, computed for many triangles at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tin.crs import length_of_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tin.tin import Tin

ALL = slice(None)

# WGS 84; another ellipsoid changes an area by less than one part in a thousand.
_SEMI_MAJOR = 6378137.0
_ECCENTRICITY2 = 0.00669437999014


def attributes(tin: Tin, rows: slice = ALL) -> dict[str, NDArray[Any]]:
    """Return the columns that describe the m triangles in ``rows``, each an array of shape (m,).

    ``v0 v1 v2``   int32: indices of the corners in ``tin.vertices``
    ``z_mean``     mean height of the corners, in the vertical unit
    ``slope``      degrees from horizontal
    ``aspect``     direction of descent, degrees clockwise from north (the y axis); NaN where flat
    ``area_2d``    planar area, in square units of the CRS, or in square metres where it is geographic
    ``area_3d``    surface area, in the same unit
    ``max_error``  largest absolute vertical error, in the vertical unit
    ``constraints``  int16 bit mask: 1, 2, 4 where edge v0-v1, v1-v2, v2-v0 is an outline or breakline

    Slope and surface area hold where vertical and horizontal units differ; an unknown vertical
    unit is taken for the horizontal one (metres for a geographic CRS).
    """
    triangles = tin.triangles[rows]
    corners = tin.vertices[triangles]
    nx, ny, nz = _normals(corners, _ground_scale(tin, corners))
    horizontal = np.hypot(nx, ny)
    aspect = np.degrees(np.arctan2(nx, ny)) % 360.0
    aspect[aspect == 360.0] = 0.0  # what % makes of a tiny negative angle
    aspect[horizontal == 0.0] = np.nan
    v0, v1, v2 = triangles.T.astype(np.int32)
    return {
        "v0": v0,
        "v1": v1,
        "v2": v2,
        "z_mean": corners[:, :, 2].mean(axis=1),
        "slope": np.degrees(np.arctan2(horizontal, nz)),
        "aspect": aspect,
        "area_2d": 0.5 * nz,
        "area_3d": 0.5 * np.hypot(horizontal, nz),
        "max_error": np.asarray(tin.triangle_errors[rows], np.float64),
        "constraints": (tin.constrained[rows] @ np.array([1, 2, 4])).astype(np.int16),
    }


def area_unit(tin: Tin) -> str:
    """Return the unit whose square the areas have."""
    if tin.crs is None:
        return "map unit"
    return "metre" if tin.crs.is_geographic else tin.crs.unit_name


def _normals(corners: NDArray[Any], scale: NDArray[Any]) -> NDArray[Any]:
    """Return the three components, each (m,), of the upward normals, as long as twice the area."""
    ux, uy, uz = ((corners[:, 1] - corners[:, 0]) * scale).T
    vx, vy, vz = ((corners[:, 2] - corners[:, 0]) * scale).T
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])


def _ground_scale(tin: Tin, corners: NDArray[Any]) -> NDArray[Any]:
    """Return, (m, 3) or (3,), what makes x, y and z of a triangle commensurable."""
    metres = length_of_unit(tin.dem.vertical_unit)
    if tin.crs is None:
        return np.ones(3)
    if not tin.crs.is_geographic:
        return np.array([1.0, 1.0, 1.0 if metres is None else metres / tin.crs.unit_factor])
    latitude = np.radians(np.clip(corners[:, :, 1].mean(axis=1), -89.9, 89.9))
    w2 = 1.0 - _ECCENTRICITY2 * np.sin(latitude) ** 2
    meridian = np.radians(_SEMI_MAJOR * (1.0 - _ECCENTRICITY2) / w2**1.5)  # metres per degree of latitude
    parallel = np.radians(_SEMI_MAJOR / np.sqrt(w2) * np.cos(latitude))
    return np.stack([parallel, meridian, np.full(len(corners), metres or 1.0)], axis=1)
