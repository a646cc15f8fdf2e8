"""The provider of the Processing toolbox."""

from pathlib import Path

from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

from .demtotin import DemToTin
from .tinerror import TinError
from .tintoraster import TinToRaster

ICON = str(Path(__file__).with_name("icon.svg"))


class Provider(QgsProcessingProvider):
    """Three algorithms: DEM to TIN, TIN error report, TIN to raster."""

    def id(self):
        """Prefix of the algorithms' ids."""
        return "dem2tin"

    def name(self):
        """Return the name in the toolbox."""
        return "dem2tin"

    def longName(self):
        """Return the name in the settings."""
        return "dem2tin - " + self.tr("TINs from DEMs")

    def icon(self):
        """Return the mark in the toolbox."""
        return QIcon(ICON)

    def svgIconPath(self):
        """Return the same mark for the model designer."""
        return ICON

    def loadAlgorithms(self):
        """Add the algorithms; they explain themselves where the core is missing."""
        for algorithm in (DemToTin, TinError, TinToRaster):
            self.addAlgorithm(algorithm())
