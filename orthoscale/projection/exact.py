"""The exact model: which vehicle on the ground, seen by this very camera, gives this box?

The vehicle is a hull standing on the local ground plane: the full footprint up to the belt line, a narrower cabin above,
cut off at the detector's effective height (its boxes do not enclose the whole silhouette). Its outline is projected with
true perspective; length, width and position are solved for so that the outline's extents along the box's two axes and
its middle are those of the box. Nothing is linearised except the lens across one vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boxes import Boxes
from .view import Views

ITERATIONS = 12
CHUNK = 20_000  # boxes solved at once; bounds memory


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


CUBOID = Hull(height=1.6, belt=1.6, roof=1.7, corner=0.0)


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
    u = np.stack([np.cos(boxes.angle), np.sin(boxes.angle)], -1)  # box axes in the image
    axes = np.stack([u, np.stack([-u[:, 1], u[:, 0]], -1)], 1)  # (N, 2 axes, 2)
    along, across = ground_axes(views, u)
    centre = views.ground.copy()
    target = boxes.xylwa[:, 2:4]

    def displacement(points: np.ndarray) -> np.ndarray:
        """(N, P, 3) camera coordinates to (N, P, 2) pixels from the box's centre, along the box's axes."""
        plane = points[..., :2] / points[..., 2:] - (views.ground[:, :2] / views.ground[:, 2:])[:, None]
        return np.einsum("nij,njk,npk->npi", axes, views.lens, plane)

    # Pixels along the box's axes for one unit along and across the vehicle: (N, 2 axes, 2 directions).
    # A short finite step: the projection is smooth and the step is a millionth of the distance.
    step = 1e-6 * np.linalg.norm(views.ground, axis=1)[:, None]
    tips = np.stack([centre + step * along, centre + step * across], 1)
    jacobian = (displacement(tips) / step[:, None]).transpose(0, 2, 1)
    gain = np.abs(np.stack([jacobian[:, 0, 0], jacobian[:, 1, 1]], -1))
    inverse = np.linalg.pinv(jacobian)

    size = target / gain
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            offset = plan[None] * size[:, None]  # (N, P, 2)
            points = (
                centre[:, None]
                + offset[..., :1] * along[:, None]
                + offset[..., 1:] * across[:, None]
                + heights[None, :, None] * views.normal[:, None]
            )
            seen = displacement(points)
            low, high = seen.min(1), seen.max(1)
            size = size + (target - (high - low)) / gain
            shift = np.einsum("nij,nj->ni", inverse, -(low + high) / 2)
            centre = centre + shift[:, :1] * along + shift[:, 1:] * across
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
