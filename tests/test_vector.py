"""Points, lines and polygons from vector files."""

from __future__ import annotations

import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import geopandas
import numpy as np
import pytest
import shapely
from terrain import dem
from test_cli import JACKSBORO, run

import tin
from tin import features, shapes, vector

UTM = "EPSG:32610"


def places(source: tin.DEM) -> np.ndarray:
    return np.column_stack(source.pixel_to_map(np.array([3, 40, 71]), np.array([5, 22, 50])))


def write(path: Path, points: np.ndarray, crs: str | None, **keywords: object) -> Path:
    geopandas.GeoDataFrame(geometry=shapely.points(points), crs=crs).to_file(path, engine="fiona", **keywords)
    return path


@pytest.mark.parametrize("suffix", ["gpkg", "geojson", "shp"])
@pytest.mark.parametrize("crs", ["EPSG:32610", "EPSG:4326"])
def test_points_come_in_the_crs_of_the_dem(tmp_path, suffix, crs):
    source = dem(crs=UTM)
    wanted = places(source)
    there = geopandas.GeoSeries(shapely.points(wanted), crs=UTM).to_crs(crs)
    path = write(tmp_path / f"p.{suffix}", there.get_coordinates().to_numpy(), crs)
    found = features.points(path, source.crs)
    np.testing.assert_allclose(found[:, :2], wanted, atol=0.01)
    mesh = tin.triangulate(source, points=found, max_points=20)
    assert {(3, 5), (40, 22), (71, 50)} <= {tuple(p) for p in mesh.pixels.astype(int).tolist()}


def test_a_layer_is_chosen_by_name_and_multipoints_count(tmp_path):
    path = tmp_path / "two.gpkg"
    write(path, np.zeros((1, 2)), UTM, layer="other")
    many = geopandas.GeoDataFrame(geometry=[shapely.MultiPoint([(1, 2), (3, 4)])], crs=UTM)
    many.to_file(path, layer="summits", engine="fiona")
    found = features.points(f"{path}:summits", dem(crs=UTM).crs)
    np.testing.assert_array_equal(found[:, :2], [[1, 2], [3, 4]])


def test_empty_geometries_and_missing_crs_are_taken_as_they_are(tmp_path):
    path = tmp_path / "p.geojson"
    path.write_text(
        '{"type":"FeatureCollection","features":['
        '{"type":"Feature","properties":{},"geometry":null},'
        '{"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[7,8]}}]}'
    )
    np.testing.assert_array_equal(features.points(path, None)[:, :2], [[7, 8]])


def test_what_is_not_points_is_refused(tmp_path):
    lines = tmp_path / "lines.gpkg"
    geopandas.GeoDataFrame(geometry=[shapely.LineString([(0, 0), (1, 1)])], crs=UTM).to_file(
        lines, engine="fiona"
    )
    refused(lines, "not-points", features.points)


def refused(source: object, code: str, function: object = None) -> str:
    with pytest.raises(tin.InputError) as caught:
        (function or (lambda name, _: vector.read(name)))(str(source), None)
    assert caught.value.code == code
    return str(caught.value)


def test_what_is_no_layer_of_a_vector_file(tmp_path):
    path = write(tmp_path / "p.gpkg", np.zeros((1, 2)), UTM, layer="here")
    assert "no layer 'roads'; there are here" in refused(f"{path}:roads", "no-layer")
    refused(f"{path}:", "no-layer")
    refused(f"{path}:x/y", "no-layer")
    for name in ("nothing.gpkg", "nothing.gpkg:here", "", ":here", "a" * 5000, "a\0b"):
        refused(tmp_path / name if name not in ("", ":here") else name, "not-found")
    assert r"C:\nothing.gpkg: no such file" in refused(r"C:\nothing.gpkg", "not-found")
    assert r"C:\nothing.gpkg: no such file" in refused(r"C:\nothing.gpkg:here", "not-found")
    refused(__file__, "not-a-vector")
    refused(JACKSBORO, "not-a-vector")
    (tmp_path / "empty.gpkg").write_bytes(b"")
    refused(tmp_path / "empty.gpkg", "not-a-vector")
    (tmp_path / "cut.gpkg").write_bytes(path.read_bytes()[:5000])
    refused(tmp_path / "cut.gpkg", "not-a-vector")
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    assert "a table without geometries" in refused(tmp_path / "table.csv", "not-a-vector")


def test_the_network_is_refused(tmp_path):
    for name in (
        "https://example.invalid/p.gpkg",
        "/vsicurl/https://example.invalid/p.gpkg:a",
        "s3://b/p.gpkg",
    ):
        refused(name, "remote")
    path = tmp_path / "p.vrt"
    path.write_text(
        '<OGRVRTDataSource><OGRVRTLayer name="a"><SrcDataSource>/vsicurl/http://127.0.0.1:9/a.gpkg'
        "</SrcDataSource></OGRVRTLayer></OGRVRTDataSource>"
    )
    refused(path, "remote")
    refused(f"{path}:a", "remote")
    with pytest.raises(tin.InputError) as caught:
        vector.read("/vsicurl/http://127.0.0.1:9/a.gpkg", allow_remote=True)
    assert caught.value.code == "not-a-vector"


@pytest.mark.parametrize("name", ["zip:p", "höhe über:NN #1 %", "a!b", "C:p?x=1&y", " p "])
def test_names_of_files_and_layers_are_odd(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / f"{name}.gpkg", np.array([[1, 2]]), UTM, layer="Höhen: alle")
    for source in (f"{name}.gpkg", f"{name}.gpkg:Höhen: alle", str(tmp_path / f"{name}.gpkg")):
        found, crs = vector.read(source)
        np.testing.assert_array_equal(found.xyz[:, :2], [[1, 2]])
        assert crs.code == UTM


def test_an_archive_and_a_folder_are_read(tmp_path):
    write(tmp_path / "p.shp", np.array([[1, 2]]), UTM)
    with zipfile.ZipFile(tmp_path / "p.zip", "w") as archive:
        for suffix in ("shp", "shx", "dbf", "prj"):
            archive.write(tmp_path / f"p.{suffix}", f"p.{suffix}")
    for source in (
        tmp_path,
        f"{tmp_path}:p",
        f"/vsizip/{tmp_path}/p.zip",
        f"/vsizip/{tmp_path}/p.zip/p.shp:p",
    ):
        np.testing.assert_array_equal(vector.read(str(source))[0].xyz[:, :2], [[1, 2]])


def test_a_shapefile_cut_short_is_refused(tmp_path, capfd):
    path = write(tmp_path / "p.shp", np.arange(100.0).reshape(50, 2), UTM)
    path.write_bytes(path.read_bytes()[:700])
    assert "damaged or incomplete" in refused(path, "unreadable")
    assert capfd.readouterr() == ("", "")


def test_every_type_of_geometry(tmp_path):
    wkts = [
        "POINT EMPTY", "POINT (0 0)", "POINT ZM (1 2 3 4)", "POINT M (5 6 7)", "MULTIPOINT EMPTY",
        "LINESTRING EMPTY", "LINESTRING (1 1)", "LINESTRING ZM (1 2 3 4, 5 6 7 8)",
        "COMPOUNDCURVE (CIRCULARSTRING (0 0, 1 1, 2 0), (2 0, 3 0))",
        "CURVEPOLYGON (CIRCULARSTRING (0 0, 1 1, 2 0, 1 -1, 0 0))",
        "GEOMETRYCOLLECTION (POINT (8 9), GEOMETRYCOLLECTION (POLYGON ((0 0, 1 0, 1 1, 0 0))))",
        "TIN Z (((0 0 0, 0 1 0, 1 1 0, 0 0 0)))",
    ]  # fmt: skip
    path = tmp_path / "g.csv"
    path.write_text("id,WKT\n" + "".join(f'{i},"{wkt}"\n' for i, wkt in enumerate(wkts)))
    found, crs = vector.read(str(path))
    assert crs is None
    # fiona gives (0, 0) for an empty point; only the real one counts, and it comes last.
    points = found.xyz[(found.kinds == shapes.POINTS)[found.path_of_vertex]]
    np.testing.assert_array_equal(points[[0, 1, -1]], [[1, 2, 3], [5, 6, np.nan], [0, 0, np.nan]])
    assert len(points) == 4
    lines = found.sizes[found.kinds == shapes.LINE].tolist()
    assert lines[:3] == [0, 1, 2]
    assert lines[3] > 20
    arc = found.xyz[found.path_of_vertex == np.flatnonzero(found.sizes == lines[3])[0]]
    np.testing.assert_allclose(np.hypot(arc[:-1, 0] - 1, arc[:-1, 1]), 1)
    assert (found.sizes[found.kinds == shapes.EXTERIOR][1:] == 4).all()


def test_an_undefined_crs_is_none(tmp_path):
    path = write(tmp_path / "p.gpkg", np.array([[1, 2]]), UTM)
    for number in (0, -1):
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("update gpkg_geometry_columns set srs_id = ?", (number,))
        assert vector.read(str(path))[1] is None


def test_points_on_the_command_line(tmp_path):
    source = tin.open(JACKSBORO)
    x, y = source.pixel_to_map(100, 100)
    path = write(tmp_path / "p.gpkg", np.array([[x, y]]), "EPSG:32616")
    out = tmp_path / "x.obj"
    done = run(JACKSBORO, out, "--points", path, "--max-points", 50, "--quiet")
    assert done.returncode == 0, done.stderr
    text = out.read_text()
    origin = next(line.split()[2:4] for line in text.splitlines() if line.startswith("# origin:"))
    vertices = np.array([line.split()[1:3] for line in text.splitlines() if line.startswith("v ")], float)
    assert np.abs(vertices + np.array(origin, float) - [x, y]).sum(axis=1).min() < 1e-6
    missing = run(JACKSBORO, tmp_path / "y.obj", "--points", tmp_path / "no.gpkg")
    assert missing.returncode == 3
    assert "no such file" in missing.stderr
