"""Calling the program orthoscale, in its own environment, and what all algorithms share."""

import json
import os
import shutil
import subprocess
import tempfile
import threading

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import (
    QgsProcessingAlgorithm,
    QgsProcessingException,
    QgsProcessingOutputNumber,
    QgsProcessingOutputString,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
)

SETTING = "ORTHOSCALE_PROGRAM"
DEFAULT = "orthoscale"
DISAGREES = 4  # exit code where evidence disagrees: a result of `check`, an error elsewhere
TOO_LITTLE = 3  # exit code where the evidence is too little for a scale, or the lot for what is to be placed
QGIS_PYTHON = ("PYTHONHOME", "PYTHONPATH")  # of QGIS's own Python, which is not the program's


class OrthoscaleAlgorithm(QgsProcessingAlgorithm):
    """Base of the algorithms: a raster, a fleet, and the program."""

    INPUT, FLEET = "INPUT", "FLEET"

    def createInstance(self):
        """A new one for each run."""
        return type(self)()

    def add_input(self):
        """The raster and the country of its vehicles."""
        self.addParameter(QgsProcessingParameterRasterLayer(self.INPUT, "Orthophoto"))
        self.addParameter(
            QgsProcessingParameterString(
                self.FLEET,
                "Country of the vehicles, by code or name (empty: the country where the orthophoto lies)",
                optional=True,
            )
        )

    def add_scale(self):
        """What `report_scale` gives."""
        self.addOutput(QgsProcessingOutputNumber("SCALE", "Metres per pixel"))
        self.addOutput(QgsProcessingOutputNumber("LOW90", "Lower end of the 90 % interval"))
        self.addOutput(QgsProcessingOutputNumber("HIGH90", "Upper end of the 90 % interval"))
        self.addOutput(QgsProcessingOutputNumber("VEHICLES_USED", "Vehicles that the scale rests on"))
        self.addOutput(QgsProcessingOutputString("VERDICT", "good, fair, poor or unusable"))

    def input_file(self, parameters, context):
        """The file of the raster. Raises QgsProcessingException where there is none, as of a map service."""
        layer = self.parameterAsRasterLayer(parameters, self.INPUT, context)
        if layer is None:
            raise QgsProcessingException(self.invalidRasterError(parameters, self.INPUT))
        path = layer.source().split("|")[0]
        if not os.path.isfile(path):
            raise QgsProcessingException(f"{path} is no file: export the layer as a GeoTIFF first")
        return path

    def input_words(self, parameters, context):
        """The file of the raster, and --fleet where it is named."""
        fleet = self.parameterAsString(parameters, self.FLEET, context).strip()
        return [self.input_file(parameters, context), *(["--fleet", fleet] if fleet else [])]


def report_scale(report, feedback):
    """The outputs of `add_scale`, told to the user too."""
    low, high = report["interval90"]
    feedback.pushInfo(
        f"{report['scale']:.5g} {report['unit']}, 90 % from {low:.5g} to {high:.5g}: "
        f"{report.get('verdict', '')}, {report['vehicles_used']} vehicles of fleet {report['fleet']}"
    )
    for remark in report["remarks"]:
        tell = feedback.pushInfo if remark["severity"] == "info" else feedback.pushWarning
        tell(remark["text"])
    return {
        "SCALE": report["scale"],
        "LOW90": low,
        "HIGH90": high,
        "VEHICLES_USED": report["vehicles_used"],
        "VERDICT": report.get("verdict", ""),
    }


def run(words, feedback, accepted=(), needed=lambda: True):
    """The JSON that `orthoscale WORDS --json` prints; None where there is none, with an exit code that is accepted.

    accepted : exit codes that are no error besides 0, where `needed` holds afterwards. Raises QgsProcessingException
    with what the program said.
    """
    program = ProcessingConfig.getSetting(SETTING) or DEFAULT
    if shutil.which(program) is None:
        raise QgsProcessingException(
            f"The program {program} is not there. Install it (pip install orthoscale), and give its path in Settings, "
            "Options, Processing, Providers, orthoscale."
        )
    command = [program, *words, "--json"]
    feedback.pushCommandInfo(" ".join(command))
    environment = {name: value for name, value in os.environ.items() if name not in QGIS_PYTHON}
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as complained:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=said, stderr=complained, env=environment, text=True
        )
        wait_for(process, feedback)
        said.seek(0)
        complained.seek(0)
        complaint = complained.read().strip()
        if process.returncode != 0 and not (process.returncode in accepted and needed()):
            raise QgsProcessingException(complaint or f"orthoscale ended with {process.returncode}")
        tell = feedback.pushWarning if process.returncode else feedback.pushInfo
        tell(complaint)
        report = said.read()
        return json.loads(report) if report or not process.returncode else None


def wait_for(process, feedback):
    """Until `process` ends; the button Cancel ends it, and it takes away what it had begun."""
    over = threading.Event()
    threading.Thread(target=lambda: (process.wait(), over.set()), daemon=True).start()
    while not over.wait(0.2):
        if feedback.isCanceled():
            process.terminate()
