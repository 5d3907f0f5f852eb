"""The group of algorithms in the Processing toolbox, and its setting: where the program is."""

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis.core import QgsProcessingProvider

from .check import Check
from .fix import Fix
from .layout import Layout
from .program import DEFAULT, SETTING
from .vehicles import Vehicles


class Provider(QgsProcessingProvider):
    """orthoscale in the toolbox."""

    def id(self):
        """As in `qgis_process run orthoscale:fix`."""
        return "orthoscale"

    def name(self):
        """As people read it."""
        return "orthoscale"

    def supportedOutputRasterLayerExtensions(self):
        """As which files the program writes rasters; QGIS offers no others, whatever its default is."""
        return ["tif", "tiff"]

    def supportedOutputVectorLayerExtensions(self):
        """The same of layers."""
        return ["gpkg", "geojson"]

    def load(self):
        """Make the setting, then the algorithms."""
        ProcessingConfig.settingIcons[self.name()] = self.icon()
        ProcessingConfig.addSetting(Setting(self.name(), SETTING, "Path of the program orthoscale", DEFAULT))
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self):
        """Take the setting away."""
        ProcessingConfig.removeSetting(SETTING)

    def loadAlgorithms(self):
        """One of each."""
        for algorithm in (Fix(), Check(), Vehicles(), Layout()):
            self.addAlgorithm(algorithm)
