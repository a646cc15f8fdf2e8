from __future__ import annotations

import numpy as np
import pyproj
import pytest
from fakes import UTM, crs, grid_tin
from numpy.testing import assert_allclose, assert_array_equal

from tin.formats import write
from tin.formats.obj import _decimals


def parse(path):
    """Read an OBJ as any viewer would, and its header as a GIS user would: header, map coordinates, faces."""
    header, vertices, faces = {}, [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        key, _, rest = line.partition(" ")
        if key == "#" and ": " in rest:
            name, _, value = rest.partition(": ")
            header[name] = value
        elif key == "v":
            vertices.append([float(number) for number in rest.split(" ")])
        elif key == "f":
            faces.append([int(number) for number in rest.split(" ")])
    local = np.array(vertices)
    if header["axes"] == "x east, y up, z south":
        local = local[:, [0, 2, 1]] * (1, -1, 1)
    else:
        assert header["axes"] == "x east, y north, z up"
    origin = np.array([float(number) for number in header["origin"].split(" ")])
    return header, local + origin, np.array(faces) - 1


@pytest.fixture
def path(tmp_path):
    return tmp_path / "out.obj"


@pytest.mark.parametrize("y_up", [False, True])
def test_map_coordinates_come_back_in_full(path, y_up):
    tin = grid_tin(crs=crs("EPSG:26710"))
    write(tin, path, y_up=y_up)
    header, vertices, faces = parse(path)
    assert_array_equal(vertices, tin.vertices)
    assert_array_equal(faces, tin.triangles)
    assert header["CRS"] == "EPSG:26710 (NAD27 / UTM zone 10N)"
    assert header["horizontal unit"] == header["vertical unit"] == "metre"
    assert pyproj.CRS(header["CRS WKT"]) == pyproj.CRS("EPSG:26710")
    assert pyproj.CRS(path.with_suffix(".prj").read_text()) == pyproj.CRS("EPSG:26710")


@pytest.mark.parametrize(
    "transform", [(1e5, 0, -1e7, 0, -1e5, 2e7), (0.1, 0.03, 5e5 / 3, 0.02, -0.1, 5e6 / 7)]
)
def test_large_and_rotated_grids_come_back(path, transform):
    tin = grid_tin(transform=transform)
    write(tin, path)
    assert_allclose(parse(path)[1], tin.vertices, rtol=0, atol=1e-9)


def test_local_coordinates_survive_float32(path):
    tin = grid_tin(200, 300, transform=UTM, crs=crs("EPSG:26710"))
    write(tin, path)
    header, vertices, _ = parse(path)
    local = vertices - np.array([float(number) for number in header["origin"].split()])
    assert_allclose(local, local.astype(np.float32), rtol=0, atol=1e-3)
    assert np.abs(local[:, :2]).max() < 0.6 * np.ptp(vertices[:, :2], axis=0).max()
    assert header["origin"] == "565700 5115400 0"


def test_no_useless_digits(path):
    tin = grid_tin(3, 3)
    tin.vertices[:, 2] = np.arange(9) / 10
    write(tin, path)
    assert "\nv -29.9 29.7 0\nv 0.1 29.7 0.1\nv 30.1 29.7 0.2\n" in path.read_text()


def test_decimals_are_the_shortest_that_round_trip():
    values = np.array([0.0, -0.0, 1.0, -1.5, 0.1, 1 / 3, 1e-7, -2.5e30, 1e22, 123456789.125, 5e-324])
    texts = _decimals(values)
    assert_array_equal(texts.astype(float), values)
    assert texts[:5].tolist() == [b"0", b"0", b"1", b"-1.5", b"0.1"]


@pytest.mark.parametrize("y_up", [False, True])
def test_faces_look_up(path, y_up):
    write(grid_tin(), path, y_up=y_up)
    lines = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([line[1:] for line in lines if line[0] == "v"], float)
    corners = vertices[np.array([line[1:] for line in lines if line[0] == "f"], int) - 1]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 1 if y_up else 2] > 0).all()


def test_degrees_are_said_to_be_degrees(path):
    tin = grid_tin(crs=crs("EPSG:4326"), transform=(1 / 1200, 0, -84.2, 0, -1 / 1200, 36.6))
    write(tin, path)
    header, vertices, _ = parse(path)
    assert header["horizontal unit"] == "degree (longitude, latitude)"
    assert header["origin"] == "-84.193 36.595 0"
    assert_array_equal(vertices, tin.vertices)


def test_without_a_crs_there_is_no_prj_and_an_old_one_goes(path):
    write(grid_tin(crs=crs("EPSG:26710"), vertical_unit=""), path)
    assert path.with_suffix(".prj").exists()
    assert parse(path)[0]["vertical unit"] == "unknown"
    write(grid_tin(), path, overwrite=True)
    assert not path.with_suffix(".prj").exists()
    assert parse(path)[0]["CRS"] == "none"


def test_a_strange_name_stays_in_its_comment(path):
    tin = grid_tin()
    tin.name = "a\nv 1 2 3\r\x0b\u2028v 4 5 6 \udcff"
    write(tin, path)
    assert len(parse(path)[1]) == len(tin.vertices)


def test_more_rows_than_are_formatted_at_a_time(path, monkeypatch):
    tin = grid_tin()
    write(tin, path)
    whole = path.read_bytes()
    monkeypatch.setattr("tin.formats.obj._ROWS", 7)
    write(tin, path, overwrite=True)
    assert path.read_bytes() == whole
