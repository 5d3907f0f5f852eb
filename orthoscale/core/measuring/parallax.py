"""The height of the ground from the vehicles' own parallax: a vehicle in several frames lies where their rays meet.

The ground of a reconstruction is a surface fitted below its sparse points (the sheet). Where these lie on tree crowns
and roofs only, it is too high: all distances are too short, and the scale comes out too large. Vehicles stand on the
ground, and frames that show one from two sides give its distance without any sparse point. So the surface is one
measurement of the ground's height, the vehicles are another, and the two are combined. That holds for parked vehicles.
Of moving ones two views meet by chance, at any height; they are told by how seldom they are found again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.special import softmax

from ..evenly import evenly
from ..normal import median_and_sd
from ..source import PosedSet
from ..votes import FOUND_IN, SAME_PLACE, same_place
from .footing import GROUND_SD, Footing

# Range and step of the search for the ground, in camera heights below the sheet: trees and roofs of 15 m under a flight
# at 60 m. As far above it, too: where the sheet lies on the ground, vehicles may stand on a parking deck or a bridge.
LOWEST_GROUND, HIGHEST_GROUND, DEPTH_STEP = 0.25, -0.25, 0.005
COINCIDING = 0.3  # of a vehicle's width: sigma of the Gaussian score of how well two places coincide
UNMATCHED = 0.5  # score of a box below which none of another frame coincides with it
CLEARLY = 1.2, 2.0  # factor and number of pairs by which the score must exceed that of the default depth
FEWEST_STANDING = 3  # vehicles seen in several frames; fewer are not used
BOX_SD = 0.05  # least error of the centre of a vehicle's box from view to view, one sigma, of the vehicle's width
# Height above the ground at which rays through the boxes' centres meet; its one sigma common to all boxes of a model,
# and for each vehicle; all as shares of a vehicle's length. Where boxes follow the body from the ground to the waist at
# 0.8 m, it is 0.4 m; where they follow the waist all around, or the roof in part, 0.8 m and more, of 4.5 m.
MIDDLE, MIDDLE_SD, MIDDLE_EACH = 0.13, 0.06, 0.04
OUTLYING = 9.0  # times the median squared residual, above which a vehicle does not enter the noise estimate
# Errors of a sheet, one sigma in camera heights: on crowns and roofs, common to all places (TOO_HIGH) and from place to
# place (UNEVEN; a sheet on crops has only the former); on the ground, common to all places (ON_GROUND). ON_TREES is the
# prior probability that it is not on the ground.
TOO_HIGH, UNEVEN, ON_GROUND, ON_TREES = 0.08, 0.02, 0.003, 0.1
ALIKE_WITHIN = 0.5  # correlation length of a sheet's errors, in camera heights
MOST_COMPARED = 200  # boxes by which the error common to all boxes is estimated
BOXES_AT_ONCE = 1000  # boxes that are worked on at a time: 8 MB per thousand vehicles
LEAST_VARIANCE = 4e-12  # of a place's height, as a share of the reach squared: the rounding error
# From which share of the boxes that other frames should confirm (parked vehicles: FOUND_IN of those that show a place)
# these do is there a parallax. Of four real models one has 0.7 (dark cars, many mistakes), the others 0.9 and more;
# simulated traffic has 0.05 to 0.35, by coincidence, and up to 0.6 along a strip, where half of it comes towards the
# camera, or where it moves by less than a width from view to view.
FOUND_AGAIN = 0.65
# Sigmas from which a vehicle that stands on no level with others is left out: its boxes are of more than one. Sigmas
# within which two stand on one level; a judgement.
STRAY_VEHICLE, SAME_LEVEL = 4.0, 2.0


@dataclass(frozen=True)
class Standing:
    """The ground under M boxes by the surface below the sparse points and by parallax, relative to the cameras'
    heights.

    lower : (M,) how far the ground lies below that surface; sizes and distances are larger by the same share. sd : (M,)
    one sigma of `lower`. shared : the part of `sd` that is common to all boxes, which does not average out.
    vehicles : number of vehicles seen in several frames, 0 if the surface alone is used. trees : probability that the
    surface does not lie on the ground.
    """

    lower: np.ndarray
    sd: np.ndarray
    shared: float = GROUND_SD
    vehicles: int = 0
    trees: float = 0.0

    @property
    def each(self) -> np.ndarray:
        """(M,) the part of `sd` that is not common to all boxes."""
        return np.sqrt(np.maximum(self.sd**2 - self.shared**2, 0.0))


def standing_in_model(
    source: PosedSet, picture: np.ndarray, place: np.ndarray, size: np.ndarray, shown: np.ndarray
) -> Footing:
    """The ground under M boxes, with the boxes' places on it.

    picture : (M,) name of the frame of each. place : (M, 3) where the ray through its centre meets the ground of
    `source`. size : (2,) typical length and width of a vehicle [units]. shown : (M,) number of frames that show each
    place.
    """
    ground = source.ground
    names, which = np.unique(picture, return_inverse=True)
    centre = np.array([source.centre(str(name)) for name in names])[which]
    plane, foot = ground.plane(place), ground.plane(centre)
    above = (centre - place) @ ground.up
    stands = standing(plane, foot, above, picture, (float(size[0]), float(size[1])), ground.sd(place), shown)
    place = centre + (place - centre) * (1 + stands.lower)[:, None]
    uneven, reach = np.sqrt(stands.trees) * UNEVEN, ALIKE_WITHIN * float(np.median(above))
    return Footing(place, stands.lower, stands.each, stands.shared, uneven, reach)


def standing(
    place: np.ndarray,
    foot: np.ndarray,
    above: np.ndarray,
    picture: np.ndarray,
    size: tuple[float, float],
    sd: np.ndarray,
    shown: np.ndarray,
) -> Standing:
    """The ground under the vehicles in M boxes.

    place : (M, 2) where the ray through the box's centre meets the surface, on its plane. foot : (M, 2) the point below
    the camera. above : (M,) the camera's height over the surface at `place`. picture : (M,) name of each box's frame.
    size : typical length and width of a vehicle. sd : (M,) one sigma of the surface's height. shown : (M,) number of
    frames that show `place`. All lengths in [units].
    """
    alone = _of_sheet(sd / above)
    if len(place) < FEWEST_STANDING:
        return alone
    offset, height = (place - foot) / above[:, None], float(np.median(above))
    length, width = size
    tried = height * np.arange(HIGHEST_GROUND, LOWEST_GROUND + DEPTH_STEP / 2, DEPTH_STEP)
    everywhere = _search(place, offset, picture, tried, 0.0, width)
    start = np.full(len(place), everywhere)
    for cell in _cells(place, height):
        usual = _search(place[cell], offset[cell], picture[cell], tried, everywhere, width)
        start[cell] = usual
        coinciding = _coinciding(place[cell] + usual * offset[cell], picture[cell], width)
        left = cell[coinciding < UNMATCHED]  # on another level, such as a parking deck, or moving
        start[left] = _search(place[left], offset[left], picture[left], tried, usual, width)
    seen = _triangulated(place, offset, picture, start, width)
    expected = 1 - (1 - FOUND_IN) ** np.maximum(shown - 1, 0)
    if len(seen.lower) < FEWEST_STANDING or seen.views.sum() < FOUND_AGAIN * expected.sum():
        return alone
    found = replace(seen, lower=seen.lower + MIDDLE * length, variance=seen.variance + (MIDDLE_EACH * length) ** 2)
    return _combined(found, place, sd, above, height, MIDDLE_SD * length)


@dataclass(frozen=True)
class _SeenVehicles:
    """K vehicles seen in several frames: place (K, 2) [units]; how far below the surface they stand (K,) [units], and
    its variance (K,); number of frames in which each is seen (K,)."""

    place: np.ndarray
    lower: np.ndarray
    variance: np.ndarray
    views: np.ndarray


def _cells(place: np.ndarray, side: float) -> list[np.ndarray]:
    """Indices of the places in each occupied square of a grid. side : of a square [units]."""
    number = np.floor((place - place.min(0)) / side).astype(int)
    _, cell = np.unique(number, axis=0, return_inverse=True)
    return [np.flatnonzero(cell.ravel() == k) for k in range(cell.max() + 1)]


def _search(
    place: np.ndarray, offset: np.ndarray, picture: np.ndarray, tried: np.ndarray, usual: float, width: float
) -> float:
    """The depth below the surface, of those `tried`, at which boxes of different frames coincide best; `usual` if no
    other is clearly better."""
    _, frame = np.unique(picture, return_inverse=True)
    tried = np.r_[usual, tried[np.argsort(np.abs(tried - usual), kind="stable")]]
    scores = [float(_coinciding(place + lower * offset, frame, width).sum()) / 2 for lower in tried]
    best = int(np.argmax(scores))
    return float(tried[best]) if scores[best] > CLEARLY[0] * scores[0] + CLEARLY[1] else usual


def _coinciding(at: np.ndarray, frame: np.ndarray, width: float) -> np.ndarray:
    """(M,) for each box at `at` (M, 2) [units], how many boxes of other frames coincide with it. frame : (M,) of each
    box."""
    i, j = cKDTree(at).query_pairs(3 * COINCIDING * width, output_type="ndarray").reshape(-1, 2).T
    i, j = i[frame[i] != frame[j]], j[frame[i] != frame[j]]
    score = np.exp(-0.5 * (np.linalg.norm(at[i] - at[j], axis=1) / (COINCIDING * width)) ** 2)
    return np.bincount(i, score, len(at)) + np.bincount(j, score, len(at))


def _triangulated(
    place: np.ndarray, offset: np.ndarray, picture: np.ndarray, start: np.ndarray, width: float
) -> _SeenVehicles:
    """Vehicles seen in several frames: groups of boxes that coincide at the depth `start` (M,) below the surface."""
    at = place + start[:, None] * offset
    labels = same_place(at, SAME_PLACE * width)
    rows, left = [], []
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        if len(mine) < 2 or len(np.unique(picture[mine])) < len(mine):
            continue
        o, p = offset[mine] - offset[mine].mean(0), place[mine] - place[mine].mean(0)
        lever = float((o**2).sum())
        if lever <= 0:
            continue
        lower = -float((o * p).sum()) / lever  # the depth at which place + lower * offset coincide best
        left.append((float(((p + lower * o) ** 2).sum()), 2 * len(mine) - 3))
        rows.append((*(place[mine] + lower * offset[mine]).mean(0), lower, lever, len(mine)))
    if not rows:
        return _SeenVehicles(np.empty((0, 2)), np.empty(0), np.empty(0), np.empty(0))
    x, y, lower, lever, views = np.array(rows).T
    squares, freedom = np.array(left).T
    each = squares / freedom
    usual = each <= OUTLYING * np.median(each)
    noise = max(float(squares[usual].sum() / freedom[usual].sum()), (BOX_SD * width) ** 2)
    return _SeenVehicles(np.column_stack([x, y]), lower, np.maximum(each, noise) / lever, views)


@dataclass(frozen=True)
class _Error:
    """A model of the error of a surface's height: a Gaussian process over the places on it.

    common : one sigma of the error common to all places. uneven : of the error that varies from place to place.
    reach : its correlation length; all [units].
    """

    common: float
    uneven: float
    reach: float

    def covariance(self, a: _Spots, b: _Spots) -> np.ndarray:
        """(M, N) covariance of the errors at `a` (M) and `b` (N)."""
        squared = cdist(a.place, b.place, "sqeuclidean") / self.reach**2
        return self.common**2 + (np.outer(a.sd, b.sd) + self.uneven**2) * np.exp(-0.5 * squared)

    def known(self, at: _Spots, lower: np.ndarray, noise: np.ndarray, boxes: _Spots) -> _GroundBelow:
        """The error at `boxes` (M), given that `lower` (K,) was measured `at` K places, with covariance `noise`."""
        whole = lu_factor(self.covariance(at, at) + noise)
        mean, told = np.empty(len(boxes.sd)), np.empty(len(boxes.sd))
        for begin in range(0, len(boxes.sd), BOXES_AT_ONCE):
            part = slice(begin, begin + BOXES_AT_ONCE)
            shared = self.covariance(at, boxes[part])
            gain = lu_solve(whole, shared)
            mean[part], told[part] = lower @ gain, (gain * shared).sum(0)
        variance = np.maximum(self.common**2 + boxes.sd**2 + self.uneven**2 - told, LEAST_VARIANCE * self.reach**2)
        some = boxes[evenly(len(boxes.sd), MOST_COMPARED)]
        shared = self.covariance(at, some)
        alike = self.covariance(some, some).mean() - lu_solve(whole, shared).mean(1) @ shared.mean(1)
        log_determinant = np.log(np.abs(np.diag(whole[0]))).sum()
        evidence = -0.5 * (log_determinant + lower @ lu_solve(whole, lower))
        return _GroundBelow(mean, variance, max(float(alike), 0.0), float(evidence))


@dataclass(frozen=True)
class _Spots:
    """N places on the surface's plane. place : (N, 2). sd : (N,) one sigma of the surface's height there; [units]."""

    place: np.ndarray
    sd: np.ndarray

    def __getitem__(self, which: slice | np.ndarray) -> _Spots:
        return _Spots(self.place[which], self.sd[which])


@dataclass(frozen=True)
class _GroundBelow:
    """How far the ground lies below the surface at M boxes: mean (M,) and variance (M,). alike : the part of the
    variance that is common to all. evidence : log probability of the measurements under this error model, up to a
    constant."""

    mean: np.ndarray
    variance: np.ndarray
    alike: float
    evidence: float


def _combined(
    seen: _SeenVehicles, place: np.ndarray, sd: np.ndarray, above: np.ndarray, height: float, middle_sd: float
) -> Standing:
    """The surface and the vehicles combined, for the boxes at `place`. The surface lies on the ground, or is too high
    by the same amount everywhere, or by varying amounts. The cases are averaged, weighted by their posterior
    probabilities."""
    boxes = _Spots(place, sd)
    middle, scatter = median_and_sd(seen.lower)
    stray_sd = np.sqrt(scatter**2 + seen.variance + (UNEVEN * height) ** 2)
    keep = (np.abs(seen.lower - middle) < STRAY_VEHICLE * stray_sd) | _in_company(seen, ALIKE_WITHIN * height)
    if keep.sum() < FEWEST_STANDING:
        return _of_sheet(sd / above)
    at = _Spots(seen.place, sd[cKDTree(place).query(seen.place)[1]])[keep]
    noise = np.diag(seen.variance[keep]) + middle_sd**2
    reach = ALIKE_WITHIN * height
    cases = [
        _Error(common * height, uneven * height, reach).known(at, seen.lower[keep], noise, boxes)
        for common, uneven in ((ON_GROUND, 0.0), (TOO_HIGH, 0.0), (TOO_HIGH, UNEVEN))
    ]
    chance = softmax(np.log([1 - ON_TREES, ON_TREES / 2, ON_TREES / 2]) + [case.evidence for case in cases])
    means = np.array([case.mean for case in cases])
    mean = chance @ means
    variance = chance @ (np.array([case.variance for case in cases]) + (means - mean) ** 2)
    off = means.mean(1) - mean.mean()
    shared = float(np.sqrt(chance @ (np.array([case.alike for case in cases]) + off**2))) / height
    return Standing(mean / above, np.sqrt(variance) / above, shared, int(keep.sum()), float(chance[1:].sum()))


def _in_company(seen: _SeenVehicles, reach: float) -> np.ndarray:
    """(K,) bool: whether FEWEST_STANDING others within `reach` [units] stand on the level of each vehicle."""
    apart = np.abs(seen.lower[:, None] - seen.lower)
    level = apart < SAME_LEVEL * np.sqrt(seen.variance[:, None] + seen.variance)
    alike: np.ndarray = level & (cdist(seen.place, seen.place) < reach)
    return alike.sum(1) > FEWEST_STANDING


def _of_sheet(sd: np.ndarray) -> Standing:
    """The ground by the surface alone, whose height has the one sigma `sd` (M,) at each place [camera heights]."""
    return Standing(np.zeros(len(sd)), np.hypot(sd, GROUND_SD))
