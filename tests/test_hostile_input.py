"""Input that is missing or broken: a stable code and one line of message."""

import gzip
import importlib
import os
import sys
import warnings

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from hostile import HEIGHTS, UTM, refused, vrt, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tin.dem import DEM
from tin.errors import InputError, TinError
from tin.reader import open as open_dem

# Missing, and not a raster


def test_missing_file(tmp_path):
    refused(tmp_path / "no.tif", "not-found", says="no.tif")
    refused("no such folder/no.dem.gz", "not-found")
    refused("", "not-found", "not-a-raster")


def test_missing_file_behind_a_gdal_name(tmp_path):
    refused(f"netcdf:{tmp_path}/no.nc:z", "unreadable", "not-a-raster")
    refused(f"/vsizip/{tmp_path}/no.zip/dem.tif", "unreadable", "not-a-raster")


def test_impossible_names(tmp_path):
    refused("a\0b.tif", "not-found", "unreadable")
    refused(tmp_path / ("x" * 300), "not-found", "unreadable")


def test_folder(tmp_path):
    refused(tmp_path, "not-a-raster")


def test_empty_file(tmp_path):
    (tmp_path / "dem.tif").touch()
    refused(tmp_path / "dem.tif", "not-a-raster")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFOs here")
def test_fifo_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "dem.tif")
    refused(tmp_path / "dem.tif", "not-a-raster")


def test_vector_file(tmp_path):
    geojson = tmp_path / "points.geojson"
    geojson.write_text(
        '{"type":"FeatureCollection","features":[{"type":"Feature","properties":{},'
        '"geometry":{"type":"Point","coordinates":[1,2]}}]}'
    )
    refused(geojson, "is-vector")


def test_vector_geopackage(tmp_path):
    import fiona

    schema = {"geometry": "Point", "properties": {}}
    with fiona.open(tmp_path / "points.gpkg", "w", driver="GPKG", schema=schema) as layer:
        layer.write({"geometry": {"type": "Point", "coordinates": (1, 2)}, "properties": {}})
    refused(tmp_path / "points.gpkg", "is-vector")


@pytest.mark.parametrize("suffix", ["txt", "tif", "dem", "asc", "png", "exr", "hgt", "nc", "vrt"])
def test_text_garbage(tmp_path, suffix):
    path = tmp_path / f"garbage.{suffix}"
    path.write_text("the quick brown fox\njumps over 13 lazy dogs\n" * 50)
    refused(path, "not-a-raster", "unreadable", says=f"garbage.{suffix}")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(
        [b"", b"P2 ", b"P5\n4 4\n", b"Pf\n2 2\n-1\n", b"II*\0", b"\x89PNG\r\n\x1a\n", b"v/1\x01"]
    ),
    st.binary(max_size=300),
)
def test_random_bytes_give_an_error_of_ours_or_a_dem(tmp_path, magic, rest):
    path = tmp_path / "random.bin"
    path.write_bytes(magic + rest)
    try:
        open_dem(path, max_pixels=10**6)
    except TinError as error:
        assert error.code
        assert "\n" not in str(error)


# Damaged


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6, 0.95, 0.999])
@pytest.mark.parametrize("options", [{}, {"compress": "deflate"}], ids=["plain", "deflate"])
def test_truncated_geotiff(tmp_path, share, options):
    heights = np.random.default_rng(0).normal(size=(200, 100)).astype(np.float32)
    path = write(tmp_path / "dem.tif", heights, **options)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    refused(path, "unreadable", says="dem.tif")


@pytest.mark.parametrize("share", [0.3, 0.6, 0.98])
def test_truncated_usgs_dem_plain_and_gzipped(tmp_path, share):
    path = tmp_path / "usgs.dem"
    rasterio.shutil.copy(write(tmp_path / "dem.tif", HEIGHTS.astype(np.int16)), path, driver="USGSDEM")
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    refused(path, "unreadable")
    packed = tmp_path / "usgs.dem.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    refused(packed, "unreadable")
    packed.write_bytes(gzip.compress(data)[: int(len(gzip.compress(data)) * share)])
    refused(packed, "unreadable", "not-a-raster")


def test_truncated_arc_ascii_grid(tmp_path):
    path = tmp_path / "dem.asc"
    rasterio.shutil.copy(write(tmp_path / "dem.tif"), path, driver="AAIGrid")
    path.write_bytes(path.read_bytes()[:-2000])
    refused(path, "unreadable")


@pytest.mark.parametrize(
    "text",
    [
        b"P2\n4 3\n1000\n1 2 3 4 5",
        b"P2\n4 3\n1000\n1 2 3 4 5 six 7 8 9 10 11 12",
        b"P2\n4 3\n1000\n1 2 3 4 5 2000 7 8 9 10 11 12",
        b"P2\n4 3\n1000\n1 2 3 4 5 -6 7 8 9 10 11 12",
        b"P2\n4 3\n1000\n1 2 3 4 5 1" + 60 * b"0" + b" 7 8 9 10 11 12",
        b"P2\n4 3\n1000\n1 2 3 4 5 1" + 400 * b"0" + b" 7 8 9 10 11 12",
        b"P2\n4 three\n1000\n",
        b"P2\n4 3",
        b"P2\n4 3\n1e3\n1 2 3 4 5 6 7 8 9 10 11 12",
        b"P2\n-4 3\n1000\n1 2 3 4 5 6 7 8 9 10 11 12",
    ],
)
def test_broken_plain_pgm(tmp_path, text):
    (tmp_path / "dem.pgm").write_bytes(text)
    refused(tmp_path / "dem.pgm", "unreadable")


def test_truncated_binary_pgm(tmp_path):
    (tmp_path / "dem.pgm").write_bytes(b"P5 100 100 2478\n" + bytes(12000))
    refused(tmp_path / "dem.pgm", "unreadable")


def test_truncated_exr_and_png(tmp_path):
    oiio = importlib.import_module("OpenImageIO")
    pixels = np.random.default_rng(0).normal(size=(64, 64, 1)).astype(np.float32)
    for name, kind in (("dem.exr", "float"), ("dem.png", "uint16")):
        image = oiio.ImageOutput.create(str(tmp_path / name))
        image.open(str(tmp_path / name), oiio.ImageSpec(64, 64, 1, kind))
        image.write_image(pixels)
        image.close()
        data = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(data[: len(data) // 2])
        refused(tmp_path / name, "unreadable", "not-a-raster")


# No heights, wrong heights


def test_all_nodata(tmp_path):
    refused(write(tmp_path / "dem.tif", np.full_like(HEIGHTS, -9999), nodata=-9999), "all-nodata")
    refused(write(tmp_path / "nan.tif", np.full_like(HEIGHTS, np.nan)), "all-nodata")


@pytest.mark.parametrize("dtype", ["complex64", "complex128", "complex_int16"])
def test_complex_data(tmp_path, dtype):
    path = tmp_path / "dem.tif"
    shape = {"height": 40, "width": 50, "count": 1, "transform": UTM, "crs": "EPSG:26710"}
    with rasterio.open(path, "w", driver="GTiff", dtype=dtype, **shape) as dataset:
        dataset.write(HEIGHTS.astype(np.complex64), 1)
    refused(path, "complex-data")


@pytest.mark.parametrize("band", [0, -1, 2, 1.5, None, "1"])
def test_band_out_of_range(tmp_path, band):
    refused(write(tmp_path / "dem.tif"), "band-range", band=band)
    (tmp_path / "dem.pgm").write_bytes(b"P2 2 2 9 1 2 3 4")
    refused(tmp_path / "dem.pgm", "band-range", band=band)


@pytest.mark.parametrize("nodata", ["-1.7976931348623157e308", "-3.4028234663852886e+38", "-3.4e+38", "nan"])
def test_nodata_that_float32_cannot_hold(tmp_path, nodata):
    heights = HEIGHTS.copy()
    heights[0, :3] = -np.inf, np.nan, np.float32(-3.4028234663852886e38)
    write(tmp_path / "dem.tif", heights)
    path = vrt(tmp_path / "dem.vrt", nodata=f"<NoDataValue>{nodata}</NoDataValue>")
    dem = open_dem(path)
    assert np.argwhere(~dem.valid).tolist() == [[0, 0], [0, 1], [0, 2]]
    with np.errstate(over="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        dataset = rasterio.open(path)
    with dataset:
        assert DEM.from_rasterio(dataset).z.tobytes() == dem.z.tobytes()


def test_nodata_beyond_float32_declared_in_a_geotiff(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, 0] = np.finfo(np.float32).min
    path = write(tmp_path / "dem.tif", heights, nodata=float(np.finfo(np.float32).min))
    assert open_dem(path).n_valid == heights.size - 1


def test_float64_nodata_at_the_very_end(tmp_path):
    heights = HEIGHTS.astype(np.float64)
    heights[0, 0] = -np.finfo(np.float64).max
    assert open_dem(write(tmp_path / "dem.tif", heights, nodata=heights[0, 0])).n_valid == heights.size - 1
    refused(write(tmp_path / "undeclared.tif", heights), "height-range")


@pytest.mark.parametrize("height", [1e308, -1e308, 1e39])
def test_heights_that_are_no_terrain(tmp_path, height):
    heights = HEIGHTS.astype(np.float64)
    heights[0, 0] = height
    refused(write(tmp_path / "dem.tif", heights), "height-range", says="NoData")


def test_denormals_and_negative_zero(tmp_path):
    heights = HEIGHTS.astype(np.float64)
    heights[0, :3] = 5e-324, -0.0, -5e-324
    dem = open_dem(write(tmp_path / "dem.tif", heights))
    assert dem.z.tobytes() == heights.tobytes()


def test_random_bits_in_void_pixels(tmp_path):
    rng = np.random.default_rng(0)
    mask = np.where(HEIGHTS % 7 == 0, 0, 255).astype(np.uint8)
    results = []
    for name in "ab":
        heights = HEIGHTS.copy()
        bits = heights.view(np.uint32)
        bits[mask == 0] = rng.integers(0, 2**32, (mask == 0).sum(), dtype=np.uint32)
        path = write(tmp_path / f"{name}.tif", heights)
        with rasterio.open(path, "r+") as dataset:
            dataset.write_mask(mask)
        results.append(open_dem(path).z.tobytes())
    assert results[0] == results[1]


def test_one_row_and_one_pixel_are_read(tmp_path):
    # Whether they make a surface is for the mesh to say.
    assert open_dem(write(tmp_path / "row.tif", HEIGHTS[:1])).shape == (1, 50)
    assert open_dem(write(tmp_path / "pixel.tif", HEIGHTS[:1, :1])).shape == (1, 1)


@pytest.mark.parametrize("numbers", ["5,1,2,5,2,4", "5,nan,0,5,0,4", "5,0,0,5,0,0", "inf,1,0,5,0,1"])
def test_singular_and_broken_transforms(tmp_path, numbers):
    write(tmp_path / "dem.tif")
    path = vrt(tmp_path / "dem.vrt", extra=f"<GeoTransform>{numbers}</GeoTransform>")
    refused(path, "bad-transform")


def test_zero_size(tmp_path):
    refused(vrt(tmp_path / "dem.vrt", size=(0, 40)), "unreadable", "empty")
    (tmp_path / "dem.pgm").write_bytes(b"P2\n0 0\n255\n")
    refused(tmp_path / "dem.pgm", "empty")
    with pytest.raises(InputError) as caught:
        DEM(np.empty((0, 0)))
    assert caught.value.code == "empty"


# Libraries that are not there


@pytest.mark.parametrize(("library", "magic"), [("rasterio", b""), ("OpenImageIO", b"nothing GDAL knows")])
def test_missing_library(tmp_path, monkeypatch, library, magic):
    (tmp_path / "dem.tif").write_bytes(magic)
    monkeypatch.setitem(sys.modules, library, None)
    refused(tmp_path / "dem.tif", "missing-library", says=f"pip install {library}")


def test_a_unit_that_is_no_text_is_none(tmp_path):
    path = tmp_path / "dem.tif"
    size = {
        "height": 3,
        "width": 3,
        "count": 1,
        "dtype": "float32",
        "transform": rasterio.Affine(2, 0, 0, 0, -2, 0),
    }
    with rasterio.open(path, "w", driver="GTiff", **size) as file:
        file.write(np.ones((3, 3), np.float32), 1)
        file.units = ["metre"]
    path.write_bytes(path.read_bytes().replace(b"metre", b"m\xfftre"))
    assert open_dem(path).vertical_unit == ""
