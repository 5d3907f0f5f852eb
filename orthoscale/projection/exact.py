"""The exact model: which vehicle on the ground, seen by this very camera, gives this box?

The vehicle is a hull standing on the local ground plane: the full footprint up to the belt line, a narrower cabin
above, cut off at the detector's effective height (its boxes do not enclose the whole silhouette). Its outline is
projected with true perspective; length, width and position are solved for so that the outline's extents along the
box's two axes and its middle are those of the box. Nothing is linearised except the lens across one vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from .view import Views

ITERATIONS = 8  # each leaves about a tenth of the error of the one before
CHUNK = 4_000  # boxes solved at once; small enough for the processor's cache


@dataclass(frozen=True)
class Hull:
    """A car-like body. Heights in metres; insets and corner as shares of the vehicle's length or width.

    The defaults are those of a mid-size car: belt line at 0.85 m, windscreen and rear window slanting inwards, corners
    rounded by about 0.25 m.
    """

    height: float = 0.8  # what the detector's boxes enclose, see DetectorCard.effective_height [m]
    belt: float = 0.85
    roof: float = 1.5
    front_inset: float = 0.30  # of the length, at the roof
    rear_inset: float = 0.12  # of the length, at the roof
    side_inset: float = 0.10  # of the width, each side, at the roof
    corner: float = 0.13  # of the width, cut off each corner

    def outline(self) -> tuple[np.ndarray, np.ndarray]:
        """Points whose convex hull is the body: (P, 2) of unit length and unit width, and (P,) heights [m]."""
        slabs = [(0.0, 0.0), (min(self.belt, self.height), 0.0)]
        if self.height > self.belt:
            slabs.append((self.height, min(1.0, (self.height - self.belt) / (self.roof - self.belt))))
        plan, heights = [], []
        for height, share in slabs:
            front = 0.5 - share * self.front_inset
            rear = -0.5 + share * self.rear_inset
            side = 0.5 - share * self.side_inset
            cut_side, cut_long = self.corner, self.corner / 2.4  # the same cut in metres along both axes
            for x, direction in ((front, -1.0), (rear, 1.0)):
                for y in (side, -side):
                    plan += [(x, y - np.sign(y) * cut_side), (x + direction * cut_long, y)]
            heights += [height] * 8
        return np.array(plan), np.array(heights)


def ground_size(boxes: Boxes, views: Views, metres_per_unit: float, hull: Hull | None = None) -> np.ndarray:
    """(N, 2) length and width of each vehicle on the ground [units of `views`]; NaN where none explains the box.

    `metres_per_unit` turns the hull's heights into units: the pooled scale so far. Its error enters only through the
    height's share of the box (about a tenth of the box per 10 % at 60 degrees), so two or three rounds settle it.
    """
    hull = hull or Hull()
    parts = [
        _solve(boxes[part], views[part], metres_per_unit, hull)
        for part in (slice(start, start + CHUNK) for start in range(0, len(boxes), CHUNK))
    ]
    return np.concatenate(parts) if parts else np.empty((0, 2))


def _solve(boxes: Boxes, views: Views, metres_per_unit: float, hull: Hull) -> np.ndarray:
    plan, heights = hull.outline()
    heights = heights / metres_per_unit
    u = np.stack([np.cos(boxes.angle), np.sin(boxes.angle)], -1)
    axes = np.stack([u, np.stack([-u[:, 1], u[:, 0]], -1)], 1)  # (N, 2 axes, 2): the box's own, in the image
    to_axes = axes @ views.lens  # (N, 2, 2) from the plane z = 1 to pixels along the box's axes
    along, across = ground_axes(views, u)
    directions = np.stack([along, across, views.normal], 1)  # (N, 3 directions, 3)
    target = boxes.xylwa[:, 2:4]
    x0, y0 = (views.ground[:, :2] / views.ground[:, 2:]).T[..., None]
    rise = heights[None, :, None] * directions[:, None, 2]  # (N, P, 3)

    def displacement(offset: np.ndarray, lift: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N, P) along both box axes from its centre, of points `offset` (N, P, 2) along and across on the
        ground, raised by `lift` (N, P, 3)."""
        x, y, z = np.moveaxis(views.ground[:, None] + offset @ directions[:, :2] + lift, -1, 0)
        x, y = x / z - x0, y / z - y0
        m = to_axes[..., None]
        return m[:, 0, 0] * x + m[:, 0, 1] * y, m[:, 1, 0] * x + m[:, 1, 1] * y

    # Pixels along the box's axes for one unit along and across the vehicle: (N, 2 axes, 2 directions). The projection
    # is smooth, so a step of a millionth of the distance gives the derivative.
    step = 1e-6 * np.linalg.norm(views.ground, axis=1)[:, None, None]
    jacobian = np.stack(displacement(step * np.eye(2), 0.0), 1) / step
    gain = np.abs(np.diagonal(jacobian, axis1=1, axis2=2))

    size, place = target / gain, np.zeros_like(target)
    with np.errstate(all="ignore"):
        inverse = np.linalg.inv(jacobian)
        for _ in range(ITERATIONS):
            seen = displacement(plan * size[:, None] + place[:, None], rise)
            low, high = (np.stack([f(d, axis=1) for d in seen], -1) for f in (np.min, np.max))
            size = size + (target - (high - low)) / gain
            place = place - ((inverse @ (low + high)[..., None])[..., 0]) / 2
        settled = (np.abs(high - low - target) < 0.01 * target).all(1)
        good = settled & (size > 0.05 * target / gain).all(1) & np.isfinite(size).all(1)
    return np.where(good[:, None], size, np.nan)


def ground_axes(views: Views, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) on the ground, camera coordinates, along and across a vehicle whose image runs along `u`.

    `u` (N, 2) is a direction in pixels at the box's centre. The plane through the camera, the centre's ray and that
    direction cuts the ground along the vehicle's heading (or against it: which end is the front is not known).
    """
    in_plane = np.linalg.solve(views.lens, u[..., None])[..., 0]
    ray = views.ground / views.ground[:, 2:]
    sweep = np.cross(ray, np.pad(in_plane, ((0, 0), (0, 1))))
    along = np.cross(sweep, views.normal)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return along, np.cross(views.normal, along)
