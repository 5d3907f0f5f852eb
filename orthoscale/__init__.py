"""orthoscale: metres for structure from motion, with vehicles as the ruler.

import orthoscale
result = orthoscale.estimate("ortho.tif", fleet="DE")
result.scale.value, result.scale.interval90, result.vehicles
orthoscale.fix("model/", "scaled/", fleet="US")

Progress is logged to the logger ``orthoscale``.
"""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING, Any

from .system import libz
from .version import __version__ as __version__

__all__ = [
    "Boxes",
    "Calibration",
    "Detections",
    "Fleet",
    "OrthoscaleError",
    "Result",
    "Scale",
    "apply",
    "calibrate",
    "check",
    "estimate",
    "fix",
    "load_calibration",
    "load_detections",
    "load_fleet",
    "photo",
    "save_calibration",
    "save_detections",
]

libz.settle()
# onnxruntime's wheels (1.31 at least) send telemetry to their maker's server, from the first import on. Pictures and
# their names are nobody's business, so it is off; set the variable to 0 to allow it.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
# Numpy's f2py, which scipy imports, takes this variable of build systems for a number, and ends the process if it is
# none, such as empty. Nothing here depends on it.
if not os.environ.get("SOURCE_DATE_EPOCH", "0").isdecimal():
    del os.environ["SOURCE_DATE_EPOCH"]

if TYPE_CHECKING:
    from .actions.apply import apply
    from .actions.calibrate import calibrate
    from .actions.check import check
    from .actions.estimate import estimate
    from .actions.fix import fix
    from .core.boxes import Boxes
    from .core.calibration import Calibration
    from .core.detections import Detections
    from .core.fleet import Fleet
    from .core.scale import Scale
    from .errors import OrthoscaleError
    from .fleets import load_fleet
    from .formats.calibration import load_calibration, save_calibration
    from .formats.detections.own import load_detections, save_detections
    from .photos.survey import photo
    from .report.result import Result

_HOME = {
    "Boxes": "core.boxes",
    "Calibration": "core.calibration",
    "Detections": "core.detections",
    "Fleet": "core.fleet",
    "OrthoscaleError": "errors",
    "Result": "report.result",
    "Scale": "core.scale",
    "apply": "actions.apply",
    "calibrate": "actions.calibrate",
    "check": "actions.check",
    "estimate": "actions.estimate",
    "fix": "actions.fix",
    "load_calibration": "formats.calibration",
    "load_detections": "formats.detections.own",
    "load_fleet": "fleets",
    "photo": "photos.survey",
    "save_calibration": "formats.calibration",
    "save_detections": "formats.detections.own",
}

logging.getLogger(__name__).addHandler(logging.NullHandler())  # silent unless the application sets up logging


def __getattr__(name: str) -> Any:
    """Load public names on first use, so that `import orthoscale` costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
