"""Scale an orthophoto: `orthoscale fix`."""

import os

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingOutputFile,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterBoolean,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterString,
)

from .program import OrthoscaleAlgorithm, report_scale, run


class Fix(OrthoscaleAlgorithm):
    """A copy with the pixel size that the vehicles give, and the vehicles as a styled layer."""

    KEEP, OVERRIDE, DISTANCE, OUTPUT = "KEEP_ORIGIN", "OVERRIDE", "KNOWN_DISTANCE", "OUTPUT"

    def name(self):
        """Its id."""
        return "fix"

    def displayName(self):
        """As the toolbox shows it."""
        return "Scale an orthophoto by its vehicles"

    def shortHelpString(self):
        """Beside the dialog."""
        return (
            "Finds the ground sampling distance of an orthophoto from the vehicles in it, and writes a copy with that "
            "pixel size. The pixels are not changed, nor is the input. Vehicles that were used are blue, rejected "
            "ones orange. A page beside the output says how far to trust the scale."
        )

    def initAlgorithm(self, configuration=None):
        """Its parameters and outputs."""
        self.add_input()
        self.addParameter(
            QgsProcessingParameterBoolean(self.KEEP, "Keep the CRS, corner and rotation (else: local metres)", True)
        )
        self.addParameter(
            QgsProcessingParameterBoolean(self.OVERRIDE, "Rescale although it claims to be in metres", False)
        )
        self.addParameter(
            QgsProcessingParameterString(
                self.DISTANCE, "Known distance: X,Y X,Y METRES [SIGMA], in pixels", optional=True
            )
        )
        self.addParameter(QgsProcessingParameterRasterDestination(self.OUTPUT, "Scaled orthophoto"))
        self.addOutput(QgsProcessingOutputVectorLayer("VEHICLES", "Vehicles"))
        self.addOutput(QgsProcessingOutputFile("REPORT", "Report"))
        self.add_scale()

    def processAlgorithm(self, parameters, context, feedback):
        """Call the program, and show what it wrote."""
        out = self.parameterAsOutputLayer(parameters, self.OUTPUT, context)
        words = ["fix", *self.input_words(parameters, context), "--out", out, "--also", "gpkg", "--overwrite"]
        words += ["--keep-origin"] if self.parameterAsBool(parameters, self.KEEP, context) else []
        words += ["--override"] if self.parameterAsBool(parameters, self.OVERRIDE, context) else []
        distance = self.parameterAsString(parameters, self.DISTANCE, context).strip()
        words += ["--known-distance", distance] if distance else []
        report = run(words, feedback)
        vehicles = f"{out}.gpkg"
        if context.willLoadLayerOnCompletion(out):
            details = QgsProcessingContext.LayerDetails("Vehicles", context.project(), "VEHICLES")
            context.addLayerToLoadOnCompletion(f"{vehicles}|layername=vehicles", details)
        page = f"{out}.html"
        feedback.pushInfo(f"Report: {page}" if os.path.isfile(page) else "There is no report.")
        return {self.OUTPUT: out, "VEHICLES": vehicles, "REPORT": page, **report_scale(report, feedback)}
