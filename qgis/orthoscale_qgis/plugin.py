"""What QGIS loads: it registers the provider of the algorithms."""

from qgis.core import QgsApplication

from .provider import Provider


class Plugin:
    """Adds the provider when it is loaded, takes it away when it is unloaded."""

    def __init__(self):
        self.provider = None

    def initProcessing(self):
        """For qgis_process, which has no window."""
        self.provider = Provider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):
        """For QGIS."""
        self.initProcessing()

    def unload(self):
        """Take the algorithms away."""
        QgsApplication.processingRegistry().removeProvider(self.provider)
