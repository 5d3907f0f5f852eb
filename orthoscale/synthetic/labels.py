"""Training labels: pictures of random scenes with exact boxes, in the format that `training/data.py` reads."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

from ..formats.pictures import write_jpeg
from .render import ortho_view, render, vehicle_boxes
from .scene import Scene, SizeSource, make_scene
from .vehicle import Vehicle
from .view import Camera, Perspective, Pose, View

VEHICLE_M = 4.45
"""Length that the pixel length of a picture refers to [m]."""

LARGEST_EXTENT_M = 300.0


def visible_share(vehicles: tuple[Vehicle, ...], view: View, owner: np.ndarray) -> np.ndarray:
    """(N,) visible share of each vehicle's outline: neither hidden behind something nor outside the picture.

    owner : (H, W) the vehicle that each pixel shows, from `render`.
    """
    seen = np.bincount(owner[owner >= 0], minlength=len(vehicles))[: len(vehicles)]
    outlines = (cv2.convexHull(view.project(v.hull).astype(np.float32)) for v in vehicles)
    return seen / np.maximum([cv2.contourArea(outline) for outline in outlines] or np.zeros(0), 1e-6)


def labelled_boxes(scene: Scene, view: View, owner: np.ndarray) -> list[dict]:
    """The boxes of one picture as the training reads them.

    A vehicle in full view is a ``vehicle``; one that is half hidden, cut by the picture's edge or too small to be
    recognised (under 8 px) is an ``ignore`` region; a hidden one is left out. A lorry is a ``large-vehicle``, even if
    it is cut.
    """
    boxes, share = vehicle_boxes(scene.vehicles, view), visible_share(scene.vehicles, view, owner)
    clear = (share > 0.6) & boxes.inside(view.width, view.height) & (boxes.length >= 8)
    kinds = [(b, "vehicle" if c else "ignore") for b, c, s in zip(boxes.xylwa, clear, share, strict=True) if s > 0.04]
    lorries = vehicle_boxes(
        tuple(Vehicle(x, y, a, length, width, 3) for x, y, length, width, a in scene.lorries), view, 2.5
    )
    places = np.concatenate([lorries.corners, lorries.centre[:, None]], 1)
    shown = np.all((places > 0) & (places < [view.width, view.height]), axis=2).any(axis=1)
    kinds += [(b, "large-vehicle") for b in lorries.xylwa[shown]]
    names = ("cx", "cy", "length", "width", "angle")
    return [dict(zip(names, np.round(b, 4).tolist(), strict=True)) | {"kind": kind} for b, kind in kinds]


def random_view(rng: np.random.Generator, size: int) -> tuple[View | None, float, float]:
    """Either an orthophoto or a frame of a flight, `size` px square: (view or None for an orthophoto, extent, GSD [m]).

    The vehicles' length is between 14 and 75 px; frames look straight down to 45 degrees forward.
    """
    while True:
        gsd = VEHICLE_M / rng.uniform(14, 75)
        if rng.random() < 0.45:
            return None, size * gsd, gsd
        pitch = np.deg2rad(rng.choice([90 - abs(rng.normal(0, 5)), rng.uniform(45, 90)]))
        camera = Camera(rng.uniform(0.9, 1.6) * size, size, size)
        slant = gsd * camera.focal_px
        yaw = rng.uniform(0, 2 * np.pi)
        back = slant * np.cos(pitch)
        centre = np.array([-back * np.cos(yaw), -back * np.sin(yaw), slant * np.sin(pitch)])
        view = Perspective(camera, Pose.looking(centre, yaw, pitch, rng.normal(0, 0.03)))
        corner = np.array([[0.0, 0], [size, 0], [size, size], [0, size]]) - size / 2
        rays = np.insert(corner / camera.focal_px, 2, 1, axis=1) @ view.pose.rotation
        if centre[2] < 22 or (rays[:, 2] > -0.15).any():
            continue
        extent = 2 * np.abs(centre[:2] - rays[:, :2] * centre[2] / rays[:, 2:]).max() + 10
        if extent < LARGEST_EXTENT_M:
            return view, extent, gsd


def write_labels(
    folder: Path,
    count: int = 240,
    seed: int = 0,
    fleet: SizeSource | None = None,
    size: int = 768,
    style: str | None = None,
) -> Path:
    """Write `count` pictures, of scenes of one `style` or of any, to ``folder/images``, and their labels to
    ``folder/labels.json``; returns the path of that."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    entries = []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        view, extent, gsd = random_view(rng, size)
        density = float(rng.choice([0.0, rng.uniform(0.001, 0.004), rng.uniform(0.004, 0.011)], p=[0.08, 0.32, 0.6]))
        scene = make_scene(int(rng.integers(1 << 40)), fleet, extent, int(np.ceil(density * extent**2)), style)
        view = ortho_view(scene, gsd) if view is None else view
        image, owner = render(scene, view, int(rng.integers(1 << 40)))
        name = f"{style or 'synthetic'}_{seed}_{i:05d}.jpg"
        write_jpeg(folder / "images" / name, image, int(rng.integers(70, 96)))
        entries.append(
            {
                "file": name,
                "set": style or "synthetic",
                "width": view.width,
                "height": view.height,
                "source": "orthoscale.synthetic",
                "licence": "CC0",
                "boxes": labelled_boxes(scene, view, owner),
            }
        )
    path = folder / "labels.json"
    path.write_text(json.dumps({"images": entries}, indent=1))
    return path
