from __future__ import annotations

import numpy as np
import pyproj
import pytest
import shapely
from fakes import FakeDEM, FakeTin, crs, grid_tin
from numpy.testing import assert_allclose, assert_array_equal

from tin.formats.attributes import attributes


def one_triangle(*corners, crs=None, vertical_unit=""):
    dem = FakeDEM((2, 2), (1, 0, 0, 0, -1, 2), crs, vertical_unit)
    return FakeTin(np.array(corners, float), np.array([[0, 1, 2]], np.uint32), dem, np.zeros((2, 2)))


def test_against_shapely_and_a_plane_fit_per_triangle():
    tin = grid_tin(crs=crs("EPSG:26710"))
    got = attributes(tin)
    for i, triangle in enumerate(tin.triangles):
        corners = tin.vertices[triangle]
        p, q, _ = np.linalg.solve(np.c_[corners[:, :2] - corners[0, :2], np.ones(3)], corners[:, 2])
        sides = [np.linalg.norm(corners[k] - corners[k - 1]) for k in range(3)]
        half = sum(sides) / 2
        assert got["z_mean"][i] == pytest.approx(corners[:, 2].mean())
        assert got["area_2d"][i] == pytest.approx(shapely.Polygon(corners).area)
        assert got["area_3d"][i] == pytest.approx(np.sqrt(half * np.prod(half - np.array(sides))))
        assert np.tan(np.radians(got["slope"][i])) == pytest.approx(np.hypot(p, q), rel=1e-9)
        downhill = np.radians(got["aspect"][i])
        assert_allclose([np.sin(downhill), np.cos(downhill)], np.array([-p, -q]) / np.hypot(p, q), atol=1e-9)
    assert_allclose(np.stack([got["v0"], got["v1"], got["v2"]], 1), tin.triangles)
    assert_allclose(got["max_error"], tin.triangle_errors)


@pytest.mark.parametrize(
    ("fall", "aspect"),
    [((0, 1), 0.0), ((1, 1), 45.0), ((1, 0), 90.0), ((0, -1), 180.0), ((-1, 0), 270.0), ((-1e-300, 1), 0.0)],
)
def test_aspect_is_where_water_runs(fall, aspect):
    corners = np.array([[0.0, 0.0], [4.0, 1.0], [1.0, 5.0]])
    tin = one_triangle(*np.c_[corners, -corners @ fall])
    assert attributes(tin)["aspect"][0] == pytest.approx(aspect)
    assert attributes(tin)["aspect"][0] < 360
    assert attributes(tin)["slope"][0] == pytest.approx(np.degrees(np.arctan(np.hypot(*fall))))


def test_a_flat_triangle_has_no_aspect():
    got = attributes(grid_tin(flat=True))
    assert np.isnan(got["aspect"]).all()
    assert (got["slope"] == 0).all()
    assert_allclose(got["area_3d"], got["area_2d"])


def test_constraints_are_a_bit_mask_of_edges():
    tin = one_triangle((0, 0, 0), (1, 0, 0), (0, 1, 0))
    for mask in range(8):
        tin.constrained = np.array([[mask & 1, mask & 2, mask & 4]], bool)
        assert attributes(tin)["constraints"].tolist() == [mask]


@pytest.mark.parametrize(
    ("code", "vertical_unit", "rise"),
    [
        ("EPSG:32633", "metre", 1.0),
        ("EPSG:32633", "", 1.0),
        ("EPSG:32633", "foot", 0.3048),
        ("EPSG:2227", "metre", 3937 / 1200),
        ("EPSG:2227", "US survey foot", 1.0),
        ("EPSG:2227", "", 1.0),
        (None, "foot", 1.0),
    ],
)
def test_slope_and_surface_where_units_differ(code, vertical_unit, rise):
    known = code and crs(code)
    got = attributes(one_triangle((0, 0, 0), (10, 0, 10), (0, 10, 0), crs=known, vertical_unit=vertical_unit))
    assert got["slope"][0] == pytest.approx(np.degrees(np.arctan(rise)))
    assert got["area_2d"][0] == pytest.approx(50)
    assert got["area_3d"][0] == pytest.approx(50 * np.hypot(1, rise))
    assert got["z_mean"][0] == pytest.approx(10 / 3)


@pytest.mark.parametrize("latitude", [-89.9, -45.0, 0.0, 36.5, 80.0])
def test_degrees_give_square_metres(latitude):
    step = 1 / 1200
    corners = np.array([[-84.0, latitude], [-84.0 + step, latitude], [-84.0, latitude + step]])
    tin = one_triangle(*np.c_[corners, [0, 0, 30]], crs=crs("EPSG:4326"))
    got = attributes(tin)
    geod = pyproj.Geod(ellps="WGS84")
    area, _ = geod.polygon_area_perimeter(*corners.T)
    north = geod.inv(*corners[0], *corners[2])[2]
    assert got["area_2d"][0] == pytest.approx(area, rel=1e-4 if abs(latitude) < 89 else 1e-2)
    assert got["slope"][0] == pytest.approx(np.degrees(np.arctan(30 / north)), rel=1e-5)
    assert got["aspect"][0] == pytest.approx(180)
    tin.dem.vertical_unit = "foot"
    assert attributes(tin)["slope"][0] == pytest.approx(np.degrees(np.arctan(30 * 0.3048 / north)), rel=1e-5)


def test_some_rows_have_what_they_have_among_all():
    tin = grid_tin(crs=crs("EPSG:4326"), transform=(0.01, 0, -84.0, 0, -0.01, 36.0))
    part, whole = attributes(tin, slice(50, 90)), attributes(tin)
    assert part.keys() == whole.keys()
    for name, column in part.items():
        assert_array_equal(column, whole[name][50:90])
