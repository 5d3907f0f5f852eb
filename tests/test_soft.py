"""In soft pictures, where every edge is unsure, none is taken for one that lies inside."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from support.drawings import Drawing
from test_enlarged import Pixels, times
from test_enlarged import car_park as asphalt
from test_remeasure import CARD, QUIET, Sees, found, proposed

from orthoscale.core.boxes import Boxes
from orthoscale.core.detections import UNKNOWN_RULER, Detections
from orthoscale.core.ruler import Ruler
from orthoscale.detect.enlarged import AS_IT_IS, enlargement
from orthoscale.detect.measurer import MOVED_SD, Measured, Measurer
from orthoscale.detect.remeasure import _notes, remeasured
from orthoscale.detect.soft import GROWS, LESS_SURE, less_sure, softness
from orthoscale.detect.windows import windows_about
from training.evaluate import measured_scenes

SURE = (0.01, 0.3)
ZOOM = 0.5
LENGTH, WIDTH = 60.0, 25.0  # of every vehicle [px]
SURE_SIGMA = np.hypot(SURE[0] * LENGTH, SURE[1])


class Unsure(Sees):
    """Says of edges that their sigma is `unsure` times that of sure ones, of one vehicle in four thrice that, of what
    is no vehicle ten times."""

    card = replace(CARD, inward=2.0, sure=SURE)

    def __init__(self, truth: Boxes, unsure: float) -> None:
        super().__init__(truth)
        self.unsure = unsure

    def __call__(self, *args: object, **options: object) -> Measured:
        told = super().__call__(*args, **options)
        none = told.kind[:, -1] > 0.5
        sigma = self.unsure * SURE_SIGMA * np.where(none, 10.0, np.where(at_two_places(told.boxes), 3.0, 1.0))
        return replace(told, sigma=np.repeat(sigma[:, None], 4, 1))


def at_two_places(boxes: Boxes) -> np.ndarray:
    """(N,) bool: vehicles whose edges may be the bonnet's or the bumper's."""
    return boxes.centre[:, 0].round() % 4 == 0


def measured(unsure: float, vehicles: int = 80) -> tuple[Boxes, Detections]:
    """What is made of 80 boxes, so many of them `vehicles`, sorted by their places, and all of the detections."""
    x, y = np.meshgrid(np.arange(10) * 150 + 100, np.arange(8) * 120 + 100)
    centre = np.c_[x.ravel() + np.arange(80) % 4, y.ravel()]
    truth = Boxes(np.c_[centre, np.tile([LENGTH, WIDTH, 0.0], (80, 1))], np.ones(80))
    got = remeasured(
        [Drawing(1800, 1200, truth)], found(proposed(truth), ZOOM), Unsure(truth[:vehicles], unsure), QUIET
    )
    boxes = got.boxes["drawing"]
    return boxes[np.lexsort(boxes.centre.T)], got


def test_most_edges_of_a_sharp_picture_are_sure():
    assert softness(np.full((20, 4), 0.8)) == 1
    assert softness(np.array([[0.6, 0.7, 2.5, 3.0], [0.8, 0.9, 0.7, 4.0]])) == 1, "some may always be at two places"
    assert softness(np.full((20, 4), [1.3, 1.5, 1.5, 1.7])) == pytest.approx(1.5**GROWS)
    assert softness(np.empty((0, 4))) == 1


def test_unsure_edges_of_a_sharp_picture_are_moved_out():
    boxes, got = measured(0.8)
    larger, unsure = boxes.xylwa[:, 2:4] - [LENGTH, WIDTH], at_two_places(boxes)
    assert unsure.sum() == 20 and larger[~unsure] == pytest.approx(0)
    assert larger[unsure] == pytest.approx(2 * 2.0 * (3 * 0.8 - 1) * SURE_SIGMA)
    assert got.ruler.margin_sd == pytest.approx(np.array(CARD.ruler.margin_sd) * ZOOM)
    assert not any("soft" in note for note in got.notes)


def test_a_picture_soft_by_less_than_is_printed_is_not_called_soft():
    """`1.00 times as uncertain as sharp ones` tells nothing."""
    _, got = measured(1.002)
    assert not any("soft" in note for note in got.notes)


def test_in_a_soft_picture_the_same_edges_are_moved_and_the_margin_is_less_sure():
    boxes, got = measured(1.6)
    soft = 1.6**GROWS
    larger, unsure = boxes.xylwa[:, 2:4] - [LENGTH, WIDTH], at_two_places(boxes)
    outward = 2.0 * (3 * 1.6 - soft) * SURE_SIGMA
    assert larger[~unsure] == pytest.approx(0) and larger[unsure] == pytest.approx(2 * outward)
    sigma = boxes.sigma[:, 0] * boxes.length / CARD.sigma_times[0] / np.sqrt(2)
    assert sigma[~unsure] == pytest.approx(1.6 * SURE_SIGMA)
    assert sigma[unsure] == pytest.approx(np.hypot(3 * 1.6 * SURE_SIGMA, MOVED_SD * outward)), "less certain for that"
    more = np.array(LESS_SURE) * np.sqrt(1 - soft**-2)
    assert got.ruler.margin_sd == pytest.approx(np.hypot(CARD.ruler.margin_sd, more) * ZOOM)
    assert "the picture is soft: its edges are 2.02 times as uncertain as sharp ones" in got.notes


def test_of_several_pictures_it_is_said_that_they_are_soft():
    seen = SimpleNamespace(index={"a": [0], "b": [1]}, enlarged=Fraction(2), soft=1.5, too_large=np.zeros(2))
    assert list(_notes(seen)) == [
        "the pictures are enlarged 2 times beyond their detail: measured at reduced size",
        "the pictures are soft: their edges are 1.50 times as uncertain as sharp ones",
    ]


def test_what_is_no_vehicle_says_nothing_of_softness():
    boxes, got = measured(0.8, vehicles=30)
    assert len(boxes) == 30 and not any("soft" in note for note in got.notes)


def test_the_softer_the_less_is_known_of_edges_and_of_sharp_ones_nothing_changes():
    ruler = Ruler(margin_sd=(0.2, 0.1))
    assert less_sure(ruler, AS_IT_IS, 1.0) == ruler
    sds = np.array([less_sure(ruler, AS_IT_IS, soft).margin_sd for soft in (1.0, 1.05, 1.3, 2.0, 5.0)])
    assert (np.diff(sds, axis=0) > 0).all() and (sds[-1] < np.hypot(ruler.margin_sd, LESS_SURE)).all()


def test_edges_of_an_enlarged_picture_are_as_sure_as_its_pixels_are_large():
    """They are looked at in fewer pixels, and sure as far as these go."""
    pixels, boxes = times(*asphalt(), 4)
    enlarged = float(enlargement(windows_about({"pixels": Pixels(pixels)}, {"pixels": boxes})))
    assert enlarged > 1.5

    class Sure(Sees):
        card = Unsure.card

        def __call__(self, *args: object, **options: object) -> Measured:
            told = super().__call__(*args, **options)
            return replace(told, sigma=np.repeat(self.card.sure_sigma(told.boxes.length, enlarged), 4, 1))

    seen = Detections({"pixels": boxes}, 1.0, UNKNOWN_RULER, (0.7, 0.5), "a detector", "detector")
    got = remeasured([Pixels(pixels)], seen, Sure(boxes), QUIET)
    assert got.boxes["pixels"].xylwa == pytest.approx(boxes.xylwa)
    assert any("times beyond its detail" in note for note in got.notes)
    assert not any("soft" in note for note in got.notes)


@pytest.mark.real
@pytest.mark.slow
def test_vehicles_are_as_large_in_a_soft_picture(data):
    """Where noise hides from `enlargement` that the picture is blurred: without, they are 2.6 and 5.7 % larger."""
    (scene,) = (one for one in measured_scenes(data) if one.name == "tartu_b")
    boxes = Boxes(scene.pictures[0].vehicles, np.ones(len(scene.pictures[0].vehicles)))
    sharp = cv2.cvtColor(cv2.imread(str(scene.pictures[0].picture.path)), cv2.COLOR_BGR2RGB)
    noise = np.random.default_rng(2).normal(0, 5, sharp.shape)
    soft = np.clip(cv2.GaussianBlur(sharp, (0, 0), 2.0) + noise, 0, 255).astype(np.uint8)
    sizes = []
    for pixels in (sharp, soft):
        seen = Detections({"pixels": boxes}, 1.0, UNKNOWN_RULER, (0.7, 0.5), "a detector", "detector")
        got = remeasured([Pixels(pixels)], seen, Measurer(), QUIET)
        assert any("soft" in note for note in got.notes) == (pixels is soft)
        assert not any("times beyond its detail" in note for note in got.notes)
        sizes.append(got.boxes["pixels"].xylwa[:, 2:4])
    larger = np.log(sizes[1] / sizes[0]).mean(0)
    assert (np.abs(larger) < [0.02, 0.045]).all()
