"""Breaklines, spot heights and areas: from feature sources to the arrays that the core takes."""

import numpy as np
from qgis.core import (
    QgsCoordinateTransform,
    QgsCsException,
    QgsFeatureRequest,
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingFeatureSource,
    QgsWkbTypes,
)

from .core import tr

POINT, LINE, POLYGON = QgsWkbTypes.PointGeometry, QgsWkbTypes.LineGeometry, QgsWkbTypes.PolygonGeometry
NAMES = {POINT: "points", LINE: "lines", POLYGON: "polygons"}
LAYER_TYPES = {
    POINT: QgsProcessing.TypeVectorPoint,
    LINE: QgsProcessing.TypeVectorLine,
    POLYGON: QgsProcessing.TypeVectorPolygon,
}
LAYERS = {"breaklines": (LINE, POLYGON), "points": (POINT,), "clip": (POLYGON,), "flat": (POLYGON,)}
"""The core's options that are layers here, and the geometries that they take."""


def read_constraints(job, crs):
    """Return the keywords of ``tin.triangulate`` for the layers given, in ``crs``."""
    found = {}
    for option in LAYERS:
        name = option.upper()
        if job.given(name):
            source = job.algorithm.parameterAsSource(job.parameters, name, job.context)
            if source is None:
                raise QgsProcessingException(job.algorithm.invalidSourceError(job.parameters, name))
            job.stage(name, tr("Reading {name}").format(name=source.sourceName()))
            found[option] = _read(source, option, crs, job)
    return found


def _read(source, option, crs, job):
    """Return (n, 3) points, lines of (n, 3) vertices, or polygons as lists of such rings; z may be NaN."""
    transform, found, lost = _transform(source, crs, job), [], 0
    # Invalid polygons are mended below, whatever QGIS is set to do with them.
    request = QgsFeatureRequest().setSubsetOfAttributes([])
    for feature in source.getFeatures(request, QgsProcessingFeatureSource.FlagSkipGeometryValidityChecks):
        job.check()
        geometry = feature.geometry()
        if geometry.isEmpty():
            continue
        geometry.convertToStraightSegment()
        try:
            if transform is not None:
                geometry.transform(transform)  # x and y alone: z stays
        except QgsCsException:
            lost += 1
            continue
        for part in _parts(geometry):
            _check(part, option, source)
            if part.type() == POLYGON and option != "breaklines":
                found += [_paths(polygon) for polygon in _valid(part)]
            else:
                found += _paths(part)
    if lost:
        message = tr("{name}: {count} features have no place in the CRS of the DEM and are left out")
        job.feedback.pushWarning(message.format(name=source.sourceName(), count=lost))
    return np.concatenate([np.empty((0, 3)), *found]) if option == "points" else found


def _transform(source, crs, job):
    own = source.sourceCrs()
    if not (own.isValid() and crs.isValid() and own != crs):
        return None
    made = QgsCoordinateTransform(own, crs, job.context.transformContext())
    if not made.isValid():  # it would do nothing
        message = tr("{name}: cannot be transformed from {own} to {crs}, the CRS of the DEM")
        names = [each.userFriendlyIdentifier() for each in (own, crs)]
        raise QgsProcessingException(message.format(name=source.sourceName(), own=names[0], crs=names[1]))
    return made


def _parts(geometry):
    """Yield what is single, also of collections within collections."""
    if geometry.isMultipart():
        for part in geometry.asGeometryCollection():
            yield from _parts(part)
    elif not geometry.isEmpty():
        yield geometry


def _check(part, option, source):
    if part.type() not in LAYERS[option]:
        message = tr("{option}: '{name}' holds {found}, where {needed} are needed")
        found, needed = NAMES[part.type()], NAMES[LAYERS[option][0]]
        raise QgsProcessingException(
            message.format(option=option, name=source.sourceName(), found=tr(found), needed=tr(needed))
        )


def _valid(polygon):
    """Return the polygons of one that may cross itself."""
    if polygon.isGeosValid():
        return [polygon]
    made = polygon.makeValid()
    # What has vertices without a place cannot be mended; the core leaves these vertices out.
    return [polygon] if made.isNull() else [part for part in _parts(made) if part.type() == POLYGON]


def _paths(part):
    """Return the (n, 3) vertices of a point, a line, or each ring of a polygon."""
    single = part.get()
    single.dropMValue()
    wkb, width = single.asWkb().data(), 3 if single.is3D() else 2
    if part.type() == POINT:
        return [_vertices(wkb, 5, 1, width)]
    if part.type() == LINE:
        return [_vertices(wkb, 9, _count(wkb, 5), width)]
    rings, place = [], 9
    for _ in range(_count(wkb, 5)):
        count = _count(wkb, place)
        rings.append(_vertices(wkb, place + 4, count, width))
        place += 4 + 8 * width * count
    return rings


def _count(wkb, place):
    return int.from_bytes(wkb[place : place + 4], "little")


def _vertices(wkb, place, count, width):
    made = np.full((count, 3), np.nan)
    made[:, :width] = np.frombuffer(wkb, "<f8", width * count, place).reshape(count, width)
    return made
