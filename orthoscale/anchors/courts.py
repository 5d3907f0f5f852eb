"""Finders of painted courts: searched for at a coarse resolution, measured in the picture's own pixels.

A court counts only if nearly all lines that the rules prescribe are found, and little is found where nothing should be
painted: a car park has many parallel lines, but none where a service line would have to be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ..core.anchors import Anchor, Standard
from .court_fit import CourtFit, fit_court
from .court_models import (
    BASKETBALL_COURTS,
    CENTRE_CIRCLE,
    HANDBALL_COURT,
    PENALTY_AREA,
    TENNIS_COURT,
    VOLLEYBALL_COURT,
    Court,
)
from .court_search import search
from .poses import Ridges
from .ridges import lightness
from .rules import SIGMAS_SEARCHED

SEARCHED = 0.3  # [m/px] of the search: a line of 5 cm is just seen, and a court is small
SAME_RESOLUTION = 0.05  # [ln] a picture nearer to that of the search is not resampled
ENLARGED = 2.0  # largest factor: a coarser picture is searched at a coarser resolution
SURE = 0.8  # share of a fit's paint that is seen, from which no other court is tried on it
COURTS_OVERLAP = 0.95  # of both sides: courts with nearer centres overlap; the rest allows for errors of fits
PAINT_SCATTER, SCATTER_TAKES = 0.25, 1.5  # paint hardly scatters by more than the first; evidence lost per unit of more
STRETCHED = 0.03  # largest |ln| of the ratio of pixels per metre along and across
# From 61 chips with tennis courts and 409 without (`benchmarks/anchors_courts.py`): fits to other things become ten
# times rarer with every 0.1 of evidence (one in 27 Mpx reaches 0.44); at EVEN they are as frequent as courts.
STEEPNESS = 25.0
EVEN = 0.54
NEVER_SURE = 0.002  # least probability of a false find: what has every line of a court may still be something else
# One sigma of the pixels per metre along and across a court, beyond the scatter about the fit: the distortion of
# orthophotos, and, times the squared GSD [m/px], the detail that lines lose in coarse pictures. STRETCH_REMAINS is the
# share of the difference between both directions that remains in their mean. From 148 courts on 61 chips, at 0.30, 0.41
# and 0.50 m/px.
ALONG_SD, ALONG_COARSE = 0.002, 0.016
ACROSS_SD, ACROSS_COARSE = 0.003, 0.018
STRETCH_REMAINS = 0.5


def evidence(fit: CourtFit) -> float:
    """Evidence for a court, 1 if all of it is seen and nothing else: the mean of the share of painted length that is
    seen and of the smallest such share among groups of strokes (those of one direction, or the arcs), less what ridges
    show where nothing should be painted, and less if ridges scatter about the strokes."""
    weight = np.array([stroke.weight for stroke in fit.court.strokes])
    fewer = min(float(np.average(fit.seen[group], weights=weight[group])) for group in fit.court.groups)
    return (
        0.5 * fit.lit
        + 0.5 * fewer
        - fit.court.bare * fit.marred
        - SCATTER_TAKES * max(0.0, fit.scatter - PAINT_SCATTER)
    )


def size_of(fit: CourtFit) -> tuple[float, float]:
    """Pixels per metre, the mean of both directions weighted by their variances, and its relative one sigma."""
    sd = np.array([
        np.sqrt(own**2 + least**2 + (coarse / size**2) ** 2)
        for own, size, least, coarse in (
            (fit.along_sd, fit.along, ALONG_SD, ALONG_COARSE),
            (fit.across_sd, fit.across, ACROSS_SD, ACROSS_COARSE),
        )
    ])  # fmt: skip
    share = sd**-2 / (sd**-2).sum()
    size = np.log([fit.along, fit.across])
    own = float(np.sqrt(((share * sd) ** 2).sum() + (STRETCH_REMAINS * (size[0] - size[1])) ** 2))
    return float(np.exp(share @ size)), own


def _resized(light: np.ndarray, gsd: float, searched: float) -> np.ndarray:
    factor = min(gsd / searched, ENLARGED)
    if abs(np.log(factor)) < SAME_RESOLUTION:
        return light
    size = [max(1, round(side * factor)) for side in light.shape[::-1]]
    return cv2.resize(light, size, interpolation=cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC)


def overlap(fit: CourtFit, place: np.ndarray) -> bool:
    """Whether a court like `fit` with its centre at `place` [px] would overlap it."""
    c, s = np.cos(fit.angle), np.sin(fit.angle)
    gap = np.abs(np.array([[c, s], [-s, c]]) @ (place - fit.place)) / (fit.along, fit.across)
    return bool((gap < COURTS_OVERLAP * fit.court.size).all())


def best_apart(fits: Sequence[CourtFit]) -> list[CourtFit]:
    """The fits with the most evidence that do not overlap, best first."""
    kept: list[CourtFit] = []
    for fit in sorted(fits, key=evidence, reverse=True):
        if not any(overlap(fit, other.place) or overlap(other, fit.place) for other in kept):
            kept.append(fit)
    return kept


@dataclass(frozen=True)
class CourtFinder:
    """Finds one kind of painted court, built to any of several rules; see `AnchorFinder`.

    courts : one for each rule. rivals : other courts of which parts look like these; where the evidence for a rival is
    greater, there is no court of this kind. even : evidence at which a find is as often something else as a court;
    finds with more are accepted. Other fields are those of the protocol.
    """

    kind: str
    courts: tuple[Court, ...]
    rivals: tuple[Court, ...] = ()
    even: float = EVEN
    finest: float = 0.05
    coarsest: float = 0.55

    @property
    def standards(self) -> tuple[Standard, ...]:
        """The standard of each court."""
        return tuple(court.standard for court in self.courts)

    @property
    def extent(self) -> float:
        """Diameter of the largest court [m]."""
        return max(court.extent for court in self.courts)

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """The courts in `image`, RGB uint8 (H, W, 3), that do not overlap; see `AnchorFinder`."""
        look = CourtLook(image, gsd, gsd_sd)
        fits = [fit for court in self.courts for fit in look.fits(court) if evidence(fit) > self.even]
        if fits:
            fits += [fit for court in self.rivals for fit in look.fits(court)]
        return [self._anchor(fit) for fit in best_apart(fits) if fit.court in self.courts]

    def _anchor(self, fit: CourtFit) -> Anchor:
        size, sd = size_of(fit)
        false = 1 / (1 + np.exp(STEEPNESS * (evidence(fit) - self.even)))
        return Anchor(
            kind=self.kind,
            place=fit.place,
            lines=fit.points(fit.court.drawing()),
            pixels=size * fit.court.standard.metres,
            relative_sd=sd,
            residual=fit.residual,
            standards=(fit.court.standard,),
            false=float(max(false, NEVER_SURE)),
        )


@lru_cache(maxsize=1)
def _ridges(light: bytes, height: int, width: int) -> Ridges:
    """Ridges of a picture (height, width) of float32; kept for the finders of other kinds, which look at it next."""
    return Ridges(np.frombuffer(light, np.float32).reshape(height, width))


class CourtLook:
    """One picture with its ridges, searched at `searched` m/px for courts of a size that fits the scale; other
    arguments as in `AnchorFinder.find`."""

    def __init__(self, image: np.ndarray, gsd: float, gsd_sd: float, searched: float = SEARCHED) -> None:
        self.gsd, self.spread = gsd, SIGMAS_SEARCHED * gsd_sd
        self.light = lightness(image)
        self.grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
        small = _resized(self.light, gsd, searched)
        self.factor = np.array(small.shape[::-1]) / self.light.shape[::-1]
        self.ridges = _ridges(small.astype(np.float32).tobytes(), *small.shape)

    def fits(self, court: Court, sure: float = SURE) -> list[CourtFit]:
        """All fits of `court` of a likely size and shape, whether true or not, in the order of the search. Where a fit
        has more than the share `sure` of its paint seen, no other is tried on it."""
        zoom = float(np.sqrt(self.factor.prod()))
        poses = search(self.ridges, court, zoom / self.gsd, self.spread)
        places = (poses.place + 0.5) / self.factor - 0.5
        found: list[CourtFit] = []
        for place, angle, size in zip(places, poses.angle, poses.size / zoom, strict=True):
            if any(fit.lit > sure and overlap(fit, place) for fit in found):
                continue
            fit = fit_court(self.light, self.grey, court, place, float(angle), float(size))
            if fit is not None:
                found.append(fit)
        return [
            fit
            for fit in found
            if abs(np.log(fit.along / fit.across)) <= STRETCHED
            and abs(np.log(size_of(fit)[0] * self.gsd)) <= self.spread + STRETCHED / 2
        ]


TENNIS = CourtFinder("tennis court", (TENNIS_COURT,))
# The others' `even` is higher: tennis courts, and grids of joints or roofs, have more strokes in common with them.
VOLLEYBALL = CourtFinder("volleyball court", (VOLLEYBALL_COURT,), (TENNIS_COURT,), even=0.6)
BASKETBALL = CourtFinder("basketball court", BASKETBALL_COURTS, (TENNIS_COURT,), even=0.58)
HANDBALL = CourtFinder("handball court", (HANDBALL_COURT,), (TENNIS_COURT, *BASKETBALL_COURTS), even=0.6)
FOOTBALL = CourtFinder("football pitch", (PENALTY_AREA, CENTRE_CIRCLE), (TENNIS_COURT,), even=0.6)
