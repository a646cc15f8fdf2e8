"""The plugin: nothing but its Processing provider."""

from qgis.core import QgsApplication

from .provider import Provider


class Plugin:
    """Registers the provider, with a window or without (qgis_process)."""

    def __init__(self, iface):
        self.iface = iface
        self.provider = None

    def initProcessing(self):
        """Called by qgis_process."""
        self.provider = Provider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):
        """Called by QGIS."""
        self.initProcessing()

    def unload(self):
        """Take the algorithms out of the toolbox."""
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
            self.provider = None
