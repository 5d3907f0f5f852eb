"""If the scale search leaves two possible lengths of the vehicles, the finder decides between them.

The search counts the detections of one small network at many resampling factors. This network mistakes many graves and
panels for vehicles; the finder, the larger network that makes the second detection pass of a sweep, hardly any. So a
sample is swept at both lengths, and the one at which more boxes are confirmed is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from ..core.boxes import Boxes
from ..core.detections import ZoomChoice
from ..core.source import Picture
from .detector import Detector
from .effort import Effort
from .sweep import sweep_twice
from .workers import visitor
from .zoom import sample, zoom_for

# The finder is asked if the second best length has at least this share of the best one's significance. Real orthophotos
# have less (`core.confirmed.AS_LIKELY`), and so need no more time.
CONTESTED = 0.2
# Boxes count for a length if the log of their ratio to it is within this: the extremes of a fleet, but no farther than
# half of the way to the other length.
OF_THAT_LENGTH = 0.4


def settled(
    choice: ZoomChoice,
    pictures: Sequence[Picture],
    detector: Detector,
    effort: Effort,
    progress: Callable[[int, int], None] | None = None,
) -> ZoomChoice:
    """`choice`; if it was contested, with the length first at which more vehicles are confirmed."""
    if detector.confirming is None or choice.vehicle_px is None or not choice.rival_px or choice.rival < CONTESTED:
        return choice
    lengths = [choice.vehicle_px, choice.rival_px]
    near = min(OF_THAT_LENGTH, abs(np.log(lengths[0] / lengths[1])) / 2)
    standing = []
    for done, length in enumerate(lengths, 1):
        standing.append(_standing(length, near, pictures, detector, effort))
        if progress:
            progress(done, len(lengths))
    first, second = np.argsort(standing)[::-1]
    rival = standing[second] / standing[first] if standing[first] > 0 else 1.0
    return replace(
        choice,
        zoom=zoom_for(lengths[first], detector.card),
        vehicle_px=lengths[first],
        rival_px=lengths[second],
        rival=rival,
    )


def _standing(length: float, near: float, pictures: Sequence[Picture], detector: Detector, effort: Effort) -> float:
    """Evidence for vehicles of `length` [px of the pictures], give or take `near` [log]: the number of confirmed boxes
    times their share of all."""
    jobs = [(pictures[k], tile) for k, tile in sample(pictures, zoom_for(length, detector.card), effort.seed)]
    with ExitStack() as open_things:
        visit = open_things.enter_context(visitor(detector, effort.threads, None))
        found = sweep_twice(jobs, np.arange(len(jobs)), visit, sure=detector.sure, passes=detector.passes)
    boxes, doubtful = (Boxes.concatenate(list(some.values())) for some in (found.boxes, found.doubtful))
    sure, unsure = (int((np.abs(np.log(some.length / length)) < near).sum()) for some in (boxes, doubtful))
    return sure**2 / (sure + unsure + 1)
