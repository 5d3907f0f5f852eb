"""How strongly a detector draws sizes to the usual is measured where boxes are exact."""

import json

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.detect.tiles import FunctionDetector
from orthoscale.fleets import load_fleet
from training.shrink import fit_shrink, known_vehicles

USUAL = np.array([4.4, 1.8])


def drawn(vehicle, gsd, shrink, margin, rng):
    box = vehicle * (USUAL / vehicle) ** np.array(shrink) / gsd + np.array(margin)
    return box + rng.normal(0, [1.0, 0.6], vehicle.shape)


def test_shrink_usual_and_noise_are_recovered():
    rng = np.random.default_rng(1)
    known = []
    for code, gsd in (("JP", 0.11), ("DE", 0.12), ("US", 0.12)):
        vehicle = load_fleet(code).sample(rng, 400)[:, :2]
        known.append((vehicle, drawn(vehicle, gsd, (0.35, 0.15), (0.6, 0.4), rng), gsd))
    fit = fit_shrink(known, (0.6, 0.4))
    assert fit.value == pytest.approx([0.35, 0.15], abs=0.04)
    assert fit.usual == pytest.approx(USUAL, rel=0.04)
    assert fit.noise == pytest.approx([1.0, 0.6], rel=0.1)
    assert fit.scenes.shape == (3, 2) and (fit.sd < 0.08).all()
    assert np.isnan(fit_shrink(known[:1], (0.6, 0.4)).sd).all()


def test_known_vehicles_are_in_metres_and_boxes_in_detector_pixels(tmp_path):
    path = tmp_path / "t.png"
    cv2.imwrite(str(path), np.random.default_rng(2).integers(0, 255, (800, 800, 3), np.uint8))
    boxes = [{"cx": 60 + 120 * (k % 6), "cy": 60 + 120 * (k // 6), "length": 80, "width": 36, "angle": 0, "visible": 1}
             for k in range(18)]  # fmt: skip
    boxes[0]["visible"] = 0.3
    path.with_suffix(".truth.json").write_text(json.dumps({"gsd_m": 0.05, "boxes": boxes}))

    def detect(image):
        scale = image.shape[0] / 800  # the whole picture is one tile
        rows = [[b["cx"] * scale, b["cy"] * scale, 84 * scale, 37 * scale, 0] for b in boxes]
        return Boxes(np.array(rows), np.full(len(rows), 0.9))

    vehicles, found, gsd = known_vehicles(path, FunctionDetector(detect), best_length=40, score=0.5)
    assert len(vehicles) == 17 and vehicles == pytest.approx(np.tile([4.0, 1.8], (17, 1)))
    assert gsd == pytest.approx(0.1) and found == pytest.approx(np.tile([42.0, 18.5], (17, 1)), rel=0.03)
    with pytest.raises(ValueError, match="0 of 17 vehicles found"):
        known_vehicles(path, FunctionDetector(lambda image: Boxes.empty()), best_length=40, score=0.5)
