"""Lines, points and areas: every kind of value gives the same arrays, hostile ones none or an error."""

from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import geopandas
import numpy as np
import pyproj
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import mapping
from terrain import dem

import tin
from tin import features
from tin.crs import CRS

UTM = CRS.parse("EPSG:32610")
NAN = np.nan
LINES = [
    np.array([[500000.0, 5099000, 10], [500300, 5099100, 20], [500500, 5098800, 15]]),
    np.array([[500100.0, 5098500, 1], [500900, 5098700, 2]]),
]
POINTS = np.array([[500010.0, 5099010, 5], [500700, 5098600, 7], [501000, 5099900, 9]])
RINGS = [
    np.array(
        [[0.0, 0, 1], [9, 0, 2], [9, 9, 3], [0, 9, 4], [0, 0, 1]]
    ),  # counter-clockwise, as all come back
    np.array([[2.0, 2, 1], [2, 4, 2], [4, 4, 3], [2, 2, 1]]),
]


def same(found, wanted):
    assert len(found) == len(wanted)
    for one, other in zip(found, wanted):
        assert one.dtype == np.float64
        np.testing.assert_array_equal(one, other)


def code(function, value, **keywords):
    with pytest.raises(tin.InputError) as caught:
        function(value, UTM, **keywords)
    return caught.value.code


def kinds_of(geometries, tmp_path, arrays):
    """The same geometries in every form."""
    frame = geopandas.GeoDataFrame({"name": list("abcdef")[: len(geometries)]}, geometry=geometries, crs=UTM)
    # fiona itself makes three dimensions of what geopandas hands over.
    frame.to_file(tmp_path / "f.gpkg", engine="fiona", layer="them", driver="GPKG")
    frame.to_file(tmp_path / "f.shp", engine="fiona")
    yield f"{tmp_path / 'f.gpkg'}:them"
    yield tmp_path / "f.gpkg"
    yield tmp_path / "f.shp"
    yield frame
    yield frame.geometry
    yield frame.geometry.array
    yield frame.geometry.set_crs(None, allow_override=True)
    yield geometries
    yield tuple(geometries)
    yield np.array(geometries, dtype=object)
    yield iter(geometries)
    yield [None, *geometries, shapely.Point(), shapely.LineString(), shapely.Polygon()]
    yield shapely.GeometryCollection(geometries)
    yield [shapely.GeometryCollection([shapely.GeometryCollection(geometries), shapely.MultiPoint()])]
    yield mapping(shapely.GeometryCollection(geometries))
    yield frame.to_geo_dict()
    yield [SimpleNamespace(__geo_interface__=mapping(geometry)) for geometry in geometries]
    yield [geometries[0], *(mapping(geometry) for geometry in geometries[1:])]
    yield arrays
    yield [array.tolist() if isinstance(array, np.ndarray) else tuple(array) for array in arrays]
    yield [arrays[0], *(mapping(geometry) for geometry in geometries[1:])]


def test_all_kinds_of_lines_are_the_same(tmp_path):
    for value in kinds_of([shapely.LineString(line) for line in LINES], tmp_path, LINES):
        same(features.lines(value, UTM), LINES)
    same(features.lines(shapely.MultiLineString(LINES), UTM), LINES)
    same(features.lines(LINES[0], UTM), LINES[:1])
    same(features.lines(LINES[0].tolist(), UTM), LINES[:1])
    same(features.lines(np.array([LINES[1]] * 3), UTM), [LINES[1]] * 3)


def test_all_kinds_of_points_are_the_same(tmp_path):
    for value in kinds_of([shapely.Point(point) for point in POINTS], tmp_path, [POINTS[:1], POINTS[1:]]):
        np.testing.assert_array_equal(features.points(value, UTM), POINTS)
    for value in (POINTS, POINTS.tolist(), list(POINTS), shapely.MultiPoint(POINTS)):
        np.testing.assert_array_equal(features.points(value, UTM), POINTS)


def test_all_kinds_of_areas_are_the_same(tmp_path):
    polygon = shapely.Polygon(RINGS[0][::-1], [RINGS[1][::-1]])
    other = shapely.Polygon(RINGS[0] + [20, 0, 0])
    arrays = [[RINGS[0], RINGS[1]], [RINGS[0] + [20, 0, 0]]]
    for value in kinds_of([polygon, other], tmp_path, arrays):
        found = features.areas(value, UTM)
        assert [len(area) for area in found] == [2, 1]
        for area, shape in zip(found, (polygon, other)):
            assert shapely.Polygon(area[0], area[1:]).normalize() == shape.normalize()
            assert [shapely.is_ccw(shapely.linearrings(ring)) for ring in area] == [True, False][: len(area)]
            assert not np.isnan(np.concatenate(area)).any()
            same(features.areas([area], UTM)[0], area)
    assert [len(area) for area in features.areas([RINGS[1] + 50, arrays[0]], UTM)] == [1, 2]
    for ring in (RINGS[0], RINGS[0][:-1], RINGS[0][::-1], [RINGS[0]], RINGS[0].tolist()):
        assert features.areas(ring, UTM)[0][0].shape == (5, 3)


@pytest.mark.parametrize(
    "empty", [[], (), np.empty((0, 2)), np.empty(0), [[]], shapely.Polygon(), [None], iter(())]
)
def test_nothing_is_nothing(empty):
    assert features.lines(empty, UTM) == []
    assert features.points(empty, UTM).shape == (0, 3)
    assert features.areas(empty, UTM) == []


def test_z_is_nan_where_there_is_none():
    flat = [shapely.LineString(LINES[0][:, :2]), shapely.LineString(LINES[1])]
    first, second = features.lines(flat, UTM)
    assert np.isnan(first[:, 2]).all()
    np.testing.assert_array_equal(second, LINES[1])
    assert np.isnan(features.points([[1, 2, np.inf], [3, 4, NAN]], UTM)[:, 2]).all()
    mixed = {"type": "LineString", "coordinates": [[0, 0], [1, 1, 5], [2, 2, 6, 7]]}
    np.testing.assert_array_equal(features.lines(mixed, UTM), [[[0, 0, NAN], [1, 1, 5], [2, 2, 6]]])
    incomplete = RINGS[0].copy()
    incomplete[1, 2] = NAN
    without, whole = features.areas([incomplete, RINGS[0] + 20], UTM)
    assert np.isnan(without[0][:, 2]).all()
    assert not np.isnan(whole[0]).any()


@pytest.mark.parametrize("code", ["EPSG:4326", "EPSG:26710", "EPSG:2227", "EPSG:4326+5773"])
def test_another_crs_is_transformed_as_pyproj_does_it(tmp_path, code):
    project = pyproj.Transformer.from_crs(UTM.wkt, code, always_xy=True).transform
    back = pyproj.Transformer.from_crs(pyproj.CRS(code).to_2d(), UTM.wkt, always_xy=True).transform
    there = [np.column_stack([*project(*line.T[:2]), line[:, 2]]) for line in LINES]
    wanted = [np.column_stack([*back(*line.T[:2]), line[:, 2]]) for line in there]
    frame = geopandas.GeoDataFrame(geometry=[shapely.LineString(line) for line in there], crs=code)
    frame.to_file(tmp_path / "f.gpkg", engine="fiona")
    for value in (frame, frame.geometry, str(tmp_path / "f.gpkg"), [frame[:1], frame[1:]]):
        for found, line in zip(features.lines(value, UTM), wanted):
            # A datum shift may be chosen differently by two versions of PROJ.
            np.testing.assert_allclose(found, line, rtol=0, atol=1e-3 if code != "EPSG:26710" else 5)
    same(features.lines(frame, None), there)


def test_the_same_crs_changes_nothing():
    frame = geopandas.GeoSeries(shapely.points(POINTS), crs=pyproj.CRS("EPSG:32610").to_wkt("WKT1_GDAL"))
    np.testing.assert_array_equal(features.points(frame, UTM), POINTS)
    local = CRS.from_wkt('LOCAL_CS["site grid",UNIT["foot",0.3048]]')
    np.testing.assert_array_equal(
        features.points(frame.set_crs(local.wkt, allow_override=True), local), POINTS
    )


def test_what_cannot_be_transformed(capfd):
    beyond = geopandas.GeoSeries(shapely.points([[-123.0, 45], [-123, 95], [1e30, 0], [NAN, 45]]), crs=4326)
    found = features.points(beyond, UTM)
    np.testing.assert_allclose(found[:, :2], [[500000, 4982950.4]], atol=0.01)
    cut = geopandas.GeoSeries(
        [shapely.LineString([(-123, 45), (-123, 46), (-123, 95), (-122, 45), (-122, 46)])]
    )
    assert [len(line) for line in features.lines(cut.set_crs(4326), UTM)] == [2, 2]
    assert features.points(beyond[1:], UTM).shape == (0, 3)
    local = 'LOCAL_CS["site grid",UNIT["foot",0.3048]]'
    assert code(features.points, beyond.set_crs(local, allow_override=True)) == "bad-crs"
    assert code(features.points, SimpleNamespace(crs=7, geometry=[shapely.Point(1, 2)])) == "bad-crs"
    assert capfd.readouterr() == ("", "")


def test_wrong_types_are_told_with_their_source(tmp_path):
    point, line, polygon = shapely.Point(1, 2), shapely.LineString(LINES[0]), shapely.Polygon(RINGS[0])
    assert code(features.points, line) == code(features.points, [point, polygon]) == "not-points"
    assert (
        code(features.lines, point) == code(features.lines, [line, shapely.MultiPoint(POINTS)]) == "not-lines"
    )
    assert code(features.areas, line) == code(features.areas, shapely.GeometryCollection([polygon, point]))
    assert code(features.areas, polygon.exterior) == "not-polygons"
    path = tmp_path / "f.gpkg"
    geopandas.GeoSeries([line], crs=UTM).to_file(path, engine="fiona")
    with pytest.raises(tin.InputError, match=r"f\.gpkg: holds lines, where polygons are needed"):
        features.areas(path, UTM)
    with pytest.raises(tin.InputError, match="clip: holds lines, where polygons are needed"):
        features.areas(line, UTM, label="clip")


def test_rings_of_polygons_are_breaklines():
    polygon = shapely.Polygon(RINGS[0], [RINGS[1]])
    same(features.lines([shapely.LineString(LINES[0]), polygon, shapely.LineString(LINES[1])], UTM),
         [LINES[0], *RINGS, LINES[1]])  # fmt: skip


@pytest.mark.parametrize(
    "value",
    [
        7,
        object(),
        b"f.gpkg",
        {"a": 1},
        {"type": "CircularString", "coordinates": [[0, 0]]},
        {"type": "LineString", "coordinates": [[0, 0], 5]},
        {"type": "LineString", "coordinates": [[0], [1]]},
        {"type": "LineString", "coordinates": [["a", "b"], ["c", "d"]]},
        [1.0, 2.0],
        np.zeros((3, 4)),
        np.zeros((2, 2, 2, 2, 2)),
        np.zeros(3, dtype=complex),
        np.array([["a", "b"]]),
        [[(0, 0), (1,)]],
        [[0, 0], [1, 1, 1]],
        [object()],
        geopandas.pd.DataFrame({"x": [1.0], "y": [2.0]}),
        geopandas.GeoDataFrame({"x": [1.0]}),
        dem(),
    ],
)
def test_what_is_not_understood(value):
    for function in (features.points, features.lines, features.areas):
        assert code(function, value) == "bad-features"


# What lines may hold: few values, so that repeats and closed loops are common.
number = st.sampled_from([0.0, 1.0, 2.0, 3.5, NAN, np.inf, -np.inf])
line_of_numbers = st.lists(st.tuples(number, number, number), max_size=12)


def pieces(line):
    """The same, vertex by vertex."""
    found = [[]]
    for x, y, z in line:
        if not np.isfinite([x, y]).all():
            found.append([])
        elif not found[-1] or found[-1][-1][:2] != (x, y):
            found[-1].append((x, y, z if np.isfinite(z) else NAN))
    return [np.array(piece) for piece in found if len(piece) > 1]


@given(st.lists(line_of_numbers, max_size=5))
@settings(deadline=None)
def test_lines_are_cut_where_they_are_not_finite(given_lines):
    wanted = [piece for line in given_lines for piece in pieces(line)]
    arrays = [np.array(line).reshape(-1, 3) for line in given_lines]
    same(features.lines(arrays, UTM), wanted)
    same(features.lines({"type": "MultiLineString", "coordinates": given_lines}, UTM), wanted)
    with np.errstate(invalid="ignore"):
        whole = [shapely.linestrings(line) for line in arrays if len(line) > 1]
    same(features.lines(whole, UTM), wanted)


coordinate = st.integers(0, 6).map(float)
ring_of_numbers = st.lists(st.tuples(coordinate, coordinate), max_size=8)


@given(st.lists(st.lists(ring_of_numbers, min_size=1, max_size=3), max_size=4))
@settings(deadline=None)
def test_areas_are_valid_closed_and_oriented(polygons):
    arrays = [[np.array(ring).reshape(-1, 2) for ring in polygon] for polygon in polygons]
    found = features.areas(arrays, UTM)
    for exterior, *holes in found:
        assert shapely.Polygon(exterior, holes).is_valid
        assert shapely.is_ccw(shapely.linearrings(exterior))
        assert not any(shapely.is_ccw(shapely.linearrings(hole)) for hole in holes)
        for ring in (exterior, *holes):
            np.testing.assert_array_equal(ring[0, :2], ring[-1, :2])
    wanted = 0.0
    for exterior, *holes in polygons:
        rings = [[*hole, hole[0]] for hole in holes if len(set(hole)) > 2]
        if len(set(exterior)) > 2:
            made = shapely.make_valid(shapely.Polygon([*exterior, exterior[0]], rings))
            wanted += shapely.area(made)
    areas = [shapely.Polygon(exterior, holes).area for exterior, *holes in found]
    assert sum(areas) == pytest.approx(wanted)


def test_hostile_areas():
    bow_tie = [(0, 0, 0), (2, 2, 2), (2, 0, 2), (0, 2, 0)]
    found = features.areas(np.array(bow_tie, float), UTM)
    assert [shapely.Polygon(*area).area for area in found] == [1, 1]
    assert {tuple(vertex) for area in found for vertex in area[0]} >= {(1, 1, 1)}
    square, hole = RINGS[0][:, :2], RINGS[1][:, :2]
    doubled = features.areas(shapely.Polygon(square, [hole, hole]), UTM)
    assert shapely.Polygon(doubled[0][0], doubled[0][1:]).is_valid
    assert features.areas([[(0, 0), (1, 1)], [(0, 0), (1, 1), (2, 2)], [(5, 5)] * 4], UTM) == []
    empty_exterior = {"type": "MultiPolygon", "coordinates": [[square.tolist()], [[], hole.tolist()]]}
    assert [len(area) for area in features.areas(empty_exterior, UTM)] == [1]
    holed = np.insert(square, 2, NAN, axis=0)
    np.testing.assert_array_equal(features.areas(holed, UTM)[0][0][:, :2].max(axis=0), [9, 9])


def test_pixels_of_map_coordinates():
    source = dem(crs=UTM)
    x, y = source.pixel_to_map(np.array([3.0, 40.5]), np.array([5.0, 22.25]))
    found = features.to_pixels(source, np.column_stack([x, y, [NAN, 4]]))
    np.testing.assert_allclose(found, [[3, 5, NAN], [40.5, 22.25, 4]])
    assert features.to_pixels(source, np.empty((0, 3))).shape == (0, 3)


def test_import_and_arrays_need_numpy_alone():
    script = (
        "import sys\n"
        "for name in ('shapely', 'fiona', 'rasterio', 'pyproj'): sys.modules[name] = None\n"
        "from tin import features\n"
        "assert len(features.lines([[[0, 0], [1, 1]]], None)) == 1\n"
        "assert len(features.points({'type': 'Point', 'coordinates': [1, 2]}, None)) == 1\n"
        "assert len(features.areas([[0, 0], [1, 1], [0, 1]], None)[0][0]) == 4\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_areas_without_shapely(monkeypatch):
    """As in QGIS: the rings are closed and cleaned, and give the same TIN whichever way they turn."""
    bent = np.array([[2.0, 2, 9], [7, 2, 9], [7, 2, 9], [NAN, 5, 9], [6, 7, 9], [3, 6, 9]])
    source = dem(crs=UTM)
    x, y = source.pixel_to_map(np.array([0.0, 40.3, 52.1]), np.array([0.0, 30.7, 11.9]))
    lake = [RINGS[0][:, :2] * 100 + (x[1], y[1]), RINGS[1][:, :2] * 100 + (x[1], y[1])]
    clip = [RINGS[0][:, :2] * 200 + (x[2], y[2] - 1600)]
    whole = [[RINGS[0], RINGS[1]], [bent]]
    with_shapely = features.areas(whole, UTM)
    meshes = [tin.triangulate(source, max_points=200, flat=[lake], clip=clip)]
    monkeypatch.setitem(sys.modules, "shapely", None)
    found = features.areas(whole, UTM)
    assert [len(area) for area in found] == [2, 1]
    same(found[0], RINGS)
    same(found[1], [bent[[0, 1, 4, 5, 0]]])
    for one, other in zip(found, with_shapely):
        assert {tuple(v) for ring in one for v in ring} == {tuple(v) for ring in other for v in ring}
    incomplete = RINGS[0].copy()
    incomplete[2, 2] = NAN
    without, with_z = features.areas([[incomplete, RINGS[1]], [RINGS[0]]], UTM)
    assert np.isnan(np.concatenate(without)[:, 2]).all()
    assert not np.isnan(with_z[0]).any()
    nothing = [[(0, 0), (1, 1)], [(5, 5)] * 4, [(0, 0), (1, 1), (0, 0), (1, 1)], [(0, 0), (NAN, 1), (2, 2)]]
    assert features.areas([[np.array(ring, float), RINGS[1][:, :2]] for ring in nothing], UTM) == []
    assert [len(area) for area in features.areas([[RINGS[0][:, :2], nothing[0]]], UTM)] == [1]
    assert features.areas([], UTM) == features.areas(np.empty((0, 3)), UTM) == []
    assert code(features.areas, [[0.0, 1.0], [2.0]]) == "bad-features"
    for turn in (slice(None), slice(None, None, -1)):
        turned = [ring[turn] for ring in lake]
        meshes.append(tin.triangulate(source, max_points=200, flat=[turned], clip=[clip[0][turn]]))
    for mesh in meshes[1:]:
        np.testing.assert_array_equal(mesh.vertices, meshes[0].vertices)
        np.testing.assert_array_equal(mesh.triangles, meshes[0].triangles)
    bow_tie = np.array([(0, 0), (2000, 2000), (2000, 0), (0, 2000)], float) + (x[1], y[1])
    line = np.array([(0, 0), (100, 100), (200, 200)], float) + (x[1], y[1])
    for crossing in (bow_tie, line):
        tin.triangulate(source, max_points=200, flat=[[crossing]]).check()
    tin.triangulate(source, max_points=200, clip=[[bow_tie]]).check()


def test_many_vertices_are_no_loop():
    many = np.random.default_rng(0).normal(size=(10**6, 3)).cumsum(axis=0)
    frame = geopandas.GeoSeries(shapely.linestrings(many.reshape(-1, 10, 3)), crs=UTM)
    found = features.lines(frame, UTM)
    assert len(found) == 10**5
    np.testing.assert_array_equal(np.concatenate(found), many)
