"""The outline of a triangulation, against shapely's union of the triangles."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from terrain import hills

import tin
from tin.outline import exterior_first, rings


def grid(rows, cols, keep):
    """A grid of squares cut in two, of whose triangles those that ``keep`` (m,) names are there."""
    row, col = np.mgrid[0:rows, 0:cols]
    places = np.column_stack([col.ravel(), row.ravel()]).astype(float)
    index = np.arange(rows * cols).reshape(rows, cols)
    sw, se, nw, ne = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([sw, se, ne, sw, ne, nw], axis=-1).reshape(-1, 3)
    return places, triangles[keep].astype(np.uint32)


def polygons(places, triangles):
    found = [exterior_first([places[ring] for ring in part]) for part in rings(triangles)]
    return [shapely.Polygon(polygon[0], polygon[1:]) for polygon in found], found


def check(places, triangles):
    made, found = polygons(places, triangles)
    assert shapely.is_valid(made).all(), shapely.is_valid_reason(made)
    assert shapely.is_valid(shapely.MultiPolygon(made))
    for polygon in found:
        ways = [shapely.is_ccw(shapely.LinearRing(ring)) for ring in polygon]
        assert ways == [True] + [False] * (len(polygon) - 1)
        assert all((ring[0] == ring[-1]).all() for ring in polygon)
    union = shapely.union_all(shapely.polygons(places[triangles]))
    assert shapely.equals(shapely.MultiPolygon(made), union)
    assert len(made) == shapely.get_num_geometries(union)
    assert sum(p.area for p in made) == pytest.approx(shapely.area(shapely.polygons(places[triangles])).sum())
    return made


@pytest.mark.parametrize("share", [0.15, 0.4, 0.6, 0.8, 0.95])
def test_any_set_of_triangles_gives_valid_polygons_that_cover_it(share):
    for seed in range(30):
        keep = np.random.default_rng(seed).random(2 * 9 * 11) < share
        if keep.any():
            check(*grid(10, 12, keep))


def squares(*missing, rows=4, cols=4):
    keep = np.ones((rows, cols, 2), bool)
    for place in missing:
        keep[place] = False
    return grid(rows + 1, cols + 1, keep.ravel())


def test_one_triangle():
    (made,) = check(np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([[0, 1, 2]], np.uint32))
    assert made.area == 0.5


def test_a_hole():
    (made,) = check(*squares((1, 1)))
    assert len(made.interiors) == 1


def test_holes_that_touch_are_two():
    (made,) = check(*squares((1, 1), (2, 2)))
    assert len(made.interiors) == 2


def test_a_hole_may_touch_the_exterior():
    places, triangles = squares((1, 1), (0, 0))
    (made,) = check(places, triangles)
    assert len(made.interiors) == 1
    assert made.exterior.intersection(made.interiors[0]).equals(shapely.Point(1, 1))


def test_parts_that_touch_in_a_vertex_are_two():
    made = check(*squares((0, 1), (1, 0), rows=2, cols=2))
    assert len(made) == 2
    assert made[0].intersection(made[1]).equals(shapely.Point(1, 1))


def test_an_island_in_a_hole_is_a_part_of_its_own():
    ring = [
        (r, c) for r in range(1, 6) for c in range(1, 6) if (r, c) != (3, 3) and (r in (1, 5) or c in (1, 5))
    ]
    ring += [(r, c) for r in range(2, 5) for c in range(2, 5) if (r, c) != (3, 3)]
    made = check(*squares(*ring, rows=7, cols=7))
    assert sorted(len(polygon.interiors) for polygon in made) == [0, 1]


@pytest.mark.parametrize("y_down", [False, True])
def test_the_outline_of_a_tin_with_voids(y_down):
    z = hills(60, 70)
    z[np.random.default_rng(1).random(z.shape) < 0.08] = np.nan
    z[20:35, 30:50] = np.nan
    sign = 1 if y_down else -1
    mesh = tin.triangulate(tin.DEM(z, transform=(30.0, 2.0, 5e5, 1.0, sign * 30.0, 5e6)), max_points="30%")
    found = mesh.outline()
    assert all(ring.shape[1] == 3 for polygon in found for ring in polygon)
    made = [shapely.Polygon(polygon[0], polygon[1:]) for polygon in found]
    assert shapely.is_valid(made).all()
    assert shapely.has_z(made).all()
    assert sum(len(polygon.interiors) for polygon in made) > 10
    corners = mesh.vertices[mesh.triangles][..., :2]
    area = shapely.area(shapely.polygons(corners)).sum()
    assert shapely.area(made).sum() == pytest.approx(area, rel=1e-9)
    assert (
        shapely.symmetric_difference(
            shapely.force_2d(shapely.MultiPolygon(made)), shapely.union_all(shapely.polygons(corners))
        ).area
        < 1e-9 * area
    )
