"""Small sources of known truth with reports to draw: rectangles on a simple picture, with sizes from a fleet."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

import orthoscale
from orthoscale.fleets import load_fleet

from .pictures import squares

EXAMPLE = Path(__file__).parents[2] / "examples" / "sheffield"
GSD = 0.1  # m/px
WIDTH, HEIGHT = 1000, 700  # px
MARGIN = (1.0, 0.5)  # px that the boxes are longer and wider than the vehicles


def car_park(folder: Path, name: str = "park.png", count: int = 60, drift: float = 0.0, seed: int = 1) -> dict:
    """Write a picture of `count` German vehicles and its detections.json; returns the truth.

    drift : relative difference in size [px] by which vehicles at the right are smaller than those at the left.
    """
    random = np.random.default_rng(seed)
    size = load_fleet("DE").sample(random, count)[:, :2]
    places = [(60 + 90 * i, 60 + 95 * j) for j in range(7) for i in range(10)]
    centre = np.array(places, float)[random.permutation(len(places))[:count]]
    px = size / GSD * (1 - drift * centre[:, :1] / WIDTH)
    angle = 0.4 + random.uniform(-0.2, 0.2, count)  # parked the same way, more or less
    image = squares(WIDTH, HEIGHT)
    rows = []
    for (x, y), (length, width), a in zip(centre, px, angle, strict=True):
        corners = cv2.boxPoints(((x, y), (length, width), np.degrees(a)))
        cv2.fillPoly(image, [corners.round().astype(np.int32)], random.integers(0, 255, 3).tolist())
        box = {"cx": x, "cy": y, "length": length + MARGIN[0], "width": width + MARGIN[1], "angle": a}
        rows.append({**box, "score": float(random.uniform(0.5, 1))})
    rows.append({"cx": 950, "cy": 650, "length": 200.0, "width": 90.0, "angle": 0.0, "score": 0.6})  # a roof
    cv2.imwrite(str(folder / name), image)
    found = {
        "detector": "rectangles",
        "detector_sha256": "",
        "zoom": 1.0,
        "effective_height": [0.7, 0.5],
        "ruler": {"margin": list(MARGIN), "margin_sd": [0.3, 0.3], "noise": [0.5, 0.5]},
        "pictures": {name: rows},
    }
    (folder / "detections.json").write_text(json.dumps(found))
    return {"size": size, "centre": centre}


def fixed(folder: Path, name: str = "park.png", **options) -> Path:
    """Run `fix` on that car park; returns its report.html."""
    out = folder / "scaled.tif"
    orthoscale.fix(folder / name, out, fleet="DE", detections=folder / "detections.json", **options)
    return folder / "scaled.tif.html"


def fixed_model(folder: Path, **options) -> Path:
    """Run `fix` on the reduced Sheffield model, whose frames are not at hand; returns its report.html."""
    detections = options.pop("detections", EXAMPLE / "detections.json")
    orthoscale.fix(EXAMPLE / "sparse", folder / "scaled", fleet="US", detections=detections, **options)
    return folder / "scaled" / "report.html"
