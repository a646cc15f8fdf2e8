"""Cancelling, bad input, outputs that exist, a missing core."""

import builtins
import sys
import time

import pytest
from osgeo import gdal
from qgis.core import (
    QgsApplication,
    QgsProcessingAlgRunnerTask,
    QgsProcessingContext,
    QgsProcessingException,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QEventLoop, QTimer
from support import USGS, VOIDS, Feedback, make_dem

ALL = {
    "OUTPUT": "t.gpkg",
    "MESH": "t.nc",
    "OBJ": "t.obj",
    "RASTER": "t.tif",
    "ERROR": "e.tif",
    "REPORT": "r.html",
}
STAGES = ["Reading", "Outlining", "Removing", "Smoothing", "Refining", "Fitting", "Flipping"]
WRITING = ["Writing {}/t.nc", "Writing {}/t.tif", "Writing {}/e.tif", "Writing the triangles"]


def outputs(folder):
    return {name: folder / file for name, file in ALL.items()}


@pytest.fixture(params=[False, True], ids=["", "gdal-exceptions"])
def gdal_exceptions(request):
    """Any plugin may turn them on, for all."""
    (gdal.UseExceptions if request.param else gdal.DontUseExceptions)()
    yield
    gdal.DontUseExceptions()


@pytest.mark.usefixtures("gdal_exceptions")
@pytest.mark.parametrize("stage", STAGES + WRITING)
def test_cancel_leaves_nothing(run, tmp_path, stage):
    said = Feedback(cancel_at=stage.format(tmp_path))
    results = run("demtotin", feedback=said, INPUT=USGS, **outputs(tmp_path))
    assert said.stages[-1].startswith(said.cancel_at)
    assert list(tmp_path.iterdir()) == []
    assert "POINTS" not in results


@pytest.mark.parametrize("stage", ["Reading the", "Comparing", "Writing"])
def test_cancel_the_error_report(run, tmp_path, stage):
    tin = run("demtotin", INPUT=VOIDS, OUTPUT="memory:", MAX_POINTS="500")["OUTPUT"]
    said = Feedback(cancel_at=stage)
    folder = tmp_path / "out"
    folder.mkdir()
    run("tinerror", feedback=said, TIN=tin, INPUT=VOIDS, ERROR=folder / "e.tif", REPORT=folder / "r.html")
    assert said.isCanceled()
    assert list(folder.iterdir()) == []


def test_cancel_keeps_other_layers_of_a_geopackage(run, tmp_path):
    file = tmp_path / "t.gpkg"
    run("demtotin", INPUT=VOIDS, OUTPUT=file, MAX_POINTS="100")
    table = f"ogr:dbname='{file}' table=\"second\" (geom)"
    run("demtotin", feedback=Feedback(cancel_at="Writing the"), INPUT=VOIDS, OUTPUT=table)
    assert [layer.GetName() for layer in layers(file)] == ["t"]
    run("demtotin", INPUT=VOIDS, OUTPUT=table, MAX_POINTS="100")
    with pytest.raises(QgsProcessingException, match="exists already"):
        run("demtotin", INPUT=VOIDS, OUTPUT=table, MAX_POINTS="100")
    assert QgsVectorLayer(f"{file}|layername=second", "x", "ogr").featureCount() > 0


def layers(file):
    dataset = gdal.OpenEx(str(file), gdal.OF_VECTOR)
    layers.kept = dataset
    return [dataset.GetLayer(i) for i in range(dataset.GetLayerCount())]


def test_in_the_background_qgis_goes_on_and_cancel_is_prompt(provider, tmp_path):
    dem = make_dem(tmp_path / "big.tif", rows=3000, cols=3000)
    context, said = QgsProcessingContext(), Feedback()
    parameters = {"INPUT": str(dem), "MAX_POINTS": "5%", "MESH": str(tmp_path / "t.nc")}
    task = QgsProcessingAlgRunnerTask(provider.algorithm("demtotin"), parameters, context, said)
    loop, ticks, cancelled = QEventLoop(), [], []
    timer = QTimer()
    timer.timeout.connect(lambda: ticks.append(time.monotonic()))
    timer.start(10)

    def cancel():
        cancelled.append(time.monotonic())
        said.cancel()

    QTimer.singleShot(500, cancel)
    task.executed.connect(lambda *_: loop.quit())
    QgsApplication.taskManager().addTask(task)
    loop.exec_()
    assert time.monotonic() - cancelled[0] < 1.0
    assert max(later - earlier for earlier, later in zip(ticks, ticks[1:])) < 0.5
    assert len(said.stages) > 1
    assert [path.name for path in tmp_path.iterdir()] == ["big.tif"]


def test_files_that_exist_stay(run, tmp_path):
    for name, file in ALL.items():
        path = tmp_path / file
        path.write_text("mine")
        with pytest.raises(QgsProcessingException, match="exists already"):
            run("demtotin", INPUT=VOIDS, **{name: path})
        assert path.read_text() == "mine"
        path.unlink()
    assert list(tmp_path.iterdir()) == []


def test_files_are_replaced_when_asked(run, tmp_path):
    for count in ("100", "200"):
        results = run("demtotin", INPUT=VOIDS, MAX_POINTS=count, OVERWRITE=True, **outputs(tmp_path))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*ALL.values(), "t.prj"])
    layer = QgsVectorLayer(str(tmp_path / "t.gpkg"), "x", "ogr")
    assert layer.featureCount() == results["TRIANGLES"]


@pytest.mark.usefixtures("gdal_exceptions")
@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"MAX_POINTS": "3"}, "max-points"),
        ({"MAX_POINTS": "many"}, "max-points"),
        ({"TOLERANCE": -1}, "tolerance"),
        ({"METRIC": "2"}, "metric"),
        ({"SCALES": "1,x"}, "scales"),
        ({"BAND": 9}, "no band 9"),
        ({"Z_FACTOR": 0}, "factor of 0"),
        ({"EXTENT": "0,1,0,1 [EPSG:32610]"}, "no pixel"),
        ({"INPUT": "no-such.tif"}, "no-such.tif"),
        ({"INPUT": __file__}, "test_failures"),
    ],
)
def test_bad_input_is_one_clear_message(run, parameters, words):
    with pytest.raises(QgsProcessingException) as caught:
        run("demtotin", **{"INPUT": VOIDS, "OUTPUT": "memory:", **parameters})
    assert words in str(caught.value)
    assert "Traceback" not in str(caught.value)


def test_a_folder_that_is_not_there(run, tmp_path):
    with pytest.raises(QgsProcessingException, match="no directory"):
        run("demtotin", INPUT=VOIDS, MESH=tmp_path / "no" / "t.nc")


def test_nothing_but_voids(run, tmp_path):
    dem = make_dem(tmp_path / "d.tif", rows=20, cols=20)
    dataset = gdal.Open(str(dem), gdal.GA_Update)
    dataset.GetRasterBand(1).Fill(-9999)
    dataset.FlushCache()
    with pytest.raises(QgsProcessingException, match="all-nodata"):
        run("demtotin", INPUT=dem, OUTPUT="memory:")


@pytest.mark.parametrize(
    ("wkt", "words"),
    [
        ("POLYGON((0 0, 9 0, 0 9, 0 0))", "heights"),
        ("POLYGONZ((0 0 1, 9 0 1, 9 9 1, 0 9 1, 0 0 1))", "triangles"),
        ("POLYGONZ((0 0 1, 9 0 1, 9 9 1, 0 0 1))", "no valid pixel"),
        (None, "no triangles"),
    ],
)
def test_what_is_no_tin_is_refused(run, wkt, words):
    from test_results import vector

    layer = vector("EPSG:32610", wkt) if wkt else QgsVectorLayer("PolygonZ?crs=EPSG:32610", "x", "memory")
    with pytest.raises(QgsProcessingException, match=words):
        run("tinerror", TIN=layer, INPUT=VOIDS)


def test_tin_to_raster_needs_a_grid(run, tmp_path):
    tin = run("demtotin", INPUT=VOIDS, OUTPUT="memory:", MAX_POINTS="100")["OUTPUT"]
    for parameters in ({}, {"PIXEL_SIZE": 0}, {"PIXEL_SIZE": 1e-9}):
        with pytest.raises(QgsProcessingException, match="pixel size"):
            run("tintoraster", TIN=tin, OUTPUT=tmp_path / "r.tif", **parameters)


@pytest.fixture(params=["missing", "old"])
def broken_core(request, monkeypatch):
    import tin

    if request.param == "old":
        monkeypatch.setattr(tin, "__version__", "0.0.9")
        return "0.0.9 is too old"
    for name in [name for name in sys.modules if name == "tin" or name.startswith("tin.")]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def refuse(name, *rest):
        if name == "tin":
            raise ImportError("No module named 'tin'")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    return "No module named 'tin'"


@pytest.mark.parametrize("name", ["demtotin", "tinerror", "tintoraster"])
def test_missing_core_says_what_to_do(provider, broken_core, name):
    algorithm = provider.algorithm(name).create()
    can, reason = algorithm.canExecute()
    assert not can
    assert "pip install" in reason
    assert broken_core in reason
    assert "pip install" in algorithm.shortHelpString()
    with pytest.raises(QgsProcessingException, match="pip install"):
        algorithm.processAlgorithm({}, QgsProcessingContext(), Feedback())


@pytest.mark.parametrize(
    ("platform", "environment", "words"),
    [
        ("win32", {}, "OSGeo4W Shell"),
        ("darwin", {}, "bin/python3"),
        ("linux", {"FLATPAK_ID": "org.qgis.qgis"}, "flatpak run"),
        ("linux", {}, "--user"),
    ],
)
def test_advice_for_every_system(app, monkeypatch, platform, environment, words):
    from dem2tin import core

    monkeypatch.setattr(sys, "platform", platform)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    where, command = core._advice()
    assert words in where + command
    assert "--no-deps" in command
