"""Simulated flights over parked vehicles, with boxes of known effective height and margin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orthoscale.core.boxes import Boxes
from orthoscale.core.fleet import Fleet
from orthoscale.core.projection.own_ruler import OwnRuler, SeenBoxes
from orthoscale.core.projection.self_calibration import self_calibrated
from orthoscale.core.projection.view import Views

from .bodies import CAR, UPRIGHT, body

UNIT = 3.7  # metres
FOCAL, WIDTH, HEIGHT = 1000.0, 1440.0, 1080.0
NOISE = (0.8, 0.6)  # px of one box's length and width
# The detector's card and its uncertainties; it is right for none of the flights.
CARD_HEIGHT, CARD_MARGIN, CARD_HEIGHT_SD, CARD_MARGIN_SD = (0.9, 0.9), (1.5, 1.5), (0.5, 0.5), (2.0, 2.0)


@dataclass(frozen=True)
class Flight:
    """Boxes of all frames, how they are seen, and the vehicle of each; true sizes [m] of the vehicles."""

    boxes: Boxes
    views: Views
    vehicle: np.ndarray
    size: np.ndarray

    def seen(self, metres_per_unit: float = UNIT) -> SeenBoxes:
        return SeenBoxes(self.boxes, self.views, 1.0, metres_per_unit)

    @property
    def members(self) -> list[np.ndarray]:
        return [np.flatnonzero(self.vehicle == k) for k in range(len(self.size))]


def fly(
    rng: np.random.Generator,
    fleet: Fleet,
    height: float,
    margin: float,
    vehicles: int = 70,
    frames: int = 36,
    altitude: tuple[float, float] = (50.0, 130.0),
    undercut: float = 0.0,
) -> Flight:
    """Frames at 45 to 90 degrees and `altitude` [m] over parked vehicles; boxes enclose these up to `height` [m], and
    exceed that by `margin` [px]. On the ground the enclosed bodies recede by `undercut` [m] on all sides."""
    size = fleet.sample(rng, vehicles)[:, :2]
    place = np.column_stack([rng.uniform(-45, 45, (vehicles, 2)), np.zeros(vehicles)])
    heading = rng.uniform(0, 2 * np.pi, vehicles)
    along = np.stack([np.cos(heading), np.sin(heading), 0 * heading], -1)
    across = np.stack([-np.sin(heading), np.cos(heading), 0 * heading], -1)
    plan, heights = body(UPRIGHT if undercut else CAR, height)  # an undercut body recedes straight from the belt line
    offset = plan * size[:, None]
    offset -= np.sign(offset) * np.where(heights == 0, undercut, 0.0)[:, None]
    points = place[:, None] + offset[..., :1] * along[:, None] + offset[..., 1:] * across[:, None]
    points = points + heights[:, None] * [0, 0, 1]
    parts, seen, who = [], [], []
    for _ in range(frames):
        pitch, yaw, above = np.radians(rng.uniform(45, 90)), rng.uniform(0, 2 * np.pi), rng.uniform(*altitude)
        forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        rotation = np.stack([right, np.cross(forward, right), forward])  # rows: the camera's axes
        camera = -forward * above / np.sin(pitch)  # looks at the origin

        def project(world: np.ndarray, rotation: np.ndarray = rotation, camera: np.ndarray = camera) -> np.ndarray:
            local = (world - camera) @ rotation.T
            return local[..., :2] / local[..., 2:] * FOCAL

        tip = project(place + 1e-3 * along) - project(place)
        angle = np.arctan2(tip[:, 1], tip[:, 0])
        u = np.stack([np.cos(angle), np.sin(angle)], -1)
        axes = np.stack([u, np.stack([-u[:, 1], u[:, 0]], -1)], 1)
        drawn = np.einsum("nij,npj->npi", axes, project(points))
        low, high = drawn.min(1), drawn.max(1)
        sides = high - low + margin + rng.normal(0, NOISE, low.shape)
        middle = np.einsum("nij,ni->nj", axes, (low + high) / 2)
        inside = (np.abs(middle) < [WIDTH / 2 - 60, HEIGHT / 2 - 60]).all(1) & (sides[:, 0] > sides[:, 1])
        rays = np.column_stack([middle / FOCAL, np.ones(vehicles)]) @ rotation
        ground = camera + rays * (-camera[2] / rays[:, 2])[:, None]
        n = int(inside.sum())
        views = Views(
            ((ground - camera) @ rotation.T / UNIT)[inside],
            np.broadcast_to(rotation[:, 2], (n, 3)),
            np.broadcast_to(np.eye(2) * FOCAL, (n, 2, 2)),
        )
        seen.append(views)
        parts.append(Boxes(np.column_stack([middle, sides, angle])[inside], np.ones(n)))
        who.append(np.flatnonzero(inside))
    return Flight(Boxes.concatenate(parts), Views.concatenate(seen), np.concatenate(who), size)


def find(flight: Flight, metres_per_unit: float = UNIT) -> tuple[OwnRuler, np.ndarray]:
    """The self-calibrated ruler of a flight, and the remaining error of the scale by lengths and by widths."""
    card = OwnRuler.of_card(CARD_HEIGHT, CARD_MARGIN, CARD_HEIGHT_SD, CARD_MARGIN_SD)
    ruler = self_calibrated(flight.seen(metres_per_unit), flight.members, card)
    size = ruler.size(flight.seen(metres_per_unit)) * UNIT
    return ruler, np.nanmean(np.log(flight.size[flight.vehicle] / size), axis=0)
