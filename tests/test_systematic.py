"""What makes all sizes of one way of measuring err alike, and what of it is left in the mean of two ways."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from orthoscale.core.measuring.joining import united
from orthoscale.core.measuring.measurement import Pooled
from orthoscale.core.measuring.systematic import ENDS, SIDES, Systematic, of_height
from orthoscale.core.pooling.usable import vote_noise
from orthoscale.core.projection.own_ruler import CORNER, HEIGHT, LEAN, OwnRuler
from orthoscale.core.ruler import Ruler
from orthoscale.core.votes import Sightings, gather

CARD = OwnRuler.of_card((0.8, 0.8), (0.0, 0.0), (0.25, 0.25), (0.3, 0.3))


def test_the_mean_of_two_ways_errs_as_it_does_when_drawn():
    """Errors of two ways, drawn by cause: a cause of one name is one and the same in both."""
    a = Systematic(np.array([0.01, 0.02]), {"ground": np.array([0.005, 0.005]), ENDS: np.array([0.008, 0.0])})
    b = Systematic(np.array([0.03, 0.01]), {"ground": np.array([0.005, 0.005]), "lens": np.array([0.004, -0.006])})
    weight, rng = np.array([0.3, 0.8]), np.random.default_rng(0)
    drawn = {cause: rng.standard_normal((200_000, 1)) for cause in ("ground", ENDS, "lens")}

    def errors(way):
        return way.own * rng.standard_normal((200_000, 2)) + sum(drawn[c] * s for c, s in way.shared.items())

    mean = (1 - weight) * (one := errors(a)) + weight * (other := errors(b))
    assert a.mean(b, weight).covariance == pytest.approx(np.cov(mean.T), abs=2e-6)
    crossed = np.cov(one.T, other.T)[[0, 1], [2, 3]]
    assert a.cross(b) == pytest.approx(crossed, abs=4e-6) and a.cross(b)[0] > 0


def test_vehicles_that_two_ways_measured_have_the_mean_that_errs_least_and_keep_their_noise():
    """Of the mean of all five the noise counts for a fifth, what each way errs by in full, and the ground for none."""
    place, ground = 10.0 * np.arange(10).reshape(5, 2), {"ground": np.array([0.05, 0.05])}

    def way(size, own, noise, views, shown, common):
        votes = gather(Sightings(np.full((5, 2), size), np.ones(5), place, np.ones(5)), repeated=False)
        votes = replace(votes, views=np.full(5, views), shown=np.full(5, shown))
        pooled = Pooled(Ruler(common_sd=common), Systematic(np.full(2, own), ground), np.full((5, 2), noise))
        return SimpleNamespace(
            votes=votes, size=votes.size, pooled=pooled, scale=SimpleNamespace(used=np.ones(5, bool))
        )

    votes, ruler, covariance = united(way(10.0, 0.01, 0.10, 3, 8, 0.01), way(12.0, 0.04, 0.06, 5, 6, 0.03))
    alone = np.array([0.01**2 + 0.10**2 / 5, 0.04**2 + 0.06**2 / 5])
    share = alone[1] / alone.sum()
    assert votes.size == pytest.approx(np.full((5, 2), 10.0**share * 12.0 ** (1 - share)))
    assert vote_noise(votes, ruler) / votes.size == pytest.approx(np.full((5, 2), share * 0.10 + (1 - share) * 0.06))
    apart = (share * 0.01) ** 2 + ((1 - share) * 0.04) ** 2
    assert covariance == pytest.approx(np.diag([apart, apart]) + 0.05**2)
    assert (votes.views == 5).all() and (votes.shown == 8).all(), "one way does not see what the other does"
    assert ruler.common_sd == pytest.approx(share * 0.01 + (1 - share) * 0.03)


def test_what_only_the_card_tells_of_heights_is_the_same_in_both_ways():
    by_height = np.array([0.01, 0.03])
    alone = of_height(by_height)
    assert alone.own == pytest.approx(0) and alone.covariance == pytest.approx(np.diag(by_height**2))
    assert alone.mean(alone, np.full(2, 0.4)).covariance == pytest.approx(alone.covariance)
    told = of_height(by_height, np.array([0.0, 0.5]))
    assert told.covariance == pytest.approx(np.diag(by_height**2)), "what is shared is a part of the whole"
    assert told.cross(alone) == pytest.approx([0, 0.5 * 0.03**2])
    assert told.shared[ENDS] == pytest.approx(0) and told.shared[SIDES][1] == pytest.approx(0.015)


def test_views_that_tell_of_heights_part_the_error_from_the_cards():
    """Bodies drawn as the card does not know them, fitted to views that tell some of it (Kalman's update)."""
    rng = np.random.default_rng(1)
    slopes, size = np.zeros((1, 2, 5)), np.array([[4.5, 1.8]])
    slopes[0, :, HEIGHT], slopes[0, :, LEAN], slopes[0, :, CORNER] = 0.5, 0.1, 0.3
    assert CARD.left_of_height(CARD, size, np.where(np.arange(5) == HEIGHT, slopes, 0.0)) == pytest.approx(1)
    views = np.zeros((3, 5))
    views[:, HEIGHT], views[:, LEAN], views[:, CORNER], noise = 1.0, (0.2, 0.9, 1.5), 0.4, 0.1
    covariance, expected = CARD.covariance.copy(), []
    for axis, prior in enumerate(CARD.covariance):
        gain = prior @ views.T @ np.linalg.inv(views @ prior @ views.T + noise**2 * np.eye(3))
        covariance[axis] = prior - gain @ views @ prior
        off = rng.standard_normal((200_000, 5)) * np.sqrt(np.diag(prior))
        left = off - (off @ views.T + noise * rng.standard_normal((200_000, 3))) @ gain.T
        expected.append(np.corrcoef(left @ slopes[0, axis], off[:, HEIGHT])[0, 1])
    fitted = OwnRuler(CARD.value, covariance, views=3)
    found = fitted.left_of_height(CARD, size, slopes)
    assert found == pytest.approx(expected, abs=0.01) and (found > 0.1).all() and (found < 0.9).all()
    slopes[0, :, LEAN] = 3.0  # a lean that views do not tell from height: the two errors would cancel
    assert fitted.left_of_height(CARD, size, slopes) == pytest.approx(0)
