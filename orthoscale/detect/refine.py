"""Test-time augmentation (`--refine`): detected vehicles are detected again in rotated pictures and at neighbouring
resampling factors.

The median over these views has less noise than a single box, and their spread is part of the box's own noise
(`Boxes.sigma`). Rotations are by 90 degrees, which needs no resampling; the factors are a quarter octave higher and
lower, so that a margin in pixels is the same on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.angles import axis_angle
from ..core.boxes import SAME_VEHICLE, Boxes, matched, suppress
from ..core.detections import Tile
from ..core.normal import of_median
from ..core.progress import Progress
from ..core.source import Picture
from ..system.threads import Threads
from .tiles import Detect, place, read, tiles

FEWEST_VIEWS = 3  # views of a vehicle, the first included, from which their median is better than a single box
# The variance over all boxes is a prior for that of each box, with the weight of this many views (Smyth 2004, moderated
# variances): five views alone give a standard deviation only to within a third.
PRIOR_VIEWS = 4


@dataclass(frozen=True)
class View:
    """quarters : counter-clockwise turns by 90 degrees. zoom : as a multiple of the first view's."""

    quarters: int
    zoom: float


VIEWS = (View(1, 1.0), View(2, 1.0), View(0, 2**0.25), View(0, 2**-0.25))


def refined(
    pictures: Sequence[Picture],
    found: dict[str, Boxes],
    zoom: float,
    noise: Sequence[float],
    detect: Detect,
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, Boxes]:
    """The boxes `found` in `pictures` at `zoom`, by name, each with the median size and place of its views.

    noise : (2,) one sigma of length and width in a single view [detector px]. Boxes that too few views show are
    unchanged.
    """
    jobs = [
        (picture, tile, number)
        for picture in pictures
        for number, view in enumerate(VIEWS)
        for tile in _with_vehicles(tiles(picture, zoom * view.zoom), found.get(picture.name, Boxes.empty()))
    ]
    seen: dict[tuple[str, int], list[Boxes]] = {}
    with Threads(workers) as pool:
        looks = pool.map(lambda job: look_turned(job[0], job[1], VIEWS[job[2]].quarters, detect), jobs)
        for done, ((picture, _, number), boxes) in enumerate(zip(jobs, looks, strict=True), 1):
            seen.setdefault((picture.name, number), []).append(boxes)
            if progress:
                progress("Refining boxes", done, len(jobs))
    noise_px = np.asarray(noise) / zoom
    return {
        name: agreed(boxes, [suppress(Boxes.concatenate(seen.get((name, k), []))) for k in range(len(VIEWS))], noise_px)
        for name, boxes in found.items()
    }


def look_turned(picture: Picture, tile: Tile, quarters: int, detect: Detect) -> Boxes:
    """Whole vehicles in a tile that is rotated before the detector sees it, in the picture's pixels."""
    image = read(picture, tile)
    boxes = detect(np.ascontiguousarray(np.rot90(image, quarters)))
    height, width = image.shape[:2]
    # The inverse of what np.rot90 does to a point (x, y) of an image of width x height.
    x, y = boxes.centre.T
    back = {0: (x, y), 1: (width - y, x), 2: (width - x, height - y), 3: (y, height - x)}[quarters % 4]
    turned = np.column_stack([*back, boxes.length, boxes.width, boxes.angle + quarters * np.pi / 2])
    return place(Boxes(turned, boxes.score), tile)


def agreed(boxes: Boxes, views: Sequence[Boxes], noise: np.ndarray) -> Boxes:
    """`boxes` with the median centre, size and angle of themselves and of their counterparts in `views`, and with their
    own sigma.

    noise : (2,) one sigma of length and width in a single view [px]. Its part that differs between views is replaced by
    that of their median; the part that all views share (paint, shade, blur) stays.
    """
    if not len(boxes):
        return boxes
    rows = np.full((1 + len(views), len(boxes), 5), np.nan)
    rows[0] = boxes.xylwa
    for row, view in zip(rows[1:], views, strict=True):
        i, j, _ = matched(boxes, view, SAME_VEHICLE)
        row[i] = view.xylwa[j]
    count = np.isfinite(rows[..., 0]).sum(0)
    rows[..., 4] = axis_angle(rows[..., 4] - boxes.angle)  # rotation relative to the first
    rows[..., 2:4] = np.log(rows[..., 2:4])
    xylwa = np.nanmedian(rows, axis=0)
    xylwa[:, 2:4] = np.exp(xylwa[:, 2:4])
    xylwa[:, 4] += boxes.angle
    many = count >= FEWEST_VIEWS
    sigma = np.full((len(boxes), 2), np.nan)
    if many.any():
        freedom = (count[many] - 1)[:, None]
        variance = np.nanvar(rows[:, many, 2:4], axis=0, ddof=1)
        usual = (freedom * variance).sum(0) / freedom.sum()
        size = xylwa[many, 2:4]
        own = (freedom * variance + PRIOR_VIEWS * usual) / (freedom + PRIOR_VIEWS) * size**2
        shared = np.maximum(noise**2 - own.mean(0), 0)
        sigma[many] = np.sqrt(shared + of_median(count[many])[:, None] * own) / size
    return replace(boxes, xylwa=np.where(many[:, None], xylwa, boxes.xylwa), sigma=sigma)


def _with_vehicles(places: Sequence[Tile], boxes: Boxes) -> list[Tile]:
    x, y = boxes.centre.T
    return [t for t in places if ((x >= t.x) & (x <= t.x + t.width) & (y >= t.y) & (y <= t.y + t.height)).any()]
