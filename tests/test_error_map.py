from __future__ import annotations

import numpy as np
import pytest
import rasterio
from fakes import UTM, crs, grid_tin
from numpy.testing import assert_allclose, assert_array_equal

import tin
from tin import formats
from tin.errors import OutputError


@pytest.fixture
def mesh():
    row, col = np.mgrid[0:40, 0:50]
    z = 2500 + 30 * np.sin(row / 5) * np.cos(col / 7)
    z[:6, :9] = np.nan
    dem = tin.DEM(z, transform=UTM, crs="EPSG:26710", vertical_unit="m", nodata=-9999, name="hills")
    return tin.triangulate(dem, max_points=60)


def test_it_is_the_tin_less_the_dem_on_the_grid_of_the_dem(mesh, tmp_path):
    path = tmp_path / "error.tif"
    formats.write_error_map(mesh, path)
    with rasterio.open(path) as raster:
        assert raster.shape == mesh.dem.shape
        assert tuple(raster.transform)[:6] == UTM
        assert raster.crs.to_epsg() == 26710
        assert raster.dtypes == ("float32",)
        assert np.isnan(raster.nodata)
        assert raster.units == ("metre",)
        assert raster.descriptions == ("error of TIN of hills",)
        assert raster.profile["tiled"]
        assert raster.compression.name == "deflate"
        error = raster.read(1)
    assert_array_equal(np.isnan(error), ~mesh.dem.valid | np.isnan(mesh.rasterize()))
    assert_array_equal(error, (mesh.rasterize() - mesh.dem.z).astype(np.float32))
    known = error[np.isfinite(error)].astype(np.float64)
    assert_allclose(np.sqrt(np.mean(known**2)), mesh.error().rmse, rtol=1e-6)
    assert_allclose(np.abs(known).max(), mesh.error().max_error, rtol=1e-6)
    assert_allclose(known.mean(), mesh.error().mean, atol=1e-6)


def test_where_only_the_tin_has_a_height_there_is_no_error(tmp_path):
    fake = grid_tin(crs=crs("EPSG:26710"))
    fake.dem.z = np.full(fake.dem.shape, 300.0)
    fake.dem.z[5, 5] = np.nan
    formats.write_error_map(fake, tmp_path / "error.tif")
    with rasterio.open(tmp_path / "error.tif") as raster:
        error = raster.read(1)
    assert np.argwhere(np.isnan(error)).tolist() == [[0, 0], [5, 5]]


def test_an_existing_file_is_kept(mesh, tmp_path):
    path = tmp_path / "error.tif"
    path.write_text("mine")
    with pytest.raises(OutputError) as caught:
        formats.write_error_map(mesh, path)
    assert caught.value.code == "exists"
    assert path.read_text() == "mine"
    formats.write_error_map(mesh, path, overwrite=True)
    assert path.stat().st_size > 1000
    assert [file.name for file in tmp_path.iterdir()] == ["error.tif"]


def test_only_geotiff(mesh, tmp_path):
    with pytest.raises(OutputError) as caught:
        formats.write_error_map(mesh, tmp_path / "error.gpkg")
    assert caught.value.code == "unknown-suffix"
    assert ".tif" in str(caught.value)


@pytest.mark.parametrize(
    ("outputs", "name", "code"),
    [
        ([], "error.gpkg", "unknown-suffix"),
        (["a.tif"], "a.tif", "duplicate-output"),
        ([], "no/error.tif", "no-directory"),
        ([], "in.tif", "same-as-input"),
        ([], "old.tif", "exists"),
    ],
)
def test_it_is_checked_before_the_work(tmp_path, outputs, name, code):
    (tmp_path / "old.tif").touch()
    with pytest.raises(OutputError) as caught:
        formats.check_outputs(
            [tmp_path / output for output in outputs],
            inputs=[tmp_path / "in.tif"],
            error_map=tmp_path / name,
        )
    assert caught.value.code == code
