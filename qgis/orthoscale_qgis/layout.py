"""Place courts, pitches and parking on a scaled orthophoto: `orthoscale layout`."""

import os
import tempfile

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
    QgsVectorFileWriter,
)

from .program import TOO_LITTLE, OrthoscaleAlgorithm, run


class Layout(OrthoscaleAlgorithm):
    """Facilities at true size inside a lot."""

    LOT, FACILITIES, CLEARANCE, ERROR, OUTPUT = "LOT", "FACILITIES", "CLEARANCE", "SCALE_ERROR", "OUTPUT"

    def name(self):
        """Its id."""
        return "layout"

    def displayName(self):
        """As the toolbox shows it."""
        return "Place courts and parking at true size"

    def shortHelpString(self):
        """Beside the dialog."""
        return (
            "Places facilities inside a lot on an orthophoto in metres, with their run-off and clear of each other. "
            "Facilities: basketball tennis:2 parking-DE:24; `orthoscale layout --list` shows all. Each says how its "
            "length changes within the scale's 90 % interval, and whether it still fits."
        )

    def initAlgorithm(self, configuration=None):
        """Its parameters and outputs."""
        self.addParameter(QgsProcessingParameterRasterLayer(self.INPUT, "Orthophoto in metres"))
        self.addParameter(
            QgsProcessingParameterFeatureSource(self.LOT, "Lot to build on", [QgsProcessing.TypeVectorPolygon])
        )
        self.addParameter(QgsProcessingParameterString(self.FACILITIES, "Facilities: CODE, CODE:COUNT, with spaces"))
        self.addParameter(
            QgsProcessingParameterNumber(
                self.CLEARANCE, "Distance between neighbours [m]", QgsProcessingParameterNumber.Double, 1.0, minValue=0
            )
        )
        self.addParameter(
            QgsProcessingParameterNumber(
                self.ERROR,
                "Half of the scale's 90 % interval [%], if there is no report beside the orthophoto",
                QgsProcessingParameterNumber.Double,
                optional=True,
                minValue=0,
            )
        )
        self.addParameter(QgsProcessingParameterFolderDestination(self.OUTPUT, "Folder for the layout"))
        self.addOutput(QgsProcessingOutputVectorLayer("AREAS", "Playing areas"))

    def processAlgorithm(self, parameters, context, feedback):
        """Write the lot to a file, call the program, and show the areas and lines."""
        raster = self.input_file(parameters, context)
        out = self.parameterAsString(parameters, self.OUTPUT, context)
        with tempfile.TemporaryDirectory() as folder:
            lot = os.path.join(folder, "lot.gpkg")
            self._save_lot(parameters, context, lot)
            words = ["layout", raster, "--lot", lot, "--out", out]
            for code in self.parameterAsString(parameters, self.FACILITIES, context).split():
                words += ["--facility", code]
            words += ["--clearance", str(self.parameterAsDouble(parameters, self.CLEARANCE, context))]
            if parameters.get(self.ERROR) is not None:
                words += ["--scale-error", str(self.parameterAsDouble(parameters, self.ERROR, context))]
            if os.path.isdir(out) and not os.listdir(out):
                os.rmdir(out)  # QGIS makes it; the program wants to make it itself
            if run([*words, "--overwrite"], feedback, (TOO_LITTLE,)) is None:  # that some do not fit is a warning
                raise QgsProcessingException("Nothing fits on the lot, and nothing was written")
        package = os.path.join(out, "layout.gpkg")
        for name in ("lines", "facilities"):
            details = QgsProcessingContext.LayerDetails(f"Layout: {name}", context.project(), name)
            context.addLayerToLoadOnCompletion(f"{package}|layername={name}", details)
        return {self.OUTPUT: out, "AREAS": f"{package}|layername=facilities"}

    def _save_lot(self, parameters, context, path):
        lot = self.parameterAsSource(parameters, self.LOT, context)
        options = QgsVectorFileWriter.SaveVectorOptions()
        options.driverName = "GPKG"
        writer = QgsVectorFileWriter.create(
            path, lot.fields(), lot.wkbType(), lot.sourceCrs(), context.transformContext(), options
        )
        for feature in lot.getFeatures():
            writer.addFeature(feature)
        if writer.hasError():
            raise QgsProcessingException(f"The lot cannot be written: {writer.errorMessage()}")
        del writer  # closes the file
