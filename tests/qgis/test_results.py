"""Results of the algorithms, against the command line's on the same input."""

import json

import numpy as np
import pytest
from osgeo import gdal, osr
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsFeature,
    QgsGeometry,
    QgsMeshLayer,
    QgsPointXY,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterRasterLayer,
    QgsProject,
    QgsRasterLayer,
    QgsRasterRange,
    QgsVectorLayer,
)
from support import USGS, VOIDS, Feedback, dems, make_dem, read_polygons, read_raster, vertices_of_obj

KINDS = ["utm", "geographic", "voids", "feet", "rotated", "south-up", "own-crs", "compound"]


def vector(crs, *wkts):
    layer = QgsVectorLayer(
        f"{QgsGeometry.fromWkt(wkts[0]).asWkt().split(' ')[0]}?crs={crs}", "shapes", "memory"
    )
    for wkt in wkts:
        feature = QgsFeature()
        feature.setGeometry(QgsGeometry.fromWkt(wkt))
        assert layer.dataProvider().addFeature(feature)
    return layer


@pytest.mark.parametrize("kind", KINDS)
def test_equal_to_the_command_line(run, command, tmp_path, kind):
    dem = dems(tmp_path)[kind]
    ours, theirs = tmp_path / "qgis", tmp_path / "command"
    ours.mkdir()
    theirs.mkdir()
    said = Feedback()
    results = run(
        "demtotin",
        feedback=said,
        INPUT=dem,
        MAX_POINTS="3%",
        OUTPUT=ours / "t.gpkg",
        MESH=ours / "t.nc",
        OBJ=ours / "t.obj",
        RASTER=ours / "t.tif",
        ERROR=ours / "e.tif",
        REPORT=ours / "r.html",
    )
    outputs = [theirs / name for name in ("t.gpkg", "t.nc", "t.obj", "t.tif")]
    numbers = json.loads(command(dem, *outputs, "--max-points", "3%", "--json", "-"))
    named = [("POINTS", "points"), ("TRIANGLES", "triangles"), ("RMSE", "rmse"), ("MAE", "mae")]
    for ours_name, name in [*named, ("P95", "p95"), ("MAX_ERROR", "max_error")]:
        assert results[ours_name] == numbers[name], name

    assert vertices_of_obj(ours / "t.obj") == vertices_of_obj(theirs / "t.obj")
    rings, rows, crs = read_polygons(ours / "t.gpkg")
    their_rings, their_rows, their_crs = read_polygons(theirs / "t.gpkg")
    assert np.array_equal(rings, their_rings)
    # Two builds of numpy may differ in the last bit of a root or an angle.
    assert len(rows) == len(their_rows)
    assert all(row == pytest.approx(other, rel=1e-12) for row, other in zip(rows, their_rows))
    own = QgsRasterLayer(str(dem), "x").crs()
    assert own.isValid()
    assert same_crs(crs, own)
    heights, dataset = read_raster(ours / "t.tif")
    their_heights, their_dataset = read_raster(theirs / "t.tif")
    assert np.array_equal(heights, their_heights, equal_nan=True)
    assert dataset.GetGeoTransform() == their_dataset.GetGeoTransform()
    same_place(dataset, gdal.Open(str(dem)))
    mesh = QgsMeshLayer(str(ours / "t.nc"), "x", "mdal")
    assert mesh.isValid()
    assert (mesh.dataProvider().vertexCount(), mesh.dataProvider().faceCount()) == (
        results["POINTS"],
        results["TRIANGLES"],
    )
    assert same_crs(mesh.crs(), own)
    assert same_crs(their_crs, own)
    errors, _ = read_raster(ours / "e.tif")
    assert np.nanmax(np.abs(errors)) == pytest.approx(results["MAX_ERROR"], abs=1e-3)
    assert "data:image/png;base64" in (ours / "r.html").read_text(encoding="utf-8")
    assert said.bar == sorted(said.bar)
    assert said.bar[-1] == 100
    assert any(f"{results['POINTS']:,} points" in line for line in said.infos)

    again = run("tinerror", TIN=ours / "t.gpkg", INPUT=dem, ERROR=ours / "e2.tif", REPORT=ours / "r2.html")
    for name in ("RMSE", "MAE", "P95", "MAX_ERROR"):
        assert again[name] == pytest.approx(results[name], rel=1e-6, abs=1e-6)
    assert (again["COVERED"], again["UNCOVERED"]) == (numbers["covered"], numbers["uncovered"])
    run("tintoraster", TIN=ours / "t.gpkg", REFERENCE=dem, OUTPUT=ours / "t2.tif")
    again_heights, _ = read_raster(ours / "t2.tif")
    assert np.allclose(again_heights, heights, rtol=1e-6, atol=1e-4, equal_nan=True)


def same_crs(one, other):
    return reference(one).IsSame(reference(other)) == 1


def reference(crs):
    return osr.SpatialReference(crs.toWkt(crs.WKT2_2018))


def same_place(dataset, other):
    assert dataset.GetGeoTransform() == other.GetGeoTransform()
    assert dataset.GetSpatialRef().IsSame(other.GetSpatialRef())


@pytest.mark.parametrize(
    ("options", "flags"),
    [
        ({"METHOD": "max", "TOLERANCE": 20}, ["--method", "max", "--tolerance", "20"]),
        ({"METHOD": "median", "MAX_POINTS": "300"}, ["--method", "median", "--max-points", "300"]),
        ({"DESPIKE": "no", "FIT": "no", "FLIPS": 0}, ["--no-despike", "--no-fit", "--flips", "0"]),
        ({"SCALES": "2px,1px", "METRIC": "max", "Z_FACTOR": 2.5},
         ["--scales", "2px,1px", "--metric", "max", "--z-factor", "2.5"]),
        ({"WEIGHT": 0.75, "CANDIDATE": "0.9", "POINTS_PER_SCALE": 100, "SCALES": "1px,0px"},
         ["--weight", "0.75", "--candidate", "0.9", "--points-per-scale", "100", "--scales", "1px,0px"]),
    ],
)  # fmt: skip
def test_options_mean_what_they_mean_to_the_command_line(run, command, tmp_path, options, flags):
    run("demtotin", INPUT=VOIDS, OBJ=tmp_path / "a.obj", **options)
    command(VOIDS, tmp_path / "b.obj", *flags)
    assert vertices_of_obj(tmp_path / "a.obj") == vertices_of_obj(tmp_path / "b.obj")


def test_y_up(run, command, tmp_path):
    run("demtotin", INPUT=VOIDS, MAX_POINTS="100", Y_UP=True, OBJ=tmp_path / "a.obj")
    command(VOIDS, tmp_path / "b.obj", "--max-points", "100", "--y-up")
    assert vertices_of_obj(tmp_path / "a.obj") == vertices_of_obj(tmp_path / "b.obj")


def test_extent_is_that_of_a_cut_dem(run, command, tmp_path):
    _, dataset = read_raster(USGS)
    x, dx, _, y, _, dy = dataset.GetGeoTransform()
    gdal.Translate(str(tmp_path / "cut.tif"), dataset, srcWin=[100, 120, 90, 70])
    extent = f"{x + 100 * dx},{x + 190 * dx},{y + 190 * dy},{y + 120 * dy} [EPSG:32616]"
    run("demtotin", INPUT=USGS, EXTENT=extent, MAX_POINTS="200", OBJ=tmp_path / "a.obj")
    command(tmp_path / "cut.tif", tmp_path / "b.obj", "--max-points", "200")
    assert vertices_of_obj(tmp_path / "a.obj") == vertices_of_obj(tmp_path / "b.obj")


def test_mask_in_another_crs(run, tmp_path):
    dem = make_dem(tmp_path / "d.tif")
    square = QgsGeometry.fromWkt(
        "POLYGON((500300 5098500, 501500 5098500, 501500 5099700, 500300 5099700, 500300 5098500))"
    )
    mask = vector("EPSG:32610", square.asWkt())
    results = run("demtotin", INPUT=dem, MASK=mask, RASTER=tmp_path / "r.tif")
    heights, _ = read_raster(tmp_path / "r.tif")
    row, col = np.nonzero(~np.isnan(heights))
    x, y = 500000 + 30 * (col + 0.5), 5100000 - 30 * (row + 0.5)
    assert (x.min(), x.max(), y.min(), y.max()) == (500315, 501485, 5098515, 5099685)
    to_degrees = QgsCoordinateTransform(
        QgsCoordinateReferenceSystem("EPSG:32610"),
        QgsCoordinateReferenceSystem("EPSG:4326"),
        QgsProject.instance(),
    )
    square.transform(to_degrees)
    again = run("demtotin", INPUT=dem, MASK=vector("EPSG:4326", square.asWkt()), RASTER=tmp_path / "r2.tif")
    assert again["POINTS"] == results["POINTS"]


def test_points_become_vertices(run, tmp_path):
    dem = make_dem(tmp_path / "d.tif")
    places = [(500000 + 30 * (c + 0.5), 5100000 - 30 * (r + 0.5)) for c, r in ((3, 5), (44, 51), (70, 12))]
    points = vector("EPSG:32610", *(QgsGeometry.fromPointXY(QgsPointXY(*place)).asWkt() for place in places))
    run("demtotin", INPUT=dem, POINTS=points, MAX_POINTS="60", OUTPUT=tmp_path / "t.gpkg")
    rings, _, _ = read_polygons(tmp_path / "t.gpkg")
    corners = {tuple(corner[:2]) for corner in rings.reshape(-1, 3).tolist()}
    assert set(places) <= corners


def test_crs_and_nodata_of_the_layer_win_over_the_file(run, tmp_path):
    layer = QgsRasterLayer(str(make_dem(tmp_path / "d.tif")), "my dem")
    layer.setCrs(QgsCoordinateReferenceSystem("EPSG:32612"))
    layer.dataProvider().setUserNoDataValue(1, [QgsRasterRange(-1000, 450)])
    run("demtotin", INPUT=layer, OUTPUT=tmp_path / "t.gpkg", RASTER=tmp_path / "r.tif", MAX_POINTS="400")
    _, _, crs = read_polygons(tmp_path / "t.gpkg")
    assert crs.authid() == "EPSG:32612"
    heights, dataset = read_raster(tmp_path / "r.tif")
    assert dataset.GetSpatialRef().GetAuthorityCode(None) == "32612"
    source, _ = read_raster(tmp_path / "d.tif")
    assert np.isnan(heights[source < 450]).mean() > 0.95


def test_without_georeference_where_qgis_draws_it(run, tmp_path):
    dem = make_dem(tmp_path / "d.tif", transform=None, crs=None)
    run("demtotin", INPUT=dem, OUTPUT=tmp_path / "t.gpkg", MESH=tmp_path / "t.nc")
    extent = QgsRasterLayer(str(dem), "x").extent()
    rings, _, _ = read_polygons(tmp_path / "t.gpkg")
    assert rings[..., 0].min() == extent.xMinimum() + 0.5
    assert rings[..., 1].max() == extent.yMaximum() - 0.5


@pytest.mark.parametrize("suffix", [".shp", ".geojson", ".fgb"])
def test_polygons_in_other_formats_come_back(run, tmp_path, suffix):
    crs = "EPSG:4326" if suffix == ".geojson" else "EPSG:32610"
    place = (-120, 0.0003, 0, 40, 0, -0.0003) if crs == "EPSG:4326" else (500000, 30, 0, 5100000, 0, -30)
    dem = make_dem(tmp_path / "d.tif", crs=crs, transform=place)
    made = run("demtotin", INPUT=dem, OUTPUT=tmp_path / f"t{suffix}", MAX_POINTS="200")
    error = run("tinerror", TIN=tmp_path / f"t{suffix}", INPUT=dem)
    assert error["RMSE"] == pytest.approx(made["RMSE"], rel=1e-4)


def test_tin_to_raster_with_a_pixel_size(run, tmp_path):
    run("demtotin", INPUT=VOIDS, OUTPUT=tmp_path / "t.gpkg", MAX_POINTS="500")
    run("tintoraster", TIN=tmp_path / "t.gpkg", PIXEL_SIZE=100, OUTPUT=tmp_path / "r.tif")
    heights, dataset = read_raster(tmp_path / "r.tif")
    x, dx, _, y, _, dy = dataset.GetGeoTransform()
    assert (dx, dy) == (100, -100)
    assert x % 100 == y % 100 == 0
    rings, _, _ = read_polygons(tmp_path / "t.gpkg")
    assert rings[..., 2].min() <= np.nanmin(heights) <= np.nanmax(heights) <= rings[..., 2].max()
    run("tintoraster", TIN=tmp_path / "t.gpkg", PIXEL_SIZE=100, OUTPUT=tmp_path / "s.tif",
        EXTENT=f"{x + 1000},{x + 3000},{y - 4000},{y - 2000} [EPSG:32610]")  # fmt: skip
    part, _ = read_raster(tmp_path / "s.tif")
    assert np.array_equal(part, heights[20:40, 10:30], equal_nan=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"crs": "EPSG:4326", "transform": (-120, 0.001, 0, 40, 0, -0.001)}, "degrees"),
        ({"crs": "EPSG:32610", "unit": "ft"}, "z factor"),
        ({"crs": "EPSG:2225", "unit": "US survey foot"}, "most 3D programs"),
        ({"crs": "EPSG:32610", "unit": "m"}, ""),
    ],
)
def test_3d_outputs_warn_of_units(run, tmp_path, options, words):
    said = Feedback()
    dem = make_dem(tmp_path / "d.tif", **options)
    run("demtotin", feedback=said, INPUT=dem, OBJ=tmp_path / "t.obj")
    assert len(said.warnings) == (1 if words else 0)
    assert words in "".join(said.warnings)
    said = Feedback()
    run("demtotin", feedback=said, INPUT=dem, OUTPUT="memory:")
    assert said.warnings == []


def test_in_a_model(app, provider, tmp_path):
    model = QgsProcessingModelAlgorithm("tin", "tests")
    model.addModelParameter(
        QgsProcessingParameterRasterLayer("dem", "dem"), QgsProcessingModelParameter("dem")
    )
    Source = QgsProcessingModelChildParameterSource
    first = QgsProcessingModelChildAlgorithm("dem2tin:demtotin")
    first.setChildId("first")
    first.addParameterSources("INPUT", [Source.fromModelParameter("dem")])
    first.addParameterSources("MAX_POINTS", [Source.fromStaticValue("300")])
    second = QgsProcessingModelChildAlgorithm("dem2tin:tintoraster")
    second.setChildId("second")
    second.addParameterSources("TIN", [Source.fromChildOutput("first", "OUTPUT")])
    # A number of the first step decides a setting of the second.
    second.addParameterSources("PIXEL_SIZE", [Source.fromExpression("@first_POINTS / 3")])
    grid = QgsProcessingModelOutput("raster", "raster")
    grid.setChildId("second")
    grid.setChildOutputName("OUTPUT")
    second.setModelOutputs({"raster": grid})
    for child in (first, second):
        assert child.algorithm() is not None
        model.addChildAlgorithm(child)
    import processing

    results = processing.run(model, {"dem": str(VOIDS), "second:raster": str(tmp_path / "r.tif")})
    _, dataset = read_raster(results["second:raster"])
    assert dataset.GetGeoTransform()[1] == 100
