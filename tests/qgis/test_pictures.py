"""What the user sees: the dialog, and results as QGIS opens them. The pictures are those of docs/qgis.md."""

import os
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from osgeo import gdal, ogr
from qgis.core import (
    QgsFeature,
    QgsFillSymbol,
    QgsGeometry,
    QgsLayerTreeModel,
    QgsLineSymbol,
    QgsPointXY,
    QgsProcessingContext,
    QgsProcessingOutputLayerDefinition,
    QgsRasterLayer,
    QgsSingleSymbolRenderer,
    QgsVectorLayer,
    QgsWkbTypes,
)
from qgis.gui import QgsBrowserGuiModel, QgsLayerTreeView, QgsMapCanvas, QgsMessageBar
from qgis.PyQt.QtCore import QEvent
from qgis.PyQt.QtGui import QColor, QImage
from qgis.PyQt.QtWidgets import QMainWindow, QSplitter
from support import USGS, Feedback, read_raster

FOLDER = Path(os.environ.get("QGIS_PICTURES", "out/qgis"))


def keep(picture, name):
    """Save a picture, which must show something: many colours, none of which fills it."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    target = FOLDER / f"{name}.png"
    image = picture.toImage().convertToFormat(QImage.Format_RGB32)
    bits = image.bits()
    bits.setsize(image.sizeInBytes())
    pixels = np.frombuffer(bits, np.uint32)
    pixels &= 0xFFF8F8F8  # nobody sees the difference, and the files are half as large
    assert image.save(str(target), "PNG", 0)
    assert target.stat().st_size < 300_000
    _, counts = np.unique(pixels, return_counts=True)
    assert len(counts) > 50
    assert counts.max() < 0.8 * counts.sum()


class Interface:
    """As much of QGIS's main window as the Processing dialogs ask for."""

    def __init__(self, layer):
        self.window, self.canvas, self.layer = QMainWindow(), QgsMapCanvas(), layer
        self.bar, self.browser = QgsMessageBar(), QgsBrowserGuiModel()

    def mainWindow(self):
        return self.window

    def mapCanvas(self):
        return self.canvas

    def activeLayer(self):
        return self.layer

    def messageBar(self):
        return self.bar

    def browserModel(self):
        return self.browser

    def __getattr__(self, name):
        return MagicMock()


@pytest.fixture
def dem(project):
    layer = QgsRasterLayer(str(USGS), "jacksboro")
    project.addMapLayer(layer)
    project.setCrs(layer.crs())
    return layer


@pytest.fixture
def interface(provider, dem, monkeypatch):
    import qgis.utils
    from processing.gui import AlgorithmDialog, BatchAlgorithmDialog  # noqa: F401

    made = Interface(dem)
    monkeypatch.setattr(qgis.utils, "iface", made)
    for name, module in list(sys.modules.items()):
        if name.startswith("processing") and hasattr(module, "iface"):
            monkeypatch.setattr(module, "iface", made)
    yield made
    made.window.close()


def shown(app, window, size):
    window.resize(*size)
    window.show()
    for _ in range(20):
        app.processEvents()
    return window.grab()


def test_dialog(app, provider, interface):
    from processing.gui.AlgorithmDialog import AlgorithmDialog

    dialog = AlgorithmDialog(provider.algorithm("demtotin").create(), False, interface.window)
    keep(shown(app, dialog, (900, 760)), "qgis-dialog")
    dialog.close()


def test_batch(app, provider, interface):
    from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog

    dialog = BatchAlgorithmDialog(provider.algorithm("demtotin").create(), interface.window)
    keep(shown(app, dialog, (1000, 420)), "qgis-batch")
    dialog.close()


def load(project, provider, name, parameters):
    """Run and open the results as the dialog does."""
    from processing.gui.Postprocessing import handleAlgorithmResults

    context, feedback = QgsProcessingContext(), Feedback()
    context.setProject(project)
    algorithm = provider.algorithm(name).create()
    for key, value in parameters.items():
        definition = algorithm.parameterDefinition(key)
        if definition.isDestination() and definition.type() != "fileDestination":
            parameters[key] = made = QgsProcessingOutputLayerDefinition(value, project)
            made.destinationName = definition.description()
    results, ok = algorithm.run(parameters, context, feedback)
    assert ok, feedback.infos
    assert handleAlgorithmResults(algorithm, context, feedback)
    return results


def window(app, project, layers, extent=None):
    """The layer tree beside the map, with only ``layers`` switched on."""
    tree = project.layerTreeRoot()
    for node in tree.findLayers():
        node.setItemVisibilityChecked(node.layer() in layers)
        node.setExpanded(node.layer() in layers)
    view, canvas, whole = QgsLayerTreeView(), QgsMapCanvas(), QSplitter()
    model = QgsLayerTreeModel(tree)
    view.setModel(model)
    canvas.setCanvasColor(QColor("white"))
    canvas.setLayers(layers)
    canvas.setDestinationCrs(project.crs())
    for part in (view, canvas):
        whole.addWidget(part)
    whole.setSizes([270, 560])
    whole.resize(830, 520)
    whole.show()
    app.processEvents()
    canvas.setExtent(extent or layers[0].extent())
    canvas.waitWhileRendering()
    for _ in range(20):
        app.processEvents()
    canvas.refresh()
    canvas.waitWhileRendering()
    app.processEvents()
    picture = whole.grab()
    whole.close()
    whole.deleteLater()
    app.sendPostedEvents(None, QEvent.DeferredDelete)
    return picture


def layer_named(project, name):
    (layer,) = project.mapLayersByName(name)
    return layer


def test_results_open_styled_and_in_place(app, project, provider, dem, tmp_path):
    results = load(
        project,
        provider,
        "demtotin",
        {
            "INPUT": dem.id(),
            "MAX_POINTS": "3000",
            "OUTPUT": "TEMPORARY_OUTPUT",
            "MESH": str(tmp_path / "t.nc"),
            "RASTER": "TEMPORARY_OUTPUT",
            "ERROR": "TEMPORARY_OUTPUT",
        },
    )
    tin = layer_named(project, "TIN of jacksboro")
    assert tin.featureCount() == results["TRIANGLES"]
    assert tin.renderer().type() == "graduatedSymbol"
    ranges = tin.renderer().ranges()
    low, high = (
        tin.minimumValue(tin.fields().indexOf("z_mean")),
        tin.maximumValue(tin.fields().indexOf("z_mean")),
    )
    assert ranges[0].lowerValue() <= low
    assert ranges[-1].upperValue() >= high
    assert tin.crs() == dem.crs()
    assert dem.extent().contains(tin.extent())
    mesh, errors, heights = (
        layer_named(project, f"TIN of jacksboro ({kind})") for kind in ("mesh", "errors", "raster")
    )
    assert mesh.crs() == dem.crs()
    assert mesh.rendererSettings().nativeMeshSettings().isEnabled()
    for layer in (errors, heights):
        assert layer.renderer().type() == "singlebandpseudocolor"
        assert layer.extent() == dem.extent()

    part = tin.extent()
    part.scale(0.35)
    keep(window(app, project, [tin], part), "qgis-tin")
    keep(window(app, project, [mesh]), "qgis-mesh")
    keep(window(app, project, [errors], part), "qgis-errors")


def ridge_and_lake(z, transform):
    """A ridge, followed from row to row, and what water at 300 m would cover to the east."""
    x, dx, _, y, _, dy = transform
    rows, col, ridge = range(330, 235, -5), 178, []
    for row in rows:
        col += z[row, col - 6 : col + 7].argmax() - 6
        ridge.append(QgsPointXY(x + (col + 0.5) * dx, y + (row + 0.5) * dy))
    ridge = QgsGeometry.fromPolylineXY(ridge)
    low = np.zeros(z.shape, np.uint8)
    low[215:335, 215:300] = z[215:335, 215:300] < 300
    raster = gdal.GetDriverByName("MEM").Create("", low.shape[1], low.shape[0], 1, gdal.GDT_Byte)
    raster.SetGeoTransform(transform)
    raster.GetRasterBand(1).WriteRaster(0, 0, low.shape[1], low.shape[0], low.tobytes())
    memory = ogr.GetDriverByName("Memory").CreateDataSource("")
    shapes = memory.CreateLayer("low", None, ogr.wkbPolygon)
    gdal.Polygonize(raster.GetRasterBand(1), raster.GetRasterBand(1), shapes, -1)
    largest = max((feature.geometry().Clone() for feature in shapes), key=lambda shape: shape.Area())
    lake = QgsGeometry.fromWkt(largest.ExportToWkt()).simplify(60)
    return ridge, lake


def drawn(project, name, geometry, symbol):
    kind = QgsWkbTypes.displayString(geometry.wkbType())
    layer = QgsVectorLayer(f"{kind}?crs={project.crs().authid()}", name, "memory")
    feature = QgsFeature()
    feature.setGeometry(geometry)
    assert layer.dataProvider().addFeature(feature)
    layer.setRenderer(QgsSingleSymbolRenderer(symbol))
    project.addMapLayer(layer)
    return layer


def test_breaklines_and_lakes(app, project, provider, dem):
    z, dataset = read_raster(USGS)
    ridge, lake = ridge_and_lake(z, dataset.GetGeoTransform())
    line = QgsLineSymbol.createSimple({"line_color": "#d7191c", "line_width": "0.7"})
    water = {"color": "90,150,220,70", "outline_color": "#1f5fa8", "outline_width": "0.5"}
    ridge = drawn(project, "ridge", ridge, line)
    lake = drawn(project, "lake", lake, QgsFillSymbol.createSimple(water))
    given = {"BREAKLINES": ridge.id(), "FLAT": lake.id(), "OUTPUT": "TEMPORARY_OUTPUT"}
    load(project, provider, "demtotin", {"INPUT": dem.id(), "MAX_POINTS": "4000", **given})
    tin = layer_named(project, "TIN of jacksboro")
    level = [f["slope"] for f in tin.getFeatures() if next(lake.getFeatures()).geometry().contains(
        f.geometry().centroid())]  # fmt: skip
    assert len(level) > 20
    assert np.mean(np.array(level) == 0) > 0.9
    part = ridge.extent()
    part.combineExtentWith(lake.extent())
    part.scale(1.05)
    keep(window(app, project, [ridge, lake, tin], part), "qgis-constraints")


def test_report(app, run, tmp_path):
    from qgis.PyQt.QtGui import QTextDocument

    run("demtotin", INPUT=USGS, MAX_POINTS="3000", REPORT=tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count("<rect") == 40
    document = QTextDocument()
    document.setHtml(text)
    assert "3,000" in document.toPlainText()


def test_style_by_hand(app, run, tmp_path):
    """The style file alone makes something sensible of a TIN, too."""
    from dem2tin.styling import TIN_STYLE
    from qgis.core import QgsVectorLayer

    run("demtotin", INPUT=USGS, MAX_POINTS="100", OUTPUT=tmp_path / "t.gpkg")
    layer = QgsVectorLayer(str(tmp_path / "t.gpkg"), "t", "ogr")
    _, ok = layer.loadNamedStyle(TIN_STYLE)
    assert ok
    assert len(layer.renderer().ranges()) == 15
