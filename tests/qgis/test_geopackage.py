"""The bulk-filled GeoPackage is one that SQLite, GDAL and QGIS take for their own."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
from dem2tin import geopackage
from qgis.core import QgsFeatureRequest, QgsRectangle, QgsVectorLayer, edit
from support import VOIDS


@pytest.fixture(params=["4", "60", "2000", "10%"])
def file(run, tmp_path, request):
    """GeoPackages whose R-trees are of one level and of more."""
    path = tmp_path / 'a "name" .gpkg'
    run("demtotin", INPUT=VOIDS, MAX_POINTS=request.param, OUTPUT=path)
    return path


def test_index_is_sound(file):
    with closing(sqlite3.connect(file)) as database:
        (table,) = database.execute("SELECT table_name FROM gpkg_contents").fetchone()
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert database.execute("SELECT rtreecheck(?)", (f"rtree_{table}_geom",)).fetchone() == ("ok",)
        (count,) = database.execute("SELECT feature_count FROM gpkg_ogr_contents").fetchone()
        (triggers,) = database.execute("SELECT count(*) FROM sqlite_master WHERE type = 'trigger'").fetchone()
    assert count == QgsVectorLayer(str(file), "x", "ogr").featureCount()
    assert triggers >= 8


def test_index_finds_what_a_search_through_all_finds(file):
    layer = QgsVectorLayer(str(file), "x", "ogr")
    assert layer.hasSpatialIndex()
    extent, everything = layer.extent(), list(layer.getFeatures())
    random = np.random.default_rng(2)
    for _ in range(20):
        x = random.uniform(extent.xMinimum(), extent.xMaximum())
        y = random.uniform(extent.yMinimum(), extent.yMaximum())
        box = QgsRectangle(x, y, x + 900, y + 600)
        found = {f.id() for f in layer.getFeatures(QgsFeatureRequest(box))}
        assert found >= {f.id() for f in everything if f.geometry().intersects(box)}
        assert found <= {f.id() for f in everything if f.geometry().boundingBox().intersects(box)}
    whole = QgsRectangle()
    whole.setMinimal()
    for feature in everything:
        whole.combineExtentWith(feature.geometry().boundingBox())
    assert whole == extent


def test_gdal_writes_on(file):
    layer = QgsVectorLayer(str(file), "x", "ogr")
    before, first = layer.featureCount(), next(layer.getFeatures())
    with edit(layer):
        assert layer.deleteFeature(first.id())
        first.setId(-1)
        first["fid"] = None
        assert layer.addFeature(first)
    assert QgsVectorLayer(str(file), "x", "ogr").featureCount() == before
    test_index_is_sound(file)


def test_boxes_grow_outwards():
    boxes = np.random.default_rng(1).uniform(-1e7, 1e7, (1000, 4))
    single = geopackage._outwards(boxes).astype(np.float64)
    assert (single[:, ::2] <= boxes[:, ::2]).all()
    assert (single[:, 1::2] >= boxes[:, 1::2]).all()
    assert np.abs(single - boxes).max() < 2
