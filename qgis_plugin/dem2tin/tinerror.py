"""TIN error report."""

import numpy as np
from qgis.core import (
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingParameterBand,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
)

from . import reading, report, styling, writing
from .algorithm import Algorithm, with_help
from .core import tr
from .surface import rasterize


class TinError(Algorithm):
    """A layer of triangles and a DEM in; how far they are apart out."""

    NAME = "tinerror"
    TITLE = "TIN error report"
    ABOUT = (
        "Measures how far a TIN is from a DEM: RMSE, mean, 95 % and largest error, a raster of them and "
        "a report."
    )
    TAGS = ("triangulation", "accuracy", "quality", "rmse", "validation")
    NUMBERS = {
        "RMSE": "Root mean square error",
        "MAE": "Mean absolute error",
        "P95": "Error that 95 % of the pixels stay within",
        "MAX_ERROR": "Largest error",
        "MEAN": "Mean error, positive where the TIN is too high",
        "COVERED": "Pixels that the TIN covers",
        "UNCOVERED": "Valid pixels that it does not cover",
    }

    def parameters(self):
        """TIN, DEM, outputs."""
        return [
            with_help(
                QgsProcessingParameterFeatureSource("TIN", tr("TIN"), [QgsProcessing.TypeVectorPolygon]),
                tr("triangles with heights (Polygon Z), such as 'DEM to TIN' makes"),
            ),
            with_help(
                QgsProcessingParameterRasterLayer("INPUT", tr("DEM")),
                tr("the heights to compare the TIN with"),
            ),
            with_help(
                QgsProcessingParameterBand("BAND", tr("Band"), 1, "INPUT", optional=True), tr("band to read")
            ),
            with_help(
                QgsProcessingParameterRasterDestination("ERROR", tr("Errors"), optional=True),
                tr("the TIN's height minus the DEM's, for every pixel"),
            ),
            with_help(
                QgsProcessingParameterFileDestination(
                    "REPORT", tr("Report"), tr("HTML files (*.html)"), optional=True
                ),
                tr("numbers, a map of the errors and their distribution"),
            ),
        ]

    def execute(self, job):
        """Read both, draw the TIN on the DEM's grid, subtract."""
        layer = self.parameterAsRasterLayer(job.parameters, "INPUT", job.context)
        source = self.parameterAsSource(job.parameters, "TIN", job.context)
        if layer is None:
            raise QgsProcessingException(self.invalidRasterError(job.parameters, "INPUT"))
        if source is None:
            raise QgsProcessingException(self.invalidSourceError(job.parameters, "TIN"))
        writing.refuse_existing(job)
        job.span(0, 15)
        band = self.parameterAsInt(job.parameters, "BAND", job.context) if job.given("BAND") else 1
        dem = reading.read_dem(layer, band, job)
        job.span(15, 50)
        job.stage("tin", tr("Reading the TIN"))
        corners = reading.read_tin(source, layer.crs(), job)
        corners[:, :, 0], corners[:, :, 1] = dem.map_to_pixel(corners[:, :, 0], corners[:, :, 1])
        job.span(50, 85)
        job.stage("compare", tr("Comparing"))
        errors = rasterize(corners, dem.shape, job.check)
        errors -= dem.z
        numbers = statistics(errors, dem.n_valid)
        job.feedback.pushInfo(
            "RMSE {RMSE:.4g}, MAE {MAE:.4g}, P95 {P95:.4g}, max {MAX_ERROR:.4g} {unit}".format(
                unit=dem.vertical_unit, **numbers
            )
        )
        if numbers["UNCOVERED"]:
            message = tr("{count} valid pixels of the DEM lie outside the TIN and do not count")
            job.feedback.pushWarning(message.format(count=numbers["UNCOVERED"]))
        return {**numbers, **self._write(job, dem, source.sourceName(), errors, numbers)}

    def _write(self, job, dem, name, errors, numbers):
        results = {}
        title = tr("{tin} against {dem}").format(tin=name, dem=dem.name)
        job.span(85, 100)
        with writing.Files(job) as files:
            if job.given("REPORT"):
                results["REPORT"] = self.parameterAsFileOutput(job.parameters, "REPORT", job.context)
                shown = {tr(self.NUMBERS[key]): value for key, value in numbers.items()}
                text = report.page(title, shown, errors, dem.vertical_unit)
                files.new(results["REPORT"]).write_text(text, encoding="utf-8")
            if job.given("ERROR"):
                target = results["ERROR"] = self.parameterAsOutputLayer(job.parameters, "ERROR", job.context)
                job.stage("write", tr("Writing {target}").format(target=target))
                path, crs = files.new(target, ("{name}.aux.xml",)), dem.crs.wkt if dem.crs else ""
                writing.write_raster(
                    job,
                    path,
                    target,
                    errors.astype(np.float32),
                    transform=dem.transform,
                    crs=crs,
                    description=tr("TIN minus DEM"),
                    unit=dem.vertical_unit,
                )
        if "ERROR" in results:
            limit = numbers["P95"] or numbers["MAX_ERROR"]
            styler = styling.RasterStyler(-limit, limit, styling.ERRORS)
            writing.dress(job, "ERROR", results["ERROR"], title, styler)
        return results


def statistics(errors, n_valid):
    """Return the outputs' numbers for (rows, cols) TIN minus DEM, as ``tin.Errors`` counts them."""
    known = errors[~np.isnan(errors)]
    if known.size == 0:
        raise QgsProcessingException(
            tr("The TIN covers no valid pixel of the DEM; do both lie in the same place?")
        )
    absolute = np.abs(known)
    index = int(np.ceil(known.size * 0.95)) - 1
    return {
        "RMSE": float(np.sqrt(np.mean(known * known))),
        "MAE": float(absolute.mean()),
        "P95": float(np.partition(absolute, index)[index]),
        "MAX_ERROR": float(absolute.max()),
        "MEAN": float(known.mean()),
        "COVERED": int(known.size),
        "UNCOVERED": int(n_valid - known.size),
    }
