"""The outputs of DEM to TIN."""

import numpy as np

from . import report, styling, writing
from .core import tr


class Results:
    """Writes what was asked for of a mesh, all or nothing, and tells QGIS how to open it."""

    def __init__(self, job, mesh, layer, options):
        self.job, self.mesh, self.layer, self.options = job, mesh, layer, options
        self.title = tr("TIN of {name}").format(name=mesh.name or layer.name())
        self.made = {}

    def write(self):
        """Return {output: what QGIS opens it by}."""
        job = self.job
        with writing.Files(job) as files:
            job.span(75, 82)
            for name, suffix in (("MESH", ".nc"), ("OBJ", ".obj")):
                if job.given(name):
                    self._file(files, name, suffix)
            job.span(82, 90)
            if any(map(job.given, ("RASTER", "ERROR", "REPORT"))):
                self._rasters(files)
            job.span(90, 100)
            if job.given("OUTPUT"):
                job.stage("features", tr("Writing the triangles"))
                self.made["OUTPUT"] = writing.write_triangles(job, "OUTPUT", self.mesh, self.layer.crs())
        self._dress()
        return self.made

    def _file(self, files, name, suffix):
        from tin.formats import WRITERS, accepted

        target = self.job.algorithm.parameterAsFileOutput(self.job.parameters, name, self.job.context)
        self.job.stage(target, tr("Writing {target}").format(target=target))
        writer = WRITERS[suffix]
        path = files.new(target, writer.companions)
        writer.write(self.mesh, path, **accepted(f"x{suffix}", self.options))
        self.job.check(1.0)
        self.made[name] = target

    def _rasters(self, files):
        job, dem = self.job, self.mesh.dem
        surface = self.mesh.rasterize(np.float32)
        job.check()
        if job.given("RASTER"):
            self._raster(files, "RASTER", surface.copy(), self.title)
        if not any(map(job.given, ("ERROR", "REPORT"))):
            return
        surface -= dem.z
        if job.given("REPORT"):
            target = job.algorithm.parameterAsFileOutput(job.parameters, "REPORT", job.context)
            text = report.page(self.title, self._numbers(), surface, dem.vertical_unit)
            files.new(target).write_text(text, encoding="utf-8")
            self.made["REPORT"] = target
        if job.given("ERROR"):
            self._raster(files, "ERROR", surface, tr("TIN minus DEM"))

    def _raster(self, files, name, heights, description):
        job, dem = self.job, self.mesh.dem
        target = job.algorithm.parameterAsOutputLayer(job.parameters, name, job.context)
        job.stage(name, tr("Writing {target}").format(target=target))
        writing.write_raster(
            job,
            files.new(target, ("{name}.aux.xml",)),
            target,
            heights,
            transform=dem.transform,
            crs=dem.crs.wkt if dem.crs else "",
            description=description,
            unit=dem.vertical_unit,
        )
        self.made[name] = target

    def _numbers(self):
        made, errors, unit = self.mesh.report, self.mesh.error(), self.mesh.dem.vertical_unit
        unit = f" [{unit}]" if unit else ""
        return {
            tr("Points"): made.points,
            tr("Triangles"): made.triangles,
            tr("Stopped by"): tr(made.stop_reason),
            tr("RMSE") + unit: errors.rmse,
            tr("Mean absolute error") + unit: errors.mae,
            tr("95 % of the pixels within") + unit: errors.p95,
            tr("Largest error") + unit: errors.max_error,
            tr("Pixels covered"): errors.covered,
            tr("Valid pixels not covered"): errors.uncovered,
            tr("Spikes replaced"): made.spikes,
            tr("Seconds"): made.seconds,
            tr("CRS"): made.crs or tr("none"),
        }

    def _dress(self):
        heights, errors = self.mesh.vertices[:, 2], self.mesh.error()
        low, high = float(heights.min()), float(heights.max())
        limit = errors.p95 or errors.max_error
        looks = {
            "OUTPUT": ("{title}", styling.PolygonStyler(low, high)),
            "MESH": (tr("{title} (mesh)"), styling.MeshStyler(low, high)),
            "RASTER": (tr("{title} (raster)"), styling.RasterStyler(low, high, styling.HEIGHTS)),
            "ERROR": (tr("{title} (errors)"), styling.RasterStyler(-limit, limit, styling.ERRORS)),
        }
        for name, (text, styler) in looks.items():
            if name in self.made:
                if name == "MESH":
                    writing.open_mesh(self.job, self.made[name])
                writing.dress(self.job, name, self.made[name], text.format(title=self.title), styler)
