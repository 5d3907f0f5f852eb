"""Detect vehicles: the boxes of `orthoscale estimate --exhaustive`."""

from qgis.core import QgsProcessing, QgsProcessingParameterVectorDestination

from .program import OrthoscaleAlgorithm, report_scale, run


class Vehicles(OrthoscaleAlgorithm):
    """All boxes of an orthophoto as polygons, where the raster lies."""

    OUTPUT = "OUTPUT"

    def name(self):
        """Its id."""
        return "vehicles"

    def displayName(self):
        """As the toolbox shows it."""
        return "Detect vehicles"

    def shortHelpString(self):
        """Beside the dialog."""
        return (
            "All vehicles of an orthophoto as oriented boxes, with their confidence, in the place of the raster. "
            "Boxes that were corrected by hand go back in by orthoscale --detections."
        )

    def initAlgorithm(self, configuration=None):
        """Its parameters and outputs."""
        self.add_input()
        self.addParameter(
            QgsProcessingParameterVectorDestination(self.OUTPUT, "Vehicles", QgsProcessing.TypeVectorPolygon)
        )
        self.add_scale()

    def supportedOutputVectorLayerExtensions(self):
        """What the program writes."""
        return ["gpkg", "geojson"]

    def processAlgorithm(self, parameters, context, feedback):
        """Call the program; QGIS loads the layer."""
        out = self.parameterAsOutputLayer(parameters, self.OUTPUT, context)
        words = ["estimate", *self.input_words(parameters, context), "--exhaustive", "--save-detections", out]
        report = run([*words, "--overwrite"], feedback)
        return {self.OUTPUT: out, **report_scale(report, feedback)}
