"""orthoscale: metres for structure from motion, with vehicles as the ruler.

import orthoscale
result = orthoscale.estimate("ortho.tif", fleet="DE")
result.scale.value, result.scale.interval90, result.vehicles
orthoscale.fix("model/", "scaled/", fleet="US")

What it does is told to the logger ``orthoscale``.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any

from . import libz

__version__ = "0.1.0"
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
    "photo",
]

libz.settle()

if TYPE_CHECKING:
    from .applying import apply
    from .boxes import Boxes
    from .calibrating import calibrate
    from .calibration import Calibration
    from .claims import check
    from .detections import Detections
    from .errors import OrthoscaleError
    from .fleet import Fleet
    from .photos.survey import photo
    from .pipeline import estimate
    from .pooling.scale import Scale
    from .result import Result
    from .writing import fix

_HOME = {
    "Boxes": "boxes",
    "Calibration": "calibration",
    "Detections": "detections",
    "Fleet": "fleet",
    "OrthoscaleError": "errors",
    "Result": "result",
    "Scale": "pooling.scale",
    "apply": "applying",
    "calibrate": "calibrating",
    "check": "claims",
    "estimate": "pipeline",
    "fix": "writing",
    "photo": "photos.survey",
}

logging.getLogger(__name__).addHandler(logging.NullHandler())  # who uses the library says whether it speaks


def __getattr__(name: str) -> Any:
    """Public names are loaded on first use, so that `import orthoscale` costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
