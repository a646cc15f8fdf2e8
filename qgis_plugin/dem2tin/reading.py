"""From QGIS layers to numpy: the DEM, masks and TIN polygons. Through GDAL and QGIS alone."""

import math

import numpy as np
from osgeo import gdal, ogr, osr
from qgis.core import (
    QgsCoordinateReferenceSystem,
    QgsFeatureRequest,
    QgsProcessingException,
)

from .core import tr

POLYGON_Z = np.dtype(
    [("order", "u1"), ("type", "<u4"), ("rings", "<u4"), ("points", "<u4"), ("xyz", "<f8", (4, 3))]
)
WITH_Z = (1003, 1017, 0x80000003)  # Polygon Z, Triangle Z and the old Polygon 2.5D
MAX_PIXELS = 2**31


class Watched:
    """An osgeo dataset or band under another name, whose reading moves the bar and can be cancelled."""

    def __init__(self, wrapped, name, progress):
        self._wrapped, self._name, self._progress = wrapped, name, progress

    def __getattr__(self, attribute):
        return getattr(self._wrapped, attribute)

    def GetDescription(self):  # noqa: N802
        """Return the layer's name, which outputs and messages then bear."""
        return self._name

    def GetRasterBand(self, band):  # noqa: N802
        """Return the band, watched."""
        return Watched(self._wrapped.GetRasterBand(band), self._name, self._progress)

    def ReadRaster(self, *arguments, **keywords):  # noqa: N802
        """Read as GDAL does."""
        return self._wrapped.ReadRaster(*arguments, callback=self._progress, **keywords)


def open_raster(layer):
    """Return the GDAL dataset of a raster layer, in the place and the CRS that QGIS shows it in."""
    if layer.providerType() != "gdal":
        message = tr("{name}: a layer of '{kind}' cannot be read directly; save it as GeoTIFF first")
        raise QgsProcessingException(message.format(name=layer.name(), kind=layer.providerType()))
    path, *extras = layer.source().split("|option:")
    dataset = gdal.OpenEx(path, gdal.OF_RASTER | gdal.OF_READONLY, open_options=extras)
    if dataset is None:
        reason = gdal.GetLastErrorMsg() or layer.source()
        raise QgsProcessingException(tr("{name}: {reason}").format(name=layer.name(), reason=reason))
    changes = {}
    own = dataset.GetProjection() or dataset.GetGCPProjection()
    if layer.crs().isValid() and QgsCoordinateReferenceSystem.fromWkt(own) != layer.crs():
        changes["outputSRS"] = layer.crs().toWkt(QgsCoordinateReferenceSystem.WKT_PREFERRED)
    is_placed = dataset.GetGeoTransform(can_return_null=True) is not None or dataset.GetGCPCount() > 0
    if changes or not is_placed:
        dataset = _virtual(dataset, changes)
    if not is_placed:
        dataset.SetGeoTransform((0.0, 1.0, 0.0, 0.0, 0.0, -1.0))  # where QGIS draws such a raster
    return dataset


def read_dem(layer, band, job, *, extent=None, mask=None, z_factor=1.0):
    """Read a band of a raster layer as ``tin.DEM``.

    ``extent`` (in the layer's CRS) cuts out the pixels whose centres it holds; ``mask``, a feature source
    of polygons, and the NoData values set in QGIS make voids.
    """
    from tin import DEM

    job.stage("read", tr("Reading {name}").format(name=layer.name()))
    dataset = open_raster(layer)
    if extent is not None and not extent.isNull():
        dataset = _virtual(dataset, {"srcWin": _window(dataset, extent)})
    watched = Watched(dataset, layer.name(), lambda fraction, *_: int(job.progress(fraction)))
    try:
        dem = DEM.from_gdal(watched, band, z_factor, MAX_PIXELS)
    finally:
        job.check()  # a cancelled read looks like a damaged file
    valid = _not_set_as_nodata(dem, layer, band, z_factor)
    if mask is not None:
        inside = _rasterize(mask, layer.crs(), dem, job)
        valid = inside if valid is None else valid & inside
    if valid is None:
        return dem
    return DEM(
        dem.z,
        valid,
        dem.transform,
        dem.crs,
        vertical_unit=dem.vertical_unit,
        nodata=dem.nodata,
        name=dem.name,
    )


def read_tin(source, crs, job):
    """Return the (m, 3, 3) x, y, z in ``crs`` of the corners of a layer of triangles."""
    request = _in_crs(source, crs, job).setSubsetOfAttributes([])
    total = max(1, source.featureCount())
    pieces = []
    for number, feature in enumerate(source.getFeatures(request)):
        if number % 1024 == 0:
            job.check(min(1.0, number / total))
        pieces += _polygons(feature)
    polygons = np.frombuffer(b"".join(pieces), POLYGON_Z)
    if len(polygons) == 0:
        raise QgsProcessingException(tr("The TIN layer has no triangles"))
    closed = (polygons["xyz"][:, 0, :2] == polygons["xyz"][:, 3, :2]).all()
    if not (closed and np.isin(polygons["type"], WITH_Z).all() and np.isfinite(polygons["xyz"]).all()):
        raise _no_tin()
    return polygons["xyz"][:, :3].copy()


def _polygons(feature):
    """Return the WKB of a feature's triangles."""
    geometry = feature.geometry()
    wkb = geometry.asWkb().data()
    if len(wkb) == POLYGON_Z.itemsize:
        return [wkb]
    parts = []
    for part in geometry.asGeometryCollection():
        part.get().dropMValue()
        wkb = part.asWkb().data()
        if len(wkb) != POLYGON_Z.itemsize:
            raise _no_tin(feature.id())
        parts.append(wkb)
    return parts


def _no_tin(number=None):
    message = tr("The TIN layer must hold triangles with heights (Polygon Z), as 'DEM to TIN' makes them")
    return QgsProcessingException(message if number is None else f"{message}; feature {number} is none")


def _in_crs(source, crs, job):
    request = QgsFeatureRequest()
    if crs.isValid() and source.sourceCrs().isValid() and crs != source.sourceCrs():
        request.setDestinationCrs(crs, job.context.transformContext())
    return request


def _virtual(dataset, changes):
    # Never give it a name: GDAL would write a VRT file there.
    made = gdal.Translate("", dataset, format="VRT", **changes)
    if made is None:
        raise QgsProcessingException(gdal.GetLastErrorMsg())
    return made


def _window(dataset, extent):
    """Return (col, row, cols, rows) of the pixels with centres in ``extent``, or around it where rotated."""
    inverse = gdal.InvGeoTransform(dataset.GetGeoTransform())
    if inverse is None:
        raise QgsProcessingException(tr("The DEM's geotransform is singular"))
    xs, ys = (extent.xMinimum(), extent.xMaximum()), (extent.yMinimum(), extent.yMaximum())
    corners = [gdal.ApplyGeoTransform(inverse, x, y) for x in xs for y in ys]
    window = []
    for places, size in zip(zip(*corners), (dataset.RasterXSize, dataset.RasterYSize)):
        # A thousandth of a pixel of slack, because extents are given in rounded numbers.
        first = max(0, math.ceil(min(places) - 0.501))
        last = min(size, math.floor(max(places) - 0.499) + 1)
        if last <= first:
            raise QgsProcessingException(tr("The extent holds no pixel of the DEM"))
        window.append((first, last - first))
    (col, cols), (row, rows) = window
    return [col, row, cols, rows]


def _not_set_as_nodata(dem, layer, band, z_factor):
    """Return where heights are none of the NoData values added to the layer in QGIS; None without such."""
    ranges = layer.dataProvider().userNoDataValues(band)
    if not ranges:
        return None
    valid = dem.valid.copy()
    for span in ranges:
        low, high = sorted((span.min() * z_factor, span.max() * z_factor))
        valid &= ~((dem.z >= low) & (dem.z <= high))
    return valid


def _rasterize(source, crs, dem, job):
    """Return (rows, cols), True where a pixel's centre lies in one of the polygons of ``source``."""
    job.stage("mask", tr("Applying the mask"))
    reference = osr.SpatialReference(dem.crs.wkt) if dem.crs else None
    memory = _memory_driver().Create("", 0, 0, 0, gdal.GDT_Unknown)
    shapes = memory.CreateLayer("mask", reference, ogr.wkbUnknown)
    for feature in source.getFeatures(_in_crs(source, crs, job).setSubsetOfAttributes([])):
        job.check()
        if feature.hasGeometry():
            shape = ogr.Feature(shapes.GetLayerDefn())
            shape.SetGeometry(ogr.CreateGeometryFromWkb(feature.geometry().asWkb().data()))
            shapes.CreateFeature(shape)
    a, b, c, d, e, f = dem.transform
    raster = gdal.GetDriverByName("MEM").Create("", dem.cols, dem.rows, 1, gdal.GDT_Byte)
    raster.SetGeoTransform((c, a, b, f, d, e))
    if reference is not None:
        raster.SetSpatialRef(reference)
    if gdal.RasterizeLayer(raster, [1], shapes, burn_values=[1]) != 0:
        raise QgsProcessingException(gdal.GetLastErrorMsg())
    burnt = raster.GetRasterBand(1).ReadRaster(buf_type=gdal.GDT_Byte)
    return np.frombuffer(burnt, np.uint8).reshape(dem.shape) != 0


def _memory_driver():
    # From GDAL 3.11 on, MEM holds vectors, too.
    return gdal.GetDriverByName("Memory") or gdal.GetDriverByName("MEM")
