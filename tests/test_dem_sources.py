"""DEMs from what other libraries hold."""

import importlib
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tin.dem import DEM
from tin.errors import InputError
from tin.reader import open as open_dem

GRID = np.arange(12.0).reshape(3, 4)
GRID.flags.writeable = False


# xarray

# rioxarray itself multiplies transforms in a way that affine 3 wants to give up.
ITS_OWN_WARNING = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")


@pytest.fixture
def array():
    xarray = importlib.import_module("xarray")
    importlib.import_module("rioxarray")
    coords = {"y": 5000 - 10.0 * np.arange(3), "x": 2000 + 10.0 * np.arange(4)}
    made = xarray.DataArray(GRID.astype(np.int16), dims=("y", "x"), coords=coords, name="relief")
    return made.rio.write_crs("EPSG:26710").rio.write_nodata(5)


@ITS_OWN_WARNING
def test_from_xarray(array):
    array.attrs["units"] = "ft"
    dem = DEM.from_xarray(array)
    np.testing.assert_array_equal(dem.z, np.where(GRID == 5, np.nan, GRID))
    assert (dem.transform, dem.crs.code) == ((10, 0, 1995, 0, -10, 5005), "EPSG:26710")
    assert (dem.vertical_unit, dem.nodata, dem.name, dem.z.dtype) == ("foot", 5, "relief", np.float32)


@ITS_OWN_WARNING
def test_from_xarray_does_not_share_memory(array):
    floats = array.astype(np.float32)
    dem = DEM.from_xarray(floats)
    floats[:] = 0
    assert np.nanmax(dem.z) == 11


@ITS_OWN_WARNING
def test_from_xarray_turned_sliced_south_up_and_with_a_band(array):
    sliced = DEM.from_xarray(array[1:, 1:])
    assert sliced.transform == (10, 0, 2005, 0, -10, 4995)
    turned = DEM.from_xarray(array.transpose("x", "y").expand_dims("band"))
    np.testing.assert_array_equal(turned.z, DEM.from_xarray(array).z)
    south_up = DEM.from_xarray(array[::-1])
    assert south_up.transform == (10, 0, 1995, 0, 10, 4975)


@ITS_OWN_WARNING
def test_from_xarray_applies_scale_and_offset(array):
    array.attrs.update(scale_factor=0.1, add_offset=100.0)
    np.testing.assert_allclose(DEM.from_xarray(array).z[0], [100, 100.1, 100.2, 100.3], rtol=1e-15)


def test_from_xarray_without_georeference_gets_unit_pixels(array):
    plain = type(array)(GRID, dims=("y", "x"))
    dem = DEM.from_xarray(plain)
    assert (dem.transform, dem.crs) == ((1, 0, 0, 0, -1, 3), None)


def test_from_xarray_refuses_what_has_no_plane(array):
    with pytest.raises(InputError) as caught:
        DEM.from_xarray(type(array)(GRID, dims=("p", "q")))
    assert caught.value.code == "no-spatial-dims"
    with pytest.raises(InputError) as caught:
        DEM.from_xarray(type(array)(np.zeros((2, 3, 4)), dims=("band", "y", "x")))
    assert caught.value.code == "not-2d"


# osgeo.gdal

GDAL_SCRIPT = """
import sys, json
sys.modules["osgeo.gdal_array"] = None  # broken where a newer numpy comes first
from osgeo import gdal
from tin.dem import DEM
d = DEM.from_gdal(gdal.Open(sys.argv[1]))
print(json.dumps([d.shape, d.n_valid, float(d.z[d.valid].astype("f8").sum()), d.transform, d.crs.code,
                  d.vertical_unit, d.nodata, d.name, "rasterio" in sys.modules]))
"""


@pytest.mark.parametrize("name", ["jacksboro.dem", "jacksboro.tif", "crater_lake_voids.tif"])
def test_from_gdal_equals_rasterio(name):
    system = "/usr/bin/python3"
    has_gdal = shutil.which(system) and not subprocess.call(
        [system, "-c", "from osgeo import gdal; import numpy"], stderr=subprocess.DEVNULL
    )
    if not has_gdal:
        pytest.skip("no system Python with osgeo.gdal")
    root = Path(__file__).parents[1]
    path = root / "sample_dem" / name
    told = json.loads(subprocess.check_output([system, "-c", GDAL_SCRIPT, path], text=True, cwd=root))
    dem = open_dem(path)
    total = float(dem.z[dem.valid].astype(np.float64).sum())
    facts = [list(dem.shape), dem.n_valid, total, list(dem.transform), dem.crs.code]
    assert told == [*facts, dem.vertical_unit, dem.nodata, dem.name, False]
