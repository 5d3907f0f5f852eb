"""Candidate poses of courts with a circle, such as the centre circle of a pitch.

Ridges vote for the centre of their circle (Hough; Duda and Hart 1972), and a line through it gives the direction.
"""

from __future__ import annotations

import numpy as np

from ..core.angles import unit_vector
from .court_models import Court
from .peaks import circle_centres, peak_shift
from .poses import Poses, Ridges
from .ridges import CLEAR_RIDGE, DIRECTIONS

VOTING = 0.3  # of a clear ridge: least ridge of a pixel that votes
BIN = 2  # [px] side of an accumulator cell
RADII_APART = 1.5  # [px] step between the radii that are tried
CIRCLE_SEEN = 0.3  # of the circumference: least votes for the 3 x 3 cells about a centre
MIDDLE_LINE = 0.3  # least mean ridge of the line through the centre
CIRCLES = 60  # clearest ones kept per megapixel, but never fewer than:
FEWEST_CIRCLES = 8
TURNS = 120  # directions of the line that are tried


def circled(ridges: Ridges, court: Court, size: float, spread: float) -> Poses:
    """Candidate poses of `court` (a circle and a line along the court through its centre), clearest first. A metre is
    `size` [px] to within a factor exp(spread)."""
    radius = max(stroke.radius for stroke in court.strokes)
    reach = max(stroke.length for stroke in court.strokes if not stroke.radius) / 2
    place, normal = _voters(ridges)
    shape = ridges.height, ridges.width
    low, high = radius * size * np.exp([-spread, spread])
    radii = np.arange(low, high + RADII_APART, RADII_APART)
    found = np.concatenate([circle_centres(place, normal, r, shape, BIN, CIRCLE_SEEN) for r in radii])
    most = max(FEWEST_CIRCLES, round(CIRCLES * ridges.width * ridges.height / 1e6))
    found = found[np.argsort(-found[:, 3], kind="stable")][:most]
    angle = np.arange(TURNS) * np.pi / TURNS
    along = np.linspace(-1, 1, 81) * reach / radius  # [radii]
    place = found[:, None, None, :2] + found[:, None, None, 2:3] * along[:, None] * unit_vector(angle)[:, None]
    ridge = ridges.at(place[..., 0], place[..., 1], np.broadcast_to(angle[:, None], place.shape[1:3]))
    line = np.clip(ridge / CLEAR_RIDGE, 0, 1).mean(-1)  # (N, TURNS)
    best = line.argmax(1) if len(found) else np.zeros(0, int)
    seen = line[np.arange(len(found)), best]
    good = seen >= MIDDLE_LINE
    score = (found[:, 3] + seen)[good] / 2
    order = np.argsort(-score, kind="stable")
    return Poses(found[good, :2][order], angle[best][good][order], (found[good, 2] / radius)[order], score[order])


def _voters(ridges: Ridges) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Pixels on ridges, x and y (N,), and the unit vectors across the ridges, x and y (N,)."""
    best = ridges.maps.argmax(0)
    y, x = np.nonzero(ridges.maps.max(0) >= VOTING * CLEAR_RIDGE)
    k = best[y, x]
    left, middle, right = (ridges.maps[(k + d) % DIRECTIONS, y, x].astype(float) for d in (-1, 0, 1))
    across = (k + peak_shift(left, middle, right)) * np.pi / DIRECTIONS + np.pi / 2
    return (x, y), (np.cos(across), np.sin(across))
