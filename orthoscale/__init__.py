"""orthoscale: metres for structure from motion, with vehicles as the ruler.

import orthoscale
result = orthoscale.estimate("ortho.tif", fleet="DE")
result.scale.value, result.scale.interval90
orthoscale.fix("model/", "scaled/", fleet="US")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import libz

__version__ = "0.1.0"
__all__ = ["Boxes", "Detections", "Fleet", "OrthoscaleError", "Result", "Scale", "estimate", "fix"]

libz.settle()

if TYPE_CHECKING:
    from .boxes import Boxes
    from .detections import Detections
    from .errors import OrthoscaleError
    from .fleet import Fleet
    from .pipeline import estimate
    from .pooling.scale import Scale
    from .result import Result
    from .writing import fix

_HOME = {
    "Boxes": "boxes",
    "Detections": "detections",
    "Fleet": "fleet",
    "OrthoscaleError": "errors",
    "Result": "result",
    "Scale": "pooling.scale",
    "estimate": "pipeline",
    "fix": "writing",
}


def __getattr__(name: str) -> Any:
    """Public names are loaded on first use, so that `import orthoscale` costs nothing."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
