import importlib

import numpy as np
import pytest
from rasters import COLS, HEIGHTS, ROWS, UTM, code_of, write

from tin.reader import open as open_dem


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
