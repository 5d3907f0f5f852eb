"""Looking again: turned looks see the same boxes, medians are sharper, and know how much their looks differed."""

from pathlib import Path

import numpy as np
import pytest
from support.drawings import Drawing, RectangleDetector, car_park

import orthoscale
from orthoscale.core.boxes import Boxes, matched
from orthoscale.core.pooling.robust import pool
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import Sightings, gather
from orthoscale.detect.refine import VIEWS, agreed, look_turned, refined
from orthoscale.detect.tiles import one_pass, tiles
from orthoscale.errors import UsageError
from orthoscale.fleets import load_fleet


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


def test_medians_are_sharper_and_know_their_spread():
    truth = car_park(40, 1800, 1500, 90)
    picture = Drawing(1800, 1500, truth)
    detect = Unsteady()
    found = one_pass([picture], 1.0, detect)
    sharper = refined([picture], found, 1.0, (0.0, 0.0), detect)["drawing"]

    def errors(boxes):
        i, j, _ = matched(truth, boxes, 0.5)
        assert len(i) == len(truth)
        return np.std(np.log(boxes.xylwa[j, 2:4] / truth.xylwa[i, 2:4]), axis=0)

    before, after = errors(found["drawing"]), errors(sharper)
    assert (after < 0.65 * before).all(), "five views: the median's scatter is 0.54 of one's"
    assert np.median(sharper.sigma, axis=0) == pytest.approx([0.54 * 0.06, 0.54 * 0.09], rel=0.2)
    assert (sharper.score == found["drawing"].score).all()


def test_steady_and_unsteady_boxes_are_told_apart():
    boxes = Boxes(np.array([[50, 50, 40, 16, 0], [150, 50, 40, 16, 0], [250, 50, 40, 16, 0]]), np.ones(3))
    looks = []
    for k in range(len(VIEWS)):
        xylwa = boxes.xylwa[:2].copy()  # the third is not seen again
        xylwa[1, 2] *= 1 + 0.15 * (-1) ** k
        looks.append(Boxes(xylwa, np.ones(2)))
    got = agreed(boxes, looks, np.zeros(2))
    assert got.sigma[1, 0] > 1.5 * got.sigma[0, 0]
    assert got.sigma[0, 0] > 0.01, "five views that agree by luck are not believed altogether"
    assert np.isnan(got.sigma[2]).all() and (got.xylwa[2] == boxes.xylwa[2]).all()
    assert len(agreed(Boxes.empty(), [Boxes.empty()] * 4, np.zeros(2))) == 0


@pytest.mark.parametrize("again, share", [(2, 0.449), (3, 0.298), (4, 0.287)])
def test_the_median_of_few_views_is_less_certain(again, share):
    """That of three was taken to be as certain as that of five."""
    rng = np.random.default_rng(3)
    xylwa = np.array([[50.0 * k, 50, 40, 16, 0] for k in range(400)])
    first, *looks = (
        Boxes(xylwa * np.exp([0, 0, 0.05, 0.05, 0] * rng.standard_normal((400, 5))), np.ones(400))
        for _ in range(1 + again)
    )
    got = agreed(first, looks, np.zeros(2))
    assert np.sqrt((got.sigma**2).mean(0)) == pytest.approx([0.05 * share**0.5] * 2, rel=0.05)


def test_views_that_agree_do_not_make_boxes_exact():
    """What views share stays as the ruler says it is."""
    rng = np.random.default_rng(1)
    boxes = Boxes(
        np.column_stack([50.0 * np.arange(60), np.zeros(60), np.full((60, 2), [40, 16]), np.zeros(60)]), [1] * 60
    )
    noise = np.array([4.0, 2.4])

    def sigma(share):
        looks = [boxes.xylwa.copy() for _ in VIEWS]
        for look in looks:
            look[:, 2:4] *= np.exp(share * noise / [40, 16] * rng.standard_normal((60, 2)))
        return np.median(agreed(boxes, [Boxes(look, boxes.score) for look in looks], noise).sigma * [40, 16], axis=0)

    assert sigma(0.01) == pytest.approx(noise, rel=0.02)
    assert (sigma(0.7) < 0.9 * noise).all()


def test_a_box_across_the_half_turn_keeps_its_direction():
    boxes = Boxes(np.array([[50, 50, 40, 16, np.pi / 2 - 0.01]]), np.ones(1))
    looks = [Boxes(np.array([[50, 50, 40, 16, angle]]), np.ones(1)) for angle in (-1.56, 1.56, -1.55, 1.55)]
    turn = (agreed(boxes, looks, np.zeros(2)).angle[0] - np.pi / 2 + np.pi / 2) % np.pi - np.pi / 2
    assert abs(turn) < 0.02


def test_sigma_and_kinds_travel_with_the_boxes():
    kinds = np.array([[1.0, 0, 0, 0], [0.1, 0.2, 0.3, 0.4]])
    boxes = Boxes(np.array([[0, 0, 9, 4, 0], [0, 0, 4, 9, 0]]), np.ones(2), np.array([[0.1, 0.2], [0.3, 0.4]]), kinds)
    assert boxes.sigma.tolist() == [[0.1, 0.2], [0.4, 0.3]], "turned with its box"
    both = Boxes.concatenate([boxes[1:].mapped(2.0, (1, 1)), Boxes(boxes.xylwa, boxes.score)])
    assert both.sigma[0].tolist() == [0.4, 0.3] and np.isnan(both.sigma[1:]).all()
    assert both.kinds[0].tolist() == [0.1, 0.2, 0.3, 0.4] and np.isnan(both.kinds[1:]).all()
    for what, shape in (("sigma", (3, 2)), ("kinds", (2, 3))):
        with pytest.raises(ValueError, match=f"{what} of shape"):
            Boxes(boxes.xylwa, boxes.score, **{what: np.zeros(shape)})


def test_a_vehicle_is_of_the_kind_that_those_views_say_which_were_looked_at():
    kinds = np.array([[0.2, 0.8, 0, 0], [np.nan] * 4, [0.4, 0.6, 0, 0], [np.nan] * 4])
    place = np.array([[0.0, 0], [0, 0], [0, 0], [100, 0]])
    votes = gather(Sightings(np.full((4, 2), [45.0, 18.0]), np.ones(4), place, np.ones(4), kinds=kinds), True)
    assert votes.kinds[0] == pytest.approx([0.3, 0.7, 0, 0]) and np.isnan(votes.kinds[1]).all()


def test_steady_boxes_count_more_in_the_pooling():
    """Half of the boxes are 15 % too large, and only by their sigma can one tell which half to believe."""
    fleet = load_fleet("DE")
    rng = np.random.default_rng(2)
    wrong = np.arange(80) < 40
    size = fleet.sample(rng, 80)[:, :2] / 0.1 * np.where(wrong, 1.15, 1.0)[:, None]

    def error(sigma):
        votes = gather(Sightings(size, np.ones(80), np.zeros((80, 2)), np.ones(80), sigma[:, None] * np.ones(2)), False)
        return abs(np.log(pool(votes, fleet, Ruler(noise=(5.0, 2.5)), "m/px").value / 0.1))

    unknown = error(np.full(80, np.nan))
    assert error(np.where(wrong, 0.25, 0.01)) < 0.8 * unknown < error(np.where(wrong, 0.01, 0.25))


@pytest.mark.slow
def test_refined_boxes_reach_the_pooling():
    town = Path(__file__).parent.parent / "examples" / "town" / "ortho.jpg"
    options = {"fleet": "DE", "gsd_hint": 0.085, "cache": False, "measurer": "none"}
    plain, sharp = (orthoscale.estimate(town, refine=r, **options) for r in (False, True))
    assert np.isnan(plain.votes.sigma).all() and np.isfinite(sharp.votes.sigma).mean() > 0.8
    assert sharp.scale.value == pytest.approx(plain.scale.value, rel=0.02)
    assert sharp.scale.value != plain.scale.value


def test_boxes_from_a_file_cannot_be_looked_at_again(tmp_path):
    with pytest.raises(UsageError, match="--refine does nothing here"):
        orthoscale.estimate(tmp_path / "a.png", detections=tmp_path / "a.json", refine=True)
