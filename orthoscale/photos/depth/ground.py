"""The altitude from a depth map, over the ground around the vehicles; and tests for maps that are not metric depth.

The depth of a pixel, divided by the depth that level ground 1 m below the camera would have there, is the height [m] of
the camera above the pixel's point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from ...core.boxes import Boxes
from ...core.normal import ROBUST_SD
from ...errors import InputError
from ..measure import Interval90, Photo

# Where ground is looked for: at RINGS widths of the vehicle from its box, but outside of every box grown by CLEARED,
# which may still show roofs and wheels; between parked vehicles there is half a width.
CLEARED, RINGS = 1.15, (0.3, 0.5, 0.7, 0.9)
ALONG_SIDE = 6  # points on each side of a ring
FEWEST_POINTS = 8  # of the ground around a vehicle
# In a picture that is not nadir, the depth of level ground grows across the picture. A metric depth grows as much,
# apart from hills and houses; an inverse one falls, a relative one grows by any amount.
GRID = 32  # pixels along each side of a picture that are compared with level ground
TELLING = 0.2  # least log depth of level ground between the nearer and the farther third of a picture, for this test
SLOPE = (0.5, 2.0)  # limits of the growth of log depth against that of level ground
# At nadir, vehicles are nearer than the ground around them. A map is refused if that fails by SIGMAS of coin tosses.
SIGMAS, FEWEST_TOSSED = 3.0, 10
NEAREST_M = 2.0  # [m] no photo of vehicles is taken from lower
FARTHEST_OFF = 10.0  # factor to the altitude by vehicles: no network is that wrong, so the unit is

Kind = Literal["z", "range"]
NO_METRES = "Give a metric depth, in metres or with --depth-factor; relative and inverse depths have no scale."


@dataclass(frozen=True)
class DepthMap:
    """A metric depth of every pixel of a photo.

    metres : (H, W) over all of the photo, at any resolution; NaN where there is no depth. kind : "z" along the optical
    axis, "range" along the ray. origin : its source, for messages.
    """

    metres: np.ndarray
    kind: Kind
    origin: str

    def at(self, photo: Photo, pixels: np.ndarray) -> np.ndarray:
        """(N,) the depth at pixels (N, 2) of `photo` [m], that of the map's nearest pixel."""
        height, width = self.metres.shape
        place = (pixels * [width / photo.tags.width, height / photo.tags.height]).astype(int)
        inside = ((place >= 0) & (place < [width, height])).all(1)
        column, row = np.clip(place, 0, [width - 1, height - 1]).T
        return np.where(inside, self.metres[row, column], np.nan)


@dataclass(frozen=True)
class DepthAltitude:
    """The altitude by a depth map.

    altitude : over the ground around the vehicles, median over them [m]. scatter : relative one sigma over the
    vehicles; errors that the network makes everywhere are not in it. vehicles : number of those around which ground was
    seen.
    """

    altitude: float
    scatter: float
    vehicles: int


def depth_altitude(photo: Photo, depth: DepthMap, boxes: Boxes, by_vehicles: Interval90 | None = None) -> DepthAltitude:
    """The altitude of `photo` by `depth`: the median over the ground around each of `boxes`, then the median over the
    boxes.

    by_vehicles : the altitude by the sizes of the vehicles, if known, to recognise a depth that is not in metres.
    Raises InputError for a map of another field of view, a relative or an inverse depth, and where no ground is seen.
    """
    height, width = depth.metres.shape
    if abs(np.log(width / height * photo.tags.height / photo.tags.width)) > 0.02:
        raise InputError(
            f"{depth.origin}: {width} x {height} depths do not cover the field of view of {photo.name}, "
            f"{photo.tags.width} x {photo.tags.height} px",
            "Give the depth of the whole photo, unturned; any resolution will do.",
        )
    _refuse_relative(photo, depth)
    boxes = boxes[photo.views(boxes.centre, 1.0)[1]]
    if not len(boxes):
        raise InputError(f"{depth.origin}: no vehicle to look for ground around", "Give a photo with vehicles.")
    below = _below(photo, depth, _rings(boxes).reshape(-1, 2)).reshape(len(boxes), -1)
    below[_covered(photo, boxes, _rings(boxes))] = np.nan
    known = np.isfinite(below).sum(1) >= FEWEST_POINTS
    if not known.any():
        raise InputError(f"{depth.origin}: no depth of the ground around the vehicles", "Inspect the depth map.")
    around = np.nanmedian(below[known], axis=1)
    _refuse_inverse(photo, depth, boxes[known], around)
    altitude = float(np.median(around))
    _refuse_unit(depth, altitude, by_vehicles)
    scatter = ROBUST_SD * float(np.median(np.abs(np.log(around / altitude))))
    return DepthAltitude(altitude, scatter, int(known.sum()))


def _below(photo: Photo, depth: DepthMap, pixels: np.ndarray) -> np.ndarray:
    """(N,) how far below the camera the points at `pixels` lie [m]; NaN where level ground is not seen."""
    level, seen = _level(photo, depth.kind, pixels)
    return np.where(seen, depth.at(photo, pixels) / level, np.nan)


def _level(photo: Photo, kind: Kind, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) the depth of level ground 1 m below the camera at `pixels` [m], and whether it is seen there."""
    views, seen = photo.views(pixels, 1.0)
    return (views.ground[:, 2] if kind == "z" else np.linalg.norm(views.ground, axis=1)), seen


def _rings(boxes: Boxes) -> np.ndarray:
    """(N, M, 2) pixels around each box, on rectangles at RINGS widths of the vehicle from it."""
    side = np.linspace(-1, 1, ALONG_SIDE, endpoint=False)
    one = np.ones_like(side)
    square = np.concatenate([np.stack(v, 1) for v in ((side, -one), (one, side), (-side, one), (-one, -side))])
    half = boxes.sides / 2
    reach = half[:, None] + np.array(RINGS)[:, None] * boxes.width[:, None, None]
    local = (square[None, None] * reach[:, :, None]).reshape(len(boxes), -1, 2)
    return boxes.centre[:, None] + local[..., :1] * boxes.along[:, None] + local[..., 1:] * boxes.across[:, None]


def _covered(photo: Photo, boxes: Boxes, pixels: np.ndarray) -> np.ndarray:
    """(N, M) whether `pixels` (N, M, 2) lie in any of the boxes grown by CLEARED, or outside the photo."""
    shrink = min(1.0, 2000 / max(photo.tags.width, photo.tags.height))  # enough for the edges of vehicles
    size = np.ceil(np.array([photo.tags.width, photo.tags.height]) * shrink).astype(int)
    mask = np.zeros(size[::-1], np.uint8)
    grown = boxes.centre[:, None] + CLEARED * (boxes.corners - boxes.centre[:, None])
    for corners in (grown * shrink).round().astype(np.int32):
        cv2.fillConvexPoly(mask, corners, 1)
    place = np.floor(pixels * shrink).astype(int)
    inside = ((place >= 0) & (place < size)).all(-1)
    column, row = np.moveaxis(np.clip(place, 0, size - 1), -1, 0)
    return ~inside | (mask[row, column] > 0)


def _refuse_relative(photo: Photo, depth: DepthMap) -> None:
    """Raise InputError where the depth does not grow across the picture as that of level ground does."""
    steps = (np.arange(GRID) + 0.5) / GRID
    x, y = np.meshgrid(steps * photo.tags.width, steps * photo.tags.height)
    pixels = np.stack([x.ravel(), y.ravel()], 1)
    level, seen = _level(photo, depth.kind, pixels)
    value = depth.at(photo, pixels)
    ok = seen & np.isfinite(value)
    if ok.sum() < GRID:
        return
    level, value = np.log(level[ok]), np.log(value[ok])
    low, high = np.quantile(level, [1 / 3, 2 / 3])
    near, far = level <= low, level >= high
    rise = np.median(level[far]) - np.median(level[near])
    if rise < TELLING:
        return
    slope = float((np.median(value[far]) - np.median(value[near])) / rise)
    if slope < 0:
        raise InputError(f"{depth.origin}: an inverse depth: it falls where the ground is farther", NO_METRES)
    if not SLOPE[0] <= slope <= SLOPE[1]:
        raise InputError(
            f"{depth.origin}: a relative depth, or a wrong pitch: seen at {np.degrees(photo.pitch):.0f} degrees, level "
            f"ground is {np.exp(rise):.2f} times as deep in the far third as in the near one, not "
            f"{np.exp(slope * rise):.2f} times",
            NO_METRES,
        )


def _refuse_inverse(photo: Photo, depth: DepthMap, boxes: Boxes, around: np.ndarray) -> None:
    """Raise InputError where vehicles lie deeper than the ground `around` them (N,) [m] far too often for chance."""
    middle = np.stack(np.meshgrid([-0.2, 0.0, 0.2], [-0.2, 0.0, 0.2]), -1).reshape(-1, 2)
    sides = (boxes.corners[:, 1] - boxes.corners[:, 0], boxes.corners[:, 3] - boxes.corners[:, 0])
    pixels = boxes.centre[:, None] + middle[:, :1] * sides[0][:, None] + middle[:, 1:] * sides[1][:, None]
    inside = np.median(_below(photo, depth, pixels.reshape(-1, 2)).reshape(len(boxes), -1), axis=1)
    deeper, nearer = int((inside > around).sum()), int((inside < around).sum())
    if deeper + nearer >= FEWEST_TOSSED and deeper - nearer > SIGMAS * np.sqrt(deeper + nearer):
        raise InputError(
            f"{depth.origin}: an inverse depth: {deeper} of {deeper + nearer} vehicles lie below the ground there",
            NO_METRES,
        )


def _refuse_unit(depth: DepthMap, altitude: float, by_vehicles: Interval90 | None) -> None:
    """Raise InputError for an altitude at which nobody flies, or that is far from the one by the vehicles."""
    if altitude < NEAREST_M:
        raise InputError(
            f"{depth.origin}: its ground lies {altitude:.3g} m below the camera: a relative depth, or another unit",
            NO_METRES,
        )
    if by_vehicles is not None and abs(np.log(altitude / by_vehicles.value)) > np.log(FARTHEST_OFF):
        raise InputError(
            f"{depth.origin}: its ground lies {altitude:.4g} m below the camera, by the vehicles "
            f"{by_vehicles.value:.4g} m: another unit",
            NO_METRES,
        )
