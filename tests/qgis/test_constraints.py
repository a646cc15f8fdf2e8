"""Breaklines, spot heights, clip polygons and lakes: against the core's own results, and hostile layers."""

import json
import re

import numpy as np
import pytest
from osgeo import gdal, ogr, osr
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsCoordinateTransformContext,
    QgsFeature,
    QgsFeatureRequest,
    QgsGeometry,
    QgsPoint,
    QgsPointXY,
    QgsProcessingAlgRunnerTask,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSourceDefinition,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QEventLoop
from support import Feedback, make_dem, read_polygons, vertices_of_obj
from test_results import vector

NAN = float("nan")
LATTICE = 30 / 256  # metres
BREAKLINE = np.array([(500200.0, 5099700, 600), (500800, 5099500, 640), (501300, 5099650, 610)])
LAKE = np.array([(501500.0, 5098700), (501900, 5098650), (502000, 5099100), (501600, 5099200)])
ISLAND = np.array([(501700.0, 5098850), (501800, 5098900), (501700, 5098950)])
POND = np.array([(500405.0, 5098602, 480), (500707, 5098621, 480), (500603, 5098809, 480)])
CLIP = np.array([(500100.0, 5098300), (502300, 5098400), (502200, 5099900), (500150, 5099850)])
SPOTS = np.array([(500333.0, 5099111, 555), (501234, 5099444, NAN), (502100, 5099000, 512)])


def text(name, *paths):
    """WKT of a point, a line or a polygon."""
    z = " Z" if paths[0].shape[1] == 3 else ""
    rings = ["(" + ", ".join(" ".join(map(repr, v)) for v in path.tolist()) + ")" for path in paths]
    return f"{name}{z} ({', '.join(rings)})" if name == "Polygon" else f"{name}{z} {rings[0]}"


def spots(*places):
    """A layer of points with heights, NaN for none: SPOTS unless others are given."""
    layer = QgsVectorLayer("PointZ?crs=EPSG:32610", "spots", "memory")
    for place in places or SPOTS:
        feature = QgsFeature()
        feature.setGeometry(QgsPoint(*place.tolist()))
        assert layer.dataProvider().addFeature(feature)
    return layer


def ring(path):
    return np.concatenate([path, path[:1]])


def moved(path, source, target):
    """x and y in another CRS, vertex by vertex."""
    transform = QgsCoordinateTransform(
        QgsCoordinateReferenceSystem(source),
        QgsCoordinateReferenceSystem(target),
        QgsCoordinateTransformContext(),
    )
    made = path.copy()
    for vertex in made:
        place = transform.transform(QgsPointXY(*vertex[:2]))
        vertex[:2] = place.x(), place.y()
    return made


def read(path):
    import tin

    return tin.DEM.from_gdal(gdal.Open(str(path)))


def same(rings, mesh):
    assert np.array_equal(rings[:, :3], mesh.vertices[mesh.triangles])


def edges_along(rings, masks, start, end):
    """Length of the constrained edges on the segment."""
    along = (end - start)[:2] / np.hypot(*(end - start)[:2])
    length = np.hypot(*(end - start)[:2])
    found = {}
    for corners, mask in zip(rings, masks):
        for k in range(3):
            edge = corners[[k, k + 1], :2] - start[:2]
            place, off = edge @ along, np.abs(edge @ [-along[1], along[0]])
            is_on = off.max() < 2 * LATTICE and place.min() > -0.2 and place.max() < length + 0.2
            if (mask or 0) >> k & 1 and is_on:
                found[tuple(np.sort(np.round(place, 1)))] = abs(place[1] - place[0])
    return sum(found.values())


def inside(polygon, places):
    shape = QgsGeometry.fromWkt(text("Polygon", *polygon))
    return np.array([shape.contains(QgsPointXY(*place)) for place in places])


def masks_of(rows, path):
    layer = QgsVectorLayer(str(path), "x", "ogr")
    names = [field.name() for field in layer.fields()]
    column = names.index("constraints") - names.index("v0")
    return [row[column] for row in rows]


@pytest.fixture
def dem(app, tmp_path):
    return make_dem(tmp_path / "d.tif")


def test_everything_at_once(run, dem, tmp_path):
    in_degrees = moved(BREAKLINE, "EPSG:32610", "EPSG:4326")
    said = Feedback()
    results = run(
        "demtotin",
        feedback=said,
        INPUT=dem,
        MAX_POINTS="400",
        BREAKLINES=vector("EPSG:4326", text("LineString", in_degrees)),
        POINTS=spots(),
        CLIP=vector("EPSG:32610", text("Polygon", ring(CLIP))),
        FLAT=vector("EPSG:32610", text("Polygon", ring(LAKE), ring(ISLAND))),
        OUTPUT=tmp_path / "t.gpkg",
    )
    assert said.warnings == []
    rings, rows, _ = read_polygons(tmp_path / "t.gpkg")
    masks = masks_of(rows, tmp_path / "t.gpkg")

    import tin

    back = moved(in_degrees, "EPSG:4326", "EPSG:32610")
    mesh = tin.triangulate(
        read(dem),
        max_points=400,
        breaklines=[back],
        points=SPOTS,
        clip=[[CLIP]],
        flat=[[LAKE, ISLAND]],
    )
    same(rings, mesh)
    assert results["POINTS"] == len(mesh.vertices)

    middles = rings[:, :3, :2].mean(axis=1)
    on_lake = inside([ring(LAKE), ring(ISLAND)], middles)
    assert on_lake.sum() > 4
    assert np.ptp(rings[on_lake, :, 2]) == 0
    on_island = inside([ring(ISLAND)], middles)
    assert on_island.any()
    corners = rings[:, :3].reshape(-1, 3)
    grown = QgsGeometry.fromWkt(text("Polygon", ring(CLIP))).buffer(2 * LATTICE, 2)
    assert all(grown.contains(QgsPointXY(x, y)) for x, y, _ in corners.tolist())
    for x, y, z in BREAKLINE[:3].tolist():
        near = np.hypot(corners[:, 0] - x, corners[:, 1] - y) < LATTICE
        assert near.any()
        assert set(corners[near, 2]) == {z}
    for start, end in zip(BREAKLINE, BREAKLINE[1:]):
        assert edges_along(rings, masks, start, end) == pytest.approx(np.hypot(*(end - start)[:2]), abs=1)
    for x, y, z in SPOTS[[0, 2]].tolist():
        near = np.hypot(corners[:, 0] - x, corners[:, 1] - y) < LATTICE
        assert set(corners[near, 2]) == {z}


def test_a_level_of_its_own(run, dem, tmp_path):
    run("demtotin", INPUT=dem, MAX_POINTS="200", OUTPUT=tmp_path / "t.gpkg",
        FLAT=vector("EPSG:32610", text("Polygon", ring(POND))))  # fmt: skip
    rings, _, _ = read_polygons(tmp_path / "t.gpkg")
    on_pond = inside([ring(POND[:, :2])], rings[:, :3, :2].mean(axis=1))
    assert on_pond.any()
    assert (rings[on_pond, :, 2] == 480).all()


def test_soft_takes_the_heights_of_the_dem(run, dem, tmp_path):
    import tin

    layers = {
        "BREAKLINES": vector("EPSG:32610", text("LineString", BREAKLINE)),
        "POINTS": spots(),
    }
    found = {}
    for soft in (False, True):
        path = tmp_path / f"{soft}.gpkg"
        run("demtotin", INPUT=dem, MAX_POINTS="200", SOFT=soft, OUTPUT=path, **layers)
        found[soft], _, _ = read_polygons(path)
        given = {"breaklines": [BREAKLINE], "points": SPOTS}
        same(found[soft], tin.triangulate(read(dem), max_points=200, soft=soft, **given))
    assert 640 in found[False][..., 2]
    assert 640 not in found[True][..., 2]


def write(path, *wkts, epsg=32610):
    """A GeoPackage of any geometries."""
    reference = osr.SpatialReference()
    reference.ImportFromEPSG(epsg)
    reference.SetAxisMappingStrategy(osr.OAMS_TRADITIONAL_GIS_ORDER)
    dataset = ogr.GetDriverByName("GPKG").CreateDataSource(str(path))
    layer = dataset.CreateLayer(path.stem, reference, ogr.wkbUnknown)
    for wkt in wkts:
        feature = ogr.Feature(layer.GetLayerDefn())
        feature.SetGeometry(None if wkt is None else ogr.CreateGeometryFromWkt(wkt))
        layer.CreateFeature(feature)
    return path


def test_without_a_window_as_on_the_command_line(process, command, dem, tmp_path):
    files = {
        "breaklines": write(tmp_path / "lines.gpkg", text("LineString", BREAKLINE)),
        "points": write(tmp_path / "spots.gpkg", *(text("Point", spot[None]) for spot in SPOTS[[0, 2]])),
        "clip": write(tmp_path / "clip.gpkg", text("Polygon", ring(CLIP))),
        "flat": write(tmp_path / "lakes.gpkg", text("Polygon", ring(LAKE)), text("Polygon", ring(POND))),
    }
    settings = [f"--{name.upper()}={path}" for name, path in files.items()]
    made = process("run", "dem2tin:demtotin", f"--INPUT={dem}", *settings, "--OUTLINE_TOLERANCE=2px",
                   "--SIEVE=5", "--KEEP_ISOLATED=true", "--MAX_POINTS=300", "--OBJ=a.obj")  # fmt: skip
    assert made.returncode == 0, made.stderr
    flags = [word for name, path in files.items() for word in (f"--{name}", path)]
    numbers = json.loads(
        command(dem, tmp_path / "b.obj", *flags, "--outline-tolerance", "2px", "--sieve", "5",
                "--keep-isolated", "--max-points", "300", "--json", "-")
    )  # fmt: skip
    assert int(re.search(r"^POINTS:\s+(\d+)", made.stdout, re.MULTILINE)[1]) == numbers["points"]
    assert vertices_of_obj(tmp_path / "a.obj") == vertices_of_obj(tmp_path / "b.obj")

    wrong = process("run", "dem2tin:demtotin", f"--INPUT={dem}", f"--CLIP={files['points']}", "--OBJ=c.obj")
    assert wrong.returncode == 1
    assert "holds points, where polygons are needed" in wrong.stdout + wrong.stderr
    assert not (tmp_path / "c.obj").exists()


def test_only_the_selected_features(run, project, dem, tmp_path):
    layer = vector("EPSG:32610", text("Polygon", ring(LAKE)), text("Polygon", ring(POND[:, :2])))
    project.addMapLayer(layer)
    (number,) = [f.id() for f in layer.getFeatures() if f.geometry().boundingBox().xMaximum() > 501000]
    layer.selectByIds([number])
    chosen = QgsProcessingFeatureSourceDefinition(layer.id(), True)
    run("demtotin", INPUT=dem, MAX_POINTS="200", FLAT=chosen, OUTPUT=tmp_path / "t.gpkg")
    import tin

    rings, _, _ = read_polygons(tmp_path / "t.gpkg")
    same(rings, tin.triangulate(read(dem), max_points=200, flat=[[LAKE]]))


def test_empty_layers(run, dem, tmp_path):
    kinds = {"BREAKLINES": "LineStringZ", "POINTS": "Point", "FLAT": "Polygon"}
    empty = {name: QgsVectorLayer(f"{k}?crs=EPSG:32610", "x", "memory") for name, k in kinds.items()}
    run("demtotin", INPUT=dem, MAX_POINTS="200", OUTPUT=tmp_path / "a.gpkg")
    said = Feedback()
    run("demtotin", feedback=said, INPUT=dem, MAX_POINTS="200", OUTPUT=tmp_path / "b.gpkg", **empty)
    assert np.array_equal(read_polygons(tmp_path / "a.gpkg")[0], read_polygons(tmp_path / "b.gpkg")[0])
    assert len(said.warnings) == 3
    assert all("there are no" in warning for warning in said.warnings)
    with pytest.raises(QgsProcessingException, match="nothing of the DEM lies inside the clip polygons"):
        run("demtotin", INPUT=dem, CLIP=empty["FLAT"], OUTPUT="memory:")


WRONG = {
    "BREAKLINES": ["Point"],
    "POINTS": ["LineString", "Polygon"],
    "CLIP": ["Point", "LineString"],
    "FLAT": ["Point", "LineString"],
}


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name in WRONG for kind in WRONG[name]])
def test_wrong_geometries_are_one_clear_message(run, dem, name, kind):
    path = {"Point": SPOTS[:1, :2], "LineString": CLIP, "Polygon": ring(CLIP)}[kind]
    layer = vector("EPSG:32610", text(kind, path))
    with pytest.raises(QgsProcessingException, match=f"{name.lower()}: 'shapes' holds .*s, where .* needed"):
        run("demtotin", INPUT=dem, OUTPUT="memory:", **{name: layer})


def test_layers_of_the_project_in_the_background(provider, project, dem, tmp_path):
    layer = vector("EPSG:4326", text("LineString", moved(BREAKLINE, "EPSG:32610", "EPSG:4326")))
    lakes = vector("EPSG:32610", text("Polygon", ring(POND)))
    project.addMapLayers([layer, lakes])
    context = QgsProcessingContext()
    context.setProject(project)
    given = {"INPUT": str(dem), "BREAKLINES": layer.id(), "FLAT": lakes.id(), "MAX_POINTS": "200"}
    parameters = {**given, "OBJ": str(tmp_path / "t.obj")}
    said, loop, ends = Feedback(), QEventLoop(), []
    task = QgsProcessingAlgRunnerTask(provider.algorithm("demtotin"), parameters, context, said)
    task.executed.connect(lambda ok, results: (ends.append((ok, results)), loop.quit()))
    QgsApplication.taskManager().addTask(task)
    loop.exec_()
    assert ends[0][0], said.infos
    assert ends[0][1]["POINTS"] == 200
    assert said.stages[:3] == ["Reading shapes", "Reading shapes", "Reading d"]


def test_layers_that_cannot_be_used(run, dem, tmp_path):
    with pytest.raises(QgsProcessingException, match=r"no-such\.gpkg"):
        run("demtotin", INPUT=dem, BREAKLINES=tmp_path / "no-such.gpkg", OUTPUT="memory:")
    site = QgsCoordinateReferenceSystem.fromWkt('LOCAL_CS["site grid",UNIT["foot",0.3048]]')
    layer = vector("EPSG:32610", text("LineString", BREAKLINE))
    layer.setCrs(site)
    with pytest.raises(QgsProcessingException, match="shapes: cannot be transformed"):
        run("demtotin", INPUT=dem, BREAKLINES=layer, OUTPUT="memory:")


def test_geometries_of_every_kind(run, dem, tmp_path):
    """Multi-parts, collections, curves, measures, nulls and crossings, under QGIS's strictest setting."""
    import processing

    x, y = 500400, 5099300
    lines = write(
        tmp_path / "lines.gpkg",
        None,
        "MULTILINESTRING ZM ((500200 5099700 600 1, 500800 5099500 640 2), "
        "(500900 5099700 5 3, 501000 5099600 6 4))",
        "GEOMETRYCOLLECTION (LINESTRING EMPTY, LINESTRING (501200 5099800, 501400 5099300))",
        f"COMPOUNDCURVE ((500200 {y}, {x} {y}), "
        f"CIRCULARSTRING ({x} {y}, {x + 100} {y + 100}, {x + 200} {y}))",
        text("Polygon", ring(POND)),
    )
    places = [(501500.0, 5098700), (501900, 5099100), (501900, 5098700), (501500, 5099100)]
    crossing = np.array([(*place, 470) for place in places])
    lakes = write(
        tmp_path / "lakes.gpkg",
        text("Polygon", ring(crossing)),
        f"MULTIPOLYGON (({text('Polygon', ring(POND[:, :2] + (0, -400)))[9:-1]}))",
    )
    context = QgsProcessingContext()
    context.setInvalidGeometryCheck(QgsFeatureRequest.GeometryAbortOnInvalid)
    said = Feedback()
    target = tmp_path / "t.gpkg"
    given = {"INPUT": str(dem), "BREAKLINES": str(lines), "FLAT": str(lakes), "MAX_POINTS": "300"}
    processing.run("dem2tin:demtotin", {**given, "OUTPUT": str(target)}, feedback=said, context=context)
    assert said.warnings == []
    rings, rows, _ = read_polygons(target)
    masks = masks_of(rows, target)
    corners = rings[:, :3].reshape(-1, 3)
    for place in ((500900, 5099700, 5), (501000, 5099600, 6), (500707, 5098621, 480)):
        near = np.hypot(corners[:, 0] - place[0], corners[:, 1] - place[1]) < LATTICE
        assert set(corners[near, 2]) == {place[2]}
    # The arc has its middle, and is no chord.
    assert (np.hypot(corners[:, 0] - x - 100, corners[:, 1] - y - 100) < LATTICE).any()
    assert edges_along(rings, masks, np.array((x, y)), np.array((x + 200, y))) < 20
    start, end = np.array((501200, 5099800)), np.array((501400, 5099300))
    assert edges_along(rings, masks, start, end) == pytest.approx(np.hypot(200, 500), abs=1)
    # Both halves of what crosses itself are level, at its height.
    middles = rings[:, :3, :2].mean(axis=1)
    for half in ([0, 4, 3], [1, 2, 4]):
        on_half = inside([ring(np.array([*crossing, (501700, 5098900, 470)])[half, :2])], middles)
        assert on_half.any()
        assert set(rings[on_half][..., 2].ravel()) == {470}


def test_warnings_are_pushed(run, dem, tmp_path):
    said = Feedback()
    flat_line = BREAKLINE * (1, 1, 0)
    outside = SPOTS + (1e6, 0, 0)
    nowhere = vector(
        "EPSG:4326", "Point (-123 95)", text("Point", moved(SPOTS[:1, :2], "EPSG:32610", "EPSG:4326"))
    )
    run("demtotin", feedback=said, INPUT=dem, OUTPUT="memory:", MAX_POINTS="200", POINTS=nowhere,
        BREAKLINES=vector("EPSG:32610", text("LineString", flat_line)))  # fmt: skip
    assert ["1 features have no place" in said.warnings[0], "all heights are 0" in said.warnings[1]] == [
        True
    ] * 2
    said = Feedback()
    points = spots(*SPOTS, *outside)
    run("demtotin", feedback=said, INPUT=dem, OUTPUT="memory:", MAX_POINTS="200", POINTS=points)
    assert said.warnings == ["points: 3 of 6 points lie outside the DEM"]
    dataset = gdal.Open(str(dem), gdal.GA_Update)
    dataset.GetRasterBand(1).DeleteNoDataValue()
    dataset = None
    said = Feedback()
    run("demtotin", feedback=said, INPUT=dem, OUTPUT="memory:", MAX_POINTS="200")
    assert len(said.warnings) == 1
    assert "if that means NoData" in said.warnings[0]
