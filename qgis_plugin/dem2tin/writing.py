"""From numpy to what QGIS opens: feature sinks, rasters, and whole files or none."""

import contextlib
import math
import re
import sqlite3
from pathlib import Path

import numpy as np
from osgeo import gdal, ogr
from qgis.core import (
    Qgis,
    QgsFeature,
    QgsFeatureSink,
    QgsField,
    QgsFields,
    QgsGeometry,
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingOutputLayerDefinition,
    QgsProcessingParameterFeatureSink,
    QgsProcessingUtils,
    QgsRasterFileWriter,
    QgsWkbTypes,
)
from qgis.PyQt.QtCore import QMetaType, QVariant

from . import geopackage
from .core import tr

NODATA = float(np.finfo(np.float32).min)  # no height can equal it
GEOTIFF = ["TILED=YES", "COMPRESS=DEFLATE", "PREDICTOR=3", "BIGTIFF=IF_SAFER", "NUM_THREADS=ALL_CPUS"]
FEATURES = 4096  # at a time
TYPES = QMetaType.Type if Qgis.QGIS_VERSION_INT >= 33800 else QVariant


class Files(contextlib.ExitStack):
    """Output files of a run, which all appear when it has succeeded, or none at all."""

    def __init__(self, job):
        super().__init__()
        self._job = job

    def new(self, target, companions=()):
        """Return where to write what becomes ``target``; ``companions`` are names of files beside it."""
        from tin.formats.atomic import atomic

        path = Path(target).resolve()
        beside = [path.with_name(name.format(name=path.name, stem=path.stem)) for name in companions]
        return self.enter_context(atomic(path, overwrite=self._job.overwrite, companions=beside))


def refuse_existing(job):
    """Raise QgsProcessingException for an output that exists, unless it may be replaced."""
    if job.overwrite:
        return
    for definition in job.algorithm.destinationParameterDefinitions():
        target = _target(job, definition)
        if target and _exists(target, isinstance(definition, QgsProcessingParameterFeatureSink)):
            message = tr("{target}: exists already; choose another name or tick '{option}'")
            option = tr("Replace output files that exist")
            raise QgsProcessingException(message.format(target=target, option=option))


def _target(job, definition):
    value = job.parameters.get(definition.name())
    if isinstance(value, QgsProcessingOutputLayerDefinition):
        value = value.sink.valueAsString(job.context.expressionContext())[0]
    value = "" if value is None else str(value)
    return "" if value in ("memory:", QgsProcessing.TEMPORARY_OUTPUT) else value


def _exists(target, is_vector):
    table = re.match(r"""ogr:dbname='(?P<file>.+?)' table="(?P<layer>.+?)\"""", target)
    if table:
        database = ogr.Open(table["file"]) if Path(table["file"]).exists() else None
        return database is not None and database.GetLayerByName(table["layer"]) is not None
    path = Path(target)
    if is_vector and not path.suffix:
        path = path.with_name(f"{path.name}.{QgsProcessingUtils.defaultVectorExtension()}")
    return path.exists()


def write_triangles(job, name, mesh, crs):
    """Write a POLYGON Z a triangle, with attributes, to the feature sink ``name``; returns the layer's id."""
    from tin.formats.attributes import attributes
    from tin.formats.gpkg import polygons_wkb

    columns = attributes(mesh)
    fields = QgsFields()
    for column, values in columns.items():
        fields.append(QgsField(column, TYPES.Double if values.dtype.kind == "f" else TYPES.Int))
    source = (job.parameters, name, job.context, fields, QgsWkbTypes.PolygonZ, crs)
    sink, layer = job.algorithm.parameterAsSink(*source)
    if sink is None:
        raise QgsProcessingException(job.algorithm.invalidSinkError(job.parameters, name))
    try:
        polygons, values = polygons_wkb(mesh), {column: _plain(c) for column, c in columns.items()}
        if Path(layer).suffix.lower() == ".gpkg" and Path(layer).is_file():
            del sink  # closes the file, which has a layer without rows now
            geopackage.fill(layer, polygons, _boxes(mesh), values, job.check)
        else:
            _add(job, sink, polygons, values)
            job.check(1.0)
            del sink
    except BaseException as error:
        sink = None
        _discard(layer)
        if isinstance(error, sqlite3.Error):
            raise QgsProcessingException(f"{layer}: {error}") from error
        raise
    return layer


def _add(job, sink, polygons, columns):
    for start in range(0, len(polygons), FEATURES):
        job.check(start / len(polygons))
        block = slice(start, start + FEATURES)
        rows = zip(*(values[block] for values in columns.values()))
        features = [_feature(wkb, row) for wkb, row in zip(polygons[block].tolist(), rows)]
        if not sink.addFeatures(features, QgsFeatureSink.FastInsert):
            raise QgsProcessingException(sink.lastError() or tr("The triangles cannot be written"))


def _boxes(mesh):
    """Return (m, 4) min x, max x, min y, max y of the triangles."""
    corners = mesh.vertices[mesh.triangles, :2]
    low, high = corners.min(axis=1), corners.max(axis=1)
    return np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)


def _plain(values):
    """Return a list, with None for NaN."""
    if values.dtype.kind == "f" and np.isnan(values).any():
        return [None if math.isnan(value) else value for value in values.tolist()]
    return values.tolist()


def _feature(wkb, row):
    geometry = QgsGeometry()
    geometry.fromWkb(bytes(wkb))
    feature = QgsFeature()
    feature.setGeometry(geometry)
    feature.setAttributes(list(row))
    return feature


def _discard(layer):
    """Remove what a sink has left behind; layers in memory vanish with their context."""
    path, _, table = layer.partition("|layername=")
    if not Path(path).is_file():
        return
    dataset = gdal.OpenEx(path, gdal.OF_VECTOR | gdal.OF_UPDATE)
    if dataset is None:
        Path(path).unlink()
    elif table and dataset.GetLayerCount() > 1:
        dataset.DeleteLayer(table.partition("|")[0])
    else:
        driver = dataset.GetDriver()
        del dataset
        driver.Delete(path)


def write_raster(job, path, target, heights, *, transform, crs, description, unit=""):
    """Write (rows, cols) float32 heights, NaN where void, to ``path`` in the format of its suffix.

    ``target`` is the final name; ``transform`` as in ``tin.DEM``, ``crs`` is WKT or "".
    """
    rows, cols = heights.shape
    void = np.isnan(heights)
    heights[void] = NODATA
    memory = gdal.GetDriverByName("MEM").Create("", cols, rows, 1, gdal.GDT_Float32)
    a, b, c, d, e, f = transform
    memory.SetGeoTransform((c, a, b, f, d, e))
    if crs:
        memory.SetProjection(crs)
    band = memory.GetRasterBand(1)
    band.WriteRaster(0, 0, cols, rows, heights.tobytes(), buf_type=gdal.GDT_Float32)
    band.SetDescription(description)
    band.SetUnitType(unit)
    if void.any():
        band.SetNoDataValue(NODATA)
    name = QgsRasterFileWriter.driverForExtension(Path(target).suffix.lstrip(".")) or "GTiff"
    made = gdal.GetDriverByName(name).CreateCopy(
        str(path),
        memory,
        0,
        GEOTIFF if name == "GTiff" else [],
        callback=lambda done, *_: int(job.progress(done)),
    )
    job.check()
    if made is None:
        raise QgsProcessingException(f"{target}: {gdal.GetLastErrorMsg()}")
    made.FlushCache()


def open_mesh(job, path):
    """Let QGIS add the mesh at ``path`` to its project at the end, if it has one open."""
    project = job.context.project()
    if project is not None:
        details = QgsProcessingContext.LayerDetails("", project, "", QgsProcessingUtils.LayerHint.Mesh)
        job.context.addLayerToLoadOnCompletion(str(path), details)


def dress(job, output, layer, name, styler):
    """Name and style a layer that QGIS is going to open; a name given by the user (in a model) stays."""
    if job.context.willLoadLayerOnCompletion(layer):
        details = job.context.layerToLoadOnCompletionDetails(layer)
        if details.name in ("", job.algorithm.parameterDefinition(output).description()):
            details.name = name
        details.setPostProcessor(styler)
