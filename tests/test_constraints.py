"""Breaklines, points with heights, clip polygons and level areas, against oracles of their own."""

from __future__ import annotations

import numpy as np
import pyogrio
import pytest
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon, box
from terrain import hills

import tin
from tin.errors import InputError

ONE_TO_ONE = (1.0, 0.0, -0.5, 0.0, 1.0, -0.5)  # map x, y are column and row
LATTICE = 1 / 256
Z = hills(60, 80)


def dem(z=Z, **keywords):
    return tin.DEM(z, transform=keywords.pop("transform", ONE_TO_ONE), **keywords)


def with_voids():
    z = Z.copy()
    z[20:30, 30:50] = np.nan
    z[:5, :5] = np.nan
    return dem(z)


def mesh_of(source=None, **options):
    made = tin.triangulate(dem() if source is None else source, **{"max_points": "10%", **options})
    made.check()
    return made


def constrained_edges(mesh):
    """(k, 2) the ends of the constrained edges, each once."""
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1)[mesh.constrained]
    return np.unique(np.sort(ends.astype(int), axis=1), axis=0)


def is_followed(mesh, line, off=6 * LATTICE):
    """Whether constrained edges lead along the line, no farther from it than ``off``."""
    line = np.asarray(line, float)[:, :2]
    edges = constrained_edges(mesh)
    shape = LineString(line)
    is_near = shapely.dwithin(shapely.points(mesh.pixels), shape, off)
    reach = {}
    for a, b in edges[is_near[edges].all(axis=1)].tolist():
        reach.setdefault(a, []).append(b)
        reach.setdefault(b, []).append(a)
    numbers = [int(np.argmin(np.hypot(*(mesh.pixels - place).T))) for place in line]
    assert np.hypot(*(mesh.pixels[numbers] - line).T).max() <= off
    for start, end in zip(numbers, numbers[1:]):
        seen, stack = {start}, [start]
        while stack:
            for b in reach.get(stack.pop(), []):
                if b not in seen:
                    seen.add(b)
                    stack.append(b)
        if end not in seen:
            return False
    return True


def surface(mesh, places):
    """Heights of the TIN at (n, 2) columns and rows, triangle by triangle; NaN where there is none."""
    a, b, c = (mesh.pixels[mesh.triangles[:, k]] for k in range(3))
    found = np.full(len(places), np.nan)
    (bx, by), (cx, cy) = (b - a).T, (c - a).T
    area = bx * cy - by * cx
    for i, place in enumerate(np.asarray(places, float)):
        px, py = (place - a).T
        u, v = (px * cy - py * cx) / area, (bx * py - by * px) / area
        inside = np.flatnonzero((u > -1e-9) & (v > -1e-9) & (u + v < 1 + 1e-9))
        if len(inside):
            t = inside[0]
            za, zb, zc = mesh.vertices[mesh.triangles[t], 2]
            found[i] = za + u[t] * (zb - za) + v[t] * (zc - za)
    return found


def along(start, end, count=97):
    share = np.linspace(0, 1, count)[:, None]
    return np.asarray(start, float) + share * (np.asarray(end, float) - start)


@pytest.mark.parametrize("method", ["auto", "median", "max"])
@pytest.mark.parametrize("limit", [{"max_points": "10%"}, {"tolerance": 1.0}, {"max_points": 5}])
def test_the_tin_runs_straight_along_a_breakline_with_heights(method, limit):
    line = [(3, 4, -50), (61, 33, 150), (70.5, 57.25, 20)]
    mesh = mesh_of(breaklines=[line], method=method, **limit)
    assert is_followed(mesh, line, LATTICE)
    grid = mesh.rasterize()
    for k in range(0, 59, 2):  # the pixels that lie on the first part
        col, row = 3 + k, 4 + k // 2
        assert grid[row, col] == pytest.approx(-50 + 200 * k / 58, abs=1e-9)
    for start, end in zip(line, line[1:]):
        wanted = along(start, end)
        np.testing.assert_allclose(surface(mesh, wanted[:, :2]), wanted[:, 2], atol=1e-7)


def test_lines_anywhere_keep_their_heights():
    random = np.random.default_rng(3)
    for _ in range(40):
        line = random.uniform((0, 0, -100), (79, 59, 300), (2, 3))
        mesh = mesh_of(breaklines=line, max_points=200)
        assert is_followed(mesh, line, LATTICE)
        line[:, :2] = np.rint(line[:, :2] / LATTICE) * LATTICE  # its vertices are moved to the lattice
        wanted = along(*line)
        np.testing.assert_allclose(surface(mesh, wanted[:, :2]), wanted[:, 2], atol=1e-6)


@pytest.mark.parametrize("soft", [False, True])
def test_a_line_without_heights_takes_those_of_the_dem(soft):
    place = np.array([(3.25, 4.5), (60.125, 33.0), (70.5, 57.25)])
    line = np.column_stack([place, [9999.0] * 3]) if soft else place
    mesh = mesh_of(breaklines=line, soft=soft, method="max", tolerance=2.0)
    assert is_followed(mesh, line, LATTICE)
    assert np.nanmax(np.abs(mesh.rasterize() - Z)) <= 2.0 + 1e-9
    for col, row in place:
        (c, r), (u, v) = (int(col), int(row)), (col % 1, row % 1)
        quad = np.pad(Z, ((0, 1), (0, 1)), mode="edge")[r : r + 2, c : c + 2]
        wanted = [1 - v, v] @ quad @ [1 - u, u]
        (found,) = np.flatnonzero((mesh.pixels == (col, row)).all(axis=1))
        # A cell of pixels is bilinear or two triangles, but between its corners.
        assert quad.min() <= mesh.vertices[found, 2] <= quad.max()
        assert mesh.vertices[found, 2] == pytest.approx(wanted, abs=0.3)


@pytest.mark.parametrize("method", ["auto", "max"])
def test_a_tolerance_holds_for_all_pixels_but_those_with_heights_of_their_own(method):
    lake = box(40.25, 35.25, 60.75, 50.75)
    options = {"breaklines": [(3, 4, -50), (61, 33, 150)], "flat": lake, "clip": box(1.3, 1.3, 77.6, 57.7)}
    mesh = mesh_of(points=[(20.4, 40.3, 500)], method=method, tolerance=1.0, max_points=None, **options)
    row, col = np.mgrid[:60, :80]
    # A quarter of a pixel around what has heights of its own belongs to it.
    hard = shapely.union(lake, shapely.LineString([(3, 4), (61, 33)]))
    is_given = shapely.dwithin(hard, shapely.points(col, row), 0.25 + 1e-9)
    error = np.abs(mesh.rasterize() - Z)
    assert np.nanmax(error[~is_given]) <= 1.0 + 1e-9
    assert mesh.report.stop_reason == "tolerance"
    assert mesh.report.errors.max_error == pytest.approx(np.nanmax(error))


def test_heights_of_some_vertices_hold_at_those():
    line = [(5, 5, 500.0), (20, 11, np.nan), (40, 20, -300.0), (50, 20, -300.0)]
    mesh = mesh_of(breaklines=line)
    heights = {tuple(p): z for p, z in zip(mesh.pixels.tolist(), mesh.vertices[:, 2].tolist())}
    assert (heights[5, 5], heights[40, 20], heights[50, 20]) == (500.0, -300.0, -300.0)
    assert Z.min() <= heights[20, 11] <= Z.max()
    np.testing.assert_allclose(mesh.rasterize()[20, 40:51], -300.0)


def test_spot_heights_keep_place_and_height():
    random = np.random.default_rng(5)
    spots = random.uniform((0, 0, -500), (79, 59, 900), (300, 3))
    for options in ({}, {"method": "median"}, {"method": "max", "tolerance": 3.0}, {"tolerance": 3.0}):
        mesh = mesh_of(points=spots, **options)
        heights = {tuple(p): z for p, z in zip(mesh.pixels.tolist(), mesh.vertices[:, 2].tolist())}
        kept = [heights[tuple(np.rint(p / LATTICE) * LATTICE)] for p in spots[:, :2]]
        assert kept == spots[:, 2].tolist()


def test_a_spot_height_beyond_the_outermost_centres_is_told():
    spots = [(-0.3, 10.0, 7.0), (79.4, 59.4, 7.0), (0.0, 10.0, 7.0)]
    mesh = mesh_of(points=spots)
    assert mesh.report.warnings == ["points: 2 of 3 points lie outside the DEM"]
    assert (mesh.vertices[:, 2] == 7.0).sum() == 1
    assert mesh_of(points=[spot[:2] for spot in spots]).report.warnings == []  # moved to the nearest pixels


def test_what_lies_on_the_outermost_pixels_is_not_lost_by_rounding():
    random = np.random.default_rng(0)
    for size in (30.0, 0.1, 2.5, 1 / 1200, 1 / 3600):
        for _ in range(10):
            low, high = ((-180, -80), (180, 80)) if size < 0.01 else ((2e5, 1e5), (8e5, 9e6))
            left, top = random.uniform(low, high)
            source = dem(transform=(size, 0.0, left, 0.0, -size, top))
            x, y = left + size * np.array([0.5, 79.5]), top - size * np.array([0.5, 59.5])
            ring = [(x[i], y[j], 500.0) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))]
            spots = mesh_of(source, points=ring[:4], max_points=50)
            assert (spots.vertices[:, 2] == 500.0).sum() == 4
            grid = mesh_of(source, breaklines=ring, max_points=50).rasterize()
            border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
            np.testing.assert_allclose(border, 500.0)


def polygon_of(mesh):
    return shapely.union_all([Polygon(p[0][:, :2], [hole[:, :2] for hole in p[1:]]) for p in mesh.outline()])


CLIPS = {
    "box": box(10.3, 8.7, 55.1, 44.9),
    "hole": Polygon(box(5, 5, 70, 50).exterior.coords, [box(20, 20, 40.5, 40.5).exterior.coords]),
    "several": MultiPolygon(
        [
            Polygon(box(2, 2, 30, 50).exterior.coords, [shapely.Point(15, 20).buffer(7).exterior.coords]),
            shapely.Point(55, 30).buffer(21),
        ]
    ),
    "across the border": shapely.Point(0, 0).buffer(40.2),
    "all": box(-100, -100, 500, 500),
    "island in a hole": MultiPolygon(
        [
            Polygon(box(5, 5, 70, 50).exterior.coords, [box(20, 15, 60, 45).exterior.coords]),
            box(30, 20.2, 50.3, 35),
        ]
    ),
    "overlapping": [box(5, 5, 30, 30), box(20, 20, 50, 50)],
    "bow tie": [[(5, 5), (60, 50), (60, 5), (5, 50)]],
}


@pytest.mark.parametrize("name", CLIPS)
@pytest.mark.parametrize("has_voids", [False, True])
def test_what_is_left_is_the_data_within_the_clip_polygons(name, has_voids):
    source = with_voids() if has_voids else dem()
    mesh = mesh_of(source, clip=CLIPS[name], outline_tolerance="0px")
    parts = CLIPS[name] if isinstance(CLIPS[name], list) else [CLIPS[name]]
    clip = shapely.union_all([shapely.make_valid(p if hasattr(p, "wkt") else Polygon(p)) for p in parts])
    if name == "bow tie":
        clip = Polygon([(5, 5), (60, 50), (60, 5), (5, 50)]).buffer(0) if clip.area == 0 else clip
    wanted = shapely.intersection(clip, polygon_of(mesh_of(source, outline_tolerance="0px")))
    found = polygon_of(mesh)
    assert found.area == pytest.approx(wanted.area, rel=1e-3)
    assert shapely.symmetric_difference(found, wanted).area < 1e-3 * wanted.area
    row, col = np.mgrid[:60, :80]
    outside = ~shapely.dwithin(wanted, shapely.points(col, row), 2 * LATTICE)
    inside = shapely.contains_xy(shapely.buffer(wanted, -2 * LATTICE), col, row)
    covered = np.isfinite(mesh.rasterize())
    assert not (covered & outside).any()
    assert covered[inside].all()


def test_polygons_and_lines_in_another_crs():
    import geopandas

    source = tin.DEM(Z, transform=(30.0, 0.0, 500000.0, 0.0, -30.0, 5_100_000.0), crs="EPSG:32610")
    clip = box(500300, 5_098_600, 501800, 5_099_700)
    line = LineString([(500400, 5_098_700, 777), (501700, 5_099_500, 777)])
    frames = [
        geopandas.GeoSeries([shape], crs="EPSG:32610").to_crs("EPSG:4326")
        for shape in (clip.segmentize(5), line)
    ]
    mesh = mesh_of(source, clip=frames[0], breaklines=frames[1])
    assert polygon_of(mesh).area == pytest.approx(clip.area, rel=1e-3)
    on_line = shapely.dwithin(line, shapely.points(mesh.vertices[:, :2]), 1.0)
    assert on_line.sum() >= 2
    np.testing.assert_allclose(mesh.vertices[on_line, 2], 777)


LAKE = Polygon([(20.5, 15.25), (60.5, 10.25), (66.5, 40.25), (30.5, 44.25)])
ISLAND = box(35.25, 20.25, 45.25, 30.25)


def places_in(mesh, area, within=True):
    points = shapely.points(mesh.pixels)
    return shapely.dwithin(area, points, 6 * LATTICE) if within else shapely.contains_properly(area, points)


@pytest.mark.parametrize("given", [None, 123.5])
@pytest.mark.parametrize("method", ["auto", "median", "max"])
def test_a_lake_is_level_and_its_island_is_not(given, method):
    lake = Polygon(LAKE.exterior.coords, [ISLAND.exterior.coords])
    level = given
    if given is None:
        row, col = np.mgrid[:60, :80]
        level = np.quantile(Z[shapely.contains_xy(lake, col, row)], 0.5, method="lower")
    options = {"despike": False} if method == "auto" else {}
    flat = lake if given is None else shapely.force_3d(lake, given)
    mesh = mesh_of(flat=flat, method=method, **options)
    heights = mesh.vertices[places_in(mesh, lake), 2]
    assert len(heights) >= 8
    assert len(set(heights.tolist())) == 1
    assert heights[0] == pytest.approx(level, abs=0.0 if given else 0.5)
    row, col = np.mgrid[:60, :80]
    in_lake, on_island = (shapely.contains_xy(shape, col, row) for shape in (lake, ISLAND))
    grid = mesh.rasterize()
    np.testing.assert_allclose(grid[in_lake], heights[0])
    # There the mesh is the terrain's.
    assert np.abs(grid - Z)[on_island].mean() < 0.25 * np.abs(heights[0] - Z)[on_island].mean()
    assert is_followed(mesh, LAKE.exterior.coords) and is_followed(mesh, ISLAND.exterior.coords)


def test_lakes_across_the_border_in_voids_and_over_each_other():
    lakes = [box(-20, -20, 10, 10), box(70, 40, 200, 300), box(25, 15, 40, 27), box(32, 20, 60, 50)]
    levels = [10.0, 20.0, 30.0, 40.0]
    mesh = mesh_of(with_voids(), flat=[shapely.force_3d(lake, z) for lake, z in zip(lakes, levels)])
    grid = mesh.rasterize()
    row, col = np.mgrid[:60, :80]
    for number, (lake, z) in enumerate(zip(lakes, levels)):
        alone = shapely.difference(lake, shapely.union_all(lakes[:number]))
        here = places_in(mesh, shapely.buffer(alone, -6 * LATTICE), within=False)
        assert set(mesh.vertices[here, 2].tolist()) <= {z}
        if number < 3:  # the fourth leans on the third, where they meet
            inside = shapely.contains_xy(lake, col, row) & np.isfinite(grid)
            assert inside.any()
            np.testing.assert_allclose(grid[inside], z)
    assert np.isnan(grid[22:28, 42:48]).all()


def test_the_gpkg_marks_exactly_the_constrained_edges(tmp_path):
    mesh = mesh_of(with_voids(), breaklines=[[(5, 7), (70, 50)]], flat=LAKE, clip=box(2, 2, 77, 57))
    mesh.write(tmp_path / "x.gpkg")
    table = pyogrio.raw.read(tmp_path / "x.gpkg", columns=["constraints", "v0", "v1", "v2"])
    names = list(table[0]["fields"])
    column = dict(zip(names, table[3]))
    bits = column["constraints"][:, None] >> np.arange(3) & 1
    assert (bits == mesh.constrained).all()
    corners = np.column_stack([column[f"v{k}"] for k in range(3)])
    assert (corners == mesh.triangles).all()
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1)
    marked = {tuple(sorted(edge)) for edge in ends[bits == 1].tolist()}
    count = {}
    for edge in ends.reshape(-1, 2).tolist():
        count[tuple(sorted(edge))] = count.get(tuple(sorted(edge)), 0) + 1
    assert {edge for edge, times in count.items() if times == 1} <= marked  # the border of the TIN
    shores = shapely.union_all([LAKE.exterior, LineString([(5, 7), (70, 50)])])
    for a, b in marked:
        middle = shapely.Point(mesh.pixels[[a, b]].mean(axis=0))
        assert count[a, b] == 1 or shapely.dwithin(shores, middle, 6 * LATTICE)
    on_line = shapely.LineString([(5, 7), (70, 50)])
    inner = shapely.difference(on_line, shapely.buffer(box(29, 19, 50, 30), 0.1))
    drawn = shapely.union_all([LineString(mesh.pixels[list(edge)]) for edge in marked])
    assert shapely.difference(inner, shapely.buffer(drawn, 6 * LATTICE)).length < 1e-6


@pytest.mark.parametrize(
    ("keywords", "code"),
    [
        ({"breaklines": shapely.Point(3, 3)}, "not-lines"),
        ({"points": box(0, 0, 1, 1)}, "not-points"),
        ({"clip": LineString([(0, 0), (9, 9)])}, "not-polygons"),
        ({"flat": shapely.Point(3, 3)}, "not-polygons"),
        ({"clip": box(200, 200, 300, 300)}, "clip-outside"),
        ({"clip": []}, "clip-outside"),
        ({"clip": box(35, 22, 45, 27)}, "clip-outside"),
        ({"clip": box(5.1, 5.1, 5.101, 5.101)}, "clip-outside"),
        ({"breaklines": "nowhere.gpkg"}, "not-found"),
        ({"breaklines": 5}, "bad-features"),
        ({"points": [(1, 2, 3, 4)]}, "bad-features"),
        ({"breaklines": [[(5, 5, 1e39), (7, 7, 1e39)]]}, "height-range"),
        ({"points": [(5, 5, -1e39)]}, "height-range"),
        ({"flat": shapely.force_3d(box(5, 5, 9, 9), 1e39)}, "height-range"),
    ],
)
def test_what_cannot_be_followed_is_refused(keywords, code):
    with pytest.raises(InputError) as caught:
        tin.triangulate(with_voids(), **keywords)
    assert caught.value.code == code
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"breaklines": []}, ["there are no lines"]),
        ({"points": shapely.MultiPoint()}, ["there are no points"]),
        ({"flat": []}, ["there are no polygons"]),
        ({"breaklines": [[(5, 5), (5, 5)]]}, ["there are no lines"]),
        ({"breaklines": [[(500, 5), (600, 5)], [(1, 1), (9, 9)]]}, ["1 of 2 lines lie outside"]),
        ({"points": [(500, 5)]}, ["1 of 1 points lie outside"]),
        ({"flat": box(500, 500, 600, 600)}, ["1 of 1 polygons lie outside"]),
        ({"breaklines": [[(5, 5, 0), (9, 9, 0)]]}, ["all heights are 0"]),
        ({"points": [(5, 5, 0)]}, ["all heights are 0"]),
        ({"flat": shapely.force_3d(box(5, 5, 9, 9), 0.0)}, ["all heights are 0"]),
        ({"breaklines": [[(5, 5, 0), (9, 9, 0)]], "soft": True}, []),
        ({"points": [(5, 5, 0), (9, 9, 8)], "flat": shapely.force_3d(box(5, 5, 9, 9), 7.0)}, []),
    ],
)
def test_what_is_perhaps_a_mistake_is_told(keywords, words):
    warnings = mesh_of(dem(Z + 1000.0), **keywords).report.warnings
    assert len(warnings) == len(words)
    for word, warning in zip(words, warnings):
        assert word in warning
