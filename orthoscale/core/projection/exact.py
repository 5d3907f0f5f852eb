"""The exact projection: finds the vehicle on the ground that, seen by the given camera, fills the given box.

The vehicle is a hull on the local ground plane: the full footprint up to the belt line, a narrower cabin above, cut off
at the detector's effective height (its boxes do not enclose the whole silhouette). Its outline is projected in true
perspective. Length, width and position are solved for so that the outline's extents along the box's two axes and its
centre are those of the box. Only the lens distortion is linearised, across one vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from .view import Views

ITERATIONS = 8  # each leaves about a tenth of the error of the one before
# Bumpers reach out furthest about here (49 CFR 581 hits them at 16 to 20 inches, 0.41 to 0.51 m), doors a bit higher.
BEND = 0.4  # [m] walls are vertical up to here; above it they lean in by `Hull.end_lean` and `Hull.side_lean`
LENGTH_PER_WIDTH = 2.4  # of a mid-size car: 4.4 by 1.83 m
FLAT = 0.01  # [m] height of a hull that is no more than an outline on the ground
CHUNK = 1_000  # boxes solved at once; small enough for the processor's cache


@dataclass(frozen=True)
class Hull:
    """A car-like body. Heights in metres; insets and corner as shares of the vehicle's length or width.

    The defaults are those of a mid-size car: belt line at 0.85 m (new cars' bonnets begin at 0.77 m in 2010, at 0.84 m
    in 2024: Transport & Environment 2025), windscreen and rear window slanting inwards, corners rounded by about
    0.25 m. Vehicles differ from that shape, so a lean draws the walls in above BEND, where bumpers reach furthest; a
    negative lean makes up for insets that a van does not have.
    """

    height: float = 0.8  # what the detector's boxes enclose, see `detect.detector.Card` [m]
    belt: float = 0.85
    roof: float = 1.5
    front_inset: float = 0.30  # of the length, at the roof
    rear_inset: float = 0.12  # of the length, at the roof
    side_inset: float = 0.10  # of the width, each side, at the roof
    corner: float = 0.25  # of the width, cut off each corner
    end_lean: float = 0.1  # of front and rear, a share of the length for each metre above BEND [1/m]
    side_lean: float = 0.0  # of each side, a share of the width for each metre above BEND [1/m]

    @property
    def least_lean(self) -> tuple[float, float]:
        """The leans of ends and of sides with which the walls are vertical; smaller ones change nothing [1/m]."""
        inset = self._taper(self.height) / max(self.height - BEND, 1e-9)
        return 0.0 - inset * max(self.front_inset, self.rear_inset), 0.0 - inset * self.side_inset

    def _taper(self, height: float) -> float:
        """Share of the roof's insets at `height` [m]."""
        return min(1.0, max(0.0, height - self.belt) / max(self.roof - self.belt, 1e-9))

    def outline(self) -> tuple[np.ndarray, np.ndarray]:
        """Points whose convex hull is the body: (P, 2) of unit length and unit width, and (P,) heights [m]."""
        bend = min(BEND, self.height)
        levels = {0.0, min(self.belt, self.height), self.height}
        if self.end_lean or self.side_lean:
            levels.add(bend)
        plan, heights = [], []
        for height in sorted(levels):
            share = self._taper(height)
            above = max(0.0, height - bend)
            end, side_in = self.end_lean * above, self.side_lean * above
            front = 0.5 - _within(share * self.front_inset + end)
            rear = -0.5 + _within(share * self.rear_inset + end)
            side = 0.5 - _within(share * self.side_inset + side_in)
            cut_side, cut_long = self.corner, self.corner / LENGTH_PER_WIDTH  # the same cut in metres along both axes
            for x, direction in ((front, -1.0), (rear, 1.0)):
                for y in (side, -side):
                    plan += [(x, y - np.sign(y) * cut_side), (x + direction * cut_long, y)]
            heights += [height] * 8
        return np.array(plan), np.array(heights)


BODIES = {  # by the name that a detector's card may give, if it finds vehicles of one kind
    "car": Hull(),
    # Steep rear, short bonnet, little taper: how far the roof is drawn in cannot be told from size by views alone.
    "van": Hull(belt=1.1, roof=2.0, front_inset=0.18, rear_inset=0.02, side_inset=0.06, corner=0.10, end_lean=0.0),
    "cuboid": Hull(front_inset=0.0, rear_inset=0.0, side_inset=0.0, corner=0.0, end_lean=0.0),
}


def _within(inset: float) -> float:
    """`inset`, limited so that walls neither lean outwards nor meet."""
    return min(max(inset, 0.0), 0.45)


def ground_size(boxes: Boxes, views: Views, metres_per_unit: float, hull: Hull = Hull()) -> np.ndarray:
    """(N, 2) length and width of each vehicle on the ground [units of `views`]; NaN where none explains the box.

    `metres_per_unit`, the pooled scale so far, turns the hull's heights into units. Its error enters only through the
    height's share of the box (about a tenth of the box per 10 % at 60 degrees), so two or three rounds settle it.
    """
    parts = [
        _solve(boxes[part], views[part], metres_per_unit, hull)
        for part in (slice(start, start + CHUNK) for start in range(0, len(boxes), CHUNK))
    ]
    return np.concatenate(parts) if parts else np.empty((0, 2))


def size_by_ends_and_sides(boxes: Boxes, views: Views, metres_per_unit: float, hulls: tuple[Hull, Hull]) -> np.ndarray:
    """(N, 2) as `ground_size`, lengths by the first of `hulls` and widths by the second: boxes need not enclose the
    ends and the sides of vehicles up to the same height."""
    length, width = (ground_size(boxes, views, metres_per_unit, hull) for hull in hulls)
    return np.stack([length[:, 0], width[:, 1]], 1)


def _solve(boxes: Boxes, views: Views, metres_per_unit: float, hull: Hull) -> np.ndarray:
    plan, heights = hull.outline()
    heights = heights / metres_per_unit
    axes = np.stack([boxes.along, boxes.across], 1)  # (N, 2 axes, 2): the box's own, in the image
    to_axes = axes @ views.lens  # (N, 2, 2) from the plane z = 1 to pixels along the box's axes
    along, across = ground_axes(boxes, views)
    # A point X of the camera's space lies (form_k . X) / X_z pixels along box axis k from the box's centre.
    centre = views.ground[:, :2] / views.ground[:, 2:]
    forms = np.concatenate([to_axes, -to_axes @ centre[..., None]], -1)  # (N, 2 forms, 3)
    forms = np.concatenate([forms, np.broadcast_to([[[0.0, 0.0, 1.0]]], (len(boxes), 1, 3))], 1)  # and X_z
    # By how much each form grows for one unit along and across the vehicle, and upwards: (N, 3 forms, 3 directions).
    slopes = forms @ np.stack([along, across, views.normal], -1)
    jacobian = slopes[:, :2, :2] / views.ground[:, 2:, None]  # pixels (N, 2 axes, 2 directions) at the box's centre
    gain = np.abs(np.diagonal(jacobian, axis1=1, axis2=2))
    target = boxes.sides

    # Boxes are the last axis from here on, so that the iterations work on long rows.
    slopes = np.ascontiguousarray(slopes.transpose(1, 2, 0))  # (3 forms, 3 directions, N)
    on_ground, rising = slopes[:, :2], slopes[:, 2:] * heights[:, None]  # rising (3, P, N)
    rising[2] += views.ground[:, 2]
    size, place = target / gain, np.zeros_like(target)
    with np.errstate(all="ignore"):
        inverse = np.linalg.inv(jacobian)
        for _ in range(ITERATIONS):
            form = plan @ (on_ground * size.T) + (on_ground * place.T).sum(1)[:, None] + rising  # (3, P, N)
            seen = form[:2] / form[2]
            low, high = seen.min(1).T, seen.max(1).T  # (N, 2)
            size = size + (target - (high - low)) / gain
            place = place - ((inverse @ (low + high)[..., None])[..., 0]) / 2
        settled = (np.abs(high - low - target) < 0.01 * target).all(1)
        good = settled & (size > 0.05 * target / gain).all(1) & np.isfinite(size).all(1)
    return np.where(good[:, None], size, np.nan)


def ground_axes(boxes: Boxes, views: Views) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) on the ground, camera coordinates, along and across the vehicles in `boxes`.

    The plane through the camera, the ray of a box's centre and its long side cuts the ground along the vehicle's
    heading (or against it: which end is the front is not known).
    """
    in_plane = np.linalg.solve(views.lens, boxes.along[..., None])[..., 0]
    ray = views.ground / views.ground[:, 2:]
    sweep = np.cross(ray, np.pad(in_plane, ((0, 0), (0, 1))))
    along = np.cross(sweep, views.normal)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.cross(views.normal, along)
