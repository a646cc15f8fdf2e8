import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasters import COLS, HEIGHTS, ROWS, edit, write

from tin.reader import open as open_dem


@pytest.mark.parametrize("nodata", [-9999, 0, 255.5, -9999.123456789])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_nodata_by_value(tmp_path, nodata, dtype):
    heights = HEIGHTS.astype(dtype)
    heights[2:5, 3] = nodata
    heights[7, 7:9] = np.nan, np.inf
    dem = open_dem(write(tmp_path / "dem.tif", heights, nodata=nodata))
    assert np.isnan(dem.z[2:5, 3]).all()
    assert np.isnan(dem.z[7, 7:9]).all()
    assert dem.n_valid == ROWS * COLS - 5
    assert dem.nodata == pytest.approx(nodata, rel=1e-6)


@pytest.mark.parametrize(("dtype", "nodata"), [("int16", -32768), ("uint16", 65535), ("int32", -(2**31))])
def test_nodata_of_integers(tmp_path, dtype, nodata):
    heights = HEIGHTS.astype(dtype)
    heights[2, 3] = nodata
    dem = open_dem(write(tmp_path / "dem.tif", heights, nodata=nodata))
    assert dem.n_valid == ROWS * COLS - 1


def test_nodata_nan(tmp_path):
    heights = HEIGHTS.astype(np.float32)
    heights[2, 3] = np.nan
    dem = open_dem(write(tmp_path / "dem.tif", heights, nodata=np.nan))
    assert dem.n_valid == ROWS * COLS - 1
    assert np.isnan(dem.nodata)


@pytest.mark.parametrize("internal", [True, False])
def test_mask_band(tmp_path, internal):
    mask = np.full((ROWS, COLS), 255, np.uint8)
    mask[5:8, 5:8] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal):
        path = edit(write(tmp_path / "dem.tif"), lambda dataset: dataset.write_mask(mask))
    assert (tmp_path / "dem.tif.msk").exists() is not internal
    np.testing.assert_array_equal(open_dem(path).valid, mask > 0)


def test_mask_band_and_nodata_together(tmp_path):
    heights = HEIGHTS.copy()
    heights[1, 1] = -1
    mask = np.full((ROWS, COLS), 255, np.uint8)
    mask[5, 5] = 0
    path = edit(write(tmp_path / "dem.tif", heights, nodata=-1), lambda dataset: dataset.write_mask(mask))
    assert np.argwhere(~open_dem(path).valid).tolist() == [[1, 1], [5, 5]]


def test_alpha_band(tmp_path):
    alpha = np.full((ROWS, COLS), 65535)
    alpha[5:8, 5:8] = 0
    path = write(tmp_path / "dem.tif", np.stack([HEIGHTS, alpha]).astype(np.uint16), ALPHA="YES")
    np.testing.assert_array_equal(open_dem(path).valid, alpha > 0)


def test_undeclared_minus_32768_is_a_height(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, 0] = -32768
    dem = open_dem(write(tmp_path / "dem.tif", heights))
    assert (dem.n_valid, dem.z[0, 0]) == (ROWS * COLS, -32768)
