"""Padel courts, by their service lines within the walls.

Three such lines are common elsewhere: in grids of joints, within tennis courts. But a padel court is also one piece of
artificial turf that ends at its walls, 10 m to either side of the net and 5 m to either side of the central line, and
nothing else is painted on it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ..core.anchors import Anchor, Standard
from .court_fit import CourtFit
from .court_models import (
    BASKETBALL_COURTS,
    HANDBALL_COURT,
    PADEL_COURT,
    TENNIS_COURT,
    VOLLEYBALL_COURT,
)
from .courts import ALONG_SD, EVEN, CourtLook, best_apart, evidence
from .strokes import values

PADEL_SEARCHED = 0.15  # [m/px] of the search: its lines are no longer than seeds are at 0.3
PADEL_EVEN = 0.5  # least evidence of its lines: its walls are evidence, too
PADEL_LINE_SEEN = 0.5  # least share of each line that is seen
PADEL_FALSE = 0.05
PADEL_COARSE = 0.08  # times the squared GSD [m/px]: relative 1 sigma as shadows end beside lines. From drawn courts
HALF_LENGTH, HALF_WIDTH = 10.0, 5.0  # [m] to the inside of the walls
FEWEST_WALLS = 3  # of four that must be seen: neighbours may share one
WALL_OFF, WALL_OFF_PX = 0.25, 0.6  # [m] and [px] by which a border may lie off its wall
WALL_INSIDE, WALL_OUTSIDE = 1.5, 1.0  # [m] from the wall, between which the border is searched
WALL_ACROSS, WALL_ACROSS_PX = 0.05, 0.3  # [m] and [px] between samples across a wall
WALL_CORNER = 1.0  # [m] of each wall's ends that are left out
WALL_SEEN = 0.7  # least share of a wall with the border where it must be
WALL_TOGETHER = 5  # steps along a wall that are averaged against noise
WALL_STEP = 0.5  # [m] between samples along walls and within the court
CLEAR_OF_PAINT = 0.5  # [m] from lines, net and walls: there is nothing but turf
TURF_COLOURED = 0.09  # least difference between turf's strongest and weakest channel, as a share of all light
TURF_ENDS = 0.03  # least change of the channels' shares of light at a border
TURF_EVEN = 0.8  # least share of the turf that is nearer to its own colour than to that beyond the borders


@dataclass(frozen=True)
class PadelCourts:
    """Finds padel courts (an `AnchorFinder`). The `standards` give the distance between the service lines."""

    kind = "padel court"
    standards: tuple[Standard, ...] = (PADEL_COURT.standard,)
    extent = 24.0
    finest = 0.05
    coarsest = 0.32

    def find(self, image: np.ndarray, gsd: float, gsd_sd: float, country: str) -> Sequence[Anchor]:
        """See `AnchorFinder.find`."""
        if min(image.shape[:2]) < HALF_LENGTH / gsd:
            return []
        look = CourtLook(image, gsd, gsd_sd, PADEL_SEARCHED)
        # The lines of two neighbouring courts also form an H, as clear as that of each court.
        fits = [replace(fit, across=fit.along) for fit in look.fits(PADEL_COURT, sure=1.0)]
        lined = [fit for fit in fits if evidence(fit) > PADEL_EVEN and fit.seen.min() > PADEL_LINE_SEEN]
        if not lined:
            return []
        shares = _shares(image)
        fits = [fit for fit in lined if _is_walled_turf(shares, fit)]
        if fits:
            others = (TENNIS_COURT, VOLLEYBALL_COURT, HANDBALL_COURT, *BASKETBALL_COURTS)
            fits += [rival for court in others for rival in look.fits(court) if evidence(rival) > EVEN]
        return [self._anchor(fit) for fit in best_apart(fits) if fit.court is PADEL_COURT]

    def _anchor(self, fit: CourtFit) -> Anchor:
        # No line gives the scale across the court.
        own = np.sqrt(fit.along_sd**2 + ALONG_SD**2 + (PADEL_COARSE / fit.along**2) ** 2)
        return Anchor(
            kind=self.kind,
            place=fit.place,
            lines=fit.points(fit.court.drawing()),
            pixels=fit.along * PADEL_COURT.standard.metres,
            relative_sd=float(own),
            residual=fit.residual,
            standards=self.standards,
            false=PADEL_FALSE,
        )


def _shares(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) float32: each channel's share of all light, which shadows of walls hardly change."""
    light = cv2.GaussianBlur(image, (0, 0), 0.7).astype(np.float32) + 1.0
    return light / light.sum(2, keepdims=True)


def _is_walled_turf(shares: np.ndarray, fit: CourtFit) -> bool:
    """Whether the court's ground is of one colour, and ends at its walls."""
    x = np.arange(-HALF_LENGTH + CLEAR_OF_PAINT, HALF_LENGTH, WALL_STEP)
    y = np.arange(-HALF_WIDTH + CLEAR_OF_PAINT, HALF_WIDTH, WALL_STEP)
    service = PADEL_COURT.standard.metres / 2
    x = x[(np.abs(x) > CLEAR_OF_PAINT) & (np.abs(np.abs(x) - service) > CLEAR_OF_PAINT)]
    y = y[np.abs(y) > CLEAR_OF_PAINT]
    inside = values(shares, fit.points(np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)))
    turf = np.median(inside, axis=0)
    if np.ptp(turf) < TURF_COLOURED:
        return False
    steps = np.array([step for step in (_border(shares, fit, turf, k) for k in range(4)) if step > 0])
    if len(steps) < FEWEST_WALLS:
        return False
    return bool(np.mean(np.linalg.norm(inside - turf, axis=1) < np.median(steps) / 2) >= TURF_EVEN)


def _border(shares: np.ndarray, fit: CourtFit, turf: np.ndarray, side: int) -> float:
    """How much the colour changes where the turf ends at one of the four walls; 0 where it does not end there."""
    length, wall = (HALF_WIDTH, HALF_LENGTH) if side % 2 else (HALF_LENGTH, HALF_WIDTH)
    along = np.arange(-length + WALL_CORNER, length - WALL_CORNER + 0.01, WALL_STEP)
    out = np.arange(-WALL_INSIDE, WALL_OUTSIDE, max(WALL_ACROSS, WALL_ACROSS_PX / fit.along))
    u, v = np.meshgrid(along, wall + out, indexing="ij")
    metres = np.stack([v, u] if side % 2 else [u, v], -1) * (1 if side < 2 else -1)
    place = fit.points(metres)
    if not ((place >= 0) & (place <= np.array(shares.shape[1::-1]) - 1)).all():
        return 0.0
    other = cv2.blur(values(shares, place) - turf, (1, WALL_TOGETHER), borderType=cv2.BORDER_REPLICATE)
    other = np.linalg.norm(other, axis=-1)
    most = other.max(1)
    at = out[np.argmax(other > most[:, None] / 2, axis=1)]
    ends = (most > TURF_ENDS) & (np.abs(at) < WALL_OFF + WALL_OFF_PX / fit.along)
    return float(np.median(most)) if ends.mean() >= WALL_SEEN else 0.0
