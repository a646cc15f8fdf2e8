from __future__ import annotations

import importlib
import sys
import threading

import numpy as np
import pytest

import tin
from tin import formats, plot
from tin.errors import OutputError
from tin.formats.geotiff import signed_error

importlib.import_module("matplotlib")


def hills(rows=60, cols=90, **settings):
    row, col = np.mgrid[0:rows, 0:cols]
    random = np.random.default_rng(0)
    z = 50 * np.sin(col / 9) * np.cos(row / 7) + random.normal(0, 1, (rows, cols))
    settings = {"transform": (30, 0, 5e5, 0, -30, 5e6), "crs": "EPSG:26710", "vertical_unit": "m", **settings}
    return tin.DEM(settings.pop("z", z), **settings)


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(plot, "DPI", 40)  # quick to draw


def texts(axes):
    return "\n".join(text.get_text() for text in axes.texts)


@pytest.fixture(scope="module")
def mesh():
    z = np.array(hills().z)
    z[:12, 40:] = np.nan
    return tin.triangulate(hills(z=z, name="hills"), max_points=300)


@pytest.fixture(scope="module")
def picture(mesh):
    return plot.figure(mesh)


def test_titles_units_and_numbers(mesh, picture):
    assert picture.get_suptitle() == f"hills: 300 points, {len(mesh.triangles):,} triangles"
    assert "90 × 60 pixels" in picture.get_supxlabel()
    assert "EPSG:26710" in picture.get_supxlabel()
    terrain, errors, close_up, histogram = picture.axes[:4]
    assert terrain.get_xlabel() == "easting (metre)"
    assert terrain.get_ylabel() == "northing (metre)"
    assert terrain.get_title() == "Terrain and mesh"
    assert "close-up" in close_up.get_title()
    assert "TIN − DEM (metre)" in histogram.get_xlabel()
    written = texts(histogram)
    for name, value in (("RMSE", mesh.error().rmse), ("MAE", mesh.error().mae), ("P95", mesh.error().p95)):
        assert f"{name:5}{value:9.4g}" in written
    assert f"max  {mesh.error().max_error:9.4g}" in written
    assert f"{mesh.error().covered:,} pixels" in written


def test_the_maps_lie_where_the_dem_lies(mesh, picture):
    terrain, errors, close_up, _ = picture.axes[:4]
    for axes in (terrain, errors):
        assert axes.get_xlim() == (5e5, 5e5 + 30 * 90)
        assert axes.get_ylim() == (5e6 - 30 * 60, 5e6)
        assert axes.get_aspect() == pytest.approx(1.0)
    x, y = close_up.get_xlim(), close_up.get_ylim()
    assert terrain.get_xlim()[0] <= x[0] < x[1] <= terrain.get_xlim()[1]
    assert terrain.get_ylim()[0] <= y[0] < y[1] <= terrain.get_ylim()[1]


def test_the_error_map_is_signed_symmetric_and_empty_where_void(mesh, picture):
    image = picture.axes[1].images[0]
    low, high = image.get_clim()
    assert low == -high
    error = signed_error(mesh)
    assert high <= np.nanmax(np.abs(error))
    shown = image.get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), np.isnan(error))
    np.testing.assert_array_equal(shown.filled(np.nan), error)


def test_every_edge_is_drawn_once(mesh, picture):
    edges, outline = picture.axes[0].collections[:2]
    pairs = np.sort(np.stack([mesh.triangles, np.roll(mesh.triangles, -1, axis=1)], axis=-1), axis=-1)
    unique = np.unique(pairs.reshape(-1, 2), axis=0)
    assert len(edges.get_segments()) + len(outline.get_segments()) == len(unique)
    assert len(outline.get_segments()) == len(np.unique(pairs[mesh.constrained], axis=0))


def test_a_mesh_too_fine_to_see_is_left_out_of_the_map_and_errors_are_averaged(monkeypatch, mesh):
    monkeypatch.setattr(plot, "MAP_PIXELS", 45)
    monkeypatch.setattr(plot, "ERROR_BLOCKS", 30)
    terrain, errors, close_up, _ = plot.figure(mesh).axes[:4]
    assert "too fine" in terrain.get_title()
    assert not terrain.collections
    assert close_up.collections
    assert errors.images[0].get_array().shape == (20, 30)
    assert errors.images[0].get_clim()[0] == 0.0


def test_block_means_leave_voids_out():
    z = np.arange(35.0).reshape(5, 7)
    z[0, 0] = z[4, 6] = np.nan
    z[2:4, 2:4] = np.nan
    means = plot._block_means(z, 2)
    assert means.shape == (3, 4)
    assert means[0, 0] == np.mean([1, 7, 8])
    assert np.isnan(means[1, 1])
    assert np.isnan(means[2, 3])
    assert plot._block_means(z, 2, power=2)[0, 3] == np.mean([36.0, 169.0])
    np.testing.assert_array_equal(plot._block_means(z, 1), z)


def test_light_comes_from_the_north_west_of_the_map():
    row, col = np.mgrid[0:9, 0:9].astype(float)
    for transform in [(1, 0, 0, 0, -1, 0), (1, 0, 0, 0, 1, 0), (0, 1, 0, 1, 0, 0), (3, 1, 0, 1, -3, 0)]:
        dem = tin.DEM(row, transform=transform)
        x, y = dem.pixel_to_map(col, row)
        to_north_west = plot._hillshade(x - y, dem, 1)  # rises to the south-east: faces the light
        away = plot._hillshade(y - x, dem, 1)
        assert to_north_west.min() > away.max()


@pytest.mark.parametrize(
    "dem",
    [
        hills(transform=(8, 5, 5e5, 5, -8, 5e6)),
        hills(4, 200, transform=None, crs=None, vertical_unit="", name="a $name$ of \u5c71\nin lines"),
        hills(crs="EPSG:4326", transform=(1e-3, 0, 10, 0, -1e-3, 47)),
        tin.DEM(np.zeros((3, 2))),
    ],
    ids=["rotated", "bare and wide", "degrees", "flat and tiny"],
)
def test_any_dem_makes_a_picture(dem, tmp_path):
    formats.write(tin.triangulate(dem), tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert [file.name for file in tmp_path.iterdir()] == ["a.png"]


def test_the_same_tin_gives_the_same_bytes_also_in_a_thread(mesh, tmp_path):
    formats.write(mesh, tmp_path / "a.png")
    thread = threading.Thread(target=formats.write, args=(mesh, tmp_path / "b.png"))
    thread.start()
    thread.join()
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert "matplotlib.pyplot" not in sys.modules


def test_without_matplotlib_it_says_so(monkeypatch, mesh, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    for draw in (lambda: plot.figure(mesh), lambda: formats.write(mesh, tmp_path / "a.png")):
        with pytest.raises(OutputError) as caught:
            draw()
        assert caught.value.code == "missing-library"
        assert "matplotlib" in str(caught.value)
