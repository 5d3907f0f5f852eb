"""Anchors with known truth: white squares on grey, a finder for them, and votes with a given error."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from orthoscale.core.anchors import Anchor, AnchorVote, Standard

SIDE = 10.0  # [m] of a square
SQUARE = Standard("squares of 10 m", SIDE, 0.001, "drawn so")
FALSE = 0.01
FINE = 5  # samples per pixel, across and down, for the share of it that is painted


@dataclass(frozen=True)
class SquareFinder:
    """Finds bright filled squares of about the standard's size, by their area: edge pixels count in proportion to their
    brightness."""

    standards: tuple[Standard, ...] = (SQUARE,)
    kind: str = "painted square"
    extent: float = 15.0
    finest: float = 0.2
    coarsest: float = 0.5

    def find(self, image, gsd, gsd_sd, country):
        share = np.clip((image.mean(axis=2) - 100) / 155, 0, 1)  # of a pixel that is painted
        bright = (share > 0.9).astype(np.uint8)
        count, label, stats, middle = cv2.connectedComponentsWithStats(bright, connectivity=4)
        found = []
        for k in range(1, count):
            x, y, w, h, area = stats[k]
            cut = x == 0 or y == 0 or x + w == image.shape[1] or y + h == image.shape[0]
            around = share[max(y - 3, 0) : y + h + 3, max(x - 3, 0) : x + w + 3]
            side = float(np.sqrt(np.where(around > 0.15, around, 0).sum()))
            likely = [s for s in self.standards if abs(np.log(s.metres / side / gsd)) < 2 * gsd_sd]
            box = cv2.boxPoints(cv2.minAreaRect(np.argwhere(label == k)[:, ::-1].astype(np.float32)))
            full = area / max(cv2.contourArea(box), 1)
            if cut or not likely or not 0.9 < full < 1.3:
                continue
            lines = np.stack([box, np.roll(box, -1, axis=0)], axis=1).astype(float)
            residual = np.full(8, 0.2)
            found.append(Anchor(self.kind, middle[k], lines, side, 0.002, residual, tuple(likely), FALSE))
        return found


def squares(width, height, gsd, middles, side=SIDE, turn=0.3):
    """A grey picture of `gsd` m/px with a white square at each of `middles` (N, 2) [px]."""
    image = np.random.default_rng(0).integers(90, 110, (height, width, 3), dtype=np.uint8)
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ np.array([[c, s], [-s, c]]) * side / gsd / 2
    reach = int(np.abs(corners).max()) + 2
    x, y = (np.indices((2 * reach * FINE, 2 * reach * FINE))[::-1] + 0.5) / FINE - reach  # from the window's middle
    for middle in np.asarray(middles, float).reshape(-1, 2):
        left, top = (np.floor(middle) - reach).astype(int)
        along, across = np.array([[c, s], [-s, c]]) @ np.stack([x, y] - (middle % 1)[:, None, None]).reshape(2, -1)
        inside = (np.maximum(np.abs(along), np.abs(across)) < side / gsd / 2).reshape(x.shape)
        share = inside.reshape(2 * reach, FINE, 2 * reach, FINE).mean((1, 3))[..., None]
        window = image[top : top + 2 * reach, left : left + 2 * reach]
        window[:] = np.round(share * 255 + (1 - share) * window)
    return image


def vote(kind, log_scale, sd, standards, meant=0, false=FALSE, window=0.4, at=0.0):
    """An anchor of a kind that gives the scale exp(`log_scale`) if it is the one with the index `meant` of
    `standards`."""
    units = standards[meant].metres / np.exp(log_scale)
    lines = np.array([[[at, 0.0], [at + units, 0.0]]])
    anchor = Anchor(kind, np.array([at, 0.0]), lines, units, sd, np.zeros(1), tuple(standards), false)
    return AnchorVote(anchor, anchor.place, units, sd, window=window)


SMALL = Standard("squares of 6 m", 6.0, 0.001, "drawn so")


def small_squares():
    """A finder of another kind, which takes any square of the right size in pixels for one of 6 m."""
    return SquareFinder(standards=(SMALL,), kind="small square", extent=9.0)


HALF = Standard("squares of 5 m", 5.0, 0.001, "drawn so")


def squares_of_two_sizes():
    """A finder that takes a square for one of 10 m or of 5 m, whichever fits the scale that it is told."""
    return SquareFinder(standards=(SQUARE, HALF))
