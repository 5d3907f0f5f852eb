"""The coarse pass over a large picture: finds at little cost which tiles may contain vehicles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..core.detections import Tile
from ..core.source import Picture
from ..system.threads import Threads
from .detector import Detector
from .tiles import look

FAR = 0.25  # resampling factor as a share of the sweep's: a sixteenth of its pixels
FAR_SCORE = 0.5  # least confidence of a box there; empty ground seldom reaches it at so low a resolution
MANY_TILES = 64  # tiles from which a coarse pass pays
FAR_TILES = 64  # tiles in its sample; half a second on two cores
UNPROMISING = 0.125  # weight of tiles that showed nothing, or were not sampled; not 0, since the pass makes mistakes


def coarse_pass(
    jobs: Sequence[tuple[Picture, Tile]],
    order: np.ndarray,
    detect: Detector,
    workers: int,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """(N,) weights for the order in which to visit the tiles `jobs`, from a look at a quarter of the resampling factor
    at the first ones in `order`.

    All tiles that show vehicles weigh the same, however many they show: so each vehicle has the same chance to be
    seen, be it in a car park or in front of a lonely house.
    """
    if len(jobs) < MANY_TILES:
        return np.ones(len(jobs))

    weight = np.full(len(jobs), UNPROMISING)
    chosen = np.sort(order[:FAR_TILES]).tolist()
    with Threads(workers) as pool:
        for k, promised in enumerate(pool.map(lambda number: hint(jobs[number], detect), chosen)):
            weight[chosen[k]] = 1.0 if promised else UNPROMISING
            if progress:
                progress(k + 1, len(chosen))
    return weight


def hint(job: tuple[Picture, Tile], detect: Detector) -> bool:
    """Whether one tile, looked at coarsely, shows anything like a vehicle."""
    picture, tile = job
    size = {"out_width": max(1, round(tile.out_width * FAR)), "out_height": max(1, round(tile.out_height * FAR))}
    return len(look(picture, replace(tile, **size), lambda image: detect(image, threshold=FAR_SCORE))) > 0
