"""Merges boxes into one vote per physical vehicle: a parked car in thirty frames is one car, not thirty."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np

from .boxes import KINDS, of_each, unknown
from .by_value import ByValue
from .linked import linked

# Views whose ground points lie closer than this share of the typical width are the same vehicle. Parked side by side,
# vehicles stand 1.35 widths apart or more (stalls of 2.4 m and up), so chains do not form.
SAME_PLACE = 0.6
# The centres of two vehicles cannot come closer than a width either. Groups of views that do are of one vehicle whose
# boxes stray (it stands half in the shade or under a tree), unless a frame shows both.
LEAST_APART = 1.0
# Share of the frames showing a vehicle in which it is found: about the recall of the shipped detector in frames, 0.84
# and 0.88 (detect/weights/README.md). Of five frames, a parked vehicle is then found in one only in 0.6 % of the cases,
# a moving one more often.
FOUND_IN = 0.8
ENOUGH_FRAMES = 5  # frames that show a place, from which on a mistake can be told from a vehicle
USUAL_NOISE = 0.05  # relative one sigma of a box that has no `sigma` of its own, besides `lasting`
LEAST_NOISE = 1e-3  # least relative one sigma, for boxes that claim to have none


@dataclass(frozen=True)
class Sightings:
    """M boxes as they lie on the ground: each is one sighting of a vehicle.

    size : (M, 2), pixel : (M,), place : (M, D), score : (M,), sigma : (M, 2), kinds : (M, 4), lasting : (M, 2) as in
    `Votes`, but of single boxes. picture : (M,) name of each one's picture, None if that is not known.
    """

    size: np.ndarray
    pixel: np.ndarray
    place: np.ndarray
    score: np.ndarray
    sigma: np.ndarray = field(default_factory=unknown)
    kinds: np.ndarray = field(default_factory=unknown)
    lasting: np.ndarray | None = None
    picture: np.ndarray | None = None

    def __post_init__(self) -> None:
        _fill_in(self)

    def __len__(self) -> int:
        return len(self.size)

    def __getitem__(self, index: np.ndarray) -> Sightings:
        parts = {each.name: getattr(self, each.name) for each in fields(self)}
        return replace(self, **{name: part[index] for name, part in parts.items() if part is not None})


@dataclass(frozen=True, eq=False)
class Votes(ByValue):
    """N vehicles, each measured once (an orthophoto) or as the median over its views (frames).

    size : (N, 2) length and width [source units].
    pixel : (N,) ground size of one detector pixel [source units]; box margin and box noise come in such pixels.
    views : (N,) number of boxes behind the vote.
    place : (N, 2) or (N, 3) where it stands [source units].
    score : (N,) best confidence of its boxes.
    members : (N,) lists of the boxes' indices.
    sigma : (N, 2) relative one-sigma noise of one of its boxes (`Boxes.sigma`), NaN where the ruler's holds.
    kinds : (N, 4) probability of each of `boxes.KINDS`, NaN where unknown.
    lasting : (N, 2) relative one-sigmas of those errors of its size that more views do not reduce: from the ground's
        height under it, and from how high its boxes reach.
    shown : (N,) number of pictures that have its place in view, None if that is not known.
    """

    size: np.ndarray
    pixel: np.ndarray
    views: np.ndarray
    place: np.ndarray
    score: np.ndarray
    members: list[np.ndarray]
    sigma: np.ndarray = field(default_factory=unknown)
    kinds: np.ndarray = field(default_factory=unknown)
    lasting: np.ndarray | None = None
    shown: np.ndarray | None = None

    def __post_init__(self) -> None:
        _fill_in(self)

    def __len__(self) -> int:
        return len(self.size)

    def counted(self, used: np.ndarray) -> list[np.ndarray]:
        """The `members` of the votes that are `used` (N,) bool."""
        return [members for members, counts in zip(self.members, used, strict=True) if counts]

    @property
    def fleeting(self) -> np.ndarray:
        """(N,) bool: missed in as many of the frames that show its place as a parked vehicle is found in, or in more.
        Mistakes flicker, parked cars stay. None are if it is not known how many frames show them."""
        if self.shown is None:
            return np.zeros(len(self), bool)
        missed = self.shown - self.views
        return (self.shown >= ENOUGH_FRAMES) & (missed >= FOUND_IN * self.shown)


def _fill_in(of: Sightings | Votes) -> None:
    """Give each its own sigma and kinds where these are `unknown`, as `Boxes` does."""
    object.__setattr__(of, "sigma", of_each(of.sigma, "sigma", len(of), 2))
    object.__setattr__(of, "kinds", of_each(of.kinds, "kinds", len(of), len(KINDS)))


def gather(seen: Sightings, repeated: bool) -> Votes:
    """One vote for each vehicle that is `seen`.

    `repeated`: the boxes come from several pictures that show the same vehicles, so boxes in one place are one vehicle.
    If it is known which picture each is from, views that stray are joined too (`LEAST_APART`).
    """
    labels = np.arange(len(seen))
    if repeated and len(seen):
        width = float(np.median(seen.size[:, 1]))
        labels = same_place(seen.place, SAME_PLACE * width)
        if seen.picture is not None:
            labels = _joined(labels, seen.place, seen.picture, LEAST_APART * width)
    views, members = np.bincount(labels), _groups(labels)
    alone = views == 1

    def over(values: np.ndarray, summary=np.median, weight: np.ndarray | None = None) -> np.ndarray:
        out = np.empty((len(members), *values.shape[1:]))
        out[alone] = values[[members[k][0] for k in np.flatnonzero(alone)]]  # nearly all, in an orthophoto
        for k in np.flatnonzero(~alone):
            weights = {} if weight is None else {"weights": weight[members[k]]}
            out[k] = summary(values[members[k]], axis=0, **weights)
        return out

    weight = None if seen.lasting is None else view_weights(seen.sigma, seen.lasting)
    return Votes(
        size=np.exp(over(np.log(seen.size), np.median if weight is None else weighted_median, weight)),
        pixel=over(seen.pixel),
        views=views,
        place=over(seen.place),
        score=over(seen.score, np.max),
        members=members,
        sigma=np.sqrt(over(seen.sigma**2, np.mean)),
        kinds=over(seen.kinds, _mean_of_known),
        lasting=None if seen.lasting is None else np.sqrt(over(seen.lasting**2, np.average, weight)),
    )


def view_weights(sigma: np.ndarray, lasting: np.ndarray | None) -> np.ndarray:
    """(M, 2) weights of sightings beside others of their vehicle: their inverse variances. Arguments as in
    `Sightings`."""
    variance = np.where(np.isfinite(sigma), sigma, USUAL_NOISE) ** 2 + (0.0 if lasting is None else lasting**2)
    return 1 / np.maximum(variance, LEAST_NOISE**2)


def weighted_median(values: np.ndarray, axis: int, weights: np.ndarray) -> np.ndarray:
    """(D,) weighted median of `values` (N, D) with `weights` (N, D) along `axis` 0, which are given as to
    `numpy.average`: half of the weight lies on either side. With equal weights it is the median."""
    order = np.argsort(values, axis=axis, kind="stable")
    values, weights = np.take_along_axis(values, order, axis), np.take_along_axis(weights, order, axis)
    # Each value lies at the middle of its weight; between two values the median is interpolated linearly.
    middle = (np.cumsum(weights, axis=axis) - weights / 2) / weights.sum(axis)
    return np.array([np.interp(0.5, middle[:, k], values[:, k]) for k in range(values.shape[1])])


def _groups(labels: np.ndarray) -> list[np.ndarray]:
    """The indices of the boxes of each label 0, 1, 2 ... in `labels` (M,)."""
    return np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))[:-1]) if len(labels) else []


def _joined(labels: np.ndarray, place: np.ndarray, picture: np.ndarray, least: float) -> np.ndarray:
    """(M,) `labels` of groups of boxes, after two groups were joined if their median places, by `place` (M, D), lie
    closer than `least`, each is the nearest to the other, and no `picture` (M,) shows both."""
    from scipy.spatial import cKDTree

    groups = _groups(labels)
    if len(groups) < 2:
        return labels
    middle = np.array([np.median(place[group], axis=0) for group in groups])
    distance, nearest = (found[:, 1] for found in cKDTree(middle).query(middle, k=2))
    target = np.arange(len(groups))
    for k in np.flatnonzero((distance < least) & (nearest[nearest] == target) & (target < nearest)):
        if not np.isin(picture[groups[k]], picture[groups[nearest[k]]]).any():
            target[nearest[k]] = k
    return np.unique(target[labels], return_inverse=True)[1]


def _mean_of_known(rows: np.ndarray, axis: int) -> np.ndarray:
    """Mean of the rows without NaN; NaN if there are none."""
    known = rows[np.isfinite(rows).all(1)]
    return known.mean(axis) if len(known) else rows[0]


def same_place(place: np.ndarray, reach: float) -> np.ndarray:
    """(M,) cluster number of each point: points linked by steps shorter than `reach`."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(place).query_pairs(reach, output_type="ndarray")
    return linked(pairs[:, 0], pairs[:, 1], len(place))
