"""Compares an orthophoto with the reconstruction it was made from, by the vehicles that both show.

The orthophoto has the vehicles' positions in pixels, the model has them in its units. The positions give the similarity
transform between the two, independently of the vehicles' sizes. So the model's scale gives metres per pixel a second
time, from other pictures and by another projection than the orthophoto's own boxes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import pdtrc

from ..core.pooling.agreement import Agreement, compare
from ..errors import TooLittleEvidence, UsageError

if TYPE_CHECKING:
    from ..core.source import Plan, PosedSet, Source
    from ..report.result import Result

SAME_POSITION = 0.35  # largest distance between a vehicle's two positions, as a share of a vehicle's length
LIKELY_RATIO = 0.25  # largest log ratio of the two scales; alignments by chance beyond it need not be tried
MIN_MATCHED = 6
NEIGHBOURS_ASKED = 24  # nearest vehicles of a start that test an alignment, before more vehicles do
PAIR_STEP = 8  # one in this many neighbours makes a pair with the start, the farthest first: it fixes the rotation best
CROSS_CHECK_FORMAT = "orthoscale check --model 1"
MOST_VEHICLES_BEGUN = 40  # vehicles from which the search starts
MOST_PAIRS_TRIED = 20_000  # pairs of the other set that one pair is laid on
MOST_PAIRS_GROWN = 6  # the best alignments of these, which are fitted to more vehicles
ENOUGH_COMMON = 0.9  # the search ends if more than this share of the smaller set's vehicles are common
MOST_WITHOUT_BETTER = 12  # the search ends after so many starts without a better alignment
LEAST_COMMON = 0.2  # share of the smaller set's vehicles below which the two do not show the same place
PLACES_ELSEWHERE = 100  # shifted places, which show how many vehicles coincide by chance
BY_CHANCE = 1e-3  # largest expected number of tries that have as many common vehicles by chance alone


@dataclass(frozen=True)
class CrossCheck:
    """An orthophoto compared with a model.

    units_per_pixel : model units that one pixel of the orthophoto covers. common : number of vehicles found in both.
    by_model : metres per pixel from the model's vehicles; by_ortho : from the orthophoto's own. agreement : of the two.
    """

    units_per_pixel: float
    common: int
    by_ortho: float
    by_model: float
    interval90_by_model: tuple[float, float]
    agreement: Agreement

    def document(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "format": CROSS_CHECK_FORMAT,
            "units_per_pixel": self.units_per_pixel,
            "common_vehicles": self.common,
            "metres_per_pixel_by_ortho": self.by_ortho,
            "metres_per_pixel_by_model": self.by_model,
            "interval90_by_model": list(self.interval90_by_model),
            "difference": self.agreement.difference,
            "sigmas": self.agreement.tension,
            "contradicts": self.agreement.contradicts,
        }


def check_against_model(ortho: Result, model: Result) -> CrossCheck:
    """Compare the scale of the orthophoto `ortho` with that of the reconstruction `model`.

    Raises UsageError if they are not one of each, TooLittleEvidence if their vehicles do not match: they show another
    place, or there are too few.
    """
    plan, posed = plan_and_posed(ortho.source, model.source)
    places = posed.from_above(model.votes.place[model.scale.used])
    pixels = plan.from_above(ortho.votes.place[ortho.scale.used])
    found = match(
        pixels * ortho.scale.value,
        places * model.scale.value,
        SAME_POSITION * float(np.median(model.vehicles["length"][model.scale.used])),
    )
    if found is None:
        raise TooLittleEvidence(
            f"the vehicles of {ortho.source.path} and {model.source.path} do not line up "
            f"({len(pixels)} and {len(places)} of them)",
            "Is the orthophoto of the same place? If vehicles stand in regular rows, more of them are needed.",
        )
    factor, common = found
    units_per_pixel = factor * ortho.scale.value / model.scale.value
    by_model = model.scale.value * units_per_pixel
    agreement = compare(
        {"orthophoto": ortho.scale, "model": replace(model.scale, value=by_model, unit=ortho.scale.unit)},
        one_network=ortho.detections.detector_sha256 == model.detections.detector_sha256,
    )
    low, high = (end * units_per_pixel for end in model.scale.interval90)
    return CrossCheck(units_per_pixel, common, ortho.scale.value, by_model, (low, high), agreement)


def plan_and_posed(ortho: Source, model: Source) -> tuple[Plan, PosedSet]:
    """The plan of `ortho` and the posed set of `model`. Raises UsageError if they are not one of each."""
    if ortho.plan is None or model.posed is None:
        raise UsageError("a cross-check needs an orthophoto and a model", "Give ORTHO.tif and --model FOLDER.")
    return ortho, model


def match(a: np.ndarray, b: np.ndarray, reach: float) -> tuple[float, int] | None:
    """The scale of the similarity from `a` (N, 2) to `b` (M, 2) that most points agree with, and how many do; None if
    few do.

    Both are in about the same unit (to LIKELY_RATIO); `reach` is the largest distance between matching points. A point
    of `a` and one near it are laid on all such pairs of `b`. Where their neighbours fall on points of `b` too, the
    similarity is fitted to more and more of them by least squares (Umeyama 1991). Seeded.
    """
    if min(len(a), len(b)) < MIN_MATCHED:
        return None
    random, there = np.random.default_rng(0), _Points.of(b, reach)
    best, tried = _search(a @ (1, 1j), there, random)
    if best.common < max(MIN_MATCHED, LEAST_COMMON * min(len(a), len(b))):
        return None
    # Two points coincide because they were laid on each other, and do not count.
    as_many = pdtrc(best.common - 3, max(_coincident(a, there, best, random), 1e-300))
    return None if tried * as_many > BY_CHANCE else (float(abs(best.factor)), best.common)


@dataclass(frozen=True)
class _Similarity:
    """A similarity of the plane, whose points are complex: a factor and a shift. common : how many points of one set
    it lays on points of the other."""

    common: int = 0
    factor: complex = 0j
    shift: complex = 0j

    def of(self, z: np.ndarray) -> np.ndarray:
        """Where it lays the complex points `z`, an array of any shape."""
        return self.factor * z + self.shift


@dataclass(frozen=True)
class _Points:
    """The points that others are laid on.

    z : (M,), complex. reach : the largest distance between matching points. first, second, apart : (P,) indices of
    neighbouring points, in either order, and their distances, the nearest first.
    """

    z: np.ndarray
    tree: cKDTree
    reach: float
    first: np.ndarray
    second: np.ndarray
    apart: np.ndarray

    @classmethod
    def of(cls, b: np.ndarray, reach: float) -> _Points:
        """Of the points `b` (M, 2)."""
        z, tree = b @ (1, 1j), cKDTree(b)
        first, second = _near_pairs(z, tree)
        apart = np.abs(z[second] - z[first])
        order = np.argsort(apart)
        return cls(z, tree, reach, first[order], second[order], apart[order])

    def hit_by(self, z: np.ndarray) -> np.ndarray:
        """Which of the complex points `z`, an array of any shape, have a point of these within reach."""
        return self.tree.query(_plane(z), distance_upper_bound=self.reach)[0] < np.inf

    def laid_on(self, start: complex, other: complex, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Factors (K,) and shifts (K,) that lay the points `start` and `other` on pairs of these; MOST_PAIRS_TRIED at
        most, at random."""
        step = other - start
        low, high = np.searchsorted(self.apart, np.abs(step) * np.array([1 - LIKELY_RATIO, 1 + LIKELY_RATIO]))
        pick = np.arange(low, high)
        if len(pick) > MOST_PAIRS_TRIED:
            pick = random.choice(pick, MOST_PAIRS_TRIED, replace=False)
        first, second = self.z[self.first[pick]], self.z[self.second[pick]]
        factors = (second - first) / step
        return factors, first - factors * start


def _search(za: np.ndarray, there: _Points, random: np.random.Generator) -> tuple[_Similarity, int]:
    """The similarity that lays most of the complex points `za` (N,) on points of `there`, and how many were tried."""
    best, tried, since = _Similarity(), 0, 0
    for start in za[random.permutation(len(za))[:MOST_VEHICLES_BEGUN]]:
        since += 1
        outwards = za[np.argsort(np.abs(za - start))]
        asked = outwards[1:NEIGHBOURS_ASKED]
        for other in asked[:: -max(1, min(PAIR_STEP, len(asked) // 3))]:
            factors, shifts = there.laid_on(start, other, random)
            if not len(factors):
                continue
            tried += len(factors)
            hits = there.hit_by(factors[:, None] * outwards[:NEIGHBOURS_ASKED] + shifts[:, None]).sum(1)
            for k in np.argsort(-hits, kind="stable")[:MOST_PAIRS_GROWN]:
                found = _grown(outwards, there, factors[k], shifts[k])
                if found is not None and found.common > best.common:
                    best, since = found, 0
        share = best.common / min(len(za), len(there.z))
        if share > ENOUGH_COMMON or (share > LEAST_COMMON and since >= MOST_WITHOUT_BETTER):
            break
    return best, tried


def _coincident(a: np.ndarray, there: _Points, found: _Similarity, random: np.random.Generator) -> float:
    """How many points of `a` (N, 2) coincide by chance with points of `there`.

    They are shifted a little, to places where vehicles stand as densely: in all directions, and along rows.
    """
    far = there.reach * random.uniform(4, 12, PLACES_ELSEWHERE)
    row = np.linalg.eigh(np.cov((a - a.mean(0)).T))[1][:, 1] @ (1, 1j) * found.factor / abs(found.factor)
    directions = np.exp(2j * np.pi * random.random(PLACES_ELSEWHERE)), row * random.choice([-1, 1], PLACES_ELSEWHERE)
    laid = found.of(a @ (1, 1j))
    return float(max(there.hit_by(laid + (far * way)[:, None]).sum(1).mean() for way in directions))


def _near_pairs(z: np.ndarray, tree: cKDTree) -> tuple[np.ndarray, np.ndarray]:
    """Ordered pairs (P,), (P,) of neighbouring points: each point with its 2 NEIGHBOURS_ASKED nearest."""
    near = tree.query(_plane(z), min(2 * NEIGHBOURS_ASKED, len(z)))[1]
    first = np.repeat(np.arange(len(z)), near.shape[1])
    other = first != near.ravel()
    return first[other], near.ravel()[other]


def _plane(z: np.ndarray) -> np.ndarray:
    """(..., 2) coordinates of the complex points `z` (...)."""
    return np.stack([z.real, z.imag], -1)


def _grown(za: np.ndarray, there: _Points, factor: complex, shift: complex) -> _Similarity | None:
    """The similarity fitted to more and more of the points `za` that fall on points of `there`, beginning with the one
    of `factor` and `shift`; None if the fit fails. za : sorted outwards from where that is known."""
    sizes = NEIGHBOURS_ASKED * 2 ** np.arange(int(np.ceil(np.log2(max(len(za) / NEIGHBOURS_ASKED, 1)))) + 1)
    found = _Similarity(0, factor, shift)
    for n in [*np.repeat(sizes, 2), len(za)]:
        distance, index = there.tree.query(_plane(found.of(za[:n])), distance_upper_bound=there.reach)
        near = distance < np.inf
        x, y = za[:n][near], there.z[index[near]]
        if near.sum() < MIN_MATCHED or not np.ptp(np.abs(x - x[0])):
            return None
        factor = np.vdot(x - x.mean(), y - y.mean()) / np.vdot(x - x.mean(), x - x.mean())
        found = _Similarity(int(near.sum()), factor, y.mean() - factor * x.mean())
        if abs(np.log(abs(factor))) > 2 * LIKELY_RATIO:
            return None
    return found
