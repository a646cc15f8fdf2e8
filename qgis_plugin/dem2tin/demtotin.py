"""DEM to TIN."""

from qgis.core import (
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingParameterExtent,
    QgsProcessingParameterFeatureSink,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
)

from . import reading, writing
from .algorithm import Algorithm, with_help
from .constraints import read_constraints
from .core import tr
from .parameters import parameters_of, values_of
from .results import Results

# The core's stages: what to show, and which part of the bar they take.
STAGES = {
    "outline": ("Outlining the data", 8, 12),
    "despike": ("Removing spikes", 12, 18),
    "smooth": ("Smoothing", 18, 30),
    "refine": ("Refining", 30, 55),
    "order": ("Ordering the points", 55, 56),
    "fit": ("Fitting heights", 56, 70),
    "flip": ("Flipping edges", 70, 74),
    "measure": ("Measuring the errors", 74, 75),
}


class DemToTin(Algorithm):
    """A raster layer in, a TIN out: polygons, mesh, OBJ, raster, report."""

    NAME = "demtotin"
    TITLE = "DEM to TIN"
    ABOUT = (
        "Turns a DEM into a compact triangle mesh (TIN) that stays true to the terrain even where the DEM is "
        "noisy. Every output is optional."
    )
    TAGS = (
        "triangulation",
        "mesh",
        "terrain",
        "elevation",
        "delaunay",
        "3d",
        "obj",
        "simplify",
        "irregular network",
    )
    NUMBERS = {
        "POINTS": "Number of points",
        "TRIANGLES": "Number of triangles",
        "RMSE": "Root mean square error",
        "MAE": "Mean absolute error",
        "P95": "Error that 95 % of the pixels stay within",
        "MAX_ERROR": "Largest error",
    }

    def parameters(self):
        """Inputs, the core's options, outputs."""
        inputs = [
            with_help(
                QgsProcessingParameterRasterLayer("INPUT", tr("DEM")),
                tr("raster of heights; its NoData pixels stay outside the TIN"),
            ),
            *parameters_of("input", "INPUT"),
            *parameters_of("method", "INPUT"),
            *parameters_of("constraints", "INPUT"),
            with_help(
                QgsProcessingParameterExtent("EXTENT", tr("Extent"), optional=True),
                tr("use only the pixels whose centres lie in it"),
            ),
            with_help(
                QgsProcessingParameterFeatureSource(
                    "MASK", tr("Mask"), [QgsProcessing.TypeVectorPolygon], optional=True
                ),
                tr("use only the pixels whose centres lie in one of these polygons"),
            ),
        ]
        outputs = [
            with_help(
                QgsProcessingParameterFeatureSink(
                    "OUTPUT", tr("TIN"), QgsProcessing.TypeVectorPolygon, optional=True
                ),
                tr("a polygon with heights (Polygon Z) a triangle, with slope, aspect, areas, largest error"),
            ),
            with_help(
                _file("MESH", tr("TIN mesh"), tr("UGRID mesh (*.nc)")),
                tr("a mesh layer, which QGIS draws faster than polygons and shows in 3D"),
            ),
            with_help(
                _file("OBJ", tr("3D model"), tr("Wavefront OBJ (*.obj)")),
                tr("for 3D programs; the file's first lines name the origin of its coordinates"),
            ),
            with_help(
                _raster("RASTER", tr("TIN as raster")),
                tr("the heights of the TIN on the DEM's own grid"),
            ),
            with_help(
                _raster("ERROR", tr("Errors")), tr("the TIN's height minus the DEM's, for every pixel")
            ),
            with_help(
                _file("REPORT", tr("Report"), tr("HTML files (*.html)")),
                tr("numbers, a map of the errors and their distribution"),
            ),
        ]
        return [*inputs, *parameters_of("output", "INPUT"), *outputs]

    def checkParameterValues(self, parameters, context):
        """Let the core judge its options before a run starts."""
        ok, message = super().checkParameterValues(parameters, context)
        if not ok or self.parameterDefinition("INPUT") is None:
            return ok, message
        from tin import TinError

        from .algorithm import Job

        try:
            for group in ("input", "constraints", "method", "output"):
                values_of(group, Job(self, parameters, context, None))
        except TinError as error:
            return False, str(error)
        return True, ""

    def execute(self, job):
        """Read, triangulate, write."""
        from tin import triangulate

        layer = self.parameterAsRasterLayer(job.parameters, "INPUT", job.context)
        if layer is None:
            raise QgsProcessingException(self.invalidRasterError(job.parameters, "INPUT"))
        options = {**values_of("constraints", job), **values_of("method", job)}
        output = values_of("output", job)
        writing.refuse_existing(job)
        # These first, because what is wrong with them shows sooner than a large DEM is read.
        options.update(read_constraints(job, layer.crs()))
        dem = self._read(layer, job)
        self._warn(dem, job)
        mesh = triangulate(dem, progress=lambda stage, done: _advance(job, stage, done), **options)
        job.check()
        for warning in mesh.report.warnings:
            job.feedback.pushWarning(warning)
        job.feedback.pushInfo(str(mesh.report))
        results = Results(job, mesh, layer, output).write()
        errors = mesh.error()
        return {
            **results,
            "POINTS": len(mesh.vertices),
            "TRIANGLES": len(mesh.triangles),
            "RMSE": errors.rmse,
            "MAE": errors.mae,
            "P95": errors.p95,
            "MAX_ERROR": errors.max_error,
        }

    def _read(self, layer, job):
        values = values_of("input", job)
        given = {"z_factor": values["z_factor"]} if "z_factor" in values else {}
        if job.given("EXTENT"):
            given["extent"] = self.parameterAsExtent(job.parameters, "EXTENT", job.context, layer.crs())
        if job.given("MASK"):
            given["mask"] = self.parameterAsSource(job.parameters, "MASK", job.context)
        job.span(0, 8)
        return reading.read_dem(layer, values.get("band", 1), job, **given)

    def _warn(self, dem, job):
        """Say where x, y and z of a 3D output are not in one unit, or not in metres."""
        crs, unit = dem.crs, dem.vertical_unit
        if crs is None or not any(map(job.given, ("MESH", "OBJ"))):
            return
        if crs.is_geographic:
            job.feedback.pushWarning(
                tr(
                    "The DEM is in degrees: in 3D, heights look a hundred thousand times too large. "
                    "Reproject the DEM to a metric CRS first, for example its UTM zone."
                )
            )
        elif unit and unit != crs.unit_name:
            message = tr(
                "x and y are in {horizontal}, heights in {vertical}: set the z factor to make them one unit."
            )
            job.feedback.pushWarning(message.format(horizontal=crs.unit_name, vertical=unit))
        elif "foot" in crs.unit_name:
            message = tr("The 3D outputs are in {unit}, like the DEM; most 3D programs take them for metres.")
            job.feedback.pushWarning(message.format(unit=crs.unit_name))


def _advance(job, stage, done):
    text, first, last = STAGES.get(stage, (stage.capitalize(), 12, 75))
    job.span(first, last)
    job.stage(stage, tr(text))
    return job.progress(done)


def _file(name, title, file_filter):
    return QgsProcessingParameterFileDestination(
        name, title, file_filter, optional=True, createByDefault=False
    )


def _raster(name, title):
    return QgsProcessingParameterRasterDestination(name, title, optional=True, createByDefault=False)
