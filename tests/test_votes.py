"""One vote per vehicle."""

from dataclasses import replace

import numpy as np
import pytest

from orthoscale.core.pooling.usable import OF_THE_VEHICLE, vote_noise
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import USUAL_NOISE, Sightings, gather


def test_views_of_a_parked_car_are_one_vote_and_neighbours_are_not():
    rng = np.random.default_rng(0)
    stalls = np.array([[0, 0, 0], [2.5, 0, 0], [5.0, 0, 0], [30, 4, 0]], float)
    which = np.repeat(np.arange(4), [12, 3, 1, 7])
    place = stalls[which] + rng.normal(0, 0.1, (len(which), 3))
    size = np.array([4.5, 1.8]) * np.exp(rng.normal(0, 0.03, (len(which), 2)))
    votes = gather(Sightings(size, np.full(len(which), 0.1), place, rng.uniform(0.5, 1, len(which))), repeated=True)
    assert sorted(votes.views.tolist()) == [1, 3, 7, 12]
    assert votes.size == pytest.approx(np.tile([4.5, 1.8], (4, 1)), rel=0.12)
    for members in votes.members:
        assert len(set(which[members])) == 1


def test_one_picture_means_one_vote_per_box_however_close():
    votes = gather(Sightings(np.ones((3, 2)), np.ones(3), np.zeros((3, 2)), np.array([0.1, 0.2, 0.3])), repeated=False)
    assert len(votes) == 3 and votes.views.tolist() == [1, 1, 1]


def test_what_is_not_known_of_boxes_is_nan_for_each():
    seen = Sightings(np.ones((3, 2)), np.ones(3), np.zeros((3, 2)), np.ones(3))
    for told in (seen, gather(seen, repeated=False), gather(seen, repeated=True)):
        assert told.sigma.shape == (len(told), 2) and told.kinds.shape == (len(told), 4)
        assert np.isnan(told.sigma).all() and np.isnan(told.kinds).all()
    with pytest.raises(ValueError, match=r"3 boxes but sigma of shape \(3,\)"):
        replace(seen, sigma=np.ones(3))


def test_an_odd_view_does_not_move_the_vote():
    size = np.array([[4.5, 1.8]] * 4 + [[9.0, 4.0]])
    votes = gather(Sightings(size, np.ones(5), np.zeros((5, 3)), np.ones(5)), repeated=True)
    assert votes.size[0].tolist() == pytest.approx([4.5, 1.8])


@pytest.mark.parametrize("repeated", [True, False])
def test_no_boxes_no_votes(repeated):
    assert len(gather(Sightings(np.empty((0, 2)), np.empty(0), np.empty((0, 3)), np.empty(0)), repeated)) == 0


def test_what_is_missed_as_often_as_vehicles_are_found_is_a_mistake():
    views, shown = zip(*((1, 1), (1, 4), (1, 5), (2, 9), (2, 10), (4, 15), (3, 25), (12, 12)), strict=True)
    which = np.repeat(np.arange(len(views)), views)
    place = 10.0 * which[:, None] * np.array([1.0, 0, 0])
    votes = gather(Sightings(np.full((len(which), 2), 2.0), np.ones(len(which)), place, np.ones(len(which))), True)
    assert votes.views.tolist() == list(views) and not votes.fleeting.any(), "how many frames show them is not known"
    votes = replace(votes, shown=np.array(shown))
    assert votes.fleeting.tolist() == [False, False, True, False, True, False, True, False]


def test_views_of_one_vehicle_err_alike_in_part():
    for views, of_median in ((1, 1.0), (4, 0.2982), (400, np.pi / 2 / 400)):
        sigma = np.full((views, 2), 0.04)
        votes = gather(
            Sightings(np.ones((views, 2)), np.ones(views), np.zeros((views, 3)), np.ones(views), sigma), True
        )
        left = 0.04 * np.sqrt(OF_THE_VEHICLE + (1 - OF_THE_VEHICLE) * of_median)
        assert vote_noise(votes, Ruler())[0] == pytest.approx([left, left], rel=0.02)


def test_views_that_stray_are_of_one_vehicle_unless_a_frame_shows_both():
    """Two vehicles cannot stand closer than a width: boxes 0.85 widths apart in two frames are one's."""
    size, width = np.tile([4.5, 1.8], (5, 1)), 1.8
    place = width * np.array([[0.0, 0.0], [0.1, 0.0], [0.85, 0.0], [2.0, 0.0], [3.2, 0.0]])
    score, pixel = np.ones(5), np.ones(5)

    def views(*frames):
        seen = gather(Sightings(size, pixel, place, score, picture=np.array(frames)), True)
        return sorted(map(sorted, (m.tolist() for m in seen.members)))

    assert views(*"abcab") == [[0, 1, 2], [3], [4]]
    assert views(*"abbab") == [[0, 1], [2], [3], [4]], "a frame shows both"
    assert len(gather(Sightings(size, pixel, place, score), True)) == 4, "where frames are not known"


def test_of_three_groups_in_a_row_the_two_that_are_nearest_to_each_other_are_one_vehicle():
    """0.9 and 0.8 widths apart: the middle one is the nearest to both, but has one nearest itself."""
    place = 1.8 * np.array([[0.0, 0.0], [0.9, 0.0], [1.7, 0.0]])
    seen = gather(
        Sightings(np.tile([4.5, 1.8], (3, 1)), np.ones(3), place, np.ones(3), picture=np.array([*"abc"])), True
    )
    assert sorted(m.tolist() for m in seen.members) == [[0], [1, 2]]


def test_a_vote_is_what_its_views_say_together():
    """Of sizes the middle in logarithms, of noises the root of the mean square, of scores the best."""
    size, sigma = np.array([[4.0, 1.6], [4.84, 2.5]]), np.array([[0.03, 0.04], [0.05, 0.08]])
    vote = gather(Sightings(size, np.array([0.1, 0.2]), np.zeros((2, 3)), np.array([0.6, 0.9]), sigma), True)
    assert vote.size == pytest.approx(np.array([[4.4, 2.0]])) and vote.score.tolist() == [0.9]
    assert vote.sigma == pytest.approx(np.sqrt([[0.0017, 0.004]]))
    assert (vote.pixel[0], vote.views[0], vote.lasting) == (pytest.approx(0.15), 2, None)


@pytest.mark.parametrize("told", [True, False])
def test_views_count_by_what_is_known_of_each(told):
    """A steep view and two flat ones, of one sigma each: the steep one has nine tenths of the weight in widths, where
    the flat ones are unsure of their height, and a third in lengths."""
    size = np.array([[4.5, 1.8], [4.5, 2.2], [4.5, 2.3]])
    sigma = np.full((3, 2), 0.03 if told else np.nan)
    noise = 0.03 if told else USUAL_NOISE
    lasting = noise * np.sqrt([[0.0, 0.0], [0.0, 17.0], [0.0, 17.0]])
    vote = gather(Sightings(size, np.ones(3), np.zeros((3, 3)), np.ones(3), sigma, lasting=lasting), True)
    assert vote.size[0] == pytest.approx([4.5, 1.8 * (2.2 / 1.8) ** (0.05 / 0.475)])
    assert vote.lasting[0] == pytest.approx([0.0, noise * np.sqrt(0.1 * 17)])
    alike = gather(Sightings(size, np.ones(3), np.zeros((3, 3)), np.ones(3), sigma, lasting=0 * lasting), True)
    assert alike.size[0] == pytest.approx([4.5, 2.2]), "with equal weights it is the median"
    sure = gather(Sightings(size, np.ones(3), np.zeros((3, 3)), np.ones(3), 0 * size, lasting=0 * lasting), True)
    assert sure.size[0] == pytest.approx([4.5, 2.2]), "boxes may say that they are exact"
