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
from rasterio.errors import NotGeoreferencedWarning
from rasterio.io import MemoryFile
from rasterio.vrt import WarpedVRT

from tin.dem import DEM
from tin.errors import InputError
from tin.reader import open as open_dem

SAMPLES = Path(__file__).parents[1] / "sample_dem"
DATA = Path(__file__).parents[2] / "shared" / "data"
UTM = Affine(30, 0, 557805, 0, -30, 5122005)  # pixel centres on multiples of 30, as USGS DEM wants
ROWS, COLS = 40, 50
HEIGHTS = (1000 + 10 * np.arange(ROWS)[:, None] + np.arange(COLS)).astype(np.int16)
HEIGHTS.flags.writeable = False


def write(path, heights=HEIGHTS, *, driver="GTiff", transform=UTM, crs="EPSG:26710", **profile):
    """Write a raster with rasterio and return its path; `heights` may have several bands."""
    bands = np.atleast_3d(heights.T).T if heights.ndim == 2 else heights
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        profile = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], **profile}
        with rasterio.open(
            path, "w", driver=driver, dtype=bands.dtype, transform=transform, crs=crs, **profile
        ) as dataset:
            dataset.write(bands)
    return path


def convert(source, path, driver, **options):
    rasterio.shutil.copy(source, path, driver=driver, **options)
    return path


def edit(path, function):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "r+") as dataset:
            function(dataset)
    return path


def code_of(path, **options):
    with pytest.raises(InputError) as caught:
        open_dem(path, **options)
    assert "\n" not in str(caught.value)
    return caught.value.code


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


# Plain height images


def test_png_16_bit(tmp_path):
    path = write(tmp_path / "dem.png", HEIGHTS.astype(np.uint16), driver="PNG", transform=None, crs=None)
    dem = open_dem(path)
    np.testing.assert_array_equal(dem.z, HEIGHTS)
    assert (dem.transform, dem.crs) == ((1, 0, 0, 0, -1, ROWS), None)


def test_float_tiff_without_georeference(tmp_path):
    dem = open_dem(write(tmp_path / "dem.tif", HEIGHTS / np.float32(3), transform=None, crs=None))
    np.testing.assert_array_equal(dem.z, HEIGHTS / np.float32(3))
    assert (dem.transform, dem.crs) == ((1, 0, 0, 0, -1, ROWS), None)


def test_crs_without_transform_is_not_believed(tmp_path):
    assert open_dem(write(tmp_path / "dem.tif", transform=None)).crs is None


def write_image(path, pixels, kind, names=("Y",)):
    oiio = importlib.import_module("OpenImageIO")
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec.channelnames = names
    if "A" in names:
        spec.alpha_channel = names.index("A")
    image = oiio.ImageOutput.create(str(path))
    assert image.open(str(path), spec), image.geterror()
    image.write_image(pixels)
    image.close()
    return path


@pytest.mark.parametrize("kind", ["float", "half"])
def test_exr(tmp_path, kind):
    heights = (HEIGHTS.astype(np.float32) / 4)[..., None]
    heights[0, :2, 0] = np.nan, np.inf
    dem = open_dem(write_image(tmp_path / "dem.exr", heights, kind))
    expected = heights.astype(np.float16 if kind == "half" else np.float32)[..., 0].astype(np.float32)
    expected[0, :2] = np.nan
    np.testing.assert_array_equal(dem.z, expected)
    assert (dem.transform, dem.crs, dem.z.dtype) == ((1, 0, 0, 0, -1, ROWS), None, np.float32)


def test_exr_of_whole_numbers_is_not_rescaled(tmp_path):
    dem = open_dem(write_image(tmp_path / "dem.exr", HEIGHTS.astype(np.uint32)[..., None], "uint"))
    np.testing.assert_array_equal(dem.z, HEIGHTS)
    assert dem.z.dtype == np.float64


def test_exr_alpha_marks_voids_and_bands_are_channels(tmp_path):
    pixels = np.ones((ROWS, COLS, 4), np.float32)
    pixels[..., 1] = HEIGHTS
    pixels[3, 4, 3] = 0
    path = write_image(tmp_path / "dem.exr", pixels, "float", ("R", "G", "B", "A"))
    dem = open_dem(path, band=2)
    assert dem.n_valid == ROWS * COLS - 1
    assert np.isnan(dem.z[3, 4])
    assert dem.z[0, 7] == HEIGHTS[0, 7]
    assert code_of(path, band=5) == "band-range"


def test_pfm(tmp_path):
    heights = HEIGHTS.astype("<f4")
    (tmp_path / "dem.pfm").write_bytes(f"Pf\n{COLS} {ROWS}\n-1.0\n".encode() + heights[::-1].tobytes())
    np.testing.assert_array_equal(open_dem(tmp_path / "dem.pfm").z, heights)


def plain_pgm(heights, maximum):
    rows = "\n".join(" ".join(map(str, row)) for row in heights)
    return (
        f"P2 # a comment\n# width height\n{heights.shape[1]} {heights.shape[0]}\n{maximum}\n{rows}\n".encode()
    )


@pytest.mark.parametrize("maximum", [1449, 1999, 40000, 65535, 100000])
def test_plain_pgm_is_not_rescaled(tmp_path, maximum):
    heights = HEIGHTS.astype(int)
    heights[-1, -1] = maximum
    (tmp_path / "dem.pgm").write_bytes(plain_pgm(heights, maximum))
    dem = open_dem(tmp_path / "dem.pgm")
    np.testing.assert_array_equal(dem.z, heights)
    assert (dem.transform, dem.crs, dem.name) == ((1, 0, 0, 0, -1, ROWS), None, "dem")


def test_binary_pgm_is_not_rescaled(tmp_path):
    (tmp_path / "dem.pgm").write_bytes(f"P5 {COLS} {ROWS} 2478\n".encode() + HEIGHTS.astype(">u2").tobytes())
    dem = open_dem(tmp_path / "dem.pgm")
    np.testing.assert_array_equal(dem.z, HEIGHTS)
    assert (dem.transform, dem.crs) == ((1, 0, 0, 0, -1, ROWS), None)


def test_world_file_places_a_plain_image(tmp_path):
    write(tmp_path / "dem.png", HEIGHTS.astype(np.uint16), driver="PNG", transform=None, crs=None)
    (tmp_path / "dem.pgw").write_text("30\n0\n0\n-30\n557820\n5121990\n")
    assert open_dem(tmp_path / "dem.png").transform == tuple(UTM)[:6]


# NoData


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
