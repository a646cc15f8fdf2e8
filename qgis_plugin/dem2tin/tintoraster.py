"""TIN to raster."""

import math

import numpy as np
from qgis.core import (
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingParameterDistance,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
)

from . import reading, styling, writing
from .algorithm import Algorithm, with_help
from .core import tr
from .surface import rasterize


class TinToRaster(Algorithm):
    """A layer of triangles in, their heights on a grid out."""

    NAME = "tintoraster"
    TITLE = "TIN to raster"
    ABOUT = (
        "Writes the heights of a TIN to a raster, on the grid of another raster or with a pixel size of "
        "your choice."
    )
    TAGS = ("rasterize", "interpolation", "grid", "dem", "geotiff")

    def parameters(self):
        """TIN, grid, output."""
        return [
            with_help(
                QgsProcessingParameterFeatureSource("TIN", tr("TIN"), [QgsProcessing.TypeVectorPolygon]),
                tr("triangles with heights (Polygon Z), such as 'DEM to TIN' makes"),
            ),
            with_help(
                QgsProcessingParameterRasterLayer("REFERENCE", tr("Raster whose grid to use"), optional=True),
                tr("the output has its CRS, its size and its pixels"),
            ),
            with_help(
                QgsProcessingParameterDistance(
                    "PIXEL_SIZE", tr("Pixel size"), None, "TIN", optional=True, minValue=0.0
                ),
                tr("where there is no raster whose grid to use"),
            ),
            with_help(
                QgsProcessingParameterExtent("EXTENT", tr("Extent"), optional=True),
                tr("with a pixel size: what to cover instead of the whole TIN"),
            ),
            with_help(
                QgsProcessingParameterRasterDestination("OUTPUT", tr("TIN as raster")),
                tr("32-bit heights; NoData outside the TIN"),
            ),
        ]

    def execute(self, job):
        """Read the TIN, choose the grid, draw."""
        source = self.parameterAsSource(job.parameters, "TIN", job.context)
        if source is None:
            raise QgsProcessingException(self.invalidSourceError(job.parameters, "TIN"))
        writing.refuse_existing(job)
        layer = None
        if job.given("REFERENCE"):
            layer = self.parameterAsRasterLayer(job.parameters, "REFERENCE", job.context)
            if layer is None:
                raise QgsProcessingException(self.invalidRasterError(job.parameters, "REFERENCE"))
        crs = source.sourceCrs() if layer is None else layer.crs()
        job.span(0, 40)
        job.stage("tin", tr("Reading the TIN"))
        corners = reading.read_tin(source, crs, job)
        transform, shape = self._grid(job, corners, crs) if layer is None else _grid_of(layer)
        low, high = float(corners[:, :, 2].min()), float(corners[:, :, 2].max())
        _to_pixels(corners, transform)
        job.span(40, 80)
        job.stage("draw", tr("Drawing {rows} x {cols} pixels").format(rows=shape[0], cols=shape[1]))
        heights = rasterize(corners, shape, job.check).astype(np.float32)
        target = self.parameterAsOutputLayer(job.parameters, "OUTPUT", job.context)
        job.span(80, 100)
        job.stage("write", tr("Writing {target}").format(target=target))
        title = tr("{tin} (raster)").format(tin=source.sourceName())
        wkt = crs.toWkt(crs.WKT_PREFERRED) if crs.isValid() else ""
        with writing.Files(job) as files:
            path = files.new(target, ("{name}.aux.xml",))
            writing.write_raster(job, path, target, heights, transform=transform, crs=wkt, description=title)
        styler = styling.RasterStyler(low, high, styling.HEIGHTS)
        writing.dress(job, "OUTPUT", target, title, styler)
        return {"OUTPUT": target}

    def _grid(self, job, corners, crs):
        """Return transform and shape for the pixel size given, aligned to whole multiples of it."""
        size = (
            self.parameterAsDouble(job.parameters, "PIXEL_SIZE", job.context)
            if job.given("PIXEL_SIZE")
            else 0.0
        )
        if not (math.isfinite(size) and size > 0):
            raise QgsProcessingException(tr("Give either a raster whose grid to use or a pixel size above 0"))
        (left, bottom), (right, top) = corners[:, :, :2].min(axis=(0, 1)), corners[:, :, :2].max(axis=(0, 1))
        if job.given("EXTENT"):
            extent = self.parameterAsExtent(job.parameters, "EXTENT", job.context, crs)
            left, right = extent.xMinimum(), extent.xMaximum()
            bottom, top = extent.yMinimum(), extent.yMaximum()
        first_col, first_row = math.floor(left / size), math.ceil(top / size)
        cols, rows = math.ceil(right / size) - first_col, first_row - math.floor(bottom / size)
        if not 0 < rows * cols <= reading.MAX_PIXELS:
            message = tr("{rows} x {cols} pixels are none or too many; choose another pixel size or extent")
            raise QgsProcessingException(message.format(rows=rows, cols=cols))
        return (size, 0.0, first_col * size, 0.0, -size, first_row * size), (rows, cols)


def _grid_of(layer):
    dataset = reading.open_raster(layer)
    c, a, b, f, d, e = dataset.GetGeoTransform()
    return (a, b, c, d, e, f), (dataset.RasterYSize, dataset.RasterXSize)


def _to_pixels(corners, transform):
    a, b, c, d, e, f = transform
    x, y, det = corners[:, :, 0] - c, corners[:, :, 1] - f, a * e - b * d
    corners[:, :, 0], corners[:, :, 1] = (e * x - b * y) / det - 0.5, (a * y - d * x) / det - 0.5
