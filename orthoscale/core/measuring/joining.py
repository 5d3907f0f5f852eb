"""Joins two measurements of one source: its vehicles as one set of votes, in which each counts once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..boxes import KINDS
from ..pooling.usable import left_by_views
from ..ruler import Ruler
from ..votes import Votes
from .measurement import Measurement, Pooled

SEEN_BOTH_WAYS = 0.8  # of a vehicle's width: largest distance between the places of one vehicle in the two modes


@dataclass(frozen=True)
class Matched:
    """K vehicles that two measurements share. a, b : (K,) indices of their votes in the first and in the second."""

    a: np.ndarray
    b: np.ndarray


def in_common(a: Measurement, b: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """(K, 2) log ratio of the sizes by `a` to those by `b`, of the vehicles that count in both; and (K, 3) their
    positions."""
    both = _matched(a, b, *(np.flatnonzero(m.scale.used) for m in (a, b)))
    return np.log(a.size[both.a]) - np.log(b.size[both.b]), a.votes.place[both.a]


def united(a: Measurement, b: Measurement) -> tuple[Votes, Ruler, np.ndarray]:
    """The vehicles of two modes as one set of votes, without the margin; their ruler; and the (2, 2) covariance of the
    geometry's errors.

    The two sizes of a vehicle measured in both modes are weighted by the errors that the modes do not share
    (`_shares`). The ruler's uncertainty is the weighted mean of both, as if it were common to them; with two networks
    that is true only in part. The geometry's uncertainty is common in part.
    """
    both = _matched(a, b, np.arange(len(a.votes)), np.arange(len(b.votes)))
    share = _shares(a.pooled, b.pooled, both)
    weight = _weights(a, b, both, share)
    systematic = a.pooled.systematic.mean(b.pooled.systematic, weight[1])
    return _joined_votes(a, b, both, share), _joined_ruler(a, b, weight), systematic.covariance


def _joined_votes(a: Measurement, b: Measurement, both: Matched, share: np.ndarray) -> Votes:
    """All vehicles of `a`, then those that only `b` measured.

    The size of a vehicle of `both` is the mean of the two, in which `a` has the weight `share` (K, 2). Both modes use
    the same pixels, so its noise is the weighted mean of the two noises and does not average out. Its kind
    probabilities are the mean of the two.
    """
    ia, ib = both.a, both.b
    rest = np.setdiff1d(np.arange(len(b.votes)), ib)
    size, noise, views = a.size.copy(), a.pooled.noise.copy(), a.votes.views.copy()
    size[ia] = np.exp(share * np.log(a.size[ia]) + (1 - share) * np.log(b.size[ib]))
    noise[ia] = share * a.pooled.noise[ia] + (1 - share) * b.pooled.noise[ib]
    views[ia] = np.maximum(views[ia], b.votes.views[ib])
    views = np.concatenate([views, b.votes.views[rest]])
    noise = np.concatenate([noise, b.pooled.noise[rest]])
    shown = None
    if a.votes.shown is not None and b.votes.shown is not None:
        shown = a.votes.shown.copy()
        shown[ia] = np.maximum(shown[ia], b.votes.shown[ib])
        shown = np.concatenate([shown, b.votes.shown[rest]])
    kinds, other = _kinds(a), _kinds(b)
    mean = (kinds[ia] + other[ib]) / 2
    kinds[ia] = np.where(np.isfinite(mean), mean, np.where(np.isfinite(kinds[ia]), kinds[ia], other[ib]))
    return Votes(
        size=np.concatenate([size, b.size[rest]]),
        pixel=np.concatenate([a.votes.pixel, b.votes.pixel[rest]]),
        views=views,
        place=np.concatenate([a.votes.place, b.votes.place[rest]]),
        score=np.concatenate([a.votes.score, b.votes.score[rest]]),
        members=[np.array([k]) for k in range(len(noise))],
        sigma=noise / left_by_views(views)[:, None],
        kinds=np.concatenate([kinds, other[rest]]),
        shown=shown,
    )


def _joined_ruler(a: Measurement, b: Measurement, weight: np.ndarray) -> Ruler:
    """The ruler of the vehicles of both modes, by the modes' `weight` (2 modes, 2) from `_weights`. The margins are
    removed already, so their uncertainty is added to the bias."""
    rulers = a.pooled.ruler, b.pooled.ruler
    bias = [
        np.hypot(ruler.bias_sd, np.asarray(ruler.margin_sd) * np.median(way.votes.pixel[:, None] / way.size, axis=0))
        for ruler, way in zip(rulers, (a, b), strict=True)
    ]
    middle: dict[str, Any] = {
        name: tuple((weight * [getattr(ruler, name) for ruler in rulers]).sum(0).tolist())
        for name in ("shrink", "shrink_sd", "usual")
    }
    of_kinds = next((ruler for ruler in rulers if ruler.kinds), rulers[0])
    return Ruler(
        margin_sd=(0.0, 0.0),
        bias_sd=tuple((weight * bias).sum(0).tolist()),
        common_sd=float(weight.mean(1) @ [ruler.common_sd for ruler in rulers]),
        kinds=of_kinds.kinds,
        kinds_vehicles=of_kinds.kinds_vehicles,
        **middle,
    )


def _shares(a: Pooled, b: Pooled, both: Matched) -> np.ndarray:
    """(K, 2) weights of `a` in the lengths and widths of the K vehicles that both measured: those that minimise the
    variance of the mean of all K. In that mean, the noise variance of each counts for a Kth, errors common to a mode in
    full."""
    shared, count = a.systematic.cross(b.systematic), max(len(both.a), 1)
    own = [
        np.diag(way.systematic.covariance) - shared + way.noise[some] ** 2 / count
        for way, some in ((a, both.a), (b, both.b))
    ]
    return np.clip(own[1] / (own[0] + own[1]), 0, 1)


def _weights(a: Measurement, b: Measurement, both: Matched, share: np.ndarray) -> np.ndarray:
    """(2 modes, 2) weights of the modes in the mean of all lengths, and of all widths, if `a` has the weight `share`
    (K, 2) in the vehicles measured in both. All vehicles have equal weight: their true sizes
    differ by more than any measurement error."""
    of_a = np.ones((len(a.votes), 2))
    of_a[both.a] = share
    counts = a.scale.used.copy()
    counts[both.a] |= b.scale.used[both.b]
    only_b = b.scale.used.copy()
    only_b[both.b] = False
    first = of_a[counts].sum(0) / (counts.sum() + only_b.sum())
    return np.array([first, 1 - first])


def _kinds(of: Measurement) -> np.ndarray:
    """(N, 4) kind probabilities of the votes of a measurement, NaN where they are not used."""
    if not of.pooled.ruler.kinds:
        return np.full((len(of.votes), len(KINDS)), np.nan)
    return of.votes.kinds.copy()


def _matched(a: Measurement, b: Measurement, some_a: np.ndarray, some_b: np.ndarray) -> Matched:
    """The vehicles that both measured: mutual nearest neighbours among the votes of indices `some_a` and `some_b`."""
    if not len(some_a) or not len(some_b):
        return Matched(np.empty(0, int), np.empty(0, int))
    reach = SEEN_BOTH_WAYS * float(np.median(a.size[some_a, 1]))
    trees = cKDTree(a.votes.place[some_a]), cKDTree(b.votes.place[some_b])
    distance, nearest = trees[0].query(b.votes.place[some_b], distance_upper_bound=reach)
    k = np.flatnonzero(np.isfinite(distance))
    mutual = trees[1].query(a.votes.place[some_a[nearest[k]]])[1] == k
    return Matched(some_a[nearest[k[mutual]]], some_b[k[mutual]])
