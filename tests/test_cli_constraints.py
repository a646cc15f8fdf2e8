"""Vector files on the command line: what is followed, what is said, and that no input is replaced."""

from __future__ import annotations

import json
import os
from pathlib import Path

import geopandas
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from test_cli import JACKSBORO, run

import tin

CRS = "EPSG:32616"
ROOT = Path(__file__).parents[1]


def place(*corners):
    """Map coordinates of columns and rows, and heights."""
    a, _, c, _, e, f = tin.open(JACKSBORO).transform
    return [(a * (col + 0.5) + c, e * (row + 0.5) + f, *z) for col, row, *z in corners]


ROAD = place((30, 30, 500), (200, 150, 700), (340, 300, 450))
CLIP = place((10, 10), (350, 20), (300, 310), (20, 300))
LAKE = place((50, 60), (120, 60), (90, 120))


@pytest.fixture
def folder(tmp_path):
    def save(name, geometry, crs=CRS, **keywords):
        geopandas.GeoDataFrame(geometry=[geometry], crs=crs).to_file(tmp_path / name, **keywords)

    save("v.gpkg", shapely.LineString(ROAD), layer="roads")
    save("v.gpkg", shapely.Polygon(LAKE), layer="lake", mode="a")
    save("clip.shp", shapely.Polygon(CLIP))
    save("spot.geojson", shapely.Point(place((77, 200, 999.5))[0]))
    save("far.geojson", shapely.Point(5, 5), crs="EPSG:4326")
    save("flatland.fgb", shapely.LineString([(x, y, 0.0) for x, y, _ in ROAD]))
    (tmp_path / "t.csv").write_text("x,y\n1,2\n")
    (tmp_path / "bad.gpkg").write_text("hello")
    return tmp_path


def dem2tin(folder, *arguments):
    return run(JACKSBORO, *arguments, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)})


def test_all_constraints_at_once(folder):
    vectors = ["--breaklines", "v.gpkg:roads", "--flat", "v.gpkg:lake", "--clip", "clip.shp"]
    outputs = ["x.gpkg", "x.tif", "--outline", "o.gpkg", "--json", "x.json"]
    done = dem2tin(folder, *outputs, *vectors, "--points", "spot.geojson")
    assert (done.returncode, done.stderr) == (0, "")
    assert "clipped or sieved off" in done.stdout
    assert json.loads((folder / "x.json").read_text())["warnings"] == []
    outline = pyogrio.read_dataframe(folder / "o.gpkg")
    data = tin.triangulate(tin.open(JACKSBORO), max_points=4).outline()
    clip = shapely.Polygon(CLIP) & shapely.union_all([shapely.Polygon(part[0], part[1:]) for part in data])
    assert shapely.union_all(outline.geometry).symmetric_difference(clip).area < 1e-3 * clip.area
    with rasterio.open(folder / "x.tif") as file:
        grid = file.read(1)
    assert grid[150, 200] == pytest.approx(700)
    assert grid[200, 77] == pytest.approx(999.5)
    assert np.ptp(grid[62:90, 80:95]) == 0
    triangles = pyogrio.read_dataframe(folder / "x.gpkg")
    corners = shapely.get_coordinates(triangles.geometry.values, include_z=True)
    assert (corners[:, 2] == 999.5).any()
    marked = triangles[triangles.constraints > 0]
    road = shapely.force_2d(shapely.LineString(ROAD))
    assert shapely.dwithin(shapely.points(corners[:, :2]), road, 0.36).sum() > 6
    assert len(marked) >= 4


def test_soft_takes_the_heights_of_the_dem(folder):
    done = dem2tin(folder, "x.tif", "--breaklines", "flatland.fgb", "--soft")
    assert (done.returncode, done.stderr) == (0, "")
    with rasterio.open(folder / "x.tif") as file:
        assert file.read(1)[150, 200] > 100


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--breaklines", "v.gpkg:rivers"], 3, "there is no layer 'rivers'; there are roads, lake"),
        (["--clip", "v.gpkg:roads"], 3, "holds lines, where polygons are needed"),
        (["--points", "v.gpkg"], 3, "holds lines, where points are needed"),
        (["--breaklines", "spot.geojson"], 3, "holds points, where lines are needed"),
        (["--points", "bad.gpkg"], 3, "cannot be read as a vector file"),
        (["--points", "t.csv"], 3, "a table without geometries"),
        (["--flat", "nope.gpkg"], 3, "nope.gpkg: no such file"),
        (["--flat", JACKSBORO], 3, "cannot be read as a vector file"),
        (["--clip", "https://example.org/a.geojson"], 3, "is remote"),
        (["--outline-tolerance", "1e7"], 2, "between 0 and 100 pixels"),
        (["--outline-tolerance=-3px"], 2, "--outline-tolerance"),
        (["--sieve", "1.5"], 2, "--sieve"),
    ],
)
def test_a_mistake_gets_one_line(folder, arguments, code, words):
    done = dem2tin(folder, "x.obj", *arguments)
    assert done.returncode == code
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(folder.glob("x.*"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--points", "far.geojson"], "far.geojson: 1 of 1 points lie outside the DEM"),
        (["--breaklines", "flatland.fgb"], "flatland.fgb: all heights are 0"),
    ],
)
def test_what_is_perhaps_a_mistake_is_told_on_stderr_and_in_the_report(folder, arguments, words):
    done = dem2tin(folder, "x.tif", "--max-points", "50", "--json", "-", *arguments)
    assert done.returncode == 0
    (warning,) = json.loads(done.stdout)["warnings"]
    assert warning.startswith(words)
    assert done.stderr.splitlines()[0] == f"dem2tin: warning: {warning}"
    assert "RuntimeWarning" not in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["v.gpkg", "--breaklines", "v.gpkg:roads"],
        ["v.gpkg", "--flat", "v.gpkg"],
        ["x.gpkg", "--breaklines", "v.gpkg:roads", "--outline", "v.gpkg"],
        ["x.gpkg", "--clip", "clip.shp", "--json", "clip.shp"],
        ["x.gpkg", "--clip", "clip.shp", "--json", "clip.dbf"],
        ["clip.obj", "--clip", "clip.shp"],
        ["x.gpkg", "--points", "spot.geojson", "--json", "spot.geojson"],
    ],
)
def test_no_vector_input_is_replaced(folder, arguments):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = dem2tin(folder, *arguments, "--overwrite")
    assert done.returncode == 4
    assert "belongs to the input" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
