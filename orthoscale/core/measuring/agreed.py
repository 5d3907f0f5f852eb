"""Where two detection passes agree on few of their boxes, what they agree on is hardly better than the rest.

Vehicles show at any resolution, mistakes now and then. A picture without a vehicle, full of panels, skylights and
sheds, has its boxes too, and these are of some size.
"""

from __future__ import annotations

from dataclasses import replace

from ..confirmed import OF_MISTAKES
from ..remarks import CAUTION, Remark, by_severity, percent
from ..scale import Scale
from ..verdicts import one_step_below, worst

LEAST_SEEN = 20  # boxes of both kinds, below which a share says little


def as_agreed(scale: Scale, believed: int, doubtful: int) -> Scale:
    """`scale`, one step lower in its verdict and ``poor`` at best where of all boxes only OF_MISTAKES or fewer are
    `believed`: things of some other size, all alike, are as sure of themselves as vehicles, and anchors follow them."""
    seen = believed + doubtful
    if seen < LEAST_SEEN or believed > OF_MISTAKES * seen:
        return scale
    remark = Remark(
        CAUTION,
        f"two detection passes agree on {believed} of {seen} boxes ({percent(believed / seen)}), as few as of "
        "mistakes: see whether there are vehicles at all",
    )
    lower = worst(one_step_below(scale.verdict), "poor")
    return replace(scale, verdict=lower, remarks=by_severity((*scale.remarks, remark)))
