"""Where two detection passes agree on few of their boxes, what they agree on is hardly better than the rest.

Vehicles show at any resolution, mistakes now and then. A picture without a vehicle, full of panels, skylights and
sheds, has its boxes too, and these are of some size. Then vehicles much larger than cars are a bad sign: graves or
tents may be the cars of the reading, and what stands out above them the cars.
"""

from __future__ import annotations

from ..confirmed import OF_MISTAKES
from ..remarks import CAUTION, REFUSAL, Remark, percent
from ..scale import Scale
from ..verdicts import UNUSABLE, one_step_below, worst

LEAST_SEEN = 20  # boxes of both kinds, below which a share says little
# Share of larger vehicles (`Scale.larger_share`) from which they are such a sign. Twelve orthophotos of known scale
# have 0.04 to 0.23, and the two passes agree on 0.83 of that with the most; of 150 rendered towns full of look-alikes
# the five that came out 18 to 50 % too large had 0.26 to 0.52 (`benchmarks/zoom_search.py`, 2026-11-23).
MANY_LARGER = 0.2


def as_agreed(scale: Scale, believed: int, doubtful: int) -> Scale:
    """`scale`, one step lower in its verdict and ``poor`` at best where of all boxes only OF_MISTAKES or fewer are
    `believed`: things of some other size, all alike, are as sure of themselves as vehicles, and anchors follow them.
    Refused where more than MANY_LARGER are larger vehicles besides."""
    seen = believed + doubtful
    if seen < LEAST_SEEN or believed > OF_MISTAKES * seen:
        return scale
    few = Remark(
        CAUTION,
        f"two detection passes agree on {believed} of {seen} boxes ({percent(believed / seen)}), as few as of "
        "mistakes: see whether there are vehicles at all",
    )
    lower = scale.remarked(few, at_best=worst(one_step_below(scale.verdict), "poor"))
    if scale.larger_share <= MANY_LARGER:
        return lower
    remark = Remark(
        REFUSAL,
        f"{percent(scale.larger_share)} of the boxes are much larger than cars, where most boxes are mistakes: these "
        "may be the cars, and the others something else",
        "Inspect the boxes (--save-detections), or say roughly how large a pixel is (--gsd-hint METRES_PER_PIXEL)",
    )
    return lower.remarked(remark, at_best=UNUSABLE)
