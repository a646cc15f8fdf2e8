"""What the tests of the plugin share: feedback that listens, DEMs of every kind, readers."""

from pathlib import Path

import numpy as np
from osgeo import gdal, osr
from qgis.core import QgsProcessingFeedback, QgsVectorLayer

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_dem"
JACKSBORO, USGS, VOIDS = (
    SAMPLES / "jacksboro.tif",
    SAMPLES / "jacksboro.dem",
    SAMPLES / "crater_lake_voids.tif",
)


class Feedback(QgsProcessingFeedback):
    """Remembers what it is told; cancels when a stage begins whose name starts with ``cancel_at``."""

    def __init__(self, cancel_at=None):
        super().__init__(False)
        self.cancel_at, self.infos, self.warnings, self.stages, self.bar = cancel_at, [], [], [], []
        self.progressChanged.connect(self.bar.append)

    def setProgressText(self, text):
        self.stages.append(text)
        if self.cancel_at is not None and text.startswith(self.cancel_at):
            self.cancel()

    def pushInfo(self, text):
        self.infos.append(text)

    def pushWarning(self, text):
        self.warnings.append(text)


def make_dem(
    path, *, rows=60, cols=80, transform=(500000, 30, 0, 5100000, 0, -30), crs="EPSG:32610", unit=None
):
    """A hilly DEM, float32, with 1 % spikes and a void of 9 x 9 pixels."""
    row, col = np.mgrid[0:rows, 0:cols]
    z = (500 + 90 * np.sin(row / 9) * np.cos(col / 13) + 0.7 * col).astype(np.float32)
    z.ravel()[np.random.default_rng(3).integers(0, z.size, z.size // 100)] += 60
    z[20:29, 30:39] = -9999
    dataset = gdal.GetDriverByName("GTiff").Create(str(path), cols, rows, 1, gdal.GDT_Float32)
    if transform:
        dataset.SetGeoTransform(transform)
    if crs:
        reference = osr.SpatialReference()
        reference.SetFromUserInput(crs)
        dataset.SetProjection(reference.ExportToWkt())
    band = dataset.GetRasterBand(1)
    band.SetNoDataValue(-9999)
    band.SetUnitType(unit or "")
    band.WriteRaster(0, 0, cols, rows, z.tobytes(), buf_type=gdal.GDT_Float32)
    return path


def dems(folder):
    """DEMs of every kind: {name: path}."""
    return {
        "utm": USGS,
        "geographic": JACKSBORO,
        "voids": VOIDS,
        "feet": make_dem(folder / "feet.tif", crs="EPSG:2225", unit="ft"),
        "rotated": make_dem(folder / "rotated.tif", transform=(500000, 26, 15, 5100000, 15, -26)),
        "south-up": make_dem(folder / "south-up.tif", transform=(500000, 30, 0, 5000000, 0, 30)),
        "own-crs": make_dem(
            folder / "own.tif", crs="+proj=tmerc +lat_0=41 +lon_0=-122 +k=0.9993 +ellps=GRS80"
        ),
        "compound": make_dem(folder / "compound.tif", crs="EPSG:32610+5703"),
    }


def read_raster(path):
    """Heights (NaN where void) and the dataset."""
    dataset = gdal.Open(str(path))
    band = dataset.GetRasterBand(1)
    shape = dataset.RasterYSize, dataset.RasterXSize
    z = np.frombuffer(band.ReadRaster(buf_type=gdal.GDT_Float32), np.float32).reshape(shape).copy()
    if band.GetNoDataValue() is not None:
        z[z == np.float32(band.GetNoDataValue())] = np.nan
    return z, dataset


def read_polygons(path):
    """(m, 4, 3) rings and the list of attributes, in the order of the file."""
    layer = QgsVectorLayer(str(path), "x", "ogr")
    assert layer.isValid(), path
    first = [field.name() for field in layer.fields()].index("v0")
    rings, rows = [], []
    for feature in layer.getFeatures():
        rings.append([(v.x(), v.y(), v.z()) for v in feature.geometry().vertices()])
        rows.append([value if value else value or None for value in feature.attributes()[first:]])
    return np.array(rings), rows, layer.crs()


def vertices_of_obj(path):
    lines = Path(path).read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line[:2] in ("v ", "f ")]
