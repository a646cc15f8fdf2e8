import gzip
import importlib
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.io import MemoryFile
from rasterio.vrt import WarpedVRT
from rasters import COLS, HEIGHTS, ROWS, UTM, code_of, edit, write

from tin.dem import DEM
from tin.errors import InputError
from tin.reader import open as open_dem

SAMPLES = Path(__file__).parents[1] / "sample_dem"
DATA = Path(__file__).parents[2] / "shared" / "data"


def convert(source, path, driver, **options):
    rasterio.shutil.copy(source, path, driver=driver, **options)
    return path


def assert_is_the_grid(dem, *, crs="EPSG:26710"):
    np.testing.assert_array_equal(dem.z, HEIGHTS)
    assert dem.transform == tuple(UTM)[:6]
    assert dem.crs.code == crs


# Formats


@pytest.mark.parametrize("driver", ["GTiff", "COG", "HFA", "AAIGrid", "VRT", "ENVI", "EHdr"])
def test_georeferenced_formats_give_the_same_dem(tmp_path, driver):
    suffix = {"GTiff": "tif", "COG": "tif", "HFA": "img", "AAIGrid": "asc", "VRT": "vrt"}.get(driver, "bil")
    path = convert(write(tmp_path / "source.tif"), tmp_path / f"dem.{suffix}", driver)
    dem = open_dem(path)
    assert_is_the_grid(dem)
    assert (dem.name, dem.n_valid) == ("dem", ROWS * COLS)


@pytest.fixture
def usgs(tmp_path):
    source = write(tmp_path / "source.tif", nodata=-32767)
    return convert(source, tmp_path / "usgs.dem", "USGSDEM")


def test_usgs_ascii_dem(usgs):
    dem = open_dem(usgs)
    assert_is_the_grid(dem)
    assert (dem.vertical_unit, dem.nodata) == ("metre", -32767)


@pytest.mark.parametrize("name", ["usgs.dem.gz", "USGS.DEM.GZ"])
def test_gzipped_usgs_dem_and_nothing_written_beside_it(usgs, tmp_path, name):
    folder = tmp_path / "packed data"
    folder.mkdir()
    packed = folder / name
    packed.write_bytes(gzip.compress(usgs.read_bytes()))
    dem = open_dem(packed)
    assert_is_the_grid(dem)
    assert dem.name.lower() == "usgs"
    assert list(folder.iterdir()) == [packed]


def test_srtm_hgt_is_pixel_is_point(tmp_path):
    heights = np.arange(1201 * 1201, dtype=np.int32).reshape(1201, 1201) % 3000
    heights[0, 0] = -32768
    (tmp_path / "N46W123.hgt").write_bytes(heights.astype(">i2").tobytes())
    dem = open_dem(tmp_path / "N46W123.hgt")
    assert dem.n_valid == 1201 * 1201 - 1
    assert dem.z[-1, -1] == heights[-1, -1]
    np.testing.assert_allclose(dem.pixel_to_map([0, 1200], [1200, 0]), [[-123, -122], [46, 47]], atol=1e-12)
    assert (dem.crs.code, dem.vertical_unit) == ("EPSG:4326", "metre")


def test_pixel_is_point_geotiff_is_shifted_once(tmp_path):
    path = write(tmp_path / "point.tif", GTIFF_POINT_GEO_IGNORE="NO")
    edit(path, lambda dataset: dataset.update_tags(AREA_OR_POINT="Point"))
    assert open_dem(path).pixel_to_map(0, 0) == (557820, 5121990)


def test_netcdf_with_scale_offset_units_and_crs(tmp_path):
    xarray = importlib.import_module("xarray")
    importlib.import_module("rioxarray")
    packing = {"scale_factor": 0.5, "add_offset": 100.0, "units": "feet", "_FillValue": np.int16(1003)}
    coords = {"y": 5121990 - 30.0 * np.arange(ROWS), "x": 557820 + 30.0 * np.arange(COLS)}
    array = xarray.DataArray(HEIGHTS, dims=("y", "x"), coords=coords, attrs=packing, name="relief")
    array.rio.write_crs("EPSG:26710").rio.write_coordinate_system().to_dataset().to_netcdf(
        tmp_path / "one.nc"
    )
    dem = open_dem(tmp_path / "one.nc")
    np.testing.assert_allclose(dem.z, np.where(HEIGHTS == 1003, np.nan, HEIGHTS * 0.5 + 100))
    assert (dem.vertical_unit, dem.crs.code, dem.transform) == ("foot", "EPSG:26710", tuple(UTM)[:6])


def test_netcdf_with_several_variables_lists_them(tmp_path):
    xarray = importlib.import_module("xarray")
    plane = ("y", "x"), HEIGHTS
    xarray.Dataset({"relief": plane, "slope": plane}).to_netcdf(tmp_path / "two.nc")
    with pytest.raises(InputError, match="relief") as caught:
        open_dem(tmp_path / "two.nc")
    assert caught.value.code == "subdatasets"
    assert open_dem(f"netcdf:{tmp_path / 'two.nc'}:slope").shape == (ROWS, COLS)


def test_geopackage_raster(tmp_path):
    path = convert(write(tmp_path / "source.tif"), tmp_path / "dem.gpkg", "GPKG")
    np.testing.assert_array_equal(open_dem(path).z, HEIGHTS)


def test_band_choice(tmp_path):
    path = write(tmp_path / "two.tif", np.stack([HEIGHTS, HEIGHTS + 1]))
    np.testing.assert_array_equal(open_dem(path, band=2).z, HEIGHTS + 1)


def test_str_and_path_and_odd_names(tmp_path):
    path = write(tmp_path / "höhe über:NN #1 %.tif")
    assert_is_the_grid(open_dem(str(path)))
    assert open_dem(path).name == "höhe über:NN #1 %"


@pytest.mark.parametrize(
    ("dtype", "working"),
    [
        ("uint8", "float32"),
        ("int8", "float32"),
        ("uint16", "float32"),
        ("int16", "float32"),
        ("float32", "float32"),
        ("int32", "float64"),
        ("uint32", "float64"),
        ("int64", "float64"),
        ("uint64", "float64"),
        ("float64", "float64"),
    ],
)
def test_dtypes(tmp_path, dtype, working):
    heights = (HEIGHTS % 100).astype(dtype)
    if dtype in ("int32", "float64"):
        heights[0, 0] = 2**24 + 1
    dem = open_dem(write(tmp_path / "dem.tif", heights))
    assert dem.z.dtype == working
    np.testing.assert_array_equal(dem.z, heights)


# Units, scale, georeference


def test_scale_and_offset(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, 0] = -1

    def describe(dataset):
        dataset.scales, dataset.offsets = (0.01,), (500000.0,)

    dem = open_dem(edit(write(tmp_path / "dem.tif", heights, nodata=-1), describe))
    assert dem.z.dtype == np.float64
    np.testing.assert_allclose(dem.z[1:], HEIGHTS[1:] * 0.01 + 500000, rtol=1e-15)
    assert np.isnan(dem.z[0, 0])
    assert dem.nodata == -1


@pytest.mark.parametrize(
    ("unit", "name"), [("m", "metre"), ("ft", "foot"), ("US survey foot", "US survey foot"), ("", "")]
)
def test_vertical_unit_of_the_band(tmp_path, unit, name):
    path = edit(write(tmp_path / "dem.tif"), lambda dataset: dataset.set_band_unit(1, unit))
    assert open_dem(path).vertical_unit == name


@pytest.mark.parametrize(
    ("crs", "unit"),
    [("EPSG:26910+5703", "metre"), ("EPSG:2227+6360", "US survey foot"), ("EPSG:4326+5773", "metre")],
)
def test_compound_crs_is_kept_with_its_vertical_unit(tmp_path, crs, unit):
    dem = open_dem(write(tmp_path / "dem.tif", crs=crs))
    assert (dem.vertical_unit, dem.crs.vertical_unit) == (unit, unit)
    assert "VERTCRS" in dem.crs.wkt


def test_z_factor_turns_feet_into_metres(tmp_path):
    path = edit(write(tmp_path / "dem.tif"), lambda dataset: dataset.set_band_unit(1, "ft"))
    dem = open_dem(path, z_factor=0.3048)
    np.testing.assert_allclose(dem.z, HEIGHTS * 0.3048, rtol=1e-7)
    assert dem.vertical_unit == "metre"


@pytest.mark.parametrize(
    "transform",
    [
        Affine(30, 0, 557805, 0, 30, 5122005),
        Affine(24, 18, 557805, 18, -24, 5122005),
        Affine(30, 5, 557805, -4, -30, 5122005),
        Affine(1000, 0, 557805, 0, -1, 5122005),
    ],
    ids=["south-up", "rotated", "sheared", "1000:1"],
)
def test_transform_is_kept_whole(tmp_path, transform):
    dem = open_dem(write(tmp_path / "dem.tif", transform=transform))
    assert dem.transform == tuple(transform)[:6]
    np.testing.assert_array_equal(dem.z, HEIGHTS)


def test_geographic_across_the_antimeridian(tmp_path):
    dem = open_dem(
        write(tmp_path / "dem.tif", transform=Affine(0.01, 0, 179.9, 0, -0.01, 60), crs="EPSG:4326")
    )
    assert dem.crs.is_geographic
    assert dem.pixel_to_map(COLS - 1, 0)[0] == pytest.approx(180.395)


def with_gcps(path, place):
    corners = [(0, 0), (0, COLS), (ROWS, 0), (ROWS, COLS)]
    points = [GroundControlPoint(row, col, *place(col, row)) for row, col in corners]
    write(path, transform=None, crs=None)
    return edit(path, lambda dataset: setattr(dataset, "gcps", (points, rasterio.CRS.from_epsg(26710))))


def test_control_points_that_fit_an_affine_give_the_transform(tmp_path):
    def place(col, row):
        return 30 * col + 5 * row + 557805, -4 * col - 30 * row + 5122005

    dem = open_dem(with_gcps(tmp_path / "dem.tif", place))
    np.testing.assert_allclose(dem.transform, (30, 5, 557805, -4, -30, 5122005), rtol=1e-9)
    assert dem.crs.code == "EPSG:26710"


@pytest.mark.parametrize(
    "place",
    [lambda col, row: (30 * col + col * row, -30 * row), lambda col, row: (float(col), float(col))],
    ids=["bilinear", "line"],
)
def test_control_points_that_do_not_fit_are_refused(tmp_path, place):
    assert code_of(with_gcps(tmp_path / "dem.tif", place)) in ("gcp-only", "bad-transform")


# What else can be handed over, and how it behaves


def test_from_rasterio_takes_open_datasets(tmp_path):
    with rasterio.open(write(tmp_path / "dem.tif")) as dataset:
        assert_is_the_grid(DEM.from_rasterio(dataset))
        with WarpedVRT(dataset, crs="EPSG:4326", nodata=-1, add_alpha=False) as warped:
            dem = DEM.from_rasterio(warped)
            assert dem.crs.code == "EPSG:4326"
            assert 0 < dem.n_valid < dem.rows * dem.cols
    with MemoryFile((tmp_path / "dem.tif").read_bytes()) as memory, memory.open() as dataset:
        assert DEM.from_rasterio(dataset).name == ""


def test_no_warning_and_no_filter_left_behind(tmp_path):
    path = write(tmp_path / "dem.tif", transform=None, crs=None)
    before = list(warnings.filters)
    results = []
    threads = [threading.Thread(target=lambda: results.append(open_dem(path).n_valid)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [ROWS * COLS] * 8
    assert warnings.filters == before


def test_nothing_is_written_beside_the_input(tmp_path):
    path = write(tmp_path / "dem.tif", nodata=-1)
    before = path.stat().st_mtime_ns
    open_dem(path)
    assert list(tmp_path.iterdir()) == [path]
    assert path.stat().st_mtime_ns == before


# Real data


@pytest.mark.parametrize(
    ("name", "shape", "voids", "heights", "crs"),
    [
        ("jacksboro.tif", (344, 403), 0, (236, 1076), "EPSG:4326"),
        ("jacksboro.dem", (364, 320), 5331, (241, 1071), "EPSG:32616"),
        ("crater_lake_voids.tif", (150, 200), 9319, (1925.1, 2569), "EPSG:32610"),
    ],
)
def test_sample_dems(name, shape, voids, heights, crs):
    dem = open_dem(SAMPLES / name)
    assert (dem.shape, dem.rows * dem.cols - dem.n_valid) == (shape, voids)
    assert (np.nanmin(dem.z), np.nanmax(dem.z)) == pytest.approx(heights)
    assert (dem.crs.code, dem.vertical_unit, dem.z.dtype) == (crs, "metre", np.float32)


def test_usgs_sample_lies_where_the_geotiff_does():
    from rasterio.warp import transform as warp

    tif, usgs = open_dem(SAMPLES / "jacksboro.tif"), open_dem(SAMPLES / "jacksboro.dem")
    row, col = np.nonzero(usgs.valid)
    x, y = warp("EPSG:32616", "EPSG:4326", *usgs.pixel_to_map(col, row))
    at = np.rint(tif.map_to_pixel(x, y)).astype(int)
    inside = (at >= 0).all(axis=0) & (at[0] < tif.cols) & (at[1] < tif.rows)
    misfit = usgs.z[row, col][inside] - tif.z[at[1], at[0]][inside]
    assert abs(np.median(misfit)) <= 1
    assert np.sqrt(np.mean(misfit**2)) < 8


@pytest.mark.skipif(not DATA.exists(), reason="the data of the house is not here")
def test_st_helens_and_crater_lake():
    helens = open_dem(DATA / "SainteHelens.dem")
    assert (helens.shape, helens.rows * helens.cols - helens.n_valid) == ((468, 327), 4151)
    assert helens.crs.code == "EPSG:26710"
    crater = open_dem(DATA / "crater.pgm")
    assert (crater.shape, crater.z.min(), crater.z.max()) == ((459, 336), 1533, 2478)
    numbers = (DATA / "crater.pgm").read_text().split()[4:]
    np.testing.assert_array_equal(crater.z.ravel(), np.array(numbers, int))
