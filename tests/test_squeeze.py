"""Squeezed pixels show in the shapes of vehicles against their headings."""

import cv2
import numpy as np
import pytest

from orthoscale.core.boxes import Boxes
from orthoscale.core.measuring.plausibility import if_square, plausible
from orthoscale.core.measuring.squeeze import OF_SQUARE, SQUEEZE, Squeeze, squeeze
from orthoscale.core.scale import Scale
from orthoscale.fleets import load_fleet


def boxes_in(aspect, count=150, seed=0, heading=None, fleet="DE"):
    """The smallest rectangles around vehicles at any heading, in pixels `aspect` times as wide as high."""
    rng = np.random.default_rng(seed)
    size = 10 * load_fleet(fleet).sample(rng, count)[:, :2]
    heading = rng.uniform(0, np.pi, count) if heading is None else heading
    out = []
    for k, ((length, width), turn) in enumerate(zip(size, heading, strict=True)):
        ahead, aside = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        corners = [a * length / 2 * ahead + b * width / 2 * aside for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        there = np.array(corners) / (np.sqrt(aspect), 1 / np.sqrt(aspect))
        _, (w, h), angle = cv2.minAreaRect(there.astype(np.float32))
        angle = np.deg2rad(angle) + (np.pi / 2 if w < h else 0)
        out.append([90 * (k % 20), 90 * (k // 20), max(w, h), min(w, h), angle])
    return Boxes(np.array(out), np.ones(count))


def scale_of(count):
    parts, used = {"sampling": 0.01, "fleet": 0.02}, np.ones(count, bool)
    checks = {"length": 0.1, "width": 0.1}
    return Scale(0.1, "m/px", (0.0965, 0.1037), parts, checks, (0.5, 0.5), 0.0, "DE", "good", used, [""] * count)


@pytest.mark.parametrize("aspect", [0.75, 0.9, 1.0, 1.15, 1.4])
def test_the_squeeze_of_vehicles_at_headings_along_the_axes_is_exact(aspect):
    heading = np.tile([0.0, np.pi / 2], 100)
    for seed in range(5):
        found = squeeze(boxes_in(aspect, 200, seed, heading))
        own = np.sqrt(found.sd**2 - OF_SQUARE**2)
        assert abs(found.log_aspect - np.log(aspect)) < 3 * own and own < 0.02


@pytest.mark.parametrize("aspect, known", [(0.7, 1.0), (1.4, 1.0), (0.5, 0.5), (2.0, 2.0), (0.55, 0.5)])
def test_the_squeeze_of_vehicles_at_any_heading(aspect, known):
    """A box is the smallest rectangle around what the squeeze made of a vehicle: a parallelogram."""
    found = np.mean([squeeze(boxes_in(aspect, 400, seed), known).log_aspect for seed in range(5)])
    assert abs(found - np.log(aspect / known)) < 0.03 * abs(np.log(aspect)) + 0.006


def test_chance_is_as_large_as_it_says():
    found = [squeeze(boxes_in(1.0, 60, seed)) for seed in range(100)]
    sigmas = [one.log_aspect / np.sqrt(one.sd**2 - OF_SQUARE**2) for one in found]
    assert 0.85 < np.std(sigmas) < 1.15 and abs(np.mean(sigmas)) < 0.3


@pytest.mark.parametrize("aspect", [0.73, 1.3])
def test_squeezed_pixels_at_any_heading_are_refused(aspect):
    boxes = boxes_in(aspect)
    found = plausible(scale_of(150), boxes, 0)
    assert found.verdict == "unusable" and found.remarks[0].severity == "refusal"
    assert f"times as wide as high or {'less' if aspect < 1 else 'more'} (" in found.remarks[0].text
    known = if_square(scale_of(150), squeeze(boxes, aspect))
    assert known.verdict == "good" and SQUEEZE not in known.parts, "what the georeferencing says is no surprise"
    assert plausible(scale_of(150), boxes_in(1.0), 0, aspect).verdict == "unusable", "warped already, and it says not"


def test_a_few_odd_boxes_make_no_squeeze():
    boxes = boxes_in(1.0, 100)
    boxes.xylwa[:8, 2] *= 2.5
    boxes.xylwa[:8, 4] = 0.0
    assert abs(squeeze(boxes).log_aspect) < 0.05


@pytest.mark.parametrize("heading", [0.0, 0.4, np.pi / 2])
def test_a_lot_whose_vehicles_stand_one_way_says_nothing(heading):
    boxes = boxes_in(0.75, 100, 1, np.full(100, heading) + np.random.default_rng(2).normal(0, 0.03, 100))
    assert squeeze(boxes) is None and plausible(scale_of(100), boxes, 0).verdict == "good"
    assert squeeze(boxes_in(0.75, 10)) is None, "and few say nothing either"


@pytest.mark.parametrize("turned", [4, 10])
def test_a_few_vehicles_that_stand_across_are_enough(turned):
    """Of the pictures of known scale the one whose vehicles turn least has 3 of 100 across the others."""
    heading = np.where(np.arange(100) < turned, np.pi / 2, 0.0)
    found = squeeze(boxes_in(0.75, 100, 1, heading))
    assert found is not None and abs(found.log_aspect - np.log(0.75)) < 3 * found.sd


@pytest.mark.parametrize(
    "log_aspect, sd, verdict",
    [(0.1, 0.05, "good"), (0.04, 0.01, "good"), (0.15, 0.045, "fair"), (0.2, 0.045, "unusable")],
)
def test_how_far_squeezed_pixels_are_borne(log_aspect, sd, verdict):
    found = if_square(scale_of(30), Squeeze(log_aspect, sd))
    assert found.verdict == verdict
    if verdict == "fair":
        assert found.parts[SQUEEZE] == pytest.approx(0.15 / np.sqrt(8)) and found.half_width > 0.09
        assert [r.severity for r in found.remarks] == ["caution"]
