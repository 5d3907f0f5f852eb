"""Detect vehicles: the boxes of `orthoscale estimate --exhaustive`."""

import os

from qgis.core import QgsProcessing, QgsProcessingParameterVectorDestination

from .program import DISAGREES, TOO_LITTLE, OrthoscaleAlgorithm, report_scale, run


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
            "All vehicles of an orthophoto as oriented boxes, with their confidence, in the place of the raster; also "
            "where they are too few or too unlike for a scale. Boxes that were corrected by hand go back in by "
            "orthoscale --detections."
        )

    def initAlgorithm(self, configuration=None):
        """Its parameters and outputs."""
        self.add_input()
        self.addParameter(
            QgsProcessingParameterVectorDestination(self.OUTPUT, "Vehicles", QgsProcessing.TypeVectorPolygon)
        )
        self.add_scale()

    def processAlgorithm(self, parameters, context, feedback):
        """Call the program; QGIS loads the layer, also one whose boxes give no scale."""
        out = self.parameterAsOutputLayer(parameters, self.OUTPUT, context)
        words = ["estimate", *self.input_words(parameters, context), "--exhaustive", "--save-detections", out]
        former = written_at(out)
        no_scale = (TOO_LITTLE, DISAGREES)
        report = run([*words, "--overwrite"], feedback, no_scale, lambda: written_at(out) not in (None, former))
        return {self.OUTPUT: out, **({} if report is None else report_scale(report, feedback))}


def written_at(path):
    """Which file is at `path`, and when it was written; None without one."""
    if not os.path.isfile(path):
        return None
    there = os.stat(path)
    return there.st_ino, there.st_mtime_ns
