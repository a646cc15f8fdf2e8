"""A TIN in another CRS: its vertices are in the right place, it stays a mesh, and every output follows."""

from __future__ import annotations

import geopandas
import numpy as np
import pyproj
import pytest
import rasterio
import shapely
from numpy.testing import assert_allclose, assert_array_equal
from terrain import dem, hills

import tin
from tin import formats, reproject
from tin.errors import InputError
from tin.formats.attributes import attributes
from tin.outline import rings

GEOGRAPHIC = (1 / 1200, 0, -84.3, 0, -1 / 1200, 36.5)


def areas(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k], :2] for k in range(3))
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def constraints(mesh):
    """The constrained edges as sets of vertices."""
    ends = np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1)[mesh.constrained]
    return {frozenset(pair) for pair in ends.tolist()}


@pytest.fixture(scope="module")
def source():
    z = hills(70, 90, 2, relief=600.0)
    z[20:40, 30:45] = np.nan
    return tin.DEM(z, transform=GEOGRAPHIC, crs="EPSG:4326", vertical_unit="m", name="hills")


@pytest.fixture(scope="module")
def mesh(source):
    return tin.triangulate(source, max_points=400)


@pytest.mark.parametrize("code", ["EPSG:32616", "EPSG:3857", "EPSG:26916", "EPSG:2274", "EPSG:32661"])
def test_vertices_are_where_pyproj_puts_them(mesh, code):
    moved = mesh.to_crs(code)
    x, y = pyproj.Transformer.from_crs(4326, code, always_xy=True).transform(*mesh.vertices[:, :2].T)
    n = len(mesh.vertices)
    assert_allclose(moved.vertices[:n], np.column_stack([x, y, mesh.vertices[:, 2]]), rtol=0, atol=1e-5)
    assert (areas(moved) > 0).all()
    assert moved.crs.code == code
    assert moved.report.crs == code
    assert (moved.report.points, moved.report.triangles) == (len(moved.vertices), len(moved.triangles))


def test_the_tin_it_was_made_of_stays_as_it_was(mesh, source):
    vertices = mesh.vertices.copy()
    moved = mesh.to_crs("utm")
    assert moved is not mesh
    assert_array_equal(mesh.vertices, vertices)
    assert mesh.crs is source.crs
    assert mesh.report.crs == "EPSG:4326"
    assert moved.dem is source
    assert moved.error() == mesh.error()
    assert_array_equal(moved.rasterize(), mesh.rasterize())
    for array in (moved.vertices, moved.triangles, moved.pixels, moved.constrained, moved.triangle_errors):
        assert not array.flags.writeable


def test_there_and_back(mesh):
    back = mesh.to_crs("utm").to_crs("EPSG:4326")
    assert_allclose(back.vertices[: len(mesh.vertices)], mesh.vertices, rtol=0, atol=1e-9)
    assert_array_equal(back.triangles[:50], mesh.to_crs("utm").triangles[:50])
    assert back.crs.code == "EPSG:4326"


@pytest.mark.parametrize("own", ["EPSG:4326", "EPSG:4326+5773"])
def test_the_same_crs_is_no_other(own):
    made = tin.triangulate(dem(transform=GEOGRAPHIC, crs=own), max_points=20)
    assert made.to_crs("EPSG:4326") is made


def test_slope_and_area_follow(mesh):
    before, after = attributes(mesh), attributes(mesh.to_crs("utm"))
    n = len(before["slope"])
    assert_allclose(after["area_2d"].sum(), before["area_2d"].sum(), rtol=2e-3)
    assert np.abs(after["slope"][:n] - before["slope"]).max() < 0.1
    assert np.median(np.abs(after["aspect"][:n] - before["aspect"])) < 3  # the meridian's convergence


def test_a_mirrored_crs_turns_the_triangles_around():
    """These axes of Krovak's point south and west."""
    czech = dem(transform=(1 / 1200, 0, 15, 0, -1 / 1200, 50), crs="EPSG:4326")
    mesh = tin.triangulate(czech, max_points=200)
    moved = mesh.to_crs("EPSG:5513")
    x, y = pyproj.Transformer.from_crs(4326, 5513, always_xy=True).transform(*mesh.vertices[:, :2].T)
    assert_allclose(moved.vertices[:, :2], np.column_stack([x, y]), rtol=0, atol=1e-3)
    assert (areas(moved) > 0).all()
    assert constraints(moved) == constraints(mesh)
    assert_array_equal(moved.triangles[:, ::-1], mesh.triangles)
    assert (areas(moved.to_crs("utm")) > 0).all()


def coast(rows=3601):
    """A degree of sea, with an island near the middle of the southern border."""
    row, col = np.arange(rows)[:, None], np.arange(rows)[None]
    z = np.maximum(0, 60 - 6 * np.hypot(row - (rows - 14), col - rows // 2)).astype(np.float32)
    step = 1 / (rows - 1)
    return tin.DEM(z, transform=(step, 0, -84, 0, -step, 61), crs="EPSG:4326", vertical_unit="m")


@pytest.fixture(scope="module")
def sea():
    # In one piece: tiles would have no edges of the sea's size.
    return tin.triangulate(coast(), tolerance=0.5, tile=0)


def test_long_edges_are_split_so_that_they_follow_the_ground(sea):
    moved = sea.to_crs("utm")
    plain = pyproj.Transformer.from_crs(4326, moved.crs.code, always_xy=True)
    corners = np.stack(plain.transform(*sea.vertices[:, :2].T), axis=-1)[sea.triangles]
    assert not shapely.is_ccw(shapely.linearrings(corners)).all()  # or this test shows nothing

    assert (areas(moved) > 0).all()
    assert 0 < len(moved.vertices) - len(sea.vertices) < 60
    ends = np.stack([moved.triangles, np.roll(moved.triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    x, y = moved.dem.pixel_to_map(*moved.pixels[ends].mean(axis=1).T)
    off = np.stack(plain.transform(x, y), axis=-1) - moved.vertices[ends][:, :, :2].mean(axis=1)
    assert np.hypot(*off.T).max() < 31.0  # a second of latitude is a pixel

    # Still one mesh without gaps: the pieces of each triangle fill it, and fit their neighbours.
    pieces = shapely.polygons(moved.vertices[moved.triangles][..., :2])
    (outline,) = moved.outline()
    assert shapely.Polygon(outline[0]).area == pytest.approx(shapely.area(pieces).sum(), rel=1e-9)
    assert len(moved.triangles) == 2 * len(moved.vertices) - (len(outline[0]) - 1) - 2  # Euler
    in_pixels = shapely.area(shapely.polygons(moved.pixels[moved.triangles])).sum()
    assert in_pixels == 3600 * 3600
    border = {frozenset(pair) for pair in zip(rings(moved.triangles)[0][0], rings(moved.triangles)[0][0][1:])}
    assert border <= constraints(moved)
    assert moved.triangle_errors.max() == sea.triangle_errors.max()


def test_heights_of_split_edges_lie_on_the_tin(sea):
    moved = sea.to_crs("utm")
    added = slice(len(sea.vertices), None)
    col, row = moved.pixels[added].T
    surface = sea.rasterize()
    whole = (col == np.rint(col)) & (row == np.rint(row))
    assert whole.any()
    heights = surface[row[whole].astype(int), col[whole].astype(int)]
    assert_allclose(moved.vertices[added, 2][whole], heights, atol=1e-9)


@pytest.mark.parametrize(
    ("place", "crs", "goal", "code"),
    [
        ((0.01, 0, 179.5, 0, -0.01, 10.0), "EPSG:4326", "EPSG:3857", "turned-over"),
        ((1000.0, 0, 650000.0, 0, -1000.0, 6e6), "EPSG:32660", "EPSG:4326", "turned-over"),
        ((1000.0, 0, 20000000.0, 0, -1000.0, 6e6), "EPSG:3857", "EPSG:4326", "turned-over"),
        ((1000.0, 0, 1950000.0, 0, -1000.0, 2050000.0), "EPSG:32661", "EPSG:4326", "turned-over"),
        ((3.0, 0, 0.0, 0, -3.0, 89.0), "EPSG:4326", "EPSG:32631", "outside-crs"),
        ((0.01, 0, 10, 0, -0.01, 90.5), "EPSG:4326", "EPSG:3857", "outside-crs"),
        ((0.1, 0, 88, 0, -0.1, 5.0), "EPSG:4326", "+proj=ortho +lat_0=0 +lon_0=0", "outside-crs"),
    ],
)
def test_what_would_be_torn_is_refused(place, crs, goal, code, capfd):
    for method in ("auto", "max"):
        mesh = tin.triangulate(dem(60, 100, transform=place, crs=crs), max_points=200, method=method)
        with pytest.raises(InputError) as caught:
            mesh.to_crs(goal)
        assert caught.value.code == code, caught.value
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_without_a_crs():
    with pytest.raises(InputError) as caught:
        tin.triangulate(dem(), max_points=20).to_crs("utm")
    assert caught.value.code == "no-crs"


def test_every_output_follows(mesh, tmp_path):
    moved = mesh.to_crs("utm")
    for suffix in (".gpkg", ".obj", ".tif", ".nc", ".png"):
        moved.write(tmp_path / f"x{suffix}")
    formats.write_error_map(moved, tmp_path / "error.tif")
    formats.write_outline(moved, tmp_path / "outline.gpkg")

    frame = geopandas.read_file(tmp_path / "x.gpkg")
    assert frame.crs.to_epsg() == 32616
    assert_allclose(frame.area, frame["area_2d"])
    assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry)).all()
    assert moved.to_geodataframe().crs.to_epsg() == 32616
    assert pyproj.CRS((tmp_path / "x.prj").read_text()).to_epsg() == 32616
    header = (tmp_path / "x.obj").read_text()[:2000]
    assert "# CRS: EPSG:32616 (WGS 84 / UTM zone 16N)" in header
    assert "# horizontal unit: metre\n" in header
    assert b"EPSG:32616" in (tmp_path / "x.nc").read_bytes()
    assert b"projection_x_coordinate" in (tmp_path / "x.nc").read_bytes()
    outline = geopandas.read_file(tmp_path / "outline.gpkg")
    assert outline.crs.to_epsg() == 32616
    assert outline.area.sum() == pytest.approx(frame.area.sum(), rel=1e-9)

    with rasterio.open(tmp_path / "x.tif") as heights, rasterio.open(tmp_path / "error.tif") as errors:
        assert heights.crs.to_epsg() == errors.crs.to_epsg() == 32616
        assert heights.shape == errors.shape
        assert heights.transform == errors.transform
        grid, missing = heights.read(1), heights.read_masks(1) == 0
        assert np.isnan(errors.nodata)
        error = errors.read(1)
    assert missing.any()
    # The raster is the TIN that the triangles are: compared at vertices inside, whose heights it meets.
    col, row = (~heights.transform) * (moved.vertices[:, 0], moved.vertices[:, 1])
    near = (np.floor(row).astype(int), np.floor(col).astype(int))
    known = ~missing[near]
    off = np.abs(grid[near] - moved.vertices[:, 2])[known]
    assert known.mean() > 0.9
    assert np.median(off) < 2.0  # half a pixel off, on slopes of metres a pixel
    assert np.sqrt(np.nanmean(error.astype(float) ** 2)) == pytest.approx(moved.error().rmse, rel=0.25)


def test_the_picture_is_a_map_in_its_crs(mesh):
    picture = mesh.to_crs("EPSG:3035").plot()
    assert "EPSG:3035" in picture.get_supxlabel()
    assert "90 × 70 pixels" in picture.get_supxlabel()
    terrain, histogram = picture.axes[0], picture.axes[3]
    assert terrain.get_xlabel() == "easting (metre)"
    assert f"{mesh.error().covered:,} pixels" in "\n".join(text.get_text() for text in histogram.texts)
    (low, high), places = terrain.get_xlim(), mesh.to_crs("EPSG:3035").vertices[:, 0]
    assert low <= places.min() < places.max() <= high


def test_drawing_needs_no_other_grid_without_another_crs(mesh):
    assert reproject.on_own_grid(mesh) is mesh
