"""Points from vector files."""

from __future__ import annotations

from pathlib import Path

import geopandas
import numpy as np
import pytest
import shapely
from terrain import dem
from test_cli import JACKSBORO, run

import tin
from tin import vector

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
    found = vector.read_points(str(path), source.crs)
    np.testing.assert_allclose(found, wanted, atol=0.01)
    mesh = tin.triangulate(source, points=found, max_points=20)
    assert {(3, 5), (40, 22), (71, 50)} <= {tuple(p) for p in mesh.pixels.astype(int).tolist()}


def test_a_layer_is_chosen_by_name_and_multipoints_count(tmp_path):
    path = tmp_path / "two.gpkg"
    write(path, np.zeros((1, 2)), UTM, layer="other")
    many = geopandas.GeoDataFrame(geometry=[shapely.MultiPoint([(1, 2), (3, 4)])], crs=UTM)
    many.to_file(path, layer="summits", engine="fiona")
    found = vector.read_points(f"{path}:summits", dem(crs=UTM).crs)
    np.testing.assert_array_equal(found, [[1, 2], [3, 4]])


def test_empty_geometries_and_missing_crs_are_taken_as_they_are(tmp_path):
    path = tmp_path / "p.geojson"
    path.write_text(
        '{"type":"FeatureCollection","features":['
        '{"type":"Feature","properties":{},"geometry":null},'
        '{"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[7,8]}}]}'
    )
    np.testing.assert_array_equal(vector.read_points(str(path), None), [[7, 8]])


def test_what_is_not_points_is_refused(tmp_path):
    lines = tmp_path / "lines.gpkg"
    geopandas.GeoDataFrame(geometry=[shapely.LineString([(0, 0), (1, 1)])], crs=UTM).to_file(
        lines, engine="fiona"
    )
    for source, code in [
        (str(lines), "not-points"),
        (f"{lines}:roads", "no-layer"),
        (str(tmp_path / "nothing.gpkg"), "not-found"),
        (__file__, "not-a-vector"),
    ]:
        with pytest.raises(tin.InputError) as caught:
            vector.read_points(source, None)
        assert caught.value.code == code


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
