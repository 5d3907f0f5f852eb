"""All vehicles of some pictures: the right zoom, then two looks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..boxes import Boxes, matched
from ..detections import Detections
from ..errors import TooLittleEvidence
from .detector import Detector
from .tiles import sweep
from .zoom import ZoomChoice, search_zoom

if TYPE_CHECKING:
    from ..sources.picture import Picture

Progress = Callable[[str, int, int], None]  # what, done, total
# The second look, half an octave coarser: half the pixels, another view of each mistake.
CONFIRMING_ZOOM = 1 / np.sqrt(2)
SAME_BOX = 0.5  # overlap at which two looks show the same vehicle


def find_vehicles(
    pictures: Sequence[Picture],
    detector: Detector | None = None,
    zoom: float | None = None,
    progress: Progress | None = None,
) -> tuple[Detections, ZoomChoice | None]:
    """Sweep `pictures` at the right zoom (searched for unless given), twice; a vehicle must show in both looks.

    detector : the shipped one by default. zoom : detector pixels per picture pixel. Raises TooLittleEvidence.
    """

    def step(what: str) -> Callable[[int, int], None] | None:
        return (lambda done, total: progress(what, done, total)) if progress else None

    detector = detector or Detector()
    choice = None
    if zoom is None:
        choice = search_zoom(pictures, detector, detector.card, step("Looking for the right zoom"))
        zoom = choice.zoom
        if choice.vehicle_px is None:
            raise TooLittleEvidence(
                f"no vehicles found at any zoom from {choice.table[0][0]:.2g} to {choice.table[-1][0]:.2g} "
                f"({sum(row[1] for row in choice.table)} doubtful boxes, {sum(row[2] for row in choice.table)} of them "
                "seen at two zooms)",
                "If there are vehicles, say how large: --gsd-hint METRES_PER_PIXEL or --zoom FACTOR.",
            )
    fine = sweep(pictures, zoom, detector, step("Finding vehicles"))
    coarse = sweep(pictures, zoom * CONFIRMING_ZOOM, detector, step("Looking twice"))
    boxes, doubtful = {}, {}
    for name, found in fine.items():
        i, j, _ = matched(found, coarse[name], SAME_BOX)
        xylwa = found.xylwa[i].copy()
        xylwa[:, 2:4] = np.sqrt(xylwa[:, 2:4] * coarse[name].xylwa[j, 2:4])
        boxes[name] = Boxes(xylwa, (found.score[i] + coarse[name].score[j]) / 2)
        alone = np.ones(len(found), bool)
        alone[i] = False
        doubtful[name] = found[alone]
    card = detector.card
    return Detections(boxes, zoom, card.ruler, card.effective_height, card.name, detector.sha256, doubtful), choice
