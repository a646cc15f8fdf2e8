import copy
import math
import pickle
import subprocess
import sys

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st

from tin.crs import CRS
from tin.dem import DEM
from tin.errors import InputError, OptionError

GRID = np.arange(12.0).reshape(3, 4)
GRID.flags.writeable = False
UTM = CRS.parse("EPSG:26710")
FEET = CRS.parse("EPSG:2227")
DEGREES = CRS.parse("EPSG:4326")


def refused(code, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        DEM(*args, **kwargs)
    assert caught.value.code == code
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16", "float16", "float32", ">i2", ">f4"])
def test_small_dtypes_become_float32(dtype):
    dem = DEM(GRID.astype(dtype))
    assert dem.z.dtype == np.float32
    np.testing.assert_array_equal(dem.z, GRID)


@pytest.mark.parametrize("dtype", ["int32", "uint32", "int64", "uint64", "float64", "longdouble"])
def test_large_dtypes_become_float64(dtype):
    dem = DEM(GRID.astype(dtype))
    assert dem.z.dtype == np.float64
    np.testing.assert_array_equal(dem.z, GRID)


def test_lists_are_taken():
    assert DEM([[1, 2], [3, 4]]).shape == (2, 2)


def test_heights_are_copied_contiguous_and_read_only():
    z = np.asfortranarray(GRID)
    dem = DEM(z)
    z[:] = 0
    np.testing.assert_array_equal(dem.z, GRID)
    assert dem.z.flags.c_contiguous
    assert not dem.z.flags.writeable
    assert not dem.valid.flags.writeable
    with pytest.raises(AttributeError):
        dem.name = "other"


def test_nan_infinity_mask_and_valid_are_voids():
    z = np.ma.array(GRID.copy(), mask=False)
    z[0, 0] = np.ma.masked
    z.data[0, 1:] = np.nan, np.inf, -np.inf
    valid = np.ones(GRID.shape, bool)
    valid[2, 3] = False
    dem = DEM(z, valid)
    expected = np.ones(GRID.shape, bool)
    expected[0] = expected[2, 3] = False
    np.testing.assert_array_equal(dem.valid, expected)
    np.testing.assert_array_equal(np.isnan(dem.z), ~expected)
    assert dem.n_valid == 7


@given(st.integers(0, 2**32 - 1))
def test_random_bits_under_voids_leave_no_trace(bits):
    z = GRID.astype(np.float32)
    z.view(np.uint32)[1, 2] = bits
    valid = np.ones(z.shape, bool)
    valid[1, 2] = False
    clean = DEM(GRID.astype(np.float32), valid)
    assert DEM(z, valid).z.tobytes() == clean.z.tobytes()


def test_signalling_nan_is_a_void_like_any_other():
    z = GRID.astype(np.float32)
    z.view(np.uint32)[1, 2] = 0x7F800001
    assert DEM(z).n_valid == 11


def test_denormals_and_negative_zero_are_heights():
    dem = DEM([[5e-324, -0.0], [1e-310, 0.0]])
    assert dem.n_valid == 4
    assert dem.z[0, 0] == 5e-324


def test_undeclared_minus_32768_is_kept_as_a_height():
    assert DEM(np.array([[-32768, 1], [2, 3]], np.int16)).n_valid == 4
    assert DEM([[-9999.0, 1], [2, 3]], nodata=-9999).n_valid == 4


def test_constant_dem():
    assert DEM(np.full((3, 3), 7)).n_valid == 9


@pytest.mark.parametrize("z", [GRID + 1j, GRID > 3, GRID.astype(object), np.array([["a", "b"]])])
def test_what_is_not_real_is_refused(z):
    refused("not-real", z)


@pytest.mark.parametrize("z", [5.0, [1.0, 2.0], np.zeros((2, 2, 2)), [[1], [1, 2]]])
def test_what_is_not_a_grid_is_refused(z):
    refused("not-2d", z)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0)])
def test_zero_size_is_refused(shape):
    refused("empty", np.zeros(shape))


def test_a_side_over_two_to_the_twenty_is_refused():
    refused("too-large", np.broadcast_to(np.float32(1), (1, 2**20 + 1)))


def test_all_void_is_refused():
    refused("all-nodata", np.full((3, 3), np.nan))
    refused("all-nodata", GRID, np.zeros(GRID.shape, bool))


@pytest.mark.parametrize("height", [1e308, -1e308, 1e101, -3.4028234663852886e38])
def test_heights_that_are_no_terrain_are_refused(height):
    refused("height-range", [[height, 1.0], [2.0, 3.0]])


def test_mask_of_another_shape_is_refused():
    refused("bad-mask", GRID, np.ones(12, bool))


@pytest.mark.parametrize(
    "transform",
    [
        (1, 2, 0, 2, 4, 0),
        (0, 0, 0, 0, 0, 0),
        (1, 0, 0, 0, 0, 0),
        (math.nan, 0, 0, 0, 1, 0),
        (1, 0, math.inf, 0, 1, 0),
        (1, 2, 3),
        "abc",
        7,
        (1e200, 0, 0, 0, 1e200, 0),
        (1e-200, 0, 0, 0, 1e-200, 0),
    ],
)
def test_bad_transform_is_refused(transform):
    refused("bad-transform", GRID, transform=transform)


def test_bad_crs_is_refused():
    refused("bad-crs", GRID, crs="EPSG:0")


def test_without_transform_pixels_are_units_and_y_is_up():
    dem = DEM(GRID)
    assert dem.transform == (1, 0, 0, 0, -1, 3)
    x, y = dem.pixel_to_map([0, 3], [0, 2])
    np.testing.assert_array_equal(x, [0.5, 3.5])
    np.testing.assert_array_equal(y, [2.5, 0.5])


@pytest.mark.parametrize("transform", [Affine(30, 1, 5e5, 2, -30, 5e6), (30, 1, 5e5, 2, -30, 5e6)])
def test_affine_or_six_numbers(transform):
    dem = DEM(GRID, transform=transform)
    assert dem.transform == (30, 1, 5e5, 2, -30, 5e6)
    assert all(type(number) is float for number in dem.transform)


TRANSFORMS = {
    "north-up": Affine(30, 0, 557805, 0, -30, 5122005),
    "south-up": Affine(30, 0, 557805, 0, 30, 5122005),
    "rotated": Affine(8, 6, 5e5, 6, -8, 5e6),
    "sheared": Affine(10, 4, 5e5, -3, -10, 5e6),
    "1000:1": Affine(1000, 0, 5e5, 0, -1, 5e6),
}


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)
def test_integer_pixels_are_centres_and_the_way_back_is_the_inverse(transform):
    dem = DEM(GRID, transform=transform, crs=UTM)
    row, col = np.mgrid[:3, :4]
    x, y = dem.pixel_to_map(col, row)
    a, b, c, d, e, f = transform[:6]
    centre = 2.5 * a + 1.5 * b + c, 2.5 * d + 1.5 * e + f
    np.testing.assert_allclose((x[1, 2], y[1, 2]), centre, rtol=1e-15)
    back = dem.map_to_pixel(x, y)
    np.testing.assert_allclose(back[0], col, atol=1e-6)
    np.testing.assert_allclose(back[1], row, atol=1e-6)


@pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)
def test_metric_measures_steps_in_metres(transform):
    e, f, g = DEM(GRID, transform=transform, crs=UTM).metric()
    x, y = transform.a * 2 - transform.b * 3, transform.d * 2 - transform.e * 3
    assert e * 4 + 2 * f * 2 * -3 + g * 9 == pytest.approx(x * x + y * y)


def test_metric_of_feet_and_of_no_crs():
    foot = 1200 / 3937
    expected = (100 * foot**2, 0.0, 400 * foot**2)
    assert DEM(GRID, transform=(10, 0, 0, 0, -20, 0), crs=FEET).metric() == pytest.approx(expected)
    assert DEM(GRID, transform=(10, 0, 0, 0, -20, 0)).metric() == (100.0, 0.0, 400.0)


@pytest.mark.parametrize(("latitude", "cosine"), [(60, 0.5), (-60, 0.5), (0, 1.0)])
def test_metric_of_degrees_uses_the_cosine_at_the_centre(latitude, cosine):
    transform = (0.001, 0, 179.999, 0, -0.001, latitude + 0.0015)
    e, f, g = DEM(GRID, transform=transform, crs=DEGREES).metric()
    assert (e, f, g) == pytest.approx(((111.32 * cosine) ** 2, 0, 111.32**2), rel=1e-9)


@pytest.mark.parametrize("latitude", [90, -90, 95])
def test_metric_at_the_poles_is_finite_and_positive(latitude):
    e, _, g = DEM(GRID, transform=(0.01, 0, 0, 0, -0.01, latitude), crs=DEGREES).metric()
    assert 0 < e < g


@pytest.mark.parametrize(
    ("text", "unit"), [("m", "metre"), ("ft", "foot"), ("us-ft", "US survey foot"), ("cm", ""), ("", "")]
)
def test_vertical_unit_in_standard_terms(text, unit):
    assert DEM(GRID, vertical_unit=text).vertical_unit == unit


def test_vertical_unit_from_a_compound_crs_unless_given():
    compound = "EPSG:26910+6360"
    assert DEM(GRID, crs=compound).vertical_unit == "US survey foot"
    assert DEM(GRID, crs=compound, vertical_unit="m").vertical_unit == "metre"
    assert DEM(GRID, crs=compound, vertical_unit="cm").vertical_unit == ""


@pytest.mark.parametrize(
    ("unit", "factor", "result"),
    [
        ("foot", 0.3048, "metre"),
        ("metre", 1 / 0.3048, "foot"),
        ("metre", 3.28084, "foot"),
        ("US survey foot", 1200 / 3937, "metre"),
        ("metre", 3937 / 1200, "US survey foot"),
        ("metre", 2.0, ""),
        ("metre", -1.0, ""),
        ("", 0.3048, ""),
    ],
)
def test_scaled_multiplies_and_tells_the_new_unit(unit, factor, result):
    dem = DEM(GRID, GRID != 5, vertical_unit=unit, nodata=-9999, name="x").scaled(factor)
    np.testing.assert_allclose(dem.z, np.where(GRID == 5, np.nan, GRID * factor))
    assert (dem.vertical_unit, dem.nodata, dem.name) == (result, -9999, "x")


def test_scaled_float32_is_rounded_once():
    z = np.array([[1234.567, 8848.86], [1 / 3, 2478]], np.float32)
    exact = (z.astype(np.float64) * 0.3048).astype(np.float32)
    np.testing.assert_array_equal(DEM(z).scaled(0.3048).z, exact)


def test_scaling_drops_a_vertical_crs_that_no_longer_holds():
    dem = DEM(GRID, crs="EPSG:26910+6360").scaled(1200 / 3937)
    assert (dem.crs.code, dem.vertical_unit) == ("EPSG:26910", "metre")
    kept = DEM(GRID, crs="EPSG:26910+5703", vertical_unit="ft").scaled(0.3048)
    assert kept.crs.vertical_unit == kept.vertical_unit == "metre"


@pytest.mark.parametrize("factor", [0, math.nan, math.inf])
def test_bad_z_factor_is_refused(factor):
    with pytest.raises(OptionError) as caught:
        DEM(GRID).scaled(factor)
    assert caught.value.code == "bad-z-factor"


def test_scaling_out_of_range_is_refused():
    for z in (GRID, GRID.astype(np.float32)):
        with pytest.raises(InputError) as caught:
            DEM(z).scaled(1e300)
        assert caught.value.code == "height-range"


def test_pickle_and_copy():
    dem = DEM(GRID, GRID != 5, (30, 0, 5e5, 0, -30, 5e6), UTM, vertical_unit="m", nodata=-1, name="x")
    for other in (pickle.loads(pickle.dumps(dem)), copy.deepcopy(dem)):
        np.testing.assert_array_equal(other.z, dem.z)
        assert (other.transform, other.crs, other.name) == (dem.transform, dem.crs, dem.name)


def test_repr_says_what_it_is():
    dem = DEM(GRID, crs=UTM, name="x")
    assert repr(dem) == "<DEM 'x': 3 x 4 (12 valid), EPSG:26710, float64>"


def test_numpy_alone_is_imported():
    code = (
        "import sys; from tin.dem import DEM; import tin.reader; DEM([[1,2],[3,4]]).metric();"
        "print({'rasterio', 'osgeo', 'fiona', 'pyogrio', 'shapely', 'OpenImageIO'} & set(sys.modules))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"
