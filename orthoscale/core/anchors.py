"""Anchors, objects of standard size in a picture: the types that describe them, and the protocol of their finders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy.spatial import cKDTree

from .by_value import ByValue
from .linked import linked

SAMPLED = 0.05  # spacing of the points at which lines are compared [anchors' reference lengths]
BAYS = "parking bays"  # the kind of rows of bays, whether found by their lines or by the vehicles in them
NEAR_LINES = 0.1  # distance within which two lines are the same one [reference lengths]; neighbours are farther apart
SHARED_LINES = 0.5  # share of one anchor's lines that lie on another's from which the two are one object


@dataclass(frozen=True)
class Standard:
    """A standardised size. name : of the rule, for people. metres : the anchor's reference length by this rule.
    relative_sd : one sigma of objects built to the standard. prior : its prior probability among the standards that an
    anchor may follow, given the anchor's shape, up to a common factor; ignored when standards are compared, so that
    anchors of one standard are recognised as such. countries : ISO codes where it applies, empty for everywhere.
    source : of the figure. documented : False if the figure was only recalled, or no document says what is built: it
    then improves no verdict."""

    name: str
    metres: float
    relative_sd: float
    source: str
    prior: float = field(default=1.0, compare=False)
    countries: tuple[str, ...] = ()
    documented: bool = field(default=True, compare=False)


def size_in_words(standard: str, metres: float, rows: str = "") -> str:
    """The name of a `standard` and its `metres`, for people. rows : how many there are, as "7 in a row", if their
    distance is meant: that of a crossing with "stripes 0.50 m, gaps 0.50 m" is 1 m."""
    return f"{rows}, each {metres:.4g} m: {standard}" if rows else f"{standard}, {metres:.4g} m"


def holding(standards: Sequence[Standard], country: str) -> list[Standard]:
    """The `standards` that hold in `country`: those that name it, else those that apply everywhere, else all."""
    own = [standard for standard in standards if country in standard.countries]
    return own or [standard for standard in standards if not standard.countries] or list(standards)


@dataclass(frozen=True, eq=False)
class Anchor(ByValue):
    """One object of standard size that was found in a picture.

    kind : "tennis court" ..., in words. picture : the picture's name, empty until the search is over.
    place : (2,) its middle [px]. lines : (N, 2, 2) the fitted model's lines from end to end [px], to be drawn.
    pixels : its reference length, independent of the model's orientation [px].
    relative_sd : one sigma of that, from the fit and from how pictures distort; without the standard's own.
    residual : (M,) distances of the measured line points from the model, across the lines [px].
    standards : those that it may follow. false : probability that it follows none of them.
    count : number of repetitions that it rests on (dashes of a lane, bays of a row); 1 for a single object.
    unlike : where the country is not known, codes of the countries whose standards it does not fit. The anchor is then
        evidence on the country, and not on the scale.
    Pixel coordinates: x right, y down, (0, 0) is the upper left corner of the upper left pixel.
    """

    kind: str
    place: np.ndarray
    lines: np.ndarray
    pixels: float
    relative_sd: float
    residual: np.ndarray
    standards: tuple[Standard, ...]
    false: float
    count: int = 1
    unlike: tuple[str, ...] = ()
    picture: str = field(default="", kw_only=True)

    def metres_per_pixel(self) -> np.ndarray:
        """(S,) the scale that it gives under each of its standards."""
        return np.array([standard.metres / self.pixels for standard in self.standards])


@dataclass(frozen=True, eq=False)
class AnchorVote(ByValue):
    """One anchor on the ground of a source, however many pictures show it.

    anchor : as its best picture shows it. place : (D,) where it lies, and units : its reference length [source units].
    relative_sd : one sigma of that length, from all pictures together; without the standard's own.
    shared_sd : one sigma of the error common to all anchors and vehicles of the source: the height of its ground.
    kind_sd : one sigma of the error common to the anchors of this kind alone: how high they lie.
    window : width of the range of sizes that was searched, in logarithms: a false find may lie anywhere in it.
    views : number of pictures that show it.
    """

    anchor: Anchor
    place: np.ndarray
    units: float
    relative_sd: float
    shared_sd: float = 0.0
    kind_sd: float = 0.0
    window: float = 1.0
    views: int = 1

    def of(self, standards: tuple[Standard, ...] | None) -> AnchorVote:
        """The same vote, which may follow only these `standards`; itself for None."""
        return self if standards is None else replace(self, anchor=replace(self.anchor, standards=standards, unlike=()))


class AnchorFinder(Protocol):
    """Finds one kind of anchor.

    kind : of its anchors. standards : all that its anchors may follow. extent : of the largest anchor [m]; search
    windows overlap by that much. finest, coarsest : range of ground sampling distances [m/px] in which it works: a
    finer picture is first reduced to `finest`; a picture coarser than `coarsest` is not searched.
    """

    @property
    def kind(self) -> str: ...
    @property
    def standards(self) -> tuple[Standard, ...]: ...
    @property
    def extent(self) -> float: ...
    @property
    def finest(self) -> float: ...
    @property
    def coarsest(self) -> float: ...

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """The anchors in `image`, RGB uint8 (H, W, 3), of roughly `gsd` m/px with a relative one-sigma of `gsd_sd`
        (sizes within two sigma are searched). `country` is an ISO code of two letters, empty where it is not known.

        Coordinates are those of `image` in OpenCV's convention, with whole numbers at pixel centres; the search turns
        them into those of `Anchor`. Never raises for a picture, however odd.
        """
        ...


def alike(lines: Sequence[np.ndarray], size: Sequence[float], blur: float = 0.0) -> np.ndarray:
    """(N,) labels of anchors of one kind; anchors whose lines coincide are the same object and have the same label.

    lines : of each anchor, (L, 2, D) from end to end. size : each one's reference length. blur : how far apart the same
    line may come out in two pictures. All in the same units.
    """
    number = np.arange(len(lines))
    if len(lines) < 2:
        return number
    points = [_along(one, SAMPLED * length) for one, length in zip(lines, size, strict=True)]
    low, high = (np.array([f(p, axis=0) for p in points]) for f in (np.min, np.max))
    reach = np.maximum(NEAR_LINES * np.asarray(size), blur)
    trees = [cKDTree(p) for p in points]
    pairs = []
    for k in range(len(lines)):
        beside = (low[k + 1 :] <= high[k] + reach[k]).all(1) & (high[k + 1 :] >= low[k] - reach[k]).all(1)
        for other in (k + 1 + np.flatnonzero(beside)).tolist():
            near = min(reach[k], reach[other])
            shares = [
                np.isfinite(trees[b].query(points[a], distance_upper_bound=near)[0]).mean()
                for a, b in ((k, other), (other, k))
            ]
            if max(shares) > SHARED_LINES:
                pairs.append((k, other))
    if not pairs:
        return number
    i, j = np.array(pairs).T
    return linked(i, j, len(lines))


def _along(lines: np.ndarray, step: float) -> np.ndarray:
    """(P, D) points about `step` apart on lines (L, 2, D)."""
    counts = np.ceil(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) / step).astype(int) + 1
    return np.concatenate(
        [
            start + np.linspace(0, 1, count)[:, None] * (end - start)
            for (start, end), count in zip(lines, counts.tolist(), strict=True)
        ]
    )
