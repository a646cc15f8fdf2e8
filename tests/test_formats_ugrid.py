"""UGRID NetCDF, read back by scipy."""

import numpy as np
import pytest
import scipy.io
from fakes import UTM, crs, grid_tin

from tin.formats import ugrid, write
from tin.formats.ugrid import Variable, write_netcdf


def read(path):
    with scipy.io.netcdf_file(path, mmap=False) as file:
        values = {name: variable.data.copy() for name, variable in file.variables.items()}
        attributes = {name: dict(variable._attributes) for name, variable in file.variables.items()}
        return values, attributes, dict(file._attributes)


def test_geometry_is_exact(tmp_path):
    tin = grid_tin(crs=crs("EPSG:32610"))
    write(tin, tmp_path / "x.nc")
    values, _, top = read(tmp_path / "x.nc")
    for axis, name in enumerate("xyz"):
        assert np.array_equal(values[f"mesh2d_node_{name}"], tin.vertices[:, axis])
    assert np.array_equal(values["mesh2d_face_nodes"], tin.triangles)
    assert np.array_equal(values["max_error"], tin.triangle_errors)
    assert top == {"Conventions": b"CF-1.8 UGRID-1.0", "title": b"TIN of hills"}


def test_topology_names_what_is_there(tmp_path):
    write(grid_tin(crs=crs("EPSG:32610")), tmp_path / "x.nc")
    values, attributes, _ = read(tmp_path / "x.nc")
    mesh = attributes["mesh2d"]
    assert (mesh["cf_role"], mesh["topology_dimension"]) == (b"mesh_topology", 2)
    named = mesh["node_coordinates"].decode().split() + [mesh["face_node_connectivity"].decode()]
    assert set(named) <= values.keys()
    assert attributes["mesh2d_face_nodes"]["start_index"] == 0
    assert attributes["mesh2d_node_z"]["location"] == b"node"
    assert attributes["max_error"]["location"] == b"face"


@pytest.mark.parametrize(
    ("code", "names", "unit"),
    [
        ("EPSG:32610", "projection_{}_coordinate", b"m"),
        ("EPSG:2225", "projection_{}_coordinate", b"US_survey_foot"),
        ("EPSG:4326", None, b"degrees_east"),
    ],
)
def test_crs_and_units(tmp_path, code, names, unit):
    write(grid_tin(crs=crs(code), vertical_unit="foot"), tmp_path / "x.nc")
    _, attributes, _ = read(tmp_path / "x.nc")
    x = attributes["mesh2d_node_x"]
    assert x["standard_name"].decode() == (names.format("x") if names else "longitude")
    assert x["units"] == unit
    assert attributes["mesh2d_node_z"]["units"] == b"ft"
    reference = attributes[x["grid_mapping"].decode()]
    assert reference["EPSG_code"].decode() == code
    assert reference["wkt"] == reference["crs_wkt"] == reference["spatial_ref"]
    assert "\n" not in reference["wkt"].decode()


def test_without_crs_and_units(tmp_path):
    write(grid_tin(vertical_unit=""), tmp_path / "x.nc")
    values, attributes, _ = read(tmp_path / "x.nc")
    assert "crs" not in values
    assert "grid_mapping" not in attributes["mesh2d_node_x"]
    assert "units" not in attributes["mesh2d_node_z"]


def test_own_crs_has_wkt_alone(tmp_path):
    own = crs("EPSG:32610")
    own.code = None
    write(grid_tin(crs=own), tmp_path / "x.nc")
    _, attributes, _ = read(tmp_path / "x.nc")
    assert "EPSG_code" not in attributes["crs"]
    assert b"UTM zone 10N" in attributes["crs"]["wkt"]


def test_name_beyond_ascii(tmp_path):
    tin = grid_tin()
    tin.name = "Höhe\n\udcff"
    write(tin, tmp_path / "x.nc")
    assert read(tmp_path / "x.nc")[2]["title"].decode() == "TIN of Höhe ?"


def test_every_kind_of_value_is_padded(tmp_path, monkeypatch):
    monkeypatch.setattr(ugrid, "_ROWS", 3)
    path = tmp_path / "x.nc"
    numbers = np.arange(7, dtype=np.int64)
    with path.open("wb") as file:
        write_netcdf(
            file,
            {"n": 7},
            {"odd": "abcde", "real": 0.25},
            [Variable("a", ("n",), numbers), Variable("b", ("n",), numbers / 3.0)],
        )
    values, _, top = read(path)
    assert np.array_equal(values["a"], numbers)
    assert np.array_equal(values["b"], numbers / 3.0)
    assert top == {"odd": b"abcde", "real": 0.25}


def test_same_bytes_every_time(tmp_path):
    for name in "ab":
        write(grid_tin(transform=UTM), tmp_path / f"{name}.nc")
    assert (tmp_path / "a.nc").read_bytes() == (tmp_path / "b.nc").read_bytes()
