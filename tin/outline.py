"""The outline of a triangulation: the polygons of the area that its triangles cover."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.int64]


def rings(triangles: npt.NDArray[Any]) -> list[list[Numbers]]:
    """Return the rings of each part, as vertex numbers: the exterior, then the holes.

    ``triangles`` are (m, 3) vertex numbers, counter-clockwise, of a plane triangulation. A part is what is
    connected across edges. Rings are closed, the first number repeated, with the area on their left:
    exteriors run counter-clockwise, holes clockwise. No ring meets a vertex twice; rings of a part may
    touch each other in a vertex, and so may parts, as valid polygons may.
    """
    start = triangles.astype(np.int64).ravel()  # of edge 3 * t + k, which leaves corner k of triangle t
    twin = _twins(triangles)
    border = np.flatnonzero(twin < 0)
    part = _parts(twin)[border // 3]
    after = _following(twin, border)
    found: dict[int, list[Numbers]] = {}
    for loop in _loops(after.tolist(), start[border].tolist()):
        found.setdefault(int(part[loop[0]]), []).append(start[border[[*loop, loop[0]]]])
    return list(found.values())


def exterior_first(polygon: list[npt.NDArray[np.float64]]) -> list[npt.NDArray[np.float64]]:
    """Put the one ring that runs counter-clockwise, (k, 2) or (k, 3) coordinates, before the holes."""
    return sorted(polygon, key=_area, reverse=True)


def _area(ring: npt.NDArray[np.float64]) -> float:
    x, y = (ring[:, :2] - ring[0, :2]).T  # near the origin, where the products lose nothing
    return 0.5 * float(x[:-1] @ y[1:] - x[1:] @ y[:-1])


def _next(edge: Numbers) -> Numbers:
    """Return the edge that follows in the same triangle."""
    return np.where(edge % 3 == 2, edge - 2, edge + 1)


def _twins(triangles: npt.NDArray[Any]) -> Numbers:
    """Return (3 m,) the same edge in the neighbouring triangle, -1 where there is none."""
    start = triangles.astype(np.int64)
    end = np.roll(start, -1, axis=1)
    key = (np.minimum(start, end) * (int(start.max(initial=0)) + 1) + np.maximum(start, end)).ravel()
    order = np.argsort(key)
    is_pair = np.diff(key[order]) == 0
    one, other = order[:-1][is_pair], order[1:][is_pair]
    twin = np.full(len(key), -1)
    twin[one], twin[other] = other, one
    return twin


def _parts(twin: Numbers) -> Numbers:
    """Return (m,) a number for each triangle that all and only those connected to it across edges share."""
    label = np.arange(len(twin) // 3)
    edge = np.flatnonzero(twin >= 0)
    pairs = np.stack([edge // 3, twin[edge] // 3])
    while True:
        ends = label[pairs]
        differ = ends[0] != ends[1]
        if not differ.any():
            return label
        pairs, ends = pairs[:, differ], ends[:, differ]
        label[ends.max(axis=0)] = ends.min(axis=0)  # whichever of several: each is a lower one
        while (label[label] != label).any():
            label = label[label]


def _following(twin: Numbers, border: Numbers) -> Numbers:
    """Return the place in ``border`` of the border edge that comes after each.

    It is found by turning around the edge's end, from triangle to triangle: where the border meets itself
    in a vertex, it stays with its own triangles.
    """
    edge = _next(border)
    inside = np.flatnonzero(twin[edge] >= 0)
    while len(inside):
        edge[inside] = _next(twin[edge[inside]])
        inside = inside[twin[edge[inside]] >= 0]
    return np.searchsorted(border, edge)


def _loops(after: list[int], start: list[int]) -> list[list[int]]:
    """Follow the edges round, and cut off a loop whenever a vertex is met again."""
    loops = []
    is_done = [False] * len(after)
    for first in range(len(after)):
        walk: list[int] = []
        place: dict[int, int] = {}  # where in the walk the edge that leaves a vertex is
        edge = first
        while not is_done[edge]:
            is_done[edge] = True
            seen = place.get(start[edge])
            if seen is not None:
                loops.append(walk[seen:])
                for cut in walk[seen:]:
                    del place[start[cut]]
                del walk[seen:]
            place[start[edge]] = len(walk)
            walk.append(edge)
            edge = after[edge]
        if walk:
            loops.append(walk)
    return loops
