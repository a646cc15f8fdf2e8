"""What a TIN follows besides the DEM: breaklines, points, clip polygons and level areas, on its pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tin import features
from tin.dem import MAX_HEIGHT
from tin.errors import InputError

if TYPE_CHECKING:
    from tin.dem import DEM
    from tin.shapes import Coordinates

Polygon = list["Coordinates"]
LATTICE = 256
"""The core's steps in a pixel."""


@dataclass
class Constraints:
    """Constraints as the core takes them: vertices are (n, 3) column, row and height, NaN for no height."""

    pixels: list[tuple[int, int]] = field(default_factory=list)
    """Column and row of the pixels that are vertices from the start (P_I of Algorithm 1)."""
    points: Coordinates = field(default_factory=lambda: np.empty((0, 3)))
    """Points that keep their place and height."""
    lines: list[Coordinates] = field(default_factory=list)
    clip: list[Polygon] | None = None
    flat: list[tuple[Polygon, float]] = field(default_factory=list)
    """Polygons and their levels; NaN: the median of the DEM there."""
    warnings: list[str] = field(default_factory=list)
    """What of it the TIN cannot follow, or perhaps should not."""

    def core_arguments(self) -> dict[str, Any]:
        """The arguments of ``tin._core.triangulate``."""
        return {name: getattr(self, name) for name in ("pixels", "points", "lines", "clip", "flat")}


def constraints(
    dem: DEM,
    *,
    breaklines: Any = None,
    points: Any = None,
    clip: Any = None,
    flat: Any = None,
    soft: bool = False,
    allow_remote: bool = False,
) -> Constraints:
    """Bring what was given onto the pixels of ``dem``; see ``tin.features`` for what can be given.

    Raises InputError, see ``tin.features``.
    """
    made = Constraints()
    crs = dem.crs
    if breaklines is not None:
        label = _label(breaklines, "breaklines")
        made.lines = [
            _placed(dem, line, soft) for line in features.lines(breaklines, crs, allow_remote=allow_remote)
        ]
        made.warnings += _outside(label, "lines", [_touches(dem, line) for line in made.lines])
        made.warnings += _unfilled(
            dem, label, np.concatenate([np.empty(0), *(line[:, 2] for line in made.lines)])
        )
    if points is not None:
        label = _label(points, "points")
        spots = _placed(dem, features.points(points, crs, allow_remote=allow_remote, keep_lost=True), soft)
        nearest = np.rint(spots[:, :2])
        has_height = ~np.isnan(spots[:, 2])
        # A point that keeps its place must lie between pixel centres, where a TIN can be.
        place = np.where(has_height[:, None], spots[:, :2], nearest)
        inside = np.all((place >= 0) & (place <= (dem.cols - 1, dem.rows - 1)), axis=1)
        made.points = spots[inside & has_height]
        pixels = nearest[inside & ~has_height].astype(int)
        made.pixels = list(zip(pixels[:, 0].tolist(), pixels[:, 1].tolist()))
        made.warnings += _outside(label, "points", inside.tolist())
        made.warnings += _unfilled(dem, label, made.points[:, 2])
    if clip is not None:
        areas = features.areas(clip, crs, label="clip", allow_remote=allow_remote)
        made.clip = [[_placed(dem, ring, True) for ring in area] for area in areas]
    if flat is not None:
        areas = features.areas(flat, crs, label="flat", allow_remote=allow_remote)
        made.flat = [([_placed(dem, ring, True) for ring in area], _level(area)) for area in areas]
        label = _label(flat, "flat")
        made.warnings += _outside(label, "polygons", [_touches(dem, polygon[0]) for polygon, _ in made.flat])
        made.warnings += _unfilled(
            dem, label, np.array([level for _, level in made.flat]), "a layer without z"
        )
    return made


def _placed(dem: DEM, xyz: Coordinates, soft: bool) -> Coordinates:
    with np.errstate(invalid="ignore"):  # what cannot be transformed is infinitely far away
        placed: Coordinates = features.to_pixels(dem, xyz)
    # As the core does, but before it cuts off what a rounding error puts beyond the outermost pixels.
    placed[:, :2] = np.rint(placed[:, :2] * LATTICE) / LATTICE
    if soft:
        placed[:, 2] = np.nan
    return placed


def _level(area: Polygon) -> float:
    """The height of a polygon that has one, else NaN."""
    return float(area[0][:, 2].mean())


def _touches(dem: DEM, placed: Coordinates) -> bool:
    """Whether the box around the vertices meets the raster."""
    low, high = placed[:, :2].min(axis=0), placed[:, :2].max(axis=0)
    return bool((high >= 0).all() and (low <= (dem.cols - 1, dem.rows - 1)).all())


def _label(value: Any, name: str) -> str:
    return os.fsdecode(value) if isinstance(value, (str, os.PathLike)) else name


def _outside(label: str, kind: str, is_inside: list[bool]) -> list[str]:
    outside = is_inside.count(False)
    if not is_inside:
        return [f"{label}: there are no {kind}"]
    return [f"{label}: {outside} of {len(is_inside)} {kind} lie outside the DEM"] if outside else []


def _unfilled(dem: DEM, label: str, heights: Coordinates, remedy: str = "--soft") -> list[str]:
    """Many layers have a third dimension that nobody filled in."""
    heights = heights[~np.isnan(heights)]
    if len(heights) and np.abs(heights).max() > MAX_HEIGHT:
        raise InputError("height-range", f"{label}: heights beyond {MAX_HEIGHT:g} are no terrain")
    is_filled = heights.any() or not len(heights)
    if is_filled or np.fmin.reduce(dem.z, axis=None) <= 0.0 <= np.fmax.reduce(dem.z, axis=None):
        return []
    return [f"{label}: all heights are 0, unlike those of the DEM; {remedy} takes the DEM's"]
