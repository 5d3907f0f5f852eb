"""Check the ground sampling distance that an orthophoto claims: `orthoscale check`."""

from qgis.core import QgsProcessingException, QgsProcessingOutputNumber, QgsProcessingOutputString

from .program import DISAGREES, OrthoscaleAlgorithm, report_scale, run


class Check(OrthoscaleAlgorithm):
    """What the vehicles say of a claim; that it disagrees is a result, not an error."""

    def name(self):
        """Its id."""
        return "check"

    def displayName(self):
        """As the toolbox shows it."""
        return "Check the claimed GSD by the vehicles"

    def shortHelpString(self):
        """Beside the dialog."""
        return (
            "Compares the ground sampling distance that an orthophoto's georeferencing claims with the one that its "
            "vehicles show. Errors below some 8 % do not show. Run it as a batch for an archive."
        )

    def initAlgorithm(self, configuration=None):
        """Its parameters and outputs."""
        self.add_input()
        self.addOutput(QgsProcessingOutputString("CLAIM", "agrees, doubtful, disagrees or has no unit"))
        self.addOutput(QgsProcessingOutputNumber("CLAIMED", "Metres per pixel that it claims"))
        self.add_scale()

    def processAlgorithm(self, parameters, context, feedback):
        """Call the program, and tell what it found."""
        report = run(["check", *self.input_words(parameters, context)], feedback, (DISAGREES,))
        if not report["comparisons"]:  # the scale contradicts itself
            refused = [remark["text"] for remark in report["remarks"] if remark["severity"] == "refusal"]
            raise QgsProcessingException("\n".join(["The claim cannot be judged.", *refused]))
        (claim,) = report["comparisons"]
        feedback.pushInfo(f"The claim of {claim['claimed']:.5g} m/px {claim['verdict']} ({claim['sigmas']:.1f} sigma).")
        for guess in claim["guesses"]:
            feedback.pushInfo(f"Perhaps {guess}.")
        return {"CLAIM": claim["verdict"], "CLAIMED": claim["claimed"], **report_scale(report, feedback)}
