"""Looking again: turned looks see the same boxes, medians are sharper, and a box's own noise is what it strays by."""

import numpy as np
import pytest
from test_detect import Drawing, RectangleDetector, car_park

from orthoscale.boxes import Boxes, matched
from orthoscale.detect.refine import VIEWS, agreed, look_turned, refined
from orthoscale.detect.tiles import sweep, tiles
from orthoscale.fleet import Fleet
from orthoscale.pooling import Ruler, pool
from orthoscale.votes import gather


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_turned_look_sees_the_same_boxes(quarters):
    truth = Boxes(np.array([[60, 40, 40, 16, 0.3], [150, 90, 50, 18, -1.0], [90, 120, 30, 14, 1.4]]), np.ones(3))
    picture = Drawing(230, 170, truth)  # neither square nor symmetric
    (tile,) = tiles(picture, 1.0)
    found = look_turned(picture, tile, quarters, RectangleDetector())
    i, j, overlaps = matched(truth, found, 0.5)
    assert len(found) == len(i) == 3 and overlaps.min() > 0.8
    assert np.abs(found.centre[j] - truth.centre[i]).max() < 0.6
    turn = (found.angle[j] - truth.angle[i] + np.pi / 2) % np.pi - np.pi / 2
    assert np.abs(turn).max() < 0.05


class Unsteady(RectangleDetector):
    """Sizes of every look are off by 6 % and 9 % at random."""

    def __call__(self, image, threshold=None):
        found = super().__call__(image)
        xylwa = found.xylwa.copy()
        xylwa[:, 2:4] *= np.exp(self.rng.normal(0, [0.06, 0.09], (len(found), 2)))
        return Boxes(xylwa, found.score)


def test_medians_are_sharper_and_know_their_noise():
    truth = car_park(40, 1800, 1500, 90)
    picture = Drawing(1800, 1500, truth)
    detect = Unsteady()
    found = sweep([picture], 1.0, detect)
    sharper = refined([picture], found, 1.0, detect)["drawing"]

    def errors(boxes):
        i, j, _ = matched(truth, boxes, 0.5)
        assert len(i) == len(truth)
        return np.std(np.log(boxes.xylwa[j, 2:4] / truth.xylwa[i, 2:4]), axis=0)

    before, after = errors(found["drawing"]), errors(sharper)
    assert (after < 0.65 * before).all(), "five views: the median's scatter is 0.54 of one's"
    assert np.median(sharper.noise, axis=0) == pytest.approx([0.06, 0.09], rel=0.2)
    assert (sharper.score == found["drawing"].score).all()


def test_steady_and_unsteady_boxes_are_told_apart():
    boxes = Boxes(np.array([[50, 50, 40, 16, 0], [150, 50, 40, 16, 0], [250, 50, 40, 16, 0]]), np.ones(3))
    looks = []
    for k in range(len(VIEWS)):
        xylwa = boxes.xylwa[:2].copy()  # the third is not seen again
        xylwa[1, 2] *= 1 + 0.15 * (-1) ** k
        looks.append(Boxes(xylwa, np.ones(2)))
    got = agreed(boxes, looks)
    assert got.noise[1, 0] > 1.5 * got.noise[0, 0]
    assert got.noise[0, 0] > 0.02, "five views that agree by luck are not believed altogether"
    assert np.isnan(got.noise[2]).all() and (got.xylwa[2] == boxes.xylwa[2]).all()
    assert len(agreed(Boxes.empty(), [Boxes.empty()] * 4)) == 0


def test_a_box_across_the_half_turn_keeps_its_direction():
    boxes = Boxes(np.array([[50, 50, 40, 16, np.pi / 2 - 0.01]]), np.ones(1))
    looks = [Boxes(np.array([[50, 50, 40, 16, angle]]), np.ones(1)) for angle in (-1.56, 1.56, -1.55, 1.55)]
    turn = (agreed(boxes, looks).angle[0] - np.pi / 2 + np.pi / 2) % np.pi - np.pi / 2
    assert abs(turn) < 0.02


def test_noise_travels_with_the_boxes_and_decides_in_the_pooling():
    noise = np.array([[0.1, 0.2], [0.3, 0.4]])
    boxes = Boxes(np.array([[0, 0, 9, 4, 0], [0, 0, 4, 9, 0]]), np.ones(2), noise)
    assert boxes.noise.tolist() == [[0.1, 0.2], [0.4, 0.3]], "turned with its box"
    both = Boxes.concatenate([boxes[1:].mapped(2.0, (1, 1)), Boxes(boxes.xylwa, boxes.score)])
    assert both.noise[0].tolist() == [0.4, 0.3] and np.isnan(both.noise[1:]).all()

    rng = np.random.default_rng(4)
    fleet = Fleet.load("DE")
    size = fleet.sample(rng, 60)[:, :2] / 0.1
    bad = np.arange(60) < 30
    own = np.where(bad[:, None], 0.25, 0.01) * np.ones((60, 2))
    size = size * np.exp(rng.normal(0, 1, (60, 2)) * own)

    def sampling(noise):
        votes = gather(size, np.ones(60), np.zeros((60, 2)), np.ones(60), False, noise)
        return pool(votes, fleet, Ruler(noise=(0.5, 0.3)), "m/px")

    told, untold = sampling(own), sampling(None)
    assert told.vehicles_used > untold.vehicles_used, "half of the boxes stray, and only their own noise says so"
    assert abs(told.value / 0.1 - 1) < 0.04
