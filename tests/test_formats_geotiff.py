from __future__ import annotations

import numpy as np
import pyproj
import pytest
import rasterio
from fakes import UTM, FakeCRS, crs, grid_tin
from numpy.testing import assert_array_equal

from tin.formats import geotiff, write


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.tif"


def test_the_grid_is_the_one_of_the_dem(path):
    tin = grid_tin(crs=crs("EPSG:26710"), nodata=-32767.0)
    write(tin, path)
    with rasterio.open(path) as raster:
        assert raster.shape == tin.dem.shape
        assert tuple(raster.transform)[:6] == UTM
        assert raster.crs.to_epsg() == 26710
        assert raster.nodata == -32767
        assert raster.dtypes == ("float32",)
        assert raster.units == ("metre",)
        assert raster.descriptions == ("TIN of hills",)
        assert raster.profile["tiled"]
        assert raster.compression.name == "deflate"
        assert raster.tags(ns="IMAGE_STRUCTURE")["PREDICTOR"] == "3"
        heights = raster.read(1, masked=True)
    assert_array_equal(heights.mask, np.isnan(tin.heights))
    assert_array_equal(heights.filled(np.nan), tin.heights.astype(np.float32))
    assert [file.name for file in path.parent.iterdir()] == ["out.tif"]


@pytest.mark.parametrize(
    ("declared", "written"),
    [
        (-32767.0, -32767.0),
        (float(np.finfo(np.float32).min), float(np.finfo(np.float32).min)),
        (float("nan"), float("nan")),
        (float("inf"), -9999.0),
        (-1.7976931348623157e308, -9999.0),
        (-32767.1, -9999.0),
        (301.0, -9999.0),
        (None, -9999.0),
    ],
)
def test_nodata_is_one_that_float32_holds_and_no_height_is(path, declared, written):
    tin = grid_tin(nodata=declared)
    tin.heights[3, 4] = 301.0
    write(tin, path)
    with rasterio.open(path) as raster:
        assert_array_equal(raster.nodata, written)
        assert_array_equal(raster.read_masks(1) == 0, np.isnan(tin.heights))


def test_nan_is_the_last_resort(path):
    tin = grid_tin(nodata=1e300)
    tin.heights[3, 4] = -9999.0
    write(tin, path)
    with rasterio.open(path) as raster:
        assert np.isnan(raster.nodata)
        assert_array_equal(np.isnan(raster.read(1)), np.isnan(tin.heights))


def test_a_full_raster_without_nodata_declares_none(path):
    tin = grid_tin()
    tin.heights[0, 0] = 300.0
    write(tin, path)
    with rasterio.open(path) as raster:
        assert raster.nodata is None


@pytest.mark.parametrize(
    "transform", [(1, 0, 0, 0, 1, 0), (1, 0, 0, 0, -1, 12), (3, 1, 5, 2, -4, 7), (30, 0, 5, 0, 30, 7)]
)
def test_any_transform_without_a_crs(path, transform):
    write(grid_tin(transform=transform, vertical_unit=""), path)
    with rasterio.MemoryFile(path.read_bytes()) as memory, pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)
        with memory.open() as raster:
            assert tuple(raster.transform)[:6] == transform
            assert raster.crs is None


@pytest.mark.parametrize("code", ["EPSG:4326", "EPSG:2227", "ESRI:102001", "EPSG:5498"])
def test_other_crs_are_kept(path, code):
    write(grid_tin(crs=crs(code)), path)
    with rasterio.open(path) as raster:
        assert (
            pyproj.CRS(raster.crs.to_wkt()).to_2d().equals(pyproj.CRS(code).to_2d(), ignore_axis_order=True)
        )


def test_a_crs_without_a_code_goes_by_its_wkt(path):
    wkt = pyproj.CRS("+proj=aea +lat_0=33 +lon_0=-101 +lat_1=30 +lat_2=41 +ellps=GRS80").to_wkt()
    write(grid_tin(crs=FakeCRS(wkt)), path)
    with rasterio.open(path) as raster:
        projection = raster.crs.to_dict()
        assert projection["proj"] == "aea"
        assert (projection["lat_1"], projection["lat_2"], projection["lon_0"]) == (30, 41, -101)


def test_old_overviews_and_statistics_go_with_the_old_file(path):
    write(grid_tin(), path)
    for suffix in (".ovr", ".aux.xml", ".msk"):
        path.with_name(path.name + suffix).write_text("stale")
    write(grid_tin(), path, overwrite=True)
    assert [file.name for file in path.parent.iterdir()] == ["out.tif"]


def test_the_number_of_threads_changes_no_byte(path, monkeypatch):
    tin = grid_tin(700, 900, crs=crs("EPSG:26710"))
    write(tin, path)
    many = path.read_bytes()
    for threads in (1, 3):
        monkeypatch.setitem(geotiff._PACKING, "num_threads", threads)
        write(tin, path, overwrite=True)
        assert path.read_bytes() == many
