from __future__ import annotations

import sys

import numpy as np
import pyproj
import pytest
from numpy.testing import assert_allclose
from terrain import hills

import tin
from tin import transform
from tin.crs import CRS
from tin.errors import InputError


def dem_at(longitude, latitude, **settings):
    """A DEM of 0.1 degrees around a place."""
    step = 0.1 / 20
    place = (step, 0, longitude - 0.05, 0, -step, latitude + 0.05)
    return tin.DEM(hills(20, 20), transform=place, **{"crs": "EPSG:4326", **settings})


@pytest.mark.parametrize(
    ("longitude", "latitude", "code"),
    [
        (-84.2, 36.4, 32616),
        (-84.2, -36.4, 32716),
        (3.0, 0.0, 32631),
        (-177.0, 10.0, 32601),
        (177.0, 10.0, 32660),
        (275.8, 36.4, 32616),
        (181.0, -10.0, 32701),
        (20.0, 83.9, 32634),
        (20.0, 84.1, 32661),
        (20.0, -79.9, 32734),
        (20.0, -80.1, 32761),
    ],
)
def test_utm_is_the_zone_of_the_centre(longitude, latitude, code):
    found = transform.target(dem_at(longitude, latitude), " UTM ")
    assert found.code == f"EPSG:{code}"
    assert found.unit_name == "metre"


def test_utm_of_a_projected_dem():
    x, y = pyproj.Transformer.from_crs(4326, 2227, always_xy=True).transform(-121.5, 37.5)
    source = tin.DEM(hills(20, 20), transform=(30, 0, x, 0, -30, y), crs="EPSG:2227")
    assert transform.target(source, "utm").code == "EPSG:32610"


@pytest.mark.parametrize(
    ("own", "asked", "code"),
    [
        (None, "utm", "no-crs"),
        (None, "EPSG:3857", "no-crs"),
        ('LOCAL_CS["site grid",UNIT["foot",0.3048]]', "utm", "bad-crs"),
        ("EPSG:4326", 'LOCAL_CS["site grid",UNIT["foot",0.3048]]', "bad-crs"),
        ("EPSG:4326", "EPSG:4978", "bad-crs"),
        ("EPSG:4326", "EPSG:5703", "bad-crs"),
        ("EPSG:4326", "EPSG:999999", "bad-crs"),
        ("EPSG:4326", "nonsense", "bad-crs"),
        ("EPSG:4326", None, "bad-crs"),
        ("EPSG:4326", 7, "bad-crs"),
    ],
)
def test_what_cannot_be_is_refused(own, asked, code, capfd):
    with pytest.raises(InputError) as caught:
        transform.target(dem_at(10, 50, crs=own), asked)
    assert caught.value.code == code
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_only_the_horizontal_part_of_a_compound_crs_counts():
    source = dem_at(-84.2, 36.4, crs="EPSG:4326+5773")
    assert transform.target(source, "EPSG:26910+5703").code == "EPSG:26910"
    assert transform.target(source, "utm").code == "EPSG:32616"
    assert transform.is_same(CRS.parse("EPSG:26910+5703"), CRS.parse("EPSG:26910"))
    assert not transform.is_same(CRS.parse("EPSG:26910"), CRS.parse("EPSG:26911"))


@pytest.mark.parametrize("source", ["EPSG:4326", "EPSG:32616", "EPSG:4326+5773", "EPSG:4979"])
@pytest.mark.parametrize(
    "goal", ["EPSG:32616", "EPSG:3857", "EPSG:3035", "EPSG:32661", "EPSG:4326", "EPSG:5513"]
)
def test_points_are_where_pyproj_puts_them(source, goal):
    degrees = np.random.default_rng(0).uniform((-90.0, 30.0), (-84.0, 40.0), (50, 2))
    flat = pyproj.CRS(source).to_2d() if "+" not in source else pyproj.CRS(source).sub_crs_list[0]
    places = np.column_stack(pyproj.Transformer.from_crs(4326, flat, always_xy=True).transform(*degrees.T))
    expected = pyproj.Transformer.from_crs(flat, goal, always_xy=True).transform(*places.T)
    moved = transform.points(CRS.parse(source), CRS.parse(goal), places)
    assert_allclose(moved, np.column_stack(expected), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("goal", "place"),
    [
        ("+proj=ortho +lat_0=0 +lon_0=0", (180.0, 1.0)),
        ("EPSG:32610", (np.nan, 45.0)),
        ("EPSG:3857", (0.0, 95.0)),
    ],
)
def test_a_point_that_has_no_place_there(goal, place, capfd):
    with pytest.raises(InputError) as caught:
        transform.points(CRS.parse("EPSG:4326"), CRS.parse(goal), np.array([[0.0, 1.0], place]))
    assert caught.value.code == "outside-crs"
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def plane(longitude, latitude):
    return 500 + 300 * (longitude + 84.2) - 200 * (latitude - 36.4)


@pytest.mark.parametrize(
    "place",
    [
        (90.0, 0, 743000, 0, -90.0, 4035000),
        (90.0, 0, 743000, 0, 90.0, 4028000),
        (80.0, 40.0, 740000, 30.0, -70.0, 4033000),
        (0, 90.0, 743000, 90.0, 0, 4028000),
    ],
)
def test_a_grid_holds_the_same_surface(place):
    row, col = np.mgrid[0:70, 0:90]
    source = tin.DEM(np.zeros((70, 90)), transform=place, crs="EPSG:32616")
    degrees = pyproj.Transformer.from_crs(32616, 4326, always_xy=True)
    z = plane(*degrees.transform(*source.pixel_to_map(col, row)))
    z[20:30, 40:60] = np.nan
    mesh = tin.triangulate(tin.DEM(z, transform=place, crs="EPSG:32616"), max_points=100)
    moved = mesh.to_crs("EPSG:4326")
    values, found = transform.to_grid(moved, mesh.dem.z)
    grid = tin.DEM(values, transform=found, crs="EPSG:4326")
    assert found[1] == found[3] == 0
    assert found[0] == pytest.approx(-found[4])
    x, y = grid.pixel_to_map(*np.meshgrid(np.arange(grid.cols), np.arange(grid.rows)))
    known = np.isfinite(values)
    # Half a pixel around the voids and at the border GDAL lets a neighbour's height stand for a missing one.
    assert np.percentile(np.abs(values - plane(x, y))[known], 90) < 0.05  # of 0.25 a pixel
    assert np.abs(values - plane(x, y))[known].max() < 1.0
    size = abs(np.linalg.det(np.reshape(place, (2, 3))[:, :2]))
    metres = (111_320 * found[0]) ** 2 * np.cos(np.radians(36.4))
    assert known.sum() * metres == pytest.approx(mesh.dem.n_valid * size, rel=0.02)
    assert 0.4 < values.size / z.size < 4


def test_without_another_crs_nothing_is_touched():
    mesh = tin.triangulate(dem_at(10, 50), max_points=20)
    values = mesh.rasterize()
    assert transform.to_grid(mesh, values) == (values, mesh.dem.transform)


@pytest.mark.parametrize("latitude", [0.0, 60.0, 83.0])
def test_the_smallest_dem(latitude, tmp_path):
    source = tin.DEM(
        np.array([[1.0, 2.0], [3.0, 4.0]]), transform=(1e-3, 0, 10, 0, -1e-3, latitude), crs="EPSG:4326"
    )
    moved = tin.triangulate(source).to_crs("utm")
    values, _ = transform.to_grid(moved, source.z)
    assert min(values.shape) >= 2
    assert np.isfinite(values).any()


def test_without_rasterio(monkeypatch):
    source = dem_at(10, 50)
    monkeypatch.setitem(sys.modules, "rasterio.crs", None)
    with pytest.raises(InputError) as caught:
        transform.target(source, CRS.parse('GEOGCS["x",UNIT["degree",0.0174532925199433]]'))
    assert caught.value.code == "missing-library"
