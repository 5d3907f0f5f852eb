"""Selects the frames of a model to process: those that show new ground, until all of it was seen from many directions.

Frames overlap: each vehicle is in ten of them or more, and after some views another one adds hardly anything. But the
first views add much: false detections do not recur, and the height that boxes enclose follows from steep and flat
views. So no part of the ground is left out, unlike in an orthophoto; only repeated views are. The selection follows
from the poses alone and is thus independent of the vehicles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..core.projection.view import LOWEST_ELEVATION, even_pixels
from ..core.source import NEAR_NADIR, PosedSet

# With fewer frames than this, all are processed: it takes seconds, and so few frames show few vehicles, so each counts.
FEW_FRAMES = 64
# Views of a place that are enough, counted separately for steep and for flat ones. On the 172 frames of `sheffield` the
# scale from the frames alone then differs by 0.7 % from that of all frames, and the pooled scale by 0.1 %; their
# sampling parts are 1.4 and 2.0 %. With 8 views it is 1.6 and 0.3 %, with 4 views 2.4 and 0.3 %. A sweep that ended
# sooner, at a sampling part of 2 % over three times that ground, was up to 13 % off: self-calibration needs the views.
ENOUGH_VIEWS = 12
PLACE_SIDE = 0.25  # side of a place, in camera heights: large enough that each frame that shows it has a point in it
ASKED_AT = (24, 18)  # points of a frame, across and down, that are projected to find out which places it shows


@dataclass(frozen=True)
class Cover:
    """order : (P,) numbers of the pictures. enough : how many of them, from the first, show every place ENOUGH_VIEWS
    times, or as often as all pictures together do."""

    order: np.ndarray
    enough: int

    def first(self, count: int) -> list[int]:
        """The first `count` pictures of the order, sorted by their numbers."""
        return sorted(self.order[:count].tolist())


def covering(places: Sequence[np.ndarray], views: int = ENOUGH_VIEWS) -> Cover:
    """An order of pictures that soon shows every place `views` times.

    places : of each picture (K, 3), as in `places_seen`. Greedy: the next picture is that whose places are worth most,
    where a place's n-th view is worth 1 / n^2, about what it takes off the variance of a mean. A greedy cover's value
    is at least 1 - 1/e of the best one's (Nemhauser, Wolsey and Fisher 1978).
    """
    count = len(places)
    rows = np.repeat(np.arange(count), [len(each) for each in places])
    known, columns = np.unique(np.concatenate([np.empty((0, 3), int), *places]), axis=0, return_inverse=True)
    shows = sparse.csr_array((np.ones(len(rows)), (rows, columns.ravel())), shape=(count, len(known)))
    seen, left, order = np.zeros(len(known)), np.ones(count, bool), []
    while left.any():
        worth = np.where(left, shows @ np.where(seen < views, (1 + seen) ** -2.0, 0.0), 0.0)
        best = int(np.argmax(worth))
        if not worth[best] > 0:
            break
        order.append(best)
        left[best] = False
        seen[shows.indices[shows.indptr[best] : shows.indptr[best + 1]]] += 1
    return Cover(np.concatenate([np.array(order, int), np.flatnonzero(left)]), len(order))


def places_seen(source: PosedSet, names: Sequence[str]) -> dict[str, np.ndarray]:
    """By frame name the places (K, 3) that each frame sees: column and row on the ground's plane, and 1 if seen from
    near the nadir, else 0. A place that is seen both ways counts as two."""
    centres = np.array([source.centre(name) for name in names])
    side = PLACE_SIDE * float(np.median(source.ground.height_above(centres)))
    middle = source.ground.plane(centres).mean(0)  # not the origin, which may lie anywhere: it would choose the frames
    places = {}
    for name in names:
        asked = even_pixels(source.image_size(name), ASKED_AT)
        views, world, ok = source.views(name, asked, LOWEST_ELEVATION)
        place = np.floor((source.ground.plane(world[ok]) - middle) / side).astype(int)
        steep = views.elevation[ok] >= np.radians(NEAR_NADIR)
        places[name] = np.unique(np.column_stack([place, steep]), axis=0)
    return places


def seen_from_above(places: np.ndarray) -> np.ndarray:
    """Those of `places` (K, 3) that a frame sees from near the nadir: what its ground picture shows."""
    return places[places[:, 2] == 1]
