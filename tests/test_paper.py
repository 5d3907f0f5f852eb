"""The paper's estimator against tables worked out by hand."""

import numpy as np
import pytest

from orthoscale.core.pooling.paper import pool_iqr, pool_paper
from orthoscale.core.votes import Votes
from orthoscale.errors import TooLittleEvidence
from orthoscale.fleets import load_fleet

TEN = [0.08, 0.09, 0.09, 0.10, 0.10, 0.10, 0.11, 0.11, 0.12]  # quartiles 0.09 and 0.11, so 0.06 to 0.14 counts


@pytest.mark.parametrize(
    "scales, scores, value, used",
    [
        (TEN, [0.9] * 9, 0.1, [1] * 9),
        ([*TEN, 0.5], [0.9] * 10, 0.1, [1] * 9 + [0]),  # an outlier above
        ([*TEN, 0.01], [0.9] * 10, 0.1, [1] * 9 + [0]),  # and below
        ([*TEN, 0.12], [0.9] * 9 + [0.5], 0.1, [1] * 9 + [0]),  # a score of exactly the threshold does not count
        ([*TEN, 0.12], [0.9] * 9 + [0.51], 0.102, [1] * 10),
        ([1, 1, 1, 1, 1, 2], [0.9] * 6, 1.0, [1] * 5 + [0]),  # no spread: nothing else counts
        ([1, 2, 3, 4, 5], [0.6] * 5, 3.0, [1] * 5),
        ([1, 2, 3, 4, 5, np.nan, np.inf], [0.6] * 7, 3.0, [1] * 5 + [0, 0]),
        ([0, 10, 11, 12, 22], [0.6] * 5, 11.0, [0, 1, 1, 1, 0]),  # 10 - 1.5 * 2 = 7 and 12 + 1.5 * 2 = 15
        ([7, 10, 11, 12, 15], [0.6] * 5, 11.0, [1] * 5),  # the ends of the range count
    ],
)
def test_mean_within_the_whiskers(scales, scores, value, used):
    result = pool_iqr(np.array(scales), np.array(scores))
    assert result.value == pytest.approx(value)
    assert result.used.tolist() == [bool(u) for u in used]
    assert result.vehicles_used == sum(used)


def test_the_interval_is_students():
    result = pool_iqr(np.array([1.0, 2, 3, 4, 5]), np.ones(5))
    half = 2.1318 * np.sqrt(2.5 / 5)  # t of 4 degrees of freedom, 95 %; variance 2.5
    assert result.interval90 == pytest.approx((3 - half, 3 + half), rel=1e-4)


@pytest.mark.parametrize("scores, count", [([0.9] * 4, 4), ([0.9] * 4 + [0.4] * 9, 4), ([], 0)])
def test_fewer_than_five_are_refused(scores, count):
    with pytest.raises(TooLittleEvidence, match=f"{count} of {len(scores)} vehicles have a score above 0.5"):
        pool_iqr(np.ones(len(scores)), np.array(scores))


def test_both_thresholds_are_the_callers():
    result = pool_iqr(np.array([1.0, 3.0]), np.array([0.2, 0.3]), min_score=0.1, min_vehicles=2)
    assert result.value == 2
    alone = pool_iqr(np.array([1.0]), np.array([0.3]), min_score=0.1, min_vehicles=1)
    assert alone.value == 1 and alone.interval90 == (-np.inf, np.inf)


def paper_votes(length, score):
    n = len(length)
    size = np.stack([length, length / 2.4], 1)
    return Votes(size, np.ones(n), np.ones(n, int), np.zeros((n, 2)), score, [np.array([k]) for k in range(n)])


@pytest.mark.parametrize("unit", [0.01, 100.0])
def test_each_vehicle_that_does_not_count_says_why(unit):
    length = np.array([4.2, 4.3, 4.4, 4.5, 4.6, 2.0, 9.0, 4.4]) / unit
    scale = pool_paper(paper_votes(length, np.array([0.9] * 7 + [0.3])), load_fleet("PAPER"), "m/px")
    assert scale.reasons == [""] * 5 + ["beyond the whiskers, too small", "beyond the whiskers, too large"] + [
        "score of 0.5 or less"
    ]


def test_vehicles_that_scatter_without_end_tell_no_scale():
    """The mean less its error would be below 0."""
    votes = paper_votes(4.4 / np.array([0.1, 0.1, 0.12, 1.4, 1.5]), np.ones(5))
    with pytest.raises(TooLittleEvidence, match="scatter so much that the mean of 5"):
        pool_paper(votes, load_fleet("PAPER"), "m/px")
